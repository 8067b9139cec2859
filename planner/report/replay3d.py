"""The 3D replay: one offline HTML file with arms, tools, block, obstacles, the bending wire and a time bar.

Written by Drake's Meshcat as static HTML. Rigid bodies move by transforms, and so does the wire, as a chain
of capsules, because animated lines keep only their last state. What has been cut appears strip by strip.
"""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Capsule, Meshcat, MeshcatAnimation, MeshcatParams, Rgba

from planner.cell.plant import CellModel, rigid
from planner.files import write_whole
from planner.issues import Issue, TandemError
from planner.plans import Plan
from planner.problem import Mesh, Problem, Setup
from planner.report import scene as scenes
from planner.report import sweep
from planner.report.replay_bar import Clock, bar, clock
from planner.report.track import Track, track
from planner.verify.result import Proof

FloatArray = NDArray[np.float64]
FPS: Final = 100.0
KEYS: Final = 480
KEYS_MORE: Final = 240
"""Keyframes of a job of one operation, and of each further one."""
STRIPS: Final = 120
LEFT: Final = 0.001
"""How far [m] inside a block that was trimmed earlier cuts are still drawn: those that trimmed it are now its
sides."""
LINKS: Final = 28
BLOCK: Final = "/block"
_CUT: Final = Rgba(1.0, 0.66, 0.36, 1.0)
_FOAM: Final = Rgba(0.97, 0.91, 0.66, 0.42)
_PART: Final = Rgba(0.16, 0.56, 0.62, 1.0)


def write(model: CellModel, problem: Problem, plan: Plan, path: Path) -> None:
    """Writes the replay to ``path``, whole or not at all. Raises as :func:`document`."""
    write_whole(path, document(model, problem, plan))


def document(model: CellModel, problem: Problem, plan: Plan, proof: Proof | None = None) -> str:
    """The replay as text. ``model``: the cell, for its robots and fixed bodies; a ``proof`` has the clock
    that its issues are told by.

    Raises :class:`TandemError` (``report.replay_failed``) if Meshcat cannot start.
    """
    try:
        meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    except RuntimeError as error:
        issue = Issue("report.replay_failed", f"Meshcat, which writes replay.html, cannot start: {error}")
        raise TandemError(issue) from error
    run = track(problem, plan, KEYS + KEYS_MORE * max(0, len(plan.operations) - 1))
    animation = MeshcatAnimation(FPS)
    film = _Film(meshcat, animation, np.round((run.time - run.time[0]) * FPS).astype(int))
    _look(meshcat, model, run)
    _bodies(film, model, problem, plan.places, run)
    _parts(meshcat, problem)
    if run.wire is not None:
        _wire(film, run.wire, run.shown, run.wire_radius)
    _strips(film, problem, run)
    animation.set_autoplay(False)
    animation.set_repetitions(1)
    meshcat.SetAnimation(animation)
    page = str(meshcat.StaticHtml())
    title = f"{problem.name} – Tandem replay"
    page = page.replace("<title>Drake MeshCat</title>", f"<title>{html.escape(title)}</title>")
    return page.replace("</body>", bar(problem.name, run, _clock(run, proof)) + "</body>", 1)


def _clock(run: Track, proof: Proof | None) -> Clock:
    series = proof.series if proof is not None else {}
    if "time" not in series or "label" not in series:
        return ()
    return clock(run, np.asarray(series["time"]), [str(label) for label in series["label"]])


@dataclasses.dataclass(frozen=True)
class _Film:
    """Meshcat, its animation, and the frame (T,) of each key."""

    meshcat: Any
    animation: Any
    frames: NDArray[np.int_]

    def move(self, path: str, poses: FloatArray) -> None:
        """Keys (T, 4, 4) for a thing; keys between two equal neighbours say nothing and are left out."""
        self.meshcat.SetTransform(path, rigid(poses[0]))
        moved = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2)) > 1e-9
        if not moved.any():
            return
        keep = np.concatenate([[True], moved]) | np.concatenate([moved, [True]])
        for i in np.flatnonzero(keep):
            self.animation.SetTransform(int(self.frames[i]), path, rigid(poses[i]))

    def show(self, path: str, seen: NDArray[np.bool_]) -> None:
        """Shows and hides a thing by keys (T,)."""
        if seen.all():
            return
        self.meshcat.SetProperty(path, "visible", bool(seen[0]))
        self.animation.SetProperty(0, path, "visible", bool(seen[0]))
        for i in np.flatnonzero(np.diff(seen.astype(int))) + 1:
            self.animation.SetProperty(int(self.frames[i]), path, "visible", bool(seen[i]))


