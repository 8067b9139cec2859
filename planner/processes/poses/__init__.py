"""Poses that the user supplies."""

from typing import Final

from planner.runtime.plugins import Process

PROCESS: Final = Process(
    schema="planner.processes.poses.plan.job:Posed",
    job="planner.processes.poses.plan.job:PosedJob",
    claims="planner.processes.poses.claims:CLAIMS",
    proof="planner.processes.poses.proof.contribution:PROOF",
)
