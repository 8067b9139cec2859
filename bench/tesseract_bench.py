"""One arm along a curve with a free spin, beside Tesseract's Descartes planner, each in a process of its own.

The same URDF (Tesseract reads ``tesseract:capsule`` where Drake wants ``drake:capsule``), tool, block, poses,
spins every 10 degrees, allowed pairs and wanted clearance. Tesseract's wheel wants a newer C++ library, hence
a newer C library, than some systems have; then the rows say "skipped" with the loader's own reason.
``TANDEM_TESSERACT_PYTHON`` names another interpreter that can load it. Runs take turns, times are processor
time from poses to joints (Tandem's with optimisation, clock and ways from home and back besides), memory is
the peak of the whole process. Figures of a path are worked out here, alike for both.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from bench.motion_jobs import block, s_curve
from bench.tesseract_peer import peak_memory
from planner.catalogue import robots
from planner.cell import plant
from planner.cell.bodies import Solid
from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, Shape, from_parts
from planner.motion.operation import plan_operation
from planner.motion.planning_scene import Scene
from planner.problem import Settings

PYTHON = "TANDEM_TESSERACT_PYTHON"
"""Environment variable: the interpreter that loads Tesseract's wheel; this one unless set."""
WHEEL = "tesseract-robotics-nanobind"
PEER = Path(__file__).with_name("tesseract_peer.py")
NAMESPACE = "https://github.com/tesseract-robotics/tesseract"
COUNTS = (400, 800)
"""Numbers of poses. At 4,000 Tesseract gave no result within 11 GB."""
RUNS = 3
SPIN = np.deg2rad(10.0)
STOCK_POSE = from_parts(np.eye(3), np.array([0.5, 0.0, 0.0]))
SIZE = (0.6, 0.8, 0.1)
MAX_PEER_TIME_S = 600
"""Time limit [s] of a run of either planner, for a machine that begins to swap."""


def interpreter() -> str:
    """The Python that is to run Tesseract."""
    return os.environ.get(PYTHON) or sys.executable


