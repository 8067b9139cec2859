"""Objects of Rhino files (3DM), selected by layer, name and colour: curves, ruled faces, free faces, meshes.

Read by ``rhino3dm`` of the extra ``cad``, which only parses; :mod:`planner.geometry.nurbs` evaluates NURBS.
Lengths are in the unit of the file.
"""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, RuledSurface
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.geometry.nurbs import NurbsCurve, NurbsSurface, bounding_rectangle
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, Severity
from planner.reading.cad_faces import CadFace, FaceErrors, RulingOptions, ruled_between_sides, tessellate_face
from planner.reading.drawing import (
    CAD_INSTALL,
    CURVE_CHORD_TOLERANCE_M,
    MAX_BYTES,
    MAX_CURVES,
    MAX_EXTENT_M,
    FileCurve,
    file_error,
    join_curves,
)
from planner.reading.strict_yaml import FileName, Strict, Unit

Kind = Literal["curve", "face", "mesh"]
UNITS: Final = {
    "Microns": 1e-6,
    "Millimeters": 1e-3,
    "Centimeters": 1e-2,
    "Decimeters": 1e-1,
    "Meters": 1.0,
    "Kilometers": 1e3,
    "Mils": 2.54e-5,
    "Inches": 0.0254,
    "Feet": 0.3048,
    "Yards": 0.9144,
}
"""Rhino's names of units, in metres. Files in others are refused."""
UNITLESS: Final = ("None", "Unset", "CustomUnits")
"""Unit names of files without a unit, for which the problem may state one."""
UNIT_TOLERANCE: Final = 1e-9
"""Relative difference up to which two units are equal."""
EDGE_SAMPLES: Final = 9
"""Number of points on each span of an edge at which the trimming of a face is tested."""
EDGE_TOLERANCE_M: Final = 1e-5
"""Maximum distance [m] of edges from their face."""
LINE_TOLERANCE_FRACTION: Final = 1e-4
"""Maximum deviation of an edge from a parameter line of its surface, as a fraction of the parameter range."""
MAX_LISTED_LAYERS: Final = 12
"""Maximum number of layers that a message names."""


class RhinoFile(Strict):
    """Objects of a Rhino file (3DM): visible ones that match the given ``layer``, ``name`` and ``colour``.

    Needs the extra ``cad`` of Tandem.

    Lengths are in the unit of the file; ``unit`` is for files that have none.
    """

    file: FileName
    layer: (
        Annotated[
            str, Field(min_length=1, max_length=255, description="its name, or its path as in roof::rails")
        ]
        | None
    ) = None
    name: Annotated[str, Field(min_length=1, max_length=255, description="of the object")] | None = None
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$", description="as shown, '#rrggbb'")] | None = (
        None
    )
    unit: Unit | None = None

    def selection_text(self) -> str:
        """Return the selection in words, for messages."""
        keys = [f"{key} {value}" for key in ("layer", "name", "colour") if (value := getattr(self, key))]
        return f" of {', '.join(keys)}" if keys else ""


class RhinoRuledFile(RhinoFile):
    """A ruled face of a Rhino file: one face, whole or trimmed along its parameter lines.

    Its normal points away from the part. ``rulings`` is u or v, for a face that is straight both ways.
    """

    rulings: Literal["u", "v"] | None = None


class RhinoFaceFile(RhinoFile):
    """A face or a mesh of a Rhino file: one object.

    A face is whole or trimmed along its parameter lines; ``chord_mm`` is the maximum distance of its facets.
    Its normal points away from the part.
    """

    chord_mm: float = Field(default=0.005, ge=0.0005, le=1)
    flip: bool = Field(default=False, description="reverse the normal; it must point away from the part")


@dataclasses.dataclass(frozen=True)
class _RhinoSelection:
    """Selected objects of a file.

    Attributes:
        path: File.
        objects: Curves and meshes, and faces, each as a pair with its solid.
        metres: Unit of the file [m].
        notes: Notes.
    """

    path: Path
    objects: tuple[Any, ...]
    metres: float
    notes: tuple[Issue, ...]


