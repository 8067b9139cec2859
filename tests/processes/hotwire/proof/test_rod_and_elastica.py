"""The two independent methods for the wire shape agree: closed form and discrete rod."""

from __future__ import annotations

import numpy as np
import pytest

from planner.processes.hotwire.plan.elastica.clamped import round_section, strip_section
from planner.processes.hotwire.proof import rod_equilibrium
from planner.processes.hotwire.proof.rod import Rod, RodShape, follow_rod
from planner.processes.hotwire.proof.rod_energy import RodEnds, quaternion_exp
from tests.processes.hotwire.plan.elastica import weightless

DOWN = np.array([0.0, 0.0, -1.0])
LENGTH = 0.7
NU = 0.3


def random_ends(count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    start = np.zeros((count, 3))
    start[:, 2] = rng.uniform(-0.8, 0.8, count)
    end = np.stack(
        [
            rng.uniform(0.72, 0.95, count) * LENGTH,
            rng.uniform(-0.1, 0.1, count) * LENGTH,
            rng.uniform(-0.8, 0.8, count),
        ],
        axis=1,
    )
    return start, end


def frames(pose: np.ndarray) -> np.ndarray:
    x, y, theta = pose
    found = np.eye(4)
    found[:2, :2] = [[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]]
    found[:2, 3] = x, y
    return found


@pytest.mark.parametrize("flat", [True, False])
def test_shapes_and_verdicts_agree(flat: bool) -> None:
    start, end = random_ends(40)
    shape = weightless.solve(LENGTH, start, end, strict=False)
    section = strip_section(10.0, NU) if flat else round_section(NU)
    rod = Rod(LENGTH, 2e-3, 2e-3 * section.stiff_bending, 2e-3 * section.torsion)
    n = rod.segments
    theta = np.asarray(shape.theta(2 * n + 1))[:, 1::2]
    points = np.asarray(shape.points(n + 1))
    stable = np.asarray(shape.stable_in_plane & shape.stable_out_of_plane(section))
    seen = set()
    for k in range(len(start)):
        if not np.isfinite(points[k]).all() or (
            not flat and abs(shape.margin_out_of_plane(section)[k]) < 0.02
        ):
            continue
        turn = np.zeros((3, n))
        turn[2] = theta[k] - start[k, 2]
        state = RodShape(quaternion_exp(turn), np.zeros(3))
        a, b = frames(start[k]), frames(end[k])
        # the same planar equilibrium in the rod, whether stable or not
        place = (a[:3, :3].T @ (b[:3, 3] - a[:3, 3]))[:, None] / LENGTH
        last = quaternion_exp(np.array([[0.0], [0.0], [end[k, 2] - start[k, 2]]]))
        ends = RodEnds(place, last, np.zeros((3, 1)))
        outcome = rod_equilibrium.solve_newton(
            rod.stiffness, rod_equilibrium.RodState(state.attitudes[..., None], np.zeros((3, 1))), ends
        )
        assert outcome.converged[0]
        assert (outcome.excess_negatives[0] == 0) == stable[k], k
        seen.add(bool(stable[k]))
        if stable[k]:
            path = follow_rod(
                rod,
                a[None],
                b[None],
                DOWN,
                RodShape(outcome.state.attitudes[..., 0], outcome.state.force[:, 0]),
            )
            assert path.is_stable[0]
            assert np.abs(path.points[0, :, :2] - points[k]).max() < 5e-6 * LENGTH
    assert seen == ({True} if flat else {True, False})
