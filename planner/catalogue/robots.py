"""The robots that are built in: dimensions, limits and speeds with their sources, from
``urdf/robots.yaml``.
"""

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
from planner.issues import TandemError, refusal

Family = str
"""Whose controller an arm has, which is what its programs are written for: "ABB", "KUKA", "UR", "ROS",
"generic", or a family of an installed language."""
DataKind = Literal["urdf", "problems"]

JOINTS: Final = tuple(f"joint_{number}" for number in range(1, 7))
"""Names of the joints in the URDFs that are built in."""
_PACKAGE: Final = Path(__file__).resolve().parents[1]
"""Folder of the package."""


class ArmForm:
    """What the closed forms of arms have in common: where each of their J axes is, and what stands before and
    behind. ``offsets`` (J,) [rad] and ``signs`` (J,): theta_i = signs_i * q_i - offsets_i.

    An arm from a file whose links of base and tip stand otherwise than those of the form has that between
    ``left`` and ``right`` (4, 4), None where they are the form's own. ``axes``: the axes x, y or z of their
    links about which theta_1 to theta_J turn. ``singular``: joints, from 0, that make postures singular.
    ``b`` [m]: how far the wrist stands beside the plane of axis 1. ``branches``: numbers of solutions.
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
        """Poses (..., 4, 4) of the form's own flange in its own base, of flange poses (..., 4, 4)."""
        if self.left is not None:
            flange = inverse(self.left) @ flange
        return flange if self.right is None else flange @ inverse(self.right)

    @property
    def count(self) -> int:
        """Number J of its axes."""
        return len(self.axes)

    @property
    def steps(self) -> FloatArray:
        """Ways (J + 1, 3) [m] from each link to the next one at theta zero, from the base to the flange."""
        raise NotImplementedError

    @property
    def turned(self) -> FloatArray:
        """How (3, 3) the flange stands on the last link."""
        return np.eye(3)

    @property
    def hand(self) -> float:
        """From the origin of link 4 or the wrist's centre, where this is one, to the flange at most [m]."""
        raise NotImplementedError

    @property
    def stretched(self) -> float:
        """From axis 1 to where the hand begins, at most [m], in the plane of the arm."""
        raise NotImplementedError

    @property
    def shoulder(self) -> float:
        """From axis 1 to the origin of link 2 [m], across the axis; 0 where axes 1 and 2 meet."""
        return 0.0

    @property
    def _beyond(self) -> float:
        return 0.0 if self.right is None else float(np.linalg.norm(self.right[:3, 3]))


class OrthoParallel(ArmForm):
    """What ortho-parallel arms share up to the point where axes 4 and 5 meet: lengths [m] as of
    :class:`OpwParameters`."""

    axes: ClassVar[str] = "zyyzyz"
    a1: float
    a2: float
    c2: float
    c3: float

    @property
    def stretched(self) -> float:
        """From axis 1 to where axes 4 and 5 meet, at most [m], in the plane of the arm."""
        return float(abs(self.a1) + self.c2 + np.hypot(self.a2, self.c3))

    @property
    def shoulder(self) -> float:
        """From axis 1 to the origin of link 2 [m]."""
        return float(np.hypot(self.a1, self.b))


@dataclasses.dataclass(frozen=True)
class OpwParameters(OrthoParallel):
    """Geometry of an ortho-parallel arm with a spherical wrist (Brandstoetter, Angerer, Hofbaur 2014).

    Lengths [m]. Flange pose in the base: Rz(t1) T(a1, b, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4)
    Ry(t5) Rz(t6) T(0, 0, c4).
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
        """As :attr:`ArmForm.steps`; the wrist's three axes meet."""
        ahead = (0.0, self.a1, 0.0, self.a2, 0.0, 0.0, 0.0)
        across = (0.0, self.b, 0.0, 0.0, 0.0, 0.0, 0.0)
        up = (0.0, self.c1, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, across, up], axis=1)

    @property
    def hand(self) -> float:
        """From the wrist's centre to the flange at most [m]."""
        return abs(self.c4) + self._beyond


