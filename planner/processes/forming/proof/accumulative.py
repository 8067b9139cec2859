"""Two tools in accumulative forming (ADSIF), and the response table that guides them.

Gives the positions of the tools relative to the required face, and its wall angle there. All coordinates are
mirrored so that the forming ball is above the sheet.

The table gives the position angle and gap that walls require. Rows of a CSV text are gap over thickness,
position angle [deg] and wall angle [deg], linear between cells; an entry that is not a number is unstable.
Conditions precede them, one a line: ``# key: value``.
"""

import dataclasses
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, dots, lengths
from planner.processes.forming.claims import FormsByTable
from planner.processes.forming.proof.face import ProofFace
from planner.processes.forming.proof.formed_shapes import PlanLookup, spread_points
from planner.processes.forming.proof.tracks import ToolTrack, make_track, straight_pieces
from planner.proof.context import Context

WALL_ANGLE_STEP_RAD = np.deg2rad(0.01)
"""Step [rad] of the wall angles for which position and gap are tabulated."""
CONDITION_TOLERANCE = 1e-7
"""Position angles [rad] and gaps over thickness that differ by less are equal."""


@dataclasses.dataclass(frozen=True)
class TableSolution:
    """What a table requires, by wall angle.

    Attributes:
        wall: Wall angles (W,) [rad], evenly ascending.
        position: Position angles (W,) [rad].
        gap: Gaps (W,) over the thickness.
        conditions: Conditions for which the table is valid, by name.
    """

    wall: FloatArray
    position: FloatArray
    gap: FloatArray
    conditions: dict[str, str]

    def support_positions(self, thickness: float, radii: float, give: float) -> FloatArray:
        """Return the required position (W, 2) [m] of the support relative to the forming ball.

        It is that of the ball centres, one row for each tabulated wall angle. The first component is
        horizontal and points away from the inside of the feature, the second one points down through the
        sheet.

        Args:
            thickness: Thickness [m] of the sheet.
            radii: Sum [m] of the radii of both balls.
            give: Deflection [m] of the tools in the sheet's plane under load.
        """
        sine = np.sin(self.position)
        distance = self.gap * thickness - give * sine + radii
        return np.stack([distance * sine, distance * np.cos(self.position)], axis=1)

    def distance_from_curve(
        self, wall: FloatArray, actual: FloatArray, curve: FloatArray, uncertainty: float
    ) -> FloatArray:
        """Return the distance (N,) [m] of support positions from the curve of required ones.

        Each position is compared with the piece of the curve within ``uncertainty`` of its wall angle. Where
        the required position jumps, tools that move straight may be anywhere on the straight line between.
        The result is infinite for wall angles outside the table.

        Args:
            wall: Wall angles (N,) [rad].
            actual: Positions (N, 2) [m], as in :meth:`support_positions`.
            curve: Required positions (W, 2) [m], the result of :meth:`support_positions`.
            uncertainty: Uncertainty [rad] of the wall angles.
        """
        count = len(self.wall)
        table_position = (wall - self.wall[0]) / WALL_ANGLE_STEP_RAD
        first = np.floor(table_position - uncertainty / WALL_ANGLE_STEP_RAD).astype(np.int64)
        last = np.ceil(table_position + uncertainty / WALL_ANGLE_STEP_RAD).astype(np.int64)
        in_table = (last >= 0) & (first < count)
        first, last = np.clip(first, 0, count - 1), np.clip(last, 0, count - 1)
        out = np.full(len(wall), np.inf)
        for step in range(int((last - first)[in_table].max(initial=0))):
            index = np.minimum(first + step, last)
            next_index = np.minimum(index + 1, last)
            line = curve[next_index] - curve[index]
            fraction = ((actual - curve[index]) * line).sum(axis=1) / np.maximum(
                (line * line).sum(axis=1), 1e-30
            )
            rest = actual - curve[index] - np.clip(fraction, 0.0, 1.0)[:, None] * line
            out = np.where(in_table, np.minimum(out, np.hypot(rest[:, 0], rest[:, 1])), out)
        return out


