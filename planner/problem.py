"""The problem to plan, as values in SI units: cell, stock, part, operations.

:mod:`planner.reading.problem` reads these from YAML. Each process defines its own operation class; the
protocol :class:`Operation` states what the rest of the package requires of it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Protocol, runtime_checkable

import numpy as np

from planner.catalogue.materials import FoamMaterial, SheetMetal
from planner.catalogue.robots import JointStiffness, RobotData, robot
from planner.claims.claim import ForceFrame
from planner.claims.handshake import Handshake
from planner.claims.sentences import (
    KEEP_OFF,
    KEEP_OFF_COORDINATED,
    KEEP_OFF_GANTRY,
    KEEP_OFF_POSITIONER,
    KEEP_OFF_TABLE,
    WORK_DONE,
)
from planner.geometry.arrays import FloatArray, Mesh, RuledSurface, Shape, exp_rotation
from planner.geometry.units import DEG
from planner.issues import Issue
from planner.tooling import Gripper, Tool

KrlDialect = Literal["krc4", "krc2"]
"""Generation of KUKA controllers for which KRL is written."""
KrlPath = Literal["slin", "spline"]
"""Motion of KUKA arms between targets: single linear moves or spline blocks."""


@dataclasses.dataclass(frozen=True)
class SagCompensation:
    """Compensation of the sag of an arm: the sagged arm reaches the nominal pose of its target.

    Attributes:
        load: Whether the weight of the tool and of a held stock bends the arm. False if the controller
            compensates for them itself.
        max_correction: Maximum correction [m] at the TCP.
    """

    load: bool
    max_correction: float


@dataclasses.dataclass(frozen=True)
class Force:
    """Force of the process on a tool at its TCP while it works.

    Attributes:
        vectors: Forces (K, 3) [N].
        height: Heights (K,) [m] of the TCP in the stock frame, ascending; K = 1 for a constant force.
        frame: Frame of the vectors: stock, TCP or feed, as :class:`planner.claims.claim.ArmSags` defines
            them.
    """

    vectors: FloatArray
    height: FloatArray
    frame: ForceFrame


MAX_BLIND_SPEED_M_S: Final = 0.25
"""Maximum speed [m/s] of motion that starts at an unknown position or goes to a station.

It limits an arm on its way to the first target, a track, and the bodies that a turntable carries.
"""


@dataclasses.dataclass(frozen=True)
class LinearAxis:
    """A linear axis under an arm. At value v [m] the bodies that it carries are moved by v times ``axis``.

    Attributes:
        axis: Unit vector (3,) in the world.
        low: Lower end of the range [m].
        high: Upper end of the range [m].
        speed: Maximum speed [m/s].
        acceleration: Maximum acceleration [m/s^2].
        unit: Name of the mechanical unit.
        home: Position [m] before a program starts.
        follow_fraction: Fraction of the tool's motion along the axis that the axis follows while the arm
            works; None if it stands still then.
        column: Index among the external axes of the arm's program, from 0.
        axis_name: Name of the axis within a gantry; empty for a track.
        carries: Bodies of the cell that are mounted on the axis, placed at its value 0.
    """

    axis: FloatArray
    low: float
    high: float
    speed: float
    acceleration: float
    unit: str
    home: float
    follow_fraction: float | None = None
    column: int = 0
    axis_name: str = ""
    carries: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Name of the axis for texts: its mechanical unit, and the axis of that unit."""
        return f"{self.unit} {self.axis_name}".strip()

    def translate(self, pose: FloatArray, value: float) -> FloatArray:
        """Return a pose (4, 4) in the world translated by ``value`` [m] along the axis."""
        translated = np.array(pose, dtype=np.float64)
        translated[:3, 3] += value * self.axis
        return translated


def motion_order(
    axes: Mapping[str, LinearAxis], start: Mapping[str, float], goal: Mapping[str, float]
) -> tuple[str, ...]:
    """Return the names of linear axes under one arm in the order in which they move, one after the other.

    First the axes that come closer to their homes move, from the arm down to the floor. Then the others move,
    from the floor up. So a column is raised before the bridge under it moves. Axes that keep their values are
    left out.

    Args:
        axes: Axes by name, from the floor up.
        start: Values [m] before the motion.
        goal: Values [m] after the motion.
    """
    names = [name for name in axes if goal[name] != start[name]]
    homing = []
    for name in names:
        goal_distance, start_distance = (abs(values[name] - axes[name].home) for values in (goal, start))
        if start_distance - goal_distance > HOME_DISTANCE_TOLERANCE_M:
            homing.append(name)
    return (*reversed(homing), *(name for name in names if name not in homing))


STOCK_AXIS: Final = "stock"
"""Name of a turntable's value among the stations. No arm can have this name."""
TILT_AXIS: Final = "stock/tilt"
"""Name of the value of a positioner's tilt axis among the stations. No arm can have this name."""
END_SUFFIX: Final = "//end"
"""Suffix of an arm's name among the stations. The value is that of its coordinated track after an operation.

No value of a gantry axis can have such a name, because there the name of the axis follows a single slash.
"""
TURNTABLE_BODY: Final = "turntable"
"""Name of the body of the cell that is a turntable's plate."""
HOME_DISTANCE_TOLERANCE_M: Final = 1e-6
"""Distances [m] of linear axes from home are taken as equal if they differ by at most this."""
EXTERNAL_AXIS_DECIMALS: Final = 4
"""Decimals with which programs write values of external axes [mm, deg]."""
EXTERNAL_AXIS_FAMILIES: Final = ("ABB", "KUKA")
"""Families of arms for whose languages tracks, turntables and positioners are supported."""


