"""A synthetic job of two arms and a bowed wire, for tests of the report: plausible motion, invented proof."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from planner.catalogue import robots
from planner.cell import kinematics
from planner.claims.claim import ContactOnlyIn, FeedWindow
from planner.claims.segments import Segment
from planner.geometry.arrays import Mesh, Shape, from_rpy, inverse, log_pose
from planner.issues import Issue, Severity
from planner.plans import OperationPlan, Plan
from planner.problem import Arm, Cell, Controller, Obstacle, Part, Problem, Settings, Stock
from planner.processes.hotwire.claims import CutsSurface, KerfCurve, WireJoins
from planner.proof.verdict import CutFace, Proof, RuleResult
from planner.targets import FlexibleTool, ScrewFreedom, TargetAction, Targets
from planner.tooling import PlainTool

ARMS = ("left", "right")
SIZE = np.array([0.4, 0.1, 0.34])
STOCK_POSE = from_rpy([0.0, 0.0, 0.24], [0.0, 0.0, 0.0])
LENGTH = 0.64


@dataclasses.dataclass(frozen=True)
class WireWork:
    """An operation with nothing but what every operation has."""

    name: str = "faces"
    process: str = "elastic_wire"
    arms: tuple[str, ...] = ARMS

    def leaves(self, stock: Stock) -> Stock:
        """The block as it was."""
        return stock


def tool(arm: str) -> PlainTool:
    """Return a holder whose TCP points along the flange's z (left arm) or against it (right arm)."""
    turn = [0, -0.5 * np.pi, 0] if arm == "left" else [0, 0.5 * np.pi, np.pi]
    body = Shape("box", (0.05, 0.03, 0.12), from_rpy([0, 0, 0.07], [0, 0, 0]))
    clamp = Shape("cylinder", (0.012, 0.05), from_rpy([0, 0, 0.145], [0, 0, 0]))
    return PlainTool(
        f"holder_{arm}", from_rpy([0, 0, 0.17], turn), 0.8, np.array([0, 0, 0.06]), (body, clamp)
    )


def amplitude(z: np.ndarray) -> np.ndarray:
    """End slope [rad] of the sections over the height."""
    return 0.25 + 0.25 * np.sin(2.5 * z / SIZE[2])


def face(offset: float, outward: float) -> Mesh:
    """Return the nominal face: the wire's cubic, moved by ``offset`` in y."""
    x, z = np.meshgrid(np.linspace(-0.2, 0.2, 25), np.linspace(0.0, SIZE[2], 21), indexing="ij")
    y = amplitude(z) * (0.3 - x**2 / 0.3) * 0.5 + offset - 0.04
    grid = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (g.ravel() for g in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), faces if outward < 0 else faces[:, ::-1])


def problem() -> Problem:
    """Two IRB 140 facing each other over a block."""
    bases = {"left": from_rpy([-0.95, 0, 0], [0, 0, 0]), "right": from_rpy([0.95, 0, 0], [0, 0, np.pi])}
    home = np.deg2rad([0.0, -20.0, 10.0, 0.0, 30.0, 0.0])
    arms = tuple(Arm(name, "irb140", bases[name], tool(name), home) for name in ARMS)
    floor = Obstacle("table", (Shape("box", (0.5, 0.3, 0.02), from_rpy([0, 0, 0.01], [0, 0, 0])),))
    pedestal = Shape("box", (0.12, 0.08, 0.22), from_rpy([0, 0, -0.11], [0, 0, 0]))
    stock = Stock(SIZE, STOCK_POSE, np.eye(3), (pedestal,))
    cell = Cell("two irb140", arms, (floor,), Controller())
    part = Part(face(0.01, 1.0), face(-0.01, -1.0))
    return Problem(
        "synthetic panel",
        cell,
        stock,
        part,
        (WireWork(),),
        Settings(),
        Path("problems/synthetic/problem.yaml"),
        "5f" * 32,
    )


