"""Says why there is no path: the targets, joints or bodies in the way, and what is free around them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue.robots import OffsetParameters, OpwParameters
from planner.cell import clearance
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.motion import offset_wrist, own_clearance
from planner.motion.place_margin import reach_gap
from planner.motion.planning_scene import Scene, holders
from planner.motion.search.ladder_search import Blocked, Dead, Wound
from planner.motion.search.reach import Grid, Reach, full_turn, slides_only
from planner.motion.trajectory.joint_path import Dense, clear
from planner.targets import Targets

REPORTED_DISTANCE_M: Final = 0.2
"""Distances [m] up to this are reported."""
TOUCHING_M: Final = 1e-6
"""Pairs are asked for so much [m] beyond what is wanted: with none wanted, those that overlap are at 0."""

LEAST_MARGIN_DEG: Final = 0.5
"""Smaller margins [deg] to limits and singularities are not advised."""
MOST_PAIRS: Final = 4
"""Pairs of bodies that a message names."""


def no_path(scene: Scene, targets: Targets, grid: Grid, blocked: Blocked) -> list[Issue]:
    """Issues that say why the ladder has no path."""
    if blocked.few is not None:
        few, rows = blocked.few
        some = no_path(scene, few, grid, dataclasses.replace(blocked, few=None))
        return [_in_job(issue, targets, rows) for issue in some]
    out = [issue for arm, r in blocked.reach.items() if (issue := _unreached(scene, targets, grid, arm, r))]
    if not out and blocked.common < targets.count:
        wound = blocked.wound
        out = [
            _broken(targets, blocked.common)
            if wound is None
            else _wound_up(scene, targets, wound, blocked.common)
        ]
    return out or [_collision(scene, targets, blocked)]


def _in_job(issue: Issue, targets: Targets, rows: IndexArray) -> Issue:
    """An issue of some of the targets, ``rows`` (K,), as one of the whole job."""
    if issue.index is None or issue.target is None:
        return issue
    index = int(rows[issue.index])
    name = targets.name(index)
    return dataclasses.replace(
        issue, message=issue.message.replace(issue.target, name), index=index, target=name
    )


def _unreached(scene: Scene, targets: Targets, grid: Grid, arm: str, r: Reach) -> Issue | None:
    """The first target that ends the branch which goes farthest, with what ends it: reach, a joint, a
    singularity."""
    if r.branches:
        return None
    ends = np.argmin(r.exists, axis=1)
    branch = int(np.argmax(ends))
    index = int(ends[branch])
    chain = scene.chains[arm]
    count = int((~r.exists[branch]).sum())
    name = targets.name(index)
    where: dict[str, Any] = {"arm": arm, "index": index, "target": name, "count": count}
    if not r.solved[:, index].any():
        what = f"arm {arm} cannot reach target {name}: "
        far = _beyond(scene, targets, grid, arm, index)
        if far <= 0.0 and not isinstance(chain.robot.form, OpwParameters):
            what += f"its wrist cannot take the tool's direction there ({chain.robot.title})"
            return Issue("motion.no_reach", what, hint=_elsewhere(targets), **where)
        what += f"its wrist would have to be {far / MM:.0f} mm beyond what the arm reaches"
        what += f" ({chain.robot.title})"
        hint = _nearer(targets)
        return Issue("motion.no_reach", what, value=far / MM, limit=0.0, unit="mm", hint=hint, **where)
    if not r.solved[branch, index] and r.exists[:, index].any():  # by branches that end elsewhere
        return _broken(targets, index)
    pose = scene.tcp(targets, grid.values[index], np.full(grid.samples, index))[arm]
    last = targets.last(arm, grid.values[index])
    q = chain.inverse(pose, [branch], last)[:, 0]
    if np.isnan(q[:, 0]).all():  # numbers of an offset wrist are joined along the path
        q = chain.inverse(pose, last=last).reshape(-1, chain.robot.axes)
    q = q[~np.isnan(q[:, 0])]
    limit = chain.best_limit_margin(q)
    best = int(np.argmax(np.minimum(limit, chain.singularity_margin(q))))
    if limit[best] < scene.settings.joint_margin:
        room = np.minimum(q[best] - chain.robot.lower, chain.robot.upper - q[best])
        joint = int(np.argmin(np.where(chain.many_turns, np.inf, room)))
        joint = joint if room[joint] < scene.settings.joint_margin else int(np.argmin(room))
        low, high = chain.robot.lower[joint] / DEG, chain.robot.upper[joint] / DEG
        got = float(q[best, joint]) / DEG
        allowed = f"allowed {low:.0f} to {high:.0f} less {scene.settings.joint_margin / DEG:.1f} deg"
        return Issue(
            "motion.joint_limit",
            f"arm {arm} passes the limit of axis {joint + 1} at target {name}: {got:.1f} deg, {allowed}",
            bodies=(f"axis {joint + 1}",),
            **measurement(float(limit[best]) / DEG, scene.settings.joint_margin / DEG, "deg"),
            hint=_elsewhere(targets) + _less("joint_margin_deg", float(limit[best])),
            **where,
        )
    single = float(chain.singularity_margin(q[best]))
    names = ("wrist (axis 5)", "elbow (axis 3)", "shoulder (axis 1)")
    if chain.spare:  # of what is left with axis 7 held
        names = ("forearm (axis 5)", "elbow (axis 4)", "shoulder (axis 2)")
    which = names[int(np.argmin(chain.singularities(q[best])))]
    return Issue(
        "motion.singular",
        f"arm {arm} is {single / DEG:.1f} deg from a singularity of its {which} at target {name}, "
        f"allowed is {scene.settings.singularity_margin / DEG:.1f} deg at least",
        bodies=(which,),
        **measurement(single / DEG, scene.settings.singularity_margin / DEG, "deg"),
        hint=_elsewhere(targets) + _less("singularity_margin_deg", single),
        **where,
    )


def _beyond(scene: Scene, targets: Targets, grid: Grid, arm: str, index: int) -> float:
    """How far [m] the wrist's centre of a target lies out of reach, at the samples of its freedoms nearest to
    it; 0 where no more than the tool's direction is."""
    pose, chain = scene.tcp(targets, grid.values[index], np.full(grid.samples, index))[arm], scene.chains[arm]
    form = chain.robot.form
    if isinstance(form, OffsetParameters):
        flange = np.linalg.inv(chain.base) @ pose @ np.linalg.inv(chain.tcp)
        return float(offset_wrist.wrist_gap(form, form.inner(flange)).min())
    return float(reach_gap(chain, pose).min())