def read_curves(spec: RhinoFile, folder: Path, field: str) -> tuple[list[FileCurve], list[Issue]]:
    """Return curves in SI units, joined where their ends meet; and notes on unit and left-out objects.

    Raises:
        TandemError: ``problem.missing_file``, ``problem.too_large``, ``part.extra_missing``, ``part.rhino``.
    """
    selection = _select(spec, folder, field, ("curve",))
    if len(selection.objects) > MAX_CURVES:
        text = (
            f"has {len(selection.objects)} curves{spec.selection_text()}, allowed {MAX_CURVES}; name a "
            "layer, or join them (_Join)"
        )
        raise file_error("part.rhino", selection.path, field, text)
    nurbs = [_to_nurbs(item, selection, field) for item in selection.objects]
    points = np.concatenate([item.control[:, :3] / item.control[:, 3:] for item in nurbs])
    extent = float(np.ptp(points, axis=0).max())
    if extent > MAX_EXTENT_M:  # it would have too many points
        text = f"is {extent:.4g} m across, allowed {MAX_EXTENT_M:g} m; check the unit, or remove stray curves"
        raise file_error("part.rhino", selection.path, field, text)
    pieces = [item.chords(CURVE_CHORD_TOLERANCE_M) for item in nurbs]
    return join_curves([piece for piece in pieces if len(piece) > 1]), list(selection.notes)


def read_ruled(
    name: str, spec: RhinoFile, options: RulingOptions, folder: Path, field: str
) -> tuple[RuledSurface, list[Issue]]:
    """Return a ruled face between two of its sides, with the rulings of the file; and notes.

    Args:
        name: Name of the face.
        spec: File, and selection of the face.
        options: How the face is ruled.
        folder: Folder to which the file name is relative.
        field: Field of the problem, for issues.

    Raises:
        TandemError: As :func:`read_curves`, and ``part.not_ruled``.
    """
    selection = _select(spec, folder, field, ("face",))
    surface, reverse = _selected_face(selection, spec, field)
    surface_ruled = ruled_between_sides(name, surface, reverse, options, _face_errors(selection, spec, field))
    return surface_ruled, list(selection.notes)


def _face_errors(selection: _RhinoSelection, spec: RhinoFile, field: str) -> FaceErrors:
    return FaceErrors(
        "part.rhino", "part.rhino_facets", selection.path, field, f"the face{spec.selection_text()}"
    )


def read_face(spec: RhinoFaceFile, folder: Path, field: str) -> CadFace:
    """Return a face or a mesh in SI units. The deviation of facets from the face is among its notes.

    Raises:
        TandemError: As :func:`read_curves`.
    """
    selection = _select(spec, folder, field, ("face", "mesh"))
    if len(selection.objects) == 1 and not isinstance(selection.objects[0], tuple):
        mesh = _read_mesh(selection.objects[0], selection.metres)
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]) if spec.flip else mesh
        return CadFace(mesh, vertex_normals(mesh), None, spec.flip, selection.notes)
    surface, reverse = _selected_face(selection, spec, field)
    errors = _face_errors(selection, spec, field)
    return tessellate_face(surface, reverse != spec.flip, spec.chord_mm, errors, selection.notes)


def _select(spec: RhinoFile, folder: Path, field: str, kinds: Sequence[Kind]) -> _RhinoSelection:
    """Return the visible objects of a file of some kinds that match the selection, at least one."""
    path = folder / spec.file
    if not is_file(path):
        raise file_error("problem.missing_file", path, field, f"{missing_file_reason(path)}; check the path")
    if path.stat().st_size > MAX_BYTES:
        raise file_error("problem.too_large", path, field, "more than 50 MB; export only what is needed")
    try:
        import rhino3dm
    except ImportError as error:
        raise file_error(
            "part.extra_missing", path, field, f"3DM files need rhino3dm; {CAD_INSTALL}"
        ) from error
    model = rhino3dm.File3dm.Read(str(path))
    if model is None:
        text = "cannot be read: it is not a complete 3DM file, or of a newer Rhino; save it for Rhino 8"
        raise file_error("part.rhino", path, field, text)
    metres, notes = _file_unit(model, spec, path, field)
    layers = {layer.Index: layer for layer in model.Layers}
    if spec.layer is not None and not any(_is_layer(layer, spec.layer) for layer in layers.values()):
        names = sorted({layer.FullPath for layer in layers.values()})
        more_text = f" and {len(names) - MAX_LISTED_LAYERS} more" if len(names) > MAX_LISTED_LAYERS else ""
        text = f"has no layer {spec.layer}; its layers are {', '.join(names[:MAX_LISTED_LAYERS])}{more_text}"
        raise file_error("part.rhino", path, field, text)
    geometries = []
    hidden_count = 0
    for item in model.Objects:
        if item.Attributes.IsInstanceDefinitionObject or not _is_selected(item, spec, layers, model):
            continue
        if _is_hidden(item, layers):
            hidden_count += 1
        else:
            geometries.append(item.Geometry)
    parts = [part for item in geometries if _kind(item) in kinds for part in _parts(item)]
    other_kinds = Counter(
        str(item.ObjectType).rpartition(".")[2] for item in geometries if _kind(item) not in kinds
    )
    left_out = [f"{count} {kind}" for kind, count in sorted(other_kinds.items())]
    left_out += [f"{hidden_count} hidden"] if hidden_count else []
    if not parts:
        text = f"has no {' and no '.join(kinds)}{spec.selection_text()}"
        text += f", but {', '.join(left_out)}; " if left_out else "; "
        raise file_error("part.rhino", path, field, text + _left_out_hint(other_kinds, hidden_count))
    if left_out:
        text = (
            f"{path.name}: left out {', '.join(left_out)}{spec.selection_text()}; "
            f"{_left_out_hint(other_kinds, hidden_count)}"
        )
        notes.append(Issue("part.rhino_left_out", text, Severity.NOTE, file=str(path), field=field))
    return _RhinoSelection(path, tuple(parts), metres, tuple(notes))


