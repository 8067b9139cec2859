"""The controllers of a cell: schema, conversion to SI units, and requirements of operations on signals.

Each signal has one use, names fit the limits of the controller, and required options are installed.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from planner.claims.handshake import Handshake, HandshakeKind, PartnerSignals, SignalWire
from planner.geometry.units import DEG
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import (
    Cell,
    Controller,
    DeviceBit,
    Interlock,
    KrlDialect,
    KrlPath,
    Operation,
    PowerOutput,
    default_output_name,
    lights_torch,
)
from planner.reading.strict_yaml import Name, Strict
from planner.runtime import plugins
from planner.runtime.plugins import Language

SignalNumber = Annotated[int, Field(ge=0, le=4096)]
"""``n`` of ``$IN[n]`` or ``$OUT[n]``, or of UR's digital outputs."""
UR_OUTPUTS: Final = range(16)
"""Numbers of a UR controller's digital outputs: 0 to 7 are standard, 8 to 15 configurable ones."""
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
    """How two controllers synchronise that share only digital signals."""

    kind: HandshakeKind = Field(
        default=Handshake.kind, description="signals change twice at each meeting and are 0 between, or once"
    )
    every: int = Field(default=Handshake.every, ge=1, le=100, description="number of moves between meetings")
    signals: dict[Name, SignalsFile] = Field(
        default_factory=dict, description="by arm; other arms have the defaults"
    )
    wires: tuple[SignalWireFile, ...] = Field(
        default=(),
        max_length=4,
        description="all four, of `output` and of `running`; none: each drives the other arm's input",
    )
    timeout_s: float = Field(
        default=Handshake.timeout, ge=0.1, le=3600, description="longest wait for the other arm at a meeting"
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
        default=None, description="its name; none: that of the request with suffix `Out`"
    )
    device: Name | None = Field(
        default=None, description="I/O device of an ABB controller; none: the output is not wired"
    )
    device_map: int = Field(default=0, ge=0, le=4095, description="bit on that device")


class DevicePlaceFile(Strict):
    """Wiring of a signal that powers nothing at an ABB controller."""

    device: Name = Field(description="I/O device")
    device_map: int = Field(default=0, ge=0, le=4095, description="bit on that device")


class InterlockFile(Strict):
    """Conditions of power besides the program."""

    outputs: dict[Name, PowerOutputFile] = Field(
        default_factory=dict, description="by the signal that the program sets, which is a request"
    )
    cycle_signal: Name = Field(default=Interlock.cycle, description="system output of ABB: a program runs")
    motors_signal: Name = Field(
        default=Interlock.motors, description="system output of ABB: the motors are on"
    )
    places: dict[Name, dict[Name, DevicePlaceFile]] = Field(
        default_factory=dict,
        description="of signals of ABB controllers that switch no power (ends of wires between two of "
        "them, inputs that an operation waits for, pulses), by arm and signal",
    )


def _installed(value: Any, validate: ValidatorFunctionWrapHandler) -> Any:
    """Accept the name of a language that an installed package adds. Other values are validated."""
    added = isinstance(value, str) and not plugins.is_built_in(Language, value)
    return value if added and value in plugins.usable(Language) else validate(value)


