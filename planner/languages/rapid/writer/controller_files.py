"""Files for an ABB controller, beside the program: what its power outputs hang on besides the program.

The program sets a request; a cross connection lets the real output follow while a program runs and the motors
are on, of two controllers on both sides. Event routines take the request back at every stop, and ask at a
start behind a stop in a cut. Behind a stop at which a torch burned no program goes on: only one that begins
anew is asked about, and nobody sets a torch's request by hand.
"""

from collections.abc import Mapping, Sequence
from typing import Final, Literal

from planner.claims import sentences
from planner.claims.handshake import SignalWire
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.writer.syntax import identifier, quoted
from planner.languages.writing import handshake
from planner.problem import Controller

POWER_MODULE: Final = "TandemPower"
"""Name of the module that switches outputs off and on at stops."""
_OFF_AT: Final = ("STOP", "QSTOP", "RESET")
"""System events at which outputs go off."""
_ON_AT: Final = ("START", "RESTART", "STEP")
"""System events at which an output may be on again."""
_RESTARTS: Final = ("RESTART", "STEP")
"""Those of them at which a program goes on where it stopped."""
_POWERED_UP: Final = "POWER_ON"
"""The system event of a controller that was off, when no stop was seen."""
SignalType = Literal["DI", "DO"]
"""What a controller calls a digital input and a digital output."""
_CONFIG_WIDTH: Final = 80
"""Lines of a configuration file are broken at so many characters."""
ConfigurationRow = Mapping[str, str | None]
"""An instance of a type of ABB's configuration: values by attribute, None for one without a value."""


def files(
    controller: Controller,
    tasks: Sequence[str],
    signals: Sequence[str],
    others: Mapping[str, SignalType],
    arms: Sequence[str],
    wires: Sequence[SignalWire] = (),
    torches: Sequence[str] = (),
) -> dict[str, str]:
    """The files, by name, for motion ``tasks`` of the one controller of ``arms``, whose programs switch
    ``signals``, which power something, and name ``others``; ``wires``: the running wires between it and
    another controller; ``torches``: those of the signals that light one."""
    arm = arms[0]
    requests = [identifier(signal) for signal in signals]
    lit = [identifier(signal) for signal in torches]
    suffix = ".sys" if controller.robotware == 6 else ".sysx"
    more = {identifier(name): kind for name, kind in others.items()}
    named: list[ConfigurationRow] = [
        {"Name": name, "SignalType": kind, **placed(controller, arms, name)} for name, kind in more.items()
    ]
    out = {"EIO.cfg": _eio(controller, requests, lit, arm, bool(wires), named)}
    if requests:
        out["SYS.cfg"] = _sys(controller, tasks, suffix, bool(lit))
        out[f"{POWER_MODULE}{suffix}"] = _module(controller, requests, lit, len(tasks) > 1)
    return out | {"README.txt": _readme(controller, requests, lit, suffix, arm, wires, named)}


def _eio(
    controller: Controller,
    requests: Sequence[str],
    torches: Sequence[str],
    arm: str,
    joined: bool,
    named: Sequence[ConfigurationRow],
) -> str:
    lock = controller.interlock
    partner = [rapid_power_term(controller, arm)] if joined else []
    more = rapid_running_rows(controller, arm) if joined else {}
    signals: list[ConfigurationRow] = []
    crossed: list[ConfigurationRow] = []
    for number, request in enumerate(requests, 1):
        real = lock.of(request)
        place = {"Device": real.device, "DeviceMap": str(real.bit)} if real.device else {}
        access = "TandemTorch" if request in torches else "TandemRequest"
        signals.append({"Name": request, "SignalType": "DO", "Access": access})
        signals.append({"Name": real.signal, "SignalType": "DO", **place, "Access": "ReadOnly"})
        terms = (request, lock.cycle, lock.motors, *partner)
        row: dict[str, str | None] = {"Name": f"TandemPower{number}", "Res": real.signal}
        for i, term in enumerate(terms, 1):
            row[f"Act{i}"] = term
            if i < len(terms):
                row[f"Oper{i}"] = "AND"
        crossed.append(row)
    signals += [
        {"Name": name, "SignalType": "DO", "Access": "ReadOnly"} for name in (lock.cycle, lock.motors)
    ]
    states = [{"Status": "CycleOn", "Signal": lock.cycle}, {"Status": "MotOnState", "Signal": lock.motors}]
    levels: list[ConfigurationRow] = []
    if set(requests) - set(torches):
        levels.append({"Name": "TandemRequest", "Rapid": None, "LocalManual": None, "LocalAuto": None})
    if torches:
        levels.append({"Name": "TandemTorch", "Rapid": None})
    head = f"EIO:CFG_1.0:{controller.robotware}:{1 if controller.robotware == 6 else 0}::"
    sections: dict[str, Sequence[ConfigurationRow]] = {
        "EIO_ACCESS": levels,
        "EIO_SIGNAL": [*signals, *named, *more.get("EIO_SIGNAL", [])],
        "SYSSIG_OUT": states,
        "SYSSIG_IN": more.get("SYSSIG_IN", []),
        "EIO_CROSS": [*crossed, *more.get("EIO_CROSS", [])],
    }
    return _cfg(head, {kind: rows for kind, rows in sections.items() if rows})


