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
    """Return the faults of the files of one ABB controller: EIO.cfg, SYS.cfg and the module TandemPower.

    Rows of the configuration may be in any order, but none may be missing, added or repeated. Cross
    connections may have their terms in any order. The module must have its expected tokens. SYS.cfg and the
    module exist only if the programs switch power outputs.
    """
    cell = power.context.problem.cell
    controller, signals = cell.controller, power.signals
    torches, partner = power.burning, power.partner
    arms = [arm.name for arm in cell.arms]
    task_names = [controller.tasks[arms.index(task.arm.name)] for task in power.tasks]
    module = f"{POWER_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"
    others = _other_rows(controller, power.tasks, signals, partner)
    expected = {"EIO": _expected_rows(controller, signals, torches, others, partner)} | (
        {"SYS": power_at_stops.hook_rows(task_names, module, torches)} if signals else {}
    )
    faults = power.file_name_faults([f"{name}.cfg" for name in expected] + ([module] if signals else []))
    if faults:
        return faults
    for name, rows in expected.items():
        try:
            head, actual = parse_configuration(power.files[f"{name}.cfg"])
        except ConfigurationSyntaxError as wrong:
            faults.append(f"{name}.cfg cannot be read: {wrong}")
            continue
        if not re.fullmatch(rf"{name}:CFG_1\.0:{controller.robotware}:[01]::", head):
            faults.append(f"{name}.cfg is not for RobotWare {controller.robotware}: {head[:40]!r}")
        if name == "EIO":
            faults += _cross_connection_faults(controller, signals, partner, actual.pop("EIO_CROSS", []))
            faults += _shared_bit_faults(actual.get("EIO_SIGNAL", []))
        faults += [fault for kind in {**rows, **actual} for fault in _row_faults(name, kind, rows, actual)]
    expected_module = power_at_stops.system_module(controller, signals, torches, len(task_names) > 1)
    if signals and rapid_words(power.files[module]) != rapid_words(expected_module):
        purpose = "reset requests at a stop, " + (
            "never resume after a torch burned" if torches else "ask at a start"
        )
        faults.append(f"{module} differs from its expected text. It must do this: {purpose}")
    return faults


def _row_faults(
    name: str,
    kind: str,
    expected: Mapping[str, Sequence[InstanceRow]],
    actual: Mapping[str, Sequence[InstanceRow]],
) -> list[str]:
    """Return faults of the rows of one type in a configuration file: missing, unexpected or repeated rows.

    ``name`` is the name of the file without suffix, and ``kind`` the type of the rows, as EIO_SIGNAL.
    ``expected`` and ``actual`` have the rows of all types in the file, by type.
    """
    expected_rows, actual_rows = expected.get(kind, ()), actual.get(kind, ())
    faults = [
        f"{name}.cfg, {kind}: the row {_row_text(row)} is missing"
        for row in expected_rows
        if row not in actual_rows
    ]
    faults += [
        f"{name}.cfg, {kind}: the row {_row_text(row)} is not expected"
        for row in actual_rows
        if row not in expected_rows
    ]
    if not faults and len(actual_rows) != len(expected_rows):
        faults.append(f"{name}.cfg, {kind}: a row occurs twice")
    return faults


def _shared_bit_faults(rows: Sequence[InstanceRow]) -> list[str]:
    """Return a fault for each bit of a device that two signals of one type share.

    One of them would switch what the other powers.
    """
    signal_by_bit: dict[tuple[str, ...], str] = {}
    faults = []
    for row in rows:
        fields = dict(row)
        if "device" in fields:
            key = tuple(fields.get(field, "").lower() for field in ("signaltype", "device", "devicemap"))
            name = fields.get("name", "")
            other = signal_by_bit.setdefault(key, name)
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
    """Return the expected rows of signals other than power outputs and partner signals.

    These are the other signals that the programs name. Each row has the type (DI or DO) that the use of the
    signal requires, and the device and bit that the cell states for it, if any. Without a row the programs
    would not load.
    """
    power_names = (
        name for signal in signals for name in (signal, controller.interlock.power_output(signal).signal)
    )
    listed_elsewhere = {(name.lower(), "DO") for name in power_names}
    if partner:
        listed_elsewhere |= {(row["name"].lower(), row["signaltype"]) for row in partner.signals}
    rows: dict[tuple[str, str], InstanceRow] = {}
    for name, kind in rapid_signals("\n".join(text for task in tasks for text in task.files.values())):
        if (name.lower(), kind) in listed_elsewhere:
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
    """Return the expected rows of EIO.cfg by type, without cross connections.

    A request is a signal on no device. The program sets it, and so may the operator if it lights no torch.
    Nobody sets the real outputs by hand: a cross connection drives them. ``other_rows`` are those of other
    signals that the programs name, because programs do not load without them.
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
    """Return the faults of the cross connections.

    Each power output follows the term: request AND program running AND motors on. With two controllers, AND
    partner running is added. Each controller then also reports its own state, and inverts the state that it
    receives from the other one. No other cross connection is allowed. ``rows`` are those of EIO_CROSS.
    """
    interlock = controller.interlock
    running = (interlock.cycle, interlock.motors)
    enabling = (*running, partner.partner_running) if partner else running
    terms_by_result: dict[str, tuple[str, ...]] = {
        interlock.power_output(request).signal: (request, *enabling) for request in signals
    }
    if partner:
        terms_by_result |= {partner.running: running, partner.lost: (f"not {partner.partner_running}",)}
    expected = {
        (result.lower(), frozenset(map(str.lower, terms))) for result, terms in terms_by_result.items()
    }
    expected_texts = {result.lower(): " AND ".join(terms) for result, terms in terms_by_result.items()}
    connections = [cross_connection(row) for row in rows]
    faults = []
    for row, connection in zip(rows, connections, strict=True):
        if connection not in expected:
            expected_text = expected_texts.get(dict(row).get("res", "").lower())
            problem = (
                f"is not {expected_text}"
                if expected_text
                else "drives a signal that no cross connection may drive"
            )
            faults.append(f"EIO.cfg, EIO_CROSS: {_row_text(row)} {problem}")
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
