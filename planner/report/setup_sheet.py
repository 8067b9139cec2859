"""The setup sheet: what the operator does, mounts, clamps and measures, and how the work goes.

Tables of tools, block and points to measure hold for a whole setup. The part on controllers says
what is loaded and set there before the first run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.cell import support
from planner.claims.claim import HoldsStock
from planner.geometry.arrays import FloatArray
from planner.geometry.units import DEG, MM
from planner.plans import OperationPlan, Plan
from planner.problem import (
    Arm,
    Controller,
    Problem,
    Setup,
    Stock,
    Turntable,
    torch_signals,
)
from planner.processes.forming.claims import SinksHolder
from planner.processes.hotwire.claims import StraightWire, WireJoins
from planner.processes.hotwire.exhibits import (
    bent_wire_rows,
    cutting_rows,
    mounting_rows,
    straight_wire_rows,
)
from planner.proof.verdict import Proof
from planner.report import axes_sheet, exhibits, markup, scene
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
    items: list[tuple[object, object]] = [("size x × y × z [mm]", _size(found))]
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
            items.append(
                (
                    "load told to the controller",
                    f"{markup.fixed(held.mass, 3)} kg at {point(held.cog)} mm",
                )
            )
    name = "place: x, y, z in the world [mm]"
    if stock.held_by is not None:
        name = "place about which it is moved: x, y, z in the world [mm]"
    if stock.held_by is None and stock.sheet is None:
        items.append(
            (
                "stands on",
                _stands_on(setup, np.asarray(plan.places[setup.number - 1])),
            )
        )
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


def _from_bases(setup: Setup, plan: Plan) -> list[tuple[object, object]]:
    """Where the block is from the base of each arm: one bottom corner, its edges, its underside."""
    stock, place = setup.stock, np.asarray(plan.places[setup.number - 1])
    out: list[tuple[object, object]] = []
    for arm in setup.cell.arms:
        base = np.asarray(plan.bases.get(arm.name, arm.base))
        seen = np.linalg.inv(base) @ place
        corner = (seen @ np.append(stock.lower, 1.0))[:3]
        along = seen[:2, 0] if np.linalg.norm(seen[:2, 0]) > 0.5 else seen[:2, 1]
        turn = float(np.arctan2(along[1], along[0])) / DEG
        off = abs((turn + 45.0) % 90.0 - 45.0)
        edges = (
            "edges parallel to the base" if off < 0.005 else f"edges turned by {markup.fixed(turn, 2)} deg"
        )
        out.append((f"from the base of {arm.name}: corner −x −y −z [mm]", f"{point(corner)}; {edges}"))
    return out


def _clamped_by(stock: Stock) -> list[tuple[object, object]]:
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
    controller = problem.cell.controller
    used = {name for operation in plan.operations for name in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    alone = controller.sync == "handshake"
    joined = alone and len(arms) > 1
    rows: list[tuple[Phrase, ...]] = []
    seen = False
    driven = [arm for arm in arms if arm.data.family == "ROS"]
    if driven:
        both = ", ".join(arm.name for arm in driven)
        rows += [(both, what, wanted, _FILL) for what, wanted in _driven(problem, plan, driven)]
    for arm in arms:
        if arm in driven:
            continue
        if arm.data.family == "KUKA":
            rows += [
                (arm.name, what, wanted, _FILL) for what, wanted in _kuka(problem, plan, arm.name, joined)
            ]
        elif arm.data.family == "UR":
            rows += [(arm.name, what, wanted, _FILL) for what, wanted in _ur(problem, plan, arm.name, joined)]
        elif alone or not seen:
            seen = True
            name = arm.name if alone else ", ".join(a.name for a in arms)
            rows += [
                (name, what, wanted, _FILL)
                for what, wanted in _abb(problem, plan, arm.name if alone else "", joined)
            ]
    if alone and not joined:
        rest = ", ".join(arm.name for arm in problem.cell.arms if arm.name not in used)
        what = "stands at home, its program stopped: nothing in this job looks at it"
        rows += [(arm.name, f"{rest} meanwhile", what, _FILL) for arm in arms if rest]
    if joined:
        both = ", ".join(arm.name for arm in arms)
        rows += [(both, what, wanted, _FILL) for what, wanted in _wire_checks(problem, plan, arms)]
    rows += [(arm.name, what, wanted, _FILL) for arm in arms for what, wanted in _sag(arm)]
    return markup.table(_CHECK_COLUMNS, rows)


_OWN_COMPENSATION = {"KUKA": "model of a positionally accurate robot", "UR": "kinematic calibration"}
"""What the controllers of a family have to make up for the load by themselves."""


def _sag(arm: Arm) -> list[tuple[str, str]]:
    """What makes up for the arm's sag, which must be done once, and by what figures."""
    if arm.sag is None or arm.stiffness is None:
        return []
    own = _OWN_COMPENSATION.get(arm.data.family, "Absolute Accuracy")
    off = f"off ({own}): the program makes up for the load's sag itself"
    on = f"on ({own}): the program makes up for the work's force alone"
    joints = ", ".join(f"{value:.3g}" for value in arm.stiffness.joints)
    return [
        ("the controller's own compensation of load", off if arm.sag.load else on),
        ("stiffness of the joints [N m/rad], as stated", f"{joints} ({arm.stiffness.source})"),
    ]


