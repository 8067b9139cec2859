"""What is to be planned, as values in SI units: cell, stock, part, operations.

:mod:`planner.reading.problem` reads these from YAML. A process defines its own operation class; all that the
rest of the house needs of one is :class:`Operation`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Protocol, runtime_checkable

import numpy as np

from planner.catalogue.materials import Foam, SheetMetal
from planner.catalogue.robots import JointStiffness, RobotData, robot
from planner.claims.claim import ForceFrame
from planner.claims.handshake import Handshake
from planner.claims.sentences import (
    CLOSED,
    KEEP_OFF,
    KEEP_OFF_GANTRY,
    KEEP_OFF_POSITIONER,
    KEEP_OFF_RIDING,
    KEEP_OFF_TABLE,
)
from planner.geometry.arrays import FloatArray, Mesh, Ruled, Shape, exp_rotation
from planner.geometry.units import DEG
from planner.issues import Issue
from planner.tooling import Gripper, Tool

KrlDialect = Literal["krc4", "krc2"]
KrlPath = Literal["slin", "spline"]


@dataclasses.dataclass(frozen=True)
class SagCompensation:
    """An arm's targets are commanded so that the sagged arm stands where it is wanted, by up to ``most`` [m]
    at its TCP. ``load``: its tool's weight, and that of a block that it holds, bend it; not where its
    controller makes up for them itself."""

    load: bool
    most: float


@dataclasses.dataclass(frozen=True)
class Force:
    """What the work exerts on a tool at its TCP while it works: ``vectors`` (K, 3) [N] where the TCP is at
    ``height`` (K,) [m] in the stock's frame, ascending, one of each for a force that is the same everywhere;
    in ``frame``, that of the stock, of the TCP or of the feed, as :class:`planner.claims.claim.ArmSags` has
    it."""

    vectors: FloatArray
    height: FloatArray
    frame: ForceFrame


BLIND_SPEED: Final = 0.25
"""Highest speed [m/s] of an arm on the way to its first target, which begins at a place that is not known, of
a track, and of what a turntable carries, on the way to a station."""


@dataclasses.dataclass(frozen=True)
class LinearAxis:
    """A linear axis under an arm: with its value v [m] what it takes along is moved by v times ``axis`` (3,),
    a unit vector of the world. ``low`` to ``high`` [m] is its range, ``speed`` [m/s] and ``acceleration``
    [m/s2] are its own; ``unit`` is its mechanical unit's name, ``home`` [m] where it stands before a program
    begins. ``follow``: the share of the tool's way along it that it goes along while the arm works, None
    where it stands then. ``column`` [from 0] is its number among external axes; ``word`` tells the axes of a
    gantry apart, empty for a track; ``carries``: bodies of the cell that stand on it, where they are at 0."""

    axis: FloatArray
    low: float
    high: float
    speed: float
    acceleration: float
    unit: str
    home: float
    follow: float | None = None
    column: int = 0
    word: str = ""
    carries: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The axis' name in texts: its unit's, and which axis of it."""
        return f"{self.unit} {self.word}".strip()

    def moved(self, pose: FloatArray, value: float) -> FloatArray:
        """A pose (4, 4) of value 0, or of any other from which it is moved, moved by a value [m]."""
        out = np.array(pose, dtype=np.float64)
        out[:3, 3] += value * self.axis
        return out


def in_turn(
    axes: Mapping[str, LinearAxis], here: Mapping[str, float], there: Mapping[str, float]
) -> tuple[str, ...]:
    """Names of linear axes under one arm, given from the floor up, in the order in which they go from their
    values ``here`` [m] to those ``there``, one after the other: first those that come nearer to their homes,
    from the arm down, then the others, from the floor up. So a column is raised before the bridge goes."""
    names = [name for name in axes if there[name] != here[name]]
    off = {name: [abs(at[name] - axes[name].home) for at in (there, here)] for name in names}
    nearer = [name for name in names if off[name][1] - off[name][0] > SAME_VALUE]
    return (*reversed(nearer), *(name for name in names if name not in nearer))


STOCK: Final = "stock"
"""What a turntable carries, by the name that it has among stations: no arm can be called so."""
TILT: Final = "stock/tilt"
"""The value of a positioner's tilt axis among stations: no arm can be called so."""
END: Final = "//end"
"""Behind an arm's name among stations: the value of its track behind an operation in which it goes along. No
axis of a gantry, whose name is behind one such sign, can be called so."""
PLATE: Final = "turntable"
"""Name of the body of the cell that is a turntable's plate."""
SAME_VALUE: Final = 1e-6
"""Distances [m] of values of linear axes from home that differ by no more are one."""
OUTER_DECIMALS: Final = 4
"""Decimals [mm, deg] with which programs write values of external axes."""
AXES_WRITTEN: Final = ("ABB", "KUKA")
"""Families of arms in whose language tracks, turntables and positioners are written."""