@dataclasses.dataclass(frozen=True)
class RotaryAxis:
    """An axis that rotates the stock by its value [rad], right-handed about ``axis`` through ``centre``.

    Attributes:
        arm: Arm whose program moves the axis.
        unit: Name of the mechanical unit.
        column: Index among the external axes of that program, from 0.
        centre: Point (3,) [m] on the axis, in the world.
        axis: Unit vector (3,) in the world.
        low: Lower end of the range [rad].
        high: Upper end of the range [rad].
        speed: Maximum speed [rad/s].
        home: Value [rad] before a program starts.
        acceleration: Maximum acceleration [rad/s^2]; infinite if not stated.
        axis_name: Name of the axis, if its unit has two.
    """

    arm: str
    unit: str
    column: int
    centre: FloatArray
    axis: FloatArray
    low: float
    high: float
    speed: float
    home: float
    acceleration: float = float("inf")
    axis_name: str = ""

    @property
    def label(self) -> str:
        """Name of the axis for texts: its mechanical unit, and the axis of that unit."""
        return f"{self.unit} {self.axis_name}".strip()

    def rotate(self, pose: FloatArray, value: float | FloatArray) -> FloatArray:
        """Return poses (..., 4, 4) in the world rotated by values (...,) [rad] about the axis."""
        rotation = exp_rotation(np.asarray(value)[..., None] * self.axis)
        shape = np.broadcast_shapes(rotation.shape[:-2], pose.shape[:-2])
        rotated = np.array(np.broadcast_to(pose, (*shape, 4, 4)), dtype=np.float64)
        rotated[..., :3, :3] = rotation @ rotated[..., :3, :3]
        offset = rotated[..., :3, 3] - self.centre
        rotated[..., :3, 3] = self.centre + (rotation @ offset[..., None])[..., 0]
        return rotated


