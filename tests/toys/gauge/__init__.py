"""A package with its own process: a gauge moves on a circle above the block.

It adds a kind of claim, the rule that proves it, issue codes, and parts of the report. Its pyproject.toml
would state ``ring = "tests.toys.gauge:PROCESS"`` under ``[project.entry-points."tandem.processes"]``.
"""

from typing import Final

from planner.runtime.plugins import Process

PROCESS: Final = Process(
    schema="tests.toys.gauge.operation:Ring",
    job="tests.toys.gauge.job:RingJob",
    claims="tests.toys.gauge.claims:CLAIMS",
    codes="tests.toys.gauge.codes:CODES",
    proof="tests.toys.gauge.proof:PROOF",
    report="tests.toys.gauge.report:REPORT",
)
