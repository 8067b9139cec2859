"""Where arms on tracks and gantries, or the block on a turntable, stand in each operation: they go there
before it, and the work is done standing. A track that goes along (:mod:`planner.motion.following`) stands
there before the first target; what is chosen is its law's offset, the best first.

Values of an axis are a grid over its range. What stood somewhere before stays if the work is as good there;
else it goes the least way to where the margin is. The first place with a path that is free is taken."""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell import axis_way, plant, support
from planner.cell.axis_way import AxisWay
from planner.geometry.arrays import FloatArray, corners, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.motion import diagnosis, following, own_clearance
from planner.motion.place_margin import margin
from planner.motion.planning_scene import Scene
from planner.motion.search.ladder_search import Found
from planner.motion.search.path_search import find_path, with_aims
from planner.motion.search.subsampling import few_of
from planner.problem import (
    AXES_WRITTEN,
    END,
    STOCK,
    TILT,
    LinearAxis,
    Problem,
    RotaryAxis,
    Setup,
    Turntable,
    any_base,
    any_lean,
    in_turn,
)
from planner.targets import Targets

STEP_M: Final = 0.1
"""Values of a linear axis are so far apart [m],"""
MOST_VALUES: Final = 201
"""at most so many,"""
MOST_PLACES: Final = 1500
"""and of a gantry at most so many places; where these are too few, values are farther apart"""
COARSER: Final = 1.25
"""by steps of this factor."""
STEP_RAD: Final = 5.0 * DEG
"""Values of a turntable are so far apart [rad],"""
MOST_ANGLES: Final = 721
"""at most so many,"""
MOST_TURNS, MOST_TILTS = 73, 19
"""of a positioner's axes,"""
ANGLE_DECIMALS: Final = 1
"""in degrees with so many decimals."""
FEW_TARGETS: Final = 24
"""Targets at which values are judged;"""
FIRST_FEW: Final = 4
"""so many of them by a first look, which asks for more where no value that they speak for will do."""
GOOD_SHARE: Final = 0.6
"""Values with this share of the best margin are good: of them the nearest comes first."""
MOST_PATHS: Final = 8
"""Values for which a path is searched at most, for each axis of a unit."""
APART_M: Final = 0.2
"""These are so far [m] apart,"""
APART_RAD: Final = 10.0 * DEG
"""or so far [rad]."""
NO_PATH: Final = "bodies or joints leave no path there"
BASE_GOES: Final = "as the base goes along"
"""Begins what is said of a base that comes too near to bodies where it rides."""
SUNK: Final = f"goes below {axis_way.FLOOR}"
MORE_POSES: Final = "state more poses between those that are far apart"
"""A remedy for joints that turn far from one target to the next."""
WAY_ROOM_M: Final = 1e-3
"""Bodies keep so much more [m] than their clearance on the way from one to the next."""


