"""A small job with a known answer: a weightless wire bent to circular arcs cuts both faces of a panel.

Two arms stand face to face with the wire between them, across their hands. The wire's end tangents and its
chord are those of a circular arc of the wire's length, so its shape is that arc (the one stable shape without
a force). The half angle changes slowly along the sweep. The nominal faces are those arcs, half a kerf nearer
to the part.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from planner.cell.kinematics import forward_kinematics
from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.claims.dialogue import (
    OperatorDialogue,
    message_step,
    power_off_steps,
    power_on_steps,
    question_step,
)
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import from_parts, from_rpy, inverse
from planner.languages.writing import write
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, Stock
from planner.processes.hotwire.claims import CutsSurface, KerfCurve, WireJoins
from planner.proof.kinematics import arm_model, inverse_kinematics
from planner.targets import TargetAction, Targets
from planner.tooling import wire_holder
from tests import line_ends

LENGTH = 0.5
KERF = 0.002
TOLERANCE = 0.0005
DIGEST = "ab12" * 16
SIZE = np.array([0.16, 0.08, 0.1])
STOCK = from_rpy([0.0, 0.0, 0.45], [0.0, 0.0, 0.0])
BASES = {
    "left": from_rpy([-0.8, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "right": from_rpy([0.8, 0.0, 0.0], [0.0, 0.0, np.pi]),
}
SIGNAL = "doWirePower"
HOME = np.deg2rad([0.0, -20.0, 20.0, 0.0, 70.0, 0.0])
OUT = 0.07
AWAY = 0.12
FEED = 0.008
AIR = 0.05


@dataclasses.dataclass(frozen=True)
class Operation:
    """The least that an operation is."""

    name: str = "panel"
    process: str = "elastic_wire"
    arms: tuple[str, ...] = ("left", "right")

    def leaves(self, stock):
        """Return the block unchanged."""
        return stock


def half_angle(y):
    """Half the angle [rad] of the arc of the section at y."""
    return 0.5 + 0.3 * y


def middle(y, low):
    """Height [m] of the arc's middle in the stock frame."""
    return (0.045 if low else 0.070) + 0.05 * y


def ends(y, low, lift=0.0):
    """TCP poses of both arms in the stock frame for the section at y (N,), and the section's arc."""
    angle = half_angle(y)
    radius = 0.5 * LENGTH / angle
    half = radius * np.sin(angle)
    z = middle(y, low) - radius * (1.0 - np.cos(angle)) + lift
    pose = {}
    for arm, side in (("left", 1.0), ("right", -1.0)):
        c, s = np.cos(side * angle), np.sin(side * angle)
        zero = np.zeros_like(y)
        x_axis = np.stack([c, zero, s], axis=-1)
        z_axis = np.broadcast_to([0.0, -1.0, 0.0], x_axis.shape)
        y_axis = np.cross(z_axis, x_axis)
        rotation = np.stack([x_axis, y_axis, z_axis], axis=-1)
        pose[arm] = from_parts(rotation, np.stack([-side * half, y, z], axis=-1))
    return pose


def face(low, count=41):
    """The nominal face: front (upper) or back (lower), as a mesh with normals away from the part."""
    side = -1.0 if low else 1.0
    y = np.linspace(-0.5 * SIZE[1], 0.5 * SIZE[1], count)
    radius = 0.5 * LENGTH / half_angle(y) - side * 0.5 * KERF
    centre = middle(y, low) - 0.5 * LENGTH / half_angle(y)
    x = np.linspace(-0.5 * SIZE[0], 0.5 * SIZE[0], count)
    z = centre[:, None] + np.sqrt(radius[:, None] ** 2 - x[None, :] ** 2)
    grid = np.stack([np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape), z], axis=-1)
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return grid.reshape(-1, 3), faces if not low else faces[:, ::-1]


def problem(**settings):
    """The cell of the job."""
    arms = tuple(
        Arm(name, "irb140", BASES[name], wire_holder("across", side), HOME)
        for name, side in (("left", "start"), ("right", "end"))
    )
    cell = Cell("small", arms, (), Controller(wire_signal=SIGNAL))
    stock = Stock(SIZE, STOCK, np.eye(3))
    return Problem(
        "small",
        cell,
        stock,
        None,
        (Operation(),),
        Settings(**settings),
        Path("small.yaml"),
        DIGEST,
        accept=("stock.hangs",),
    )


def claims():
    """The claims of the process."""
    wire = WireJoins(("left", "right"), LENGTH, 0.02, 0.02, 0.0154, 0.0, True, 8.0, 0.0006, 5e-5)
    faces = [
        CutsSurface(Segment.read(f"cut/{name}"), *face(low), KerfCurve.constant(KERF), TOLERANCE)
        for name, low in (("front", False), ("back", True))
    ]
    feeds = [FeedWindow(Segment.read(f"cut/{name}"), 0.003, 0.012) for name in ("front", "back")]
    return {"panel": (wire, *faces, ContactOnlyIn(("cut",), SIGNAL, 10.0), *feeds, dialogue())}


