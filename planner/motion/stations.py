"""Stations: positions of tracks, gantries and turntables during each operation.

External axes move to their station before the operation and stand while it runs. A coordinated track
(:mod:`planner.motion.coordinated_track`) stands at its station before the first target and moves afterwards.
For it the offset of its law is chosen.

Candidate values of an axis are a grid over its range, scored by the margins of the arms. Values with a good
margin are tried first, the nearest to the previous value before the others, so that an axis moves only if
that improves the margin. The first value with a free path is used.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from planner.cell import external_axis_motion, plant, support
from planner.cell.external_axis_motion import AxisMotionCheck
from planner.geometry.arrays import FloatArray, hull_points, transform
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error
from planner.motion import coordinated_track, diagnosis, self_clearance
from planner.motion.placement_margin import placement_margin
from planner.motion.planning_scene import Scene
from planner.motion.search.layered_graph_search import PathResult
from planner.motion.search.path_search import find_path, with_aims
from planner.motion.search.subsampling import sample_coarsely
from planner.problem import (
    END_SUFFIX,
    EXTERNAL_AXIS_FAMILIES,
    STOCK_AXIS,
    TILT_AXIS,
    LinearAxis,
    Problem,
    RotaryAxis,
    Setup,
    Turntable,
    allows_any_attitude,
    allows_moving_base,
    motion_order,
)
from planner.targets import Targets

LINEAR_STEP_M: Final = 0.1
"""Step [m] between candidate values of a linear axis."""
MAX_LINEAR_VALUES: Final = 201
"""Maximum number of candidate values of a linear axis."""
MAX_GANTRY_POSITIONS: Final = 1500
"""Maximum number of candidate positions of a gantry. If the grid has more, its step is increased."""
GANTRY_STEP_FACTOR: Final = 1.25
"""Factor by which the step of a gantry's grid is increased."""
TURNTABLE_STEP_RAD: Final = 5.0 * DEG
"""Step [rad] between candidate angles of a turntable."""
MAX_TURNTABLE_ANGLES: Final = 721
"""Maximum number of candidate angles of a turntable."""
MAX_POSITIONER_ROTATIONS, MAX_POSITIONER_TILTS = 73, 19
"""Maximum numbers of candidate rotations and tilts of a positioner."""
ANGLE_DECIMALS: Final = 1
"""Decimals of candidate angles in degrees."""
SCORED_TARGETS: Final = 24
"""Number of targets at which candidates are scored."""
QUICK_SCORED_TARGETS: Final = 4
"""Number of targets at which the quick check scores candidates first. More follow if none of these candidates
is feasible.
"""
GOOD_SCORE_FRACTION: Final = 0.6
"""Fraction of the best margin above which candidates are good. Of good candidates the nearest comes first."""
MAX_PATH_SEARCHES: Final = 8
"""Maximum number of candidates for which a path is searched, for each axis of a unit."""
MIN_LINEAR_DISTANCE_M: Final = 0.2
"""Minimum distance [m] between tried values of a linear axis."""
MIN_ANGULAR_DISTANCE_RAD: Final = 10.0 * DEG
"""Minimum distance [rad] between tried angles of a rotary axis."""
NO_PATH_TEXT: Final = "bodies or joints block every path there"
BASE_MOVES_TEXT: Final = "while the base moves"
"""Start of the text about a base that is too close to bodies while it moves with a coordinated track."""
BELOW_FLOOR_TEXT: Final = f"moves below {external_axis_motion.FLOOR}"
MORE_POSES_HINT: Final = "state more poses between distant ones"
"""Hint for joints that turn far from one target to the next."""
TRAVEL_EXTRA_CLEARANCE_M: Final = 1e-3
"""Extra clearance [m] while external axes travel between stations."""


