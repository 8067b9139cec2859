"""Triangles of OBJ, STL, PLY, GLB and 3MF files, read from their bytes, and faces as indexed meshes.

Faces come from files and from lofts. They are offset inwards by a thickness, and the rims of both faces are
joined by ruled edges.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray
from planner.proof.part_files import (
    UNITS,
    Entry,
    UnreadError,
    file_of,
    metres,
    packed_meshes,
    points_in_metres,
    radians,
)
from planner.proof.part_files.curves import (
    GuideRulings,
    bezier,
    bspline,
    interpolate_control,
    join_guides,
    polyline_guide,
)

_STL: Final = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("more", "<u2")])
"""Data type of one triangle of a binary STL file."""
_STL_HEAD: Final = 84
"""Bytes before the first triangle: 80 of text and the count."""
_PLY_TYPES: Final = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
"""Number types of PLY files by name."""
_PLY_FACES: Final = ("vertex_indices", "vertex_index")
"""Names of the property that lists a face's vertices."""


@dataclasses.dataclass(frozen=True)
class Facets:
    """Triangles of a file.

    Attributes:
        corners: Corners (F, 3, 3) in the file's units, anticlockwise seen from outside.
        row: Number (F,) of the face in the file to which each triangle belongs, from 1.
        unit: Metres per unit of the file, None if the file does not state it.
    """

    corners: FloatArray
    row: IntArray
    unit: float | None = None


def read_facets(path: Path) -> Facets:
    """Read the triangles of a file in the format of its suffix. Polygons are split into fans of triangles.

    Raises:
        UnreadError: The file cannot be read.
    """
    data = path.read_bytes()
    kind = path.suffix.lower()
    try:
        if kind == ".obj":
            facets = _obj(data.decode("utf-8", errors="replace"))
        elif kind == ".stl":
            facets = _stl(data)
        elif kind == ".ply":
            facets = _ply(data)
        elif kind in (".glb", ".3mf"):
            corners, unit = packed_meshes.read_glb(data) if kind == ".glb" else packed_meshes.read_3mf(path)
            facets = Facets(corners, np.arange(1, len(corners) + 1), unit)
        else:
            raise UnreadError(f"mesh files {path.suffix or 'without suffix'} are not supported")
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise UnreadError(str(error) or type(error).__name__) from error
    if not len(facets.corners) or not np.isfinite(facets.corners).all():
        raise UnreadError(
            "it has no faces" if not len(facets.corners) else "it has numbers that are not finite"
        )
    return facets


def read_points(path: Path) -> FloatArray:
    """Read the points (N, 3) of a scan in the file's units.

    They are vertices of a mesh, or the first three columns of a text.

    Raises:
        UnreadError: The file cannot be read.
    """
    data = path.read_bytes()
    kind = path.suffix.lower()
    try:
        if kind == ".ply":
            vertex_columns = _ply_columns(data)["vertex"]
            return np.array([vertex_columns[axis] for axis in "xyz"], dtype=np.float64).T
        if kind == ".stl":
            return np.unique(_stl(data).corners.reshape(-1, 3), axis=0)
        if kind not in (".obj", ".xyz", ".txt"):
            raise UnreadError(f"scan files {path.suffix or 'without suffix'} are not supported")
        lines = _lines(data)
        words = [line.replace(",", " ").replace(";", " ").split() for line in lines]
        if kind == ".obj":
            words = [line[1:] for line in words if line and line[0] == "v"]
        words = [line for line in words if line and not line[0].startswith(("#", "//"))]
        if kind != ".obj" and words and (len(words[0]) == 1 or not _is_number(words[0][0])):
            del words[0]  # the number of points, or column names
        return np.array([[float(word) for word in line[:3]] for line in words]).reshape(-1, 3)
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise UnreadError(str(error) or type(error).__name__) from error


