"""What goes with KRL programs: lines for the controller on power outputs, and notes to the user.

No output of KRL falls at a stop by itself. Lines of the submit interpreter take it back, also the
real output where the cell has one besides the program's request, and hold the arm until somebody
says how it goes on, or, where a torch burned, until the program is reset.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims.handshake import SignalWire
from planner.issues import Issue, Severity
from planner.languages.krl.writer import spline_blocks
from planner.languages.krl.writer.data import Data, near_zero
from planner.languages.writing import handshake
from planner.languages.writing.layout import TaskProgram
from planner.plans import Plan
from planner.problem import Controller, KrlDialect, Problem

POWER_FLAG: Final = "TANDEM_CUT"
"""The variable of a controller that says that a wire or tool was on when the program stopped."""
TORCH_FLAG: Final = "TANDEM_LIT"
"""That a torch burned then."""
KRL_PARTNER_SEEN: Final = "TANDEM_SEEN"
"""The variable of a KUKA controller that says that both programs have run since the last stop."""
KRL_RUNS: Final = "$PRO_ACT AND $PERI_RDY"
"""That a program runs with the drives on."""


def files(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    wires: Sequence[SignalWire] = (),
    torches: Sequence[str] = (),
) -> dict[str, str]:
    """The files, by name, for the controller of ``arm`` whose program switches ``signals``; ``wires``: the
    running wires between it and another controller; ``torches``: those signals that light one."""
    runs = KRL_RUNS + (f" AND {krl_power_term(controller, arm)}" if wires else "")
    numbers = {signal: controller.number(arm, signal) for signal in signals}
    flags = {signal: TORCH_FLAG if signal in torches else POWER_FLAG for signal in signals}
    taken = [line for signal, number in numbers.items() for line in _taken(number, flags[signal])]
    submit = krl_submit_lines(controller, arm) if wires else []
    submit += [f"IF NOT ({runs}) THEN", *taken, "ENDIF"] if taken else []
    submit += _ended([numbers[signal] for signal in torches]) if torches else []
    for signal, number in numbers.items():
        real = controller.number(arm, controller.interlock.of(signal).signal)
        if real is not None:
            submit.append(f"$OUT[{real}]=$OUT[{number}] AND {runs}")
    kept = [flag for flag in (POWER_FLAG, TORCH_FLAG) if flag in flags.values()]
    submit += [f"IF {POWER_FLAG} THEN", "$OV_PRO=0", "ENDIF"] if POWER_FLAG in kept else []
    variables = kept + ([KRL_PARTNER_SEEN] if wires else [])
    out = {
        "config_user.dat": _text([f"DECL BOOL {name}=FALSE" for name in variables]),
        "sps_user.sub": _text(submit),
    }
    if taken:  # the real outputs too: a submit interpreter that stands takes none back
        locks = (controller.interlock.of(signal).signal for signal in signals)
        outputs = (controller.number(arm, lock) for lock in locks)
        off = [f"$OUT[{number}]=FALSE" for number in outputs if number is not None]
        out["ir_stopm_user.src"] = _text([*taken, *off])
    return out | {"README.txt": _readme(controller, arm, signals, wires, torches)}


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


def _taken(number: int | None, flag: str) -> list[str]:
    """The request is taken back, and that it was on is kept."""
    return [f"IF $OUT[{number}] THEN", f"{flag}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE"]


def _ended(numbers: Sequence[int | None]) -> list[str]:
    """Where a torch burned no start goes on, nor is it lit by hand, until the program is reset."""
    return [
        *("IF $PRO_STATE1==#P_RESET THEN", f"{TORCH_FLAG}=FALSE", "ENDIF"),
        f"IF {TORCH_FLAG} THEN",
        *(f"$OUT[{number}]=FALSE" for number in numbers),
        *("$OV_PRO=0", "ENDIF"),
    ]


def _text(lines: Sequence[str]) -> str:
    return "".join(f"{line}\n" for line in ["; Written by Tandem.", *lines])


_LOAD: Final = """For the controller of arm {arm}. Make an archive first.

