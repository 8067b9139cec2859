"""Rules on time that passes while nothing moves.

verify.power_idle: time for which arms stand still while the power of a wire or a spindle is on.
verify.meeting_time: time for which tasks wait where they meet.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

import numpy as np

from planner.claims.handshake import HandshakeKind
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.programs import job, stages
from planner.programs.handshake.automata import ProgramAutomaton
from planner.programs.stages import JobStage, TaskText, sync_points
from planner.programs.steps import (
    ChoiceStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    SettingStep,
    SignalStep,
    WaitStep,
)
from planner.programs.text import segment_of_name
from planner.proof.context import Context
from planner.proof.language_contribution import language_of_task
from planner.proof.replay.logic import dwell_time, steps_between_moves
from planner.proof.rule import RuleOutcome, mm, node_issue, rule, step_issue

POWER_IDLE = "verify.power_idle"
"""Code of the rule on power while nothing moves."""
MEETING_TIME = "verify.meeting_time"
"""Code of the rule on waits at meetings."""
MAX_IDLE_FACTOR = 1.1
"""Ratio of the time with the power on to the stated time that is allowed while nothing moves."""
IDLE_SPARE_S = 0.5
"""Time [s] for which power may be on in addition to :data:`MAX_IDLE_FACTOR`, because statements take time,
too.
"""
MAX_SLOW_FACTOR = 2.0
"""Maximum ratio between the time of a move with a hot wire and the time at the lowest feed."""
RAMP_TIME_S = 5.0
"""Time [s] that a move with a hot wire may take in addition to :data:`MAX_SLOW_FACTOR`, because short moves
and rotations of a tool take the time of their ramps.
"""
TRAVEL_SPARE_S = 1.0
"""Time [s] by which waits for external axes may be shorter than the motion of the axes, because speeds in the
text are rounded.
"""
MAX_ISSUES_SHOWN = 50
"""Maximum number of issues of one task."""


@dataclasses.dataclass(frozen=True)
class _Slot:
    """Steps of the tasks between one move and the next in a stage.

    Attributes:
        stage: Number of the stage.
        steps: Steps of each task by its name.
        motion_follows: Whether a move of the stage follows.
        segment: Key of the segment of the previous move, as the text names it, "" before the first move.
    """

    stage: int
    steps: Mapping[str, tuple[ProgramStep, ...]]
    motion_follows: bool
    segment: str


@dataclasses.dataclass
class _Power:
    """State of a signal while the slots are traversed.

    Attributes:
        on: Whether the signal is on.
        switching_task: Name of the task that has switched it on since the last move, "" if none has.
        on_time: Time [s] for which it has been on since the last move.
    """

    on: bool = False
    switching_task: str = ""
    on_time: float = 0.0


@rule("verify.power_idle")
def power_idle(context: Context) -> RuleOutcome:
    """With the power of a wire or a spindle on, the arms stand no longer than heating up or running up
    takes. The times are stated in the problem, and a G-code file may wait, too. The operator is asked
    nothing, except about an elastic wire before it moves. No hot wire creeps.
    """
    issues: list[Issue] = []
    worst = 0.0
    slots = tuple(_slots(context))
    dwells = _longest_dwells(context)
    for signal in sorted({claim.signal.lower(): claim.signal for claim in context.contacts}.values()):
        for tasks in job.group_by_controller(context.problem, context.job.tasks):
            controller_tasks = frozenset(task.name for task in tasks)
            checker = _PowerWalk(context, signal, controller_tasks, dwells)
            for slot in slots:
                checker.process(slot)
            issues += [*checker.issues[:MAX_ISSUES_SHOWN], *_slow_moves(context, signal, controller_tasks)]
            worst = max(worst, checker.worst)
    issues += _unclaimed_power(context)
    if not context.contacts:
        return RuleOutcome(tuple(issues), nothing="no power")
    return RuleOutcome(tuple(issues), 100.0 * worst, 100.0, "% of the time allowed")


def _unclaimed_power(context: Context) -> list[Issue]:
    """Report the cell's wire signal if it is on but no operation has a wire on it."""
    signal = context.problem.cell.controller.wire_signal
    if any(claim.signal.lower() == signal.lower() for claim in context.contacts):
        return []
    message = f"{signal} is switched on, but no operation of the problem has a wire or drive on it"
    return [
        step_issue(POWER_IDLE, message, task, step)
        for task in context.job.tasks
        for step in task.steps
        if isinstance(step, SignalStep) and step.signal.lower() == signal.lower() and step.value
    ]


