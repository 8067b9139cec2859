"""Checks of planned cuts with a straight wire, before the arms' motion is planned.

They concern corners, kerfs, span and throat of the bow, and the gripper that holds the block.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, RuledSurface, Shape, hull_points, inverse, transform
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.problem import Part, Setup
from planner.processes.hotwire.plan.kerf import width as kerfs
from planner.processes.hotwire.plan.kerf.width import KerfFlag, explain
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight.cut import StraightCut
from planner.processes.hotwire.plan.straight.gouge_check import check_other_surfaces
from planner.processes.hotwire.plan.straight.order import (
    WireLines,
    box_chord,
    distance_to_polyline,
    enlarged_box,
    exit_distance,
    gripper_holds,
    neighbour_pieces,
    point_text,
)
from planner.reading import grip_choice
from planner.tooling import Bow

GOUGE_TOLERANCE_FRACTION: Final = 0.3
"""Amount by which a wire may come closer to its surface than half a kerf, as a fraction of the tolerance."""
LENGTH_TOLERANCE_M: Final = 1e-9
"""Differences of lengths [m] below this are rounding errors."""
BOW_ROTATION_SAMPLES: Final = 72
"""Number of rotations of the bow about the wire at which the depth behind the wire is checked."""
HOLDER_SAMPLES: Final = 65
"""Number of points along a wire at which its distance to the holder is checked."""


def check_cut(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield issues of one cut: curves that are too tight, and foam that it removes from other surfaces.

    Codes: ``straight.corner``, ``straight.crossing``, ``straight.slit``, ``straight.lead``. Yields nothing if
    the half kerfs of the cut have not converged, because its wires then are not a real path.

    Args:
        op: Operation with a straight wire.
        cut: The cut.
        ruled: All ruled surfaces of the part.
        box: Lower and upper corner of the block (2, 3) [m].
    """
    if not cut.on.converged:
        return
    yield from _tight_curve_issues(op, cut)
    yield from _self_crossing_issues(op, cut)
    yield from _slit_issues(op, cut, ruled, box)
    yield from check_other_surfaces(op, cut, ruled, box)


def _tight_curve_issues(op: Straight, cut: StraightCut) -> Iterator[Issue]:
    """Yield ``straight.corner`` at an inner curve with a radius below half a kerf, which cannot be cut.

    There a guide point of the wire moves back while the end of the ruling moves on. Moves of less than 1e-7 m
    on the surface do not count. At most one issue is yielded.
    """
    offset, name = cut.on, cut.nominal.segment
    lines, foot = offset.lines, offset.row.foot
    for ends, feet, end in ((lines.start, foot.start, 0), (lines.end, foot.end, 1)):
        move, ruling_move = np.diff(ends, axis=0), np.diff(feet, axis=0)
        is_reversed = (np.sum(move * ruling_move, axis=1) < 0.0) & (
            np.linalg.norm(ruling_move, axis=1) > 1e-7
        )
        if is_reversed.any():
            k = int(np.argmax(is_reversed))
            yield Issue(
                "straight.corner",
                f"{op.name}: the inner radius of {name} at {point_text(feet[k])} is below half a kerf, "
                f"{offset.half[k, end] / MM:.2f} mm; use a thinner slot, or a larger radius there",
                field=str(name),
                **measurement(float(offset.half[k, end] / MM), None, "mm"),
            )
            return


def _self_crossing_issues(op: Straight, cut: StraightCut) -> Iterator[Issue]:
    """Yield ``straight.crossing`` if a wire comes closer to any part of its surface than half its kerf.

    A fraction `GOUGE_TOLERANCE_FRACTION` of the tolerance is allowed. At most one issue is yielded.
    """
    offset, ruled = cut.on, cut.nominal.ruled
    allowed = GOUGE_TOLERANCE_FRACTION * op.shape_tol_mm * MM
    lines = offset.lines
    for points, guide, end in ((lines.start, ruled.start, 0), (lines.end, ruled.end, 1)):
        line = np.concatenate([guide, guide[:1]]) if ruled.closed else guide
        overlap = offset.half[:, end] - distance_to_polyline(points, line)
        k = int(np.argmax(overlap))
        if overlap[k] > allowed:
            yield Issue(
                "straight.crossing",
                f"{op.name}: next to {cut.nominal.segment} the wire at {point_text(points[k])} removes "
                f"{overlap[k] / MM:.2f} mm of another piece of the same surface: it crosses itself, or a gap "
                "is narrower than the slot; use a thinner slot or change the outline",
                field=str(cut.nominal.segment),
                **measurement(float(overlap[k] / MM), allowed / MM, "mm"),
            )
            return


