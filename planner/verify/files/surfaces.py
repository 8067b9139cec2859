"""The surfaces of a part as the problem's numbers and its files state them, in the part's own frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.verify.files.drawings import Drawn, read_curves
from planner.verify.files.faults import UnreadError
from planner.verify.files.guides import Curve, Ruled, anchored, joined, through
from planner.verify.files.meshed import Face, behind, edges_of, loft_face, mesh_face, rims
from planner.verify.files.samples import Samples, on_rulings, on_triangles
from planner.verify.files.splines import bezier, bspline
from planner.verify.files.values import UNITS, Said, file_of, metres, radians, row
from planner.verify.files.wings import skin

FloatArray = NDArray[np.float64]

COUNT: Final = 600
"""Places of a surface."""
SEVERAL: Final = 6000
"""Places of all the outlines of a plate together, but for `LEAST` of each."""
LEAST: Final = 60
CORNER: Final = 20.0
"""Angle [deg] of a corner, where none is stated."""
_CURVE: Final = 2000
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


NUMBERS: Final = "the problem's numbers"


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
    """The face of a mesh or a loft, and where it comes from."""
    if said.get("mesh"):
        own = said["mesh"]
        face: Face = _read(own, lambda: mesh_face(own))
        return face, _name(own)
    return loft_face(said["loft"]), NUMBERS


def _of_face(name: str, file: str, face: Face, spare: float = 0.0) -> Surface:
    found = on_triangles(face.corners, face.number, COUNT)
    bound = face.vertices[np.unique(face.faces)]
    return Surface(name, file, (found,), bound, spare, face=face)


def _faces(front: Said, back: Said | None, edges: bool) -> list[Surface]:
    outer, name = _face(front)
    out = [_of_face("front", name, outer)]
    if not back:
        return out
    if back.get("mesh"):
        own = back["mesh"]
        inner: Face = _read(own, lambda: mesh_face(own))
        out.append(_of_face("back", _name(own), inner))
    else:
        inner = behind(outer, metres(back["offset_mm"]))
        out.append(_of_face("back", name, inner))
    found = edges_of(outer, inner, moved=not back.get("mesh")) if edges else []
    if found:
        out.append(_of_rulings("edges", name, found))
    return out


def _of_rulings(
    name: str, file: str, found: list[Ruled], count: int = COUNT, guides: bool = False
) -> Surface:
    samples = tuple(on_rulings(one.start, one.end, count, guides) for one in found)
    return Surface(name, file, samples, np.concatenate([found[0].start, found[0].end]))


def _wing(said: Said) -> Surface:
    files = [Path(str(said[side]["file"])).name for side in ("root", "tip") if said[side].get("file")]
    name = " and ".join(dict.fromkeys(files)) or NUMBERS
    try:
        found = skin(said)
    except (UnreadError, OSError) as error:
        raise UnreadError(f"{name} cannot be read a second time: {error}") from error
    # by the least twist, only the sections themselves are known here
    return _of_rulings("skin", name, [found], guides=said.get("match") == "least_twist")


def _ruled(said: Said) -> Surface:
    closed = bool(said.get("closed"))
    match = str(said.get("match") or "arc_length")
    start, end = (_guide(said[side], closed) for side in ("start", "end"))
    files = [_name(said[side]["dxf"]) for side in ("start", "end") if said[side].get("dxf")]
    found = joined(start, end, "arc_length" if match == "least_twist" else match)
    if not found:
        raise UnreadError(f"surface {said['name']}: its guides have other numbers of corners")
    if closed:
        found = [_outwards(one, bool(said.get("hole"))) for one in found]
    elif said.get("flip"):
        found = [Ruled(one.start[::-1], one.end[::-1]) for one in found]
    name = " and ".join(dict.fromkeys(files)) or NUMBERS
    return _of_rulings(str(said["name"]), name, found, guides=match == "least_twist")


def _guide(said: Said, closed: bool) -> Curve:
    angle = radians(said.get("corner_deg", CORNER))
    if said.get("polyline_mm") is not None:
        curve = through(row(said["polyline_mm"]), closed, angle)
    elif said.get("dxf") is not None:
        own = said["dxf"]
        found = [c for c in _drawing(own) if c.closed == closed]
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
    t = np.linspace(0.0, 1.0, _CURVE + 1)
    points = (bspline if kind == "bspline_mm" else bezier)(control, t)
    if closed:
        points, t = points[:-1], t[:-1]
    curve = through(points, closed, radians(CORNER))
    if len(curve.points) != len(points):
        return curve
    anchor = np.zeros(len(points), dtype=np.bool_)
    anchor[0] = curve.anchor[0]
    anchor[-1] = not closed
    return Curve(points, t, anchor, closed)


def _drawing(said: Said) -> list[Drawn]:
    found: list[Drawn] = _read(
        said, lambda: read_curves(file_of(said), UNITS[str(said["unit"])], said.get("layer"))
    )
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
    names = [NUMBERS] * len(rings)
    if said.get("dxf"):
        curves = _drawing(said["dxf"])
        rings += [curve.points[:, :2] for curve in curves]
        names += [_name(said["dxf"])] * len(curves)
    count = min(COUNT, max(LEAST, SEVERAL // max(len(rings), 1)))
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
    return bspline(np.concatenate([control, control[:1]]), np.linspace(0.0, 1.0, _CURVE + 1))[:-1]


def _inside(point: FloatArray, ring: FloatArray) -> bool:
    """Whether a point (2,) is inside of a closed ring (N, 2), by the edges that a ray to the right passes."""
    a, b = ring - point, np.roll(ring, -1, axis=0) - point
    crosses = (a[:, 1] > 0.0) != (b[:, 1] > 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return bool((crosses & (at > 0.0)).sum() % 2)
