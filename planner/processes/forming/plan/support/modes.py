"""Where both tools are along the path of the contact, for each mode of forming.

Opposite each other (``dsif``, ``dpif_l``), with the wall angle a, the forming ball of radius R1 and
the other of R2: the gap is g = squeeze t0 cos(a), and the centres are R1 + g + R2 apart. The line
between them is the face's normal in dsif; in dpif_l it is turned from there toward the vertical by
the shift angle, at most by a.

Near the flat around a feature there is no room for a ball opposite a steep wall: it would cut into
the flat. There the line is turned toward the vertical as far as it must, at the same distance, so
that the support rolls around the forming ball as that sinks into the sheet. For a ball of R2 this
ends at a depth of about R2 (1 - cos a).

**Along the border** of a feature (``dpif_p``): where the other tool is while the forming one goes
round. The ray from the middle of the last contour through the contact meets the border, offset
outward by the support's radius so that a ball, or a disk by its rim, lies beside the wall. About a
border that is not star-shaped, rays meet it several times; there the share of the loop that is done
is the share of the border that is done.

**Heat** (``heat``): where the source of heat opposite the forming ball heats, and how its nozzle
stands.
"""

import dataclasses
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.units import DEG, MM
from planner.issues import Issue, Severity, TandemError
from planner.processes.forming.plan.contact import MIRROR, ContactPath, Pass, ToolPath
from planner.processes.forming.plan.operation import Forming
from planner.processes.forming.plan.support.clearance import Clamp, clear_lean, radius_issue
from planner.processes.forming.plan.support.directions import (
    axes,
    insert,
    leaned,
    mixed,
    nozzle_below_flat,
    steady_below,
    steady_normals,
)
from planner.processes.forming.plan.support.opposite import (
    AT_TARGET,
    CHORD_SHARE,
    MIDWAY_TURN,
    TARGET_TURN,
    Touching,
    Way,
    opposite_path,
    parted,
    straight,
    waited,
)
from planner.tooling import FormingHead, profile

NOZZLE_TURN: Final = 1.0 * DEG
"""A nozzle turns by no more than this [rad] in one move: it is long, and its arm turns with it."""
_SPLIT_ROUNDS: Final = 8
"""Moves are parted so often at most where the nozzle turns."""
_SHORT_MOVE: Final = 5e-5
"""Moves of the place that is heated that are not longer [m] are parted for turns alone."""


def heated(
    one: Pass,
    contact: ContactPath,
    former: FormingHead,
    nozzle: FormingHead,
    thickness: float,
    clamp: Clamp | None,
    slack: float,
    between: bool = True,
) -> tuple[ContactPath, FloatArray, FloatArray]:
    """The place (N, 3) [m] that is heated, across the sheet of ``thickness`` [m] from the ball, the axis
    (N, 3) of the nozzle behind it, and the path itself with targets added where the nozzle turns.

    The nozzle leans as the wall does, as far as it stays under the flat and off the ``clamp``. Both follow
    the smooth face that the ball leans on, not its facets; within ``slack`` [m] it leans on it. For a forming
    tool above. If not ``between``, no target is added.
    """
    touching = Touching(one, former.radius, 1.0, thickness)
    way = waited(contact, touching, slack, AT_TARGET) if between else straight(contact, touching, slack)
    for left in range(_SPLIT_ROUNDS if between else 0, -1, -1):
        contact = way.contact
        # where the ball waits the place that is heated goes on, and directions are steadied along that
        about = contact.centre - former.radius * way.lean.normal
        normal = way.lean.nearest(steady_normals(way.lean.normal, about), TARGET_TURN)
        through = former.radius + thickness * np.clip(normal[:, 2], 0.0, 1.0)
        place = contact.centre - through[:, None] * normal
        level = one.start - thickness
        most = nozzle_below_flat(place[:, 2], level, nozzle.standoff, nozzle.radius)
        lean = np.minimum(np.arccos(np.clip(normal[:, 2], -1.0, 1.0)), most)
        if clamp is not None:
            lean = clear_lean(clamp, place, normal, lean, profile(nozzle))
        axis = leaned(normal, steady_below(lean, about))
        turn = np.arccos(np.clip(dots(axis[1:], axis[:-1]), -1.0, 1.0))
        count = np.append(1, np.ceil(turn / NOZZLE_TURN)).astype(np.int64)
        count = np.maximum(count, _uneven(way, contact.centre - place))
        if left == 0 or count.max() <= 1:
            break
        way = parted(way, count, touching)
    return contact, place, axis