@dataclasses.dataclass(frozen=True)
class RotaryAxis:
    """An axis that turns the block: with its value v [rad] what it carries is turned by v, by the right hand,
    about the unit vector ``axis`` (3,) through ``centre`` (3,) [m] of the world. ``low`` to ``high`` [rad] is
    its range, ``speed`` [rad/s] and ``acceleration`` [rad/s2] are its own, infinite where none is stated;
    ``unit`` is its mechanical unit's name, moved by the program of ``arm`` as external axis number ``column``
    [from 0]; ``home`` [rad] where it stands before a program begins. ``word`` tells two axes of one unit
    apart."""

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
    word: str = ""

    @property
    def label(self) -> str:
        """The axis' name in texts: its unit's, and which axis of it."""
        return f"{self.unit} {self.word}".strip()

    def turned(self, place: FloatArray, value: float | FloatArray) -> FloatArray:
        """Poses (..., 4, 4) of value 0, or of any other from which they are turned, turned by values (...,)
        [rad]."""
        turn = exp_rotation(np.asarray(value)[..., None] * self.axis)
        count = np.broadcast_shapes(turn.shape[:-2], place.shape[:-2])
        out = np.array(np.broadcast_to(place, (*count, 4, 4)), dtype=np.float64)
        out[..., :3, :3] = turn @ out[..., :3, :3]
        out[..., :3, 3] = self.centre + (turn @ (out[..., :3, 3] - self.centre)[..., None])[..., 0]
        return out


