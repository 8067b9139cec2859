"""The cell check of RAPID programs: positions and frames that it compares."""

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from planner.issues import Issue
from planner.languages.rapid import sentences as rapid_sentences
from planner.languages.rapid.reader.configuration import rapid_words
from planner.languages.rapid.reader.flow import CHECK_MODULE
from planner.languages.rapid.reader.program_text import modules_of
from planner.languages.rapid.reader.reader import masked
from planner.languages.rapid.reader.syntax_tree import Instruction, Literal, ProcCall
from planner.programs.stages import TaskText
from planner.programs.steps import BASE_FRAME
from planner.proof.context import Context
from planner.proof.kinematics.external_axes import OuterAxis, outer_axes
from planner.proof.rule import Outcome
from planner.proof.rules.controller_files import CELL_CHECK
from planner.proof.rules.external_axes import OFF_HOME

_BEFORE_CALL = frozenset({"ConfJ", "ConfL", "SingArea", "SetDO", "Reset"})
"""What may stand in main before the call."""
_CHECK_HEAD = ["proc", "check_cell", "(", ")"]
"""First words of the procedure that checks the cell."""
_AXES_HEAD = ["proc", "check_axes", "(", ")"]
"""First words of the procedure that checks the positions of tracks and turntables."""
_DISTANCE, _TURN = 0.1, 0.02
"""How far the controller's frames may be off the plan's [mm], [degrees]."""


def cell_check(context: Context, task: TaskText) -> Outcome:
    """Faults of the comparison of the cell with the plan (verify.cell_check)."""
    hint = "plan again; copy all modules"
    found = _check_faults(context, task)
    return Outcome(
        tuple(Issue(CELL_CHECK, what, arm=task.arm.name, file=file, hint=hint) for file, what in found)
    )


def _check_faults(context: Context, task: TaskText) -> list[tuple[str, str]]:
    own = [path for path in task.files if CHECK_MODULE.match(PurePosixPath(path).name)]
    if len(own) != 1:
        return [(task.name, f"{len(own)} modules compare the cell with the plan; wanted: one, TandemCheck_n")]
    out = [] if _called(task) else [(task.name, "main does not call check_cell before anything else")]
    file = own[0]
    words = rapid_words(task.files[file])
    together = len(context.job.tasks) > 1 and context.job.readings is None
    parts = _parts(words)
    if parts is None:
        return [*out, (file, "it is not of the form that check_cell has")]
    module, body, handler, rest = parts
    axes = outer_axes(task.arm, context.problem.cell.turntable)
    second, looks, rest = _axes_parts(rest) if axes else ([], [], rest)
    if rapid_words(masked(task.files[file])) != [*module, *_CHECK_HEAD, *handler, *second, "endmodule"]:
        out.append((file, "its handler cannot be told from what compares"))
    if looks != _axes_wanted(axes):
        out.append((file, "it does not look as it should whether tracks and turntables are at home"))
    head, calls = _wanted(context, task)
    if module[:1] != ["module"] or len(module) != 2 or rest != rapid_words(_helpers(together, bool(axes))):
        out.append((file, "the procedures that compare are not as they should be"))
    if body[: len(head)] != head:
        out.append((file, "it does not read the base frame as it should, or not of this robot"))
    compared = sorted(body[len(head) :])
    out += [(file, f"it does not compare {_shown_call(lost)}") for lost in sorted(set(calls) - set(compared))]
    if not out and compared != sorted(calls):
        out.append((file, "it does more than compare what was planned"))
    return out


def _shown_call(call: str) -> str:
    found = re.search(r'"([^"]*)"', call)
    return (found.group(1) if found else call) + " with what was planned"


