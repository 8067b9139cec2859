"""Built-in robots: dimensions, limits and speeds with their sources, from ``urdf/robots.yaml``."""

import dataclasses
import functools
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import numpy as np
import yaml

from planner.files import is_file
from planner.geometry.arrays import FloatArray, Shape, inverse
from planner.geometry.units import DEG
from planner.issue_codes import format_message
from planner.issues import TandemError, issue_error

Family = str
"""Controller of an arm, for which its programs are written.
"ABB", "KUKA", "UR", "ROS", "generic", or a family of an installed language.
"""
DataKind = Literal["urdf", "problems"]
"""Folder of data that comes with the package."""

JOINTS: Final = tuple(f"joint_{number}" for number in range(1, 7))
"""Names of the joints in the built-in URDFs."""
_PACKAGE: Final = Path(__file__).resolve().parents[1]
"""Folder of the package."""


class ArmForm:
    """Common properties of the geometries of arms with J axes whose inverse kinematics has a closed form.

    The angles of a form are theta_i = signs_i * q_i - offsets_i, where q_i are the robot's serial angles.

    Attributes:
        branches: Maximum number of solutions of the inverse kinematics.
        axes: Axis of each link, "x", "y" or "z", about which theta_1 to theta_J rotate it.
        singular: Indices of the joints whose angles decide whether a posture is singular.
        b: Distance [m] of the wrist from the plane through axis 1 in which the arm moves.
        offsets: Joint offsets (J,) [rad].
        signs: Joint signs (J,), 1 or -1.
        left: Pose (4, 4) of the form's base in the base link of an arm from a file, None if they agree.
        right: Pose (4, 4) of the tip link of an arm from a file in the form's flange, None if they agree.
    """

    branches: ClassVar[int] = 8
    axes: ClassVar[str]
    singular: ClassVar[tuple[int, ...]]
    b: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray | None
    right: FloatArray | None

    def inner(self, flange: FloatArray) -> FloatArray:
        """Return poses of the form's own flange in the form's own base.

        Args:
            flange: Poses (..., 4, 4) of the robot's flange or tip link in its base link.

        Returns:
            Poses (..., 4, 4).
        """
        if self.left is not None:
            flange = inverse(self.left) @ flange
        return flange if self.right is None else flange @ inverse(self.right)

    @property
    def count(self) -> int:
        """Number J of its axes."""
        return len(self.axes)

    @property
    def steps(self) -> FloatArray:
        """Translations (J + 1, 3) [m] between successive links at theta zero, from the base to the flange."""
        raise NotImplementedError

    @property
    def flange_rotation(self) -> FloatArray:
        """Rotation (3, 3) of the flange relative to the last link."""
        return np.eye(3)

    @property
    def hand(self) -> float:
        """Maximum distance [m] of the robot's flange from the wrist's centre.

        Arms without a wrist centre state another point from which the distance counts.
        """
        raise NotImplementedError

    @property
    def stretched(self) -> float:
        """Maximum distance [m] from axis 1 to where :attr:`hand` starts, in the plane of the arm."""
        raise NotImplementedError

    @property
    def shoulder(self) -> float:
        """Distance [m] of the origin of link 2 from axis 1, 0 if axes 1 and 2 meet."""
        return 0.0

    @property
    def _beyond(self) -> float:
        """Distance [m] of the tip link of an arm from a file from the form's flange."""
        return 0.0 if self.right is None else float(np.linalg.norm(self.right[:3, 3]))


class OrthoParallel(ArmForm):
    """Common properties of ortho-parallel arms up to the point where axes 4 and 5 meet.

    Lengths [m] are those of :class:`OpwParameters`.
    """

    axes: ClassVar[str] = "zyyzyz"
    a1: float
    a2: float
    c2: float
    c3: float

    @property
    def stretched(self) -> float:
        """Maximum distance [m] from axis 1 to where axes 4 and 5 meet, in the plane of the arm."""
        return float(abs(self.a1) + self.c2 + np.hypot(self.a2, self.c3))

    @property
    def shoulder(self) -> float:
        """Distance [m] of the origin of link 2 from axis 1."""
        return float(np.hypot(self.a1, self.b))


