"""A cell whose second robot is to be aligned: which arm, which points count, and whether all can be so."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner import yaml_lines
from planner.align_points import ProbedPoints
from planner.catalogue import robot
from planner.issues import Issue, TandemError
from planner.problem import Arm, Cell
from planner.problem_file import read_cell
from planner.units import MM
from planner.yaml_lines import Document


def moved_arm(cell: Cell, wanted: str | None, file: str) -> int:
    """Index of the arm whose base is looked for: the second unless ``wanted`` names one. Raises `TandemError`
    (align.cell)."""
    names = [arm.name for arm in cell.arms]
    if len(names) != 2:
        what = f"the cell has {len(names)} arm, allowed 2: one robot alone needs no alignment"
        raise TandemError(Issue("align.cell", what, file=file, hint="take a cell of two robots"))
    if wanted is not None and wanted not in names:
        what = f"arm: got {wanted!r}, allowed {', '.join(names)}"
        raise TandemError(Issue("align.cell", what, file=file, hint="name an arm of the cell"))
    index = 1 if wanted is None else names.index(wanted)
    if cell.arms[1 - index].base_auto:
        what = f"the base of {names[1 - index]} is itself to be searched (base_auto)"
        hint = "state it, and align the other arm to it"
        field = f"arms.{1 - index}.base_auto"
        raise TandemError(Issue("align.cell", what, file=file, field=field, hint=hint))
    return index


def used_points(points: ProbedPoints, left_out: Sequence[str], file: str) -> NDArray[np.bool_]:
    """Which points (N,) count; raises `TandemError` (align.file) for names that no point has."""
    unknown = [name for name in left_out if name not in points.names]
    if unknown:
        what = f"to leave out: got {', '.join(unknown)}, allowed {', '.join(points.names)}"
        raise TandemError(Issue("align.file", what, file=file, hint="correct the name"))
    return np.array([name not in left_out for name in points.names], dtype=bool)


def require_reach(cell: Cell, order: tuple[int, int], points: ProbedPoints, file: str) -> None:
    """Raise `TandemError` (align.units) for points that no TCP of the arm can come to: they are in another
    unit or frame. ``order``: indices of the arms that probed first and second."""
    issues = []
    for k, where in zip(order, (points.first, points.second), strict=True):
        arm = cell.arms[k]
        data = robot(arm.robot)
        most = (
            data.reach + float(np.linalg.norm(arm.tool.tcp[:3, 3])) + 1.0
        )  # the base lies below the shoulder
        far = np.linalg.norm(where, axis=1)
        issues += [
            _too_far(cell.arms[k], data.title, points.names[i], far[i], most, file)
            for i in np.flatnonzero(far > most).tolist()
        ]
    if issues:
        raise TandemError(issues)


def require_readable(text: str, output: Path, document: Document) -> None:
    """Raise `TandemError` (align.cell) if the new cell cannot be read where it is to be: files that it names
    are looked for from there."""
    if output.resolve().parent == document.path.resolve().parent:
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "cell.yaml"
        copy.write_text(text, encoding="utf-8")
        new = yaml_lines.read(copy)
    new.path = output
    try:
        read_cell(new)
    except TandemError as error:
        what = f"the cell cannot be read at {output}: {error.issues[0].message}"
        hint = "write it beside the old one, so that the files it names are found"
        raise TandemError(Issue("align.cell", what, file=str(output), hint=hint)) from error


def _too_far(arm: Arm, title: str, point: str, got: float, most: float, file: str) -> Issue:
    return Issue(
        "align.units",
        f"point {point!r} is {got / MM:.0f} mm from the base of {arm.name}, allowed up to "
        f"{most / MM:.0f} mm, where {title} with its tool comes",
        file=file,
        arm=arm.name,
        target=point,
        value=got / MM,
        limit=most / MM,
        unit="mm",
        hint="give mm in the robot's own base, not in the world or a work object",
    )
