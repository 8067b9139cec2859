"""Codes whose remedies are tried elsewhere, cannot be tried, or are still to be: see ``remedy_rows``."""

from __future__ import annotations

from typing import Final

from planner.issue_codes import CODES

ELSEWHERE: Final = {
    "forming.force": ("test_acceptance", "test_an_error_says_how_it_is_accepted_and_following_that_works"),
    "milling.too_large": (
        "verify/test_mill_places",
        "test_what_is_too_large_is_refused_by_the_planner_first_and_not_proven",
    ),
    "part.mesh_noise": (
        "test_sheet_file",
        "test_noise_beyond_the_stated_tolerance_is_told_and_its_remedy_works",
    ),
}
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
    {"verify.no_programs", "verify.files", "verify.problem_differs", "verify.duration", "verify.unread"}
)
"""Codes of proofs that a user can do something about but undo a change."""
NONE: Final = {
    **{code: UNDO for code in CODES if code.startswith("verify.") and code not in FOLLOWED},
    **dict.fromkeys(("internal.error", "claims.unproven", "claims.none"), OURS),
    **dict.fromkeys(("report.exhibit", "plan.not_saveable"), OURS),
    **dict.fromkeys(("part.extra_missing", "sign.extra", "batch.install", "service.install"), INSTALL),
    **dict.fromkeys(("catalogue.missing_data", "plan.missing_file", "plan.damaged", "plan.schema"), DAMAGED),
    **dict.fromkeys(("part.ruled_deviation", "part.strips_found", "sign.good"), FACT),
    **dict.fromkeys(("wire.chosen", "straight.slit"), FACT),
    **dict.fromkeys(
        (
            "batch.crashed", "batch.timeout", "batch.memory", "batch.cancelled", "batch.worker",
            "batch.cluster", "batch.versions", "batch.in_use", "service.database", "service.start",
            "service.token", "service.foreign", "service.too_many", "service.stopping", "service.storage",
            "service.check_stopped", "service.gave_up", "service.answer", "report.replay_failed",
        ),
        STATE,
    ),
    "sign.unproven": "what is not proven is planned again, then signed: see verify.*",
    "sign.signature": "a text or signature that somebody changed cannot be mended, only signed again",
    "sign.content": "a result that somebody changed is planned or fetched again",
    "sign.missing": "who made the result signs it; the reader cannot",
    "wire.no_equilibrium": "of the solver, for callers of the library; jobs are told wire.shape and its kin",
    "wire.no_stable_shape": "of the solver, for callers of the library; jobs are told wire.unstable",
    "post.plan": "a saved plan that no program can carry out was changed: it is planned again",
}  # fmt: skip
"""Why no remedy of a code can be tried here."""

_TO_DO: Final = """
    output.folder
    kerf.unsettled kerf.doubt
    part.edges
    wire.held wire.unstable wire.touches wire.between_targets
    straight.uneven
    post.turn_near_zero post.krl_turn post.path post.spline post.spline_left post.krl_size post.action
    post.tool post.frame post.no_split post.handshake_process post.handshake_drift post.load
    verify.files verify.problem_differs verify.duration verify.unread verify.no_programs
    sign.key
    milling.tool milling.no_surface milling.guides milling.guide_lengths milling.holder milling.gouge
    milling.front milling.pattern milling.off_surface
    forming.wall_angle forming.support_radius forming.gap
    forming.shift forming.support_tool forming.die_gouge forming.die_far forming.holder
    forming.holder_step forming.clamp forming.clear forming.trial forming.force_input
    forming.adsif_table forming.adsif_conditions forming.adsif_unstable forming.adsif_compliance
    forming.path_options forming.no_contour forming.open_contour forming.unreached forming.hole
    forming.touching forming.step
    gcode.syntax gcode.word gcode.mode gcode.spindle gcode.rotary gcode.axis gcode.arc gcode.position
    gcode.tool gcode.offset gcode.empty gcode.after_end gcode.skipped
    motion.joint_limit motion.singular motion.no_path motion.collision motion.linear_move motion.home
    motion.entry motion.timing motion.feed_min motion.stops motion.short_moves motion.no_placement
    motion.path_kept
    service.request service.not_found service.unknown_job service.unknown_file service.not_uploaded
    service.file_name service.archive service.too_large
"""
TO_DO: Final = frozenset(_TO_DO.split())
"""Codes whose remedy nothing follows yet. It only shrinks: a code with a row must not stand here."""