@dataclasses.dataclass(frozen=True)
class OpwParameters(OrthoParallel):
    """Geometry of an ortho-parallel arm with a spherical wrist. Lengths [m].

    Flange pose in the base: Rz(t1) T(a1, b, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5) Rz(t6)
    T(0, 0, c4).

    Source: Brandstoetter, Angerer, Hofbaur (2014).
    """

    singular: ClassVar[tuple[int, ...]] = (1, 2, 4)
    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray | None = None
    right: FloatArray | None = None

    @property
    def steps(self) -> FloatArray:
        """Translations (7, 3) [m] between successive links at theta zero, from the base to the flange.

        The wrist's three axes meet, so those between its links are zero.
        """
        ahead = (0.0, self.a1, 0.0, self.a2, 0.0, 0.0, 0.0)
        across = (0.0, self.b, 0.0, 0.0, 0.0, 0.0, 0.0)
        up = (0.0, self.c1, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, across, up], axis=1)

    @property
    def hand(self) -> float:
        """Maximum distance [m] of the flange from the wrist's centre."""
        return abs(self.c4) + self._beyond


@dataclasses.dataclass(frozen=True)
class OffsetParameters(OrthoParallel):
    """Geometry of an ortho-parallel arm with an offset wrist. Lengths [m] as of :class:`OpwParameters`.

    Axes 4 and 5 meet, and axis 6 passes beside that point, as in ABB's GoFa and Fanuc's CRX. ``a3`` and
    ``b3`` are the distances of axis 6 from the point where axes 4 and 5 meet, across axis 5 and along it;
    ``c4`` reaches from the foot there to the flange. Flange pose in the base: Rz(t1) T(a1, 0, c1) Ry(t2)
    T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5) T(a3, b3, 0) Rz(t6) T(0, 0, c4).
    """

    branches: ClassVar[int] = 24
    singular: ClassVar[tuple[int, ...]] = (1, 2, 3, 4)
    b: ClassVar[float] = 0.0  # type: ignore[misc]
    a1: float
    a2: float
    a3: float
    b3: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray | None = None
    right: FloatArray | None = None

    @property
    def steps(self) -> FloatArray:
        """Translations (7, 3) [m] between successive links at theta zero, from the base to the flange.

        Axes 4 and 5 meet, so that between links 4 and 5 is zero.
        """
        ahead = (0.0, self.a1, 0.0, self.a2, 0.0, self.a3, 0.0)
        across = (0.0, 0.0, 0.0, 0.0, 0.0, self.b3, 0.0)
        up = (0.0, self.c1, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, across, up], axis=1)

    @property
    def hand(self) -> float:
        """Maximum distance [m] of the flange from the point where axes 4 and 5 meet."""
        return float(np.linalg.norm([self.a3, self.b3, self.c4])) + self._beyond


