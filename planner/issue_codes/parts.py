"""Issue codes of building elements, meshes and parts."""

from typing import Final

from planner.issue_codes.row import IssueCode

CODES: Final[dict[str, IssueCode]] = {
    # building elements
    "element.surface": IssueCode(
        "the surface of an element has holes or folds, touches itself, does not fill a "
        "rectangle, or is too narrow for adjacent panels",
        is_input_error=True,
    ),
    "element.wire": IssueCode("no wire is long enough for the smallest panel at a position of the element"),
    "element.tolerance": IssueCode(
        "panels deviate from the surface of the element by more than the tolerance"
    ),
    "element.shape": IssueCode(
        "panels of an element self-intersect, fold over, tilt too far or are too small"
    ),
    "element.count": IssueCode(
        "the row layout gives another number of quad panels than requested",
        message="{panel_count} panels: rows of quads over {min_width_mm:g} mm wide allow no count closer to "
        "{requested_count}",
    ),
    "element.concave": IssueCode(
        "planar panels of an element have concave corners",
        message="{concave_count} of {panel_count} panels are concave{reason_clause}: {panels}",
    ),
    "element.assembly": IssueCode(
        "panels of an element have no collision-free straight insertion path in any tested order",
        message="{blocked_count} of {panel_count} panels have no free straight insertion path in any order "
        "that was tried; on the best path the interference is: {panels}",
    ),
    "element.dowels": IssueCode(
        "panels are inserted without dowels: the insertion path is too oblique, or there is no "
        "space for a dowel",
        message="{undowelled_count} of {inserted_count} panels have no dowel; the best joint of each is: "
        "{panels}",
    ),
    "element.block": IssueCode("no block holds the panel at a position of the element"),
    "element.held": IssueCode(
        "panels that no wire can cut safely, listed where they cannot be avoided",
        message="{affected_count} of {panel_count} panels {problem}: {panels}",
    ),
    "element.run": IssueCode(
        "the report needs an element batch whose panels are all proven", is_input_error=True
    ),
    "element.mark": IssueCode(
        "the marked panel is not in the element, or the list of marks is invalid or belongs to other panels",
        is_input_error=True,
    ),
    "element.joint": IssueCode("adjacent panels of an element meet with a larger step than requested"),
    "element.face": IssueCode(
        "panel faces deviate from the written surface, or their slot is on the side of the panel",
        message="{face} of panel {panel} as cut: {percentile_95_mm:.3f} mm off {reference} at 95 % of its "
        "points, {max_deviation_mm:.3f} mm at most{slot_clause}; allowed: {percentile_95_limit_mm:g} and "
        "{max_deviation_limit_mm:g} mm",
    ),
    "element.raw_block": IssueCode("the block of a panel fits none of the raw blocks of its foam"),
    "element.cut": IssueCode("the bow cannot reach some cuts of raw blocks from any direction"),
    "element.stock": IssueCode(
        "the list of leftover foam is invalid or has invalid rows", is_input_error=True
    ),
    "element.jobs": IssueCode(
        "a template of the element is invalid, or a panel matches no template or several", is_input_error=True
    ),
    # meshes and parts
    "mesh.unreadable": IssueCode(
        "the mesh file has an unsupported format or is damaged", is_input_error=True
    ),
    "mesh.empty": IssueCode("the mesh file has no faces with a positive area", is_input_error=True),
    "mesh.unit": IssueCode(
        "the mesh is implausibly large or small in its unit, or states another unit than the problem",
        is_input_error=True,
    ),
    "mesh.file_unit": IssueCode(
        "the unit that the mesh file states and that was used",
        is_input_error=True,
        message="{file} {unit_note}",
    ),
    "mesh.non_manifold": IssueCode("more than two faces of the mesh share an edge", is_input_error=True),
    "mesh.orientation": IssueCode("adjacent faces of the mesh have opposite normals", is_input_error=True),
    "mesh.closed": IssueCode("the mesh is closed, but an open face is required", is_input_error=True),
    "mesh.pieces": IssueCode(
        "the mesh has several separate pieces, but one is required", is_input_error=True
    ),
    "part.mesh_noise": IssueCode(
        "the estimated noise of the mesh of a part, and the smooth face that was fitted", is_input_error=True
    ),
    "part.mesh_tolerance": IssueCode("the mesh tolerance is too large for the part", is_input_error=True),
    "part.offset": IssueCode(
        "the curvature radius of the face is smaller than the offset distance",
        is_input_error=True,
        message="offset by {offset_mm:.2f} mm, the face folds over itself at {folded} of {facets} facets, "
        "the first at ({position_mm[0]:.1f}, {position_mm[1]:.1f}, {position_mm[2]:.1f}) mm; its radius must "
        "be larger than that, so use a thinner part, a smaller kerf or a smoother face",
    ),
    "part.stock_too_small": IssueCode("the part does not fit into the block", is_input_error=True),
    "part.faces": IssueCode(
        "the front and back faces of a part are not on each other's inner side", is_input_error=True
    ),
    "part.missing_face": IssueCode("a face to cut does not exist in the part", is_input_error=True),
    "part.naca": IssueCode(
        "the digits belong to no NACA family",
        is_input_error=True,
        message="NACA {digits}: {reason}; correct the digits",
    ),
    "part.airfoil_format": IssueCode(
        "the airfoil file is in neither Selig nor Lednicer format", is_input_error=True
    ),
    "part.airfoil_order": IssueCode("the points of the airfoil are in the wrong order", is_input_error=True),
    "part.airfoil_open": IssueCode("the airfoil has no trailing edge, or only one side", is_input_error=True),
    "part.airfoil_points": IssueCode("the airfoil has too few points", is_input_error=True),
    "part.airfoil_crossing": IssueCode("the airfoil intersects itself", is_input_error=True),
    "part.airfoil_note": IssueCode(
        "the airfoil was corrected: point order, chord or duplicate points",
        is_input_error=True,
        message="{file} {correction}",
    ),
    "part.wing": IssueCode("the shape of the wing is implausible", is_input_error=True),
    "part.ruled_shape": IssueCode(
        "the ruled surface has rulings of zero length, or folds over itself", is_input_error=True
    ),
    "part.corners": IssueCode("the two guide curves have different numbers of corners", is_input_error=True),
    "part.guide": IssueCode(
        "the guide curve has too few points, zero length, or intersects itself", is_input_error=True
    ),
    "part.guide_turned": IssueCode(
        "the guide curve was reversed so that the rulings do not cross", is_input_error=True
    ),
    "part.outline_open": IssueCode("the outline is not closed", is_input_error=True),
    "part.outline_crossing": IssueCode("the outline intersects itself", is_input_error=True),
    "part.outline_overlap": IssueCode("outlines cross or touch each other", is_input_error=True),
    "part.outline_duplicate": IssueCode("the same outline occurs twice", is_input_error=True),
    "part.extra_missing": IssueCode(
        "reading the file requires a package of an optional extra", is_input_error=True
    ),
    "part.dxf": IssueCode(
        "the DXF file is unreadable, or contains none of the required entities", is_input_error=True
    ),
    "part.dxf_left_out": IssueCode("unsupported entities of the DXF file were skipped", is_input_error=True),
    "part.dxf_unit": IssueCode("the DXF file states another unit than the problem", is_input_error=True),
    "part.rhino": IssueCode(
        "the Rhino file is unreadable, or lacks the required objects, or has several of them",
        is_input_error=True,
    ),
    "part.rhino_unit": IssueCode("the unit in which the Rhino file was read", is_input_error=True),
    "part.rhino_left_out": IssueCode(
        "objects of the Rhino file were skipped or converted", is_input_error=True
    ),
    "part.rhino_facets": IssueCode(
        "the measured deviation of the facets from the face of the Rhino file", is_input_error=True
    ),
    "part.step": IssueCode(
        "the STEP or IGES file is unreadable, or does not contain the required face", is_input_error=True
    ),
    "part.step_unit": IssueCode("the unit in which the STEP or IGES file was read", is_input_error=True),
    "part.step_facets": IssueCode(
        "the measured deviation of the facets from the face of the STEP or IGES file", is_input_error=True
    ),
    "part.edges": IssueCode(
        "straight edges cannot join the boundaries of front and back",
        is_input_error=True,
        message="{reason}, so the part has no ruled edges for a cut with a straight wire; {remedy} if it "
        "needs them",
    ),
    "part.patch": IssueCode(
        "the mesh is not a patch with one boundary and four corners", is_input_error=True
    ),
    "part.not_ruled": IssueCode(
        "the surface deviates from every ruled surface by more than its tolerance", is_input_error=True
    ),
    "part.ruled_deviation": IssueCode(
        "the deviation of the surface from its ruled approximation", is_input_error=True
    ),
    "part.strips": IssueCode(
        "no number of ruled strips meets the tolerance of the surface, or a strip does not exist",
        is_input_error=True,
    ),
    "part.strips_found": IssueCode(
        "the strips of the surface: number, deviations and kinks", is_input_error=True
    ),
    "part.missing_surface": IssueCode(
        "a ruled surface to cut does not exist in the part", is_input_error=True
    ),
}
