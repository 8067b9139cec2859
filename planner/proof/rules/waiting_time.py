"""Rules on time that passes while nothing moves.

verify.power_idle: how long arms may stand with the power of a wire or a spindle on.
verify.meeting_time: how long tasks wait where they meet.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from planner.claims.handshake import HandshakeKind
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.programs import job, stages
from planner.programs.handshake.automata import Reading
from planner.programs.stages import Stage, TaskText, sync_points
from planner.programs.steps import ChoiceStep, MessageStep, MoveStep, SettingStep, SignalStep, Step, WaitStep
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import of_task
from planner.proof.replay.logic import between, dwell_time
from planner.proof.rule import Outcome, at_node, at_step, mm, rule

POWER_IDLE = "verify.power_idle"
"""Code of the rule about power before anything moves."""
MEETING_TIME = "verify.meeting_time"
"""Code of the rule about waits at meetings."""
IDLE_FACTOR = 1.1
"""Power may be on this many times as long as the problem says before anything moves..."""
IDLE_SPARE = 0.5
"""...and so much longer [s]: statements take time, too."""
SLOW_FACTOR = 2.0
"""With a hot wire a move may take this many times as long as at the lowest feed..."""
RAMP_TIME = 5.0
"""...and so much longer [s]: moves that are short or turn a tool take what their ramps take."""
TRAVEL_SPARE = 1.0
"""Waits for external axes may be so much [s] shorter than what their ways add: texts have rounded speeds."""
ISSUES_SHOWN = 50
"""Issues of one task at most."""


@dataclasses.dataclass(frozen=True)
class _Slot:
    """What tasks do between one motion and the next in a stage. ``moved``: a motion follows. ``segment``:
    that of the motion before, as the text says it, "" for none."""

    stage: int
    steps: Mapping[str, tuple[Step, ...]]
    moved: bool
    segment: str


@dataclasses.dataclass
class _Power:
    """A signal on its way through the slots: whether it is ``on``; since the last motion, which task switched
    it on, and for how long [s] it has been on."""

    on: bool = False
    by: str = ""
    spent: float = 0.0


@rule("verify.power_idle")
def power_idle(context: Context) -> Outcome:
    """With the power of a wire or a spindle on, the arms stand no longer than the problem says that it takes
    to heat up or to run up, or a G-code file waits; nobody is asked anything but about an elastic wire before
    it moves; and no hot wire creeps."""
    issues: list[Issue] = []
    worst = 0.0
    slots = tuple(_slots(context))
    dwells = _dwells(context)
    for signal in sorted({claim.signal.lower(): claim.signal for claim in context.contacts}.values()):
        for tasks in job.controllers(context.problem, context.job.tasks):
            own = frozenset(task.name for task in tasks)
            walk = _Walk(context, signal, own, dwells)
            for slot in slots:
                walk.take(slot)
            issues += [*walk.issues[:ISSUES_SHOWN], *_creeping(context, signal, own)]
            worst = max(worst, walk.worst)
    issues += _unclaimed(context)
    if not context.contacts:
        return Outcome(tuple(issues), nothing="no power")
    return Outcome(tuple(issues), 100.0 * worst, 100.0, "% of the time allowed")


def _unclaimed(context: Context) -> list[Issue]:
    """The cell's signal for a wire, on where no operation has a wire on it."""
    signal = context.problem.cell.controller.wire_signal
    if any(claim.signal.lower() == signal.lower() for claim in context.contacts):
        return []
    what = f"{signal} goes on, and no operation of the problem has anything that it heats or drives"
    return [
        at_step(POWER_IDLE, what, task, step)
        for task in context.job.tasks
        for step in task.steps
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower() and step.value
    ]


def _slots(context: Context) -> Iterator[_Slot]:
    """All slots of the job in the order in which they pass."""
    segment = ""
    for number, stage in enumerate(context.job.stages):
        movers = [task.name for task in context.job.tasks if stage.moves(task.name)]
        rest = {task.name: stage.steps[task.name] for task in context.job.tasks if task.name not in movers}
        if not movers:
            yield _Slot(number, rest, False, segment)
        for group in [movers] if stage.synchronised and movers else [[name] for name in movers]:
            count = max(len(stage.moves(name)) for name in group)
            parts = {name: between(stage.steps[name], count) for name in group}
            for i in range(count + 1):
                steps = {name: tuple(part[i]) for name, part in parts.items()}
                yield _Slot(number, {**steps, **(rest if i == 0 else {})}, i < count, segment)
                segment = _segment(stage, group[0], i) if i < count else segment


