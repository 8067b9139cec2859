"""Helpers that read the text of programs: modules, moves, and statements in execution order."""

from __future__ import annotations

import json
import re

import numpy as np

from planner.geometry.arrays import from_quaternion
from planner.languages.writing import write
from tests.line_ends import bare

MOVE = re.compile(
    r"^ +MoveL \[\[([-\d.,]+)\],\[([-\d.,]+)\],\[([-\d,]+)\],\[9E9,9E9,9E9,9E9,9E9,9E9\]\]"
    r"(?:\\ID:=(\d+))?,v(\w+)\\T:=([\d.]+),(\w+),(\w+)\\WObj:=(\w+);$"
)


def programs(plan, problem, margins=None):
    """Texts as they are written, RAPID's with bare line feeds."""
    return bare(write.program_files(plan, problem, margins))


def modules(files, task, kind=""):
    return {
        name: text
        for name, text in files.items()
        if name.startswith(f"{task}/Tandem{kind}") and ".mod" in name
    }


def moves(files, task):
    lines = "\n".join(modules(files, task, "Cut").values()).split("\n")
    return [found.groups() for line in lines if "MoveL" in line for found in [MOVE.match(line)] if found]


def numbers(rows, column):
    return np.array([[float(value) for value in row[column].split(",")] for row in rows])


def flat(files, task):
    """The task's statements in the order in which they run, procedure calls followed."""
    text = "\n".join(modules(files, task).values())
    bodies = {
        name: [line.strip() for line in body.split("\n  ERROR")[0].split("\n")]
        for name, body in re.findall(r"PROC (\w+)\(\)\n(.*?)\n  ENDPROC", text, re.DOTALL)
    }

    def walk(name):
        for line in bodies[name]:
            if line.rstrip(";") in bodies:
                yield from walk(line.rstrip(";"))
            elif line and not line.startswith("!"):
                yield line

    return list(walk("main"))


def data(files, task, kind, name):
    """The value of a declaration as nested lists; words are strings."""
    text = "\n".join(modules(files, task).values())
    found = re.search(rf"PERS {kind} {name}:=(.*);", text)
    assert found, name
    return json.loads(re.sub(r"\b(TRUE|FALSE)\b", lambda m: m.group(1).lower(), found.group(1)))


def pose(value):
    """(4, 4) in m of RAPID's pose."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = from_quaternion(np.array(value[1])), np.array(value[0]) * 1e-3
    return out


def targets(rows):
    """Poses (M, 4, 4) in m of moves."""
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = from_quaternion(numbers(rows, 1)), numbers(rows, 0) * 1e-3
    return out
