"""Curves, ruled faces, faces and meshes of Rhino files (3DM), read independently of the planner.

rhino3dm parses the file. The selection of objects, the evaluation of their NURBS and the extent of a face are
computed here.

Source: B-splines by Cox and de Boor's recursion on homogeneous points: L. Piegl, W. Tiller, The NURBS Book
(1997), 4.2 to 4.4.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares

from planner.geometry.arrays import FloatArray, spread_rows
from planner.proof.part_files import UNITS, Entry, UnreadError, file_of
from planner.proof.part_files.curves import DrawingCurve, GuideRulings, join_pieces, nurbs
from planner.proof.part_files.meshes import (
    STRAIGHT_TOLERANCE_M,
    MeshFace,
    Region,
    face_of,
    grid_face,
    rulings,
)

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
"""Length units [m] by their names in Rhino."""
_CHORDS: Final = 192
"""Number of chords of each span of a curve."""
_EDGE_POINTS: Final = 17
"""Maximum number of points of an edge of a face that are examined, including its ends."""
_SEAM_POINTS: Final = 41
"""Number of points of a surface's first isoline that are compared with its last one, to find a seam."""
_CORNER_TOLERANCE_M: Final = 2e-5
"""Maximum distance [m] of a corner of a face from its surface."""
_END_FRACTION: Final = 1e-3
"""Distance from an end of a surface's parameter range, as a fraction of the range, up to which a point counts
as at the end.
"""
_FACE_KINDS: Final = ("Brep", "Extrusion", "Surface")
"""Kinds of objects that have faces."""


def read_curves(entry: Entry) -> list[DrawingCurve]:
    """Read the requested curves, joined at common ends.

    Raises:
        UnreadError: The file cannot be read, or has no such curve.
    """
    model, size = _read_model(entry)
    pieces = []
    for geometry in _selected_geometry(model, entry):
        if _kind(geometry) == "Curve":
            curve = geometry.ToNurbsCurve()
            control = _homogeneous_points(curve.Points)
            knots = _full_knots(list(curve.Knots))
            spans = np.unique(knots[curve.Degree : len(control) + 1])
            inner = np.linspace(0.0, 1.0, _CHORDS, endpoint=False)
            t = np.append((spans[:-1, None] + np.diff(spans)[:, None] * inner).ravel(), spans[-1])
            pieces.append(
                size * _from_homogeneous(nurbs(control, np.ones(len(control)), knots, curve.Degree, t))
            )
    if not pieces:
        raise UnreadError("it has no curve that matches the selection")
    return join_pieces(pieces)


def ruled_face(entry: Entry) -> GuideRulings:
    """Read the rulings of a ruled face, in the order in which the face's normal is tangent x ruling.

    At the end of a closed face the first ruling is repeated.

    Raises:
        UnreadError: The file cannot be read, or the face is not ruled.
    """
    patch = _only_surface(entry)
    _, start, end = rulings(patch.at, patch.region, patch.knots, entry.get("rulings"))
    middle = len(start) // 2
    up = np.cross(start[middle + 1] - start[middle - 1], end[middle] - start[middle])
    if float(up @ patch.normal(0.5)) < 0.0:
        start, end = start[::-1], end[::-1]
    return GuideRulings(start, end)


def face(entry: Entry) -> MeshFace:
    """Read a face on a grid of exact points, or a mesh.

    Raises:
        UnreadError: The file cannot be read, or has no such face.
    """
    model, size = _read_model(entry)
    meshes = [geometry for geometry in _selected_geometry(model, entry) if _kind(geometry) == "Mesh"]
    if meshes:
        mesh = meshes[0]
        vertices = size * np.array(
            [(p.X, p.Y, p.Z) for p in mesh.Vertices.ToPoint3dArray()], dtype=np.float64
        )
        numbers, corners = [], []
        for k in range(len(mesh.Faces)):
            a, b, c, d = mesh.Faces[k]
            for triangle in ((a, b, c), (a, c, d)) if c != d else ((a, b, c),):
                numbers.append(k + 1)
                corners.append(vertices[list(triangle)])
        return face_of(np.array(corners), np.array(numbers), bool(entry.get("flip")))
    patch = _only_surface(entry)
    return grid_face(patch.at, *patch.region, patch.reversed != bool(entry.get("flip")), patch.knots)


