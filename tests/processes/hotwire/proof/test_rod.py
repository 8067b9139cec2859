"""The discrete rod against known shapes and stability limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner.processes.hotwire.proof.rod import Rod, RodError, follow_rod, mount_rod
from tests.processes.hotwire.proof.rods import DOWN, LENGTH, arc_frames, frame, planar_reference, wire


@pytest.mark.parametrize("turn", [0.3, 1.2, math.pi, 1.5 * math.pi])
def test_arc_is_met(turn: float) -> None:
    a, b, centre = arc_frames(turn)
    rod = wire()
    path = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN, turning=turn))
    radii = np.linalg.norm(path.points[0] - centre, axis=1)
    assert np.abs(radii - LENGTH / turn).max() < 1e-6 * LENGTH
    assert np.allclose(path.curvature[0], [0.0, turn / LENGTH], atol=2e-5 * turn / LENGTH)
    assert np.abs(path.tension).max() < 1e-4 * rod.soft_bending / LENGTH**2  # an arc needs no force
    assert path.is_stable[0] and not path.has_jumped[0] and path.residual[0] < 1e-12


def test_s_shape_meets_collocation() -> None:
    start, end = (0.0, 0.0, 0.5), (0.9, 0.1, 0.4)
    a = frame(0, 0, 0.5)
    b = frame(0.9 * LENGTH, 0.1 * LENGTH, 0.4)
    rod = wire(ratio=10.0)
    path = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN))
    reference = planar_reference(start, end, path.points[0, :, :2] / LENGTH)
    got = path.points[0, :, :2].T / LENGTH
    assert np.abs(got - reference[:2]).max() < 2e-6
    assert np.abs(path.curvature[0, :, 1] * LENGTH - reference[3]).max() < 2e-2  # second order at the clamps
    assert np.sign(reference[3]).min() < 0 < np.sign(reference[3]).max()  # it does have an inflection
    assert path.error[0] < 1e-3 * LENGTH


def test_refined_error_falls_with_the_fourth_power() -> None:
    a = frame(0, 0, 0.5)
    b = frame(0.8 * LENGTH, 0.1 * LENGTH, 0.9)
    points = {}
    for n in (32, 64, 256):
        rod = wire(ratio=10.0, segments=n)
        points[n] = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN)).points[0, :: n // 32]
    coarse, fine = (np.abs(points[n] - points[256]).max() / LENGTH for n in (32, 64))
    assert fine < 5e-6
    assert coarse / fine > 9.0


def test_attitude_and_place_in_space_do_not_matter_without_weight() -> None:
    a, b = frame(0, 0, 0.6), frame(0.6, 0.05, -0.4)
    rng = np.random.default_rng(3)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = turn, rng.normal(size=3)
    rod = wire(10.0)
    one = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN))
    two = follow_rod(rod, (move @ a)[None], (move @ b)[None], DOWN, mount_rod(rod, move @ a, move @ b, DOWN))
    assert np.allclose(one.points[0] @ turn.T + move[:3, 3], two.points[0], atol=1e-9)
    assert np.allclose(one.frames[0][:, :, 0] @ turn.T, two.frames[0][:, :, 0], atol=1e-7)


@pytest.mark.parametrize("ratio", [4.0, 1000.0])
def test_sag_across_a_slight_bow_is_that_of_the_beam_column(ratio: float) -> None:
    """EI y4 + P y2 = w with clamped ends; P = 4 pi^2 EI_soft / L^2 is the bow's thrust.

    For a stiff strip P does not count, and the sag is the textbook w L^4 / (384 EI).
    """
    a, b = frame(0, 0, 0), frame(LENGTH * (1.0 - 1e-7), 0, 0)
    rod = Rod(LENGTH, 2e-3, ratio * 2e-3, 2e-3, 2e-4)
    path = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN, bow=1.0))
    sag = -path.points[0, rod.segments // 2, 2]
    u = LENGTH / 2 * math.sqrt(4 * math.pi**2 / LENGTH**2 / ratio)
    exact = rod.weight * LENGTH**4 / rod.stiff_bending / (16 * u**3) * (math.tan(u / 2) - u / 2)
    assert sag == pytest.approx(exact, rel=2e-3)
    if ratio > 100:
        assert sag == pytest.approx(rod.weight * LENGTH**4 / (384 * rod.stiff_bending), rel=5e-3)


def test_each_clamp_of_a_symmetric_arch_carries_half_the_weight() -> None:
    a, b, down = frame(0, 0, 0.8), frame(0.5, 0, -0.8), np.array([0.0, -9.81, 0.0])
    rod = wire(weight=0.05)
    path = follow_rod(rod, a[None], b[None], down, mount_rod(rod, a, b, down))
    lift = (a[:3, :3] @ path.shapes[0].force)[1] * rod.soft_bending / LENGTH**2  # on the wire at its end
    assert lift == pytest.approx(rod.weight * LENGTH / 2, rel=1e-6)


# ---- following ---------------------------------------------------------------------------------------------


def test_many_instants_at_once_equal_one_after_the_other() -> None:
    rod = wire(10.0, weight=0.02)
    u = np.linspace(0.0, 1.0, 65)
    a = np.array([frame(0, 0.02 * x, 0.6 - 0.4 * math.sin(3 * x)) for x in u])
    b = np.array([frame(0.6 - 0.08 * x, 0.05 * x, -0.5 - 0.7 * x) for x in u])
    first = mount_rod(rod, a[0], b[0], DOWN)
    one, many = follow_rod(rod, a, b, DOWN, first, stride=1), follow_rod(rod, a, b, DOWN, first, stride=16)
    assert np.abs(one.points - many.points).max() < 1e-9
    assert np.allclose(one.min_eigenvalue, many.min_eigenvalue, atol=1e-6)
    assert np.array_equal(many.points, follow_rod(rod, a, b, DOWN, first, stride=16).points)
    going_on = follow_rod(rod, a[40:], b[40:], DOWN, many.shapes[40])
    assert np.abs(going_on.points - many.points[40:]).max() < 1e-9


def test_a_full_turn_is_remembered() -> None:
    """The same end frames with the wire wound once around: the shape depends on the way that led there."""
    rod = wire(10.0)
    a, b, _ = arc_frames(1.5 * math.pi)
    wound = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN, turning=1.5 * math.pi))
    other = follow_rod(rod, a[None], b[None], DOWN, mount_rod(rod, a, b, DOWN, turning=-0.5 * math.pi))
    assert wound.is_stable[0] and other.is_stable[0]
    assert np.abs(wound.points - other.points).max() > 0.05 * LENGTH


def test_ends_too_far_apart_are_said() -> None:
    rod = wire()
    a, b = frame(0, 0, 0), frame(LENGTH * 1.001, 0, 0)
    with pytest.raises(RodError, match="must be longer"):
        mount_rod(rod, a, b, DOWN)
    near = np.array([frame(x * LENGTH, 0, -0.2) for x in np.linspace(0.9, 1.01, 12)])
    start = np.repeat(frame(0, 0, 0.2)[None], 12, axis=0)
    path = follow_rod(rod, start, near, DOWN, mount_rod(rod, start[0], near[0], DOWN))
    assert path.is_stable[0] and not path.is_stable[-1]
    assert path.residual[-1] > 0.005


@pytest.mark.parametrize(
    "numbers",
    [{"length": 0.0}, {"soft_bending": -1.0}, {"weight": math.nan}, {"segments": 7}, {"torsion": math.inf}],
)
def test_rods_without_meaning_are_refused(numbers: dict[str, float]) -> None:
    sound = {
        "length": 1.0,
        "soft_bending": 1.0,
        "stiff_bending": 1.0,
        "torsion": 1.0,
        "weight": 0.0,
        "segments": 64,
    }
    with pytest.raises(RodError):
        Rod(**{**sound, **numbers})  # type: ignore[arg-type]
