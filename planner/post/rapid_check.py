"""The module that compares, before anything moves, what the controller has with what was planned: base frame,
tools and work objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner import controller_texts as said
from planner.plans import Plan
from planner.post.program import Job, TaskProgram
from planner.post.rapid_data import Tools, wobj_name
from planner.post.rapid_format import pose, quoted

CALL = "check_cell"
_AXES = "xyz"


def body(task: TaskProgram, job: Job, plan: Plan, tools: Tools, robot: str) -> list[str]:
    """Statements of the procedure :data:`CALL`; ``robot`` is the robot's name in the configuration."""
    place = quoted(f"/MOC/ROBOT/{robot}")
    out = ["VAR pose cfg_base;", "VAR num cfg_value;"]
    for axis in _AXES:
        out += [f'ReadCfgData {place},"base_frame_pos_{axis}",cfg_value;']
        out += [f"cfg_base.trans.{axis}:=1000*cfg_value;"]
    for part in range(4):
        out += [f'ReadCfgData {place},"base_frame_orient_u{part}",cfg_value;']
        out += [f"cfg_base.rot.q{part + 1}:=cfg_value;"]
    out += [_pose(said.base_of(task.arm.name), "cfg_base", "base_frame")]
    for name, matrix in {tools.of(op.arm.tool): op.arm.tool.tcp for op in task.operations}.items():
        out += [_pose(said.frame_of(name), f"{name}.tframe", pose(matrix))]
        out += [f"check_true {quoted(said.kind_of(name))},{name}.robhold;"]
    return [*out, *_wobjs(task, job, plan)]


def _wobjs(task: TaskProgram, job: Job, plan: Plan) -> list[str]:
    """Where the user frame is fixed it is compared too; one that moves is the controller's own."""
    out: dict[str, list[str]] = {}
    for index, operation in enumerate(task.operations):
        if operation.track is None or operation.track.frame == "world":
            continue
        frame = operation.track.frame
        name = wobj_name(frame, operation.setup)
        kind = quoted(said.kind_of(name))
        if frame == "stock":
            place, inner = pose(plan.places[operation.setup - 1]), pose(np.eye(4))
            lines = [_pose(said.user_frame_of(name), f"{name}.uframe", place)]
            lines += [f"check_true {kind},NOT {name}.robhold AND {name}.ufprog;"]
        else:
            holder = next(t for t in job.tasks if t.arm.name == frame.removeprefix("held:"))
            inner = pose(holder.operations[index].arm.tool.tcp)
            moved = f"NOT {name}.robhold AND NOT {name}.ufprog AND {name}.ufmec={quoted(holder.unit)}"
            lines = [f"check_true {kind},{moved};"]
        out[name] = [_pose(said.object_frame_of(name), f"{name}.oframe", inner), *lines]
    return [line for lines in out.values() for line in lines]


def _pose(what: str, got: str, wanted: str) -> str:
    return f"check_pose {quoted(what)},{got},{wanted};"


def helpers(together: bool) -> list[str]:
    """The procedures that compare and, where something is off, say what and never go on."""
    apart = [f"Pow(got.rot.q{i}-off_sign*wanted.rot.q{i},2)" for i in range(1, 5)]
    along = "+".join(f"got.rot.q{i}*wanted.rot.q{i}" for i in range(1, 5))
    return [
        "! a turn is small here: twice the distance of the quaternions, in degrees",
        "PROC check_pose(string what,pose got,pose wanted)",
        "  VAR num off_sign:=1;",
        "  VAR num off_turn;",
        f"  IF {along}<0 THEN",
        "    off_sign:=-1;",
        "  ENDIF",
        f"  off_turn:=114.591559*Sqrt({apart[0]}+{apart[1]}",
        f"    +{apart[2]}+{apart[3]});",
        "  IF Distance(got.trans,wanted.trans)>0.1 OR off_turn>0.02 THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(said.OFF_BY_MM)}\\Num:=Distance(got.trans,wanted.trans);",
        f"    TPWrite {quoted(said.OFF_BY_DEGREES)}\\Num:=off_turn;",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        "PROC check_true(string what,bool same)",
        "  IF NOT same THEN",
        "    TPWrite what;",
        f"    TPWrite {quoted(said.NOT_AS_PLANNED)};",
        "    check_stop;",
        "  ENDIF",
        "ENDPROC",
        "",
        "! a start does not lead out of here",
        "PROC check_stop()",
        *(f"  TPWrite {quoted(line)};" for line in said.NOTHING_MOVES),
        "  WHILE TRUE DO",
        "    Stop\\AllMoveTasks;" if together else "    Stop;",
        "  ENDWHILE",
        "ENDPROC",
    ]


def lines(procedure: Sequence[str], together: bool) -> list[str]:
    """The module's lines around the procedure :data:`CALL`."""
    return [*procedure, "", *helpers(together)]