def _segment(stage: Stage, task: str, i: int) -> str:
    moves = stage.moves(task)
    return segment_of_name(moves[min(i, len(moves) - 1)].procedure).key


class _Walk:
    """Goes through the slots with one signal of the controller that runs the tasks ``own``."""

    def __init__(
        self, context: Context, signal: str, own: Collection[str], dwells: Mapping[tuple[int, str], float]
    ) -> None:
        self.context, self.signal, self.key, self.dwells = context, signal, signal.lower(), dwells
        self.own = own
        self.tasks = {task.name: task for task in context.job.tasks}
        self.mounted = {n for phase in context.phases for n in range(phase.first, phase.last + 1)}
        self.power = _Power()
        self.issues: list[Issue] = []
        self.worst = 0.0

    def take(self, slot: _Slot) -> None:
        """One slot. What other tasks do counts where it keeps a task waiting that has left the power on."""
        power = self.power
        switches = next((n for n, steps in slot.steps.items() if n in self.own and self._switched(steps)), "")
        since = 0.0
        now = 0.0
        for step in slot.steps.get(switches, ()):
            if isinstance(step, SignalStep) and step.signal.lower() == self.key:
                if step.value and not power.on:
                    since, power.by = now, switches
                elif power.on and not step.value:
                    power.spent += now - since
                    self._judge(slot)
                power.on = bool(step.value)
            elif power.on:
                self._endless(slot, switches, step)
            now += dwell_time([step])
        if power.on:
            for name, steps in slot.steps.items():
                for step in steps if name != switches else ():
                    self._endless(slot, name, step)
            power.spent += max(dwell_time(list(steps)) for steps in slot.steps.values()) - since
            self._judge(slot)
        if slot.moved:
            power.by, power.spent = "", 0.0

    def _switched(self, steps: Sequence[Step]) -> bool:
        return any(isinstance(step, SignalStep) and step.signal.lower() == self.key for step in steps)

    def _judge(self, slot: _Slot) -> None:
        """Whether the power has been on for too long since the last motion."""
        setup = int(self.context.spans.of_stage[slot.stage])
        contacts = self.context.setup_claims[setup].contacts
        heat = (claim.heat_up for claim in contacts if claim.signal.lower() == self.key)
        stated = max(heat, default=0.0) if self.power.by else 0.0
        stated += self.dwells.get((setup, slot.segment), 0.0)
        allowed = IDLE_FACTOR * stated + IDLE_SPARE
        self.worst = max(self.worst, self.power.spent / allowed)
        if self.power.spent <= allowed:
            return
        name, step = _longest(slot)
        what = f"{self.signal} is on for {self.power.spent:g} s while nothing moves; allowed: {allowed:g} s"
        hint = "switch it off before, or wait as long as the problem says"
        issue = at_step(POWER_IDLE, what, self.tasks[name], step, hint)
        self.issues.append(dataclasses.replace(issue, value=self.power.spent, limit=allowed, unit="s"))
        self.power.spent = 0.0

    def _endless(self, slot: _Slot, name: str, step: Step) -> None:
        """A step with the power on that nobody knows the end of."""
        if isinstance(step, MessageStep) and step.confirm:
            if name == self.power.by and slot.stage in self.mounted:
                return  # a wire that is taken up hot, before it moves
            self._fault(name, step, "waits for an answer")
        elif isinstance(step, WaitStep) and step.signal:
            self._fault(name, step, f"waits for {step.signal}")
        elif isinstance(step, WaitStep) and step.seconds is None and step.kind != "WaitRob":
            self._fault(name, step, "waits for as long as is known at run time only")
        elif isinstance(step, ChoiceStep) and (step.repeats or any(_waits(inside) for inside in step.steps)):
            self._fault(name, step, f"loops or waits on {step.condition}")
        elif isinstance(step, ChoiceStep) and _stands(step, self.key):
            self._fault(name, step, f"may stop on {step.condition}")

    def _fault(self, name: str, step: Step, what: str) -> None:
        what = f"{name} {what} while {self.signal} is on"
        self.issues.append(at_step(POWER_IDLE, what, self.tasks[name], step, "switch it off before"))


