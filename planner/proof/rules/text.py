"""Rules on the text itself, and targets that were modified on the pendant.

verify.syntax, declarations, pers_literal, names, line_length, module_size, decimals, files, digest.

Modified targets are recognised by their digits, which each language writes in its own way. If a rule fails at
or next to a modified target, the issue names the target as the likely cause.
"""

import dataclasses
import re
from collections.abc import Collection, Iterable
from typing import Final, NamedTuple

from planner.issues import Issue, Severity
from planner.programs.job import program_suffixes, task_names
from planner.programs.language import Sharing, reader_of
from planner.programs.stages import JobText, TaskText
from planner.programs.steps import MoveStep, TextFault
from planner.programs.text import changed_files, unexpected_characters
from planner.proof import language_contribution
from planner.proof.context import Context
from planner.proof.findings import Findings
from planner.proof.language_contribution import check_task, job_issues
from planner.proof.rule import RuleOutcome, rule, target_label

QUATERNION_TOLERANCE: Final = 1e-5
"""Tolerance of the norm of a quaternion from 1."""
_REWRITTEN_FRACTION = 0.5
"""Fraction of a task's targets above which targets that look modified do not count as modified, because
another program wrote all of them.
"""
_MAX_TARGETS_NAMED = 3
"""Maximum number of modified targets that an issue names."""


class ModifiedTarget(NamedTuple):
    """A move to a target that looks modified.

    Attributes:
        number: Index of the move among the moves of its task.
        file: File with the numbers of the target.
        line: Line of the numbers.
        name: Name of the target in messages.
    """

    number: int
    file: str
    line: int
    name: str


class ModifiedTargets(NamedTuple):
    """Modified targets of a job.

    Attributes:
        changed: Modified targets by arm.
        moves: Moves by arm and by line: {arm: {(module, line): [(index of the move, name of its target)]}}.
        targets: Number of all targets.
    """

    changed: dict[str, tuple[ModifiedTarget, ...]]
    moves: dict[str, dict[tuple[str, int], list[tuple[int, str | None]]]]
    targets: int


def find_modified_targets(job: JobText) -> ModifiedTargets:
    """Find the targets that look modified in the programs, to name them as the likely cause of issues.

    If most targets of a task look modified, another program wrote all of them, and none counts.
    """
    changed: dict[str, tuple[ModifiedTarget, ...]] = {}
    moves: dict[str, dict[tuple[str, int], list[tuple[int, str | None]]]] = {}
    total = 0
    for task in job.tasks:
        lines_by_file = {file: _target_lines(file, text) for file, text in task.files.items()}
        count = sum(len(lines) for lines in lines_by_file.values())
        total += count
        modified_count = sum(sum(lines.values()) for lines in lines_by_file.values())
        is_minority = modified_count <= _REWRITTEN_FRACTION * count
        moves_by_line = moves.setdefault(task.arm.name, {})
        modified: list[ModifiedTarget] = []
        steps = [step for step in task.steps if isinstance(step, MoveStep)]
        target_files = {**task.text.targets, **{task.text.module_of(file): file for file in task.files}}
        for number, step in enumerate(steps):
            moves_by_line.setdefault((step.module, step.line), []).append((number, target_label(step)))
            file, line = _target_location(task, step, target_files)
            if is_minority and lines_by_file.get(file, {}).get(line):
                modified.append(ModifiedTarget(number, file, line, target_label(step) or f"line {line}"))
        changed[task.arm.name] = tuple(modified)
    return ModifiedTargets(changed, moves, total)


def modified_targets_note(job: JobText) -> str:
    """Return a text with the number of targets that look modified, "" for none."""
    modified_targets = find_modified_targets(job)
    lines = {(target.file, target.line) for group in modified_targets.changed.values() for target in group}
    return (
        f"{len(lines)} of {modified_targets.targets} targets rounded since they were written" if lines else ""
    )


def with_pendant_cause(modified_targets: ModifiedTargets, issue: Issue) -> Issue:
    """Return the issue with the modified target at or next to its position as its likely cause."""
    causes = _likely_causes(modified_targets, issue)
    if not causes:
        return issue
    names = ", ".join(f"{c.name} ({c.file}, line {c.line})" for c in causes[:_MAX_TARGETS_NAMED])
    verb = "was" if len(causes) == 1 else "were"
    hint = f"likely cause: {names} {verb} changed on the pendant, as the digits show; plan again"
    return dataclasses.replace(issue, hint=f"{hint}; {issue.hint}" if issue.hint else hint)


def with_language_cause(issue: Issue) -> Issue:
    """Return an issue about the text with its likely cause, if the language of its file knows it."""
    cause = language_contribution.language_of_file(issue.file or "").likely_cause(issue.message)
    return dataclasses.replace(issue, hint=f"likely cause: {cause}") if cause else issue


