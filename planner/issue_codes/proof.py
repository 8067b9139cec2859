"""Issue codes of the proof."""

from typing import Final

from planner.issue_codes.row import IssueCode

_MOVE_STOCK: Final = "move or rotate the stock, and plan again"
_LOWER_FEED: Final = "lower the feed there, or round the corner with more targets, and plan again"
_REDUCE_SPACING: Final = "reduce the target spacing (tangent_deg, chord_mm), and plan again"

CODES: Final[dict[str, IssueCode]] = {
    # proof of the programs
    "verify.syntax": IssueCode(
        "the program is not valid in its language, or has no unique linear control flow"
    ),
    "verify.declarations": IssueCode(
        "a name in the program is undeclared, has no value or has the wrong type"
    ),
    "verify.pers_literal": IssueCode("persistent data must be initialised with a literal"),
    "verify.names": IssueCode("a name in the program is invalid, too long or already taken"),
    "verify.line_length": IssueCode("a line or string of the program is too long"),
    "verify.module_size": IssueCode("a module exceeds the maximum number of moves or bytes"),
    "verify.decimals": IssueCode("target values have too few decimals, or a quaternion is not normalised"),
    "verify.files": IssueCode("program files are missing or superfluous, or differ from the file list"),
    "verify.digest": IssueCode("the programs were not written for this problem"),
    "verify.problem_differs": IssueCode(
        "the problem in the result folder differs from the problem of the proof"
    ),
    "verify.task_list": IssueCode("a synchronisation point does not list all tasks"),
    "verify.sync_order": IssueCode(
        "the tasks do not pass the same synchronisation points in the same order, each exactly once"
    ),
    "verify.handshake": IssueCode(
        "two controllers that share signals may deadlock, lose a signal or lose synchronisation"
    ),
    "verify.step_apart": IssueCode(
        "arms that may be one step ahead of each other come too close, or the gap of their "
        "tools is outside its tolerance"
    ),
    "verify.meeting_time": IssueCode(
        "a rendezvous aborts the run when the other side is late, or may never end"
    ),
    "verify.error_handler": IssueCode(
        "an error handler is missing, continues the program, or does not switch off, stop and report"
    ),
    "verify.undo": IssueCode(
        "leaving a procedure early would leave the power on or a synchronised block open"
    ),
    "verify.motion_settings": IssueCode("settings make the moves slower than their programmed times"),
    "verify.move_count": IssueCode("the tasks have different numbers of moves in a synchronised block"),
    "verify.move_ids": IssueCode("IDs of synchronised moves are missing, differ or do not increase"),
    "verify.zone_kind": IssueCode("of two simultaneous moves, one stops and the other does not"),
    "verify.move_time": IssueCode("simultaneous moves have no time or different times"),
    "verify.duration": IssueCode("the programs are too long, or a face has too many facets, for the proof"),
    "verify.setup": IssueCode(
        "a setup is not announced, not confirmed exactly once and in order, or an arm moves "
        "before its confirmation"
    ),
    "verify.dialogue": IssueCode("an operator message or question differs from what the problem requires"),
    "verify.dialogue_figures": IssueCode("a value in an operator message differs from the motion"),
    "verify.signals": IssueCode(
        "a signal that is not the wire's is switched, or is switched in a way that cannot be followed"
    ),
    "verify.held_frame": IssueCode("work on a held block is not in the frame of the arm that holds it"),
    "verify.load": IssueCode(
        "the controller does not have the load of the held block, or keeps it after release"
    ),
    "verify.bow": IssueCode("a clamp of a straight wire comes too close to the foam"),
    "verify.rulings": IssueCode("a straight wire deviates from the rulings of the surface, or misses some"),
    "verify.order": IssueCode("cuts are in another order than the operation states"),
    "verify.part": IssueCode(
        "the wire cuts into the part during approach or retreat, or into another surface"
    ),
    "verify.slit": IssueCode(
        "the wire approaches a cut from another side than stated, or through a slit that is too long"
    ),
    "verify.kerf": IssueCode("the slot is narrower or wider than required at the actual speed of the wire"),
    "verify.cell_check": IssueCode(
        "the program moves before it compares the controller's frames with the plan"
    ),
    "verify.start_posture": IssueCode("a trajectory starts from joints that are not checked, or not at home"),
    "verify.goal_tolerances": IssueCode(
        "a trajectory continues at a larger path deviation than the cell allows"
    ),
    "verify.power_on_failure": IssueCode("an output stays on if a trajectory step fails"),
    "verify.between_points": IssueCode("the tool leaves the straight line between two trajectory points"),
    "verify.controller_files": IssueCode(
        "controller files are missing, changed, or belong to other programs"
    ),
    "verify.hidden": IssueCode("code outside the linear control flow runs or may run: it is not proven"),
    "verify.speed_data": IssueCode("the speed data of a move are below path length over time"),
    "verify.arms_alone": IssueCode("two arms move at the same time without synchronisation"),
    "verify.wire_alone": IssueCode("an arm moves alone while a wire is mounted"),
    "verify.stop_before_logic": IssueCode(
        "an arm does not stop before a signal, wait or synchronisation point"
    ),
    "verify.tool_data": IssueCode("the tool data of the program differ from the cell"),
    "verify.work_object": IssueCode("a work object is not at the pose of the stock"),
    "verify.rests": IssueCode("the block is not held or supported as required"),
    "verify.base_frames": IssueCode("the base frame of the program differs from the problem"),
    "verify.move_kinds": IssueCode("the path of a move is unknown, or ConfL is not set as the arm needs it"),
    "verify.external_axes": IssueCode(
        "the unit, values or moves of a track, table or positioner are not as required"
    ),
    "verify.track_along": IssueCode("a coordinated track violates its motion law or exceeds its limits"),
    "verify.track_way": IssueCode(
        "bodies come too close while a track, table or positioner moves to a station"
    ),
    "verify.zone_size": IssueCode("a zone is larger than half of the shorter adjacent move"),
    "verify.zero_length": IssueCode("a move has zero length"),
    "verify.wire_mount": IssueCode("mounting or removing the wire is not confirmed"),
    "verify.reach": IssueCode("an arm cannot follow the path of the program", remedy=_MOVE_STOCK),
    "verify.corner": IssueCode("a zone blends a joint move with a linear move"),
    "verify.continuity": IssueCode("the joint solution changes between two moves"),
    "verify.confdata": IssueCode("the configuration data do not select the joint solution of the motion"),
    "verify.status": IssueCode("Status and Turn of a KRL target do not uniquely select the joint solution"),
    "verify.joint_limits": IssueCode(
        "a joint exceeds its limits",
        remedy=f"{_MOVE_STOCK}; settings.joint_margin_deg is the margin to the limits",
    ),
    "verify.rod_limits": IssueCode(
        "axis 3 of a parallel-rod arm, as its controller counts it, exceeds its limits",
        remedy="use a longer or thinner wire, and plan again",
    ),
    "verify.joint_speed": IssueCode(
        "the programmed times require a joint speed above the limit of the robot", remedy=_LOWER_FEED
    ),
    "verify.joint_acceleration": IssueCode(
        "the programmed times require a joint acceleration above the limit of the robot", remedy=_LOWER_FEED
    ),
    "verify.spline": IssueCode("the uncertainty of a spline block's curve leaves too little margin"),
    "verify.singularity": IssueCode(
        "an arm comes too close to a singularity",
        remedy=f"{_MOVE_STOCK}; settings.singularity_margin_deg is the margin to singularities",
    ),
    "verify.tcp_speed": IssueCode(
        "a tool exceeds the TCP speed that the problem allows",
        remedy="lower the feed, and plan again; settings.tcp_speed_mm_s is the limit",
    ),
    "verify.unknown_start": IssueCode(
        "a move with an unknown start may be too fast, or a joint move has a time"
    ),
    "verify.power_idle": IssueCode("power stays on too long while nothing moves or during a wait"),
    "verify.follows": IssueCode("a tool does not pass through the given poses"),
    "verify.wire_length": IssueCode(
        "the ends of the wire are too far apart, or no wire shape meets both clamps"
    ),
    "verify.wire_stability": IssueCode("the wire shape is unstable, or snaps to another shape"),
    "verify.curvature": IssueCode("the wire is bent beyond its elastic limit"),
    "verify.contact": IssueCode("the wire touches the stock where it must not cut"),
    "verify.stop_in_foam": IssueCode("the wire stops inside the stock"),
    "verify.wire_power": IssueCode(
        "the wire is not powered in the stock, is powered near an operator, or is on too briefly"
    ),
    "verify.feed": IssueCode("the speed of the wire in the stock is outside the feed window"),
    "verify.sag": IssueCode(
        "the compliance compensation of an arm differs from the problem, or is too large"
    ),
    "verify.kinematics": IssueCode("a link or tool is not at its forward-kinematics pose"),
    "verify.robot_model": IssueCode(
        "the URDF of a robot is unreadable, or differs from the robot that was planned with"
    ),
    "verify.clearance": IssueCode(
        "bodies of the cell come too close to each other",
        remedy="move the obstacle or the stock, and plan again",
    ),
    "verify.own_clearance": IssueCode(
        "links or tool of one arm come too close to each other",
        remedy="mount the tool differently, or give targets more rotational freedom, and plan again",
    ),
    "verify.wire_clearance": IssueCode(
        "the wire comes too close to a body", remedy="move the body that is too close, and plan again"
    ),
    "verify.part_file": IssueCode("the programs do not make the part that the proof reads from its file"),
    "verify.surface": IssueCode("too little of the cut surface is within tolerance"),
    "verify.gouge": IssueCode(
        "a forming tool cuts into the face that it forms, or penetrates the flat sheet",
        remedy="use a smaller forming tool or larger radii of the part, and plan again",
    ),
    "verify.formed": IssueCode(
        "too little of a face is formed, the ball loses contact for too long, or a face has no claim"
    ),
    "verify.gap": IssueCode(
        "the gap or the relative orientation of two forming tools is outside its tolerance",
        remedy=_REDUCE_SPACING,
    ),
    "verify.border": IssueCode("a support leaves the border of the formed area, or cuts across it"),
    "verify.opposite": IssueCode("a following tool is not opposite the forming tool"),
    "verify.sheet": IssueCode(
        "a forming tool collides with a formed wall, or penetrates the sheet",
        remedy="use a slimmer tool, another order or a tilted tool (lean_deg), and plan again",
    ),
    "verify.holder": IssueCode("the signal of the sinking clamp is not pulsed at each formed level"),
    "verify.adsif": IssueCode(
        "tools of ADSIF forming are not at the positions of the response table", remedy=_REDUCE_SPACING
    ),
    "verify.forming_part": IssueCode(
        "the forming passes do not make the part, or not in the required order and shapes"
    ),
    "verify.forming_holes": IssueCode(
        "a formed area or a forming tool comes too close to a curve that was cut before"
    ),
    "verify.forming_claims": IssueCode(
        "the claims of a pass do not follow from the part and the values of the user"
    ),
    "verify.feature_order": IssueCode(
        "the forming segments are not those of the claims, each exactly once and in order"
    ),
    "verify.springback": IssueCode(
        "the overforming of the tools differs from the springback file, or that file is wrong "
        "or makes walls too steep",
        remedy="write the file again (tandem springback PROBLEM --write FILE) and plan again",
    ),
    "verify.level": IssueCode(
        "a level of a pass is not the stated one, or differs from its file, or that file "
        "belongs to another job, exceeds its limits or makes walls too steep",
        remedy="write problem and file again (tandem next-loop OUT --problem FILE) and plan again",
    ),
    "verify.forming_feed": IssueCode("a tool exceeds the feed on the sheet"),
    "verify.lean": IssueCode("the tilt of a forming tool exceeds the limit of the problem"),
    "verify.ridge": IssueCode("a ridge or groove remains on the cut surface"),
    # passes over a sheet, and the tool that supports it
    "verify.milled": IssueCode(
        "a milled surface is outside its tolerance, or material without a claim is milled",
        remedy="use a smaller cutter or finer steps, and plan again",
    ),
    "verify.mill_gouge": IssueCode(
        "the cutter, shank, holder or spindle cuts into the part",
        remedy="use a smaller or slimmer cutter, or tilt its axis, and plan again",
    ),
    "verify.mill_path": IssueCode("the tip or axis of a cutter deviates from its curve"),
    "verify.mill_feed": IssueCode(
        "the cutter exceeds its feed, or a milling segment has no feed",
        remedy="lower the feed, and plan again",
    ),
    "verify.spindle": IssueCode(
        "the spindle is not at speed while the cutter is in the block, or runs where nothing is milled"
    ),
    # curves cut out of a formed sheet
    "verify.trim_cut": IssueCode(
        "an outline of a trimmed sheet is not cut as required, or has gaps other than its micro-joints"
    ),
    "verify.trim_kept": IssueCode("a torch, mill or knife cuts into material that must remain"),
    "verify.trim_torch": IssueCode("the stand-off or tilt of a cutting torch is outside its limits"),
    "verify.trim_arc": IssueCode(
        "an arc starts at the wrong position, is not waited for, or burns where nothing is cut"
    ),
    "verify.trim_order": IssueCode("an outline is cut before an outline inside it"),
    "verify.trim_feed": IssueCode(
        "the torch is faster or slower than the sheet thickness requires", remedy=_LOWER_FEED
    ),
    "verify.trim_mill": IssueCode(
        "a trimming mill has the wrong depth, tilts too far, enters the sheet in a forbidden "
        "way, or leaves its slot"
    ),
    "verify.trim_spindle": IssueCode(
        "a mill or knife is in the sheet before its drive is up to speed, or the drive runs elsewhere"
    ),
    "verify.trim_knife": IssueCode(
        "a trimming knife has the wrong depth, deviates or tilts from its curve, or rotates in the sheet"
    ),
    "verify.trim_clear": IssueCode("a tool comes too close to the sheet that it trims"),
    "verify.unread": IssueCode(
        "a line of a third-party program is not understood, or one of its moves is not proven"
    ),
    "verify.no_programs": IssueCode(
        "the result folder contains no programs",
        message="{folder}: no programs found; plan the problem first",
    ),
}