_CONVERSION_HINTS: Final = {
    "InstanceReference": "explode blocks (_ExplodeBlock)",
    "SubD": "convert SubD to NURBS (_ToNURBS) or to a mesh (_Mesh)",
}
"""Remedies in Rhino for objects of these kinds."""


def _left_out_hint(other_kinds: Mapping[str, int], hidden_count: int) -> str:
    """Return remedies for left-out objects, all remedies if none is known for their kinds."""
    hints = [hint for kind, hint in _CONVERSION_HINTS.items() if kind in other_kinds]
    hints += ["show hidden objects (_Show, layers)"] if hidden_count else []
    return ", ".join(hints or [*_CONVERSION_HINTS.values(), "show hidden objects (_Show, layers)"])


def _file_unit(model: Any, spec: RhinoFile, path: Path, field: str) -> tuple[float, list[Issue]]:
    """Return the length unit of the file [m], and a note that states it."""
    unit_name = str(model.Settings.ModelUnitSystem).rpartition(".")[2]
    file_metres = UNITS.get(unit_name)
    stated = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    if file_metres is None and unit_name not in UNITLESS:
        text = f"is in {unit_name.lower()}, which is not supported; change it in Rhino (_Units)"
        raise file_error("part.rhino", path, field, text)
    if file_metres is None and stated is None:
        text = f"states no known unit ({unit_name}); state it (unit: mm), or set it in Rhino (_Units)"
        raise file_error("part.rhino", path, field, text)
    if (
        file_metres is not None
        and stated is not None
        and abs(file_metres - stated) > UNIT_TOLERANCE * file_metres
    ):
        text = f"is in {unit_name.lower()}, but the problem states {spec.unit}; remove unit, or change it in "
        text += "Rhino (_Units)"
        raise file_error("part.rhino", path, field, text)
    text = f"{path.name} is in {unit_name.lower() if file_metres is not None else spec.unit}"
    note = Issue("part.rhino_unit", text, Severity.NOTE, file=str(path), field=field)
    return float(file_metres or stated or 0.0), [note]


def _is_layer(layer: Any, name: str) -> bool:
    return name.lower() in (layer.Name.lower(), layer.FullPath.lower())


def _is_selected(item: Any, spec: RhinoFile, layers: dict[int, Any], model: Any) -> bool:
    """Return whether an object has the layer, name and colour of the selection, as far as it states them."""
    attributes = item.Attributes
    layer = layers.get(attributes.LayerIndex)
    if spec.layer is not None and (layer is None or not _is_layer(layer, spec.layer)):
        return False
    if spec.name is not None and attributes.Name.lower() != spec.name.lower():
        return False
    if spec.colour is None:
        return True
    colour = "#" + "".join(f"{value:02x}" for value in attributes.DrawColor(model)[:3])
    return colour == spec.colour.lower()


def _is_hidden(item: Any, layers: dict[int, Any]) -> bool:
    """Return whether an object, its layer or a layer above that one is not visible."""
    if not item.Attributes.Visible:
        return True
    layer = layers.get(item.Attributes.LayerIndex)
    if layer is None:
        return False
    parents = [other for other in layers.values() if layer.FullPath.startswith(other.FullPath + "::")]
    return any(not other.Visible for other in (layer, *parents))


