"""One flank cut: from a ruled surface of the part to roughing passes and the finishing pass.

Ways in and out of the cut: straight on until the cutter is off the block, and round convex corners.
"""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, Ruled, unit
from planner.geometry.polylines import thinned
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity, TandemError, has_errors, refusal
from planner.problem import Part
from planner.processes.milling.plan import cutter_contact
from planner.processes.milling.plan.cutter_contact import Strip, strips
from planner.processes.milling.plan.operation import FlankCut, Milling
from planner.processes.milling.plan.tool_path import Run, plain_path
from planner.tooling import Cutter

CORNER_STEP: Final = np.deg2rad(5.0)
"""Turn [rad] of the cutter about a corner from target to target."""
LEAD_TARGETS: Final = 6
"""Targets of a way in or out on which the tool still turns."""
LEAD_TURN: Final = np.deg2rad(10.0)
"""How far [rad] a tool turns on along a way in or out at most."""
LEAD_ROUNDS: Final = 8
"""How often a way in or out is made longer at most, until the cutter is off the block at its end."""
LEAD_PLACES: Final = 257
"""Places along a cutter that are held against the block there."""
LEAD_SPARE: Final = 1e-4
"""What a cutter has to be off the block there [m] besides its radius: programs are rounded."""
LONGEST_LEAD: Final = 5.0
"""A way that is not off the block after so much [m] never is."""


def off_block(ends: FloatArray, way: FloatArray, box: FloatArray, clear: float) -> float:
    """How far [m] a cutter has to go along the unit vector ``way`` (3,) until all its ``ends`` (K, 3) are
    ``clear`` [m] beyond one side of the block ``box`` (2, 3)."""
    best = LONGEST_LEAD
    for axis in range(3):
        if way[axis] > 1e-6:
            best = min(best, (box[1, axis] + clear - float(ends[:, axis].min())) / way[axis])
        elif way[axis] < -1e-6:
            best = min(best, (float(ends[:, axis].max()) - box[0, axis] + clear) / -way[axis])
    return max(best, 0.0)


def beyond(
    low: FloatArray, high: FloatArray, low_way: FloatArray, high_way: FloatArray, length: float
) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) each, on from an axis ``low`` to ``high`` (3,) whose ends move by ``low_way`` and
    ``high_way`` (3,) at once, by ``length`` [m]: first as the surface would go on, so that the tool
    does not stop turning at once, then more and more straight."""
    scale = max(float(np.linalg.norm(low_way)), float(np.linalg.norm(high_way)), 1e-12)
    straight = 0.5 * (low_way + high_way) / scale
    turn = 0.5 * (high_way - low_way) / scale
    whole = length / max(float(np.linalg.norm(straight)), 0.1)
    rate = float(np.linalg.norm(turn)) * 2.0 / max(float(np.linalg.norm(high - low)), 1e-9)
    during = min(whole, 2.0 * LEAD_TURN / max(rate, 1e-9))
    at = np.unique(np.append(np.linspace(0.0, during, LEAD_TARGETS + 1), whole))[:, None]
    slowing = np.where(at < during, at - at * at / (2.0 * during), 0.5 * during)
    return low + at * straight - slowing * turn, high + at * straight + slowing * turn


def round_corner(
    foot: tuple[FloatArray, FloatArray],
    before: tuple[FloatArray, FloatArray],
    after: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) each between ``before`` and ``after`` [(3,), (3,)], at the same distances from the corner's
    ruling ``foot`` [(3,), (3,)], both ends left out."""
    sides = []
    turns = []
    for at, one, two in zip(foot, before, after, strict=True):
        a, b = one - at, two - at
        turns.append(
            float(
                np.arccos(
                    np.clip(a @ b / max(float(np.linalg.norm(a)) * float(np.linalg.norm(b)), 1e-18), -1, 1)
                )
            )
        )
    count = max(int(np.ceil(max(turns) / CORNER_STEP)), 1)
    share = np.arange(1, count)[:, None] / count
    for at, one, two, turn in zip(foot, before, after, turns, strict=True):
        a, b = one - at, two - at
        if turn < 1e-9:
            sides.append(at + (1.0 - share) * a + share * b)
        else:
            sides.append(at + (np.sin((1.0 - share) * turn) * a + np.sin(share * turn) * b) / np.sin(turn))
    return sides[0], sides[1]


