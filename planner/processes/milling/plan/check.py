"""What would go wrong in a milling job: deviations, cutters that do not fit, tools in the part.

A tool is a body of revolution (`sections`): how far points are off it, and how deep the part stands
in it along a path.
"""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.face_places import CREASE_ANGLE
from planner.geometry.mesh import TriangleMesh, closest_on_triangles, corner_normals
from planner.geometry.swept_body import RoundBody, count_near, least_distances, places_near
from planner.geometry.units import MM, measurement
from planner.issues import Issue
from planner.processes.milling.plan.operation import FlankCut
from planner.processes.milling.plan.process_plan import Done, Face, Work
from planner.processes.milling.plan.tool_path import Run
from planner.tooling import Cutter

PATH_SPACING: Final = 0.15
"""Distance of places along the path, over the radius of the section."""
LEAST_SPACING: Final = 0.5e-3
"""The same at least [m]."""
SIGHT_DISTANCE: Final = 2e-3
"""Points that are farther off than this [m] are as good as any other."""


@dataclasses.dataclass(frozen=True)
class Section:
    """A cylinder about the axis from ``start`` to ``end`` [m] behind the tip with ``radius`` [m], its front
    edge rounded by ``corner`` [m]."""

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0

    def off(self, back: FloatArray, beside: FloatArray) -> FloatArray:
        """Distance [m] of points ``back`` behind the tip and ``beside`` the axis from the section, below zero
        inside, in the shape of both."""
        radial = beside - (self.radius - self.corner)
        front = self.start + self.corner - back
        # a rounded edge at the front, a sharp one behind
        outer = np.hypot(np.maximum(radial, 0.0), np.maximum(front, 0.0)) - self.corner
        inner = np.minimum(np.maximum(radial, front), 0.0)
        rear = back - self.end
        body = outer + inner
        both = np.hypot(np.maximum(body, 0.0), np.maximum(rear, 0.0))
        return np.asarray(np.where((body > 0.0) & (rear > 0.0), both, np.maximum(body, rear)))

    @property
    def round(self) -> RoundBody:
        """The section as a body of revolution."""
        return RoundBody(self.start, self.end, self.radius, self.off, self.corner == 0.0)