@dataclasses.dataclass(frozen=True)
class Turntable(RotaryAxis):
    """Rotary axis that carries the stock and its support. It is vertical if all values are 0.

    Its plate, round about the axis, is the body :data:`TURNTABLE_BODY` of the cell.

    Attributes:
        tilt: Tilt axis of a positioner, fixed in the world, which tilts the rotary axis, the plate and the
            bracket; None for a turntable without tilt.
        bracket: Bodies of the cell that tilt with a positioner.
        load: Maximum payload [kg], None if not stated.
    """

    tilt: RotaryAxis | None = None
    bracket: tuple[str, ...] = ()
    load: float | None = None

    @property
    def kind(self) -> str:
        """Name of the device for texts."""
        return "turntable" if self.tilt is None else "positioner"

    @property
    def axes(self) -> dict[str, RotaryAxis]:
        """Axes by the names of their values among the stations, in the order in which they move."""
        return {STOCK_AXIS: self} if self.tilt is None else {STOCK_AXIS: self, TILT_AXIS: self.tilt}

    @property
    def tilted_bodies(self) -> tuple[str, ...]:
        """Bodies of the cell that move with the tilt axis."""
        return () if self.tilt is None else (TURNTABLE_BODY, *self.bracket)

    def axis_at_tilt(self, name: str, tilt: float) -> RotaryAxis:
        """Return the axis with that name in :attr:`axes`, as it lies in the world at a tilt [rad]."""
        if name == TILT_AXIS or self.tilt is None:
            return self.axes[name]
        pose = np.eye(4)
        pose[:3, 3] = self.centre
        pose = self.tilt.rotate(pose, tilt)
        return dataclasses.replace(self, centre=pose[:3, 3], axis=pose[:3, :3] @ self.axis)

    def move_pose(
        self,
        pose: FloatArray,
        values: Mapping[str, float | FloatArray],
        reference: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return poses (..., 4, 4) in the world of a body that moves with the turntable.

        Args:
            pose: Pose (4, 4) at the values ``reference``.
            values: Values [rad] by the names of :attr:`axes`, one each or arrays (...,) for several poses.
                The default is 0.
            reference: Values [rad] at which the body has the pose ``pose``. The default is 0.
        """
        reference = reference or {}
        if self.tilt is not None:
            pose = self.tilt.rotate(pose, -reference.get(TILT_AXIS, 0.0))
        pose = self.rotate(pose, values.get(STOCK_AXIS, 0.0) - reference.get(STOCK_AXIS, 0.0))
        return pose if self.tilt is None else self.tilt.rotate(pose, values.get(TILT_AXIS, 0.0))


@dataclasses.dataclass(frozen=True)
class Arm:
    """One robot of a cell.

    Attributes:
        name: Name of the arm.
        robot: Name in the catalogue, or name of ``custom_data``.
        base: Base pose (4, 4) in the world. In a cell: at axis values 0; in a setup: at ``axis_positions``.
        tool: Tool on the flange.
        home: Joint values at home (6,) [rad].
        base_auto: Whether the placement search may move the base.
        stiffness: Joint stiffness from the robot's file, else from the catalogue; None if neither states it.
        sag: Sag compensation; None if the arm has none.
        custom_data: Data of a robot from a file of the user; None for one of the catalogue.
        linear_axes: Axes that carry the base, from the floor up: one is a track, two or three are a gantry.
        axis_positions: Values [m] of these axes in a setup; empty in a cell.
    """

    name: str
    robot: str
    base: FloatArray
    tool: Tool
    home: FloatArray
    base_auto: bool = False
    stiffness: JointStiffness | None = None
    sag: SagCompensation | None = None
    custom_data: RobotData | None = None
    linear_axes: tuple[LinearAxis, ...] = ()
    axis_positions: tuple[float, ...] = ()

    @property
    def axes_by_name(self) -> dict[str, LinearAxis]:
        """Axes under the arm by the names of their values among the stations, from the floor up.

        The name is "arm" for the track and "arm/axis" for an axis of the gantry of an arm called "arm".
        """
        return {
            f"{self.name}/{axis.axis_name}" if axis.axis_name else self.name: axis
            for axis in self.linear_axes
        }

    @property
    def axis_values(self) -> dict[str, float]:
        """Values [m] of the linear axes by name; empty for an arm of a cell."""
        return dict(zip(self.axes_by_name, self.axis_positions, strict=True)) if self.axis_positions else {}

    @property
    def track(self) -> LinearAxis | None:
        """Axis of the track under the arm; None for a fixed arm and for one on a gantry."""
        return self.linear_axes[0] if len(self.linear_axes) == 1 else None

    @property
    def track_position(self) -> float | None:
        """Value [m] of the arm's track; None if there is none or it is not set."""
        return self.axis_positions[0] if len(self.axis_positions) == 1 else None

    @property
    def has_coordinated_track(self) -> bool:
        """Whether the arm has a coordinated track, which moves while the arm works."""
        return self.track is not None and self.track.follow_fraction is not None

    def at_stations(self, values: Mapping[str, float]) -> "Arm":
        """Return the arm with its linear axes at these values [m], by the names of :attr:`axes_by_name`.

        Raises:
            KeyError: If the value of an axis is missing.
        """
        base = self.base
        current = self.axis_values
        for name, axis in self.axes_by_name.items():
            base = axis.translate(base, values[name] - current.get(name, 0.0))
        return dataclasses.replace(
            self, base=base, axis_positions=tuple(values[name] for name in self.axes_by_name)
        )

    @property
    def data(self) -> RobotData:
        """Data of the robot. Raises as :func:`planner.catalogue.robots.robot`."""
        return robot(self.robot) if self.custom_data is None else self.custom_data


@dataclasses.dataclass(frozen=True)
class Obstacle:
    """A body of the cell, placed in the world by the poses of its shapes. Only external axes may move it."""

    name: str
    shapes: tuple[Shape, ...]

    def transform(self, motion: FloatArray) -> "Obstacle":
        """Return the body transformed by ``motion`` (4, 4) in the world."""
        shapes = tuple(dataclasses.replace(shape, pose=motion @ shape.pose) for shape in self.shapes)
        return dataclasses.replace(self, shapes=shapes)


@dataclasses.dataclass(frozen=True)
class BentWire:
    """A bent wire or strip that is available in a cell.

    Attributes:
        material: Name in the table of materials.
        length: Hot length [m]: the part between the clamps, which is heated.
        thickness: Diameter, or thickness of a strip [m].
        width: Width of a strip [m], None for a round wire.
        temperature: Temperature while it cuts [C].
    """

    material: str
    length: float
    thickness: float
    width: float | None
    temperature: float


@dataclasses.dataclass(frozen=True)
class Cell:
    """Robots with the bodies and devices around them.

    Attributes:
        name: Name of the cell.
        arms: Arms.
        obstacles: Bodies around the arms, including those that external axes carry.
        controller: Names of tasks and signals, and limits of the controllers.
        grippers: Available grippers, of which one is chosen for a stock that an arm holds.
        wires: Available bent wires, of which one is chosen if an operation states none.
        turntable: Turntable under the stock; None if the stock stands still.
    """

    name: str
    arms: tuple[Arm, ...]
    obstacles: tuple[Obstacle, ...]
    controller: "Controller"
    grippers: tuple[Gripper, ...] = ()
    wires: tuple[BentWire, ...] = ()
    turntable: Turntable | None = None

    def arm(self, name: str) -> Arm:
        """Return the arm of that name.

        Raises:
            KeyError: If no arm has that name.
        """
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)

    def linear_axis(self, name: str) -> tuple[Arm, LinearAxis]:
        """Return the arm of a linear axis and the axis, by the name of its value among the stations.

        Raises:
            KeyError: If no axis has that name.
        """
        for arm in self.arms:
            if name in arm.axes_by_name:
                return arm, arm.axes_by_name[name]
        raise KeyError(name)

    @property
    def carried_bodies(self) -> dict[str, tuple[str, ...]]:
        """Bodies of the cell that are mounted on an axis, by the name of its value among the stations.

        The axes are the tilt axis of a positioner and the linear axes. Axes without bodies are left out.
        """
        bodies_by_axis = {name: axis.carries for arm in self.arms for name, axis in arm.axes_by_name.items()}
        bodies_by_axis[TILT_AXIS] = () if self.turntable is None else self.turntable.tilted_bodies
        return {name: bodies for name, bodies in bodies_by_axis.items() if bodies}

    def carried_motions(self, goal: Mapping[str, float], start: Mapping[str, float]) -> dict[str, FloatArray]:
        """Return the motions (4, 4) in the world of bodies on axes, by the names of :attr:`carried_bodies`.

        Args:
            goal: Axis values [m, rad] after the motion, by the names of the axes. The default is 0.
            start: Axis values before it. The default is 0.
        """
        motions = {}
        table = self.turntable
        for arm in self.arms:
            motion = np.eye(4)
            for name, axis in arm.axes_by_name.items():  # from the floor up: each carries the following ones
                motion = axis.translate(motion, goal.get(name, 0.0) - start.get(name, 0.0))
                motions[name] = motion
        if table is not None and table.tilt is not None:
            motions[TILT_AXIS] = table.tilt.rotate(
                np.eye(4), goal.get(TILT_AXIS, 0.0) - start.get(TILT_AXIS, 0.0)
            )
        return {name: motions[name] for name in self.carried_bodies}

    def with_moved_bodies(self, goal: Mapping[str, float], start: Mapping[str, float]) -> "Cell":
        """Return the cell with the bodies on axes moved from axis values ``start`` to ``goal`` [m, rad]."""
        motions = self.carried_motions(goal, start)
        motion_of_body = {
            body: motions[name] for name, bodies in self.carried_bodies.items() for body in bodies
        }
        bodies = tuple(
            obstacle.transform(motion_of_body[obstacle.name]) if obstacle.name in motion_of_body else obstacle
            for obstacle in self.obstacles
        )
        return dataclasses.replace(self, obstacles=bodies) if motion_of_body and goal != start else self


