"""The rows of a trajectory file, read strictly: JSON Lines, one step or one point of a move a line.

A row is an object with exactly the keys of its kind, in their order. Numbers are plain decimals; NaN, a key
that stands twice, a key or kind of row that is not known, and a last row that does not count and seal the
rows before it are faults. The reader shares no code with the writer: it knows the rows from
docs/trajectories.md."""

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from planner.programs.steps import Fault

VERSION: Final = 2
"""The form of the file that is read."""
MOST_VALUE: Final = 1e6
"""Numbers are no larger [s, rad, m, kg]."""
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_/.-]{0,99}", re.ASCII)
_NUMBER: Final = re.compile(r"-?\d{1,7}(\.\d{1,12})?", re.ASCII)


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Where a row stands [from 1]."""

    line: int


@dataclass(frozen=True, slots=True, eq=False)
class ArmRow(Row):
    """An arm: its `joints` by name, in the order of all numbers, and its `base` (6,) in the world."""

    arm: str
    robot: str
    joints: tuple[str, ...]
    base: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class OperationRow(Row):
    """An operation begins, in a setup [from 1] in which the block stands at `block` (6,) in the world, or in
    the frame of the TCP of the arm that it is `held_by`."""

    operation: str
    setup: int
    held_by: str
    block: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ToolRow(Row):
    """What an arm carries from here on: `tcp` (6,) in the flange, `mass` [kg] and `centre` (3,) [m]."""

    tool: str
    arm: str
    tcp: tuple[float, ...]
    mass: float
    centre: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CarryRow(Row):
    """What an arm's tool holds from here on, in the frame of its TCP: `mass` [kg], 0 for nothing, `centre`
    (3,) [m], moments of `inertia` (3,) [kg m^2] about `axes` (3,), a rotation vector, through it. The
    operator says that the arm's controller knows it, or nothing more is done."""

    arm: str
    mass: float
    centre: tuple[float, ...]
    axes: tuple[float, ...]
    inertia: tuple[float, ...]
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AtRow(Row):
    """All joints stand at `at` [rad], each `within` [rad], or nothing more is done."""

    at: tuple[float, ...]
    within: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TellRow(Row):
    """The operator is told something."""

    text: str


@dataclass(frozen=True, slots=True, eq=False)
class AskRow(Row):
    """The operator is asked something, and says yes, or nothing more is done."""

    text: str
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SetRow(Row):
    """An output is switched."""

    signal: str
    to: int


@dataclass(frozen=True, slots=True, eq=False)
class AwaitRow(Row):
    """An input is waited for, `within` [s], or nothing more is done."""

    signal: str
    to: int
    within: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DwellRow(Row):
    """Nothing is done for `seconds`."""

    seconds: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Point(Row):
    """A point of a move: `t` [s] from its start, `q` [rad] and `v` [rad/s] of all joints, the label of the
    `segment`, "" in a move that has none."""

    t: float
    q: tuple[float, ...]
    v: tuple[float, ...]
    segment: str


@dataclass(frozen=True, slots=True, eq=False)
class MoveRow(Row):
    """One goal: the `arms` that move, tolerances of all joints on the `path` and at the `goal` [rad], and
    by how much it may be late, `goal_time` [s]. `points` follow."""

    arms: tuple[str, ...]
    path: tuple[float, ...]
    goal: tuple[float, ...]
    goal_time: float
    on_failure: tuple[str, ...]
    points: list[Point] = field(default_factory=list)


MayFail = CarryRow | AtRow | AskRow | AwaitRow | DwellRow | MoveRow
"""Rows of steps that may not end; ``on_failure`` names the outputs that fall then."""


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A file: what it says of itself, its arms, and its rows behind them, a move with its points."""

    file: str
    problem: str
    digest: str
    arms: tuple[ArmRow, ...]
    rows: tuple[Row, ...]

    @property
    def points(self) -> int:
        """How many points all moves have."""
        return sum(len(row.points) for row in self.rows if isinstance(row, MoveRow))

    @property
    def width(self) -> int:
        """How many joints all arms have."""
        return sum(len(arm.joints) for arm in self.arms)


class RowError(Exception):
    """A row is none. `kind` is a fault's code without the language."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.message = kind, message


def read(file: str, text: str, most_bytes: int) -> tuple[Program | None, tuple[Fault, ...]]:
    """The program of a file's text, None where there is none, and all faults."""
    faults: list[Fault] = []
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > most_bytes:
        what = f"{size} bytes; allowed: {most_bytes}; split the job"
        return None, (Fault(1, 1, "trajectory.file_size", what, file),)  # rows of one as long take minutes
    lines = text.replace("\r\n", "\n").split("\n")
    if lines[-1] != "":
        faults.append(Fault(len(lines), 1, "trajectory.syntax", "the file ends within a line", file))
    else:
        lines = lines[:-1]
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(_row(number, line))
        except RowError as wrong:
            faults.append(Fault(number, 1, f"trajectory.{wrong.kind}", wrong.message, file))
            if len(faults) > _MOST_FAULTS:
                break
    if faults:
        return None, tuple(faults)
    try:
        return _program(file, lines, found), ()
    except _MisplacedError as wrong:
        return None, (Fault(wrong.line, 1, f"trajectory.{wrong.kind}", wrong.message, file),)