def solve_table(text: str, prefer: str) -> TableSolution:
    """Return what the table in ``text`` requires.

    Of all solutions it takes the one with the smallest position angle ("angle") or the largest gap ("gap");
    the other one decides ties.

    Args:
        text: CSV text as described at the top of this module.
        prefer: "angle" or "gap".

    Raises:
        ValueError: If fewer than two cells are stable, or no two neighbouring ones.
    """
    conditions: dict[str, str] = {}
    rows: list[tuple[float, float, float]] = []
    for line in text.splitlines():
        if line.startswith("#"):
            key, colon, value = line[1:].partition(":")
            if colon:
                conditions[key.strip()] = value.strip()
            continue
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) == 3 and cells[2].replace(".", "", 1).isdigit():
            rows.append((float(cells[0]), np.deg2rad(float(cells[1])), np.deg2rad(float(cells[2]))))
    if len(rows) < 2:
        raise ValueError("the response table has fewer than two stable cells")
    edges = _stable_edges(np.array(rows))
    if not len(edges):
        raise ValueError("no two neighbouring cells of the response table are stable")
    low, high = edges[:, :, 2].min(), edges[:, :, 2].max()
    wall = low + WALL_ANGLE_STEP_RAD * np.arange(int(np.floor((high - low) / WALL_ANGLE_STEP_RAD)) + 1)
    wall = np.append(wall, high) if high - wall[-1] > 1e-9 else wall
    position, gap = _choose_solutions(edges, wall, prefer)
    return TableSolution(wall, position, gap, conditions)


def _stable_edges(cells: FloatArray) -> FloatArray:
    """Return the pairs (E, 2, 3) of stable cells (gap, position, wall) that are neighbours in the grid.

    The grid is that of all gaps and positions. Along the edges the wall changes linearly, and no solution
    with the smallest angle or the largest gap is off them.
    """
    out = []
    for across, along in ((0, 1), (1, 0)):
        values = np.unique(cells[:, along])
        for level in np.unique(cells[:, across]):
            line = cells[cells[:, across] == level]
            line = line[np.argsort(line[:, along])]
            position = np.searchsorted(values, line[:, along])
            out += [line[k : k + 2] for k in np.flatnonzero(np.diff(position) == 1)]
    return np.array(out).reshape(-1, 2, 3)


def _choose_solutions(edges: FloatArray, wall: FloatArray, prefer: str) -> tuple[FloatArray, FloatArray]:
    """Return the preferred position angles (W,) [rad] and gaps (W,) for wall angles (W,) [rad].

    Every edge (E, 2, 3) on which a wall angle occurs gives one solution, linear along the edge.
    """
    start, end = edges[:, 0], edges[:, 1]
    rise = end[:, 2] - start[:, 2]
    fraction = (wall[:, None] - start[:, 2]) / np.where(np.abs(rise) < 1e-12, np.inf, rise)
    fits = (fraction >= -1e-9) & (fraction <= 1.0 + 1e-9) & (np.abs(rise) >= 1e-12)
    is_flat = (np.abs(rise) < 1e-12) & (np.abs(wall[:, None] - start[:, 2]) < 1e-9)
    # along a line of one wall angle the better end is the solution
    best_end = np.where((end - start)[:, 1] * (1.0 if prefer == "angle" else 0.0) < 0.0, 1.0, 0.0)
    best_end = np.where((prefer == "gap") & (end[:, 0] > start[:, 0]), 1.0, best_end)
    fraction = np.clip(np.where(is_flat, best_end, fraction), 0.0, 1.0)
    gap = start[:, 0] + fraction * (end[:, 0] - start[:, 0])
    position = start[:, 1] + fraction * (end[:, 1] - start[:, 1])
    first, second = (position, -gap) if prefer == "angle" else (-gap, position)
    first = np.where(fits | is_flat, first, np.inf)
    equal = first <= first.min(axis=1, keepdims=True) + CONDITION_TOLERANCE
    choice = np.where(equal, second, np.inf).argmin(axis=1)
    wall_index = np.arange(len(wall))
    return position[wall_index, choice], gap[wall_index, choice]


MAX_CHECK_STEP_M = 0.5e-3
"""Maximum path length [m] between checks of the tools."""
CHECK_CHORD_FRACTION = 0.1
"""Maximum deviation of the straight pieces between checks from the path, as a fraction of the tolerance."""
MIN_WALL_ANGLE_RAD = np.deg2rad(1.0)
"""Triangles with a smaller wall angle [rad] count as flat."""
WALL_ANGLE_ERROR_RAD = np.deg2rad(0.1)
"""Uncertainty [rad] of the wall angle: faces consist of facets."""
EDGE_CONTACT_TOLERANCE_M = 5e-5
"""A ball that misses a wall by at most this [m] in plan is at its edge."""
_NEIGHBOURS = 16
"""Number of path pieces, by the distance of their middles from a point, among which the nearest is sought."""
_ANGLE_LEVELS = 200
"""Number of levels over a wall's height for which its steepest slope is calculated."""
_WALL_POINTS = 60_000
"""Number of points of the walls that must be passed."""


