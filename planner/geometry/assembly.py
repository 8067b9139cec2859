"""Assembly order of the bodies of a shell or wall, and a straight insertion path for each.

A body touches others along its sides. The directions along which it can leave the bodies that are placed form
a cone: the intersection of the half spaces of the sides there. The direction that is farthest from all of
them is computed exactly (`middle_direction`). Collisions beyond the neighbours are checked for the whole body
swept along its path (`obstruction_depth`).

**Order.** Bodies follow a required order, each when the bodies that support it are placed. A body that would
block the insertion of a neighbour waits until that one is placed, if that one has some support already.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, lengths, unit

NONE: Final = -1
"""Number of the body beyond a side if there is none."""
CONTACT_TOLERANCE_M: Final = 1e-6
"""Bodies that overlap by less than this [m] touch."""
TRAVEL_FACTOR: Final = 1.5
"""Free length of a body's insertion path, in diameters of the body."""
MAX_DIRECTIONS: Final = 400
"""Number of directions that are tried if the middle one is not free."""
MAX_MEASURED: Final = 4
"""Number of paths for which the obstruction is measured if none is free."""
OBSTRUCTION_STEPS_M: Final = 1e-4 * 2.0 ** np.arange(12)
"""Steps in which an obstruction is reported [m]."""
MAX_ORDERS: Final = 4
"""Maximum number of orders that are tried while some bodies have no insertion path."""
MIDDLE_FRACTIONS: Final = (0.0, 0.1, 0.2, 0.4, 0.8)
"""Fractions of the middle direction that are added to one normal to a side, until other sides are passed."""
_SKEW: Final = np.array([1.0, 0.6180339887, 0.3249197])  # generic: no edge of a regular shell is normal to it
_TIGHT: Final = 1e-12  # tolerance of margins, and of lengths of sums of unit vectors
_FLAT: Final = 1e-14  # m^2, twice a projected area: smaller triangles cover nothing


@dataclasses.dataclass(frozen=True)
class Slab:
    """A body between a front and a back, whose vertices are paired.

    Attributes:
        front: Vertices of the front (V, 3) [m].
        back: Vertices of the back (V, 3) [m].
        faces: Triangles of the front (F, 3), counterclockwise seen from there.
        rim: Vertices on its outline (C,), counterclockwise as well.
        beyond: Body beyond the side from each of these to the next one (C,), or ``NONE``.
    """

    front: FloatArray
    back: FloatArray
    faces: IntArray
    rim: IntArray
    beyond: IntArray

    @functools.cached_property
    def mesh(self) -> tuple[FloatArray, IntArray]:
        """Vertices (2 V, 3), those of the front first, and outward triangles (T, 3) of the closed surface."""
        count = len(self.front)
        a, b = self.rim, np.roll(self.rim, -1)
        key = self.front @ _SKEW
        first = (key[a] < key[b])[:, None]  # diagonal of a side; the adjacent body uses the same one
        low = np.where(first, np.stack([count + a, count + b, a], 1), np.stack([count + a, count + b, b], 1))
        high = np.where(first, np.stack([count + b, b, a], 1), np.stack([count + a, b, a], 1))
        faces = np.concatenate([self.faces, count + self.faces[:, ::-1], low, high])
        return np.concatenate([self.front, self.back]), faces

    @functools.cached_property
    def triangles(self) -> FloatArray:
        """Triangles of the closed surface as corners (T, 3, 3)."""
        vertices, faces = self.mesh
        return vertices[faces]

    @functools.cached_property
    def normals(self) -> FloatArray:
        """Outward normals (C, 4, 3) of the sides, at the four corners of each.

        Sides may be twisted. The normals in between are inside the cone of these four.
        """
        end_vertices = [np.roll(self.rim, -1), self.rim]
        rise = [self.front[k] - self.back[k] for k in end_vertices]
        along = [face[end_vertices[0]] - face[end_vertices[1]] for face in (self.front, self.back)]
        return unit(np.stack([np.cross(e, r) for e in along for r in rise], axis=1))

    @property
    def normal(self) -> FloatArray:
        """The mean normal (3,) of the front."""
        a, b, c = self.front[self.faces].transpose(1, 0, 2)
        return unit(np.cross(b - a, c - a).sum(axis=0))

    @functools.cached_property
    def bounding_ball(self) -> tuple[FloatArray, float]:
        """Centre of its bounding box, and the radius [m] of the ball about it that contains the body."""
        vertices = self.mesh[0]
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        return centre, float(lengths(vertices - centre).max())

    @property
    def travel(self) -> float:
        """Free length of its insertion path [m]."""
        return TRAVEL_FACTOR * 2.0 * self.bounding_ball[1]


