"""Milling: flank, point and engraving cuts, and paths of G-code."""

from typing import Final

from planner.runtime.plugins import Process

PROCESS: Final = Process(
    schema="planner.processes.milling.plan.operation:Milling",
    job="planner.processes.milling.plan.job:MillingJob",
    claims="planner.processes.milling.claims:CLAIMS",
    proof="planner.processes.milling.proof.contribution:PROOF",
    report="planner.processes.milling.report:REPORT",
)
