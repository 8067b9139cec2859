"""Pictures of a cell: arms, tools, block and wire at one moment, rendered without a display.

Shown is one moment of each setup, in the midst of its longest work.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy import ndimage

from planner.cell.plant import CellModel
from planner.geometry.arrays import FloatArray, IndexArray, Mesh, transform
from planner.plans import OperationPlan, Plan
from planner.problem import Problem, Setup
from planner.report import raster, scene
from planner.report.raster import Camera, Solid, Thing
from planner.report.replay import TRIMMED_DEPTH_M
from planner.report.scene import Scene, mounted, stand

HOT_WIRE_COLOUR: Final = (1.0, 0.30, 0.06)
"""Red, green, blue in 0..1 of a hot wire."""
PART_COLOUR: Final = (0.16, 0.56, 0.62)
"""Red, green, blue in 0..1 of the wanted part."""
BLOCK_COLOUR: Final = (0.86, 0.90, 0.84)
"""Red, green, blue in 0..1 of the block, which is laid over the picture as a veil."""
_EARLIER_WIRE_COLOUR: Final = (1.0, 0.62, 0.35)
"""Red, green, blue in 0..1 of the wire where it was before."""


CUT_COLOUR: Final = (1.0, 0.66, 0.36)
"""Red, green, blue in 0..1 of what straight wires have cut."""


@dataclasses.dataclass(frozen=True)
class Moment:
    """Joint angles {arm: (6,)} in a setup with the stock at ``place`` (4, 4) in the world.

    A wire (P, 3) in the world that joins the arms, earlier ones (S, P, 3); wanted surfaces ``part`` and what
    has been ``cut``, in the stock frame. ``bases`` {arm: (4, 4)}: of arms whose tracks go along.
    """

    setup: Setup
    place: FloatArray
    q: Mapping[str, FloatArray]
    wire: FloatArray | None = None
    earlier: Sequence[FloatArray] = ()
    part: Sequence[Mesh] = ()
    cut: Sequence[Mesh] = ()
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Picture:
    """``pixels`` (h, w, 3), premultiplied, and ``alpha`` (h, w) in 0..1; ``labels``: name, x, y in 0..1."""

    pixels: FloatArray
    alpha: FloatArray
    labels: tuple[tuple[str, float, float], ...]


def picture(scene: Scene, moment: Moment, width: int = 900, height: int = 500) -> Picture:
    """The cell from the side where the arms stand apart, on a clear ground with a shadow."""
    poses = stand(scene, moment.setup, moment.place, {arm: q[None] for arm, q in moment.q.items()})
    pieces = (*scene.pieces, *mounted(moment.setup, moment.place))
    solid = {id(piece): piece.solid.moved(poses[piece.body][0] @ piece.pose) for piece in pieces}
    opaque, block = [], []
    for piece in pieces:
        hot = piece.body.endswith("/edge")
        if piece.body == "stock":
            block.append(Thing(solid[id(piece)], BLOCK_COLOUR))
        else:
            paint = HOT_WIRE_COLOUR if hot else piece.color[:3]
            opaque.append(Thing(solid[id(piece)], paint, 1.0 if hot else 0.0, piece.closed))
    for meshes, paint in ((moment.part, PART_COLOUR), (moment.cut, CUT_COLOUR)):
        for mesh in meshes:
            shown = raster.mesh(mesh.vertices, mesh.faces, smooth=True).moved(poses["stock"][0])
            opaque.append(Thing(shown, paint, 0.0, closed=False))
    opaque += [Thing(raster.tube(wire, 0.0011, 6), _EARLIER_WIRE_COLOUR, 0.85) for wire in moment.earlier]
    if moment.wire is not None:
        opaque.append(Thing(raster.tube(moment.wire, 0.0032), HOT_WIRE_COLOUR, 1.0))
    fixed = {obstacle.name for obstacle in scene.model.cell.obstacles}
    subject = [solid[id(piece)].vertices for piece in pieces if piece.body not in fixed]
    camera = raster.frame(np.concatenate(subject), _direction(scene, moment.place), 2 * width, 2 * height)
    image = raster.rendered(camera, opaque)
    color, alpha = image.color, np.isfinite(image.depth).astype(np.float64)
    color, alpha = _veil(camera, block, image.depth, color, alpha)
    color, alpha = _ground(camera, [*opaque, *block], color, alpha)
    alpha = alpha * _fade(camera)
    labels = []
    for arm in scene.model.arms:
        base = f"{arm}/base_link"
        foot = [p.solid.moved(poses[base][0] @ p.pose).vertices for p in scene.pieces if p.body == base]
        place = foot[0] if foot else scene.model.bases[arm][None, :3, 3]
        x, y, _ = camera.project(np.concatenate([place, *foot])).T
        labels.append((arm, float(x.mean() / camera.width), float(y.max() / camera.height + 0.012)))
    return _cropped(
        Picture(_halved(color * alpha[..., None]), _halved(alpha[..., None])[..., 0], tuple(labels))
    )


def _cropped(picture: Picture, margin: int = 14) -> Picture:
    """The picture without empty rows above and below; pixels are premultiplied."""
    rows = np.flatnonzero((picture.alpha > 0.02).any(axis=1))
    h = len(picture.alpha)
    a, b = max(int(rows[0]) - margin, 0), min(int(rows[-1]) + margin + 18, h)
    labels = tuple((name, x, (y * h - a) / (b - a)) for name, x, y in picture.labels)
    return Picture(picture.pixels[a:b], picture.alpha[a:b], labels)


def _direction(scene: Scene, place: FloatArray) -> FloatArray:
    """A view from above across the line from the first base to the last, or from a single one to the
    block."""
    places = [*(scene.model.bases[arm][:3, 3] for arm in scene.model.arms), place[:3, 3]]
    line = places[max(1, len(places) - 2)] - places[0]
    if np.linalg.norm(line[:2]) < 1e-6:
        line = scene.model.bases[scene.model.arms[0]][:3, 0]
    line = line[:2] / max(float(np.linalg.norm(line[:2])), 1e-9)
    across = np.array([-line[1], line[0]])
    flat = across + 0.30 * line
    return np.array([flat[0], flat[1], -0.42])


def _veil(
    camera: Camera, block: list[Thing], depth: FloatArray, color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Lays the block over the picture as a translucent body with its ink lines kept."""
    if not block:
        return color, alpha
    window = camera.window(np.concatenate([thing.solid.vertices for thing in block]))
    image = raster.rendered(window, block)
    part = np.s_[window.top : window.top + window.height, window.left : window.left + window.width]
    strength = np.where(image.color.sum(axis=-1) < 1.25, 0.75, 0.42) * (image.depth < depth[part])
    color[part], alpha[part] = _over(image.color, strength, color[part], alpha[part])
    return color, alpha