class ControllerFile(Strict):
    """Names that the programs use, and the number of controllers.

    One controller moves both arms (MultiMove), or each arm has its own.
    """

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
        description="with `language: ros`, by arm: prefix of the joint names of its URDF",
    )
    path_tolerance_deg: float = Field(
        default=2.0,
        gt=0,
        le=10,
        description="with `language: ros`: path tolerance; a joint that deviates more aborts the move",
    )
    goal_tolerance_deg: float = Field(
        default=0.2, gt=0, le=2, description="with `language: ros`: goal tolerance of each joint"
    )
    goal_time_s: float = Field(
        default=Controller.goal_time, gt=0, le=30, description="with `language: ros`: goal time tolerance"
    )
    max_moves: int = Field(default=Controller.max_moves, ge=10, le=100_000)
    max_kilobytes: int = Field(default=Controller.max_bytes // 1000, ge=10, le=10_000)


def build_controller(spec: ControllerFile, arms: Sequence[str]) -> Controller:
    """Convert the controller, or both controllers, of a cell with these arms. Raises ``TandemError``."""
    is_separate = spec.sync == "handshake"
    tasks = spec.tasks or (Controller.tasks[:1] * 2 if is_separate else Controller.tasks)
    units = spec.units or (Controller.units[:1] * 2 if is_separate else Controller.units)
    names_by_field = (("tasks", tasks), ("units", units), ("robots", spec.robots or units))
    for field, names in names_by_field:
        if len(names) < len(arms):
            message = f"{len(names)} {field} for {len(arms)} arms; name one for each arm of the cell"
            raise issue_error("post.tasks", message, field=f"controller.{field}")
        if not is_separate and len({name.lower() for name in names}) != len(names):
            message = f"the {field} {', '.join(names)} are not unique; give each arm its own"
            raise issue_error("problem.duplicate_name", message, field=f"controller.{field}")
    for field, used_names in (("controller.tasks", tasks), ("arms", tuple(arms))):
        if "controller" in (name.lower() for name in used_names):
            message = "controller is the name of a folder next to the programs; rename it"
            raise issue_error("problem.field", message, field=field)
    if spec.handshake is not None and not is_separate:
        raise _handshake_error(
            "", "a handshake is stated, but sync is multimove; set sync to handshake or remove it"
        )
    handshake = (
        _build_handshake(spec.handshake or HandshakeFile.model_validate({}), arms, spec.wire_signal)
        if is_separate
        else Handshake()
    )
    _check_io(spec.io, arms, handshake if is_separate else None)
    _check_ros(spec, arms)
    if spec.path == "spline":
        _check_spline_path(spec, len(arms))
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
        _build_interlock(spec.interlock),
        tuple(spec.robots or ()),
        spec.options,
        spec.language,
        dict(spec.joint_prefix),
        spec.path_tolerance_deg * DEG,
        spec.goal_tolerance_deg * DEG,
        spec.goal_time_s,
    )


def _check_ros(spec: ControllerFile, arms: Sequence[str]) -> None:
    """Raise for inconsistent settings of joint trajectories."""
    for name in spec.joint_prefix:
        if name not in arms:
            text = f"the cell has no arm {name}; allowed: {', '.join(arms)}"
            raise issue_error("problem.field", text, field="controller.joint_prefix")
    if spec.language != "ros" and spec.joint_prefix:
        text = f"a joint_prefix is stated, but language is {spec.language}; set language: ros or remove it"
        raise issue_error("problem.field", text, field="controller.joint_prefix")
    if spec.language == "ros" and spec.sync == "handshake":
        text = "language: ros with sync: handshake; with ros one controller moves all joints on one clock: "
        text += "remove sync, or use two arms with their own languages"
        raise issue_error("problem.field", text, field="controller.sync")


def _check_spline_path(spec: ControllerFile, arms: int) -> None:
    """Raise if spline blocks cannot be written or proven."""
    if spec.dialect != "krc4":
        message = f"path: spline with dialect: {spec.dialect}; allowed: krc4; set dialect: krc4 or path: slin"
    elif spec.sync == "handshake" or arms > 1:
        message = (
            "path: spline for two arms, which would have to stop at every meeting, and whose "
            "distance between meetings is proven on straight moves; allowed: one arm; set path: slin"
        )
    else:
        return
    raise issue_error("problem.field", message, field="controller.path")


def _build_interlock(spec: InterlockFile) -> Interlock:
    """Convert the interlock. An output without a stated name has the default name of its request."""
    outputs = {
        request: PowerOutput(item.signal or default_output_name(request), item.device or "", item.device_map)
        for request, item in spec.outputs.items()
    }
    device_bits = {
        arm: {signal: DeviceBit(item.device, item.device_map) for signal, item in items.items()}
        for arm, items in spec.places.items()
    }
    return Interlock(outputs, spec.cycle_signal, spec.motors_signal, device_bits)