@dataclasses.dataclass(frozen=True)
class ParallelParameters(ArmForm):
    """Geometry of an arm whose axes 2, 3 and 4 are parallel, as in UR arms. Lengths [m], ``b`` >= 0.

    Axis 1 meets 2, 5 meets 4 and 6, and these axes are at right angles. Flange pose in the base: Rz(t1)
    T(0, 0, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(0, 0, c3) Ry(t4) T(0, b, c4) Rz(t5) Ry(t6) T(0, c5, 0) Rx(-90
    deg). In a maker's Denavit-Hartenberg table c1 is d1, c2 and c3 are the sizes of a2 and a3, and b, c4
    and c5 are d4, d5 and d6.
    """

    axes: ClassVar[str] = "zyyyzy"
    singular: ClassVar[tuple[int, ...]] = (1, 2, 3, 4)
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    c5: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray | None = None
    right: FloatArray | None = None

    @property
    def steps(self) -> FloatArray:
        """Translations (7, 3) [m] between successive links at theta zero, from the base to the flange.

        Axes 5 and 6 meet, so that between links 5 and 6 is zero.
        """
        up = (0.0, self.c1, self.c2, self.c3, self.c4, 0.0, 0.0)
        across = (0.0, 0.0, 0.0, 0.0, self.b, 0.0, self.c5)
        return np.stack([np.zeros(7), across, up], axis=1)

    @property
    def flange_rotation(self) -> FloatArray:
        """Rotation (3, 3) of the flange relative to the last link.

        It is Rx(-90 deg): the flange's z axis is along axis 6 and points out of the arm.
        """
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

    @property
    def hand(self) -> float:
        """Maximum distance [m] of the flange from axis 4."""
        return float(np.hypot(self.b, self.c4)) + abs(self.c5) + self._beyond

    @property
    def stretched(self) -> float:
        """Maximum distance [m] from axis 1 to axis 4."""
        return self.c2 + self.c3


@dataclasses.dataclass(frozen=True)
class SevenParameters(ArmForm):
    """Geometry of an arm with seven axes, each at a right angle to the one before. Lengths [m].

    Axes 1, 2 and 3 meet in its shoulder, 5 and 6 meet, and 7 passes beside that point or through it, as in
    Franka's Panda and KUKA's iiwa. ``a2`` and ``a3`` are the distances by which the elbow is ahead of the
    upper arm, and the forearm ahead of the elbow; ``a4`` that by which axis 7 is ahead of axis 6. Flange
    pose in the base: Rz(t1) T(0, 0, c1) Ry(t2) Rz(t3) T(a2, 0, c2) Ry(t4) T(a3, 0, c3) Rz(t5) Ry(t6) T(a4,
    0, 0) Rz(t7) T(0, 0, c4).
    """

    axes: ClassVar[str] = "zyzyzyz"
    singular: ClassVar[tuple[int, ...]] = (1, 3, 4)
    b: ClassVar[float] = 0.0  # type: ignore[misc]
    a2: float
    a3: float
    a4: float
    c1: float
    c2: float
    c3: float
    c4: float
    offsets: FloatArray
    signs: FloatArray
    left: FloatArray | None = None
    right: FloatArray | None = None

    @property
    def steps(self) -> FloatArray:
        """Translations (8, 3) [m] between successive links at theta zero, from the base to the flange.

        Axes 2 and 3 meet, and 5 and 6, so those between their links are zero.
        """
        ahead = (0.0, 0.0, 0.0, self.a2, self.a3, 0.0, self.a4, 0.0)
        up = (0.0, self.c1, 0.0, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, np.zeros(8), up], axis=1)

    @property
    def upper(self) -> float:
        """Distance [m] from the shoulder to axis 4."""
        return float(np.hypot(self.a2, self.c2))

    @property
    def fore(self) -> float:
        """Distance [m] from axis 4 to the point where axes 5 and 6 meet."""
        return float(np.hypot(self.a3, self.c3))

    @property
    def straight(self) -> float:
        """Theta 4 [rad] at which the arm is stretched."""
        return float(np.arctan2(self.a2, self.c2) - np.arctan2(self.a3, self.c3))

    @property
    def hand(self) -> float:
        """Maximum distance [m] of the flange from the point where axes 5 and 6 meet."""
        return float(np.hypot(self.a4, self.c4)) + self._beyond

    @property
    def stretched(self) -> float:
        """Maximum distance [m] from axis 1 to the point where axes 5 and 6 meet."""
        return self.upper + self.fore


