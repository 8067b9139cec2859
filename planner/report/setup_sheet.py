"""The setup sheet: what the operator does, mounts, clamps and measures, and the sequence of the work.

Tables of tools, block and points to measure apply to a whole setup. The part on controllers states what is
loaded and set there before the first run.
"""

from collections.abc import Sequence

import numpy as np

from planner.cell import support
from planner.claims.claim import HoldsStock
from planner.claims.handshake import SignalWire
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Setup, Stock, Turntable
from planner.proof.verdict import Proof
from planner.report import exhibits, markup, scene
from planner.report.markup import Block, FactsBlock, FigureBlock, Phrase, TableBlock
from planner.report.motion_charts import operation_starts
from planner.report.plugin_contributions import (
    ControllerCheck,
    ControllerSetup,
    ReportOfLanguage,
    SetupRow,
    power_signals,
    process_reports,
    reports_by_language,
)
from planner.report.pose_text import point_text, pose_cells
from planner.tooling import Gripper

_FILL_IN = markup.FillInBlank()
"""Space to tick off or to write a measured value."""
_POSE_COLUMNS = ("x, y, z [mm]", "roll, pitch, yaw [deg]", "quaternion w, x, y, z")
"""Column headings of a pose."""
_CORNERS = (
    ("bottom corner −x −y", (0, 0, 0)),
    ("bottom corner +x −y", (1, 0, 0)),
    ("bottom corner −x +y", (0, 1, 0)),
    ("top corner −x −y", (0, 0, 1)),
)
"""Corners of the block to measure: name, and 0 or 1 for the lower or upper end along x, y and z."""


def tool_table(setup: Setup, plan: Plan) -> Block:
    """Return three tables: tools, frames, and robot data that are assumed or not confirmed.

    The frames of each arm are its TCP in the flange frame and its base in the world.
    """
    rows, frames = [], []
    for arm in setup.cell.arms:
        robot = arm.data
        cog = ", ".join(markup.fixed_decimals(float(v) / MM, 1) for v in arm.tool.cog)
        rows.append((arm.name, robot.title, robot.controller, arm.tool.name, arm.tool.mass, cog))
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        frames.append((f"{arm.name}: TCP on the flange", *pose_cells(arm.tool.tcp)))
        frames.append((f"{arm.name}: base in the world", *pose_cells(base)))
    headings = ("arm", "robot", "controller", "tool", "mass [kg]", "centre of gravity on the flange [mm]")
    tables = [markup.make_table(headings, rows), markup.make_table(("frame", *_POSE_COLUMNS), frames)]
    assumptions = [(arm.name, line) for arm in setup.cell.arms for line in arm.data.assumed]
    tables.append(markup.make_table(("arm", "robot data: assumed or not confirmed"), assumptions))
    return markup.BlockGroup(tuple(tables))


