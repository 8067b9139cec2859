"""A small job with a known answer: the bow of one arm cuts two tapered, twisted panels out of a block.

The block is turned between the cuts, and the second cut uses another bow. Each face is ruled between two
straight guide lines, along which the wire's ends move at different speeds. The wire is offset from each line
by half the kerf at the speed there.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.claims.segments import Segment
from planner.geometry.arrays import from_rpy
from planner.languages.writing import write
from planner.plans import Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, SetupChange, Stock
from planner.processes.hotwire.claims import CutsSurface, FollowsRulings, KerfCurve, KerfWithin, StraightWire
from planner.tooling import bow
from tests import line_ends, urdf_text
from tests.proof.by_hand import Operation, dialogue, frames, home_of, operation_plan, strip, way_of

TOLERANCE = 0.0003
MARGIN = 0.02
DIGEST = "cd34" * 16
SIZE = np.array([0.16, 0.08, 0.1])
OVER = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.012]])
STOCK_POSES = (
    from_rpy([0.45, 0.0, -0.1], [0.0, 0.0, 0.0]),
    from_rpy([0.45, 0.0, -0.1], [0.0, 0.0, np.pi / 2.0]),
)
SIGNAL = "doWirePower"
NAMES = ("top", "back")
"""Names of the faces, one per operation."""
DOWN = np.array([0.0, 0.0, -1.0])
FEED, AIR = 0.008, 0.05
JOINT_GUESS_DEG = {
    "irb140": [0.0, 0.0, 0.0, 0.0, 90.0, 0.0],
    "kr10_r1100": [0.0, -90.0, 90.0, 0.0, 90.0, 0.0],
}
JOINT_GUESS_DEG["ur10e"] = [180.0, -90.0, 90.0, -90.0, -90.0, 0.0]
"""Joints [deg] near home, by robot."""
BOWS = (bow(0.4, 0.4), bow(0.3, 0.4))
STEPS = (
    ("Mount the tool bow_400 on arm left.", "Clamp the block as the setup sheet says."),
    ("Mount the tool bow_300 on arm left.", "Turn the block by a quarter and clamp it."),
)
_SPEED = np.linspace(0.0005, 0.03, 600)
KERF = KerfCurve(_SPEED, *([0.0006 + 4e-6 / _SPEED] * 3))


def guides(k, u):
    """Points (N, 3) of both guide lines of face ``k`` at ``u`` (N,), -1 to 1 along the face."""
    if k == 0:
        start = np.stack([0.08 * u, np.full_like(u, -0.04), 0.066 + 0.002 * u], axis=-1)
        end = np.stack([0.056 * u, np.full_like(u, 0.04), 0.074 - 0.002 * u], axis=-1)
    else:
        start = np.stack([np.full_like(u, -0.08), 0.04 * u, 0.030 + 0.001 * u], axis=-1)
        end = np.stack([np.full_like(u, 0.08), 0.03 * u, 0.034 + 0.0 * u], axis=-1)
    return start, end


def wire(k, u):
    """Points (N, 3) of the wire over the guide lines of face ``k``, half a kerf outwards of them."""
    start, end = guides(k, u)
    h = 1e-5
    before, after = guides(k, u - h), guides(k, u + h)
    along = end - start
    rate = [(b - a) / (2.0 * h) for a, b in zip(before, after, strict=True)]
    fastest = max(float(np.linalg.norm(r, axis=1).max()) for r in rate)
    out = []
    for point, way in zip((start, end), rate, strict=True):
        normal = np.cross(way, along)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        direction = along / np.linalg.norm(along, axis=1, keepdims=True)
        across = np.linalg.norm(way - (way * direction).sum(axis=1, keepdims=True) * direction, axis=1)
        out.append(point + 0.5 * KERF.at(FEED * across / fastest)[:, None] * normal)
    return out


def face(k):
    """The nominal face as a mesh with normals away from the part."""
    u = np.linspace(-1.0, 1.0, 41)
    return np.concatenate(guides(k, u)), strip(u)


@functools.cache
def robot_data(model):
    """The data of a robot that is not built in, None for the others."""
    return urdf_text.ur10e_data() if model == "ur10e" else None


def cell(k=0, model="irb140"):
    """The cell with the bow of setup ``k``."""
    arm = Arm("left", model, np.eye(4), BOWS[k], np.zeros(6), custom_data=robot_data(model))
    pose = STOCK_POSES[0] @ frames(np.array([[-0.16, -0.1, 0.2]]), np.array([[-0.16, 0.1, 0.2]]), DOWN)[0]
    home = home_of(dataclasses.replace(arm, tool=BOWS[0]), pose, JOINT_GUESS_DEG[model])
    arms = (dataclasses.replace(arm, home=home),)
    io = {"left": {SIGNAL: 17 if model != "ur10e" else 9}}
    return Cell("straight", arms, (), Controller(("T_ROB1",), ("ROB_1",), wire_signal=SIGNAL, io=io))


def problem(model="irb140", **settings):
    """The problem of the job."""
    stock = Stock(SIZE, STOCK_POSES[0], np.eye(3), oversize=OVER)
    turned = {"place": STOCK_POSES[1], "attitude": STOCK_POSES[1][:3, :3]}
    return Problem(
        "straight",
        cell(model=model),
        stock,
        None,
        (Operation("top", "straight_wire", ("left",), True), Operation("back", "straight_wire", ("left",))),
        Settings(**settings),
        Path("straight.yaml"),
        DIGEST,
        changes={0: SetupChange(steps=STEPS[0]), 1: SetupChange({"left": BOWS[1]}, turned, STEPS[1])},
        accept=("stock.hangs",),
    )


def claims(margin=MARGIN, kerf=KERF):
    """The claims of the process."""
    out = {}
    for k, name in enumerate(("top", "back")):
        half = 0.5 * (0.4, 0.3)[k]
        segment, u = Segment("cut", NAMES[k]), np.linspace(-1.0, 1.0, 41)
        out[name] = (
            StraightWire("left", np.array([-half, 0, 0]), np.array([half, 0, 0]), 0.0002, margin),
            ContactOnlyIn(("cut",), SIGNAL, 5.0),
            dialogue(("left",), SIGNAL),
            CutsSurface(segment, *face(k), kerf, TOLERANCE),
            FollowsRulings(segment, *guides(k, u), kerf, TOLERANCE),
            KerfWithin(segment, kerf, 0.0008, 0.0016),
            *(FeedWindow(way, 0.003, 0.012) for way in segment.all_phases),
        )
    return out


def wire_path(k, count):
    """Both ends of the wire at all targets, and speed, label and stop of each."""
    segment, step = Segment("cut", NAMES[k]), 2.0 / count
    into_, on, out_ = map(str, segment.all_phases)
    lead = 0.035 / (0.056, 0.03)[k]  # the slower end comes from outside the block too
    leads = max(int(np.ceil(lead / step)), 2)
    into, out = np.linspace(-1.0 - lead, -1.0, leads + 1), np.linspace(1.0, 1.0 + lead, leads + 1)
    far = 1.0 + lead + 0.3
    u = np.concatenate([[-far], into, np.linspace(-1.0, 1.0, count + 1)[1:], out[1:], [far]])
    rows = [(AIR, "approach", True)] * 2
    rows += [(FEED, into_, False)] * leads + [(FEED, on, False)] * count
    rows += [(FEED, out_, False)] * leads + [(AIR, "retreat", True)]
    rows[-2] = (*rows[-2][:2], True)
    return wire(k, u), rows


def plan(count=24, over=None, model="irb140"):
    """The plan; ``over``: height [m] in the block at which the first bow goes home above it."""
    parts = []
    for k, name in enumerate(("top", "back")):
        start, end = wire_path(k, count)[0]
        pose = frames(start, end, DOWN)
        world = STOCK_POSES[k] @ pose
        up = np.eye(4)
        up[2, 3] = 0.13 if k == 0 else 0.17
        ways = {"left": up @ world[:1]}, {"left": up @ world[-1:]}
        if over is not None and k == 0:
            low = np.repeat(world[-1:], 2, axis=0)
            low[:, 0, 3] = STOCK_POSES[0][0, 3] + np.array([0.12, -0.11])
            low[:, 2, 3] = STOCK_POSES[0][2, 3] + over
            ways = ways[0], {"left": low}
        arm = cell(model=model).arms[0]
        here = dataclasses.replace(cell(k, model), arms=(dataclasses.replace(arm, tool=BOWS[k]),))
        rows = wire_path(k, count)[1]
        parts.append(
            operation_plan(
                name,
                here,
                {"left": pose},
                {"left": "stock"},
                {"left": world},
                rows,
                way_of(start, end),
                SIGNAL,
                *ways,
                ("left",),
            )
        )
    return Plan("straight", DIGEST, {}, STOCK_POSES, {"left": np.eye(4)}, tuple(parts), {})


@functools.cache
def programs(count=24, model="irb140"):
    """The texts of the job as the planner writes them."""
    return line_ends.bare(write.program_files(plan(count, model=model), problem(model)))
