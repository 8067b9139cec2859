"""What languages contribute to the proof.

Many rules have a part that differs by language. A rule of :mod:`planner.proof.rules` asks the language of a
task for that part by its code (:func:`checked`). The languages are found by :mod:`planner.runtime.plugins`,
so that the proof imports none of them.
"""

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import Final

from planner.claims import sentences
from planner.claims.sentences import Sentence
from planner.issues import Issue, refusal
from planner.problem import Arm, Problem
from planner.programs.handshake.automata import Wiring
from planner.programs.stages import TaskText
from planner.programs.steps import MoveStep, SettingStep
from planner.programs.text import Partner
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import OuterAxis
from planner.proof.rule import Outcome, Rule
from planner.runtime import plugins
from planner.runtime.plugins import Language, PluginError, Reference

TaskCheck = Callable[[Context, TaskText], Outcome]
"""Part of a rule about one task."""
JobCheck = Callable[[Context], Iterable[Issue]]
"""Part of a rule about all tasks."""


@dataclasses.dataclass(frozen=True)
class StartSentences:
    """What programs tell and ask before anything moves.

    Attributes:
        ready: Question whether all is ready, if nobody confirms a setup behind it.
        clear: Question whether all is clear, if somebody does.
        joined: Question in place of these where the arms are joined.
        leader_earlier: Question of the first program of two controllers about an earlier run.
        follower_earlier: Question of the second one.
        start_partner: What the first one tells about the start of the second one.
    """

    ready: Sentence = sentences.READY
    clear: Sentence = sentences.CLEAR
    joined: Sentence | None = None
    leader_earlier: Sentence = sentences.EARLIER
    follower_earlier: Sentence = sentences.EARLIER
    start_partner: Sentence = sentences.START_PARTNER


@dataclasses.dataclass(frozen=True)
class ExternalAxes:
    """How programs state and look at tracks, gantries, turntables and positioners.

    Attributes:
        names: Names of the values of targets, in messages.
        zero_is_unused: Whether a value of 0 may stand for an axis that does not exist.
        looks_at: Whether a step compares an axis with its home as it should.
    """

    names: tuple[str, ...] = ("E1", "E2", "E3", "E4", "E5", "E6")
    zero_is_unused: bool = True
    looks_at: Callable[[Context, OuterAxis, SettingStep], bool] = lambda context, axis, step: False


@dataclasses.dataclass(frozen=True)
class ControllerPower:
    """Power at one controller, and what its files have to do about it.

    Attributes:
        context: The proof.
        tasks: Tasks of the controller.
        signals: Outputs that the tasks switch on, and that a stop has to switch off.
        burning: Those that light torches.
        partner: Ends of the running wires, if two controllers watch each other.
        files: Texts of the files by name.
    """

    context: Context
    tasks: Sequence[TaskText]
    signals: Sequence[str]
    burning: frozenset[str]
    partner: Partner | None
    files: Mapping[str, str]

    def misnamed(self, names: Sequence[str]) -> list[str]:
        """Return files that are missing, and files that belong to nothing."""
        lost = [f"{name} is missing" for name in names if name not in self.files]
        return lost + [
            f"{name} belongs to nothing" for name in self.files if name not in (*names, "README.txt")
        ]


