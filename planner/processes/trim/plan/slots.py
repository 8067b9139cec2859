"""From closed curves to slots: the way of the torch from where it pierces to where the arc goes off."""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, unit
from planner.geometry.units import MM
from planner.issues import refusal
from planner.processes.trim.plan.face import Face, Laid, apart, offset
from planner.processes.trim.plan.operation import OutlineFile, Trim

STARTS: Final = 48
"""Places about a curve at which a slot is tried to begin."""
GAP: Final = 1.5 * MM
"""Where the middle of a slot has no place for so long [m], the curve is narrower there than the slot."""
LEAST_ROUND: Final = 0.5
"""The middle of a slot is so many half widths long at least."""
LEAD_SPACING: Final = 0.5 * MM
"""Distance [m] of places of ways in and out."""
LEAD_PLACES: Final = 5
"""Places of a way in at least: between two of them it comes down to the height at which it cuts."""
LEAD_ROOM: Final = 0.05 * MM
"""How much nearer to a curve than the slot's half width its ways in and out may come [m]."""


@dataclasses.dataclass(frozen=True)
class Slot:
    """One slot without a break: ``point``, ``normal`` (N, 3) on the face, normals up; rows before ``first``
    lead in, rows behind ``last`` lead out. ``heading`` (N,) [rad] of a knife's edge, seen from above, counted
    on from place to place, and how far ``over`` [m] corners it cuts into the part; nothing of other tools."""

    name: str
    outline: str
    point: FloatArray
    normal: FloatArray
    first: int
    last: int
    heading: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    over: float = 0.0


@dataclasses.dataclass(frozen=True)
class Wanted:
    """An outline of the problem, laid on the face; ``area`` is what it encloses in plan."""

    spec: OutlineFile
    laid: Laid
    area: shapely.Polygon

    @property
    def inside(self) -> bool:
        """Whether what is inside drops."""
        return self.spec.drops == "inside"

    def waste(self, xy: FloatArray) -> BoolArray:
        """(N,) whether places in plan lie in its waste."""
        return np.asarray(shapely.contains_xy(self.area, xy[:, 0], xy[:, 1]) == self.inside)


def slots(op: Trim, one: Wanted, others: list[Wanted], face: Face, kerf: float) -> list[Slot]:
    """The slots of an outline: one, or one between each two micro-joints. Raises ``TandemError`` with
    ``trim.narrow``, ``trim.corner``, ``trim.joints`` and ``trim.lead``."""
    half = 0.5 * kerf
    middle, out = offset(one.laid, face, half, one.inside)
    _require_whole(one, middle, half, op.shape_tol_mm * MM)
    ring = np.concatenate([middle, middle[:1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1)))
    length, count = float(along[-1]), max(one.spec.joints, 1)
    gap = one.spec.joint_mm * MM + kerf if one.spec.joints else 0.0
    if length / count <= gap + 2.0 * kerf:
        most = int(length / (gap + 2.0 * kerf))
        what = f"{one.spec.name}: {count} micro-joints of {one.spec.joint_mm:g} mm leave nothing to cut "
        what += f"between them; at most {most} fit on {length / MM:.1f} mm"
        raise refusal("trim.joints", what, value=count, limit=most, hint=f"take joints: {most}")
    ways = unit(np.concatenate([out, out[:1]]))
    best: tuple[float, list[Slot]] | None = None
    for start in length * np.arange(STARTS) / STARTS:
        made = [
            _slot(op, one, face, (along, ring, ways), start + k * length / count, length / count, gap, k)
            for k in range(count)
        ]
        room = min(_room(op, slot, one, others, half) for slot in made)
        if best is None or room > best[0] + 1e-9:
            best = room, made
        if best is not None and best[0] >= op.lead.length_mm * MM:
            break  # no place has more room than it needs
    if best is None or best[0] < 0.0:
        short = 0.0 if best is None else -best[0]
        fits = max(op.lead.length_mm - short / MM, 0.0)
        what = f"{one.spec.name}: no way in of {op.lead.length_mm:g} mm with the pierce point "
        what += f"{op.pierce.off_mm:g} mm off all curves fits into the waste; {short / MM:.2f} mm are lacking"
        hint = f"take a shorter lead.length_mm or pierce.off_mm (about {fits:.1f}), or a narrower kerf"
        raise refusal("trim.lead", what, value=short / MM, limit=0.0, unit="mm", hint=hint)
    return best[1]


