"""What is cut in which order: rows of rulings, and the part's closed surfaces in a plane across the wire.

Wanted are ruled surfaces of the part and sides of the block. The section across the wire says which
piece lies in which, and what lies beside a cut. Wires are batches of lines: how they move across
themselves, and where they pass a box.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely

from planner.claims.segments import Segment, clash
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray, Ruled, dots
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.problem import Part, Setup, Stock
from planner.processes.hotwire.plan.operation import BLOCK_SIDES, Straight, SurfaceCut, TrimCut
from planner.tooling import Bow

_PARALLEL: Final = 1e-12
"""Components of a direction below this do not leave the slab between two faces."""


@dataclasses.dataclass(frozen=True)
class Lines:
    """Wires through the points ``start`` and ``end`` (N, 3) [m], which are the guide points of a cut; the
    wire goes on beyond both."""

    start: FloatArray
    end: FloatArray

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | list[int] | IndexArray | BoolArray) -> "Lines":
        return Lines(self.start[rows], self.end[rows])

    @property
    def direction(self) -> FloatArray:
        """Unit vectors (N, 3) from start to end."""
        way = self.end - self.start
        return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))

    def at(self, length: FloatArray) -> FloatArray:
        """Points (N, 3) [m] at signed lengths (N,) [m] from the starts."""
        return self.start + length[:, None] * self.direction

    def moved(self, shift: FloatArray) -> "Lines":
        """The lines shifted by (3,) or (N, 3) [m]."""
        return Lines(self.start + shift, self.end + shift)

    def reversed(self) -> "Lines":
        """The lines in the opposite order."""
        return Lines(self.start[::-1], self.end[::-1])

    def abreast(self, points: FloatArray) -> FloatArray:
        """Signed lengths (N,) from the starts to the points of the lines nearest to ``points`` (N, 3)."""
        return np.asarray(np.sum((points - self.start) * self.direction, axis=1))


def join(parts: list[Lines]) -> Lines:
    """All lines in one batch."""
    return Lines(np.concatenate([p.start for p in parts]), np.concatenate([p.end for p in parts]))


def chord(lines: Lines, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed lengths (N,), (N,) [m] from the starts at which the lines enter and leave a box (2, 3); NaN
    where they pass it by (the slab method)."""
    way = lines.direction
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((box[k] - lines.start) / way for k in (0, 1))
    still = np.abs(way) < _PARALLEL
    between = (lines.start > box[0]) & (lines.start < box[1])
    first = np.where(still, np.where(between, -np.inf, np.inf), np.fmin(a, b)).max(axis=1)
    last = np.where(still, np.where(between, np.inf, -np.inf), np.fmax(a, b)).min(axis=1)
    passes = first < last
    return np.where(passes, first, np.nan), np.where(passes, last, np.nan)


def grown(box: FloatArray, margin: float) -> FloatArray:
    """A box (2, 3) that is larger by ``margin`` [m] on all sides."""
    return box + margin * np.array([[-1.0], [1.0]])


def place_text(point: FloatArray) -> str:
    """A place (3,) [m] as messages name it."""
    return "[" + ", ".join(f"{value / MM:.1f}" for value in point) + "] mm"


def move_across(lines: Lines, points: FloatArray) -> FloatArray:
    """How far (N - 1,) [m] each line moves across itself to the next one, at ``points`` (N - 1, 3) near it.

    Measured in the plane through the point across the mean direction of both.
    """
    way = lines.direction
    mean = way[:-1] + way[1:]
    mean = mean / np.linalg.norm(mean, axis=1, keepdims=True)

    def crossing(start: FloatArray, direction: FloatArray) -> FloatArray:
        share = np.sum((points - start) * mean, axis=1) / np.sum(direction * mean, axis=1)
        return np.asarray(start + share[:, None] * direction)

    gap = crossing(lines.start[1:], way[1:]) - crossing(lines.start[:-1], way[:-1])
    return np.asarray(np.linalg.norm(gap, axis=1))


def fastest(lines: Lines, box: FloatArray) -> FloatArray:
    """How far (N,) [m] the fastest point inside the box moves across the wire on the way to each line; NaN
    where none is inside, 0 for the first.

    The move is linear along the wire, so that it is largest at an end of the stretch inside.
    """
    enter, leave = chord(lines, box)
    out = np.full(len(lines), np.nan)
    for rows in (slice(None, -1), slice(1, None)):  # the stretch of either line: both count
        here = lines[rows]
        for length in (enter[rows], leave[rows]):
            inside = np.isfinite(length)
            points = here.at(np.where(inside, length, 0.0))
            out[1:] = np.fmax(out[1:], np.where(inside, move_across(lines, points), np.nan))
    out[:1] = 0.0
    return out


