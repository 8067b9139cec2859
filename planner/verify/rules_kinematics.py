"""Rules on where robots are: their files against the catalogue, and every link against Drake."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.cell.plant import CellModel
from planner.issues import Issue, TandemError
from planner.verify import machines
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_sample

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Models = Callable[[int], CellModel]

SAMPLES: Final = 1000
"""Samples of a motion at which every link is held against Drake; each setup has a tenth of them at least."""
LINKS: Final = 1e-9
"""How far two ways to work out where a link is may differ [m, and in each entry of the rotation]."""
KINEMATICS: Final = 1e-6
"""How far a tool may be from where the replay has it [m]: the text's figures of the tool are rounded."""


def robot_model(context: Context) -> Outcome:
    """The robots' URDF files are those of arms that the proof can follow, and dimensions and limits that
    the programs were planned with are theirs."""
    issues: list[Issue] = []
    cells = [context.problem.cell, *(setup.cell for setup in context.setups)]
    names = sorted({arm.robot for cell in cells for arm in cell.arms})
    for name in names:
        try:
            differ = machines.differences(machines.of(name))
        except TandemError as error:
            issues += error.issues
            continue
        issues += [Issue(machines.CODE, f"the robot {name}: {what}", hint=machines.HINT) for what in differ]
    return Outcome(tuple(issues), where=", ".join(names))


def kinematics(context: Context, models: Models) -> Outcome:
    """Drake puts every link where the robots' files do, and so does what bounds the clearance; the tools,
    and the block that one holds, are where the replay has them."""
    issues: list[Issue] = []
    worst, count = 0.0, 0
    total = len(context.sample_setup)
    for index in range(len(context.setups)):
        rows = np.flatnonzero(context.sample_setup == index)
        if not len(rows):
            continue
        wanted = max(SAMPLES * len(rows) // total, SAMPLES // 10)
        some = rows[np.unique(np.linspace(0, len(rows) - 1, wanted).astype(np.int64))]
        found, off = _setup(context, models(index), index, some)
        issues += found
        worst, count = max(worst, off), count + len(some)
    return Outcome(tuple(issues), mm(worst), mm(KINEMATICS), "mm", f"every link at {count} samples")


def _setup(context: Context, model: CellModel, index: int, rows: IntArray) -> tuple[list[Issue], float]:
    """Bodies of a setup that are elsewhere by one way than by another at samples ``rows`` (K,), each at its
    worst sample, and how far the replay is off Drake [m]."""
    motion = context.motion
    at_home = {arm.name: np.tile(arm.home, (len(rows), 1)) for arm in model.cell.arms}
    q = at_home | {arm: np.asarray(angles[rows]) for arm, angles in motion.q.items()}
    drake = _drake(model, q)
    held = context.holder(index)
    tools = {f"{arm}/tool": model.cell.arm(arm).tool.tcp for arm in motion.q}
    replayed = {name: motion.tcp[name.removesuffix("/tool")][rows] for name in tools}
    if held is not None and held.arm in motion.q:
        replayed["stock"], tools["stock"] = context.stock_poses(index, rows), np.eye(4)
    places = {name: drake[name] @ tool for name, tool in tools.items()}
    issues, worst = [], 0.0
    for words, ours, theirs, limit in (
        ("by the chain of its URDF, and by Drake", _chains(model, q), drake, LINKS),
        ("by what bounds the clearance, and by Drake", model.poses(q), drake, LINKS),
        ("by the replay, and by Drake", replayed, places, KINEMATICS),
    ):
        for name in sorted(ours.keys() & theirs.keys()):
            off = np.abs(ours[name] - theirs[name]).reshape(len(rows), -1).max(axis=1)
            k = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
            worst = max(worst, float(off[k]))
            if not off[k] <= limit:
                message = f"{name} is at two places that are {mm(off[k]):.6f} mm apart: {words}"
                arm = name.split("/")[0] if name.split("/")[0] in motion.q else next(iter(motion.q))
                sample, measure = int(rows[k]), (mm(off[k]), mm(limit), "mm")
                issues.append(at_sample("verify.kinematics", message, motion, arm, sample, measure, (name,)))
    return issues, worst


def _drake(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Poses (K, 4, 4) in the world of all links and tools, and of a held block, by Drake's plant."""
    names = [f"{arm}/{link}" for arm in model.arms for link in _LINKS]
    names += ["stock"] if model.stock.held_by is not None else []
    some = [model.body(name) for name in names]
    rows = model.stack(q)
    out = np.empty((len(some), len(rows), 4, 4))
    checker, plant = model.checker, model.plant
    for k, row in enumerate(rows):
        at = checker.UpdatePositions(row)
        for i, body in enumerate(some):
            out[i, k] = plant.EvalBodyPoseInWorld(at, body).GetAsMatrix4()
    return dict(zip(names, out, strict=True))


_LINKS: Final = ("base_link", *(f"link_{i}" for i in range(1, 7)), "tool")


def _chains(model: CellModel, q: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The same of the links and the flange, which a tool's body stands in, by the chains of the URDFs."""
    out = {}
    for arm, rows in q.items():
        chain = machines.of(model.cell.arm(arm).robot).chain
        frames = model.bases[arm] @ chain.frames(rows)
        for i, link in enumerate((*chain.links[:6], "tool")):
            out[f"{arm}/{link}"] = frames[:, i]
    return out
