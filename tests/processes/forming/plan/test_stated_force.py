"""Stated forces by depth, level and place, less the support force. Planner and proof agree."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.processes import registry
from planner.processes.forming.claims import FormsSheet
from planner.processes.forming.plan.check import check
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.proof import stated_force
from tests import small_forming
from tests.processes.forming.plan import shapes

TABLE = [[1, 200], [-1, 500], [-6, 700]]
"""Forces by z: the contact goes from 1 mm, the upper face of the flat, to -5."""


def by_level(levels: int, points: int = 0, name: str | None = None) -> str:
    """A file of forces that grow by level, and around it."""
    head = ["pass"] * (name is not None) + ["level"] + ["point"] * (points > 0) + ["force_n"]
    rows = [",".join(head + ["x_mm", "y_mm"] * (points > 0))]
    for level in range(levels):
        for point in range(max(points, 1)):
            turn = 2.0 * np.pi * point / max(points, 1)
            force = (300.0 + 60.0 * level) * (1.0 + 0.25 * np.cos(turn))
            at = [f"{(28.0 - 2.4 * level) * f(turn):.3f}" for f in (np.cos, np.sin)]
            own = [str(level), *([str(point)] if points else []), f"{force:.1f}", *(at if points else [])]
            rows.append(",".join(([name] if name is not None else []) + own))
    return "\n".join(rows) + "\n"


def load(folder: Path, mode: str = "spif", text: str = "", **op: Any) -> FormingJob:
    if text:
        (folder / "forces.csv").write_text(text)
        op["force_by"] = {"file": "forces.csv"}
    path = small_forming.write(folder, small_forming.problem(mode, **op))
    (made,) = registry.jobs(pipeline.load(path))
    assert isinstance(made, FormingJob)
    return made


def refused(folder: Path, mode: str = "spif", text: str = "", **op: Any) -> list[Issue]:
    with pytest.raises(TandemError) as error:
        _ = load(folder, mode, text, **op).planned
    return list(error.value.issues)


def forces_at(job: FormingJob, *points_mm: tuple[float, float, float]) -> list[float]:
    """Forces [N] at places [mm], as planner and proof have them, which are the same."""
    points = MM * np.array(points_mm, dtype=float)
    work = job.planned
    assert work.stated_forces is not None
    found = work.stated_forces.force_at(work.passes[0].name, points)
    np.testing.assert_allclose(_force_of_proof(job, work.passes[0].name).force_at(points), found, rtol=1e-9)
    return [round(float(n), 3) for n in found]


def _force_of_proof(job: FormingJob, name: str) -> stated_force.StatedPassForce:
    claim = next(c for c in job.claims() if isinstance(c, FormsSheet) and c.segment.name == name)
    found = stated_force.stated_pass_force(job.operation, claim)
    assert found is not None
    return found


def test_a_table_goes_evenly_between_its_rows_and_on_beyond_them(tmp_path: Path) -> None:
    for table in (TABLE, TABLE[::-1]):
        job = load(tmp_path, force_by={"table": table})
        assert forces_at(job, (20, 0, 5), (20, 0, 0), (0, 9, -1), (0, 0, -3.5), (0, 0, -9)) == [
            200.0,
            350.0,
            500.0,
            600.0,
            700.0,
        ]


def test_what_the_support_presses_is_taken_off(tmp_path: Path) -> None:
    job = load(tmp_path, "dsif", force_by={"table": TABLE}, support_force_n=150)
    assert forces_at(job, (0, 0, 1), (0, 0, -6)) == [50.0, 550.0]
    assert forces_at(load(tmp_path, "dpif_l", force_n=400, support_force_n=150), (0, 0, -3)) == [250.0]
    assert forces_at(load(tmp_path, "dsif", force_n=400, support_force_n=0), (0, 0, -3)) == [400.0]


def test_each_arm_is_held_against_what_it_presses_itself(tmp_path: Path) -> None:
    job = load(tmp_path, "dsif", force_n=3000, support_force_n=2000)
    issues = [one for one in check(job.planned, job.setup, make_tool_paths(job.planned)) if one.arm]
    assert {one.arm: one.value for one in issues if one.code == "forming.force"} == {
        "arm left": 3000.0,
        "arm right": 2000.0,
    }


@pytest.mark.parametrize(
    ("path", "depths"), [("helical", (1.0, 3.0, 5.0, 6.0)), ("contour", (2.0, 4.0, 6.0))]
)
def test_a_level_counts_for_the_middle_of_a_spiral_and_the_end_of_others(
    tmp_path: Path, path: str, depths: tuple[float, ...]
) -> None:
    job = load(tmp_path, text=by_level(len(depths)), path=path)
    places = [(20.0, 0.0, 1.0 - depth) for depth in depths]
    assert forces_at(job, *places) == [375.0 + 75.0 * k for k in range(len(depths))]
    assert forces_at(job, (20.0, 0.0, 1.0)) == [375.0]


def test_around_a_level_it_is_by_place(tmp_path: Path) -> None:
    job = load(tmp_path, text=by_level(4, 8))
    assert forces_at(job, (28, 0, 0), (40, 0, 0), (-28, 0, 0), (0, 28, 0)) == [375.0, 375.0, 225.0, 300.0]
    middle = 28.0 * np.cos(np.pi / 8) * np.array([np.cos(np.pi / 8), np.sin(np.pi / 8)])
    (force,) = forces_at(job, (float(middle[0]), float(middle[1]), 0.0))
    assert force == pytest.approx(300.0 * (1.0 + 0.125 * (1.0 + np.sqrt(0.5))), rel=2e-4)
    random = np.random.default_rng(5).uniform([-30, -30, -7], [30, 30, 2], (400, 3))
    forces_at(job, *map(tuple, random))  # both alike


def test_of_several_passes_each_has_rows_of_its_own(tmp_path: Path) -> None:
    def of(text: str) -> FormingJob:
        (tmp_path / "forces.csv").write_text(text)
        data = small_forming.problem("spif", passes=[45], force_by={"file": "forces.csv"})
        data["sheet"] |= {"metal": "aa5754_o"}
        path = small_forming.write(tmp_path, data, shapes.cone(60.0, 0.012, 0.030, 96))
        (made,) = registry.jobs(pipeline.load(path))
        assert isinstance(made, FormingJob)
        return made

    names = ("f1_p1", "f1_p2")
    first, second = (by_level(6, name=name) for name in names)
    made = of(first + second.partition("\n")[2].replace(".0\n", "9.0\n"))
    assert made.planned.stated_forces is not None
    points = np.array([[0.02, 0.0, -0.004], [0.0, 0.02, -0.009]])
    one, other = (made.planned.stated_forces.force_at(name, points) for name in names)
    assert (one + 5.0 < other).all()
    for name, found in zip(names, (one, other), strict=True):
        np.testing.assert_allclose(_force_of_proof(made, name).force_at(points), found)
    with pytest.raises(TandemError, match="got 0 levels, it has"):
        _ = of(first).planned
    with pytest.raises(TandemError, match="got no column 'pass'"):
        _ = of(by_level(6)).planned


@pytest.mark.parametrize(
    ("mode", "op", "message"),
    [
        ("spif", {"force_by": {"table": [[1, 200], [-6, -5]]}}, "than or equal to 0, got -5"),
        ("spif", {"force_by": {"table": [[1, 200], [-6, 700], [-3, 500]]}}, "row 3 is at z -3 mm; z must"),
        ("spif", {"force_by": {"table": [[1, 200], [1, 700]]}}, "row 2 is at z 1 mm"),
        ("spif", {"force_by": {"table": [[1, 0], [-6, 0]]}}, "all forces are 0"),
        ("spif", {"force_by": {"table": [[1, 200]]}}, "2"),
        ("spif", {"force_by": {}}, "either a table"),
        ("spif", {"force_by": {"table": TABLE, "file": "forces.csv"}}, "either a table"),
        ("spif", {"force_by": {"table": TABLE}, "force_n": 400}, "either force_n or force_by"),
        ("spif", {"force_by": {"file": "f.csv"}, "scallop_mm": 0.01}, "levels are counted by stepdown_mm"),
        ("adsif", {"force_by": {"table": TABLE}}, "force_by belongs to the modes"),
        ("spif", {"force_n": 400, "support_force_n": 100}, "in spif no second tool presses"),
        ("dpif_p", {"force_n": 400, "support_force_n": 100}, "belongs to the modes dpif_l and dsif"),
        ("dsif", {"support_force_n": 100}, "the formula has no support"),
        ("dsif", {"force_n": 400, "support_force_n": 400}, "exceeds the forming tool's 400 N"),
        ("dsif", {"force_by": {"table": TABLE}, "support_force_n": 300}, "forming tool's 200 N"),
        ("dsif", {"force_by": {"file": "f.csv"}, "support_force_n": 300}, "the force of both tools"),
        ("dsif", {"force_n": 400, "support_force_n": -1}, "than or equal to 0, got -1"),
    ],
)
def test_what_cannot_be_stated_is_refused_by_its_field(
    tmp_path: Path, mode: str, op: dict[str, Any], message: str
) -> None:
    issues = refused(tmp_path, mode, **op)
    assert {issue.code for issue in issues} == {"problem.field"}
    assert any(message in issue.message for issue in issues), issues


def test_a_force_that_is_no_number_is_refused(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, force_by={"table": [[1, 200], [-6, float("nan")]]})
    assert issue.code == "problem.not_finite"


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([[1, 200], [-3, 700]], "the table goes from z -3 to 1 mm, the passes from -5.00 to 1.00 mm"),
        ([[-2, 200], [-6, 700]], "the table goes from z -6 to -2 mm"),
        ([[1, 0.2], [-6, 0.7]], "largest force is 0.7 N, about"),
        ([[1, 200], [-6, 90_000]], "largest force is 90000 N, about"),
    ],
)
def test_a_table_of_another_part_or_unit_is_refused(tmp_path: Path, table: list[Any], message: str) -> None:
    (issue,) = refused(tmp_path, force_by={"table": table})
    assert issue.code == "forming.force_input"
    assert message in issue.message
    assert issue.hint
    assert load(tmp_path, force_by={"table": TABLE}).planned.stated_forces


GOOD, PLACED = by_level(4), by_level(4, 8)


@pytest.mark.parametrize(
    ("text", "field", "message"),
    [
        (by_level(2), "level", "got 2 levels, it has 3"),
        (by_level(5), "level", "'4', allowed 0 to 3"),
        (GOOD.replace("1,450.0\n", ""), "level", "level 1: got 0 of its 1 points"),
        (GOOD.replace("1,450.0", "1,-450.0"), "force_n", "'-450.0'"),
        (GOOD.replace("1,450.0", "1,nan"), "force_n", "'nan'"),
        (GOOD.replace("1,450.0", "2,450.0"), "level", "again"),
        ("level,force_n\n0,0.4\n1,0.5\n2,0.6\n", "force_n", "the largest force is 0.6 N"),
        (GOOD.replace("force_n", "force_kn"), "force_n", "got no column 'force_n'"),
        ("level,force_n\n", "level", "got 0 levels, it has 3"),
        (PLACED.replace("x_mm,y_mm", "x_in,y_in"), "x_in", "which is unknown"),
        (
            "\n".join(row.rsplit(",", 2)[0] for row in PLACED.splitlines()),
            "x_mm",
            "several points on a level",
        ),
        (PLACED.replace("2,3,", "2,9,"), "level", "got 8 of its 10 points"),
    ],
)
def test_a_wrong_row_of_measured_forces_is_named(tmp_path: Path, text: str, field: str, message: str) -> None:
    issues = refused(tmp_path, text=text)
    assert {issue.code for issue in issues} == {"forming.loop_forces"}
    assert any(issue.field == field and message in issue.message for issue in issues), issues
    assert all(issue.hint for issue in issues)


def test_a_problem_carries_its_forces_along_and_changes_with_them(tmp_path: Path) -> None:
    path = load(tmp_path, text=GOOD).setup and tmp_path / "problem.yaml"
    problem = pipeline.load(path)
    saved = pipeline.save(problem, tmp_path / "out")
    assert pipeline.load(saved).digest == problem.digest
    (tmp_path / "forces.csv").write_text(GOOD.replace("450.0", "451.0"))
    assert pipeline.load(path).digest != problem.digest
