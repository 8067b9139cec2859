"""Two balls opposite each other across the sheet: position of the supporting one along the path.

The line between the centres follows the face that the forming ball touches, as smoothly as the proof's
tolerance permits. In a sharp corner the path of the ball's centre has a corner: the ball touches one wall
when it arrives and another one when it leaves. There it dwells while the support goes round it. Between
targets both balls move straight, so each move is checked at its middle, and gets a target there if the gap or
the line deviates by more than a fraction of the tolerance.

**The touched face** (`BallContactFace`) at a position of the ball's centre: the direction across the sheet,
and its thickness. Both are evaluated at the ball's centre, as in the proof, not at the required contact
point. A mesh has normals that are smooth over its facets, but the point nearest to the ball jumps from facet
to facet, the more so the closer the radius of the ball is to that of the face. So all facets that are nearly
as near count, with a weight that falls to zero first for those that turn away the most. This separates walls
that meet in a crease.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.processes.forming.plan.contact import (
    ContactFace,
    ContactPath,
    FormingPass,
    FormingToolPath,
    PassContact,
)
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.sheet_mechanics import face_by_corner
from planner.processes.forming.plan.support.clearance import (
    MAX_COARSE_POINTS,
    MAX_POINTS,
    FarFace,
    clear_tilt,
)
from planner.processes.forming.plan.support.directions import (
    angle_to_fan,
    angle_to_vertical_arc,
    insert_targets_at,
    interpolate,
    interpolate_rotation,
    limit_rotation,
    max_angle_below_flat,
    nearest_on_arc,
    smooth_directions,
    smooth_lower_envelope,
    subdivision,
    tilt_from_vertical,
    tool_axes,
)
from planner.tooling import FormingHead

NEAREST_TOLERANCE_M: Final = 2e-5
"""Facets farther from the centre by this [m] than the nearest one have no weight."""
FULL_WEIGHT_ANGLE_RAD: Final = 5.0 * DEG
"""Facets whose normals differ from that of the nearest one by more than this [rad] lose their weight at a
smaller distance than `NEAREST_TOLERANCE_M`.
"""
TIE_TOLERANCE_M: Final = 4e-6
"""Touched points whose distances from the ball differ by at most this [m] are equally near: the mean gap is
clipped to the range of their gaps.
"""
MAX_SMOOTH_ANGLE_RAD: Final = 8.0 * DEG
"""Facets represent a smooth face while its normal deviates from theirs by less than this [rad]."""
CREASE_THICKNESS_FRACTION: Final = 0.15
"""Difference of the thicknesses on both sides of a crease, as a fraction of the flat sheet's thickness."""
TOUCH_TOLERANCE_M: Final = 4e-6
"""Points as near as the nearest one within this [m] are touched at once; the proof uses a slightly larger
value.
"""


@dataclasses.dataclass(frozen=True)
class TouchedFace:
    """Face touched by the ball at N positions of its centre.

    Attributes:
        normal: Upward unit normals (N, 3) of the face.
        gap: Gaps (N,) [m] required between the tools.
        ends: (N, 4, 3). Of all points that the ball touches at once: the two unit directions to its centre
            that differ the most, and the two normals there of the smooth face. The sheet extends around the
            ball from one to the other.
    """

    normal: FloatArray
    gap: FloatArray
    ends: FloatArray

    def __getitem__(self, indices: IntArray) -> "TouchedFace":
        return TouchedFace(self.normal[indices], self.gap[indices], self.ends[indices])

    def inserted(self, row: IntArray, other: "TouchedFace") -> "TouchedFace":
        """Return the values with those of others inserted before indices (M,)."""
        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in dataclasses.fields(self))
        return TouchedFace(*(np.insert(mine, row, new, axis=0) for mine, new in pairs))

    def angle_to(self, line: FloatArray) -> FloatArray:
        """Return the angles (N,) [rad] by which lines between both balls leave the permitted fan.

        One fan spans the two touched directions to the ball's centre and the vertical, another one the two
        normals of the smooth face and the vertical. The smaller of both angles counts. ``line`` (N, 3) are
        unit vectors.
        """
        return np.minimum(*(angle_to_fan(line, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)))

    def limit_normal(self, normal: FloatArray, max_angle: float) -> FloatArray:
        """Return unit normals (N, 3) rotated toward the touched ones as little as necessary.

        Args:
            normal: Unit normals (N, 3).
            max_angle: Maximum angle [rad] of the result to the touched normals.
        """
        candidates = [nearest_on_arc(normal, self.ends[:, k], self.ends[:, k + 1]) for k in (0, 2)]
        first_is_nearer = dots(candidates[0], normal) > dots(candidates[1], normal)
        return limit_rotation(np.where(first_is_nearer[:, None], *candidates), normal, max_angle)