_MOST_FAULTS: Final = 50


class _MisplacedError(RowError):
    def __init__(self, line: int, message: str, kind: str = "syntax") -> None:
        super().__init__(kind, message)
        self.line = line


@dataclass(frozen=True, slots=True)
class _Head:
    line: int
    version: int
    written_by: str
    problem: str
    digest: str


@dataclass(frozen=True, slots=True)
class _Segment:
    line: int
    segment: str


@dataclass(frozen=True, slots=True)
class _End:
    line: int
    rows: int
    sha256: str


def _program(file: str, lines: Sequence[str], found: Sequence[Any]) -> Program:
    """The rows as a program. Raises `_MisplacedError` for one that stands where it must not."""
    if not found or not isinstance(found[0], _Head):
        raise _MisplacedError(1, "the file does not begin with its head (tandem_trajectory)")
    head, end = found[0], found[-1]
    if head.version != VERSION:
        raise _MisplacedError(1, f"tandem_trajectory is {head.version}; allowed: {VERSION}")
    if not isinstance(end, _End):
        raise _MisplacedError(len(found), "the file does not close with its end; it was cut off")
    if end.rows != len(found):
        raise _MisplacedError(end.line, f"the end counts {end.rows} rows; the file has {len(found)}")
    sealed = hashlib.sha256(
        "".join(f"{line}\n" for line in lines[:-1]).encode("ascii", "replace")
    ).hexdigest()
    if end.sha256 != sealed:
        raise _MisplacedError(end.line, "the rows are not those that the end was written for (sha256)")
    arms: list[ArmRow] = []
    rows: list[Row] = []
    segment: str | None = None
    for row in found[1:-1]:
        move = rows[-1] if rows and isinstance(rows[-1], MoveRow) else None
        match row:
            case ArmRow() if not rows and segment is None:
                arms.append(row)
            case _Segment() if move is not None and (segment is not None or len(move.points) == 1):
                segment = row.segment
            case Point() if move is not None:
                move.points.append(Point(row.line, row.t, row.q, row.v, segment or ""))
            case Row() if not isinstance(row, ArmRow | Point) and arms:
                if isinstance(row, OperationRow) and not rows and row.setup != 1:
                    raise _MisplacedError(row.line, "the first operation is of setup 1")
                rows.append(row)
                segment = None
            case _:
                raise _MisplacedError(row.line, "this row does not stand where it may")
    program = Program(file, head.problem, head.digest, tuple(arms), tuple(rows))
    for name, values in (("arms", [a.arm for a in arms]), ("joints", [j for a in arms for j in a.joints])):
        if len(set(values)) != len(values):
            raise _MisplacedError(
                arms[0].line, f"the {name} {', '.join(values)} are not different", "name_duplicate"
            )
    if not arms:
        raise _MisplacedError(1, "the file names no arm")
    spelt: dict[str, str] = {}
    for row in rows:
        _fits(row, program)
        for name in _signals(row):
            other = spelt.setdefault(name.lower(), name)
            if other != name:  # one signal to the proof, two services to a runner
                what = f"{name} stands elsewhere as {other}; one name is spelt one way"
                raise _MisplacedError(row.line, what, "name_duplicate")
    return program


def _signals(row: Row) -> tuple[str, ...]:
    match row:
        case SetRow(signal=name):
            return (name,)
        case AwaitRow(signal=name):
            return (name, *row.on_failure)
    return row.on_failure if isinstance(row, MayFail) else ()


def _fits(row: Row, program: Program) -> None:
    """Raise where a row's numbers are not one for each joint, or its arms are not those of the file."""
    known = [arm.arm for arm in program.arms]
    match row:
        case AtRow(at=values):
            _wide(row, program, values)
        case OperationRow(held_by=arm) if arm and arm not in known:
            raise _MisplacedError(row.line, f"there is no arm {arm}", "undeclared")
        case ToolRow(arm=arm) | CarryRow(arm=arm) if arm not in known:
            raise _MisplacedError(row.line, f"there is no arm {arm}", "undeclared")
        case MoveRow(arms=arms, points=points):
            if not arms or [name for name in known if name in arms] != list(arms):
                raise _MisplacedError(
                    row.line, f"move of {list(arms)}; the file's arms are {known}", "undeclared"
                )
            _wide(row, program, row.path)
            _wide(row, program, row.goal)
            if not points:
                raise _MisplacedError(row.line, "a move without points")
            for point in points:
                _wide(point, program, point.q)
                _wide(point, program, point.v)


def _wide(row: Row, program: Program, values: Sequence[float]) -> None:
    if len(values) != program.width:
        raise _MisplacedError(
            row.line, f"{len(values)} numbers; the file's arms have {program.width} joints", "type"
        )


# ---- one row ----


