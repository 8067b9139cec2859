"""How near bodies come to each other while a track or gantry takes an arm, folded, from one station to
another, one axis after the other, or a turntable or positioner the block.

What rides moves at most by the way of its farthest point: that of the carriage, or the arc about the
axis. So a distance changes by no more than that: looks lie as far apart as the distance found leaves
room, and between two of them a bound holds.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from planner.cell import clearance, distance
from planner.cell.bodies import Solid, own_shapes
from planner.cell.plant import CellModel
from planner.cell.support import Ground
from planner.geometry.arrays import BoolArray, FloatArray, Shape, corners, transform
from planner.geometry.units import DEG
from planner.problem import (
    BLIND_SPEED,
    END,
    PLATE,
    STOCK,
    TILT,
    Arm,
    Cell,
    LinearAxis,
    Problem,
    RotaryAxis,
    Setup,
    Turntable,
    in_turn,
)

LEVEL: Final = 1e-12
"""Axes whose unit vectors' heights are off 1 by less stand upright."""
LEAST_STEP_M: Final = 1e-3
"""Looks are no nearer [m]."""
STANDING_GAP_M: Final = 5e-3
"""What a base is as near to [m] where its way begins it may stand on; so near are shapes in a bearing."""
SUNK_M: Final = 2e-3
"""What a base stands on is at most so far [m] above its foot: bodies of bases end 1 mm below some."""
LEAST_NORMAL: Final = 1e-3
"""Planes along a way are square to parts of axes that are no shorter."""
LEAST_UPRIGHT: Final = 0.5
"""A base whose own z axis is turned farther into its way, by the length of what is square to it, stands on
nothing that it could leave sliding."""
BEARING_M: Final = 0.15
"""Shapes that meet face to face in a tilt axis' bearing come as near [m] to the axis."""
TOUCHING_M: Final = 1e-6
"""What lies as far apart [m] lies in one place."""
REACH_M: Final = 0.5
"""Distances are looked for up to here [m]."""
ABB_TURN_RAD_S: Final = 45.0 * DEG
"""Highest turning [rad/s] in joint moves of RAPID programs."""
RIDERS: Final = ("stock", "support")
"""Bodies that a turntable turns."""
FLOOR: Final = "the floor"
"""What bodies that are tilted or lowered may come near to that is no body of the cell."""
LEVEL_RAD: Final = 1e-9
"""Linear axes whose unit vectors' heights are less go level."""


class Look(NamedTuple):
    """Where bodies that ride were when they were looked at: the ``value`` [m, rad] of the axis and ``poses``
    (4, 4) in the world by their names."""

    value: float
    poses: Mapping[str, FloatArray]


@dataclasses.dataclass(frozen=True)
class AxisWay:
    """The least distance [m] on a way, at the value ``at`` [m, rad] of the axis (a bound between looks),
    between which bodies, and the looks that were taken, in order. ``clear``: they went all the way, and none
    found bodies nearer than asked."""

    least: float
    at: float
    pair: tuple[str, str]
    clear: bool = False
    looked: tuple[Look, ...] = dataclasses.field(default=(), compare=False, repr=False)


class Travel(NamedTuple):
    """A way of an external axis from one value [m, rad] to another, and the time [s] that it takes."""

    begin: float
    end: float
    seconds: float


def carried(cell: Cell, name: str) -> dict[str, tuple[str, ...]]:
    """Bodies of a cell that the linear axis of a name takes along, by the names of the axes on which they
    stand: itself and those above it."""
    arm, _ = cell.rail(name)
    names = list(arm.rails)
    return {one: arm.rails[one].carries for one in names[names.index(name) :]}


