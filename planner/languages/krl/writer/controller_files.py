"""Controller files for power outputs, which go with KRL programs, and notes to the user.

An output of KRL stays on at a stop. Lines for the submit interpreter therefore reset the output that the
program sets (its request). If the cell has a separate output that switches the power, they reset that one,
too. They then hold the arm until the operator decides how to continue or, after a stop at which a torch
burned, until the program is reset.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.claims.handshake import SignalWire
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.languages.krl.writer import spline_blocks
from planner.languages.krl.writer.data import TaskDeclarations, axes_near_zero
from planner.languages.writing import handshake
from planner.languages.writing.layout import TaskProgram
from planner.plans import Plan
from planner.problem import Controller, KrlDialect, Problem

POWER_FLAG: Final = "TANDEM_CUT"
"""Controller variable: a wire or tool was on when the program stopped."""
TORCH_FLAG: Final = "TANDEM_LIT"
"""Controller variable: a torch burned when the program stopped."""
KRL_PARTNER_SEEN: Final = "TANDEM_SEEN"
"""Variable of a KUKA controller: both programs have run since the last stop."""
KRL_RUNS: Final = "$PRO_ACT AND $PERI_RDY"
"""Condition: a program runs with the drives on."""


def build_files(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    wires: Sequence[SignalWire] = (),
    torches: Sequence[str] = (),
) -> dict[str, str]:
    """Return the files of the controller of an arm by name: variables, submit interpreter, stops and README.

    Args:
        controller: Controllers of the cell.
        arm: Name of the arm.
        signals: Power outputs that its program switches.
        wires: Running wires between this controller and another one.
        torches: Those of ``signals`` that light a torch.
    """
    runs = KRL_RUNS + (f" AND {krl_power_term(controller, arm)}" if wires else "")
    numbers = {signal: controller.signal_number(arm, signal) for signal in signals}
    flags = {signal: TORCH_FLAG if signal in torches else POWER_FLAG for signal in signals}
    reset_lines = [
        line for signal, number in numbers.items() for line in _reset_request(number, flags[signal])
    ]
    submit = krl_submit_lines(controller, arm) if wires else []
    if reset_lines:
        submit += [f"IF NOT ({runs}) THEN", *reset_lines, "ENDIF"]
    if torches:
        submit += _torch_lock([numbers[signal] for signal in torches])
    for signal, number in numbers.items():
        output_number = controller.signal_number(arm, controller.interlock.power_output(signal).signal)
        if output_number is not None:
            submit.append(f"$OUT[{output_number}]=$OUT[{number}] AND {runs}")
    used_flags = [flag for flag in (POWER_FLAG, TORCH_FLAG) if flag in flags.values()]
    if POWER_FLAG in used_flags:
        submit += [f"IF {POWER_FLAG} THEN", "$OV_PRO=0", "ENDIF"]
    variables = used_flags + ([KRL_PARTNER_SEEN] if wires else [])
    out = {
        "config_user.dat": _text([f"DECL BOOL {name}=FALSE" for name in variables]),
        "sps_user.sub": _text(submit),
    }
    if reset_lines:  # the power outputs, too, because a stopped submit interpreter resets none
        output_names = (controller.interlock.power_output(signal).signal for signal in signals)
        outputs = (controller.signal_number(arm, name) for name in output_names)
        switch_off = [f"$OUT[{number}]=FALSE" for number in outputs if number is not None]
        out["ir_stopm_user.src"] = _text([*reset_lines, *switch_off])
    return out | {"README.txt": _readme(controller, arm, signals, wires, torches)}


def krl_power_term(controller: Controller, arm: str) -> str:
    """Return the term that is ANDed to the condition for power: the input that the partner's program runs.

    Args:
        controller: Controllers of the cell.
        arm: Name of the arm.
    """
    return f"$IN[{controller.signal_number(arm, controller.handshake.of(arm).partner_running)}]"


def krl_submit_lines(controller: Controller, arm: str) -> list[str]:
    """Return the lines for the cycle of the submit interpreter of a KUKA arm's controller.

    $MOVE_ENABLE reads the level of its input and also blocks a start. A controller whose partner has not run
    yet would therefore never start. So the wire counts only after both programs have been seen to run.

    Args:
        controller: Controllers of the cell.
        arm: Name of the arm.
    """
    signals = controller.handshake.of(arm)
    running = controller.signal_number(arm, signals.running)
    enable = controller.signal_number(arm, signals.move_enable)
    partner_running = krl_power_term(controller, arm)
    return [
        f"$OUT[{running}]={KRL_RUNS} ; {signals.running}",
        "IF NOT $PRO_ACT THEN",
        f"{KRL_PARTNER_SEEN}=FALSE",
        "ENDIF",
        f"IF $PRO_ACT AND {partner_running} THEN ; {signals.partner_running}",
        f"{KRL_PARTNER_SEEN}=TRUE",
        "ENDIF",
        f"$OUT[{enable}]={partner_running} OR NOT {KRL_PARTNER_SEEN} ; {signals.move_enable}",
    ]


def _reset_request(number: int | None, flag: str) -> list[str]:
    """Return statements that reset the output of a request, and set a flag if it was on."""
    return [f"IF $OUT[{number}] THEN", f"{flag}=TRUE", "ENDIF", f"$OUT[{number}]=FALSE"]


def _torch_lock(numbers: Sequence[int | None]) -> list[str]:
    """Return statements that hold the arm and the torches off after a stop at which a torch burned.

    They do so until the program is reset: the override is 0, and the outputs ``numbers`` are off even if
    somebody sets them by hand.
    """
    return [
        *("IF $PRO_STATE1==#P_RESET THEN", f"{TORCH_FLAG}=FALSE", "ENDIF"),
        f"IF {TORCH_FLAG} THEN",
        *(f"$OUT[{number}]=FALSE" for number in numbers),
        *("$OV_PRO=0", "ENDIF"),
    ]


def _text(lines: Sequence[str]) -> str:
    return "".join(f"{line}\n" for line in ["; Written by Tandem.", *lines])


_INSTRUCTIONS: Final = """For the controller of arm {arm}. Make an archive first.

