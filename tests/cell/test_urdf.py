"""The URDF files on disk match the output of the script, and their solids are plausible."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import trimesh
import yaml

from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.cell.bodies import Solid, signed_distance
from planner.geometry.arrays import Shape, from_rpy, inverse, transform
from tests.cell.cells import BLOCK, alone

DISTANT_POSE = from_rpy((50.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _script(name: str) -> ModuleType:
    path = robots.data_dir("urdf") / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


MAKE, MEASURE = _script("make_urdf"), _script("measure_bodies")
EXTREMES = yaml.safe_load(Path(__file__).with_name("mesh_extremes.yaml").read_text(encoding="utf-8"))
"""Outermost points of makers' meshes, by arm and link."""


@pytest.mark.parametrize("name", robots.robot_names())
def test_files_are_what_the_script_writes(name: str) -> None:
    assert robots.urdf_path(name).read_text(encoding="utf-8") == MAKE.urdf(name)


def _solid(solid: object) -> Solid:
    turn = {"z": (0.0, 0.0, 0.0), "y": (np.pi / 2, 0.0, 0.0), "x": (0.0, np.pi / 2, 0.0)}[solid.axis]
    size = tuple(1e-3 * v for v in solid.size)
    return Solid("", Shape(solid.kind, size, from_rpy(1e-3 * np.array(solid.xyz), turn)))


def _outside(solids: list, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (P, 3) [mm] from the nearest solid [mm]; negative inside."""
    made = [_solid(solid) for solid in solids]
    each = [signed_distance(s, transform(inverse(s.shape.pose), 1e-3 * points)) for s in made]
    return 1e3 * np.min(each, axis=0)


@pytest.mark.parametrize("name", EXTREMES)
def test_bodies_hold_the_makers_meshes(name: str) -> None:
    """Points are rounded to whole millimetres."""
    bodies = MAKE.bodies(robots.robot(name))
    assert list(EXTREMES[name]) == list(bodies)
    for link, rows in EXTREMES[name].items():
        assert _outside(bodies[link], np.array(rows, dtype=np.float64)).max() < 0.5 * np.sqrt(3.0), link


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("seed", range(4))
def test_measured_solids_hold_the_mesh(seed: int) -> None:
    """An upper arm of a round motor and a beam, turned to another side each time."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(40.0, 90.0, 3)
    motor = trimesh.creation.cylinder(radius=size[0], height=3.0 * size[1])
    beam = trimesh.creation.box((0.5 * size[1], 8.0 * size[2], 0.6 * size[0]))
    beam.apply_translation((0.9 * size[1], 4.0 * size[2], 0.0))
    whole = trimesh.util.concatenate([motor, beam])
    whole.vertices = np.roll(whole.vertices, seed, axis=1)
    found = MEASURE.solids(whole.triangles)
    points = trimesh.sample.sample_surface(whole, 3000, seed=seed)[0]
    made = [MAKE._solid([kind, extent, centre], 1) for kind, extent, centre in found]
    assert _outside(made, points).max() < 1e-6
    box = np.prod(np.ptp(whole.vertices, axis=0))
    volumes = [np.prod(size) if kind == "box" else np.pi * size[0] ** 2 * size[1] for kind, size, _ in found]
    assert sum(volumes) < 0.6 * box


def test_stretched_bodies_reach_as_far_as_the_arm() -> None:
    """An arm with the bodies of another one: the same round the joints, as much longer as its links are."""
    short, long = (MAKE.bodies(robots.robot(name)) for name in ("irb6700_235", "irb6700_205"))

    def ends(bodies: dict, link: str) -> tuple[float, float]:
        rows = [
            (s.xyz[2], 0.0 if s.kind == "cylinder" and s.axis != "z" else s.size[-1]) for s in bodies[link]
        ]
        return min(z - 0.5 * h for z, h in rows), max(z + 0.5 * h for z, h in rows)

    assert long["link_3"] == short["link_3"]
    (low, high), (same, higher) = ends(short, "link_2"), ends(long, "link_2")
    assert low == same < 0.0
    assert higher == pytest.approx(high * 1.28 / 1.135)
    assert ends(long, "link_4") == pytest.approx(ends(short, "link_4"))  # forearms of one length


@pytest.mark.parametrize("name", robots.robot_names())
def test_a_robot_is_clear_of_itself_at_home_and_in_most_postures(name: str) -> None:
    robot = robots.robot(name)
    model = plant.build_cell_model(alone(name), BLOCK, DISTANT_POSE)
    assert clearance.is_free(model, {}, 0.010).all()
    q = np.random.default_rng(2).uniform(robot.lower, robot.upper, (400, 6))
    fraction = clearance.is_free(model, {"arm": q}, 0.0)[robot.limit_margin(q) > 0.0].mean()
    assert fraction > 0.6


@pytest.mark.parametrize("name", EXTREMES)
def test_a_robot_folded_into_its_foot_is_seen(name: str) -> None:
    """The 300 mm ball tool inside the base's solids."""
    robot = robots.robot(name)
    model = plant.build_cell_model(alone(name), BLOCK, DISTANT_POSE)
    q = np.random.default_rng(3).uniform(robot.lower, robot.upper, (4000, 6))
    tip = model.tcp({"arm": q})["arm"][:, :3, 3]
    inside = _outside(MAKE.bodies(robot)["base_link"], 1e3 * tip) < 0.0
    if inside.any():
        assert not clearance.is_free(model, {"arm": q[inside]}, 0.0).any()


BALANCED = """<robot name="arm">
  <link name="base_link"/><link name="link_1"/><link name="link_2"/>
  <link name="cylinder">
    <collision><origin xyz="0 0 0.1"/><geometry><mesh filename="bar.stl"/></geometry></collision>
  </link>
  <joint name="one" type="revolute">
    <parent link="base_link"/><child link="link_1"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="two" type="revolute">
    <parent link="link_1"/><child link="link_2"/><origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="three" type="continuous">
    <parent link="link_2"/><child link="cylinder"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
    <mimic joint="two" multiplier="-1"/>
  </joint>
</robot>"""


def test_a_balancer_is_where_joint_2_takes_it(tmp_path: Path) -> None:
    """A bar above a hinge on link 2 that turns back by as much: it stays upright, on an arc of 300 mm."""
    trimesh.creation.box((0.02, 0.04, 0.06)).export(tmp_path / "bar.stl")
    (tmp_path / "arm.urdf").write_text(BALANCED, encoding="utf-8")
    chain = SimpleNamespace(joints=("one", "two"), lower=np.array([-1.0, -0.5]), upper=np.array([1.0, 1.0]))
    spec = SimpleNamespace(meshes=())
    found = MEASURE._balancers(chain, spec, tmp_path / "arm.urdf", np.eye(4))
    assert len(found) == MEASURE.SWEPT
    for triangles, q in zip(found, np.linspace(-0.5, 1.0, MEASURE.SWEPT), strict=True):
        middle = 0.5 * (triangles.min(axis=(0, 1)) + triangles.max(axis=(0, 1)))
        assert middle == pytest.approx([200.0 + 300.0 * np.sin(q), 0.0, 600.0 + 300.0 * np.cos(q)], abs=1e-4)
        assert np.ptp(triangles.reshape(-1, 3), axis=0) == pytest.approx([20.0, 40.0, 60.0], abs=1e-4)