def sections(cutter: Cutter) -> tuple[Section, ...]:
    """The tool's cylinders from the tip to the end of the spindle."""
    out = [Section("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(Section("shank", cutter.flute, cutter.overhang, cutter.shank))
    pairs = list(zip(cutter.behind[::2], cutter.behind[1::2], strict=True))
    for k, (a, b) in enumerate(pairs):
        name = "spindle" if k == len(pairs) - 1 else "holder"
        out.append(Section(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def between(
    tip: FloatArray, axis: FloatArray, reach: float, step: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Tips and axes (M, 3) along straight moves between N places, at most ``step`` [m] of the faster end of a
    tool of length ``reach`` [m] apart, and the place (M,) that each move leads to."""
    ends = np.stack([tip, tip + reach * axis], axis=1)
    way = np.linalg.norm(np.diff(ends, axis=0), axis=2).max(axis=1)
    count = np.maximum(np.ceil(way / step).astype(np.int64), 1)
    to = np.repeat(np.arange(1, len(tip)), count)
    share = (np.arange(len(to)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[to - 1]
    tips = tip[to - 1] + share[:, None] * (tip[to] - tip[to - 1])
    axes = axis[to - 1] + share[:, None] * (axis[to] - axis[to - 1])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    tips, axes = np.concatenate([tip[:1], tips]), np.concatenate([axis[:1], axes])
    return tips, axes, np.concatenate([[0], to])


def comes_near(vertices: FloatArray, tip: FloatArray, axis: FloatArray, section: Section) -> bool:
    """Whether a section on a path (N,) may come within ``SIGHT_DISTANCE`` of a face of ``vertices`` (V, 3),
    by the boxes around both. On moves it stays in that of their ends, but for what a turning axis goes
    beyond."""
    turns = np.linalg.norm(0.5 * (axis[1:] + axis[:-1]), axis=1)
    room = section.radius + SIGHT_DISTANCE + section.end * (1.0 - float(turns.min(initial=1.0)))
    ends = np.stack([tip + section.start * axis, tip + section.end * axis])
    low, high = ends.min(axis=(0, 1)) - room, ends.max(axis=(0, 1)) + room
    return bool(((low <= vertices.max(axis=0)) & (high >= vertices.min(axis=0))).all())


def body_places(
    tip: FloatArray, axis: FloatArray, section: Section
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Tips and axes (M, 3) at which a section on a path (N,) is looked at, and the place (M,) that each move
    leads to."""
    return between(tip, axis, section.end, max(PATH_SPACING * section.radius, LEAST_SPACING))


def distance_off(
    points: FloatArray, tip: FloatArray, axis: FloatArray, section: Section, below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a section along a path (N,), negative inside, and the
    place (P,) that the move leads to at which it is least; no more than ``SIGHT_DISTANCE`` is told. With
    ``below`` [m] what is not less may be told too large, but for the least of all."""
    tips, axes, to = body_places(tip, axis, section)
    best, place = least_distances(points, tips, axes, section.round, SIGHT_DISTANCE, below)
    return best, np.where(best < SIGHT_DISTANCE, to[place], 0)


MOST_FACE_POINTS: Final = 3_000_000
"""Most places of a face beside one piece of a tool that this is held against; the proof takes some more."""
EDGE_BACK: Final = 5.0 * MM
"""How far behind it a sharp edge of a tool is looked at [m],"""
EDGE_SPACING: Final = 2.0
"""at places of a face that are so much nearer to one another, over the tolerance; never nearer than"""
FINEST_SPACING: Final = 0.4 * MM
"""[m] this."""
SPACING_SHARE: Final = 0.5
"""Share of the tolerance that may lie between places of a face."""
RISE_LENGTH: Final = 0.2
"""Length of the ways down and up [m] that are looked at, along the tool's own axis."""
BOUND_SPACING: Final = 0.25
"""Places of a face that bound a ball are so far apart at least, over the cutter's radius."""
TWIST_SHARE: Final = 0.1
"""A cutter that is off a surface by more than this share of its radius does not fit, twisted or not."""
SAME_LEVEL: Final = 0.5 * MM
"""Places whose levels along an axis differ by less [m] are at one level."""
CHORD_ALLOWANCE: Final = 2e-5
"""What facets of the part and of the path may hide [m]."""

PARTS_BEHIND: Final = ("holder", "spindle")
"""What is behind a cutter, by names of the tool's pieces."""
LONGER_OVERHANGS: Final = (5.0 * MM, 10.0 * MM, 20.0 * MM, 40.0 * MM, 80.0 * MM)
"""By so much [m] more overhang is tried where a holder or a spindle goes into the part."""


def check(work: Work) -> list[Issue]:
    """Issues of all cuts."""
    out = list(work.notes)
    for face in work.faces:
        for one in work.cuts:
            own = one.face is not None and one.face.name == face.name
            twist = _twist(work, one) if own else []
            out += twist or _gouges(work, one, face)
    return out


def _twist(work: Work, one: Done) -> list[Issue]:
    radius = work.cutter.radius
    if not isinstance(one.cut, FlankCut) or not one.tolerance < one.off < TWIST_SHARE * radius:
        return []
    slim = f"a radius of {np.floor(one.fits / MM * 100.0) / 100.0:.2f} mm or less, " if one.fits else ""
    what = f"flank {one.cut.flank}: its rulings are twisted, and the cutter of radius {radius / MM:g} mm is "
    what += f"{one.off / MM:.3f} mm off them; allowed: {one.tolerance / MM:g}: take {slim}a shape_tol_mm of "
    what += f"{np.ceil(1.02e3 * one.off / MM) / 1e3:.3f} or more, or part the surface"
    return [
        Issue(
            "milling.twist",
            what,
            field=f"operations.cuts.{one.cut.flank}",
            **measurement(one.off / MM, one.tolerance / MM, "mm"),
        )
    ]


def _gouges(work: Work, one: Done, face: Face) -> list[Issue]:
    """Gouges of one cut into a face, one issue for each section, and what of it is too large to be looked
    at."""
    out: list[Issue] = []
    told: set[str] = set()
    deep = one.depth if face.name == "front" else 0.0
    corners = face.mesh.vertices[face.mesh.faces]
    for section in sections(work.cutter):
        ways = [(run, *_way(run)) for run in one.runs]
        ways = [way for way in ways if comes_near(face.mesh.vertices, *way[1:], section)]
        if not ways:
            continue
        places = [body_places(*way[1:], section) for way in ways]
        tips, axes = (np.concatenate([place[k] for place in places]) for k in (0, 1))
        size = max(float(np.sqrt(8.0 * section.radius * SPACING_SHARE * one.tolerance)), 0.3 * MM)
        points, owner, count = places_near(
            corners, tips, axes, section.round, SIGHT_DISTANCE, size, MOST_FACE_POINTS
        )
        narrow = max(EDGE_SPACING * one.tolerance, FINEST_SPACING)
        for edge in _edges(section):
            some = count_near(corners, tips, axes, edge.round, SIGHT_DISTANCE, narrow, MOST_FACE_POINTS)
            count, size = max((count, size), (some, narrow))
        if count > MOST_FACE_POINTS:
            out.append(_too_large(one, face, section, count, size))
            continue
        allowed = one.tolerance + CHORD_ALLOWANCE + (deep if section.name == "cutter" else 0.0)
        for run, tip, axis in ways if len(points) else ():
            apart, where = distance_off(points, tip, axis, section, -allowed)
            k = int(apart.argmin())
            if apart[k] >= -allowed or section.name in told:
                continue
            told.add(section.name)
            found = _gouge(work, one, run, face, section, points, owner, apart, k, int(where[k]), allowed)
            if section.name in PARTS_BEHIND:
                found = dataclasses.replace(found, hint=_longer(work, one, points, allowed))
            out.append(found)
    return out


def _longer(work: Work, one: Done, points: FloatArray, allowed: float) -> str:
    """What keeps holder and spindle out of a face at places (P, 3) [m]: the overhang that was tried, if one
    does."""
    cutter = work.cutter
    ways = [_way(run) for run in one.runs]
    behind = [section for section in sections(cutter) if section.name in PARTS_BEHIND]
    for more in LONGER_OVERHANGS:
        tool = [dataclasses.replace(own, start=own.start + more, end=own.end + more) for own in behind]
        tool.append(Section("shank", cutter.flute, cutter.overhang + more, cutter.shank))
        if _clear(points, ways, tool, allowed):
            return (
                f"take an overhang of {np.ceil((cutter.overhang + more) / MM):.0f} mm or more, as was tried"
            )
    return "lean the tool's axis away, or take a slimmer holder"


def _clear(
    points: FloatArray, ways: Sequence[tuple[FloatArray, FloatArray]], tool: Sequence[Section], allowed: float
) -> bool:
    """Whether no point is deeper in these sections of a tool than is allowed along all of its ways."""
    return all(
        float(distance_off(points, *way, section, -allowed)[0].min()) >= -allowed
        for way in ways
        for section in tool
    )


def _edges(section: Section) -> tuple[Section, ...]:
    front = dataclasses.replace(section, end=min(section.end, section.start + EDGE_BACK))
    back = dataclasses.replace(section, start=max(section.start, section.end - EDGE_BACK), corner=0.0)
    return (back,) if section.corner > 0.0 else (front, back)


def _too_large(one: Done, face: Face, section: Section, count: int, size: float) -> Issue:
    """What to do where a face would take ``count`` places, whose pieces have edges of ``size`` [m]."""
    fewer = 1.05 * size * float(np.sqrt(count / MOST_FACE_POINTS))
    narrow = size <= max(EDGE_SPACING * one.tolerance, FINEST_SPACING)
    wanted = fewer / EDGE_SPACING if narrow else fewer**2 / (8.0 * section.radius * SPACING_SHARE)
    what = f"{one.runs[0].name}: beside the {section.name}, {face.name} would have to be looked at in "
    what += f"{count} places, {size / MM:.2f} mm apart, so that no gouge is missed; allowed: "
    what += f"{MOST_FACE_POINTS}: take a shape_tol_mm of {np.ceil(wanted / MM * 100.0) / 100.0:.2f} or more, "
    what += "or part the surface and mill it in several operations"
    value, limit = float(count), float(MOST_FACE_POINTS)
    return Issue("milling.too_large", what, field="operations.cuts", value=value, limit=limit)


def _way(run: Run) -> tuple[FloatArray, FloatArray]:
    """Tips and axes of a run with the ways down and up along the tool's own axis."""
    path = run.path
    start, end = path.tip[0] + RISE_LENGTH * path.axis[0], path.tip[-1] + RISE_LENGTH * path.axis[-1]
    tip = np.concatenate([start[None], path.tip, end[None]])
    return tip, np.concatenate([path.axis[:1], path.axis, path.axis[-1:]])


def _gouge(
    work: Work,
    one: Done,
    run: Run,
    face: Face,
    section: Section,
    points: FloatArray,
    owner: IntArray,
    apart: FloatArray,
    k: int,
    where: int,
    allowed: float,
) -> Issue:
    at = ", ".join(f"{v / MM:.1f}" for v in points[k])
    target = _target(run, where - 1)
    measure = measurement(float(-apart[k] / MM), allowed / MM, "mm")
    own = one.face is not None and one.face.name == face.name
    flank = isinstance(one.cut, FlankCut)
    along = run.path.axis[min(max(where - 1, 0), len(run.path) - 1)] if flank else None
    fits = None
    if section.name == "cutter":
        fits = largest_that_fits(face, points, owner, k, section.radius, along)
    if fits is not None and fits < section.radius and (own or one.depth > 0.0):
        what = f"{run.name}: the cutter of radius {section.radius / MM:g} mm does not fit into "
        what += f"{face.name} at {at} mm, "
        what += f"it would take {-apart[k] / MM:.2f} mm too much; the largest radius that fits "
        what += f"there is {fits / MM:.2f} mm"
        return Issue("milling.tool_radius", what, target=target, **measure)
    what = f"{run.name}: the {section.name} goes {-apart[k] / MM:.2f} mm into {face.name} at "
    what += f"{at} mm (target {target}); "
    what += f"allowed: {allowed / MM:.2f} mm; "
    leads = flank and not run.first < where - 1 <= run.last
    if section.name == "shank":
        what += "take a longer flute or a slimmer shank, or lean the tool's axis away"
    elif section.name in PARTS_BEHIND:
        what = what.removesuffix("; ")
    elif leads:
        what += "that is on its way in or out: give a lead_mm that ends before (0: down and up at the wall)"
    else:
        what += "take a thinner cutter, another axis, or other leads"
    return Issue("milling.gouge", what, target=target, **measure)


def _target(run: Run, row: int) -> str:
    """Name of the target at a row of the run's path, -1 and one behind it for the ways down and up."""
    if row <= run.first:
        return f"mill/{run.name}_in/{max(row + 1, 1)}"
    out = row > run.last
    return f"mill/{run.name}{'_out' if out else ''}/{row - (run.last if out else run.first)}"


def largest_that_fits(
    face: Face, points: FloatArray, owner: IntArray, k: int, radius: float, along: FloatArray | None = None
) -> float | None:
    """Radius [m] of the largest ball that touches the face near point ``k`` without holding another of its
    points; None where no smaller one than ``radius`` is bounded by it.

    A ball of radius r about p + r n holds q where |q - p|^2 < 2 r (q - p) n. With ``along`` (3,), the axis
    of a flank, it is a cylinder: only places at one level of the axis bound it.
    """
    tree = cKDTree(points)
    some = np.asarray(tree.query_ball_point(points[k], radius), dtype=np.int64)
    some = some[:: max(1, len(some) // 400)]
    corners = face.mesh.vertices[face.mesh.faces][owner[some]]
    share = closest_on_triangles(points[some], corners[:, 0], corners[:, 1], corners[:, 2])
    smooth = corner_normals(TriangleMesh(face.mesh.vertices, face.mesh.faces), CREASE_ANGLE)[owner[some]]
    normal = np.einsum("nk,nkd->nd", share, smooth)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    way = points[some][None] - points[some][:, None]
    height = np.einsum("ijd,id->ij", way, normal)
    square = dots(way, way)
    # facets are chords: places that are near to one another see corners where the face is round
    level = np.abs(way @ along) < SAME_LEVEL if along is not None else np.ones(height.shape, dtype=bool)
    real = level & (height > 0.02 * np.sqrt(square)) & (square > np.square(BOUND_SPACING * radius))
    found = np.where(real, square / np.maximum(2.0 * height, 1e-12), np.inf)
    least = float(found.min(initial=np.inf))
    return least if np.isfinite(least) else None
