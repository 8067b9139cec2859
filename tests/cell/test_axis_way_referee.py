"""Motion of a track's base over random rails and past random bodies, and of a tilt between posts.

The reference are plain trials with coal (https://github.com/coal-library/coal).
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planner.cell import external_axis_motion, plant
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray
from planner.problem import TILT_AXIS
from tests import positioner_job, track_job
from tests.cell.test_distance import coal_shape

ENOUGH = 0.01
ENDS = (-0.5, 0.6)
STEP_M = 4e-3
ALLOWED = 1e-6
"""Distances are within this of the truth [m]."""


def _rotated_pose(
    at: FloatArray, spin: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> dict[str, Any]:
    """A pose of a file, its position (3,) [mm] turned by ``spin`` [deg] about z."""
    c, s = float(np.cos(np.deg2rad(spin))), float(np.sin(np.deg2rad(spin)))
    x, y, z = at.tolist()
    return {"xyz_mm": [c * x - s * y, s * x + c * y, z], "rpy_deg": [*rpy[:2], rpy[2] + spin]}


def _rails(rng: np.random.Generator, spin: float) -> list[dict[str, Any]]:
    """Two to four rails along x, turned by ``spin``, one of them in two pieces; the first of them touches a
    foot at 0."""
    out: list[dict[str, Any]] = []
    for side in np.linspace(-120.0, 120.0, int(rng.integers(2, 5))).tolist():
        top = 0.0 if not out else float(-rng.uniform(0.0, 30.0))
        kind = str(rng.choice(["box", "cylinder", "capsule"]))
        if kind == "box":
            high = float(rng.uniform(20.0, 120.0))
            for x in (-2000.0, 2000.0):
                at = np.array([x, side, top - 0.5 * high])
                out.append({"kind": "box", "size_mm": [4000, 40, high], "pose": _rotated_pose(at, spin)})
            continue
        radius = float(rng.uniform(10.0, 60.0))
        lying = _rotated_pose(np.array([0.0, side, top - radius]), spin, (0.0, 90.0, 0.0))
        out.append({"kind": kind, "radius_mm": radius, "length_mm": 6000, "pose": lying})
    return out


def _random_obstacles(folder: Path, rng: np.random.Generator, spin: float) -> list[dict[str, Any]]:
    """Return bodies ahead of the base and next to its path, some in it, all higher than its foot."""
    out: list[dict[str, Any]] = []
    for number in range(int(rng.integers(1, 5))):
        size = rng.uniform(30.0, 160.0, 3).tolist()
        side = float(rng.choice([-1.0, 1.0])) * (
            float(rng.uniform(230.0, 420.0)) if rng.random() < 0.8 else 0.0
        )
        at = np.array([rng.uniform(-900.0, 900.0), side, rng.uniform(20.0, 100.0)])
        if side == 0.0:
            at[0] = rng.uniform(300.0, 900.0)
        rpy = tuple(rng.uniform(-180.0, 180.0, 3).tolist()) if rng.random() < 0.5 else (0.0, 0.0, 0.0)
        kind, pose = str(rng.choice(["box", "cylinder", "sphere", "mesh"])), _rotated_pose(at, spin, rpy)
        if kind == "box":
            out.append({"kind": "box", "size_mm": size, "pose": pose})
        elif kind == "cylinder":
            out.append({"kind": "cylinder", "radius_mm": size[0] / 2, "length_mm": size[1], "pose": pose})
        elif kind == "sphere":
            out.append({"kind": "sphere", "radius_mm": size[0] / 2, "pose": pose})
        else:
            name = f"stop_{number}.stl"
            trimesh.convex.convex_hull(rng.normal(size=(20, 3)) * np.array(size) / 4).export(folder / name)
            out.append({"kind": "mesh", "file": name, "unit": "mm", "pose": pose})
    return out


class _CoalReferee:
    """Distances [m] between moving bodies and the shapes of a fixed one, by coal."""

    def __init__(self, coal: Any, model: CellModel, riders: Collection[str], still: str) -> None:
        self.coal = coal
        poses = model.poses({})
        self.riders = [solid for solid in model.solids if solid.body in riders]
        self.initial_poses = [poses[solid.body][0] @ solid.shape.pose for solid in self.riders]
        self.still = [solid for solid in model.solids if solid.body == still]
        self.shapes = [coal_shape(coal, solid) for solid in self.riders]
        self.others = [coal_shape(coal, solid) for solid in self.still]
        self.request = coal.DistanceRequest()
        self.request.gjk_tolerance, self.request.gjk_max_iterations = 1e-10, 10_000

    def distances(self, displacement: FloatArray) -> FloatArray:
        """Return the distances (R, F) of all shapes.

        ``displacement`` (4, 4) moves the riders from the model's pose.
        """
        out = np.empty((len(self.riders), len(self.still)))
        for i, begin in enumerate(self.initial_poses):
            here = self._transform(displacement @ begin)
            for j, other in enumerate(self.still):
                there, result = self._transform(other.shape.pose), self.coal.DistanceResult()
                pair = self.shapes[i], here, self.others[j], there
                out[i, j] = self.coal.distance(*pair, self.request, result)
        return out

    def _transform(self, pose: FloatArray) -> Any:
        return self.coal.Transform3s(pose[:3, :3], pose[:3, 3])


@pytest.mark.parametrize("seed", range(12))
def test_the_way_of_a_base_is_coals(tmp_path: Path, seed: int) -> None:
    """One body has rails and all else, so nothing but the shapes says on what the base slides."""
    coal = pytest.importorskip("coal", reason="coal, the referee of distances, is not installed")
    rng = np.random.default_rng(seed)
    spin = float(rng.uniform(-180.0, 180.0))
    axis = [float(np.cos(np.deg2rad(spin))), float(np.sin(np.deg2rad(spin))), 0.0]
    rails = _rails(rng, spin)
    shapes = [*rails, *_random_obstacles(tmp_path, rng, spin)]
    made = track_job.problem(
        tmp_path, {**track_job.TRACK, "axis": axis}, obstacles=[{"name": "rail", "shapes": shapes}]
    )
    setup = made.with_stations({0: {"left": ENDS[0]}}).setups[0]
    assert setup.stock.place is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    arm = setup.cell.arm("left")
    assert arm.track is not None
    links = frozenset(frozenset((name, "rail")) for name in model.poses({}) if name.startswith("left/"))
    way = external_axis_motion.check_linear_motion(model, "left", ENDS, {"left": arm.home}, ENOUGH, links)
    truth = _CoalReferee(coal, model, ["left/base_link"], "rail")

    def gaps(value: float) -> FloatArray:
        goes = np.eye(4)
        goes[:3, 3] = (value - ENDS[0]) * np.array(axis)
        return truth.distances(goes)

    last, number = way.samples[-1].value, len(rails)
    found = np.array([gaps(value) for value in [*np.arange(ENDS[0], last, STEP_M), last]])
    stands, besides = found[:, :, :number], found[:, :, number:]
    assert way.min_distance <= besides.min() + ALLOWED
    if way.clear:
        assert last == pytest.approx(ENDS[1], abs=1e-12) and besides.min() > ENOUGH - ALLOWED
    else:
        assert besides[-1].min() < ENOUGH + ALLOWED
    # what was left out bears the base at the start and lets it slide
    assert abs(stands[0].min()) < external_axis_motion.MAX_SUPPORT_ABOVE_FOOT_M
    assert stands.min() > -external_axis_motion.MAX_SUPPORT_ABOVE_FOOT_M


AXIS = np.array([0.9, 0.0, 0.47])
"""A point of the positioner's tilt axis, which lies along y."""


