"""The surfaces of a part as the problem's numbers and its files state them, in the part's own frame.

Among them is the skin of a wing panel, from its sections and the numbers that place them. Its frame has x
from the leading to the trailing edge, y from root to tip, z up, and its origin at the root's leading edge.

Airfoil sections come from coordinate files in Selig's or Lednicer's format, or from NACA digits by formulas.
A section is an array of points (N, 2), relative to the chord, from the trailing edge over the upper side to
the leading edge and back over the lower side.

Source: I. H. Abbott and A. E. von Doenhoff, Theory of Wing Sections (1959), 6.4 to 6.6; C. L. Ladson and C.
W. Brooks, NASA TM X-3284 (1975).
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
    Entry,
    Samples,
    UnreadError,
    file_of,
    metres,
    on_rulings,
    on_triangles,
    points_in_metres,
    radians,
    rhino,
    step,
)
from planner.proof.part_files.curves import (
    DrawingCurve,
    GuideCurve,
    GuideRulings,
    bezier,
    bspline,
    join_guides,
    match_guides,
    polyline_guide,
    read_curves,
    with_corners_at,
)
from planner.proof.part_files.meshes import (
    MeshFace,
    boundary_edges,
    loft_face,
    mesh_face,
    offset_inwards,
    ruled_edges,
)

_FIVE_DIGIT: Final = {
    1: (0.0580, 361.4),
    2: (0.1260, 51.64),
    3: (0.2025, 15.957),
    4: (0.29, 6.643),
    5: (0.391, 3.23),
}
"""Position m of the camber line's joint and its factor k1, for a lift coefficient of 0.3, by the second of
five NACA digits.
"""
_FIVE_DIGIT_REFLEX: Final = {
    2: (0.130, 51.990, 0.000764),
    3: (0.217, 15.793, 0.00677),
    4: (0.318, 6.520, 0.0303),
    5: (0.441, 3.191, 0.1355),
}
"""Position m, factor k1, and k2 / k1 after the joint, by the second of five NACA digits, if the third is
1.
"""
_SECTION_STATIONS: Final = 201
"""Number of positions along the chord of a section from NACA digits."""


def read_section(path: Path) -> FloatArray:
    """Read the section of a coordinate file, with its chord scaled to 1 if necessary.

    Raises:
        UnreadError: The file has no points, or other numbers of points than it states.
    """
    # Without a byte order mark. Each line with two numbers is a point, relative to the chord or not.
    pairs = _rows(path.read_bytes().decode("utf-8", errors="replace").lstrip("\ufeff"))
    if len(pairs) < 3:
        raise UnreadError("it has no points")
    first = pairs[0]
    # Lednicer's format starts with the numbers of points, and has both sides from the leading edge.
    if first.min() >= 2.5 and np.abs(first - np.rint(first)).max() < 1e-6:
        upper_count = round(first[0])
        if len(pairs) != 1 + upper_count + round(first[1]):
            raise UnreadError("its two sides do not have the numbers of points that it states")
        pairs = np.concatenate([pairs[upper_count:0:-1], pairs[upper_count + 1 :]])
    keep = np.append(True, np.hypot(*np.diff(pairs, axis=0).T) > 1e-9)
    points = pairs[keep]
    points = _from_trailing_edge(points)
    # Sections whose chord already extends from 0 to 1, within 0.2 %, stay as they are.
    nose_x, tail_x = points[:, 0].min(), 0.5 * (points[0, 0] + points[-1, 0])
    if max(abs(nose_x), abs(tail_x - nose_x - 1.0)) > 2e-3:
        points = np.column_stack([points[:, 0] - nose_x, points[:, 1]]) / (tail_x - nose_x)
    return np.asarray(points)


def _rows(text: str) -> FloatArray:
    """Return the pairs of numbers (N, 2) of a text, in order. Other lines are names and remarks."""
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


def _from_trailing_edge(points: FloatArray) -> FloatArray:
    """Return the points (N, 2) of a section from the trailing edge on, over the upper side first.

    Files may start at the nose, or run over the lower side first.
    """
    low, high = points[:, 0].min(), points[:, 0].max()
    if max(points[0, 0], points[-1, 0]) < 0.5 * (low + high):  # starts at the nose
        if np.hypot(*(points[0] - points[-1])) < 1e-9 * (high - low):
            points = points[:-1]
        points = np.roll(points, -int(np.argmax(points[:, 0])), axis=0)
    x, y = points.T
    twice_area = np.sum((x - np.roll(x, 1)) * (y + np.roll(y, 1)))  # twice the area, positive if clockwise
    return points if twice_area <= 0.0 else points[::-1]


def section_of_digits(digits: str) -> FloatArray:
    """Return the section (N, 2) of four or five NACA digits, relative to the chord.

    Raises:
        UnreadError: There is no camber line for the digits.
    """
    x = np.sin(0.5 * np.pi * np.linspace(0.0, 1.0, _SECTION_STATIONS)) ** 2  # denser at both edges
    line, slope = _camber(digits, x)
    thickness_factor = float(digits[-2:]) / 20.0  # 5 t, with the thickness t in percent
    half = thickness_factor * (0.2969 * x**0.5 - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)
    angle = np.arctan(slope)
    up = np.column_stack([x - half * np.sin(angle), line + half * np.cos(angle)])
    down = np.column_stack([x + half * np.sin(angle), line - half * np.cos(angle)])
    return np.vstack([up[::-1], down[1:]])


def _camber(digits: str, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return height and slope (N,) of the camber line of four or five NACA digits at x (N,).

    Heights and x are relative to the chord.

    Raises:
        UnreadError: There is no camber line for five digits.
    """
    if len(digits) == 4:
        high, position = int(digits[0]) / 100.0, int(digits[1]) / 10.0
        if high == 0.0:
            return 0.0 * x, 0.0 * x
        front = x <= position
        size = high / np.where(front, position, 1.0 - position) ** 2
        line = size * (2.0 * position * x - x**2 + np.where(front, 0.0, 1.0 - 2.0 * position))
        return line, size * 2.0 * (position - x)
    try:
        lift, second, third = int(digits[0]) * 0.15 / 0.3, int(digits[1]), int(digits[2])
        if third == 0:
            m, k = _FIVE_DIGIT[second]
            front = x < m
            line = np.where(front, x**3 - 3 * m * x**2 + m**2 * (3 - m) * x, m**3 * (1 - x))
            slope = np.where(front, 3 * x**2 - 6 * m * x + m**2 * (3 - m), -(m**3))
        else:
            m, k, ratio = _FIVE_DIGIT_REFLEX[second]
            back = np.where(x < m, 1.0, ratio)
            fall = ratio * (1 - m) ** 3 + m**3
            line = back * (x - m) ** 3 - fall * x + m**3
            slope = 3.0 * back * (x - m) ** 2 - fall
    except (KeyError, ValueError) as error:
        raise UnreadError(f"NACA {digits} is unknown") from error
    return lift * k / 6.0 * line, lift * k / 6.0 * slope


