"""Syntax tree of a RAPID module, and RAPID's data records, as frozen values.

Every node knows its offset in the text or its line. This file also defines the types of the components of
each record, the predefined data, and the conversion from numbers to the values of
:mod:`planner.programs.steps` in SI units.
Order of the components, units (mm, degrees, s, kg) and values of the predefined speeds and zones: ABB,
Technical reference manual RAPID Instructions, Functions and Data types, 3HAC16581-1 (robtarget, speeddata,
zonedata...).
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.geometry.arrays import FloatArray, read_only
from planner.programs import steps

QUATERNION_TOLERANCE = 1e-5
"""Maximum deviation of the norm of a quaternion from 1."""


@dataclass(frozen=True, slots=True)
class SyncIdent:
    """A synchronisation point. Tasks meet at points of equal name."""

    name: str


Value = Any
"""Value of RAPID data.

It is a bool, float or str, a SyncIdent, a record as a class of :mod:`planner.programs.steps`, a NumPy array
(pos, orient, pose), or for a RAPID array the tuple of the values of its elements.
"""

RECORDS: dict[str, tuple[str, ...]] = {
    "pos": ("num",) * 3,
    "orient": ("num",) * 4,
    "pose": ("pos", "orient"),
    "confdata": ("num",) * 4,
    "robjoint": ("num",) * 6,
    "extjoint": ("num",) * 6,
    "robtarget": ("pos", "orient", "confdata", "extjoint"),
    "jointtarget": ("robjoint", "extjoint"),
    "loaddata": ("num", "pos", "orient", "num", "num", "num"),
    "tooldata": ("bool", "pose", "loaddata"),
    "wobjdata": ("bool", "bool", "string", "pose", "pose"),
    "speeddata": ("num",) * 4,
    "zonedata": ("bool", *("num",) * 6),
    "tasks": ("string",),
}
"""Types of the components of each record, in order."""
NUMBER_TYPES = frozenset({"num", "btnres", "buttondata", "icondata", "errnum", "dionum"})
"""Types whose values are numbers."""
OPAQUE_TYPES = frozenset({"syncident", "clock", "signaldo", "signaldi"})
"""Types whose values are not visible to a program."""
ALL_TYPES = frozenset(RECORDS) | NUMBER_TYPES | OPAQUE_TYPES | {"bool", "string"}
"""All supported types."""


class RapidValueError(Exception):
    """A value does not fit its type.

    Attributes:
        code: Issue code for a `Fault`.
        message: What is wrong.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message


def base_type(name: str) -> str:
    """Return the type by which types are compared: num for its aliases, else the type itself."""
    return "num" if name in NUMBER_TYPES else name


def build_value(kind: str, items: Any) -> Value:
    """Convert the components of a value as written to the value in SI units.

    Numbers in records are rounded to single precision, as the controller holds them.

    Args:
        kind: The RAPID type.
        items: Nested lists of numbers, truth values and strings in file units (mm, degrees).

    Raises:
        RapidValueError: Count, type, norm or range is wrong.
    """
    if kind == "robtarget":  # fast path for the common case
        try:
            (x, y, z), (a, b, c, d), conf, external = items
            c1, c4, c6, cx = map(int, conf)
            configuration = (c1, c4, c6, cx)
            numbers = [x, y, z, a, b, c, d, *external]
            if (
                len(numbers) == 13
                and configuration == tuple(conf)
                and set(map(type, [*numbers, *conf])) <= {int, float}
            ):
                _require_unit_norm("robtarget.2", (a, b, c, d))
                if math.isfinite(sum(numbers)):  # no number is infinite or NaN
                    axes = _NO_AXES if external == _NO_AXIS_VALUES else np.array(external, dtype=float)
                    position, quaternion = steps.to_singles((x, y, z)) * 1e-3, steps.to_singles((a, b, c, d))
                    return steps.RobTarget(position, quaternion, _interned_configuration(configuration), axes)
        except (TypeError, ValueError, OverflowError):
            pass  # the components do not have the usual form; the general check reports what is wrong
    check_components(kind, items, kind)
    convert = _CONVERTERS.get(kind)
    return convert(items) if convert else items


_NO_AXIS_VALUES = [steps.UNUSED_AXIS] * 6
_NO_AXES = read_only(np.array(_NO_AXIS_VALUES))
"""The external axes of nearly all of tens of thousands of targets, shared to save memory."""


