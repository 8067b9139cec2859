"""Where milling tools are while they mill, their bodies, and the places at which they are looked for.

Tips and axes in the block's frame, at as few places of the replay as the motion between them
allows. The tool is a row of solids of revolution: how far points are off it along a track. Places
of faces that count are those near to a tool's way, as near to one another as what is looked for is
wide. Sharp edges are narrow where they go in, and are looked for more closely.
"""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.geometry.swept_body import RoundBody, least_distances, places_near
from planner.problem import Stock
from planner.processes.milling.claims import MillsAlong, MillsFlank, MillsOver, MillsSurface, SparesPart
from planner.processes.milling.proof.following import Followed, follow, rows_to_check
from planner.processes.milling.proof.wanted_ways import down, up
from planner.proof.context import Context
from planner.proof.facts import Fact
from planner.proof.replay.motion import during
from planner.proof.replay.tool_track import Spaced, Track, tcp_in_stock, track_of
from planner.runtime.executor import SERIAL, Executor
from planner.tooling import Cutter, Mill

BEND_SHARE = 0.1
"""Part of a tolerance that straight lines between places may leave the way by, where it bends."""


def in_block(tip: FloatArray, axis: FloatArray, length: float, radius: float, stock: Stock) -> BoolArray:
    """(T,) whether a cutter with ``tip`` and ``axis`` (T, 3) in the block's frame, as a row of balls along
    its axis, is in the block."""
    out = np.zeros(len(tip), dtype=bool)
    for back in np.append(np.arange(0.0, length, max(radius, 1e-3)), length):
        at = tip + back * axis
        beyond = np.maximum(np.maximum(stock.lower - at, at - stock.upper), 0.0)
        # the first ball is the tip's end, a disk: less than its radius counts there
        near = 1e-6 if back == 0.0 else radius
        out |= np.linalg.norm(beyond, axis=1) < min(near, radius) - 1e-9
    return out


