"""The files of ABB controllers: signals, cross connections, system events and the module TandemPower."""

import re
from collections.abc import Mapping, Sequence

from planner.languages.rapid.reader.configuration import (
    Row,
    UnreadError,
    configuration,
    crossed,
    rapid_signals,
    rapid_words,
)
from planner.languages.rapid.rules import power_at_stops
from planner.languages.rapid.rules.power_at_stops import POWER_MODULE, config_row
from planner.problem import Controller
from planner.programs.stages import TaskText
from planner.programs.text import Partner
from planner.proof.language_contribution import ControllerPower


def controller_files(power: ControllerPower) -> list[str]:
    """Return the faults of the files of an ABB controller."""
    cell = power.context.problem.cell
    controller, signals, lit, partner = cell.controller, power.signals, power.burning, power.partner
    arms = [arm.name for arm in cell.arms]
    names = [controller.tasks[arms.index(task.arm.name)] for task in power.tasks]
    module = f"{POWER_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"
    others = _others(controller, power.tasks, signals, partner)
    wanted = {"EIO": _signals(controller, signals, lit, others, partner)} | (
        {"SYS": power_at_stops.hooks(names, module, lit)} if signals else {}
    )
    faults = power.misnamed([f"{name}.cfg" for name in wanted] + ([module] if signals else []))
    if faults:
        return faults
    for name, rows in wanted.items():
        try:
            head, got = configuration(power.files[f"{name}.cfg"])
        except UnreadError as wrong:
            faults.append(f"{name}.cfg cannot be read: {wrong}")
            continue
        if not re.fullmatch(rf"{name}:CFG_1\.0:{controller.robotware}:[01]::", head):
            faults.append(f"{name}.cfg is not for RobotWare {controller.robotware}: {head[:40]!r}")
        if name == "EIO":
            faults += _crosses(controller, signals, partner, got.pop("EIO_CROSS", []))
            faults += _shared_bits(got.get("EIO_SIGNAL", []))
        faults += [fault for kind in {**rows, **got} for fault in _rows(name, kind, rows, got)]
    due = power_at_stops.routines(controller, signals, lit, len(names) > 1)
    if signals and rapid_words(power.files[module]) != rapid_words(due):
        what = "request back at a stop, " + (
            "no way on where a torch burned" if lit else "question at a start"
        )
        faults.append(f"{module} does not do what it is to: {what}")
    return faults


def _rows(
    name: str, kind: str, wanted: Mapping[str, Sequence[Row]], got: Mapping[str, Sequence[Row]]
) -> list[str]:
    want, have = wanted.get(kind, ()), got.get(kind, ())
    faults = [f"{name}.cfg, {kind}: there is no {_shown_row(row)}" for row in want if row not in have]
    faults += [
        f"{name}.cfg, {kind}: {_shown_row(row)} is not as it should be" for row in have if row not in want
    ]
    if not faults and len(have) != len(want):
        faults.append(f"{name}.cfg, {kind}: a row stands there twice")
    return faults


def _shared_bits(rows: Sequence[Row]) -> list[str]:
    """Signals of one type on one bit of a device: one of them would switch what the other one powers."""
    names: dict[tuple[str, ...], str] = {}
    faults = []
    for row in rows:
        fields = dict(row)
        if "device" in fields:
            key = tuple(fields.get(name, "").lower() for name in ("signaltype", "device", "devicemap"))
            name = fields.get("name", "")
            other = names.setdefault(key, name)
            if other != name:
                faults.append(f"EIO.cfg, EIO_SIGNAL: {other} and {name} are bit {key[2]} of one device")
    return faults


def _shown_row(row: Row) -> str:
    return " ".join(f"-{key} {value}".strip() for key, value in sorted(row))