@dataclasses.dataclass(frozen=True)
class _LinearUnit:
    """The track or gantry of an arm.

    Attributes:
        name: Name of the arm.
        axes: Linear axes by name.
        scale: Displayed unit in m.
        unit_text: Displayed unit.
        min_distance: Minimum distance [m] between values that are tried.
    """

    name: str
    axes: Mapping[str, LinearAxis]
    scale: float = MM
    unit_text: str = "mm"
    min_distance: float = MIN_LINEAR_DISTANCE_M

    @property
    def first_axis(self) -> LinearAxis:
        """The axis of a track, or the axis of a gantry that stands on the floor."""
        return next(iter(self.axes.values()))

    @property
    def unit(self) -> str:
        """Names of the mechanical units of its axes, for users."""
        return " and ".join(dict.fromkeys(axis.unit for axis in self.axes.values()))

    @property
    def subject(self) -> str:
        """What the unit carries, for users."""
        return f"arm {self.name}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values in stations."""
        return tuple(self.axes)

    @property
    def value_words(self) -> str:
        """Names of its values for users, in order."""
        return ", ".join(axis.axis_name for axis in self.axes.values())

    @property
    def range_text(self) -> str:
        """Ranges of its axes for users, without the unit."""
        spans = (f"{axis.axis_name} {axis.low / MM:g} to {axis.high / MM:g}" for axis in self.axes.values())
        return ", ".join(span.strip() for span in spans)

    def candidates(self) -> FloatArray:
        """Return candidate values (K, A) [m] of its A axes: all combinations of a grid for each axis."""
        step = LINEAR_STEP_M
        while True:
            grids = [linear_values(axis, step) for axis in self.axes.values()]
            if len(grids) == 1 or np.prod([len(grid) for grid in grids]) <= MAX_GANTRY_POSITIONS:
                mesh = np.meshgrid(*grids, indexing="ij")
                return np.stack([axis_grid.ravel() for axis_grid in mesh], axis=1)
            step *= GANTRY_STEP_FACTOR

    def poses_at(
        self, problem: Problem, setup: Setup, grid: FloatArray
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Return stock poses (K, 1, 4, 4) and base poses {arm: (K, 1, 4, 4)} at values (K, A) of the axes."""
        base = problem.cell.arm(self.name).base
        bases = np.tile(base, (len(grid), 1, 1, 1))
        bases[:, 0, :3, 3] += grid @ np.stack([axis.axis for axis in self.axes.values()])
        return np.tile(_stock_pose(setup), (len(grid), 1, 1, 1)), {self.name: bases}

    def check_travel(
        self, setup: Setup, start: Mapping[str, float], goal: Mapping[str, float], min_clearance: float
    ) -> AxisMotionCheck:
        """Check the travel from values ``start`` to ``goal`` [m], one axis after the other.

        Returns the check of the first axis that comes closer to bodies than ``min_clearance`` [m]. If all
        axes keep it, the check of the last axis that moves is returned.
        """
        model = _build_model(setup)
        current = {name: start[name] for name in self.names}
        # a travel of the base changes no distance within its arm
        same_arm_pairs = self_clearance.same_arm_pairs(model)
        travel = AxisMotionCheck(external_axis_motion.MAX_MEASURED_DISTANCE_M, 0.0, ("", ""), clear=True)
        for name in motion_order(self.axes, start, goal):
            ends = (current[name], goal[name])
            travel = external_axis_motion.check_linear_motion(
                model, name, ends, _home_postures(setup), min_clearance, same_arm_pairs
            )
            if not travel.clear:
                return travel
            new_values = {**current, name: goal[name]}
            model, current = external_axis_motion.model_at_values(model, new_values, current), new_values
        return travel


@dataclasses.dataclass(frozen=True)
class _RotaryUnit:
    """The turntable or positioner of a cell, which carries the stock.

    Attributes:
        first_axis: The turntable, with its tilt axis if it is a positioner.
        name: Name under which stations list it.
        scale: Displayed unit in rad.
        unit_text: Displayed unit.
        min_distance: Minimum distance [rad] between values that are tried.
    """

    first_axis: Turntable
    name: str = STOCK_AXIS
    scale: float = DEG
    unit_text: str = "deg"
    min_distance: float = MIN_ANGULAR_DISTANCE_RAD

    @property
    def unit(self) -> str:
        """Name of its mechanical unit, for users."""
        return self.first_axis.unit

    @property
    def subject(self) -> str:
        """What the unit carries, for users."""
        return "the block"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its values in stations."""
        return tuple(self.first_axis.axes)

    @property
    def value_words(self) -> str:
        """Names of its values for users, in order."""
        return " and ".join(axis.axis_name for axis in self.first_axis.axes.values())

    @property
    def range_text(self) -> str:
        """Ranges of its axes for users, without the unit."""
        spans = (
            f"{axis.axis_name} {axis.low / DEG:g} to {axis.high / DEG:g}"
            for axis in self.first_axis.axes.values()
        )
        return ", ".join(spans).strip()

    def candidates(self) -> FloatArray:
        """Return candidate values (K, A) [rad] of the rotation and, if there is one, of the tilt."""
        if self.first_axis.tilt is None:
            return rotary_values(self.first_axis)[:, None]
        mesh = np.meshgrid(
            rotary_values(self.first_axis, MAX_POSITIONER_ROTATIONS),
            rotary_values(self.first_axis.tilt, MAX_POSITIONER_TILTS),
            indexing="ij",
        )
        return np.stack([grid.ravel() for grid in mesh], axis=1)

    def poses_at(
        self, problem: Problem, setup: Setup, grid: FloatArray
    ) -> tuple[FloatArray, Mapping[str, FloatArray]]:
        """Return stock poses (K, 1, 4, 4) at values (K, A) of the axes, and no base poses."""
        stock_pose, current_values = _stock_pose(setup), setup.stock.axis_values
        return self.first_axis.move_pose(
            stock_pose, dict(zip(self.names, grid.T, strict=True)), current_values
        )[:, None], {}

    def check_travel(
        self, setup: Setup, start: Mapping[str, float], goal: Mapping[str, float], min_clearance: float
    ) -> AxisMotionCheck:
        """Check the travel from values ``start`` to ``goal`` [rad], one axis after the other.

        Returns the check of the first axis that comes closer to bodies than ``min_clearance`` [m]. If all
        axes keep it, the check of the last axis that moves is returned.
        """
        model = _build_model(setup)
        current = {name: start[name] for name in self.names}
        travel = AxisMotionCheck(external_axis_motion.MAX_MEASURED_DISTANCE_M, 0.0, ("", ""), clear=True)
        for name in self.names:
            if goal[name] != current[name]:
                ends = (current[name], goal[name])
                tilt = current.get(TILT_AXIS, 0.0)
                travel = external_axis_motion.check_rotary_motion(
                    model, name, tilt, ends, _home_postures(setup), min_clearance
                )
                if not travel.clear:
                    return travel
                new_values = {**current, name: goal[name]}
                model, current = external_axis_motion.model_at_values(model, new_values, current), new_values
        return travel


_ExternalUnit = _LinearUnit | _RotaryUnit


StationTest = Callable[[Scene, Targets, int], bool]
"""Returns whether the arms reach the targets of an operation, given by its index, in a scene."""


def assign_stations(
    problem: Problem, targets: Sequence[Targets], passes: StationTest | None = None
) -> tuple[Problem, tuple[Targets, ...]]:
    """Choose the stations of all external axes in each operation.

    Args:
        problem: Problem.
        targets: Targets of each operation.
        passes: Quick test of a station, which ignores the travel to it. None requires a free travel and a
            path.

    Returns:
        The problem with stations, and the targets with the positions of coordinated tracks.

    Raises:
        TandemError: ``motion.station`` if an operation has no station. ``problem.track`` if the stock pose is
            not stated, or if tools slide along a coordinated track.
    """
    units: dict[str, _ExternalUnit] = {
        arm.name: _LinearUnit(arm.name, arm.axes_by_name) for arm in problem.cell.arms if arm.linear_axes
    }
    if problem.cell.turntable is not None:
        units[STOCK_AXIS] = _RotaryUnit(problem.cell.turntable)
    if not units:
        return problem, tuple(targets)
    if problem.stock.place is None or any(setup.stock.place is None for setup in problem.setups):
        message = "placement of the stock is not supported "
        message += "with a track, gantry or turntable"
        raise issue_error("problem.track", f"{message}; state stock.place", field="stock.place")
    current = problem.axis_homes
    out: dict[int, dict[str, float]] = {}
    targets_on_tracks: list[Targets] = []
    for index, operation_targets in enumerate(targets):
        # in the order in which programs move them
        moving_units = [units[name] for name in units if name in (*operation_targets.arms, STOCK_AXIS)]
        choice = _StationChoice(current, operation_targets)
        if moving_units:
            choice = _choose_stations(
                _StationSearch(
                    problem.with_stations({**out, index: current}), index, operation_targets, current, passes
                ),
                moving_units,
            )
        track_ends = {name: float(values[-1]) for name, values in choice.targets.track_positions.items()}
        out[index] = {**choice.values, **{f"{name}{END_SUFFIX}": value for name, value in track_ends.items()}}
        current = {**choice.values, **track_ends}
        targets_on_tracks.append(choice.targets)
    placed_problem = problem.with_stations(out)
    if passes is None:
        _require_travel_home(placed_problem, units, current)
    return placed_problem, tuple(targets_on_tracks)


def _require_travel_home(
    problem: Problem, units: Mapping[str, _ExternalUnit], current: Mapping[str, float]
) -> None:
    """Require that external axes can travel home after the last operation.

    Args:
        problem: Problem with its stations.
        units: All tracks, gantries and turntables of the cell.
        current: Values [m, rad] of all axes after the last operation.

    Raises:
        TandemError: ``motion.station`` if an axis comes too close to a body.
    """
    index = len(problem.operations) - 1
    clearance = problem.settings.clearance + TRAVEL_EXTRA_CLEARANCE_M
    homes = problem.axis_homes
    last_stations = problem.stations.get(index, {})
    station_values = {name: value for name, value in last_stations.items() if not name.endswith(END_SUFFIX)}
    for unit in units.values():
        if all(current[name] == homes[name] for name in unit.names):
            continue
        setup = problem.with_stations({**problem.stations, index: {**station_values, **current}}).setup_of(
            index
        )
        travel = unit.check_travel(setup, current, homes, clearance)
        current = {**current, **{name: homes[name] for name in unit.names}}
        if not travel.clear:
            message = f"operation {problem.operations[index].name}: when {unit.unit} travels home after it, "
            message += _describe_collision(travel)
            hint = "remove the obstacle, or put the home of the axis on the other side of it"
            field = f"operations.{index}"
            raise issue_error("motion.station", message, hint=hint, field=field)


def linear_values(track: LinearAxis, step: float = LINEAR_STEP_M) -> FloatArray:
    """Return candidate values (K,) [m] of a linear axis, in tenths of a millimetre and including its home.

    Args:
        track: The axis.
        step: Maximum step [m].
    """
    count = min(max(int(np.ceil((track.high - track.low) / step)) + 1, 2), MAX_LINEAR_VALUES)
    return np.unique(np.append(np.round(np.linspace(track.low, track.high, count), 4), track.home) + 0.0)


def rotary_values(table: RotaryAxis, max_count: int = MAX_TURNTABLE_ANGLES) -> FloatArray:
    """Return candidate angles (K,) [rad] of a rotary axis within its range.

    They are evenly spaced from its home, in whole tenths of a degree, and include the home itself.

    Args:
        table: The axis.
        max_count: Approximate maximum number of angles.
    """
    step = max(TURNTABLE_STEP_RAD / DEG, np.ceil((table.high - table.low) / DEG / (max_count - 1)))
    low, high, home = (value / DEG for value in (table.low, table.high, table.home))
    steps = np.arange(np.ceil((low - home) / step - 1e-9), np.floor((high - home) / step + 1e-9) + 1.0)
    grid = np.round(home + step * steps, ANGLE_DECIMALS)
    grid = np.append(grid[(grid >= low) & (grid <= high)], round(home, 4))
    return np.asarray(np.unique(grid) * DEG)


def _stock_pose(setup: Setup) -> FloatArray:
    """Return the stated stock pose (4, 4); the identity if none is stated."""
    return setup.stock.place if setup.stock.place is not None else np.eye(4)


def _build_model(setup: Setup) -> plant.CellModel:
    return plant.build_cell_model(setup.cell, setup.stock, _stock_pose(setup))


def _home_postures(setup: Setup) -> dict[str, FloatArray]:
    return {arm.name: arm.home for arm in setup.cell.arms}


@dataclasses.dataclass(frozen=True)
class _StationSearch:
    """The search for values of axes of one operation.

    Attributes:
        problem: The problem, with all axes at ``values``.
        index: Index of the operation.
        targets: Targets of the operation.
        values: Values [m, rad] of all axes by name. Axes move to new values one after the other.
        passes: Quick test of a station that replaces the search of a path and the check of the travel, or
            None.
    """

    problem: Problem
    index: int
    targets: Targets
    values: Mapping[str, float]
    passes: StationTest | None

    def setup(self) -> Setup:
        """Return the setup of the operation, with all axes at ``values``."""
        return self.problem.setup_of(self.index)

    def with_values(self, values: Mapping[str, float]) -> "_StationSearch":
        """Return this search with all axes at other values."""
        problem = self.problem.with_stations({**self.problem.stations, self.index: values})
        return dataclasses.replace(self, problem=problem, values=values)

    def scene_and_targets(self, changed_values: Mapping[str, float]) -> tuple[Scene, Targets]:
        """Return scene and targets with some axes at the given values, and the others at ``values``."""
        problem = self.with_values({**self.values, **changed_values}).problem
        scene = _make_scene(problem, self.index, self.targets, _build_model(problem.setup_of(self.index)))
        return scene, with_aims(scene, self.targets)


@dataclasses.dataclass(frozen=True)
class _StationChoice:
    """Values [m, rad] of all axes before the first target, and targets with coordinated track positions."""

    values: Mapping[str, float]
    targets: Targets


def _choose_stations(search: _StationSearch, units: Sequence[_ExternalUnit]) -> _StationChoice:
    """Choose values of ``units``, which move one after the other, with which the operation has a path.

    The first unit is chosen by the margins of the arms whose place is known by then. A value is feasible only
    if values of the following units can be chosen, too.

    Raises:
        TandemError: ``motion.station`` if there are no such values.
    """
    unit, *rest = units
    is_coordinated = isinstance(unit, _LinearUnit) and unit.first_axis.follow_fraction is not None
    return (_choose_coordinated_track if is_coordinated else _choose_fixed_station)(search, unit, rest)


def _choose_fixed_station(
    search: _StationSearch, unit: _ExternalUnit, rest: Sequence[_ExternalUnit]
) -> _StationChoice:
    """Choose the values of a unit that stands during the operation.

    Candidates are scored by the margins at a few targets and tried in the order of :func:`_trial_order`.

    Args:
        search: The operation.
        unit: The unit.
        rest: Units that are chosen after this one.

    Raises:
        TandemError: ``motion.station`` if no value leads to a path; if only a unit of ``rest`` has no value,
            its issue.
    """
    problem, index, targets = search.problem, search.index, search.targets
    setup = search.setup()
    grid = unit.candidates()
    stock_and_bases = unit.poses_at(problem, setup, grid)
    previous = np.array([search.values[name] for name in unit.names])
    max_targets = SCORED_TARGETS // len(unit.names)  # fewer for positioners, which have many more values
    aimed = with_aims(_make_scene(problem, index, targets), targets)
    for count in (max_targets,) if search.passes is None else (QUICK_SCORED_TARGETS, max_targets):
        sampled = sample_coarsely(setup.cell, aimed, count, with_slides=False)
        score = placement_margin(sampled, *stock_and_bases, problem.settings, _placed_arms(targets, rest))
        tried: list[FloatArray] = []
        first_reason: str | Issue = ""
        for k in _trial_order(grid, score, previous, unit.min_distance):
            if len(tried) >= MAX_PATH_SEARCHES * len(unit.names):
                break
            is_close = any(np.abs(grid[k] - other).max() < unit.min_distance for other in tried)
            if is_close and (grid[k] != previous).any():  # the previous value is tried in any case
                continue
            tried.append(grid[k])
            result = _try_value(search, unit, rest, _values_by_name(unit, grid[k]))
            if isinstance(result, _StationChoice):
                return result
            first_reason = first_reason or result  # the reason of the first, best value
    if isinstance(first_reason, Issue):
        raise TandemError(first_reason)
    if first_reason == NO_PATH_TEXT:
        first_reason = _first_obstruction(*search.scene_and_targets(_values_by_name(unit, tried[0])))
    raise TandemError(_no_station_issue(search, unit, grid, score, tried, first_reason))


def _try_value(
    search: _StationSearch, unit: _ExternalUnit, rest: Sequence[_ExternalUnit], values: Mapping[str, float]
) -> _StationChoice | Issue | str:
    """Try one station of a unit: the travel to it, the units that are chosen next, and the path there.

    The travel is checked only if the unit moves and there is no quick test.

    Args:
        search: The operation.
        unit: The unit.
        rest: Units that are chosen after this one.
        values: Values [m, rad] of the axes of the unit.

    Returns:
        The choice of all units if the station is feasible; else the issue of a unit of ``rest``, or a text
        that describes a collision on the travel, or :data:`NO_PATH_TEXT`.
    """
    if any(values[name] != search.values[name] for name in unit.names) and search.passes is None:
        clearance = search.problem.settings.clearance + TRAVEL_EXTRA_CLEARANCE_M
        travel = unit.check_travel(search.setup(), search.values, values, clearance)
        if not travel.clear:
            return f"on the way there {_describe_collision(travel)}"
    all_values = {**search.values, **values}
    if rest:
        try:
            return _choose_stations(search.with_values(all_values), rest)
        except TandemError as error:
            return error.issues[0]
    scene, aimed_targets = search.scene_and_targets(values)
    passes = search.passes
    is_feasible = (
        isinstance(find_path(scene, aimed_targets)[1], PathResult)
        if passes is None
        else passes(scene, aimed_targets, search.index)
    )
    return _StationChoice(all_values, search.targets) if is_feasible else NO_PATH_TEXT


def _placed_arms(targets: Targets, rest: Sequence[_ExternalUnit]) -> tuple[str, ...]:
    """Return the arms of the targets whose place does not depend on the units of ``rest``."""
    return tuple(arm for arm in targets.arms if all(unit.name != arm for unit in rest))


def _choose_coordinated_track(
    search: _StationSearch, unit: _ExternalUnit, rest: Sequence[_ExternalUnit]
) -> _StationChoice:
    """Choose the positions of a coordinated track at the targets of an operation.

    The track has a free travel to the first position, and the arms have a path while it moves.

    Args:
        search: The operation.
        unit: The coordinated track.
        rest: Units that are chosen after this one.

    Raises:
        TandemError: ``problem.track`` if freedoms let the tool slide along the track, ``motion.station`` if
            no law of the track is feasible.
    """
    problem, index, targets = search.problem, search.index, search.targets
    scene, name = _make_scene(problem, index, targets), problem.operations[index].name
    tool_slide = coordinated_track.max_tool_slide(scene, targets, unit.name)
    if tool_slide > coordinated_track.MAX_SLIDE_M:
        message = (
            f"operation {name}: its freedoms let the tool slide by up to {tool_slide / MM:.1f} mm along "
        )
        message += f"{unit.unit}, which follows the nominal poses; allowed: "
        message += f"{coordinated_track.MAX_SLIDE_M / MM:g} mm; remove these freedoms, "
        message += "or remove follow from the track"
        raise issue_error("problem.track", message, arm=unit.name, field=f"operations.{index}")
    choices: list[_StationChoice] = []
    rest_issues: list[Issue] = []

    def failure_reason(track_targets: Targets) -> str:
        """Return why track positions are not feasible; empty if they are.

        The choice, or the issue of a unit of ``rest``, is appended to the lists of the outer function.
        """
        values = track_targets.track_positions[unit.name]
        start = {unit.name: float(values[0])}
        track_search = dataclasses.replace(search, targets=track_targets)
        result = _try_value(track_search, unit, rest, start)
        if result == NO_PATH_TEXT:
            return _first_obstruction(*track_search.scene_and_targets(start))
        if isinstance(result, str):
            return result
        if isinstance(result, Issue):
            rest_issues.append(result)
            return result.message
        choices.append(result)
        return "" if search.passes is not None else _base_collision(search, unit, result.values, values)

    cell, scored_arms = search.setup().cell, _placed_arms(targets, rest)
    choice = coordinated_track.choose_track_law(scene, cell, targets, unit.name, scored_arms, failure_reason)
    if not isinstance(choice, coordinated_track.TrackLawFailure):
        return choices[-1]
    if rest_issues:
        raise TandemError(rest_issues[0])
    range_text = f"{choice.best[0] / MM:g} to {choice.best[-1] / MM:g} mm"
    message = f"operation {name}: {unit.subject} does not reach all of it while {unit.unit} moves within "
    message += f"{unit.range_text} mm; from {range_text} it reaches most"
    if choice.tried:
        message = f"operation {name}: there is no path while {unit.unit} moves; tried {choice.tried} laws, "
        message += f"at the best, from {range_text}: {choice.fault}"
    hint = "make the track longer or put it closer to the work, split the operation, or let the track stand "
    hint += "(remove follow)"
    if choice.tried:
        if choice.fault.endswith(BELOW_FLOOR_TEXT):
            specific_hint = "raise the base, or narrow range_mm to where it is on or above the floor"
        elif choice.fault.startswith(BASE_MOVES_TEXT):
            specific_hint = "remove the obstacle, or narrow range_mm to where the base is clear"
        else:
            specific_hint = f"remove the obstacle, or {MORE_POSES_HINT}"
        hint = f"{specific_hint}; or {hint}"
    raise issue_error("motion.station", message, arm=unit.name, hint=hint, field=f"operations.{index}")


def _base_collision(
    search: _StationSearch, unit: _ExternalUnit, choice_values: Mapping[str, float], positions: FloatArray
) -> str:
    """Describe what the base of an arm is too close to while a coordinated track moves it; empty if nothing.

    Only the base and what the track carries with it are checked, over the whole range of ``positions`` (N,)
    [m]. The rest of the arm is checked on its path.
    """
    low, high = float(positions.min()), float(positions.max())
    setup = search.with_values({**choice_values, unit.name: low}).setup()
    model = _build_model(setup)
    bodies = sorted({solid.body for solid in model.solids})
    # Pairs of the model are ignored, because the arm is not at home while the track moves.
    ignored_pairs = frozenset(map(frozenset, itertools.combinations(bodies, 2)))
    clearance = search.problem.settings.clearance + TRAVEL_EXTRA_CLEARANCE_M
    travel = external_axis_motion.check_linear_motion(
        model, unit.name, (low, high), _home_postures(setup), clearance, ignored_pairs
    )
    if travel.clear:
        return ""
    text = f"{BASE_MOVES_TEXT} {_describe_collision(travel)}"
    return text if text.endswith(BELOW_FLOOR_TEXT) else f"{text} (at least {clearance / MM:g} mm required)"


def _values_by_name(unit: _ExternalUnit, row: FloatArray) -> dict[str, float]:
    """Return values (A,) of the axes of a unit by their names in stations."""
    return dict(zip(unit.names, row.tolist(), strict=True))


def _trial_order(grid: FloatArray, score: FloatArray, previous: FloatArray, min_distance: float) -> list[int]:
    """Return the indices of candidate values at which the job is reached, in the order to try them.

    Values with a good margin come first, by distance from the previous value, then the others by margin. If a
    unit has several axes, many values are close to each other. The first value in this order and the one
    farthest from all values before it therefore alternate.

    Args:
        grid: (K, A) [m, rad] candidate values.
        score: (K,) [rad] margins; the job is reached where they are above 0.
        previous: (A,) [m, rad] previous value.
        min_distance: Distance [m, rad] below which values near one that is tried are left out; several axes
            only.
    """
    reachable = np.flatnonzero(score > 0.0)
    if not len(reachable):
        return []
    is_good = score >= GOOD_SCORE_FRACTION * score.max()
    distance = np.abs(grid - previous).sum(axis=1)
    good_indices = sorted((k for k in reachable if is_good[k]), key=lambda k: (distance[k], -score[k]))
    other_indices = sorted((k for k in reachable if not is_good[k]), key=lambda k: -score[k])
    ordered = [*good_indices, *other_indices]
    if grid.shape[1] == 1:
        return [int(k) for k in ordered]
    out: list[int] = []
    while ordered and len(out) < MAX_PATH_SEARCHES * grid.shape[1]:
        k = ordered[0]
        if len(out) % 2:
            separation = np.abs(grid[ordered][:, None] - grid[out]).max(axis=2).min(axis=1)
            k = ordered[int(np.argmax(separation))]
        out.append(int(k))
        ordered = [index for index in ordered if np.abs(grid[index] - grid[k]).max() >= min_distance]
    return out


def _make_scene(
    problem: Problem, index: int, targets: Targets, model: plant.CellModel | None = None
) -> Scene:
    """Create the scene of an operation, given by its index, with external axes as in the problem."""
    setup = problem.setup_of(index)
    return Scene.of(setup.cell, targets.arms, _stock_pose(setup), problem.settings, model)


def _describe_collision(travel: AxisMotionCheck) -> str:
    """Describe which bodies are too close on a travel, and what may be the cause at its start."""
    if external_axis_motion.FLOOR in travel.pair and travel.min_distance < 0.0:
        return f"{travel.pair[0]} {BELOW_FLOOR_TEXT}"
    text = f"{' and '.join(travel.pair)} come as close as {max(travel.min_distance, 0.0) / MM:.1f} mm"
    if len(travel.samples) > 1:
        return text
    if any(name.endswith("/base_link") for name in travel.pair):
        text += " at its start; a base may touch its support only if each shape of the support ends below "
        return f"{text}its foot"
    if set(travel.pair) & set(travel.samples[0].poses):
        text += " at its start; the support of a carried body has to be less than "
        text += (
            f"{external_axis_motion.MAX_STANDING_GAP_M / MM:g} mm from it over the whole range of the axis"
        )
    return text


def _first_obstruction(scene: Scene, targets: Targets) -> str:
    """Return the message of the first issue that explains why the targets have no path."""
    grid, result = find_path(scene, targets)
    issues = [] if isinstance(result, PathResult) else diagnosis.no_path_issues(scene, targets, grid, result)
    return issues[0].message if issues else NO_PATH_TEXT


def _no_station_issue(
    search: _StationSearch,
    unit: _ExternalUnit,
    grid: FloatArray,
    score: FloatArray,
    tried: Sequence[FloatArray],
    reason: str,
) -> Issue:
    """Return ``motion.station`` of an operation for which a unit has no feasible value.

    The hint for a track suggests that it moves while the arm works, if the cell and all operations of the arm
    allow a coordinated track.

    Args:
        search: The operation.
        unit: The unit.
        grid: (K, A) [m, rad] candidate values.
        score: (K,) [rad] margins of the candidates.
        tried: Values at which a path was searched, in order.
        reason: Why the first of them failed.
    """
    problem, index = search.problem, search.index
    name, is_table = problem.operations[index].name, unit.name == STOCK_AXIS

    def format_values(values: FloatArray) -> str:
        return " and ".join(f"{value / unit.scale:g}" for value in values)

    reach_text = "the arms do not reach all of it" if is_table else f"{unit.subject} does not reach all of it"
    message = (
        f"operation {name}: {reach_text} from any value of {unit.unit}, {unit.range_text} {unit.unit_text}"
    )
    if tried:
        axes_text = f" ({unit.value_words})" if len(unit.names) > 1 else ""
        tried_text = ", ".join(format_values(values) for values in tried)
        message = f"operation {name}: no value of {unit.unit} has a path; tried {tried_text} "
        message += f"{unit.unit_text}{axes_text}; "
        message += f"at {format_values(tried[0])} {unit.unit_text}: {reason}"
    best_text = f"{format_values(grid[int(np.argmax(score))])} {unit.unit_text} comes closest"
    if is_table:
        hint = f"split the operation, because the table stands during it ({best_text}), or move the table to "
        hint += "where the arms reach one side of the stock and leave it room to turn"
    else:
        axis_text = "track" if len(unit.names) == 1 else "axes"
        hint = (
            f"split the operation, because the base stands during it ({best_text}), or make the {axis_text} "
            "longer"
        )
        arm_data = problem.cell.arm(unit.name)
        others_coordinated = any(
            problem.cell.arm(other).has_coordinated_track for other in problem.operations[index].arms
        )
        holds_stock = any(setup.stock.held_by == arm_data.name for setup in problem.setups)
        can_follow = (
            arm_data.track is not None
            and not arm_data.track.carries
            and arm_data.sag is None
            and not (others_coordinated or holds_stock)
        )
        if can_follow and all(
            allows_moving_base(candidate)
            for candidate in problem.operations
            if arm_data.name in candidate.arms
        ):
            hint += ", or let it move while the arm works (track: follow: 1)"
    arm = None if is_table else unit.name
    return Issue("motion.station", message, arm=arm, hint=hint, field=f"operations.{index}")


MAX_SUGGESTED_TRAVEL_M: Final = 4.0
"""Maximum travel [m] of suggested tracks to either side of the base."""
MIN_BASE_DISTANCE_M: Final = 0.3
"""Minimum distance [m] between the rim of a suggested turntable with its stock and the centre of a base."""
MIN_SUGGESTED_ROTATION_RAD: Final = 1e-9
"""Rotation [rad] below which a turntable is not suggested."""
TRACK_DIRECTIONS: Final = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}
"""Directions of suggested tracks."""


