"""A small job with a known answer: one arm holds a block that the other arm's bow cuts while both move.

Then the block is put down and cut once more, with the holder waiting at home. The holder lifts and tilts the
block freely. In the block's own frame the wire moves as in ``straight_job``.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from planner.catalogue.materials import FoamMaterial
from planner.claims.claim import ContactOnlyIn, FeedWindow, HoldsStock
from planner.claims.segments import Segment
from planner.geometry.arrays import exp_twist, from_rpy
from planner.languages.writing import write
from planner.plans import Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, SetupChange, Stock
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, KerfWithin, StraightWire
from planner.tooling import bow, gripper_plate
from tests import line_ends
from tests.processes.hotwire.proof.straight_job import AIR, FEED, KERF, MARGIN, SIGNAL, SIZE, TOLERANCE
from tests.proof.by_hand import Operation, dialogue, frames, home_of, operation_plan, strip, way_of

DIGEST = "ef56" * 16
BASES = {
    "left": from_rpy([-0.6, 0.0, 0.1], [0.0, 0.0, 0.0]),
    "right": from_rpy([0.75, 0.0, 0.0], [0.0, 0.0, np.pi]),
}
GRIP = from_rpy([0.01, -0.005, 0.0], [0.0, 0.0, 0.1])
STOCK_POSE = from_rpy([-0.15, 0.0, 0.0], [0.0, 0.0, -np.pi / 2.0])
DOWN = np.array([0.0, 0.0, -1.0])
HALF = 0.2
OVER = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]])
STEPS = (
    (
        "Mount the tool bow_400 on arm left.",
        "Fix the block to the gripper of arm right as the setup sheet says.",
    ),
    ("Take the block off its gripper and clamp it as the setup sheet says.",),
)


def guides(k, u):
    """Points (N, 3) of both guide lines of face ``k`` in the block's frame at ``u`` (N,), -1 to 1."""
    if k == 0:
        start = np.stack([np.full_like(u, 0.08), 0.04 * u, 0.070 + 0.002 * u], axis=-1)
        end = np.stack([np.full_like(u, -0.08), 0.03 * u, 0.074 - 0.001 * u], axis=-1)
    else:
        start = np.stack([np.full_like(u, -0.08), 0.04 * u, 0.030 + 0.001 * u], axis=-1)
        end = np.stack([np.full_like(u, 0.08), 0.03 * u, 0.034 + 0.0 * u], axis=-1)
    return start, end


def wire(k, u):
    """Points (N, 3) of the wire over the guide lines of face ``k``, half a kerf outwards of them."""
    h = 1e-5
    start, end = guides(k, u)
    rate = [(b - a) / (2.0 * h) for a, b in zip(guides(k, u - h), guides(k, u + h), strict=True)]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    fastest = max(float(np.linalg.norm(r, axis=1).max()) for r in rate)
    out = []
    for point, way in zip((start, end), rate, strict=True):
        normal = np.cross(way, along)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        across = np.linalg.norm(way - (way * along).sum(axis=1, keepdims=True) * along, axis=1)
        out.append(point + 0.5 * KERF.at(FEED * across / fastest)[:, None] * normal)
    return out


def rows_of(k, count):
    """``u`` of all targets, and speed, label and stop of each."""
    name, step, lead = ("end", "back")[k], 2.0 / count, 0.035 / 0.03
    leads = max(int(np.ceil(lead / step)), 2)
    into, out = np.linspace(-1.0 - lead, -1.0, leads + 1), np.linspace(1.0, 1.0 + lead, leads + 1)
    far = 1.0 + lead + 0.3
    u = np.concatenate([[-far], into, np.linspace(-1.0, 1.0, count + 1)[1:], out[1:], [far]])
    rows = [(AIR, "approach", True)] * 2
    rows += [(FEED, f"cut/{name}_in", False)] * leads + [(FEED, f"cut/{name}", False)] * count
    rows += [(FEED, f"cut/{name}_out", False)] * (leads - 1) + [(FEED, f"cut/{name}_out", True)]
    return u, [*rows, (AIR, "retreat", True)]


def holder(count):
    """TCP poses of the holder in the world at ``count`` targets: it lifts, shifts and tilts the block."""
    t = np.linspace(-1.0, 1.0, count)
    base = np.eye(4)
    base[:3, :3] = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    base[:3, 3] = [0.06, 0.0, 0.18]
    twist = np.stack([0.05 * t, 0.03 * t**2, 0.04 * t, 0.0 * t, -0.03 * t, 0.01 * t], axis=-1)
    return base @ exp_twist(twist)


