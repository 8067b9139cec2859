"""Configuration files and system module of an ABB controller, which switch power outputs beside the program.

The program sets a request, which is a signal on no device. A cross connection lets the real output follow
while a program runs and the motors are on; with two controllers, while this holds for both. Event routines
reset the request at every stop, and ask the operator at a start after a stop in a cut. After a stop at which
a torch burned, no program resumes: the operator is asked only at a start from main, and nobody can set the
request of a torch by hand.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Literal

from planner.claims import sentences
from planner.claims.handshake import SignalWire
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.writer.syntax import identifier, quoted
from planner.languages.writing import handshake
from planner.languages.writing.language import PoweredSignals
from planner.problem import Controller

POWER_MODULE: Final = "TandemPower"
"""Name of the module that switches outputs at stops and starts."""
_POWER_OFF_EVENTS: Final = ("STOP", "QSTOP", "RESET")
"""System events at which outputs are switched off."""
_POWER_ON_EVENTS: Final = ("START", "RESTART", "STEP")
"""System events at which an output may be switched on again."""
_RESUME_EVENTS: Final = ("RESTART", "STEP")
"""Events of ``_POWER_ON_EVENTS`` at which a program resumes where it stopped."""
_POWER_UP_EVENT: Final = "POWER_ON"
"""System event of a controller that is switched on. It saw no stop while it was off."""
SignalType = Literal["DI", "DO"]
"""ABB's names for a digital input and a digital output."""
_CONFIG_WIDTH: Final = 80
"""Maximum length of a line of a configuration file [characters]; longer rows are continued."""
ConfigurationRow = Mapping[str, str | None]
"""A row (instance) of ABB's configuration: values by attribute, None for an attribute without value."""


def build_files(
    controller: Controller,
    tasks: Sequence[str],
    arms: Sequence[str],
    powered: PoweredSignals,
    other_signals: Mapping[str, SignalType],
) -> dict[str, str]:
    """Return the files of one controller by name.

    These are EIO.cfg, README.txt and, if the programs switch power, SYS.cfg and the module TandemPower.

    Args:
        controller: Controllers of the cell.
        tasks: Motion tasks of this controller.
        arms: Names of its arms.
        powered: Power outputs that its programs switch, and the running wires between it and another
            controller.
        other_signals: Other signals that its programs name, with their types.
    """
    arm = arms[0]
    wires = powered.wires
    requests = [identifier(signal) for signal in powered.signals]
    torch_requests = [identifier(signal) for signal in powered.torches]
    other_types = {identifier(name): kind for name, kind in other_signals.items()}
    other_rows: list[ConfigurationRow] = [
        {"Name": name, "SignalType": kind, **device_attributes(controller, arms, name)}
        for name, kind in other_types.items()
    ]
    files = {"EIO.cfg": _eio(controller, requests, torch_requests, arm, bool(wires), other_rows)}
    if requests:
        files["SYS.cfg"] = _sys(controller, tasks, bool(torch_requests))
        files[_module_file(controller)] = _module(controller, requests, torch_requests, len(tasks) > 1)
    return files | {"README.txt": _readme(controller, requests, torch_requests, arm, wires, other_rows)}


def _module_file(controller: Controller) -> str:
    """Return the file name of the module that switches outputs; RobotWare 7 has another suffix."""
    return f"{POWER_MODULE}{'.sys' if controller.robotware == 6 else '.sysx'}"