@dataclasses.dataclass(frozen=True)
class Turntable(RotaryAxis):
    """What the block, and what is clamped under it, stand on: a rotary axis, vertical with all values 0,
    whose plate, round about it, is the body :data:`PLATE` of the cell. A positioner has a ``tilt`` axis, too,
    fixed in the world, which tilts the turn axis, the plate and the bodies ``bracket`` of the cell. ``load``
    [kg] is the most that it carries, None where none is stated."""

    tilt: RotaryAxis | None = None
    bracket: tuple[str, ...] = ()
    load: float | None = None

    @property
    def kind(self) -> str:
        """What it is called in texts."""
        return "turntable" if self.tilt is None else "positioner"

    @property
    def axes(self) -> dict[str, RotaryAxis]:
        """The axes by the names of their values among stations, in the order in which they move."""
        return {STOCK: self} if self.tilt is None else {STOCK: self, TILT: self.tilt}

    @property
    def tilted_bodies(self) -> tuple[str, ...]:
        """Bodies of the cell that go along with the tilt axis."""
        return () if self.tilt is None else (PLATE, *self.bracket)

    def pivot(self, name: str, tilt: float) -> RotaryAxis:
        """The axis of a name of :attr:`axes` where it lies in the world at a value ``tilt`` [rad]."""
        if name == TILT or self.tilt is None:
            return self.axes[name]
        seat = np.eye(4)
        seat[:3, 3] = self.centre
        seat = self.tilt.turned(seat, tilt)
        return dataclasses.replace(self, centre=seat[:3, 3], axis=seat[:3, :3] @ self.axis)

    def placed(
        self,
        place: FloatArray,
        there: Mapping[str, float | FloatArray],
        here: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """A pose (4, 4), of the values ``here`` by the names of :attr:`axes`, of 0 unless stated, where the
        values are ``there``, of one each or of as many as poses are wanted: Rot(tilt axis) Rot(turn axis)
        pose."""
        here = here or {}
        if self.tilt is not None:
            place = self.tilt.turned(place, -here.get(TILT, 0.0))
        place = self.turned(place, there.get(STOCK, 0.0) - here.get(STOCK, 0.0))
        return place if self.tilt is None else self.tilt.turned(place, there.get(TILT, 0.0))


@dataclasses.dataclass(frozen=True)
class Arm:
    """One robot of a cell: catalogue name, base pose (4, 4) in the world, tool, home joints (6,) [rad].

    ``base_auto``: the base may be moved by the placement search. ``stiffness``: of its joints, as its file
    states them, else as the catalogue has them, None for neither; ``sag``: how what that makes is
    compensated, None where it is not. ``given``: the robot's data where a file of the user's own has it,
    which ``robot`` then names, None for one of the catalogue. ``axes``: what its base rides on, from the
    floor up: one is a track, two or three are a gantry. An arm of a cell has the ``base`` of values 0, one of
    a setup that of the values ``stood`` [m] of its axes where it stands."""

    name: str
    robot: str
    base: FloatArray
    tool: Tool
    home: FloatArray
    base_auto: bool = False
    stiffness: JointStiffness | None = None
    sag: SagCompensation | None = None
    given: RobotData | None = None
    axes: tuple[LinearAxis, ...] = ()
    stood: tuple[float, ...] = ()

    @property
    def rails(self) -> dict[str, LinearAxis]:
        """The axes under it by the names of their values among stations, from the floor up: that of a track
        is the arm's, those of a gantry have the axis' behind it."""
        return {f"{self.name}/{one.word}" if one.word else self.name: one for one in self.axes}

    @property
    def stands(self) -> dict[str, float]:
        """The values [m] of these by their names, none for an arm of a cell."""
        return dict(zip(self.rails, self.stood, strict=True)) if self.stood else {}

    @property
    def track(self) -> LinearAxis | None:
        """The axis of an arm on a track; None for one that stands, or is on a gantry."""
        return self.axes[0] if len(self.axes) == 1 else None

    @property
    def station(self) -> float | None:
        """The value [m] of its track where it stands."""
        return self.stood[0] if len(self.stood) == 1 else None

    @property
    def follows(self) -> bool:
        """Whether its track goes along while it works."""
        return self.track is not None and self.track.follow is not None

    def at_stations(self, values: Mapping[str, float]) -> "Arm":
        """The arm where its axes have these values [m], by their names; raises ``KeyError`` where one is
        missing."""
        base, stands = self.base, self.stands
        for name, axis in self.rails.items():
            base = axis.moved(base, values[name] - stands.get(name, 0.0))
        return dataclasses.replace(self, base=base, stood=tuple(values[name] for name in self.rails))

    @property
    def data(self) -> RobotData:
        """The robot's data; raises as :func:`planner.catalogue.robots.robot`."""
        return robot(self.robot) if self.given is None else self.given


@dataclasses.dataclass(frozen=True)
class Obstacle:
    """A fixed body of the cell, placed in the world by the poses of its shapes."""

    name: str
    shapes: tuple[Shape, ...]

    def moved(self, motion: FloatArray) -> "Obstacle":
        """The body moved by a motion (4, 4) of the world."""
        shapes = tuple(dataclasses.replace(one, pose=motion @ one.pose) for one in self.shapes)
        return dataclasses.replace(self, shapes=shapes)


@dataclasses.dataclass(frozen=True)
class BentWire:
    """A wire or strip at hand in a cell.

    Attributes:
        material: Name in the table of materials.
        length: Hot length between the clamps [m].
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
    """Arms and obstacles; ``task`` names of the controller and the signal names are in ``controller``.
    ``grippers`` lie ready, from which one is chosen for a block that an arm holds, and ``wires`` are the bent
    wires at hand, from which one is chosen where an operation states none. ``turntable``: what the block
    stands on, None where it stands still."""

    name: str
    arms: tuple[Arm, ...]
    obstacles: tuple[Obstacle, ...]
    controller: "Controller"
    grippers: tuple[Gripper, ...] = ()
    wires: tuple[BentWire, ...] = ()
    turntable: Turntable | None = None

    def arm(self, name: str) -> Arm:
        """The arm of that name; raises ``KeyError``."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)

    def rail(self, name: str) -> tuple[Arm, LinearAxis]:
        """The arm and the linear axis under it whose value has a name among stations; raises ``KeyError``."""
        for arm in self.arms:
            if name in arm.rails:
                return arm, arm.rails[name]
        raise KeyError(name)

    @property
    def riders(self) -> dict[str, tuple[str, ...]]:
        """Bodies of the cell that stand on an axis, by the name of its value among stations: of a
        positioner's tilt, and of those of gantries. Axes without any are left out."""
        out = {name: axis.carries for arm in self.arms for name, axis in arm.rails.items()}
        out[TILT] = () if self.turntable is None else self.turntable.tilted_bodies
        return {name: bodies for name, bodies in out.items() if bodies}

    def going(self, there: Mapping[str, float], here: Mapping[str, float]) -> dict[str, FloatArray]:
        """Motions (4, 4) of the world of what stands on axes, by the names of :attr:`riders`, as all axes go
        from values ``here`` [m, rad] to those ``there``; one that is in neither stays."""
        out, table = {}, self.turntable
        for arm in self.arms:
            goes = np.eye(4)
            for name, axis in arm.rails.items():  # those below it take it along
                goes = axis.moved(goes, there.get(name, 0.0) - here.get(name, 0.0))
                out[name] = goes
        if table is not None and table.tilt is not None:
            out[TILT] = table.tilt.turned(np.eye(4), there.get(TILT, 0.0) - here.get(TILT, 0.0))
        return {name: out[name] for name in self.riders}

    def gone(self, there: Mapping[str, float], here: Mapping[str, float]) -> "Cell":
        """The cell with the bodies that stand on axes where these take them from values ``here`` [m, rad] to
        those ``there``."""
        goes = self.going(there, here)
        moved = {body: goes[name] for name, bodies in self.riders.items() for body in bodies}
        bodies = tuple(one.moved(moved[one.name]) if one.name in moved else one for one in self.obstacles)
        return dataclasses.replace(self, obstacles=bodies) if moved and there != here else self


def output_of(request: str) -> str:
    """The name of the output that a request drives, where no other is stated."""
    return f"{request}Out"


@dataclasses.dataclass(frozen=True)
class PowerOutput:
    """What a request of the program drives: the output ``signal``, bit ``bit`` of ``device`` on an ABB
    controller; without a device nothing is wired to it."""

    signal: str
    device: str = ""
    bit: int = 0


@dataclasses.dataclass(frozen=True)
class DevicePlace:
    """Where a signal of an ABB controller is wired: bit ``bit`` of ``device``."""

    device: str
    bit: int = 0


@dataclasses.dataclass(frozen=True)
class Interlock:
    """What power hangs on besides the program: ``outputs`` by the signal that the program sets, which is a
    request, and the system outputs of an ABB controller that say that a program runs and motors are on.
    ``places`` {arm: {signal: place}} of signals that power nothing, at ABB controllers."""

    outputs: Mapping[str, PowerOutput] = dataclasses.field(default_factory=dict)
    cycle: str = "soCycleOn"
    motors: str = "soMotorsOn"
    places: Mapping[str, Mapping[str, DevicePlace]] = dataclasses.field(default_factory=dict)

    def of(self, request: str) -> PowerOutput:
        """The output that a request drives; unless stated, one with the request's name and ``Out``."""
        found = {name.lower(): output for name, output in self.outputs.items()}
        return found.get(request.lower(), PowerOutput(output_of(request)))

    def place(self, arm: str, signal: str) -> DevicePlace | None:
        """Where a signal that powers nothing is wired at the controller of an arm; None if the cell states
        it not."""
        found = {name.lower(): place for name, place in self.places.get(arm, {}).items()}
        return found.get(signal.lower())


@dataclasses.dataclass(frozen=True)
class Controller:
    """How the programs address the controller: task and mechanical unit per arm, signals, limits of a module.

    ``sync``: one MultiMove controller for all arms, or one for each arm that meet by ``handshake``; tasks and
    units of two controllers may have the same names. ``dialect``: the KRL of KUKA arms; ``path``: how they go
    from target to target, straight one by one or in spline blocks. ``io``: {arm: {signal: number}} of the
    inputs and outputs of KUKA and UR controllers, which know no names. ``robotware``: main version of ABB's
    controllers. ``robots``: names of the robots in their configuration, the units' unless stated. ``options``
    that are installed, None where the cell does not say.

    ``language``: what all arms are programmed in, "own" for that of each arm's family, "ros" for joint
    trajectories; of these ``joint_prefix`` {arm: what stands before the names of its joints},
    ``path_tolerance`` and ``goal_tolerance`` [rad] of each joint, and ``goal_time`` [s] by which a goal may
    be late."""

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

    def robot(self, place: int) -> str:
        """The name under ``/MOC/ROBOT`` of the robot of the cell's arm number ``place`` [from 0]."""
        return self.robots[place] if self.robots else self.units[place]

    def number(self, arm: str, signal: str) -> int | None:
        """The number of a signal on the controller of a KUKA or UR arm; None if the cell states none."""
        numbers = {name.lower(): value for name, value in self.io.get(arm, {}).items()}
        return numbers.get(signal.lower())


@dataclasses.dataclass(frozen=True)
class Formed:
    """A part to be formed out of the sheet: ``mesh`` is its lower face in the stock frame, with normals up.

    By the sine law, t = t0 cos(a), a sheet that is formed in one pass is as thick along z everywhere as at
    first, so that one face is the other one moved along z.

    ``given``: the mesh of the file in that frame, where ``mesh`` is the face that is meant by it within its
    ``tolerance`` [m], 0 for a mesh without noise; None where both are the same. ``stated`` [m]: the tolerance
    that the user states, None where it was found.
    """

    mesh: Mesh
    given: Mesh | None = None
    tolerance: float = 0.0
    stated: float | None = None

    @property
    def source(self) -> Mesh:
        """The mesh as it was given."""
        return self.mesh if self.given is None else self.given


@dataclasses.dataclass(frozen=True)
class Part:
    """The wanted part in the stock frame: ``front`` and ``back`` face as open meshes with normals away from
    the part, and its ruled surfaces by name, among them the ``edges`` that join front and back; or a sheet
    that is ``formed``.

    ``notes``: what was found on the way from the file to these surfaces (deviations, kinks), for the user.
    """

    front: Mesh | None = None
    back: Mesh | None = None
    ruled: tuple[Ruled, ...] = ()
    notes: tuple[Issue, ...] = ()
    formed: Formed | None = None


@dataclasses.dataclass(frozen=True)
class Hole:
    """A closed curve ``ring`` (K, 2) [m] in plan along which an operation has cut a sheet: what lies
    ``inside`` of it drops, or all that is outside. On the sheet's other face the cut may be farther out, or
    in, by ``across`` [m] in plan."""

    name: str
    ring: FloatArray
    inside: bool = True
    across: float = 0.0


@dataclasses.dataclass(frozen=True)
class Stages:
    """The operations that form a sheet ``before`` and ``after`` another one, in order, each with its name and
    the numbers of the features that it forms, None for all; those of single levels are left out. ``stays``:
    the sheet stays clamped behind it."""

    before: tuple[tuple[str, tuple[int, ...] | None], ...] = ()
    after: tuple[tuple[str, tuple[int, ...] | None], ...] = ()
    stays: bool = False


@dataclasses.dataclass(frozen=True)
class Sheet:
    """What a stock that is a clamped sheet has besides its size: ``metal``, and the ``opening`` (K, 2) [m] of
    its clamp, a closed convex outline in the sheet's plane about the stock frame's origin. ``border`` [N/m^2]
    is the stiffness of the clamp's grip in plane, by its length: 0 where the sheet slides, infinite where it
    does not move.

    ``formed`` are the convex solids, in the stock frame, that hold what stands out of the flat sheet once the
    part is formed, or at any time before; bodies of the cell keep clear of them from the beginning.
    ``holes``: along which curves earlier operations have cut it. ``stages``: which others form it, as one
    operation finds it; None where nothing says so, and where none does. ``die``: an operation has one behind
    it, of which nothing says that it is ever taken away.
    """

    metal: SheetMetal
    opening: FloatArray
    border: float = 0.0
    formed: tuple[Shape, ...] = ()
    holes: tuple[Hole, ...] = ()
    stages: Stages | None = None
    die: bool = False


@dataclasses.dataclass(frozen=True)
class Pedestal:
    """What Tandem is to make for a block to stand on: ``kind`` of it, its ``sides`` and ``heights`` [m] in
    stock, and the ``share`` of the block's sides that it may be wide, or ``beyond`` them by which it is wider
    [m]."""

    kind: Literal["table", "pedestal"]
    sides: tuple[float, ...]
    heights: tuple[float, ...]
    share: float
    beyond: float = 0.0


@dataclasses.dataclass(frozen=True)
class Stock:
    """The block: ``size`` (3,) [m] of the datum block; frame at the centre of its bottom face, z up through
    the block.

    ``oversize`` (2, 3) [m]: how far the block, as an operation finds it, stands out of the datum block on the
    lower and on the upper side along x, y and z. ``place`` (4, 4) is the stock frame's pose in the world, or
    None where the placement search is to find it, with ``attitude`` (3, 3), its rotation up to a yaw about
    the world's vertical, which ``any_attitude`` leaves open for a block that is held. ``support``: shapes
    in the stock frame that stand under the block and move with it (a pedestal). ``held_by``: the arm whose
    tool holds the block, with the stock frame at ``grip`` (4, 4) in its TCP frame, which may be chosen;
    ``place`` is then the pose about which the holder moves the block. ``sheet``: the block is a sheet,
    clamped along its rim; z runs through its thickness, and ``support`` is its clamp. ``pedestal``: what
    stands under the block is made, as high as its place wants it (``planner.cell.support``), in place of
    ``support``. On a turntable the stock of a problem has the ``place`` of value 0, one of a setup that of
    the ``station`` [rad] where it stands, and of the ``tilt`` [rad] of a positioner.
    """

    size: FloatArray
    place: FloatArray | None
    attitude: FloatArray
    support: tuple[Shape, ...] = ()
    any_attitude: bool = False
    oversize: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((2, 3)))
    foam: Foam | None = None
    held_by: str | None = None
    grip: FloatArray = dataclasses.field(default_factory=lambda: np.eye(4))
    grip_chosen: bool = False
    pedestal: Pedestal | None = None
    sheet: Sheet | None = None
    station: float | None = None
    tilt: float | None = None

    @property
    def stands(self) -> dict[str, float]:
        """The values [rad] of the axes of its turntable by their names among stations, none where it stands
        on none."""
        both = {STOCK: self.station, TILT: self.tilt}
        return {name: value for name, value in both.items() if value is not None}

    def at_station(self, table: Turntable, values: Mapping[str, float]) -> "Stock":
        """The block where its turntable has these values [rad], by the names of its axes; raises
        ``ValueError`` for one whose place is not known."""
        if self.place is None:
            raise ValueError("the place of a block on a turntable is not known")
        place = table.placed(self.place, values, self.stands)
        own = (values[STOCK], values.get(TILT))
        return dataclasses.replace(self, place=place, attitude=place[:3, :3], station=own[0], tilt=own[1])

    @property
    def lower(self) -> FloatArray:
        """Lowest corner (3,) [m] of the block as found, in the stock frame."""
        return np.asarray(np.array([-0.5, -0.5, 0.0]) * self.size - self.oversize[0])

    @property
    def upper(self) -> FloatArray:
        """Highest corner (3,) [m] of the block as found, in the stock frame."""
        return np.asarray(np.array([0.5, 0.5, 1.0]) * self.size + self.oversize[1])

    @property
    def box(self) -> FloatArray:
        """Both corners (2, 3) [m] of the block as found, in the stock frame."""
        return np.stack([self.lower, self.upper])

    @property
    def mass(self) -> float | None:
        """Mass [kg] of the block as found, None without a foam."""
        return None if self.foam is None else float(np.prod(self.upper - self.lower)) * self.foam.density

    @property
    def leans_freely(self) -> bool:
        """Whether the search may give the block any attitude: only a block that is held has no bottom."""
        return self.any_attitude and self.held_by is not None and self.place is None

    @property
    def gravity(self) -> FloatArray:
        """Unit vector (3,) of gravity in the stock frame; the same for every yaw of the block."""
        return -self.attitude[2, :]


