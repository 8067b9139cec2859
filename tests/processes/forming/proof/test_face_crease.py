"""The line of two tools where the forming ball touches both walls of a crease, against closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import Delaunay

from planner.processes.forming.proof.face import NearestPoints, ProofFace
from planner.processes.forming.proof.forming_facts import TOUCH_TOLERANCE_M, BallContacts
from planner.processes.forming.proof.rules.two_tools import _line_angle
from planner.processes.forming.proof.tracks import ToolTrack

TILT = np.radians(60.0)
RADIUS = 0.005
WALLS = np.array([[-np.sin(TILT), 0.0, np.cos(TILT)], [0.0, -np.sin(TILT), np.cos(TILT)]])
CORNER = np.linalg.solve(np.vstack([WALLS, [0.0, 0.0, 1.0]]), [RADIUS, RADIUS, 0.0])
"""A ball's centre there touches both walls, which meet in a crease through the origin."""


def line_deviation_deg(
    centre: np.ndarray, line: np.ndarray, walls: np.ndarray = WALLS, upright: bool = True
) -> float:
    """Return the deviation [deg] that the proof finds for a line of two tools, with a ball about ``centre``.

    If ``upright`` is False, the line is that of a ball and a heat source that need not stand upright off the
    walls.
    """
    along = np.cross(*walls)
    along /= np.linalg.norm(along)
    away = [np.cross(walls[0], along), -np.cross(walls[1], along)]
    away = [side * np.sign(side @ other) for side, other in zip(away, walls[::-1], strict=True)]
    points = [-0.05 * along, 0.05 * along]
    vertices = np.array([*points, *(p + 0.05 * a for a in away for p in points)])
    faces = np.array([[0, 2, 3], [0, 3, 1], [0, 5, 4], [0, 1, 5]])
    normal = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    faces[normal[:, 2] < 0.0] = faces[normal[:, 2] < 0.0][:, ::-1]
    face = ProofFace(vertices, faces, RADIUS)
    both = np.stack([centre, centre - 2.1 * RADIUS * line / np.linalg.norm(line)])[None]
    rows = np.zeros(1, dtype=np.int64)
    joined = np.zeros(0, dtype=np.bool_)
    way = ToolTrack(("left", "right"), rows, both, np.ones(1, dtype=np.bool_), joined, (), np.eye(4)[None])
    found = face.nearest(both[:, 0], TOUCH_TOLERANCE_M)
    return float(np.rad2deg(_line_angle(way, rows, face, found, 1, upright=upright)[0]))


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5, 1.0])
@pytest.mark.parametrize("up", [0.0, 0.4])
def test_between_two_walls_that_the_ball_touches_the_line_may_be_any_mean(fraction: float, up: float) -> None:
    line = (1.0 - fraction) * WALLS[0] + fraction * WALLS[1] + np.array([0.0, 0.0, up])
    assert line_deviation_deg(CORNER, line) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.5, 1.0])
def test_heat_may_come_from_between_both_walls_but_from_nowhere_above_them(fraction: float) -> None:
    """Off the great circle through both normals as far as it is turned out of its plane."""
    mean = (1.0 - fraction) * WALLS[0] + fraction * WALLS[1]
    assert line_deviation_deg(CORNER, mean, upright=False) == pytest.approx(0.0, abs=1e-4)
    pole = np.cross(*WALLS)
    pole *= np.sign(pole[2]) / np.linalg.norm(pole)
    up = np.cos(np.deg2rad(12.0)) * mean / np.linalg.norm(mean) + np.sin(np.deg2rad(12.0)) * pole
    assert line_deviation_deg(CORNER, up, upright=False) == pytest.approx(12.0, abs=1e-6)


def test_heat_comes_from_one_wall_beside_the_crease() -> None:
    line = WALLS[0] + WALLS[1]
    beside = CORNER + np.array([0.0, -5e-5, 0.0])
    expected = np.arccos(line @ WALLS[0] / np.linalg.norm(line))
    assert line_deviation_deg(beside, line, upright=False) == pytest.approx(np.rad2deg(expected), abs=1e-6)
    assert line_deviation_deg(CORNER, 2.0 * WALLS[0] - WALLS[1], upright=False) > 10.0  # beyond both


