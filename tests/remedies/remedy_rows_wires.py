"""Rows of ``test_remedies_of_data`` for bent and straight wires, as their processes report them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Final

from planner.catalogue.materials import foams
from planner.issues import Issue
from planner.processes.hotwire.plan.elastic.job import ElasticJob
from planner.processes.hotwire.plan.straight.job import StraightJob
from tests.processes.hotwire.plan import foam_blocks, panels
from tests.processes.hotwire.plan.foam_blocks import twisted
from tests.remedies.advice import ReportedFigure, Word
from tests.remedies.remedy_rows import CUT, Row, collect_issues, heat, lay


def bend(folder: Path, data: Any) -> list[Issue]:
    """What a bent wire tells of a block that an arm holds, or nobody."""
    own = panels.setup()
    holder = None if data["held_by"] == "nobody" else data["held_by"]
    held = dataclasses.replace(own, stock=dataclasses.replace(own.stock, held_by=holder))
    return collect_issues(lambda: ElasticJob(panels.operation(), held, panels.part()).targets().issues)


def turn(folder: Path, data: Any) -> list[Issue]:
    """What a straight wire tells of a surface about which it turns within a few mm."""
    setup = foam_blocks.setup(foam_blocks.stock(foam=foams()["xps_30"]))
    feeds = {"feed_mm_s": 6, "feed_min_mm_s": 2, "kerf_range_mm": [0.3, 20], "power_w": 30.0}
    asked = foam_blocks.operation(**feeds, **data)
    return collect_issues(lambda: StraightJob(asked, setup, twisted()).targets().issues)


ROWS: Final = [
    Row("kerf.doubt", lay, heat(40, 5), "state kerf_mm", {"operations.0": {**CUT, "kerf_mm": 1.9}}),
    Row("wire.held", bend, {"held_by": "right"}, "put the block on its support",
        {"held_by": Word("held_by: (\\w+)")}),
    Row("straight.uneven", turn, {"shape_tol_mm": 0.3}, "a several times larger",
        {"shape_tol_mm": ReportedFigure("# mm missing or left", 0.1, times=4.0)}),
]  # fmt: skip
