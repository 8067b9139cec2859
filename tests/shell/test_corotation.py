"""Forces of displaced sheets: none in rigid rotations, and a tangent that is their derivative."""

from __future__ import annotations

import numpy as np
import pytest

from planner.geometry.arrays import exp_rotation
from planner.shell.corotation import Assembly, State, TooFarError, at_rest
from planner.shell.element import Membrane
from planner.shell.newton import Loading, clamped, column_weights
from tests.shell.sheets import cone, down, patch


@pytest.mark.parametrize("membrane", ["optimal", "constant strain"])
def test_rigid_turns_give_no_force(membrane: Membrane) -> None:
    sheet, _ = cone(0.05, 1500, membrane)
    count = len(sheet.nodes)
    assembly = Assembly(sheet, np.ones((count, 6), dtype=bool), np.zeros((count, 3)))
    axis = np.array([0.48, 0.6, 0.64])
    turn = exp_rotation(np.radians(30.0) * axis)
    u = sheet.nodes @ turn.T + [0.3, -0.1, 0.2] - sheet.nodes
    result = assembly.force(State(u, np.broadcast_to(turn, (count, 3, 3))))
    assert np.abs(result).max() < 1e-6


@pytest.mark.parametrize("membrane", ["optimal", "constant strain"])
def test_the_tangent_is_the_derivative_of_the_forces(membrane: Membrane) -> None:
    """Far from balance its symmetric half is compared: turns 0.05 rad beside one another."""
    sheet, _ = patch(membrane)
    count = len(sheet.nodes)
    spring = np.full((count, 3), 2e5)
    assembly = Assembly(sheet, np.ones((count, 6), dtype=bool), spring)
    rng = np.random.default_rng(5)
    state = at_rest(sheet).moved(rng.normal(size=(count, 6)) * ([2e-5] * 3 + [0.05] * 3))
    force, tangent = assembly.tangent(state)
    assert np.allclose(force, assembly.force(state), rtol=1e-12, atol=1e-9)
    slope = np.zeros((6 * count, 6 * count))
    for freedom in range(6 * count):
        step = np.zeros(6 * count)
        step[freedom] = 1e-7
        ahead = assembly.force(state.moved(step.reshape(-1, 6)))
        behind = assembly.force(state.moved(-step.reshape(-1, 6)))
        slope[:, freedom] = (ahead - behind).reshape(-1) / 2e-7
    slope = 0.5 * (slope + slope.T)
    scale = np.sqrt(np.abs(np.diag(slope)))
    deviation = np.abs(slope - tangent.toarray()) / (scale[:, None] * scale)
    assert deviation.max() < 1e-6


def test_in_balance_the_tangent_is_the_derivative_along_any_step() -> None:
    """At 100 N on a cone, where it is symmetric by itself: along random steps within 1e-3."""
    sheet, place = cone(0.05, 800)
    loading = Loading(sheet, clamped(sheet, "sliding"))
    state = loading.states(column_weights(sheet, place, 3e-3), down(100.0))[-1]
    assembly, free = loading.assembly, loading.assembly.free
    _, tangent = assembly.tangent(state)
    rng = np.random.default_rng(2)
    for _ in range(5):
        step = np.zeros(6 * len(sheet.nodes))
        step[free] = rng.normal(size=len(free)) * np.tile([1e-8] * 3 + [1e-6] * 3, len(sheet.nodes))[free]
        ahead = assembly.force(state.moved(step.reshape(-1, 6))).reshape(-1)[free]
        behind = assembly.force(state.moved(-step.reshape(-1, 6))).reshape(-1)[free]
        slope, told = 0.5 * (ahead - behind), tangent @ step[free]
        assert np.linalg.norm(slope - told) < 1e-3 * np.linalg.norm(slope)


def test_a_corner_that_turns_over_is_refused() -> None:
    sheet, _ = patch("optimal")
    count = len(sheet.nodes)
    assembly = Assembly(sheet, np.ones((count, 6), dtype=bool), np.zeros((count, 3)))
    step = np.zeros((count, 6))
    step[3, 3:] = [1.5, 0.0, 0.0]
    with pytest.raises(TooFarError):
        assembly.force(at_rest(sheet).moved(step))
