"""The surfaces of a part as the problem's numbers and its files state them, in the part's own frame.

Among them the skin of a wing panel, from its sections and the numbers that place them: x from the
leading to the trailing edge, y from root to tip, z up; origin at the root's leading edge.

Airfoil sections: coordinates from files in Selig's or Lednicer's format, and NACA digits by
formulas. A section is a row of points (N, 2) per chord from the trailing edge over the upper side
to the leading edge and back below. Formulas: I. H. Abbott and A. E. von Doenhoff, Theory of Wing
Sections (1959), 6.4 to 6.6; C. L. Ladson and C. W. Brooks, NASA TM X-3284 (1975).
"""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.interpolate import CubicSpline

from planner.geometry.arrays import FloatArray
from planner.proof.part_files import (
    UNITS,
    Said,
    Samples,
    UnreadError,
    file_of,
    metres,
    on_rulings,
    on_triangles,
    radians,
    rhino,
    row,
    step,
)
from planner.proof.part_files.curves import (
    Curve,
    Drawn,
    Ruled,
    anchored,
    bezier,
    bspline,
    joined,
    matched,
    read_curves,
    through,
)
from planner.proof.part_files.meshes import Face, behind, edges_of, loft_face, mesh_face, rims

_SIMPLE: Final = {
    1: (0.0580, 361.4),
    2: (0.1260, 51.64),
    3: (0.2025, 15.957),
    4: (0.29, 6.643),
    5: (0.391, 3.23),
}
"""Second digit of five: place m of the camber line's joint and its factor k1, for a lift of 0.3."""
_REFLEXED: Final = {
    2: (0.130, 51.990, 0.000764),
    3: (0.217, 15.793, 0.00677),
    4: (0.318, 6.520, 0.0303),
    5: (0.441, 3.191, 0.1355),
}
"""The same with a third digit 1, and k2 / k1 behind the joint."""
_SECTION_STATIONS: Final = 201
"""Stations along the chord of a section that its digits give."""


def read_section(path: Path) -> FloatArray:
    """The section of a coordinate file, its chord brought to 1 where it is not. Raises `UnreadError`."""
    rows = _rows(path.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff"))
    if len(rows) < 3:
        raise UnreadError("it has no row of points")
    first = rows[0]
    if first.min() >= 2.5 and np.abs(first - np.rint(first)).max() < 1e-6:
        upper = round(first[0])
        if len(rows) != 1 + upper + round(first[1]):
            raise UnreadError("its two sides have other numbers of points than it says")
        rows = np.concatenate([rows[upper:0:-1], rows[upper + 1 :]])
    keep = np.append(True, np.hypot(*np.diff(rows, axis=0).T) > 1e-9)
    points = rows[keep]
    points = _from_the_tail(points)
    left, tail = points[:, 0].min(), 0.5 * (points[0, 0] + points[-1, 0])
    if max(abs(left), abs(tail - left - 1.0)) > 2e-3:
        points = np.column_stack([points[:, 0] - left, points[:, 1]]) / (tail - left)
    return np.asarray(points)


def _rows(text: str) -> FloatArray:
    """Pairs of numbers (N, 2), in order; lines with anything else are names and remarks."""
    out = []
    for line in text.splitlines():
        if line.lstrip().startswith("#"):
            continue
        words = line.strip().lstrip("(").rstrip(")").replace(",", " ").replace(";", " ").split()
        try:
            pair = [float(word.lower().replace("d", "e")) for word in words]
        except ValueError:
            continue
        if len(pair) == 2:
            out.append(pair)
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def _from_the_tail(points: FloatArray) -> FloatArray:
    """The points begun at the trailing edge and turned so that they go over the upper side first."""
    low, high = points[:, 0].min(), points[:, 0].max()
    if max(points[0, 0], points[-1, 0]) < 0.5 * (low + high):  # begun at the nose
        if np.hypot(*(points[0] - points[-1])) < 1e-9 * (high - low):
            points = points[:-1]
        points = np.roll(points, -int(np.argmax(points[:, 0])), axis=0)
    x, y = points.T
    ahead = np.sum((x - np.roll(x, 1)) * (y + np.roll(y, 1)))  # twice the area, clockwise above zero
    return points if ahead <= 0.0 else points[::-1]


def section_of_digits(digits: str) -> FloatArray:
    """The section of NACA digits. Raises `UnreadError`."""
    x = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, _SECTION_STATIONS)) ** 2  # close together at both edges
    line, slope = _camber(digits, x)
    tall = float(digits[-2:]) / 20.0
    half = tall * (0.2969 * x**0.5 - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)
    turn = np.arctan(slope)
    up = np.column_stack([x - half * np.sin(turn), line + half * np.cos(turn)])
    down = np.column_stack([x + half * np.sin(turn), line - half * np.cos(turn)])
    return np.vstack([up[::-1], down[1:]])


