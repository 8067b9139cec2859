"""The running wire between two controllers: what the operator reads of it, and what each controller's
configuration needs for it beside its program.

No program switches the wire: the controller holds it at 1 while its program runs with the motors on. It leads
into the other one's stop input and into the interlock of its power, so that a stop of either side stops both
and takes the power, whatever the programs do. A wire that is cut says 0: not running.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from planner.handshake import SignalWire
from planner.post.rapid_format import identifier
from planner.problem import Controller

STANDS: Final = "The program of arm {other} does not run: {input} is 0."
RUNS: Final = "Stop the program of arm {other}: {input} is 1. If it stands, the wire is stuck."
SEEN: Final = "TANDEM_SEEN"
"""The variable of a KUKA controller that says that both programs have run since the last stop."""
KRL_RUNS: Final = "$PRO_ACT AND $PERI_RDY"
"""That a program runs with the drives on."""

Row = Mapping[str, str | None]
"""An instance of a type of ABB's configuration: values by attribute, None for one without a value."""


def ends(wires: Sequence[SignalWire], arm: str) -> tuple[SignalWire, SignalWire]:
    """The running wire that leaves an arm's controller, and the one that comes in."""
    return next(w for w in wires if w.source == arm), next(w for w in wires if w.sink == arm)


def term(controller: Controller, arm: str) -> str:
    """The further AND term of the power of an ABB arm's controller: the input from the other one."""
    return identifier(controller.handshake.of(arm).partner_running)


def rows(controller: Controller, arm: str) -> dict[str, list[Row]]:
    """Rows of EIO.cfg by type, for the controller of an ABB arm; the outputs of the system that say that a
    program runs and motors are on are declared beside them.

    Seen in backups of real cells: SYSSIG_OUT of CycleOn into EIO_CROSS. From public tools that write such
    files: -Act1_invert, SYSSIG_IN. From memory: the action Stop, and that it acts on the rising edge.
    """
    own, lock = controller.handshake.of(arm), controller.interlock
    running, given, lost = identifier(own.running), identifier(own.partner_running), identifier(own.lost)
    out, into = _placed(controller, arm, own.running), _placed(controller, arm, own.partner_running)
    return {
        "EIO_SIGNAL": [
            {"Name": running, "SignalType": "DO", **out, "Access": "ReadOnly"},
            {"Name": given, "SignalType": "DI", **into},
            {"Name": lost, "SignalType": "DI"},
        ],
        "SYSSIG_IN": [{"Signal": lost, "Action": "Stop"}],
        "EIO_CROSS": [
            {
                "Name": "TandemRunning",
                "Res": running,
                "Act1": identifier(lock.cycle),
                "Oper1": "AND",
                "Act2": identifier(lock.motors),
            },
            {"Name": "TandemPartner", "Res": lost, "Act1": given, "Act1_invert": None},
        ],
    }


def _placed(controller: Controller, arm: str, signal: str) -> dict[str, str]:
    place = controller.interlock.place(arm, signal)
    return {"Device": place.device, "DeviceMap": str(place.bit)} if place else {}


def krl_term(controller: Controller, arm: str) -> str:
    """The further AND term of the power of a KUKA arm's controller."""
    return f"$IN[{controller.number(arm, controller.handshake.of(arm).partner_running)}]"


def submit(controller: Controller, arm: str) -> list[str]:
    """Lines for the cycle of the submit interpreter of a KUKA arm's controller.

    $MOVE_ENABLE looks at the level of its input and holds a start up too, so a controller whose partner has
    not run yet would never start: the wire counts from the first time on that both are seen to run.
    """
    own = controller.handshake.of(arm)
    out, enable = controller.number(arm, own.running), controller.number(arm, own.move_enable)
    given = krl_term(controller, arm)
    return [
        f"$OUT[{out}]={KRL_RUNS} ; {own.running}",
        "IF NOT $PRO_ACT THEN",
        f"{SEEN}=FALSE",
        "ENDIF",
        f"IF $PRO_ACT AND {given} THEN ; {own.partner_running}",
        f"{SEEN}=TRUE",
        "ENDIF",
        f"$OUT[{enable}]={given} OR NOT {SEEN} ; {own.move_enable}",
    ]