def block_table(setup: Setup, plan: Plan, held: HoldsStock | None) -> FactsBlock:
    """Tabulate size and pose of the block at the start of a setup, and its support or the arm that holds it.

    Args:
        setup: Setup.
        plan: Plan.
        held: Claim with the load of a block that an arm holds, or None.
    """
    stock = setup.stock
    size = stock.upper - stock.lower
    position, stock_rotation, quaternion = pose_cells(np.asarray(plan.stock_poses[setup.number - 1]))
    items: list[SetupRow] = [("size x × y × z [mm]", _size(size))]
    if stock.oversize.any():
        items.append(("datum block in it [mm]", _size(stock.size)))
        sides = "; ".join(
            f"{axis} {markup.fixed_decimals(low / MM, 1)} and {markup.fixed_decimals(high / MM, 1)}"
            for axis, low, high in zip("xyz", *stock.oversize.tolist(), strict=True)
        )
        items.append(("to be trimmed below and above [mm]", sides))
    items.append(("frame", "centre of the datum block's bottom face, z up through the block"))
    if stock.foam is not None:
        items.append(("foam", f"{stock.foam.title}, {stock.foam.density:g} kg/m³"))
    if stock.mass is not None:
        items.append(("mass", f"{markup.fixed_decimals(stock.mass, 3)} kg"))
    if stock.held_by is not None:
        tool = setup.cell.arm(stock.held_by).tool
        at, rotation, quaternion_grip = pose_cells(stock.grip)
        items.append(("held by", f"{tool.name} of arm {stock.held_by}, by its bottom face"))
        items += [
            ("grip: the block's frame in the gripper's TCP frame x, y, z [mm]", at),
            ("grip: roll, pitch, yaw [deg]", rotation),
            ("grip: quaternion w, x, y, z", quaternion_grip),
        ]
        if isinstance(tool, Gripper):
            width, depth = (markup.fixed_decimals(v / MM, 0) for v in tool.footprint)
            items.append(("face of the gripper, centred on its TCP [mm]", f"{width} × {depth}"))
            items += _grip_rows(setup.stock)
        if held is not None:
            load = f"{markup.fixed_decimals(held.mass, 3)} kg at {point_text(held.cog)} mm"
            items.append(("load stated to the controller", load))
    name = "place: x, y, z in the world [mm]"
    if stock.held_by is not None:
        name = "place around which it is moved: x, y, z in the world [mm]"
    if stock.held_by is None and stock.sheet is None:
        items.append(("stands on", _support_text(setup, np.asarray(plan.stock_poses[setup.number - 1]))))
        items += _relative_to_bases(setup, plan)
    chosen = "the problem" if stock.place is not None else "the placement search"
    table = setup.cell.turntable
    if table is not None and stock.station is not None:
        pose_at_zero = table.move_pose(np.asarray(plan.stock_poses[setup.number - 1]), {}, stock.axis_values)
        at, rotation, _ = pose_cells(pose_at_zero)
        items.append((f"clamp it with {table.unit} at 0 deg so that it is at x, y, z [mm]", at))
        items.append((f"roll, pitch, yaw with {table.unit} at 0 deg [deg]", rotation))
        if stock.tilt is not None:
            tilt_text = (
                f"it is tilted by {stock.tilt / DEG:g} deg here, and tilts while it moves there and home"
            )
            items.append(("bolt or clamp it to the plate", tilt_text))
        name = f"place with {table.unit} at {_axis_values_text(table, stock)}: x, y, z in the world [mm]"
    items += [
        (name, position),
        ("place: roll, pitch, yaw [deg]", stock_rotation),
        ("place: quaternion w, x, y, z", quaternion),
        ("place chosen by", chosen),
    ]
    return FactsBlock(tuple(items))


def _axis_values_text(table: Turntable, stock: Stock) -> str:
    """Return the values of the axes under a block in its setup, as text in degrees."""
    values = (
        f"{axis.axis_name} {stock.axis_values[name] / DEG:g}".strip() for name, axis in table.axes.items()
    )
    return f"{', '.join(values)} deg"


def _support_text(setup: Setup, stock_pose: FloatArray) -> str:
    """Return what supports a block with this pose in its setup, with a positioner's tilt at 0, as text."""
    table = setup.cell.turntable
    upright = setup.with_zero_tilt
    if table is not None and setup.stock.axis_values:
        stock_pose = table.move_pose(stock_pose, upright.stock.axis_values, setup.stock.axis_values)
    return support.support_note(upright.cell, setup.stock, stock_pose)


def _relative_to_bases(setup: Setup, plan: Plan) -> list[SetupRow]:
    """Return where the block is in the frame of each base: a bottom corner, and the angle of its edges."""
    stock, stock_pose = setup.stock, np.asarray(plan.stock_poses[setup.number - 1])
    out: list[SetupRow] = []
    for arm in setup.cell.arms:
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        in_base = np.linalg.inv(base) @ stock_pose
        corner = (in_base @ np.append(stock.lower, 1.0))[:3]
        # x axis of the block in plan, or its y axis if the block is tilted so that x is nearly vertical
        along = in_base[:2, 0] if np.linalg.norm(in_base[:2, 0]) > 0.5 else in_base[:2, 1]
        angle = float(np.arctan2(along[1], along[0])) / DEG
        # deviation from the nearest multiple of 90 deg
        deviation = abs((angle + 45.0) % 90.0 - 45.0)
        edges = (
            "parallel to the base"
            if deviation < 0.005
            else f"rotated by {markup.fixed_decimals(angle, 2)} deg"
        )
        out.append(
            (f"from the base of {arm.name}: corner −x −y −z [mm]", f"{point_text(corner)}; edges {edges}")
        )
    return out


