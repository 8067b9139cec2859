"""Stability limits of the discrete rod, against known values."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.proof import rod_energy, rod_equilibrium
from planner.processes.hotwire.proof.rod import Rod, follow_rod, mount_rod
from tests.processes.hotwire.proof.rods import DOWN, LENGTH, arc_frames, frame, planar_reference, wire


def end_gap(q: FloatArray, ends: rod_energy.RodEnds) -> FloatArray:
    """Error (3, T) of the end's place."""
    gap: FloatArray = rod_energy.rotation_matrix(q)[:, 0].sum(axis=1) / q.shape[1] - ends.position
    return gap


def test_gradient_and_hessian_are_those_of_the_energy() -> None:
    rng = np.random.default_rng(0)
    n, t = 8, 2
    stiffness = np.array([0.8, 10.0, 1.0])
    q = rod_energy.quaternion_exp(rng.normal(size=(3, n, t)) * 0.3)
    turn = rod_energy.quaternion_exp(rng.normal(size=(3, t)) * 0.3)
    ends = rod_energy.RodEnds(rng.normal(size=(3, t)), turn, rng.normal(size=(3, t)) * 3)
    force = rng.normal(size=(3, t)) * 5

    def rotated(rotation: FloatArray) -> FloatArray:
        return rod_energy.quaternion_product(q, rod_energy.quaternion_exp(rotation))

    def lagrangian(rotation: FloatArray) -> FloatArray:
        there = rotated(rotation)
        return rod_energy.rod_energy(stiffness, there, ends) - (force * end_gap(there, ends)).sum(axis=0)

    parts = rod_energy.rod_derivatives(stiffness, q, force, ends)
    for i, k in np.ndindex(3, n):
        one = np.zeros((3, n, t))
        one[i, k] = 1e-5
        slope = (lagrangian(one) - lagrangian(-one)) / 2e-5
        assert np.allclose(slope, parts.gradient[i, k], atol=1e-7)
        gap = (end_gap(rotated(one), ends) - end_gap(rotated(-one), ends)) / 2e-5
        assert np.allclose(gap, parts.end_jacobian[:, i, k], atol=1e-8)
        one *= 10
        for j, m in ((j, m) for j in range(3) for m in (k, k + 1) if m < n):
            two = np.zeros((3, n, t))
            two[j, m] = 1e-4
            four = (
                lagrangian(one + two) - lagrangian(one - two) - lagrangian(two - one) + lagrangian(-one - two)
            )
            block = parts.diagonal[i, j, k] if m == k else parts.off_diagonal[i, j, k]
            assert np.allclose(four / 4e-8, block, atol=2e-5)


def test_batched_elimination_agrees_with_the_dense_solution() -> None:
    rng = np.random.default_rng(1)
    q = rod_energy.quaternion_exp(rng.normal(size=(3, 12, 5)) * 0.3)
    turn = rod_energy.quaternion_exp(rng.normal(size=(3, 5)) * 0.3)
    ends = rod_energy.RodEnds(rng.normal(size=(3, 5)), turn, rng.normal(size=(3, 5)))
    parts = rod_energy.rod_derivatives(np.array([0.8, 4.0, 1.0]), q, rng.normal(size=(3, 5)) * 5, ends)
    work = rod_equilibrium.BlockElimination(parts, lift=0.0)
    rotation, force = work.solve(-parts.gradient, parts.end_error)
    names = ("gradient", "diagonal", "off_diagonal", "end_jacobian", "end_error")
    for k in range(5):
        one = rod_energy.RodDerivatives(*(getattr(parts, name)[..., k : k + 1] for name in names))
        full = rod_equilibrium.saddle_matrix(one)
        dense = np.linalg.solve(full, np.concatenate([-one.gradient[..., 0].T.ravel(), one.end_error[:, 0]]))
        assert np.allclose(dense[:36].reshape(12, 3).T, rotation[..., k], atol=1e-7)
        assert np.allclose(dense[36:], force[:, k], atol=1e-6)
        negatives = int((np.linalg.eigvalsh(full) < 0).sum())
        assert negatives == work.negatives[k] + 3 == rod_equilibrium.factorise(full)[2]


