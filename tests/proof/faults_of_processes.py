"""Faults in the planning of processes: sides, kerf, thickness, order, paths, freedoms, feeds, signals."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from planner.processes.hotwire.claims import KerfCurve
from planner.processes.hotwire.plan.straight.order import WireLines
from planner.targets import ScrewFreedom, TargetAction, Targets
from tests.proof.planner_faults import Fault, always, change_fields, fields, given, result, value


def _nearer(figures: Any) -> Any:
    """Report clamps 2 mm nearer to each other than they are."""
    chord, angles = figures
    return chord - 0.002, angles


def _scaled(factor: float) -> Any:
    return lambda old: factor * old


def _shift_points(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return lambda points: None if points is None else points + np.array([x, y, z])


# ---- targets as a whole ----


def _without(*kinds: str) -> Any:
    """The actions without those of some kinds."""
    return lambda actions: tuple(a for a in actions if a.kind not in kinds)


def _renamed(actions: tuple[TargetAction, ...]) -> tuple[TargetAction, ...]:
    return tuple(dataclasses.replace(a, signal="doOther") if a.signal else a for a in actions)


def _short_waits(actions: tuple[TargetAction, ...]) -> tuple[TargetAction, ...]:
    return tuple(dataclasses.replace(a, seconds=1e-3 * a.seconds) for a in actions)


def _late(actions: tuple[TargetAction, ...]) -> tuple[TargetAction, ...]:
    """What is switched on at the start is switched on at the end of the job."""
    last = max(a.target for a in actions)
    return tuple(
        sorted(
            (dataclasses.replace(a, target=last) if a.kind == "on" else a for a in actions),
            key=lambda a: a.target,
        )
    )


def _poses(arm: int, move: Any) -> Any:
    """The poses of one arm of the targets, by its number, moved by (4, 4) in the work frame."""
    return result(lambda targets: _changed(targets, arm, lambda pose: move @ pose))


def _own_poses(move: Any, arm: int = 0) -> Any:
    """Change poses in the tool's own frame."""
    return result(lambda targets: _changed(targets, arm, lambda pose: pose @ move))


def _changed(targets: Targets, number: int, change: Any) -> Targets:
    """Targets with other poses of one arm, also in the tables of their freedoms."""
    arm = targets.arms[number]
    freedoms = tuple(
        dataclasses.replace(f, pose={**f.pose, arm: change(f.pose[arm])})
        if arm in getattr(f, "pose", {})
        else f
        for f in targets.freedoms
    )
    return dataclasses.replace(
        targets, freedoms=freedoms, pose={**targets.pose, arm: change(targets.pose[arm])}
    )


def _shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


def _turn(axis: int, angle: float) -> np.ndarray:
    out = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i], out[i, j] = np.sin(angle), -np.sin(angle)
    return out


def _swapped_arms(targets: Targets) -> Targets:
    a, b = targets.arms
    freedoms = tuple(
        dataclasses.replace(f, pose={a: f.pose[b], b: f.pose[a]}) if hasattr(f, "pose") else f
        for f in targets.freedoms
    )
    return dataclasses.replace(targets, freedoms=freedoms, pose={a: targets.pose[b], b: targets.pose[a]})


# ---- helpers of single faults ----


def _curve_wider(factor: float) -> Any:
    def wider(curve: KerfCurve) -> KerfCurve:
        return KerfCurve(curve.speed, factor * curve.width, factor * curve.low, factor * curve.high)

    return result(wider)


def _narrow(interval: tuple[float, float]) -> tuple[float, float]:
    return interval[0] + 0.02, interval[1] - 0.02


