"""The 3D replay: one offline HTML file with arms, tools, block, obstacles, the bending wire and a time bar.

Written by Drake's Meshcat as static HTML. Rigid bodies move by transforms, and so does the wire, as a chain
of capsules, because animated lines keep only their last state. What has been cut appears strip by strip.
"""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Capsule, Meshcat, MeshcatAnimation, MeshcatParams, Rgba

from planner.cell.plant import CellModel, rigid
from planner.files import write_whole
from planner.geometry.rigid import inverse, transform
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.problem import Problem
from planner.report import scene as scenes
from planner.report.replay_bar import bar
from planner.report.track import Track, track
from planner.targets import segment_kind

FloatArray = NDArray[np.float64]
FPS: Final = 100.0
KEYS: Final = 480
LINKS: Final = 28
_WIRE: Final = Rgba(1.0, 0.30, 0.05, 1.0)
_CUT: Final = Rgba(1.0, 0.72, 0.45, 0.75)
_PART: Final = Rgba(0.10, 0.52, 0.60, 0.45)


def write(model: CellModel, problem: Problem, plan: Plan, path: Path) -> None:
    """Writes the replay to ``path``, whole or not at all. Raises as :func:`document`."""
    write_whole(path, document(model, problem, plan))


def document(model: CellModel, problem: Problem, plan: Plan) -> str:
    """The replay as text. Raises :class:`TandemError` (``report.replay_failed``) if Meshcat cannot start."""
    try:
        meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    except RuntimeError as error:
        issue = Issue("report.replay_failed", f"Meshcat, which writes replay.html, cannot start: {error}")
        raise TandemError(issue) from error
    run = track(problem, plan, KEYS)
    animation = MeshcatAnimation(FPS)
    frames = np.round((run.time - run.time[0]) * FPS).astype(int)
    _look(meshcat, model)
    _bodies(meshcat, animation, frames, model, run)
    _parts(meshcat, problem, plan)
    if run.wire is not None and run.shown is not None:
        _wire(meshcat, animation, frames, run.wire, run.shown, run.wire_radius)
        _strips(meshcat, animation, frames, run, np.asarray(plan.stock_pose), problem.stock.size)
    animation.set_autoplay(False)
    animation.set_repetitions(1)
    meshcat.SetAnimation(animation)
    page = str(meshcat.StaticHtml())
    title = f"{problem.name} – Tandem replay"
    page = page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>")
    return page.replace("</body>", bar(problem.name, run) + "</body>", 1)


def _look(meshcat: Any, model: CellModel) -> None:
    """Background, camera across the line of the bases, no grid or axes."""
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [0.74, 0.78, 0.83])
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Grid", "visible", True)
    places = np.array([model.bases[arm][:3, 3] for arm in model.arms])
    middle = places.mean(axis=0)
    line = places[-1] - places[0] if len(places) > 1 else model.bases[model.arms[0]][:3, 1]
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    reach = max(robot.reach for robot in model.robots.values())
    spread = float(np.linalg.norm(places - middle, axis=1).max()) + 0.8 * reach
    across = np.array([line[1], -line[0], 0.0])
    target = middle + np.array([0.0, 0.0, 0.42 * reach])
    eye = target + 0.82 * spread * across - 0.2 * spread * line + np.array([0.0, 0.0, 0.30 * spread])
    meshcat.SetCameraPose(eye, target)


def _bodies(meshcat: Any, animation: Any, frames: NDArray[np.int_], model: CellModel, run: Track) -> None:
    scene = scenes.extract(model)
    poses = scene.poses(run.q)
    for number, piece in enumerate(scene.pieces):
        path = f"/cell/{piece.body}/{number}"
        alpha = 0.30 if piece.body == "stock" else piece.color[3]
        meshcat.SetObject(path, piece.shape, Rgba(*piece.color[:3], alpha))
        meshcat.SetTransform(path, rigid(piece.pose))
    for body in scene.bodies():
        path = f"/cell/{body}"
        meshcat.SetTransform(path, rigid(poses[body][0]))
        if np.ptp(poses[body], axis=0).max() > 1e-9:
            _animate(animation, frames, path, poses[body])


