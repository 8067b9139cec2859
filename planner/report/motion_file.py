"""Motion of a plan as plain data, for programs that draw or animate it: `motion.json`.

Planes of TCPs and blocks in the world [mm], joint angles by joint name [deg], times [s].
"""

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import END_SUFFIX, STOCK_AXIS, TILT_AXIS, Arm, Problem, Setup
from planner.report import scene

FORMAT_VERSION: Final = 1
"""Version of the format. It is increased when something is removed."""
DIGITS: Final = 9
"""Decimals of lengths [mm], angles [deg] and unit vectors. Times have six."""


def motion_json(problem: Problem, plan: Plan) -> str:
    """Return the content of `motion.json`.

    A plane is nine numbers: origin [mm], x axis, y axis. Joint angles are those of the arms' URDFs.

    - ``arms`` {name: robot, plane of its base, names and home of its joints}.
    - ``operations``: each has ``start_s`` of its first target on the clock of the plan; for all targets
      ``time_s`` from there, ``names`` and ``segments``; ``order`` of the arms in the approach, and
      ``together``: which of approach ("entry") and retreat ("exit") all arms do at once; and by arm
      ``tcp``, ``joints_deg``, ``entry_deg`` and ``exit_deg``.
    - ``block``: plane of the block's frame, or for a held block its holder and the plane in the holder's
      TCP.
    - ``stations_mm``: values of tracks by arm, and of gantry axes by arm and axis, as "arm/bridge".
      ``base`` is that of values 0. For a coordinated track it is the value before the first target, and
      ``track_mm`` by arm has the values at all targets.
    - ``turntable_deg``: angle of a turntable to which the block is rotated.
    - ``tilt_deg``: angle of a positioner's tilt axis, by which the block is tilted.

    Args:
        problem: Problem.
        plan: Plan.
    """
    arms = {
        arm.name: {
            "robot": arm.robot,
            "base": _planes(np.asarray(plan.bases.get(arm.name, arm.base))),
            "joints": list(arm.data.joints),
            "home_deg": _rounded(np.asarray(arm.home) / DEG),
        }
        for arm in problem.cell.arms
    }
    operations, start = [], 0.0
    for index, operation in enumerate(plan.operations):
        setup = problem.setup_of(index)
        operations.append(_operation(operation, setup, plan, start))
        start += float(operation.time[-1] - operation.time[0])
    data = {
        "motion": FORMAT_VERSION,
        "name": plan.problem_name,
        "digest": plan.digest,
        "unit": {"length": "mm", "angle": "deg", "time": "s"},
        "arms": arms,
        "operations": operations,
    }
    for index, axis_values in plan.stations.items():
        table_keys = {STOCK_AXIS: "turntable_deg", TILT_AXIS: "tilt_deg"}
        stations_mm = {
            name: round(value / MM, DIGITS)
            for name, value in axis_values.items()
            if name not in table_keys and not name.endswith(END_SUFFIX)
        }
        if stations_mm:
            operations[index]["stations_mm"] = stations_mm
        operations[index] |= {
            key: round(axis_values[name] / DEG, DIGITS)
            for name, key in table_keys.items()
            if name in axis_values
        }
    return json.dumps(data, separators=(",", ":")) + "\n"


def _operation(operation: OperationPlan, setup: Setup, plan: Plan, start: float) -> dict[str, Any]:
    """Return the entry of one operation, whose first target is at ``start`` [s] on the clock of the plan."""
    targets = operation.targets
    return {
        "name": operation.name,
        "start_s": round(start, 6),
        "time_s": np.round(operation.time - operation.time[0], 6).tolist(),
        "names": _target_names(operation),
        "segments": [str(segment) for segment in targets.segment],
        "order": list(operation.arm_order),
        "together": list(operation.synchronised),
        "block": _block_plane(setup, np.asarray(plan.stock_poses[setup.number - 1])),
        "arms": {
            name: _arm_motion(
                setup.cell.arm(name), q, operation, scene.bases_at_targets(setup, plan.bases, operation)
            )
            for name, q in operation.q.items()
        },
    }


def _arm_motion(
    arm: Arm, q: FloatArray, operation: OperationPlan, bases: Mapping[str, FloatArray]
) -> dict[str, Any]:
    """Return the motion of one arm in an operation, from its serial joint angles (N, J) at the targets."""
    track_positions = operation.targets.track_positions.get(arm.name)
    track_fields = {} if track_positions is None else {"track_mm": _rounded(track_positions / MM)}
    return {
        **track_fields,
        "tcp": _planes(scene.flange_poses(arm, bases, q) @ arm.tool.tcp),
        "joints_deg": _rounded(q / DEG),
        "entry_deg": _rounded(np.asarray(operation.approach.get(arm.name, ())) / DEG),
        "exit_deg": _rounded(np.asarray(operation.retreat.get(arm.name, ())) / DEG),
    }


def _target_names(operation: OperationPlan) -> list[str]:
    """Return the names of all targets in one pass, equal to those of :meth:`planner.targets.Targets.name`."""
    out: list[str] = []
    number, previous = 0, None
    for segment in operation.targets.segment:
        number = number + 1 if segment == previous else 1
        previous = segment
        out.append(f"{segment}/{number}")
    return out


def _block_plane(setup: Setup, stock_pose: FloatArray) -> dict[str, Any]:
    """Return the plane of the block in the world, or its holder with the plane in the holder's TCP."""
    if setup.stock.held_by is None:
        return {"plane": _planes(stock_pose)}
    return {"held_by": setup.stock.held_by, "in_tcp": _planes(np.asarray(setup.stock.grip))}


def _planes(pose: FloatArray) -> Any:
    """Return planes (..., 9) of poses (..., 4, 4) as nested lists: origin [mm], x axis and y axis."""
    return _rounded(np.concatenate([pose[..., :3, 3] / MM, pose[..., :3, 0], pose[..., :3, 1]], axis=-1))


def _rounded(values: FloatArray) -> Any:
    return (np.round(values, DIGITS) + 0.0).tolist()  # no -0.0
