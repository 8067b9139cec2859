"""Batch files: lists, ranges and tables of fields; every fault at once, with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from planner.batch.batch_file import RangeFile, read_batch, set_field
from planner.batch.run import collect_items
from planner.issues import TandemError
from tests import small_problem


def write(folder: Path, text: str, **files: str) -> Path:
    (folder / "base").mkdir(exist_ok=True)
    small_problem.write(folder / "base")
    for name, content in files.items():
        (folder / f"{name}.csv").write_text(content)
    path = folder / "many.yaml"
    path.write_text(text)
    return path


def faults(path: Path) -> list[tuple[str, int | None, str]]:
    with pytest.raises(TandemError) as caught:
        read_batch(path)
    return [(issue.code, issue.line, issue.message) for issue in caught.value.issues]


def test_all_combinations_in_order(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "batch: 1\nproblem: base\nvary:\n  settings.clearance_mm: [5, 10.5]\n"
        "  operations.poses.arms: [[left]]\n  settings.seed: {from: 1, to: 3, count: 3}\n",
    )
    result = read_batch(path)
    assert [v.name for v in result] == ["001", "002", "003", "004", "005", "006"]
    assert [tuple(v.values.values()) for v in result[:4]] == [
        (5, ["left"], 1),
        (5, ["left"], 2),
        (5, ["left"], 3),
        (10.5, ["left"], 1),
    ]
    problem = result[3].read()
    assert problem.settings.clearance == pytest.approx(0.0105)
    assert problem.settings.seed == 1
    assert problem.path == tmp_path / "base" / "problem.yaml"
    items = collect_items([path], tmp_path / "out")
    assert [item.name for item in items][:2] == ["many-001", "many-002"]
    assert items[3].varied["settings.clearance_mm"] == 10.5


def test_values_side_by_side_and_a_table_of_parts(tmp_path: Path) -> None:
    text = (
        "batch: 1\nproblem: base/problem.yaml\ncombine: zip\nvary:\n"
        "  settings.seed: [1, 2]\n  settings.clearance_mm: [5, 6]\ncsv: parts.csv\n"
    )
    table = "name, operations.0.file,settings.speed_fraction\nfirst,mine.csv,0.5\n\nsecond,,0.7\n"
    path = write(tmp_path, text, parts=table)
    (tmp_path / "mine.csv").write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS[:3]]))
    result = read_batch(path)
    assert [v.name for v in result] == ["first-001", "first-002", "second-003", "second-004"]
    assert result[1].values == {
        "operations.0.file": "mine.csv",
        "settings.speed_fraction": 0.5,
        "settings.seed": 2,
        "settings.clearance_mm": 6,
    }
    first, last = result[0].read(), result[3].read()
    assert first.source["operations"][0]["file"] == str(tmp_path / "mine.csv")
    assert last.source["operations"][0]["file"] == str(tmp_path / "base" / "targets.csv")
    assert last.settings.speed_fraction == 0.7
    alone = write(tmp_path, "batch: 1\nproblem: base\ncsv: parts.csv\n")
    assert [v.name for v in read_batch(alone)] == ["first", "second"]


@pytest.mark.parametrize(
    ("spec", "values"),
    [
        ({"from": 0, "to": 1, "count": 3}, [0, 0.5, 1]),
        ({"from": 0.1, "to": 0.3, "step": 0.1}, [0.1, 0.2, 0.3]),
        ({"from": 5, "to": 1, "step": 1.5}, [5, 3.5, 2]),
        ({"from": 2, "to": 2, "step": 1}, [2]),
    ],
)
def test_ranges(spec: dict[str, float], values: list[float]) -> None:
    got = RangeFile.model_validate(spec).values()
    assert got == values
    assert [type(g) for g in got] == [int if float(v).is_integer() else float for v in values]


def test_all_faults_at_once_with_their_lines(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "batch: 2\nproblem: base\nspeed: 3\nvary:\n  settings.seed: []\n  settings.x: {from: 1, to: 2}\n"
        "combine: all\n",
    )
    result = faults(path)
    assert {code for code, _, _ in result} == {"batch.field"}
    lines = {line for _, line, _ in result}
    assert {1, 3, 5, 6, 7} <= lines
    assert any("a range has either a count or a step" in message for _, _, message in result)
    assert any("speed: unknown key" in message for _, _, message in result)


@pytest.mark.parametrize(
    ("text", "line", "expected_text"),
    [
        ("batch: 1\nproblem: base\n", 1, "nothing varies"),
        ("batch: 1\nproblem: nowhere\nvary: {settings.seed: [1]}\n", 2, "no bundled problem"),
        ("batch: 1\nproblem: base\ncombine: zip\nvary: {a.b: [1], c.d: [1, 2]}\n", 1, "c.d has 2"),
        ("batch: 1\nproblem: base\nvary: {a: {from: 0, to: 1, step: 1.0e-9}}\n", 3, "more than 100000"),
        (
            "batch: 1\nproblem: base\n"
            "vary: {a: {from: 0, to: 1, count: 1000}, b: {from: 0, to: 1, count: 101}}",
            3,
            "101000 jobs",
        ),
        ("batch: 1\nproblem: base\nvary: {a: {from: .nan, to: 1, count: 3}}\n", 3, "finite"),
    ],
)
def test_faults_of_a_batch_file(tmp_path: Path, text: str, line: int, expected_text: str) -> None:
    result = faults(write(tmp_path, text))
    assert [(code, at) for code, at, _ in result] == [("batch.field", line)] * len(result)
    assert any(expected_text in message for _, _, message in result)


@pytest.mark.parametrize(
    ("table", "expected_text"),
    [
        ("", "no valid heading"),
        ("a,a\n1,2\n", "none twice"),
        ("a,\n1,2\n", "no valid heading"),
        ("a\n\n", "no lines below"),
        ("a,b\n1\n1,2,3\n", "1 cells, but the heading has 2"),
    ],
)
def test_faults_of_a_table(tmp_path: Path, table: str, expected_text: str) -> None:
    result = faults(write(tmp_path, "batch: 1\nproblem: base\ncsv: t.csv\n", t=table))
    assert {code for code, _, _ in result} == {"batch.csv"}
    assert expected_text in result[0][2]
    assert len(result) == (2 if "cells" in expected_text else 1)
    missing = faults(write(tmp_path, "batch: 1\nproblem: nowhere\ncsv: none.csv\n"))
    assert [code for code, _, _ in missing] == ["batch.field", "batch.csv"]


def test_a_value_that_the_problem_refuses_is_told_at_the_batch_files_line(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "batch: 1\nproblem: base\nvary:\n  settings.seed: [1]\n  settings.clearance_mm: [-3]\n"
        "  settings.sped: [1]\n  operations.7.feed: [1]\n  operations.none.feed: [1]\n"
        "  name.x: [1]\n  a..b: [2]\n",
    )
    with pytest.raises(TandemError) as caught:
        read_batch(path)[0].read()
    issues = caught.value.issues
    assert [(i.code, i.line) for i in issues] == [("batch.field", n) for n in (7, 8, 9, 10)]
    assert "has 1 entries" in issues[0].message
    assert "known are poses" in issues[1].message
    path = write(
        tmp_path, "batch: 1\nproblem: base\nvary:\n  settings.clearance_mm: [-3]\n  settings.sped: [1]\n"
    )
    with pytest.raises(TandemError) as caught:
        read_batch(path)[0].read()
    issues = caught.value.issues
    assert {(i.code, i.line, i.file) for i in issues} == {("problem.field", n, str(path)) for n in (4, 5)}


def test_a_fault_of_the_problem_itself_is_told_at_its_own_line(tmp_path: Path) -> None:
    path = write(tmp_path, "batch: 1\nproblem: base\nvary:\n  settings.seed: [1]\n")
    base = tmp_path / "base" / "problem.yaml"
    base.write_text(base.read_text().replace("irb140", "irb1"))
    with pytest.raises(TandemError) as caught:
        read_batch(path)[0].read()
    (issue,) = caught.value.issues
    assert (issue.code, issue.file, issue.line) == ("problem.unknown_robot", str(base), 6)


def test_names_of_files_start_at_the_batch_file(tmp_path: Path) -> None:
    data: dict[str, Any] = {"part": {"mesh": {"file": "/a"}}, "list": [{"name": "x", "file": "/b"}]}
    set_field(data, "part.mesh", {"file": "c.stl", "more": [{"file": "d"}]}, tmp_path)
    set_field(data, "list.x.file", "e", tmp_path)
    assert data["part"]["mesh"] == {"file": str(tmp_path / "c.stl"), "more": [{"file": str(tmp_path / "d")}]}
    assert data["list"][0]["file"] == str(tmp_path / "e")


def test_the_batch_file_of_the_documentation_reads(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "batch.md").read_text()
    path = tmp_path / "many.yaml"
    path.write_text(text.split("```yaml\n")[1].split("```")[0])
    result = read_batch(path)
    assert len(result) == 2 * 3 * 4
    assert result[-1].values == {
        "settings.clearance_mm": 10,
        "operations.wing.feed_mm_s": 8,
        "settings.seed": 6,
    }
    assert result[-1].read().operations[0].name == "wing"
