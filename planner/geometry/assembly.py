"""The order in which bodies of a shell or wall can be put up, and the straight way in for each.

A body touches others along its sides. The directions along which it can leave those that stand are a cone:
the half spaces of the sides there. Its middle, the direction that is farthest from all of them, is exact
(`middle_way`). What is beyond the neighbours is asked of the whole body swept along its way (`in_the_way`).

**Order.** Bodies follow a wanted order, each when those that it rests on stand. One that would leave a
neighbour without a way in waits until that one stands, if that rests on something already.
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
"""The body beyond a side where there is none."""
CLEAR: Final = 1e-6
"""Bodies that overlap by less than this [m] touch."""
TRAVEL: Final = 1.5
"""How far the way in of a body is free, in diameters of the body."""
DIRECTIONS: Final = 400
"""Directions that are tried where the middle one is not free."""
FEW: Final = 4
"""Ways of which it is asked how much is in them where none is free."""
TOLD: Final = 1e-4 * 2.0 ** np.arange(12)
"""How much [m] that is, in steps."""
ROUNDS: Final = 4
"""Orders that are tried while bodies are left without a way in."""
TOWARDS: Final = (0.0, 0.1, 0.2, 0.4, 0.8)
"""Shares of the middle way that are added to one that is square to a side, until other sides let it pass."""
_SKEW: Final = np.array([1.0, 0.6180339887, 0.3249197])  # along no edge of a regular shell
_TIGHT: Final = 1e-12  # of a margin: no constraint is farther beyond
_FLAT: Final = 1e-14  # m^2: triangles with less area cover nothing


@dataclasses.dataclass(frozen=True)
class Slab:
    """A body between ``front`` and ``back`` (V, 3) [m], whose vertices belong together in pairs: ``faces``
    (F, 3) of its front, counterclockwise seen from there, ``rim`` (C,): vertices on its outline, the same way
    round; ``beyond`` (C,): the body beyond the side from one of these to the next, or ``NONE``."""

    front: FloatArray
    back: FloatArray
    faces: IntArray
    rim: IntArray
    beyond: IntArray

    @functools.cached_property
    def mesh(self) -> tuple[FloatArray, IntArray]:
        """Vertices (2 V, 3), those in front first, and triangles (T, 3) of the closed surface, outwards."""
        count = len(self.front)
        a, b = self.rim, np.roll(self.rim, -1)
        key = self.front @ _SKEW
        first = (key[a] < key[b])[:, None]  # the diagonal of a side, which is the same for the body beyond
        low = np.where(first, np.stack([count + a, count + b, a], 1), np.stack([count + a, count + b, b], 1))
        high = np.where(first, np.stack([count + b, b, a], 1), np.stack([count + a, b, a], 1))
        faces = np.concatenate([self.faces, count + self.faces[:, ::-1], low, high])
        return np.concatenate([self.front, self.back]), faces

    @functools.cached_property
    def triangles(self) -> FloatArray:
        """The same as corners (T, 3, 3)."""
        vertices, faces = self.mesh
        return vertices[faces]

    @functools.cached_property
    def normals(self) -> FloatArray:
        """Outward normals (C, 4, 3) of the sides at their corners; those in between are in their cone."""
        turned = [np.roll(self.rim, -1), self.rim]
        rise = [self.front[k] - self.back[k] for k in turned]
        along = [face[turned[0]] - face[turned[1]] for face in (self.front, self.back)]
        return unit(np.stack([np.cross(e, r) for e in along for r in rise], axis=1))

    @property
    def normal(self) -> FloatArray:
        """The mean normal (3,) of the front."""
        a, b, c = self.front[self.faces].transpose(1, 0, 2)
        return unit(np.cross(b - a, c - a).sum(axis=0))

    @functools.cached_property
    def ball(self) -> tuple[FloatArray, float]:
        """The middle of its box, and the radius [m] about it that holds the body."""
        whole = self.mesh[0]
        middle = 0.5 * (whole.min(axis=0) + whole.max(axis=0))
        return middle, float(lengths(whole - middle).max())

    @property
    def travel(self) -> float:
        """How far [m] its way in is free."""
        return TRAVEL * 2.0 * self.ball[1]


def outline_faces(ring: FloatArray) -> IntArray:
    """Triangles (F, 3), counterclockwise, of the polygon with corners (C, 2), counterclockwise, and no other
    ones. Raises ``ValueError`` where it crosses itself."""
    shape = shapely.Polygon(ring)
    if not shape.is_valid:
        raise ValueError("an outline crosses itself")
    number = {corner: k for k, corner in enumerate(map(tuple, ring.tolist()))}
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shape))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    faces = np.array([[number[x, y] for x, y in one] for one in corners.tolist()], dtype=np.int64)
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    turned = one[:, 0] * two[:, 1] < one[:, 1] * two[:, 0]
    faces[turned] = faces[turned, ::-1]
    return faces[np.lexsort(faces.T[::-1])]


def bodies_beyond(plans: Sequence[FloatArray], off: float) -> list[IntArray]:
    """For each edge of outlines (C, 2) that fill a plane side by side, counterclockwise, the outline beyond,
    found ``off`` outside of its middle, or ``NONE``."""
    tree = shapely.STRtree([shapely.Polygon(ring) for ring in plans])
    out = []
    for ring in plans:
        along = np.roll(ring, -1, axis=0) - ring
        outwards = np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths(along)[:, None]
        places = shapely.points(ring + 0.5 * along + off * outwards)
        edge, body = tree.query(places, predicate="within")
        beyond = np.full(len(ring), NONE)
        beyond[edge] = body
        out.append(beyond)
    return out


def rows_up(beyond: Sequence[IntArray], first: BoolArray, low: FloatArray) -> IntArray:
    """The row (N,) of each body: 0 for the ``first`` ones (N,), then for neighbours of the row before. What
    hangs together with none goes on from the one that is ``low``est (N,)."""
    rows = np.full(len(beyond), NONE)
    now = np.flatnonzero(first)
    for row in range(len(beyond)):
        rows[now] = row
        if (rows != NONE).all():
            break
        near = np.concatenate([beyond[k] for k in now.tolist()])
        now = np.unique(near[(near != NONE) & (rows[near] == NONE)])
        if not len(now):  # pieces that hang together by a corner alone
            now = np.array([int(np.argmin(np.where(rows == NONE, low, np.inf)))])
    return rows


def middle_way(normals: FloatArray) -> tuple[FloatArray, float]:
    """The unit direction d (3,) whose least margin, the smallest -n . d over unit ``normals`` (K, 3), K > 0,
    is the largest there is, and that margin: the sine of the angle to the nearest half space. Below zero
    there is no way out of them.

    At the best direction one, two or three margins are the least, so it is among the directions that have
    these equal: all of them of a working set, to which the worst of the others is added until none is worse.
    """
    work = [0]
    while True:
        way, margin = _middle_of(normals[work])
        worst = int(np.argmax(normals @ way))
        if -float(normals[worst] @ way) >= margin - _TIGHT or worst in work:
            return way, margin
        work.append(worst)


@functools.cache
def _chosen(count: int, some: int) -> IntArray:
    """All choices (K, ``some``) of so many of the numbers 0 to ``count`` - 1."""
    chosen = list(itertools.combinations(range(count), some))
    return np.array(chosen, dtype=np.int64).reshape(-1, some)


def _middle_of(normals: FloatArray) -> tuple[FloatArray, float]:
    ways = [-normals]
    pairs, triples = _chosen(len(normals), 2), _chosen(len(normals), 3)
    half = -normals[pairs].sum(axis=1)
    ways.append(half[lengths(half) > _TIGHT])
    a, b, c = normals[triples].transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    ways += [across[lengths(across) > _TIGHT], -across[lengths(across) > _TIGHT]]
    opposite = half[lengths(half) <= _TIGHT]
    if len(opposite):  # two sides against one another: along both, and away from a third
        ways += [np.cross(normals[i], np.eye(3)) for i in pairs[lengths(half) <= _TIGHT][:, 0]]
    found = np.concatenate(ways)
    found = unit(found[lengths(found) > _TIGHT])
    margins = -(found @ normals.T).max(axis=1)
    best = int(np.argmax(np.round(margins, 12)))
    return found[best], float(margins[best])


def in_the_way(
    body: FloatArray, others: FloatArray, way: FloatArray, travel: float, give: float = CLEAR
) -> float:
    """How deep [m] a closed body of triangles (T, 3, 3) comes into ``others`` (U, 3, 3), which it does not
    overlap now, when it is moved by up to ``travel`` [m] along ``way`` (3,): across the surfaces that meet.
    What is no wider than ``give`` [m] is not seen.

    On a line along the way others are in the way where they begin above the body. Facets of both that look
    back are piecewise linear over the plane across, so the ends of what each pair has in common say it. What
    begins nearer than ``travel`` above the top of the body counts.
    """
    side = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(way, side), way], axis=1)
    under, over = _looking(body @ axes), _looking(others @ axes)
    under = _shrunk(under, give)
    if not len(under):
        return 0.0
    low, high = under.min(axis=(0, 1)), under.max(axis=(0, 1))
    over = over[(over.max(axis=1) > low).all(axis=1) & (over.min(axis=1)[:, :2] < high[:2]).all(axis=1)]
    (a_low, a_high), (b_low, b_high) = ((t.min(axis=1), t.max(axis=1)) for t in (under, over))
    near = a_low[:, None, 2] < b_high[:, 2]
    for axis in range(2):
        near &= (a_low[:, None, axis] < b_high[:, axis]) & (b_low[:, axis] < a_high[:, None, axis])
    i, k = np.nonzero(near)
    if not len(i):
        return 0.0
    a, b = under[i], over[k]
    least, most = _heights_above(a, b)
    depth = most * np.minimum(_facing(a), _facing(b))
    met = (most > 0.0) & (least < travel + np.ptp(body @ way))
    return float(depth[met].max(initial=0.0))


def _looking(triangles: FloatArray) -> FloatArray:
    """Those that look against z."""
    one, two = triangles[:, 1, :2] - triangles[:, 0, :2], triangles[:, 2, :2] - triangles[:, 0, :2]
    return triangles[one[:, 1] * two[:, 0] - one[:, 0] * two[:, 1] > _FLAT]


def _facing(triangles: FloatArray) -> FloatArray:
    """The part (T,) of the unit normals along z."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(np.abs(normal[:, 2]) / lengths(normal))


