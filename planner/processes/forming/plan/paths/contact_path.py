"""The path of the contact on the face of a pass, of the ball's centre, and targets along it.

There are as few targets on the contact curve as three limits allow: the change of direction of its tangent,
the deviation of the straight moves of the ball's centre, and the longest move.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from shapely import Polygon

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError, issue_error
from planner.processes.forming.plan.contact import MIRROR, ContactFace, ContactPath, FormingPass
from planner.processes.forming.plan.paths.level_lines import (
    FLAT_MARGIN_M,
    LevelLoop,
    closed_loops,
    constant_levels,
    cut_levels,
    scallop_levels,
    scallop_spacing,
)
from planner.processes.forming.plan.paths.spiral import (
    ContactCurve,
    PathOptions,
    loop_curve,
    order_loops,
    spiral_curve,
)
from planner.processes.forming.plan.paths.tool_radius import (
    Creases,
    LevelSlices,
    TooNarrow,
    largest_fitting_radius,
    reachable_loops,
    too_narrow_error,
)

_MakeTargets = Callable[[FloatArray], "ContactTargets"]

MIN_SPACING_M: Final = 5e-5
"""Minimum spacing [m] of targets."""
_MIN_CORNER_ANGLE_RAD: Final = np.radians(15.0)
"""Normals that turn by more than this [rad] from point to point do so at a corner, within which there are no
targets.
"""
_MAX_SPLIT_ROUNDS: Final = 8
"""Maximum number of times that a move is halved if it leaves the path of the ball's centre."""
_END_HALVINGS: Final = 10
"""Number of bisections that locate the end of a piece that the ball does not reach."""
_MAX_CLOSED_GAP_M: Final = 3e-4
"""If a crease keeps the ball away from a piece of the curve whose ends are this near [m], the piece is a
corner and the ball goes from end to end.
"""
_MOVE_SAMPLE_FRACTIONS: Final = np.array([0.25, 0.5, 0.75])
"""Fractions of a straight move at which it is tested for cutting into the face."""
_CHORD_FRACTION: Final = 0.9
"""Fraction of the chord with which the spacing of targets is calculated."""
_EARLY_SAMPLES: Final = 40
"""Approximate number of points that reveal early that a ball is far too large."""


@dataclasses.dataclass(frozen=True)
class ContactTargets:
    """N targets on a curve.

    Attributes:
        row: Position (N,) on the curve: index of a point, plus the fraction of the way to the next point.
        point: Contact points (N, 3), as in ``ContactPath``.
        normal: Unit normals (N, 3), as in ``ContactPath``.
        centre: Ball centres (N, 3), as in ``ContactPath``.
        loop: Number (N,) of the loop.
        piece: Number (N,) of the piece of the curve.
        kept: Whether (N,) the curve requires the target, as at ends of loops.
        missed: Whether (N,) a crease keeps the ball away from the required point.
    """

    row: FloatArray
    point: FloatArray
    normal: FloatArray
    centre: FloatArray
    loop: IntArray
    piece: IntArray
    kept: BoolArray
    missed: BoolArray

    def __getitem__(self, indices: IntArray | BoolArray) -> "ContactTargets":
        return ContactTargets(*(getattr(self, field.name)[indices] for field in dataclasses.fields(self)))


