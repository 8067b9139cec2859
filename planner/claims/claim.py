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
    """In ``segment`` the distance of the TCPs of ``arms`` may change by ``change`` [m] while one arm is one
    step ahead of the other."""

    segment: Segment
    arms: tuple[str, str]
    change: float


@dataclasses.dataclass(frozen=True)
class Allowance:
    """Deviation of curves from the replay, which a claim has to leave room for.

    Attributes:
        way: Deviation of the TCP on each segment (N,) [m].
        turn: Deviation of its orientation on each segment (N,) [rad].
        joints: Largest deviation of a joint [rad].
        body: Largest deviation of any body of the arm [m].
        faster: Factor by which the tool may be faster than on the straight moves.
    """

    way: FloatArray
    turn: FloatArray
    joints: float
    body: float
    faster: float

    @property
    def largest_turn(self) -> float:
        """Largest deviation of the orientation [rad]."""
        return float(self.turn.max())

    def at(self, lever: float) -> float:
        """Return the largest deviation [m] at a distance ``lever`` [m] from the TCP."""
        return float((self.way + lever * self.turn).max())


@dataclasses.dataclass(frozen=True)
class Power:
    """An output that programs switch because of a claim.

    Attributes:
        signal: Name of the output.
        burns: Whether it lights a torch, which nobody lights again where it burned at a stop.
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
        """How much the distance of two tools may change while their arms are one step apart."""
        return None

    @property
    def longest_stop(self) -> tuple[Segment, float] | None:
        """A segment in which the tool may stand with its power on, and how long [s]."""
        return None

    @property
    def spindle_rule(self) -> tuple[str, str] | None:
        """An arm, and the kind of its segments in which a rule about this claim judges the spindle."""
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
        """Return the claim with so much less room that it holds on curves if it holds on straight moves."""
        return self

    def used_up(self, allowance: Allowance) -> tuple[float, float] | None:
        """Return deviation and tolerance [m] if curves leave nothing of the tolerance."""
        return None

    def uneven_feed(self) -> Segment | None:
        """Return the segment whose feed changes from place to place."""
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
    """The tool of ``arm`` holds the stock, ``grip`` (4, 4) being the stock frame in its TCP frame, and the
    controller knows the load: ``mass`` [kg], ``cog`` (3,) [m] in the TCP frame."""

    arm: str
    grip: FloatArray
    mass: float
    cog: FloatArray


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn(Claim):
    """The edge (wire) touches the stock only in segments of the kinds ``kinds``, while ``signal`` is on."""

    on_curves: ClassVar[bool] = True

    kinds: tuple[str, ...]
    signal: str
    heat_up: float

    def power(self) -> Power | None:
        """Return the power of the edge."""
        return Power(self.signal)


@dataclasses.dataclass(frozen=True)
class OneOf(Claim):
    """The problem leaves open what is mounted: of the groups of claims in ``either`` one whole group must
    hold, the one whose `OperatorDialogue` begins with what the operator is told to mount."""

    either: tuple[tuple[Claim, ...], ...]


@dataclasses.dataclass(frozen=True)
class FeedWindow(Claim):
    """While the edge is inside the stock its fastest point there moves between ``lower`` and ``upper``
    [m/s].
    """

    on_curves: ClassVar[bool] = True

    segment: Segment
    lower: float
    upper: float

    def tightened(self, allowance: Allowance) -> "FeedWindow":
        """Return the window of the straight moves, on which the tool is slower than on curves."""
        return dataclasses.replace(self, upper=self.upper / allowance.faster)


ForceFrame = Literal["stock", "tool", "feed"]
"""Along whose axes a force stands: the stock's, the TCP's, or those of the feed."""
FEED_WAY: Final = 5e-3
"""Over this way [m] before and behind a place the direction of its feed is taken, and forces turn with it."""


@dataclasses.dataclass(frozen=True)
class ArmSags(Claim):
    """What is claimed of the places of ``arm`` holds of the arm as its loads bend it, by ``joints`` (6,) [N
    m/rad] about the axes as its controller counts them; nowhere do these move its TCP by more than ``most``
    [m].

    ``mass`` [kg] hangs at ``cog`` (3,) [m, flange] all the time. ``force`` (K, 3) [N] acts at the TCP, in the
    ``frame`` of the stock, the TCP ("tool") or the feed, while segments work: on the way to the first target
    of their work proper it rises from nothing, evenly along that way, and on the way off the last one it
    falls. It is what a table has at the ``height`` (K,) [m], ascending, of the TCP in the stock's frame,
    evenly between its rows; with one row it is the same everywhere. Where it comes and goes it is that of the
    target at which it acts in full.

    In the frame of the feed z is the TCP's z axis, x what the feed has across it and y = z x x. The feed is
    the mean direction of the way from :data:`FEED_WAY` [m] before to as far behind, along the straight moves
    on which the force acts, so shorter than 1 where these turn: x and y count by the share of the feed that
    goes across the axis, and a tool that goes along its axis has z alone. On the way off the force is what it
    was at its beginning, falling.
    """

    arm: str
    joints: FloatArray
    mass: float
    cog: FloatArray
    force: FloatArray
    height: FloatArray
    frame: ForceFrame
    most: float


def on_straight_moves_alone(claims: Sequence[Claim]) -> tuple[str, ...]:
    """Return the names of the kinds among ``claims`` that are proven on straight moves only."""
    return tuple(dict.fromkeys(type(one).__name__ for one in claims if not one.on_curves))
