"""Reads an uploaded problem: its name, what stands in its way, its reach, what the page draws of it.

Files are found among the uploads by the names that the problem says, never on the disk; what is told calls
them by the user's names. It gives the problem as it stands alone, too, and tests its reach if asked. How many
facets and vertices a mesh file has is told from its text or header without building the mesh.

**Drawn before it is planned**: surfaces, block, and ways of tool points, all as triangles; the ways
of the tool points, of poses that a table gives, as thin bars.

**Elements** are read in the same way, with the templates of their jobs inside; panels, out of the folder of a
divided element, as problems that stand alone.

This runs in a process of its own (:mod:`planner.service.upload_processes`), because what people
upload may be hostile; it loads all processes, so nothing else imports it.
"""

import contextlib
import dataclasses
import hashlib
import json
import os
import re
import shutil
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from planner import plans
from planner.batch.job import ELEMENT, PROBLEM
from planner.element import element_file
from planner.element.element_file import ElementFile
from planner.element.nested_output import PROBLEMS
from planner.files import FILE_KEYS, base_name, carried_name
from planner.geometry.arrays import FloatArray, Mesh, spread_rows
from planner.geometry.thinning import thinned
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import Problem
from planner.processes import registry
from planner.reading import problem as problem_file
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Document
from planner.report.raster import part_meshes
from planner.runtime.memoize import use_cache
from planner.service import kept_targets
from planner.service.examined import Examined
from planner.service.kept_files import KeptFiles

NOWHERE: Final = "files/not-uploaded"
"""Stands for a file that was not uploaded; there is none of this name."""
PROCESS: Final = "targets"
"""Its targets are as good as read from a file; those of other processes take planning."""
MOST: Final = 3000
"""Bars of one way; of longer ones some poses are left out."""
DIVIDED_BY: Final = {
    "elastic": ("tolerance_mm", "joint_mm"),
    "hexagons": ("count", "off_surface_mm"),
    "boxes": ("least_height_mm",),
    "puzzle": ("lobe_mm", "cells"),
    "strips": ("tolerance_mm",),
}
"""Figures of the element file by which each kind of panels is divided."""
WIDTH: Final = 0.004
"""Of a bar, as a share of the way's extent and the block's."""