def _uneven(way: Way, across: FloatArray) -> IntArray:
    """Into how many (N,) pieces the move to each target is to be parted: two where in its middle the line
    ``across`` (N, 3) from what is heated to the ball is off what that leans on there; where the ball stands,
    as many as the line's turn needs."""
    unit = across / np.linalg.norm(across, axis=1, keepdims=True)
    line = mixed(unit[:-1], unit[1:], np.full(len(unit) - 1, 0.5))
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    middle = way.middle[np.arange(1, len(unit))]
    off = np.arccos(np.clip(dots(middle.nearest(line, 0.0), line), -1.0, 1.0))
    turn = np.arccos(np.clip(dots(unit[1:], unit[:-1]), -1.0, 1.0))
    place = way.contact.centre - across
    moved = np.linalg.norm(np.diff(way.contact.centre, axis=0), axis=1)
    moved = np.maximum(moved, np.linalg.norm(np.diff(place, axis=0), axis=1))
    two = np.where((off > MIDWAY_TURN) & (moved > _SHORT_MOVE), 2.0, 1.0)
    count = np.where(way.still[1:], np.ceil(turn / (2.0 * NOZZLE_TURN)), two)
    return np.append(1, np.maximum(count, 1.0)).astype(np.int64)


BORDER_MARGIN: Final = 3e-4
"""The support keeps so far [m] outside the border."""
BEND_CUT: Final = 1e-4
"""Straight moves may cut its bends by so much [m], inward or outward."""
FLAT_NOISE: Final = 5e-5
"""What is off the flat by less [m] may be noise of its mesh, and is not formed."""
_ARC_PIECES: Final = 64
"""Pieces of a quarter of an arc about the border."""


def border_curve(one: Pass, support: FormingHead, thickness: float, margin: float = 0.0) -> FloatArray:
    """The closed curve (K, 3) [m], the first point repeated, on which the TCP of a support runs round a pass:
    anticlockwise seen from above. ``thickness`` [m] of the sheet; ``margin`` [m] farther out.

    The border is that of the feature's outermost level line and all triangles of the face with a corner off
    the flat: in a fillet at the rim that line is millimetres inside of them where the mesh is noisy."""
    grown = shapely.Polygon(_moved(one).buffer(support.radius + margin, quad_segs=_ARC_PIECES).exterior)
    ring = shapely.get_coordinates(shapely.orient_polygons(grown).exterior)
    off = thickness + (support.radius if support.kind == "ball" else 0.0)
    return np.column_stack([ring, np.full(len(ring), one.start - one.side * off)])


def _moved(one: Pass) -> shapely.Polygon:
    """What a pass moves, seen from above: its largest piece."""
    corners = one.vertices[one.faces]
    moved = corners[(np.abs(corners[:, :, 2] - one.start) > FLAT_NOISE).any(axis=1)]
    region = shapely.Polygon(one.region[:, :2]).buffer(0.0)
    triangles = shapely.polygons(moved[:, [0, 1, 2, 0], :2])
    shapely.prepare(region)
    both = shapely.union_all([region, *triangles[~shapely.covers(region, triangles)]])
    pieces = shapely.get_parts(both)
    return pieces[int(np.argmax(shapely.area(pieces)))]