def _rows(count: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Height z and offset y of the wire's plane, and the segment, over the targets."""
    inside, top, low = SIZE[2], SIZE[2] + 0.03, -0.03
    cut = max(8, count // 2 - 16)
    stretches = [
        ("mount", [top + 0.1], [0.06]),
        ("transit", np.linspace(top + 0.08, top + 0.02, 4), np.linspace(0.05, 0.02, 4)),
        ("approach", np.linspace(top, inside + 0.01, 5), np.full(5, 0.01)),
        ("cut/front", np.linspace(inside, low, cut), np.full(cut, 0.01)),
        ("link", np.full(8, low - 0.01), np.linspace(0.01, -0.01, 8)),
        ("cut/back", np.linspace(low, inside + 0.01, cut), np.full(cut, -0.01)),
        ("retreat", np.linspace(inside + 0.02, top + 0.05, 6), np.full(6, -0.01)),
        ("unmount", [top + 0.1], [-0.01]),
    ]
    z = np.concatenate([np.atleast_1d(s[1]) for s in stretches])
    y = np.concatenate([np.atleast_1d(s[2]) for s in stretches])
    return z, y, tuple(s[0] for s in stretches for _ in np.atleast_1d(s[1]))


def _follow(arm: Arm, poses: np.ndarray) -> np.ndarray:
    """Joint angles (N, 6) that take the TCP along world poses, by Newton steps from a start posture."""
    robot = robots.robot(arm.robot)
    expected = inverse(arm.base) @ poses @ inverse(arm.tool.tcp)
    q = np.deg2rad([0.0, 10.0, 30.0, 0.0, -40.0, 0.0])
    out = np.empty((len(poses), 6))
    for i, goal in enumerate(expected):
        for _ in range(30 if i == 0 else 5):
            reached = kinematics.forward_kinematics(robot, q)
            twist = log_pose(inverse(reached) @ goal)
            step = np.concatenate([reached[:3, :3] @ twist[:3], reached[:3, :3] @ twist[3:]])
            jacobian = kinematics.jacobian(robot, q)
            damped = jacobian.T @ jacobian + 1e-6 * np.eye(6)
            q = q + np.clip(np.linalg.solve(damped, jacobian.T @ step), -0.3, 0.3)
        out[i] = q
    return out


def plan(count: int = 90) -> Plan:
    """A plan of about ``count`` targets for :func:`problem`."""
    job = problem()
    z, y, segment = _rows(count)
    n, slope = len(z), amplitude(np.clip(z, 0.0, SIZE[2]))
    pose = {}
    for arm, side in (("left", -1.0), ("right", 1.0)):
        angle = -side * slope
        pose[arm] = from_rpy([0, 0, 0], [0, 0, 0]) + np.zeros((n, 4, 4))
        pose[arm][:, 0, 0], pose[arm][:, 0, 1] = np.cos(angle), -np.sin(angle)
        pose[arm][:, 1, 0], pose[arm][:, 1, 1] = np.sin(angle), np.cos(angle)
        pose[arm][:, :3, 3] = np.stack([np.full(n, side * 0.3), y - 0.04, z], axis=1)
    s = np.linspace(-0.3, 0.3, 25)
    bow = slope[:, None] * (0.3 - s**2 / 0.3) * 0.5
    points = np.stack(
        [np.tile(s, (n, 1)), bow + y[:, None] - 0.04, np.repeat(z[:, None], 25, axis=1)], axis=-1
    )
    q = {arm: _follow(job.cell.arm(arm), STOCK_POSE @ pose[arm]) for arm in ARMS}
    travel = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1)])
    cutting = np.array([label.startswith("cut") for label in segment])
    feed = np.where(cutting, 0.006, 0.05)
    time = np.cumsum(travel / (0.9 * feed) + np.where(travel > 0, 0.0, 0.0))
    stop = np.array([i in (0, n - 1) or segment[i] != segment[i - 1] for i in range(n)])
    spin = ScrewFreedom(
        "spin", {a: np.eye(6)[0] for a in ARMS}, np.full(n, -3.14), np.full(n, 3.14), periodic=True
    )
    assert job.part is not None and job.part.back is not None
    surfaces = [("cut/front", job.part.front), ("cut/back", job.part.back)]
    held = (
        WireJoins(ARMS, LENGTH, 2.1e-2, 2.1e-2, 1.6e-2, 0.06, True, 40.0, 1.2e-3, 1e-4),
        *(
            CutsSurface(Segment.read(name), m.vertices, m.faces, KerfCurve.constant(1.4e-3), 5e-4)
            for name, m in surfaces
        ),
        ContactOnlyIn(("cut",), "doWirePower", 4.0),
        FeedWindow(Segment.read("cut/front"), 0.002, 0.006),
    )
    actions = (
        TargetAction(0, "confirm", "Mount the wire: 638.2 mm of Kanthal D 1.2 mm"),
        TargetAction(0, "on", signal="doWirePower"),
        TargetAction(0, "wait", seconds=4.0),
        TargetAction(n - 1, "off", signal="doWirePower"),
        TargetAction(n - 1, "confirm", "Take the wire off"),
    )
    targets = Targets(
        ARMS,
        pose,
        dict.fromkeys(ARMS, "stock"),
        (spin,),
        feed,
        np.where(cutting, 0.002, 0.0),
        travel,
        stop,
        tuple(map(Segment.read, segment)),
        True,
        FlexibleTool(points, 6e-4),
        actions,
        held,
        _exhibits(points[cutting]),
    )
    home = job.cell.arms[0].home
    entry = {arm: np.stack([home, 0.5 * (home + q[arm][0]), q[arm][0]]) for arm in ARMS}
    leave = {arm: np.stack([q[arm][-1], 0.5 * (home + q[arm][-1]), home]) for arm in ARMS}
    stages = {"reach": 0.21, "ladder": 0.33, "trajopt": 0.41, "timing": 0.08}
    metrics = {
        "ladder_cost": 31.2,
        "trajopt_cost": 21.9,
        "least_clearance": 0.021,
        "limit_margin": 0.31,
        "stages": stages,
        "placement": _placement(),
    }
    done = OperationPlan("faces", targets, q, np.zeros((n, 1)), time, entry, leave, ARMS, metrics)
    bases = {arm.name: arm.base for arm in job.cell.arms}
    versions = {"planner": "0.1.0", "drake": "1.45", "numpy": np.__version__, "python": "3.11"}
    return Plan(job.name, job.digest, versions, (STOCK_POSE,), bases, (done,), {"stages": stages})


