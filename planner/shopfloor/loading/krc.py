"""Comparison of what the programs need of a KUKA controller with its own files.

It is made where a share or folder has these files.

`$config.dat` (R1/System) has TOOL_DATA, BASE_DATA and LOAD_DATA with their names in TOOL_NAME[n,], BASE_NAME
and LOAD_NAME. `$machine.dat` (R1/Mada) has $ROBROOT. Paths and format follow public archives of KRC2 and
KRC4; they have not been tested on a controller. Tandem's programs bring their own frames under their own
names. A tool of the same name must therefore be equal, and one of another name means nothing.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, from_rpy
from planner.issues import Issue, TandemError
from planner.problem import Arm
from planner.programs import text as program_text
from planner.shopfloor.loading.compare import BASE_SHIFT, BASE_TURN, ComparisonResult, unread
from planner.shopfloor.loading.literals import difference, turn_deg
from planner.shopfloor.loading.pieces import kind
from planner.shopfloor.loading.store import Store

ROOTS: Final = ("", "R1", "KRC/R1", "KRC/ROBOTER/KRC/R1", "..", "../..")
"""Possible paths of R1, relative to the given folder."""
FILES: Final = {"$config.dat": "System", "$machine.dat": "Mada"}
"""Files that are searched, and their folder in R1."""
NOT_THERE: Final = "mode, version and model of the controller, inputs and outputs: a folder contains none"
"""Data for which no file is read."""
_BASE_ON_TRACK: Final = (
    "base frame and track: on a track $ROBROOT has no effect; the program itself checks $ROBROOT_C"
)
"""Why the base of an arm on a track is not compared."""
_FRAME: Final = re.compile(r"\b([XYZABC])\s+([-+]?[\d.]+(?:[eE][-+]?\d+)?)")
_ENTRY: Final = re.compile(
    r"^\s*(TOOL|BASE|LOAD)_(DATA|NAME)\[(\d+),?\]\s*=\s*(\{.*\}|\"[^\"]*\")", re.I | re.M
)
_ROOT: Final = re.compile(r"^\s*(?:DECL\s+)?(?:FRAME\s+)?\$ROBROOT\s*=\s*(\{[^}]*\})", re.I | re.M)
_PROGRAM_DATUM: Final = re.compile(r"^\s*DECL\s+(FRAME|LOAD)\s+([tbl]_\w+)\s*=\s*(\{.*\})", re.I | re.M)
"""Tandem's tools, bases and loads, by the first letter of their names."""
_TABLES: Final = {"t": "TOOL", "b": "BASE", "l": "LOAD"}


def compare(store: Store, files: Mapping[str, bytes], arms: Sequence[Arm]) -> ComparisonResult:
    """Compare the data of a KUKA arm's program ``files`` with the files of the controller.

    These are base, tools, bases and loads. Everything else is reported as not compared.

    Raises:
        TandemError: ``upload.controller`` if the folder cannot be read.
    """
    if not any(arm.data.family == "KUKA" for arm in arms):
        what = "base frame, tools, signals, options and mode of the controller: a folder contains none"
        return ComparisonResult((), (unread(what),), ())
    out, lost, agreed = list[Issue](), [NOT_THERE], list[str]()
    machine, config = (_read_file(store, name) for name in ("$machine.dat", "$config.dat"))
    texts = [program_text.decode(content, name) for name, content in files.items() if kind(name) == "krl"]
    fault = _BASE_ON_TRACK if any("$ROBROOT_C" in text for text in texts) else _foot(machine)
    if fault is None:
        agreed.append("$ROBROOT")
    elif fault.startswith("$ROBROOT is"):
        out.append(Issue("upload.differs", fault, field="$ROBROOT"))
    else:
        lost.append(fault)
    program_data = [match_text.groups() for text in texts for match_text in _PROGRAM_DATUM.finditer(text)]
    if config is None:
        lost.append("tools, bases and loads: R1/System has no $config.dat")
    else:
        for word, name, value in program_data:
            compared, same = _datum(config, word.upper(), name, value)
            if same:
                agreed.append(compared)
            elif compared.startswith("!"):
                out.append(Issue("upload.differs", compared[1:], field=name))
            else:
                lost.append(compared)
    return ComparisonResult(tuple(out), tuple(unread(what) for what in lost), tuple(agreed))


