"""Rules on the text itself, and targets that somebody changed on the pendant.

verify.syntax, declarations, pers_literal, names, line_length, module_size, decimals, files, digest.

Changed targets are known by their digits; where a rule fails beside one, the issue names it as the
likely cause. Programs are written with the same decimals throughout: 4 of mm and 8 of quaternions
in RAPID, 4 of mm and 5 of degrees in KRL. ModPos puts down 2 decimals of mm and 6 digits of a
quaternion (seen in backups of six cells); KSS puts down all digits of single precision, so that
decimals vary with the size (seen in public programs).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import PurePosixPath
from typing import NamedTuple
from xml.etree import ElementTree as ET

from planner.issues import Issue, Severity
from planner.languages.rapid.reader.program_text import modules_of
from planner.languages.rapid.reader.syntax_tree import QUATERNION_TOLERANCE
from planner.programs.job import task_names
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import Fault, MoveStep
from planner.programs.text import changed, strange
from planner.proof.context import Context
from planner.proof.rule import Outcome, rule, target

_TRAJECTORY = ".jsonl"
"""Ending of files of trajectories."""
_RAPID_TARGET = re.compile(
    r"\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]\s*,\s*\[[^\[\]]*\]\s*,\s*\[[^\[\]]*\]\s*\]"
)
"""A target in RAPID: its position and its turn."""
_KRL_TARGET = re.compile(r"\{X ([^,}]*),Y ([^,}]*),Z ([^,}]*),A ([^,}]*),B ([^,}]*),C ([^,}]*)")
"""A target in KRL: its position and its turn."""
_INLINE_FORM = re.compile(
    r"[PFL]DAT_ACT|\$BWDSTART|#(?:PTP|CP)_(?:PARAMS|DAT)|\b(?:S?PTP|S?LIN)\s+X\w+"
    r"|DECL\s+(?:FDAT|[PL]DAT)\b",
    re.IGNORECASE,
)
"""What KUKA's inline forms leave in programs and data lists."""
_MM, _DIGITS = 2, 6
_KRL_MM, _KRL_DEG = 4, 5
_REWRITTEN_SHARE = 0.5
"""Where more of a task's targets than this share look changed, all were written like that."""
_TARGETS_NAMED = 3
"""So many changed targets are named at most where a rule does not say where it failed."""


class Changed(NamedTuple):
    """A move to a target that looks changed: its number among the task's moves, where the numbers stand, and
    what it is called."""

    number: int
    file: str
    line: int
    name: str


class Marks(NamedTuple):
    """Changed targets by arm, the moves of each arm by (module, line), and how many targets there are."""

    changed: dict[str, tuple[Changed, ...]]
    moves: dict[str, dict[tuple[str, int], list[tuple[int, str | None]]]]
    targets: int


def marks(job: JobText) -> Marks:
    """What looks changed in the programs."""
    changed: dict[str, tuple[Changed, ...]] = {}
    moves: dict[str, dict[tuple[str, int], list[tuple[int, str | None]]]] = {}
    total = 0
    for task in job.tasks:
        rows = {file: _rows(file, text) for file, text in task.files.items()}
        count = sum(len(found) for found in rows.values())
        total += count
        few = sum(sum(found.values()) for found in rows.values()) <= _REWRITTEN_SHARE * count
        places = moves.setdefault(task.arm.name, {})
        found: list[Changed] = []
        steps = [step for step in task.steps if isinstance(step, MoveStep)]
        where = {**task.text.targets, **{task.text.module_of(file): file for file in task.files}}
        for number, step in enumerate(steps):
            places.setdefault((step.module, step.line), []).append((number, target(step)))
            file, line = _stands(task, step, where)
            if few and rows.get(file, {}).get(line):
                found.append(Changed(number, file, line, target(step) or f"line {line}"))
        changed[task.arm.name] = tuple(found)
    return Marks(changed, moves, total)


def summary(job: JobText) -> str:
    """How many targets look changed, for people; "" for none."""
    found = marks(job)
    lines = {(c.file, c.line) for group in found.changed.values() for c in group}
    return f"{len(lines)} of {found.targets} targets rounded since they were written" if lines else ""


def with_pendant_cause(found: Marks, issue: Issue) -> Issue:
    """The issue with the changed target at or next to its place as its likely cause."""
    causes = _causes(found, issue)
    if not causes:
        return issue
    names = ", ".join(f"{c.name} ({c.file}, line {c.line})" for c in causes[:_TARGETS_NAMED])
    what = "was" if len(causes) == 1 else "were"
    hint = f"likely cause: {names} {what} changed on the pendant, as the digits tell; plan again"
    return dataclasses.replace(issue, hint=f"{hint}; {issue.hint}" if issue.hint else hint)


