"""What would go wrong while a sheet is trimmed: curves that cross or leave the sheet, tools in the wall."""

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, unit
from planner.geometry.mesh import small_pieces
from planner.geometry.swept_body import RoundBody, places_near
from planner.geometry.units import DEG, MM
from planner.issues import Issue, refusal
from planner.processes.trim.plan.cutting import Cutting, flute_body
from planner.processes.trim.plan.face import Face, apart
from planner.processes.trim.plan.operation import Trim
from planner.processes.trim.plan.slots import Slot, Wanted

ROUNDING: Final = 1e-6
"""Room [m] for rounding where places are left out that are too far off."""
FACE_SPACING: Final = 2.0 * MM
"""Distance [m] of places of the face at which a torch is held against it."""
MOST_PLACES: Final = 200_000
"""Places of the face at most."""
PART_SPACING: Final = 0.5 * MM
"""Distance [m] of places of the face at which a cutter is held against the part."""
MOST_PART_PLACES: Final = 1_000_000
"""Such places at most."""
LEANS: Final = 6
"""Directions to which a torch is tried to lean."""
LEAST_RISE: Final = 15.0 * DEG
"""A torch must rise from the flat sheet by this angle [rad] at least, or it never reaches the safe plane."""


def curve_issues(
    wanted: Sequence[Wanted], opening: FloatArray, reach: float, tolerance: float
) -> Iterator[Issue]:
    """Curves that cross themselves or each other, lie in the waste of another one, or leave the ``opening``
    (K, 2) [m] of the clamp, with all that is cut ``reach`` [m] beside them; and those between which nothing
    is sure to stay, as the edges of both may be off by the ``tolerance`` [m]."""
    free = shapely.Polygon(opening)
    for one in wanted:
        name = one.spec.name
        if not one.area.is_valid:
            what = f"{name}: the curve crosses itself{_where(shapely.is_valid_reason(one.area))}"
            yield Issue("trim.crosses", what, hint="draw it anew, as one closed curve that meets nothing")
            continue
        side = 0.0 if one.inside else reach
        out = shapely.distance(free, shapely.points(one.laid.point[:, :2]))
        near = float(shapely.distance(free.exterior, one.area.exterior)) - side
        if out.max() > 0.0 or near < 0.0:
            k = int(np.argmax(out)) if out.max() > 0.0 else _nearest(one, free)
            x, y, _ = one.laid.point[k] / MM
            beyond = float(out.max()) + side if out.max() > 0.0 else -near
            what = f"{name}: at ({x:.1f}, {y:.1f}) mm the curve, with slot and ways in, is {beyond / MM:.1f} "
            what += "mm beyond the opening of the clamp"
            hint = "move the curve inwards, or take a larger opening"
            yield Issue("trim.off_part", what, value=beyond / MM, limit=0.0, unit="mm", hint=hint)
    for one, other in itertools.combinations([w for w in wanted if w.area.is_valid], 2):
        names = f"{one.spec.name} and {other.spec.name}"
        if shapely.intersects(one.area.exterior, other.area.exterior):
            where = (
                shapely.get_coordinates(shapely.intersection(one.area.exterior, other.area.exterior))[0] / MM
            )
            what = f"{names} cross or meet, at ({where[0]:.1f}, {where[1]:.1f}) mm"
            yield Issue("trim.crosses", what, hint="move one of them, or join them to one curve")
            continue
        between = float(shapely.distance(one.area.exterior, other.area.exterior))
        if between < 2.0 * tolerance:
            near = shapely.get_coordinates(shapely.shortest_line(one.area.exterior, other.area.exterior))
            x, y = near.mean(axis=0) / MM
            what = f"{names} come within {between / MM:.2f} mm of each other, at ({x:.1f}, {y:.1f}) mm; as "
            what += f"both edges may be off by shape_tol_mm, allowed are {2.0 * tolerance / MM:g} mm or more"
            hint = "move them apart, join them to one curve, or take a smaller shape_tol_mm"
            value, limit = between / MM, 2.0 * tolerance / MM
            yield Issue("trim.crosses", what, value=value, limit=limit, unit="mm", hint=hint)
            continue
        for a, b in ((one, other), (other, one)):
            if bool(a.waste(b.laid.point[:1, :2])[0]):
                what = f"{b.spec.name} lies in what {a.spec.name} lets drop, so that nothing is cut there"
                yield Issue("trim.in_waste", what, hint="leave it out, or turn drops of one of them")