def _camber(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Height and slope of the camber line at x (N,)."""
    if len(digits) == 4:
        high, place = int(digits[0]) / 100.0, int(digits[1]) / 10.0
        if high == 0.0:
            return 0.0 * x, 0.0 * x
        front = x <= place
        size = high / np.where(front, place, 1.0 - place) ** 2
        line = size * (2.0 * place * x - x**2 + np.where(front, 0.0, 1.0 - 2.0 * place))
        return line, size * 2.0 * (place - x)
    try:
        lift, second, third = int(digits[0]) * 0.15 / 0.3, int(digits[1]), int(digits[2])
        if third == 0:
            m, k = _SIMPLE[second]
            front = x < m
            line = np.where(front, x**3 - 3 * m * x**2 + m**2 * (3 - m) * x, m**3 * (1 - x))
            slope = np.where(front, 3 * x**2 - 6 * m * x + m**2 * (3 - m), -(m**3))
        else:
            m, k, ratio = _REFLEXED[second]
            back = np.where(x < m, 1.0, ratio)
            fall = ratio * (1 - m) ** 3 + m**3
            line = back * (x - m) ** 3 - fall * x + m**3
            slope = 3.0 * back * (x - m) ** 2 - fall
    except (KeyError, ValueError) as error:
        raise UnreadError(f"NACA {digits} is not known") from error
    return lift * k / 6.0 * line, lift * k / 6.0 * slope


SHARP_EDGE: Final = 1e-6
"""A trailing edge that is thinner [m] is an edge."""
_SECTION_PLACES: Final = 600
"""Places along each side of a section."""


def skin(said: Said) -> Ruled:
    """The skin, over the lower side first, away from the part outwards. Raises `UnreadError`."""
    least = metres(said.get("trailing_edge_mm") or 0.0)
    sections, chords = [], []
    for side in ("root", "tip"):
        own = said[side]
        points = read_section(file_of(own)) if own.get("file") else section_of_digits(str(own["naca"]))
        chords.append(metres(own["chord_mm"]))
        sections.append(_thick(points, least / chords[-1]))
    gaps = [
        float(np.hypot(*(points[0] - points[-1]))) * chord
        for points, chord in zip(sections, chords, strict=True)
    ]
    span = metres(said["span_mm"])
    sweep, rise = (np.tan(radians(said.get(key) or 0.0)) for key in ("sweep_deg", "dihedral_deg"))
    quarter = np.array([[0.25 * chords[0], 0.0], [0.25 * chords[0] + span * sweep, span * rise]])
    turn = (0.0, radians(said.get("twist_deg") or 0.0))
    guides = []
    for k, (points, chord) in enumerate(zip(sections, chords, strict=True)):
        curve = _curve(points, chord, max(gaps) > SHARP_EDGE)
        x, z = curve.points[:, 0] - 0.25 * chord, curve.points[:, 1]
        c, s = np.cos(turn[k]), np.sin(turn[k])  # the nose, at x below zero, goes down
        placed = np.column_stack(
            [quarter[k, 0] + c * x - s * z, np.full(len(x), k * span), quarter[k, 1] + s * x + c * z]
        )
        guides.append(dataclasses.replace(curve, points=placed))
    return matched(guides[0], guides[1], "arc_length")


def _thick(points: FloatArray, least: float) -> FloatArray:
    """The section with a trailing edge of ``least`` chords, its sides moved apart in proportion to x."""
    gap = float(np.hypot(*(points[0] - points[-1])))
    if gap >= least:
        return points
    sign = np.where(np.arange(len(points)) <= _nose(points), 0.5, -0.5)
    return points + np.column_stack([0.0 * sign, sign * (least - gap) * np.clip(points[:, 0], 0.0, 1.0)])


def _nose(points: FloatArray) -> int:
    return int(np.argmax(np.hypot(*(points - 0.5 * (points[0] + points[-1])).T)))


def _curve(points: FloatArray, chord: float, blunt: bool) -> Curve:
    """A section [m] as a closed curve from the trailing edge along the lower side, kept together at the
    leading edge, the place farthest from the trailing edge, and at the trailing edge's one or two corners."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    curve = CubicSpline(way, points * chord)
    tail = 0.5 * chord * (points[0] + points[-1])
    at = _nose(points)
    near = np.linspace(way[max(at - 1, 0)], way[min(at + 1, len(way) - 1)], 4001)
    nose = near[int(np.argmax(np.hypot(*(curve(near) - tail).T)))]
    lower, upper = np.linspace(way[-1], nose, _SECTION_PLACES), np.linspace(nose, 0.0, _SECTION_PLACES)[1:]
    flat = curve(np.concatenate([lower, upper]))
    anchor = np.zeros(len(flat), dtype=np.bool_)
    anchor[[0, _SECTION_PLACES - 1, -1]] = True
    if not blunt:
        flat[0] = tail
        flat, anchor = flat[:-1], anchor[:-1]
    spread = np.column_stack([flat, np.zeros(len(flat))])
    return Curve(spread, np.arange(len(flat)) / len(flat), anchor, True)


SURFACE_PLACES: Final = 600
"""Places of a surface."""
OUTLINE_PLACES: Final = 6000
"""Places of all the outlines of a plate together, but for `LEAST_OUTLINE_PLACES` of each."""
LEAST_OUTLINE_PLACES: Final = 60
"""Places of one outline at least."""
CORNER_ANGLE_DEG: Final = 20.0
"""Angle [deg] of a corner, where none is stated."""
_SPLINE_PLACES: Final = 2000
"""Places along a spline."""


@dataclasses.dataclass(frozen=True)
class Surface:
    """One surface by the ``name`` it is cut by, from ``file`` (or "the problem's numbers"), as places
    ``samples``: several where the problem leaves open which (guides that fit in several ways).

    ``bound`` (K, 3) [m] are places that bound it. ``spare`` [m]: how far the problem allows what is cut to be
    off it besides. ``part_of``: only a piece of it is cut, so what is cut has to lie on it. ``facets``
    (F, 3, 3) [m] are its triangles in that case; ``face`` is it, where it is one.
    """

    name: str
    file: str
    samples: tuple[Samples, ...]
    bound: FloatArray
    spare: float = 0.0
    part_of: bool = False
    facets: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3, 3)))
    face: Face | None = None

    def rim(self) -> FloatArray:
        """The edges (E, 2, 3) [m] around a face; none of other surfaces."""
        return np.zeros((0, 2, 3)) if self.face is None else self.face.vertices[rims(self.face)]


