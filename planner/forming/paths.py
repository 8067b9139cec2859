"""The path of the contact on the face of a pass, and of the ball's centre."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from planner.forming.contact import Face
from planner.forming.path_options import PathOptions
from planner.forming.paths_slices import Loop, cut
from planner.forming.paths_slices import loops as closed_lines
from planner.forming.paths_targets import Targets, targets
from planner.forming.paths_tool import Creases, TooNarrow, largest, lowest_reached
from planner.forming.spacing import EDGE, constant_levels, scallop_levels, scallop_width
from planner.forming.spiral import Curve, in_order, loop_curve, spiral_curve
from planner.forming.values import ContactPath, Pass
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError

FloatArray = NDArray[np.float64]

MOST_LEVELS: Final = 20_000
_MIRROR: Final = np.array([1.0, 1.0, -1.0])


def make_path(one: Pass, radius: float, options: PathOptions) -> ContactPath:
    """The way of the contact of a ball of ``radius`` [m] over the face of a pass, level by level from its
    start to its end.

    The ball touches the face (to 3 um) at every target and cuts into it nowhere (to 2 um), nor by more than
    ``options.cut`` on the straight moves between targets of its centre. Targets are at least 0.05 mm apart.
    Concave creases, where no ball fits, are left with a fillet of the ball's own radius: the path keeps off
    them as far as it must. Rows whose ``working`` is False are the ends of moves that do not form (lifts to
    another loop; the move along the sheet of kind "stepped"): at those in the air ``point`` is the nearest
    place of the face.

    Raises ``TandemError``: ``forming.path_options`` for a step, chord ... that is out of range,
    ``forming.no_contour`` if nothing of the face is between its levels, ``forming.open_contour`` where the
    mesh ends, ``forming.tool_radius`` where a smooth place is narrower than the ball.
    """
    _check(one, radius, options)
    try:
        return _path(one, radius, options)
    except TooNarrow as narrow:
        fits = largest(narrow, lambda smaller: _path(one, smaller, options), options.scallop or 0.0)
        raise narrow.told(fits) from None


def _path(one: Pass, radius: float, options: PathOptions) -> ContactPath:
    """The path; raises ``TooNarrow`` where it is too narrow for the ball."""
    vertices = one.vertices if one.side > 0 else one.vertices * _MIRROR  # features that rise: upside down
    start, end = one.side * one.start, one.side * one.end
    region = _region(one)
    box = np.stack([one.region.min(axis=0), one.region.max(axis=0)])[:, :2]
    face = Face(TriangleMesh(vertices, one.faces), radius, box)
    levels = _levels(face, region, start, end, radius, options)
    centre = np.asarray(Polygon(one.region[:, :2]).centroid.coords[0])

    def sliced(heights: FloatArray) -> list[list[Loop]]:
        mesh = face.mesh
        found = closed_lines(cut(mesh.vertices, mesh.faces, face.smooth, heights), region, one.name)
        groups: list[list[Loop]] = [[] for _ in heights]
        for loop in found:
            groups[loop.level].append(loop)
        return groups

    creases = Creases(face)
    wider = Face(face.mesh, radius + options.spare, box) if options.spare > 0.0 else None
    groups = lowest_reached(
        sliced(levels), levels, sliced, face, creases, options.chord, wider, options.missed
    )
    loops, ways = in_order([group for group in groups if group], options, centre)
    if not loops:
        raise TandemError(
            Issue(
                "forming.no_contour",
                f"{one.name}: no closed level line of the face lies in the feature's outline between z = "
                f"{1e3 * one.start:.3f} and {1e3 * one.end:.3f} mm; check that levels and outline belong to "
                "the face",
            )
        )
    curve = spiral_curve(loops, ways) if options.kind == "helical" else loop_curve(loops, ways)
    return _contact_path(targets(curve, face, creases, options, one.name), curve, face, options, one.side)


def _levels(
    face: Face, region: Polygon | None, start: float, end: float, radius: float, options: PathOptions
) -> FloatArray:
    if options.scallop is not None:
        width = scallop_width(radius, options.scallop)
        mesh = face.mesh
        levels = scallop_levels(mesh.vertices, mesh.faces, face.smooth, region, start, end, width)
    else:
        levels = constant_levels(start, end, options.stepdown or start - end)
    levels = np.append(start, levels)  # the first turn is flat, at the flat around the feature
    # levels of the flat have no lines of their own
    return np.asarray(np.clip(levels, end + EDGE, start - EDGE))


def _region(one: Pass) -> Polygon:
    """The outline of the feature and a little more, as the first lines run along it."""
    wide = float(np.ptp(one.region, axis=0).max())
    return Polygon(one.region[:, :2]).buffer(0.0).buffer(2e-4 + 1e-3 * wide)


def _contact_path(found: Targets, curve: Curve, face: Face, options: PathOptions, side: int) -> ContactPath:
    """The targets with what lies between pieces, turned back to the side that forms."""
    point, normal, centre, loop = found.point, found.normal, found.centre, found.loop
    working = np.ones(len(point), dtype=np.bool_)
    working[0] = False
    breaks = np.flatnonzero(np.diff(found.piece)) + 1
    high = float(face.mesh.vertices[:, 2].max()) + face.radius + options.lift
    at, between, labels = [], [], []
    for row in breaks:
        one, two = centre[row - 1], centre[row]
        if curve.ways[found.piece[row - 1]] == "step":
            over = [np.array([two[0], two[1], max(one[2], two[2])])]
        else:
            over = [np.array([one[0], one[1], high]), np.array([two[0], two[1], high])]
            working[row] = False
        at += [row] * len(over)
        between += over
        labels += [loop[row]] * len(over)
    if at:
        air = np.array(between)
        near, on, weights = face.nearest(air)
        centre, point = np.insert(centre, at, air, axis=0), np.insert(point, at, near, axis=0)
        normal = np.insert(normal, at, face.normal_at(on, weights), axis=0)
        loop = np.insert(loop, at, labels)
        working = np.insert(working, at, False)
    back = np.array([1.0, 1.0, float(side)])
    return ContactPath(
        point=point * back,
        normal=normal * np.array([side, side, 1.0]),
        centre=centre * back,
        angle=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        loop=loop,
        working=working,
    )


def _check(one: Pass, radius: float, options: PathOptions) -> None:
    depth = one.side * (one.start - one.end)
    wrong = []
    step = options.stepdown if options.stepdown is not None else options.scallop
    if (options.stepdown is None) == (options.scallop is None):
        wrong.append("state stepdown or scallop, one of both")
    elif step is None or not step > 0.0 or not np.isfinite(step):
        wrong.append("stepdown and scallop must be above 0")
    elif options.stepdown is not None and depth / options.stepdown > MOST_LEVELS:
        wrong.append(
            f"stepdown {1e3 * options.stepdown:.4g} mm makes {depth / options.stepdown:.0f} levels, up to "
            f"{MOST_LEVELS} are planned; take a stepdown of {1e3 * depth / MOST_LEVELS + 1e-5:.5f} mm at "
            "least"
        )
    elif options.scallop is not None and not options.scallop < radius:
        wrong.append(f"scallop {1e3 * options.scallop:.4g} mm must be below the ball's radius")
    wrong += [
        f"{name} is {getattr(options, name):.4g}, it must be above 0"
        for name in ("tangent_angle", "chord", "cut", "longest", "lift", "missed")
        if not getattr(options, name) > 0.0
    ]
    if not radius > 0.0:
        wrong.append(f"the ball's radius is {1e3 * radius:.4g} mm, it must be above 0")
    if not depth > 2.0 * EDGE:
        wrong.append(
            f"the face goes from z = {1e3 * one.start:.4g} to {1e3 * one.end:.4g} mm, its end must lie "
            f"{'below' if one.side > 0 else 'above'} its start"
        )
    if wrong:
        raise TandemError([Issue("forming.path_options", f"{one.name}: {what}") for what in wrong])