MAX_SHARP_EDGE_THICKNESS_M: Final = 1e-6
"""Thickness [m] up to which a trailing edge counts as sharp."""
_SECTION_POINTS: Final = 600
"""Number of points along each side of a section."""


def wing_skin(entry: Entry) -> GuideRulings:
    """Return the rulings of a wing panel's skin from root to tip, over the lower side first.

    In this order the surface faces away from the part.

    Raises:
        UnreadError: A section cannot be read.
    """
    min_edge = metres(entry.get("trailing_edge_mm") or 0.0)
    sections, chords = [], []
    for side in ("root", "tip"):
        section = entry[side]
        points = (
            read_section(file_of(section)) if section.get("file") else section_of_digits(str(section["naca"]))
        )
        chords.append(metres(section["chord_mm"]))
        sections.append(_with_trailing_edge(points, min_edge / chords[-1]))
    gaps = [
        float(np.hypot(*(points[0] - points[-1]))) * chord
        for points, chord in zip(sections, chords, strict=True)
    ]
    span = metres(entry["span_mm"])
    sweep, rise = (np.tan(radians(entry.get(key) or 0.0)) for key in ("sweep_deg", "dihedral_deg"))
    quarter_chord = np.array([[0.25 * chords[0], 0.0], [0.25 * chords[0] + span * sweep, span * rise]])
    twists = (0.0, radians(entry.get("twist_deg") or 0.0))
    guides = []
    for k, (points, chord) in enumerate(zip(sections, chords, strict=True)):
        curve = _section_curve(points, chord, max(gaps) > MAX_SHARP_EDGE_THICKNESS_M)
        x, z = curve.points[:, 0] - 0.25 * chord, curve.points[:, 1]
        c, s = np.cos(twists[k]), np.sin(twists[k])  # the nose, at negative x, moves down
        placed = np.column_stack(
            [
                quarter_chord[k, 0] + c * x - s * z,
                np.full(len(x), k * span),
                quarter_chord[k, 1] + s * x + c * z,
            ]
        )
        guides.append(dataclasses.replace(curve, points=placed))
    return match_guides(guides[0], guides[1], "arc_length")


