"""Small plans for the tests of the writers: joints are chosen, poses follow by forward kinematics."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from planner.catalogue.robots import robot
from planner.cell.kinematics import forward_kinematics
from planner.claims.claim import HoldsStock
from planner.claims.segments import Segment
from planner.geometry.arrays import from_rpy, inverse
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, SetupChange, Stock
from planner.targets import TargetAction, Targets
from planner.tooling import PlainTool, bow, gripper_plate

HOME = np.deg2rad([0.0, 0.0, 0.0, 0.0, 30.0, 0.0])
START = np.deg2rad([5.0, 20.0, 10.0, 15.0, 45.0, -25.0])
DIGEST = "0123456789abcdef" * 4  # SHA-256 in length
STOCK = from_rpy([0.55, 0.0, 0.2], [0.0, 0.0, np.pi / 2])
BASES = {"left": np.eye(4), "right": from_rpy([1.1, 0.0, 0.0], [0.0, 0.0, np.pi])}
ACTIONS = (
    TargetAction(0, "message", text="Mount a wire of 812.5 mm, cold."),
    TargetAction(0, "on", signal="doWirePower"),
    TargetAction(0, "wait", seconds=12.5),
    TargetAction(0, "confirm", text='Take up the slack at the slide, then press "OK".'),
)


@dataclasses.dataclass(frozen=True)
class Work:
    """An operation with nothing but what every operation has."""

    name: str = "work"
    process: str = "posed"
    arms: tuple = ("left", "right")

    def leaves(self, stock):
        """Return the block unchanged."""
        return stock


def tool(name="Holder", tcp=None, mass=1.25):
    """A tool with its TCP 150 mm out."""
    pose = from_rpy([0.0, 0.0, 0.15], [0.0, np.pi / 2, 0.0]) if tcp is None else tcp
    return PlainTool(name, pose, mass, np.array([0.0, 0.0, 0.06]), ())


def problem(arms=("left", "right"), model="irb140", **controller):
    """A cell of one or two arms of one model."""
    cell = Cell(
        "test",
        tuple(Arm(name, model, BASES[name], tool(), HOME) for name in arms),
        (),
        Controller(**controller),
    )
    stock = Stock(np.array([0.4, 0.3, 0.2]), STOCK, np.eye(3))
    return Problem("test", cell, stock, None, (Work(),) * 3, Settings(), Path("problem.yaml"), DIGEST)


def world_tcp(job, arm, q):
    """TCP poses in the world."""
    item = job.cell.arm(arm)
    return item.base @ forward_kinematics(robot(item.robot), q) @ item.tool.tcp


def operation(
    job,
    q,
    segment,
    stop=(),
    actions=ACTIONS,
    name="panel",
    step=0.5,
    coupled=True,
    frame="stock",
    stock_pose=STOCK,
):
    """Return an operation with joints ``q`` {arm: (N, 6)}.

    It stops at targets ``stop``, the first and the last. ``job``: problem or setup with the cell at that
    time.
    """
    count = len(segment)
    stops = np.zeros(count, dtype=bool)
    stops[[0, -1, *stop]] = True
    stock_pose = inverse(stock_pose) if frame == "stock" else np.eye(4)
    targets = Targets(
        arms=tuple(q),
        pose={arm: stock_pose @ world_tcp(job, arm, joints) for arm, joints in q.items()},
        frame=dict.fromkeys(q, frame),
        freedoms=(),
        feed=np.full(count, 0.02),
        feed_min=np.zeros(count),
        travel=np.zeros(count),
        stop=stops,
        segment=tuple(map(Segment.read, segment)),
        coupled=coupled,
        actions=tuple(actions),
        feed_throughout=False,
    )
    middle = 0.5 * (HOME + START)
    return OperationPlan(
        name=name,
        targets=targets,
        q=q,
        values=np.zeros((count, 0)),
        time=step * np.arange(count, dtype=np.float64),
        approach={arm: np.stack([HOME, middle, joints[0]]) for arm, joints in q.items()},
        retreat={arm: np.stack([joints[-1], middle, HOME]) for arm, joints in q.items()},
        arm_order=tuple(q),
        metrics={},
    )


def plan(*operations, stock_poses=(STOCK,)):
    """A plan of these operations."""
    return Plan("test", DIGEST, {}, stock_poses, BASES, operations, {})


def sweep(count, size=0.3, start=START):
    """Joints (count, 6) on a smooth line."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    return start + size * s * np.array([0.3, 0.2, -0.3, 0.1, 0.2, -0.2])


