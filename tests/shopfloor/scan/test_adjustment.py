"""Adjustments by synthetic scans: rounds against sheets whose truth is known, gain, limits and refusals."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray, transform
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.springback.compensation import shift_at_targets
from planner.processes.forming.plan.springback.compensation_file import SpringbackFile
from planner.processes.forming.proof import scan_field
from planner.processes.forming.proof.springback_file import ScanData
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import adjustment, deviation, forming_rate
from planner.shopfloor.scan.cloud import Cloud
from tests.shopfloor.scan import rounds
from tests.shopfloor.scan.rounds import GIVES_WAY, KINDS, FormingRounds, adjust_paths

LEVELS = np.arange(1.0, 21.0) * MM


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    return rounds.forming_job(tmp_path_factory.mktemp("cone"), KINDS["cone"])


def simulate_scan(job: FormingJob, shallow: FloatArray, seed: int) -> tuple[Cloud, ProbedPoints]:
    return rounds.simulate_scan(job, LEVELS, shallow, seed)


@pytest.mark.long
def test_two_rounds_leave_two_tenths_and_the_third_changes_nothing(job: FormingJob) -> None:
    """Below the first three millimetres, where the plant's sheet gives way before it forms at all."""
    left = [np.abs(item) for item in FormingRounds(job, KINDS["cone"]).run(seed=1, count=3)]
    below = [item[GIVES_WAY:] for item in left]
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
    cloud, marks = simulate_scan(job, shallow, 9)
    _, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    ((_, path),) = make_tool_paths(job.planned)
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
    cloud, marks = simulate_scan(job, np.minimum(LEVELS, 4.0 * MM)[:, None] * np.ones(24), 10)
    size, mesh = job.setup.stock.size, job.part.formed.mesh  # type: ignore[union-attr]
    pose, found = deviation.of_part(cloud, job.part, size, marks, True)
    ((item, path),) = laid = make_tool_paths(job.planned)
    field = scan_field.ScanField(mesh, size, True, transform(pose.matrix, cloud.points))
    said = ScanData("", 1.0, True, pose.matrix, np.zeros((2, 0, 3)), 1.0, frozenset())
    places = arc_length(path.forming_centre)
    at = np.arange(0.0, places[-1], MM)
    touch = interpolate_polyline(path.contact.point, places, at)[:, :2]
    radius = job.planned.heads[job.planned.forming_arm(item)].radius
    none = scan_field.ShiftProfile(arc=np.zeros(1), shift=np.zeros(1))
    touched_path = scan_field.TouchedPath(plan=touch, arc=at, side=item.side, radius=radius)
    least, most, fraction = scan_field.shift_bounds(field, said, none, touched_path, 0.05)
    assert fraction == 1.0
    registered = adjustment.RegisteredScan(cloud, marks, pose, found, top=True)
    step = adjustment.AdjustmentStep(None, 1.0, Springback(file=Path("a.json")))
    for exponent in (forming_rate.EXPONENT, 0.0):
        monkeypatch.setattr(forming_rate, "EXPONENT", exponent)
        (made,) = adjustment.adjusted(job.planned, laid, registered, step)
        got = np.interp(at, arc_length(made.tool_path.point), made.tool_path.shift)
        off = np.abs(got - np.clip(got, least, most))
        assert bool((off < 0.1 * MM + 0.05 * got + 0.025 * MM).all()) == (exponent > 0.0)


def test_the_gain_is_the_share_that_is_made_up_for(job: FormingJob) -> None:
    laid = make_tool_paths(job.planned)
    even = np.outer(np.sqrt(LEVELS / LEVELS[-1]), np.full(24, 1.0 * MM))
    scan = simulate_scan(job, even, 3)
    whole, half = (adjust_paths(job, laid, None, scan, gain)[0] for gain in (1.0, 0.5))
    deep = whole.point[:, 2] < -5.0 * MM
    ((_, path),) = laid
    for item, gain in ((whole, 1.0), (half, 0.5)):
        shift = shift_at_targets(item.tool_path, path)[deep]
        np.testing.assert_allclose(shift, gain * item.shallowness[deep], atol=0.08 * MM)
        np.testing.assert_allclose(item.foretold[deep], item.shallowness[deep] - shift, atol=0.02 * MM)


@pytest.mark.long
def test_too_deep_a_part_is_formed_less_deep_but_never_above_the_path(job: FormingJob) -> None:
    laid = make_tool_paths(job.planned)
    ((_, path),) = laid
    deep = np.outer(LEVELS / LEVELS[-1], np.full(24, -0.6 * MM))
    (first,) = adjust_paths(job, laid, None, simulate_scan(job, -2.0 * deep, 4))
    given = SpringbackFile("a.json", (first.tool_path,), 0.05, scan="scan.ply")
    (second,) = adjust_paths(job, laid, given, simulate_scan(job, deep, 5))
    low = path.contact.point[:, 2] < -10.0 * MM
    deviation = shift_at_targets(first.tool_path, path) - shift_at_targets(second.tool_path, path)
    assert (deviation[low] > 0.2 * MM).all()
    (none,) = adjust_paths(job, laid, None, simulate_scan(job, deep, 6))
    assert float(none.tool_path.shift.max()) < 0.05 * MM
    assert float(none.tool_path.shift.min()) >= 0.0
    assert np.nanmin(none.foretold) < -0.4 * MM  # and that is reported


def test_a_scan_that_shows_too_little_is_refused_with_the_place(job: FormingJob) -> None:
    laid = make_tool_paths(job.planned)
    cloud, marks = simulate_scan(job, np.zeros((20, 24)), 7)
    pose, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    assert pose.marks
    bare = found.seen[:, 0] < 0.01
    less = dataclasses.replace(found, seen=found.seen[bare], rise=found.rise[bare])
    registered = adjustment.RegisteredScan(cloud, marks, pose, less, top=True)
    step = adjustment.AdjustmentStep(None, 1.0, Springback(file=Path("a.json")))
    with pytest.raises(
        TandemError, match=r"shows \d+ % of its path, allowed 70 % or more; there are no points at"
    ) as error:
        adjustment.adjusted(job.planned, laid, registered, step)
    assert error.value.issues[0].code == "scan.hole"


def test_more_than_the_problem_allows_is_refused(job: FormingJob) -> None:
    cloud, marks = simulate_scan(job, np.outer(LEVELS / LEVELS[-1], np.full(24, 2.0 * MM)), 8)
    pose, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    registered = adjustment.RegisteredScan(cloud, marks, pose, found, top=True)
    step = adjustment.AdjustmentStep(None, 1.0, Springback(file=Path("a.json"), most_mm=1.0))
    with pytest.raises(TandemError, match="most_mm allows 1 mm"):
        adjustment.adjusted(job.planned, make_tool_paths(job.planned), registered, step)