@dataclasses.dataclass(frozen=True)
class RodCoupling:
    """A parallel rod, by which motor 3 sets the angle of link 3 to the base instead of that to link 2.

    The controller's value of axis 3 is therefore the sum of the serial angles of joints 2 and 3. This sum has
    limits of its own, in addition to those of the serial angle of joint 3.

    Attributes:
        axis3_lower: Lower limit [rad] of the sum.
        axis3_upper: Upper limit [rad] of the sum.
    """

    axis3_lower: float
    axis3_upper: float


@dataclasses.dataclass(frozen=True)
class JointStiffness:
    """Stiffness of the drives of an arm's axes, with links taken as rigid.

    Attributes:
        joints: Stiffness (6,) [N m/rad] about the axes as the controller counts them.
        source: Who measured it, where and how.
    """

    joints: FloatArray
    source: str


@dataclasses.dataclass(frozen=True)
class VisualShape:
    """Visual shape of a link.

    Attributes:
        shape: Shape in the link's frame.
        color: Colour (red, green, blue, each 0 to 1). None means the colour of collision shapes.
    """

    shape: Shape
    color: tuple[float, ...] | None = None


@dataclasses.dataclass(frozen=True)
class RobotFile:
    """Data that the robot of a user takes from its URDF. J is the number of joints.

    Attributes:
        text: Text of the URDF.
        base: Name of the base link.
        tip: Name of the tip link.
        zero: Poses (J + 2, 4, 4) in the base, with all joints at zero: of the base, of the links that the
            joints rotate, and of the tip.
        axis: Unit vectors (J, 3) of the joints' axes in the base, with all joints at zero. The axes pass
            through the origins of the links.
        shapes: Collision shapes of the base and of links 1 to J, in the frames of these links.
        joints: Names of the joints.
        visuals: Visual shapes of the same links, which replace ``shapes`` in pictures but in no distance.
        unseen: Texts on parts of the URDF that pictures leave out, and why.
    """

    text: str
    base: str
    tip: str
    zero: FloatArray
    axis: FloatArray
    shapes: tuple[tuple[Shape, ...], ...]
    joints: tuple[str, ...]
    visuals: tuple[tuple[VisualShape, ...], ...] = ()
    unseen: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class RobotData:
    """One robot of J axes. Joint angles are serial angles [rad]: each joint's angle to the link before it.

    Attributes:
        name: Name in problem files.
        title: Name for people.
        family: Controller family.
        controller: Name of the controller.
        form: Geometry.
        lower: Lower joint limits (J,) [rad].
        upper: Upper joint limits (J,) [rad].
        velocity: Maximum joint speeds (J,) [rad/s].
        acceleration: Maximum joint accelerations (J,) [rad/s^2].
        payload: Payload [kg].
        reach: Reach [m].
        coupling: Parallel rod, if any.
        home: Default posture (J,) [rad] of cells that state none.
        sources: Sources of the values.
        assumed: Values without a source, each with the reason why it was chosen.
        stiffness: Stiffness of the drives. None if no reliable one is published, so that the arm's deflection
            cannot be computed.
        file: The user's URDF, None for robots of the catalogue, whose URDF is :func:`urdf_path`.
    """

    name: str
    title: str
    family: Family
    controller: str
    form: ArmForm
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    payload: float
    reach: float
    coupling: RodCoupling | None
    home: FloatArray
    sources: tuple[str, ...]
    assumed: tuple[str, ...]
    stiffness: JointStiffness | None = None
    file: RobotFile | None = None

    @property
    def axes(self) -> int:
        """Number J of the robot's axes."""
        return self.form.count

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints in its URDF."""
        return JOINTS if self.file is None else self.file.joints

    @property
    def opw(self) -> OpwParameters:
        """Geometry of an arm with a spherical wrist. Only for these, ABB's and KUKA's programs name postures.

        Raises:
            TypeError: The arm has no spherical wrist.
        """
        if not isinstance(self.form, OpwParameters):
            raise TypeError(f"{self.name} has no spherical wrist")
        return self.form

    @property
    def has_unnamed_postures(self) -> bool:
        """Whether it is uncertain how ABB's confdata name the arm's postures.

        This applies to arms with parallel rods or offset wrists. They run with ConfL off: straight moves
        continue from the previous posture.
        """
        return self.coupling is not None or isinstance(self.form, OffsetParameters)

    def to_controller(self, q: FloatArray) -> FloatArray:
        """Return the controller's joint values (..., J) [rad] of serial angles (..., J)."""
        return self._couple(q, 1.0)

    def from_controller(self, values: FloatArray) -> FloatArray:
        """Return the serial angles (..., J) [rad] of the controller's joint values (..., J)."""
        return self._couple(values, -1.0)

    def _couple(self, q: FloatArray, sign: float) -> FloatArray:
        """Return joint values (..., J) with ``sign`` times joint 2 added to joint 3 if a rod couples them."""
        values = np.array(q, dtype=np.float64)
        if self.coupling is not None:
            values[..., 2] += sign * values[..., 1]
        return values

    def limit_margin(self, q: FloatArray) -> FloatArray:
        """Return the smallest distance (...,) [rad] of serial angles (..., J) to any limit.

        Limits are those of the joints and of the parallel rod. The distance is negative outside of them, and
        NaN where an angle is NaN.
        """
        q = np.asarray(q, dtype=np.float64)
        margin = np.minimum(q - self.lower, self.upper - q).min(axis=-1)
        if self.coupling is not None:
            axis3 = q[..., 1] + q[..., 2]
            rod = np.minimum(axis3 - self.coupling.axis3_lower, self.coupling.axis3_upper - axis3)
            margin = np.minimum(margin, rod)
        return np.asarray(margin)