def along(
    model: CellModel,
    name: str,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
    ignore: clearance.Pairs = frozenset(),
) -> AxisWay:
    """The way of the linear axis of a ``name`` among stations from one value [m] to the other; ``model`` has
    the base, and what the axes carry, where it begins, ``q`` {arm: (6,)} [rad] are all arms' joints
    meanwhile. It ends at a distance below ``enough`` [m].

    The base of the arm rides, and all that this axis and those on it carry. Pairs of bodies in ``ignore`` are
    not looked at, nor is the base against shapes on which it stands and slides (:func:`_borne`), and what is
    carried against shapes that bear it (:func:`_sliding`); against others of the same bodies they are. What
    goes up or down keeps off the floor, too; a base may stand on it."""
    arm, axis = model.cell.rail(name)
    base, foot = model.bases[arm.name], f"{arm.name}/base_link"
    above = carried(model.cell, name)
    bodies = [body for own in above.values() for body in own]
    own = [solid for solid in model.solids if solid.body in (foot, *bodies)]
    still = [f"{other}/base_link" for other in model.arms if other != arm.name]
    still += [body.name for body in model.cell.obstacles if body.name not in bodies]
    still += ["stock", "support"] if model.stock.held_by is None else []
    fixed = [solid for solid in model.solids if solid.body in still]
    feet = [solid for solid in own if solid.body == foot]
    without = np.zeros((len(own), len(fixed)), bool)
    without[[solid.body == foot for solid in own]] = _borne(model, feet, fixed, base[:3, 2], axis.axis)
    bearers = _bearers(model.cell, arm)
    bears = np.array([solid.body in bearers for solid in fixed], bool)
    carries = np.array([solid.body != foot for solid in own], bool)
    without |= _sliding(model, own, fixed, axis, ends[0]) & carries[:, None] & bears
    floor = Ground.of(model.cell).floor

    def at(value: float) -> CellModel:
        way = value - ends[0]
        goes = axis.moved(np.eye(4), way)
        moved = model.with_moved({one: goes @ model.motion(one) for one, some in above.items() if some})
        return moved.with_bases({arm.name: axis.moved(base, way)})

    def beside(placed: CellModel) -> dict[tuple[str, str], float]:
        out = _apart(placed, own, fixed, without)
        if abs(axis.axis[2]) < LEVEL_RAD:
            return out
        feet = _low(placed, own, [foot], floor)  # a base may stand on the floor, and not in it
        sunk = {pair: low for pair, low in feet.items() if low < -SUNK_M}
        return out | sunk | _low(placed, own, bodies, floor)

    return _looked(at, beside, 1.0, ends, q, enough, (foot, *bodies), ignore)


def _bearers(cell: Cell, arm: Arm) -> set[str]:
    """Bodies that what rides on the axes under an arm may slide along: those of the cell that no axis under
    another arm carries; no block, its support or another arm's base."""
    riding = {
        name for other in cell.arms if other.name != arm.name for on in other.axes for name in on.carries
    }
    return {body.name for body in cell.obstacles} - riding


def _low(
    placed: CellModel, riders: Sequence[Solid], bodies: Sequence[str], floor: float
) -> dict[tuple[str, str], float]:
    """How far [m] riders, those of ``bodies``, are above the floor."""
    out: dict[tuple[str, str], float] = {}
    poses = placed.poses({})
    for solid in (one for one in riders if one.body in bodies):
        low = float(transform(poses[solid.body][0] @ solid.shape.pose, corners(solid.shape))[:, 2].min())
        pair = (solid.body, FLOOR)
        out[pair] = min(out.get(pair, np.inf), low - floor)
    return out


