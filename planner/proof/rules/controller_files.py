"""Rules on what controllers need besides the motion: their files, and the check of the cell.

verify.controller_files: what power hangs on besides the program, who gives it back, and how two
controllers know of each other. verify.cell_check: the module that compares the cell with the plan
at run time, and what readers see of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePosixPath

import numpy as np

from planner.geometry.arrays import inverse
from planner.issues import Issue
from planner.languages.krl.reader.lines import krl_lines
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.reader.configuration import (
    Row,
    UnreadError,
    configuration,
    crossed,
    rapid_signals,
    rapid_words,
)
from planner.languages.rapid.reader.flow import CHECK_MODULE
from planner.languages.rapid.reader.reader import masked
from planner.languages.rapid.reader.syntax_tree import Instruction, Literal, ProcCall
from planner.languages.rapid.rules import power_at_stops
from planner.languages.rapid.rules.power_at_stops import POWER_MODULE, config_row
from planner.languages.urscript.reader.flow import LOOK_KIND
from planner.languages.urscript.reader.reader import pose
from planner.languages.urscript.reader.syntax_tree import CHECK_POINT, LOOK_ERROR
from planner.problem import Controller
from planner.processes.forming.claims import SinksHolder
from planner.programs.job import controllers
from planner.programs.stages import CONTROLLER, TaskText
from planner.programs.steps import BASE_FRAME, SettingStep, SignalStep, Step
from planner.programs.text import Partner, strange
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.kinematics.external_axes import OuterAxis, outer_axes
from planner.proof.rule import Outcome, at_step, mm, rule
from planner.proof.rules.external_axes import OFF_HOME
from planner.proof.rules.setups_and_frames import FRAME_POSITION, HOME_ERROR

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
    joined = controller.sync == "handshake" and len(context.job.tasks) > 1
    for folder, tasks, signals in _powered(context, joined):
        files = there.pop(folder, {})
        count += len(signals)
        partner = Partner(controller, tasks[0].arm.name) if joined else None
        lit = power_at_stops.torches(context, signals)
        if tasks[0].krl is None:
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
    pulsed = {claim.signal.lower() for claim in context.claims if isinstance(claim, SinksHolder)}
    alone = context.problem.cell.controller.sync == "handshake"
    out: list[tuple[str, tuple[TaskText, ...], list[str]]] = []
    for tasks in controllers(context.problem, context.job.tasks):
        if tasks[0].script is not None or tasks[0].trajectory is not None:
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
    flags, submit, stopped = power_at_stops.krl_files(controller, arm, signals, lit, runs)
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
_BEFORE_CALL = frozenset({"ConfJ", "ConfL", "SingArea", "SetDO", "Reset"})
"""What may stand in main before the call."""
_CHECK_HEAD = ["proc", "check_cell", "(", ")"]
"""Words that the procedure begins with."""
_AXES_HEAD = ["proc", "check_axes", "(", ")"]
"""The same of that which looks where tracks and turntables are."""
_DISTANCE, _TURN = 0.1, 0.02
"""How far the controller's frames may be off the plan's [mm], [degrees]."""


@rule("verify.cell_check")
def cell_check(context: Context) -> Outcome:
    """Before anything else each RAPID program compares base frame, tools and work objects with what was
    planned, and stops for good over 0.1 mm or 0.02 degrees; so does what looks where tracks and turntables
    are, over 1 mm or 0.1 degrees; one of URScript ends unless its controller has
    the flange, at home, where the plan has it within 10 mm."""
    issues: list[Issue] = []
    for task in context.job.tasks:
        if task.script is not None:
            issues += [at_step(CELL_CHECK, fault, task, step) for step, fault in _looks(task)]
        if task.rapid:
            issues += [
                Issue(CELL_CHECK, fault, arm=task.arm.name, file=file, hint="plan again; copy all modules")
                for file, fault in _faults(context, task)
            ]
    return Outcome(tuple(issues))


def _looks(task: TaskText) -> list[tuple[Step | None, str]]:
    """What is wrong with the look of a URScript program at its arm, step by step."""
    steps = [s for s in task.steps if isinstance(s, SettingStep) and s.kind == LOOK_KIND]
    if len(steps) != 1:
        return [
            (None, f"the program looks {len(steps)} times whether the arm is the planned one; once is due")
        ]
    (step,), machine = steps, arm_model.machine_of(task.arm.data)
    out: list[tuple[Step | None, str]] = []
    q, tip, place, most = (np.array(step.values[a:b]) for a, b in ((0, 6), (6, 12), (12, 18), (18, 19)))
    if np.abs(q - task.arm.home).max() > HOME_ERROR:
        out.append((step, "the arm is looked at elsewhere than at home"))
    if np.abs(tip[:3] - CHECK_POINT).max() > FRAME_POSITION:
        out.append((step, f"the point of the flange is {tip[:3].tolist()} m; wanted: {list(CHECK_POINT)}"))
    flange = inverse(machine.table.base) @ machine.flange(q)
    off = float(np.linalg.norm((flange @ pose(tuple(tip)))[:3, 3] - place[:3]))
    if off > FRAME_POSITION:
        out.append((step, f"the arm's URDF has that point {mm(off):.4f} mm from where the program wants it"))
    if most[0] > LOOK_ERROR:
        out.append((step, f"the point may be off by {mm(most[0]):g} mm; allowed: {mm(LOOK_ERROR):g}"))
    return out


def _faults(context: Context, task: TaskText) -> list[tuple[str, str]]:
    own = [path for path in task.files if CHECK_MODULE.match(PurePosixPath(path).name)]
    if len(own) != 1:
        return [(task.name, f"{len(own)} modules compare the cell with the plan; wanted: one, TandemCheck_n")]
    out = [] if _called(task) else [(task.name, "main does not call check_cell before anything else")]
    file = own[0]
    words = rapid_words(task.files[file])
    together = len(context.job.tasks) > 1 and context.job.readings is None
    parts = _parts(words)
    if parts is None:
        return [*out, (file, "it is not of the form that check_cell has")]
    module, body, handler, rest = parts
    axes = outer_axes(task.arm, context.problem.cell.turntable)
    second, looks, rest = _axes_parts(rest) if axes else ([], [], rest)
    if rapid_words(masked(task.files[file])) != [*module, *_CHECK_HEAD, *handler, *second, "endmodule"]:
        out.append((file, "its handler cannot be told from what compares"))
    if looks != _axes_wanted(axes):
        out.append((file, "it does not look as it should whether tracks and turntables are at home"))
    head, calls = _wanted(context, task)
    if module[:1] != ["module"] or len(module) != 2 or rest != rapid_words(_helpers(together, bool(axes))):
        out.append((file, "the procedures that compare are not as they should be"))
    if body[: len(head)] != head:
        out.append((file, "it does not read the base frame as it should, or not of this robot"))
    compared = sorted(body[len(head) :])
    out += [(file, f"it does not compare {_shown_call(lost)}") for lost in sorted(set(calls) - set(compared))]
    if not out and compared != sorted(calls):
        out.append((file, "it does more than compare what was planned"))
    return out


def _shown_call(call: str) -> str:
    found = re.search(r'"([^"]*)"', call)
    return (found.group(1) if found else call) + " with what was planned"


def _called(task: TaskText) -> bool:
    """Whether ``main`` begins with the call."""
    mains = [p for module in task.modules for p in module.procedures if p.name.lower() == "main"]
    for statement in mains[0].body if len(mains) == 1 else ():
        if isinstance(statement, ProcCall):
            return statement.name.lower() == "check_cell"
        if not (isinstance(statement, Instruction) and statement.name in _BEFORE_CALL):
            return False
        if statement.name == "SetDO" and not (
            isinstance(statement.arguments[1], Literal) and statement.arguments[1].value == 0
        ):
            return False
    return False


def _parts(words: Sequence[str]) -> tuple[list[str], list[str], list[str], list[str]] | None:
    """Words before the procedure, its statements, words of its handler, which is judged as those of all
    procedures are, and words behind it."""
    text = list(words)
    at = next((i for i in range(len(text)) if text[i : i + 4] == _CHECK_HEAD), None)
    if at is None or "error" not in text[at:] or "endproc" not in text[at:]:
        return None
    handler, end = text.index("error", at), text.index("endproc", at)
    if handler > end or text[-1:] != ["endmodule"]:
        return None
    body: list[str] = [" ".join(part) for part in _split(text[at + 4 : handler])]
    return text[:at], body, text[handler : end + 1], text[end + 1 : -1]


def _axes_parts(rest: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Words of the frame of the procedure that looks at external axes, with its handler, its statements, and
    words behind it; all is behind it where there is none."""
    text = list(rest)
    if text[: len(_AXES_HEAD)] != _AXES_HEAD or "error" not in text or "endproc" not in text:
        return [], [], text
    handler, end = text.index("error"), text.index("endproc")
    if handler > end:
        return [], [], text
    body = [" ".join(part) for part in _split(text[len(_AXES_HEAD) : handler])]
    return [*_AXES_HEAD, *text[handler : end + 1]], body, text[end + 1 :]