def joint_columns(robots: Mapping[str, RobotData]) -> dict[str, slice]:
    """Return the columns of each robot's joints in arrays with the joints of all robots side by side."""
    ends = [0, *itertools.accumulate(robot.axes for robot in robots.values())]
    return {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(robots)}


def data_dir(kind: DataKind) -> Path:
    """Return the folder of one kind of the data that comes with the package.

    It is in the package if this is installed, else in the checkout next to it.

    Raises:
        TandemError: It is in neither of them (``catalogue.missing_data``).
    """
    for folder in (_PACKAGE / "_installed" / kind, _PACKAGE.parent / kind):
        if folder.is_dir():
            return folder
    raise _missing(_PACKAGE / "_installed" / kind)


def bundled_path(path: Path) -> Path:
    """Return the path itself, or that of the file of this name among the bundled problems.

    The latter is only returned if the path is relative without "..", no file is there, and the bundled
    file exists. The name may start with ``problems/``.
    """
    parts = path.parts[1:] if path.parts[:1] == ("problems",) else path.parts
    inside = data_dir("problems").joinpath(*parts)
    is_existing = is_file(path) or path.is_absolute() or ".." in parts
    return inside if not is_existing and is_file(inside) else path


def robot_names() -> tuple[str, ...]:
    """Return the names of all robots, in the order of the data file."""
    return tuple(_table())


def robot(name: str) -> RobotData:
    """Return the robot of that name.

    Raises:
        TandemError: The name is unknown (``problem.unknown_robot``). The message lists the known ones.
    """
    table = _table()
    if name not in table:
        message = format_message("problem.unknown_robot", name=name, known_robots=", ".join(table))
        raise issue_error("problem.unknown_robot", message, hint="choose one of these names")
    return table[name]


def urdf_path(name: str) -> Path:
    """Return the path of a robot's URDF file.

    Raises:
        TandemError: As in :func:`robot`, or the file is missing (``catalogue.missing_data``).
    """
    path = data_dir("urdf") / f"{robot(name).name}.urdf"
    if not path.is_file():
        raise _missing(path)
    return path


def damaged_file_error(path: Path, what: str) -> TandemError:
    """Return ``catalogue.missing_data`` for a file of Tandem that cannot be read. ``what`` is the reason."""
    return _error(f"{path} is part of Tandem and cannot be read: {what}")


