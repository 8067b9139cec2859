"""Every issue code with its meaning: the one table that code, tests, ``tandem issues`` and the docs share.

A code is ``room.what``; it is stable once released. Plug-ins of other packages bring rows of their own
(:func:`all_codes`).
"""

import dataclasses
from collections.abc import Mapping
from typing import Final


@dataclasses.dataclass(frozen=True)
class Code:
    """A row of the table: what the code means; whether what was given is to blame (``given``: exit code 2) or
    what can be planned (3); what a problem accepts that names it (``accept:``); and what to do where an issue
    itself knows nothing better.

    What may be accepted speaks of what the user may know better than Tandem: forces, metal, how a block is
    really held up. What makes a motion wrong (collisions, limits, a wire that snaps, a slot of the wrong
    width) never may be.
    """

    meaning: str
    given: bool = False
    accepts: str | None = None
    remedy: str | None = None


_PLACE: Final = "move or turn the stock, and plan again"
_SLOWER: Final = "lower the feed there, or round the corner by more targets, and plan again"
_NEARER: Final = "put targets nearer to each other (tangent_deg, chord_mm), and plan again"

CODES: Final[dict[str, Code]] = {
    # problem files
    "problem.missing_file": Code("a file that the problem names does not exist", given=True),
    "problem.not_yaml": Code("the problem file is not YAML", given=True),
    "problem.field": Code("a field of the problem file is missing, unknown or out of range", given=True),
    "problem.duplicate_name": Code("two things of the same kind have the same name", given=True),
    "problem.track": Code("a track where none is written yet", given=True),
    "problem.turntable": Code(
        "turntable or positioner: none is written yet, or a block beside it", given=True
    ),
    "problem.too_large": Code("a file is larger than what is read", given=True),
    "problem.unknown_robot": Code("a robot that the catalogue does not have", given=True),
    # robots from files
    "robot.urdf": Code("the file of a robot is no URDF that can be read", given=True),
    "robot.chain": Code(
        "the chain of a URDF from base to tip has joints that follow others or slide, or is none", given=True
    ),
    "robot.limits": Code("a joint of a URDF has no range or no speed", given=True),
    "robot.bodies": Code("bodies of a robot for collision are not there or bound nothing", given=True),
    "robot.unseen": Code("links of a robot are shown by their bodies for collision", given=True),
    "robot.not_opw": Code("an arm of another class than those that are planned for", given=True),
    "robot.deviation": Code("the closed form of an arm leads beside the URDF's own kinematics", given=True),
    "problem.unknown_arm": Code("an operation names an arm that the cell does not have", given=True),
    "problem.unknown_process": Code("an operation names a process that there is not", given=True),
    "problem.process_package": Code(
        "an installed process cannot be loaded, or claims a name that is taken", given=True
    ),
    "problem.not_finite": Code("a number is NaN or infinite", given=True),
    "problem.accepted": Code("a problem accepts a finding that does not occur", given=True),
    # blocks that are held, and what is known of them
    "stock.gripper": Code("the arm that is to hold the block carries no gripper"),
    "stock.foam_missing": Code("something needs the block's foam, which the problem does not name"),
    "stock.too_heavy": Code("the block and its gripper are beyond the payload of the arm that holds them"),
    "stock.grip_force": Code("a gripper does not hold the block firmly enough"),
    "stock.grip_chosen": Code("which gripper of the cell was chosen for a block, and where it holds it"),
    "stock.support": Code(
        "the support of a block does not reach the floor, or the block does not rest on it",
        accepts="the support of a block does not reach the floor, or the block does not rest on it",
    ),
    "stock.hangs": Code(
        "nothing is stated on which a block stands", accepts="nothing is stated on which a block stands"
    ),
    "stock.footprint": Code("the gripper's face does not lie within the block's or the part's bottom face"),
    # building elements
    "element.surface": Code(
        "the surface of an element has holes, folds over its plane, fills no rectangle, touches itself, or "
        "has no room for panels side by side",
        given=True,
    ),
    "element.wire": Code("no wire is long enough for the smallest panel at some place of an element"),
    "element.tolerance": Code("panels are farther off the surface of an element than is allowed"),
    "element.shape": Code(
        "panels of an element cross themselves, fold over behind, lean too far or are too small"
    ),
    "element.count": Code("a shell of quads has more or fewer panels than asked, as its rows come out"),
    "element.concave": Code("planar panels of an element have inner corners"),
    "element.assembly": Code("panels of an element have no straight way in that is free, in any order tried"),
    "element.dowels": Code(
        "panels of an element come in without a dowel: their ways in lean too much, or there is no room"
    ),
    "element.block": Code("no block holds a panel at some place of an element"),
    "element.held": Code("panels of an element that no wire cuts safely, named where nothing avoids them"),
    "element.run": Code(
        "a report is asked of what is no element or no batch of it, or some of its panels are not proven",
        given=True,
    ),
    "element.mark": Code(
        "a panel is marked that an element does not have, or the list of marks is none or of other panels",
        given=True,
    ),
    "element.joint": Code("neighbouring panels of an element meet with a step larger than asked"),
    "element.face": Code("faces of an element's panels are cut off what is written, or on the panel's side"),
    "element.raw_block": Code("the block of a panel fits none of the raw blocks of its foam"),
    "element.cut": Code("the bow reaches some cuts of raw blocks in no way"),
    "element.stock": Code("a list of foam that is left over is none, or has wrong rows", given=True),
    "element.jobs": Code(
        "a template of an element is none, or a panel is meant by none of the templates or by several",
        given=True,
    ),
    # catalogue and cell
    "catalogue.missing_data": Code("a data file that is part of Tandem is missing or cannot be read"),
    "cell.body_name": Code(
        "a body of the cell has a name that another body has, or that is reserved", given=True
    ),
    # saved plans
    "output.folder": Code(
        "the output folder cannot be written, or holds the problem file itself", given=True
    ),
    "output.disk_full": Code("the disk that results are written to is full"),
    "plan.missing_file": Code("a file of a saved plan is missing or cannot be read"),
    "plan.damaged": Code("a file of a saved plan is damaged"),
    "plan.schema": Code("a saved plan comes from another format or schema version"),
    "plan.not_saveable": Code("a plan holds a value that is neither an array nor plain data"),
    # report
    "report.exhibit": Code(
        "an exhibit of a process is not of its kind's form and was left out of the report"
    ),
    # the general door, process: targets
    "targets.file": Code(
        "a file of targets cannot be read, or a value in it is missing or out of range", given=True
    ),
    "targets.held": Code("poses of one's own are given for a block that an arm holds", given=True),
    "targets.freedom": Code("a free axis gives both a turn and a slide, or neither", given=True),
    # wire shapes
    "wire.too_short": Code("a wire is shorter than the distance between its clamps"),
    "wire.unknown_material": Code("a wire material that is not built in", given=True),
    "wire.size": Code("the size of a wire or strip is missing, contradictory or not positive", given=True),
    "wire.temperature": Code("a wire temperature outside the range of its material", given=True),
    "wire.no_equilibrium": Code("the solver found no equilibrium of a wire with weight near its guess"),
    # kerf of a hot wire
    "kerf.unknown_foam": Code("a foam that is not built in", given=True),
    "kerf.no_data": Code("a foam has no test cuts, or not what a kerf model needs", given=True),
    "kerf.model": Code("a kerf model that does not exist", given=True),
    "kerf.input": Code("a power, speed, width or thickness is not a number above 0", given=True),
    "kerf.impossible": Code("no wire, speed or power gives such a kerf", given=True),
    "kerf.melts": Code("a power at which the wire reaches its limit temperature in air", given=True),
    "kerf.file": Code(
        "a file of test cuts cannot be read, or a value in it is missing or out of range", given=True
    ),
    "kerf.few_cuts": Code("too few test cuts are left, or all at one speed and power", given=True),
    "kerf.no_trend": Code("the kerf of test cuts does not grow with power over speed", given=True),
    "kerf.foam_file": Code("a field of a foam file is missing, unknown or out of range", given=True),
    "kerf.too_hot": Code(
        "a slot is wider than what leaves a usable face: the wire burns the foam", given=True
    ),
    "kerf.too_cold": Code("a slot is narrower than what leaves a usable face: the wire drags", given=True),
    "kerf.unsettled": Code(
        "an end of the wire nearly stands still beside the surface: no slot fits its own speed", given=True
    ),
    "kerf.doubt": Code("the kerf model is used outside of its tests", given=True),
    # meshes and parts
    "mesh.unreadable": Code("a mesh file is of a kind that is not read, or is damaged", given=True),
    "mesh.empty": Code("a mesh file has no faces with area", given=True),
    "mesh.unit": Code(
        "a mesh is implausibly large or small in its unit, or states another than the problem", given=True
    ),
    "mesh.file_unit": Code("the unit in which a mesh file was read that states its own", given=True),
    "mesh.non_manifold": Code("more than two faces of a mesh meet at an edge", given=True),
    "mesh.orientation": Code("neighbouring faces of a mesh have opposite normals", given=True),
    "mesh.closed": Code("a closed mesh is given where one open face is wanted", given=True),
    "mesh.pieces": Code("a mesh has several separate pieces where one is wanted", given=True),
    "part.mesh_noise": Code(
        "what was found of the noise of a part's mesh, and of the smooth face within it", given=True
    ),
    "part.mesh_tolerance": Code("the tolerance of a part's mesh is too large for the part", given=True),
    "part.offset": Code(
        "a face is bent more tightly than the distance by which it is to be offset", given=True
    ),
    "part.stock_too_small": Code("the part does not fit into the block", given=True),
    "part.faces": Code("front and back face of a part do not lie on each other's inner side", given=True),
    "part.missing_face": Code("a face is to be cut that the part does not have", given=True),
    "part.naca": Code("digits of a NACA section that no family has", given=True),
    "part.airfoil_format": Code(
        "a file of airfoil coordinates is in neither Selig's nor Lednicer's format", given=True
    ),
    "part.airfoil_order": Code("points of an airfoil are in the wrong order", given=True),
    "part.airfoil_open": Code("an airfoil has no trailing edge, or one side only", given=True),
    "part.airfoil_points": Code("an airfoil has too few points", given=True),
    "part.airfoil_crossing": Code("an airfoil crosses itself", given=True),
    "part.airfoil_note": Code(
        "an airfoil was put right: its order, its chord or points given twice", given=True
    ),
    "part.wing": Code("a wing has an implausible shape", given=True),
    "part.ruled_shape": Code("a ruled surface has rulings of no length, or folds over itself", given=True),
    "part.corners": Code("two guide curves have unequal numbers of corners", given=True),
    "part.guide": Code("a guide curve has too few points, no length, or crosses itself", given=True),
    "part.guide_turned": Code(
        "a guide curve was run the other way, so that the rulings do not cross", given=True
    ),
    "part.outline_open": Code("an outline through a plate is not closed", given=True),
    "part.outline_crossing": Code("an outline through a plate crosses itself", given=True),
    "part.outline_overlap": Code("outlines through a plate cross or touch each other", given=True),
    "part.outline_duplicate": Code("the same outline is given twice", given=True),
    "part.extra_missing": Code("a file needs a package that comes with an extra of Tandem", given=True),
    "part.dxf": Code("a DXF file cannot be read, or holds nothing that is wanted from it", given=True),
    "part.dxf_left_out": Code(
        "entities of a DXF file were left out because they are of no use here", given=True
    ),
    "part.dxf_unit": Code("a DXF file states another unit than the problem does", given=True),
    "part.rhino": Code(
        "a Rhino file cannot be read, or holds nothing, or not one thing, of what is wanted from it",
        given=True,
    ),
    "part.rhino_unit": Code("the unit in which a Rhino file was read", given=True),
    "part.rhino_left_out": Code("objects of a Rhino file were left out, or read in another way", given=True),
    "part.rhino_facets": Code("how far facets are off the face of a Rhino file, as measured", given=True),
    "part.step": Code(
        "a STEP or IGES file cannot be read, or has not the one face that is wanted", given=True
    ),
    "part.step_unit": Code("the unit in which a STEP or IGES file was read", given=True),
    "part.step_facets": Code(
        "how far facets are off the face of a STEP or IGES file, as measured", given=True
    ),
    "part.edges": Code("the boundaries of front and back cannot be joined by straight edges", given=True),
    "part.patch": Code("a mesh is not a patch with one boundary and four corners", given=True),
    "part.not_ruled": Code("a surface is farther from any ruled one than its tolerance", given=True),
    "part.ruled_deviation": Code("how far a surface is from the ruled one that stands for it", given=True),
    "part.strips": Code(
        "no number of ruled strips keeps a surface's tolerance, or a strip is not there", given=True
    ),
    "part.strips_found": Code("strips of a surface: their number, deviations and kinks", given=True),
    # planning a bent wire
    "wire.held": Code("an elastic wire is to cut a block that an arm holds"),
    "wire.chosen": Code("which of the wires at hand is to be mounted, and why"),
    "wire.shape": Code("an elastic wire does not meet a face within the tolerance"),
    "wire.curvature": Code("a planned wire is bent beyond its elastic limit"),
    "wire.unstable": Code("a planned wire shape snaps, or is close to it, in or out of its plane"),
    "wire.weight": Code("its weight takes the wire out of tolerance"),
    "wire.end_error": Code("errors of the wire's ends take it out of tolerance"),
    "wire.touches": Code("the wire comes too near to the block where it does not cut"),
    "wire.between_targets": Code("between two targets the driven wire leaves its wanted shape"),
    # planning a straight wire
    "bow.missing": Code("the arm that is to cut carries no bow with a straight wire"),
    "bow.arms": Code("an operation does not name the arm with the bow and the one that holds the block"),
    "bow.span": Code("the foam is wider than the bow's wire with its margins"),
    "bow.throat": Code("the block is deeper than the bow's throat on every side of the wire"),
    "straight.trim": Code("a side is to be trimmed where the block has no oversize"),
    "straight.corner": Code("an inner corner or curve is tighter than half a kerf"),
    "straight.crossing": Code("beside one piece of a surface the wire cuts into another"),
    "straight.uneven": Code("a slot grows and shrinks faster on the way than the wire can follow"),
    "straight.slit": Code("the wire comes to a hole through a slit in the part"),
    "straight.lead": Code("the wire would come to an outline through the part"),
    "straight.drop": Code(
        "what is above a level cut drops by a kerf before it is cut itself",
        accepts="what is cut off drops by a slot before it is cut itself",
    ),
    "part.missing_surface": Code("a ruled surface is to be cut that the part does not have", given=True),
    # writing programs
    "post.tasks": Code("the controller has no task or unit for an arm, or has too few", given=True),
    "post.language": Code("no programs are written for the controllers of an arm's family", given=True),
    "post.controller": Code("arms cannot move together by the controllers that they have", given=True),
    "post.signal": Code(
        "a signal has no number on the controller of a KUKA or UR arm, or one that mixes up two arms of UR",
        given=True,
    ),
    "post.trajectory": Code("no points of a trajectory keep a way at its speed"),
    "post.ur_arm": Code("an arm of the family ur is none that a UR controller moves", given=True),
    "post.blend": Code("a tool turns about its TCP where it may not stop: UR has no blend there"),
    "post.turn_near_zero": Code(
        "an axis is so near to zero that a KUKA controller may pass over its turn bit"
    ),
    "post.krl_turn": Code("a move turns so far that a KUKA controller may take another way between its ends"),
    "post.path": Code("a job that cannot go by spline blocks"),
    "post.spline": Code("KRL programs have spline blocks, which were not seen on a controller"),
    "post.spline_left": Code("moves that could not be put into spline blocks stay straight ones"),
    "post.krl_size": Code("KRL programs are too long for some controllers"),
    "post.plan": Code("a plan has times, joints or ways that no program can carry out"),
    "post.action": Code("an action of the process is at a target where the motion does not stop"),
    "post.name": Code(
        "a segment, tool or signal has a name that the language refuses, or that another has", given=True
    ),
    "post.tool": Code("a tool's data cannot be written"),
    "post.frame": Code("targets lie in a work frame that the program cannot refer to"),
    "post.option": Code("the controller has not the option that the programs need"),
    "post.no_split": Code("a program is too long for one module and has no stop to split it at"),
    "post.handshake_process": Code("work that two controllers cannot do that share digital signals only"),
    "post.handshake_drift": Code("what one arm a step ahead of the other does to the distance of the tools"),
    "post.load": Code("the block that an arm holds has no weight that the controller can be told"),
    # proof of the programs
    "verify.syntax": Code("a program is not RAPID as the controller reads it, or has no single straight way"),
    "verify.declarations": Code("something in a program is not declared, has no value or the wrong type"),
    "verify.pers_literal": Code("persistent data are not given a literal"),
    "verify.names": Code("a name in a program is not allowed, too long or taken"),
    "verify.line_length": Code("a line or string of a program is too long"),
    "verify.module_size": Code("a module has more moves or bytes than allowed"),
    "verify.decimals": Code("numbers of targets are too coarse, or a quaternion is not a unit one"),
    "verify.files": Code("program files are missing, left over, or not those that the list names"),
    "verify.digest": Code("the programs were not written for this problem"),
    "verify.problem_differs": Code("the problem in a result folder is not the one that it is proven against"),
    "sign.extra": Code("signatures need a package that is not installed"),
    "sign.key": Code("a file of keys for signatures cannot be used"),
    "sign.unproven": Code("a result that is not proven is not signed"),
    "sign.missing": Code("a result is not signed"),
    "sign.signature": Code("a signature is not by the keys given, or not of this text"),
    "sign.content": Code("a result is not what was signed"),
    "sign.good": Code("a result is signed and as it was then"),
    "upload.unproven": Code(
        "a result that is not verified, or whose files are not those of its proof", given=True
    ),
    "upload.release": Code(
        "a result's release was withdrawn, is of other programs, or is missing where asked for", given=True
    ),
    "upload.address": Code("the address of a controller, or what to send there, is not stated", given=True),
    "upload.controller": Code("a controller cannot be reached, or answers otherwise than it should"),
    "upload.login": Code("a controller refuses the login, or its certificate is not trusted"),
    "upload.busy": Code("a controller runs, is in manual mode, or is held by somebody else"),
    "upload.write": Code("a file is not on the controller as it was sent"),
    "upload.differs": Code("the controller is not as the programs were planned for"),
    "upload.not_looked_at": Code("something of a controller was not read, and so not compared"),
    "upload.missing": Code("programs that were looked for on a controller are not there"),
    "upload.touched": Code("a target or datum on the controller is not that of the result"),
    "verify.task_list": Code("a synchronisation point does not name all tasks"),
    "verify.sync_order": Code(
        "the tasks do not pass the same synchronisation points in the same order, each once"
    ),
    "verify.handshake": Code(
        "two controllers that share signals may wait for ever, lose a signal or run apart"
    ),
    "verify.step_apart": Code(
        "arms that may be one step apart come too near, or their tools' gap is too far off"
    ),
    "verify.meeting_time": Code("a meeting ends the run when somebody answers late, or may last for ever"),
    "verify.error_handler": Code(
        "an error handler is missing, does not switch off, stop and say so, or goes on"
    ),
    "verify.undo": Code("leaving a procedure by the side would leave the power on or a block open"),
    "verify.motion_settings": Code("settings make the moves slower than their times say"),
    "verify.move_count": Code("the tasks have different numbers of moves in a synchronised block"),
    "verify.move_ids": Code("IDs of synchronised moves are missing, not equal or not ascending"),
    "verify.zone_kind": Code("of two moves that run together one stops and the other does not"),
    "verify.move_time": Code("moves that run together have no time or different times"),
    "verify.duration": Code("the programs, or the facets of a face, are more than what the proof looks at"),
    "verify.setup": Code(
        "a setup is not told, not confirmed once and in order, or an arm moves before it is"
    ),
    "verify.dialogue": Code(
        "the operator is told or asked something else than what follows from the problem"
    ),
    "verify.dialogue_figures": Code("a figure that the operator is told is not that of the motion"),
    "verify.signals": Code("a signal other than a wire's is switched, or not in one plain way"),
    "verify.held_frame": Code("work on a held block is not in the frame that its holder carries"),
    "verify.load": Code("the controller does not know the load of a held block, or still counts with one"),
    "verify.bow": Code("a clamp of a straight wire comes too near to the foam that it cuts"),
    "verify.rulings": Code(
        "a straight wire leaves the rulings of the wanted surface, or misses a part of them"
    ),
    "verify.order": Code("cuts follow one another in another order than the operation states"),
    "verify.part": Code(
        "the wire cuts into the part on its way in or out, or into another surface than its own"
    ),
    "verify.slit": Code("a wire comes to a cut from elsewhere than stated, or by too long a slit"),
    "verify.kerf": Code("the slot is narrower or wider than wanted at the wire's actual speed"),
    "verify.cell_check": Code(
        "a program does not compare the controller's frames with the plan before it moves"
    ),
    "verify.start_posture": Code(
        "a move of a trajectory begins where nobody has looked that the joints are, or not at home"
    ),
    "verify.goal_tolerances": Code("a move of a trajectory goes on farther off its way than the cell states"),
    "verify.power_on_failure": Code("an output stays on where a step of a trajectory does not end"),
    "verify.between_points": Code("between two points of a trajectory the tool leaves the straight way"),
    "verify.controller_files": Code("files for a controller are missing, changed, or fit other programs"),
    "verify.hidden": Code("something runs beside the straight way, or may: it is not proven"),
    "verify.speed_data": Code("the speed beside a move's time is below what way and time ask for"),
    "verify.arms_alone": Code("two arms move at once without synchronisation"),
    "verify.wire_alone": Code("an arm moves alone while a wire is mounted"),
    "verify.stop_before_logic": Code("an arm does not stop before a signal, wait or synchronisation point"),
    "verify.tool_data": Code("the tool data of a program are not those of the cell"),
    "verify.work_object": Code("a work object is not where the stock stands"),
    "verify.rests": Code("a block is not held or borne as it must be"),
    "verify.base_frames": Code("the base frame that a program states is not the problem's"),
    "verify.move_kinds": Code("a move whose path is not known, or ConfL is not as the arm needs it"),
    "verify.external_axes": Code(
        "unit, value or moves of a track, table or positioner are not as they must be"
    ),
    "verify.track_along": Code("a track that goes along does not by its law, or asks for more than it can"),
    "verify.track_way": Code("bodies come too near on the way of a track, table or positioner to a station"),
    "verify.zone_size": Code("a zone takes more than half of the shorter move beside it"),
    "verify.zero_length": Code("a move goes nowhere"),
    "verify.wire_mount": Code("nobody confirms that the wire is mounted, or that it is taken off"),
    "verify.reach": Code("an arm cannot go the path that a program states", remedy=_PLACE),
    "verify.corner": Code("a zone joins a joint move and a straight one"),
    "verify.continuity": Code("a joint jumps to another solution"),
    "verify.confdata": Code("the configuration numbers do not select the joint solution of the motion"),
    "verify.status": Code("Status and Turn of a KRL target do not select the joint solution, or not alone"),
    "verify.joint_limits": Code(
        "a joint leaves its limits", remedy=f"{_PLACE}; settings.joint_margin_deg says how far arms keep off"
    ),
    "verify.rod_limits": Code(
        "axis 3 of a parallel-rod arm, as its controller counts it, leaves its limits",
        remedy="take a longer or thinner wire, and plan again",
    ),
    "verify.joint_speed": Code("the times ask for a joint speed above the robot's", remedy=_SLOWER),
    "verify.joint_acceleration": Code(
        "the times ask for a joint acceleration above the robot's", remedy=_SLOWER
    ),
    "verify.spline": Code("what is not known of a spline block's curve leaves too little room"),
    "verify.singularity": Code(
        "an arm comes too near to a singular posture",
        remedy=f"{_PLACE}; settings.singularity_margin_deg says how far arms keep off",
    ),
    "verify.tcp_speed": Code(
        "a tool moves faster than the problem allows",
        remedy="lower the feed, and plan again; settings.tcp_speed_mm_s is the most allowed",
    ),
    "verify.unknown_start": Code(
        "a move whose start is not known may be too fast, or a joint move states a time"
    ),
    "verify.power_idle": Code(
        "power is on for too long while nothing moves, or while somebody is waited for"
    ),
    "verify.follows": Code("a tool does not pass the poses that the problem gives"),
    "verify.wire_length": Code("the wire's ends are too far apart, or no shape of it meets both clamps"),
    "verify.wire_stability": Code("the wire's shape is not stable, or snaps to another one"),
    "verify.curvature": Code("the wire is bent beyond its elastic limit"),
    "verify.contact": Code("the wire touches the stock where it must not cut"),
    "verify.stop_in_foam": Code("the wire stands still inside the stock"),
    "verify.wire_power": Code(
        "the wire's power is off in the stock, on at an operator's hands, or on too briefly"
    ),
    "verify.feed": Code("the wire's speed in the stock is outside the feed window"),
    "verify.sag": Code("what is taken of an arm that gives way is not what the problem states, or too much"),
    "verify.kinematics": Code("a link or a tool is not where the joints put it"),
    "verify.robot_model": Code(
        "a robot's URDF cannot be followed, or is not of the robot that was planned with"
    ),
    "verify.clearance": Code(
        "bodies of the cell come too near to each other",
        remedy="move what is in the way, or the stock, and plan again",
    ),
    "verify.own_clearance": Code(
        "links or tool of one arm come too near to each other",
        remedy="mount the tool otherwise, or let targets turn more freely, and plan again",
    ),
    "verify.wire_clearance": Code(
        "the wire comes too near to a body", remedy="move what is in the wire's way, and plan again"
    ),
    "verify.part_file": Code(
        "the part, as the proof reads its file once more, is not what the programs make"
    ),
    "verify.surface": Code("too little of the cut surface is within tolerance of the wanted one"),
    "verify.gouge": Code(
        "a forming tool cuts into the face that it forms, or goes through the flat sheet",
        remedy="take a smaller forming tool or round the part more, and plan again",
    ),
    "verify.formed": Code(
        "too little of a face is formed, the ball is off it too long, or no claim is made there"
    ),
    "verify.gap": Code(
        "the gap between two forming tools, or the way they face each other, is not as wanted", remedy=_NEARER
    ),
    "verify.border": Code("a support leaves the border of what is formed, or cuts across it"),
    "verify.opposite": Code("a tool that follows a forming one across the sheet is not opposite of it"),
    "verify.sheet": Code(
        "a forming tool runs into what is formed already, or through the sheet",
        remedy="take a slimmer tool, another order, or let it lean (lean_deg), and plan again",
    ),
    "verify.holder": Code("the signal of a clamp that sinks is not pulsed with the level that is formed"),
    "verify.adsif": Code(
        "tools that form by a response table are not where it wants them for the wanted face", remedy=_NEARER
    ),
    "verify.forming_part": Code(
        "what passes form does not make the part, or not in the wanted order and shapes"
    ),
    "verify.forming_holes": Code(
        "what is formed, or a tool that forms, comes nearer than wanted to a curve of a cut before"
    ),
    "verify.forming_claims": Code(
        "what is claimed of a pass does not follow from the part and the user's numbers"
    ),
    "verify.feature_order": Code(
        "the segments that form a sheet are not those claimed, each once and in order"
    ),
    "verify.springback": Code(
        "tools go deeper than the part by another amount or on another way than the springback file says, "
        "what that says is wrong, or it makes walls too steep",
        remedy="write the file again (tandem springback PROBLEM --write FILE) and plan again",
    ),
    "verify.level": Code(
        "one level of a pass is not the one that the problem states, or deeper by another amount than its "
        "file says, or that is of another job, beyond its limits or makes walls too steep",
        remedy="write problem and file again (tandem next-loop OUT --problem FILE) and plan again",
    ),
    "verify.forming_feed": Code("a tool moves faster on the sheet than it may"),
    "verify.lean": Code("a forming tool leans farther than the problem lets it"),
    "verify.ridge": Code("a ridge or groove stands out of the cut surface"),
    # passes over a sheet, and the tool that supports it
    "verify.milled": Code(
        "a milled surface is not within its tolerance, or something is milled that is not claimed",
        remedy="take a smaller cutter or finer steps, and plan again",
    ),
    "verify.mill_gouge": Code(
        "a cutter, its shank, holder or spindle goes into the part",
        remedy="take a smaller or slimmer cutter or tilt its axis, and plan again",
    ),
    "verify.mill_path": Code("the tip of a cutter or its axis is off the curve that it follows"),
    "verify.mill_feed": Code(
        "a cutter moves faster than it may, or a segment that mills has no feed",
        remedy="lower the feed, and plan again",
    ),
    "verify.spindle": Code(
        "a cutter is in the block and its spindle is not up to speed, or where nothing is milled"
    ),
    # curves cut out of a formed sheet
    "verify.trim_cut": Code(
        "an outline of a trimmed sheet is not cut as wanted, or is left uncut elsewhere than at its joints"
    ),
    "verify.trim_kept": Code("a torch, a mill or a knife cuts into what is to stay"),
    "verify.trim_torch": Code("a torch that cuts is not as far off the sheet as wanted, or leans too far"),
    "verify.trim_arc": Code(
        "an arc starts in the wrong place, is not waited for, or burns where nothing is cut"
    ),
    "verify.trim_order": Code("an outline is cut before one that lies in it"),
    "verify.trim_feed": Code(
        "a torch cuts faster or slower than the sheet's thickness wants", remedy=_SLOWER
    ),
    "verify.trim_mill": Code(
        "a mill that trims is not as deep as wanted, leans too far, goes into the sheet otherwise than it "
        "may, or cuts beside its slot"
    ),
    "verify.trim_spindle": Code(
        "a mill or a knife is in a sheet while its drive is not on for long enough, or elsewhere"
    ),
    "verify.trim_knife": Code(
        "a knife that trims is not as deep as wanted, stands or leans off its curve, or turns in the sheet"
    ),
    "verify.trim_clear": Code("a tool comes nearer to the sheet that it trims than it may"),
    "trim.tool": Code(
        "an arm that is to trim carries no torch, mill or knife, or one that does not go through the sheet",
        given=True,
    ),
    "trim.die": Code("a mill or a knife is to go through a sheet behind which there is a die", given=True),
    "trim.no_sheet": Code("a sheet is to be trimmed where there is none, or none that is formed", given=True),
    "trim.open": Code("a curve that is to be cut is not closed", given=True),
    "trim.crosses": Code("curves that are to be cut cross themselves or each other", given=True),
    "trim.in_waste": Code("a curve lies in what another one lets drop", given=True),
    "trim.off_part": Code("a curve, with its slot and its ways in, leaves the opening of the clamp"),
    "trim.narrow": Code("the waste is narrower than the slot"),
    "trim.corner": Code("a corner is too sharp for a round slot, or a bend or a corner for a blade"),
    "trim.joints": Code("more micro-joints than fit on a curve"),
    "trim.lead": Code("no way in with its pierce point fits into the waste"),
    "trim.wall": Code("a tool comes nearer to a wall of the sheet than it may, or stands too flat"),
    "trim.slow": Code("an arm is slower in a slot than the torch's cut allows"),
    # milling
    "milling.tool": Code("an arm that is to mill carries no cutter", given=True),
    "milling.no_surface": Code(
        "a cut names a surface that the part does not have, or needs a front", given=True
    ),
    "milling.guides": Code("two curves of a cut run against each other, or meet", given=True),
    "milling.guide_lengths": Code("the guides of a flank cut are of very different lengths", given=True),
    "milling.flute": Code("the cutting length of a cutter is shorter than the wall that its side mills"),
    "milling.holder": Code("the holder of a cutter would be below the top of the wall that is milled"),
    "milling.corner": Code("a surface has an inner corner, which a round cutter cannot mill"),
    "milling.twist": Code("a cutter is off twisted rulings by more than the tolerance"),
    "milling.tool_radius": Code("a cutter is too thick for a place of the part"),
    "milling.too_large": Code("a face is too large to be looked at as closely as its tolerance wants"),
    "milling.gouge": Code("a cutter, its shank, holder or spindle would go into the part"),
    "milling.safe_plane": Code("a tool stands so flat that it never rises to the safe plane"),
    "milling.front": Code("the part's front turns away from the side from which it is milled"),
    "milling.pattern": Code(
        "the lines of a face are too many, leave nothing of it, or ridges over its tolerance"
    ),
    "milling.off_surface": Code("a curve to be engraved leaves the part's front"),
    "forming.no_sheet": Code("forming without a sheet, or without a part that is one", given=True),
    "forming.tool": Code("an arm carries a tool that its mode of forming cannot use", given=True),
    "forming.side": Code("a feature goes to the side on which no tool can form it", given=True),
    "forming.closed_mesh": Code(
        "the mesh of a part is closed, where one face of the sheet is asked for", given=True
    ),
    "forming.inside_out": Code("faces of a part's mesh look to different sides", given=True),
    "forming.wall_angle": Code(
        "a wall is too steep to be formed, or too steep for one pass",
        accepts="a pass, or its loops with their springback, form a steeper wall than the metal is known to "
        "bear at once",
    ),
    "forming.support_radius": Code("the supporting tool's ball is larger than the part leaves room for"),
    "forming.gap": Code("between targets the gap of two tools cannot be kept as well as it should be"),
    "forming.shift": Code("a support is to be turned around the former by more than the wall's angle"),
    "forming.support_tool": Code("a mode of forming has not the tool that it needs", given=True),
    "forming.die_gouge": Code("a die would cut into the wanted part"),
    "forming.die_far": Code(
        "a full die is too far from the wanted part",
        accepts="a full die is away from the walls that it is to hold",
    ),
    "forming.holder": Code("a die and the holder of its sheet do not go together", given=True),
    "forming.holder_step": Code(
        "a clamp that sinks by steps cannot follow the tool, or ends off the part's rim"
    ),
    "forming.clamp": Code("a tool reaches into the clamp of the sheet"),
    "forming.clear": Code("a tool cuts into a part of the sheet that is formed already"),
    # sheet metals, forces, trials and tables of forming
    "forming.unknown_metal": Code("a sheet metal that is not built in", given=True),
    "forming.thickness_untested": Code("a sheet is thicker or thinner than the forming tests that are known"),
    "forming.trial": Code("a trial of one lab failed at such a wall, thickness and depth"),
    "forming.force_input": Code("a length, angle or force of a force estimate is out of range", given=True),
    "forming.force": Code(
        "the forming force is beyond the payload that a robot has left",
        accepts="the robots press far harder than their payload says",
    ),
    "control.machine": Code("a field of a machine file is missing, unknown or out of range", given=True),
    "control.unstable": Code("a gain of force control or of compensation that would swing up"),
    "control.band": Code("a force that leaves its band at the feed that is wanted"),
    "control.range": Code("corrections beyond what the controller allows"),
    "forming.springback": Code(
        "a formed sheet comes back by more than parts may be off when the tool lets go"
    ),
    "forming.springback_mesh": Code("the sheet as formed cannot be divided into so few triangles"),
    "forming.plate_test": Code("readings of a plate test that cannot be ones, or are too few", given=True),
    "forming.clamp_unclear": Code("what readings of a plate test do not tell, or not apart"),
    "forming.springback_mode": Code("springback is asked of what has no model for it", given=True),
    "forming.compensation": Code(
        "a springback file cannot be used: cut short, changed, of another job, or beyond its limits",
        given=True,
    ),
    "forming.compensated": Code("by how much tools go deeper than the part, for the sheet comes back"),
    "forming.limit_load": Code("a formed sheet snaps through or buckles under the force that is expected"),
    "forming.loop_curves": Code(
        "a file of springback curves cannot be read, is cut short, or is of another problem", given=True
    ),
    "forming.loop_forces": Code(
        "measured forces of other points, levels or units, or a row of them is wrong", given=True
    ),
    "forming.loop_law": Code("a figure of the springback loop is out of range", given=True),
    "forming.loop_plant": Code("a plant's file is wrong, or its sheet is another part's", given=True),
    "forming.loop_unstable": Code("a gain of the springback loop that would swing up from level to level"),
    "forming.loop_range": Code("corrections of the springback loop were cut to their range"),
    "forming.adsif_table": Code(
        "a table of the ADSIF response cannot be read, or a value in it is wrong", given=True
    ),
    "forming.adsif_conditions": Code("the ADSIF table holds for another metal, sheet, tool or path"),
    "forming.adsif_range": Code("a wall angle that the ADSIF table does not reach"),
    "forming.adsif_unstable": Code("tool positions that the ADSIF table calls unstable, or beyond it"),
    "forming.adsif_compliance": Code("the tools give way by more than the ADSIF gap can make up for"),
    # paths of the contact on a face
    "forming.path_options": Code(
        "a step, ridge height, chord or other figure of a forming path is out of range", given=True
    ),
    "forming.no_contour": Code("nothing of a face lies between the levels that a path is to go"),
    "forming.open_contour": Code("a level line of a face ends at a border of its mesh"),
    "forming.unreached": Code(
        "what a forming ball does not reach of a part: corners that are tighter than it is"
    ),
    "forming.tool_radius": Code("a forming tool is too large for a place of the face"),
    # scans of formed parts
    "scan.file": Code("a scan cannot be read, or has too few points or too many", given=True),
    "scan.unit": Code("a scan is far larger or smaller than the sheet: a wrong unit", given=True),
    "scan.flat": Code("too little of the flat around a part is in its scan", given=True),
    "scan.other_part": Code("a scan shows another part, too little of it, or its mirror image", given=True),
    "scan.no_marks": Code(
        "a scan came without marks, so its place in the sheet's plane is taken as it is", given=True
    ),
    "scan.marks": Code("marks agree too little to say where a scan lies as well as a part is measured"),
    "scan.stray": Code("how many points of a scan belong to nothing around them"),
    "scan.hole": Code("a place of a part that its scan does not show", given=True),
    # the base of the second robot, from points that both probed
    "align.file": Code(
        "a file of probed points cannot be read, or a value in it is missing or out of range", given=True
    ),
    "align.cell": Code("a cell has no second arm, or its base cannot be rewritten in place", given=True),
    "align.few_points": Code("fewer than three points were probed, or too few are left", given=True),
    "align.same_points": Code("probed points lie in one place", given=True),
    "align.collinear": Code(
        "probed points lie on one line, so that the turn about it is unknown", given=True
    ),
    "align.mirrored": Code(
        "probed points fit a mirror image, as when an axis has the wrong sign", given=True
    ),
    "align.units": Code(
        "the points of one robot are a common factor larger than those of the other", given=True
    ),
    "align.bad_point": Code("a probed point does not fit the others", given=True),
    "align.large_residual": Code(
        "probed points fit worse than allowed, and no one of them is to blame", given=True
    ),
    # G-code
    "gcode.syntax": Code("a line is no G-code, or a file no text", given=True),
    "gcode.word": Code(
        "a word or code of G-code that is not carried out, or means nothing on its line", given=True
    ),
    "gcode.unit": Code("lengths of a G-code file are in a unit that is stated nowhere", given=True),
    "gcode.mode": Code("a mode of a G-code file, such as G90 or G91, is stated nowhere", given=True),
    "gcode.plane": Code("an arc of a G-code file lies in a plane that is stated nowhere", given=True),
    "gcode.feed": Code("a feed of a G-code file is stated nowhere, or is none", given=True),
    "gcode.spindle": Code("a G-code file cuts while the spindle stands, or its speed is none", given=True),
    "gcode.rotary": Code(
        "a word of G-code turns the tool, but no machine is stated that says how", given=True
    ),
    "gcode.axis": Code(
        "a tool axis of a G-code file is no unit vector, or turns over in one move", given=True
    ),
    "gcode.arc": Code("an arc of a G-code file has no centre, two, or one that does not fit", given=True),
    "gcode.position": Code(
        "a G-code file moves from or to a place that is not stated, or is too far", given=True
    ),
    "gcode.tool": Code("a G-code file has a second tool, or changes to none", given=True),
    "gcode.offset": Code("a G-code file counts from an origin that the problem does not place", given=True),
    "gcode.empty": Code("a G-code file has no moves", given=True),
    "gcode.after_end": Code("a G-code file goes on after its program's end", given=True),
    "gcode.skipped": Code("a code of a G-code file is passed over, as the problem says", given=True),
    # motion
    "motion.no_reach": Code("an arm cannot reach a target"),
    "motion.station": Code(
        "no value of a track, table or positioner has a path for an operation", given=True
    ),
    "motion.joint_limit": Code("an arm passes a joint limit at a target whatever its freedoms"),
    "motion.singular": Code("an arm comes too near a singular posture at a target whatever its freedoms"),
    "motion.no_path": Code("no choice of branches carries the arms past a target without a jump"),
    "motion.collision": Code("bodies come too near each other at a target whatever its freedoms"),
    "motion.linear_move": Code("an arm cannot follow the straight move between two targets"),
    "motion.sag": Code("by how much an arm is commanded off where it is wanted, to make up for its sag"),
    "motion.sag_range": Code(
        "an arm gives way by more than may be made up for, or too unevenly between targets"
    ),
    "motion.overlap": Code("bodies of the cell that stand still are inside of one another"),
    "motion.home": Code("the arms are too near something while all are at home"),
    "motion.entry": Code("an arm has no free way between home and its first or last target"),
    "motion.timing": Code("no clock was found for a piece of the path"),
    "motion.feed_min": Code("the arms cannot make a move as fast as the process wants"),
    "motion.stops": Code("the arm stops at corners that it would else have to pass very slowly"),
    "motion.short_moves": Code("moves take or go less than controllers like, so that these may stop there"),
    "motion.no_placement": Code("no place of the stock was found from which the whole job can be done"),
    "motion.path_kept": Code("the optimised path did not keep clearance, so the ladder's path is used"),
    "motion.like": Code("what was taken over from the plan of a problem like this one, and what was not"),
    "motion.solver": Code("this build of Drake lacks the solvers that improve a path"),
    "claims.unproven": Code("a process claims something that no rule of the proof looks at"),
    "claims.none": Code("a process claims nothing of an operation"),
    "verify.unread": Code("a line of somebody else's program is not read, or a move of it is not proven"),
    "verify.no_programs": Code("a result folder holds no programs"),
    # features of a part that is formed from a sheet
    "forming.undercut": Code("a part turns over: a wall beyond 90 degrees"),
    "forming.hole": Code("a part has a hole, or a crack between facets", given=True),
    "forming.border": Code("the edge of a part leaves the sheet plane", given=True),
    "forming.touching": Code("two features touch or lie over each other", given=True),
    "forming.flat": Code("nothing of a part leaves the sheet plane", given=True),
    "forming.step": Code("a slicing step is no length above 0, or gives too many levels", given=True),
    "forming.holes": Code("what is formed, or a tool, comes too near to a curve along which a sheet was cut"),
    "forming.features": Code(
        "operations that form some features of a part name one that it has not, one twice, or not all"
    ),
    "forming.order": Code(
        "an order of forming names a feature twice, not at all, or before what it stands on", given=True
    ),
    # many problems at once
    "batch.crashed": Code("the process that planned a problem ended before it was done"),
    "batch.timeout": Code("planning a problem took longer than was allowed"),
    "batch.memory": Code("planning a problem needed more memory than was allowed"),
    "batch.cancelled": Code("planning a problem was cancelled"),
    "batch.worker": Code("worker processes do not start"),
    "batch.field": Code("a field of a batch file is missing, unknown or out of range", given=True),
    "batch.csv": Code(
        "a batch file's table cannot be read, or a line of it does not fit its heading", given=True
    ),
    "batch.install": Code("a cluster needs packages that are not installed", given=True),
    "batch.cluster": Code("a cluster cannot be reached, has no workers, or went away"),
    "batch.versions": Code("a worker of a cluster has other versions than what plans on it"),
    "batch.in_use": Code("another batch is writing to the output folder", given=True),
    # the service
    "service.install": Code("the service needs packages that are not installed"),
    "service.database": Code("the database of the service cannot be opened, or is away"),
    "service.not_planning": Code("the service takes jobs in, and none is planned now"),
    "service.start": Code("the service cannot be started as asked"),
    "service.request": Code("a request to the service has a field that is missing, unknown or out of range"),
    "service.not_found": Code("the service has nothing at that address, or not by that method"),
    "service.token": Code("a request to the service has no token, or one that is unknown, revoked or over"),
    "service.log_in": Code("somebody cannot log in by the provider of accounts"),
    "service.damaged": Code("a stored program is not as it was written, and is not given out"),
    "service.role": Code("a request to the service is beyond what the role of its token allows"),
    "service.foreign": Code("a request comes from another site"),
    "service.link": Code("a link is over, withdrawn or not signed by the service, or a job has too many"),
    "service.unknown_job": Code("a job that the service does not have"),
    "service.unknown_file": Code("a file that a job does not have"),
    "service.not_uploaded": Code("a problem names a file that was not uploaded with it"),
    "service.file_name": Code("an uploaded file has no name, a name too long, or one that another file has"),
    "service.archive": Code("an archive or compressed file was uploaded"),
    "service.too_large": Code("an upload or a file of it is larger than the service takes"),
    "service.too_many": Code("a token has as many jobs, streams of events or waiting uploads as it may have"),
    "service.stopping": Code("the service was told to stop while it read an upload"),
    "service.storage": Code("the files of a token, or of the whole service, have no more room"),
    "service.check_stopped": Code("reading or checking a problem took too much time or memory"),
    "service.backup": Code("a store of the service cannot be backed up, or a backup not be restored"),
    "service.idempotency": Code("an idempotency key is none, or came with another request before"),
    "service.webhook": Code("an address cannot be told of jobs that end, or there is no such webhook"),
    "service.state": Code("a job is in a state in which what is asked of it cannot be done"),
    "service.release": Code("programs cannot be released, or a release not be withdrawn"),
    "service.draft": Code("a draft is not there, or was saved by somebody else meanwhile"),
    "service.gave_up": Code("the service stopped several times while it worked on a job"),
    "service.answer": Code("an address does not answer as this service does"),
    "service.timeout": Code("the service did not answer, or a job did not end, in the time that was given"),
    "service.version": Code("the service is too new for a client, or too old for what it was asked"),
    # internal
    "internal.error": Code("Tandem itself failed; nothing was written"),
}