def _sys(controller: Controller, tasks: Sequence[str], suffix: str, torch: bool) -> str:
    hooks: list[ConfigurationRow] = []
    for number, task in enumerate(tasks):
        again = "tandem_again" if number == 0 else "tandem_wait"
        at = dict.fromkeys(_OFF_AT, "tandem_off") | dict.fromkeys(_ON_AT, again)
        if torch:
            at |= {"START": "tandem_begin" if number == 0 else "tandem_wait", _POWERED_UP: "tandem_lost"}
            at |= dict.fromkeys(_RESTARTS, again if number == 0 else "tandem_stay")
        routines = at.items()
        hooks += [{"Routine": routine, "Shelf": shelf, "Task": task} for shelf, routine in routines]
    loaded: list[ConfigurationRow] = [
        {"File": f"HOME:/{POWER_MODULE}{suffix}", "ModName": POWER_MODULE, "AllTask": None}
    ]
    head = f"SYS:CFG_1.0:{controller.robotware}:0::"
    return _cfg(head, {"CAB_TASK_MODULES": loaded, "CAB_EXEC_HOOKS": hooks})


def rapid_power_term(controller: Controller, arm: str) -> str:
    """The further AND term of the power of an ABB arm's controller: the input from the other one."""
    return identifier(controller.handshake.of(arm).partner_running)


def rapid_running_rows(controller: Controller, arm: str) -> dict[str, list[ConfigurationRow]]:
    """Rows of EIO.cfg by type, for the controller of an ABB arm; the outputs of the system that say that a
    program runs and motors are on are declared beside them.

    Seen in backups of real cells: SYSSIG_OUT of CycleOn into EIO_CROSS. From public tools that write such
    files: -Act1_invert, SYSSIG_IN. From memory: the action Stop, and that it acts on the rising edge.
    """
    own, lock = controller.handshake.of(arm), controller.interlock
    running, given, lost = identifier(own.running), identifier(own.partner_running), identifier(own.lost)
    out, into = (placed(controller, [arm], name) for name in (own.running, own.partner_running))
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


def placed(controller: Controller, arms: Sequence[str], signal: str) -> dict[str, str]:
    """Device and bit of a signal at the controller of these arms; none where the cell states none."""
    places = (controller.interlock.place(arm, signal) for arm in arms)
    place = next((place for place in places if place is not None), None)
    return {"Device": place.device, "DeviceMap": str(place.bit)} if place else {}


def _cfg(head: str, sections: Mapping[str, Sequence[ConfigurationRow]]) -> str:
    """A configuration file; long rows go on behind a backslash."""
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


