"""The measurements of `python -m bench scan`, at a size that tests can afford: same parts, fields, bounds."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from bench import scan_bench
from planner.geometry.units import DEG, MM
from planner.shopfloor.scan import freedoms
from tests.shopfloor.scan.synthetic_scan import SyntheticScan

COUNT = 20_000


@pytest.mark.parametrize(("name", "seed"), [("dish", 1), ("dish with a dome", 2), ("pit", 3)])
def test_small_scans_meet_the_bounds_of_large_ones(name: str, seed: int) -> None:
    job = scan_bench.jobs()[name]
    made = scan_bench.scan(job, COUNT, seed)
    pose, found = scan_bench.fit_scan(job, made, marks=True)
    deviation = scan_bench.fit_error(job, made, pose.matrix, found)
    assert deviation.field < 0.05 * MM
    assert deviation.displacement < 0.05 * MM
    assert deviation.rotation < 0.05 * DEG
    assert deviation.known > 0.9
    assert len(found.holes) >= 1
    # the reported bound holds
    assert deviation.displacement < 3.0 * pose.position_sigma
    assert deviation.rotation < 3.0 * pose.rotation_sigma


def test_without_marks_height_and_tilt_hold_and_a_place_beside_the_part_is_told() -> None:
    job = scan_bench.jobs()["pit"]
    made = scan_bench.scan(job, COUNT, 4)
    right = scan_bench.displace_scan(made, (0.0, 0.0), 0.0)
    pose, found = scan_bench.fit_scan(job, right, marks=False)
    deviation = scan_bench.fit_error(job, right, pose.matrix, found)
    assert deviation.field < 0.05 * MM
    assert deviation.height < 0.05 * MM
    assert deviation.tilt < 0.05 * DEG
    assert not freedoms.in_plane_motion(found).is_offset
    wrong = scan_bench.displace_scan(made, scan_bench.LATERAL_OFFSET_M, scan_bench.ROTATION_RAD)
    pose, found = scan_bench.fit_scan(job, wrong, marks=False)
    told = freedoms.in_plane_motion(found)
    assert scan_bench.fit_error(job, wrong, pose.matrix, found).field > 0.2 * MM
    assert told.is_offset
    np.testing.assert_allclose(told.move, -np.array(scan_bench.LATERAL_OFFSET_M), atol=0.3 * MM)


def small(name: str) -> tuple[scan_bench.ScanJob, SyntheticScan]:
    job = scan_bench.jobs()[name]
    return job, scan_bench.scan(job, COUNT, 5)


def test_a_fit_to_the_formed_part_takes_what_came_back_for_a_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan_bench, "PLAIN_POINTS", 3000)
    monkeypatch.setattr(scan_bench, "PEER_POINTS", 50_000)
    job, made = small("dish")
    row = scan_bench.peer_row("a plain fit", job, made, scan_bench.plain_icp, 1.0)
    place, field = map(float, re.findall(r"(?:place|field) ([0-9.]+) mm", row["note"]))
    assert place > 0.1
    assert field > 0.1


def test_a_peer_that_is_not_there_is_skipped_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    job, made = small("dish")
    row = scan_bench.peer_row("small_gicp", job, made, scan_bench.by_small_gicp, 1.0)
    assert row["note"].startswith("skipped: ")
    assert "small_gicp" in row["note"]
    assert "median_s" not in row
