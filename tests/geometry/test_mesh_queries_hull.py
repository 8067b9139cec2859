"""A convex solid with few corners holds all points and is hardly larger than their hull."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from planner.geometry.mesh_queries import MAX_HULL_CORNERS, outer_hull


def test_a_simple_hull_is_taken_as_it_is() -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    found = outer_hull(np.asarray(box.vertices))
    assert trimesh.Trimesh(found.vertices, found.faces).volume == pytest.approx(0.006)


def test_a_round_solid_is_held_by_few_corners() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(size=(4000, 3))
    points *= np.array([0.2, 0.2, 0.1]) / np.linalg.norm(points, axis=1, keepdims=True)
    found = outer_hull(points)
    solid = trimesh.Trimesh(found.vertices, found.faces)
    solid.fix_normals()
    assert MAX_HULL_CORNERS < len(found.vertices) < 400
    away = np.einsum("fd,pfd->pf", solid.face_normals, points[:, None] - solid.triangles[None, :, 0])
    assert away.max() < 1e-9
    assert solid.volume < 1.15 * 4.0 / 3.0 * np.pi * 0.2 * 0.2 * 0.1


def test_flat_points_are_refused() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    rotated = square @ np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0] + [5.0, -3.0, 2.0]
    for points in (square, rotated, np.repeat(rotated, 30, axis=0), square[:3], square[[0, 1, 1, 0, 1]]):
        with pytest.raises(ValueError, match="plane"):
            outer_hull(points)
