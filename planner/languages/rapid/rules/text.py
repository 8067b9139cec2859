"""RAPID's part of the rules on program text.

Programs are written with 4 decimals of mm and 8 of quaternions throughout. ModPos writes 2 decimals of mm
and 6 digits of a quaternion (seen in backups of six cells).
"""

import re
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Final
from xml.etree import ElementTree as ET

from planner.issues import Issue
from planner.languages.rapid.reader.lexer import RapidCursor
from planner.languages.rapid.reader.program_text import modules_of
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep
from planner.proof.context import Context
from planner.proof.rule import RuleOutcome
from planner.proof.rules.text import QUATERNION_TOLERANCE, decimals_of

_TARGET: Final = re.compile(
    r"\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]\s*,\s*\[[^\[\]]*\]\s*,\s*\[[^\[\]]*\]\s*\]"
)
"""A robtarget in place: group 1 is its position, group 2 its orientation."""
_MODPOS_MM_DECIMALS: Final = 2
_MODPOS_QUATERNION_DIGITS: Final = 6
"""Digits that ModPos writes at most: decimals of a position, significant digits of a quaternion."""


def target_offsets(text: str) -> Iterator[tuple[int, bool]]:
    """Yield the offset of each target in a module, and whether ModPos may have written it.

    ModPos teaches a target at the controller. Such a target has no more digits than ModPos writes.
    """
    for match in _TARGET.finditer(text):
        position, orientation = (match.group(group).split(",") for group in (1, 2))
        rounded = all(decimals_of(number) <= _MODPOS_MM_DECIMALS for number in position)
        yield (
            match.start(),
            rounded and all(_digits(number) <= _MODPOS_QUATERNION_DIGITS for number in orientation),
        )


def _digits(number: str) -> int:
    """Return the number of digits of a numeral from its first nonzero digit on, without the exponent."""
    return len(number.strip().upper().partition("E")[0].lstrip("+-0.").replace(".", ""))


def _lines(content: str) -> list[str]:
    """Return lines with more than a comment; "!" starts one, because no string continues over a line end."""
    lines = (line.strip(" \t\r") for line in content.split("\n"))
    return [line for line in lines if line and not line.startswith("!")]


def same_text(first: str, second: str) -> bool:
    """Return whether two texts differ only in comments and white space.

    Args:
        first: One text.
        second: The other text.
    """
    return _lines(first) == _lines(second) or _words(first) == _words(second)  # comparing lines is fast


def _words(content: str) -> list[str]:
    """Return the lower-case tokens up to the end of the text or the first token that is no RAPID.

    The last element is the kind of the token at which the list ends: "end" or "bad".
    """
    cursor = RapidCursor(content)
    out: list[str] = []
    while cursor.token.kind not in ("end", "bad"):
        out.append(cursor.token.word or cursor.token.text)
        cursor.take()
    return [*out, cursor.token.kind]


def shared_persistents(context: Context, task: TaskText) -> RuleOutcome:
    """Refuse PERS data except lists of tasks, because other tasks share them (verify.pers_literal).

    Args:
        context: The proof.
        task: The task.
    """
    return RuleOutcome(
        tuple(
            Issue("verify.pers_literal", f"PERS {data.name} is shared with the other tasks", file=task.name)
            for module in modules_of(task.text)
            for data in module.data
            if data.storage == "PERS" and data.kind != "tasks"
        )
    )


def quaternions(context: Context, task: TaskText) -> RuleOutcome:
    """Check that quaternions have unit norm (verify.decimals).

    Args:
        context: The proof.
        task: The task.
    """
    issues: list[Issue] = []
    worst = 0.0
    for step in task.steps:
        if isinstance(step, MoveStep) and not step.by_joints:
            deviation = abs(float((step.target.quaternion**2).sum()) ** 0.5 - 1.0)  # type: ignore[union-attr]
            worst = max(worst, deviation)
            if deviation > QUATERNION_TOLERANCE:
                message = (
                    f"the quaternion's norm deviates from 1 by {deviation:.2g}; allowed: "
                    f"{QUATERNION_TOLERANCE:g}"
                )
                file = f"{task.name}/{step.module}"
                issues.append(Issue("verify.decimals", message, file=file, line=step.line))
    return RuleOutcome(tuple(issues), worst)


