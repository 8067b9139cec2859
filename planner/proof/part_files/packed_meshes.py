"""Triangles of GLB and 3MF files, read a second time from their bytes, with the unit that each states.

GLB: glTF 2.0 (ISO/IEC 12113): chunks of JSON and numbers, nodes with poses, metres, y up. 3MF: core
specification 1.3: XML in a ZIP, objects placed by components and items.
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
"""Numbers of a GLB file by their kind."""
_UNITS_3MF: Final = {
    "micron": 1 / 1_000_000,
    "millimeter": 1 / 1000,
    "centimeter": 1 / 100,
    "inch": 254 / 10_000,
    "foot": 3048 / 10_000,
    "meter": 1.0,
}
"""Units of 3MF files [m]."""
_DEEPEST: Final = 40
"""Nodes or components in one another at most."""
_MOST_PLACES: Final = 100_001
"""Times that components of a 3MF file, or nodes of a GLB file, are placed at most."""
_MOST_TRIANGLES: Final = 12_500_000
"""Triangles of a file at most, those that are placed several times counted each time."""
_MOST_BYTES: Final = 400_000_000
"""Bytes of an unpacked 3MF file at most."""


def glb(data: bytes) -> tuple[FloatArray, float]:
    """Triangles (F, 3, 3) of a GLB file in its lengths, z up, and the metres of those."""
    if data[:4] != b"glTF":
        raise UnreadError("it is no GLB file")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= len(data):
        size, kind = struct.unpack_from("<I4s", data, at)
        chunks.setdefault(kind.rstrip(b"\0 "), data[at + 8 : at + 8 + size])
        at += 8 + size
    said, numbers = json.loads(chunks[b"JSON"]), chunks.get(b"BIN", b"")
    found, places = [np.zeros((0, 3, 3))], 0

    def walk(index: int, above: FloatArray, depth: int) -> None:
        nonlocal places
        places += 1
        if depth > _DEEPEST or places > _MOST_PLACES:
            raise UnreadError("its nodes are in one another too deep, or too often")
        node = said["nodes"][index]
        here = above @ _node_pose(node)
        if "mesh" in node:
            for one in said["meshes"][node["mesh"]]["primitives"]:
                corners = _primitive(said, numbers, one)
                corners = corners @ here[:3, :3].T + here[:3, 3]
                found.append(corners[:, ::-1] if np.linalg.det(here[:3, :3]) < 0.0 else corners)
        for child in node.get("children", ()):
            walk(child, here, depth + 1)

    for root in said["scenes"][said.get("scene", 0)].get("nodes", ()):
        walk(root, np.eye(4), 0)
    x, y, z = np.moveaxis(np.concatenate(found), -1, 0)
    return np.stack([x, -z, y], axis=-1), 1.0


def _node_pose(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    out = np.eye(4)
    out[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    out[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return out


def _primitive(said: dict[str, Any], numbers: bytes, one: dict[str, Any]) -> FloatArray:
    """Triangles (F, 3, 3) of a row of them, a strip or a fan; nothing for points and lines."""
    mode = one.get("mode", 4)
    if mode < 4:
        return np.zeros((0, 3, 3))
    places = _accessor(said, numbers, one["attributes"]["POSITION"]).astype(np.float64)
    order: IntArray = np.arange(len(places))
    if "indices" in one:
        order = _accessor(said, numbers, one["indices"])[:, 0].astype(np.int64)
    if mode == 4:
        three = order[: len(order) // 3 * 3].reshape(-1, 3)
    elif mode == 5:
        three = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        three[1::2] = three[1::2][:, [1, 0, 2]]
    else:
        three = np.stack([np.full(len(order) - 2, order[0]), order[1:-1], order[2:]], axis=1)
    return np.asarray(places[three])


def _accessor(said: dict[str, Any], numbers: bytes, index: int) -> Any:
    own = said["accessors"][index]
    if "sparse" in own or "bufferView" not in own:
        raise UnreadError("its numbers are not kept in a plain row")
    view = said["bufferViews"][own["bufferView"]]
    wide = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[own["type"]]
    kind = np.dtype(_COMPONENTS[own["componentType"]])
    first = view.get("byteOffset", 0) + own.get("byteOffset", 0)
    step = view.get("byteStride", wide * kind.itemsize)
    if first + step * (own["count"] - 1) + wide * kind.itemsize > len(numbers):
        raise UnreadError("it ends within its data")
    return np.ndarray((own["count"], wide), kind, numbers, first, (step, kind.itemsize))


def packed(path: Path) -> tuple[FloatArray, float]:
    """Triangles (F, 3, 3) of a 3MF file in its lengths, and the metres of those."""
    try:
        with zipfile.ZipFile(path) as pack:
            if sum(one.file_size for one in pack.infolist()) > _MOST_BYTES:
                raise UnreadError("it is too large when it is unpacked")
            links = expatbuilder.parseString(pack.read("_rels/.rels"))
            root = next(
                one.getAttribute("Target")
                for one in links.getElementsByTagNameNS("*", "Relationship")
                if one.getAttribute("Type").endswith("/3dmodel")
            )
            parts: dict[str, dict[str, _Thing]] = {}
            size, items = _part(pack, root.lstrip("/"), parts)
            corners, triangles = [np.zeros((0, 3, 3))], 0
            for part, number, pose in items:
                for one in _built(lambda name: _part(pack, name, parts), parts, part, number, pose, 0):
                    corners.append(one)
                    triangles += len(one)
                    if len(corners) > _MOST_PLACES or triangles > _MOST_TRIANGLES:
                        raise UnreadError("its components are placed too often")
    except (zipfile.BadZipFile, StopIteration, KeyError, SyntaxError) as error:
        raise UnreadError(f"it is no 3MF file that can be read ({error or 'no model'})") from error
    return np.concatenate(corners), size


_Thing = tuple[str, FloatArray, list[tuple[str, str, FloatArray]]]
"""An object: its kind, its triangles (F, 3, 3), and what is placed in it."""


def _built(
    read: Callable[[str], Any],
    parts: dict[str, dict[str, _Thing]],
    part: str,
    number: str,
    pose: FloatArray,
    depth: int,
) -> Iterator[FloatArray]:
    """The triangles of an object and of all that it is made of, placed by ``pose`` (4, 4) of columns."""
    if depth > _DEEPEST:
        raise UnreadError("its components are in one another too deep")
    if part not in parts:
        read(part)
    kind, corners, inner = parts[part][number]
    if kind in ("support", "solidsupport", "other"):
        return
    placed = corners @ pose[:3, :3].T + pose[:3, 3]
    yield placed[:, ::-1] if np.linalg.det(pose[:3, :3]) < 0.0 else placed
    for other, its, own in inner:
        yield from _built(read, parts, other, its, pose @ own, depth + 1)


def _part(
    pack: zipfile.ZipFile, name: str, parts: dict[str, dict[str, _Thing]]
) -> tuple[float, list[tuple[str, str, FloatArray]]]:
    """Reads the objects of one part into ``parts``; its unit [m] and its items."""
    own = parts.setdefault(name, {})
    size = _UNITS_3MF["millimeter"]
    items: list[tuple[str, str, FloatArray]] = []
    places: list[tuple[float, ...]] = []
    faces: list[tuple[int, ...]] = []
    inner: list[tuple[str, str, FloatArray]] = []
    number, kind = "", ""
    with pack.open(name) as stream:
        events: Any = pulldom.parse(stream)
        for event, node in events:
            if event not in ("START_ELEMENT", "END_ELEMENT"):
                continue
            tag, begins = node.localName, event == "START_ELEMENT"
            if tag == "model" and begins:
                size = _UNITS_3MF[node.getAttribute("unit") or "millimeter"]
            elif tag == "object" and begins:
                number, kind = node.getAttribute("id"), node.getAttribute("type")
                places, faces, inner = [], [], []
            elif tag == "object":
                of = np.array(faces, dtype=np.int64).reshape(-1, 3)
                own[number] = (kind, np.array(places, dtype=np.float64).reshape(-1, 3)[of], inner)
            elif tag == "vertex" and begins:
                places.append(tuple(float(node.getAttribute(axis)) for axis in "xyz"))
            elif tag == "triangle" and begins:
                faces.append(tuple(int(node.getAttribute(k)) for k in ("v1", "v2", "v3")))
            elif tag in ("component", "item") and begins:
                (inner if tag == "component" else items).append(_placing(node, name))
    return size, items


def _placing(node: Any, part: str) -> tuple[str, str, FloatArray]:
    pose = np.eye(4)
    if node.getAttribute("transform"):
        pose[:3] = np.array(node.getAttribute("transform").split(), dtype=np.float64).reshape(4, 3).T
    other = next((one.value for one in node.attributes.values() if one.localName == "path"), part)
    return other.lstrip("/"), node.getAttribute("objectid"), pose
