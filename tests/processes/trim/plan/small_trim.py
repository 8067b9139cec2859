"""A dish of 60 mm in which a torch on an IRB 140 cuts three apertures, and a slot around them."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import yaml

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.issues import Issue
from planner.languages.writing import write as post
from planner.motion import solve
from planner.problem import Problem
from planner.processes import registry
from planner.processes.trim.proof import outlines
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.rule_order import ORDER
from planner.proof.rule_table import built_in
from planner.proof.verdict import Proof
from tests import urdf_text
from tests.small_forming import CELLS, dish
from tests.small_forming import write as write_forming

SLIM = {"nozzle_diameter_mm": 8, "nozzle_length_mm": 45, "body_diameter_mm": 26, "length_mm": 220}
TORCH: dict[str, Any] = {"kind": "torch", "cuts_by": "plasma", "kerf_mm": 1.2, "standoff_mm": 3, **SLIM}
OUTLINES: list[dict[str, Any]] = [
    {"name": "round", "circle": {"at_mm": [0, 0], "diameter_mm": 16}},
    {
        "name": "wall",
        "curve": {
            "bspline_mm": [
                [18, -6, 0],
                [25, -6, 0],
                [27, 0, 0],
                [25, 6, 0],
                [18, 6, 0],
                [16, 0, 0],
                [18, -6, 0],
            ]
        },
    },
    {"name": "rim", "circle": {"at_mm": [0, 0], "diameter_mm": 72}, "drops": "outside", "joints": 3},
]
KUKA: dict[str, Any] = {"robot": "kr10_r1100", "home_deg": [0, -90, 90, 0, 60, 0]}
"""A KUKA arm instead of the IRB 140."""
NUMBERS = {"doArc": 17, "diArcOk": 17}
"""Numbers of its output and of its input; they count apart."""
UR_NUMBERS = {"doArc": 3, "diArcOk": 0}
"""Numbers of the output and of the input of the UR10e of :func:`of_ur`."""
TRIM: dict[str, Any] = {
    "name": "cut",
    "process": "trim",
    "arms": ["robot"],
    "feed_mm_s": 8,
    "lead": {"length_mm": 2.5},
    "pierce": {"height_mm": 4, "off_mm": 1.5},
}

MILL: dict[str, Any] = {
    "kind": "mill",
    "diameter_mm": 2,
    "flute_mm": 8,
    "overhang_mm": 30,
    "holder": [{"length_mm": 30, "diameter_mm": 20}],
    "spindle_diameter_mm": 50,
    "spindle_length_mm": 120,
    "mass_kg": 3,
}


def milled(tool: dict[str, Any] | None = None, **by: Any) -> dict[str, Any]:
    """Fields of an operation in which a mill cuts, and its tool."""
    return {"tool": {**MILL, **(tool or {})}, "by": {"kind": "mill", **by}, "pierce": {"off_mm": 1.5}}


def data(**fields: Any) -> dict[str, Any]:
    """The problem as a file has it; ``fields`` are the operation's own, ``tool`` those of the torch, or a
    whole tool, ``arm`` and ``controller`` those of the cell, ``sheet`` those of the sheet."""
    cell = yaml.safe_load((CELLS / "irb140_ball.yaml").read_text())
    cell["arms"][0] |= fields.pop("arm", {})
    cell["controller"] = fields.pop("controller", cell["controller"])
    tool = fields.pop("tool", {})
    cell["arms"][0]["tool"] = tool if "kind" in tool else {**TORCH, **tool}
    outlines, sheet = copy.deepcopy(fields.pop("outlines", OUTLINES)), fields.pop("sheet", {})
    return {
        "tandem": 1,
        "name": "trimmed",
        "cell": cell,
        "sheet": {
            "size_mm": [160, 160],
            "thickness_mm": 1,
            "metal": "aa1100_o",
            "opening_mm": 120,
            "clamp": {"width_mm": 20, "above_mm": 10, "below_mm": 60},
            **sheet,
        },
        "part": {"sheet_mesh": {"file": "part.ply", "unit": "mm", "face": "bottom"}},
        "settings": {"clearance_mm": 5},
        "operations": [{**TRIM, "outlines": outlines, **fields}],
    }


def of_ur(folder: Path, numbers: dict[str, int] | None = None) -> dict[str, Any]:
    """Return fields with a UR10e instead of the IRB 140, and write its URDF into the folder."""
    (folder / "ur10e.urdf").write_text(urdf_text.ur10e(), "utf-8")
    robot = {"urdf": "ur10e.urdf", "name": "ur10e", "family": "ur", "payload_kg": 12.5}
    return {
        "arm": {"robot": robot, "home_deg": [0, -90, 90, -90, -90, 0]},
        "controller": {"io": {"robot": UR_NUMBERS if numbers is None else numbers}},
        "sheet": {"place": {"xyz_mm": [700, 0, 300]}},
    }


def problem(folder: Path, part: Mesh | None = None, **fields: Any) -> Problem:
    """The problem, read."""
    return pipeline.load(write_forming(folder, data(**fields), dish() if part is None else part))


class Job:
    """A planned job, its programs and a prover that keeps its models."""

    def __init__(self, folder: Path, part: Mesh | None = None, **fields: Any) -> None:
        self.problem = problem(folder, part, **fields)
        targets = [registry.job(self.problem, 0).targets()]
        self.plan = solve.solve(self.problem, targets)
        self.programs: dict[str, str] = dict(post.program_files(self.plan, self.problem))
        self.prover = Prover(self.problem, registry.claims(self.problem))

    def prove(self, programs: dict[str, str], last: str | None = "verify.trim_spindle") -> Proof:
        return self.prover.prove(programs, last=last)

    def broken(self, programs: dict[str, str]) -> set[str]:
        return {issue.code for issue in self.prove(programs).issues}

    def told_by(self, code: str, programs: dict[str, str]) -> bool:
        """Return whether the rule of that code refuses the programs."""
        return code in {issue.code for issue in self.issues_of(code, programs)}

    def issues_of(self, code: str, programs: dict[str, str]) -> list[Issue]:
        """What the rule of that code refuses the programs for; of those on trimming it alone looks."""
        claims, unread = outlines.resolve_claims(self.prover.claims)
        context = Context(self.problem, claims, programs, unread)
        if code in ORDER["slots"] and context.is_replayable:
            issues = built_in()[code](context).issues
        else:
            issues = self.prove(programs, code).issues
        return [issue for issue in issues if issue.code == code]
