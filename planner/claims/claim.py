"""Claims: what must hold of the operations of a job, as data.

A process states claims, and the proof has a rule for each kind. Claims follow from the problem alone, never
from a plan, so that a proof can start from the problem and the program text. All geometry is in the stock
frame, in metres. This file contains the base class and the kinds that several processes use. The kinds that
only one process uses are in ``processes/<name>/claims.py``.
"""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Final, Literal

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class ToolDistance:
    """Limit of the change of the TCP distance while one arm is one move ahead of the other.

    Attributes:
        segment: Segment in which the limit holds.
        arms: Names of the arms.
        change: Maximum change of the distance of their TCPs [m].
    """

    segment: Segment
    arms: tuple[str, str]
    change: float


@dataclasses.dataclass(frozen=True)
class Allowance:
    """Maximum deviation of a controller's curves from the straight moves of the replay.

    Claims are checked with so much less tolerance.

    Attributes:
        position: Deviation of the TCP on each of N moves, (N,) [m].
        rotation: Deviation of its orientation on each move, (N,) [rad].
        joints: Largest deviation of a joint [rad].
        body: Largest deviation of any body of the arm [m].
        speed_factor: Factor by which the tool may be faster than on the straight moves.
    """

    position: FloatArray
    rotation: FloatArray
    joints: float
    body: float
    speed_factor: float

    @property
    def max_rotation(self) -> float:
        """Largest deviation of the orientation [rad]."""
        return float(self.rotation.max())

    def at(self, lever: float) -> float:
        """Return the largest deviation [m] at a distance ``lever`` [m] from the TCP."""
        return float((self.position + lever * self.rotation).max())


@dataclasses.dataclass(frozen=True)
class Power:
    """An output that programs switch because of a claim, and that powers something.

    Attributes:
        signal: Name of the output.
        burns: Whether it lights a torch, which must not be lit again where it burned at a stop.
        pulsed: Whether the output is on for a pulse only, so that a stop does not have to switch it off.
    """

    signal: str
    burns: bool = False
    pulsed: bool = False