def with_form_cause(issue: Issue) -> Issue:
    """The issue about a line that an inline form has written with that as its likely cause."""
    if _INLINE_FORM.search(issue.message) is None:
        return issue
    hint = "likely cause: changed on the pendant by an inline form; plan again"
    return dataclasses.replace(issue, hint=hint)


def _causes(found: Marks, issue: Issue) -> list[Changed]:
    if issue.line is None:
        groups = [found.changed.get(issue.arm, ())] if issue.arm in found.changed else found.changed.values()
        return [c for group in groups for c in group]
    module = (issue.file or "").rpartition("/")[2]
    numbers: set[int] = set()
    arms = [issue.arm] if issue.arm in found.moves else list(found.moves)
    for arm in arms:
        for (holder, line), here in found.moves[arm or ""].items():
            if line == issue.line and (not issue.file or holder == module):
                numbers |= {number for number, name in here if issue.target in (None, name)}
    beside = {number + step for number in numbers for step in (-1, 0, 1)}
    near = [c for arm in arms for c in found.changed[arm or ""] if c.number in beside]
    if near or issue.target is None:
        return near
    # the arm that holds the other end of a wire, or the other's work
    others = (c for arm, group in found.changed.items() if arm not in arms for c in group)
    return [c for c in others if c.name == issue.target]


def _rows(file: str, text: str) -> dict[int, bool]:
    """Lines on which targets stand, and whether one of them looks changed."""
    out: dict[int, bool] = {}
    krl = file.lower().endswith((".src", ".dat"))
    line, seen = 1, 0
    for found in (_KRL_TARGET if krl else _RAPID_TARGET).finditer(text):
        line, seen = line + text.count("\n", seen, found.start()), found.start()
        before = text[text.rfind("\n", 0, seen) + 1 : seen]
        if krl and re.match(r"\s*DECL\s+(?!E6POS)", before, re.IGNORECASE):
            continue  # a frame or a load
        out[line] = out.get(line, False) or (_krl(found) if krl else _rapid(found))
    return out


def _rapid(found: re.Match[str]) -> bool:
    place, turn = (found.group(group).split(",") for group in (1, 2))
    return all(_decimals(n) <= _MM for n in place) and all(_digits(n) <= _DIGITS for n in turn)


def _krl(found: re.Match[str]) -> bool:
    place, angles = [_decimals(n) for n in found.groups()[:3]], [_decimals(n) for n in found.groups()[3:]]
    longer = max(place) > _KRL_MM or max(angles) > _KRL_DEG
    return longer or (max(place) < _KRL_MM and max(angles) < _KRL_DEG)


def _decimals(number: str) -> int:
    mantissa, _, exponent = number.strip().upper().partition("E")
    shift = int(exponent) if re.fullmatch(r"[+-]?\d{1,3}", exponent) else 0
    return max(len(mantissa.partition(".")[2]) - shift, 0)


def _digits(number: str) -> int:
    return len(number.strip().upper().partition("E")[0].lstrip("+-0.").replace(".", ""))


def _stands(task: TaskText, step: MoveStep, where: dict[str, str]) -> tuple[str, int]:
    """File and line of the numbers that a move goes to."""
    named = where.get(f":{step.target_name.lower()}") if step.target_name else None
    if named is None:
        return where.get(step.module, ""), step.line
    file, _, line = named.rpartition(":")
    return file, int(line)


_DECLARATION = frozenset({"undeclared", "unknown_procedure", "type", "no_value"})
_PERS = frozenset({"pers_literal"})
_NAMES = frozenset({"name_form", "name_length", "name_reserved", "name_duplicate"})
_LINES = frozenset({"line_length", "string_length"})
_SIZES = frozenset({"file_size"})
_NUMBERS = frozenset({"number", "quaternion"})
_FILES = frozenset({"name_file"})
_OTHERS = _DECLARATION | _PERS | _NAMES | _LINES | _SIZES | _NUMBERS | _FILES
"""Kinds of faults of reading, in any language, by the rule that names them; the rest are of syntax."""


def _faults(context: Context, code: str, faults: Iterable[Fault], hint: str) -> Outcome:
    issues = tuple(
        Issue(code, fault.message, file=fault.file, line=fault.line, field=fault.code, hint=hint)
        for fault in faults
    )
    return Outcome(issues, float(len(issues)), 0.0, "faults")