def _slit_issues(
    op: Straight, cut: StraightCut, ruled: tuple[RuledSurface, ...], box: FloatArray
) -> Iterator[Issue]:
    """Yield an issue for the slit by which the wire reaches a closed cut through the part.

    The slit is unavoidable for a hole and for a piece inside a hole, and the note ``straight.slit`` states
    it. For an outline it is the error ``straight.lead``. Slits of less than 0.1 mm are not reported.
    """
    start = cut.start
    if start is None or start.length_in_part < 1e-4:
        return
    position, direction = point_text(cut.on.row.foot.start[0]), _direction_text(start.direction)
    if cut.nominal.ruled.hole or neighbour_pieces(cut.nominal.ruled, ruled, box, 0.5).enclosed:
        yield Issue(
            "straight.slit",
            format_message(
                "straight.slit",
                operation=op.name,
                segment=cut.nominal.segment,
                length_mm=start.length_in_part / MM,
                direction=direction,
                position=position,
            ),
            Severity.NOTE,
            field=str(cut.nominal.segment),
            **measurement(start.length_in_part / MM, None, "mm"),
        )
        return
    yield Issue(
        "straight.lead",
        f"{op.name}: the wire reaches {cut.nominal.segment} through the part: a slit of "
        f"{start.length_in_part / MM:.1f} mm, along {direction} from {position}; state another lead, or move "
        "the pieces apart",
        field=str(cut.nominal.segment),
        **measurement(start.length_in_part / MM, 0.0, "mm"),
    )


def check_model(
    op: Straight, setup: Setup, bow: Bow, cuts: list[StraightCut], thickness: float
) -> Iterator[Issue]:
    """Yield the warning ``kerf.doubt`` if the kerf model flags its own result as unreliable.

    Args:
        op: Operation with a straight wire.
        setup: Setup that the operation finds.
        bow: The bow.
        cuts: All cuts.
        thickness: Thickness of the foam along the wire [m].
    """
    foam = setup.stock.foam
    if op.power_w is None or foam is None:
        return
    wire = kerfs.HotWire(2.0 * bow.radius, bow.span)
    speed = np.concatenate([cut.on.speed.ravel() for cut in cuts])
    estimate = kerfs.width(foam, wire, op.power_w, np.maximum(speed, 1e-3), thickness)
    flag = int(np.bitwise_or.reduce(estimate.flag)) & ~int(KerfFlag.TOO_HOT | KerfFlag.TOO_COLD)
    if flag:
        spread = float((estimate.high - estimate.low).max() / 2.0 / MM)
        yield Issue(
            "kerf.doubt",
            format_message(
                "kerf.doubt",
                operation=op.name,
                foam=foam.name,
                reasons="; ".join(explain(flag)),
                spread_mm=spread,
            ),
            Severity.WARNING,
            field="operations.power_w",
            **measurement(spread, None, "mm"),
            hint="make test cuts (see tandem kerf fit), or state kerf_mm instead of power_w",
        )


def check_bow(
    op: Straight, bow: Bow, lines: WireLines, segment: tuple[Segment, ...], box: FloatArray, pose: FloatArray
) -> Iterator[Issue]:
    """Yield ``bow.span`` if the wire is too short, and ``bow.throat`` if the beam is too close to it.

    The wire has to span the block and a margin at both ends. The beam has to clear the block at some rotation
    of the bow about the wire, which is checked for wires that meet the block.

    Args:
        op: Operation with a straight wire.
        bow: The bow.
        lines: N wires of the job.
        segment: Segment of each wire (N,).
        box: Lower and upper corner of the block (2, 3) [m].
        pose: Poses of the bow (N, 4, 4).
    """
    first, last = box_chord(lines, enlarged_box(box, op.margin_mm * MM))
    required_span = np.where(np.isfinite(first), last - first, 0.0)
    k = int(np.argmax(required_span))
    if required_span[k] > bow.span + LENGTH_TOLERANCE_M:
        message = f"{op.name}: in {segment[k]} the foam and {op.margin_mm:g} mm at both ends need a wire of "
        message += (
            f"{np.ceil((required_span[k] - LENGTH_TOLERANCE_M) / MM):.0f} mm, but the bow has "
            f"{bow.span / MM:.0f} "
        )
        message += "mm; use a wider bow or a smaller block, or let the wire run along another axis"
        yield Issue(
            "bow.span", message, index=k, **measurement(float(required_span[k] / MM), bow.span / MM, "mm")
        )
    inside = np.flatnonzero(np.isfinite(box_chord(lines, box)[0]))
    if not inside.size:
        return
    depth = _min_block_depth(lines[inside], pose[inside], box, op.margin_mm * MM)
    k = int(np.argmax(depth))
    if depth[k] > bow.throat:
        deeper = np.ceil((depth[k] - bow.throat) / MM)
        yield Issue(
            "bow.throat",
            format_message(
                "bow.throat",
                operation=op.name,
                segment=segment[inside[k]],
                depth_mm=depth[k] / MM,
                free_throat_mm=bow.throat / MM,
                missing_mm=deeper,
                required_throat_mm=bow.stated_throat / MM + deeper,
            ),
            index=int(inside[k]),
            **measurement(float(depth[k] / MM), bow.throat / MM, "mm"),
        )


