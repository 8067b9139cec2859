"""Rules on the text itself: syntax, declarations, names, sizes, numbers, files, the problem's digest."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from pathlib import PurePosixPath
from xml.etree import ElementTree as ET

from planner.issues import Issue, Severity
from planner.verify import pendant, rules_krl
from planner.verify.context import DIGEST, Context, Outcome
from planner.verify.faults import Fault
from planner.verify.files.carried import changed
from planner.verify.job import task_names
from planner.verify.program_text import strange
from planner.verify.rapid_ast import Literal
from planner.verify.rapid_values import QUATERNION_TOLERANCE
from planner.verify.steps import MoveStep

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


def syntax(context: Context) -> Outcome:
    """The text is RAPID, or KRL, and has one straight way."""
    job = context.job
    faults = [*(f for f in job.faults if f.kind not in _OTHERS), *job.flow]
    faults += [f for task in job.tasks for file, text in task.files.items() for f in strange(file, text)]
    found = _faults(context, "verify.syntax", faults, "write the programs again with Tandem")
    notes = tuple(
        Issue("verify.syntax", n.message, Severity.WARNING, file=n.file, line=n.line, field=n.code)
        for n in job.notes
    )
    return dataclasses.replace(found, issues=(*found.issues, *notes))


def declarations(context: Context) -> Outcome:
    """What is used is declared, of the right type, with a value."""
    faults = [f for f in context.job.faults if f.kind in _DECLARATION]
    return _faults(context, "verify.declarations", faults, "declare what is used, with its type and value")


def persistents(context: Context) -> Outcome:
    """PERS data are given literals, and are not shared between tasks, which would let one change another."""
    faults = [f for f in context.job.faults if f.kind in _PERS]
    outcome = _faults(context, "verify.pers_literal", faults, "give PERS data a literal")
    shared = [
        Issue("verify.pers_literal", f"PERS {data.name} is shared with the other tasks", file=task.name)
        for task in context.job.tasks
        for module in task.modules
        for data in module.data
        if data.storage == "PERS" and data.kind != "tasks"
    ]
    return dataclasses.replace(outcome, issues=(*outcome.issues, *shared))


def names(context: Context) -> Outcome:
    """Names are legal, not too long and unique."""
    faults = [f for f in context.job.faults if f.kind in _NAMES]
    return _faults(context, "verify.names", faults, "a letter first, not too long, no reserved word")


def line_lengths(context: Context) -> Outcome:
    """Lines and strings are within what the controller reads."""
    faults = [f for f in context.job.faults if f.kind in _LINES]
    return _faults(context, "verify.line_length", faults, "break the line")


def module_size(context: Context) -> Outcome:
    """Modules are within the problem's limits of bytes and moves."""
    issues = [
        Issue("verify.module_size", f.message, file=f.file, line=f.line, hint="split the module")
        for f in context.job.faults
        if f.kind in _SIZES
    ]
    limit, worst = context.problem.cell.controller.max_moves, 0
    for task in context.job.tasks:
        found, most = rules_krl.sizes(context, task)
        issues += found
        worst = max(worst, most)
        for module in task.modules:
            steps = (step for p in module.procedures for step in p.body)
            count = sum(type(step).__name__ == "Move" for step in steps)
            worst = max(worst, count)
            if count > limit:
                message = f"module {module.name} has {count} moves; allowed: {limit}"
                issues.append(
                    Issue("verify.module_size", message, file=module.file, value=count, limit=limit)
                )
    return Outcome(tuple(issues), worst, limit, "moves")


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
        if task.krl is not None:
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
    return Outcome(tuple(issues), worst, QUATERNION_TOLERANCE, "", pendant.summary(context.job))


def files(context: Context) -> Outcome:
    """Every task of the cell has modules, no file is left over, and the program lists name the modules that
    are there, as the controller's RobotWare loads them; a KRL file has the name of its program."""
    issues = [
        Issue("verify.files", f.message, file=f.file, line=f.line, hint="rename the file as its program is")
        for f in context.job.faults
        if f.kind in _FILES
    ]
    job = context.job
    names = task_names(context.problem)
    read = {task.name for task in job.tasks}
    used = {arm for operation in context.problem.operations for arm in operation.arms}
    for number, arm in enumerate(context.problem.cell.arms):
        name = names[number] if number < len(names) else f"task {number + 1}"
        if arm.name in used and name not in read:
            message = f"arm {arm.name} has no module for task {name}"
            issues.append(Issue("verify.files", message, arm=arm.name, hint="copy all files of the programs"))
    issues += [
        Issue("verify.files", f"{path} belongs to none of the tasks", file=path, hint="take it away")
        for path in job.strays
    ]
    for task in job.tasks:
        for module in task.modules:
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
            there = sorted(PurePosixPath(module.file).name.lower() for module in task.modules)
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


def digest(context: Context) -> Outcome:
    """The programs were written for this very problem."""
    issues = []
    for task in context.job.tasks:
        found = [
            data.initial.value
            for data in context.data(task, rf"{DIGEST}(_\d+)?")
            if isinstance(data.initial, Literal) and data.kind == "string"
        ]
        text = "".join(str(part) for part in found) if task.krl is None else task.krl.digest
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