class Milling:
    """The milling of one proof: its claims by setup, and tracks worked out when asked; ``executor`` runs what
    another process may work out meanwhile."""

    def __init__(self, context: Context, executor: Executor = SERIAL) -> None:
        self.context, self.executor = context, executor
        self.by_setup: tuple[
            tuple[int, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart], ...
        ] = tuple(
            (index, claim)
            for index, setup in enumerate(context.setup_claims)
            for group in setup.groups
            for claim in group
            if isinstance(claim, MillsSurface | MillsAlong | MillsFlank | MillsOver | SparesPart)
        )
        self._tracks: dict[tuple[int, str, tuple[str, ...]], Track] = {}
        self._spaced: dict[tuple[int, str, tuple[str, ...], float, float], Spaced] = {}
        self._followed: dict[tuple[int, int], tuple[IntArray, Followed]] = {}

    @property
    def surfaces(self) -> tuple[tuple[int, MillsSurface], ...]:
        """Surfaces that are milled."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsSurface))

    @property
    def curves(self) -> tuple[tuple[int, MillsAlong], ...]:
        """Curves that tips follow; among them the ways to passes over faces and from them, straight along the
        axis from the safe plane to wherever these begin and end."""
        own = [(i, self._said(i, claim)) for i, claim in self.by_setup if isinstance(claim, MillsAlong)]
        return (*own, *self._over_ways)

    def _said(self, index: int, claim: MillsAlong) -> MillsAlong:
        """The claim, or where either way will do, that for the way that its tool goes."""
        track = self.track(index, claim.arm, (claim.segment.key,)) if claim.back else None
        if claim.back is None or track is None or not len(track.rows):
            return claim
        seen = track.tip[[0, -1]]
        apart = [np.linalg.norm(own.tip[[0, -1]] - seen, axis=1).sum() for own in (claim, claim.back)]
        return claim if apart[0] <= apart[1] else claim.back

    @cached_property
    def _over_ways(self) -> tuple[tuple[int, MillsAlong], ...]:
        out: list[tuple[int, MillsAlong]] = []
        for index, claim in self.over:
            for segment in claim.segments:
                track = self.track(index, claim.arm, (segment.key,))
                for way, row in ((down, 0), (up, -1)) if len(track.rows) else ():
                    ends, bounds = (track.tip[row], track.axis[row]), (claim.tolerance, claim.turn)
                    out.append((index, way(claim.safe, segment, claim.arm, *ends, *bounds)))
        return tuple(out)

    @property
    def over(self) -> tuple[tuple[int, MillsOver], ...]:
        """Faces that the ends of cutters pass over."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsOver))

    @property
    def flanks(self) -> tuple[tuple[int, MillsFlank], ...]:
        """Ruled surfaces that cutters pass with their sides."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, MillsFlank))

    @property
    def spared(self) -> tuple[tuple[int, SparesPart], ...]:
        """Faces that tools must not go into."""
        return tuple((i, claim) for i, claim in self.by_setup if isinstance(claim, SparesPart))

    @cached_property
    def labels(self) -> frozenset[str]:
        """Labels of all moves in which a face is spared, a surface made or a curve followed."""
        names: list[Segment] = []
        for _, claim in self.by_setup:
            names += (claim.segment,) if isinstance(claim, MillsAlong) else claim.segments
        return frozenset(way.key for name in names for way in name.ways)

    def mounted(self, index: int, arm: str) -> Cutter | None:
        """The cutter of the tool on ``arm`` in setup ``index``."""
        tool = self.context.setups[index].cell.arm(arm).tool
        return tool.cutter if isinstance(tool, Mill) else None

    def track(self, index: int, arm: str, labels: tuple[str, ...]) -> Track:
        """The track of ``arm`` in setup ``index`` on moves of segments with these keys."""
        key = (index, arm, labels)
        if key not in self._tracks:
            self._tracks[key] = track_of(self.context, *key)
        return self._tracks[key]

    def followed(self, index: int, claim: MillsAlong) -> tuple[IntArray, Followed] | None:
        """How the claimed way is followed at those samples of its track whose rows come first; None where the
        track has none."""
        key = (index, id(claim))  # claims live as long as this does
        track = self.track(index, claim.arm, (claim.segment.key,))
        if key not in self._followed and len(track.rows):
            some = rows_to_check(track.tip, track.axis, claim.tolerance)
            self._followed[key] = some, follow(claim, track.tip, track.axis, some)
        return self._followed.get(key)

    def spaced(self, index: int, arm: str, labels: tuple[str, ...], step: float, tolerance: float) -> Spaced:
        """Places along :meth:`track`, as :meth:`Track.spaced` has them, with the bends that count at a
        ``tolerance`` [m]: each face is held against them."""
        key = (index, arm, labels, step, tolerance)
        if key not in self._spaced:
            self._spaced[key] = self.track(index, arm, labels).spaced(step, BEND_SHARE * tolerance)
        return self._spaced[key]

    def inside(self, index: int, arm: str, cutter: Cutter) -> tuple[IntArray, IntArray, FloatArray]:
        """The samples (M,) of setup ``index`` at which the cutter on ``arm`` is in the block, or the last
        ones before, with the moves (M,) under way and the times (M,) [s]."""
        looks, stock = self.context.motion.looks, self.context.stock(index)
        rows = np.flatnonzero(during(self.context.sample_setup[looks.sample] == index))
        found = np.zeros(len(rows), dtype=bool)
        for part, seen in tcp_in_stock(self.context, index, arm, rows):
            tip, axis = seen[:, :3, 3], -seen[:, :3, 2]
            found[part] = in_block(tip, axis, cutter.overhang, cutter.radius, stock)
        rows = rows[found]
        return looks.sample[rows], looks.node[rows], looks.time[rows]


def _milling(context: Context) -> Milling:
    return Milling(context, context.motion_executor)


MILLING: Final[Fact[Context, Milling]] = Fact("milling", _milling)
"""The milling of a proof."""


SIGHT_DISTANCE = 3e-3
"""Points farther off than this [m] are not told apart."""


@dataclasses.dataclass(frozen=True)
class Solid:
    """One piece of a tool: a cylinder of ``radius`` [m] from ``start`` to ``end`` [m] behind the tip, the
    edge of its front rounded by ``corner`` [m]; ``name`` as a person calls it."""

    name: str
    start: float
    end: float
    radius: float
    corner: float = 0.0


def solids(cutter: Cutter) -> tuple[Solid, ...]:
    """Cutting part, shank, and the pieces of holder and spindle."""
    out = [Solid("cutter", 0.0, cutter.flute, cutter.radius, cutter.corner)]
    if cutter.overhang > cutter.flute:
        out.append(Solid("shank", cutter.flute, cutter.overhang, cutter.shank))
    count = len(cutter.behind) // 2
    for k in range(count):
        a, b = cutter.behind[2 * k], cutter.behind[2 * k + 1]
        name = "spindle" if k == count - 1 else "holder"
        out.append(Solid(name, float(a[0]), float(b[0]), float(a[1])))
    return tuple(out)


def signed(solid: Solid, back: FloatArray, beside: FloatArray) -> FloatArray:
    """Distance [m] of points ``back`` behind the tip and ``beside`` the axis from a solid, below zero inside,
    in the shape of both: that from its half section, a rectangle, and where one of its corners is round, from
    the arc there."""
    aside = beside - solid.radius
    ends = np.maximum(solid.start - back, back - solid.end)
    out = np.maximum(aside, ends)
    edge = np.nonzero((aside > 0.0) & (ends > 0.0))
    out[edge] = np.hypot(aside[edge], ends[edge])
    if solid.corner > 0.0:
        before, over = solid.start + solid.corner - back, aside + solid.corner
        arc = np.nonzero((before > 0.0) & (over > 0.0))
        out[arc] = np.hypot(before[arc], over[arc]) - solid.corner
    return np.asarray(out)


def comes_near(vertices: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid) -> bool:
    """Whether a solid at places (M, 3) of a track may come within ``SIGHT_DISTANCE`` of a face with
    ``vertices`` (V, 3), by the boxes around both."""
    ends = np.concatenate([tip + solid.start * axis, tip + solid.end * axis])
    room = solid.radius + SIGHT_DISTANCE
    apart = (ends.min(axis=0) - room > vertices.max(axis=0)) | (
        ends.max(axis=0) + room < vertices.min(axis=0)
    )
    return not bool(apart.any())


def sweep(
    points: FloatArray, tip: FloatArray, axis: FloatArray, solid: Solid, below: float = np.inf
) -> tuple[FloatArray, IntArray]:
    """Least distance (P,) [m] of points (P, 3) from a solid at any of the places (M, 3) of a track, below
    zero inside, and the index (P,) of that place; at most ``SIGHT_DISTANCE`` is told. All places count. With
    ``below`` [m] what is not less may be told too large, but for the least of all."""

    def distance(back: FloatArray, beside: FloatArray) -> FloatArray:
        return signed(solid, back, beside)

    body = RoundBody(solid.start, solid.end, solid.radius, distance, solid.corner == 0.0)
    return least_distances(points, tip, axis, body, SIGHT_DISTANCE, below)


SLICE_LENGTH = 5e-3
"""How long slices of a tool at its edges are [m]: what goes in by more than half of that is seen without."""
EDGE_SPACING = 2.0
"""Way between places over the tolerance: an edge at 45 degrees that goes in by the tolerance is so wide, and
leaves stairs half as deep as the step between two places."""
LEAST_STEP = 0.1e-3
"""The same at least [m]."""
FINEST_SPACING = 0.4e-3
"""Places of a face are no nearer to one another than this [m],"""
MOST_FACE_POINTS = 4_000_000
"""and there are at most so many by one piece of a tool."""


def rim_step(tolerance: float) -> float:
    """Way between places [m] at which edges are looked at."""
    return max(EDGE_SPACING * tolerance, LEAST_STEP)


def edges(pieces: tuple[Solid, ...]) -> tuple[Solid, ...]:
    """Slices of a tool's pieces at their sharp edges: at the front where a piece is wider than what is before
    it, and behind where it is wider than what follows."""
    out: list[Solid] = []
    for k, own in enumerate(pieces):
        before = pieces[k - 1].radius if k else 0.0
        behind = pieces[k + 1].radius if k + 1 < len(pieces) else 0.0
        if own.corner == 0.0 and own.radius > before:
            out.append(dataclasses.replace(own, end=min(own.end, own.start + SLICE_LENGTH)))
        if own.radius > behind:
            out.append(dataclasses.replace(own, start=max(own.start, own.end - SLICE_LENGTH), corner=0.0))
    return tuple(out)


def rim_size(tolerance: float) -> float:
    """How near [m] to one another places of a face are by an edge: as it is wide where it goes in by the
    tolerance."""
    return max(EDGE_SPACING * tolerance, FINEST_SPACING)


def round_size(radius: float, tolerance: float) -> float:
    """The same for what is round, of ``radius`` [m]: between them it is in the face by half of the tolerance
    at most, s^2 / 6 r."""
    return max(float(np.sqrt(3.0 * radius * tolerance)), FINEST_SPACING)


def near_places(
    corners: FloatArray, solid: Solid, tip: FloatArray, axis: FloatArray, size: float
) -> tuple[FloatArray, int]:
    """Places (P, 3) of triangles (T, 3, 3) within sight of a solid somewhere on its way ``tip``, ``axis``
    (M, 3), as near to one another as pieces of edges of ``size`` [m] are, and how many these are: above
    ``MOST_FACE_POINTS`` that is too many, and there are none."""
    body = RoundBody(solid.start, solid.end, solid.radius, functools.partial(signed, solid))
    places, _, count = places_near(corners, tip, axis, body, SIGHT_DISTANCE, size, MOST_FACE_POINTS)
    return places, count


@dataclasses.dataclass(frozen=True)
class Held:
    """A face of ``vertices`` (V, 3), ``faces`` (T, 3) that is held against one solid of a tool, or the
    ``sharp`` edge of one, on its way ``tip``, ``axis`` (M, 3): what is inside by more than ``allowed`` [m] is
    looked for as closely as ``tolerance`` [m] asks, where the solid comes ``near`` at all."""

    vertices: FloatArray
    faces: IntArray
    solid: Solid
    sharp: bool
    near: bool
    tip: FloatArray
    axis: FloatArray
    tolerance: float
    allowed: float

    @property
    def size(self) -> float:
        """How near to one another places of the face have to be [m]."""
        return rim_size(self.tolerance) if self.sharp else round_size(self.solid.radius, self.tolerance)

    def inside(self) -> "Inside | int":
        """What is inside; where the face would have to be looked at in too many places, how many these
        are."""
        points = self.vertices[:1]
        if self.near:
            corners = self.vertices[self.faces]
            found, count = near_places(corners, self.solid, self.tip, self.axis, self.size)
            if count > MOST_FACE_POINTS:
                return count
            points = np.concatenate([found, points if self.sharp else self.vertices])
        off, place = sweep(points, self.tip, self.axis, self.solid, -self.allowed)
        k = int(off.argmin())
        deep = np.flatnonzero(off < -self.allowed)
        deep = deep[np.unique(place[deep], return_index=True)[1]]
        return Inside(float(off[k]), int(place[k]), points[deep], off[deep], place[deep])


@dataclasses.dataclass(frozen=True)
class Inside:
    """The ``least`` distance [m] of places of a face from a solid, below zero inside, and at which place of
    its way, ``at``; ``points`` (K, 3) that are inside by more than is allowed, with their distances ``off``
    (K,) and places ``place`` (K,), one for each of these."""

    least: float
    at: int
    points: FloatArray
    off: FloatArray
    place: IntArray


def insides(held: Sequence[Held]) -> Iterator[Inside | int]:
    """What is inside of each."""
    for one in held:
        yield one.inside()
