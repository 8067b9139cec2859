"""Table of all issue codes, used by the code, the tests, ``tandem issues`` and the documentation.

A code has the form ``area.problem`` and is stable once released. Plug-ins add their own rows
(:func:`all_codes`).
"""

import dataclasses
from collections.abc import Mapping
from typing import Final


@dataclasses.dataclass(frozen=True)
class IssueCode:
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
    is_input_error: bool = False
    acceptance: str | None = None
    remedy: str | None = None


_MOVE_STOCK: Final = "move or rotate the stock, and plan again"
_LOWER_FEED: Final = "lower the feed there, or round the corner with more targets, and plan again"
_REDUCE_SPACING: Final = "reduce the target spacing (tangent_deg, chord_mm), and plan again"

CODES: Final[dict[str, IssueCode]] = {
    # problem files
    "problem.missing_file": IssueCode("a file that the problem names does not exist", is_input_error=True),
    "problem.not_yaml": IssueCode("the problem file is not valid YAML", is_input_error=True),
    "problem.field": IssueCode(
        "a field of the problem file is missing, unknown or out of range", is_input_error=True
    ),
    "problem.duplicate_name": IssueCode("two items of the same kind have the same name", is_input_error=True),
    "problem.track": IssueCode("tracks are not supported for this controller", is_input_error=True),
    "problem.turntable": IssueCode(
        "turntables and positioners are not supported for this controller, or the block is not on it",
        is_input_error=True,
    ),
    "problem.too_large": IssueCode("a file exceeds the size limit", is_input_error=True),
    "problem.unknown_robot": IssueCode("the robot is not in the catalogue", is_input_error=True),
    # robots from files
    "robot.urdf": IssueCode("the robot file is not a readable URDF", is_input_error=True),
    "robot.chain": IssueCode(
        "the URDF chain from base to tip is missing, or has mimic or prismatic joints", is_input_error=True
    ),
    "robot.limits": IssueCode("a URDF joint has no range or no maximum speed", is_input_error=True),
    "robot.bodies": IssueCode(
        "collision bodies of a robot are missing or enclose no volume", is_input_error=True
    ),
    "robot.unseen": IssueCode(
        "links of a robot have no visual mesh and are shown by their collision bodies", is_input_error=True
    ),
    "robot.not_opw": IssueCode("the kinematic class of the arm is not supported", is_input_error=True),
    "robot.deviation": IssueCode(
        "the closed-form kinematics of an arm deviate from its URDF", is_input_error=True
    ),
    "problem.unknown_arm": IssueCode(
        "an operation names an arm that is not in the cell", is_input_error=True
    ),
    "problem.unknown_process": IssueCode("an operation names an unknown process", is_input_error=True),
    "problem.process_package": IssueCode(
        "an installed process cannot be loaded, or its name is already taken", is_input_error=True
    ),
    "problem.not_finite": IssueCode("a number is NaN or infinite", is_input_error=True),
    "problem.accepted": IssueCode("the problem accepts an issue that does not occur", is_input_error=True),
    # blocks that are held, and what is known of them
    "stock.gripper": IssueCode("the arm that should hold the block has no gripper"),
    "stock.foam_missing": IssueCode("the foam of the block is required but not stated"),
    "stock.too_heavy": IssueCode("block and gripper exceed the payload of the arm that holds them"),
    "stock.grip_force": IssueCode("the gripper does not hold the block firmly enough"),
    "stock.grip_chosen": IssueCode("the chosen gripper, and where it holds the block"),
    "stock.support": IssueCode(
        "the support does not reach the floor, or the block does not rest on it",
        acceptance="the support does not reach the floor, or the block does not rest on it",
    ),
    "stock.hangs": IssueCode(
        "no support is stated for the block", acceptance="no support is stated for the block"
    ),
    "stock.footprint": IssueCode("the gripper face lies outside the bottom face of the block or part"),
    # building elements
    "element.surface": IssueCode(
        "the surface of an element has holes or folds, touches itself, does not fill a "
        "rectangle, or is too narrow for adjacent panels",
        is_input_error=True,
    ),
    "element.wire": IssueCode("no wire is long enough for the smallest panel at a position of the element"),
    "element.tolerance": IssueCode(
        "panels deviate from the surface of the element by more than the tolerance"
    ),
    "element.shape": IssueCode(
        "panels of an element self-intersect, fold over, tilt too far or are too small"
    ),
    "element.count": IssueCode("the row layout gives another number of quad panels than requested"),
    "element.concave": IssueCode("planar panels of an element have concave corners"),
    "element.assembly": IssueCode(
        "panels of an element have no collision-free straight insertion path in any tested order"
    ),
    "element.dowels": IssueCode(
        "panels are inserted without dowels: the insertion path is too oblique, or there is no "
        "space for a dowel"
    ),
    "element.block": IssueCode("no block holds the panel at a position of the element"),
    "element.held": IssueCode("panels that no wire can cut safely, listed where they cannot be avoided"),
    "element.run": IssueCode(
        "the report needs an element batch whose panels are all proven", is_input_error=True
    ),
    "element.mark": IssueCode(
        "the marked panel is not in the element, or the list of marks is invalid or belongs to other panels",
        is_input_error=True,
    ),
    "element.joint": IssueCode("adjacent panels of an element meet with a larger step than requested"),
    "element.face": IssueCode(
        "panel faces deviate from the written surface, or their slot is on the side of the panel"
    ),
    "element.raw_block": IssueCode("the block of a panel fits none of the raw blocks of its foam"),
    "element.cut": IssueCode("the bow cannot reach some cuts of raw blocks from any direction"),
    "element.stock": IssueCode(
        "the list of leftover foam is invalid or has invalid rows", is_input_error=True
    ),
    "element.jobs": IssueCode(
        "a template of the element is invalid, or a panel matches no template or several", is_input_error=True
    ),
    # catalogue and cell
    "catalogue.missing_data": IssueCode("a data file of the Tandem installation is missing or unreadable"),
    "cell.body_name": IssueCode("the name of a cell body is reserved or already taken", is_input_error=True),
    # saved plans
    "output.folder": IssueCode(
        "the output folder is not writable, or contains the problem file itself", is_input_error=True
    ),
    "output.disk_full": IssueCode("the disk of the output folder is full"),
    "plan.missing_file": IssueCode("a file of a saved plan is missing or unreadable"),
    "plan.damaged": IssueCode("a file of a saved plan is damaged"),
    "plan.schema": IssueCode("a saved plan has another format or schema version"),
    "plan.not_saveable": IssueCode("a plan contains a value that is neither an array nor plain data"),
    # report
    "report.exhibit": IssueCode("an exhibit of a process has an invalid form and is left out of the report"),
    # the general door, process: targets
    "targets.file": IssueCode(
        "a targets file is unreadable, or a value in it is missing or out of range", is_input_error=True
    ),
    "targets.held": IssueCode(
        "given poses are not supported for a block that an arm holds", is_input_error=True
    ),
    "targets.freedom": IssueCode(
        "a free axis needs exactly one of rotation and translation", is_input_error=True
    ),
    # wire shapes
    "wire.too_short": IssueCode("the wire is shorter than the distance between its clamps"),
    "wire.unknown_material": IssueCode("unknown wire material", is_input_error=True),
    "wire.size": IssueCode(
        "the size of a wire or strip is missing, contradictory or not positive", is_input_error=True
    ),
    "wire.temperature": IssueCode(
        "the wire temperature is outside the range of its material", is_input_error=True
    ),
    "wire.no_equilibrium": IssueCode(
        "the solver found no equilibrium of the heavy wire near the initial guess"
    ),
    # kerf of a hot wire
    "kerf.unknown_foam": IssueCode("unknown foam", is_input_error=True),
    "kerf.no_data": IssueCode(
        "the foam has no test cuts, or not those that the kerf model needs", is_input_error=True
    ),
    "kerf.model": IssueCode("unknown kerf model", is_input_error=True),
    "kerf.input": IssueCode(
        "power, speed, width and thickness must be positive numbers", is_input_error=True
    ),
    "kerf.impossible": IssueCode("no wire, speed or power produces this kerf", is_input_error=True),
    "kerf.melts": IssueCode(
        "at this power the wire reaches its limit temperature in air", is_input_error=True
    ),
    "kerf.file": IssueCode(
        "a file of test cuts is unreadable, or a value in it is missing or out of range", is_input_error=True
    ),
    "kerf.few_cuts": IssueCode(
        "too few test cuts remain, or all have the same speed and power", is_input_error=True
    ),
    "kerf.no_trend": IssueCode(
        "the kerf of the test cuts does not increase with power over speed", is_input_error=True
    ),
    "kerf.foam_file": IssueCode(
        "a field of the foam file is missing, unknown or out of range", is_input_error=True
    ),
    "kerf.too_hot": IssueCode(
        "the slot is too wide for a usable face: the wire burns the foam", is_input_error=True
    ),
    "kerf.too_cold": IssueCode(
        "the slot is too narrow for a usable face: the wire drags", is_input_error=True
    ),
    "kerf.unsettled": IssueCode(
        "one end of the wire almost stops at the surface: no kerf is consistent with its own speed",
        is_input_error=True,
    ),
    "kerf.doubt": IssueCode("the kerf model is used outside its tested range", is_input_error=True),
    # meshes and parts
    "mesh.unreadable": IssueCode(
        "the mesh file has an unsupported format or is damaged", is_input_error=True
    ),
    "mesh.empty": IssueCode("the mesh file has no faces with a positive area", is_input_error=True),
    "mesh.unit": IssueCode(
        "the mesh is implausibly large or small in its unit, or states another unit than the problem",
        is_input_error=True,
    ),
    "mesh.file_unit": IssueCode("the unit that the mesh file states and that was used", is_input_error=True),
    "mesh.non_manifold": IssueCode("more than two faces of the mesh share an edge", is_input_error=True),
    "mesh.orientation": IssueCode("adjacent faces of the mesh have opposite normals", is_input_error=True),
    "mesh.closed": IssueCode("the mesh is closed, but an open face is required", is_input_error=True),
    "mesh.pieces": IssueCode(
        "the mesh has several separate pieces, but one is required", is_input_error=True
    ),
    "part.mesh_noise": IssueCode(
        "the estimated noise of the mesh of a part, and the smooth face that was fitted", is_input_error=True
    ),
    "part.mesh_tolerance": IssueCode("the mesh tolerance is too large for the part", is_input_error=True),
    "part.offset": IssueCode(
        "the curvature radius of the face is smaller than the offset distance", is_input_error=True
    ),
    "part.stock_too_small": IssueCode("the part does not fit into the block", is_input_error=True),
    "part.faces": IssueCode(
        "the front and back faces of a part are not on each other's inner side", is_input_error=True
    ),
    "part.missing_face": IssueCode("a face to cut does not exist in the part", is_input_error=True),
    "part.naca": IssueCode("the digits belong to no NACA family", is_input_error=True),
    "part.airfoil_format": IssueCode(
        "the airfoil file is in neither Selig nor Lednicer format", is_input_error=True
    ),
    "part.airfoil_order": IssueCode("the points of the airfoil are in the wrong order", is_input_error=True),
    "part.airfoil_open": IssueCode("the airfoil has no trailing edge, or only one side", is_input_error=True),
    "part.airfoil_points": IssueCode("the airfoil has too few points", is_input_error=True),
    "part.airfoil_crossing": IssueCode("the airfoil intersects itself", is_input_error=True),
    "part.airfoil_note": IssueCode(
        "the airfoil was corrected: point order, chord or duplicate points", is_input_error=True
    ),
    "part.wing": IssueCode("the shape of the wing is implausible", is_input_error=True),
    "part.ruled_shape": IssueCode(
        "the ruled surface has rulings of zero length, or folds over itself", is_input_error=True
    ),
    "part.corners": IssueCode("the two guide curves have different numbers of corners", is_input_error=True),
    "part.guide": IssueCode(
        "the guide curve has too few points, zero length, or intersects itself", is_input_error=True
    ),
    "part.guide_turned": IssueCode(
        "the guide curve was reversed so that the rulings do not cross", is_input_error=True
    ),
    "part.outline_open": IssueCode("the outline is not closed", is_input_error=True),
    "part.outline_crossing": IssueCode("the outline intersects itself", is_input_error=True),
    "part.outline_overlap": IssueCode("outlines cross or touch each other", is_input_error=True),
    "part.outline_duplicate": IssueCode("the same outline occurs twice", is_input_error=True),
    "part.extra_missing": IssueCode(
        "reading the file requires a package of an optional extra", is_input_error=True
    ),
    "part.dxf": IssueCode(
        "the DXF file is unreadable, or contains none of the required entities", is_input_error=True
    ),
    "part.dxf_left_out": IssueCode("unsupported entities of the DXF file were skipped", is_input_error=True),
    "part.dxf_unit": IssueCode("the DXF file states another unit than the problem", is_input_error=True),
    "part.rhino": IssueCode(
        "the Rhino file is unreadable, or lacks the required objects, or has several of them",
        is_input_error=True,
    ),
    "part.rhino_unit": IssueCode("the unit in which the Rhino file was read", is_input_error=True),
    "part.rhino_left_out": IssueCode(
        "objects of the Rhino file were skipped or converted", is_input_error=True
    ),
    "part.rhino_facets": IssueCode(
        "the measured deviation of the facets from the face of the Rhino file", is_input_error=True
    ),
    "part.step": IssueCode(
        "the STEP or IGES file is unreadable, or does not contain the required face", is_input_error=True
    ),
    "part.step_unit": IssueCode("the unit in which the STEP or IGES file was read", is_input_error=True),
    "part.step_facets": IssueCode(
        "the measured deviation of the facets from the face of the STEP or IGES file", is_input_error=True
    ),
    "part.edges": IssueCode(
        "straight edges cannot join the boundaries of front and back", is_input_error=True
    ),
    "part.patch": IssueCode(
        "the mesh is not a patch with one boundary and four corners", is_input_error=True
    ),
    "part.not_ruled": IssueCode(
        "the surface deviates from every ruled surface by more than its tolerance", is_input_error=True
    ),
    "part.ruled_deviation": IssueCode(
        "the deviation of the surface from its ruled approximation", is_input_error=True
    ),
    "part.strips": IssueCode(
        "no number of ruled strips meets the tolerance of the surface, or a strip does not exist",
        is_input_error=True,
    ),
    "part.strips_found": IssueCode(
        "the strips of the surface: number, deviations and kinks", is_input_error=True
    ),
    # planning a bent wire
    "wire.held": IssueCode("an elastic wire cannot cut a block that an arm holds"),
    "wire.chosen": IssueCode("the chosen wire, and why"),
    "wire.shape": IssueCode("the elastic wire deviates from the face by more than the tolerance"),
    "wire.curvature": IssueCode("the planned wire is bent beyond its elastic limit"),
    "wire.unstable": IssueCode(
        "the planned wire shape is unstable or almost unstable, in or out of its plane"
    ),
    "wire.weight": IssueCode("the weight of the wire moves it out of tolerance"),
    "wire.end_error": IssueCode("position errors of the wire ends move the wire out of tolerance"),
    "wire.touches": IssueCode("the wire comes too close to the block where it does not cut"),
    "wire.between_targets": IssueCode("the wire leaves its required shape between two targets"),
    # planning a straight wire
    "bow.missing": IssueCode("the cutting arm has no bow with a straight wire"),
    "bow.arms": IssueCode("the operation must name the arm with the bow and the arm that holds the block"),
    "bow.span": IssueCode("the foam is wider than the wire of the bow minus its margins"),
    "bow.throat": IssueCode("the block is deeper than the throat of the bow on every side of the wire"),
    "straight.trim": IssueCode("a side should be trimmed, but the block has no oversize there"),
    "straight.corner": IssueCode("an inner corner or curve is tighter than half the kerf"),
    "straight.crossing": IssueCode("while cutting one piece of a surface, the wire cuts into another"),
    "straight.uneven": IssueCode("the slot width changes faster along the path than the wire can follow"),
    "straight.slit": IssueCode("the wire reaches a hole through a slit in the part"),
    "straight.lead": IssueCode("the approach to an outline would cut through the part"),
    "straight.drop": IssueCode(
        "material above a level cut drops by one kerf before it is cut itself",
        acceptance="cut material drops by one kerf before it is cut itself",
    ),
    "part.missing_surface": IssueCode(
        "a ruled surface to cut does not exist in the part", is_input_error=True
    ),
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
    "post.trajectory": IssueCode("no trajectory points follow the path at its speed"),
    "post.ur_arm": IssueCode(
        "an arm of the family ur is not one that a UR controller moves", is_input_error=True
    ),
    "post.blend": IssueCode(
        "the tool rotates about its TCP where it must not stop: URScript has no blend for this"
    ),
    "post.turn_near_zero": IssueCode(
        "an axis is so close to zero that a KUKA controller may ignore its turn bit"
    ),
    "post.krl_turn": IssueCode("a move rotates so far that a KUKA controller may choose another path"),
    "post.path": IssueCode("the job cannot use spline blocks"),
    "post.spline": IssueCode("the KRL programs contain spline blocks, which were not tested on a controller"),
    "post.spline_left": IssueCode("moves that do not fit into spline blocks remain linear moves"),
    "post.krl_size": IssueCode("the KRL programs are too long for some controllers"),
    "post.plan": IssueCode("the plan contains times, joints or paths that no program can execute"),
    "post.action": IssueCode("a process action is at a target where the motion does not stop"),
    "post.name": IssueCode(
        "the name of a segment, tool or signal is invalid in the language or already taken",
        is_input_error=True,
    ),
    "post.tool": IssueCode("the data of a tool cannot be written"),
    "post.frame": IssueCode("targets are in a work frame that the program cannot refer to"),
    "post.option": IssueCode("the controller lacks an option that the programs need"),
    "post.no_split": IssueCode("the program is too long for one module and has no stop at which to split it"),
    "post.handshake_process": IssueCode(
        "two controllers that only share digital signals cannot do this work"
    ),
    "post.handshake_drift": IssueCode(
        "the change of tool distance when one arm is one step ahead of the other"
    ),
    "post.load": IssueCode("the held block has no weight that can be set in the controller"),
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
    "sign.extra": IssueCode("signatures require a package that is not installed"),
    "sign.key": IssueCode("the key file for signatures is unusable"),
    "sign.unproven": IssueCode("only a proven result can be signed"),
    "sign.missing": IssueCode("the result is not signed"),
    "sign.signature": IssueCode("the signature was not made with the given keys, or not for this text"),
    "sign.content": IssueCode("the result differs from the signed one"),
    "sign.good": IssueCode("the result is signed and unchanged"),
    "upload.unproven": IssueCode(
        "the result is not verified, or its files differ from those of its proof", is_input_error=True
    ),
    "upload.release": IssueCode(
        "the release of the result is withdrawn, is for other programs, or is required but missing",
        is_input_error=True,
    ),
    "upload.address": IssueCode(
        "the address of a controller, or what to send to it, is not stated", is_input_error=True
    ),
    "upload.controller": IssueCode("the controller is unreachable, or gives an unexpected answer"),
    "upload.login": IssueCode("the controller rejects the login, or its certificate is not trusted"),
    "upload.busy": IssueCode("the controller is running, in manual mode, or controlled by another client"),
    "upload.write": IssueCode("a file on the controller differs from the file that was sent"),
    "upload.differs": IssueCode("the controller differs from the one that the programs were planned for"),
    "upload.not_looked_at": IssueCode("a property of the controller was not read and therefore not compared"),
    "upload.missing": IssueCode("the expected programs are not on the controller"),
    "upload.touched": IssueCode("a target or data value on the controller differs from the result"),
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
    "trim.tool": IssueCode(
        "the trimming arm has no torch, mill or knife, or its tool does not reach through the sheet",
        is_input_error=True,
    ),
    "trim.die": IssueCode(
        "a mill or knife cannot cut through a sheet with a die behind it", is_input_error=True
    ),
    "trim.no_sheet": IssueCode("trimming requires a sheet that was formed", is_input_error=True),
    "trim.open": IssueCode("a curve to cut is not closed", is_input_error=True),
    "trim.crosses": IssueCode("curves to cut intersect themselves or each other", is_input_error=True),
    "trim.in_waste": IssueCode("a curve lies in the waste of another curve", is_input_error=True),
    "trim.off_part": IssueCode("a curve with its slot and lead-ins leaves the opening of the clamp"),
    "trim.narrow": IssueCode("the waste is narrower than the slot"),
    "trim.corner": IssueCode(
        "a corner is too sharp for a round slot, or a bend or corner too sharp for a blade"
    ),
    "trim.joints": IssueCode("too many micro-joints for the curve"),
    "trim.lead": IssueCode("no lead-in with its pierce point fits into the waste"),
    "trim.wall": IssueCode(
        "a tool comes too close to a wall of the sheet, or its angle to the sheet is too flat"
    ),
    "trim.slow": IssueCode("the arm is slower in the slot than the cut of the torch allows"),
    # milling
    "milling.tool": IssueCode("the milling arm has no cutter", is_input_error=True),
    "milling.no_surface": IssueCode(
        "a cut names a surface that the part does not have, or requires a front face", is_input_error=True
    ),
    "milling.guides": IssueCode(
        "the two guide curves of a cut run in opposite directions, or meet", is_input_error=True
    ),
    "milling.guide_lengths": IssueCode(
        "the guide curves of a flank cut have very different lengths", is_input_error=True
    ),
    "milling.flute": IssueCode("the cutting length of the cutter is shorter than the wall"),
    "milling.holder": IssueCode("the holder of the cutter would be below the top of the wall"),
    "milling.corner": IssueCode("the surface has an inner corner, which a round cutter cannot mill"),
    "milling.twist": IssueCode("the cutter deviates from twisted rulings by more than the tolerance"),
    "milling.tool_radius": IssueCode("the cutter is too thick for a region of the part"),
    "milling.too_large": IssueCode("the face is too large to be checked at the resolution of its tolerance"),
    "milling.gouge": IssueCode("the cutter, shank, holder or spindle would cut into the part"),
    "milling.safe_plane": IssueCode("the tool axis is so flat that the tool never rises to the safe plane"),
    "milling.front": IssueCode("the front of the part faces away from the milling side"),
    "milling.pattern": IssueCode(
        "the milling lines are too many, cover nothing, or leave ridges above the tolerance"
    ),
    "milling.off_surface": IssueCode("a curve to engrave leaves the front of the part"),
    "forming.no_sheet": IssueCode("forming requires a sheet and a part", is_input_error=True),
    "forming.tool": IssueCode("the tool of an arm is not usable in this forming mode", is_input_error=True),
    "forming.side": IssueCode(
        "a feature points to the side on which no tool can form it", is_input_error=True
    ),
    "forming.closed_mesh": IssueCode(
        "the mesh of the part is closed, but one face of the sheet is required", is_input_error=True
    ),
    "forming.inside_out": IssueCode(
        "faces of the mesh of the part have inconsistent orientations", is_input_error=True
    ),
    "forming.wall_angle": IssueCode(
        "a wall is too steep to be formed, or too steep for one pass",
        acceptance="a pass, or its loops with springback, form a steeper wall than the metal is known to "
        "bear",
    ),
    "forming.support_radius": IssueCode("the ball of the supporting tool is too large for the part"),
    "forming.gap": IssueCode("the gap between the two tools exceeds its tolerance between targets"),
    "forming.shift": IssueCode(
        "the requested rotation of the support around the forming tool exceeds the wall angle"
    ),
    "forming.support_tool": IssueCode(
        "the forming mode requires a tool that is missing", is_input_error=True
    ),
    "forming.die_gouge": IssueCode("the die would cut into the part"),
    "forming.die_far": IssueCode(
        "a full die is too far from the part",
        acceptance="a full die does not touch the walls that it should support",
    ),
    "forming.holder": IssueCode("a die and this sheet holder are incompatible", is_input_error=True),
    "forming.holder_step": IssueCode(
        "the sinking clamp cannot follow the tool, or its last step misses the rim of the part"
    ),
    "forming.clamp": IssueCode("a tool collides with the clamp of the sheet"),
    "forming.clear": IssueCode("a tool cuts into a formed region of the sheet"),
    # sheet metals, forces, trials and tables of forming
    "forming.unknown_metal": IssueCode("unknown sheet metal", is_input_error=True),
    "forming.thickness_untested": IssueCode(
        "the sheet thickness is outside the range of known forming tests"
    ),
    "forming.trial": IssueCode("a trial of one laboratory failed at this wall angle, thickness and depth"),
    "forming.force_input": IssueCode(
        "a length, angle or force of the force estimate is out of range", is_input_error=True
    ),
    "forming.force": IssueCode(
        "the forming force exceeds the remaining payload of a robot",
        acceptance="the robots can press harder than their stated payload",
    ),
    "control.machine": IssueCode(
        "a field of the machine file is missing, unknown or out of range", is_input_error=True
    ),
    "control.unstable": IssueCode("a gain of force control or compensation would be unstable"),
    "control.band": IssueCode("the force leaves its band at the requested feed"),
    "control.range": IssueCode("the corrections exceed what the controller allows"),
    "forming.springback": IssueCode("the springback of the formed sheet after release exceeds the tolerance"),
    "forming.springback_mesh": IssueCode("the formed sheet cannot be meshed with so few triangles"),
    "forming.plate_test": IssueCode(
        "the readings of a plate test are implausible or too few", is_input_error=True
    ),
    "forming.clamp_unclear": IssueCode(
        "the readings of the plate test do not determine some values, or do not separate them"
    ),
    "forming.springback_mode": IssueCode("springback is not modelled for this job", is_input_error=True),
    "forming.compensation": IssueCode(
        "the springback file is truncated, changed, of another job, or exceeds its limits",
        is_input_error=True,
    ),
    "forming.compensated": IssueCode("the overforming that compensates springback"),
    "forming.limit_load": IssueCode("the formed sheet snaps through or buckles under the expected force"),
    "forming.loop_curves": IssueCode(
        "the file of springback curves is unreadable, truncated, or of another problem", is_input_error=True
    ),
    "forming.loop_forces": IssueCode(
        "the measured forces have other points, levels or units, or an invalid row", is_input_error=True
    ),
    "forming.loop_law": IssueCode("a parameter of the springback loop is out of range", is_input_error=True),
    "forming.loop_plant": IssueCode(
        "the plant file is invalid, or its sheet belongs to another part", is_input_error=True
    ),
    "forming.loop_unstable": IssueCode("a gain of the springback loop would be unstable from level to level"),
    "forming.loop_range": IssueCode("corrections of the springback loop were limited to their range"),
    "forming.adsif_table": IssueCode(
        "a table of the ADSIF response is unreadable, or contains an invalid value", is_input_error=True
    ),
    "forming.adsif_conditions": IssueCode(
        "the ADSIF table was measured for another metal, sheet, tool or path"
    ),
    "forming.adsif_range": IssueCode("the wall angle is outside the ADSIF table"),
    "forming.adsif_unstable": IssueCode(
        "the tool positions are unstable according to the ADSIF table, or outside it"
    ),
    "forming.adsif_compliance": IssueCode(
        "the deflection of the tools exceeds what the ADSIF gap can compensate"
    ),
    # paths of the contact on a face
    "forming.path_options": IssueCode(
        "a step, ridge height, chord or other value of the forming path is out of range", is_input_error=True
    ),
    "forming.no_contour": IssueCode("no part of the face lies between the levels of the path"),
    "forming.open_contour": IssueCode("a level line of the face ends at a border of its mesh"),
    "forming.unreached": IssueCode(
        "corners of the part are tighter than the forming ball, which does not reach them"
    ),
    "forming.tool_radius": IssueCode("the forming tool is too large for a region of the face"),
    # scans of formed parts
    "scan.file": IssueCode("the scan is unreadable, or has too few or too many points", is_input_error=True),
    "scan.unit": IssueCode(
        "the scan is far larger or smaller than the sheet: its unit is wrong", is_input_error=True
    ),
    "scan.flat": IssueCode(
        "too little of the flat flange around the part is in the scan", is_input_error=True
    ),
    "scan.other_part": IssueCode(
        "the scan shows another part, too little of the part, or its mirror image", is_input_error=True
    ),
    "scan.no_marks": IssueCode(
        "the scan has no marks, so its position in the sheet plane is assumed to be correct",
        is_input_error=True,
    ),
    "scan.marks": IssueCode("the marks do not locate the scan as accurately as the part is measured"),
    "scan.stray": IssueCode("the number of isolated points of the scan"),
    "scan.hole": IssueCode("a region of the part is missing in the scan", is_input_error=True),
    # the base of the second robot, from points that both probed
    "align.file": IssueCode(
        "a file of probed points is unreadable, or a value in it is missing or out of range",
        is_input_error=True,
    ),
    "align.cell": IssueCode(
        "the cell has no second arm, or its base cannot be updated in the file", is_input_error=True
    ),
    "align.few_points": IssueCode(
        "fewer than three points were probed, or too few remain", is_input_error=True
    ),
    "align.same_points": IssueCode("the probed points coincide", is_input_error=True),
    "align.collinear": IssueCode(
        "the probed points are collinear, so the rotation about their line is undetermined",
        is_input_error=True,
    ),
    "align.mirrored": IssueCode(
        "the probed points fit a mirror image, as if one axis had the wrong sign", is_input_error=True
    ),
    "align.units": IssueCode(
        "the points of the two robots differ by a common scale factor", is_input_error=True
    ),
    "align.bad_point": IssueCode("one probed point does not fit the others", is_input_error=True),
    "align.large_residual": IssueCode(
        "the residual of the probed points exceeds the limit, and no single point causes it",
        is_input_error=True,
    ),
    # G-code
    "gcode.syntax": IssueCode("a line is not valid G-code, or the file is not text", is_input_error=True),
    "gcode.word": IssueCode(
        "a G-code word is not supported, or has no meaning on its line", is_input_error=True
    ),
    "gcode.unit": IssueCode("the length unit of the G-code file is not stated", is_input_error=True),
    "gcode.mode": IssueCode(
        "a mode of the G-code file, such as G90 or G91, is not stated", is_input_error=True
    ),
    "gcode.plane": IssueCode("the plane of an arc in the G-code file is not stated", is_input_error=True),
    "gcode.feed": IssueCode("the feed in the G-code file is not stated or not positive", is_input_error=True),
    "gcode.spindle": IssueCode(
        "the G-code file cuts with a stopped spindle or without a spindle speed", is_input_error=True
    ),
    "gcode.rotary": IssueCode(
        "a G-code word rotates the tool, but no machine kinematics are stated", is_input_error=True
    ),
    "gcode.axis": IssueCode(
        "a tool axis of the G-code file is not a unit vector, or reverses within one move",
        is_input_error=True,
    ),
    "gcode.arc": IssueCode(
        "an arc of the G-code file has no centre, two centres, or an inconsistent one", is_input_error=True
    ),
    "gcode.position": IssueCode(
        "a G-code move starts or ends at a position that is not stated or too far away", is_input_error=True
    ),
    "gcode.tool": IssueCode("only one tool per G-code file is supported", is_input_error=True),
    "gcode.offset": IssueCode(
        "the G-code file uses a work offset that the problem does not define", is_input_error=True
    ),
    "gcode.empty": IssueCode("the G-code file contains no moves", is_input_error=True),
    "gcode.after_end": IssueCode(
        "the G-code file continues after the end of its program", is_input_error=True
    ),
    "gcode.skipped": IssueCode("a G-code code is skipped, as the problem requests", is_input_error=True),
    # motion
    "motion.no_reach": IssueCode("an arm cannot reach a target"),
    "motion.station": IssueCode(
        "no position of the track, table or positioner has a path for the operation", is_input_error=True
    ),
    "motion.joint_limit": IssueCode(
        "an arm exceeds a joint limit at a target for all values of its freedoms"
    ),
    "motion.singular": IssueCode(
        "an arm is too close to a singularity at a target for all values of its freedoms"
    ),
    "motion.no_path": IssueCode("no sequence of joint branches passes a target without a jump"),
    "motion.collision": IssueCode("bodies come too close at a target for all values of the freedoms"),
    "motion.linear_move": IssueCode("an arm cannot follow the linear move between two targets"),
    "motion.sag": IssueCode("the pose offset that compensates the compliance of an arm"),
    "motion.sag_range": IssueCode(
        "the compliance of an arm is beyond the compensation range, or too uneven between targets"
    ),
    "motion.overlap": IssueCode("static bodies of the cell overlap"),
    "motion.home": IssueCode("an arm at its home position is too close to a body"),
    "motion.entry": IssueCode("an arm has no collision-free path between home and its first or last target"),
    "motion.timing": IssueCode("no timing was found for a section of the path"),
    "motion.feed_min": IssueCode("the arms cannot make a move as fast as the process requires"),
    "motion.stops": IssueCode("the arm stops at corners that it would otherwise pass very slowly"),
    "motion.short_moves": IssueCode(
        "moves are so short in time or length that the controller may stop there"
    ),
    "motion.no_placement": IssueCode("no stock position was found from which the whole job is feasible"),
    "motion.path_kept": IssueCode(
        "the optimised path violates the clearance, so the path of the graph search is used"
    ),
    "motion.like": IssueCode("what was reused from the reference plan, and what was not"),
    "motion.solver": IssueCode("this build of Drake lacks the solvers that optimise a path"),
    "claims.unproven": IssueCode("a claim of a process is checked by no proof rule"),
    "claims.none": IssueCode("a process makes no claim about an operation"),
    "verify.unread": IssueCode(
        "a line of a third-party program is not understood, or one of its moves is not proven"
    ),
    "verify.no_programs": IssueCode("the result folder contains no programs"),
    # features of a part that is formed from a sheet
    "forming.undercut": IssueCode("the part has an undercut: a wall steeper than 90 degrees"),
    "forming.hole": IssueCode("the part has a hole, or a gap between facets", is_input_error=True),
    "forming.border": IssueCode("the edge of the part leaves the sheet plane", is_input_error=True),
    "forming.touching": IssueCode("two features touch or overlap", is_input_error=True),
    "forming.flat": IssueCode("the part is flat: nothing leaves the sheet plane", is_input_error=True),
    "forming.step": IssueCode(
        "the slicing step is not positive, or gives too many levels", is_input_error=True
    ),
    "forming.holes": IssueCode(
        "a formed area or a tool comes too close to a curve along which the sheet was cut"
    ),
    "forming.features": IssueCode(
        "the operations of a part name an unknown feature, name one twice, or omit one"
    ),
    "forming.order": IssueCode(
        "the forming order names a feature twice, omits one, or names one before its parent",
        is_input_error=True,
    ),
    # many problems at once
    "batch.crashed": IssueCode("the process that planned a problem ended unexpectedly"),
    "batch.timeout": IssueCode("planning a problem exceeded the time limit"),
    "batch.memory": IssueCode("planning a problem exceeded the memory limit"),
    "batch.cancelled": IssueCode("planning a problem was cancelled"),
    "batch.worker": IssueCode("worker processes do not start"),
    "batch.field": IssueCode(
        "a field of the batch file is missing, unknown or out of range", is_input_error=True
    ),
    "batch.csv": IssueCode(
        "the table of the batch file is unreadable, or a row does not match its header", is_input_error=True
    ),
    "batch.install": IssueCode("a cluster requires packages that are not installed", is_input_error=True),
    "batch.cluster": IssueCode("the cluster is unreachable, has no workers, or stopped responding"),
    "batch.versions": IssueCode("a cluster worker has other package versions than the client"),
    "batch.in_use": IssueCode("another batch is writing to the output folder", is_input_error=True),
    # the service
    "service.install": IssueCode("the service requires packages that are not installed"),
    "service.database": IssueCode("the database of the service cannot be opened or is unreachable"),
    "service.not_planning": IssueCode("the service accepts jobs, but none is planned at present"),
    "service.start": IssueCode("the service cannot start with these options"),
    "service.request": IssueCode("a field of the request is missing, unknown or out of range"),
    "service.not_found": IssueCode("the service has no such resource, or does not support the method"),
    "service.token": IssueCode("missing, unknown, revoked or expired token"),
    "service.log_in": IssueCode("login with the account provider failed"),
    "service.damaged": IssueCode("a stored program is damaged and is not served"),
    "service.role": IssueCode("the role of the token does not permit the request"),
    "service.foreign": IssueCode("the request comes from another site"),
    "service.link": IssueCode(
        "the link is expired, withdrawn or not signed by the service, or the job has too many links"
    ),
    "service.unknown_job": IssueCode("unknown job"),
    "service.unknown_file": IssueCode("the job has no such file"),
    "service.not_uploaded": IssueCode("the problem names a file that was not uploaded"),
    "service.file_name": IssueCode("the name of an uploaded file is missing, too long or not unique"),
    "service.archive": IssueCode("archives and compressed files are not accepted"),
    "service.too_large": IssueCode("an upload or one of its files exceeds the size limit"),
    "service.too_many": IssueCode(
        "the token has reached its limit of jobs, event streams or pending uploads"
    ),
    "service.stopping": IssueCode("the service stopped while it read an upload"),
    "service.storage": IssueCode("the storage quota of the token or of the service is exhausted"),
    "service.check_stopped": IssueCode("checking the problem exceeded the limit of time or memory"),
    "service.backup": IssueCode("a store of the service cannot be backed up or restored"),
    "service.idempotency": IssueCode("the idempotency key is invalid, or was used with another request"),
    "service.webhook": IssueCode("the webhook address is not usable, or the webhook does not exist"),
    "service.state": IssueCode("the state of the job does not permit the request"),
    "service.release": IssueCode("the programs cannot be released, or the release cannot be withdrawn"),
    "service.draft": IssueCode("the draft does not exist, or was changed by another user"),
    "service.gave_up": IssueCode("the service stopped several times while it worked on the job"),
    "service.answer": IssueCode("the server at this address does not answer like this service"),
    "service.timeout": IssueCode("the service did not answer, or the job did not end, within the time limit"),
    "service.version": IssueCode("the service is too new for the client, or too old for the request"),
    # internal
    "internal.error": IssueCode("internal error of Tandem; nothing was written"),
}