def make_targets(
    curve: ContactCurve, face: ContactFace, creases: Creases, options: PathOptions, name: str
) -> ContactTargets:
    """Return targets on a curve, at least 0.05 mm apart, through which the ball goes on straight moves.

    Args:
        curve: Curve of required contact.
        face: Face.
        creases: Its creases.
        options: Options of the path.
        name: Name of the pass.

    Raises:
        TooNarrow: if the face is too narrow for the ball.
    """

    def make_at(rows: FloatArray) -> ContactTargets:
        """Return targets at positions (N,) on the curve."""
        return _targets_at(rows, curve, face, creases, options.missed, name)

    initial_rows = _initial_rows(curve, face.radius, options)
    # a few points reveal early that a tool is far too large (step of the slice: the quotient rounded up)
    required, normal = curve_points(
        curve, face, creases, initial_rows[:: -(-len(initial_rows) // _EARLY_SAMPLES)]
    )
    contact = face.clear(required, normal, rounds=3)
    is_narrow = (contact.gap > max(0.02 * face.radius, options.missed)) & ~creases.is_near(required)
    if is_narrow.any():
        raise too_narrow_error(
            name, face, required[is_narrow], normal[is_narrow], contact.gap[is_narrow], options.missed
        )
    result = make_at(initial_rows)
    result = _trim_corners(result, make_at)
    result = _split_moves(result, make_at, face, options)
    result = _add_edge_targets(result, face, options.cut)
    return _drop_close_targets(result)


def curve_points(
    curve: ContactCurve, face: ContactFace, creases: Creases, curve_rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the required points (N, 3) [m] and unit normals (N, 3) at positions on a curve.

    Where the straight line between two points of the curve is off the face, they are those of the nearest
    point of the face.

    Args:
        curve: Curve of required contact.
        face: Face.
        creases: Its creases.
        curve_rows: Positions (N,) as in `ContactTargets.row`.
    """
    row = np.clip(np.floor(curve_rows).astype(np.int64), 0, len(curve.point) - 2)
    fraction = (curve_rows - row)[:, None]
    point = (1.0 - fraction) * curve.point[row] + fraction * curve.point[row + 1]
    normal = (1.0 - fraction) * curve.normal[row] + fraction * curve.normal[row + 1]
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    # inside a spiral, the points of the curve themselves may be off the face, too
    is_before_off_face = np.concatenate([[False], curve.is_off_face])
    is_after_off_face = np.concatenate([curve.is_off_face, [False]])
    is_point_off_face = is_before_off_face & is_after_off_face
    is_off_face = np.where(
        fraction[:, 0] == 0.0,
        is_point_off_face[row],
        np.where(fraction[:, 0] == 1.0, is_point_off_face[row + 1], curve.is_off_face[row]),
    )
    off_face = np.flatnonzero(is_off_face)
    if len(off_face):
        nearest, nearest_face, weights = face.nearest(point[off_face])
        point[off_face] = nearest
        face_normal = face.normal_at(nearest_face, weights)
        # in a fillet lower than the step, the normals of adjacent loops differ much from its own
        is_usable = (dots(face_normal, normal[off_face]) > np.cos(_MIN_CORNER_ANGLE_RAD)) | ~creases.is_near(
            nearest
        )
        normal[off_face] = np.where(is_usable[:, None], face_normal, normal[off_face])
    return point, normal


def _targets_at(
    rows: FloatArray, curve: ContactCurve, face: ContactFace, creases: Creases, missed: float, name: str
) -> ContactTargets:
    """Return targets at positions ``rows`` (N,) on a curve, or raise `TooNarrow`."""
    required, normal = curve_points(curve, face, creases, rows)
    contact = face.clear(required, normal)
    is_narrow = creases.is_too_narrow(required, contact, missed)
    if is_narrow.any():
        raise too_narrow_error(
            name, face, required[is_narrow], normal[is_narrow], contact.gap[is_narrow], missed
        )
    nearest_point = np.round(rows).astype(np.int64)
    return ContactTargets(
        rows,
        contact.point,
        contact.normal,
        contact.centre,
        curve.loop[np.ceil(rows - 1e-9).astype(np.int64)],
        curve.piece[nearest_point],
        curve.keep[nearest_point] & (nearest_point == rows),
        creases.misses(required, contact),
    )


def _initial_rows(curve: ContactCurve, radius: float, options: PathOptions) -> FloatArray:
    """Return the positions (N,) of the initial targets on the curve, as in `ContactTargets.row`.

    Corners of the curve, both ends of each piece, and the points that it marks become targets. Between them
    targets are spaced so that moves keep the options: the tangent angle, the chord of the ball's centre, and
    the longest move. The number of moves that these demand is added up along the curve, and each section
    between fixed targets is divided into equal parts of that sum.
    """
    point, centre = curve.point, curve.point + radius * curve.normal
    is_break = np.diff(curve.piece) != 0
    rotation, _ = _direction_changes(point, is_break)
    centre_rotation, centre_length = _direction_changes(centre, is_break)
    length = np.maximum(np.linalg.norm(np.diff(point, axis=0), axis=1), centre_length)
    is_corner = rotation > max(_MIN_CORNER_ANGLE_RAD, 1.01 * options.tangent_angle)
    centre_rotation = np.where(is_corner, 0.0, centre_rotation)
    width = np.maximum(0.5 * (np.append(centre_length, 0.0) + np.append(0.0, centre_length)), 1e-9)
    # a move of length L over a polyline that turns by b at points w apart deviates by L (b L / w + b) / 8;
    # solved for L, width / L is the number of moves that a point demands
    chord = 0.5 * (
        centre_rotation
        + np.sqrt(
            centre_rotation * centre_rotation
            + 32.0 * _CHORD_FRACTION * options.chord * centre_rotation / width
        )
    )
    chord *= width / (8.0 * _CHORD_FRACTION * options.chord)
    demand = np.maximum(np.where(is_corner, 0.0, rotation) / options.tangent_angle, chord)
    # each point contributes half of its demand to either side
    between = np.maximum(0.5 * (demand[1:] + demand[:-1]), length / options.longest)
    between[is_break] = 0.0
    keep = curve.keep | is_corner
    keep[0] = keep[-1] = True
    keep[:-1] |= is_break
    keep[1:] |= is_break
    total_demand = np.concatenate([[0.0], np.cumsum(between)])
    kept_points = np.flatnonzero(keep)
    section_demand = np.diff(total_demand[kept_points])
    part_count = np.maximum(np.ceil(section_demand - 1e-9), 1).astype(np.int64)
    section = np.repeat(np.arange(len(part_count)), part_count)
    fraction = (
        np.arange(len(section)) - np.repeat(np.cumsum(part_count) - part_count, part_count)
    ) / part_count[section]
    positions = total_demand[kept_points[section]] + fraction * section_demand[section]
    fractional_rows = np.interp(positions, total_demand, np.arange(len(total_demand)))
    fractional_rows[fraction == 0.0] = kept_points[section[fraction == 0.0]]
    # drop positions between two pieces, which belong to none
    inside = ~is_break[np.minimum(fractional_rows.astype(np.int64), len(is_break) - 1)] | (fraction == 0.0)
    return np.append(fractional_rows[inside], float(kept_points[-1]))


def _direction_changes(point: FloatArray, is_break: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the change of direction (K,) [rad] at each point of a polyline, and its lengths (K - 1,) [m].

    A move that ``is_break`` (K - 1,) leads from one piece of the curve to the next. The change is 0 next to
    such a move, and moves that are too short to have a direction are skipped.
    """
    move = np.diff(point, axis=0)
    length = np.linalg.norm(move, axis=1)
    has_direction = (length > 1e-7) & ~is_break
    rotation = np.zeros(len(point))
    moves = np.flatnonzero(has_direction)
    direction = move[moves] / length[moves, None]
    cosine = dots(direction[1:], direction[:-1])
    sine = np.linalg.norm(np.cross(direction[1:], direction[:-1]), axis=1)
    angle = np.arctan2(sine, cosine)
    crosses_break = np.cumsum(is_break)[moves[1:]] != np.cumsum(is_break)[moves[:-1]]
    rotation[moves[1:]] = np.where(crosses_break, 0.0, angle)
    return rotation, length


def _trim_corners(targets: ContactTargets, make_at: _MakeTargets) -> ContactTargets:
    """Return the targets with additional ones at the ends of sections from which creases keep the ball away.

    The ends are the last points that the ball reaches on either side. If the ball is at nearly the same
    position at both ends, as in a sharp corner, the targets in between are dropped.
    """
    same_piece = targets.piece[1:] == targets.piece[:-1]
    section_ends = np.flatnonzero(same_piece & (targets.missed[1:] != targets.missed[:-1]))
    if not len(section_ends):
        return targets
    good = np.where(targets.missed[section_ends], targets.row[section_ends + 1], targets.row[section_ends])
    bad = np.where(targets.missed[section_ends], targets.row[section_ends], targets.row[section_ends + 1])
    for _ in range(_END_HALVINGS):
        middle = 0.5 * (good + bad)
        is_missed = make_at(middle).missed
        good, bad = np.where(is_missed, good, middle), np.where(is_missed, middle, bad)
    targets = _merge_targets(targets, make_at(good))
    run = np.cumsum(np.append(0, targets.missed[1:] != targets.missed[:-1]))
    first = np.searchsorted(run, run, side="left")
    last = np.searchsorted(run, run, side="right") - 1
    previous, following = np.maximum(first - 1, 0), np.minimum(last + 1, len(run) - 1)
    is_inside_piece = (
        (first > 0) & (last < len(run) - 1) & (targets.piece[previous] == targets.piece[following])
    )
    is_near = np.linalg.norm(targets.centre[following] - targets.centre[previous], axis=1) < _MAX_CLOSED_GAP_M
    return targets[~(targets.missed & is_inside_piece & is_near)]


def _split_moves(
    targets: ContactTargets, make_at: _MakeTargets, face: ContactFace, options: PathOptions
) -> ContactTargets:
    """Return the targets with others inserted where a straight move leaves the path of the centre.

    Each move is halved while its middle deviates from the path by more than ``chord``, it cuts into the face
    by more than ``cut``, or it is longer than ``longest``. Moves that are too short for a further target are
    not halved. Where a crease keeps the ball away from the middle, the deviation does not count.
    """
    check = np.ones(len(targets.row) - 1, dtype=np.bool_)
    for _ in range(_MAX_SPLIT_ROUNDS):
        length = np.linalg.norm(np.diff(targets.centre, axis=0), axis=1)
        check &= (targets.piece[1:] == targets.piece[:-1]) & (length > 2.0 * MIN_SPACING_M)
        moves = np.flatnonzero(check)
        if not len(moves):
            break
        middle = make_at(0.5 * (targets.row[moves] + targets.row[moves + 1]))
        deviation = _line_distance(middle.centre, targets.centre[moves], targets.centre[moves + 1])
        straight = 0.5 * (targets.centre[moves] + targets.centre[moves + 1])
        # at a corner the ball does not pass the middle, so only cutting into the face counts
        missed_moves = np.flatnonzero(middle.missed)
        cuts = dots(middle.centre - straight, middle.normal) > options.cut
        if len(missed_moves):
            cuts[missed_moves] = face.clearance(straight[missed_moves]) < face.radius - min(
                options.chord, options.cut
            )
        needs_split = (
            cuts | (~middle.missed & (deviation > options.chord)) | (length[moves] > 1.001 * options.longest)
        )
        if not needs_split.any():
            break
        is_split = np.zeros(len(targets.row), dtype=np.bool_)
        is_split[moves[needs_split]] = True
        # indices of the new targets, on both sides of which moves are checked again
        slots = np.flatnonzero(is_split) + np.arange(1, int(needs_split.sum()) + 1)
        targets = _merge_targets(targets, middle[needs_split])
        check = np.zeros(len(targets.row) - 1, dtype=np.bool_)
        check[slots - 1] = check[slots] = True
    return targets


def _add_edge_targets(targets: ContactTargets, face: ContactFace, cut: float) -> ContactTargets:
    """Return the targets with others inserted where the ball rolls over a convex edge.

    From loop to loop the nearest point of the face jumps over the edge, however near targets are, and the
    straight move from one side to the other cuts into the edge by more than ``cut`` [m]. There the point
    nearest to the move is on the edge.
    """
    check = np.ones(len(targets.row) - 1, dtype=np.bool_)
    fractions = _MOVE_SAMPLE_FRACTIONS[:, None, None]
    for _ in range(_MAX_SPLIT_ROUNDS):
        has_turned = dots(targets.normal[1:], targets.normal[:-1]) < 1.0 - cut / face.radius
        moves = np.flatnonzero(check & has_turned & (targets.piece[1:] == targets.piece[:-1]))
        if not len(moves):
            break
        start, end = targets.centre[moves], targets.centre[moves + 1]
        samples = ((1.0 - fractions) * start + fractions * end).reshape(-1, 3)
        clear = face.clearance(samples).reshape(len(fractions), len(moves))
        moves = moves[clear.min(axis=0) < face.radius - cut]
        if not len(moves):
            break
        _, nearest, away = face.deepest(0.5 * (targets.centre[moves] + targets.centre[moves + 1]))
        contact = face.clear(nearest, away)
        no_flags = np.zeros(len(moves), dtype=np.bool_)
        middle = ContactTargets(
            0.5 * (targets.row[moves] + targets.row[moves + 1]),
            contact.point,
            contact.normal,
            contact.centre,
            targets.loop[moves + 1],
            targets.piece[moves],
            no_flags,
            no_flags,
        )
        targets = _merge_targets(targets, middle)
        check = np.zeros(len(targets.row) - 1, dtype=np.bool_)
        slots = moves + np.arange(1, len(moves) + 1)
        check[slots - 1] = check[slots] = True
    return targets


def _line_distance(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the distances (N,) [m] of points (N, 3) from lines between ``start`` and ``end`` (N, 3)."""
    line, offset = end - start, points - start
    fraction = dots(offset, line) / np.maximum(dots(line, line), 1e-300)
    return np.asarray(np.linalg.norm(offset - np.clip(fraction, 0.0, 1.0)[:, None] * line, axis=1))


def _merge_targets(first: ContactTargets, second: ContactTargets) -> ContactTargets:
    """Return both sets of targets as one, in the order of the curve."""
    order = np.argsort(np.concatenate([first.row, second.row]), kind="stable")
    merged_values = (
        np.concatenate([getattr(first, field.name), getattr(second, field.name)])
        for field in dataclasses.fields(first)
    )
    return ContactTargets(*(values[order] for values in merged_values))


def _drop_close_targets(targets: ContactTargets) -> ContactTargets:
    """Return the targets without those less than 0.05 mm after the previous one.

    The ends of pieces stay. Of two close targets, the one that the curve requires stays.
    """
    while len(targets.row) > 2:
        is_near = np.linalg.norm(np.diff(targets.centre, axis=0), axis=1) < MIN_SPACING_M
        same_piece = targets.piece[1:] == targets.piece[:-1]
        if not (is_near & same_piece).any():
            break
        close_moves = np.flatnonzero(is_near & same_piece)
        # the first target of a close move is dropped if the second one ends its piece or is required
        drops_first = np.append(~same_piece, True)[close_moves + 1] | (
            targets.kept[close_moves + 1] & ~targets.kept[close_moves]
        )
        is_dropped = np.zeros(len(targets.row), dtype=np.bool_)
        is_dropped[np.where(drops_first, close_moves, close_moves + 1)] = True
        starts_piece = np.concatenate([[True], ~same_piece])
        is_dropped &= ~(starts_piece & ~np.append(~same_piece, True))  # a piece of one target stays
        if not is_dropped.any():
            break
        # of several targets in a row only every second one is dropped, because distances then change
        run = np.cumsum(np.append(0, is_dropped[1:] != is_dropped[:-1]))
        position = np.arange(len(run)) - np.searchsorted(run, run, side="left")
        targets = targets[~(is_dropped & (position % 2 == 0))]
    return targets


MAX_LEVEL_LINES: Final = 20_000
"""Maximum number of level lines of a path."""


def make_contact_path(forming_pass: FormingPass, radius: float, options: PathOptions) -> ContactPath:
    """Return the path of the contact of a ball over the face of a pass.

    It goes level by level from the start of the pass to its end. The ball touches the face (to 3 um) at every
    target. It does not cut into it there (to 2 um), nor by more than ``options.cut`` on the straight moves of
    its centre between targets. Targets are at least 0.05 mm apart. Concave creases, where no ball fits, are
    left with a fillet of the ball's own radius: the path keeps away from them as far as necessary. Points
    whose ``working`` is False are the ends of moves that do not form (lifts to another loop; the move along
    the sheet of kind "stepped"). At those in the air ``point`` is the nearest point of the face.

    Args:
        forming_pass: Pass.
        radius: Radius [m] of the ball.
        options: Options of the path.

    Raises:
        TandemError: ``forming.path_options`` for a step, chord ... that is out of range;
            ``forming.no_contour`` if nothing of the face is between its levels; ``forming.open_contour``
            where the mesh ends; ``forming.tool_radius`` where a smooth region is narrower than the ball.
    """
    _check_options(forming_pass, radius, options)
    try:
        return _ball_path(forming_pass, radius, options)
    except TooNarrow as narrow:
        fits = largest_fitting_radius(
            narrow, lambda smaller: _ball_path(forming_pass, smaller, options), options.scallop or 0.0
        )
        raise narrow.error(fits) from None


def _ball_path(forming_pass: FormingPass, radius: float, options: PathOptions) -> ContactPath:
    """Return the path of `make_contact_path` for one radius [m] of the ball.

    Level lines that the ball reaches are joined to a curve, on which targets are then placed.

    Raises:
        TooNarrow: if the face is too narrow for the ball; the caller then tries smaller ones.
        TandemError: ``forming.no_contour``, ``forming.open_contour``.
    """
    # a face that is formed from below is mirrored in z, so that the ball is always above it
    vertices = forming_pass.vertices if forming_pass.side > 0 else forming_pass.vertices * MIRROR
    start, end = forming_pass.side * forming_pass.start, forming_pass.side * forming_pass.end
    region = _feature_region(forming_pass)
    box = np.stack([forming_pass.region.min(axis=0), forming_pass.region.max(axis=0)])[:, :2]
    face = ContactFace(TriangleMesh(vertices, forming_pass.faces), radius, box)
    levels = _levels(face, region, start, end, radius, options)
    centre = np.asarray(Polygon(forming_pass.region[:, :2]).centroid.coords[0])

    def slice_face(heights: FloatArray) -> list[list[LevelLoop]]:
        """Return the closed level lines of the feature at each of some heights (K,) [m]."""
        mesh = face.mesh
        level_loops = closed_loops(
            cut_levels(mesh.vertices, mesh.faces, face.smooth, heights), region, forming_pass.name
        )
        groups: list[list[LevelLoop]] = [[] for _ in heights]
        for loop in level_loops:
            groups[loop.level].append(loop)
        return groups

    creases = Creases(face)
    wider = ContactFace(face.mesh, radius + options.spare, box) if options.spare > 0.0 else None
    slices = LevelSlices(levels=levels, groups=slice_face(levels), slice_face=slice_face)
    groups = reachable_loops(slices, face, creases, options.chord, wider=wider, missed=options.missed)
    loops, transitions = order_loops([group for group in groups if group], options, centre)
    if not loops:
        message = (
            f"{forming_pass.name}: the face has no closed level line in the feature's outline between z = "
        )
        message += (
            f"{1e3 * forming_pass.start:.3f} and {1e3 * forming_pass.end:.3f} mm; check that levels and "
            "outline belong to "
        )
        message += "the face"
        raise issue_error("forming.no_contour", message)
    helical = options.kind == "helical"
    curve = spiral_curve(loops, transitions, options.seams) if helical else loop_curve(loops, transitions)
    return _assemble_path(
        make_targets(curve, face, creases, options, forming_pass.name),
        curve,
        face,
        options,
        forming_pass.side,
    )


def _levels(
    face: ContactFace, region: Polygon | None, start: float, end: float, radius: float, options: PathOptions
) -> FloatArray:
    """Return the descending levels (L,) [m] of the loops, by scallop height or step-down."""
    if options.scallop is not None:
        width = scallop_spacing(radius, options.scallop)
        levels = scallop_levels(face.mesh, face.smooth, region, start, end, width)
    else:
        levels = constant_levels(start, end, options.stepdown or start - end)
    levels = np.append(start, levels)  # the first turn is flat, at the flat around the feature
    # the flat itself has no level lines
    return np.asarray(np.clip(levels, end + FLAT_MARGIN_M, start - FLAT_MARGIN_M))


def _feature_region(forming_pass: FormingPass) -> Polygon:
    """Return the outline of the feature with a small margin, because the first lines run along it."""
    width = float(np.ptp(forming_pass.region, axis=0).max())
    return Polygon(forming_pass.region[:, :2]).buffer(0.0).buffer(2e-4 + 1e-3 * width)


def _assemble_path(
    targets: ContactTargets, curve: ContactCurve, face: ContactFace, options: PathOptions, side: int
) -> ContactPath:
    """Return the path through the targets and the moves between pieces of the curve.

    At a transition "lift" the ball is lifted above the whole face, crosses, and comes down; these moves do
    not form. At a transition "step" it moves level along the sheet, which does not form, and then down. The
    face was mirrored if ``side`` is -1, so the result is mirrored back.
    """
    point, normal, centre, loop = targets.point, targets.normal, targets.centre, targets.loop
    working = np.ones(len(point), dtype=np.bool_)
    working[0] = False
    breaks = np.flatnonzero(np.diff(targets.piece)) + 1
    high = float(face.mesh.vertices[:, 2].max()) + face.radius + options.lift
    insert_indices, insert_centres, labels = [], [], []
    for index in breaks:
        start, end = centre[index - 1], centre[index]
        if curve.transitions[targets.piece[index - 1]] == "step":
            via_points = [np.array([end[0], end[1], max(start[2], end[2])])]
        else:
            via_points = [np.array([start[0], start[1], high]), np.array([end[0], end[1], high])]
            working[index] = False
        insert_indices += [index] * len(via_points)
        insert_centres += via_points
        labels += [loop[index]] * len(via_points)
    if insert_indices:
        air = np.array(insert_centres)
        nearest, nearest_face, weights = face.nearest(air)
        centre = np.insert(centre, insert_indices, air, axis=0)
        point = np.insert(point, insert_indices, nearest, axis=0)
        normal = np.insert(normal, insert_indices, face.normal_at(nearest_face, weights), axis=0)
        loop = np.insert(loop, insert_indices, labels)
        working = np.insert(working, insert_indices, False)
    mirror = np.array([1.0, 1.0, float(side)])
    return ContactPath(
        point=point * mirror,
        normal=normal * np.array([side, side, 1.0]),
        centre=centre * mirror,
        angle=np.arccos(np.clip(normal[:, 2], -1.0, 1.0)),
        loop=loop,
        working=working,
    )


def _check_options(forming_pass: FormingPass, radius: float, options: PathOptions) -> None:
    """Raise ``TandemError`` (forming.path_options) with all options that are out of range."""
    depth = forming_pass.side * (forming_pass.start - forming_pass.end)
    problems = []
    step = options.stepdown if options.stepdown is not None else options.scallop
    if (options.stepdown is None) == (options.scallop is None):
        problems.append("state either stepdown or scallop")
    elif step is None or not step > 0.0 or not np.isfinite(step):
        problems.append("stepdown and scallop must be above 0")
    elif options.stepdown is not None and depth / options.stepdown > MAX_LEVEL_LINES:
        problems.append(
            f"stepdown {1e3 * options.stepdown:.4g} mm gives {depth / options.stepdown:.0f} levels, allowed "
            f"are {MAX_LEVEL_LINES}; use a stepdown of "
            f"{1e3 * depth / MAX_LEVEL_LINES + 1e-5:.5f} mm at "
            "least"
        )
    elif options.scallop is not None and not options.scallop < radius:
        problems.append(f"scallop {1e3 * options.scallop:.4g} mm must be below the ball's radius")
    problems += [
        f"{name} is {getattr(options, name):.4g}, it must be above 0"
        for name in ("tangent_angle", "chord", "cut", "longest", "lift", "missed")
        if not getattr(options, name) > 0.0
    ]
    if not radius > 0.0:
        problems.append(f"the ball's radius is {1e3 * radius:.4g} mm, it must be above 0")
    if not depth > 2.0 * FLAT_MARGIN_M:
        problems.append(
            f"the face goes from z = {1e3 * forming_pass.start:.4g} to {1e3 * forming_pass.end:.4g} mm, its "
            f"end must lie {'below' if forming_pass.side > 0 else 'above'} its start"
        )
    if problems:
        raise TandemError(
            [Issue("forming.path_options", f"{forming_pass.name}: {message}") for message in problems]
        )
