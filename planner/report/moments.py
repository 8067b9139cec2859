"""Which moments of a job are shown as pictures: one of each setup, in the midst of its longest work."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from planner.cell.plant import CellModel
from planner.geometry.rigid import transform
from planner.plans import OperationPlan, Plan
from planner.problem import Mesh, Problem, Setup
from planner.report import cell_picture, scene, standing, sweep
from planner.report.cell_picture import Moment, Picture
from planner.report.replay3d import LEFT

FloatArray = NDArray[np.float64]
SHARE = 0.62
"""How much of the longest cut is done in the picture."""


def pictures(model: CellModel, problem: Problem, plan: Plan | None) -> tuple[tuple[str, Picture], ...]:
    """Titles and pictures of the setups; without a plan the first one, with all arms at home.

    ``model``: the cell, for its robots and fixed bodies; its stock pose is where the block then stands.
    """
    seen = scene.extract(model)
    setups = problem.setups
    if plan is None or not plan.operations:
        shown = _standing(problem, setups[0], model.stock_pose)
        return (("", cell_picture.picture(seen, shown)),)
    out = []
    for setup, place in zip(setups, plan.places, strict=True):
        names = ", ".join(plan.operations[i].name for i in setup.operations)
        title = f"Setup {setup.number}: {names}" if len(setups) > 1 else ""
        out.append((title, cell_picture.picture(seen, _moment(problem, plan, setup, place))))
    return tuple(out)


def _standing(problem: Problem, setup: Setup, place: FloatArray) -> Moment:
    home = {arm.name: np.asarray(arm.home) for arm in setup.cell.arms}
    return Moment(setup, place, home, part=[mesh for _, mesh in sweep.part_meshes(problem.part)])


def _moment(problem: Problem, plan: Plan, setup: Setup, place: FloatArray) -> Moment:
    """The midst of the setup's longest cut, or all arms at home if nothing is cut."""
    still = _standing(problem, setup, place)
    cuts = [(len(rows), -i, rows) for i in setup.operations for rows in _cuts(plan.operations[i])]
    if not cuts:
        return still
    _, minus, rows = max(cuts, key=lambda cut: cut[:2])
    operation = plan.operations[-minus]
    here = int(rows[int(SHARE * (len(rows) - 1))])
    q = {**still.q, **{arm: operation.q[arm][here] for arm in operation.q}}
    done = _done(problem, plan, -minus, here, setup)
    edge, frame = operation.targets.edge, operation.targets.frame[operation.targets.arms[0]]
    wires: list[FloatArray] = []
    if edge is not None and frame in ("stock", "world"):
        before = [int(i) for i in rows if i < here][:: max(1, here // 9)]
        wires = [transform(place if frame == "stock" else np.eye(4), edge.points[i]) for i in (*before, here)]
    wire = wires[-1] if wires else None
    return dataclasses.replace(still, q=q, wire=wire, earlier=wires[:-1], cut=done)


def _cuts(operation: OperationPlan) -> list[NDArray[np.intp]]:
    """Rows of each run of one segment of work."""
    segments = operation.targets.segment
    cut = np.array([segment.works for segment in segments])
    starts = np.flatnonzero(
        cut & np.array([i == 0 or segments[i] != segments[i - 1] for i in range(len(segments))])
    )
    return [
        np.arange(a, next((i for i in range(a, len(segments)) if segments[i] != segments[a]), len(segments)))
        for a in starts
    ]


def _done(problem: Problem, plan: Plan, last: int, here: int, shown: Setup) -> list[Mesh]:
    """What straight wires have cut up to target ``here`` of operation ``last``, within the block as shown."""
    out = []
    for index in range(last + 1):
        operation, setup = plan.operations[index], problem.setup_of(index)
        arm = standing.cutter(setup, operation.targets.arms)
        if arm is None or operation.targets.edge is not None:
            continue
        left = 0.0 if sweep.alike(setup.stock, shown.stock) else LEFT
        place = plan.places[setup.number - 1]
        for rows in _cuts(operation):
            rows = np.append(max(rows[0] - 1, 0), rows)
            rows = rows if index < last else rows[rows <= here]
            if len(rows) < 2:
                continue
            q = {name: joints[rows] for name, joints in operation.q.items()}
            points = standing.wire_in_block(setup, arm, place, plan.bases, q)
            mesh = sweep.surface(points, shown.stock.lower + left, shown.stock.upper - left)
            out += [] if mesh is None else [mesh]
    return out
