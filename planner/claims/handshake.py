"""Signals and wires of the handshake between two controllers."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

HandshakeKind = Literal["four_phase", "toggle"]


@dataclasses.dataclass(frozen=True)
class PartnerSignals:
    """Names that one controller has for its output to the other one and for its input from there.

    ``running``: the output that the controller itself holds at 1 while its program runs with the motors on;
    ``partner_running``: the input that the other one's drives, which no program switches either;
    ``move_enable``: of a KUKA controller, the output that is looped to its input for $MOVE_ENABLE.
    """

    output: str = "doPartner"
    input: str = "diPartner"
    running: str = "doRunning"
    partner_running: str = "diPartnerRunning"
    move_enable: str = "doMoveEnable"

    @property
    def lost(self) -> str:
        """Of an ABB controller, what ``partner_running`` is not: its rise stops the program."""
        return f"{self.partner_running}_lost"


@dataclasses.dataclass(frozen=True)
class SignalWire:
    """A wire between controllers: the output ``output`` of the arm ``source`` drives the input ``input`` of
    the arm ``sink``."""

    source: str
    output: str
    sink: str
    input: str


@dataclasses.dataclass(frozen=True)
class Handshake:
    """The handshake of two controllers.

    ``kind``: two signal changes of each side at every meeting, or one. ``every``: they meet at every so many
    moves. ``signals`` {arm: names}, the defaults for an arm that is not named; ``wires``: what drives what;
    ``running``: the wires that say that a controller runs.
    ``timeout`` [s]: how long an arm waits for the other one at a step of joint work; ``patience`` [s]: how
    long while the other arm moves alone or asks the operator.
    """

    kind: HandshakeKind = "four_phase"
    every: int = 1
    signals: Mapping[str, PartnerSignals] = dataclasses.field(default_factory=dict)
    wires: tuple[SignalWire, ...] = ()
    running: tuple[SignalWire, ...] = ()
    timeout: float = 30.0
    patience: float = 3600.0

    def of(self, arm: str) -> PartnerSignals:
        """The signals of an arm's controller."""
        return self.signals.get(arm, PartnerSignals())

    def wired(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """The wires between two arms' controllers by which they meet; unless stated, outputs drive the other
        one's inputs."""
        if self.wires or len(arms) != 2:
            return self.wires
        return tuple(
            SignalWire(a, self.of(a).output, b, self.of(b).input) for a, b in (tuple(arms), tuple(arms)[::-1])
        )

    def wired_running(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """The wires by which two arms' controllers know that the other one runs; as :meth:`wired`."""
        if self.running or len(arms) != 2:
            return self.running
        return tuple(
            SignalWire(a, self.of(a).running, b, self.of(b).partner_running)
            for a, b in (tuple(arms), tuple(arms)[::-1])
        )