def _with_trailing_edge(points: FloatArray, min_gap: float) -> FloatArray:
    """Return the section (N, 2) with a trailing edge at least ``min_gap`` thick, relative to the chord.

    If it is thinner, the upper and the lower side are moved apart in proportion to x.
    """
    gap = float(np.hypot(*(points[0] - points[-1])))
    if gap >= min_gap:
        return points
    sign = np.where(np.arange(len(points)) <= _nose(points), 0.5, -0.5)
    return points + np.column_stack([0.0 * sign, sign * (min_gap - gap) * np.clip(points[:, 0], 0.0, 1.0)])


def _nose(points: FloatArray) -> int:
    """Return the index of the point that is farthest from the trailing edge."""
    return int(np.argmax(np.hypot(*(points - 0.5 * (points[0] + points[-1])).T)))


def _section_curve(points: FloatArray, chord: float, blunt: bool) -> GuideCurve:
    """Return a section (N, 2) as a closed curve [m] from the trailing edge along the lower side.

    Its anchors are the leading edge, which is the point farthest from the trailing edge, and the corners of
    the trailing edge: two if it is ``blunt``, else one. The section is relative to the chord.
    """
    lengths = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    curve = CubicSpline(lengths, points * chord)
    tail = 0.5 * chord * (points[0] + points[-1])
    nose_index = _nose(points)
    nose_range = np.linspace(
        lengths[max(nose_index - 1, 0)], lengths[min(nose_index + 1, len(lengths) - 1)], 4001
    )
    nose = nose_range[int(np.argmax(np.hypot(*(curve(nose_range) - tail).T)))]
    lower = np.linspace(lengths[-1], nose, _SECTION_POINTS)
    upper = np.linspace(nose, 0.0, _SECTION_POINTS)[1:]
    flat = curve(np.concatenate([lower, upper]))
    anchor = np.zeros(len(flat), dtype=np.bool_)
    anchor[[0, _SECTION_POINTS - 1, -1]] = True
    if not blunt:
        flat[0] = tail
        flat, anchor = flat[:-1], anchor[:-1]
    in_space = np.column_stack([flat, np.zeros(len(flat))])
    return GuideCurve(in_space, np.arange(len(flat)) / len(flat), anchor, closed=True)


SURFACE_POINTS: Final = 600
"""Number of points at which a surface is compared."""
OUTLINE_POINTS: Final = 6000
"""Number of points at which all outlines of a plate together are compared, unless their minima add up to
more.
"""
MIN_OUTLINE_POINTS: Final = 60
"""Minimum number of points of one outline."""
CORNER_ANGLE_DEG: Final = 20.0
"""Angle [deg] of a corner if none is stated."""
_SPLINE_POINTS: Final = 2000
"""Number of points along a spline."""


@dataclasses.dataclass(frozen=True)
class PartSurface:
    """One surface of a part.

    Attributes:
        name: Name of the surface in the operations that cut it.
        file: Name of its file, or "the problem's numbers".
        samples: Points of the surface. There are several sets if its guides fit in several ways, and one of
            them must be produced.
        bound: Points (K, 3) [m] that bound the surface.
        spare: Additional deviation [m] that the problem allows.
        part_of: Whether only a piece of the surface is cut, which has to lie on it.
        facets: Triangles (F, 3, 3) [m] of the surface if ``part_of``, else none.
        face: The surface as a face, None for ruled surfaces.
    """

    name: str
    file: str
    samples: tuple[Samples, ...]
    bound: FloatArray
    spare: float = 0.0
    part_of: bool = False
    facets: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 3, 3)))
    face: MeshFace | None = None

    def rim(self) -> FloatArray:
        """Return the edges (E, 2, 3) [m] around a face, none for other surfaces."""
        return np.zeros((0, 2, 3)) if self.face is None else self.face.vertices[boundary_edges(self.face)]


