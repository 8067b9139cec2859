"""Parts of the rules on the text that RAPID alone has.

Programs are written with 4 decimals of mm and 8 of quaternions throughout. ModPos writes 2 decimals of mm and
6 digits of a quaternion (seen in backups of six cells).
"""

import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Final
from xml.etree import ElementTree as ET

from planner.issues import Issue
from planner.languages.rapid.reader.lexer import Cursor
from planner.languages.rapid.reader.program_text import modules_of
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.rule import Outcome
from planner.proof.rules.text import QUATERNION_TOLERANCE, decimals_of

_TARGET: Final = re.compile(
    r"\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]\s*,\s*\[[^\[\]]*\]\s*,\s*\[[^\[\]]*\]\s*\]"
)
"""A target: its position and its orientation."""
_MODPOS_MM_DECIMALS: Final = 2
_MODPOS_QUATERNION_DIGITS: Final = 6


def targets_in(text: str) -> Iterator[tuple[int, bool]]:
    """Yield where targets stand in a module, and whether ModPos may have written each of them."""
    for found in _TARGET.finditer(text):
        position, orientation = (found.group(group).split(",") for group in (1, 2))
        rounded = all(decimals_of(number) <= _MODPOS_MM_DECIMALS for number in position)
        yield found.start(), rounded and all(_digits(n) <= _MODPOS_QUATERNION_DIGITS for n in orientation)


def _digits(number: str) -> int:
    return len(number.strip().upper().partition("E")[0].lstrip("+-0.").replace(".", ""))


def _lines(content: str) -> list[str]:
    """The lines that hold more than a comment: no string, the only other place for a !, goes over a line's
    end."""
    lines = (line.strip(" \t\r") for line in content.split("\n"))
    return [line for line in lines if line and not line.startswith("!")]


def same_text(first: str, second: str) -> bool:
    """Return whether two texts differ in comments and white space at most."""
    return _lines(first) == _lines(second) or _words(first) == _words(second)


def _words(content: str) -> list[str]:
    cursor, out = Cursor(content), []
    while cursor.token.kind not in ("end", "bad"):
        out.append(cursor.token.word or cursor.token.text)
        cursor.take()
    return [*out, cursor.token.kind]


def shared_persistents(context: Context, task: TaskText) -> Outcome:
    """PERS data that other tasks share (verify.pers_literal)."""
    return Outcome(
        tuple(
            Issue("verify.pers_literal", f"PERS {data.name} is shared with the other tasks", file=task.name)
            for module in modules_of(task.text)
            for data in module.data
            if data.storage == "PERS" and data.kind != "tasks"
        )
    )


def quaternions(context: Context, task: TaskText) -> Outcome:
    """Quaternions that are no unit ones (verify.decimals)."""
    issues, worst = list[Issue](), 0.0
    for step in task.steps:
        if isinstance(step, MoveStep) and not step.by_joints:
            off = abs(float((step.target.quaternion**2).sum()) ** 0.5 - 1.0)  # type: ignore[union-attr]
            worst = max(worst, off)
            if off > QUATERNION_TOLERANCE:
                what = f"the quaternion's norm is off 1 by {off:.2g}; allowed: {QUATERNION_TOLERANCE:g}"
                file = f"{task.name}/{step.module}"
                issues.append(Issue("verify.decimals", what, file=file, line=step.line))
    return Outcome(tuple(issues), worst)


def files(context: Context, task: TaskText) -> Outcome:
    """Modules with other names than their files, and tasks with several program lists (verify.files)."""
    issues = []
    for module in modules_of(task.text):
        if PurePosixPath(module.file).stem.lower() != module.name.lower():
            what = f"{module.file} holds the module {module.name}; the list of modules goes by file names"
            hint = f"rename the file {module.name}{PurePosixPath(module.file).suffix}"
            issues.append(Issue("verify.files", what, file=module.file, hint=hint))
        issues += _ending(context, module.file)
    lists = [path for path in context.job.lists if _folder(path) in {_folder(file) for file in task.files}]
    if len(lists) > 1:
        what = f"{task.name} has {len(lists)} program lists, {', '.join(lists)}"
        issues.append(Issue("verify.files", what, file=lists[1], hint="take all but one away"))
    return Outcome(tuple(issues))


def program_lists(context: Context) -> list[Issue]:
    """Program lists that controllers do not load, or that name other modules (verify.files)."""
    return [issue for path, text in context.job.lists.items() for issue in _list(context, path, text)]


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