def _others(
    controller: Controller, tasks: Sequence[TaskText], signals: Sequence[str], partner: Partner | None
) -> list[Row]:
    """Rows of all other signals that the text of the programs names, each of the type that its use asks for,
    on the device that the cell states for it."""
    powers = (name for one in signals for name in (one, controller.interlock.of(one).signal))
    known = {(name.lower(), "DO") for name in powers}
    known |= {(row["name"].lower(), row["signaltype"]) for row in partner.signals} if partner else set()
    rows: dict[tuple[str, str], Row] = {}
    for name, kind in rapid_signals("\n".join(text for task in tasks for text in task.files.values())):
        if (name.lower(), kind) in known:
            continue
        places = (controller.interlock.place(task.arm.name, name) for task in tasks)
        place = next((place for place in places if place is not None), None)
        wired = {"device": place.device, "devicemap": str(place.bit)} if place else {}
        rows[name.lower(), kind] = config_row(name=name, signaltype=kind, **wired)
    return list(rows.values())


def _signals(
    controller: Controller,
    signals: Sequence[str],
    lit: frozenset[str],
    others: Sequence[Row],
    partner: Partner | None,
) -> dict[str, list[Row]]:
    """Requests that nothing but program and operator set, of torches the program alone, on no device; outputs
    that nobody sets by hand; and the other signals that the programs name, without which they do not load."""
    lock = controller.interlock
    rows = power_at_stops.requests(signals, lit)
    for request in signals:
        real = lock.of(request)
        wired = {"device": real.device, "devicemap": str(real.bit)} if real.device else {}
        rows.append(config_row(name=real.signal, signaltype="DO", access="ReadOnly", **wired))
    rows += [config_row(name=name, signaltype="DO", access="ReadOnly") for name in (lock.cycle, lock.motors)]
    wanted = {
        "EIO_SIGNAL": [
            *rows,
            *others,
            *(config_row(**values) for values in (partner.signals if partner else ())),
        ],
        "SYSSIG_OUT": [
            config_row(status="CycleOn", signal=lock.cycle),
            config_row(status="MotOnState", signal=lock.motors),
        ],
    }
    if signals:
        wanted["EIO_ACCESS"] = power_at_stops.access(signals, lit)
    if partner:
        wanted["SYSSIG_IN"] = [config_row(signal=partner.lost, action="Stop")]
    return wanted


def _crosses(
    controller: Controller, signals: Sequence[str], partner: Partner | None, rows: Sequence[Row]
) -> list[str]:
    """Each power output is the request AND a running program AND motors that are on AND a partner that runs;
    of two controllers each says so of itself, and hears it of the other one; nothing else is there."""
    lock = controller.interlock
    runs = (lock.cycle, lock.motors)
    needed = (*runs, partner.given) if partner else runs
    terms: dict[str, tuple[str, ...]] = {lock.of(request).signal: (request, *needed) for request in signals}
    if partner:
        terms |= {partner.running: runs, partner.lost: (f"not {partner.given}",)}
    wanted = {(result.lower(), frozenset(map(str.lower, needs))) for result, needs in terms.items()}
    called = {result.lower(): " AND ".join(needs) for result, needs in terms.items()}
    got = [crossed(row) for row in rows]
    faults = []
    for row, read in zip(rows, got, strict=True):
        if read not in wanted:
            to_be = called.get(dict(row).get("res", "").lower())
            wrong = f"is not {to_be}" if to_be else "drives what no cross connection is to drive"
            faults.append(f"EIO.cfg, EIO_CROSS: {_shown_row(row)} {wrong}")
    if len(set(got)) != len(got):
        faults.append("EIO.cfg, EIO_CROSS: an output is driven twice")
    names = [value for row in rows for key, value in row if key == "name"]
    if len(set(names)) != len(rows):
        faults.append("EIO.cfg, EIO_CROSS: cross connections need names that differ")
    faults += [
        f"EIO.cfg, EIO_CROSS: nothing drives {result}" for result, _ in wanted - set(filter(None, got))
    ]
    return faults
