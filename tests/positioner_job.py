"""A small job of a block on a tilt-turn positioner.

It has poses over the near end of the block, and against the underside of its far end, which no turn alone
brings within reach.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

import planner
from planner.cell import plant
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import FloatArray, inverse, to_quaternion
from planner.pipeline import Outcome
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rules import external_axes
from tests import table_job
from tests.track_job import COLUMNS

TILT: dict[str, Any] = {
    "external_axis": 1,
    "centre_mm": [900, 0, 470],
    "axis": [0, 1, 0],
    "range_deg": [-20, 70],
    "speed_deg_s": 15,
    "acceleration_deg_s2": 30,
    "bracket": ["cradle"],
}
POSITIONER: dict[str, Any] = {
    "unit": "STN_1",
    "external_axis": 2,
    "centre_mm": [900, 0, 500],
    "range_deg": [-180, 180],
    "home_deg": 180,
    "speed_deg_s": 20,
    "acceleration_deg_s2": 40,
    "load_kg": 250,
    "plate": {"diameter_mm": 220, "height_mm": 20},
    "tilt": TILT,
}
CRADLE = {
    "name": "cradle",
    "shapes": [{"kind": "box", "size_mm": [100, 500, 40], "pose": {"xyz_mm": [900, 0, 440]}}],
}
POSTS = {
    "name": "posts",
    "shapes": [
        {"kind": "box", "size_mm": [100, 40, 490], "pose": {"xyz_mm": [900, y, 245]}} for y in (-272, 272)
    ],
}
STOCK: dict[str, Any] = {
    "size_mm": [400, 260, 50],
    "place": {"xyz_mm": [920, 10, 540], "rpy_deg": [0, 0, 10]},
    "support": [{"kind": "box", "size_mm": [200, 200, 40], "pose": {"xyz_mm": [0, 0, -20]}}],
}


def rows(up: bool) -> str:
    """Five poses in the block's frame: the ball's axis down above its near end, or up below its far end."""
    out = [COLUMNS]
    turn = to_quaternion(np.diag([1.0, 1.0, 1.0] if up else [1.0, -1.0, -1.0]))
    for k in range(5):
        x, y, z = 190.0 if up else -190.0, -40.0 + 20.0 * k, -40.0 if up else 90.0
        out.append(",".join(str(round(float(v), 9)) for v in (x, y, z, *turn, 50.0)) + ",move")
    return "\n".join(out) + "\n"


def problem(
    folder: Path,
    positioner: dict[str, Any] | None = POSITIONER,
    obstacles: Any = (CRADLE, POSTS),
    stock: dict[str, Any] = STOCK,
    arms: Any = (table_job.ARM,),
    controller: dict[str, str] | None = None,
    **changes: Any,
) -> planner.Problem:
    """Poses over the block's near end in operation ``a`` and below its far end in ``b``."""
    cell: dict[str, Any] = {"name": "positioner", "arms": list(arms), "obstacles": list(obstacles)}
    if controller:
        cell["controller"] = controller
    if positioner is not None:
        cell["positioner"] = positioner
    for name, up in (("a", False), ("b", True)):
        (folder / f"{name}.csv").write_text(rows(up))
    operations = [
        {"name": name, "process": "targets", "arms": ["left"], "file": f"{name}.csv", "frame": "stock"}
        for name in "ab"
    ]
    data = {"tandem": 1, "name": "tilted", "cell": cell, "stock": stock, "operations": operations, **changes}
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(data))
    return planner.load(path)


FOLDER = tempfile.TemporaryDirectory()
"""Where the files of the planned job lie as long as tests run."""


@functools.cache
def planned_job() -> Outcome:
    """The job, planned and proven."""
    return planner.plan(problem(Path(FOLDER.name)))


KRL_TILT: dict[str, Any] = {**TILT, "external_axis": 2, "axis": [0, -1, 0], "range_deg": [-70, 20]}
KRL_POSITIONER: dict[str, Any] = {**POSITIONER, "external_axis": 1, "tilt": KRL_TILT}
"""The same positioner, whose turn is E1 and whose tilt, of the other sense, is E2."""
KUKA: dict[str, Any] = {
    **table_job.ARM,
    "robot": "kr6_r900",
    "base": {"xyz_mm": [0, 0, 200], "rpy_deg": [0, 0, 10]},
}
"""A KUKA arm that stands askew to it."""


@functools.cache
def planned_krl_job(robot: str = "kr6_r900", **controller: str) -> Outcome:
    """The job for the KUKA arm, planned and proven; ``controller`` of its cell."""
    folder = Path(FOLDER.name) / "-".join(["krl", *controller.values()])
    folder.mkdir()
    arms = ({**KUKA, "robot": robot},)
    return planner.plan(problem(folder, KRL_POSITIONER, arms=arms, controller=controller))


def require_text_is_planned(
    out: Outcome, prover: Prover, turn: float, tilt_vector: FloatArray, tolerance_m: float
) -> None:
    """The text alone has the block, at the second station, where scipy's turns have it: by ``turn`` [deg]
    about the plate's middle, then by ``lean`` (3,) [rad] about the tilt axis, which passes 30 mm below it,
    ``off`` [m] at most; and the tool within a micrometre of the plan in both operations."""
    context = external_axes.with_text_stations(Context(prover.problem, prover.claims, out.programs))
    place, stated = context.stock_frames[1], prover.problem.stock.place
    assert place is not None and stated is not None
    about = Rotation.from_euler("z", turn, degrees=True).as_matrix()
    over = Rotation.from_rotvec(tilt_vector).as_matrix()
    middle, below = np.array([0.9, 0.0, 0.5]), np.array([0.9, 0.0, 0.47])
    turned = middle + about @ (stated[:3, 3] - middle)
    np.testing.assert_allclose(place[:3, :3], over @ about @ stated[:3, :3], atol=5e-8)
    np.testing.assert_allclose(place[:3, 3], below + over @ (turned - below), atol=tolerance_m)
    for index, setup in enumerate(out.problem.setups):
        made, planned_arm = out.plan.operations[index], setup.cell.arm("left")
        tcp = planned_arm.base @ forward_kinematics(planned_arm.data, made.q["left"]) @ planned_arm.tool.tcp
        seen = (inverse(np.asarray(context.stock_frames[index])) @ tcp)[:, :3, 3]
        assert np.linalg.norm(seen - made.targets.pose["left"][:, :3, 3], axis=1).max() < 1e-6
        nodes = context.spans.of_stage[context.motion.node_stage] == index
        text = context.motion.node_tcp["left"][nodes][:, :3, 3]
        assert np.linalg.norm(text[:, None] - tcp[1:, :3, 3], axis=2).min(axis=0).max() < 1e-6


def model() -> plant.CellModel:
    """The cell as the first setup of the planned job has it."""
    setup = planned_job().problem.setups[0]
    assert setup.stock.place is not None
    return plant.build_cell_model(setup.cell, setup.stock, setup.stock.place)