1. config_user.dat: into the user fold of $CONFIG.DAT.
2. sps_user.sub: into the user fold of the LOOP of SPS.SUB, which must contain no WAIT or motion.
3. {stops}
4. Restart the submit interpreter; it must run whenever the program does.
5. {trial}
"""
_STOP_FILE: Final = "ir_stopm_user.src: into the user fold of IR_STOPM.SRC."
_NO_STOP_FILE: Final = "IR_STOPM.SRC stays unchanged: this program switches no power."
_TRIAL: Final = """\
Try it without wire and with the tool off: set the output by hand while the program waits, then
   stop. It must fall, and the arm must not move at the next start."""
_TORCH_TRIAL: Final = """\
Try it with the supply of the torch off and its input bridged: stop the program while the output
   is TRUE. It must fall, the arm must not move at the next start, and the output must not be set
   by hand; only a reset clears this state."""
_NO_POWER_TRIAL: Final = "Watch the outputs below while a program runs and while it is stopped."

_RUNNING_WIRES_SECTION: Final = """
Running wires, between this controller and the one of arm {other}:
  $OUT[{out}] {running}: 1 while this program runs; to {their} of arm {other}
  $IN[{given}] {partner}: 1 while the program of arm {other} runs; from its {source}
  $OUT[{enable}] {move}: to the input that $MOVE_ENABLE reads, with $CHCK_MOVENA=TRUE

Try them before the first cut, without wire and with the tool off, all motors on: let both programs
run at reduced speed and pull the wire at $IN[{given}].
This arm must stop at once{falls}. Its stop must stop arm {other}, too.
Repeat with the other wire, and by stopping either program.
After a stop either side may be started first; nothing has power before both run.

Seen: $PRO_ACT, $MOVE_ENABLE with $CHCK_MOVENA, outputs set by the submit interpreter.
To be checked at the controller: that $PRO_ACT falls at every stop; that the input of $MOVE_ENABLE
works in all modes that are used.
"""

_POWER_SECTION: Final = """
Outputs:
{signals}

{behind}{both}

Seen: $OUT[n] = request AND $PRO_ACT in the submit interpreter, which keeps running at stops;
IR_STOPM as the place for the user's reactions to stops, and its interrupt at the start of programs.

To be checked at the controller: $PERI_RDY (drives ready); that $OV_PRO can be set by the submit
interpreter in all modes; that IR_STOPM runs at every stop message.

