"""Tracks in a cell file: what is read, and what cannot be a track."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.issues import TandemError
from tests.track_job import ARM, TRACK, problem


def told(folder: Path, track: dict[str, Any], **arm: Any) -> list[tuple[str, str]]:
    with pytest.raises(TandemError) as refused:
        problem(folder, track, **arm)
    return [(issue.code, issue.message) for issue in refused.value.issues]


def test_a_track_is_read_in_si_units_and_each_operation_is_a_setup(tmp_path: Path) -> None:
    made = problem(tmp_path, {**TRACK, "axis": [0, 3, 4], "home_mm": 250})
    track = made.cell.arm("left").track
    assert track is not None
    np.testing.assert_allclose(track.axis, [0.0, 0.6, 0.8])
    assert (track.low, track.high, track.home, track.unit) == (-3.0, 3.0, 0.25, "TRACK_1")
    assert [setup.operations for setup in made.setups] == [(0,), (1,)]
    stood = made.stationed({0: {"left": 1.5}})
    for setup in stood.setups:  # where nothing is said it stays
        np.testing.assert_allclose(setup.cell.arm("left").base[:3, 3], [0.0, 0.9, 1.2])
        assert "to 1500.000 mm" in setup.steps[-1] and "TRACK_1" in setup.steps[-1]
    np.testing.assert_allclose(made.setups[0].cell.arm("left").base[:3, 3], [0.0, 0.15, 0.2])
    np.testing.assert_allclose(stood.cell.arm("left").base[:3, 3], 0.0)  # that of value 0


def test_without_a_track_setups_are_as_they_were(tmp_path: Path) -> None:
    made = problem(tmp_path, None)
    assert [setup.operations for setup in made.setups] == [(0, 1)] and not made.setups[0].steps


WRONG = [
    ({"axis": [0, 0, 0]}, {}, "its length is 0"),
    ({"range_mm": [3000, -3000]}, {}, "the least value first"),
    ({"range_mm": [100, 100]}, {}, "the least value first"),
    ({"speed_mm_s": 0}, {}, "speed_mm_s: got 0; allowed: above 0"),
    ({"acceleration_mm_s2": -1}, {}, "acceleration_mm_s2: got -1"),
    ({"home_mm": 3001}, {}, "outside the range"),
    ({"unit": "ROB_1"}, {}, "the robot ROB_1"),
    ({}, {"base_auto": True}, "state its base"),
    ({}, {"robot": "kr16_2", "tool": {"kind": "ball_tool"}}, "KRL's E1"),
]


@pytest.mark.parametrize(("track", "arm", "words"), WRONG, ids=[words for _, _, words in WRONG])
def test_what_cannot_be_a_track_is_told(
    tmp_path: Path, track: dict[str, Any], arm: dict[str, Any], words: str
) -> None:
    found = told(tmp_path, {**TRACK, **track}, **arm)
    assert [message for _, message in found if words in message], found


def test_all_faults_of_a_track_are_told_at_once(tmp_path: Path) -> None:
    found = told(tmp_path, {**TRACK, "axis": [0, 0, 0], "speed_mm_s": 0, "home_mm": 9000})
    assert len(found) == 3


@pytest.mark.parametrize(
    ("controller", "code"), [({}, "problem.duplicate_name"), ({"sync": "handshake"}, "problem.track")]
)
def test_two_arms_on_one_unit_and_two_controllers_are_refused(
    tmp_path: Path, controller: dict[str, Any], code: str
) -> None:
    problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["cell"]["arms"].append({**ARM, "name": "right", "base": {"xyz_mm": [3000, 0, 0]}})
    data["cell"]["controller"] = controller
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as refused:
        planner.load(path)
    assert {issue.code for issue in refused.value.issues} == {code}
