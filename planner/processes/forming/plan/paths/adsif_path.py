"""Paths of both tools in ADSIF: at the sheet's level from the inside out, the part sinking behind.

The way of the forming tool in single point forming is projected on a plane: its tip goes the
projection distance below the flat sheet's face. What lies inside a contour moves on as one rigid
piece, so a contour needs no depth, but the wall angle there, which the response table turns into
position angle and gap. Loops are the pitch apart: the level lines of the face at steps of pitch
tan(a), a being the mean wall angle about the level. Source: the dissertation named in
`adsif_response`, section 3.2.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np

from planner.catalogue.materials import SheetMetal
from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh, corner_normals
from planner.geometry.units import DEG, MM
from planner.issues import refusal
from planner.processes.forming.plan.contact import CREASE_ANGLE, MIRROR, ContactPath, Pass, ToolPath
from planner.processes.forming.plan.operation import Adsif, Forming
from planner.processes.forming.plan.paths.adsif_response import (
    Conditions,
    Response,
    between_centres,
    built_in_table,
    compensated,
    deflection,
    invert,
    left_to_command,
    read_table,
    require,
)
from planner.processes.forming.plan.paths.level_lines import Loop, cut, loops
from planner.tooling import FormingHead

EDGE_MARGIN: Final = 1e-5
"""The first and the last loop keep so far [m] from the ends of the wall."""
ANGLE_CELL: Final = 1e-4
"""Heights [m] over which the mean wall angle of a level is taken."""
MOST_LOOPS: Final = 5000
"""Loops of one pass at most."""
WALL_ANGLE_STEP: Final = 0.01 * DEG
"""Angles [rad] of walls, so far apart, are asked what a table holds at most."""


def adsif_tool_path(
    one: Pass,
    operation: Forming,
    former: FormingHead,
    support: FormingHead,
    thickness: float,
    metal: SheetMetal,
) -> ToolPath:
    """Both tools over a feature. ``thickness`` [m] of the sheet; the gap [m] is as commanded, so with the
    give of the tools taken off.

    The contact's points are those of the wanted part, not of the sheet at that instant. Raises
    ``TandemError`` with the codes ``forming.adsif_*`` where the table does not reach, and
    ``forming.support_tool`` for tools that differ or are no balls.
    """
    ball = former.kind == support.kind == "ball"
    if not ball or abs(former.radius - support.radius) > 1e-5:
        got = " and ".join(f"a {one.kind} of {one.radius / MM:g} mm" for one in (former, support))
        what = (
            f"mode adsif needs two balls of one radius, got {got}; mount a ball of {former.radius / MM:g} mm "
            "on both arms"
        )
        raise refusal("forming.support_tool", what, field="mode")
    response = _response(operation)
    held = operation.adsif
    wanted = Conditions(metal.name, thickness, former.radius, held.pitch_mm * MM, held.projection_mm * MM)
    require(response, wanted)
    if one.side < 0:
        vertices, start, end = one.vertices * MIRROR, -one.start, -one.end
        one = dataclasses.replace(one, side=1, vertices=vertices, start=start, end=end)
        return _mirrored(adsif_tool_path(one, operation, former, support, thickness, metal))
    contact = _contact(one, former.radius, operation)
    position, gap = _commanded(response, contact.angle, held, thickness)
    across, down = between_centres(position, gap, former.radius, support.radius)
    outward = -contact.normal[:, :2] / np.linalg.norm(contact.normal[:, :2], axis=1, keepdims=True)
    level = one.start - held.projection_mm * MM + former.radius
    place = np.column_stack([contact.centre[:, :2], np.full(len(across), level)])
    below = place + np.column_stack([across[:, None] * outward, -down])
    axis = np.tile([0.0, 0.0, -1.0], (len(place), 1))
    return ToolPath(place, axis, below, -axis, gap, dataclasses.replace(contact, centre=place))


def pressed_by_support(operation: Forming, radii: float, thickness: float) -> float:
    """How far [m] the support presses the flat sheet around at most for any wall of the response table, by
    the geometry in `adsif`: its way of forming, for the forming ball's tip stays at the projection distance.
    ``radii`` [m] of both balls together, ``thickness`` [m] of the sheet."""
    response, held = _response(operation), operation.adsif
    low, high = response.range
    wall = np.append(np.arange(low, high, WALL_ANGLE_STEP), high)
    position, gap = invert(response, wall, held.prefer)
    gap = left_to_command(gap * thickness, position, _yielded(held))
    able = gap > 0.0  # of other walls the path says that nothing of their gap is left
    if not able.any():
        return 0.0
    _, down = between_centres(position[able], gap[able], radii, 0.0)
    return float(thickness - held.projection_mm * MM + radii - down.min())


def _yielded(held: Adsif) -> float:
    """How far [m] both tools give way in the plane of the sheet, by the stated force and stiffness."""
    if held.force_n <= 0.0 or held.stiffness_n_mm is None:
        return 0.0
    return float(deflection(held.force_n, held.stiffness_n_mm / MM))


def _commanded(
    response: Response, wall: FloatArray, held: Adsif, thickness: float
) -> tuple[FloatArray, FloatArray]:
    """Position angles [rad] and gaps [m] as commanded (N,) for wall angles (N,) [rad]."""
    position, gap = invert(response, wall, held.prefer)
    gap, yielded = gap * thickness, _yielded(held)
    return position, compensated(gap, position, yielded) if yielded > 0.0 else gap


def _response(operation: Forming) -> Response:
    return built_in_table() if operation.adsif.file is None else read_table(operation.adsif.file)


def _contact(one: Pass, radius: float, operation: Forming) -> ContactPath:
    """Contacts of the ball on the face, loop by loop from the feature's end to its start."""
    mesh = TriangleMesh(one.vertices, one.faces)
    levels = _levels(one, operation.adsif.pitch_mm * MM)
    smooth = corner_normals(mesh, CREASE_ANGLE)
    found = loops(cut(mesh.vertices, mesh.faces, smooth, levels), None, one.name)
    by_level: dict[int, Loop] = {}
    for loop in found:
        held = by_level.get(loop.level)
        if held is None or abs(loop.area()) > abs(held.area()):
            by_level[loop.level] = loop
    way = 1.0 if operation.direction == "ccw" else -1.0
    rings = [by_level[k] for k in sorted(by_level, key=lambda k: levels[k])]
    rings = [ring if ring.area() * way > 0.0 else ring.reversed() for ring in rings]
    seam = np.array([np.cos(operation.seam_deg * DEG), np.sin(operation.seam_deg * DEG)])
    sampled = [_sampled(ring, seam, radius, operation) for ring in rings]
    if operation.path == "helical":
        sampled = _spiral(sampled)
    point, normal = (np.concatenate([pair[k] for pair in sampled]) for k in range(2))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    loop_number = np.repeat(np.arange(len(sampled)), [len(pair[0]) for pair in sampled])
    return ContactPath(
        point=point,
        normal=normal,
        centre=point + radius * normal,
        angle=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        loop=loop_number,
        working=np.arange(len(point)) > 0,
    )


