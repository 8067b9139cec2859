"""Issue codes of gauges."""

from __future__ import annotations

from typing import Final

from planner.issue_codes import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    "ring.above": IssueCode(
        "a gauge comes nearer to the block than it may, or does not go round",
        remedy="plan again, or lower least_mm",
    ),
    "ring.height": IssueCode("a circle is hardly higher than the gauge must stay", is_input_error=True),
}
"""Rows by code."""
