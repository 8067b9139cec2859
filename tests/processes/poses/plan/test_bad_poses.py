"""Every fault of a file of targets or of its operation is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from planner import pipeline
from planner.issues import TandemError
from planner.processes.poses.plan.job import MAX_TABLE_BYTES as MAX_TABLE
from tests import small_problem
from tests.refusals import OPERATION, POSES, change, codes, expect_refusal

ROW = small_problem.ROWS[0]
TABLES = {
    "empty": "",
    "header alone": small_problem.COLUMNS + "\n",
    "one row": f"{small_problem.COLUMNS}\n{ROW}\n",
    "semicolons": f"{small_problem.COLUMNS}\n{ROW}\n{ROW}\n".replace(",", ";"),
    "column missing": f"{small_problem.COLUMNS}\n{ROW}\n{ROW}\n".replace("left.qx,", "").replace(",-0.5", ""),
    "column twice": f"{small_problem.COLUMNS},feed_mm_s\n{ROW},5\n{ROW},6\n",
    "column unknown": f"{small_problem.COLUMNS},speed\n{ROW},5\n{ROW},6\n",
    "cell too many": f"{small_problem.COLUMNS}\n{ROW},1\n{ROW}\n",
    "cell too few": f"{small_problem.COLUMNS}\n{ROW}\n450,1,500\n",
    "decimal commas": f"{small_problem.COLUMNS}\n{ROW}\n" + ROW.replace("0.5", '"0,5"') + "\n",
    "not a number": f"{small_problem.COLUMNS}\n{ROW}\n" + ROW.replace("450", "nan") + "\n",
    "infinite": f"{small_problem.COLUMNS}\n{ROW}\n" + ROW.replace("450", "1e999") + "\n",
    "metres away": f"{small_problem.COLUMNS}\n{ROW}\n" + ROW.replace("450", "1e9") + "\n",
    "no rotation": f"{small_problem.COLUMNS}\n{ROW}\n" + ROW.replace("0.5", "0") + "\n",
    "feed zero": f"{small_problem.COLUMNS}\n{ROW}\n{ROW[:-2]}0\n",
    "stop unclear": f"{small_problem.COLUMNS},stop\n{ROW},maybe\n{ROW},1\n",
    "segment with code": f'{small_problem.COLUMNS},segment\n{ROW},"cut/x\nENDPROC"\n{ROW},cut/x\n',
    "open quote": f'{small_problem.COLUMNS}\n{ROW}\n"{ROW}\n',
}


@pytest.mark.parametrize("name", TABLES)
def test_each_wrong_table_of_targets_is_named(tmp_path: Path, name: str) -> None:
    problem = pipeline.load(small_problem.write(tmp_path, table=TABLES[name]))
    with pytest.raises(TandemError) as caught:
        pipeline.plan(problem)
    assert codes(caught.value.issues) == {"targets.file"}
    assert all("targets.csv" in str(issue.file) for issue in caught.value.issues)


@pytest.mark.parametrize(
    "content",
    [
        b"{}",
        b"[]",
        b"[1, 2]",
        b"[[], []]",
        b"null",
        b"[" * 100_000,
        b'[{"a": 1}, {}]',
        b"\xff\xfe",
        b"[" + b"9" * 9999,
    ],
)
def test_each_wrong_list_of_targets_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "t.json").write_bytes(content)
    problem = pipeline.load(
        small_problem.write(tmp_path, small_problem.PROBLEM.replace("targets.csv", "t.json"))
    )
    found = pipeline.check(problem)
    assert codes(found) == {"targets.file"}


def test_a_table_with_a_byte_order_mark_is_read(tmp_path: Path) -> None:
    table = "\ufeff" + "\r\n".join([small_problem.COLUMNS, *small_problem.ROWS, ""])
    problem = pipeline.load(small_problem.write(tmp_path, table=table))
    assert not pipeline.check(problem)


def test_tables_that_are_missing_or_too_large(tmp_path: Path) -> None:
    path = small_problem.write(tmp_path)
    problem = pipeline.load(path)
    (tmp_path / "targets.csv").unlink()
    assert codes(pipeline.check(problem)) == {"problem.missing_file"}
    with (tmp_path / "targets.csv").open("wb") as stream:
        stream.truncate(MAX_TABLE + 1)
    assert codes(pipeline.check(problem)) == {"problem.too_large"}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("arms", ["left", "left"]),
        ("arms", []),
        ("file", 5),
        ("feed_mm_s", 0),
        ("feed_mm_s", 1e9),
        ("free", [{"name": "a", "arms": ["left"], "axis": "x", "turn_deg": [10, -10]}]),
        ("free", [{"name": "a", "arms": ["right"], "axis": "x", "turn_deg": [-10, 10]}]),
        ("free", [{"name": "a", "arms": ["left"], "axis": "x", "turn_deg": [-9, 9]}] * 2),
        ("free", [{"name": "a", "arms": ["left", "left"], "axis": "x", "turn_deg": [-9, 9]}]),
        ("free", [{"name": "a", "arms": ["left"], "axis": "w", "turn_deg": [-9, 9]}]),
        ("frame", "base"),
    ],
)
def test_each_wrong_field_of_the_general_door_is_named(tmp_path: Path, field: str, value: Any) -> None:
    path = small_problem.write(tmp_path, yaml.safe_dump(change(POSES, OPERATION + field, value)))
    (*_, issue) = expect_refusal(path)
    assert issue.code == "problem.field"
    assert issue.field
    assert issue.field.startswith("operations.0")


@pytest.mark.parametrize("name", ["stock", "support", "world"])
def test_names_that_the_model_keeps_for_itself_are_refused(tmp_path: Path, name: str) -> None:
    data = change(change(POSES, "cell.arms.0.name", name), OPERATION + "arms", [name])
    table = "\n".join([small_problem.COLUMNS.replace("left", name), *small_problem.ROWS])
    (issue,) = pipeline.check(pipeline.load(small_problem.write(tmp_path, yaml.safe_dump(data), table)))
    assert (issue.code, issue.field) == ("cell.body_name", "cell.arms.0.name")
