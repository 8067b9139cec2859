"""What another process is sent of a long motion, to measure distances in it."""

from __future__ import annotations

import pickle

import numpy as np

from planner.proof.rules.clearance import Looks


def test_another_process_gets_the_joints_that_are_looked_at_alone() -> None:
    joints = np.random.default_rng(5).uniform(-1.0, 1.0, (1000, 6))
    looks = Looks(1, np.array([3, 40, 999]), frozenset(), {"left": joints}, itself=True)
    content = pickle.dumps(looks)
    sent = pickle.loads(content)
    assert len(content) < joints.nbytes / 10
    assert (sent.index, sent.rows.tolist(), sent.itself) == (1, [3, 40, 999], True)
    for own in (looks, sent, pickle.loads(pickle.dumps(sent))):
        np.testing.assert_array_equal(own.q["left"], joints[[3, 40, 999]])