def _wire_checks(problem: Problem, plan: Plan, arms: Sequence[Arm]) -> list[tuple[str, str]]:
    """Each wire between two controllers, and how it is tried."""
    names = [arm.name for arm in arms]
    handshake = problem.cell.controller.handshake
    out = [
        (
            f"wire: {wire.output} of {wire.source} to {wire.input} of {wire.sink}",
            "0 and 1 are read at its end",
        )
        for wire in handshake.wired(names)
    ]
    for wire in handshake.wired_running(names):
        falls = " and its power falls" if _powered(problem, plan, wire.sink) else ""
        out.append(
            (
                f"running wire: {wire.output} of {wire.source} to {wire.input} of {wire.sink}",
                f"pulled while both programs run: arm {wire.sink} stops at once{falls}, "
                f"then arm {wire.source} stops, too",
            )
        )
    return out


def _wired(problem: Problem, arm: str) -> list[tuple[str, str]]:
    """The places of the running wires' ends at an ABB controller."""
    own, lock = problem.cell.controller.handshake.of(arm), problem.cell.controller.interlock
    places = [(name, lock.place(arm, name)) for name in (own.running, own.partner_running)]
    return [
        (f"{name} is wired", f"{at.device}, bit {at.bit}" if at else "NO DEVICE stated, so the wire is dead")
        for name, at in places
    ]


def _ur(problem: Problem, plan: Plan, arm: str, joined: bool) -> list[tuple[str, str]]:
    controller, out = problem.cell.controller, list[tuple[str, str]]()
    own = controller.handshake.of(arm)
    for signal in _powered(problem, plan, arm):
        name = _ur_signal(controller.number(arm, signal), "output")
        out.append((f"{signal} is {name}, in Installation, I/O", "low when the program does not run"))
        out.append(("the power falls at a safety stop and with the drives", f"wired so, behind {name}"))
        if joined:
            wire = f"the wire that ends at {own.partner_running}"
            out.append((f"the power of {signal} falls with {wire}", "a relay in series, beside the program"))
    if joined:
        out += _ur_joined(controller, arm)
    lit = torch_signals(problem.operations) & set(_powered(problem, plan, arm))
    out += [row for signal in sorted(lit) for row in _ur_torch(signal)]
    out += [
        ("pose of the flange at home in Base, at the panel", "as the program's get_forward_kin has it"),
        ("mounting in Installation", "as the arm stands"),
        ("motion version in Installation", "noted; blends and times may differ by it"),
        ("local control, no Dashboard client", "nothing but a person closes popups"),
        ("time from the first movel to the last", "as planned, at 100 % speed: else the feed is another"),
        ("Program loops forever, in the program's head", "off: at its end it would begin anew by itself"),
        ("behind an error or a stop that is given up", "start the program from its beginning"),
    ]
    return out