@runtime_checkable
class Operation(Protocol):
    """What every process's operation has."""

    name: str
    process: str
    arms: tuple[str, ...]

    def leaves(self, stock: Stock) -> Stock:
        """The block as the next operation finds it."""


def any_lean(operation: Operation) -> bool:
    """Whether targets and claims of an operation are the same however the block leans: only where its process
    says so (``any_lean = True`` of its schema)."""
    return bool(getattr(operation, "any_lean", False))


def any_base(operation: Operation) -> bool:
    """Whether the base of its arm may ride along while an operation is worked at: only where its process says
    so (``any_base = True`` of its schema)."""
    return bool(getattr(operation, "any_base", False))


def lights_torch(operation: Operation) -> bool:
    """Whether the signal of an operation lights a torch: that of one that trims by a torch."""
    return operation.process == "trim" and getattr(getattr(operation, "by", None), "kind", "torch") == "torch"


def torch_signals(operations: Sequence[Operation]) -> frozenset[str]:
    """The signals that light the torches of operations."""
    own = (getattr(one, "signal", None) for one in operations if lights_torch(one))
    return frozenset(signal for signal in own if isinstance(signal, str))


@runtime_checkable
class Fixed(Protocol):
    """An operation that brings fixtures of its own, or shapes of the stock that others do not know."""

    def with_fixtures(self, stock: Stock, part: Part | None, before: Sequence[Operation]) -> Stock:
        """The stock with bodies of fixtures, by which bodies of the cell keep clear; ``before``: the
        operations before this one."""