def exit_length(lines: Lines, way: FloatArray, box: FloatArray) -> FloatArray:
    """How far (N,) [m] each line must go along ``way`` (N, 3) until it has left the box for good, 0 where it
    never meets it that way.

    A line shifted by s meets the box where six half planes in (s, length along the line) have a common
    point; the farthest is one of their corners.
    """
    far = np.zeros(len(lines))
    direction = lines.direction
    rows = [
        (sign * way[:, k], sign * direction[:, k], sign * (box[end, k] - lines.start[:, k]))
        for k in range(3)
        for end, sign in ((0, -1.0), (1, 1.0))
    ]
    for (a, b, c), (d, e, f) in itertools.combinations(rows, 2):
        det = a * e - b * d
        good = np.abs(det) > _PARALLEL
        whole = np.where(good, det, 1.0)
        s, t = (c * e - b * f) / whole, (a * f - c * d) / whole
        for g, h, k in rows:
            good &= g * s + h * t <= k + 1e-9
        far = np.where(good, np.maximum(far, s), far)
    return far


def distance_to_polyline(points: FloatArray, polyline: FloatArray) -> FloatArray:
    """Distance (N,) [m] of points (N, 3) to a polyline (M, 3)."""
    out = np.full(len(points), np.inf)
    base, way = polyline[:-1], np.diff(polyline, axis=0)
    square = np.maximum(np.sum(way * way, axis=1), 1e-30)
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) * len(base) // 1_000_000)):
        gap = points[chunk, None] - base
        share = np.clip(np.einsum("nmi,mi->nm", gap, way) / square, 0.0, 1.0)
        gap -= share[..., None] * way
        out[chunk] = np.sqrt(dots(gap, gap).min(axis=1))
    return out


PARALLEL_COSINE: Final = 0.87
"""Least cosine between the rulings of surfaces that are looked at together."""
COMMON_SHARE: Final = 1e-3
"""Pieces that share more than this of the smaller one bound the part together."""


@dataclasses.dataclass(frozen=True)
class Plane:
    """A plane with its ``origin`` (3,) [m], unit ``normal`` (3,) and ``axes`` (3, 2)."""

    origin: FloatArray
    normal: FloatArray
    axes: FloatArray

    def point(self, place: FloatArray) -> FloatArray:
        """The point (3,) [m] at a place (2,) in the plane."""
        return np.asarray(self.origin + self.axes @ place)


@dataclasses.dataclass(frozen=True)
class Piece:
    """What a slot must leave alone: an outline's area, or, ``around``, the wall of a hole."""

    name: str
    shape: shapely.Geometry
    around: bool = False


@dataclasses.dataclass(frozen=True)
class Pieces:
    """The pieces beside a cut in a plane; ``enclosed``: what is cut lies in a hole of another piece."""

    plane: Plane
    others: list[Piece]
    enclosed: bool


def section(lines: Lines, plane: Plane) -> FloatArray:
    """Where lines (N) pass a plane, in its axes (N, 2)."""
    way = lines.end - lines.start
    share = (plane.origin - lines.start) @ plane.normal / (way @ plane.normal)
    return np.asarray((lines.start + share[:, None] * way - plane.origin) @ plane.axes)


def pieces_across(own: Ruled, ruled: Sequence[Ruled], box: FloatArray, level: float) -> Pieces:
    """What lies beside a closed surface in the plane at the share ``level`` of its rulings in the box."""
    plane = _plane(own, box, level)
    mine = contour(own, plane)
    others: list[Piece] = []
    enclosed = False
    for other in ruled:
        if (
            other.name == own.name
            or not other.closed
            or abs(_direction(other) @ plane.normal) < PARALLEL_COSINE
        ):
            continue
        shape = contour(other, plane)
        common = shapely.area(shapely.intersection(mine, shape))
        small, large = sorted((mine.area, shape.area))
        if common < COMMON_SHARE * small:
            others += [] if other.hole else [Piece(other.name, shape)]
        elif common > (1.0 - COMMON_SHARE) * small and small < large:
            within = mine.area < shape.area
            if within and other.hole:
                others.append(Piece(other.name, shapely.boundary(shape), around=True))
                enclosed |= not own.hole
            elif not within and own.hole and not other.hole:
                others.append(Piece(other.name, shape))
    return Pieces(plane, others, enclosed)


def alike(one: Ruled, other: Ruled) -> bool:
    """Whether two surfaces have rulings of about one direction, so that they are looked at together."""
    return bool(abs(_direction(one) @ _direction(other)) >= PARALLEL_COSINE)