@rule("verify.syntax")
def syntax(context: Context) -> Outcome:
    """The text is RAPID, KRL, URScript or a file of trajectories, and has one straight way."""
    job = context.job
    faults = [*(f for f in job.faults if f.kind not in _OTHERS), *job.flow]
    faults += [f for task in job.tasks for file, text in task.files.items() for f in strange(file, text)]
    found = _faults(context, "verify.syntax", faults, "write the programs again with Tandem")
    notes = tuple(
        Issue("verify.syntax", n.message, Severity.WARNING, file=n.file, line=n.line, field=n.code)
        for n in job.notes
    )
    return dataclasses.replace(found, issues=(*found.issues, *notes))


@rule("verify.declarations")
def declarations(context: Context) -> Outcome:
    """What is used is declared, of the right type, with a value."""
    faults = [f for f in context.job.faults if f.kind in _DECLARATION]
    return _faults(context, "verify.declarations", faults, "declare what is used, with its type and value")


@rule("verify.pers_literal")
def persistents(context: Context) -> Outcome:
    """PERS data are given literals, and are not shared between tasks, which would let one change another."""
    faults = [f for f in context.job.faults if f.kind in _PERS]
    outcome = _faults(context, "verify.pers_literal", faults, "give PERS data a literal")
    shared = [
        Issue("verify.pers_literal", f"PERS {data.name} is shared with the other tasks", file=task.name)
        for task in context.job.tasks
        for module in modules_of(task.text)
        for data in module.data
        if data.storage == "PERS" and data.kind != "tasks"
    ]
    return dataclasses.replace(outcome, issues=(*outcome.issues, *shared))


@rule("verify.names")
def names(context: Context) -> Outcome:
    """Names are legal, not too long and unique."""
    faults = [f for f in context.job.faults if f.kind in _NAMES]
    return _faults(context, "verify.names", faults, "a letter first, not too long, no reserved word")


@rule("verify.line_length")
def line_lengths(context: Context) -> Outcome:
    """Lines and strings are within what the controller reads."""
    faults = [f for f in context.job.faults if f.kind in _LINES]
    return _faults(context, "verify.line_length", faults, "break the line")


@rule("verify.module_size")
def module_size(context: Context) -> Outcome:
    """Modules are within the problem's limits of bytes and moves."""
    issues = [
        Issue("verify.module_size", f.message, file=f.file, line=f.line, hint="split the module")
        for f in context.job.faults
        if f.kind in _SIZES
    ]
    limit, worst = context.problem.cell.controller.max_moves, 0
    for size in dict.fromkeys(size for task in context.job.tasks for size in task.text.sizes):
        worst = max(worst, size.moves)
        if size.moves > limit:
            message = f"{size.part} has {size.moves} {size.unit}; allowed: {limit}"
            issues.append(Issue("verify.module_size", message, file=size.file, value=size.moves, limit=limit))
    return Outcome(tuple(issues), worst, limit, "moves")


@rule("verify.decimals")
def decimals(context: Context) -> Outcome:
    """Numbers are such as a controller holds, and quaternions are unit ones; targets that were rounded since
    they were written are told."""
    issues = [
        Issue("verify.decimals", f.message, file=f.file, line=f.line, hint="write plain decimals")
        for f in context.job.faults
        if f.kind in _NUMBERS
    ]
    worst = 0.0
    for task in context.job.tasks:
        if task.text.language != "rapid":
            continue  # angles are of no length
        for step in task.steps:
            if isinstance(step, MoveStep) and not step.by_joints:
                off = abs(float((step.target.quaternion**2).sum()) ** 0.5 - 1.0)  # type: ignore[union-attr]
                worst = max(worst, off)
                if off > QUATERNION_TOLERANCE:
                    message = (
                        f"the quaternion's norm is off 1 by {off:.2g}; allowed: {QUATERNION_TOLERANCE:g}"
                    )
                    issues.append(
                        Issue("verify.decimals", message, file=f"{task.name}/{step.module}", line=step.line)
                    )
    return Outcome(tuple(issues), worst, QUATERNION_TOLERANCE, "", summary(context.job))


