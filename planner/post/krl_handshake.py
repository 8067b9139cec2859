"""KRL for two controllers that share digital signals: the steps of :mod:`planner.post.partner` as text."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planner import dialogue
from planner.post import krl_panel
from planner.post.krl_format import comment
from planner.post.partner import Ask, AwaitLine, AwaitRunning, Halt, Note, Partner, PartnerStep, SetLine, Tell
from planner.problem import Controller


def lines(
    partner: Partner, controller: Controller, steps: Sequence[PartnerStep], shown: bool = True
) -> list[str]:
    """The statements of the steps; ``shown``: the panel says so while the program waits, which in a file with
    a meeting it does already."""
    waiting = dialogue.WAITING.say(arm=partner.other)
    own = partner.handshake.of(partner.arm)
    output, given = controller.number(partner.arm, own.output), controller.number(partner.arm, own.input)
    runs = controller.number(partner.arm, own.partner_running)
    out: list[str] = []
    for step in steps:
        match step:
            case SetLine(value):
                out.append(f"$OUT[{output}]={_level(value)}")
            case AwaitLine(value, seconds):
                wait = _wait(f"$IN[{given}]=={_level(1 - value)}", seconds, partner.unanswered)
                out += krl_panel.during(waiting, wait, controller.dialect) if shown else wait
            case AwaitRunning(value, seconds):
                wait = _wait(f"$IN[{runs}]=={_level(1 - value)}", seconds, partner.not_as_wanted(value))
                out += krl_panel.during(waiting, wait, controller.dialect) if shown else wait
            case Halt(text):  # krc2: the HALT of the question is a stop itself
                out += ["HALT"] if controller.dialect == "krc4" else []
                out += krl_panel.asked(text, controller.dialect)
            case Ask(text):
                out += krl_panel.asked(text, controller.dialect)
            case Tell(text):
                out += krl_panel.told(text, controller.dialect)
            case Note(text):
                out += comment(text)
    return out


def suffix(phases: tuple[int, ...]) -> str:
    """The end of the name of the file with a meeting."""
    return f"meet_{phases[0]}" if len(phases) == 1 else "meet"


def _level(value: int) -> str:
    return "TRUE" if value else "FALSE"


def _wait(condition: str, seconds: float, unanswered: str) -> list[str]:
    """Wait as long as the condition holds; the program halts whenever the time is over, and waits again."""
    return [
        "$TIMER[1]=0",
        "$TIMER_STOP[1]=FALSE",
        f"WHILE {condition}",
        f"IF $TIMER[1]>{math.ceil(1e3 * seconds)} THEN",
        *comment(f"{unanswered} Start waits for it again."),
        "HALT",
        "$TIMER[1]=0",
        "ENDIF",
        "WAIT SEC 0.01",
        "ENDWHILE",
        "$TIMER_STOP[1]=TRUE",
    ]