def _over(
    top: FloatArray, strength: FloatArray, color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One picture laid over another (Porter and Duff 1984), colours not premultiplied."""
    out = strength + alpha * (1.0 - strength)
    mixed = top * strength[..., None] + color * (alpha * (1.0 - strength))[..., None]
    return mixed / np.maximum(out, 1e-9)[..., None], out


def _ground(
    camera: Camera, things: list[Thing], color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A soft shadow on the ground, darker the lower what hangs above it, at a quarter of the resolution."""
    points = np.concatenate([_scattered(thing.solid) for thing in things])
    low, high = points.min(axis=0) - 0.35, points.max(axis=0) + 0.35
    cell = float((high - low)[:2].max()) / 260.0
    shape = np.ceil((high[:2] - low[:2]) / cell).astype(int) + 1
    weight = np.exp(-np.maximum(points[:, 2], 0.0) / 0.30)
    index = ((points[:, :2] - low[:2]) / cell).astype(int)
    cover = np.zeros(shape)
    np.maximum.at(cover, (index[:, 0], index[:, 1]), weight)
    cover = ndimage.grey_closing(cover, size=(5, 5))
    soft = 0.8 * ndimage.gaussian_filter(cover, 2.0) + 0.5 * ndimage.gaussian_filter(cover, 9.0)
    step = 4
    x, y = np.meshgrid(np.arange(0, camera.width, step) + 2.0, np.arange(0, camera.height, step) + 2.0)
    flat = np.stack([x - 0.5 * camera.full[0], y - 0.5 * camera.full[1], np.full_like(x, camera.focal)], -1)
    ray = flat @ camera.pose[:3, :3].T
    reach = (min(0.0, float(points[:, 2].min())) - camera.pose[2, 3]) / np.minimum(ray[..., 2], -1e-9)
    hit = camera.pose[:2, 3] + reach[..., None] * ray[..., :2]
    place = np.moveaxis((hit - low[:2]) / cell, -1, 0)
    coarse = np.clip(ndimage.map_coordinates(soft, place, order=1, cval=0.0), 0.0, 1.0) * 0.45
    shade = ndimage.zoom(coarse, step, order=1)[: camera.height, : camera.width]
    tint = np.broadcast_to([0.17, 0.19, 0.24], color.shape)
    return _over(color, alpha, np.asarray(tint), shade)


def _scattered(solid: Solid) -> FloatArray:
    """The solid's vertices and more points on its larger faces, so that it covers what is under it."""
    corners = solid.vertices[solid.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    often = np.minimum((area / 2e-4).astype(int), 2000)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), int(often.sum()))
    inner = np.einsum("pk,pkc->pc", weights, np.repeat(corners, often, axis=0))
    return np.concatenate([solid.vertices, inner])


