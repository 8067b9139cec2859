"""Interface between the planner and the writer of a robot language, and the available writers."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Literal

from planner.claims.handshake import SignalWire
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError
from planner.languages.writing.layout import JobPrograms, TaskProgram
from planner.plans import Plan
from planner.problem import Arm, Controller, Problem
from planner.runtime import plugins
from planner.runtime.plugins import Language, PluginError
from planner.targets import Targets


@dataclasses.dataclass(frozen=True)
class WrittenPrograms:
    """Program files of one or several arms, and how their times differ from the plan.

    Attributes:
        files: Texts by relative name.
        clocks: Times of operations whose moves take longer in the programs than planned, by index of the
            operation. Each is an array (2, K): positions on the path (3.5 is half way from target 3 to
            target 4), and the times [s] at which the arms pass them.
    """

    files: dict[str, str]
    clocks: Mapping[int, FloatArray] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class PoweredSignals:
    """Signals that the configuration of a controller must know.

    Attributes:
        signals: Signals that the programs switch and that power something, sorted.
        torches: Those of them that light a torch.
        wires: Running wires between this controller and another one.
    """

    signals: Sequence[str]
    torches: Sequence[str]
    wires: Sequence[SignalWire]


Margins = Mapping[str, str]
"""Results of the proof by name, as text, for comments in the headers of programs."""
Poses = tuple[FloatArray, FloatArray]
"""Positions (N, 3) [mm] and quaternions (N, 4) of an arm at all targets of an operation."""


def _no_issues(*_: object) -> tuple[Issue, ...]:
    return ()


def _unchanged_poses(position: FloatArray, quaternion: FloatArray) -> Poses:
    return position, quaternion


@dataclasses.dataclass(frozen=True, eq=False)
class Writer:
    """Writer of programs of one language. All members but ``write`` have defaults.

    All functions get the tasks or arms of this language only, and may raise :class:`TandemError`
    (``post.*``).

    Attributes:
        write: Returns the programs of tasks. Files of arms with separate controllers are in folders by arm.
        syncs: Values of ``controller.sync`` with which programs of several arms are written.
        opt_in: How a user requests this language for arms of any family, a clause. Empty for a
            manufacturer's language.
        unmixed: Why its arms do not work in one job with arms of other languages, a clause. Empty if they
            do.
        stops_at_turns: Whether an arm stops where it only rotates about its TCP, because the language states
            corners as lengths on the path.
        stops_at_pauses: Whether an arm stops before and after it stands still while the other one moves.
        round_poses: Returns positions and quaternions in which consecutive poses that the language cannot
            distinguish are equal.
        refuse: Returns why these arms cannot do the job, however it is planned.
        refuse_settings: Returns why the job does not work with settings that only this language has; called
            for every job.
        refuse_segment: Returns why the language has no name for a segment.
        controller_files: Returns the files, by name, for the configuration of the controller of these tasks.
        notes: Returns notes to the user on the programs, given all program files.
    """

    write: Callable[[Sequence[TaskProgram], JobPrograms, Plan, Problem, Margins], WrittenPrograms]
    syncs: tuple[Literal["multimove", "handshake"], ...] = ()
    opt_in: str = ""
    unmixed: str = ""
    stops_at_turns: bool = False
    stops_at_pauses: bool = False
    round_poses: Callable[[FloatArray, FloatArray], Poses] = _unchanged_poses
    refuse: Callable[[Problem, Sequence[Targets], Sequence[Arm]], Iterable[Issue]] = _no_issues
    refuse_settings: Callable[[Problem, Sequence[Targets]], Iterable[Issue]] = _no_issues
    refuse_segment: Callable[[Segment], Iterable[Issue]] = _no_issues
    controller_files: (
        Callable[[JobPrograms, Sequence[TaskProgram], Controller, PoweredSignals], dict[str, str]] | None
    ) = None
    notes: Callable[[Sequence[TaskProgram], Plan, Problem, Mapping[str, str]], Iterable[Issue]] | None = None


def writers() -> dict[str, tuple[str, Writer]]:
    """Return title and writer of the language of each family of robots.

    If several languages serve a family, Tandem's own one counts. Languages whose writer cannot be loaded are
    left out.
    """
    out: dict[str, tuple[str, Writer]] = {}
    for language in plugins.usable(Language).values():
        with contextlib.suppress(PluginError):
            title_and_writer = language.title, plugins.load(language.writer, Writer)
            out |= {family: title_and_writer for family in language.families if family not in out}
    return out


def manufacturer_languages() -> dict[str, tuple[str, Writer]]:
    """Return the result of :func:`writers` without languages for arms of any family."""
    return {
        family: title_and_writer
        for family, title_and_writer in writers().items()
        if not title_and_writer[1].opt_in
    }


def writers_in_use(arms: Iterable[Arm]) -> list[Writer]:
    """Return the writers of arms in the order of the languages; arms without a writer are left out."""
    families = {arm.data.family for arm in arms}
    return list(dict.fromkeys(writer for family, (_, writer) in writers().items() if family in families))


def writer_of(arm: Arm) -> Writer:
    """Return the writer of an arm's programs.

    Raises:
        TandemError: No language is available for the arm's family (``post.language``).
    """
    for writer in writers_in_use([arm]):
        return writer
    raise TandemError(no_writer_issue(arm))


def no_writer_issue(arm: Arm) -> Issue:
    """Return the issue that no programs are written for the controller of an arm (``post.language``)."""
    family, manufacturers = arm.data.family, manufacturer_languages()
    reason = f"is of the family {family}, whose language is not written yet"
    if arm.data.axes > 6:
        reason = "has seven axes, and no supported language of a controller states seven joints"
    if (language := plugins.language_of(family)) is not None:
        try:
            plugins.load(language.writer, Writer)
        except PluginError as error:
            reason = f"is of the family {family}, and the writer of {language.title} {error}"
    reason += "; allowed are " + ", ".join(f"{name} ({title})" for name, (title, _) in manufacturers.items())
    remedies = [writer.opt_in for _, writer in writers().values() if writer.opt_in]
    hint = "; else ".join([*remedies, f"plan with an arm of {' or '.join(manufacturers)}"])
    hint += "; check still reports its reach"
    return Issue("post.language", f"arm {arm.name} ({arm.robot}) {reason}", arm=arm.name, hint=hint)
