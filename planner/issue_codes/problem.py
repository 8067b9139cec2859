"""Issue codes of problem files: fields, robots, cells, stock and targets."""

from typing import Final

from planner.issue_codes.row import IssueCode

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
    "problem.unknown_robot": IssueCode(
        "the robot is not in the catalogue",
        is_input_error=True,
        message="robot {name!r} is not in the catalogue, which has {known_robots}",
    ),
    # robots from files
    "robot.urdf": IssueCode("the robot file is not a readable URDF", is_input_error=True),
    "robot.chain": IssueCode(
        "the URDF chain from base to tip is missing, or has mimic or prismatic joints", is_input_error=True
    ),
    "robot.limits": IssueCode(
        "a URDF joint has no range or no maximum speed",
        is_input_error=True,
        message="joint {joint!r}: {fault}; {remedy}",
    ),
    "robot.bodies": IssueCode(
        "collision bodies of a robot are missing or enclose no volume", is_input_error=True
    ),
    "robot.unseen": IssueCode(
        "links of a robot have no visual mesh and are shown by their collision bodies", is_input_error=True
    ),
    "robot.not_opw": IssueCode(
        "the kinematic class of the arm is not supported",
        is_input_error=True,
        message="the arm from {first_link!r} on is {arm_class}; allowed are six revolute joints: axis 1 "
        "square to axis 2, 2 parallel to 3, and 3, 4, 5, 6 each square to the previous, with 4 and 5 "
        "through one point (off the plane of axis 1 only if 6 passes through it too), or 2, 3, 4 parallel, "
        "1 through 2, and 5 square to 4 and 6 and through both; or seven, each square to the previous, 1, 2 "
        "and 3 through one point, 5 and 6 through another, and neither this nor axis 7 off the plane of the "
        "arm",
    ),
    "robot.deviation": IssueCode(
        "the closed-form kinematics of an arm deviate from its URDF",
        is_input_error=True,
        message="the arm is close to one with {kinematic_class}: its closed form deviates by up to "
        "{deviation_mm:.3g} mm and {deviation_rad:.3g} rad from the tip of the URDF on {posture_count} "
        "postures; allowed are {max_deviation_mm:g} mm and {max_deviation_rad:g} rad",
    ),
    "problem.unknown_arm": IssueCode(
        "an operation names an arm that is not in the cell", is_input_error=True
    ),
    "problem.unknown_process": IssueCode(
        "an operation names an unknown process",
        is_input_error=True,
        message="operations.{index}.process: got {process!r}, known are {known_processes}; choose one of "
        "them",
    ),
    "problem.process_package": IssueCode(
        "an installed process cannot be loaded, or its name is already taken", is_input_error=True
    ),
    "problem.not_finite": IssueCode("a number is NaN or infinite", is_input_error=True),
    "problem.accepted": IssueCode(
        "the problem accepts an issue that does not occur",
        is_input_error=True,
        message="accept: {accepted_code} does not occur; remove it so that it does not mask a future issue",
    ),
    # blocks that are held, and what is known of them
    "stock.gripper": IssueCode("the arm that should hold the block has no gripper"),
    "stock.foam_missing": IssueCode("the foam of the block is required but not stated"),
    "stock.too_heavy": IssueCode(
        "block and gripper exceed the payload of the arm that holds them",
        message="{field}: the block of {block_kg:.2f} kg and the tool of {tool_kg:.2f} kg are "
        "{total_kg:.2f} kg, {robot} carries {payload_kg:g} kg; use a lighter foam, a smaller block or a "
        "larger arm",
    ),
    "stock.grip_force": IssueCode(
        "the gripper does not hold the block firmly enough",
        message="{field}: {gripper} holds with {holding_force_n:.1f} N, the block of {block_kg:.2f} kg "
        "needs {required_force_n:.1f} N ({force_factor:g} times its weight, because the arm accelerates "
        "it); use a larger gripper, or state its holding_n if it is known",
    ),
    "stock.grip_chosen": IssueCode(
        "the chosen gripper, and where it holds the block",
        message="the block is held by {gripper} of arm {arm} ({choice}), its centre at [{centre_mm}] mm of "
        "the block's bottom face{rotation_clause}",
    ),
    "stock.support": IssueCode(
        "the support does not reach the floor, or the block does not rest on it",
        acceptance="the support does not reach the floor, or the block does not rest on it",
    ),
    "stock.hangs": IssueCode(
        "no support is stated for the block",
        acceptance="no support is stated for the block",
        message="the block is not supported: {reason}; arms may move where its support will be",
    ),
    "stock.footprint": IssueCode("the gripper face lies outside the bottom face of the block or part"),
    # catalogue and cell
    "catalogue.missing_data": IssueCode("a data file of the Tandem installation is missing or unreadable"),
    "cell.body_name": IssueCode(
        "the name of a cell body is reserved or already taken",
        is_input_error=True,
        message="{kind} {name!r}: the name is taken, reserved or contains '/'",
    ),
    # the general door, process: targets
    "targets.file": IssueCode(
        "a targets file is unreadable, or a value in it is missing or out of range",
        is_input_error=True,
        message="{file}{row}: {fault}",
    ),
    "targets.held": IssueCode(
        "given poses are not supported for a block that an arm holds",
        is_input_error=True,
        message="{operation}: arm {arm} holds the block, but supplied poses need a block on a support. "
        "Leave out stock.held_by and state the support (support: pedestal), or after a setup in which an "
        "arm holds it: setup: {{held_by: nobody, place: auto, support: pedestal}}",
    ),
    "targets.freedom": IssueCode(
        "a free axis needs exactly one of rotation and translation", is_input_error=True
    ),
}
