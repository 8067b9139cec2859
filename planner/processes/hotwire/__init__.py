"""Hot-wire cutting: bent wires between two arms, and straight wires in a bow."""

from typing import Final

from planner.runtime.plugins import Process

ELASTIC_WIRE: Final = Process(
    schema="planner.processes.hotwire.plan.operation:ElasticWire",
    job="planner.processes.hotwire.plan.elastic.job:ElasticJob",
    claims="planner.processes.hotwire.claims:CLAIMS",
    proof="planner.processes.hotwire.proof.contribution:PROOF",
    report="planner.processes.hotwire.report:REPORT",
)
STRAIGHT_WIRE: Final = Process(
    schema="planner.processes.hotwire.plan.operation:Straight",
    job="planner.processes.hotwire.plan.straight.job:StraightJob",
    claims="planner.processes.hotwire.claims:CLAIMS",
    proof="planner.processes.hotwire.proof.contribution:PROOF",
    report="planner.processes.hotwire.report:REPORT",
)
