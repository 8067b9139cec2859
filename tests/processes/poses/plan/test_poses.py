"""The generic input: poses from CSV and JSON, and every fault of such a file."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from planner.issues import TandemError
from planner.problem import Cell, Controller, Setup, Stock
from planner.processes.poses.plan.job import Posed, PosedJob
from planner.reading.values import POSE_COLUMNS

SETUP = Setup(
    1, Cell("none", (), (), Controller()), Stock(np.array([0.1, 0.1, 0.1]), np.eye(4), np.eye(3)), (0,)
)
LEFT = dict(zip(POSE_COLUMNS, (1, 2, 3, 1, 0, 0, 0), strict=True))
RIGHT = dict(zip(POSE_COLUMNS, (9, 2, 3, 0, 1, 0, 0), strict=True))
ROW = {
    **{f"left.{column}": value for column, value in LEFT.items()},
    **{f"right.{column}": value for column, value in RIGHT.items()},
    "feed_mm_s": 20,
}


def operation(folder: Path, name: str = "targets.csv", **more: Any) -> Posed:
    data = {"name": "job", "process": "targets", "arms": ["left", "right"], "file": name, **more}
    return Posed.model_validate(data, context={"folder": folder})


def write(folder: Path, rows: list[dict[str, Any]], name: str = "targets.csv") -> None:
    if name.endswith(".json"):
        (folder / name).write_text(json.dumps(rows))
        return
    lines = [",".join(rows[0])] + [",".join(str(v) for v in row.values()) for row in rows]
    (folder / name).write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("name", ["targets.csv", "targets.json"])
def test_both_formats_give_the_same_targets(tmp_path: Path, name: str) -> None:
    write(tmp_path, [ROW, {**ROW, "left.x_mm": 4, "right.y_mm": 7}], name)
    targets = PosedJob(operation(tmp_path, name), SETUP, None).targets()
    assert targets.count == 2
    np.testing.assert_allclose(targets.pose["left"][:, :3, 3], [[1e-3, 2e-3, 3e-3], [4e-3, 2e-3, 3e-3]])
    np.testing.assert_allclose(targets.pose["right"][0, :3, :3], np.diag([1.0, -1, -1]), atol=1e-15)
    np.testing.assert_allclose(targets.travel, [0, 5e-3])
    np.testing.assert_allclose(targets.feed, 0.02)
    assert targets.stop.all()


def test_free_axes_become_shared_freedoms(tmp_path: Path) -> None:
    write(tmp_path, [ROW, ROW])
    free = [{"name": "spin", "arms": ["left", "right"], "axis": "x", "turn_deg": [-180, 180]}]
    (freedom,) = PosedJob(operation(tmp_path, free=free), SETUP, None).targets().freedoms
    assert freedom.periodic
    np.testing.assert_allclose(freedom.upper, np.pi)
    assert set(freedom.axis) == {"left", "right"}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"left.x_mm": "abc"}, "column 'left.x_mm': got 'abc'"),
        ({"right.z_mm": "nan"}, "column 'right.z_mm'"),
        ({"left.qw": 1.1}, "quaternion of length 1.1000"),
        ({"feed_mm_s": 0}, "feed_mm_s is 0"),
    ],
)
def test_a_wrong_value_is_named_by_row_and_column(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    write(tmp_path, [ROW, {**ROW, **change}])
    with pytest.raises(TandemError) as caught:
        PosedJob(operation(tmp_path), SETUP, None).targets()
    (issue,) = caught.value.issues
    assert issue.code == "targets.file"
    assert issue.index == 1
    assert words in issue.message


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        PosedJob(operation(tmp_path), SETUP, None).targets()
    assert caught.value.issues[0].code == "problem.missing_file"


def test_a_broken_json_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.json").write_text("[{")
    with pytest.raises(TandemError) as caught:
        PosedJob(operation(tmp_path, "t.json"), SETUP, None).targets()
    assert caught.value.issues[0].code == "targets.file"


def test_a_free_axis_is_a_turn_or_a_slide(tmp_path: Path) -> None:
    write(tmp_path, [ROW, ROW])
    free = [{"name": "both", "arms": ["left"], "axis": "z", "turn_deg": [0, 1], "slide_mm": [0, 1]}]
    with pytest.raises(TandemError) as caught:
        PosedJob(operation(tmp_path, free=free), SETUP, None).targets()
    assert caught.value.issues[0].code == "targets.freedom"


def test_unknown_keys_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="extra"):
        operation(tmp_path, colour="red")


def test_a_block_that_an_arm_holds_is_refused(tmp_path: Path) -> None:
    write(tmp_path, [ROW, {**ROW, "left.x_mm": 4}])
    block = dataclasses.replace(SETUP.stock, held_by="right")
    with pytest.raises(TandemError) as caught:
        PosedJob(operation(tmp_path), dataclasses.replace(SETUP, stock=block), None).targets()
    assert [issue.code for issue in caught.value.issues] == ["targets.held"]