class BallContactFace:
    """The face of a pass that is formed from above, as a ball touches it.

    Args:
        forming_pass: Pass.
        radius: Radius [m] of the ball.
        squeeze: Gap as a multiple of the thickness of the sheet.
        thickness: Thickness [m] of the flat sheet.
    """

    def __init__(self, forming_pass: FormingPass, radius: float, squeeze: float, thickness: float) -> None:
        self.radius = radius
        self._face = ContactFace(TriangleMesh(forming_pass.vertices, forming_pass.faces), radius)
        self._gap = squeeze * face_by_corner(forming_pass, thickness)[2].reshape(-1, 3)
        self._jump = CREASE_THICKNESS_FRACTION * squeeze * thickness

    def touched_at(self, centres: FloatArray) -> TouchedFace:
        """Return the face that balls at ``centres`` (N, 3) [m] touch.

        The values are weighted means over all facets that are nearly as near as the nearest one. If the ball
        touches two walls of different thickness, or a wall and a floor, only the facets of the thinner one
        count.
        """
        point, face, weights, foot, distance = self._face.touched(centres, NEAREST_TOLERANCE_M)
        ends = self._ends(point, centres[point] - foot, face, weights, distance)
        nearest_pair = np.searchsorted(point, np.arange(len(centres)))[point]
        normal = _normal_over_edges(centres[point] - foot, self._face.normal_at(face, weights))
        gap = dots(weights, self._gap[face])
        rotation = np.arccos(np.clip(dots(normal, normal[nearest_pair]), -1.0, 1.0))
        # falls to 0 at NEAREST_TOLERANCE_M, and sooner for facets that turn away by more than
        # FULL_WEIGHT_ANGLE_RAD
        weight = 1.0 - (distance - distance[nearest_pair]) * np.maximum(rotation, FULL_WEIGHT_ANGLE_RAD) / (
            FULL_WEIGHT_ANGLE_RAD * NEAREST_TOLERANCE_M
        )
        has_weight = weight > 0.0
        min_gap = np.full(len(centres), np.inf)
        np.minimum.at(min_gap, point[has_weight], gap[has_weight])
        has_weight &= gap <= min_gap[point] + self._jump
        point = point[has_weight]
        weight, normal, gap, distance = (
            values[has_weight] for values in (weight, normal, gap, distance - distance[nearest_pair])
        )
        is_tied = distance <= TIE_TOLERANCE_M
        low, high = np.full(len(centres), np.inf), np.full(len(centres), -np.inf)
        np.minimum.at(low, point[is_tied], gap[is_tied])
        np.maximum.at(high, point[is_tied], gap[is_tied])
        normal_sum, mean_gap = np.zeros((len(centres), 3)), np.zeros(len(centres))
        np.add.at(normal_sum, point, weight[:, None] * normal)
        np.add.at(mean_gap, point, weight * gap)
        length = np.linalg.norm(normal_sum, axis=1, keepdims=True)
        mean_gap /= np.bincount(point, weight, len(centres))
        # a thinner wall that the ball is about to touch counts alone: clip to the gaps of equally near points
        clipped = np.where(high >= low, np.clip(mean_gap, low, high), mean_gap)
        return TouchedFace(normal_sum / np.maximum(length, 1e-300), clipped, ends)

    def _ends(
        self, row: IntArray, direction: FloatArray, face: IntArray, weights: FloatArray, distance: FloatArray
    ) -> FloatArray:
        """Return `TouchedFace.ends` (N, 4, 3) of M pairs, ordered by point ``row`` (M,) and then by distance.

        ``direction`` (M, 3) [m] points to the centre, ``face`` (M,) has ``weights`` (M, 3), ``distance`` (M,)
        is in m.
        """
        start = np.flatnonzero(np.diff(row, prepend=-1) > 0)
        is_touched = np.flatnonzero(
            distance <= np.repeat(distance[start], np.diff(np.append(start, len(row)))) + TOUCH_TOLERANCE_M
        )
        row, start = row[is_touched], np.searchsorted(row[is_touched], np.arange(len(start)))
        length = np.linalg.norm(direction[is_touched], axis=1, keepdims=True)
        smooth = self._face.normal_at(face[is_touched], weights[is_touched])
        kinds = (np.where(length > 0.0, direction[is_touched] / np.maximum(length, 1e-300), smooth), smooth)
        return np.stack([end for kind in kinds for end in _most_different(kind, row, start)], axis=1)


