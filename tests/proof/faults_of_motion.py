"""Faults in how motion is planned: freedoms, kinematics, frames, placement, clearance, time."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any, Final

import numpy as np

from planner.cell.bodies import ClearanceEasing
from planner.geometry.arrays import exp_twist
from tests.proof.planner_faults import Fault, fields, given, result


def _scaled(factor: float) -> Any:
    return lambda old: factor * old


def _twice(old: Any) -> Any:
    """Screws are applied once more."""

    def pose(targets: Any, arm: str, values: Any, rows: Any, *known: Any) -> Any:
        found = old(targets, arm, values, rows, *known)
        for j, freedom in enumerate(targets.freedoms):
            if arm in getattr(freedom, "axis", {}):
                found = found @ exp_twist(values[..., j, None] * freedom.axis[arm])
        return found

    return pose


def _turn_in_pose_frame(old: Any) -> Any:
    """Screws turn about the axes of the frame that the poses are in, and not about the tool's."""

    def pose(targets: Any, arm: str, values: Any, rows: Any, *known: Any) -> Any:
        found = targets.pose[arm][rows]
        for j, freedom in enumerate(targets.freedoms):
            if arm in getattr(freedom, "axis", {}):
                turn = exp_twist(values[..., j, None] * freedom.axis[arm])
                at = found[..., :3, 3].copy()
                found = turn @ found
                found[..., :3, 3] = at
        return found

    return pose


