"""Issue codes of sheet forming."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    "forming.no_sheet": IssueCode("forming requires a sheet and a part", is_input_error=True),
    "forming.tool": IssueCode(
        "the tool of an arm is not usable in this forming mode",
        is_input_error=True,
        message="{operation}: arm {arm} carries the tool {tool}, mode {mode} needs {required_tools}",
    ),
    "forming.side": IssueCode(
        "a feature points to the side on which no tool can form it",
        is_input_error=True,
        message="{operation}: {features} {direction} the sheet, where there is none; turn the part or the "
        "sheet over, or use two arms in mode dsif, whose tools swap roles",
    ),
    "forming.closed_mesh": IssueCode(
        "the mesh of the part is closed, but one face of the sheet is required", is_input_error=True
    ),
    "forming.inside_out": IssueCode(
        "faces of the mesh of the part have inconsistent orientations",
        is_input_error=True,
        message="{file}: {reversed_percent:.0f} % of the area faces the opposite way, allowed "
        "{max_reversed_percent:.0f} %: the faces are oriented inconsistently",
    ),
    "forming.wall_angle": IssueCode(
        "a wall is too steep to be formed, or too steep for one pass",
        acceptance="a pass, or its loops with springback, form a steeper wall than the metal is known to "
        "bear",
    ),
    "forming.support_radius": IssueCode("the ball of the supporting tool is too large for the part"),
    "forming.gap": IssueCode("the gap between the two tools exceeds its tolerance between targets"),
    "forming.shift": IssueCode(
        "the requested rotation of the support around the forming tool exceeds the wall angle",
        message="feature {feature}: shift_deg is {shift_deg:g}, allowed is 0 to {wall_angle_deg:.1f}, the "
        "angle of its wall",
    ),
    "forming.support_tool": IssueCode(
        "the forming mode requires a tool that is missing", is_input_error=True
    ),
    "forming.die_gouge": IssueCode("the die would cut into the part"),
    "forming.die_far": IssueCode(
        "a full die is too far from the part",
        acceptance="a full die does not touch the walls that it should support",
        message="feature {feature}: the full die is more than {max_distance_mm:g} mm away from "
        "{unsupported_percent:.0f} % of the walls, up to {distance_mm:.2f} mm at ({x_mm:.1f}, {y_mm:.1f}, "
        "{z_mm:.1f}) mm; check its unit and position, or state full: false for a partial die",
    ),
    "forming.holder": IssueCode("a die and this sheet holder are incompatible", is_input_error=True),
    "forming.holder_step": IssueCode(
        "the sinking clamp cannot follow the tool, or its last step misses the rim of the part"
    ),
    "forming.clamp": IssueCode(
        "a tool collides with the clamp of the sheet",
        message="pass {pass_name}: the tool of {arm} reaches {depth_mm:.1f} mm into the clamp at "
        "({x_mm:.1f}, {y_mm:.1f}, {z_mm:.1f}) mm, allowed is 0",
    ),
    "forming.clear": IssueCode(
        "a tool cuts into a formed region of the sheet",
        message="pass {pass_name}: the tool of {arm} cuts {depth_mm:.3f} mm into the sheet at ({x_mm:.1f}, "
        "{y_mm:.1f}, {z_mm:.1f}) mm, allowed is {tolerance_mm:.2f} mm",
    ),
    # sheet metals, forces, trials and tables of forming
    "forming.unknown_metal": IssueCode("unknown sheet metal", is_input_error=True),
    "forming.thickness_untested": IssueCode(
        "the sheet thickness is outside the range of known forming tests",
        message="thickness: got {thickness_mm:g} mm, tests of {metal} are known for {tested_range}; its "
        "wall angle limit and forces are guesses beyond that",
    ),
    "forming.trial": IssueCode(
        "a trial of one laboratory failed at this wall angle, thickness and depth",
        message="{thickness_mm:g} mm {metal_family}, {angle_deg:.0f} deg, {depth_mm:.0f} mm deep: in a "
        "trial ({trial}: {trial_mode}{support_clause}, {trial_thickness_mm:g} mm, {trial_angle_deg:.0f} "
        "deg, {lubricant}) {cause} at a depth of {trial_depth_mm:.0f} mm; a single trial in one lab with "
        "metal of unstated alloy is no limit",
    ),
    "forming.force_input": IssueCode(
        "a length, angle or force of the force estimate is out of range", is_input_error=True
    ),
    "forming.force": IssueCode(
        "the forming force exceeds the remaining payload of a robot",
        acceptance="the robots can press harder than their stated payload",
        message="{arm}: forming needs about {force_n:.0f} N{range_clause} ({source}), the payload of "
        "{robot} leaves {free_force_n:.0f} N besides its tool; the arm may stop with a collision error or "
        "deflect",
    ),
    "forming.springback": IssueCode("the springback of the formed sheet after release exceeds the tolerance"),
    "forming.springback_mesh": IssueCode(
        "the formed sheet cannot be meshed with so few triangles",
        message="pass {pass_name}: the sheet as formed at z = {z_mm:.2f} mm has no mesh: {error}",
    ),
    "forming.plate_test": IssueCode(
        "the readings of a plate test are implausible or too few", is_input_error=True
    ),
    "forming.clamp_unclear": IssueCode(
        "the readings of the plate test do not determine some values, or do not separate them"
    ),
    "forming.springback_mode": IssueCode("springback is not modelled for this job", is_input_error=True),
    "forming.compensation": IssueCode(
        "the springback file is truncated, changed, of another job, or exceeds its limits",
        is_input_error=True,
    ),
    "forming.compensated": IssueCode(
        "the overforming that compensates springback",
        message="tools go deeper than the part to compensate springback, by {file}: up to "
        "{max_shift_mm:.2f} mm ({level_clause}pass {pass_name}); {basis}",
    ),
    "forming.limit_load": IssueCode("the formed sheet snaps through or buckles under the expected force"),
    "forming.loop_curves": IssueCode(
        "the file of springback curves is unreadable, truncated, or of another problem", is_input_error=True
    ),
    "forming.loop_forces": IssueCode(
        "the measured forces have other points, levels or units, or an invalid row", is_input_error=True
    ),
    "forming.loop_law": IssueCode("a parameter of the springback loop is out of range", is_input_error=True),
    "forming.loop_plant": IssueCode(
        "the plant file is invalid, or its sheet belongs to another part", is_input_error=True
    ),
    "forming.loop_unstable": IssueCode(
        "a gain of the springback loop would be unstable from level to level",
        message="rule {rule}, {levels_per_action} levels per action: q (the model's springback times the "
        "gain, over that of the sheet) may be {ratio:.2f}, allowed below {limit:.2f}: level {level} has "
        "gamma {gamma:.2f}, and the loop would diverge",
    ),
    "forming.loop_range": IssueCode("corrections of the springback loop were limited to their range"),
    "forming.adsif_table": IssueCode(
        "a table of the ADSIF response is unreadable, or contains an invalid value",
        is_input_error=True,
        message="ADSIF table: {fault}",
    ),
    "forming.adsif_conditions": IssueCode(
        "the ADSIF table was measured for another metal, sheet, tool or path"
    ),
    "forming.adsif_range": IssueCode("the wall angle is outside the ADSIF table"),
    "forming.adsif_unstable": IssueCode(
        "the tool positions are unstable according to the ADSIF table, or outside it",
        message="position angle {position_deg:.4g} deg with gap {gap_ratio:.4g} of the thickness: the sheet "
        "buckles there, or it was not tested ({source})",
    ),
    "forming.adsif_compliance": IssueCode(
        "the deflection of the tools exceeds what the ADSIF gap can compensate"
    ),
    # paths of the contact on a face
    "forming.path_options": IssueCode(
        "a step, ridge height, chord or other value of the forming path is out of range", is_input_error=True
    ),
    "forming.no_contour": IssueCode("no part of the face lies between the levels of the path"),
    "forming.open_contour": IssueCode("a level line of the face ends at a border of its mesh"),
    "forming.unreached": IssueCode(
        "corners of the part are tighter than the forming ball, which does not reach them"
    ),
    "forming.tool_radius": IssueCode("the forming tool is too large for a region of the face"),
    # features of a part that is formed from a sheet
    "forming.undercut": IssueCode("the part has an undercut: a wall steeper than 90 degrees"),
    "forming.hole": IssueCode("the part has a hole, or a gap between facets", is_input_error=True),
    "forming.border": IssueCode("the edge of the part leaves the sheet plane", is_input_error=True),
    "forming.touching": IssueCode("two features touch or overlap", is_input_error=True),
    "forming.flat": IssueCode("the part is flat: nothing leaves the sheet plane", is_input_error=True),
    "forming.step": IssueCode(
        "the slicing step is not positive, or gives too many levels", is_input_error=True
    ),
    "forming.holes": IssueCode(
        "a formed area or a tool comes too close to a curve along which the sheet was cut"
    ),
    "forming.features": IssueCode(
        "the operations of a part name an unknown feature, name one twice, or omit one"
    ),
    "forming.order": IssueCode(
        "the forming order names a feature twice, omits one, or names one before its parent",
        is_input_error=True,
        message="order of forming: {fault}",
    ),
}