def default_output_name(request: str) -> str:
    """Return the default name of the output that a request drives."""
    return f"{request}Out"


@dataclasses.dataclass(frozen=True)
class PowerOutput:
    """Output that the controller switches when the program requests it.

    Attributes:
        signal: Name of the output.
        device: Name of the device of an ABB controller to which it is wired; empty if it is not wired.
        bit: Number of the bit of the device.
    """

    signal: str
    device: str = ""
    bit: int = 0


@dataclasses.dataclass(frozen=True)
class DeviceBit:
    """Wiring of a signal of an ABB controller.

    Attributes:
        device: Name of the device.
        bit: Number of the bit of the device.
    """

    device: str
    bit: int = 0


@dataclasses.dataclass(frozen=True)
class Interlock:
    """Interlock of power: the signal of a program only requests it, and the controller switches an output.

    Attributes:
        outputs: {signal that the program sets as a request: output that is switched}.
        cycle: System output of an ABB controller that is high while a program runs.
        motors: System output of an ABB controller that is high while motors are on.
        device_bits: {arm: {signal: wiring}} of signals that do not switch power, at ABB controllers.
    """

    outputs: Mapping[str, PowerOutput] = dataclasses.field(default_factory=dict)
    cycle: str = "soCycleOn"
    motors: str = "soMotorsOn"
    device_bits: Mapping[str, Mapping[str, DeviceBit]] = dataclasses.field(default_factory=dict)

    def power_output(self, request: str) -> PowerOutput:
        """Return the output that a request drives. Names are compared without case.

        The default is an output without wiring, with the name of the request and the suffix ``Out``.
        """
        outputs = {name.lower(): output for name, output in self.outputs.items()}
        return outputs.get(request.lower(), PowerOutput(default_output_name(request)))

    def device_bit(self, arm: str, signal: str) -> DeviceBit | None:
        """Return the wiring of a signal that does not switch power; None if the cell does not state it."""
        bits = {name.lower(): device_bit for name, device_bit in self.device_bits.get(arm, {}).items()}
        return bits.get(signal.lower())


@dataclasses.dataclass(frozen=True)
class Controller:
    """Addresses of the controller in programs: tasks, mechanical units, signals, and limits of a module.

    Attributes:
        tasks: Name of the task of each arm. Tasks of two controllers may have the same name.
        units: Name of the mechanical unit of each arm. Units of two controllers may have the same name.
        wire_signal: Signal that powers the wire.
        max_moves: Maximum number of moves of a module.
        max_bytes: Maximum size of a module [bytes].
        sync: "multimove" for one controller with all arms; "handshake" for one controller per arm.
        handshake: Signals with which controllers meet.
        dialect: KRL dialect of KUKA arms.
        io: {arm: {signal: number}} of the inputs and outputs of KUKA and UR controllers, which have no names.
        path: Motion of KUKA arms between targets: single linear moves or spline blocks.
        robotware: Main version of ABB controllers.
        interlock: Conditions of power besides the program.
        robots: Names of the robots in the configuration of ABB controllers; empty if they are those of
            ``units``.
        options: Installed options; None if the cell does not state them.
        language: Language of all programs: "own" for that of each arm's family, "ros" for joint trajectories.
        joint_prefix: {arm: prefix of the names of its joints}, for joint trajectories.
        path_tolerance: Tolerance [rad] of each joint on the path, for joint trajectories.
        goal_tolerance: Tolerance [rad] of each joint at the goal, for joint trajectories.
        goal_time: Time [s] by which a goal may be late, for joint trajectories.
    """

    tasks: tuple[str, ...] = ("T_ROB1", "T_ROB2")
    units: tuple[str, ...] = ("ROB_1", "ROB_2")
    wire_signal: str = "doWirePower"
    max_moves: int = 5000
    max_bytes: int = 1_000_000
    sync: Literal["multimove", "handshake"] = "multimove"
    handshake: Handshake = dataclasses.field(default_factory=Handshake)
    dialect: KrlDialect = "krc4"
    io: Mapping[str, Mapping[str, int]] = dataclasses.field(default_factory=dict)
    path: KrlPath = "slin"
    robotware: Literal[6, 7] = 6
    interlock: Interlock = dataclasses.field(default_factory=Interlock)
    robots: tuple[str, ...] = ()
    options: tuple[str, ...] | None = None
    language: str = "own"
    joint_prefix: Mapping[str, str] = dataclasses.field(default_factory=dict)
    path_tolerance: float = 2.0 * DEG
    goal_tolerance: float = 0.2 * DEG
    goal_time: float = 2.0

    def robot_name(self, arm_index: int) -> str:
        """Return the name under ``/MOC/ROBOT`` of the robot of the cell's arm ``arm_index`` (from 0)."""
        return self.robots[arm_index] if self.robots else self.units[arm_index]

    def signal_number(self, arm: str, signal: str) -> int | None:
        """Return the number of a signal of a KUKA or UR arm; None if the cell does not state it."""
        numbers = {name.lower(): value for name, value in self.io.get(arm, {}).items()}
        return numbers.get(signal.lower())


