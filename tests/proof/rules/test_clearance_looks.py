"""Data that another process receives to measure distances of a long motion."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from planner import pipeline
from planner.proof.context import Context
from planner.proof.rules.clearance import ClearanceQueries
from tests import small_problem


def test_another_process_gets_the_joints_that_are_looked_at_alone() -> None:
    joints = np.random.default_rng(5).uniform(-1.0, 1.0, (1000, 6))
    looks = ClearanceQueries(1, np.array([3, 40, 999]), frozenset(), {"left": joints}, itself=True)
    content = pickle.dumps(looks)
    sent = pickle.loads(content)
    assert len(content) < joints.nbytes / 10
    assert (sent.index, sent.rows.tolist(), sent.itself) == (1, [3, 40, 999], True)
    for own in (looks, sent, pickle.loads(pickle.dumps(sent))):
        np.testing.assert_array_equal(own.q["left"], joints[[3, 40, 999]])


def test_another_process_gets_no_cached_values(tmp_path: Path) -> None:
    context = Context(pipeline.load(small_problem.write(tmp_path)), {}, {})
    context.cache["models"] = [lambda: None]  # cannot be pickled, like the models of a cell
    sent = pickle.loads(pickle.dumps(context))
    assert sent.cache == {} and sent.programs == {}
