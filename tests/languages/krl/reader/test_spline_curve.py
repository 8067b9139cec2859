"""No curve of the family exceeds the bound, and the worst of them comes close to it."""

from __future__ import annotations

import numpy as np
import pytest

from planner.languages.krl.reader import spline_curve
from tests.languages.krl.reader import spline_members as members
from tests.languages.krl.reader.spline_members import block


@pytest.mark.parametrize("kind", ["arc", "kink", "anyhow"])
def test_no_member_of_the_family_leaves_the_bound(kind):
    rng = np.random.default_rng(7)
    reached = np.zeros(3)
    for _ in range(8):
        count = int(rng.integers(1, 9))
        pose, times = block(rng, count, kind)
        found = spline_curve.bound_curves(pose, times)
        for _ in range(40):
            i = int(rng.integers(count))
            law = str(rng.choice(members.RULES))
            shape = str(rng.choice(members.KINDS, p=[0.2, 0.4, 0.08, 0.08, 0.08, 0.08, 0.08]))
            curve, _ = members.member(i, pose, times, law, shape, rng)
            apart, change, speed = members.max_deviation(curve, members.rows(pose, i)[0], i)
            if law != "time":
                assert apart <= found.deviation[i] + 1e-12, (law, shape, i)
                reached[0] = max(reached[0], apart / found.deviation[i])
            else:
                assert change <= found.speed_change[i] * times[i] + 1e-12, (shape, i)
                assert speed <= found.speed[i] * times[i] + 1e-12, (shape, i)
                rates = np.array([found.speed_change[i], found.speed[i]]) * times[i]
                reached[1:] = np.maximum(reached[1:], [change, speed] / rates)
    assert (reached > 0.6).all(), reached  # the bound is not far from the worst of them
