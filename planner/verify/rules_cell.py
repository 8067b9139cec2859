"""Rules on clearance: bodies against bodies, and the wire against everything."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.catalogue import robot
from planner.cell import clearance
from planner.cell.edge import Against, edge
from planner.cell.plant import CellModel
from planner.geometry.rigid import from_parts
from planner.issues import Issue
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample
from planner.verify.wire import Wire

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

BETWEEN = 1e-3
"""How much less than the wanted clearance is accepted between targets [m]."""
STRIDE = 0.012
"""Way of any point of an arm between looks [m]."""
REACH = 0.1
MOST = 4000
_FK_SAMPLES = 60
KINEMATICS = 1e-6
NEAR_CLAMP = 0.02
"""Length of wire next to a clamp that is not held against that clamp [m]."""


def looks(context: Context) -> IntArray:
    """Samples at which clearance is measured: no point of an arm moves farther than ``STRIDE`` between
    them."""
    motion = context.motion
    way = np.zeros(len(motion.time))
    for task in context.job.tasks:
        reach = _lever(context, task.arm.name)
        way[1:] += np.abs(np.diff(motion.q[task.arm.name], axis=0)) @ reach
    along = np.cumsum(way)
    count = int(np.clip(np.ceil(along[-1] / STRIDE), 1, MOST))
    marks = np.searchsorted(along, np.linspace(0.0, along[-1], count + 1))
    return np.unique(np.clip(marks, 0, len(along) - 1))


def _lever(context: Context, arm: str) -> FloatArray:
    """How far any point of an arm is from each of its axes at most (6,) [m]."""
    p = robot(context.problem.cell.arm(arm).robot).opw
    tool = float(np.linalg.norm(context.problem.cell.arm(arm).tool.tcp[:3, 3])) + 0.05
    hand = abs(p.c4) + tool
    forearm = float(np.hypot(p.a2, p.c3))
    return np.array(
        [abs(p.a1) + p.c2 + forearm + hand, p.c2 + forearm + hand, forearm + hand, hand, hand, tool]
    )


def kinematics(context: Context, model: CellModel) -> Outcome:
    """Drake's kinematics of the cell puts the tools where the replay has them."""
    motion = context.motion
    rows = np.unique(np.linspace(0, len(motion.time) - 1, _FK_SAMPLES).astype(np.int64))
    issues, worst = [], 0.0
    for k in rows:
        drake = model.checker.UpdatePositions(
            model.stack({arm: q[k : k + 1] for arm, q in motion.q.items()})[0]
        )
        for arm in motion.q:
            body = model.body(f"{arm}/tool")
            pose = model.plant.EvalBodyPoseInWorld(drake, body)
            tcp = from_parts(pose.rotation().matrix(), pose.translation()) @ model.cell.arm(arm).tool.tcp
            off = float(np.abs(tcp - motion.tcp[arm][k]).max())
            worst = max(worst, off)
            if off > KINEMATICS:
                message = f"the tool of {arm} is {mm(off):.5f} mm off where the joints put it"
                issues.append(
                    at_sample(
                        "verify.kinematics",
                        message,
                        context.motion,
                        arm,
                        int(k),
                        (mm(off), mm(KINEMATICS), "mm"),
                    )
                )
    return Outcome(tuple(issues), mm(worst), mm(KINEMATICS), "mm")


def bodies(context: Context, model: CellModel, rows: IntArray) -> tuple[Outcome, clearance.LeastClearance]:
    """Robots, tools, stock and obstacles keep apart."""
    wanted = context.problem.settings.clearance
    found = clearance.least(
        model, {arm: q[rows] for arm, q in context.motion.q.items()}, max(REACH, 1.5 * wanted)
    )
    issues = []
    limit = wanted - BETWEEN
    for i in np.flatnonzero(found.distance < limit):
        pair = found.pair[int(i)]
        message = (
            f"{pair[0]} and {pair[1]} come within {mm(found.distance[i]):.2f} mm; allowed: "
            f"{mm(wanted):.2f} mm"
        )
        issue = at_sample(
            "verify.clearance",
            message,
            context.motion,
            context.job.tasks[0].arm.name,
            int(rows[i]),
            (mm(found.distance[i]), mm(wanted), "mm"),
            pair,
        )
        issues.append(issue)
    k = found.worst()
    where = " and ".join(found.pair[k]) if found.pair[k][0] else "nothing near"
    return Outcome(tuple(issues), mm(found.distance[k]), mm(limit), "mm", where), found


def wire_bodies(
    context: Context, model: CellModel, wires: tuple[Wire, ...]
) -> tuple[Outcome, list[FloatArray]]:
    """The wire keeps clear of everything, but of the stock only where it does not cut."""
    issues: list[Issue] = []
    series, least, where = [], np.inf, ""
    limit = context.problem.settings.clearance
    for wire in wires:
        distance = np.full(len(wire.sample), np.nan)
        series.append(distance)
        if wire.path is None:
            continue
        kinds = context.contacts[0].kinds if context.contacts else ("cut",)
        cut = np.array([label.split("/")[0] in kinds for label in wire.labels])
        groups: tuple[tuple[Against, IntArray], ...] = (
            ("no_stock", np.flatnonzero(cut)),
            ("all", np.flatnonzero(~cut)),
        )
        for against, chosen in groups:
            if not len(chosen):
                continue
            rows = wire.sample[chosen]
            found = edge(
                model,
                {arm: context.motion.q[arm][rows] for arm in wire.phase.claim.arms},
                wire.path.points[chosen],
                0.5 * wire.phase.claim.thickness,
                NEAR_CLAMP,
                against,
            )
            distance[chosen] = found.distance
            for i in np.flatnonzero(found.distance < limit - BETWEEN):
                pair = found.pair[int(i)]
                message = (
                    f"the wire comes within {mm(found.distance[i]):.2f} mm of {' and '.join(pair)}; "
                    f"allowed: {mm(limit):.2f} mm"
                )
                issue = at_sample(
                    "verify.wire_clearance",
                    message,
                    context.motion,
                    wire.phase.claim.arms[0],
                    int(rows[i]),
                    (mm(found.distance[i]), mm(limit), "mm"),
                    pair,
                )
                issues.append(issue)
            k = found.worst()
            if found.distance[k] < least:
                least, where = float(found.distance[k]), " and ".join(found.pair[k])
    if not np.isfinite(least):
        return Outcome(tuple(issues), where="no wire"), series
    return Outcome(tuple(issues), mm(least), mm(limit), "mm", where), series