@dataclasses.dataclass(frozen=True)
class ProofOfLanguage:
    """What a language contributes.

    Attributes:
        rules: Rules about programs of this language alone.
        checks: Parts of rules about one task, by the codes of the rules.
        job_checks: Parts of rules about all tasks, by the codes of the rules.
        same_text: Whether two texts of a file differ in comments and white space at most.
        targets_in: Places in the text of a file at which targets stand, and whether each one has digits that
            a person or a controller wrote.
        likely_cause: Likely cause of a fault of the text by its message, "" if nothing is known.
        start: What programs tell and ask before anything moves.
        missing_file: Message about an arm without program; it may name {arm} and {task}.
        external_axes: How programs state and look at external axes.
        controller_files: Faults of the files of a controller, None if it takes no files.
        corners: Corners of consecutive moves of a task that are too large, and the largest excess [mm], None
            for those of the common zones.
        slowest: Whether a move is as slow as the language can state, None if moves state times.
        begins: Kinds of moves that go nowhere because something begins there.
        stands_still: What is wrong with a move that goes nowhere while another arm moves, "" if nothing is.
        watches_torch: Whether programs go on in a slot behind a pause, so that they have to watch their
            torch.
        restarts: Faults of two programs that begin anew behind each stop, and the number of states, None if
            programs go on where they were stopped.
    """

    rules: tuple[Rule, ...] = ()
    checks: Mapping[str, TaskCheck] = dataclasses.field(default_factory=dict)
    job_checks: Mapping[str, JobCheck] = dataclasses.field(default_factory=dict)
    same_text: Callable[[str, str], bool] = operator.eq
    targets_in: Callable[[str], Iterator[tuple[int, bool]]] = lambda text: iter(())
    likely_cause: Callable[[str], str] = lambda message: ""
    start: StartSentences = StartSentences()
    missing_file: str = "arm {arm} has no module for task {task}"
    external_axes: ExternalAxes = ExternalAxes()
    controller_files: Callable[[ControllerPower], list[str]] | None = None
    corners: Callable[[TaskText, Sequence[MoveStep]], tuple[list[Issue], float]] | None = None
    slowest: Callable[[MoveStep], bool] | None = None
    begins: frozenset[str] = frozenset()
    stands_still: Callable[[MoveStep], str] = lambda move: ""
    watches_torch: bool = False
    restarts: Callable[[Context, Wiring], tuple[list[Issue], int]] | None = None


_NOTHING: Final = ProofOfLanguage()
"""Contribution of a language without one."""


@functools.cache
def _load(reference: Reference | None) -> ProofOfLanguage:
    return _NOTHING if reference is None else plugins.load(reference, ProofOfLanguage)


def _of(language: Language | None) -> ProofOfLanguage:
    return _NOTHING if language is None else _load(language.proof)


def of_task(task: TaskText) -> ProofOfLanguage:
    """Return the contribution of the language of a task."""
    return _of(plugins.usable(Language).get(task.text.language))


def of_file(path: str) -> ProofOfLanguage:
    """Return the contribution of the language that a file has by the ending of its name."""
    ending = PurePosixPath(path).suffix.lower()
    return _of(next((one for one in plugins.usable(Language).values() if ending in one.endings), None))


def of_arm(arm: Arm) -> ProofOfLanguage:
    """Return the contribution of the language that the controller of an arm reads."""
    return _of(plugins.language_of(arm.data.family))


def checked(code: str, context: Context, task: TaskText) -> Outcome:
    """Apply the part of a rule that the language of a task has.

    Args:
        code: Code of the rule.
        context: The proof.
        task: The task.

    Returns:
        What was found, nothing if the language has no such part.
    """
    check = of_task(task).checks.get(code)
    return Outcome() if check is None else check(context, task)


def job_issues(code: str, context: Context) -> list[Issue]:
    """Return the issues of the parts of a rule that languages have about all tasks."""
    contributions = dict.fromkeys(one.proof for one in plugins.usable(Language).values())
    checks = (_load(reference).job_checks.get(code) for reference in contributions)
    return [issue for check in checks if check is not None for issue in check(context)]


def of_languages(problem: Problem | None = None) -> tuple[ProofOfLanguage, ...]:
    """Return the contributions of Tandem's languages, and of the other languages that a problem uses.

    Raises:
        TandemError: The contribution of an installed package cannot be loaded (``post.language``).
    """
    families = {arm.data.family for arm in problem.cell.arms} if problem else set[str]()
    used = frozenset(
        name for name, one in plugins.usable(Language).items() if not families.isdisjoint(one.families)
    )
    try:
        return tuple(plugins.parts(Language, "proof", ProofOfLanguage, used))
    except PluginError as error:
        raise refusal("post.language", str(error)) from error