FROM_NUMBERS: Final = "the problem's numbers"
"""Stands for a file's name where a part is given by numbers in the problem."""


def stated(part: Said, height: float, edges: bool = True) -> list[Surface]:
    """The surfaces of a part that is cut from a block ``height`` [m] high; ``edges``: those between front and
    back as well. Raises `UnreadError`, which names the file."""
    if part.get("front"):
        return _faces(part["front"], part.get("back"), edges)
    if part.get("ruled"):
        return [_ruled(own) for own in part["ruled"]]
    if part.get("wing"):
        return [_wing(part["wing"])]
    if part.get("plate"):
        return _plate(part["plate"], height)
    if part.get("mesh"):
        own = part["mesh"]
        face = _read(own, lambda: mesh_face(own))
        return [_of_face("patch", _name(own), face, metres(own.get("tolerance_mm", 0.5)))]
    if part.get("strips"):
        own = part["strips"]
        face, name = _face(own)
        found = _of_face("strip", name, face, metres(own.get("tolerance_mm", 1.0)))
        return [dataclasses.replace(found, part_of=True, facets=face.corners)]
    raise UnreadError("the problem's part is of a kind that is not known")


def _read(said: Said, reader: Callable[[], Any]) -> Any:
    """What a reader finds in a named file; its fault with the file's name."""
    path = file_of(said)
    try:
        return reader()
    except OSError as error:
        raise UnreadError(f"{path.name} cannot be opened ({error.strerror or error})") from error
    except UnreadError as error:
        raise UnreadError(f"{path.name} cannot be read a second time: {error}") from error


