"""Input and output of an alignment.

The input is the probed points of both robots, and which arm gets a new base. The output is the cell file with
that base. Points are in each robot's own base. In the cell file only the numbers change; comments and layout
are kept.
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
"""Suffixes of the columns with the coordinates of a point, after the name of the arm."""


@dataclasses.dataclass(frozen=True, eq=False)
class ProbedPoints:
    """N probed points.

    Attributes:
        names: Names of the points.
        first: Positions (N, 3) [m] of the TCP of the first robot, in its base frame.
        second: Positions (N, 3) [m] of the TCP of the second robot, in its base frame.
    """

    names: tuple[str, ...]
    first: FloatArray
    second: FloatArray


def read(path: Path, arms: tuple[str, str]) -> ProbedPoints:
    """Read probed points from a CSV file with the columns name, and <arm>.x_mm, .y_mm and .z_mm of both arms.

    Separators are commas, or semicolons with decimal commas. Lines that begin with # and a column ``note``
    are ignored. ``arms`` are the names of the first and the second arm.

    Raises:
        TandemError: ``align.file`` for each fault, with its line.
    """
    file = str(path)
    rows = _rows(path)
    columns = ["name"] + [f"{arm}.{axis}" for arm in arms for axis in AXES]
    issues = (
        _headings(file, rows[0], columns) if rows else [_fault(file, None, None, "has no lines", "write it")]
    )
    if issues:
        raise TandemError(issues)
    column_indices = [rows[0][1].index(column) for column in columns]
    names: list[str] = []
    values = []
    for line, cells in rows[1:]:
        if len(cells) != len(rows[0][1]):
            message = f"got {len(cells)} values, allowed {len(rows[0][1])} as in the headings"
            issues.append(_fault(file, line, None, message, "correct the row"))
            continue
        name, *texts = (cells[k] for k in column_indices)
        if not name or name in names:
            message = f"got the name {name!r} again" if name else "got no name"
            issues.append(
                _fault(file, line, "name", f"{message}, allowed a unique name for each point", "name it")
            )
        names.append(name)
        values.append([_number(text) for text in texts])
        for column, text, value in zip(columns[1:], texts, values[-1], strict=True):
            if not abs(value) <= MAX_COORDINATE_MM:
                message = (
                    f"got {text!r}, allowed a number from {-MAX_COORDINATE_MM:g} to {MAX_COORDINATE_MM:g} mm"
                )
                issues.append(_fault(file, line, column, message, "correct it, or leave the point out"))
    if issues:
        raise TandemError(issues)
    points = np.array(values, dtype=np.float64).reshape(-1, 6) * MM
    return ProbedPoints(tuple(names), points[:, :3], points[:, 3:])


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Read the lines of a CSV file, each with its number and cells, the headings first.

    Decimal commas are replaced by points.

    Raises:
        TandemError: ``align.file`` if the file is missing, too large or not CSV.
    """
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
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip(" ,;\t") and not line.startswith("#")
    ]
    has_semicolons = bool(lines) and ";" in lines[0][1]
    out: list[tuple[int, list[str]]] = []
    for line, line_text in lines:
        try:
            cells = next(csv.reader([line_text], delimiter=";" if has_semicolons else ","))
        except csv.Error as error:
            raise TandemError(_fault(file, line, None, f"is not CSV: {error}", "correct the row")) from error
        cells = [cell.strip() for cell in cells]
        if has_semicolons and out:
            cells = [cells[0], *(cell.replace(",", ".") for cell in cells[1:])]
        out.append((line, cells))
    return out


def _headings(file: str, heading: tuple[int, list[str]], columns: list[str]) -> list[Issue]:
    """Return an issue for each required column that is missing or repeated, and for each unknown one."""
    line, header = heading
    issues = []
    for column in columns:
        if header.count(column) != 1:
            message = f"got the column {column!r} {header.count(column)} times, allowed once"
            issues.append(_fault(file, line, column, message, f"the columns are {', '.join(columns)}"))
    for column in header:
        if column not in (*columns, "note"):
            message = f"column: got {column!r}, allowed {', '.join(columns)} and note"
            issues.append(_fault(file, line, column, message, "remove it or correct its spelling"))
    return issues


