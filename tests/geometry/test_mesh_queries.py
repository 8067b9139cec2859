"""Sections against trimesh's own slicing, closed forms, and random surfaces."""

from __future__ import annotations

import numpy as np
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.geometry.mesh import TriangleMesh, face_normals
from planner.geometry.mesh_queries import slice_mesh


def surface(seed: int, n: int = 12) -> TriangleMesh:
    rng = np.random.default_rng(seed)
    x = np.linspace(-0.2, 0.2, n)
    xx, yy = np.meshgrid(x, x * 1.7, indexing="ij")
    zz = 0.05 * np.sin(8 * xx + rng.uniform(0, 6)) * np.cos(7 * yy + rng.uniform(0, 6))
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return TriangleMesh(np.stack([xx, yy, zz], -1).reshape(-1, 3), faces)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_sections_are_those_of_trimesh(seed: int) -> None:
    mesh = surface(seed)
    rng = np.random.default_rng(seed + 1)
    origin = rng.uniform(-0.1, 0.1, size=(5, 3))
    normal = rng.normal(size=(5, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cut = slice_mesh(mesh, origin, normal)
    peer = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    for k in range(5):
        rows = np.nonzero(cut.plane == k)[0]
        own = [cut.polyline(i) for i in rows]
        other = trimesh.intersections.mesh_plane(peer, normal[k], origin[k])
        want = np.linalg.norm(other[:, 1] - other[:, 0], axis=1).sum() if len(other) else 0.0
        got = sum(
            np.linalg.norm(np.diff(p, axis=0), axis=1).sum()
            + (np.linalg.norm(p[-1] - p[0]) if cut.closed[i] else 0.0)
            for i, p in zip(rows, own, strict=True)
        )
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)
        for p in own:
            np.testing.assert_allclose((p - origin[k]) @ normal[k], 0.0, atol=1e-12)


def test_polylines_run_along_plane_normal_cross_mesh_normal() -> None:
    mesh = surface(4)
    assert (face_normals(mesh)[:, 2] > 0).all()
    cut = slice_mesh(mesh, np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]]))
    assert len(cut.plane) == 1
    line = cut.polyline(0)
    assert (np.diff(line[:, 0]) > 0).all()  # y cross z = x
    np.testing.assert_allclose(line[[0, -1], 0], [-0.2, 0.2], atol=1e-12)


def test_a_sphere_is_cut_in_rings() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    mesh = TriangleMesh(np.array(ball.vertices), np.array(ball.faces, dtype=np.int64))
    heights = np.array([-0.5, 0.01, 0.3])
    cut = slice_mesh(mesh, np.outer(heights, [0, 0, 1.0]), np.tile([0, 0, 1.0], (3, 1)))
    assert cut.closed.all()
    assert cut.plane.tolist() == [0, 1, 2]
    for i, h in enumerate(heights):
        radius = np.linalg.norm(cut.polyline(i)[:, :2], axis=1)
        np.testing.assert_allclose(radius, np.sqrt(1 - h * h), atol=5e-3)


def test_a_plane_through_vertices_and_one_that_misses() -> None:
    x = np.linspace(0, 1, 5)
    mesh = TriangleMesh(
        np.array([[a, b, 0.0] for a in x for b in x]),
        np.array([[5 * i + j, 5 * i + j + 5, 5 * i + j + 6] for i in range(4) for j in range(4)]
                 + [[5 * i + j, 5 * i + j + 6, 5 * i + j + 1] for i in range(4) for j in range(4)]),
    )  # fmt: skip
    cut = slice_mesh(mesh, np.array([[0.5, 0.5, 0], [3.0, 0, 0]]), np.array([[1.0, 0, 0], [1.0, 0, 0]]))
    assert cut.plane.tolist() == [0]
    assert not cut.closed[0]
    np.testing.assert_allclose(np.ptp(cut.polyline(0), axis=0), [0, 1, 0], atol=1e-12)
