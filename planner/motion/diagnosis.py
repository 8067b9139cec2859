"""Diagnosis of failed path searches.

It says which targets, joints or bodies block the path, and what is free around them.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.catalogue.robots import OffsetParameters, OpwParameters
from planner.cell import clearance
from planner.geometry.arrays import BoolArray, FloatArray, IndexArray
from planner.geometry.units import DEG, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.motion import offset_wrist, self_clearance
from planner.motion.placement_margin import reach_gap
from planner.motion.planning_scene import Scene, frame_holders
from planner.motion.search.layered_graph_search import BlockedSearch, DeadEnd, JointWinding
from planner.motion.search.reach import ArmReach, SampleGrid, is_full_turn, is_sampled_as_slide
from planner.motion.trajectory.joint_path import MoveSamples, is_clear
from planner.targets import Targets

REPORTED_DISTANCE_M: Final = 0.2
"""Distance [m] up to which clearance is reported."""
CONTACT_TOLERANCE_M: Final = 1e-6
"""Added [m] to the required clearance in queries. With a required clearance of 0, overlapping pairs are at
distance 0.
"""

MIN_SUGGESTED_MARGIN_DEG: Final = 0.5
"""Smallest margin [deg] to limits and singularities that a hint suggests."""
MAX_NAMED_PAIRS: Final = 4
"""Maximum number of pairs of bodies that a message names."""


def no_path_issues(scene: Scene, targets: Targets, grid: SampleGrid, blocked: BlockedSearch) -> list[Issue]:
    """Explain why the layered graph has no path.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        grid: Samples of the freedoms that were searched.
        blocked: Result of the failed search.

    Returns:
        At least one issue: ``motion.no_reach``, ``motion.joint_limit``, ``motion.singular``,
        ``motion.no_path`` or ``motion.collision``.
    """
    if blocked.subset is not None:  # the search of a subset of the targets failed, so it explains the failure
        subset_targets, rows = blocked.subset
        subset_issues = no_path_issues(scene, subset_targets, grid, dataclasses.replace(blocked, subset=None))
        return [_restate_for_job(issue, targets, rows) for issue in subset_issues]
    out = [
        issue
        for arm, arm_reach in blocked.reach.items()
        if (issue := _reach_issue(scene, targets, grid, arm, arm_reach))
    ]
    if not out and blocked.common < targets.count:
        winding = blocked.winding
        out = [
            _branch_issue(targets, blocked.common)
            if winding is None
            else _winding_issue(scene, targets, winding, blocked.common)
        ]
    return out or [_blocked_issue(scene, targets, blocked)]


def _restate_for_job(issue: Issue, targets: Targets, rows: IndexArray) -> Issue:
    """Restate an issue of a subset of the targets with index and name of its target in the whole operation.

    ``rows`` (K,) are the indices of the subset in ``targets``.
    """
    if issue.index is None or issue.target is None:
        return issue
    index = int(rows[issue.index])
    name = targets.name(index)
    return dataclasses.replace(
        issue, message=issue.message.replace(issue.target, name), index=index, target=name
    )


def _reach_issue(
    scene: Scene, targets: Targets, grid: SampleGrid, arm: str, arm_reach: ArmReach
) -> Issue | None:
    """Explain why no branch of an arm exists at all targets; None if one does.

    A branch exists at a target if one of its samples keeps all margins. The issue is about the branch that
    exists at most targets from the first one on, and about the first target at which it does not. The cause
    is reach, a joint limit, a singularity, or that the arm could continue only on another branch.
    """
    if arm_reach.branches:
        return None
    ends = np.argmin(arm_reach.exists, axis=1)
    branch = int(np.argmax(ends))
    index = int(ends[branch])  # the first target at which this branch does not exist
    chain = scene.chains[arm]
    count = int((~arm_reach.exists[branch]).sum())
    name = targets.name(index)
    fields: dict[str, Any] = {"arm": arm, "index": index, "target": name, "count": count}
    if not arm_reach.solved[:, index].any():
        message = f"arm {arm} cannot reach target {name}: "
        shortfall = _reach_shortfall(scene, targets, grid, arm, index)
        if shortfall <= 0.0 and not isinstance(chain.robot.form, OpwParameters):
            message += f"its wrist cannot orient the tool as required ({chain.robot.title})"
            return Issue("motion.no_reach", message, hint=_relocation_hint(targets), **fields)
        message += f"its wrist would have to be {shortfall / MM:.0f} mm outside its reach"
        message += f" ({chain.robot.title})"
        hint = _reach_hint(targets)
        return Issue(
            "motion.no_reach", message, value=shortfall / MM, limit=0.0, unit="mm", hint=hint, **fields
        )
    if not arm_reach.solved[branch, index] and arm_reach.exists[:, index].any():
        # Other branches reach this target, so the arm only cannot continue to them.
        return _branch_issue(targets, index)
    # The issue describes the sample with the largest of the smaller margins, to limits and singularities.
    pose = scene.tcp_poses(targets, grid.values[index], np.full(grid.samples, index))[arm]
    redundant_angle = targets.last_joint_angle(arm, grid.values[index])
    q = chain.inverse(pose, [branch], redundant_angle)[:, 0]
    if np.isnan(q[:, 0]).all():  # the branch numbers of an offset wrist are matched along the path
        q = chain.inverse(pose, last_joint=redundant_angle).reshape(-1, chain.robot.axes)
    q = q[~np.isnan(q[:, 0])]
    limit_margin = chain.best_limit_margin(q)
    best = int(np.argmax(np.minimum(limit_margin, chain.singularity_margin(q))))
    if limit_margin[best] < scene.settings.joint_margin:
        margins = np.minimum(q[best] - chain.robot.lower, chain.robot.upper - q[best])
        # Name a joint that violates its margin, and one with many turns only if no other joint does.
        joint = int(np.argmin(np.where(chain.has_many_turns, np.inf, margins)))
        joint = joint if margins[joint] < scene.settings.joint_margin else int(np.argmin(margins))
        return Issue(
            "motion.joint_limit",
            format_message(
                "motion.joint_limit",
                arm=arm,
                axis=joint + 1,
                target=name,
                angle_deg=float(q[best, joint]) / DEG,
                lower_deg=chain.robot.lower[joint] / DEG,
                upper_deg=chain.robot.upper[joint] / DEG,
                margin_deg=scene.settings.joint_margin / DEG,
            ),
            bodies=(f"axis {joint + 1}",),
            **measurement(float(limit_margin[best]) / DEG, scene.settings.joint_margin / DEG, "deg"),
            hint=_relocation_hint(targets) + _margin_hint("joint_margin_deg", float(limit_margin[best])),
            **fields,
        )
    singularity_margin = float(chain.singularity_margin(q[best]))
    names = ("wrist (axis 5)", "elbow (axis 3)", "shoulder (axis 1)")
    if chain.is_redundant:  # the six axes that remain with the redundant axis held
        names = ("forearm (axis 5)", "elbow (axis 4)", "shoulder (axis 2)")
    joint_name = names[int(np.argmin(chain.singularities(q[best])))]
    return Issue(
        "motion.singular",
        format_message(
            "motion.singular",
            arm=arm,
            distance_deg=singularity_margin / DEG,
            joint=joint_name,
            target=name,
            min_distance_deg=scene.settings.singularity_margin / DEG,
        ),
        bodies=(joint_name,),
        **measurement(singularity_margin / DEG, scene.settings.singularity_margin / DEG, "deg"),
        hint=_relocation_hint(targets) + _margin_hint("singularity_margin_deg", singularity_margin),
        **fields,
    )


def _reach_shortfall(scene: Scene, targets: Targets, grid: SampleGrid, arm: str, index: int) -> float:
    """Return the distance [m] of the wrist centre from the reachable region, for the target's nearest sample.

    It is 0 if the wrist centre is within reach and only the orientation of the tool is not.
    """
    pose = scene.tcp_poses(targets, grid.values[index], np.full(grid.samples, index))[arm]
    chain = scene.chains[arm]
    form = chain.robot.form
    if isinstance(form, OffsetParameters):
        flange = np.linalg.inv(chain.base) @ pose @ np.linalg.inv(chain.tcp)
        return float(offset_wrist.wrist_gap(form, form.inner(flange)).min())
    return float(reach_gap(chain, pose).min())


def _branch_issue(targets: Targets, index: int) -> Issue:
    """Return the issue of a target that each arm reaches, but that no combination of branches passes.

    The arms would have to jump to other branches or to other values of their freedoms there.
    """
    name = targets.name(index)
    message = f"no choice of branches for {' and '.join(targets.arms)} passes target {name}: the arms can "
    message += "reach it, but they cannot continue without a joint jump or with the same freedoms"
    return Issue("motion.no_path", message, index=index, target=name, hint=_relocation_hint(targets))


def _winding_issue(scene: Scene, targets: Targets, winding: JointWinding, index: int) -> Issue:
    """Return the issue of a joint that would have to turn beyond its limits to follow the path.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        winding: The joint, and the range of angles that it would need.
        index: Target at which the joint leaves its limits.
    """
    robot, margin = scene.chains[winding.arm].robot, scene.settings.joint_margin
    low, high = (float(end[winding.joint]) / DEG for end in (robot.lower + margin, robot.upper - margin))
    name, span = targets.name(index), f"from {winding.low / DEG:.0f} to {winding.high / DEG:.0f} deg"
    message = (
        f"axis {winding.joint + 1} of arm {winding.arm} would have to turn {span} over the job, because its "
    )
    message += f"tool and wrist turn; allowed: {low:.0f} to {high:.0f} deg, which it leaves at target {name}"
    if winding.jumps:
        message = (
            f"axis {winding.joint + 1} of arm {winding.arm} would have to turn beyond its limits and jumps "
        )
        message += f"{span} instead at target {name}; allowed: {low:.0f} to {high:.0f} deg"
    return Issue(
        "motion.no_path",
        message,
        **measurement(abs(winding.high - winding.low) / DEG, high - low, "deg"),
        arm=winding.arm,
        index=index,
        target=name,
        hint=_relocation_hint(targets)
        + ", turn the tool about its axis on the flange, or split the job there",
    )


def _blocked_issue(scene: Scene, targets: Targets, blocked: BlockedSearch) -> Issue:
    """Return the collision issue of the target that no path passes.

    It lists the samples that are free before and after it, and the bodies that collide at it. If no pair of
    bodies explains the dead end, the issue is that the arms cannot continue on any branches. Without a dead
    end, the collision that the search found on a move is reported.

    Raises:
        ValueError: The search did not fail because of collisions.
    """
    dead = blocked.dead_end
    if dead is None and blocked.collision is not None:
        return collision_issue(scene, targets, blocked.collision[1], blocked.collision[0])
    if dead is None or scene.model is None:
        raise ValueError("the search did not fail because of collisions")
    # If some samples are free, the samples to which the arms could continue block the path. If none is free,
    # all samples in reach do.
    has_free = bool(dead.free.any())
    colliding = np.flatnonzero((dead.next if has_free else dead.possible) & ~dead.free)
    if not len(colliding):
        return _branch_issue(targets, dead.index)
    blocks, (counted_distance, nearest) = _collision_groups(scene, targets, dead, colliding)
    if not blocks:
        return _branch_issue(targets, dead.index)
    best, limit, setting = self_clearance.true_distance(scene.settings, counted_distance, nearest)
    name, count = targets.name(dead.index), len(colliding)
    sample_text = (
        f"{count} sample{'s' if count > 1 else ''} of {_freedom_names(targets)}"
        if targets.freedoms
        else "one posture"
    )
    block_texts = ", ".join(f"{block} at {block.count if count > 1 else 'it'}" for block in blocks)
    free_before = (
        _freedom_intervals(targets, dead.grid, dead.index - 1, dead.reached) if dead.reached.any() else ""
    )
    # Either some postures are free but not connected to the previous target, or none is free.
    if has_free:
        free_here = _freedom_intervals(targets, dead.grid, dead.index, dead.free)
        message = (
            f"no free path passes target {name}: {free_here} is free there, but the arms come from "
            f"{free_before}; the {sample_text} to which they could continue collide: {block_texts}"
        )
    else:
        message = (
            f"no posture is free at target {name}: the {sample_text} in reach there all collide: "
            f"{block_texts}"
        )
        message += f"; before it, {free_before} is free" if free_before else ""
        if dead.later is not None:
            grid, index, free = dead.later
            message += (
                f"; at {targets.name(index)}, {_freedom_intervals(targets, grid, index, free)} is free again"
            )
        elif dead.find_connections is not None and dead.index + 1 < targets.count:
            message += "; no posture is free after it"
    tried = len(dead.tried)
    between_text = f" between {nearest[0]} and {nearest[1]}" if {*nearest} - {*blocks[0].pair, ""} else ""
    choices = f"all {tried} choices of branches" if tried > 1 else "the only choice of branches"
    return Issue(
        "motion.collision",
        f"{message}; the best of them leaves {_format_near_limit(best / MM, limit / MM)} mm{between_text} "
        f"(at least {limit / MM:.1f} mm required; {choices} tried)",
        index=dead.index,
        target=name,
        bodies=blocks[0].pair,
        **measurement(best / MM, limit / MM, "mm"),
        count=count,
        hint=_clearance_hint(targets, setting, nearest),
    )


@dataclasses.dataclass(frozen=True)
class CollisionGroup:
    """Two owners of bodies (arms, obstacles, the stock) that are too close to each other.

    Attributes:
        owners: Names of the two owners.
        pair: The pair of bodies that is too close most often.
        count: Number of samples at which the owners are too close.
    """

    owners: tuple[str, str]
    pair: tuple[str, str]
    count: int

    def __str__(self) -> str:
        return f"{self.pair[0]} with {self.pair[1]}"


def _collision_groups(
    scene: Scene, targets: Targets, dead: DeadEnd, samples: IndexArray
) -> tuple[list[CollisionGroup], tuple[float, tuple[str, str]]]:
    """Group the bodies that are too close at a target that no path passes, and find its best sample.

    The message of the issue names both. The groups are chosen greedily until all samples are explained, at
    most :data:`MAX_NAMED_PAIRS`: first the group that blocks most samples, then the one that blocks most of
    the rest.

    Args:
        scene: Cell with a collision model.
        targets: Targets of the operation.
        dead: The target, with the joints of its samples.
        samples: (K,) indices of the samples that collide.

    Returns:
        The groups, and the smallest counted distance [m] of the sample where it is largest, with its pair of
        bodies. See :mod:`planner.motion.self_clearance` for counted distances.
    """
    if scene.model is None:
        raise ValueError("without a collision model nothing can collide")
    # Collect the samples at which each pair of bodies (or the wire with a body) is too close.
    q = {arm: arm_reach.q[dead.index, samples] for arm, arm_reach in dead.states.items()}
    index = np.full(len(samples), dead.index)
    required = scene.settings.clearance
    samples_by_pair: dict[tuple[str, str], set[int]] = {}
    model = scene.model_at(targets, index) or scene.model
    for ignored_pairs, rows in scene.split_by_contacts(targets, index):
        joints = scene.model.stack_rows({arm: v[rows] for arm, v in q.items()})
        queries = clearance.distance_gradients_at(
            model.at_rows(rows), joints, required + CONTACT_TOLERANCE_M, ignored_pairs
        )
        for row, query in zip(rows.tolist(), queries, strict=True):
            for a, b in query.bodies[query.distance <= required].tolist():
                first, second = sorted((scene.model.body_name(a), scene.model.body_name(b)))
                samples_by_pair.setdefault((first, second), set()).add(row)
    closest = scene.smallest_clearances(targets, q, index, REPORTED_DISTANCE_M)
    distances = closest.distance
    wire_distances, wire_pairs = scene.edge_clearance(targets, q, index)
    for row in np.flatnonzero(wire_distances < required).tolist():
        first, second = sorted(wire_pairs[row])
        samples_by_pair.setdefault((first, second), set()).add(row)
    # Group the pairs by their owners, then cover the samples greedily by groups.
    samples_by_owners: dict[tuple[str, str], set[int]] = {}
    for (a, b), samples_hit in samples_by_pair.items():
        samples_by_owners.setdefault((_owner(a), _owner(b)), set()).update(samples_hit)
    out: list[CollisionGroup] = []
    unexplained = set(range(len(samples)))
    while unexplained and len(out) < MAX_NAMED_PAIRS and samples_by_owners:
        owners = max(sorted(samples_by_owners), key=lambda t: len(samples_by_owners[t] & unexplained))
        if not samples_by_owners[owners] & unexplained:
            break
        pairs = [pair for pair in sorted(samples_by_pair) if (_owner(pair[0]), _owner(pair[1])) == owners]
        out.append(
            CollisionGroup(
                owners,
                max(pairs, key=lambda pair: len(samples_by_pair[pair])),
                len(samples_by_owners[owners]),
            )
        )
        unexplained -= samples_by_owners.pop(owners)
    best = int(np.argmax(np.minimum(distances, wire_distances)))
    if wire_distances[best] < distances[best]:
        return out, (float(wire_distances[best]), wire_pairs[best])
    return out, (float(distances[best]), closest.pair[best])


def _owner(body: str) -> str:
    """Return the arm, obstacle or stock that a body belongs to, which is the first part of its name."""
    return body.partition("/")[0]


def _format_near_limit(value: float, limit: float) -> str:
    """Format a value with as many digits as are needed to tell it from the limit."""
    return f"{value:.1f}" if abs(value - limit) > 0.1 else f"{value:.3f}"


def _freedom_intervals(targets: Targets, grid: SampleGrid, index: int, samples: BoolArray) -> str:
    """Describe the values that each freedom takes in some samples of a target, as text with units.

    ``samples`` (S,) says which samples of the grid count. Neighbouring values become one interval. Freedoms
    with an empty range are left out.
    """
    out = []
    for j, freedom in enumerate(targets.freedoms):
        if float((freedom.upper - freedom.lower).max()) <= 0.0:
            continue
        values, value_index = np.unique(grid.values[index, :, j].round(9), return_inverse=True)
        used = np.bincount(value_index.reshape(-1), weights=samples) > 0
        unit, scale = ("mm", MM) if is_sampled_as_slide(freedom) else ("deg", DEG)
        runs = _true_runs(used, is_full_turn(freedom))
        if is_full_turn(freedom) and used.all():
            text = "any"
        else:
            text = (
                " and ".join(_format_interval(values[a] / scale, values[b] / scale) for a, b in runs)
                + f" {unit}"
            )
        out.append(f"{freedom.name} {text}")
    return ", ".join(out) or "the only posture"


def _format_interval(low: float, high: float) -> str:
    return f"{low:.0f}" if low == high else f"{low:.0f} to {high:.0f}"


def _true_runs(used: BoolArray, is_ring: bool) -> list[tuple[int, int]]:
    """Return first and last index of each run of true values.

    On a ring, a run at the end continues in the run at the start. Its first index exceeds its last one.
    """
    edge = np.diff(np.concatenate([[0], used.astype(np.intp), [0]]))
    runs = list(zip(np.flatnonzero(edge > 0).tolist(), (np.flatnonzero(edge < 0) - 1).tolist(), strict=True))
    if is_ring and len(runs) > 1 and used[0] and used[-1]:
        runs = [*runs[1:-1], (runs[-1][0], runs[0][1])]
    return runs


def collision_issue(
    scene: Scene, targets: Targets, q: Mapping[str, FloatArray], index: int, count: int = 1
) -> Issue:
    """Return the issue ``motion.collision`` with the closest pair of bodies at one configuration.

    Args:
        scene: Cell with a collision model.
        targets: Targets of the operation.
        q: {arm: (6,)} [rad] joints.
        index: Target to which the arms move.
        count: Number of configurations that collide, which the issue reports.

    Raises:
        ValueError: The scene has no collision model.
    """
    if scene.model is None:
        raise ValueError("without a collision model there are no collisions")
    single = {arm: angles[None] for arm, angles in q.items()}
    closest = scene.smallest_clearances(targets, single, np.array([index]), 0.2)
    distance, pair = float(closest.distance[0]), closest.pair[0]
    wire_distance, wire_pair = scene.edge_clearance(targets, single, np.array([index]))
    if float(wire_distance[0]) < distance:
        distance, pair = float(wire_distance[0]), wire_pair[0]
    distance, limit, setting = self_clearance.true_distance(scene.settings, distance, pair)
    name = targets.name(index)
    return Issue(
        "motion.collision",
        f"{pair[0]} and {pair[1]} are {distance / MM:.1f} mm apart at target {name} "
        f"(at least {limit / MM:.1f} mm required), with {_tried_freedoms(targets)} tried",
        index=index,
        target=name,
        bodies=pair,
        **measurement(distance / MM, limit / MM, "mm"),
        count=count,
        hint=_clearance_hint(targets, setting, pair),
    )


def is_tool_and_support(pair: Sequence[str]) -> bool:
    """Whether a pair is the working end of a tool and the support of the stock.

    Their relative pose follows from the work, wherever the stock is.
    """
    return "support" in pair and any(body.endswith("/edge") for body in pair)


def _clearance_hint(targets: Targets, setting: str, pair: tuple[str, str]) -> str:
    """Return a hint for a ``pair`` of bodies that are too close.

    ``setting`` is the name of the setting that requires the clearance.
    """
    if is_tool_and_support(pair):
        advice = (
            "make room for the tool in the fixture or support, which moves with the stock (for the clamp "
        )
        return f"{advice}of a sheet: a larger opening_mm), use a slimmer tool, or lower {setting}"
    if setting == self_clearance.SELF_CLEARANCE_FIELD:
        return f"{_move_stock_hint(targets)}, change how the tool is mounted, or lower {setting}"
    return f"{_move_stock_hint(targets)}, move the obstacle, or lower {setting}"


def _holds_stock(targets: Targets) -> bool:
    """Whether an arm holds the stock in any frame of the targets."""
    return any(holder is not None for _, holder in frame_holders(targets))


def _reach_hint(targets: Targets) -> str:
    if _holds_stock(targets):
        return "let the planner place the held stock (place: auto), move the bases closer, or use larger arms"
    return "move the stock toward the arm, or use a larger arm"


def _relocation_hint(targets: Targets) -> str:
    return f"{_move_stock_hint(targets)}, or give the targets more freedom"


def _margin_hint(field: str, margin: float) -> str:
    """Return the end of a hint that suggests a smaller value of a margin setting, or an empty text.

    Args:
        field: Name of the setting.
        margin: Margin [rad] that the target has. It is suggested, rounded down, if it is at least
            :data:`MIN_SUGGESTED_MARGIN_DEG`.
    """
    suggested_deg = float(np.floor(margin / DEG * 10.0 - 1e-6)) / 10.0  # rounded down to 0.1 deg
    return (
        f", or set settings.{field}: {suggested_deg:g}, which is enough here"
        if suggested_deg >= MIN_SUGGESTED_MARGIN_DEG
        else ""
    )


def _move_stock_hint(targets: Targets) -> str:
    if _holds_stock(targets):
        return "let the planner place the held stock (place: auto), or grip it differently"
    return "move or rotate the stock"


def _tried_freedoms(targets: Targets) -> str:
    """Say that all freedoms were tried, with their names if there are several."""
    names = [f.name for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    return f"every freedom ({', '.join(names)})" if len(names) > 1 else "every freedom"


def _freedom_names(targets: Targets) -> str:
    """Return the names of the freedoms whose range is not empty."""
    names = [f.name for f in targets.freedoms if float((f.upper - f.lower).max()) > 0.0]
    return " and ".join(names) or "no freedom"


def require_linear_moves(
    scene: Scene, targets: Targets, branch: Mapping[str, int], samples: MoveSamples
) -> None:
    """Require that the linear moves between targets stay within reach and keep clearance.

    The first move that does not is reported.

    Args:
        scene: Cell with the stock in its pose.
        targets: Targets of the operation.
        branch: {arm: branch} that the moves keep.
        samples: Joints along the moves, NaN where a pose has no solution on the branch.

    Raises:
        TandemError: ``motion.linear_move`` or ``motion.collision``.
    """
    for arm, q in samples.q.items():
        unreached = np.flatnonzero(np.isnan(q).any(axis=1))
        if len(unreached):
            index = int(samples.move[unreached[0]])
            message = f"arm {arm} cannot follow the straight move to target {targets.name(index)}: between "
            message += f"the targets it leaves its reach or its branch {branch[arm]}"
            hint = "place the targets closer together there, or move the stock"
            raise issue_error(
                "motion.linear_move", message, arm=arm, index=index, target=targets.name(index), hint=hint
            )
    colliding = np.flatnonzero(~is_clear(scene, targets, samples))
    if len(colliding):
        row = int(colliding[0])
        joints = {arm: q[row] for arm, q in samples.q.items()}
        raise TandemError(collision_issue(scene, targets, joints, int(samples.move[row]), len(colliding)))
