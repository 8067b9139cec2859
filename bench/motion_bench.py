"""Reach, ladder, trajectory optimisation and timing of whole jobs; ``bench tesseract`` has the ladder's peer.

Times are processor time of this process on one core, so that other work on the machine does not count; wall
time is in the note. Run with OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import dataclasses
import resource
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from py_opw_kinematics import KinematicModel, Robot
from scipy.spatial.transform import RigidTransform

from bench import motion_bows
from bench.motion_jobs import arc_wire, block, box, s_curve, spiral_pair, two_arms
from planner.catalogue.robots import robot
from planner.cell import plant
from planner.cell.kinematics import flange_poses, forward_kinematics
from planner.geometry.arrays import from_parts
from planner.motion import planning_scene
from planner.motion.operation import plan_operation
from planner.motion.placement import PlacementJob, PlacementSearch
from planner.motion.planning_scene import Scene
from planner.motion.solve import solve
from planner.problem import Obstacle, Problem, Settings
from tests.urdf_text import PANDA_FORM, UR10E

REPEATS = 5
CORE = ("ladder", "transit", "trajopt", "timing")
HIGH = from_parts(np.eye(3), np.array([0.0, 0.0, 0.5]))
SIZE = (0.16, 0.7, 0.1)


def time_work(work: Callable[[], Any], repeats: int = REPEATS) -> tuple[dict[str, Any], Any]:
    """Median and spread (largest less smallest) of processor time, and the last result."""
    out = work()
    cpu, wall = [], []
    for _ in range(repeats):
        start, clock = time.process_time(), time.perf_counter()
        out = work()
        cpu.append(time.process_time() - start)
        wall.append(time.perf_counter() - clock)
    row = {"median_s": float(np.median(cpu)), "spread": max(cpu) - min(cpu)}
    return {**row, "note": f"wall {np.median(wall):.3f} s"}, out


def run() -> list[dict[str, Any]]:
    """All measurements of motion."""
    return [
        inverse(),
        inverse_three_parallel(),
        inverse_offset_wrist(),
        inverse_seven_axes(),
        *jobs(),
        one_arm(400),
        one_arm(4000),
        many_targets(),
        *bows(),
        placement(),
    ]


def inverse() -> dict[str, Any]:
    """All eight branches of 10,000 poses of an IRB 140, against py-opw-kinematics."""
    data = robot("irb140")
    q = np.random.default_rng(0).uniform(data.lower, data.upper, (10_000, 6))
    flange = forward_kinematics(data, q)
    ours, _ = time_work(lambda: planning_scene.inverse_kinematics(data.opw, flange))
    p = data.opw
    model = KinematicModel(p.a1, p.a2, p.b, p.c1, p.c2, p.c3, p.c4, tuple(p.offsets), (False,) * 6)
    peer = Robot(model, degrees=False)
    poses = RigidTransform.from_matrix(flange)
    theirs, _ = time_work(lambda: peer.reach(poses, [(-20.0, 20.0)] * 6))
    rate = 10_000 / ours["median_s"]
    note = f"{rate:,.0f} poses/s; peer py-opw-kinematics reach (with its margins) {theirs['median_s']:.3f} s"
    return {
        "name": "IK, 8 branches, 10,000 poses",
        **ours,
        "ratio": ours["median_s"] / theirs["median_s"],
        "note": note,
    }


def inverse_three_parallel() -> dict[str, Any]:
    """All eight branches of 10,000 poses of a UR10e; EAIK is the peer of ``bench peers``."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (10_000, 6))
    flange = forward_kinematics(UR10E, q)
    row, _ = time_work(lambda: planning_scene.inverse_kinematics(UR10E.form, flange))
    note = f"{10_000 / row['median_s']:,.0f} poses/s"
    return {"name": "IK, 8 branches, 10,000 poses, UR10e", **row, "note": note}


def inverse_offset_wrist() -> dict[str, Any]:
    """All branches of 1,000 poses of a GoFa; ssik is the peer of ``bench peers``."""
    data = robot("crb15000_5_95")
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (1000, 6))
    flange = forward_kinematics(data, q)
    row, found = time_work(lambda: planning_scene.inverse_kinematics(data.form, flange))
    count = int(np.sum(~np.isnan(found[..., 0])))
    note = f"{1000 / row['median_s']:,.0f} poses/s, {count:,} solutions"
    return {"name": "IK, up to 16 solutions, 1,000 poses, GoFa", **row, "note": note}


