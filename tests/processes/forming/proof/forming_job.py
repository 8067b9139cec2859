"""A small job with a known answer: two arms form a spherical dish out of an upright sheet between them.

Everything is in closed form about the dish's sphere. The centre of the forming ball moves on a smaller sphere
and that of the supporting ball on a larger one. Both lie on one ray from the sphere's centre, separated by
the sheet thickness that the sine law predicts.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np

from planner.claims.dialogue import OperatorDialogue, question_step
from planner.claims.handshake import Handshake
from planner.claims.segments import Segment
from planner.claims.sentences import Sentence
from planner.geometry.arrays import from_parts, from_rpy
from planner.languages.writing import write
from planner.plans import Plan
from planner.problem import Arm, Cell, Controller, Problem, Settings, Stock
from planner.processes.forming.claims import (
    FormingFeed,
    FormsInOrder,
    FormsPart,
    FormsSheet,
    SheetState,
    ToolGap,
)
from planner.targets import TargetAction
from planner.tooling import ball_tool, head_outline
from tests import line_ends
from tests.proof.by_hand import Operation, home_of, operation_plan

DIGEST = "ef56" * 16
ARMS = ("left", "right")
BALL = 0.004
SPHERE = 0.040
RIM = np.deg2rad(30.0)
LAST = np.deg2rad(3.5)
SHEET = 0.001
TURNS = 9
OUTER = 0.035
TOLERANCE, GAP_TOLERANCE, SCALLOP = 5e-5, 2e-5, 1.5e-4
FEED, AIR = 0.065, 0.05
AWAY = 0.030
# the sheet's z axis points to the left arm
STOCK_POSE = from_parts(
    np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 0.45])
)
BASES = {
    "left": from_rpy([-0.72, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "right": from_rpy([0.72, 0.0, 0.0], [0.0, 0.0, np.pi]),
}
SEGMENT = Segment("form", "f1")
TOOL = ball_tool(BALL, 0.16)


def centre_of_sphere():
    """Middle (3,) [m] of the dish's sphere, whose rim is in the sheet's top face."""
    return np.array([0.0, 0.0, SHEET + SPHERE * np.cos(RIM)])


def face(around=120, down=24):
    """The face that the forming ball touches, the sheet's top: dish and flat around it, normals up."""
    turn = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    angle = np.linspace(RIM, 0.0, down + 1)[:-1]
    radius = np.concatenate([[OUTER], SPHERE * np.sin(angle)])
    z = np.concatenate([[SHEET], centre_of_sphere()[2] - SPHERE * np.cos(angle)])
    rings = np.stack(
        [np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn)), np.tile(z[:, None], around)], -1
    )
    index = np.arange(len(radius) * around).reshape(len(radius), around)
    a, b, c, d = index[:-1], np.roll(index, -1, 1)[:-1], np.roll(index, -1, 1)[1:], index[1:]
    faces = [np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))]
    tip = np.full(around, index.size)
    faces.append(np.stack([index[-1], np.roll(index[-1], -1), tip], -1))
    bottom = centre_of_sphere() - [0.0, 0.0, SPHERE]
    return np.concatenate([rings.reshape(-1, 3), bottom[None]]), np.concatenate(faces)


def thickness(vertices):
    """The sheet's thickness (V,) [m] by the sine law, on the dish's side of its rim."""
    return SHEET * np.clip((centre_of_sphere()[2] - vertices[:, 2]) / SPHERE, np.cos(RIM), 1.0)


def spiral(steps):
    """Rays (N, 3) from the sphere's middle to the contact, from the rim inwards, by arc length downwards."""
    u = np.linspace(0.0, 1.0, TURNS * steps + 1)
    angle, turn = RIM + (LAST - RIM) * u, 2.0 * np.pi * TURNS * u
    return np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), -np.cos(angle)], -1)


def problem(controller=None, **settings):
    """The cell of the job."""
    arms = []
    for name in ARMS:
        arm = Arm(name, "irb140", BASES[name], TOOL, np.zeros(6))
        pose = STOCK_POSE @ poses(name, np.array([[0.0, 0.0, 0.11 if name == "left" else -0.11]]))[0]
        arms.append(dataclasses.replace(arm, home=home_of(arm, pose, [0.0, -20.0, 20.0, 0.0, 20.0, 0.0])))
    cell = Cell("forming", tuple(arms), (), controller or Controller())
    stock = Stock(np.array([0.2, 0.2, SHEET]), STOCK_POSE, STOCK_POSE[:3, :3])
    operation = Operation("dish", "forming", ARMS)
    return Problem(
        "forming",
        cell,
        stock,
        None,
        (operation,),
        Settings(**settings),
        Path("forming.yaml"),
        DIGEST,
        accept=("stock.hangs",),
    )


def part():
    """The part and the numbers of the job as a problem would state them."""
    vertices, faces = face()
    return FormsPart(
        mode="dsif",
        arms=ARMS,
        sides=(1, -1),
        kinds=("ball", "ball"),
        radii=(BALL, BALL),
        vertices=vertices - [0.0, 0.0, SHEET],
        faces=faces,
        thickness=SHEET,
        virgin=False,
        order=None,
        squeeze=1.0,
        feed=FEED,
        steps=(None, SCALLOP - TOLERANCE),
        share=0.95,
        gouge=TOLERANCE,
        gap=GAP_TOLERANCE,
        handshake=1e-3,
        pressed=0.0,
        passes=None,
        limit=np.deg2rad(65.0),
        angle_step=np.deg2rad(15.0),
        repeats=1,
    )


