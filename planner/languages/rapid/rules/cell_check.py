"""The rule verify.cell_check on the cell check of RAPID programs: frames and positions that it compares."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from planner.issues import Issue
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.reader.configuration import rapid_words
from planner.languages.rapid.reader.flow import CHECK_MODULE
from planner.languages.rapid.reader.program_text import modules_of
from planner.languages.rapid.reader.reader import mask_comparisons
from planner.languages.rapid.reader.syntax_tree import Instruction, Literal, ProcCall
from planner.programs.stages import TaskText
from planner.programs.steps import BASE_FRAME
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import TaskAxis, task_axes
from planner.proof.rule import RuleOutcome
from planner.proof.rules.controller_files import CELL_CHECK
from planner.proof.rules.external_axes import HOME_TOLERANCES

_ALLOWED_BEFORE_CALL = frozenset({"ConfJ", "ConfL", "SingArea", "SetDO", "Reset"})
"""Statements that may precede the call in main."""
_CHECK_HEAD = ["proc", "check_cell", "(", ")"]
"""First tokens of the procedure that checks the cell."""
_AXES_HEAD = ["proc", "check_axes", "(", ")"]
"""First tokens of the procedure that checks the positions of tracks and turntables."""
_POSITION_TOLERANCE_MM = 0.1
"""Maximum distance between a frame of the controller and that of the plan [mm]."""
_ROTATION_TOLERANCE_DEG = 0.02
"""Maximum rotation between a frame of the controller and that of the plan [degrees]."""


def cell_check(context: Context, task: TaskText) -> RuleOutcome:
    """Check the module that compares the controller's data with the plan (verify.cell_check).

    Args:
        context: The proof.
        task: The task.
    """
    hint = "plan again; copy all modules"
    faults = _check_faults(context, task)
    return RuleOutcome(
        tuple(Issue(CELL_CHECK, what, arm=task.arm.name, file=file, hint=hint) for file, what in faults)
    )


def _check_faults(context: Context, task: TaskText) -> list[tuple[str, str]]:
    """Return the faults of the check module and of its call in main, each as (file, message).

    The module must have the expected tokens; the order of comparisons is free. Another rule checks handlers.
    """
    check_modules = [path for path in task.files if CHECK_MODULE.match(PurePosixPath(path).name)]
    if len(check_modules) != 1:
        return [
            (
                task.name,
                f"{len(check_modules)} modules compare the cell with the plan; required: one, TandemCheck_n",
            )
        ]
    faults = (
        [] if _is_called_first(task) else [(task.name, "main does not call check_cell before anything else")]
    )
    file = check_modules[0]
    words = rapid_words(task.files[file])
    multiple_tasks = len(context.job.tasks) > 1 and context.job.automata_by_arm is None
    parts = _split_module(words)
    if parts is None:
        return [*faults, (file, "the procedure check_cell does not have its expected form")]
    module, body, handler, rest = parts
    axes = task_axes(task.arm, context.problem.cell.turntable)
    axes_frame, axes_statements, rest = _split_axes_check(rest) if axes else ([], [], rest)
    # the reader sees the handlers only if what it masks is exactly the comparing code
    if rapid_words(mask_comparisons(task.files[file])) != [
        *module,
        *_CHECK_HEAD,
        *handler,
        *axes_frame,
        "endmodule",
    ]:
        faults.append((file, "its error handler cannot be separated from its comparisons"))
    if axes_statements != _expected_axes_check(axes):
        faults.append((file, "it does not check correctly that tracks and turntables are at home"))
    reading, calls = _expected_statements(context, task)
    if (
        module[:1] != ["module"]
        or len(module) != 2
        or rest != rapid_words(_expected_helpers(multiple_tasks, bool(axes)))
    ):
        faults.append((file, "the comparing procedures differ from their expected text"))
    if body[: len(reading)] != reading:
        faults.append((file, "it does not read the base frame of this robot as expected"))
    compared = sorted(body[len(reading) :])
    faults += [
        (file, f"it does not compare {_describe_call(call)}") for call in sorted(set(calls) - set(compared))
    ]
    if not faults and compared != sorted(calls):
        faults.append((file, "it does more than the expected comparisons"))
    return faults


def _describe_call(call: str) -> str:
    """Describe a comparison for a message: by its first string if it has one, else by its tokens."""
    match = re.search(r'"([^"]*)"', call)
    return (match.group(1) if match else call) + " with the plan"


def _is_called_first(task: TaskText) -> bool:
    """Return whether main calls check_cell before any other procedure or move.

    Only settings of the motion and outputs that are set to 0 may precede the call.
    """
    mains = [
        procedure
        for module in modules_of(task.text)
        for procedure in module.procedures
        if procedure.name.lower() == "main"
    ]
    for statement in mains[0].body if len(mains) == 1 else ():
        if isinstance(statement, ProcCall):
            return statement.name.lower() == "check_cell"
        if not (isinstance(statement, Instruction) and statement.name in _ALLOWED_BEFORE_CALL):
            return False
        if statement.name == "SetDO" and not (
            isinstance(statement.arguments[1], Literal) and statement.arguments[1].value == 0
        ):
            return False
    return False


def _split_module(words: Sequence[str]) -> tuple[list[str], list[str], list[str], list[str]] | None:
    """Split the tokens of a check module at the procedure check_cell; None if it has not the required form.

    Returns:
        Tokens before the procedure, its statements, tokens of its error handler to ENDPROC, and tokens after
        it without ENDMODULE.
    """
    tokens = list(words)
    start = next((i for i in range(len(tokens)) if tokens[i : i + 4] == _CHECK_HEAD), None)
    if start is None or "error" not in tokens[start:] or "endproc" not in tokens[start:]:
        return None
    handler, end = tokens.index("error", start), tokens.index("endproc", start)
    if handler > end or tokens[-1:] != ["endmodule"]:
        return None
    body: list[str] = [" ".join(part) for part in _split_statements(tokens[start + 4 : handler])]
    return tokens[:start], body, tokens[handler : end + 1], tokens[end + 1 : -1]


def _split_axes_check(rest: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Split the tokens after check_cell at the end of the procedure check_axes.

    Returns:
        Head and error handler of check_axes as tokens, its statements, and the tokens after it. Without such
        a procedure, the first two are empty and the last are all tokens.
    """
    tokens = list(rest)
    if tokens[: len(_AXES_HEAD)] != _AXES_HEAD or "error" not in tokens or "endproc" not in tokens:
        return [], [], tokens
    handler, end = tokens.index("error"), tokens.index("endproc")
    if handler > end:
        return [], [], tokens
    body = [" ".join(part) for part in _split_statements(tokens[len(_AXES_HEAD) : handler])]
    return [*_AXES_HEAD, *tokens[handler : end + 1]], body, tokens[end + 1 :]