@functools.cache
def cell():
    """The cell, the same in both setups."""
    arms = []
    for name, tool, guess, axes, place in (
        ("left", bow(0.4, 0.4), [0, 0, 0, 0, 90, -180], ([0, -1, 0], [0, 0, -1]), [-0.31, 0.0, 0.2]),
        ("right", gripper_plate(0.06, 0.06), [0, 0, 20, 0, -20, 0], ([0, 1, 0], [-1, 0, 0]), [0.2, 0.0, 0.3]),
    ):
        x, z = np.array(axes, dtype=float)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
        pose[:3, 3] = place
        arm = Arm(name, "irb140", BASES[name], tool, np.zeros(6))
        arms.append(Arm(name, "irb140", BASES[name], tool, home_of(arm, pose, guess)))
    return Cell("held", tuple(arms), (), Controller(wire_signal=SIGNAL))


def stock():
    """The block as the first setup holds it."""
    foam = FoamMaterial("test", "test", 30.0, {})
    return Stock(
        SIZE, None, np.eye(3), any_attitude=True, oversize=OVER, foam=foam, held_by="right", grip=GRIP
    )


def problem(**settings):
    """The problem of the job."""
    down = {"held_by": None, "place": STOCK_POSE, "attitude": STOCK_POSE[:3, :3], "any_attitude": False}
    return Problem(
        "held",
        cell(),
        stock(),
        None,
        (
            Operation("end", "straight_wire", ("left", "right"), True),
            Operation("back", "straight_wire", ("left",)),
        ),
        Settings(**settings),
        Path("held.yaml"),
        DIGEST,
        changes={0: SetupChange(steps=STEPS[0]), 1: SetupChange(stock=down, steps=STEPS[1])},
    )


def load():
    """Mass [kg] of the held block and its centre (3,) [m] in the holder's TCP frame."""
    block = stock()
    size = block.upper - block.lower
    centre = 0.5 * (block.lower + block.upper)
    return float(np.prod(size)) * 30.0, GRIP[:3, :3] @ centre + GRIP[:3, 3]


def claims():
    """The claims of the process."""
    out = {}
    for k, name in enumerate(("end", "back")):
        segment, u = Segment("cut", name), np.linspace(-1.0, 1.0, 41)
        start, end = guides(k, u)
        out[name] = (
            StraightWire("left", np.array([-HALF, 0, 0]), np.array([HALF, 0, 0]), 0.0002, MARGIN),
            ContactOnlyIn(("cut",), SIGNAL, 5.0),
            dialogue(("left", "right") if k == 0 else ("left",), SIGNAL),
            CutsSurface(segment, np.concatenate([start, end]), strip(u), KERF, TOLERANCE),
            FollowsRulings(segment, start, end, KERF, TOLERANCE),
            KerfWithin(segment, KERF, 0.0008, 0.0016),
            *(FeedWindow(way, 0.003, 0.012) for way in segment.all_phases),
            *((HoldsStock("right", GRIP, *load()),) if k == 0 else ()),
        )
    return out


def moved(pose, x, z):
    """A pose with other coordinates x and z in the world."""
    out = pose.copy()
    out[..., 0, 3], out[..., 2, 3] = x, z
    return out


def plan(count=24):
    """The plan."""
    parts = []
    for k, name in enumerate(("end", "back")):
        u, rows = rows_of(k, count)
        start, end = wire(k, u)
        aim = np.array([0.0, 1.0, 0.0]) if k == 0 else DOWN
        pose = frames(start, end, aim)
        order = ("right", "left") if k == 0 else ("left",)
        if k == 0:
            held = holder(len(u))
            poses, frame = {"left": GRIP @ pose, "right": held}, {"left": "held:right", "right": "world"}
            world = {"left": held @ GRIP @ pose, "right": held}
            entry = {"left": moved(world["left"][:1], -0.13, 0.31), "right": held[:0]}
            leave = {"left": moved(world["left"][-1:], -0.2, 0.12), "right": held[:0]}
        else:
            poses, frame, world = {"left": pose}, {"left": "stock"}, {"left": STOCK_POSE @ pose}
            entry = {"left": moved(world["left"][:1], world["left"][0, 0, 3], 0.17)}
            leave = {"left": moved(world["left"][-1:], world["left"][-1, 0, 3], 0.22)}
        travel = way_of(start, end)
        parts.append(
            operation_plan(
                name, cell(), poses, frame, world, rows, travel, SIGNAL, entry, leave, order, claims()[name]
            )
        )
    return Plan("held", DIGEST, {}, (np.eye(4), STOCK_POSE), BASES, tuple(parts), {})


@functools.cache
def programs(count=24):
    """The texts of the job as the planner writes them."""
    return line_ends.bare(write.program_files(plan(count), problem()))