def _likely_causes(modified_targets: ModifiedTargets, issue: Issue) -> list[ModifiedTarget]:
    """Return the modified targets that may have caused an issue.

    They are at, directly before or directly after the move of the issue. If there are none, targets of other
    arms with the name of the issue's target count. For an issue without a line, all targets of its arm count.
    """
    if issue.line is None:
        groups = (
            [modified_targets.changed.get(issue.arm, ())]
            if issue.arm in modified_targets.changed
            else modified_targets.changed.values()
        )
        return [target for group in groups for target in group]
    module = (issue.file or "").rpartition("/")[2]
    numbers: set[int] = set()
    arms = [issue.arm] if issue.arm in modified_targets.moves else list(modified_targets.moves)
    for arm in arms:
        for (holder, line), moves_here in modified_targets.moves[arm or ""].items():
            if line == issue.line and (not issue.file or holder == module):
                numbers |= {number for number, name in moves_here if issue.target in (None, name)}
    adjacent = {number + step for number in numbers for step in (-1, 0, 1)}
    adjacent_targets = [
        target for arm in arms for target in modified_targets.changed[arm or ""] if target.number in adjacent
    ]
    if adjacent_targets or issue.target is None:
        return adjacent_targets
    # The other arm may hold the other end of the wire, or the work.
    others = (
        target for arm, group in modified_targets.changed.items() if arm not in arms for target in group
    )
    return [target for target in others if target.name == issue.target]


def _target_lines(file: str, text: str) -> dict[int, bool]:
    """Return the lines of a file with targets, each with whether one of its targets looks modified."""
    out: dict[int, bool] = {}
    line, seen = 1, 0
    for position, is_changed in language_contribution.language_of_file(file).targets_in(text):
        line, seen = line + text.count("\n", seen, position), position
        out[line] = out.get(line, False) or is_changed
    return out


def decimals_of(number: str) -> int:
    """Return the number of decimals that a written number has, with its exponent resolved."""
    mantissa, _, exponent = number.strip().upper().partition("E")
    shift = int(exponent) if re.fullmatch(r"[+-]?\d{1,3}", exponent) else 0
    return max(len(mantissa.partition(".")[2]) - shift, 0)


def _target_location(task: TaskText, step: MoveStep, target_files: dict[str, str]) -> tuple[str, int]:
    """Return file and line of the numbers of a move's target.

    ``target_files`` maps ":" and the name of a declared target to "file:line", and the name of a module to
    its file. A target without a declaration has its numbers in the line of the move.
    """
    declaration = target_files.get(f":{step.target_name.lower()}") if step.target_name else None
    if declaration is None:
        return target_files.get(step.module, ""), step.line
    file, _, line = declaration.rpartition(":")
    return file, int(line)


# Kinds of reading faults, in any language, by the rule that reports them. All others belong to verify.syntax.
_DECLARATION = frozenset({"undeclared", "unknown_procedure", "type", "no_value"})
_PERS = frozenset({"pers_literal"})
_NAMES = frozenset({"name_form", "name_length", "name_reserved", "name_duplicate"})
_LINES = frozenset({"line_length", "string_length"})
_SIZES = frozenset({"file_size"})
_NUMBERS = frozenset({"number", "quaternion"})
_FILES = frozenset({"name_file"})
_OTHER_KINDS = _DECLARATION | _PERS | _NAMES | _LINES | _SIZES | _NUMBERS | _FILES
"""Kinds of reading faults that rules other than verify.syntax report."""


def _reading_faults(context: Context, code: str, kinds: Collection[str], hint: str) -> RuleOutcome:
    """Return the reading faults of some kinds as the outcome of a rule."""
    return _faults_outcome(code, [fault for fault in context.job.faults if fault.kind in kinds], hint)


def _faults_outcome(code: str, faults: Iterable[TextFault], hint: str) -> RuleOutcome:
    """Return faults as the outcome of a rule, whose value is their number."""
    issues = tuple(
        Issue(code, fault.message, file=fault.file, line=fault.line, field=fault.code, hint=hint)
        for fault in faults
    )
    return RuleOutcome(issues, float(len(issues)), 0.0, "faults")


@rule("verify.syntax")
def syntax(context: Context) -> RuleOutcome:
    """The text is RAPID, KRL, URScript or a trajectory file, and has one straight path of execution."""
    job = context.job
    faults = [*(fault for fault in job.faults if fault.kind not in _OTHER_KINDS), *job.flow_faults]
    faults += [
        fault
        for task in job.tasks
        for file, text in task.files.items()
        for fault in unexpected_characters(file, text)
    ]
    outcome = _faults_outcome("verify.syntax", faults, "write the programs again with Tandem")
    notes = tuple(
        Issue(
            "verify.syntax", note.message, Severity.WARNING, file=note.file, line=note.line, field=note.code
        )
        for note in job.notes
    )
    return dataclasses.replace(outcome, issues=(*outcome.issues, *notes))


@rule("verify.declarations")
def declarations(context: Context) -> RuleOutcome:
    """Everything that is used is declared, has the right type, and has a value."""
    return _reading_faults(
        context, "verify.declarations", _DECLARATION, "declare what is used, with its type and value"
    )