def _levels(one: Pass, pitch: float) -> FloatArray:
    """Levels (L,) [m] from the feature's end up to its start, the pitch apart in plan."""
    corner = one.vertices[one.faces]
    low, high = corner[:, :, 2].min(axis=1), corner[:, :, 2].max(axis=1)
    a, b, c = corner[:, 0, :2], corner[:, 1, :2], corner[:, 2, :2]
    plan = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    whole = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    rises = high - low > 1e-9
    low, high, plan, whole = low[rises], high[rises], plan[rises], whole[rises]
    edges = np.linspace(one.end, one.start, max(int(np.ceil((one.start - one.end) / ANGLE_CELL)), 1) + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    order, falling = np.argsort(low), np.argsort(high)

    def over(density: FloatArray) -> FloatArray:
        """Sum (C,) of what lies at each middle height."""
        begun = np.concatenate([[0.0], np.cumsum(density[order])])
        ended = np.concatenate([[0.0], np.cumsum(density[falling])])
        return np.asarray(
            begun[np.searchsorted(low[order], middle)] - ended[np.searchsorted(high[falling], middle)]
        )

    flat, full = over(plan / (high - low)), over(whole / (high - low))
    cosine = np.clip(flat / np.maximum(full, 1e-300), 1e-3, 1.0)
    slope = np.sqrt(1.0 - cosine**2) / cosine
    width = np.concatenate([[0.0], np.cumsum(np.diff(edges) / np.maximum(slope, 1e-6))])
    count = int(width[-1] / pitch)
    if not 1 <= count <= MOST_LOOPS:
        what = (
            f"pass {one.name}: {count} loops at a pitch of {pitch / MM:g} mm, allowed are 1 to {MOST_LOOPS}"
        )
        raise refusal("forming.adsif_conditions", what + "; change the pitch", field="adsif")
    levels = np.interp(pitch * np.arange(count + 1), width, edges)
    return np.asarray(np.clip(levels, one.end + EDGE_MARGIN, one.start - EDGE_MARGIN))


def _sampled(
    ring: Loop, seam: FloatArray, radius: float, operation: Forming
) -> tuple[FloatArray, FloatArray]:
    """Points and normals (M, 3) of a loop from the seam on, the last as the first: as many as the chord and
    the tangent of the forming ball's way need."""
    off = ring.point[:-1, :2] - ring.point[:-1, :2].mean(axis=0)
    first = int(np.argmax((off @ seam) / np.linalg.norm(off, axis=1)))
    point = np.concatenate([ring.point[:-1][first:], ring.point[: first + 1]])
    normal = np.concatenate([ring.normal[:-1][first:], ring.normal[: first + 1]])
    way = point + radius * normal
    step = np.linalg.norm(np.diff(way, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(step)])
    keep = np.concatenate([[True], step > 1e-9])
    heading = np.unwrap(np.arctan2(normal[:, 1], normal[:, 0]))
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(heading)))])
    share = at / at[-1] + turned / max(turned[-1], 1e-9)
    mean = at[-1] / (2.0 * np.pi)
    angle = min(operation.tangent_deg * DEG, 2.0 * np.arccos(max(1.0 - operation.chord_mm * MM / mean, 0.0)))
    count = max(int(np.ceil(max(turned[-1], 2.0 * np.pi) / angle)), 16)
    wanted = np.linspace(0.0, share[-1], 2 * count + 1)
    share, point, normal = share[keep], point[keep], normal[keep]
    return (
        np.column_stack([np.interp(wanted, share, point[:, k]) for k in range(3)]),
        np.column_stack([np.interp(wanted, share, normal[:, k]) for k in range(3)]),
    )