FORMING: Final = "forming"
"""The process that forms sheets; fields of others may have the same names."""


@runtime_checkable
class Forms(Protocol):
    """An operation that forms a sheet, of the process :data:`FORMING`: the ``features`` of its part with
    these numbers, None for all; or of one pass a ``level`` alone, if not None."""

    name: str
    process: str
    features: tuple[int, ...] | None
    level: object


OWN_CLEARANCE: Final = 0.005
"""What the links and the tool of one arm keep off each other [m] where nothing is said and
``Settings.clearance`` is more: they follow from the arm's own axes and the tool's calibration alone (decision
0031)."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """Limits that motion and proof share: clearances [m], fractions of joint speed and acceleration, margins
    [rad]. These are the defaults of problem files as well.

    ``own_clearance`` is stated for links and tool of one arm; :attr:`of_one_arm` is what counts.
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
    def of_one_arm(self) -> float:
        """The clearance [m] of links and tool of one arm to each other: never more than that of all else."""
        return min(self.clearance, OWN_CLEARANCE if self.own_clearance is None else self.own_clearance)

    def wider(self, by: float) -> "Settings":
        """The same with both clearances wider by a distance [m]."""
        return dataclasses.replace(self, clearance=self.clearance + by, own_clearance=self.of_one_arm + by)