def turning(
    model: CellModel,
    table: Turntable,
    name: str,
    tilt: float,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
) -> AxisWay:
    """The way of a turntable, or of one axis of a positioner by its ``name`` among stations, from one value
    [rad] to the other. ``model`` has the block, and what is tilted with it, where the way begins, with the
    tilt axis at ``tilt`` [rad]; ``q`` {arm: (6,)} [rad] are all arms' joints meanwhile. It ends at a distance
    below ``enough`` [m].

    The plate is round about the turn axis, so nothing comes nearer to it by its turning, and what it carries
    stays as far from it as it is. The tilt axis takes plate and bracket along; shapes of these are not looked
    at against the fixed ones that bear them (:func:`_bearing`), whose distance no tilt makes less; against
    all other shapes of the same bodies they are. What leans as it goes keeps off the floor, too.
    """
    pivot = table.pivot(name, tilt)
    tilts = name == TILT
    riding = (*RIDERS, *table.tilted_bodies) if tilts else RIDERS
    riders = [solid for solid in model.solids if solid.body in riding]
    still = [f"{arm}/base_link" for arm in model.arms]
    still += [body.name for body in model.cell.obstacles if body.name not in (*riding, PLATE)]
    fixed = [solid for solid in model.solids if solid.body in still]
    floor = Ground.of(model.cell).floor
    level = abs(pivot.axis[2]) > 1.0 - LEVEL

    def at(value: float) -> CellModel:
        goes = pivot.turned(np.eye(4), value - ends[0])
        moved = model.with_stock(goes @ model.stock_pose)
        return moved.with_moved({TILT: goes @ model.motion(TILT)}) if tilts else moved

    bearing = _bearing(at(0.0), riders, fixed, pivot) if tilts and riders and fixed else None

    def beside(placed: CellModel) -> dict[tuple[str, str], float]:
        out = _apart(placed, riders, fixed, bearing)
        # on a level one heights stay, and so does the way to the floor
        return out if level else out | _low(placed, riders, riding, floor)

    poses = model.poses({})
    lever = max((swing([s.shape], poses[s.body][0], pivot) for s in riders), default=0.0)
    others = sorted({solid.body for solid in model.solids} - set(riding))
    aside = frozenset(
        map(frozenset, itertools.combinations(others, 2))
    )  # the way changes nothing between them
    shaped = {solid.body for solid in riders}
    return _looked(at, beside, lever, ends, q, enough, [name for name in riding if name in shaped], aside)


def stood(model: CellModel, there: Mapping[str, float], here: Mapping[str, float]) -> CellModel:
    """The model with axes under arms and under the block at the values ``there`` [m, rad], which have the
    values ``here`` in it, by their names among stations; an axis that is in neither stays."""
    cell, table = model.cell, model.cell.turntable
    moved = model.with_moved({k: goes @ model.motion(k) for k, goes in cell.going(there, here).items()})
    for arm in cell.arms:
        base = model.bases[arm.name]
        for name, axis in arm.rails.items():
            base = axis.moved(base, there.get(name, 0.0) - here.get(name, 0.0))
        moved = moved.with_bases({arm.name: base}) if arm.axes else moved
    return moved if table is None else moved.with_stock(table.placed(model.stock_pose, there, here))


def swing(shapes: Sequence[Shape], place: FloatArray, axis: RotaryAxis) -> float:
    """How far [m] the farthest point of shapes is from an axis, with their frame at ``place`` (4, 4)."""
    far = [transform(place @ shape.pose, corners(shape)) - axis.centre for shape in shapes]
    return max((float(np.linalg.norm(np.cross(p, axis.axis), axis=1).max()) for p in far), default=0.0)


def rim(setup: Setup, place: FloatArray, table: Turntable, name: str = STOCK) -> float:
    """How far [m] what an axis under the block carries in a setup, by its ``name`` among stations, reaches
    from it, with the block at ``place`` (4, 4), where the setup's values have it."""
    stock = setup.stock
    block = (*own_shapes(setup.cell, stock)["stock"], *stock.support)
    pivot = table.pivot(name, stock.tilt or 0.0)
    tilted = [body for body in setup.cell.obstacles if name == TILT and body.name in table.tilted_bodies]
    return max(swing(block, place, pivot), *(swing(body.shapes, np.eye(4), pivot) for body in tilted), 0.0)


