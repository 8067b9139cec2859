"""Strict reader of the rows of a trajectory file: JSON Lines, one step or one point of a move per line.

A row is an object with exactly the keys of its kind, in their order. Numbers are decimals without exponent.
Faults are, for example, NaN, duplicate or unknown keys, unknown kinds of rows, and a last row that does not
match number and hash of the rows before it. The reader shares no code with the writer: it implements
docs/trajectories.md.
"""

import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from planner.programs.steps import TextFault

VERSION: Final = 2
"""Supported version of the file format."""
MAX_VALUE: Final = 1e6
"""Maximum magnitude of numbers [s, rad, m, kg]."""
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_/.-]{0,99}", re.ASCII)
"""Pattern of names."""
_NUMBER: Final = re.compile(r"-?\d{1,7}(\.\d{1,12})?", re.ASCII)
"""Pattern of numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryRow:
    """A row; ``line`` counts from 1."""

    line: int


@dataclass(frozen=True, slots=True, eq=False)
class ArmRow(TrajectoryRow):
    """An arm that the file moves. A pose is a position [m] and a rotation vector [rad], (6,).

    Attributes:
        joints: Names of its joints, in the order of their numbers in rows.
        base: Pose of the base in the world, (6,).
    """

    arm: str
    robot: str
    joints: tuple[str, ...]
    base: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class OperationRow(TrajectoryRow):
    """Start of an operation.

    Attributes:
        setup: Number of the setup, from 1.
        held_by: Arm that holds the block, "" for none.
        block: Pose of the block, (6,), in the world, or in the TCP frame of the arm that holds it.
    """

    operation: str
    setup: int
    held_by: str
    block: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ToolRow(TrajectoryRow):
    """Tool that an arm carries from here on.

    Attributes:
        tcp: Pose of the TCP in the flange frame, (6,).
        mass: Mass [kg].
        centre: Centre of mass in the flange frame, (3,) [m].
    """

    tool: str
    arm: str
    tcp: tuple[float, ...]
    mass: float
    centre: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CarryRow(TrajectoryRow):
    """Load that an arm's tool holds from here on, in its TCP frame.

    The operator confirms that the arm's controller knows it; otherwise the run ends.

    Attributes:
        mass: Mass [kg], 0 for nothing.
        centre: Centre of mass, (3,) [m].
        axes: Rotation vector of the principal axes, (3,) [rad].
        inertia: Principal moments of inertia, (3,) [kg m^2].
    """

    arm: str
    mass: float
    centre: tuple[float, ...]
    axes: tuple[float, ...]
    inertia: tuple[float, ...]
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AtRow(TrajectoryRow):
    """Checks that each joint deviates from ``at`` [rad] by at most ``within`` [rad]; else the run ends."""

    at: tuple[float, ...]
    within: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TellRow(TrajectoryRow):
    """Message to the operator."""

    text: str


@dataclass(frozen=True, slots=True, eq=False)
class AskRow(TrajectoryRow):
    """Question to the operator; without a yes the run ends."""

    text: str
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class SetRow(TrajectoryRow):
    """Switches an output to the level ``to``, 0 or 1."""

    signal: str
    to: int


@dataclass(frozen=True, slots=True, eq=False)
class AwaitRow(TrajectoryRow):
    """Waits up to ``within`` [s] for an input to have the level ``to``; otherwise the run ends."""

    signal: str
    to: int
    within: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DwellRow(TrajectoryRow):
    """Waits for ``seconds`` [s]."""

    seconds: float
    on_failure: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryPoint(TrajectoryRow):
    """A point of a move.

    Attributes:
        t: Time from the start of the move [s].
        q: All joints [rad].
        v: All joint velocities [rad/s].
        segment: Label of the segment, "" in a move without segments.
    """

    t: float
    q: tuple[float, ...]
    v: tuple[float, ...]
    segment: str


@dataclass(frozen=True, slots=True, eq=False)
class MoveRow(TrajectoryRow):
    """One goal of the controller.

    Attributes:
        arms: Arms that move.
        path: Path tolerances of all joints [rad].
        goal: Goal tolerances of all joints [rad].
        goal_time: Allowed delay of the end [s].
        points: Points of the move; the rows after this one.
    """

    arms: tuple[str, ...]
    path: tuple[float, ...]
    goal: tuple[float, ...]
    goal_time: float
    on_failure: tuple[str, ...]
    points: list[TrajectoryPoint] = field(default_factory=list)


MayFail = CarryRow | AtRow | AskRow | AwaitRow | DwellRow | MoveRow
"""Rows of steps that may fail; ``on_failure`` names the outputs that are then switched off."""


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryProgram:
    """A trajectory file.

    Attributes:
        file: Its path.
        problem: Name of the problem.
        digest: Digest of the problem.
        arms: Rows of its arms, in the order of all numbers.
        rows: All other rows without head and end; a move contains its points.
    """

    file: str
    problem: str
    digest: str
    arms: tuple[ArmRow, ...]
    rows: tuple[TrajectoryRow, ...]

    @property
    def points(self) -> int:
        """Number of points of all moves."""
        return sum(len(row.points) for row in self.rows if isinstance(row, MoveRow))

    @property
    def width(self) -> int:
        """Total number of joints of all arms."""
        return sum(len(arm.joints) for arm in self.arms)


class RowError(Exception):
    """A row is not valid.

    Attributes:
        kind: Issue code without its prefix "trajectory.".
        message: What is wrong.
    """

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind
        self.message = message


def read(file: str, text: str, max_bytes: int) -> tuple[TrajectoryProgram | None, tuple[TextFault, ...]]:
    """Return the program of a file, None if there are faults, and the faults.

    Args:
        file: Path of the file.
        text: Its text.
        max_bytes: Maximum size [bytes].
    """
    faults: list[TextFault] = []
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > max_bytes:
        message = f"{size} bytes; allowed: {max_bytes}; split the job"
        # parsing a file of this size takes minutes
        return None, (TextFault(1, 1, "trajectory.file_size", message, file),)
    lines = text.replace("\r\n", "\n").split("\n")
    if lines[-1] != "":
        faults.append(TextFault(len(lines), 1, "trajectory.syntax", "the file ends within a line", file))
    else:
        lines = lines[:-1]
    parsed: list[Any] = []
    for number, line in enumerate(lines, 1):
        try:
            parsed.append(_parse_row(number, line))
        except RowError as wrong:
            faults.append(TextFault(number, 1, f"trajectory.{wrong.kind}", wrong.message, file))
            if len(faults) > _MAX_FAULTS:
                break
    if faults:
        return None, tuple(faults)
    try:
        return _build_program(file, lines, parsed), ()
    except _MisplacedError as wrong:
        return None, (TextFault(wrong.line, 1, f"trajectory.{wrong.kind}", wrong.message, file),)


_MAX_FAULTS: Final = 50
"""Number of faults after which reading stops."""


class _MisplacedError(RowError):
    """A row is valid in itself, but does not fit the rest of the file."""

    def __init__(self, line: int, message: str, kind: str = "syntax") -> None:
        super().__init__(kind, message)
        self.line = line


@dataclass(frozen=True, slots=True)
class _Head:
    """First row of a file."""

    line: int
    version: int
    written_by: str
    problem: str
    digest: str


@dataclass(frozen=True, slots=True)
class _Segment:
    """Start of a segment within a move."""

    line: int
    segment: str


@dataclass(frozen=True, slots=True)
class _End:
    """Last row: number of all rows, and SHA-256 of the rows before it."""

    line: int
    rows: int
    sha256: str


def _build_program(file: str, lines: Sequence[str], parsed: Sequence[Any]) -> TrajectoryProgram:
    """Return the parsed rows as a program.

    The order is: head, arms, all other rows, end. Points and segments follow their move. The first segment of
    a move follows its first point, and all its later points belong to a segment. Version, number of rows and
    hash are checked, names of arms and joints are unique, and each signal has one spelling.

    Args:
        file: Path of the file.
        lines: All lines, without line ends.
        parsed: The parsed row of each line.

    Raises:
        _MisplacedError: A row does not fit the file.
    """
    if not parsed or not isinstance(parsed[0], _Head):
        raise _MisplacedError(1, "the file does not start with its head (tandem_trajectory)")
    head, end = parsed[0], parsed[-1]
    if head.version != VERSION:
        raise _MisplacedError(1, f"tandem_trajectory is {head.version}; allowed: {VERSION}")
    if not isinstance(end, _End):
        raise _MisplacedError(len(parsed), "the file does not end with its end row; it is incomplete")
    if end.rows != len(parsed):
        raise _MisplacedError(end.line, f"the end row states {end.rows} rows; the file has {len(parsed)}")
    digest = hashlib.sha256(
        "".join(f"{line}\n" for line in lines[:-1]).encode("ascii", "replace")
    ).hexdigest()
    if end.sha256 != digest:
        raise _MisplacedError(end.line, "the rows do not match the hash of the end row (sha256)")
    arms: list[ArmRow] = []
    rows: list[TrajectoryRow] = []
    segment: str | None = None
    for row in parsed[1:-1]:
        move = rows[-1] if rows and isinstance(rows[-1], MoveRow) else None
        match row:
            case ArmRow() if not rows and segment is None:
                arms.append(row)
            case _Segment() if move is not None and (segment is not None or len(move.points) == 1):
                segment = row.segment
            case TrajectoryPoint() if move is not None:
                move.points.append(TrajectoryPoint(row.line, row.t, row.q, row.v, segment or ""))
            case TrajectoryRow() if not isinstance(row, ArmRow | TrajectoryPoint) and arms:
                if isinstance(row, OperationRow) and not rows and row.setup != 1:
                    raise _MisplacedError(row.line, "the first operation must be in setup 1")
                rows.append(row)
                segment = None
            case _:
                raise _MisplacedError(row.line, "this row is not allowed here")
    program = TrajectoryProgram(file, head.problem, head.digest, tuple(arms), tuple(rows))
    joints = [joint for arm in arms for joint in arm.joints]
    for kind, names in (("arms", [arm.arm for arm in arms]), ("joints", joints)):
        if len(set(names)) != len(names):
            raise _MisplacedError(
                arms[0].line, f"the names of the {kind} {', '.join(names)} must differ", "name_duplicate"
            )
    if not arms:
        raise _MisplacedError(1, "the file names no arm")
    spellings: dict[str, str] = {}
    for row in rows:
        _check_row(row, program)
        for name in _signals(row):
            other = spellings.setdefault(name.lower(), name)
            if other != name:  # the proof ignores case, but a runner would use two services
                message = f"{name} is spelt {other} elsewhere; use one spelling"
                raise _MisplacedError(row.line, message, "name_duplicate")
    return program


def _signals(row: TrajectoryRow) -> tuple[str, ...]:
    """Return the names of all signals in a row."""
    match row:
        case SetRow(signal=name):
            return (name,)
        case AwaitRow(signal=name):
            return (name, *row.on_failure)
    return row.on_failure if isinstance(row, MayFail) else ()


def _check_row(row: TrajectoryRow, program: TrajectoryProgram) -> None:
    """Check that a row has one number for each joint, and names only arms of the file.

    A move must name at least one arm, in the file's order, and have at least one point.

    Raises:
        _MisplacedError: The row does not fit the arms of the file.
    """
    arm_names = [arm.arm for arm in program.arms]
    match row:
        case AtRow(at=values):
            _require_width(row, program, values)
        case OperationRow(held_by=arm) if arm and arm not in arm_names:
            raise _MisplacedError(row.line, f"there is no arm {arm}", "undeclared")
        case ToolRow(arm=arm) | CarryRow(arm=arm) if arm not in arm_names:
            raise _MisplacedError(row.line, f"there is no arm {arm}", "undeclared")
        case MoveRow(arms=arms, points=points):
            if not arms or [name for name in arm_names if name in arms] != list(arms):
                raise _MisplacedError(
                    row.line, f"move of {list(arms)}; the file's arms are {arm_names}", "undeclared"
                )
            _require_width(row, program, row.path)
            _require_width(row, program, row.goal)
            if not points:
                raise _MisplacedError(row.line, "a move without points")
            for point in points:
                _require_width(point, program, point.q)
                _require_width(point, program, point.v)


def _require_width(row: TrajectoryRow, program: TrajectoryProgram, values: Sequence[float]) -> None:
    if len(values) != program.width:
        raise _MisplacedError(
            row.line, f"{len(values)} numbers; the file's arms have {program.width} joints", "type"
        )


# ---- one row ----


def _parse_row(number: int, line: str) -> Any:
    """Return the row in line ``number`` as an object of its kind, such as `MoveRow`.

    The first key names the kind. All keys of the kind must follow in their order.

    Raises:
        RowError: The row is not valid.
    """
    if not line.isascii():
        raise RowError("syntax", "the row contains characters that are not ASCII")
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
        raise RowError("syntax", f"unknown row {keys[0]!r}; allowed: {', '.join(_KINDS)}")
    parsers, construct = kind
    if keys != tuple(parsers):
        raise RowError(
            "syntax", f"a row {keys[0]!r} has the keys {list(parsers)}, in this order; got {list(keys)}"
        )
    values = [parse(key, value[key]) for key, parse in parsers.items()]
    return construct(number, *values)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        raise RowError("name_duplicate", "a key occurs twice in one row")
    return out


def _constant(word: str) -> float:
    raise RowError("number", f"{word} is not allowed in a trajectory")


def _number(word: str) -> float | int:
    if _NUMBER.fullmatch(word) is None:
        raise RowError("number", f"{word}: expected a plain decimal with at most 12 digits after the point")
    return float(word) if "." in word else int(word)


def _real(key: str, value: Any) -> float:
    """Parse the value of a key as a number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RowError("type", f"{key} is no number")
    if not (math.isfinite(value) and abs(value) <= MAX_VALUE):
        raise RowError("number", f"{key} is {value}; allowed: up to {MAX_VALUE:g}")
    return float(value)