1. config_user.dat: into the user fold of $CONFIG.DAT.
2. sps_user.sub: into the user fold of the LOOP of SPS.SUB; no WAIT and no motion may stand there.
3. {stops}
4. Restart the submit interpreter; it must run whenever the program does.
5. {trial}
"""
_STOPS: Final = "ir_stopm_user.src: into the user fold of IR_STOPM.SRC."
_NO_STOPS: Final = "IR_STOPM.SRC stays as it is: this program switches no power."
_TRIAL: Final = """\
Try it without wire and with the tool off: set the output by hand while the program waits, then
   stop. It must fall, and the arm must not move at the next start."""
_TORCH_TRIAL: Final = """\
Try it with the supply of the torch off and its input bridged: stop the program while the output
   is TRUE. It must fall, the arm must not move at the next start, and the output must not be set
   by hand; a reset alone leads out."""
_LOOK: Final = "Look at the outputs below while a program runs and while it stands."

_WIRE: Final = """
Running wires, between this controller and the one of arm {other}:
  $OUT[{out}] {running}: 1 while this program runs; to {their} of arm {other}
  $IN[{given}] {partner}: 1 while the program of arm {other} runs; from {source} of it
  $OUT[{enable}] {move}: to the input that $MOVE_ENABLE reads, with $CHCK_MOVENA=TRUE

Try them before the first cut, without wire and with the tool off, all motors on: let both programs
run at reduced speed and pull the wire at $IN[{given}].
This arm must stop at once{falls}. Its stop must stop arm {other}, too.
Then the same with the other wire, and by stopping either program.
After a stop either side may be started first; nothing has power before both run.

Seen: $PRO_ACT, $MOVE_ENABLE with $CHCK_MOVENA, outputs set by the submit interpreter.
To be checked at the controller: that $PRO_ACT falls at every stop; that the input of $MOVE_ENABLE
counts in all modes that are used.
"""

_POWER: Final = """
Outputs:
{signals}

{behind}{both}

Seen: $OUT[n] = request AND $PRO_ACT in the submit interpreter, which runs on through stops;
IR_STOPM as the user's place for reactions to stops, and its interrupt at the head of programs.

To be checked at the controller: $PERI_RDY (drives ready); that $OV_PRO can be set by the submit
interpreter in all modes; that IR_STOPM runs at every stop message.

The submit interpreter is no safety function: an emergency stop must cut the power by itself, too.
"""
_HOT: Final = """
Mounting a hot wire with the gate open: in automatic the open gate takes the drives away, and the
power with them. Mount it cold; or in T1 while somebody else holds enabling switch and start key and
the program waits; behind a change of mode the power is off.
"""


_FREED: Final = """\
Behind a stop with the power on {flag} is TRUE and the override 0. Free the wire or the tool, or
set the output again by hand and wait until it is hot or runs at full speed; then set {flag} to
FALSE in the variable display and the override to what it was. Never do so while block or part is in
the way of a cold wire or a tool that stands."""
_NEVER_LIT: Final = """\
{torches} lights a torch.
Behind a stop while it burned {flag} is TRUE: the submit interpreter holds that output at FALSE
and the override at 0, whatever is set by hand, until the program is reset. It does not go on: the
arc would burn where the torch stands, or metal would stay in the slot. Move the torch out by hand,
look at the sheet, reset the program, and set the override to what it was. It cuts all of its slots:
begin anew on a sheet without them, else plan anew what is left. Never select a line, and never
write {flag}. Behind a power failure do the same, also where it is FALSE.

To be checked at the controller: $PRO_STATE1, and that it is #P_RESET behind a reset alone."""


def _readme(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    wires: Sequence[SignalWire],
    torches: Sequence[str],
) -> str:
    rows = []
    for signal in signals:
        lock = controller.interlock.of(signal).signal
        number, real = controller.number(arm, signal), controller.number(arm, lock)
        if real is None:
            rows.append(f"  $OUT[{number}] {signal}: set by the program, taken back at a stop")
        else:
            rows.append(f"  $OUT[{number}] {signal}: request of the program, wired to nothing")
            rows.append(f"  $OUT[{real}] {lock}: the power hangs on this one")
    by_hand = bool(set(signals) - set(torches))
    stops, trial = (_STOPS, _TRIAL if by_hand else _TORCH_TRIAL) if rows else (_NO_STOPS, _LOOK)
    out = _LOAD.format(arm=arm, stops=stops, trial=trial)
    if wires:
        out += _wire(controller, arm, wires, bool(rows))
    if rows:
        both = "\nThe power stays on only while the program of the other arm runs, too." if wires else ""
        behind = [_FREED.format(flag=POWER_FLAG)] if by_hand else []
        behind += [_NEVER_LIT.format(flag=TORCH_FLAG, torches=", ".join(torches))] if torches else []
        out += _POWER.format(signals="\n".join(rows), behind="\n\n".join(behind), both=both)
        out += _HOT if by_hand else ""
    return out


def _wire(controller: Controller, arm: str, wires: Sequence[SignalWire], powered: bool) -> str:
    there, here = handshake.running_wires(wires, arm)
    own = controller.handshake.of(arm)
    out, given, enable = (
        controller.number(arm, name) for name in (own.running, own.partner_running, own.move_enable)
    )
    return _WIRE.format(
        other=there.sink,
        out=out,
        running=own.running,
        their=there.input,
        given=given,
        partner=own.partner_running,
        source=here.output,
        enable=enable,
        move=own.move_enable,
        falls=", and its power fall" if powered else "",
    )