def _broken(targets: Targets, index: int) -> Issue:
    name = targets.name(index)
    what = f"no choice of branches for {' and '.join(targets.arms)} passes target {name}: up to there the "
    what += "arms can go, but not on without a jump of a joint, or not both with the same freedoms"
    return Issue("motion.no_path", what, index=index, target=name, hint=_elsewhere(targets))


def _wound_up(scene: Scene, targets: Targets, wound: Wound, index: int) -> Issue:
    """A joint that would have to turn on where its limits end."""
    robot, margin = scene.chains[wound.arm].robot, scene.settings.joint_margin
    low, high = (float(end[wound.joint]) / DEG for end in (robot.lower + margin, robot.upper - margin))
    name, span = targets.name(index), f"from {wound.low / DEG:.0f} to {wound.high / DEG:.0f} deg"
    what = f"axis {wound.joint + 1} of arm {wound.arm} would have to turn {span} over the job, as its tool "
    what += f"and its wrist turn; allowed: {low:.0f} to {high:.0f} deg, which ends at target {name}"
    if wound.jumps:
        what = f"axis {wound.joint + 1} of arm {wound.arm} would have to turn on past its limits, and jumps "
        what += f"{span} instead, at target {name}; allowed: {low:.0f} to {high:.0f} deg"
    return Issue(
        "motion.no_path",
        what,
        **measurement(abs(wound.high - wound.low) / DEG, high - low, "deg"),
        arm=wound.arm,
        index=index,
        target=name,
        hint=_elsewhere(targets) + ", turn the tool about its axis on the flange, or split the job there",
    )