def suggest_axis(problem: Problem, targets: Sequence[Targets]) -> str:
    """Suggest an external axis with which every operation is reached.

    For a cell of one ABB or KUKA arm this is the shortest track under the arm, a turntable under the stock,
    or both as alternatives. Collisions are not checked.

    Args:
        problem: Problem without external axes.
        targets: Targets of each operation.

    Returns:
        A hint; empty if neither helps or the cell has an external axis.
    """
    (arm, *others), stock_pose = problem.cell.arms, problem.stock.place
    is_supported = (
        not others
        and stock_pose is not None
        and arm.data.family in EXTERNAL_AXIS_FAMILIES
        and not arm.base_auto
    )
    is_supported = is_supported and problem.stock.held_by is None and problem.stock.sheet is None
    if not is_supported or arm.linear_axes or problem.cell.turntable is not None or problem.changes:
        return ""
    return "; or ".join(
        text
        for text in (_turntable_suggestion(problem, targets), _track_suggestion(problem, targets))
        if text
    )


def _nearest_stations(
    problem: Problem, targets: Sequence[Targets], grid: FloatArray, unit: _ExternalUnit
) -> FloatArray | None:
    """Return for each of N operations the station nearest to 0 from which all of it is reached.

    Args:
        problem: Problem without external axes.
        targets: Targets of each operation.
        grid: (K, A) [m, rad] values of the unit to choose from.
        unit: Suggested unit.

    Returns:
        Values (N, A) [m, rad]; None if an operation is not reached from any value.
    """
    out = []
    for index, operation_targets in enumerate(targets):
        sampled = sample_coarsely(
            problem.cell,
            with_aims(_make_scene(problem, index, operation_targets), operation_targets),
            SCORED_TARGETS,
            with_slides=False,
        )
        score = placement_margin(
            sampled, *unit.poses_at(problem, problem.setup_of(index), grid), problem.settings
        )
        reachable = grid[score > 0.0]
        if not len(reachable):
            return None
        out.append(reachable[np.argmin(np.abs(reachable).sum(axis=1))])
    return np.array(out)