@dataclasses.dataclass(frozen=True)
class _NurbsPatch:
    """A NURBS surface, and the face on it.

    Attributes:
        degree: Degrees along u and v.
        knots: Knots along u and v.
        control: Homogeneous control points (C, D, 4) [m].
        region: Ranges of the parameters u and v that the face covers.
        reversed: Whether the face's normal is -dS/du x dS/dv.
    """

    degree: tuple[int, int]
    knots: tuple[FloatArray, FloatArray]
    control: FloatArray
    region: Region
    reversed: bool

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return points (N, 3) at u, v (N,)."""
        count, across = self.control.shape[:2]
        flat_control = self.control.reshape(count, across * 4)
        lines = nurbs(flat_control, np.ones(count), self.knots[0], self.degree[0], u).reshape(-1, across, 4)
        return _from_homogeneous(nurbs(lines, np.ones(across), self.knots[1], self.degree[1], v))

    def normal(self, fraction: float) -> FloatArray:
        """Return the face's normal (3,), not normalised, at a fraction of its parameter ranges."""
        (u0, u1), (v0, v1) = self.region
        u, v = u0 + fraction * (u1 - u0), v0 + fraction * (v1 - v0)
        du, dv = 1e-4 * (u1 - u0), 1e-4 * (v1 - v0)
        p = self.at(np.array([u - du, u + du, u, u]), np.array([v, v, v - dv, v + dv]))
        up = np.cross(p[1] - p[0], p[3] - p[2])
        return -up if self.reversed else np.asarray(up)


def _only_surface(entry: Entry) -> _NurbsPatch:
    """Return the only face that the entry selects, as a NURBS surface with the ranges that the face covers.

    Raises:
        UnreadError: The selection has not exactly one face, or the face has holes.
    """
    model, size = _read_model(entry)
    candidates = [
        (brep_face, brep)
        for solid in _selected_geometry(model, entry)
        if _kind(solid) in _FACE_KINDS
        for brep in [solid.ToBrep(True) if _kind(solid) == "Extrusion" else solid]
        for brep_face in brep.Faces
    ]
    if len(candidates) != 1:
        raise UnreadError(f"{len(candidates)} of its faces match the selection")
    brep_face, brep = candidates[0]
    nurbs_surface = brep_face.UnderlyingSurface().ToNurbsSurface()
    shape = nurbs_surface.Points.CountU, nurbs_surface.Points.CountV
    control = np.array(
        [
            _homogeneous(nurbs_surface.Points.GetControlPoint(i, j))
            for i in range(shape[0])
            for j in range(shape[1])
        ]
    ).reshape(*shape, 4) * np.array([size, size, size, 1.0])
    knots = _full_knots(nurbs_surface.KnotsU.ToList()), _full_knots(nurbs_surface.KnotsV.ToList())
    degree = nurbs_surface.OrderU - 1, nurbs_surface.OrderV - 1
    ends = [(float(k[p]), float(k[-p - 1])) for k, p in zip(knots, degree, strict=True)]
    whole = _NurbsPatch(degree, knots, control, (ends[0], ends[1]), bool(brep_face.OrientationIsReversed))
    if len(brep_face.Loops) != 1:
        raise UnreadError("its face has holes")
    return dataclasses.replace(whole, region=_face_region(whole, brep_face.Loops[0].Trims, brep.Edges, size))


def _face_region(whole: _NurbsPatch, trims: Any, edges: Any, size: float) -> Region:
    """Return the ranges of u and v that a face covers, from points of the edges that bound it.

    A bound near an end of the surface's own range becomes this end.

    Args:
        whole: The surface, with its own ranges.
        trims: Trims of the face's only loop. Each refers to an edge.
        edges: Edges of the body.
        size: Metres per unit of the file.

    Raises:
        UnreadError: An edge is not on the surface.
    """
    numbers = [trim.EdgeIndex for trim in trims if trim.EdgeIndex >= 0]
    edge_points = []
    for number in set(numbers):
        edge_curve = edges[number].ToNurbsCurve()
        knots = np.unique(list(edge_curve.Knots))
        edge_parameters = np.sort(np.concatenate([knots, 0.5 * (knots[1:] + knots[:-1])]))
        for t in edge_parameters[spread_rows(len(edge_parameters), _EDGE_POINTS)]:
            point = edge_curve.PointAt(float(t))
            edge_points.append((point.X, point.Y, point.Z))
    parameters = np.array(
        [_surface_parameters(whole, size * np.array(edge_point)) for edge_point in edge_points]
    )
    region = []
    for k, (low, high) in enumerate(whole.region):
        tolerance = _END_FRACTION * (high - low)
        values = parameters[:, k]
        inner = values[(values > low + tolerance) & (values < high - tolerance)]
        if _is_closed_along(whole, k) and len(inner):
            # A point on the seam has two parameters, low and high. A face all round, which has one edge
            # twice, extends to both. Another face extends to the one next to its inner points.
            end = low if inner.min() - low <= high - inner.max() else high
            is_all_round = len(set(numbers)) < len(numbers)
            values = np.append(inner, (low, high) if is_all_round else end)
        a, b = float(values.min()), float(values.max())
        region.append((low if a - low < tolerance else a, high if high - b < tolerance else b))
    return region[0], region[1]


