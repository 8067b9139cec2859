"""What languages contribute to the proof.

Many rules have a part that differs by language. A rule of :mod:`planner.proof.rules` asks the language of a
task for that part by its code (:func:`check_task`). The languages are found by
:mod:`planner.runtime.plugins`, so that the proof imports none of them.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Final

from planner.claims import sentences
from planner.claims.sentences import Sentence
from planner.issues import Issue, issue_error
from planner.problem import Arm, Problem
from planner.programs.handshake.automata import Wiring
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, SettingStep
from planner.programs.text import ControllerPartner
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import TaskAxis
from planner.proof.rule import Rule, RuleOutcome
from planner.runtime import plugins
from planner.runtime.plugins import Language, PluginError, Reference

TaskCheck = Callable[[Context, TaskText], RuleOutcome]
"""Part of a rule about one task."""
JobCheck = Callable[[Context], Iterable[Issue]]
"""Part of a rule about all tasks."""


@dataclasses.dataclass(frozen=True)
class StartSentences:
    """What programs show and ask before anything moves.

    Attributes:
        ready: Question whether all is ready, if no question about the first setup follows.
        clear: Question whether all is clear, if a question about the first setup follows.
        joined: Question that replaces these two if the arms are joined, None if none does.
        leader_earlier: Question of the first program of two controllers about an earlier run.
        follower_earlier: Question of the second program about an earlier run.
        start_partner: What the first program shows about the start of the second one.
    """

    ready: Sentence = sentences.READY
    clear: Sentence = sentences.CLEAR
    joined: Sentence | None = None
    leader_earlier: Sentence = sentences.EARLIER_RUN
    follower_earlier: Sentence = sentences.EARLIER_RUN
    start_partner: Sentence = sentences.START_PARTNER


@dataclasses.dataclass(frozen=True)
class AxisFormat:
    """How programs state and check tracks, gantries, turntables and positioners.

    Attributes:
        names: Names of the external axes of targets, in messages.
        zero_is_unused: Whether a value of 0 may stand for an axis that does not exist.
        checks_home: Function that tells whether a step compares an axis with its home as it should.
    """

    names: tuple[str, ...] = ("E1", "E2", "E3", "E4", "E5", "E6")
    zero_is_unused: bool = True
    checks_home: Callable[[Context, TaskAxis, SettingStep], bool] = lambda context, axis, step: False


@dataclasses.dataclass(frozen=True)
class ControllerPower:
    """Outputs of one controller that a stop must switch off, and the files that must do so.

    Attributes:
        context: The proof.
        tasks: Tasks of the controller.
        signals: Outputs that the tasks switch on, and that a stop has to switch off.
        burning: Outputs that light torches.
        partner: Ends of the running wires, if two controllers monitor each other.
        files: Texts of the files by name.
    """

    context: Context
    tasks: Sequence[TaskText]
    signals: Sequence[str]
    burning: frozenset[str]
    partner: ControllerPartner | None
    files: Mapping[str, str]

    def file_name_faults(self, names: Sequence[str]) -> list[str]:
        """Return messages about files of ``names`` that are missing, and about files that are not in it."""
        missing = [f"{name} is missing" for name in names if name not in self.files]
        return missing + [
            f"{name} does not belong to the programs"
            for name in self.files
            if name not in (*names, "README.txt")
        ]


@dataclasses.dataclass(frozen=True)
class ProofOfLanguage:
    """What a language contributes to the proof.

    Attributes:
        rules: Rules about programs of this language only.
        checks: Parts of rules about one task, by the codes of the rules.
        job_checks: Parts of rules about all tasks, by the codes of the rules.
        same_text: Function that tells whether two texts of a file differ at most in comments and white space.
        targets_in: Function for the positions of targets in the text of a file, each with whether its digits
            were written by a person or a controller.
        likely_cause: Function for the likely cause of a fault of the text by its message, "" if unknown.
        start: What programs show and ask before anything moves.
        missing_file: Message about an arm without a program; it may name {arm} and {task}.
        external_axes: How programs state and check external axes.
        controller_files: Faults of the files of a controller, None if it takes no files.
        corners: Function for the issues of zones of consecutive moves of a task that are too large, and the
            largest excess [mm]; None if the common rule on zones applies.
        slowest: Function that tells whether a move is as slow as the language can state, None if moves state
            times.
        starting_kinds: Kinds of moves of zero length that are allowed because something starts there.
        zero_length_fault: What is wrong with a move of zero length while another arm moves, "" if nothing
            is.
        watches_torch: Whether programs continue in a slot after a pause, so that they have to monitor their
            torch.
        restarts: Function for the issues of two programs that start anew after each stop, and the number of
            states that were examined; None if programs continue where they were stopped.
    """

    rules: tuple[Rule, ...] = ()
    checks: Mapping[str, TaskCheck] = dataclasses.field(default_factory=dict)
    job_checks: Mapping[str, JobCheck] = dataclasses.field(default_factory=dict)
    same_text: Callable[[str, str], bool] = operator.eq
    targets_in: Callable[[str], Iterator[tuple[int, bool]]] = lambda text: iter(())
    likely_cause: Callable[[str], str] = lambda message: ""
    start: StartSentences = StartSentences()
    missing_file: str = "arm {arm} has no module for task {task}"
    external_axes: AxisFormat = AxisFormat()
    controller_files: Callable[[ControllerPower], list[str]] | None = None
    corners: Callable[[TaskText, Sequence[MoveStep]], tuple[list[Issue], float]] | None = None
    slowest: Callable[[MoveStep], bool] | None = None
    starting_kinds: frozenset[str] = frozenset()
    zero_length_fault: Callable[[MoveStep], str] = lambda move: ""
    watches_torch: bool = False
    restarts: Callable[[Context, Wiring], tuple[list[Issue], int]] | None = None


_EMPTY: Final = ProofOfLanguage()
"""Contribution of a language that contributes nothing."""


@functools.cache
def _load(reference: Reference | None) -> ProofOfLanguage:
    """Load the contribution to which a reference points, an empty one for None."""
    return _EMPTY if reference is None else plugins.load(reference, ProofOfLanguage)


def _of(language: Language | None) -> ProofOfLanguage:
    """Return the contribution of a language, an empty one for None."""
    return _EMPTY if language is None else _load(language.proof)


def language_of_task(task: TaskText) -> ProofOfLanguage:
    """Return the contribution of the language of a task."""
    return _of(plugins.usable(Language).get(task.text.language))


def language_of_file(path: str) -> ProofOfLanguage:
    """Return the contribution of the language of a file, by the suffix of its name."""
    ending = PurePosixPath(path).suffix.lower()
    return _of(
        next((language for language in plugins.usable(Language).values() if ending in language.endings), None)
    )


def language_of_arm(arm: Arm) -> ProofOfLanguage:
    """Return the contribution of the language that the controller of an arm reads."""
    return _of(plugins.language_of(arm.data.family))


def check_task(code: str, context: Context, task: TaskText) -> RuleOutcome:
    """Check a task by the part of a rule that its language contributes.

    Args:
        code: Code of the rule.
        context: The proof.
        task: The task.

    Returns:
        The outcome, which is empty if the language has no such part.
    """
    check = language_of_task(task).checks.get(code)
    return RuleOutcome() if check is None else check(context, task)


def job_issues(code: str, context: Context) -> list[Issue]:
    """Return the issues that the languages' parts of a rule find in all tasks together."""
    contributions = dict.fromkeys(language.proof for language in plugins.usable(Language).values())
    checks = (_load(reference).job_checks.get(code) for reference in contributions)
    return [issue for check in checks if check is not None for issue in check(context)]


def proofs_of_languages(problem: Problem | None = None) -> tuple[ProofOfLanguage, ...]:
    """Return the contributions of Tandem's languages, and of the other languages that a problem uses.

    Raises:
        TandemError: The contribution of an installed package cannot be loaded (``post.language``).
    """
    families = {arm.data.family for arm in problem.cell.arms} if problem else set[str]()
    used = frozenset(
        name
        for name, language in plugins.usable(Language).items()
        if not families.isdisjoint(language.families)
    )
    try:
        return tuple(plugins.parts(Language, "proof", ProofOfLanguage, used))
    except PluginError as error:
        raise issue_error("post.language", str(error)) from error
