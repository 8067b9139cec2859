"""The corpus of ordinary jobs: its generators, and the results of a sample of its jobs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import yaml

from bench import corpus
from bench.corpus import airfoils, meshes, remedies, run, sheets, table
from bench.corpus.job import PROBLEM, Job, make
from planner import pipeline
from planner.issue_codes import CODES
from planner.issues import TandemError
from planner.processes.forming.plan.operation import Mode

NAMES = corpus.names()
SAMPLE = NAMES[:40]
"""Forty jobs of all families, always the same ones until families grow."""


@pytest.fixture(scope="module")
def jobs() -> tuple[Job, ...]:
    return corpus.jobs()


def problem(job: Job) -> Any:
    return yaml.load(job.files[PROBLEM], Loader=yaml.CSafeLoader)


def test_there_are_at_least_400_jobs_and_a_third_has_a_fault(jobs: tuple[Job, ...]) -> None:
    assert len(jobs) >= 400
    assert len({job.name for job in jobs}) == len(jobs)
    assert 0.3 < sum(not job.feasible for job in jobs) / len(jobs) < 0.36
    for job in jobs:
        assert job.codes <= set(CODES)
        assert len(job.why) > 10


def test_all_processes_modes_and_controllers_are_there(jobs: tuple[Job, ...]) -> None:
    seen: Counter[str] = Counter()
    for job in jobs:
        if not job.feasible:
            continue
        data = problem(job)
        cell = yaml.load(job.files["cell.yaml"], Loader=yaml.CSafeLoader)
        own = data["operations"][0]
        seen[own["process"]] += 1
        seen[own.get("mode", "")] += 1
        seen[cell["controller"].get("sync", "multimove")] += 1
        seen.update(arm["robot"] for arm in cell["arms"])
        seen.update(key for cut in own.get("cuts", []) if isinstance(cut, dict) for key in cut)
        seen.update(Path(name).suffix for name in job.files)
        seen["held"] += "held_by" in data.get("stock", {})
    processes = ("elastic_wire", "straight_wire", "forming", "milling", "targets")
    modes = get_args(Mode)
    cuts = ("flank", "lines", "engrave", "gcode", "surface")
    endings = (".dat", ".dxf", ".obj", ".stl", ".ply", ".nc", ".csv", ".json")
    for what in (*processes, *modes, *cuts, *endings, "handshake", "multimove", "held", "kr60_ha"):
        assert seen[what] >= 2, what


def test_a_first_part_of_the_corpus_has_jobs_of_all_families() -> None:
    first = NAMES[:60]
    assert {name.rsplit("_", 1)[0] for name in first} == set(corpus.FAMILIES)
    assert sorted(NAMES) == sorted(
        f"{name}_{k:02d}" for name, (count, _, _) in corpus.FAMILIES.items() for k in range(count)
    )
    assert {name.rsplit("_", 1)[0] for name in SAMPLE} == set(corpus.FAMILIES)


@pytest.mark.parametrize("name", corpus.FAMILIES)
def test_a_job_is_the_same_whenever_it_is_made(name: str) -> None:
    _, base, faults = corpus.FAMILIES[name]
    for index in (5, 3):  # in another order, and not kept
        again = make(name, index, base, faults)
        kept = corpus.find(again.name)
        assert dict(again.files) == dict(kept.files)
        assert (again.codes, again.why, again.seed) == (kept.codes, kept.why, kept.seed)


def test_every_file_that_a_problem_names_is_there(jobs: tuple[Job, ...]) -> None:
    def file_names(value: Any) -> list[str]:
        if isinstance(value, dict):
            own = [value["file"]] if isinstance(value.get("file"), str) else []
            return own + [name for each in value.values() for name in file_names(each)]
        return [name for each in value for name in file_names(each)] if isinstance(value, list) else []

    for job in jobs:
        missing = [name for name in file_names(problem(job)) if name not in job.files]
        assert not missing or job.codes & {"problem.missing_file", "targets.file"}


def unread(job: Job, folder: Path) -> list[str]:
    """Codes by which a job's problem is not even read."""
    try:
        pipeline.load(job.write(folder))
    except TandemError as error:
        return [issue.code for issue in error.issues]
    return []


def test_jobs_are_valid_problem_files(tmp_path: Path) -> None:
    """A job of each family is read whole, the first or the third, which has a fault: that may be found by
    then, but no other one."""
    for number, name in enumerate(corpus.FAMILIES):
        job = corpus.find(f"{name}_{2 * (number % 2):02d}")
        assert set(unread(job, tmp_path)) <= job.codes


@pytest.mark.long
def test_all_jobs_are_valid_problem_files(jobs: tuple[Job, ...], tmp_path: Path) -> None:
    """Nothing is wrong with a problem file itself that the generator did not want."""
    for job in jobs:
        result = set(unread(job, tmp_path)) - job.codes
        assert not {code for code in result if code.startswith("problem.")}, job.name


