"""Faults in the planner's own code, in memory, and the verdict of the proof on the resulting programs.

A fault stays in force from reading the problem to the proof's last rule, as a defect of the code base would,
while the planner's own checks are off. The faults are in code that only the planner uses. None is in code
that the proof may share by decision 0001: constants, the cell, plain vector algebra.
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
"""Function that returns the replacement of an object, given the object."""

LEFT_OUT: Final = ("planner.service", "planner.batch", "planner.__main__")
"""Packages that no plan is made by."""

CHECKS: Final[Mapping[str, Change]] = {
    target: lambda old: lambda *args, **more: []
    for target in (
        "processes.hotwire.plan.elastic.check:check_job",
        "processes.hotwire.plan.elastic.check:check_driven",
        "processes.hotwire.plan.elastic.check:check_heat",
        "processes.hotwire.plan.elastic.check:check_shape",
        "processes.hotwire.plan.elastic.check:misfit_issues",
        "processes.hotwire.plan.elastic.job:_drive_issues",
        "processes.hotwire.plan.elastic.job:_check_length",
        "processes.hotwire.plan.min_feed_check:check_min_feed",
        "processes.hotwire.plan.straight.check:check_bow",
        "processes.hotwire.plan.straight.check:check_cut",
        "processes.hotwire.plan.straight.check:check_holder",
        "processes.hotwire.plan.straight.check:check_model",
        "processes.hotwire.plan.straight.slot_check:check_heat",
        "processes.hotwire.plan.straight.slot_check:check_driven",
        "processes.hotwire.plan.straight.slot_check:check_inner_corners",
        "processes.hotwire.plan.straight.slot_check:check_path",
        "processes.hotwire.plan.straight.route:check_drops",
        "processes.forming.plan.check:check",
        "processes.forming.plan.check:clamp_reach_issues",
        "processes.forming.plan.check:die_check",
        "processes.forming.plan.check:shift_issues",
        "processes.forming.plan.springback.compensation:steepening_issues",
        "processes.forming.plan.two_point:holder_issues",
        "processes.milling.plan.check:check_work",
        "processes.milling.plan.flank_cut:check_flank",
        "processes.milling.plan.process_plan:_speed_issues",
        "geometry.mesh:check_surface",
        "geometry.part_placement:check_ruled",
        "reading.part_surfaces:check_size",
        "reading.part_surfaces:_check_sides",
        "reading.part:_refuse_shapes",
        "reading.part:_require_enclosed",
        "reading.sheet:_require_fits",
        "reading.sheet:_require_flat_rim",
        "motion.diagnosis:require_linear_moves",
        "motion.homing:require_free_home",
        "motion.sag:_range_issues",
        "motion.sag:_min_feed_issues",
        "motion.sag:_uneven_sag_issues",
        "languages.writing.write:refusals",
    )
}
"""The planner's own checks, which are disabled while a fault is in force."""


def _none(old: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args, **more: None


SOONER: Final[Mapping[str, Change]] = {
    "motion.operation:_clearance_penalty": _none,
    "processes.forming.plan.springback.forecast:estimate_springback": _none,
}
"""Changes that save planning time.

Paths are optimised without distance queries, which take most of the time; the search and the clearance check
keep them collision-free. Springback is not forecast.
"""


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
    """Change the return value of a function."""

    def wrap(old: Callable[..., Any]) -> Callable[..., Any]:
        return functools.wraps(old)(lambda *args, **more: change(old(*args, **more)))

    return wrap


def fields(**changes: Callable[[Any], Any]) -> Change:
    """Change fields of the return value of a function."""
    return result(lambda made: change_fields(made, **changes))


def change_fields(instance: Any, **changes: Callable[[Any], Any]) -> Any:
    """A dataclass with changed fields."""
    return dataclasses.replace(
        instance, **{name: change(getattr(instance, name)) for name, change in changes.items()}
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
    """Replace a function by one that always returns this value."""
    return lambda old: lambda *args, **more: new


# ---- putting them into the planner ----


@functools.cache
def modules() -> tuple[Any, ...]:
    """All modules that read, plan, write and prove problems."""
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
    """References in the planner to each object of its modules: (module, name, object) by the object's id."""
    out: dict[int, list[tuple[Any, str, Any]]] = {}
    for module in modules():
        for name, thing in vars(module).items():
            out.setdefault(id(thing), []).append((module, name, thing))
    return {key: tuple(places) for key, places in out.items()}


@functools.cache
def _caches() -> tuple[Any, ...]:
    """All memoised functions of the planner."""
    things = {id(t): t for places in _held().values() for _, _, t in places}
    return tuple(t for t in things.values() if callable(getattr(t, "cache_clear", None)))


@contextlib.contextmanager
def changed(changes: Mapping[str, Change]) -> Iterator[None]:
    """The targets are something else everywhere in the planner, also where they were imported by name."""
    _caches()
    originals: list[tuple[Any, str, Any]] = []
    try:
        for target, change in changes.items():
            for place, name, old, new in _changes(target, change):
                originals.append((place, name, old))
                setattr(place, name, new)
        _forget()
        yield
    finally:
        for place, name, old in reversed(originals):
            setattr(place, name, old)
        _forget()


def thing(target: str) -> Any:
    """Return the object that a target names."""
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
    """Plan and prove a job while ``changes`` are in force and the planner's checks are off.

    ``first_error``: the proof stops at the first broken rule, and the plan is made with :data:`SOONER`.
    """
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
    """Return the programs without their comments."""
    return {
        name: [line for line in text.splitlines() if not re.match(r"\s*[!;](?![*?])", line)]
        for name, text in programs.items()
    }