def _eio(
    controller: Controller,
    requests: Sequence[str],
    torches: Sequence[str],
    arm: str,
    has_partner: bool,
    other_rows: Sequence[ConfigurationRow],
) -> str:
    """Return the text of EIO.cfg: signals, access levels, system inputs and outputs, cross connections.

    Args:
        controller: Controllers of the cell.
        requests: Signals that programs set to request power, on no device. A real output follows each.
        torches: Those of them that light a torch, which only a program may set.
        arm: Name of the first arm of this controller.
        has_partner: Whether there are running wires to another controller.
        other_rows: Rows of other signals that the programs name.
    """
    interlock = controller.interlock
    partner_terms = [rapid_power_term(controller, arm)] if has_partner else []
    running_rows = rapid_running_rows(controller, arm) if has_partner else {}
    signals: list[ConfigurationRow] = []
    cross_connections: list[ConfigurationRow] = []
    for number, request in enumerate(requests, 1):
        output = interlock.power_output(request)
        wiring = {"Device": output.device, "DeviceMap": str(output.bit)} if output.device else {}
        access = "TandemTorch" if request in torches else "TandemRequest"
        signals.append({"Name": request, "SignalType": "DO", "Access": access})
        signals.append({"Name": output.signal, "SignalType": "DO", **wiring, "Access": "ReadOnly"})
        terms = (request, interlock.cycle, interlock.motors, *partner_terms)
        row: dict[str, str | None] = {"Name": f"TandemPower{number}", "Res": output.signal}
        for i, term in enumerate(terms, 1):
            row[f"Act{i}"] = term
            if i < len(terms):
                row[f"Oper{i}"] = "AND"
        cross_connections.append(row)
    signals += [
        {"Name": name, "SignalType": "DO", "Access": "ReadOnly"}
        for name in (interlock.cycle, interlock.motors)
    ]
    states = [
        {"Status": "CycleOn", "Signal": interlock.cycle},
        {"Status": "MotOnState", "Signal": interlock.motors},
    ]
    levels: list[ConfigurationRow] = []
    if set(requests) - set(torches):
        levels.append({"Name": "TandemRequest", "Rapid": None, "LocalManual": None, "LocalAuto": None})
    if torches:
        levels.append({"Name": "TandemTorch", "Rapid": None})
    head = f"EIO:CFG_1.0:{controller.robotware}:{1 if controller.robotware == 6 else 0}::"
    sections: dict[str, Sequence[ConfigurationRow]] = {
        "EIO_ACCESS": levels,
        "EIO_SIGNAL": [*signals, *other_rows, *running_rows.get("EIO_SIGNAL", [])],
        "SYSSIG_OUT": states,
        "SYSSIG_IN": running_rows.get("SYSSIG_IN", []),
        "EIO_CROSS": [*cross_connections, *running_rows.get("EIO_CROSS", [])],
    }
    return _cfg(head, {kind: rows for kind, rows in sections.items() if rows})


def _sys(controller: Controller, tasks: Sequence[str], has_torch: bool) -> str:
    """Return the text of SYS.cfg, which binds the event routines to system events of each task.

    At a start the first task asks the operator, and the others wait for the answer.
    """
    hooks: list[ConfigurationRow] = []
    for number, task in enumerate(tasks):
        start_routine = "tandem_again" if number == 0 else "tandem_wait"
        routine_by_event = dict.fromkeys(_POWER_OFF_EVENTS, "tandem_off") | dict.fromkeys(
            _POWER_ON_EVENTS, start_routine
        )
        if has_torch:
            routine_by_event |= {
                "START": "tandem_begin" if number == 0 else "tandem_wait",
                _POWER_UP_EVENT: "tandem_lost",
            }
            routine_by_event |= dict.fromkeys(_RESUME_EVENTS, start_routine if number == 0 else "tandem_stay")
        routines = routine_by_event.items()
        hooks += [{"Routine": routine, "Shelf": shelf, "Task": task} for shelf, routine in routines]
    loaded: list[ConfigurationRow] = [
        {"File": f"HOME:/{_module_file(controller)}", "ModName": POWER_MODULE, "AllTask": None}
    ]
    head = f"SYS:CFG_1.0:{controller.robotware}:0::"
    return _cfg(head, {"CAB_TASK_MODULES": loaded, "CAB_EXEC_HOOKS": hooks})


def rapid_power_term(controller: Controller, arm: str) -> str:
    """Return the additional AND term of an arm's power: the running input from the other controller.

    Args:
        controller: Controllers of the cell.
        arm: Name of the arm.
    """
    return identifier(controller.handshake.of(arm).partner_running)


