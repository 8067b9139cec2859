"""One level of a pass: its path is the whole loop, from seam to seam, for all kinds of paths."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from planner import pipeline
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.processes import registry
from planner.processes.forming.plan import level as one_level
from planner.processes.forming.plan.contact import ContactPath
from planner.processes.forming.plan.job import FormingJob
from tests import small_forming
from tests.processes.forming.plan import shapes


def contact(folder: Path, number: int, **operation: Any) -> ContactPath:
    """The path of a level of a square pit of 60 mm, on whose sides targets are 20 mm apart."""
    data = small_forming.problem("spif", stepdown_mm=1.0, level={"number": number}, **operation)
    part = shapes.pit(shapely.box(-0.03, -0.03, 0.03, 0.03), 45.0, 0.010)
    job = registry.job(pipeline.load(small_forming.write(folder, data, part)), 0)
    assert isinstance(job, FormingJob)
    level = job.operation.level
    assert level is not None
    one = one_level.level_pass(job.planned, level)
    return one_level.make_level_path(job.planned, one, level).contact


@pytest.mark.long
def test_a_level_of_a_spiral_begins_where_the_one_before_ends(tmp_path: Path) -> None:
    found = [contact(tmp_path, number) for number in range(6)]
    for one, two in itertools.pairwise(found):
        assert two.point[0] == pytest.approx(one.point[-1], abs=1e-6)
    for one in found[1:-1]:
        assert np.unique(one.loop).tolist() == [0]
        assert abs(one.point[-1, 2] - one.point[0, 2]) == pytest.approx(1.0 * MM, abs=1e-5)
        # once around, from the seam on +x to the seam
        assert one.point[[0, -1], 1] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("path", ["contour", "alternating", "stepped"])
def test_a_level_of_loops_is_closed(tmp_path: Path, path: str) -> None:
    for number in (1, 2, 4):
        found = contact(tmp_path, number, path=path).centre
        assert found[0, :2] == pytest.approx(found[-1, :2], abs=1e-6)


def test_a_seam_in_a_corner_leaves_no_more_than_the_corner(tmp_path: Path) -> None:
    one, two = (contact(tmp_path, number, seam_deg=45.0) for number in (2, 3))
    assert np.linalg.norm(two.point[0] - one.point[-1]) < 0.3 * MM


def test_a_last_level_that_ends_above_its_own_end_is_refused(tmp_path: Path) -> None:
    # a ball of 6 mm in a sharp fold of 45 degrees touches the wall 1.8 mm above the floor at the lowest
    with pytest.raises(TandemError) as error:
        contact(tmp_path, 8)
    (issue,) = error.value.issues
    assert (issue.code, issue.field) == ("forming.path_options", "level.number")
    assert "8.00 to 9.00 mm" in issue.message
