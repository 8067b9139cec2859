"""Rows of ``test_remedies_of_data``: controllers, and programs that are written for them.

Issues that appear only when a plan is written are tested on plans of the writers' own tests, which need no
search.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from planner.claims.handshake import Handshake
from planner.issues import Issue
from planner.languages.krl.writer import controller_files as krl_files
from planner.languages.writing.steps import build_job
from planner.languages.writing.write import program_files, program_notes
from planner.problem import Controller
from planner.targets import TargetAction
from tests.languages.writing import krl_job, synthetic, test_layout
from tests.refusals import change
from tests.remedies.advice import ReportedFigure, Word
from tests.remedies.remedy_rows import BOTH, HELD, ON_TABLE, STRAIGHT, Row, Yaml, collect_issues, lay, load

ARM_COLUMNS: Final = [
    f"{arm}.{one}" for arm in ("left", "right") for one in ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
]
PAIRS: Final = "\n".join(
    [",".join([*ARM_COLUMNS, "feed_mm_s"]), *(f"450,{y},500,1,0,0,0,450,{y},500,1,0,0,0,20" for y in (0, 20))]
)
NUMBERS: Final = {
    arm: {
        getattr(own, name): 2 * k + side
        for k, name in enumerate(("output", "input", "running", "partner_running", "move_enable"), 1)
    }
    for side, arm in enumerate(("left", "right"))
    for own in [Controller().handshake.of(arm)]
}
TOGETHER: Final = change(
    {**HELD, "stock": {"size_mm": [300, 200, 100], "foam": "eps_a120", "support": "pedestal"}},
    "operations.0.arms",
    ["left", "right"],
)
KUKA: Final = change(change(TOGETHER, "cell.arms.0.robot", "kr60_ha"), "cell.arms.1.robot", "kr60_ha")
STANDING: Final = change(STRAIGHT, "cell.arms.0.robot", "kr60_ha")

CONTROLLERS: Final = [
    Row("post.controller", lay, change(KUKA, "cell.controller", {"io": NUMBERS}),
        "set controller: {sync: handshake}",
        {"cell.controller.sync": Word("set controller: \\{sync: (\\w+)")}, {"targets.csv": PAIRS}),
    Row("post.signal", lay, change(STANDING, "operations.0.signal", "doHeat"), "state the actual numbers",
        {"cell.controller": Yaml("controller: (\\{.*\\}\\})")}),
    Row("post.option", load, change({**HELD, "operations": [BOTH]}, "cell.controller", {"options": []}), "",
        {"cell.controller.options": [Word("(604-1 MultiMove Coordinated)")]}),
    Row("post.tasks", load, change(STRAIGHT, "cell.controller", {"tasks": ["T_ROB1"]}), "",
        {"cell.controller.tasks": ["T_ROB1", "T_ROB2"]}),
]  # fmt: skip


# ---- plans that are written ----------------------------------------


def with_tools(problem: Any, mass: float) -> Any:
    """Return the problem with tools of that mass [kg]."""
    arms = [dataclasses.replace(a, tool=dataclasses.replace(a.tool, mass=mass)) for a in problem.cell.arms]
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=tuple(arms)))


def with_targets(plan: Any, **fields: Any) -> Any:
    """The plan with other fields of its first operation's targets."""
    first = plan.operations[0]
    targets = dataclasses.replace(first.targets, **fields)
    return dataclasses.replace(plan, operations=(dataclasses.replace(first, targets=targets),))


def small(mass: float = 1.0, frame: str = "stock", action_at: int = 0, stop: int = 6) -> Any:
    """Two arms of ABB at nine targets, one action at a target, and a stop on the way."""
    plan, problem = synthetic.small()
    stops = np.isin(np.arange(9), [0, stop, 8])
    fields = {"stop": stops, "frame": {"left": frame, "right": frame}}
    plan = with_targets(plan, **fields, actions=(TargetAction(action_at, "message", text="?"),))
    return plan, with_tools(problem, mass)


def long(max_moves: int = 5000, max_kilobytes: float = 1000) -> Any:
    """Cuts of 40 moves, which go into modules whole."""
    return test_layout.job([40, 20, 40], [40, 60], max_moves=max_moves, max_bytes=int(1000 * max_kilobytes))