def _check_io(io: Mapping[str, Mapping[str, int]], arms: Sequence[str], handshake: Handshake | None) -> None:
    """Raise for signal numbers of an unknown arm, or for two signals that share one."""
    for arm, numbers in io.items():
        if arm not in arms:
            text = f"the cell has no arm {arm}; allowed: {', '.join(arms)}"
            raise issue_error("problem.field", text, field="controller.io")
        signals = handshake.of(arm) if handshake else None
        inputs = {signals.input.lower(), signals.partner_running.lower()} if signals else set()
        handshake_names = inputs | (
            {signals.output.lower(), signals.running.lower(), signals.move_enable.lower()}
            if signals
            else set()
        )
        name_by_key: dict[tuple[bool, int] | str, str] = {}
        for name, number in numbers.items():
            # for other names, _numbers decides later whether an operation waits for them
            keys: list[tuple[bool, int] | str] = [name.lower()]
            keys += [(name.lower() in inputs, number)] if name.lower() in handshake_names else []
            for key in keys:
                if key in name_by_key:
                    raise TandemError(
                        _shared_number_issue(name_by_key[key], name, number, f"controller.io.{arm}")
                    )
            name_by_key |= dict.fromkeys(keys, name)


def _shared_number_issue(first: str, second: str, number: int, field: str) -> Issue:
    message = f"{first} and {second} (number {number}) cannot be distinguished"
    return Issue("problem.field", f"{message}; give each its own name and number", field=field)


def _build_handshake(spec: HandshakeFile, arms: Sequence[str], power: str) -> Handshake:
    """Convert the handshake of two arms. ``power`` is the name of the signal of the wire's power.

    Raises ``problem.field`` for other numbers of arms, unknown arms, equal signals and inconsistent wires.
    """
    if len(arms) != 2:
        raise _handshake_error(
            "", f"the cell has {len(arms)} arm; a handshake connects the controllers of two"
        )
    for name in spec.signals:
        if name not in arms:
            raise _handshake_error("signals", f"the cell has no arm {name}; allowed: {', '.join(arms)}")
    signals = {
        arm: PartnerSignals(
            names.output, names.input, names.running, names.partner_running, names.move_enable
        )
        for arm in arms
        for names in [spec.signals.get(arm, SignalsFile())]
    }
    for arm, names in signals.items():
        signal_names = [*dataclasses.astuple(names), power]
        if len({word.lower() for word in signal_names}) != len(signal_names):
            text = (
                f"{', '.join(signal_names[:-1])} and {power} (the wire's power) must be "
                f"{len(signal_names)} signals"
            )
            raise _handshake_error(f"signals.{arm}", f"{text}; give them different names")
    wires = tuple(SignalWire(w.output.arm, w.output.signal, w.input.arm, w.input.signal) for w in spec.wires)
    _check_wires(wires, signals)
    are_running = [wire.output.lower() == signals[wire.source].running.lower() for wire in wires]
    meeting_wires = tuple(wire for wire, is_running in zip(wires, are_running, strict=True) if not is_running)
    watch_wires = tuple(wire for wire, is_running in zip(wires, are_running, strict=True) if is_running)
    return Handshake(
        spec.kind, spec.every, signals, meeting_wires, watch_wires, spec.timeout_s, spec.patience_s
    )


def _check_wires(wires: Sequence[SignalWire], signals: Mapping[str, PartnerSignals]) -> None:
    """Raise if stated wires are not two from each controller to the other one.

    One wire runs from output to input, the other from running output to running input.
    """
    if not wires:
        return
    first, second = signals
    required = [
        SignalWire(a, output, b, input_name)
        for a, b in ((first, second), (second, first))
        for output, input_name in (
            (signals[a].output, signals[b].input),
            (signals[a].running, signals[b].partner_running),
        )
    ]
    stated = {(w.source, w.output.lower(), w.sink, w.input.lower()) for w in wires}
    for wire in required:
        if (wire.source, wire.output.lower(), wire.sink, wire.input.lower()) not in stated:
            message = f"no wire goes from {wire.output} of {wire.source} to {wire.input} of {wire.sink}"
            raise _handshake_error(
                "wires", f"{message}; add it, correct the names of the signals, or remove wires"
            )


