"""A milled job as G-code for a five-axis machine: inverse time (G93), tip and rotary axes at every block.

X Y Z are the tip's in the frame of the stock, so the machine has to control the tool's centre point (on
LinuxCNC a switchable kinematics, elsewhere G43.4 or TRAORI), which the program asks its operator to switch
on. Rotary axes count as :mod:`planner.processes.milling.plan.gcode.state` says. Each block takes the time
that the move takes in the plan. Of the machine's limits and bodies nothing is known here, and the program
says so.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.issues import refusal
from planner.processes.milling.plan.gcode.state import ROTARY_NAMES, Convention
from planner.processes.milling.plan.operation import GCodeCut, Milling
from planner.targets import Action, Targets

AXIS_OFF: Final = 0.02 * DEG
"""How far [rad] the tool's axis may be off the plan's between two blocks: as readers of such files count."""
MOST_HALVES: Final = 12
"""A move is halved so often at most, where its axis passes by that about which a rotary axis turns."""
POLE: Final = 5e-5
"""Sine of the tilt below which there is none: the axis that carries it has any angle there, and noise of a
mesh or of a plan must not turn it about."""
MOST_FEED: Final = 9999.0
"""Largest feed word of a move [1/min]; controllers often have four digits for it (unverified). So a move
takes 6 ms at least, longer than in the plan where this divides it finely, or has no time for it."""


class UnreachedAxisError(ValueError):
    """The machine cannot point the tool as a way wants it at a ``row``; the nearest is ``off`` [rad] by."""

    def __init__(self, row: int, off: float) -> None:
        super().__init__(f"row {row}: the axis is {off / DEG:.3f} deg off what the machine can")
        self.row, self.off = row, off


@dataclasses.dataclass(frozen=True)
class Way:
    """One operation: places of the tip (N, 3) [m] in the stock's frame, unit vectors (N, 3) from the tip to
    the spindle, times (N,) [s], names (N,) of targets, what happens at which, the spindle's speed [1/min],
    and the ``signal`` that runs it."""

    name: str
    tip: FloatArray
    axis: FloatArray
    time: FloatArray
    names: Sequence[str]
    actions: Sequence[Action]
    spindle_rpm: float
    signal: str


def way_of(operation: object, targets: Targets, values: FloatArray, time: FloatArray) -> Way:
    """What an operation mills, of its targets with ``values`` (N, F) of their freedoms at ``time`` (N,) [s].

    Raises ``TandemError`` (``problem.field``) for another process, a block that an arm holds, and for cuts
    that are G-code already.
    """
    if not isinstance(operation, Milling):
        named = f"'{getattr(operation, 'name', operation)}' ({getattr(operation, 'process', '?')})"
        what = f"G-code is written of milling alone, got the operation {named}; export that as .3dm"
        raise refusal("problem.field", what, field="output")
    arm = operation.arms[0]
    if given := [cut.gcode.file.name for cut in operation.cuts if isinstance(cut, GCodeCut)]:
        what = f"the operation '{operation.name}' cuts by {given[0]}, which is G-code; take that file"
        raise refusal("problem.field", what, field="output")
    if targets.frame[arm] != "stock":
        what = (
            f"the operation '{operation.name}': its targets are in the frame {targets.frame[arm]}, not stock"
        )
        raise refusal("problem.field", what, field="output")
    pose = targets.poses(values)[arm]
    names = [targets.name(i) for i in range(targets.count)]
    tip, axis = pose[:, :3, 3], -pose[:, :3, 2]  # z of the tool points out of the spindle
    rpm, signal = operation.spindle_rpm, operation.signal
    return Way(operation.name, tip, axis, time, names, targets.actions, rpm, signal)


def program(title: str, ways: Iterable[Way], machine: Convention) -> str:
    """The text of all ways, one after the other. Raises ``TandemError`` (``problem.field``) where the machine
    cannot point the tool as the plan does."""
    body: list[str] = []
    for way in ways:
        try:
            body += _operation(way, machine)
        except UnreachedAxisError as error:
            off = f"{error.off / DEG:.2f} deg off at {way.names[error.row]}, allowed {AXIS_OFF / DEG:g} deg"
            what = f"a machine {machine.name} cannot point the tool as '{way.name}' does, {off}"
            hint = "name a machine with two rotary axes"
            raise refusal("problem.field", what, field="machine", hint=hint) from error
    head = [
        f"(job {_plain(title)})",
        f"(for a machine {machine.name}, rotary axes {' '.join(machine.letters)} in degrees)",
        *(
            f"({letter} counts as it turns the {'tool' if sign > 0 else 'part'} about +{about}, right hand)"
            for letter, about in zip(ROTARY_NAMES, "xyz", strict=True)
            for own, sign in machine.chain
            if own == letter
        ),
        "(X Y Z mm: the tip in the frame of the stock; tool centre point control has to be on)",
        "(NOT proven for this machine: its limits, its bodies and its clamping are not known)",
        "(P of G4 is in seconds)",
        "G21 G90 G94 G17 G40 G80",
    ]
    return "\n".join([*head, *body, "G94", "M2", ""])


def angles(axis: FloatArray, machine: Convention) -> FloatArray:
    """Angles (N, 3) [rad] of A, B and C, 0 where the machine has none, by which it points along the unit
    vectors ``axis`` (N, 3), each near the one before: of both ways to tilt, the one that turns less in all.

    Raises :class:`UnreachedAxisError` for a vector that a machine with one rotary axis cannot take.
    """
    best = min(
        (_followed(axis, machine, side) for side in (0, 1)),
        key=lambda one: (round(float(np.abs(np.diff(one, axis=0)).sum()), 9), float(np.abs(one[0]).sum())),
    )
    off = np.arccos(np.clip(np.einsum("ni,ni->n", machine.axis(best), axis), -1.0, 1.0))
    if off.max() > AXIS_OFF:
        row = int(off.argmax())
        raise UnreachedAxisError(row, float(off[row]))
    return best


def _followed(axis: FloatArray, machine: Convention, side: int) -> FloatArray:
    """Angles along a way that begins with the one or the other way to tilt. Where the tilt is none, what
    carries it turns evenly from where it was to where it has to be next, and stands there at the begin."""
    out = np.zeros((len(axis), 3))
    free = _at_pole(axis, machine)
    known = np.flatnonzero(~free)
    last = np.zeros(3)
    for row in known:
        near = _near(axis[row], machine, last)
        pick = min(side, len(near) - 1)
        if row > known[0]:
            pick = int(np.argmin([np.abs(one - last).sum() for one in near]))
        out[row] = last = near[pick]
    for row in np.flatnonzero(free):
        last = np.array([np.interp(row, known, out[known, k]) for k in range(3)]) if len(known) else last
        near = _near(axis[row], machine, last)
        out[row] = last = near[int(np.argmin([np.abs(one - last).sum() for one in near]))]
    return out


def _near(vector: FloatArray, machine: Convention, last: FloatArray) -> list[FloatArray]:
    """Both solutions (3,) [rad] by whole turns next to the ``last`` one."""
    both = _solutions(vector, machine, last)
    return [one + 2.0 * np.pi * np.round((last - one) / (2.0 * np.pi)) for one in both]


def _at_pole(axis: FloatArray, machine: Convention) -> NDArray[np.bool_]:
    """Whether the tool (N,) is along the axis that carries the tilt; of a single rotary axis nowhere."""
    if len(machine.chain) == 1:
        return np.zeros(len(axis), dtype=np.bool_)
    about = ROTARY_NAMES.index(machine.chain[0][0])
    return np.asarray(np.linalg.norm(np.delete(axis, about, axis=1), axis=1) <= POLE)


def _solutions(vector: FloatArray, machine: Convention, last: FloatArray) -> list[FloatArray]:
    """Angles (3,) [rad] that point along a vector: the tilt next to the spindle first, then what carries it;
    at the pole of that the ``last`` one."""
    x, y, z = vector.tolist()
    letters = [letter for letter, _ in machine.chain]
    signs = dict(machine.chain)
    found: list[dict[str, float]]
    if letters == ["A"]:
        found = [{"A": np.arctan2(-y, z)}]
    elif letters == ["B"]:
        found = [{"B": np.arctan2(x, z)}]
    elif letters[0] == "C":
        flat = float(np.hypot(x, y))
        tilt = float(np.arctan2(flat if flat > POLE else 0.0, z))
        kept = signs["C"] * float(last[2])
        # A tilts +z towards -y, B towards +x; C then turns that to where it is wanted
        way = (np.arctan2(x, -y) if letters[1] == "A" else np.arctan2(y, x)) if flat > POLE else kept
        found = [{letters[1]: tilt, "C": way}, {letters[1]: -tilt, "C": way + np.pi if flat > POLE else way}]
    elif letters == ["A", "B"]:
        cross = float(np.hypot(y, z))
        first = np.arctan2(-y, z) if cross > POLE else signs["A"] * float(last[0])
        found = [{"B": np.arctan2(x, cross), "A": first}, {"B": np.arctan2(x, -cross), "A": first + np.pi}]
    else:
        cross = float(np.hypot(x, z))
        first = np.arctan2(x, z) if cross > POLE else signs["B"] * float(last[1])
        found = [{"A": np.arctan2(-y, cross), "B": first}, {"A": np.arctan2(-y, -cross), "B": first + np.pi}]
    return [np.array([signs.get(name, 1) * one.get(name, 0.0) for name in ROTARY_NAMES]) for one in found]


def blocks(way: Way, machine: Convention) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Ends of blocks along a way: tips (B, 3) [m], angles (B, 3) [rad], times (B,) [s] and the targets (B,)
    that they belong to, the first one of each included. Moves are halved until the axis, whose angles go
    evenly, is within :data:`AXIS_OFF` of the plan's, which goes along great circles."""
    share = np.arange(len(way.tip), dtype=np.float64)
    turn = angles(way.axis, machine)
    for _ in range(MOST_HALVES):
        middle = 0.5 * (share[1:] + share[:-1])
        straight = machine.axis(0.5 * (turn[1:] + turn[:-1]))
        off = np.linalg.norm(straight - _axis_at(way, middle), axis=1)
        far = off > AXIS_OFF
        if not far.any():
            break
        share = np.sort(np.concatenate([share, middle[far]]))
        turn = angles(_axis_at(way, share), machine)
    whole = np.arange(len(way.tip))
    tip = np.stack([np.interp(share, whole, way.tip[:, k]) for k in range(3)], axis=1)
    return tip, turn, np.interp(share, whole, way.time), np.ceil(share - 1e-12)


