"""Ruled surfaces and ruled strips, against closed forms: hypar, cylinder, sphere, saddle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_queries import MeshDistance
from planner.geometry.ruled_approximation import Patch, cut_strips, patch_of_mesh
from planner.geometry.rulings import outward_normals, ruling_points
from planner.issues import Issue, TandemError
from planner.problem import Part
from tests.reading import part_specs

BLOCK = np.array([0.5, 0.5, 0.3])


def make(spec: dict[str, Any], folder: Path = Path()) -> Part:
    return part_specs.make(spec, folder, BLOCK)


def refused(spec: dict[str, Any], folder: Path = Path()) -> Issue:
    return part_specs.expect_refusal(spec, folder, BLOCK)[0]


def grid_mesh(height: Any, cells: int = 40, width: float = 0.2, depth: float = 0.15) -> TriangleMesh:
    """z = height(x, y) [m] over a rectangle, seen from above."""
    x, y = np.meshgrid(np.linspace(0, width, cells + 1), np.linspace(0, depth, cells + 1), indexing="ij")
    i = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    p, q, r, w = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, w], 1)])
    return TriangleMesh(np.stack([x, y, height(x, y)], -1).reshape(-1, 3), faces)


def write(mesh: TriangleMesh, path: Path) -> None:
    trimesh.Trimesh(1e3 * mesh.vertices, mesh.faces, process=False).export(path)


def test_the_rulings_of_a_hypar_are_found(tmp_path: Path) -> None:
    write(grid_mesh(lambda x, y: 2.0 * x * y, 60), tmp_path / "hypar.ply")
    place = {"xyz_mm": [0, 0, 0]}
    part = make(
        {"mesh": {"file": "hypar.ply", "unit": "mm", "tolerance_mm": 0.05}, "in_stock": place}, tmp_path
    )
    (patch,) = part.ruled
    (note,) = part.notes
    assert note.code == "part.ruled_deviation"
    assert note.value is not None
    assert note.value < 0.02
    x, y, z = ruling_points(patch, np.linspace(0, 1, 7)).reshape(-1, 3).T
    assert np.abs(z - 2.0 * x * y).max() < 2e-5
    way = patch.end - patch.start
    assert min(np.abs(way[:, 0]).max(), np.abs(way[:, 1]).max()) < 2e-3  # along x, or along y
    assert (outward_normals(patch)[0][:, 2] > 0).all()
    spec = {"file": "hypar.ply", "unit": "mm", "flip": True}
    (other,) = make({"mesh": spec, "in_stock": place}, tmp_path).ruled
    assert (outward_normals(other)[0][:, 2] < 0).all()


def test_a_slanted_piece_of_a_cone_is_found_to_be_ruled(tmp_path: Path) -> None:
    s, t = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41), indexing="ij")
    tip = np.array([0.1, 0.0, 0.5])
    base = np.stack([0.2 * s, 0.02 * np.sin(3 * s), 0.03 * np.cos(4 * s)], axis=-1)
    fraction = (0.2 + 0.2 * s) * t  # the upper guide cuts the cone askew
    grid = base + fraction[..., None] * (tip - base)
    mesh = grid_mesh(lambda x, y: 0 * x)
    write(TriangleMesh(grid.reshape(-1, 3), mesh.faces), tmp_path / "cone.ply")
    part = make({"mesh": {"file": "cone.ply", "unit": "mm"}}, tmp_path)
    assert part.notes[0].value is not None
    assert part.notes[0].value < 0.1


def test_a_dome_is_not_ruled_and_says_where(tmp_path: Path) -> None:
    write(grid_mesh(lambda x, y: 3.0 * x * (0.2 - x) + 3.0 * y * (0.15 - y), 30), tmp_path / "dome.ply")
    issue = refused({"mesh": {"file": "dome.ply", "unit": "mm"}}, tmp_path)
    assert issue.code == "part.not_ruled"
    assert issue.value is not None
    assert issue.value > 5.0
    assert "near (" in issue.message


def test_a_mesh_without_four_corners_is_no_patch(tmp_path: Path) -> None:
    disc = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    disc.update_faces(disc.triangles_center[:, 2] > 0.02)
    with pytest.raises(TandemError) as caught:
        patch_of_mesh(TriangleMesh(np.array(disc.vertices), np.array(disc.faces)), "part.mesh")
    assert caught.value.issues[0].code == "part.patch"
    mesh = grid_mesh(lambda x, y: 0 * x, 12)
    holed = TriangleMesh(mesh.vertices, np.delete(mesh.faces, [70, 70 + 144], axis=0))
    with pytest.raises(TandemError) as caught:
        patch_of_mesh(holed, "part.mesh")
    assert "2 boundaries" in caught.value.issues[0].message


def test_a_mesh_laid_out_flat_gives_its_own_points_back() -> None:
    mesh = grid_mesh(lambda x, y: 0.3 * np.sin(20 * x) * y, 30)
    patch = patch_of_mesh(mesh, "part.mesh")
    u, v = np.random.default_rng(1).uniform(size=(2, 400))
    seen = patch.points(u, v)
    assert MeshDistance(mesh, 0.002).distance(seen)[0].max() < 1e-4
    rim = patch.points(np.linspace(0, 1, 9), np.zeros(9))
    assert MeshDistance(mesh, 0.002).distance(rim)[0].max() < 1e-12
    corners = patch.points(np.array([0, 1, 1, 0]), np.array([0, 0, 1, 1]))
    assert {tuple(np.round(c[:2], 6)) for c in corners} == {(0, 0), (0.2, 0), (0.2, 0.15), (0, 0.15)}


def test_distances_from_a_mesh_are_those_of_another_library() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    sight = np.random.default_rng(0).normal(size=(200, 3)) * 0.08
    _, expected, _ = trimesh.proximity.closest_point(ball, sight)
    mesh = TriangleMesh(np.array(ball.vertices), np.array(ball.faces))
    np.testing.assert_allclose(MeshDistance(mesh, 0.004).distance(sight)[0], expected, atol=1e-6)


def round_patch(radius: float, angle: float, width: float, sphere: bool) -> Patch:
    """A piece of a cylinder along x, or of a sphere in longitude and latitude; u goes round by ``angle``."""

    def surface_point(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        u, v = np.broadcast_arrays(u, v)
        a = (u - 0.5) * angle
        if not sphere:
            return np.stack([(v - 0.5) * width, radius * np.sin(a), radius * np.cos(a)], axis=-1)
        b = (v - 0.5) * width / radius
        return radius * np.stack([np.sin(b), np.cos(b) * np.sin(a), np.cos(b) * np.cos(a)], axis=-1)

    u, v = np.meshgrid(np.linspace(0, 1, 194), np.linspace(0, 1, 61), indexing="ij")
    i = np.arange(194 * 61).reshape(194, 61)
    p, q, r, w = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([p, r, q], 1), np.stack([p, w, r], 1)])
    return Patch(surface_point, TriangleMesh(surface_point(u, v).reshape(-1, 3), faces), False)


@pytest.mark.parametrize("sphere", [False, True])
def test_strips_round_a_cylinder_or_sphere_have_the_sagitta_and_the_kinks_of_their_chords(
    sphere: bool,
) -> None:
    radius, angle = 0.3, 1.2
    patch = round_patch(radius, angle, 0.2, sphere)
    found = cut_strips(patch, "u", 1.0, 6, "part.strips")
    sagitta = radius * (1.0 - np.cos(angle / 12.0))
    np.testing.assert_allclose(found.deviation, sagitta, rtol=0.03)
    # across the equator neighbours meet at the angle of one chord, elsewhere on the sphere at less
    np.testing.assert_allclose(found.kink, angle / 6.0, rtol=0.02)
    for strip in found.strips:
        assert (np.sum(outward_normals(strip)[0] * strip.start, axis=1) > 0).all()


@pytest.mark.parametrize("tolerance", [2e-3, 5e-4])
def test_the_least_number_of_strips_for_a_tolerance(tolerance: float) -> None:
    radius, angle = 0.3, 1.2
    found = cut_strips(round_patch(radius, angle, 0.2, False), "u", tolerance, None, "part.strips")
    expected = angle / (2.0 * np.arccos(1.0 - tolerance / radius))
    assert len(found.strips) in (int(np.ceil(expected)), int(np.ceil(expected)) + 1)
    assert found.deviation.max() <= tolerance
    along = cut_strips(round_patch(radius, angle, 0.2, False), "v", tolerance, None, "part.strips")
    assert len(along.strips) == 1  # rulings along the cylinder
    assert along.deviation.max() < 2e-5


LOFT = {
    "sections": [
        {
            "at": i / 3,
            "bspline_mm": [[x, 60 * i, 20 + 15 * np.sin(x / 40 + 0.4 * i)] for x in range(0, 201, 40)],
        }
        for i in range(4)
    ],
    "chord_mm": 0.05,
}


def test_a_strip_of_a_loft_is_taken_and_all_are_told() -> None:
    parts = [make({"strips": {"loft": LOFT, "tolerance_mm": 0.5, "take": k, "across": "v"}}) for k in (1, 2)]
    (note,) = parts[0].notes
    assert note.code == "part.strips_found"
    assert "ruled strips" in note.message
    assert "kinks between" in note.message
    first, second = (part.ruled[0] for part in parts)
    assert first.name == "strip"
    assert not first.closed
    shared = [np.linalg.norm(np.diff(e, axis=0), axis=1).sum() for e in (first.end, second.start)]
    assert shared[0] == pytest.approx(shared[1], rel=1e-4)


def test_strips_of_a_mesh_are_those_of_the_surface_that_it_shows(tmp_path: Path) -> None:
    write(grid_mesh(lambda x, y: 3.0 * x * (0.2 - x), 60), tmp_path / "arch.ply")
    mesh = {"file": "arch.ply", "unit": "mm"}
    counts = {}
    for across in ("u", "v"):
        strips = {"mesh": mesh, "tolerance_mm": 0.3, "across": across}
        counts[across] = int(make({"strips": strips}, tmp_path).notes[0].message.split()[0])
    # z = 3 x (0.2 - x) over chords of a step s sags by 3 s^2 / 4 at the crown
    assert min(counts.values()) == 1
    assert max(counts.values()) == pytest.approx(0.2 / np.sqrt(4 * 3e-4 / 3), abs=2)


def test_strips_that_are_too_few_too_many_or_not_there_are_refused() -> None:
    few = {"loft": LOFT, "tolerance_mm": 0.05, "count": 2, "across": "v"}
    issue = refused({"strips": few})
    assert issue.code == "part.strips"
    assert "use more strips" in issue.message
    assert refused({"strips": {"loft": LOFT, "take": 99}}).field == "part.strips.take"
    with pytest.raises(TandemError) as caught:
        cut_strips(round_patch(0.3, 1.2, 0.2, True), "u", 1e-8, None, "part.strips")
    assert caught.value.issues[0].code == "part.strips"


def test_the_points_of_a_coarse_mesh_lie_on_its_own_facets() -> None:
    mesh = grid_mesh(lambda x, y: 2.0 * x * y + 0.3 * x, 8)
    patch = patch_of_mesh(mesh, "part.mesh")
    u, v = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    where = patch.points(u, v).reshape(-1, 3)
    # each square of the grid is two triangles with the diagonal of positive slope in (x, y)
    cell = where[:, :2] / (0.2 / 8, 0.15 / 8)
    a, b = np.minimum(np.floor(cell + 1e-9), 7).T
    s, t = cell[:, 0] - a, cell[:, 1] - b

    def height(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        x, y = i * 0.2 / 8, j * 0.15 / 8
        return 2.0 * x * y + 0.3 * x

    low, high = height(a, b), height(a + 1, b + 1)
    right, left = height(a + 1, b), height(a, b + 1)
    lower = low + s * (right - low) + t * (high - right)
    upper = low + t * (left - low) + s * (high - left)
    np.testing.assert_allclose(where[:, 2], np.where(s >= t, lower, upper), atol=1e-9)


@pytest.mark.parametrize("cells", [4, 10, 100])
def test_strips_have_corners_where_a_coarse_mesh_folds_them(cells: int) -> None:
    """A wave of straight facets: along the strips the curve turns at the mesh's edges, by the angle of their
    chords; facets of 2 mm stand for the smooth wave."""
    mesh = grid_mesh(lambda x, y: 0.01 * np.sin(2.0 * np.pi * x / 0.2), cells)
    found = cut_strips(patch_of_mesh(mesh, "part.strips.mesh"), "u", 1.0, 2, "part.strips")
    x = np.linspace(0.0, 0.2, cells + 1)
    slope = np.arctan(np.diff(0.01 * np.sin(2.0 * np.pi * x / 0.2)) / np.diff(x))
    folds = x[1:-1][np.abs(np.diff(slope)) > np.deg2rad(2.0)] if cells < 100 else np.zeros(0)
    for strip in found.strips:
        for guide in (strip.start, strip.end):
            at = np.sort(guide[strip.corner, 0])
            assert np.abs(at[:, None] - x).min(axis=1).max(initial=0.0) < 1e-6
            assert set(np.round(folds, 6)) <= set(np.round(at, 6))
        assert strip.corner.any() == (cells < 100)
