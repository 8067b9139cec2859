"""From a plan to the steps of each task: who moves when, where tasks meet, and what arms carry.

Which targets are moved to is settled here, too. What an arm carries is the block that its tool
holds, as the controller must know it.
"""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from planner.cell import axis_way
from planner.cell.axis_way import Travel
from planner.claims.claim import HoldsStock
from planner.claims.handshake import Handshake
from planner.claims.segments import Segment
from planner.geometry import corner_rounding
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, to_quaternion
from planner.geometry.units import MM
from planner.issues import Issue, TandemError, refusal
from planner.languages.writing import handshake as handshake_drift
from planner.languages.writing import layout
from planner.languages.writing.handshake import handshake_refusals, meeting_rows, stretched
from planner.languages.writing.language import writer_of
from planner.languages.writing.outer_axes import at_station, legs_between, outer_values, table_of
from planner.plans import OperationPlan, Plan
from planner.problem import OUTER_DECIMALS, Arm, Cell, Problem, Settings, Setup
from planner.targets import Action, Targets
from planner.tooling import Tool

LEAST_MASS = 0.001
"""Least mass [kg] of a load in RAPID."""


def require_mass(tool: Tool, needs: str = "a load needs {} kg at least") -> None:
    """Raises :class:`TandemError` (``post.tool``) for a tool without mass; ``needs``: what asks for it."""
    if not tool.mass >= LEAST_MASS:
        message = f"tool {tool.name!r} has a mass of {tool.mass} kg; {needs.format(LEAST_MASS)}"
        raise refusal("post.tool", message, hint=f"state the tool's mass_kg, {LEAST_MASS} or more")


def carries(plan: Plan, problem: Problem) -> dict[int, dict[str, layout.Carry]]:
    """{index of an operation: {arm: what it carries from there on}}, where that changes.

    Raises :class:`TandemError` (``post.load``) where a block is held and no claim says how heavy it is.
    """
    out: dict[int, dict[str, layout.Carry]] = {}
    before: str | None = None
    for setup in problem.setups:
        if setup.operations[0] >= len(plan.operations):
            break
        holder = setup.stock.held_by
        change = {before: layout.Carry(None)} if before is not None and before != holder else {}
        if holder is not None:
            change[holder] = layout.Carry(_load(plan, setup, holder))
        out[setup.operations[0]] = change
        before = holder
    return out


def _load(plan: Plan, setup: Setup, holder: str) -> layout.Load:
    """The block of a setup in the holder's TCP frame, a solid box of one density."""
    claims = [
        claim
        for index in setup.operations
        if index < len(plan.operations)
        for claim in plan.operations[index].targets.claims
        if isinstance(claim, HoldsStock) and claim.arm == holder
    ]
    if not claims or not claims[0].mass >= LEAST_MASS:
        got = f"{claims[0].mass:g} kg" if claims else "no claim of its weight"
        message = f"setup {setup.number}: arm {holder} holds the block, with {got}; it needs {LEAST_MASS} kg"
        hint = (
            "give a larger block, or one of a denser foam" if claims else "name the block's foam (stock.foam)"
        )
        raise refusal("post.load", message, arm=holder, hint=f"{hint}, and plan again")
    claim, size = claims[0], setup.stock.upper - setup.stock.lower
    inertia = claim.mass / 12.0 * (np.sum(size**2) - size**2)
    return layout.Load(setup.number, claim.mass, claim.cog, claim.grip[:3, :3], inertia)


MAX_TASKS = 2
"""Motion tasks of a program at most."""
SAME_JOINTS = 1e-6
"""Joints [rad] that differ by less are one place, some 0.00005 deg apart."""


