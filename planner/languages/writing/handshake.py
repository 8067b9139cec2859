"""Handshake of two programs over digital signals: where they meet, how, the drift, running wires.

No language of robots stands here. Work that cannot be done by meetings is refused. Between two
meetings one arm may be ahead of the other: what that does to the distance of two tools is the
drift.

The lead asks and the other one answers, so no line changes before its last change was answered:
programs that both set their output and then wait lose an edge when one of them is late.

Each program sees the other one's running wire at 0 and then at 1 before the first meeting: the lead
is started while the other one stands, and stands itself while the other one looks. So a wire that
is cut or stuck is found before anything moves. Every meeting begins with a look at it.

No program switches the running wire: the controller holds it at 1 while its program runs with the
motors on. It leads into the other one's stop input and into the interlock of its power, so that a
stop of either side stops both and takes the power, whatever the programs do. A wire that is cut
says 0: not running. What each controller's configuration needs for it beside its program, and what
the operator reads of it, is here.
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
from planner.issues import Issue, Severity
from planner.languages.writing.layout import TIME_DECIMALS, Drift, Job, OperationProgram, TaskProgram
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.targets import Targets

_MULTIMOVE_HINT = "use one MultiMove controller for both arms (sync: multimove)"
"""What to do where two controllers cannot do a job."""


def meeting_rows(stop: BoolArray, every: int) -> BoolArray:
    """Whether (M,) the arms meet behind each move: at all stops, and at every ``every`` moves since the last
    one."""
    rows = np.arange(len(stop))
    begins = np.where(np.concatenate([[True], stop[:-1]]), rows, 0) if len(stop) else rows
    since = rows - np.maximum.accumulate(begins)
    return np.asarray(stop | ((since + 1) % every == 0))


def stretched(
    duration: FloatArray, stop: BoolArray, least: FloatArray, steps: Sequence[FloatArray]
) -> FloatArray:
    """Times (M,) [s] of moves that stop at ``stop`` (M,) where they were planned to run through, rounded up
    as written; never below ``duration`` (M,).

    From stop to stop by a cubic a move of the mean speed 1 has the highest speed 3/2 and, in the time 1, the
    highest acceleration 6; with a stop at one end and the mean speed at the other it is 4/3 and 4. ``least``
    (M,) [s]: the time at the highest speed allowed; ``steps``: for each arm the joints' steps (M, 6) over
    their accelerations allowed [s^2].
    """
    ends = stop.astype(np.int64) + np.concatenate([[True], stop[:-1]]) if len(stop) else np.zeros(0, np.int64)
    out = np.maximum(duration, np.array([1.0, 4.0 / 3.0, 1.5])[ends] * least)
    for step in steps:
        out = np.maximum(
            out, np.sqrt(np.array([0.0, 4.0, 6.0])[ends] * np.abs(step).max(axis=1, initial=0.0))
        )
    unit = 10.0**TIME_DECIMALS
    changed = out > duration
    return np.asarray(np.where(changed, np.ceil(out * unit - 1e-6) / unit, duration))


def handshake_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Operations in which one arm a step ahead of the other would break something
    (``post.handshake_process``)."""
    issues = []
    for i, (operation, targets) in enumerate(zip(problem.operations, made, strict=False)):
        if targets.coupled:
            what = (
                f"operation {operation.name}: a wire joins {' and '.join(targets.arms)}, whose controllers "
                "share digital signals only; one arm may be a whole step ahead of the other, which bends the "
                "wire out of its shape, kinks it or tears it"
            )
            issues.append(Issue("post.handshake_process", what, index=i, hint=_MULTIMOVE_HINT))
        holder = problem.setup_of(i).stock.held_by
        carried = any(frame.startswith("held:") for frame in targets.frame.values())
        if len(targets.arms) > 1 and (carried or holder in targets.arms):
            what = (
                f"operation {operation.name}: {holder or 'an arm'} moves the block that it holds while the "
                "other arm works on it, and their controllers share digital signals only; one arm may be a "
                "whole step ahead of the other, so the tool would leave its path on the block"
            )
            issues.append(Issue("post.handshake_process", what, index=i, hint=_MULTIMOVE_HINT))
        row = _halted(targets, problem.cell.controller.handshake.every)
        if row is not None:
            what = (
                f"operation {operation.name}: the arms stop at {targets.name(row)}, where their controllers "
                "meet or one arm stands still, and a least feed is asked for there"
            )
            hint = f"lower feed_min_mm_s there, or {_MULTIMOVE_HINT}"
            issues.append(Issue("post.handshake_process", what, index=i, hint=hint))
    return tuple(issues)


