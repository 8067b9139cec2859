"""Status and Turn: they select exactly the given random joints of KUKA arms."""

import numpy as np
import pytest

from planner.catalogue import robots
from planner.cell.kinematics import forward_kinematics, link_frames
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.inverse_kinematics import (
    NEAR_ZERO_ANGLE_RAD,
    select_by_status,
    singularity_distance,
    status_of,
    straight_elbow,
)
from tests.robot_sample import KUKAS


def turn_of(q):
    return sum(1 << axis for axis in range(6) if q[axis] < 0.0)


def samples(machine, count, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(machine.data.lower, machine.data.upper, (count, 6))
    return q[singularity_distance(machine, q) > np.deg2rad(1.0)]


@pytest.mark.parametrize("name", KUKAS)
def test_they_select_the_joints_that_they_were_made_from(name):
    machine = arm_model.robot_machine(robots.robot(name))
    for q in samples(machine, 300, 7):
        found = select_by_status(
            machine, forward_kinematics(machine.data, q), int(status_of(machine, q)), turn_of(q)
        )
        assert len(found.q) == 1
        assert np.abs(found.q[0] - q).max() < 1e-9
        assert found.near_zero == tuple(np.flatnonzero(np.abs(q) < NEAR_ZERO_ANGLE_RAD) + 1)


@pytest.mark.parametrize("name", KUKAS)
def test_bits_are_what_the_manual_draws(name):
    """Bit 0 by the wrist's centre in the frame of axis 1, bit 1 by the side of the straight arm on which it
    is bent, both from the links' frames, and bit 2 by the sign of axis 5."""
    machine = arm_model.robot_machine(robots.robot(name))
    q = samples(machine, 500, 8)
    frames = link_frames(machine.data, q)
    wrist = frames[:, 4, :3, 3]
    x = np.einsum("ni,ni->n", frames[:, 0, :3, 0], wrist - frames[:, 0, :3, 3])
    upper, fore = frames[:, 2, :3, 3] - frames[:, 1, :3, 3], wrist - frames[:, 2, :3, 3]
    bend = np.einsum("ni,ni->n", np.cross(upper, fore), frames[:, 2, :3, 1])
    expected = (x < 0.0) + 2 * (bend > 0.0) + 4 * (q[:, 4] < 0.0)
    assert (status_of(machine, q) == expected).all()
    stretched = np.zeros(6)
    stretched[2] = straight_elbow(machine)
    frames = link_frames(machine.data, stretched)
    arm = [frames[i, :3, 3] for i in (1, 2, 4)]
    assert np.linalg.norm(np.cross(arm[1] - arm[0], arm[2] - arm[1])) < 1e-12


@pytest.mark.parametrize("name", KUKAS)
def test_other_bits_select_no_joints_or_others(name):
    machine = arm_model.robot_machine(robots.robot(name))
    for q in samples(machine, 40, 9):
        if np.abs(q).min() < NEAR_ZERO_ANGLE_RAD:
            continue
        status, turn = int(status_of(machine, q)), turn_of(q)
        flange = forward_kinematics(machine.data, q)
        changed = [(status ^ (1 << bit), turn) for bit in range(3)]
        changed += [(status, turn ^ (1 << bit)) for bit in range(6)]
        for some in changed:
            found = select_by_status(machine, flange, *some)
            assert all(np.abs(other - q).max() > np.deg2rad(1.0) for other in found.q)