def _waits(step: Step) -> bool:
    """Whether a step of a branch takes time."""
    if isinstance(step, ChoiceStep):
        return step.repeats or any(_waits(inside) for inside in step.steps)
    return isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm)


def _stands(choice: ChoiceStep, key: str) -> bool:
    """Whether a branch stops the arm or the program and has not switched the signal off before."""
    for step in choice.steps:
        if isinstance(step, SignalStep) and step.signal.lower() == key and not step.value:
            return False
        if isinstance(step, SettingStep) or (isinstance(step, ChoiceStep) and _stands(step, key)):
            return True
    return False


def _longest(slot: _Slot) -> tuple[str, Step | None]:
    found = [
        (step.pause, name, step)
        for name, steps in slot.steps.items()
        for step in steps
        if isinstance(step, WaitStep)
    ]
    _, name, step = max(found, key=lambda item: item[0], default=(0.0, next(iter(slot.steps)), None))
    return name, step


def _dwells(context: Context) -> dict[tuple[int, str], float]:
    """The longest wait [s] that a G-code file asks for at one place, by setup and segment."""
    out: dict[tuple[int, str], float] = {}
    for claim in context.claims:
        if claim.longest_stop is not None:
            segment, seconds = claim.longest_stop
            out[context.setup_of(claim), segment.key] = seconds
    return out


def _creeping(context: Context, signal: str, own: Collection[str]) -> list[Issue]:
    """Moves with a wire that tasks ``own`` have made hot, which take much longer than at the lowest feed."""
    motion = context.motion
    if not len(motion.node_sample):
        return []
    on = motion.on_for(signal, own, motion.time[motion.node_sample] - 0.5 * motion.node_duration) >= 0.0
    issues = []
    for index, setup in enumerate(context.setup_claims):
        if all(claim.signal.lower() != signal.lower() for claim in setup.contacts):
            continue
        least = min((c.lower for c in context.feeds if context.setup_of(c) == index), default=0.0)
        lever = 0.5 * max((c.heated_length for group in setup.groups for c in group), default=0.0)
        here = np.flatnonzero(on & (context.spans.of_stage[motion.node_stage] == index))
        if least <= 0.0 or lever <= 0.0 or not len(here):
            continue
        way = np.max([_ways(context, arm, lever)[here] for arm in motion.tcp], axis=0)
        most = SLOW_FACTOR * way / least + RAMP_TIME
        for k in np.flatnonzero(motion.node_duration[here] > most)[:ISSUES_SHOWN]:
            took = float(motion.node_duration[here[k]])
            what = f"{signal} is on while a move of {mm(way[k]):.2f} mm takes {took:g} s; at the lowest feed "
            what += f"it takes {way[k] / least:.2f} s"
            issue = at_node(POWER_IDLE, what, motion, next(iter(motion.tcp)), int(here[k]))
            issues.append(dataclasses.replace(issue, value=took, limit=float(most[k]), unit="s"))
    return issues


def _ways(context: Context, arm: str, lever: float) -> FloatArray:
    """How far (K,) [m] a tool goes in each move, at most, ``lever`` [m] off its TCP."""
    motion = context.motion
    rows = motion.node_sample
    before = np.concatenate([[0], rows[:-1]])
    step = motion.tcp[arm][rows] - motion.tcp[arm][before]
    x, z, way = (np.linalg.norm(step[:, :3, axis], axis=1) for axis in (0, 2, 3))
    turn = np.maximum(x, z)
    return np.asarray(way + lever * turn)


@rule("verify.meeting_time")
def meeting_time(context: Context) -> Outcome:
    """Where tasks meet they wait for each other without a limit of time, which would end a run whenever
    somebody takes longer to answer. Two controllers wait as long as the problem says: while the other one
    asks somebody no less than for its patience, while it takes axes elsewhere for so long besides."""
    issues = []
    for task in context.job.tasks:
        for point in sync_points(task):
            if point.limited:
                what = (
                    f"{point.kind} {point.ident} ends the run when the other task comes later than its time"
                )
                issues.append(at_step(MEETING_TIME, what, task, point, "leave \\TimeOut out"))
    if context.job.readings is not None and len(context.job.tasks) == 2:
        issues += _answers(context)
    return Outcome(tuple(issues))