def _where(reason: str) -> str:
    """The place of a fault as GEOS tells it [m], in words; nothing where it tells none."""
    found = re.search(r"\[(\S+) (\S+)\]", reason)
    if found is None:
        return ""
    x, y = (round(float(number) / MM, 1) + 0.0 for number in found.groups())  # no -0.0
    return f", at ({x:.1f}, {y:.1f}) mm"


def _nearest(one: Wanted, free: shapely.Polygon) -> int:
    return int(np.argmin(shapely.distance(free.exterior, shapely.points(one.laid.point[:, :2]))))


def clear_of(
    own: RoundBody, places: FloatArray, tips: FloatArray, axes: FloatArray, sight: float
) -> FloatArray:
    """Least distance (N, L) [m] of a tool's body, at each of ``tips`` with ``axes`` (N, L, 3) from there into
    the tool, from ``places`` (P, 3); at most ``sight`` [m]. The L of one row lean about one place."""
    out = np.empty(tips.shape[:2])
    wide, far = own.widest + sight, max(abs(own.start), abs(own.end)) + sight
    # what comes near to any of a row is near to the first, as far as the others lean from it
    aside = np.linalg.norm(tips - tips[:, :1], axis=2) + far * np.linalg.norm(axes - axes[:, :1], axis=2)
    square = np.einsum("ij,ij->i", places, places)
    for k, (row, ways) in enumerate(zip(tips, axes, strict=True)):
        back = places @ ways[0] - row[0] @ ways[0]
        beside = square - 2.0 * (places @ row[0]) + row[0] @ row[0] - back * back
        most = wide + float(aside[k].max()) + ROUNDING
        near = places[(beside < most * most) & (np.abs(back) < far + most)]
        for number, (tip, axis) in enumerate(zip(row, ways, strict=True)):
            rest = near - tip
            back = rest @ axis
            off = np.sqrt(np.maximum(np.einsum("ij,ij->i", rest, rest) - back * back, 0.0))
            out[k, number] = own.distance(back, off).min(initial=sight)
    return out


