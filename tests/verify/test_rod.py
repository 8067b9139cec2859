"""The discrete rod against shapes and stability limits known from elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_bvp, solve_ivp

from planner.verify import rod_energy, rod_solve
from planner.verify.rod import Rod, RodError, follow, mount

Array = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])
LENGTH = 0.7
ROUND = 1.0 / 1.3  # torsion over bending of a round wire with Poisson's ratio 0.3


def frame(x: float, y: float, theta: float, spin: float = 0.0) -> Array:
    """Planar end frame in the world's x-y plane, then spun about its own x."""
    c, s, a, b = math.cos(theta), math.sin(theta), math.cos(spin), math.sin(spin)
    found = np.eye(4)
    found[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.array(
        [[1.0, 0, 0], [0, a, -b], [0, b, a]]
    )
    found[:2, 3] = x, y
    return found


def wire(ratio: float = 1.0, torsion: float = ROUND, weight: float = 0.0, segments: int = 64) -> Rod:
    return Rod(LENGTH, 2e-3, ratio * 2e-3, torsion * 2e-3, weight, segments)


def planar_reference(
    start: tuple[float, float, float], end: tuple[float, float, float], guess: Array
) -> Array:
    """Elastica x, y, theta, k at 65 points by scipy's collocation.

    x' = cos, y' = sin, theta' = k, k' = Fx sin - Fy cos.

    All in units of the length; `guess` is a polyline of 65 points.
    """
    s = np.linspace(0.0, 1.0, len(guess))
    slope = np.gradient(guess, s, axis=0)
    theta = np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))
    y0 = np.stack([guess[:, 0], guess[:, 1], theta, np.gradient(theta, s)])

    def rate(_: Array, y: Array, p: Array) -> Array:
        return np.stack([np.cos(y[2]), np.sin(y[2]), y[3], p[0] * np.sin(y[2]) - p[1] * np.cos(y[2])])

    def edge(a: Array, b: Array, _: Array) -> Array:
        return np.concatenate([a[:3] - start, b[:3] - end, []])

    solution = solve_bvp(rate, edge, s, y0, p=[-20.0, 0.0], tol=1e-10, max_nodes=20000)
    assert solution.success
    found: Array = solution.sol(s)
    return found


# ---- shapes ------------------------------------------------------------------------------------------------


def arc_frames(turn: float) -> tuple[Array, Array, Array]:
    radius = LENGTH / turn
    half = turn / 2
    centre = np.array([radius * math.sin(half), radius * math.cos(half), 0.0])
    return frame(0, 0, -half), frame(2 * radius * math.sin(half), 0, half), centre


@pytest.mark.parametrize("turn", [0.3, 1.2, math.pi, 1.5 * math.pi])
def test_arc_is_met(turn: float) -> None:
    a, b, centre = arc_frames(turn)
    rod = wire()
    path = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN, turning=turn))
    radii = np.linalg.norm(path.points[0] - centre, axis=1)
    assert np.abs(radii - LENGTH / turn).max() < 1e-6 * LENGTH
    assert np.allclose(path.curvature[0], [0.0, turn / LENGTH], atol=2e-5 * turn / LENGTH)
    assert np.abs(path.tension).max() < 1e-4 * rod.soft / LENGTH**2  # an arc needs no force
    assert path.stable[0] and not path.jump[0] and path.residual[0] < 1e-12


def test_s_shape_meets_collocation() -> None:
    start, end = (0.0, 0.0, 0.5), (0.9, 0.1, 0.4)
    a = frame(0, 0, 0.5)
    b = frame(0.9 * LENGTH, 0.1 * LENGTH, 0.4)
    rod = wire(ratio=10.0)
    path = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN))
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
        points[n] = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN)).points[0, :: n // 32]
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
    one = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN))
    two = follow(rod, (move @ a)[None], (move @ b)[None], DOWN, mount(rod, move @ a, move @ b, DOWN))
    assert np.allclose(one.points[0] @ turn.T + move[:3, 3], two.points[0], atol=1e-9)
    assert np.allclose(one.frames[0][:, :, 0] @ turn.T, two.frames[0][:, :, 0], atol=1e-7)