def kuka(
    a1: float = 5.0,
    path: str = "slin",
    count: float = 9,
    size: float = 0.05,
    kink: float = 0.0,
    stop: float = 6,
    mass: float = 1.0,
) -> Any:
    """Return a KUKA arm whose first axis begins at ``a1`` [deg].

    It moves through ``count`` targets on a path of that size with a bend by ``kink`` in its middle.
    """
    count, stop = int(count), int(stop)  # figures of an issue are no whole numbers by their type
    start = np.array([np.deg2rad(a1), *krl_job.START[1:]])
    q = synthetic.sweep(count, size=size, start=start)
    q[count // 2 :, 0] += kink * np.arange(count - count // 2) / count
    labels = ["approach", *["cut/front"] * (count - 2), "retreat"]
    plan, problem = krl_job.alone(q=q, labels=labels, path=path, actions=(), stop=(stop,))
    return plan, with_tools(problem, mass)


def turning(step_deg: float = 5.0) -> Any:
    """Return a KUKA arm with an old controller whose tool rotates by the given angle in each move."""
    plan, problem = krl_job.alone(q=synthetic.sweep(9, start=krl_job.START), actions=(), dialect="krc2")
    pose = plan.operations[0].targets.pose["left"].copy()
    for k in range(9):
        turn = Rotation.from_rotvec(np.deg2rad(step_deg) * k * np.array([0.6, 0.8, 0.0])).as_matrix()
        pose[k, :3, :3] = pose[0, :3, :3] @ turn
    return with_targets(plan, pose={"left": pose}), problem


def pair(sync: str = "handshake", coupled: bool = False) -> Any:
    """Two arms that meet, or that hold one wire."""
    own = {"handshake": Handshake("toggle", 4), "tasks": ("T_ROB1", "T_ROB1"), "units": ("ROB_1", "ROB_1")}
    job = synthetic.problem(sync=sync, **(own if sync == "handshake" else {}))
    q = {"left": synthetic.sweep(9), "right": synthetic.sweep(9, 0.25)}
    work = synthetic.operation(job, q, krl_job.LABELS, stop=(6,), actions=(), coupled=coupled)
    return synthetic.plan(work), job


def carried(mass: float = 0.9) -> Any:
    """Return a held block of that mass [kg]."""
    plan, problem = synthetic.held()
    claims = plan.operations[0].targets.claims
    return with_targets(
        plan, claims=tuple(dataclasses.replace(claim, mass=mass) for claim in claims)
    ), problem


PLAN_BUILDERS: Final[Mapping[str, Callable[..., Any]]] = {
    own.__name__: own for own in (small, long, kuka, turning, pair, carried)
}


def write_programs(folder: Path, data: Any) -> list[Issue]:
    """Write the programs of a handmade plan; return the issues and notes."""
    plan, problem = PLAN_BUILDERS[data["made"]](
        **{key: value for key, value in data.items() if key != "made"}
    )

    def work() -> Iterable[Issue]:
        program_files(plan, problem)
        return program_notes(plan, problem)

    return collect_issues(work)


def write_programs_of_size(folder: Path, data: Any) -> list[Issue]:
    """Return the issues of programs of a given total size that are split into a given number of problems."""
    plan, problem = kuka()
    text = {"left/test.src": "x" * (data["bytes"] // data["problems"])}
    return list(krl_files.notes(build_job(plan, problem).tasks, plan, problem, text))


def program_row(
    code: str, build_plan: Callable[..., Any], given: Mapping[str, Any], says: str, remedy: Any
) -> Row:
    slow = given.get("count", 9) > 100
    return Row(code, write_programs, {"made": build_plan.__name__, **given}, says, remedy, long=slow)


POSTED: Final = [
    Row("post.path", lay, change(ON_TABLE, "cell.controller", {"path": "spline"}), "path: slin",
        {"cell.controller.path": Word(r"path: (\w+)\}")}),
    Row("problem.field", load, change(ON_TABLE, "cell.arms.0.tool", {"kind": "plain", "mass_kg": 0.0001,
        "tcp": {"xyz_mm": [0, 0, 100]}}), "greater than or equal to",
        {"cell.arms.0.tool.mass_kg": ReportedFigure("greater than or equal to #", 0.001)}),
    program_row("post.tool", small, {"mass": 0.0}, "state the tool's mass",
        {"mass": ReportedFigure("mass_kg, #", 0.001)}),
    program_row("post.tool", kuka, {"mass": 0.0}, "state the tool's mass",
        {"mass": ReportedFigure("mass_kg, #", 0.001)}),
    program_row("post.frame", small, {"frame": "table"}, "allowed", {"frame": Word(r"allowed: (\w+)")}),
    program_row("post.action", small, {"action_at": 4}, "stop the motion",
        {"stop": ReportedFigure("stop the motion at target #")}),
    program_row("post.no_split", long, {"max_moves": 30}, "allow larger modules",
        {"max_moves": ReportedFigure("max_moves: #"), "max_kilobytes": ReportedFigure("max_kilobytes: #")}),
    program_row("post.no_split", long, {"max_kilobytes": 6}, "allow larger modules",
        {"max_moves": ReportedFigure("max_moves: #"), "max_kilobytes": ReportedFigure("max_kilobytes: #")}),
    program_row("post.load", carried, {"mass": 0.0005}, "a larger block",
        {"mass": ReportedFigure("at least # kg", 0.001)}),
    program_row("post.handshake_process", pair, {"coupled": True}, "use one MultiMove controller",
        {"sync": Word(r"sync: (\w+)")}),
    program_row("post.handshake_drift", pair, {}, "one MultiMove controller",
        {"sync": Word(r"sync: (\w+)")}),
    program_row("post.turn_near_zero", kuka, {"a1": 1.0}, "farther from zero",
        {"a1": ReportedFigure("is within # degrees", 0.1, times=1.05)}),
    program_row("post.krl_turn", turning, {"step_deg": 25.0}, "put targets closer",
        {"step_deg": ReportedFigure("by # degrees or less", 0.1, down=True)}),
    Row("post.krl_size", write_programs_of_size, {"bytes": 9_000_000, "problems": 1}, "split the job",
        {"problems": Yaml(r"into (\d+) problems")}),
    program_row("post.spline", kuka, {"path": "spline"}, "path: slin", {"path": Word(r"path: (\w+)\}")}),
    program_row("post.spline_left", kuka, {"path": "spline", "size": 1.0, "stop": 0}, "times as close",
        {"count": ReportedFigure("put targets # times", times=9.0)}),
    program_row("post.spline_left", kuka, {"path": "spline", "kink": 0.08, "stop": 0}, "has a kink",
        {"stop": 4}),
    program_row("post.spline_left", kuka, {"path": "spline", "count": 520, "stop": 0},
        "stop the motion every", {"stop": ReportedFigure("stop the motion every # moves")}),
]  # fmt: skip

ROWS: Final = [*CONTROLLERS, *POSTED]
