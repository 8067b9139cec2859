"""Which words of RAPID a Tandem program may use, and what arguments its instructions take.

Forms: ABB, Technical reference manual RAPID Instructions, Functions and Data types, 3HAC16581-1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

# every reserved word of the language, also those that are not in the subset: none may name anything
_RESERVED = (
    "alias and backward case connect const default div do else elseif endfor endfunc endif endmodule "
    "endproc endrecord endtest endtrap endwhile error exit false for from func goto if inout local mod "
    "module nostepin not noview or pers proc raise readonly record retry return step sysmodule task test "
    "then to trap true trynext undo var viewonly while with xor "
)
RESERVED = frozenset(_RESERVED.split())
ATTRIBUTES = frozenset({"sysmodule", "noview", "nostepin", "viewonly", "readonly"})


@dataclass(frozen=True)
class Form:
    """An instruction: official `name`, types of the required arguments, options as name -> (slot, type).

    Slot n means: behind the n-th required argument. Type "switch" takes no value. "signal..." types are
    names that the controller's configuration declares. "variable <type>" must be a VAR or PERS.
    """

    name: str
    required: tuple[str, ...] = ()
    options: dict[str, tuple[int, str]] = field(default_factory=dict)


def _move(name: str, target: str, extra: dict[str, tuple[int, str]]) -> Form:
    options: dict[str, tuple[int, str]] = {
        "conc": (0, "switch"),
        "id": (1, "num"),
        "v": (2, "num"),
        "t": (2, "num"),
        "z": (3, "num"),
        "wobj": (4, "wobjdata"),
        "tload": (4, "loaddata"),
    }
    return Form(name, (target, "speeddata", "zonedata", "tooldata"), options | extra)


_LINES: dict[str, tuple[int, str]] = {f"msgline{n}": (1, "string") for n in range(2, 6)}
_BOX = {"header": (0, "string"), **_LINES, "wrap": (1, "switch"), "buttons": (1, "num"), "icon": (1, "num")}
_BOX |= {"result": (1, "variable num"), "maxtime": (1, "num")}

_FORMS = (
    _move("MoveAbsJ", "jointtarget", {"noeoffs": (1, "switch")}),
    _move("MoveJ", "robtarget", {}),
    _move("MoveL", "robtarget", {"corr": (4, "switch")}),
    Form("SetDO", ("signaldo", "num"), {"sdelay": (0, "num"), "sync": (0, "switch")}),
    Form("Set", ("signaldo",)),
    Form("Reset", ("signaldo",)),
    Form("WaitTime", ("num",), {"inpos": (0, "switch")}),
    Form("WaitRob", (), {"inpos": (0, "switch"), "zerospeed": (0, "switch")}),
    Form("WaitDI", ("signaldi", "num"), {"maxtime": (2, "num"), "timeflag": (2, "variable bool")}),
    Form("TPErase"),
    Form(
        "TPWrite",
        ("string",),
        {"num": (1, "num"), "bool": (1, "bool"), "pos": (1, "pos"), "orient": (1, "orient")},
    ),
    Form("UIMsgBox", ("string",), _BOX),
    Form("TPReadFK", ("variable num", *("string",) * 6), {"maxtime": (7, "num")}),
    Form("WaitSyncTask", ("syncident", "tasks"), {"inpos": (0, "switch"), "timeout": (2, "num")}),
    Form("SyncMoveOn", ("syncident", "tasks"), {"timeout": (2, "num")}),
    Form("SyncMoveOff", ("syncident",), {"timeout": (1, "num")}),
    Form("SyncMoveUndo"),
    Form("StopMove", (), {"quick": (0, "switch"), "allmotiontasks": (0, "switch")}),
    Form("StartMove", (), {"allmotiontasks": (0, "switch")}),
    Form("ClearPath"),
    Form("StorePath", (), {"keepsync": (0, "switch")}),
    Form("RestoPath"),
    Form("ConfL", (), {"on": (0, "switch"), "off": (0, "switch")}),
    Form("ConfJ", (), {"on": (0, "switch"), "off": (0, "switch")}),
    Form("SingArea", (), {"off": (0, "switch"), "wrist": (0, "switch")}),
    Form("AccSet", ("num", "num")),
    Form("VelSet", ("num", "num")),
    Form("GripLoad", ("loaddata",)),
    Form("ClkReset", ("clock",)),
    Form("ClkStart", ("clock",)),
    Form("ClkStop", ("clock",)),
    Form("Load", ("string",), {"dynamic": (0, "switch"), "file": (1, "string"), "checkref": (1, "switch")}),
    Form(
        "UnLoad", ("string",), {"errifchanged": (0, "switch"), "save": (0, "switch"), "file": (1, "string")}
    ),
    Form("Stop", (), {"noregain": (0, "switch"), "allmovetasks": (0, "switch")}),
    Form(
        "ErrWrite",
        ("string", "string"),
        {f"rl{n}": (2, "string") for n in range(2, 5)} | {"w": (0, "switch")},
    ),
    # statements of one word; the parser reads them the same way
    Form("EXIT"),
    Form("RETURN"),
    Form("RAISE"),
    Form("RETRY"),
    Form("TRYNEXT"),
)
FORMS: dict[str, Form] = {form.name.lower(): form for form in _FORMS}
MOVES = frozenset({"moveabsj", "movej", "movel"})
IN_HANDLER_ONLY = frozenset({"retry", "trynext"})
EXCLUSIVE = (
    ("v", "t"),
    ("on", "off"),
    ("off", "wrist"),
    ("sdelay", "sync"),
    ("conc", "id"),
    ("errifchanged", "save"),
)

# functions: types of the arguments and of the result
FUNCTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "issyncmoveon": ((), "bool"),
    "clkread": (("clock",), "num"),
    "numtostr": (("num", "num"), "string"),
    "doutput": (("signaldo",), "num"),
    "dinput": (("signaldi",), "num"),
    "testdi": (("signaldi",), "bool"),
    "gettaskname": ((), "string"),
    "ctime": ((), "string"),
    "cdate": ((), "string"),
    "abs": (("num",), "num"),
}
