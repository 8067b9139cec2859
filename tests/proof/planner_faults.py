"""Faults put into the planner's own code, in memory, and what the proof says of the programs that come out.

A fault stays in force from reading the problem to the proof's last rule, as a defect of the code base would,
while the planner's own checks are off. Faults are in what the planner alone decides or reads; none is
in what the proof may share by decision 0001: constants, the cell, plain vector algebra.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib
import pkgutil
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import planner
from planner import pipeline
from planner.issues import TandemError
from planner.problem import Problem
from planner.proof import prove
from planner.proof.verdict import Proof
from tests.proof.planner_jobs import JOBS

Change = Callable[[Any], Any]
"""Makes what stands in for something, of that thing itself."""

LEFT_OUT: Final = ("planner.service", "planner.batch", "planner.__main__")
"""Packages that no plan is made by."""

CHECKS: Final[Mapping[str, Change]] = {
    target: lambda old: lambda *args, **more: []
    for target in (
        "processes.hotwire.plan.elastic.check:check",
        "processes.hotwire.plan.elastic.check:check_driven",
        "processes.hotwire.plan.elastic.check:check_heat",
        "processes.hotwire.plan.elastic.check:check_shape",
        "processes.hotwire.plan.elastic.check:misfit",
        "processes.hotwire.plan.elastic.job:_driven",
        "processes.hotwire.plan.elastic.job:_long_enough",
        "processes.hotwire.plan.least_feed:check_least",
        "processes.hotwire.plan.straight.check:check_bow",
        "processes.hotwire.plan.straight.check:check_cut",
        "processes.hotwire.plan.straight.check:check_holder",
        "processes.hotwire.plan.straight.check:check_model",
        "processes.hotwire.plan.straight.slot_check:check_heat",
        "processes.hotwire.plan.straight.slot_check:check_driven",
        "processes.hotwire.plan.straight.slot_check:check_inner",
        "processes.hotwire.plan.straight.slot_check:check_passed",
        "processes.hotwire.plan.straight.route:check_drops",
        "processes.forming.plan.check:check",
        "processes.forming.plan.check:clamped_issues",
        "processes.forming.plan.check:of_die",
        "processes.forming.plan.check:shift_issues",
        "processes.forming.plan.springback.compensation:steeper",
        "processes.forming.plan.two_point:holder_issues",
        "processes.milling.plan.check:check",
        "processes.milling.plan.flank_cut:check",
        "processes.milling.plan.process_plan:_speeds",
        "geometry.mesh:check_surface",
        "geometry.placing:check_ruled",
        "reading.part_surfaces:check_size",
        "reading.part_surfaces:_check_sides",
        "reading.part:_refuse_shapes",
        "reading.part:_refuse_small",
        "reading.sheet:_require_fits",
        "reading.sheet:_require_flat_rim",
        "motion.diagnosis:require_moves",
        "motion.ways:require_home",
        "motion.sag:_beyond",
        "motion.sag:_least_feed",
        "motion.sag:_uneven",
        "languages.writing.write:refusals",
    )
}
"""The planner's own checks, which find nothing while a fault is in force."""


