"""Detection of an unchanged element: whether a folder already holds the division of this element.

The output follows from the element file, all files that it names, and the versions of the packages that
divide it. Points of meshes and ruled walls may differ by tiny amounts, because exports of one model differ in
their last decimals. Otherwise every panel would be planned again.
"""

import dataclasses
import hashlib
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner.element.element_file import ElasticElement, Element, HexagonElement, StripsElement, WallElement
from planner.files import is_file, versions
from planner.geometry.arrays import FloatArray, transform
from planner.reading.problem import problem_digest, resolve_files
from planner.runtime.version import __version__

MADE_FROM_FILE: Final = "made_from.npz"
"""File that states what the folder of an element was made from."""
POINT_TOLERANCE_M: Final = 1e-8
"""Maximum displacement [m] of points of a surface that counts as unchanged."""
PROBLEMS: Final = ("panels", "blocks", "again")
"""Subfolders of an element's folder that contain problems and their meshes."""


def made_from(element: Element, file: Path, files: Mapping[str, str | bytes]) -> bytes:
    """Return the content of `MADE_FROM_FILE` for an element read from ``file``, with output ``files``."""
    key, points = _input_key(element, file)
    stream = io.BytesIO()
    np.savez(stream, key=np.array(key), problems=np.array(_content_hash(_problems(files))), points=points)
    return stream.getvalue()


def is_unchanged(folder: Path, element: Element, file: Path) -> bool:
    """Whether ``folder`` is complete and was made from this element, which was read from ``file``.

    It is not if a problem in it was changed, removed or added since.
    """
    if not is_file(folder / MADE_FROM_FILE) or not is_file(folder / "element.json"):
        return False
    try:
        with np.load(folder / MADE_FROM_FILE, allow_pickle=False) as stored:
            stored_hashes = str(stored["key"]), str(stored["problems"])
            stored_points = np.asarray(stored["points"], dtype=np.float64)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return False
    key, points_now = _input_key(element, file)
    return (
        stored_hashes == (key, _content_hash(problems_in(folder)))
        and stored_points.shape == points_now.shape
        and float(np.abs(stored_points - points_now).max(initial=0.0)) <= POINT_TOLERANCE_M
    )


def problems_in(folder: Path) -> dict[str, bytes]:
    """Return the contents of the problems in an element's folder and of their meshes, by relative path."""
    paths = [path for subfolder in PROBLEMS for path in (folder / subfolder).rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def count_unchanged(previous: Mapping[str, bytes], files: Mapping[str, str | bytes]) -> tuple[int, int]:
    """Return how many problems of ``files``, with their meshes, are as ``previous``, and how many exist."""
    problems = _problems(files)
    names = [name for name in problems if name.endswith(".yaml")]
    changed = {Path(name).stem for name, content in problems.items() if previous.get(name) != content}

    def is_same(name: str) -> bool:
        stem = Path(name).stem
        return not {stem, f"{stem}_front", f"{stem}_back"} & changed

    return sum(map(is_same, names)), len(names)


def _problems(files: Mapping[str, str | bytes]) -> dict[str, bytes]:
    """Return the contents of those files that are problems or their meshes."""
    selected = {name: content for name, content in files.items() if Path(name).parts[0] in PROBLEMS}
    return {name: data.encode() if isinstance(data, str) else data for name, data in selected.items()}


def _content_hash(files: Mapping[str, bytes]) -> str:
    """Return a SHA-256 over names and contents of files, in the order of names."""
    rows = [f"{name} {hashlib.sha256(files[name]).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def _input_key(element: Element, file: Path) -> tuple[str, FloatArray]:
    """Return a SHA-256 over all input but the points of the surface, and these points (N, 3) [m].

    Points are in the file frame. There are none if they are not compared with a tolerance.
    """
    spec = element.file.model_dump(mode="json")
    faces, points = np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3))
    is_mesh = spec["surface"]["mesh"] is not None
    if isinstance(element, ElasticElement) and is_mesh:
        faces = element.surface.front.faces
        points = transform(element.surface.pose, element.surface.front.vertices)
    elif isinstance(element, HexagonElement) and is_mesh:
        faces, points = element.surface.faces, element.surface.vertices
    elif isinstance(element, StripsElement) and is_mesh:
        faces, points = element.patch.mesh.faces, element.patch.mesh.vertices
    elif isinstance(element, WallElement):
        spec["surface"]["ruled"] = None
        points = element.wall.ends.reshape(-1, 3)
    if is_mesh:
        spec["surface"]["mesh"] = None
    inputs: dict[str, Any] = {
        **resolve_files(spec, file.parent),
        "templates": [dataclasses.asdict(item)["data"] for item in element.templates],
        "saw": None if element.saw is None else element.saw.data,
        "left_over": [dataclasses.asdict(item) for item in element.stock],
        "faces": hashlib.sha256(np.ascontiguousarray(faces, dtype=np.int64).tobytes()).hexdigest(),
        "versions": {"tandem": __version__, **versions()},
    }
    return problem_digest(inputs), np.asarray(points, dtype=np.float64)
