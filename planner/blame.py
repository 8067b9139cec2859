"""Whether what was given is to blame for a refusal, or what can be planned."""

from __future__ import annotations

from collections.abc import Iterable

from planner.issues import Issue, Severity

GIVEN_WRONG = {"problem", "part", "targets", "mesh", "cell", "output", "kerf", "align", "gcode"} | {
    "wire.unknown_material",
    "wire.size",
    "wire.temperature",
    "post.tasks",
    "post.controller",
    "post.signal",
    "post.name",
    "forming.no_sheet",
    "forming.tool",
    "forming.side",
    "forming.closed_mesh",
    "forming.inside_out",
    "forming.support_tool",
    "forming.holder",
    "forming.unknown_metal",
    "forming.force_input",
    "forming.adsif_table",
    "forming.path_options",
    "forming.hole",
    "forming.border",
    "forming.touching",
    "forming.flat",
    "forming.step",
    "forming.order",
    "milling.tool",
    "milling.no_surface",
    "milling.guides",
    "milling.guide_lengths",
    "batch.field",
    "batch.csv",
    "batch.in_use",
    "batch.install",
}
"""Issue codes, and rooms of codes, that what was given is to blame for, not what can be planned."""


def given_wrong(issues: Iterable[Issue]) -> bool:
    """Whether all errors are faults of what was given (exit code 2), not of what is feasible (3)."""
    codes = [issue.code for issue in issues if issue.severity is Severity.ERROR]
    return all(code in GIVEN_WRONG or code.split(".")[0] in GIVEN_WRONG for code in codes)