@dataclasses.dataclass(frozen=True)
class OffsetParameters(OrthoParallel):
    """Geometry of an ortho-parallel arm with an offset wrist: axes 4 and 5 meet, axis 6 passes beside that
    point, as those of ABB's GoFa and Fanuc's CRX.

    Lengths [m], as of :class:`OpwParameters`; ``a3`` and ``b3``: how far axis 6 is off the point where axes 4
    and 5 meet, across axis 5 and along it; ``c4`` reaches from the foot there to the flange. Flange pose in
    the base: Rz(t1) T(a1, 0, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(a2, 0, c3) Rz(t4) Ry(t5) T(a3, b3, 0) Rz(t6)
    T(0, 0, c4).
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
        """As :attr:`ArmForm.steps`; axes 4 and 5 meet."""
        ahead = (0.0, self.a1, 0.0, self.a2, 0.0, self.a3, 0.0)
        across = (0.0, 0.0, 0.0, 0.0, 0.0, self.b3, 0.0)
        up = (0.0, self.c1, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, across, up], axis=1)

    @property
    def hand(self) -> float:
        """From where axes 4 and 5 meet to the flange at most [m]."""
        return float(np.linalg.norm([self.a3, self.b3, self.c4])) + self._beyond


@dataclasses.dataclass(frozen=True)
class ParallelParameters(ArmForm):
    """Geometry of an arm whose axes 2, 3 and 4 are parallel, as those of UR: 1 meets 2, 5 meets 4 and 6, and
    each of 1-2, 4-5 and 5-6 is square.

    Lengths [m], ``b`` >= 0. Flange pose in the base: Rz(t1) T(0, 0, c1) Ry(t2) T(0, 0, c2) Ry(t3) T(0, 0, c3)
    Ry(t4) T(0, b, c4) Rz(t5) Ry(t6) T(0, c5, 0) Rx(-90 deg). Of a maker's Denavit-Hartenberg table c1 is d1,
    c2 and c3 are the sizes of a2 and a3, b, c4 and c5 are d4, d5 and d6.
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
        """As :attr:`ArmForm.steps`; axes 5 and 6 meet."""
        up = (0.0, self.c1, self.c2, self.c3, self.c4, 0.0, 0.0)
        across = (0.0, 0.0, 0.0, 0.0, self.b, 0.0, self.c5)
        return np.stack([np.zeros(7), across, up], axis=1)

    @property
    def turned(self) -> FloatArray:
        """Rx(-90 deg): z of the flange is along axis 6, out of the arm."""
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

    @property
    def hand(self) -> float:
        """From axis 4 in the plane of the arm to the flange at most [m]."""
        return float(np.hypot(self.b, self.c4)) + abs(self.c5) + self._beyond

    @property
    def stretched(self) -> float:
        """From axis 1 to axis 4, at most [m]."""
        return self.c2 + self.c3