@dataclasses.dataclass(frozen=True)
class FormedPart:
    """A part to be formed from the sheet.

    By the sine law t = t0 cos(a), where t0 is the initial thickness and a the wall angle, a sheet formed in
    one pass keeps its thickness along z everywhere. So one face is the other face translated along z.

    Attributes:
        mesh: Lower face of the part in the stock frame, with normals up.
        file_mesh: Mesh of the file in that frame, if ``mesh`` is the face recovered from it within
            ``tolerance``; None if both are the same.
        tolerance: Tolerance [m] of ``mesh``; 0 for a mesh without noise.
        stated_tolerance: Tolerance [m] that the user states; None if it was estimated.
    """

    mesh: Mesh
    file_mesh: Mesh | None = None
    tolerance: float = 0.0
    stated_tolerance: float | None = None

    @property
    def source(self) -> Mesh:
        """Mesh of the user's file, in the stock frame."""
        return self.mesh if self.file_mesh is None else self.file_mesh


@dataclasses.dataclass(frozen=True)
class Part:
    """The part to make, in the stock frame: an open front and back face, or a formed sheet.

    Attributes:
        front: Front face as an open mesh with normals away from the part.
        back: Back face as an open mesh with normals away from the part.
        ruled: Ruled surfaces by name, including the ``edges`` that join front and back.
        notes: Findings of the reader for the user (deviations, kinks).
        formed: Part formed from a sheet.
    """

    front: Mesh | None = None
    back: Mesh | None = None
    ruled: tuple[RuledSurface, ...] = ()
    notes: tuple[Issue, ...] = ()
    formed: FormedPart | None = None


@dataclasses.dataclass(frozen=True)
class SheetHole:
    """A closed curve along which an operation has cut a sheet.

    Attributes:
        name: Name of the curve.
        ring: Curve in plan (K, 2) [m].
        inside: Whether the sheet inside the curve is cut off. Otherwise all that is outside is.
        face_offset: Offset [m] in plan, outward or inward, by which the cut may deviate on the other face of
            the sheet.
    """

    name: str
    ring: FloatArray
    inside: bool = True
    face_offset: float = 0.0


@dataclasses.dataclass(frozen=True)
class FormingStages:
    """Operations that form a sheet before and after a given operation, each with its features.

    Operations that form only a single level are left out.

    Attributes:
        previous: (name, numbers of the features that it forms; None for all) of the operations before the
            given one, in order.
        following: (name, numbers of features) of the operations after it, in order.
        stays_clamped: Whether the sheet stays clamped after the given operation.
    """

    previous: tuple[tuple[str, tuple[int, ...] | None], ...] = ()
    following: tuple[tuple[str, tuple[int, ...] | None], ...] = ()
    stays_clamped: bool = False


@dataclasses.dataclass(frozen=True)
class Sheet:
    """Properties of a stock that is a clamped sheet, besides its size.

    Attributes:
        metal: Material.
        opening: Opening of the clamp (K, 2) [m], a closed convex outline in the sheet plane about the origin
            of the stock frame.
        border: Stiffness of the clamp's grip in plane per length [N/m^2]: 0 if the sheet slides, infinite if
            it is rigidly clamped.
        formed: Convex solids in the stock frame that enclose all parts of the sheet that stand out of its
            plane at any time of the forming. Bodies of the cell keep clear of them from the start.
        holes: Curves along which earlier operations have cut it.
        stages: Other operations that form it, seen from the operation that finds it in this state; None if
            this is not stated or no operation forms it.
        die: Whether an operation has put a die under the sheet. No problem states that a die is removed.
    """

    metal: SheetMetal
    opening: FloatArray
    border: float = 0.0
    formed: tuple[Shape, ...] = ()
    holes: tuple[SheetHole, ...] = ()
    stages: FormingStages | None = None
    die: bool = False


@dataclasses.dataclass(frozen=True)
class Pedestal:
    """Support that Tandem designs for a block.

    Attributes:
        kind: Table or pedestal.
        sides: Available side lengths [m].
        heights: Available heights [m].
        width_fraction: Maximum ratio of the support's sides to those of the block.
        overhang: Width [m] by which the support extends beyond the block on each side.
    """

    kind: Literal["table", "pedestal"]
    sides: tuple[float, ...]
    heights: tuple[float, ...]
    width_fraction: float
    overhang: float = 0.0


