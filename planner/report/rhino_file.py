"""Meshes, lines and points as a 3DM file of Rhino, in layers, in mm. Equal input gives identical bytes.

rhino3dm writes the current time and random ids into each file. Here all files have the same date, and ids
follow from the order of objects and the paths of layers.
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
from planner.issues import issue_error

Rgb = tuple[float, float, float]
RHINO_VERSION: Final = 7
"""Oldest version of Rhino that reads the files."""
PATH_COLOUR: Final = (0.10, 0.20, 0.60)
"""Colour of tool paths."""
ID_NAMESPACE: Final = uuid.UUID("7f3d5f0e-5d0b-5a55-9d0c-6f1c2b7a4e18")
"""Namespace of the ids of layers and objects."""
# Structure of a file: chunks with a type, whose codes are those of openNURBS, and a length
_HEADER: Final = 32  # bytes before the first chunk of a file
_CHUNK: Final = struct.Struct("<Iq")  # type, and length, or value if the highest bit of the type is set
_VALUE: Final = 0x80000000
_PROPERTIES: Final = 0x10000014
_HISTORY: Final = 0x20008021
_TIME: Final = struct.pack("<8i", 0, 0, 0, 1, 0, 100, 6, 0)  # 1 January 2000, as struct tm has it
_CRC: Final = struct.Struct("<I")


@dataclasses.dataclass(frozen=True)
class RhinoMesh:
    """A mesh in the world.

    Attributes:
        layer: Path of the layer.
        vertices: Vertices (V, 3) [m].
        faces: Faces (F, 3).
        color: Colour.
        name: Name, or empty.
        text: User text.
    """

    layer: str
    vertices: FloatArray
    faces: IntArray
    color: Rgb
    name: str = ""
    text: Mapping[str, str] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class RhinoPolyline:
    """A polyline (N, 3) [m] in the world on a ``layer``."""

    layer: str
    points: FloatArray
    color: Rgb


@dataclasses.dataclass(frozen=True)
class RhinoTarget:
    """A TCP (3,) [m] in the world on a ``layer``, with its user text."""

    layer: str
    point: FloatArray
    text: Mapping[str, str]


def is_available() -> bool:
    """Report whether 3DM files can be written."""
    return importlib.util.find_spec("rhino3dm") is not None


def rhino_bytes(items: Iterable[RhinoMesh | RhinoPolyline | RhinoTarget]) -> bytes:
    """Return shapes, lines and targets as the content of a 3DM file of Rhino 7, each on its layer.

    Ids and dates in the file are fixed, so that equal items give equal bytes.

    Args:
        items: Shapes, lines and targets. Their order determines the ids of the objects.

    Raises:
        TandemError: ``part.extra_missing``, rhino3dm is not installed.
    """
    try:
        import rhino3dm
    except ImportError as error:
        message = "3DM files need rhino3dm. Run pip install 'tandem-planner[cad]'."
        raise issue_error("part.extra_missing", message, field="output") from error
    model = rhino3dm.File3dm()
    model.Settings.ModelUnitSystem = rhino3dm.UnitSystem.Millimeters
    layers: dict[str, int] = {}
    for number, item in enumerate(items):
        attributes = rhino3dm.ObjectAttributes()
        attributes.Id = uuid.uuid5(ID_NAMESPACE, f"object {number}")
        color = PATH_COLOUR if isinstance(item, RhinoTarget) else item.color
        attributes.LayerIndex = _layer(model, layers, item.layer, color)
        if isinstance(item, RhinoMesh):
            attributes.Name = item.name
            _set_user_text(attributes, item.text)
            model.Objects.AddMesh(_mesh(item), attributes)
        elif isinstance(item, RhinoPolyline):
            points = [rhino3dm.Point3d(*point) for point in (item.points / MM).tolist()]
            model.Objects.AddPolyline(rhino3dm.Polyline(points), attributes)
        else:
            attributes.Name = item.text["target"]
            _set_user_text(attributes, item.text)
            model.Objects.AddPoint(rhino3dm.Point3d(*(item.point / MM).tolist()), attributes)
    options = rhino3dm.File3dmWriteOptions()
    options.Version = RHINO_VERSION
    # Write() would store the path in the file.
    return set_fixed_dates(base64.b64decode(model.Encode(options)))


def set_fixed_dates(content: bytes) -> bytes:
    """Set the dates of creation and last edit of a 3DM file to 1 January 2000.

    Equal plans thus give files with equal bytes. The dates are in the revision history chunk.

    The file consists of openNURBS chunks: type, length and content. The last four bytes of the content may be
    a CRC-32 of the rest. A short chunk has a value instead of a length, and no content.

    Args:
        content: File as rhino3dm writes it.

    Raises:
        ValueError: The file has another structure.
    """
    out, offset = bytearray(content), _HEADER
    while offset + _CHUNK.size < len(out):
        kind, length = _CHUNK.unpack_from(out, offset)
        offset += _CHUNK.size
        if kind == _HISTORY:
            end = offset + length - _CRC.size
            position = offset + 1  # after the version of the chunk, one byte
            for _ in ("made", "edited"):  # name (length and UTF-16 letters), then date
                position += 4 + 2 * int.from_bytes(out[position : position + 4], "little")
                out[position : position + len(_TIME)] = _TIME
                position += len(_TIME)
            if position >= end:  # shorter than its content: not the known structure
                break
            out[end : end + _CRC.size] = _CRC.pack(zlib.crc32(out[offset:end]))
            return bytes(out)
        # Skip the content of a chunk. A short chunk (_VALUE) has none. The properties are not skipped,
        # because the history is one of the chunks in their content.
        if not kind & _VALUE and kind != _PROPERTIES:
            offset += length
    raise ValueError("rhino3dm wrote no revision history at its place in openNURBS files")


def _set_user_text(attributes: Any, text: Mapping[str, str]) -> None:
    for key, value in text.items():
        attributes.SetUserString(key, value)


def _layer(model: Any, layers: dict[str, int], path: str, color: Rgb) -> int:
    """Return the index of a layer by its path. If it is missing, it is created with its parents.

    ``layers`` has the indices of existing layers by path, and gets those of new ones.
    """
    import rhino3dm

    if path not in layers:
        parent, _, name = path.rpartition("::")
        layer = rhino3dm.Layer()
        layer.Id = uuid.uuid5(ID_NAMESPACE, f"layer {path}")
        layer.Name = name
        layer.Color = (*(round(255 * value) for value in color), 255)
        if parent:
            layer.ParentLayerId = model.Layers[_layer(model, layers, parent, color)].Id
        layers[path] = model.Layers.Add(layer)
    return layers[path]


def _mesh(shape: RhinoMesh) -> Any:
    """Convert a mesh to one of rhino3dm in mm, with normals."""
    import rhino3dm

    mesh = rhino3dm.Mesh()
    mesh.Vertices.UseDoublePrecisionVertices = True
    for point in (shape.vertices / MM).tolist():
        mesh.Vertices.AddPoint3d(*point)
    for a, b, c in shape.faces.tolist():
        mesh.Faces.AddFace(a, b, c)
    mesh.Normals.ComputeNormals()
    return mesh
