"""Files of the loop: curves, measured forces, plants. Faults in them are reported by line and field."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.loops.loop_plan import read_loop_plan
from planner.loops.plant import read_plant
from planner.reading.forces_file import read_forces
from tests.loops.plans import file_data, forces, power_plan, write

PLAN = power_plan()


def refused(work: Callable[[], object]) -> list[Issue]:
    with pytest.raises(TandemError) as error:
        work()
    return list(error.value.issues)


def read_text(tmp_path: Path, text: str) -> Any:
    path = tmp_path / "forces.csv"
    path.write_text(text)
    return read_forces(path, [PLAN.expected_forces])[0]


def test_curves_come_back_as_they_were(tmp_path: Path) -> None:
    plan = read_loop_plan(write(tmp_path / "c.json", file_data(PLAN)))
    assert (plan.name, plan.side, plan.radius) == ("wall", 1, pytest.approx(5.0 * MM))
    for mine, expected in zip(plan.levels, PLAN.levels, strict=True):
        assert mine.depth == pytest.approx(expected.depth)
        assert mine.path == pytest.approx(expected.path)
        assert mine.springback == pytest.approx(expected.springback)


def changed(path: str, value: object) -> dict[str, Any]:
    data = file_data(PLAN)
    node: Any = data
    *steps, last = path.split(".")
    for step in steps:
        node = node[int(step)] if isinstance(node, list) else node[step]
    node[int(last) if isinstance(node, list) else last] = value
    return data


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("passes.0.levels.0.points.0.forces_n", [0.0, 20.0, 10.0]),
        ("passes.0.levels.0.points.0.springback_mm", [0.0, 1.0]),
        ("passes.0.levels.0.points.0.springback_mm.0", 0.5),
        ("passes.0.levels.0.points.0.place", 1000),
        ("passes.0.levels.0.points.1.place", 0),
        ("passes.0.levels.1.depth_mm", -1),
        ("passes.0.levels", []),
        ("passes.0.side", 0),
        ("passes.0.ball_radius_mm", None),
        ("tandem_loop", 2),
        ("colour", "red"),
    ],
)
def test_a_wrong_field_of_curves_is_named(tmp_path: Path, path: str, value: object) -> None:
    issues = refused(lambda: read_loop_plan(write(tmp_path / "c.json", changed(path, value))))
    assert {issue.code for issue in issues} == {"forming.loop_curves"}
    assert all(issue.hint for issue in issues)


def test_curves_that_are_cut_short_missing_or_of_no_such_pass_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "c.json", file_data(PLAN))
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    assert refused(lambda: read_loop_plan(path))[0].code == "forming.loop_curves"
    assert "no such file" in refused(lambda: read_loop_plan(tmp_path / "no.json"))[0].message
    path.write_text(text)
    assert "wall" in refused(lambda: read_loop_plan(path, "roof"))[0].message
    assert read_loop_plan(path, "wall").name == "wall"


def test_forces_and_lifts_are_read(tmp_path: Path) -> None:
    text = "# a part\nlevel,point,force_n,springback_mm\n" + "\n".join(f"0,{p},5{p}0,1.{p}" for p in range(5))
    found = read_text(tmp_path, text + "\n0,5,550,\n")
    assert found.force[0] == pytest.approx([500, 510, 520, 530, 540, 550])
    assert found.lift[0][:5] == pytest.approx(np.array([1.0, 1.1, 1.2, 1.3, 1.4]) * MM)
    assert np.isnan(found.lift[0][5])
    assert read_text(tmp_path, "level,point,force_n\n").force == ()


GOOD = forces(3)


@pytest.mark.parametrize(
    ("text", "field", "message"),
    [
        ("", "level", "got no column 'level'"),
        ("level,point,force\n0,0,5\n", "force_n", "got no column 'force_n'"),
        ("level,point,force_n,temperature\n0,0,5,20\n", "temperature", "which is unknown"),
        ("level,point,force_n,force_n\n0,0,5,5\n", "force_n", "2 times"),
        (GOOD.replace("1,3,500.0", "1,3,-500.0"), "force_n", "'-500.0'"),
        (GOOD.replace("1,3,500.0", "1,3,nan"), "force_n", "'nan'"),
        (GOOD.replace("1,3,500.0", "1,3,inf"), "force_n", "'inf'"),
        (GOOD.replace("1,3,500.0", "1,3,"), "force_n", "''"),
        (GOOD.replace("1,3,500.0", "1,3,5e8"), "force_n", "'5e8'"),
        (GOOD.replace("500.0", "0.5"), "force_n", "expected 600 N"),
        (GOOD.replace("1,3,500.0", "1,9,500.0"), "point", "'9', allowed 0 to 5"),
        (GOOD.replace("1,3,500.0", "99,3,500.0"), "level", "'99', allowed 0 to 19"),
        (GOOD.replace("1,3,500.0", "-1,3,500.0"), "level", "'-1'"),
        (GOOD.replace("1,3,500.0", "1,2,500.0"), "point", "again"),
        (GOOD.replace("1,3,500.0\n", ""), "level", "level 1: got 5 of its 6 points, no 3"),
        (GOOD.replace("\n1,", "\n5,"), "level", "level 1: got 0 of its 6 points"),
        (GOOD.replace("1,3,500.0", "1,3"), None, "2 values, allowed 3"),
    ],
)
def test_a_wrong_row_of_forces_is_named(tmp_path: Path, text: str, field: str | None, message: str) -> None:
    issues = refused(lambda: read_text(tmp_path, text))
    assert {issue.code for issue in issues} == {"forming.loop_forces"}
    assert any(issue.field == field and message in issue.message for issue in issues), issues
    assert all(issue.hint for issue in issues)


PLACED = "level,point,force_n,x_mm,y_mm\n" + "\n".join(
    f"0,{k},500,{50 * np.cos(np.pi * k / 3):.2f},{50 * np.sin(np.pi * k / 3):.2f}" for k in range(6)
)


def test_where_points_are_may_be_said_beside_them(tmp_path: Path) -> None:
    found = read_text(tmp_path, PLACED + "\n")
    assert found.position[0][0] == pytest.approx([50 * MM, 0.0], abs=1e-5)
    named = GOOD.replace("level", "pass,level").replace("\n", "\nwall,")
    assert len(read_text(tmp_path, named.removesuffix("wall,")).force) == 3


@pytest.mark.parametrize(
    ("text", "field", "message"),
    [
        (PLACED.replace("0,0,500,50.00", "0,0,500,53.00"), "x_mm", "3.0 mm from point 0"),
        (PLACED.replace("0,0,500,50.00", "0,0,500,nan"), "x_mm", "got nan"),
        (PLACED.replace("0,0,500,50.00", "0,0,500,"), "x_mm", "allowed up to"),
        ("level,point,force_n,x_mm\n0,0,500,50\n", "y_mm", "got no column 'y_mm'"),
        ("level,point,force_n,pass\n0,0,500,roof\n", "pass", "got pass 'roof', allowed wall"),
        ("level,force_n\n0,500\n", "point", "got no column 'point'"),
    ],
)
def test_a_place_or_pass_of_another_part_is_named(
    tmp_path: Path, text: str, field: str, message: str
) -> None:
    issues = refused(lambda: read_text(tmp_path, text))
    assert {issue.code for issue in issues} == {"forming.loop_forces"}
    assert any(issue.field == field and message in issue.message for issue in issues), issues
    assert all(issue.hint for issue in issues)


def test_correcting_the_row_that_is_named_is_enough(tmp_path: Path) -> None:
    lines = GOOD.replace("1,3,500.0", "1,3,-500.0").splitlines()
    (issue,) = refused(lambda: read_text(tmp_path, "\n".join(lines)))
    assert issue.line is not None
    lines[issue.line - 1] = lines[issue.line - 1].replace("-", "")
    assert len(read_text(tmp_path, "\n".join(lines)).force) == 3


def test_rows_with_the_same_fault_are_told_once(tmp_path: Path) -> None:
    wrong = GOOD.replace(",500.0", ",-500.0")
    rows = [line for line, row in enumerate(wrong.splitlines(), 1) if ",-500.0" in row]
    assert len(rows) > 2
    (issue,) = refused(lambda: read_text(tmp_path, wrong))
    assert (issue.field, issue.line) == ("force_n", rows[0])
    assert f"; in {len(rows)} rows" in issue.message


def test_a_file_of_forces_that_is_missing_or_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "forces.csv"
    assert refused(lambda: read_forces(path, [PLAN.expected_forces]))[0].code == "forming.loop_forces"
    path.write_bytes(b"\xff\xfe\x00\x01")
    assert refused(lambda: read_forces(path, [PLAN.expected_forces]))[0].code == "forming.loop_forces"


PLANT: dict[str, Any] = {"tandem_plant": 1, "sheet": "cone"}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sheet", "sphere"),
        ("sheet", None),
        ("curves", [{"depth_mm": 1, "forces_n": [100], "springback_mm": [1]}]),
        ("thickness", [1.1, 0.9]),
        ("thickness", [0, 1]),
        ("force_n", -620),
        ("force_exponent", 0),
        ("stiffness_n_mm", 0),
        ("noise", 2),
        ("colour", "red"),
    ],
)
def test_a_wrong_field_of_a_plant_is_named_and_correcting_it_is_enough(
    tmp_path: Path, field: str, value: object
) -> None:
    path = tmp_path / "plant.yaml"
    path.write_text(yaml.safe_dump({**PLANT, field: value}))
    issues = refused(lambda: read_plant(path))
    assert {issue.code for issue in issues} == {"forming.loop_plant"}
    path.write_text(yaml.safe_dump(PLANT))
    assert read_plant(path).sheet == "cone"


def test_curves_of_a_plant_have_to_grow(tmp_path: Path) -> None:
    path = tmp_path / "plant.yaml"
    for curve in (
        {"forces_n": [200, 100], "springback_mm": [1, 2]},
        {"forces_n": [100, 200], "springback_mm": [1]},
    ):
        path.write_text(yaml.safe_dump({"tandem_plant": 1, "curves": [{"depth_mm": 1, **curve}]}))
        assert refused(lambda: read_plant(path))[0].code == "forming.loop_plant"