def build(plan: Plan, problem: Problem) -> layout.Job:
    """The steps of every task; raises :class:`TandemError` (``post.*``) for a plan that no program can do."""
    used = {arm for operation in plan.operations for arm in operation.targets.arms}
    arms = [arm for arm in problem.cell.arms if arm.name in used]
    controller = problem.cell.controller
    named = min(len(controller.tasks), len(controller.units), MAX_TASKS)
    if not 1 <= len(arms) <= named:
        got = f"{len(arms)} arms move; the controller has tasks and units for {named}"
        raise refusal("post.tasks", got, hint="name one task and one unit for each arm of the cell")
    setups = {index: setup for setup in problem.setups for index in setup.operations}
    if len(plan.operations) > len(setups) or len(plan.places) < len(problem.setups):
        message = (
            f"the plan has {len(plan.operations)} operations in {len(plan.places)} setups, the problem "
            f"{len(setups)} in {len(problem.setups)}"
        )
        raise refusal("post.plan", message, hint="plan this problem again")
    handshake = controller.handshake if controller.sync == "handshake" and len(arms) > 1 else None
    if handshake is not None:
        refused = handshake_refusals(problem, [operation.targets for operation in plan.operations])
        if refused:
            raise TandemError(refused)
    homes = {arm.name: outer_values(arm, problem.cell, problem.homes) for arm in arms}
    builder = _Builder([arm.name for arm in arms], handshake, problem.settings, homes)
    loads = carries(plan, problem)
    travels = axis_way.travels(problem, plan.places)
    parts = [
        builder.operation(
            i,
            operation,
            setups[i],
            plan.places[setups[i].number - 1],
            loads.get(i, {}),
            travels[i : i + 2],
            problem.closing if i + 1 == len(problem.operations) else None,
        )
        for i, operation in enumerate(plan.operations)
    ]
    place = {arm.name: i for i, arm in enumerate(problem.cell.arms)}
    tasks = tuple(
        layout.TaskProgram(
            number=n + 1,
            task=controller.tasks[place[arm.name]],
            unit=controller.units[place[arm.name]],
            arm=arm,
            robot=arm.data,
            base=plan.bases.get(arm.name, arm.base),
            operations=tuple(part[arm.name] for part in parts),
            table=table_of(arm, problem.cell),
            home_station=homes[arm.name],
        )
        for n, arm in enumerate(arms)
    )
    actions = [action for operation in plan.operations for action in operation.targets.actions]
    signals = dict.fromkeys(action.signal for action in actions if action.kind in ("on", "off"))
    coupled = any(operation.targets.coupled for operation in plan.operations)
    drifts = () if handshake is None else handshake_drift.drifts(plan, setups, parts)
    return layout.Job(tasks, builder.meets, builder.blocks, coupled, tuple(signals), handshake, drifts)