def _is_number(word: str) -> bool:
    """Return whether a word is a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _lines(data: bytes) -> list[str]:
    """Return the lines of a text of numbers, in UTF-16, or in any encoding that extends ASCII."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16").splitlines()
    return data.removeprefix(b"\xef\xbb\xbf").decode("latin-1").splitlines()


def _obj(text: str) -> Facets:
    """Read the lines ``v`` and ``f`` of an OBJ file.

    A negative index counts back from the last vertex above its line.
    """
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append([float(word) for word in words[1:4]])
        elif words[0] == "f" and len(words) > 3:
            indices = [int(word.split("/", 1)[0]) for word in words[1:]]
            polygons.append([i - 1 if i > 0 else len(vertices) + i for i in indices])
    return _fans(np.array(vertices, dtype=np.float64).reshape(-1, 3), polygons)


def _fans(vertices: FloatArray, polygons: Sequence[Sequence[int]] | IntArray) -> Facets:
    """Return polygons as triangles: a fan about the first corner of each, in the order of the polygons."""
    lengths = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    triangles, numbers = [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for length in np.unique(lengths[lengths > 2]).tolist():
        rows = np.flatnonzero(lengths == length)
        # polygon_rows (P, length): the P polygons with this number of corners.
        all_equal = len(rows) == len(polygons)
        polygon_rows = np.asarray(
            polygons if all_equal else [polygons[i] for i in rows.tolist()], dtype=np.int64
        )
        fan = [polygon_rows[:, [0, k, k + 1]] for k in range(1, length - 1)]
        triangles.append(np.stack(fan, axis=1).reshape(-1, 3))
        numbers.append(np.repeat(rows + 1, length - 2))
    order = np.argsort(np.concatenate(numbers), kind="stable")
    ordered_triangles = np.concatenate(triangles)[order]
    if len(ordered_triangles) and (ordered_triangles.min() < 0 or ordered_triangles.max() >= len(vertices)):
        raise UnreadError("a face refers to a missing vertex")
    return Facets(vertices[ordered_triangles], np.concatenate(numbers)[order])


def _stl(data: bytes) -> Facets:
    """Read an STL file: binary if its size matches its triangle count, else text with one or more solids."""
    if len(data) >= _STL_HEAD:
        count = int.from_bytes(data[80:84], "little")
        if len(data) == _STL_HEAD + count * _STL.itemsize:
            corners = np.frombuffer(data, _STL, count, _STL_HEAD)["corner"].astype(np.float64)
            return Facets(corners, np.arange(1, count + 1))
    words = data.decode("utf-8", errors="replace").lower().split()
    if "endsolid" not in words:
        raise UnreadError("it is neither a binary STL of the right length nor a text STL")
    last = len(words) - 1 - words[::-1].index("endsolid")
    # Words after the last "endsolid" are the name of a solid, which may be "vertex".
    positions = np.flatnonzero(np.array(words[:last]) == "vertex")
    numbers = [[float(word) for word in words[i + 1 : i + 4]] for i in positions]
    corners = np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)
    return Facets(corners, np.arange(1, len(corners) + 1))


@dataclasses.dataclass
class _PlyElement:
    """An element of a PLY file: a table such as that of vertices or of faces.

    Attributes:
        name: Name of the element.
        count: Number of its rows.
        properties: Name and type of each column, with the type of the count if it is a list, else None.
    """

    name: str
    count: int
    properties: list[tuple[str, str, str | None]]


def _ply(data: bytes) -> Facets:
    """Read the triangles of a PLY file."""
    columns = _ply_columns(data)
    vertices, polygons = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    if "vertex" in columns:
        vertices = np.array([columns["vertex"][axis] for axis in "xyz"], dtype=np.float64).T
    if "face" in columns:
        face_columns = columns["face"]
        list_name = next((name for name in _PLY_FACES if name in face_columns), None) or _first_list(data)
        if list_name is None:
            raise UnreadError("its faces have no list of vertices")
        polygons = face_columns[list_name]
    return _fans(vertices, polygons)