def border_path(
    one: Pass,
    contact: ContactPath,
    radius: float,
    support: FormingHead,
    thickness: float,
    between: bool = True,
) -> tuple[ContactPath, FloatArray]:
    """The support's TCP (N, 3) [m] at the targets of a path, and the path itself with targets added where
    the border bends between two of them, if ``between``. ``radius`` [m] of the forming ball."""
    ring = border_curve(one, support, thickness, BORDER_MARGIN)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring[:, :2], axis=0), axis=1))])
    middle = _middle(contact)
    along = _by_ray(ring, at, middle, contact.point)
    if along is None:
        along = _by_share(ring, at, contact)
    path = contact
    if between:
        row, share, position = _bends(ring, at, along)
        path = insert(contact, radius, one.side, row, share)
        along = np.insert(along, row, position)
    place = np.column_stack([np.interp(np.mod(along, at[-1]), at, ring[:, k]) for k in range(3)])
    return path, place


def _middle(contact: ContactPath) -> FloatArray:
    last = contact.point[(contact.loop == contact.loop.max()) & contact.working][:, :2]
    if len(last) < 3 or np.ptp(last, axis=0).max() < 1e-6:
        return np.asarray(contact.point[-1, :2])
    polygon = shapely.Polygon(last).buffer(0.0)
    centre = polygon.centroid if polygon.area > 0.0 else shapely.MultiPoint(last).convex_hull.centroid
    return np.asarray(centre.coords[0])


def _by_ray(ring: FloatArray, at: FloatArray, middle: FloatArray, points: FloatArray) -> FloatArray | None:
    """Where (N,) [m] along the border the rays through ``points`` meet it, counted on from round to round;
    None for a border that some ray meets more than once."""
    off = ring[:, :2] - middle
    turn = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    if not (np.all(np.diff(turn) > 0.0) and abs(turn[-1] - turn[0] - 2.0 * np.pi) < 1e-6):
        return None
    way = points[:, :2] - middle
    far = np.linalg.norm(way, axis=1) > 1e-6
    heading = np.arctan2(way[:, 1], way[:, 0])
    if not far.all():  # at the very middle any direction will do: that of the target before
        known = np.flatnonzero(far)
        if not len(known):
            return np.full(len(points), at[0])
        nearest = known[np.maximum(np.searchsorted(known, np.arange(len(points)), side="right") - 1, 0)]
        heading = heading[nearest]
    heading = turn[0] + np.mod(heading - turn[0], 2.0 * np.pi)
    k = np.clip(np.searchsorted(turn, heading, side="right") - 1, 0, len(turn) - 2)
    a, edge = off[k], off[k + 1] - off[k]
    ray = np.column_stack([np.cos(heading), np.sin(heading)])
    share = (a[:, 1] * ray[:, 0] - a[:, 0] * ray[:, 1]) / (edge[:, 0] * ray[:, 1] - edge[:, 1] * ray[:, 0])
    place = at[k] + np.clip(share, 0.0, 1.0) * (at[k + 1] - at[k])
    return np.asarray(np.unwrap(place, period=at[-1]))


def _by_share(ring: FloatArray, at: FloatArray, contact: ContactPath) -> FloatArray:
    """The same by the share of each loop that is done, from the place of the border next to where the first
    loop begins."""
    near = shapely.LineString(ring[:, :2])
    origin = float(near.project(shapely.Point(contact.point[0, :2])))
    done, total = np.zeros(len(contact.point)), 0.0
    for number in np.unique(contact.loop):
        rows = np.flatnonzero((contact.loop == number) & contact.working)
        if len(rows) < 2:
            done[rows] = total
            continue
        first = max(rows[0] - 1, 0)
        line = contact.point[np.concatenate([[first], rows]), :2]
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        x, y = (line - line[0]).T
        sense = 1.0 if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) >= 0.0 else -1.0
        done[rows] = total + sense * length[1:] / max(length[-1], 1e-12)
        total += sense
    known = np.flatnonzero(contact.working)
    if len(known):
        done = np.interp(np.arange(len(done)), known, done[known], left=0.0)
    return np.asarray(origin + at[-1] * done)


