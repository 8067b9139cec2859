"""Issue codes of trimming formed sheets."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    "trim.tool": IssueCode(
        "the trimming arm has no torch, mill or knife, or its tool does not reach through the sheet",
        is_input_error=True,
    ),
    "trim.die": IssueCode(
        "a mill or knife cannot cut through a sheet with a die behind it",
        is_input_error=True,
        message="{operation}: there is a die behind the sheet, which the {tool} would hit",
    ),
    "trim.no_sheet": IssueCode("trimming requires a sheet that was formed", is_input_error=True),
    "trim.open": IssueCode("a curve to cut is not closed", is_input_error=True),
    "trim.crosses": IssueCode("curves to cut intersect themselves or each other", is_input_error=True),
    "trim.in_waste": IssueCode("a curve lies in the waste of another curve", is_input_error=True),
    "trim.off_part": IssueCode("a curve with its slot and lead-ins leaves the opening of the clamp"),
    "trim.narrow": IssueCode("the waste is narrower than the slot"),
    "trim.corner": IssueCode(
        "a corner is too sharp for a round slot, or a bend or corner too sharp for a blade"
    ),
    "trim.joints": IssueCode("too many micro-joints for the curve"),
    "trim.lead": IssueCode("no lead-in with its pierce point fits into the waste"),
    "trim.wall": IssueCode(
        "a tool comes too close to a wall of the sheet, or its angle to the sheet is too flat"
    ),
    "trim.slow": IssueCode("the arm is slower in the slot than the cut of the torch allows"),
}
