"""Expected texts of the controller files that switch power at stops and starts.

A wire or a tool may be switched on again by hand if a person confirms it. A torch never: after a stop at
which it burned no program resumes, no question asks whether it is on, nobody sets its request by hand, and
only a start from main is possible. The proof has its own copy of the sentences for torches; those for other
power outputs are shared with the writer.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from planner.claims import sentences
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.reader.configuration import InstanceRow
from planner.problem import Controller

POWER_MODULE: Final = "TandemPower"
"""Name of the module that switches outputs at stops and starts."""
_POWER_OFF_EVENTS: Final = ("STOP", "QSTOP", "RESET")
"""System events at which requests are reset."""
_TORCH_RESTART_QUESTION: Final = (
    "{signal} burned at the stop,",
    "or the controller has been off since.",
    "Begin: PP is at main, the torch was moved out by hand,",
    "and the sheet has no slot of this program yet.",
    "Stop: otherwise. Then replan what is left to cut.",
)
"""The question before a program starts from main after a stop at which a torch burned."""
_TORCH_RESTART_BUTTONS: Final = ("Begin", "Stop")
"""Answers to `_TORCH_RESTART_QUESTION`: none of them states that the torch burns."""
_TORCH_RESTART_REFUSED: Final = (
    "Not started: a torch burned at the stop",
    "or the controller was off. Move it out",
    "by hand, inspect the sheet, then PP to",
    "main in all tasks, and Start.",
)
"""Shown if a program is resumed after a stop at which a torch burned."""


def config_row(**values: str) -> InstanceRow:
    """Return a row of a configuration file from its attributes; "" is an attribute without value."""
    return frozenset(values.items())


def request_rows(signals: Sequence[str], torches: frozenset[str]) -> list[InstanceRow]:
    """Return the expected EIO_SIGNAL rows of requests, which are signals on no device.

    The program and the operator may set the requests of tools and wires; only the program may set those of
    torches.

    Args:
        signals: Power outputs.
        torches: Those of them that light a torch.
    """
    return [
        config_row(name=name, signaltype="DO", access="TandemTorch" if name in torches else "TandemRequest")
        for name in signals
    ]


def access_rows(signals: Sequence[str], torches: frozenset[str]) -> list[InstanceRow]:
    """Return the expected EIO_ACCESS rows: the access levels that requests use, which state who may set them.

    Args:
        signals: Power outputs.
        torches: Those of them that light a torch.
    """
    rows = []
    if set(signals) - torches:
        rows.append(config_row(name="TandemRequest", rapid="", localmanual="", localauto=""))
    if torches:
        rows.append(config_row(name="TandemTorch", rapid=""))
    return rows


def hook_rows(tasks: Sequence[str], module: str, torches: frozenset[str]) -> dict[str, list[InstanceRow]]:
    """Return the expected rows of SYS.cfg: the module in every task, and the routine of each system event.

    At a start the first task asks the operator, and the others wait for the answers.

    Args:
        tasks: Names of the tasks.
        module: File name of the module.
        torches: Power outputs that light a torch.
    """
    rows = []
    for number, task in enumerate(tasks):
        start, restart = ("tandem_wait", "tandem_wait") if number else ("tandem_again", "tandem_again")
        if torches:
            start, restart = ("tandem_wait", "tandem_stay") if number else ("tandem_begin", "tandem_again")
        routine_by_event = dict.fromkeys(_POWER_OFF_EVENTS, "tandem_off") | {
            "START": start,
            "RESTART": restart,
            "STEP": restart,
        }
        routine_by_event |= {"POWER_ON": "tandem_lost"} if torches else {}
        rows += [
            config_row(routine=routine, shelf=shelf, task=task) for shelf, routine in routine_by_event.items()
        ]
    loaded = config_row(file=f"HOME:/{module}", modname=POWER_MODULE, alltask="")
    return {"CAB_TASK_MODULES": [loaded], "CAB_EXEC_HOOKS": rows}


def system_module(
    controller: Controller, signals: Sequence[str], torches: frozenset[str], multiple_tasks: bool
) -> str:
    """Return the expected text of the system module TandemPower.

    A flag for each power output (tandem_cut_n, tandem_lit_n for torches) stores that it was on at a stop.
    tandem_off sets the flags and resets the requests. tandem_again asks about each flag at a start,
    tandem_wait waits until they are reset, and tandem_stay also ends the program after a torch burned. The
    other routines are in `_torch_routines`.

    Args:
        controller: Controllers of the cell.
        signals: Power outputs.
        torches: Those of them that light a torch.
        multiple_tasks: Whether the controller has several motion tasks.
    """
    signal_by_flag = {
        f"tandem_{'lit' if signal in torches else 'cut'}_{number}": signal
        for number, signal in enumerate(signals, 1)
    }
    torch_flags = [flag for flag, request in signal_by_flag.items() if request in torches]
    stop = "Stop\\AllMoveTasks" if multiple_tasks else "Stop"
    switch_off = "".join(
        f"IF DOutput({signal})=1 THEN {flag}:=TRUE; ENDIF SetDO {signal},0;"
        for flag, signal in signal_by_flag.items()
    )
    ends = "".join(f"IF {flag} THEN tandem_end; ENDIF " for flag in torch_flags)
    questions = ""
    for flag, request in signal_by_flag.items():
        if request in torches:
            continue
        questions += _question(
            flag, rapid_sentences.restart_question(request), rapid_sentences.RESTART_BUTTONS
        )
        output = controller.interlock.power_output(request).signal
        questions += f"ELSEIF answer=2 AND DOutput({output})=1 THEN {flag}:=FALSE; "
        questions += _refusal_branch(rapid_sentences.RESTART_REFUSED, stop)
    answer = "VAR num answer; "
    again_routine = f"PROC tandem_again() {answer if questions else ''}tandem_off; {ends}{questions}ENDPROC "
    waits = "".join(f"WaitUntil NOT {flag};" for flag in signal_by_flag)
    wait_routine = f"PROC tandem_wait() tandem_off; {waits} ENDPROC " if multiple_tasks else ""
    data = "".join(f"PERS bool {flag}:=FALSE;" for flag in signal_by_flag)
    torch_routines = (
        _torch_routines({flag: signal_by_flag[flag] for flag in torch_flags}, stop) if torch_flags else ""
    )
    stay_routine = (
        f"PROC tandem_stay() tandem_off; {ends} tandem_wait; ENDPROC "
        if torch_flags and multiple_tasks
        else ""
    )
    return (
        f"MODULE {POWER_MODULE}(SYSMODULE) {data} PROC tandem_off() {switch_off} ENDPROC "
        f"{torch_routines}{again_routine}{wait_routine}{stay_routine}ENDMODULE"
    )


def _torch_routines(signal_by_flag: Mapping[str, str], stop: str) -> str:
    """Return the routines for torches, whose outputs are ``signal_by_flag``.

    tandem_lost sets all flags after power-on, because a controller that was off saw no stop. tandem_end never
    lets the program continue. tandem_begin asks about each torch before a start from main.
    """
    set_on = "".join(f"{flag}:=TRUE;" for flag in signal_by_flag)
    shown = "".join(f'TPWrite "{line}";' for line in _TORCH_RESTART_REFUSED)
    questions = "".join(
        _question(
            flag, [line.format(signal=request) for line in _TORCH_RESTART_QUESTION], _TORCH_RESTART_BUTTONS
        )
        + _refusal_branch(_TORCH_RESTART_REFUSED, stop)
        for flag, request in signal_by_flag.items()
    )
    return (
        f"PROC tandem_lost() {set_on} tandem_off; ENDPROC "
        f"PROC tandem_end() WHILE TRUE DO {shown} {stop}; ENDWHILE ENDPROC "
        f"PROC tandem_begin() VAR num answer; tandem_off; {questions} tandem_again; ENDPROC "
    )


def _question(flag: str, lines: Iterable[str], buttons: Iterable[str]) -> str:
    """Return the start of a loop that asks while a flag is TRUE, up to the first answer, which resets it.

    `_refusal_branch` ends the loop.
    """
    line_list, button_list = (",".join(f'"{text}"' for text in texts) for texts in (lines, buttons))
    return (
        f'WHILE {flag} DO answer:=UIMessageBox(\\Header:="{sentences.HEADER}"\\MsgArray:=[{line_list}]'
        f"\\BtnArray:=[{button_list}]\\Icon:=iconWarning); IF answer=1 THEN {flag}:=FALSE; "
    )


def _refusal_branch(lines: Iterable[str], stop: str) -> str:
    """Return the end of the loop of `_question`: any other answer shows ``lines`` and stops."""
    shown = "".join(f'TPWrite "{line}";' for line in lines)
    return f"ELSE {shown} {stop}; ENDIF ENDWHILE "
