"""Issue codes of the shop floor: scans and the alignment of robots."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # scans of formed parts
    "scan.file": IssueCode(
        "the scan is unreadable, or has too few or too many points",
        is_input_error=True,
        message="{file}: {fault}",
    ),
    "scan.unit": IssueCode(
        "the scan is far larger or smaller than the sheet: its unit is wrong", is_input_error=True
    ),
    "scan.flat": IssueCode(
        "too little of the flat flange around the part is in the scan", is_input_error=True
    ),
    "scan.other_part": IssueCode(
        "the scan shows another part, too little of the part, or its mirror image", is_input_error=True
    ),
    "scan.no_marks": IssueCode(
        "the scan has no marks, so its position in the sheet plane is assumed to be correct",
        is_input_error=True,
    ),
    "scan.marks": IssueCode("the marks do not locate the scan as accurately as the part is measured"),
    "scan.stray": IssueCode("the number of isolated points of the scan"),
    "scan.hole": IssueCode("a region of the part is missing in the scan", is_input_error=True),
    # the base of the second robot, from points that both probed
    "align.file": IssueCode(
        "a file of probed points is unreadable, or a value in it is missing or out of range",
        is_input_error=True,
    ),
    "align.cell": IssueCode(
        "the cell has no second arm, or its base cannot be updated in the file", is_input_error=True
    ),
    "align.few_points": IssueCode(
        "fewer than three points were probed, or too few remain", is_input_error=True
    ),
    "align.same_points": IssueCode("the probed points coincide", is_input_error=True),
    "align.collinear": IssueCode(
        "the probed points are collinear, so the rotation about their line is undetermined",
        is_input_error=True,
    ),
    "align.mirrored": IssueCode(
        "the probed points fit a mirror image, as if one axis had the wrong sign", is_input_error=True
    ),
    "align.units": IssueCode(
        "the points of the two robots differ by a common scale factor", is_input_error=True
    ),
    "align.bad_point": IssueCode(
        "one probed point does not fit the others",
        is_input_error=True,
        message="point {point!r} is {distance_mm:.2f} mm from its position by the other points "
        "({x_mm:+.2f}, {y_mm:+.2f}, {z_mm:+.2f} mm), allowed {tolerance_mm:g} mm",
    ),
    "align.large_residual": IssueCode(
        "the residual of the probed points exceeds the limit, and no single point causes it",
        is_input_error=True,
        message="points are up to {max_distance_mm:.2f} mm from the fit, allowed {tolerance_mm:g} mm, and "
        "no single one of them is certainly wrong; the largest disagreement is {disagreement_mm:.2f} mm in "
        "the distance between {first_point!r} and {second_point!r}",
    ),
}
