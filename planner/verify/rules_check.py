"""The rule on the module that compares the cell with the plan at run time, and what readers see of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePosixPath

from planner import controller_texts as said
from planner.issues import Issue
from planner.verify.context import BASE_FRAME, Context, Outcome
from planner.verify.controller_text import rapid_words
from planner.verify.job import TaskText
from planner.verify.rapid_ast import Instruction, Literal, ProcCall
from planner.verify.rapid_reader import CHECK, masked

CODE = "verify.cell_check"
_BEFORE = frozenset({"ConfJ", "ConfL", "SingArea", "SetDO", "Reset"})
"""What may stand in main before the call."""
_START = ["proc", "check_cell", "(", ")"]
_DISTANCE, _TURN = 0.1, 0.02
"""How far the controller's frames may be off the plan's [mm], [degrees]."""


def cell_check(context: Context) -> Outcome:
    """Before anything else each RAPID program compares base frame, tools and work objects with what was
    planned, and stops for good over 0.1 mm or 0.02 degrees."""
    issues: list[Issue] = []
    for task in context.job.tasks:
        if task.krl is None:
            issues += [
                Issue(CODE, fault, arm=task.arm.name, file=file, hint="plan again; copy all modules")
                for file, fault in _faults(context, task)
            ]
    return Outcome(tuple(issues))


def _faults(context: Context, task: TaskText) -> list[tuple[str, str]]:
    own = [path for path in task.files if CHECK.match(PurePosixPath(path).name)]
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
    if rapid_words(masked(task.files[file])) != [*module, *_START, *handler, "endmodule"]:
        out.append((file, "its handler cannot be told from what compares"))
    head, calls = _wanted(context, task)
    if module[:1] != ["module"] or len(module) != 2 or rest != rapid_words(_helpers(together)):
        out.append((file, "the procedures that compare are not as they should be"))
    if body[: len(head)] != head:
        out.append((file, "it does not read the base frame as it should, or not of this robot"))
    compared = sorted(body[len(head) :])
    out += [(file, f"it does not compare {_shown(lost)}") for lost in sorted(set(calls) - set(compared))]
    if not out and compared != sorted(calls):
        out.append((file, "it does more than compare what was planned"))
    return out


def _shown(call: str) -> str:
    found = re.search(r'"([^"]*)"', call)
    return (found.group(1) if found else call) + " with what was planned"


def _called(task: TaskText) -> bool:
    """Whether ``main`` begins with the call."""
    mains = [p for module in task.modules for p in module.procedures if p.name.lower() == "main"]
    for statement in mains[0].body if len(mains) == 1 else ():
        if isinstance(statement, ProcCall):
            return statement.name.lower() == "check_cell"
        if not (isinstance(statement, Instruction) and statement.name in _BEFORE):
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
    at = next((i for i in range(len(text)) if text[i : i + 4] == _START), None)
    if at is None or "error" not in text[at:] or "endproc" not in text[at:]:
        return None
    handler, end = text.index("error", at), text.index("endproc", at)
    if handler > end or text[-1:] != ["endmodule"]:
        return None
    body: list[str] = [" ".join(part) for part in _split(text[at + 4 : handler])]
    return text[:at], body, text[handler : end + 1], text[end + 1 : -1]


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
    calls = f'check_pose "{said.base_of(task.arm.name)}",cfg_base,{BASE_FRAME};'
    for data in context.data(task, r"\w+"):
        if not isinstance(data.initial, Literal) or data.kind not in ("tooldata", "wobjdata"):
            continue
        calls += _compared(data.name, data.kind, _raw(task, data.name))
    return _statements(read), _statements(calls)


def _compared(name: str, kind: str, value: Sequence[str]) -> str:
    """Comparisons of a declared tool or work object, whose parts are ``value`` as text."""
    if kind == "tooldata":
        text = f'check_pose "{said.frame_of(name)}",{name}.tframe,{value[1]};'
        return text + f'check_true "{said.kind_of(name)}",{name}.robhold;'
    text = f'check_pose "{said.object_frame_of(name)}",{name}.oframe,{value[4]};'
    who = f'check_true "{said.kind_of(name)}",NOT {name}.robhold AND '
    if value[1].upper() == "TRUE":
        text += f'check_pose "{said.user_frame_of(name)}",{name}.uframe,{value[3]};'
        return text + f"{who}{name}.ufprog;"
    return text + f"{who}NOT {name}.ufprog AND {name}.ufmec={value[2]};"


def _raw(task: TaskText, name: str) -> list[str]:
    """The components of a declaration, as its text has them."""
    for path, text in task.files.items():
        if CHECK.match(PurePosixPath(path).name):
            continue
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


def _helpers(together: bool) -> str:
    """The procedures that compare, as they have to be."""
    parts = ("1", "2", "3", "4")
    dot = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in parts)
    squares = "+".join(f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in parts)
    stop = "Stop\\AllMoveTasks" if together else "Stop"
    said_last = "".join(f'TPWrite "{line}";' for line in said.NOTHING_MOVES)
    return f"""
    PROC check_pose(string what, pose got, pose wanted)
      VAR num off_sign:=1; VAR num off_turn;
      IF {dot}<0 THEN off_sign:=-1; ENDIF
      off_turn:=114.591559*Sqrt({squares});
      IF Distance(got.trans,wanted.trans)>{_DISTANCE} OR off_turn>{_TURN} THEN
        TPWrite what; TPWrite "{said.OFF_BY_MM}"\\Num:=Distance(got.trans,wanted.trans);
        TPWrite "{said.OFF_BY_DEGREES}"\\Num:=off_turn; check_stop;
      ENDIF
    ENDPROC
    PROC check_true(string what, bool same)
      IF NOT same THEN TPWrite what; TPWrite "{said.NOT_AS_PLANNED}"; check_stop; ENDIF
    ENDPROC
    PROC check_stop()
      {said_last} WHILE TRUE DO {stop}; ENDWHILE
    ENDPROC
    """
