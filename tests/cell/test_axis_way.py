"""Motion of tracks, turntables and positioners: bounds against plain trials, and the final poses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial.transform import Rotation
from shapely.affinity import rotate

from planner.cell import clearance, external_axis_motion, plant
from planner.problem import RotaryAxis, Turntable
from tests import positioner_job, table_job, track_job


@pytest.mark.parametrize(("side", "clear"), [(1500.0, True), (-450.0, True), (150.0, False)])
def test_no_plain_trial_is_nearer_than_the_bound(tmp_path: Path, side: float, clear: bool) -> None:
    pose = {"xyz_mm": [side, 300, 350]}
    post = {"name": "post", "shapes": [{"kind": "box", "size_mm": [60, 50, 700], "pose": pose}]}
    problem = track_job.problem(tmp_path, obstacles=[post]).with_stations({0: {"left": -0.5}})
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    arm = setup.cell.arm("left")
    assert arm.track is not None
    way = external_axis_motion.check_linear_motion(model, "left", (-0.5, 0.9), {"left": arm.home}, 0.01)
    assert way.clear == clear
    least = np.inf
    for value in np.linspace(-0.5, way.at if not clear else 0.9, 101):
        there = model.with_bases({"left": arm.track.translate(problem.cell.arms[0].base, value)})
        least = min(least, float(clearance.min_clearance(there, {"left": arm.home[None]}, 0.5).distance[0]))
    assert way.min_distance <= least + 1e-9
    assert len(way.samples) < 2000


def _box(size: list[float], at: list[float]) -> dict[str, Any]:
    return {"kind": "box", "size_mm": size, "pose": {"xyz_mm": at}}


def _rail(top: float = 0.0, size: tuple[float, float] = (500.0, 7000.0), y: float = 0.0) -> dict[str, Any]:
    return _box([*size, 50], [0, y, top - 25])


STOP = _box([200, 100, 100], [0, 300, 50])
"""A body on a rail that is lower than all of an arm but its base."""


@pytest.mark.parametrize(
    ("body", "clear"),
    [
        ([_rail()], True),
        ([_rail(1.0)], True),  # bodies of bases end so far below
        ([_rail(size=(500.0, 1000.0), y=y) for y in (-1000.0, 0.0, 1000.0)], True),  # laid in pieces
        ([_rail(4.0)], False),
        ([_rail(), STOP], False),
        ([_rail(), _box([60, 7000, 100], [209.5, 0, 50])], False),  # a wall 3 mm beside the base
        ([STOP, _box([200, 100, 100], [-30, -756, 50])], False),  # one of them 3 mm behind the base
    ],
)
def test_a_base_slides_on_what_is_under_its_foot(tmp_path: Path, body: list[Any], clear: bool) -> None:
    """Given as one body. The base reaches to 176.5 mm across its way and, at first, from -703 mm along it."""
    way = _along(tmp_path, body)
    assert way.clear == clear
    if not clear:
        assert way.pair == ("left/base_link", "rail")


@pytest.mark.parametrize(("stop", "clear"), [(False, True), (True, False)])
def test_a_mesh_of_rail_and_stop_is_its_hull(tmp_path: Path, stop: bool, clear: bool) -> None:
    parts = [trimesh.creation.box([500, 7000, 50], trimesh.transformations.translation_matrix([0, 0, -25]))]
    if stop:
        there = trimesh.transformations.translation_matrix([0, 300, 10])
        parts.append(trimesh.creation.box([200, 100, 100], there))
    trimesh.util.concatenate(parts).export(tmp_path / "rail.stl")
    way = _along(tmp_path, [{"kind": "mesh", "file": "rail.stl", "unit": "mm"}])
    assert way.clear == clear
    assert clear or way.pair == ("left/base_link", "rail")


def _along(folder: Path, body: list[Any]) -> external_axis_motion.AxisMotionCheck:
    """The way of a base from -0.5 to 0.9 m over the one body of its cell."""
    made = track_job.problem(folder, obstacles=[{"name": "rail", "shapes": body}])
    setup = made.with_stations({0: {"left": -0.5}}).setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    arm = setup.cell.arm("left")
    assert arm.track is not None
    return external_axis_motion.check_linear_motion(model, "left", (-0.5, 0.9), {"left": arm.home}, 0.01)


@pytest.mark.parametrize(("side", "clear"), [(470.0, True), (430.0, True), (405.0, False)])
@pytest.mark.parametrize("end", [140.0, -140.0])
def test_a_turning_block_is_no_nearer_than_the_bound(
    tmp_path: Path, side: float, clear: bool, end: float
) -> None:
    """Upright blocks, so shapely's turned outlines in the plane are the truth."""
    pose = {"xyz_mm": [900, float(np.sign(end)) * side, 300]}
    post = {"name": "post", "shapes": [{"kind": "box", "size_mm": [40, 20, 600], "pose": pose}]}
    problem = table_job.problem(tmp_path, obstacles=[post])
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(model, "stock", 0.0, (0.0, np.deg2rad(end)), homes, 0.01)
    assert way.clear == clear
    block = rotate(shapely.box(630, -180, 1230, 220), 10.0, origin=(930, 20))
    corner = np.sign(end) * side
    fixed = shapely.box(880, corner - 10, 920, corner + 10)
    least = min(
        rotate(block, angle, origin=(900, 0)).distance(fixed)
        for angle in np.linspace(0.0, end if clear else np.rad2deg(way.at), 401)
    )
    assert 1e3 * way.min_distance <= least + 1e-6
    if clear:  # looks are dense enough to be of use
        assert 1e3 * way.min_distance > 0.5 * (least + 10.0) - 0.1
        assert way.pair == ("stock", "post")
    assert len(way.samples) < 2000