def _look(meshcat: Any, model: CellModel, run: Track) -> None:
    """Background, camera across the line of the bases, or of the base and the block; no axes."""
    meshcat.SetProperty("/Background", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background", "bottom_color", [0.74, 0.78, 0.83])
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetProperty("/Grid", "visible", True)
    places = np.array([model.bases[arm][:3, 3] for arm in model.arms])
    reach = max(robot.reach for robot in model.robots.values())
    block = run.block[:, :3, 3]
    ends = places if len(places) > 1 else np.stack([places[0], block.mean(axis=0)])
    line = (ends[-1] - ends[0]) * np.array([1.0, 1.0, 0.0])
    line = line / max(float(np.linalg.norm(line)), 1e-9)
    seen = np.concatenate([places, places + np.array([0.0, 0.0, 0.85 * reach]), block])
    target = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    spread = float(np.linalg.norm(seen - target, axis=1).max()) + 0.6 * reach
    across = np.array([line[1], -line[0], 0.0])
    target[2] -= 0.10 * spread  # the bar takes the foot of the picture
    eye = target + 0.92 * spread * across - 0.2 * spread * line + np.array([0.0, 0.0, 0.35 * spread])
    meshcat.SetCameraPose(eye, target)


def _bodies(
    film: _Film, model: CellModel, problem: Problem, places: Sequence[FloatArray], run: Track
) -> None:
    """Robots and fixed bodies, tools and blocks of all setups, each shown in the setups that have it."""
    scene = scenes.extract(model)
    poses = scene.poses(run.q)
    for number, piece in enumerate(scene.pieces):
        _object(film, f"/cell/{piece.body}/{number}", piece)
    for body in scene.bodies():
        film.move(f"/cell/{body}", poses[body])
    for arm in model.arms:
        film.move(f"/cell/{arm}/tool", poses[f"{arm}/tool"])
    film.move(BLOCK, run.block)
    sets: dict[str, tuple[list[scenes.Piece], NDArray[np.bool_]]] = {}
    for index, setup in enumerate(problem.setups):
        for name, pieces in _groups(setup, places[index]).items():
            path = next(
                (p for p, (known, _) in sets.items() if p.startswith(name) and _same(known, pieces)), ""
            )
            path = path or f"{name}/{index}"
            seen = sets.setdefault(path, (pieces, np.zeros(len(run.time), dtype=bool)))[1]
            seen |= run.setup == index
    for path, (pieces, seen) in sets.items():
        for number, piece in enumerate(pieces):
            _object(film, f"{path}/{number}", piece)
        film.show(path, seen)


def _groups(setup: Setup, place: FloatArray) -> dict[str, list[scenes.Piece]]:
    """Pieces of a setup by the path of what they move with."""
    out: dict[str, list[scenes.Piece]] = {}
    for piece in scenes.mounted(setup, place):
        arm, _, kind = piece.body.partition("/")
        out.setdefault(f"/cell/{arm}/tool" if kind else f"{BLOCK}/{piece.body}", []).append(piece)
    return out


def _same(one: list[scenes.Piece], other: list[scenes.Piece]) -> bool:
    """Whether two groups look the same."""
    return len(one) == len(other) and all(
        a.body == b.body
        and a.solid.vertices.shape == b.solid.vertices.shape
        and np.allclose(a.solid.moved(a.pose).vertices, b.solid.moved(b.pose).vertices, atol=1e-9)
        for a, b in zip(one, other, strict=True)
    )


def _object(film: _Film, path: str, piece: scenes.Piece) -> None:
    film.meshcat.SetObject(path, piece.shape, _FOAM if piece.body == "stock" else Rgba(*piece.color))
    film.meshcat.SetTransform(path, rigid(piece.pose))


def _parts(meshcat: Any, problem: Problem) -> None:
    """The wanted surfaces, which move with the block."""
    for name, mesh in sweep.part_meshes(problem.part):
        _surface(meshcat, f"{BLOCK}/wanted/{name}", mesh, _PART)


def _surface(meshcat: Any, path: str, mesh: Mesh, color: Rgba) -> None:
    """A surface that can be seen from both sides."""
    both = np.concatenate([mesh.faces, mesh.faces[:, ::-1]])
    meshcat.SetTriangleMesh(path, mesh.vertices.T, both.T.astype(np.int32), color)


def _wire(film: _Film, wire: FloatArray, shown: NDArray[np.bool_], radius: float) -> None:
    """A chain of capsules along the wire (T, P, 3), drawn thick enough to be seen."""
    points = wire[:, np.unique(np.linspace(0, wire.shape[1] - 1, LINKS + 1).round().astype(int))]
    step = np.diff(points, axis=1)
    length = np.linalg.norm(step, axis=-1)
    poses = _along(0.5 * (points[:, 1:] + points[:, :-1]), step)
    for k in range(step.shape[1]):
        path = f"/wire/{k}"
        shape = Capsule(max(radius, scenes.SEEN), float(np.median(length[shown, k])))
        film.meshcat.SetObject(path, shape, Rgba(*scenes.HOT))
        film.move(path, poses[:, k])
    film.show("/wire", shown)


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


def _strips(film: _Film, problem: Problem, run: Track) -> None:
    """What wires sweep within the block while they cut, as strips that appear when they are cut and stay.

    In later setups, in which the block may have become smaller, they are drawn as far as it goes then.
    """
    number = 0
    blocks = [setup.stock for setup in problem.setups]
    total = sum(len(cut.keys) for cut in run.sweeps)
    for cut in run.sweeps:
        own = blocks[cut.setup]
        some = np.unique(np.linspace(0, cut.points.shape[1] - 1, 25).round().astype(int))
        points = cut.points[:, some]
        steps = np.arange(len(cut.keys) - 1)
        count = max(1, min(len(steps), round(STRIPS * len(steps) / max(total, 1))))
        kept = [k for k, block in enumerate(blocks) if k >= cut.setup and sweep.alike(block, own)]
        parts = [(part, own.lower, own.upper, kept) for part in np.array_split(steps, count)]
        smaller = (k for k in range(cut.setup + 1, len(blocks)) if k not in kept)
        parts += [(steps, blocks[k].lower + LEFT, blocks[k].upper - LEFT, [k]) for k in smaller]
        for part, lower, upper, setups in parts:
            mesh = sweep.surface(points[part[0] : part[-1] + 2], lower, upper) if len(part) else None
            if mesh is None:
                continue
            path = f"{BLOCK}/cut/{number}"
            _surface(film.meshcat, path, mesh, _CUT)
            done = np.arange(len(run.time)) >= cut.keys[part[-1] + 1]
            film.show(path, done & np.isin(run.setup, setups))
            number += 1
