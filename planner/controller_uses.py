"""What the operations of a problem ask of the controllers of its cell: signals of one use each, names that
fit, options that are there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from planner.catalogue import robot
from planner.issues import Issue
from planner.problem import Cell, Controller, Operation

RAPID_NAME: Final = 32
SWITCHED_NAME: Final = 28
"""The longest names [characters] of signals, and of those that programs switch."""

_COORDINATED: Final = {6: "604-1 MultiMove Coordinated", 7: "3102-1 MultiMove Coordinated"}
"""What one ABB controller needs to move two arms together, by RobotWare."""


def faults(cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """Signals that two uses share, names that are too long (both ``problem.field``), and options that are
    missing (``post.option``), each with its field in the problem file."""
    used = [(f"operations.{index}", operation) for index, operation in enumerate(operations)]
    return [*_signals(cell, used), *_places(cell), *_options(cell.controller, cell, operations)]


def _signals(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Each name has one use; requests of one use may come again."""
    controller = cell.controller
    uses: dict[str, str] = {}
    issues: list[Issue] = []

    def use(name: str, what: str, field: str, longest: int = RAPID_NAME) -> None:
        before = uses.setdefault(name.lower(), what)
        if before != what:
            got = f"{name} is to be {before} and {what}; a signal has one use"
            issues.append(Issue("problem.field", got, field=field, hint="give them different signals"))
        if len(name) > longest:
            got = f"{name} has {len(name)} characters; allowed: {longest}"
            issues.append(Issue("problem.field", got, field=field, hint="shorten the name"))

    lock, place = controller.interlock, "cell.controller.interlock"
    if controller.sync == "handshake":
        for arm in cell.arms:
            own = controller.handshake.of(arm.name)
            field = f"cell.controller.handshake.signals.{arm.name}"
            use(own.output, "an output to the other controller", field)
            use(own.input, "an input from the other controller", field)
    use(lock.cycle, "what says that a program runs", f"{place}.cycle_signal")
    use(lock.motors, "what says that motors are on", f"{place}.motors_signal")
    for field, operation in operations:
        die = getattr(operation, "die", None)
        if die is not None and getattr(die, "holder", "") == "sinking":
            use(die.signal, "the pulse of a clamp that sinks", f"{field}.die.signal", SWITCHED_NAME)
        signal = getattr(operation, "signal", None)
        if isinstance(signal, str):
            what = "the power of a spindle" if operation.process == "milling" else "the power of a wire"
            use(signal, what, f"{field}.signal", SWITCHED_NAME)
            use(lock.of(signal).signal, f"the output that {signal} drives", f"{place}.outputs")
    for arm in cell.arms:
        for request, output in lock.outputs.items():
            if controller.number(arm.name, request) and not controller.number(arm.name, output.signal):
                got = (
                    f"{output.signal} has no number on the controller of arm {arm.name}, where {request} has"
                )
                hint = f"add it to controller: {{io: {{{arm.name}: ...}}}}"
                issues.append(Issue("problem.field", got, field=f"{place}.outputs.{request}", hint=hint))
    wired: dict[tuple[str, int], str] = {}
    for request, output in lock.outputs.items():
        key = (output.device.lower(), output.bit)
        if output.device and key in wired:
            got = f"{wired[key]} and {output.signal} are both bit {output.bit} of {output.device}"
            hint = "give each output a bit of its own (device_map)"
            issues.append(Issue("problem.field", got, field=f"{place}.outputs.{request}", hint=hint))
        wired[key] = output.signal
    if controller.sync == "handshake":
        issues += _running(cell, operations, uses)
    return issues


def _running(cell: Cell, operations: Sequence[tuple[str, Operation]], uses: Mapping[str, str]) -> list[Issue]:
    """Ends of the running wires have names of their own at their controller, and ABB's bits of their own."""
    lock, order = cell.controller.interlock, [arm.name for arm in cell.arms]
    issues = []
    for arm in cell.arms:
        own = cell.controller.handshake.of(arm.name)
        field = f"cell.controller.handshake.signals.{arm.name}"
        for name in (own.running, own.partner_running, own.lost):
            if name.lower() in uses:
                got = f"{name} is to be {uses[name.lower()]} and an end of a running wire"
                got += "; a signal has one use"
                issues.append(Issue("problem.field", got, field=field, hint="give them different signals"))
        taken: dict[tuple[str, int], str] = {}
        for _, operation in operations:
            signal = getattr(operation, "signal", None)
            if isinstance(signal, str) and min(operation.arms, key=order.index) == arm.name:
                output = lock.of(signal)
                taken |= {(output.device.lower(), output.bit): output.signal} if output.device else {}
        place = lock.place(arm.name, own.running)
        if place is not None and (place.device.lower(), place.bit) in taken:
            other = taken[place.device.lower(), place.bit]
            got = f"{other} and {own.running} are both bit {place.bit} of {place.device}"
            hint = "give each output a bit of its own (device_map)"
            field = f"cell.controller.interlock.places.{arm.name}"
            issues.append(Issue("problem.field", got, field=field, hint=hint))
    return issues


def _places(cell: Cell) -> list[Issue]:
    """Places are stated of the running wires' ends at ABB controllers that have them."""
    controller, issues = cell.controller, []
    ends = {
        arm.name: [own.running, own.partner_running]
        for arm in cell.arms
        for own in [controller.handshake.of(arm.name)]
        if controller.sync == "handshake" and robot(arm.robot).family == "ABB"
    }
    for arm, places in controller.interlock.places.items():
        known = [name.lower() for name in ends.get(arm, ())]
        for signal in places:
            if signal.lower() not in known:
                got = f"arm {arm} has no end {signal} of a running wire at an ABB controller"
                may = "; ".join(f"{name}: {', '.join(names)}" for name, names in ends.items()) or "none"
                field = f"cell.controller.interlock.places.{arm}"
                issues.append(
                    Issue("problem.field", f"{got}; allowed: {may}", field=field, hint="take it out")
                )
    return issues


def _options(controller: Controller, cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """One ABB controller that moves two arms needs MultiMove; a cell that states no options is not asked."""
    arms = {arm for operation in operations for arm in operation.arms}
    together = [arm for arm in cell.arms if arm.name in arms and robot(arm.robot).family == "ABB"]
    if controller.options is None or controller.sync == "handshake" or len(together) < 2:
        return []
    wanted = _COORDINATED[controller.robotware]
    if any(option.split()[:1] == wanted.split()[:1] for option in controller.options):
        return []
    got = f"two arms on one controller need the option {wanted}; the cell lists {_listed(controller)}"
    hint = "install the option, or take two controllers that share signals (sync: handshake)"
    return [Issue("post.option", got, field="cell.controller.options", hint=hint)]


def _listed(controller: Controller) -> str:
    return ", ".join(controller.options or ()) or "none"
