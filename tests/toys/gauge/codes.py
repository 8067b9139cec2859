"""Issue codes of gauges."""

from __future__ import annotations

from typing import Final

from planner.issue_codes import Code

CODES: Final[dict[str, Code]] = {
    "ring.above": Code(
        "a gauge comes nearer to the block than it may, or does not go round",
        remedy="plan again, or lower least_mm",
    ),
    "ring.height": Code("a circle is hardly higher than the gauge must stay", given=True),
}
"""Rows by code."""