def rapid_running_rows(controller: Controller, arm: str) -> dict[str, list[ConfigurationRow]]:
    """Return the rows of EIO.cfg for the running wires of an ABB arm's controller, by type.

    The system outputs CycleOn and MotOnState, which they use, are declared elsewhere in the same file.

    Seen in backups of real cells: SYSSIG_OUT of CycleOn into EIO_CROSS. From public tools that write such
    files: -Act1_invert, SYSSIG_IN. From memory: the action Stop, and that it acts on the rising edge.

    Args:
        controller: Controllers of the cell.
        arm: Name of the arm.
    """
    signals = controller.handshake.of(arm)
    interlock = controller.interlock
    running = identifier(signals.running)
    partner_running = identifier(signals.partner_running)
    lost = identifier(signals.lost_input)
    output_wiring = device_attributes(controller, [arm], signals.running)
    input_wiring = device_attributes(controller, [arm], signals.partner_running)
    return {
        "EIO_SIGNAL": [
            {"Name": running, "SignalType": "DO", **output_wiring, "Access": "ReadOnly"},
            {"Name": partner_running, "SignalType": "DI", **input_wiring},
            {"Name": lost, "SignalType": "DI"},
        ],
        "SYSSIG_IN": [{"Signal": lost, "Action": "Stop"}],
        "EIO_CROSS": [
            {
                "Name": "TandemRunning",
                "Res": running,
                "Act1": identifier(interlock.cycle),
                "Oper1": "AND",
                "Act2": identifier(interlock.motors),
            },
            {"Name": "TandemPartner", "Res": lost, "Act1": partner_running, "Act1_invert": None},
        ],
    }


def device_attributes(controller: Controller, arms: Sequence[str], signal: str) -> dict[str, str]:
    """Return the attributes Device and DeviceMap of a signal; empty if the cell states no device for it.

    Args:
        controller: Controllers of the cell.
        arms: Names of the arms of this controller.
        signal: Name of the signal.
    """
    connections = (controller.interlock.device_bit(arm, signal) for arm in arms)
    connection = next((connection for connection in connections if connection is not None), None)
    return {"Device": connection.device, "DeviceMap": str(connection.bit)} if connection else {}


def _cfg(head: str, sections: Mapping[str, Sequence[ConfigurationRow]]) -> str:
    """Return the text of a configuration file.

    Args:
        head: First line.
        sections: Rows of each section, by the name of the section. A row that is longer than
            ``_CONFIG_WIDTH`` continues in the next line, after a backslash.
    """
    out = [head]
    for kind, rows in sections.items():
        out += ["#", f"{kind}:"]
        for row in rows:
            out.append("")
            line = "     "
            for name, value in row.items():
                word = f"-{name}" if value is None else f"-{name} {quoted(value)}"
                if len(line) + len(word) > _CONFIG_WIDTH:
                    out.append(f"{line}\\")
                    line = "     "
                line += f" {word}"
            out.append(line)
    return "\n".join([*out, ""])


def _module(
    controller: Controller, requests: Sequence[str], torches: Sequence[str], multiple_tasks: bool
) -> str:
    """Return the text of the system module TandemPower with the event routines that SYS.cfg names.

    A flag for each request (tandem_cut_n, tandem_lit_n for torches) stores that it was on at a stop.

    Args:
        controller: Controllers of the cell.
        requests: Signals that programs set to request power.
        torches: Those of them that light a torch.
        multiple_tasks: Whether the controller has several motion tasks.
    """
    flags = {
        request: f"tandem_{'lit' if request in torches else 'cut'}_{number}"
        for number, request in enumerate(requests, 1)
    }
    torch_flags = [flags[request] for request in torches]
    other_flags = {request: flag for request, flag in flags.items() if request not in torches}
    stop = "Stop\\AllMoveTasks;" if multiple_tasks else "Stop;"
    out = [
        f"MODULE {POWER_MODULE}(SYSMODULE)",
        "  ! Written by Tandem for the event routines that SYS.cfg names.",
        "  ! TRUE: the power was on at a stop, and the operator has not answered yet.",
        *(f"  PERS bool {flag}:=FALSE;" for flag in flags.values()),
        "",
        "  ! At every stop: power that was on stays off until the operator answers.",
        "  PROC tandem_off()",
    ]
    for request, flag in flags.items():
        out += [
            f"    IF DOutput({request})=1 THEN",
            f"      {flag}:=TRUE;",
            "    ENDIF",
            f"    SetDO {request},0;",
        ]
    out += ["  ENDPROC"]
    if torches:
        out += _torch_routines(torches, flags, stop)
    out += ["", "  ! At every start: no arm continues a cut before the operator confirms it."]
    out += ["  PROC tandem_again()", *(["    VAR num answer;"] if other_flags else []), "    tandem_off;"]
    out += _end_if_set(torch_flags)
    for request, flag in other_flags.items():
        output = controller.interlock.power_output(request).signal
        out += [
            *_question_loop(flag, rapid_sentences.restart_question(request), rapid_sentences.RESTART_BUTTONS),
            f"      ELSEIF answer=2 AND DOutput({output})=1 THEN",
            f"        {flag}:=FALSE;",
            *_refusal_branch(rapid_sentences.RESTART_REFUSED, stop),
        ]
    out += ["  ENDPROC"]
    if multiple_tasks:
        out += ["", "  ! The other task waits for the answer.", "  PROC tandem_wait()", "    tandem_off;"]
        out += [f"    WaitUntil NOT {flag};" for flag in flags.values()]
        out += ["  ENDPROC"]
    if multiple_tasks and torches:
        out += [
            "",
            "  ! After a stop at which a torch burned it does not resume.",
            "  PROC tandem_stay()",
            "    tandem_off;",
        ]
        out += [*_end_if_set(torch_flags), "    tandem_wait;", "  ENDPROC"]
    return "\n".join([*out, "ENDMODULE", ""])


