"""Meshes, lines and points as a 3DM file of Rhino, in layers, in mm; the same ones always as the same bytes.

rhino3dm writes the clock into each file, and makes up ids: here all are of one day, and ids follow from the
order of objects and the paths of layers.
"""

import base64
import dataclasses
import importlib.util
import struct
import uuid
import zlib
from collections.abc import Iterable, Mapping
from typing import Any, Final

from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.units import MM
from planner.issues import refusal

Rgb = tuple[float, float, float]
RHINO_VERSION: Final = 7
"""Files are for this Rhino and newer ones."""
WAY_COLOUR: Final = (0.10, 0.20, 0.60)
"""Colour of the ways of tools."""
IDS: Final = uuid.UUID("7f3d5f0e-5d0b-5a55-9d0c-6f1c2b7a4e18")
"""What ids of layers and objects are made of, beside their paths and numbers."""
_HEADER: Final = 32  # bytes before the first chunk of a file
_CHUNK: Final = struct.Struct("<Iq")  # its type, and length or, with the type's highest bit, value
_VALUE: Final = 0x80000000
_PROPERTIES: Final = 0x10000014
_HISTORY: Final = 0x20008021
_TIME: Final = struct.pack("<8i", 0, 0, 0, 1, 0, 100, 6, 0)  # 1 January 2000, as struct tm has it
_CRC: Final = struct.Struct("<I")


@dataclasses.dataclass(frozen=True)
class Shape:
    """A mesh in the world: ``vertices`` (V, 3) [m], ``faces`` (F, 3); its ``layer``, a path, and colour; its
    name and user text, if any."""

    layer: str
    vertices: FloatArray
    faces: IntArray
    color: Rgb
    name: str = ""
    text: Mapping[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Line:
    """A polyline (N, 3) [m] in the world on a ``layer``."""

    layer: str
    points: FloatArray
    color: Rgb


@dataclasses.dataclass(frozen=True)
class Target:
    """A TCP (3,) [m] in the world on a ``layer``, with its user text."""

    layer: str
    point: FloatArray
    text: Mapping[str, str]


def installed() -> bool:
    """Whether 3DM files can be written."""
    return importlib.util.find_spec("rhino3dm") is not None


def rhino(found: Iterable[Shape | Line | Target]) -> bytes:
    """Shapes, lines and targets as a 3DM file of Rhino 7, in layers. Raises ``TandemError``
    (``part.extra_missing``) without ``rhino3dm``."""
    try:
        import rhino3dm
    except ImportError as error:
        what = "3DM files need rhino3dm: pip install 'tandem-planner[cad]'"
        raise refusal("part.extra_missing", what, field="output") from error
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    layers: dict[str, int] = {}
    for number, one in enumerate(found):
        own = rhino3dm.ObjectAttributes()
        own.Id = uuid.uuid5(IDS, f"object {number}")
        color = WAY_COLOUR if isinstance(one, Target) else one.color
        own.LayerIndex = _layer(model, layers, one.layer, color)
        if isinstance(one, Shape):
            own.Name = one.name
            _say(own, one.text)
            model.Objects.AddMesh(_mesh(one), own)
        elif isinstance(one, Line):
            points = [rhino3dm.Point3d(*point) for point in (one.points / MM).tolist()]
            model.Objects.AddPolyline(rhino3dm.Polyline(points), own)
        else:
            own.Name = one.text["target"]
            _say(own, one.text)
            model.Objects.AddPoint(rhino3dm.Point3d(*(one.point / MM).tolist()), own)
    options = rhino3dm.File3dmWriteOptions()
    options.Version = RHINO_VERSION
    return undated(base64.b64decode(model.Encode(options)))  # a file that is written holds its own path


def undated(content: bytes) -> bytes:
    """A 3DM file as made and last edited on 1 January 2000 (openNURBS chunks: type, length and content, whose
    last four bytes may be a CRC-32 of the rest).

    Raises ``ValueError`` where the file is not as rhino3dm writes it.
    """
    out, place = bytearray(content), _HEADER
    while place + _CHUNK.size < len(out):
        kind, length = _CHUNK.unpack_from(out, place)
        place += _CHUNK.size
        if kind == _HISTORY:
            end = place + length - _CRC.size
            at = place + 1  # behind its version
            for _ in ("made", "edited"):  # who, as a length and as many letters of two bytes; when
                at += 4 + 2 * int.from_bytes(out[at : at + 4], "little")
                out[at : at + len(_TIME)] = _TIME
                at += len(_TIME)
            if at >= end:
                break
            out[end : end + _CRC.size] = _CRC.pack(zlib.crc32(out[place:end]))
            return bytes(out)
        if not kind & _VALUE and kind != _PROPERTIES:
            place += length
    raise ValueError("rhino3dm wrote no history of revisions where openNURBS has it")


def _say(own: Any, text: Mapping[str, str]) -> None:
    for key, value in text.items():
        own.SetUserString(key, value)


def _layer(model: Any, layers: dict[str, int], path: str, color: Rgb) -> int:
    """The number of a layer by its path, made with those that it is in where it is new."""
    import rhino3dm

    if path not in layers:
        parent, _, name = path.rpartition("::")
        made = rhino3dm.Layer()
        made.Id = uuid.uuid5(IDS, f"layer {path}")
        made.Name = name
        made.Color = (*(round(255 * value) for value in color), 255)
        if parent:
            made.ParentLayerId = model.Layers[_layer(model, layers, parent, color)].Id
        layers[path] = model.Layers.Add(made)
    return layers[path]


def _mesh(shape: Shape) -> Any:
    import rhino3dm

    mesh = rhino3dm.Mesh()
    mesh.Vertices.UseDoublePrecisionVertices = True
    for point in (shape.vertices / MM).tolist():
        mesh.Vertices.AddPoint3d(*point)
    for a, b, c in shape.faces.tolist():
        mesh.Faces.AddFace(a, b, c)
    mesh.Normals.ComputeNormals()
    return mesh