def _module(controller: Controller, requests: Sequence[str], torches: Sequence[str], together: bool) -> str:
    flags = {
        request: f"tandem_{'lit' if request in torches else 'cut'}_{number}"
        for number, request in enumerate(requests, 1)
    }
    lit = [flags[request] for request in torches]
    cut = {request: flag for request, flag in flags.items() if request not in torches}
    stop = "Stop\\AllMoveTasks;" if together else "Stop;"
    out = [
        f"MODULE {POWER_MODULE}(SYSMODULE)",
        "  ! Written by Tandem for the event routines that SYS.cfg names.",
        "  ! Whether the power was on at a stop, and nobody has said yet how it goes on.",
        *(f"  PERS bool {flag}:=FALSE;" for flag in flags.values()),
        "",
        "  ! At every stop: power that was on does not come back by itself.",
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
        out += _begun_anew(torches, flags, stop)
    out += ["", "  ! At every start: no arm moves on in a cut before somebody says that it may."]
    out += ["  PROC tandem_again()", *(["    VAR num answer;"] if cut else []), "    tandem_off;"]
    out += _ended(lit)
    for request, flag in cut.items():
        real = controller.interlock.of(request).signal
        out += [
            *_asked(flag, rapid_sentences.again(request), rapid_sentences.BUTTONS),
            f"      ELSEIF answer=2 AND DOutput({real})=1 THEN",
            f"        {flag}:=FALSE;",
            *_refused(rapid_sentences.REFUSED, stop),
        ]
    out += ["  ENDPROC"]
    if together:
        out += ["", "  ! The other task waits for the answer.", "  PROC tandem_wait()", "    tandem_off;"]
        out += [f"    WaitUntil NOT {flag};" for flag in flags.values()]
        out += ["  ENDPROC"]
    if together and torches:
        out += ["", "  ! Nor does it go on where a torch burned.", "  PROC tandem_stay()", "    tandem_off;"]
        out += [*_ended(lit), "    tandem_wait;", "  ENDPROC"]
    return "\n".join([*out, "ENDMODULE", ""])


def _begun_anew(torches: Sequence[str], flags: Mapping[str, str], stop: str) -> list[str]:
    """What becomes of a program that stopped while a torch burned."""
    out = ["", "  ! A controller that was off saw no stop: a torch may have burned."]
    out += ["  PROC tandem_lost()", *(f"    {flags[request]}:=TRUE;" for request in torches)]
    out += ["    tandem_off;", "  ENDPROC", ""]
    out += ["  ! Where a torch burned no start goes on; PP to main alone leads out."]
    out += ["  PROC tandem_end()", "    WHILE TRUE DO"]
    out += [f"      TPWrite {quoted(line)};" for line in rapid_sentences.ENDED]
    out += [f"      {stop}", "    ENDWHILE", "  ENDPROC", ""]
    out += ["  ! At a start anew: nothing is lit again, and all slots are still to be cut."]
    out += ["  PROC tandem_begin()", "    VAR num answer;", "    tandem_off;"]
    for request in torches:
        words = rapid_sentences.burned(request)
        out += _asked(flags[request], words, rapid_sentences.BEGIN_BUTTONS)
        out += _refused(rapid_sentences.ENDED, stop)
    return [*out, "    tandem_again;", "  ENDPROC"]


def _ended(flags: Sequence[str]) -> list[str]:
    """The program ends if one of the ``flags`` of torches is TRUE."""
    return [line for flag in flags for line in (f"    IF {flag} THEN", "      tandem_end;", "    ENDIF")]


def _asked(flag: str, lines: Sequence[str], buttons: Sequence[str]) -> list[str]:
    """A question as long as a flag is TRUE, which the first answer takes back."""
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


def _refused(lines: Sequence[str], stop: str) -> list[str]:
    told = [f"        TPWrite {quoted(line)};" for line in lines]
    return ["      ELSE", *told, f"        {stop}", "      ENDIF", "    ENDWHILE"]


_STEPS: Final = """For the controller that these programs run on. Make a backup first.

1. {module}
2. Load {files}: Control Panel, Configuration, File, Load Parameters, "Load parameters
   if no duplicates". A signal that has one of these names already must be taken out first.
3. Restart the controller.{held}
4. {trial}
"""
_COPY: Final = "Copy {module} to HOME: of the controller."
_NO_COPY: Final = "No module is needed: this program switches no power."
_HELD: Final = " Every motion task then holds the module and the event routines."
_TRIAL: Final = """\
Try it without wire and with the tool off: start, set the request by hand, stop. The real output
   must fall with the program, with the motors, and when the enabling device is let go."""
_TORCH_TRIAL: Final = """\
Try it with the supply of the torch off and its input bridged: start, stop while the request is
   1. The real output must fall with the program, with the motors, and when the enabling device is
   let go; Start and a step must stop at once, and only PP to main ask."""
_LOOK: Final = "Look at the signals below while a program runs and while it stands."

_WIRE: Final = """
Running wires, between this controller and the one of arm {other}:
{ends}
  {lost}: on no device; {partner} turned over, whose rise stops the program

Try them before the first cut, without wire and with the tool off, all motors on: let both programs
run at reduced speed and pull the wire at {partner}.
This arm must stop at once{falls}. Its stop must stop arm {other}, too.
Then the same with the other wire, and by stopping either program.
After a stop either side may be started first; nothing has power before both run.

Seen in public tools that write such files: -Act1_invert, SYSSIG_IN; in a backup: SYSSIG_OUT with
CycleOn into EIO_CROSS. To be checked at the controller: SYSSIG_OUT with MotOnState; the action
Stop, that it acts on the rise alone, and that Start is not held up while
{lost} is 1. If it is, neither side can be started first: a PLC then
has to make a pulse of the rise.
"""

_POWER: Final = """
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


_BY_HAND: Final = """\
; that TandemRequest lets
the operator set the request by hand in automatic"""
_TORCH: Final = """
{torches} lights a torch.
Behind a stop while it burned, and when the controller was off, no program goes on: nobody can set
that request by hand (TandemTorch), no question offers it, and a start or a step stops at once. Move
the torch out by hand, look at the sheet, then PP to main in all tasks and Start: "Begin" is the
answer for a sheet that has no slot of this program yet. Else plan anew what is left. Never move PP
into the program: it would light the torch where it stands.

To be checked, too: the shelf POWER_ON; that Start behind PP to main runs START, and behind a stop
RESTART; that nobody can set a signal of access TandemTorch at the panel.
"""
_HOT: Final = """
Mounting a hot wire with the gate open: in automatic the guard stop takes motors and program away,
and the power with them. Mount it cold; or in manual at reduced speed, while somebody else holds the
enabling device and the program waits at its question. The job then runs to its end in manual: a
change to automatic is a stop, at which the power falls.
"""


_OTHERS: Final = """
Other signals that the programs name, without which they do not load:
{signals}

One that the controller has already, wired, may stay as it is; its type has to be the same.
"""


def _readme(
    controller: Controller,
    requests: Sequence[str],
    torches: Sequence[str],
    suffix: str,
    arm: str,
    wires: Sequence[SignalWire],
    named: Sequence[ConfigurationRow],
) -> str:
    module = _COPY.format(module=f"{POWER_MODULE}{suffix}") if requests else _NO_COPY
    names = "EIO.cfg and SYS.cfg" if requests else "EIO.cfg"
    by_hand = bool(set(requests) - set(torches))
    held, trial = (_HELD, _TRIAL if by_hand else _TORCH_TRIAL) if requests else ("", _LOOK)
    out = _STEPS.format(module=module, files=names, held=held, trial=trial)
    if wires:
        out += _wire(controller, arm, wires, bool(requests))
    if requests:
        both = "\nThe power is on only while the program of the other arm runs, too." if wires else ""
        rows, said = "\n".join(_outputs(controller, requests)), _BY_HAND if by_hand else ""
        out += _POWER.format(signals=rows, both=both, by_hand=said)
        out += _TORCH.format(torches=" and ".join(torches)) if torches else ""
        out += _HOT if by_hand else ""
    if named:
        more = [line for row in named for line in _named(row, arm)]
        out += _OTHERS.format(signals="\n".join(more))
    return out


def _named(row: ConfigurationRow, arm: str) -> list[str]:
    """What is said of a signal that powers nothing."""
    name = row["Name"]
    kind, dead = (
        ("input", "nothing drives it") if row["SignalType"] == "DI" else ("output", "it drives nothing")
    )
    if "Device" in row:
        return [f"  {name}: {kind}, {row['Device']}, bit {row['DeviceMap']}"]
    stated = f"places: {{{arm}: {{{name}: {{device: D, device_map: 0}}}}}}"
    return [
        f"  {name}: {kind}, NO DEVICE, so that {dead}; state it in the cell:",
        f"    controller: {{interlock: {{{stated}}}}}",
    ]


def _outputs(controller: Controller, requests: Sequence[str]) -> list[str]:
    rows = []
    for request in requests:
        real = controller.interlock.of(request)
        rows.append(f"  {request}: request of the program, on no device")
        if real.device:
            rows.append(f"  {real.signal}: {real.device}, bit {real.bit}; the power hangs on this one")
        else:
            rows.append(f"  {real.signal}: NO DEVICE, so nothing is powered; state it in the cell:")
            rows.append(
                f"    controller: {{interlock: {{outputs: {{{request}: {{device: D, device_map: 0}}}}}}}}"
            )
    return rows


def _wire(controller: Controller, arm: str, wires: Sequence[SignalWire], powered: bool) -> str:
    there, here = handshake.running_wires(wires, arm)
    own = controller.handshake.of(arm)
    rows = []
    for name, what in (
        (own.running, f"output, 1 while this program runs; to {there.input} of arm {there.sink}"),
        (own.partner_running, f"input, 1 while the other one runs; from {here.output} of arm {here.source}"),
    ):
        place = controller.interlock.place(arm, name)
        rows.append(f"  {name}: {what}")
        if place is not None:
            rows.append(f"    {place.device}, bit {place.bit}")
        else:
            rows.append("    NO DEVICE, so the wire does not work yet; state it in the cell:")
            stated = f"places: {{{arm}: {{{name}: {{device: D, device_map: 0}}}}}}"
            rows.append(f"    controller: {{interlock: {{{stated}}}}}")
    return _WIRE.format(
        other=there.sink,
        ends="\n".join(rows),
        lost=own.lost,
        partner=own.partner_running,
        falls=", and its power fall" if powered else "",
    )