def _name(said: Said) -> str:
    return file_of(said).name


def _face(said: Said) -> tuple[Face, str]:
    """The face of a mesh, a Rhino or STEP file or a loft, and where it comes from."""
    for kind, reader in (("mesh", mesh_face), ("rhino", rhino.face), ("step", step.face)):
        if said.get(kind):
            own = said[kind]
            face: Face = _read(own, functools.partial(reader, own))
            return face, _name(own)
    return loft_face(said["loft"]), FROM_NUMBERS


def _of_face(name: str, file: str, face: Face, spare: float = 0.0) -> Surface:
    found = on_triangles(face.corners, face.number, SURFACE_PLACES)
    bound = face.vertices[np.unique(face.faces)]
    return Surface(name, file, (found,), bound, spare, face=face)


def _faces(front: Said, back: Said | None, edges: bool) -> list[Surface]:
    outer, name = _face(front)
    out = [_of_face("front", name, outer)]
    if not back:
        return out
    moved = back.get("offset_mm") is not None
    inner, other = (behind(outer, metres(back["offset_mm"])), name) if moved else _face(back)
    out.append(_of_face("back", other, inner))
    found = edges_of(outer, inner, moved) if edges else []
    if found:
        out.append(_of_rulings("edges", name, found))
    return out


def _of_rulings(
    name: str, file: str, found: list[Ruled], count: int = SURFACE_PLACES, guides: bool = False
) -> Surface:
    samples = tuple(on_rulings(one.start, one.end, count, guides) for one in found)
    return Surface(name, file, samples, np.concatenate([found[0].start, found[0].end]))


def _wing(said: Said) -> Surface:
    files = [Path(str(said[side]["file"])).name for side in ("root", "tip") if said[side].get("file")]
    name = " and ".join(dict.fromkeys(files)) or FROM_NUMBERS
    try:
        found = skin(said)
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read a second time: {error}") from error
    # by the least twist, only the sections themselves are known here
    return _of_rulings("skin", name, [found], guides=said.get("match") == "least_twist")


def _ruled(said: Said) -> Surface:
    closed = bool(said.get("closed"))
    match = str(said.get("match") or "arc_length")
    if said.get("rhino") or said.get("step"):
        own = said.get("rhino") or said["step"]
        reader = rhino.ruled_face if said.get("rhino") else step.ruled_face
        one = _read(own, lambda: reader(own))
        if closed:
            one = _outwards(one, bool(said.get("hole")))
        elif said.get("flip"):
            one = Ruled(one.start[::-1], one.end[::-1])
        return _of_rulings(str(said["name"]), _name(own), [one])
    start, end = (_guide(said[side], closed) for side in ("start", "end"))
    files = [_name(said[side][k]) for side in ("start", "end") for k in ("dxf", "rhino") if said[side].get(k)]
    found = joined(start, end, "arc_length" if match == "least_twist" else match)
    if not found:
        raise UnreadError(f"surface {said['name']}: its guides have other numbers of corners")
    if closed:
        found = [_outwards(one, bool(said.get("hole"))) for one in found]
    elif said.get("flip"):
        found = [Ruled(one.start[::-1], one.end[::-1]) for one in found]
    name = " and ".join(dict.fromkeys(files)) or FROM_NUMBERS
    return _of_rulings(str(said["name"]), name, found, guides=match == "least_twist")


def _guide(said: Said, closed: bool) -> Curve:
    angle = radians(said.get("corner_deg", CORNER_ANGLE_DEG))
    if said.get("polyline_mm") is not None:
        curve = through(row(said["polyline_mm"]), closed, angle)
    elif said.get("dxf") is not None or said.get("rhino") is not None:
        own = said.get("dxf") or said["rhino"]
        found = [c for c in _drawing(own, "rhino" if said.get("rhino") else "dxf") if c.closed == closed]
        if len(found) != 1:
            kind = "closed" if closed else "open"
            raise UnreadError(f"{_name(own)} has {len(found)} {kind} curves where it was read a second time")
        points = found[0].points
        if own.get("z_mm") is not None:
            points = np.column_stack([points[:, :2], np.full(len(points), metres(own["z_mm"]))])
        curve = through(points, closed, angle, either=found[0].pieces > 1)
    else:
        kind = "bspline_mm" if said.get("bspline_mm") is not None else "bezier_mm"
        curve = _smooth(row(said[kind]), kind, closed)
    if said.get("corners_mm") is not None:
        curve = anchored(curve, row(said["corners_mm"]).reshape(-1, 3))
    return curve


