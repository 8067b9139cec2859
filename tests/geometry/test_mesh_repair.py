"""Known noise on closed-form faces is estimated and removed, and true features stay."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.mesh import TriangleMesh, check_surface, face_normals, merge_vertices
from planner.geometry.mesh_repair import (
    border_edges,
    fit_face,
    level_flats,
    level_rims,
    sew_cracks,
    vertex_noise,
)
from planner.proof.part_files.sheets import mesh_noise
from tests.processes.forming.plan import nests, shapes

SPACING = 1.5e-3


def bowl(x, y):
    """A cap of a sphere of 70 mm, 12 mm deep, that runs out into the flat by a fillet of 10 mm."""
    away = np.hypot(x, y)
    ball, fillet, deep = 0.07, 0.01, 0.012
    middle = ball - deep
    # where cap and fillet meet the slope is the same
    a = np.arccos((middle + fillet) / (ball + fillet))
    foot, meet = (ball + fillet) * np.sin(a), ball * np.sin(a)
    cap = middle - np.sqrt(np.maximum(ball**2 - away**2, 0.0))
    round_ = np.sqrt(np.maximum(fillet**2 - (away - foot) ** 2, 0.0)) - fillet
    return np.where(away < meet, cap, np.where(away < foot, round_, 0.0))


def pit(x, y):
    """A cone of 45 degrees with sharp edges, 10 mm deep."""
    return -np.clip(0.035 - np.hypot(x, y), 0.0, 0.01)


def noisy(height, noise, seed=3, spacing=SPACING):
    mesh = nests.sheet(height, 0.06, spacing, seed)
    rng = np.random.default_rng(seed)
    return TriangleMesh(mesh.vertices + rng.normal(0.0, 1.0, mesh.vertices.shape) * noise, mesh.faces)


@pytest.mark.parametrize("height", [bowl, pit])
@pytest.mark.parametrize("noise", [2e-5, 5e-5, 1e-4])
def test_the_noise_of_a_mesh_is_found_by_both_estimates(height, noise):
    mesh = noisy(height, noise)
    assert vertex_noise(mesh) == pytest.approx(noise, rel=0.2)
    assert mesh_noise(mesh.vertices, mesh.faces) / 3.0 == pytest.approx(noise, rel=0.3)


@pytest.mark.parametrize(
    "mesh",
    [
        nests.sheet(bowl, 0.06, SPACING),
        nests.sheet(pit, 0.06, 2.0 * SPACING),
        shapes.cone(45.0, 0.01, 0.03),
        shapes.bowl(0.05, 40.0),
    ],
)
def test_a_mesh_without_noise_has_none(mesh):
    one = TriangleMesh(mesh.vertices, mesh.faces)
    assert vertex_noise(one) == 0.0
    assert mesh_noise(mesh.vertices, mesh.faces) == 0.0


@pytest.mark.parametrize("noise", [2e-5, 1e-4])
def test_the_fitted_face_is_nearer_to_the_meant_one_than_its_vertices(noise):
    mesh = noisy(bowl, noise)
    face = fit_face(mesh, noise, 0.0)
    x, y, z = face.vertices.T
    assert np.sqrt(np.mean((z - bowl(x, y)) ** 2)) < 0.6 * noise
    # its facets lean as the sphere does
    middle = face.vertices[face.faces].mean(axis=1)
    inner = np.hypot(middle[:, 0], middle[:, 1]) < 0.02
    meant = np.column_stack([-middle[:, :2], 0.058 - middle[:, 2]])[inner]
    meant /= np.linalg.norm(meant, axis=1, keepdims=True)
    deviation = np.arccos(np.clip((meant * face_normals(face)[inner]).sum(axis=1), -1.0, 1.0))
    assert np.rad2deg(np.sqrt(np.mean(deviation**2))) < 2.0
    moved = np.linalg.norm(face.vertices - mesh.vertices, axis=1)
    assert np.sqrt(np.mean(moved**2)) < 2.0 * noise


def test_sharp_edges_stay_where_they_are():
    mesh = noisy(pit, 5e-5)
    face = fit_face(mesh, 5e-5, 0.0)
    x, y, z = face.vertices.T
    assert np.abs(z - pit(x, y)).max() < 9.0 * 5e-5


def test_flats_become_level_and_walls_stay():
    face = level_flats(fit_face(noisy(pit, 5e-5), 5e-5, 0.0), 2.5e-5, 0.0)
    x, y, z = face.vertices.T
    away = np.hypot(x, y)
    assert (z[away > 0.038] == 0.0).mean() > 0.96
    floor = z[away < 0.02]
    assert (floor == np.median(floor)).mean() > 0.9
    assert np.median(floor) == pytest.approx(-0.01, abs=3e-5)
    wall = (away > 0.027) & (away < 0.033)
    assert np.abs(z - pit(x, y))[wall].max() < 2e-4


def clean():
    mesh = nests.sheet(bowl, 0.06, 3e-3)
    return TriangleMesh(mesh.vertices, mesh.faces)


def split_every_tenth_face(mesh, fraction, closed):
    """Every tenth face divided at a point of its first edge, of which its neighbour knows nothing;
    ``closed``: with the triangle of no area between them."""
    vertices, faces = mesh.vertices.tolist(), mesh.faces.tolist()
    for k in range(0, len(mesh.faces), 10):
        a, b, c = faces[k]
        point = (1.0 - fraction) * mesh.vertices[a] + fraction * mesh.vertices[b]
        faces[k] = [a, len(vertices), c]
        faces.append([len(vertices), b, c])
        if closed:
            faces.append([a, b, len(vertices)])
        vertices.append(point.tolist())
    return merge_vertices(TriangleMesh(np.array(vertices), np.array(faces)))


def soup(mesh, by):
    """Return the mesh with separate corners for each face, shifted by up to ``by`` [m]."""
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    corners = corners + np.random.default_rng(1).uniform(-by, by, corners.shape)
    return TriangleMesh(corners, np.arange(len(corners)).reshape(-1, 3))


@pytest.mark.parametrize(
    "flaw",
    [
        lambda mesh: TriangleMesh(mesh.vertices, np.concatenate([mesh.faces, mesh.faces[:40, ::-1]])),
        lambda mesh: split_every_tenth_face(mesh, 0.4, closed=False),
        lambda mesh: split_every_tenth_face(mesh, 0.5, closed=True),
        lambda mesh: soup(mesh, 2e-6),
    ],
    ids=["faces twice", "corners on edges", "slivers of no area", "soup"],
)
def test_flawed_meshes_become_one_surface(flaw):
    whole = sew_cracks(flaw(clean()))
    assert check_surface(whole, "part") == []
    rim = border_edges(whole.faces)
    assert len(np.unique(rim)) == len(rim)
    x, y = whole.vertices[np.unique(rim), :2].T
    assert np.maximum(np.abs(x), np.abs(y)) == pytest.approx(0.06, abs=1e-5)  # no hole is left inside
    area = np.linalg.norm(
        np.cross(*(whole.vertices[whole.faces][:, k] - whole.vertices[whole.faces][:, 0] for k in (1, 2))),
        axis=1,
    )
    meant = clean()
    expected = np.linalg.norm(
        np.cross(*(meant.vertices[meant.faces][:, k] - meant.vertices[meant.faces][:, 0] for k in (1, 2))),
        axis=1,
    )
    assert area.sum() == pytest.approx(expected.sum(), rel=1e-4)


def test_a_mesh_without_flaws_stays_the_very_mesh():
    mesh = clean()
    assert sew_cracks(mesh) is mesh
    assert level_rims(mesh, 0.0, 0.0) is mesh


def test_a_hole_stays_a_hole():
    mesh = clean()
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    holed = TriangleMesh(mesh.vertices, mesh.faces[np.hypot(middle[:, 0], middle[:, 1]) > 0.01])
    assert len(border_edges(sew_cracks(holed).faces)) == len(border_edges(holed.faces))


def test_corners_of_a_sharp_rim_and_bumps_of_the_flat_are_put_onto_it():
    mesh = shapes.revolved(
        [(0.06, 0.0), (0.05, 0.0), (0.0304, 0.0), (0.03, -1e-5), (0.02, -0.01), (0.0, -0.01)]
    )
    bumped = mesh.vertices.copy()
    bumped[130, 2] = 8e-6
    level = level_rims(TriangleMesh(bumped, mesh.faces), 0.0, 2e-5).vertices
    assert (level[:480, 2] == 0.0).all()
    assert np.array_equal(level[480:], mesh.vertices[480:])


def test_a_fillet_that_begins_gently_is_no_flaw():
    mesh = shapes.revolved(
        [(0.06, 0.0), (0.05, 0.0), (0.049, -1e-5), (0.048, -4e-5), (0.03, -0.002), (0.0, -0.002)]
    )
    one = TriangleMesh(mesh.vertices, mesh.faces)
    assert np.array_equal(level_rims(one, 0.0, 2e-5).vertices, mesh.vertices)
