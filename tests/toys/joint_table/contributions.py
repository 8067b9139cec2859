"""Contributions of joint tables to the proof and to the setup sheet."""

from __future__ import annotations

from typing import Final

import numpy as np

from planner.geometry.arrays import dots
from planner.issues import Issue
from planner.proof.context import Context
from planner.proof.language_contribution import ProofOfLanguage
from planner.proof.replay.standstill import work_nodes
from planner.proof.rule import RuleOutcome, mm, rule, sample_issue
from planner.proof.rules.setups_and_frames import HOME_TOLERANCE_RAD
from planner.report.plugin_contributions import ReportOfLanguage
from tests.toys.joint_table.reader import JointTable

STRAIGHT: Final = 0.2e-3
"""Allowed deviation [m] of the tool from the straight line between rows in work."""


@rule("joint_table.start", stage="tasks")
def start(context: Context) -> RuleOutcome:
    """Joint tables begin at home."""
    issues = list[Issue]()
    for task in context.job.tasks:
        if isinstance(task.text, JointTable):
            deviation = float(np.abs(task.text.start - task.arm.home).max())
            if deviation > HOME_TOLERANCE_RAD:
                what = f"the first row is {np.rad2deg(deviation):.4f} deg off home"
                issues.append(Issue("joint_table.start", what, arm=task.arm.name, file=min(task.files)))
    return RuleOutcome(tuple(issues))


@rule("joint_table.straight")
def straight(context: Context) -> RuleOutcome:
    """Joint tables: in work the tool keeps within 0.2 mm of the straight way from row to row."""
    issues, worst, motion = list[Issue](), 0.0, context.motion
    for task in context.job.tasks:
        work, before, after, _ = work_nodes(context, task)
        work &= isinstance(task.text, JointTable)
        rows = np.flatnonzero(work[motion.merged_samples.node])
        node = motion.merged_samples.node[rows]
        here = motion.poses(task.arm.name, motion.merged_samples.row[rows])[:, :3, 3]
        begin, way = before[node, :3, 3], after[node, :3, 3] - before[node, :3, 3]
        fraction = np.clip(dots(here - begin, way) / np.maximum(dots(way, way), 1e-12), 0.0, 1.0)
        deviation = np.linalg.norm(here - begin - fraction[:, None] * way, axis=1)
        worst = max(worst, float(deviation.max(initial=0.0)))
        for k in np.flatnonzero(deviation > STRAIGHT)[:1]:
            what, sample = (
                f"the tool is {mm(deviation[k]):.4f} mm off the straight way",
                motion.merged_samples.sample[rows[k]],
            )
            issues.append(sample_issue("joint_table.straight", what, motion, task.arm.name, int(sample)))
    return RuleOutcome(tuple(issues), mm(worst), mm(STRAIGHT), "mm")


_KNOWN_START: Final = RuleOutcome(nothing="joint tables begin at home")
PROOF: Final = ProofOfLanguage(
    (start, straight), {"verify.unknown_start": lambda context, task: _KNOWN_START}
)
REPORT: Final = ReportOfLanguage(
    programs=lambda problem, arms: [
        (f"joint table of {arm.name}", "cubics from rest to rest") for arm in arms
    ]
)