def _slots(context: Context) -> Iterator[_Slot]:
    """Yield all slots in order of time.

    N moves give N + 1 slots: before the first move, and after each move. Tasks that move together share
    slots. If tasks move one after the other, each has its own slots. All steps of tasks without moves are in
    the first slot. A stage without moves is one slot.
    """
    segment = ""
    for number, stage in enumerate(context.job.stages):
        movers = [task.name for task in context.job.tasks if stage.moves(task.name)]
        rest = {task.name: stage.steps[task.name] for task in context.job.tasks if task.name not in movers}
        if not movers:
            yield _Slot(number, rest, False, segment)
        for group in [movers] if stage.synchronised and movers else [[name] for name in movers]:
            count = max(len(stage.moves(name)) for name in group)
            parts = {name: steps_between_moves(stage.steps[name], count) for name in group}
            for i in range(count + 1):
                steps = {name: tuple(part[i]) for name, part in parts.items()}
                yield _Slot(number, {**steps, **(rest if i == 0 else {})}, i < count, segment)
                segment = _segment(stage, group[0], i) if i < count else segment


def _segment(stage: JobStage, task: str, i: int) -> str:
    """Return the key of the segment of a task's move ``i`` in a stage, at most of its last move."""
    moves = stage.moves(task)
    return segment_of_name(moves[min(i, len(moves) - 1)].procedure).key


class _PowerWalk:
    """Follows one power signal of one controller through all slots, and collects the issues.

    It sums the time for which the signal is on since the last move.

    Attributes:
        context: The proof.
        signal: Name of the signal.
        key: Name of the signal in lower case.
        dwells: Longest stated wait [s] by the index of the setup and the key of the segment.
        controller_tasks: Names of the controller's tasks.
        tasks: All tasks by name.
        mounted: Numbers of the stages in which a wire joins the arms.
        power: State of the signal.
        issues: Issues that were found.
        worst: Largest time with power as a fraction of the allowed time.
    """

    def __init__(
        self,
        context: Context,
        signal: str,
        controller_tasks: Collection[str],
        dwells: Mapping[tuple[int, str], float],
    ) -> None:
        self.context, self.signal, self.key, self.dwells = context, signal, signal.lower(), dwells
        self.controller_tasks = controller_tasks
        self.tasks = {task.name: task for task in context.job.tasks}
        self.mounted = {n for phase in context.phases for n in range(phase.first, phase.last + 1)}
        self.power = _Power()
        self.issues: list[Issue] = []
        self.worst = 0.0

    def process(self, slot: _Slot) -> None:
        """Process one slot: add the time with power, and report steps that may take any time meanwhile.

        First the steps of the controller's task that switches the signal are processed; without such a task
        there are none. If the signal is on after them, the time is that of the slowest task of the slot,
        because the tasks wait for each other. A move ends the standstill.
        """
        power = self.power
        switching_task = next(
            (
                name
                for name, steps in slot.steps.items()
                if name in self.controller_tasks and self._switched(steps)
            ),
            "",
        )
        switched_on = 0.0
        elapsed = 0.0
        for step in slot.steps.get(switching_task, ()):
            if isinstance(step, SignalStep) and step.signal.lower() == self.key:
                if step.value and not power.on:
                    switched_on, power.switching_task = elapsed, switching_task
                elif power.on and not step.value:
                    power.on_time += elapsed - switched_on
                    self._check_on_time(slot)
                power.on = bool(step.value)
            elif power.on:
                self._check_unbounded(slot, switching_task, step)
            elapsed += dwell_time([step])
        if power.on:
            for name, steps in slot.steps.items():
                for step in steps if name != switching_task else ():
                    self._check_unbounded(slot, name, step)
            power.on_time += max(dwell_time(list(steps)) for steps in slot.steps.values()) - switched_on
            self._check_on_time(slot)
        if slot.motion_follows:
            power.switching_task, power.on_time = "", 0.0

    def _switched(self, steps: Sequence[ProgramStep]) -> bool:
        """Return whether one of the steps sets the signal."""
        return any(isinstance(step, SignalStep) and step.signal.lower() == self.key for step in steps)

    def _check_on_time(self, slot: _Slot) -> None:
        """Report power that has been on for too long since the last move.

        Allowed are the time to heat up or run up, if the signal was switched on since that move, plus the
        wait that a G-code file states in the segment, with a factor and a constant. After an issue the time
        starts again.
        """
        setup = int(self.context.spans.of_stage[slot.stage])
        contacts = self.context.setup_claims[setup].contacts
        heat = (claim.heat_up for claim in contacts if claim.signal.lower() == self.key)
        stated = max(heat, default=0.0) if self.power.switching_task else 0.0
        stated += self.dwells.get((setup, slot.segment), 0.0)
        allowed = MAX_IDLE_FACTOR * stated + IDLE_SPARE_S
        self.worst = max(self.worst, self.power.on_time / allowed)
        if self.power.on_time <= allowed:
            return
        name, step = _longest_wait(slot)
        message = (
            f"{self.signal} is on for {self.power.on_time:g} s while nothing moves; allowed: {allowed:g} s"
        )
        hint = "switch it off before, or wait as long as the problem says"
        issue = step_issue(POWER_IDLE, message, self.tasks[name], step, hint)
        self.issues.append(dataclasses.replace(issue, value=self.power.on_time, limit=allowed, unit="s"))
        self.power.on_time = 0.0

    def _check_unbounded(self, slot: _Slot, name: str, step: ProgramStep) -> None:
        """Report a step of task ``name`` that may take any time, or stop the program, while the power is on.

        These are questions, waits for a signal or for an unknown time (except WaitRob, which waits for the
        arm to stop), and branches that loop, wait or stop. A question by the switching task is allowed while
        a wire joins the arms (``mounted``).
        """
        if isinstance(step, MessageStep) and step.confirm:
            if name == self.power.switching_task and slot.stage in self.mounted:
                return  # an elastic wire is tensioned while hot, before it moves
            self._fault(name, step, "waits for an answer")
        elif isinstance(step, WaitStep) and step.signal:
            self._fault(name, step, f"waits for {step.signal}")
        elif isinstance(step, WaitStep) and step.seconds is None and step.kind != "WaitRob":
            self._fault(name, step, "waits for a time that is known only at run time")
        elif isinstance(step, ChoiceStep) and (
            step.repeats or any(_takes_time(inside) for inside in step.steps)
        ):
            self._fault(name, step, f"loops or waits on {step.condition}")
        elif isinstance(step, ChoiceStep) and _may_stop_with_power(step, self.key):
            self._fault(name, step, f"may stop on {step.condition}")

    def _fault(self, name: str, step: ProgramStep, action: str) -> None:
        """Add an issue about a step in which task ``name`` does an ``action`` while the signal is on."""
        message = f"{name} {action} while {self.signal} is on"
        self.issues.append(step_issue(POWER_IDLE, message, self.tasks[name], step, "switch it off before"))


