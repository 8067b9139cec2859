"""The controllers of a cell: schema, values in SI units, and what operations ask of their signals.

Signals are of one use each, names fit what the controller allows, and options that are needed are
there.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from planner.claims.handshake import Handshake, HandshakeKind, PartnerSignals, SignalWire
from planner.geometry.units import DEG
from planner.issues import Issue, TandemError, refusal
from planner.problem import (
    Cell,
    Controller,
    DevicePlace,
    Interlock,
    KrlDialect,
    KrlPath,
    Operation,
    PowerOutput,
    lights_torch,
    output_of,
)
from planner.reading.strict_yaml import Name, Strict
from planner.runtime import plugins
from planner.runtime.plugins import Language

SignalNumber = Annotated[int, Field(ge=0, le=4096)]
"""``n`` of ``$IN[n]`` or ``$OUT[n]``, or of UR's digital outputs."""
UR_OUTPUTS: Final = range(16)
"""Numbers of a UR controller's digital outputs: 0 to 7 are standard ones, 8 to 15 the configurable ones."""
OTHER_NUMBERS: Final = range(1, 4097)
"""Numbers of signals of all other controllers."""


class SignalsFile(Strict):
    """Signals of one controller to the other one."""

    output: Name = Field(default=PartnerSignals.output, description="digital output to the other controller")
    input: Name = Field(default=PartnerSignals.input, description="digital input from the other controller")
    running: Name = Field(
        default=PartnerSignals.running,
        description="output that the controller holds at 1 while its program runs",
    )
    partner_running: Name = Field(
        default=PartnerSignals.partner_running,
        description="input from the other controller's `running`; its fall stops this arm",
    )
    move_enable: Name = Field(
        default=PartnerSignals.move_enable,
        description="of a KUKA controller: output that is looped to the input of $MOVE_ENABLE",
    )


class WireEndFile(Strict):
    """One end of a wire between the controllers."""

    arm: Name
    signal: Name


class SignalWireFile(Strict):
    """A wire between the controllers."""

    output: WireEndFile = Field(description="the output that drives it")
    input: WireEndFile = Field(description="the input that it drives")


class HandshakeFile(Strict):
    """How two controllers meet that share digital signals only."""

    kind: HandshakeKind = Field(
        default=Handshake.kind, description="signals change twice at each meeting and are 0 between, or once"
    )
    every: int = Field(default=Handshake.every, ge=1, le=100, description="meet at every so many moves")
    signals: dict[Name, SignalsFile] = Field(
        default_factory=dict, description="by arm; an arm not named has the defaults"
    )
    wires: tuple[SignalWireFile, ...] = Field(
        default=(),
        max_length=4,
        description="all four, of `output` and of `running`; none: each drives the other arm's input",
    )
    timeout_s: float = Field(
        default=Handshake.timeout,
        ge=0.1,
        le=3600,
        description="longest wait for the other arm at a step of joint work",
    )
    patience_s: float = Field(
        default=Handshake.patience,
        ge=1,
        le=86_400,
        description="longest wait while the other arm moves alone or asks the operator",
    )


class PowerOutputFile(Strict):
    """The output that a request of the program drives."""

    signal: Name | None = Field(
        default=None, description="its name, unless stated that of the request and `Out`"
    )
    device: Name | None = Field(
        default=None, description="I/O device of an ABB controller; none: nothing is wired to it"
    )
    device_map: int = Field(default=0, ge=0, le=4095, description="bit on that device")


class DevicePlaceFile(Strict):
    """Where a signal that powers nothing is at an ABB controller."""

    device: Name = Field(description="I/O device")
    device_map: int = Field(default=0, ge=0, le=4095, description="bit on that device")