def _first_list(data: bytes) -> str | None:
    """Return the name of the first list property of faces, None without any."""
    faces = [element for element in _ply_elements(_ply_head(data)[0]) if element.name == "face"]
    return next(
        (name for face_element in faces for name, _, count in face_element.properties if count is not None),
        None,
    )


def _ply_columns(data: bytes) -> dict[str, Mapping[str, Any]]:
    """Return the columns of a PLY file: {name of the element: {name of the property: values}}."""
    head, body = _ply_head(data)
    form = next((line[1] for line in head if line[0] == "format"), "")
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    if order is None:
        raise UnreadError(f"its format is {form or '(none)'}")
    numbers = np.array(body.split(), dtype=np.float64) if not order else np.zeros(0)
    offset = 0
    out: dict[str, Mapping[str, Any]] = {}
    for element in _ply_elements(head):
        columns: Mapping[str, Any]
        if order:
            columns, offset = _ply_binary(element, body, offset, order)
        else:
            columns, offset = _ply_text(element, numbers, offset)
        out[element.name] = columns
    return out


def _ply_head(data: bytes) -> tuple[list[list[str]], bytes]:
    """Return the words of each line of the header, and the data after it."""
    end = data.find(b"end_header")
    if not data[:3].lower() == b"ply" or end < 0:
        raise UnreadError("it has no PLY header")
    after = data.find(b"\n", end)
    lines = data[:end].decode("ascii", errors="replace").splitlines()
    return [line.split() for line in lines if line.split()], data[after + 1 :] if after >= 0 else b""


def _ply_elements(head: list[list[str]]) -> list[_PlyElement]:
    """Return the elements that the header states, in the order of their data."""
    out: list[_PlyElement] = []
    for words in head:
        if words[0] == "element":
            out.append(_PlyElement(words[1], int(words[2]), []))
        elif words[0] == "property" and words[1] == "list":
            out[-1].properties.append((words[4], _PLY_TYPES[words[3]], _PLY_TYPES[words[2]]))
        elif words[0] == "property":
            out[-1].properties.append((words[2], _PLY_TYPES[words[1]], None))
    return out


def _ply_text(element: _PlyElement, numbers: FloatArray, offset: int) -> tuple[dict[str, Any], int]:
    """Return the columns of an element of a text file, and the index of the first number of the next element.

    ``numbers`` are all numbers after the header. The element starts at index ``offset``. If the lists of all
    rows are as long as those of the first row, which is the usual case, they are read in one step.
    """
    lengths, position = [], offset
    for _, _, count in element.properties:
        lengths.append(int(numbers[position]) if count is not None and element.count else 0)
        position += 1 + lengths[-1] if count is not None else 1
    width = position - offset
    if element.count and offset + width * element.count <= len(numbers):
        table = numbers[offset : offset + width * element.count].reshape(element.count, width)
        columns: dict[str, Any] = {}
        column, are_equal = 0, True
        for (name, _, count), length in zip(element.properties, lengths, strict=True):
            if count is None:
                columns[name] = table[:, column]
                column += 1
            else:
                are_equal &= bool((table[:, column] == length).all())
                columns[name] = table[:, column + 1 : column + 1 + length].astype(np.int64)
                column += 1 + length
        if are_equal:
            return columns, offset + width * element.count
    out: dict[str, Any] = {name: [] for name, _, _ in element.properties}
    for _ in range(element.count):
        for name, _, count in element.properties:
            length = int(numbers[offset]) if count is not None else 1
            offset += count is not None
            values = numbers[offset : offset + length]
            if len(values) < length:
                raise UnreadError("it is truncated")
            out[name].append(values.astype(np.int64) if count is not None else values[0])
            offset += length
    return out, offset


