"""Checks files of ABB controllers: signals, cross connections, system events and the module TandemPower."""

import re
from collections.abc import Mapping, Sequence

from planner.languages.rapid.reader.configuration import (
    ConfigurationSyntaxError,
    InstanceRow,
    cross_connection,
    parse_configuration,
    rapid_signals,
    rapid_words,
)
from planner.languages.rapid.rules import power_at_stops
from planner.languages.rapid.rules.power_at_stops import POWER_MODULE, config_row
from planner.problem import Controller
from planner.programs.stages import TaskText
from planner.programs.text import ControllerPartner
from planner.proof.language_contribution import ControllerPower


def controller_files(power: ControllerPower) -> list[str]:
    """Return the faults of the files of an ABB controller."""
    cell = power.context.problem.cell
    controller, signals, torches, partner = cell.controller, power.signals, power.burning, power.partner
    arms = [arm.name for arm in cell.arms]
    names = [controller.tasks[arms.index(task.arm.name)] for task in power.tasks]
    module = f"{POWER_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"
    others = _other_rows(controller, power.tasks, signals, partner)
    expected = {"EIO": _expected_rows(controller, signals, torches, others, partner)} | (
        {"SYS": power_at_stops.hook_rows(names, module, torches)} if signals else {}
    )
    faults = power.file_name_faults([f"{name}.cfg" for name in expected] + ([module] if signals else []))
    if faults:
        return faults
    for name, rows in expected.items():
        try:
            head, got = parse_configuration(power.files[f"{name}.cfg"])
        except ConfigurationSyntaxError as wrong:
            faults.append(f"{name}.cfg cannot be read: {wrong}")
            continue
        if not re.fullmatch(rf"{name}:CFG_1\.0:{controller.robotware}:[01]::", head):
            faults.append(f"{name}.cfg is not for RobotWare {controller.robotware}: {head[:40]!r}")
        if name == "EIO":
            faults += _cross_connection_faults(controller, signals, partner, got.pop("EIO_CROSS", []))
            faults += _shared_bit_faults(got.get("EIO_SIGNAL", []))
        faults += [fault for kind in {**rows, **got} for fault in _row_faults(name, kind, rows, got)]
    expected_module = power_at_stops.system_module(controller, signals, torches, len(names) > 1)
    if signals and rapid_words(power.files[module]) != rapid_words(expected_module):
        what = "reset requests at a stop, " + (
            "never resume after a torch burned" if torches else "ask at a start"
        )
        faults.append(f"{module} differs from its expected text. It must do this: {what}")
    return faults


def _row_faults(
    name: str,
    kind: str,
    expected: Mapping[str, Sequence[InstanceRow]],
    actual: Mapping[str, Sequence[InstanceRow]],
) -> list[str]:
    want, have = expected.get(kind, ()), actual.get(kind, ())
    faults = [f"{name}.cfg, {kind}: the row {_row_text(row)} is missing" for row in want if row not in have]
    faults += [
        f"{name}.cfg, {kind}: the row {_row_text(row)} is not expected" for row in have if row not in want
    ]
    if not faults and len(have) != len(want):
        faults.append(f"{name}.cfg, {kind}: a row occurs twice")
    return faults


def _shared_bit_faults(rows: Sequence[InstanceRow]) -> list[str]:
    """Faults for two signals of one type on one bit of a device: one switches what the other powers."""
    names: dict[tuple[str, ...], str] = {}
    faults = []
    for row in rows:
        fields = dict(row)
        if "device" in fields:
            key = tuple(fields.get(name, "").lower() for name in ("signaltype", "device", "devicemap"))
            name = fields.get("name", "")
            other = names.setdefault(key, name)
            if other != name:
                faults.append(f"EIO.cfg, EIO_SIGNAL: {other} and {name} share bit {key[2]} of one device")
    return faults


def _row_text(row: InstanceRow) -> str:
    return " ".join(f"-{key} {value}".strip() for key, value in sorted(row))