def small(actions=ACTIONS, **settings):
    """Two arms, nine targets, three segments with a stop between cut and retreat; returns (plan, problem)."""
    job = problem(**settings)
    labels = [
        "mount",
        "approach",
        "approach",
        "cut/front",
        "cut/front",
        "cut/front",
        "cut/front",
        "retreat",
        "unmount",
    ]
    q = {"left": sweep(9), "right": sweep(9, 0.25)}
    off = (
        TargetAction(6, "off", signal="doWirePower"),
        TargetAction(8, "confirm", text="Take the wire off."),
    )
    return plan(operation(job, q, labels, stop=(6,), actions=(*actions, *off))), job


ROTATED_STOCK = from_rpy([0.5, 0.1, 0.25], [0.0, np.pi / 2, 0.3])


def two_setups():
    """A bow on the left arm cuts alone, then both arms work on the turned block; returns (plan, problem)."""
    job = problem()
    changes = {
        0: SetupChange(
            steps=("Mount the tool bow_400 on arm left.", "Clamp the block as the setup sheet says.")
        ),
        1: SetupChange(
            tools={"left": tool()},
            stock={"place": ROTATED_STOCK, "attitude": ROTATED_STOCK[:3, :3]},
            steps=("Mount the tool Holder on arm left.", "Turn the block and clamp it again."),
        ),
    }
    arms = (dataclasses.replace(job.cell.arms[0], tool=bow()), job.cell.arms[1])
    cell = dataclasses.replace(job.cell, arms=arms)
    work = (Work("sides", arms=("left",)), Work("faces"))
    job = dataclasses.replace(job, cell=cell, operations=work, changes=changes)
    first, second = job.setups
    alone = {"left": sweep(7)}
    labels = ["approach", "approach", "cut/trim_left", "cut/trim_left", "cut/trim_left", "retreat", "retreat"]
    both = {"left": sweep(6), "right": sweep(6, 0.25)}
    made = plan(
        operation(first, alone, labels, name="sides", actions=(), coupled=False),
        operation(
            second, both, ["mount", *["cut/front"] * 4, "retreat"], name="faces", stock_pose=ROTATED_STOCK
        ),
        stock_poses=(STOCK, ROTATED_STOCK),
    )
    return made, job


GRIP = from_rpy([0.02, -0.01, 0.0], [0.0, 0.0, 0.4])
FREE = SetupChange(stock={"held_by": None}, steps=("Take the block off its gripper and clamp it.",))


def held(released=False):
    """The right arm holds the block while the left one cuts it with a bow; returns (plan, problem).

    ``released``: afterwards the block is put down, and the left arm works alone.
    """
    job = problem()
    tools = (bow(), gripper_plate(0.16, 0.12))
    arms = tuple(dataclasses.replace(a, tool=t) for a, t in zip(job.cell.arms, tools, strict=True))
    stock = Stock(np.array([0.3, 0.2, 0.25]), STOCK, np.eye(3), held_by="right", grip=GRIP)
    changes = {0: SetupChange(steps=("Fix the block to the gripper of arm right as the setup sheet says.",))}
    if released:
        changes[1] = FREE
    work = (Work("held"), Work("standing", arms=("left",)))[: 2 if released else 1]
    cell = dataclasses.replace(job.cell, arms=arms)
    job = dataclasses.replace(job, cell=cell, stock=stock, operations=work, changes=changes)
    q = {"left": sweep(8), "right": sweep(8, 0.2)}
    labels = ["approach", "approach", *["cut/side"] * 5, "retreat"]
    made = operation(job, q, labels, name="held", actions=(), coupled=False)
    tcp = {arm: world_tcp(job, arm, joints) for arm, joints in q.items()}
    targets = dataclasses.replace(
        made.targets,
        pose={"left": inverse(tcp["right"]) @ tcp["left"], "right": inverse(STOCK) @ tcp["right"]},
        frame={"left": "held:right", "right": "stock"},
        claims=(HoldsStock("right", GRIP, 0.9, np.array([0.02, -0.01, 0.125])),),
    )
    operations = [dataclasses.replace(made, targets=targets)]
    if released:
        alone = {"left": sweep(4)}
        operations.append(
            operation(job.setups[1], alone, ["cut/top"] * 4, name="standing", actions=(), coupled=False)
        )
    return plan(*operations, stock_poses=(STOCK,) * len(job.setups)), job
