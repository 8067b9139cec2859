"""Input and output of an alignment.

The input is the probed points of both robots and the arm that moves, the output the cell file with the new
base. Points are in each robot's own base. In the cell file only the numbers change; comments and layout are
kept.
"""

import copy
import csv
import dataclasses
import math
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import BoolArray, FloatArray, to_rpy
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Arm, Cell
from planner.reading import strict_yaml
from planner.reading.problem import read_cell
from planner.reading.strict_yaml import Document

MAX_BYTES: Final = 1_000_000
"""Maximum size [bytes] of a file of probed points."""
MAX_COORDINATE_MM: Final = 100_000.0
"""Largest accepted coordinate [mm]."""
AXES: Final = ("x_mm", "y_mm", "z_mm")
"""Suffixes of the columns of a point."""


@dataclasses.dataclass(frozen=True, eq=False)
class ProbedPoints:
    """N probed points.

    Attributes:
        names: Names of the points.
        first: (N, 3) [m] TCP of the first robot, in its base.
        second: (N, 3) [m] TCP of the second robot, in its base.
    """

    names: tuple[str, ...]
    first: FloatArray
    second: FloatArray


def read(path: Path, arms: tuple[str, str]) -> ProbedPoints:
    """Read probed points from a CSV file with the columns name, and <arm>.x_mm, .y_mm and .z_mm of both arms.

    Separators are commas, or semicolons with decimal commas. Lines that begin with # and a column note are
    ignored.

    Raises:
        TandemError: align.file, with every fault and its line.
    """
    file = str(path)
    rows = _rows(path)
    columns = ["name"] + [f"{arm}.{axis}" for arm in arms for axis in AXES]
    issues = (
        _headings(file, rows[0], columns) if rows else [_fault(file, None, None, "has no lines", "write it")]
    )
    if issues:
        raise TandemError(issues)
    places = [rows[0][1].index(column) for column in columns]
    names: list[str] = []
    values = []
    for line, cells in rows[1:]:
        if len(cells) != len(rows[0][1]):
            what = f"got {len(cells)} values, allowed {len(rows[0][1])} as in the headings"
            issues.append(_fault(file, line, None, what, "correct the row"))
            continue
        name, *texts = (cells[k] for k in places)
        if not name or name in names:
            what = f"got the name {name!r} again" if name else "got no name"
            issues.append(
                _fault(file, line, "name", f"{what}, allowed a unique name for each point", "name it")
            )
        names.append(name)
        values.append([_number(text) for text in texts])
        for column, text, value in zip(columns[1:], texts, values[-1], strict=True):
            if not abs(value) <= MAX_COORDINATE_MM:
                what = (
                    f"got {text!r}, allowed a number from {-MAX_COORDINATE_MM:g} to {MAX_COORDINATE_MM:g} mm"
                )
                issues.append(_fault(file, line, column, what, "correct it, or leave the point out"))
    if issues:
        raise TandemError(issues)
    points = np.array(values, dtype=np.float64).reshape(-1, 6) * MM
    return ProbedPoints(tuple(names), points[:, :3], points[:, 3:])


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Lines with their cells, the headings first."""
    file = str(path)
    if not is_file(path):
        raise TandemError(_fault(file, None, None, f"{file}: {missing_file_reason(path)}", "check the path"))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise TandemError(_fault(file, None, None, f"larger than {MAX_BYTES / 1e6:g} MB", "cut it down"))
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TandemError(
            _fault(file, None, None, f"cannot be read as text: {error}", "save it as CSV, UTF-8")
        ) from error
    lines = [(k, x) for k, x in enumerate(text.splitlines(), 1) if x.strip(" ,;\t") and not x.startswith("#")]
    semicolons = bool(lines) and ";" in lines[0][1]
    out: list[tuple[int, list[str]]] = []
    for line, raw in lines:
        try:
            cells = next(csv.reader([raw], delimiter=";" if semicolons else ","))
        except csv.Error as error:
            raise TandemError(_fault(file, line, None, f"is not CSV: {error}", "correct the row")) from error
        cells = [cell.strip() for cell in cells]
        if semicolons and out:
            cells = [cells[0], *(cell.replace(",", ".") for cell in cells[1:])]
        out.append((line, cells))
    return out


def _headings(file: str, heading: tuple[int, list[str]], columns: list[str]) -> list[Issue]:
    line, header = heading
    issues = []
    for column in columns:
        if header.count(column) != 1:
            what = f"got the column {column!r} {header.count(column)} times, allowed once"
            issues.append(_fault(file, line, column, what, f"the columns are {', '.join(columns)}"))
    for column in header:
        if column not in (*columns, "note"):
            what = f"column: got {column!r}, allowed {', '.join(columns)} and note"
            issues.append(_fault(file, line, column, what, "remove it or correct its spelling"))
    return issues


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _fault(file: str, line: int | None, field: str | None, what: str, hint: str) -> Issue:
    return Issue("align.file", what, file=file, line=line, field=field, hint=hint)


def moved_arm(cell: Cell, arm_name: str | None, file: str) -> int:
    """Index of the arm whose base is searched: the second one unless ``arm_name`` is given.

    Raises:
        TandemError: align.cell.
    """
    names = [arm.name for arm in cell.arms]
    if len(names) != 2:
        what = f"the cell has {len(names)} arm, allowed 2: a single robot needs no alignment"
        raise issue_error("align.cell", what, file=file, hint="take a cell of two robots")
    if arm_name is not None and arm_name not in names:
        what = f"arm: got {arm_name!r}, allowed {', '.join(names)}"
        raise issue_error("align.cell", what, file=file, hint="name an arm of the cell")
    index = 1 if arm_name is None else names.index(arm_name)
    if cell.arms[1 - index].base_auto:
        what = f"the base of {names[1 - index]} is to be searched as well (base_auto)"
        hint = "state it, and align the other arm to it"
        field = f"arms.{1 - index}.base_auto"
        raise issue_error("align.cell", what, file=file, field=field, hint=hint)
    return index


def used_points(points: ProbedPoints, left_out: Sequence[str], file: str) -> BoolArray:
    """Which points (N,) are used.

    Raises:
        TandemError: align.file for unknown names.
    """
    unknown = [name for name in left_out if name not in points.names]
    if unknown:
        what = f"to leave out: got {', '.join(unknown)}, allowed {', '.join(points.names)}"
        raise issue_error("align.file", what, file=file, hint="correct the name")
    return np.array([name not in left_out for name in points.names], dtype=bool)


def require_reach(cell: Cell, order: tuple[int, int], points: ProbedPoints, file: str) -> None:
    """Require that each TCP can reach its points; otherwise they are in another unit or frame.

    Args:
        cell: Cell with both arms.
        order: Indices of the arms that probed first and second.
        points: Probed points.
        file: Name of their file.

    Raises:
        TandemError: align.units.
    """
    issues = []
    for k, where in zip(order, (points.first, points.second), strict=True):
        arm = cell.arms[k]
        data = arm.data
        max_distance = (
            data.reach + float(np.linalg.norm(arm.tool.tcp[:3, 3])) + 1.0
        )  # the base lies below the shoulder
        is_too_far = np.linalg.norm(where, axis=1)
        issues += [
            _too_far(cell.arms[k], data.title, points.names[i], is_too_far[i], max_distance, file)
            for i in np.flatnonzero(is_too_far > max_distance).tolist()
        ]
    if issues:
        raise TandemError(issues)


def require_readable(text: str, output: Path, document: Document) -> None:
    """Require that the new cell can be read at its output path, from which the files that it names are found.

    Raises:
        TandemError: align.cell.
    """
    if output.resolve().parent == document.path.resolve().parent:
        return
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "cell.yaml"
        copy.write_text(text, encoding="utf-8")
        new = strict_yaml.read(copy)
    new.path = output
    try:
        read_cell(new)
    except TandemError as error:
        what = f"the cell cannot be read at {output}: {error.issues[0].message}"
        hint = "write it to the folder of the old one, so that the files it names are found"
        raise issue_error("align.cell", what, file=str(output), hint=hint) from error


def _too_far(arm: Arm, title: str, point: str, got: float, max_distance: float, file: str) -> Issue:
    return Issue(
        "align.units",
        f"point {point!r} is {got / MM:.0f} mm from the base of {arm.name}, allowed up to "
        f"{max_distance / MM:.0f} mm, the reach of {title} with its tool",
        file=file,
        arm=arm.name,
        target=point,
        value=got / MM,
        limit=max_distance / MM,
        unit="mm",
        hint="give mm in the robot's own base, not in the world or a work object",
    )


Change = tuple[int, int, str]
"""Start and end of a replaced text, and its replacement."""
POSE_KEYS: Final = ("xyz_mm", "rpy_deg")
"""Keys of a base in a cell file: position and attitude."""


def rounded(base: FloatArray) -> tuple[list[float], list[float]]:
    """Position [mm] to 0.1 um and roll, pitch, yaw [deg] to 1e-6 deg of a pose (4, 4), as in files."""
    xyz = [round(float(v), 4) + 0.0 for v in base[:3, 3] / MM]
    rpy = [round(float(v), 6) + 0.0 for v in to_rpy(base[:3, :3]) / DEG]
    return xyz, rpy


def with_base(document: Document, index: int, base: FloatArray) -> str:
    """Text of a cell file in which an arm has a new base, which is no longer searched.

    Args:
        document: Cell file.
        index: Index of the arm.
        base: (4, 4) new base.

    Raises:
        TandemError: align.cell if the layout of the file does not allow it, for example with an alias.
    """
    text = document.text.decode("utf-8-sig")
    original: Any = yaml.safe_load(text)
    values = dict(zip(POSE_KEYS, rounded(base), strict=True))
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if root is None:
        raise ValueError("an empty file is not a cell")
    try:
        changes = _changes(root, index, values)
        for start, end, new in sorted(changes, reverse=True):
            text = text[:start] + new + text[end:]
        got: Any = yaml.safe_load(text)
    except (yaml.YAMLError, LookupError) as error:
        raise _refuse(document, index, str(error)) from error
    if _plain(got) != _plain(_expected_data(original, index, values)):
        raise _refuse(document, index, "a part of it is an alias or merge key")
    return text


def _expected_data(data: Any, index: int, values: dict[str, list[float]]) -> Any:
    expected = copy.deepcopy(data)
    arm = dict(expected["arms"][index])
    arm["base"] = dict(values)
    if arm.get("base_auto"):
        arm["base_auto"] = False
    expected["arms"] = [*expected["arms"][:index], arm, *expected["arms"][index + 1 :]]
    return expected


def _changes(root: yaml.Node, index: int, values: dict[str, list[float]]) -> list[Change]:
    arm = _get(root, "arms").value[index]
    changes = []
    searched = _find(arm, "base_auto")
    if searched is not None and searched.value.lower() in ("true", "yes", "on"):
        changes.append(_put(searched, "false"))
    base = _find(arm, "base")
    whole = ", ".join(f"{key}: {_listed(values[key])}" for key in POSE_KEYS)
    if base is None:
        return [*changes, _insert(arm, f"base: {{{whole}}}")]
    if not isinstance(base, yaml.MappingNode) or not base.value:
        return [*changes, _put(base, f"{{{whole}}}")]
    for key in POSE_KEYS:
        node = _find(base, key)
        if node is None:
            changes.append(_insert(base, f"{key}: {_listed(values[key])}"))
        elif isinstance(node, yaml.SequenceNode) and len(node.value) == 3:
            pairs = zip(node.value, values[key], strict=True)
            changes += [_put(item, f"{number:.10g}") for item, number in pairs]
        else:
            raise LookupError(f"{key} is not a list of three numbers")
    return changes


def _insert(mapping: yaml.MappingNode, entry: str) -> Change:
    """Insert an entry before the first one of a mapping, in its layout."""
    mark = mapping.value[0][0].start_mark
    gap = ", " if mapping.flow_style else "\n" + " " * mark.column
    return mark.index, mark.index, entry + gap


def _put(node: yaml.Node, new: str) -> Change:
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        raise LookupError("its layout is unexpected")
    lead = " " if node.start_mark.index == node.end_mark.index else ""  # a key without a value
    return node.start_mark.index, node.end_mark.index, lead + new


def _get(mapping: yaml.Node, key: str) -> Any:
    value = _find(mapping, key)
    if value is None:
        raise LookupError(f"{key} is defined elsewhere")
    return value


def _find(mapping: yaml.Node, key: str) -> Any:
    return next((value for name, value in mapping.value if name.value == key), None)


def _listed(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.10g}" for value in values) + "]"


def _plain(data: Any) -> Any:
    """Numbers as floats and tuples as lists, so that only values are compared."""
    if isinstance(data, dict):
        return {key: _plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_plain(value) for value in data]
    if isinstance(data, int | float) and not isinstance(data, bool):
        return float(data)
    return data


def _refuse(document: Document, index: int, why: str) -> TandemError:
    return issue_error(
        "align.cell",
        f"the base of arm {index + 1} cannot be rewritten in place: {why}",
        file=str(document.path),
        line=document.line(("arms", index, "base")),
        field=f"arms.{index}.base",
        hint="write it out, as base: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}",
    )