@pytest.mark.parametrize("ratio", [4.0, 1000.0])
def test_sag_across_a_slight_bow_is_that_of_the_beam_column(ratio: float) -> None:
    """EI y4 + P y2 = w with clamped ends; P = 4 pi^2 EI_soft / L^2 is the bow's thrust.

    For a stiff strip P does not count, and the sag is the textbook w L^4 / (384 EI).
    """
    a, b = frame(0, 0, 0), frame(LENGTH * (1.0 - 1e-7), 0, 0)
    rod = Rod(LENGTH, 2e-3, ratio * 2e-3, 2e-3, 2e-4)
    path = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN, bow=1.0))
    sag = -path.points[0, rod.segments // 2, 2]
    u = LENGTH / 2 * math.sqrt(4 * math.pi**2 / LENGTH**2 / ratio)
    exact = rod.weight * LENGTH**4 / rod.stiff / (16 * u**3) * (math.tan(u / 2) - u / 2)
    assert sag == pytest.approx(exact, rel=2e-3)
    if ratio > 100:
        assert sag == pytest.approx(rod.weight * LENGTH**4 / (384 * rod.stiff), rel=5e-3)


def test_each_clamp_of_a_symmetric_arch_carries_half_the_weight() -> None:
    a, b, down = frame(0, 0, 0.8), frame(0.5, 0, -0.8), np.array([0.0, -9.81, 0.0])
    rod = wire(weight=0.05)
    path = follow(rod, a[None], b[None], down, mount(rod, a, b, down))
    lift = (a[:3, :3] @ path.shapes[0].force)[1] * rod.soft / LENGTH**2  # on the wire at its end
    assert lift == pytest.approx(rod.weight * LENGTH / 2, rel=1e-6)


# ---- stability ---------------------------------------------------------------------------------------------


def test_gradient_and_hessian_are_those_of_the_energy() -> None:
    rng = np.random.default_rng(0)
    n, t = 8, 2
    stiffness = np.array([0.8, 10.0, 1.0])
    q = rod_energy.exponential(rng.normal(size=(3, n, t)) * 0.3)
    turn = rod_energy.exponential(rng.normal(size=(3, t)) * 0.3)
    ends = rod_energy.Ends(rng.normal(size=(3, t)), turn, rng.normal(size=(3, t)) * 3)
    force = rng.normal(size=(3, t)) * 5

    def turned(rotation: Array) -> Array:
        return rod_energy.multiply(q, rod_energy.exponential(rotation))

    def lagrangian(rotation: Array) -> Array:
        there = turned(rotation)
        return rod_energy.energy(stiffness, there, ends) - (force * rod_energy.gap(there, ends)).sum(axis=0)

    parts = rod_energy.derivatives(stiffness, q, force, ends)
    for i, k in np.ndindex(3, n):
        one = np.zeros((3, n, t))
        one[i, k] = 1e-5
        slope = (lagrangian(one) - lagrangian(-one)) / 2e-5
        assert np.allclose(slope, parts.gradient[i, k], atol=1e-7)
        gap = (rod_energy.gap(turned(one), ends) - rod_energy.gap(turned(-one), ends)) / 2e-5
        assert np.allclose(gap, parts.slope[:, i, k], atol=1e-8)
        one *= 10
        for j, m in ((j, m) for j in range(3) for m in (k, k + 1) if m < n):
            two = np.zeros((3, n, t))
            two[j, m] = 1e-4
            four = (
                lagrangian(one + two) - lagrangian(one - two) - lagrangian(two - one) + lagrangian(-one - two)
            )
            block = parts.diagonal[i, j, k] if m == k else parts.beside[i, j, k]
            assert np.allclose(four / 4e-8, block, atol=2e-5)


def test_batched_elimination_agrees_with_the_dense_solution() -> None:
    rng = np.random.default_rng(1)
    q = rod_energy.exponential(rng.normal(size=(3, 12, 5)) * 0.3)
    turn = rod_energy.exponential(rng.normal(size=(3, 5)) * 0.3)
    ends = rod_energy.Ends(rng.normal(size=(3, 5)), turn, rng.normal(size=(3, 5)))
    parts = rod_energy.derivatives(np.array([0.8, 4.0, 1.0]), q, rng.normal(size=(3, 5)) * 5, ends)
    work = rod_solve.Elimination(parts, lift=0.0)
    rotation, force = work.solve(-parts.gradient, parts.gap)
    names = ("gradient", "diagonal", "beside", "slope", "gap")
    for k in range(5):
        one = rod_energy.Derivatives(*(getattr(parts, name)[..., k : k + 1] for name in names))
        full = rod_solve.saddle(one)
        dense = np.linalg.solve(full, np.concatenate([-one.gradient[..., 0].T.ravel(), one.gap[:, 0]]))
        assert np.allclose(dense[:36].reshape(12, 3).T, rotation[..., k], atol=1e-7)
        assert np.allclose(dense[36:], force[:, k], atol=1e-6)
        negatives = int((np.linalg.eigvalsh(full) < 0).sum())
        assert negatives == work.negatives[k] + 3 == rod_solve.factor(full)[2]


def rocking(rod: Rod, distance: float, angles: Array) -> tuple[Array, Array]:
    """End frames that turn symmetrically from bowing up (angle > 0) to bowing down."""
    a = np.array([frame(0, 0, angle) for angle in angles])
    return a, np.array([frame(distance * rod.length, 0, -angle) for angle in angles])


def test_round_wire_between_rocking_ends_turns_over_as_soon_as_they_pass_level() -> None:
    """With level ends any plane through the ends is as good as any other, so past level the shape must fall;
    the mirror image of the shape before is the only stable one of its kind."""
    rod = wire()
    angles = np.linspace(0.31, -0.31, 32)
    a, b = rocking(rod, 0.9, angles)
    path = follow(rod, a, b, DOWN, mount(rod, a[0], b[0], DOWN))
    assert path.jump.tolist() == [k == 16 for k in range(32)]
    assert path.stable.all()
    assert np.allclose(path.points[::-1] * [1, -1, 1], path.points, atol=1e-5 * LENGTH)
    assert path.moved[16] > 0.3 * LENGTH and path.moved[:16].max() == 0.0
    assert path.min_eig[15] < 0.02 < path.min_eig[0]


def first_singular_angle(distance: float, angles: Array) -> float:
    """Where the planar elastica between rocking ends ends: its shooting map's Jacobian is singular there.

    The map takes (k0, Fx, Fy) at the start to (x, y, theta) at the end, integrated by scipy.
    """

    def shoot(p: Array, angle: float) -> Array:
        """Misses (3, m) of m starts (3, m)."""

        def rate(_: float, flat: Array) -> Array:
            y = flat.reshape(4, -1)
            return np.concatenate(
                [np.cos(y[2]), np.sin(y[2]), y[3], p[1] * np.sin(y[2]) - p[2] * np.cos(y[2])]
            )

        m = p.shape[1]
        start = np.concatenate([np.zeros(2 * m), np.full(m, angle), p[0]])
        end = (
            solve_ivp(rate, (0, 1), start, rtol=1e-10, atol=1e-12, method="DOP853").y[:, -1].reshape(4, m)[:3]
        )
        return np.asarray(end) - np.array([[distance], [0.0], [-angle]])

    def linear(p: Array, angle: float) -> tuple[Array, Array]:
        """The miss (3,) and its Jacobian (3, 3)."""
        steps = np.diag([1e-5, 1e-4, 1e-4])
        misses = shoot(p[:, None] + np.concatenate([np.zeros((3, 1)), steps, -steps], axis=1), angle)
        return misses[:, 0], (misses[:, 1:4] - misses[:, 4:]) / (2 * steps.sum(axis=0))

    reference = planar_reference(
        (0, 0, angles[0]), (distance, 0, -angles[0]), start_guess(distance, angles[0])
    )
    theta, k = reference[2], reference[3]
    s = np.linspace(0, 1, len(theta))
    bend = np.gradient(k, s)[5:-5]
    fx, fy = np.linalg.lstsq(np.stack([np.sin(theta), -np.cos(theta)], axis=1)[5:-5], bend, rcond=None)[0]
    p = np.array([k[0], fx, fy])
    determinants: list[tuple[float, float]] = []
    for angle in angles:
        old = p
        for _ in range(5):
            miss, jacobian = linear(p, angle)
            p = p - np.linalg.solve(jacobian, miss)
        miss, jacobian = linear(p, angle)
        if determinants and (np.abs(p - old).max() > 3.0 or np.abs(miss).max() > 1e-8):  # the branch is left
            (a1, d1), (a2, d2) = determinants[-2:]
            return a2 + (a2 - a1) * d2**2 / (d1**2 - d2**2)  # at a fold the square goes to 0 evenly
        determinants.append((float(angle), float(np.linalg.det(jacobian))))
    raise AssertionError("no singular angle in the range")


def start_guess(distance: float, angle: float) -> Array:
    """A polyline close to the shape, from the mounted rod (only to start the reference's own iteration)."""
    rod = wire(10.0)
    a, b = rocking(rod, distance, np.array([angle]))
    points: Array = follow(rod, a, b, DOWN, mount(rod, a[0], b[0], DOWN, bow=1.0)).points[0, :, :2] / LENGTH
    return points


def test_strip_between_rocking_ends_snaps_where_the_planar_elastica_ends() -> None:
    rod = wire(10.0)
    angles = np.linspace(-0.3, -0.8, 51)
    a, b = rocking(rod, 0.9, angles)
    path = follow(rod, a, b, DOWN, mount(rod, a[0], b[0], DOWN, bow=1.0))
    critical = first_singular_angle(0.9, np.arange(-0.57, -0.7, -0.01))
    jumps = np.flatnonzero(path.jump)
    assert len(jumps) == 1
    assert angles[jumps[0]] - 0.001 <= critical <= angles[jumps[0] - 1] + 0.001
    assert np.abs(path.points[..., 2]).max() < 1e-6  # in its plane all the way
    assert path.stable.all()
    # behind the snap: the mirror image of the shape with the opposite angle
    last = angles[-1]
    c, d = rocking(rod, 0.9, -np.array([last]))
    twin = follow(rod, c, d, DOWN, mount(rod, c[0], d[0], DOWN))
    assert np.allclose(twin.points[0] * [1, -1, 1], path.points[-1], atol=1e-5 * LENGTH)


def test_round_wire_buckles_out_of_plane_where_a_strip_holds() -> None:
    """Two inflections: stable in the plane (the strip shows it), not out of it for a round wire."""
    angles = np.linspace(-0.05, -0.3, 11)
    for ratio, holds in ((10.0, True), (1.0, False)):
        rod = wire(ratio)
        a, b = rocking(rod, 0.8, angles)
        flat = mount(wire(10.0), a[0], b[0], DOWN, bow=1.0)
        path = follow(rod, a, b, DOWN, flat)
        signs = np.sign(path.curvature[0, :, 1])
        if holds:
            assert (np.diff(signs[2:-2]) != 0).sum() == 2
            assert path.stable.all() and not path.jump.any()
            assert np.abs(path.points[..., 2]).max() < 1e-8
            assert path.min_eig.min() > 0.1
        else:
            assert path.jump[0]  # the planar shape cannot even be mounted
            assert path.points[0, 32, 1] < 0.0  # it has turned over


def test_spin_of_both_ends_together_leaves_a_round_wire_alone_and_turns_no_twist_into_it() -> None:
    rod = wire()
    spins = np.linspace(0.0, 4.0 * math.pi, 60)
    a = np.array([frame(0, 0, 0.7, spin) for spin in spins])
    b = np.array([frame(0.55, 0.1, -0.9, spin) for spin in spins])
    path = follow(rod, a, b, DOWN, mount(rod, a[0], b[0], DOWN))
    assert not path.jump.any() and path.stable.all()
    assert np.abs(path.points - path.points[0]).max() < 1e-9
    assert np.abs(path.twist).max() < 1e-6


def test_unequal_spin_twists_evenly() -> None:
    rod = Rod(LENGTH, 2e-3, 2e-3, 6e-3)  # torsionally stiff: holds the twist
    spins = np.linspace(0.0, 0.5, 12)
    a, b, _ = arc_frames(0.8)
    turned = np.array([b @ frame(0, 0, 0, spin) for spin in spins])
    path = follow(rod, np.repeat(a[None], 12, axis=0), turned, DOWN, mount(rod, a, b, DOWN))
    assert path.stable.all() and not path.jump.any()
    # the torsion moment of an isotropic rod is constant along it (Love, Treatise on Elasticity, art. 260)
    assert np.ptp(path.twist[-1]) < 2e-3 * abs(path.twist[-1]).mean()


def test_ring_loses_stability_at_the_twist_of_michell_and_zajac() -> None:
    """A closed ring with its ends twisted against each other buckles at 2 pi sqrt(3) EI / GJ (Michell 1889;
    Zajac, Trans. ASME J. Appl. Mech. 29, 1962; Goriely, J. Elasticity 84, 2006)."""
    torsion = 1.6
    critical = 2.0 * math.pi * math.sqrt(3.0) / torsion
    n = 96
    middle = (np.arange(n) + 0.5) / n
    values = []
    for twist in (0.97 * critical, 1.03 * critical):
        around = rod_energy.exponential(np.outer([0, 0, 1.0], 2 * math.pi * middle))
        about = rod_energy.exponential(np.outer([1.0, 0, 0], twist * middle))
        q = rod_energy.multiply(around, about)[..., None]
        turn = rod_energy.exponential(np.array([twist, 0.0, 0.0]))[:, None]
        ends = rod_energy.Ends(np.zeros((3, 1)), turn, np.zeros((3, 1)))
        stiffness = np.array([torsion, 1.0, 1.0])
        # the ring stands because of a force along its axis' direction: found by least squares of the gradient
        state = rod_solve.State(q, np.zeros((3, 1)))
        state = rod_solve.newton(stiffness, state, ends, rounds=30).state
        full = rod_solve.saddle(rod_energy.derivatives(stiffness, state.q, state.force, ends))
        basis = np.linalg.qr(full[3 * n :, : 3 * n].T, mode="complete")[0][:, 3:]
        lowest = np.linalg.eigvalsh(basis.T @ full[: 3 * n, : 3 * n] @ basis)[:3] * n
        values.append(lowest)
    before, after = values
    # one eigenvalue is 0 always: a round ring rolls freely about its own line
    assert abs(before).min() < 1e-3 and abs(after).min() < 1e-3
    assert (before < -1e-3).sum() == 0
    assert (after < -1e-3).sum() >= 1


# ---- following ---------------------------------------------------------------------------------------------


def test_many_instants_at_once_equal_one_after_the_other() -> None:
    rod = wire(10.0, weight=0.02)
    u = np.linspace(0.0, 1.0, 65)
    a = np.array([frame(0, 0.02 * x, 0.6 - 0.4 * math.sin(3 * x)) for x in u])
    b = np.array([frame(0.6 - 0.08 * x, 0.05 * x, -0.5 - 0.7 * x) for x in u])
    first = mount(rod, a[0], b[0], DOWN)
    one, many = follow(rod, a, b, DOWN, first, stride=1), follow(rod, a, b, DOWN, first, stride=16)
    assert np.abs(one.points - many.points).max() < 1e-9
    assert np.allclose(one.min_eig, many.min_eig, atol=1e-6)
    assert np.array_equal(many.points, follow(rod, a, b, DOWN, first, stride=16).points)
    going_on = follow(rod, a[40:], b[40:], DOWN, many.shapes[40])
    assert np.abs(going_on.points - many.points[40:]).max() < 1e-9


def test_a_full_turn_is_remembered() -> None:
    """The same end frames with the wire wound once around: the shape depends on the way that led there."""
    rod = wire(10.0)
    a, b, _ = arc_frames(1.5 * math.pi)
    wound = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN, turning=1.5 * math.pi))
    other = follow(rod, a[None], b[None], DOWN, mount(rod, a, b, DOWN, turning=-0.5 * math.pi))
    assert wound.stable[0] and other.stable[0]
    assert np.abs(wound.points - other.points).max() > 0.05 * LENGTH


def test_ends_too_far_apart_are_said() -> None:
    rod = wire()
    a, b = frame(0, 0, 0), frame(LENGTH * 1.001, 0, 0)
    with pytest.raises(RodError, match="must be longer"):
        mount(rod, a, b, DOWN)
    near = np.array([frame(x * LENGTH, 0, -0.2) for x in np.linspace(0.9, 1.01, 12)])
    start = np.repeat(frame(0, 0, 0.2)[None], 12, axis=0)
    path = follow(rod, start, near, DOWN, mount(rod, start[0], near[0], DOWN))
    assert path.stable[0] and not path.stable[-1]
    assert path.residual[-1] > 0.005


@pytest.mark.parametrize(
    "numbers", [{"length": 0.0}, {"soft": -1.0}, {"weight": math.nan}, {"segments": 7}, {"torsion": math.inf}]
)
def test_rods_without_meaning_are_refused(numbers: dict[str, float]) -> None:
    sound = {"length": 1.0, "soft": 1.0, "stiff": 1.0, "torsion": 1.0, "weight": 0.0, "segments": 64}
    with pytest.raises(RodError):
        Rod(**{**sound, **numbers})  # type: ignore[arg-type]