def _halted(targets: Targets, every: int) -> int | None:
    """The first target at which arms that meet at every ``every`` moves stop against a required least
    feed."""
    if len(targets.arms) < 2 or targets.run_up is None or targets.count < 3:
        return None
    halts = meeting_rows(targets.stop[1:], every)[:-1]
    for pose in targets.pose.values():
        still = np.all(np.diff(pose, axis=0) == 0.0, axis=(1, 2))
        halts |= still[1:] | still[:-1]
    asked = (targets.feed_min[1:-1] > 0.0) | (targets.feed_min[2:] > 0.0)
    rows = np.flatnonzero(halts & ~targets.stop[1:-1] & asked)
    return int(rows[0]) + 1 if len(rows) else None


DRIFT_SAMPLES: Final = 8
"""Instants looked at on each move of the arm that is in question; the other arm's are all looked at."""
_DENSE_INSTANTS: Final = 100
"""Instants of a long interval, if it has not more moves."""
_PAIRS_AT_ONCE: Final = 500_000
"""Pairs of an instant and a move that are worked on at once."""


def distance_change(first: FloatArray, second: FloatArray, meets: IntArray) -> FloatArray:
    """The most (M,) [m] by which the distance of two points differs from the planned one while the arms are
    at any instants of the same interval between meetings.

    ``first``, ``second`` (M + 1, 3) [m]: stations of both points in one frame, which they go straight between
    in equal times; ``meets`` (M,): not 0 where they meet behind the move. With one point at its instant s and
    the other at any instant t of the interval the change is | |a(s) - b(t)| - |a(s) - b(s)| |. Over t it is
    exact (the distance of a point to straight pieces is least at a foot or an end, largest at an end); s
    takes :data:`DRIFT_SAMPLES` + 1 instants of every move, its ends among them, and fewer in long intervals.
    """
    count = len(meets)
    out = np.zeros(count)
    ends = np.flatnonzero(meets != 0)
    if not count or not len(ends) or ends[-1] != count - 1:
        ends = np.append(ends, count - 1) if count else ends
    begins = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)
    lengths = ends + 1 - begins
    for length in np.unique(lengths).tolist():
        share = max(1, _PAIRS_AT_ONCE // (length * length * (DRIFT_SAMPLES + 1)))
        group = begins[lengths == length]
        for low in range(0, len(group), share):
            begin = group[low : low + share]
            rows = begin[:, None] + np.arange(length + 1)
            a, b = first[rows], second[rows]
            worst = np.maximum(_ahead(a, b), _ahead(b, a))
            out[rows[:, :-1]] = worst[:, None]
    return out


def _ahead(a: FloatArray, b: FloatArray) -> FloatArray:
    """The largest change (G,) for the stations (G, L + 1, 3) of G intervals, ``a`` at sampled instants."""
    samples = max(1, min(DRIFT_SAMPLES, _DENSE_INSTANTS // (a.shape[1] - 1)))
    share = np.linspace(0.0, 1.0, samples + 1)[:, None]

    def along(x: FloatArray) -> FloatArray:
        points = x[:, :-1, None] + share * (x[:, 1:, None] - x[:, :-1, None])
        return np.asarray(points.reshape(len(x), -1, 3))

    here, there = along(a), along(b)
    planned = np.linalg.norm(here - there, axis=2)
    offset = here[:, :, None] - b[:, None, :-1]  # (G, S, L, 3) to the beginnings of the other one's moves
    step = (b[:, 1:] - b[:, :-1])[:, None]
    square = np.maximum(np.sum(step * step, axis=3), 1e-30)
    foot = np.clip(np.sum(offset * step, axis=3) / square, 0.0, 1.0)
    near = np.linalg.norm(offset - foot[..., None] * step, axis=3).min(axis=2)
    far = np.linalg.norm(here[:, :, None] - b[:, None], axis=3).max(axis=2)
    return np.asarray(np.maximum(planned - near, far - planned).max(axis=1))


def drifts(
    plan: Plan, setups: Mapping[int, Setup], programs: Sequence[Mapping[str, OperationProgram]]
) -> tuple[Drift, ...]:
    """The drift of every operation in which both arms move."""
    out = []
    for i, (operation, parts) in enumerate(zip(plan.operations, programs, strict=True)):
        moving = [part.track for part in parts.values() if part.track is not None]
        meets = next(iter(parts.values())).meets
        if len(moving) != 2 or not len(meets):
            continue
        place = plan.places[setups[i].number - 1]
        poses = operation.targets.poses(operation.values)
        start = {
            arm: (place @ pose[0] if operation.targets.frame[arm] == "stock" else pose[0])[:3, 3]
            for arm, pose in poses.items()
        }
        ways = []
        for arm in operation.targets.arms:
            track = parts[arm].track
            if track is None:
                continue
            position = 1e-3 * track.position
            if track.frame == "stock":
                position = position @ place[:3, :3].T + place[:3, 3]
            ways.append(np.concatenate([start[arm][None], position]))
        moved = distance_change(ways[0], ways[1], meets)
        row = int(np.argmax(moved))
        segments = next(iter(parts.values())).segments
        out.append(Drift(operation.name, moved, float(moved[row]), row, segments[row]))
    return tuple(out)


def drift_issues(job: Job) -> tuple[Issue, ...]:
    """What the user should know of the drift (``post.handshake_drift``), a note for each operation."""
    return tuple(
        Issue(
            "post.handshake_drift",
            f"operation {drift.name}: {drift_sentence(drift)}",
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
    """The drift in words."""
    return (
        "with one arm ahead of the other between two meetings the distance of the TCPs differs from the "
        f"planned one by up to {drift.worst * 1e3:.3f} mm, at move {drift.row + 1} ({drift.segment}); on "
        f"half of the moves by {float(np.median(drift.change)) * 1e3:.3f} mm at most"
    )


PARTNER_STANDS: Final = "The program of arm {other} does not run: {input} is 0."
"""Shown while a program waits for the other one to run."""
PARTNER_RUNS: Final = "Stop the program of arm {other}: {input} is 1. If it stands, the wire is stuck."
"""Shown while a program waits for the other one to stop."""

BEGIN_ANEW: Final = "PP to main in all tasks (ABB), or a reset (KUKA)"
"""How a program begins anew."""
_BURNED_HERE: Final = """
Where the torch burned at a stop the program of arm {other} begins anew as well: its controller knows
nothing of the torch, and a program that goes on there would meet this one at the wrong place.
"""
_BURNED_THERE: Final = """
{torches} of arm {other} lights a torch. Behind a stop while it burned the program of arm {other}
begins anew, and so must this one: {anew}. Nothing
here keeps it from going on: this controller knows nothing of the torch, and a program that goes on
would meet that one at the wrong place.
"""


def burned_anew(lit: Mapping[str, Sequence[str]], arm: str) -> str:
    """What the notes for the controller of an arm say of a stop at which a torch burned; ``lit``: the
    signals that light one, by arm."""
    other = next(name for name in lit if name != arm)
    out = _BURNED_HERE.format(other=other) if lit[arm] else ""
    if lit[other]:
        out += _BURNED_THERE.format(torches=" and ".join(lit[other]), other=other, anew=BEGIN_ANEW)
    return out


def running_wires(wires: Sequence[SignalWire], arm: str) -> tuple[SignalWire, SignalWire]:
    """The running wire that leaves an arm's controller, and the one that comes in."""
    return next(w for w in wires if w.source == arm), next(w for w in wires if w.sink == arm)


@dataclasses.dataclass(frozen=True)
class SetLine:
    """The own output takes the level ``value``, 0 or 1."""

    value: int


@dataclasses.dataclass(frozen=True)
class AwaitLine:
    """Wait until the own input has the level ``value``, for ``seconds`` [s] at most."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class AwaitRunning:
    """Wait until the other controller's running wire has the level ``value``, for ``seconds`` [s] at most."""

    value: int
    seconds: float


@dataclasses.dataclass(frozen=True)
class Halt:
    """The program stops by itself, so that the running wire falls; started again, it asks ``text``."""

    text: str


@dataclasses.dataclass(frozen=True)
class Ask:
    """The operator reads ``text`` and confirms."""

    text: str


@dataclasses.dataclass(frozen=True)
class Tell:
    """The operator can read ``text``."""

    text: str


@dataclasses.dataclass(frozen=True)
class Note:
    """A comment."""

    text: str


PartnerStep = SetLine | AwaitLine | AwaitRunning | Halt | Ask | Tell | Note


@dataclasses.dataclass(frozen=True)
class Partner:
    """One side of the handshake: ``other`` is the other arm's name; the first task leads."""

    handshake: Handshake
    arm: str
    other: str
    lead: bool
    meets: int

    @staticmethod
    def of(task: TaskProgram, job: Job) -> "Partner | None":
        """The side of a task; None where one controller moves all."""
        if job.handshake is None:
            return None
        other = next(item.arm.name for item in job.tasks if item.number != task.number)
        return Partner(job.handshake, task.arm.name, other, task.number == 1, job.meets)

    def phases(self, number: int) -> tuple[int, ...]:
        """Levels that the lines take, one after the other, at the meeting ``number`` [from 1]."""
        return (number % 2,) if self.handshake.kind == "toggle" else (1, 0)

    def meeting(self, number: int, wait: float) -> list[PartnerStep]:
        """The steps of a meeting, which waits ``wait`` [s] at most: the other program runs, the lines."""
        out: list[PartnerStep] = [AwaitRunning(1, wait)]
        for phase in self.phases(number):
            turn: list[PartnerStep] = [SetLine(phase), AwaitLine(phase, wait)]
            out += turn if self.lead else turn[::-1]
        return out

    def meet(self, number: int, seconds: float) -> list[PartnerStep]:
        """A meeting at which the other arm may have moved alone for ``seconds`` or asked the operator."""
        return self.meeting(number, self.handshake.patience + math.ceil(seconds))

    def step(self, number: int) -> list[PartnerStep]:
        """A meeting behind a move at which both arms move."""
        return self.meeting(number, self.handshake.timeout)

    def kinds(self, task: TaskProgram) -> dict[tuple[int, ...], int]:
        """{phases: a number} of the meetings behind the task's moves."""
        numbers = np.concatenate([operation.meets for operation in task.operations])
        return {self.phases(n): n for n in np.unique(numbers[numbers > 0]).tolist()}

    def start(self, earlier: Sentence, ask: str) -> list[PartnerStep]:
        """Return what the program begins with: lines down and seen so, the other program seen to stand, then
        to run, first meeting.

        Args:
            earlier: Question whether the other arm's program still runs.
            ask: The lead's question before the start.
        """
        limit = self.handshake.timeout
        first = Ask(earlier.filled(other=self.other))
        out: list[PartnerStep] = [first, SetLine(0), AwaitRunning(0, limit)]
        wait = limit if self.lead else self.handshake.patience
        if self.lead:
            ready = sentences.PARTNER_READY.filled(other=self.other, arm=self.arm, start=ask)
            out += [Tell(sentences.START_PARTNER.filled(other=self.other)), Halt(ready), AwaitLine(0, wait)]
        else:
            out += [AwaitLine(0, wait), Tell(sentences.READY_TO_MEET.filled(other=self.other))]
        return [*out, Note("First meeting: both programs run."), *self.meeting(1, wait)]

    def end(self) -> list[PartnerStep]:
        """What the program ends with, so that both lines are 0 then."""
        if self.handshake.kind == "four_phase" or self.meets % 2 == 0:
            return []
        return [Note("Last meeting: both lines are 0."), *self.meet(self.meets + 1, 0.0)]

    @property
    def unanswered(self) -> str:
        """What is said of a wait that was over its time."""
        return sentences.UNANSWERED.filled(other=self.other)

    def not_as_wanted(self, value: int) -> str:
        """What is said when the other one's running wire did not come to this level in time."""
        text = PARTNER_STANDS if value else PARTNER_RUNS
        return text.format(other=self.other, input=self.handshake.of(self.arm).partner_running)

    def header(self) -> tuple[str, str]:
        """Sentences on the signals, and on the wires between the controllers."""
        own, kind = self.handshake.of(self.arm), self.handshake.kind.replace("_", "-")
        role = "leads" if self.lead else "follows"
        wires = " ".join(
            f"Wire {wire.output} of arm {wire.source} to {wire.input} of arm {wire.sink}."
            for arms in [(self.arm, self.other)]
            for wire in (*self.handshake.wired(arms), *self.handshake.wired_running(arms))
        )
        every = "every move" if self.handshake.every == 1 else f"every {self.handshake.every} moves"
        return (
            f"Meets arm {self.other}, on a controller of its own, by {kind} handshake at {every}: sets "
            f"{own.output}, reads {own.input}, and {role}. {own.partner_running} is 1 while the program of "
            f"arm {self.other} runs; its fall stops this arm and takes its power. {own.running} is its like.",
            wires,
        )