def _answers(context: Context) -> Iterator[Issue]:
    """Waits for the other controller that are too short for what it does before, or longer than anything
    takes."""
    readings, handshake = context.job.readings or {}, context.problem.cell.controller.handshake
    tasks = context.job.tasks
    for task, other in (tasks, tasks[::-1]):
        mine, theirs = readings[task.name], readings[other.name]
        asks = _intervals(other, theirs, _asks)
        midway = asks.copy() if of_task(other).restarts is not None else set[int]()
        asks |= _intervals(other, theirs, _moves) - _intervals(task, mine, _moves)
        travels = _travels(context, other, theirs)
        most = max(handshake.patience, handshake.timeout) + 1.0 + _busy(other) + sum(travels.values())
        watched = stages.wiring(context.problem).watches.get(task.name, frozenset())
        for step, interval in _meetings(task, mine, handshake.kind, watched, midway):
            least = handshake.patience if interval in asks else min(handshake.timeout, handshake.patience)
            least += max(travels.get(interval, 0.0) - TRAVEL_SPARE, 0.0)
            if step.seconds is None:
                what = f"{task.name} may wait for {step.signal} for ever; state a limit"
                yield at_step(MEETING_TIME, what, task, step)
            elif not least <= step.seconds <= most:
                what = f"{task.name} waits for {step.signal} for {step.seconds:g} s; "
                what += f"wanted: {least:g} to {most:.0f} s"
                yield at_step(MEETING_TIME, what, task, step, "as the handshake's timeout and patience say")


def _intervals(task: TaskText, reading: Reading, chosen: Callable[[Step], bool]) -> set[int]:
    """Intervals between meetings in which a program has such steps."""
    return {n for n, step in zip(reading.interval, task.steps, strict=True) if chosen(step)}


def _travels(context: Context, task: TaskText, reading: Reading) -> dict[int | None, float]:
    """How long [s] a task takes external axes elsewhere, by intervals between meetings."""
    out: dict[int | None, float] = {}
    for number, step in zip(reading.interval, task.steps, strict=True):
        seconds = context.travels.get(id(step), 0.0)
        if seconds > 0.0:
            out[number] = out.get(number, 0.0) + seconds
    return out


def _meetings(
    task: TaskText, reading: Reading, kind: HandshakeKind, watched: Collection[str], midway: Collection[int]
) -> Iterator[tuple[WaitStep, int | None]]:
    """Waits of the protocol, each with the other program's interval that it may last: what that does before
    it arrives. None where both have arrived, and at the lead's start, when the operator has seen to it.

    ``midway``: meetings in the middle of which the other program asks, so that who follows waits there.
    A look whether the other program runs (an input that is ``watched``) lasts as long as the meeting behind
    it may; whether that stands is seen at the start, when somebody stops it.
    """
    before: SignalStep | None = None
    looks: list[WaitStep] = []
    own = zip(reading.protocol, reading.interval, task.steps, strict=True)
    for step, number in [(step, number) for mine, number, step in own if mine]:
        if isinstance(step, SignalStep):
            before = step
        elif isinstance(step, WaitStep) and step.signal.lower() in watched:
            if step.value:
                looks.append(step)
            else:
                yield step, None
        elif isinstance(step, WaitStep):
            leads = before is not None and before.value == step.value  # it asks, and waits for the answer
            met = kind == "four_phase" and not step.value
            late = number - 1 if leads else number
            held = met and not leads and number in midway
            interval = None if (met and not held) or (leads and late <= 0) else late
            yield from ((one, interval) for one in (*looks, step))
            looks = []


def _asks(step: Step) -> bool:
    return isinstance(step, MessageStep) and step.confirm


def _moves(step: Step) -> bool:
    return isinstance(step, MoveStep)


def _busy(task: TaskText) -> float:
    """How long [s] a task moves and waits by what it states."""
    moves = sum(step.time or 0.0 for step in task.steps if isinstance(step, MoveStep))
    return moves + dwell_time([step for step in task.steps if isinstance(step, WaitStep)])
