"""What joint tables contribute to the proof and to the setup sheet."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.geometry.arrays import dots
from planner.issues import Issue
from planner.proof.context import Context
from planner.proof.language_contribution import ProofOfLanguage
from planner.proof.replay.standing import work_nodes
from planner.proof.rule import Outcome, at_sample, mm, rule
from planner.proof.rules.setups_and_frames import HOME_ERROR
from planner.report.contribution import ReportOfLanguage
from tests.toys.joint_table.reader import JointTable

STRAIGHT: Final = 0.2e-3
"""How far [m] the tool may leave the straight way from row to row in work."""


@rule("joint_table.start", stage="tasks")
def start(context: Context) -> Outcome:
    """Joint tables begin at home."""
    issues = list[Issue]()
    for task in context.job.tasks:
        if isinstance(task.text, JointTable):
            off = float(np.abs(task.text.start - task.arm.home).max())
            if off > HOME_ERROR:
                what = f"the first row is {np.rad2deg(off):.4f} deg off home"
                issues.append(Issue("joint_table.start", what, arm=task.arm.name, file=min(task.files)))
    return Outcome(tuple(issues))


@rule("joint_table.straight")
def straight(context: Context) -> Outcome:
    """Joint tables: in work the tool keeps within 0.2 mm of the straight way from row to row."""
    issues, worst, motion = list[Issue](), 0.0, context.motion
    for task in context.job.tasks:
        work, before, after, _ = work_nodes(context, task)
        work &= isinstance(task.text, JointTable)
        rows = np.flatnonzero(work[motion.looks.node])
        node = motion.looks.node[rows]
        here = motion.poses(task.arm.name, motion.looks.row[rows])[:, :3, 3]
        begin, way = before[node, :3, 3], after[node, :3, 3] - before[node, :3, 3]
        share = np.clip(dots(here - begin, way) / np.maximum(dots(way, way), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(here - begin - share[:, None] * way, axis=1)
        worst = max(worst, float(off.max(initial=0.0)))
        for k in np.flatnonzero(off > STRAIGHT)[:1]:
            what, sample = (
                f"the tool is {mm(off[k]):.4f} mm off the straight way",
                motion.looks.sample[rows[k]],
            )
            issues.append(at_sample("joint_table.straight", what, motion, task.arm.name, int(sample)))
    return Outcome(tuple(issues), mm(worst), mm(STRAIGHT), "mm")


_KNOWN_START: Final = Outcome(nothing="joint tables begin at home")
PROOF: Final = ProofOfLanguage(
    (start, straight), {"verify.unknown_start": lambda context, task: _KNOWN_START}
)
REPORT: Final = ReportOfLanguage(
    programs=lambda problem, arms: [
        (f"joint table of {arm.name}", "cubics from rest to rest") for arm in arms
    ]
)
