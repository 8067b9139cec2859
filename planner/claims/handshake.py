"""Signals and wires of the handshake between two controllers."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

HandshakeKind = Literal["four_phase", "toggle"]


@dataclasses.dataclass(frozen=True)
class PartnerSignals:
    """Names of the signals of one controller for the other one.

    Attributes:
        output: Output to the other controller.
        input: Input from the other controller.
        running: Output that the controller holds at 1 while its program runs with the motors on.
        partner_running: Input that the other one's ``running`` drives. No program switches it.
        move_enable: For a KUKA controller, the output that is looped to its input for $MOVE_ENABLE.
    """

    output: str = "doPartner"
    input: str = "diPartner"
    running: str = "doRunning"
    partner_running: str = "diPartnerRunning"
    move_enable: str = "doMoveEnable"

    @property
    def lost_input(self) -> str:
        """For an ABB controller, the inverse of ``partner_running``. Its rise stops the program."""
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
        kind: Two signal changes of each side at every meeting (``four_phase``), or one (``toggle``).
        every: Number of moves between meetings.
        signals: Names by arm, defaults for an arm that is not named.
        wires: Wires by which the controllers meet.
        running: Wires that state that a controller runs.
        timeout: Maximum time [s] for which an arm waits for the other one at a step of joint work.
        patience: Maximum time [s] for which it waits while the other one moves alone or asks the operator.
    """

    kind: HandshakeKind = "four_phase"
    every: int = 1
    signals: Mapping[str, PartnerSignals] = dataclasses.field(default_factory=dict)
    wires: tuple[SignalWire, ...] = ()
    running: tuple[SignalWire, ...] = ()
    timeout: float = 30.0
    patience: float = 3600.0

    def of(self, arm: str) -> PartnerSignals:
        """Return the signals of an arm's controller."""
        return self.signals.get(arm, PartnerSignals())

    def meeting_wires(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """Return the wires by which two arms' controllers meet.

        By default, each controller's outputs drive the inputs of the other.
        """
        if self.wires or len(arms) != 2:
            return self.wires
        return tuple(
            SignalWire(a, self.of(a).output, b, self.of(b).input) for a, b in (tuple(arms), tuple(arms)[::-1])
        )

    def running_wires(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """Return the wires by which two arms' controllers know that the other one runs.

        By default, each controller's outputs drive the inputs of the other.
        """
        if self.running or len(arms) != 2:
            return self.running
        return tuple(
            SignalWire(a, self.of(a).running, b, self.of(b).partner_running)
            for a, b in (tuple(arms), tuple(arms)[::-1])
        )
