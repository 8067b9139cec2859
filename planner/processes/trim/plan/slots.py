"""From closed curves to slots: the path of the tool from where it pierces to where it leaves the sheet."""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, unit
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.processes.trim.plan.face import FaceCurve, SheetFace, curve_distance, offset_curve
from planner.processes.trim.plan.operation import OutlineFile, Trim

START_TRIALS: Final = 48
"""Number of points along a curve at which a slot is tried to start."""
MAX_GAP_M: Final = 1.5 * MM
"""A larger step between points of a slot's centre line [m] means that the waste is narrower than the slot."""
MIN_LENGTH_FACTOR: Final = 0.5
"""Minimum length of a slot's centre line, as a factor of half the kerf."""
LEAD_SPACING_M: Final = 0.5 * MM
"""Distance of points of leads [m]."""
MIN_LEAD_POINTS: Final = 5
"""Minimum number of points of a lead-in, along which the tool goes down to its cutting height."""
LEAD_MARGIN_M: Final = 0.05 * MM
"""Length by which leads may be nearer to a curve than half the kerf [m]."""


@dataclasses.dataclass(frozen=True)
class Slot:
    """One uninterrupted slot, with its leads.

    Attributes:
        name: Name of its segment.
        outline: Name of its outline.
        point: Points of its centre line on the face (N, 3) [m].
        normal: Upward normals (N, 3).
        first: Index of the first point after the lead-in.
        last: Index of the last point before the lead-out.
        heading: Heading of a knife's edge (N,) [rad], seen from above and without jumps; empty for other
            tools.
        overcut: Maximum length by which a knife cuts into the part past corners [m].
    """

    name: str
    outline: str
    point: FloatArray
    normal: FloatArray
    first: int
    last: int
    heading: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    overcut: float = 0.0


@dataclasses.dataclass(frozen=True)
class PlannedOutline:
    """An outline of the problem, projected onto the face.

    Attributes:
        spec: Outline of the problem.
        curve: Curve on the face.
        area: The area that it encloses in plan.
    """

    spec: OutlineFile
    curve: FaceCurve
    area: shapely.Polygon

    @property
    def drops_inside(self) -> bool:
        """Whether the sheet inside the outline is waste and drops, otherwise the sheet outside."""
        return self.spec.drops == "inside"

    def in_waste(self, xy: FloatArray) -> BoolArray:
        """Return whether (N,) points in plan (N, 2) [m] lie in its waste."""
        return np.asarray(shapely.contains_xy(self.area, xy[:, 0], xy[:, 1]) == self.drops_inside)


@dataclasses.dataclass(frozen=True)
class SlotPlan:
    """Slots of an operation.

    Attributes:
        outlines: Outlines on the face.
        slots: Their slots in order.
    """

    outlines: tuple[PlannedOutline, ...]
    slots: tuple[Slot, ...]


