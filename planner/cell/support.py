"""What a block stands on: the floor, a body of the cell, the support that is stated, or a table or pedestal
that is made for it as high as its place wants it.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IndexArray, Shape, corners, transform
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity
from planner.problem import Arm, Cell, Pedestal, Problem, Setup, Stock

FOOT_HEIGHT: Final = 0.025
"""[m] what feet, shims and clamps may be between two bodies of which one stands on the other."""
FLOOR_HINT: Final = "or correct the heights of the bases, the lowest of which tells the floor"
"""End of the remedy for a block that nothing bears; the floor is at the lowest base."""
LEVEL_COSINE: Final = np.cos(np.deg2rad(1.0))
"""Cosine of the angle (1 degree) by which the side may lean on which a block stands."""


@dataclasses.dataclass(frozen=True)
class Ground:
    """What bears others in a cell: the floor at ``floor`` [m], and ``boxes`` (K, 2, 3) [m] around the shapes
    of obstacles, whose ``names`` (K,) these are."""

    floor: float
    boxes: FloatArray
    names: tuple[str, ...]

    @staticmethod
    def of(cell: Cell) -> "Ground":
        """The ground of a cell: its floor is level with the lowest base that stands upright, at most at 0; a
        track has its base at value 0 there, wherever it climbs or falls to."""
        upright = [float(_at_zero(arm)[2, 3]) for arm in cell.arms if arm.base[2, 2] > 0.5]
        boxes = [np.zeros((0, 2, 3))]
        names = []
        for obstacle in cell.obstacles:
            for shape in obstacle.shapes:
                points = transform(shape.pose, corners(shape))
                boxes.append(np.stack([points.min(axis=0), points.max(axis=0)])[None])
                names.append(obstacle.name)
        return Ground(min([0.0, *upright]), np.concatenate(boxes), tuple(names))

    def below(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, IndexArray]:
        """How far (K,) [m] boxes from ``low`` to ``high`` (K, 3) are above what bears them, 0 or less
        where they stand in it, and which obstacle's shape that is, -1 for the floor. What is below a box
        bears it where, with all that is as high, it is on either side of the box's middle."""
        gap = low[:, 2] - self.floor
        what = np.full(len(low), -1, dtype=np.intp)
        middle = 0.5 * (low + high)[:, :2]
        for k, (first, last) in enumerate(self.boxes):
            around = np.stack([np.full_like(middle, np.inf), np.full_like(middle, -np.inf)])
            for one, other in self.boxes[np.abs(self.boxes[:, 1, 2] - last[2]) <= FOOT_HEIGHT]:
                a, b = np.maximum(low[:, :2], one[:2]), np.minimum(high[:, :2], other[:2])
                over = (a <= b).all(axis=1)[:, None]
                around[0] = np.where(over, np.minimum(around[0], a), around[0])
                around[1] = np.where(over, np.maximum(around[1], b), around[1])
            own = (low[:, :2] <= last[:2]).all(axis=1) & (high[:, :2] >= first[:2]).all(axis=1)
            bears = own & ((around[0] <= middle) & (middle <= around[1])).all(axis=1)
            near = low[:, 2] - last[2]
            taken = bears & (low[:, 2] >= first[2] - FOOT_HEIGHT) & (near < gap)
            gap, what = np.where(taken, near, gap), np.where(taken, k, what)
        return gap, what

    @property
    def bears(self) -> bool:
        """Whether something in the cell but the floor might bear a block."""
        return bool((self.boxes[:, 1, 2] > self.floor + FOOT_HEIGHT).any())


def block_corners(stock: Stock) -> FloatArray:
    """Corners (8, 3) [m] of the block as found, in the stock frame."""
    return np.array(list(itertools.product(*zip(stock.lower, stock.upper, strict=True))))


def underside(stock: Stock, places: FloatArray) -> FloatArray:
    """Height (K,) [m] of the lowest corner of a block at ``places`` (K, 4, 4)."""
    return np.asarray(_world(block_corners(stock), places)[..., 2].min(axis=1))