def _driven(problem: Problem, plan: Plan, arms: Sequence[Arm]) -> list[tuple[str, str]]:
    """What a controller of ROS 2 that moves all joints must have, and the runner of trajectories."""
    controller, out = problem.cell.controller, list[tuple[str, str]]()
    names = [
        f"{controller.joint_prefix.get(arm.name, '')}{joint}" for arm in arms for joint in arm.data.joints
    ]
    path, goal = (
        float(np.rad2deg(value)) for value in (controller.path_tolerance, controller.goal_tolerance)
    )
    for signal in _powered(problem, plan):
        out.append((f"the service that sets {signal}", "answers once the output has the value"))
        out.append(
            (
                f"{signal} with the runner ended by force, the computer off, its network pulled",
                "falls within 1 s",
            )
        )
        out.append((f"the power of {signal} at a safety stop and with the drives", "falls: wired so"))
    return [
        *out,
        ("controller", "one joint_trajectory_controller for all joints, interpolation_method splines"),
        ("its joints, in any order", ", ".join(names)),
        ("state interfaces", "position and velocity of all joints"),
        ("allow_nonzero_velocity_at_trajectory_end, allow_partial_joints_goal", "false"),
        ("interpolate_from_desired_state (open_loop_control in Humble)", "true"),
        (
            "version of joint_trajectory_controller",
            "2.37 (Humble), 4.12 (Jazzy), or later: before, it looks at no tolerances of goals",
        ),
        ("joints of the URDF at the computer", "zero and turn as those that the job was planned with"),
        ("a hand on a joint while it moves slowly: ends the move", f"beyond {path:g} deg off its way"),
        ("behind each move all joints", f"within {goal:g} deg"),
        ("what scales speeds at the controller or at the pendant", "100 %: else the feed is another"),
        ("tool and load at each arm's controller", "as the rows tool of the file have them"),
        ("time of the longest move", "as planned"),
        ("behind a stop of any kind", "power off, wire off, arms home by hand; start from the beginning"),
    ]


def _ur_torch(signal: str) -> list[tuple[str, str]]:
    """What a UR controller needs so that a torch goes out at each stop, and is not lit again."""
    return [
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while {signal} is on, "
            f"supply off and input bridged: {signal}",
            "falls; else a safety output in series with it",
        ),
        (
            "once, as before: Pause in a slot, then Play",
            "the program ends, nothing is lit; else this controller gives outputs back: light no torch with "
            "it",
        ),
        (
            "once, as before: the speed slider at its least in a slot; the input pulled in a slot",
            "the program ends within some seconds; at once",
        ),
        ("the speed slider", "100 %, and nobody moves it"),
        (
            f"{signal} on at a stop: never set again by hand",
            "the program ends: torch out by hand, sheet looked at, start from the beginning; it cuts all "
            "slots, so on a sheet without them, else plan anew what is left",
        ),
    ]


def _ur_joined(controller: Controller, arm: str) -> list[tuple[str, str]]:
    """What a UR controller needs so that another one's program knows when this one stops."""
    own = controller.handshake.of(arm)
    ends = [
        (own.output, "output"),
        (own.running, "output"),
        (own.input, "input"),
        (own.partner_running, "input"),
    ]
    named = [(f"{name} is {_ur_signal(controller.number(arm, name), kind)}", "wired") for name, kind in ends]
    return [
        *named,
        (f"{own.running} in Installation, I/O", "low when the program does not run; no other action"),
        (f"{own.output}, {own.input}, {own.partner_running} in Installation, I/O", "no action"),
        (
            f"Stop, Pause, emergency stop, safeguard stop, protective stop, each while both programs run: "
            f"{own.running}",
            "falls, and the other arm stops; else a safety output of this controller in series with its wire",
        ),
        ("emergency stops of both controllers", "joined: either button stops both"),
        ("the speed slider", "100 % at both, and nobody moves it"),
        ("behind a stop or pause of either arm", "both programs have ended: start both from their beginning"),
        (
            "once: the arm that follows started alone up to Ready to meet, Pause, then Play",
            "its program ends; else this controller gives outputs back behind a pause: do not use it for two",
        ),
    ]


def _ur_signal(number: int | None, kind: str) -> str:
    """What a number of a digital input or output is called at a UR controller."""
    if number is None:
        return "none"
    if number >= STANDARD_OUTPUTS:
        return f"configurable {kind} {number - STANDARD_OUTPUTS}"
    return f"digital {kind} {number}"


STANDARD_OUTPUTS = 8
"""How many standard digital outputs, and inputs, a UR controller has; configurable ones come behind them."""


def _powered(problem: Problem, plan: Plan, arm: str = "") -> list[str]:
    """Signals that programs switch, without the clamps of sheets; of one arm where each has a controller."""
    order = [item.name for item in problem.cell.arms]
    out: dict[str, None] = {}
    for operation in plan.operations:
        targets = operation.targets
        pulsed = {claim.signal for claim in targets.claims if isinstance(claim, SinksHolder)}
        if not arm or arm == min(targets.arms, key=order.index):
            on = (action.signal for action in targets.actions if action.kind == "on")
            out |= dict.fromkeys(signal for signal in on if signal not in pulsed)
    return list(out)