def _grip_rows(stock: Stock) -> list[SetupRow]:
    """Return the distances of a gripper's middle from two edges of the block's bottom face, and its angle."""
    tcp_in_stock = np.linalg.inv(stock.grip)
    from_edges = tcp_in_stock[:2, 3] - stock.lower[:2]
    angle = float(np.arctan2(tcp_in_stock[1, 0], tcp_in_stock[0, 0])) / DEG
    rotation_text = (
        "parallel to the block" if abs(angle) < 1e-6 else f"rotated by {markup.fixed_decimals(angle, 1)} deg"
    )
    x, y = (markup.fixed_decimals(float(v) / MM, 1) for v in from_edges)
    edges = f"{x} mm from edge −x, {y} mm from edge −y"
    chooser = "Tandem" if stock.grip_chosen else "the problem"
    return [
        ("middle of the gripper on the block's bottom face", f"{edges}; {rotation_text}"),
        ("grip chosen by", chooser),
    ]


def measured_points(setup: Setup, plan: Plan, operation: int) -> TableBlock:
    """Tabulate points to measure before the first run, with space to fill in the measured values.

    These are the TCP of each arm at the first target of an operation, and corners of the block.

    Args:
        setup: Setup.
        plan: Plan.
        operation: Index of the operation, whose arms are measured.
    """
    rows: list[tuple[Phrase, ...]] = []
    operation_plan = plan.operations[operation]
    for arm in setup.cell.arms:
        if arm.name not in operation_plan.q:
            continue
        q = operation_plan.q[arm.name][0]
        joints = operation_plan.commanded.get(arm.name, operation_plan.q[arm.name])[0]
        angles = ", ".join(markup.fixed_decimals(float(v) / DEG, 3) for v in arm.data.to_controller(joints))
        position, rpy, _ = pose_cells(scene.flange_poses(arm, plan.bases, q) @ arm.tool.tcp)
        rows.append(
            (f"{arm.name}: TCP at {operation_plan.targets.name(0)}, world", position, rpy, angles, _FILL_IN)
        )
    stock = setup.stock
    ends = np.array([stock.lower, stock.upper])
    held = stock.held_by is not None
    frame = stock.grip if held else np.asarray(plan.stock_poses[setup.number - 1])
    frame_name = f"TCP frame of {stock.held_by}" if held else "world"
    if setup.cell.turntable is not None and stock.station is not None:
        frame_name = f"world, {setup.cell.turntable.unit} at {_axis_values_text(setup.cell.turntable, stock)}"
    for label, (i, j, k) in _CORNERS:
        corner = np.array([ends[i, 0], ends[j, 1], ends[k, 2], 1.0])
        rows.append((f"block, {label}, {frame_name}", point_text((frame @ corner)[:3]), "", "", _FILL_IN))
    headings = ("what", *_POSE_COLUMNS[:2], "axes on the controller [deg]", "measured")
    return markup.make_table(headings, rows)


def _size(size: FloatArray) -> str:
    """Format the edges (3,) [m] of a block in millimetres."""
    return " × ".join(markup.fixed_decimals(float(v) / MM, 1) for v in size)


_CHECK_COLUMNS = ("controller", "what", "required", "done")
"""Column headings of the table of checks at controllers."""


