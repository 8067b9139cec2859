"""Reader of mesh files: OBJ, STL, PLY and GLB by ``trimesh``, and 3MF by its standard.

GLB is binary glTF 2.0 (Khronos; ISO/IEC 12113), with lengths in metres and y up. 3MF is the 3D Manufacturing
Format, core specification 1.3: a ZIP of XML that states its unit, with z up.
"""

import dataclasses
import io
import json
import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, merge_vertices
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error

MAX_MESH_BYTES: Final = 100_000_000
"""Maximum size of mesh files [bytes]. Larger files are refused unread."""
MAX_UNPACKED_BYTES: Final = 400_000_000
"""Maximum unpacked size of a 3MF file [bytes]."""
PLAIN_SUFFIXES: Final = (".obj", ".stl", ".ply")
"""Mesh files without a unit: Wavefront OBJ, STL, Stanford PLY."""
UNIT_SUFFIXES: Final = (".glb", ".3mf")
"""Mesh files that state their unit: binary glTF, 3D Manufacturing Format."""
MIN_EXTENT_M: Final = 1e-3
"""Minimum length of a mesh's longest side [m]. Shorter meshes have a wrong unit."""
MAX_EXTENT_M: Final = 20.0
"""Maximum length of a mesh's longest side [m]. Longer meshes have a wrong unit."""
UNITS_3MF: Final = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
"""Units of 3MF files [m]. The default is millimetres (core specification, 3.4)."""
_Y_UP: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotates glTF's y up to z up."""
_PRODUCTION: Final = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_MATERIAL: Final = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
_START_PART: Final = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_MAX_TRIANGLES: Final = MAX_MESH_BYTES // 8
"""Maximum number of facets, or vertices, of a 3MF file.

Objects that are placed several times count each time.
"""
_MAX_PLACEMENTS: Final = 100_000
"""Maximum number of placed components and items of a 3MF file. Nested ones count each time."""
_MAX_NESTING: Final = 32
"""Maximum nesting depth of components of a 3MF file."""
_UNREAD_OBJECTS: Final = ("support", "solidsupport", "other")
"""Kinds of objects of a 3MF file that are not parts."""


@dataclasses.dataclass(frozen=True)
class FileUnit:
    """The unit that a file states.

    Attributes:
        name: Name of the unit.
        metres: Its length [m].
        note: Text of the note about it.
    """

    name: str
    metres: float
    note: str


def unit_note(path: Path, field: str) -> list[Issue]:
    """Return a note about the unit that a mesh file states, none for files without one.

    Args:
        path: The file, which has been read.
        field: Field of the note.
    """
    if path.suffix.lower() not in UNIT_SUFFIXES:
        return []
    message = format_message("mesh.file_unit", file=path.name, unit_note=stated_unit(path).note)
    return [Issue("mesh.file_unit", message, Severity.NOTE, file=str(path), field=field)]


def stated_unit(path: Path) -> FileUnit:
    """Return the unit that a GLB or 3MF file states.

    Args:
        path: The file.

    Raises:
        TandemError: ``mesh.unreadable``.
    """
    if path.suffix.lower() == ".glb":
        return FileUnit(
            "m", 1.0, "is in metres and has y up, as the glTF standard defines; it was rotated to z up"
        )
    try:
        with zipfile.ZipFile(path) as pack, pack.open(_model_part(pack)) as stream:
            _, root = next(ET.iterparse(stream, events=("start",)))
        name = root.get("unit", "millimeter")
        return FileUnit(name, UNITS_3MF[name], f"is in {name}, as the file states")
    except Exception as error:  # damaged files raise all kinds of exceptions
        raise _unreadable(path, error) from error