class Uploaded:
    """The uploads of one problem: ``uploads`` {name that the user gave: stored file}, laid into ``folder``
    under names of our own when the problem names them."""

    def __init__(self, folder: Path, uploads: Mapping[str, Path]) -> None:
        self._folder, self._uploads = folder, uploads
        self._names: dict[str, str] = {}
        self._cell: Document | None = None
        self._inner: dict[Path, int] = {}  # how deep in the whole the file begins
        self._faults: list[Issue] = []
        (folder / "files").mkdir()

    def inside(self, document: Document) -> tuple[Document, list[Issue]]:
        """The document with every file name changed to one in the folder and a cell's file written out, and
        a fault for each name that is no upload's."""
        data = self._changed(document.data, document, ())
        if isinstance(data.get("cell"), str):
            path = self._laid(data["cell"], document, ("cell",))
            if path == NOWHERE:
                data["cell"] = NOWHERE
            else:
                self._cell, data["cell"] = self._read(path, ("cell",))
        return document.with_data(data), self._faults

    def element_inside(self, document: Document) -> tuple[Document, list[Issue]]:
        """The same of an element: the templates of its jobs and of its raw blocks are written out, with their
        cells."""
        data = self._changed(document.data, document, ())
        jobs, saw, raw = data.get("jobs"), data.get("cut_blocks"), data.get("raw_blocks")
        for number, job in enumerate(jobs if isinstance(jobs, list) else ()):
            if isinstance(job, dict) and "problem" in job:
                job["problem"] = self._template(job["problem"], document, ("jobs", number, "problem"))
        if isinstance(saw, dict) and "problem" in saw:
            saw["problem"] = self._template(saw["problem"], document, ("cut_blocks", "problem"))
        if isinstance(raw, dict) and isinstance(raw.get("stock"), str):
            raw["stock"] = self._laid(raw["stock"], document, ("raw_blocks", "stock"))
        return document.with_data(data), self._faults

    def _template(self, given: Any, document: Document, place: tuple[str | int, ...]) -> Any:
        if isinstance(given, str):
            path = self._laid(given, document, place)
            if path == NOWHERE:
                return given
            document, given = self._read(path, place)
        if isinstance(given, dict) and isinstance(given.get("cell"), str):
            path = self._laid(given["cell"], document, (*place, "cell"))
            if path != NOWHERE:
                given["cell"] = self._read(path, (*place, "cell"))[1]
        return given

    def _read(self, path: str, place: tuple[str | int, ...]) -> tuple[Document, Any]:
        """A file that is laid, and its values as the whole has them at ``place``."""
        document = strict_yaml.read(self._folder / path)
        self._inner[document.path] = len(place)
        return document, self._changed(document.data, document, place)

    def in_user_names(self, issues: Iterable[Issue]) -> tuple[Issue, ...]:
        """The issues without paths of this machine, those of a cell's file with its lines."""
        return tuple(self._in_user_names(issue) for issue in issues)

    def _in_user_names(self, issue: Issue) -> Issue:
        place = (issue.field or "").split(".")
        if self._cell is not None and place[0] == "cell" and len(place) > 1:
            steps = tuple(int(step) if step.isdigit() else step for step in place[1:])
            issue = dataclasses.replace(issue, file=str(self._cell.path), line=self._cell.line(steps))
        return dataclasses.replace(
            issue,
            message=self._plain(issue.message) or "",
            file=self._plain(issue.file),
            field=self._plain(issue.field),
            hint=self._plain(issue.hint),
        )

    def _plain(self, text: str | None) -> str | None:
        if text is None:
            return None
        for path, name in self._names.items():
            text = text.replace(path, name).replace(base_name(path), base_name(name))
        return text.replace(f"{self._folder}{os.sep}", "")

    def _changed(self, data: Any, document: Document, place: tuple[str | int, ...]) -> Any:
        if isinstance(data, dict):
            return {
                key: self._laid(value, document, (*place, key))
                if key in FILE_KEYS and isinstance(value, str)
                else self._changed(value, document, (*place, key))
                for key, value in data.items()
            }
        if isinstance(data, list):
            return [self._changed(value, document, (*place, i)) for i, value in enumerate(data)]
        return data

    def _laid(self, name: str, document: Document, place: tuple[str | int, ...]) -> str:
        """Lay the upload of that name into the folder; its path from there."""
        found = (
            [name] if name in self._uploads else [n for n in self._uploads if base_name(n) == base_name(name)]
        )
        if len(found) != 1:
            self._faults.append(self._not_uploaded(name, bool(found), document, place))
            return NOWHERE
        source = self._uploads[found[0]]
        laid = f"files/{carried_name(found[0], source.name)}"
        if not (self._folder / laid).exists():
            _link_or_copy(source, self._folder / laid)
        self._names[str(self._folder / laid)] = found[0]
        return laid

    def _not_uploaded(self, name: str, many: bool, document: Document, place: tuple[str | int, ...]) -> Issue:
        field = ".".join(str(step) for step in place)
        have = ", ".join(repr(one[:80]) for one in sorted(self._uploads)[:10]) or "no files"
        what = f"{'several uploads are' if many else 'no upload is'} called {base_name(name)[:80]!r}"
        inner = place[self._inner.get(document.path, 0) :]
        return Issue(
            "service.not_uploaded",
            f"{field}: got {name[:80]!r}, {what}; with the problem came {have}",
            file=str(document.path),
            line=document.line(inner),
            field=field,
            hint="upload the file with the problem, under the name that the problem says",
        )


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        target.hardlink_to(source)
    except OSError:  # on another disk
        shutil.copyfile(source, target)


