"""Trimming of formed sheets with a torch, a laser, a knife or a mill."""

from typing import Final

from planner.runtime.plugins import Process

PROCESS: Final = Process(
    schema="planner.processes.trim.plan.operation:Trim",
    job="planner.processes.trim.plan.job:TrimJob",
    claims="planner.processes.trim.claims:CLAIMS",
    proof="planner.processes.trim.proof.contribution:PROOF",
)