def rocking(rod: Rod, distance: float, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """End frames that turn symmetrically from bowing up (angle > 0) to bowing down."""
    a = np.array([frame(0, 0, angle) for angle in angles])
    return a, np.array([frame(distance * rod.length, 0, -angle) for angle in angles])


def test_round_wire_between_rocking_ends_turns_over_as_soon_as_they_pass_level() -> None:
    """With level ends all planes through the ends are equivalent, so past level the shape must fall.

    The mirror image of the previous shape is the only stable one of its kind.
    """
    rod = wire()
    angles = np.linspace(0.31, -0.31, 32)
    a, b = rocking(rod, 0.9, angles)
    path = follow_rod(rod, a, b, DOWN, mount_rod(rod, a[0], b[0], DOWN))
    assert path.has_jumped.tolist() == [k == 16 for k in range(32)]
    assert path.is_stable.all()
    assert np.allclose(path.points[::-1] * [1, -1, 1], path.points, atol=1e-5 * LENGTH)
    assert path.jump_distance[16] > 0.3 * LENGTH and path.jump_distance[:16].max() == 0.0
    assert path.min_eigenvalue[15] < 0.02 < path.min_eigenvalue[0]


def first_singular_angle(distance: float, angles: FloatArray) -> float:
    """Return the angle at which the planar elastica between rocking ends loses stability.

    The Jacobian of its shooting map is singular there. The map takes (k0, Fx, Fy) at the start to (x, y,
    theta) at the end, integrated by scipy.
    """

    def shoot(p: FloatArray, angle: float) -> FloatArray:
        """Misses (3, m) of m starts (3, m)."""

        def rate(_: float, flat: FloatArray) -> FloatArray:
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

    def linear(p: FloatArray, angle: float) -> tuple[FloatArray, FloatArray]:
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


def start_guess(distance: float, angle: float) -> FloatArray:
    """A polyline close to the shape, from the mounted rod (only to start the reference's own iteration)."""
    rod = wire(10.0)
    a, b = rocking(rod, distance, np.array([angle]))
    points: FloatArray = (
        follow_rod(rod, a, b, DOWN, mount_rod(rod, a[0], b[0], DOWN, bow=1.0)).points[0, :, :2] / LENGTH
    )
    return points


def test_strip_between_rocking_ends_snaps_where_the_planar_elastica_ends() -> None:
    rod = wire(10.0)
    angles = np.linspace(-0.3, -0.8, 51)
    a, b = rocking(rod, 0.9, angles)
    path = follow_rod(rod, a, b, DOWN, mount_rod(rod, a[0], b[0], DOWN, bow=1.0))
    critical = first_singular_angle(0.9, np.arange(-0.57, -0.7, -0.01))
    jumps = np.flatnonzero(path.has_jumped)
    assert len(jumps) == 1
    assert angles[jumps[0]] - 0.001 <= critical <= angles[jumps[0] - 1] + 0.001
    assert np.abs(path.points[..., 2]).max() < 1e-6  # in its plane all the way
    assert path.is_stable.all()
    # behind the snap: the mirror image of the shape with the opposite angle
    last = angles[-1]
    c, d = rocking(rod, 0.9, -np.array([last]))
    twin = follow_rod(rod, c, d, DOWN, mount_rod(rod, c[0], d[0], DOWN))
    assert np.allclose(twin.points[0] * [1, -1, 1], path.points[-1], atol=1e-5 * LENGTH)


def test_round_wire_buckles_out_of_plane_where_a_strip_holds() -> None:
    """Two inflections: stable in the plane (the strip shows it), not out of it for a round wire."""
    angles = np.linspace(-0.05, -0.3, 11)
    for ratio, holds in ((10.0, True), (1.0, False)):
        rod = wire(ratio)
        a, b = rocking(rod, 0.8, angles)
        flat = mount_rod(wire(10.0), a[0], b[0], DOWN, bow=1.0)
        path = follow_rod(rod, a, b, DOWN, flat)
        signs = np.sign(path.curvature[0, :, 1])
        if holds:
            assert (np.diff(signs[2:-2]) != 0).sum() == 2
            assert path.is_stable.all() and not path.has_jumped.any()
            assert np.abs(path.points[..., 2]).max() < 1e-8
            assert path.min_eigenvalue.min() > 0.1
        else:
            assert path.has_jumped[0]  # the planar shape cannot even be mounted
            assert path.points[0, 32, 1] < 0.0  # it has turned over


def test_spin_of_both_ends_together_leaves_a_round_wire_alone_and_turns_no_twist_into_it() -> None:
    rod = wire()
    spins = np.linspace(0.0, 4.0 * math.pi, 60)
    a = np.array([frame(0, 0, 0.7, spin) for spin in spins])
    b = np.array([frame(0.55, 0.1, -0.9, spin) for spin in spins])
    path = follow_rod(rod, a, b, DOWN, mount_rod(rod, a[0], b[0], DOWN))
    assert not path.has_jumped.any() and path.is_stable.all()
    assert np.abs(path.points - path.points[0]).max() < 1e-9
    assert np.abs(path.twist).max() < 1e-6


def test_unequal_spin_twists_evenly() -> None:
    rod = Rod(LENGTH, 2e-3, 2e-3, 6e-3)  # torsionally stiff: holds the twist
    spins = np.linspace(0.0, 0.5, 12)
    a, b, _ = arc_frames(0.8)
    rotated = np.array([b @ frame(0, 0, 0, spin) for spin in spins])
    path = follow_rod(rod, np.repeat(a[None], 12, axis=0), rotated, DOWN, mount_rod(rod, a, b, DOWN))
    assert path.is_stable.all() and not path.has_jumped.any()
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
        around = rod_energy.quaternion_exp(np.outer([0, 0, 1.0], 2 * math.pi * middle))
        about = rod_energy.quaternion_exp(np.outer([1.0, 0, 0], twist * middle))
        q = rod_energy.quaternion_product(around, about)[..., None]
        turn = rod_energy.quaternion_exp(np.array([twist, 0.0, 0.0]))[:, None]
        ends = rod_energy.RodEnds(np.zeros((3, 1)), turn, np.zeros((3, 1)))
        stiffness = np.array([torsion, 1.0, 1.0])
        # the ring stands because of a force along its axis' direction: found by least squares of the gradient
        state = rod_equilibrium.RodState(q, np.zeros((3, 1)))
        state = rod_equilibrium.solve_newton(stiffness, state, ends, rounds=30).state
        full = rod_equilibrium.saddle_matrix(
            rod_energy.rod_derivatives(stiffness, state.attitudes, state.force, ends)
        )
        basis = np.linalg.qr(full[3 * n :, : 3 * n].T, mode="complete")[0][:, 3:]
        lowest = np.linalg.eigvalsh(basis.T @ full[: 3 * n, : 3 * n] @ basis)[:3] * n
        values.append(lowest)
    before, after = values
    # one eigenvalue is 0 always: a round ring rolls freely about its own line
    assert abs(before).min() < 1e-3 and abs(after).min() < 1e-3
    assert (before < -1e-3).sum() == 0
    assert (after < -1e-3).sum() >= 1