@dataclasses.dataclass(frozen=True)
class SevenParameters(ArmForm):
    """Geometry of an arm with seven axes, each square to the one before: 1, 2 and 3 meet in its shoulder, 5
    and 6 meet, and 7 passes beside that point or through it, as those of Franka's Panda and KUKA's iiwa.

    Lengths [m]; ``a2`` and ``a3``: how far the elbow stands before the upper arm, and the forearm before the
    elbow; ``a4``: axis 7 before axis 6. Flange pose in the base: Rz(t1) T(0, 0, c1) Ry(t2) Rz(t3) T(a2, 0,
    c2) Ry(t4) T(a3, 0, c3) Rz(t5) Ry(t6) T(a4, 0, 0) Rz(t7) T(0, 0, c4).
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
        """As :attr:`ArmForm.steps`; axes 2 and 3 meet, and 5 and 6."""
        ahead = (0.0, 0.0, 0.0, self.a2, self.a3, 0.0, self.a4, 0.0)
        up = (0.0, self.c1, 0.0, self.c2, self.c3, 0.0, 0.0, self.c4)
        return np.stack([ahead, np.zeros(8), up], axis=1)

    @property
    def upper(self) -> float:
        """From the shoulder to axis 4 [m]."""
        return float(np.hypot(self.a2, self.c2))

    @property
    def fore(self) -> float:
        """From axis 4 to where axes 5 and 6 meet [m]."""
        return float(np.hypot(self.a3, self.c3))

    @property
    def straight(self) -> float:
        """Theta 4 at which the arm is stretched [rad]."""
        return float(np.arctan2(self.a2, self.c2) - np.arctan2(self.a3, self.c3))

    @property
    def hand(self) -> float:
        """From where axes 5 and 6 meet to the flange at most [m]."""
        return float(np.hypot(self.a4, self.c4)) + self._beyond

    @property
    def stretched(self) -> float:
        """From axis 1 to where axes 5 and 6 meet, at most [m]."""
        return self.upper + self.fore


@dataclasses.dataclass(frozen=True)
class RodCoupling:
    """A parallel rod: motor 3 turns the upper arm against the base, so the controller's axis 3 is serial q3
    + q2.

    ``axis3_lower``, ``axis3_upper`` [rad] bound that sum; the robot's own limits bound the serial q3. Both
    hold.
    """

    axis3_lower: float
    axis3_upper: float


@dataclasses.dataclass(frozen=True)
class JointStiffness:
    """How stiff the drives of an arm's axes are: ``joints`` (6,) [N m/rad] about the axes as the controller
    counts them, links taken as rigid. ``source``: who identified them, where and how."""

    joints: FloatArray
    source: str


@dataclasses.dataclass(frozen=True)
class Look:
    """What is seen of a link: a shape in the link's frame, in a colour (red, green, blue in 0..1) where it is
    not that of shapes for collision."""

    shape: Shape
    color: tuple[float, ...] | None = None


@dataclasses.dataclass(frozen=True)
class RobotFile:
    """What a robot of the user's own has of its URDF: its ``text``, and the links ``base`` and ``tip`` in it.

    ``zero`` (J + 2, 4, 4): frames of the base, of the links that the joints turn and of the tip, in the base
    with all joints at zero; ``axis`` (J, 3): unit vectors of the axes in the base, through the origins of the
    links. ``shapes``: what is held apart, of the base and of links 1 to J, in their frames. ``joints``: names
    of the joints. ``looks``: what is seen of the same links in place of ``shapes``, which are seen where
    there are none; no distance knows of them. ``unseen``: what of the URDF's is not seen, and why.
    """

    text: str
    base: str
    tip: str
    zero: FloatArray
    axis: FloatArray
    shapes: tuple[tuple[Shape, ...], ...]
    joints: tuple[str, ...]
    looks: tuple[tuple[Look, ...], ...] = ()
    unseen: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class RobotData:
    """One robot of J axes. Joint angles are serial angles (J,) [rad]; velocity [rad/s], acceleration
    [rad/s^2].

    ``home`` (J,) [rad] is the posture of cells that state none. ``sources`` say where figures come from,
    ``assumed`` which ones do not come from a source, and on what ground they were set. ``stiffness`` is None
    where nobody has published any that is certain: then nothing is claimed of how far the arm gives way.
    ``file`` is None for robots of the catalogue, whose URDF is :func:`urdf_path`.
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
        """Number J of its axes."""
        return self.form.count

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints in its URDF."""
        return JOINTS if self.file is None else self.file.joints

    @property
    def opw(self) -> OpwParameters:
        """The form of an arm with a spherical wrist, whose solutions ABB and KUKA name; other arms have none:
        raises ``TypeError``."""
        if not isinstance(self.form, OpwParameters):
            raise TypeError(f"{self.name} has no spherical wrist")
        return self.form

    @property
    def unnamed(self) -> bool:
        """Whether it is not settled how ABB's confdata name the arm's postures: parallel rods, offset wrists.
        Such arms run with ConfL off: straight moves go on from the posture before them."""
        return self.coupling is not None or isinstance(self.form, OffsetParameters)

    def to_controller(self, q: FloatArray) -> FloatArray:
        """The controller's joint values (..., J) [rad] of serial angles (..., J)."""
        return self._couple(q, 1.0)

    def from_controller(self, values: FloatArray) -> FloatArray:
        """Serial angles (..., J) [rad] of the controller's joint values (..., J)."""
        return self._couple(values, -1.0)

    def _couple(self, q: FloatArray, sign: float) -> FloatArray:
        out = np.array(q, dtype=np.float64)
        if self.coupling is not None:
            out[..., 2] += sign * out[..., 1]
        return out

    def limit_margin(self, q: FloatArray) -> FloatArray:
        """Least distance (...,) [rad] of serial angles (..., J) to any limit; negative outside, NaN for
        NaN."""
        q = np.asarray(q, dtype=np.float64)
        margin = np.minimum(q - self.lower, self.upper - q).min(axis=-1)
        if self.coupling is not None:
            axis3 = q[..., 1] + q[..., 2]
            rod = np.minimum(axis3 - self.coupling.axis3_lower, self.coupling.axis3_upper - axis3)
            margin = np.minimum(margin, rod)
        return np.asarray(margin)


def columns_of(robots: Mapping[str, RobotData]) -> dict[str, slice]:
    """Where the joints of each of some robots are among those of all of them, one after the other."""
    ends = [0, *itertools.accumulate(robot.axes for robot in robots.values())]
    return {name: slice(ends[k], ends[k + 1]) for k, name in enumerate(robots)}


def data_dir(kind: DataKind) -> Path:
    """Folder of the data that travels with the package, in an installed package or in a checkout.

    Raises :class:`TandemError` (``catalogue.missing_data``) when neither has it.
    """
    for folder in (_PACKAGE / "_installed" / kind, _PACKAGE.parent / kind):
        if folder.is_dir():
            return folder
    raise _missing(_PACKAGE / "_installed" / kind)


