"""Handshake of two programs over digital signals: meetings, their steps, the drift, and running wires.

This module is independent of robot languages. Work that cannot be done with meetings is refused. Between two
meetings one arm may be ahead of the other. The resulting change of the distance of the two tools is the
drift.

The lead asks and the other program answers, so no line changes before its previous change was answered.
Programs that both set their output and then wait would lose an edge if one of them is late.

Before the first meeting each program reads the other one's running wire at 0 and then at 1: the lead is
started while the other program is stopped, and is itself stopped while the other one checks. A wire that is
cut or stuck is therefore detected before anything moves. Every meeting starts with a check of this wire.

No program switches the running wire: the controller holds it at 1 while its program runs with the motors on.
It is connected to the other controller's stop input and to the interlock of its power. A stop of either side
therefore stops both and switches the power off, whatever the programs do. A cut wire reads 0: not running.
This module also holds texts about these wires for the README of each controller and for the operator.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims import sentences
from planner.claims.handshake import Handshake, SignalWire
from planner.claims.sentences import Sentence
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.languages.writing.layout import TIME_DECIMALS, Drift, JobPrograms, OperationProgram, TaskProgram
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.targets import Targets

_MULTIMOVE_HINT = "use one MultiMove controller for both arms (sync: multimove)"
"""Remedy if two controllers cannot do a job."""


def meeting_rows(stop: BoolArray, every: int) -> BoolArray:
    """Return after which moves the arms meet, (M,).

    They meet after each move that ends in a stop and, counted from the last stop, after every ``every``
    moves.

    Args:
        stop: Whether each move ends in a stop, (M,).
        every: Maximum number of moves from one meeting to the next.
    """
    index = np.arange(len(stop))
    first_after_stop = np.where(np.concatenate([[True], stop[:-1]]), index, 0) if len(stop) else index
    moves_since_stop = index - np.maximum.accumulate(first_after_stop)
    return np.asarray(stop | ((moves_since_stop + 1) % every == 0))


def lengthen_for_stops(
    duration: FloatArray, stop: BoolArray, min_duration: FloatArray, steps: Sequence[FloatArray]
) -> FloatArray:
    """Return the times (M,) [s] of moves with additional stops; longer times are rounded up as written.

    Each move is taken as a cubic in time. From stop to stop, a move over the distance 1 in the
    time 1 has the maximum speed 3/2 and the maximum acceleration 6. With a stop at one end and the mean speed
    at the other these are 4/3 and 4.

    Args:
        duration: Planned times, (M,) [s]; lower bounds of the result.
        stop: Whether each move ends in a stop, (M,).
        min_duration: Times at the maximum allowed speed, (M,) [s].
        steps: For each arm the joint steps (M, 6) divided by the allowed accelerations [s^2].
    """
    # number of ends of each move (0, 1 or 2) at which the arm is at rest, index of the factors below
    stop_count = (
        stop.astype(np.int64) + np.concatenate([[True], stop[:-1]]) if len(stop) else np.zeros(0, np.int64)
    )
    out = np.maximum(duration, np.array([1.0, 4.0 / 3.0, 1.5])[stop_count] * min_duration)
    for step in steps:
        out = np.maximum(
            out, np.sqrt(np.array([0.0, 4.0, 6.0])[stop_count] * np.abs(step).max(axis=1, initial=0.0))
        )
    scale = 10.0**TIME_DECIMALS
    changed = out > duration
    return np.asarray(np.where(changed, np.ceil(out * scale - 1e-6) / scale, duration))


def handshake_refusals(problem: Problem, targets_by_operation: Sequence[Targets]) -> tuple[Issue, ...]:
    """Return issues of operations that two controllers cannot do by handshake (``post.handshake_process``).

    One arm may be a whole move ahead of the other. Three kinds of work do not allow that: a wire that joins
    the arms; a block that one arm holds while the other works on it; and a minimum feed at a target at which
    the arms stop to meet.

    Args:
        problem: The problem.
        targets_by_operation: Targets of each operation.
    """
    issues = []
    for i, (operation, targets) in enumerate(zip(problem.operations, targets_by_operation, strict=False)):
        if targets.coupled:
            message = (
                f"operation {operation.name}: a wire joins {' and '.join(targets.arms)}, whose controllers "
                "share only digital signals; one arm may be a whole step ahead of the other, which bends the "
                "wire out of its shape, kinks it or tears it"
            )
            issues.append(Issue("post.handshake_process", message, index=i, hint=_MULTIMOVE_HINT))
        holder = problem.setup_of(i).stock.held_by
        carried = any(frame.startswith("held:") for frame in targets.frame.values())
        if len(targets.arms) > 1 and (carried or holder in targets.arms):
            message = (
                f"operation {operation.name}: {holder or 'an arm'} moves the block that it holds while the "
                "other arm works on it, and their controllers share only digital signals; one arm may be a "
                "whole step ahead of the other, so the tool would leave its path on the block"
            )
            issues.append(Issue("post.handshake_process", message, index=i, hint=_MULTIMOVE_HINT))
        target_index = _first_stop_with_min_feed(targets, problem.cell.controller.handshake.every)
        if target_index is not None:
            message = (
                f"operation {operation.name}: the arms stop at {targets.name(target_index)}, where their "
                "controllers meet or one arm stands still, but a minimum feed is required there"
            )
            hint = f"lower feed_min_mm_s there, or {_MULTIMOVE_HINT}"
            issues.append(Issue("post.handshake_process", message, index=i, hint=hint))
    return tuple(issues)


def _first_stop_with_min_feed(targets: Targets, every: int) -> int | None:
    """Return the index of the first target at which a stop of the arms conflicts with a minimum feed.

    The arms stop after every ``every`` moves, where they meet, and before and after a move in which one of
    them stands still. The result is None if there is no conflict. Stops that the targets require themselves,
    and the first and last target, do not count.
    """
    if len(targets.arms) < 2 or targets.run_up is None or targets.count < 3:
        return None
    stops = meeting_rows(targets.stop[1:], every)[:-1]
    for pose in targets.pose.values():
        still = np.all(np.diff(pose, axis=0) == 0.0, axis=(1, 2))
        stops |= still[1:] | still[:-1]
    requires_feed = (targets.feed_min[1:-1] > 0.0) | (targets.feed_min[2:] > 0.0)
    conflicts = np.flatnonzero(stops & ~targets.stop[1:-1] & requires_feed)
    return int(conflicts[0]) + 1 if len(conflicts) else None


DRIFT_SAMPLES: Final = 8
"""Number of sampled instants on each move of one arm, before its end.