MEMORY_BYTES: Final = 4_000_000
"""Bytes that a controller has for programs (KSS 8.3, told in a forum)."""
TURN_OFF: Final = np.deg2rad(0.05)
"""A classical LIN and a turn about one axis may differ by so much [rad] before it is told."""


def notes(
    tasks: Sequence[TaskProgram], plan: Plan, problem: Problem, files: Mapping[str, str]
) -> tuple[Issue, ...]:
    """Turn bits near zero (``post.turn_near_zero``), large turns in one move (``post.krl_turn``), files
    that are too long for some controllers (``post.krl_size``), what spline blocks rest on (``post.spline``),
    and moves that are in none (``post.spline_left``)."""
    out: list[Issue] = []
    dialect = problem.cell.controller.dialect
    for task in tasks:
        out += [*_turn_bits(task), *_turns(task, plan, dialect), *_size(task, files)]
        if problem.cell.controller.path == "spline":
            out += _splines(task, plan)
    return tuple(out)


def _turn_bits(task: TaskProgram) -> list[Issue]:
    out = []
    for number, operation in enumerate(task.operations, 1):
        q = spline_blocks.first_joints(operation)
        axes = [] if q is None else near_zero(task.robot, q).tolist()
        if axes:
            listed = ", ".join(f"A{axis}" for axis in axes)
            message = (
                f"operation {operation.name}: at its first target p_{number}_start {listed} of arm "
                f"{task.arm.name} is within 2 degrees of zero, where a controller may pass over the turn bit"
            )
            hint = (
                "watch the way from the station before at low speed, or turn or move the stock until these "
            )
            hint += "axes are farther off zero at that target"
            out.append(
                Issue("post.turn_near_zero", message, Severity.WARNING, arm=task.arm.name, index=0, hint=hint)
            )
    return out


def _turns(task: TaskProgram, plan: Plan, dialect: KrlDialect) -> list[Issue]:
    out = []
    for operation, rows in zip(
        task.operations, spline_blocks.operation_rows(task, Data(task, plan)), strict=True
    ):
        if rows is None or not len(rows.turn):
            continue
        worst = int(np.argmax(rows.turn))
        off = float(rows.turn[worst]) ** 2 / 16.0
        if off > TURN_OFF:
            count = int(np.sum(rows.turn**2 / 16.0 > TURN_OFF))
            place = f"{operation.segments[worst]}, move {worst + 1}"
            message = (
                f"operation {operation.name}: {count} moves of arm {task.arm.name} turn so far at once that "
                f"a controller that swivels and rotates the tool may be {np.rad2deg(off):.2f} degrees off "
                f"between their ends; most at {place}, with {np.rad2deg(rows.turn[worst]):.1f} degrees"
            )
            out.append(
                Issue(
                    "post.krl_turn",
                    message,
                    Severity.WARNING if dialect == "krc2" else Severity.NOTE,
                    arm=task.arm.name,
                    target=place,
                    value=float(np.rad2deg(off)),
                    limit=float(np.rad2deg(TURN_OFF)),
                    unit="deg",
                    hint="look at these moves at low speed, or put targets closer, so that the tool turns by "
                    f"{np.floor(np.rad2deg(4.0 * np.sqrt(TURN_OFF)) * 10.0) / 10.0:.1f} degrees or less in a "
                    "move",
                )
            )
    return out


def _splines(task: TaskProgram, plan: Plan) -> list[Issue]:
    found = spline_blocks.operation_blocks(task, plan, Data(task, plan))
    named = zip(task.operations, found, strict=True)
    return [
        issue
        for operation, runs in named
        for issue in spline_blocks.block_notes(operation.name, task.arm.name, runs, operation.segments)
    ]


def _size(task: TaskProgram, files: Mapping[str, str]) -> list[Issue]:
    size = sum(len(text) for path, text in files.items() if path.startswith(f"{task.arm.name}/"))
    if size <= MEMORY_BYTES:
        return []
    message = (
        f"the programs of arm {task.arm.name} have {size / 1e6:.1f} MB; some controllers hold "
        f"{MEMORY_BYTES / 1e6:g} MB"
    )
    hint = "load the files one after the other, or split the job into "
    hint += f"{int(np.ceil(size / MEMORY_BYTES))} problems of like length"
    return [
        Issue(
            "post.krl_size",
            message,
            Severity.WARNING,
            arm=task.arm.name,
            value=size / 1e6,
            limit=MEMORY_BYTES / 1e6,
            unit="MB",
            hint=hint,
        )
    ]