def travel_speeds(problem: Problem, places: Sequence[FloatArray]) -> dict[str, float]:
    """Speeds [m/s, rad/s] of axes under arms and under the block on the way to stations as programs have
    them, by their names among stations; what they carry goes at most at :data:`planner.problem.BLIND_SPEED`.
    ``places`` (4, 4) of the block in each setup. In KRL they are whole percents of the axis' own."""
    out: dict[str, float] = {}
    for arm in problem.cell.arms:
        most = {name: min(axis.speed, BLIND_SPEED) for name, axis in arm.rails.items()}
        if arm.data.family == "ABB":  # one figure of speeddata for all of them
            most = dict.fromkeys(most, min(most.values(), default=0.0))
        out |= {name: _in_percents(most[name], axis.speed, arm) for name, axis in arm.rails.items()}
    table = problem.cell.turntable
    if table is not None:
        mover = problem.cell.arm(table.arm)
        rows = list(zip(problem.setups, places, strict=False))
        if (end := problem.closing) is not None and end.stock.place is not None:
            rows.append((end, end.stock.place))
        own: dict[str, float] = {}
        for name, axis in table.axes.items():
            far = max(rim(setup, np.asarray(place), table, name) for setup, place in rows)
            own[name] = min(axis.speed, BLIND_SPEED / far)
        if mover.data.family == "ABB":  # one figure of speeddata for all of them
            own = dict.fromkeys(own, min(*own.values(), ABB_TURN_RAD_S))
        out |= {name: _in_percents(own[name], axis.speed, mover) for name, axis in table.axes.items()}
    return out


def _in_percents(most: float, own: float, mover: Arm) -> float:
    if mover.data.family != "KUKA":
        return most
    return max(1.0, float(np.floor(100.0 * most / own + 1e-9))) / 100.0 * own


def travels(problem: Problem, places: Sequence[FloatArray]) -> tuple[dict[str, Travel], ...]:
    """Ways of axes under arms and under the block before each operation, and home behind the last one, by
    their names among stations, in the order in which they go; those that stay have none. Ramps are at an
    axis' own acceleration, where one is stated."""
    if not problem.homes or not problem.operations:
        return ()
    speeds, here, out = travel_speeds(problem, places), problem.homes, list[dict[str, Travel]]()
    under, table = problem.cell.arms, problem.cell.turntable
    ramps = {name: axis.acceleration for arm in under for name, axis in arm.rails.items()}
    ramps |= {} if table is None else {name: axis.acceleration for name, axis in table.axes.items()}
    for index in range(len(problem.operations) + 1):
        there = problem.homes if index == len(problem.operations) else problem.stations.get(index, here)
        own: dict[str, Travel] = {}
        ends = {name: there.get(name, here[name]) for name in here}
        order = [name for arm in under for name in in_turn(arm.rails, here, ends)]
        for name in (*order, *(() if table is None else table.axes)):
            value = ends[name]
            way = abs(value - here[name])
            if way > 0.0:
                ramp = ramps[name]
                top = min(speeds[name], float(np.sqrt(way * ramp)))
                own[name] = Travel(here[name], value, way / top + top / ramp)
        out.append(own)
        here = {name: there.get(f"{name}{END}", there.get(name, here[name])) for name in here}
    return tuple(out)


def _looked(
    at: Callable[[float], CellModel],
    beside: Callable[[CellModel], Mapping[tuple[str, str], float]],
    lever: float,
    ends: tuple[float, float],
    q: Mapping[str, FloatArray],
    enough: float,
    riding: Sequence[str],
    ignore: clearance.Pairs = frozenset(),
) -> AxisWay:
    """Looks along a way: ``at`` gives the cell at a value, ``beside`` distances [m] of what rides to what is
    fixed, as two bodies of which neither has joints; ``lever`` [m, m/rad] is the way of the farthest point by
    a value of 1; bodies that ride; pairs to ``ignore``."""
    begin, end = ends
    rows = {name: np.asarray(joints)[None] for name, joints in q.items()}
    sense, length = float(np.sign(end - begin)), lever * abs(end - begin)
    worst = AxisWay(REACH_M, begin, ("", ""))
    gone, before, step, seen = 0.0, np.inf, 0.0, list[Look]()
    while True:
        value = begin + sense * (gone / lever if lever > 0.0 else 0.0)
        placed = at(value)
        found = clearance.least(placed, rows, REACH_M, ignore)
        gap, pair = float(found.distance[0]), found.pair[0]
        for two, other in beside(placed).items():
            if other < gap:
                gap, pair = other, two
        poses = placed.poses({})
        seen.append(Look(value, {name: poses[name][0] for name in riding}))
        bound = min(gap, 0.5 * (before + gap - step)) if np.isfinite(before) else gap
        if bound < worst.least:
            worst = AxisWay(bound, value, pair)
        if gone >= length or gap < enough:
            return dataclasses.replace(worst, clear=gap >= enough, looked=tuple(seen))
        step = min(max(gap - enough, LEAST_STEP_M), length - gone)
        gone, before = gone + step, gap