def _fade(camera: Camera) -> FloatArray:
    """Strength (h, w) that falls to 0 at the left, right and lower border, where only obstacles reach."""
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    width = 0.028 * camera.width
    side = np.clip(np.minimum(x, camera.width - x) / width, 0.0, 1.0)
    return np.asarray(np.clip((camera.height - y) / width, 0.0, 1.0)[:, None] * side[None, :])


def _halved(image: FloatArray) -> FloatArray:
    """Means of four pixels each."""
    above, below = image[0::2], image[1::2]
    return np.asarray(0.25 * ((above[:, 0::2] + above[:, 1::2]) + (below[:, 0::2] + below[:, 1::2])))


SHOWN_CUT_SHARE = 0.62
"""How much of the longest cut is done in the picture."""


def setup_pictures(model: CellModel, problem: Problem, plan: Plan | None) -> tuple[tuple[str, Picture], ...]:
    """Titles and pictures of the setups; without a plan the first one, with all arms at home.

    ``model``: the cell, for its robots and fixed bodies; its stock pose is where the block then stands.
    """
    seen = scene.extract(model)
    setups = problem.setups
    if plan is None or not plan.operations:
        shown = _standing(problem, setups[0], model.stock_pose)
        return (("", picture(seen, shown)),)
    out = []
    for setup, place in zip(setups, plan.places, strict=True):
        names = ", ".join(plan.operations[i].name for i in setup.operations)
        title = f"Setup {setup.number}: {names}" if len(setups) > 1 else ""
        there = seen.model.with_bases(scene.standing(setup))
        moment = _moment(problem, plan, setup, place)
        here = dataclasses.replace(seen, model=there.with_bases(moment.bases))
        out.append((title, picture(here, moment)))
    return tuple(out)


def _standing(problem: Problem, setup: Setup, place: FloatArray) -> Moment:
    home = {arm.name: np.asarray(arm.home) for arm in setup.cell.arms}
    return Moment(setup, place, home, part=[mesh for _, mesh in raster.part_meshes(problem.part)])


def _moment(problem: Problem, plan: Plan, setup: Setup, place: FloatArray) -> Moment:
    """The midst of the setup's longest cut, or all arms at home if nothing is cut."""
    still = _standing(problem, setup, place)
    cuts = [(len(rows), -i, rows) for i in setup.operations for rows in _cuts(plan.operations[i])]
    if not cuts:
        return still
    _, minus, rows = max(cuts, key=lambda cut: cut[:2])
    operation = plan.operations[-minus]
    here = int(rows[int(SHOWN_CUT_SHARE * (len(rows) - 1))])
    q = {**still.q, **{arm: operation.q[arm][here] for arm in operation.q}}
    done = _cut_so_far(problem, plan, -minus, here, setup)
    edge, frame = operation.targets.edge, operation.targets.frame[operation.targets.arms[0]]
    wires: list[FloatArray] = []
    if edge is not None and frame in ("stock", "world"):
        before = [int(i) for i in rows if i < here][:: max(1, here // 9)]
        wires = [transform(place if frame == "stock" else np.eye(4), edge.points[i]) for i in (*before, here)]
    wire = wires[-1] if wires else None
    bases = scene.riding(setup, {}, operation, here)
    return dataclasses.replace(still, q=q, wire=wire, earlier=wires[:-1], cut=done, bases=bases)


def _cuts(operation: OperationPlan) -> list[IndexArray]:
    """Rows of each run of one segment of work."""
    segments = operation.targets.segment
    cut = np.array([segment.works for segment in segments])
    starts = np.flatnonzero(
        cut & np.array([i == 0 or segments[i] != segments[i - 1] for i in range(len(segments))])
    )
    return [
        np.arange(a, next((i for i in range(a, len(segments)) if segments[i] != segments[a]), len(segments)))
        for a in starts
    ]


def _cut_so_far(problem: Problem, plan: Plan, last: int, here: int, shown: Setup) -> list[Mesh]:
    """What straight wires have cut up to target ``here`` of operation ``last``, within the block as shown."""
    out = []
    for index in range(last + 1):
        operation, setup = plan.operations[index], problem.setup_of(index)
        arm = scene.cutter(setup, operation.targets.arms)
        if arm is None or operation.targets.edge is not None:
            continue
        left = 0.0 if raster.same_size(setup.stock, shown.stock) else TRIMMED_DEPTH_M
        place = plan.places[setup.number - 1]
        for rows in _cuts(operation):
            rows = np.append(max(rows[0] - 1, 0), rows)
            rows = rows if index < last else rows[rows <= here]
            if len(rows) < 2:
                continue
            q = {name: joints[rows] for name, joints in operation.q.items()}
            points = scene.wire_in_block(
                setup, arm, place, scene.riding(setup, plan.bases, operation, rows), q
            )
            mesh = raster.swept_surface(points, shown.stock.lower + left, shown.stock.upper - left)
            out += [] if mesh is None else [mesh]
    return out
