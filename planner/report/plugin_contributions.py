"""Contributions of processes and languages to the report: values that the report draws, never HTML.

The report imports neither processes nor languages. It finds their contributions by
:mod:`planner.runtime.plugins`: those of the processes of a problem, and of the languages of its
controllers.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.issues import issue_error
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Setup, torch_signals
from planner.proof.verdict import CutFace, Proof
from planner.report.charts import ChartLine, FaceWords, LimitLine, MapRulings
from planner.report.markup import Phrase, Tile
from planner.runtime import plugins
from planner.runtime.plugins import Language, PluginError, Process

SetupRow = tuple[Phrase, Phrase]
"""A name and its value."""
ControllerCheck = tuple[str, str]
"""What to check at a controller, and the required state."""


@dataclasses.dataclass(frozen=True)
class EdgeSpeed:
    """Speed of the fastest point of a tool's edge inside the stock, from the replay of the proof.

    Attributes:
        time: Time [s], (N,).
        speed: Speed [m/s], (N,), NaN outside the stock.
        label: Keys of the segments, (N,).
        title: Title of the speed among the colours of the replay.
    """

    time: FloatArray
    speed: FloatArray
    label: Sequence[str]
    title: str


@dataclasses.dataclass(frozen=True)
class TimeChart:
    """A chart over the time of the motion, with curves in one ``unit``. The report adds the segments."""

    title: str
    lines: tuple[ChartLine, ...]
    unit: str
    note: str
    levels: tuple[LimitLine, ...] = ()
    y_range: tuple[float, float] | None = None


@dataclasses.dataclass(frozen=True)
class ProcessMotion:
    """What a process adds to the charts of the motion.

    Attributes:
        speeds: Speeds for the chart of feeds. They replace the feeds of the plan.
        clearances: Curves [mm] that are added to the chart of clearances.
        distances: Charts that follow those of clearances.
        charts: Charts that follow those of joint limits and singular postures.
    """

    speeds: tuple[EdgeSpeed, ...] = ()
    clearances: tuple[ChartLine, ...] = ()
    distances: tuple[TimeChart, ...] = ()
    charts: tuple[TimeChart, ...] = ()


def _no_contribution(*_: object) -> tuple[()]:
    return ()


def _no_motion(*_: object) -> ProcessMotion:
    return ProcessMotion()


@dataclasses.dataclass(frozen=True)
class ReportOfProcess:
    """Contribution of a process to the report. By default it adds nothing.

    Attributes:
        tiles: Key values of a plan and its proof.
        setup_rows: Rows of the setup sheet about an operation. Its exhibits of kind ``setup`` follow.
        motion: Charts of the motion, from the plan and the series of the proof.
        rulings: Rulings of ruled faces, by key of the segment. The map of such a face is unrolled.
        faces: Words for simulated faces, by kind of the segment.
        clearance_rules: Codes of rules that decide whether the minimum clearance is sufficient.
        hot: What the operator mounts and the power heats, such as "the wire".
    """

    tiles: Callable[[Plan, Proof | None], tuple[Tile, ...]] = _no_contribution
    setup_rows: Callable[[Setup, Plan, OperationPlan, Proof | None], Sequence[SetupRow]] = _no_contribution
    motion: Callable[[Plan, Mapping[str, Any]], ProcessMotion] = _no_motion
    rulings: Callable[[Sequence[Claim]], Sequence[tuple[str, MapRulings]]] = _no_contribution
    faces: Mapping[str, FaceWords] = dataclasses.field(default_factory=dict)
    clearance_rules: tuple[str, ...] = ()
    hot: str = ""


def process_reports(problem: Problem) -> tuple[ReportOfProcess, ...]:
    """Return the contributions of the processes of a problem, in the order of the plug-ins.

    Args:
        problem: Problem.

    Raises:
        TandemError: The contribution of an installed package cannot be loaded
            (``problem.process_package``).
    """
    used = {operation.process for operation in problem.operations}
    # Processes with the same contribution add it once.
    names_by_report = {
        process.report: name
        for name, process in plugins.usable(Process).items()
        if name in used and process.report
    }
    try:
        return tuple(
            plugins.part_of(Process, name, "report", ReportOfProcess) for name in names_by_report.values()
        )
    except PluginError as error:
        raise issue_error("problem.process_package", str(error)) from error


def face_words(problem: Problem, face: CutFace) -> FaceWords:
    """Return the words that a process has for deviations of a simulated face, or the general ones."""
    candidates = (process.faces.get(face.segment.kind) for process in process_reports(problem))
    return next((words for words in candidates if words is not None), FaceWords())


@dataclasses.dataclass(frozen=True)
class ControllerSetup:
    """One or several controllers that are programmed as one, before the first run.

    Attributes:
        problem: Problem.
        plan: Plan.
        arms: Arms of the controller that take part, in the order of the cell.
        joined: Whether it is synchronised with another controller by handshake.
    """

    problem: Problem
    plan: Plan
    arms: tuple[Arm, ...]
    joined: bool

    @property
    def signals(self) -> list[str]:
        """Signals that switch power and that the programs of the controller set."""
        return power_signals(self.problem, self.plan, self.arms)

    @property
    def hot(self) -> str:
        """What the operator mounts and the power heats, or an empty text."""
        return " and ".join(process.hot for process in process_reports(self.problem) if process.hot)

    def torch_checks(self, signals: Sequence[str], restart: str) -> list[ControllerCheck]:
        """Return the checks of the setup sheet for a stop while a torch burns.

        They state what to do at this controller, whether the torch is switched by it or by a joined one.

        Args:
            signals: Signals of the controller.
            restart: Instruction to start its program from the beginning, as part of a sentence.
        """
        torches = torch_signals(self.problem.operations)
        arms = self.problem.cell.arms if self.joined else ()
        torches_by_arm = {
            arm.name: torches & set(power_signals(self.problem, self.plan, [arm])) for arm in arms
        }
        restart += ", at both controllers" if any(torches_by_arm.values()) else ""
        advice = (
            f"the program ends: move the torch out by hand, inspect the sheet, {restart}; it cuts all slots, "
        )
        advice += "so use an uncut sheet, or plan the remaining slots again"
        other_advice = f"this program restarts too: {restart}; its controller does not see the torch"
        torch_signals_here = [signal for signal in signals if signal in torches]
        out = [(f"{signal} on at a stop: never set again by hand", advice) for signal in torch_signals_here]
        other_arms = set(torches_by_arm) - {arm.name for arm in self.arms}
        other_signals = [
            (signal, name)
            for name in torches_by_arm
            if name in other_arms
            for signal in sorted(torches_by_arm[name])
        ]
        return out + [
            (f"{signal} of arm {name} on at a stop", other_advice) for signal, name in other_signals
        ]


def power_signals(problem: Problem, plan: Plan, arms: Iterable[Arm]) -> list[str]:
    """Return the signals that switch power and that the programs of some arms set.

    The actions of an operation are in the program of its first arm in the order of the cell.

    Args:
        problem: Problem.
        plan: Plan.
        arms: Arms.
    """
    order = [arm.name for arm in problem.cell.arms]
    names = {arm.name for arm in arms}
    targets_of_arms = (op.targets for op in plan.operations if min(op.targets.arms, key=order.index) in names)
    actions = (action for targets in targets_of_arms for action in targets.actions)
    return list(
        dict.fromkeys(
            power_action.signal
            for power_action in actions
            if power_action.kind == "on" and power_action.switches_power
        )
    )


def signal_numbers(problem: Problem, arm: Arm) -> str:
    """Return the numbers of signals at an arm's controller, as text that is appended to a sentence."""
    numbers = problem.cell.controller.io.get(arm.name, {})
    return "".join(f"; {signal} is number {number}" for signal, number in numbers.items())