def _shrunk(triangles: FloatArray, by: float) -> FloatArray:
    """Triangles whose edges in x and y are moved inwards ``by`` that [m], without those that vanish."""
    flat = triangles[..., :2]
    edge = lengths((np.roll(flat, 1, axis=1) - np.roll(flat, -1, axis=1)).reshape(-1, 2)).reshape(-1, 3)
    one, two = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    inner = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / edge.sum(axis=1)  # the circle's radius
    keep = inner > by
    triangles, edge, inner = triangles[keep], edge[keep], inner[keep]
    share = edge / edge.sum(axis=1, keepdims=True)
    middle = (share[..., None] * triangles).sum(axis=1, keepdims=True)
    return np.asarray(middle + (1.0 - by / inner)[:, None, None] * (triangles - middle))


def _heights_above(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How high (P,) triangles ``b`` (P, 3, 3) are above ``a`` at least and at most where their shadows on the
    plane z = 0 overlap; below nothing where they do not."""
    p, q = a[:, :, None, :2], b[:, None, :, :2]
    along, across = np.roll(p, -1, axis=1) - p, np.roll(q, -1, axis=2) - q
    turn = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    rest = q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (rest[..., 0] * across[..., 1] - rest[..., 1] * across[..., 0]) / turn
        t = (rest[..., 0] * along[..., 1] - rest[..., 1] * along[..., 0]) / turn
        crossing = (p + s[..., None] * along).reshape(len(a), 9, 2)
        cross = ((s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)).reshape(len(a), 9)
    places = np.concatenate([a[..., :2], b[..., :2], np.where(cross[..., None], crossing, 0.0)], axis=1)
    (z_a, in_a), (z_b, in_b) = _at(a, places), _at(b, places)
    known = np.concatenate([in_b[:, :3], in_a[:, 3:6], cross], axis=1)
    above = z_b - z_a
    return np.where(known, above, np.inf).min(axis=1), np.where(known, above, -np.inf).max(axis=1)


def _at(triangles: FloatArray, places: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Heights (P, M) of the planes of triangles (P, 3, 3) at places (P, M, 2), and which are inside."""
    first = triangles[:, None, 0]
    one, two = (triangles[:, None, k] - first for k in (1, 2))
    own = places - first[..., :2]
    whole = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    u = (own[..., 0] * two[..., 1] - own[..., 1] * two[..., 0]) / whole
    v = (one[..., 0] * own[..., 1] - one[..., 1] * own[..., 0]) / whole
    z = first[..., 2] + u * one[..., 2] + v * two[..., 2]
    return np.asarray(z), np.asarray((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0))


@dataclasses.dataclass(frozen=True)
class Step:
    """The next ``body`` that is put up, the direction ``way`` (3,) in which it comes in, and the ``depth``
    [m] that would have to be off all round for that way to be free, 0 where it is; in the steps of
    `TOLD`."""

    body: int
    way: FloatArray
    depth: float


def put_up(
    slabs: Sequence[Slab],
    rank: IntArray,
    rests: Sequence[IntArray],
    up: FloatArray,
    give: float,
    square: float | None = None,
) -> tuple[Step, ...]:
    """All bodies in the order in which they are put up.

    ``rank`` (N,): the order that is wanted; ``rests``: the bodies that each one rests on, none of them on the
    ground; ``up`` (3,): what nothing comes from below against; ``give`` [m]: what may be in the way. Of up to
    `ROUNDS` orders the first with the fewest bodies that more is in the way of: those then come as early as
    they can. ``square`` [rad]: of the ways in that are free, one is wanted that is no more than this off
    square to sides of as many neighbours as possible, as dowels ask; none: one that is far from all sides.
    """
    site = _Site(slabs, rests, up, give, square)
    wanted = np.argsort(np.argsort(rank, kind="stable")).astype(np.float64)
    best: tuple[Step, ...] = ()
    least = len(slabs) + 1
    for _ in range(ROUNDS):
        steps = _in_order(site, wanted)
        closing = [step.body for step in steps if step.depth > give]
        if len(closing) < least:
            best, least = steps, len(closing)
        if not closing:
            break
        for k in closing:
            near = slabs[k].beyond[slabs[k].beyond != NONE]
            wanted[k] = min([wanted[k], *wanted[near]]) - 0.5
    return best


class _Site:
    """What all orders of the same bodies have in common."""

    def __init__(
        self,
        slabs: Sequence[Slab],
        rests: Sequence[IntArray],
        up: FloatArray,
        give: float,
        square: float | None,
    ) -> None:
        self.slabs, self.up, self.give, self.square = slabs, up, give, square
        self.rests = [set(one.tolist()) for one in rests]
        self.near = [sorted({b for b in slab.beyond.tolist() if b != NONE}) for slab in slabs]
        self.middles = np.array([slab.ball[0] for slab in slabs])
        self.radii = np.array([slab.ball[1] for slab in slabs])
        low = np.array([float((slab.mesh[0] @ up).min()) for slab in slabs])
        self.low = low - low.min()  # above the ground
        deep = [float(lengths(slab.front - slab.back).max()) for slab in slabs]
        self.slack = [
            give / one for one in deep
        ]  # margins below nothing by which no more than that is in the way
        self.known: dict[tuple[int, frozenset[int]], bool] = {}

    def sides(self, k: int, standing: set[int]) -> FloatArray:
        """Normals (K, 3) of a body's sides to those that stand, and of what it has on the ground."""
        slab = self.slabs[k]
        sides = slab.normals[[b in standing for b in slab.beyond.tolist()]].reshape(-1, 3)
        return np.concatenate([sides, -self.up[None]]) if self.low[k] <= self.give else sides

    def opens(self, k: int, standing: set[int]) -> bool:
        """Whether the sides of a body to those that stand leave a way."""
        key = k, frozenset(standing.intersection(self.near[k]))
        if key not in self.known:
            sides = self.sides(k, standing)
            self.known[key] = not len(sides) or middle_way(sides)[1] >= -self.slack[k]
        return self.known[key]

    def closes(self, k: int, standing: set[int]) -> int:
        """How many bodies that wait would have no way in once this one stands."""
        then = standing | {k}
        return sum(
            b not in then and self.opens(b, standing) and not self.opens(b, then) for b in self.near[k]
        )

    def step(self, k: int, standing: set[int]) -> Step:
        """The way in of a body, the first of those tried that is free; else, of the few that do not ask its
        sides, the one with the least in the way."""
        slab = self.slabs[k]
        around = self._around(k, standing)

        def met(way: FloatArray, give: float) -> bool:
            return in_the_way(slab.triangles, around, way, slab.travel, give) > give

        above = []
        for way in self._ways(k, standing):  # most bodies take the first one
            if self.low[k] + min(0.0, float(way @ self.up)) * slab.travel < -self.give:
                continue
            if not len(around) or not met(way, self.give):
                return Step(k, -way, 0.0)
            above.append(way)
        depths = []
        for way in above[:FEW]:
            gives = TOLD[self.give < TOLD].tolist()
            depths.append(next((give for give in gives if not met(way, give)), float("inf")))
        best = int(np.argmin(depths))
        return Step(k, -above[best], min(depths[best], 2.0 * slab.ball[1]))

    def _around(self, k: int, standing: set[int]) -> FloatArray:
        """Triangles (U, 3, 3) of those that stand and may be in the way of a body."""
        reach = self.slabs[k].travel + self.radii[k]
        apart = lengths(self.middles - self.middles[k])
        near = [b for b in np.flatnonzero(apart < reach + self.radii).tolist() if b in standing]
        return np.concatenate([self.slabs[b].triangles for b in near] or [np.zeros((0, 3, 3))])

    def _ways(self, k: int, standing: set[int]) -> Iterator[FloatArray]:
        """Ways out of a body that are tried: square to sides where that is wanted; away from all sides and
        from below, away from all sides, to the front, to the back, up; then whatever the sides leave, the
        farthest from them first."""
        sides, normal = self.sides(k, standing), self.slabs[k].normal
        below = -self.up[None]
        first = middle_way(np.concatenate([sides, below]))[0] if len(sides) else normal
        if len(sides) and self.square is not None:
            yield from self._square_ways(k, standing, sides, first, self.square)
        yield first
        if len(sides):
            yield middle_way(sides)[0]
        yield from (normal, -normal, self.up)
        if self.opens(k, standing):
            many = _directions()
            margin = -(many @ np.concatenate([sides, below]).T).max(axis=1)
            order = np.argsort(-np.round(margin, 9), kind="stable")
            yield from many[order[margin[order] > 0.0]]

    def _square_ways(
        self, k: int, standing: set[int], sides: FloatArray, middle: FloatArray, square: float
    ) -> Sequence[FloatArray]:
        """Ways out of a body, clear of its ``sides`` (K, 3), that are at most ``square`` [rad] off square to
        those of one neighbour or more, of most neighbours first, then the farthest from all sides."""
        slab, near = self.slabs[k], [b for b in self.near[k] if b in standing]
        outs = [-unit(slab.normals[slab.beyond == b].mean(axis=(0, 1))) for b in near]
        some = [np.sum(c, axis=0) for n in (1, 2, 3) for c in itertools.combinations(outs, n)]
        aims = np.array([aim for aim in some if lengths(aim) > _TIGHT]).reshape(-1, 3)
        ways = np.concatenate([unit(unit(aims) + share * middle) for share in TOWARDS])
        margin = -(ways @ sides.T).max(axis=1)
        count = (ways @ np.array(outs).reshape(-1, 3).T >= np.cos(square)).sum(axis=1)
        keep = np.flatnonzero((margin >= -self.slack[k]) & (count > 0))
        order = np.lexsort((-np.round(margin[keep], 9), -count[keep]))
        return list(ways[keep[order]][:FEW])


@functools.cache
def _directions() -> FloatArray:
    """Directions (`DIRECTIONS`, 3) spread evenly, on a spiral by the golden angle."""
    k = np.arange(DIRECTIONS)
    z = 1.0 - (2.0 * k + 1.0) / DIRECTIONS
    turn, r = k * np.pi * (3.0 - np.sqrt(5.0)), np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _in_order(site: _Site, wanted: FloatArray) -> tuple[Step, ...]:
    left = np.argsort(wanted, kind="stable").tolist()
    standing: set[int] = set()
    steps = []
    while left:
        step = _next(site, left, standing)
        left.remove(step.body)
        standing.add(step.body)
        steps.append(step)
    return tuple(steps)


def _next(site: _Site, left: Sequence[int], standing: set[int]) -> Step:
    """The first body that rests on what stands, all of it or else a part, has a way in and takes nobody's;
    where there is none, the first that takes the fewest."""
    full = (k for k in left if site.rests[k] <= standing)
    part = (k for k in left if site.rests[k] & standing and not site.rests[k] <= standing)
    for k in itertools.chain(full, part):  # most of them are never asked
        if site.opens(k, standing) and not site.closes(k, standing):
            step = site.step(k, standing)
            if step.depth <= site.give:
                return step
    some = [k for k in left if site.rests[k] <= standing]
    some = some or [k for k in left if site.rests[k] & standing] or list(left)
    return site.step(min(some, key=lambda k: site.closes(k, standing)), standing)
