"""Reads an uploaded problem, and tests its reach if asked: what it is called, what stands in its way, and the
problem as it stands alone.

This runs in a process of its own (:mod:`planner.service.examiner`), because what people upload may be
hostile.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner import problem_bundle, problem_file, processes, yaml_lines
from planner.issues import Issue, TandemError
from planner.problem import Problem
from planner.service.examined import Examined
from planner.service.mesh_size import mesh_size
from planner.service.page.shapes import shapes
from planner.service.uploaded import NOWHERE, Uploaded, last
from planner.units import MM
from planner.yaml_lines import Document

PROBLEM: Final = "problem.yaml"
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
TAR: Final = slice(257, 262)


def examine(
    folder: Path,
    problem: Path,
    uploads: Mapping[str, Path],
    facets: int,
    reach: bool = False,
    draw: bool = False,
) -> Examined:
    """Read the problem in the file ``problem``; ``uploads`` {name that the user gave: stored file}.

    ``folder`` is an empty one for this call alone. A mesh has at most ``facets``, three vertices for each.
    With ``reach`` the targets are made and reach is tested, with ``draw`` there are ``shapes`` for the page.
    """
    faults = [*_archives(uploads), *_large_meshes(uploads, facets)]
    if faults:
        return Examined(tuple(faults))
    uploaded = Uploaded(folder, uploads)
    shutil.copyfile(problem, folder / PROBLEM)
    try:
        document, faults = uploaded.inside(yaml_lines.read(folder / PROBLEM))
        if faults:
            return Examined(uploaded.told([*faults, *_other_faults(document)]))
        read = problem_file.build(document, processes.schemas())
    except TandemError as error:
        return Examined(uploaded.told(error.issues))
    files = problem_bundle.bundle(read)
    text = files.pop(PROBLEM).decode()
    found = [*(read.part.notes if read.part is not None else ()), *read.notes]
    if reach:
        from planner import pipeline  # loads Drake

        found += [issue for issue in pipeline.check(read) if issue not in found]
    drawn: list[dict[str, Any]] = []
    if draw:
        drawn, faults = shapes(read)
        found += [issue for issue in faults if issue not in found]
    return Examined(
        issues=uploaded.told(found),
        name=read.name,
        digest=read.digest,
        processes=tuple(dict.fromkeys(operation.process for operation in read.operations)),
        text=text,
        files={name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
        summary=_summary(read),
        shapes=tuple(drawn),
    )


def _other_faults(document: Document) -> list[Issue]:
    """What else is wrong where files are missing."""
    try:
        problem_file.build(document, processes.schemas())
    except TandemError as error:
        return [issue for issue in error.issues if NOWHERE not in f"{issue.message} {issue.file}"]
    return []


def _archives(uploads: Mapping[str, Path]) -> Iterator[Issue]:
    for name, path in uploads.items():
        with path.open("rb") as stream:
            head = stream.read(512)
        if head.startswith(ARCHIVES) or head[TAR] == b"ustar":
            message = f"{name[:80]!r} is an archive or compressed; unpack it and upload the files themselves"
            yield Issue("service.archive", message, file=name, field="files")


def _large_meshes(uploads: Mapping[str, Path], most: int) -> Iterator[Issue]:
    """Meshes are counted before they are read, which takes far more time and memory."""
    for name, path in uploads.items():
        size = mesh_size(path, Path(last(name)).suffix)
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