def dialogue():
    """The operator dialogue of the job."""
    first = (
        message_step(Sentence("Mount a wire of 495 mm, cold.")),
        question_step(Sentence("Press OK when the wire is mounted.")),
        *power_on_steps(SIGNAL, 10.0),
        question_step(Sentence("Take up the slack at the slide, then press OK.")),
    )
    last = (*power_off_steps(SIGNAL, 5.0), question_step(Sentence("Take the wire off, then press OK.")))
    return OperatorDialogue(("left", "right"), first, last, joined=True)


def wire_path(count=24):
    """Sections of the job: y, whether low, lift, speed, label, stop."""
    rows = [(AWAY, False, 0.0, AIR, "mount", True)]

    def go(ys, low, speed, label, lift=0.0):
        rows.extend((y, low, lift, speed, label, False) for y in ys)
        rows[-1] = (*rows[-1][:5], True)

    go(np.linspace(AWAY, OUT, 6)[1:], False, AIR, "approach")
    go(np.linspace(OUT, -OUT, count + 1)[1:], False, FEED, "cut/front")
    go([-OUT - 0.01, -OUT - 0.02], False, AIR, "link")
    go([-OUT - 0.02], True, AIR, "link")
    go([-OUT - 0.01, -OUT], True, AIR, "link")
    go(np.linspace(-OUT, OUT, count + 1)[1:], True, FEED, "cut/back")
    go(np.linspace(OUT, AWAY, 6)[1:], True, AIR, "retreat")
    return rows


def joints_at(arm, pose):
    """Joints (N, 6) of TCP poses (N, 4, 4) in the stock frame, in the posture of home."""
    machine = arm_model.robot_machine(arm.data)
    flange = inverse(arm.base) @ STOCK @ pose @ inverse(arm.tool.tcp)
    branch = np.full(len(pose), int(inverse_kinematics.branch_of(machine, arm.home)))
    q = inverse_kinematics.unwrapped_path(
        machine, inverse_kinematics.solve(machine, flange, branch), arm.home
    )
    assert np.isfinite(q).all(), arm.name
    assert np.abs(forward_kinematics(machine.data, q) - flange).max() < 1e-9
    return q


def plan(count=24):
    """The plan, with joints by the proof's own inverse kinematics.

    The posture is chosen, nothing is searched.
    """
    rows = wire_path(count)
    y, lift, speed = (np.array([row[i] for row in rows], dtype=float) for i in (0, 2, 3))
    low = np.array([row[1] for row in rows])
    pose = {}
    high, deep = ends(y, False, lift), ends(y, True, lift)
    for arm in ("left", "right"):
        pose[arm] = np.where(low[:, None, None], deep[arm], high[arm])
    job = problem()
    q, travel = {}, np.zeros(len(y))
    for arm in job.cell.arms:
        q[arm.name] = joints_at(arm, pose[arm.name])
        step = np.linalg.norm(np.diff(pose[arm.name][:, :3, 3], axis=0), axis=1)
        travel[1:] = np.maximum(travel[1:], step)
    duration = np.maximum(travel / speed, 0.2)
    stop = np.array([row[5] for row in rows])
    # moves from and to a stop take half as long again, so that ramps fit in
    duration[1:] *= np.where(stop[1:] | stop[:-1], 1.4, 1.0)
    duration[0] = 0.0
    last = len(y) - 1
    actions = (
        TargetAction(0, "message", text="Mount a wire of 495 mm, cold."),
        TargetAction(0, "confirm", text="Press OK when the wire is mounted."),
        TargetAction(0, "on", signal=SIGNAL),
        TargetAction(0, "wait", seconds=10.0),
        TargetAction(0, "confirm", text="Take up the slack at the slide, then press OK."),
        TargetAction(last, "off", signal=SIGNAL),
        TargetAction(last, "wait", seconds=5.0),
        TargetAction(last, "confirm", text="Take the wire off, then press OK."),
    )
    targets = Targets(
        arms=("left", "right"),
        pose=pose,
        frame={"left": "stock", "right": "stock"},
        freedoms=(),
        feed=speed,
        feed_min=np.zeros(len(y)),
        travel=travel,
        stop=stop,
        segment=tuple(Segment.read(row[4]) for row in rows),
        coupled=True,
        actions=actions,
    )
    aside = {arm: 0.5 * (HOME + joints[0]) for arm, joints in q.items()}
    operation = OperationPlan(
        name="panel",
        targets=targets,
        q=q,
        values=np.zeros((len(y), 0)),
        time=np.cumsum(duration),
        approach={arm: np.stack([HOME, aside[arm], joints[0]]) for arm, joints in q.items()},
        retreat={arm: np.stack([joints[-1], aside[arm], HOME]) for arm, joints in q.items()},
        arm_order=("left", "right"),
        metrics={},
    )
    return Plan("small", DIGEST, {}, (STOCK,), BASES, (operation,), {})


@functools.cache
def programs(count=24):
    """The texts of the job as the planner writes them."""
    return line_ends.bare(write.program_files(plan(count), problem()))
