"""Pictures of a cell: arms, tools, block and wire at one instant, rendered without a display.

Each setup is shown at one instant, during its longest cut.
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
from planner.report.raster import Camera, RenderItem, RenderSolid
from planner.report.replay import TRIMMED_DEPTH_M
from planner.report.scene import VisibleScene, scene_poses, setup_pieces

HOT_WIRE_COLOUR: Final = (1.0, 0.30, 0.06)
"""Red, green, blue in 0..1 of a hot wire."""
PART_COLOUR: Final = (0.16, 0.56, 0.62)
"""Red, green, blue in 0..1 of the nominal part."""
BLOCK_COLOUR: Final = (0.86, 0.90, 0.84)
"""Red, green, blue in 0..1 of the block, which is blended over the picture."""
_EARLIER_WIRE_COLOUR: Final = (1.0, 0.62, 0.35)
"""Red, green, blue in 0..1 of earlier positions of the wire."""


CUT_COLOUR: Final = (1.0, 0.66, 0.36)
"""Red, green, blue in 0..1 of surfaces that straight wires have cut."""


@dataclasses.dataclass(frozen=True)
class PictureState:
    """State of the cell that a picture shows.

    Attributes:
        setup: Setup.
        stock_pose: Pose of the stock in the world (4, 4).
        q: Joint values {arm: (6,)} [rad].
        wire: Wire between the arms in the world (P, 3) [m], or None.
        earlier: Earlier positions of that wire in the world, each (P, 3) [m].
        part: Nominal surfaces, in the stock frame.
        cut: Surfaces that have been cut, in the stock frame.
        bases: Bases in the world {arm: (4, 4)} of arms on coordinated tracks.
    """

    setup: Setup
    stock_pose: FloatArray
    q: Mapping[str, FloatArray]
    wire: FloatArray | None = None
    earlier: Sequence[FloatArray] = ()
    part: Sequence[Mesh] = ()
    cut: Sequence[Mesh] = ()
    bases: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Picture:
    """A rendered picture.

    Attributes:
        pixels: Colours (h, w, 3) in 0..1, premultiplied with the opacity.
        alpha: Opacity (h, w) in 0..1.
        labels: Names of the arms with x and y of their feet in 0..1, from the upper left corner.
    """

    pixels: FloatArray
    alpha: FloatArray
    labels: tuple[tuple[str, float, float], ...]


def picture(scene: VisibleScene, moment: PictureState, width: int = 900, height: int = 500) -> Picture:
    """Render the cell on a transparent background with a shadow on the ground.

    The view is across the line of the arms' bases, so that no arm hides another one. The scene is rendered at
    twice the size and averaged, against jagged edges. The empty rows above and below the cell are removed, so
    the picture may be lower than ``height``.

    Args:
        scene: Visible shapes of robots and fixed bodies.
        moment: State of the cell.
        width: Width [px].
        height: Height [px].
    """
    poses = scene_poses(scene, moment.setup, moment.stock_pose, {arm: q[None] for arm, q in moment.q.items()})
    pieces = (*scene.pieces, *setup_pieces(moment.setup, moment.stock_pose))
    solid = {id(piece): piece.solid.moved(poses[piece.body][0] @ piece.pose) for piece in pieces}
    opaque, block = [], []
    for piece in pieces:
        is_hot = piece.body.endswith("/edge")
        if piece.body == "stock":
            block.append(RenderItem(solid[id(piece)], BLOCK_COLOUR))
        else:
            colour = HOT_WIRE_COLOUR if is_hot else piece.color[:3]
            opaque.append(RenderItem(solid[id(piece)], colour, 1.0 if is_hot else 0.0, piece.closed))
    for meshes, colour in ((moment.part, PART_COLOUR), (moment.cut, CUT_COLOUR)):
        for mesh in meshes:
            solid_to_draw = raster.mesh(mesh.vertices, mesh.faces, smooth=True).moved(poses["stock"][0])
            opaque.append(RenderItem(solid_to_draw, colour, 0.0, closed=False))
    opaque += [
        RenderItem(raster.tube(wire, 0.0011, 6), _EARLIER_WIRE_COLOUR, 0.85) for wire in moment.earlier
    ]
    if moment.wire is not None:
        opaque.append(RenderItem(raster.tube(moment.wire, 0.0032), HOT_WIRE_COLOUR, 1.0))
    # Obstacles, which may be far away, do not determine what the camera frames.
    fixed = {obstacle.name for obstacle in scene.model.cell.obstacles}
    framed_vertices = [solid[id(piece)].vertices for piece in pieces if piece.body not in fixed]
    camera = raster.frame_camera(
        np.concatenate(framed_vertices), _view_direction(scene, moment.stock_pose), 2 * width, 2 * height
    )
    image = raster.render_items(camera, opaque)
    color, alpha = image.color, np.isfinite(image.depth).astype(np.float64)
    color, alpha = _blend_block(camera, block, image.depth, color, alpha)
    color, alpha = _add_ground_shadow(camera, [*opaque, *block], color, alpha)
    alpha = alpha * _border_weight(camera)
    labels = []
    for arm in scene.model.arms:
        base = f"{arm}/base_link"
        foot_vertices = [
            p.solid.moved(poses[base][0] @ p.pose).vertices for p in scene.pieces if p.body == base
        ]
        foot_position = foot_vertices[0] if foot_vertices else scene.model.bases[arm][None, :3, 3]
        x, y, _ = camera.project(np.concatenate([foot_position, *foot_vertices])).T
        labels.append((arm, float(x.mean() / camera.width), float(y.max() / camera.height + 0.012)))
    return _crop(
        Picture(_downsample(color * alpha[..., None]), _downsample(alpha[..., None])[..., 0], tuple(labels))
    )


def _crop(picture: Picture, margin: int = 14) -> Picture:
    """Remove the transparent rows above and below the cell, except a margin [px], and shift the labels."""
    rows = np.flatnonzero((picture.alpha > 0.02).any(axis=1))
    h = len(picture.alpha)
    a, b = max(int(rows[0]) - margin, 0), min(int(rows[-1]) + margin + 18, h)
    labels = tuple((name, x, (y * h - a) / (b - a)) for name, x, y in picture.labels)
    return Picture(picture.pixels[a:b], picture.alpha[a:b], labels)


def _view_direction(scene: VisibleScene, stock_pose: FloatArray) -> FloatArray:
    """Return a view direction (3,) from above, across the line from the first base to the last.

    For a single arm it is across the line from the base to the block, which has the pose ``stock_pose``.
    """
    positions = [*(scene.model.bases[arm][:3, 3] for arm in scene.model.arms), stock_pose[:3, 3]]
    line = positions[max(1, len(positions) - 2)] - positions[0]
    if np.linalg.norm(line[:2]) < 1e-6:
        line = scene.model.bases[scene.model.arms[0]][:3, 0]
    line = line[:2] / max(float(np.linalg.norm(line[:2])), 1e-9)
    across = np.array([-line[1], line[0]])
    horizontal = across + 0.30 * line
    return np.array([horizontal[0], horizontal[1], -0.42])


def _blend_block(
    camera: Camera, block: list[RenderItem], depth: FloatArray, color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Blend the block over the picture as a translucent body, with its ink lines more opaque.

    The picture's colours (h, w, 3) and opacity (h, w) are changed in place where its depth (h, w) [m] is
    greater than that of the block.
    """
    if not block:
        return color, alpha
    window = camera.window(np.concatenate([thing.solid.vertices for thing in block]))
    image = raster.render_items(window, block)
    region = np.s_[window.top : window.top + window.height, window.left : window.left + window.width]
    opacity = np.where(image.color.sum(axis=-1) < 1.25, 0.75, 0.42) * (image.depth < depth[region])
    color[region], alpha[region] = _composite(image.color, opacity, color[region], alpha[region])
    return color, alpha