def _handshake_error(field: str, message: str) -> TandemError:
    path = "controller.handshake" + (f".{field}" if field else "")
    return issue_error("problem.field", message, field=path)


MAX_RAPID_NAME: Final = 32
"""Maximum length of a name in RAPID [characters]."""
MAX_SWITCHED_NAME: Final = 28
"""Maximum length of the name of a signal that programs switch [characters]."""

_COORDINATED: Final = {6: "604-1 MultiMove Coordinated", 7: "3102-1 MultiMove Coordinated"}
"""Option that one ABB controller needs to move two arms together, by RobotWare version."""


def controller_faults(cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """Return the faults of signals and options, each with its field in the problem file.

    Signals with two uses and names that are too long are ``problem.field``; missing options are
    ``post.option``.
    """
    used = [(f"operations.{index}", operation) for index, operation in enumerate(operations)]
    return [
        *_signal_faults(cell, used),
        *_number_faults(cell, used),
        *_device_bit_faults(cell, used),
        *_option_faults(cell.controller, cell, operations),
    ]


def _number_faults(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Check that signals have numbers of the arm's controller, unique among inputs and among outputs."""
    out = []
    waited_for = {name.lower() for _, operation in operations if (name := _ok_signal(operation)) is not None}
    for arm in cell.arms:
        allowed = UR_OUTPUTS if arm.data.family == "UR" else OTHER_NUMBERS
        signals = cell.controller.handshake.of(arm.name)
        has_handshake = cell.controller.sync == "handshake"
        inputs = waited_for | (
            {signals.input.lower(), signals.partner_running.lower()} if has_handshake else set()
        )
        used: dict[tuple[bool, int], str] = {}
        for name, number in cell.controller.io.get(arm.name, {}).items():
            other = used.setdefault((name.lower() in inputs, number), name)
            if other != name:
                out.append(_shared_number_issue(other, name, number, f"cell.controller.io.{arm.name}"))
            if number not in allowed:
                assignment = (
                    f"{name} is number {number} on the {arm.data.family} controller of arm {arm.name}"
                )
                text = f"{assignment}; allowed: {allowed.start} to {allowed.stop - 1}"
                field = f"cell.controller.io.{arm.name}.{name}"
                out.append(Issue("problem.field", text, field=field, hint="state its actual number"))
    return out


def _ok_signal(operation: Operation) -> str | None:
    """Return the input that an operation waits for, None if it waits for none."""
    name = getattr(operation, "ok_signal", None)
    return name if isinstance(name, str) else None


_SPINDLE_PROCESSES: Final = ("milling", "trim")
"""Processes whose signal powers a spindle, unless it lights a torch."""


def _power_consumer(operation: Operation) -> str:
    """Return the kind of tool that an operation's signal powers, for messages."""
    if lights_torch(operation):
        return "torch"
    if getattr(getattr(operation, "by", None), "kind", "") == "knife":
        return "knife"
    return "spindle" if operation.process in _SPINDLE_PROCESSES else "wire"


def _signal_faults(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Check that each name has one use. Requests of the same use may be repeated."""
    controller = cell.controller
    uses: dict[str, str] = {}
    lead_by_signal: dict[str, str] = {}
    issues: list[Issue] = []

    def use(name: str, purpose: str, field: str, max_length: int = MAX_RAPID_NAME) -> None:
        """Record a use of a signal, and add the faults of its name."""
        previous_use = uses.setdefault(name.lower(), purpose)
        if previous_use != purpose:
            text = f"{name} is used as {previous_use} and as {purpose}; a signal has one use"
            issues.append(Issue("problem.field", text, field=field, hint="give them different signals"))
        if len(name) > max_length:
            text = f"{name} has {len(name)} characters; allowed: {max_length}"
            issues.append(Issue("problem.field", text, field=field, hint="shorten the name"))
        if name.lower().startswith("tandem") or name.lower() == "answer":
            text = f"{name} is a name in the generated files, which would shadow the signal"
            issues.append(Issue("problem.field", text, field=field, hint="give the signal another name"))

    interlock, interlock_field = controller.interlock, "cell.controller.interlock"
    if controller.sync == "handshake":
        for arm in cell.arms:
            partner_signals = controller.handshake.of(arm.name)
            field = f"cell.controller.handshake.signals.{arm.name}"
            use(partner_signals.output, "an output to the other controller", field)
            use(partner_signals.input, "an input from the other controller", field)
    use(interlock.cycle, "the output that is high while a program runs", f"{interlock_field}.cycle_signal")
    use(interlock.motors, "the output that is high while motors are on", f"{interlock_field}.motors_signal")
    for field, operation in operations:
        die = getattr(operation, "die", None)
        if die is not None and getattr(die, "holder", "") == "sinking":
            use(die.signal, "the pulse of a clamp that sinks", f"{field}.die.signal", MAX_SWITCHED_NAME)
        signal = getattr(operation, "signal", None)
        if isinstance(signal, str):
            lead = next((arm.name for arm in cell.arms if arm.name in operation.arms), "")
            known_lead = lead_by_signal.setdefault(signal.lower(), lead)
            if controller.sync == "handshake" and known_lead != lead:
                text = (
                    f"{signal} powers tools of arms {known_lead} and {lead}, which have separate controllers"
                )
                hint = "use another signal for the operations of one of them"
                issues.append(Issue("problem.field", text, field=f"{field}.signal", hint=hint))
            purpose = f"the power of a {_power_consumer(operation)}"
            use(signal, purpose, f"{field}.signal", MAX_SWITCHED_NAME)
            use(
                interlock.power_output(signal).signal,
                f"the output that {signal} drives",
                f"{interlock_field}.outputs",
            )
        ok_signal = _ok_signal(operation)
        if ok_signal is not None:
            use(ok_signal, "an input that an operation waits for", f"{field}.ok_signal")
    for arm in cell.arms:
        for request, output in interlock.outputs.items():
            has_number = controller.signal_number(arm.name, request) is not None and arm.data.family != "UR"
            if has_number and controller.signal_number(arm.name, output.signal) is None:
                text = f"{output.signal} has no number on the controller of arm {arm.name}, but {request} has"
                hint = f"add it to controller: {{io: {{{arm.name}: ...}}}}"
                issues.append(
                    Issue("problem.field", text, field=f"{interlock_field}.outputs.{request}", hint=hint)
                )
    signal_by_bit: dict[tuple[str, int], str] = {}
    for request, output in interlock.outputs.items():
        key = (output.device.lower(), output.bit)
        if output.device and key in signal_by_bit:
            text = f"{signal_by_bit[key]} and {output.signal} are both bit {output.bit} of {output.device}"
            hint = "give each output its own bit (device_map)"
            issues.append(
                Issue("problem.field", text, field=f"{interlock_field}.outputs.{request}", hint=hint)
            )
        signal_by_bit[key] = output.signal
    if controller.sync == "handshake":
        issues += _running_wire_faults(cell, operations, uses)
    return issues


def _running_wire_faults(
    cell: Cell, operations: Sequence[tuple[str, Operation]], uses: Mapping[str, str]
) -> list[Issue]:
    """Check that the ends of the running wires have names of their own at their controller."""
    issues = []
    for arm in cell.arms:
        signals = cell.controller.handshake.of(arm.name)
        field = f"cell.controller.handshake.signals.{arm.name}"
        for name in (signals.running, signals.partner_running, signals.lost_input):
            if name.lower() in uses:
                text = f"{name} is used as {uses[name.lower()]} and as an end of a running wire"
                text += "; a signal has one use"
                issues.append(Issue("problem.field", text, field=field, hint="give them different signals"))
    return issues


def _device_bit_faults(cell: Cell, operations: Sequence[tuple[str, Operation]]) -> list[Issue]:
    """Check the wiring of signals of ABB controllers that power nothing.

    Each signal must exist, and no two inputs and no two outputs of a controller may share a bit.
    """
    controller = cell.controller
    issues: list[Issue] = []
    is_separate = controller.sync == "handshake"
    signal_by_bit: dict[tuple[str, bool, str, int], str] = {}  # by controller, whether input, device and bit
    arm_names = [arm.name for arm in cell.arms]
    signals: dict[str, list[str]] = {}
    inputs_by_arm: dict[str, set[str]] = {}
    for arm in cell.arms:
        if arm.data.family != "ABB":
            continue
        partner_signals = controller.handshake.of(arm.name)
        outputs: list[str] = []
        inputs: list[str] = []
        if controller.sync == "handshake":
            outputs = [partner_signals.running, partner_signals.output]
            inputs = [partner_signals.partner_running, partner_signals.input]
        for _, operation in operations:
            power = getattr(operation, "signal", None)
            if isinstance(power, str) and arm.name == next((n for n in arm_names if n in operation.arms), ""):
                power_output = controller.interlock.power_output(power)
                if power_output.device:
                    signal_by_bit[
                        arm.name if is_separate else "", False, power_output.device.lower(), power_output.bit
                    ] = power_output.signal
            if arm.name in operation.arms or controller.sync != "handshake":
                ok_signal = _ok_signal(operation)
                if ok_signal is not None:
                    inputs.append(ok_signal)
                die = getattr(operation, "die", None)
                if die is not None and getattr(die, "holder", "") == "sinking":
                    outputs.append(die.signal)
        signals[arm.name] = list(dict.fromkeys([*outputs, *inputs]))
        inputs_by_arm[arm.name] = {name.lower() for name in inputs}
    signals = {name: names for name, names in signals.items() if names}
    for arm_name, device_bits in controller.interlock.device_bits.items():
        known_names = [name.lower() for name in signals.get(arm_name, [])]
        for signal, device_bit in device_bits.items():
            is_input = signal.lower() in inputs_by_arm.get(arm_name, set())
            other = signal_by_bit.setdefault(
                (arm_name if is_separate else "", is_input, device_bit.device.lower(), device_bit.bit), signal
            )
            if other.lower() != signal.lower():
                text = f"{other} and {signal} are both bit {device_bit.bit} of {device_bit.device}"
                field = f"cell.controller.interlock.places.{arm_name}"
                hint = f"give each {'input' if is_input else 'output'} its own bit (device_map)"
                issues.append(Issue("problem.field", text, field=field, hint=hint))
            if signal.lower() not in known_names:
                text = (
                    f"arm {arm_name} has no signal {signal} at an ABB controller that does not switch power"
                )
                allowed = (
                    "; ".join(f"{name}: {', '.join(names)}" for name, names in signals.items()) or "none"
                )
                field = f"cell.controller.interlock.places.{arm_name}"
                issues.append(
                    Issue("problem.field", f"{text}; allowed: {allowed}", field=field, hint="remove it")
                )
    return issues


def _option_faults(controller: Controller, cell: Cell, operations: Sequence[Operation]) -> list[Issue]:
    """Check that one ABB controller with two arms has MultiMove.

    A cell without stated options is not checked.
    """
    arms = {arm for operation in operations for arm in operation.arms}
    moved_arms = [arm for arm in cell.arms if arm.name in arms and arm.data.family == "ABB"]
    if controller.options is None or controller.sync == "handshake" or len(moved_arms) < 2:
        return []
    required = _COORDINATED[controller.robotware]
    if any(option.split()[:1] == required.split()[:1] for option in controller.options):
        return []
    text = format_message("post.option", required_option=required, listed_options=_listed_options(controller))
    hint = "install the option, or use two controllers that share signals (sync: handshake)"
    return [Issue("post.option", text, field="cell.controller.options", hint=hint)]


def _listed_options(controller: Controller) -> str:
    return ", ".join(controller.options or ()) or "none"