def _placement() -> dict[str, object]:
    rng = np.random.default_rng(5)
    tried = np.concatenate([rng.uniform([-0.3, -0.3], [0.3, 0.3], (60, 2)), rng.normal(0, 0.03, (40, 2))])
    score = 0.4 - 2.0 * np.hypot(*tried.T) + 0.02 * rng.normal(size=100)
    return {"positions": tried, "score": score, "unit": "rad", "chosen": int(np.argmax(score))}


def _exhibits(points: np.ndarray) -> dict[str, object]:
    take = points[:: max(1, len(points) // 24)]
    height = take[:, 0, 2]
    return {
        "sections": {
            "kind": "sections",
            "title": "Wire shapes over the panel",
            "frame": "stock",
            "curves": take,
            "value": height * 1e3,
            "value_name": "height",
            "unit": "mm",
        },
        "curvature": {
            "kind": "curve",
            "title": "Greatest curvature of the sections",
            "x": height,
            "x_label": "height [m]",
            "y_label": "curvature [1/m]",
            "series": ({"name": "greatest", "y": 8 + 4 * np.sin(9 * height)},),
            "limits": ({"name": "elastic limit", "value": 14.0},),
        },
        "wire": {
            "kind": "setup",
            "title": "Wire",
            "items": (("material", "Kanthal D, 1.2 mm", ""), ("cold length to cut", 638.2, "mm")),
        },
        "fits": {
            "kind": "table",
            "title": "Fit of the sections",
            "columns": ("face", "sections", "worst [mm]"),
            "rows": (("front", 12, 0.21), ("back", 12, 0.19)),
        },
    }


def proof(rows: int = 1500) -> Proof:
    """An invented verdict with one failed rule."""
    job, made = problem(), plan(60).operations[0]
    time = np.linspace(0.0, made.time[-1], rows)
    series: dict[str, object] = {"time": time}
    for arm in ARMS:
        q = np.stack([np.interp(time, made.time, made.q[arm][:, k]) for k in range(6)], axis=1)
        speed = np.gradient(q, time, axis=0)
        series |= {
            f"joints/{arm}": q,
            f"speed/{arm}": speed,
            f"acceleration/{arm}": np.gradient(speed, time, axis=0),
        }
    wave = 0.03 + 0.012 * np.cos(time / 5.0)
    series["label"] = np.array([str(made.targets.segment[i]) for i in np.searchsorted(made.time, time)])
    series["wire/1/time"] = time
    series["wire/1/label"] = series["label"]
    series["wire/1/feed"] = np.full(rows, 0.0054)
    series["wire/1/clearance"] = wave + 0.01
    series["wire/1/curvature"] = 10 + np.sin(time / 9.0)
    series["wire/1/stability"] = 0.4 + 0.1 * np.sin(time / 7.0)
    series["clearance/time"] = time
    series["clearance/distance"] = wave
    series["clearance/pair"] = tuple(
        "left/tool - stock" if w < 0.03 else "right/link_5 - left/tool" for w in wave
    )
    rng = np.random.default_rng(2)
    faces = []
    assert job.part is not None
    for name, mesh in (("cut/front", job.part.front), ("cut/back", job.part.back)):
        assert mesh is not None
        corners = mesh.vertices[mesh.faces]
        weights = rng.dirichlet(np.ones(3), (len(corners), 4))
        p = np.einsum("fkc,fjc->fkj", weights, corners.transpose(0, 2, 1)).reshape(-1, 3)
        d = 3e-4 * np.sin(30 * p[:, 0]) * np.cos(20 * p[:, 2]) + 3e-5 * rng.normal(size=len(p))
        fraction = float((np.abs(d) < 5e-4).mean())
        rms, worst = float(np.sqrt((d**2).mean())), float(np.abs(d).max())
        faces.append(
            CutFace(Segment.read(name), p, d, np.full(len(p), 1e-5), 5e-4, fraction, 0.95, rms, worst)
        )
    rules = (
        RuleResult("internal.error", "joint limits hold on the replayed motion", True, 18.2, 2.0, "deg"),
        RuleResult(
            "internal.error", "clearance of everything to everything", False, 8.7, 10.0, "mm", "cut/front/7"
        ),
        RuleResult("internal.error", "every move has its partner of equal ID", True),
        RuleResult("internal.error", "the wire stays stable", False, ran=False),
    )
    issue = Issue(
        "internal.error",
        "left/tool comes within 8.7 mm of the stock, 10 mm is asked for",
        Severity.ERROR,
        arm="left",
        index=31,
        target="cut/front/7",
        time=12.5,
        bodies=("left/tool", "stock"),
        value=8.7,
        limit=10.0,
        unit="mm",
        hint="move the stock or ask for less clearance",
        count=4,
    )
    return Proof(job.digest, rules, (issue,), series, tuple(faces), "v 0 0 0\n")
