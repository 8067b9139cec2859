"""What a RAPID module says, as frozen values. Every node knows its offset in the text or its line."""

from __future__ import annotations

from dataclasses import dataclass

from planner.verify.rapid_values import Value

# ---- expressions; `start` is the offset in the module's text -----------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Literal:
    """A value that stands in the text; `kind` is its RAPID type."""

    start: int
    kind: str
    value: Value


@dataclass(frozen=True, slots=True)
class Aggregate:
    """`[a, b, ...]` whose type its place decides."""

    start: int
    items: tuple[Expr, ...]


@dataclass(frozen=True, slots=True)
class Name:
    """A name of data; `text` as written."""

    start: int
    text: str

    @property
    def key(self) -> str:
        """The name as RAPID compares it."""
        return self.text.lower()


@dataclass(frozen=True, slots=True)
class Function:
    """A function call."""

    start: int
    text: str
    arguments: tuple[Expr, ...]


@dataclass(frozen=True, slots=True)
class Unary:
    """`-x`, `+x` or `NOT x`; `operator` in lower case."""

    start: int
    operator: str
    operand: Expr


@dataclass(frozen=True, slots=True)
class Binary:
    """`left operator right`; `operator` in lower case."""

    start: int
    operator: str
    left: Expr
    right: Expr


Expr = Literal | Aggregate | Name | Function | Unary | Binary


# ---- statements --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Statement:
    """`line` from 1; `start` the offset of its first word."""

    line: int
    start: int


@dataclass(frozen=True, slots=True)
class Move(Statement):
    """`kind` MoveAbsJ, MoveJ or MoveL; `switches` holds conc, noeoffs, inpos... as given, in lower case."""

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
class Instruction(Statement):
    """Any other built-in instruction: `name` in its official spelling, required arguments, options by
    lower-case name.
    """

    name: str
    arguments: tuple[Expr, ...] = ()
    options: tuple[tuple[str, Expr | None], ...] = ()


@dataclass(frozen=True, slots=True)
class Assign(Statement):
    """`target := value;`"""

    target: Name
    value: Expr


@dataclass(frozen=True, slots=True)
class ProcCall(Statement):
    """`name;`"""

    name: str


@dataclass(frozen=True, slots=True)
class LateCall(Statement):
    """`%"module:procedure"%;`"""

    name: Expr


@dataclass(frozen=True, slots=True)
class If(Statement):
    """`branches`: condition and body of IF and each ELSEIF; `otherwise`: body of ELSE. `source`: text of
    the conditions.
    """

    branches: tuple[tuple[Expr, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]
    source: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class While(Statement):
    """`WHILE condition DO body ENDWHILE`"""

    condition: Expr
    body: tuple[Statement, ...]
    source: str


@dataclass(frozen=True, slots=True)
class For(Statement):
    """`FOR name FROM first TO last [STEP step] DO body ENDFOR`"""

    name: str
    first: Expr
    last: Expr
    step: Expr | None
    body: tuple[Statement, ...]


# ---- declarations ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Data:
    """One data declaration: `storage` CONST, VAR, PERS or TASK PERS; `size` of an array or None."""

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
    """A procedure without parameters; `error` and `undo` are its handlers, None where it has none."""

    line: int
    start: int
    name: str
    local: bool
    body: tuple[Statement, ...]
    error: tuple[Statement, ...] | None = None
    undo: tuple[Statement, ...] | None = None


@dataclass(frozen=True, slots=True)
class Module:
    """A module; `file` is where it came from, `bytes` its size, `lines` its number of lines."""

    name: str
    attributes: tuple[str, ...]
    data: tuple[Data, ...]
    procedures: tuple[Procedure, ...]
    file: str
    bytes: int
    lines: int
    starts: tuple[int, ...]  # offsets of the lines, to place later faults