RULING_SPACING: Final = 1.0 / 10.0
"""Distance of the rulings at which the cutter is placed, over its radius."""
MOST_RULINGS: Final = 6000
"""Rulings of a surface at which the cutter is placed, about, at most."""
CHORD_SHARE: Final = 0.1
"""Share of the tolerance that straight moves between targets may cost."""
BLOCK_CLEARANCE: Final = 2.0 * MM
"""How far [m] the cutter is off the block at the ends of its ways in and out."""
INNER_CORNER_TURN: Final = 3.0 * DEG
"""An inner corner that turns by more than this [rad] cannot be milled by a round cutter."""
ROUNDING_FACTOR: Final = 1.05
"""Radius of a rounded corner, over the cutter's, that is advised: as tight as the cutter it would rub."""
SLIMMER_TRIALS: Final = 4
"""Slimmer cutters that are tried along twisted rulings."""
TOLERANCE_SHARE: Final = 0.97
"""Share of the tolerance that a slimmer cutter is to keep, so that it surely does."""
LEAST_ADVISED_RADIUS: Final = 0.5 * MM
"""Cutters of smaller radius [m] are not advised."""
LENGTH_RATIO: Final = 2.0
"""Guides one of which is longer than the other by this factor are told: its end moves so much faster."""


@dataclasses.dataclass(frozen=True)
class Placed:
    """The cutter along a surface: its axis from ``low`` to ``high`` (N, 3) [m], opposite of both guides, and
    ``off`` [m], how far it is off the surface at most."""

    low: FloatArray
    high: FloatArray
    off: float


def surface(part: Part | None, name: str) -> Ruled:
    """The ruled surface of that name. Raises ``TandemError`` with ``milling.no_surface``."""
    known = {} if part is None else {own.name: own for own in part.ruled}
    if name not in known:
        has = ", ".join(known) or "none"
        what = f"cuts: the part has no ruled surface {name}; it has {has}: name one of them, or give it "
        what += "under part.ruled"
        raise refusal("milling.no_surface", what, field="operations.cuts")
    return known[name]


@dataclasses.dataclass(frozen=True)
class Passes:
    """The passes of a cut; ``off`` [m], how far the cutter is off the surface at most in the last one, what
    the user is told, and where that is off by too much, the radius [m] of one that ``fits``, if any."""

    runs: tuple[Run, ...]
    off: float
    notes: tuple[Issue, ...]
    fits: float | None = None


def passes(op: Milling, cut: FlankCut, ruled: Ruled, cutter: Cutter, box: FloatArray) -> Passes:
    """Roughing passes and the finishing pass. Raises ``TandemError`` with codes ``milling.*``."""
    told = tuple(check(op, cut, ruled, cutter))
    if has_errors(told):
        raise TandemError(told)
    below = under(cut, cutter)
    finish = placed(op, cut, ruled, cutter.radius)
    deep = float(np.linalg.norm(finish.high - finish.low, axis=1).max()) + below
    out = []
    if cut.stepdown_mm is not None and cut.guides == "surface":
        rough = placed(op, cut, ruled, cutter.radius + cut.leave_mm * MM)
        count = max(int(np.ceil(deep / (cut.stepdown_mm * MM) - 1e-9)), 1)
        for k in range(1, count + 1):
            lift = deep * (1.0 - k / count) - below
            out.append(_run(op, cut, f"{cut.flank}_r{k}", rough, lift, cutter, box))
    out.append(_run(op, cut, cut.flank, finish, -below, cutter, box))
    return Passes(tuple(out), finish.off, tuple(told), _fits(op, cut, ruled, cutter.radius, finish.off))


def _fits(op: Milling, cut: FlankCut, ruled: Ruled, radius: float, off: float) -> float | None:
    """Radius [m] of a cutter that is near enough to twisted rulings: tried, for the deviation goes with the
    radius only about."""
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    for _ in range(SLIMMER_TRIALS):
        if off <= tolerance:
            return None
        radius *= TOLERANCE_SHARE * tolerance / off
        if radius < LEAST_ADVISED_RADIUS:
            return None
        off = placed(op, cut, ruled, radius).off
        if off <= TOLERANCE_SHARE * tolerance:
            return radius
    return None


def under(cut: FlankCut, cutter: Cutter) -> float:
    """How far [m] the tip is beyond the tip guide: the rounding of the cutter's end
    does not reach the side."""
    return cut.overrun_mm * MM + (cutter.corner if cut.guides == "surface" else 0.0)