@dataclasses.dataclass(frozen=True)
class Stock:
    """The stock: a block or a clamped sheet.

    The stock frame is at the centre of the bottom face of the datum block, with z up through the block
    (through the thickness of a sheet).

    Attributes:
        size: Size of the datum block (3,) [m].
        place: Pose (4, 4) of the stock frame in the world; None if the placement search determines it. For a
            held block: the pose about which the holder moves it. On a turntable: at value 0 in a problem, at
            ``station`` and ``tilt`` in a setup.
        attitude: Rotation (3, 3) of the stock frame, up to a yaw about the world's vertical.
        support: Shapes in the stock frame under the block that move with it (pedestal); the clamp of a sheet.
        any_attitude: Whether ``attitude`` is free; for a held block.
        oversize: Oversize (2, 3) [m] beyond the datum block on the lower and the upper side along x, y and z,
            as an operation finds it.
        foam: Foam of the block.
        held_by: Arm whose tool holds the block.
        grip: Pose (4, 4) of the stock frame in the TCP frame of that arm.
        grip_chosen: Whether Tandem chooses the grip.
        pedestal: Support to be designed, as high as the placement requires (``planner.cell.support``), in
            place of ``support``.
        sheet: Properties of a sheet clamped along its rim; None for a block.
        station: Value [rad] of the turntable in a setup.
        tilt: Value [rad] of a positioner's tilt axis in a setup.
    """

    size: FloatArray
    place: FloatArray | None
    attitude: FloatArray
    support: tuple[Shape, ...] = ()
    any_attitude: bool = False
    oversize: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((2, 3)))
    foam: FoamMaterial | None = None
    held_by: str | None = None
    grip: FloatArray = dataclasses.field(default_factory=lambda: np.eye(4))
    grip_chosen: bool = False
    pedestal: Pedestal | None = None
    sheet: Sheet | None = None
    station: float | None = None
    tilt: float | None = None

    @property
    def axis_values(self) -> dict[str, float]:
        """Values [rad] of the turntable's axes by their names among the stations; empty without one."""
        axis_values = {STOCK_AXIS: self.station, TILT_AXIS: self.tilt}
        return {name: value for name, value in axis_values.items() if value is not None}

    def at_station(self, table: Turntable, values: Mapping[str, float]) -> "Stock":
        """Return the stock with the axes of its turntable at these values [rad], by the names of the axes.

        Raises:
            ValueError: If the pose of the stock is unknown.
        """
        if self.place is None:
            raise ValueError("the place of a block on a turntable is not known")
        pose = table.move_pose(self.place, values, self.axis_values)
        return dataclasses.replace(
            self, place=pose, attitude=pose[:3, :3], station=values[STOCK_AXIS], tilt=values.get(TILT_AXIS)
        )

    @property
    def lower(self) -> FloatArray:
        """Lowest corner (3,) [m] of the block with its oversize, in the stock frame."""
        return np.asarray(np.array([-0.5, -0.5, 0.0]) * self.size - self.oversize[0])

    @property
    def upper(self) -> FloatArray:
        """Highest corner (3,) [m] of the block with its oversize, in the stock frame."""
        return np.asarray(np.array([0.5, 0.5, 1.0]) * self.size + self.oversize[1])

    @property
    def box(self) -> FloatArray:
        """Both corners (2, 3) [m] of the block with its oversize, in the stock frame."""
        return np.stack([self.lower, self.upper])

    @property
    def mass(self) -> float | None:
        """Mass [kg] of the block with its oversize; None without a foam."""
        return None if self.foam is None else float(np.prod(self.upper - self.lower)) * self.foam.density

    @property
    def is_attitude_free(self) -> bool:
        """Whether the search may give the block any attitude. Other blocks than held ones stand on a face."""
        return self.any_attitude and self.held_by is not None and self.place is None

    @property
    def gravity(self) -> FloatArray:
        """Unit vector (3,) of gravity in the stock frame, equal for all yaw angles of the block."""
        return -self.attitude[2, :]


@runtime_checkable
class Operation(Protocol):
    """Fields and methods that the operations of all processes have."""

    name: str
    process: str
    arms: tuple[str, ...]

    def leaves(self, stock: Stock) -> Stock:
        """Return the stock as the next operation finds it."""


def allows_any_attitude(operation: Operation) -> bool:
    """Whether targets and claims of an operation do not depend on the attitude of the block.

    This is so if its process declares it (``any_lean = True`` in its schema).
    """
    return bool(getattr(operation, "any_lean", False))


def allows_moving_base(operation: Operation) -> bool:
    """Whether the base of its arm may move while an operation is executed.

    This is so if its process declares it (``any_base = True`` in its schema).
    """
    return bool(getattr(operation, "any_base", False))


def lights_torch(operation: Operation) -> bool:
    """Whether the signal of an operation lights a torch, which is so for trimming with a torch."""
    return operation.process == "trim" and getattr(getattr(operation, "by", None), "kind", "torch") == "torch"


def torch_signals(operations: Sequence[Operation]) -> frozenset[str]:
    """Return the signals that light the torches of operations."""
    signals = (getattr(operation, "signal", None) for operation in operations if lights_torch(operation))
    return frozenset(signal for signal in signals if isinstance(signal, str))


@runtime_checkable
class HasFixtures(Protocol):
    """An operation that adds fixtures or shapes to the stock, from which bodies must keep clear."""

    def with_fixtures(
        self, stock: Stock, part: Part | None, previous_operations: Sequence[Operation]
    ) -> Stock:
        """Return the stock with the bodies of fixtures that bodies of the cell keep clear of.

        Args:
            stock: Stock as the operation finds it.
            part: Part, or None.
            previous_operations: Operations before this one.
        """


FORMING: Final = "forming"
"""Name of the process that forms sheets.

The fields of :class:`FormingOperation` alone do not tell it, because other processes may have the same ones.
"""


@runtime_checkable
class FormingOperation(Protocol):
    """An operation of the process :data:`FORMING`.

    Attributes:
        name: Name of the operation.
        process: Name of the process.
        features: Numbers of the features of its part that it forms; None for all.
        level: Level that a one-pass operation forms alone; None for all.
    """

    name: str
    process: str
    features: tuple[int, ...] | None
    level: object


DEFAULT_SELF_CLEARANCE_M: Final = 0.005
"""Default clearance [m] between links and tool of one arm, if ``Settings.clearance`` is larger.

Smaller than other clearances because it depends only on the arm's own axes and the calibration of its tool
(decision 0031).
"""


@dataclasses.dataclass(frozen=True)
class Settings:
    """Limits that motion and proof share, with margins. The defaults are those of problem files.

    A margin is the distance by which a plan stays inside a limit.

    Attributes:
        clearance: Clearance [m] between bodies.
        own_clearance: Clearance [m] between links and tool of one arm as stated, None if it is not stated.
            :attr:`self_clearance` is the effective one.
        speed_fraction: Fraction of the joint speed limits.
        acceleration_fraction: Fraction of the joint acceleration limits.
        joint_margin: Margin [rad] to joint limits.
        singularity_margin: Margin [rad] to singularities.
        tcp_speed: Maximum speed of the TCP [m/s].
        seed: Seed of random numbers.
    """

    clearance: float = 0.010
    own_clearance: float | None = None
    speed_fraction: float = 0.9
    acceleration_fraction: float = 0.8
    joint_margin: float = 2.0 * DEG
    singularity_margin: float = 5.0 * DEG
    tcp_speed: float = 0.25
    seed: int = 0

    @property
    def self_clearance(self) -> float:
        """Clearance [m] between links and tool of one arm; at most the clearance between other bodies."""
        stated = DEFAULT_SELF_CLEARANCE_M if self.own_clearance is None else self.own_clearance
        return min(self.clearance, stated)

    def widen_clearances(self, by: float) -> "Settings":
        """Return the settings with both clearances increased by a distance [m]."""
        return dataclasses.replace(
            self, clearance=self.clearance + by, own_clearance=self.self_clearance + by
        )


