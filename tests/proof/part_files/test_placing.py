"""The pose of a part that the problem places freely: recovered from the cut surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.arrays import from_rpy, transform
from planner.proof.part_files import comparison, on_triangles


def panel(x: np.ndarray, y: np.ndarray, sag: tuple[float, float]) -> np.ndarray:
    """A sheet bent to a radius of 0.78 m along x whose section sags from one amount to another [m]."""
    fraction = (x - x.min()) / np.ptp(x)
    bow = sag[0] + fraction * (sag[1] - sag[0])
    return np.asarray(np.sqrt(0.78**2 - x**2) - 0.78 - bow * (y / 0.07) ** 2)


def facets(sag: tuple[float, float]) -> np.ndarray:
    """Triangles (F, 3, 3) of such a panel of 280 x 140 mm."""
    x, y = np.meshgrid(np.linspace(-0.14, 0.14, 141), np.linspace(-0.07, 0.07, 71), indexing="ij")
    grid = np.stack([x, y, panel(x, y, sag)], axis=-1)
    a, b, c, d = (grid[i : i - 1 or None, j : j - 1 or None] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    two = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    return np.asarray(two.reshape(-1, 3, 3))


@pytest.mark.parametrize("sag", [(0.005, 0.019), (0.003, 0.006), (0.0, 0.012)])
def test_a_gentle_panel_is_found_where_it_lies(sag: tuple[float, float]) -> None:
    """Its form says how it is turned in its own plane, better than places do that are a millimetre apart."""
    made = facets(sag)
    box = made.reshape(-1, 3)
    middle = 0.5 * (box.min(axis=0) + box.max(axis=0))
    away = from_rpy([0.3, -0.2, 0.1], [1.2, 0.4, -2.0])
    read = transform(away, box).reshape(made.shape)
    rows = np.arange(len(made)) + 1
    source = on_triangles(read, rows, 600)
    at = comparison.aligned_pose([source], [on_triangles(made, rows, 20_000)], read.reshape(-1, 3), middle)
    x, y, z = source.moved(at).points.T
    deviation = np.abs(z - panel(np.clip(x, -0.14, 0.14), y, sag))
    assert np.percentile(deviation, 99) < 2e-5
    assert np.abs(at @ away - np.eye(4)).max() < 2e-3


def test_the_back_of_a_panel_that_is_alike_on_both_sides_is_no_place_for_its_front() -> None:
    """A wave turned over lies on itself: only which face is which tells the two places apart."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 81), np.linspace(-0.3, 0.3, 121), indexing="ij")
    wave = (0.02 + 0.01 * y) * np.sin(8.0 * x)
    corners = []
    for rise, sense in ((0.014, 1), (-0.014, -1)):
        grid = np.stack([x, y, wave + rise], axis=-1)
        a, b, c, d = (grid[i : i - 1 or None, j : j - 1 or None] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
        two = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
        corners.append(two[:, ::sense])
    rows = np.arange(len(corners[0])) + 1
    made = [on_triangles(face, rows, 10_000) for face in corners]
    for turn in (0.0, np.pi):
        away = from_rpy([0.1, 0.0, 0.0], [0.0, turn, 0.0])
        read = [transform(away, face.reshape(-1, 3)).reshape(face.shape) for face in corners]
        source = [on_triangles(face, rows, 600) for face in read]
        at = comparison.aligned_pose(source, made, np.concatenate(read).reshape(-1, 3), np.zeros(3))
        assert np.abs(at @ away - np.eye(4)).max() < 5e-3