@dataclasses.dataclass(frozen=True)
class _Rails:
    """The track or gantry of an arm, as an axis among others."""

    name: str
    rails: Mapping[str, LinearAxis]
    scale: float = MM
    sign: str = "mm"
    apart: float = APART_M

    @property
    def track(self) -> LinearAxis:
        """The axis on the floor: that of a track."""
        return next(iter(self.rails.values()))

    @property
    def unit(self) -> str:
        return " and ".join(dict.fromkeys(axis.unit for axis in self.rails.values()))

    @property
    def what(self) -> str:
        return f"arm {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values among stations."""
        return tuple(self.rails)

    @property
    def words(self) -> str:
        """What its values are called, in order."""
        return ", ".join(axis.word for axis in self.rails.values())

    @property
    def ranges(self) -> str:
        spans = (f"{axis.word} {axis.low / MM:g} to {axis.high / MM:g}" for axis in self.rails.values())
        return ", ".join(span.strip() for span in spans)

    def values(self) -> FloatArray:
        """Values (K, A) at which it may stand."""
        step = STEP_M
        while True:
            grids = [values(axis, step) for axis in self.rails.values()]
            if len(grids) == 1 or np.prod([len(grid) for grid in grids]) <= MOST_PLACES:
                every = np.meshgrid(*grids, indexing="ij")
                return np.stack([one.ravel() for one in every], axis=1)
            step *= COARSER

    def placed(
        self, problem: Problem, setup: Setup, grid: FloatArray
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Places of the block (K, 1, 4, 4) and bases for values (K, A)."""
        base = problem.cell.arm(self.name).base
        bases = np.tile(base, (len(grid), 1, 1, 1))
        bases[:, 0, :3, 3] += grid @ np.stack([axis.axis for axis in self.rails.values()])
        return np.tile(_place(setup), (len(grid), 1, 1, 1)), {self.name: bases}

    def way(
        self, setup: Setup, here: Mapping[str, float], there: Mapping[str, float], enough: float
    ) -> AxisWay:
        """The way of one axis after the other, to where the first one comes too near to anything."""
        model, at = _model(setup), {name: here[name] for name in self.names}
        within = own_clearance.own_pairs(model)  # a way of the base changes nothing within an arm
        way = AxisWay(axis_way.REACH_M, 0.0, ("", ""), clear=True)
        for name in in_turn(self.rails, here, there):
            ends = (at[name], there[name])
            way = axis_way.along(model, name, ends, _homes(setup), enough, within)
            if not way.clear:
                return way
            gone = {**at, name: there[name]}
            model, at = axis_way.stood(model, gone, at), gone
        return way


@dataclasses.dataclass(frozen=True)
class _Table:
    """The turntable or positioner of a cell, as an axis among others."""

    track: Turntable
    name: str = STOCK
    scale: float = DEG
    sign: str = "deg"
    apart: float = APART_RAD

    @property
    def unit(self) -> str:
        return self.track.unit

    @property
    def what(self) -> str:
        return "the block"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values among stations."""
        return tuple(self.track.axes)

    @property
    def words(self) -> str:
        """What its values are called, in order."""
        return " and ".join(axis.word for axis in self.track.axes.values())

    @property
    def ranges(self) -> str:
        spans = (
            f"{axis.word} {axis.low / DEG:g} to {axis.high / DEG:g}" for axis in self.track.axes.values()
        )
        return ", ".join(spans).strip()

    def values(self) -> FloatArray:
        """Values (K, A) at which it may stand: of the turn, and with it of the tilt."""
        if self.track.tilt is None:
            return angles(self.track)[:, None]
        both = np.meshgrid(angles(self.track, MOST_TURNS), angles(self.track.tilt, MOST_TILTS), indexing="ij")
        return np.stack([one.ravel() for one in both], axis=1)

    def placed(
        self, problem: Problem, setup: Setup, grid: FloatArray
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Places of the block (K, 1, 4, 4) for values (K, A), and no bases."""
        place, here = _place(setup), setup.stock.stands
        return self.track.placed(place, dict(zip(self.names, grid.T, strict=True)), here)[:, None], {}

    def way(
        self, setup: Setup, here: Mapping[str, float], there: Mapping[str, float], enough: float
    ) -> AxisWay:
        """The way of one axis after the other, to where the first one comes too near to anything."""
        model, at = _model(setup), {name: here[name] for name in self.names}
        way = AxisWay(axis_way.REACH_M, 0.0, ("", ""), clear=True)
        for name in self.names:
            if there[name] != at[name]:
                ends = (at[name], there[name])
                tilt = at.get(TILT, 0.0)
                way = axis_way.turning(model, self.track, name, tilt, ends, _homes(setup), enough)
                if not way.clear:
                    return way
                gone = {**at, name: there[name]}
                model, at = axis_way.stood(model, gone, at), gone
        return way


_Axis = _Rails | _Table


Passes = Callable[[Scene, Targets, int], bool]
"""Whether the targets of an operation, by its index, can be worked at where all stands in the scene."""


def stationed(
    problem: Problem, targets: Sequence[Targets], passes: Passes | None = None
) -> tuple[Problem, tuple[Targets, ...]]:
    """The problem with a station of each arm on axes, and of the block on a turntable, in each operation,
    and the targets with the values of tracks that go along; where an axis can stand says ``passes``, which
    asks for no way there, by default whether there is a way there and a path. Raises :class:`TandemError`
    (``motion.station``) where there is none, with the operation, and ``problem.track`` for a block whose
    place is not stated, and for tools that slide along a track that goes along."""
    axes: dict[str, _Axis] = {arm.name: _Rails(arm.name, arm.rails) for arm in problem.cell.arms if arm.axes}
    if problem.cell.turntable is not None:
        axes[STOCK] = _Table(problem.cell.turntable)
    if not axes:
        return problem, tuple(targets)
    if problem.stock.place is None or any(setup.stock.place is None for setup in problem.setups):
        what = "an arm stands on a track or gantry and the block's place is searched; both together "
        what += "are not written "
        raise refusal("problem.track", f"{what}yet; state stock.place", field="stock.place")
    at = problem.homes
    out: dict[int, dict[str, float]] = {}
    riding: list[Targets] = []
    for index, own in enumerate(targets):
        going = [axes[name] for name in axes if name in (*own.arms, STOCK)]  # as programs move them
        found = _Stood(at, own)
        if going:
            found = _placed(
                _StationSearch(problem.stationed({**out, index: at}), index, own, at, passes), going
            )
        gone = {name: float(values[-1]) for name, values in found.targets.ride.items()}
        out[index] = {**found.at, **{f"{name}{END}": value for name, value in gone.items()}}
        at = {**found.at, **gone}
        riding.append(found.targets)
    made = problem.stationed(out)
    if passes is None:
        _check_way_home(made, axes, at)
    return made, tuple(riding)


def _check_way_home(problem: Problem, axes: Mapping[str, _Axis], at: Mapping[str, float]) -> None:
    """Raise an issue (``motion.station``) where axes cannot go home behind the last operation."""
    index = len(problem.operations) - 1
    enough = problem.settings.clearance + WAY_ROOM_M
    homes = problem.homes
    own = problem.stations.get(index, {})
    stands = {name: value for name, value in own.items() if not name.endswith(END)}
    for axis in axes.values():
        if all(at[name] == homes[name] for name in axis.names):
            continue
        setup = problem.stationed({**problem.stations, index: {**stands, **at}}).setup_of(index)
        way = axis.way(setup, at, homes, enough)
        at = {**at, **{name: homes[name] for name in axis.names}}
        if not way.clear:
            what = f"operation {problem.operations[index].name}: on the way of {axis.unit} home behind it "
            what += _near(way)
            hint = "take what is there away, or let the axis have its home on the other side of it"
            field = f"operations.{index}"
            raise refusal("motion.station", what, hint=hint, field=field)


def values(track: LinearAxis, step: float = STEP_M) -> FloatArray:
    """The values (K,) [m] at which a linear axis may stand, whole tenths of a millimetre, ``step`` [m] apart
    at most; 0 has no sign."""
    count = min(max(int(np.ceil((track.high - track.low) / step)) + 1, 2), MOST_VALUES)
    return np.unique(np.append(np.round(np.linspace(track.low, track.high, count), 4), track.home) + 0.0)


def angles(table: RotaryAxis, most: int = MOST_ANGLES) -> FloatArray:
    """The values (K,) [rad] at which an axis under the block may stand, whole tenths of a degree within its
    range, about its home, about ``most`` of them at most."""
    step = max(STEP_RAD / DEG, np.ceil((table.high - table.low) / DEG / (most - 1)))
    low, high, home = (value / DEG for value in (table.low, table.high, table.home))
    steps = np.arange(np.ceil((low - home) / step - 1e-9), np.floor((high - home) / step + 1e-9) + 1.0)
    grid = np.round(home + step * steps, ANGLE_DECIMALS)
    grid = np.append(grid[(grid >= low) & (grid <= high)], round(home, 4))
    return np.asarray(np.unique(grid) * DEG)


def _place(setup: Setup) -> FloatArray:
    return setup.stock.place if setup.stock.place is not None else np.eye(4)


def _model(setup: Setup) -> plant.CellModel:
    return plant.build(setup.cell, setup.stock, _place(setup))


def _homes(setup: Setup) -> dict[str, FloatArray]:
    return {arm.name: arm.home for arm in setup.cell.arms}


@dataclasses.dataclass(frozen=True)
class _StationSearch:
    """The search for values of axes of one operation.

    Attributes:
        problem: The problem, with all axes ``at`` their values.
        index: Index of the operation.
        targets: Targets of the operation.
        at: Values [m, rad] of all axes by name. Axes move to new values one after the other.
        passes: A quick test of a scene that replaces the search of a path, or None.
    """

    problem: Problem
    index: int
    targets: Targets
    at: Mapping[str, float]
    passes: Passes | None

    def setup(self) -> Setup:
        """The setup of the operation."""
        return self.problem.setup_of(self.index)

    def with_axes_at(self, at: Mapping[str, float]) -> "_StationSearch":
        """Return this search with all axes ``at`` other values."""
        problem = self.problem.stationed({**self.problem.stations, self.index: at})
        return dataclasses.replace(self, problem=problem, at=at)

    def aimed(self, value: Mapping[str, float]) -> tuple[Scene, Targets]:
        """The scene, and the targets, where an axis stands at a value and all others at theirs."""
        problem = self.with_axes_at({**self.at, **value}).problem
        scene = _scene(problem, self.index, self.targets, _model(problem.setup_of(self.index)))
        return scene, with_aims(scene, self.targets)


@dataclasses.dataclass(frozen=True)
class _Stood:
    """Where all axes stand ``at`` before the first target, and the targets with the values of tracks that go
    along."""

    at: Mapping[str, float]
    targets: Targets


def _placed(work: _StationSearch, axes: Sequence[_Axis]) -> _Stood:
    """Where ``axes``, which go there one after the other, have a path of the operation; raises
    ``TandemError`` where there is none. Each is judged by the arms that are placed by then, and by whether
    those behind it have places, too."""
    axis, *rest = axes
    follows = isinstance(axis, _Rails) and axis.track.follow is not None
    return (_followed if follows else _station)(work, axis, rest)


def _station(work: _StationSearch, axis: _Axis, rest: Sequence[_Axis]) -> _Stood:
    problem, index, targets = work.problem, work.index, work.targets
    setup = work.setup()
    grid = axis.values()
    placed = axis.placed(problem, setup, grid)
    before = np.array([work.at[name] for name in axis.names])
    most = FEW_TARGETS // len(axis.names)  # a positioner has many more values
    aimed = with_aims(_scene(problem, index, targets), targets)
    for count in (most,) if work.passes is None else (FIRST_FEW, most):
        few = few_of(setup.cell, aimed, count, False)
        score = margin(few, *placed, problem.settings, _judged(targets, rest))
        tried: list[FloatArray] = []
        first: str | Issue = ""
        for k in _order(grid, score, before, axis.apart):
            if len(tried) >= MOST_PATHS * len(axis.names):
                break
            near = any(np.abs(grid[k] - other).max() < axis.apart for other in tried)
            if near and (grid[k] != before).any():
                continue
            tried.append(grid[k])
            found = _try(work, axis, rest, _named(axis, grid[k]))
            if isinstance(found, _Stood):
                return found
            first = first or found  # of the value that was thought best
    if isinstance(first, Issue):
        raise TandemError(first)
    if first == NO_PATH:
        first = _in_the_way(*work.aimed(_named(axis, tried[0])))
    raise TandemError(_nowhere(work, axis, grid, score, tried, first))


def _try(
    work: _StationSearch, axis: _Axis, rest: Sequence[_Axis], value: Mapping[str, float]
) -> _Stood | Issue | str:
    """Where axes stand with ``axis`` at a value; else what comes too near on its way there, why there is no
    place for the ``rest``, or that there is no path."""
    if any(value[name] != work.at[name] for name in axis.names) and work.passes is None:
        enough = work.problem.settings.clearance + WAY_ROOM_M
        way = axis.way(work.setup(), work.at, value, enough)
        if not way.clear:
            return f"on the way there {_near(way)}"
    here = {**work.at, **value}
    if rest:
        try:
            return _placed(work.with_axes_at(here), rest)
        except TandemError as error:
            return error.issues[0]
    scene, own = work.aimed(value)
    passes = work.passes
    free = isinstance(find_path(scene, own)[1], Found) if passes is None else passes(scene, own, work.index)
    return _Stood(here, work.targets) if free else NO_PATH


def _judged(targets: Targets, rest: Sequence[_Axis]) -> tuple[str, ...]:
    """The arms of targets that stand where they are to work, when only the axes of ``rest`` do not."""
    return tuple(arm for arm in targets.arms if all(axis.name != arm for axis in rest))


def _followed(work: _StationSearch, axis: _Axis, rest: Sequence[_Axis]) -> _Stood:
    """The values of a track that goes along in an operation, with which there is a way to the first one and a
    path."""
    problem, index, targets = work.problem, work.index, work.targets
    scene, name = _scene(problem, index, targets), problem.operations[index].name
    slides = following.slides(scene, targets, axis.name)
    if slides > following.MOST_SLIDE_M:
        what = f"operation {name}: its freedoms let the tool slide by up to {slides / MM:.1f} mm along "
        what += f"{axis.unit}, which goes along by nominal poses; allowed are "
        what += f"{following.MOST_SLIDE_M / MM:g} mm; leave them out, or take follow out of the track"
        raise refusal("problem.track", what, arm=axis.name, field=f"operations.{index}")
    kept: list[_Stood] = []
    others: list[Issue] = []

    def fault(riding: Targets) -> str:
        values = riding.ride[axis.name]
        start, own = {axis.name: float(values[0])}, dataclasses.replace(work, targets=riding)
        found = _try(own, axis, rest, start)
        if found == NO_PATH:
            return _in_the_way(*own.aimed(start))
        if isinstance(found, str):
            return found
        if isinstance(found, Issue):
            others.append(found)
            return found.message
        kept.append(found)
        return "" if work.passes is not None else _base_fault(work, axis, found.at, values)

    cell, judged = work.setup().cell, _judged(targets, rest)
    found = following.chosen(scene, cell, targets, axis.name, judged, fault)
    if not isinstance(found, following.Unreached):
        return kept[-1]
    if others:
        raise TandemError(others[0])
    from_to = f"{found.best[0] / MM:g} to {found.best[-1] / MM:g} mm"
    what = f"operation {name}: {axis.what} reaches not all of it while {axis.unit} goes along, within "
    what += f"{axis.ranges} mm; from {from_to} it reaches most"
    if found.tried:
        what = f"operation {name}: there is no path while {axis.unit} goes along; tried {found.tried} laws, "
        what += f"at the best, from {from_to}: {found.fault}"
    hint = "make the track longer or put it nearer to the work, split the operation, or let the track stand "
    hint += "(take follow out)"
    if found.tried:
        if found.fault.endswith(SUNK):
            first = "put the base higher, or narrow range_mm to where it stands on or above the floor"
        elif found.fault.startswith(BASE_GOES):
            first = "clear away what is in the way, or narrow range_mm to where the base is clear"
        else:
            first = f"clear away what is in the way, or {MORE_POSES}"
        hint = f"{first}; or {hint}"
    raise refusal("motion.station", what, arm=axis.name, hint=hint, field=f"operations.{index}")


def _base_fault(work: _StationSearch, axis: _Axis, at: Mapping[str, float], values: FloatArray) -> str:
    """What the base itself comes too near to while it goes along with ``values`` (N,) [m]; the rest of the
    arm is looked at as it works."""
    low, high = float(values.min()), float(values.max())
    setup = work.with_axes_at({**at, axis.name: low}).setup()
    model = _model(setup)
    bodies = sorted({solid.body for solid in model.solids})
    aside = frozenset(map(frozenset, itertools.combinations(bodies, 2)))
    enough = work.problem.settings.clearance + WAY_ROOM_M
    way = axis_way.along(model, axis.name, (low, high), _homes(setup), enough, aside)
    if way.clear:
        return ""
    said = f"{BASE_GOES} {_near(way)}"
    return said if said.endswith(SUNK) else f"{said}, allowed are {enough / MM:g} mm at least"


def _named(axis: _Axis, row: FloatArray) -> dict[str, float]:
    """Values (A,) of an axis by their names among stations."""
    return dict(zip(axis.names, row.tolist(), strict=True))


def _order(grid: FloatArray, score: FloatArray, before: FloatArray, near_by: float) -> list[int]:
    """Values (K, A) with a margin: the good ones by their way from ``before`` (A,), then the others, best
    first. Of the values of several axes there are many within ``near_by`` of each other, so the nearest and
    those farthest from what comes before take turns."""
    reached = np.flatnonzero(score > 0.0)
    if not len(reached):
        return []
    good = score >= GOOD_SHARE * score.max()
    far = np.abs(grid - before).sum(axis=1)
    near = sorted((k for k in reached if good[k]), key=lambda k: (far[k], -score[k]))
    rest = sorted((k for k in reached if not good[k]), key=lambda k: -score[k])
    ordered = [*near, *rest]
    if grid.shape[1] == 1:
        return [int(k) for k in ordered]
    out: list[int] = []
    while ordered and len(out) < MOST_PATHS * grid.shape[1]:
        k = ordered[0]
        if len(out) % 2:
            apart = np.abs(grid[ordered][:, None] - grid[out]).max(axis=2).min(axis=1)
            k = ordered[int(np.argmax(apart))]
        out.append(int(k))
        ordered = [one for one in ordered if np.abs(grid[one] - grid[k]).max() >= near_by]
    return out


def _scene(problem: Problem, index: int, targets: Targets, model: plant.CellModel | None = None) -> Scene:
    setup = problem.setup_of(index)
    return Scene.of(setup.cell, targets.arms, _place(setup), problem.settings, model)


def _near(way: AxisWay) -> str:
    """Which bodies come too near on a way, and what may be so near where it begins."""
    if axis_way.FLOOR in way.pair and way.least < 0.0:
        return f"{way.pair[0]} {SUNK}"
    said = f"{' and '.join(way.pair)} come as near as {max(way.least, 0.0) / MM:.1f} mm"
    if len(way.looked) > 1:
        return said
    if any(name.endswith("/base_link") for name in way.pair):
        said += ", where it begins; a base may touch what it stands on, where each shape of that ends below "
        return f"{said}its foot"
    if set(way.pair) & set(way.looked[0].poses):
        said += ", where it begins; what bears a body that is carried is less than "
        said += f"{axis_way.STANDING_GAP_M / MM:g} mm beside it over all of the axis' range"
    return said


def _in_the_way(scene: Scene, targets: Targets) -> str:
    """What leaves no path, the first of what is found."""
    grid, found = find_path(scene, targets)
    said = [] if isinstance(found, Found) else diagnosis.no_path(scene, targets, grid, found)
    return said[0].message if said else NO_PATH


def _nowhere(
    work: _StationSearch,
    axis: _Axis,
    grid: FloatArray,
    score: FloatArray,
    tried: Sequence[FloatArray],
    reasons: str,
) -> Issue:
    problem, index = work.problem, work.index
    name, table = problem.operations[index].name, axis.name == STOCK

    def shown(row: FloatArray) -> str:
        return " and ".join(f"{value / axis.scale:g}" for value in row)

    reach = "the arms reach all of it" if table else f"{axis.what} reaches all of it"
    what = f"operation {name}: {reach} from no value of {axis.unit}, {axis.ranges} {axis.sign}"
    if tried:
        which = f" ({axis.words})" if len(axis.names) > 1 else ""
        all_of = ", ".join(shown(row) for row in tried)
        what = f"operation {name}: no value of {axis.unit} has a path; tried {all_of} {axis.sign}{which}; "
        what += f"at {shown(tried[0])} {axis.sign}: {reasons}"
    best = f"{shown(grid[int(np.argmax(score))])} {axis.sign} is nearest to it"
    if table:
        hint = f"split the operation, as the table stands while an arm works ({best}), or put the table "
        hint += "elsewhere, where the arms reach one side of the block and leave it room to turn"
    else:
        kind = "track" if len(axis.names) == 1 else "axes"
        hint = f"split the operation, as an arm stands while it works ({best}), or make the {kind} longer"
        own = problem.cell.arm(axis.name)
        beside = any(problem.cell.arm(other).follows for other in problem.operations[index].arms)
        held = any(setup.stock.held_by == own.name for setup in problem.setups)
        able = own.track is not None and not own.track.carries and own.sag is None and not (beside or held)
        if able and all(any_base(one) for one in problem.operations if own.name in one.arms):
            hint += ", or let it go along while the arm works (track: follow: 1)"
    arm = None if table else axis.name
    return Issue("motion.station", what, arm=arm, hint=hint, field=f"operations.{index}")


RAIL_M: Final = 4.0
"""Tracks that are advised go so far [m] to either side of where a base stands."""
BASE_ROOM_M: Final = 0.3
"""A block on a turntable that is advised turns so far [m] from the middle of a base."""
ANGLE_NOISE: Final = 1e-9
"""Turntables that would turn by less [rad] are not advised."""
AXES: Final = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
"""Directions of tracks that are advised."""


def advice(problem: Problem, targets: Sequence[Targets]) -> str:
    """What takes the arm of a cell of one ABB or KUKA arm, or the block, to where it reaches every operation:
    the shortest track under the arm, or a turntable under the block, whichever will do; empty where neither
    does, or there is one. Bodies in the way are not looked at."""
    (arm, *others), place = problem.cell.arms, problem.stock.place
    stated = not others and place is not None and arm.data.family in AXES_WRITTEN and not arm.base_auto
    stated = stated and problem.stock.held_by is None and problem.stock.sheet is None
    if not stated or arm.axes or problem.cell.turntable is not None or problem.changes:
        return ""
    return "; or ".join(
        text for text in (_table_advice(problem, targets), _track_advice(problem, targets)) if text
    )


def _stands(problem: Problem, targets: Sequence[Targets], grid: FloatArray, axis: _Axis) -> FloatArray | None:
    """For each operation the least values (N, A) of ``grid`` (K, A) from which all of it is reached; None
    where one has none."""
    out = []
    for index, own in enumerate(targets):
        few = few_of(problem.cell, with_aims(_scene(problem, index, own), own), FEW_TARGETS, False)
        score = margin(few, *axis.placed(problem, problem.setup_of(index), grid), problem.settings)
        reached = grid[score > 0.0]
        if not len(reached):
            return None
        out.append(reached[np.argmin(np.abs(reached).sum(axis=1))])
    return np.array(out)


def _table_advice(problem: Problem, targets: Sequence[Targets]) -> str:
    """A turntable under the middle of the block, from which every operation is reached; its home is where the
    block stands now. Where none does, a positioner is looked for, whose tilt axis lies across the plate."""
    setup = problem.setups[0]
    bottom = [transform(_place(setup) @ s.pose, corners(s)) for s in setup.stock.support]
    bottom = bottom or [transform(_place(setup), support.block_corners(setup.stock))]
    middle = transform(_place(setup), support.block_corners(setup.stock)).mean(axis=0)
    centre = np.array([middle[0], middle[1], min(float(points[:, 2].min()) for points in bottom)])
    table = Turntable("", "", 0, centre, np.array([0.0, 0.0, 1.0]), -np.pi, np.pi, 1.0, 0.0)
    far = float(np.linalg.norm(centre[:2] - setup.cell.arms[0].base[:2, 3]))
    if axis_way.rim(setup, _place(setup), table) + BASE_ROOM_M > far:
        return ""
    stands = _stands(problem, targets, _Table(table).values(), _Table(table))
    at = ", ".join(f"{v:.0f}" for v in centre / MM)
    if stands is None and all(map(any_lean, problem.operations)):
        return _tilt_advice(problem, targets, table, at)
    if stands is None or not np.abs(stands).max() > ANGLE_NOISE:
        return ""
    what = "put the block on a turntable under its middle, at which each operation is reached from a station "
    what += f"of its own (cell: turntable: {{centre_mm: [{at}], range_deg: [-180, 180], unit: ..., "
    return what + "speed_deg_s: ..., plate: {diameter_mm: ..., height_mm: ...}})"


def _tilt_advice(problem: Problem, targets: Sequence[Targets], table: Turntable, at: str) -> str:
    """The positioner that tilts the block the least, about x or y through the middle of its plate."""
    found: list[tuple[float, str]] = []
    for axis in AXES.values():
        tilt = RotaryAxis("", "", 1, table.centre, np.array(axis), -0.5 * np.pi, 0.5 * np.pi, 1.0, 0.0)
        both = _Table(dataclasses.replace(table, tilt=tilt))
        stands = _stands(problem, targets, both.values(), both)
        if stands is None:
            continue
        listed = ", ".join(f"{v:g}" for v in axis)
        low, high = min(0.0, stands[:, 1].min()) / DEG, max(0.0, stands[:, 1].max()) / DEG
        what = "put the block on a positioner under its middle, at which each operation is reached from a "
        what += f"station of its own (cell: positioner: {{centre_mm: [{at}], range_deg: [-180, 180], tilt: "
        what += f"{{centre_mm: [{at}], axis: [{listed}], range_deg: [{low:.0f}, {high:.0f}], ...}}, "
        found.append((float(np.abs(stands[:, 1]).max()), what + "unit: ..., plate: ...})"))
    return min(found)[1] if found else ""


def _track_advice(problem: Problem, targets: Sequence[Targets]) -> str:
    """The shortest track under the arm from which it reaches every operation."""
    (arm, *_) = problem.cell.arms
    found: list[tuple[float, str]] = []
    grid = np.arange(-RAIL_M, RAIL_M + 0.5 * STEP_M, 2.0 * STEP_M)
    for name, axis in AXES.items():
        rail = LinearAxis(np.array(axis), -RAIL_M, RAIL_M, 1.0, 1.0, "", 0.0)
        stands = _stands(problem, targets, grid[:, None], _Rails(arm.name, {arm.name: rail}))
        if stands is None:
            continue
        low, high = min(0.0, stands.min()) / MM, max(0.0, stands.max()) / MM
        axes = f"[{', '.join(f'{v:g}' for v in axis)}]"
        what = f"put arm {arm.name} on a track along {name}, which reaches each operation from a station "
        what += f"of its own (track: {{axis: {axes}, range_mm: [{low:.0f}, {high:.0f}], unit: ..., "
        found.append((high - low, what + "speed_mm_s: ..., acceleration_mm_s2: ...})"))
    # a track of no length is none: the arm reaches everything from where it stands
    return min(found)[1] if found and min(found)[0] * MM > 0.5 * STEP_M else ""