@dataclasses.dataclass(frozen=True)
class ReportOfLanguage:
    """Contribution of a robot language to the report.

    Attributes:
        checks: What to check at a controller before the first run.
        programs: Rows of the setup sheet about the programs of arms of the cell.
        load_compensation: Name of the load compensation that the controllers have.
    """

    checks: Callable[[ControllerSetup], Sequence[ControllerCheck]] = _no_contribution
    programs: Callable[[Problem, Sequence[Arm]], Sequence[SetupRow]] = _no_contribution
    load_compensation: str = "Absolute Accuracy"


def reports_by_language(arms: Iterable[Arm]) -> list[tuple[ReportOfLanguage, tuple[Arm, ...]]]:
    """Group arms by the languages of their controllers, in the order of the plug-ins.

    Arms whose language contributes nothing to the report are left out.

    Args:
        arms: Arms.

    Raises:
        TandemError: The contribution of an installed language cannot be loaded (``post.language``).
    """
    arms = tuple(arms)
    out = []
    for name, language in plugins.usable(Language).items():
        arms_of_language = tuple(arm for arm in arms if arm.data.family in language.families)
        if arms_of_language and language.report is not None:
            try:
                out.append((plugins.part_of(Language, name, "report", ReportOfLanguage), arms_of_language))
            except PluginError as error:
                raise issue_error("post.language", str(error)) from error
    return out
