"""Tracks and turntables in a cell file: what is read, and what cannot be one."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.issues import TandemError
from planner.reading import axes
from tests import table_job
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


# ---- turntables ----


def test_a_turntable_is_read_in_si_units_and_turns_all_that_stands_on_it(tmp_path: Path) -> None:
    given = {**table_job.TABLE, "axis": [0, 0, -2], "home_deg": 30, "external_axis": 3}
    made = table_job.problem(tmp_path, given)
    table = made.cell.turntable
    assert table is not None
    assert (table.arm, table.unit, table.column) == ("left", "STN_1", 2)
    np.testing.assert_allclose([table.low, table.high, table.home], np.deg2rad([-180, 180, 30]))
    np.testing.assert_allclose(table.centre, [0.9, 0.0, 0.2])
    (plate,) = [body for body in made.cell.obstacles if body.name == "turntable"]
    np.testing.assert_allclose(plate.shapes[0].pose[:3, 3], [0.9, 0.0, 0.1])  # its top is the centre's height
    stood = made.stationed({0: {"stock": np.pi / 2}})
    for (
        setup
    ) in stood.setups:  # where nothing is said it stays; a quarter turn clockwise, as its axis is down
        place = setup.stock.place
        assert place is not None
        np.testing.assert_allclose(place[:3, 3], [0.9 + 0.02, -0.03, 0.24], atol=1e-12)
        angle = np.deg2rad(10 - 90)
        np.testing.assert_allclose(place[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-12)
        np.testing.assert_allclose(setup.stock.attitude, place[:3, :3])
        assert "to 90.0000 deg" in setup.steps[-1] and "STN_1" in setup.steps[-1]
    (home, _) = made.setups
    assert home.stock.station == pytest.approx(np.deg2rad(30)) and "to 30.0000 deg" in home.steps[-1]
    assert made.stock.place is not None
    np.testing.assert_allclose(made.stock.place[:3, 3], [0.93, 0.02, 0.24])  # that of value 0


def test_without_a_turntable_setups_are_as_they_were(tmp_path: Path) -> None:
    block = {**table_job.STOCK, "support": "pedestal"}
    made = table_job.problem(tmp_path, None, stock=block)
    assert [setup.operations for setup in made.setups] == [(0, 1)] and not made.setups[0].steps


FAST = {**table_job.TABLE, "speed_deg_s": 720}
KUKA = {**table_job.ARM, "robot": "kr16_2"}
LONG = {**table_job.STOCK, "size_mm": [4600, 400, 50]}
NO_TABLE: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"axis": [0, 0, 0]}, {}, "its length is 0"),
    ({"axis": [0, 1, 0]}, {}, "it leans"),
    ({"range_deg": [180, -180]}, {}, "the least value first"),
    ({"range_deg": [-4000, 0]}, {}, "up to 3600"),
    ({"home_deg": 200}, {}, "outside the range"),
    ({"speed_deg_s": 0}, {}, "speed_deg_s"),
    ({"external_axis": 7}, {}, "external_axis"),
    ({"unit": "rob_1"}, {}, "that of a robot"),
    ({"arm": "other"}, {}, "'other' is not an arm"),
    (FAST, {"arms": [KUKA], "stock": LONG}, "one percent of its own"),
    ({}, {"arms": [{**table_job.ARM, "track": TRACK}]}, "together with an arm on a track"),
    ({"centre_mm": [900, 600, 200]}, {}, "does not stand on the turntable"),
    ({"centre_mm": [900, 0, 100]}, {}, "100 mm above the plate"),
    ({}, {"stock": {**table_job.STOCK, "support": "pedestal"}}, "does not turn; state the shapes"),
    ({}, {"stock": {**table_job.STOCK, "place": "auto"}}, "state stock.place"),
]


@pytest.mark.parametrize(("table", "rest", "words"), NO_TABLE, ids=[words for _, _, words in NO_TABLE])
def test_what_cannot_be_a_turntable_is_told(
    tmp_path: Path, table: dict[str, Any], rest: dict[str, Any], words: str
) -> None:
    with pytest.raises(TandemError) as refused:
        table_job.problem(tmp_path, {**table_job.TABLE, **table}, **rest)
    found = [str(issue) for issue in refused.value.issues]
    assert [text for text in found if words in text], found
    own = ("problem.turntable", "problem.field", "problem.unknown_arm", "problem.duplicate_name")
    assert {issue.code for issue in refused.value.issues} <= set(own)


def test_axes_beyond_arms_without_rapid_or_krl_are_refused(tmp_path: Path) -> None:
    cell = table_job.problem(tmp_path).cell
    arm = dataclasses.replace(cell.arms[0], given=dataclasses.replace(cell.arms[0].data, family="UR"))
    with pytest.raises(TandemError, match="written for ABB and KUKA controllers alone") as refused:
        axes.track(axes.TrackFile.model_validate(TRACK), arm, 0)
    assert {issue.code for issue in refused.value.issues} == {"problem.track"}
    with pytest.raises(TandemError, match="written for ABB and KUKA controllers alone") as refused:
        axes.turntable(axes.TurntableFile.model_validate(table_job.TABLE), [arm], cell.controller)
    assert {issue.code for issue in refused.value.issues} == {"problem.turntable"}