def _number(text: str) -> float:
    """Convert a text to a number; NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _fault(file: str, line: int | None, field: str | None, message: str, hint: str) -> Issue:
    return Issue("align.file", message, file=file, line=line, field=field, hint=hint)


def moved_arm(cell: Cell, arm_name: str | None, file: str) -> int:
    """Return the index of the arm whose base is computed: that of ``arm_name``, else the second one.

    Raises:
        TandemError: ``align.cell`` if the cell does not have two arms, none has that name, or the base of the
            other arm is unknown.
    """
    names = [arm.name for arm in cell.arms]
    if len(names) != 2:
        message = f"the cell has {len(names)} arm, allowed 2: a single robot needs no alignment"
        raise issue_error("align.cell", message, file=file, hint="take a cell of two robots")
    if arm_name is not None and arm_name not in names:
        message = f"arm: got {arm_name!r}, allowed {', '.join(names)}"
        raise issue_error("align.cell", message, file=file, hint="name an arm of the cell")
    index = 1 if arm_name is None else names.index(arm_name)
    if cell.arms[1 - index].base_auto:
        message = f"the base of {names[1 - index]} is to be searched as well (base_auto)"
        hint = "state it, and align the other arm to it"
        field = f"arms.{1 - index}.base_auto"
        raise issue_error("align.cell", message, file=file, field=field, hint=hint)
    return index


def used_points(points: ProbedPoints, left_out: Sequence[str], file: str) -> BoolArray:
    """Return whether each point (N,) is used, which is those whose names are not in ``left_out``.

    Raises:
        TandemError: ``align.file`` if ``left_out`` has an unknown name.
    """
    unknown = [name for name in left_out if name not in points.names]
    if unknown:
        message = f"to leave out: got {', '.join(unknown)}, allowed {', '.join(points.names)}"
        raise issue_error("align.file", message, file=file, hint="correct the name")
    return np.array([name not in left_out for name in points.names], dtype=bool)


def require_reach(cell: Cell, order: tuple[int, int], points: ProbedPoints, file: str) -> None:
    """Require that the points of each robot are within its reach; else they are in another unit or frame.

    Args:
        cell: Cell with both arms.
        order: Indices of the arms that probed first and second.
        points: Probed points.
        file: Name of their file.

    Raises:
        TandemError: ``align.units`` for each point that is too far away.
    """
    issues = []
    for k, positions in zip(order, (points.first, points.second), strict=True):
        arm = cell.arms[k]
        data = arm.data
        # 1 m in addition, because the reach counts from the shoulder, which is above the base
        max_distance = data.reach + float(np.linalg.norm(arm.tool.tcp[:3, 3])) + 1.0
        distances = np.linalg.norm(positions, axis=1)
        issues += [
            _too_far(cell.arms[k], data.title, points.names[i], distances[i], max_distance, file)
            for i in np.flatnonzero(distances > max_distance).tolist()
        ]
    if issues:
        raise TandemError(issues)


def require_readable(text: str, output: Path, document: Document) -> None:
    """Require that the new cell file can be read at its output path.

    Files that it names are relative to its folder, so they may be missing if that is not the folder of the
    old file, ``document``.

    Raises:
        TandemError: ``align.cell`` if it cannot be read.
    """
    if output.resolve().parent == document.path.resolve().parent:
        return
    with tempfile.TemporaryDirectory() as folder:
        temporary = Path(folder) / "cell.yaml"
        temporary.write_text(text, encoding="utf-8")
        new = strict_yaml.read(temporary)
    new.path = output
    try:
        read_cell(new)
    except TandemError as error:
        message = f"the cell cannot be read at {output}: {error.issues[0].message}"
        hint = "write it to the folder of the old one, so that the files it names are found"
        raise issue_error("align.cell", message, file=str(output), hint=hint) from error


def _too_far(arm: Arm, title: str, point: str, got: float, max_distance: float, file: str) -> Issue:
    """Return the issue of a point at the distance ``got`` [m] from the base of an arm with the ``title``."""
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
"""Keys of a base in a cell file: position, and roll, pitch and yaw."""


def rounded(base: FloatArray) -> tuple[list[float], list[float]]:
    """Return position [mm] to 0.1 um and roll, pitch, yaw [deg] to 1e-6 deg of a pose (4, 4), as in files."""
    xyz = [round(float(v), 4) + 0.0 for v in base[:3, 3] / MM]
    rpy = [round(float(v), 6) + 0.0 for v in to_rpy(base[:3, :3]) / DEG]
    return xyz, rpy


def with_base(document: Document, index: int, base: FloatArray) -> str:
    """Return the text of a cell file in which an arm has a new base, and ``base_auto`` is false.

    Args:
        document: Cell file.
        index: Index of the arm.
        base: New base (4, 4).

    Raises:
        TandemError: ``align.cell`` if the layout of the file does not allow it, for example with an alias.
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
    # verify that the edited text means what it should, and nothing else
    if _comparable(got) != _comparable(_expected_data(original, index, values)):
        raise _refuse(document, index, "a part of it is an alias or merge key")
    return text