def read_mesh(
    path: Path, unit: float | None, scale: float = 1.0, max_extent: float = MAX_EXTENT_M
) -> TriangleMesh:
    """Read a mesh file and merge equal vertices.

    Args:
        path: OBJ, STL, PLY, GLB or 3MF file.
        unit: Length unit [m] of an OBJ, STL or PLY file. GLB and 3MF files state their own.
        scale: Factor on all lengths.
        max_extent: Maximum extent [m].

    Raises:
        TandemError: The file is missing, larger than 100 MB, of another kind, unreadable, or without faces;
            it has numbers that are not finite; it has another unit than stated, or none; or its size
            indicates a wrong unit.
    """
    if not is_file(path):
        raise _refuse("problem.missing_file", path, f"{missing_file_reason(path)}; check the path")
    size, kind = path.stat().st_size, path.suffix.lower()
    if size > MAX_MESH_BYTES:
        raise _refuse(
            "problem.too_large",
            path,
            f"{size / 1e6:.0f} MB, allowed {MAX_MESH_BYTES / 1e6:.0f} MB; export it with fewer facets",
        )
    if kind not in (*PLAIN_SUFFIXES, *UNIT_SUFFIXES):
        message = f"got '{path.suffix}', supported are OBJ, STL, PLY, GLB and 3MF; convert it"
        raise _refuse("mesh.unreadable", path, message)
    metres = _length_unit(path, unit)
    try:
        vertices, faces = _read_arrays(path, kind)
    except Exception as error:  # readers of damaged files raise all kinds of exceptions
        raise _unreadable(path, error) from error
    if len(faces) == 0:
        raise _refuse("mesh.empty", path, "has no faces; export the surface as a mesh of triangles or quads")
    if not np.isfinite(vertices).all():
        bad_vertex = int(np.nonzero(~np.isfinite(vertices).all(axis=1))[0][0])
        raise _refuse("problem.not_finite", path, f"vertex {bad_vertex} is not finite; repair the file")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _refuse("mesh.unreadable", path, "a face names a missing vertex; export it again")
    mesh = merge_vertices(TriangleMesh(vertices * (metres * scale), faces))
    if len(mesh.faces) == 0:
        raise _refuse("mesh.empty", path, "none of its faces has an area; export it again")
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    if not MIN_EXTENT_M <= extent <= max_extent:
        unit_owner = "its own" if kind in UNIT_SUFFIXES else "the stated"
        remedy = "export it again" if kind in UNIT_SUFFIXES else "state the unit in which the file was made"
        raise _refuse(
            "mesh.unit",
            path,
            f"is {extent * 1e3:.4g} mm long in {unit_owner} unit, allowed {MIN_EXTENT_M * 1e3:g} to "
            f"{max_extent * 1e3:g} mm; {remedy}",
        )
    return mesh


def _length_unit(path: Path, unit: float | None) -> float:
    """Return the length unit of a file [m], which the file or the problem states."""
    if path.suffix.lower() in PLAIN_SUFFIXES:
        if unit is None:
            message = f"a {path.suffix} file has no unit; state it, for example unit: mm"
            raise _refuse("mesh.unit", path, message)
        return unit
    file_unit = stated_unit(path)
    if unit is not None and abs(unit - file_unit.metres) > 1e-9 * file_unit.metres:
        stated_name = next((name for name, size in LENGTH_UNITS.items() if size == unit), f"{unit:g} m")
        message = (
            f"{file_unit.note.split(' and ')[0]}, the problem states {stated_name}; remove unit, or export "
            f"it in {stated_name}"
        )
        raise _refuse("mesh.unit", path, message)
    return file_unit.metres