def paths(problem: Problem) -> tuple[list[tuple[str, Mesh]], list[Issue]]:
    """The ways by name, in the stock's frame [m], and what is wrong with their tables."""
    found: list[tuple[str, Mesh]] = []
    faults: list[Issue] = []
    for index, operation in enumerate(problem.operations):
        if operation.process != PROCESS:
            continue
        try:
            targets = registry.job(problem, index).targets()
        except TandemError as error:
            faults.extend(error.issues)
            continue
        stock = problem.setup_of(index).stock
        for arm in targets.arms:
            places = targets.pose[arm][:, :3, 3]
            if targets.frame[arm] == "world":
                if stock.place is None:  # the search will say where the block is
                    continue
                places = (places - stock.place[:3, 3]) @ stock.place[:3, :3]
            size = max(float(np.ptp(places, axis=0).max()), float(stock.size.max()))
            found.append((f"{operation.name}, {arm}", path_bars(places, WIDTH * size)))
    return found, faults


def path_bars(places: FloatArray, width: float) -> Mesh:
    """Bars of a square section from each place (N, 3) to the next one; equal places have none."""
    some = places[spread_rows(len(places), MOST + 1)]
    start, way = some[:-1], np.diff(some, axis=0)
    length = np.linalg.norm(way, axis=1)
    start, way, length = start[length > 0.0], way[length > 0.0], length[length > 0.0]
    along = way / length[:, None]
    other = np.eye(3)[np.argmin(np.abs(along), axis=1)]
    across = np.cross(along, other)
    across *= 0.5 * width / np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(along, across)
    ring = np.stack([across + up, up - across, -across - up, across - up], axis=1)
    corners = np.concatenate([start[:, None] + ring, (start + way)[:, None] + ring], axis=1)
    sides = [(i, (i + 1) % 4, 4 + i) for i in range(4)]
    sides += [((i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    caps = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    faces = np.array(sides + caps)[None] + 8 * np.arange(len(start))[:, None, None]
    return Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3))


FINEST: Final = 60_000
"""Meshes of more triangles are thinned out for the picture."""


def shapes(problem: Problem) -> tuple[list[dict[str, Any]], list[Issue]]:
    """Bodies in the stock's frame [mm]: ``name``, ``kind`` (part, path, stock), ``vertices`` and ``faces``,
    both flat lists; and what is wrong with tables of poses."""
    named = list(part_meshes(problem.part))
    if problem.part is not None and problem.part.formed is not None:
        named.append(("formed sheet", problem.part.formed.mesh))
    bodies = [_body(name, "part", mesh) for name, mesh in named if len(mesh.faces)]
    ways, faults = paths(problem)
    bodies += [_body(name, "path", mesh) for name, mesh in ways]
    bodies.append(_body("sheet" if problem.stock.sheet is not None else "block", "stock", _box_mesh(problem)))
    return bodies, faults


def _box_mesh(problem: Problem) -> Mesh:
    low, high = problem.stock.lower, problem.stock.upper
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))]
    return Mesh(low + corners * (high - low), np.array(faces, dtype=np.int64))


def _body(name: str, kind: str, mesh: Mesh) -> dict[str, Any]:
    thin = thinned(mesh, FINEST) if kind == "part" else mesh
    vertices: FloatArray = np.round(thin.vertices / MM, 3)
    return {
        "name": name,
        "kind": kind,
        "vertices": vertices.reshape(-1).tolist(),
        "faces": np.asarray(thin.faces).reshape(-1).tolist(),
    }


