"""Ridges of constant steps on a cone and on a dome, against the closed form for a ball between two paths."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.mesh import TriangleMesh
from planner.processes.forming.plan.paths import level_lines

RADIUS, STEP = 5e-3, 1e-3


def surface_of_revolution(radius: np.ndarray, z: np.ndarray, around: int = 240) -> TriangleMesh:
    """A surface of revolution, outermost ring first, normals up."""
    turn = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rings = np.stack(
        [np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn)), np.tile(z[:, None], around)], -1
    )
    index = np.arange(len(radius) * around).reshape(len(radius), around)
    a, b, c, d = index[:-1], np.roll(index, -1, 1)[:-1], np.roll(index, -1, 1)[1:], index[1:]
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    return TriangleMesh(rings.reshape(-1, 3), faces)


def between(width: np.ndarray | float) -> np.ndarray:
    """Return the height of the ridge between two paths of the ball ``width`` apart (Pythagoras)."""
    return np.asarray(RADIUS - np.sqrt(RADIUS**2 - (0.5 * np.asarray(width)) ** 2))


@pytest.mark.parametrize("angle_deg", [30.0, 60.0])
def test_on_a_cone_the_ridge_is_that_of_its_wall(angle_deg: float) -> None:
    """Far from the cone's ends nothing is flatter than its wall."""
    slope = np.tan(np.radians(angle_deg))
    radius = np.linspace(0.06, 0.03, 40)
    cone = surface_of_revolution(
        np.concatenate([[0.08], radius]), np.concatenate([[0.0], (radius - 0.06) * slope])
    )
    found = level_lines.ridge_heights(cone, RADIUS, STEP, 0.95)
    middle = cone.vertices[cone.faces].mean(axis=1)
    wall = np.hypot(middle[:, 0], middle[:, 1]) < 0.055
    np.testing.assert_allclose(found[wall], between(STEP / np.sin(np.radians(angle_deg))), rtol=2e-3)


def test_on_a_dome_it_is_that_of_a_flatter_place_within_a_step() -> None:
    """No lower than on a wall as steep as there, no higher than between the two ways that are next above."""
    sphere = 0.06
    angle = np.radians(np.linspace(70.0, 1.0, 140))
    dome = surface_of_revolution(sphere * np.sin(angle), sphere * np.cos(angle))
    found = level_lines.ridge_heights(dome, RADIUS, STEP, 0.95)
    middle = dome.vertices[dome.faces].mean(axis=1)
    here = np.arccos(np.clip(middle[:, 2] / np.linalg.norm(middle, axis=1), -1.0, 1.0))
    use = (here > np.radians(25.0)) & (here < np.radians(65.0))
    up = np.arccos(np.cos(here[use]) + STEP / sphere)
    above = np.arccos(np.cos(up) + STEP / sphere)
    assert np.all(found[use] >= between(STEP / np.sin(here[use])) * 0.99)
    assert np.all(found[use] <= between(sphere * (up - above)) * 1.01)


def test_a_fine_mesh_says_the_same_as_a_coarse_one() -> None:
    sphere = 0.06
    for count in (60, 400):
        angle = np.radians(np.linspace(70.0, 1.0, count))
        dome = surface_of_revolution(sphere * np.sin(angle), sphere * np.cos(angle))
        middle = dome.vertices[dome.faces].mean(axis=1)
        here = np.degrees(np.arccos(np.clip(middle[:, 2] / np.linalg.norm(middle, axis=1), -1.0, 1.0)))
        found = level_lines.ridge_heights(dome, RADIUS, STEP, 0.95)[np.abs(here - 45.0) < 1.5]
        assert found.mean() == pytest.approx(float(between(STEP / np.sin(np.radians(43.7)))), rel=0.05)
