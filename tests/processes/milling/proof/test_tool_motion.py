"""Sample points of milled faces: none is missed, however large the face is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.mesh import bisect_triangles
from planner.issues import TandemError
from planner.processes import registry
from planner.processes.forming.proof import face as forming_face
from planner.processes.forming.proof.face import ProofFace, remaining_face
from planner.processes.forming.proof.rules.tool import _face_points
from planner.processes.hotwire.proof.cut_surface import sample_face
from planner.processes.milling.plan import check
from planner.processes.milling.proof import tool_motion
from planner.processes.milling.proof.rules import cutter
from planner.processes.milling.proof.tool_motion import (
    ToolSolid,
    edge_spacing,
    near_face_points,
    round_spacing,
    track_distance,
)
from planner.proof.faces import subdivide
from tests.processes.milling.plan.small_mill import WALL, problem
from tests.remedies.advice import ReportedFigure

BALL = ToolSolid("cutter", 0.0, 0.03, 0.003, 0.003)
FLAT = ToolSolid("cutter", 0.0, 0.005, 0.006)
TOLERANCE = 1e-4
FIELD = np.array(
    [[[-1.5, -1.5, 0], [1.5, -1.5, 0], [1.5, 1.5, 0]], [[-1.5, -1.5, 0], [1.5, 1.5, 0], [-1.5, 1.5, 0]]]
)
"""A field of 9 m2 in two triangles."""


def dipped(depth: float, where: float) -> tuple[np.ndarray, np.ndarray]:
    """A tool goes across the field and once goes in, which is as wide as a tip of 3 mm makes it."""
    x = np.arange(-1.4, 1.4, 2e-4)
    tip = np.stack([x, 0.3 + 0.1 * x, 1e-5 - depth * (np.abs(x - where) < 1.5e-4)], axis=1)
    return tip, np.broadcast_to([0.0, 0.0, 1.0], tip.shape)


@pytest.mark.long
@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("where", [-0.7213, 0.0031, 1.1117])
def test_a_spot_is_found_on_a_face_of_any_size(where: float) -> None:
    tip, axis = dipped(2.5e-4, where)
    for solid, size in ((BALL, round_spacing(BALL.radius, TOLERANCE)), (FLAT, edge_spacing(TOLERANCE))):
        places, count = near_face_points(FIELD, solid, tip, axis, size)
        assert count == len(places) < tool_motion.MAX_FACE_POINTS
        deviation, _ = track_distance(places, tip, axis, solid)
        assert -2.5e-4 - 1e-9 <= deviation.min() < -2.4e-4 + 0.5 * TOLERANCE
    coarse, _ = bisect_triangles(FIELD, round_spacing(BALL.radius, TOLERANCE), 240_000)  # all over it
    assert track_distance(coarse.mean(axis=1), tip, axis, BALL)[0].min() > -1.5e-4


def test_places_are_as_near_to_one_another_as_is_said() -> None:
    """Against points thrown at random on a folded face, all that are near the tool by its closed form."""
    rng = np.random.default_rng(3)
    fold = FIELD @ np.array([[1.0, 0, 0.0], [0, 0.8, 0.6], [0, -0.6, 0.8]])
    corners = np.concatenate([0.05 * FIELD, 0.05 * fold])
    tip = rng.uniform(-0.06, 0.06, (40, 3)) + np.array([0, 0, 0.02])
    axis = rng.normal(size=(40, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    solid, size = ToolSolid("shank", 0.01, 0.06, 0.004), 1.1e-3
    places, count = near_face_points(corners, solid, tip, axis, size)
    fraction = rng.dirichlet([1.0, 1.0, 1.0], (4, 20_000))
    points = np.einsum("tnk,tkd->tnd", fraction, corners).reshape(-1, 3)
    deviation, _ = track_distance(points, tip, axis, solid)
    near = points[deviation < 3e-3]
    assert 1000 < len(near) < 0.7 * len(points)
    distance = np.array([np.linalg.norm(places - p, axis=1).min() for p in near[::10]])
    assert distance.max() <= size / np.sqrt(3.0)
    assert count == len(places)


def test_what_is_too_large_is_refused_by_the_planner_first_and_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The samples of this small wall slightly exceed the limit. The reported tolerance is sufficient."""
    read = problem(tmp_path, WALL, shape_tol_mm=0.1)
    outcome = pipeline.plan(read)
    assert outcome.verified, outcome.issues
    monkeypatch.setattr(tool_motion, "MAX_FACE_POINTS", 40_000)
    monkeypatch.setattr(cutter, "MAX_FACE_POINTS", 40_000)
    proof = pipeline.verify(read, outcome.programs)
    (issue, *_) = [i for i in proof.issues if i.code == "verify.mill_gouge"]
    assert not proof.ok and issue.limit == 40_000 and "points" in issue.message
    monkeypatch.setattr(check, "MAX_FACE_POINTS", 30_000)
    with pytest.raises(TandemError) as caught:
        registry.job(read, 0).targets()
    (reported,) = caught.value.issues
    assert reported.code == "milling.too_large" and reported.value is not None and reported.value > 30_000
    expected = ReportedFigure("shape_tol_mm of #", step=0.01).of([reported], None)
    registry.job(problem(tmp_path, WALL, shape_tol_mm=expected), 0).targets()


