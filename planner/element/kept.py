"""Whether a folder holds the very element that is to be divided, so that it may stay as it is.

What is written of an element follows from its file, all that this names, and the versions of what divides it.
Surfaces that are meshes, and ruled walls, may have moved by next to nothing: exports of one model differ in
their last decimals, and a division that is made anew from them would plan every panel anew.
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
from planner.reading.problem import digest, resolved
from planner.runtime.version import __version__

FILE: Final = "made_from.npz"
"""What the folder of an element was made from."""
SAME: Final = 1e-8
"""A surface whose points have moved by no more than this [m] is the same."""
PROBLEMS: Final = ("panels", "blocks", "again")
"""Folders of problems and their meshes in that of an element."""


def made_from(element: Element, file: Path, files: Mapping[str, str | bytes]) -> bytes:
    """`FILE` for an element read from ``file`` whose folder has ``files``."""
    key, points = _input(element, file)
    stream = io.BytesIO()
    np.savez(stream, key=np.array(key), problems=np.array(_content(_problems(files))), points=points)
    return stream.getvalue()


def holds(folder: Path, element: Element, file: Path) -> bool:
    """Whether ``folder`` is whole and was made from this element, read from ``file``; problems in it that
    were changed since count as missing."""
    if not is_file(folder / FILE) or not is_file(folder / "element.json"):
        return False
    try:
        with np.load(folder / FILE, allow_pickle=False) as known:
            before = str(known["key"]), str(known["problems"])
            points = np.asarray(known["points"], dtype=np.float64)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return False
    key, now = _input(element, file)
    return (
        before == (key, _content(problems_in(folder)))
        and points.shape == now.shape
        and float(np.abs(points - now).max(initial=0.0)) <= SAME
    )


def problems_in(folder: Path) -> dict[str, bytes]:
    """Contents of the problems of an element's folder and their meshes, by name."""
    paths = [path for own in PROBLEMS for path in (folder / own).rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def stayed(before: Mapping[str, bytes], files: Mapping[str, str | bytes]) -> tuple[int, int]:
    """How many problems among ``files`` are as ``before``, with all meshes of the same name, and how many
    there are."""
    problems = _problems(files)
    names = [name for name in problems if name.endswith(".yaml")]
    changed = {Path(name).stem for name, content in problems.items() if before.get(name) != content}

    def same(name: str) -> bool:
        stem = Path(name).stem
        return not {stem, f"{stem}_front", f"{stem}_back"} & changed

    return sum(map(same, names)), len(names)


def _problems(files: Mapping[str, str | bytes]) -> dict[str, bytes]:
    own = {name: content for name, content in files.items() if Path(name).parts[0] in PROBLEMS}
    return {name: one.encode() if isinstance(one, str) else one for name, one in own.items()}


def _content(files: Mapping[str, bytes]) -> str:
    rows = [f"{name} {hashlib.sha256(files[name]).hexdigest()}" for name in sorted(files)]
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def _input(element: Element, file: Path) -> tuple[str, FloatArray]:
    """SHA-256 over all but the surface's points, and these (N, 3) [m] in the frame of the file."""
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
        **resolved(spec, file.parent),
        "templates": [dataclasses.asdict(one)["data"] for one in element.templates],
        "saw": None if element.saw is None else element.saw.data,
        "left_over": [dataclasses.asdict(one) for one in element.stock],
        "faces": hashlib.sha256(np.ascontiguousarray(faces, dtype=np.int64).tobytes()).hexdigest(),
        "versions": {"tandem": __version__, **versions()},
    }
    return digest(whole), np.asarray(points, dtype=np.float64)
