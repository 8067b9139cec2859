"""What the programs need of a KUKA controller, against its own files where the share or folder has them.

`$config.dat` (R1/System) has TOOL_DATA, BASE_DATA and LOAD_DATA with their names in TOOL_NAME[n,], BASE_NAME
and LOAD_NAME; `$machine.dat` (R1/Mada) has $ROBROOT. Places and form are as public archives of KRC2 and KRC4
have them; no controller was there. Our programs bring their own frames under their own names, so a tool of
the same name must be the same, and one of another name says nothing.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, from_rpy
from planner.issues import Issue, TandemError
from planner.problem import Arm
from planner.programs import text as program_text
from planner.shopfloor.loading.compare import BASE_SHIFT, BASE_TURN, Found, unread
from planner.shopfloor.loading.literals import difference, turn_deg
from planner.shopfloor.loading.pieces import kind
from planner.shopfloor.loading.store import Store

ROOTS: Final = ("", "R1", "KRC/R1", "KRC/ROBOTER/KRC/R1", "..", "../..")
"""Where R1 may be, as the folder that was given sees it."""
FILES: Final = {"$config.dat": "System", "$machine.dat": "Mada"}
"""Files that are looked for, and their folder in R1."""
NOT_THERE: Final = (
    "mode, version and model of the controller, inputs and outputs: a folder tells none of them"
)
"""What no file is read for."""
_RIDDEN: Final = (
    "base frame and track: on a track $ROBROOT counts for nothing; the program itself looks at $ROBROOT_C"
)
"""Why the foot of an arm on a track is not compared."""
_FRAME: Final = re.compile(r"\b([XYZABC])\s+([-+]?[\d.]+(?:[eE][-+]?\d+)?)")
_ENTRY: Final = re.compile(
    r"^\s*(TOOL|BASE|LOAD)_(DATA|NAME)\[(\d+),?\]\s*=\s*(\{.*\}|\"[^\"]*\")", re.I | re.M
)
_ROOT: Final = re.compile(r"^\s*(?:DECL\s+)?(?:FRAME\s+)?\$ROBROOT\s*=\s*(\{[^}]*\})", re.I | re.M)
_OWN: Final = re.compile(r"^\s*DECL\s+(FRAME|LOAD)\s+([tbl]_\w+)\s*=\s*(\{.*\})", re.I | re.M)
"""Our tools, bases and loads, by the letter that their names begin with."""
_TABLES: Final = {"t": "TOOL", "b": "BASE", "l": "LOAD"}


def compare(store: Store, files: Mapping[str, bytes], arms: Sequence[Arm]) -> Found:
    """Foot, tools, bases and loads of a KUKA arm's program ``files`` against the files that are there; all
    else is named as not looked at. Raises ``TandemError`` (``upload.controller``) where the folder cannot be
    read."""
    if not any(arm.data.family == "KUKA" for arm in arms):
        what = "base frame, tools, signals, options and mode of the controller: a folder tells none of them"
        return Found((), (unread(what),), ())
    out, lost, agreed = list[Issue](), [NOT_THERE], list[str]()
    machine, config = (_found(store, name) for name in ("$machine.dat", "$config.dat"))
    texts = [program_text.decode(content, name) for name, content in files.items() if kind(name) == "krl"]
    fault = _RIDDEN if any("$ROBROOT_C" in text for text in texts) else _foot(machine)
    if fault is None:
        agreed.append("$ROBROOT")
    elif fault.startswith("$ROBROOT is"):
        out.append(Issue("upload.differs", fault, field="$ROBROOT"))
    else:
        lost.append(fault)
    own = [found.groups() for text in texts for found in _OWN.finditer(text)]
    if config is None:
        lost.append("tools, bases and loads: no $config.dat in R1/System there")
    else:
        for word, name, value in own:
            told, same = _datum(config, word.upper(), name, value)
            if same:
                agreed.append(told)
            elif told.startswith("!"):
                out.append(Issue("upload.differs", told[1:], field=name))
            else:
                lost.append(told)
    return Found(tuple(out), tuple(unread(what) for what in lost), tuple(agreed))


def _found(store: Store, name: str) -> str | None:
    """The text of one of ``FILES``, whatever the case of its name and its folders' is."""
    for root in ROOTS:
        path: str | None = ""
        for step in (*root.split("/"), FILES[name], name):
            if not step or path is None:
                continue
            if step == "..":
                path = f"{path}/..".lstrip("/")
                continue
            there = _listing(store, path)
            real = next((one for one in there if one.lower() == step.lower()), None)
            path = None if real is None else f"{path}/{real}".lstrip("/")
        content = store.read(path) if path else None
        if content is not None:
            return program_text.decode(content, name)
    return None


