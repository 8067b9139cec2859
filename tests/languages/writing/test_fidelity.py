"""Posted targets select the planned solution and read back as planned, for every robot of the catalogue."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.robots import robot
from tests.languages.writing import fidelity
from tests.robot_sample import SAMPLE


@pytest.mark.parametrize("name", SAMPLE)
def test_random_targets_of_every_robot(name):
    got = fidelity.measure(name, 2000)
    # how a controller counts cfx of a parallel-rod arm is not settled; by the rule of serial arms it holds
    assert got.selected == 1.0
    assert got.position <= 0.001
    assert got.angle <= 0.0001


@pytest.mark.parametrize("name", ["irb140", "kr60_ha"])
def test_a_range_of_more_turns_than_the_bits_can_tell_is_found_out(name):
    """The measurement itself: within limits of two turns more, signs of other turns fit as well."""
    arm = robot(name)
    q = fidelity.sample(arm, 300)
    assert fidelity.selects(arm, q).all()
    wide = dataclasses.replace(arm, lower=arm.lower - 4 * np.pi, upper=arm.upper + 4 * np.pi)
    assert not fidelity.selects(wide, q).all()
