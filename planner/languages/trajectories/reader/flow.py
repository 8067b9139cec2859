"""Converts the rows of a trajectory file to the steps of each arm, with meetings around each goal.

One controller moves all joints. A goal in which several arms move is a synchronised block. In a goal in
which one arm moves, the others keep their joint values exactly. Questions, switched outputs and waits are
steps of the first arm. A move with segments is work: its points are passed on the cubic that the controller
interpolates through positions and velocities. A move without segments is a rest-to-rest move, straight in
joint space. The first point of either is its start.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NoReturn

import numpy as np

from planner.catalogue.robots import RobotData
from planner.geometry.arrays import FloatArray, exp_rotation, from_parts, to_quaternion
from planner.languages.trajectories.reader import rows
from planner.programs import steps

PASSED, REST_TO_REST = "passed", "way"
"""Kinds of moves: to a point that is passed during work, and from rest to rest outside of work."""
FIRST_POINT_KINDS: Final = {PASSED: "passed first", REST_TO_REST: "way first"}
"""Kinds of the first point of a goal, by kind of move. The arm stands there, up to a deviation."""
BLOCK, WORLD = "block", "wobj0"
"""Names of the work frames: that of the block, and the world."""
NO_WORK_SEGMENT: Final = "main"
"""Segment of moves outside of work."""
_NO_LIMIT: Final = steps.MoveSpeed(math.inf, math.inf, math.inf, math.inf)
"""Speed of moves, which state times instead."""
_STOP: Final = steps.Zone(True, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Corner at a point with zero velocity."""
_FLY_BY: Final = steps.Zone(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Corner at a point that is passed: the curve goes through the point."""
_NO_AXES: Final = np.zeros(6)
"""Values of the external axes, which these files do not move."""


def pose(values: Sequence[float]) -> FloatArray:
    """Return the pose (4, 4) of a position [m] and a rotation vector [rad]."""
    return from_parts(exp_rotation(np.array(values[3:])), np.array(values[:3]))


def columns(program: rows.TrajectoryProgram) -> dict[str, slice]:
    """Return the slice of each arm's joints among the numbers of a row, by arm."""
    out = {}
    first = 0
    for arm in program.arms:
        out[arm.arm] = slice(first, first + len(arm.joints))
        first += len(arm.joints)
    return out


def main_flow(
    program: rows.TrajectoryProgram, data: Mapping[str, RobotData]
) -> dict[str, tuple[steps.ProgramStep, ...]]:
    """Return the steps of each arm, for a program without faults.

    Args:
        program: The program.
        data: Data of the arms' robots.

    Raises:
        FlowError: A row is not allowed where it is, or a value is not allowed.
    """
    return _TrajectoryRunner(program, data).run()


class _TrajectoryRunner:
    """Follows the rows of one file.

    Attributes:
        arms: Names of the arms in the file's order. Steps that concern no arm belong to the first one.
        columns: Slice of each arm's joints among the numbers of a row, by arm.
        out: Steps so far, by arm.
        tools: Name and data of the tool that each arm carries, by arm.
        operation: Row of the current operation, None before the first one.
        label: Segment in which the last move ended, ``NO_WORK_SEGMENT`` outside of work.
        frames: Work frames so far, by line of the operation and key of the frame. Equal ones are one object.
        posture: Joints [rad] of all arms after the last move, None before the first check of the joints.
            Before the first move it is the posture of that check.
        goals: Number of moves so far.
        ids: Number of points so far.
    """

    def __init__(self, program: rows.TrajectoryProgram, data: Mapping[str, RobotData]) -> None:
        self.program, self.data = program, data
        self.arms = [arm.arm for arm in program.arms]
        self.columns = columns(program)
        self.out: dict[str, list[steps.ProgramStep]] = {arm: [] for arm in self.arms}
        self.tools: dict[str, tuple[str, steps.Tool]] = {}
        self.operation: rows.OperationRow | None = None
        self.label = NO_WORK_SEGMENT
        self.frames: dict[tuple[int, int], steps.WorkObject] = {}
        self.posture: tuple[float, ...] | None = None
        self.goals = self.ids = 0

    def run(self) -> dict[str, tuple[steps.ProgramStep, ...]]:
        """Return the steps of each arm."""
        for arm in self.program.arms:
            joint_count = self.data[arm.arm].axes
            if len(arm.joints) != joint_count:
                self._fail(arm, f"{arm.arm} has {len(arm.joints)} joints; its robot has {joint_count}")
        for row in self.program.rows:
            self._row(row)
        return {arm: tuple(arm_steps) for arm, arm_steps in self.out.items()}

    def _fail(self, row: rows.TrajectoryRow, message: str) -> NoReturn:
        raise steps.FlowError([steps.TextFault(row.line, 1, "trajectory.flow", message, self.program.file)])

    def _where(self, row: rows.TrajectoryRow, label: str = "main") -> tuple[str, str, int, str]:
        return self.program.file.rpartition("/")[2], label, row.line, ""

    def _row(self, row: rows.TrajectoryRow) -> None:
        """Append the steps of a row, or store its data for later moves.

        Operations and tools are stored. The first check of the joints gives the start posture. Later checks
        have no effect here: a rule compares them with the moves. A question is also a meeting of all arms.
        """
        where = self._where(row)
        lead_steps = self.out[self.arms[0]]
        match row:
            case rows.OperationRow():
                self.operation = row
                self.label = NO_WORK_SEGMENT
            case rows.CarryRow(arm=arm, mass=mass, centre=centre, axes=axes, inertia=inertia):
                quaternion = to_quaternion(exp_rotation(np.array(axes)))
                load = steps.LoadData(mass, np.array(centre), quaternion, np.array(inertia))
                self.out[arm].append(steps.CarryStep(*where, load, f"what {arm} holds"))
            case rows.ToolRow(tool=name, arm=arm, tcp=tcp, mass=mass, centre=centre):
                load = steps.LoadData(mass, np.array(centre), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
                self.tools[arm] = name, steps.Tool(True, pose(tcp), load)
            case rows.AtRow(at=values):
                self.posture = values if self.posture is None else self.posture
            case rows.TellRow(text=text):
                lead_steps.append(steps.MessageStep(*where, "tell", (text,), False, text, False, "line"))
            case rows.AskRow(text=text):
                lead_steps.append(steps.MessageStep(*where, "ask", (text,), True, text, True))
                self._meet(row, "WaitSyncTask", f"asked_{row.line}")
            case rows.SetRow(signal=signal, to=value):
                lead_steps.append(steps.SignalStep(*where, "set", signal, float(value), 0.0, True))
            case rows.AwaitRow(signal=signal, to=value, within=seconds):
                lead_steps.append(steps.WaitStep(*where, "await", seconds, signal, float(value), True))
            case rows.DwellRow(seconds=seconds):
                if seconds <= 0.0:
                    self._fail(row, f"a dwell of {seconds:g} s")
                lead_steps.append(steps.WaitStep(*where, "dwell", seconds, "", None, True))
            case rows.MoveRow():
                self._move(row)

    def _meet(self, row: rows.TrajectoryRow, kind: str, ident: str) -> None:
        """Append a meeting of all arms, if the file has several. ``kind`` is the RAPID instruction for it."""
        if len(self.arms) > 1:
            for arm in self.arms:
                self.out[arm].append(steps.SyncStep(*self._where(row), kind, ident, tuple(self.arms)))

    def _move(self, row: rows.MoveRow) -> None:
        """Append the points of a goal as moves of its arms, between two meetings of all arms.

        A goal of work has a start without segment, then points with segments. A rest-to-rest move has two
        points without segments.

        Raises:
            FlowError: The points have another form, or a row that must precede the move is missing.
        """
        if self.posture is None:
            self._fail(row, "a move precedes the first check of the joints (at)")
        missing = [arm for arm in row.arms if arm not in self.tools]
        if missing or self.operation is None:
            missing_row = "operation" if self.operation is None else f"tool of {missing[0]}"
            self._fail(row, f"a move precedes the row of the {missing_row}")
        holder = self.operation.held_by
        if holder and holder not in self.tools:
            self._fail(row, f"a move precedes the row of the tool of {holder}, which holds the block")
        self._check_move(row)
        self.goals += 1
        several_arms = len(row.arms) > 1
        self._meet(row, "SyncMoveOn" if several_arms else "WaitSyncTask", f"goal_{self.goals}")
        start_point, *points = row.points
        if start_point.segment or not points:
            self._fail(row, "the first point of a move must be its start; a segment, or the end, follows it")
        labels = {point.segment for point in points}
        is_work = labels != {""}
        if is_work and "" in labels:
            self._fail(row, "points before the first segment of a move")
        if not is_work and len(points) != 1:
            self._fail(
                row, f"a rest-to-rest move has two points, its start and its end; got {len(row.points)}"
            )
        previous_time = 0.0
        # the start of a move in work belongs to the segment in which the previous move has ended
        label = self.label if is_work else NO_WORK_SEGMENT
        self.label = row.points[-1].segment or NO_WORK_SEGMENT
        for point in row.points:
            self.ids += 1
            for arm in row.arms:
                kind = PASSED if is_work else REST_TO_REST
                kind = FIRST_POINT_KINDS[kind] if point is start_point else kind
                self.out[arm].append(
                    self._step(
                        point.segment or label, kind, point, arm, point.t - previous_time, several_arms
                    )
                )
            previous_time = point.t
        self._meet(row, "SyncMoveOff" if several_arms else "WaitSyncTask", f"goal_{self.goals}_end")
        self.posture = row.points[-1].q

    def _check_move(self, row: rows.MoveRow) -> None:
        """Check that times increase, the move ends at rest, and arms that do not move keep their joints.

        Such an arm must have exactly the joints of the previous posture, and zero velocities, at each point.
        """
        previous_time = 0.0
        start_posture = self.posture or ()
        unmoved = [i for arm in self.arms if arm not in row.arms for i in _indices(self.columns[arm])]
        for point in row.points:
            if not point.t > previous_time:
                self._fail(
                    point,
                    f"t is {point.t:g} s after {previous_time:g} s; times must be positive and increase",
                )
            previous_time = point.t
            for i in unmoved:
                if point.q[i] != start_posture[i] or point.v[i] != 0.0:
                    self._fail(
                        point, f"number {i + 1} belongs to an arm that stands still in this move, but changes"
                    )
        last_point = row.points[-1]
        if any(last_point.v):
            self._fail(last_point, "the last point of a move is not at rest: a velocity is not 0")

    def _step(
        self, label: str, kind: str, point: rows.TrajectoryPoint, arm: str, time: float, together: bool
    ) -> steps.MoveStep:
        """Return the move of one arm to a point.

        The target is a point that is passed if ``kind`` is one of work, and joints otherwise. ``label`` is
        the segment. ``time`` [s] counts from the previous point. If several arms move (``together``), their
        moves to this point have a common number.
        """
        arm_columns = self.columns[arm]
        q, v = np.array(point.q[arm_columns]), np.array(point.v[arm_columns])
        name, tool = self.tools[arm]
        if kind in (PASSED, FIRST_POINT_KINDS[PASSED]):
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
            _STOP if stops else _FLY_BY,
            "a stop" if stops else "a passed point",
            tool,
            name,
            *self._frame(arm),
            (),
        )

    def _frame(self, arm: str) -> tuple[steps.WorkObject, str]:
        """Return the work frame of an arm with its name: the frame of the block.

        If an arm holds the block, the work frame is the world for that arm, and the holder's TCP frame for
        the others.
        """
        operation = self.operation
        if operation is None:
            return steps.WorkObject(False, True, "", np.eye(4), np.eye(4)), BLOCK
        holder = operation.held_by
        if arm == holder:
            return self._shared_frame(0, steps.WorkObject(False, True, "", np.eye(4), np.eye(4))), WORLD
        if holder:
            tool = self.tools[holder][1].pose
            return self._shared_frame(
                id(tool), steps.WorkObject(False, False, holder, np.eye(4), tool)
            ), BLOCK
        block = steps.WorkObject(False, True, "", np.eye(4), pose(operation.block))
        return self._shared_frame(operation.line, block), BLOCK

    def _shared_frame(self, key: int, frame: steps.WorkObject) -> steps.WorkObject:
        """Return the first frame with this key in the current operation, or ``frame`` if it is the first.

        Equal frames are one object, so that the proof recognises them.
        """
        line = 0 if self.operation is None else self.operation.line
        return self.frames.setdefault((line, key), frame)


def _indices(columns: slice) -> range:
    return range(columns.start, columns.stop)