def _ply_binary(element: _PlyElement, body: bytes, offset: int, order: str) -> tuple[dict[str, Any], int]:
    """Return the columns of an element of a binary file, and the index of the first byte of the next element.

    ``body`` are the bytes after the header. The element starts at index ``offset``. If the lists of all rows
    are as long as those of the first row, which is the usual case, they are read in one step. ``order`` is
    the byte order, "<" or ">".
    """
    lengths = _first_lengths(element, body, offset, order)
    fields: list[Any] = []
    for (name, kind, count), length in zip(element.properties, lengths, strict=True):
        if count is not None:
            fields += [(f"count {name}", order + count), (name, order + kind, (length,))]
        else:
            fields.append((name, order + kind))
    row = np.dtype(fields)
    if offset + row.itemsize * element.count <= len(body):
        table = np.frombuffer(body, row, element.count, offset)
        are_equal = all(
            (table[f"count {name}"] == length).all()
            for (name, _, count), length in zip(element.properties, lengths, strict=True)
            if count is not None
        )
        if are_equal:
            return {name: table[name] for name, _, _ in element.properties}, offset + table.nbytes
    out: dict[str, Any] = {name: [] for name, _, _ in element.properties}
    for _ in range(element.count):
        for name, kind, count in element.properties:
            length = 1
            if count is not None:
                length = int(np.frombuffer(body, order + count, 1, offset)[0])
                offset += np.dtype(count).itemsize
            values = np.frombuffer(body, order + kind, length, offset)
            offset += values.nbytes
            out[name].append(values if count is not None else values[0])
    return out, offset


def _first_lengths(element: _PlyElement, body: bytes, offset: int, order: str) -> list[int]:
    """Return the lengths of the lists in the first row of an element, 0 for scalar properties."""
    out = []
    for _, kind, count in element.properties:
        length = 0
        if count is not None and element.count:
            length = int(np.frombuffer(body, order + count, 1, offset)[0])
            offset += np.dtype(count).itemsize
        out.append(length)
        offset += np.dtype(kind).itemsize * (length if count is not None else 1)
    return out


LOFT_CELLS: Final = (40, 400)
"""Minimum and maximum number of cells of a loft along each of its parameters."""
LOFT_TOLERANCE_M: Final = 1e-5
"""Maximum deviation [m] of cells from the loft, if the maximum number of cells suffices."""
_NORMAL_STEP: Final = 1e-5
"""Step of the differences that give a surface's normals, relative to the range of its parameters."""
_RULINGS: Final = 2000
"""Number of rulings into which a ruled face is divided."""
STRAIGHT_TOLERANCE_M: Final = 1e-8
"""Maximum deviation [m] of a straight line from its chord."""
_POSITIONS: Final = np.linspace(0.0, 1.0, 41)
"""Fractions of both parameter ranges of a face at which its lines are examined."""
_VERTEX_TOLERANCE: Final = 1e-9
"""Distance up to which vertices are equal, relative to the mesh's extent."""
_CORNER_ANGLE_RAD: Final = 20.0 * np.pi / 180.0
"""Angle [rad] above which a rim has a corner."""


@dataclasses.dataclass(frozen=True)
class MeshFace:
    """A face of a part as an indexed mesh.

    Attributes:
        vertices: Vertices (V, 3) [m].
        up: Unit normals (V, 3) at the vertices, away from the part.
        faces: Indices (F, 3) of the vertices of each triangle.
        number: Number (F,) from 1 of each triangle, or of the face in the file to which it belongs.
    """

    vertices: FloatArray
    up: FloatArray
    faces: IntArray
    number: IntArray

    @property
    def corners(self) -> FloatArray:
        """Corners (F, 3, 3) of the triangles."""
        return self.vertices[self.faces]


def mesh_face(entry: Entry) -> MeshFace:
    """Read the face of a mesh file in its own unit or the stated one, scaled, and flipped if requested.

    Raises:
        UnreadError: The file cannot be read.
    """
    facets = read_facets(file_of(entry))
    size = UNITS[str(entry["unit"])] if facets.unit is None else facets.unit
    corners = facets.corners * size * float(entry.get("scale") or 1.0)
    return face_of(corners, facets.row, bool(entry.get("flip")))