def bundled(path: Path) -> Path:
    """The file itself, or the bundled problem's file of that name where there is none; the name may begin
    with ``problems/``.
    """
    parts = path.parts[1:] if path.parts[:1] == ("problems",) else path.parts
    inside = data_dir("problems").joinpath(*parts)
    own = is_file(path) or path.is_absolute() or ".." in parts
    return inside if not own and is_file(inside) else path


def robot_names() -> tuple[str, ...]:
    """Names of all robots, in the order of the data file."""
    return tuple(_table())


def robot(name: str) -> RobotData:
    """The robot of that name; raises :class:`TandemError` (``problem.unknown_robot``) naming the known
    ones."""
    table = _table()
    if name not in table:
        message = f"robot {name!r} is not in the catalogue, which has {', '.join(table)}"
        raise refusal("problem.unknown_robot", message, hint="choose one of these names")
    return table[name]


def urdf_path(name: str) -> Path:
    """Path of the robot's URDF file; raises as :func:`robot`, or ``catalogue.missing_data`` without the
    file."""
    path = data_dir("urdf") / f"{robot(name).name}.urdf"
    if not path.is_file():
        raise _missing(path)
    return path


def damaged(path: Path, what: str) -> TandemError:
    """The error (``catalogue.missing_data``) of a file of Tandem that cannot be read: ``what`` says why."""
    return _error(f"{path} is part of Tandem and cannot be read: {what}")


def _missing(path: Path) -> TandemError:
    return _error(f"{path} is missing, which is part of Tandem")


def _error(message: str) -> TandemError:
    return refusal(
        "catalogue.missing_data", message, hint="install tandem-planner again, or restore the checkout"
    )


@functools.cache
def _table() -> dict[str, RobotData]:
    path = data_dir("urdf") / "robots.yaml"
    if not path.is_file():
        raise _missing(path)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster, where PyYAML has it
    data = yaml.load(path.read_text(encoding="utf-8"), Loader=loader)
    return {name: _read(name, entry) for name, entry in data.items()}


def _read(name: str, entry: dict[str, Any]) -> RobotData:
    limits = np.array(entry["limits_deg"], dtype=np.float64) * DEG
    velocity = np.array(entry["velocity_deg_s"], dtype=np.float64) * DEG
    spherical = "opw_m" in entry
    kind: Any = OpwParameters if spherical else OffsetParameters
    lengths = entry["opw_m" if spherical else "offset_wrist_m"]
    rise = float(entry["full_speed_after_s"])
    coupled = entry.get("coupled_deg")
    acceleration = f"acceleration: assumed, every axis reaches its full speed in {rise:g} s from rest"
    return RobotData(
        name=name,
        title=entry["title"],
        family=entry["family"],
        controller=entry["controller"],
        form=kind(
            **{key: float(value) for key, value in lengths.items()},
            offsets=_frozen(np.array(entry["offset_deg"], dtype=np.float64) * DEG),
            signs=_frozen(np.array(entry["sign"], dtype=np.float64)),
        ),
        lower=_frozen(limits[:, 0]),
        upper=_frozen(limits[:, 1]),
        velocity=_frozen(velocity),
        acceleration=_frozen(velocity / rise),
        payload=float(entry["payload_kg"]),
        reach=float(entry["reach_m"]),
        coupling=None if coupled is None else RodCoupling(coupled[0] * DEG, coupled[1] * DEG),
        home=_frozen(np.array(entry.get("home_deg", np.zeros(6)), dtype=np.float64) * DEG),
        sources=tuple(entry["sources"]),
        assumed=(acceleration, *entry.get("unverified", ())),
        stiffness=_stiffness(name, entry.get("stiffness")),
    )


def _stiffness(name: str, entry: dict[str, Any] | None) -> JointStiffness | None:
    """Raises :class:`TandemError` (``catalogue.missing_data``) for what is no stiffness of six axes with a
    source."""
    if entry is None:
        return None
    joints, source = np.array(entry.get("joints_nm_rad", ()), dtype=np.float64), entry.get("source", "")
    if joints.shape != (6,) or not (joints > 0.0).all() or not np.isfinite(joints).all() or not source:
        got = f"{name}: stiffness needs joints_nm_rad of six axes, each above 0, and its source"
        raise damaged(data_dir("urdf") / "robots.yaml", got)
    return JointStiffness(_frozen(joints), source)


def _frozen(array: FloatArray) -> FloatArray:
    out = array.copy()
    out.flags.writeable = False
    return out