def _torch_routines(torches: Sequence[str], flags: Mapping[str, str], stop: str) -> list[str]:
    """Return the lines of the routines for a program that stopped while a torch burned.

    ``torches`` are the requests of torches, ``flags`` the names of the flags by request, and ``stop`` is the
    statement that stops all tasks.
    """
    out = ["", "  ! A controller that was off saw no stop: a torch may have burned."]
    out += ["  PROC tandem_lost()", *(f"    {flags[request]}:=TRUE;" for request in torches)]
    out += ["    tandem_off;", "  ENDPROC", ""]
    out += ["  ! After a stop at which a torch burned only PP to main helps."]
    out += ["  PROC tandem_end()", "    WHILE TRUE DO"]
    out += [f"      TPWrite {quoted(line)};" for line in rapid_sentences.TORCH_RESTART_REFUSED]
    out += [f"      {stop}", "    ENDWHILE", "  ENDPROC", ""]
    out += ["  ! At a start from main: no torch is lit again, and no slot is cut yet."]
    out += ["  PROC tandem_begin()", "    VAR num answer;", "    tandem_off;"]
    for request in torches:
        question = rapid_sentences.torch_restart_question(request)
        out += _question_loop(flags[request], question, rapid_sentences.TORCH_RESTART_BUTTONS)
        out += _refusal_branch(rapid_sentences.TORCH_RESTART_REFUSED, stop)
    return [*out, "    tandem_again;", "  ENDPROC"]


def _end_if_set(flags: Sequence[str]) -> list[str]:
    """Return statements that end the program if one of the torches' ``flags`` is TRUE."""
    return [line for flag in flags for line in (f"    IF {flag} THEN", "      tandem_end;", "    ENDIF")]


def _question_loop(flag: str, lines: Sequence[str], buttons: Sequence[str]) -> list[str]:
    """Return the start of a loop that asks while a flag is TRUE.

    It ends with the branch of the first answer, which resets the flag.
    """
    return [
        f"    WHILE {flag} DO",
        f"      answer:=UIMessageBox(\\Header:={quoted(sentences.HEADER)}",
        f"        \\MsgArray:=[{quoted(lines[0])},",
        *(f"          {quoted(line)}," for line in lines[1:-1]),
        f"          {quoted(lines[-1])}]",
        f"        \\BtnArray:=[{','.join(quoted(word) for word in buttons)}]\\Icon:=iconWarning);",
        "      IF answer=1 THEN",
        f"        {flag}:=FALSE;",
    ]


def _refusal_branch(lines: Sequence[str], stop: str) -> list[str]:
    """Return the end of the loop of `_question_loop`: any other answer shows ``lines`` and stops."""
    shown = [f"        TPWrite {quoted(line)};" for line in lines]
    return ["      ELSE", *shown, f"        {stop}", "      ENDIF", "    ENDWHILE"]


