"""Curves, ruled faces, faces and meshes of Rhino files (3DM), read a second time.

rhino3dm parses the file; which objects are meant, what their NURBS are and where a face ends is
worked out here. B-splines by Cox and de Boor's steps on homogeneous points: L. Piegl, W. Tiller, The
NURBS Book (1997), 4.2 to 4.4.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from planner.geometry.arrays import FloatArray, spread_rows
from planner.proof.part_files import UNITS, Said, UnreadError, file_of
from planner.proof.part_files.curves import Drawn, Ruled, chained, nurbs
from planner.proof.part_files.meshes import STRAIGHT, Face, Region, face_of, gridded, rulings

_UNIT_NAMES: Final = {
    "Microns": 1 / 1_000_000,
    "Millimeters": 1 / 1000,
    "Centimeters": 1 / 100,
    "Decimeters": 1 / 10,
    "Meters": 1.0,
    "Kilometers": 1000.0,
    "Mils": 254 / 10_000_000,
    "Inches": 254 / 10_000,
    "Feet": 3048 / 10_000,
    "Yards": 9144 / 10_000,
}
"""Rhino's names of units [m]."""
_CHORDS: Final = 192
"""Chords of each span of a curve."""
_EDGE_PLACES: Final = 17
"""Places of an edge at most at which it is looked at, its ends among them."""
_SEAM_PLACES: Final = 41
"""Places along an end of a surface at which it is held against the other end."""
_CORNER_OFF: Final = 2e-5
"""A corner of a face is off its surface by this at most [m]."""
_THIN: Final = 1e-3
"""Share of a surface's parameters within which a place is at an end of them."""
_DRAWN_FACES: Final = ("Brep", "Extrusion", "Surface")
"""Kinds of objects that have faces."""


def read_curves(said: Said) -> list[Drawn]:
    """The curves that are asked for, joined where ends meet. Raises `UnreadError`."""
    model, size = _model(said)
    pieces = []
    for one in _asked(model, said):
        if _kind(one) == "Curve":
            own = one.ToNurbsCurve()
            control = _points(own.Points)
            knots = _whole(list(own.Knots))
            spans = np.unique(knots[own.Degree : len(control) + 1])
            inner = np.linspace(0.0, 1.0, _CHORDS, endpoint=False)
            t = np.append((spans[:-1, None] + np.diff(spans)[:, None] * inner).ravel(), spans[-1])
            pieces.append(size * _over(nurbs(control, np.ones(len(control)), knots, own.Degree, t)))
    if not pieces:
        raise UnreadError("it has no curve of what is asked for")
    return chained(pieces)


def ruled_face(said: Said) -> Ruled:
    """The rulings of a ruled face, its normal tangent x ruling, the first one again at the end of a closed
    one. Raises `UnreadError`."""
    found = _surface(said)
    _, start, end = rulings(found.at, found.region, found.knots, said.get("rulings"))
    middle = len(start) // 2
    up = np.cross(start[middle + 1] - start[middle - 1], end[middle] - start[middle])
    if float(up @ found.normal(0.5)) < 0.0:
        start, end = start[::-1], end[::-1]
    return Ruled(start, end)


def face(said: Said) -> Face:
    """A face on a grid of exact places, or a mesh. Raises `UnreadError`."""
    model, size = _model(said)
    meshes = [one for one in _asked(model, said) if _kind(one) == "Mesh"]
    if meshes:
        own = meshes[0]
        places = size * np.array([(p.X, p.Y, p.Z) for p in own.Vertices.ToPoint3dArray()], dtype=np.float64)
        rows, corners = [], []
        for k in range(len(own.Faces)):
            a, b, c, d = own.Faces[k]
            for three in ((a, b, c), (a, c, d)) if c != d else ((a, b, c),):
                rows.append(k + 1)
                corners.append(places[list(three)])
        return face_of(np.array(corners), np.array(rows), bool(said.get("flip")))
    found = _surface(said)
    return gridded(found.at, *found.region, found.reversed != bool(said.get("flip")), found.knots)