def _called(task: TaskText) -> bool:
    mains = [p for module in modules_of(task.text) for p in module.procedures if p.name.lower() == "main"]
    for statement in mains[0].body if len(mains) == 1 else ():
        if isinstance(statement, ProcCall):
            return statement.name.lower() == "check_cell"
        if not (isinstance(statement, Instruction) and statement.name in _BEFORE_CALL):
            return False
        if statement.name == "SetDO" and not (
            isinstance(statement.arguments[1], Literal) and statement.arguments[1].value == 0
        ):
            return False
    return False


def _parts(words: Sequence[str]) -> tuple[list[str], list[str], list[str], list[str]] | None:
    """Words before the procedure, its statements, words of its handler, which is judged as those of all
    procedures are, and words behind it."""
    text = list(words)
    at = next((i for i in range(len(text)) if text[i : i + 4] == _CHECK_HEAD), None)
    if at is None or "error" not in text[at:] or "endproc" not in text[at:]:
        return None
    handler, end = text.index("error", at), text.index("endproc", at)
    if handler > end or text[-1:] != ["endmodule"]:
        return None
    body: list[str] = [" ".join(part) for part in _split(text[at + 4 : handler])]
    return text[:at], body, text[handler : end + 1], text[end + 1 : -1]


def _axes_parts(rest: Sequence[str]) -> tuple[list[str], list[str], list[str]]:
    """Words of the frame of the procedure that looks at external axes, with its handler, its statements, and
    words behind it; all is behind it where there is none."""
    text = list(rest)
    if text[: len(_AXES_HEAD)] != _AXES_HEAD or "error" not in text or "endproc" not in text:
        return [], [], text
    handler, end = text.index("error"), text.index("endproc")
    if handler > end:
        return [], [], text
    body = [" ".join(part) for part in _split(text[len(_AXES_HEAD) : handler])]
    return [*_AXES_HEAD, *text[handler : end + 1]], body, text[end + 1 :]


def _axes_wanted(axes: Sequence[OuterAxis]) -> list[str]:
    text = "VAR jointtarget cfg_here; cfg_here:=CJointT();" if axes else ""
    for axis in sorted(axes, key=lambda one: one.column):
        here = f"cfg_here.extax.eax_{'abcdef'[axis.column]}"
        name = rapid_sentences.AXIS_OF.filled(unit=axis.unit)
        home = f"{axis.home / axis.scale:.4f}"
        home = home.removeprefix("-") if float(home) == 0.0 else home
        text += f'check_axis "{name}",{here},{home},{OFF_HOME[axis.sign]:g};'
    return _statements(text)


def _split(words: Sequence[str]) -> list[list[str]]:
    out: list[list[str]] = [[]]
    for word in words:
        if word == ";":
            out.append([])
        else:
            out[-1].append(word)
    return out if out[-1] else out[:-1]


def _statements(text: str) -> list[str]:
    return [" ".join(part) for part in _split(rapid_words(text))]


def _wanted(context: Context, task: TaskText) -> tuple[list[str], list[str]]:
    """How the base frame is read, in this order, and the comparisons, in any order."""
    controller = context.problem.cell.controller
    arms = [arm.name for arm in context.problem.cell.arms]
    place = f'"/MOC/ROBOT/{controller.robot(arms.index(task.arm.name))}"'
    read = "VAR pose cfg_base; VAR num cfg_value;"
    for axis in "xyz":
        read += (
            f'ReadCfgData {place},"base_frame_pos_{axis}",cfg_value; cfg_base.trans.{axis}:=1000*cfg_value;'
        )
    for part in range(4):
        read += f'ReadCfgData {place},"base_frame_orient_u{part}",cfg_value;'
        read += f"cfg_base.rot.q{part + 1}:=cfg_value;"
    calls = f'check_pose "{rapid_sentences.BASE_OF.filled(arm=task.arm.name)}",cfg_base,{BASE_FRAME};'
    for data in (data for module in modules_of(task.text) for data in module.data):
        if not isinstance(data.initial, Literal) or data.kind not in ("tooldata", "wobjdata"):
            continue
        calls += _compared(data.name, data.kind, _raw(task, data.name))
    return _statements(read), _statements(calls)