def _none(old: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, **more: None


SOONER: Final[Mapping[str, Change]] = {
    "motion.operation:_avoid": _none,
    "processes.forming.plan.springback.forecast:estimate": _none,
}
"""Paths are optimised without asking for distances, which takes most of the time of planning; they stay free,
as the search and the look at moves see to that. What a sheet springs back by is not foretold to people."""


@dataclasses.dataclass(frozen=True)
class Fault:
    """A fault by its name, the job (of ``JOBS``) that shows it, and what it changes: {module:name, without
    ``planner.``: change}."""

    name: str
    job: str
    changes: Mapping[str, Change]


@dataclasses.dataclass(frozen=True)
class Verdict:
    """What came of a job. ``refused``: codes of the planner's own issues where it made no programs;
    ``programs``: the texts; ``proven``; ``broken``: codes of rules that do not hold."""

    refused: tuple[str, ...]
    programs: Mapping[str, str]
    proven: bool
    broken: tuple[str, ...]


# ---- making changes ----


def result(change: Callable[..., Any]) -> Change:
    """Whatever a function gives back is changed."""

    def wrap(old: Callable[..., Any]) -> Callable[..., Any]:
        return functools.wraps(old)(lambda *args, **more: change(old(*args, **more)))

    return wrap


def fields(**changes: Callable[[Any], Any]) -> Change:
    """Fields of the value that a function gives back are changed."""
    return result(lambda made: of(made, **changes))


def of(made: Any, **changes: Callable[[Any], Any]) -> Any:
    """A dataclass with changed fields."""
    return dataclasses.replace(
        made, **{name: change(getattr(made, name)) for name, change in changes.items()}
    )


def given(number: int, change: Callable[[Any], Any]) -> Change:
    """A function is given another value as its positional argument ``number``."""

    def wrap(old: Callable[..., Any]) -> Callable[..., Any]:
        def other(*args: Any, **more: Any) -> Any:
            return old(*args[:number], change(args[number]), *args[number + 1 :], **more)

        return functools.wraps(old)(other)

    return wrap


def value(new: Any) -> Change:
    """A constant has another value."""
    return lambda old: new


def always(new: Any) -> Change:
    """A function gives back this, whatever it is asked."""
    return lambda old: lambda *args, **more: new


# ---- putting them into the planner ----


@functools.cache
def modules() -> tuple[Any, ...]:
    """All modules by which problems are read, planned, written and proven."""
    for found in pkgutil.walk_packages(planner.__path__, "planner."):
        if not found.name.startswith(LEFT_OUT):
            importlib.import_module(found.name)
    return tuple(
        module
        for name, module in sorted(sys.modules.items())
        if name.startswith("planner") and not name.startswith(LEFT_OUT)
    )


@functools.cache
def _held() -> Mapping[int, tuple[tuple[Any, str, Any], ...]]:
    """Where in the planner each thing of its modules is known: (module, name, thing) by the thing's id."""
    out: dict[int, list[tuple[Any, str, Any]]] = {}
    for module in modules():
        for name, thing in vars(module).items():
            out.setdefault(id(thing), []).append((module, name, thing))
    return {key: tuple(places) for key, places in out.items()}


@functools.cache
def _caches() -> tuple[Any, ...]:
    """All functions of the planner that remember what they gave back."""
    things = {id(t): t for places in _held().values() for _, _, t in places}
    return tuple(t for t in things.values() if callable(getattr(t, "cache_clear", None)))


@contextlib.contextmanager
def changed(changes: Mapping[str, Change]) -> Iterator[None]:
    """The targets are something else everywhere in the planner, also where they were imported by name."""
    _caches()
    before: list[tuple[Any, str, Any]] = []
    try:
        for target, change in changes.items():
            for place, name, old, new in _changes(target, change):
                before.append((place, name, old))
                setattr(place, name, new)
        _forget()
        yield
    finally:
        for place, name, old in reversed(before):
            setattr(place, name, old)
        _forget()


def thing(target: str) -> Any:
    """What a target names."""
    where, _, name = target.partition(":")
    held: Any = importlib.import_module(f"planner.{where}")
    for part in name.split("."):
        held = vars(held)[part]
    return held.__func__ if isinstance(held, staticmethod) else held


def _changes(target: str, change: Change) -> list[tuple[Any, str, Any, Any]]:
    """(where, name, old, new) of everything that a change of ``target`` touches."""
    where, _, name = target.partition(":")
    holder: Any = importlib.import_module(f"planner.{where}")
    if "." not in name:
        old = getattr(holder, name)
        new = change(old)
        places = _held()[id(old)]
        return [(m, known, old, new) for m, known, _ in places if callable(old) or known == name]
    owner, name = name.split(".")
    holder = getattr(holder, owner)
    old = holder.__dict__[name]
    if isinstance(old, property):
        return [(holder, name, old, property(change(old.fget)))]
    if isinstance(old, staticmethod):
        return [(holder, name, old, staticmethod(change(old.__func__)))]
    return [(holder, name, old, change(old))]


def _forget() -> None:
    for cache in _caches():
        cache.cache_clear()


# ---- running a job ----


def run(job: str, folder: Path, changes: Mapping[str, Change], first_error: bool = False) -> Verdict:
    """A job's plan, programs and proof while ``changes`` are in force and the planner's checks are off.
    ``first_error``: the proof stops at the first rule that is broken, by which it does not hold, and the plan
    is made :data:`SOONER`."""
    modules()
    path = JOBS[job](folder)
    with changed({**CHECKS, **(SOONER if first_error else {}), **changes}):
        return _planned(path, first_error)


def _planned(path: Path, first_error: bool) -> Verdict:
    written: dict[str, str] = {}
    own = prove.prove

    def watched(problem: Problem, claims: Any, programs: Mapping[str, str], *executor: Any) -> Proof:
        written.update(programs)
        if first_error:
            return prove.Prover(problem, claims, *executor).prove(programs, first_error=True)
        return own(problem, claims, programs, *executor)

    prove.prove = watched
    try:
        proof = pipeline.plan(pipeline.load(path)).proof
    except TandemError as error:
        codes = tuple(sorted({issue.code for issue in error.issues}))
        return Verdict(() if written else codes, written, False, codes if written else ())
    finally:
        prove.prove = own
    broken = tuple(rule.code for rule in proof.rules if rule.ran and not rule.passed)
    return Verdict((), written, proof.ok, broken)


@functools.cache
def clean(job: str) -> Verdict:
    """The job without a fault."""
    with tempfile.TemporaryDirectory() as folder:
        return run(job, Path(folder), {})


def instructions(programs: Mapping[str, str]) -> dict[str, list[str]]:
    """What the programs do, without their comments."""
    return {
        name: [line for line in text.splitlines() if not re.match(r"\s*[!;](?![*?])", line)]
        for name, text in programs.items()
    }
