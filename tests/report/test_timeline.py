"""The time bar of the replay follows the clock of the programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planner import pipeline
from planner.claims.segments import Segment
from planner.report import scene, time_bar
from planner.report.scene import Keyframes
from tests import small_problem


def run(time: list[float], segment: list[str]) -> Keyframes:
    count = len(time)
    return Keyframes(
        time=np.array(time),
        q={"left": np.zeros((count, 6))},
        segment=tuple(map(Segment.read, segment)),
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
    pairs = np.array(time_bar.replay_clock(shown, time, labels))
    at = np.interp([0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 4.5], *pairs.T)
    np.testing.assert_allclose(at, [0.0, 4.0, 4.5, 5.0, 6.0, 7.0, 9.0])


def test_segments_that_the_programs_repeat_are_taken_in_order() -> None:
    shown = run([0, 1, 2, 3], ["cut", "cut", "link", "cut"])
    time = np.array([0.0, 2.0, 3.0, 5.0])
    pairs = time_bar.replay_clock(shown, time, ["cut", "cut", "link", "cut"])
    expected = [[0, 0], [0, 0], [2, 1], [2, 1], [3, 2], [3, 2], [5, 3], [5, 3]]
    np.testing.assert_allclose(pairs, expected)


def test_the_arm_stands_in_the_replay_as_the_programs_have_it(tmp_path: Path) -> None:
    """Joint angles that the proof read out of the programs, against those of the replay."""
    outcome = pipeline.plan(pipeline.load(small_problem.write(tmp_path)))
    series = outcome.proof.series
    shown = scene.sample_keyframes(outcome.problem, outcome.plan, 600)
    labels = [str(label) for label in series["label"]]
    at = np.flatnonzero(np.array(labels) == "cut/path")[5:-5]
    pairs = np.array(time_bar.replay_clock(shown, np.asarray(series["time"]), labels))
    led = np.interp(series["time"][at], *pairs.T)
    for joint in range(6):
        got = np.interp(led, shown.time - shown.time[0], shown.q["left"][:, joint])
        np.testing.assert_allclose(
            got, series["joints/left"][at, joint], atol=np.radians(0.5)
        )  # rounded corners


def test_without_a_proof_there_is_no_clock() -> None:
    assert '"clock":[]' in time_bar.time_bar("name", run([0, 1], ["cut", "cut"]))


def test_the_bar_says_what_its_time_consists_of() -> None:
    shown = run([0, 4, 5, 76.3, 80], ["entry", "entry", "approach", "cut", "exit"])
    bar = time_bar.time_bar("name", shown, motion_time=72.3)
    assert "1:12.3 from first to last target, 0:07.7 approach and retreat</span>" in bar
    changed = run([0, 2, 60.04, 62], ["setup", "setup", "cut", "cut"])
    bar = time_bar.time_bar("name", changed, motion_time=59.96)
    assert "1:00.0 from first to last target, 0:02.0 approach and retreat and changes of setup" in bar
    assert "first to last" not in time_bar.time_bar("name", run([0, 1], ["cut", "cut"]), motion_time=1.0)