def _missing(path: Path) -> TandemError:
    """Return ``catalogue.missing_data`` for a file or folder of Tandem that does not exist."""
    return _error(f"{path}, a part of Tandem, is missing")


def _error(message: str) -> TandemError:
    """Return ``catalogue.missing_data`` with a message and the hint to install Tandem again."""
    return issue_error(
        "catalogue.missing_data", message, hint="install tandem-planner again, or restore the checkout"
    )


@functools.cache
def _table() -> dict[str, RobotData]:
    """Return all built-in robots by name, read from the data file once.

    Raises:
        TandemError: The file is missing, or an entry's stiffness is damaged (``catalogue.missing_data``).
    """
    path = data_dir("urdf") / "robots.yaml"
    if not path.is_file():
        raise _missing(path)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, if PyYAML has it
    data = yaml.load(path.read_text(encoding="utf-8"), Loader=loader)
    return {name: _read(name, entry) for name, entry in data.items()}


def _read(name: str, entry: dict[str, Any]) -> RobotData:
    """Return the robot of an entry of the data file, with angles in radians and read-only arrays.

    Makers do not publish accelerations. Each is assumed such that the axis reaches its full speed in
    ``full_speed_after_s`` of the entry.
    """
    limits = np.array(entry["limits_deg"], dtype=np.float64) * DEG
    velocity = np.array(entry["velocity_deg_s"], dtype=np.float64) * DEG
    is_spherical = "opw_m" in entry
    form_class: Any = OpwParameters if is_spherical else OffsetParameters
    lengths = entry["opw_m" if is_spherical else "offset_wrist_m"]
    rise_time = float(entry["full_speed_after_s"])
    rod_limits = entry.get("coupled_deg")
    acceleration = f"acceleration: assumed, every axis reaches its full speed in {rise_time:g} s from rest"
    return RobotData(
        name=name,
        title=entry["title"],
        family=entry["family"],
        controller=entry["controller"],
        form=form_class(
            **{key: float(value) for key, value in lengths.items()},
            offsets=_read_only(np.array(entry["offset_deg"], dtype=np.float64) * DEG),
            signs=_read_only(np.array(entry["sign"], dtype=np.float64)),
        ),
        lower=_read_only(limits[:, 0]),
        upper=_read_only(limits[:, 1]),
        velocity=_read_only(velocity),
        acceleration=_read_only(velocity / rise_time),
        payload=float(entry["payload_kg"]),
        reach=float(entry["reach_m"]),
        coupling=None if rod_limits is None else RodCoupling(rod_limits[0] * DEG, rod_limits[1] * DEG),
        home=_read_only(np.array(entry.get("home_deg", np.zeros(6)), dtype=np.float64) * DEG),
        sources=tuple(entry["sources"]),
        assumed=(acceleration, *entry.get("unverified", ())),
        stiffness=_stiffness(name, entry.get("stiffness")),
    )


def _stiffness(name: str, entry: dict[str, Any] | None) -> JointStiffness | None:
    """Return the stiffness of a robot from the ``stiffness`` of its entry, None without one.

    Raises:
        TandemError: It is not a positive stiffness of six axes with a source (``catalogue.missing_data``).
    """
    if entry is None:
        return None
    joints, source = np.array(entry.get("joints_nm_rad", ()), dtype=np.float64), entry.get("source", "")
    if joints.shape != (6,) or not (joints > 0.0).all() or not np.isfinite(joints).all() or not source:
        reason = f"{name}: stiffness needs joints_nm_rad of six axes, each above 0, and its source"
        raise damaged_file_error(data_dir("urdf") / "robots.yaml", reason)
    return JointStiffness(_read_only(joints), source)


def _read_only(array: FloatArray) -> FloatArray:
    """Return a read-only copy, because the robots of the catalogue are shared."""
    read_only = array.copy()
    read_only.flags.writeable = False
    return read_only