def _turntable_suggestion(problem: Problem, targets: Sequence[Targets]) -> str:
    """Suggest a turntable under the centre of the stock, with its home at the current stock pose.

    If it does not help and the stock may have any attitude, a positioner is suggested. Returns an empty text
    if the turntable would hit a base, or if neither helps.
    """
    setup = problem.setups[0]
    # The plate is centred under the stock, at the height of the lowest point of the support or the stock.
    hulls = [transform(_stock_pose(setup) @ s.pose, hull_points(s)) for s in setup.stock.support]
    hulls = hulls or [transform(_stock_pose(setup), support.block_corners(setup.stock))]
    stock_centre = transform(_stock_pose(setup), support.block_corners(setup.stock)).mean(axis=0)
    lowest = min(float(points[:, 2].min()) for points in hulls)
    centre = np.array([stock_centre[0], stock_centre[1], lowest])
    table = Turntable("", "", 0, centre, np.array([0.0, 0.0, 1.0]), -np.pi, np.pi, 1.0, 0.0)
    base_distance = float(np.linalg.norm(centre[:2] - setup.cell.arms[0].base[:2, 3]))
    if (
        external_axis_motion.carried_radius(setup, _stock_pose(setup), table) + MIN_BASE_DISTANCE_M
        > base_distance
    ):
        return ""
    nearest_stations = _nearest_stations(
        problem, targets, _RotaryUnit(table).candidates(), _RotaryUnit(table)
    )
    centre_text = ", ".join(f"{v:.0f}" for v in centre / MM)
    if nearest_stations is None and all(map(allows_any_attitude, problem.operations)):
        return _positioner_suggestion(problem, targets, table, centre_text)
    if nearest_stations is None or not np.abs(nearest_stations).max() > MIN_SUGGESTED_ROTATION_RAD:
        return ""
    text = "put the stock on a turntable under its centre, with which each operation is reached from its own "
    text += f"station (cell: turntable: {{centre_mm: [{centre_text}], range_deg: [-180, 180], unit: ..., "
    return text + "speed_deg_s: ..., plate: {diameter_mm: ..., height_mm: ...}})"