@dataclasses.dataclass(frozen=True)
class SetupChange:
    """Change of the cell before an operation.

    Attributes:
        tools: New tools by arm.
        stock: New values of fields of :class:`Stock` by name.
        steps: Instructions for the operator, one sentence each.
    """

    tools: Mapping[str, Tool] = dataclasses.field(default_factory=dict)
    stock: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    steps: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Setup:
    """State of the cell for consecutive operations: mounted tools, and the stock as found and clamped.

    Attributes:
        number: Number of the setup, from 1.
        cell: Cell with the mounted tools.
        stock: Stock.
        operations: Indices of the operations of the problem; empty for the end of a program.
        steps: Instructions for the operator before the operations, one sentence each. If there are any,
            programs ask for a confirmation.
    """

    number: int
    cell: Cell
    stock: Stock
    operations: tuple[int, ...]
    steps: tuple[str, ...] = ()

    @property
    def confirmation(self) -> str:
        """Question that the operator confirms before anything moves in this setup."""
        if not self.operations:
            return WORK_DONE
        return f"Setup {self.number} done as instructed, nobody in the cell?"

    @property
    def axis_values(self) -> dict[str, float]:
        """Values [m, rad] of the axes under arms and stock, by their names among the stations."""
        return {
            **{k: v for arm in self.cell.arms for k, v in arm.axis_values.items()},
            **self.stock.axis_values,
        }

    @property
    def with_zero_tilt(self) -> "Setup":
        """The setup with the tilt axis of a positioner at 0, so that the stock is upright on its plate."""
        table, tilt = self.cell.turntable, self.stock.tilt
        if table is None or not tilt:
            return self
        stock = self.stock.at_station(table, {**self.stock.axis_values, TILT_AXIS: 0.0})
        cell = self.cell.with_moved_bodies({TILT_AXIS: 0.0}, {TILT_AXIS: tilt})
        return dataclasses.replace(self, cell=cell, stock=stock)