def _bends(ring: FloatArray, at: FloatArray, along: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Corners of the border that moves between places ``along`` (N,) [m] would cut: the row (M,) that each
    move ends at, the share (M,) of it and the place (M,) along the border."""
    line = shapely.LineString(ring[:, :2])
    kept = shapely.get_coordinates(line.simplify(0.5 * BEND_CUT))[:-1]
    known = set(map(tuple, kept.tolist()))
    corner = at[:-1][[tuple(point) in known for point in ring[:-1, :2].tolist()]]
    low, high = np.minimum(along[1:], along[:-1]), np.maximum(along[1:], along[:-1])
    length = at[-1]

    def count(value: FloatArray) -> IntArray:
        """How many corners lie before a place, over all rounds."""
        rounds = np.floor(value / length)
        inner = np.searchsorted(corner, value - rounds * length, side="right")
        return np.asarray((rounds * len(corner) + inner).astype(np.int64))

    begin, stop = count(low), count(np.nextafter(high, -np.inf))
    number = np.maximum(stop - begin, 0)
    move = np.repeat(np.arange(len(number)), number)
    step = np.arange(len(move)) - np.repeat(np.cumsum(number) - number, number)
    back = (along[1:] < along[:-1])[move]
    index = np.where(back, stop[move] - 1 - step, begin[move] + step)
    place = corner[np.mod(index, len(corner))] + np.floor_divide(index, len(corner)) * length
    share = (place - along[move]) / (along[move + 1] - along[move])
    whole = np.abs(along[move + 1] - along[move])
    inside = (
        np.minimum(share, 1.0 - share) * whole > BEND_CUT
    )  # what is nearer would be a move that hardly moves
    move, place, share = move[inside], place[inside], share[inside]

    def on(value: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(np.mod(value, length), at, ring[:, k]) for k in range(2)])

    one, two, mine = on(along[move]), on(along[move + 1]), on(place)
    way, rest = two - one, mine - one
    part = np.clip(dots(rest, way) / np.maximum((way**2).sum(axis=1), 1e-18), 0.0, 1.0)
    off = np.linalg.norm(rest - part[:, None] * way, axis=1)
    worst = np.zeros(len(number))
    np.maximum.at(worst, move, off)
    needed = worst[move] > BEND_CUT
    return (move + 1)[needed], share[needed], place[needed]


def tool_path(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
    clamp: Clamp | None = None,
    every: int = 0,
    between: bool = True,
) -> ToolPath:
    """Both tools along ``contact``, for all modes but adsif (`adsif_path.adsif_tool_path`).

    ``thickness`` [m] of the flat sheet; ``clamp``: what a source of heat leans away from;
    ``every``: moves between meetings of two controllers, 0 for one clock. The result's
    contact has more targets where straight moves would let the gap, or the support's way along the border,
    off by too much, but none if not ``between``. Raises ``TandemError`` (forming.support_tool) where the mode
    has no such support.
    """
    _require(operation, former, support)
    mode = operation.mode
    if one.side < 0:
        over = None if clamp is None else dataclasses.replace(clamp, low=-clamp.high, high=-clamp.low)
        found = tool_path(
            _mirrored(one), _turned_over(contact), operation, former, support, thickness, over, every, between
        )
        return _back(found)
    if support is None or mode in ("spif", "tpif"):
        none = np.full(len(contact.point), np.nan)
        return ToolPath(contact.centre, axes(contact.normal, _lean(operation)), None, None, none, contact)
    if mode == "dpif_p":
        path, place = border_path(one, contact, former.radius, support, thickness, between)
        up = np.tile([0.0, 0.0, 1.0], (len(place), 1))
        none = np.full(len(place), np.nan)
        return ToolPath(path.centre, axes(path.normal, _lean(operation)), place, up, none, path)
    if mode == "heat":
        path, place, behind = heated(
            one, contact, former, support, thickness, clamp, operation.gouge_tol_mm * MM, between
        )
        none = np.full(len(place), np.nan)
        return ToolPath(path.centre, axes(path.normal, _lean(operation)), place, behind, none, path)
    return opposite_path(one, contact, operation, former, support, thickness, every, between)


def support_issues(
    one: Pass,
    path: ToolPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
) -> tuple[Issue, ...]:
    """Warnings of a path of two tools opposite each other: where the support is too large to be opposite, and
    so is turned aside (forming.support_radius), and where straight moves do not keep the gap as they should
    (forming.gap)."""
    if path.support is None or support is None or operation.mode not in ("dsif", "dpif_l"):
        return ()
    contact, across = path.contact, path.former - path.support
    if one.side < 0:
        one, contact, across = _mirrored(one), _turned_over(contact), across * MIRROR
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    tilt = np.arccos(np.clip(across[:, 2] / np.linalg.norm(across, axis=1), -1.0, 1.0))
    wanted = np.maximum(contact.angle - shift, 0.0)
    off = np.where(np.isnan(path.gap), 0.0, wanted - tilt)
    radii, slack = np.array([former.radius, support.radius]), operation.gouge_tol_mm * MM
    gap = np.nan_to_num(path.gap)
    issue = radius_issue(one, thickness, contact, wanted, off, gap, radii, slack)
    loose = _loose_issue(one, path, operation)
    return tuple(found for found in (issue, loose) if found is not None)


def _loose_issue(one: Pass, path: ToolPath, operation: Forming) -> Issue | None:
    if path.loose is None or path.support is None or not path.loose.any():
        return None
    rows = np.flatnonzero(path.loose)
    first = ", ".join(f"{value:.1f}" for value in path.former[rows[0]] / MM)
    across = path.former - path.support
    length = np.linalg.norm(across, axis=1)
    middle = np.linalg.norm(0.5 * (across[rows] + across[rows - 1]), axis=1)
    off = float((0.5 * (length[rows] + length[rows - 1]) - middle).max()) / MM
    what = f"pass {one.name}: on {len(rows)} moves between targets, first at ({first}) mm, "
    if off > CHORD_SHARE * operation.gap_tol_mm:
        what += (
            f"the gap of the tools is off by up to {off:.3f} mm, {CHORD_SHARE:.0%} of gap_tol_mm are "
            "planned for"
        )
        hint = f"allow a gap_tol_mm of {off / CHORD_SHARE + 5e-4:.3f}, or round the part there"
    else:
        what += "the wall turns at once, and the line of the tools does not follow within its tolerance"
        hint = "round the part there"
    what += ", however near the targets are; the proof decides whether it holds"
    return Issue("forming.gap", what, Severity.WARNING, value=float(len(rows)), limit=0.0, hint=hint)


def _lean(operation: Forming) -> float:
    return operation.lean_deg * DEG


def _mirrored(one: Pass) -> Pass:
    """A pass mirrored in z; its faces run the same way round in plan, so their normals are up again."""
    return dataclasses.replace(
        one, side=-one.side, vertices=one.vertices * MIRROR, start=-one.start, end=-one.end
    )


def _turned_over(contact: ContactPath) -> ContactPath:
    """A path mirrored in z with its normals still up."""
    return dataclasses.replace(
        contact, point=contact.point * MIRROR, centre=contact.centre * MIRROR, normal=contact.normal * -MIRROR
    )


def _back(found: ToolPath) -> ToolPath:
    return dataclasses.replace(
        found,
        former=found.former * MIRROR,
        axis=found.axis * MIRROR,
        support=None if found.support is None else found.support * MIRROR,
        support_axis=None if found.support_axis is None else found.support_axis * MIRROR,
        contact=_turned_over(found.contact),
    )


def _require(operation: Forming, former: FormingHead, support: FormingHead | None) -> None:
    mode = operation.mode
    wanted = {"dsif": "ball", "dpif_l": "ball", "adsif": "ball", "dpif_p": "ball or disk", "heat": "heat"}
    issues: list[tuple[str, str, str]] = []
    if former.kind != "ball":
        issues.append(("forming", former.kind, "ball"))
    if mode in wanted and (support is None or support.kind not in wanted[mode]):
        issues.append(("supporting", "none" if support is None else support.kind, wanted[mode]))
    if issues:
        raise TandemError(
            [
                Issue(
                    "forming.support_tool",
                    f"mode {mode}: the {role} tool is {got}, allowed is {allowed}; mount another tool, or "
                    "take another mode",
                    field="mode",
                )
                for role, got, allowed in issues
            ]
        )