def test_the_plate_and_what_stands_on_it_do_not_come_nearer(tmp_path: Path) -> None:
    problem = table_job.problem(tmp_path)
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(model, "stock", 0.0, (0.0, np.pi), homes, 0.01)
    assert way.clear and "turntable" not in way.pair


@pytest.mark.parametrize(
    ("x", "z", "clear"), [(1080.0, 140.0, True), (1080.0, 258.0, True), (1080.0, 300.0, False)]
)
def test_a_tilting_block_is_no_nearer_than_the_bound(tmp_path: Path, x: float, z: float, clear: bool) -> None:
    """All bodies are upright to the plane of the tilt, so shapely's turned outlines there are the truth."""
    x = 1080.0
    box = {"kind": "box", "size_mm": [60, 100, z], "pose": {"xyz_mm": [x, 0, 0.5 * z]}}
    post = {"name": "post", "shapes": [box]}
    stock = {**positioner_job.STOCK, "place": {"xyz_mm": [920, 0, 540]}}
    problem = positioner_job.problem(tmp_path, obstacles=(positioner_job.CRADLE, post), stock=stock)
    start = problem.with_stations({0: {"stock": 0.0, "stock/tilt": 0.0}})
    setup = start.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(
        model, "stock/tilt", 0.0, (0.0, np.deg2rad(70.0)), homes, 0.01
    )
    assert way.clear == clear
    riding = shapely.union_all(
        [
            shapely.box(720, 540, 1120, 590),  # block
            shapely.box(820, 500, 1020, 540),  # support
            shapely.box(790, 480, 1010, 500),  # plate
            shapely.box(850, 420, 950, 460),  # cradle
        ]
    )
    fixed = shapely.box(x - 30, 0, x + 30, z)
    least = min(
        rotate(riding, -angle, origin=(900, 470)).distance(fixed)
        for angle in np.linspace(0.0, 70.0 if clear else np.rad2deg(way.at), 401)
    )
    assert way.min_distance <= 1e-3 * least + 1e-9
    if clear:
        assert way.min_distance > 0.01 and len(way.samples) < 200


def test_what_is_tilted_keeps_off_the_floor(tmp_path: Path) -> None:
    low = {**positioner_job.TILT, "centre_mm": [900, 0, 130]}
    given = {**positioner_job.POSITIONER, "centre_mm": [900, 0, 160], "tilt": low}
    stock = {**positioner_job.STOCK, "place": {"xyz_mm": [920, 0, 200]}}
    cradle = {"name": "cradle", "shapes": [{"kind": "box", "size_mm": [100, 500, 20]}]}
    cradle["shapes"][0]["pose"] = {"xyz_mm": [900, 0, 110]}
    arm = {**table_job.ARM, "base": {"xyz_mm": [0, 0, 0]}}
    problem = positioner_job.problem(tmp_path, given, [cradle], stock, arms=(arm,))
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(
        model, "stock/tilt", 0.0, (0.0, np.deg2rad(70.0)), homes, 0.01
    )
    assert not way.clear and way.pair[1] == external_axis_motion.FLOOR
    # the block's far lower corner: 180 mm (turned home, so on the other side) and 70 mm above the axis
    angle = np.rad2deg(way.at)
    outline = rotate(shapely.box(680, 200, 1080, 250), -angle, origin=(900, 130))
    assert outline.bounds[1] < 11.5