@dataclasses.dataclass(frozen=True)
class Change:
    """What is changed before an operation: ``tools`` by arm, ``stock`` fields of :class:`Stock` by name, and
    ``steps``, what the operator does, a sentence each."""

    tools: Mapping[str, Tool] = dataclasses.field(default_factory=dict)
    stock: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    steps: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Setup:
    """How the cell stands for some operations in a row: the cell with the tools that are mounted, the block
    as found and clamped.

    ``operations``: indices of the problem's operations, none for the end of a program. ``steps``: what the
    operator does before them, a sentence each; where there are any, the programs ask for a confirmation.
    """

    number: int
    cell: Cell
    stock: Stock
    operations: tuple[int, ...]
    steps: tuple[str, ...] = ()

    @property
    def confirmation(self) -> str:
        """What the operator confirms before anything moves in this setup."""
        if not self.operations:
            return CLOSED
        return f"Setup {self.number} done as told, nobody in the cell?"

    @property
    def stands(self) -> dict[str, float]:
        """Values [m, rad] of the axes under arms and under the block, by their names among stations."""
        return {**{k: v for arm in self.cell.arms for k, v in arm.stands.items()}, **self.stock.stands}

    @property
    def upright(self) -> "Setup":
        """The same with a positioner's tilt at 0, where the block stands on its plate."""
        table, tilt = self.cell.turntable, self.stock.tilt
        if table is None or not tilt:
            return self
        stock = self.stock.at_station(table, {**self.stock.stands, TILT: 0.0})
        cell = self.cell.gone({TILT: 0.0}, {TILT: tilt})
        return dataclasses.replace(self, cell=cell, stock=stock)