def _listing(store: Store, path: str) -> dict[str, bool]:
    """What is in a folder; nothing where it is above the one that was given and closed to us."""
    try:
        return store.listing(path) or {}
    except TandemError:
        if not path.startswith(".."):
            raise
        return {}


def _foot(machine: str | None) -> str | None:
    """What is wrong with $ROBROOT, which the programs want at zero; None if nothing."""
    if machine is None:
        return "base frame ($ROBROOT): no $machine.dat in R1/Mada there"
    found = _ROOT.search(machine)
    pose = None if found is None else _pose(found.group(1))
    if found is None or pose is None:
        return "base frame: $machine.dat states no $ROBROOT that can be read"
    shift = float(np.linalg.norm(pose[:3, 3]))
    turn = turn_deg(pose[:3, :3], np.eye(3))
    if shift <= BASE_SHIFT and turn <= BASE_TURN:
        return None
    return f"$ROBROOT is off zero by {shift:.3f} mm, {turn:.4f} deg; the programs want it at zero"


def _pose(text: str) -> FloatArray | None:
    """A frame (4, 4) [mm] of its six components; angles A, B, C [deg] about z, y, x."""
    parts = {name.upper(): float(number) for name, number in _FRAME.findall(text.upper())}
    if parts.keys() != set("XYZABC"):
        return None
    return from_rpy([parts[k] for k in "XYZ"], np.deg2rad([parts[k] for k in "CBA"]))


def _datum(config: str, word: str, name: str, value: str) -> tuple[str, bool]:
    """What is to be said of one of our data, beginning with ! where it differs; whether it agrees."""
    table = _TABLES[name[0].lower()]
    entries: dict[str, dict[int, str]] = {"DATA": {}, "NAME": {}}
    for kind_, column, number, text in _ENTRY.findall(config):
        if kind_.upper() == table:
            entries[column.upper()][int(number)] = text.strip('"')
    plain = name[2:].lower()
    named = [k for k, text in entries["NAME"].items() if text.strip().lower() in (name.lower(), plain)]
    for number in named:
        there = entries["DATA"].get(number)
        if there is None:
            return f"{name}: {table}_NAME[{number},] has its name, and no {table}_DATA has its value", False
        far = _off(value, there) if word == "FRAME" else difference(value, there)
        if far is not None:
            return f"!{name}: {table}_DATA[{number}] of that name is another one: {far}", False
    if named:
        return f"{name} ({table}_DATA[{', '.join(map(str, named))}])", True
    same = [k for k, text in entries["DATA"].items() if word == "FRAME" and _off(value, text) is None]
    if same:
        return f"{name} ({table}_DATA[{same[0]}] by value)", True
    return f"{name}: no {table}_DATA has that name or value; the program brings its own", False


def _off(planned: str, there: str) -> str | None:
    """How far a frame is off the planned one, None where it is the same as printed."""
    a, b = _pose(planned), _pose(there)
    if a is None or b is None:
        return difference(planned, there)
    shift, turn = float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])
    return None if shift <= 1e-3 and turn <= 1e-3 else f"off by {shift:.3f} mm, {turn:.3f} deg"