def flat():
    """Both faces of the flat sheet around the dish, without the bend at its rim."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.arange(-0.056, 0.0561, 0.004)]))
    out = np.hypot(x, y) > SPHERE * np.sin(RIM) + 0.006
    return np.concatenate([np.column_stack([x[out], y[out], np.full(out.sum(), z)]) for z in (0.0, SHEET)])


def claims(more=(), **changes):
    """Return the claims of a process and ``more``; ``changes`` {class name: fields}."""
    vertices, faces = face()
    end = float(vertices[:, 2].min())
    head, none = head_outline(TOOL.head), np.zeros((0, 3))
    # a wall that is formed already, beside the dish
    wall = np.stack(np.meshgrid([0.05], np.linspace(-0.02, 0.02, 21), np.linspace(-0.02, SHEET, 12)), -1)
    made = (
        part(),
        FormsInOrder((SEGMENT,)),
        FormsSheet(
            SEGMENT, "left", 1, BALL, vertices, faces, SHEET, end, TOLERANCE, np.full(len(faces), SCALLOP)
        ),
        SheetState(
            SEGMENT,
            ARMS,
            1,
            SHEET,
            np.concatenate([wall.reshape(-1, 3), flat()]),
            none,
            (head, head),
            TOLERANCE,
            TOLERANCE,
        ),
        ToolGap(SEGMENT, ARMS, 1, (BALL, BALL), vertices, faces, thickness(vertices), GAP_TOLERANCE),
        FormingFeed(SEGMENT, ARMS, FEED),
    )
    spoken = OperatorDialogue(ARMS, (question_step(Sentence("Sheet clamped, nobody in the cell?")),))
    made = (*made, spoken)
    return {
        "dish": tuple(dataclasses.replace(c, **changes.get(type(c).__name__, {})) for c in (*made, *more))
    }


def poses(arm, centre):
    """TCP poses (N, 4, 4) in the sheet's frame, the tools square to the sheet."""
    down = -1.0 if arm == "left" else 1.0
    z = np.array([0.0, 0.0, down])
    x = np.array([1.0, 0.0, 0.0])
    pose = np.tile(np.eye(4), (len(centre), 1, 1))
    pose[:, :3, :3] = np.stack([x, np.cross(z, x), z], axis=-1)
    pose[:, :3, 3] = centre
    return pose


def centres(steps):
    """Both balls' centres {arm: (N, 3)} along the spiral."""
    ray = spiral(steps)
    gap = SHEET * -ray[:, 2]
    return {
        "left": centre_of_sphere() + (SPHERE - BALL) * ray,
        "right": centre_of_sphere() + (SPHERE + gap + BALL)[:, None] * ray,
    }


def plan(steps=72):
    """The plan; ``steps`` targets a turn."""
    way = centres(steps)
    pose, ends = {}, {}
    for arm in ARMS:
        points = way[arm]
        up = AWAY if arm == "left" else -AWAY
        off = np.array([0.0, 0.0, up])
        first, last = (np.where([0, 0, 1], off, points[k]) for k in (0, -1))
        pose[arm] = poses(arm, np.concatenate([[first + off, first], points, [last, last + off]]))
        ends[arm] = (STOCK_POSE @ pose[arm])[[0, -1]]
    count = len(way["left"])
    rows = [(AIR, "approach", True)] * 2 + [(AIR, str(SEGMENT.at("in")), True)]
    rows += [(FEED, str(SEGMENT), False)] * (count - 2) + [(FEED, str(SEGMENT), True)]
    rows += [(AIR, str(SEGMENT.at("out")), True), (AIR, "retreat", True)]
    steps_of = [np.linalg.norm(np.diff(pose[arm][:, :3, 3], axis=0), axis=1) for arm in ARMS]
    travel = np.concatenate([[0.0], np.max(steps_of, axis=0)])
    made = operation_plan(
        "dish",
        problem().cell,
        pose,
        dict.fromkeys(ARMS, "stock"),
        {arm: STOCK_POSE @ pose[arm] for arm in ARMS},
        rows,
        travel,
        "doWirePower",
        {arm: ends[arm][:1] for arm in ARMS},
        {arm: ends[arm][1:] for arm in ARMS},
        ARMS,
    )
    duration = np.maximum(np.diff(made.time, prepend=0.0), 0.0)
    forming = np.array([row[1] == str(SEGMENT) for row in rows])
    duration[forming] = 0.04 * np.where(np.array([row[2] for row in rows]), 1.5, 1.0)[forming]
    duration[int(np.argmax(forming))] = 0.06
    actions = (TargetAction(0, "confirm", text="Sheet clamped, nobody in the cell?"),)
    targets = dataclasses.replace(made.targets, actions=actions)
    made = dataclasses.replace(made, targets=targets, time=np.cumsum(duration))
    return Plan("forming", DIGEST, {}, (STOCK_POSE,), BASES, (made,), {})


@functools.cache
def programs(steps=72):
    """The texts of the job as the planner writes them."""
    return line_ends.bare(write.program_files(plan(steps), problem()))


@functools.cache
def programs_of_two(every, steps=72):
    """The texts for two controllers, and the problem they are for."""
    controller = Controller(
        ("T_ROB1",) * 2, ("ROB_1",) * 2, sync="handshake", handshake=Handshake("toggle", every)
    )
    there = problem(controller)
    return there, line_ends.bare(write.program_files(plan(steps), there))