def _spiral(rings: list[tuple[FloatArray, FloatArray]]) -> list[tuple[FloatArray, FloatArray]]:
    """One spiral outward between the first and the last loop, which stay whole."""
    out = [rings[0]]
    for inner, outer in itertools.pairwise(rings):
        count = max(len(inner[0]), len(outer[0]))
        share = np.linspace(0.0, 1.0, count)
        both = []
        for one, two in zip(inner, outer, strict=True):
            a, b = _even(one, count), _even(two, count)
            both.append((a + share[:, None] * (b - a))[1:])
        out.append((both[0], both[1]))
    out.append((rings[-1][0][1:], rings[-1][1][1:]))
    return out


def _even(values: FloatArray, count: int) -> FloatArray:
    at, wanted = np.linspace(0.0, 1.0, len(values)), np.linspace(0.0, 1.0, count)
    return np.column_stack([np.interp(wanted, at, values[:, k]) for k in range(3)])


def _mirrored(found: ToolPath) -> ToolPath:
    contact = dataclasses.replace(
        found.contact,
        point=found.contact.point * MIRROR,
        centre=found.contact.centre * MIRROR,
        normal=found.contact.normal * -MIRROR,
    )
    support = None if found.support is None else found.support * MIRROR
    axis = None if found.support_axis is None else found.support_axis * MIRROR
    return ToolPath(found.former * MIRROR, found.axis * MIRROR, support, axis, found.gap, contact)