@rule("verify.files")
def files(context: Context) -> Outcome:
    """Every task of the cell has modules, no file is left over, and the program lists name the modules that
    are there, as the controller's RobotWare loads them; a file of KRL or URScript has the
    name of its program."""
    issues = [
        Issue("verify.files", f.message, file=f.file, line=f.line, hint=_named(f))
        for f in context.job.faults
        if f.kind in _FILES
    ]
    faulty = any(f.file.endswith(_TRAJECTORY) for f in context.job.faults)  # there, but not read
    job = context.job
    names = task_names(context.problem)
    read = {task.name for task in job.tasks}
    used = {arm for operation in context.problem.operations for arm in operation.arms}
    for number, arm in enumerate(context.problem.cell.arms):
        name = names[number] if number < len(names) else f"task {number + 1}"
        driven = arm.data.family == "ROS"
        if arm.name in used and name not in read and not (driven and faulty):
            message = f"arm {arm.name} has no module for task {name}"
            message = f"no file of trajectories moves arm {arm.name}" if driven else message
            issues.append(Issue("verify.files", message, arm=arm.name, hint="copy all files of the programs"))
    issues += [
        Issue("verify.files", f"{path} belongs to none of the tasks", file=path, hint="take it away")
        for path in job.strays
    ]
    for task in job.tasks:
        for module in modules_of(task.text):
            if PurePosixPath(module.file).stem.lower() != module.name.lower():
                what = f"{module.file} holds the module {module.name}; the list of modules goes by file names"
                hint = f"rename the file {module.name}{PurePosixPath(module.file).suffix}"
                issues.append(Issue("verify.files", what, file=module.file, hint=hint))
            issues += _ending(context, module.file)
        lists = [path for path in job.lists if _folder(path) in {_folder(file) for file in task.files}]
        if len(lists) > 1:
            what = f"{task.name} has {len(lists)} program lists, {', '.join(lists)}"
            issues.append(Issue("verify.files", what, file=lists[1], hint="take all but one away"))
    for path, text in job.lists.items():
        issues += _list(context, path, text)
    return Outcome(tuple(issues))


def _named(fault: Fault) -> str:
    several = fault.file.endswith(_TRAJECTORY)
    return "take all but one away" if several else "rename the file as its program is"


def _ending(context: Context, file: str) -> list[Issue]:
    """RobotWare 6 loads ``.mod`` alone, RobotWare 7 ``.modx``."""
    version = context.problem.cell.controller.robotware
    allowed = {6: ".mod", 7: ".modx"}[version]
    if PurePosixPath(file).suffix == allowed:
        return []
    what = f"{file} is no module of RobotWare {version}, which loads {allowed}"
    hint = "plan again with the controller's robotware; a renamed module is no converted one"
    return [Issue("verify.files", what, file=file, hint=hint)]


def _list(context: Context, path: str, text: str) -> list[Issue]:
    if "<!" in text:
        return [_more(path)]
    bare = re.search(r"(?<!\r)\n|\r(?!\n)", text)
    if bare is not None or not text.endswith("\r\n"):
        line = text.count("\n", 0, bare.start() if bare else len(text)) + 1
        what = "the program list has other line ends than CR LF; controllers do not load it"
        return [Issue("verify.files", what, file=path, line=line, hint="copy the file byte by byte")]
    try:
        root = ET.fromstring(text.encode("latin-1", "replace"))
    except (ET.ParseError, LookupError, ValueError) as wrong:
        what = f"the program list cannot be read: {wrong}"
        return [Issue("verify.files", what, file=path, hint="copy the file byte by byte")]
    if root.tag != "Program" or any(item.tag != "Module" or len(item) for item in root):
        return [_more(path)]
    listed = sorted((item.text or "").strip().lower() for item in root)
    for task in context.job.tasks:
        if any(_folder(file) == _folder(path) for file in task.files):
            there = sorted(PurePosixPath(module.file).name.lower() for module in modules_of(task.text))
            if listed != there:
                message = f"the list names {', '.join(listed)}; the task's modules are {', '.join(there)}"
                return [Issue("verify.files", message, file=path, hint="list every module once")]
            return []
    what = "the program list stands beside no task's modules"
    return [Issue("verify.files", what, file=path, hint="take it away, or copy the modules beside it")]


def _more(path: str) -> Issue:
    what = "the program list holds more than modules"
    return Issue("verify.files", what, file=path, hint="copy the file byte by byte")


def _folder(path: str) -> str:
    return path.rpartition("/")[0]


@rule("verify.digest")
def digest(context: Context) -> Outcome:
    """The programs were written for this very problem."""
    issues = []
    for task in context.job.tasks:
        text = task.text.digest
        if text != context.problem.digest:
            message = (
                f"task {task.name} states the problem {text[:12] or '(none)'}..., "
                f"this problem is {context.problem.digest[:12]}..."
            )
            issues.append(Issue("verify.digest", message, file=task.name, hint="plan this problem again"))
    if issues:
        issues += [
            Issue(
                "verify.digest",
                f"{name} is not the file that the programs were written for: it has been changed since",
                file=name,
                hint="bring the file back, or plan this problem again",
            )
            for name in changed(context.problem.source)
        ]
    return Outcome(tuple(issues))
