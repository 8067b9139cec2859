"""No curve of the family leaves the bound, and the bound is near the worst of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner.verify.krl import spline_curve
from tests.verify.krl import spline_members as members


def block(rng, count, kind):
    """Poses (N + 1, 4, 4) and times (N,) of a block: smooth, with a kink, or anyhow."""
    pose = np.tile(np.eye(4), (count + 1, 1, 1))
    if kind == "anyhow":
        place = np.cumsum(rng.normal(0.0, 2e-3, (count + 1, 3)), axis=0)
        turn = np.cumsum(rng.normal(0.0, 0.02, (count + 1, 3)), axis=0)
    else:
        step = 2e-3 * (1.0 + 0.5 * rng.random(count + 1))
        along = np.cumsum(step)
        radius = 0.05 if kind == "arc" else 1e3
        place = radius * np.stack([np.sin(along / radius), 1.0 - np.cos(along / radius), 0 * along], axis=1)
        turn = np.outer(along, rng.normal(0.0, 3.0, 3))
        if kind == "kink":
            half = count // 2
            place[half + 1 :, 1] += along[half + 1 :] - along[half]
    pose[:, :3, 3] = place
    pose[:, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
    times = np.linalg.norm(np.diff(place, axis=0), axis=1) / 0.03 * rng.uniform(0.8, 1.5, count)
    return pose, times


@pytest.mark.parametrize("kind", ["arc", "kink", "anyhow"])
def test_no_member_of_the_family_leaves_the_bound(kind):
    rng = np.random.default_rng(7)
    reached = np.zeros(3)
    for _ in range(8):
        count = int(rng.integers(1, 9))
        pose, times = block(rng, count, kind)
        found = spline_curve.bounds(pose, times)
        for _ in range(40):
            i = int(rng.integers(count))
            law = str(rng.choice(members.RULES))
            shape = str(rng.choice(members.KINDS, p=[0.2, 0.4, 0.08, 0.08, 0.08, 0.08, 0.08]))
            curve, _ = members.member(i, pose, times, law, shape, rng)
            apart, change, speed = members.off(curve, members.rows(pose, i)[0], i)
            if law != "time":
                assert apart <= found.off[i] + 1e-12, (law, shape, i)
                reached[0] = max(reached[0], apart / found.off[i])
            else:
                assert change <= found.change[i] * times[i] + 1e-12, (shape, i)
                assert speed <= found.speed[i] * times[i] + 1e-12, (shape, i)
                rates = np.array([found.change[i], found.speed[i]]) * times[i]
                reached[1:] = np.maximum(reached[1:], [change, speed] / rates)
    assert (reached > 0.6).all(), reached  # the bound is not far from the worst of them