FROM_NUMBERS: Final = "the problem's numbers"
"""Used instead of a file's name if a part is given by numbers in the problem."""


def part_surfaces(part: Entry, height: float, edges: bool = True) -> list[PartSurface]:
    """Return the surfaces of a part that is cut from a block.

    Args:
        part: The part as the problem file states it.
        height: Height [m] of the block.
        edges: Whether the edges between front and back are included.

    Raises:
        UnreadError: A file cannot be read; the message names it. Or the part is of an unknown kind.
    """
    if part.get("front"):
        return _front_and_back(part["front"], part.get("back"), edges)
    if part.get("ruled"):
        return [_read_ruled(entry) for entry in part["ruled"]]
    if part.get("wing"):
        return [_wing_surface(part["wing"])]
    if part.get("plate"):
        return _plate_outlines(part["plate"], height)
    if part.get("mesh"):
        entry = part["mesh"]
        face = _read_named(entry, lambda: mesh_face(entry))
        return [_face_surface("patch", _file_name(entry), face, metres(entry.get("tolerance_mm", 0.5)))]
    if part.get("strips"):
        entry = part["strips"]
        face, name = _read_face(entry)
        strip = _face_surface("strip", name, face, metres(entry.get("tolerance_mm", 1.0)))
        return [dataclasses.replace(strip, part_of=True, facets=face.corners)]
    raise UnreadError("the problem's part is of an unknown kind")


def _read_named(entry: Entry, reader: Callable[[], Any]) -> Any:
    """Return the result of a reader for the file of an entry. Errors are raised with the file's name."""
    path = file_of(entry)
    try:
        return reader()
    except OSError as error:
        raise UnreadError(f"{path.name} cannot be opened ({error.strerror or error})") from error
    except UnreadError as error:
        raise UnreadError(f"{path.name} cannot be read by the proof: {error}") from error


def _file_name(entry: Entry) -> str:
    """Return the name of the file of an entry, without its folder."""
    return file_of(entry).name


def _read_face(entry: Entry) -> tuple[MeshFace, str]:
    """Return the face of a mesh file, a Rhino file, a STEP file or a loft, and the name of its file."""
    for kind, reader in (("mesh", mesh_face), ("rhino", rhino.face), ("step", step.face)):
        if entry.get(kind):
            face_entry = entry[kind]
            face: MeshFace = _read_named(face_entry, functools.partial(reader, face_entry))
            return face, _file_name(face_entry)
    return loft_face(entry["loft"]), FROM_NUMBERS


def _face_surface(name: str, file: str, face: MeshFace, spare: float = 0.0) -> PartSurface:
    """Return a face as a surface with points to compare. ``spare`` [m] is the additional deviation."""
    samples = on_triangles(face.corners, face.number, SURFACE_POINTS)
    bound = face.vertices[np.unique(face.faces)]
    return PartSurface(name, file, (samples,), bound, spare, face=face)


def _front_and_back(front: Entry, back: Entry | None, edges: bool) -> list[PartSurface]:
    """Return the front of a panel, its back if it has one, and the ruled edges between both if requested.

    The back is a face of its own, or the front offset inwards. Without exactly one rim of each there are no
    edges.
    """
    front_face, name = _read_face(front)
    out = [_face_surface("front", name, front_face)]
    if not back:
        return out
    moved = back.get("offset_mm") is not None
    back_face, back_name = (
        (offset_inwards(front_face, metres(back["offset_mm"])), name) if moved else _read_face(back)
    )
    out.append(_face_surface("back", back_name, back_face))
    edge_surfaces = ruled_edges(front_face, back_face, moved) if edges else []
    if edge_surfaces:
        out.append(_ruled_surface("edges", name, edge_surfaces))
    return out


def _ruled_surface(
    name: str, file: str, candidates: list[GuideRulings], count: int = SURFACE_POINTS, guides: bool = False
) -> PartSurface:
    """Return a ruled surface with ``count`` points to compare, one set for each of the candidates.

    With ``guides``, the points lie only on both guides.
    """
    samples = tuple(on_rulings(candidate.start, candidate.end, count, guides) for candidate in candidates)
    return PartSurface(name, file, samples, np.concatenate([candidates[0].start, candidates[0].end]))


