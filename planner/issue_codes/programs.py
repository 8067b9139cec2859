"""Issue codes of motions and robot programs."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # writing programs
    "post.tasks": IssueCode(
        "the controller has no task or mechanical unit for an arm, or too few", is_input_error=True
    ),
    "post.language": IssueCode(
        "no robot language is available for the controller family of an arm", is_input_error=True
    ),
    "post.controller": IssueCode(
        "the controllers of these arms cannot synchronise them", is_input_error=True
    ),
    "post.signal": IssueCode(
        "a signal has no number on its KUKA or UR controller, or the numbers of two UR arms conflict",
        is_input_error=True,
    ),
    "post.trajectory": IssueCode(
        "no trajectory points follow the path at its speed",
        message="operation {operation}: on the path to target {target_number} ({segment}): {reason}",
    ),
    "post.ur_arm": IssueCode(
        "an arm of the family ur is not one that a UR controller moves",
        is_input_error=True,
        message="arm {arm} ({robot}) is not an arm for a UR controller: {reason}",
    ),
    "post.blend": IssueCode(
        "the tool rotates about its TCP where it must not stop: URScript has no blend for this"
    ),
    "post.turn_near_zero": IssueCode(
        "an axis is so close to zero that a KUKA controller may ignore its turn bit",
        message="operation {operation}: at its first target p_{operation_number}_start {axes} of "
        "arm {arm} is within 2 degrees of zero, where a controller may ignore the turn "
        "bit",
    ),
    "post.krl_turn": IssueCode(
        "a move rotates so far that a KUKA controller may choose another path",
        message="operation {operation}: {move_count} moves of arm {arm} rotate so far that a "
        "controller that swivels and rotates the tool may deviate by {deviation_deg:.2f} "
        "degrees between their ends; largest at {location}, with {rotation_deg:.1f} "
        "degrees",
    ),
    "post.path": IssueCode("the job cannot use spline blocks"),
    "post.spline": IssueCode("the KRL programs contain spline blocks, which were not tested on a controller"),
    "post.spline_left": IssueCode("moves that do not fit into spline blocks remain linear moves"),
    "post.krl_size": IssueCode(
        "the KRL programs are too long for some controllers",
        message="the programs of arm {arm} have {size_mb:.1f} MB; some controllers hold {max_size_mb:g} MB",
    ),
    "post.plan": IssueCode("the plan contains times, joints or paths that no program can execute"),
    "post.action": IssueCode("a process action is at a target where the motion does not stop"),
    "post.name": IssueCode(
        "the name of a segment, tool or signal is invalid in the language or already taken",
        is_input_error=True,
    ),
    "post.tool": IssueCode(
        "the data of a tool cannot be written",
        message="tool {tool!r} has a mass of {mass_kg} kg; {requirement}",
    ),
    "post.frame": IssueCode("targets are in a work frame that the program cannot refer to"),
    "post.option": IssueCode(
        "the controller lacks an option that the programs need",
        message="two arms on one controller need the option {required_option}; the cell lists "
        "{listed_options}",
    ),
    "post.no_split": IssueCode("the program is too long for one module and has no stop at which to split it"),
    "post.handshake_process": IssueCode(
        "two controllers that only share digital signals cannot do this work"
    ),
    "post.handshake_drift": IssueCode(
        "the change of tool distance when one arm is one step ahead of the other",
        message="operation {operation}: {drift}",
    ),
    "post.load": IssueCode("the held block has no weight that can be set in the controller"),
    "control.machine": IssueCode(
        "a field of the machine file is missing, unknown or out of range", is_input_error=True
    ),
    "control.unstable": IssueCode("a gain of force control or compensation would be unstable"),
    "control.band": IssueCode(
        "the force leaves its band at the requested feed",
        message="{machine}: at {feed_mm_s:g} mm/s the gap changes by {gap_speed_mm_s:.3g} mm/s "
        "and the force error is up to {force_error_n:.1f} N, allowed "
        "{max_force_error_n:g} N",
    ),
    "control.range": IssueCode(
        "the corrections exceed what the controller allows",
        message="{machine}: compensation corrects by {correction_mm:.2f} mm, allowed "
        "{max_correction_mm:g} mm",
    ),
    # motion
    "motion.no_reach": IssueCode("an arm cannot reach a target"),
    "motion.station": IssueCode(
        "no position of the track, table or positioner has a path for the operation", is_input_error=True
    ),
    "motion.joint_limit": IssueCode(
        "an arm exceeds a joint limit at a target for all values of its freedoms",
        message="arm {arm} exceeds the limit of axis {axis} at target {target}: {angle_deg:.1f} "
        "deg, allowed {lower_deg:.0f} to {upper_deg:.0f} less {margin_deg:.1f} deg margin",
    ),
    "motion.singular": IssueCode(
        "an arm is too close to a singularity at a target for all values of its freedoms",
        message="arm {arm} is {distance_deg:.1f} deg from a singularity of its {joint} at target "
        "{target} (at least {min_distance_deg:.1f} deg required)",
    ),
    "motion.no_path": IssueCode("no sequence of joint branches passes a target without a jump"),
    "motion.collision": IssueCode("bodies come too close at a target for all values of the freedoms"),
    "motion.linear_move": IssueCode("an arm cannot follow the linear move between two targets"),
    "motion.sag": IssueCode("the pose offset that compensates the compliance of an arm"),
    "motion.sag_range": IssueCode(
        "the compliance of an arm is beyond the compensation range, or too uneven between targets"
    ),
    "motion.overlap": IssueCode("static bodies of the cell overlap"),
    "motion.home": IssueCode(
        "an arm at its home position is too close to a body",
        message="at home {first_body} and {second_body} {separation} (at least "
        "{min_distance_mm:.1f} mm required)",
    ),
    "motion.entry": IssueCode(
        "an arm has no collision-free path between home and its first or last target",
        message="arm {arm} has no free path from home to {target}: {first_body} and "
        "{second_body} are {distance_mm:.1f} mm apart {position} (at least "
        "{min_distance_mm:.1f} mm required)",
    ),
    "motion.timing": IssueCode(
        "no timing was found for a section of the path",
        message="no feasible timing was found for the moves up to target {target}",
    ),
    "motion.feed_min": IssueCode("the arms cannot make a move as fast as the process requires"),
    "motion.stops": IssueCode(
        "the arm stops at corners that it would otherwise pass very slowly",
        message="the arm stops at {stop_count} targets, first at {target}, where it would have "
        "to pass a sharp corner at less than a third of the feed",
    ),
    "motion.short_moves": IssueCode(
        "moves are so short in time or length that the controller may stop there",
        message="{moves} shorter than {min_time_s:g} s or {min_length_mm:g} mm, first the move "
        "to {target}; the shortest take {shortest_time_s:.3f} s and "
        "{shortest_length_mm:.3f} mm: a controller may stop there",
    ),
    "motion.no_placement": IssueCode("no stock position was found from which the whole job is feasible"),
    "motion.path_kept": IssueCode(
        "the optimised path violates the clearance, so the path of the graph search is used"
    ),
    "motion.like": IssueCode("what was reused from the reference plan, and what was not"),
    "motion.solver": IssueCode("this build of Drake lacks the solvers that optimise a path"),
}