def air(ground: Ground, stock: Stock, places: FloatArray) -> FloatArray:
    """How far (K,) [m] the foot of a block's support, or the block without one, is above what is below it."""
    shapes = [transform(shape.pose, corners(shape)) for shape in stock.support] or [block_corners(stock)]
    feet = np.stack([_world(points, places)[..., 2].min(axis=1) for points in shapes])
    lowest = np.argmin(feet, axis=0)
    out = np.empty(len(places))
    for k, points in enumerate(shapes):
        some = lowest == k
        world = _world(points, places[some])
        out[some] = ground.below(world.min(axis=1), world.max(axis=1))[0]
    return out


def bearer(cell: Cell, stock: Stock, place: FloatArray) -> tuple[float, str]:
    """How far [m] the foot of a block's support, or the block without one, is above what is below it, and the
    obstacle's name that this is, empty for the floor."""
    shapes = [transform(shape.pose, corners(shape)) for shape in stock.support] or [block_corners(stock)]
    foot = min((transform(place, points) for points in shapes), key=lambda one: float(one[:, 2].min()))
    ground = Ground.of(cell)
    gap, what = ground.below(foot.min(axis=0)[None], foot.max(axis=0)[None])
    return float(gap[0]), ground.names[int(what[0])] if what[0] >= 0 else ""


def with_support(cell: Cell, stock: Stock, place: FloatArray) -> Stock:
    """The stock with the table or pedestal that is made for it at ``place`` (4, 4) as its support: a box of a
    size in stock, in the middle under the block; none where the block stands on the floor or leans."""
    wanted = stock.pedestal
    if wanted is None or stock.held_by is not None:
        return stock
    height = float(underside(stock, place[None])[0]) - Ground.of(cell).floor
    up = place[2, :3]  # in the stock frame
    axis = int(np.argmax(np.abs(up)))
    if height <= FOOT_HEIGHT or abs(up[axis]) < LEVEL_COSINE:
        return dataclasses.replace(stock, support=())
    extent = stock.upper - stock.lower
    size, centre = np.empty(3), 0.5 * (stock.upper + stock.lower)
    for k in range(3):
        most = wanted.share * extent[k] + 2.0 * wanted.beyond
        if k == axis:
            size[k] = height
        elif wanted.beyond:  # the next one that is wide enough
            size[k] = next((s for s in wanted.sides if s >= most - 1e-9), wanted.sides[-1])
        else:
            size[k] = max([s for s in wanted.sides if s <= most + 1e-9], default=wanted.sides[0])
    down = -np.sign(up[axis])
    face = stock.lower[axis] if down < 0 else stock.upper[axis]
    centre[axis] = face + down * 0.5 * height
    pose = np.eye(4)
    pose[:3, 3] = centre
    return dataclasses.replace(
        stock, support=(Shape("box", (float(size[0]), float(size[1]), float(size[2])), pose),)
    )


def levels(cell: Cell, stock: Stock) -> FloatArray:
    """Heights [m] of the stock frame in the world at which the block stands on what is in stock."""
    if stock.pedestal is None:
        return np.zeros(0)
    lean = np.eye(4)
    lean[:3, :3] = stock.attitude
    own = float(underside(stock, lean[None])[0])
    return np.asarray(Ground.of(cell).floor + np.array(stock.pedestal.heights) - own)


def support_note(cell: Cell, stock: Stock, place: FloatArray) -> str:
    """What a block at ``place`` (4, 4) stands on, in words."""
    ground, made = Ground.of(cell), with_support(cell, stock, place)
    world = _world(block_corners(stock), place[None])[0]
    if stock.pedestal is not None and made.support:
        sides = [v for k, v in enumerate(made.support[0].size) if k != int(np.argmax(np.abs(place[2, :3])))]
        high = float(world[:, 2].min()) - ground.floor
        size = f"{sides[0] / MM:.0f} x {sides[1] / MM:.0f} mm, {high / MM:.0f} mm high from the floor"
        return f"a {stock.pedestal.kind} of {size}, in the middle under the block"
    if stock.support:
        gap = float(air(ground, stock, place[None])[0])
        foot = (
            "which stands on what is below it"
            if gap <= FOOT_HEIGHT
            else f"which ends {gap / MM:.0f} mm in the air"
        )
        return f"the support that the problem states, {foot}"
    gap, what = (v[0] for v in ground.below(world.min(axis=0)[None], world.max(axis=0)[None]))
    if gap > FOOT_HEIGHT:
        return f"nothing that is stated; it hangs {gap / MM:.0f} mm above what is below it"
    return "the floor" if what < 0 else f"the body {ground.names[what]} of the cell"