def _axes_wanted(axes: Sequence[OuterAxis]) -> list[str]:
    """What that procedure has to look at."""
    text = "VAR jointtarget cfg_here; cfg_here:=CJointT();" if axes else ""
    for axis in sorted(axes, key=lambda one: one.column):
        here, name = f"cfg_here.extax.eax_{'abcdef'[axis.column]}", rapid_sentences.axis_of(axis.unit)
        home = f"{axis.home / axis.scale:.4f}"
        home = home.removeprefix("-") if float(home) == 0.0 else home
        text += f'check_axis "{name}",{here},{home},{OFF_HOME[axis.sign]:g};'
    return _statements(text)


def _split(words: Sequence[str]) -> list[list[str]]:
    out: list[list[str]] = [[]]
    for word in words:
        if word == ";":
            out.append([])
        else:
            out[-1].append(word)
    return out if out[-1] else out[:-1]


def _statements(text: str) -> list[str]:
    return [" ".join(part) for part in _split(rapid_words(text))]


def _wanted(context: Context, task: TaskText) -> tuple[list[str], list[str]]:
    """How the base frame is read, in this order, and the comparisons, in any order."""
    controller = context.problem.cell.controller
    arms = [arm.name for arm in context.problem.cell.arms]
    place = f'"/MOC/ROBOT/{controller.robot(arms.index(task.arm.name))}"'
    read = "VAR pose cfg_base; VAR num cfg_value;"
    for axis in "xyz":
        read += (
            f'ReadCfgData {place},"base_frame_pos_{axis}",cfg_value; cfg_base.trans.{axis}:=1000*cfg_value;'
        )
    for part in range(4):
        read += f'ReadCfgData {place},"base_frame_orient_u{part}",cfg_value;'
        read += f"cfg_base.rot.q{part + 1}:=cfg_value;"
    calls = f'check_pose "{rapid_sentences.base_of(task.arm.name)}",cfg_base,{BASE_FRAME};'
    for data in context.data(task, r"\w+"):
        if not isinstance(data.initial, Literal) or data.kind not in ("tooldata", "wobjdata"):
            continue
        calls += _compared(data.name, data.kind, _raw(task, data.name))
    return _statements(read), _statements(calls)