def _wing_surface(entry: Entry) -> PartSurface:
    """Return the skin of a wing panel. Errors are raised again with the names of the sections' files."""
    files = [Path(str(entry[side]["file"])).name for side in ("root", "tip") if entry[side].get("file")]
    name = " and ".join(dict.fromkeys(files)) or FROM_NUMBERS
    try:
        rulings = wing_skin(entry)
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read by the proof: {error}") from error
    # With least twist the rulings are chosen by the planner, so only the sections are known here.
    return _ruled_surface("skin", name, [rulings], guides=entry.get("match") == "least_twist")


def _read_ruled(entry: Entry) -> PartSurface:
    """Return a ruled surface: a face of a Rhino or STEP file, or the surface between two guides.

    A closed surface faces away from what it encloses, or toward it if it is a ``hole``. An open one is
    reversed by ``flip``. With the match "least_twist" the planner chooses the rulings, so only the guides are
    compared.
    """
    closed = bool(entry.get("closed"))
    match = str(entry.get("match") or "arc_length")
    if entry.get("rhino") or entry.get("step"):
        file_entry = entry.get("rhino") or entry["step"]
        reader = rhino.ruled_face if entry.get("rhino") else step.ruled_face
        candidate = _read_named(file_entry, lambda: reader(file_entry))
        if closed:
            candidate = _facing_outwards(candidate, bool(entry.get("hole")))
        elif entry.get("flip"):
            candidate = GuideRulings(candidate.start[::-1], candidate.end[::-1])
        return _ruled_surface(str(entry["name"]), _file_name(file_entry), [candidate])
    start, end = (_read_guide(entry[side], closed) for side in ("start", "end"))
    files = [
        _file_name(entry[side][k])
        for side in ("start", "end")
        for k in ("dxf", "rhino")
        if entry[side].get(k)
    ]
    candidates = join_guides(start, end, "arc_length" if match == "least_twist" else match)
    if not candidates:
        raise UnreadError(f"surface {entry['name']}: its guides have different numbers of corners")
    if closed:
        candidates = [_facing_outwards(candidate, bool(entry.get("hole"))) for candidate in candidates]
    elif entry.get("flip"):
        candidates = [GuideRulings(candidate.start[::-1], candidate.end[::-1]) for candidate in candidates]
    name = " and ".join(dict.fromkeys(files)) or FROM_NUMBERS
    return _ruled_surface(str(entry["name"]), name, candidates, guides=match == "least_twist")


def _read_guide(entry: Entry, closed: bool) -> GuideCurve:
    """Return a guide from a polyline, a spline, or the only curve of a drawing that is closed or open.

    ``closed`` says which curve of the drawing is meant. ``z_mm`` replaces its heights, and ``corners_mm`` the
    corners of any guide.
    """
    angle = radians(entry.get("corner_deg", CORNER_ANGLE_DEG))
    if entry.get("polyline_mm") is not None:
        curve = polyline_guide(points_in_metres(entry["polyline_mm"]), closed, angle)
    elif entry.get("dxf") is not None or entry.get("rhino") is not None:
        file_entry = entry.get("dxf") or entry["rhino"]
        matching = [
            c
            for c in _read_drawing(file_entry, "rhino" if entry.get("rhino") else "dxf")
            if c.closed == closed
        ]
        if len(matching) != 1:
            kind = "closed" if closed else "open"
            raise UnreadError(f"{_file_name(file_entry)} has {len(matching)} {kind} curves as read")
        points = matching[0].points
        if file_entry.get("z_mm") is not None:
            points = np.column_stack([points[:, :2], np.full(len(points), metres(file_entry["z_mm"]))])
        curve = polyline_guide(points, closed, angle, either=matching[0].pieces > 1)
    else:
        kind = "bspline_mm" if entry.get("bspline_mm") is not None else "bezier_mm"
        curve = _spline_guide(points_in_metres(entry[kind]), kind, closed)
    if entry.get("corners_mm") is not None:
        curve = with_corners_at(curve, points_in_metres(entry["corners_mm"]).reshape(-1, 3))
    return curve


