"""Small plans for the tests of the writers: joints are chosen, poses follow by forward kinematics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planner.catalogue import robot
from planner.cell.robots import forward
from planner.geometry.rigid import from_rpy, inverse
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, Stock, Tool
from planner.targets import Action, Targets

HOME = np.deg2rad([0.0, 0.0, 0.0, 0.0, 30.0, 0.0])
START = np.deg2rad([5.0, 20.0, 10.0, 15.0, 45.0, -25.0])
DIGEST = "0123456789abcdef" * 4  # SHA-256 in length
STOCK = from_rpy([0.55, 0.0, 0.2], [0.0, 0.0, np.pi / 2])
BASES = {"left": np.eye(4), "right": from_rpy([1.1, 0.0, 0.0], [0.0, 0.0, np.pi])}
ACTIONS = (
    Action(0, "message", text="Mount a wire of 812.5 mm, cold."),
    Action(0, "on", signal="doWirePower"),
    Action(0, "wait", seconds=12.5),
    Action(0, "confirm", text='Take up the slack at the slide, then press "OK".'),
)


def tool(name="Holder", tcp=None, mass=1.25):
    """A tool with its TCP 150 mm out."""
    pose = from_rpy([0.0, 0.0, 0.15], [0.0, np.pi / 2, 0.0]) if tcp is None else tcp
    return Tool(name, pose, mass, np.array([0.0, 0.0, 0.06]), ())


def problem(arms=("left", "right"), model="irb140", **controller):
    """A cell of one or two arms of one model."""
    cell = Cell(
        "test",
        tuple(Arm(name, model, BASES[name], tool(), HOME) for name in arms),
        (),
        Controller(**controller),
    )
    stock = Stock(np.array([0.4, 0.3, 0.2]), STOCK, np.eye(3))
    return Problem("test", cell, stock, None, (), Settings(), Path("problem.yaml"), DIGEST)


def world_tcp(job, arm, q):
    """TCP poses in the world."""
    item = job.cell.arm(arm)
    return item.base @ forward(robot(item.robot), q) @ item.tool.tcp


def operation(job, q, segment, stop=(), actions=ACTIONS, name="panel", step=0.5, coupled=True, frame="stock"):
    """An operation with joints ``q`` {arm: (N, 6)}; it stops at targets ``stop``, the first and the last."""
    count = len(segment)
    stops = np.zeros(count, dtype=bool)
    stops[[0, -1, *stop]] = True
    place = inverse(STOCK) if frame == "stock" else np.eye(4)
    targets = Targets(
        arms=tuple(q),
        pose={arm: place @ world_tcp(job, arm, joints) for arm, joints in q.items()},
        frame=dict.fromkeys(q, frame),
        freedoms=(),
        feed=np.full(count, 0.02),
        feed_min=np.zeros(count),
        travel=np.zeros(count),
        stop=stops,
        segment=tuple(segment),
        coupled=coupled,
        actions=tuple(actions),
    )
    middle = 0.5 * (HOME + START)
    return OperationPlan(
        name=name,
        targets=targets,
        q=q,
        values=np.zeros((count, 0)),
        time=step * np.arange(count, dtype=np.float64),
        entry={arm: np.stack([HOME, middle, joints[0]]) for arm, joints in q.items()},
        exit={arm: np.stack([joints[-1], middle, HOME]) for arm, joints in q.items()},
        order=tuple(q),
        metrics={},
    )


def plan(*operations):
    """A plan of these operations."""
    return Plan("test", DIGEST, {}, (STOCK,), BASES, operations, {})


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
    off = (Action(6, "off", signal="doWirePower"), Action(8, "confirm", text="Take the wire off."))
    return plan(operation(job, q, labels, stop=(6,), actions=(*actions, *off))), job
