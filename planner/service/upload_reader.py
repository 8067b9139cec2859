"""Reader of uploaded problems: name, issues, reach, and the shapes that the web page draws.

Files are looked up among the uploads by the names in the problem, never on the disk. Messages use the names
that the user gave. The reader also returns the problem in a self-contained form, and tests its reach if
requested. The facets and vertices of a mesh file are counted from its text or header, without building the
mesh.

**Shapes**: surfaces and block as triangles, and the tool paths of pose tables as thin bars.

**Elements** are read in the same way, with the templates of their jobs inlined. Panels are read from the
folder of a divided element, as self-contained problems.

This module runs in a process of its own (:mod:`planner.service.upload_processes`), because uploads may be
hostile. It loads all processes, so nothing else imports it.
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
from planner.batch.job import ELEMENT_FILE, PROBLEM_FILE
from planner.element import element_file
from planner.element.element_file import ElementFile
from planner.element.nested_output import PROBLEMS
from planner.files import FILE_KEYS, base_name, bundled_name
from planner.geometry.arrays import FloatArray, Mesh, spread_rows
from planner.geometry.decimation import decimate
from planner.geometry.units import MM
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Problem
from planner.processes import registry
from planner.reading import problem as problem_file
from planner.reading import strict_yaml
from planner.reading.strict_yaml import Document
from planner.report.raster import part_meshes
from planner.runtime.memoize import use_cache
from planner.service import target_cache
from planner.service.file_cache import FileCache
from planner.service.reading_result import PROBLEM_ONLY, ReadingOptions, ReadingResult

MISSING_FILE: Final = "files/not-uploaded"
"""Placeholder for a file that was not uploaded. No file has this name."""
POSE_PROCESS: Final = "targets"
"""Process whose targets are read from a file. Targets of other processes take planning."""
MAX_BARS: Final = 3000
"""Maximum number of bars of one drawn path. Longer paths are decimated."""
DIVISION_FIELDS: Final = {
    "elastic": ("tolerance_mm", "joint_mm"),
    "hexagons": ("count", "off_surface_mm"),
    "boxes": ("least_height_mm",),
    "puzzle": ("lobe_mm", "cells"),
    "strips": ("tolerance_mm",),
}
"""Fields of the element file that control the division, by kind of panels."""
BAR_WIDTH_FRACTION: Final = 0.004
"""Width of a bar, as a fraction of the extent of path or block."""


class LinkedUploads:
    """The uploads of one problem, linked into a folder under safe names when the problem uses them.

    Args:
        folder: Empty folder.
        uploads: Stored files by the names that the user gave.
    """

    def __init__(self, folder: Path, uploads: Mapping[str, Path]) -> None:
        self._folder, self._uploads = folder, uploads
        self._names: dict[str, str] = {}
        self._cell: Document | None = None
        self._inline_depth: dict[Path, int] = {}  # depth of each file's root in the inlined document
        self._faults: list[Issue] = []
        (folder / "files").mkdir()

    def inline_problem(self, document: Document) -> tuple[Document, list[Issue]]:
        """Inline the cell of a problem and replace all file names by those in the folder.

        Args:
            document: Problem file.

        Returns:
            Changed document, and an issue for each file that was not uploaded.
        """
        data = self._with_linked_files(document.data, document, ())
        if isinstance(data.get("cell"), str):
            path = self._link_upload(data["cell"], document, ("cell",))
            if path == MISSING_FILE:
                data["cell"] = MISSING_FILE
            else:
                self._cell, data["cell"] = self._read_inlined(path, ("cell",))
        return document.with_data(data), self._faults

    def inline_element(self, document: Document) -> tuple[Document, list[Issue]]:
        """Inline the templates of an element with their cells, and replace all file names.

        Templates belong to its jobs and its raw blocks.

        Args:
            document: Element file.

        Returns:
            Changed document, and an issue for each file that was not uploaded.
        """
        data = self._with_linked_files(document.data, document, ())
        jobs, block_cutting, raw_blocks = data.get("jobs"), data.get("cut_blocks"), data.get("raw_blocks")
        for number, job in enumerate(jobs if isinstance(jobs, list) else ()):
            if isinstance(job, dict) and "problem" in job:
                job["problem"] = self._inline_template(job["problem"], document, ("jobs", number, "problem"))
        if isinstance(block_cutting, dict) and "problem" in block_cutting:
            block_cutting["problem"] = self._inline_template(
                block_cutting["problem"], document, ("cut_blocks", "problem")
            )
        if isinstance(raw_blocks, dict) and isinstance(raw_blocks.get("stock"), str):
            raw_blocks["stock"] = self._link_upload(raw_blocks["stock"], document, ("raw_blocks", "stock"))
        return document.with_data(data), self._faults

    def _inline_template(self, template: Any, document: Document, field_path: tuple[str | int, ...]) -> Any:
        """Return the data of a template with its cell inlined.

        Args:
            template: Name of the template file, or its data.
            document: Document that contains the template or its name.
            field_path: Path of the template in the inlined document.
        """
        if isinstance(template, str):
            linked_path = self._link_upload(template, document, field_path)
            if linked_path == MISSING_FILE:
                return template
            document, template = self._read_inlined(linked_path, field_path)
        if isinstance(template, dict) and isinstance(template.get("cell"), str):
            linked_path = self._link_upload(template["cell"], document, (*field_path, "cell"))
            if linked_path != MISSING_FILE:
                template["cell"] = self._read_inlined(linked_path, (*field_path, "cell"))[1]
        return template

    def _read_inlined(self, path: str, field_path: tuple[str | int, ...]) -> tuple[Document, Any]:
        """Read a linked file. Return the document, and its values as they are inlined at a field path."""
        document = strict_yaml.read(self._folder / path)
        self._inline_depth[document.path] = len(field_path)
        return document, self._with_linked_files(document.data, document, field_path)

    def with_user_names(self, issues: Iterable[Issue]) -> tuple[Issue, ...]:
        """Replace paths of this machine in issues by the user's names, and lines by those in the cell file.

        Args:
            issues: Issues.
        """
        return tuple(self._with_user_names(issue) for issue in issues)

    def _with_user_names(self, issue: Issue) -> Issue:
        """Replace paths in one issue. An issue of a cell file gets the path and the line of that file."""
        field_path = (issue.field or "").split(".")
        if self._cell is not None and field_path[0] == "cell" and len(field_path) > 1:
            steps = tuple(int(step) if step.isdigit() else step for step in field_path[1:])
            issue = dataclasses.replace(issue, file=str(self._cell.path), line=self._cell.line(steps))
        return dataclasses.replace(
            issue,
            message=self._replace_paths(issue.message) or "",
            file=self._replace_paths(issue.file),
            field=self._replace_paths(issue.field),
            hint=self._replace_paths(issue.hint),
        )

    def _replace_paths(self, text: str | None) -> str | None:
        """Replace paths and names of linked files in a text by the user's names, and drop the folder."""
        if text is None:
            return None
        for path, name in self._names.items():
            text = text.replace(path, name).replace(base_name(path), base_name(name))
        return text.replace(f"{self._folder}{os.sep}", "")

    def _with_linked_files(self, data: Any, document: Document, field_path: tuple[str | int, ...]) -> Any:
        """Return a copy of data in which all file names are those of linked uploads.

        Args:
            data: Values at ``field_path``, at any level.
            document: Document that contains the values, for the lines of issues.
            field_path: Path of the values in the inlined document.
        """
        if isinstance(data, dict):
            return {
                key: self._link_upload(value, document, (*field_path, key))
                if key in FILE_KEYS and isinstance(value, str)
                else self._with_linked_files(value, document, (*field_path, key))
                for key, value in data.items()
            }
        if isinstance(data, list):
            return [
                self._with_linked_files(value, document, (*field_path, index))
                for index, value in enumerate(data)
            ]
        return data

    def _link_upload(self, name: str, document: Document, field_path: tuple[str | int, ...]) -> str:
        """Link the upload with a name into the folder.

        A name matches an upload with the same name, else the only upload with the same last path component.

        Args:
            name: Name in the document.
            document: Document, for the line of an issue.
            field_path: Path of the field in the inlined document.

        Returns:
            Path in the folder. If there is no match, an issue is added, and `MISSING_FILE` is returned.
        """
        matches = (
            [name]
            if name in self._uploads
            else [upload_name for upload_name in self._uploads if base_name(upload_name) == base_name(name)]
        )
        if len(matches) != 1:
            self._faults.append(self._missing_upload(name, bool(matches), document, field_path))
            return MISSING_FILE
        source = self._uploads[matches[0]]
        linked_path = f"files/{bundled_name(matches[0], source.name)}"
        if not (self._folder / linked_path).exists():
            _link_or_copy(source, self._folder / linked_path)
        self._names[str(self._folder / linked_path)] = matches[0]
        return linked_path

    def _missing_upload(
        self, name: str, ambiguous: bool, document: Document, field_path: tuple[str | int, ...]
    ) -> Issue:
        """Return the issue for a file that was not uploaded, or whose name matches several uploads."""
        field = ".".join(str(part) for part in field_path)
        uploaded_names = (
            ", ".join(repr(upload_name[:80]) for upload_name in sorted(self._uploads)[:10]) or "no files"
        )
        path_in_file = field_path[self._inline_depth.get(document.path, 0) :]
        return Issue(
            "service.not_uploaded",
            format_message(
                "service.not_uploaded",
                field=field,
                matches="several uploads are" if ambiguous else "no upload is",
                file_name=base_name(name)[:80],
                stated_path=name[:80],
                uploaded_files=uploaded_names,
            ),
            file=str(document.path),
            line=document.line(path_in_file),
            field=field,
            hint="Upload the file together with the problem, under the name that the problem states.",
        )


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        target.hardlink_to(source)
    except OSError:  # on another disk
        shutil.copyfile(source, target)


