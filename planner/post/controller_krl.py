"""Lines for a KUKA controller, beside the program: what its power outputs hang on besides the program.

No output of KRL falls at a stop by itself. Lines of the submit interpreter take it back, also the real output
where the cell has one besides the program's request, and hold the arm until somebody says how it goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from planner.problem import Controller

FLAG: Final = "TANDEM_CUT"
_RUNS: Final = "$PRO_ACT AND $PERI_RDY"


def files(controller: Controller, arm: str, signals: Sequence[str]) -> dict[str, str]:
    """The files, by name, for the controller of ``arm`` whose program switches ``signals``."""
    numbers = [(signal, controller.number(arm, signal)) for signal in signals]
    taken = [line for _, number in numbers for line in _taken(number)]
    submit = [f"IF NOT ({_RUNS}) THEN", *taken, "ENDIF"]
    for signal, number in numbers:
        real = controller.number(arm, controller.interlock.of(signal).signal)
        if real is not None:
            submit.append(f"$OUT[{real}]=$OUT[{number}] AND {_RUNS}")
    submit += [f"IF {FLAG} THEN", "$OV_PRO=0", "ENDIF"]
    return {
        "config_user.dat": _text([f"DECL BOOL {FLAG}=FALSE"]),
        "sps_user.sub": _text(submit),
        "ir_stopm_user.src": _text(taken),
        "README.txt": _readme(controller, arm, signals),
    }


def _taken(number: int | None) -> list[str]:
    """The request is taken back, and that it was on is kept."""
    return [f"IF $OUT[{number}] THEN", f"{FLAG}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE"]


def _text(lines: Sequence[str]) -> str:
    return "".join(f"{line}\n" for line in ["; Written by Tandem.", *lines])


_STEPS: Final = """For the controller of arm {arm}. Make an archive first.

1. config_user.dat: into the user fold of $CONFIG.DAT.
2. sps_user.sub: into the user fold of the LOOP of SPS.SUB; no WAIT and no motion may stand there.
3. ir_stopm_user.src: into the user fold of IR_STOPM.SRC.
4. Restart the submit interpreter; it must run whenever the program does.
5. Try it without wire and with the tool off: set the output by hand while the program waits, then
   stop. It must fall, and the arm must not move at the next start.

Outputs:
{signals}

Behind a stop with the power on {flag} is TRUE and the override 0. Free the wire or the tool, or
set the output again by hand and wait until it is hot or runs at full speed; then set {flag} to
FALSE in the variable display and the override to what it was. Never do so while block or part is in
the way of a cold wire or a tool that stands.

Seen: $OUT[n] = request AND $PRO_ACT in the submit interpreter, which runs on through stops;
IR_STOPM as the user's place for reactions to stops, and its interrupt at the head of programs.

To be checked at the controller: $PERI_RDY (drives ready); that $OV_PRO can be set by the submit
interpreter in all modes; that IR_STOPM runs at every stop message.

The submit interpreter is no safety function: an emergency stop must cut the power by itself, too.

Mounting a hot wire with the gate open: in automatic the open gate takes the drives away, and the
power with them. Mount it cold; or in T1 while somebody else holds enabling switch and start key and
the program waits; behind a change of mode the power is off.
"""


def _readme(controller: Controller, arm: str, signals: Sequence[str]) -> str:
    rows = []
    for signal in signals:
        lock = controller.interlock.of(signal).signal
        number, real = controller.number(arm, signal), controller.number(arm, lock)
        if real is None:
            rows.append(f"  $OUT[{number}] {signal}: set by the program, taken back at a stop")
        else:
            rows.append(f"  $OUT[{number}] {signal}: request of the program, wired to nothing")
            rows.append(f"  $OUT[{real}] {lock}: the power hangs on this one")
    return _STEPS.format(arm=arm, flag=FLAG, signals="\n".join(rows))
