"""The rule that compares a tool with a path of tips and axes, on paths computed by hand.

Motion that follows the path passes, all other motion fails.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.processes.milling.claims import MillsAlong
from planner.processes.milling.proof.path_following import PathDeviation, match_path

UP = np.array([0.0, 0.0, 1.0])
TOLERANCE, TURN = 1e-4, np.deg2rad(0.5)


def leaning(angle: float) -> FloatArray:
    """An axis that leans from z to x [rad]."""
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


PATHS = {
    "straight": [([0, 0, 0], UP), ([100, 0, 0], UP)],
    "corner": [([0, 0, 0], UP), ([30, 0, 0], UP), ([30, 20, 0], UP)],
    "out and back": [([0, 0, 0], UP), ([40, 0, 0], UP), ([0, 0, 0], UP), ([0, 5, 0], UP)],
    "pecks": [([0, 0, z], UP) for z in (0, -3, 0, -6, 0, -9, 0)],
    "twice around": [([x, y, 0], UP) for _ in range(2) for x, y in ((0, 0), (9, 0), (9, 9), (0, 9))],
    "turn in place": [
        ([0, 0, 0], UP),
        ([10, 0, 0], UP),
        ([10, 0, 0], leaning(0.5)),
        ([0, 0, 0], leaning(0.5)),
    ],
    "leaning on the way": [([0, 0, 0], leaning(-0.3)), ([50, 0, 0], leaning(0.3))],
    "crossing": [([0, 0, 0], UP), ([20, 20, 0], UP), ([20, 0, 0], UP), ([0, 20, 0], UP)],
    "dense": [([10 * np.cos(t), 10 * np.sin(t), 0], UP) for t in np.linspace(0, 12, 900)],
}


def claim(path: list[tuple[list[float], FloatArray]]) -> MillsAlong:
    tip = np.array([place for place, _ in path], dtype=np.float64) * 1e-3
    axis = np.array([axis for _, axis in path])
    return MillsAlong(Segment.read("mill/a"), "robot", tip, axis, np.full(len(tip), 0.02), TOLERANCE, TURN)


def replay(claimed: MillsAlong, step: float = 0.4e-3) -> tuple[FloatArray, FloatArray]:
    """Sample the path. Tip and axis (by SciPy's rotations) move uniformly from point to point."""
    tips, axes = [claimed.tip[:1]], [claimed.axis[:1]]
    for i in range(len(claimed.tip) - 1):
        length = np.linalg.norm(claimed.tip[i + 1] - claimed.tip[i]) + 0.05 * np.linalg.norm(
            claimed.axis[i + 1] - claimed.axis[i]
        )
        fraction = np.append(
            np.arange(0.3, max(length / step, 0.4))[:, None] * step / max(length, 1e-9), [[1.0]], 0
        )
        fraction = fraction[fraction[:, 0] <= 1.0]
        tips.append(claimed.tip[i] + fraction * (claimed.tip[i + 1] - claimed.tip[i]))
        turn = Rotation.align_vectors(claimed.axis[i + 1], claimed.axis[i])[0].as_rotvec()
        axes.append(Rotation.from_rotvec(fraction * turn).apply(claimed.axis[i]))
    return np.concatenate(tips), np.concatenate(axes)


def holds(followed: PathDeviation) -> bool:
    return bool(
        (followed.distance <= TOLERANCE).all()
        and (followed.angle <= TURN).all()
        and followed.missed_count == 0
    )


@pytest.mark.parametrize("name", PATHS)
def test_a_tool_on_its_way_follows_it_exactly(name: str) -> None:
    own = claim(PATHS[name])
    found = match_path(own, *replay(own))
    assert holds(found)
    assert found.distance.max() < 1e-9
    assert found.angle.max() < 1e-6


@pytest.mark.parametrize("name", PATHS)
def test_a_tool_within_the_tolerances_holds(name: str) -> None:
    own = claim(PATHS[name])
    tip, axis = replay(own)
    assert holds(match_path(own, tip + np.array([0.0, 0.0, 0.6 * TOLERANCE]), axis))


def shifted(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    out = tip.copy()
    out[len(tip) // 2, 1:] += 3.0 * TOLERANCE
    return out, axis


def tilted(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    out = axis.copy()
    out[len(tip) // 2] += [0.0, 3.0 * TURN, 0.0]
    return tip, out / np.linalg.norm(out, axis=1, keepdims=True)


def cut_short(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    return tip[:-4], axis[:-4]


def late(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    return tip[20:], axis[20:]


def backwards(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    return tip[::-1], axis[::-1]


def twice(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A stretch in the middle is gone back and over once more."""
    rows = np.r_[
        0 : len(tip) * 3 // 5, len(tip) * 3 // 5 : len(tip) * 2 // 5 : -1, len(tip) * 2 // 5 : len(tip)
    ]
    return tip[rows], axis[rows]


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("wrong", [shifted, tilted, cut_short, late, backwards, twice])
def test_whatever_else_a_tool_does_is_found(name: str, wrong: object) -> None:
    own = claim(PATHS[name])
    assert callable(wrong)
    assert not holds(match_path(own, *wrong(*replay(own))))


def test_a_corner_that_is_cut_is_missed() -> None:
    own = claim(PATHS["corner"])
    tip, axis = replay(own)
    keep = np.linalg.norm(tip - own.tip[1], axis=1) > 2e-3
    assert not holds(match_path(own, tip[keep], axis[keep]))


def test_a_turn_in_place_that_is_left_out_is_missed() -> None:
    own = claim(PATHS["turn in place"])
    tip, axis = replay(own)
    keep = (np.linalg.norm(tip - own.tip[1], axis=1) > 1e-6) & (axis[:, 0] < 1e-6)
    assert not holds(match_path(own, tip[keep], axis[keep]))


def test_one_time_around_of_two_is_not_enough() -> None:
    own = claim(PATHS["twice around"])
    tip, axis = replay(own)
    half = len(tip) // 2
    assert not holds(match_path(own, tip[half:], axis[half:]))


@pytest.mark.parametrize("step", [8e-5, 2.4e-4, 4e-4, 1.2e-3])
@pytest.mark.parametrize("back", [0.3, 0.5, 1.0])
def test_a_step_back_that_is_left_out_is_missed_however_far_samples_are_apart(
    back: float, step: float
) -> None:
    """Every place lies on the straight way, but in another order; 0.28 mm are within both tolerances."""
    own = claim([([0, 0, 0], UP), ([10, 0, 0], UP), ([10 - back, 0, 0], UP), ([20, 0, 0], UP)])
    straight = claim([([0, 0, 0], UP), ([20, 0, 0], UP)])
    for shift in np.linspace(0.0, 0.9, 7):
        tip, axis = replay(straight, step)
        tip = np.concatenate([tip[:1], tip[1:-1] + np.array([shift * step, 0.0, 0.0]), tip[-1:]])
        assert not holds(match_path(own, tip, axis))
    assert holds(match_path(own, *replay(own, step)))
