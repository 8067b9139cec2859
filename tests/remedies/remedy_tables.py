"""Codes whose remedies are tested elsewhere, cannot be tested, or are not tested yet: see ``remedy_rows``."""

from __future__ import annotations

from typing import Final

from planner.issue_codes import CODES

ELSEWHERE: Final = {
    "part.step": (
        "reading/test_step",
        "test_faces_of_several_bodies_are_told_and_picked",
    ),
    **dict.fromkeys(
        ("robot.urdf", "robot.chain", "robot.limits"),
        ("reading/test_urdf", "test_bad_files_are_refused_in_words_and_what_is_advised_helps"),
    ),
    **dict.fromkeys(
        ("scan.unit", "scan.flat", "scan.other_part"),
        ("shopfloor/scan/test_scan_fit", "test_scans_that_are_none_of_the_part_are_refused_by_what_they_are"),
    ),
    "motion.station": (
        "test_long_wall",
        "test_one_operation_that_no_station_reaches_is_told_with_what_to_do",
    ),
    **dict.fromkeys(
        (
            "trim.crosses", "trim.in_waste", "trim.off_part", "trim.narrow", "trim.joints", "trim.lead",
            "trim.wall", "trim.corner",
        ),
        (
            "processes/trim/plan/test_input",
            "test_what_cannot_be_cut_is_refused_and_the_change_that_is_told_helps",
        ),
    ),
    "forming.holes": (
        "processes/forming/plan/test_stages", "test_a_smaller_margin_and_a_hole_farther_away_help",
    ),
    "forming.features": (
        "processes/forming/plan/test_stages", "test_features_that_do_not_add_up_to_the_part_are_refused",
    ),
    "trim.open": ("processes/trim/plan/test_input", "test_an_open_drawing_is_refused"),
    "trim.tool": ("processes/trim/plan/test_input", "test_a_forming_tool_cuts_no_sheet"),
    "trim.die": ("processes/trim/plan/test_mill", "test_a_die_behind_the_sheet_is_not_cut"),
    "trim.no_sheet": ("processes/trim/plan/test_input", "test_without_a_formed_sheet_nothing_is_trimmed"),
    "trim.slow": ("processes/trim/plan/test_input", "test_an_arm_that_is_too_slow_is_told"),
    "problem.track": ("reading/test_axes", "test_what_cannot_be_a_track_is_told"),
    "problem.turntable": ("reading/test_axes", "test_what_cannot_be_a_turntable_is_told"),
    "scan.file": ("shopfloor/scan/test_scan_fit", "test_bad_files_are_refused_in_words"),
    "scan.no_marks": (
        "shopfloor/scan/test_scan_fit",
        "test_without_marks_height_and_tilt_are_found_and_said",
    ),
    "scan.marks": (
        "shopfloor/scan/test_scan_fit",
        "test_marks_say_how_well_a_scan_lies_and_which_of_them_is_doubted",
    ),
    "scan.hole": (
        "shopfloor/scan/test_adjustment",
        "test_a_scan_that_shows_too_little_is_refused_with_the_place",
    ),
    "robot.bodies": (
        "reading/test_robot_file",
        "test_meshes_that_are_not_there_are_refused_and_laid_there_are_hulled",
    ),
    "robot.not_opw": ("reading/test_urdf", "test_the_base_behind_what_carries_the_arm_is_a_remedy"),
    "robot.deviation": (
        "reading/test_urdf", "test_figures_with_noise_are_refused_with_the_deviation",
    ),
    "post.language": (
        "test_ur_jobs", "test_an_arm_without_a_language_is_refused_and_check_tells_of_its_reach_all_the_same",
    ),
    "post.ur_arm": (
        "languages/urscript/writer/test_program", "test_an_arm_that_a_ur_controller_does_not_move_is_refused",
    ),
    "post.trajectory": (
        "test_driven_jobs", "test_a_way_that_no_points_keep_is_told_and_a_stop_there_helps",
    ),
    "post.blend": (
        "languages/urscript/writer/test_program",
        "test_a_turn_about_the_tcp_is_no_blend_and_a_stop_there_helps",
    ),
    "forming.force": ("test_acceptance", "test_an_error_says_how_it_is_accepted_and_following_that_works"),
    "kerf.unsettled": (
        "processes/hotwire/plan/straight/test_offset_heat",
        "test_an_end_that_stands_still_has_no_slot_of_its_own",
    ),
    "motion.sag": (
        "motion/test_sag", "test_where_the_controller_makes_up_for_the_load_only_the_force_is_ours",
    ),
    "motion.sag_range": (
        "motion/test_sag", "test_a_shift_beyond_its_range_is_refused_and_the_range_advised_is_enough",
    ),
    "motion.collision": ("motion/test_diagnosis", "test_the_change_that_is_named_opens_the_way"),
    "milling.too_large": (
        "processes/milling/proof/test_tool_motion",
        "test_what_is_too_large_is_refused_by_the_planner_first_and_not_proven",
    ),
    "control.machine": (
        "loops/test_machine", "test_a_wrong_field_is_named_and_correcting_it_is_enough",
    ),
    "control.unstable": (
        "loops/test_machine", "test_a_gain_that_swings_up_is_refused_and_the_one_advised_is_not",
    ),
    "control.band": (
        "loops/test_machine", "test_a_feed_that_loses_the_band_is_told_and_the_one_advised_keeps_it",
    ),
    "control.range": (
        "loops/test_machine", "test_corrections_beyond_the_range_are_told_and_a_larger_range_ends_it",
    ),
    "forming.springback": (
        "processes/forming/plan/springback/test_springback",
        "test_a_part_that_comes_back_is_told_and_each_remedy_helps",
    ),
    "forming.compensation": (
        "processes/forming/plan/springback/test_compensation",
        "test_an_edited_file_is_refused_and_one_that_is_written_again_is_good",
    ),
    "forming.springback_mesh": (
        "processes/forming/plan/springback/test_springback",
        "test_too_few_triangles_are_told_and_as_many_as_advised_do",
    ),
    "forming.plate_test": (
        "processes/forming/plan/springback/test_clamp_calibration",
        "test_what_are_no_readings_is_refused_by_line",
    ),
    "forming.clamp_unclear": (
        "processes/forming/plan/springback/test_clamp_calibration", "test_what_is_not_told_is_said",
    ),
    "forming.limit_load": (
        "processes/forming/plan/springback/test_springback",
        "test_a_sheet_that_snaps_is_told_by_its_limit_and_less_force_ends_it",
    ),
    "forming.loop_curves": (
        "cli/test_loop", "test_curves_of_another_problem_are_refused_and_writing_them_again_helps",
    ),
    "forming.loop_forces": (
        "loops/test_loop_files", "test_correcting_the_row_that_is_named_is_enough",
    ),
    "forming.loop_law": (
        "cli/test_loop", "test_a_figure_out_of_range_is_named_and_the_default_serves",
    ),
    "forming.loop_plant": (
        "loops/test_loop_files", "test_a_wrong_field_of_a_plant_is_named_and_correcting_it_is_enough",
    ),
    "forming.loop_unstable": (
        "cli/test_loop", "test_a_gain_that_swings_up_is_refused_and_the_one_advised_is_not",
    ),
    "forming.loop_range": (
        "cli/test_loop", "test_offsets_beyond_their_range_are_cut_and_told_and_more_range_ends_it",
    ),
    "problem.process_package": (
        "test_processes",
        "test_what_cannot_be_used_is_refused_where_a_problem_names_it",
    ),
    "element.surface": (
        "element/test_element_file",
        "test_surfaces_that_are_none_are_refused_with_their_place",
    ),
    "element.wire": (
        "element/test_element_file",
        "test_wires_too_short_are_refused_with_the_length_that_reaches",
    ),
    "element.tolerance": (
        "element/test_element_file",
        "test_noise_is_out_of_tolerance_and_the_tolerance_advised_is_enough",
    ),
    "element.block": (
        "element/test_element_file",
        "test_blocks_too_thin_are_refused_with_the_thickness_that_fits",
    ),
    "element.shape": (
        "element/test_hexagons",
        "test_panels_beyond_a_limit_are_named_with_a_change_that_helps",
    ),
    "element.assembly": (
        "element/test_assembly",
        "test_panels_without_a_way_in_are_named_and_what_is_advised_opens_one",
    ),
    "element.dowels": (
        "element/test_dowels",
        "test_shorter_dowels_find_room_where_long_ones_have_none",
    ),
    "element.count": (
        "element/test_quads",
        "test_a_count_that_rows_cannot_make_is_told_and_narrower_panels_make_it",
    ),
    "element.concave": (
        "element/test_hexagons",
        "test_concave_panels_are_named_all_and_none_else",
    ),
    "element.held": (
        "element/test_element_file",
        "test_panels_that_no_wire_holds_are_named_and_more_lengths_help",
    ),
    "element.run": (
        "element/test_run_report",
        "test_what_is_no_batch_of_the_element_is_refused_and_a_batch_of_it_is_read",
    ),
    "element.mark": (
        "element/test_progress",
        "test_what_is_no_panel_or_no_list_is_refused_and_what_is_advised_helps",
    ),
    "element.joint": (
        "element/test_element_file",
        "test_joints_beyond_the_step_asked_are_told_and_the_step_advised_is_kept",
    ),
    "element.face": (
        "element/test_rows",
        "test_a_slot_on_the_side_of_the_panels_is_named_by_the_report_and_none_once_planned_anew",
    ),
    "element.raw_block": (
        "element/test_nest",
        "test_blocks_that_fit_no_raw_block_are_refused_with_the_size_that_does",
    ),
    "element.cut": (
        "element/test_nest",
        "test_cuts_out_of_reach_are_named_and_the_bow_advised_reaches_them",
    ),
    "element.stock": (
        "element/test_nest",
        "test_wrong_rows_of_the_stock_are_refused_and_without_them_it_is_read",
    ),
    "element.jobs": (
        "element/test_element_file",
        "test_templates_that_overlap_or_leave_a_panel_out_are_refused_by_panel",
    ),
    "part.mesh_noise": (
        "reading/test_sheet",
        "test_noise_beyond_the_stated_tolerance_is_told_and_its_remedy_works",
    ),
    "upload.unproven": (
        "shopfloor/loading/test_loading_commands",
        "test_what_was_changed_is_not_sent_and_an_old_result_is_proven_again",
    ),
    "upload.release": ("shopfloor/loading/test_loading_commands", "test_what_is_not_released_is_not_sent"),
    "upload.missing": (
        "shopfloor/loading/test_loading_commands",
        "test_programs_come_back_from_a_controller",
    ),
    **dict.fromkeys(
        ("upload.login", "upload.address"),
        ("shopfloor/loading/test_upload", "test_a_certificate_is_trusted_by_its_fingerprint_alone"),
    ),
    **dict.fromkeys(
        ("upload.busy", "upload.controller"),
        (
            "shopfloor/loading/test_upload",
            "test_a_controller_that_is_not_ready_is_refused_and_nothing_is_written",
        ),
    ),
    "upload.differs": (
        "shopfloor/loading/test_upload",
        "test_tools_are_compared_with_the_text_of_the_module",
    ),
    "upload.write": ("shopfloor/loading/test_upload", "test_what_was_begun_is_taken_away"),
    **dict.fromkeys(
        (
            "service.request", "service.not_found", "service.unknown_job", "service.unknown_file",
            "service.not_uploaded", "service.file_name", "service.archive", "service.too_large",
        ),
        ("service/test_request_remedies", "test_what_an_answer_advises_makes_a_good_one"),
    ),
}  # fmt: skip
"""File and name of tests that follow the remedy of a code."""

