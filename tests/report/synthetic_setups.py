"""Synthetic jobs with a bow: one of two setups, and one whose block is held by an arm."""

from __future__ import annotations

import dataclasses

import numpy as np

from planner.catalogue.materials import foam
from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.claims.claim import ContactOnlyIn, FeedWindow, HoldsStock
from planner.claims.segments import Segment
from planner.geometry.arrays import RuledSurface, from_parts, from_rpy, inverse
from planner.issues import Issue, Severity
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Part, Problem, Setup, SetupChange, Stock
from planner.processes.hotwire.claims import CutsSurface, KerfCurve, StraightWire
from planner.targets import TargetAction, Targets
from planner.tooling import bow, gripper_plate
from tests.report import synthetic_job as job

FIRST = from_rpy([0.22, 0.0, 0.24], [0.0, 0.0, 0.0])
KERF = KerfCurve(
    np.array([0.002, 0.004, 0.008]),
    np.array([2.0e-3, 1.5e-3, 1.1e-3]),
    np.array([1.8e-3, 1.3e-3, 0.9e-3]),
    np.array([2.2e-3, 1.7e-3, 1.3e-3]),
)


@dataclasses.dataclass(frozen=True)
class Trim(job.WireWork):
    """Leaves a block without oversize."""

    def leaves(self, stock: Stock) -> Stock:
        """The datum block."""
        return dataclasses.replace(stock, oversize=np.zeros((2, 3)))


def side(name: str, x: float, size: np.ndarray) -> RuledSurface:
    """A ruled face across x, with rulings along y."""
    z = np.linspace(size[2], 0.0, 12)
    bulge = x + 0.03 * np.sin(np.pi * z / size[2]) * np.sign(x)
    start = np.stack([bulge, np.full(12, -0.5 * size[1]), z], axis=1)
    return RuledSurface(name, start, start * [1.0, -1.0, 1.0], np.zeros(12, dtype=bool))


def _bow_pose(stock_pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """World poses (N, 4, 4) of a bow's TCP at stock points (N, 3): the wire along world y, the beam at -x."""
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return from_parts(np.tile(turn, (len(points), 1, 1)), points @ stock_pose[:3, :3].T + stock_pose[:3, 3])


def _straight(
    setup: Setup,
    name: str,
    labels: list[str],
    points: np.ndarray,
    stock_pose: np.ndarray,
    held: np.ndarray | None,
) -> OperationPlan:
    """An operation of the left arm's bow with its TCP at points (N, 3) of the stock; ``held``: (N, 4, 4) how
    the stock moves in the world."""
    n = len(points)
    poses = (
        _bow_pose(stock_pose, points)
        if held is None
        else held @ inverse(stock_pose) @ _bow_pose(stock_pose, points)
    )
    left = setup.cell.arm("left")
    q = {"left": job._follow(left, poses)}
    arms: tuple[str, ...] = ("left",)
    pose = {"left": inverse(stock_pose) @ poses}
    frame = {"left": "stock"}
    bows = left.tool
    half = 0.5 * bows.span
    claims: list[object] = [
        StraightWire("left", np.array([-half, 0, 0]), np.array([half, 0, 0]), 2e-4, 0.02),
        ContactOnlyIn(("cut",), "doWirePower", 5.0),
    ]
    cuts = list(dict.fromkeys(label for label in labels if label.startswith("cut")))
    triangle = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0.1]])
    for label in cuts:
        claims += [CutsSurface(Segment.read(label), triangle, np.array([[0, 1, 2]]), KERF, 3e-4)]
        claims += [FeedWindow(Segment.read(label), 0.003, 0.006)]
    if held is not None:
        right = setup.cell.arm("right")
        tcp = held @ inverse(setup.stock.grip)
        q["right"] = job._follow(right, tcp)
        arms = ("left", "right")
        pose = {"left": inverse(tcp) @ poses, "right": inverse(stock_pose) @ tcp}
        frame = {"left": "held:right", "right": "stock"}
        cog = setup.stock.grip[:3, :3] @ (0.5 * (setup.stock.lower + setup.stock.upper))
        claims.append(HoldsStock("right", setup.stock.grip, float(setup.stock.mass or 0.0), cog))
    travel = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1)]) + 1e-4
    cutting = np.array([label.startswith("cut") for label in labels])
    feed = np.where(cutting, 0.005, 0.05)
    stop = np.array([i in (0, n - 1) for i in range(n)])
    actions = (TargetAction(0, "on", signal="doWirePower"), TargetAction(0, "wait", seconds=5.0))
    targets = Targets(
        arms,
        pose,
        frame,
        (),
        feed,
        np.where(cutting, 0.003, 0.0),
        travel,
        stop,
        tuple(map(Segment.read, labels)),
        actions=actions,
        claims=tuple(claims),
    )
    home = job.problem().cell.arms[0].home
    entry = {arm: np.stack([home, 0.5 * (home + q[arm][0]), q[arm][0]]) for arm in arms}
    leave = {arm: np.stack([q[arm][-1], 0.5 * (home + q[arm][-1]), home]) for arm in arms}
    time = np.cumsum(travel / feed)
    return OperationPlan(name, targets, q, np.zeros((n, 0)), time, entry, leave, arms, {})


