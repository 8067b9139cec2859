"""Issue codes of milling and G-code."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # milling
    "milling.tool": IssueCode("the milling arm has no cutter", is_input_error=True),
    "milling.no_surface": IssueCode(
        "a cut names a surface that the part does not have, or requires a front face", is_input_error=True
    ),
    "milling.guides": IssueCode(
        "the two guide curves of a cut run in opposite directions, or meet", is_input_error=True
    ),
    "milling.guide_lengths": IssueCode(
        "the guide curves of a flank cut have very different lengths", is_input_error=True
    ),
    "milling.flute": IssueCode("the cutting length of the cutter is shorter than the wall"),
    "milling.holder": IssueCode("the holder of the cutter would be below the top of the wall"),
    "milling.corner": IssueCode("the surface has an inner corner, which a round cutter cannot mill"),
    "milling.twist": IssueCode("the cutter deviates from twisted rulings by more than the tolerance"),
    "milling.tool_radius": IssueCode("the cutter is too thick for a region of the part"),
    "milling.too_large": IssueCode("the face is too large to be checked at the resolution of its tolerance"),
    "milling.gouge": IssueCode("the cutter, shank, holder or spindle would cut into the part"),
    "milling.safe_plane": IssueCode(
        "the tool axis is so flat that the tool never rises to the safe plane",
        message="{cut}: the tool is tilted {tilt_deg:.0f} degrees from the {side} of the block "
        "and cannot rise to the safe plane there, allowed {max_tilt_deg:.0f}",
    ),
    "milling.front": IssueCode("the front of the part faces away from the milling side"),
    "milling.pattern": IssueCode(
        "the milling lines are too many, cover nothing, or leave ridges above the tolerance"
    ),
    "milling.off_surface": IssueCode("a curve to engrave leaves the front of the part"),
    # G-code
    "gcode.syntax": IssueCode("a line is not valid G-code, or the file is not text", is_input_error=True),
    "gcode.word": IssueCode(
        "a G-code word is not supported, or has no meaning on its line", is_input_error=True
    ),
    "gcode.unit": IssueCode("the length unit of the G-code file is not stated", is_input_error=True),
    "gcode.mode": IssueCode(
        "a mode of the G-code file, such as G90 or G91, is not stated", is_input_error=True
    ),
    "gcode.plane": IssueCode("the plane of an arc in the G-code file is not stated", is_input_error=True),
    "gcode.feed": IssueCode("the feed in the G-code file is not stated or not positive", is_input_error=True),
    "gcode.spindle": IssueCode(
        "the G-code file cuts with a stopped spindle or without a spindle speed", is_input_error=True
    ),
    "gcode.rotary": IssueCode(
        "a G-code word rotates the tool, but no machine kinematics are stated", is_input_error=True
    ),
    "gcode.axis": IssueCode(
        "a tool axis of the G-code file is not a unit vector, or reverses within one move",
        is_input_error=True,
    ),
    "gcode.arc": IssueCode(
        "an arc of the G-code file has no centre, two centres, or an inconsistent one", is_input_error=True
    ),
    "gcode.position": IssueCode(
        "a G-code move starts or ends at a position that is not stated or too far away", is_input_error=True
    ),
    "gcode.tool": IssueCode("only one tool per G-code file is supported", is_input_error=True),
    "gcode.offset": IssueCode(
        "the G-code file uses a work offset that the problem does not define", is_input_error=True
    ),
    "gcode.empty": IssueCode("the G-code file contains no moves", is_input_error=True),
    "gcode.after_end": IssueCode(
        "the G-code file continues after the end of its program", is_input_error=True
    ),
    "gcode.skipped": IssueCode("a G-code word is skipped, as the problem requests", is_input_error=True),
}
