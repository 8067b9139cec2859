"""Stages of the proof, and the order in which rules run.

The order is visible in ``proof.json``, in reports and in the documentation, so it is stated here for all
rules of Tandem and depends on nothing else. Rules of installed packages follow the rules of their stage.

A rule may rely on the rules before it. If a fault leaves the rules of a stage nothing to examine, that
stage and those after it do not run, and the proof does not hold (:mod:`planner.proof.prove`).
"""

from collections.abc import Mapping
from typing import Final, Literal

Stage = Literal[
    "text", "robots", "tasks", "setups", "curves", "motion", "sheets", "cutters", "slots", "wires", "bodies"
]
"""Stages in their order.

From "tasks" on, the programs of all arms can be read. From "setups" on, tasks pass the same
synchronisation points. From "curves" on, a motion follows from the programs (``context.motion``). From
"sheets" on, arms reach all targets of it.
"""

ORDER: Final[Mapping[Stage, tuple[str, ...]]] = {
    "text": (
        "verify.syntax",
        "verify.declarations",
        "verify.pers_literal",
        "verify.names",
        "verify.line_length",
        "verify.module_size",
        "verify.decimals",
        "verify.files",
        "verify.digest",
    ),
    "robots": ("verify.robot_model",),
    "tasks": (
        "verify.task_list",
        "verify.sync_order",
        "verify.handshake",
        "verify.meeting_time",
        "verify.error_handler",
        "verify.undo",
        "verify.motion_settings",
        "verify.hidden",
        "verify.cell_check",
        "verify.controller_files",
        "verify.start_posture",
        "verify.goal_tolerances",
        "verify.power_on_failure",
    ),
    "setups": (
        "verify.setup",
        "verify.dialogue",
        "verify.move_count",
        "verify.move_ids",
        "verify.zone_kind",
        "verify.move_time",
        "verify.speed_data",
        "verify.arms_alone",
        "verify.wire_alone",
        "verify.stop_before_logic",
        "verify.signals",
        "verify.tool_data",
        "verify.work_object",
        "verify.held_frame",
        "verify.load",
        "verify.base_frames",
        "verify.rests",
        "verify.status",
        "verify.move_kinds",
        "verify.external_axes",
        "verify.unknown_start",
        "verify.zone_size",
        "verify.zero_length",
        "verify.wire_mount",
    ),
    "curves": ("verify.spline",),
    "motion": (
        "verify.reach",
        "verify.sag",
        "verify.corner",
        "verify.continuity",
        "verify.confdata",
        "verify.joint_limits",
        "verify.rod_limits",
        "verify.joint_speed",
        "verify.joint_acceleration",
        "verify.singularity",
        "verify.tcp_speed",
        "verify.track_along",
        "verify.between_points",
        "verify.power_idle",
        "verify.follows",
        "verify.order",
    ),
    "sheets": (
        "verify.forming_part",
        "verify.forming_holes",
        "verify.forming_claims",
        "verify.springback",
        "verify.level",
        "verify.feature_order",
        "verify.forming_feed",
        "verify.lean",
        "verify.gouge",
        "verify.gap",
        "verify.border",
        "verify.opposite",
        "verify.sheet",
        "verify.holder",
        "verify.adsif",
        "verify.formed",
    ),
    "cutters": (
        "verify.milled",
        "verify.mill_gouge",
        "verify.mill_path",
        "verify.mill_feed",
        "verify.spindle",
    ),
    "slots": (
        "verify.trim_cut",
        "verify.trim_kept",
        "verify.trim_torch",
        "verify.trim_arc",
        "verify.trim_order",
        "verify.trim_feed",
        "verify.trim_clear",
        "verify.trim_mill",
        "verify.trim_spindle",
        "verify.trim_knife",
    ),
    "wires": (
        "verify.wire_length",
        "verify.wire_stability",
        "verify.curvature",
        "verify.contact",
        "verify.stop_in_foam",
        "verify.wire_power",
        "verify.dialogue_figures",
        "verify.feed",
        "verify.bow",
        "verify.rulings",
        "verify.slit",
        "verify.surface",
        "verify.kerf",
        "verify.part_file",
        "verify.ridge",
        "verify.part",
    ),
    "bodies": (
        "verify.kinematics",
        "verify.clearance",
        "verify.own_clearance",
        "verify.step_apart",
        "verify.track_way",
        "verify.wire_clearance",
    ),
}
"""Codes of the rules by stage."""
NEEDED: Final = (
    "verify.setup",
    "verify.move_count",
    "verify.sync_order",
    "verify.handshake",
    "verify.arms_alone",
    "verify.held_frame",
    "verify.status",
)
"""Codes of the rules that must hold for a motion to follow from the text."""
FACES: Final = ("verify.surface", "verify.formed", "verify.milled")
"""Codes of the rules of Tandem that yield simulated faces, in the order in which reports show them."""
