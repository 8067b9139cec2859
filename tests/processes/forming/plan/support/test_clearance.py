"""Clearance of heads in the clamp of a sheet, against sampled points of the heads."""

from __future__ import annotations

import numpy as np
import pytest

from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath
from planner.processes.forming.plan.support.clearance import ClampBars, clamp_issues
from planner.tooling import FormingHead, head_outline

REACH, BARS = 0.1, ((0.001, 0.011), (-0.06, 0.0))
HEAD = FormingHead("ball", 0.006, 0.02, 0.05, 0.15)


def clamp() -> ClampBars:
    """Four bars above a sheet and four below, around an opening of 200 mm."""
    turn = np.arange(4) * 0.5 * np.pi
    outward = np.tile(np.column_stack([np.cos(turn), np.sin(turn)]), (2, 1))
    low, high = np.repeat(np.array(BARS), 4, axis=0).T
    return ClampBars(outward, np.full(8, REACH), low, high)


def path(centre: np.ndarray, axis: np.ndarray) -> FormingToolPath:
    one = np.zeros(len(centre))
    contact = ContactPath(centre, -axis, centre, one, one.astype(np.int64), one == 0.0)
    return FormingToolPath(centre, axis, None, None, np.full(len(centre), np.nan), contact)


def surface(centre: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Points (M, 3) on the ball and on the shafts of a head."""
    back = np.concatenate([np.linspace(0.0, 0.05, 101), np.linspace(0.05, 0.15, 201)])
    radius = np.concatenate([np.full(101, 0.006), np.full(201, 0.02)])
    one = np.cross(axis, [1.0, 0.0, 0.0])
    one /= np.linalg.norm(one)
    turn = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    ring = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * np.cross(axis, one)
    shafts = (centre - back[:, None] * axis)[:, None] + radius[:, None, None] * ring
    ball = np.random.default_rng(1).normal(size=(3000, 3))
    ball *= 0.006 / np.linalg.norm(ball, axis=1, keepdims=True)
    return np.concatenate([shafts.reshape(-1, 3), centre + ball])


def inside(points: np.ndarray, room: float) -> bool:
    out = np.abs(points[:, :2]).max(axis=1) > REACH - room
    high = [(points[:, 2] > low - room) & (points[:, 2] < high + room) for low, high in BARS]
    return bool((out & (high[0] | high[1])).any())


@pytest.mark.parametrize("above", [True, False])
def test_heads_in_the_clamp_are_told_and_no_others(above: bool) -> None:
    rng = np.random.default_rng(5)
    one = FormingPass(
        "f1", 1, 1, 1, np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros(0), 0, 0, np.zeros((0, 2))
    )
    told = 0
    for trial in range(150):
        flat = rng.uniform(-0.09, 0.09, 2)
        place = np.array([[*flat, rng.uniform(-0.05, 0.02)]])
        axis = np.array([[*rng.uniform(-1.0, 1.0, 2), -1.0 if above else 1.0]])
        axis /= np.linalg.norm(axis)
        issues = clamp_issues(one, path(place, axis), clamp(), ("A",), (head_outline(HEAD),))
        points = surface(place[0], axis[0])
        if inside(points, -1e-3):
            assert [issue.code for issue in issues] == ["forming.clamp"], trial
            told += 1
        elif not inside(points, 1e-3):
            assert issues == (), trial
    assert 20 < told < 130