def _is_closed_along(patch: _NurbsPatch, along: int) -> bool:
    """Return whether a surface is closed along u (0) or v (1): whether it ends where it starts."""
    (low, high), other = patch.region[along], patch.region[1 - along]
    t = np.linspace(*other, _SEAM_POINTS)
    ends = [np.full(len(t), end) for end in (low, high)]
    first, last = (patch.at(end, t) if along == 0 else patch.at(t, end) for end in ends)
    return bool(np.linalg.norm(first - last, axis=1).max() < STRAIGHT_TOLERANCE_M)


def _surface_parameters(patch: _NurbsPatch, point: FloatArray) -> FloatArray:
    """Return the parameters (2,) of a point (3,) [m] of a surface: nearest grid point, then least squares."""
    grid = [np.linspace(low, high, 60) for low, high in patch.region]
    u, v = (part.ravel() for part in np.meshgrid(*grid, indexing="ij"))
    first = int(np.linalg.norm(patch.at(u, v) - point, axis=1).argmin())
    low, high = np.array(patch.region).T
    start = np.clip([u[first], v[first]], low + 1e-9 * (high - low), high - 1e-9 * (high - low))

    def residual(parameters: FloatArray) -> FloatArray:
        """Return the vector (3,) [mm] from the point to the surface at parameters (2,)."""
        return np.asarray(1e3 * (patch.at(parameters[:1], parameters[1:])[0] - point))  # mm

    tolerance = 1e-15
    solution = least_squares(
        residual,
        start,
        bounds=(low, high),
        x_scale=high - low,
        xtol=tolerance,
        ftol=tolerance,
        gtol=tolerance,
    )
    if np.linalg.norm(solution.fun) > 1e3 * _CORNER_TOLERANCE_M:
        raise UnreadError("a corner of its face is not on its surface")
    return np.asarray(solution.x)


def _read_model(entry: Entry) -> tuple[Any, float]:
    """Return the file's model, and the metres per unit: as the file states it, else as the entry does."""
    path: Path = file_of(entry)
    try:
        import rhino3dm
    except ImportError as error:
        raise UnreadError("3DM files need rhino3dm: pip install 'tandem-planner[cad]'") from error
    path.stat()
    model = rhino3dm.File3dm.Read(str(path))
    if model is None:
        raise UnreadError("it is not a readable 3DM file")
    name = str(model.Settings.ModelUnitSystem).split(".")[-1]
    if name in _UNIT_NAMES:
        return model, _UNIT_NAMES[name]
    if entry.get("unit") is None:
        raise UnreadError(f"its unit is unknown ({name})")
    return model, UNITS[str(entry["unit"])]


def _selected_geometry(model: Any, entry: Entry) -> Iterator[Any]:
    """Yield visible objects outside of blocks that have the requested layer, name and colour."""
    by_index = {layer.Index: layer for layer in model.Layers}
    hidden = [layer.FullPath for layer in by_index.values() if not layer.Visible]
    for item in model.Objects:
        attributes = item.Attributes
        layer = by_index[attributes.LayerIndex]
        path = str(layer.FullPath)
        if attributes.IsInstanceDefinitionObject or not attributes.Visible:
            continue
        if any(path == hidden_layer or path.startswith(f"{hidden_layer}::") for hidden_layer in hidden):
            continue
        if entry.get("layer") and str(entry["layer"]).lower() not in (
            path.lower(),
            path.lower().split("::")[-1],
        ):
            continue
        if entry.get("name") and attributes.Name.lower() != str(entry["name"]).lower():
            continue
        if entry.get("colour") and tuple(bytes.fromhex(str(entry["colour"])[1:])) != tuple(
            attributes.DrawColor(model)[:3]
        ):
            continue
        yield item.Geometry


def _kind(geometry: Any) -> str:
    """Return the kind of an object without its prefix, such as ``Curve`` or ``Brep``."""
    return str(geometry.ObjectType).split(".")[-1]


def _full_knots(knots: Any) -> FloatArray:
    """Return all knots. Rhino omits the first and the last one."""
    return np.array([knots[0], *knots, knots[-1]], dtype=np.float64)


def _homogeneous(point: Any) -> tuple[float, float, float, float]:
    """Return a control point of Rhino as weighted coordinates and weight."""
    return point.X, point.Y, point.Z, point.W


def _homogeneous_points(points: Any) -> FloatArray:
    """Return the control points of a curve as homogeneous points (N, 4)."""
    return np.array([_homogeneous(point) for point in points], dtype=np.float64)


def _from_homogeneous(homogeneous: FloatArray) -> FloatArray:
    """Return points (N, 3) of homogeneous points (N, 4)."""
    return np.asarray(homogeneous[:, :3] / homogeneous[:, 3:])
