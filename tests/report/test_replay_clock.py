"""The replay's bar knows the programs' clock."""

from __future__ import annotations

import numpy as np
import pytest

from planner.report import replay_bar
from planner.report.track import Track


def run(time: list[float], segment: list[str]) -> Track:
    count = len(time)
    return Track(
        time=np.array(time),
        q={"left": np.zeros((count, 6))},
        segment=tuple(segment),
        setup=np.zeros(count, dtype=np.int64),
        block=np.tile(np.eye(4), (count, 1, 1)),
        wire=None,
        shown=np.zeros(count, dtype=bool),
        wire_radius=0.0,
        stops=(),
        sweeps=(),
    )


def test_times_of_the_programs_lead_to_the_same_place_in_the_replay() -> None:
    shown = run([0, 4, 5, 7, 9], ["entry", "entry", "approach", "cut", "exit"])
    time = np.array([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 4.5])
    labels = ["home", "home", "approach", "approach", "cut", "cut", "home"]
    pairs = np.array(replay_bar.clock(shown, time, labels))
    at = np.interp([1.0, 1.5, 2.0, 3.0, 4.0], *pairs.T)
    np.testing.assert_allclose(at, [4.0, 4.5, 5.0, 6.0, 7.0])


def test_segments_that_the_programs_repeat_are_taken_in_order() -> None:
    shown = run([0, 1, 2, 3], ["cut", "cut", "link", "cut"])
    time = np.array([0.0, 2.0, 3.0, 5.0])
    pairs = replay_bar.clock(shown, time, ["cut", "cut", "link", "cut"])
    assert pairs == pytest.approx(((0.0, 0.0), (2.0, 1.0), (2.0, 1.0), (3.0, 2.0), (3.0, 2.0), (5.0, 3.0)))


def test_without_a_proof_there_is_no_clock() -> None:
    assert '"clock":[]' in replay_bar.bar("name", run([0, 1], ["cut", "cut"]))
