"""Everything that a task does or may do: its main flow through the modules, and its ERROR and UNDO sections.

On the main flow calls are expanded and names replaced by values. Conditions on constants are decided. A
condition that is only known at run time (an operator's answer, IsSyncMoveOn()) must not decide over motion,
signals or synchronisation: such a program cannot be proven and is refused.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

from planner.languages.rapid.reader.evaluation import UNKNOWN, Evaluator, NameTable
from planner.languages.rapid.reader.lexer import INSTRUCTIONS
from planner.languages.rapid.reader.syntax_tree import (
    PREDEFINED,
    Assign,
    DataDeclaration,
    Expr,
    For,
    If,
    Instruction,
    LateCall,
    Module,
    MoveStatement,
    Name,
    ProcCall,
    Procedure,
    RapidStatement,
    Value,
    While,
)
from planner.programs.steps import (
    CallStep,
    CarryStep,
    ChoiceStep,
    FlowError,
    LoadStep,
    MessageStep,
    MoveStep,
    ProgramStep,
    SettingStep,
    SignalStep,
    SyncStep,
    TextFault,
    WaitStep,
    WorkObject,
    to_single,
)

CHECK_MODULE = re.compile(r"(?i)TandemCheck_\w+\.(modx?)$")
"""Names of the modules that compare the cell with the plan; a separate rule reads them."""
AXES_CHECK_PROCEDURE = "check_axes"
"""Name of the procedure in a check module that checks external axes, and kind of the step for its call."""
MAX_CALL_DEPTH = 50
"""Maximum call depth of procedures."""
MAX_ITERATIONS = 100_000
"""Maximum number of iterations of a FOR."""
_END_STATEMENTS = ("RETURN", "EXIT", "RAISE", "RETRY", "TRYNEXT")
"""Statements that end a procedure or handler."""
_MESSAGE_STATEMENTS = ("TPWrite", "TPErase", "UIMsgBox", "TPReadFK", "ErrWrite")
"""Statements that show a text or ask a question."""
_STOP_STATEMENTS = ("EXIT", "Stop", "StopMove")
"""Statements that stop the motion."""


class _LeaveError(Exception):
    """Raised at a RETURN, EXIT, RAISE, RETRY or TRYNEXT (``word``), to leave the procedure."""

    def __init__(self, word: str) -> None:
        super().__init__(word)
        self.word = word


class RapidRunner(Evaluator):
    """Executes procedures symbolically and collects their steps.

    Attributes:
        handler: Whether this is an ERROR or UNDO section, whose steps may depend on run-time conditions.
        steps: Steps so far.
        procedure: Name of the current procedure.
        condition: Run-time condition of the current branch, "" for none.
        depth: Call depth.
        entered: (module, procedure) of everything that ran or may run.
        modules: Modules by lower-case name.
        assigned: Values that were assigned so far, see `Evaluator`.
    """

    def __init__(
        self, modules: Sequence[Module], handler: bool = False, names: NameTable | None = None
    ) -> None:
        super().__init__(modules, names)
        self.handler = handler
        self.steps: list[ProgramStep] = []
        self.procedure = ""
        self.condition = ""
        self.depth = 0
        self.entered: set[tuple[str, str]] = set()
        self._offset = 0

    # ---- entry ----

    def run(self, entry: str) -> tuple[ProgramStep, ...]:
        """Return all steps of a procedure, with those of the procedures that it calls.

        Args:
            entry: Name of the procedure.

        Raises:
            FlowError: The procedure is missing, local or not unique, calls never end, or a run-time condition
                decides over motion, signals or synchronisation.
        """
        entries = [
            (module, procedure)
            for module in self.modules.values()
            for procedure in module.procedures
            if procedure.name.lower() == entry.lower()
        ]
        if len(entries) == 1 and not entries[0][1].local:
            return self.run_block(*entries[0], entries[0][1].body)
        cause = f"several procedures {entry}, or a local procedure," if entries else f"no procedure {entry}"
        raise FlowError([TextFault(1, 1, "rapid.flow", f"{cause} in the task's modules", self.module.file)])

    def run_block(
        self, module: Module, procedure: Procedure, body: Sequence[RapidStatement]
    ) -> tuple[ProgramStep, ...]:
        """Execute a block of a procedure and return all steps so far.

        The block ends early at a RETURN, EXIT or similar statement (`_LeaveError`).

        Args:
            module: Module of the procedure.
            procedure: The procedure.
            body: Statements of the block: the body, or the ERROR or UNDO section.
        """
        self.module = module
        self.procedure = procedure.name
        self.entered.add((module.name, procedure.name))
        self._offset = procedure.start
        with suppress(_LeaveError):
            try:
                self.block(body)
            except RecursionError:
                raise self.flow_error(self._offset, "blocks and calls are nested too deeply") from None
        return tuple(self.steps)

    # ---- statements ----

    def block(self, statements: Sequence[RapidStatement]) -> None:
        """Execute statements in order."""
        for statement in statements:
            self.statement(statement)

    def statement(self, statement: RapidStatement) -> None:
        """Execute one statement and append its effects to ``steps``.

        The statements of a called procedure are executed at the place of the call.
        """
        self._spend(statement, 5 if isinstance(statement, MoveStatement) else 1)
        match statement:
            case MoveStatement():
                self.steps.append(self._move(statement))
            case Instruction():
                self._instruction(statement)
            case Assign():
                self._assign(statement.target, self.value(statement.value, self._kind(statement.target)))
            case ProcCall():
                self._append_axes_check(statement)
                self.call(statement.start, statement.name)
            case LateCall():
                name = self.value(statement.name, "string")
                if not isinstance(name, str):
                    raise self.flow_error(
                        statement.start, "the name of the called procedure is known at run time only"
                    )
                self.steps.append(CallStep(*self._where(statement), name))
                self.call(statement.start, name)
            case If():
                self._if(statement)
            case While():
                self._while(statement)
            case For():
                self._for(statement)

    def _spend(self, statement: RapidStatement, cost: int) -> None:
        """Subtract the cost of a statement from the budget, which stops loops and calls that never end."""
        self._offset = statement.start
        self.names.budget -= cost
        if self.names.budget < 0:
            raise self.flow_error(
                statement.start, "the program has no end, or executes its lines too often to be read"
            )

    def _append_axes_check(self, statement: ProcCall) -> None:
        """Append a step if a statement calls the check of external axes, which a separate rule reads."""
        declaration = self.find(statement.name.lower())
        file = "" if declaration is None else PurePosixPath(declaration[0].file).name
        if statement.name.lower() == AXES_CHECK_PROCEDURE and CHECK_MODULE.match(file):
            self.steps.append(SettingStep(*self._where(statement), AXES_CHECK_PROCEDURE, (), ()))

    def call(self, start: int, name: str) -> None:
        """Execute a procedure at the place of its call.

        Args:
            start: Offset of the call.
            name: Name of the procedure, perhaps as "module:procedure".
        """
        holder, _, short = name.rpartition(":")
        declaration = self.find(short.lower())
        if holder:
            module = self.modules.get(holder.lower())
            items = self.names.items(module).get(short.lower(), []) if module else []
            declaration = (module, items[0]) if module and items else None
        if declaration is None or not isinstance(declaration[1], Procedure):
            raise self.flow_error(start, f"no procedure {name} in the task's modules")
        if self.depth >= MAX_CALL_DEPTH:
            raise self.flow_error(
                start, f"calls nested more than {MAX_CALL_DEPTH} deep; {name} may call itself"
            )
        caller = self.module, self.procedure
        called_module, called = declaration[0], declaration[1]
        self.entered.add((called_module.name, called.name))
        self.module = called_module
        self.procedure = called.name
        self.depth += 1
        try:
            self.block(called.body)
        except _LeaveError as leave:
            if leave.word != "RETURN":
                raise  # EXIT, RAISE, RETRY and TRYNEXT also leave the caller
        finally:
            self.module, self.procedure = caller
            self.depth -= 1

    def _where(self, statement: RapidStatement) -> tuple[str, str, int, str]:
        """Return the first four fields of a `ProgramStep`: module, procedure, line and condition."""
        return self.module.name, self.procedure, statement.line, self.condition

    def _kind(self, name: Name) -> str:
        """Return the RAPID type of declared data, or num for other names, such as loop counters."""
        declaration = self.find(name.key)
        return declaration[1].kind if declaration and isinstance(declaration[1], DataDeclaration) else "num"

    def _assign(self, name: Expr, value: Value) -> None:
        """Store the value that a statement assigns to declared data; other expressions are ignored.

        ``value`` is UNKNOWN if the value is only known at run time, as the answer of an operator is.
        """
        if isinstance(name, Name):
            declaration = self.find(name.key)
            if declaration:
                self.assigned[declaration[0].name.lower(), name.key] = value

    def _require_value(self, expr: Expr, kind: str) -> Value:
        """Return the value of an expression; raise a FlowError if it is only known at run time."""
        value = self.value(expr, kind)
        if value is None:
            raise self.flow_error(
                expr.start, f"this {kind} is known at run time only; the motion cannot be proven"
            )
        return value

    def _move(self, move: MoveStatement) -> MoveStep:
        """Return the step of a move, with all names replaced by their values.

        Raises:
            FlowError: A value is only known at run time.
        """
        form = INSTRUCTIONS[move.kind.lower()]
        target = self._require_value(move.target, form.required[0])
        ident = None if move.id is None else int(self._require_value(move.id, "num"))
        time = None if move.time is None else to_single(self._require_value(move.time, "num"))
        velocity = (
            None if move.velocity is None else to_single(self._require_value(move.velocity, "num")) * 1e-3
        )
        wobj: WorkObject = (
            PREDEFINED["wobj0"][1] if move.wobj is None else self._require_value(move.wobj, "wobjdata")
        )
        return MoveStep(
            *self._where(move),
            move.kind,
            target,
            _name_text(move.target),
            ident,
            time,
            velocity,
            self._require_value(move.speed, "speeddata"),
            self._require_value(move.zone, "zonedata"),
            _name_text(move.zone),
            self._require_value(move.tool, "tooldata"),
            _name_text(move.tool),
            wobj,
            "wobj0" if move.wobj is None else _name_text(move.wobj),
            move.switches,
        )

    def _instruction(self, statement: Instruction) -> None:
        """Append the step of a built-in instruction that is no move.

        Signal values, meetings, files and loads must be known before run time. Other instructions become a
        `SettingStep` with their options and their numbers.

        Raises:
            FlowError: A value that must be known is only known at run time.
            _LeaveError: The instruction ends the procedure and depends on no run-time condition.
        """
        name, arguments, options = statement.name, statement.arguments, dict(statement.options)
        where = self._where(statement)
        if name in ("SetDO", "Set", "Reset"):
            value = self._require_value(arguments[1], "num") if name == "SetDO" else float(name == "Set")
            delay = self.value(options.get("sdelay"), "num") or 0.0
            self.steps.append(
                SignalStep(*where, name, _name_text(arguments[0]), value, delay, "sync" in options)
            )
        elif name in ("WaitTime", "WaitRob", "WaitDI"):
            seconds = self.value(arguments[0] if name == "WaitTime" else options.get("maxtime"), "num")
            signal = _name_text(arguments[0]) if name == "WaitDI" else ""
            value = self.value(arguments[1], "num") if name == "WaitDI" else None
            flag = options.get("timeflag")
            flag_name = _name_text(flag) if flag is not None else ""
            self.steps.append(WaitStep(*where, name, seconds, signal, value, "inpos" in options, flag_name))
            if flag is not None:
                self._assign(flag, UNKNOWN)
        elif name in _MESSAGE_STATEMENTS:
            self._message(statement, options)
        elif name.startswith(("WaitSync", "SyncMove")):
            ident = _name_text(arguments[0]) if arguments else ""
            tasks = self._require_value(arguments[1], "tasks") if len(arguments) > 1 else ()
            self.steps.append(SyncStep(*where, name, ident, tasks, "timeout" in options))
        elif name in ("Load", "UnLoad"):
            path = self._require_value(arguments[0], "string")
            file = self.value(options.get("file"), "string")
            self.steps.append(LoadStep(*where, name, path + (f"/{file}" if file else "")))
        elif name in ("ActUnit", "DeactUnit"):
            self.steps.append(SettingStep(*where, name, (), (), unit=_name_text(arguments[0]).lower()))
        elif name == "GripLoad":
            self.steps.append(
                CarryStep(*where, self._require_value(arguments[0], "loaddata"), _name_text(arguments[0]))
            )
        else:
            values = tuple(
                self.value(argument, "num") for argument in arguments if not isinstance(argument, Name)
            )
            self.steps.append(SettingStep(*where, name, tuple(options), values, stops=name == "Stop"))
            if name in _END_STATEMENTS and not self.condition:
                raise _LeaveError(name)

    def _message(self, statement: Instruction, options: dict[str, Expr | None]) -> None:
        """Append the step of a statement that shows a text or asks a question.

        "..." stands for text that is known at run time only. Results of questions become UNKNOWN.
        """
        name, arguments = statement.name, statement.arguments
        shown = [value for value in (options.get("header"), *arguments) if value is not None]
        # the panel shows lines by number, in whatever order the text lists them
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
        waits_for_operator = name in ("UIMsgBox", "TPReadFK")
        text = " ".join(lines[1:] if options.get("header") is not None else lines)
        button = options.get("buttons")
        # the program continues only after OK: no timeout, no other answer, and OK is the only button
        only_ok = name == "UIMsgBox" and "maxtime" not in options and "result" not in options
        only_ok = only_ok and (button is None or self.value(button, "num") == PREDEFINED["btnok"][1])
        panel: Literal["line", "clear", ""] = (
            "line" if name == "TPWrite" else "clear" if name == "TPErase" else ""
        )
        header = lines[0] if options.get("header") is not None else ""
        other_options = tuple(
            (key, "" if value is None else _name_text(value))
            for key, value in options.items()
            if key != "header" and not key.startswith("msgline")
        )
        self.steps.append(
            MessageStep(
                *self._where(statement),
                name,
                lines,
                waits_for_operator,
                text,
                only_ok,
                panel,
                header,
                other_options,
            )
        )

    # ---- branches and loops ----

    def _if(self, statement: If) -> None:
        """Execute the branch whose condition is known to hold, or all branches that may be executed.

        As soon as one condition is only known at run time, this branch and all later ones that may hold are
        collected as choices, with ELSE.
        """
        undecided = ""  # text of the last condition that is only known at run time, "" for none
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
        """Execute a loop while its condition is known to hold, then as a choice if it is unknown."""
        while (truth := self.value(statement.condition, "bool")) is True:
            self._spend(statement, 1)
            self.block(statement.body)
        if truth is None:
            self._choice(statement, statement.source, lambda: self.block(statement.body), repeats=True)

    def _for(self, statement: For) -> None:
        """Execute a counted loop, whose range must be known before run time.

        Without STEP the step is 1 or -1, towards the last value. ``MAX_ITERATIONS`` limits the steps.
        """
        first, last = self._require_value(statement.first, "num"), self._require_value(statement.last, "num")
        step = (
            self._require_value(statement.step, "num") if statement.step else (1.0 if last >= first else -1.0)
        )
        if step == 0 or abs(last - first) > MAX_ITERATIONS * abs(step):
            raise self.flow_error(statement.start, f"FOR from {first:g} to {last:g} by {step:g} does not end")
        key = ("for", statement.name.lower())
        outer = self.assigned.get(key)
        # 1e-9 of a step keeps the last iteration if the division gives slightly less than a whole number
        for count in range(int((last - first) / step + 1e-9) + 1 if (last - first) / step >= 0 else 0):
            self._spend(statement, 1)
            self.assigned[key] = first + count * step
            self.block(statement.body)
        self.assigned[key] = outer

    def _choice(
        self, statement: RapidStatement, condition: str, run: Callable[[], None], repeats: bool = False
    ) -> None:
        """Collect the steps of a branch under a run-time condition; refuse those that must not depend on one.

        ``run`` executes the branch. ``repeats`` is True for a loop. In a handler all steps are allowed.
        """
        self._spend(statement, 1 + len(self.assigned))  # the assigned values are copied below
        outer_steps, outer_condition = self.steps, self.condition
        assigned_before = dict(self.assigned)
        self.steps = []
        self.condition = condition if not outer_condition else f"{outer_condition} and {condition}"
        try:
            run()
        except _LeaveError:
            pass
        finally:
            branch_steps, self.steps, self.condition = self.steps, outer_steps, outer_condition
        # values that the branch may or may not have assigned are unknown after it; ``self`` marks a new key
        self.assigned = {
            key: value if assigned_before.get(key, self) is value else UNKNOWN
            for key, value in self.assigned.items()
        }
        where = (self.module.name, self.procedure, statement.line, condition)
        if self.handler:
            self.steps.extend(branch_steps)
            return
        for step in branch_steps:
            if not _harmless(step, branch_steps):
                raise self.flow_error(
                    statement.start,
                    f"whether line {step.line} is executed is known at run time only ({condition})",
                )
        self.steps.append(ChoiceStep(*where, tuple(branch_steps), repeats))


def _harmless(step: ProgramStep, branch: Sequence[ProgramStep]) -> bool:
    """Return whether a step of a branch may depend on a run-time condition.

    It may if it shows text, waits, stops the task, or is a procedure's late-bound call or a nested choice. In
    a branch that ends the task with EXIT, signals may be switched off without delay. A step that leaves its
    procedure (RETURN, RAISE) may not, because it would skip the statements that follow there.
    """
    last_step = branch[-1]
    # the EXIT depends on no further condition than the first step of the branch
    ends_task = (
        isinstance(last_step, SettingStep)
        and last_step.kind == "EXIT"
        and last_step.condition == branch[0].condition
    )
    match step:
        case SettingStep():
            return step.kind in _STOP_STATEMENTS
        case SignalStep():
            return ends_task and step.value == 0.0 and not step.delay
        case _:
            return isinstance(step, MessageStep | WaitStep | CallStep | ChoiceStep)


def _name_text(expr: Expr) -> str:
    """Return a name as written, "" for any other expression."""
    return expr.text if isinstance(expr, Name) else ""


Sections = Mapping[tuple[str, str], tuple[ProgramStep, ...]]
"""Steps of the ERROR or UNDO sections, by names of module and procedure."""


def main_steps(modules: Sequence[Module], entry: str = "main") -> tuple[ProgramStep, ...]:
    """Return the steps of a task's main flow, with calls expanded.

    Args:
        modules: Modules without faults (`reader.read_task`).
        entry: Procedure to start from.

    Raises:
        FlowError: The entry is missing, the calls never end, or run-time conditions decide over motion.
    """
    return RapidRunner(modules).run(entry)


@dataclass(frozen=True, slots=True)
class TaskFlow:
    """Everything that a task may do.

    Attributes:
        steps: Steps of the main flow.
        handlers: Steps of each ERROR section by (module, procedure). Branches on run-time conditions are
            included, and their steps state the condition.
        undos: Steps of each UNDO section by (module, procedure), with branches included in the same way.
        called: (module, procedure) of everything that runs or may run, those sections included.
    """

    steps: tuple[ProgramStep, ...]
    handlers: Sections
    undos: Sections
    called: frozenset[tuple[str, str]]


def task_flow(modules: Sequence[Module], entry: str = "main") -> TaskFlow:
    """Return the main flow of a task as :func:`main_steps` does, and its ERROR and UNDO sections.

    Args:
        modules: Modules without faults.
        entry: Procedure to start from.

    Raises:
        FlowError: The entry is missing, the calls never end, or run-time conditions decide over motion.
    """
    names = NameTable(modules)
    runner = RapidRunner(modules, names=names)
    steps = runner.run(entry)
    handlers = _sections(modules, names, "error")
    undos = _sections(modules, names, "undo")
    return TaskFlow(steps, handlers, undos, _called_procedures(modules, names, runner.entered))


def error_handlers(modules: Sequence[Module]) -> Sections:
    """Return the steps of all ERROR sections by (module, procedure)."""
    return _sections(modules, NameTable(modules), "error")


def _called_procedures(
    modules: Sequence[Module], names: NameTable, entered: set[tuple[str, str]]
) -> frozenset[tuple[str, str]]:
    """Return (module, procedure) of all procedures that may run, for the rule against hidden procedures.

    The main flow runs those in ``entered``. Their ERROR and UNDO sections may call further procedures, whose
    sections may again call others.
    """
    # reversed: of procedures with equal names, the first one counts
    by_name = {
        (module.name, procedure.name): procedure
        for module in modules
        for procedure in reversed(module.procedures)
    }
    called = set(entered)
    todo = set(called)
    while todo:
        holder, name = todo.pop()
        module, procedure = names.modules[holder.lower()], by_name[holder, name]
        for block in (procedure.error, procedure.undo):
            runner = RapidRunner(modules, handler=True, names=names)
            runner.run_block(module, procedure, block or ())
            todo |= runner.entered - called
            called |= runner.entered
    return frozenset(called)


def _sections(
    modules: Sequence[Module], names: NameTable, section: str
) -> dict[tuple[str, str], tuple[ProgramStep, ...]]:
    """Return the steps of each section of one kind, by module and procedure.

    ``section`` is "error" for ERROR sections and "undo" for UNDO sections.
    """
    sections: dict[tuple[str, str], tuple[ProgramStep, ...]] = {}
    for module in modules:
        for procedure in module.procedures:
            block = getattr(procedure, section)
            if block is not None:
                runner = RapidRunner(modules, handler=True, names=names)
                sections[module.name, procedure.name] = runner.run_block(module, procedure, block)
    return sections