def two_setups() -> tuple[Problem, Plan]:
    """A bow trims the block's side and cuts a ruled side; then two arms with a bent wire cut the faces."""
    base = job.problem()
    over = np.array([[0.03, 0.01, 0.0], [0.02, 0.01, 0.02]])
    stock = dataclasses.replace(base.stock, place=FIRST, oversize=over, foam=foam("eps"))
    arms = (dataclasses.replace(base.cell.arms[0], tool=bow(throat=0.3)), base.cell.arms[1])
    note = Issue("problem.field", "kinks of 3.1 deg between strips", Severity.NOTE)
    assert base.part is not None
    part = Part(base.part.front, base.part.back, (side("left", -0.17, job.SIZE),), (note,))
    changes = {
        0: SetupChange(
            steps=("Mount the tool bow_400 on arm left.", "Clamp the block as the setup sheet says.")
        ),
        1: SetupChange(
            tools={"left": base.cell.arms[0].tool},
            stock={"place": job.STOCK_POSE},
            steps=("Mount the tool holder_left on arm left.", "Clamp the block in its new place."),
        ),
    }
    problem = dataclasses.replace(
        base,
        cell=dataclasses.replace(base.cell, arms=arms),
        stock=stock,
        part=part,
        operations=(Trim("sides", "straight_wire", ("left",)), job.WireWork()),
        changes=changes,
    )
    down = np.linspace(job.SIZE[2] + 0.05, -0.03, 40)
    z = np.concatenate([down, np.full(6, down[-1]), np.linspace(down[-1], down[0], 8), down])
    bulge = -0.17 - 0.03 * np.sin(np.pi * np.clip(down / job.SIZE[2], 0.0, 1.0))
    x = np.concatenate([np.full(40, -0.2), np.full(6, -0.26), np.linspace(-0.26, -0.17, 8), bulge])
    labels = ["approach"] * 3 + ["cut/trim_left"] * 37 + ["link"] * 14 + ["link"] * 3 + ["cut/left"] * 37
    points = np.stack([x, 0.0 * x, z], axis=1)
    points = np.concatenate([points, points[-1:] + np.array([-0.08, 0.0, 0.0])])
    first = _straight(problem.setups[0], "sides", [*labels, "retreat"], points, FIRST, None)
    bent = job.plan(90)
    plan = dataclasses.replace(
        bent, stock_poses=(FIRST, job.STOCK_POSE), operations=(first, *bent.operations), metrics={}
    )
    return problem, plan


def held_block_job() -> tuple[Problem, Plan]:
    """The right arm holds a block of foam and turns it while the left one cuts two sides with a bow."""
    base = job.problem()
    size = np.array([0.2, 0.24, 0.18])
    place = from_rpy([0.2, 0.0, 0.45], [0.0, -0.5 * np.pi, 0.0])
    grip = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    tools = (bow(), gripper_plate(0.12, 0.12))
    arms: tuple[Arm, ...] = tuple(
        dataclasses.replace(arm, tool=tool) for arm, tool in zip(base.cell.arms, tools, strict=True)
    )
    stock = Stock(size, place, place[:3, :3], foam=foam("eps"), held_by="right", grip=grip)
    z = np.linspace(0.0, 0.18, 12)
    wavy = np.stack([0.07 + 0.02 * np.sin(20 * z), np.full(12, -0.12), z], axis=1)
    ruled = RuledSurface("side", wavy, wavy * [1.0, -1.0, 1.0], np.zeros(12, dtype=bool))
    changes = {0: SetupChange(steps=("Fix the block to the gripper of arm right as the setup sheet says.",))}
    problem = dataclasses.replace(
        base,
        name="synthetic held block",
        cell=dataclasses.replace(base.cell, arms=arms),
        stock=stock,
        part=Part(ruled=(ruled,)),
        operations=(job.WireWork("side", "straight_wire", ("left", "right")),),
        changes=changes,
    )
    n = 60
    down = np.linspace(0.23, -0.04, n)
    points = np.stack([0.07 + 0.02 * np.sin(20 * np.clip(down, 0, 0.18)), 0.0 * down, down], axis=1)
    labels = ["approach"] * 10 + ["cut/side"] * 42 + ["retreat"] * 8
    turn = np.linspace(-0.4, 0.4, n)
    moved = place @ np.array([from_rpy([0, 0, 0], [0, 0, a]) for a in turn])
    moved[:, 2, 3] += 0.04 * np.sin(3 * turn)
    operation = _straight(problem.setups[0], "side", labels, points, place, moved)
    bases = {arm.name: arm.base for arm in arms}
    return problem, Plan(problem.name, problem.digest, {}, (place,), bases, (operation,), {})


def tcp_distance(problem: Problem, plan: Plan, arm: str) -> np.ndarray:
    """How far [m] (N,) the TCP of an arm of the first operation is from where its targets want it."""
    setup, operation = problem.setups[0], plan.operations[0]

    def tcp(name: str) -> np.ndarray:
        item = setup.cell.arm(name)
        return item.base @ forward_kinematics(robot(item.robot), operation.q[name]) @ item.tool.tcp

    frame = operation.targets.frame[arm]
    work = plan.stock_poses[0] if frame == "stock" else tcp(frame.removeprefix("held:"))
    return np.linalg.norm((work @ operation.targets.pose[arm])[:, :3, 3] - tcp(arm)[:, :3, 3], axis=1)