def _spline_guide(control: FloatArray, kind: str, closed: bool) -> GuideCurve:
    """Return a spline as a guide, without corners except where the ends of a closed spline meet at an angle.

    Control points are (C, 3) [m]. ``kind`` is ``bspline_mm`` or ``bezier_mm``.
    """
    t = np.linspace(0.0, 1.0, _SPLINE_POINTS + 1)
    points = (bspline if kind == "bspline_mm" else bezier)(control, t)
    if closed:
        points, t = points[:-1], t[:-1]
    curve = polyline_guide(points, closed, radians(CORNER_ANGLE_DEG))
    if len(curve.points) != len(points):  # repeated points were removed, so t does not fit
        return curve
    anchor = np.zeros(len(points), dtype=np.bool_)
    anchor[0] = curve.anchor[0]
    anchor[-1] = not closed
    return GuideCurve(points, t, anchor, closed)


def _read_drawing(entry: Entry, kind: str) -> list[DrawingCurve]:
    """Return the curves of a "dxf" or "rhino" file."""

    def reader() -> list[DrawingCurve]:
        if kind == "rhino":
            return rhino.read_curves(entry)
        return read_curves(file_of(entry), UNITS[str(entry["unit"])], entry.get("layer"))

    drawing_curves: list[DrawingCurve] = _read_named(entry, reader)
    return drawing_curves


def _facing_outwards(surface: GuideRulings, hole: bool) -> GuideRulings:
    """Return a closed surface that faces away from what it encloses, or toward it if it is a ``hole``."""
    middle = 0.5 * (surface.start + surface.end)
    middle = middle - middle.mean(axis=0)
    # Vector area of the middle line. It points along the rulings if the surface faces outwards.
    around = np.cross(middle[:-1], middle[1:]).sum(axis=0)
    outside = float(around @ (surface.end - surface.start).mean(axis=0)) > 0.0
    return surface if outside != hole else GuideRulings(surface.start[::-1], surface.end[::-1])


def _plate_outlines(entry: Entry, height: float) -> list[PartSurface]:
    """Return the vertical surfaces through the outlines of a plate of ``height`` [m].

    They are named by their kind, ``outline`` or ``hole``, because the problem does not define their order. An
    outline inside an odd number of others is a hole.
    """
    rings: list[FloatArray] = [_read_outline(outline) for outline in entry.get("outlines") or ()]
    names = [FROM_NUMBERS] * len(rings)
    for kind in ("dxf", "rhino"):
        if entry.get(kind):
            curves = _read_drawing(entry[kind], kind)
            rings += [curve.points[:, :2] for curve in curves]
            names += [_file_name(entry[kind])] * len(curves)
    count = min(SURFACE_POINTS, max(MIN_OUTLINE_POINTS, OUTLINE_POINTS // max(len(rings), 1)))
    out = []
    for k, ring in enumerate(rings):
        enclosing_count = sum(_is_inside(ring[0], other) for j, other in enumerate(rings) if j != k)
        hole = enclosing_count % 2 == 1
        x, y = ring.T
        anticlockwise = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) > 0.0
        ring = ring if anticlockwise != hole else ring[::-1]
        base = np.column_stack([np.concatenate([ring, ring[:1]]), np.zeros(len(ring) + 1)])
        top = base + np.array([0.0, 0.0, height])
        out.append(_ruled_surface("hole" if hole else "outline", names[k], [GuideRulings(base, top)], count))
    return out


def _read_outline(entry: Entry) -> FloatArray:
    """Return the points (N, 2) [m] of one closed outline: a circle, a polyline or a B-spline."""
    if entry.get("circle"):
        angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
        centre = np.array([metres(value) for value in entry["circle"]["centre_mm"]])
        return centre + metres(entry["circle"]["radius_mm"]) * np.column_stack([np.cos(angle), np.sin(angle)])
    if entry.get("polyline_mm"):
        return points_in_metres(entry["polyline_mm"])
    control = points_in_metres(entry["bspline_mm"])
    return bspline(np.concatenate([control, control[:1]]), np.linspace(0.0, 1.0, _SPLINE_POINTS + 1))[:-1]


def _is_inside(point: FloatArray, ring: FloatArray) -> bool:
    """Return whether a point (2,) is inside a closed polyline (N, 2).

    It is inside if a ray along x crosses an odd number of edges.
    """
    a, b = ring - point, np.roll(ring, -1, axis=0) - point
    crosses = (a[:, 1] > 0.0) != (b[:, 1] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_x = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool((crosses & (crossing_x > 0.0)).sum() % 2)
