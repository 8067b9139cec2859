"""What must hold of cuts with a straight wire before they are planned: corners, kerfs, the bow's room, the
holder's plate.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray, Ruled, Shape, corners, inverse, transform
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity
from planner.problem import Part, Setup
from planner.processes.hotwire.plan.kerf import width as kerfs
from planner.processes.hotwire.plan.kerf.width import KerfFlag, explain
from planner.processes.hotwire.plan.operation import Straight
from planner.processes.hotwire.plan.straight.cut import Cut
from planner.processes.hotwire.plan.straight.gouge_check import check_spared
from planner.processes.hotwire.plan.straight.order import (
    Lines,
    chord,
    distance_to_polyline,
    exit_length,
    gripper_holds,
    grown,
    pieces_across,
    place_text,
)
from planner.reading import grip_choice
from planner.tooling import Bow

GOUGE_SHARE: Final = 0.3
"""Share of the tolerance by which a wire may come nearer to its surface than half a kerf."""
NEGLIGIBLE_LENGTH: Final = 1e-9
"""Lengths [m] below this are rounding."""
BOW_TURNS: Final = 72
"""Turns of the bow about the wire that are looked at for room behind the wire."""
HOLDER_PLACES: Final = 65
"""Places along a wire at which its distance to the holder is looked at."""


def check_cut(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    """Issues of one cut's shape among all surfaces of the part: straight.corner, straight.crossing,
    straight.slit and straight.lead; none where the wires stand for no true way."""
    if not cut.on.settled:
        return
    yield from _tight(op, cut)
    yield from _crossing(op, cut)
    yield from _slit(op, cut, ruled, box)
    yield from check_spared(op, cut, ruled, box)


def _tight(op: Straight, cut: Cut) -> Iterator[Issue]:
    """Inner curves tighter than half a kerf cannot be cut."""
    made, name = cut.on, cut.wanted.segment
    lines, foot = made.lines, made.row.foot
    for ends, feet, e in ((lines.start, foot.start, 0), (lines.end, foot.end, 1)):
        move, way = np.diff(ends, axis=0), np.diff(feet, axis=0)
        back = (np.sum(move * way, axis=1) < 0.0) & (np.linalg.norm(way, axis=1) > 1e-7)
        if back.any():
            k = int(np.argmax(back))
            yield Issue(
                "straight.corner",
                f"{op.name}: {name} is bent inward more tightly than half a kerf, {made.half[k, e] / MM:.2f} "
                f"mm, at {place_text(feet[k])}; take a thinner slot, or a larger radius there",
                field=str(name),
                **measurement(float(made.half[k, e] / MM), None, "mm"),
            )
            return


def _crossing(op: Straight, cut: Cut) -> Iterator[Issue]:
    """No wire comes nearer to the surface, wherever on it, than half its kerf."""
    made, ruled = cut.on, cut.wanted.ruled
    allowed = GOUGE_SHARE * op.shape_tol_mm * MM
    lines = made.lines
    for points, guide, e in ((lines.start, ruled.start, 0), (lines.end, ruled.end, 1)):
        line = np.concatenate([guide, guide[:1]]) if ruled.closed else guide
        near = made.half[:, e] - distance_to_polyline(points, line)
        k = int(np.argmax(near))
        if near[k] > allowed:
            yield Issue(
                "straight.crossing",
                f"{op.name}: beside {cut.wanted.segment} the wire at {place_text(points[k])} takes "
                f"{near[k] / MM:.2f} mm off another piece of the same surface: it crosses itself, or a gap "
                "is narrower than the slot; take a thinner slot or change the outline",
                field=str(cut.wanted.segment),
                **measurement(float(near[k] / MM), allowed / MM, "mm"),
            )
            return


def _slit(op: Straight, cut: Cut, ruled: tuple[Ruled, ...], box: FloatArray) -> Iterator[Issue]:
    start = cut.start
    if start is None or start.through < 1e-4:
        return
    what = f"{op.name}: the wire comes to {cut.wanted.segment} through the part"
    place = place_text(cut.on.row.foot.start[0])
    how = f"a slit of {start.through / MM:.1f} mm, along {_way(start.way)} from {place}"
    if cut.wanted.ruled.hole or pieces_across(cut.wanted.ruled, ruled, box, 0.5).enclosed:
        yield Issue(
            "straight.slit",
            f"{what}: {how}; glue it, or cut the part in two there",
            Severity.NOTE,
            field=str(cut.wanted.segment),
            **measurement(start.through / MM, None, "mm"),
        )
        return
    yield Issue(
        "straight.lead",
        f"{what}: {how}; give another lead, or move the pieces apart",
        field=str(cut.wanted.segment),
        **measurement(start.through / MM, 0.0, "mm"),
    )


def check_model(op: Straight, setup: Setup, bow: Bow, cuts: list[Cut], thickness: float) -> Iterator[Issue]:
    """What the kerf model says against its own figures, as a warning."""
    foam = setup.stock.foam
    if op.power_w is None or foam is None:
        return
    wire = kerfs.HotWire(2.0 * bow.radius, bow.span)
    speed = np.concatenate([cut.on.speed.ravel() for cut in cuts])
    made = kerfs.width(foam, wire, op.power_w, np.maximum(speed, 1e-3), thickness)
    flag = int(np.bitwise_or.reduce(made.flag)) & ~int(KerfFlag.TOO_HOT | KerfFlag.TOO_COLD)
    if flag:
        spread = float((made.high - made.low).max() / 2.0 / MM)
        yield Issue(
            "kerf.doubt",
            f"{op.name}: the kerf in {foam.name} is not sure: {'; '.join(explain(flag))}. Nine cuts of ten "
            f"are within {spread:.2f} mm of it",
            Severity.WARNING,
            field="operations.power_w",
            **measurement(spread, None, "mm"),
            hint="make test cuts, see tandem kerf fit, or state their kerf_mm instead of power_w",
        )


def check_bow(
    op: Straight, bow: Bow, lines: Lines, segment: tuple[Segment, ...], box: FloatArray, pose: FloatArray
) -> Iterator[Issue]:
    """The wire is long enough between its clamps, and the beam has room behind it at some turn of the bow."""
    first, last = chord(lines, grown(box, op.margin_mm * MM))
    need = np.where(np.isfinite(first), last - first, 0.0)
    k = int(np.argmax(need))
    if need[k] > bow.span + NEGLIGIBLE_LENGTH:
        what = f"{op.name}: in {segment[k]} the foam and {op.margin_mm:g} mm at both ends need a wire of "
        what += f"{np.ceil((need[k] - NEGLIGIBLE_LENGTH) / MM):.0f} mm, but the bow's is {bow.span / MM:.0f} "
        what += "mm; take a wider bow or a smaller block, or let the wire run along another axis"
        yield Issue("bow.span", what, index=k, **measurement(float(need[k] / MM), bow.span / MM, "mm"))
    inside = np.flatnonzero(np.isfinite(chord(lines, box)[0]))
    if not inside.size:
        return
    depth = _depth(lines[inside], pose[inside], box, op.margin_mm * MM)
    k = int(np.argmax(depth))
    if depth[k] > bow.throat:
        deeper = np.ceil((depth[k] - bow.throat) / MM)
        yield Issue(
            "bow.throat",
            f"{op.name}: in {segment[inside[k]]} the block reaches {depth[k] / MM:.0f} mm behind the wire "
            f"on every side, but the bow's throat is free for {bow.throat / MM:.0f} mm; take a bow that is "
            f"{deeper:.0f} mm deeper (throat_mm: {bow.stated_throat / MM + deeper:.0f}), or a smaller block",
            index=int(inside[k]),
            **measurement(float(depth[k] / MM), bow.throat / MM, "mm"),
        )


def _depth(lines: Lines, pose: FloatArray, box: FloatArray, margin: float) -> FloatArray:
    """Least depth (N,) [m] of the block behind the wires over all turns of the bow."""
    angle = 2.0 * np.pi * np.arange(BOW_TURNS) / BOW_TURNS
    best = np.full(len(lines), np.inf)
    wide = grown(box, 0.1 * margin)
    for a in angle:
        way = np.cos(a) * pose[:, :3, 2] + np.sin(a) * pose[:, :3, 1]
        best = np.minimum(best, exit_length(lines, way, wide))
    return best


def check_holder(
    op: Straight, setup: Setup, part: Part | None, cuts: list[Cut], lines: Lines, segment: tuple[Segment, ...]
) -> Iterator[Issue]:
    """No wire that cuts comes within the margin of the plate that holds the block, and what is cut free is
    what the plate holds."""
    holder = setup.stock.held_by
    if holder is None:
        return
    tool = setup.cell.arm(holder).tool
    outlines = [c.wanted.ruled for c in cuts if c.wanted.ruled.closed and not c.wanted.ruled.hole]
    foot = inverse(setup.stock.grip)[:3, 3]
    if outlines and not any(gripper_holds(outline, foot) for outline in outlines):
        yield Issue(
            "stock.footprint",
            f"{op.name}: {tool.name} holds the block at {place_text(foot)}, beside {outlines[0].name}, so "
            "that the part falls when it is cut free; move the grip below the part",
            field="stock.grip",
            arm=holder,
            hint=grip_choice.advice(setup, part, op.margin_mm * MM),
        )
        return
    to_stock = inverse(setup.stock.grip) @ inverse(tool.tcp)
    cutting = np.array([one.kind == "cut" for one in segment])
    for shape in tool.shapes:
        own = inverse(to_stock @ shape.pose)
        local = Lines(transform(own, lines.start), transform(own, lines.end))
        hit = cutting & (_to_shape(local, shape, op.margin_mm * MM) < op.margin_mm * MM)
        if hit.any():
            k = int(np.argmax(hit))
            yield Issue(
                "stock.footprint",
                f"{op.name}: in {segment[k]} the wire comes nearer than {op.margin_mm:g} mm to {tool.name}, "
                "which holds the block; take a smaller gripper, or move the grip away from the part's edges",
                field="stock.grip",
                arm=holder,
                index=k,
                limit=op.margin_mm,
                unit="mm",
                hint=grip_choice.advice(setup, part, op.margin_mm * MM),
            )
            return


def _to_shape(lines: Lines, shape: Shape, far: float) -> FloatArray:
    """Distance (N,) [m] of lines to a shape, in its frame, where it is below ``far`` [m], else infinity;
    sampled. Round shapes count as cylinders, meshes as boxes."""
    extent = corners(shape)
    box = np.stack([extent.min(axis=0), extent.max(axis=0)])
    first, last = chord(lines, grown(box, far))
    out = np.full(len(lines), np.inf)
    near = np.flatnonzero(np.isfinite(first))
    share = np.linspace(0.0, 1.0, HOLDER_PLACES)[None, :, None]
    ends = [lines[near].at(length[near])[:, None] for length in (first, last)]
    points = ends[0] + share * (ends[1] - ends[0])
    gap = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
    if shape.kind in ("cylinder", "capsule", "sphere"):
        radial = np.linalg.norm(points[..., :2], axis=2) - shape.size[0]
        gap = np.stack([np.maximum(radial, 0.0), gap[..., 2]], axis=2)
    out[near] = np.linalg.norm(gap, axis=2).min(axis=1)
    return out


def _way(direction: FloatArray) -> str:
    return "[" + ", ".join(f"{value:.2f}" for value in direction + 0.0) + "]"