def _kind(geometry: Any) -> Kind | None:
    """Return the kind of a geometry, None if it is not one that can be read."""
    kind = str(geometry.ObjectType).rpartition(".")[2]
    other_kinds: dict[str, Kind] = {"Curve": "curve", "Mesh": "mesh"}
    return "face" if kind in ("Brep", "Extrusion", "Surface") else other_kinds.get(kind)


def _parts(geometry: Any) -> list[Any]:
    """Return the faces of a solid or surface, each with its solid; anything else unchanged."""
    if _kind(geometry) != "face":
        return [geometry]
    kind = str(geometry.ObjectType).rpartition(".")[2]
    brep = geometry.ToBrep(True) if kind == "Extrusion" else geometry
    return [(face, brep) for face in brep.Faces]


def _to_nurbs(geometry: Any, selection: _RhinoSelection, field: str) -> NurbsCurve:
    """Return a curve or an edge as a NURBS curve in metres. Raises ``part.rhino`` if it has no valid form."""
    nurbs = geometry.ToNurbsCurve()
    if nurbs is None:
        raise file_error(
            "part.rhino", selection.path, field, "a curve has no NURBS form; rebuild it (_Rebuild)"
        )
    control = np.array([(p.X, p.Y, p.Z, p.W) for p in nurbs.Points], dtype=np.float64)
    if nurbs.Dimension == 2:
        control[:, 2] = 0.0
    return NurbsCurve(
        nurbs.Degree, _knots(list(nurbs.Knots)), _require_finite(_scale(control, selection), selection, field)
    )


def _knots(knots: Sequence[float]) -> FloatArray:
    """Return a complete knot vector; Rhino omits the first and the last knot, which have no effect."""
    return np.array([knots[0], *knots, knots[-1]], dtype=np.float64)


def _scale(control: FloatArray, selection: _RhinoSelection) -> FloatArray:
    """Return homogeneous control points (..., 4) in metres. Weights are not scaled."""
    return np.asarray(control * np.array([selection.metres] * 3 + [1.0]))


def _require_finite(control: FloatArray, selection: _RhinoSelection, field: str) -> FloatArray:
    """Return the control points (..., 4) if they are finite with positive weights, else raise."""
    if not np.isfinite(control).all() or (control[..., 3] <= 0.0).any():
        message = "has numbers that are not finite, or weights that are not positive; rebuild it (_Rebuild)"
        raise file_error("part.rhino", selection.path, field, message)
    return control


def _selected_face(selection: _RhinoSelection, spec: RhinoFile, field: str) -> tuple[NurbsSurface, bool]:
    """Return the one selected face, trimmed to its region, and whether its normal is reversed."""
    if len(selection.objects) != 1:
        message = (
            f"has {len(selection.objects)} faces and meshes{spec.selection_text()}, expected 1; explode "
        )
        message += "solids (_Explode) and give the face its own layer or name"
        raise file_error("part.rhino", selection.path, field, message)
    face, brep = selection.objects[0]
    nurbs = face.UnderlyingSurface()
    nurbs = None if nurbs is None else nurbs.ToNurbsSurface()
    if nurbs is None:
        raise file_error(
            "part.rhino", selection.path, field, "the face has no NURBS form; rebuild it (_Rebuild)"
        )
    points = [
        [nurbs.Points.GetControlPoint(i, j) for j in range(nurbs.Points.CountV)]
        for i in range(nurbs.Points.CountU)
    ]
    control = np.array([[(p.X, p.Y, p.Z, p.W) for p in row] for row in points], dtype=np.float64)
    knots = _knots(nurbs.KnotsU.ToList()), _knots(nurbs.KnotsV.ToList())
    degree = nurbs.OrderU - 1, nurbs.OrderV - 1
    control = _require_finite(_scale(control, selection), selection, field)
    surface = NurbsSurface(degree, knots, control, ((0.0, 0.0), (0.0, 0.0)))
    surface = dataclasses.replace(surface, region=surface.whole())
    if len(face.Loops) != 1:
        message = (
            f"the face{spec.selection_text()} has holes; untrim it (_Untrim), or cut it so that it has none"
        )
        raise file_error("part.rhino", selection.path, field, message)
    return _face_region(surface, face, brep, selection, spec, field), bool(face.OrientationIsReversed)


