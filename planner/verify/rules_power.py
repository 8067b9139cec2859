"""Rules on the power of wires: on and hot in the foam, off at hands, switched in one plain way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from planner.claims_forming import SinksHolder
from planner.issues import Issue
from planner.verify.context import Context, Outcome, Phase
from planner.verify.findings import at_step
from planner.verify.job import TaskText
from planner.verify.rules_wire import moving, wire_issue
from planner.verify.steps import MessageStep, MoveStep, SignalStep, Step
from planner.verify.wire import Wire

IntArray = NDArray[np.int64]


def signals(context: Context) -> Outcome:
    """Only the signals of wires, of spindles and of clamps that sink are switched, to 0 or 1, at once, by
    one task between two synchronisation points, and are off before anybody is asked or an arm moves."""
    issues: list[Issue] = []
    known = {claim.signal.lower() for claim in context.contacts}
    known |= {claim.signal.lower() for claim in context.claims if isinstance(claim, SinksHolder)}
    known.add(context.problem.cell.controller.wire_signal.lower())
    issues += _left_on(context, known)
    for stage in context.job.stages:
        first: TaskText | None = None
        for task in context.job.tasks:
            for step in stage.steps[task.name]:
                if not isinstance(step, SignalStep):
                    continue
                faults = []
                if step.signal.lower() not in known:
                    faults.append(f"{step.signal} is no signal of a wire, a spindle or a clamp")
                if step.value not in (0.0, 1.0):
                    faults.append(f"{step.signal} is set to {step.value:g}, neither 0 nor 1")
                if step.delay:
                    faults.append(f"{step.signal} is switched {step.delay:g} s later")
                if first is not None and first is not task:
                    faults.append(f"{first.name} switches a signal between the same synchronisation points")
                first = first or task
                issues += [at_step("verify.signals", fault, task, step) for fault in faults]
    for task in context.job.tasks:
        issues += [
            Issue(
                "verify.signals",
                f"{data.name} hides a signal of the controller",
                file=task.name,
                line=data.line,
            )
            for module in task.modules
            for data in module.data
            if data.kind.startswith("signal")
        ]
    return Outcome(tuple(issues))


def _left_on(context: Context, known: set[str]) -> list[Issue]:
    """Power that a program before this one may have left on, when a task asks or moves at first."""
    issues = []
    for task in context.job.tasks:
        off: set[str] = set()
        first: Step | None = None
        for step in task.steps:
            if isinstance(step, MoveStep) or (isinstance(step, MessageStep) and step.confirm):
                first = first or step
            elif isinstance(step, SignalStep) and step.signal.lower() in known:
                name = step.signal.lower()
                if name not in off and (first is not None or step.value):
                    what = f"{step.signal} is not switched off first; a run before this may have left it on"
                    issues.append(at_step("verify.signals", what, task, step))
                off.add(name)
    return issues


def wire_power(context: Context, wires: tuple[Wire, ...]) -> Outcome:
    """The power is on and the wire hot before it touches the block, on until it has left, and off when hands
    are near it."""
    issues: list[Issue] = []
    for wire in wires:
        for claim in context.setup_claims[wire.setup].contacts:
            issues += _power_in_contact(context, wire, claim.signal, claim.heat_up)
            if wire.phase is not None:
                issues += _power_at_hands(context, wire.phase, claim.signal)
    for signal in sorted({claim.signal for claim in context.contacts}):
        issues += _power_elsewhere(context, signal)
    return Outcome(tuple(issues), where="" if wires else "no wire")


def _switching(context: Context, signal: str) -> list[tuple[float, float]]:
    """Times and values of a signal in order; off at first."""
    found = [
        (time, step.value)
        for time, _, _, step in context.motion.step_time
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower()
    ]
    return [(-np.inf, 0.0), *sorted(found, key=lambda item: item[0])]


def _power_in_contact(context: Context, wire: Wire, signal: str, heat_up: float) -> list[Issue]:
    touching = np.flatnonzero(wire.depth > 0.0)
    if not len(touching):
        return []
    issues = []
    switching = _switching(context, signal)
    for run in np.split(touching, np.flatnonzero(np.diff(touching) > 1) + 1):
        first, last = context.motion.time[wire.sample[run[[0, -1]]]]
        before = [(time, value) for time, value in switching if time <= first]
        on = next((i for i in range(len(before), 0, -1) if not before[i - 1][1]), 0)
        if on == len(before):
            what = f"{signal} is not on when the wire touches the block"
            issues.append(wire_issue(context, wire, "verify.wire_power", what, int(run[0])))
        elif first - before[on][0] < heat_up - 1e-6:
            hot = float(first - before[on][0])
            what = f"the wire touches the block {hot:.1f} s after {signal} is on; it needs {heat_up:g} s"
            issues.append(
                wire_issue(context, wire, "verify.wire_power", what, int(run[0]), hot, heat_up, "s")
            )
        if any(not value and first < time < last for time, value in switching):
            what = f"{signal} goes off while the wire is in the block"
            issues.append(wire_issue(context, wire, "verify.wire_power", what, int(run[-1])))
    return issues


def _power_at_hands(context: Context, phase: Phase, signal: str) -> list[Issue]:
    """Off at the first confirmation (mounting) and the last one (taking off), and heated up by waiting, not
    by moving."""
    issues = []
    steps = context.mounted_steps(phase)
    confirms = context.confirms(phase)
    state: list[float] = []
    value = 0.0
    for _, _, step in steps:
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        state.append(value)
    if confirms:
        first, last = moving(context, phase)
        if state[confirms[0]] and confirms[0] < first:
            issues.append(Issue("verify.wire_power", f"{signal} is on when the operator mounts the wire"))
        if any(state[i] and first < i < last for i in confirms):
            what = f"{signal} is on while the operator is asked something on the way"
            issues.append(Issue("verify.wire_power", what, hint="ask before the arms move, or switch it off"))
        if state[confirms[-1]] and confirms[-1] > last:
            issues.append(Issue("verify.wire_power", f"{signal} is on when the operator takes the wire off"))
    if value:
        issues.append(Issue("verify.wire_power", f"{signal} is still on when the arms move alone again"))
    return issues


def _power_elsewhere(context: Context, signal: str) -> list[Issue]:
    """Off at every question that is no part of mounting a bent wire, and at the end of the job."""
    issues = []
    mounted = {number for phase in context.phases for number in range(phase.first, phase.last + 1)}
    value = 0.0
    for number, task, step in _all_steps(context):
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower():
            value = step.value
        if isinstance(step, MessageStep) and step.confirm and value and number not in mounted:
            what = f"{signal} is on while the operator is asked something"
            issues.append(at_step("verify.wire_power", what, task, step, "switch it off first"))
    if value:
        issues.append(Issue("verify.wire_power", f"{signal} is on when the programs end"))
    return issues


def _all_steps(context: Context) -> Iterator[tuple[int, TaskText, Step]]:
    """Steps of all tasks, stage by stage; within a stage only one task switches."""
    for number, stage in enumerate(context.job.stages):
        for task in context.job.tasks:
            yield from ((number, task, step) for step in stage.steps[task.name])
