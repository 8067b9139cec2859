"""The running wire between two controllers: what the operator reads of it, and the lines that each
controller's configuration needs beside its program.

No program switches the wire: the controller holds it at 1 while its program runs with the motors on. It leads
into the other one's stop input and into the interlock of its power, so that a stop of either side stops both
and takes the power, whatever the programs do. A wire that is cut says 0: not running.
"""

from __future__ import annotations

from typing import Final

from planner.post.languages import speaks_krl
from planner.post.rapid_format import identifier
from planner.problem import Arm, Controller, Problem

STANDS: Final = "The program of arm {other} does not run: {input} is 0."
RUNS: Final = "Stop the program of arm {other}: {input} is 1. If it stands, the wire is stuck."
CYCLE: Final = "soCycleOn"
MOTORS: Final = "soMotOn"
"""System outputs of an ABB controller that the lines below use; declare them once."""


def lines(problem: Problem, arm: Arm) -> tuple[str, ...]:
    """Lines of configuration for the running wires of an arm's controller: of EIO.cfg, or of the user's part
    of the submit interpreter. None where one controller moves all."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return ()
    return _submit(controller, arm.name) if speaks_krl(arm) else _eio(controller, arm.name)


def power(problem: Problem, arm: Arm) -> str:
    """The further AND term of the power output of an arm's controller: the signal of a cross connection, or
    an expression of the submit interpreter. "" where one controller moves all."""
    controller = problem.cell.controller
    if controller.sync != "handshake":
        return ""
    given = controller.handshake.of(arm.name).partner_running
    return f"$IN[{controller.number(arm.name, given)}]" if speaks_krl(arm) else identifier(given)


def _eio(controller: Controller, arm: str) -> tuple[str, ...]:
    """Seen in backups of real cells: SYSSIG_OUT of CycleOn into EIO_CROSS. From public tools that write such
    files: -Act1_invert, SYSSIG_IN. From memory: the action Stop, and that it acts on the rising edge."""
    own = controller.handshake.of(arm)
    running, given = identifier(own.running), identifier(own.partner_running)
    lost = f"{given[:27]}_lost"
    return (
        "EIO_SIGNAL:",
        f'-Name "{CYCLE}" -SignalType "DO" -Access "ReadOnly"',
        f'-Name "{MOTORS}" -SignalType "DO" -Access "ReadOnly"',
        f'-Name "{running}" -SignalType "DO" -Device "..." -DeviceMap "..." -Access "ReadOnly"',
        f'-Name "{given}" -SignalType "DI" -Device "..." -DeviceMap "..."',
        f'-Name "{lost}" -SignalType "DI"',
        "SYSSIG_OUT:",
        f'-Status "CycleOn" -Signal "{CYCLE}"',
        f'-Status "MotOnState" -Signal "{MOTORS}"',
        "SYSSIG_IN:",
        f'-Signal "{lost}" -Action "Stop"',
        "EIO_CROSS:",
        f'-Name "tandem_running" -Res "{running}" -Act1 "{CYCLE}" -Oper1 "AND" -Act2 "{MOTORS}"',
        f'-Name "tandem_partner" -Res "{lost}" -Act1 "{given}" -Act1_invert',
    )


def _submit(controller: Controller, arm: str) -> tuple[str, ...]:
    """The input of $MOVE_ENABLE is level-sensitive and holds a start up too, so a controller whose partner
    has not run yet would never start: it counts from the first time on that both are seen to run."""
    own = controller.handshake.of(arm)
    number = {
        name: controller.number(arm, name) for name in (own.running, own.partner_running, own.move_enable)
    }
    out, given, enable = number.values()
    return (
        "; declarations of SPS.SUB",
        "DECL BOOL tandem_seen",
        "; USER INIT",
        "tandem_seen=FALSE",
        "; USER PLC, in the cycle",
        f"$OUT[{out}]=$PRO_ACT AND $PERI_RDY ; {own.running}",
        "IF NOT $PRO_ACT THEN",
        "tandem_seen=FALSE",
        "ENDIF",
        f"IF $PRO_ACT AND $IN[{given}] THEN",
        "tandem_seen=TRUE",
        "ENDIF",
        f"$OUT[{enable}]=$IN[{given}] OR NOT tandem_seen ; {own.move_enable}",
        f"; wire $OUT[{enable}] to the input that $MOVE_ENABLE reads; $CHCK_MOVENA=TRUE",
    )
