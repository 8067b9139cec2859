"""The rule on files for controllers: what power hangs on besides the program, who gives it back, and how two
controllers know of each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from planner import controller_texts as said
from planner.claims_forming import SinksHolder
from planner.issues import Issue
from planner.problem import Controller
from planner.verify.context import Context, Outcome
from planner.verify.controller_running import Partner
from planner.verify.controller_text import Row, UnreadError, configuration, crossed, krl_lines, rapid_words
from planner.verify.job import CONTROLLER, TaskText
from planner.verify.program_text import strange
from planner.verify.steps import SignalStep

CODE = "verify.controller_files"
_HINT = "plan again, and copy all files as they are"
_MODULE = "TandemPower"
_SHELVES = {"stop": "off", "qstop": "off", "reset": "off", "start": "on", "restart": "on", "step": "on"}


def controller_files(context: Context) -> Outcome:
    """Power hangs on more than the program: files for each controller let its output fall at every stop, take
    the request back, and ask before an arm moves on in a cut; of two controllers each says that it runs, and
    the other one's stop stops it and takes its power. They fit the program, and none is left over."""
    controller = context.problem.cell.controller
    there: dict[str, dict[str, str]] = {}
    for path, text in context.programs.items():
        parts = PurePosixPath(path).parts
        if parts[0].lower() == CONTROLLER:
            folder = "/".join(parts[1:-1])
            there.setdefault(folder, {})[parts[-1]] = text
    issues: list[Issue] = []
    count = 0
    joined = controller.sync == "handshake" and len(context.job.tasks) > 1
    for folder, tasks, signals in _powered(context, joined):
        files = there.pop(folder, {})
        count += len(signals)
        partner = Partner(controller, tasks[0].arm.name) if joined else None
        if tasks[0].krl is None:
            names = [controller.tasks[_place(context, task)] for task in tasks]
            faults = _abb(controller, names, signals, files, partner)
        else:
            faults = _kuka(controller, tasks[0].arm.name, signals, files, partner)
        faults += [f"{name}: {fault.message}" for name in files for fault in strange(name, files[name])]
        issues += [
            Issue(CODE, f"{CONTROLLER}/{folder}: {fault}", file=f"{CONTROLLER}/{folder}", hint=_HINT)
            for fault in faults
        ]
    for folder in there:
        what = f"{CONTROLLER}/{folder} holds files of another job: no program here needs them"
        issues.append(Issue(CODE, what, file=f"{CONTROLLER}/{folder}", hint="take them away"))
    return Outcome(tuple(issues), where="" if count else "nothing is powered" if not joined else "wires only")


def _place(context: Context, task: TaskText) -> int:
    return [arm.name for arm in context.problem.cell.arms].index(task.arm.name)


