"""What programs say, ask, switch and wait for on their straight ways, and between which moves."""

from __future__ import annotations

import bisect
import dataclasses
import functools

from planner.verify.job import JobText, TaskText
from planner.verify.segment_names import said
from planner.verify.steps import MessageStep, MoveStep, SignalStep, Step, WaitStep

STATE = "#STATE"
"""What the panel of a KUKA controller shows while a program waits, in forms that their own reader holds."""


@dataclasses.dataclass(frozen=True)
class Spoken:
    """One step of a task. ``before`` and ``after``: the moves of any task that come before it and after it,
    None for none; ``group``: how often straight moves have begun behind joint moves by then. ``meanwhile``:
    a move of another task, or of several at once, that nothing keeps from going on at the same time."""

    task: TaskText
    step: Step
    before: MoveStep | None
    after: MoveStep | None
    group: int
    meanwhile: MoveStep | None

    @property
    def kind(self) -> str:
        """``told``, ``asked``, ``on``, ``off`` or ``wait``; "" for what no program should have."""
        step = self.step
        if isinstance(step, MessageStep):
            if step.confirm:
                return "asked" if step.certain else ""
            return "told" if step.panel == "line" else ""
        if isinstance(step, SignalStep):
            return {1.0: "on", 0.0: "off"}.get(step.value, "")
        return "wait" if isinstance(step, WaitStep) and not step.signal else ""

    @property
    def at_joints(self) -> bool:
        """Whether the move before goes by joints, or there is none."""
        return self.before is None or self.before.by_joints

    @property
    def to_joints(self) -> bool:
        """Whether the next move goes by joints, or there is none."""
        return self.after is None or self.after.by_joints

    @functools.cached_property
    def behind(self) -> str:
        """The key of the segment of the move before."""
        return "" if self.before is None else said(self.before.procedure).key

    @functools.cached_property
    def ahead(self) -> str:
        """The key of the segment of the next move."""
        return "" if self.after is None else said(self.after.procedure).key


def spoken(job: JobText) -> dict[str, list[Spoken]]:
    """The steps of each task, by its name. Steps of the handshake of two controllers are left out, but for
    what they ask."""
    rows = _rows(job)
    moves = [(place, row.step) for place, row in enumerate(rows) if isinstance(row.step, MoveStep)]
    places = [place for place, _ in moves]
    group, groups, joints = 0, [0], True
    for _, move in moves:
        group += joints and not move.by_joints
        joints = move.by_joints
        groups.append(group)
    out: dict[str, list[Spoken]] = {task.name: [] for task in job.tasks}
    for place, row in enumerate(rows):
        if isinstance(row.step, MoveStep) or not _counts(row):
            continue
        k = bisect.bisect_left(places, place)
        before = moves[k - 1][1] if k else None
        after = moves[k][1] if k < len(moves) else None
        out[row.task.name].append(
            Spoken(row.task, row.step, before, after, groups[k], _meanwhile(job, row.task, row.stage))
        )
    return out


@dataclasses.dataclass(frozen=True)
class _Row:
    stage: int
    task: TaskText
    step: Step
    protocol: bool


def _rows(job: JobText) -> list[_Row]:
    """All steps of all tasks, stage by stage."""
    stage_of = {
        id(step): number
        for number, stage in enumerate(job.stages)
        for steps in stage.steps.values()
        for step in steps
    }
    rows: list[tuple[int, int, int, _Row]] = []
    for n, task in enumerate(job.tasks):
        reading = None if job.readings is None else job.readings.get(task.name)
        stage = 0
        for k, step in enumerate(task.steps):
            stage = stage_of.get(id(step), stage)
            protocol = reading is not None and reading.protocol[k]
            rows.append((stage, n, k, _Row(stage, task, step, protocol)))
    return [row for *_, row in sorted(rows, key=lambda item: item[:3])]


def _counts(row: _Row) -> bool:
    """Whether a step is one that this is about: a wait of no time is not, nor are arrivals."""
    step = row.step
    if isinstance(step, MessageStep):
        return step.kind != STATE
    if row.protocol:
        return False
    if isinstance(step, WaitStep):
        return bool(step.signal) or step.pause != 0.0 or (step.kind == "WaitTime" and step.seconds is None)
    return isinstance(step, SignalStep)


def _meanwhile(job: JobText, task: TaskText, number: int) -> MoveStep | None:
    """A move that may be under way while a task says something in a stage."""
    stage = job.stages[number]
    for other in job.tasks:
        if stage.moves(other.name) and (other is not task or (stage.synchronised and len(job.tasks) > 1)):
            return stage.moves(other.name)[0]
    return None