def outline_faces(ring: FloatArray) -> IntArray:
    """Triangulate a polygon without additional vertices.

    Args:
        ring: Corners (C, 2), counterclockwise.

    Returns:
        Triangles (F, 3), counterclockwise.

    Raises:
        ValueError: The polygon crosses itself.
    """
    shape = shapely.Polygon(ring)
    if not shape.is_valid:
        raise ValueError("an outline crosses itself")
    index = {corner: k for k, corner in enumerate(map(tuple, ring.tolist()))}
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    faces = np.array([[index[x, y] for x, y in triangle] for triangle in corners.tolist()], dtype=np.int64)
    first_edge = corners[:, 1] - corners[:, 0]
    second_edge = corners[:, 2] - corners[:, 0]
    is_clockwise = first_edge[:, 0] * second_edge[:, 1] < first_edge[:, 1] * second_edge[:, 0]
    faces[is_clockwise] = faces[is_clockwise, ::-1]
    return faces[np.lexsort(faces.T[::-1])]


def bodies_beyond(plans: Sequence[FloatArray], distance: float) -> list[IntArray]:
    """Find the neighbour beyond each edge of outlines that tile a plane.

    Args:
        plans: Corners of the outlines (C, 2), counterclockwise.
        distance: Distance outside of an edge's midpoint at which the neighbour is searched.

    Returns:
        For each outline the index of the outline beyond each edge (C,), or ``NONE``.
    """
    tree = shapely.STRtree([shapely.Polygon(ring) for ring in plans])
    out = []
    for ring in plans:
        along = np.roll(ring, -1, axis=0) - ring
        outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths(along)[:, None]
        points = shapely.points(ring + 0.5 * along + distance * outwards)
        edge, body = tree.query(points, predicate="within")
        beyond = np.full(len(ring), NONE)
        beyond[edge] = body
        out.append(beyond)
    return out


def assembly_rows(beyond: Sequence[IntArray], first: BoolArray, low: FloatArray) -> IntArray:
    """Return the row (N,) of each body: 0 for the first ones, then one more for each step to neighbours.

    If no remaining body is next to the last row, the lowest remaining body is the next row.

    Args:
        beyond: Neighbours of each body, with ``NONE`` at sides without one.
        first: Whether a body is in row 0 (N,).
        low: Height of the lowest point of each body (N,).
    """
    rows = np.full(len(beyond), NONE)
    current = np.flatnonzero(first)
    for row in range(len(beyond)):
        rows[current] = row
        if (rows != NONE).all():
            break
        neighbours = np.concatenate([beyond[k] for k in current.tolist()])
        current = np.unique(neighbours[(neighbours != NONE) & (rows[neighbours] == NONE)])
        if not len(current):  # pieces that are connected only by a corner
            current = np.array([int(np.argmin(np.where(rows == NONE, low, np.inf)))])
    return rows


def middle_direction(normals: FloatArray) -> tuple[FloatArray, float]:
    """Return the direction (3,) that is farthest from the half spaces n . d > 0, and its margin.

    The unit direction d maximises the smallest -n . d over the normals n. This margin is the sine of the
    angle to the nearest half space. It is negative if every direction enters one of them. At the optimum the
    smallest margin is that of one, two or three normals, so :func:`_middle_of_set` only tests directions with
    equal margins to that many normals. It does so for a working set, to which the normal with the smallest
    margin is added until that normal is in the set or no longer reduces the margin.

    Args:
        normals: Unit normals (K, 3), K > 0.
    """
    working_set = [0]
    while True:
        direction, margin = _middle_of_set(normals[working_set])
        worst_index = int(np.argmax(normals @ direction))
        if -float(normals[worst_index] @ direction) >= margin - _TIGHT or worst_index in working_set:
            return direction, margin
        working_set.append(worst_index)


@functools.cache
def _combinations(count: int, size: int) -> IntArray:
    """Return all combinations (K, ``size``) of the numbers 0 to ``count`` - 1."""
    combinations = list(itertools.combinations(range(count), size))
    return np.array(combinations, dtype=np.int64).reshape(-1, size)