UNDO: Final = (
    "programs are proven as they were written: who changed them undoes it or plans again; unchanged ones "
    "that are not proven are a fault of Tandem, to be reported"
)
OURS: Final = "a fault of Tandem itself, to be reported"
INSTALL: Final = "the remedy is to install something, which a test does not do"
STATE: Final = "tells a state of machines or of other users; nothing in the user's files is wrong"
FACT: Final = "a note of what was found or chosen; nothing is wrong"
DAMAGED: Final = "what is damaged or another version's is not mended, but planned or installed again"

FOLLOWED: Final = frozenset(
    {"verify.no_programs", "verify.files", "verify.problem_differs", "verify.duration"}
)
"""Codes of proofs that a user can do something about but undo a change."""
NONE: Final = {
    **{code: UNDO for code in CODES if code.startswith("verify.") and code not in FOLLOWED},
    **dict.fromkeys(("internal.error", "claims.unproven", "claims.none"), OURS),
    **dict.fromkeys(("report.exhibit", "plan.not_saveable"), OURS),
    **dict.fromkeys(("part.extra_missing", "sign.extra", "batch.install", "service.install"), INSTALL),
    **dict.fromkeys(("catalogue.missing_data", "plan.missing_file", "plan.damaged", "plan.schema"), DAMAGED),
    **dict.fromkeys(("part.ruled_deviation", "part.strips_found", "sign.good"), FACT),
    **dict.fromkeys(("wire.chosen", "straight.slit", "motion.path_kept", "motion.solver"), FACT),
    **dict.fromkeys(("mesh.file_unit", "part.rhino_unit", "part.rhino_facets", "gcode.skipped"), FACT),
    "robot.unseen": FACT,
    **dict.fromkeys(("part.step_unit", "part.step_facets", "scan.stray"), FACT),
    "motion.like": FACT,
    "forming.compensated": FACT,
    **dict.fromkeys(
        (
            "batch.crashed", "batch.timeout", "batch.memory", "batch.cancelled", "batch.worker",
            "batch.cluster", "batch.versions", "batch.in_use", "service.database", "service.start",
            "service.token", "service.foreign", "service.link", "service.too_many", "service.stopping",
            "service.storage", "service.check_stopped", "service.gave_up", "service.answer",
            "service.timeout", "service.version", "service.backup", "service.idempotency", "service.webhook",
            "output.disk_full", "service.state", "service.not_planning",
            "upload.not_looked_at", "service.role", "service.release", "service.log_in", "service.damaged",
            "service.draft",
        ),
        STATE,
    ),
    "upload.touched": "somebody has meant it: it is planned with, or the result is sent again",
    "sign.unproven": "what is not proven is planned again, then signed: see verify.*",
    "sign.signature": "a text or signature that somebody changed cannot be mended, only signed again",
    "sign.content": "a result that somebody changed is planned or fetched again",
    "sign.missing": "who made the result signs it; the reader cannot",
    "wire.no_equilibrium": "of the solver, for callers of the library; jobs get wire.shape and related codes",
    "verify.unread": "tells by line what of somebody else's programs is not read or proven; as nobody knows "
    "where an arm starts, its first move is always among it",
    "wire.touches": "ways in the air are laid clear of the block: a guard, which no job is known to meet; "
    "its test moves the wire by hand",
    "wire.between_targets": "targets are added until the driven wire is on the face: a guard, which no job "
    "is known to meet, with steps of 50 mm and tolerances of 0.05 mm either; its test moves it by hand",
    "forming.springback_mode": "no other mode is a remedy: what it advises is a test piece of metal",
    "forming.trial": "what it advises is a test piece of metal, and nothing of the user's files is wrong",
    "motion.linear_move": "the search looks at moves too and tells motion.no_path or motion.collision: a "
    "guard, which no job is known to meet; its test takes the joints away by hand",
    "motion.timing": "a joint that jumps, which the search excludes: a guard, which no job is known to meet; "
    "its test takes the clock away by hand",
    "post.plan": "a saved plan that no program can carry out was changed: it is planned again",
}  # fmt: skip
"""Why no remedy of a code can be tried here."""

_TO_DO: Final = """
    wire.unstable forming.gap
"""
TO_DO: Final = frozenset(_TO_DO.split())
"""Codes whose remedy nothing follows yet. It only shrinks: a code with a row must not stand here."""