def _require_whole(one: Wanted, middle: FloatArray, half: float, tolerance: float) -> None:
    """Whether the middle of the slot goes all the way round, and near enough to all of the curve."""
    step = np.linalg.norm(np.diff(np.concatenate([middle, middle[:1]]), axis=0), axis=1) if len(middle) else 0
    # a middle that shrinks to a place goes round nothing
    round_it = len(middle) >= 8 and float(np.sum(step)) > LEAST_ROUND * half
    if not round_it or float(np.max(step)) > GAP:
        where = middle[int(np.argmax(step))] if round_it else one.laid.point.mean(axis=0)
        what = f"{one.spec.name}: about ({where[0] / MM:.1f}, {where[1] / MM:.1f}) mm the waste is narrower "
        what += f"than the kerf of {2.0 * half / MM:g} mm, so that its slot does not close"
        raise refusal(
            "trim.narrow",
            what,
            limit=2.0 * half / MM,
            unit="mm",
            hint="widen it there, or take a narrower kerf",
        )
    left = apart(one.laid.point, middle) - half
    k = int(np.argmax(left))
    if left[k] > tolerance:
        x, y, _ = one.laid.point[k] / MM
        what = f"{one.spec.name}: in the corner at ({x:.1f}, {y:.1f}) mm a round slot leaves "
        what += f"{left[k] / MM:.2f} mm, allowed are {tolerance / MM:g} mm"
        hint = (
            f"round the corner with {half / MM:g} mm or more, or take shape_tol_mm: {left[k] / MM + 0.01:.2f}"
        )
        value, limit = float(left[k]) / MM, tolerance / MM
        raise refusal("trim.corner", what, value=value, limit=limit, unit="mm", hint=hint)


Ring = tuple[FloatArray, FloatArray, FloatArray]
"""Way along the middle of a slot, its places, and the directions into the waste; the first again at the
end."""


def _slot(
    op: Trim, one: Wanted, face: Face, ring: Ring, start: float, whole: float, gap: float, number: int
) -> Slot:
    """The slot that begins half a gap behind ``start`` [m] and ends as far before the next one, or a little
    past its own start."""
    along, places, ways = ring
    length = float(along[-1])
    low = start + 0.5 * gap
    high = start + whole - 0.5 * gap if gap else start + length + op.lead.overcut_mm * MM
    inner = np.concatenate([along[:-1] + turn * length for turn in range(3)])
    at = np.concatenate([[low], inner[(inner > low + 1e-6) & (inner < high - 1e-6)], [high]]) % length
    point = np.stack([np.interp(at, along, places[:, k]) for k in range(3)], axis=1)
    into = unit(np.stack([np.interp(at[[0, -1]], along, ways[:, k]) for k in range(3)], axis=1))
    lead = _lead(op, point[0], into[0], unit((point[1] - point[0])[None])[0])
    leave = op.lead.out_mm * MM if not gap else 0.0
    steps = np.linspace(0.0, 1.0, max(int(np.ceil(leave / LEAD_SPACING)), 1) + 1)[1:, None] * leave
    off = point[-1] + steps * into[1] if leave else np.zeros((0, 3))
    laid, normal = face.at(np.concatenate([lead, point, off])[:, :2])
    name = one.spec.name if not gap else f"{one.spec.name}_p{number + 1}"
    return Slot(name, one.spec.name, laid, normal, len(lead), len(lead) + len(point) - 1)


def _lead(op: Trim, end: FloatArray, into: FloatArray, way: FloatArray) -> FloatArray:
    """Places (K, 3) of a way in to ``end``, without that."""
    length = op.lead.length_mm * MM
    count = max(int(np.ceil(length / LEAD_SPACING)), LEAD_PLACES)
    if op.lead.shape == "line":
        return np.asarray(end + np.linspace(length, 0.0, count + 1)[:-1, None] * into)
    turn = np.linspace(0.5 * np.pi, 0.0, 2 * count + 1)[:-1, None]
    return np.asarray(end + length * ((1.0 - np.cos(turn)) * into - np.sin(turn) * way))


def _room(op: Trim, slot: Slot, one: Wanted, others: list[Wanted], half: float) -> float:
    """By how much [m] a slot's pierce point is farther off all curves than it has to be, below zero where it
    is nearer, or where a way in or out comes near to a curve."""
    leads = np.concatenate([slot.point[: slot.first], slot.point[slot.last + 1 :]])
    off = np.where(one.waste(leads[:, :2]), 1.0, -1.0) * apart(leads, one.laid.point)
    room = min(float(off[0]) - op.pierce.off_mm * MM, float(off.min()) - half + LEAD_ROOM)
    for other in others:
        room = min(room, float(apart(leads[:1], other.laid.point)[0]) - op.pierce.off_mm * MM)
    return room