def _collision(scene: Scene, targets: Targets, blocked: Blocked) -> Issue:
    """Where all paths end, which samples are free before and after it, and what blocks those there."""
    dead = blocked.dead
    if dead is None and blocked.hit is not None:
        return describe(scene, targets, blocked.hit[1], blocked.hit[0])
    if dead is None or scene.model is None:
        raise ValueError("a search that failed without collisions has another reason")
    open_ = bool(dead.free.any())
    looked = np.flatnonzero((dead.next if open_ else dead.possible) & ~dead.free)
    if not len(looked):
        return _broken(targets, dead.index)
    blocks, (counted, nearest) = _blocking(scene, targets, dead, looked)
    if not blocks:
        return _broken(targets, dead.index)
    best, limit, setting = own_clearance.told(scene.settings, counted, nearest)
    name, count = targets.name(dead.index), len(looked)
    every = (
        f"{count} sample{'s' if count > 1 else ''} of {_names(targets)}"
        if targets.freedoms
        else "one posture"
    )
    shares = ", ".join(f"{block} at {block.count if count > 1 else 'it'}" for block in blocks)
    before = _intervals(targets, dead.grid, dead.index - 1, dead.reached) if dead.reached.any() else ""
    if open_:
        there = _intervals(targets, dead.grid, dead.index, dead.free)
        what = (
            f"no free path goes past target {name}: free there is {there}, but the arms come from "
            f"{before}; the {every} that they could go on to collide: {shares}"
        )
    else:
        what = f"nothing is free at target {name}: the {every} in reach there all collide: {shares}"
        what += f"; free before it is {before}" if before else ""
        if dead.later is not None:
            grid, index, free = dead.later
            what += f"; free again at {targets.name(index)} is {_intervals(targets, grid, index, free)}"
        elif dead.before is not None and dead.index + 1 < targets.count:
            what += "; nothing is free after it"
    tried = len(dead.tried)
    beside = f" between {nearest[0]} and {nearest[1]}" if {*nearest} - {*blocks[0].pair, ""} else ""
    choices = f"all {tried} choices of branches" if tried > 1 else "the only choice of branches"
    return Issue(
        "motion.collision",
        f"{what}; the best of them leaves {_close(best / MM, limit / MM)} mm{beside}, allowed is "
        f"{limit / MM:.1f} mm at least ({choices} tried)",
        index=dead.index,
        target=name,
        bodies=blocks[0].pair,
        **measurement(best / MM, limit / MM, "mm"),
        count=count,
        hint=_room(targets, setting, nearest),
    )


@dataclasses.dataclass(frozen=True)
class Block:
    """Two things of the cell (arms, obstacles, the stock) that are too near each other: at ``count`` samples,
    ``pair`` being the bodies that are so most often."""

    things: tuple[str, str]
    pair: tuple[str, str]
    count: int

    def __str__(self) -> str:
        return f"{self.pair[0]} with {self.pair[1]}"


