"""The straight way of a trajectory file: its rows as steps of each arm, which meet around each goal.

One controller moves all joints, so a goal in which several arms move is a synchronised block, and in one in
which one of them moves the others stand where they stood, number by number. What is asked, switched and
waited for stands in the way of the first arm. A move with segments is work: its points are passed on the
cubic that the controller lays through positions and velocities. One without is a way from rest to rest,
straight in joint space. The first point of either is where it begins."""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NoReturn

import numpy as np

from planner.catalogue.robots import RobotData
from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, to_quaternion
from planner.languages.trajectories.reader import rows
from planner.programs import steps

PASSED, WAY = "passed", "way"
"""Kinds of moves: to a point that is passed in work, and from rest to rest outside of it."""
BEGINS: Final = {PASSED: "passed first", WAY: "way first"}
"""The same to where a goal begins, at which an arm stands but for what it is off."""
BLOCK, WORLD = "block", "wobj0"
"""What the frames of work are called here: that in which the block stands, and the world."""
WAY_LABEL: Final = "main"
"""Segment of what is no work."""
_NO_LIMIT: Final = steps.Speed(math.inf, math.inf, math.inf, math.inf)
_STOP: Final = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_PASSES: Final = steps.Zone(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_AXES: Final = np.zeros(6)


def pose(values: Sequence[float]) -> FloatArray:
    """Pose (4, 4) of a position [m] and a rotation vector [rad]."""
    return from_parts(exp_rotation(np.array(values[3:])), np.array(values[:3]))


def columns(program: rows.Program) -> dict[str, slice]:
    """Where the joints of each arm stand among the numbers of a row."""
    out, first = {}, 0
    for arm in program.arms:
        out[arm.arm] = slice(first, first + len(arm.joints))
        first += len(arm.joints)
    return out


def flow(program: rows.Program, data: Mapping[str, RobotData]) -> dict[str, tuple[steps.Step, ...]]:
    """{arm: its steps} of a program without faults; ``data`` of the arms' robots. Raises `FlowError`."""
    return _Runner(program, data).run()


class _Runner:
    def __init__(self, program: rows.Program, data: Mapping[str, RobotData]) -> None:
        self.program, self.data = program, data
        self.arms = [arm.arm for arm in program.arms]
        self.columns = columns(program)
        self.out: dict[str, list[steps.Step]] = {arm: [] for arm in self.arms}
        self.tools: dict[str, tuple[str, steps.Tool]] = {}
        self.operation: rows.OperationRow | None = None
        self.label = WAY_LABEL
        """Where in the work of its operation an arm stands."""
        self.frames: dict[tuple[int, int], steps.WorkObject] = {}
        self.here: tuple[float, ...] | None = None
        self.goals = self.ids = 0

    def run(self) -> dict[str, tuple[steps.Step, ...]]:
        for arm in self.program.arms:
            wanted = self.data[arm.arm].axes
            if len(arm.joints) != wanted:
                self._fail(arm, f"{len(arm.joints)} joints of {arm.arm}; its robot has {wanted}")
        for row in self.program.rows:
            self._row(row)
        return {arm: tuple(own) for arm, own in self.out.items()}

    def _fail(self, row: rows.Row, message: str) -> NoReturn:
        raise steps.FlowError([steps.Fault(row.line, 1, "trajectory.flow", message, self.program.file)])

    def _where(self, row: rows.Row, label: str = "main") -> tuple[str, str, int, str]:
        return self.program.file.rpartition("/")[2], label, row.line, ""

    def _row(self, row: rows.Row) -> None:
        where, lead = self._where(row), self.out[self.arms[0]]
        match row:
            case rows.OperationRow():
                self.operation, self.label = row, WAY_LABEL
            case rows.CarryRow(arm=arm, mass=mass, centre=centre, axes=axes, inertia=inertia):
                turn = to_quaternion(exp_rotation(np.array(axes)))
                load = steps.Load(mass, np.array(centre), turn, np.array(inertia))
                self.out[arm].append(steps.CarryStep(*where, load, f"what {arm} holds"))
            case rows.ToolRow(tool=name, arm=arm, tcp=tcp, mass=mass, centre=centre):
                load = steps.Load(mass, np.array(centre), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
                self.tools[arm] = name, steps.Tool(True, pose(tcp), load)
            case rows.AtRow(at=values):
                self.here = values if self.here is None else self.here
            case rows.TellRow(text=text):
                lead.append(steps.MessageStep(*where, "tell", (text,), False, text, False, "line"))
            case rows.AskRow(text=text):
                lead.append(steps.MessageStep(*where, "ask", (text,), True, text, True))
                self._meet(row, "WaitSyncTask", f"asked_{row.line}")
            case rows.SetRow(signal=signal, to=value):
                lead.append(steps.SignalStep(*where, "set", signal, float(value), 0.0, True))
            case rows.AwaitRow(signal=signal, to=value, within=seconds):
                lead.append(steps.WaitStep(*where, "await", seconds, signal, float(value), True))
            case rows.DwellRow(seconds=seconds):
                if seconds <= 0.0:
                    self._fail(row, f"a dwell of {seconds:g} s")
                lead.append(steps.WaitStep(*where, "dwell", seconds, "", None, True))
            case rows.MoveRow():
                self._move(row)

    def _meet(self, row: rows.Row, kind: str, ident: str) -> None:
        if len(self.arms) > 1:
            for arm in self.arms:
                self.out[arm].append(steps.SyncStep(*self._where(row), kind, ident, tuple(self.arms)))

    def _move(self, row: rows.MoveRow) -> None:
        if self.here is None:
            self._fail(row, "a move before any row says where the arms stand (at)")
        missing = [arm for arm in row.arms if arm not in self.tools]
        if missing or self.operation is None:
            what = "operation" if self.operation is None else f"tool of {missing[0]}"
            self._fail(row, f"a move before any row says the {what}")
        holder = self.operation.held_by
        if holder and holder not in self.tools:
            self._fail(row, f"a move before any row says the tool of {holder}, which holds the block")
        self._checked(row)
        self.goals += 1
        together = len(row.arms) > 1
        self._meet(row, "SyncMoveOn" if together else "WaitSyncTask", f"goal_{self.goals}")
        begun, *points = row.points
        if begun.segment or not points:
            self._fail(
                row, "the first point of a move is where it begins; a segment, or the way, is behind it"
            )
        labels = {point.segment for point in points}
        works = labels != {""}
        if works and "" in labels:
            self._fail(row, "points before the first segment of a move")
        if not works and len(points) != 1:
            what = "a way has two points, the one where it begins and its end, straight from rest to rest; "
            self._fail(row, f"{what}this has {len(row.points)}")
        before, label = 0.0, self.label if works else WAY_LABEL
        self.label = row.points[-1].segment or WAY_LABEL
        for point in row.points:
            self.ids += 1
            for arm in row.arms:
                kind = PASSED if works else WAY
                kind = BEGINS[kind] if point is begun else kind
                self.out[arm].append(
                    self._step(point.segment or label, kind, point, arm, point.t - before, together)
                )
            before = point.t
        self._meet(row, "SyncMoveOff" if together else "WaitSyncTask", f"goal_{self.goals}_end")
        self.here = row.points[-1].q

    def _checked(self, row: rows.MoveRow) -> None:
        """Times ascend, the move ends at rest, and what stands keeps its numbers."""
        before = 0.0
        stood = self.here or ()
        still = [i for arm in self.arms if arm not in row.arms for i in _range(self.columns[arm])]
        for point in row.points:
            if not point.t > before:
                self._fail(point, f"t is {point.t:g} s behind {before:g} s; times ascend from above 0")
            before = point.t
            for i in still:
                if point.q[i] != stood[i] or point.v[i] != 0.0:
                    self._fail(
                        point, f"number {i + 1} belongs to an arm that stands in this move, and changes"
                    )
        last = row.points[-1]
        if any(last.v):
            self._fail(last, "the last point of a move is no rest: a velocity is not 0")

    def _step(
        self, label: str, kind: str, point: rows.Point, arm: str, time: float, together: bool
    ) -> steps.MoveStep:
        own = self.columns[arm]
        q, v = np.array(point.q[own]), np.array(point.v[own])
        name, tool = self.tools[arm]
        if kind in (PASSED, BEGINS[PASSED]):
            target: steps.PassedTarget | steps.JointTarget = steps.PassedTarget(q, v, _NO_AXES)
        else:
            target = steps.JointTarget(self.data[arm].to_controller(q), _NO_AXES)
        stops = not any(point.v)
        return steps.MoveStep(
            *self._where(point, label),
            kind,
            target,
            "",
            self.ids if together else None,
            time,
            None,
            _NO_LIMIT,
            _STOP if stops else _PASSES,
            "a stop" if stops else "a passed point",
            tool,
            name,
            *self._frame(arm),
            (),
        )

    def _frame(self, arm: str) -> tuple[steps.WorkObject, str]:
        """The frame of an arm's work: the block's, which stands; where one arm holds it the world for that
        one, and for the other one what its tool carries."""
        operation = self.operation
        if operation is None:
            return steps.WorkObject(False, True, "", np.eye(4), np.eye(4)), BLOCK
        holder = operation.held_by
        if arm == holder:
            return self._known(0, steps.WorkObject(False, True, "", np.eye(4), np.eye(4))), WORLD
        if holder:
            tool = self.tools[holder][1].pose
            return self._known(id(tool), steps.WorkObject(False, False, holder, np.eye(4), tool)), BLOCK
        block = steps.WorkObject(False, True, "", np.eye(4), pose(operation.block))
        return self._known(operation.line, block), BLOCK

    def _known(self, key: int, made: steps.WorkObject) -> steps.WorkObject:
        line = 0 if self.operation is None else self.operation.line
        return self.frames.setdefault((line, key), made)


def _range(some: slice) -> range:
    return range(some.start, some.stop)