class _Builder:
    """Numbers the meeting points and blocks of a job while its operations are laid out."""

    def __init__(
        self,
        arms: Sequence[str],
        handshake: Handshake | None,
        settings: Settings,
        stands: Mapping[str, layout.Outer | None],
    ) -> None:
        self.arms = arms
        self.handshake = handshake
        self.settings = settings
        self.meets = 0 if handshake is None else 1  # the first meeting stands before all operations
        self.blocks = 0
        self.steps: dict[str, list[layout.Step]] = {}
        self.stands = dict(stands)

    def operation(
        self,
        number: int,
        plan: OperationPlan,
        setup: Setup,
        place: FloatArray,
        loads: Mapping[str, layout.Carry],
        travels: Sequence[Mapping[str, Travel]],
        closing: Setup | None = None,
    ) -> dict[str, layout.OperationProgram]:
        """The operation's program for each task; ``loads``: what arms carry from its beginning on;
        ``travels`` of external axes before it and behind it, by their names, if there are any; ``closing``:
        how the cell stands behind it, where external axes go home."""
        targets = plan.targets
        _check(plan, self.handshake is None)
        frames = _frames(plan, setup)
        arms = {arm.name: arm for arm in setup.cell.arms}
        writers = {arm: writer_of(arms[arm]) for arm in targets.arms}
        planned = _written(plan, frames, place)
        written = {arm: writers[arm].round_poses(*poses) for arm, poses in planned.items()}
        keep = _kept(written)
        stop = _stops(targets, keep)
        meets = np.zeros(len(keep), dtype=np.int64)
        turned = [written[arm][0] for arm in targets.arms if writers[arm].stops_at_turns]
        longer = _turns(turned, targets, keep) & ~stop
        stop = stop | longer
        if self.handshake is not None and len(targets.arms) > 1:
            paused = [written[arm] for arm in targets.arms if writers[arm].stops_at_pauses]
            stop = stop | _pauses(paused, keep)
            stop = meeting_rows(stop, self.handshake.every)
            meets = stop.astype(np.int64)
        duration = _durations(plan, keep)
        if meets.any() or longer.any():
            duration = _stretched(duration, stop, plan, keep, written, arms, self.settings)
        tracks = {
            arm: _track(plan, arms[arm], frames[arm], keep, stop, duration, *written[arm])
            for arm in targets.arms
        }
        segments = tuple(targets.segment[i] for i in keep)
        self.steps = {arm: [] for arm in self.arms}
        self._meet(f"all tasks are ready for operation {plan.name}")
        before = dict(self.stands)
        stands = {arm: outer_values(arms[arm], setup.cell, setup.stands) for arm in self.arms}
        gone = {arm: float(values[-1]) for arm, values in targets.ride.items()}
        leaves = {arm: outer_values(arms[arm], setup.cell, {**setup.stands, **gone}) for arm in self.arms}
        homes = {arm: arms[arm].home for arm in self.arms}
        opened = number == setup.operations[0] and bool(setup.steps)
        for arm in self.arms:
            if number == 0 and (opened or arm not in targets.arms):
                home = layout.Joints(homes[arm], "entry", station=before[arm])
                look = () if home.station is None else (layout.AxesLook(home.station),)
                self._alone(arm, [*look, home], f"{arm} stands at home")
        if opened:
            self._setup(setup)
        self._stations(stands, arms, setup.cell, travels[0] if travels else {})
        for arm, carry in loads.items():
            self.steps[arm].append(carry)
        from_home = number > 0 or opened
        if "entry" in plan.together:
            for arm in () if from_home else plan.order:
                self._alone(arm, [layout.Joints(homes[arm], "entry")], f"{arm} stands at home")
            ways = {arm: (homes[arm], *plan.entry[arm], plan.q[arm][0]) for arm in plan.order}
            self._at_once(ways, "entry", "start")
        else:
            for arm in plan.order:
                steps = _joints((homes[arm], *plan.entry[arm], plan.q[arm][0]), "entry")
                steps[-1] = layout.Joints(plan.q[arm][0], "start")
                self._alone(arm, steps[1:] if from_home else steps, f"{arm} stands at its first target")
        self._actions(targets, -1, keep)
        self._blocks(number, targets, keep, segments, meets, duration)
        for arm in self.arms:
            self.steps[arm] = [at_station(step, stands[arm]) for step in self.steps[arm]]
            self.stands[arm] = leaves[arm]
        if "exit" in plan.together:
            self._at_once({arm: (plan.q[arm][-1], *plan.exit[arm], homes[arm]) for arm in plan.order}, "exit")
        else:
            for arm in reversed(plan.order):
                steps = _joints((plan.q[arm][-1], *plan.exit[arm], homes[arm]), "exit")
                self._alone(arm, steps[1:], f"{arm} is home again")
        for arm in self.arms:
            self.steps[arm] = [at_station(step, leaves[arm]) for step in self.steps[arm]]
        if closing is not None:
            self._setup(closing, "all work is done")
            ends = {arm: outer_values(arms[arm], closing.cell, closing.stands) for arm in self.arms}
            self._stations(ends, arms, closing.cell, travels[1])
        ids = np.arange(1, len(keep) + 1)
        return {
            arm: layout.OperationProgram(
                plan.name,
                setup.number,
                arms[arm],
                tracks.get(arm),
                ids,
                stop,
                meets,
                segments,
                keep,
                tuple(self.steps[arm]),
                stands[arm],
            )
            for arm in self.arms
        }

    def _stations(
        self,
        stands: Mapping[str, layout.Outer | None],
        arms: Mapping[str, Arm],
        cell: Cell,
        travels: Mapping[str, Travel],
    ) -> None:
        """External axes that stand elsewhere go to where they are to stand, arm after arm, folded, those of a
        gantry or positioner one after the other; for as long the other arm waits."""
        for arm in self.arms:
            station, before, table = stands[arm], self.stands[arm], table_of(arms[arm], cell)
            if station is not None and before is not None and station != before:
                legs = legs_between(before, station, arms[arm], table)
                steps = [layout.Joints(arms[arm].home, "station", station=leg) for leg in legs]
                what = arm if table is None else "the block"
                names = arms[arm].rails if table is None else table.axes
                seconds = sum(travels[name].seconds for name in names if name in travels)
                self._alone(arm, steps, f"{what} stands at its station", seconds)
                self.stands[arm] = station

    def _setup(self, setup: Setup, reached: str = "") -> None:
        """The first task tells what is to be done and asks whether it is; nobody moves before all met."""
        told = [Action(0, "message", text=text) for text in setup.steps]
        asked = Action(0, "confirm", text=setup.confirmation)
        self._alone(
            self.arms[0],
            [layout.Do(action) for action in (*told, asked)],
            reached or f"setup {setup.number} is done",
        )

    def _meet(self, reached: str, seconds: float = 0.0, by: str = "") -> None:
        """All arms meet; all but ``by`` wait for what that one does alone for ``seconds``."""
        if len(self.arms) > 1:
            self.meets += 1
            for arm in self.arms:
                self.steps[arm].append(layout.Meet(self.meets, reached, 0.0 if arm == by else seconds))

    def _alone(self, arm: str, steps: Sequence[layout.Step], reached: str, seconds: float = 0.0) -> None:
        """What one arm does while the others wait: ``seconds``, and those that its actions state."""
        if steps:
            self.steps[arm] += steps
            seconds += sum(step.action.seconds for step in steps if isinstance(step, layout.Do))
            self._meet(reached, seconds, arm)

    def _at_once(self, ways: Mapping[str, Sequence[FloatArray]], place: str, last: str | None = None) -> None:
        """All arms through their stations, move by move, in a synchronised block, from the first one on; what
        they reach ``last`` has a name of its own. Of stations that are one place for all arms the later one
        counts."""
        rows = np.stack([np.stack(ways[arm]) for arm in ways], axis=1)
        goes = np.abs(np.diff(rows, axis=0)).max(axis=(1, 2)) >= SAME_JOINTS
        if not goes.any():
            return
        begun = np.logical_or.accumulate(goes)
        rows = rows[1:][begun & np.append(goes[1:], True)]
        self.blocks += 1
        for k, arm in enumerate(ways):
            names = [place] * (len(rows) - 1) + [last or place]
            steps = [
                layout.Joints(row[k], name, i)
                for i, (row, name) in enumerate(zip(rows, names, strict=True), 1)
            ]
            self.steps[arm] += [layout.SyncOn(self.blocks), *steps, layout.SyncOff(self.blocks)]

    def _actions(self, targets: Targets, row: int, keep: IntArray) -> None:
        """Actions from the target of this row to before that of the next one; row -1 is the first target."""
        low = keep[row] if row >= 0 else 0
        high = keep[row + 1] if row + 1 < len(keep) else targets.count
        due = [action for action in targets.actions if low <= action.at < high]
        due.sort(key=lambda action: action.at)
        lead = next(arm for arm in self.arms if arm in targets.arms)
        self._alone(lead, [layout.Do(action) for action in due], "what this stop asks for is done")

    def _blocks(
        self,
        number: int,
        targets: Targets,
        keep: IntArray,
        segments: Sequence[Segment],
        meets: IntArray,
        duration: FloatArray,
    ) -> None:
        """Lays out the moves; gives the rows that are marked in ``meets`` (M,) their numbers."""
        together = len(targets.arms) > 1
        ends = {int(np.searchsorted(keep, action.at, side="right")) - 1 for action in targets.actions}
        edges = sorted({0, len(keep)} | {end + 1 for end in ends})
        for first, last in itertools.pairwise(edges):
            if together:
                self.blocks += 1
            runs = _runs(number, segments, first, last, together)
            for arm in targets.arms:
                self.steps[arm] += (
                    [layout.SyncOn(self.blocks), *runs, layout.SyncOff(self.blocks)] if together else runs
                )
            marked = np.flatnonzero(meets[first:last]) + first
            meets[marked] = self.meets + 1 + np.arange(len(marked))
            self.meets += len(marked)
            if not together:
                one = targets.arms[0]
                self._meet(f"{one} has run its moves", float(duration[first:last].sum()), one)
            self._actions(targets, last - 1, keep)


