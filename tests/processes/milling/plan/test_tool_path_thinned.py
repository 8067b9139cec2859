"""Thinned paths: removed targets lie on the remaining moves, tip and axis at the same instant."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planner.geometry.polylines import thin_rows

CHORD, LEVER = 2e-5, 0.05


def points(tip: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Tip and a point on the axis (N, 2, 3) of tools that go along x and lean by angles (N,) in the plane."""
    axis = np.stack([np.sin(tilt), 0.0 * tilt, np.cos(tilt)], axis=1)
    return np.stack([tip, tip + LEVER * axis], axis=1)


@pytest.mark.parametrize("wave", [0.004, 0.02, 0.2])
def test_rows_left_out_are_met_by_tip_and_axis_at_one_moment(wave: float) -> None:
    """By brute force over a thousand moments of each move that stays."""
    x = np.linspace(0.0, 0.06, 601)
    tip = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    tools = points(tip, 0.25 * np.cos(x / wave))
    rows = thin_rows(tools, CHORD, 1.0)
    assert rows[0] == 0 and rows[-1] == 600 and (np.diff(rows) > 0).all()
    moment = np.linspace(0.0, 1.0, 1001)[:, None, None]
    for first, last in itertools.pairwise(rows):
        moves = tools[first] + moment * (tools[last] - tools[first])
        for row in range(first + 1, last):
            deviation = np.linalg.norm(moves - tools[row], axis=2).max(axis=1).min()
            assert (
                deviation < 1.5 * CHORD
            )  # the moment that is nearest on the whole need not be the very best


def test_an_axis_that_leans_while_its_tip_goes_evenly_is_kept() -> None:
    """Each point stays on one line, but the axis runs ahead of the tip: no straight move does that."""
    x = np.linspace(0.0, 0.004, 5)
    tip = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    even = points(tip, np.full(5, 0.1))
    assert thin_rows(even, CHORD, 1.0).tolist() == [0, 4]
    ahead = even.copy()
    ahead[1:4, 1, 0] += 0.001
    assert thin_rows(ahead, CHORD, 1.0).tolist() != [0, 4]
