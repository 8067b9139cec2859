"""All that a task does and may do: its straight way through the modules, what errors and UNDO run.

On the straight way calls are put in place and names replaced by values. Conditions on constants are
decided. A condition known at run time only (an operator's answer, IsSyncMoveOn()) must not decide
over motion, signals or synchronisation: such a program cannot be proven and is refused.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

from planner.languages.rapid.reader.evaluation import UNKNOWN, Evaluator, Names
from planner.languages.rapid.reader.lexer import INSTRUCTIONS
from planner.languages.rapid.reader.syntax_tree import (
    PREDEFINED,
    Assign,
    Data,
    Expr,
    For,
    If,
    Instruction,
    LateCall,
    Module,
    Move,
    Name,
    ProcCall,
    Procedure,
    Statement,
    Value,
    While,
)
from planner.programs.steps import (
    CallStep,
    CarryStep,
    ChoiceStep,
    Fault,
    FlowError,
    LoadStep,
    MessageStep,
    MoveStep,
    SettingStep,
    SignalStep,
    Step,
    SyncStep,
    WaitStep,
    WorkObject,
    single,
)

CHECK_MODULE = re.compile(r"(?i)TandemCheck_\w+\.(modx?)$")
"""Names of the modules that compare the cell with the plan, which a rule of their own reads."""
AXES_CHECK = "check_axes"
"""Name of the procedure there that looks at external axes, and the kind of the step that calls it."""
MAX_CALLS = 50
"""Procedures that call each other may be so deep."""
MAX_LOOPS = 100_000
"""Rounds of a FOR at most."""
_END_STATEMENTS = ("RETURN", "EXIT", "RAISE", "RETRY", "TRYNEXT")
"""Statements that end a procedure or handler."""
_MESSAGE_STATEMENTS = ("TPWrite", "TPErase", "UIMsgBox", "TPReadFK", "ErrWrite")
"""Statements that show or ask something."""
_STOP_STATEMENTS = ("EXIT", "Stop", "StopMove")
"""Statements that stop the motion."""


class _LeaveError(Exception):
    """A RETURN, EXIT, RAISE, RETRY or TRYNEXT was met."""

    def __init__(self, word: str) -> None:
        super().__init__(word)
        self.word = word


class Runner(Evaluator):
    """Runs procedures and collects their steps; `entered`: what ran or may run. `handler`: a section in which
    steps may hang on run-time conditions."""

    def __init__(self, modules: Sequence[Module], handler: bool = False, names: Names | None = None) -> None:
        super().__init__(modules, names)
        self.handler = handler
        self.steps: list[Step] = []
        self.procedure = ""
        self.condition = ""
        self.depth = 0
        self.entered: set[tuple[str, str]] = set()
        self._at = 0

    # ---- entry ----

    def run(self, entry: str) -> tuple[Step, ...]:
        """Steps from the procedure `entry` on."""
        found = [
            (module, procedure)
            for module in self.modules.values()
            for procedure in module.procedures
            if procedure.name.lower() == entry.lower()
        ]
        if len(found) == 1 and not found[0][1].local:
            return self.run_block(*found[0], found[0][1].body)
        what = f"several procedures {entry}, or a local one" if found else f"no procedure {entry}"
        raise FlowError([Fault(1, 1, "rapid.flow", f"{what} in the task's modules", self.module.file)])

    def run_block(self, module: Module, procedure: Procedure, body: Sequence[Statement]) -> tuple[Step, ...]:
        """Steps of a block of a procedure."""
        self.module, self.procedure = module, procedure.name
        self.entered.add((module.name, procedure.name))
        self._at = procedure.start
        with suppress(_LeaveError):
            try:
                self.block(body)
            except RecursionError:
                raise self.fail(self._at, "blocks and calls are nested too deeply") from None
        return tuple(self.steps)

    # ---- statements ----

    def block(self, statements: Sequence[Statement]) -> None:
        """Runs statements one after the other."""
        for statement in statements:
            self.statement(statement)

    def statement(self, statement: Statement) -> None:
        """Runs one statement; what it does is appended to ``steps``."""
        self._spend(statement, 5 if isinstance(statement, Move) else 1)
        match statement:
            case Move():
                self.steps.append(self._move(statement))
            case Instruction():
                self._instruction(statement)
            case Assign():
                self._assign(statement.target, self.value(statement.value, self._kind(statement.target)))
            case ProcCall():
                self._checks(statement)
                self.call(statement.start, statement.name)
            case LateCall():
                name = self.value(statement.name, "string")
                if not isinstance(name, str):
                    raise self.fail(
                        statement.start, "the name of the procedure to call is known at run time only"
                    )
                self.steps.append(CallStep(*self._where(statement), name))
                self.call(statement.start, name)
            case If():
                self._if(statement)
            case While():
                self._while(statement)
            case For():
                self._for(statement)

    def _spend(self, statement: Statement, work: int) -> None:
        self._at = statement.start
        self.names.work -= work
        if self.names.work < 0:
            raise self.fail(statement.start, "the program has no end, or runs its lines too often to be read")

    def _checks(self, statement: ProcCall) -> None:
        """A step for a call of the look at external axes, whose statements a rule of its own reads."""
        found = self.find(statement.name.lower())
        file = "" if found is None else PurePosixPath(found[0].file).name
        if statement.name.lower() == AXES_CHECK and CHECK_MODULE.match(file):
            self.steps.append(SettingStep(*self._where(statement), AXES_CHECK, (), ()))

    def call(self, start: int, name: str) -> None:
        """Put the steps of a procedure in place. `name` may be "module:procedure"."""
        holder, _, short = name.rpartition(":")
        found = self.find(short.lower())
        if holder:
            module = self.modules.get(holder.lower())
            items = self.names.items(module).get(short.lower(), []) if module else []
            found = (module, items[0]) if module and items else None
        if found is None or not isinstance(found[1], Procedure):
            raise self.fail(start, f"no procedure {name} in the task's modules")
        if self.depth >= MAX_CALLS:
            raise self.fail(start, f"calls nested more than {MAX_CALLS} deep; {name} may call itself")
        here = self.module, self.procedure
        self.entered.add((found[0].name, found[1].name))
        self.module, self.procedure, self.depth = found[0], found[1].name, self.depth + 1
        try:
            self.block(found[1].body)
        except _LeaveError as left:
            if left.word != "RETURN":
                raise
        finally:
            (self.module, self.procedure), self.depth = here, self.depth - 1

    def _where(self, statement: Statement) -> tuple[str, str, int, str]:
        return self.module.name, self.procedure, statement.line, self.condition

    def _kind(self, name: Name) -> str:
        found = self.find(name.key)
        return found[1].kind if found and isinstance(found[1], Data) else "num"

    def _assign(self, name: Expr, value: Value) -> None:
        if isinstance(name, Name):
            found = self.find(name.key)
            if found:
                self.cells[found[0].name.lower(), name.key] = value

    def _needed(self, expr: Expr, kind: str) -> Value:
        value = self.value(expr, kind)
        if value is None:
            raise self.fail(expr.start, f"this {kind} is known at run time only; the motion cannot be proven")
        return value

    def _move(self, move: Move) -> MoveStep:
        form = INSTRUCTIONS[move.kind.lower()]
        target = self._needed(move.target, form.required[0])
        ident = None if move.id is None else int(self._needed(move.id, "num"))
        time = None if move.time is None else single(self._needed(move.time, "num"))
        velocity = None if move.velocity is None else single(self._needed(move.velocity, "num")) * 1e-3
        wobj: WorkObject = (
            PREDEFINED["wobj0"][1] if move.wobj is None else self._needed(move.wobj, "wobjdata")
        )
        return MoveStep(
            *self._where(move),
            move.kind,
            target,
            _text(move.target),
            ident,
            time,
            velocity,
            self._needed(move.speed, "speeddata"),
            self._needed(move.zone, "zonedata"),
            _text(move.zone),
            self._needed(move.tool, "tooldata"),
            _text(move.tool),
            wobj,
            "wobj0" if move.wobj is None else _text(move.wobj),
            move.switches,
        )

    def _instruction(self, statement: Instruction) -> None:
        name, arguments, options = statement.name, statement.arguments, dict(statement.options)
        where = self._where(statement)
        if name in ("SetDO", "Set", "Reset"):
            value = self._needed(arguments[1], "num") if name == "SetDO" else float(name == "Set")
            delay = self.value(options.get("sdelay"), "num") or 0.0
            self.steps.append(SignalStep(*where, name, _text(arguments[0]), value, delay, "sync" in options))
        elif name in ("WaitTime", "WaitRob", "WaitDI"):
            seconds = self.value(arguments[0] if name == "WaitTime" else options.get("maxtime"), "num")
            signal = _text(arguments[0]) if name == "WaitDI" else ""
            value = self.value(arguments[1], "num") if name == "WaitDI" else None
            flag = options.get("timeflag")
            told = _text(flag) if flag is not None else ""
            self.steps.append(WaitStep(*where, name, seconds, signal, value, "inpos" in options, told))
            if flag is not None:
                self._assign(flag, UNKNOWN)
        elif name in _MESSAGE_STATEMENTS:
            self._message(statement, options)
        elif name.startswith(("WaitSync", "SyncMove")):
            ident = _text(arguments[0]) if arguments else ""
            tasks = self._needed(arguments[1], "tasks") if len(arguments) > 1 else ()
            self.steps.append(SyncStep(*where, name, ident, tasks, "timeout" in options))
        elif name in ("Load", "UnLoad"):
            path = self._needed(arguments[0], "string")
            file = self.value(options.get("file"), "string")
            self.steps.append(LoadStep(*where, name, path + (f"/{file}" if file else "")))
        elif name in ("ActUnit", "DeactUnit"):
            self.steps.append(SettingStep(*where, name, (), (), unit=_text(arguments[0]).lower()))
        elif name == "GripLoad":
            self.steps.append(CarryStep(*where, self._needed(arguments[0], "loaddata"), _text(arguments[0])))
        else:
            values = tuple(
                self.value(argument, "num") for argument in arguments if not isinstance(argument, Name)
            )
            self.steps.append(SettingStep(*where, name, tuple(options), values, name == "Stop"))
            if name in _END_STATEMENTS and not self.condition:
                raise _LeaveError(name)

    def _message(self, statement: Instruction, options: dict[str, Expr | None]) -> None:
        name, arguments = statement.name, statement.arguments
        shown = [value for value in (options.get("header"), *arguments) if value is not None]
        # shown by their numbers, in whatever order they are written
        shown += [
            value
            for key, value in sorted(options.items())
            if key.startswith(("msgline", "rl")) and value is not None
        ]
        if name == "TPReadFK":
            self._assign(arguments[0], UNKNOWN)
            shown = list(arguments[1:])
        result = options.get("result")
        if result is not None:
            self._assign(result, UNKNOWN)
        texts = [self.value(value, "string") for value in shown]
        lines = tuple("..." if text is None else str(text) for text in texts)
        asks = name in ("UIMsgBox", "TPReadFK")
        text = " ".join(lines[1:] if options.get("header") is not None else lines)
        button = options.get("buttons")
        certain = name == "UIMsgBox" and "maxtime" not in options and "result" not in options
        certain = certain and (button is None or self.value(button, "num") == PREDEFINED["btnok"][1])
        panel: Literal["line", "clear", ""] = (
            "line" if name == "TPWrite" else "clear" if name == "TPErase" else ""
        )
        header = lines[0] if options.get("header") is not None else ""
        others = tuple(
            (key, "" if value is None else _text(value))
            for key, value in options.items()
            if key != "header" and not key.startswith("msgline")
        )
        self.steps.append(
            MessageStep(*self._where(statement), name, lines, asks, text, certain, panel, header, others)
        )

    # ---- branches and loops ----

    def _if(self, statement: If) -> None:
        undecided = ""
        for (condition, body), source in zip(statement.branches, statement.source, strict=True):
            truth = self.value(condition, "bool")
            if truth is False:
                continue
            if truth is True and not undecided:
                self.block(body)
                return
            undecided = source if truth is not True else "else"
            self._choice(statement, source, lambda body=body: self.block(body))  # type: ignore[misc]
        if not undecided:
            self.block(statement.otherwise)
        elif statement.otherwise:
            self._choice(statement, f"not ({undecided})", lambda: self.block(statement.otherwise))

    def _while(self, statement: While) -> None:
        while (truth := self.value(statement.condition, "bool")) is True:
            self._spend(statement, 1)
            self.block(statement.body)
        if truth is None:
            self._choice(statement, statement.source, lambda: self.block(statement.body), True)

    def _for(self, statement: For) -> None:
        first, last = self._needed(statement.first, "num"), self._needed(statement.last, "num")
        step = self._needed(statement.step, "num") if statement.step else (1.0 if last >= first else -1.0)
        if step == 0 or abs(last - first) > MAX_LOOPS * abs(step):
            raise self.fail(statement.start, f"FOR from {first:g} to {last:g} by {step:g} has no end")
        key = ("for", statement.name.lower())
        outer = self.cells.get(key)
        for count in range(int((last - first) / step + 1e-9) + 1 if (last - first) / step >= 0 else 0):
            self._spend(statement, 1)
            self.cells[key] = first + count * step
            self.block(statement.body)
        self.cells[key] = outer

    def _choice(
        self, statement: Statement, condition: str, run: Callable[[], None], repeats: bool = False
    ) -> None:
        """Steps under a run-time condition: kept aside if harmless, refused if they move, switch or
        synchronise.
        """
        self._spend(statement, 1 + len(self.cells))
        steps, outer, cells = self.steps, self.condition, dict(self.cells)
        self.steps, self.condition = [], condition if not outer else f"{outer} and {condition}"
        try:
            run()
        except _LeaveError:
            pass
        finally:
            aside, self.steps, self.condition = self.steps, steps, outer
        # what the branch may or may not have assigned is not known behind it
        self.cells = {
            key: value if cells.get(key, self) is value else UNKNOWN for key, value in self.cells.items()
        }
        where = (self.module.name, self.procedure, statement.line, condition)
        if self.handler:
            self.steps.extend(aside)
            return
        for step in aside:
            if not _harmless(step, aside):
                raise self.fail(
                    statement.start,
                    f"whether line {step.line} is run is known at run time only ({condition})",
                )
        self.steps.append(ChoiceStep(*where, tuple(aside), repeats))


def _harmless(step: Step, branch: Sequence[Step]) -> bool:
    """Whether a step may hang on what is known at run time only: it talks, waits or stops the task for good.

    In a branch that ends the task, signals may be switched off before. A branch that leaves its procedure
    (RETURN, RAISE) would leave out what follows there.
    """
    last = branch[-1]
    ends = isinstance(last, SettingStep) and last.kind == "EXIT" and last.condition == branch[0].condition
    match step:
        case SettingStep():
            return step.kind in _STOP_STATEMENTS
        case SignalStep():
            return ends and step.value == 0.0 and not step.delay
        case _:
            return isinstance(step, MessageStep | WaitStep | CallStep | ChoiceStep)


def _text(expr: Expr) -> str:
    return expr.text if isinstance(expr, Name) else ""


Sections = Mapping[tuple[str, str], tuple[Step, ...]]


def flatten(modules: Sequence[Module], entry: str = "main") -> tuple[Step, ...]:
    """All steps of a task from `entry` on, for modules without faults (`reader.read_task`).

    Raises `FlowError` when the entry is missing, the calls have no end, or run-time conditions decide over
    the motion.
    """
    return Runner(modules).run(entry)


@dataclass(frozen=True, slots=True)
class Flow:
    """All that a task may do: `steps` of its straight way, steps of each ERROR section (`handlers`) and UNDO
    section (`undos`) by (module, procedure), in which branches on run-time conditions are included and say
    so, and `called`: (module, procedure) of all that runs or may run, those sections included."""

    steps: tuple[Step, ...]
    handlers: Sections
    undos: Sections
    called: frozenset[tuple[str, str]]


def flow(modules: Sequence[Module], entry: str = "main") -> Flow:
    """What :func:`flatten` gives, with all that may run beside it; raises as that does."""
    names = Names(modules)
    runner = Runner(modules, names=names)
    steps = runner.run(entry)
    errors, undo = (_sections(modules, names, which) for which in ("error", "undo"))
    return Flow(steps, errors, undo, _called(modules, names, runner.entered))


def handlers(modules: Sequence[Module]) -> Sections:
    """The :class:`Flow`'s `handlers` alone."""
    return _sections(modules, Names(modules), "error")


def _called(
    modules: Sequence[Module], names: Names, entered: set[tuple[str, str]]
) -> frozenset[tuple[str, str]]:
    """What may run where the straight way has `entered` these procedures."""
    by_name = {(m.name, p.name): p for m in modules for p in reversed(m.procedures)}
    found = set(entered)
    todo = set(found)
    while todo:
        holder, name = todo.pop()
        module, procedure = names.modules[holder.lower()], by_name[holder, name]
        for block in (procedure.error, procedure.undo):
            aside = Runner(modules, handler=True, names=names)
            aside.run_block(module, procedure, block or ())
            todo |= aside.entered - found
            found |= aside.entered
    return frozenset(found)


def _sections(modules: Sequence[Module], names: Names, which: str) -> dict[tuple[str, str], tuple[Step, ...]]:
    found: dict[tuple[str, str], tuple[Step, ...]] = {}
    for module in modules:
        for procedure in module.procedures:
            block = getattr(procedure, which)
            if block is not None:
                runner = Runner(modules, handler=True, names=names)
                found[module.name, procedure.name] = runner.run_block(module, procedure, block)
    return found