def _runs(
    number: int, segments: Sequence[Segment], first: int, last: int, together: bool
) -> list[layout.Run]:
    edges = [first, *(i for i in range(first + 1, last) if segments[i] != segments[i - 1]), last]
    return [layout.Run(number, segments[a], a, b, together) for a, b in itertools.pairwise(edges)]


def _joints(stations: Sequence[FloatArray], place: str) -> list[layout.Step]:
    """Steps to the stations in order; of two that are one place the later one counts."""
    steps: list[layout.Step] = []
    last: FloatArray | None = None
    for q in stations:
        if last is not None and np.abs(q - last).max() < SAME_JOINTS:
            steps.pop()
        steps.append(layout.Joints(np.asarray(q, dtype=np.float64), place))
        last = q
    return steps


def _check(plan: OperationPlan, one_controller: bool) -> None:
    """Issues for times, shapes, ways and actions that no program can express; ``one_controller`` moves all
    arms."""
    targets = plan.targets
    issues = []
    rows = [plan.time, *plan.q.values()]
    if any(len(row) != targets.count or not np.isfinite(row).all() for row in rows):
        message = (
            f"operation {plan.name}: times and joints must be finite and one row a target ({targets.count})"
        )
        issues.append(Issue("post.plan", message, hint="plan the job again"))
    for name in plan.together:
        way = {"entry": plan.entry, "exit": plan.exit}.get(name, {})
        counts = {len(way[arm]) for arm in plan.order if arm in way}
        if one_controller and set(plan.order) == set(way) and len(way) > 1 and len(counts) == 1:
            continue
        message = (
            f"operation {plan.name}: the arms cannot go the way {name!r} at once; that needs one MultiMove "
            "controller for both, and as many waypoints of each arm"
        )
        issues.append(Issue("post.plan", message, hint="plan the job again"))
    for action in targets.actions:
        if not 0 <= action.at < targets.count or not (targets.stop[action.at] or action.at == 0):
            message = (
                f"operation {plan.name}: action {action.kind!r} is at target {action.at}, which is no stop"
            )
            issues.append(
                Issue(
                    "post.action", message, index=action.at, hint=f"let the motion stop at target {action.at}"
                )
            )
    if issues:
        raise TandemError(issues)


