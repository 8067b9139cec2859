"""Distance of balls from corners with a smaller radius, against closed forms of corner and cone."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh
from planner.processes.forming.plan.check import find_unreached_region, nearest_centres
from planner.processes.forming.plan.contact import ContactFace as PlannersFace
from planner.processes.forming.proof import face as forming_face
from planner.processes.forming.proof.face import ProofFace, min_ball_distance, remaining_face
from tests.processes.forming.plan.shapes import cone, pit, plan_passes, revolved

BALL = 0.005


def foot(angle: float, side: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a cone with a sharp floor, points up its wall with normals, and the distance of a ball there."""
    mesh = cone(angle, 0.01, 0.03, 240)
    a = np.radians(angle)
    high = np.linspace(0.0, 1.2 * BALL * (1.0 - np.cos(a)), 9)
    radius = 0.03 - 0.01 / np.tan(a) + high / np.tan(a)
    points = np.column_stack([radius, 0.0 * high, high - 0.01])
    normals = np.tile([-np.sin(a), 0.0, np.cos(a)], (len(high), 1))
    reach = BALL * np.tan(0.5 * a) - high / np.sin(a)
    off = np.where(reach > 0.0, np.hypot(BALL, reach) - BALL, 0.0)
    flip = np.array([1.0, 1.0, float(side)])
    return mesh.vertices * flip, mesh.faces, points * flip, normals * [side, 1.0, 1.0], off


@pytest.mark.parametrize("angle", [25.0, 50.0, 65.0, 80.0])
@pytest.mark.parametrize("side", [1, -1])
def test_at_a_sharp_floor_a_ball_stays_off_by_the_sector_of_the_corner(angle: float, side: int) -> None:
    vertices, faces, points, normals, deviation = foot(angle, side)
    got = min_ball_distance(ProofFace(vertices, faces, BALL), points, normals, BALL, side)
    assert got == pytest.approx(deviation, abs=4e-6)
    assert got[0] == pytest.approx(BALL * (1.0 / np.cos(np.radians(0.5 * angle)) - 1.0), abs=4e-6)
    if side > 0:  # the planner's own code says the same
        face = PlannersFace(TriangleMesh(vertices, faces), BALL)
        distance = np.linalg.norm(nearest_centres(face, points, normals) - points, axis=1) - BALL
        assert np.maximum(distance, 0.0) == pytest.approx(deviation, abs=8e-6)


@pytest.mark.parametrize("angle", [20.0, 40.0, 60.0])
def test_in_the_tip_of_a_cone_it_stays_off_by_that_of_all_its_walls(angle: float) -> None:
    mesh = revolved([(0.06, 0.0), (0.04, 0.0), (0.0, -0.04 * np.tan(np.radians(angle)))], 360)
    tip, up = mesh.vertices[-1:], np.array([[0.0, 0.0, 1.0]])
    got = min_ball_distance(ProofFace(mesh.vertices, mesh.faces, BALL), tip, up, BALL, 1)
    assert got[0] == pytest.approx(BALL * (1.0 / np.cos(np.radians(angle)) - 1.0), abs=5e-6)


@pytest.mark.long
def test_a_face_that_is_wide_enough_is_left_as_it_is() -> None:
    turn = np.radians(np.linspace(50.0, 0.0, 26))
    radius = 1.2 * BALL  # a dish
    cap = [(float(radius * np.sin(t)), float(radius * (np.cos(turn[0]) - np.cos(t)))) for t in turn]
    mesh = revolved([(cap[0][0] + 0.02, 0.0), *cap], 180)
    face = ProofFace(mesh.vertices, mesh.faces, BALL)
    assert remaining_face(face, BALL, 1, 0.0) is face


@pytest.mark.long
def test_what_is_left_in_a_sharp_corner_is_a_fillet_of_the_ball() -> None:
    angle, ball = 65.0, 0.002
    mesh = cone(angle, 0.004, 0.01, 120)
    left = remaining_face(ProofFace(mesh.vertices, mesh.faces, ball), ball, 1, 0.0)
    a, floor = np.radians(angle), 0.01 - 0.004 / np.tan(np.radians(angle))
    places = left.corners.mean(axis=1)
    near = np.hypot(places[:, 0], places[:, 1])
    # the ball in the corner, turned about the axis
    off = np.hypot(near - (floor - ball * np.tan(0.5 * a)), places[:, 2] - (ball - 0.004))
    reach = ball * np.tan(0.5 * a)
    tight = (near > floor - reach + 5e-5) & (places[:, 2] < ball * (1.0 - np.cos(a)) - 0.004 - 5e-5)
    assert tight.sum() > 500
    assert off[tight] == pytest.approx(ball, abs=8e-5)  # facets


@pytest.mark.long
def test_long_triangles_are_left_with_fillets_at_all_their_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pit as drawn, of a few triangles, with more small pieces than are looked at."""
    monkeypatch.setattr(forming_face, "_MAX_PIECES", 20_000)
    ball, half, deep, angle = 0.003, 0.02, 0.006, np.radians(50.0)
    mesh = pit(shapely.box(-half, -half, half, half), 50.0, deep)
    left = remaining_face(ProofFace(mesh.vertices, mesh.faces, ball), ball, 1, 0.0)
    foot, reach = half - deep / np.tan(angle), ball * np.tan(0.5 * angle)
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):  # between two walls and the floor
        distance = left.nearest(np.array([[x * foot, y * foot, -deep]])).distance[0]
        assert distance == pytest.approx(np.hypot(np.sqrt(2.0) * reach, ball) - ball, abs=0.006 * ball)
    along = np.array([[foot, 0.2 * foot, -deep], [0.1 * foot, -foot, -deep]])
    assert left.nearest(along).distance == pytest.approx(np.hypot(reach, ball) - ball, abs=0.006 * ball)
    inner = np.array([[0.0, 0.3 * foot, -deep], [0.5 * foot, foot - 1.5 * reach, -deep]])
    assert left.nearest(inner).distance == pytest.approx(0.0, abs=1e-9)


@pytest.mark.long
def test_the_planner_tells_volume_place_and_share_of_a_sharp_floor() -> None:
    angle, radius = np.radians(65.0), 0.03
    forming_pass = plan_passes(cone(65.0, 0.01, radius, 120))[-1]
    found = find_unreached_region(forming_pass, BALL)
    assert found is not None
    near = radius - 0.01 / np.tan(angle)
    half = 0.5 * angle
    # Pappus: the area between corner and arc, at about the foot's radius
    section = BALL**2 * (np.tan(half) - half)
    assert found.volume == pytest.approx(2.0 * np.pi * (near - 0.4e-3) * section, rel=0.06)
    assert found.max_distance == pytest.approx(BALL * (1.0 / np.cos(half) - 1.0), abs=2e-5)
    assert np.hypot(*found.point[:2]) == pytest.approx(near, abs=1e-3)
    assert found.regions == 1
    assert found.wall_fraction == pytest.approx(BALL * np.tan(half) / (0.01 / np.sin(angle)), rel=0.2)