The submit interpreter is no safety function: an emergency stop must cut the power by itself, too.
"""
_HOT_WIRE_SECTION: Final = """
Mounting a hot wire with the gate open: in automatic the open gate switches off the drives, and the
power with them. Mount it cold; or in T1 while a second person holds enabling switch and start key
and the program waits; after a change of mode the power is off.
"""


_RESTART_SECTION: Final = """\
After a stop with the power on {flag} is TRUE and the override 0. Free the wire or the tool, or
set the output again by hand and wait until it is hot or runs at full speed; then set {flag} to
FALSE in the variable display and restore the override. Never do so while stock or part is in
the path of a cold wire or of a tool that does not run."""
_TORCH_SECTION: Final = """\
{torches} lights a torch.
After a stop while it burned {flag} is TRUE: the submit interpreter holds that output at FALSE
and the override at 0, whatever is set by hand, until the program is reset. It does not resume: the
arc would burn where the torch is, or metal would stay in the slot. Move the torch out by hand,
inspect the sheet, reset the program, and restore the override. It cuts all of its slots:
start on a sheet without them, otherwise replan what is left. Never select a line, and never
write {flag}. After a power failure do the same, even if it is FALSE.

To be checked at the controller: $PRO_STATE1, and that it is #P_RESET only after a reset."""


def _readme(
    controller: Controller,
    arm: str,
    signals: Sequence[str],
    wires: Sequence[SignalWire],
    torches: Sequence[str],
) -> str:
    """Return the README of a controller's files; see :func:`build_files` for the parameters."""
    output_lines = []
    for signal in signals:
        output_name = controller.interlock.power_output(signal).signal
        number = controller.signal_number(arm, signal)
        output_number = controller.signal_number(arm, output_name)
        if output_number is None:
            output_lines.append(f"  $OUT[{number}] {signal}: set by the program, reset at a stop")
        else:
            output_lines.append(f"  $OUT[{number}] {signal}: request of the program, wired to nothing")
            output_lines.append(f"  $OUT[{output_number}] {output_name}: this one switches the power")
    manual_requests = bool(set(signals) - set(torches))
    stops, trial = _NO_STOP_FILE, _NO_POWER_TRIAL
    if output_lines:
        stops, trial = _STOP_FILE, _TRIAL if manual_requests else _TORCH_TRIAL
    out = _INSTRUCTIONS.format(arm=arm, stops=stops, trial=trial)
    if wires:
        out += _running_wires_section(controller, arm, wires, bool(output_lines))
    if output_lines:
        partner_condition = (
            "\nThe power stays on only while the program of the other arm runs, too." if wires else ""
        )
        after_stop = [_RESTART_SECTION.format(flag=POWER_FLAG)] if manual_requests else []
        if torches:
            after_stop.append(_TORCH_SECTION.format(flag=TORCH_FLAG, torches=", ".join(torches)))
        out += _POWER_SECTION.format(
            signals="\n".join(output_lines), behind="\n\n".join(after_stop), both=partner_condition
        )
        if manual_requests:
            out += _HOT_WIRE_SECTION
    return out


def _running_wires_section(
    controller: Controller, arm: str, wires: Sequence[SignalWire], powered: bool
) -> str:
    """Return the section of the README on the running wires; ``powered``: the program switches power."""
    outgoing, incoming = handshake.running_wires(wires, arm)
    signals = controller.handshake.of(arm)
    running, partner_running, enable = (
        controller.signal_number(arm, name)
        for name in (signals.running, signals.partner_running, signals.move_enable)
    )
    return _RUNNING_WIRES_SECTION.format(
        other=outgoing.sink,
        out=running,
        running=signals.running,
        their=outgoing.input,
        given=partner_running,
        partner=signals.partner_running,
        source=incoming.output,
        enable=enable,
        move=signals.move_enable,
        falls=", and its power fall" if powered else "",
    )


MAX_PROGRAM_BYTES: Final = 4_000_000
"""Program memory of a controller [bytes] (KSS 8.3, according to a forum post)."""
MAX_ROTATION_DEVIATION_RAD: Final = np.deg2rad(0.05)
"""Deviation [rad] between a classical LIN and a rotation about one axis above which a note is issued."""


def notes(
    tasks: Sequence[TaskProgram], plan: Plan, problem: Problem, files: Mapping[str, str]
) -> tuple[Issue, ...]:
    """Return notes to the user on KRL programs.

    They concern turn bits near zero (``post.turn_near_zero``), large rotations in one move
    (``post.krl_turn``), programs that exceed the memory of some controllers (``post.krl_size``), assumptions
    about spline blocks (``post.spline``), and moves that are not in a block (``post.spline_left``).

    Args:
        tasks: Tasks of KUKA arms.
        plan: The plan.
        problem: Problem of the plan.
        files: Texts of the programs by path.
    """
    out: list[Issue] = []
    dialect = problem.cell.controller.dialect
    for task in tasks:
        out += [*_turn_bit_notes(task), *_rotation_notes(task, plan, dialect), *_size_notes(task, files)]
        if problem.cell.controller.path == "spline":
            out += _spline_notes(task, plan)
    return tuple(out)


