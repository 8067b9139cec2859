"""Duration of a proof: a small job, its parts, and refusal of a faulty program."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.processes.hotwire.proof.wire_motion import follow_wire, mounted_phases
from planner.proof.context import Context
from planner.proof.kinematics import arm_model
from planner.proof.prove import Prover
from planner.proof.rule_table import built_in
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job, small_job
from tests.proof.mutants import MUTATORS

TARGETS = 220
"""Targets of each face: with entry, link and exit about 460 in all."""
BOW_TARGETS = 100
"""Targets of each of two ruled faces; lead-ins and lead-outs make it about 400 in all."""
POSES = 100_000
"""Number of postures of each of two arms whose flange pose is computed."""


def run() -> list[dict[str, Any]]:
    """Rows of name, median and spread in seconds, and a note."""
    programs = small_job.programs(TARGETS)
    problem, claims = small_job.problem(), small_job.claims()
    prover = Prover(problem, claims)
    proof = prover.prove(programs)
    if not proof.ok:
        raise RuntimeError(f"the clean job is not proven: {[str(issue) for issue in proof.issues]}")
    context = Context(problem, claims, programs)
    moves = sum(len(stage.moves(task.name)) for stage in context.job.stages for task in context.job.tasks)
    wrong = MUTATORS["wrong_time"][1](np.random.default_rng(1), programs)

    def replay() -> None:
        Context(problem, claims, programs).motion  # noqa: B018

    def wire() -> None:
        follow_wire(context, *mounted_phases(context)[0])

    _ = context.motion
    bows = []
    for name, job in (("one arm, two setups", straight_job), ("held block, two setups", held_job)):
        texts, other = job.programs(BOW_TARGETS), Prover(job.problem(), job.claims())
        if not other.prove(texts).ok:
            raise RuntimeError(f"the clean job with a bow, {name}, is not proven")
        note = f"{BOW_TARGETS} targets a face"
        bows.append(_row(f"verify: bow, {name}", functools.partial(other.prove, texts), note, 3))
    return [
        *bows,
        _poses(),
        _row(
            "verify: whole proof", lambda: prover.prove(programs), f"{moves} moves, {len(built_in())} rules"
        ),
        _row(
            "verify: cold, with the Drake model", lambda: Prover(problem, claims).prove(programs), "3 runs", 3
        ),
        _row("verify: read and replay", replay, f"{len(context.motion.time)} samples of 4 ms, two arms"),
        _row(
            "verify: follow the wire",
            wire,
            f"{len(follow_wire(context, *mounted_phases(context)[0]).sample)} shapes",
        ),
        _row(
            "verify: refuse a wrong time",
            lambda: prover.prove(wrong, first_error=True),
            "stops at the first fault",
        ),
    ]


def _poses() -> dict[str, Any]:
    """The flanges of two arms by the chains of their URDFs; the peer is the planner's own chain."""
    arms = [arm_model.robot_machine(robot(name)) for name in ("irb140", "kr210_r2700")]
    rng = np.random.default_rng(4)
    q = [rng.uniform(arm.data.lower, arm.data.upper, (POSES, 6)) for arm in arms]

    def ours() -> None:
        for arm, rows in zip(arms, q, strict=True):
            arm.flange(rows)

    def planners() -> None:
        for arm, rows in zip(arms, q, strict=True):
            forward_kinematics(arm.data, rows)

    row = _row("verify: poses by URDF, 100,000 x 2", ours, "two arms; peer: the planner's own chain")
    return row | {"ratio": _row("", planners, "")["median_s"] / row["median_s"]}


def _row(name: str, work: Callable[[], object], note: str, repeats: int = 5) -> dict[str, Any]:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return {
        "name": name,
        "median_s": statistics.median(times),
        "spread": max(times) - min(times),
        "note": note,
    }