def _takes_time(step: ProgramStep) -> bool:
    """Return whether a step of a branch takes time: a loop, a wait or a question, in any depth."""
    if isinstance(step, ChoiceStep):
        return step.repeats or any(_takes_time(inside) for inside in step.steps)
    return isinstance(step, WaitStep) or (isinstance(step, MessageStep) and step.confirm)


def _may_stop_with_power(choice: ChoiceStep, key: str) -> bool:
    """Return whether a branch stops the arm or the program before it switches the signal ``key`` off.

    Every setting in a branch counts as a stop. ``key`` is the name of the signal in lower case.
    """
    for step in choice.steps:
        if isinstance(step, SignalStep) and step.signal.lower() == key and not step.value:
            return False
        if isinstance(step, SettingStep) or (
            isinstance(step, ChoiceStep) and _may_stop_with_power(step, key)
        ):
            return True
    return False


def _longest_wait(slot: _Slot) -> tuple[str, ProgramStep | None]:
    """Return the task and the step of the longest wait in a slot, at which an issue is reported.

    If there is no wait, the result is the first task and None.
    """
    waits = [
        (step.pause, name, step)
        for name, steps in slot.steps.items()
        for step in steps
        if isinstance(step, WaitStep)
    ]
    _, name, step = max(waits, key=lambda item: item[0], default=(0.0, next(iter(slot.steps)), None))
    return name, step


def _longest_dwells(context: Context) -> dict[tuple[int, str], float]:
    """Return the longest wait [s] that a G-code file states at one position.

    It is given by the index of the setup and the key of the segment. Power may be on meanwhile.
    """
    out: dict[tuple[int, str], float] = {}
    for claim in context.claims:
        if claim.longest_stop is not None:
            segment, seconds = claim.longest_stop
            out[context.setup_of(claim), segment.key] = seconds
    return out