def _composite(
    top: FloatArray, strength: FloatArray, color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Composite a picture over another one (Porter and Duff 1984), colours not premultiplied.

    The upper picture has colours ``top`` (h, w, 3) and opacity ``strength`` (h, w), the lower one ``color``
    and ``alpha``. Returns colours and opacity.
    """
    out = strength + alpha * (1.0 - strength)
    mixed = top * strength[..., None] + color * (alpha * (1.0 - strength))[..., None]
    return mixed / np.maximum(out, 1e-9)[..., None], out


def _add_ground_shadow(
    camera: Camera, casters: list[RenderItem], color: FloatArray, alpha: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add a soft shadow of bodies on the ground to a picture, darker below lower bodies.

    Returns the picture's colours (h, w, 3) and its opacity (h, w). All factors are chosen for the appearance.
    """
    points = np.concatenate([_ground_points(thing.solid) for thing in casters])
    low, high = points.min(axis=0) - 0.35, points.max(axis=0) + 0.35
    cell_size = float((high - low)[:2].max()) / 260.0
    shape = np.ceil((high[:2] - low[:2]) / cell_size).astype(int) + 1
    # cover of the ground by bodies, between 0 and 1: it decreases with their height above the floor
    weight = np.exp(-np.maximum(points[:, 2], 0.0) / 0.30)
    index = ((points[:, :2] - low[:2]) / cell_size).astype(int)
    cover = np.zeros(shape)
    np.maximum.at(cover, (index[:, 0], index[:, 1]), weight)
    cover = ndimage.grey_closing(cover, size=(5, 5))
    blurred = 0.8 * ndimage.gaussian_filter(cover, 2.0) + 0.5 * ndimage.gaussian_filter(cover, 9.0)
    # intersection of the ray of each coarse pixel with the ground
    step = 4
    x, y = np.meshgrid(np.arange(0, camera.width, step) + 2.0, np.arange(0, camera.height, step) + 2.0)
    local = np.stack([x - 0.5 * camera.full[0], y - 0.5 * camera.full[1], np.full_like(x, camera.focal)], -1)
    ray = local @ camera.pose[:3, :3].T
    # all rays that do not go down get a very long ray, far outside the shadow
    ray_length = (min(0.0, float(points[:, 2].min())) - camera.pose[2, 3]) / np.minimum(ray[..., 2], -1e-9)
    ground_point = camera.pose[:2, 3] + ray_length[..., None] * ray[..., :2]
    grid_position = np.moveaxis((ground_point - low[:2]) / cell_size, -1, 0)
    coarse = np.clip(ndimage.map_coordinates(blurred, grid_position, order=1, cval=0.0), 0.0, 1.0) * 0.45
    shade = ndimage.zoom(coarse, step, order=1)[: camera.height, : camera.width]
    tint = np.broadcast_to([0.17, 0.19, 0.24], color.shape)
    return _composite(color, alpha, np.asarray(tint), shade)


def _ground_points(solid: RenderSolid) -> FloatArray:
    """Return the vertices (P, 3) [m] of a solid with random points on its larger faces.

    The vertices of a large face are too far apart to cover the ground below it.
    """
    corners = solid.vertices[solid.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    point_counts = np.minimum((area / 2e-4).astype(int), 2000)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3), int(point_counts.sum()))
    face_points = np.einsum("pk,pkc->pc", weights, np.repeat(corners, point_counts, axis=0))
    return np.concatenate([solid.vertices, face_points])


