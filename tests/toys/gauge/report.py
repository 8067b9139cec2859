"""Contributions of the gauge to the report: a tile, a row of the setup sheet and a chart."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from planner.geometry.units import MM
from planner.plans import OperationPlan, Plan
from planner.problem import Setup
from planner.proof.verdict import Proof
from planner.report.charts import ChartLine, LimitLine
from planner.report.markup import Tile
from planner.report.plugin_contributions import ProcessMotion, ReportOfProcess, SetupRow, TimeChart
from tests.toys.gauge.claims import KeepsAbove


def _claims(operation: OperationPlan) -> list[KeepsAbove]:
    return [claim for claim in operation.targets.claims if isinstance(claim, KeepsAbove)]


def _tiles(plan: Plan, proof: Proof | None) -> tuple[Tile, ...]:
    if proof is None:
        return ()
    found = proof.rule("ring.above")
    return () if found.worst is None else (Tile("gauge above the block", f"{found.worst:.1f}", found.unit),)


def _setup_rows(setup: Setup, plan: Plan, operation: OperationPlan, proof: Proof | None) -> list[SetupRow]:
    return [("gauge stays above the block by", f"{one.height / MM:.1f} mm") for one in _claims(operation)]


def _motion(plan: Plan, series: Mapping[str, Any]) -> ProcessMotion:
    limits = tuple(
        LimitLine(one.height / MM, "allowed") for operation in plan.operations for one in _claims(operation)
    )
    lines = tuple(
        ChartLine("tip", series[name], series[name.replace("time", "height")] / MM)
        for name in series
        if re.fullmatch(r"ring/\d+/time", name)
    )
    if not lines:
        return ProcessMotion()
    return ProcessMotion(charts=(TimeChart("Height of the gauge", lines, "mm", "above the block", limits),))


REPORT: Final = ReportOfProcess(tiles=_tiles, setup_rows=_setup_rows, motion=_motion)
