"""Meshes read from files: OBJ, STL, PLY and GLB by ``trimesh``, and 3MF by what its standard says.

GLB is binary glTF 2.0 (Khronos; ISO/IEC 12113): lengths in metres, y up. 3MF is the 3D Manufacturing
Format, core specification 1.3: a ZIP of XML that states its unit, z up.
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

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.mesh import TriangleMesh, merge
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import Issue, Severity, TandemError, refusal

MAX_MESH_BYTES: Final = 100_000_000
"""Mesh files larger than this [bytes] are refused unread."""
MOST_UNPACKED: Final = 400_000_000
"""A 3MF file is not unpacked to more than this [bytes]."""
PLAIN_SUFFIXES: Final = (".obj", ".stl", ".ply")
"""Mesh files that state no unit: Wavefront OBJ, STL, Stanford PLY."""
UNIT_SUFFIXES: Final = (".glb", ".3mf")
"""Mesh files that state their unit: binary glTF, 3D Manufacturing Format."""
SMALLEST_EXTENT: Final = 1e-3
"""A mesh whose longest side is shorter [m] was stated in a wrong unit."""
LARGEST_EXTENT: Final = 20.0
"""A mesh whose longest side is longer [m] was stated in a wrong unit."""
UNITS_3MF: Final = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}
"""Units of 3MF files [m]; one that says none is in millimetres (core specification, 3.4)."""
_Y_UP: Final = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns glTF's y up into z up."""
_PRODUCTION: Final = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
_MATERIAL: Final = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
_START_PART: Final = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_MOST_TRIANGLES: Final = MAX_MESH_BYTES // 8
"""Facets, or vertices, of a 3MF file at most, those that are placed several times counted each time."""
_MOST_PLACES: Final = 100_000
"""Places of components and items of a 3MF file at most, those in one another counted each time."""
_MOST_NESTED: Final = 32
"""Components of a 3MF file in components at most."""
_UNREAD_OBJECTS: Final = ("support", "solidsupport", "other")
"""Kinds of objects of a 3MF file that are no part."""


@dataclasses.dataclass(frozen=True)
class FileUnit:
    """The unit that a file states: its ``name`` and its ``metres``; how it is ``told``."""

    name: str
    metres: float
    told: str


def unit_note(path: Path, field: str) -> list[Issue]:
    """A note of the unit that a mesh file states, of one that was read; none of files without one."""
    if path.suffix.lower() not in UNIT_SUFFIXES:
        return []
    told = stated_unit(path).told
    return [Issue("mesh.file_unit", f"{path.name} {told}", Severity.NOTE, file=str(path), field=field)]


def stated_unit(path: Path) -> FileUnit:
    """The unit that a GLB or 3MF file states. Raises ``TandemError`` (mesh.unreadable)."""
    if path.suffix.lower() == ".glb":
        return FileUnit(
            "m", 1.0, "is in metres and has y up, as glTF's standard says; it was turned so that z is up"
        )
    try:
        with zipfile.ZipFile(path) as pack, pack.open(_start(pack)) as stream:
            _, root = next(ET.iterparse(stream, events=("start",)))
        name = root.get("unit", "millimeter")
        return FileUnit(name, UNITS_3MF[name], f"is in {name}, as the file says")
    except Exception as error:  # damaged files raise anything
        raise _unread(path, error) from error


def read_mesh(
    path: Path, unit: float | None, scale: float = 1.0, largest: float = LARGEST_EXTENT
) -> TriangleMesh:
    """Read an OBJ, STL or PLY file whose lengths are in ``unit`` metres, or a GLB or 3MF file, which states
    its own, times ``scale``; equal vertices become one. ``largest``: how long [m] it may be.

    Raises ``TandemError`` for a file that is missing, larger than 100 MB, of another kind, unreadable,
    without faces, with numbers that are not finite, of another unit than it states or of none, or of a size
    that says that the unit is wrong.
    """
    if not is_file(path):
        raise _refuse("problem.missing_file", path, f"{no_file(path)}; check the path")
    size, kind = path.stat().st_size, path.suffix.lower()
    if size > MAX_MESH_BYTES:
        raise _refuse(
            "problem.too_large",
            path,
            f"{size / 1e6:.0f} MB, up to {MAX_MESH_BYTES / 1e6:.0f} MB are read; export it with fewer facets",
        )
    if kind not in (*PLAIN_SUFFIXES, *UNIT_SUFFIXES):
        what = f"got '{path.suffix}', read are OBJ, STL, PLY, GLB and 3MF; convert it"
        raise _refuse("mesh.unreadable", path, what)
    metres = _unit(path, unit)
    try:
        vertices, faces = _read(path, kind)
    except Exception as error:  # readers of damaged files raise anything
        raise _unread(path, error) from error
    if len(faces) == 0:
        raise _refuse("mesh.empty", path, "has no faces; export the surface as a mesh of triangles or quads")
    if not np.isfinite(vertices).all():
        bad = int(np.nonzero(~np.isfinite(vertices).all(axis=1))[0][0])
        raise _refuse("problem.not_finite", path, f"vertex {bad} is not finite; repair the file")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _refuse("mesh.unreadable", path, "a face names a vertex that is not there; export it again")
    mesh = merge(TriangleMesh(vertices * (metres * scale), faces))
    if len(mesh.faces) == 0:
        raise _refuse("mesh.empty", path, "all its faces have no area; export it again")
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    if not SMALLEST_EXTENT <= extent <= largest:
        own = "its own" if kind in UNIT_SUFFIXES else "the stated"
        remedy = "export it anew" if kind in UNIT_SUFFIXES else "state the unit that the file was made in"
        raise _refuse(
            "mesh.unit",
            path,
            f"is {extent * 1e3:.4g} mm long in {own} unit, allowed are {SMALLEST_EXTENT * 1e3:g} to "
            f"{largest * 1e3:g} mm; {remedy}",
        )
    return mesh