def all_codes() -> Mapping[str, Code]:
    """Return the rows of Tandem and of all installed plug-ins by code."""
    out = dict(CODES)
    for rows in _of_plugins().values():
        out |= {code: row for code, row in rows.items() if code not in out}
    return out


def row(code: str) -> Code:
    """Return the row of a code. Plug-ins are imported only for codes that are not Tandem's.

    Raises:
        KeyError: Neither Tandem nor a plug-in states the code.
    """
    found = CODES.get(code) or all_codes().get(code)
    if found is None:
        raise KeyError(f"issue code {code!r} is not in planner/issue_codes.py; declare it there")
    return found


def owners(code: str) -> frozenset[str]:
    """Return who states a code: "Tandem", and packages such as "package ring-gauge"."""
    others = {owner for owner, rows in _of_plugins().items() if code in rows}
    return frozenset({"Tandem", *others} if code in CODES else others)


def _of_plugins() -> Mapping[str, Mapping[str, Code]]:
    """Rows by owner. The registry of processes refuses a plug-in whose rows cannot be loaded."""
    from planner.runtime import plugins  # imports importlib.metadata, which `tandem --help` does without

    out: dict[str, dict[str, Code]] = {}
    for kind in (plugins.Process, plugins.Language):
        for name, rows in plugins.loadable(kind, "codes", dict).items():
            out.setdefault(plugins.installed(kind)[name].owner, {}).update(rows)
    return out