def _blocking(
    scene: Scene, targets: Targets, dead: Dead, samples: IndexArray
) -> tuple[list[Block], tuple[float, tuple[str, str]]]:
    """Things that are too near each other at ``samples`` (K,) of the target where paths end: those that block
    most, then those that block most of the rest, until all are explained; and the distance [m], as it counts,
    that the best sample leaves, with its pair."""
    if scene.model is None:
        raise ValueError("without a model nothing is in the way")
    q = {arm: r.q[dead.index, samples] for arm, r in dead.rungs.items()}
    index = np.full(len(samples), dead.index)
    wanted = scene.settings.clearance
    found: dict[tuple[str, str], set[int]] = {}
    there = scene.bodies(targets, index) or scene.model
    for ignore, rows in scene.by_kind(targets, index):
        part = scene.model.stack({arm: v[rows] for arm, v in q.items()})
        every = clearance.gradients_at(there.at_rows(rows), part, wanted + TOUCHING_M, ignore)
        for row, near in zip(rows.tolist(), every, strict=True):
            for a, b in near.bodies[near.distance <= wanted].tolist():
                first, second = sorted((scene.model.body_name(a), scene.model.body_name(b)))
                found.setdefault((first, second), set()).add(row)
    bodies = scene.least(targets, q, index, REPORTED_DISTANCE_M)
    least = bodies.distance
    wire, wire_pairs = scene.edge_clearance(targets, q, index)
    for row in np.flatnonzero(wire < wanted).tolist():
        first, second = sorted(wire_pairs[row])
        found.setdefault((first, second), set()).add(row)
    together: dict[tuple[str, str], set[int]] = {}
    for (a, b), hit in found.items():
        together.setdefault((_thing(a), _thing(b)), set()).update(hit)
    out: list[Block] = []
    left = set(range(len(samples)))
    while left and len(out) < MOST_PAIRS and together:
        things = max(sorted(together), key=lambda t: len(together[t] & left))
        if not together[things] & left:
            break
        own = [pair for pair in sorted(found) if (_thing(pair[0]), _thing(pair[1])) == things]
        out.append(Block(things, max(own, key=lambda pair: len(found[pair])), len(together[things])))
        left -= together.pop(things)
    best = int(np.argmax(np.minimum(least, wire)))
    if wire[best] < least[best]:
        return out, (float(wire[best]), wire_pairs[best])
    return out, (float(least[best]), bodies.pair[best])


def _thing(body: str) -> str:
    return body.partition("/")[0]


def _close(value: float, limit: float) -> str:
    """A figure with as many digits as tell it from the limit."""
    return f"{value:.1f}" if abs(value - limit) > 0.1 else f"{value:.3f}"


def _intervals(targets: Targets, grid: Grid, index: int, samples: BoolArray) -> str:
    """The intervals of each freedom over some samples (S,) of a target, as people read them."""
    out = []
    for j, freedom in enumerate(targets.freedoms):
        if float((freedom.upper - freedom.lower).max()) <= 0.0:
            continue
        values, place = np.unique(grid.values[index, :, j].round(9), return_inverse=True)
        used = np.bincount(place.reshape(-1), weights=samples) > 0
        unit, scale = ("mm", MM) if slides_only(freedom) else ("deg", DEG)
        runs = _runs(used, full_turn(freedom))
        if full_turn(freedom) and used.all():
            told = "any"
        else:
            told = " and ".join(_run(values[a] / scale, values[b] / scale) for a, b in runs) + f" {unit}"
        out.append(f"{freedom.name} {told}")
    return ", ".join(out) or "the only posture"


def _run(low: float, high: float) -> str:
    return f"{low:.0f}" if low == high else f"{low:.0f} to {high:.0f}"


def _runs(used: BoolArray, ring: bool) -> list[tuple[int, int]]:
    """First and last of the runs of true ones; on a ring a run may go on from the end to the beginning."""
    edge = np.diff(np.concatenate([[0], used.astype(np.intp), [0]]))
    runs = list(zip(np.flatnonzero(edge > 0).tolist(), (np.flatnonzero(edge < 0) - 1).tolist(), strict=True))
    if ring and len(runs) > 1 and used[0] and used[-1]:
        runs = [*runs[1:-1], (runs[-1][0], runs[0][1])]
    return runs