def _turn_bit_notes(task: TaskProgram) -> list[Issue]:
    """Return a warning for each operation at whose first target axes are near zero.

    A controller may ignore the turn bits of these axes, and then reach the target in another posture.
    """
    out = []
    for number, operation in enumerate(task.operations, 1):
        q = spline_blocks.first_joints(operation)
        axes = [] if q is None else axes_near_zero(task.robot, q).tolist()
        if axes:
            listed = ", ".join(f"A{axis}" for axis in axes)
            message = format_message(
                "post.turn_near_zero",
                operation=operation.name,
                operation_number=number,
                axes=listed,
                arm=task.arm.name,
            )
            hint = "watch the move from the previous station at low speed, or rotate or move the stock until "
            hint += "these axes are farther from zero at that target"
            out.append(
                Issue("post.turn_near_zero", message, Severity.WARNING, arm=task.arm.name, index=0, hint=hint)
            )
    return out


def _rotation_notes(task: TaskProgram, plan: Plan, dialect: KrlDialect) -> list[Issue]:
    """Return an issue for each operation in which controllers may rotate the tool otherwise than planned.

    The issue is a warning in krc2, and a note in krc4. It names the move that rotates most. The planner
    rotates about one axis. A classical LIN swivels the tool axis by A and rotates about it by B. In the
    middle of a move that rotates by w, with |A|^2 + |B|^2 = w^2, the orientations differ by |A x B| / 8, to
    second order, which is at most w^2 / 16.
    """
    out = []
    for operation, moves in zip(
        task.operations, spline_blocks.operation_rows(task, TaskDeclarations(task, plan)), strict=True
    ):
        if moves is None or not len(moves.rotation):
            continue
        worst_index = int(np.argmax(moves.rotation))
        deviation = float(moves.rotation[worst_index]) ** 2 / 16.0
        if deviation > MAX_ROTATION_DEVIATION_RAD:
            count = int(np.sum(moves.rotation**2 / 16.0 > MAX_ROTATION_DEVIATION_RAD))
            location = f"{operation.segments[worst_index]}, move {worst_index + 1}"
            message = format_message(
                "post.krl_turn",
                operation=operation.name,
                move_count=count,
                arm=task.arm.name,
                deviation_deg=np.rad2deg(deviation),
                location=location,
                rotation_deg=np.rad2deg(moves.rotation[worst_index]),
            )
            out.append(
                Issue(
                    "post.krl_turn",
                    message,
                    Severity.WARNING if dialect == "krc2" else Severity.NOTE,
                    arm=task.arm.name,
                    target=location,
                    value=float(np.rad2deg(deviation)),
                    limit=float(np.rad2deg(MAX_ROTATION_DEVIATION_RAD)),
                    unit="deg",
                    # the advised rotation w has the allowed deviation w^2 / 16; rounded down to 0.1 deg
                    hint="watch these moves at low speed, or put targets closer, so that the tool rotates "
                    "by "
                    f"{np.floor(np.rad2deg(4.0 * np.sqrt(MAX_ROTATION_DEVIATION_RAD)) * 10.0) / 10.0:.1f} "
                    "degrees or less in a move",
                )
            )
    return out


def _spline_notes(task: TaskProgram, plan: Plan) -> list[Issue]:
    """Return the notes on the spline blocks of all operations of a task."""
    runs_by_operation = spline_blocks.operation_runs(task, plan, TaskDeclarations(task, plan))
    operations_with_runs = zip(task.operations, runs_by_operation, strict=True)
    return [
        issue
        for operation, runs in operations_with_runs
        for issue in spline_blocks.block_notes(operation.name, task.arm.name, runs, operation.segments)
    ]


def _size_notes(task: TaskProgram, files: Mapping[str, str]) -> list[Issue]:
    """Return a warning if the files of a task exceed the program memory of a controller."""
    size = sum(len(text) for path, text in files.items() if path.startswith(f"{task.arm.name}/"))
    if size <= MAX_PROGRAM_BYTES:
        return []
    message = format_message(
        "post.krl_size", arm=task.arm.name, size_mb=size / 1e6, max_size_mb=MAX_PROGRAM_BYTES / 1e6
    )
    hint = "load the files one after the other, or split the job into "
    hint += f"{int(np.ceil(size / MAX_PROGRAM_BYTES))} problems of similar length"
    return [
        Issue(
            "post.krl_size",
            message,
            Severity.WARNING,
            arm=task.arm.name,
            value=size / 1e6,
            limit=MAX_PROGRAM_BYTES / 1e6,
            unit="MB",
            hint=hint,
        )
    ]