def _compared(name: str, kind: str, value: Sequence[str]) -> str:
    """Comparisons of a declared tool or work object, whose parts are ``value`` as text."""
    if kind == "tooldata":
        text = f'check_pose "{rapid_sentences.FRAME_OF.filled(name=name)}",{name}.tframe,{value[1]};'
        return text + f'check_true "{rapid_sentences.HOLDER_OF.filled(name=name)}",{name}.robhold;'
    text = f'check_pose "{rapid_sentences.OBJECT_FRAME_OF.filled(name=name)}",{name}.oframe,{value[4]};'
    who = f'check_true "{rapid_sentences.HOLDER_OF.filled(name=name)}",NOT {name}.robhold AND '
    if value[1].upper() == "TRUE":
        text += f'check_pose "{rapid_sentences.USER_FRAME_OF.filled(name=name)}",{name}.uframe,{value[3]};'
        return text + f"{who}{name}.ufprog;"
    return text + f"{who}NOT {name}.ufprog AND {name}.ufmec={value[2]};"


def _raw(task: TaskText, name: str) -> list[str]:
    for path, text in task.files.items():
        if CHECK_MODULE.match(PurePosixPath(path).name):
            continue
        if re.search(rf"(?i)\b{name}\s*:=", text) is None:
            continue  # nor without comments, of which each leaves a semicolon
        plain = re.sub(r"(?m)^\s*!.*|;\s*!.*", ";", text)
        found = re.search(rf"(?i)\b{name}\s*:=\s*\[(.*?)\]\s*;", plain, re.DOTALL)
        if found is not None:
            return _components(found.group(1))
    return [""] * 5


def _components(text: str) -> list[str]:
    out, depth, quoted = [""], 0, False
    for sign in text:
        quoted ^= sign == '"'
        depth += 0 if quoted else (sign == "[") - (sign == "]")
        if sign == "," and depth == 0 and not quoted:
            out.append("")
        else:
            out[-1] += sign
    return [part.strip() for part in out] + [""] * 5


def _helpers(together: bool, axes: bool) -> str:
    """The procedures that compare, as they have to be; ``axes``: tracks and turntables, too."""
    parts = ("1", "2", "3", "4")
    dot = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in parts)
    squares = "+".join(f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in parts)
    stop = "Stop\\AllMoveTasks" if together else "Stop"
    axis = f"""
    PROC check_axis(string what, num got, num wanted, num most)
      IF Abs(got-wanted)>most THEN
        TPWrite what; TPWrite "{rapid_sentences.OFF_HOME}"\\Num:=got-wanted; check_stop;
      ENDIF
    ENDPROC"""
    said_last = "".join(f'TPWrite "{line}";' for line in rapid_sentences.NOTHING_MOVES)
    return f"""
    PROC check_pose(string what, pose got, pose wanted)
      VAR num off_sign:=1; VAR num off_turn;
      IF {dot}<0 THEN off_sign:=-1; ENDIF
      off_turn:=114.591559*Sqrt({squares});
      IF Distance(got.trans,wanted.trans)>{_DISTANCE} OR off_turn>{_TURN} THEN
        TPWrite what; TPWrite "{rapid_sentences.OFF_BY_MM}"\\Num:=Distance(got.trans,wanted.trans);
        TPWrite "{rapid_sentences.OFF_BY_DEGREES}"\\Num:=off_turn; check_stop;
      ENDIF
    ENDPROC
    PROC check_true(string what, bool same)
      IF NOT same THEN TPWrite what; TPWrite "{rapid_sentences.NOT_AS_PLANNED}"; check_stop; ENDIF
    ENDPROC
    {axis if axes else ""}
    PROC check_stop()
      {said_last} WHILE TRUE DO {stop}; ENDWHILE
    ENDPROC
    """
