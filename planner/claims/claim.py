"""Claims: what must hold of a job, as data.

A process states claims, and the proof has a rule for each kind. Claims follow from the problem alone, never
from a plan, so that a proof can start from the problem and the program text. All geometry is in the stock
frame, in metres. This file has the base class and the kinds that several processes use. The kinds of one
process are in ``processes/<name>/claims.py``.
"""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar, Final, Literal

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class ToolDistance:
    """Limit of the change of tool distance while one arm is one step ahead of the other.

    Attributes:
        segment: Segment in which it holds.
        arms: Names of the arms.
        change: Maximum change [m] of the distance of their TCPs.
    """

    segment: Segment
    arms: tuple[str, str]
    change: float


@dataclasses.dataclass(frozen=True)
class Allowance:
    """Deviation of curves from the replay, for which a claim has to leave margin.

    Attributes:
        position: Deviation of the TCP on each segment (N,) [m].
        rotation: Deviation of its orientation on each segment (N,) [rad].
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
    """An output that programs switch because of a claim.

    Attributes:
        signal: Name of the output.
        burns: Whether it lights a torch, which must not be lit again where it burned at a stop.
        pulsed: Whether it is on for a pulse only, so that a stop does not have to switch it off.
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
        """Register the kind. A second kind of the same name would replace the first one in plan files."""
        other = _KINDS.get(cls.__name__, cls).__module__
        if other != cls.__module__:
            raise TypeError(f"{cls.__module__}: {other} already has a claim {cls.__name__}")
        _KINDS[cls.__name__] = cls

    @property
    def tool_distance(self) -> ToolDistance | None:
        """Limit of the tool distance while the arms are one step apart, or None."""
        return None

    @property
    def longest_stop(self) -> tuple[Segment, float] | None:
        """A segment in which the tool may stand with its power on, and how long [s], or None."""
        return None

    @property
    def spindle_rule(self) -> tuple[str, str] | None:
        """Arm and kind of its segments in which a rule about this claim checks the spindle, or None."""
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
        """Return the claim with its margin reduced by an allowance for curves.

        If the result holds on straight moves, the claim holds on curves.
        """
        return self

    def used_up(self, allowance: Allowance) -> tuple[float, float] | None:
        """Return deviation and tolerance [m] if curves leave nothing of the tolerance, else None."""
        return None

    def uneven_feed(self) -> Segment | None:
        """Return the segment whose feed varies along the path, or None."""
        return None


def powers(claims: Sequence[Claim]) -> tuple[Power, ...]:
    """Return the outputs that programs switch because of claims, in their order."""
    return tuple(power for claim in claims if (power := claim.power()) is not None)


_KINDS: Final[dict[str, type[Claim]]] = {}
"""Kinds of claims by name."""


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
        grip: Stock frame (4, 4) in the arm's TCP frame.
        mass: Mass [kg] of the stock.
        cog: Centre of gravity (3,) [m] in the TCP frame.
    """

    arm: str
    grip: FloatArray
    mass: float
    cog: FloatArray


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn(Claim):
    """The edge (wire) touches the stock only in segments of some kinds, while its signal is on.

    Attributes:
        kinds: Kinds of these segments.
        signal: Output that switches the edge's power.
        heat_up: Time [s] that heating up takes.
    """

    on_curves: ClassVar[bool] = True

    kinds: tuple[str, ...]
    signal: str
    heat_up: float

    def power(self) -> Power | None:
        """Return the power of the edge."""
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
    """While the edge is inside the stock, its fastest point there moves within a speed range.

    Attributes:
        segment: Segment in which it holds.
        lower: Minimum speed [m/s].
        upper: Maximum speed [m/s].
    """

    on_curves: ClassVar[bool] = True

    segment: Segment
    lower: float
    upper: float

    def tightened(self, allowance: Allowance) -> "FeedWindow":
        """Return the window of the straight moves, on which the tool is slower than on curves."""
        return dataclasses.replace(self, upper=self.upper / allowance.speed_factor)


ForceFrame = Literal["stock", "tool", "feed"]
"""Frame of a force: that of the stock, of the TCP, or of the feed."""
FEED_PATH_M: Final = 5e-3
"""Path [m] before and after a point over which the direction of its feed is averaged. Forces turn with
it.
"""


@dataclasses.dataclass(frozen=True)
class ArmSags(Claim):
    """The claimed positions of an arm hold for the arm as its loads deflect it.

    The mass acts all the time. The force acts at the TCP while segments work. On the path to the first
    target of their actual work it rises from zero, linearly along the path, and on the path after the last
    one it falls. It is interpolated linearly by the height of the TCP in the stock's frame. While it rises
    or falls, it is that of the target at which it acts in full.

    In the frame of the feed, z is the TCP's z axis, x the component of the feed across it, and y = z x x.
    The feed is the mean direction of the path from :data:`FEED_PATH_M` before to as far after, along the
    straight moves on which the force acts, so it is shorter than 1 where these turn. x and y count by the
    component of the feed across the axis, and a tool that moves along its axis has z alone. On the path
    after the last target the force is what it was at the start of that path, falling.

    Attributes:
        arm: Name of the arm.
        joints: Joint stiffness (6,) [N m/rad] about the axes as the controller counts them.
        mass: Mass [kg] on the flange.
        cog: Centre of gravity (3,) [m] in the flange frame.
        force: Forces (K, 3) [N].
        height: Heights (K,) [m] of the TCP in the stock's frame, ascending. One height: the same force
            everywhere.
        frame: Frame of the forces.
        max_deflection: Maximum deflection [m] of the TCP.
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