def _expected_axes_check(axes: Sequence[TaskAxis]) -> list[str]:
    """Return the expected statements of check_axes, in order of the columns.

    They compare the external axes with their home values.
    """
    text = "VAR jointtarget cfg_here; cfg_here:=CJointT();" if axes else ""
    for axis in sorted(axes, key=lambda external_axis: external_axis.column):
        value = f"cfg_here.extax.eax_{'abcdef'[axis.column]}"
        name = rapid_sentences.AXIS_OF.format(unit=axis.label)
        home = f"{axis.home / axis.scale:.4f}"
        home = home.removeprefix("-") if float(home) == 0.0 else home
        text += f'check_axis "{name}",{value},{home},{HOME_TOLERANCES[axis.unit_symbol]:g};'
    return _statements(text)


def _split_statements(words: Sequence[str]) -> list[list[str]]:
    """Split tokens at semicolons."""
    statements: list[list[str]] = [[]]
    for word in words:
        if word == ";":
            statements.append([])
        else:
            statements[-1].append(word)
    return statements if statements[-1] else statements[:-1]


def _statements(text: str) -> list[str]:
    """Return the statements of a text, each as its tokens joined by spaces."""
    return [" ".join(part) for part in _split_statements(rapid_words(text))]


def _expected_statements(context: Context, task: TaskText) -> tuple[list[str], list[str]]:
    """Return the expected statements of a check module: those that read the base frame, and comparisons.

    The first ones must be in this order. The comparisons may be in any order.
    """
    controller = context.problem.cell.controller
    arms = [arm.name for arm in context.problem.cell.arms]
    config_path = f'"/MOC/ROBOT/{controller.robot_name(arms.index(task.arm.name))}"'
    read = "VAR pose cfg_base; VAR num cfg_value;"
    for axis in "xyz":
        read += (
            f'ReadCfgData {config_path},"base_frame_pos_{axis}",cfg_value; '
            f"cfg_base.trans.{axis}:=1000*cfg_value;"
        )
    for part in range(4):
        read += f'ReadCfgData {config_path},"base_frame_orient_u{part}",cfg_value;'
        read += f"cfg_base.rot.q{part + 1}:=cfg_value;"
    calls = f'check_pose "{rapid_sentences.BASE_OF.format(arm=task.arm.name)}",cfg_base,{BASE_FRAME};'
    for data in (data for module in modules_of(task.text) for data in module.data):
        if not isinstance(data.initial, Literal) or data.kind not in ("tooldata", "wobjdata"):
            continue
        calls += _comparisons(data.name, data.kind, _declared_components(task, data.name))
    return _statements(read), _statements(calls)