def placed(op: Milling, cut: FlankCut, ruled: Ruled, radius: float) -> Placed:
    """The cutter of ``radius`` [m] along the surface, in the direction asked for."""
    pieces = _pieces(op, cut, ruled, radius)
    around = radius if cut.guides == "surface" else 0.0
    lows: list[FloatArray] = []
    highs: list[FloatArray] = []
    off = 0.0
    last: Strip | None = None
    for strip in pieces:
        low, high = cutter_contact.axes(strip, around)
        if around:
            left = np.abs(cutter_contact.deviation(strip, around, low, high))
            off = max(off, float(left.max()))
        if last is not None and around:
            foot = strip.low[0], strip.high[0]
            rows = round_corner(foot, (lows[-1][-1], highs[-1][-1]), (low[0], high[0]))
            lows.append(rows[0])
            highs.append(rows[1])
        lows.append(low)
        highs.append(high)
        last = strip
    return Placed(np.concatenate(lows), np.concatenate(highs), off)


def check(op: Milling, cut: FlankCut, ruled: Ruled, cutter: Cutter) -> Iterator[Issue]:
    """What is wrong with guides, flute and corners for this cutter."""
    field = f"operations.cuts.{cut.flank}"
    pieces = _pieces(op, cut, ruled, cutter.radius)
    lengths = [
        sum(_length(side) for side in sides) for sides in zip(*((s.low, s.high) for s in pieces), strict=True)
    ]
    ratio = max(lengths) / max(min(lengths), 1e-9)
    if ratio > LENGTH_RATIO:
        long = int(lengths[1] > lengths[0])
        names = ("start", "end") if cut.tip == "start" else ("end", "start")
        what = f"flank {cut.flank}: its guides are {lengths[0] / MM:.0f} and {lengths[1] / MM:.0f} mm long, "
        what += f"so that one end of the flank moves {ratio:.1f} times as fast as the other; the feed holds "
        what += f"for the faster. Where the slower burns or rubs, shorten the guide {names[long]} to "
        what += f"{np.floor(LENGTH_RATIO * min(lengths) / MM * 10.0) / 10.0:.1f} mm or less, or part the "
        what += "surface"
        yield Issue(
            "milling.guide_lengths", what, Severity.WARNING, field=field, value=ratio, limit=LENGTH_RATIO
        )
    high = max(float(np.linalg.norm(strip.high - strip.low, axis=1).max()) for strip in pieces)
    need = high + under(cut, cutter)
    if cut.guides == "surface" and need > cutter.flute + 1e-9:
        what = f"flank {cut.flank} needs {_up(need):.2f} mm of flute (wall {high / MM:.1f}, beyond its guide "
        what += f"{under(cut, cutter) / MM:.1f}), the cutter has {cutter.flute / MM:.1f}; take a longer flute"
        if need > cutter.overhang:
            what += " and overhang"
        what += ", or part the wall into surfaces one above the other"
        yield Issue("milling.flute", what, field=field, value=need / MM, limit=cutter.flute / MM, unit="mm")
    if need > cutter.overhang:
        what = f"flank {cut.flank}: the tip is {need / MM:.1f} mm below the wall's top, and the holder "
        what += f"begins {cutter.overhang / MM:.1f} mm behind it; take an overhang of {_up(need):.2f} mm or "
        what += "more"
        yield Issue(
            "milling.holder", what, field=field, value=need / MM, limit=cutter.overhang / MM, unit="mm"
        )
    if cut.guides == "surface":
        yield from _corners(cut, pieces, ruled.closed, cutter.radius, field)


def _corners(cut: FlankCut, pieces: list[Strip], closed: bool, radius: float, field: str) -> Iterator[Issue]:
    around = [*pieces, pieces[0]] if closed and not pieces[0].ring else pieces
    for before, after in itertools.pairwise(around):
        turn = float(np.arcsin(np.clip(after.tangents()[0][0] @ before.normals()[0][-1], -1.0, 1.0)))
        if turn > INNER_CORNER_TURN:
            at = ", ".join(f"{v / MM:.1f}" for v in after.low[0])
            what = f"flank {cut.flank} has an inner corner of {turn / DEG:.0f} degrees at {at} mm, "
            # between two walls at the angle pi - turn a circle is so far off the corner
            stays = radius * (1.0 / np.cos(0.5 * turn) - 1.0)
            what += f"where a cutter of {radius / MM:g} mm radius leaves a fillet of its own, "
            what += f"{stays / MM:.2f} mm off the corner; round both guides there by "
            what += f"{_up(ROUNDING_FACTOR * radius):.2f} mm or more"
            yield Issue(
                "milling.corner", what, field=field, **measurement(turn / DEG, INNER_CORNER_TURN / DEG, "deg")
            )