def _positioner_suggestion(
    problem: Problem, targets: Sequence[Targets], table: Turntable, centre_text: str
) -> str:
    """Suggest the positioner with the smallest tilt, about x or y through the centre of its plate.

    ``centre_text`` is this centre as text in mm. Returns an empty text if no positioner helps.
    """
    suggestions: list[tuple[float, str]] = []
    for axis in TRACK_DIRECTIONS.values():
        tilt = RotaryAxis("", "", 1, table.centre, np.array(axis), -0.5 * np.pi, 0.5 * np.pi, 1.0, 0.0)
        positioner = _RotaryUnit(dataclasses.replace(table, tilt=tilt))
        nearest_stations = _nearest_stations(problem, targets, positioner.candidates(), positioner)
        if nearest_stations is None:
            continue
        axis_text = ", ".join(f"{v:g}" for v in axis)
        low, high = min(0.0, nearest_stations[:, 1].min()) / DEG, max(0.0, nearest_stations[:, 1].max()) / DEG
        text = "put the stock on a positioner under its centre, with which each operation is reached from "
        text += (
            f"its own station (cell: positioner: {{centre_mm: [{centre_text}], range_deg: [-180, 180], tilt: "
        )
        text += (
            f"{{centre_mm: [{centre_text}], axis: [{axis_text}], range_deg: [{low:.0f}, {high:.0f}], ...}}, "
        )
        suggestions.append((float(np.abs(nearest_stations[:, 1]).max()), text + "unit: ..., plate: ...})"))
    return min(suggestions)[1] if suggestions else ""


