"""Tracks, turntables and positioners in a cell file: what is read, and what is refused."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import planner
from planner.geometry.arrays import exp_rotation, from_parts
from planner.issues import TandemError
from planner.problem import RotaryAxis
from planner.reading import rail_axes, rotary_axes
from tests import positioner_job, table_job
from tests.track_job import ARM, TRACK, problem


def read_issues(folder: Path, track: dict[str, Any], **arm: Any) -> list[tuple[str, str]]:
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
    stood = made.with_stations({0: {"left": 1.5}})
    for setup in stood.setups:  # where nothing is said it stays
        np.testing.assert_allclose(setup.cell.arm("left").base[:3, 3], [0.0, 0.9, 1.2])
        assert "to 1500.000 mm" in setup.steps[-1] and "TRACK_1" in setup.steps[-1]
    np.testing.assert_allclose(made.setups[0].cell.arm("left").base[:3, 3], [0.0, 0.15, 0.2])
    np.testing.assert_allclose(stood.cell.arm("left").base[:3, 3], 0.0)  # that of value 0


def test_the_value_that_people_are_told_hangs_on_no_noise(tmp_path: Path) -> None:
    """Programs have four decimals and messages have three.

    Plan and proof compute the value independently and round a half alike.
    """
    made = problem(tmp_path)
    for value in (-0.5154295, 1.2345675):
        near = (np.nextafter(value, -9.0), value, np.nextafter(value, 9.0))
        assert len({made.with_stations({0: {"left": float(v)}}).setups[0].steps for v in near}) == 1


def test_without_a_track_setups_are_as_they_were(tmp_path: Path) -> None:
    made = problem(tmp_path, None)
    assert [setup.operations for setup in made.setups] == [(0, 1)] and not made.setups[0].steps


WRONG = [
    ({"axis": [0, 0, 0]}, {}, "its length is 0"),
    ({"range_mm": [3000, -3000]}, {}, "the lower value first"),
    ({"range_mm": [100, 100]}, {}, "the lower value first"),
    ({"speed_mm_s": 0}, {}, "speed_mm_s: got 0; allowed: 1 at least"),
    ({"speed_mm_s": 1e-9}, {}, "speed_mm_s: got 1e-09; allowed: 1 at least"),  # programs were not proven
    ({"range_mm": [0, 1e9]}, {}, "allowed are values up to 100000 mm either way"),
    ({"acceleration_mm_s2": -1}, {}, "acceleration_mm_s2: got -1"),
    ({"home_mm": 3001}, {}, "outside the range"),
    ({"range_mm": [-3, 3]}, {}, "values are mm: 3 m are 3000"),
    ({}, {"gantry": {"axes": [TRACK, TRACK]}}, "is stated with the key axes"),
    ({}, {"tracks": [TRACK, TRACK]}, "an arm on two or three linear axes"),
    ({"unit": "ROB_1"}, {}, "the robot ROB_1"),
    ({}, {"base_auto": True}, "state its base"),
]


@pytest.mark.parametrize(("track", "arm", "words"), WRONG, ids=[words for _, _, words in WRONG])
def test_what_cannot_be_a_track_is_told(
    tmp_path: Path, track: dict[str, Any], arm: dict[str, Any], words: str
) -> None:
    result = read_issues(tmp_path, {**TRACK, **track}, **arm)
    assert [message for _, message in result if words in message], result


def test_a_list_of_tracks_in_a_cell_file_is_told_as_a_gantry(tmp_path: Path) -> None:
    problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["cell"]["arms"][0]["track"] = [TRACK, {**TRACK, "axis": [0, 0, 1]}]
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(data["cell"]))
    path.write_text(yaml.safe_dump({**data, "cell": "cell.yaml"}))
    with pytest.raises(TandemError, match="is stated with the key axes; axes") as refused:
        planner.load(path)
    (issue,) = refused.value.issues
    assert issue.code == "problem.field" and str(issue.field).endswith("arms.0.track")


def test_all_faults_of_a_track_are_told_at_once(tmp_path: Path) -> None:
    result = read_issues(tmp_path, {**TRACK, "axis": [0, 0, 0], "speed_mm_s": 0, "home_mm": 9000})
    assert len(result) == 3


def test_arms_on_one_controller_have_units_of_their_own(tmp_path: Path) -> None:
    """On two controllers each may be called alike, but for its own robot."""
    problem(tmp_path)
    path = tmp_path / "problem.yaml"
    data = yaml.safe_load(path.read_text())
    data["cell"]["arms"].append({**ARM, "name": "right", "base": {"xyz_mm": [3000, 0, 0]}})

    def load(**controller: Any) -> planner.Problem:
        path.write_text(yaml.safe_dump({**data, "cell": {**data["cell"], "controller": controller}}))
        return planner.load(path)

    assert [arm.linear_axes[0].unit for arm in load(sync="handshake").cell.arms] == ["TRACK_1", "TRACK_1"]
    for controller in ({}, {"sync": "handshake", "units": ["ROB_1", "TRACK_1"]}):
        with pytest.raises(TandemError) as refused:
            load(**controller)
        assert {issue.code for issue in refused.value.issues} == {"problem.duplicate_name"}


# ---- tracks that go along ----


SOFT = {"stiffness": {"joints_nm_rad": [1e5] * 6, "source": "a guess"}, "compensate_sag": {"load": True}}


def test_what_cannot_go_along_is_told(tmp_path: Path) -> None:
    words, found = (
        "has a coordinated track and sag compensation; both together are not",
        read_issues(tmp_path, {**TRACK, "follow": 1}, **SOFT),
    )
    assert [message for code, message in found if words in message and code == "problem.track"], found


@pytest.mark.parametrize("follow_fraction", [0.0, -1.0, 1.5])
def test_a_track_goes_along_by_a_share_of_the_way(tmp_path: Path, follow_fraction: float) -> None:
    assert problem(tmp_path, {**TRACK, "follow": 0.5}).cell.arm("left").has_coordinated_track
    assert not problem(tmp_path).cell.arm("left").has_coordinated_track
    assert any(
        "follow" in message for _, message in read_issues(tmp_path, {**TRACK, "follow": follow_fraction})
    )


def test_a_track_goes_along_only_in_work_that_takes_it(tmp_path: Path) -> None:
    made = problem(tmp_path, {**TRACK, "follow": 1})
    assert "and goes along while the arm works" in made.setups[0].steps[-1]
    assert rail_axes.coordinated_track_faults(made) == []
    trimmed = SimpleNamespace(name="edge", process="trim", arms=("left",), leaves=lambda stock: stock)
    (fault,) = rail_axes.coordinated_track_faults(
        dataclasses.replace(made, operations=(trimmed, made.operations[0]))
    )
    assert fault.code == "problem.track" and fault.field == "operations.0"
    assert "trim does not support a coordinated track" in fault.message


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
    stood = made.with_stations({0: {"stock": np.pi / 2}})
    for (
        setup
    ) in stood.setups:  # where nothing is said it stays; a quarter turn clockwise, as its axis is down
        stock_pose = setup.stock.place
        assert stock_pose is not None
        np.testing.assert_allclose(stock_pose[:3, 3], [0.9 + 0.02, -0.03, 0.24], atol=1e-12)
        angle = np.deg2rad(10 - 90)
        np.testing.assert_allclose(stock_pose[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-12)
        np.testing.assert_allclose(setup.stock.attitude, stock_pose[:3, :3])
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
    ({"axis": [0, 1, 0]}, {}, "it is not vertical"),
    ({"range_deg": [180, -180]}, {}, "the lower value first"),
    ({"range_deg": [-4000, 0]}, {}, "up to 3600"),
    ({"home_deg": 200}, {}, "outside the range"),
    ({"speed_deg_s": 0}, {}, "speed_deg_s"),
    ({"external_axis": 7}, {}, "external_axis"),
    ({"unit": "rob_1"}, {}, "that of a robot"),
    ({"arm": "other"}, {}, "'other' is not an arm"),
    (FAST, {"arms": [KUKA], "stock": LONG}, "one percent of its maximum"),
    ({}, {"arms": [{**table_job.ARM, "track": TRACK}]}, "together with an arm on a track"),
    ({"centre_mm": [900, 600, 200]}, {}, "the block is not on the turntable"),
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
    result = [str(issue) for issue in refused.value.issues]
    assert [text for text in result if words in text], result
    own = ("problem.turntable", "problem.field", "problem.unknown_arm", "problem.duplicate_name")
    assert {issue.code for issue in refused.value.issues} <= set(own)


def test_axes_beyond_arms_without_rapid_or_krl_are_refused(tmp_path: Path) -> None:
    cell = table_job.problem(tmp_path).cell
    arm = dataclasses.replace(cell.arms[0], custom_data=dataclasses.replace(cell.arms[0].data, family="UR"))
    with pytest.raises(TandemError, match="only supported for ABB and KUKA controllers") as refused:
        rail_axes.build_linear_axes(rail_axes.TrackFile.model_validate(TRACK), None, arm, 0, ())
    assert {issue.code for issue in refused.value.issues} == {"problem.track"}
    with pytest.raises(TandemError, match="only supported for ABB and KUKA controllers") as refused:
        rotary_axes.build_turntable(
            rotary_axes.TurntableFile.model_validate(table_job.TABLE), [arm], cell.controller
        )
    assert {issue.code for issue in refused.value.issues} == {"problem.turntable"}
    spec = rotary_axes.PositionerFile.model_validate(positioner_job.POSITIONER)
    with pytest.raises(TandemError, match="positioners are only supported for ABB and KUKA controllers"):
        rotary_axes.build_turntable(spec, [arm], cell.controller, ("cradle",))


# ---- positioners ----


def test_a_positioner_is_read_and_tilts_what_the_turn_has_turned(tmp_path: Path) -> None:
    made = positioner_job.problem(tmp_path)
    table = made.cell.turntable
    assert table is not None and table.tilt is not None
    assert (table.label, table.column, table.tilt.label, table.tilt.column) == (
        "STN_1 turn",
        1,
        "STN_1 tilt",
        0,
    )
    np.testing.assert_allclose(np.rad2deg([table.tilt.low, table.tilt.high]), [-20, 70])
    assert table.load == 250.0 and np.rad2deg(table.tilt.acceleration) == pytest.approx(30.0)
    stood = made.with_stations({0: {"stock": np.deg2rad(-60.0), "stock/tilt": np.deg2rad(40.0)}}).setups[0]
    turn = Rotation.from_euler("z", -60.0, degrees=True).as_matrix()  # scipy's
    tilt = Rotation.from_euler("y", 40.0, degrees=True).as_matrix()
    middle, below = np.array([0.9, 0.0, 0.5]), np.array([0.9, 0.0, 0.47])
    place, stated = stood.stock.place, made.stock.place
    assert place is not None and stated is not None
    seen = below + tilt @ (middle + turn @ (stated[:3, 3] - middle) - below)
    np.testing.assert_allclose(place[:3, 3], seen, atol=1e-12)
    np.testing.assert_allclose(place[:3, :3], tilt @ turn @ stated[:3, :3], atol=1e-12)
    bodies = {body.name: body.shapes[0].pose for body in stood.cell.obstacles}
    np.testing.assert_allclose(bodies["cradle"][:3, 3], below + tilt @ [0.0, 0.0, -0.03], atol=1e-12)
    np.testing.assert_allclose(
        bodies["turntable"][:3, 2], tilt[:, 2], atol=1e-12
    )  # the plate, round about it
    np.testing.assert_allclose(bodies["posts"], made.cell.obstacles[1].shapes[0].pose)
    assert "turns to -60.0000 deg" in stood.steps[-1] and "tilts to 40.0000 deg" in stood.steps[-1]
    level = stood.with_zero_tilt
    np.testing.assert_allclose(level.cell.obstacles[0].shapes[0].pose[:3, 3], [0.9, 0.0, 0.44], atol=1e-12)
    assert level.stock.place is not None and level.stock.place[2, 3] == pytest.approx(0.54)


TILTS: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"axis": [0, 0, 0]}, {}, "tilt.axis: its length is 0"),
    ({"axis": [0, 0.05, 1]}, {}, "tilt.axis: it is vertical"),
    ({"range_deg": [30, 30]}, {}, "tilt.range_deg: got 30 to 30"),
    ({"range_deg": [10, 90], "home_deg": 20}, {}, "0, where the plate is level, is outside 10 to 90"),
    ({"range_deg": [-200, 90]}, {}, "up to 180 either way"),
    ({"home_deg": 120}, {}, "tilt.home_deg: 120 is outside the range"),
    ({"home_deg": 45}, {}, "tilt.home_deg: got 45; the block is clamped and removed there"),
    ({"external_axis": 2}, {}, "it is 2 (eax_b, E2), as for the turn axis"),
    ({"bracket": ["arm"]}, {}, "'arm' is not an obstacle of the cell; obstacles are cradle, posts"),
    ({"speed_deg_s": 0}, {}, "speed_deg_s"),
    ({}, {"range_deg": [180, -180]}, "the lower value first"),
    ({}, {"axis": [0, 1, 1]}, "it is not vertical; allowed"),
    ({}, {"centre_mm": [900, 0, 400]}, "the block is not on the positioner"),
    ({}, {"load_kg": 0.1}, "carries 0.1 kg"),
    ({}, {"plate": {"diameter_mm": 220, "height_mm": 530}}, "extends 30 mm into the floor; make it lower"),
]


@pytest.mark.parametrize(("tilt", "table", "words"), TILTS, ids=[words for _, _, words in TILTS])
def test_what_cannot_be_a_positioner_is_told(
    tmp_path: Path, tilt: dict[str, Any], table: dict[str, Any], words: str
) -> None:
    given = {**positioner_job.POSITIONER, **table, "tilt": {**positioner_job.TILT, **tilt}}
    stock = {**positioner_job.STOCK, "foam": "xps_30"}
    with pytest.raises(TandemError) as refused:
        positioner_job.problem(tmp_path, given, stock=stock)
    result = [str(issue) for issue in refused.value.issues]
    assert [text for text in result if words in text], result


def test_axes_that_do_not_meet_and_lean_otherwise_are_taken(tmp_path: Path) -> None:
    tilt = {**positioner_job.TILT, "centre_mm": [860, 0, 450], "axis": [0, 1, 1]}
    assert positioner_job.problem(tmp_path, {**positioner_job.POSITIONER, "tilt": tilt}).cell.turntable


def test_a_positioner_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match="together with an arm on a track"):
        positioner_job.problem(tmp_path, arms=({**table_job.ARM, "track": TRACK},))
    cell = positioner_job.problem(tmp_path).path
    data = yaml.safe_load(cell.read_text())
    data["cell"]["turntable"] = table_job.TABLE
    cell.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError, match="got a turntable and a positioner"):
        planner.load(cell)


@pytest.mark.parametrize("kind", ["turntable", "positioner"])
def test_a_kuka_controller_turns_no_farther_than_its_software_limits(tmp_path: Path, kind: str) -> None:
    job: Any = table_job if kind == "turntable" else positioner_job
    own = job.TABLE if kind == "turntable" else job.POSITIONER
    wide, most = {**own, "range_deg": [-720, 180]}, {**own, "range_deg": [-358, 358]}
    assert job.problem(tmp_path, wide).cell.turntable and job.problem(tmp_path, most, arms=(KUKA,))
    with pytest.raises(TandemError, match="got -720 to 180; software limits of rotary axes") as caught:
        job.problem(tmp_path, wide, arms=(KUKA,))
    assert [issue.field for issue in caught.value.issues] == [f"cell.{kind}.range_deg"]


def test_a_tilt_that_krl_cannot_slow_down_enough_is_told(tmp_path: Path) -> None:
    """At one percent of 720 deg/s a point 2 m from the axis moves at 251 mm/s.

    The block's upper end is 1.94 m above the tilt axis, and farther from it than that in every rotation. It
    is farthest with its long side across the axis, to which it has to be rotated first.
    """
    fast = {**positioner_job.TILT, "speed_deg_s": 720}
    stock = {**positioner_job.STOCK, "size_mm": [260, 1100, 1860]}
    positioner = {**positioner_job.POSITIONER, "tilt": fast}
    assert positioner_job.problem(tmp_path, positioner, stock=stock).cell.turntable
    with pytest.raises(TandemError, match="one percent of its maximum") as caught:
        positioner_job.problem(tmp_path, positioner, stock=stock, arms=(KUKA,))
    (issue,) = caught.value.issues
    assert issue.field == "cell.positioner.tilt.speed_deg_s" and "the load of STN_1 tilt" in issue.message
    top = np.array([[x, y, 1860.0] for x in (-130.0, 130.0) for y in (-550.0, 550.0)])
    at = np.array([920.0, 10.0, 540.0]) + Rotation.from_euler("z", 10, degrees=True).apply(top)
    distance = float(np.hypot(np.linalg.norm(at[:, :2] - [900.0, 0.0], axis=1), at[:, 2] - 470.0).max())
    told_far = float(issue.message.split(" extends ")[1].split()[0])
    assert 0.999 * distance < told_far < 1.003 * distance
    slow = {**positioner, "tilt": {**fast, "speed_deg_s": 600}}
    assert positioner_job.problem(tmp_path, slow, stock=stock, arms=(KUKA,)).cell.turntable


def test_work_that_counts_on_gravity_takes_no_tilted_block(tmp_path: Path) -> None:
    made = positioner_job.problem(tmp_path)
    weighing = dataclasses.replace(made, operations=(made.operations[0], _Weighed()))
    (issue,) = rotary_axes.turntable_faults(weighing)
    assert issue.code == "problem.turntable" and issue.field == "operations.1"
    assert "operation cut: straight_wire depends on the direction of gravity in the block" in issue.message


class _Weighed:
    """An operation whose process does not limit the tilt of its block."""

    name, process, arms = "cut", "straight_wire", ("left",)

    def leaves(self, stock: Any) -> Any:
        return stock


def test_values_at_once_turn_a_pose_as_one_by_one() -> None:
    given = np.random.default_rng(3)
    axis = given.normal(size=3)
    turn = RotaryAxis("table", "TABLE", 0, given.normal(size=3), axis / np.linalg.norm(axis), -3, 3, 1, 0)
    place = from_parts(exp_rotation(given.normal(size=3)), given.normal(size=3))
    values = given.uniform(-3.0, 3.0, 20)
    np.testing.assert_array_equal(turn.rotate(place, values), [turn.rotate(place, v) for v in values])