def face_of(corners: FloatArray, number: IntArray, flip: bool) -> MeshFace:
    """Return triangles as a face with indexed vertices and normals.

    Equal corners become one vertex, and triangles without area are left out.

    Args:
        corners: Corners (F, 3, 3) [m] of the triangles.
        number: Number (F,) of each triangle.
        flip: Whether the order of the corners, and with it the normals, are reversed.

    Raises:
        UnreadError: No triangle has an area.
    """
    corners = corners[:, ::-1] if flip else corners
    low = corners.reshape(-1, 3).min(axis=0)
    step = max(float((corners.reshape(-1, 3).max(axis=0) - low).max()) * _VERTEX_TOLERANCE, 1e-15)
    grid = np.rint((corners.reshape(-1, 3) - low) / step).astype(np.int64)
    _, first, index = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    vertices, faces = corners.reshape(-1, 3)[first], index.reshape(-1, 3).astype(np.int64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area = np.linalg.norm(cross, axis=1) > step * step
    faces, number = faces[has_area], number[has_area]
    if not len(faces):
        raise UnreadError("all its faces have no area")
    return MeshFace(vertices, _normals(vertices, faces), faces, number)


def loft_face(entry: Entry) -> MeshFace:
    """Return the face of a loft, or of the stated region of it, on a grid of exact points."""
    region = entry.get("region") or {}
    u0, u1 = (float(v) for v in region.get("u") or (0.0, 1.0))
    v0, v1 = (float(v) for v in region.get("v") or (0.0, 1.0))
    return grid_face(lambda u, v: loft_points(entry, u, v), (u0, u1), (v0, v1), bool(entry.get("flip")))


SurfaceFunction = Callable[[FloatArray, FloatArray], FloatArray]
"""Function for points (N, 3) [m] of a surface at its parameters u and v (N,)."""


def grid_face(
    at: SurfaceFunction,
    u: tuple[float, float],
    v: tuple[float, float],
    flip: bool,
    kinks: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros(0)),
) -> MeshFace:
    """Return the face of a surface as triangles between exact points of the surface on a grid.

    The grid is so fine that triangles deviate by at most ``LOFT_TOLERANCE_M``, as far as ``LOFT_CELLS``
    allows. Normals come from central differences with a small step.

    Args:
        at: The surface S(u, v).
        u: Range of its parameter u.
        v: Range of its parameter v.
        flip: Whether the normal away from the part is -dS/du x dS/dv.
        kinks: Parameters along u, and along v, of kinks, through which lines of the grid are added.
    """
    cells = _cell_count(at, u, v)
    grid_lines = [np.linspace(*ends, cells + 1) for ends in (u, v)]
    for k, (low, high) in enumerate((u, v)):
        inner = kinks[k][(kinks[k] > low) & (kinks[k] < high)]
        # Lines that nearly coincide would give cells without area.
        all_lines = np.union1d(grid_lines[k], inner)
        tolerance = _VERTEX_TOLERANCE * (high - low)
        grid_lines[k] = all_lines[np.append(True, np.diff(all_lines) > tolerance)]
    grid = np.meshgrid(*grid_lines, indexing="ij")
    uu, vv = (part.ravel() for part in grid)
    points = at(uu, vv)
    du, dv = _NORMAL_STEP * (u[1] - u[0]), _NORMAL_STEP * (v[1] - v[0])
    along = at(uu + du, vv) - at(uu - du, vv)
    across = at(uu, vv + dv) - at(uu, vv - dv)
    up = np.cross(along, across)
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-300)
    index = np.arange(len(uu)).reshape(grid[0].shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    if flip:
        up, faces = -up, faces[:, ::-1]
    return MeshFace(points, up, faces, np.arange(1, len(faces) + 1))


Region = tuple[tuple[float, float], tuple[float, float]]
"""Ranges of a surface's parameters u and v."""


def straight_parameters(at: SurfaceFunction, region: Region) -> list[int]:
    """Return the parameters along which a surface is straight, so that it is ruled: 0 for u, 1 for v.

    Both, or none, may be returned. Lines at 41 evenly spaced values of the other parameter are examined.
    """
    grid = [low + _POSITIONS * (high - low) for low, high in region]
    u, v = (part.ravel() for part in np.meshgrid(*grid, indexing="ij"))
    lines = at(u, v).reshape(len(_POSITIONS), len(_POSITIONS), 3)
    return [k for k, line_set in enumerate((np.swapaxes(lines, 0, 1), lines)) if _all_straight(line_set)]


def _all_straight(lines: FloatArray) -> bool:
    """Return whether all lines (L, N, 3) of points are straight. A line that is only a point is not."""
    chords = lines[:, -1] - lines[:, 0]
    length = np.linalg.norm(chords, axis=1)
    if length.min() < STRAIGHT_TOLERANCE_M:
        return False
    distances = np.cross(lines - lines[:, :1], (chords / length[:, None])[:, None])
    return bool(np.linalg.norm(distances, axis=2).max() < STRAIGHT_TOLERANCE_M)


def rulings(
    at: SurfaceFunction, region: Region, kinks: tuple[FloatArray, FloatArray], direction: str | None
) -> tuple[int, FloatArray, FloatArray]:
    """Return the rulings of a ruled surface.

    Args:
        at: The surface.
        region: Ranges of its parameters.
        kinks: Parameters along u, and along v, of kinks, at each of which there must be a ruling.
        direction: Parameter along which the rulings run, ``u`` or ``v``. None if the surface is straight
            along one only.

    Returns:
        Parameter along which the rulings run, u (0) or v (1), and their starts and ends (M, 3).

    Raises:
        UnreadError: The surface is straight along no parameter, or along both.
    """
    along = [k for k in straight_parameters(at, region) if direction in (None, "uv"[k])]
    if len(along) != 1:
        raise UnreadError(f"its face is straight {'along both axes' if along else 'along no axis'}")
    (k,) = along
    low, high = region[1 - k]
    inner = kinks[1 - k]
    t = np.union1d(np.linspace(low, high, _RULINGS), inner[(inner > low) & (inner < high)])
    ends = [np.full(len(t), side) for side in region[k]]
    start, end = (at(side, t) if k == 0 else at(t, side) for side in ends)
    return k, start, end


def _cell_count(surface: SurfaceFunction, u: tuple[float, float], v: tuple[float, float]) -> int:
    """Return the number of cells along each parameter with which they deviate by ``LOFT_TOLERANCE_M``.

    The deviation is measured on the coarsest grid, of n0 cells, at the middles of double cells, of which
    there are n0 / 2. It falls with the square of the cell size, so that n = n0 / 2 sqrt(deviation /
    tolerance). The result is within ``LOFT_CELLS``.
    """
    min_cells, max_cells = LOFT_CELLS
    grid = np.meshgrid(np.linspace(*u, min_cells + 1), np.linspace(*v, min_cells + 1), indexing="ij")
    points = surface(grid[0].ravel(), grid[1].ravel()).reshape(min_cells + 1, min_cells + 1, 3)
    deviations = [
        points[1:-1:2] - 0.5 * (points[:-1:2] + points[2::2]),
        points[:, 1:-1:2] - 0.5 * (points[:, :-1:2] + points[:, 2::2]),
    ]
    deviations.append(points[1:-1:2, 1:-1:2] - 0.5 * (points[:-1:2, :-1:2] + points[2::2, 2::2]))
    max_deviation = max(float(np.linalg.norm(values, axis=2).max()) for values in deviations)
    return int(np.clip(0.5 * min_cells * np.sqrt(max_deviation / LOFT_TOLERANCE_M), min_cells, max_cells))


def loft_points(entry: Entry, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return points (N, 3) [m] of a loft, at u (N,) from curve to curve and v (N,) along each curve.

    With a rail, the curves are profiles in half planes through a vertical axis, and u is the fraction of the
    rail's angle about this axis. The first coordinate of a profile is the distance beyond the rail's radius,
    the second one the height. Without a rail, the curves are sections in space.
    """
    rail = entry.get("rail")
    curves = entry.get("sections") if rail is None else entry.get("profiles")
    kind = "bezier_mm" if curves[0].get("bezier_mm") is not None else "bspline_mm"  # type: ignore[index]
    at = np.array([float(curve["at"]) for curve in curves])  # type: ignore[union-attr]
    control = interpolate_control(at, np.stack([points_in_metres(curve[kind]) for curve in curves]), u)  # type: ignore[union-attr]
    points = (bezier if kind == "bezier_mm" else bspline)(control, v)
    if rail is None:
        return points
    angle = radians(rail["start_deg"]) + u * (radians(rail["end_deg"]) - radians(rail["start_deg"]))
    out = metres(rail["radius_mm"]) + points[:, 0]
    centre = [metres(value) for value in rail.get("centre_mm") or (0.0, 0.0, 0.0)]
    return np.column_stack([out * np.cos(angle), out * np.sin(angle), points[:, 1]]) + centre


def offset_inwards(front: MeshFace, depth: float) -> MeshFace:
    """Return the front offset inwards by ``depth`` [m], facing the other way."""
    return MeshFace(front.vertices - depth * front.up, -front.up, front.faces[:, ::-1], front.number)


def boundary_edges(face: MeshFace) -> IntArray:
    """Return the edges (E, 2) that belong to one triangle only, as indices of vertices.

    Each edge runs in the direction in which the face is on its left.
    """
    edges = np.concatenate([face.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[np.sort(first[count == 1])])


def ruled_edges(front: MeshFace, back: MeshFace, moved: bool) -> list[GuideRulings]:
    """Return the ruled edges between the rims of a front and its back.

    Args:
        front: Front of the part.
        back: Back of the part.
        moved: Whether the back consists of the moved vertices of the front. Then vertices of equal index are
            joined. Otherwise points at equal fractions of the length of both rims are joined.

    Returns:
        All ways to join the rims that are equally short. Empty if a face does not have exactly one rim.
    """
    loops = [_closed_loop(boundary_edges(face)) for face in (front, back)]
    if loops[0] is None or loops[1] is None:
        return []
    first = loops[0][::-1]  # so that start direction x ruling points away from the part
    start = front.vertices[first]
    if moved:
        ring = np.append(first, first[0])
        return [GuideRulings(front.vertices[ring], back.vertices[ring])]
    front_rim = polyline_guide(start, closed=True, angle=_CORNER_ANGLE_RAD)
    back_rim = polyline_guide(back.vertices[loops[1]], closed=True, angle=_CORNER_ANGLE_RAD)
    return join_guides(front_rim, back_rim, "arc_length")


def _closed_loop(edges: IntArray) -> IntArray | None:
    """Return the vertices, in order, if directed edges (E, 2) are exactly one closed loop, else None."""
    next_of = dict(edges.tolist())
    if not len(edges) or len(next_of) != len(edges):
        return None
    out = [int(edges[0, 0])]
    while (
        (next_vertex := next_of.get(out[-1])) is not None and next_vertex != out[0] and len(out) <= len(edges)
    ):
        out.append(next_vertex)
    return np.array(out, dtype=np.int64) if len(out) == len(edges) else None


def _normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return unit normals (V, 3) at vertices: means of the normals of triangles, by their angles there."""
    out = np.zeros_like(vertices)
    for k in range(3):
        corner, next_corner, previous_corner = (vertices[faces[:, (k + i) % 3]] for i in range(3))
        edge_a, edge_b = next_corner - corner, previous_corner - corner
        normal = np.cross(edge_a, edge_b)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        angle = np.arctan2(size[:, 0], np.einsum("ij,ij->i", edge_a, edge_b))
        np.add.at(out, faces[:, k], angle[:, None] * normal / np.maximum(size, 1e-300))
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-300))