def _read_arrays(path: Path, kind: str) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) and faces (F, 3), with z up if the file defines which axis is up."""
    if kind == ".3mf":
        return _read_3mf(path)
    import trimesh  # takes half a second, which problems without meshes avoid

    data = path.read_bytes()
    if kind == ".obj":
        data = _absolute_indices(data)
    if kind == ".glb":
        _require_plain_glb(data)
    content = io.BytesIO(data)  # no folder, so that files named inside are not opened
    load_options: dict[str, Any] = {"skip_materials": True} if kind == ".glb" else {}
    loaded = trimesh.load(content, kind[1:], force="mesh", process=False, **load_options)
    vertices = np.array(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(loaded.faces, dtype=np.int64).reshape(-1, 3)
    return (vertices @ _Y_UP.T if kind == ".glb" else vertices), faces


def _require_plain_glb(data: bytes) -> None:
    """Check that a GLB file can be read without extensions and other files.

    Raises:
        ValueError: The data are not glTF 2.0, or need an unsupported extension or another file.
    """
    if data[:4] != b"glTF" or data[16:20] != b"JSON":
        raise ValueError("it is not binary glTF of version 2")
    head = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    # these extensions change only the appearance
    appearance = ("KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights")
    unsupported = [
        item for item in head.get("extensionsRequired", ()) if not str(item).startswith(appearance)
    ]
    if unsupported:
        raise ValueError(
            f"it needs {', '.join(unsupported)}, which is not supported; export it without compression"
        )
    if any("uri" in item for item in head.get("buffers", ())):
        raise ValueError("its data are in another file; export it as one GLB")


def _absolute_indices(data: bytes) -> bytes:
    """Replace relative indices of an OBJ file by absolute ones.

    They count back from their own line, but trimesh counts them from the end of the file.
    """
    if re.search(rb"^[ \t]*f[ \t].*-", data, re.MULTILINE) is None:
        return data
    count = {b"v": 0, b"vt": 0, b"vn": 0}
    out = []
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.split()
        if words and words[0] in count:
            count[words[0]] += 1
        elif words and words[0] == b"f":
            corners = [word.split(b"/") for word in words[1:]]
            line = b"f " + b" ".join(
                b"/".join(
                    b"%d" % (so_far + 1 + int(index)) if index.startswith(b"-") else index
                    for index, so_far in zip(corner, count.values(), strict=False)
                )
                for corner in corners
            )
        out.append(line)
    return b"\n".join(out) + b"\n"


PlacedObject = tuple[str, str, FloatArray]
"""A placed object of a 3MF file: its part, its number, and its pose (4, 3).