class InterlockFile(Strict):
    """What the power hangs on besides the program."""

    outputs: dict[Name, PowerOutputFile] = Field(
        default_factory=dict, description="by the signal that the program sets, which is a request"
    )
    cycle_signal: Name = Field(default=Interlock.cycle, description="system output of ABB: a program runs")
    motors_signal: Name = Field(
        default=Interlock.motors, description="system output of ABB: the motors are on"
    )
    places: dict[Name, dict[Name, DevicePlaceFile]] = Field(
        default_factory=dict,
        description="of signals that power nothing at ABB controllers (ends of wires between two of "
        "them, inputs that an operation waits for, pulses), by arm and signal",
    )


def _installed(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """Take the name of a language that an installed package adds as it is."""
    added = isinstance(value, str) and not plugins.is_built_in(Language, value)
    return value if added and value in plugins.usable(Language) else validate(value)


class ControllerFile(Strict):
    """Names that the programs use, and whether one controller moves both arms (MultiMove) or each has its
    own."""

    sync: Literal["multimove", "handshake"] = Field(
        default=Controller.sync, description="one controller, or two that share digital signals only"
    )
    tasks: tuple[Name, ...] | None = Field(
        default=None, min_length=1, max_length=2, description="T_ROB1, T_ROB2; with `handshake` T_ROB1 twice"
    )
    units: tuple[Name, ...] | None = Field(
        default=None, min_length=1, max_length=2, description="ROB_1, ROB_2; with `handshake` ROB_1 twice"
    )
    handshake: HandshakeFile | None = None
    wire_signal: Name = Controller.wire_signal
    dialect: KrlDialect = Field(
        default=Controller.dialect, description="of KUKA arms: KSS 8.3 on, or the older subset"
    )
    path: KrlPath = Field(
        default=Controller.path,
        description="of KUKA arms: straight moves, or spline blocks with times (`krc4`, one arm)",
    )
    io: dict[Name, dict[Name, SignalNumber]] = Field(
        default_factory=dict, description="numbers of the signals of KUKA and UR controllers, by arm and name"
    )
    robotware: Literal[6, 7] = Field(
        default=Controller.robotware,
        description="of ABB controllers: 6 has `.mod` in ISO 8859-1, 7 `.modx` in UTF-8",
    )
    robots: tuple[Name, ...] | None = Field(
        default=None, min_length=1, max_length=2, description="`ROBOT` in MOC.cfg; unless stated, `units`"
    )
    options: tuple[Annotated[str, Field(min_length=1, max_length=80)], ...] | None = Field(
        default=None, description="options installed, as the controller lists them; none: not stated"
    )
    interlock: InterlockFile = Field(default_factory=InterlockFile)
    language: Annotated[
        Literal["own", "ros"],
        WrapValidator(_installed),
        Field(
            description="`ros`: joint trajectories for one controller of ROS 2 that moves all arms; `own`: "
            "the language of each arm's family"
        ),
    ] = "own"
    joint_prefix: dict[Name, Name] = Field(
        default_factory=dict,
        description="with `language: ros`, by arm: what stands before the joints' names of its URDF",
    )
    path_tolerance_deg: float = Field(
        default=2.0,
        gt=0,
        le=10,
        description="with `language: ros`: a joint farther off its way ends the move",
    )
    goal_tolerance_deg: float = Field(
        default=0.2, gt=0, le=2, description="with `language: ros`: so near to its goal each joint comes"
    )
    goal_time_s: float = Field(
        default=Controller.goal_time, gt=0, le=30, description="with `language: ros`: so late it may be there"
    )
    max_moves: int = Field(default=Controller.max_moves, ge=10, le=100_000)
    max_kilobytes: int = Field(default=Controller.max_bytes // 1000, ge=10, le=10_000)


def controllers(spec: ControllerFile, arms: Sequence[str]) -> Controller:
    """The controller, or the two of them, of a cell with these arms. Raises ``TandemError``."""
    alone = spec.sync == "handshake"
    tasks = spec.tasks or (Controller.tasks[:1] * 2 if alone else Controller.tasks)
    units = spec.units or (Controller.units[:1] * 2 if alone else Controller.units)
    stated = (("tasks", tasks), ("units", units), ("robots", spec.robots or units))
    for field, names in stated:
        if len(names) < len(arms):
            what = f"{len(names)} {field} for {len(arms)} arms; name one for each arm of the cell"
            raise refusal("post.tasks", what, field=f"controller.{field}")
        if not alone and len({name.lower() for name in names}) != len(names):
            what = f"the {field} {', '.join(names)} are not different; give each arm its own"
            raise refusal("problem.duplicate_name", what, field=f"controller.{field}")
    for field, called in (("controller.tasks", tasks), ("arms", tuple(arms))):
        if "controller" in (name.lower() for name in called):
            what = "controller is the folder of files for controllers beside the programs; rename it"
            raise refusal("problem.field", what, field=field)
    if spec.handshake is not None and not alone:
        raise _wrong("", "a handshake is stated, but sync is multimove; set sync to handshake or take it out")
    handshake = (
        _handshake(spec.handshake or HandshakeFile.model_validate({}), arms, spec.wire_signal)
        if alone
        else Handshake()
    )
    _check_io(spec.io, arms, handshake if alone else None)
    _check_ros(spec, arms)
    if spec.path == "spline":
        _check_path(spec, len(arms))
    return Controller(
        tuple(tasks),
        tuple(units),
        spec.wire_signal,
        spec.max_moves,
        spec.max_kilobytes * 1000,
        spec.sync,
        handshake,
        spec.dialect,
        {arm: dict(numbers) for arm, numbers in spec.io.items()},
        spec.path,
        spec.robotware,
        _interlock(spec.interlock),
        tuple(spec.robots or ()),
        spec.options,
        spec.language,
        dict(spec.joint_prefix),
        spec.path_tolerance_deg * DEG,
        spec.goal_tolerance_deg * DEG,
        spec.goal_time_s,
    )


def _check_ros(spec: ControllerFile, arms: Sequence[str]) -> None:
    """Raise where what is stated of trajectories does not fit."""
    for name in spec.joint_prefix:
        if name not in arms:
            what = f"the cell has no arm {name}; allowed: {', '.join(arms)}"
            raise refusal("problem.field", what, field="controller.joint_prefix")
    if spec.language != "ros" and spec.joint_prefix:
        what = f"a joint_prefix is stated, but language is {spec.language}; set language: ros or take it out"
        raise refusal("problem.field", what, field="controller.joint_prefix")
    if spec.language == "ros" and spec.sync == "handshake":
        what = "language: ros with sync: handshake; one controller moves all joints there, on one clock: "
        what += "take sync out, or two arms with languages of their own"
        raise refusal("problem.field", what, field="controller.sync")


def _check_path(spec: ControllerFile, arms: int) -> None:
    """Raise where spline blocks cannot be written or proven."""
    if spec.dialect != "krc4":
        what = f"path: spline with dialect: {spec.dialect}; allowed: krc4; set dialect: krc4 or path: slin"
    elif spec.sync == "handshake" or arms > 1:
        what = (
            "path: spline for two arms, which would have to stand still at every meeting, and whose "
            "distance between two of them is proven on straight moves; allowed: one arm alone; set path: slin"
        )
    else:
        return
    raise refusal("problem.field", what, field="controller.path")


def _interlock(spec: InterlockFile) -> Interlock:
    outputs = {
        request: PowerOutput(item.signal or output_of(request), item.device or "", item.device_map)
        for request, item in spec.outputs.items()
    }
    places = {
        arm: {signal: DevicePlace(item.device, item.device_map) for signal, item in items.items()}
        for arm, items in spec.places.items()
    }
    return Interlock(outputs, spec.cycle_signal, spec.motors_signal, places)


def _check_io(io: Mapping[str, Mapping[str, int]], arms: Sequence[str], handshake: Handshake | None) -> None:
    """Raise where numbers are stated for an arm that is not there, or two signals share one."""
    for arm, numbers in io.items():
        if arm not in arms:
            what = f"the cell has no arm {arm}; allowed: {', '.join(arms)}"
            raise refusal("problem.field", what, field="controller.io")
        own = handshake.of(arm) if handshake else None
        inputs = {own.input.lower(), own.partner_running.lower()} if own else set()
        lines = inputs | (
            {own.output.lower(), own.running.lower(), own.move_enable.lower()} if own else set()
        )
        used: dict[tuple[bool, int] | str, str] = {}
        for name, number in numbers.items():
            # of other names it is not known yet whether an operation waits for them: see _numbers
            keys: list[tuple[bool, int] | str] = [name.lower()]
            keys += [(name.lower() in inputs, number)] if name.lower() in lines else []
            for key in keys:
                if key in used:
                    raise TandemError(_one(used[key], name, number, f"controller.io.{arm}"))
            used |= dict.fromkeys(keys, name)


def _one(first: str, second: str, number: int, field: str) -> Issue:
    what = f"{first} and {second} (number {number}) cannot be told apart"
    return Issue("problem.field", f"{what}; give each a name and a number of its own", field=field)


def _handshake(spec: HandshakeFile, arms: Sequence[str], power: str) -> Handshake:
    if len(arms) != 2:
        raise _wrong("", f"the cell has {len(arms)} arm; a handshake joins the controllers of two")
    for name in spec.signals:
        if name not in arms:
            raise _wrong("signals", f"the cell has no arm {name}; allowed: {', '.join(arms)}")
    signals = {
        arm: PartnerSignals(
            names.output, names.input, names.running, names.partner_running, names.move_enable
        )
        for arm in arms
        for names in [spec.signals.get(arm, SignalsFile())]
    }
    for arm, names in signals.items():
        words = [*dataclasses.astuple(names), power]
        if len({word.lower() for word in words}) != len(words):
            what = f"{', '.join(words[:-1])} and {power} (the wire's power) must be {len(words)} signals"
            raise _wrong(f"signals.{arm}", f"{what}; give them different names")
    wires = tuple(SignalWire(w.output.arm, w.output.signal, w.input.arm, w.input.signal) for w in spec.wires)
    _check_wires(wires, signals)
    runs = [wire.output.lower() == signals[wire.source].running.lower() for wire in wires]
    meet = tuple(wire for wire, running in zip(wires, runs, strict=True) if not running)
    watch = tuple(wire for wire, running in zip(wires, runs, strict=True) if running)
    return Handshake(spec.kind, spec.every, signals, meet, watch, spec.timeout_s, spec.patience_s)


def _check_wires(wires: Sequence[SignalWire], signals: Mapping[str, PartnerSignals]) -> None:
    """Raise where stated wires are not two from each controller to the other one: from output to input, and
    from running output to running input."""
    if not wires:
        return
    first, second = signals
    wanted = [
        SignalWire(a, output, b, given)
        for a, b in ((first, second), (second, first))
        for output, given in (
            (signals[a].output, signals[b].input),
            (signals[a].running, signals[b].partner_running),
        )
    ]
    got = {(w.source, w.output.lower(), w.sink, w.input.lower()) for w in wires}
    for wire in wanted:
        if (wire.source, wire.output.lower(), wire.sink, wire.input.lower()) not in got:
            what = f"no wire leads from {wire.output} of {wire.source} to {wire.input} of {wire.sink}"
            raise _wrong("wires", f"{what}; add it, name the signals as they are, or leave wires out")


def _wrong(field: str, message: str) -> TandemError:
    place = "controller.handshake" + (f".{field}" if field else "")
    return refusal("problem.field", message, field=place)


MAX_RAPID_NAME: Final = 32
"""Longest name in RAPID [characters]."""
MAX_SWITCHED_NAME: Final = 28
"""Longest name [characters] of a signal that programs switch."""

_COORDINATED: Final = {6: "604-1 MultiMove Coordinated", 7: "3102-1 MultiMove Coordinated"}
"""What one ABB controller needs to move two arms together, by RobotWare."""


def faults(cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """Signals that two uses share, names that are too long (both ``problem.field``), and options that are
    missing (``post.option``), each with its field in the problem file."""
    used = [(f"operations.{index}", operation) for index, operation in enumerate(operations)]
    return [
        *_signals(cell, used),
        *_numbers(cell, used),
        *_places(cell, used),
        *_options(cell.controller, cell, operations),
    ]


def _numbers(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Signals have numbers that the arm's controller has; of two inputs, or two outputs, each its own."""
    out = []
    given = {name.lower() for _, operation in operations if (name := _waited(operation)) is not None}
    for arm in cell.arms:
        allowed = UR_OUTPUTS if arm.data.family == "UR" else OTHER_NUMBERS
        own = cell.controller.handshake.of(arm.name)
        joined = cell.controller.sync == "handshake"
        inputs = given | ({own.input.lower(), own.partner_running.lower()} if joined else set())
        used: dict[tuple[bool, int], str] = {}
        for name, number in cell.controller.io.get(arm.name, {}).items():
            other = used.setdefault((name.lower() in inputs, number), name)
            if other != name:
                out.append(_one(other, name, number, f"cell.controller.io.{arm.name}"))
            if number not in allowed:
                got = f"{name} is number {number} on the {arm.data.family} controller of arm {arm.name}"
                what = f"{got}; allowed: {allowed.start} to {allowed.stop - 1}"
                field = f"cell.controller.io.{arm.name}.{name}"
                out.append(Issue("problem.field", what, field=field, hint="state the number that it has"))
    return out


def _waited(operation: Operation) -> str | None:
    name = getattr(operation, "ok_signal", None)
    return name if isinstance(name, str) else None


_BY_SPINDLE: Final = ("milling", "trim")
"""Processes whose signal, where it lights no torch, powers a spindle."""


def _powered(operation: Operation) -> str:
    if lights_torch(operation):
        return "torch"
    if getattr(getattr(operation, "by", None), "kind", "") == "knife":
        return "knife"
    return "spindle" if operation.process in _BY_SPINDLE else "wire"


def _signals(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Each name has one use; requests of one use may come again."""
    controller = cell.controller
    uses: dict[str, str] = {}
    leads: dict[str, str] = {}
    issues: list[Issue] = []

    def use(name: str, what: str, field: str, longest: int = MAX_RAPID_NAME) -> None:
        before = uses.setdefault(name.lower(), what)
        if before != what:
            got = f"{name} is to be {before} and {what}; a signal has one use"
            issues.append(Issue("problem.field", got, field=field, hint="give them different signals"))
        if len(name) > longest:
            got = f"{name} has {len(name)} characters; allowed: {longest}"
            issues.append(Issue("problem.field", got, field=field, hint="shorten the name"))
        if name.lower().startswith("tandem") or name.lower() == "answer":
            got = f"{name} is a name of the controller's files, which would hide the signal"
            issues.append(Issue("problem.field", got, field=field, hint="give the signal another name"))

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
            use(die.signal, "the pulse of a clamp that sinks", f"{field}.die.signal", MAX_SWITCHED_NAME)
        signal = getattr(operation, "signal", None)
        if isinstance(signal, str):
            lead = next((arm.name for arm in cell.arms if arm.name in operation.arms), "")
            known = leads.setdefault(signal.lower(), lead)
            if controller.sync == "handshake" and known != lead:
                got = f"{signal} powers what arms {known} and {lead} carry, each on a controller of its own"
                hint = "give the operations of one of them another signal"
                issues.append(Issue("problem.field", got, field=f"{field}.signal", hint=hint))
            what = f"the power of a {_powered(operation)}"
            use(signal, what, f"{field}.signal", MAX_SWITCHED_NAME)
            use(lock.of(signal).signal, f"the output that {signal} drives", f"{place}.outputs")
        given = _waited(operation)
        if given is not None:
            use(given, "an input that an operation waits for", f"{field}.ok_signal")
    for arm in cell.arms:
        for request, output in lock.outputs.items():
            stated = controller.number(arm.name, request) is not None and arm.data.family != "UR"
            if stated and controller.number(arm.name, output.signal) is None:
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
    """Ends of the running wires have names of their own at their controller."""
    issues = []
    for arm in cell.arms:
        own = cell.controller.handshake.of(arm.name)
        field = f"cell.controller.handshake.signals.{arm.name}"
        for name in (own.running, own.partner_running, own.lost):
            if name.lower() in uses:
                got = f"{name} is to be {uses[name.lower()]} and an end of a running wire"
                got += "; a signal has one use"
                issues.append(Issue("problem.field", got, field=field, hint="give them different signals"))
    return issues


def _places(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Places are stated of signals that ABB controllers have and that power nothing; no two inputs, and no
    two outputs, of a controller share one."""
    controller, issues = cell.controller, list[Issue]()
    alone, taken = controller.sync == "handshake", dict[tuple[str, bool, str, int], str]()
    order = [arm.name for arm in cell.arms]
    ends: dict[str, list[str]] = {}
    inputs: dict[str, set[str]] = {}
    for arm in cell.arms:
        if arm.data.family != "ABB":
            continue
        own, mine, given = controller.handshake.of(arm.name), list[str](), list[str]()
        if controller.sync == "handshake":
            mine, given = [own.running, own.output], [own.partner_running, own.input]
        for _, operation in operations:
            power = getattr(operation, "signal", None)
            if isinstance(power, str) and arm.name == next((n for n in order if n in operation.arms), ""):
                real = controller.interlock.of(power)
                if real.device:
                    taken[arm.name if alone else "", False, real.device.lower(), real.bit] = real.signal
            if arm.name in operation.arms or controller.sync != "handshake":
                given += [one] if (one := _waited(operation)) is not None else []
                die = getattr(operation, "die", None)
                mine += [die.signal] if die is not None and getattr(die, "holder", "") == "sinking" else []
        ends[arm.name] = list(dict.fromkeys([*mine, *given]))
        inputs[arm.name] = {name.lower() for name in given}
    ends = {name: names for name, names in ends.items() if names}
    for at, places in controller.interlock.places.items():
        known = [name.lower() for name in ends.get(at, [])]
        for signal, place in places.items():
            is_input = signal.lower() in inputs.get(at, set())
            other = taken.setdefault((at if alone else "", is_input, place.device.lower(), place.bit), signal)
            if other.lower() != signal.lower():
                got = f"{other} and {signal} are both bit {place.bit} of {place.device}"
                field = f"cell.controller.interlock.places.{at}"
                hint = f"give each {'input' if is_input else 'output'} a bit of its own (device_map)"
                issues.append(Issue("problem.field", got, field=field, hint=hint))
            if signal.lower() not in known:
                got = f"arm {at} has no signal {signal} at an ABB controller that powers nothing"
                may = "; ".join(f"{name}: {', '.join(names)}" for name, names in ends.items()) or "none"
                field = f"cell.controller.interlock.places.{at}"
                issues.append(
                    Issue("problem.field", f"{got}; allowed: {may}", field=field, hint="take it out")
                )
    return issues


def _options(controller: Controller, cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """One ABB controller that moves two arms needs MultiMove; a cell that states no options is not asked."""
    arms = {arm for operation in operations for arm in operation.arms}
    together = [arm for arm in cell.arms if arm.name in arms and arm.data.family == "ABB"]
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