@dataclasses.dataclass(frozen=True)
class Problem:
    """A whole problem: ``path`` is the file it came from, ``digest`` the SHA-256 over its values and files.

    ``cell`` and ``stock`` are as the first operation finds them; ``changes`` {index of an operation: change}
    are made before later ones; :attr:`setups` are what each operation finds. ``source`` is what the file
    said, with the cell inside and file names made absolute, so that it can be carried along. ``accept``:
    codes of errors that the user takes upon himself. ``notes``: what was chosen on the way from the file.
    ``forces`` {index of an operation: {arm: force}}: what the work exerts on tools; those of operations of
    one setup are alike. ``stations`` {index of an operation: {name as :attr:`Arm.rails` has it: value [m] of
    that axis, :data:`STOCK`: value [rad] of the turntable, :data:`TILT`: of its tilt}}: where arms on tracks
    and gantries and the block stand in it; where nothing is said they stay, at first at home. A track that
    goes along stands there before the first target, and behind the last one where its arm's name with
    :data:`END` says."""

    name: str
    cell: Cell
    stock: Stock
    part: Part | None
    operations: tuple[Operation, ...]
    settings: Settings
    path: Path
    digest: str
    source: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    changes: Mapping[int, Change] = dataclasses.field(default_factory=dict)
    accept: tuple[str, ...] = ()
    notes: tuple[Issue, ...] = ()
    forces: Mapping[int, Mapping[str, Force]] = dataclasses.field(default_factory=dict)
    stations: Mapping[int, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def stationed(self, stations: Mapping[int, Mapping[str, float]]) -> "Problem":
        """The same with arms on tracks and the block at stations, as :attr:`stations` has them."""
        return dataclasses.replace(self, stations=stations) if stations else self

    @property
    def homes(self) -> dict[str, float]:
        """Values [m, rad] of the axes under arms and under the block before anything moves, by their names as
        :attr:`stations` has them."""
        out = {name: axis.home for arm in self.cell.arms for name, axis in arm.rails.items()}
        table = self.cell.turntable
        return out | ({} if table is None else {name: axis.home for name, axis in table.axes.items()})

    def force_on(self, arm: str, setup: Setup) -> Force | None:
        """What the work of a setup exerts on the tool of an arm, None where nothing is stated."""
        stated = (self.forces.get(index, {}).get(arm) for index in setup.operations)
        return next((force for force in stated if force is not None), None)

    @property
    def setups(self) -> tuple[Setup, ...]:
        """How the cell stands for the operations, in order; a change starts a new setup.

        Where an arm stands on a track, or the block on a turntable, each operation is a setup, and the
        operator keeps off them: so setups do not hang on where they stand.
        """
        tracked, table = self.homes, self.cell.turntable
        cell, stock, left = self.cell, self.stock, self.stock
        out: list[Setup] = []
        for index, operation in enumerate(self.operations):
            change = self.changes.get(index)
            if change is not None:
                arms = tuple(dataclasses.replace(a, tool=change.tools.get(a.name, a.tool)) for a in cell.arms)
                cell, left = dataclasses.replace(cell, arms=arms), dataclasses.replace(left, **change.stock)
            if not out or change is not None or tracked:
                stock, steps = left, change.steps if change else ()
                tracked |= self.stations.get(index, {})
                stands = dataclasses.replace(cell, arms=tuple(_standing(arm, tracked) for arm in cell.arms))
                stands = stands.gone(tracked, {})
                on = [arm for arm in stands.arms if arm.axes]
                steps += tuple(_keep_off(arm, arm.follows and arm.name in operation.arms) for arm in on)
                if table is not None and stock.place is not None:
                    stock = stock.at_station(table, {name: tracked[name] for name in table.axes})
                    steps += (_keep_off_table(table, stock.stands),)
                out.append(Setup(len(out) + 1, stands, stock, (index,), steps))
            else:
                out[-1] = dataclasses.replace(out[-1], operations=(*out[-1].operations, index))
            left = operation.leaves(left)
            gone = [name for name in tracked if name.endswith(END)]
            tracked |= {name.removesuffix(END): tracked.pop(name) for name in gone}
        return tuple(out)

    @property
    def closing(self) -> Setup | None:
        """How the cell stands behind the last operation, where tracks or the turntable go home again, so that
        the next run finds them there; None without such axes."""
        if not self.homes or not self.operations:
            return None
        last = self.setups[-1]
        arms = tuple(_standing(arm, self.homes) for arm in last.cell.arms)
        steps = tuple(_keep_off(arm) for arm in arms if arm.axes)
        stock, table = last.stock, self.cell.turntable
        if table is not None and stock.place is not None:
            homes = {name: axis.home for name, axis in table.axes.items()}
            stock = stock.at_station(table, homes)
            steps += (_keep_off_table(table, homes),)
        cell = dataclasses.replace(last.cell.gone(self.homes, last.stands), arms=arms)
        return Setup(last.number + 1, cell, stock, (), steps)

    def setup_of(self, index: int) -> Setup:
        """The setup of an operation, by its index."""
        return next(setup for setup in self.setups if index in setup.operations)

    def found_by(self, index: int) -> Setup:
        """The setup of an operation, by its index, with a sheet as this operation finds it: what those before
        it in the same setup have left, and which others form it."""
        setup = self.setup_of(index)
        stock = setup.stock
        for before in setup.operations[: setup.operations.index(index)]:
            stock = self.operations[before].leaves(stock)
        if stock.sheet is None or setup.stock.sheet is None:
            return setup
        forms = [
            (k, op) for k, op in enumerate(self.operations) if isinstance(op, Forms) and op.process == FORMING
        ]
        # operations of one level each form the same features, level by level
        whole = [(k, (op.name, op.features)) for k, op in forms if op.level is None]
        moved = self.changes.get(index + 1, Change()).stock.keys() & {"place", "support"}
        stages = Stages(
            tuple(one for k, one in whole if k < index),
            tuple(one for k, one in whole if k > index),
            index + 1 < len(self.operations) and not moved,
        )
        sheet = dataclasses.replace(stock.sheet, stages=stages if forms else None)
        return dataclasses.replace(setup, stock=dataclasses.replace(setup.stock, sheet=sheet))


def _standing(arm: Arm, stations: Mapping[str, float]) -> Arm:
    return arm.at_stations(stations) if arm.axes else arm


def _keep_off(arm: Arm, rides: bool = False) -> str:
    """What the operator does before the axes under an arm go to a station, and a track perhaps ``rides``
    along from there."""
    # as written: noise settles no half, and 0 has no sign
    values = {name: f"{round(1e3 * value, OUTER_DECIMALS) + 0.0:.3f}" for name, value in arm.stands.items()}
    if arm.track is None:
        units = " and ".join(dict.fromkeys(axis.unit for axis in arm.axes))
        ways = ", ".join(f"{axis.word} at {values[name]} mm" for name, axis in arm.rails.items())
        return KEEP_OFF_GANTRY.filled(unit=units, arm=arm.name, values=ways)
    said = KEEP_OFF_RIDING if rides else KEEP_OFF
    return said.filled(arm=arm.name, unit=arm.track.unit, value=values[arm.name])


def _keep_off_table(table: Turntable, values: Mapping[str, float]) -> str:
    """What the operator does before a turntable or positioner goes to a station."""
    turn, tilt = (f"{round(float(np.rad2deg(values.get(name, 0.0))), 4) + 0.0:.4f}" for name in (STOCK, TILT))
    if table.tilt is None:
        return KEEP_OFF_TABLE.filled(unit=table.unit, value=turn)
    return KEEP_OFF_POSITIONER.filled(unit=table.unit, turn=turn, tilt=tilt)


def setups_of(problem: Problem) -> tuple[Setup, ...]:
    """How the cell stands, setup by setup, and at last, without operations, with all axes home again."""
    return problem.setups if problem.closing is None else (*problem.setups, problem.closing)