_INSTRUCTIONS: Final = """For the controller that these programs run on. Make a backup first.

1. {module}
2. Load {files}: Control Panel, Configuration, File, Load Parameters, "Load parameters
   if no duplicates". Remove any signal that already has one of these names first.
3. Restart the controller.{held}
4. {trial}
"""
_COPY_MODULE: Final = "Copy {module} to HOME: of the controller."
_NO_MODULE: Final = "No module is needed: this program switches no power."
_RESTART_EFFECT: Final = " Every motion task then has the module and the event routines."
_TRIAL: Final = """\
Try it without wire and with the tool off: start, set the request by hand, stop. The real output
   must fall with the program, with the motors, and when the enabling device is let go."""
_TORCH_TRIAL: Final = """\
Try it with the supply of the torch off and its input bridged: start, stop while the request is
   1. The real output must fall with the program, with the motors, and when the enabling device is
   let go; Start and a step must stop at once, and only PP to main asks."""
_NO_POWER_TRIAL: Final = "Watch the signals below while a program runs and while it is stopped."

_RUNNING_WIRES_SECTION: Final = """
Running wires, between this controller and the one of arm {other}:
{ends}
  {lost}: on no device; {partner} inverted; its rising edge stops the program

Try them before the first cut, without wire and with the tool off, all motors on: let both programs
run at reduced speed and pull the wire at {partner}.
This arm must stop at once{falls}. Its stop must stop arm {other}, too.
Repeat with the other wire, and by stopping either program.
After a stop either side may be started first; nothing has power before both run.

Seen in public tools that write such files: -Act1_invert, SYSSIG_IN; in a backup: SYSSIG_OUT with
CycleOn into EIO_CROSS. To be checked at the controller: SYSSIG_OUT with MotOnState; the action
Stop, that it acts on the rising edge only, and that Start is not blocked while
{lost} is 1. If it is, neither side can be started first: a PLC must then
turn the rising edge into a pulse.
"""

_POWER_SECTION: Final = """
Signals:
{signals}{both}

Seen in backups of real controllers: EIO_CROSS with AND of a request and a CycleOn output
(RobotWare 5; -Name in RobotWare 6), SYSSIG_OUT with CycleOn, EIO_ACCESS and its attributes,
-Access "ReadOnly", -Device and -DeviceMap, CAB_TASK_MODULES with HOME: and -AllTask,
CAB_EXEC_HOOKS for START, RESTART and STEP, a wait in such a routine, UIMessageBox.

To be checked at the controller: SYSSIG_OUT with MotOnState; the shelves STOP, QSTOP and RESET; that
CycleOn falls at every stop; that Stop in a routine of START or RESTART keeps the arms where they
are; that both tasks wait there; UIMessageBox with MsgArray and BtnArray{by_hand}.

A cross connection is no safety function: an emergency stop must cut the power by itself, too.
"""


_MANUAL_REQUEST_CHECK: Final = """\
; that TandemRequest lets
the operator set the request by hand in automatic"""
_TORCH_SECTION: Final = """
{torches} lights a torch.
After a stop while it burned, and after the controller was off, no program resumes: nobody can set
that request by hand (TandemTorch), no question offers it, and a start or a step stops at once. Move
the torch out by hand, inspect the sheet, then PP to main in all tasks and Start: "Begin" is the
answer for a sheet that has no slot of this program yet. Otherwise replan what is left. Never move
PP into the program: it would light the torch where it is.

To be checked, too: the shelf POWER_ON; that Start after PP to main runs START, and after a stop
RESTART; that nobody can set a signal of access TandemTorch at the panel.
"""
_HOT_WIRE_SECTION: Final = """
Mounting a hot wire with the gate open: in automatic the guard stop ends motors and program, and the
power with them. Mount it cold; or in manual at reduced speed, while a second person holds the
enabling device and the program waits at its question. The job then runs to its end in manual: a
change to automatic is a stop, at which the power goes off.
"""


_OTHER_SIGNALS_SECTION: Final = """
Other signals that the programs name, without which they do not load:
{signals}

A wired signal that the controller already has may stay unchanged if its type is the same.
"""


