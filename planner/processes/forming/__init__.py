"""Incremental sheet forming."""

from typing import Final

from planner.runtime.plugins import Process

PROCESS: Final = Process(
    schema="planner.processes.forming.plan.operation:Forming",
    job="planner.processes.forming.plan.job:FormingJob",
    claims="planner.processes.forming.claims:CLAIMS",
    proof="planner.processes.forming.proof.contribution:PROOF",
    report="planner.processes.forming.report:REPORT",
    wider="planner.processes.forming.plan.support.clearance:wider_mm",
)