def _border_weight(camera: Camera) -> FloatArray:
    """Return a weight (h, w) that falls to 0 at the left, right and lower border.

    It fades out obstacles, which alone reach these borders.
    """
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    width = 0.028 * camera.width
    side = np.clip(np.minimum(x, camera.width - x) / width, 0.0, 1.0)
    return np.asarray(np.clip((camera.height - y) / width, 0.0, 1.0)[:, None] * side[None, :])


def _downsample(image: FloatArray) -> FloatArray:
    """Average blocks of two by two pixels."""
    above, below = image[0::2], image[1::2]
    return np.asarray(0.25 * ((above[:, 0::2] + above[:, 1::2]) + (below[:, 0::2] + below[:, 1::2])))


SHOWN_CUT_FRACTION = 0.62
"""Fraction of the longest cut that is done in the picture."""


def setup_pictures(model: CellModel, problem: Problem, plan: Plan | None) -> tuple[tuple[str, Picture], ...]:
    """Render each setup during its longest cut.

    Without a plan only the first setup is rendered, with all arms at home.

    Args:
        model: Cell model, for its robots and fixed bodies. Without a plan its stock pose is that of the
            block.
        problem: Problem.
        plan: Plan, or None.

    Returns:
        Titles and pictures, in the order of the setups. The title of a single picture is empty.
    """
    visible = scene.extract_scene(model)
    setups = problem.setups
    if plan is None or not plan.operations:
        home_state = _home_state(problem, setups[0], model.stock_pose)
        return (("", picture(visible, home_state)),)
    out = []
    for setup, stock_pose in zip(setups, plan.stock_poses, strict=True):
        names = ", ".join(plan.operations[i].name for i in setup.operations)
        title = f"Setup {setup.number}: {names}" if len(setups) > 1 else ""
        setup_model = visible.model.with_bases(scene.axis_bases(setup))
        moment = _cutting_state(problem, plan, setup, stock_pose)
        scene_at_state = dataclasses.replace(visible, model=setup_model.with_bases(moment.bases))
        out.append((title, picture(scene_at_state, moment)))
    return tuple(out)