def gripper_holds(outline: Ruled, foot: FloatArray) -> bool:
    """Whether a gripper below the block with the middle of its face at ``foot`` (3,) [m] holds what an
    outline cuts free; true for outlines whose rulings lie rather than stand."""
    if abs(_direction(outline)[2]) < PARALLEL_COSINE:
        return True
    plane = _across(np.asarray(foot, dtype=np.float64), np.array([0.0, 0.0, 1.0]))
    return bool(contour(outline, plane).intersects(shapely.Point(0.0, 0.0)))


def depths(ruled: Sequence[Ruled]) -> list[int]:
    """In how many other closed surfaces of the same direction each closed one lies; 0 for strips."""
    out = [0] * len(ruled)
    closed = [k for k, own in enumerate(ruled) if own.closed]
    ways = [_direction(ruled[k]).round(6) for k in closed]
    for way in np.unique(np.array(ways).reshape(-1, 3), axis=0):
        rows = [k for k, own in zip(closed, ways, strict=True) if (own == way).all()]
        plane = _across(np.zeros(3), way)
        middles = [Lines(ruled[k].start, ruled[k].end) for k in rows]
        shapes = [shapely.make_valid(shapely.Polygon(0.5 * (m.start + m.end) @ plane.axes)) for m in middles]
        tree = shapely.STRtree(shapes)
        inner, outer = tree.query([shape.representative_point() for shape in shapes], predicate="within")
        for i, o in zip(inner, outer, strict=True):
            out[rows[i]] += int(i != o and shapes[i].area < shapes[o].area)
    return out


def _direction(ruled: Ruled) -> FloatArray:
    way = (ruled.end - ruled.start).mean(axis=0)
    return np.asarray(way / max(float(np.linalg.norm(way)), 1e-12))


def _across(origin: FloatArray, normal: FloatArray) -> Plane:
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return Plane(origin, normal, np.stack([first, np.cross(normal, first)], axis=1))


def _plane(own: Ruled, box: FloatArray, level: float) -> Plane:
    normal = _direction(own)
    corners = np.array(list(itertools.product(*box.T))) @ normal
    low = max(float((own.start @ normal).min()), float(corners.min()))
    high = min(float((own.end @ normal).max()), float(corners.max()))
    origin = 0.5 * (own.start + own.end).mean(axis=0)
    return _across(origin + (low + level * (high - low) - float(origin @ normal)) * normal, normal)


def contour(ruled: Ruled, plane: Plane) -> shapely.Geometry:
    """The area within a closed surface where it passes a plane, in its axes."""
    return shapely.make_valid(shapely.Polygon(section(Lines(ruled.start, ruled.end), plane)))


LEAST_OVERSIZE: Final = 1e-4
"""[m] a side that stands out by less has nothing that could be cut off."""