@dataclasses.dataclass(frozen=True)
class Claim:
    """Base class of all claims. A kind of claim is a frozen dataclass that inherits from it.

    Attributes:
        on_curves: Whether the rules of this kind hold on curves of spline blocks as well. If not, writers use
            straight moves only, and the proof refuses spline blocks.

    Raises:
        TypeError: Two kinds have the same name. Plan files state kinds by name.
    """

    on_curves: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Register the kind by its name. Two kinds of one name could not be told apart in plan files."""
        registered_module = _KINDS.get(cls.__name__, cls).__module__
        if registered_module != cls.__module__:
            raise TypeError(f"{cls.__module__}: {registered_module} already has a claim {cls.__name__}")
        _KINDS[cls.__name__] = cls

    @property
    def tool_distance(self) -> ToolDistance | None:
        """Limit of the change of the TCP distance while one arm is one move ahead, or None."""
        return None

    @property
    def longest_stop(self) -> tuple[Segment, float] | None:
        """A segment in which the tool may stand still with its power on, and for how long [s], or None."""
        return None

    @property
    def spindle_rule(self) -> tuple[str, str] | None:
        """Name of an arm and kind of segments in which the rule of this claim checks its spindle, or None."""
        return None

    @property
    def heated_length(self) -> float:
        """Length [m] of the wire that the claim is about, or 0."""
        return 0.0

    @property
    def joined_arms(self) -> tuple[str, ...]:
        """Names of the arms that are joined to one another, for example by a wire."""
        return ()

    def power(self) -> Power | None:
        """Return the output that programs switch because of the claim."""
        return None

    def tightened(self, allowance: Allowance) -> "Claim":
        """Return the claim with tolerances and feeds reduced by the deviation of curves.

        If the result holds on the straight moves, the claim holds on the curves.
        """
        return self

    def used_up(self, allowance: Allowance) -> tuple[float, float] | None:
        """Return the deviation and the tolerance [m] if curves use up the whole tolerance, else None."""
        return None

    def uneven_feed(self) -> Segment | None:
        """Return the segment whose feed varies along the path, or None."""
        return None


def powers(claims: Sequence[Claim]) -> tuple[Power, ...]:
    """Return the outputs that programs switch because of claims, in the order of the claims."""
    return tuple(power for claim in claims if (power := claim.power()) is not None)


_KINDS: Final[dict[str, type[Claim]]] = {}
"""Classes of claims by name."""


def kinds() -> tuple[type[Claim], ...]:
    """Return all kinds of claims whose modules have been imported, in the order of their definition.

    Reading a problem and loading a plan import the claims of all processes.
    """
    return tuple(_KINDS.values())


@dataclasses.dataclass(frozen=True)
class HoldsStock(Claim):
    """The tool of an arm holds the stock, and the controller knows the load.

    Attributes:
        arm: Name of the arm.
        grip: Stock frame in the arm's TCP frame, (4, 4) [m].
        mass: Mass of the stock [kg].
        cog: Centre of mass of the stock in the TCP frame, (3,) [m].
    """

    arm: str
    grip: FloatArray
    mass: float
    cog: FloatArray


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn(Claim):
    """The cutting edge (wire) touches the stock only in segments of some kinds, and only while it has power.

    Attributes:
        kinds: Kinds of these segments.
        signal: Output that switches the power of the edge.
        heat_up: Time that the edge takes to heat up [s].
    """

    on_curves: ClassVar[bool] = True

    kinds: tuple[str, ...]
    signal: str
    heat_up: float

    def power(self) -> Power | None:
        """Return the output that switches the power of the edge."""
        return Power(self.signal)


@dataclasses.dataclass(frozen=True)
class OneOf(Claim):
    """One of several groups of claims must hold, because the problem leaves open what is mounted.

    Attributes:
        either: Groups of claims. One group must hold as a whole: the one whose `OperatorDialogue` starts with
            the item that the operator mounts.
    """

    either: tuple[tuple[Claim, ...], ...]


@dataclasses.dataclass(frozen=True)
class FeedWindow(Claim):
    """While the cutting edge is inside the stock, its fastest point there moves within a speed range.

    Attributes:
        segment: Segment in which this holds.
        lower: Minimum speed [m/s].
        upper: Maximum speed [m/s].
    """

    on_curves: ClassVar[bool] = True

    segment: Segment
    lower: float
    upper: float

    def tightened(self, allowance: Allowance) -> "FeedWindow":
        """Return the window with a lower maximum speed, because the tool may be faster on curves."""
        return dataclasses.replace(self, upper=self.upper / allowance.speed_factor)


ForceFrame = Literal["stock", "tool", "feed"]
"""Frame of a force: that of the stock, of the TCP, or of the feed."""
FEED_PATH_M: Final = 5e-3
"""Length of path [m] before and after a point over which the direction of its feed is averaged.

Forces in the frame of the feed rotate with this direction.
"""


@dataclasses.dataclass(frozen=True)
class ArmSags(Claim):
    """All claims on positions of an arm hold for the arm as its loads deflect it.

    The mass acts all the time. The force acts at the TCP while segments work. It is interpolated linearly by
    the height of the TCP in the stock frame. On the path to the first target of the actual work it rises from
    zero to its value at that target, linearly along the path. On the path after the last target it falls from
    its value there to zero.

    In the frame of the feed, z is the TCP's z axis, x the component of the feed across it, and y = z x x. The
    feed is the mean direction of the path from :data:`FEED_PATH_M` before a point to as far after it, along
    the straight moves on which the force acts. It is shorter than 1 where these moves change direction. The x
    and y components of the force are multiplied by the length of the feed's component across the axis, so
    that a tool that moves along its axis has z alone.

    Attributes:
        arm: Name of the arm.
        joints: Joint stiffness about the axes as the controller counts them, (6,) [N m/rad].
        mass: Mass on the flange [kg].
        cog: Centre of mass in the flange frame, (3,) [m].
        force: Forces at the heights, (K, 3) [N].
        height: Heights of the TCP in the stock frame, ascending, (K,) [m]. With one height the force is the
            same everywhere.
        frame: Frame of the forces.
        max_deflection: Maximum deflection of the TCP [m].
    """

    arm: str
    joints: FloatArray
    mass: float
    cog: FloatArray
    force: FloatArray
    height: FloatArray
    frame: ForceFrame
    max_deflection: float


def kinds_on_straight_moves(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return the names of the kinds among ``claims`` that are proven on straight moves only."""
    return tuple(dict.fromkeys(type(claim).__name__ for claim in claims if not claim.on_curves))
