"""Two plans, or two batches, side by side."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import plans
from planner.batch import compare
from planner.batch.job import JobRecord, JobResult, JobState
from planner.batch.rows import RECORDS_FOLDER
from planner.batch.solve import UserFileNames
from planner.claims.segments import Segment
from planner.cli.batch import Compare, run_compare
from planner.issues import Issue, TandemError
from planner.pipeline import Outcome, load
from planner.plans import OperationPlan, Plan
from planner.proof.verdict import Proof
from planner.targets import Targets
from tests import small_problem

LABELS = ("approach", "cut", "cut", "link", "cut")


def plan(time: tuple[float, ...] = (0, 1, 2, 3, 4), labels: tuple[str, ...] = LABELS, **more: Any) -> Plan:
    count = len(labels)
    pose = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    every = np.ones(count)
    flags = np.zeros(count, dtype=bool)
    targets = Targets(
        ("a",), {"a": pose}, {"a": "world"}, (), every, 0 * every, every, flags, tuple(map(Segment, labels))
    )
    q = {"a": np.zeros((count, 6))}
    operation = OperationPlan(
        "job", targets, q, np.zeros((count, 0)), np.array(time, dtype=float), {}, {}, ("a",),
        {"trajopt_cost": 2.0},
    )  # fmt: skip
    operation = dataclasses.replace(operation, **more)
    return Plan("p", "d", {}, (np.eye(4),), {}, (operation,), {})


def compare_runs(tmp_path: Path, first: Plan, second: Plan) -> compare.PlanComparison:
    for name, made in (("a", first), ("b", second)):
        plans.save(made, tmp_path / name)
    return compare.compare_plans(tmp_path / "a", tmp_path / "b")


def test_a_plan_is_the_same_as_itself(tmp_path: Path) -> None:
    result = compare_runs(tmp_path, plan(), plan())
    assert result.segments == ()
    assert result.issues == {}
    assert {pair.name: pair.first for pair in result.figures} == {
        "targets": 5.0,
        "cycle_s": 4.0,
        "path_cost": 2.0,
    }
    assert all(pair.change == 0.0 for pair in result.figures)


def test_what_changed_is_found_where_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = plan((0, 1, 2.5, 3.5, 4.5), issues=(Issue("mesh.unit", "m", count=3),))
    other.operations[0].q["a"][4, 2] = np.deg2rad(7.0)
    other.operations[0].targets.pose["a"][4, 0, 3] = 0.002
    result = compare_runs(tmp_path, plan(), other)
    cut, again = result.segments
    assert (cut.segment, cut.targets, cut.seconds) == ("cut", (2, 2), (2.0, 2.5))
    assert (cut.joints_deg, cut.poses_mm) == (0.0, 0.0)
    assert again.segment == "cut (2)"
    assert again.joints_deg == pytest.approx(7.0)
    assert again.poses_mm == pytest.approx(2.0)
    assert result.issues == {"mesh.unit": (0, 3)}
    assert next(p for p in result.figures if p.name == "cycle_s").change == 0.5
    run_compare(Compare(tmp_path / "a", tmp_path / "b"))
    shown = capsys.readouterr().out
    for text in ("+0.5 (+12.5 %)", "job/cut (2)", "mesh.unit", "no proof"):
        assert text in shown


def test_segments_of_one_side_alone_and_of_other_length(tmp_path: Path) -> None:
    result = compare_runs(tmp_path, plan(), plan((0, 1, 2, 3), ("approach", "cut", "cut", "cut")))
    assert [(s.segment, s.targets) for s in result.segments] == [
        ("cut", (2, 3)),
        ("link", (1, None)),
        ("cut (2)", (1, None)),
    ]
    renamed = compare_runs(tmp_path, plan(), plan(name="new"))
    assert {(s.operation, s.targets[0] is None) for s in renamed.segments} == {("job", False), ("new", True)}


def test_folders_that_hold_no_plan_are_both_named(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        compare.compare_plans(tmp_path / "a", tmp_path / "b")
    assert [issue.code for issue in caught.value.issues] == ["plan.missing_file"] * 2
    result = compare_runs(tmp_path, plan(), plan())
    assert result.first.ok is None
    (tmp_path / "a" / "proof.json").write_text('{"ok": true, "rules": [{"x": 1}], "issues": []}')
    with pytest.raises(TandemError, match=r"proof\.json is damaged"):
        compare.compare_plans(tmp_path / "a", tmp_path / "b")


def record(folder: Path, name: str, state: JobState, metrics: Mapping[str, float], *codes: str) -> None:
    issues = tuple(Issue(code, "m") for code in codes)
    JobRecord(folder / RECORDS_FOLDER / f"{name}.json").write(JobResult(name, state, issues, metrics, 2.0))


def test_batches_are_compared_job_by_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    item, other = tmp_path / "one", tmp_path / "other"
    record(item, "a", "verified", {"cycle_s": 10.0})
    record(item, "gone", "verified", {})
    record(other, "a", "unproven", {"cycle_s": 8.0}, "verify.surface")
    record(other, "new", "timeout", {}, "batch.timeout")
    a, gone, new = compare.compare_batches(item, other)
    assert a.figure("cycle_s").change == -2.0
    assert a.figure("planning_s").change == 0.0
    assert a.issues == {"verify.surface": (0, 1)}
    assert (gone.second, new.first) == (None, None)
    run_compare(Compare(item, other))
    shown = capsys.readouterr().out
    assert "3 jobs, the status of 3 differs" in shown
    assert "cycle s, sum over 1 jobs: 10 to 8" in shown
    with pytest.raises(TandemError, match="no results of a batch"):
        run_compare(Compare(item, tmp_path / "none"))


def test_no_issue_of_an_outcome_names_the_folder_that_it_was_planned_in(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "1.nc").write_text("")
    (tmp_path / "problem.yaml").write_text("")
    inside = str(tmp_path / "files" / "1.nc")
    issues = (Issue("mesh.unit", f"{inside}: m", file=inside, hint=f"see {tmp_path}/problem.yaml"),)
    made = plan(issues=issues)
    targets = dataclasses.replace(made.operations[0].targets, issues=issues)
    made = dataclasses.replace(
        made, issues=issues, operations=(dataclasses.replace(made.operations[0], targets=targets),)
    )
    proof = Proof("d", (), issues, {}, (), "")
    problem = load(small_problem.write(tmp_path))
    told = UserFileNames(tmp_path, {"files/1.nc": "mine.nc"}).outcome(Outcome(problem, made, proof, {}))
    text = b"".join(plans.dump(told.plan).values())
    assert str(tmp_path).encode() not in text
    assert text.count(b"mine.nc: m") == 3
    assert [(i.file, i.hint) for i in told.proof.issues] == [("mine.nc", "see problem.yaml")]