def describe(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], index: int, count: int = 1
) -> Issue:
    """The closest pair of bodies at one configuration {arm: (6,)} on the way to target ``index``, as an
    issue."""
    if scene.model is None:
        raise ValueError("there are no collisions without a model")
    one = {arm: angles[None] for arm, angles in q.items()}
    found = scene.least(targets, one, np.array([index]), 0.2)
    distance, pair = float(found.distance[0]), found.pair[0]
    wire, wire_pair = scene.edge_clearance(targets, one, np.array([index]))
    if float(wire[0]) < distance:
        distance, pair = float(wire[0]), wire_pair[0]
    distance, limit, setting = own_clearance.told(scene.settings, distance, pair)
    name = targets.name(index)
    return Issue(
        "motion.collision",
        f"{pair[0]} and {pair[1]} are {distance / MM:.1f} mm apart at target {name}, "
        f"allowed is {limit / MM:.1f} mm at least, with {_tried(targets)} tried",
        index=index,
        target=name,
        bodies=pair,
        **measurement(distance / MM, limit / MM, "mm"),
        count=count,
        hint=_room(targets, setting, pair),
    )


def at_support(pair: Sequence[str]) -> bool:
    """Whether two bodies are a tool's working end and what bears the stock: they stand to each other as the
    work has it, wherever the stock is."""
    return "support" in pair and any(body.endswith("/edge") for body in pair)


def _room(targets: Targets, setting: str, pair: tuple[str, str]) -> str:
    """What to do where the bodies of a ``pair`` are too near each other; ``setting`` is the one that asks for
    it."""
    if at_support(pair):
        what = "make room there for the tool in what holds or bears the stock, which moves along with it (a "
        return f"{what}sheet's clamp: a larger opening_mm), take a slimmer tool, or lower {setting}"
    if setting == own_clearance.OWN_FIELD:
        return f"{_else(targets)}, mount the tool otherwise, or lower {setting}"
    return f"{_else(targets)}, move the obstacle, or lower {setting}"


def _held(targets: Targets) -> bool:
    return any(holder is not None for _, holder in holders(targets))


def _nearer(targets: Targets) -> str:
    if _held(targets):
        return (
            "let the place of the held block be found (place: auto), move bases nearer, or take larger arms"
        )
    return "move the stock toward the arm, or take a larger arm"


def _elsewhere(targets: Targets) -> str:
    return f"{_else(targets)}, or let the targets turn more freely"


def _less(field: str, got: float) -> str:
    """The margin [rad] that would let a target pass, where one is left that is worth it."""
    told = float(np.floor(got / DEG * 10.0 - 1e-6)) / 10.0
    return f", or take settings.{field}: {told:g}, which is enough here" if told >= LEAST_MARGIN_DEG else ""


def _else(targets: Targets) -> str:
    if _held(targets):
        return "let the place of the held block be found (place: auto), or grip it otherwise"
    return "move or turn the stock"


def _tried(targets: Targets) -> str:
    names = [f.name for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    return f"every freedom ({', '.join(names)})" if len(names) > 1 else "every freedom"


def _names(targets: Targets) -> str:
    names = [f.name for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    return " and ".join(names) or "no freedom"


def require_moves(scene: Scene, targets: Targets, branch: Mapping[str, int], samples: Dense) -> None:
    """Raises :class:`TandemError` where a linear move between targets leaves reach or passes too near
    something."""
    for arm, q in samples.q.items():
        lost = np.flatnonzero(np.isnan(q).any(axis=1))
        if len(lost):
            index = int(samples.move[lost[0]])
            what = f"arm {arm} cannot follow the straight move to target {targets.name(index)}: between "
            what += f"targets it leaves its reach or its branch {branch[arm]}"
            hint = "put targets closer together there, or move the stock"
            raise refusal(
                "motion.linear_move", what, arm=arm, index=index, target=targets.name(index), hint=hint
            )
    hit = np.flatnonzero(~clear(scene, targets, samples))
    if len(hit):
        row = int(hit[0])
        at = {arm: q[row] for arm, q in samples.q.items()}
        raise TandemError(describe(scene, targets, at, int(samples.move[row]), len(hit)))
