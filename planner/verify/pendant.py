"""Targets that somebody changed on the pendant, as their digits tell, and rules that fail there.

Programs are written with the same decimals throughout: 4 of mm and 8 of quaternions in RAPID, 4 of mm and 5
of degrees in KRL. ModPos puts down 2 decimals of mm and 6 digits of a quaternion (seen in backups of six
cells); KSS puts down all digits of single precision, so that decimals vary with the size (seen in public
programs).
"""

from __future__ import annotations

import dataclasses
import re
from typing import NamedTuple

from planner.issues import Issue
from planner.verify.findings import target
from planner.verify.job import JobText, TaskText
from planner.verify.steps import MoveStep

_RAPID = re.compile(r"\[\s*\[([^\[\]]*)\]\s*,\s*\[([^\[\]]*)\]\s*,\s*\[[^\[\]]*\]\s*,\s*\[[^\[\]]*\]\s*\]")
_KRL = re.compile(r"\{X ([^,}]*),Y ([^,}]*),Z ([^,}]*),A ([^,}]*),B ([^,}]*),C ([^,}]*)")
_INLINE = re.compile(
    r"[PFL]DAT_ACT|\$BWDSTART|#(?:PTP|CP)_(?:PARAMS|DAT)|\b(?:S?PTP|S?LIN)\s+X\w+"
    r"|DECL\s+(?:FDAT|[PL]DAT)\b",
    re.IGNORECASE,
)
"""What KUKA's inline forms leave in programs and data lists."""
_MM, _DIGITS = 2, 6
_KRL_MM, _KRL_DEG = 4, 5
_MOST = 0.5
"""Where more of a task's targets than this share look changed, all were written like that."""
_NAMED = 3
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
        few = sum(sum(found.values()) for found in rows.values()) <= _MOST * count
        places = moves.setdefault(task.arm.name, {})
        found: list[Changed] = []
        steps = [step for step in task.steps if isinstance(step, MoveStep)]
        where = _declared(task) | {_short(task, file): file for file in task.files}
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


def told(found: Marks, issue: Issue) -> Issue:
    """The issue with the changed target at or next to its place as its likely cause."""
    causes = _causes(found, issue)
    if not causes:
        return issue
    names = ", ".join(f"{c.name} ({c.file}, line {c.line})" for c in causes[:_NAMED])
    what = "was" if len(causes) == 1 else "were"
    hint = f"likely cause: {names} {what} changed on the pendant, as the digits tell; plan again"
    return dataclasses.replace(issue, hint=f"{hint}; {issue.hint}" if issue.hint else hint)


def of_form(issue: Issue) -> Issue:
    """The issue about a line that an inline form has written with that as its likely cause."""
    if _INLINE.search(issue.message) is None:
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
    for found in (_KRL if krl else _RAPID).finditer(text):
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


def _short(task: TaskText, file: str) -> str:
    """What steps call a file: its module in RAPID, its name in KRL."""
    return next((m.name for m in task.modules if m.file == file), file.rpartition("/")[2])


def _declared(task: TaskText) -> dict[str, str]:
    """Places of named targets as "file:line", by their name in lower case behind a colon."""
    out = {}
    for module in task.modules:
        for data in module.data:
            if data.kind == "robtarget":
                out[f":{data.name.lower()}"] = f"{module.file}:{data.line}"
    if task.krl is not None and task.krl.data is not None:
        for name, item in task.krl.data.items.items():
            if item.kind == "e6pos":
                out[f":{name}"] = f"{task.krl.data.file}:{item.line}"
    return out


def _stands(task: TaskText, step: MoveStep, where: dict[str, str]) -> tuple[str, int]:
    """File and line of the numbers that a move goes to."""
    named = where.get(f":{step.target_name.lower()}") if step.target_name else None
    if named is None:
        return where.get(step.module, ""), step.line
    file, _, line = named.rpartition(":")
    return file, int(line)
