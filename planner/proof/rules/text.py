"""Rules on the text itself, and targets that somebody changed on the pendant.

verify.syntax, declarations, pers_literal, names, line_length, module_size, decimals, files, digest.

Changed targets are known by their digits, of which the language of a file knows. If a rule fails next to a
changed target, the issue names it as the likely cause.
"""

import dataclasses
import re
from collections.abc import Collection, Iterable
from typing import Final, NamedTuple

from planner.issues import Issue, Severity
from planner.programs.job import endings, task_names
from planner.programs.language import Sharing, reader_of
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import Fault, MoveStep
from planner.programs.text import changed, strange
from planner.proof import language_contribution
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.language_contribution import checked, job_issues
from planner.proof.rule import Outcome, rule, target

QUATERNION_TOLERANCE: Final = 1e-5
"""How far the norm of a quaternion may be off 1."""
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
    """Return an issue about the text with its likely cause, if the language of its file knows it."""
    cause = language_contribution.of_file(issue.file or "").likely_cause(issue.message)
    return dataclasses.replace(issue, hint=f"likely cause: {cause}") if cause else issue


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
    line, seen = 1, 0
    for place, is_changed in language_contribution.of_file(file).targets_in(text):
        line, seen = line + text.count("\n", seen, place), place
        out[line] = out.get(line, False) or is_changed
    return out


def decimals_of(number: str) -> int:
    """Return the number of decimals of a number, without its exponent."""
    mantissa, _, exponent = number.strip().upper().partition("E")
    shift = int(exponent) if re.fullmatch(r"[+-]?\d{1,3}", exponent) else 0
    return max(len(mantissa.partition(".")[2]) - shift, 0)


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


def _faults(context: Context, code: str, kinds: Collection[str], hint: str) -> Outcome:
    return _outcome(code, [fault for fault in context.job.faults if fault.kind in kinds], hint)


def _outcome(code: str, faults: Iterable[Fault], hint: str) -> Outcome:
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
    found = _outcome("verify.syntax", faults, "write the programs again with Tandem")
    notes = tuple(
        Issue("verify.syntax", n.message, Severity.WARNING, file=n.file, line=n.line, field=n.code)
        for n in job.notes
    )
    return dataclasses.replace(found, issues=(*found.issues, *notes))


@rule("verify.declarations")
def declarations(context: Context) -> Outcome:
    """What is used is declared, of the right type, with a value."""
    return _faults(
        context, "verify.declarations", _DECLARATION, "declare what is used, with its type and value"
    )


@rule("verify.pers_literal")
def persistents(context: Context) -> Outcome:
    """PERS data are given literals, and are not shared between tasks, which would let one change another."""
    outcome = _faults(context, "verify.pers_literal", _PERS, "give PERS data a literal")
    shared = [i for task in context.job.tasks for i in checked("verify.pers_literal", context, task).issues]
    return dataclasses.replace(outcome, issues=(*outcome.issues, *shared))


@rule("verify.names")
def names(context: Context) -> Outcome:
    """Names are legal, not too long and unique."""
    return _faults(context, "verify.names", _NAMES, "a letter first, not too long, no reserved word")


@rule("verify.line_length")
def line_lengths(context: Context) -> Outcome:
    """Lines and strings are within what the controller reads."""
    return _faults(context, "verify.line_length", _LINES, "break the line")


@rule("verify.module_size")
def module_size(context: Context) -> Outcome:
    """Modules are within the problem's limits of bytes and moves."""
    limit = context.problem.cell.controller.max_moves
    findings = Findings("verify.module_size", context, worst=0.0)
    for fault in context.job.faults:
        if fault.kind in _SIZES:
            findings.add(fault.message, file=fault.file, line=fault.line, hint="split the module")
    for size in dict.fromkeys(size for task in context.job.tasks for size in task.text.sizes):
        findings.highest(size.moves)
        if size.moves > limit:
            message = f"{size.part} has {size.moves} {size.unit}; allowed: {limit}"
            findings.add(message, (size.moves, limit, None), file=size.file)
    return findings.outcome(int, "moves", limit)


@rule("verify.decimals")
def decimals(context: Context) -> Outcome:
    """Numbers are such as a controller holds, and quaternions are unit ones; targets that were rounded since
    they were written are told."""
    findings = Findings("verify.decimals", context, worst=0.0)
    for fault in context.job.faults:
        if fault.kind in _NUMBERS:
            findings.add(fault.message, file=fault.file, line=fault.line, hint="write plain decimals")
    for task in context.job.tasks:
        one = checked("verify.decimals", context, task)
        findings.issues += one.issues
        findings.highest(one.worst or 0.0)
    found = findings.outcome(limit=QUATERNION_TOLERANCE)
    return dataclasses.replace(found, where=summary(context.job))


@rule("verify.files")
def files(context: Context) -> Outcome:
    """Every task of the cell has modules, no file is left over, and the program lists name the modules that
    are there, as the controller's RobotWare loads them; a file of KRL or URScript has the
    name of its program."""
    arms = context.problem.cell.arms
    sharing = {arm.name for arm in arms if (own := reader_of(arm)) and own.sharing is Sharing.FILE}
    shared = tuple(ending for arm in arms if arm.name in sharing for ending in endings(arm))
    issues = [
        Issue("verify.files", f.message, file=f.file, line=f.line, hint=_named(f, shared))
        for f in context.job.faults
        if f.kind in _FILES
    ]
    faulty = any(f.file.endswith(shared) for f in context.job.faults)  # there, but not read
    names = task_names(context.problem)
    read = {task.name for task in context.job.tasks}
    used = {arm for operation in context.problem.operations for arm in operation.arms}
    for number, arm in enumerate(arms):
        name = names[number] if number < len(names) else f"task {number + 1}"
        if arm.name in used and name not in read and not (faulty and arm.name in sharing):
            message = language_contribution.of_arm(arm).missing_file.format(arm=arm.name, task=name)
            issues.append(Issue("verify.files", message, arm=arm.name, hint="copy all files of the programs"))
    issues += [
        Issue("verify.files", f"{path} belongs to none of the tasks", file=path, hint="take it away")
        for path in context.job.strays
    ]
    for task in context.job.tasks:
        issues += checked("verify.files", context, task).issues
    return Outcome((*issues, *job_issues("verify.files", context)))


def _named(fault: Fault, shared: tuple[str, ...]) -> str:
    return "take all but one away" if fault.file.endswith(shared) else "rename the file as its program is"


@rule("verify.digest")
def digest(context: Context) -> Outcome:
    """The programs were written for this very problem."""
    findings = Findings("verify.digest", context)
    for task in context.job.tasks:
        text = task.text.digest
        if text != context.problem.digest:
            message = (
                f"task {task.name} states the problem {text[:12] or '(none)'}..., "
                f"this problem is {context.problem.digest[:12]}..."
            )
            findings.add(message, file=task.name, hint="plan this problem again")
    for name in changed(context.problem.source) if findings.issues else ():
        message = f"{name} is not the file that the programs were written for: it has been changed since"
        findings.add(message, file=name, hint="bring the file back, or plan this problem again")
    return findings.outcome_without_value()
