"""Table of all issue codes, used by the code, the tests, ``tandem issues`` and the documentation.

A code has the form ``area.problem`` and is stable once released. Plug-ins add their own rows
(:func:`all_codes`).
"""

import dataclasses
from collections.abc import Mapping
from typing import Final


@dataclasses.dataclass(frozen=True)
class Code:
    """One row of the table of issue codes.

    Issues may only be accepted where the user may know better than Tandem: forces, metals, supports of
    blocks. Issues that make a motion wrong (collisions, limits, unstable wires, slot widths) never may be.

    Attributes:
        meaning: What the code means, as a phrase without a full stop.
        given: Whether the input is at fault (exit code 2) rather than the motion (exit code 3).
        accepts: What a problem accepts that lists the code under ``accept``, or None if it may not.
        remedy: Remedy for issues that state none of their own.
    """

    meaning: str
    given: bool = False
    accepts: str | None = None
    remedy: str | None = None


_PLACE: Final = "move or rotate the stock, and plan again"
_SLOWER: Final = "lower the feed there, or round the corner with more targets, and plan again"
_NEARER: Final = "reduce the target spacing (tangent_deg, chord_mm), and plan again"

CODES: Final[dict[str, Code]] = {
    # problem files
    "problem.missing_file": Code("a file that the problem names does not exist", given=True),
    "problem.not_yaml": Code("the problem file is not valid YAML", given=True),
    "problem.field": Code("a field of the problem file is missing, unknown or out of range", given=True),
    "problem.duplicate_name": Code("two items of the same kind have the same name", given=True),
    "problem.track": Code("tracks are not supported for this controller", given=True),
    "problem.turntable": Code(
        "turntables and positioners are not supported for this controller, or the block is not on it",
        given=True,
    ),
    "problem.too_large": Code("a file exceeds the size limit", given=True),
    "problem.unknown_robot": Code("the robot is not in the catalogue", given=True),
    # robots from files
    "robot.urdf": Code("the robot file is not a readable URDF", given=True),
    "robot.chain": Code(
        "the URDF chain from base to tip is missing, or has mimic or prismatic joints", given=True
    ),
    "robot.limits": Code("a URDF joint has no range or no maximum speed", given=True),
    "robot.bodies": Code("collision bodies of a robot are missing or enclose no volume", given=True),
    "robot.unseen": Code(
        "links of a robot have no visual mesh and are shown by their collision bodies", given=True
    ),
    "robot.not_opw": Code("the kinematic class of the arm is not supported", given=True),
    "robot.deviation": Code("the closed-form kinematics of an arm deviate from its URDF", given=True),
    "problem.unknown_arm": Code("an operation names an arm that is not in the cell", given=True),
    "problem.unknown_process": Code("an operation names an unknown process", given=True),
    "problem.process_package": Code(
        "an installed process cannot be loaded, or its name is already taken", given=True
    ),
    "problem.not_finite": Code("a number is NaN or infinite", given=True),
    "problem.accepted": Code("the problem accepts an issue that does not occur", given=True),
    # blocks that are held, and what is known of them
    "stock.gripper": Code("the arm that should hold the block has no gripper"),
    "stock.foam_missing": Code("the foam of the block is required but not stated"),
    "stock.too_heavy": Code("block and gripper exceed the payload of the arm that holds them"),
    "stock.grip_force": Code("the gripper does not hold the block firmly enough"),
    "stock.grip_chosen": Code("the chosen gripper, and where it holds the block"),
    "stock.support": Code(
        "the support does not reach the floor, or the block does not rest on it",
        accepts="the support does not reach the floor, or the block does not rest on it",
    ),
    "stock.hangs": Code("no support is stated for the block", accepts="no support is stated for the block"),
    "stock.footprint": Code("the gripper face lies outside the bottom face of the block or part"),
    # building elements
    "element.surface": Code(
        "the surface of an element has holes or folds, touches itself, does not fill a "
        "rectangle, or is too narrow for adjacent panels",
        given=True,
    ),
    "element.wire": Code("no wire is long enough for the smallest panel at a position of the element"),
    "element.tolerance": Code("panels deviate from the surface of the element by more than the tolerance"),
    "element.shape": Code("panels of an element self-intersect, fold over, tilt too far or are too small"),
    "element.count": Code("the row layout gives another number of quad panels than requested"),
    "element.concave": Code("planar panels of an element have concave corners"),
    "element.assembly": Code(
        "panels of an element have no collision-free straight insertion path in any tested order"
    ),
    "element.dowels": Code(
        "panels are inserted without dowels: the insertion path is too oblique, or there is no "
        "space for a dowel"
    ),
    "element.block": Code("no block holds the panel at a position of the element"),
    "element.held": Code("panels that no wire can cut safely, listed where they cannot be avoided"),
    "element.run": Code("the report needs an element batch whose panels are all proven", given=True),
    "element.mark": Code(
        "the marked panel is not in the element, or the list of marks is invalid or belongs to other panels",
        given=True,
    ),
    "element.joint": Code("adjacent panels of an element meet with a larger step than requested"),
    "element.face": Code(
        "panel faces deviate from the written surface, or their slot is on the side of the panel"
    ),
    "element.raw_block": Code("the block of a panel fits none of the raw blocks of its foam"),
    "element.cut": Code("the bow cannot reach some cuts of raw blocks from any direction"),
    "element.stock": Code("the list of leftover foam is invalid or has invalid rows", given=True),
    "element.jobs": Code(
        "a template of the element is invalid, or a panel matches no template or several", given=True
    ),
    # catalogue and cell
    "catalogue.missing_data": Code("a data file of the Tandem installation is missing or unreadable"),
    "cell.body_name": Code("the name of a cell body is reserved or already taken", given=True),
    # saved plans
    "output.folder": Code(
        "the output folder is not writable, or contains the problem file itself", given=True
    ),
    "output.disk_full": Code("the disk of the output folder is full"),
    "plan.missing_file": Code("a file of a saved plan is missing or unreadable"),
    "plan.damaged": Code("a file of a saved plan is damaged"),
    "plan.schema": Code("a saved plan has another format or schema version"),
    "plan.not_saveable": Code("a plan contains a value that is neither an array nor plain data"),
    # report
    "report.exhibit": Code("an exhibit of a process has an invalid form and is left out of the report"),
    # the general door, process: targets
    "targets.file": Code(
        "a targets file is unreadable, or a value in it is missing or out of range", given=True
    ),
    "targets.held": Code("given poses are not supported for a block that an arm holds", given=True),
    "targets.freedom": Code("a free axis needs exactly one of rotation and translation", given=True),
    # wire shapes
    "wire.too_short": Code("the wire is shorter than the distance between its clamps"),
    "wire.unknown_material": Code("unknown wire material", given=True),
    "wire.size": Code("the size of a wire or strip is missing, contradictory or not positive", given=True),
    "wire.temperature": Code("the wire temperature is outside the range of its material", given=True),
    "wire.no_equilibrium": Code("the solver found no equilibrium of the heavy wire near the initial guess"),
    # kerf of a hot wire
    "kerf.unknown_foam": Code("unknown foam", given=True),
    "kerf.no_data": Code("the foam has no test cuts, or not those that the kerf model needs", given=True),
    "kerf.model": Code("unknown kerf model", given=True),
    "kerf.input": Code("power, speed, width and thickness must be positive numbers", given=True),
    "kerf.impossible": Code("no wire, speed or power produces this kerf", given=True),
    "kerf.melts": Code("at this power the wire reaches its limit temperature in air", given=True),
    "kerf.file": Code(
        "a file of test cuts is unreadable, or a value in it is missing or out of range", given=True
    ),
    "kerf.few_cuts": Code("too few test cuts remain, or all have the same speed and power", given=True),
    "kerf.no_trend": Code("the kerf of the test cuts does not increase with power over speed", given=True),
    "kerf.foam_file": Code("a field of the foam file is missing, unknown or out of range", given=True),
    "kerf.too_hot": Code("the slot is too wide for a usable face: the wire burns the foam", given=True),
    "kerf.too_cold": Code("the slot is too narrow for a usable face: the wire drags", given=True),
    "kerf.unsettled": Code(
        "one end of the wire almost stops at the surface: no kerf is consistent with its own speed",
        given=True,
    ),
    "kerf.doubt": Code("the kerf model is used outside its tested range", given=True),
    # meshes and parts
    "mesh.unreadable": Code("the mesh file has an unsupported format or is damaged", given=True),
    "mesh.empty": Code("the mesh file has no faces with a positive area", given=True),
    "mesh.unit": Code(
        "the mesh is implausibly large or small in its unit, or states another unit than the problem",
        given=True,
    ),
    "mesh.file_unit": Code("the unit that the mesh file states and that was used", given=True),
    "mesh.non_manifold": Code("more than two faces of the mesh share an edge", given=True),
    "mesh.orientation": Code("adjacent faces of the mesh have opposite normals", given=True),
    "mesh.closed": Code("the mesh is closed, but an open face is required", given=True),
    "mesh.pieces": Code("the mesh has several separate pieces, but one is required", given=True),
    "part.mesh_noise": Code(
        "the estimated noise of the mesh of a part, and the smooth face that was fitted", given=True
    ),
    "part.mesh_tolerance": Code("the mesh tolerance is too large for the part", given=True),
    "part.offset": Code("the curvature radius of the face is smaller than the offset distance", given=True),
    "part.stock_too_small": Code("the part does not fit into the block", given=True),
    "part.faces": Code("the front and back faces of a part are not on each other's inner side", given=True),
    "part.missing_face": Code("a face to cut does not exist in the part", given=True),
    "part.naca": Code("the digits belong to no NACA family", given=True),
    "part.airfoil_format": Code("the airfoil file is in neither Selig nor Lednicer format", given=True),
    "part.airfoil_order": Code("the points of the airfoil are in the wrong order", given=True),
    "part.airfoil_open": Code("the airfoil has no trailing edge, or only one side", given=True),
    "part.airfoil_points": Code("the airfoil has too few points", given=True),
    "part.airfoil_crossing": Code("the airfoil intersects itself", given=True),
    "part.airfoil_note": Code(
        "the airfoil was corrected: point order, chord or duplicate points", given=True
    ),
    "part.wing": Code("the shape of the wing is implausible", given=True),
    "part.ruled_shape": Code(
        "the ruled surface has rulings of zero length, or folds over itself", given=True
    ),
    "part.corners": Code("the two guide curves have different numbers of corners", given=True),
    "part.guide": Code("the guide curve has too few points, zero length, or intersects itself", given=True),
    "part.guide_turned": Code("the guide curve was reversed so that the rulings do not cross", given=True),
    "part.outline_open": Code("the outline is not closed", given=True),
    "part.outline_crossing": Code("the outline intersects itself", given=True),
    "part.outline_overlap": Code("outlines cross or touch each other", given=True),
    "part.outline_duplicate": Code("the same outline occurs twice", given=True),
    "part.extra_missing": Code("reading the file requires a package of an optional extra", given=True),
    "part.dxf": Code("the DXF file is unreadable, or contains none of the required entities", given=True),
    "part.dxf_left_out": Code("unsupported entities of the DXF file were skipped", given=True),
    "part.dxf_unit": Code("the DXF file states another unit than the problem", given=True),
    "part.rhino": Code(
        "the Rhino file is unreadable, or lacks the required objects, or has several of them", given=True
    ),
    "part.rhino_unit": Code("the unit in which the Rhino file was read", given=True),
    "part.rhino_left_out": Code("objects of the Rhino file were skipped or converted", given=True),
    "part.rhino_facets": Code(
        "the measured deviation of the facets from the face of the Rhino file", given=True
    ),
    "part.step": Code(
        "the STEP or IGES file is unreadable, or does not contain the required face", given=True
    ),
    "part.step_unit": Code("the unit in which the STEP or IGES file was read", given=True),
    "part.step_facets": Code(
        "the measured deviation of the facets from the face of the STEP or IGES file", given=True
    ),
    "part.edges": Code("straight edges cannot join the boundaries of front and back", given=True),
    "part.patch": Code("the mesh is not a patch with one boundary and four corners", given=True),
    "part.not_ruled": Code(
        "the surface deviates from every ruled surface by more than its tolerance", given=True
    ),
    "part.ruled_deviation": Code("the deviation of the surface from its ruled approximation", given=True),
    "part.strips": Code(
        "no number of ruled strips meets the tolerance of the surface, or a strip does not exist", given=True
    ),
    "part.strips_found": Code("the strips of the surface: number, deviations and kinks", given=True),
    # planning a bent wire
    "wire.held": Code("an elastic wire cannot cut a block that an arm holds"),
    "wire.chosen": Code("the chosen wire, and why"),
    "wire.shape": Code("the elastic wire deviates from the face by more than the tolerance"),
    "wire.curvature": Code("the planned wire is bent beyond its elastic limit"),
    "wire.unstable": Code("the planned wire shape is unstable or almost unstable, in or out of its plane"),
    "wire.weight": Code("the weight of the wire moves it out of tolerance"),
    "wire.end_error": Code("position errors of the wire ends move the wire out of tolerance"),
    "wire.touches": Code("the wire comes too close to the block where it does not cut"),
    "wire.between_targets": Code("the wire leaves its required shape between two targets"),
    # planning a straight wire
    "bow.missing": Code("the cutting arm has no bow with a straight wire"),
    "bow.arms": Code("the operation must name the arm with the bow and the arm that holds the block"),
    "bow.span": Code("the foam is wider than the wire of the bow minus its margins"),
    "bow.throat": Code("the block is deeper than the throat of the bow on every side of the wire"),
    "straight.trim": Code("a side should be trimmed, but the block has no oversize there"),
    "straight.corner": Code("an inner corner or curve is tighter than half the kerf"),
    "straight.crossing": Code("while cutting one piece of a surface, the wire cuts into another"),
    "straight.uneven": Code("the slot width changes faster along the path than the wire can follow"),
    "straight.slit": Code("the wire reaches a hole through a slit in the part"),
    "straight.lead": Code("the approach to an outline would cut through the part"),
    "straight.drop": Code(
        "material above a level cut drops by one kerf before it is cut itself",
        accepts="cut material drops by one kerf before it is cut itself",
    ),
    "part.missing_surface": Code("a ruled surface to cut does not exist in the part", given=True),
    # writing programs
    "post.tasks": Code("the controller has no task or mechanical unit for an arm, or too few", given=True),
    "post.language": Code("no robot language is available for the controller family of an arm", given=True),
    "post.controller": Code("the controllers of these arms cannot synchronise them", given=True),
    "post.signal": Code(
        "a signal has no number on its KUKA or UR controller, or the numbers of two UR arms conflict",
        given=True,
    ),
    "post.trajectory": Code("no trajectory points follow the path at its speed"),
    "post.ur_arm": Code("an arm of the family ur is not one that a UR controller moves", given=True),
    "post.blend": Code(
        "the tool rotates about its TCP where it must not stop: URScript has no blend for this"
    ),
    "post.turn_near_zero": Code("an axis is so close to zero that a KUKA controller may ignore its turn bit"),
    "post.krl_turn": Code("a move rotates so far that a KUKA controller may choose another path"),
    "post.path": Code("the job cannot use spline blocks"),
    "post.spline": Code("the KRL programs contain spline blocks, which were not tested on a controller"),
    "post.spline_left": Code("moves that do not fit into spline blocks remain linear moves"),
    "post.krl_size": Code("the KRL programs are too long for some controllers"),
    "post.plan": Code("the plan contains times, joints or paths that no program can execute"),
    "post.action": Code("a process action is at a target where the motion does not stop"),
    "post.name": Code(
        "the name of a segment, tool or signal is invalid in the language or already taken", given=True
    ),
    "post.tool": Code("the data of a tool cannot be written"),
    "post.frame": Code("targets are in a work frame that the program cannot refer to"),
    "post.option": Code("the controller lacks an option that the programs need"),
    "post.no_split": Code("the program is too long for one module and has no stop at which to split it"),
    "post.handshake_process": Code("two controllers that only share digital signals cannot do this work"),
    "post.handshake_drift": Code("the change of tool distance when one arm is one step ahead of the other"),
    "post.load": Code("the held block has no weight that can be set in the controller"),
    # proof of the programs
    "verify.syntax": Code("the program is not valid in its language, or has no unique linear control flow"),
    "verify.declarations": Code("a name in the program is undeclared, has no value or has the wrong type"),
    "verify.pers_literal": Code("persistent data must be initialised with a literal"),
    "verify.names": Code("a name in the program is invalid, too long or already taken"),
    "verify.line_length": Code("a line or string of the program is too long"),
    "verify.module_size": Code("a module exceeds the maximum number of moves or bytes"),
    "verify.decimals": Code("target values have too few decimals, or a quaternion is not normalised"),
    "verify.files": Code("program files are missing or superfluous, or differ from the file list"),
    "verify.digest": Code("the programs were not written for this problem"),
    "verify.problem_differs": Code("the problem in the result folder differs from the problem of the proof"),
    "sign.extra": Code("signatures require a package that is not installed"),
    "sign.key": Code("the key file for signatures is unusable"),
    "sign.unproven": Code("only a proven result can be signed"),
    "sign.missing": Code("the result is not signed"),
    "sign.signature": Code("the signature was not made with the given keys, or not for this text"),
    "sign.content": Code("the result differs from the signed one"),
    "sign.good": Code("the result is signed and unchanged"),
    "upload.unproven": Code(
        "the result is not verified, or its files differ from those of its proof", given=True
    ),
    "upload.release": Code(
        "the release of the result is withdrawn, is for other programs, or is required but missing",
        given=True,
    ),
    "upload.address": Code("the address of a controller, or what to send to it, is not stated", given=True),
    "upload.controller": Code("the controller is unreachable, or gives an unexpected answer"),
    "upload.login": Code("the controller rejects the login, or its certificate is not trusted"),
    "upload.busy": Code("the controller is running, in manual mode, or controlled by another client"),
    "upload.write": Code("a file on the controller differs from the file that was sent"),
    "upload.differs": Code("the controller differs from the one that the programs were planned for"),
    "upload.not_looked_at": Code("a property of the controller was not read and therefore not compared"),
    "upload.missing": Code("the expected programs are not on the controller"),
    "upload.touched": Code("a target or data value on the controller differs from the result"),
    "verify.task_list": Code("a synchronisation point does not list all tasks"),
    "verify.sync_order": Code(
        "the tasks do not pass the same synchronisation points in the same order, each exactly once"
    ),
    "verify.handshake": Code(
        "two controllers that share signals may deadlock, lose a signal or lose synchronisation"
    ),
    "verify.step_apart": Code(
        "arms that may be one step ahead of each other come too close, or the gap of their "
        "tools is outside its tolerance"
    ),
    "verify.meeting_time": Code("a rendezvous aborts the run when the other side is late, or may never end"),
    "verify.error_handler": Code(
        "an error handler is missing, continues the program, or does not switch off, stop and report"
    ),
    "verify.undo": Code("leaving a procedure early would leave the power on or a synchronised block open"),
    "verify.motion_settings": Code("settings make the moves slower than their programmed times"),
    "verify.move_count": Code("the tasks have different numbers of moves in a synchronised block"),
    "verify.move_ids": Code("IDs of synchronised moves are missing, differ or do not increase"),
    "verify.zone_kind": Code("of two simultaneous moves, one stops and the other does not"),
    "verify.move_time": Code("simultaneous moves have no time or different times"),
    "verify.duration": Code("the programs are too long, or a face has too many facets, for the proof"),
    "verify.setup": Code(
        "a setup is not announced, not confirmed exactly once and in order, or an arm moves "
        "before its confirmation"
    ),
    "verify.dialogue": Code("an operator message or question differs from what the problem requires"),
    "verify.dialogue_figures": Code("a value in an operator message differs from the motion"),
    "verify.signals": Code(
        "a signal that is not the wire's is switched, or is switched in a way that cannot be followed"
    ),
    "verify.held_frame": Code("work on a held block is not in the frame of the arm that holds it"),
    "verify.load": Code("the controller does not have the load of the held block, or keeps it after release"),
    "verify.bow": Code("a clamp of a straight wire comes too close to the foam"),
    "verify.rulings": Code("a straight wire deviates from the rulings of the surface, or misses some"),
    "verify.order": Code("cuts are in another order than the operation states"),
    "verify.part": Code("the wire cuts into the part during approach or retreat, or into another surface"),
    "verify.slit": Code(
        "the wire approaches a cut from another side than stated, or through a slit that is too long"
    ),
    "verify.kerf": Code("the slot is narrower or wider than required at the actual speed of the wire"),
    "verify.cell_check": Code("the program moves before it compares the controller's frames with the plan"),
    "verify.start_posture": Code("a trajectory starts from joints that are not checked, or not at home"),
    "verify.goal_tolerances": Code("a trajectory continues at a larger path deviation than the cell allows"),
    "verify.power_on_failure": Code("an output stays on if a trajectory step fails"),
    "verify.between_points": Code("the tool leaves the straight line between two trajectory points"),
    "verify.controller_files": Code("controller files are missing, changed, or belong to other programs"),
    "verify.hidden": Code("code outside the linear control flow runs or may run: it is not proven"),
    "verify.speed_data": Code("the speed data of a move are below path length over time"),
    "verify.arms_alone": Code("two arms move at the same time without synchronisation"),
    "verify.wire_alone": Code("an arm moves alone while a wire is mounted"),
    "verify.stop_before_logic": Code("an arm does not stop before a signal, wait or synchronisation point"),
    "verify.tool_data": Code("the tool data of the program differ from the cell"),
    "verify.work_object": Code("a work object is not at the pose of the stock"),
    "verify.rests": Code("the block is not held or supported as required"),
    "verify.base_frames": Code("the base frame of the program differs from the problem"),
    "verify.move_kinds": Code("the path of a move is unknown, or ConfL is not set as the arm needs it"),
    "verify.external_axes": Code(
        "the unit, values or moves of a track, table or positioner are not as required"
    ),
    "verify.track_along": Code("a coordinated track violates its motion law or exceeds its limits"),
    "verify.track_way": Code("bodies come too close while a track, table or positioner moves to a station"),
    "verify.zone_size": Code("a zone is larger than half of the shorter adjacent move"),
    "verify.zero_length": Code("a move has zero length"),
    "verify.wire_mount": Code("mounting or removing the wire is not confirmed"),
    "verify.reach": Code("an arm cannot follow the path of the program", remedy=_PLACE),
    "verify.corner": Code("a zone blends a joint move with a linear move"),
    "verify.continuity": Code("the joint solution changes between two moves"),
    "verify.confdata": Code("the configuration data do not select the joint solution of the motion"),
    "verify.status": Code("Status and Turn of a KRL target do not uniquely select the joint solution"),
    "verify.joint_limits": Code(
        "a joint exceeds its limits",
        remedy=f"{_PLACE}; settings.joint_margin_deg is the margin to the limits",
    ),
    "verify.rod_limits": Code(
        "axis 3 of a parallel-rod arm, as its controller counts it, exceeds its limits",
        remedy="use a longer or thinner wire, and plan again",
    ),
    "verify.joint_speed": Code(
        "the programmed times require a joint speed above the limit of the robot", remedy=_SLOWER
    ),
    "verify.joint_acceleration": Code(
        "the programmed times require a joint acceleration above the limit of the robot", remedy=_SLOWER
    ),
    "verify.spline": Code("the uncertainty of a spline block's curve leaves too little margin"),
    "verify.singularity": Code(
        "an arm comes too close to a singularity",
        remedy=f"{_PLACE}; settings.singularity_margin_deg is the margin to singularities",
    ),
    "verify.tcp_speed": Code(
        "a tool exceeds the TCP speed that the problem allows",
        remedy="lower the feed, and plan again; settings.tcp_speed_mm_s is the limit",
    ),
    "verify.unknown_start": Code("a move with an unknown start may be too fast, or a joint move has a time"),
    "verify.power_idle": Code("power stays on too long while nothing moves or during a wait"),
    "verify.follows": Code("a tool does not pass through the given poses"),
    "verify.wire_length": Code("the ends of the wire are too far apart, or no wire shape meets both clamps"),
    "verify.wire_stability": Code("the wire shape is unstable, or snaps to another shape"),
    "verify.curvature": Code("the wire is bent beyond its elastic limit"),
    "verify.contact": Code("the wire touches the stock where it must not cut"),
    "verify.stop_in_foam": Code("the wire stops inside the stock"),
    "verify.wire_power": Code(
        "the wire is not powered in the stock, is powered near an operator, or is on too briefly"
    ),
    "verify.feed": Code("the speed of the wire in the stock is outside the feed window"),
    "verify.sag": Code("the compliance compensation of an arm differs from the problem, or is too large"),
    "verify.kinematics": Code("a link or tool is not at its forward-kinematics pose"),
    "verify.robot_model": Code(
        "the URDF of a robot is unreadable, or differs from the robot that was planned with"
    ),
    "verify.clearance": Code(
        "bodies of the cell come too close to each other",
        remedy="move the obstacle or the stock, and plan again",
    ),
    "verify.own_clearance": Code(
        "links or tool of one arm come too close to each other",
        remedy="mount the tool differently, or give targets more rotational freedom, and plan again",
    ),
    "verify.wire_clearance": Code(
        "the wire comes too close to a body", remedy="move the body that is too close, and plan again"
    ),
    "verify.part_file": Code("the programs do not make the part that the proof reads from its file"),
    "verify.surface": Code("too little of the cut surface is within tolerance"),
    "verify.gouge": Code(
        "a forming tool cuts into the face that it forms, or penetrates the flat sheet",
        remedy="use a smaller forming tool or larger radii of the part, and plan again",
    ),
    "verify.formed": Code(
        "too little of a face is formed, the ball loses contact for too long, or a face has no claim"
    ),
    "verify.gap": Code(
        "the gap or the relative orientation of two forming tools is outside its tolerance", remedy=_NEARER
    ),
    "verify.border": Code("a support leaves the border of the formed area, or cuts across it"),
    "verify.opposite": Code("a following tool is not opposite the forming tool"),
    "verify.sheet": Code(
        "a forming tool collides with a formed wall, or penetrates the sheet",
        remedy="use a slimmer tool, another order or a tilted tool (lean_deg), and plan again",
    ),
    "verify.holder": Code("the signal of the sinking clamp is not pulsed at each formed level"),
    "verify.adsif": Code(
        "tools of ADSIF forming are not at the positions of the response table", remedy=_NEARER
    ),
    "verify.forming_part": Code(
        "the forming passes do not make the part, or not in the required order and shapes"
    ),
    "verify.forming_holes": Code(
        "a formed area or a forming tool comes too close to a curve that was cut before"
    ),
    "verify.forming_claims": Code(
        "the claims of a pass do not follow from the part and the values of the user"
    ),
    "verify.feature_order": Code(
        "the forming segments are not those of the claims, each exactly once and in order"
    ),
    "verify.springback": Code(
        "the overforming of the tools differs from the springback file, or that file is wrong "
        "or makes walls too steep",
        remedy="write the file again (tandem springback PROBLEM --write FILE) and plan again",
    ),
    "verify.level": Code(
        "a level of a pass is not the stated one, or differs from its file, or that file "
        "belongs to another job, exceeds its limits or makes walls too steep",
        remedy="write problem and file again (tandem next-loop OUT --problem FILE) and plan again",
    ),
    "verify.forming_feed": Code("a tool exceeds the feed on the sheet"),
    "verify.lean": Code("the tilt of a forming tool exceeds the limit of the problem"),
    "verify.ridge": Code("a ridge or groove remains on the cut surface"),
    # passes over a sheet, and the tool that supports it
    "verify.milled": Code(
        "a milled surface is outside its tolerance, or material without a claim is milled",
        remedy="use a smaller cutter or finer steps, and plan again",
    ),
    "verify.mill_gouge": Code(
        "the cutter, shank, holder or spindle cuts into the part",
        remedy="use a smaller or slimmer cutter, or tilt its axis, and plan again",
    ),
    "verify.mill_path": Code("the tip or axis of a cutter deviates from its curve"),
    "verify.mill_feed": Code(
        "the cutter exceeds its feed, or a milling segment has no feed",
        remedy="lower the feed, and plan again",
    ),
    "verify.spindle": Code(
        "the spindle is not at speed while the cutter is in the block, or runs where nothing is milled"
    ),
    # curves cut out of a formed sheet
    "verify.trim_cut": Code(
        "an outline of a trimmed sheet is not cut as required, or has gaps other than its micro-joints"
    ),
    "verify.trim_kept": Code("a torch, mill or knife cuts into material that must remain"),
    "verify.trim_torch": Code("the stand-off or tilt of a cutting torch is outside its limits"),
    "verify.trim_arc": Code(
        "an arc starts at the wrong position, is not waited for, or burns where nothing is cut"
    ),
    "verify.trim_order": Code("an outline is cut before an outline inside it"),
    "verify.trim_feed": Code(
        "the torch is faster or slower than the sheet thickness requires", remedy=_SLOWER
    ),
    "verify.trim_mill": Code(
        "a trimming mill has the wrong depth, tilts too far, enters the sheet in a forbidden "
        "way, or leaves its slot"
    ),
    "verify.trim_spindle": Code(
        "a mill or knife is in the sheet before its drive is up to speed, or the drive runs elsewhere"
    ),
    "verify.trim_knife": Code(
        "a trimming knife has the wrong depth, deviates or tilts from its curve, or rotates in the sheet"
    ),
    "verify.trim_clear": Code("a tool comes too close to the sheet that it trims"),
    "trim.tool": Code(
        "the trimming arm has no torch, mill or knife, or its tool does not reach through the sheet",
        given=True,
    ),
    "trim.die": Code("a mill or knife cannot cut through a sheet with a die behind it", given=True),
    "trim.no_sheet": Code("trimming requires a sheet that was formed", given=True),
    "trim.open": Code("a curve to cut is not closed", given=True),
    "trim.crosses": Code("curves to cut intersect themselves or each other", given=True),
    "trim.in_waste": Code("a curve lies in the waste of another curve", given=True),
    "trim.off_part": Code("a curve with its slot and lead-ins leaves the opening of the clamp"),
    "trim.narrow": Code("the waste is narrower than the slot"),
    "trim.corner": Code("a corner is too sharp for a round slot, or a bend or corner too sharp for a blade"),
    "trim.joints": Code("too many micro-joints for the curve"),
    "trim.lead": Code("no lead-in with its pierce point fits into the waste"),
    "trim.wall": Code("a tool comes too close to a wall of the sheet, or its angle to the sheet is too flat"),
    "trim.slow": Code("the arm is slower in the slot than the cut of the torch allows"),
    # milling
    "milling.tool": Code("the milling arm has no cutter", given=True),
    "milling.no_surface": Code(
        "a cut names a surface that the part does not have, or requires a front face", given=True
    ),
    "milling.guides": Code("the two guide curves of a cut run in opposite directions, or meet", given=True),
    "milling.guide_lengths": Code("the guide curves of a flank cut have very different lengths", given=True),
    "milling.flute": Code("the cutting length of the cutter is shorter than the wall"),
    "milling.holder": Code("the holder of the cutter would be below the top of the wall"),
    "milling.corner": Code("the surface has an inner corner, which a round cutter cannot mill"),
    "milling.twist": Code("the cutter deviates from twisted rulings by more than the tolerance"),
    "milling.tool_radius": Code("the cutter is too thick for a region of the part"),
    "milling.too_large": Code("the face is too large to be checked at the resolution of its tolerance"),
    "milling.gouge": Code("the cutter, shank, holder or spindle would cut into the part"),
    "milling.safe_plane": Code("the tool axis is so flat that the tool never rises to the safe plane"),
    "milling.front": Code("the front of the part faces away from the milling side"),
    "milling.pattern": Code(
        "the milling lines are too many, cover nothing, or leave ridges above the tolerance"
    ),
    "milling.off_surface": Code("a curve to engrave leaves the front of the part"),
    "forming.no_sheet": Code("forming requires a sheet and a part", given=True),
    "forming.tool": Code("the tool of an arm is not usable in this forming mode", given=True),
    "forming.side": Code("a feature points to the side on which no tool can form it", given=True),
    "forming.closed_mesh": Code(
        "the mesh of the part is closed, but one face of the sheet is required", given=True
    ),
    "forming.inside_out": Code("faces of the mesh of the part have inconsistent orientations", given=True),
    "forming.wall_angle": Code(
        "a wall is too steep to be formed, or too steep for one pass",
        accepts="a pass, or its loops with springback, form a steeper wall than the metal is known to bear",
    ),
    "forming.support_radius": Code("the ball of the supporting tool is too large for the part"),
    "forming.gap": Code("the gap between the two tools exceeds its tolerance between targets"),
    "forming.shift": Code(
        "the requested rotation of the support around the forming tool exceeds the wall angle"
    ),
    "forming.support_tool": Code("the forming mode requires a tool that is missing", given=True),
    "forming.die_gouge": Code("the die would cut into the part"),
    "forming.die_far": Code(
        "a full die is too far from the part",
        accepts="a full die does not touch the walls that it should support",
    ),
    "forming.holder": Code("a die and this sheet holder are incompatible", given=True),
    "forming.holder_step": Code(
        "the sinking clamp cannot follow the tool, or its last step misses the rim of the part"
    ),
    "forming.clamp": Code("a tool collides with the clamp of the sheet"),
    "forming.clear": Code("a tool cuts into a formed region of the sheet"),
    # sheet metals, forces, trials and tables of forming
    "forming.unknown_metal": Code("unknown sheet metal", given=True),
    "forming.thickness_untested": Code("the sheet thickness is outside the range of known forming tests"),
    "forming.trial": Code("a trial of one laboratory failed at this wall angle, thickness and depth"),
    "forming.force_input": Code("a length, angle or force of the force estimate is out of range", given=True),
    "forming.force": Code(
        "the forming force exceeds the remaining payload of a robot",
        accepts="the robots can press harder than their stated payload",
    ),
    "control.machine": Code("a field of the machine file is missing, unknown or out of range", given=True),
    "control.unstable": Code("a gain of force control or compensation would be unstable"),
    "control.band": Code("the force leaves its band at the requested feed"),
    "control.range": Code("the corrections exceed what the controller allows"),
    "forming.springback": Code("the springback of the formed sheet after release exceeds the tolerance"),
    "forming.springback_mesh": Code("the formed sheet cannot be meshed with so few triangles"),
    "forming.plate_test": Code("the readings of a plate test are implausible or too few", given=True),
    "forming.clamp_unclear": Code(
        "the readings of the plate test do not determine some values, or do not separate them"
    ),
    "forming.springback_mode": Code("springback is not modelled for this job", given=True),
    "forming.compensation": Code(
        "the springback file is truncated, changed, of another job, or exceeds its limits", given=True
    ),
    "forming.compensated": Code("the overforming that compensates springback"),
    "forming.limit_load": Code("the formed sheet snaps through or buckles under the expected force"),
    "forming.loop_curves": Code(
        "the file of springback curves is unreadable, truncated, or of another problem", given=True
    ),
    "forming.loop_forces": Code(
        "the measured forces have other points, levels or units, or an invalid row", given=True
    ),
    "forming.loop_law": Code("a parameter of the springback loop is out of range", given=True),
    "forming.loop_plant": Code("the plant file is invalid, or its sheet belongs to another part", given=True),
    "forming.loop_unstable": Code("a gain of the springback loop would be unstable from level to level"),
    "forming.loop_range": Code("corrections of the springback loop were limited to their range"),
    "forming.adsif_table": Code(
        "a table of the ADSIF response is unreadable, or contains an invalid value", given=True
    ),
    "forming.adsif_conditions": Code("the ADSIF table was measured for another metal, sheet, tool or path"),
    "forming.adsif_range": Code("the wall angle is outside the ADSIF table"),
    "forming.adsif_unstable": Code(
        "the tool positions are unstable according to the ADSIF table, or outside it"
    ),
    "forming.adsif_compliance": Code("the deflection of the tools exceeds what the ADSIF gap can compensate"),
    # paths of the contact on a face
    "forming.path_options": Code(
        "a step, ridge height, chord or other value of the forming path is out of range", given=True
    ),
    "forming.no_contour": Code("no part of the face lies between the levels of the path"),
    "forming.open_contour": Code("a level line of the face ends at a border of its mesh"),
    "forming.unreached": Code(
        "corners of the part are tighter than the forming ball, which does not reach them"
    ),
    "forming.tool_radius": Code("the forming tool is too large for a region of the face"),
    # scans of formed parts
    "scan.file": Code("the scan is unreadable, or has too few or too many points", given=True),
    "scan.unit": Code("the scan is far larger or smaller than the sheet: its unit is wrong", given=True),
    "scan.flat": Code("too little of the flat flange around the part is in the scan", given=True),
    "scan.other_part": Code(
        "the scan shows another part, too little of the part, or its mirror image", given=True
    ),
    "scan.no_marks": Code(
        "the scan has no marks, so its position in the sheet plane is assumed to be correct", given=True
    ),
    "scan.marks": Code("the marks do not locate the scan as accurately as the part is measured"),
    "scan.stray": Code("the number of isolated points of the scan"),
    "scan.hole": Code("a region of the part is missing in the scan", given=True),
    # the base of the second robot, from points that both probed
    "align.file": Code(
        "a file of probed points is unreadable, or a value in it is missing or out of range", given=True
    ),
    "align.cell": Code("the cell has no second arm, or its base cannot be updated in the file", given=True),
    "align.few_points": Code("fewer than three points were probed, or too few remain", given=True),
    "align.same_points": Code("the probed points coincide", given=True),
    "align.collinear": Code(
        "the probed points are collinear, so the rotation about their line is undetermined", given=True
    ),
    "align.mirrored": Code(
        "the probed points fit a mirror image, as if one axis had the wrong sign", given=True
    ),
    "align.units": Code("the points of the two robots differ by a common scale factor", given=True),
    "align.bad_point": Code("one probed point does not fit the others", given=True),
    "align.large_residual": Code(
        "the residual of the probed points exceeds the limit, and no single point causes it", given=True
    ),
    # G-code
    "gcode.syntax": Code("a line is not valid G-code, or the file is not text", given=True),
    "gcode.word": Code("a G-code word is not supported, or has no meaning on its line", given=True),
    "gcode.unit": Code("the length unit of the G-code file is not stated", given=True),
    "gcode.mode": Code("a mode of the G-code file, such as G90 or G91, is not stated", given=True),
    "gcode.plane": Code("the plane of an arc in the G-code file is not stated", given=True),
    "gcode.feed": Code("the feed in the G-code file is not stated or not positive", given=True),
    "gcode.spindle": Code(
        "the G-code file cuts with a stopped spindle or without a spindle speed", given=True
    ),
    "gcode.rotary": Code("a G-code word rotates the tool, but no machine kinematics are stated", given=True),
    "gcode.axis": Code(
        "a tool axis of the G-code file is not a unit vector, or reverses within one move", given=True
    ),
    "gcode.arc": Code(
        "an arc of the G-code file has no centre, two centres, or an inconsistent one", given=True
    ),
    "gcode.position": Code(
        "a G-code move starts or ends at a position that is not stated or too far away", given=True
    ),
    "gcode.tool": Code("only one tool per G-code file is supported", given=True),
    "gcode.offset": Code("the G-code file uses a work offset that the problem does not define", given=True),
    "gcode.empty": Code("the G-code file contains no moves", given=True),
    "gcode.after_end": Code("the G-code file continues after the end of its program", given=True),
    "gcode.skipped": Code("a G-code code is skipped, as the problem requests", given=True),
    # motion
    "motion.no_reach": Code("an arm cannot reach a target"),
    "motion.station": Code(
        "no position of the track, table or positioner has a path for the operation", given=True
    ),
    "motion.joint_limit": Code("an arm exceeds a joint limit at a target for all values of its freedoms"),
    "motion.singular": Code(
        "an arm is too close to a singularity at a target for all values of its freedoms"
    ),
    "motion.no_path": Code("no sequence of joint branches passes a target without a jump"),
    "motion.collision": Code("bodies come too close at a target for all values of the freedoms"),
    "motion.linear_move": Code("an arm cannot follow the linear move between two targets"),
    "motion.sag": Code("the pose offset that compensates the compliance of an arm"),
    "motion.sag_range": Code(
        "the compliance of an arm is beyond the compensation range, or too uneven between targets"
    ),
    "motion.overlap": Code("static bodies of the cell overlap"),
    "motion.home": Code("an arm at its home position is too close to a body"),
    "motion.entry": Code("an arm has no collision-free path between home and its first or last target"),
    "motion.timing": Code("no timing was found for a section of the path"),
    "motion.feed_min": Code("the arms cannot make a move as fast as the process requires"),
    "motion.stops": Code("the arm stops at corners that it would otherwise pass very slowly"),
    "motion.short_moves": Code("moves are so short in time or length that the controller may stop there"),
    "motion.no_placement": Code("no stock position was found from which the whole job is feasible"),
    "motion.path_kept": Code(
        "the optimised path violates the clearance, so the path of the graph search is used"
    ),
    "motion.like": Code("what was reused from the reference plan, and what was not"),
    "motion.solver": Code("this build of Drake lacks the solvers that optimise a path"),
    "claims.unproven": Code("a claim of a process is checked by no proof rule"),
    "claims.none": Code("a process makes no claim about an operation"),
    "verify.unread": Code(
        "a line of a third-party program is not understood, or one of its moves is not proven"
    ),
    "verify.no_programs": Code("the result folder contains no programs"),
    # features of a part that is formed from a sheet
    "forming.undercut": Code("the part has an undercut: a wall steeper than 90 degrees"),
    "forming.hole": Code("the part has a hole, or a gap between facets", given=True),
    "forming.border": Code("the edge of the part leaves the sheet plane", given=True),
    "forming.touching": Code("two features touch or overlap", given=True),
    "forming.flat": Code("the part is flat: nothing leaves the sheet plane", given=True),
    "forming.step": Code("the slicing step is not positive, or gives too many levels", given=True),
    "forming.holes": Code("a formed area or a tool comes too close to a curve along which the sheet was cut"),
    "forming.features": Code("the operations of a part name an unknown feature, name one twice, or omit one"),
    "forming.order": Code(
        "the forming order names a feature twice, omits one, or names one before its parent", given=True
    ),
    # many problems at once
    "batch.crashed": Code("the process that planned a problem ended unexpectedly"),
    "batch.timeout": Code("planning a problem exceeded the time limit"),
    "batch.memory": Code("planning a problem exceeded the memory limit"),
    "batch.cancelled": Code("planning a problem was cancelled"),
    "batch.worker": Code("worker processes do not start"),
    "batch.field": Code("a field of the batch file is missing, unknown or out of range", given=True),
    "batch.csv": Code(
        "the table of the batch file is unreadable, or a row does not match its header", given=True
    ),
    "batch.install": Code("a cluster requires packages that are not installed", given=True),
    "batch.cluster": Code("the cluster is unreachable, has no workers, or stopped responding"),
    "batch.versions": Code("a cluster worker has other package versions than the client"),
    "batch.in_use": Code("another batch is writing to the output folder", given=True),
    # the service
    "service.install": Code("the service requires packages that are not installed"),
    "service.database": Code("the database of the service cannot be opened or is unreachable"),
    "service.not_planning": Code("the service accepts jobs, but none is planned at present"),
    "service.start": Code("the service cannot start with these options"),
    "service.request": Code("a field of the request is missing, unknown or out of range"),
    "service.not_found": Code("the service has no such resource, or does not support the method"),
    "service.token": Code("missing, unknown, revoked or expired token"),
    "service.log_in": Code("login with the account provider failed"),
    "service.damaged": Code("a stored program is damaged and is not served"),
    "service.role": Code("the role of the token does not permit the request"),
    "service.foreign": Code("the request comes from another site"),
    "service.link": Code(
        "the link is expired, withdrawn or not signed by the service, or the job has too many links"
    ),
    "service.unknown_job": Code("unknown job"),
    "service.unknown_file": Code("the job has no such file"),
    "service.not_uploaded": Code("the problem names a file that was not uploaded"),
    "service.file_name": Code("the name of an uploaded file is missing, too long or not unique"),
    "service.archive": Code("archives and compressed files are not accepted"),
    "service.too_large": Code("an upload or one of its files exceeds the size limit"),
    "service.too_many": Code("the token has reached its limit of jobs, event streams or pending uploads"),
    "service.stopping": Code("the service stopped while it read an upload"),
    "service.storage": Code("the storage quota of the token or of the service is exhausted"),
    "service.check_stopped": Code("checking the problem exceeded the limit of time or memory"),
    "service.backup": Code("a store of the service cannot be backed up or restored"),
    "service.idempotency": Code("the idempotency key is invalid, or was used with another request"),
    "service.webhook": Code("the webhook address is not usable, or the webhook does not exist"),
    "service.state": Code("the state of the job does not permit the request"),
    "service.release": Code("the programs cannot be released, or the release cannot be withdrawn"),
    "service.draft": Code("the draft does not exist, or was changed by another user"),
    "service.gave_up": Code("the service stopped several times while it worked on the job"),
    "service.answer": Code("the server at this address does not answer like this service"),
    "service.timeout": Code("the service did not answer, or the job did not end, within the time limit"),
    "service.version": Code("the service is too new for the client, or too old for the request"),
    # internal
    "internal.error": Code("internal error of Tandem; nothing was written"),
}


