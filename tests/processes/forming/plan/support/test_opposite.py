"""Two balls opposite each other at sharp corners and over facets, against the planes of the walls."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath, PassContact
from planner.processes.forming.plan.paths.contact_path import make_contact_path
from planner.processes.forming.plan.paths.spiral import PathOptions
from planner.processes.forming.plan.support.modes import MountedSheet, make_mode_path
from planner.processes.forming.plan.support.opposite import (
    MAX_FACING_ANGLE_RAD,
    BallContactFace,
    make_opposite_path,
)
from planner.processes.forming.proof import tracks
from planner.processes.forming.proof.face import ProofFace
from planner.processes.forming.proof.forming_facts import TOUCH_TOLERANCE_M
from planner.processes.forming.proof.rules.two_tools import _direction_angle
from planner.processes.forming.proof.tracks import ToolTrack, straight_pieces
from planner.tooling import FormingHead
from tests.processes.forming.plan.paths.path_faces import cone
from tests.processes.forming.plan.shapes import BALL, T0, operation

TILT = np.radians(50.0)
RIM, DEPTH, LEVEL = 0.04, 0.02, T0
EAST = np.array([-np.sin(TILT), 0.0, np.cos(TILT)])
NORTH = np.array([0.0, -np.sin(TILT), np.cos(TILT)])


def pit() -> FormingPass:
    """A pit with a square outline, four plane walls that meet in sharp creases, and a flat around."""
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    foot = RIM - DEPTH / np.tan(TILT)
    rings = [(0.07, 0.0), (RIM, 0.0), (foot, -DEPTH)]
    vertices = np.array([[*(half * corner), LEVEL + z] for half, z in rings for corner in square])
    faces = [[8, 9, 10], [8, 10, 11]]
    for ring in (0, 4):
        for k in range(4):
            a, b = ring + k, ring + (k + 1) % 4
            faces += [[a, b, a + 4], [b, b + 4, a + 4]]
    thickness = np.full(len(vertices), T0 * np.cos(TILT))
    outline = np.column_stack([RIM * square, np.full(4, LEVEL)])
    region = np.concatenate([outline, outline[:1]])
    return FormingPass("f1", 1, 1, 1, vertices, np.array(faces), thickness, LEVEL, LEVEL - DEPTH, region)


def round_the_corner(height: float) -> ContactPath:
    """Up along the wall in the east to the corner, then along that in the north, the centre at a height."""
    down = LEVEL - height
    side = RIM - (down + BALL.radius / np.cos(TILT)) / np.tan(TILT)
    centre = np.array([[side, 0.0, height], [side, side, height], [0.0, side, height]])
    normal = np.array([EAST, NORTH, NORTH])
    count = len(centre)
    working = np.arange(count) > 0
    angle = np.full(count, TILT)
    return ContactPath(
        centre - BALL.radius * normal, normal, centre, angle, np.zeros(count, dtype=np.int64), working
    )


@pytest.fixture(scope="module")
def path() -> FormingToolPath:
    pass_contact = PassContact(pit(), round_the_corner(LEVEL - 0.006))
    return make_opposite_path(pass_contact, operation(), BALL, BALL, T0)


def lines(path: FormingToolPath) -> FloatArray:
    assert path.support_centre is not None
    across = path.forming_centre - path.support_centre
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def test_along_a_wall_the_line_is_the_walls_normal_up_to_the_corner(path: FormingToolPath) -> None:
    side = path.forming_centre[:, 0].max()
    line = lines(path)
    east = path.forming_centre[:, 1] < side - 1e-4
    north = path.forming_centre[:, 0] < side - 1e-4
    assert east.any() and north.any()
    for rows, normal in ((east, EAST), (north, NORTH)):
        pole = np.cross(normal, [0.0, 0.0, 1.0])
        beside = np.abs(line[rows] @ (pole / np.linalg.norm(pole)))
        assert np.degrees(np.arcsin(beside.max())) < 1.3  # steadied


def test_at_the_corner_the_former_waits_for_the_support(path: FormingToolPath) -> None:
    assert path.support_centre is not None
    at = np.linalg.norm(path.forming_centre[:, :2] - path.forming_centre[:, :2].max(axis=0), axis=1) < 5e-6
    assert at.sum() >= 10
    moved = np.linalg.norm(np.diff(path.support_centre[at], axis=0), axis=1)
    assert moved.sum() > 0.008
    # between both walls the line is a mean of their normals and the vertical, with no negative part
    basis = np.column_stack([EAST, NORTH, [0.0, 0.0, 1.0]])
    high = 1.0 / np.linalg.norm(np.linalg.inv(basis), axis=1)  # of each over the plane of the other two
    beyond = np.linalg.solve(basis, lines(path)[at].T) * high[:, None]
    assert np.degrees(np.arcsin(-beyond.min())) < 1.8  # steadied


def test_between_targets_gap_and_line_hold(path: FormingToolPath) -> None:
    assert path.support_centre is not None
    touching = BallContactFace(pit(), BALL.radius, 1.0, T0)
    for fraction in np.linspace(0.1, 0.9, 5):
        former = path.forming_centre[:-1] + fraction * np.diff(path.forming_centre, axis=0)
        support = path.support_centre[:-1] + fraction * np.diff(path.support_centre, axis=0)
        gap = np.linalg.norm(former - support, axis=1) - 2.0 * BALL.radius
        assert np.abs(gap - T0 * np.cos(TILT)).max() < 8e-6
    tilt = touching.touched_at(path.forming_centre)
    assert tilt.gap == pytest.approx(T0 * np.cos(TILT), abs=1e-9)


def test_heat_waits_at_the_corner_too() -> None:
    """The nozzle goes from one wall's normal to the other's while the ball stands where both walls' offset
    planes meet, in turns of a degree."""
    nozzle = FormingHead("heat", 0.01, 0.01, 0.0, 0.1, 0.0, 0.02)
    pass_contact = PassContact(pit(), round_the_corner(LEVEL - 0.006))
    path = make_mode_path(pass_contact, operation("heat"), BALL, nozzle, MountedSheet(T0))
    side, line = path.forming_centre[:, 0].max(), lines(path)
    deviation = np.rad2deg(np.arccos(np.clip(line @ np.stack([EAST, NORTH], axis=1), -1.0, 1.0)))
    away = np.abs(path.forming_centre[:, :2] - side).max(axis=1)
    assert deviation[away > 1e-5].min(axis=1).max() < 3.0  # steadied by up to 2.5 degrees
    between = deviation.min(axis=1) > 10.0
    assert between.sum() > 10 and away[between].max() < 5e-6
    pole = np.cross(EAST, NORTH) / np.linalg.norm(np.cross(EAST, NORTH))
    assert np.rad2deg(np.arcsin(np.abs(line @ pole))).max() < 3.0
    assert path.support_axis is not None
    turn = np.einsum("nd,nd->n", path.support_axis[1:], path.support_axis[:-1])
    assert np.rad2deg(np.arccos(np.clip(turn, -1.0, 1.0))).max() < 1.01


def test_off_the_wall_the_support_is_straight_below() -> None:
    contact = round_the_corner(LEVEL - 0.006)
    over = contact.centre.copy()
    over[1, 0] -= 0.002  # two millimetres off the wall in the east, before the corner
    over[1, 1] -= 0.01
    point = contact.point.copy()
    point[1] = over[1] - (BALL.radius + 0.002 * np.sin(TILT)) * EAST
    working = np.array([False, False, True])
    crossing = dataclasses.replace(contact, point=point, centre=over, working=working)
    path = make_opposite_path(PassContact(pit(), crossing), operation(), BALL, BALL, T0)
    assert path.support_centre is not None
    away = np.linalg.norm(path.forming_centre - over[1], axis=1)
    at = int(np.argmin(away))
    assert away[at] < 1e-9
    assert path.support_centre[at, :2] == pytest.approx(over[1, :2], abs=1e-9)
    assert path.forming_centre[at, 2] - path.support_centre[at, 2] == pytest.approx(
        2.0 * BALL.radius + path.gap[at], abs=1e-9
    )


def rounded(corner: float, pitch: float, shift: float) -> FormingPass:
    """A pit with walls of 50 deg, square with round corners, sampled on a grid; at its foot their radius is
    ``corner``, the grid ``pitch`` [m] wide and ``shift`` of that off the middle."""
    x, y = np.meshgrid(*[(np.arange(-20, 21) + shift) * pitch] * 2, indexing="ij")
    steep, high = np.tan(TILT), 8 * MM
    wide = corner + high / steep
    square = float(x.max()) - wide - 2.5 * pitch
    aside = np.hypot(np.maximum(np.abs(x) - square, 0.0), np.maximum(np.abs(y) - square, 0.0))
    z = np.clip((aside - wide) * steep, -high, 0.0) + T0
    k = np.arange(40)[:, None] * 41 + np.arange(40)
    a, b, c, d = (part.ravel() for part in (k, k + 41, k + 42, k + 1))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    ring = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * (square + wide + pitch)
    thickness = np.full(x.size, T0 * np.cos(TILT))
    return FormingPass(
        "f1",
        1,
        1,
        1,
        np.column_stack([x.ravel(), y.ravel(), z.ravel()]),
        faces,
        thickness,
        T0,
        T0 - high,
        ring,
    )


def direction_deviation_deg(
    forming_pass: FormingPass, centres: FloatArray, directions: FloatArray, ball: float
) -> float:
    """How far [deg] directions are off what the proof, by its own code, finds touched by balls there."""
    face = ProofFace(forming_pass.vertices, forming_pass.faces, ball)
    found = face.nearest(centres, TOUCH_TOLERANCE_M)
    return float(np.degrees(_direction_angle(directions, centres, face, found, 1, upright=True).max()))


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(("corner", "pitch", "shift"), [(5.5, 1.5, 0.1), (8.0, 1.5, 0.3), (5.3, 1.25, 0.0)])
def test_in_a_round_corner_of_coarse_facets_the_line_stays_at_what_is_touched(
    corner: float, pitch: float, shift: float
) -> None:
    """A ball that just fits touches facets far from each other, and hops between them."""
    one, head = rounded(corner * MM, pitch * MM, shift), dataclasses.replace(BALL, radius=5 * MM)
    options = PathOptions(stepdown=1.5 * MM, tangent_angle=np.radians(2.0))
    pass_contact = PassContact(one, make_contact_path(one, head.radius, options))
    path = make_opposite_path(pass_contact, operation(), head, head, T0)
    line = lines(path)
    assert path.forming_centre[:, 2].min() < T0 - 2.5 * MM
    middle, between = 0.5 * (path.forming_centre[1:] + path.forming_centre[:-1]), line[1:] + line[:-1]
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    assert direction_deviation_deg(one, path.forming_centre, line, head.radius) < 2.6
    assert direction_deviation_deg(one, middle, between, head.radius) < 3.1


def ringed(wall: float, corner: float, parts: int, high: float, square: float) -> FormingPass:
    """A pit with walls of ``wall`` [deg] down to a sharp floor ``high`` [mm] deep. Its corners, round by the
    radius ``corner`` [mm] at the floor about those of a square, are ``parts`` facets each."""
    wide = corner * MM + high * MM / np.tan(np.radians(wall))
    turn = (np.linspace(0.0, np.pi / 2, parts + 1) + np.pi / 2 * np.arange(4)[:, None]).ravel()
    signs = np.repeat(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]), parts + 1, axis=0)
    rings = []
    levels = np.linspace(0.0, -high * MM, 6)
    for radius, z in [(wide + 0.02, 0.0), *((wide + z / np.tan(np.radians(wall)), z) for z in levels)]:
        flat = square * MM * signs + radius * np.column_stack([np.cos(turn), np.sin(turn)])
        rings.append(np.column_stack([flat, np.full(len(flat), z + T0)]))
    m = len(turn)
    vertices = np.concatenate([*rings, [[0.0, 0.0, T0 - high * MM]]])
    i = np.arange(m)
    j = (i + 1) % m
    bands = [
        part
        for a in range(0, 6 * m, m)
        for part in (
            np.column_stack([a + i, a + j, a + m + i]),
            np.column_stack([a + j, a + m + j, a + m + i]),
        )
    ]
    faces = np.concatenate([*bands, np.column_stack([6 * m + i, 6 * m + j, np.full(m, 7 * m)])])
    ring = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * (square * MM + wide + 0.01)
    thickness = np.full(len(vertices), T0 * np.cos(np.radians(wall)))
    return FormingPass("f1", 1, 1, 1, vertices, faces, thickness, T0, T0 - high * MM, ring)


@pytest.mark.parametrize(
    ("wall", "corner", "parts", "high", "square", "ball", "step"),
    [
        (52.613966, 15.637319, 7, 9.488388, 9.736825, 6.35, 1.0),
        (35.024832, 9.827912, 8, 9.674805, 10.762764, 5.0, 1.0),
    ],
)
def test_all_along_the_foot_of_a_wall_the_ball_stays_at_the_wall(
    wall: float, corner: float, parts: int, high: float, square: float, ball: float, step: float
) -> None:
    """Straight moves take the ball off the wall by some of their chord: it must not touch the floor first."""
    one = ringed(wall, corner, parts, high, square)
    head = dataclasses.replace(BALL, radius=ball * MM)
    options = PathOptions(kind="helical", stepdown=step * MM, tangent_angle=np.radians(4.0))
    pass_contact = PassContact(one, make_contact_path(one, head.radius, options))
    path = make_opposite_path(pass_contact, operation(), head, head, T0)
    for fraction in (0.25, 0.5, 0.75):
        former, support = (
            way[:-1] + fraction * np.diff(way, axis=0) for way in (path.forming_centre, path.support_centre)
        )
        line = (former - support) / np.linalg.norm(former - support, axis=1, keepdims=True)
        assert direction_deviation_deg(one, former, line, head.radius) < 3.6


def test_over_facets_the_ball_leans_on_the_smooth_face() -> None:
    """A dish of a ball's own shape in facets of 3 deg: the sphere's normal is that from its centre."""
    radius, ball, step = 0.03, BALL.radius, np.radians(3.0)
    polar = np.arange(1, 21) * step
    turn = np.arange(120) * 2.0 * np.pi / 120
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rings = [np.column_stack([radius * np.sin(p) * ring, np.full(120, -radius * np.cos(p))]) for p in polar]
    vertices = np.concatenate([*rings, [[0.0, 0.0, -radius]]])
    fan = [[k, (k + 1) % 120, len(vertices) - 1] for k in range(120)]
    faces = [
        [j * 120 + k, (j + 1) * 120 + k, (j + 1) * 120 + (k + 1) % 120] for j in range(19) for k in range(120)
    ]
    faces += [
        [j * 120 + k, (j + 1) * 120 + (k + 1) % 120, j * 120 + (k + 1) % 120]
        for j in range(19)
        for k in range(120)
    ]
    one = FormingPass(
        "f1",
        1,
        1,
        1,
        vertices,
        np.array(fan + faces),
        np.full(len(vertices), T0),
        float(vertices[:, 2].max()),
        -radius,
        vertices[19 * 120 : 20 * 120],
    )
    rng = np.random.default_rng(3)
    tilt, spin = rng.uniform(0.1, 0.8, 400), rng.uniform(0.0, 2.0 * np.pi, 400)
    outward = np.column_stack([np.sin(tilt) * np.cos(spin), np.sin(tilt) * np.sin(spin), -np.cos(tilt)])
    tilt_angle = BallContactFace(one, ball, 1.0, T0).touched_at((radius - ball) * outward)
    deviation = np.arccos(np.clip(np.einsum("nd,nd->n", tilt_angle.normal, -outward), -1.0, 1.0))
    assert np.degrees(deviation.max()) < 1.0
    assert deviation.max() < MAX_FACING_ANGLE_RAD
    assert np.abs(tilt_angle.gap - T0 * np.cos(tilt)).max() < 0.03 * T0


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("kind", ["stepped", "contour", "alternating"])
def test_where_the_ball_steps_off_the_wall_the_support_turns_below_it_at_once(kind: str) -> None:
    """Off the wall the support stands below: the line turns there on the way, not more and more finely."""
    part = cone(0.06, 0.02, 50.0, 0.012)
    options = PathOptions(kind=kind, stepdown=2e-3, longest=3e-3)  # type: ignore[arg-type]
    contact = make_contact_path(part, BALL.radius, options)
    found = make_opposite_path(PassContact(part, contact), operation(path=kind), BALL, BALL, T0)
    line = lines(found)
    turn = np.degrees(np.arccos(np.clip((line[1:] * line[:-1]).sum(axis=1), -1.0, 1.0)))
    assert turn.max() < 5.0
    step = np.linalg.norm(np.diff(found.forming_centre, axis=0), axis=1)
    assert np.count_nonzero((step < 1e-6) & (turn < 0.1)) < 5
    assert len(found.forming_centre) < 4 * len(contact.centre)


def test_a_bend_that_two_tools_have_in_common_takes_nothing_from_their_gap() -> None:
    """Both turn by 90 degrees half-way between two samples, 1 mm apart along the way: by hand the corner is
    0.35 mm off what joins the samples. The way from one tool to the other does not bend at all, but where the
    second one is 0.1 mm aside at one sample."""
    one = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.5, 0.5, 0.0], [1.5, 1.5, 0.0], [1.5, 2.5, 0.0]])
    other = one - [0.0, 0.0, 11.0]
    found = straight_pieces(sampled_track(1e-3 * one, 1e-3 * other), 1e-6)
    assert found.deviation.max() > 2.5e-4
    assert found.distance_error == pytest.approx(np.full(len(found.distance_error), 2e-6))
    other[2, 2] += 0.1
    # by hand: second differences of 0.1 and 0.2 mm along their line are 0.067 mm between the samples
    assert straight_pieces(
        sampled_track(1e-3 * one, 1e-3 * other), 1e-6
    ).distance_error.max() == pytest.approx(6.87e-5, abs=2e-7)
    other[2] += [1.0, 0.0, -0.1]
    # across it a corner of 0.67 mm is 0.02 mm of 11
    assert straight_pieces(
        sampled_track(1e-3 * one, 1e-3 * other), 1e-6
    ).distance_error.max() == pytest.approx(2.3e-5, abs=2e-6)


def test_one_corner_between_two_samples_is_bounded_wherever_it_is() -> None:
    """Against the corner itself: its distance from the straight way that joins the samples."""
    rng = np.random.default_rng(11)
    for turn, at in zip(rng.uniform(0.05, 2.6, 60), rng.uniform(0.02, 0.98, 60), strict=True):
        way = np.array([[1.0, 0.0, 0.0], [np.cos(turn), np.sin(turn), 0.0]])
        corner = 5.0 * way[0]
        before = [corner - (k + at) * way[0] for k in range(4, -1, -1)]
        after = [corner + (k + 1.0 - at) * way[1] for k in range(5)]
        points = 1e-3 * np.array([*before, *after])
        chord = points[5] - points[4]
        true = np.linalg.norm(np.cross(1e-3 * corner - points[4], chord)) / np.linalg.norm(chord)
        found = straight_pieces(sampled_track(points, points - [0.0, 0.0, 11e-3]), 1e-9)
        own = (found.first <= 4) & (found.last >= 5)
        assert found.deviation[own].min() >= true - 1e-9
        assert found.deviation[own].max() <= 1.02 * true + 1e-6


def sampled_track(first_arm: FloatArray, second_arm: FloatArray) -> ToolTrack:
    """Samples of two arms in one segment, all of it forming."""
    centre = np.stack([first_arm, second_arm], axis=1)
    count = len(first_arm)
    joined, own = np.ones(count - 1, dtype=np.bool_), np.ones(count, dtype=np.bool_)
    return ToolTrack(("left", "right"), np.arange(count), centre, own, joined, (), np.eye(4)[None])


def test_a_track_is_the_same_in_pieces_however_many_samples_are_worked_out_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With gaps between samples too, at the edges of what is worked out at once among them."""
    rng = np.random.default_rng(5)
    one = np.cumsum(rng.normal(scale=1e-3, size=(120, 3)), axis=0)
    way = sampled_track(one, one - [0.0, 0.0, 11e-3] + rng.normal(scale=1e-4, size=(120, 3)))
    joined = way.joined.copy()
    joined[[6, 7, 40, 63]] = False
    way = dataclasses.replace(way, joined=joined)
    whole = straight_pieces(way, 1e-5)
    for count in (1, 2, 7, 64):
        monkeypatch.setattr(tracks, "SAMPLES_AT_ONCE", count)
        parts = straight_pieces(way, 1e-5)
        for field in dataclasses.fields(whole):
            assert np.array_equal(getattr(parts, field.name), getattr(whole, field.name)), field.name