def _track_suggestion(problem: Problem, targets: Sequence[Targets]) -> str:
    """Suggest the shortest track under the arm, along x or y, from which it reaches every operation.

    Returns an empty text if no track helps, or if none is needed.
    """
    (arm, *_) = problem.cell.arms
    suggestions: list[tuple[float, str]] = []
    grid = np.arange(
        -MAX_SUGGESTED_TRAVEL_M, MAX_SUGGESTED_TRAVEL_M + 0.5 * LINEAR_STEP_M, 2.0 * LINEAR_STEP_M
    )
    for name, axis in TRACK_DIRECTIONS.items():
        track = LinearAxis(np.array(axis), -MAX_SUGGESTED_TRAVEL_M, MAX_SUGGESTED_TRAVEL_M, 1.0, 1.0, "", 0.0)
        nearest_stations = _nearest_stations(
            problem, targets, grid[:, None], _LinearUnit(arm.name, {arm.name: track})
        )
        if nearest_stations is None:
            continue
        low, high = min(0.0, nearest_stations.min()) / MM, max(0.0, nearest_stations.max()) / MM
        axis_text = f"[{', '.join(f'{v:g}' for v in axis)}]"
        text = f"put arm {arm.name} on a track along {name}, with which it reaches each operation from its "
        text += f"own station (track: {{axis: {axis_text}, range_mm: [{low:.0f}, {high:.0f}], unit: ..., "
        suggestions.append((high - low, text + "speed_mm_s: ..., acceleration_mm_s2: ...})"))
    # a track of no length means that the arm reaches everything from where it is
    return min(suggestions)[1] if suggestions and min(suggestions)[0] * MM > 0.5 * LINEAR_STEP_M else ""
