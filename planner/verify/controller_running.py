"""What two controllers need beside their programs to know of each other: an output that says that this one
runs, an input of the other one's, whose fall stops this arm and takes its power."""

from __future__ import annotations

from dataclasses import dataclass

from planner.problem import Controller


@dataclass(frozen=True)
class Partner:
    """The ends of the running wires at the controller of ``arm``, which another one stands beside."""

    controller: Controller
    arm: str
    seen: str = "TANDEM_SEEN"

    @property
    def running(self) -> str:
        """The output that is 1 while the program of this arm runs."""
        return self.controller.handshake.of(self.arm).running

    @property
    def given(self) -> str:
        """The input that is 1 while the other arm's program runs."""
        return self.controller.handshake.of(self.arm).partner_running

    @property
    def lost(self) -> str:
        """Of ABB, the signal whose rise stops this arm."""
        return f"{self.given}_lost"

    @property
    def signals(self) -> list[dict[str, str]]:
        """Of ABB, the signals by attribute: an output that nobody sets by hand, two inputs."""
        rows = [
            {"name": self.running, "signaltype": "DO", "access": "ReadOnly"},
            {"name": self.given, "signaltype": "DI"},
            {"name": self.lost, "signaltype": "DI"},
        ]
        for row in rows[:2]:
            place = self.controller.interlock.place(self.arm, row["name"])
            if place is not None:
                row |= {"device": place.device, "devicemap": str(place.bit)}
        return rows

    @property
    def input(self) -> str:
        """Of KUKA, the input that is 1 while the other arm's program runs."""
        return f"$IN[{self.controller.number(self.arm, self.given)}]"

    def watched(self, runs: str) -> list[str]:
        """Of KUKA, the lines of the submit interpreter: the output says what ``runs``; moves are free unless
        the other one, which was seen to run since this program started, does not run any more."""
        own = self.controller.handshake.of(self.arm)
        out, free = (self.controller.number(self.arm, name) for name in (own.running, own.move_enable))
        return [
            f"$OUT[{out}]={runs}",
            *("IF NOT $PRO_ACT THEN", f"{self.seen}=FALSE", "ENDIF"),
            *(f"IF $PRO_ACT AND {self.input} THEN", f"{self.seen}=TRUE", "ENDIF"),
            f"$OUT[{free}]={self.input} OR NOT {self.seen}",
        ]
