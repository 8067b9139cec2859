"""The setup sheet: what the operator does, mounts, clamps and measures, and how the work goes.

Tables of tools, block and points to measure hold for a whole setup. The part on controllers says
what is loaded and set there before the first run.
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
from planner.report.contribution import (
    Check,
    ControllerSetup,
    ReportOfLanguage,
    Row,
    by_language,
    of_processes,
    powered,
)
from planner.report.markup import Block, Facts, Figure, Phrase, Table
from planner.report.motion_charts import operation_starts
from planner.report.pose_text import point, pose_cells
from planner.tooling import Gripper

_FILL = markup.Blank()
"""Room to tick off or to write in what was measured."""
_POSE_COLUMNS = ("x, y, z [mm]", "roll, pitch, yaw [deg]", "quaternion w, x, y, z")
"""Heads of the columns of a pose."""
_CORNERS = (
    ("bottom corner −x −y", (0, 0, 0)),
    ("bottom corner +x −y", (1, 0, 0)),
    ("bottom corner −x +y", (0, 1, 0)),
    ("top corner −x −y", (0, 0, 1)),
)
"""Corners of the block to be measured: what they are called, and their place along x, y, z."""


def tool_table(setup: Setup, plan: Plan) -> Block:
    """What each arm carries, its TCP on the flange and its base in the world."""
    rows, frames = [], []
    for arm in setup.cell.arms:
        robot = arm.data
        cog = ", ".join(markup.fixed(float(v) / MM, 1) for v in arm.tool.cog)
        rows.append((arm.name, robot.title, robot.controller, arm.tool.name, arm.tool.mass, cog))
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        frames.append((f"{arm.name}: TCP on the flange", *pose_cells(arm.tool.tcp)))
        frames.append((f"{arm.name}: base in the world", *pose_cells(base)))
    heads = ("arm", "robot", "controller", "tool", "mass [kg]", "centre of gravity on the flange [mm]")
    tables = [markup.table(heads, rows), markup.table(("frame", *_POSE_COLUMNS), frames)]
    doubts = [(arm.name, line) for arm in setup.cell.arms for line in arm.data.assumed]
    tables.append(markup.table(("arm", "of the robot: assumed or not confirmed"), doubts))
    return markup.Group(tuple(tables))


def block_table(setup: Setup, plan: Plan, held: HoldsStock | None) -> Facts:
    """Size and place of the block as found, and how an arm holds it."""
    stock = setup.stock
    found = stock.upper - stock.lower
    place, turn, quaternion = pose_cells(np.asarray(plan.places[setup.number - 1]))
    items: list[Row] = [("size x × y × z [mm]", _size(found))]
    if stock.oversize.any():
        items.append(("of it the datum block [mm]", _size(stock.size)))
        sides = "; ".join(
            f"{axis} {markup.fixed(low / MM, 1)} and {markup.fixed(high / MM, 1)}"
            for axis, low, high in zip("xyz", *stock.oversize.tolist(), strict=True)
        )
        items.append(("to be trimmed below and above [mm]", sides))
    items.append(("frame", "centre of the datum block's bottom face, z up through the block"))
    if stock.foam is not None:
        items.append(("foam", f"{stock.foam.title}, {stock.foam.density:g} kg/m³"))
    if stock.mass is not None:
        items.append(("mass", f"{markup.fixed(stock.mass, 3)} kg"))
    if stock.held_by is not None:
        tool = setup.cell.arm(stock.held_by).tool
        at, lean, quaternion_grip = pose_cells(stock.grip)
        items.append(("held by", f"{tool.name} of arm {stock.held_by}, by its bottom face"))
        items += [
            ("grip: the block's frame in the gripper's TCP frame x, y, z [mm]", at),
            ("grip: roll, pitch, yaw [deg]", lean),
            ("grip: quaternion w, x, y, z", quaternion_grip),
        ]
        if isinstance(tool, Gripper):
            width, depth = (markup.fixed(v / MM, 0) for v in tool.footprint)
            items.append(("face of the gripper, centred on its TCP [mm]", f"{width} × {depth}"))
            items += _clamped_by(setup.stock)
        if held is not None:
            load = f"{markup.fixed(held.mass, 3)} kg at {point(held.cog)} mm"
            items.append(("load told to the controller", load))
    name = "place: x, y, z in the world [mm]"
    if stock.held_by is not None:
        name = "place about which it is moved: x, y, z in the world [mm]"
    if stock.held_by is None and stock.sheet is None:
        items.append(("stands on", _stands_on(setup, np.asarray(plan.places[setup.number - 1]))))
        items += _from_bases(setup, plan)
    chosen = "the problem" if stock.place is not None else "the placement search"
    table = setup.cell.turntable
    if table is not None and stock.station is not None:
        zero = table.placed(np.asarray(plan.places[setup.number - 1]), {}, stock.stands)
        at, lean, _ = pose_cells(zero)
        items.append((f"clamped so that it is, with {table.unit} at 0 deg, at x, y, z [mm]", at))
        items.append((f"and its roll, pitch, yaw with {table.unit} at 0 deg [deg]", lean))
        if stock.tilt is not None:
            leans = f"it is tilted by {stock.tilt / DEG:g} deg here, and leans as it goes there and home"
            items.append(("bolted or clamped to the plate", leans))
        name = f"place once {table.unit} is at {_stand(table, stock)}: x, y, z in the world [mm]"
    items += [
        (name, place),
        ("place: roll, pitch, yaw [deg]", turn),
        ("place: quaternion w, x, y, z", quaternion),
        ("place chosen by", chosen),
    ]
    return Facts(tuple(items))


def _stand(table: Turntable, stock: Stock) -> str:
    """The values of the axes under a block, in words."""
    words = (f"{axis.word} {stock.stands[name] / DEG:g}".strip() for name, axis in table.axes.items())
    return f"{', '.join(words)} deg"


def _stands_on(setup: Setup, place: FloatArray) -> str:
    """What the block stands on, where a positioner's tilt is at 0."""
    table, up = setup.cell.turntable, setup.upright
    if table is not None and setup.stock.stands:
        place = table.placed(place, up.stock.stands, setup.stock.stands)
    return support.support_note(up.cell, setup.stock, place)


