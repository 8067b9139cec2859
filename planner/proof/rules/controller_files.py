"""Rules on what controllers need besides the motion: their files, and the check of the cell.

verify.controller_files: files that switch power off and on again, and signals by which two controllers
watch each other. verify.cell_check: the part of a program that compares the cell with the plan before it
moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath

from planner.claims.claim import powers
from planner.issues import Issue
from planner.languages.krl.reader.lines import krl_lines
from planner.languages.krl.rules import power_at_stops as krl_power_at_stops
from planner.languages.rapid.reader.configuration import (
    Row,
    UnreadError,
    configuration,
    crossed,
    rapid_signals,
    rapid_words,
)
from planner.languages.rapid.rules import power_at_stops
from planner.languages.rapid.rules.cell_check import check_faults
from planner.languages.rapid.rules.power_at_stops import POWER_MODULE, config_row
from planner.languages.urscript.rules.robot_check import robot_check_faults
from planner.problem import Controller
from planner.programs.job import controllers
from planner.programs.stages import CONTROLLER, TaskText
from planner.programs.steps import SignalStep
from planner.programs.text import Partner, strange
from planner.proof.context import Context
from planner.proof.rule import Outcome, at_step, rule

CONTROLLER_FILES = "verify.controller_files"
"""Code of the rule about files for the controllers."""
_COPY_HINT = "plan again, and copy all files as they are"
"""What to do about any of its faults."""


@rule("verify.controller_files")
def controller_files(context: Context) -> Outcome:
    """Power hangs on more than the program: files for each controller let its output fall at every stop, take
    the request back, and ask before an arm moves on in a cut; where a torch burned nothing goes on, nor is it
    set on again, until the program begins anew. Of two controllers each says that it runs, and the other
    one's stop stops it and takes its power. They declare every signal that the programs name, with the type
    of its use, fit the program, and none is left over."""
    controller = context.problem.cell.controller
    there: dict[str, dict[str, str]] = {}
    issues = _one_file(context.programs)
    for path, text in context.programs.items():
        parts = PurePosixPath(path).parts
        if parts[0].lower() == CONTROLLER:
            folder = "/".join(parts[1:-1])
            there.setdefault(folder, {})[parts[-1]] = text
    count = 0
    burning = {power.signal.lower() for power in powers(context.claims) if power.burns}
    joined = controller.sync == "handshake" and len(context.job.tasks) > 1
    for folder, tasks, signals in _powered(context, joined):
        files = there.pop(folder, {})
        count += len(signals)
        partner = Partner(controller, tasks[0].arm.name) if joined else None
        lit = frozenset(signal for signal in signals if signal.lower() in burning)
        if tasks[0].text.language != "krl":
            names = [controller.tasks[_place(context, task)] for task in tasks]
            others = _others(controller, tasks, signals, partner)
            faults = _abb(controller, names, signals, lit, others, files, partner)
        else:
            faults = _kuka(controller, tasks[0].arm.name, signals, lit, files, partner)
        faults += [f"{name}: {fault.message}" for name in files for fault in strange(name, files[name])]
        issues += [
            Issue(
                CONTROLLER_FILES,
                f"{CONTROLLER}/{folder}: {fault}",
                file=f"{CONTROLLER}/{folder}",
                hint=_COPY_HINT,
            )
            for fault in faults
        ]
    for folder in there:
        what = f"{CONTROLLER}/{folder} holds files of another job: no program here needs them"
        issues.append(Issue(CONTROLLER_FILES, what, file=f"{CONTROLLER}/{folder}", hint="take them away"))
    return Outcome(
        tuple(issues), nothing="" if count else "nothing is powered" if not joined else "wires only"
    )


def _one_file(paths: Iterable[str]) -> list[Issue]:
    """Files that are one where case does not count, as on a controller: either may be loaded."""
    seen: dict[str, str] = {}
    issues = []
    for path in paths:
        other = seen.setdefault(path.lower(), path)
        first = PurePosixPath(path).parts[0]
        if other != path:
            what = f"{path} and {other} are one file where case does not count"
        elif first.lower() == CONTROLLER and first != CONTROLLER:
            what = f"{path} is in a folder that is to be called {CONTROLLER}"
        else:
            continue
        issues.append(Issue(CONTROLLER_FILES, what, file=path, hint="take it away, or " + _COPY_HINT))
    return issues


def _place(context: Context, task: TaskText) -> int:
    return [arm.name for arm in context.problem.cell.arms].index(task.arm.name)


def _powered(context: Context, joined: bool) -> list[tuple[str, tuple[TaskText, ...], list[str]]]:
    """Folder, tasks and signals of each controller whose tasks switch something on, without the clamps of
    sheets, which are moved by pulses; of all controllers where two are ``joined``."""
    pulsed = {power.signal.lower() for power in powers(context.claims) if power.pulsed}
    alone = context.problem.cell.controller.sync == "handshake"
    out: list[tuple[str, tuple[TaskText, ...], list[str]]] = []
    for tasks in controllers(context.problem, context.job.tasks):
        if tasks[0].text.language in ("urscript", "trajectories"):
            continue  # these take no files: an installation is set at the panel, a runner by its cell
        steps = [step for task in tasks for step in task.steps if isinstance(step, SignalStep)]
        own = context.problem.cell.controller.handshake.of(tasks[0].arm.name).output.lower()
        aside = pulsed | ({own} if alone else set())
        on = {step.signal.lower(): step.signal for step in steps if step.value}
        signals = [name for key, name in sorted(on.items()) if key not in aside]
        if signals or joined:
            out.append((tasks[0].name, tasks, signals))
    return out


def _names(files: Mapping[str, str], wanted: Sequence[str]) -> list[str]:
    lost = [f"{name} is missing" for name in wanted if name not in files]
    return lost + [f"{name} belongs to nothing" for name in files if name not in (*wanted, "README.txt")]


# ---- ABB ----


def _abb(
    controller: Controller,
    tasks: Sequence[str],
    signals: Sequence[str],
    lit: frozenset[str],
    others: Sequence[Row],
    files: Mapping[str, str],
    partner: Partner | None,
) -> list[str]:
    module = f"{POWER_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"
    wanted = {"EIO": _signals(controller, signals, lit, others, partner)} | (
        {"SYS": power_at_stops.hooks(tasks, module, lit)} if signals else {}
    )
    faults = _names(files, [f"{name}.cfg" for name in wanted] + ([module] if signals else []))
    if faults:
        return faults
    for name, rows in wanted.items():
        try:
            head, got = configuration(files[f"{name}.cfg"])
        except UnreadError as wrong:
            faults.append(f"{name}.cfg cannot be read: {wrong}")
            continue
        if not re.fullmatch(rf"{name}:CFG_1\.0:{controller.robotware}:[01]::", head):
            faults.append(f"{name}.cfg is not for RobotWare {controller.robotware}: {head[:40]!r}")
        if name == "EIO":
            faults += _crosses(controller, signals, partner, got.pop("EIO_CROSS", []))
            faults += _shared_bits(got.get("EIO_SIGNAL", []))
        faults += [fault for kind in {**rows, **got} for fault in _rows(name, kind, rows, got)]
    due = power_at_stops.routines(controller, signals, lit, len(tasks) > 1)
    if signals and rapid_words(files[module]) != rapid_words(due):
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


# ---- KUKA ----


def _kuka(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    lit: frozenset[str],
    files: Mapping[str, str],
    partner: Partner | None,
) -> list[str]:
    runs = "$PRO_ACT AND $PERI_RDY"
    watched, known = (partner.watched(runs), [partner.seen]) if partner else ([], [])
    runs += f" AND {partner.input}" if partner else ""
    flags, submit, stopped = krl_power_at_stops.krl_files(controller, arm, signals, lit, runs)
    declared = [f"DECL BOOL {name}=FALSE" for name in [*flags, *known]]
    wanted = {"config_user.dat": declared, "sps_user.sub": [*watched, *submit]}
    if signals:
        wanted["ir_stopm_user.src"] = stopped
    faults = _names(files, tuple(wanted))
    if faults:
        return faults
    for name, lines in wanted.items():
        got, want = krl_lines(files[name]), krl_lines("\n".join(lines))
        if got != want:
            at = next((i for i, (g, w) in enumerate(zip(got, want, strict=False)) if g != w), None)
            place = min(len(got), len(want)) if at is None else at
            here, there = (rows[place] if place < len(rows) else "the end" for rows in (got, want))
            faults.append(f"{name} does not do what it is to: {here!r} stands where {there!r} is to be")
    return faults


CELL_CHECK = "verify.cell_check"
"""Code of the rule about the comparison of the cell with the plan."""


@rule("verify.cell_check")
def cell_check(context: Context) -> Outcome:
    """Before anything else each RAPID program compares base frame, tools and work objects with what was
    planned, and stops for good over 0.1 mm or 0.02 degrees; so does what looks where tracks and turntables
    are, over 1 mm or 0.1 degrees; one of URScript ends unless its controller has
    the flange, at home, where the plan has it within 10 mm."""
    issues: list[Issue] = []
    for task in context.job.tasks:
        if task.text.language == "urscript":
            issues += [at_step(CELL_CHECK, fault, task, step) for step, fault in robot_check_faults(task)]
        if task.text.language == "rapid":
            issues += [
                Issue(CELL_CHECK, fault, arm=task.arm.name, file=file, hint="plan again; copy all modules")
                for file, fault in check_faults(context, task)
            ]
    return Outcome(tuple(issues))
