"""A package with a process of its own: a gauge goes round on a circle above the block.

It brings a kind of claim, the rule that proves it, issue codes, and parts of the report. Its pyproject.toml
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