def _torches(
    problem: Problem, plan: Plan, signals: Sequence[str], anew: str, arm: str = ""
) -> list[tuple[str, str]]:
    """What follows a stop at which a torch burned; ``anew``: how a program begins again; ``arm``: the one of
    this controller where the other one has another."""
    own = torch_signals(problem.operations)
    there = (
        {one.name: set(_powered(problem, plan, one.name)) & own for one in problem.cell.arms} if arm else {}
    )
    anew += ", at both controllers" if any(there.values()) else ""
    words = f"the program ends: torch out by hand, sheet looked at, {anew}; it cuts all slots, so on a sheet "
    words += "without them, else plan anew what is left"
    out = [(f"{signal} on at a stop: never set again by hand", words) for signal in signals if signal in own]
    also = f"this program begins anew, too: {anew}; its controller knows nothing of the torch"
    rows = [(name, signal) for name, lit in there.items() if name != arm for signal in sorted(map(str, lit))]
    return out + [(f"{signal} of arm {name} on at a stop", also) for name, signal in rows]


def _hot(problem: Problem) -> bool:
    """Whether wires are mounted that get hot."""
    return any(operation.process.endswith("_wire") for operation in problem.operations)


def _abb(problem: Problem, plan: Plan, arm: str, joined: bool) -> list[tuple[str, str]]:
    controller = problem.cell.controller
    ending = "sys" if controller.robotware == 6 else "sysx"
    out = [("RobotWare", f"{controller.robotware}; its modules end in .{ending.replace('sys', 'mod')}")]
    signals = _powered(problem, plan, arm)
    folder = f"programs/controller/{arm}" if arm else "programs/controller"
    if joined and not signals:
        out.append((f"EIO.cfg of {folder}", "loaded"))
    if joined:
        out += _wired(problem, arm)
    if signals:
        out.append((f"EIO.cfg, SYS.cfg and TandemPower.{ending} of {folder}", "loaded"))
        for signal in signals:
            real = controller.interlock.of(signal)
            place = f"{real.device}, bit {real.bit}" if real.device else "NO DEVICE stated, so no power"
            out.append((f"{real.signal} falls at a stop, with the motors, with the enabling device", place))
    if signals and _hot(problem):
        out.append(
            (
                "mounting while the wire is hot and the gate open",
                "not in automatic: mount cold, or in manual at reduced speed while somebody else holds the "
                "enabling device, and run to the end in manual",
            )
        )
    out += _torches(problem, plan, signals, "PP to main in all tasks, Start", arm if joined else "")
    out.append(("SoftES in SYS.cfg (RUNCHN_BOOL)", "selected: arms keep to their path at an emergency stop"))
    for item in problem.cell.arms:
        if item.axes and arm in ("", item.name):
            out += axes_sheet.abb_rails(item, controller.robot(problem.cell.arms.index(item)))
    table = problem.cell.turntable
    if table is not None and arm in ("", table.arm):
        out += axes_sheet.turntable(problem, table)
    if any(setup.stock.held_by for setup in problem.setups):
        out.append(("ModalPayLoadMode (SYS_MISC)", "1: else GripLoad of the held block counts for nothing"))
    out.append(("CAB_REGAIN_DIST, AUTO", "small: an arm goes back to its path by itself from so far away"))
    out.append(("behind an error or a stop that is given up", "PP to main in all tasks, then start"))
    return out


