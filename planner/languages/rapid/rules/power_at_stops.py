"""What files for controllers have to do with power at stops and starts: the texts that are wanted.

A wire or a tool may be set on again by hand, and then a person says so. A torch never: where it burned at a
stop no program goes on, nothing asks whether it is on, nobody sets its request by hand, and only a program
that begins anew leads out. The words of that are the proof's own, those of other power have one wording.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from planner.claims import sentences
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.reader.configuration import Row
from planner.problem import Controller

POWER_MODULE: Final = "TandemPower"
"""Name of the module that switches outputs off and on at stops."""
_OFF: Final = ("STOP", "QSTOP", "RESET")
"""System events at which requests are taken back."""
_BEGUN_WORDS: Final = (
    "{signal} burned at the stop,",
    "or the controller was off since.",
    "Begin: PP is at main, the torch was moved out by hand,",
    "and the sheet has no slot of this program yet.",
    "Stop: else. Then plan anew what is left to cut.",
)
"""The question before a program begins anew behind a stop at which a torch burned."""
_BEGUN_BUTTONS: Final = ("Begin", "Stop")
"""Its answers: none of them says that the torch burns."""
_ENDED_WORDS: Final = (
    "Not started: a torch burned at the stop",
    "or the controller was off. Move it out",
    "by hand, look at the sheet, then PP to",
    "main in all tasks, and Start.",
)
"""Told where it would go on."""


def config_row(**values: str) -> Row:
    """A row of a configuration file, by its fields."""
    return frozenset(values.items())


def requests(signals: Sequence[str], lit: frozenset[str]) -> list[Row]:
    """The rows of requests, on no device: the program and a person set those of tools and wires, the program
    alone those of torches."""
    return [
        config_row(name=name, signaltype="DO", access="TandemTorch" if name in lit else "TandemRequest")
        for name in signals
    ]


def access(signals: Sequence[str], lit: frozenset[str]) -> list[Row]:
    """Who may set them."""
    both = config_row(name="TandemRequest", rapid="", localmanual="", localauto="")
    return [both] * bool(set(signals) - lit) + [config_row(name="TandemTorch", rapid="")] * bool(lit)


def hooks(tasks: Sequence[str], module: str, lit: frozenset[str]) -> dict[str, list[Row]]:
    """The module in every task, and what each task runs at each system event."""
    wanted = []
    for number, task in enumerate(tasks):
        start, on = ("tandem_wait", "tandem_wait") if number else ("tandem_again", "tandem_again")
        if lit:
            start, on = ("tandem_wait", "tandem_stay") if number else ("tandem_begin", "tandem_again")
        at = dict.fromkeys(_OFF, "tandem_off") | {"START": start, "RESTART": on, "STEP": on}
        at |= {"POWER_ON": "tandem_lost"} if lit else {}
        wanted += [config_row(routine=routine, shelf=shelf, task=task) for shelf, routine in at.items()]
    loaded = config_row(file=f"HOME:/{module}", modname=POWER_MODULE, alltask="")
    return {"CAB_TASK_MODULES": [loaded], "CAB_EXEC_HOOKS": wanted}


def routines(controller: Controller, signals: Sequence[str], lit: frozenset[str], together: bool) -> str:
    """The system module as it has to be."""
    kept = {f"tandem_{'lit' if s in lit else 'cut'}_{n}": s for n, s in enumerate(signals, 1)}
    burned = [flag for flag, request in kept.items() if request in lit]
    stop = "Stop\\AllMoveTasks" if together else "Stop"
    off = "".join(f"IF DOutput({s})=1 THEN {flag}:=TRUE; ENDIF SetDO {s},0;" for flag, s in kept.items())
    ends = "".join(f"IF {flag} THEN tandem_end; ENDIF " for flag in burned)
    asked = ""
    for flag, request in kept.items():
        if request in lit:
            continue
        asked += _question(flag, rapid_sentences.again(request), rapid_sentences.BUTTONS)
        real = controller.interlock.of(request).signal
        asked += f"ELSEIF answer=2 AND DOutput({real})=1 THEN {flag}:=FALSE; "
        asked += _else(rapid_sentences.REFUSED, stop)
    answer = "VAR num answer; "
    anew = f"PROC tandem_again() {answer if asked else ''}tandem_off; {ends}{asked}ENDPROC "
    waits = "".join(f"WaitUntil NOT {flag};" for flag in kept)
    wait = f"PROC tandem_wait() tandem_off; {waits} ENDPROC " if together else ""
    data = "".join(f"PERS bool {flag}:=FALSE;" for flag in kept)
    before = _torch_routines({flag: kept[flag] for flag in burned}, stop) if burned else ""
    stay = f"PROC tandem_stay() tandem_off; {ends} tandem_wait; ENDPROC " if burned and together else ""
    return (
        f"MODULE {POWER_MODULE}(SYSMODULE) {data} PROC tandem_off() {off} ENDPROC "
        f"{before}{anew}{wait}{stay}ENDMODULE"
    )


def _torch_routines(burned: Mapping[str, str], stop: str) -> str:
    """Lost: a controller that was off saw no stop. End: nothing leads out. Begin: asks, and takes back."""
    set_on = "".join(f"{flag}:=TRUE;" for flag in burned)
    told = "".join(f'TPWrite "{line}";' for line in _ENDED_WORDS)
    asked = "".join(
        _question(flag, [line.format(signal=request) for line in _BEGUN_WORDS], _BEGUN_BUTTONS)
        + _else(_ENDED_WORDS, stop)
        for flag, request in burned.items()
    )
    return (
        f"PROC tandem_lost() {set_on} tandem_off; ENDPROC "
        f"PROC tandem_end() WHILE TRUE DO {told} {stop}; ENDWHILE ENDPROC "
        f"PROC tandem_begin() VAR num answer; tandem_off; {asked} tandem_again; ENDPROC "
    )


def _question(flag: str, lines: Iterable[str], buttons: Iterable[str]) -> str:
    told, words = (",".join(f'"{one}"' for one in many) for many in (lines, buttons))
    return (
        f'WHILE {flag} DO answer:=UIMessageBox(\\Header:="{sentences.HEADER}"\\MsgArray:=[{told}]'
        f"\\BtnArray:=[{words}]\\Icon:=iconWarning); IF answer=1 THEN {flag}:=FALSE; "
    )


def _else(lines: Iterable[str], stop: str) -> str:
    told = "".join(f'TPWrite "{line}";' for line in lines)
    return f"ELSE {told} {stop}; ENDIF ENDWHILE "
