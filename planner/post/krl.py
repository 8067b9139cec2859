"""KRL programs of a job: for each KUKA arm a main program, its data list, and files with moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner import __version__
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.post import handshake_drift, krl_moves, krl_panel, krl_spline, krl_tracks
from planner.post.krl_data import Data
from planner.post.krl_format import comment, name
from planner.post.krl_main import Main
from planner.post.layout import Part, kilobytes, parts
from planner.post.partner import Partner
from planner.post.program import Job, TaskProgram
from planner.problem import KrlDialect, Problem

IntArray = NDArray[np.int64]

LINE_END: Final = "\r\n"
_STEM: Final = 16
_FRAME: Final = 1500
"""Bytes of a part without its moves: the header of a file, settings, comments."""
_CALL: Final = 30


def texts(job: Job, plan: Plan, problem: Problem, margins: Mapping[str, str]) -> dict[str, str]:
    """Program files of the KUKA arms by relative name. Raises :class:`TandemError` (``post.*``)."""
    own = [task for task in job.tasks if task.robot.family == "KUKA"]
    limits = problem.cell.controller
    data = {task.number: Data(task, plan) for task in own}
    moves = {task.number: _lines(task, plan, problem, data[task.number]) for task in own}
    call = _CALL if job.handshake is not None else 0
    sizes = [
        np.max([_sizes(moves[t.number][i], len(t.operations[i].ids)) for t in own], axis=0) + call
        for i in range(len(plan.operations))
    ]
    layout = parts(job, sizes, _FRAME, limits.max_moves, limits.max_bytes)
    out: dict[str, str] = {}
    for task in own:
        out |= _files(task, job, plan, problem, margins, data[task.number], layout, moves[task.number])
    for path, text in out.items():
        if len(text.encode()) > limits.max_bytes:
            message = f"{path} has {len(text.encode())} bytes; allowed: {limits.max_bytes}"
            hint = f"allow larger files: controller: {{max_kilobytes: {kilobytes(text)}}}"
            raise TandemError(Issue("post.no_split", message, file=path, hint=hint))
    return out


def _lines(task: TaskProgram, plan: Plan, problem: Problem, data: Data) -> list[krl_moves.Lines | None]:
    """The text of the moves of each operation."""
    controller = problem.cell.controller
    rows = krl_tracks.rows(task, data)
    lines = [None if own is None else krl_moves.lines(own, controller.dialect) for own in rows]
    if controller.path == "slin":
        return lines
    found = krl_tracks.blocks(task, plan, data)
    return [
        None if text is None or own is None else krl_spline.with_blocks(text, own, runs)
        for text, own, runs in zip(lines, rows, found, strict=True)
    ]


def _files(
    task: TaskProgram,
    job: Job,
    plan: Plan,
    problem: Problem,
    margins: Mapping[str, str],
    data: Data,
    layout: Sequence[Part],
    moves: Sequence[krl_moves.Lines | None],
) -> dict[str, str]:
    """The files of one task."""
    stem = name(problem.name, _STEM)
    main = Main(task, job, problem, data, layout, moves, stem)
    body = main.lines()
    head = _header(task, job, plan, problem, margins)
    brief = comment(f"Problem {plan.problem_name}, SHA-256 {plan.digest}.")
    dialect = problem.cell.controller.dialect
    note = "; what this program was planned for; the proof starts from these"
    listed = data.list(stem, [*head, note], {"problem_digest": plan.digest})
    head = [*krl_panel.declarations(dialect), *head]
    files = {f"{stem}.src": _program(stem, head, body, main.bodies, dialect), f"{stem}.dat": listed}
    for word, lines in main.bodies.items():
        files[f"{word}.src"] = _program(word, brief, lines, main.bodies, dialect)
    return {
        f"{task.arm.name}/{path}": "".join(f"{line}{LINE_END}" for line in ["&ACCESS RVP", "&REL 1", *lines])
        for path, lines in files.items()
    }


def _program(
    word: str, head: Sequence[str], body: Sequence[str], known: Mapping[str, object], dialect: KrlDialect
) -> list[str]:
    """A DEF; what it calls is declared where the dialect wants that."""
    called = dict.fromkeys(line[:-2] for line in body if line.endswith("()") and line[:-2] in known)
    declared = [f"EXT {other}()" for other in called] if dialect == "krc2" else []
    if dialect == "krc2" and any(line.startswith("BAS(") for line in body):
        declared.insert(0, krl_panel.EXT_BAS)
    return [f"DEF {word}()", *declared, *head, *body, "END"]


def _header(
    task: TaskProgram, job: Job, plan: Plan, problem: Problem, margins: Mapping[str, str]
) -> list[str]:
    tools = ", then ".join(dict.fromkeys(op.arm.tool.name for op in task.operations))
    out = comment(f"Written by Tandem {__version__} for arm {task.arm.name}: {task.robot.title}.")
    out += comment(f"Tool {tools}. Written, not taught: plan again to change it.")
    out += comment(f"Problem {plan.problem_name}, SHA-256 {plan.digest}.")
    for item, value in margins.items():
        out += comment(f"Proven: {item} {value}.")
    if problem.cell.controller.path == "spline":
        for sentence in krl_spline.ASSUMED:
            out += comment(sentence)
    partner = Partner.of(task, job)
    if partner is not None:
        for sentence in partner.header():
            out += comment(sentence)
        for drift in job.drifts:
            out += comment(f"Operation {drift.name}: {handshake_drift.sentence(drift)}.")
    switched = ", ".join(job.switched(task))
    if switched:
        out += comment(
            f"A program that stops leaves {switched} as it is: wire it so that power falls with the drives."
        )
    return out


def _sizes(lines: krl_moves.Lines | None, count: int) -> IntArray:
    return np.zeros(count, dtype=np.int64) if lines is None else lines.sizes()