def _home_state(problem: Problem, setup: Setup, stock_pose: FloatArray) -> PictureState:
    """Return the state with all arms of a setup at home, with the nominal part."""
    home = {arm.name: np.asarray(arm.home) for arm in setup.cell.arms}
    return PictureState(setup, stock_pose, home, part=[mesh for _, mesh in raster.part_meshes(problem.part)])


def _cutting_state(problem: Problem, plan: Plan, setup: Setup, stock_pose: FloatArray) -> PictureState:
    """Return the state of the cell that the picture of a setup shows.

    It is at ``SHOWN_CUT_FRACTION`` of the longest cut, with the wire there and some of the wires before it.
    If nothing is cut, all arms are at home.
    """
    home_state = _home_state(problem, setup, stock_pose)
    cuts = [(len(run), -i, run) for i in setup.operations for run in _cut_runs(plan.operations[i])]
    if not cuts:
        return home_state
    # the longest run; of equally long ones that of the first operation, because its index is negated
    _, minus_index, run = max(cuts, key=lambda cut: cut[:2])
    operation = plan.operations[-minus_index]
    target_index = int(run[int(SHOWN_CUT_FRACTION * (len(run) - 1))])
    q = {**home_state.q, **{arm: operation.q[arm][target_index] for arm in operation.q}}
    cut_surfaces = _cut_surfaces(problem, plan, -minus_index, target_index, setup)
    edge = operation.targets.flexible_tool
    frame = operation.targets.frame[operation.targets.arms[0]]
    wires: list[FloatArray] = []
    if edge is not None and frame in ("stock", "world"):
        earlier_indices = [int(i) for i in run if i < target_index][:: max(1, target_index // 9)]
        wires = [
            transform(stock_pose if frame == "stock" else np.eye(4), edge.points[i])
            for i in (*earlier_indices, target_index)
        ]
    wire = wires[-1] if wires else None
    bases = scene.bases_at_targets(setup, {}, operation, target_index)
    return dataclasses.replace(home_state, q=q, wire=wire, earlier=wires[:-1], cut=cut_surfaces, bases=bases)


def _cut_runs(operation: OperationPlan) -> list[IndexArray]:
    """Return the runs of an operation's targets that belong to one working segment, as indices (K,) each."""
    segments = operation.targets.segment
    works = np.array([segment.works for segment in segments])
    starts = np.flatnonzero(
        works & np.array([i == 0 or segments[i] != segments[i - 1] for i in range(len(segments))])
    )
    return [
        np.arange(a, next((i for i in range(a, len(segments)) if segments[i] != segments[a]), len(segments)))
        for a in starts
    ]


def _cut_surfaces(problem: Problem, plan: Plan, last: int, target_index: int, shown: Setup) -> list[Mesh]:
    """Return the surfaces that straight wires cut in the block that is ``shown``.

    They end at a target of the operation ``last``. Surfaces on the sides of a trimmed block are left out.
    """
    out = []
    for index in range(last + 1):
        operation, setup = plan.operations[index], problem.setup_of(index)
        arm = scene.linear_cutter(setup, operation.targets.arms)
        if arm is None or operation.targets.flexible_tool is not None:
            continue
        margin = 0.0 if raster.have_same_size(setup.stock, shown.stock) else TRIMMED_DEPTH_M
        stock_pose = plan.stock_poses[setup.number - 1]
        for indices in _cut_runs(operation):
            indices = np.append(max(indices[0] - 1, 0), indices)
            indices = indices if index < last else indices[indices <= target_index]
            if len(indices) < 2:
                continue
            q = {name: joints[indices] for name, joints in operation.q.items()}
            points = scene.wire_in_block(
                setup, arm, stock_pose, scene.bases_at_targets(setup, plan.bases, operation, indices), q
            )
            mesh = raster.swept_surface(points, shown.stock.lower + margin, shown.stock.upper - margin)
            out += [] if mesh is None else [mesh]
    return out