The pose is multiplied to rows of points from the right.
"""


@dataclasses.dataclass(frozen=True)
class _Object3mf:
    """An object of a 3MF file: a mesh, or a group of placed objects."""

    kind: str
    vertices: FloatArray
    faces: IntArray
    components: tuple[PlacedObject, ...]


def _read_3mf(path: Path) -> tuple[FloatArray, IntArray]:
    """Return vertices (V, 3) in the file's unit and faces (F, 3) of all objects to build, in their places.

    Raises:
        ValueError: The file is not valid; other exceptions are possible.
    """
    with zipfile.ZipFile(path) as pack:
        if sum(entry.file_size for entry in pack.infolist()) > MAX_UNPACKED_BYTES:
            raise ValueError(
                f"it unpacks to more than {MAX_UNPACKED_BYTES / 1e6:.0f} MB; export fewer facets"
            )
        start = _model_part(pack)
        objects, items = _read_model(pack, start)
        for part in {entry[0] for entry in _all_placed(objects, items)} - {start}:
            objects |= _read_model(pack, part)[0]
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    count = placement_count = triangles = 0

    def place_object(placed_object: PlacedObject, pose: FloatArray, depth: int) -> None:
        nonlocal count, placement_count, triangles
        placement_count += 1
        if placement_count > _MAX_PLACEMENTS:  # nesting multiplies the number of placed components
            raise ValueError(f"its components are placed over {_MAX_PLACEMENTS} times; export it as one mesh")
        if depth > _MAX_NESTING:
            raise ValueError("its components are nested too deep, or in themselves")
        object_3mf = objects.get(placed_object[:2])
        if object_3mf is None:
            raise ValueError(f"an object {placed_object[1]} that it names is missing")
        if object_3mf.kind in _UNREAD_OBJECTS:
            return
        world_pose = _compose(placed_object[2], pose)
        vertices.append(object_3mf.vertices @ world_pose[:3] + world_pose[3])
        is_mirrored = np.linalg.det(world_pose[:3]) < 0.0
        faces.append(count + (object_3mf.faces[:, ::-1] if is_mirrored else object_3mf.faces))
        count, triangles = count + len(object_3mf.vertices), triangles + len(object_3mf.faces)
        if max(count, triangles) > _MAX_TRIANGLES:
            raise ValueError("its components make too many facets; export it with fewer")
        for component in object_3mf.components:
            place_object(component, world_pose, depth + 1)

    for item in items:
        place_object(item, np.vstack([np.eye(3), np.zeros(3)]), 0)
    return np.concatenate(vertices), np.concatenate(faces)


def _all_placed(objects: dict[tuple[str, str], _Object3mf], items: list[PlacedObject]) -> list[PlacedObject]:
    """Return the items to build and the components of all objects."""
    return [*items, *(other for group in objects.values() for other in group.components)]


def _compose(first: FloatArray, then: FloatArray) -> FloatArray:
    """Return the pose (4, 3) that moves rows of points by one pose and then by another."""
    return np.vstack([first[:3] @ then[:3], first[3] @ then[:3] + then[3]])


def _model_part(pack: zipfile.ZipFile) -> str:
    """Return the part of a 3MF file that its relationships name as its model."""
    for relation in ET.fromstring(pack.read("_rels/.rels")):
        if relation.get("Type") == _START_PART:
            return str(relation.get("Target")).lstrip("/")
    raise ValueError("it names no model")


def _read_model(
    pack: zipfile.ZipFile, part: str
) -> tuple[dict[tuple[str, str], _Object3mf], list[PlacedObject]]:
    """Return objects of one part of a file by part and number, and the items to build."""
    objects: dict[tuple[str, str], _Object3mf] = {}
    items: list[PlacedObject] = []
    namespaces: dict[str, str] = {}
    core = ""  # namespace of the core specification, which differs between versions
    with pack.open(part) as stream:
        for event, value in ET.iterparse(stream, events=("start-ns", "start", "end")):
            if event == "start-ns":
                namespaces[value[0]] = value[1]
            elif event == "start" and not core:
                core = value.tag.partition("}")[0] + "}"
                required = value.get("requiredextensions", "").split()
                unsupported = [
                    extension
                    for extension in required
                    if namespaces.get(extension, extension) not in (_PRODUCTION, _MATERIAL)
                ]
                if unsupported:
                    names = ", ".join(namespaces.get(extension, extension) for extension in unsupported)
                    raise ValueError(f"it needs the extension {names}, which is not supported")
            elif event == "end" and value.tag == f"{core}object":
                objects[part, value.get("id")] = _parse_object(value, part, core)
                value.clear()
            elif event == "end" and value.tag == f"{core}item":
                items.append(_parse_placement(value, part))
    return objects, items


def _parse_object(node: Any, part: str, core: str) -> _Object3mf:
    """Return the object of an XML element in a part of a file. ``core`` is the core namespace, in braces."""
    points = [
        [float(v.get(k)) for k in "xyz"] for v in node.iterfind(f"{core}mesh/{core}vertices/{core}vertex")
    ]
    triangles = [
        [int(t.get(k)) for k in ("v1", "v2", "v3")]
        for t in node.iterfind(f"{core}mesh/{core}triangles/{core}triangle")
    ]
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(points)):
        raise ValueError("a face names a missing vertex")
    components = tuple(_parse_placement(c, part) for c in node.iterfind(f"{core}components/{core}component"))
    kind = node.get("type", "model")
    return _Object3mf(kind, np.array(points, dtype=np.float64).reshape(-1, 3), faces, components)


def _parse_placement(node: Any, part: str) -> PlacedObject:
    """Return the placed object of an item or component in a part of a file, without a pose at the origin."""
    text = node.get("transform")
    pose = np.vstack([np.eye(3), np.zeros(3)])
    if text:
        pose = np.array([float(word) for word in text.split()]).reshape(4, 3)
    return str(node.get(f"{{{_PRODUCTION}}}path", part)).lstrip("/"), str(node.get("objectid")), pose


def _unreadable(path: Path, error: Exception) -> TandemError:
    reason = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
    return _refuse("mesh.unreadable", path, f"cannot be read ({reason}); export it again")


def _refuse(code: str, path: Path, message: str) -> TandemError:
    return issue_error(code, f"{path.name}: {message}", file=str(path))


def obj_objects(text: str) -> dict[str, Mesh]:
    """Return the objects of an OBJ file in mm, as the planner writes it, by name.

    Args:
        text: Text of the file.
    """
    points: list[list[float]] = []
    faces: dict[str, list[list[int]]] = {}
    name = "part"
    for line in text.splitlines():
        words = line.split()
        if words[:1] == ["o"]:
            name = words[1]
        elif words[:1] == ["v"]:
            points.append([float(word) * MM for word in words[1:4]])
        elif words[:1] == ["f"]:
            faces.setdefault(name, []).append([int(word.partition("/")[0]) - 1 for word in words[1:4]])
    vertices, out = np.array(points).reshape(-1, 3), {}
    for name, triangles in faces.items():
        used, index = np.unique(np.array(triangles), return_inverse=True)
        out[name] = Mesh(vertices[used], index.reshape(-1, 3).astype(np.int64))
    return out