def tool_paths(problem: Problem) -> tuple[list[tuple[str, Mesh]], list[Issue]]:
    """Return the tool paths of pose tables, and issues of the tables.

    Args:
        problem: Problem.

    Returns:
        Pairs of a name and a mesh of thin bars, in the frame of the stock [m], and issues. Paths in the world
        are missing if the problem does not state the pose of the block.
    """
    bars: list[tuple[str, Mesh]] = []
    faults: list[Issue] = []
    for index, operation in enumerate(problem.operations):
        if operation.process != POSE_PROCESS:
            continue
        try:
            targets = registry.job(problem, index).targets()
        except TandemError as error:
            faults.extend(error.issues)
            continue
        stock = problem.setup_of(index).stock
        for arm in targets.arms:
            positions = targets.pose[arm][:, :3, 3]
            if targets.frame[arm] == "world":
                if stock.place is None:  # planning will find the pose of the block
                    continue
                positions = (positions - stock.place[:3, 3]) @ stock.place[:3, :3]
            size = max(float(np.ptp(positions, axis=0).max()), float(stock.size.max()))
            bars.append((f"{operation.name}, {arm}", path_bars(positions, BAR_WIDTH_FRACTION * size)))
    return bars, faults


def path_bars(positions: FloatArray, width: float) -> Mesh:
    """Return a tool path as a mesh of bars with a square section between successive positions.

    At most ``MAX_BARS`` bars are drawn. Equal successive positions give none.

    Args:
        positions: Positions (N, 3) [m].
        width: Width of the section [m].
    """
    sampled = positions[spread_rows(len(positions), MAX_BARS + 1)]
    start, steps = sampled[:-1], np.diff(sampled, axis=0)
    length = np.linalg.norm(steps, axis=1)
    start, steps, length = start[length > 0.0], steps[length > 0.0], length[length > 0.0]
    direction = steps / length[:, None]
    # The section is a square around the path: its corners are the sums of two perpendicular vectors.
    least_aligned = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    across = np.cross(direction, least_aligned)
    across *= 0.5 * width / np.linalg.norm(across, axis=1)[:, None]
    up = np.cross(direction, across)
    ring = np.stack([across + up, up - across, -across - up, across - up], axis=1)
    corners = np.concatenate([start[:, None] + ring, (start + steps)[:, None] + ring], axis=1)
    sides = [(i, (i + 1) % 4, 4 + i) for i in range(4)]
    sides += [((i + 1) % 4, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    caps = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    faces = np.array(sides + caps)[None] + 8 * np.arange(len(start))[:, None, None]
    return Mesh(corners.reshape(-1, 3), faces.reshape(-1, 3))


MAX_MESH_TRIANGLES: Final = 60_000
"""Maximum number of triangles of a drawn mesh. Finer meshes are simplified."""


def shapes(problem: Problem) -> tuple[list[dict[str, Any]], list[Issue]]:
    """Return the shapes to draw, in the frame of the stock [mm].

    Args:
        problem: Problem.

    Returns:
        Shapes with ``name``, ``kind`` (part, path, stock), ``vertices`` and ``faces``, both flat lists, and
        issues of pose tables.
    """
    named_meshes = list(part_meshes(problem.part))
    if problem.part is not None and problem.part.formed is not None:
        named_meshes.append(("formed sheet", problem.part.formed.mesh))
    bodies = [_body(name, "part", mesh) for name, mesh in named_meshes if len(mesh.faces)]
    tool_path_meshes, faults = tool_paths(problem)
    bodies += [_body(name, "path", mesh) for name, mesh in tool_path_meshes]
    bodies.append(_body("sheet" if problem.stock.sheet is not None else "block", "stock", _box_mesh(problem)))
    return bodies, faults


def _box_mesh(problem: Problem) -> Mesh:
    """Return the box of the stock [m] as twelve triangles."""
    low, high = problem.stock.lower, problem.stock.upper
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Mesh(low + corners * (high - low), np.array(faces, dtype=np.int64))


def _body(name: str, kind: str, mesh: Mesh) -> dict[str, Any]:
    """Convert a mesh [m] to a shape [mm]. Meshes of the part are simplified."""
    simplified = decimate(mesh, MAX_MESH_TRIANGLES) if kind == "part" else mesh
    vertices: FloatArray = np.round(simplified.vertices / MM, 3)
    return {
        "name": name,
        "kind": kind,
        "vertices": vertices.reshape(-1).tolist(),
        "faces": np.asarray(simplified.faces).reshape(-1).tolist(),
    }


TEXT_CHUNK_BYTES: Final = 1 << 22
"""Bytes of text that are read at a time, up to the end of a line."""
STL_HEADER_BYTES, STL_FACET_BYTES = 84, 50
"""Size [bytes] of the header of a binary STL file, and of each facet."""
PLY_TYPE_BYTES: Final = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Size [bytes] of a value of each type in a binary PLY file."""
MAX_PLY_HEADER_BYTES: Final = 1 << 16
"""Maximum size [bytes] of the header of a PLY file."""
MAX_GLB_JSON_BYTES: Final = 1 << 24
"""Maximum size [bytes] of the JSON of a GLB file that is parsed."""
MAX_UNPACKED_BYTES: Final = 400_000_000
"""Maximum size [bytes] of an unpacked 3MF file."""
_OBJ_FACE: Final = re.compile(rb"^[ \t]*f[ \t][^\r\n]*", re.MULTILINE)
"""A face in an OBJ file."""
_OBJ_VERTEX: Final = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
"""Beginning of a vertex in an OBJ file."""
_STL_FACET: Final = re.compile(rb"^[ \t]*facet\b", re.MULTILINE | re.IGNORECASE)
"""Beginning of a facet in an ASCII STL file."""


class MeshSize(NamedTuple):
    """Size of a mesh file. Polygons count as the triangles that they become."""

    facets: int
    vertices: int


def mesh_size(path: Path, suffix: str) -> MeshSize:
    """Count facets and vertices of an OBJ, STL, PLY, GLB or 3MF file.

    Zero for other and for invalid files.

    Args:
        path: Path of the file.
        suffix: Suffix of the name that the user gave.
    """
    file_suffix = suffix.lower()
    if file_suffix == ".obj":
        return _obj_size(path)
    if file_suffix == ".stl":
        return _stl_size(path)
    if file_suffix == ".glb":
        return _glb_size(path)
    if file_suffix == ".3mf":
        return _size_of_3mf(path)
    return _ply_size(path) if file_suffix == ".ply" else MeshSize(0, 0)


def _obj_size(path: Path) -> MeshSize:
    """Count in an OBJ file. A face with n corners becomes n - 2 triangles."""
    facets = vertices = 0
    for text in _text_chunks(path):
        vertices += len(_OBJ_VERTEX.findall(text))
        # A line has the word "f" before its corners.
        facets += sum(max(len(face.split()) - 3, 0) for face in _OBJ_FACE.findall(text))
    return MeshSize(facets, vertices)


def _stl_size(path: Path) -> MeshSize:
    """Count the facets of an STL file, each with three vertices.

    The file is binary if its length matches the count in its header. Otherwise it is text or broken.
    """
    with path.open("rb") as stream:
        head = stream.read(STL_HEADER_BYTES)
    facets = int.from_bytes(head[80:84], "little")
    if len(head) < STL_HEADER_BYTES or STL_HEADER_BYTES + STL_FACET_BYTES * facets != path.stat().st_size:
        facets = sum(len(_STL_FACET.findall(chunk)) for chunk in _text_chunks(path))
    return MeshSize(facets, 3 * facets)


def _glb_size(path: Path) -> MeshSize:
    """Return the numbers of facets and vertices in the JSON header of a GLB file, to refuse large meshes.

    Meshes with several instances count once. Both numbers are 0 if the header cannot be read. A primitive
    without indices has a corner for each vertex. Three corners are a triangle.
    """
    with path.open("rb") as stream:
        length = int.from_bytes(stream.read(16)[12:16], "little")
        text = stream.read(4 + min(length, MAX_GLB_JSON_BYTES))[4:]
    try:
        data = json.loads(text)
        counts = [int(primitive["count"]) for primitive in data["accessors"]]
        primitives = [primitive for mesh in data["meshes"] for primitive in mesh["primitives"]]
        vertex_counts = [counts[primitive["attributes"]["POSITION"]] for primitive in primitives]
        corner_counts = [
            counts[primitive["indices"]] if "indices" in primitive else vertex_count
            for primitive, vertex_count in zip(primitives, vertex_counts, strict=True)
        ]
    except (ValueError, TypeError, KeyError, IndexError):
        return MeshSize(0, 0)
    return MeshSize(sum(corner_counts) // 3, sum(vertex_counts))


def _size_of_3mf(path: Path) -> MeshSize:
    """Return the numbers of facets and vertices of a 3MF file, to refuse large meshes.

    The tags are counted while the file is unpacked. Both numbers are 0 if it cannot be unpacked. A file that
    unpacks to more than `MAX_UNPACKED_BYTES` counts as that many.
    """
    facets = vertices = 0
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > MAX_UNPACKED_BYTES:
                return MeshSize(MAX_UNPACKED_BYTES, MAX_UNPACKED_BYTES)
            for entry in entries:
                if entry.filename.lower().endswith(".model"):
                    with archive.open(entry) as stream:
                        tail = b""  # end of the previous chunk, which may contain the beginning of a tag
                        while chunk := stream.read(TEXT_CHUNK_BYTES):
                            facets += (tail + chunk).count(b"<triangle ") - tail.count(b"<triangle ")
                            vertices += (tail + chunk).count(b"<vertex ") - tail.count(b"<vertex ")
                            tail = chunk[-16:]
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError, zlib.error):
        return MeshSize(0, 0)
    return MeshSize(facets, vertices)


def _ply_size(path: Path) -> MeshSize:
    """Return the numbers of facets and vertices of a PLY file without reading its mesh, to refuse large ones.

    The header states the numbers of faces and vertices. Faces may be polygons, which count as several
    triangles. Their number follows from the number of corners if the faces come last in the file and have a
    single list. Otherwise each face of the header counts as one.
    """
    with path.open("rb") as stream:
        header, has_end, _ = stream.read(MAX_PLY_HEADER_BYTES).partition(b"end_header")
    if not has_end:
        return MeshSize(0, 0)
    elements = list(_ply_elements(header.decode("latin-1")))
    max_rows = path.stat().st_size  # a file cannot have more rows than bytes; the reader refuses such a count
    counts = {name: min(count, max_rows) for name, count, _ in elements}
    facets, vertices = counts.get("face", 0), counts.get("vertex", 0)
    other_elements, last_element = elements[:-1], elements[-1] if elements else ("", 0, [])
    list_properties = [prop for prop in last_element[2] if prop[0] == "list"]
    others_have_fixed_size = not any(
        prop[0] == "list" for _, _, property_types in other_elements for prop in property_types
    )
    if last_element[0] != "face" or len(list_properties) != 1 or not others_have_fixed_size:
        return MeshSize(facets, vertices)
    if b"ascii" in header:
        other_line_count = sum(count for _, count, _ in other_elements)
        corner_based_facets = (
            _corner_count(path, other_line_count) - 2 * facets
            if last_element[2][0] == list_properties[0]
            else 0
        )
    else:
        # The rest of the file holds the corners of all faces. A face with n corners becomes n - 2 triangles.
        other_bytes = sum(
            count * PLY_TYPE_BYTES.get(prop[0], 0)
            for _, count, property_types in other_elements
            for prop in property_types
        )
        scalar_bytes = sum(PLY_TYPE_BYTES.get(prop[0], 0) for prop in last_element[2] if prop[0] != "list")
        list_bytes = max_rows - len(header) - len(b"end_header\n") - other_bytes
        list_bytes -= facets * (scalar_bytes + PLY_TYPE_BYTES.get(list_properties[0][1], 1))
        corner_based_facets = list_bytes // PLY_TYPE_BYTES.get(list_properties[0][2], 4) - 2 * facets
    return MeshSize(max(facets, corner_based_facets), vertices)


def _corner_count(path: Path, skipped_lines: int) -> int:
    """Sum the corners of all faces of an ASCII PLY file.

    Each face starts with its number of corners.

    Args:
        path: Path of the file.
        skipped_lines: Number of lines after the header that describe other elements.
    """
    corners = 0
    with path.open("rb") as stream:
        for line in stream:
            if line.startswith(b"end_header"):
                break
        for number, line in enumerate(stream):
            if number >= skipped_lines:
                first_word = line.split(None, 1)[:1]
                corners += min(int(first_word[0]), len(line)) if first_word and first_word[0].isdigit() else 0
    return corners


def _ply_elements(head: str) -> Iterator[tuple[str, int, list[tuple[str, ...]]]]:
    """Yield name, count and property types of each PLY element.

    The type of a list is a tuple of ``list``, the type of its count, and the type of its items. Other types
    are tuples of one name.
    """
    name, count, property_types = "", 0, list[tuple[str, ...]]()
    for words in (line.split() for line in head.splitlines()):
        if words[:1] == ["element"] and len(words) == 3:
            if name:
                yield name, count, property_types
            name, count, property_types = words[1], int(words[2]) if words[2].isdecimal() else 0, []
        elif words[:1] == ["property"] and len(words) in (3, 5):
            property_types.append(tuple(words[1:4]) if words[1] == "list" else (words[1],))
    if name:
        yield name, count, property_types


def _text_chunks(path: Path) -> Iterator[bytes]:
    """Yield a file in parts that end with a line, with continued lines joined."""
    with path.open("rb") as stream:
        while chunk := stream.read(TEXT_CHUNK_BYTES):
            lines = [chunk, stream.readline()]
            while lines[-1] and (lines[-2] + lines[-1]).endswith(LINE_CONTINUATIONS):
                lines.append(stream.readline())
            text = b"".join(lines)
            for line_end in LINE_CONTINUATIONS:
                text = text.replace(line_end, b"")
            yield text


LINE_CONTINUATIONS: Final = (b"\\\r\n", b"\\\n")
"""Line ends of an OBJ file after which the line continues."""
ARCHIVE_MAGIC: Final = (
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
"""First bytes of zip, gzip, bzip2, xz, 7z, rar, zstd, lz4, ar and cab files.

The mark of tar is further on.
"""
TAR_MAGIC: Final = slice(257, 262)
"""Slice of the first bytes of a tar file that contains ``ustar``."""


def examine(
    folder: Path,
    problem: Path,
    uploads: Mapping[str, Path],
    max_facets: int,
    options: ReadingOptions = PROBLEM_ONLY,
    cache_folder: Path | None = None,
) -> ReadingResult:
    """Read an uploaded problem.

    Args:
        folder: Empty folder for this call.
        problem: Problem file.
        uploads: Stored files by the names that the user gave.
        max_facets: Maximum number of facets of a mesh. Three times as many vertices are allowed.
        options: What is computed, and which fields are replaced.
        cache_folder: Folder that caches targets and results computed from meshes, or None.

    Returns:
        Result, which contains only issues if the problem cannot be read.
    """
    cache = None if cache_folder is None else FileCache(cache_folder)
    faults = [*_archive_issues(uploads), *_large_mesh_issues(uploads, max_facets)]
    if faults:
        return ReadingResult(tuple(faults))
    with use_cache(cache):
        uploaded = LinkedUploads(folder, uploads)
        shutil.copyfile(problem, folder / PROBLEM_FILE)
        try:
            document = strict_yaml.read(folder / PROBLEM_FILE)
            field_issues = [*_replace_fields(document.data, options.fields or {})]
            document, faults = uploaded.inline_problem(document)
            faults = [*field_issues, *faults]
            if faults:
                return ReadingResult(uploaded.with_user_names([*faults, *_remaining_issues(document)]))
            problem_read = problem_file.build_problem(document, registry.readers())
        except TandemError as error:
            return ReadingResult(uploaded.with_user_names(error.issues))
        files = problem_file.bundle(problem_read)
        text = files.pop(PROBLEM_FILE).decode()
        issues = [*(problem_read.part.notes if problem_read.part is not None else ()), *problem_read.notes]
        looked_at: dict[str, Any] | None = None
        if options.reach:
            from planner import pipeline  # loads Drake

            make = (
                None
                if cache is None
                else target_cache.cached_targets_maker(
                    cache, problem_read, accept_equivalent=options.targets is not None
                )
            )
            check_result = pipeline.quick_check(problem_read, options.targets, make)
            issues += [issue for issue in check_result.issues if issue not in issues]
            if check_result.total:
                looked_at = {
                    "targets": check_result.checked,
                    "of": check_result.total,
                    "placed": check_result.is_placed,
                    "thinned": check_result.is_subsampled,
                }
        drawing: dict[str, Any] | None = None
        if options.cell is not None:
            try:
                drawing, faults = _draw_cell(problem_read, folder, cache, options.cell)
                issues += faults
            except TandemError as error:
                issues += error.issues
        drawn_shapes: list[dict[str, Any]] = []
        if options.draw:
            drawn_shapes, faults = shapes(problem_read)
            issues += [issue for issue in faults if issue not in issues]
        return ReadingResult(
            issues=uploaded.with_user_names(issues),
            name=problem_read.name,
            digest=problem_read.digest,
            processes=tuple(dict.fromkeys(operation.process for operation in problem_read.operations)),
            text=text,
            files={name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
            summary=_summary(problem_read),
            shapes=tuple(drawn_shapes),
            looked_at=looked_at,
            cell=drawing,
        )


def _draw_cell(
    problem: Problem, folder: Path, cache: FileCache | None, arguments: Mapping[str, Any]
) -> tuple[dict[str, Any], list[Issue]]:
    """Draw the cell of a problem.

    Args:
        problem: Problem.
        folder: Folder for the files of a plan.
        cache: Cache of targets, or None.
        arguments: ``operation``, ``max_samples``, ``freedom``, ``reach`` and, if a plan is drawn, ``plan``:
            pairs of the name and the path of each of its files.

    Returns:
        Fields of :class:`planner.service.cell_models.CellOut` as JSON data, and issues.

    Raises:
        TandemError: The operation does not exist, or the cell cannot be built.
    """
    count = len(problem.operations)
    if arguments["operation"] >= count:
        message = (
            f"operation: out of range (got {arguments['operation']}, allowed 0 to {count - 1} of {count})"
        )
        raise issue_error("service.request", message, field="operation")
    from planner.service import cell_drawing  # loads Drake

    make = (
        None if cache is None else target_cache.cached_targets_maker(cache, problem, accept_equivalent=True)
    )
    plan = None
    if files := arguments.get("plan"):
        for name, path in files:
            _link_or_copy(Path(path), folder / name)
        with contextlib.suppress(TandemError):  # written by another version
            plan = plans.load(folder)
    sampling = None
    if arguments["max_samples"] is not None:
        sampling = cell_drawing.TargetSampling(
            arguments["max_samples"], arguments["freedom"], arguments["reach"]
        )
    fields, faults = cell_drawing.view(problem, arguments["operation"], sampling, make, plan)
    for target in fields.get("targets", ()):
        target["faults"] = [issue.to_dict() for issue in target["faults"]]
    return fields, faults


def examine_element(
    folder: Path, element: Path, uploads: Mapping[str, Path], max_facets: int, fields: Mapping[str, Any]
) -> ReadingResult:
    """Read an uploaded element.

    Args:
        folder: Empty folder for this call.
        element: Element file.
        uploads: Stored files by the names that the user gave.
        max_facets: Maximum number of facets of a mesh.
        fields: New values by field path.

    Returns:
        Result whose ``summary`` contains the ``kind`` of its panels and the ``fields`` that may be changed.
    """
    faults = [*_archive_issues(uploads), *_large_mesh_issues(uploads, max_facets)]
    if faults:
        return ReadingResult(tuple(faults))
    uploaded = LinkedUploads(folder, uploads)
    shutil.copyfile(element, folder / ELEMENT_FILE)
    try:
        document = strict_yaml.read(folder / ELEMENT_FILE)
        faults = [*_replace_fields(document.data, fields)]
        document, missing_uploads = uploaded.inline_element(document)
        if faults or missing_uploads:
            return ReadingResult(uploaded.with_user_names([*faults, *missing_uploads]))
        text = strict_yaml.dump(document.data)
        (folder / ELEMENT_FILE).write_text(text, "utf-8")
        element_read = element_file.read_element(folder / ELEMENT_FILE)
    except TandemError as error:
        return ReadingResult(uploaded.with_user_names(error.issues))
    linked_files = {f"files/{path.name}": path.read_bytes() for path in sorted((folder / "files").iterdir())}
    files = {
        name: hashlib.sha256(content).hexdigest() for name, content in linked_files.items() if name in text
    }
    operations = [
        operation for template in element_read.templates for operation in template.data["operations"]
    ]
    process_names = [
        str(operation_data["process"])
        for operation_data in operations
        if isinstance(operation_data, dict) and "process" in operation_data
    ]
    return ReadingResult(
        issues=(),
        name=element_read.file.name,
        digest=hashlib.sha256(text.encode()).hexdigest(),
        processes=tuple(dict.fromkeys(process_names)),
        text=text,
        files=files,
        summary={"kind": element_read.file.panels.kind, "fields": _changeable_fields(element_read.file)},
    )


_FIELD_PATH: Final = re.compile(r"[A-Za-z0-9_.-]{1,200}")
"""Path of a field in a problem or an element."""


def _replace_fields(data: dict[str, Any], fields: Mapping[str, Any]) -> Iterator[Issue]:
    """Set fields by their paths. Yield an issue for each that cannot be set."""
    for field, value in fields.items():
        if not _FIELD_PATH.fullmatch(field):  # other characters could reorder or hide parts of the message
            message = f"fields: invalid path (got {field[:40]!a}). Give a field path, such as stock.size_mm."
            yield Issue("service.request", message, field="fields")
            continue
        try:
            strict_yaml.set_field(data, field, value, Path("/"))
        except ValueError as error:
            yield Issue("service.request", f"{field[:80]}: {error}", field=field[:80])


def _changeable_fields(spec: ElementFile) -> dict[str, Any]:
    """Return the fields of an element that may be changed, with their values.

    These are the fields that control the division, the thickness, and the sizes of blocks and raw blocks.
    """
    kind = spec.panels.kind
    panel_settings = getattr(spec.panels, kind)
    fields: dict[str, Any] = {}
    for name in DIVISION_FIELDS[kind]:
        value = getattr(panel_settings, name)
        if value is not None:
            fields[f"panels.{kind}.{name}"] = list(value) if isinstance(value, tuple) else value
    fields["thickness_mm"] = spec.thickness_mm
    for number, block in enumerate(spec.blocks):
        fields[f"blocks.{number}.size_mm"] = list(block.size_mm)
    for number, block in enumerate(spec.raw_blocks.sizes if spec.raw_blocks else ()):
        fields[f"raw_blocks.sizes.{number}.size_mm"] = list(block.size_mm)
    return fields


def examine_panels(folder: Path, files: Mapping[str, Path], panels: Sequence[str]) -> list[ReadingResult]:
    """Read panels and raw-block jobs of a divided element as self-contained problems.

    Their targets are computed when they are planned.

    Args:
        folder: Empty folder for this call.
        files: Files of the element's job by name.
        panels: Ids of panels and raw-block jobs.
    """
    for name, path in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        _link_or_copy(path, folder / name)
    results = []
    for panel in panels:
        path = next(path for item in PROBLEMS if (path := folder / item / f"{panel}.yaml").is_file())
        source = problem_file.resolve_files(strict_yaml.read(path).data, path.parent)
        stored = problem_file.pack_files(source)
        text = stored.pop(PROBLEM_FILE).decode()
        results.append(
            ReadingResult(
                issues=(),
                name=str(source["name"]),
                digest=problem_file.problem_digest(source),
                processes=tuple(dict.fromkeys(str(item["process"]) for item in source["operations"])),
                text=text,
                files={name: hashlib.sha256(content).hexdigest() for name, content in stored.items()},
            )
        )
    return results


def _remaining_issues(document: Document) -> list[Issue]:
    """Return the issues of a problem with missing uploads that are not caused by these."""
    try:
        problem_file.build_problem(document, registry.readers())
    except TandemError as error:
        return [issue for issue in error.issues if MISSING_FILE not in f"{issue.message} {issue.file}"]
    return []


def _archive_issues(uploads: Mapping[str, Path]) -> Iterator[Issue]:
    """Yield an issue for each upload that is an archive, which its first bytes show.

    3MF meshes, which are archives, are allowed.
    """
    for name, path in uploads.items():
        with path.open("rb") as stream:
            head = stream.read(512)
        if Path(base_name(name)).suffix.lower() == ".3mf" and zipfile.is_zipfile(path):
            continue  # a mesh, whose size :func:`_large_mesh_issues` checks
        if head.startswith(ARCHIVE_MAGIC) or head[TAR_MAGIC] == b"ustar":
            message = format_message("service.archive", file=name[:80])
            yield Issue("service.archive", message, file=name, field="files")


def _large_mesh_issues(uploads: Mapping[str, Path], max_facets: int) -> Iterator[Issue]:
    """Yield an issue for each mesh that is too large.

    Counting takes far less time and memory than reading.
    """
    for name, path in uploads.items():
        size = mesh_size(path, Path(base_name(name)).suffix)
        for quantity, count, limit in (
            ("facets", size.facets, max_facets),
            ("vertices", size.vertices, 3 * max_facets),
        ):
            if count > limit:
                message = (
                    f"{name[:80]!r}: too many {quantity} (got {count:,}, allowed {limit:,}). "
                    "Export it coarser, or simplify it."
                )
                yield Issue("service.too_large", message, file=name, field="files", value=count, limit=limit)


def _summary(problem: Problem) -> dict[str, Any]:
    """Summarise a problem. Boxes are lower and upper corners [mm] in the frame of the stock."""
    arms = [{"name": arm.name, "robot": arm.robot, "tool": arm.tool.name} for arm in problem.cell.arms]
    operations = [
        {"name": operation.name, "process": operation.process, "arms": list(operation.arms)}
        for operation in problem.operations
    ]
    summary: dict[str, Any] = {"arms": arms, "operations": operations, "stock_mm": _box(problem.stock.box)}
    part = problem.part
    if part is not None:
        formed = part.formed.mesh if part.formed is not None else None
        point_arrays = [mesh.vertices for mesh in (part.front, part.back, formed) if mesh is not None]
        point_arrays += [np.concatenate([ruled.start, ruled.end]) for ruled in part.ruled]
        all_points = np.concatenate(point_arrays) if point_arrays else np.zeros((0, 3))
        if len(all_points):
            summary["part_mm"] = _box(np.stack([all_points.min(axis=0), all_points.max(axis=0)]))
    return summary


def _box(corners: Any) -> list[list[float]]:
    return [[round(float(value) / MM, 3) for value in corner] for corner in corners]
