"""How many facets and vertices a mesh file has, told from its text or header without building the mesh."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

LINES: Final = 1 << 22
"""Text is read so many bytes at a time, to the end of a line."""
STL_HEAD, STL_FACET = 84, 50
PLY_BYTES: Final = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
PLY_HEAD: Final = 1 << 16
_FACE: Final = re.compile(rb"^[ \t]*f[ \t][^\r\n]*", re.MULTILINE)
_VERTEX: Final = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
_STL_FACET: Final = re.compile(rb"^[ \t]*facet\b", re.MULTILINE | re.IGNORECASE)


class MeshSize(NamedTuple):
    """Polygons count as the triangles that they become."""

    facets: int
    vertices: int


def mesh_size(path: Path, suffix: str) -> MeshSize:
    """The size of an OBJ, STL or PLY file; zero for other kinds and for what is none."""
    kind = suffix.lower()
    if kind == ".obj":
        return _obj(path)
    if kind == ".stl":
        return _stl(path)
    return _ply(path) if kind == ".ply" else MeshSize(0, 0)


def _obj(path: Path) -> MeshSize:
    facets = vertices = 0
    for text in _texts(path):
        vertices += len(_VERTEX.findall(text))
        facets += sum(max(len(face.split()) - 3, 0) for face in _FACE.findall(text))
    return MeshSize(facets, vertices)


def _stl(path: Path) -> MeshSize:
    """A binary file is as long as its count says; others are text, or broken."""
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
    facets = int.from_bytes(head[80:84], "little")
    if len(head) < STL_HEAD or STL_HEAD + STL_FACET * facets != path.stat().st_size:
        facets = sum(len(_STL_FACET.findall(part)) for part in _texts(path))
    return MeshSize(facets, 3 * facets)


def _ply(path: Path) -> MeshSize:
    with path.open("rb") as stream:
        head, found, _ = stream.read(PLY_HEAD).partition(b"end_header")
    if not found:
        return MeshSize(0, 0)
    elements = list(_elements(head.decode("latin-1")))
    most = path.stat().st_size  # no file holds more rows than bytes; the reader refuses one that says so
    counts = {name: min(count, most) for name, count, _ in elements}
    facets, vertices = counts.get("face", 0), counts.get("vertex", 0)
    before, last = elements[:-1], elements[-1] if elements else ("", 0, [])
    lists = [kind for kind in last[2] if kind[0] == "list"]
    plain = not any(kind[0] == "list" for _, _, kinds in before for kind in kinds)
    if last[0] != "face" or len(lists) != 1 or not plain:
        return MeshSize(facets, vertices)
    if b"ascii" in head:
        rows = sum(count for _, count, _ in before)
        polygons = _corners(path, rows) - 2 * facets if last[2][0] == lists[0] else 0
    else:
        # what is left for the corners of all faces tells their number, and n corners make n - 2 triangles
        fixed = sum(count * PLY_BYTES.get(kind[0], 0) for _, count, kinds in before for kind in kinds)
        own = sum(PLY_BYTES.get(kind[0], 0) for kind in last[2] if kind[0] != "list")
        left = most - len(head) - len(b"end_header\n") - fixed
        left -= facets * (own + PLY_BYTES.get(lists[0][1], 1))
        polygons = left // PLY_BYTES.get(lists[0][2], 4) - 2 * facets
    return MeshSize(max(facets, polygons), vertices)


def _corners(path: Path, rows: int) -> int:
    """The corners of all faces of a text file: each begins with its count, ``rows`` come before them."""
    corners = 0
    with path.open("rb") as stream:
        for line in stream:
            if line.startswith(b"end_header"):
                break
        for number, line in enumerate(stream):
            if number >= rows:
                first = line.split(None, 1)[:1]
                corners += min(int(first[0]), len(line)) if first and first[0].isdigit() else 0
    return corners


def _elements(head: str) -> Iterator[tuple[str, int, list[tuple[str, ...]]]]:
    """Name, count, and the types of the properties (``list``, its count's, its items') of each element."""
    name, count, kinds = "", 0, list[tuple[str, ...]]()
    for words in (line.split() for line in head.splitlines()):
        if words[:1] == ["element"] and len(words) == 3:
            if name:
                yield name, count, kinds
            name, count, kinds = words[1], int(words[2]) if words[2].isdecimal() else 0, []
        elif words[:1] == ["property"] and len(words) in (3, 5):
            kinds.append(tuple(words[1:4]) if words[1] == "list" else (words[1],))
    if name:
        yield name, count, kinds


def _texts(path: Path) -> Iterator[bytes]:
    """The file in parts that end with a line."""
    with path.open("rb") as stream:
        while part := stream.read(LINES):
            yield part + stream.readline()