def _apart(
    model: CellModel, riders: list[Solid], fixed: list[Solid], without: BoolArray | None
) -> dict[tuple[str, str], float]:
    """Distances [m], at most 0 where they overlap, between solids of the block and fixed ones, by bodies;
    pairs (R, F) ``without`` count for nothing."""
    out: dict[tuple[str, str], float] = {}
    if not riders or not fixed:
        return out
    gaps = _gaps(model, riders, fixed)
    for i, j in zip(*np.nonzero(np.ones_like(gaps, bool) if without is None else ~without), strict=True):
        pair = (riders[i].body, fixed[j].body)
        out[pair] = min(out.get(pair, np.inf), float(gaps[i, j]))
    return out


def _placed(model: CellModel, solids: Sequence[Solid]) -> FloatArray:
    """Poses (S, 4, 4) in the world of solids of bodies that no joint moves."""
    poses = model.poses({})
    return np.stack([poses[one.body][0] @ one.shape.pose for one in solids])


def _gaps(
    model: CellModel, riders: list[Solid], fixed: list[Solid], gone: FloatArray | None = None
) -> FloatArray:
    """Distances (R, F) [m], at most 0 where they overlap, between solids, with riders ``gone`` (3,) [m] from
    where ``model`` has them."""
    both = [*riders, *fixed]
    placed = _placed(model, both)
    if gone is not None:
        placed[: len(riders), :3, 3] += gone
    first, second = (v.ravel() for v in np.indices((len(riders), len(fixed))))
    second = second + len(riders)
    gaps, _, _ = distance.distances(distance.cores(both), first, second, placed[first], placed[second])
    return gaps.reshape(len(riders), len(fixed))


def _extents(kinds: distance.Cores, placed: FloatArray, direction: FloatArray) -> FloatArray:
    """How far (2, S) [m] solids at poses (S, 4, 4) go back and forth along a unit vector (3,), from 0."""
    every, ends = np.arange(len(placed)), []
    for sense in (-1.0, 1.0):
        ray = np.broadcast_to(sense * direction, (len(placed), 3))
        far = kinds.support(every, np.einsum("sc,scd->sd", ray, placed[:, :3, :3]))
        tips = np.einsum("scd,sd->sc", placed[:, :3, :3], far) + placed[:, :3, 3]
        ends.append(tips @ direction + sense * kinds.rounding)
    return np.stack(ends)


def _borne(
    model: CellModel, own: list[Solid], fixed: list[Solid], upright: FloatArray, direction: FloatArray
) -> BoolArray:
    """On which fixed shapes (F,) a base, of solids ``own``, stands and slides, where ``model`` has it; its z
    axis is ``upright`` (3,). Those are shapes of obstacles to one of whose shapes it is nearer than
    :data:`STANDING_GAP_M`, and which end below its foot: below a plane along the way, so that it comes no
    nearer to them wherever it goes. What is higher by more than :data:`SUNK_M` is looked at: a box on a
    rail, and a mesh, which stands for its hull, of both."""
    up = upright - (upright @ direction) * direction
    length = float(np.linalg.norm(up))
    if not own or not fixed or length < LEAST_UPRIGHT:
        return np.zeros(len(fixed), bool)
    both = [*own, *fixed]
    low, high = _extents(distance.cores(both), _placed(model, both), up / length)
    under = high[len(own) :] < low[: len(own)].min() + SUNK_M
    near = _gaps(model, own, fixed).min(axis=0) < STANDING_GAP_M
    bodies = {fixed[j].body for j in np.flatnonzero(under & near)}
    bodies &= {body.name for body in model.cell.obstacles}
    return np.asarray(under & np.array([solid.body in bodies for solid in fixed]))