def _animate(animation: Any, frames: NDArray[np.int_], path: str, poses: FloatArray) -> None:
    """Keys for a moving thing; keys between two equal neighbours say nothing and are left out."""
    moved = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2)) > 1e-9
    keep = np.concatenate([[True], moved]) | np.concatenate([moved, [True]])
    for i in np.flatnonzero(keep):
        animation.SetTransform(int(frames[i]), path, rigid(poses[i]))


def _parts(meshcat: Any, problem: Problem, plan: Plan) -> None:
    if problem.part is None:
        return
    for name, mesh in (("front", problem.part.front), ("back", problem.part.back)):
        if mesh is not None:
            path = f"/wanted part/{name}"
            both = np.concatenate([mesh.faces, mesh.faces[:, ::-1]])
            meshcat.SetTriangleMesh(path, mesh.vertices.T, both.T.astype(np.int32), _PART)
            meshcat.SetTransform(path, rigid(np.asarray(plan.stock_pose)))


def _wire(
    meshcat: Any,
    animation: Any,
    frames: NDArray[np.int_],
    wire: FloatArray,
    shown: NDArray[np.bool_],
    radius: float,
) -> None:
    """A chain of capsules along the wire (T, P, 3), drawn at least 4 mm thick so that it can be seen."""
    points = wire[:, np.unique(np.linspace(0, wire.shape[1] - 1, LINKS + 1).round().astype(int))]
    step = np.diff(points, axis=1)
    length = np.linalg.norm(step, axis=-1)
    poses = _along(0.5 * (points[:, 1:] + points[:, :-1]), step)
    for k in range(step.shape[1]):
        path = f"/wire/{k}"
        meshcat.SetObject(path, Capsule(max(radius, 2.2e-3), float(np.median(length[shown, k]))), _WIRE)
        meshcat.SetTransform(path, rigid(poses[0, k]))
        _animate(animation, frames, path, poses[:, k])
    meshcat.SetProperty("/wire", "visible", bool(shown[0]))
    animation.SetProperty(0, "/wire", "visible", bool(shown[0]))
    for i in np.flatnonzero(np.diff(shown.astype(int))) + 1:
        animation.SetProperty(int(frames[i]), "/wire", "visible", bool(shown[i]))


def _along(middle: FloatArray, direction: FloatArray) -> FloatArray:
    """Poses (..., 4, 4) at ``middle`` with z along ``direction``."""
    z = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    aside = np.where(np.abs(z[..., 2:3]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    x = np.cross(aside, z)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    pose = np.zeros((*z.shape[:-1], 4, 4))
    pose[..., :3, 0], pose[..., :3, 1], pose[..., :3, 2] = x, np.cross(z, x), z
    pose[..., :3, 3], pose[..., 3, 3] = middle, 1.0
    return pose


def _strips(
    meshcat: Any, animation: Any, frames: NDArray[np.int_], run: Track, place: FloatArray, size: FloatArray
) -> None:
    """What the wire sweeps within the block while it cuts, as strips that appear when they are cut."""
    if run.wire is None:
        return
    cutting = np.array([segment_kind(label) == "cut" for label in run.segment])
    points = run.wire[:, np.unique(np.linspace(0, run.wire.shape[1] - 1, 25).round().astype(int))]
    rows = np.flatnonzero(cutting[1:] & cutting[:-1])
    count = points.shape[1]
    for number, block in enumerate(np.array_split(rows, max(1, min(90, len(rows))))):
        if not len(block):
            continue
        span = np.concatenate([block, block[-1:] + 1])
        vertices = points[span].reshape(-1, 3)
        i, j = np.meshgrid(np.arange(len(span) - 1), np.arange(count - 1), indexing="ij")
        a = (i * count + j).ravel()
        quads = np.concatenate(
            [np.stack([a, a + 1, a + count + 1], 1), np.stack([a, a + count + 1, a + count], 1)]
        )
        middle = transform(inverse(place), vertices[quads].mean(axis=1)) - [0.0, 0.0, 0.5 * size[2]]
        quads = quads[(np.abs(middle) <= 0.5 * size).all(axis=1)]
        if not len(quads):
            continue
        faces = np.concatenate([quads, quads[:, ::-1]])
        path = f"/cut/{number}"
        meshcat.SetTriangleMesh(path, vertices.T, faces.T.astype(np.int32), _CUT)
        animation.SetProperty(0, path, "visible", False)
        animation.SetProperty(int(frames[span[-1]]), path, "visible", True)