def _unit(path: Path, unit: float | None) -> float:
    """Metres of a length of the file, which states it or for which the problem does."""
    if path.suffix.lower() in PLAIN_SUFFIXES:
        if unit is None:
            what = f"a file {path.suffix} states no unit; state it, as in unit: mm"
            raise _refuse("mesh.unit", path, what)
        return unit
    own = stated_unit(path)
    if unit is not None and abs(unit - own.metres) > 1e-9 * own.metres:
        said = next((name for name, size in LENGTH_UNITS.items() if size == unit), f"{unit:g} m")
        what = f"{own.told.split(' and ')[0]}, the problem says {said}; take unit out, or export it in {said}"
        raise _refuse("mesh.unit", path, what)
    return own.metres


def _read(path: Path, kind: str) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) in the file's lengths, z up where the file says what is up, and faces (F, 3)."""
    if kind == ".3mf":
        return _read_3mf(path)
    import trimesh  # half a second that problems without meshes do not wait for

    data = path.read_bytes()
    if kind == ".obj":
        data = _counted_from_the_start(data)
    if kind == ".glb":
        _require_plain_glb(data)
    content = io.BytesIO(data)  # has no folder, so that nothing the file names is opened
    more: dict[str, Any] = {"skip_materials": True} if kind == ".glb" else {}
    loaded = trimesh.load(content, kind[1:], force="mesh", process=False, **more)
    vertices = np.array(loaded.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.array(loaded.faces, dtype=np.int64).reshape(-1, 3)
    return (vertices @ _Y_UP.T if kind == ".glb" else vertices), faces


def _require_plain_glb(data: bytes) -> None:
    """Raise ``ValueError`` for a GLB whose meshes cannot be had without an extension of glTF."""
    if data[:4] != b"glTF" or data[16:20] != b"JSON":
        raise ValueError("it is no binary glTF of version 2")
    head = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    shown = ("KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights")
    needed = [one for one in head.get("extensionsRequired", ()) if not str(one).startswith(shown)]
    if needed:
        raise ValueError(f"it needs {', '.join(needed)}, which is not read; export it without compression")
    if any("uri" in one for one in head.get("buffers", ())):
        raise ValueError("its data lie in another file; export it as one GLB")


def _counted_from_the_start(data: bytes) -> bytes:
    """An OBJ file without indices that count back from their own line, which trimesh counts from the end of
    the file."""
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


Placed = tuple[str, str, FloatArray]
"""An object of a 3MF file that is placed: its part, its number, its pose (4, 3) behind rows of points."""


@dataclasses.dataclass(frozen=True)
class _Object:
    """An object of a 3MF file: a mesh, or others that are placed in it."""

    kind: str
    vertices: FloatArray
    faces: IntArray
    components: tuple[Placed, ...]


def _read_3mf(path: Path) -> tuple[FloatArray, IntArray]:
    """All objects that are to be built, where the file places them. Raises ``ValueError`` and others."""
    with zipfile.ZipFile(path) as pack:
        if sum(one.file_size for one in pack.infolist()) > MOST_UNPACKED:
            raise ValueError(f"it unpacks to more than {MOST_UNPACKED / 1e6:.0f} MB; export fewer facets")
        start = _start(pack)
        objects, items = _model(pack, start)
        for part in {one[0] for one in _placed(objects, items)} - {start}:
            objects |= _model(pack, part)[0]
    vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)]
    count = places = triangles = 0

    def put(one: Placed, pose: FloatArray, depth: int) -> None:
        nonlocal count, places, triangles
        places += 1
        if places > _MOST_PLACES:  # a few that are placed in one another are more than anybody can count
            raise ValueError(f"its components are placed over {_MOST_PLACES} times; export it as one mesh")
        if depth > _MOST_NESTED:
            raise ValueError("its components are nested too deep, or in themselves")
        own = objects.get(one[:2])
        if own is None:
            raise ValueError(f"an object {one[1]} that it names is not there")
        if own.kind in _UNREAD_OBJECTS:
            return
        here = _behind(one[2], pose)
        vertices.append(own.vertices @ here[:3] + here[3])
        turned = np.linalg.det(here[:3]) < 0.0
        faces.append(count + (own.faces[:, ::-1] if turned else own.faces))
        count, triangles = count + len(own.vertices), triangles + len(own.faces)
        if max(count, triangles) > _MOST_TRIANGLES:
            raise ValueError("its components make too many facets; export it with fewer")
        for other in own.components:
            put(other, here, depth + 1)

    for item in items:
        put(item, np.vstack([np.eye(3), np.zeros(3)]), 0)
    return np.concatenate(vertices), np.concatenate(faces)