def _slow_moves(context: Context, signal: str, controller_tasks: Collection[str]) -> list[Issue]:
    """Report moves that take much longer than at the lowest claimed feed while a wire is hot.

    A wire that creeps burns the foam. Only setups whose operations heat a wire by ``signal``, a signal of the
    controller with the tasks ``controller_tasks``, are examined.
    """
    motion = context.motion
    if not len(motion.node_sample):
        return []
    # Flags (K,): whether the signal is on in the middle of each move.
    on = (
        motion.signal_on_time(
            signal, controller_tasks, motion.time[motion.node_sample] - 0.5 * motion.node_duration
        )
        >= 0.0
    )
    issues = []
    for index, setup in enumerate(context.setup_claims):
        if all(claim.signal.lower() != signal.lower() for claim in setup.contacts):
            continue
        min_feed = min((c.lower for c in context.feeds if context.setup_of(c) == index), default=0.0)
        # lever [m]: half of the longest heated wire, the distance of its ends from its middle.
        lever = 0.5 * max((c.heated_length for group in setup.groups for c in group), default=0.0)
        rows = np.flatnonzero(on & (context.spans.of_stage[motion.node_stage] == index))
        if min_feed <= 0.0 or lever <= 0.0 or not len(rows):
            continue
        path = np.max([_path_lengths(context, arm, lever)[rows] for arm in motion.tcp], axis=0)
        max_times = MAX_SLOW_FACTOR * path / min_feed + RAMP_TIME_S
        for k in np.flatnonzero(motion.node_duration[rows] > max_times)[:MAX_ISSUES_SHOWN]:
            duration = float(motion.node_duration[rows[k]])
            message = (
                f"{signal} is on while a move of {mm(path[k]):.2f} mm takes {duration:g} s; at the lowest "
                "feed "
            )
            message += f"it takes {path[k] / min_feed:.2f} s"
            issue = node_issue(POWER_IDLE, message, motion, next(iter(motion.tcp)), int(rows[k]))
            issues.append(dataclasses.replace(issue, value=duration, limit=float(max_times[k]), unit="s"))
    return issues


def _path_lengths(context: Context, arm: str, lever: float) -> FloatArray:
    """Return upper bounds (K,) [m] of the path in each move of points at ``lever`` [m] from the TCP.

    The points lie on the tool's x or z axis. The ends of a move are the samples at its node and at the node
    before. A rotation moves such a point by at most the lever times the change of the axis' unit vector.
    """
    motion = context.motion
    rows = motion.node_sample
    previous = np.concatenate([[0], rows[:-1]])
    step = motion.tcp[arm][rows] - motion.tcp[arm][previous]
    x, z, shift = (np.linalg.norm(step[:, :3, axis], axis=1) for axis in (0, 2, 3))
    rotation = np.maximum(x, z)
    return np.asarray(shift + lever * rotation)


@rule("verify.meeting_time")
def meeting_time(context: Context) -> RuleOutcome:
    """Tasks wait for each other without a time limit where they meet.
    A limit would end a run whenever somebody takes longer to answer. Two controllers wait as long as the
    problem states: at least for its patience while the other one asks somebody, plus the time for which
    the other one moves axes.
    """
    issues = []
    for task in context.job.tasks:
        for point in sync_points(task):
            if point.limited:
                message = (
                    f"{point.kind} {point.ident} has a time limit and ends the run if the other task is late"
                )
                issues.append(step_issue(MEETING_TIME, message, task, point, "remove \\TimeOut"))
    if context.job.automata_by_arm is not None and len(context.job.tasks) == 2:
        issues += _check_handshake_waits(context)
    return RuleOutcome(tuple(issues))