def _most_different(unit: FloatArray, row: IntArray, start: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return, for each of N groups of unit vectors, the two (N, 3) that differ the most.

    ``row`` (M,) is the group of each vector ``unit`` (M, 3), and ``start`` (N,) the first one of each group.
    """
    first = start
    for _ in range(2):  # the farthest from the first vector, and the farthest from that
        order = np.lexsort((dots(unit, unit[first[row]]), row))
        first, other = order[start], first
    return unit[first], unit[other]


def _normal_over_edges(direction: FloatArray, normal: FloatArray) -> FloatArray:
    """Return unit normals (M, 3) of facets; over an edge the ``direction`` (M, 3) to the ball's centre.

    Over an edge the normals deviate from that direction: there the ball rolls from one facet to the next.
    """
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 0.0, direction / np.maximum(length, 1e-300), normal)
    angle = np.arccos(np.clip(dots(direction, normal), -1.0, 1.0))
    return limit_rotation(direction, normal, angle * np.clip(2.0 - angle / MAX_SMOOTH_ANGLE_RAD, 0.0, 1.0))


BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

SUPPORT_LIFT_M: Final = 5e-3
"""Distance [m] by which the support retracts from the sheet while the forming tool crosses through
the air.
"""
MIN_AIR_DISTANCE_M: Final = 3e-3
"""Distance [m] of the forming ball from the face beyond which it is in the air."""
CHORD_GAP_FRACTION: Final = 0.3
"""Fraction of the gap's tolerance that straight moves between targets may take."""
DRIFT_GAP_FRACTION: Final = 0.8
"""Fraction of the allowed gap error with one controller ahead that planning uses."""
MAX_FACING_ANGLE_RAD: Final = 4.0 * DEG
"""Maximum angle [rad] of the line of two tools to the directions between the face's normal and the vertical.

The support is rotated toward the vertical where it would cut into the flat or where a shift is stated.
"""
SMOOTHING_ANGLE_RAD: Final = 1.2 * DEG
"""Part [rad] of ``MAX_FACING_ANGLE_RAD`` for smoothing the line at targets; between them it may deviate twice
as far.
"""
MAX_TARGET_ANGLE_RAD: Final = 2.5 * DEG
"""Maximum angle [rad] of the line to the directions between all points that the ball touches at a target."""
MAX_MIDWAY_ANGLE_RAD: Final = 3.0 * DEG
"""Maximum angle [rad] of the line to those directions between targets."""
DWELL_ROTATION_RAD: Final = 8.0 * DEG
"""Rotation [rad] of the touched face from which the ball dwells while the support moves."""
_CORNER_HALVINGS: Final = 14
"""Number of bisections that locate a corner: moves are at most some millimetres long, and the corner is
needed to a micrometre.
"""
TARGET_TOLERANCE_M: Final = 5e-6
"""A corner this near [m] to a target is at the target."""
_SHORT_MOVE_M: Final = 5e-5
"""Moves of both tools up to this length [m] are not split."""
_DWELL_MOVE_M: Final = 3e-6
"""A ball that moves at most this distance [m] while the touched face rotates dwells at a corner."""
_MAX_SPLIT_ROUNDS: Final = 40
"""Maximum number of rounds of splitting.

Where the line has to rotate steadily, a finer move leaves less rotation to its neighbour, which is next.
Rounds with few of them are cheap.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class OppositePath:
    """Path of the forming ball at N targets, with the face that it touches.

    Attributes:
        contact: Path of the contact.
        touched: Touched face at the targets.
        dwells: Whether (N,) the forming ball does not move on the way to the target.
        middle: Touched face at the middle of the move to each target; the first row has no meaning.
        lift: Fraction (N,) from 0 to 1: 0 where the ball is on the face, 1 where it crosses from one place to
            another off the face but not in the air, and in between on added targets of a move that leads from
            one state to the other. The support is vertically below the ball where it is 1.
    """

    contact: ContactPath
    touched: TouchedFace
    dwells: BoolArray
    middle: TouchedFace
    lift: FloatArray


@dataclasses.dataclass(frozen=True)
class TargetRefinement:
    """How targets are added to a path.

    Attributes:
        enabled: Whether targets are added.
        sync_interval: Moves between meetings of two controllers, 0 for one clock.
    """

    enabled: bool = True
    sync_interval: int = 0


DEFAULT_REFINEMENT: Final = TargetRefinement()
"""Targets are added, and both tools have one clock."""


def make_opposite_path(
    pass_contact: PassContact,
    operation: Forming,
    forming_head: FormingHead,
    support: FormingHead,
    thickness: float,
    refinement: TargetRefinement = DEFAULT_REFINEMENT,
) -> FormingToolPath:
    """Return the paths of both tools over a pass that is formed from above, in mode dsif or dpif_l.

    The support is across the sheet from the forming ball, at the required gap. It is rotated toward the
    vertical where it would otherwise cut into the sheet. In each round the support is placed at all targets,
    and moves on which the gap or the line of the tools deviates too much are split. The rounds end when no
    move is left to split.

    Args:
        pass_contact: Pass with the path of the contact.
        operation: Operation.
        forming_head: Working end of the forming tool.
        support: Working end of the support.
        thickness: Thickness [m] of the flat sheet.
        refinement: How targets are added.

    Returns:
        Paths of both tools at N targets. ``gap`` (N,) is NaN where the forming ball is in the air, and
        ``unresolved`` (N,) marks moves that would still have to be split.
    """
    forming_pass, contact = pass_contact.forming_pass, pass_contact.contact
    refine = refinement.enabled
    max_points = MAX_POINTS if refine else MAX_COARSE_POINTS
    level = forming_pass.start - thickness
    far_face = FarFace(forming_pass, thickness, contact, forming_head.radius, max_points)
    touched_face = BallContactFace(forming_pass, forming_head.radius, operation.squeeze, thickness)
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    radius_sum = forming_head.radius + support.radius
    gap_tolerance = CHORD_GAP_FRACTION * operation.gap_tol_mm * MM
    slack = operation.gouge_tol_mm * MM
    opposite = (
        add_dwells(contact, touched_face, slack) if refine else without_dwells(contact, touched_face, slack)
    )
    for rounds_left in range(_MAX_SPLIT_ROUNDS if refine else 0, -1, -1):
        contact, gap = opposite.contact, opposite.touched.gap
        distance = gap + radius_sum
        # smooth along the support's path: in a corner the support moves much farther than the forming ball
        support_about = contact.centre - radius_sum * opposite.touched.normal
        normal = opposite.touched.limit_normal(
            smooth_directions(opposite.touched.normal, support_about, SMOOTHING_ANGLE_RAD),
            MAX_TARGET_ANGLE_RAD,
        )
        wall_angle = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
        # off the face the support cannot be opposite: it is straight below the ball
        tilt = (1.0 - opposite.lift) * np.maximum(wall_angle - shift, 0.0)
        tilt = np.minimum(tilt, max_angle_below_flat(contact.centre[:, 2], distance, level, support.radius))
        # the support presses into the sheet by the squeeze, which is not a cut
        squeezed = np.maximum(thickness * np.cos(contact.angle) - gap, 0.0)
        clear_radius = support.radius - squeezed - operation.gouge_tol_mm * MM
        facing = dataclasses.replace(contact, normal=normal)
        tilt = smooth_lower_envelope(
            clear_tilt(far_face, facing, tilt, distance, clear_radius), support_about
        )
        across = distance[:, None] * tilt_from_vertical(normal, tilt)
        is_in_air = (
            np.linalg.norm(contact.centre - contact.point, axis=1) > forming_head.radius + MIN_AIR_DISTANCE_M
        )
        if not refine:
            piece_count = np.ones(len(is_in_air), dtype=np.int64)
            break
        piece_count = np.maximum(
            _line_pieces(opposite, across, radius_sum, gap_tolerance),
            _gap_pieces(opposite, across, radius_sum, gap_tolerance, touched_face),
        )
        if refinement.sync_interval:
            max_drift = DRIFT_GAP_FRACTION * operation.handshake_gap_mm * MM
            piece_count = np.maximum(
                piece_count,
                _drift_pieces(contact.centre, across, gap + radius_sum, refinement.sync_interval, max_drift),
            )
        piece_count[1:][is_in_air[1:] | is_in_air[:-1]] = 1
        if rounds_left == 0 or piece_count.max() == 1:
            break
        opposite = split_moves(opposite, piece_count, touched_face)
    support_centre = contact.centre - across
    _retract_support(support_centre, is_in_air, forming_pass, thickness, support.radius)
    tool_tilt = operation.lean_deg * DEG
    return FormingToolPath(
        forming_centre=contact.centre,
        axis=tool_axes(contact.normal, tool_tilt),
        support_centre=support_centre,
        support_axis=tilt_from_vertical(normal, np.minimum(tilt, tool_tilt)),
        gap=np.where(is_in_air, np.nan, gap),
        contact=contact,
        unresolved=piece_count > 1,
    )


def add_dwells(
    contact: ContactPath, touched_face: BallContactFace, slack: float, spread: float = 0.0
) -> OppositePath:
    """Return the path with two targets at one position wherever the touched face jumps, as in a sharp corner.

    The ball arrives at the first target and dwells until the second one, while the support or nozzle moves
    from the direction of the one wall to that of the other.

    Args:
        contact: Path of the contact, N targets.
        touched_face: Face.
        slack: Distance [m] from the face within which the ball counts as touching it.
        spread: Distance [m] before and after the corner at which the touched faces of the two targets are
            evaluated. Both targets are at the corner itself. With 0 the faces are those right before and
            right after the jump.
    """
    is_crossing = _is_crossing(contact, touched_face, slack)
    touched = touched_face.touched_at(contact.centre)
    step = np.linalg.norm(np.diff(contact.centre, axis=0), axis=1)
    targets = (
        np.flatnonzero(
            (_angle_between(touched.normal[1:], touched.normal[:-1]) > DWELL_ROTATION_RAD) & (step > 0.0)
        )
        + 1
    )
    before_corner, after_corner = touched[targets - 1], touched[targets]
    low, high = np.zeros(len(targets)), np.ones(len(targets))
    for _ in range(_CORNER_HALVINGS):  # keep the half with the larger rotation
        middle = 0.5 * (low + high)
        middle_touched = touched_face.touched_at(
            interpolate(contact.centre[targets - 1], contact.centre[targets], middle)
        )
        is_in_first_half = _angle_between(before_corner.normal, middle_touched.normal) > _angle_between(
            middle_touched.normal, after_corner.normal
        )
        low, high = np.where(is_in_first_half, low, middle), np.where(is_in_first_half, middle, high)
        before_corner, after_corner = (
            _select(is_in_first_half, before_corner, middle_touched),
            _select(is_in_first_half, middle_touched, after_corner),
        )
    middle = 0.5 * (low + high)
    if spread:  # near a crease the ball touches both walls
        spread_fraction = spread / step[targets - 1]
        low, high = np.maximum(low - spread_fraction, 0.0), np.minimum(high + spread_fraction, 1.0)
        move = contact.centre[targets - 1], contact.centre[targets]
        before_corner = touched_face.touched_at(interpolate(*move, low))
        after_corner = touched_face.touched_at(interpolate(*move, high))
    jump = np.flatnonzero(_angle_between(before_corner.normal, after_corner.normal) > DWELL_ROTATION_RAD)
    fraction = middle[jump]
    row = targets[jump]
    pair = before_corner[jump], after_corner[jump]
    # an existing target at that position is one of the two
    target_distance = step[row - 1] * fraction, step[row - 1] * (1.0 - fraction)
    at_target = [
        (target_distance[k] < TARGET_TOLERANCE_M)
        & (_angle_between(pair[k].normal, touched.normal[row - 1 + k]) < SMOOTHING_ANGLE_RAD)
        for k in range(2)
    ]
    row, fraction = np.repeat(row, 2), np.repeat(fraction, 2)
    is_new = ~np.column_stack(at_target).ravel()
    normal = np.stack([part.normal for part in pair], axis=1).reshape(-1, 3)
    gap = np.column_stack([part.gap for part in pair]).ravel()
    ends = np.stack([part.ends for part in pair], axis=1).reshape(-1, 4, 3)
    path = insert_targets_at(contact, row[is_new], fraction[is_new], normal[is_new], touched_face.radius)
    inserted_touched = touched.inserted(row[is_new], TouchedFace(normal, gap, ends)[is_new])
    # the second target of each pair is reached without motion, whether it is new or the next existing one
    origin = np.insert(np.arange(len(step) + 1), row[is_new], -1 - np.flatnonzero(is_new))
    dwells = np.isin(origin, -1 - np.flatnonzero(is_new)[np.flatnonzero(is_new) % 2 == 1])
    dwells |= np.isin(origin, row[1::2][at_target[1]])
    between = np.concatenate([path.centre[:1], 0.5 * (path.centre[1:] + path.centre[:-1])])
    lift = np.insert(
        is_crossing, row[is_new], is_crossing[row[is_new]] | is_crossing[row[is_new] - 1]
    ).astype(np.float64)
    return OppositePath(path, inserted_touched, dwells, touched_face.touched_at(between), lift)


def without_dwells(contact: ContactPath, touched_face: BallContactFace, slack: float) -> OppositePath:
    """Return the path with the targets of ``contact`` alone, without dwells where the touched face jumps.

    Such a path is not refined, so ``middle`` is not evaluated and has the values at the targets.
    """
    touched = touched_face.touched_at(contact.centre)
    no_dwells = np.zeros(len(contact.centre), dtype=np.bool_)
    return OppositePath(
        contact, touched, no_dwells, touched, _is_crossing(contact, touched_face, slack).astype(np.float64)
    )


def _is_crossing(contact: ContactPath, touched_face: BallContactFace, slack: float) -> BoolArray:
    """Return whether (N,) the ball crosses, off the face by more than ``slack`` [m] but not in the air."""
    away = np.linalg.norm(contact.centre - contact.point, axis=1) - touched_face.radius
    return np.asarray(~contact.working & (away > slack) & (away <= MIN_AIR_DISTANCE_M))


def _select(condition: BoolArray, when_true: TouchedFace, when_false: TouchedFace) -> TouchedFace:
    """Return the values (N,) of one face where ``condition`` (N,) is true, and those of another elsewhere."""
    indices = np.where(condition, np.arange(len(condition)), len(condition) + np.arange(len(condition)))
    return when_true.inserted(np.full(len(condition), len(condition)), when_false)[indices]


def _line_pieces(opposite: OppositePath, across: FloatArray, radii: float, tolerance: float) -> IntArray:
    """Return the number (N,) of pieces that the gap and the line of the tools at mid-move require.

    ``count[i]`` is that of the move to target i; that of target 0 is 1. A move is split if at its middle the
    gap deviates by more than ``tolerance`` [m], or the line between the tools by too large an angle, unless
    both tools move at most `_SHORT_MOVE_M`. It then has at least two pieces, and as many as the rotation of
    the line requires. A move on which the forming ball dwells has as many as the rotation requires, at least
    one. ``across`` (N, 3) [m] points from the support to the forming ball, and ``radii`` [m] is the sum of
    both radii.
    """
    length = np.linalg.norm(across, axis=1)
    middle_across = 0.5 * (across[1:] + across[:-1])
    middle_length = np.linalg.norm(middle_across, axis=1)
    gap_deviation = np.maximum(
        np.abs(middle_length - radii - opposite.middle.gap[1:]),
        0.5 * (length[1:] + length[:-1]) - middle_length,
    )
    line = middle_across / middle_length[:, None]
    is_rotated = angle_to_vertical_arc(line, opposite.middle.normal[1:]) > 2.0 * SMOOTHING_ANGLE_RAD
    is_rotated |= opposite.middle[np.arange(1, len(length))].angle_to(line) > MAX_MIDWAY_ANGLE_RAD
    step = np.linalg.norm(np.diff(opposite.contact.centre, axis=0), axis=1)
    move_length = np.maximum(step, np.linalg.norm(np.diff(opposite.contact.centre - across, axis=0), axis=1))
    needs_split = ((gap_deviation > tolerance) | is_rotated) & (move_length > _SHORT_MOVE_M)
    # rotation of a line of length L at which its chord is 0.5 tolerance nearer: L (1 - cos(a / 2))
    finest = 2.0 * np.arccos(1.0 - 0.5 * tolerance / length[1:])
    arc = np.ceil(_angle_between(across[1:] / length[1:, None], across[:-1] / length[:-1, None]) / finest)
    count = np.where(
        opposite.dwells[1:], np.maximum(arc, 1.0), np.where(needs_split, np.maximum(arc, 2.0), 1.0)
    )
    return np.concatenate([[1], count]).astype(np.int64)


def _gap_pieces(
    opposite: OppositePath, across: FloatArray, radii: float, tolerance: float, touched_face: BallContactFace
) -> IntArray:
    """Return the number (N,) of pieces, 1 or 2, that changes of the required gap within a move demand.

    ``count[i]`` is that of the move to target i. It is 2 if the required gap at both ends differs by more
    than ``tolerance`` [m], and the planned gap deviates from the required one by more than that at one or
    three quarters of the move. Short moves, and those on which the ball dwells, are not split. ``across``
    (N, 3) [m] points from the support to the forming ball, and ``radii`` [m] is the sum of both radii.
    """
    gap, centre = opposite.touched.gap, opposite.contact.centre
    moves = np.flatnonzero(np.abs(np.diff(gap)) > tolerance) + 1
    step = np.linalg.norm(centre[moves] - centre[moves - 1], axis=1)
    moves = moves[(step > _SHORT_MOVE_M) & ~opposite.dwells[moves]]
    count = np.ones(len(gap), dtype=np.int64)
    for fraction in (0.25, 0.75) if len(moves) else ():
        fractions = np.full(len(moves), fraction)
        required = touched_face.touched_at(interpolate(centre[moves - 1], centre[moves], fractions)).gap
        planned = np.linalg.norm(interpolate(across[moves - 1], across[moves], fractions), axis=1) - radii
        count[moves[np.abs(planned - required) > tolerance]] = 2
    return count


def _drift_pieces(
    centre: FloatArray, across: FloatArray, distance: FloatArray, sync_interval: int, tolerance: float
) -> IntArray:
    """Return the number (N,) of pieces that two controllers require which meet only every few moves.

    ``count[i]`` is that of the move to target i. Between the meetings either arm may be up to
    ``sync_interval`` moves ahead of the other. Even then the distance of the balls may deviate from the
    nominal ``distance`` (N,) [m] by at most ``tolerance`` [m].
    """
    support_centre = centre - across
    count = np.ones(len(centre), dtype=np.int64)
    for ahead in range(1, min(sync_interval, len(centre) - 1) + 1):
        forming_ahead = np.abs(
            np.linalg.norm(centre[ahead:] - support_centre[:-ahead], axis=1) - distance[ahead:]
        )
        support_ahead = np.abs(
            np.linalg.norm(centre[:-ahead] - support_centre[ahead:], axis=1) - distance[:-ahead]
        )
        deviation = np.maximum(forming_ahead, support_ahead)
        # the deviation grows with the square of the length of moves
        pieces = np.where(deviation > tolerance, np.ceil(np.sqrt(deviation / tolerance)), 1.0).astype(
            np.int64
        )
        for step in range(ahead):  # all moves between must be equally short
            np.maximum.at(count, np.arange(1 + step, 1 + step + len(pieces)), pieces)
    step = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    move_length = np.maximum(step, np.linalg.norm(np.diff(support_centre, axis=0), axis=1))
    return np.where(np.append(0.0, move_length) > _SHORT_MOVE_M, count, 1)


def split_moves(opposite: OppositePath, count: IntArray, touched_face: BallContactFace) -> OppositePath:
    """Return the path with the move to each target i split into ``count[i]`` equal pieces.

    At an added target the touched face is evaluated anew. If the ball dwells on the move, its normal and gap
    are interpolated instead, because the face jumps there.
    """
    row, fraction = subdivision(count)
    dwells = opposite.dwells[row]
    normal = interpolate_rotation(opposite.touched.normal[row - 1], opposite.touched.normal[row], fraction)
    gap = opposite.touched.gap[row - 1] + fraction * (
        opposite.touched.gap[row] - opposite.touched.gap[row - 1]
    )
    centre = interpolate(opposite.contact.centre[row - 1], opposite.contact.centre[row], fraction)
    touched = touched_face.touched_at(centre)
    normal = np.where(dwells[:, None], normal, touched.normal)
    gap = np.where(dwells, gap, touched.gap)
    all_touched = opposite.touched.inserted(row, TouchedFace(normal, gap, touched.ends))
    contact = insert_targets_at(opposite.contact, row, fraction, normal, touched_face.radius)
    changed = np.flatnonzero(np.insert(count > 1, row, True))
    middle = opposite.middle.inserted(row, touched)
    touched = touched_face.touched_at(
        interpolate(contact.centre[changed - 1], contact.centre[changed], np.full(len(changed), 0.5))
    )
    middle.normal[changed], middle.gap[changed], middle.ends[changed] = (
        touched.normal,
        touched.gap,
        touched.ends,
    )
    step = np.linalg.norm(np.diff(contact.centre, axis=0, prepend=contact.centre[:1]), axis=1)
    has_rotated = (
        _angle_between(all_touched.normal, np.concatenate([all_touched.normal[:1], all_touched.normal[:-1]]))
        > SMOOTHING_ANGLE_RAD
    )
    dwells = np.insert(opposite.dwells, row, dwells) | ((step < _DWELL_MOVE_M) & has_rotated)
    lift = np.insert(
        opposite.lift, row, opposite.lift[row - 1] + fraction * (opposite.lift[row] - opposite.lift[row - 1])
    )
    return OppositePath(contact, all_touched, dwells, middle, lift)


def _angle_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles (N,) [rad] between unit vectors (N, 3)."""
    return np.asarray(np.arccos(np.clip(dots(first, second), -1.0, 1.0)))


def _retract_support(
    support_centre: FloatArray, air: BoolArray, forming_pass: FormingPass, thickness: float, radius: float
) -> None:
    """Retract the support from the sheet while the forming tool crosses through the air, in place.

    The support goes straight down from its last target on the face, below the whole sheet to the next one,
    and straight up to it. ``support_centre`` (N, 3) [m] is changed where ``air`` (N,) is true.
    """
    if not air.any() or air.all():
        return
    low = float(forming_pass.vertices[:, 2].min()) - thickness - radius - SUPPORT_LIFT_M
    in_air = np.flatnonzero(air)
    on_face = np.flatnonzero(~air)
    next_on_face = np.searchsorted(on_face, in_air)
    is_first = np.concatenate([[True], np.diff(in_air) > 1])
    source = np.where(
        (is_first & (next_on_face > 0)) | (next_on_face == len(on_face)),
        on_face[np.maximum(next_on_face - 1, 0)],
        on_face[np.minimum(next_on_face, len(on_face) - 1)],
    )
    support_centre[in_air] = np.column_stack([support_centre[source, :2], np.full(len(in_air), low)])
