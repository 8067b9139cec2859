"""What a block stands on: the floor, a body of the cell, the support that is stated, or a table or pedestal
that is made for it as high as its place wants it."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.geometry.rigid import transform
from planner.geometry.shapes import Shape, corners
from planner.issues import Issue, Severity
from planner.problem import Cell, Problem, Setup, Stock
from planner.units import MM

FloatArray = NDArray[np.float64]

FEET: Final = 0.025
"""[m] what feet, shims and clamps may be between two bodies of which one stands on the other."""
LEVEL: Final = np.cos(np.deg2rad(1.0))
"""A block whose side is level by so much stands on it."""


@dataclasses.dataclass(frozen=True)
class Ground:
    """What bears others in a cell: the floor at ``floor`` [m], and ``boxes`` (K, 2, 3) [m] around the shapes
    of obstacles, whose ``names`` (K,) these are."""

    floor: float
    boxes: FloatArray
    names: tuple[str, ...]

    @staticmethod
    def of(cell: Cell) -> Ground:
        """The ground of a cell: its floor is level with the lowest base that stands upright, at most at 0."""
        upright = [float(arm.base[2, 3]) for arm in cell.arms if arm.base[2, 2] > 0.5]
        boxes = [np.zeros((0, 2, 3))]
        names = []
        for obstacle in cell.obstacles:
            for shape in obstacle.shapes:
                points = transform(shape.pose, corners(shape))
                boxes.append(np.stack([points.min(axis=0), points.max(axis=0)])[None])
                names.append(obstacle.name)
        return Ground(min([0.0, *upright]), np.concatenate(boxes), tuple(names))

    def below(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, NDArray[np.intp]]:
        """How far (K,) [m] boxes from ``low`` to ``high`` (K, 3) are above what is below them, 0 or less
        where they stand in it, and which obstacle's shape that is, -1 for the floor."""
        gap = low[:, 2] - self.floor
        what = np.full(len(low), -1, dtype=np.intp)
        for k, (first, last) in enumerate(self.boxes):
            over = (low[:, :2] <= last[:2]).all(axis=1) & (high[:, :2] >= first[:2]).all(axis=1)
            near = low[:, 2] - last[2]
            taken = over & (low[:, 2] >= first[2] - FEET) & (near < gap)
            gap, what = np.where(taken, near, gap), np.where(taken, k, what)
        return gap, what


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


def with_support(cell: Cell, stock: Stock, place: FloatArray) -> Stock:
    """The stock with the table or pedestal that is made for it at ``place`` (4, 4) as its support: a box of a
    size in stock, in the middle under the block; none where the block stands on the floor or leans."""
    wanted = stock.pedestal
    if wanted is None or stock.held_by is not None:
        return stock
    height = float(underside(stock, place[None])[0]) - Ground.of(cell).floor
    up = place[2, :3]  # in the stock frame
    axis = int(np.argmax(np.abs(up)))
    if height <= FEET or abs(up[axis]) < LEVEL:
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


def told(cell: Cell, stock: Stock, place: FloatArray) -> str:
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
            "which stands on what is below it" if gap <= FEET else f"which ends {gap / MM:.0f} mm in the air"
        )
        return f"the support that the problem states, {foot}"
    gap, what = (v[0] for v in ground.below(world.min(axis=0)[None], world.max(axis=0)[None]))
    if gap > FEET:
        return f"nothing that is stated; it hangs {gap / MM:.0f} mm above what is below it"
    return "the floor" if what < 0 else f"the body {ground.names[what]} of the cell"


def issues(problem: Problem) -> list[Issue]:
    """What is wrong with how the blocks of a problem stand, as far as it is known before their places are."""
    out: list[Issue] = []
    for setup in problem.setups:
        stock = setup.stock
        if stock.held_by is not None or stock.sheet is not None:
            continue
        field = f"operations.{setup.operations[0]}.setup.support" if setup.number > 1 else "stock.support"
        out += _setup(setup, field)
    return out


def _setup(setup: Setup, field: str) -> list[Issue]:
    stock, cell = setup.stock, setup.cell
    if stock.pedestal is not None:
        up = stock.attitude[2] if stock.place is None else stock.place[2, :3]
        if np.abs(up).max() >= LEVEL:
            return []
        what = (
            f"{field}: a block that leans stands on no {stock.pedestal.kind}; state the shapes of its support"
        )
        return [Issue("problem.field", what, field=field)]
    if stock.place is None:
        if stock.support or (stock.pedestal is None and _bears(cell)):
            return []
        return [_hangs("its place is searched, and nothing is stated that it stands on", field, None)]
    gap = float(air(Ground.of(cell), stock, stock.place[None])[0])
    if not stock.support:
        return [] if gap <= FEET else [_hangs(f"it is {gap / MM:.0f} mm above what is below it", field, gap)]
    out = []
    head = max(
        float(transform(stock.place @ shape.pose, corners(shape))[:, 2].max()) for shape in stock.support
    )
    hang = float(underside(stock, stock.place[None])[0]) - head
    for off, what in (
        (gap, "the support under the block ends {} mm above what is below it"),
        (hang, "the block hangs {} mm above its support"),
    ):
        if off > FEET:
            out.append(
                Issue(
                    "stock.support",
                    f"{what.format(f'{off / MM:.0f}')}; allowed are {FEET / MM:g} mm for feet",
                    Severity.WARNING,
                    field=field,
                    value=off / MM,
                    limit=FEET / MM,
                    unit="mm",
                    hint="make it longer, put what it stands on among the cell's obstacles, or let Tandem "
                    "make one: support: pedestal",
                    accepted=False,
                )
            )
    return out


def _bears(cell: Cell) -> bool:
    """Whether something in the cell but the floor might bear a block."""
    ground = Ground.of(cell)
    return bool((ground.boxes[:, 1, 2] > ground.floor + FEET).any())


def _hangs(why: str, field: str, gap: float | None) -> Issue:
    return Issue(
        "stock.hangs",
        f"the block hangs in the air: {why}; arms may go where it will be borne",
        Severity.WARNING,
        field=field,
        value=None if gap is None else gap / MM,
        limit=None if gap is None else FEET / MM,
        unit=None if gap is None else "mm",
        hint="state its support by shapes, or let Tandem make one that arms keep clear of: "
        "support: pedestal, or support: table",
    )


def _world(points: FloatArray, places: FloatArray) -> FloatArray:
    """Points (N, 3) at places (K, 4, 4), as (K, N, 3)."""
    return np.asarray(np.einsum("kij,nj->kni", places[:, :3, :3], points) + places[:, None, :3, 3])