def _middle_of_set(normals: FloatArray) -> tuple[FloatArray, float]:
    """Return :func:`middle_direction` of a few normals, from all directions that may be the optimum."""
    candidates = [-normals]
    pairs, triples = _combinations(len(normals), 2), _combinations(len(normals), 3)
    bisector = -normals[pairs].sum(axis=1)
    candidates.append(bisector[lengths(bisector) > _TIGHT])
    a, b, c = normals[triples].transpose(1, 0, 2)
    equal = np.cross(b - a, c - a)  # has equal margins to all three
    candidates += [equal[lengths(equal) > _TIGHT], -equal[lengths(equal) > _TIGHT]]
    opposite = bisector[lengths(bisector) <= _TIGHT]
    if len(opposite):  # two opposite sides: along both, and away from a third one
        candidates += [np.cross(normals[i], np.eye(3)) for i in pairs[lengths(bisector) <= _TIGHT][:, 0]]
    directions = np.concatenate(candidates)
    directions = unit(directions[lengths(directions) > _TIGHT])
    margins = -(directions @ normals.T).max(axis=1)
    best = int(np.argmax(np.round(margins, 12)))
    return directions[best], float(margins[best])


def obstruction_depth(
    body: FloatArray,
    others: FloatArray,
    direction: FloatArray,
    travel: float,
    tolerance: float = CONTACT_TOLERANCE_M,
) -> float:
    """Return how deep [m] a moving body enters others, measured normal to the surfaces that meet.

    With the direction of motion as up, others obstruct the body where their underside is above its underside.
    Undersides are piecewise linear over the horizontal plane. The largest height of one above the other is
    thus at a vertex of the overlap of two triangles. Others that start ``travel`` or more above the top of
    the body do not count.

    Args:
        body: Triangles of the body (T, 3, 3) [m].
        others: Triangles of the others (U, 3, 3) [m], which it does not overlap now.
        direction: Direction (3,).
        travel: Length of the motion [m].
        tolerance: Width [m] below which obstructions are ignored.
    """
    side = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(direction, side), direction], axis=1)
    under, over = _facing_down(body @ axes), _facing_down(others @ axes)
    under = _shrink(under, tolerance)
    if not len(under):
        return 0.0
    low, high = under.min(axis=(0, 1)), under.max(axis=(0, 1))
    over = over[(over.max(axis=1) > low).all(axis=1) & (over.min(axis=1)[:, :2] < high[:2]).all(axis=1)]
    (a_low, a_high), (b_low, b_high) = ((t.min(axis=1), t.max(axis=1)) for t in (under, over))
    overlapping = a_low[:, None, 2] < b_high[:, 2]
    for axis in range(2):
        overlapping &= (a_low[:, None, axis] < b_high[:, axis]) & (b_low[:, axis] < a_high[:, None, axis])
    i, k = np.nonzero(overlapping)
    if not len(i):
        return 0.0
    a, b = under[i], over[k]
    min_height, max_height = _height_range(a, b)
    depth = max_height * np.minimum(_normal_z(a), _normal_z(b))
    is_obstructed = (max_height > 0.0) & (min_height < travel + np.ptp(body @ direction))
    return float(depth[is_obstructed].max(initial=0.0))


def _facing_down(triangles: FloatArray) -> FloatArray:
    """Return the triangles (K, 3, 3) that face -z, without nearly vertical ones."""
    first_edge = triangles[:, 1, :2] - triangles[:, 0, :2]
    second_edge = triangles[:, 2, :2] - triangles[:, 0, :2]
    return triangles[first_edge[:, 1] * second_edge[:, 0] - first_edge[:, 0] * second_edge[:, 1] > _FLAT]


