"""Speed bounds of driven tools are valid and tight.

The distance that an arm needs to accelerate is tested too.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from planner.catalogue.robots import robot
from planner.geometry.arrays import from_rpy, inverse
from planner.languages.trajectories.writer.start_times import settling_time
from planner.languages.trajectories.writer.straight_segments import TrajectoryArm
from planner.proof.kinematics.arm_model import robot_machine
from planner.proof.replay import trajectory_speed
from planner.proof.replay.moves import hermite

TOOL = from_rpy([0.1, 0.05, 0.3], [0.3, -0.2, 1.0])
GRIP = from_rpy([0.0, 0.02, 0.1], [0.0, 0.4, 0.0])
BASES = np.eye(4), from_rpy([1.4, 0.2, 0.1], [0.0, 0.0, 3.0])
COUNT = 12


def ends(seed, joints):
    """Cubics near postures ``joints`` (D,): slow, fast and wild ones."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-2.0, 0.0, (COUNT, 1))
    q = joints + rng.uniform(-0.4, 0.4, (COUNT, len(joints)))
    span = rng.uniform(0.05, 2.0, COUNT)
    q_end = q + size * span[:, None] * rng.normal(size=q.shape)
    return (q, q_end, *(size * rng.normal(size=q.shape) for _ in range(2))), span


def true_peaks(position_of, spline_ends, span):
    fraction = np.linspace(0.0, 1.0, 8001)[:, None]
    a, b, va, vb = (one[:, None] for one in spline_ends)
    place = position_of(hermite(a, b, va, vb, span[:, None, None], fraction))
    return np.linalg.norm(np.diff(place, axis=1), axis=2).max(axis=1) * 8000 / span


@pytest.mark.parametrize("name", ["irb140", "crx10ia_l", "kr60_ha"])
def test_no_tool_is_faster_than_its_bound_and_the_bound_is_near(name):
    machine = robot_machine(robot(name))
    some, span = ends(1, machine.data.home)
    bound = trajectory_speed.peak_speeds(trajectory_speed.tool_in_base(machine, TOOL), some, span)
    true = true_peaks(lambda q: (machine.flange(q) @ TOOL)[..., :3, 3], some, span)
    assert (bound >= true * (1.0 - 1e-9)).all()
    assert (bound <= 1.01 * true + 2e-4).all()


def test_nor_one_that_is_seen_from_an_arm_that_moves():
    one, other = robot_machine(robot("irb140")), robot_machine(robot("crx10ia_l"))
    seen = trajectory_speed.tool_in_holder((one, TOOL, BASES[0]), (other, GRIP, BASES[1]))
    some, span = ends(2, np.concatenate([other.data.home[::-1], one.data.home]))

    def position_of(q):
        held = BASES[1] @ other.flange(q[..., 5::-1]) @ GRIP
        return (inverse(held) @ BASES[0] @ one.flange(q[..., 6:]) @ TOOL)[..., :3, 3]

    true = true_peaks(position_of, some, span)
    bound = trajectory_speed.peak_speeds(seen, some, span)
    assert (bound >= true * (1.0 - 1e-9)).all()
    assert (bound <= 1.02 * true + 1e-3).all()


@pytest.mark.parametrize("within", [0.002, 0.007, 0.07])
def test_an_arm_that_is_off_comes_to_its_start_within_its_limits(within):
    """Of all corners of what is allowed off; the time is the writer's, the limits are looked at densely."""
    data, speed = robot("irb140"), 0.25
    machine, home = robot_machine(data), np.asarray(data.home)
    took = settling_time([TrajectoryArm(data, np.eye(4), TOOL, slice(0, 6))], home, within, speed)
    assert trajectory_speed.settling_fraction(machine, TOOL, home, within, took, speed) <= 1.0
    assert trajectory_speed.settling_fraction(machine, TOOL, home, within, 0.8 * took, speed) > 0.7
    off = within * np.array(list(itertools.product((-1.0, 1.0), repeat=6)))
    fraction = np.linspace(0.0, 1.0, 401)[:, None, None]
    still = np.zeros_like(off)
    q = hermite(home + off, np.broadcast_to(home, off.shape), still, still, np.full((1, 1), took), fraction)
    place = (machine.flange(q) @ TOOL)[..., :3, 3]
    step = took / 400
    assert np.linalg.norm(np.diff(place, axis=0), axis=2).max() / step <= speed
    assert (np.abs(np.diff(q, axis=0)).max(axis=(0, 1)) / step <= data.velocity).all()
    assert (np.abs(np.diff(q, 2, axis=0)).max(axis=(0, 1)) / step**2 <= data.acceleration * 1.001).all()