def all_codes() -> Mapping[str, IssueCode]:
    """Return the rows of Tandem and of all installed plug-ins, by code."""
    out = dict(CODES)
    for rows in _plugin_codes().values():
        out |= {code: row for code, row in rows.items() if code not in out}
    return out


def lookup_code(code: str) -> IssueCode:
    """Return the row of a code.

    Plug-ins are imported only for codes that are not Tandem's.

    Raises:
        KeyError: If neither Tandem nor a plug-in declares the code.
    """
    entry = CODES.get(code) or all_codes().get(code)
    if entry is None:
        raise KeyError(f"issue code {code!r} is not in planner/issue_codes.py; declare it there")
    return entry


def code_owners(code: str) -> frozenset[str]:
    """Return the packages that declare a code: "Tandem", or plug-ins such as "package ring-gauge"."""
    others = {owner for owner, rows in _plugin_codes().items() if code in rows}
    return frozenset({"Tandem", *others} if code in CODES else others)


def _plugin_codes() -> Mapping[str, Mapping[str, IssueCode]]:
    """Return rows by owner. The registry of processes refuses plug-ins whose rows cannot be loaded."""
    from planner.runtime import plugins  # imports importlib.metadata, which `tandem --help` does without

    out: dict[str, dict[str, IssueCode]] = {}
    for kind in (plugins.Process, plugins.Language):
        for name, rows in plugins.loadable(kind, "codes", dict).items():
            out.setdefault(plugins.installed(kind)[name].owner, {}).update(rows)
    return out
