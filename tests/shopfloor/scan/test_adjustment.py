"""Adjustments by made-up scans: rounds against sheets whose truth is known, gain, limits and refusals."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray, transform
from planner.geometry.curves import along, arc_length
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import lay_all
from planner.processes.forming.plan.springback.compensation import at_targets
from planner.processes.forming.plan.springback.compensation_file import Compensation
from planner.processes.forming.proof import scan_field
from planner.processes.forming.proof.springback_file import Measured
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import adjustment, deviation, forming_rate
from planner.shopfloor.scan.cloud import Cloud
from tests.shopfloor.scan import rounds
from tests.shopfloor.scan.rounds import GIVES_WAY, KINDS, Rounds, next_one

LEVELS = np.arange(1.0, 21.0) * MM


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    return rounds.job_of(tmp_path_factory.mktemp("cone"), KINDS["cone"])


def scan_of(job: FormingJob, shallow: FloatArray, seed: int) -> tuple[Cloud, ProbedPoints]:
    return rounds.scan_of(job, LEVELS, shallow, seed)


@pytest.mark.long
def test_two_rounds_leave_two_tenths_and_the_third_changes_nothing(job: FormingJob) -> None:
    """Below the first three millimetres, where the plant's sheet gives way before it forms at all."""
    left = [np.abs(one) for one in Rounds(job, KINDS["cone"]).run(seed=1, count=3)]
    below = [one[GIVES_WAY:] for one in left]
    assert below[0].mean() > 4.0 * MM
    assert below[1].mean() <= 0.12 * MM
    assert below[2].max() <= 0.2 * MM
    assert below[2].mean() <= 0.03 * MM
    assert np.percentile(np.abs(below[3] - below[2]), 95) <= 0.1 * MM
    # above there is no less of it than a round takes
    assert left[2][:GIVES_WAY].mean() <= 0.6 * MM


def test_what_comes_back_whole_is_no_stray_point(job: FormingJob) -> None:
    """A wall that was not formed at all is as far off as it is deep: that changes along the wall as the way
    does, and is measured all the same."""
    shallow = np.minimum(LEVELS, 4.0 * MM)[:, None] * np.ones(24)
    cloud, marks = scan_of(job, shallow, 9)
    _, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    ((_, path),) = lay_all(job.planned)
    depth = job.planned.thickness - path.contact.point[:, 2]
    wall = (depth > 0.5 * MM) & (depth < 3.0 * MM)
    off = found.along_z(path.contact.point[wall])
    assert np.isfinite(off).all()
    assert np.percentile(np.abs(off - depth[wall]), 98) < 0.1 * MM
    assert np.abs(off - depth[wall]).max() < 0.7 * MM
    assert 0.07 < found.stray / found.used < 0.13


def test_the_proof_makes_the_same_of_a_wall_that_came_back_whole(
    job: FormingJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its own code, from points alone; and not of what leaves out how much was formed at once."""
    cloud, marks = scan_of(job, np.minimum(LEVELS, 4.0 * MM)[:, None] * np.ones(24), 10)
    size, mesh = job.setup.stock.size, job.part.formed.mesh  # type: ignore[union-attr]
    pose, found = deviation.of_part(cloud, job.part, size, marks, True)
    ((one, path),) = laid = lay_all(job.planned)
    field = scan_field.Field(mesh, size, True, transform(pose.matrix, cloud.points))
    said = Measured("", 1.0, True, pose.matrix, np.zeros((2, 0, 3)), 1.0, frozenset())
    places = arc_length(path.former)
    at = np.arange(0.0, places[-1], MM)
    touch = along(path.contact.point, places, at)[:, :2]
    radius = job.planned.heads[job.planned.former(one)].radius
    none = (np.zeros(1), np.zeros(1))
    least, most, share = scan_field.shifts(field, said, none, one.side, touch, at, radius, 0.05)
    assert share == 1.0
    for exponent in (forming_rate.EXPONENT, 0.0):
        monkeypatch.setattr(forming_rate, "EXPONENT", exponent)
        limits = Springback(file=Path("a.json"))
        (made,) = adjustment.adjusted(job.planned, laid, None, found, True, 1.0, limits)
        got = np.interp(at, arc_length(made.way.point), made.way.shift)
        off = np.abs(got - np.clip(got, least, most))
        assert bool((off < 0.1 * MM + 0.05 * got + 0.025 * MM).all()) == (exponent > 0.0)


def test_the_gain_is_the_share_that_is_made_up_for(job: FormingJob) -> None:
    laid = lay_all(job.planned)
    even = np.outer(np.sqrt(LEVELS / LEVELS[-1]), np.full(24, 1.0 * MM))
    scan = scan_of(job, even, 3)
    whole, half = (next_one(job, laid, None, scan, gain)[0] for gain in (1.0, 0.5))
    deep = whole.point[:, 2] < -5.0 * MM
    ((_, path),) = laid
    for one, gain in ((whole, 1.0), (half, 0.5)):
        shift = at_targets(one.way, path)[deep]
        np.testing.assert_allclose(shift, gain * one.before[deep], atol=0.08 * MM)
        np.testing.assert_allclose(one.foretold[deep], one.before[deep] - shift, atol=0.02 * MM)


@pytest.mark.long
def test_too_deep_a_part_is_formed_less_deep_but_never_above_the_path(job: FormingJob) -> None:
    laid = lay_all(job.planned)
    ((_, path),) = laid
    deep = np.outer(LEVELS / LEVELS[-1], np.full(24, -0.6 * MM))
    (first,) = next_one(job, laid, None, scan_of(job, -2.0 * deep, 4))
    given = Compensation("a.json", (first.way,), 0.05, scan="scan.ply")
    (second,) = next_one(job, laid, given, scan_of(job, deep, 5))
    low = path.contact.point[:, 2] < -10.0 * MM
    off = at_targets(first.way, path) - at_targets(second.way, path)
    assert (off[low] > 0.2 * MM).all()
    (none,) = next_one(job, laid, None, scan_of(job, deep, 6))
    assert float(none.way.shift.max()) < 0.05 * MM
    assert float(none.way.shift.min()) >= 0.0
    assert np.nanmin(none.foretold) < -0.4 * MM  # and that is told


def test_a_scan_that_shows_too_little_is_refused_with_the_place(job: FormingJob) -> None:
    laid = lay_all(job.planned)
    cloud, marks = scan_of(job, np.zeros((20, 24)), 7)
    pose, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    assert pose.marks
    bare = found.seen[:, 0] < 0.01
    less = dataclasses.replace(found, seen=found.seen[bare], rise=found.rise[bare])
    with pytest.raises(
        TandemError, match=r"shows \d+ % of its way, allowed 70 % or more; nothing is known at"
    ) as error:
        adjustment.adjusted(job.planned, laid, None, less, True, 1.0, Springback(file=Path("a.json")))
    assert error.value.issues[0].code == "scan.hole"


def test_more_than_the_problem_allows_is_refused(job: FormingJob) -> None:
    cloud, marks = scan_of(job, np.outer(LEVELS / LEVELS[-1], np.full(24, 2.0 * MM)), 8)
    _, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    limits = Springback(file=Path("a.json"), most_mm=1.0)
    with pytest.raises(TandemError, match="most_mm allows 1 mm"):
        adjustment.adjusted(job.planned, lay_all(job.planned), None, found, True, 1.0, limits)