def all_codes() -> Mapping[str, Code]:
    """Return the rows of Tandem and of all installed plug-ins, by code."""
    out = dict(CODES)
    for rows in _of_plugins().values():
        out |= {code: row for code, row in rows.items() if code not in out}
    return out


def row(code: str) -> Code:
    """Return the row of a code.

    Plug-ins are imported only for codes that are not Tandem's.

    Raises:
        KeyError: If neither Tandem nor a plug-in declares the code.
    """
    found = CODES.get(code) or all_codes().get(code)
    if found is None:
        raise KeyError(f"issue code {code!r} is not in planner/issue_codes.py; declare it there")
    return found


def owners(code: str) -> frozenset[str]:
    """Return the packages that declare a code: "Tandem", or plug-ins such as "package ring-gauge"."""
    others = {owner for owner, rows in _of_plugins().items() if code in rows}
    return frozenset({"Tandem", *others} if code in CODES else others)


def _of_plugins() -> Mapping[str, Mapping[str, Code]]:
    """Return rows by owner. The registry of processes refuses plug-ins whose rows cannot be loaded."""
    from planner.runtime import plugins  # imports importlib.metadata, which `tandem --help` does without

    out: dict[str, dict[str, Code]] = {}
    for kind in (plugins.Process, plugins.Language):
        for name, rows in plugins.loadable(kind, "codes", dict).items():
            out.setdefault(plugins.installed(kind)[name].owner, {}).update(rows)
    return out