POSTS = positioner_job.POSTS["shapes"]
SHAFT = {
    "kind": "cylinder",
    "radius_mm": 20,
    "length_mm": 600,
    "pose": {"xyz_mm": [900, 0, 470], "rpy_deg": [90, 0, 0]},
}
CRADLE = positioner_job.CRADLE["shapes"]


@pytest.mark.parametrize(
    ("bracket", "fixed", "clear"),
    [
        (CRADLE, POSTS, True),
        (CRADLE, [*POSTS, _box([60, 100, 440], [816, 0, 220])], False),  # a column 4 mm behind the cradle
        ([*CRADLE, SHAFT], POSTS, True),  # a shaft that goes into the posts
        ([*CRADLE, _box([60, 560, 30], [900, 0, 470])], POSTS, False),  # a square one that does
        # a bar that lies 3.2 mm off the edge of a post, above it and past its end, and goes down beside it
        (
            [*CRADLE, _box([300, 12, 40], [900, 257, 495])],
            [POSTS[0], _box([300, 40, 472], [900, 284, 236])],
            False,
        ),
        # a post at the end of a wide cradle, off the axis
        ([_box([400, 500, 40], [900, 0, 440])], [*POSTS, _box([40, 40, 490], [1080, 272, 245])], False),
    ],
)
def test_shapes_beside_a_bearing_are_looked_at(
    tmp_path: Path, bracket: list[Any], fixed: list[Any], clear: bool
) -> None:
    """Posts bear the cradle, 2 mm off its ends; other shapes of the same two bodies do not for that."""
    obstacles = ({"name": "cradle", "shapes": bracket}, {"name": "posts", "shapes": fixed})
    problem = positioner_job.problem(tmp_path, obstacles=obstacles)
    setup = problem.setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(
        model, "stock/tilt", 0.0, (0.0, np.deg2rad(70.0)), homes, 0.01
    )
    assert way.clear == clear
    if not clear:
        assert way.pair == ("cradle", "posts")


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("tilt_angle", [0.7, -0.4])
def test_a_tilted_turn_is_scipys(sense: float, tilt_angle: float) -> None:
    """Where axes take a block, and where the turn axis then lies, by scipy's rotations about axes of either
    sense whose centres lie apart."""
    across = np.array([0.6, 0.8, 0.0])
    tilt = RotaryAxis("left", "STN_1", 0, np.array([0.8, 0.1, 0.4]), across, -1.5, 1.5, 1.0, 0.0)
    centre = np.array([0.9, 0.0, 0.5])
    table = Turntable("left", "STN_1", 1, centre, np.array([0.0, 0.0, sense]), -3.0, 3.0, 1.0, 0.0, tilt=tilt)
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler("xyz", [0.1, -0.2, 0.3]).as_matrix()
    place[:3, 3] = 1.0, 0.2, 0.6

    def seated(turn: float) -> np.ndarray:
        about, over = (
            Rotation.from_rotvec([0.0, 0.0, sense * turn]),
            Rotation.from_rotvec(tilt_angle * across),
        )
        out = np.eye(4)
        out[:3, :3] = (over * about).as_matrix() @ place[:3, :3]
        out[:3, 3] = tilt.centre + over.apply(centre + about.apply(place[:3, 3] - centre) - tilt.centre)
        return out

    first = {"stock": 0.5, "stock/tilt": tilt_angle}
    np.testing.assert_allclose(table.move_pose(place, first), seated(0.5), atol=1e-14)
    second = table.move_pose(seated(0.5), {"stock": 1.4, "stock/tilt": tilt_angle}, first)
    np.testing.assert_allclose(second, seated(1.4), atol=1e-14)
    pivot = table.axis_at_tilt("stock", tilt_angle)
    np.testing.assert_allclose(pivot.rotate(seated(0.5), 0.9), seated(1.4), atol=1e-14)
    np.testing.assert_allclose(pivot.axis, Rotation.from_rotvec(tilt_angle * across).apply([0.0, 0.0, sense]))
    assert table.axis_at_tilt("stock/tilt", tilt_angle) is tilt
