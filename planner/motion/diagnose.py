"""Says why there is no path: which targets, joints or bodies are in the way, and whether moving the stock
would help."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.issues import Issue, TandemError
from planner.motion.joints import Dense
from planner.motion.placement import reach_gap
from planner.motion.reach import Grid, Reach, reach, sample
from planner.motion.scene import Scene, holders
from planner.motion.search import Blocked
from planner.motion.subset import subset
from planner.targets import Targets
from planner.units import DEG, MM

FloatArray = NDArray[np.float64]

SHIFTS: Final = (0.05, 0.1, 0.2, 0.3)
SUBSAMPLE: Final = 24


def no_path(scene: Scene, targets: Targets, grid: Grid, blocked: Blocked) -> list[Issue]:
    """Issues that say why the ladder has no path."""
    if blocked.few is not None:
        few, rows = blocked.few
        help_ = shift_that_helps(scene, targets)
        some = no_path(scene, few, grid, dataclasses.replace(blocked, few=None))
        return [_in_job(issue, targets, rows, help_) for issue in some]
    out = [issue for arm, r in blocked.reach.items() if (issue := _unreached(scene, targets, grid, arm, r))]
    if not out and blocked.common < targets.count:
        out = [_broken(targets, blocked.common)]
    if not out:
        out = [_collision(scene, targets, blocked)]
    help_ = shift_that_helps(scene, targets)
    return [dataclasses.replace(issue, hint=help_ or issue.hint) for issue in out]


def _in_job(issue: Issue, targets: Targets, rows: NDArray[np.intp], help_: str | None) -> Issue:
    """An issue of some of the targets, ``rows`` (K,), as one of the whole job."""
    if issue.index is None or issue.target is None:
        return issue
    index = int(rows[issue.index])
    name = targets.name(index)
    return dataclasses.replace(
        issue,
        message=issue.message.replace(issue.target, name),
        index=index,
        target=name,
        hint=help_ or issue.hint,
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
    if not r.solved[branch, index]:
        far = _beyond(scene, targets, grid, arm, index)
        return Issue(
            "motion.no_reach",
            f"arm {arm} cannot reach target {name}: its wrist would have to be {far / MM:.0f} mm "
            f"beyond what the arm reaches ({chain.robot.title})",
            value=far / MM,
            limit=0.0,
            unit="mm",
            hint=_nearer(targets),
            arm=arm,
            index=index,
            target=name,
            count=count,
        )
    pose = scene.tcp(targets, grid.values[index], np.full(grid.samples, index))[arm]
    q = chain.inverse(pose, [branch])[:, 0]
    q = q[~np.isnan(q[:, 0])]
    limit = np.stack(chain.limit_margins(q, chain.turns)).max(axis=0)
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
            value=float(limit[best]) / DEG,
            limit=scene.settings.joint_margin / DEG,
            unit="deg",
            hint=_elsewhere(targets),
            arm=arm,
            index=index,
            target=name,
            count=count,
        )
    single = float(chain.singularity_margin(q[best]))
    which = ("wrist (axis 5)", "elbow (axis 3)", "shoulder (axis 1)")[
        int(np.argmin(chain.singularities(q[best])))
    ]
    return Issue(
        "motion.singular",
        f"arm {arm} is {single / DEG:.1f} deg from a singularity of its {which} at target {name}, "
        f"allowed is {scene.settings.singularity_margin / DEG:.1f} deg at least",
        bodies=(which,),
        value=single / DEG,
        limit=scene.settings.singularity_margin / DEG,
        unit="deg",
        hint=_elsewhere(targets),
        arm=arm,
        index=index,
        target=name,
        count=count,
    )


def _beyond(scene: Scene, targets: Targets, grid: Grid, arm: str, index: int) -> float:
    """How far [m] the wrist's centre of a target lies out of reach, at the samples of its freedoms nearest to
    it."""
    pose = scene.tcp(targets, grid.values[index], np.full(grid.samples, index))[arm]
    return float(reach_gap(scene.chains[arm], pose).min())


def _broken(targets: Targets, index: int) -> Issue:
    name = targets.name(index)
    return Issue(
        "motion.no_path",
        f"no choice of branches for {' and '.join(targets.arms)} passes target {name}: up to there the arms "
        f"can go, but not on without a jump of a joint, or not both with the same freedoms",
        index=index,
        target=name,
        hint=_elsewhere(targets),
    )


def _collision(scene: Scene, targets: Targets, blocked: Blocked) -> Issue:
    """The first target of the last path that collides, with the pair of bodies."""
    if blocked.hit is not None:
        return describe(scene, targets, blocked.hit[1], blocked.hit[0])
    if blocked.path is None or blocked.collided is None or scene.model is None:
        raise ValueError("a search that failed without collisions has another reason")
    rows = np.arange(targets.count)
    hit = np.flatnonzero(blocked.collided[rows, blocked.path.path.sample])
    closed = np.flatnonzero(blocked.collided.all(axis=1))
    index = int(closed[0]) if len(closed) else int(hit[0]) if len(hit) else 0
    return describe(scene, targets, {a: q[index] for a, q in blocked.path.q.items()}, index, len(hit) or 1)


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
    name = targets.name(index)
    return Issue(
        "motion.collision",
        f"{pair[0]} and {pair[1]} are {distance / MM:.1f} mm apart at target {name}, "
        f"allowed is {scene.settings.clearance / MM:.1f} mm at least, with {_tried(targets)} tried",
        index=index,
        target=name,
        bodies=pair,
        value=distance / MM,
        limit=scene.settings.clearance / MM,
        unit="mm",
        count=count,
        hint=f"{_else(targets)}, move the obstacle, or lower clearance_mm",
    )


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


def _else(targets: Targets) -> str:
    if _held(targets):
        return "let the place of the held block be found (place: auto), or grip it otherwise"
    return "move or turn the stock"


def _tried(targets: Targets) -> str:
    names = [f.name for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    return f"every freedom ({', '.join(names)})" if len(names) > 1 else "every freedom"


def require_moves(scene: Scene, targets: Targets, branch: Mapping[str, int], samples: Dense) -> None:
    """Raises :class:`TandemError` where a linear move between targets leaves reach or passes too near
    something."""
    for arm, q in samples.q.items():
        lost = np.flatnonzero(np.isnan(q).any(axis=1))
        if len(lost):
            index = int(samples.move[lost[0]])
            raise TandemError(
                Issue(
                    "motion.linear_move",
                    f"arm {arm} cannot follow the straight move to target {targets.name(index)}: "
                    f"between targets it leaves its reach or its branch {branch[arm]}",
                    arm=arm,
                    index=index,
                    target=targets.name(index),
                    hint="put targets closer together there, or move the stock",
                )
            )
    hit = np.flatnonzero(~clear(scene, targets, samples))
    if len(hit):
        row = int(hit[0])
        at = {arm: q[row] for arm, q in samples.q.items()}
        raise TandemError(describe(scene, targets, at, int(samples.move[row]), len(hit)))


def clear(scene: Scene, targets: Targets, samples: Dense) -> NDArray[np.bool_]:
    """(K,) whether samples of the moves keep clearance; the edge between targets is taken from the nearer
    target."""
    near = np.where(samples.share >= 0.5, samples.move, samples.move - 1)
    return scene.free(targets, samples.q, np.maximum(near, 0), samples.move)


def shift_that_helps(scene: Scene, targets: Targets) -> str | None:
    """The shortest shift of the stock along the world's axes after which every arm has a branch for all of a
    sample of the targets, as a sentence; None if none does."""
    if any(targets.frame.get(arm, "stock") != "stock" for arm in targets.arms):
        return None
    for size in SHIFTS:
        for axis in range(3):
            for sign in (1.0, -1.0):
                shift = np.zeros(3)
                shift[axis] = sign * size
                if _reaches(scene, targets, shift):
                    way = f"{sign * size / MM:+.0f} mm in {'xyz'[axis]}"
                    return f"moving the stock by {way} would bring every target within reach of all arms"
    return None


def _reaches(scene: Scene, targets: Targets, shift: FloatArray) -> bool:
    rows = np.unique(np.linspace(0, targets.count - 1, min(SUBSAMPLE, targets.count)).astype(np.intp))
    few = subset(targets, rows)
    moved = scene.stock.copy()
    moved[:3, 3] += shift
    table = reach(dataclasses.replace(scene, stock=moved, model=None), few, sample(few, np.deg2rad(20.0)))
    return all(r.branches for r in table.values())