def plan_slots(
    op: Trim, outline: PlannedOutline, others: list[PlannedOutline], face: SheetFace, kerf: float
) -> list[Slot]:
    """Plan the slots of an outline for a torch or mill: one, or one between each two micro-joints.

    ``START_TRIALS`` starting points are tried along the curve. The first one is taken at which leads and
    pierce points have ample distance from all curves, otherwise the one with the most distance.

    Args:
        op: Operation.
        outline: Outline.
        others: Other outlines.
        face: Face of the sheet.
        kerf: Width of the slot [m].

    Raises:
        TandemError: ``trim.narrow`` if the waste is narrower than the kerf, ``trim.corner`` if a round slot
            leaves too much in a corner, ``trim.joints`` if the micro-joints leave nothing to cut,
            ``trim.lead`` if no lead-in fits.
    """
    half_kerf = 0.5 * kerf
    middle, into_waste = offset_curve(outline.curve, face, half_kerf, outline.drops_inside)
    _check_closed(outline, middle, half_kerf, op.shape_tol_mm * MM)
    ring = np.concatenate([middle, middle[:1]])
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1)))
    length, count = float(along[-1]), max(outline.spec.joints, 1)
    gap = outline.spec.joint_mm * MM + kerf if outline.spec.joints else 0.0
    if length / count <= gap + 2.0 * kerf:
        max_joints = int(length / (gap + 2.0 * kerf))
        message = (
            f"{outline.spec.name}: {count} micro-joints of {outline.spec.joint_mm:g} mm leave nothing to cut "
        )
        message += f"between them; at most {max_joints} fit on {length / MM:.1f} mm"
        raise issue_error(
            "trim.joints", message, value=count, limit=max_joints, hint=f"use joints: {max_joints}"
        )
    centre_line = CentreLine(along, ring, unit(np.concatenate([into_waste, into_waste[:1]])))
    best: tuple[float, list[Slot]] | None = None
    for start in length * np.arange(START_TRIALS) / START_TRIALS:
        candidates = [
            _build_slot(
                op, outline, face, centre_line, _SlotSpan(start + k * length / count, length / count, gap, k)
            )
            for k in range(count)
        ]
        margin = min(_lead_margin(op, slot, outline, others, half_kerf) for slot in candidates)
        if best is None or margin > best[0] + 1e-9:
            best = margin, candidates
        if best is not None and best[0] >= op.lead.length_mm * MM:
            break  # more margin is of no use
    if best is None or best[0] < 0.0:
        missing = 0.0 if best is None else -best[0]
        fitting_mm = max(op.lead.length_mm - missing / MM, 0.0)
        message = f"{outline.spec.name}: no lead-in of {op.lead.length_mm:g} mm with the pierce point "
        message += (
            f"{op.pierce.off_mm:g} mm from all curves fits into the waste; {missing / MM:.2f} mm missing"
        )
        hint = f"use a shorter lead.length_mm or pierce.off_mm (about {fitting_mm:.1f}), or a narrower kerf"
        raise issue_error("trim.lead", message, value=missing / MM, limit=0.0, unit="mm", hint=hint)
    return best[1]


def _check_closed(outline: PlannedOutline, middle: FloatArray, half_kerf: float, tolerance: float) -> None:
    """Check that a slot with the centre line ``middle`` (M, 3) [m] closes and cuts all of the curve.

    Raises:
        TandemError: ``trim.narrow`` if the slot does not close, because the waste is narrower than the kerf;
            ``trim.corner`` if it leaves more than ``tolerance`` [m] of a corner.
    """
    step = np.linalg.norm(np.diff(np.concatenate([middle, middle[:1]]), axis=0), axis=1) if len(middle) else 0
    # a centre line that shrinks to a point encloses nothing
    goes_round = len(middle) >= 8 and float(np.sum(step)) > MIN_LENGTH_FACTOR * half_kerf
    if not goes_round or float(np.max(step)) > MAX_GAP_M:
        where = middle[int(np.argmax(step))] if goes_round else outline.curve.point.mean(axis=0)
        message = (
            f"{outline.spec.name}: about ({where[0] / MM:.1f}, {where[1] / MM:.1f}) mm the waste is narrower "
        )
        message += f"than the kerf of {2.0 * half_kerf / MM:g} mm, so that its slot does not close"
        raise issue_error(
            "trim.narrow",
            message,
            limit=2.0 * half_kerf / MM,
            unit="mm",
            hint="widen it there, or use a narrower kerf",
        )
    residual = curve_distance(outline.curve.point, middle) - half_kerf
    k = int(np.argmax(residual))
    if residual[k] > tolerance:
        x, y, _ = outline.curve.point[k] / MM
        message = f"{outline.spec.name}: in the corner at ({x:.1f}, {y:.1f}) mm a round slot leaves "
        message += f"{residual[k] / MM:.2f} mm, allowed {tolerance / MM:g} mm"
        hint = (
            f"round the corner with {half_kerf / MM:g} mm or more, or use shape_tol_mm: "
            f"{residual[k] / MM + 0.01:.2f}"
        )
        value, limit = float(residual[k]) / MM, tolerance / MM
        raise issue_error("trim.corner", message, value=value, limit=limit, unit="mm", hint=hint)


@dataclasses.dataclass(frozen=True)
class CentreLine:
    """Closed centre line of a slot. The first of its N points is repeated at the end.

    Attributes:
        along: Length along it up to each point (N,) [m].
        point: Points (N, 3) [m].
        into_waste: Directions into the waste (N, 3).
    """

    along: FloatArray
    point: FloatArray
    into_waste: FloatArray