def _other_rows(
    controller: Controller,
    tasks: Sequence[TaskText],
    signals: Sequence[str],
    partner: ControllerPartner | None,
) -> list[InstanceRow]:
    """Expected rows of all other signals that the programs name.

    Each has the type that its use requires, and the device that the cell states for it.
    """
    power_names = (
        name for signal in signals for name in (signal, controller.interlock.power_output(signal).signal)
    )
    known = {(name.lower(), "DO") for name in power_names}
    known |= {(row["name"].lower(), row["signaltype"]) for row in partner.signals} if partner else set()
    rows: dict[tuple[str, str], InstanceRow] = {}
    for name, kind in rapid_signals("\n".join(text for task in tasks for text in task.files.values())):
        if (name.lower(), kind) in known:
            continue
        connections = (controller.interlock.device_bit(task.arm.name, name) for task in tasks)
        connection = next((connection for connection in connections if connection is not None), None)
        wired = {"device": connection.device, "devicemap": str(connection.bit)} if connection else {}
        rows[name.lower(), kind] = config_row(name=name, signaltype=kind, **wired)
    return list(rows.values())


def _expected_rows(
    controller: Controller,
    signals: Sequence[str],
    torches: frozenset[str],
    other_rows: Sequence[InstanceRow],
    partner: ControllerPartner | None,
) -> dict[str, list[InstanceRow]]:
    """Expected rows of EIO.cfg by type, without cross connections.

    Requests are on no device: program and operator set them, and only the program those of torches. Nobody
    sets the real outputs by hand. The other signals that the programs name are included, because programs do
    not load without them.
    """
    interlock = controller.interlock
    rows = power_at_stops.request_rows(signals, torches)
    for request in signals:
        output = interlock.power_output(request)
        wired = {"device": output.device, "devicemap": str(output.bit)} if output.device else {}
        rows.append(config_row(name=output.signal, signaltype="DO", access="ReadOnly", **wired))
    rows += [
        config_row(name=name, signaltype="DO", access="ReadOnly")
        for name in (interlock.cycle, interlock.motors)
    ]
    expected = {
        "EIO_SIGNAL": [
            *rows,
            *other_rows,
            *(config_row(**values) for values in (partner.signals if partner else ())),
        ],
        "SYSSIG_OUT": [
            config_row(status="CycleOn", signal=interlock.cycle),
            config_row(status="MotOnState", signal=interlock.motors),
        ],
    }
    if signals:
        expected["EIO_ACCESS"] = power_at_stops.access_rows(signals, torches)
    if partner:
        expected["SYSSIG_IN"] = [config_row(signal=partner.lost, action="Stop")]
    return expected


def _cross_connection_faults(
    controller: Controller,
    signals: Sequence[str],
    partner: ControllerPartner | None,
    rows: Sequence[InstanceRow],
) -> list[str]:
    """Faults of the cross connections.

    Each power output is request AND running program AND motors on AND partner running. With two controllers
    each reports its own state and receives that of the other one. Nothing else is connected.
    """
    interlock = controller.interlock
    runs = (interlock.cycle, interlock.motors)
    needed = (*runs, partner.partner_running) if partner else runs
    terms: dict[str, tuple[str, ...]] = {
        interlock.power_output(request).signal: (request, *needed) for request in signals
    }
    if partner:
        terms |= {partner.running: runs, partner.lost: (f"not {partner.partner_running}",)}
    expected = {(result.lower(), frozenset(map(str.lower, needs))) for result, needs in terms.items()}
    expected_texts = {result.lower(): " AND ".join(needs) for result, needs in terms.items()}
    connections = [cross_connection(row) for row in rows]
    faults = []
    for row, read in zip(rows, connections, strict=True):
        if read not in expected:
            expected_text = expected_texts.get(dict(row).get("res", "").lower())
            wrong = (
                f"is not {expected_text}"
                if expected_text
                else "drives a signal that no cross connection may drive"
            )
            faults.append(f"EIO.cfg, EIO_CROSS: {_row_text(row)} {wrong}")
    if len(set(connections)) != len(connections):
        faults.append("EIO.cfg, EIO_CROSS: an output is driven twice")
    names = [value for row in rows for key, value in row if key == "name"]
    if len(set(names)) != len(rows):
        faults.append("EIO.cfg, EIO_CROSS: the names of cross connections must differ")
    faults += [
        f"EIO.cfg, EIO_CROSS: nothing drives {result}"
        for result, _ in expected - set(filter(None, connections))
    ]
    return faults