def test_beside_the_crease_one_wall_alone_is_touched() -> None:
    line = WALLS[0] + WALLS[1]
    beside = CORNER + np.array([0.0, -5e-5, 0.0])  # off the wall in the north
    pole = np.cross(WALLS[0], [0.0, 0.0, 1.0])
    expected = np.arcsin(abs(line @ pole) / np.linalg.norm(pole) / np.linalg.norm(line))
    assert line_deviation_deg(beside, line) == pytest.approx(np.rad2deg(expected), abs=1e-6)
    assert line_deviation_deg(beside, line) > 20.0


def hollow(half: float) -> np.ndarray:
    """Normals of two facets of a hollow that lean at 45 degrees and turn by twice ``half`` [deg]."""
    spin = np.deg2rad([-half, half])
    middle, beside = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0), np.array([0.0, 1.0, 0.0])
    return np.cos(spin)[:, None] * middle + np.sin(spin)[:, None] * beside


@pytest.mark.parametrize("half", [3.0, 7.0, 9.5])
def test_where_a_ball_touches_two_facets_of_a_hollow_its_normal_is_any_between(half: float) -> None:
    """Facets that are no crease, of a hollow as narrow as the ball: it touches both far from their edge."""
    walls = hollow(half)
    middle = walls.sum(axis=0)
    centre = RADIUS * middle / (1.0 + walls[0] @ walls[1])
    assert walls @ centre == pytest.approx([RADIUS, RADIUS])
    assert line_deviation_deg(centre, middle, walls) == pytest.approx(0.0, abs=1e-4)
    assert line_deviation_deg(centre, walls[0], walls) == pytest.approx(0.0, abs=1e-4)
    on_one = centre + 2e-4 * np.array([0.0, 1.0, 0.0])  # rolled onto the first one alone
    on_one += (RADIUS - walls[0] @ on_one) * walls[0]
    assert line_deviation_deg(on_one, walls[0], walls) == pytest.approx(0.0, abs=1e-4)
    assert line_deviation_deg(on_one, walls[1], walls) > half


@pytest.mark.parametrize("degrees", [5.0, 30.0])
def test_beyond_both_walls_the_line_is_off_by_how_far_it_is_beyond(degrees: float) -> None:
    """Off the great circle through both normals, away from the vertical."""
    mean = (WALLS[0] + WALLS[1]) / np.linalg.norm(WALLS[0] + WALLS[1])
    pole = np.cross(*WALLS)
    pole *= -np.sign(pole[2]) / np.linalg.norm(pole)
    angle = np.deg2rad(degrees)
    assert line_deviation_deg(CORNER, np.cos(angle) * mean + np.sin(angle) * pole) == pytest.approx(
        degrees, abs=1e-6
    )


def test_what_is_nearest_is_the_same_however_it_is_asked() -> None:
    rng = np.random.default_rng(7)
    vertices = np.column_stack([rng.uniform(-0.1, 0.1, (40, 2)), np.zeros(40)])
    faces = Delaunay(vertices[:, :2]).simplices.astype(np.int64)
    cross = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    faces[cross[:, 2] < 0.0] = faces[cross[:, 2] < 0.0][:, ::-1]
    face = ProofFace(vertices, faces, RADIUS)
    centre = np.column_stack([rng.uniform(-0.15, 0.15, (60, 2)), rng.uniform(-0.02, 0.02, 60)])[:, None]
    # over vertices, where many triangles are as near
    centre[:8, 0] = vertices[:8] + np.array([0.0, 0.0, RADIUS])
    joined, own = np.zeros(59, dtype=np.bool_), np.ones(60, dtype=np.bool_)
    way = ToolTrack(("left",), np.arange(60), centre, own, joined, (), np.eye(4)[None])
    balls = BallContacts(way, face)
    for rows in (np.array([3, 10, 40]), np.array([0, 3, 7, 41]), np.arange(60), np.array([5])):
        got, expected = balls.nearest_at(rows), face.nearest(centre[rows, 0], TOUCH_TOLERANCE_M)
        for field in dataclasses.fields(NearestPoints):
            assert np.array_equal(getattr(got, field.name), getattr(expected, field.name)), field.name