def _smooth(control: FloatArray, kind: str, closed: bool) -> Curve:
    """A spline without corners, but where a closed one's ends meet at an angle."""
    t = np.linspace(0.0, 1.0, _SPLINE_PLACES + 1)
    points = (bspline if kind == "bspline_mm" else bezier)(control, t)
    if closed:
        points, t = points[:-1], t[:-1]
    curve = through(points, closed, radians(CORNER_ANGLE_DEG))
    if len(curve.points) != len(points):
        return curve
    anchor = np.zeros(len(points), dtype=np.bool_)
    anchor[0] = curve.anchor[0]
    anchor[-1] = not closed
    return Curve(points, t, anchor, closed)


def _drawing(said: Said, kind: str) -> list[Drawn]:
    """The curves of a "dxf" or "rhino" file."""

    def reader() -> list[Drawn]:
        if kind == "rhino":
            return rhino.read_curves(said)
        return read_curves(file_of(said), UNITS[str(said["unit"])], said.get("layer"))

    found: list[Drawn] = _read(said, reader)
    return found


def _outwards(one: Ruled, hole: bool) -> Ruled:
    """A closed surface with its outer side away from what it goes around, or toward it for a hole."""
    middle = 0.5 * (one.start + one.end)
    middle = middle - middle.mean(axis=0)
    around = np.cross(middle[:-1], middle[1:]).sum(axis=0)
    outside = float(around @ (one.end - one.start).mean(axis=0)) > 0.0
    return one if outside != hole else Ruled(one.start[::-1], one.end[::-1])


def _plate(said: Said, height: float) -> list[Surface]:
    """The outlines; named after what they are alone, as their order is not told by the problem: ``outline``
    or ``hole``."""
    rings: list[FloatArray] = [_outline(own) for own in said.get("outlines") or ()]
    names = [FROM_NUMBERS] * len(rings)
    for kind in ("dxf", "rhino"):
        if said.get(kind):
            curves = _drawing(said[kind], kind)
            rings += [curve.points[:, :2] for curve in curves]
            names += [_name(said[kind])] * len(curves)
    count = min(SURFACE_PLACES, max(LEAST_OUTLINE_PLACES, OUTLINE_PLACES // max(len(rings), 1)))
    out = []
    for k, ring in enumerate(rings):
        around = sum(_inside(ring[0], other) for j, other in enumerate(rings) if j != k)
        hole = around % 2 == 1
        x, y = ring.T
        left = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) > 0.0
        ring = ring if left != hole else ring[::-1]
        base = np.column_stack([np.concatenate([ring, ring[:1]]), np.zeros(len(ring) + 1)])
        top = base + np.array([0.0, 0.0, height])
        out.append(_of_rulings("hole" if hole else "outline", names[k], [Ruled(base, top)], count))
    return out


def _outline(said: Said) -> FloatArray:
    """The ring (N, 2) [m] of one outline."""
    if said.get("circle"):
        angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
        centre = np.array([metres(value) for value in said["circle"]["centre_mm"]])
        return centre + metres(said["circle"]["radius_mm"]) * np.column_stack([np.cos(angle), np.sin(angle)])
    if said.get("polyline_mm"):
        return row(said["polyline_mm"])
    control = row(said["bspline_mm"])
    return bspline(np.concatenate([control, control[:1]]), np.linspace(0.0, 1.0, _SPLINE_PLACES + 1))[:-1]


def _inside(point: FloatArray, ring: FloatArray) -> bool:
    """Whether a point (2,) is inside of a closed ring (N, 2), by the edges that a ray to the right passes."""
    a, b = ring - point, np.roll(ring, -1, axis=0) - point
    crosses = (a[:, 1] > 0.0) != (b[:, 1] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool((crosses & (at > 0.0)).sum() % 2)