def _powered(context: Context, joined: bool) -> list[tuple[str, list[TaskText], list[str]]]:
    """Folder, tasks and signals of each controller whose tasks switch something on, without the clamps of
    sheets, which are moved by pulses; of all controllers where two are ``joined``."""
    pulsed = {claim.signal.lower() for claim in context.claims if isinstance(claim, SinksHolder)}
    alone = context.problem.cell.controller.sync == "handshake"
    groups: list[list[TaskText]] = []
    for task in context.job.tasks:
        if alone or task.krl is not None or not groups or groups[-1][0].krl is not None:
            groups.append([task])
        else:
            groups[-1].append(task)
    out = []
    for tasks in groups:
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
    files: Mapping[str, str],
    partner: Partner | None,
) -> list[str]:
    module = f"{_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"
    wanted = {"EIO": _signals(controller, signals, partner)} | (
        {"SYS": _hooks(tasks, module)} if signals else {}
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
        if not head.startswith(f"{name}:CFG_1.0:{controller.robotware}:"):
            faults.append(f"{name}.cfg is not for RobotWare {controller.robotware}: {head[:40]!r}")
        if name == "EIO":
            faults += _crosses(controller, signals, partner, got.pop("EIO_CROSS", []))
        faults += [fault for kind in {**rows, **got} for fault in _rows(name, kind, rows, got)]
    if signals and rapid_words(files[module]) != rapid_words(_routines(controller, signals, len(tasks) > 1)):
        faults.append(f"{module} does not do what it is to: request back at a stop, question at a start")
    return faults


def _rows(
    name: str, kind: str, wanted: Mapping[str, Sequence[Row]], got: Mapping[str, Sequence[Row]]
) -> list[str]:
    want, have = wanted.get(kind, ()), got.get(kind, ())
    faults = [f"{name}.cfg, {kind}: there is no {_shown(row)}" for row in want if row not in have]
    faults += [f"{name}.cfg, {kind}: {_shown(row)} is not as it should be" for row in have if row not in want]
    if not faults and len(have) != len(want):
        faults.append(f"{name}.cfg, {kind}: a row stands there twice")
    return faults


def _shown(row: Row) -> str:
    return " ".join(f"-{key} {value}".strip() for key, value in sorted(row))


def _row(**values: str) -> Row:
    return frozenset(values.items())


def _signals(controller: Controller, signals: Sequence[str], partner: Partner | None) -> dict[str, list[Row]]:
    """Requests that nothing but program and operator set, on no device; outputs that nobody sets by hand."""
    lock = controller.interlock
    rows = []
    for request in signals:
        real = lock.of(request)
        wired = {"device": real.device, "devicemap": str(real.bit)} if real.device else {}
        rows.append(_row(name=request, signaltype="DO", access="TandemRequest"))
        rows.append(_row(name=real.signal, signaltype="DO", access="ReadOnly", **wired))
    rows += [_row(name=name, signaltype="DO", access="ReadOnly") for name in (lock.cycle, lock.motors)]
    wanted = {
        "EIO_SIGNAL": [*rows, *(_row(**values) for values in (partner.signals if partner else ()))],
        "SYSSIG_OUT": [
            _row(status="CycleOn", signal=lock.cycle),
            _row(status="MotOnState", signal=lock.motors),
        ],
    }
    if signals:
        wanted["EIO_ACCESS"] = [_row(name="TandemRequest", rapid="", localmanual="", localauto="")]
    if partner:
        wanted["SYSSIG_IN"] = [_row(signal=partner.lost, action="Stop")]
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
            faults.append(f"EIO.cfg, EIO_CROSS: {_shown(row)} {wrong}")
    names = [value for row in rows for key, value in row if key == "name"]
    if len(set(names)) != len(rows):
        faults.append("EIO.cfg, EIO_CROSS: cross connections need names that differ")
    faults += [
        f"EIO.cfg, EIO_CROSS: nothing drives {result}" for result, _ in wanted - set(filter(None, got))
    ]
    return faults


def _hooks(tasks: Sequence[str], module: str) -> dict[str, list[Row]]:
    hooks = []
    for number, task in enumerate(tasks):
        routine = {"off": "tandem_off", "on": "tandem_wait" if number else "tandem_again"}
        hooks += [
            _row(routine=routine[kind], shelf=shelf.upper(), task=task) for shelf, kind in _SHELVES.items()
        ]
    loaded = _row(file=f"HOME:/{module}", modname=_MODULE, alltask="")
    return {"CAB_TASK_MODULES": [loaded], "CAB_EXEC_HOOKS": hooks}


def _routines(controller: Controller, signals: Sequence[str], together: bool) -> str:
    """The system module as it has to be."""
    kept = {f"tandem_cut_{number}": request for number, request in enumerate(signals, 1)}
    off = "".join(
        f"IF DOutput({request})=1 THEN {flag}:=TRUE; ENDIF SetDO {request},0;"
        for flag, request in kept.items()
    )
    ask, stop = "", "Stop\\AllMoveTasks" if together else "Stop"
    for flag, request in kept.items():
        lines = ",".join(f'"{line}"' for line in said.again(request))
        words = ",".join(f'"{word}"' for word in said.BUTTONS)
        told = "".join(f'TPWrite "{line}";' for line in said.REFUSED)
        ask += (
            f'WHILE {flag} DO answer:=UIMessageBox(\\Header:="{said.HEADER}"\\MsgArray:=[{lines}]'
            f"\\BtnArray:=[{words}]\\Icon:=iconWarning); IF answer=1 THEN {flag}:=FALSE; "
            f"ELSEIF answer=2 AND DOutput({controller.interlock.of(request).signal})=1 THEN {flag}:=FALSE; "
            f"ELSE {told} {stop}; ENDIF ENDWHILE "
        )
    waits = "".join(f"WaitUntil NOT {flag};" for flag in kept)
    wait = f"PROC tandem_wait() tandem_off; {waits} ENDPROC" if together else ""
    data = "".join(f"PERS bool {flag}:=FALSE;" for flag in kept)
    return (
        f"MODULE {_MODULE}(SYSMODULE) {data} PROC tandem_off() {off} ENDPROC "
        f"PROC tandem_again() VAR num answer; tandem_off; {ask} ENDPROC {wait} ENDMODULE"
    )


# ---- KUKA ----


def _kuka(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    files: Mapping[str, str],
    partner: Partner | None,
) -> list[str]:
    flag, runs = "TANDEM_CUT", "$PRO_ACT AND $PERI_RDY"
    watched, known = (partner.watched(runs), [partner.seen]) if partner else ([], [])
    runs += f" AND {partner.input}" if partner else ""
    numbers = {signal: controller.number(arm, signal) for signal in signals}
    back = [
        line
        for number in numbers.values()
        for line in (f"IF $OUT[{number}] THEN", f"{flag}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE")
    ]
    real = {
        number: controller.number(arm, controller.interlock.of(s).signal) for s, number in numbers.items()
    }
    follow = [f"$OUT[{out}]=$OUT[{n}] AND {runs}" for n, out in real.items() if out is not None]
    held = [f"IF {flag} THEN", "$OV_PRO=0", "ENDIF"]
    power = [f"IF NOT({runs}) THEN", *back, "ENDIF", *follow, *held]
    declared = [f"DECL BOOL {name}=FALSE" for name in ([flag] if signals else []) + known]
    wanted = {"config_user.dat": declared, "sps_user.sub": [*watched, *(power if signals else [])]}
    if signals:
        wanted["ir_stopm_user.src"] = back
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
