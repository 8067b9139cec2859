"""Faults in the writing of programs: units, frames, quaternions, rounding, order, arms, zones, signals."""

from __future__ import annotations

import dataclasses
import re
from typing import Any, Final

import numpy as np

from planner.languages.writing.handshake import AskOperator, AwaitLine, AwaitRunning, SetLine, StopAndAsk
from tests.proof.planner_faults import Fault, always, change_fields, fields, given, result

_STATION = "languages.writing.steps:external_axis_values"
"""Values of external axes in a setup, as programs have them."""


def _scaled(factor: float) -> Any:
    return lambda old: factor * old


def _positions(change: Any) -> Any:
    """Positions [mm] of the arms as they are written."""
    return result(lambda written: {arm: (change(p), q) for arm, (p, q) in written.items()})


def _quaternions(change: Any) -> Any:
    return result(lambda written: {arm: (p, change(q)) for arm, (p, q) in written.items()})


def _every_second(rows: Any) -> Any:
    return np.unique(np.append(rows[1::2], rows[-1]))


def _one_lost(rows: Any) -> Any:
    return np.delete(rows, len(rows) // 2)


def _swapped(written: Any) -> Any:
    a, b = written
    return {a: written[b], b: written[a]}


def _actions(change: Any) -> Any:
    return given(1, change)


def _lines(pattern: str, new: str, count: int = 0) -> Any:
    """The text of each program that is written, changed."""
    return result(lambda made: {name: re.sub(pattern, new, text, count=count) for name, text in made.items()})


def _no_wait(steps: Any) -> Any:
    return [step for step in steps if not isinstance(step, AwaitLine)]


def _set_twice(steps: Any) -> Any:
    return [SetLine(1 - step.value) if isinstance(step, SetLine) else step for step in steps]


def _turned_back(angles: Any) -> Any:
    return angles[..., ::-1]


def _moved(x: float = 0.0, z: float = 0.0) -> Any:
    """A pose (4, 4) moved in the frame that it is in [m]."""

    def move(pose: Any) -> Any:
        out = np.array(pose)
        out[:3, 3] += [x, 0.0, z]
        return out

    return move


def _tool(tcp: Any) -> Any:
    return lambda tool: change_fields(tool, tcp=tcp)


def _ids_off(old: Any) -> Any:
    """One task counts its moves from 2."""

    def moves(task: Any, job: Any, zone: Any) -> Any:
        made = old(task, job, zone)
        if task.number == 1:
            return made
        return [
            [re.sub(r"ID:=(\d+)", lambda m: f"ID:={int(m[1]) + 1}", line) for line in some] for some in made
        ]

    return moves


def _no_look(steps: Any) -> Any:
    return [step for step in steps if not isinstance(step, AwaitRunning)]


def _goes_on(steps: Any) -> Any:
    """The lead asks without stopping."""
    return [AskOperator(step.text) if isinstance(step, StopAndAsk) else step for step in steps]


def _every_other_call(old: Any) -> Any:
    return lambda partner, number: old(partner, number) if number % 2 or partner.lead else ""


def _first_alone(old: Any) -> Any:
    """Do not wait for the other arm at home or at its first target."""

    def meet(self: Any, reached: str, *more: Any) -> None:
        if "first target" not in reached and "at home" not in reached:
            old(self, reached, *more)

    return meet


def _inverted(lines: Any) -> Any:
    swap = {",0;": ",1;", ",1;": ",0;"}
    return [s[:-3] + swap[s[-3:]] if s.startswith("SetDO") else s for s in lines]


def _slack_off(plan: Any) -> Any:
    """Write a split of the slack that is 2 cm off the planned one."""
    values = plan.values.copy()
    values[:, 0] += 0.02
    return dataclasses.replace(plan, values=values)


def _other_names(partner: Any) -> Any:
    """Each program sets and reads the lines of the other one."""
    return partner and dataclasses.replace(partner, arm=partner.other, other=partner.arm)


def _first_off(station: Any) -> Any:
    """The first external axis is a millimetre farther."""
    return station and ((station[0][0], station[0][1] + 1.0), *station[1:])


def _values_swapped(station: Any) -> Any:
    """Two external axes have each other's values."""
    return station and ((station[0][0], station[1][1]), (station[1][0], station[0][1]))


def _in_metres(station: Any) -> Any:
    return station and tuple((column, round(1e-3 * value, 4)) for column, value in station)


def _other_columns(along: Any) -> Any:
    """Directions of two external axes, each as that of the other."""
    return dict(zip(along, reversed(along.values()), strict=True))


RAPID: Final = (
    Fault("post_metres", "posed", {"languages.writing.steps:_written_poses": _positions(_scaled(1e-3))}),
    Fault("post_rounded_to_mm", "posed", {"languages.writing.steps:_written_poses": _positions(np.round)}),
    Fault("post_rounded_wing", "wing", {"languages.writing.steps:_written_poses": _positions(np.round)}),
    Fault("post_rounded_dish", "dsif", {"languages.writing.steps:_written_poses": _positions(np.round)}),
    Fault(
        "post_quaternion_last",
        "posed",
        {"languages.writing.steps:_written_poses": _quaternions(lambda q: np.roll(q, -1, axis=1))},
    ),
    Fault(
        "post_quaternion_conjugate",
        "flank",
        {"languages.writing.steps:_written_poses": _quaternions(lambda q: q * [1, -1, -1, -1])},
    ),
    Fault(
        "post_mirrored",
        "ruled",
        {"languages.writing.steps:_written_poses": _positions(lambda p: p * [1.0, -1.0, 1.0])},
    ),
    Fault(
        "post_axes_swapped",
        "oval",
        {"languages.writing.steps:_written_poses": _positions(lambda p: p[:, [1, 0, 2]])},
    ),
    Fault("post_arms_swapped", "dsif", {"languages.writing.steps:_written_poses": result(_swapped)}),
    Fault("post_arms_swapped_wire", "elastic", {"languages.writing.steps:_written_poses": result(_swapped)}),
    Fault(
        "post_spin_lost",
        "posed",
        {
            "languages.writing.steps:_written_poses": given(
                0, lambda plan: change_fields(plan, values=_scaled(0.0))
            )
        },
    ),
    Fault(
        "post_slide_lost",
        "held",
        {
            "languages.writing.steps:_written_poses": given(
                0, lambda plan: change_fields(plan, values=_scaled(0.0))
            )
        },
    ),
    Fault(
        "post_spin_twice",
        "posed",
        {
            "languages.writing.steps:_written_poses": given(
                0, lambda plan: change_fields(plan, values=_scaled(2.0))
            )
        },
    ),
    Fault(
        "post_tilt_twice",
        "dsif",
        {
            "languages.writing.steps:_written_poses": given(
                0, lambda plan: change_fields(plan, values=_scaled(2.0))
            )
        },
    ),
    Fault("post_slack_off", "elastic", {"languages.writing.steps:_written_poses": given(0, _slack_off)}),
    Fault("gantry_value_off", "gantry", {_STATION: result(_first_off)}),
    Fault("gantry_values_swapped", "gantry", {_STATION: result(_values_swapped)}),
    Fault("gantry_values_swapped_krl", "gantry_krl", {_STATION: result(_values_swapped)}),
    Fault("gantry_in_metres", "gantry", {_STATION: result(_in_metres)}),
    Fault("gantry_order_reversed", "gantry", {"problem:motion_order": result(lambda names: names[::-1])}),
    Fault(
        "gantry_unit_off",
        "gantry",
        {"languages.rapid.writer.program:identifier": given(0, lambda u: f"{u}_2")},
    ),
    Fault(
        "gantry_look_swapped",
        "gantry_krl",
        {"languages.krl.writer.syntax:robroot_check": given(2, _other_columns)},
    ),
    Fault("post_every_second", "posed", {"languages.writing.steps:_moved_targets": result(_every_second)}),
    Fault("post_every_second_cut", "wing", {"languages.writing.steps:_moved_targets": result(_every_second)}),
    Fault("post_target_lost", "posed", {"languages.writing.steps:_moved_targets": result(_one_lost)}),
    Fault("post_times_halved", "ruled", {"languages.writing.steps:_durations": result(_scaled(0.5))}),
    Fault("post_times_doubled", "elastic", {"languages.writing.steps:_durations": result(_scaled(3.0))}),
    Fault(
        "post_stops_lost",
        "plate",
        {
            "languages.writing.steps:_stops": result(
                lambda s: np.append(np.zeros(len(s) - 1, dtype=bool), True)
            )
        },
    ),
    Fault(
        "post_work_object_world",
        "spif",
        {"languages.rapid.writer.data:wobj_name": given(0, lambda f: "world")},
    ),
    Fault(
        "post_place_moved",
        "flank",
        {
            "languages.rapid.writer.data:_wobj_declarations": given(
                2, lambda plan: change_fields(plan, stock_poses=lambda ps: tuple(map(_moved(x=0.005), ps)))
            )
        },
    ),
    Fault(
        "post_held_frame_lost",
        "held",
        {
            "languages.rapid.writer.data:_held_wobjdata": given(
                1,
                lambda op: change_fields(
                    op,
                    arm=lambda a: change_fields(a, tool=lambda t: change_fields(t, tcp=lambda p: np.eye(4))),
                ),
            )
        },
    ),
    Fault(
        "post_tool_length",
        "posed",
        {"languages.rapid.writer.data:_tooldata": given(0, lambda t: change_fields(t, tcp=_moved(z=0.001)))},
    ),
    Fault(
        "post_tool_turned",
        "ruled",
        {
            "languages.rapid.writer.data:_tooldata": given(
                0, lambda t: change_fields(t, tcp=lambda p: p @ np.diag([-1.0, -1.0, 1.0, 1.0]))
            )
        },
    ),
    Fault(
        "post_tool_weightless",
        "ruled",
        {"languages.rapid.writer.data:_tooldata": given(0, lambda t: change_fields(t, mass=_scaled(0.1)))},
    ),
    Fault(
        "post_base_frame_off",
        "elastic",
        {
            "languages.writing.steps:build_job": result(
                lambda job: change_fields(
                    job, tasks=lambda ts: tuple(change_fields(t, base=_moved(x=0.01)) for t in ts)
                )
            )
        },
    ),
    Fault("post_confdata_zero", "ruled", {"languages.rapid.writer.syntax:confdata": result(_scaled(0))}),
    Fault(
        "post_zones_large",
        "spif",
        {
            "languages.rapid.writer.syntax:zones": lambda old: (
                lambda track, stop: np.where(stop, "fine", "z10")
            )
        },
    ),
    Fault(
        "post_zones_none_fine",
        "plate",
        {
            "languages.rapid.writer.syntax:zones": lambda old: (
                lambda track, stop: np.where(old(track, stop) == "fine", "z10", old(track, stop))
            )
        },
    ),
    Fault(
        "post_corners_wide",
        "flank_rough",
        {"geometry.corner_rounding:max_zones": result(lambda r: tuple(8.0 * v for v in r))},
    ),
    Fault(
        "post_joints_degrees", "posed", {"languages.rapid.writer.syntax:jointtarget": given(0, np.deg2rad)}
    ),
    Fault(
        "post_waits_ms",
        "ruled",
        {
            "languages.rapid.writer.syntax:action_lines": given(
                0, lambda a: change_fields(a, seconds=_scaled(1e-3))
            )
        },
    ),
    Fault(
        "post_signal_inverted", "elastic", {"languages.rapid.writer.syntax:action_lines": result(_inverted)}
    ),
    Fault("post_question_lost", "elastic", {"languages.rapid.writer.syntax:message_box": always([])}),
    Fault("post_meeting_lost", "posed_two", {"languages.writing.steps:_JobBuilder._meet": _first_alone}),
    Fault("post_ids_off", "posed_two", {"languages.rapid.writer.program:_moves": _ids_off}),
    Fault("post_load_moved", "held", {"languages.writing.steps:_held_load": fields(cog=lambda c: c + 0.1)}),
)

HANDSHAKE: Final = (
    Fault(
        "handshake_no_wait",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.meeting": result(_no_wait)},
    ),
    Fault(
        "handshake_levels_inverted",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.meeting": result(_set_twice)},
    ),
    Fault(
        "handshake_both_lead",
        "handshake",
        {
            "languages.writing.handshake:HandshakeSide.of": result(
                lambda p: None if p is None else change_fields(p, lead=lambda v: True)
            )
        },
    ),
    Fault(
        "handshake_wires_swapped",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.of": result(_other_names)},
    ),
    Fault(
        "handshake_fewer_meetings",
        "dsif_handshake",
        {"languages.writing.handshake:meeting_rows": given(1, lambda every: 10 * every)},
    ),
    Fault(
        "running_not_looked_at",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.meeting": result(_no_look)},
    ),
    Fault(
        "running_not_seen_at_0",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.start_steps": result(_no_look)},
    ),
    Fault(
        "running_lead_goes_on",
        "handshake",
        {"languages.writing.handshake:HandshakeSide.start_steps": result(_goes_on)},
    ),
    Fault(
        "handshake_meetings_lost",
        "handshake",
        {"languages.rapid.writer.program:partner_call": _every_other_call},
    ),
    Fault(
        "handshake_not_stretched",
        "dsif_handshake",
        {"languages.writing.handshake:lengthen_for_stops": lambda old: lambda duration, *more: duration},
    ),
)

URSCRIPT: Final = (
    Fault(
        "ur_no_wait",
        "handshake_ur",
        {
            "languages.urscript.writer.program:watched_meeting": result(
                lambda both: tuple(map(_no_wait, both))
            )
        },
    ),
    Fault(
        "ur_never_watches",
        "handshake_ur",
        {"languages.urscript.writer.program:_ProgramWriter._watch": lambda old: lambda *a: []},
    ),
    Fault(
        "ur_watches_the_line",
        "handshake_ur",
        {"languages.urscript.writer.syntax:watch_thread": given(0, lambda number: number - 1)},
    ),
    Fault(
        "ur_other_input",
        "handshake_ur",
        {"languages.urscript.writer.syntax:wait_function": given(1, lambda number: number + 4)},
    ),
)

KRL: Final = (
    Fault("krl_a_for_c", "posed_krl", {"languages.krl.writer.syntax:abc": result(_turned_back)}),
    Fault("krl_radians", "posed_krl", {"languages.krl.writer.syntax:abc": result(np.deg2rad)}),
    Fault(
        "krl_base_world",
        "gcode_krl",
        {"languages.krl.writer.data:TaskDeclarations.base_pose": result(lambda r: (np.eye(4), r[1]))},
    ),
    Fault(
        "krl_base_inverse",
        "gcode_krl",
        {
            "languages.krl.writer.data:TaskDeclarations.base_pose": result(
                lambda r: (np.linalg.inv(r[0]), r[1])
            )
        },
    ),
    Fault("krl_status", "posed_krl", {"languages.krl.writer.data:status": result(lambda s: s ^ 2)}),
    Fault("krl_turn", "posed_krl", {"languages.krl.writer.data:turn": result(lambda t: t ^ 2)}),
    Fault("krl_speed_mm", "posed_krl", {"languages.krl.writer.syntax:krl_moves": fields(speed=_scaled(1e3))}),
    Fault(
        "krl_speed_tenth", "gcode_krl", {"languages.krl.writer.syntax:krl_moves": fields(speed=_scaled(10.0))}
    ),
    Fault(
        "krl_corners_wide",
        "gcode_krl",
        {"languages.krl.writer.syntax:_corners": result(lambda c: (10.0 * c[0] + 5.0, c[1]))},
    ),
    Fault(
        "krl_tool_off",
        "posed_krl",
        {
            "languages.krl.writer.data:TaskDeclarations.tool": given(
                1, lambda t: change_fields(t, tcp=_moved(z=0.001))
            )
        },
    ),
    Fault("krl_joints_off", "posed_krl", {"languages.krl.writer.syntax:e6axis": given(0, lambda d: d + 1.0)}),
    Fault(
        "krl_positions_metres",
        "gcode_krl",
        {"languages.writing.steps:_written_poses": _positions(_scaled(1e-3))},
    ),
    Fault("krl_rounded", "gcode_krl", {"languages.writing.steps:_written_poses": _positions(np.round)}),
    Fault(
        "krl_spindle_other_output",
        "gcode_krl",
        {"problem:Controller.signal_number": result(lambda n: n and n + 1)},
    ),
    Fault("krl_ptp_fast", "posed_krl", {"languages.krl.writer.program:ptp_percent": always(100)}),
    Fault(
        "krl_wait_ms",
        "gcode_krl",
        {
            "languages.krl.writer.program:MainProgram._action": given(
                1, lambda a: change_fields(a, seconds=_scaled(1e-3))
            )
        },
    ),
    Fault("krl_nobody_asked", "posed_krl", {"languages.krl.writer.syntax:question_lines": always([])}),
    Fault(
        "krl_asked_by_halt",
        "gcode_krl",
        {"languages.krl.writer.syntax:question_lines": given(1, lambda dialect: "krc2")},
    ),
    Fault(
        "krl_told_in_comments",
        "gcode_krl",
        {"languages.krl.writer.syntax:message_lines": given(1, lambda dialect: "krc2")},
    ),
    Fault("krl_foot_not_looked_at", "posed_krl", {"languages.krl.writer.syntax:robroot_check": always([])}),
    Fault(
        "krl_foot_of_another_arm",
        "posed_krl",
        {"languages.krl.writer.syntax:robroot_check": given(0, lambda arm: "other")},
    ),
)


FAULTS: Final = (*RAPID, *HANDSHAKE, *URSCRIPT, *KRL)