def _normal_z(triangles: FloatArray) -> FloatArray:
    """Return the component (T,) of the unit normals along z."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(np.abs(normal[:, 2]) / lengths(normal))


def _shrink(triangles: FloatArray, by: float) -> FloatArray:
    """Return triangles whose edges in x and y are moved inwards by ``by`` [m], without those that vanish."""
    flat = triangles[..., :2]
    sides = lengths((np.roll(flat, 1, axis=1) - np.roll(flat, -1, axis=1)).reshape(-1, 2)).reshape(-1, 3)
    first_edge, second_edge = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    inradius = np.abs(
        first_edge[:, 0] * second_edge[:, 1] - first_edge[:, 1] * second_edge[:, 0]
    ) / sides.sum(axis=1)
    keep = inradius > by
    triangles, sides, inradius = triangles[keep], sides[keep], inradius[keep]
    weights = sides / sides.sum(axis=1, keepdims=True)
    incentre = (weights[..., None] * triangles).sum(axis=1, keepdims=True)
    return np.asarray(incentre + (1.0 - by / inradius)[:, None, None] * (triangles - incentre))


def _height_range(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return minimum and maximum height (P,) of triangles ``b`` above ``a`` (P, 3, 3) where they overlap.

    Overlap is that of their projections onto z = 0. Without overlap the result is inf and -inf.
    """
    p, q = a[:, :, None, :2], b[:, None, :, :2]
    along, across = np.roll(p, -1, axis=1) - p, np.roll(q, -1, axis=2) - q
    determinant = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    offset = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (offset[..., 0] * across[..., 1] - offset[..., 1] * across[..., 0]) / determinant
        t = (offset[..., 0] * along[..., 1] - offset[..., 1] * along[..., 0]) / determinant
        crossing = (p + s[..., None] * along).reshape(len(a), 9, 2)
        is_crossing = ((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)).reshape(len(a), 9)
    points = np.concatenate([a[..., :2], b[..., :2], np.where(is_crossing[..., None], crossing, 0.0)], axis=1)
    (z_a, in_a), (z_b, in_b) = _plane_heights(a, points), _plane_heights(b, points)
    # the overlap is a polygon of corners inside the other triangle and of crossings of edges
    is_vertex = np.concatenate([in_b[:, :3], in_a[:, 3:6], is_crossing], axis=1)
    above = z_b - z_a
    return np.where(is_vertex, above, np.inf).min(axis=1), np.where(is_vertex, above, -np.inf).max(axis=1)