def _check_handshake_waits(context: Context) -> Iterator[Issue]:
    """Report waits for the other controller that are too short, too long, or without a limit.

    A wait must last at least

    - the patience of the handshake, if the other program meanwhile asks its operator, or moves while this
      one does not;
    - otherwise the smaller one of timeout and patience;
    - in both cases plus the time for which the other program moves external axes in that interval.

    It must not last longer than the larger one of timeout and patience, plus 1 s and the time of all moves,
    waits and axis motions of the other program, because nothing takes that long.
    """
    automata, handshake = context.job.automata_by_arm or {}, context.problem.cell.controller.handshake
    tasks = context.job.tasks
    for task, other in (tasks, tasks[::-1]):
        automaton, other_automaton = automata[task.name], automata[other.name]
        # Intervals in which the other program may take as long as the patience: it asks, or it moves and this
        # one does not. midway: meetings at which it asks, if its programs start anew after each stop.
        long_intervals = _intervals_with(other, other_automaton, _asks)
        midway = long_intervals.copy() if language_of_task(other).restarts is not None else set[int]()
        long_intervals |= _intervals_with(other, other_automaton, _moves) - _intervals_with(
            task, automaton, _moves
        )
        travels = _travel_times(context, other, other_automaton)
        max_wait = (
            max(handshake.patience, handshake.timeout) + 1.0 + _busy_time(other) + sum(travels.values())
        )
        watched = stages.controller_wiring(context.problem).running_inputs.get(task.name, frozenset())
        for step, interval in _protocol_waits(task, automaton, handshake.kind, watched, midway):
            min_wait = (
                handshake.patience
                if interval in long_intervals
                else min(handshake.timeout, handshake.patience)
            )
            min_wait += max(travels.get(interval, 0.0) - TRAVEL_SPARE_S, 0.0)
            if step.seconds is None:
                message = f"{task.name} may wait for {step.signal} forever; state a time limit"
                yield step_issue(MEETING_TIME, message, task, step)
            elif not min_wait <= step.seconds <= max_wait:
                message = f"{task.name} waits for {step.signal} for {step.seconds:g} s; "
                message += f"allowed: {min_wait:g} to {max_wait:.0f} s"
                yield step_issue(
                    MEETING_TIME, message, task, step, "see timeout and patience of the handshake"
                )


def _intervals_with(
    task: TaskText, automaton: ProgramAutomaton, chosen: Callable[[ProgramStep], bool]
) -> set[int]:
    """Return the numbers of the intervals between meetings in which a program has a step that is ``chosen``.

    Interval n follows meeting n; interval 0 is before the first meeting.
    """
    return {number for number, step in zip(automaton.interval, task.steps, strict=True) if chosen(step)}


def _travel_times(context: Context, task: TaskText, automaton: ProgramAutomaton) -> dict[int | None, float]:
    """Return the time [s] for which a task moves external axes, by the number of the interval."""
    out: dict[int | None, float] = {}
    for number, step in zip(automaton.interval, task.steps, strict=True):
        seconds = context.travel_times.get(id(step), 0.0)
        if seconds > 0.0:
            out[number] = out.get(number, 0.0) + seconds
    return out


def _protocol_waits(
    task: TaskText,
    automaton: ProgramAutomaton,
    kind: HandshakeKind,
    watched: Collection[str],
    midway: Collection[int],
) -> Iterator[tuple[WaitStep, int | None]]:
    """Yield the waits of the handshake, each with the interval of the other program for which it may last.

    In this interval the other program works before it arrives at the meeting. It is None if both have
    arrived, and at the start of the leading program, for which the operator ensures that the other one is
    ready. A check that the other program runs (an input in ``watched`` at 1) may last as long as the next
    wait. A check that the other program is stopped has no interval, because it is done at the start, when an
    operator stops it.

    Args:
        task: Task that waits.
        automaton: Actions and intervals of its program.
        kind: Kind of the handshake.
        watched: Inputs of running wires, in lower case.
        midway: Meetings during which the other program asks a question, so that the follower waits there.
    """
    last_signal: SignalStep | None = None
    checks: list[WaitStep] = []
    protocol_steps = zip(automaton.protocol, automaton.interval, task.steps, strict=True)
    for step, number in [(step, number) for is_protocol, number, step in protocol_steps if is_protocol]:
        if isinstance(step, SignalStep):
            last_signal = step
        elif isinstance(step, WaitStep) and step.signal.lower() in watched:
            if step.value:
                checks.append(step)
            else:
                yield step, None
        elif isinstance(step, WaitStep):
            # The leading program sets its signal and waits until the other one answers with the same value.
            # is_held: the follower waits for the second phase while the leader asks a question.
            leads = last_signal is not None and last_signal.value == step.value
            both_arrived = kind == "four_phase" and not step.value
            waiting_interval = number - 1 if leads else number
            is_held = both_arrived and not leads and number in midway
            interval = (
                None
                if (both_arrived and not is_held) or (leads and waiting_interval <= 0)
                else waiting_interval
            )
            yield from ((wait, interval) for wait in (*checks, step))
            checks = []


def _asks(step: ProgramStep) -> bool:
    """Return whether a step asks the operator."""
    return isinstance(step, MessageStep) and step.confirm


def _moves(step: ProgramStep) -> bool:
    """Return whether a step is a move."""
    return isinstance(step, MoveStep)


def _busy_time(task: TaskText) -> float:
    """Return the time [s] for which a task moves and waits according to its text."""
    moves = sum(step.time or 0.0 for step in task.steps if isinstance(step, MoveStep))
    return moves + dwell_time([step for step in task.steps if isinstance(step, WaitStep)])