@functools.lru_cache(maxsize=256)
def _interned_configuration(configuration: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """Return an equal tuple that an earlier target has, to save memory."""
    return configuration


def check_components(kind: str, items: Any, path: str) -> None:
    """Check that values have the components of a type.

    Args:
        kind: The RAPID type.
        items: Nested lists of numbers, truth values and strings.
        path: Name of the value, for messages, such as "robtarget.2".

    Raises:
        RapidValueError: Count, type, norm or range is wrong.
    """
    if kind in RECORDS:
        parts = RECORDS[kind]
        if not isinstance(items, list | tuple):
            raise RapidValueError(
                "rapid.type", f"{path}: got {_kind(items)}; a {kind} has {len(parts)} components"
            )
        if len(items) != len(parts):
            raise RapidValueError(
                "rapid.arity", f"{path}: got {len(items)} components; a {kind} has {len(parts)}"
            )
        for number, (part, item) in enumerate(zip(parts, items, strict=True), 1):
            check_components(part, item, f"{path}.{number}")
        if kind == "orient":
            _require_unit_norm(path, items)
        if kind == "confdata" and any(value != int(value) for value in items):
            raise RapidValueError(
                "rapid.type", f"{path}: configuration numbers must be integers; got {list(items)}"
            )
        return
    expected = base_type(kind)
    if _kind(items) != expected:
        raise RapidValueError("rapid.type", f"{path}: got {_kind(items)}; expected {expected}")
    if expected == "num" and not abs(items) < steps.MAX_NUMBER:
        raise RapidValueError("rapid.number", f"{path}: {items} exceeds the numbers of a controller")


def _require_unit_norm(path: str, q: Any) -> None:
    norm = math.sqrt(sum(float(value) ** 2 for value in q))
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        allowed = f"1 within {QUATERNION_TOLERANCE:g}"
        raise RapidValueError(
            "rapid.quaternion", f"{path}: the quaternion's norm is {norm:.6g}; allowed: {allowed}"
        )


def _kind(item: Any) -> str:
    """Return the RAPID type of a parsed value, or a description for messages if it has none."""
    if isinstance(item, bool):
        return "bool"
    if isinstance(item, int | float):
        return "num"
    if isinstance(item, str):
        return "string"
    return "a list" if isinstance(item, list | tuple) else type(item).__name__.lower()


def _pos(items: Any) -> FloatArray:
    return steps.to_singles(items) * 1e-3


def _pose(items: Any) -> FloatArray:
    return steps.poses(_pos(items[0]), steps.to_singles(items[1]))


def _load(items: Any) -> steps.LoadData:
    return steps.LoadData(
        float(items[0]), _pos(items[1]), steps.to_singles(items[2]), np.array(items[3:], dtype=float)
    )


def _rob(items: Any) -> steps.RobTarget:
    c1, c4, c6, cx = (int(value) for value in items[2])
    return steps.RobTarget(
        _pos(items[0]), steps.to_singles(items[1]), (c1, c4, c6, cx), np.array(items[3], dtype=float)
    )


def _speed(items: Any) -> steps.MoveSpeed:
    tcp, reorientation, linear, rotary = map(steps.to_single, items)
    return steps.MoveSpeed(tcp * 1e-3, math.radians(reorientation), linear * 1e-3, math.radians(rotary))


def _zone(items: Any) -> steps.Zone:
    fine = items[0]
    tcp, reorientation, external, angle, linear, rotary = map(steps.to_single, items[1:])
    lengths = (tcp * 1e-3, reorientation * 1e-3, external * 1e-3)
    return steps.Zone(fine, *lengths, math.radians(angle), linear * 1e-3, math.radians(rotary))


_CONVERTERS: dict[str, Callable[[Any], Value]] = {
    "num": float,
    "pos": _pos,
    "orient": steps.to_singles,
    "pose": _pose,
    "robtarget": _rob,
    "jointtarget": lambda items: steps.JointTarget(
        np.radians(steps.to_singles(items[0])), np.array(items[1], dtype=float)
    ),
    "loaddata": _load,
    "tooldata": lambda items: steps.Tool(items[0], _pose(items[1]), _load(items[2])),
    "wobjdata": lambda items: steps.WorkObject(
        items[0], items[1], items[2], _pose(items[3]), _pose(items[4])
    ),
    "speeddata": _speed,
    "zonedata": _zone,
    "tasks": lambda items: items[0],
}
"""Converters from parsed data to a value, by type."""

_UNIT_POSE = [[0, 0, 0], [1, 0, 0, 0]]
"""The identity pose."""
_SPEEDS_MM_S = (
    "5 10 20 30 40 50 60 80 100 150 200 300 400 500 600 800 1000 1500 2000 2500 3000 4000 5000 6000 7000"
)
"""Predefined speeds of the TCP [mm/s]: v5 to v7000."""
_ZONES_MM = {
    0: (0.3, 0.3, 0.03),
    1: (1, 1, 0.1),
    5: (5, 8, 0.8),
    10: (10, 15, 1.5),
    15: (15, 23, 2.3),
    20: (20, 30, 3),
}
"""Predefined zones by their number.

Each has the radius of the TCP [mm], the radius of reorientation and external axes [mm], and the angle of
reorientation and rotary axes [deg].
"""
_ZONES_MM |= {30: (30, 45, 4.5), 40: (40, 60, 6), 50: (50, 75, 7.5), 60: (60, 90, 9), 80: (80, 120, 12)}
_ZONES_MM |= {100: (100, 150, 15), 150: (150, 225, 23), 200: (200, 300, 30)}


_NUMBERED = {
    "resunkwn resok resabort resretry resignore rescancel resyes resno": 0,
    "btnnone btnok btnabrtrtryign btnokcancel btnretrycancel btnyesno btnyesnocancel": -1,
    "iconnone iconinfo iconwarning iconerror": 0,
}
"""Answers, buttons and icons of message boxes, numbered consecutively from the stated first number."""
_ERRORS = "err_wait_maxtime err_path_stop err_robmove err_refunkprc err_filnotfnd err_ioenable"
"""Error numbers, whose values only the controller knows."""


def _predefined() -> dict[str, tuple[str, Value]]:
    """Build the table of predefined data. A value is None if only the controller knows it."""
    table: dict[str, tuple[str, Value]] = {
        f"v{v}": ("speeddata", build_value("speeddata", [v, 500, 5000, 1000]))
        for v in map(int, _SPEEDS_MM_S.split())
    }
    # vmax is the robot's own maximum TCP speed: the instruction sets no limit
    table["vmax"] = ("speeddata", steps.MoveSpeed(math.inf, math.radians(500), 5.0, math.radians(1000)))
    for number, (tcp, radius, angle) in _ZONES_MM.items():
        table[f"z{number}"] = (
            "zonedata",
            build_value("zonedata", [False, tcp, radius, radius, angle, radius, angle]),
        )
    table["fine"] = ("zonedata", build_value("zonedata", [True, 0, 0, 0, 0, 0, 0]))
    load = [0.001, [0, 0, 0.001], [1, 0, 0, 0], 0, 0, 0]
    table["load0"] = ("loaddata", build_value("loaddata", load))
    table["tool0"] = ("tooldata", build_value("tooldata", [True, _UNIT_POSE, load]))
    table["wobj0"] = ("wobjdata", build_value("wobjdata", [False, True, "", _UNIT_POSE, _UNIT_POSE]))
    for names, first_number in _NUMBERED.items():
        table |= {name: ("num", float(value)) for value, name in enumerate(names.split(), first_number)}
    table |= {"pi": ("num", 3.141592654), "high": ("num", 1.0), "low": ("num", 0.0), "edge": ("num", 2.0)}
    table |= {"stempty": ("string", ""), "diskhome": ("string", "HOME:"), "errno": ("num", None)}
    table |= dict.fromkeys(_ERRORS.split(), ("num", None))
    return table


PREDEFINED = _predefined()
"""Predefined data of RAPID: lower-case name -> (type, value)."""


# ---- expressions; `start` is the offset in the module's text -----------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Literal:
    """A literal value; `kind` is its RAPID type."""

    start: int
    kind: str
    value: Value


@dataclass(frozen=True, slots=True)
class Aggregate:
    """`[a, b, ...]`, whose type follows from the context."""

    start: int
    items: "tuple[Expr, ...]"


@dataclass(frozen=True, slots=True)
class Name:
    """A reference to data by its name; `text` is the name as written."""

    start: int
    text: str

    @property
    def key(self) -> str:
        """The name in lower case: RAPID ignores case."""
        return self.text.lower()


@dataclass(frozen=True, slots=True)
class Function:
    """A function call; `text` is the function's name as written."""

    start: int
    text: str
    arguments: "tuple[Expr, ...]"


@dataclass(frozen=True, slots=True)
class Unary:
    """`-x`, `+x` or `NOT x`; `operator` in lower case."""

    start: int
    operator: str
    operand: "Expr"


@dataclass(frozen=True, slots=True)
class Binary:
    """`left operator right`; `operator` in lower case."""

    start: int
    operator: str
    left: "Expr"
    right: "Expr"


Expr = Literal | Aggregate | Name | Function | Unary | Binary


# ---- statements --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class RapidStatement:
    """A statement.

    Attributes:
        line: Line, from 1.
        start: Offset of its first word.
    """

    line: int
    start: int


@dataclass(frozen=True, slots=True)
class MoveStatement(RapidStatement):
    """A move instruction: `kind` is MoveAbsJ, MoveJ or MoveL.

    Attributes:
        id: Option ID: number of a synchronised move.
        time: Option T [s].
        velocity: Option V [mm/s].
        wobj: Option WObj: the work object.
        switches: Options without value (conc, noeoffs, inpos...), in lower case.
    """

    kind: str
    target: Expr
    speed: Expr
    zone: Expr
    tool: Expr
    id: Expr | None = None
    time: Expr | None = None
    velocity: Expr | None = None
    wobj: Expr | None = None
    switches: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Instruction(RapidStatement):
    """Any other built-in instruction.

    Attributes:
        name: Official spelling.
        arguments: Required arguments.
        options: (lower-case name, value or None for a switch).
    """

    name: str
    arguments: tuple[Expr, ...] = ()
    options: tuple[tuple[str, Expr | None], ...] = ()


@dataclass(frozen=True, slots=True)
class Assign(RapidStatement):
    """An assignment: `target := value;`."""

    target: Name
    value: Expr


@dataclass(frozen=True, slots=True)
class ProcCall(RapidStatement):
    """A procedure call: `name;`."""

    name: str


@dataclass(frozen=True, slots=True)
class LateCall(RapidStatement):
    """A late-bound procedure call: `%"module:procedure"%;`."""

    name: Expr


@dataclass(frozen=True, slots=True)
class If(RapidStatement):
    """An IF statement.

    Attributes:
        branches: Condition and body of IF and of each ELSEIF.
        otherwise: Body of ELSE.
        source: Text of the condition of each branch.
    """

    branches: tuple[tuple[Expr, tuple[RapidStatement, ...]], ...]
    otherwise: tuple[RapidStatement, ...]
    source: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class While(RapidStatement):
    """A loop: `WHILE condition DO body ENDWHILE`; `source` is the text of the condition."""

    condition: Expr
    body: tuple[RapidStatement, ...]
    source: str


@dataclass(frozen=True, slots=True)
class For(RapidStatement):
    """A counted loop: `FOR name FROM first TO last [STEP step] DO body ENDFOR`."""

    name: str
    first: Expr
    last: Expr
    step: Expr | None
    body: tuple[RapidStatement, ...]


# ---- declarations ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class DataDeclaration:
    """A data declaration.

    Attributes:
        storage: CONST, VAR, PERS or TASK PERS.
        size: Size of an array, or None.
    """

    line: int
    start: int
    name: str
    kind: str
    storage: str
    local: bool
    size: int | None
    initial: Expr | None


@dataclass(frozen=True, slots=True)
class Procedure:
    """A procedure without parameters; `error` and `undo` are its handlers, None if missing."""

    line: int
    start: int
    name: str
    local: bool
    body: tuple[RapidStatement, ...]
    error: tuple[RapidStatement, ...] | None = None
    undo: tuple[RapidStatement, ...] | None = None


@dataclass(frozen=True, slots=True)
class Module:
    """A module.

    Attributes:
        file: Path that it was read from.
        bytes: Size [bytes].
        lines: Number of lines.
        starts: Offset of the start of each line, to locate faults that are found later.
    """

    name: str
    attributes: tuple[str, ...]
    data: tuple[DataDeclaration, ...]
    procedures: tuple[Procedure, ...]
    file: str
    bytes: int
    lines: int
    starts: tuple[int, ...]