def _plane_heights(triangles: FloatArray, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return heights (P, M) of planes of triangles (P, 3, 3) at points (P, M, 2), and which are inside."""
    first = triangles[:, None, 0]
    first_edge, second_edge = (triangles[:, None, k] - first for k in (1, 2))
    offsets = points - first[..., :2]
    area = first_edge[..., 0] * second_edge[..., 1] - first_edge[..., 1] * second_edge[..., 0]
    u = (offsets[..., 0] * second_edge[..., 1] - offsets[..., 1] * second_edge[..., 0]) / area
    v = (first_edge[..., 0] * offsets[..., 1] - first_edge[..., 1] * offsets[..., 0]) / area
    z = first[..., 2] + u * first_edge[..., 2] + v * second_edge[..., 2]
    return np.asarray(z), np.asarray((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0))


@dataclasses.dataclass(frozen=True)
class AssemblyStep:
    """One step of an assembly.

    Attributes:
        body: Body that is placed.
        direction: Direction in which it is inserted (3,).
        depth: Clearance [m] that would be needed all round for that path, 0 if it is free; in the steps of
            `OBSTRUCTION_STEPS_M`.
    """

    body: int
    direction: FloatArray
    depth: float


def assemble(
    slabs: Sequence[Slab],
    rank: IntArray,
    supports: Sequence[IntArray],
    up: FloatArray,
    tolerance: float,
    max_square_angle: float | None = None,
) -> tuple[AssemblyStep, ...]:
    """Return the steps in which all bodies are placed.

    Up to `MAX_ORDERS` orders are tried, and the first one with the fewest obstructed bodies is returned. In
    the next order, obstructed bodies come before their neighbours.

    Args:
        slabs: The bodies (N).
        rank: Required order (N,).
        supports: Bodies that support each one; none for those on the ground.
        up: Upward direction (3,); nothing is inserted from below against it.
        tolerance: Allowed obstruction [m].
        max_square_angle: Maximum angle [rad] between the path and the normals of sides of as many neighbours
            as possible, as dowels require. None prefers a path far from all sides.
    """
    site = _Site(slabs, supports, up, tolerance, max_square_angle)
    order = np.argsort(np.argsort(rank, kind="stable")).astype(np.float64)
    best_steps: tuple[AssemblyStep, ...] = ()
    min_obstructed = len(slabs) + 1
    for _ in range(MAX_ORDERS):
        steps = _assemble_in_order(site, order)
        obstructed = [step.body for step in steps if step.depth > tolerance]
        if len(obstructed) < min_obstructed:
            best_steps, min_obstructed = steps, len(obstructed)
        if not obstructed:
            break
        for k in obstructed:
            neighbours = slabs[k].beyond[slabs[k].beyond != NONE]
            order[k] = min([order[k], *order[neighbours]]) - 0.5
    return best_steps


class _Site:
    """The bodies of an assembly, with data and tests that do not depend on the order.

    Methods have the body as ``k``, and the numbers of the bodies that are in place as ``placed``.
    """

    def __init__(
        self,
        slabs: Sequence[Slab],
        supports: Sequence[IntArray],
        up: FloatArray,
        tolerance: float,
        max_square_angle: float | None,
    ) -> None:
        self.slabs, self.up, self.tolerance, self.max_square_angle = slabs, up, tolerance, max_square_angle
        self.supports = [set(item.tolist()) for item in supports]
        self.neighbours = [sorted({b for b in slab.beyond.tolist() if b != NONE}) for slab in slabs]
        self.centres = np.array([slab.bounding_ball[0] for slab in slabs])
        self.radii = np.array([slab.bounding_ball[1] for slab in slabs])
        low = np.array([float((slab.mesh[0] @ up).min()) for slab in slabs])
        self.low = low - low.min()  # above the ground
        depths = [float(lengths(slab.front - slab.back).max()) for slab in slabs]
        # a negative margin times the body's depth is the obstruction
        self.margin_tolerances = [tolerance / item for item in depths]
        self.feasible: dict[tuple[int, frozenset[int]], bool] = {}

    def contact_normals(self, k: int, placed: set[int]) -> FloatArray:
        """Return normals (K, 3) of a body's sides to placed bodies, and of its contact with the ground."""
        slab = self.slabs[k]
        sides = slab.normals[[b in placed for b in slab.beyond.tolist()]].reshape(-1, 3)
        return np.concatenate([sides, -self.up[None]]) if self.low[k] <= self.tolerance else sides

    def has_direction(self, k: int, placed: set[int]) -> bool:
        """Return whether the sides of a body to placed ones leave an insertion direction."""
        key = k, frozenset(placed.intersection(self.neighbours[k]))
        if key not in self.feasible:
            sides = self.contact_normals(k, placed)
            self.feasible[key] = not len(sides) or middle_direction(sides)[1] >= -self.margin_tolerances[k]
        return self.feasible[key]

    def blocked_count(self, k: int, placed: set[int]) -> int:
        """Return how many waiting bodies would have no insertion direction once this one is placed."""
        placed_next = placed | {k}
        return sum(
            b not in placed_next and self.has_direction(b, placed) and not self.has_direction(b, placed_next)
            for b in self.neighbours[k]
        )

    def insertion(self, k: int, placed: set[int]) -> AssemblyStep:
        """Return the insertion of a body by the first free path of those tried.

        If none is free, it is the least obstructed one of the first few.
        """
        slab = self.slabs[k]
        obstacles = self._obstacles(k, placed)

        def is_obstructed(direction: FloatArray, tolerance: float) -> bool:
            return obstruction_depth(slab.triangles, obstacles, direction, slab.travel, tolerance) > tolerance

        candidates = []
        for direction in self._candidate_directions(k, placed):  # most bodies take the first one
            if self.low[k] + min(0.0, float(direction @ self.up)) * slab.travel < -self.tolerance:
                continue
            if not len(obstacles) or not is_obstructed(direction, self.tolerance):
                return AssemblyStep(k, -direction, 0.0)
            candidates.append(direction)
        depths = []
        for direction in candidates[:MAX_MEASURED]:
            steps = OBSTRUCTION_STEPS_M[self.tolerance < OBSTRUCTION_STEPS_M].tolist()
            depths.append(
                next((width for width in steps if not is_obstructed(direction, width)), float("inf"))
            )
        best = int(np.argmin(depths))
        return AssemblyStep(k, -candidates[best], min(depths[best], 2.0 * slab.bounding_ball[1]))

    def _obstacles(self, k: int, placed: set[int]) -> FloatArray:
        """Return triangles (U, 3, 3) of placed bodies that may obstruct a body."""
        reach = self.slabs[k].travel + self.radii[k]
        distances = lengths(self.centres - self.centres[k])
        nearby = [b for b in np.flatnonzero(distances < reach + self.radii).tolist() if b in placed]
        return np.concatenate([self.slabs[b].triangles for b in nearby] or [np.zeros((0, 3, 3))])

    def _candidate_directions(self, k: int, placed: set[int]) -> Iterator[FloatArray]:
        """Yield directions to try for a body.

        They are: normal to sides if required; away from all sides and from below; away from all sides; to the
        front; to the back; up; then all others that the sides allow, the farthest from them first.
        """
        sides, normal = self.contact_normals(k, placed), self.slabs[k].normal
        below = -self.up[None]
        first = middle_direction(np.concatenate([sides, below]))[0] if len(sides) else normal
        if len(sides) and self.max_square_angle is not None:
            yield from self._square_directions(k, placed, sides, first, self.max_square_angle)
        yield first
        if len(sides):
            yield middle_direction(sides)[0]
        yield from (normal, -normal, self.up)
        if self.has_direction(k, placed):
            all_directions = _directions()
            margin = -(all_directions @ np.concatenate([sides, below]).T).max(axis=1)
            order = np.argsort(-np.round(margin, 9), kind="stable")
            yield from all_directions[order[margin[order] > 0.0]]

    def _square_directions(
        self, k: int, placed: set[int], sides: FloatArray, middle: FloatArray, max_angle: float
    ) -> Sequence[FloatArray]:
        """Return directions (D, 3) that clear ``sides`` (K, 3) and are nearly normal to neighbours' sides.

        Those within ``max_angle`` [rad] of the normals of most neighbours come first. ``middle`` (3,) is the
        direction far from all sides.
        """
        slab, neighbours = self.slabs[k], [b for b in self.neighbours[k] if b in placed]
        away = [-unit(slab.normals[slab.beyond == b].mean(axis=(0, 1))) for b in neighbours]
        sums = [np.sum(c, axis=0) for n in (1, 2, 3) for c in itertools.combinations(away, n)]
        aims = np.array([aim for aim in sums if lengths(aim) > _TIGHT]).reshape(-1, 3)
        directions = np.concatenate([unit(unit(aims) + fraction * middle) for fraction in MIDDLE_FRACTIONS])
        margin = -(directions @ sides.T).max(axis=1)
        count = (directions @ np.array(away).reshape(-1, 3).T >= np.cos(max_angle)).sum(axis=1)
        keep = np.flatnonzero((margin >= -self.margin_tolerances[k]) & (count > 0))
        order = np.lexsort((-np.round(margin[keep], 9), -count[keep]))
        return list(directions[keep[order]][:MAX_MEASURED])


@functools.cache
def _directions() -> FloatArray:
    """Return directions (`MAX_DIRECTIONS`, 3) spread evenly on a spiral by the golden angle."""
    k = np.arange(MAX_DIRECTIONS)
    z = 1.0 - (2.0 * k + 1.0) / MAX_DIRECTIONS
    azimuth, r = k * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=1)


