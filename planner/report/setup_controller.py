"""The part of the setup sheet on the controllers: what is loaded and set there before the first run."""

from __future__ import annotations

from collections.abc import Sequence

from planner.catalogue import robot
from planner.claims_forming import SinksHolder
from planner.plans import Plan
from planner.problem import Arm, Problem
from planner.report import markup
from planner.report.markup import Raw

_HEADS = ("controller", "what", "to be so", "done")
_BOX = Raw('<span class="fill"></span>')


def checks(problem: Problem, plan: Plan) -> Raw:
    """A table to tick off, for each controller of the arms that take part."""
    controller = problem.cell.controller
    used = {name for operation in plan.operations for name in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    alone = controller.sync == "handshake"
    joined = alone and len(arms) > 1
    rows: list[tuple[object, ...]] = []
    seen = False
    for arm in arms:
        if robot(arm.robot).family == "KUKA":
            rows += [
                (arm.name, what, wanted, _BOX) for what, wanted in _kuka(problem, plan, arm.name, joined)
            ]
        elif alone or not seen:
            seen = True
            name = arm.name if alone else ", ".join(a.name for a in arms)
            rows += [
                (name, what, wanted, _BOX)
                for what, wanted in _abb(problem, plan, arm.name if alone else "", joined)
            ]
    if joined:
        both = ", ".join(arm.name for arm in arms)
        rows += [(both, what, wanted, _BOX) for what, wanted in _wires(problem, plan, arms)]
    return markup.table(_HEADS, rows)


def _wires(problem: Problem, plan: Plan, arms: Sequence[Arm]) -> list[tuple[str, str]]:
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
    out.append(("SoftES in SYS.cfg (RUNCHN_BOOL)", "selected: arms keep to their path at an emergency stop"))
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
    out.append(("behind an error or a stop that is given up", "reset the program, then start"))
    return out
