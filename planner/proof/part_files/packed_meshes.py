"""Triangles of GLB and 3MF files, read independently from their bytes, with the unit that each states.

A GLB file (glTF 2.0, ISO/IEC 12113) has chunks of JSON and of numbers, nodes with poses, metres, and y up. A
3MF file (core specification 1.3) is XML in a ZIP archive, with objects that components and items place.
"""

import json
import struct
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final
from xml.dom import expatbuilder, pulldom

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.part_files import UnreadError

_COMPONENTS: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Number types of a GLB file by component type."""
_UNITS_3MF: Final = {
    "micron": 1 / 1_000_000,
    "millimeter": 1 / 1000,
    "centimeter": 1 / 100,
    "inch": 254 / 10_000,
    "foot": 3048 / 10_000,
    "meter": 1.0,
}
"""Units of 3MF files [m]."""
_MAX_DEPTH: Final = 40
"""Maximum nesting depth of nodes or components."""
_MAX_PLACEMENTS: Final = 100_001
"""Maximum number of placed components of a 3MF file, or nodes of a GLB file."""
_MAX_TRIANGLES: Final = 12_500_000
"""Maximum number of triangles of a file. Triangles that are placed several times count each time."""
_MAX_BYTES: Final = 400_000_000
"""Maximum size [bytes] of an unpacked 3MF file."""


def read_glb(data: bytes) -> tuple[FloatArray, float]:
    """Return the triangles (F, 3, 3) of a GLB file in its units, with z up, and the metres per unit.

    Raises:
        UnreadError: The data are not a GLB file, or too large. Damaged files raise other errors of parsing.
    """
    if data[:4] != b"glTF":
        raise UnreadError("it is not a GLB file")
    chunks: dict[bytes, bytes] = {}
    offset = 12
    while offset + 8 <= len(data):
        size, kind = struct.unpack_from("<I4s", data, offset)
        chunks.setdefault(kind.rstrip(b"\0 "), data[offset + 8 : offset + 8 + size])
        offset += 8 + size
    document, numbers = json.loads(chunks[b"JSON"]), chunks.get(b"BIN", b"")
    triangles, placements = [np.zeros((0, 3, 3))], 0

    def walk(index: int, parent_pose: FloatArray, depth: int) -> None:
        """Append the triangles of a node and of its children."""
        nonlocal placements
        placements += 1
        if depth > _MAX_DEPTH or placements > _MAX_PLACEMENTS:
            raise UnreadError("its nodes are nested too deep or placed too often")
        node = document["nodes"][index]
        node_pose = parent_pose @ _node_pose(node)
        if "mesh" in node:
            for primitive in document["meshes"][node["mesh"]]["primitives"]:
                corners = _primitive_triangles(document, numbers, primitive)
                corners = corners @ node_pose[:3, :3].T + node_pose[:3, 3]
                # A mirrored node reverses the orientation of its triangles.
                triangles.append(corners[:, ::-1] if np.linalg.det(node_pose[:3, :3]) < 0.0 else corners)
        for child in node.get("children", ()):
            walk(child, node_pose, depth + 1)

    for root in document["scenes"][document.get("scene", 0)].get("nodes", ()):
        walk(root, np.eye(4), 0)
    x, y, z = np.moveaxis(np.concatenate(triangles), -1, 0)
    return np.stack([x, -z, y], axis=-1), 1.0


def _node_pose(node: dict[str, Any]) -> FloatArray:
    """Return the transform (4, 4) of a node, with its scale, in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.eye(4)
    out[:3, :3] = rotation * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _primitive_triangles(document: dict[str, Any], numbers: bytes, primitive: dict[str, Any]) -> FloatArray:
    """Return the triangles (F, 3, 3) of a list (mode 4), strip (5) or fan (6), none for points and lines."""
    mode = primitive.get("mode", 4)
    if mode < 4:
        return np.zeros((0, 3, 3))
    vertices = _read_accessor(document, numbers, primitive["attributes"]["POSITION"]).astype(np.float64)
    order: IntArray = np.arange(len(vertices))
    if "indices" in primitive:
        order = _read_accessor(document, numbers, primitive["indices"])[:, 0].astype(np.int64)
    # In a strip every second triangle has the opposite orientation.
    if mode == 4:
        indices = order[: len(order) // 3 * 3].reshape(-1, 3)
    elif mode == 5:
        indices = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        indices[1::2] = indices[1::2][:, [1, 0, 2]]
    else:
        indices = np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    return np.asarray(vertices[indices])


def _read_accessor(document: dict[str, Any], numbers: bytes, index: int) -> Any:
    """Return the array (N, D) that an accessor describes, with D from 1 to 4 components.

    Raises:
        UnreadError: The numbers are not stored as a plain array, or the file is truncated.
    """
    accessor = document["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise UnreadError("its numbers are not stored as a plain array")
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    kind = np.dtype(_COMPONENTS[accessor["componentType"]])
    first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    step = view.get("byteStride", width * kind.itemsize)
    if first + step * (accessor["count"] - 1) + width * kind.itemsize > len(numbers):
        raise UnreadError("it is truncated")
    return np.ndarray((accessor["count"], width), kind, numbers, first, (step, kind.itemsize))


def read_3mf(path: Path) -> tuple[FloatArray, float]:
    """Return the triangles (F, 3, 3) of a 3MF file in its units, and the metres per unit.

    Raises:
        UnreadError: The file cannot be read, or is too large.
    """
    try:
        with zipfile.ZipFile(path) as pack:
            if sum(member.file_size for member in pack.infolist()) > _MAX_BYTES:
                raise UnreadError("it is too large when it is unpacked")
            links = expatbuilder.parseString(pack.read("_rels/.rels"))
            root = next(
                link.getAttribute("Target")
                for link in links.getElementsByTagNameNS("*", "Relationship")
                if link.getAttribute("Type").endswith("/3dmodel")
            )
            parts: dict[str, dict[str, _Object3mf]] = {}
            size, items = _read_part(pack, root.lstrip("/"), parts)
            corners, triangle_count = [np.zeros((0, 3, 3))], 0
            for part, number, pose in items:
                for placed in _placed_triangles(
                    lambda name: _read_part(pack, name, parts), parts, part, number, pose, 0
                ):
                    corners.append(placed)
                    triangle_count += len(placed)
                    if len(corners) > _MAX_PLACEMENTS or triangle_count > _MAX_TRIANGLES:
                        raise UnreadError("its components are placed too often")
    except (zipfile.BadZipFile, StopIteration, KeyError, SyntaxError) as error:
        raise UnreadError(f"it is not a readable 3MF file ({error or 'no model'})") from error
    return np.concatenate(corners), size


_Object3mf = tuple[str, FloatArray, list[tuple[str, str, FloatArray]]]
"""An object: its kind, its triangles (F, 3, 3), and its components. A component is an object that is placed
in this one: file in the archive, number of the object, and pose (4, 4).
"""


def _placed_triangles(
    read: Callable[[str], Any],
    parts: dict[str, dict[str, _Object3mf]],
    part: str,
    number: str,
    pose: FloatArray,
    depth: int,
) -> Iterator[FloatArray]:
    """Yield the triangles of an object and of all its components, placed by ``pose`` (4, 4).

    Supports and objects of the type "other" are left out.

    Args:
        read: Function that reads a file of the archive into ``parts``.
        parts: Objects that were read: {file: {number of the object: object}}.
        part: File in the archive with the object.
        number: Number of the object in this file.
        pose: Pose (4, 4) of the object.
        depth: Nesting depth of the object.

    Raises:
        UnreadError: Components are nested too deep.
    """
    if depth > _MAX_DEPTH:
        raise UnreadError("its components are nested too deep")
    if part not in parts:
        read(part)
    kind, corners, inner = parts[part][number]
    if kind in ("support", "solidsupport", "other"):
        return
    placed = corners @ pose[:3, :3].T + pose[:3, 3]
    yield placed[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0.0 else placed
    for other, component_number, component_pose in inner:
        yield from _placed_triangles(read, parts, other, component_number, pose @ component_pose, depth + 1)


def _read_part(
    pack: zipfile.ZipFile, name: str, parts: dict[str, dict[str, _Object3mf]]
) -> tuple[float, list[tuple[str, str, FloatArray]]]:
    """Read the objects of a file of the archive into ``parts``.

    Returns:
        Metres per unit, and the items: file, number and pose (4, 4) of each object that is built.
    """
    objects = parts.setdefault(name, {})
    size = _UNITS_3MF["millimeter"]
    items: list[tuple[str, str, FloatArray]] = []
    vertices: list[tuple[float, ...]] = []
    faces: list[tuple[int, ...]] = []
    components: list[tuple[str, str, FloatArray]] = []
    number, kind = "", ""
    with pack.open(name) as stream:
        events: Any = pulldom.parse(stream)
        for event, node in events:
            if event not in ("START_ELEMENT", "END_ELEMENT"):
                continue
            tag, is_start = node.localName, event == "START_ELEMENT"
            if tag == "model" and is_start:
                size = _UNITS_3MF[node.getAttribute("unit") or "millimeter"]
            elif tag == "object" and is_start:
                number, kind = node.getAttribute("id"), node.getAttribute("type")
                vertices, faces, components = [], [], []
            elif tag == "object":
                indices = np.array(faces, dtype=np.int64).reshape(-1, 3)
                corners = np.array(vertices, dtype=np.float64).reshape(-1, 3)[indices]
                objects[number] = (kind, corners, components)
            elif tag == "vertex" and is_start:
                vertices.append(tuple(float(node.getAttribute(axis)) for axis in "xyz"))
            elif tag == "triangle" and is_start:
                faces.append(tuple(int(node.getAttribute(k)) for k in ("v1", "v2", "v3")))
            elif tag in ("component", "item") and is_start:
                (components if tag == "component" else items).append(_placement(node, name))
    return size, items


def _placement(node: Any, part: str) -> tuple[str, str, FloatArray]:
    """Return file, number and pose (4, 4) of the object that a component or item in file ``part`` places."""
    pose = np.eye(4)
    if node.getAttribute("transform"):
        pose[:3] = np.array(node.getAttribute("transform").split(), dtype=np.float64).reshape(4, 3).T
    other = next(
        (attribute.value for attribute in node.attributes.values() if attribute.localName == "path"), part
    )
    return other.lstrip("/"), node.getAttribute("objectid"), pose