def _assemble_in_order(site: _Site, order: FloatArray) -> tuple[AssemblyStep, ...]:
    """Return the steps that place all bodies, those with the smallest value of ``order`` (N,) first."""
    waiting = np.argsort(order, kind="stable").tolist()
    placed: set[int] = set()
    steps = []
    while waiting:
        step = _next_step(site, waiting, placed)
        waiting.remove(step.body)
        placed.add(step.body)
        steps.append(step)
    return tuple(steps)


def _next_step(site: _Site, waiting: Sequence[int], placed: set[int]) -> AssemblyStep:
    """Return the step of the next body.

    It is the first one that has full support, or else partial support, has an insertion path, and blocks no
    other body. If there is none, it is the first one that blocks the fewest.
    """
    supported = (k for k in waiting if site.supports[k] <= placed)
    partly_supported = (k for k in waiting if site.supports[k] & placed and not site.supports[k] <= placed)
    for k in itertools.chain(supported, partly_supported):  # generators, because most bodies are never tested
        if site.has_direction(k, placed) and not site.blocked_count(k, placed):
            step = site.insertion(k, placed)
            if step.depth <= site.tolerance:
                return step
    candidates = [k for k in waiting if site.supports[k] <= placed]
    candidates = candidates or [k for k in waiting if site.supports[k] & placed] or list(waiting)
    return site.insertion(min(candidates, key=lambda k: site.blocked_count(k, placed)), placed)
