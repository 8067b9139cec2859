"""The motion of a plan as plain data, for programs that draw or animate it: `motion.json`.

Planes at the TCPs and of the blocks in the world [mm], joint angles by the joints' names [deg], times [s].
"""

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import END, STOCK, TILT, Arm, Problem, Setup
from planner.report import scene

FORMAT: Final = 1
"""Number of the file's form; one more when something of it goes."""
DIGITS: Final = 9
"""Decimals of lengths [mm], angles [deg] and unit vectors; times have six."""


def text(problem: Problem, plan: Plan) -> str:
    """The file.

    A plane is nine numbers: origin [mm], x axis, y axis. ``arms`` {name: robot, plane of its base, names and
    home of its joints}. Each of ``operations`` has ``start_s`` of its first target on the plan's clock, for
    all targets ``time_s`` from there, ``names`` and ``segments``, and by arm ``tcp``, ``joints_deg``,
    ``entry_deg`` and ``exit_deg``; ``block`` is the plane of the block's frame, or of a held one its holder
    and the plane in the holder's TCP; ``stations_mm`` are values of tracks by arm, and of the axes of
    gantries by arm and axis, as "arm/bridge", whose ``base`` is that of values 0, before the first target
    where they go along: ``track_mm`` by arm has those at all targets then;
    ``turntable_deg`` is that of a turntable, to which the block is turned, ``tilt_deg`` that of a
    positioner's tilt axis, by which it is tilted then. Joint angles are those of the arms' URDFs.
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
    for index, own in enumerate(plan.operations):
        setup = problem.setup_of(index)
        operations.append(_operation(own, setup, plan, start))
        start += float(own.time[-1] - own.time[0])
    data = {
        "motion": FORMAT,
        "name": plan.problem_name,
        "digest": plan.digest,
        "unit": {"length": "mm", "angle": "deg", "time": "s"},
        "arms": arms,
        "operations": operations,
    }
    for index, stands in plan.stations.items():
        turned = {STOCK: "turntable_deg", TILT: "tilt_deg"}
        arms_on = {
            arm: round(value / MM, DIGITS)
            for arm, value in stands.items()
            if arm not in turned and not arm.endswith(END)
        }
        operations[index] |= {"stations_mm": arms_on} if arms_on else {}
        shown = {word: round(stands[name] / DEG, DIGITS) for name, word in turned.items() if name in stands}
        operations[index] |= shown
    return json.dumps(data, separators=(",", ":")) + "\n"


def _operation(own: OperationPlan, setup: Setup, plan: Plan, start: float) -> dict[str, Any]:
    targets = own.targets
    return {
        "name": own.name,
        "start_s": round(start, 6),
        "time_s": np.round(own.time - own.time[0], 6).tolist(),
        "names": _names(own),
        "segments": [str(segment) for segment in targets.segment],
        "order": list(own.order),
        "together": list(own.together),
        "block": _block(setup, np.asarray(plan.places[setup.number - 1])),
        "arms": {
            name: _way(setup.cell.arm(name), q, own, scene.riding(setup, plan.bases, own))
            for name, q in own.q.items()
        },
    }


def _way(arm: Arm, q: FloatArray, own: OperationPlan, bases: Mapping[str, FloatArray]) -> dict[str, Any]:
    ride = own.targets.ride.get(arm.name)
    gone = {} if ride is None else {"track_mm": _rounded(ride / MM)}
    return {
        **gone,
        "tcp": _planes(scene.flange_poses(arm, bases, q) @ arm.tool.tcp),
        "joints_deg": _rounded(q / DEG),
        "entry_deg": _rounded(np.asarray(own.entry.get(arm.name, ())) / DEG),
        "exit_deg": _rounded(np.asarray(own.exit.get(arm.name, ())) / DEG),
    }


def _names(own: OperationPlan) -> list[str]:
    """Names of all targets, as :meth:`planner.targets.Targets.name` gives them one by one."""
    out: list[str] = []
    number, last = 0, None
    for segment in own.targets.segment:
        number = number + 1 if segment == last else 1
        last = segment
        out.append(f"{segment}/{number}")
    return out


def _block(setup: Setup, place: FloatArray) -> dict[str, Any]:
    if setup.stock.held_by is None:
        return {"plane": _planes(place)}
    return {"held_by": setup.stock.held_by, "in_tcp": _planes(np.asarray(setup.stock.grip))}


def _planes(pose: FloatArray) -> Any:
    """Planes (..., 9) of poses (..., 4, 4)."""
    return _rounded(np.concatenate([pose[..., :3, 3] / MM, pose[..., :3, 0], pose[..., :3, 1]], axis=-1))


def _rounded(values: FloatArray) -> Any:
    return (np.round(values, DIGITS) + 0.0).tolist()  # no -0.0
