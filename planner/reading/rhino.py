"""What is taken of Rhino's files (3DM), by layer, name and colour: curves, ruled faces, free faces, meshes.

Read by ``rhino3dm`` of the extra ``cad``, which only parses; what NURBS are, :mod:`planner.geometry.nurbs`
works out. Lengths are in the file's own unit.
"""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, Ruled
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.geometry.nurbs import NurbsCurve, NurbsSurface, rectangle
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, Severity
from planner.reading.cad_faces import CadFace, Refusals, Way, between_sides, faceted
from planner.reading.drawing import (
    CAD_INSTALL,
    FLATNESS,
    LARGEST,
    MOST_BYTES,
    MOST_CURVES,
    FileCurve,
    joined,
    refused,
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
"""Rhino's names of units, in metres; files in others are refused."""
UNSAID: Final = ("None", "Unset", "CustomUnits")
"""Units of files that say none, whose unit the problem may state."""
SAME_UNIT: Final = 1e-9
"""Share by which units may differ that are one."""
EDGE_PLACES: Final = 9
"""Places of each span of an edge at which it is looked at where a face is trimmed."""
ON_FACE: Final = 1e-5
"""Edges of a face are off it by this at most [m]."""
ON_LINE_SHARE: Final = 1e-4
"""Share of a surface's parameters by which an edge along one of its lines may be off that line."""
LAYERS_TOLD: Final = 12
"""Layers that a message names at most."""


class RhinoFile(Strict):
    """Objects of a Rhino file (3DM): those that are visible and have all of what is given of ``layer``,
    ``name`` and ``colour``. Needs the extra ``cad`` of Tandem.

    Lengths are in the file's unit; ``unit`` is for files that have none.
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

    def asked(self) -> str:
        """What is asked for, in words."""
        keys = [f"{key} {value}" for key in ("layer", "name", "colour") if (value := getattr(self, key))]
        return f" of {', '.join(keys)}" if keys else ""


class RhinoRuledFile(RhinoFile):
    """A ruled face of a Rhino file: one face, whole or cut along its own lines; its normal points away from
    the part. ``rulings``: along u or v, where it is straight both ways.
    """

    rulings: Literal["u", "v"] | None = None


class RhinoFaceFile(RhinoFile):
    """A face or a mesh of a Rhino file: one object. A face is whole or cut along its own lines; ``chord_mm``:
    how far its facets may be off it. Its normal points away from the part.
    """

    chord_mm: float = Field(default=0.005, ge=0.0005, le=1)
    flip: bool = Field(default=False, description="turn the side that faces away from the part")


@dataclasses.dataclass(frozen=True)
class _Found:
    """Curves and meshes of a file, and faces, each with its solid; the metres of its unit; notes."""

    path: Path
    objects: tuple[Any, ...]
    metres: float
    notes: tuple[Issue, ...]


def curves(spec: RhinoFile, folder: Path, field: str) -> tuple[list[FileCurve], list[Issue]]:
    """Curves in SI units, those whose ends meet joined; and notes of the unit and of what was left out.

    Raises ``TandemError``: ``problem.missing_file``, ``problem.too_large``, ``part.extra_missing``,
    ``part.rhino``.
    """
    found = _read(spec, folder, field, ("curve",))
    if len(found.objects) > MOST_CURVES:
        what = (
            f"has {len(found.objects)} curves{spec.asked()}, {MOST_CURVES} are read; name a layer, or join "
        )
        raise refused("part.rhino", found.path, field, what + "them (_Join)")
    own = [_curve(one, found, field) for one in found.objects]
    points = np.concatenate([one.control[:, :3] / one.control[:, 3:] for one in own])
    across = float(np.ptp(points, axis=0).max())
    if across > LARGEST:  # their points would be too many
        what = f"is {across:.4g} m across, up to {LARGEST:g} m are read; see the unit, or clear stray curves"
        raise refused("part.rhino", found.path, field, what)
    pieces = [one.chords(FLATNESS) for one in own]
    return joined([piece for piece in pieces if len(piece) > 1]), list(found.notes)


def ruled(
    name: str, spec: RhinoRuledFile, closed: bool, flip: bool, hole: bool, folder: Path, field: str
) -> tuple[Ruled, list[Issue]]:
    """A ruled face between its own sides, its rulings as they are in the file; and notes.

    Raises ``TandemError``: as :func:`curves`, and ``part.not_ruled``.
    """
    found = _read(spec, folder, field, ("face",))
    surface, reverse = _face(found, spec, field)
    way = Way(spec.rulings, closed, flip, hole)
    made = between_sides(name, surface, reverse, way, _refusals(found, spec, field))
    return made, list(found.notes)


def _refusals(found: _Found, spec: RhinoFile, field: str) -> Refusals:
    return Refusals("part.rhino", "part.rhino_facets", found.path, field, f"the face{spec.asked()}")


def face(spec: RhinoFaceFile, folder: Path, field: str) -> CadFace:
    """A face or a mesh in SI units; how far facets are off the face is among its notes.

    Raises ``TandemError``: as :func:`curves`.
    """
    found = _read(spec, folder, field, ("face", "mesh"))
    if len(found.objects) == 1 and not isinstance(found.objects[0], tuple):
        mesh = _mesh(found.objects[0], found.metres)
        mesh = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]) if spec.flip else mesh
        return CadFace(mesh, vertex_normals(mesh), None, spec.flip, found.notes)
    surface, reverse = _face(found, spec, field)
    of = _refusals(found, spec, field)
    return faceted(surface, reverse != spec.flip, spec.chord_mm, of, found.notes)


def _read(spec: RhinoFile, folder: Path, field: str, kinds: Sequence[Kind]) -> _Found:
    path = folder / spec.file
    if not is_file(path):
        raise refused("problem.missing_file", path, field, f"{no_file(path)}; check the path")
    if path.stat().st_size > MOST_BYTES:
        raise refused("problem.too_large", path, field, "more than 50 MB; export only what is needed")
    try:
        import rhino3dm
    except ImportError as error:
        raise refused("part.extra_missing", path, field, f"3DM files need rhino3dm; {CAD_INSTALL}") from error
    model = rhino3dm.File3dm.Read(str(path))
    if model is None:
        what = "cannot be read: it is no whole 3DM file, or of a newer Rhino; save it for Rhino 8 or older"
        raise refused("part.rhino", path, field, what)
    metres, notes = _unit(model, spec, path, field)
    layers = {layer.Index: layer for layer in model.Layers}
    if spec.layer is not None and not any(_is_layer(layer, spec.layer) for layer in layers.values()):
        names = sorted({layer.FullPath for layer in layers.values()})
        more = f" and {len(names) - LAYERS_TOLD} more" if len(names) > LAYERS_TOLD else ""
        what = f"has no layer {spec.layer}; its layers are {', '.join(names[:LAYERS_TOLD])}{more}"
        raise refused("part.rhino", path, field, what)
    wanted, hidden = [], 0
    for one in model.Objects:
        if one.Attributes.IsInstanceDefinitionObject or not _is_asked(one, spec, layers, model):
            continue
        if _is_hidden(one, layers):
            hidden += 1
        else:
            wanted.append(one.Geometry)
    mine = [part for one in wanted if _kind(one) in kinds for part in _parts(one)]
    others = Counter(str(one.ObjectType).rpartition(".")[2] for one in wanted if _kind(one) not in kinds)
    left = [f"{count} {kind}" for kind, count in sorted(others.items())]
    left += [f"{hidden} hidden"] if hidden else []
    if not mine:
        what = f"has no {' and no '.join(kinds)}{spec.asked()}"
        what += f", but {', '.join(left)}; " if left else "; "
        raise refused("part.rhino", path, field, what + _hint(others, hidden))
    if left:
        what = f"{path.name}: left out {', '.join(left)}{spec.asked()}; {_hint(others, hidden)}"
        notes.append(Issue("part.rhino_left_out", what, Severity.NOTE, file=str(path), field=field))
    return _Found(path, tuple(mine), metres, tuple(notes))


_TURNED: Final = {
    "InstanceReference": "explode blocks (_ExplodeBlock)",
    "SubD": "turn SubD into NURBS (_ToNURBS) or into a mesh (_Mesh)",
}
"""What to do in Rhino with objects of these kinds."""


def _hint(others: Mapping[str, int], hidden: int) -> str:
    """What to do with objects that are left out, of these kinds and hidden; of all where it is none of
    them."""
    known = [what for kind, what in _TURNED.items() if kind in others]
    known += ["show what is hidden (_Show, layers)"] if hidden else []
    return ", ".join(known or [*_TURNED.values(), "show what is hidden (_Show, layers)"])


def _unit(model: Any, spec: RhinoFile, path: Path, field: str) -> tuple[float, list[Issue]]:
    """Metres of a length of the file, and a note that tells the unit."""
    said = str(model.Settings.ModelUnitSystem).rpartition(".")[2]
    own = UNITS.get(said)
    stated = None if spec.unit is None else LENGTH_UNITS[spec.unit]
    if own is None and said not in UNSAID:
        what = f"is in {said.lower()}, which is no unit that is read; change it in Rhino (_Units)"
        raise refused("part.rhino", path, field, what)
    if own is None and stated is None:
        what = f"says no unit that is known ({said}); state it (unit: mm), or set it in Rhino (_Units)"
        raise refused("part.rhino", path, field, what)
    if own is not None and stated is not None and abs(own - stated) > SAME_UNIT * own:
        what = f"is in {said.lower()}, the problem says {spec.unit}; take unit out, or change it in Rhino "
        what += "(_Units)"
        raise refused("part.rhino", path, field, what)
    what = f"{path.name} is in {said.lower() if own is not None else spec.unit}"
    note = Issue("part.rhino_unit", what, Severity.NOTE, file=str(path), field=field)
    return float(own or stated or 0.0), [note]


def _is_layer(layer: Any, asked: str) -> bool:
    return asked.lower() in (layer.Name.lower(), layer.FullPath.lower())


def _is_asked(one: Any, spec: RhinoFile, layers: dict[int, Any], model: Any) -> bool:
    own = one.Attributes
    layer = layers.get(own.LayerIndex)
    if spec.layer is not None and (layer is None or not _is_layer(layer, spec.layer)):
        return False
    if spec.name is not None and own.Name.lower() != spec.name.lower():
        return False
    if spec.colour is None:
        return True
    shown = "#" + "".join(f"{value:02x}" for value in own.DrawColor(model)[:3])
    return shown == spec.colour.lower()


def _is_hidden(one: Any, layers: dict[int, Any]) -> bool:
    if not one.Attributes.Visible:
        return True
    layer = layers.get(one.Attributes.LayerIndex)
    if layer is None:
        return False
    around = [other for other in layers.values() if layer.FullPath.startswith(other.FullPath + "::")]
    return any(not other.Visible for other in (layer, *around))


def _kind(geometry: Any) -> Kind | None:
    kind = str(geometry.ObjectType).rpartition(".")[2]
    known: dict[str, Kind] = {"Curve": "curve", "Mesh": "mesh"}
    return "face" if kind in ("Brep", "Extrusion", "Surface") else known.get(kind)


def _parts(geometry: Any) -> list[Any]:
    """The faces of a solid or surface, each with its solid; anything else as it is."""
    if _kind(geometry) != "face":
        return [geometry]
    kind = str(geometry.ObjectType).rpartition(".")[2]
    brep = geometry.ToBrep(True) if kind == "Extrusion" else geometry
    return [(one, brep) for one in brep.Faces]


def _curve(geometry: Any, found: _Found, field: str) -> NurbsCurve:
    own = geometry.ToNurbsCurve()
    if own is None:
        raise refused("part.rhino", found.path, field, "a curve has no NURBS form; rebuild it (_Rebuild)")
    control = np.array([(p.X, p.Y, p.Z, p.W) for p in own.Points], dtype=np.float64)
    if own.Dimension == 2:
        control[:, 2] = 0.0
    return NurbsCurve(own.Degree, _knots(list(own.Knots)), _finite(_scaled(control, found), found, field))


def _knots(own: Sequence[float]) -> FloatArray:
    """Rhino leaves out the first and the last knot, which nothing depends on."""
    return np.array([own[0], *own, own[-1]], dtype=np.float64)


def _scaled(control: FloatArray, found: _Found) -> FloatArray:
    return np.asarray(control * np.array([found.metres] * 3 + [1.0]))


def _finite(control: FloatArray, found: _Found, field: str) -> FloatArray:
    if not np.isfinite(control).all() or (control[..., 3] <= 0.0).any():
        what = "has numbers that are not finite, or weights that are not above 0; rebuild it (_Rebuild)"
        raise refused("part.rhino", found.path, field, what)
    return control


def _face(found: _Found, spec: RhinoFile, field: str) -> tuple[NurbsSurface, bool]:
    """The one face that is asked for, as far as it is not cut off; whether its normal is turned."""
    if len(found.objects) != 1:
        what = f"has {len(found.objects)} faces and meshes{spec.asked()}, 1 is wanted; explode solids "
        what += "(_Explode) and give the face a layer or a name of its own"
        raise refused("part.rhino", found.path, field, what)
    one, brep = found.objects[0]
    own = one.UnderlyingSurface()
    own = None if own is None else own.ToNurbsSurface()
    if own is None:
        raise refused("part.rhino", found.path, field, "the face has no NURBS form; rebuild it (_Rebuild)")
    rows = [
        [own.Points.GetControlPoint(i, j) for j in range(own.Points.CountV)] for i in range(own.Points.CountU)
    ]
    control = np.array([[(p.X, p.Y, p.Z, p.W) for p in row] for row in rows], dtype=np.float64)
    knots = _knots(own.KnotsU.ToList()), _knots(own.KnotsV.ToList())
    degree = own.OrderU - 1, own.OrderV - 1
    control = _finite(_scaled(control, found), found, field)
    surface = NurbsSurface(degree, knots, control, ((0.0, 0.0), (0.0, 0.0)))
    surface = dataclasses.replace(surface, region=surface.whole())
    if len(one.Loops) != 1:
        what = f"the face{spec.asked()} has holes; untrim it (_Untrim), or cut it so that it has none"
        raise refused("part.rhino", found.path, field, what)
    return _region(surface, one, brep, found, spec, field), bool(one.OrientationIsReversed)


def _region(
    surface: NurbsSurface, one: Any, brep: Any, found: _Found, spec: RhinoFile, field: str
) -> NurbsSurface:
    """The piece of a surface that the face's edges go around."""
    whole = np.array(surface.whole())
    size = whole[:, 1] - whole[:, 0]
    at, seams = [], []
    indices = [trim.EdgeIndex for trim in one.Loops[0].Trims if trim.EdgeIndex >= 0]  # below: at a pole
    for index in indices:
        edge = _curve(brep.Edges[index], found, field)
        where, off = surface.places(edge.points(_spread(edge.spans())))
        if off.max() > ON_FACE:
            what = (
                f"an edge of the face{spec.asked()} is {off.max() / MM:.3g} mm off it; rebuild it (_Rebuild)"
            )
            raise refused("part.rhino", found.path, field, what)
        at += list(where.reshape(-1, EDGE_PLACES, 2))
        seams += [indices.count(index) > 1] * (len(where) // EDGE_PLACES)
    for k in (0, 1):
        if surface.closed(k):
            at = _unrolled(at, seams, k, whole[k], ON_LINE_SHARE * size[k])
    box = rectangle(at, ON_LINE_SHARE * size) if at else None
    if box is None:
        what = f"the face{spec.asked()} is cut along other lines than its own; untrim it (_Untrim), or make "
        what += "it anew between its edges (_EdgeSrf, _Loft)"
        raise refused("part.rhino", found.path, field, what)
    low, high = box
    low = np.where(low - whole[:, 0] <= ON_LINE_SHARE * size, whole[:, 0], low)
    high = np.where(whole[:, 1] - high <= ON_LINE_SHARE * size, whole[:, 1], high)
    region = (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))
    return dataclasses.replace(surface, region=region)


def _unrolled(
    at: Sequence[FloatArray], seams: Sequence[bool], k: int, ends: FloatArray, near: float
) -> list[FloatArray]:
    """Places (N, 2) of edges on a surface whose parameter ``k`` goes all round, from ``ends[0]`` to
    ``ends[1]``, where both are one line: ``seams`` are on either, else on that next to the face."""
    out = [edge.copy() for edge in at]
    values = np.concatenate([edge[:, k] for edge in out])
    inner = values[(values > ends[0] + near) & (values < ends[1] - near)]
    if not len(inner):
        return out
    nearer = ends[0] if inner.min() - ends[0] <= ends[1] - inner.max() else ends[1]
    for number, (edge, seam) in enumerate(zip(out, seams, strict=True)):
        on_seam = (edge[:, k] <= ends[0] + near) | (edge[:, k] >= ends[1] - near)
        if on_seam.all() and seam:
            edge[:, k] = ends[sum(seams[:number]) % 2]
        elif not any(seams):
            edge[on_seam, k] = nearer
    return out


def _spread(spans: FloatArray) -> FloatArray:
    """`EDGE_PLACES` parameters in each of some spans (S + 1,), its ends included."""
    share = np.linspace(0.0, 1.0, EDGE_PLACES)
    return np.asarray((spans[:-1, None] + np.diff(spans)[:, None] * share).ravel())


def _mesh(geometry: Any, metres: float) -> TriangleMesh:
    """A mesh with its corners that are one place made one; quads as two triangles."""
    places = geometry.Vertices.ToPoint3dArray()  # in double precision where the file has it
    vertices = np.array([(p.X, p.Y, p.Z) for p in places], dtype=np.float64) * metres
    faces = np.array([geometry.Faces[k] for k in range(len(geometry.Faces))], dtype=np.int64).reshape(-1, 4)
    split = np.concatenate([faces[:, :3], faces[:, [0, 2, 3]][faces[:, 2] != faces[:, 3]]])
    unlike, index = np.unique(vertices, axis=0, return_inverse=True)
    return TriangleMesh(unlike, index.reshape(-1)[split])
