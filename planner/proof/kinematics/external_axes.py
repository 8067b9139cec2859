"""External axes as the proof knows them: those that a task of the text moves, and where they have bases and
bodies, by sums of its own."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.problem import STOCK, TILT, Arm, Cell, Turntable
from planner.programs.steps import MoveStep

SAME_VALUE = 1e-6
"""Values [m, rad] that differ by no more are one station."""


@dataclasses.dataclass(frozen=True)
class OuterAxis:
    """An external axis that a task of the text moves: what it ``carries``, by the name of its value among
    stations, that of an arm's axis, :data:`STOCK` or :data:`TILT`; its ``unit``, of the mechanical unit of
    that name or one of its axes; its ``column`` [from 0] in targets, whose values times ``scale`` are in m or
    rad, as ``low``, ``high``, ``home``, ``speed`` and ``acceleration`` are, which is infinite where none is
    stated; ``sign`` is the unit of values in texts. ``mechanism``: name of its mechanical unit. ``follow``:
    of a track that goes along while its arm works, the share of the tool's way. ``way`` (3,): the unit vector
    of the world along which a linear one goes."""

    carries: str
    mechanism: str
    unit: str
    column: int
    scale: float
    sign: str
    low: float
    high: float
    home: float
    speed: float
    acceleration: float
    follow: float | None = None
    way: tuple[float, float, float] | None = None

    @property
    def arm(self) -> str | None:
        """The arm that it takes along; None for an axis under the block."""
        return None if self.carries in (STOCK, TILT) else self.carries.partition("/")[0]

    def told(self, move: MoveStep) -> float:
        """The speed [m/s, rad/s] that the text gives the axis in a move."""
        if move.speed.outer is not None:  # KRL: a share of the axis' own
            return move.speed.outer[self.column] * self.speed
        return move.speed.rotary if self.carries in (STOCK, TILT) else move.speed.linear

    def shown(self, value: float) -> str:
        """A value [m, rad] for messages."""
        return f"{round(value / self.scale, 6):g} {self.sign}"


def outer_axes(arm: Arm, table: Turntable | None) -> tuple[OuterAxis, ...]:
    """The external axes that the task of an arm moves: those under it from the floor up, the turntable or the
    turn axis of a positioner, the tilt axis of one."""
    out = []
    for name, rail in arm.rails.items():
        ends = (rail.low, rail.high, rail.home, rail.speed, rail.acceleration)
        x, y, z = rail.axis.tolist()
        known = (rail.unit, rail.label, rail.column)
        out.append(OuterAxis(name, *known, 1e-3, "mm", *ends, rail.follow, (x, y, z)))
    for name, axis in table.axes.items() if table is not None and table.arm == arm.name else ():
        ends = (axis.low, axis.high, axis.home, axis.speed, axis.acceleration)
        known = (axis.unit, axis.label, axis.column)
        out.append(OuterAxis(name, *known, np.pi / 180.0, "deg", *ends))
    return tuple(out)


def place_in_turn(axes: Sequence[OuterAxis], axis: OuterAxis, here: float, there: float) -> tuple[int, int]:
    """When an axis of those of a task goes from one value [m, rad] to another, one after the other:
    ascending. Of those under an arm such that come nearer to home go first, from the arm down, then the
    others, from the floor up; of those under the block the turn goes before the tilt."""
    place = axes.index(axis)
    nearer = abs(here - axis.home) - abs(there - axis.home) > SAME_VALUE
    return (0, -place) if axis.arm is not None and nearer else (1, place)


def slid(arm: Arm, values: Mapping[str, float], last: str | None = None) -> FloatArray:
    """How far (3,) [m] the axes under an arm take what stands on them at ``values`` [m] by their names, one
    that is not named at 0: its base, or what stands on the axis ``last``."""
    out = np.zeros(3)
    for name, rail in arm.rails.items():
        out = out + values.get(name, 0.0) * np.asarray(rail.axis)
        if name == last:
            break
    return out


def moved_on(cell: Cell, there: Mapping[str, float], here: Mapping[str, float]) -> dict[str, FloatArray]:
    """Motions (4, 4) of what stands on axes under arms, by their names, from values ``here`` [m] to those
    ``there``."""
    out = {}
    for arm in cell.arms:
        for name, rail in arm.rails.items():
            if rail.carries:
                out[name] = np.eye(4)
                out[name][:3, 3] = slid(arm, there, name) - slid(arm, here, name)
    return out


def outer_values(arm: Arm, external: FloatArray) -> dict[str, float]:
    """Values [m] of the axes under an arm by their names, of a target's external axes (6,) as it has them."""
    return {axis.carries: axis.scale * float(external[axis.column]) for axis in outer_axes(arm, None)}


def floor_of(cell: Cell) -> float:
    """The height [m] of the floor: 0, or where the lowest arm that stands upright has its foot with the axes
    under it at 0."""
    feet = [arm.base[2, 3] - slid(arm, arm.stands)[2] for arm in cell.arms if arm.base[2, 2] > 0.5]
    return float(min([0.0, *feet]))