def _face_region(
    surface: NurbsSurface, face: Any, brep: Any, selection: _RhinoSelection, spec: RhinoFile, field: str
) -> NurbsSurface:
    """Return the region of a surface that the edges of the face enclose."""
    whole = np.array(surface.whole())
    ranges = whole[:, 1] - whole[:, 0]
    edge_parameters, seams = [], []
    indices = [
        trim.EdgeIndex for trim in face.Loops[0].Trims if trim.EdgeIndex >= 0
    ]  # negative at a pole, which has no edge
    for index in indices:
        edge = _to_nurbs(brep.Edges[index], selection, field)
        parameters, distance = surface.nearest_parameters(edge.points(_sample_spans(edge.spans())))
        if distance.max() > EDGE_TOLERANCE_M:
            text = (
                f"an edge of the face{spec.selection_text()} is {distance.max() / MM:.3g} mm off it; rebuild "
                "it (_Rebuild)"
            )
            raise file_error("part.rhino", selection.path, field, text)
        edge_parameters += list(parameters.reshape(-1, EDGE_SAMPLES, 2))
        seams += [indices.count(index) > 1] * (len(parameters) // EDGE_SAMPLES)
    for k in (0, 1):
        if surface.is_closed(k):
            edge_parameters = _unroll_parameters(
                edge_parameters, seams, k, whole[k], LINE_TOLERANCE_FRACTION * ranges[k]
            )
    box = bounding_rectangle(edge_parameters, LINE_TOLERANCE_FRACTION * ranges) if edge_parameters else None
    if box is None:
        text = (
            f"the face{spec.selection_text()} is not trimmed along its parameter lines; untrim it (_Untrim), "
        )
        text += "or create it again from its edges (_EdgeSrf, _Loft)"
        raise file_error("part.rhino", selection.path, field, text)
    low, high = box
    low = np.where(low - whole[:, 0] <= LINE_TOLERANCE_FRACTION * ranges, whole[:, 0], low)
    high = np.where(whole[:, 1] - high <= LINE_TOLERANCE_FRACTION * ranges, whole[:, 1], high)
    region = (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))
    return dataclasses.replace(surface, region=region)


def _unroll_parameters(
    edges: Sequence[FloatArray], are_seams: Sequence[bool], k: int, ends: FloatArray, tolerance: float
) -> list[FloatArray]:
    """Return parameters (N, 2) of edges on a surface that is closed in parameter ``k``.

    The lines at ``ends[0]`` and ``ends[1]`` coincide. If the face has seams, which are edges that occur
    twice, one occurrence is put at each end. Otherwise edges on that line are put at the end near the face.
    """
    out = [edge.copy() for edge in edges]
    values = np.concatenate([edge[:, k] for edge in out])
    inner = values[(values > ends[0] + tolerance) & (values < ends[1] - tolerance)]
    if not len(inner):
        return out
    near_end = ends[0] if inner.min() - ends[0] <= ends[1] - inner.max() else ends[1]
    for number, (edge, is_seam) in enumerate(zip(out, are_seams, strict=True)):
        on_seam = (edge[:, k] <= ends[0] + tolerance) | (edge[:, k] >= ends[1] - tolerance)
        if on_seam.all() and is_seam:
            edge[:, k] = ends[sum(are_seams[:number]) % 2]
        elif not any(are_seams):
            edge[on_seam, k] = near_end
    return out


def _sample_spans(spans: FloatArray) -> FloatArray:
    """Return `EDGE_SAMPLES` parameters in each of the spans (S + 1,), ends included."""
    fractions = np.linspace(0.0, 1.0, EDGE_SAMPLES)
    return np.asarray((spans[:-1, None] + np.diff(spans)[:, None] * fractions).ravel())


def _read_mesh(geometry: Any, metres: float) -> TriangleMesh:
    """Return a mesh with coincident vertices merged and quads split into two triangles."""
    points = geometry.Vertices.ToPoint3dArray()  # in double precision if the file has it
    vertices = np.array([(p.X, p.Y, p.Z) for p in points], dtype=np.float64) * metres
    faces = np.array([geometry.Faces[k] for k in range(len(geometry.Faces))], dtype=np.int64).reshape(-1, 4)
    split = np.concatenate([faces[:, :3], faces[:, [0, 2, 3]][faces[:, 2] != faces[:, 3]]])
    unique_vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    return TriangleMesh(unique_vertices, index.reshape(-1)[split])
