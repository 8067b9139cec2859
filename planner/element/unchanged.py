"""Detection of an unchanged element: whether a folder already holds the division of this element.

The output follows from the element file, all files that it names, and the versions of the packages that
divide it. Surfaces that are meshes, and ruled walls, may move by tiny amounts: exports of one model differ in
their last decimals, and a new division from them would plan every panel again.
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
"""Maximum displacement [m] of the points of an unchanged surface."""
PROBLEMS: Final = ("panels", "blocks", "again")
"""Folders of problems and their meshes in the folder of an element."""


def made_from(element: Element, file: Path, files: Mapping[str, str | bytes]) -> bytes:
    """Return the content of `MADE_FROM_FILE` for an element read from ``file`` whose folder has ``files``."""
    key, points = _input_key(element, file)
    stream = io.BytesIO()
    np.savez(stream, key=np.array(key), problems=np.array(_content_hash(_problems(files))), points=points)
    return stream.getvalue()


def is_unchanged(folder: Path, element: Element, file: Path) -> bool:
    """Whether ``folder`` is complete and was made from this element, read from ``file``.

    Problems in it that were changed since count as missing.
    """
    if not is_file(folder / MADE_FROM_FILE) or not is_file(folder / "element.json"):
        return False
    try:
        with np.load(folder / MADE_FROM_FILE, allow_pickle=False) as known:
            known_hashes = str(known["key"]), str(known["problems"])
            points = np.asarray(known["points"], dtype=np.float64)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return False
    key, now = _input_key(element, file)
    return (
        known_hashes == (key, _content_hash(problems_in(folder)))
        and points.shape == now.shape
        and float(np.abs(points - now).max(initial=0.0)) <= POINT_TOLERANCE_M
    )


def problems_in(folder: Path) -> dict[str, bytes]:
    """Return the contents of the problems of an element's folder and their meshes, by name."""
    paths = [path for subfolder in PROBLEMS for path in (folder / subfolder).rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def count_unchanged(previous: Mapping[str, bytes], files: Mapping[str, str | bytes]) -> tuple[int, int]:
    """Return how many problems among ``files`` are unchanged, with their meshes, and their total."""
    problems = _problems(files)
    names = [name for name in problems if name.endswith(".yaml")]
    changed = {Path(name).stem for name, content in problems.items() if previous.get(name) != content}

    def same(name: str) -> bool:
        stem = Path(name).stem
        return not {stem, f"{stem}_front", f"{stem}_back"} & changed

    return sum(map(same, names)), len(names)


def _problems(files: Mapping[str, str | bytes]) -> dict[str, bytes]:
    selected = {name: content for name, content in files.items() if Path(name).parts[0] in PROBLEMS}
    return {name: data.encode() if isinstance(data, str) else data for name, data in selected.items()}


def _content_hash(files: Mapping[str, bytes]) -> str:
    rows = [f"{name} {hashlib.sha256(files[name]).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def _input_key(element: Element, file: Path) -> tuple[str, FloatArray]:
    """Return the SHA-256 over all but the surface points, and these (N, 3) [m] in the file frame."""
    spec = element.file.model_dump(mode="json")
    faces, points = np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3))
    mesh = spec["surface"]["mesh"] is not None
    if isinstance(element, ElasticElement) and mesh:
        faces = element.surface.front.faces
        points = transform(element.surface.pose, element.surface.front.vertices)
    elif isinstance(element, HexagonElement) and mesh:
        faces, points = element.surface.faces, element.surface.vertices
    elif isinstance(element, StripsElement) and mesh:
        faces, points = element.patch.mesh.faces, element.patch.mesh.vertices
    elif isinstance(element, WallElement):
        spec["surface"]["ruled"], points = None, element.wall.ends.reshape(-1, 3)
    if mesh:
        spec["surface"]["mesh"] = None
    whole: dict[str, Any] = {
        **resolve_files(spec, file.parent),
        "templates": [dataclasses.asdict(item)["data"] for item in element.templates],
        "saw": None if element.saw is None else element.saw.data,
        "left_over": [dataclasses.asdict(item) for item in element.stock],
        "faces": hashlib.sha256(np.ascontiguousarray(faces, dtype=np.int64).tobytes()).hexdigest(),
        "versions": {"tandem": __version__, **versions()},
    }
    return problem_digest(whole), np.asarray(points, dtype=np.float64)