LINES: Final = 1 << 22
"""Text is read so many bytes at a time, to the end of a line."""
STL_HEAD, STL_FACET = 84, 50
"""Bytes of the head of a binary STL file, and of each facet after it."""
PLY_BYTES: Final = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of a value of each type in a binary PLY file."""
PLY_HEAD_BYTES: Final = 1 << 16
"""Bytes in which the head of a PLY file must end."""
GLB_HEAD_BYTES: Final = 1 << 24
"""Bytes of the JSON of a GLB file that are looked at."""
PACKED_BYTES: Final = 400_000_000
"""Bytes of an unpacked 3MF file at most."""
_OBJ_FACE: Final = re.compile(rb"^[ \t]*f[ \t][^\r\n]*", re.MULTILINE)
"""A line of an OBJ file that is a face."""
_OBJ_VERTEX: Final = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
"""How a line of an OBJ file begins that is a vertex."""
_STL_FACET: Final = re.compile(rb"^[ \t]*facet\b", re.MULTILINE | re.IGNORECASE)
"""How a line of an STL file in text begins that is a facet."""


class MeshSize(NamedTuple):
    """Polygons count as the triangles that they become."""

    facets: int
    vertices: int


def mesh_size(path: Path, suffix: str) -> MeshSize:
    """The size of an OBJ, STL, PLY, GLB or 3MF file; zero for other kinds and for what is none."""
    kind = suffix.lower()
    if kind == ".obj":
        return _obj(path)
    if kind == ".stl":
        return _stl(path)
    if kind == ".glb":
        return _glb(path)
    if kind == ".3mf":
        return _packed(path)
    return _ply(path) if kind == ".ply" else MeshSize(0, 0)


def _obj(path: Path) -> MeshSize:
    facets = vertices = 0
    for text in _texts(path):
        vertices += len(_OBJ_VERTEX.findall(text))
        facets += sum(max(len(face.split()) - 3, 0) for face in _OBJ_FACE.findall(text))
    return MeshSize(facets, vertices)


def _stl(path: Path) -> MeshSize:
    """A binary file is as long as its count says; others are text, or broken."""
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
    facets = int.from_bytes(head[80:84], "little")
    if len(head) < STL_HEAD or STL_HEAD + STL_FACET * facets != path.stat().st_size:
        facets = sum(len(_STL_FACET.findall(part)) for part in _texts(path))
    return MeshSize(facets, 3 * facets)


def _glb(path: Path) -> MeshSize:
    """As its JSON says, meshes that are shown more than once counted once."""
    with path.open("rb") as stream:
        length = int.from_bytes(stream.read(16)[12:16], "little")
        text = stream.read(4 + min(length, GLB_HEAD_BYTES))[4:]
    try:
        said = json.loads(text)
        counts = [int(one["count"]) for one in said["accessors"]]
        every = [one for mesh in said["meshes"] for one in mesh["primitives"]]
        vertices = [counts[one["attributes"]["POSITION"]] for one in every]
        corners = [
            counts[one["indices"]] if "indices" in one else n for one, n in zip(every, vertices, strict=True)
        ]
    except (ValueError, TypeError, KeyError, IndexError):
        return MeshSize(0, 0)
    return MeshSize(sum(corners) // 3, sum(vertices))


def _packed(path: Path) -> MeshSize:
    """Of a 3MF file as far as it is unpacked; one that unpacks to more has as many facets as bytes."""
    facets = vertices = 0
    try:
        with zipfile.ZipFile(path) as pack:
            inside = pack.infolist()
            if sum(one.file_size for one in inside) > PACKED_BYTES:
                return MeshSize(PACKED_BYTES, PACKED_BYTES)
            for one in inside:
                if one.filename.lower().endswith(".model"):
                    with pack.open(one) as stream:
                        tail = b""
                        while piece := stream.read(LINES):
                            facets += (tail + piece).count(b"<triangle ") - tail.count(b"<triangle ")
                            vertices += (tail + piece).count(b"<vertex ") - tail.count(b"<vertex ")
                            tail = piece[-16:]
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError, zlib.error):
        return MeshSize(0, 0)
    return MeshSize(facets, vertices)


def _ply(path: Path) -> MeshSize:
    with path.open("rb") as stream:
        head, found, _ = stream.read(PLY_HEAD_BYTES).partition(b"end_header")
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
    """The file in parts that end with a line, without the line ends that a backslash takes away."""
    with path.open("rb") as stream:
        while part := stream.read(LINES):
            pieces = [part, stream.readline()]
            while pieces[-1] and (pieces[-2] + pieces[-1]).endswith(CONTINUED):
                pieces.append(stream.readline())
            whole = b"".join(pieces)
            for end in CONTINUED:
                whole = whole.replace(end, b"")
            yield whole


CONTINUED: Final = (b"\\\r\n", b"\\\n")
"""How a line of an OBJ file ends that goes on in the next one."""
ARCHIVES: Final = (
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"\x1f\x8b",
    b"BZh",
    b"\xfd7zXZ",
    b"7z\xbc\xaf",
    b"Rar!",
    b"\x28\xb5\x2f\xfd",
    b"\x04\x22\x4d\x18",
    b"!<arch>\n",
    b"MSCF",
)
"""How zip, gzip, bzip2, xz, 7z, rar, zstd, lz4, ar and cab begin; tar has its word further on."""
TAR_MAGIC: Final = slice(257, 262)
"""Bytes at which a tar file says that it is one."""


def examine(
    folder: Path,
    problem: Path,
    uploads: Mapping[str, Path],
    facets: int,
    reach: bool = False,
    draw: bool = False,
    targets: int | None = None,
    kept: Path | None = None,
    cell: Mapping[str, Any] | None = None,
    fields: Mapping[str, Any] | None = None,
) -> Examined:
    """Read the problem in the file ``problem``; ``uploads`` {name that the user gave: stored file}.

    ``folder`` is an empty one for this call alone. A mesh has at most ``facets``, three vertices for each.
    With ``reach`` the targets are made and reach is tested, at about so many ``targets`` where they are
    given. With ``kept``, those made and what is worked out of meshes are kept in that folder. With ``draw``
    there are ``shapes`` for the page, with ``cell`` there is what :func:`planner.service.cell_view.view`
    draws for these arguments. ``fields`` take the place of those that the problem has.
    """
    known = None if kept is None else KeptFiles(kept)
    faults = [*_archives(uploads), *_large_meshes(uploads, facets)]
    if faults:
        return Examined(tuple(faults))
    with use_cache(known):
        uploaded = Uploaded(folder, uploads)
        shutil.copyfile(problem, folder / PROBLEM)
        try:
            document = strict_yaml.read(folder / PROBLEM)
            wrong = [*_replaced(document.data, fields or {})]
            document, faults = uploaded.inside(document)
            faults = [*wrong, *faults]
            if faults:
                return Examined(uploaded.in_user_names([*faults, *_other_faults(document)]))
            read = problem_file.build(document, registry.readers())
        except TandemError as error:
            return Examined(uploaded.in_user_names(error.issues))
        files = problem_file.bundle(read)
        text = files.pop(PROBLEM).decode()
        found = [*(read.part.notes if read.part is not None else ()), *read.notes]
        looked_at: dict[str, Any] | None = None
        if reach:
            from planner import pipeline  # loads Drake

            make = None if known is None else kept_targets.maker(known, read, alike=targets is not None)
            looked = pipeline.looked_over(read, targets, make)
            found += [issue for issue in looked.issues if issue not in found]
            if looked.of:
                looked_at = {name: getattr(looked, name) for name in ("targets", "of", "placed", "thinned")}
        seen: dict[str, Any] | None = None
        if cell is not None:
            try:
                seen, faults = _cell(read, folder, known, cell)
                found += faults
            except TandemError as error:
                found += error.issues
        drawn: list[dict[str, Any]] = []
        if draw:
            drawn, faults = shapes(read)
            found += [issue for issue in faults if issue not in found]
        return Examined(
            issues=uploaded.in_user_names(found),
            name=read.name,
            digest=read.digest,
            processes=tuple(dict.fromkeys(operation.process for operation in read.operations)),
            text=text,
            files={name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
            summary=_summary(read),
            shapes=tuple(drawn),
            looked_at=looked_at,
            cell=seen,
        )


def _cell(
    problem: Problem, folder: Path, kept: KeptFiles | None, asked: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Issue]]:
    count = len(problem.operations)
    if asked["operation"] >= count:
        what = f"operation: got {asked['operation']}, the problem has {count}; give 0 to {count - 1}"
        raise refusal("service.request", what, field="operation")
    from planner.service import cell_view  # loads Drake

    make = None if kept is None else kept_targets.maker(kept, problem, alike=True)
    plan = None
    if files := asked.get("plan"):
        for name, path in files:
            _link_or_copy(Path(path), folder / name)
        with contextlib.suppress(TandemError):  # made by another version
            plan = plans.load(folder)
    seen, faults = cell_view.view(problem, make=make, **{**asked, "plan": plan})
    for target in seen.get("targets", ()):
        target["faults"] = [issue.to_dict() for issue in target["faults"]]
    return seen, faults


def examine_element(
    folder: Path, element: Path, uploads: Mapping[str, Path], facets: int, fields: Mapping[str, Any]
) -> Examined:
    """The same of an element file, with ``fields`` in place of those that it has; ``summary``: the ``kind``
    of its panels and the ``fields`` that may be changed, as they are."""
    faults = [*_archives(uploads), *_large_meshes(uploads, facets)]
    if faults:
        return Examined(tuple(faults))
    uploaded = Uploaded(folder, uploads)
    shutil.copyfile(element, folder / ELEMENT)
    try:
        document = strict_yaml.read(folder / ELEMENT)
        faults = [*_replaced(document.data, fields)]
        document, missing = uploaded.element_inside(document)
        if faults or missing:
            return Examined(uploaded.in_user_names([*faults, *missing]))
        text = strict_yaml.dump(document.data)
        (folder / ELEMENT).write_text(text, "utf-8")
        read = element_file.read(folder / ELEMENT)
    except TandemError as error:
        return Examined(uploaded.in_user_names(error.issues))
    laid = {f"files/{path.name}": path.read_bytes() for path in sorted((folder / "files").iterdir())}
    files = {name: hashlib.sha256(content).hexdigest() for name, content in laid.items() if name in text}
    operations = [operation for template in read.templates for operation in template.data["operations"]]
    named = [str(one["process"]) for one in operations if isinstance(one, dict) and "process" in one]
    return Examined(
        issues=(),
        name=read.file.name,
        digest=hashlib.sha256(text.encode()).hexdigest(),
        processes=tuple(dict.fromkeys(named)),
        text=text,
        files=files,
        summary={"kind": read.file.panels.kind, "fields": _fields(read.file)},
    )


_PLACE: Final = re.compile(r"[A-Za-z0-9_.-]{1,200}")
"""The place of a field in a problem or an element."""


def _replaced(data: dict[str, Any], fields: Mapping[str, Any]) -> Iterator[Issue]:
    """Set fields by their places; what cannot be set."""
    for field, value in fields.items():
        if not _PLACE.fullmatch(field):  # it may turn or hide what is told of it
            what = f"fields: got {field[:40]!a}; give the place of a field, such as stock.size_mm"
            yield Issue("service.request", what, field="fields")
            continue
        try:
            strict_yaml.changed_field(data, field, value, Path("/"))
        except ValueError as error:
            yield Issue("service.request", f"{field[:80]}: {error}; correct it", field=field[:80])


def _fields(spec: ElementFile) -> dict[str, Any]:
    """What may be changed by hand: thickness, blocks, the figure by which its kind is divided."""
    kind = spec.panels.kind
    wanted = getattr(spec.panels, kind)
    out: dict[str, Any] = {}
    for name in DIVIDED_BY[kind]:
        value = getattr(wanted, name)
        if value is not None:
            out[f"panels.{kind}.{name}"] = list(value) if isinstance(value, tuple) else value
    out["thickness_mm"] = spec.thickness_mm
    for number, block in enumerate(spec.blocks):
        out[f"blocks.{number}.size_mm"] = list(block.size_mm)
    for number, block in enumerate(spec.raw_blocks.sizes if spec.raw_blocks else ()):
        out[f"raw_blocks.sizes.{number}.size_mm"] = list(block.size_mm)
    return out


def examine_panels(folder: Path, files: Mapping[str, Path], panels: Sequence[str]) -> list[Examined]:
    """Panels and jobs of raw blocks of a divided element by their ids as problems that stand alone; ``files``
    of the element's job, by name. Their targets are made when they are planned."""
    for name, path in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        _link_or_copy(path, folder / name)
    out = []
    for panel in panels:
        path = next(path for one in PROBLEMS if (path := folder / one / f"{panel}.yaml").is_file())
        source = problem_file.resolved(strict_yaml.read(path).data, path.parent)
        stored = problem_file.packed(source)
        text = stored.pop(PROBLEM).decode()
        out.append(
            Examined(
                issues=(),
                name=str(source["name"]),
                digest=problem_file.digest(source),
                processes=tuple(dict.fromkeys(str(one["process"]) for one in source["operations"])),
                text=text,
                files={name: hashlib.sha256(content).hexdigest() for name, content in stored.items()},
            )
        )
    return out