def _kuka(problem: Problem, plan: Plan, arm: str, joined: bool) -> list[tuple[str, str]]:
    controller, out = problem.cell.controller, list[tuple[str, str]]()
    signals = [
        (signal, number)
        for signal in _powered(problem, plan, arm)
        if (number := controller.number(arm, signal)) is not None
    ]
    folder = f"programs/controller/{arm}"
    if signals:
        files = f"config_user.dat, sps_user.sub and ir_stopm_user.src of {folder}"
        out.append((files, "in $CONFIG.DAT, SPS.SUB and IR_STOPM.SRC; the submit interpreter runs"))
    elif joined:
        files = f"config_user.dat and sps_user.sub of {folder}"
        out.append((files, "in $CONFIG.DAT and SPS.SUB; the submit interpreter runs"))
    if joined:
        own = controller.handshake.of(arm)
        enable = controller.number(arm, own.move_enable)
        out.append(
            (f"$OUT[{enable}] {own.move_enable}", "wired to the input of $MOVE_ENABLE; $CHCK_MOVENA TRUE")
        )
    for signal, number in signals:
        real = controller.number(arm, controller.interlock.of(signal).signal)
        out.append(
            ("the power falls at a stop and with the drives", f"$OUT[{number if real is None else real}]")
        )
    if signals and _hot(problem):
        words = "not in automatic: mount cold, or in T1 with the enabling switch held by somebody else"
        out.append(("mounting while the wire is hot and the gate open", words))
    out += _torches(problem, plan, [signal for signal, _ in signals], "reset, start", arm if joined else "")
    rider = problem.cell.arm(arm)
    if rider.axes:
        out += axes_sheet.kuka_rails(rider)
    table = problem.cell.turntable
    if table is not None and table.arm == arm:
        out += axes_sheet.turntable(problem, table)
    out += axes_sheet.other_axes(rider, table)
    out.append(("behind an error or a stop that is given up", "reset the program, then start"))
    return out


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
    items: list[tuple[object, object]] = []
    for claim in targets.claims:
        if isinstance(claim, WireJoins):
            items += bent_wire_rows(claim) + mounting_rows(setup, plan, operation, claim)
        elif isinstance(claim, StraightWire):
            items += straight_wire_rows(claim)
    own = exhibits.setup_items(targets.exhibits)
    straight = any(isinstance(claim, StraightWire) for claim in targets.claims)
    # the straight wire's process says all this by itself
    items += own if own and straight else [*cutting_rows(operation, proof), *own]
    signals = dict.fromkeys(a.signal for a in targets.actions if a.signal)
    items += [("signals", _listed([markup.Code(signal) for signal in signals]))] if signals else []
    waits = sum(a.seconds for a in targets.actions)
    items += [("waits in all", f"{markup.fixed(waits, 1)} s")] if waits else []
    return Facts((*items, *_controllers(problem), *_wires(problem)))


def _listed(phrases: Sequence[Phrase]) -> Phrase:
    """Phrases with commas between them."""
    return markup.Joined(tuple(part for one in phrases for part in (", ", one))[1:])


def _controllers(problem: Problem) -> list[tuple[object, object]]:
    """Tasks of ABB's arms; of KUKA's the dialect, what the controller must have, and numbers of signals; of
    UR's the numbers."""
    controller = problem.cell.controller
    ur = [arm.name for arm in problem.cell.arms if arm.data.family == "UR"]
    krl = [arm.name for arm in problem.cell.arms if arm.data.family == "KUKA"]
    driven = [arm.name for arm in problem.cell.arms if arm.data.family == "ROS"]
    named = [
        f"{arm.name}: {task}"
        for arm, task in zip(problem.cell.arms, controller.tasks, strict=False)
        if arm.name not in (*krl, *ur, *driven)
    ]
    out: list[tuple[object, object]] = [("tasks", ", ".join(named))] if named else []
    if driven:
        out.append(
            (f"trajectories of {', '.join(driven)}", "one file for ROS 2, not run on a controller yet")
        )
    dialect = {"krc4": "KRC4, KSS 8.3 on", "krc2": "KRC2"}[controller.dialect]
    for arm in krl:
        numbers = controller.io.get(arm, {})
        listed = "".join(f"; {signal} is number {number}" for signal, number in numbers.items())
        blocks = "; spline blocks, not seen on a controller" if controller.path == "spline" else ""
        out.append((f"KRL of {arm}", f"{dialect}; $ROBROOT zero{listed}{blocks}"))
    for arm in ur:
        numbers = controller.io.get(arm, {})
        listed = "".join(f"; {signal} is number {number}" for signal, number in numbers.items())
        out.append((f"URScript of {arm}", f"one program, not run on a controller yet{listed}"))
    return out


def _wires(problem: Problem) -> list[tuple[object, object]]:
    """The wires between two controllers that meet by handshake."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return []
    arms = [arm.name for arm in problem.cell.arms]
    wires = (*controller.handshake.wired(arms), *controller.handshake.wired_running(arms))
    shown = ", ".join(f"{w.output} of {w.source} to {w.input} of {w.sink}" for w in wires)
    return [("wires between the controllers", shown)]


def _stops(operation: OperationPlan, start: float) -> Block:
    rows: list[tuple[Phrase, ...]] = []
    for action in operation.targets.actions:
        what = action.text or action.signal or (f"{action.seconds:g} s" if action.kind == "wait" else "")
        time = markup.fixed(float(operation.time[action.at]) + start, 1)
        rows.append((time, operation.targets.name(action.at), _STOP_WORDS[action.kind], what))
    if not rows:
        return markup.Paragraph("none")
    return markup.table(("motion time [s]", "at target", "", "what"), rows)