def _expected_data(data: Any, index: int, values: dict[str, list[float]]) -> Any:
    """Return the data of a cell file with the new base of an arm."""
    expected = copy.deepcopy(data)
    arm = dict(expected["arms"][index])
    arm["base"] = dict(values)
    if arm.get("base_auto"):
        arm["base_auto"] = False
    expected["arms"] = [*expected["arms"][:index], arm, *expected["arms"][index + 1 :]]
    return expected


def _changes(root: yaml.Node, index: int, values: dict[str, list[float]]) -> list[Change]:
    """Return the changes of the text that set the base of an arm; raise ``LookupError`` if impossible."""
    arm = _get(root, "arms").value[index]
    changes = []
    base_auto = _find(arm, "base_auto")
    if base_auto is not None and base_auto.value.lower() in ("true", "yes", "on"):
        changes.append(_put(base_auto, "false"))
    base = _find(arm, "base")
    all_values = ", ".join(f"{key}: {_listed(values[key])}" for key in POSE_KEYS)
    if base is None:
        return [*changes, _insert(arm, f"base: {{{all_values}}}")]
    if not isinstance(base, yaml.MappingNode) or not base.value:
        return [*changes, _put(base, f"{{{all_values}}}")]
    for key in POSE_KEYS:
        node = _find(base, key)
        if node is None:
            changes.append(_insert(base, f"{key}: {_listed(values[key])}"))
        elif isinstance(node, yaml.SequenceNode) and len(node.value) == 3:
            items = zip(node.value, values[key], strict=True)
            changes += [_put(item, f"{number:.10g}") for item, number in items]
        else:
            raise LookupError(f"{key} is not a list of three numbers")
    return changes


def _insert(mapping: yaml.MappingNode, entry: str) -> Change:
    """Return the change that inserts an entry before the first one of a mapping, in its layout."""
    mark = mapping.value[0][0].start_mark
    gap = ", " if mapping.flow_style else "\n" + " " * mark.column
    return mark.index, mark.index, entry + gap


def _put(node: yaml.Node, new: str) -> Change:
    """Return the change that replaces a node; raise ``LookupError`` for a list or mapping in block style."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        raise LookupError("its layout is unexpected")
    space = " " if node.start_mark.index == node.end_mark.index else ""  # a key without a value
    return node.start_mark.index, node.end_mark.index, space + new


def _get(mapping: yaml.Node, key: str) -> Any:
    value = _find(mapping, key)
    if value is None:
        raise LookupError(f"{key} is defined elsewhere")
    return value


def _find(mapping: yaml.Node, key: str) -> Any:
    return next((value for name, value in mapping.value if name.value == key), None)


def _listed(values: list[float]) -> str:
    return "[" + ", ".join(f"{value:.10g}" for value in values) + "]"


def _comparable(data: Any) -> Any:
    """Convert numbers to floats and tuples to lists, so that only values are compared."""
    if isinstance(data, dict):
        return {key: _comparable(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_comparable(value) for value in data]
    if isinstance(data, int | float) and not isinstance(data, bool):
        return float(data)
    return data


def _refuse(document: Document, index: int, why: str) -> TandemError:
    """Return the error that the base of an arm cannot be rewritten in the text of the cell file."""
    return issue_error(
        "align.cell",
        f"the base of arm {index + 1} cannot be rewritten in place: {why}",
        file=str(document.path),
        line=document.line(("arms", index, "base")),
        field=f"arms.{index}.base",
        hint="write it out, as base: {xyz_mm: [0, 0, 0], rpy_deg: [0, 0, 0]}",
    )
