"""What processes and languages add to the report: values that the report draws, never HTML.

The report imports neither processes nor languages. It finds their parts by :mod:`planner.runtime.plugins`:
those of the processes of a problem, and of the languages that its controllers read.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.issues import refusal
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Problem, Setup, torch_signals
from planner.proof.verdict import CutFace, Proof
from planner.report.charts import FaceWords, Level, Line, Rulings
from planner.report.markup import Phrase, Tile
from planner.runtime import plugins
from planner.runtime.plugins import Language, PluginError, Process

Row = tuple[Phrase, Phrase]
"""A name and its value."""
Check = tuple[str, str]
"""What to check at a controller, and how it must be."""


@dataclasses.dataclass(frozen=True)
class EdgeSpeed:
    """Speed of the fastest point of a tool's edge inside the stock, as the proof replays it.

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
    """A chart over the time of the motion. The report adds the segments."""

    title: str
    lines: tuple[Line, ...]
    unit: str
    note: str
    levels: tuple[Level, ...] = ()
    y_range: tuple[float, float] | None = None


@dataclasses.dataclass(frozen=True)
class ProcessMotion:
    """What a process adds to the charts of the motion.

    Attributes:
        speeds: Speeds for the chart of feeds. They replace the feeds of the plan.
        clearances: Lines [mm] for the chart of clearances.
        distances: Charts after those of clearances.
        charts: Charts after those of joint limits and singular postures.
    """

    speeds: tuple[EdgeSpeed, ...] = ()
    clearances: tuple[Line, ...] = ()
    distances: tuple[TimeChart, ...] = ()
    charts: tuple[TimeChart, ...] = ()


def _nothing(*_: object) -> tuple[()]:
    return ()


def _no_motion(*_: object) -> ProcessMotion:
    return ProcessMotion()


@dataclasses.dataclass(frozen=True)
class ReportOfProcess:
    """Parts of the report that a process supplies. By default it adds nothing.

    Attributes:
        tiles: Key figures of a plan and its proof.
        setup_rows: Rows of the setup sheet about an operation. Its exhibits of kind ``setup`` follow.
        motion: Charts of the motion, from the plan and the series of the proof.
        rulings: Rulings of ruled faces, by key of the segment. The map of such a face is laid flat.
        faces: Words for simulated faces, by kind of the segment.
        clearance_rules: Codes of rules that decide whether the least clearance is sufficient.
        hot: What the operator mounts and the power heats, such as "the wire".
    """

    tiles: Callable[[Plan, Proof | None], tuple[Tile, ...]] = _nothing
    setup_rows: Callable[[Setup, Plan, OperationPlan, Proof | None], Sequence[Row]] = _nothing
    motion: Callable[[Plan, Mapping[str, Any]], ProcessMotion] = _no_motion
    rulings: Callable[[Sequence[Claim]], Sequence[tuple[str, Rulings]]] = _nothing
    faces: Mapping[str, FaceWords] = dataclasses.field(default_factory=dict)
    clearance_rules: tuple[str, ...] = ()
    hot: str = ""


def of_processes(problem: Problem) -> tuple[ReportOfProcess, ...]:
    """Return what the processes of a problem add, in the order of the plug-ins.

    Raises:
        TandemError: The contribution of an installed package cannot be loaded (``problem.process_package``).
    """
    used = {operation.process for operation in problem.operations}
    found = {p.report: name for name, p in plugins.usable(Process).items() if name in used and p.report}
    try:
        return tuple(plugins.part_of(Process, name, "report", ReportOfProcess) for name in found.values())
    except PluginError as error:
        raise refusal("problem.process_package", str(error)) from error


def face_words(problem: Problem, face: CutFace) -> FaceWords:
    """Return what deviations of a simulated face are called."""
    known = (process.faces.get(face.segment.kind) for process in of_processes(problem))
    return next((words for words in known if words is not None), FaceWords())


@dataclasses.dataclass(frozen=True)
class ControllerSetup:
    """A controller, or several that one language programs as one, before the first run.

    Attributes:
        arms: Arms of the controller that take part, in the order of the cell.
        joined: Whether it meets another controller by handshake.
    """

    problem: Problem
    plan: Plan
    arms: tuple[Arm, ...]
    joined: bool

    @property
    def signals(self) -> list[str]:
        """Signals that power something and that the programs of the controller switch on."""
        return powered(self.problem, self.plan, self.arms)

    @property
    def hot(self) -> str:
        """What the operator mounts and the power heats, or nothing."""
        return " and ".join(process.hot for process in of_processes(self.problem) if process.hot)

    def torch_checks(self, signals: Sequence[str], restart: str) -> list[Check]:
        """Say what follows a stop at which a torch burned.

        Args:
            signals: Signals of the controller.
            restart: How its program starts from the beginning.
        """
        torches = torch_signals(self.problem.operations)
        arms = self.problem.cell.arms if self.joined else ()
        lit = {arm.name: torches & set(powered(self.problem, self.plan, [arm])) for arm in arms}
        restart += ", at both controllers" if any(lit.values()) else ""
        words = (
            f"the program ends: torch out by hand, sheet looked at, {restart}; it cuts all slots, so on a "
        )
        words += "sheet without them, else plan anew what is left"
        also = f"this program begins anew, too: {restart}; its controller knows nothing of the torch"
        own = [signal for signal in signals if signal in torches]
        out = [(f"{signal} on at a stop: never set again by hand", words) for signal in own]
        others = set(lit) - {arm.name for arm in self.arms}
        rows = [(signal, name) for name in lit if name in others for signal in sorted(lit[name])]
        return out + [(f"{signal} of arm {name} on at a stop", also) for signal, name in rows]


def powered(problem: Problem, plan: Plan, arms: Iterable[Arm]) -> list[str]:
    """Return the signals that power something and that the programs of arms switch on."""
    order = [arm.name for arm in problem.cell.arms]
    names = {arm.name for arm in arms}
    own = (op.targets for op in plan.operations if min(op.targets.arms, key=order.index) in names)
    actions = (action for targets in own for action in targets.actions)
    return list(dict.fromkeys(one.signal for one in actions if one.kind == "on" and one.powers))


def numbered_signals(problem: Problem, arm: Arm) -> str:
    """State the numbers of signals at the controller of an arm, to follow other words."""
    numbers = problem.cell.controller.io.get(arm.name, {})
    return "".join(f"; {signal} is number {number}" for signal, number in numbers.items())


@dataclasses.dataclass(frozen=True)
class ReportOfLanguage:
    """Parts of the report that a robot language supplies.

    Attributes:
        checks: What to check at a controller before the first run.
        programs: Rows of the setup sheet about the programs of arms of the cell.
        load_compensation: How its controllers compensate loads by themselves.
    """

    checks: Callable[[ControllerSetup], Sequence[Check]] = _nothing
    programs: Callable[[Problem, Sequence[Arm]], Sequence[Row]] = _nothing
    load_compensation: str = "Absolute Accuracy"


def by_language(arms: Iterable[Arm]) -> list[tuple[ReportOfLanguage, tuple[Arm, ...]]]:
    """Divide arms by the languages of their controllers, in the order of the plug-ins.

    Raises:
        TandemError: The contribution of an installed language cannot be loaded (``post.language``).
    """
    arms = tuple(arms)
    out = []
    for name, language in plugins.usable(Language).items():
        own = tuple(arm for arm in arms if arm.data.family in language.families)
        if own and language.report is not None:
            try:
                out.append((plugins.part_of(Language, name, "report", ReportOfLanguage), own))
            except PluginError as error:
                raise refusal("post.language", str(error)) from error
    return out