@dataclasses.dataclass(frozen=True)
class WallContacts:
    """Points at which the forming ball would touch walls of the face, found along z at K rows of a track.

    Attributes:
        row: Index (M,) among the K rows, ascending. A row is missing where the ball would touch no wall, and
            repeated where it would touch several.
        point: Touched points (M, 3) [m].
        normal: Upward unit normals (M, 3).
    """

    row: IntArray
    point: FloatArray
    normal: FloatArray


class AccumulativePath:
    """Both tools of a claim on accumulative forming along their path, compared with the claimed face.

    ``start``, ``end`` [m] and all positions are mirrored if the forming ball is below. ``index`` is that of
    the setup.
    """

    def __init__(self, context: Context, claim: FormsByTable, index: int) -> None:
        self.claim = claim
        self.track: ToolTrack = make_track(context, claim.segment, index, claim.arms)
        self._up = np.array([1.0, 1.0, float(claim.side)])
        self.start, self.end = claim.side * claim.start, claim.side * claim.end
        # mirrored in z only, so normals still point up
        self.face = ProofFace(claim.vertices * self._up, claim.faces, claim.radii[0])

    @cached_property
    def rows(self) -> IntArray:
        """Rows (K,) of the track, without approach and retreat, at which both tools are checked."""
        tool_track = self.track
        if len(tool_track.rows) < 2:
            return np.zeros(0, dtype=np.int64)
        pieces = straight_pieces(tool_track, CHECK_CHORD_FRACTION * self.claim.tolerance)
        step = np.linalg.norm(np.diff(tool_track.centre[:], axis=0), axis=2).max(axis=1)
        passed = np.floor(np.concatenate([[0.0], np.cumsum(step)]) / MAX_CHECK_STEP_M)
        check_rows = np.flatnonzero(np.diff(passed, prepend=0.0) > 0.0)
        rows = np.unique(np.concatenate([pieces.first, pieces.last, check_rows]))
        starts_forming = np.append(tool_track.is_forming[1:], False)  # where the first own move starts
        return np.asarray(rows[tool_track.is_forming[rows] | starts_forming[rows]], dtype=np.int64)

    @cached_property
    def centre(self) -> FloatArray:
        """Both balls' centres (K, 2, 3) [m], the forming one first."""
        return np.asarray(self.track.centre[self.rows] * self._up)

    @cached_property
    def all_centres(self) -> FloatArray:
        """Both balls' centres (T, 2, 3) [m] at all rows of the track, approach and retreat included."""
        return np.asarray(self.track.centre[:] * self._up)

    def axis(self, column: int) -> FloatArray:
        """Return the z axes (T, 3) of the tool of arm ``column`` of the claim at all rows of the track."""
        return np.asarray(self.track.axis(column) * self._up)

    @cached_property
    def walls(self) -> IntArray:
        """The triangles (W,) of the face that are walls."""
        return np.flatnonzero(self.face.normal[:, 2] < np.cos(MIN_WALL_ANGLE_RAD))

    @cached_property
    def contacts(self) -> WallContacts:
        """Contacts of the forming ball with walls at the checked rows.

        The ball touches a wall if its centre, seen along z, is over the wall offset along its smooth normals
        by the ball's radius.
        """
        walls, radius = self.walls, self.claim.radii[0]
        smooth, corners = self.face.smooth_normals[walls], self.face.corners[walls]
        offset_walls = PlanLookup(corners + radius * smooth)
        row, triangle, weight = offset_walls.locate(self.centre[:, 0, :2], EDGE_CONTACT_TOLERANCE_M)
        normal = np.einsum("mk,mkd->md", weight, smooth[triangle])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return WallContacts(row, np.einsum("mk,mkd->md", weight, corners[triangle]), normal)

    def support_offset(self, contacts: WallContacts) -> tuple[FloatArray, FloatArray]:
        """Return the position of the support's centre relative to the forming ball's at M contacts.

        Returns:
            Position (M, 2) [m] in the vertical plane square to the wall, with the components of
            :meth:`TableSolution.support_positions`, and distance (M,) [m] from that plane.
        """
        between = (self.centre[:, 1] - self.centre[:, 0])[contacts.row]
        inward = contacts.normal[:, :2] / np.maximum(lengths(contacts.normal[:, :2]), 1e-12)[:, None]
        across = -dots(between[:, :2], inward)
        aside = between[:, 0] * inward[:, 1] - between[:, 1] * inward[:, 0]
        return np.stack([across, -between[:, 2]], axis=1), np.abs(aside)

    def table_fit(self, table: TableSolution) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how well the support's position fits a table at each of the K checked rows.

        If the ball touches several walls at a row, the contact that fits best is taken.

        Returns:
            Distance (K,) [m] from the required position in the plane square to the wall, distance (K,) [m]
            from that plane, and the touched point (K, 3) [m]. Where the ball touches no wall, both distances
            are infinite and the point is NaN.
        """
        claim, contacts = self.claim, self.contacts
        actual, aside = self.support_offset(contacts)
        curve = table.support_positions(claim.thickness, sum(claim.radii), claim.give)
        wall = np.arccos(np.clip(contacts.normal[:, 2], -1.0, 1.0))
        distance = table.distance_from_curve(wall, actual, curve, WALL_ANGLE_ERROR_RAD)
        count = len(self.rows)
        order = np.lexsort((distance + aside, contacts.row))
        chosen = order[np.diff(contacts.row[order], prepend=-1) > 0]  # first, so best, contact of each row
        position_error, plane_distance = np.full(count, np.inf), np.full(count, np.inf)
        point = np.full((count, 3), np.nan)
        contact_rows = contacts.row[chosen]
        position_error[contact_rows] = distance[chosen]
        plane_distance[contact_rows] = aside[chosen]
        point[contact_rows] = contacts.point[chosen]
        return position_error, plane_distance, point

    def wall_distances(self, touched: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how close the path of the touched point comes to points all over the walls.

        Args:
            touched: Points (K, 3) [m] that the ball touches, in the order of the path.

        Returns:
            Points (P, 3) [m] all over the walls, their distances (P,) [m] from the polyline through
            ``touched``, and the distance (P,) [m] between adjacent loops along the wall there.
        """
        points, loop_distance = self._wall_points()
        a, b = touched[:-1], touched[1:]
        neighbours = np.asarray(cKDTree(0.5 * (a + b)).query(points, k=min(_NEIGHBOURS, len(a)))[1])
        distance = np.full(len(points), np.inf)
        for column in neighbours.reshape(len(points), -1).T:
            along, rest = (b - a)[column], points - a[column]
            fraction = np.clip(dots(rest, along) / np.maximum(dots(along, along), 1e-30), 0.0, 1.0)
            distance = np.minimum(distance, lengths(rest - fraction[:, None] * along))
        return points, distance, loop_distance

    def loop_height(self, level: FloatArray) -> FloatArray:
        """Return the height difference (N,) [m] between adjacent loops near given levels.

        Loops are one pitch apart in plan, so it is the pitch times the slope of the steepest wall there.

        Args:
            level: Levels (N,) [m].
        """
        low = self.face.corners[self.walls][:, :, 2].min(axis=1)
        high = self.face.corners[self.walls][:, :, 2].max(axis=1)
        slope = np.sqrt(1.0 - self.face.normal[self.walls, 2] ** 2) / self.face.normal[self.walls, 2]
        edges = np.linspace(self.end, self.start, _ANGLE_LEVELS + 1)
        width = float(edges[1] - edges[0])
        first = np.clip(((low - self.end) / width - 1.0).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        last = np.clip(((high - self.end) / width + 1.0).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        steepest = np.zeros(_ANGLE_LEVELS)
        for step in range(int((last - first).max(initial=0)) + 1):
            band = np.minimum(first + step, last)
            np.maximum.at(steepest, band, slope)
        band = np.clip(((level - self.end) / width).astype(np.int64), 0, _ANGLE_LEVELS - 1)
        return np.asarray(self.claim.pitch * steepest[band])

    def _wall_points(self) -> tuple[FloatArray, FloatArray]:
        """Return points (P, 3) [m] on the walls, and the loop distance there.

        The loop distance (P,) [m] is that between adjacent loops along the wall. The points are spread evenly
        by area and always the same.
        """
        points, owner = spread_points(self.face.corners[self.walls], _WALL_POINTS)
        sine = np.sqrt(1.0 - self.face.normal[self.walls, 2] ** 2)
        return points, self.loop_height(points[:, 2]) / sine[owner]