LEAD_ALONG: Final = 0.94
"""Largest cosine between a lead and the wire: one along the wire takes it nowhere."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """One surface to cut; ``name`` is that of its segment behind ``cut/``."""

    name: str
    ruled: Ruled
    cut: SurfaceCut | TrimCut

    @property
    def segment(self) -> Segment:
        """The segment of the targets on the surface; the ways in and out are its other phases."""
        return Segment("cut", self.name)


def wanted_surfaces(op: Straight, setup: Setup, part: Part | None) -> list[Wanted]:
    """The surfaces to cut, in order. Raises ``TandemError``: part.missing_surface, straight.trim,
    straight.lead, problem.duplicate_name."""
    out = _listed(op, setup, part)
    both = clash(one.segment for one in out)
    if both is not None:
        what = (
            f"{op.name}: two surfaces are called {both[0].name!r} and {both[1].name!r}, which programs "
            "cannot tell apart; rename one"
        )
        raise refusal("problem.duplicate_name", what, field="part")
    return out


def _listed(op: Straight, setup: Setup, part: Part | None) -> list[Wanted]:
    ruled = () if part is None else part.ruled
    if op.cuts == "all":
        if not ruled:
            raise TandemError(_missing(op, "cuts: all ruled surfaces", ruled))
        up, depth = -setup.stock.gravity, depths(ruled)
        order = sorted(range(len(ruled)), key=lambda k: _rank(ruled[k], depth[k], up))
        return [Wanted(ruled[k].name, ruled[k], SurfaceCut(surface=ruled[k].name)) for k in order]
    known = {r.name: r for r in ruled}
    out: list[Wanted] = []
    issues: list[Issue] = []
    for cut in op.cuts:
        if isinstance(cut, TrimCut):
            for side in cut.trim:
                fault = list(_no_oversize(op, setup.stock, side))
                issues += fault
                if not fault:
                    out.append(Wanted(f"trim_{side}", _side(op, setup, side, cut), cut))
        elif cut.surface in known:
            issues += _along_the_wire(op, known[cut.surface], cut)
            out.append(Wanted(cut.surface, known[cut.surface], cut))
        else:
            issues.append(_missing(op, f"surface '{cut.surface}'", ruled))
    if issues:
        raise TandemError(issues)
    return out


def _rank(ruled: Ruled, depth: int, up: FloatArray) -> tuple[int, int, float]:
    """Holes and pieces in holes first, the inmost before what is around them; then strips, then outlines,
    upper ones first, since what is cut free rests on the rest. ``depth``: in how many others it lies."""
    middle = 0.5 * (ruled.start + ruled.end).mean(axis=0)
    kind = 0 if ruled.hole or depth else 2 if ruled.closed else 1
    return kind, -depth, float(-(middle @ up).round(6)) if ruled.closed and not ruled.hole else 0.0


def _missing(op: Straight, what: str, ruled: tuple[Ruled, ...]) -> Issue:
    have = ", ".join(r.name for r in ruled) or "none"
    return Issue(
        "part.missing_surface",
        f"{op.name}: {what} cannot be cut; ruled surfaces of the part: {have}; add it to the part or correct "
        "the name",
        field="part",
    )


def _along_the_wire(op: Straight, ruled: Ruled, cut: SurfaceCut) -> Iterator[Issue]:
    """A lead that is given must take the wire across itself, at every ruling."""
    if isinstance(cut.lead, str):
        return
    rulings = ruled.end - ruled.start
    rulings = rulings / np.maximum(np.linalg.norm(rulings, axis=1, keepdims=True), 1e-12)
    lead = np.array(cut.lead) / np.linalg.norm(cut.lead)
    along = float(np.abs(rulings @ lead).max())
    if along <= LEAD_ALONG:
        return
    angle, least = (np.degrees(np.arccos(min(value, 1.0))) for value in (along, LEAD_ALONG))
    what = f"{op.name}: lead {list(cut.lead)} of {cut.surface} is {angle:.0f} degrees off the wire; "
    what += f"{least:.0f} at least are wanted: give a direction across the wire, or auto"
    yield Issue("straight.lead", what, field=cut.surface)


def _no_oversize(op: Straight, stock: Stock, side: str) -> Iterator[Issue]:
    axis, end = BLOCK_SIDES[side]
    over = float(stock.oversize[end, axis])
    if over >= LEAST_OVERSIZE:
        return
    yield Issue(
        "straight.trim",
        f"{op.name}: side {side} is to be trimmed, but the block stands out of the datum block by "
        f"{over / MM:g} mm there; give stock.oversize_mm, or leave the side out",
        field="stock.oversize_mm",
        **measurement(over / MM, LEAST_OVERSIZE / MM, "mm"),
    )


def _side(op: Straight, setup: Setup, side: str, cut: TrimCut) -> Ruled:
    """A side of the datum block as two rulings, from the upper to the lower edge where it stands upright."""
    stock = setup.stock
    axis, end = BLOCK_SIDES[side]
    low, high = np.array([-0.5, -0.5, 0.0]) * stock.size, np.array([0.5, 0.5, 1.0]) * stock.size
    along = _along(op, setup, axis, cut)
    sweep = 3 - axis - along
    corner = np.zeros((2, 2, 3))  # ruling, end
    corner[..., axis] = (low, high)[end][axis]
    corner[:, 0, along], corner[:, 1, along] = low[along], high[along]
    first, last = (low[sweep], high[sweep])
    falling = stock.gravity[sweep] > 0.5
    first, last = (first, last) if falling or stock.gravity[sweep] > -0.5 else (last, first)
    corner[0, :, sweep], corner[1, :, sweep] = first, last
    normal = np.cross(corner[1, 0] - corner[0, 0], corner[0, 1] - corner[0, 0])
    if normal[axis] * (1.0 if end else -1.0) < 0.0:
        corner = corner[:, ::-1]
    return Ruled(f"trim_{side}", corner[:, 0], corner[:, 1], np.zeros(2, dtype=np.bool_))


def _along(op: Straight, setup: Setup, axis: int, cut: TrimCut) -> int:
    """The axis that the wire is parallel to: level rather than upright, then the shorter way through."""
    if cut.along != "auto":
        return "xyz".index(cut.along)
    length = setup.stock.upper - setup.stock.lower
    tool = setup.cell.arm(op.arms[0]).tool
    room = (tool.span if isinstance(tool, Bow) else np.inf) - 2.0 * op.margin_mm * MM
    level = np.abs(setup.stock.gravity) < 0.5
    choice = [k for k in range(3) if k != axis]
    return min(choice, key=lambda k: (length[k] > room, not level[k], length[k]))