def _axis_at(way: Way, share: FloatArray) -> FloatArray:
    """Unit vectors (B, 3) at ``share`` (B,), whole at targets, on great circles between them."""
    last = len(way.axis) - 1
    before = np.minimum(share.astype(np.intp), max(last - 1, 0))
    one, two = way.axis[before], way.axis[np.minimum(before + 1, last)]
    part = (share - before)[:, None]
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", one, two), -1.0, 1.0))[:, None]
    sine = np.sin(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        bent = (np.sin((1.0 - part) * angle) * one + np.sin(part * angle) * two) / sine
    mixed = np.where(sine > 1e-9, bent, (1.0 - part) * one + part * two)
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def _operation(way: Way, machine: Convention) -> Iterator[str]:
    tip, turn, time, target = blocks(way, machine)
    used = [(letter, ROTARY_NAMES.index(letter)) for letter in machine.letters]
    degrees = turn / DEG

    def rotary(row: int) -> str:
        return " ".join(f"{letter}{degrees[row, k]:.5f}" for letter, k in used)

    span = ", ".join(f"{letter} {degrees[:, k].min():.3f} to {degrees[:, k].max():.3f}" for letter, k in used)
    feed = 60.0 / np.maximum(np.diff(time), 60.0 / MOST_FEED)
    turns = np.abs(np.diff(degrees, axis=0)) * feed[:, None] / 60.0
    fast = turns.max(axis=0) if len(turns) else np.zeros(3)
    yield f"({_plain(way.name)}: {span} deg)"
    yield f"(fastest rotary axes: {', '.join(f'{letter} {fast[k]:.2f} deg/s' for letter, k in used)})"
    waiting = list(way.actions)
    while waiting and waiting[0].at == 0 and waiting[0].kind in ("message", "confirm"):
        yield from _done(waiting.pop(0), way)
    yield from _pause("tool centre point control on, tool high above the stock?")
    x, y, z = (tip[0] / MM).tolist()
    yield f"G94 G0 {rotary(0)}"
    yield f"G0 X{x:.5f} Y{y:.5f}"
    yield f"G0 Z{z:.5f}"
    while waiting and waiting[0].at == 0:  # no stop asks anything of who stands before a spindle that runs
        yield from _done(waiting.pop(0), way)
    for i in range(1, len(tip)):
        yield from _named(way, int(target[i]), int(target[i - 1]))
        place = " ".join(f"{word}{value:.5f}" for word, value in zip("XYZ", tip[i] / MM, strict=True))
        yield f"G93 G1 {place} {rotary(i)} F{feed[i - 1]:.6f}"
        if i + 1 == len(tip) or target[i + 1] > target[i]:
            while waiting and waiting[0].at <= target[i]:
                yield from _done(waiting.pop(0), way)


def _named(way: Way, target: int, before: int) -> Iterator[str]:
    own = way.names[target].rpartition("/")[0]
    if target == before:
        return
    if before == 0 or own != way.names[before].rpartition("/")[0]:
        yield f"({_plain(own)})"


def _done(action: Action, way: Way) -> Iterator[str]:
    """What happens at a stop, in the words of the standard."""
    if action.kind in ("on", "off") and action.signal == way.signal:
        yield f"M3 S{round(way.spindle_rpm, 3):.10g}" if action.kind == "on" else "M5"
    elif action.kind == "wait":
        yield f"G94 G4 P{action.seconds:.3f}"
    elif action.kind == "confirm":
        yield from _pause(action.text)
    elif action.kind == "message":
        yield f"(MSG, {_plain(action.text)})"
    else:
        yield from _pause(f"switch {action.signal or action.kind} {action.kind} by hand")


def _pause(text: str) -> Iterator[str]:
    yield f"(MSG, {_plain(text)})"
    yield "M0"


def _plain(text: str) -> str:
    """Text as a comment can have it: printable ASCII without brackets, on one line."""
    kept = "".join(c if " " <= c <= "~" and c not in "()" else " " for c in text)
    return " ".join(kept.split())