@dataclasses.dataclass(frozen=True)
class _Patch:
    """A surface: degrees, knots, ``control`` (C, D, 4) homogeneous [m], the ``region`` of its face, u and v,
    whether the face's normal is ``reversed``."""

    degree: tuple[int, int]
    knots: tuple[FloatArray, FloatArray]
    control: FloatArray
    region: Region
    reversed: bool

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Places (N, 3) at u, v (N,)."""
        count, across = self.control.shape[:2]
        rows = self.control.reshape(count, across * 4)
        lines = nurbs(rows, np.ones(count), self.knots[0], self.degree[0], u).reshape(-1, across, 4)
        return _over(nurbs(lines, np.ones(across), self.knots[1], self.degree[1], v))

    def normal(self, share: float) -> FloatArray:
        """The face's normal (3,), of no stated length, at a share of its region."""
        (u0, u1), (v0, v1) = self.region
        u, v = u0 + share * (u1 - u0), v0 + share * (v1 - v0)
        du, dv = 1e-4 * (u1 - u0), 1e-4 * (v1 - v0)
        p = self.at(np.array([u - du, u + du, u, u]), np.array([v, v, v - dv, v + dv]))
        up = np.cross(p[1] - p[0], p[3] - p[2])
        return -up if self.reversed else np.asarray(up)


def _surface(said: Said) -> _Patch:
    model, size = _model(said)
    found = [
        (one, brep)
        for solid in _asked(model, said)
        if _kind(solid) in _DRAWN_FACES
        for brep in [solid.ToBrep(True) if _kind(solid) == "Extrusion" else solid]
        for one in brep.Faces
    ]
    if len(found) != 1:
        raise UnreadError(f"it has {len(found)} faces of what is asked for")
    one, brep = found[0]
    own = one.UnderlyingSurface().ToNurbsSurface()
    shape = own.Points.CountU, own.Points.CountV
    control = np.array(
        [_homogeneous(own.Points.GetControlPoint(i, j)) for i in range(shape[0]) for j in range(shape[1])]
    ).reshape(*shape, 4) * np.array([size, size, size, 1.0])
    knots = _whole(own.KnotsU.ToList()), _whole(own.KnotsV.ToList())
    degree = own.OrderU - 1, own.OrderV - 1
    ends = [(float(k[p]), float(k[-p - 1])) for k, p in zip(knots, degree, strict=True)]
    whole = _Patch(degree, knots, control, (ends[0], ends[1]), bool(one.OrientationIsReversed))
    if len(one.Loops) != 1:
        raise UnreadError("its face has holes")
    return dataclasses.replace(whole, region=_region(whole, one.Loops[0].Trims, brep.Edges, size))


def _region(whole: _Patch, trims: Any, edges: Any, size: float) -> Region:
    """The parameters between which a face lies, by places of its edges."""
    numbers = [trim.EdgeIndex for trim in trims if trim.EdgeIndex >= 0]
    places = []
    for number in set(numbers):
        own = edges[number].ToNurbsCurve()
        knots = np.unique(list(own.Knots))
        every = np.sort(np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])]))
        for t in every[spread_rows(len(every), _EDGE_PLACES)]:
            point = own.PointAt(float(t))
            places.append((point.X, point.Y, point.Z))
    where = np.array([_inverted(whole, size * np.array(place)) for place in places])
    region = []
    for k, (low, high) in enumerate(whole.region):
        near = _THIN * (high - low)
        at = where[:, k]
        inner = at[(at > low + near) & (at < high - near)]
        if _meets_itself(whole, k) and len(inner):
            # on the seam it is either end: both of a face all round, else the one next to the face
            end = low if inner.min() - low <= high - inner.max() else high
            both = len(set(numbers)) < len(numbers)
            at = np.append(inner, (low, high) if both else end)
        a, b = float(at.min()), float(at.max())
        region.append((low if a - low < near else a, high if high - b < near else b))
    return region[0], region[1]