def issues(problem: Problem) -> list[Issue]:
    """What is wrong with how the blocks of a problem stand, as far as it is known before their places are."""
    out: list[Issue] = []
    for setup in problem.setups:
        out += stood(setup)
    return out


def stood(setup: Setup) -> list[Issue]:
    """What is wrong with how the block of one setup stands, as far as it is known before its place is."""
    setup = setup.upright
    stock, cell = setup.stock, setup.cell
    if stock.held_by is not None or stock.sheet is not None:
        return []
    field = f"operations.{setup.operations[0]}.setup.support" if setup.number > 1 else "stock.support"
    turn = stock.attitude if stock.place is None else stock.place[:3, :3]
    if stock.pedestal is not None:
        if np.abs(turn[2]).max() < LEVEL_COSINE:
            what = f"{field}: a block that leans stands on no {stock.pedestal.kind}; state the shapes of its "
            return [Issue("problem.field", what + "support", field=field)]
        return [] if stock.place is None else _high(cell, stock, stock.pedestal, stock.place, field)
    if not stock.support:
        if stock.place is None:
            why = "its place is searched, and nothing is stated that it stands on"
            return [] if Ground.of(cell).bears else [_hangs(why, field, None)]
        if (sunk := _sunk(cell, stock, stock.place)) > FOOT_HEIGHT:
            lost = _hangs("", field, sunk)
            what = f"the block goes {sunk / MM:.0f} mm below the floor; allowed are {FOOT_HEIGHT / MM:g} mm"
            return [
                dataclasses.replace(
                    lost, message=what, hint=f"move it by {sunk / MM:.0f} mm in z, {FLOOR_HINT}"
                )
            ]
        gap = float(air(Ground.of(cell), stock, stock.place[None])[0])
        return (
            []
            if gap <= FOOT_HEIGHT
            else [_hangs(f"it is {gap / MM:.0f} mm above what would bear it", field, gap)]
        )
    lean = np.eye(4)
    lean[:3, :3] = turn
    out = _rest(stock, lean)
    if stock.place is not None:
        gap = float(air(Ground.of(cell), stock, stock.place[None])[0])
        out.append(
            (gap, FOOT_HEIGHT, f"the support under the block ends {gap / MM:.0f} mm above what is below it")
        )
        sunk = _sunk(cell, stock, stock.place)
        out.insert(0, (sunk, FOOT_HEIGHT, f"the block goes {sunk / MM:.0f} mm below the floor"))
    hint = "make it longer, put it under the middle of the block, put what it stands on among the cell's "
    hint += "obstacles, or let Tandem make one: support: pedestal"
    return [_unborne(what, field, off, limit, hint) for off, limit, what in out if off > limit + 1e-9][:1]


def _sunk(cell: Cell, stock: Stock, place: FloatArray) -> float:
    """How far [m] a block at ``place`` (4, 4) goes below the floor."""
    return Ground.of(cell).floor - float(underside(stock, place[None])[0])


def _rest(stock: Stock, place: FloatArray) -> list[tuple[float, float, str]]:
    """How far [m] a block at ``place`` (4, 4), which may be turned and moved, is above its support and beside
    it, each with what is allowed [m] and in words."""
    block = _world(block_corners(stock), place[None])[0]
    low, seen = float(block[:, 2].min()), shapely.MultiPoint(block[:, :2]).convex_hull
    shapes = [transform(place @ shape.pose, corners(shape)) for shape in stock.support]
    views = [shapely.MultiPoint(shape[:, :2]).convex_hull.intersection(seen) for shape in shapes]
    tops = np.array([float(shape[:, 2].max()) for shape in shapes])
    feet = np.array([float(shape[:, 2].min()) for shape in shapes])
    below = (feet < low) & np.array([view.area > 0.0 for view in views])
    if not below.any():
        around = shapely.MultiPoint(np.concatenate(shapes)[:, :2]).convex_hull
        aside = float(around.distance(seen.centroid)) or float(np.abs(tops - low).min())
        return [(aside, 0.0, "nothing of the support is under the block")]
    top = float(tops[below].max())
    bearing = [view for view, use in zip(views, below & (tops >= top - FOOT_HEIGHT), strict=True) if use]
    aside = float(shapely.unary_union(bearing).convex_hull.distance(seen.centroid))
    hang, words = (
        low - top,
        f"the middle of the block is {aside / MM:.0f} mm beside its support, so that it tips",
    )
    return [(hang, FOOT_HEIGHT, f"the block hangs {hang / MM:.0f} mm above its support"), (aside, 0.0, words)]