def _integer(key: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise RowError("type", f"{key} is no integer")
    return value


def _bit(key: str, value: Any) -> int:
    if _integer(key, value) not in (0, 1):
        raise RowError("type", f"{key} is {value}; allowed: 0 and 1")
    return int(value)


def _reals(count: int | None = None) -> Callable[[str, Any], tuple[float, ...]]:
    """Return a parser of a list of ``count`` numbers, or of any number of them."""

    def parse(key: str, value: Any) -> tuple[float, ...]:
        if not isinstance(value, list):
            raise RowError("type", f"{key} is no list of numbers")
        if count is not None and len(value) != count:
            raise RowError("type", f"{key} has {len(value)} numbers; expected {count}")
        return tuple(_real(key, number) for number in value)

    return parse


def _name(key: str, value: Any) -> str:
    if not isinstance(value, str) or _NAME.fullmatch(value) is None:
        raise RowError(
            "name_form", f"{key} is {value!r}; expected a letter, then letters, digits and _ / . -"
        )
    return value


def _name_or_none(key: str, value: Any) -> str:
    return "" if value == "" else _name(key, value)


def _names(key: str, value: Any) -> tuple[str, ...]:
    """Parse the value of a key as a list of distinct names, where case does not count.

    Raises `RowError` if it is not such a list.
    """
    if not isinstance(value, list):
        raise RowError("type", f"{key} is no list of names")
    names = tuple(_name(key, item) for item in value)
    if len({name.lower() for name in names}) != len(names):
        raise RowError("name_duplicate", f"{key}: {', '.join(names)} must differ")
    return names


def _text(key: str, value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise RowError("type", f"{key} is no text of one line")
    return value


def _point(line: int, t: float, q: tuple[float, ...], v: tuple[float, ...]) -> TrajectoryPoint:
    return TrajectoryPoint(line, t, q, v, "")


_Keys = Mapping[str, Callable[[str, Any], Any]]
"""Parsers of the values of a row, by key."""
_ON_FAILURE: Final[_Keys] = {"on_failure": _names}
_KINDS: Final[Mapping[str, tuple[_Keys, Callable[..., Any]]]] = {
    "tandem_trajectory": (
        {"tandem_trajectory": _integer, "written_by": _text, "problem": _text, "problem_digest": _text},
        _Head,
    ),
    "arm": ({"arm": _name, "robot": _name, "joints": _names, "base": _reals(6)}, ArmRow),
    "operation": (
        {"operation": _text, "setup": _integer, "held_by": _name_or_none, "block": _reals(6)},
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
            **_ON_FAILURE,
        },
        CarryRow,
    ),
    "at": ({"at": _reals(), "within": _real, **_ON_FAILURE}, AtRow),
    "tell": ({"tell": _text}, TellRow),
    "ask": ({"ask": _text, **_ON_FAILURE}, AskRow),
    "set": ({"set": _name, "to": _bit}, SetRow),
    "await": ({"await": _name, "to": _bit, "within": _real, **_ON_FAILURE}, AwaitRow),
    "dwell": ({"dwell": _real, **_ON_FAILURE}, DwellRow),
    "move": (
        {"move": _names, "path": _reals(), "goal": _reals(), "goal_time": _real, **_ON_FAILURE},
        MoveRow,
    ),
    "segment": ({"segment": _text}, _Segment),
    "t": ({"t": _real, "q": _reals(), "v": _reals()}, _point),
    "end": ({"end": _integer, "sha256": _text}, _End),
}
"""Kinds of rows by their first key: parsers of all keys, and the class of the row."""