def _comparisons(name: str, kind: str, value: Sequence[str]) -> str:
    """Return the expected statements that compare a declared tool or work object with the controller's data.

    ``value`` has its components as texts: those of tooldata are robhold, tframe and tload, and those of
    wobjdata are robhold, ufprog, ufmec, uframe and oframe.
    """
    if kind == "tooldata":
        text = f'check_pose "{rapid_sentences.FRAME_OF.format(name=name)}",{name}.tframe,{value[1]};'
        return text + f'check_true "{rapid_sentences.HOLDER_OF.format(name=name)}",{name}.robhold;'
    text = f'check_pose "{rapid_sentences.OBJECT_FRAME_OF.format(name=name)}",{name}.oframe,{value[4]};'
    holder_check = f'check_true "{rapid_sentences.HOLDER_OF.format(name=name)}",NOT {name}.robhold AND '
    if value[1].upper() == "TRUE":
        text += f'check_pose "{rapid_sentences.USER_FRAME_OF.format(name=name)}",{name}.uframe,{value[3]};'
        return text + f"{holder_check}{name}.ufprog;"
    return text + f"{holder_check}NOT {name}.ufprog AND {name}.ufmec={value[2]};"


def _declared_components(task: TaskText, name: str) -> list[str]:
    """Return the texts of the components with which a datum is declared in a task.

    Declarations in check modules do not count. Five empty texts follow, which stand for missing components.
    """
    for path, text in task.files.items():
        if CHECK_MODULE.match(PurePosixPath(path).name):
            continue
        if re.search(rf"(?i)\b{name}\s*:=", text) is None:
            continue  # a comment becomes one semicolon below, so the name would not appear then either
        without_comments = re.sub(r"(?m)^\s*!.*|;\s*!.*", ";", text)
        match = re.search(rf"(?i)\b{name}\s*:=\s*\[(.*?)\]\s*;", without_comments, re.DOTALL)
        if match is not None:
            return _components(match.group(1))
    return [""] * 5


def _components(text: str) -> list[str]:
    """Split an aggregate at the commas outside of brackets and strings.

    Five empty texts are appended, so that missing components of a record can be read.
    """
    parts = [""]
    depth = 0
    quoted = False
    for character in text:
        quoted ^= character == '"'  # each quote starts or ends a string
        depth += 0 if quoted else (character == "[") - (character == "]")
        if character == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts] + [""] * 5


def _expected_helpers(multiple_tasks: bool, with_axes: bool) -> str:
    """Return the expected text of the procedures that check_cell calls to compare, report and stop.

    ``multiple_tasks`` stops all tasks of the controller. ``with_axes`` adds the procedure that compares
    tracks and turntables. The angle between unit quaternions p and q of equal
    sign is 4 asin(|p - q| / 2): for small angles 2 |p - q| [rad], or 114.59 |p - q| [degrees].
    """
    numbers = ("1", "2", "3", "4")
    dot = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in numbers)
    squares = "+".join(f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in numbers)
    stop = "Stop\\AllMoveTasks" if multiple_tasks else "Stop"
    axis = f"""
    PROC check_axis(string what, num got, num wanted, num most)
      IF Abs(got-wanted)>most THEN
        TPWrite what; TPWrite "{rapid_sentences.HOME_DEVIATION}"\\Num:=got-wanted; check_stop;
      ENDIF
    ENDPROC"""
    final_texts = "".join(f'TPWrite "{line}";' for line in rapid_sentences.MOTION_BLOCKED)
    return f"""
    PROC check_pose(string what, pose got, pose wanted)
      VAR num off_sign:=1; VAR num off_turn;
      IF {dot}<0 THEN off_sign:=-1; ENDIF
      off_turn:=114.591559*Sqrt({squares});
      IF Distance(got.trans,wanted.trans)>{_POSITION_TOLERANCE_MM} OR off_turn>{_ROTATION_TOLERANCE_DEG} THEN
        TPWrite what; TPWrite "{rapid_sentences.POSITION_DEVIATION}"\\Num:=Distance(got.trans,wanted.trans);
        TPWrite "{rapid_sentences.ROTATION_DEVIATION}"\\Num:=off_turn; check_stop;
      ENDIF
    ENDPROC
    PROC check_true(string what, bool same)
      IF NOT same THEN TPWrite what; TPWrite "{rapid_sentences.DIFFERS_FROM_PLAN}"; check_stop; ENDIF
    ENDPROC
    {axis if with_axes else ""}
    PROC check_stop()
      {final_texts} WHILE TRUE DO {stop}; ENDWHILE
    ENDPROC
    """