def files(context: Context, task: TaskText) -> RuleOutcome:
    """Refuse modules not named like their files, and tasks with several program lists (verify.files).

    Args:
        context: The proof.
        task: The task.
    """
    issues = []
    for module in modules_of(task.text):
        if PurePosixPath(module.file).stem.lower() != module.name.lower():
            message = f"{module.file} contains the module {module.name}; the program list uses file names"
            hint = f"rename the file {module.name}{PurePosixPath(module.file).suffix}"
            issues.append(Issue("verify.files", message, file=module.file, hint=hint))
        issues += _suffix_issues(context, module.file)
    lists = [path for path in context.job.lists if _folder(path) in {_folder(file) for file in task.files}]
    if len(lists) > 1:
        message = f"{task.name} has {len(lists)} program lists, {', '.join(lists)}"
        issues.append(Issue("verify.files", message, file=lists[1], hint="remove all but one"))
    return RuleOutcome(tuple(issues))


def program_lists(context: Context) -> list[Issue]:
    """Return issues of program lists that do not load or that name other modules (verify.files)."""
    return [
        issue
        for path, text in context.job.lists.items()
        for issue in _program_list_issues(context, path, text)
    ]


def _suffix_issues(context: Context, file: str) -> list[Issue]:
    """Return an issue if the controller does not load a module with this suffix.

    RobotWare 6 loads ``.mod``, RobotWare 7 loads ``.modx``.
    """
    version = context.problem.cell.controller.robotware
    allowed = {6: ".mod", 7: ".modx"}[version]
    if PurePosixPath(file).suffix == allowed:
        return []
    message = f"RobotWare {version} does not load {file}; allowed: {allowed}"
    hint = "plan again with the controller's robotware; renaming a module does not convert it"
    return [Issue("verify.files", message, file=file, hint=hint)]


def _program_list_issues(context: Context, path: str, text: str) -> list[Issue]:
    """Return the issues of one program list (.pgf).

    Its form is checked, and whether it names exactly the modules in its folder.
    """
    if "<!" in text:  # a document type, an entity or a comment
        return [_unexpected_content(path)]
    wrong_line_end = re.search(r"(?<!\r)\n|\r(?!\n)", text)
    if wrong_line_end is not None or not text.endswith("\r\n"):
        line = text.count("\n", 0, wrong_line_end.start() if wrong_line_end else len(text)) + 1
        what = "the line ends of the program list are not CR LF; controllers do not load it"
        hint = "copy the file unchanged, in binary mode"
        return [Issue("verify.files", what, file=path, line=line, hint=hint)]
    try:
        root = ET.fromstring(text.encode("latin-1", "replace"))
    except (ET.ParseError, LookupError, ValueError) as wrong:
        what = f"the program list cannot be read: {wrong}"
        return [Issue("verify.files", what, file=path, hint="copy the file unchanged, in binary mode")]
    if root.tag != "Program" or any(item.tag != "Module" or len(item) for item in root):
        return [_unexpected_content(path)]
    listed = sorted((item.text or "").strip().lower() for item in root)
    for task in context.job.tasks:
        if any(_folder(file) == _folder(path) for file in task.files):
            present = sorted(PurePosixPath(module.file).name.lower() for module in modules_of(task.text))
            if listed != present:
                message = f"the list names {', '.join(listed)}; the task's modules are {', '.join(present)}"
                return [Issue("verify.files", message, file=path, hint="list every module once")]
            return []
    what = "no task has its modules in the folder of the program list"
    return [Issue("verify.files", what, file=path, hint="remove it, or copy the modules to its folder")]


def _unexpected_content(path: str) -> Issue:
    message = "the program list contains more than modules"
    return Issue("verify.files", message, file=path, hint="copy the file unchanged, in binary mode")


def _folder(path: str) -> str:
    return path.rpartition("/")[0]