def test_airfoils_are_those_of_the_tables() -> None:
    """NACA 0012 and 2412 of Abbott and von Doenhoff's tables: thickness and camber at 30 and 40 %."""
    plain = airfoils.naca_four_digits(0.0, 0.4, 0.12, 201, False)
    upper = plain[:201][::-1]
    assert abs(2.0 * float(height_at(0.3, upper)) - 0.12003) < 2e-4
    cambered = airfoils.naca_four_digits(0.02, 0.4, 0.12, 201, False)
    middle = 0.5 * (height_at(0.4, cambered[:201][::-1]) + height_at(0.4, cambered[200:]))
    assert abs(middle - 0.02) < 1e-4
    cusp = airfoils.karman_trefftz(0.1, 0.0, 0.0, 400)
    assert abs(cusp[:, 1].sum()) < 1e-9  # a Joukowski section without camber is symmetric


def height_at(x: float, side: Any) -> float:
    return float(np.interp(x, side[:, 0], side[:, 1]))


def test_profiles_have_the_depth_angle_and_radii_that_are_asked() -> None:
    line = sheets.profile(sheets.wall(20.0, 50.0, 8.0, 10.0), 0.2)
    assert abs(line[-1, 1] + 20.0) < 1e-3
    slope = np.degrees(np.arctan2(-np.diff(line[:, 1]), np.diff(line[:, 0])))
    assert abs(slope.max() - 50.0) < 1e-6
    points, faces = meshes.revolve(np.array([[30.0, 0.0], [20.0, -5.0], [0.0, -5.0]]), 360)
    normal = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    assert (normal[:, 2] > 0.0).all()
    area = 0.5 * np.linalg.norm(normal, axis=1).sum()
    assert abs(area - np.pi * (50.0 * np.hypot(10.0, 5.0) + 400.0)) < 1.0  # frustum and floor, in closed form


def result(job: Job, code: int, *codes: str, seconds: float = 1.0) -> run.Result:
    issues = [{"code": c, "severity": "error", "message": f"{c} is so"} for c in codes]
    row = {"exit": code, "issues": issues, "seconds": seconds}
    return run.Result(job, row, row)


def test_what_became_of_a_job_is_told_by_its_cause() -> None:
    good, bad = corpus.find("wing_00"), corpus.find("wing_02")
    (code,) = bad.codes
    other = "motion.no_path"
    assert result(good, 0).verdict == run.VERIFIED
    assert result(good, 3, other).verdict == run.FALSE
    assert result(good, 4, "verify.surface").verdict == run.UNPROVEN
    assert result(bad, 3, code).verdict == run.TRUE
    assert result(bad, 3, other, code).verdict == run.OTHER
    assert result(bad, 0).verdict == run.PLANNED_ANYWAY
    assert result(bad, 1).verdict == run.CRASH
    text = table.markdown([result(good, 0), result(good, 3, other), result(bad, 3, code)])
    assert "1 of 2 (50 %)" in text
    assert "1 of 1 (100 %)" in text
    assert f"| wing_00 | feasible | {run.FALSE} | {other} |" in text


def test_a_process_over_its_processor_time_is_told_and_not_run_again(tmp_path: Path) -> None:
    job = corpus.find("targets_00")
    first = run.single(job, tmp_path, limit=1)  # reading the planner alone takes longer
    assert first.verdict == run.OVER
    assert first.plan["seconds"] == 1.0
    assert run.single(job, tmp_path, limit=300).verdict == run.OVER
    assert run.done([job], tmp_path)[0].verdict == run.OVER


def test_a_remedy_with_a_number_is_done_to_the_problem() -> None:
    job = corpus.find("wing_02")  # a block that is too thin
    text = "the part extends beyond the block of 1 x 2 x 3 mm by 4.5 mm in z; use a larger block"
    issue = {"code": "part.stock_too_small", "severity": "error", "message": text, "value": 20.5}
    changed = remedies.follow_remedies(job, [issue])
    assert changed is not None
    old, new = problem(job)["stock"]["size_mm"], problem(changed[0])["stock"]["size_mm"]
    assert new[:2] == old[:2]
    assert abs(new[2] - old[2] - 4.6) < 1e-9
    assert remedies.follow_remedies(job, [{**issue, "message": "use a larger block"}]) is None


@pytest.mark.long
def test_a_sample_of_the_corpus_ends_as_it_should(tmp_path: Path) -> None:
    """Forty jobs, the same ones each time. Asserted: none ends with exit code 4, with a crash or over its
    processor time; of those that can be made all but one are verified; of those with a fault all but one are
    refused, with the generator's cause first."""
    results = run.run([corpus.find(name) for name in SAMPLE], tmp_path, processes=2, tell=False)
    told = table.markdown(results)
    count = Counter(r.verdict for r in results)
    assert count[run.UNPROVEN] == count[run.CRASH] == count[run.OVER] == 0, told
    assert count[run.FALSE] <= 1, told
    assert count[run.OTHER] + count[run.PLANNED_ANYWAY] <= 1, told