def _sliding(
    model: CellModel, riders: list[Solid], fixed: list[Solid], axis: LinearAxis, value: float
) -> BoolArray:
    """Which fixed shapes riders slide along (R, F) on an axis, by how they stand where ``model`` has them, at
    a ``value`` [m] of it: less than :data:`STANDING_GAP_M` apart over all of its range, with a plane along
    the way between them, which both keep to their sides of wherever the axis goes. Both shapes are convex, so
    what is as near at both ends of the range is so between. Planes are looked for square to the axes of both
    shapes, and between the way and these. Boxes that overlap are looked at, and so is what stands in the way,
    as an end stop, and what the axis leaves behind, as a post beside the way."""
    out = np.zeros((len(riders), len(fixed)), bool)
    if not riders or not fixed:
        return out
    both, direction = [*riders, *fixed], axis.axis
    kinds, placed = distance.cores(both), _placed(model, both)
    near = np.ones_like(out)
    for end in (axis.low, axis.high):
        near &= _gaps(model, riders, fixed, (end - value) * direction) < STANDING_GAP_M
    for i, j in zip(*np.nonzero(near), strict=True):
        two = [int(i), len(riders) + int(j)]
        own = np.concatenate([placed[k, :3, :3].T for k in two])
        for normal in (*(own - (own @ direction)[:, None] * direction), *np.cross(direction, own)):
            length = float(np.linalg.norm(normal))
            if length > LEAST_NORMAL:
                low, high = _extents(kinds, placed, normal / length)
                past = max(low[two[1]] - high[two[0]], low[two[0]] - high[two[1]])
                out[i, j] |= past > -TOUCHING_M
    return out


def _bearing(model: CellModel, riders: list[Solid], fixed: list[Solid], axis: RotaryAxis) -> BoolArray:
    """Which shapes of plate and bracket, of riders, fixed ones bear (R, F), by how they stand with the tilt
    at 0, where ``model`` has them: less than :data:`STANDING_GAP_M` apart, and of a kind that the tilt cannot
    bring nearer. One of the two is round about the tilt axis, as a shaft or its seat; or the fixed one begins
    along the axis where the other ends, they are no farther apart than these ends, and both come within
    :data:`BEARING_M` of the axis, as a cradle before its posts: turned, the faces slide past each other.
    Anything else is looked at: a column beside the bracket, a box that a fixed one overlaps, and a bar above
    the end of a post that the tilt lowers beside it."""
    both = [*riders, *fixed]
    kinds, placed = distance.cores(both), _placed(model, both)
    every = np.arange(len(both))
    low, high = _extents(kinds, placed, axis.axis) - axis.centre @ axis.axis
    own, other = slice(len(riders)), slice(len(riders), None)
    past = np.maximum(low[other] - high[own, None], low[own, None] - high[other])

    line = np.eye(4)  # the axis, as far as shapes lie along it
    line[:3, 3] = axis.centre + 0.5 * (low.min() + high.max()) * axis.axis
    line[:3, :3] = np.linalg.svd(axis.axis[None])[2].T[:, [1, 2, 0]]
    rod = Solid("", Shape("capsule", (TOUCHING_M, float(high.max() - low.min())), np.eye(4)))
    rods = np.broadcast_to(line, placed.shape)
    last = np.full(len(both), len(both))
    off = distance.distances(distance.cores([*both, rod]), every, last, placed, rods)[0]
    near = off < BEARING_M

    aside = np.cross(placed[:, :3, 3] - axis.centre, axis.axis)
    skew = np.linalg.norm(np.cross(placed[:, :3, 2], axis.axis), axis=1)
    ball = np.array([one.shape.kind == "sphere" for one in both])
    rod_like = np.array([one.shape.kind in ("cylinder", "capsule") for one in both])
    round_about = (ball | rod_like & (skew < TOUCHING_M)) & (np.linalg.norm(aside, axis=1) < TOUCHING_M)

    gaps = _gaps(model, riders, fixed)
    slides = (past > -TOUCHING_M) & (gaps < past + TOUCHING_M) & near[own, None] & near[other]
    turns = round_about[own, None] | round_about[other]
    tilted = np.array([one.body not in RIDERS for one in riders])[:, None]
    return np.asarray(tilted & (gaps < STANDING_GAP_M) & (slides | turns))
