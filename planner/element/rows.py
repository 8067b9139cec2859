"""Rows: parts of raw blocks out of which several panels are cut together, without separate blocks.

A straight wire cuts the faces of all panels of a row in one pass, if they lie in one slab or their rulings
are in line. Then the operator puts the row on edge, and the wire goes around each panel, the uppermost first.
This module decides which parts of a nested block are rows, and why others are not. `row_jobs` writes their
problems.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, transform, unit
from planner.geometry.cut_tree import BlockPart, BowSize, CutTree
from planner.geometry.units import DEG, MM

THICKNESS_TOLERANCE_M: Final = 5e-5
"""Maximum difference [m] of thicknesses that count as equal: sizes of blocks are rounded to 0.1 mm."""
ALONE_REASON: Final = "nothing else is cut out of its part of the block"
"""Reason why a panel is cut alone if its part of the block has no other panel."""
FRONTS, BACKS = "fronts", "backs"
"""Names of the surfaces of a problem that have the fronts, or the backs, of all panels of a row."""
RULING_INSET_M: Final = 1e-3
"""Distance [m] inside of the row at which rulings of faces end. The wire extends beyond both ends."""
SUPPORT_CLEARANCE_M: Final = 1e-3
"""Distance [m] between the wire and the supports of a row, in addition to the clearance."""
OUTLINE_EXTENSION_M: Final = 3e-3
"""Extension [m] of outlines beyond a front that is cut, if there is foam."""
MIN_REMOVED_M: Final = 2e-4
"""Minimum thickness [m] of foam cut off above panels, so that their sides cross the plane of fronts."""
MIN_SUPPORT_M: Final = 0.02
"""Minimum length [m] of a support."""
LENGTH_TOLERANCE_M: Final = 1e-6
"""Lengths [m] below this are rounding errors."""
_SIDE_DISTANCE_M: Final = 0.005  # [m], panels farther beside the one below do not obstruct its approach
_WIRE_SAMPLES: Final = 9  # number of points of a wire that are checked
_STEP_M: Final = 1e-3  # [m], step of positions at which supports are checked


@dataclasses.dataclass(frozen=True)
class PanelShape:
    """Shape of a panel in the frame of its block; lengths in m.

    Attributes:
        outline: Corners (2, C, 3) at the back and in front, counterclockwise.
        faces: Ends (2, N, 3) of the rulings of back and front, along x and successive along y. None if the
            faces are level: the back at z = 0, the front at the thickness of the panel.
    """

    outline: FloatArray
    faces: tuple[FloatArray, FloatArray] | None = None

    def max_tilt(self) -> float:
        """Return the maximum angle [rad] between the wire and z when it goes around the panel."""
        rise = self.outline[1] - self.outline[0]
        return float(np.arctan2(np.linalg.norm(rise[:, :2], axis=1), rise[:, 2]).max())


@dataclasses.dataclass(frozen=True)
class RowLimits:
    """Limits of a row.

    Attributes:
        bow: Bow that cuts rows.
        margin: Minimum distance [m] of the foam from the ends of the wire and from the beam.
        kept: Minimum side [m] of offcuts that are kept. A part with such an offcut is not a row.
        room: Minimum distance [m] between wire and supports.
    """

    bow: BowSize
    margin: float
    kept: float
    room: float


@dataclasses.dataclass(frozen=True)
class RowPiece:
    """A panel whose block is to be cut.

    Attributes:
        name: Id of the panel.
        thickness: Thickness [m].
        shape: Shape of the panel; None if no straight wire cuts it.
    """

    name: str
    thickness: float
    shape: PanelShape | None


SupportRange = tuple[float, float]
"""Lower and upper end [m] of a support along an axis of a row, in the frame of the row."""


@dataclasses.dataclass(frozen=True)
class PanelRow:
    """A part of a block out of which panels are cut together.

    Cuts are in the frame of the row [m], with its origin at the centre of the bottom face. Outlines, poses
    and pieces are ordered from the uppermost panel on edge to the lowest one.

    Attributes:
        part: Part of the block.
        pieces: Boxes of the panels in the block.
        poses: Poses (4, 4) of the blocks of panels, by id.
        faces: By surface (`FRONTS`, `BACKS`), the rulings (2, N, 3) of each panel in turn.
        outlines: Outlines (2, C, 3) of back and front, by id.
        beams: Supports on which it lies flat while faces are cut; empty if there are no faces to cut.
        axis: Axis (0: x, 1: y) that is upright when it stands on edge for the outlines.
        feet: Supports along the other axis on which it stands on edge.
    """

    part: BlockPart
    pieces: tuple[BlockPart, ...]
    poses: Mapping[str, FloatArray]
    faces: Mapping[str, Sequence[FloatArray]]
    outlines: Mapping[str, FloatArray]
    beams: tuple[SupportRange, ...]
    axis: int
    feet: tuple[SupportRange, ...]

    def is_free_above(self, name: str) -> bool:
        """Whether no other panel is above this one on edge, so that the wire can approach it from above."""
        across_values = self.outlines[name][..., 1 - self.axis]
        low, high = float(across_values.min()), float(across_values.max())
        top = float(self.outlines[name][..., self.axis].max())
        return not any(
            ring[..., self.axis].max() > top
            and ring[..., 1 - self.axis].min() < high + _SIDE_DISTANCE_M
            and ring[..., 1 - self.axis].max() > low - _SIDE_DISTANCE_M
            for other, ring in self.outlines.items()
            if other != name
        )

    @property
    def along(self) -> int:
        """Axis (0: x, 1: y) along which the wire cuts faces. Beams follow one another along it."""
        return 0 if self.pieces[0].is_rotated else 1


def find_rows(
    tree: CutTree, pieces: Sequence[RowPiece], thickness: float, limits: RowLimits
) -> tuple[dict[int, PanelRow], dict[int, str]]:
    """Find the largest parts of a block that are rows.

    Args:
        tree: Cuts of the block.
        pieces: Panels by box number.
        thickness: Thickness of the block [m].
        limits: Limits of rows.

    Returns:
        Rows by the index of their part in the tree; and, by box number, why other boxes are cut alone.
    """
    rows: dict[int, PanelRow] = {}
    alone: dict[int, str] = {}
    stack = [(0, ALONE_REASON)]
    while stack:
        i, reason = stack.pop()
        part = tree.parts[i]
        if part.box is not None:
            alone[part.box] = reason
            continue
        if sum(tree.parts[k].box is not None for k in tree.descendants(i)) > 1:
            row = _make_row(tree, i, pieces, thickness, limits)
            if isinstance(row, PanelRow):
                rows[i] = row
                continue
            reason = row  # why the part is not a row; its own parts may be rows
        stack += [(k, reason) for k in (part.high, part.low) if k is not None]
    return rows, alone


def _make_row(
    tree: CutTree, i: int, pieces: Sequence[RowPiece], thickness: float, limits: RowLimits
) -> PanelRow | str:
    """Return the part ``i`` of a tree as a row, or the reason why it is not a row."""
    part, bow, margin = tree.parts[i], limits.bow, limits.margin
    descendants = [tree.parts[k] for k in tree.descendants(i)]
    boxes = [item for item in descendants if item.box is not None]
    shapes = [item.shape for item in (pieces[box.box or 0] for box in boxes) if item.shape is not None]
    if len(shapes) < len(boxes):
        return "a bent wire cuts their faces"
    for item in descendants:
        if (
            item.box is None
            and item.axis is None
            and min(item.length, item.width) >= limits.kept - THICKNESS_TOLERANCE_M
        ):
            size = f"{item.length / MM:.0f} x {item.width / MM:.0f} mm"
            return f"the offcut beside them, {size}, is large enough to be kept"
    sides = (part.length, part.width)
    upright = [k for k in (0, 1) if sides[k] + margin <= bow.throat]
    if not upright:
        allowed_text = f"throat of {bow.throat / MM:g} mm allows {(bow.throat - margin) / MM:.0f}"
        return f"on edge they stand {min(sides) / MM:.0f} mm high, and the bow's {allowed_text}"
    tilt = max(shape.max_tilt() for shape in shapes)
    span = thickness / float(np.cos(tilt)) + 2.0 * margin
    if span > bow.span:
        return _span_reason("around them", span, tilt, bow)
    thicknesses = [pieces[box.box or 0].thickness for box in boxes]
    has_ruled_faces = [shape.faces is not None for shape in shapes]
    if all(has_ruled_faces):
        reason = _line_reason(part, boxes, margin, bow)
        if reason is not None:
            return reason
    elif any(has_ruled_faces) or max(thicknesses) - min(thicknesses) > THICKNESS_TOLERANCE_M:
        return "they have different thicknesses, so their faces are in several planes"
    elif THICKNESS_TOLERANCE_M < thickness - thicknesses[0] < MIN_REMOVED_M - LENGTH_TOLERANCE_M:
        excess_text = f"{(thickness - thicknesses[0]) / MM:.2g} mm thicker than they are"
        return f"the block is {excess_text}; it must be equally thick, or {MIN_REMOVED_M / MM:g} mm thicker"
    elif thickness - thicknesses[0] > THICKNESS_TOLERANCE_M and min(sides) + 2.0 * margin > bow.span:
        return _span_reason("across them, to their thickness", min(sides) + 2.0 * margin, 0.0, bow)
    return _supported_row(
        part, boxes, pieces, thickness, sorted(upright, key=lambda k: (sides[k], k)), limits
    )


def _span_reason(direction: str, span: float, tilt: float, bow: BowSize) -> str:
    """Return the reason that the bow is too narrow for a wire in a direction, which needs ``span`` [m]."""
    leans = f", which is tilted by {tilt / DEG:.0f} degrees," if tilt > DEG else ""
    return (
        f"the wire {direction}{leans} needs a span of {span / MM:.0f} mm, but the bow has {bow.span / MM:g}"
    )


def _line_reason(part: BlockPart, boxes: Sequence[BlockPart], margin: float, bow: BowSize) -> str | None:
    """Return the reason why the ruled faces of ``boxes`` cannot be cut in one pass; None if they can."""
    is_rotated = boxes[0].is_rotated
    if any(box.is_rotated != is_rotated for box in boxes):
        return "the rulings of their faces have different directions in the block"
    ends = sorted((box.x, box.x + box.length) if is_rotated else (box.y, box.y + box.width) for box in boxes)
    if any(first[1] > second[0] + THICKNESS_TOLERANCE_M for first, second in itertools.pairwise(ends)):
        return "they are side by side along the rulings of their faces"
    across = (part.width if is_rotated else part.length) + 2.0 * margin
    return _span_reason("along their rulings", across, 0.0, bow) if across > bow.span else None


def _supported_row(
    part: BlockPart,
    boxes: Sequence[BlockPart],
    pieces: Sequence[RowPiece],
    thickness: float,
    axes: Sequence[int],
    limits: RowLimits,
) -> PanelRow | str:
    """Return the row of boxes with its supports, or the reason why it cannot be supported.

    ``axes`` are the axes that may be upright when the row stands on edge, the preferred one first.
    """
    poses = [_panel_pose(part, box) for box in boxes]
    row_pieces = [pieces[box.box or 0] for box in boxes]
    shapes = [piece.shape for piece in row_pieces if piece.shape is not None]
    outlines = [transform(pose, shape.outline) for pose, shape in zip(poses, shapes, strict=True)]
    half = 0.5 * np.array([part.length, part.width])
    faces: dict[str, Sequence[FloatArray]] = {}
    beams: tuple[SupportRange, ...] = ()
    along = 0 if boxes[0].is_rotated else 1
    if shapes[0].faces is not None:
        for k, name in ((1, FRONTS), (0, BACKS)):
            own_faces = [shape.faces[k] for shape in shapes if shape.faces is not None]
            faces[name] = _faces_in_line(own_faces, poses, float(half[1 - along]) - RULING_INSET_M)
            ends = [
                (float(rulings[..., along].min()), float(rulings[..., along].max()))
                for rulings in faces[name]
            ]
            if any(
                first[1] > second[0] - THICKNESS_TOLERANCE_M
                for first, second in itertools.pairwise(sorted(ends))
            ):
                return "their faces, which extend beyond their sides, overlap"
        backs = _extend_wires(np.concatenate(faces[BACKS], axis=1), along, float(half[along]) + limits.room)
        beam_ranges = _support_ranges(_wire_paths(backs), along, 2, 0.0, half, limits.room)
        if isinstance(beam_ranges, float):
            return _clearance_reason("foam_faces_mm", "when lying flat", beam_ranges, limits)
        beams = beam_ranges
    elif thickness - row_pieces[0].thickness > THICKNESS_TOLERANCE_M:
        panel_thickness = row_pieces[0].thickness
        # surfaces that bound a part together extend beyond one another
        extension = 1.0 + min(OUTLINE_EXTENSION_M, thickness - panel_thickness) / panel_thickness
        outlines = [np.stack([ring[0], ring[0] + extension * (ring[1] - ring[0])]) for ring in outlines]
        excess = max(float((np.abs(ring[..., :2]) - half).max()) for ring in outlines)
        if excess > LENGTH_TOLERANCE_M:
            more_foam = f"{excess / MM:.2g} mm more foam beside them (foam_sides_mm)"
            return f"their sides, extended beyond the fronts, leave the part; {more_foam} would suffice"
        faces[FRONTS] = [_level_plane(half, panel_thickness)]
        beams = ((-float(half[along]), float(half[along])),)
    max_height = -np.inf
    for axis in axes:
        rings = [_to_faces(np.concatenate([ring, ring[:, :1]], axis=1), thickness) for ring in outlines]
        paths = [path for ring in rings for path in _wire_paths(ring)]
        feet = _support_ranges(paths, 1 - axis, axis, -float(half[axis]), half, limits.room)
        if isinstance(feet, float):
            max_height = max(max_height, feet)
            continue
        top = [-float(ring[..., axis].max()) for ring in outlines]
        order = sorted(range(len(boxes)), key=lambda k: (round(top[k] / THICKNESS_TOLERANCE_M), k))
        return PanelRow(
            part,
            tuple(boxes[k] for k in order),
            {row_pieces[k].name: poses[k] for k in order},
            faces,
            {row_pieces[k].name: outlines[k] for k in order},
            beams,
            axis,
            feet,
        )
    return _clearance_reason("foam_sides_mm", "on edge", max_height, limits)


def _clearance_reason(field: str, how: str, height: float, limits: RowLimits) -> str:
    """Return the reason that the wire is too close to supports; ``field`` states the foam that would help."""
    requirement = f"{limits.room / MM:g} mm are required ({field})"
    return f"{how} the wire comes within {height / MM:.1f} mm of what bears them, and {requirement}"


def _to_faces(ring: FloatArray, thickness: float) -> FloatArray:
    """Return where (2, N, 3) [m] wires through ``ring`` (2, N, 3) [m] intersect bottom and top of a row."""
    rise = ring[1] - ring[0]
    fractions = [(height - ring[0][:, 2]) / rise[:, 2] for height in (0.0, thickness)]
    return np.stack([ring[0] + fraction[:, None] * rise for fraction in fractions])


def _wire_paths(ends: FloatArray) -> list[FloatArray]:
    """Return the paths (N, 3) of `_WIRE_SAMPLES` points of a wire, from the paths of its ``ends`` (2, N, 3).

    An inclined wire may be closer to a support in between than at both ends.
    """
    return [
        ends[0] + fraction * (ends[1] - ends[0]) for fraction in np.linspace(0.0, 1.0, _WIRE_SAMPLES).tolist()
    ]


def _extend_wires(ends: FloatArray, along: int, max_distance: float) -> FloatArray:
    """Add lead-in and lead-out to the paths of a wire's ends (2, N, 3), straight on from a surface.

    The paths reach to ``max_distance`` [m] from the centre of the row along the axis ``along``.
    """
    out = ends
    for k, inner_index in ((0, 1), (-1, -2)):
        ruling = unit(ends[1, k] - ends[0, k])
        direction = (ends[:, k] - ends[:, inner_index]).sum(axis=0)
        direction = unit(direction - (direction @ ruling) * ruling)
        remaining = max_distance - np.sign(direction[along]) * ends[:, k, along]
        length = float(
            np.clip(
                remaining.max() / max(abs(float(direction[along])), LENGTH_TOLERANCE_M),
                0.0,
                2.0 * max_distance,
            )
        )
        extension = ends[:, [k]] + length * direction
        out = np.concatenate([extension, out] if k == 0 else [out, extension], axis=1)
    return out


def _support_ranges(
    lines: Sequence[FloatArray], along: int, up: int, bottom: float, half: FloatArray, room: float
) -> tuple[SupportRange, ...] | float:
    """Return where a row may be supported from below, so that the wire stays ``room`` [m] away from supports.

    If no support is possible on one of both sides of its middle, return the minimum height [m] of the paths.

    Args:
        lines: Paths (N, 3) of the wire.
        along: Axis along which supports follow one another.
        up: Upward axis.
        bottom: Position of the bottom of the row along ``up`` [m].
        half: Half size of the row [m].
        room: Distance to keep [m].
    """
    at = np.arange(-half[along], half[along] + 0.5 * _STEP_M, _STEP_M)
    min_height = np.full(len(at), np.inf)
    for line in lines:
        for (a, high), (b, end) in itertools.pairwise(line[:, [along, up]] - [0.0, bottom]):
            fraction = np.linspace(0.0, 1.0, int(np.ceil(max(abs(b - a), abs(end - high)) / _STEP_M)) + 1)
            positions, heights = a + fraction * (b - a), high + fraction * (end - high)
            for k in np.flatnonzero(heights < room):
                window = slice(*np.searchsorted(at, [positions[k] - room, positions[k] + room]))
                min_height[window] = np.minimum(min_height[window], heights[k])
    is_free = np.concatenate([[False], min_height >= room, [False]])
    ends = np.flatnonzero(is_free[1:] != is_free[:-1]).reshape(-1, 2)
    ranges = [(float(at[a]), float(at[b - 1])) for a, b in ends if at[b - 1] - at[a] >= MIN_SUPPORT_M]
    if not ranges or ranges[0][0] > -MIN_SUPPORT_M or ranges[-1][1] < MIN_SUPPORT_M:
        return float(min_height.min())
    return tuple(ranges)


def _panel_pose(part: BlockPart, piece: BlockPart) -> FloatArray:
    """Return the pose (4, 4) of a panel's block, the part ``piece``, in the frame of its row, ``part``."""
    out = np.eye(4)
    if piece.is_rotated:
        out[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    out[0, 3] = piece.x + 0.5 * piece.length - part.x - 0.5 * part.length
    out[1, 3] = piece.y + 0.5 * piece.width - part.y - 0.5 * part.width
    return out


def _faces_in_line(
    each: Sequence[FloatArray], poses: Sequence[FloatArray], half_width: float
) -> list[FloatArray]:
    """Return the faces (2, N, 3) [m] of all panels in the frame of the row, in the order of cutting.

    Rulings are extended to reach from -``half_width`` to ``half_width`` [m]. ``each`` has the faces (2, N, 3)
    [m] in the frames of their blocks, ``poses`` are those of these blocks.
    """
    ordered_faces = []
    for (start, end), pose in zip(each, poses, strict=True):
        # position of the middle of its block along its own x and y
        side_offset, line_offset = (float(pose[:2, k] @ pose[:2, 3]) for k in (0, 1))
        fraction = (np.array([[-half_width], [half_width]]) - side_offset - start[:, 0]) / (end - start)[:, 0]
        rulings = start + fraction[..., None] * (end - start)
        ordered_faces.append(
            (line_offset * np.sign(rulings[0, -1, 1] - rulings[0, 0, 1]), transform(pose, rulings))
        )
    return [rulings for _, rulings in sorted(ordered_faces, key=lambda item: item[0])]


def _level_plane(half: FloatArray, height: float) -> FloatArray:
    """Return the plane at a height [m] of a row as two rulings (2, 2, 3) that span its shorter side.

    Its normal, the cross product of the direction between first ends and the rulings, points up, so the slot
    is above the panels.
    """
    x, y = half.tolist()
    corners = [[[-x, -y], [x, -y]], [[-x, y], [x, y]]]
    if y > x:
        corners = [[[x, -y], [x, y]], [[-x, -y], [-x, y]]]
    return np.insert(np.array(corners), 2, height, axis=-1)
