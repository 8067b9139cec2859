"""Penetration of points into a moving tool head, against plane geometry at every row."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.processes.forming.proof import swept_volume
from planner.processes.forming.proof.swept_volume import MAX_CHECK_STEP_M, HeadPath, ToolHead

RADIUS, LONG = 0.008, 0.12
PROFILE = np.array([[0.0, RADIUS], [LONG, RADIUS]])


def _circling_cylinder(seed: int, rise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a circling cylinder of varying tilt, in steps of 0.05 mm, over a rising surface."""
    rng = np.random.default_rng(seed)
    count = 6000
    along = np.linspace(0.0, 1.0, count)
    turn = 2.0 * np.pi * along * 1.2 + rng.uniform(0.0, 6.0)
    centre = np.stack([0.04 * np.cos(turn), 0.04 * np.sin(turn), 0.004 + 0.002 * np.sin(5.0 * turn)], axis=1)
    tilt = 0.3 * np.sin(3.0 * turn)
    axis = np.stack([np.sin(tilt), np.zeros(count), -np.cos(tilt)], axis=1)
    return centre, axis, rise * along


@pytest.mark.parametrize("rise", [0.0, 0.006])
def test_the_deepest_point_is_found_all_along_the_way(rise: float) -> None:
    """A point is inside a cylinder by the least of what it is off the mantle and the front; the rear is open.
    Between looks no place of the tool goes farther than half of ``LOOK_STEP``."""
    centre, axis, up = _circling_cylinder(4, rise)
    points = np.random.default_rng(5).uniform([-0.06, -0.06, -0.01], [0.06, 0.06, 0.03], (400, 3))
    deep, rows = ToolHead.from_profile(PROFILE, 0.0).penetration(
        points, HeadPath.from_rows(centre, axis, up, LONG), 1e-4
    )
    rest = points[None] + up[:, None, None] * np.array([0.0, 0.0, 1.0]) - centre[:, None]
    behind = -np.einsum("tpd,td->tp", rest, axis)
    beside = np.sqrt((rest**2).sum(axis=2) - behind**2)
    inside = np.minimum(RADIUS - beside, behind)
    inside[behind > LONG] = -1.0
    exact = inside.max(axis=1)
    assert exact.max() > 0.003
    assert (exact < 0.0).any()
    found = np.full(len(centre), -np.inf)
    found[rows] = deep
    there = (found > 0.0) & (behind.max(axis=1) < LONG)
    np.testing.assert_allclose(found[there], exact[there], atol=1e-9)
    for row in np.flatnonzero(exact > 0.5 * MAX_CHECK_STEP_M + 1e-4):
        nearest = rows[np.argmin(np.abs(rows - row))]
        assert found[nearest] >= exact[row] - 0.5 * MAX_CHECK_STEP_M


def test_a_disk_flat_on_a_sheet_has_nothing_inside_until_it_dips() -> None:
    grid = np.stack(np.meshgrid(np.arange(-60, 61, 2), np.arange(-20, 21, 2)), axis=-1).reshape(-1, 2) * 1e-3
    points = np.column_stack([grid, np.zeros(len(grid))])
    centre = np.column_stack([np.linspace(-0.04, 0.04, 2001), np.zeros(2001), np.zeros(2001)])
    axis = np.tile([0.0, 0.0, -1.0], (2001, 1))
    head = ToolHead.from_profile(PROFILE, 0.0)
    deep, _ = head.penetration(points, HeadPath.from_rows(centre, axis, np.zeros(2001), LONG), 5e-5)
    assert len(deep) == 0
    centre[1000:, 2] -= 4e-4
    way = HeadPath.from_rows(centre, axis, np.zeros(2001), LONG)
    deep, rows = head.penetration(points, way, 5e-5)
    assert set(way.rows[way.rows >= 1000]) == set(rows[deep > 5e-5])
    np.testing.assert_allclose(deep[deep > 5e-5], 4e-4, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 37, 1999])
def test_looks_are_the_same_however_many_rows_are_worked_out_at_once(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    centre, axis, up = (part[:2000] for part in _circling_cylinder(6, 0.004))
    whole = HeadPath.from_rows(centre, axis, up, LONG)
    assert 100 < len(whole.rows) < 2000
    monkeypatch.setattr(swept_volume, "_ROWS_AT_ONCE", count)
    parts = HeadPath.from_rows(centre, axis, up, LONG)
    for field in dataclasses.fields(whole):
        assert np.array_equal(getattr(parts, field.name), getattr(whole, field.name)), field.name