For the other arm the extremum over all instants is exact.
"""
_DENSE_INSTANTS: Final = 100
"""Maximum number of samples of a long interval between meetings, but at least one on each move."""
_MAX_PAIRS: Final = 500_000
"""Maximum number of pairs of a sample and a move in one array operation; bounds the memory."""


def distance_change(first: FloatArray, second: FloatArray, meets: IntArray) -> FloatArray:
    """Return the maximum change (M,) [m] of the distance of two points if one arm is ahead of the other.

    Between two meetings each arm may be at any instant of the interval. With one point at instant s and the
    other at instant t the change is | |a(s) - b(t)| - |a(s) - b(s)| |. Its maximum over t is exact: the
    distance of a point from straight segments is smallest at a foot point or an end, and largest at an end. s
    takes :data:`DRIFT_SAMPLES` + 1 samples of every move, including its ends, and fewer in long intervals.

    Args:
        first: Positions of one point, (M + 1, 3) [m], connected by straight segments of equal times.
        second: Positions of the other point in the same frame, (M + 1, 3) [m].
        meets: Nonzero if the arms meet after the move, (M,).

    Returns:
        The maximum in the interval to which each move belongs, (M,) [m].
    """
    count = len(meets)
    out = np.zeros(count)
    ends = np.flatnonzero(meets != 0)
    if not count or not len(ends) or ends[-1] != count - 1:
        ends = np.append(ends, count - 1) if count else ends
    interval_starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)
    lengths = ends + 1 - interval_starts
    # intervals of equal length are computed together, in batches that fit into memory
    for length in np.unique(lengths).tolist():
        batch_size = max(1, _MAX_PAIRS // (length * length * (DRIFT_SAMPLES + 1)))
        starts_of_length = interval_starts[lengths == length]
        for batch_start in range(0, len(starts_of_length), batch_size):
            starts = starts_of_length[batch_start : batch_start + batch_size]
            index = starts[:, None] + np.arange(length + 1)
            first_points, second_points = first[index], second[index]
            max_change = np.maximum(
                _max_distance_change(first_points, second_points),
                _max_distance_change(second_points, first_points),
            )
            out[index[:, :-1]] = max_change[:, None]
    return out


def _max_distance_change(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the maximum change (G,) [m] of the distance of two points in G intervals of L moves each.

    ``a`` (G, L + 1, 3) [m] is taken at sampled instants, ``b`` (G, L + 1, 3) [m] at all instants.
    """
    samples = max(1, min(DRIFT_SAMPLES, _DENSE_INSTANTS // (a.shape[1] - 1)))
    fractions = np.linspace(0.0, 1.0, samples + 1)[:, None]

    def sample(x: FloatArray) -> FloatArray:
        points = x[:, :-1, None] + fractions * (x[:, 1:, None] - x[:, :-1, None])
        return np.asarray(points.reshape(len(x), -1, 3))

    sampled, partner_at_same_instant = sample(a), sample(b)
    planned_distance = np.linalg.norm(sampled - partner_at_same_instant, axis=2)
    offset = sampled[:, :, None] - b[:, None, :-1]  # (G, S, L, 3) from the starts of the other arm's moves
    step = (b[:, 1:] - b[:, :-1])[:, None]
    square = np.maximum(np.sum(step * step, axis=3), 1e-30)
    # foot point of a(s) on each segment of b, clipped to its ends
    foot = np.clip(np.sum(offset * step, axis=3) / square, 0.0, 1.0)
    min_distance = np.linalg.norm(offset - foot[..., None] * step, axis=3).min(axis=2)
    max_distance = np.linalg.norm(sampled[:, :, None] - b[:, None], axis=3).max(axis=2)
    return np.asarray(
        np.maximum(planned_distance - min_distance, max_distance - planned_distance).max(axis=1)
    )


def operation_drifts(
    plan: Plan, setups: Mapping[int, Setup], programs: Sequence[Mapping[str, OperationProgram]]
) -> tuple[Drift, ...]:
    """Return the drift of the TCP distance in every operation in which both arms move.

    Args:
        plan: The plan.
        setups: Setup of each operation, by index.
        programs: Programs of each operation, by arm.
    """
    out = []
    for i, (operation, parts) in enumerate(zip(plan.operations, programs, strict=True)):
        move_tables = [part.moves for part in parts.values() if part.moves is not None]
        meets = next(iter(parts.values())).meets
        if len(move_tables) != 2 or not len(meets):
            continue
        stock_pose = plan.stock_poses[setups[i].number - 1]
        poses = operation.targets.poses(operation.values)
        start = {
            arm: (stock_pose @ pose[0] if operation.targets.frame[arm] == "stock" else pose[0])[:3, 3]
            for arm, pose in poses.items()
        }
        tcp_paths = []
        for arm in operation.targets.arms:
            moves = parts[arm].moves
            if moves is None:
                continue
            position = 1e-3 * moves.position
            if moves.frame == "stock":
                position = position @ stock_pose[:3, :3].T + stock_pose[:3, 3]
            tcp_paths.append(np.concatenate([start[arm][None], position]))
        change = distance_change(tcp_paths[0], tcp_paths[1], meets)
        worst_index = int(np.argmax(change))
        segments = next(iter(parts.values())).segments
        out.append(
            Drift(operation.name, change, float(change[worst_index]), worst_index, segments[worst_index])
        )
    return tuple(out)


def drift_issues(job: JobPrograms) -> tuple[Issue, ...]:
    """Return a note (``post.handshake_drift``) on the drift of each operation in which both arms move."""
    return tuple(
        Issue(
            "post.handshake_drift",
            format_message("post.handshake_drift", operation=drift.name, drift=drift_sentence(drift)),
            Severity.NOTE,
            target=f"{drift.segment}, move {drift.row + 1}",
            value=drift.worst * 1e3,
            unit="mm",
            hint="meet at more moves (controller: {handshake: {every: 1}}), shorten the moves, or use one "
            "MultiMove controller (sync: multimove)",
        )
        for drift in job.drifts
    )


def drift_sentence(drift: Drift) -> str:
    """Return the maximum and the median of a drift as a clause of a message."""
    return (
        "with one arm ahead of the other between two meetings the distance of the TCPs differs from the "
        f"planned one by up to {drift.worst * 1e3:.3f} mm, at move {drift.row + 1} ({drift.segment}); on "
        f"half of the moves by {float(np.median(drift.change)) * 1e3:.3f} mm at most"
    )


PARTNER_NOT_RUNNING: Final = "The program of arm {other} does not run: {input} is 0."
"""Shown while a program waits for the other one to run."""
PARTNER_STILL_RUNNING: Final = (
    "Stop the program of arm {other}: {input} is 1. If it is stopped, the wire is stuck."
)
"""Shown while a program waits for the other one to stop."""

RESTART_FROM_MAIN: Final = "PP to main in all tasks (ABB), or a reset (KUKA)"
"""How to start a program from its beginning."""
_OWN_TORCH_SECTION: Final = """
After a stop while the torch burned restart the program of arm {other} from its beginning as well:
its controller does not know of the torch, and a resumed program would meet this one at the wrong
place.
"""
_PARTNER_TORCH_SECTION: Final = """
{torches} of arm {other} lights a torch. After a stop while it burned the program of arm {other}
restarts from its beginning, and so must this one: {anew}.
Nothing here prevents it from resuming: this controller does not know of the torch, and a resumed
program would meet that one at the wrong place.
"""


def torch_restart_section(torches: Mapping[str, Sequence[str]], arm: str) -> str:
    """Return the section of a controller's README on stops at which a torch burned.

    Args:
        torches: Signals that light a torch, by arm.
        arm: Arm of the controller.
    """
    other = next(name for name in torches if name != arm)
    out = _OWN_TORCH_SECTION.format(other=other) if torches[arm] else ""
    if torches[other]:
        out += _PARTNER_TORCH_SECTION.format(
            torches=" and ".join(torches[other]), other=other, anew=RESTART_FROM_MAIN
        )
    return out


def running_wires(wires: Sequence[SignalWire], arm: str) -> tuple[SignalWire, SignalWire]:
    """Return the running wire that leaves an arm's controller, and the one that arrives there.

    Args:
        wires: Both running wires.
        arm: The arm.
    """
    outgoing = next(wire for wire in wires if wire.source == arm)
    incoming = next(wire for wire in wires if wire.sink == arm)
    return outgoing, incoming


@dataclasses.dataclass(frozen=True)
class SetLine:
    """Sets the program's output to the level ``value``, 0 or 1."""

    value: int


@dataclasses.dataclass(frozen=True)
class AwaitLine:
    """Waits at most ``seconds`` [s] until the program's input has the level ``value``."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class AwaitRunning:
    """Waits at most ``seconds`` [s] until the other controller's running wire has the level ``value``."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class StopAndAsk:
    """Stops the program, so that its running wire goes to 0; after the next start it asks ``text``."""

    text: str


@dataclasses.dataclass(frozen=True)
class AskOperator:
    """Shows ``text`` and waits for the operator's confirmation."""

    text: str


@dataclasses.dataclass(frozen=True)
class ShowText:
    """Shows ``text`` to the operator."""

    text: str


@dataclasses.dataclass(frozen=True)
class CommentStep:
    """Has no effect; the program contains ``text`` as a comment."""

    text: str


PartnerStep = SetLine | AwaitLine | AwaitRunning | StopAndAsk | AskOperator | ShowText | CommentStep
"""One step of the handshake with the other program; each language writes it as statements."""


@dataclasses.dataclass(frozen=True)
class HandshakeSide:
    """The handshake of two programs as one of them sees it.

    Attributes:
        handshake: Signals and times of the handshake.
        arm: Name of this arm.
        other: Name of the other arm.
        lead: Whether this side leads, as the first task does: it changes its line first.
        meets: Number of meetings of the job.
    """

    handshake: Handshake
    arm: str
    other: str
    lead: bool
    meets: int

    @staticmethod
    def of(task: TaskProgram, job: JobPrograms) -> "HandshakeSide | None":
        """Return the side of a task; None if one controller moves all arms.

        Args:
            task: The task.
            job: All tasks.
        """
        if job.handshake is None:
            return None
        other = next(item.arm.name for item in job.tasks if item.number != task.number)
        return HandshakeSide(job.handshake, task.arm.name, other, task.number == 1, job.meets)

    def phases(self, number: int) -> tuple[int, ...]:
        """Return the levels that both lines take in turn at meeting ``number``, from 1."""
        return (number % 2,) if self.handshake.kind == "toggle" else (1, 0)

    def meeting(self, number: int, wait: float) -> list[PartnerStep]:
        """Return the steps of a meeting: check that the other program runs, then change the lines.

        The lead sets its line and waits for the other's, the other side waits first.

        Args:
            number: Number of the meeting, from 1.
            wait: Timeout of each wait [s].
        """
        out: list[PartnerStep] = [AwaitRunning(1, wait)]
        for phase in self.phases(number):
            exchange: list[PartnerStep] = [SetLine(phase), AwaitLine(phase, wait)]
            out += exchange if self.lead else exchange[::-1]
        return out

    def meeting_after_solo(self, number: int, seconds: float) -> list[PartnerStep]:
        """Return the steps of a meeting before which the other arm may move alone or ask the operator.

        Args:
            number: Number of the meeting, from 1.
            seconds: Planned time of the other arm's own moves [s].
        """
        return self.meeting(number, self.handshake.patience + math.ceil(seconds))

    def meeting_after_move(self, number: int) -> list[PartnerStep]:
        """Return the steps of a meeting after a move of both arms."""
        return self.meeting(number, self.handshake.timeout)

    def meeting_kinds(self, task: TaskProgram) -> dict[tuple[int, ...], int]:
        """Return the sequences of phases that occur after the task's moves, each with one meeting number."""
        numbers = np.concatenate([operation.meets for operation in task.operations])
        return {self.phases(number): number for number in np.unique(numbers[numbers > 0]).tolist()}

    def start_steps(self, earlier: Sentence, question: str) -> list[PartnerStep]:
        """Return the first steps of the program, up to the first meeting.

        Each program sets its line to 0 and checks the other's. It sees the other program stopped and, at the
        first meeting, running.

        Args:
            earlier: Question whether a program of an earlier run still runs at the other controller.
            question: Question that the lead asks the operator before the start.
        """
        timeout = self.handshake.timeout
        earlier_question = AskOperator(earlier.format(other=self.other))
        out: list[PartnerStep] = [earlier_question, SetLine(0), AwaitRunning(0, timeout)]
        wait = timeout if self.lead else self.handshake.patience
        if self.lead:
            ready = sentences.PARTNER_READY.format(other=self.other, arm=self.arm, start=question)
            out += [
                ShowText(sentences.START_PARTNER.format(other=self.other)),
                StopAndAsk(ready),
                AwaitLine(0, wait),
            ]
        else:
            out += [AwaitLine(0, wait), ShowText(sentences.READY_TO_MEET.format(other=self.other))]
        return [*out, CommentStep("First meeting: both programs run."), *self.meeting(1, wait)]

    def end_steps(self) -> list[PartnerStep]:
        """Return the last steps of the program, which set both lines to 0, unless they are 0 already."""
        if self.handshake.kind == "four_phase" or self.meets % 2 == 0:
            return []
        return [CommentStep("Last meeting: both lines are 0."), *self.meeting_after_solo(self.meets + 1, 0.0)]

    @property
    def timeout_text(self) -> str:
        """Text that a program shows after a wait for the other one that timed out."""
        return sentences.UNANSWERED.format(other=self.other)

    def wrong_level_text(self, value: int) -> str:
        """Return the text that a program shows if the running wire did not reach level ``value`` in time."""
        text = PARTNER_NOT_RUNNING if value else PARTNER_STILL_RUNNING
        return text.format(other=self.other, input=self.handshake.of(self.arm).partner_running)

    def header(self) -> tuple[str, str]:
        """Return two paragraphs for the header of the program: on the signals, and on the wires."""
        signals, kind = self.handshake.of(self.arm), self.handshake.kind.replace("_", "-")
        role = "leads" if self.lead else "follows"
        wires = " ".join(
            f"Wire {wire.output} of arm {wire.source} to {wire.input} of arm {wire.sink}."
            for arms in [(self.arm, self.other)]
            for wire in (*self.handshake.meeting_wires(arms), *self.handshake.running_wires(arms))
        )
        every = "every move" if self.handshake.every == 1 else f"every {self.handshake.every} moves"
        return (
            f"Meets arm {self.other}, on a separate controller, by {kind} handshake at {every}: sets "
            f"{signals.output}, reads {signals.input}, and {role}. {signals.partner_running} is 1 while the "
            f"program of arm {self.other} runs; when it falls, this arm stops and its power goes off. "
            f"{signals.running} is the corresponding output.",
            wires,
        )