def uneven() -> tuple[np.ndarray, np.ndarray]:
    """A square of 0.3 m in two triangles, and an adjacent one of 10 mm in 80,000."""
    x = np.linspace(0.31, 0.32, 201)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
    index = np.arange(201 * 201).reshape(201, 201)
    a, b, c, d = (index[i : 200 + i, j : 200 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    fine = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    large = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]])
    vertices = np.concatenate([large, grid])
    faces = np.concatenate([[[0, 1, 2], [0, 2, 3]], fine + 4])
    return np.column_stack([vertices, np.zeros(len(vertices))]), faces


def test_a_mesh_that_is_dense_in_one_place_is_looked_at_all_over() -> None:
    """One place of a triangle of 0.3 m said nothing of the rest of it."""
    vertices, faces = uneven()
    coarse, _ = bisect_triangles(vertices[faces], 0.002, 60_000)
    assert (coarse.mean(axis=1)[:, 0] < 0.3).sum() == 2
    _, owner = subdivide(vertices[faces], 0.002)
    assert np.bincount(owner)[:2].min() > 0.045 / 0.5 / 0.002**2
    points, normals, area = sample_face(vertices, faces)
    assert area.sum() == pytest.approx(0.09 + 1e-4) and normals.min(axis=0)[2] == pytest.approx(1.0)
    assert (points[:, 0] < 0.3).sum() > 2900
    sheet = _face_points(ProofFace(vertices, faces, 0.005))
    beyond = np.random.default_rng(1).uniform(0.0, 0.3, (50, 2))
    distance = [np.linalg.norm(sheet[:, :2] - p, axis=1).min() for p in beyond]
    assert max(distance) < 2.0 * np.sqrt(0.0901 / 60_000) / np.sqrt(3.0)


def test_long_thin_facets_that_are_too_many_pieces_are_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = uneven()
    monkeypatch.setattr("planner.proof.faces.MAX_PIECES", 10_000)
    with pytest.raises(TandemError) as caught:
        subdivide(vertices[faces[:2]], 0.002)
    (issue,) = caught.value.issues
    assert issue.code == "verify.duration" and "facets of even shape" in issue.message


def test_what_a_ball_leaves_of_a_facet_that_is_not_looked_at_closely_is_the_facet(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A box of 0.1 m with upright walls: its floor is raised in the corners alone, or not at all."""
    low, high = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]]) * 0.05, 0.03
    vertices = np.concatenate(
        [np.column_stack([low, np.full(4, -high)]), np.column_stack([1.01 * low, np.zeros(4)])]
    )
    sides = [[k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k] for k in range(4)]
    faces = [[0, 1, 2], [0, 2, 3], *([a, b, c] for a, b, c, _ in sides), *([a, c, d] for a, _, c, d in sides)]
    face = ProofFace(vertices, np.array(faces)[:, ::1], 0.005)
    for most in (25_000, 300):
        monkeypatch.setattr(forming_face, "_MAX_PIECES", most)
        left = remaining_face(face, 0.005, 1, 0.0)
        middle = np.array([[x, y, 0.0] for x in (-0.03, 0.0, 0.02) for y in (-0.02, 0.01, 0.03)])
        assert np.abs(left.nearest(middle - [0, 0, high]).distance).max() < 2e-5