def _min_block_depth(lines: WireLines, pose: FloatArray, box: FloatArray, margin: float) -> FloatArray:
    """Return the depth (N,) [m] of the block between each wire and the bow's beam, at the best rotation.

    `check_bow` compares this depth with the free throat between wire and beam. The bow may rotate about the
    wire, which is the x axis of its pose. The beam then lies in a direction in the plane of its y and z axes.
    Of `BOW_ROTATION_SAMPLES` rotations, the one with the smallest depth counts.

    Args:
        lines: N wires.
        pose: Poses of the bow (N, 4, 4).
        box: Lower and upper corner of the block (2, 3) [m].
        margin: Margin of the operation [m].
    """
    angle = 2.0 * np.pi * np.arange(BOW_ROTATION_SAMPLES) / BOW_ROTATION_SAMPLES
    best = np.full(len(lines), np.inf)
    enlarged = enlarged_box(box, 0.1 * margin)  # chosen: a tenth of the margin between block and beam
    for a in angle:
        direction = np.cos(a) * pose[:, :3, 2] + np.sin(a) * pose[:, :3, 1]
        best = np.minimum(best, exit_distance(lines, direction, enlarged))
    return best


def check_holder(
    op: Straight,
    setup: Setup,
    part: Part | None,
    cuts: list[StraightCut],
    lines: WireLines,
    segment: tuple[Segment, ...],
) -> Iterator[Issue]:
    """Yield ``stock.footprint`` if a cutting wire comes closer to the holding gripper than the margin.

    It is also yielded, alone, if the gripper holds none of the pieces that are cut free. Nothing is yielded
    if no arm holds the block.

    Args:
        op: Operation with a straight wire.
        setup: Setup that the operation finds.
        part: Part, if the problem has one.
        cuts: All cuts.
        lines: N wires of the job.
        segment: Segment of each wire (N,).
    """
    holder = setup.stock.held_by
    if holder is None:
        return
    tool = setup.cell.arm(holder).tool
    outlines = [c.nominal.ruled for c in cuts if c.nominal.ruled.closed and not c.nominal.ruled.hole]
    foot = inverse(setup.stock.grip)[:3, 3]
    if outlines and not any(gripper_holds(outline, foot) for outline in outlines):
        yield Issue(
            "stock.footprint",
            f"{op.name}: {tool.name} holds the block at {point_text(foot)}, next to {outlines[0].name}, so "
            "that the part falls when it is cut free; move the grip below the part",
            field="stock.grip",
            arm=holder,
            hint=grip_choice.grip_advice(setup, part, op.margin_mm * MM),
        )
        return
    to_stock = inverse(setup.stock.grip) @ inverse(tool.tcp)
    cutting = np.array([item.kind == "cut" for item in segment])
    for shape in tool.shapes:
        to_shape = inverse(to_stock @ shape.pose)
        local = WireLines(transform(to_shape, lines.start), transform(to_shape, lines.end))
        is_too_close = cutting & (_distance_to_shape(local, shape, op.margin_mm * MM) < op.margin_mm * MM)
        if is_too_close.any():
            k = int(np.argmax(is_too_close))
            yield Issue(
                "stock.footprint",
                f"{op.name}: in {segment[k]} the wire comes closer than {op.margin_mm:g} mm to {tool.name}, "
                "which holds the block; use a smaller gripper, or move the grip away from the part's edges",
                field="stock.grip",
                arm=holder,
                index=k,
                limit=op.margin_mm,
                unit="mm",
                hint=grip_choice.grip_advice(setup, part, op.margin_mm * MM),
            )
            return


def _distance_to_shape(lines: WireLines, shape: Shape, max_distance: float) -> FloatArray:
    """Return the distance (N,) [m] of lines to a shape of the holding gripper, both in the shape's frame.

    The distance is the smallest one of points sampled along each line. It is infinite for lines that miss the
    shape's box enlarged by ``max_distance``. Round shapes count as cylinders, meshes as boxes.
    """
    extent = hull_points(shape)
    box = np.stack([extent.min(axis=0), extent.max(axis=0)])
    first, last = box_chord(lines, enlarged_box(box, max_distance))
    out = np.full(len(lines), np.inf)
    candidates = np.flatnonzero(np.isfinite(first))
    fraction = np.linspace(0.0, 1.0, HOLDER_SAMPLES)[None, :, None]
    ends = [lines[candidates].at(length[candidates])[:, None] for length in (first, last)]
    points = ends[0] + fraction * (ends[1] - ends[0])
    gap = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
    if shape.kind in ("cylinder", "capsule", "sphere"):
        radial = np.linalg.norm(points[..., :2], axis=2) - shape.size[0]
        gap = np.stack([np.maximum(radial, 0.0), gap[..., 2]], axis=2)
    out[candidates] = np.linalg.norm(gap, axis=2).min(axis=1)
    return out


def _direction_text(direction: FloatArray) -> str:
    return "[" + ", ".join(f"{value:.2f}" for value in direction + 0.0) + "]"