def _from_bases(setup: Setup, plan: Plan) -> list[Row]:
    """Where the block is from the base of each arm: one bottom corner, its edges, its underside."""
    stock, place = setup.stock, np.asarray(plan.places[setup.number - 1])
    out: list[Row] = []
    for arm in setup.cell.arms:
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        seen = np.linalg.inv(base) @ place
        corner = (seen @ np.append(stock.lower, 1.0))[:3]
        along = seen[:2, 0] if np.linalg.norm(seen[:2, 0]) > 0.5 else seen[:2, 1]
        turn = float(np.arctan2(along[1], along[0])) / DEG
        off = abs((turn + 45.0) % 90.0 - 45.0)
        edges = "parallel to the base" if off < 0.005 else f"turned by {markup.fixed(turn, 2)} deg"
        out.append((f"from the base of {arm.name}: corner −x −y −z [mm]", f"{point(corner)}; edges {edges}"))
    return out


def _clamped_by(stock: Stock) -> list[Row]:
    """Where the middle of a gripper is, from two edges of the block's bottom face."""
    middle = np.linalg.inv(stock.grip)
    across = middle[:2, 3] - stock.lower[:2]
    turn = float(np.arctan2(middle[1, 0], middle[0, 0])) / DEG
    turned = "its sides along the block's" if abs(turn) < 1e-6 else f"turned by {markup.fixed(turn, 1)} deg"
    x, y = (markup.fixed(float(v) / MM, 1) for v in across)
    edges = f"{x} mm from edge −x, {y} mm from edge −y"
    by = "Tandem" if stock.grip_chosen else "the problem"
    return [
        ("middle of the gripper on the block's bottom face", f"{edges}; {turned}"),
        ("grip chosen by", by),
    ]