def _row(number: int, line: str) -> Any:
    if not line.isascii():
        raise RowError("syntax", "the row holds other characters than ASCII")
    try:
        value = json.loads(
            line, object_pairs_hook=_object, parse_constant=_constant, parse_float=_number, parse_int=_number
        )
    except (ValueError, RecursionError) as wrong:
        raise RowError("syntax", f"the row is no JSON: {wrong}") from None
    if not isinstance(value, dict) or not value:
        raise RowError("syntax", "a row is an object with keys")
    keys = tuple(value)
    kind = _KINDS.get(keys[0])
    if kind is None:
        raise RowError("syntax", f"{keys[0]!r} begins no row; known are {', '.join(_KINDS)}")
    wanted, make = kind
    if keys != tuple(wanted):
        raise RowError(
            "syntax", f"a row {keys[0]!r} has the keys {list(wanted)}, in this order; got {list(keys)}"
        )
    parts = [take(name, value[name]) for name, take in wanted.items()]
    return make(number, *parts)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        raise RowError("name_duplicate", "a key stands twice in one row")
    return out


def _constant(word: str) -> float:
    raise RowError("number", f"{word} is no number of a trajectory")


def _number(word: str) -> float | int:
    if _NUMBER.fullmatch(word) is None:
        raise RowError("number", f"{word}: plain decimals must stand here, with at most 12 behind the point")
    return float(word) if "." in word else int(word)


def _real(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RowError("type", f"{name} is no number")
    if not (math.isfinite(value) and abs(value) <= MOST_VALUE):
        raise RowError("number", f"{name} is {value}; allowed: up to {MOST_VALUE:g}")
    return float(value)


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise RowError("type", f"{name} is no whole number")
    return value


def _bit(name: str, value: Any) -> int:
    if _whole(name, value) not in (0, 1):
        raise RowError("type", f"{name} is {value}; allowed: 0 and 1")
    return int(value)


def _reals(count: int | None = None) -> Callable[[str, Any], tuple[float, ...]]:
    def take(name: str, value: Any) -> tuple[float, ...]:
        if not isinstance(value, list):
            raise RowError("type", f"{name} is no list of numbers")
        if count is not None and len(value) != count:
            raise RowError("type", f"{name} has {len(value)} numbers; {count} must stand here")
        return tuple(_real(name, one) for one in value)

    return take


def _name(name: str, value: Any) -> str:
    if not isinstance(value, str) or _NAME.fullmatch(value) is None:
        raise RowError(
            "name_form", f"{name} is {value!r}; a letter, then letters, digits and _ / . - stand here"
        )
    return value


def _name_or_none(name: str, value: Any) -> str:
    return "" if value == "" else _name(name, value)


def _names(name: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise RowError("type", f"{name} is no list of names")
    out = tuple(_name(name, one) for one in value)
    if len({one.lower() for one in out}) != len(out):
        raise RowError("name_duplicate", f"{name}: {', '.join(out)} are not different")
    return out


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise RowError("type", f"{name} is no text of one line")
    return value


def _point(line: int, t: float, q: tuple[float, ...], v: tuple[float, ...]) -> Point:
    return Point(line, t, q, v, "")


_Keys = Mapping[str, Callable[[str, Any], Any]]
_FALLS: Final[_Keys] = {"on_failure": _names}
_KINDS: Final[Mapping[str, tuple[_Keys, Callable[..., Any]]]] = {
    "tandem_trajectory": (
        {"tandem_trajectory": _whole, "written_by": _text, "problem": _text, "problem_digest": _text},
        _Head,
    ),
    "arm": ({"arm": _name, "robot": _name, "joints": _names, "base": _reals(6)}, ArmRow),
    "operation": (
        {"operation": _text, "setup": _whole, "held_by": _name_or_none, "block": _reals(6)},
        OperationRow,
    ),
    "tool": ({"tool": _name, "arm": _name, "tcp": _reals(6), "mass": _real, "centre": _reals(3)}, ToolRow),
    "carry": (
        {
            "carry": _name,
            "mass": _real,
            "centre": _reals(3),
            "axes": _reals(3),
            "inertia": _reals(3),
            **_FALLS,
        },
        CarryRow,
    ),
    "at": ({"at": _reals(), "within": _real, **_FALLS}, AtRow),
    "tell": ({"tell": _text}, TellRow),
    "ask": ({"ask": _text, **_FALLS}, AskRow),
    "set": ({"set": _name, "to": _bit}, SetRow),
    "await": ({"await": _name, "to": _bit, "within": _real, **_FALLS}, AwaitRow),
    "dwell": ({"dwell": _real, **_FALLS}, DwellRow),
    "move": ({"move": _names, "path": _reals(), "goal": _reals(), "goal_time": _real, **_FALLS}, MoveRow),
    "segment": ({"segment": _text}, _Segment),
    "t": ({"t": _real, "q": _reals(), "v": _reals()}, _point),
    "end": ({"end": _whole, "sha256": _text}, _End),
}
"""Kinds of rows by their first key: all keys with what reads their values, and what they become."""