@rule("verify.pers_literal")
def persistent_data(context: Context) -> RuleOutcome:
    """PERS data have literals and are not shared between tasks, which would let one task change another."""
    outcome = _reading_faults(context, "verify.pers_literal", _PERS, "give PERS data a literal")
    shared = [
        issue
        for task in context.job.tasks
        for issue in check_task("verify.pers_literal", context, task).issues
    ]
    return dataclasses.replace(outcome, issues=(*outcome.issues, *shared))


@rule("verify.names")
def names(context: Context) -> RuleOutcome:
    """Names are legal, not too long and unique."""
    return _reading_faults(
        context, "verify.names", _NAMES, "start with a letter, avoid long and reserved names"
    )


@rule("verify.line_length")
def line_lengths(context: Context) -> RuleOutcome:
    """Lines and strings are within the limits of the controller."""
    return _reading_faults(context, "verify.line_length", _LINES, "break the line")


@rule("verify.module_size")
def module_size(context: Context) -> RuleOutcome:
    """Modules are within the problem's limits of bytes and moves."""
    limit = context.problem.cell.controller.max_moves
    findings = Findings("verify.module_size", context, worst=0.0)
    for fault in context.job.faults:
        if fault.kind in _SIZES:
            findings.add(fault.message, file=fault.file, line=fault.line, hint="split the module")
    for size in dict.fromkeys(size for task in context.job.tasks for size in task.text.sizes):
        findings.note_highest(size.moves)
        if size.moves > limit:
            message = f"{size.part} has {size.moves} {size.unit}; allowed: {limit}"
            findings.add(message, (size.moves, limit, None), file=size.file)
    return findings.outcome(int, "moves", limit)


@rule("verify.decimals")
def decimals(context: Context) -> RuleOutcome:
    """Numbers are exact on the controller, and quaternions have unit length.
    Targets that were rounded since they were written are reported.
    """
    findings = Findings("verify.decimals", context, worst=0.0)
    for fault in context.job.faults:
        if fault.kind in _NUMBERS:
            findings.add(fault.message, file=fault.file, line=fault.line, hint="write plain decimals")
    for task in context.job.tasks:
        checked_outcome = check_task("verify.decimals", context, task)
        findings.issues += checked_outcome.issues
        findings.note_highest(checked_outcome.worst or 0.0)
    outcome = findings.outcome(limit=QUATERNION_TOLERANCE)
    return dataclasses.replace(outcome, where=modified_targets_note(context.job))


@rule("verify.files")
def files(context: Context) -> RuleOutcome:
    """Every task of the cell has its modules, and no file is left over.
    The program lists name the existing modules, as the controller's RobotWare loads them. A file of KRL
    or URScript has the name of its program.
    """
    arms = context.problem.cell.arms
    sharing = {arm.name for arm in arms if (reader := reader_of(arm)) and reader.sharing is Sharing.FILE}
    shared_suffixes = tuple(ending for arm in arms if arm.name in sharing for ending in program_suffixes(arm))
    issues = [
        Issue(
            "verify.files",
            fault.message,
            file=fault.file,
            line=fault.line,
            hint=_rename_hint(fault, shared_suffixes),
        )
        for fault in context.job.faults
        if fault.kind in _FILES
    ]
    # A file with a fault exists, although it was not read.
    has_unread_file = any(fault.file.endswith(shared_suffixes) for fault in context.job.faults)
    names = task_names(context.problem)
    read = {task.name for task in context.job.tasks}
    used = {arm for operation in context.problem.operations for arm in operation.arms}
    for number, arm in enumerate(arms):
        name = names[number] if number < len(names) else f"task {number + 1}"
        if arm.name in used and name not in read and not (has_unread_file and arm.name in sharing):
            message = language_contribution.language_of_arm(arm).missing_file.format(arm=arm.name, task=name)
            issues.append(Issue("verify.files", message, arm=arm.name, hint="copy all files of the programs"))
    issues += [
        Issue("verify.files", f"{path} belongs to none of the tasks", file=path, hint="remove it")
        for path in context.job.strays
    ]
    for task in context.job.tasks:
        issues += check_task("verify.files", context, task).issues
    return RuleOutcome((*issues, *job_issues("verify.files", context)))


def _rename_hint(fault: TextFault, shared: tuple[str, ...]) -> str:
    """Return the remedy for a file with a wrong name.

    A file whose name ends in one of ``shared`` holds the programs of several arms, so only one may exist.
    """
    return "remove all but one" if fault.file.endswith(shared) else "rename the file like its program"


@rule("verify.digest")
def digest(context: Context) -> RuleOutcome:
    """The programs were written for this very problem."""
    findings = Findings("verify.digest", context)
    for task in context.job.tasks:
        stated_digest = task.text.digest
        if stated_digest != context.problem.digest:
            message = (
                f"task {task.name} states the problem {stated_digest[:12] or '(none)'}..., "
                f"this problem is {context.problem.digest[:12]}..."
            )
            findings.add(message, file=task.name, hint="plan this problem again")
    for name in changed_files(context.problem.source) if findings.issues else ():
        message = f"{name} has changed since the programs were written"
        findings.add(message, file=name, hint="restore the file, or plan this problem again")
    return findings.outcome_without_value()