def _moved_pose(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    def move(pose: Any) -> Any:
        out = np.array(pose)
        out[..., :3, 3] += [x, y, z]
        return out

    return move


def _rotate_pose(axis: int, degrees: float) -> Any:
    twist = np.zeros(6)
    twist[axis] = np.deg2rad(degrees)
    return lambda pose: pose @ exp_twist(twist)


def _joint_off(joint: int, degrees: float) -> Any:
    def shift_joint(q: Any) -> Any:
        out = np.array(q)
        out[..., joint] += np.deg2rad(degrees)
        return out

    return shift_joint


def _link(name: str, more: float) -> Any:
    """Change a length of the arm by an amount [m] for the planner's solver."""
    return given(0, lambda opw: dataclasses.replace(opw, **{name: getattr(opw, name) + more}))


def _straight_way(old: Any) -> Any:
    return lambda scene, standing, arm, goal: (np.stack([scene.chains[arm].home, goal]), False)


def _all_eased(old: Any) -> Any:
    """Arms, block and obstacles may be as near as the links of one arm may, and 0.2 m nearer."""

    def eased(model: Any, settings: Any) -> Any:
        names = {solid.body for solid in model.solids}
        pairs = frozenset(map(frozenset, itertools.combinations(sorted(names), 2)))
        return model.with_easing(ClearanceEasing(pairs, 0.2))

    return eased


def _free(old: Any) -> Any:
    def free(*args: Any, **more: Any) -> Any:
        return np.ones_like(old(*args, **more))

    return free


def _plan_moved(change: Any) -> Any:
    return fields(operations=lambda ops: tuple(dataclasses.replace(op, **change(op)) for op in ops))


def _jump(op: Any) -> dict[str, Any]:
    q = {arm: np.array(rows) for arm, rows in op.q.items()}
    for rows in q.values():
        rows[len(rows) // 2] += np.deg2rad(0.5)
    return {"q": q}


def _other_axis(freedom: Any) -> Any:
    """The free turn is about the next axis of the tool."""
    axis = {arm: np.concatenate([np.roll(t[:3], 1), t[3:]]) for arm, t in freedom.axis.items()}
    return dataclasses.replace(freedom, axis=axis, lower=freedom.lower * 0 + 0.2)


FREEDOMS: Final = (
    Fault("spin_beyond_its_range", "posed", {"targets:Targets._pose": _twice}),
    Fault("spin_of_wrong_frame", "posed", {"targets:Targets._pose": _turn_in_pose_frame}),
    Fault("posed_axis_wrong", "posed", {"processes.poses.plan.job:_screw_freedom": result(_other_axis)}),
    Fault(
        "posed_range_wide",
        "posed",
        {
            "processes.poses.plan.job:_screw_freedom": fields(
                lower=lambda v: v * 0 + 1.0, upper=lambda v: v * 0 + 1.5
            )
        },
    ),
    Fault("posed_turned", "posed", {"processes.poses.plan.job:_parse_poses": result(_rotate_pose(0, 2.0))}),
    Fault(
        "posed_position_shifted",
        "posed",
        {"processes.poses.plan.job:_parse_poses": result(_moved_pose(x=0.001))},
    ),
    Fault(
        "posed_inch", "posed_two", {"processes.poses.plan.job:_parse_poses": result(_moved_pose(z=0.0254))}
    ),
    Fault(
        "posed_row_lost",
        "posed",
        {"processes.poses.plan.job:_read_rows": result(lambda rows: rows[:3] + rows[4:])},
    ),
)

KINEMATICS: Final = (
    Fault("opw_a1_off", "posed", {"motion.planning_scene:inverse_kinematics": _link("a1", 0.001)}),
    Fault(
        "opw_joint_offset", "flank", {"motion.planning_scene:inverse_kinematics": result(_joint_off(1, 0.1))}
    ),
    Fault(
        "opw_joint_offset_krl",
        "posed_krl",
        {"motion.planning_scene:inverse_kinematics": result(_joint_off(2, 0.1))},
    ),
    Fault(
        "kinematics_longer",
        "posed",
        {
            "motion.planning_scene:inverse_kinematics": _link("c3", 0.001),
            "cell.kinematics:link_frames": given(
                0,
                lambda robot: dataclasses.replace(
                    robot, form=dataclasses.replace(robot.opw, c3=robot.opw.c3 + 0.001)
                ),
            ),
        },
    ),
    Fault(
        "catalogue_opw_off",
        "posed",
        {"catalogue.robots:robot": fields(form=lambda form: dataclasses.replace(form, c2=form.c2 + 0.001))},
    ),
    Fault(
        "catalogue_offset_off",
        "ruled",
        {
            "catalogue.robots:robot": fields(
                form=lambda form: dataclasses.replace(form, offsets=form.offsets + np.deg2rad(0.1))
            )
        },
    ),
    Fault(
        "tool_off_in_motion", "posed", {"motion.planning_scene:Chain.of": fields(tcp=_moved_pose(z=0.001))}
    ),
)

HOMING: Final = (
    Fault("ways_unchecked", "behind", {"motion.homing:_plan_arm": _straight_way}),
    Fault("own_clearance_of_all", "behind", {"motion.self_clearance:with_counted_distances": _all_eased}),
)

TIME: Final = (
    Fault("clock_ten_times", "spif", {"motion.solve:solve": _plan_moved(lambda op: {"time": 0.1 * op.time})}),
    Fault(
        "clock_ten_times_wire",
        "elastic",
        {"motion.solve:solve": _plan_moved(lambda op: {"time": 0.1 * op.time})},
    ),
    Fault(
        "clock_tenth_wire", "ruled", {"motion.solve:solve": _plan_moved(lambda op: {"time": 10.0 * op.time})}
    ),
    Fault(
        "clock_in_minutes", "gcode", {"motion.solve:solve": _plan_moved(lambda op: {"time": op.time / 60.0})}
    ),
    Fault(
        "clock_krl_fast", "posed_krl", {"motion.solve:solve": _plan_moved(lambda op: {"time": 0.1 * op.time})}
    ),
    Fault(
        "clock_uneven",
        "ruled",
        {
            "motion.solve:solve": _plan_moved(
                lambda op: {"time": op.time[-1] * (np.arange(len(op.time)) / (len(op.time) - 1)) ** 1.5}
            )
        },
    ),
    Fault(
        "joint_speed_unbounded",
        "posed_fast",
        {
            "motion.operation:speed_limits": result(_scaled(100.0)),
            "motion.trajectory.timing:ClockLimits": given(1, _scaled(1e4)),
        },
    ),
    Fault(
        "acceleration_unbounded",
        "posed_fast",
        {"motion.trajectory.timing:ClockLimits": given(1, _scaled(1e4))},
    ),
    Fault("tcp_speed_lost", "elastic", {"motion.trajectory.timing:min_times": result(_scaled(0.05))}),
    Fault(
        "posed_too_fast", "posed_two", {"motion.solve:solve": _plan_moved(lambda op: {"time": 0.2 * op.time})}
    ),
)

FAULTS: Final = (*FREEDOMS, *KINEMATICS, *HOMING, *TIME)
