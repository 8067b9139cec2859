"""Remedies of every room work: each issue's advice is applied to the bad data, and the issue is gone.

The rows of ``remedy_rows`` are problems, files and tables as data; those of ``test_remedies`` are bundled.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from planner.issue_codes import CODES
from planner.issues import Issue, Severity
from tests.reading.part_specs import WING, circle, guides, outline
from tests.refusals import change
from tests.remedies import remedy_rows as rows
from tests.remedies import (
    remedy_rows_controllers,
    remedy_rows_forming,
    remedy_rows_milling,
    remedy_rows_motion,
    remedy_rows_parts,
    remedy_rows_results,
    remedy_rows_wires,
)
from tests.remedies import remedy_tables as tables
from tests.remedies.advice import ReportedFigure, Word
from tests.remedies.remedy_rows import GONE, Row
from tests.remedies.remedy_rows_parts import block
from tests.remedies.test_remedies import REMEDIES
from tests.test_infeasible import EXPECT

SUBJECTS = (
    remedy_rows_parts,
    remedy_rows_milling,
    remedy_rows_forming,
    remedy_rows_wires,
    remedy_rows_motion,
    remedy_rows_controllers,
    remedy_rows_results,
)
ROWS = [*rows.ROWS, *(row for subject in SUBJECTS for row in subject.ROWS)]


def remove_value(data: Any, field: str) -> Any:
    out = copy.deepcopy(data)
    inner = out
    *steps, last = [int(step) if step.isdigit() else step for step in field.split(".")]
    for step in steps:
        inner = inner[step]
    del inner[last]
    return out


def current_value(data: Any, field: str) -> Any:
    for step in field.split("."):
        data = data[int(step)] if isinstance(data, list) else data.get(step)
        if data is None:
            return None
    return data


def figures(value: Any, issues: Sequence[Issue], was: Any) -> Any:
    """Replace placeholders of the value by the figures of the issues."""
    if isinstance(value, ReportedFigure | Word):
        return value.of(issues, was)
    if isinstance(value, dict):
        return {key: figures(item, issues, None) for key, item in value.items()}
    return [figures(item, issues, None) for item in value] if isinstance(value, list) else value


def put(folder: Path, name: str, content: str | bytes) -> None:
    if isinstance(content, bytes):
        (folder / name).write_bytes(content)
    else:
        (folder / name).write_text(content)


def follow(row: Row, data: Any, issues: Sequence[Issue], folder: Path) -> Any:
    """The data after the remedy; files of it are written."""
    for field, value in row.remedy.items():
        if not field:
            data = value
        elif field.startswith("@"):
            put(folder, field[1:], figures(value, issues, None))
        elif value is GONE:
            data = remove_value(data, field)
        else:
            data = change(data, field, figures(value, issues, current_value(data, field)))
    return data


def prepare(folder: Path, *given: Row) -> None:
    put(folder, "targets.csv", rows.TABLE)
    for row in given:
        for name, content in row.files.items():
            put(folder, name, content)


def try_remedy(row: Row, folder: Path) -> tuple[list[Issue], list[Issue]]:
    """The issues before and after the remedy is followed."""
    prepare(folder, row)
    before = row.how(folder, row.data)
    own = [issue for issue in before if issue.code == row.code]
    assert own, [str(issue) for issue in before]
    assert row.says in "; ".join(str(issue) for issue in own), [str(issue) for issue in own]
    return before, row.how(folder, follow(row, row.data, own, folder))


EACH = [pytest.param(row, marks=[pytest.mark.long] * row.long, id=row.code) for row in ROWS]


@pytest.mark.sampled(every=6)
@pytest.mark.parametrize("row", EACH)
def test_what_an_issue_advises_ends_it_and_leaves_no_other_fault(row: Row, tmp_path: Path) -> None:
    """An error may remain as a note: remaining foam, where more is allowed."""
    before, after = try_remedy(row, tmp_path)
    was = {issue.severity for issue in before if issue.code == row.code} | {Severity.ERROR}
    assert not [
        str(i) for i in after if i.severity in was and (i.code == row.code or i.severity is Severity.ERROR)
    ]


# ---- two faults at once ----------------------------------------

STRAIGHT = rows.STRAIGHT
SECOND = {**STRAIGHT["operations"][0], "name": "second"}
TWO = {
    "robot and section": ("problem.unknown_robot", "part.naca", rows.load,
        change(block({"wing": {**WING, "tip": {"naca": "0099", "chord_mm": 100}}}),
        "cell.arms.0.robot", "irb9")),
    "operation's key and outline": ("problem.field", "part.outline_overlap", rows.load,
        change(block(outline(circle(100, 50, 10))), "operations.0.sped", 3)),
    "process and guide": ("problem.unknown_process", "part.guide", rows.load,
        change(block(guides(start={"polyline_mm": [[0, 0, 0], [5, 0, 0], [5, 0, 0]]})),
        "operations.0.process", "knit")),
    "names and section": ("problem.duplicate_name", "part.wing", rows.load,
        {**block({"wing": {**WING, "trailing_edge_mm": 20}}),
        "operations": [rows.POSES["operations"][0], dict(rows.POSES["operations"][0])]}),
    "arm and foam": ("problem.unknown_arm", "kerf.unknown_foam", rows.load, change(change(STRAIGHT,
        "stock.foam", "granite"), "operations.0.arms", ["middle"])),
    "options and block": ("post.option", "part.stock_too_small", rows.load, {**rows.HELD,
        "operations": [rows.BOTH], "cell": {**rows.HELD["cell"], "controller": {"options": []}},
        "part": outline(circle(50, 50, 300))}),
    "gripper and foam": ("problem.field", "kerf.unknown_foam", rows.load, change(change(rows.HELD,
        "stock.foam", "granite"), "stock.gripper", "claw")),
    "foam and outline": ("kerf.unknown_foam", "part.outline_overlap", rows.load, {**change(STRAIGHT,
        "stock.foam", "granite"), "part": outline(circle(100, 50, 10))}),
    "bow and trim": ("bow.missing", "straight.trim", rows.lay, {**STRAIGHT, "operations": [{**SECOND,
        "arms": ["right"]}, {**SECOND, "name": "third", "cuts": [{"trim": ["left"]}]}]}),
    "heat and surface": ("kerf.too_hot", "part.missing_surface", rows.lay, {**rows.heat(60, 2.5),
        "operations": [rows.heat(60, 2.5)["operations"][0], {**SECOND, "cuts": [{"surface": "wing"}]}]}),
    "flute and holder": ("milling.flute", "milling.holder", rows.lay, remedy_rows_milling.with_cut(
        remedy_rows_milling.WALL, {"flank": "wall"}, {"flute_mm": 21.1, "overhang_mm": 33.3})),
    "surface and margin": ("milling.no_surface", "milling.pattern", rows.lay, change(
        remedy_rows_milling.with_cut(remedy_rows_milling.PANEL, {}, remedy_rows_milling.BALL),
        "operations.0.cuts", [{"flank": "door"}, {**remedy_rows_milling.LINES, "margin_mm": 300}])),
    "support and side": ("stock.support", "bow.missing", rows.lay, change(change(STRAIGHT, "stock.support",
        [{"kind": "box", "size_mm": [50, 50, 50], "pose": {"xyz_mm": [0, 0, -25]}}]), "operations.0.arms",
        ["right"])),
}  # fmt: skip


@pytest.mark.parametrize("name", TWO)
def test_two_faults_at_once_are_both_named(name: str, tmp_path: Path) -> None:
    item, other, how, data = TWO[name]
    prepare(tmp_path)
    assert {item, other} <= {issue.code for issue in how(tmp_path, data)}


# ---- every code ----------------------------------------

BUNDLED = {code for name in REMEDIES for code in EXPECT[f"{name}.yaml"]}
TRIED = {row.code for row in ROWS} | BUNDLED


def test_every_code_has_a_row_or_a_reason() -> None:
    """``TO_DO`` only shrinks: what has a row, or a word why there is none, must not stand there."""
    known = [TRIED, set(tables.ELSEWHERE), set(tables.NONE), set(tables.TO_DO)]
    assert set(CODES) == set().union(*known), sorted(set(CODES) ^ set().union(*known))
    for done in known[:3]:
        assert not done & known[3], "take these out of TO_DO"
    assert not known[2] & (known[0] | known[1]), "these have a remedy that is tried"


def test_what_is_tried_elsewhere_is_there() -> None:
    for code, (file, name) in tables.ELSEWHERE.items():
        text = (Path(__file__).parents[1] / f"{file}.py").read_text()
        assert f"def {name}(" in text
        assert code in text
