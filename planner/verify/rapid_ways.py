"""All that a task does and may do, from its modules: the straight way, and what errors and UNDO run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from planner.verify.rapid_ast import Module
from planner.verify.rapid_evaluate import Names
from planner.verify.rapid_flow import Runner
from planner.verify.steps import Step

Sections = Mapping[tuple[str, str], tuple[Step, ...]]


def flatten(modules: Sequence[Module], entry: str = "main") -> tuple[Step, ...]:
    """All steps of a task from `entry` on, for modules without faults (`rapid_reader.read_task`).

    Raises `FlowError` when the entry is missing, the calls have no end, or run-time conditions decide over
    the motion.
    """
    return Runner(modules).run(entry)


@dataclass(frozen=True, slots=True)
class Flow:
    """All that a task may do: `steps` of its straight way, steps of each ERROR section (`handlers`) and UNDO
    section (`undos`) by (module, procedure), in which branches on run-time conditions are included and say
    so, and `called`: (module, procedure) of all that runs or may run, those sections included."""

    steps: tuple[Step, ...]
    handlers: Sections
    undos: Sections
    called: frozenset[tuple[str, str]]


def flow(modules: Sequence[Module], entry: str = "main") -> Flow:
    """What :func:`flatten` gives, with all that may run beside it; raises as that does."""
    names = Names(modules)
    runner = Runner(modules, names=names)
    steps = runner.run(entry)
    errors, undo = (_sections(modules, names, which) for which in ("error", "undo"))
    return Flow(steps, errors, undo, _called(modules, names, runner.entered))


def handlers(modules: Sequence[Module]) -> Sections:
    """The :class:`Flow`'s `handlers` alone."""
    return _sections(modules, Names(modules), "error")


def _called(
    modules: Sequence[Module], names: Names, entered: set[tuple[str, str]]
) -> frozenset[tuple[str, str]]:
    """What may run where the straight way has `entered` these procedures."""
    by_name = {(m.name, p.name): p for m in modules for p in reversed(m.procedures)}
    found = set(entered)
    todo = set(found)
    while todo:
        holder, name = todo.pop()
        module, procedure = names.modules[holder.lower()], by_name[holder, name]
        for block in (procedure.error, procedure.undo):
            aside = Runner(modules, handler=True, names=names)
            aside.run_block(module, procedure, block or ())
            todo |= aside.entered - found
            found |= aside.entered
    return frozenset(found)


def _sections(modules: Sequence[Module], names: Names, which: str) -> dict[tuple[str, str], tuple[Step, ...]]:
    found: dict[tuple[str, str], tuple[Step, ...]] = {}
    for module in modules:
        for procedure in module.procedures:
            block = getattr(procedure, which)
            if block is not None:
                runner = Runner(modules, handler=True, names=names)
                found[module.name, procedure.name] = runner.run_block(module, procedure, block)
    return found