def controller_checks(problem: Problem, plan: Plan) -> TableBlock:
    """Return the table of checks to tick off before the first run, for the controllers of all used arms.

    Arms of one language share a controller. With synchronisation by handshake each arm has its own.
    """
    used = {name for operation in plan.operations for name in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    separate = problem.cell.controller.sync == "handshake"
    joined = separate and len(arms) > 1
    controllers = [
        (language, group)
        for language, language_arms in reports_by_language(arms)
        for group in ([(arm,) for arm in language_arms] if separate else [language_arms])
    ]
    controllers.sort(key=lambda controller: arms.index(controller[1][0]))
    rows = [
        row
        for language, group in controllers
        for row in _check_rows(group, language.checks(ControllerSetup(problem, plan, group, joined)))
    ]
    if separate and not joined:
        idle = ", ".join(arm.name for arm in problem.cell.arms if arm.name not in used)
        requirement = "is at home with its program stopped: this job does not monitor it"
        rows += [
            row for arm in arms if idle for row in _check_rows([arm], [(f"{idle} meanwhile", requirement)])
        ]
    if joined:
        rows += _check_rows(arms, _wire_checks(problem, plan, arms))
    for language, group in controllers:
        rows += [row for arm in group for row in _check_rows([arm], _sag_checks(arm, language))]
    return markup.make_table(_CHECK_COLUMNS, rows)


def _check_rows(arms: Sequence[Arm], checks: Sequence[ControllerCheck]) -> list[tuple[Phrase, ...]]:
    """Return rows of the table: controllers of the arms, what to check, required state, and a blank."""
    names = ", ".join(arm.name for arm in arms)
    return [(names, what, required, _FILL_IN) for what, required in checks]


def _sag_checks(arm: Arm, language: ReportOfLanguage) -> list[ControllerCheck]:
    """Return the checks for an arm whose program compensates sag, or none for other arms.

    The load compensation of the controller has to be off if the program compensates the sag from the load, so
    that it is not compensated twice. The second check states the stiffness of the joints.
    """
    if arm.sag is None or arm.stiffness is None:
        return []
    compensation_name = language.load_compensation
    off_text = f"off ({compensation_name}): the program compensates the sag from the load"
    on_text = f"on ({compensation_name}): the program compensates only the process force"
    joints = ", ".join(f"{value:.3g}" for value in arm.stiffness.joints)
    return [
        ("load compensation of the controller", off_text if arm.sag.load else on_text),
        ("stiffness of the joints [N m/rad], as stated", f"{joints} ({arm.stiffness.source})"),
    ]


def _wire_checks(problem: Problem, plan: Plan, arms: Sequence[Arm]) -> list[ControllerCheck]:
    """Return a check for each signal wire between two controllers, with the way to test it."""
    names = [arm.name for arm in arms]
    handshake = problem.cell.controller.handshake
    out = [
        (f"wire: {_wire_text(wire)}", "0 and 1 are read at its input")
        for wire in handshake.meeting_wires(names)
    ]
    for wire in handshake.running_wires(names):
        has_power = power_signals(problem, plan, [problem.cell.arm(wire.sink)])
        power_text = " and its power switches off" if has_power else ""
        test = f"unplug while both programs run: arm {wire.sink} stops at once{power_text}, "
        test += f"then arm {wire.source} stops too"
        out.append((f"running wire: {_wire_text(wire)}", test))
    return out


def _wire_text(wire: SignalWire) -> str:
    return f"{wire.output} of {wire.source} to {wire.input} of {wire.sink}"


_STOP_WORDS = {
    "confirm": "the program waits for the operator",
    "message": "message",
    "on": "signal on",
    "off": "signal off",
    "wait": "wait",
    "input": "wait for the input",
}
"""What a program does at a stop, by kind of action."""


def build_sheet(problem: Problem, plan: Plan, proof: Proof | None = None) -> markup.BlockGroup:
    """Return the whole setup sheet of a plan, with a part for each setup that has a planned operation.

    Args:
        problem: Problem.
        plan: Plan.
        proof: Proof, or None.
    """
    starts = operation_starts(plan)
    parts: list[Block] = []
    for setup in problem.setups:
        operations = [i for i in setup.operations if i < len(plan.operations)]
        if not operations:
            continue
        if len(problem.setups) > 1:
            names = ", ".join(plan.operations[i].name for i in operations)
            parts.append(markup.Heading(f"Setup {setup.number}: {names}"))
        if setup.steps:
            parts.append(FigureBlock("To do, with all arms at home", _steps(setup)))
        parts.append(FigureBlock("Robots and tools", tool_table(setup, plan)))
        parts.append(FigureBlock("Block", block_table(setup, plan, _held_stock_claim(setup, plan))))
        for index in operations:
            operation = plan.operations[index]
            title = f"Operation {operation.name}" if len(plan.operations) > 1 else "Work"
            parts.append(FigureBlock(title, _work_facts(problem, setup, plan, operation, proof)))
            parts.append(FigureBlock("Stops and actions", _stop_table(operation, starts[index])))
        if setup.number == 1:
            parts.append(FigureBlock("Controllers, before the first run", controller_checks(problem, plan)))
        parts.append(FigureBlock("Measure before the first run", measured_points(setup, plan, operations[0])))
    return markup.BlockGroup(tuple(parts), spaced=True)


def _steps(setup: Setup) -> Block:
    """Return the operator's steps at the start of a setup, and the question that the program then asks."""
    question = markup.JoinedPhrases(("The program asks: ", markup.Bold(setup.confirmation)))
    return markup.BlockGroup((markup.StepsBlock(tuple(setup.steps)), markup.Paragraph(question)))


def _held_stock_claim(setup: Setup, plan: Plan) -> HoldsStock | None:
    """Return the first claim in a setup with the load of a block that an arm holds, or None."""
    for index in setup.operations:
        # a plan that failed has fewer operations than the problem
        for claim in plan.operations[index].targets.claims if index < len(plan.operations) else ():
            if isinstance(claim, HoldsStock):
                return claim
    return None


def _work_facts(
    problem: Problem, setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None
) -> FactsBlock:
    """Return the facts about an operation for the setup sheet.

    They come from processes and exhibits. Signals, the total waiting time, programs and wires are added.
    """
    targets = operation.targets
    items: list[SetupRow] = []
    for process in process_reports(problem):
        items += process.setup_rows(setup, plan, operation, proof)
    items += exhibits.setup_items(targets.exhibits)
    signals = dict.fromkeys(action.signal for action in targets.actions if action.signal)
    if signals:
        items.append(("signals", _comma_separated([markup.CodePhrase(signal) for signal in signals])))
    waiting_time = sum(action.seconds for action in targets.actions)
    if waiting_time:
        items.append(("total waiting time", f"{markup.fixed_decimals(waiting_time, 1)} s"))
    for language, arms in reports_by_language(problem.cell.arms):
        items += language.programs(problem, arms)
    return FactsBlock((*items, *_wire_rows(problem)))


def _comma_separated(phrases: Sequence[Phrase]) -> Phrase:
    """Join phrases with commas between them."""
    return markup.JoinedPhrases(tuple(part for phrase in phrases for part in (", ", phrase))[1:])


def _wire_rows(problem: Problem) -> list[SetupRow]:
    """Return the wires between two controllers that are synchronised by handshake."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return []
    arms = [arm.name for arm in problem.cell.arms]
    wires = (*controller.handshake.meeting_wires(arms), *controller.handshake.running_wires(arms))
    return [("wires between the controllers", ", ".join(map(_wire_text, wires)))]


def _stop_table(operation: OperationPlan, start: float) -> Block:
    """Tabulate the actions of an operation, whose clock starts at ``start`` [s] of the motion time."""
    rows: list[tuple[Phrase, ...]] = []
    for action in operation.targets.actions:
        detail = action.text or action.signal or (f"{action.seconds:g} s" if action.kind == "wait" else "")
        time = markup.fixed_decimals(float(operation.time[action.target]) + start, 1)
        rows.append((time, operation.targets.name(action.target), _STOP_WORDS[action.kind], detail))
    if not rows:
        return markup.Paragraph("none")
    return markup.make_table(("motion time [s]", "at target", "", "what"), rows)