def _posts(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return posts next to the cradle's ends, and up to two shapes of the same body around them."""
    out = list(positioner_job.POSTS["shapes"])
    for _ in range(int(rng.integers(0, 3))):
        size = rng.uniform(20.0, 120.0, 3)
        at = np.array([900.0, 0.0, 470.0]) + rng.uniform([-330.0, -330.0, -450.0], [330.0, 330.0, -200.0])
        rpy = rng.uniform(-180.0, 180.0, 3) if rng.random() < 0.5 else np.zeros(3)
        pose = {"xyz_mm": at.tolist(), "rpy_deg": rpy.tolist()}
        out.append({"kind": "box", "size_mm": size.tolist(), "pose": pose})
    return out


def _bracket(rng: np.random.Generator) -> list[dict[str, Any]]:
    """The cradle, and bars near its axis that end about where the posts begin."""
    out = list(positioner_job.CRADLE["shapes"])
    for _ in range(int(rng.integers(0, 3))):
        size = [float(rng.uniform(60.0, 300.0)), 20.0, float(rng.uniform(20.0, 60.0))]
        side = float(rng.choice([-1.0, 1.0])) * float(rng.uniform(215.0, 243.0))
        at = [900.0, side, 470.0 + float(rng.uniform(-40.0, 60.0))]
        out.append({"kind": "box", "size_mm": size, "pose": {"xyz_mm": at}})
    return out


@pytest.mark.parametrize("seed", range(12))
def test_the_way_of_a_tilt_is_coals(tmp_path: Path, seed: int) -> None:
    """What was left out was near at the start, and no tilt makes it nearer; all else is as near as told."""
    coal = pytest.importorskip("coal", reason="coal, the referee of distances, is not installed")
    rng = np.random.default_rng(seed)
    obstacles = [{"name": "cradle", "shapes": _bracket(rng)}, {"name": "posts", "shapes": _posts(rng)}]
    made = positioner_job.problem(tmp_path, obstacles=obstacles)
    setup, table = made.setups[0], made.cell.turntable
    assert setup.stock.place is not None and table is not None
    model = plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
    end = np.deg2rad(70.0)
    homes = {arm.name: arm.home for arm in setup.cell.arms}
    way = external_axis_motion.check_rotary_motion(model, TILT_AXIS, 0.0, (0.0, end), homes, ENOUGH)
    truth = _CoalReferee(coal, model, ["stock", "support", *table.tilted_bodies], "posts")

    def gaps(value: float) -> FloatArray:
        goes = np.eye(4)
        goes[:3, :3] = Rotation.from_euler("y", value).as_matrix()
        goes[:3, 3] = AXIS - goes[:3, :3] @ AXIS
        return truth.distances(goes)

    last = way.samples[-1].value
    found = np.array([gaps(value) for value in np.linspace(0.0, last, 71)])
    bears = (found[0] < external_axis_motion.MAX_STANDING_GAP_M) & (found.min(axis=0) > found[0] - 1e-5)
    assert bears.any()
    besides = found[:, ~bears]
    if way.clear:
        assert last == pytest.approx(end) and besides.min() > ENOUGH - ALLOWED
        assert way.min_distance <= besides.min() + ALLOWED
    elif way.pair == ("cradle", "posts"):
        assert found[-1].min() < ENOUGH + ALLOWED
