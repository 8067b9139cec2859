"""The way of a track's base over random rails and past random bodies, against plain trials by coal
(https://github.com/coal-library/coal)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from planner.cell import axis_way, plant
from planner.cell.bodies import Solid
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray
from tests import track_job
from tests.cell.test_distance import coal_shape

ENOUGH = 0.01
ENDS = (-0.5, 0.6)
STEP_M = 4e-3
ALLOWED = 1e-6
"""Distances are within this of the truth [m]."""


def _turned(at: FloatArray, spin: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
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
                out.append({"kind": "box", "size_mm": [4000, 40, high], "pose": _turned(at, spin)})
            continue
        radius = float(rng.uniform(10.0, 60.0))
        lying = _turned(np.array([0.0, side, top - radius]), spin, (0.0, 90.0, 0.0))
        out.append({"kind": kind, "radius_mm": radius, "length_mm": 6000, "pose": lying})
    return out


def _others(folder: Path, rng: np.random.Generator, spin: float) -> list[dict[str, Any]]:
    """Bodies ahead of the base and beside its way, some in it, all higher than its foot."""
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
        kind, pose = str(rng.choice(["box", "cylinder", "sphere", "mesh"])), _turned(at, spin, rpy)
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


class _Coal:
    """Distances [m] of a base to shapes of the body "rail", by coal."""

    def __init__(self, coal: Any, model: CellModel) -> None:
        self.coal = coal
        self.base = [solid for solid in model.solids if solid.body == "left/base_link"]
        self.rail = [solid for solid in model.solids if solid.body == "rail"]
        self.shapes = {id(solid): coal_shape(coal, solid) for solid in (*self.base, *self.rail)}
        self.request = coal.DistanceRequest()
        self.request.gjk_tolerance, self.request.gjk_max_iterations = 1e-10, 10_000

    def _one(self, own: Solid, at: FloatArray, other: Solid) -> float:
        places = (
            self.coal.Transform3s(pose[:3, :3], pose[:3, 3])
            for pose in (at @ own.shape.pose, other.shape.pose)
        )
        here, there = places
        shapes = self.shapes[id(own)], self.shapes[id(other)]
        return float(
            self.coal.distance(shapes[0], here, shapes[1], there, self.request, self.coal.DistanceResult())
        )

    def least(self, at: FloatArray, of: slice) -> float:
        """The least one with the base at ``at`` (4, 4) to some of the shapes."""
        return min(
            (self._one(own, at, other) for own in self.base for other in self.rail[of]), default=np.inf
        )


@pytest.mark.parametrize("seed", range(12))
def test_the_way_of_a_base_is_coals(tmp_path: Path, seed: int) -> None:
    """One body has rails and all else, so nothing but the shapes says on what the base slides."""
    coal = pytest.importorskip("coal", reason="coal, the referee of distances, is not installed")
    rng = np.random.default_rng(seed)
    spin = float(rng.uniform(-180.0, 180.0))
    axis = [float(np.cos(np.deg2rad(spin))), float(np.sin(np.deg2rad(spin))), 0.0]
    rails = _rails(rng, spin)
    shapes = [*rails, *_others(tmp_path, rng, spin)]
    made = track_job.problem(
        tmp_path, {**track_job.TRACK, "axis": axis}, obstacles=[{"name": "rail", "shapes": shapes}]
    )
    setup = made.stationed({0: {"left": ENDS[0]}}).setups[0]
    assert setup.stock.place is not None
    model = plant.build(setup.cell, setup.stock, setup.stock.place)
    arm = setup.cell.arm("left")
    assert arm.track is not None
    links = frozenset(frozenset((name, "rail")) for name in model.poses({}) if name.startswith("left/"))
    way = axis_way.along(model, "left", arm.track.axis, ENDS, {"left": arm.home}, ENOUGH, links)
    truth, base = _Coal(coal, model), made.cell.arms[0].base
    stands, besides = slice(len(rails)), slice(len(rails), None)

    def least(value: float, of: slice) -> float:
        return truth.least(arm.track.moved(base, value), of)

    last = way.looked[-1].value
    tried = np.arange(ENDS[0], last, STEP_M)
    gaps = [least(value, besides) for value in tried]
    assert way.least <= min(gaps, default=np.inf) + ALLOWED
    assert least(last, besides) < ENOUGH + ALLOWED if not way.clear else min(gaps) > ENOUGH - ALLOWED
    assert not way.clear or last == pytest.approx(ENDS[1], abs=1e-12)
    # what was left out bears the base at the start and lets it slide
    assert abs(least(ENDS[0], stands)) < axis_way.SUNK_M
    assert all(least(value, stands) > -axis_way.SUNK_M for value in tried[::10])