def _read_file(store: Store, name: str) -> str | None:
    """Text of one of ``FILES``; the case of its name and folders is ignored."""
    for root in ROOTS:
        path: str | None = ""
        for step in (*root.split("/"), FILES[name], name):
            if not step or path is None:
                continue
            if step == "..":
                path = f"{path}/..".lstrip("/")
                continue
            listing = _listing(store, path)
            real = next((one for one in listing if one.lower() == step.lower()), None)
            path = None if real is None else f"{path}/{real}".lstrip("/")
        content = store.read(path) if path else None
        if content is not None:
            return program_text.decode(content, name)
    return None


def _listing(store: Store, path: str) -> dict[str, bool]:
    """Content of a folder; empty if it is above the given folder and not accessible."""
    try:
        return store.listing(path) or {}
    except TandemError:
        if not path.startswith(".."):
            raise
        return {}


def _foot(machine: str | None) -> str | None:
    """Fault of $ROBROOT, which the programs require at zero; None if there is none."""
    if machine is None:
        return "base frame ($ROBROOT): R1/Mada has no $machine.dat"
    match = _ROOT.search(machine)
    pose = None if match is None else _pose(match.group(1))
    if match is None or pose is None:
        return "base frame: $machine.dat has no readable $ROBROOT"
    shift = float(np.linalg.norm(pose[:3, 3]))
    turn = turn_deg(pose[:3, :3], np.eye(3))
    if shift <= BASE_SHIFT and turn <= BASE_TURN:
        return None
    return f"$ROBROOT is off zero by {shift:.3f} mm, {turn:.4f} deg; the programs require zero"


def _pose(text: str) -> FloatArray | None:
    """A frame (4, 4) [mm] from its six components; angles A, B, C [deg] about z, y, x."""
    parts = {name.upper(): float(number) for name, number in _FRAME.findall(text.upper())}
    if parts.keys() != set("XYZABC"):
        return None
    return from_rpy([parts[k] for k in "XYZ"], np.deg2rad([parts[k] for k in "CBA"]))


def _datum(config: str, word: str, name: str, value: str) -> tuple[str, bool]:
    """Text about one of Tandem's data, beginning with ! if it differs; and whether it agrees."""
    table = _TABLES[name[0].lower()]
    entries: dict[str, dict[int, str]] = {"DATA": {}, "NAME": {}}
    for kind_, column, number, text in _ENTRY.findall(config):
        if kind_.upper() == table:
            entries[column.upper()][int(number)] = text.strip('"')
    plain = name[2:].lower()
    named = [k for k, text in entries["NAME"].items() if text.strip().lower() in (name.lower(), plain)]
    for number in named:
        stored_value = entries["DATA"].get(number)
        if stored_value is None:
            return f"{name}: {table}_NAME[{number},] has its name, but no {table}_DATA has its value", False
        difference_text = (
            _value_difference(value, stored_value) if word == "FRAME" else difference(value, stored_value)
        )
        if difference_text is not None:
            return f"!{name}: {table}_DATA[{number}] of that name differs: {difference_text}", False
    if named:
        return f"{name} ({table}_DATA[{', '.join(map(str, named))}])", True
    same = [
        k for k, text in entries["DATA"].items() if word == "FRAME" and _value_difference(value, text) is None
    ]
    if same:
        return f"{name} ({table}_DATA[{same[0]}] by value)", True
    return f"{name}: no {table}_DATA has that name or value; the program defines it", False


def _value_difference(planned: str, actual: str) -> str | None:
    """Return the deviation of a frame from the planned one; None if both print equally."""
    a, b = _pose(planned), _pose(actual)
    if a is None or b is None:
        return difference(planned, actual)
    shift, turn = float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])
    return None if shift <= 1e-3 and turn <= 1e-3 else f"off by {shift:.3f} mm, {turn:.3f} deg"