def _readme(
    controller: Controller,
    requests: Sequence[str],
    torches: Sequence[str],
    arm: str,
    wires: Sequence[SignalWire],
    other_rows: Sequence[ConfigurationRow],
) -> str:
    """Return the text of README.txt: how to load the files, try them and wire the signals.

    ``requests`` and ``torches`` are as in `_eio`. ``wires`` are the running wires to another controller, none
    for one controller. Sections about power, torches, wires and other signals occur only if there are any.
    """
    module = _COPY_MODULE.format(module=_module_file(controller)) if requests else _NO_MODULE
    files = "EIO.cfg and SYS.cfg" if requests else "EIO.cfg"
    manual_requests = bool(set(requests) - set(torches))
    restart_effect = ""
    trial = _NO_POWER_TRIAL
    if requests:
        restart_effect = _RESTART_EFFECT
        trial = _TRIAL if manual_requests else _TORCH_TRIAL
    out = _INSTRUCTIONS.format(module=module, files=files, held=restart_effect, trial=trial)
    if wires:
        out += _running_wires_section(controller, arm, wires, bool(requests))
    if requests:
        partner_note = "\nThe power is on only while the program of the other arm runs, too." if wires else ""
        signals = "\n".join(_power_output_lines(controller, requests))
        manual_check = _MANUAL_REQUEST_CHECK if manual_requests else ""
        out += _POWER_SECTION.format(signals=signals, both=partner_note, by_hand=manual_check)
        out += _TORCH_SECTION.format(torches=" and ".join(torches)) if torches else ""
        out += _HOT_WIRE_SECTION if manual_requests else ""
    if other_rows:
        signal_lines = [line for row in other_rows for line in _other_signal_lines(row, arm)]
        out += _OTHER_SIGNALS_SECTION.format(signals="\n".join(signal_lines))
    return out


def _other_signal_lines(row: ConfigurationRow, arm: str) -> list[str]:
    """Return the lines of the README on a signal that switches no power."""
    name = row["Name"]
    is_input = row["SignalType"] == "DI"
    kind = "input" if is_input else "output"
    if "Device" in row:
        return [f"  {name}: {kind}, {row['Device']}, bit {row['DeviceMap']}"]
    consequence = "nothing drives it" if is_input else "it drives nothing"
    example = f"places: {{{arm}: {{{name}: {{device: D, device_map: 0}}}}}}"
    return [
        f"  {name}: {kind}, NO DEVICE, so that {consequence}; state it in the cell:",
        f"    controller: {{interlock: {{{example}}}}}",
    ]


def _power_output_lines(controller: Controller, requests: Sequence[str]) -> list[str]:
    """Return the lines of the README on each request and the power output that follows it."""
    lines = []
    for request in requests:
        output = controller.interlock.power_output(request)
        lines.append(f"  {request}: request of the program, on no device")
        if output.device:
            lines.append(f"  {output.signal}: {output.device}, bit {output.bit}; this one switches the power")
        else:
            lines.append(f"  {output.signal}: NO DEVICE, so nothing is powered; state it in the cell:")
            lines.append(
                f"    controller: {{interlock: {{outputs: {{{request}: {{device: D, device_map: 0}}}}}}}}"
            )
    return lines


def _running_wires_section(
    controller: Controller, arm: str, wires: Sequence[SignalWire], powered: bool
) -> str:
    """Return the README section on the running wires between the controller of ``arm`` and the other one."""
    outgoing, incoming = handshake.running_wires(wires, arm)
    signals = controller.handshake.of(arm)
    lines = []
    for name, description in (
        (signals.running, f"output, 1 while this program runs; to {outgoing.input} of arm {outgoing.sink}"),
        (
            signals.partner_running,
            f"input, 1 while the other one runs; from {incoming.output} of arm {incoming.source}",
        ),
    ):
        connection = controller.interlock.device_bit(arm, name)
        lines.append(f"  {name}: {description}")
        if connection is not None:
            lines.append(f"    {connection.device}, bit {connection.bit}")
        else:
            lines.append("    NO DEVICE, so the wire does not work yet; state it in the cell:")
            example = f"places: {{{arm}: {{{name}: {{device: D, device_map: 0}}}}}}"
            lines.append(f"    controller: {{interlock: {{{example}}}}}")
    return _RUNNING_WIRES_SECTION.format(
        other=outgoing.sink,
        ends="\n".join(lines),
        lost=signals.lost_input,
        partner=signals.partner_running,
        falls=", and its power fall" if powered else "",
    )
