"""What is to be planned, as values in SI units: cell, stock, part, operations.

:mod:`planner.problem_file` reads these from YAML. A process defines its own operation class; all that the
rest of the house needs of one is :class:`Operation`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ShapeKind = Literal["box", "cylinder", "capsule", "sphere", "mesh"]


@dataclasses.dataclass(frozen=True)
class Shape:
    """A rigid shape at ``pose`` (4, 4) in the frame of the thing that it belongs to.

    ``size`` [m]: box (x, y, z); cylinder and capsule (radius, length along z, a capsule's without its caps);
    sphere (radius,); mesh () with ``vertices`` (V, 3) and ``faces`` (F, 3), its collision shape being the
    convex hull.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    pose: FloatArray
    vertices: FloatArray | None = None
    faces: NDArray[np.int64] | None = None


@dataclasses.dataclass(frozen=True)
class Tool:
    """A tool on a flange: ``tcp`` (4, 4) and ``shapes`` in the flange frame; mass [kg], centre of gravity
    (3,) [m].
    """

    name: str
    tcp: FloatArray
    mass: float
    cog: FloatArray
    shapes: tuple[Shape, ...]


@dataclasses.dataclass(frozen=True)
class Arm:
    """One robot of a cell: catalogue name, base pose (4, 4) in the world, tool, home joints (6,) [rad].

    ``base_auto``: the base may be moved by the placement search.
    """

    name: str
    robot: str
    base: FloatArray
    tool: Tool
    home: FloatArray
    base_auto: bool = False


@dataclasses.dataclass(frozen=True)
class Obstacle:
    """A fixed body of the cell, placed in the world by the poses of its shapes."""

    name: str
    shapes: tuple[Shape, ...]


@dataclasses.dataclass(frozen=True)
class Cell:
    """Arms and obstacles; ``task`` names of the controller and the signal names are in ``controller``."""

    name: str
    arms: tuple[Arm, ...]
    obstacles: tuple[Obstacle, ...]
    controller: Controller

    def arm(self, name: str) -> Arm:
        """The arm of that name; raises ``KeyError``."""
        for arm in self.arms:
            if arm.name == name:
                return arm
        raise KeyError(name)


@dataclasses.dataclass(frozen=True)
class Controller:
    """How the programs address the controller: task and mechanical unit per arm, signals, limits of a
    module.
    """

    tasks: tuple[str, ...] = ("T_ROB1", "T_ROB2")
    units: tuple[str, ...] = ("ROB_1", "ROB_2")
    wire_signal: str = "doWirePower"
    max_moves: int = 5000
    max_bytes: int = 1_000_000


@dataclasses.dataclass(frozen=True)
class Mesh:
    """Triangles: ``vertices`` (V, 3) [m], ``faces`` (F, 3)."""

    vertices: FloatArray
    faces: NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Part:
    """The wanted part in the stock frame: ``front`` and ``back`` face as open meshes with normals away from
    the part.
    """

    front: Mesh
    back: Mesh | None


@dataclasses.dataclass(frozen=True)
class Stock:
    """The raw block: ``size`` (3,) [m]; frame at the centre of its bottom face, z up through the block.

    ``place`` (4, 4) is its pose in the world, or None where the placement search is to find it, with
    ``attitude`` (3, 3), its rotation up to a yaw about the world's vertical. ``support``: shapes in the stock
    frame that stand under the block and move with it (a pedestal).
    """

    size: FloatArray
    place: FloatArray | None
    attitude: FloatArray
    support: tuple[Shape, ...] = ()

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


@dataclasses.dataclass(frozen=True)
class Settings:
    """Limits that motion and proof share: clearance [m], fractions of joint speed and acceleration, margins
    [rad].
    """

    clearance: float = 0.010
    speed_fraction: float = 0.9
    acceleration_fraction: float = 0.8
    joint_margin: float = np.deg2rad(2.0)
    singularity_margin: float = np.deg2rad(5.0)
    tcp_speed: float = 0.25
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Problem:
    """A whole problem: ``path`` is the file it came from, ``digest`` the SHA-256 over its values and files.

    ``source`` is what the file said, with the cell inside and file names made absolute, so that it can be
    carried along.
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
