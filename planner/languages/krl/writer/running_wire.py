"""KRL lines of the signals by which two controllers watch each other."""

from __future__ import annotations

from typing import Final

from planner.problem import Controller

KRL_PARTNER_SEEN: Final = "TANDEM_SEEN"
"""The variable of a KUKA controller that says that both programs have run since the last stop."""
KRL_RUNS: Final = "$PRO_ACT AND $PERI_RDY"
"""That a program runs with the drives on."""


def krl_power_term(controller: Controller, arm: str) -> str:
    """The further AND term of the power of a KUKA arm's controller."""
    return f"$IN[{controller.number(arm, controller.handshake.of(arm).partner_running)}]"


def krl_submit_lines(controller: Controller, arm: str) -> list[str]:
    """Lines for the cycle of the submit interpreter of a KUKA arm's controller.

    $MOVE_ENABLE looks at the level of its input and holds a start up too, so a controller whose partner has
    not run yet would never start: the wire counts from the first time on that both are seen to run.
    """
    own = controller.handshake.of(arm)
    out, enable = controller.number(arm, own.running), controller.number(arm, own.move_enable)
    given = krl_power_term(controller, arm)
    return [
        f"$OUT[{out}]={KRL_RUNS} ; {own.running}",
        "IF NOT $PRO_ACT THEN",
        f"{KRL_PARTNER_SEEN}=FALSE",
        "ENDIF",
        f"IF $PRO_ACT AND {given} THEN ; {own.partner_running}",
        f"{KRL_PARTNER_SEEN}=TRUE",
        "ENDIF",
        f"$OUT[{enable}]={given} OR NOT {KRL_PARTNER_SEEN} ; {own.move_enable}",
    ]