def _meets_itself(patch: _Patch, along: int) -> bool:
    """Whether a whole surface ends along u (0) or v (1) where it begins."""
    (low, high), other = patch.region[along], patch.region[1 - along]
    t = np.linspace(*other, _SEAM_PLACES)
    ends = [np.full(len(t), end) for end in (low, high)]
    first, last = (patch.at(end, t) if along == 0 else patch.at(t, end) for end in ends)
    return bool(np.linalg.norm(first - last, axis=1).max() < STRAIGHT)


def _inverted(patch: _Patch, point: FloatArray) -> FloatArray:
    """Parameters (2,) of a point of a surface."""
    grid = [np.linspace(low, high, 60) for low, high in patch.region]
    u, v = (part.ravel() for part in np.meshgrid(*grid, indexing="ij"))
    first = int(np.linalg.norm(patch.at(u, v) - point, axis=1).argmin())
    low, high = np.array(patch.region).T
    begin = np.clip([u[first], v[first]], low + 1e-9 * (high - low), high - 1e-9 * (high - low))

    def off(where: FloatArray) -> FloatArray:
        return np.asarray(1e3 * (patch.at(where[:1], where[1:])[0] - point))

    least = 1e-15
    found = least_squares(
        off, begin, bounds=(low, high), x_scale=high - low, xtol=least, ftol=least, gtol=least
    )
    if np.linalg.norm(found.fun) > 1e3 * _CORNER_OFF:
        raise UnreadError("a corner of its face is not on its surface")
    return np.asarray(found.x)


def _model(said: Said) -> tuple[Any, float]:
    """The file, and the metres of its lengths."""
    path: Path = file_of(said)
    try:
        import rhino3dm
    except ImportError as error:
        raise UnreadError("3DM files need rhino3dm: pip install 'tandem-planner[cad]'") from error
    path.stat()
    model = rhino3dm.File3dm.Read(str(path))
    if model is None:
        raise UnreadError("it is no 3DM file that can be read")
    name = str(model.Settings.ModelUnitSystem).split(".")[-1]
    if name in _UNIT_NAMES:
        return model, _UNIT_NAMES[name]
    if said.get("unit") is None:
        raise UnreadError(f"its unit is not known ({name})")
    return model, UNITS[str(said["unit"])]


def _asked(model: Any, said: Said) -> Iterator[Any]:
    """Visible objects outside of blocks that have the layer, name and colour that are asked for."""
    by_index = {layer.Index: layer for layer in model.Layers}
    hidden = [layer.FullPath for layer in by_index.values() if not layer.Visible]
    for one in model.Objects:
        own = one.Attributes
        layer = by_index[own.LayerIndex]
        path = str(layer.FullPath)
        if own.IsInstanceDefinitionObject or not own.Visible:
            continue
        if any(path == off or path.startswith(f"{off}::") for off in hidden):
            continue
        if said.get("layer") and str(said["layer"]).lower() not in (
            path.lower(),
            path.lower().split("::")[-1],
        ):
            continue
        if said.get("name") and own.Name.lower() != str(said["name"]).lower():
            continue
        if said.get("colour") and tuple(bytes.fromhex(str(said["colour"])[1:])) != tuple(
            own.DrawColor(model)[:3]
        ):
            continue
        yield one.Geometry


def _kind(geometry: Any) -> str:
    return str(geometry.ObjectType).split(".")[-1]


def _whole(knots: Any) -> FloatArray:
    """All knots: the file leaves out the outermost ones."""
    return np.array([knots[0], *knots, knots[-1]], dtype=np.float64)


def _homogeneous(point: Any) -> tuple[float, float, float, float]:
    return point.X, point.Y, point.Z, point.W


def _points(points: Any) -> FloatArray:
    return np.array([_homogeneous(point) for point in points], dtype=np.float64)


def _over(homogeneous: FloatArray) -> FloatArray:
    return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:])