def _pieces(op: Milling, cut: FlankCut, ruled: Ruled, radius: float) -> list[Strip]:
    whole = sum(
        float(np.linalg.norm(np.diff(side, axis=0), axis=1).sum()) for side in (ruled.start, ruled.end)
    )
    step = max(radius * RULING_SPACING, 0.5 * whole / MOST_RULINGS)
    pieces = strips(ruled, cut.tip == "start", 0.02 * op.shape_tol_mm * MM, step)
    if cut.direction == "against" or (
        cut.direction in ("climb", "conventional") and cut.direction != _way(pieces[0])
    ):
        return [strip.reversed() for strip in pieces[::-1]]
    return pieces


def _way(strip: Strip) -> str:
    """``climb`` or ``conventional``: a cutter that turns clockwise, seen from the spindle, climbs where it is
    on the left of the surface, seen along the feed with the spindle up."""
    left = np.cross(strip.high[0] - strip.low[0], strip.tangents()[0][0])
    return "climb" if float(left @ strip.normals()[0][0]) > 0.0 else "conventional"


def _run(
    op: Milling, cut: FlankCut, name: str, on: Placed, lift: float, cutter: Cutter, box: FloatArray
) -> Run:
    """One pass with the tip ``lift`` [m] above the tip guide."""
    tolerance = (cut.shape_tol_mm or op.shape_tol_mm) * MM
    rows = thinned(np.stack([on.low, on.high], axis=1), CHORD_SHARE * tolerance, op.step_mm * MM)
    low, high = on.low[rows], on.high[rows]
    into = _lead(cut, low, high, (0, 1), lift, cutter, box)
    out = _lead(cut, low, high, (-1, -2), lift, cutter, box)
    base = np.concatenate([into[0][::-1], low, out[0]])
    top = np.concatenate([into[1][::-1], high, out[1]])
    axis = unit(top - base)
    first = len(into[0])
    path = plain_path(base + lift * axis, axis, (cut.feed_mm_s or op.feed_mm_s) * MM)
    reach = float(np.linalg.norm(on.high - on.low, axis=1).max()) - lift
    return Run(name, path, first, first + len(rows) - 1, max(reach, 0.0))


def _lead(
    cut: FlankCut,
    low: FloatArray,
    high: FloatArray,
    rows: tuple[int, int],
    lift: float,
    cutter: Cutter,
    box: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) each that go on beyond the first of two rows, away from the second."""
    k, after = rows
    low_way, high_way = low[k] - low[after], high[k] - high[after]
    way = low_way + high_way
    way /= max(float(np.linalg.norm(way)), 1e-12)
    if cut.lead_mm is None:
        far = np.stack([low[k] + min(lift, 0.0) * unit(high[k] - low[k]), high[k]])
        length = off_block(far, way, box, cutter.radius + BLOCK_CLEARANCE)
    else:
        length = cut.lead_mm * MM
    if length < 1e-6:
        return low[:0], high[:0]
    one, other = beyond(low[k], high[k], low_way, high_way, length)
    for _ in range(LEAD_ROUNDS if cut.lead_mm is None else 0):
        more = _still_in(one[-1], other[-1], way, lift, cutter, box)
        if more <= 0.0 or length >= LONGEST_LEAD:
            break
        # a tool that turns on its way is behind at one end, and leans over the block above the surface
        length += more
        one, other = beyond(low[k], high[k], low_way, high_way, length)
    return one[1:], other[1:]


def _still_in(
    low: FloatArray, high: FloatArray, way: FloatArray, lift: float, cutter: Cutter, box: FloatArray
) -> float:
    """How far [m] on along ``way`` (3,) a cutter on the axis from ``low`` to ``high`` (3,) is off the block
    with its whole length, 0 where it is there already: it is drawn back along that axis."""
    axis = unit(high - low)
    back = np.linspace(lift, lift + cutter.overhang, LEAD_PLACES)
    on = low + back[:, None] * axis
    gap = np.linalg.norm(np.maximum(np.maximum(box[0] - on, on - box[1]), 0.0), axis=1)
    inside = gap < cutter.radius + LEAD_SPARE
    return off_block(on[inside], way, box, cutter.radius + BLOCK_CLEARANCE) if inside.any() else 0.0


def _up(length: float) -> float:
    """A length [m] in mm, rounded up: a figure that is followed must do."""
    return float(np.ceil(length / MM * 100.0 - 1e-6) / 100.0)


def _length(side: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(side, axis=0), axis=1).sum())