def measured_points(setup: Setup, plan: Plan, operation: int) -> Table:
    """TCPs at the first target of an operation and corners of the block, with room for what was measured."""
    rows: list[tuple[Phrase, ...]] = []
    made = plan.operations[operation]
    for arm in setup.cell.arms:
        if arm.name not in made.q:
            continue
        q = made.q[arm.name][0]
        counted = made.commanded.get(arm.name, made.q[arm.name])[0]
        angles = ", ".join(markup.fixed(float(v) / DEG, 3) for v in arm.data.to_controller(counted))
        place, turn, _ = pose_cells(scene.flange_poses(arm, plan.bases, q) @ arm.tool.tcp)
        rows.append((f"{arm.name}: TCP at {made.targets.name(0)}, world", place, turn, angles, _FILL))
    stock = setup.stock
    ends = np.array([stock.lower, stock.upper])
    held = stock.held_by is not None
    frame = stock.grip if held else np.asarray(plan.places[setup.number - 1])
    where = f"TCP frame of {stock.held_by}" if held else "world"
    if setup.cell.turntable is not None and stock.station is not None:
        where = f"world, {setup.cell.turntable.unit} at {_stand(setup.cell.turntable, stock)}"
    for label, (i, j, k) in _CORNERS:
        corner = np.array([ends[i, 0], ends[j, 1], ends[k, 2], 1.0])
        rows.append((f"block, {label}, {where}", point((frame @ corner)[:3]), "", "", _FILL))
    heads = ("what", *_POSE_COLUMNS[:2], "axes on the controller [deg]", "measured")
    return markup.table(heads, rows)


def _size(size: FloatArray) -> str:
    return " × ".join(markup.fixed(float(v) / MM, 1) for v in size)


_CHECK_COLUMNS = ("controller", "what", "to be so", "done")
"""Heads of the table of what is checked at controllers."""