def _placed(objects: dict[tuple[str, str], _Object], items: list[Placed]) -> list[Placed]:
    return [*items, *(other for one in objects.values() for other in one.components)]


def _behind(first: FloatArray, then: FloatArray) -> FloatArray:
    """The pose (4, 3) that moves rows of points by one and then by another."""
    return np.vstack([first[:3] @ then[:3], first[3] @ then[:3] + then[3]])


def _start(pack: zipfile.ZipFile) -> str:
    """The part of a 3MF file that its relations name as its model."""
    for one in ET.fromstring(pack.read("_rels/.rels")):
        if one.get("Type") == _START_PART:
            return str(one.get("Target")).lstrip("/")
    raise ValueError("it names no model")


def _model(pack: zipfile.ZipFile, part: str) -> tuple[dict[tuple[str, str], _Object], list[Placed]]:
    """Objects of one part of a file by part and number, and what is to be built."""
    objects: dict[tuple[str, str], _Object] = {}
    items: list[Placed] = []
    spaces: dict[str, str] = {}
    core = ""  # the namespace of the core specification, which has changed with its versions
    with pack.open(part) as stream:
        for event, got in ET.iterparse(stream, events=("start-ns", "start", "end")):
            if event == "start-ns":
                spaces[got[0]] = got[1]
            elif event == "start" and not core:
                core = got.tag.partition("}")[0] + "}"
                asked = got.get("requiredextensions", "").split()
                other = [one for one in asked if spaces.get(one, one) not in (_PRODUCTION, _MATERIAL)]
                if other:
                    what = ", ".join(spaces.get(one, one) for one in other)
                    raise ValueError(f"it needs the extension {what}, which is not read")
            elif event == "end" and got.tag == f"{core}object":
                objects[part, got.get("id")] = _object(got, part, core)
                got.clear()
            elif event == "end" and got.tag == f"{core}item":
                items.append(_place(got, part))
    return objects, items


def _object(one: Any, part: str, core: str) -> _Object:
    at = [[float(v.get(k)) for k in "xyz"] for v in one.iterfind(f"{core}mesh/{core}vertices/{core}vertex")]
    of = [
        [int(t.get(k)) for k in ("v1", "v2", "v3")]
        for t in one.iterfind(f"{core}mesh/{core}triangles/{core}triangle")
    ]
    faces = np.array(of, dtype=np.int64).reshape(-1, 3)
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(at)):
        raise ValueError("a face names a vertex that is not there")
    inner = tuple(_place(c, part) for c in one.iterfind(f"{core}components/{core}component"))
    kind = one.get("type", "model")
    return _Object(kind, np.array(at, dtype=np.float64).reshape(-1, 3), faces, inner)


def _place(one: Any, part: str) -> Placed:
    said = one.get("transform")
    pose = np.vstack([np.eye(3), np.zeros(3)])
    if said:
        pose = np.array([float(word) for word in said.split()]).reshape(4, 3)
    return str(one.get(f"{{{_PRODUCTION}}}path", part)).lstrip("/"), str(one.get("objectid")), pose


def _unread(path: Path, error: Exception) -> TandemError:
    reason = str(error).splitlines()[0][:160] if str(error) else type(error).__name__
    return _refuse("mesh.unreadable", path, f"cannot be read ({reason}); export it again")


def _refuse(code: str, path: Path, what: str) -> TandemError:
    return refusal(code, f"{path.name}: {what}", file=str(path))


def objects(text: str) -> dict[str, Mesh]:
    """The objects of an OBJ file in mm, as the planner writes it, by their names."""
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
    for name, rows in faces.items():
        used, index = np.unique(np.array(rows), return_inverse=True)
        out[name] = Mesh(vertices[used], index.reshape(-1, 3).astype(np.int64))
    return out