@dataclasses.dataclass(frozen=True)
class _SlotSpan:
    """Part of a centre line that one slot takes.

    Attributes:
        start: Length along the centre line at which it starts [m].
        spacing: Length from its start to that of the next span [m].
        gap: Length between two slots that is not cut [m], 0 for a slot all the way round.
        number: Number of the slot on the centre line, from 0.
    """

    start: float
    spacing: float
    gap: float
    number: int


def _build_slot(
    op: Trim, outline: PlannedOutline, face: SheetFace, centre_line: CentreLine, span: _SlotSpan
) -> Slot:
    """Build the slot of a span, with its leads.

    It starts half a gap after the start of its span, and ends half a gap before the next span. It then has no
    lead-out, because it ends at a micro-joint. A slot without a gap goes all the way round, ends slightly
    past its own start and has a lead-out.
    """
    along, ring_points, directions = centre_line.along, centre_line.point, centre_line.into_waste
    start, gap = span.start, span.gap
    length = float(along[-1])
    low = start + 0.5 * gap
    high = start + span.spacing - 0.5 * gap if gap else start + length + op.lead.overcut_mm * MM
    # the centre line's own lengths in three revolutions, because a span may go beyond its end
    own_lengths = np.concatenate([along[:-1] + revolution * length for revolution in range(3)])
    inner = own_lengths[(own_lengths > low + 1e-6) & (own_lengths < high - 1e-6)]
    lengths = np.concatenate([[low], inner, [high]]) % length
    point = np.stack([np.interp(lengths, along, ring_points[:, k]) for k in range(3)], axis=1)
    into_waste = unit(
        np.stack([np.interp(lengths[[0, -1]], along, directions[:, k]) for k in range(3)], axis=1)
    )
    lead_in = _lead_in(op, point[0], into_waste[0], unit((point[1] - point[0])[None])[0])
    out_length = op.lead.out_mm * MM if not gap else 0.0
    steps = (
        np.linspace(0.0, 1.0, max(int(np.ceil(out_length / LEAD_SPACING_M)), 1) + 1)[1:, None] * out_length
    )
    lead_out = point[-1] + steps * into_waste[1] if out_length else np.zeros((0, 3))
    on_face, normal = face.at(np.concatenate([lead_in, point, lead_out])[:, :2])
    name = outline.spec.name if not gap else f"{outline.spec.name}_p{span.number + 1}"
    return Slot(name, outline.spec.name, on_face, normal, len(lead_in), len(lead_in) + len(point) - 1)


def _lead_in(op: Trim, end: FloatArray, into_waste: FloatArray, direction: FloatArray) -> FloatArray:
    """Return points (K, 3) [m] of a lead-in to ``end`` (3,), without that point.

    ``into_waste`` and ``direction`` (3,) are unit vectors at ``end``, the latter along the slot.
    """
    length = op.lead.length_mm * MM
    count = max(int(np.ceil(length / LEAD_SPACING_M)), MIN_LEAD_POINTS)
    if op.lead.shape == "line":
        return np.asarray(end + np.linspace(length, 0.0, count + 1)[:-1, None] * into_waste)
    angles = np.linspace(0.5 * np.pi, 0.0, 2 * count + 1)[:-1, None]
    return np.asarray(end + length * ((1.0 - np.cos(angles)) * into_waste - np.sin(angles) * direction))


def _lead_margin(
    op: Trim, slot: Slot, outline: PlannedOutline, others: list[PlannedOutline], half_kerf: float
) -> float:
    """Return the margin [m] of a slot's pierce point and leads, negative if they are too near to a curve.

    The pierce point has to keep its distance from all curves, the leads only from the curve of the slot.
    """
    leads = np.concatenate([slot.point[: slot.first], slot.point[slot.last + 1 :]])
    distances = np.where(outline.in_waste(leads[:, :2]), 1.0, -1.0) * curve_distance(
        leads, outline.curve.point
    )
    margin = min(
        float(distances[0]) - op.pierce.off_mm * MM, float(distances.min()) - half_kerf + LEAD_MARGIN_M
    )
    for other in others:
        margin = min(margin, float(curve_distance(leads[:1], other.curve.point)[0]) - op.pierce.off_mm * MM)
    return margin