def _other_faults(document: Document) -> list[Issue]:
    """What else is wrong where files are missing."""
    try:
        problem_file.build(document, registry.readers())
    except TandemError as error:
        return [issue for issue in error.issues if NOWHERE not in f"{issue.message} {issue.file}"]
    return []


def _archives(uploads: Mapping[str, Path]) -> Iterator[Issue]:
    for name, path in uploads.items():
        with path.open("rb") as stream:
            head = stream.read(512)
        if Path(base_name(name)).suffix.lower() == ".3mf" and zipfile.is_zipfile(path):
            continue  # a mesh, whose contents are counted below
        if head.startswith(ARCHIVES) or head[TAR_MAGIC] == b"ustar":
            message = f"{name[:80]!r} is an archive or compressed; unpack it and upload the files themselves"
            yield Issue("service.archive", message, file=name, field="files")


def _large_meshes(uploads: Mapping[str, Path], most: int) -> Iterator[Issue]:
    """Meshes are counted before they are read, which takes far more time and memory."""
    for name, path in uploads.items():
        size = mesh_size(path, Path(base_name(name)).suffix)
        for what, count, limit in (("facets", size.facets, most), ("vertices", size.vertices, 3 * most)):
            if count > limit:
                message = (
                    f"{name[:80]!r} has {count:,} {what}, this service takes meshes of at most {limit:,}; "
                    "export it coarser, or simplify it"
                )
                yield Issue("service.too_large", message, file=name, field="files", value=count, limit=limit)


def _summary(problem: Problem) -> dict[str, Any]:
    """What is in the problem; boxes as lower and upper corner [mm] in the stock's frame."""
    arms = [{"name": arm.name, "robot": arm.robot, "tool": arm.tool.name} for arm in problem.cell.arms]
    operations = [{"name": o.name, "process": o.process, "arms": list(o.arms)} for o in problem.operations]
    out: dict[str, Any] = {"arms": arms, "operations": operations, "stock_mm": _box(problem.stock.box)}
    part = problem.part
    if part is not None:
        formed = part.formed.mesh if part.formed is not None else None
        points = [mesh.vertices for mesh in (part.front, part.back, formed) if mesh is not None]
        points += [np.concatenate([ruled.start, ruled.end]) for ruled in part.ruled]
        every = np.concatenate(points) if points else np.zeros((0, 3))
        if len(every):
            out["part_mm"] = _box(np.stack([every.min(axis=0), every.max(axis=0)]))
    return out


def _box(corners: Any) -> list[list[float]]:
    return [[round(float(value) / MM, 3) for value in corner] for corner in corners]
