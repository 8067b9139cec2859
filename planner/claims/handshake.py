"""Signals and wires of the handshake between two controllers."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

HandshakeKind = Literal["four_phase", "toggle"]


@dataclasses.dataclass(frozen=True)
class PartnerSignals:
    """Names of the signals by which one controller communicates with the other one.

    Attributes:
        output: Output to the other controller.
        input: Input from the other controller.
        running: Output that the controller holds at 1 while its program runs with the motors on.
        partner_running: Input that the ``running`` output of the other controller drives.
        move_enable: For a KUKA controller, the output that is looped to its input for $MOVE_ENABLE.
    """

    output: str = "doPartner"
    input: str = "diPartner"
    running: str = "doRunning"
    partner_running: str = "diPartnerRunning"
    move_enable: str = "doMoveEnable"

    @property
    def lost_input(self) -> str:
        """For an ABB controller, the inverse of ``partner_running``, a signal whose rise stops the arm."""
        return f"{self.partner_running}_lost"


@dataclasses.dataclass(frozen=True)
class SignalWire:
    """A wire between controllers.

    Attributes:
        source: Arm whose controller drives the wire.
        output: Output of that controller.
        sink: Arm whose controller reads the wire.
        input: Input of that controller.
    """

    source: str
    output: str
    sink: str
    input: str


@dataclasses.dataclass(frozen=True)
class Handshake:
    """The handshake of two controllers.

    Attributes:
        kind: Whether the line of each side changes twice at every meeting (``four_phase``) or once
            (``toggle``).
        every: Number of moves between two meetings.
        signals: Names of signals by arm; an arm that is not in it has the default names.
        wires: Wires by which the controllers meet, () for the default ones.
        running: Wires that state that a controller runs its program, () for the default ones.
        timeout: Maximum time for which an arm waits for the other one during joint work [s].
        patience: Maximum time for which it waits while the other one moves alone or asks the operator [s].
    """

    kind: HandshakeKind = "four_phase"
    every: int = 1
    signals: Mapping[str, PartnerSignals] = dataclasses.field(default_factory=dict)
    wires: tuple[SignalWire, ...] = ()
    running: tuple[SignalWire, ...] = ()
    timeout: float = 30.0
    patience: float = 3600.0

    def of(self, arm: str) -> PartnerSignals:
        """Return the names of the signals of an arm's controller."""
        return self.signals.get(arm, PartnerSignals())

    def meeting_wires(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """Return the wires over which the controllers of two arms synchronise (meet).

        If none are stated, the output of each controller drives the input of the other. For any other number
        of arms only stated wires are returned.
        """
        if self.wires or len(arms) != 2:
            return self.wires
        return tuple(
            SignalWire(source, self.of(source).output, sink, self.of(sink).input)
            for source, sink in (tuple(arms), tuple(arms)[::-1])
        )

    def running_wires(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """Return the wires by which each of two arms' controllers knows that the other one runs.

        If none are stated, the ``running`` output of each drives the ``partner_running`` input of the other.
        For any other number of arms only stated wires are returned.
        """
        if self.running or len(arms) != 2:
            return self.running
        return tuple(
            SignalWire(source, self.of(source).running, sink, self.of(sink).partner_running)
            for source, sink in (tuple(arms), tuple(arms)[::-1])
        )
