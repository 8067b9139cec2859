"""Issue codes of hot wires: shapes, kerf and straight cuts."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # wire shapes
    "wire.too_short": IssueCode("the wire is shorter than the distance between its clamps"),
    "wire.unknown_material": IssueCode("unknown wire material", is_input_error=True),
    "wire.size": IssueCode(
        "the size of a wire or strip is missing, contradictory or not positive", is_input_error=True
    ),
    "wire.temperature": IssueCode(
        "the wire temperature is outside the range of its material", is_input_error=True
    ),
    "wire.no_equilibrium": IssueCode(
        "the solver found no equilibrium of the heavy wire near the initial guess",
        message="wire {index} of {length_mm:.4f} mm has no equilibrium between its clamps near the guess",
    ),
    # kerf of a hot wire
    "kerf.unknown_foam": IssueCode("unknown foam", is_input_error=True),
    "kerf.no_data": IssueCode(
        "the foam has no test cuts, or not those that the kerf model needs", is_input_error=True
    ),
    "kerf.model": IssueCode("unknown kerf model", is_input_error=True),
    "kerf.input": IssueCode(
        "power, speed, width and thickness must be positive numbers", is_input_error=True
    ),
    "kerf.impossible": IssueCode("no wire, speed or power produces this kerf", is_input_error=True),
    "kerf.melts": IssueCode(
        "at this power the wire reaches its limit temperature in air",
        is_input_error=True,
        message="power: got {power_w:.4g} W over a wire {diameter_mm:g} mm thick and "
        "{length_mm:g} mm long, allowed up to {max_power_w:.3g} W, where it reaches "
        "{limit_temperature_c:g} C in air, the limit of {material}",
    ),
    "kerf.file": IssueCode(
        "a file of test cuts is unreadable, or a value in it is missing or out of range", is_input_error=True
    ),
    "kerf.few_cuts": IssueCode(
        "too few test cuts remain, or all have the same speed and power",
        is_input_error=True,
        message="test cuts: got {usable_count} usable cuts ({hot_count} too hot and {cold_count} "
        "too cold left out), allowed {min_count} or more, at two or more speeds or powers",
    ),
    "kerf.no_trend": IssueCode(
        "the kerf of the test cuts does not increase with power over speed",
        is_input_error=True,
        message="test cuts: the kerf falls with power over speed (chi {chi:.2f}), but it has to rise",
    ),
    "kerf.foam_file": IssueCode(
        "a field of the foam file is missing, unknown or out of range", is_input_error=True
    ),
    "kerf.too_hot": IssueCode(
        "the slot is too wide for a usable face: the wire burns the foam",
        is_input_error=True,
        message="{operation}: on cut/{face} the joint limits hold the wire at {feed_percent:.0f} "
        "% of its feed at [{position_mm}] mm; it melts {kerf_mm:.2f} mm there, allowed "
        "are {max_kerf_mm:.2f} mm",
    ),
    "kerf.too_cold": IssueCode(
        "the slot is too narrow for a usable face: the wire drags", is_input_error=True
    ),
    "kerf.unsettled": IssueCode(
        "one end of the wire almost stops at the surface: no kerf is consistent with its own speed",
        is_input_error=True,
    ),
    "kerf.doubt": IssueCode(
        "the kerf model is used outside its tested range",
        is_input_error=True,
        message="{operation}: the kerf in {foam} is uncertain: {reasons}. Nine of ten cuts are "
        "within {spread_mm:.2f} mm of it",
    ),
    # planning a bent wire
    "wire.held": IssueCode("an elastic wire cannot cut a block that an arm holds"),
    "wire.chosen": IssueCode(
        "the chosen wire, and why",
        message="{operation}: of {wire_count} available wires mount {wire}, swept along {sweep}: "
        "{required_percent:g} % of each face within {deviation_mm:.2f} mm, including "
        "weight and end errors; allowed: {tolerance_mm:g} mm",
    ),
    "wire.shape": IssueCode("the elastic wire deviates from the face by more than the tolerance"),
    "wire.curvature": IssueCode(
        "the planned wire is bent beyond its elastic limit",
        message="the wire is bent to a radius of {radius_mm:.0f} mm ({target}), but {material} "
        "of {thickness_mm:g} mm stays elastic only down to {min_radius_mm:.0f} mm",
    ),
    "wire.unstable": IssueCode(
        "the planned wire shape is unstable or almost unstable, in or out of its plane",
        message="the planned wire shape is {state} {plane} ({target}): margin {margin:.3f}, "
        "where 1 is a free wire and 0 snaps",
    ),
    "wire.weight": IssueCode(
        "the weight of the wire moves it out of tolerance",
        message="{operation}: {required_percent:g} % of the {face} face is within {deviation}, "
        "required are {tolerance_mm:g} mm: the weight of the wire {effect}",
    ),
    "wire.end_error": IssueCode("position errors of the wire ends move the wire out of tolerance"),
    "wire.touches": IssueCode(
        "the wire comes too close to the block where it does not cut",
        message="{operation}: in segment {segment} the wire comes within {clearance_mm:.1f} mm "
        "of the block, required are {min_clearance_mm:g} mm",
    ),
    "wire.between_targets": IssueCode(
        "the wire leaves its required shape between two targets",
        message="{operation}: between targets {previous_target} and {target} ({segment}) the "
        "wire deviates by {deviation_mm:.2f} mm or has no equilibrium, although targets "
        "were added",
    ),
    # planning a straight wire
    "bow.missing": IssueCode("the cutting arm has no bow with a straight wire"),
    "bow.arms": IssueCode(
        "the operation must name the arm with the bow and the arm that holds the block",
        message="{operation}: arms are {arms}, but the block {support} in this setup; name {required_arms}",
    ),
    "bow.span": IssueCode("the foam is wider than the wire of the bow minus its margins"),
    "bow.throat": IssueCode(
        "the block is deeper than the throat of the bow on every side of the wire",
        message="{operation}: in {segment} the block reaches {depth_mm:.0f} mm behind the wire "
        "on every side, but the bow's throat is free for {free_throat_mm:.0f} mm; use a "
        "bow that is {missing_mm:.0f} mm deeper (throat_mm: {required_throat_mm:.0f}), "
        "or a smaller block",
    ),
    "straight.trim": IssueCode(
        "a side should be trimmed, but the block has no oversize there",
        message="{operation}: side {side} is to be trimmed, but the oversize of the block is "
        "{oversize_mm:g} mm there; state stock.oversize_mm, or leave the side out",
    ),
    "straight.corner": IssueCode("an inner corner or curve is tighter than half the kerf"),
    "straight.crossing": IssueCode("while cutting one piece of a surface, the wire cuts into another"),
    "straight.uneven": IssueCode("the slot width changes faster along the path than the wire can follow"),
    "straight.slit": IssueCode(
        "the wire reaches a hole through a slit in the part",
        message="{operation}: the wire reaches {segment} through the part: a slit of "
        "{length_mm:.1f} mm, along {direction} from {position}; glue it, or divide the "
        "part there",
    ),
    "straight.lead": IssueCode("the approach to an outline would cut through the part"),
    "straight.drop": IssueCode(
        "material above a level cut drops by one kerf before it is cut itself",
        acceptance="cut material drops by one kerf before it is cut itself",
        message="{operation}: the material above {segment} drops by the slot of {slot_mm:.1f} mm "
        "before {later_segment} is cut in it; set spacers: true, or cut it later",
    ),
}
