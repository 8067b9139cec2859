"""Small plans for KUKA arms, and helpers that read the text of their programs."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
from scipy.spatial.transform import Rotation

from planner.claims.handshake import Handshake
from planner.targets import TargetAction
from tests.languages.writing import krl_job, synthetic

HOME = np.deg2rad([0.0, -90.0, 90.0, 0.0, 30.0, 0.0])
START = np.deg2rad([5.0, -70.0, 80.0, 15.0, 45.0, -25.0])
LABELS = ["mount", "approach", "approach", *["cut/front"] * 4, "retreat", "unmount"]
ACTIONS = (
    TargetAction(0, "message", text="Check the cutter."),
    TargetAction(0, "on", signal="doSpindle"),
    TargetAction(0, "wait", seconds=2.5),
    TargetAction(0, "confirm", text="Is the spindle up to speed?"),
    TargetAction(8, "off", signal="doSpindle"),
)
MOVE = re.compile(
    r"^(SLIN|LIN) \{X ([-\d.]+),Y ([-\d.]+),Z ([-\d.]+),A ([-\d.]+),B ([-\d.]+),C ([-\d.]+)\}( C_\w+)?$"
)


def at_home(job, homes=None):
    """The problem with its arms at home where KUKA's hang; ABB's stay."""
    arms = tuple(dataclasses.replace(a, home=HOME) if a.robot.startswith("kr") else a for a in job.cell.arms)
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, arms=arms))


def alone(model="kr10_r1100", q=None, labels=LABELS, stop=(6,), actions=ACTIONS, step=0.5, **controller):
    """One arm, nine targets with a stop between cut and retreat; returns (plan, problem)."""
    controller = {"io": {"left": {"doSpindle": 17}}, **controller}
    job = at_home(synthetic.problem(("left",), model=model, **controller))
    joints = {"left": synthetic.sweep(len(labels), start=START) if q is None else q}
    work = synthetic.operation(job, joints, labels, stop=stop, actions=actions, coupled=False, step=step)
    return synthetic.plan(synthetic_homes(work, job)), job


def synthetic_homes(work, job):
    """Return the operation with approach from and retreat to the arms' own homes."""
    homes = {arm.name: arm.home for arm in job.cell.arms}
    entry = {a: np.stack([homes[a], 0.5 * (homes[a] + q[0]), q[0]]) for a, q in work.q.items()}
    leave = {a: np.stack([q[-1], 0.5 * (homes[a] + q[-1]), homes[a]]) for a, q in work.q.items()}
    return dataclasses.replace(work, approach=entry, retreat=leave)


def two(models=("kr10_r1100", "kr10_r1100"), kind="four_phase", every=1, actions=(), **controller):
    """Two arms with a controller each; returns (plan, problem)."""
    io = {
        arm: {
            "doSpindle": 17,
            "doPartner": 1,
            "diPartner": 1,
            "doRunning": 2,
            "diPartnerRunning": 2,
            "doMoveEnable": 3,
        }
        for arm, model in zip(("left", "right"), models, strict=True)
        if model.startswith("kr")
    }
    fields = {"tasks": ("T_ROB1",) * 2, "units": ("ROB_1",) * 2, "io": io, **controller}
    job = synthetic.problem(sync="handshake", handshake=Handshake(kind, every), **fields)
    arms = tuple(dataclasses.replace(a, robot=m) for a, m in zip(job.cell.arms, models, strict=True))
    job = at_home(dataclasses.replace(job, cell=dataclasses.replace(job.cell, arms=arms)))
    q = {
        arm.name: synthetic.sweep(9, size, START if arm.robot.startswith("kr") else synthetic.START)
        for arm, size in zip(job.cell.arms, (0.3, 0.25), strict=True)
    }
    work = synthetic.operation(job, q, LABELS, stop=(6,), actions=actions, coupled=False)
    return synthetic.plan(synthetic_homes(work, job)), job


def body(text):
    """Lines of a file without comments."""
    lines = (line.partition(";")[0].strip() for line in text.split("\r\n"))
    return [line for line in lines if line]


def flat(files, arm="left", stem="test"):
    """Statements in the order in which they run, calls followed, declarations left out."""

    def walk(name):
        for line in body(files[f"{arm}/{name}.src"]):
            if line.startswith(("&", "DEF ", "EXT ", "DECL ")) or line == "END":
                continue
            if line.endswith("()") and f"{arm}/{line[:-2]}.src" in files:
                yield from walk(line[:-2])
            else:
                yield line

    return list(walk(stem))


def folded(statements):
    """Statements with dialogs, messages and looks at the robot's foot as one word each: ASK and READ with
    the text that was put together, TELL, SHOW, CLEAR, FOOT."""
    out, asked, at = [], "", 0
    while at < len(statements):
        line = statements[at]
        text = re.search(r'Msg_txt\[\] "(.*)"\}$', statements[at + 2 if line == "tm_answer=0" else at])
        if line == "tm_answer=0":
            asked = f"{asked} {text.group(1)}".strip()
            key = re.search(r'"(\w+)"', statements[at + 3]).group(1)
            if key != "Next":
                out.append(f"{'ASK' if key == 'Yes' else key.upper()} {asked}")
                asked = ""
            at += 11
        elif line.startswith("tm_msg="):
            out.append(f"{'TELL' if '#NOTIFY' in statements[at + 1] else 'SHOW'} {text.group(1)}")
            at += 2
        elif line.startswith("tm_shift="):
            out.append("FOOT")
            at = statements.index("ENDWHILE", at) + 1
            at += 2 * statements[at].startswith("tm_par")
        elif line.startswith("tm_gone="):
            out.append("CLEAR")
            at += 1
        else:
            out += [] if line.startswith(("tm_", "DECL ")) else [line]
            at += 1
    return out


def data(files, arm="left", stem="test"):
    """{name: {component: value}} of the data list; nested structures are flattened by their last names."""
    out = {}
    for line in body(files[f"{arm}/{stem}.dat"]):
        found = re.match(r"DECL \w+ (\w+)=\{(.*)\}$", line)
        if found:
            out[found.group(1)] = {k: float(v) for k, v in re.findall(r"(\w+) (-?[\d.]+)", found.group(2))}
    return out


def moves(statements):
    """(word, pose (6,), end word, settings in force) of each straight move, in order."""
    now, out = {}, []
    for line in statements:
        setting = re.match(r"^(\$[\w.]+)=([-\d.]+)$", line)
        found = MOVE.match(line)
        if setting:
            now[setting.group(1)] = float(setting.group(2))
        elif found:
            word, *pose, end = found.groups()
            out.append((word, np.array([float(v) for v in pose]), (end or "").strip(), dict(now)))
    return out


def turning_job(dialect="krc4", step=0.5):
    """The arm's wrist turns about the TCP for three moves, then it moves on."""
    plan, problem = krl_job.alone(
        q=synthetic.sweep(9, start=krl_job.START), dialect=dialect, actions=(), step=step
    )
    work = plan.operations[0]
    poses = work.targets.pose["left"].copy()
    for i in range(2, 6):
        spin = Rotation.from_rotvec([0.0, 0.02 * (i - 1), 0.03 * (i - 1)]).as_matrix()
        poses[i, :3, :3], poses[i, :3, 3] = poses[1, :3, :3] @ spin, poses[1, :3, 3]
    targets = dataclasses.replace(work.targets, pose={"left": poses})
    return dataclasses.replace(plan, operations=(dataclasses.replace(work, targets=targets),)), problem