def _high(cell: Cell, stock: Stock, pedestal: Pedestal, place: FloatArray, field: str) -> list[Issue]:
    """What is wrong with the height of what is made under a block whose place is stated."""
    high = float(underside(stock, place[None])[0]) - Ground.of(cell).floor
    most, kind = pedestal.heights[-1], pedestal.kind
    if high < -FOOT_HEIGHT:
        what = f"the block is {-high / MM:.0f} mm below the floor, where no {kind} is"
        hint = f"correct its place, {FLOOR_HINT}; or take support out"
        return [_unborne(what, field, -high, FOOT_HEIGHT, hint)]
    if high > most + 1e-9:
        what = f"the {kind} under the block would be {high / MM:.0f} mm high; those in stock are "
        what += f"{most / MM:.0f} at most"
        hint = f"put the block lower, at most {most / MM:.0f} mm above the floor, or state the shapes of its "
        hint += "support"
        return [_unborne(what, field, high, most, hint)]
    name, deep = made_in(cell, stock, place)
    if deep > FOOT_HEIGHT:
        what = f"the {kind} under the block would stand {deep / MM:.0f} mm deep in {name}"
        hint = f"state the shapes of a support that stands on it, or put the block or {name} elsewhere"
        return [_unborne(what, field, deep, FOOT_HEIGHT, hint)]
    return []


def made_in(cell: Cell, stock: Stock, place: FloatArray) -> tuple[str, float]:
    """The obstacle in which what is made for a block at ``place`` (4, 4) would stand deepest, and how deep
    [m]."""
    shapes = () if stock.pedestal is None else with_support(cell, stock, place).support
    found = [_stands_in(transform(place @ shape.pose, corners(shape)), cell) for shape in shapes]
    return max(found, key=lambda one: one[1], default=("", 0.0))


def _stands_in(made: FloatArray, cell: Cell) -> tuple[str, float]:
    """The obstacle in which a box that stands, by its corners (8, 3), is deepest, and how deep [m]."""
    view = shapely.MultiPoint(made[:, :2]).convex_hull
    found = [("", 0.0)]
    for obstacle in cell.obstacles:
        for body in (transform(one.pose, corners(one)) for one in obstacle.shapes):
            deep = min(body[:, 2].max() - made[:, 2].min(), made[:, 2].max() - body[:, 2].min())
            if view.intersection(shapely.MultiPoint(body[:, :2]).convex_hull).area > 1e-6:
                found.append((obstacle.name, float(deep)))
    return max(found, key=lambda one: one[1])


def _unborne(what: str, field: str, value: float, limit: float, hint: str) -> Issue:
    if limit == FOOT_HEIGHT:
        what += f"; allowed are {FOOT_HEIGHT / MM:g} mm for feet"
    return Issue(
        "stock.support",
        what,
        Severity.WARNING,
        field=field,
        **measurement(value / MM, limit / MM, "mm"),
        hint=hint,
        accepted=False,
    )


def _hangs(why: str, field: str, gap: float | None) -> Issue:
    return Issue(
        "stock.hangs",
        f"the block hangs in the air: {why}; arms may go where it will be borne",
        Severity.WARNING,
        field=field,
        value=None if gap is None else gap / MM,
        limit=None if gap is None else FOOT_HEIGHT / MM,
        unit=None if gap is None else "mm",
        hint="state its support by shapes, or let Tandem make one that arms keep clear of: "
        "support: pedestal, or support: table",
        accepted=False,
    )


def _world(points: FloatArray, places: FloatArray) -> FloatArray:
    """Points (N, 3) at places (K, 4, 4), as (K, N, 3)."""
    return np.asarray(np.einsum("kij,nj->kni", places[:, :3, :3], points) + places[:, None, :3, 3])


def _at_zero(arm: Arm) -> FloatArray:
    """The base (4, 4) of an arm with the axes under it at 0."""
    return arm.at_stations(dict.fromkeys(arm.rails, 0.0)).base