def gouged(
    one: Wanted,
    tool: Cutting,
    places: FloatArray,
    thickness: float,
    side: int,
    way: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """How far (N,) [m] over its outline the cutter is in the part, and where (N, 3), at each row of a
    ``way``: its tips and its axes (N, 3). ``places`` (P, 3) are those of the face, the other one
    is lower by the ``thickness`` [m]: of that so much counts as the edge of the cut."""
    deep, where = np.zeros(len(way[0])), np.zeros((len(way[0]), 3))
    if tool.cutter is None or not len(places):
        return deep, where
    cutter = tool.cutter
    part = places[~one.waste(places[:, :2])]
    if not len(part):
        return deep, where
    off = apart(part, one.laid.point)
    both = np.concatenate([part, part - np.array([0.0, 0.0, side * thickness])])
    off = np.concatenate([off, off - thickness])
    tree = cKDTree(both)
    for k, (tip, axis) in enumerate(zip(*way, strict=True)):
        some = tree.query_ball_point(tip + 0.5 * cutter.flute * axis, 0.5 * cutter.flute + cutter.radius)
        if not some:
            continue
        rest = both[some] - tip
        back = rest @ axis
        beside = np.linalg.norm(rest - back[:, None] * axis, axis=1)
        inside = (beside < cutter.radius) & (back > 0.0) & (back < cutter.flute)
        found = np.where(inside, off[some], 0.0)
        j = int(np.argmax(found))
        deep[k], where[k] = found[j], both[some[j]]
    return deep, where


def gouge_issue(slot: Slot, deep: FloatArray, where: FloatArray, op: Trim) -> Iterator[Issue]:
    """A cutter that goes into the part where that is bent."""
    k = int(np.argmax(deep))
    if deep[k] <= op.shape_tol_mm * MM:
        return
    x, y, z = where[k] / MM
    what = f"{slot.outline}: the cutter goes {deep[k] / MM:.2f} mm over the curve into the part, at "
    what += f"({x:.1f}, {y:.1f}, {z:.1f}) mm; allowed: {op.shape_tol_mm:g} mm"
    hint = "move the curve away from the wall there, take a thinner cutter, or less below_mm"
    value, limit = float(deep[k]) / MM, op.shape_tol_mm
    yield Issue("trim.wall", what, value=value, limit=limit, unit="mm", hint=hint)


def part_places(
    face: Face, size: FloatArray, tool: Cutting, way: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Places (P, 3) of the sheet of ``size`` (3,) [m], ``PART_SPACING`` from one another at most, where a
    cutter may be in one of its faces at some row of a ``way``: its tips and axes (N, 3). Raises
    ``TandemError`` (trim.wall) where there are too many."""
    if tool.cutter is None:
        return np.zeros((0, 3))
    vertices, faces = face.beyond(size[:2])
    flute = flute_body(tool.cutter)
    found, _, count = places_near(
        vertices[faces], *way, flute, float(size[2]), PART_SPACING, MOST_PART_PLACES
    )
    if count > MOST_PART_PLACES:
        what = f"about the slot there are {count} places to be looked at; allowed: {MOST_PART_PLACES}"
        hint = "cut it in several pieces (joints), or take a thinner cutter"
        raise refusal("trim.wall", what, value=count, limit=MOST_PART_PLACES, hint=hint)
    return found


def face_places(face: Face, size: FloatArray) -> FloatArray:
    """Places (P, 3) of the sheet of ``size`` (2,) [m], ``FACE_SPACING`` from one another at most."""
    vertices, faces = face.beyond(size)
    return np.concatenate(
        [vertices, small_pieces(vertices[faces], FACE_SPACING, MOST_PLACES)[0].mean(axis=1)]
    )


def wall_issue(slot: Slot, tips: FloatArray, off: FloatArray, op: Trim, tool: Cutting) -> Iterator[Issue]:
    """A tool square to the face that is nearer to the sheet than it may be."""
    k = int(np.argmin(off))
    if off[k] >= op.clear_mm * MM:
        return
    x, y, z = tips[k] / MM
    what = f"{slot.outline}: at ({x:.1f}, {y:.1f}, {z:.1f}) mm the {_named(tool)}, square to the sheet, "
    what += f"{'stands in it by' if off[k] < 0.0 else 'is off its wall by'} {abs(off[k]) / MM:.2f} mm; "
    what += f"wanted: {op.clear_mm:g} mm"
    hint = "move the curve away from the wall, take a longer flute or a slimmer holder"
    if tool.blade is not None:
        hint = "move the curve away from the wall, take a longer blade_mm or a slimmer body"
    elif tool.cutter is None:
        hint = "move the curve away from the wall, take a slimmer nozzle, or a larger standoff_mm"
    yield Issue("trim.wall", what, value=float(off[k]) / MM, limit=op.clear_mm, unit="mm", hint=hint)


def _named(tool: Cutting) -> str:
    """What keeps clear of the sheet, in words."""
    if tool.blade is not None:
        return f"{tool.word}'s body"
    return tool.word if tool.cutter is None else f"{tool.word}'s shank or holder"


def rise_issue(slot: Slot, axes: FloatArray, side: int) -> Iterator[Issue]:
    """A tool so flat at a pierce point or at an end that it never rises to the safe plane."""
    up = float((side * axes[[0, -1], 2]).min())
    if up < np.sin(LEAST_RISE):
        lean = float(np.rad2deg(np.arccos(np.clip(up, -1.0, 1.0))))
        most = 90.0 - LEAST_RISE / DEG
        what = f"{slot.outline}: where its slot begins or ends the wall is {lean:.0f} deg steep, and a tool "
        what += f"square to it does not come down to it from the safe plane; allowed: {most:g} deg"
        yield Issue(
            "trim.wall", what, value=lean, limit=most, unit="deg", hint="let it begin on a flatter place"
        )


def leans(axes: FloatArray, angle: float) -> list[FloatArray]:
    """Axes (N, 3) leant by ``angle`` [rad] to ``LEANS`` sides."""
    one = unit(np.cross(axes, np.eye(3)[int(np.abs(axes).max(axis=0).argmin())]))
    other = np.cross(axes, one)
    turn = 2.0 * np.pi * np.arange(LEANS) / LEANS
    return [
        np.asarray(np.cos(angle) * axes + np.sin(angle) * (np.cos(t) * one + np.sin(t) * other)) for t in turn
    ]
