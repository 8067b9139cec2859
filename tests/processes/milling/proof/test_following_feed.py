"""The feed along a path, and programs that exceed it where the file states a lower one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from planner.claims.segments import Segment
from planner.processes.milling.claims import MillsAlong
from planner.processes.milling.plan.tool_path import insert_near_changes
from planner.processes.milling.proof.path_following import (
    FEED_TOLERANCE_FACTOR,
    match_path,
    max_feeds,
    range_maxima,
    rows_to_check,
)
from tests.processes.milling.plan.small_mill import BALL, PANEL
from tests.processes.milling.proof.milling_job import Job, in_procedure

TOLERANCE = 0.2e-3
FILE = """G21 G90 G17 G94
M3 S6000
G0 X-50 Y-10 Z10
G1 Z2 F600
X-20 F3000
X-10 F300
X0 F2000
G3 X10 Y0 I0 J10 F200
G1 Y20 F2400
X-50 F2520
Y-5 F120
Y-20 F240
X40
G0 Z10
M5
"""


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp("feeds")
    (folder / "job.nc").write_text(FILE)
    cut = {"name": "prog", "gcode": {"file": "job.nc", "origin": {"xyz_mm": [0, 0, 30]}}}
    return Job(folder, PANEL, BALL, cuts=[cut], part=None)


def test_highest_is_that_of_every_stretch() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=500)
    first = rng.integers(0, 500, 3000)
    last = np.minimum(first + rng.integers(0, 500, 3000) ** 2 // 500, 499)
    expected = [values[a : b + 1].max() for a, b in zip(first, last, strict=True)]
    np.testing.assert_array_equal(range_maxima(values, first, last), expected)


def test_the_feed_changes_where_the_way_says() -> None:
    """A straight way with 10, 50 and 20 mm/s; two tolerances about each change either feed will do."""
    tip = np.array([[0.0, 0, 0], [30, 0, 0], [60, 0, 0], [90, 0, 0]]) * 1e-3
    axis = np.tile([0.0, 0.0, 1.0], (4, 1))
    claim = MillsAlong(
        Segment.read("mill/a"), "robot", tip, axis, np.array([0, 10, 50, 20]) * 1e-3, TOLERANCE, 0.01
    )
    x = np.linspace(0.0, 0.09, 1801)
    seen = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    axes = np.tile([0.0, 0.0, 1.0], (len(x), 1))
    some = rows_to_check(seen, axes, TOLERANCE)
    got = max_feeds(claim, some, match_path(claim, seen[some], axes[some]), len(x))
    sure = (FEED_TOLERANCE_FACTOR + 3.0) * TOLERANCE
    x = 0.5 * (x[1:] + x[:-1])
    for low, high, feed in ((0.0, 0.03, 0.01), (0.03, 0.06, 0.05), (0.06, 0.09, 0.02)):
        inner = (x > low + sure * (low > 0)) & (x < high - sure * (high < 0.09))
        assert np.all(got[inner] == feed)


def test_places_about_changes() -> None:
    tip = np.array([[0.0, 0, 0], [10, 0, 0], [11, 0, 0], [11.9, 0, 0], [12.1, 0, 0], [20, 0, 0]])
    change = np.array([False, True, True, True, True, False])
    to, tips, axes = insert_near_changes(tip, np.tile([0.0, 0.0, 1.0], (6, 1)), change, 0.4)
    np.testing.assert_allclose(tips[:, 0], [0, 9.6, 10, 10.4, 10.6, 11, 11.45, 11.9, 12.1, 12.5, 20])
    np.testing.assert_array_equal(to, [0, 1, 1, 2, 2, 2, 3, 3, 4, 5, 5])
    np.testing.assert_allclose(axes, np.tile([0.0, 0.0, 1.0], (len(tips), 1)))


def test_each_move_of_a_file_keeps_its_own_feed(job: Job) -> None:
    rule = job.prove(job.programs).rule("verify.mill_feed")
    assert rule.passed
    assert rule.worst is not None and 0.9 < rule.worst < 1.0
    # without the file's changes the pass takes as long as its moves do at their own feeds
    text = "".join(job.programs.values())
    body = text[text.index("PROC mill_prog_1()") :]
    times = [float(t) for t in re.findall(r"\\T:=([\d.]+)", body[: body.index("ENDPROC")])]
    ways = [(30, 3000), (10, 300), (10, 2000), (5 * np.pi, 200), (20, 2400), (60, 2520), (25, 120)]
    least = sum(60.0 * way / feed for way, feed in [*ways, (15, 240), (90, 240)])
    assert least < sum(times) < 1.2 * least


def test_a_slow_stretch_at_the_highest_feed_of_its_pass_is_caught(job: Job) -> None:
    """One move of some 5 mm at 2 mm/s is made to take a tenth of its time; 42 mm/s are allowed elsewhere."""

    def faster(text: str) -> str:
        times = [m for m in re.finditer(r"\\T:=([\d.]+)", text) if 2.0 < float(m[1]) < 3.0]
        one = times[len(times) // 2]
        return f"{text[: one.start(1)]}{0.1 * float(one[1]):.5f}{text[one.end(1) :]}"

    bad = in_procedure(job.programs, "mill_prog_1", faster)
    (issue,) = [i for i in job.prove(bad).issues if i.code == "verify.mill_feed"]
    assert issue.limit == pytest.approx(2.0)