def inverse_seven_axes() -> dict[str, Any]:
    """All eight branches of 10,000 poses of a Panda, each with an angle of its last joint; EAIK and ssik find
    as many (`tests/motion/test_seven_axes.py`)."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (10_000, 7))
    flange = flange_poses(PANDA_FORM, q)
    row, _ = time_work(lambda: planning_scene.inverse_kinematics(PANDA_FORM, flange, last_joint=q[:, 6]))
    note = f"{10_000 / row['median_s']:,.0f} poses/s"
    return {"name": "IK, 8 branches, 10,000 poses, Panda", **row, "note": note}


def jobs() -> list[dict[str, Any]]:
    """437 synchronised targets of two arms with a wire: in the open, and with beams that force changes of
    spin."""
    out = []
    for name, beams in (("open", ()), ("beams", beams_in_the_way())):
        cell, targets = two_arms(obstacles=beams), arc_wire()
        model = plant.build_cell_model(cell, block(SIZE, HIGH), HIGH)
        stages: list[float] = []

        def work(cell=cell, targets=targets, model=model, stages=stages) -> Any:  # type: ignore[no-untyped-def]
            scene = Scene.of(cell, targets.arms, HIGH, Settings(), model)
            plan = plan_operation("job", scene, targets, cell.controller)
            stages.append(sum(plan.metrics["stages"][key] for key in CORE))
            return plan

        row, plan = time_work(work)
        metrics = plan.metrics
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        spins = np.rad2deg(np.ptp(plan.values[:, 0]))
        row["note"] += (
            f"; reach to timing {np.median(stages[1:]):.3f} s wall; {metrics['ladder_rounds']} rounds, "
            f"{metrics['collision_checks']} checks, spin over {spins:.0f} deg; "
            f"cost {metrics['ladder_cost']:.3g} -> {metrics['trajopt_cost']:.3g}, "
            f"optimised path used: {metrics['trajopt_used']}; peak memory {peak:.0f} MB"
        )
        out.append({"name": f"two arms, 437 targets, {name}, whole", **row})
    return out


def beams_in_the_way() -> tuple[Obstacle, ...]:
    """A beam where the left hand would pass with the spin that suits the rest."""
    cell, targets = two_arms(), arc_wire()
    scene = Scene.of(cell, targets.arms, HIGH, Settings())
    plan = plan_operation("job", scene, targets, cell.controller)
    beams = []
    for k, (arm, row) in enumerate((("left", 140), ("right", 300))):
        x, y, z = (cell.arm(arm).base @ forward_kinematics(robot("irb140"), plan.q[arm][row]))[:3, 3]
        beams.append(Obstacle(f"beam_{k}", (box((0.03, 0.04, 0.03), (x, y, z + 0.09)),)))
    return tuple(beams)


def one_arm(count: int) -> dict[str, Any]:
    """Poses on an S-curve with free spin at 10 degrees and collisions."""
    cell, targets = s_curve(count)
    place = from_parts(np.eye(3), np.array([0.5, 0.0, 0.0]))
    model = plant.build_cell_model(cell, block((0.6, 0.8, 0.1), place), place)
    stages: list[float] = []

    def work() -> Any:
        scene = Scene.of(cell, targets.arms, place, Settings(), model)
        plan = plan_operation("s", scene, targets, cell.controller)
        stages.append(sum(plan.metrics["stages"][key] for key in CORE))
        return plan

    row, plan = time_work(work)
    checks = plan.metrics["collision_checks"]
    row["note"] += f"; reach to timing {np.median(stages[1:]):.3f} s wall; {checks} checks"
    return {"name": f"one arm, {count:,} poses, 36 spins, whole", **row}


def many_targets() -> dict[str, Any]:
    """25,000 targets of two arms with balls on both sides of a spiral, a free spin for each."""
    cell, targets = spiral_pair(25_000, loops=156)
    away = from_parts(np.eye(3), np.array([0.0, 3.0, 0.0]))
    model = plant.build_cell_model(cell, block((0.01, 0.01, 0.01), away), away)
    settings = Settings(clearance=0.0005)

    def work() -> Any:
        scene = Scene.of(cell, targets.arms, away, settings, model)
        return plan_operation("spiral", scene, targets, cell.controller)

    row, plan = time_work(work, repeats=1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    stages = ", ".join(f"{name} {took:.1f}" for name, took in plan.metrics["stages"].items())
    row["note"] += f"; {stages} s wall; peak {peak:.2f} GB; {plan.metrics['collision_checks']} checks"
    return {"name": "two arms, 25,000 targets, a spin each, whole", **row}


def bows() -> list[dict[str, Any]]:
    """A bow of 400 targets around a standing block, and around one that another arm holds, from its place to
    the ways home."""
    out = []
    for name, make in (
        ("one arm, bow", motion_bows.standing_block),
        ("two arms, bow and held block", motion_bows.held_block),
    ):
        cell, stock, targets = make(400)
        operation = SimpleNamespace(name="side", process="", arms=targets.arms, leaves=lambda block: block)
        problem = Problem("bows", cell, stock, None, (operation,), Settings(), Path(), "")
        row, plan = time_work(lambda problem=problem, targets=targets: solve(problem, [targets]), 3)  # type: ignore[misc]
        stages = {**plan.metrics["stages"], **plan.operations[0].metrics["stages"]}
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        each = ", ".join(f"{key} {value:.2f}" for key, value in stages.items() if value > 0.005)
        row["note"] += f"; {targets.count} targets; wall of the last: {each} s; peak memory {peak:.0f} MB"
        out.append({"name": f"{name}, whole with place", **row})
    return out


def placement() -> dict[str, Any]:
    """Search for the place of the block, ten seeds; all must find one."""
    cell, targets = two_arms(1.8), arc_wire()
    stock = block(SIZE, None)
    start = np.array([5.0, 5.0, 5.0, 1.0])
    seeds = iter(range(1, 100))
    result: list[bool] = []

    def work() -> None:
        settings, jobs = Settings(seed=next(seeds)), [PlacementJob(cell, targets)]
        search = PlacementSearch(dataclasses.replace(stock), jobs, settings, start=start)
        result.append(bool(search.run()[0]))

    row, _ = time_work(work, 10)
    row["note"] += f"; found {sum(result)} of {len(result)}"
    return {"name": "placement search without collisions", **row}