def _thin_out(rows: Any) -> Any:
    return rows[[0, len(rows) // 2, -1]]


def _lifted(height: float) -> Any:
    def change(on: Any) -> Any:
        up = np.array([0.0, 0.0, height])
        foot = WireLines(on.row.foot.start + up, on.row.foot.end + up)
        return dataclasses.replace(on, row=dataclasses.replace(on.row, foot=foot))

    return change


def _far_slide(freedoms: tuple[Any, ...]) -> tuple[Any, ...]:
    """The slide along the wire moves a clamp nearer to the foam than the problem allows."""
    return tuple(
        dataclasses.replace(f, lower=f.upper + 0.006, upper=f.upper + 0.008) if f.name == "slide" else f
        for f in freedoms
    )


def _through(start: Any) -> Any:
    return dataclasses.replace(start, direction=_turn(2, 0.9)[:3, :3] @ start.direction)


def _half_path(old: Any) -> Any:
    def path(*args: Any) -> Any:
        found = old(*args)
        count = len(found.centre) // 2
        cut = {f.name: getattr(found, f.name)[:count] for f in dataclasses.fields(found)}
        return type(found)(**cut)

    return path


def _wide_tilts(freedoms: Any) -> Any:
    """Use tilts of a cone of 0.5 rad, whatever the user allows, and prefer those at its end."""
    out = []
    for one in freedoms:
        out.append(one)
        if one.name.startswith("spin"):
            (arm,) = one.axis
            count = np.ones(len(one.lower))
            twist = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            out.insert(-1, ScrewFreedom(f"wide_{arm}", {arm: twist}, 0.2 * count, 0.5 * count))
    return tuple(out)


def _leaning(axis: Any) -> Any:
    tilt = axis + np.array([0.15, 0.0, 0.0])
    return tilt / np.linalg.norm(tilt, axis=1, keepdims=True)


def _no_sine(old: Any) -> Any:
    return lambda vertices, faces: np.ones(len(vertices))


def _flat_corners(old: Any) -> Any:
    def corners(surface: Any, thickness: float) -> Any:
        vertices, faces, thick = old(surface, thickness)
        return vertices, faces, np.full_like(thick, thickness)

    return corners


def _wider_ring(ring: Any) -> Any:
    middle = ring[:-1].mean(axis=0) * np.array([1.0, 1.0, 0.0])
    away = (ring - middle) * np.array([1.0, 1.0, 0.0])
    return ring + 0.002 * away / np.linalg.norm(away, axis=1, keepdims=True)


def _other_arm(old: Any) -> Any:
    return lambda job, one: next(arm for arm in job.operation.arms if arm != old(job, one))


def _one_less(count: Any) -> Any:
    out = count.copy()
    out[np.flatnonzero(out)[2]] -= 1
    return out


def _late_pulses(count: Any) -> Any:
    out = np.zeros_like(count)
    at = np.flatnonzero(count)
    out[np.append(at[2:], [len(count) - 2, len(count) - 1])] = count[at]
    return out


def _run_moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return lambda run: change_fields(run, path=lambda path: change_fields(path, tip=_shift_points(x, y, z)))


def _rows_lost(rows: Any) -> Any:
    middle = len(rows) // 2
    return np.delete(rows, slice(middle - 2, middle + 3)) if len(rows) > 10 else rows


def _program_moved(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return lambda program: change_fields(
        program, path=lambda path: change_fields(path, tip=_shift_points(x, y, z))
    )


def _coarse(old: Any) -> Any:
    """Rulings of a cut are far apart; those of the part itself stay as they are."""
    return lambda ruled, chord, step: old(ruled, 0.002, 0.06) if step < 0.1 else old(ruled, chord, step)


def _long_way(old: Any) -> Any:
    """Replace arcs by the complementary arcs."""

    def sweep(*args: Any) -> float:
        angle = float(old(*args))
        return angle - np.copysign(2.0 * np.pi, angle)

    return sweep


def _always_absolute(old: Any) -> Any:
    return lambda modal, step: old(dataclasses.replace(modal, absolute=True), step)


# ---- a bent wire ----


ELASTIC: Final = (
    Fault("trim_no_kerf", "trim", {"processes.trim.plan.slots:offset_curve": given(2, _scaled(0.1))}),
    Fault("elastic_other_side_of_kerf", "elastic", {"geometry.mesh:offset_mesh": given(1, lambda d: -d)}),
    Fault("elastic_no_kerf", "elastic", {"geometry.mesh:offset_mesh": given(1, _scaled(0.0))}),
    Fault("elastic_half_kerf", "elastic", {"geometry.mesh:offset_mesh": given(1, _scaled(0.5))}),
    Fault(
        "elastic_kerf_curve",
        "elastic_heat",
        {"processes.hotwire.plan.operation:Heat.kerf_curve": _curve_wider(2.5)},
    ),
    Fault(
        "elastic_wire_too_soft",
        "elastic_thin",
        {"processes.hotwire.plan.wire:HeatedWire.bending_stiffness": result(_scaled(0.3))},
    ),
    Fault(
        "elastic_weight_upward",
        "elastic_thin",
        {"processes.hotwire.plan.wire:HeatedWire.load_over_stiffness": result(_scaled(-1.0))},
    ),
    Fault(
        "elastic_wire_shifted",
        "elastic",
        {"processes.hotwire.plan.elastic.job:_make_targets": _poses(0, _shift(z=0.002))},
    ),
    Fault(
        "elastic_clamp_turned",
        "elastic",
        {"processes.hotwire.plan.elastic.job:_make_targets": _own_poses(_turn(2, 0.03))},
    ),
    Fault(
        "elastic_feed_times_ten",
        "elastic",
        {"processes.hotwire.plan.elastic.job:_make_targets": fields(feed=_scaled(10.0))},
    ),
    Fault(
        "elastic_travel_in_mm",
        "elastic",
        {"processes.hotwire.plan.elastic.job:_make_targets": fields(travel=_scaled(1e-3))},
    ),
    Fault(
        "elastic_no_heating", "elastic", {"processes.hotwire.plan.elastic.job:_actions": result(_short_waits)}
    ),
    Fault("elastic_power_late", "elastic", {"processes.hotwire.plan.elastic.job:_actions": result(_late)}),
    Fault(
        "elastic_signal_other", "elastic", {"processes.hotwire.plan.elastic.job:_actions": result(_renamed)}
    ),
    Fault(
        "elastic_not_asked",
        "elastic",
        {"processes.hotwire.plan.elastic.job:_actions": result(_without("confirm"))},
    ),
    Fault(
        "elastic_told_too_long",
        "elastic",
        {"processes.hotwire.plan.wire:HeatedWire.cold_length": result(_scaled(1.01))},
    ),
    Fault(
        "elastic_told_too_near",
        "elastic",
        {"processes.hotwire.plan.elastic.job:mount_figures": result(_nearer)},
    ),
    Fault(
        "elastic_section_lost",
        "elastic",
        {"processes.hotwire.plan.elastic.path:cut_positions": result(_thin_out)},
    ),
    Fault(
        "elastic_length_longer",
        "elastic",
        {"processes.hotwire.plan.elastic.path:wires_from_states": given(2, _scaled(1.02))},
    ),
)


# ---- a straight wire ----


def _swapped_halves(half: Any) -> Any:
    return half[:, ::-1]


STRAIGHT: Final = (
    Fault(
        "straight_other_side_of_kerf",
        "ruled",
        {"processes.hotwire.plan.straight.offset:wire_offset": fields(half=_scaled(-1.0))},
    ),
    Fault(
        "straight_half_kerf",
        "ruled",
        {"processes.hotwire.plan.straight.offset:wire_offset": fields(half=_scaled(0.3))},
    ),
    Fault(
        "straight_no_kerf",
        "plate",
        {"processes.hotwire.plan.straight.offset:wire_offset": fields(half=_scaled(0.0))},
    ),
    Fault(
        "straight_kerf_ends_swapped",
        "tapered",
        {"processes.hotwire.plan.straight.offset:wire_offset": fields(half=_swapped_halves)},
    ),
    Fault(
        "straight_kerf_doubled",
        "plate",
        {"processes.hotwire.plan.operation:Heat.kerf_curve": _curve_wider(1.5)},
    ),
    Fault(
        "straight_shifted",
        "ruled",
        {
            "processes.hotwire.plan.straight.cut:make_cut": result(
                lambda c: change_fields(c, on=_lifted(0.0008))
            )
        },
    ),
    Fault(
        "straight_pose_off",
        "ruled",
        {"processes.hotwire.plan.straight.job:bow_poses": result(lambda p: p @ _shift(z=0.0008))},
    ),
    Fault(
        "straight_pose_turned",
        "wing",
        {"processes.hotwire.plan.straight.job:bow_poses": result(lambda p: p @ _turn(2, 0.01))},
    ),
    Fault(
        "straight_slide_too_far",
        "ruled",
        {"processes.hotwire.plan.straight.job:bow_freedoms": result(_far_slide)},
    ),
    Fault(
        "straight_slit_through_part",
        "plate",
        {"processes.hotwire.plan.straight.cut:choose_start": result(_through)},
    ),
    Fault(
        "straight_outline_first",
        "plate",
        {"processes.hotwire.plan.straight.order:nominal_surfaces": result(lambda w: w[::-1])},
    ),
    Fault(
        "straight_surface_lost",
        "plate",
        {"processes.hotwire.plan.straight.order:nominal_surfaces": result(lambda w: w[:-1])},
    ),
    Fault(
        "straight_feed_times_ten",
        "ruled",
        {"processes.hotwire.plan.straight.job:_max_feeds": result(_scaled(10.0))},
    ),
    Fault(
        "straight_feed_tenth",
        "ruled",
        {"processes.hotwire.plan.straight.job:_max_feeds": result(_scaled(0.1))},
    ),
    Fault(
        "straight_no_heating",
        "ruled",
        {"processes.hotwire.plan.straight.route:operator_actions": result(_short_waits)},
    ),
    Fault(
        "straight_power_late",
        "ruled",
        {"processes.hotwire.plan.straight.route:operator_actions": result(_late)},
    ),
    Fault(
        "straight_signal_other",
        "ruled",
        {"processes.hotwire.plan.straight.route:operator_actions": result(_renamed)},
    ),
    Fault(
        "held_grip_off",
        "held_side",
        {"processes.hotwire.plan.straight.job:_make_targets": _poses(0, _shift(x=0.001))},
    ),
    Fault(
        "held_grip_upside_down",
        "held",
        {"processes.hotwire.plan.straight.job:_make_targets": _poses(0, _turn(2, 0.02))},
    ),
    Fault("held_mass_lost", "held", {"languages.writing.steps:_held_load": fields(mass=_scaled(0.3))}),
    Fault("held_load_forgotten", "held", {"languages.writing.steps:load_changes": always({})}),
    Fault("straight_sampled_coarsely", "wing", {"geometry.rulings:resample": _coarse}),
)


# ---- sheet forming ----

FORMING: Final = (
    Fault(
        "form_ball_too_deep",
        "spif",
        {
            "processes.forming.plan.paths.contact_path:make_contact_path": fields(
                centre=_shift_points(z=-0.0003)
            )
        },
    ),
    Fault(
        "form_ball_too_high",
        "spif",
        {
            "processes.forming.plan.paths.contact_path:make_contact_path": fields(
                centre=_shift_points(z=0.0005)
            )
        },
    ),
    Fault(
        "form_ball_aside",
        "spif",
        {
            "processes.forming.plan.paths.contact_path:make_contact_path": fields(
                centre=_shift_points(x=0.0008)
            )
        },
    ),
    Fault(
        "form_ball_smaller",
        "spif",
        {"processes.forming.plan.paths.contact_path:make_contact_path": given(1, _scaled(0.9))},
    ),
    Fault(
        "form_step_doubled",
        "spif",
        {
            "processes.forming.plan.process_plan:FormingWork.options": result(
                lambda o: change_fields(o, stepdown=_scaled(1.6))
            )
        },
    ),
    Fault(
        "form_level_left_out",
        "spif",
        {
            "processes.forming.plan.paths.contact_path:constant_levels": result(
                lambda z: np.delete(z, len(z) // 2)
            )
        },
    ),
    Fault(
        "form_half_the_depth",
        "spif",
        {"processes.forming.plan.paths.contact_path:make_contact_path": _half_path},
    ),
    Fault(
        "form_thickness_lost",
        "spif",
        {
            "processes.forming.plan.passes:_final_pass": fields(
                vertices=_shift_points(z=-0.001), start=_scaled(1.0)
            )
        },
    ),
    Fault(
        "form_tip_for_centre",
        "spif",
        {"processes.forming.plan.job:tool_poses": given(0, _shift_points(z=-0.006))},
    ),
    Fault("form_feed_times_ten", "spif", {"processes.forming.plan.job:_targets": fields(feed=_scaled(10.0))}),
    Fault(
        "form_feed_in_wrong_unit",
        "dsif",
        {"processes.forming.plan.job:_targets": fields(travel=_scaled(0.1))},
    ),
    Fault(
        "form_support_shifted",
        "dsif",
        {
            "processes.forming.plan.support.modes:make_opposite_path": fields(
                support_centre=_shift_points(x=0.0005)
            )
        },
    ),
    Fault(
        "form_support_farther",
        "dsif",
        {
            "processes.forming.plan.support.modes:make_opposite_path": fields(
                support_centre=_shift_points(z=-0.0003)
            )
        },
    ),
    Fault(
        "form_gap_without_sine",
        "dsif",
        {
            "processes.forming.plan.sheet_mechanics:_min_normal_z": _no_sine,
            "processes.forming.plan.sheet_mechanics:face_by_corner": _flat_corners,
        },
    ),
    Fault(
        "form_squeeze_lost",
        "dsif_squeezed",
        {
            "processes.forming.plan.support.opposite:make_opposite_path": given(
                1, lambda op: op.model_copy(update={"squeeze": 1.0})
            )
        },
    ),
    Fault(
        "form_support_turned",
        "dpif_l_shifted",
        {
            "processes.forming.plan.support.modes:make_opposite_path": fields(
                support_centre=_shift_points(y=0.0008)
            )
        },
    ),
    Fault(
        "form_border_off",
        "dpif_p",
        {"processes.forming.plan.support.modes:border_curve": result(_wider_ring)},
    ),
    Fault(
        "form_border_lower",
        "dpif_p",
        {
            "processes.forming.plan.support.modes:border_path": result(
                lambda r: (r[0], r[1] - np.array([0, 0, 0.001]))
            )
        },
    ),
    Fault(
        "form_border_without_radius",
        "dpif_p",
        {
            "processes.forming.plan.support.modes:border_curve": given(
                1, lambda h: change_fields(h, radius=_scaled(0.8))
            )
        },
    ),
    Fault(
        "form_heat_other_place",
        "heat",
        {
            "processes.forming.plan.support.modes:heat_path": result(
                lambda r: (r[0], r[1] + np.array([0.006, 0, 0]), r[2])
            )
        },
    ),
    Fault(
        "form_children_first",
        "two_features",
        {"processes.forming.plan.features.tree:in_place_order": result(lambda order: order[::-1])},
    ),
    Fault(
        "form_feature_lost",
        "two_features",
        {"processes.forming.plan.passes:make_passes": result(lambda p: p[:1])},
    ),
    Fault(
        "form_feature_twice",
        "two_features",
        {"processes.forming.plan.passes:make_passes": result(lambda p: (*p, p[-1]))},
    ),
    Fault(
        "form_feature_level",
        "two_features",
        {"processes.forming.plan.features.tree:sheet_level": result(lambda z: z + 0.001)},
    ),
    Fault(
        "adsif_shifted",
        "adsif_small",
        {
            "processes.forming.plan.paths.adsif_path:adsif_tool_path": fields(
                forming_centre=_shift_points(x=0.003), support_centre=_shift_points(x=0.003)
            )
        },
    ),
    Fault(
        "adsif_mirrored_angle",
        "adsif",
        {"processes.forming.plan.paths.adsif_response:invert_response": result(lambda r: (-r[0], r[1]))},
    ),
    Fault(
        "adsif_angle_off",
        "adsif",
        {"processes.forming.plan.paths.adsif_response:invert_response": result(lambda r: (0.8 * r[0], r[1]))},
    ),
    Fault(
        "adsif_gap_in_sheets",
        "adsif",
        {"processes.forming.plan.paths.adsif_response:invert_response": result(lambda r: (r[0], 1.5 * r[1]))},
    ),
    Fault(
        "adsif_pitch_tripled",
        "adsif",
        {"processes.forming.plan.paths.adsif_path:_loop_levels": given(1, _scaled(3.0))},
    ),
    Fault(
        "adsif_too_shallow",
        "adsif",
        {
            "processes.forming.plan.paths.adsif_path:adsif_tool_path": fields(
                forming_centre=_shift_points(z=0.001), support_centre=_shift_points(z=0.001)
            )
        },
    ),
    Fault(
        "adsif_wall_steeper",
        "adsif",
        {"processes.forming.plan.paths.adsif_path:_contact_path": fields(angle=lambda a: a + 0.05)},
    ),
    Fault("tpif_pulse_lost", "tpif", {"processes.forming.plan.two_point:pulse_counts": result(_one_less)}),
    Fault(
        "tpif_pulses_late", "tpif", {"processes.forming.plan.two_point:pulse_counts": result(_late_pulses)}
    ),
    Fault("tpif_step_halved", "tpif", {"processes.forming.plan.two_point:holder_step": result(_scaled(0.5))}),
    Fault("tpif_signal_other", "tpif", {"processes.forming.plan.job:_actions": result(_renamed)}),
)


# ---- milling ----

MILLING: Final = (
    Fault(
        "flank_other_side",
        "flank",
        {"processes.milling.plan.cutter_contact:cutter_axes": given(1, _scaled(-1.0))},
    ),
    Fault(
        "flank_half_radius",
        "flank",
        {"processes.milling.plan.flank_cut:place_cutter": given(3, _scaled(0.5))},
    ),
    Fault(
        "flank_diameter_for_radius",
        "flank",
        {"processes.milling.plan.flank_cut:place_cutter": given(3, _scaled(2.0))},
    ),
    Fault(
        "flank_tip_high",
        "flank",
        {"processes.milling.plan.flank_cut:tip_overrun": result(lambda u: u - 0.006)},
    ),
    Fault(
        "flank_shifted",
        "flank",
        {"processes.milling.plan.flank_cut:_build_pass": result(_run_moved(y=0.001))},
    ),
    Fault(
        "form_tools_lean", "dsif", {"processes.forming.plan.support.directions:tool_axes": result(_leaning)}
    ),
    Fault(
        "form_lean_in_degrees",
        "spif",
        {"processes.forming.plan.support.directions:tool_axes": given(1, lambda lean: lean + 0.2)},
    ),
    Fault("form_cone_wide", "spif", {"processes.forming.plan.job:tool_freedoms": result(_wide_tilts)}),
    Fault("flank_axis_leans", "flank", {"processes.milling.plan.job:tool_poses": given(1, _leaning)}),
    Fault(
        "lines_step_doubled", "lines", {"processes.milling.plan.point_cut:ridge_step": result(_scaled(2.5))}
    ),
    Fault(
        "lines_tip_for_centre",
        "lines",
        {"processes.milling.plan.point_cut:tool_tips": result(_shift_points(z=-0.001))},
    ),
    Fault(
        "lines_last_lost",
        "lines",
        {"processes.milling.plan.point_cut:_line_offsets": result(lambda o: o[:-4])},
    ),
    Fault(
        "engrave_depth_doubled",
        "engrave",
        {
            "processes.milling.plan.point_cut:plan_engraving": given(
                1, lambda c: c.model_copy(update={"depth_mm": 2.0 * c.depth_mm})
            )
        },
    ),
    Fault(
        "engrave_mirrored",
        "engrave",
        {"processes.milling.plan.point_cut:_resample_curve": result(lambda p: p * [1.0, -1.0, 1.0])},
    ),
    Fault(
        "engrave_depth_up",
        "engrave",
        {
            "processes.milling.plan.point_cut:plan_engraving": given(
                1, lambda c: c.model_copy(update={"depth_mm": -c.depth_mm})
            )
        },
    ),
    Fault(
        "engrave_curve_moved",
        "engrave",
        {"geometry.face_from_above:FaceFromAbove.at": given(1, lambda xy: xy + 0.001)},
    ),
    Fault(
        "gcode_shifted",
        "gcode",
        {"processes.milling.plan.gcode.reader:read_gcode": result(_program_moved(x=0.002))},
    ),
    Fault("gcode_inch_as_mm", "gcode", {"processes.milling.plan.gcode.state:INCH_M": value(0.025)}),
    Fault(
        "gcode_offset_lost",
        "gcode",
        {
            "processes.milling.plan.operation:GCodeFile.dialect": fields(
                offsets=lambda o: dict.fromkeys(o, (0.0, 0.0, 0.0))
            )
        },
    ),
    Fault(
        "gcode_origin_lost",
        "gcode",
        {"processes.milling.plan.operation:GCodeFile.dialect": fields(frame=lambda p: np.eye(4))},
    ),
    Fault("gcode_arcs_other_way", "gcode", {"processes.milling.plan.gcode.moves:arc_sweep": _long_way}),
    Fault(
        "gcode_arcs_as_chords",
        "gcode",
        {"processes.milling.plan.gcode.moves:arc_points": result(lambda p: p[-1:])},
    ),
    Fault(
        "gcode_increments_absolute",
        "gcode",
        {"processes.milling.plan.gcode.moves:_target_position": _always_absolute},
    ),
    Fault(
        "gcode_feed_per_second",
        "gcode",
        {"processes.milling.plan.gcode.moves:_cut_feed": result(_scaled(60.0))},
    ),
    Fault("gcode_line_lost", "gcode", {"processes.milling.plan.process_plan:_kept_rows": result(_rows_lost)}),
    Fault("gcode_thinned", "gcode", {"processes.milling.plan.process_plan:CHORD_FRACTION": value(20.0)}),
    Fault(
        "gcode_rotary_sign",
        "gcode_rotary",
        {
            "processes.milling.plan.gcode.state:find_convention": result(
                lambda c: change_fields(c, chain=lambda x: tuple((a, -s) for a, s in x))
            )
        },
    ),
    Fault(
        "gcode_rotary_order",
        "gcode_rotary",
        {
            "processes.milling.plan.gcode.state:find_convention": result(
                lambda c: change_fields(c, chain=lambda x: x[::-1])
            )
        },
    ),
    Fault(
        "gcode_degrees",
        "gcode_rotary",
        {"processes.milling.plan.gcode.state:Convention.axis": given(1, _scaled(0.9))},
    ),
    Fault(
        "mill_rapid_plunge",
        "engrave",
        {"processes.milling.plan.tool_path:plan_route": fields(feed=_scaled(5.0))},
    ),
    Fault(
        "mill_feed_times_ten",
        "flank",
        {"processes.milling.plan.job:_build_targets": fields(feed=_scaled(10.0))},
    ),
    Fault("mill_spindle_off", "flank", {"processes.milling.plan.job:_build_actions": result(_without("on"))}),
    Fault("mill_no_spin_up", "flank", {"processes.milling.plan.job:_build_actions": result(_short_waits)}),
    Fault("mill_signal_other", "flank", {"processes.milling.plan.job:_build_actions": result(_renamed)}),
    Fault(
        "mill_pass_lost",
        "flank_rough",
        {"processes.milling.plan.process_plan:MillingPlan.passes": result(lambda r: r[1:])},
    ),
    Fault(
        "mill_longer_cutter",
        "engrave",
        {"processes.milling.plan.job:_build_targets": _own_poses(_shift(z=0.001))},
    ),
)

FAULTS: Final = (*ELASTIC, *STRAIGHT, *FORMING, *MILLING)