def controller_checks(problem: Problem, plan: Plan) -> Table:
    """A table to tick off, for each controller of the arms that take part."""
    used = {name for operation in plan.operations for name in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    alone = problem.cell.controller.sync == "handshake"
    joined = alone and len(arms) > 1
    controllers = [
        (language, own)
        for language, together in by_language(arms)
        for own in ([(arm,) for arm in together] if alone else [together])
    ]
    controllers.sort(key=lambda one: arms.index(one[1][0]))
    rows = [
        row
        for language, own in controllers
        for row in _checked(own, language.checks(ControllerSetup(problem, plan, own, joined)))
    ]
    if alone and not joined:
        rest = ", ".join(arm.name for arm in problem.cell.arms if arm.name not in used)
        what = "stands at home, its program stopped: nothing in this job looks at it"
        rows += [row for arm in arms if rest for row in _checked([arm], [(f"{rest} meanwhile", what)])]
    if joined:
        rows += _checked(arms, _wire_checks(problem, plan, arms))
    for language, own in controllers:
        rows += [row for arm in own for row in _checked([arm], _sag(arm, language))]
    return markup.table(_CHECK_COLUMNS, rows)


def _checked(arms: Sequence[Arm], checks: Sequence[Check]) -> list[tuple[Phrase, ...]]:
    """Rows of the table for the controllers of arms."""
    names = ", ".join(arm.name for arm in arms)
    return [(names, what, how, _FILL) for what, how in checks]


def _sag(arm: Arm, language: ReportOfLanguage) -> list[Check]:
    """What makes up for the arm's sag, which must be done once, and by what figures."""
    if arm.sag is None or arm.stiffness is None:
        return []
    own = language.load_compensation
    off = f"off ({own}): the program makes up for the load's sag itself"
    on = f"on ({own}): the program makes up for the work's force alone"
    joints = ", ".join(f"{value:.3g}" for value in arm.stiffness.joints)
    return [
        ("the controller's own compensation of load", off if arm.sag.load else on),
        ("stiffness of the joints [N m/rad], as stated", f"{joints} ({arm.stiffness.source})"),
    ]


def _wire_checks(problem: Problem, plan: Plan, arms: Sequence[Arm]) -> list[Check]:
    """Each wire between two controllers, and how it is tried."""
    names = [arm.name for arm in arms]
    handshake = problem.cell.controller.handshake
    out = [(f"wire: {_wire(wire)}", "0 and 1 are read at its end") for wire in handshake.wired(names)]
    for wire in handshake.wired_running(names):
        falls = " and its power falls" if powered(problem, plan, [problem.cell.arm(wire.sink)]) else ""
        what = (
            f"pulled while both programs run: arm {wire.sink} stops at once{falls}, then arm {wire.source} "
        )
        out.append((f"running wire: {_wire(wire)}", f"{what}stops, too"))
    return out


def _wire(wire: SignalWire) -> str:
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


def sheet(problem: Problem, plan: Plan, proof: Proof | None = None) -> markup.Group:
    """All of the setup sheet for a plan, a part for each setup."""
    starts = operation_starts(plan)
    parts: list[Block] = []
    for setup in problem.setups:
        made = [i for i in setup.operations if i < len(plan.operations)]
        if not made:
            continue
        if len(problem.setups) > 1:
            names = ", ".join(plan.operations[i].name for i in made)
            parts.append(markup.Heading(f"Setup {setup.number}: {names}"))
        if setup.steps:
            parts.append(Figure("To do, with all arms at home", _steps(setup)))
        parts.append(Figure("Robots and tools", tool_table(setup, plan)))
        parts.append(Figure("Block", block_table(setup, plan, _holds(setup, plan))))
        for index in made:
            operation = plan.operations[index]
            title = f"Operation {operation.name}" if len(plan.operations) > 1 else "Work"
            parts.append(Figure(title, _work(problem, setup, plan, operation, proof)))
            parts.append(Figure("Stops with something to do", _stops(operation, starts[index])))
        if setup.number == 1:
            parts.append(Figure("Controllers, before the first run", controller_checks(problem, plan)))
        parts.append(Figure("Measure before the first run", measured_points(setup, plan, made[0])))
    return markup.Group(tuple(parts), apart=True)


def _steps(setup: Setup) -> Block:
    """What the operator does, and what the program then asks."""
    asked = markup.Joined(("The program asks: ", markup.Bold(setup.confirmation)))
    return markup.Group((markup.Steps(tuple(setup.steps)), markup.Paragraph(asked)))


def _holds(setup: Setup, plan: Plan) -> HoldsStock | None:
    """What the controller is told of a held block."""
    for index in setup.operations:
        for claim in plan.operations[index].targets.claims if index < len(plan.operations) else ():
            if isinstance(claim, HoldsStock):
                return claim
    return None


def _work(problem: Problem, setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None) -> Facts:
    targets = operation.targets
    items: list[Row] = []
    for process in of_processes(problem):
        items += process.setup_rows(setup, plan, operation, proof)
    items += exhibits.setup_items(targets.exhibits)
    signals = dict.fromkeys(a.signal for a in targets.actions if a.signal)
    items += [("signals", _listed([markup.Code(signal) for signal in signals]))] if signals else []
    waits = sum(a.seconds for a in targets.actions)
    items += [("waits in all", f"{markup.fixed(waits, 1)} s")] if waits else []
    for language, arms in by_language(problem.cell.arms):
        items += language.programs(problem, arms)
    return Facts((*items, *_wires(problem)))


def _listed(phrases: Sequence[Phrase]) -> Phrase:
    return markup.Joined(tuple(part for one in phrases for part in (", ", one))[1:])


def _wires(problem: Problem) -> list[Row]:
    """The wires between two controllers that meet by handshake."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return []
    arms = [arm.name for arm in problem.cell.arms]
    wires = (*controller.handshake.wired(arms), *controller.handshake.wired_running(arms))
    return [("wires between the controllers", ", ".join(map(_wire, wires)))]


def _stops(operation: OperationPlan, start: float) -> Block:
    rows: list[tuple[Phrase, ...]] = []
    for action in operation.targets.actions:
        what = action.text or action.signal or (f"{action.seconds:g} s" if action.kind == "wait" else "")
        time = markup.fixed(float(operation.time[action.at]) + start, 1)
        rows.append((time, operation.targets.name(action.at), _STOP_WORDS[action.kind], what))
    if not rows:
        return markup.Paragraph("none")
    return markup.table(("motion time [s]", "at target", "", "what"), rows)
