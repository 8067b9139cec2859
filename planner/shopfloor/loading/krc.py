"""Comparison of what programs require of a KUKA controller with the controller's own files.

The files are compared if the share or folder that programs are sent to contains them.

`$config.dat` (R1/System) has TOOL_DATA, BASE_DATA and LOAD_DATA with their names in TOOL_NAME[n,], BASE_NAME
and LOAD_NAME. `$machine.dat` (R1/Mada) has $ROBROOT. Paths and format follow public archives of KRC2 and
KRC4; they have not been tested on a controller. Tandem's programs define their own frames under their own
names. So a tool of the same name must be equal, and other tools are irrelevant.
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
"""What no file states, so that it is not compared."""
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
    """Compare the data of KUKA programs with the files $machine.dat and $config.dat of the controller.

    Compared are the base of the robot ($ROBROOT), tools, bases and loads. Everything else is reported as not
    compared. ``files`` has the contents of the program files by name.

    Raises:
        TandemError: ``upload.controller`` if the folder cannot be read.
    """
    if not any(arm.data.family == "KUKA" for arm in arms):
        what = "base frame, tools, signals, options and mode of the controller: a folder contains none"
        return ComparisonResult((), (unread(what),), ())
    differs: list[Issue] = []
    not_compared = [NOT_THERE]
    agreed: list[str] = []
    machine, config = (_read_file(store, name) for name in ("$machine.dat", "$config.dat"))
    texts = [program_text.decode(content, name) for name, content in files.items() if kind(name) == "krl"]
    fault = _BASE_ON_TRACK if any("$ROBROOT_C" in text for text in texts) else _robroot_fault(machine)
    if fault is None:
        agreed.append("$ROBROOT")
    elif fault.startswith("$ROBROOT is"):  # a difference; other texts say why it was not compared
        differs.append(Issue("upload.differs", fault, field="$ROBROOT"))
    else:
        not_compared.append(fault)
    program_data = [match.groups() for text in texts for match in _PROGRAM_DATUM.finditer(text)]
    if config is None:
        not_compared.append("tools, bases and loads: R1/System has no $config.dat")
    else:
        for word, name, value in program_data:
            compared, same = _datum(config, word.upper(), name, value)
            if same:
                agreed.append(compared)
            elif compared.startswith("!"):
                differs.append(Issue("upload.differs", compared[1:], field=name))
            else:
                not_compared.append(compared)
    return ComparisonResult(tuple(differs), tuple(unread(what) for what in not_compared), tuple(agreed))


def _read_file(store: Store, name: str) -> str | None:
    """Return the text of one of ``FILES``, whatever the case of its name and folders, or None."""
    for root in ROOTS:
        path: str | None = ""
        for step in (*root.split("/"), FILES[name], name):
            if not step or path is None:
                continue
            if step == "..":
                path = f"{path}/..".lstrip("/")
                continue
            listing = _listing(store, path)
            entry = next((entry for entry in listing if entry.lower() == step.lower()), None)
            path = None if entry is None else f"{path}/{entry}".lstrip("/")
        content = store.read(path) if path else None
        if content is not None:
            return program_text.decode(content, name)
    return None


def _listing(store: Store, path: str) -> dict[str, bool]:
    """Return the entries of a folder; none if it is above the store's folder and not accessible."""
    try:
        return store.listing(path) or {}
    except TandemError:
        if not path.startswith(".."):
            raise
        return {}


def _robroot_fault(machine: str | None) -> str | None:
    """Return what is wrong with $ROBROOT in $machine.dat; None if it is zero, as programs require."""
    if machine is None:
        return "base frame ($ROBROOT): R1/Mada has no $machine.dat"
    match = _ROOT.search(machine)
    pose = None if match is None else _pose(match.group(1))
    if match is None or pose is None:
        return "base frame: $machine.dat has no readable $ROBROOT"
    shift = float(np.linalg.norm(pose[:3, 3]))
    angle = turn_deg(pose[:3, :3], np.eye(3))
    if shift <= BASE_SHIFT and angle <= BASE_TURN:
        return None
    return f"$ROBROOT is off zero by {shift:.3f} mm, {angle:.4f} deg; the programs require zero"


def _pose(text: str) -> FloatArray | None:
    """Return a frame (4, 4) [mm] from its components, with A, B, C [deg] about z, y, x, or None."""
    components = {name.upper(): float(number) for name, number in _FRAME.findall(text.upper())}
    if components.keys() != set("XYZABC"):
        return None
    return from_rpy([components[axis] for axis in "XYZ"], np.deg2rad([components[axis] for axis in "CBA"]))


def _datum(config: str, word: str, name: str, value: str) -> tuple[str, bool]:
    """Compare a datum of the programs with the text of $config.dat.

    ``word`` is its type, FRAME or LOAD. The first letter of its ``name`` selects the table of the controller.
    The entry is found by its name, or for a FRAME without such a name by its value.

    Returns:
        A description of the comparison, and whether the datum agrees. If it differs, the description begins
        with ``!``. Otherwise a datum that does not agree has nothing to be compared with.
    """
    table = _TABLES[name[0].lower()]
    entries: dict[str, dict[int, str]] = {"DATA": {}, "NAME": {}}
    for kind_, column, number, text in _ENTRY.findall(config):
        if kind_.upper() == table:
            entries[column.upper()][int(number)] = text.strip('"')
    short_name = name[2:].lower()  # without the letter of the table and the character after it
    named = [k for k, text in entries["NAME"].items() if text.strip().lower() in (name.lower(), short_name)]
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
    same_value = [
        k for k, text in entries["DATA"].items() if word == "FRAME" and _value_difference(value, text) is None
    ]
    if same_value:
        return f"{name} ({table}_DATA[{same_value[0]}] by value)", True
    return f"{name}: no {table}_DATA has that name or value; the program defines it", False


def _value_difference(planned: str, actual: str) -> str | None:
    """Return how a frame differs from the planned one; None if by at most 0.001 mm and 0.001 deg."""
    a, b = _pose(planned), _pose(actual)
    if a is None or b is None:
        return difference(planned, actual)
    shift, angle = float(np.linalg.norm(a[:3, 3] - b[:3, 3])), turn_deg(a[:3, :3], b[:3, :3])
    return None if shift <= 1e-3 and angle <= 1e-3 else f"off by {shift:.3f} mm, {angle:.3f} deg"