def _frames(plan: OperationPlan, setup: Setup) -> dict[str, str]:
    """Frame in which each arm's moves are written: a holder's, planned about the block's place, are the
    world's, for no work object can be what the arm itself carries."""
    holder = setup.stock.held_by
    frames = plan.targets.frame
    return {
        arm: "world" if arm == holder and frames[arm] == "stock" else frames[arm] for arm in plan.targets.arms
    }


def _written(
    plan: OperationPlan, frames: Mapping[str, str], place: FloatArray
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Positions (N, 3) [mm] and quaternions (N, 4) of each arm at all targets, rounded as written.

    ``frames``: as :func:`_frames` has them; ``place`` (4, 4) is the stock's in the world.
    """
    out = {}
    for arm, planned in plan.targets.poses(plan.values).items():
        moved = frames[arm] != plan.targets.frame[arm]
        pose = place @ planned if moved else planned
        quaternion = to_quaternion(pose[:, :3, :3])
        flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
        sign = np.cumprod(np.concatenate([[1.0], np.where(flips, -1.0, 1.0)]))
        # + 0.0 turns -0.0 into 0.0
        out[arm] = (
            np.round(pose[:, :3, 3] * 1e3, layout.POSITION_DECIMALS) + 0.0,
            np.round(quaternion * sign[:, None], layout.QUATERNION_DECIMALS) + 0.0,
        )
    return out


def _kept(written: Mapping[str, tuple[FloatArray, FloatArray]]) -> IntArray:
    """Indices of the targets that are moved to: all but the first, without those where no arm moves."""
    moves = [np.any(np.diff(value, axis=0) != 0.0, axis=1) for pair in written.values() for value in pair]
    return np.flatnonzero(np.any(moves, axis=0)) + 1


def _stops(targets: Targets, keep: IntArray) -> BoolArray:
    """Whether each kept move ends in a stop; a stop at a dropped target passes to the move before it."""
    stop = np.zeros(len(keep), dtype=bool)
    for i in np.flatnonzero(targets.stop):
        row = int(np.searchsorted(keep, i, side="right")) - 1
        if row >= 0:
            stop[row] = True
    if len(stop):
        stop[-1] = True
    return stop


def _pauses(written: Sequence[tuple[FloatArray, FloatArray]], keep: IntArray) -> BoolArray:
    """Whether (M,) the kept moves stop because one of these arms, which cannot pass through a corner into
    standing still, stands still in this move or in the next one."""
    still = np.zeros(len(keep), dtype=bool)
    stations = np.concatenate([[0], keep])
    for position, quaternion in written:
        goes = np.any(np.diff(position[stations], axis=0) != 0.0, axis=1)
        still |= ~(goes | np.any(np.diff(quaternion[stations], axis=0) != 0.0, axis=1))
    return np.asarray(still | np.append(still[1:], False))


def _turns(written: Sequence[FloatArray], targets: Targets, keep: IntArray) -> BoolArray:
    """Whether (M,) the kept moves have to stop because the TCP of one of these arms, whose corners are
    lengths on its way, stands in this move or in the next one; not where work has a least feed."""
    still = np.zeros(len(keep), dtype=bool)
    for position in written:
        way = np.diff(position[np.concatenate([[0], keep])], axis=0)
        still |= np.linalg.norm(way, axis=1) <= corner_rounding.STANDING_MM
    fed = targets.feed_min[keep] > 0.0
    free = ~(fed | np.append(fed[1:], False))
    return np.asarray((still | np.append(still[1:], False)) & free)


def _durations(plan: OperationPlan, keep: IntArray) -> FloatArray:
    """Times (M,) [s] of the kept moves, rounded as written."""
    clock = np.round(plan.time, layout.TIME_DECIMALS)
    duration = np.round(clock[keep] - clock[keep - 1], layout.TIME_DECIMALS)
    late = np.flatnonzero(duration <= 0.0)
    if len(late):
        i = int(keep[late[0]])
        place = f"operation {plan.name}, target {i} ({plan.targets.name(i)})"
        message = f"{place}: the move takes {duration[late[0]]} s"
        raise refusal("post.plan", message, index=i, hint="every move needs a time above 0.00001 s")
    return np.asarray(duration)


def _stretched(
    duration: FloatArray,
    stop: BoolArray,
    plan: OperationPlan,
    keep: IntArray,
    written: Mapping[str, tuple[FloatArray, FloatArray]],
    arms: Mapping[str, Arm],
    settings: Settings,
) -> FloatArray:
    """The times of moves that have more stops than the plan counted with."""
    targets = plan.targets
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.where(targets.travel > 0.0, targets.travel / targets.feed, 0.0)
    least = np.diff(np.cumsum(least)[np.concatenate([[0], keep])])
    steps = []
    for arm, (position, _) in written.items():
        way = np.linalg.norm(position[keep] - position[keep - 1], axis=1)
        least = np.maximum(least, 1e-3 * way / settings.tcp_speed)
        q = plan.q[arm]
        allowed = settings.acceleration_fraction * arms[arm].data.acceleration
        steps.append((q[keep] - q[keep - 1]) / allowed)
    return stretched(duration, stop, least, steps)


def _track(
    plan: OperationPlan,
    arm: Arm,
    frame: str,
    keep: IntArray,
    stop: BoolArray,
    duration: FloatArray,
    position: FloatArray,
    quaternion: FloatArray,
) -> layout.Track:
    distance = np.linalg.norm(position[keep] - position[keep - 1], axis=1)
    stations = np.concatenate([[0], keep])
    segments = [plan.targets.segment[i] for i in keep]
    room = corner_rounding.room(
        position[stations],
        quaternion[stations],
        stop,
        1e3 * plan.targets.rounding.turning(arm.name, arm.tool),
        1e3 * plan.targets.rounding.deviations(segments),
    )
    ride = plan.targets.ride.get(arm.name)
    outer = None if ride is None else np.round(ride[keep] / MM, OUTER_DECIMALS) + 0.0
    q = plan.q[arm.name][keep]
    return layout.Track(position[keep], quaternion[keep], q, duration, distance, *room, frame, outer)
