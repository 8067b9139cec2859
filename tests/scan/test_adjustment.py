"""Rounds of forming, scanning and adjusting against sheets whose truth is known: `planner.loops.plant`, which
knows nothing of adjustments; the scans are made up of what it formed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree

from planner import pipeline, processes
from planner.align.probing import ProbedPoints
from planner.forming.contact import ToolPath
from planner.forming.job import FormingJob
from planner.forming.operation import Springback
from planner.forming.process_plan import lay_all
from planner.forming.springback.compensation import at_targets
from planner.forming.springback.compensation_file import Compensation
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.loops.plant import PlantFile, Sheets
from planner.scan import adjustment, deviation
from planner.scan.adjustment import Adjusted
from planner.scan.cloud import Cloud
from tests import small_forming
from tests.forming.shapes import revolved
from tests.scan.made_scan import made_scan

TURN = 2.0 * np.pi * np.arange(24) / 24
LEVELS = np.arange(1.0, 21.0) * MM


def cone() -> Mesh:
    """The plant's cone: 45 degrees from a circle of 50 mm, 20 mm deep."""
    radius = np.concatenate([[58.0], np.linspace(50.0, 30.0, 41), [15.0, 0.0]])
    depth = np.concatenate([[0.0], np.linspace(0.0, 20.0, 41), [20.0, 20.0]])
    return revolved([(float(r) * MM, float(-z) * MM) for r, z in zip(radius, depth, strict=True)], 120)


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    data = small_forming.problem("spif", stepdown_mm=1.0, force_n=620, unreached_mm=5)
    data["sheet"] |= {"size_mm": [260, 260], "opening_mm": 180, "metal": "aa5754_o"}
    path = small_forming.write(tmp_path_factory.mktemp("cone"), data, cone())
    (found,) = processes.jobs(pipeline.load(path))
    assert isinstance(found, FormingJob)
    return found


def formed(path: ToolPath, shift: FloatArray, thick: float, seed: int) -> FloatArray:
    """How much too shallow (L, 24) [m] a sheet of the plant is, by level and around, after it was formed with
    a ``shift`` (N,) [m] at the path's targets."""

    def ring(depth: float) -> FloatArray:
        return np.asarray((50.0 * MM - depth) * np.column_stack([np.cos(TURN), np.sin(TURN)]))

    sheets = Sheets(PlantFile(tandem_plant=1, sheet="cone"), [seed], ring(LEVELS[0]))
    touched, out = KDTree(path.contact.point), []
    for depth in LEVELS:
        place = np.column_stack([ring(depth), np.full(len(TURN), thick - depth)])
        sheets.form(
            depth, 1.0 * MM, (depth + shift[touched.query(place, k=4)[1]].mean(axis=1))[None], place[:, :2]
        )
        out.append(depth - sheets.depth[0])
    return np.array(out)


def scan_of(job: FormingJob, shallow: FloatArray, seed: int) -> tuple[Cloud, ProbedPoints]:
    thick, around = job.planned.thickness, np.append(TURN, 2.0 * np.pi)
    rows = np.vstack([np.zeros(24), shallow])
    field = RegularGridInterpolator(
        (np.append(0.0, LEVELS), around),
        np.column_stack([rows, rows[:, 0]]),
        bounds_error=False,
        fill_value=None,
    )

    def off(q: FloatArray) -> FloatArray:
        angle = np.mod(np.arctan2(q[:, 1], q[:, 0]), 2.0 * np.pi)
        return np.asarray(field(np.column_stack([np.clip(thick - q[:, 2], 0.0, LEVELS[-1]), angle])))

    made = made_scan(cone(), job.setup.stock.size, off, seed, along_z=True)
    return Cloud("scan.ply", "0" * 64, made.points, 0), ProbedPoints(tuple("abcd"), made.sheet, made.scan)


def next_one(
    job: FormingJob,
    laid: Any,
    given: Compensation | None,
    scan: tuple[Cloud, ProbedPoints],
    gain: float = 1.0,
) -> tuple[Adjusted, ...]:
    cloud, marks = scan
    _, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    return adjustment.adjusted(job.planned, laid, given, found, True, gain, Springback(file=Path("a.json")))


def test_two_rounds_leave_two_tenths_and_the_third_changes_nothing(job: FormingJob) -> None:
    """Below the first three millimetres, where the plant's sheet gives way before it forms at all and all of
    the depth comes back: 95 in 100 places, and half as much in the mean."""
    laid = lay_all(job.planned)
    ((_, path),) = laid
    given: Compensation | None = None
    shift, left = np.zeros(len(path.former)), []
    for number in range(4):
        shallow = formed(path, shift, job.planned.thickness, seed=1)
        left.append(np.abs(shallow[3:]))
        (one,) = next_one(job, laid, given, scan_of(job, shallow, number))
        given = Compensation("a.json", (one.way,), 0.05, scan="scan.ply")
        shift = at_targets(one.way, path)
    assert left[0].mean() > 4.0 * MM
    assert np.percentile(left[2], 95) <= 0.2 * MM
    assert left[2].mean() <= 0.1 * MM
    assert np.percentile(np.abs(left[3] - left[2]), 95) <= 0.2 * MM
    assert left[2].max() <= 0.3 * MM


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
        np.testing.assert_allclose(one.foretold[deep], one.before[deep] - shift, atol=1e-9)


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