def reason() -> str | None:
    """Why Tesseract cannot be run here, None where it can."""
    try:
        probe = subprocess.run(
            [interpreter(), str(PEER)], capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{interpreter()}: {error}"
    if probe.returncode == 0:
        return None
    said = (probe.stdout or probe.stderr).strip().splitlines()
    if said and "No module named 'tesseract_robotics'" in said[-1]:
        return f"{WHEEL} is not installed (pip install 'tandem-planner[bench]')"
    return said[-1] if said else f"exit code {probe.returncode}"


def run() -> list[dict[str, Any]]:
    """Rows of time, memory and path of either planner, for each number of poses."""
    missing = reason()
    return [row for count in COUNTS for row in compare(count, missing)]


def compare(count: int, missing: str | None) -> list[dict[str, Any]]:
    """Both planners' rows at ``count`` poses; ``missing``: why Tesseract is left out."""
    ours: list[dict[str, Any]] = []
    theirs: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = write_job(folder, count)
        for _ in range(RUNS):
            command = [sys.executable, "-m", "bench.tesseract_bench", str(folder), str(count)]
            ours.append(_run(command, folder))
            if missing is None:
                theirs.append(_run([interpreter(), str(PEER), str(folder)], folder))
    title = f"one arm, {count} poses, 36 spins"
    mine = _row(f"Tandem: {title}", ours, model)
    if missing is not None:
        return [mine, {"name": f"Tesseract: {title}", "note": f"skipped: {missing}", "skipped": missing}]
    peer = _row(f"Tesseract: {title}", theirs, model)
    if peer.get("median_s"):
        mine["ratio"] = mine["median_s"] / peer["median_s"]
    return [mine, peer]


def _run(command: list[str], folder: Path) -> dict[str, Any]:
    """Return the result of a planner's process, or why it ended."""
    found = folder / "found.json"
    found.unlink(missing_ok=True)
    root = str(Path(__file__).resolve().parents[1])
    paths = os.pathsep.join(p for p in (root, os.environ.get("PYTHONPATH")) if p)
    environment = {**os.environ, "PYTHONPATH": paths}
    try:
        ended = subprocess.run(
            command, capture_output=True, text=True, timeout=MAX_PEER_TIME_S, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        return {"q": None, "message": f"no result within {MAX_PEER_TIME_S} s"}
    if not found.exists():
        said = ended.stderr.strip().splitlines()
        return {"q": None, "message": f"exit code {ended.returncode}: {said[-1] if said else 'no word'}"}
    out: dict[str, Any] = json.loads(found.read_text())
    return out


def _row(name: str, runs: list[dict[str, Any]], model: CellModel) -> dict[str, Any]:
    failed = [own for own in runs if own["q"] is None]
    if failed:
        return {"name": name, "note": f"no path: {failed[0]['message']}"}
    seconds = [own["seconds"] for own in runs]
    q = np.array(runs[-1]["q"])
    squared = float(np.sum(np.diff(q, axis=0) ** 2))
    off, tilt = _max_pose_error(model, q)
    near = least_by_coal(model, q)
    said = "coal is not installed" if near is None else f"least distance by coal {near * 1e3:.2f} mm"
    memory = float(np.median([own["memory_mb"] for own in runs]))
    return {
        "name": name,
        "median_s": float(np.median(seconds)),
        "spread": max(seconds) - min(seconds),
        "memory_mb": memory,
        "squared_steps": squared,
        "least_m": near,
        "version": runs[-1].get("version", ""),
        "note": f"{memory:.0f} MB, sum of squared joint steps {squared:.4f} rad^2, {said}, "
        f"tools off by {off:.0e} m, {tilt:.0e} rad",
    }


def _max_pose_error(model: CellModel, q: FloatArray) -> tuple[float, float]:
    """How far the TCP [m] and the tool's axis [rad] are off the poses at most, for joints (N, 6)."""
    _, targets = s_curve(len(q))
    ((arm, expected),) = targets.pose.items()
    result = model.tcp({arm: q})[arm]
    tilt = np.linalg.norm(np.cross(result[:, :3, 2], expected[:, :3, 2]), axis=1)
    facing = np.sum(result[:, :3, 2] * expected[:, :3, 2], axis=1)
    way = np.linalg.norm(result[:, :3, 3] - expected[:, :3, 3], axis=1)
    return float(way.max()), float(np.arctan2(tilt, facing).max())


def write_job(folder: Path, count: int) -> CellModel:
    """Write the job for Tesseract into ``folder``; the cell's model."""
    cell, targets = s_curve(count)
    model = plant.build_cell_model(cell, block(SIZE, STOCK_POSE), STOCK_POSE)
    (arm,) = cell.arms
    data = robots.robot(arm.robot)
    (folder / "cell.urdf").write_text(urdf(model))
    (folder / "cell.srdf").write_text(srdf(model, folder))
    opw = {k: float(getattr(data.opw, k)) for k in ("a1", "a2", "b", "c1", "c2", "c3", "c4")}
    opw |= {"offsets": data.opw.offsets.tolist(), "sign_corrections": data.opw.signs.astype(int).tolist()}
    ends = {"base_link": "base_link", "tip_link": "tool0"}
    forward = {"KDLFwdKinChain": {"class": "KDLFwdKinChainFactory", "config": ends}}
    inverse = {"OPWInvKin": {"class": "OPWInvKinFactory", "config": {**ends, "params": opw}}}
    kinematics = {
        "search_libraries": ["tesseract_kinematics_opw_factories", "tesseract_kinematics_kdl_factories"],
        "fwd_kin_plugins": {"manipulator": {"default": "KDLFwdKinChain", "plugins": forward}},
        "inv_kin_plugins": {"manipulator": {"default": "OPWInvKin", "plugins": inverse}},
    }
    manager = {"BulletDiscreteBVHManager": {"class": "BulletDiscreteBVHManagerFactory"}}
    contacts = {
        "search_libraries": ["tesseract_collision_bullet_factories"],
        "discrete_plugins": {"default": "BulletDiscreteBVHManager", "plugins": manager},
    }
    (folder / "kinematics.yaml").write_text(yaml.safe_dump({"kinematic_plugins": kinematics}))
    (folder / "contacts.yaml").write_text(yaml.safe_dump({"contact_manager_plugins": contacts}))
    poses = np.linalg.inv(arm.base) @ targets.pose[arm.name]
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    job = {
        "poses": np.concatenate([poses[:, :3, 3], turns], axis=1).tolist(),
        "resolution": SPIN,
        "spin": [-np.pi, np.pi - SPIN],
        "clearance": Settings().clearance,
        "collisions": True,
    }
    (folder / "job.json").write_text(json.dumps(job))
    return model


def urdf(model: CellModel) -> str:
    """The robot's own URDF with tool, TCP and block for Tesseract, in the frame of the base."""
    (arm,) = model.cell.arms
    text = robots.urdf_path(arm.robot).read_text(encoding="utf-8")
    text = text.replace("drake:capsule", "tesseract:capsule").rsplit("</robot>", 1)[0]
    text = text.replace("<robot ", f'<robot xmlns:tesseract="{NAMESPACE}" tesseract:make_convex="false" ', 1)
    own = {"tool": ("tool0", np.eye(4)), "stock": ("base_link", np.linalg.inv(arm.base) @ model.stock_pose)}
    for link, (parent, pose) in own.items():
        body = f"{arm.name}/tool" if link == "tool" else link
        shapes = "".join(_collision(s) for s in model.solids if s.body == body)
        text += f'<link name="{link}">{shapes}</link>{_fixed_joint(link, parent, pose)}'
    return f'{text}<link name="tcp"/>{_fixed_joint("tcp", "tool0", arm.tool.tcp)}</robot>\n'


def _fixed_joint(link: str, parent: str, pose: FloatArray) -> str:
    ends = f'<parent link="{parent}"/><child link="{link}"/>'
    return f'<joint name="{link}_joint" type="fixed">{_origin(pose)}{ends}</joint>'


def _origin(pose: FloatArray) -> str:
    xyz = " ".join(repr(float(v)) for v in pose[:3, 3])
    rpy = " ".join(repr(float(v)) for v in Rotation.from_matrix(pose[:3, :3]).as_euler("xyz"))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def _collision(solid: Solid) -> str:
    shape = solid.shape
    if shape.kind == "box":
        what = f'<box size="{" ".join(map(repr, map(float, shape.size)))}"/>'
    elif shape.kind in ("cylinder", "capsule"):
        tag = f"tesseract:{shape.kind}" if shape.kind == "capsule" else shape.kind
        what = f'<{tag} radius="{shape.size[0]!r}" length="{shape.size[1]!r}"/>'
    else:
        raise ValueError(
            f"the job has a {shape.kind}; only boxes, cylinders and capsules are exported to Tesseract"
        )
    return f"<collision>{_origin(shape.pose)}<geometry>{what}</geometry></collision>"


def srdf(model: CellModel, folder: Path) -> str:
    """Return the arm as a group, the plugins, and the pairs that are not checked."""
    (arm,) = model.cell.arms
    pairs = "".join(
        f'<disable_collisions link1="{a.removeprefix(arm.name + "/")}" '
        f'link2="{b.removeprefix(arm.name + "/")}" reason="Never"/>'
        for a, b, _ in model.filtered_pairs
    )
    return (
        f'<robot name="{arm.robot}"><group name="manipulator"><chain base_link="base_link" tip_link="tool0"/>'
        f'</group><kinematics_plugin_config filename="{folder / "kinematics.yaml"}"/>'
        f'<contact_managers_plugin_config filename="{folder / "contacts.yaml"}"/>{pairs}</robot>\n'
    )


def least_by_coal(model: CellModel, q: FloatArray) -> float | None:
    """Return the minimum distance [m] of all checked pairs at joints ``q`` (N, 6) by the library coal.

    None if coal is not installed.
    """
    try:
        import coal
    except ImportError:
        return None
    (arm,) = model.arms
    poses = model.poses({arm: q})
    shaped = [(solid, _coal_shape(coal, solid.shape)) for solid in model.bounds.all_solids]
    apart = {frozenset(pair[:2]) for pair in model.filtered_pairs} - set(model.partially_checked)
    minimum = np.inf
    request, answer = coal.DistanceRequest(), coal.DistanceResult()
    for i, (item, own) in enumerate(shaped):
        for j, (other, its) in enumerate(shaped[i + 1 :], start=i + 1):
            bodies = frozenset((item.body, other.body))
            if (
                len(bodies) == 1
                or bodies in apart
                or (i, j) not in model.partially_checked.get(bodies, [(i, j)])
            ):
                continue
            first = np.broadcast_to(poses[item.body] @ item.shape.pose, (len(q), 4, 4))
            second = np.broadcast_to(poses[other.body] @ other.shape.pose, (len(q), 4, 4))
            for a, b in zip(first, second, strict=True):
                answer.clear()
                at = [coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (a, b)]
                minimum = min(minimum, coal.distance(own, at[0], its, at[1], request, answer))
    return float(minimum)


def _coal_shape(coal: Any, shape: Shape) -> Any:
    make = {"box": coal.Box, "cylinder": coal.Cylinder, "capsule": coal.Capsule, "sphere": coal.Sphere}
    return make[shape.kind](*shape.size)


def ours(count: int) -> dict[str, Any]:
    """Tandem on the same job: joints at the targets, processor time [s], peak memory [MB]."""
    cell, targets = s_curve(count)
    targets = dataclasses.replace(targets, may_join=False)  # joints at every pose, as the peer gives them
    model = plant.build_cell_model(cell, block(SIZE, STOCK_POSE), STOCK_POSE)
    start = time.process_time()
    scene = Scene.of(cell, targets.arms, STOCK_POSE, Settings(), model)
    operation_plan = plan_operation("s", scene, targets, cell.controller)
    seconds = time.process_time() - start
    (q,) = operation_plan.q.values()
    return {"q": q.tolist(), "seconds": seconds, "memory_mb": peak_memory(), "message": ""}


if __name__ == "__main__":
    (Path(sys.argv[1]) / "found.json").write_text(json.dumps(ours(int(sys.argv[2]))))