def _compared(name: str, kind: str, value: Sequence[str]) -> str:
    """Comparisons of a declared tool or work object, whose parts are ``value`` as text."""
    if kind == "tooldata":
        text = f'check_pose "{rapid_sentences.frame_of(name)}",{name}.tframe,{value[1]};'
        return text + f'check_true "{rapid_sentences.kind_of(name)}",{name}.robhold;'
    text = f'check_pose "{rapid_sentences.object_frame_of(name)}",{name}.oframe,{value[4]};'
    who = f'check_true "{rapid_sentences.kind_of(name)}",NOT {name}.robhold AND '
    if value[1].upper() == "TRUE":
        text += f'check_pose "{rapid_sentences.user_frame_of(name)}",{name}.uframe,{value[3]};'
        return text + f"{who}{name}.ufprog;"
    return text + f"{who}NOT {name}.ufprog AND {name}.ufmec={value[2]};"


def _raw(task: TaskText, name: str) -> list[str]:
    """The components of a declaration, as its text has them."""
    for path, text in task.files.items():
        if CHECK_MODULE.match(PurePosixPath(path).name):
            continue
        if re.search(rf"(?i)\b{name}\s*:=", text) is None:
            continue  # nor without comments, of which each leaves a semicolon
        plain = re.sub(r"(?m)^\s*!.*|;\s*!.*", ";", text)
        found = re.search(rf"(?i)\b{name}\s*:=\s*\[(.*?)\]\s*;", plain, re.DOTALL)
        if found is not None:
            return _components(found.group(1))
    return [""] * 5


def _components(text: str) -> list[str]:
    out, depth, quoted = [""], 0, False
    for sign in text:
        quoted ^= sign == '"'
        depth += 0 if quoted else (sign == "[") - (sign == "]")
        if sign == "," and depth == 0 and not quoted:
            out.append("")
        else:
            out[-1] += sign
    return [part.strip() for part in out] + [""] * 5


def _helpers(together: bool, axes: bool) -> str:
    """The procedures that compare, as they have to be; ``axes``: tracks and turntables, too."""
    parts = ("1", "2", "3", "4")
    dot = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in parts)
    squares = "+".join(f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in parts)
    stop = "Stop\\AllMoveTasks" if together else "Stop"
    axis = f"""
    PROC check_axis(string what, num got, num wanted, num most)
      IF Abs(got-wanted)>most THEN
        TPWrite what; TPWrite "{rapid_sentences.OFF_HOME}"\\Num:=got-wanted; check_stop;
      ENDIF
    ENDPROC"""
    said_last = "".join(f'TPWrite "{line}";' for line in rapid_sentences.NOTHING_MOVES)
    return f"""
    PROC check_pose(string what, pose got, pose wanted)
      VAR num off_sign:=1; VAR num off_turn;
      IF {dot}<0 THEN off_sign:=-1; ENDIF
      off_turn:=114.591559*Sqrt({squares});
      IF Distance(got.trans,wanted.trans)>{_DISTANCE} OR off_turn>{_TURN} THEN
        TPWrite what; TPWrite "{rapid_sentences.OFF_BY_MM}"\\Num:=Distance(got.trans,wanted.trans);
        TPWrite "{rapid_sentences.OFF_BY_DEGREES}"\\Num:=off_turn; check_stop;
      ENDIF
    ENDPROC
    PROC check_true(string what, bool same)
      IF NOT same THEN TPWrite what; TPWrite "{rapid_sentences.NOT_AS_PLANNED}"; check_stop; ENDIF
    ENDPROC
    {axis if axes else ""}
    PROC check_stop()
      {said_last} WHILE TRUE DO {stop}; ENDWHILE
    ENDPROC
    """
