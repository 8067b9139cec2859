"""Meshes with fewer triangles: vertices stay within the cell that merges them, and edges are kept."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from planner.geometry.arrays import Mesh
from planner.geometry.decimation import merge_cells, split_creases

CELL = 0.008


def drum() -> Mesh:
    """A cylinder of 200 x 300 mm in 70,000 triangles, about z."""
    made = trimesh.creation.cylinder(0.1, 0.3, sections=300)
    made = made.subdivide_to_size(0.004)
    made.merge_vertices()
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces))


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("edges", [False, True])
def test_no_vertex_is_farther_than_the_diagonal_from_the_one_that_stands_for_it(edges: bool) -> None:
    fine = drum()
    few = merge_cells(fine, CELL, edges)
    assert len(few.faces) < len(fine.faces) / 3
    assert cKDTree(few.vertices).query(fine.vertices)[0].max() < CELL * np.sqrt(3.0)
    assert cKDTree(fine.vertices).query(few.vertices)[0].max() < CELL * np.sqrt(3.0)


@pytest.mark.long
def test_edges_stay_where_they_are() -> None:
    """Means are inside of the rim by millimetres; what is nearest to the planes is on it."""
    few = merge_cells(drum(), CELL, edges=True)
    x, y, z = few.vertices.T
    ends = np.abs(z) > 0.149
    assert np.abs(np.abs(z[ends]) - 0.15).max() < 1e-5
    radius = np.hypot(x, y)
    assert radius.max() < 0.1 + 1e-4
    sides = np.abs(z) < 0.15 - CELL
    assert np.abs(radius[sides] - 0.1).max() < 3e-4
    rim = few.vertices[ends & (radius > 0.099)]
    turned = np.sort(np.arctan2(rim[:, 1], rim[:, 0])[rim[:, 2] > 0.0])
    assert np.diff(turned).max() < np.deg2rad(10.0)
    assert np.median(np.hypot(rim[:, 0], rim[:, 1])) == pytest.approx(0.1, abs=2e-4)


def test_faces_that_are_turned_share_no_vertex() -> None:
    """A box gets four vertices a side, a ball keeps its own."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    apart = split_creases(Mesh(np.asarray(box.vertices), np.asarray(box.faces)), np.deg2rad(30.0))
    assert len(apart.vertices) == 24
    np.testing.assert_array_equal(apart.vertices[apart.faces], box.vertices[box.faces])
    ball = trimesh.creation.icosphere(3)
    same = split_creases(Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), np.deg2rad(30.0))
    assert len(same.vertices) == len(ball.vertices)