@dataclasses.dataclass(frozen=True)
class Problem:
    """A whole problem.

    Attributes:
        name: Name of the problem.
        cell: Cell as the first operation finds it.
        stock: Stock as the first operation finds it.
        part: Part, or None.
        operations: Operations in order.
        settings: Limits.
        path: File that the problem was read from.
        digest: SHA-256 of the values and files of the problem.
        source: Content of the file, with the cell inlined and absolute file names, so that it can be bundled.
        changes: {index of an operation: change before it}, for operations after the first. :attr:`setups` has
            the results.
        accept: Codes of errors that the user accepts.
        notes: Choices made while the file was read.
        forces: {index of an operation: {arm: force of the process on its tool}}; equal for operations of one
            setup.
        stations: {index of an operation: {name of an axis: value}}. Names are those of
            :attr:`Arm.axes_by_name` [m], :data:`STOCK_AXIS` for the turntable and :data:`TILT_AXIS` for its
            tilt [rad]. Axes without a value stay, at first at home. A coordinated track is there before the
            first target; after the last target it is at the value of the arm's name with :data:`END_SUFFIX`.
    """

    name: str
    cell: Cell
    stock: Stock
    part: Part | None
    operations: tuple[Operation, ...]
    settings: Settings
    path: Path
    digest: str
    source: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    changes: Mapping[int, SetupChange] = dataclasses.field(default_factory=dict)
    accept: tuple[str, ...] = ()
    notes: tuple[Issue, ...] = ()
    forces: Mapping[int, Mapping[str, Force]] = dataclasses.field(default_factory=dict)
    stations: Mapping[int, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def with_stations(self, stations: Mapping[int, Mapping[str, float]]) -> "Problem":
        """Return the problem with external axes at ``stations``, as :attr:`stations` defines them."""
        return dataclasses.replace(self, stations=stations) if stations else self

    @property
    def axis_homes(self) -> dict[str, float]:
        """Values [m, rad] of the external axes before anything moves, by their names among the stations."""
        homes = {name: axis.home for arm in self.cell.arms for name, axis in arm.axes_by_name.items()}
        if self.cell.turntable is not None:
            homes |= {name: axis.home for name, axis in self.cell.turntable.axes.items()}
        return homes

    def tool_force(self, arm: str, setup: Setup) -> Force | None:
        """Return the force of the process on the tool of an arm in a setup; None if none is stated."""
        forces = (self.forces.get(index, {}).get(arm) for index in setup.operations)
        return next((force for force in forces if force is not None), None)

    @property
    def setups(self) -> tuple[Setup, ...]:
        """Setups of the operations, in order. A change starts a new setup.

        In a cell with external axes, each operation has a setup of its own, whose instructions tell the
        operator to keep away from the axes. So the number of setups does not depend on the stations.
        """
        axis_values, table = self.axis_homes, self.cell.turntable
        # ``stock`` is that of the setup, ``next_stock`` as the next operation finds it
        cell, stock, next_stock = self.cell, self.stock, self.stock
        setups: list[Setup] = []
        for index, operation in enumerate(self.operations):
            change = self.changes.get(index)
            if change is not None:
                arms = tuple(dataclasses.replace(a, tool=change.tools.get(a.name, a.tool)) for a in cell.arms)
                cell = dataclasses.replace(cell, arms=arms)
                next_stock = dataclasses.replace(next_stock, **change.stock)
            if not setups or change is not None or axis_values:
                stock = next_stock
                steps = change.steps if change else ()
                axis_values |= self.stations.get(index, {})
                setup_cell = dataclasses.replace(
                    cell, arms=tuple(_arm_at_stations(arm, axis_values) for arm in cell.arms)
                )
                setup_cell = setup_cell.with_moved_bodies(axis_values, {})
                arms_on_axes = [arm for arm in setup_cell.arms if arm.linear_axes]
                steps += tuple(
                    _keep_off_instruction(arm, arm.has_coordinated_track and arm.name in operation.arms)
                    for arm in arms_on_axes
                )
                if table is not None and stock.place is not None:
                    stock = stock.at_station(table, {name: axis_values[name] for name in table.axes})
                    steps += (_keep_off_turntable_instruction(table, stock.axis_values),)
                setups.append(Setup(len(setups) + 1, setup_cell, stock, (index,), steps))
            else:
                setups[-1] = dataclasses.replace(setups[-1], operations=(*setups[-1].operations, index))
            next_stock = operation.leaves(next_stock)
            end_names = [name for name in axis_values if name.endswith(END_SUFFIX)]
            axis_values |= {name.removesuffix(END_SUFFIX): axis_values.pop(name) for name in end_names}
        return tuple(setups)

    @property
    def closing_setup(self) -> Setup | None:
        """Setup after the last operation, in which external axes return to home for the next run.

        None without external axes.
        """
        if not self.axis_homes or not self.operations:
            return None
        last = self.setups[-1]
        arms = tuple(_arm_at_stations(arm, self.axis_homes) for arm in last.cell.arms)
        steps = tuple(_keep_off_instruction(arm) for arm in arms if arm.linear_axes)
        stock, table = last.stock, self.cell.turntable
        if table is not None and stock.place is not None:
            homes = {name: axis.home for name, axis in table.axes.items()}
            stock = stock.at_station(table, homes)
            steps += (_keep_off_turntable_instruction(table, homes),)
        cell = dataclasses.replace(last.cell.with_moved_bodies(self.axis_homes, last.axis_values), arms=arms)
        return Setup(last.number + 1, cell, stock, (), steps)

    def setup_of(self, index: int) -> Setup:
        """Return the setup of the operation of an index."""
        return next(setup for setup in self.setups if index in setup.operations)

    def setup_on_arrival(self, index: int) -> Setup:
        """Return the setup of the operation of an index, with a sheet as this operation finds it.

        The sheet is as the earlier operations of the setup leave it, and its ``stages`` name the other
        operations that form it. Without a sheet, this is :meth:`setup_of`.
        """
        setup = self.setup_of(index)
        stock = setup.stock
        for previous in setup.operations[: setup.operations.index(index)]:
            stock = self.operations[previous].leaves(stock)
        if stock.sheet is None or setup.stock.sheet is None:
            return setup
        forming_operations = [
            (k, op)
            for k, op in enumerate(self.operations)
            if isinstance(op, FormingOperation) and op.process == FORMING
        ]
        # not operations of single levels, which form the same features level by level
        all_levels = [(k, (op.name, op.features)) for k, op in forming_operations if op.level is None]
        moved_fields = self.changes.get(index + 1, SetupChange()).stock.keys() & {"place", "support"}
        stages = FormingStages(
            previous=tuple(name_and_features for k, name_and_features in all_levels if k < index),
            following=tuple(name_and_features for k, name_and_features in all_levels if k > index),
            stays_clamped=index + 1 < len(self.operations) and not moved_fields,
        )
        sheet = dataclasses.replace(stock.sheet, stages=stages if forming_operations else None)
        return dataclasses.replace(setup, stock=dataclasses.replace(setup.stock, sheet=sheet))


def _arm_at_stations(arm: Arm, stations: Mapping[str, float]) -> Arm:
    return arm.at_stations(stations) if arm.linear_axes else arm


def _keep_off_instruction(arm: Arm, is_coordinated: bool = False) -> str:
    """Return the instruction to keep away before the axes under an arm move to a station.

    ``is_coordinated`` says whether the track also moves while the arm works.
    """
    # First rounded as in programs, so that noise does not decide how a half is rounded. Zero gets no sign.
    values = {
        name: f"{round(1e3 * value, EXTERNAL_AXIS_DECIMALS) + 0.0:.3f}"
        for name, value in arm.axis_values.items()
    }
    if arm.track is None:
        units = " and ".join(dict.fromkeys(axis.unit for axis in arm.linear_axes))
        positions = ", ".join(
            f"{axis.axis_name} at {values[name]} mm" for name, axis in arm.axes_by_name.items()
        )
        return KEEP_OFF_GANTRY.format(unit=units, arm=arm.name, values=positions)
    sentence = KEEP_OFF_COORDINATED if is_coordinated else KEEP_OFF
    return sentence.format(arm=arm.name, unit=arm.track.unit, value=values[arm.name])


def _keep_off_turntable_instruction(table: Turntable, values: Mapping[str, float]) -> str:
    """Return the instruction to keep away before a turntable or positioner moves to a station."""
    rotation, tilt = (
        f"{round(float(np.rad2deg(values.get(name, 0.0))), 4) + 0.0:.4f}" for name in (STOCK_AXIS, TILT_AXIS)
    )
    if table.tilt is None:
        return KEEP_OFF_TABLE.format(unit=table.unit, value=rotation)
    return KEEP_OFF_POSITIONER.format(unit=table.unit, turn=rotation, tilt=tilt)


def all_setups(problem: Problem) -> tuple[Setup, ...]:
    """Return all setups, with the closing one at the end if there is one."""
    return problem.setups if problem.closing_setup is None else (*problem.setups, problem.closing_setup)
