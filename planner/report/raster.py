"""Rendering without a display: triangle meshes and a small depth-buffer renderer in NumPy.

Meshes are the shapes of a cell, nominal surfaces, and surfaces that a wire sweeps in the block: strips
between its successive positions.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, RuledSurface, lengths
from planner.problem import Part, Stock


@dataclasses.dataclass(frozen=True)
class RenderSolid:
    """Triangles to draw: ``vertices`` (V, 3) [m] with unit ``normals`` (V, 3), and ``faces`` (F, 3)."""

    vertices: FloatArray
    normals: FloatArray
    faces: IntArray

    def moved(self, pose: FloatArray) -> "RenderSolid":
        """Return the solid transformed by a pose (4, 4)."""
        return RenderSolid(
            self.vertices @ pose[:3, :3].T + pose[:3, 3], self.normals @ pose[:3, :3].T, self.faces
        )


def box(x: float, y: float, z: float) -> RenderSolid:
    """Return a box with edges x, y, z [m] about its centre."""
    corners: list[FloatArray] = []
    normals: list[FloatArray] = []
    faces: list[list[int]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            face = np.zeros((4, 3))
            face[:, axis] = sign
            face[:, u] = np.array([-1.0, 1.0, 1.0, -1.0]) * sign
            face[:, v] = [-1.0, -1.0, 1.0, 1.0]
            base = 4 * len(corners)
            corners.append(face)
            normals.append(np.tile(np.eye(3)[axis] * sign, (4, 1)))
            faces += [[base, base + 1, base + 2], [base, base + 2, base + 3]]
    half = 0.5 * np.array([x, y, z])
    return RenderSolid(
        np.concatenate(corners) * half, np.concatenate(normals), np.array(faces, dtype=np.int64)
    )


def cylinder(radius: float, length: float, sides: int = 32) -> RenderSolid:
    """Return a cylinder about z [m], centred, with flat ends."""
    # profile of a unit cylinder: radius, z, and normal; edges have two normals, so that they are sharp
    profile = [(0.0, -1.0, 0.0, -1.0), (1.0, -1.0, 0.0, -1.0), (1.0, -1.0, 1.0, 0.0)]
    profile += [(1.0, 1.0, 1.0, 0.0), (1.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)]
    scaled_profile = np.array(profile) * [radius, 0.5 * length, 1.0, 1.0]
    return _revolved(scaled_profile, sides)


def capsule(radius: float, length: float, sides: int = 24, rings: int = 6) -> RenderSolid:
    """Return a capsule about z [m], centred. ``length`` excludes the caps, of ``rings`` rings each."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * rings)
    shift = np.where(angle < 0.0, -0.5, 0.5) * length
    profile = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle) + shift, np.cos(angle), np.sin(angle)], axis=1
    )
    return _revolved(profile, sides)


def sphere(radius: float, sides: int = 24) -> RenderSolid:
    """Return a sphere about the origin [m]."""
    return capsule(radius, 0.0, sides)


def mesh(vertices: FloatArray, faces: IntArray, smooth: bool = False) -> RenderSolid:
    """Return the solid of a mesh (V, 3), (F, 3): faceted, or ``smooth`` with area-weighted vertex normals.

    A faceted solid has three vertices of its own for each face.
    """
    corners = vertices[faces]
    face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if smooth:
        normals = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(normals, faces[:, k], face_normals)
        return RenderSolid(vertices, _unit(normals), faces)
    own_faces = np.arange(3 * len(faces), dtype=np.int64).reshape(-1, 3)
    return RenderSolid(corners.reshape(-1, 3), np.repeat(_unit(face_normals), 3, axis=0), own_faces)


def tube(points: FloatArray, radius: float, sides: int = 10) -> RenderSolid:
    """Return an open tube about a polyline (P, 3) [m], with rotation-minimising frames."""
    tangent = _unit(np.gradient(points, axis=0))
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    first_axes = np.empty((len(points), 3))
    for i, t in enumerate(tangent):
        side = side - t * (side @ t)
        side /= np.linalg.norm(side)
        first_axes[i] = side
    second_axes = np.cross(tangent, first_axes)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    normals = np.cos(angle)[:, None] * first_axes[:, None] + np.sin(angle)[:, None] * second_axes[:, None]
    vertices = points[:, None] + radius * normals
    return RenderSolid(vertices.reshape(-1, 3), normals.reshape(-1, 3), _grid(len(points), sides))


def _revolved(profile: FloatArray, sides: int) -> RenderSolid:
    """Return a body of revolution about z from a profile (N, 4) from below.

    Its columns are radius and z [m] of a point, and the radial and z component of the normal there.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)

    def spin(radius: FloatArray, z: FloatArray) -> FloatArray:
        """Return vectors (N * sides, 3) of points (N,) of the profile, rotated about z, ring by ring."""
        ones = np.ones(sides)
        return np.stack([np.outer(radius, c), np.outer(radius, s), np.outer(z, ones)], axis=-1).reshape(-1, 3)

    return RenderSolid(
        spin(profile[:, 0], profile[:, 1]), spin(profile[:, 2], profile[:, 3]), _grid(len(profile), sides)
    )


def _grid(rings: int, sides: int) -> IntArray:
    """Return the triangles (2 (rings - 1) sides, 3) between successive closed rings of ``sides`` vertices."""
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = a + sides, b + sides
    return np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])


def _unit(v: FloatArray) -> FloatArray:
    """Return unit vectors (..., 3). A zero vector stays zero."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30))


STRAIGHT_WIRE_POINTS: Final = 3
"""Number of points of a drawn straight wire. Two adjacent rulings may be twisted."""


def clip_wires(ends: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Clip straight wires to a box.

    Slab method: the entry and exit parameters of the ray are the maximum and the minimum over the three
    pairs of planes (Kay and Kajiya 1986).

    Args:
        ends: Ends of the wires (T, 2, 3) [m].
        lower: Lower corner of the box (3,) [m].
        upper: Upper corner of the box (3,) [m].

    Returns:
        Evenly spaced points (T, STRAIGHT_WIRE_POINTS, 3) [m] of the part of each wire that is inside, NaN for
        a wire outside.
    """
    start, direction = ends[:, 0], ends[:, 1] - ends[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_lower, to_upper = (lower - start) / direction, (upper - start) / direction
    # A wire parallel to a pair of planes is between them everywhere or nowhere.
    is_parallel = np.abs(direction) < 1e-12
    is_between = (start >= lower) & (start <= upper)
    entry = np.where(is_parallel, np.where(is_between, -np.inf, np.inf), np.minimum(to_lower, to_upper)).max(
        axis=1
    )
    leave = np.where(is_parallel, np.where(is_between, np.inf, -np.inf), np.maximum(to_lower, to_upper)).min(
        axis=1
    )
    entry, leave = np.maximum(entry, 0.0), np.minimum(leave, 1.0)
    is_inside = leave > entry
    entry, leave = np.where(is_inside, entry, 0.0), np.where(is_inside, leave, 0.0)
    fraction = np.linspace(0.0, 1.0, STRAIGHT_WIRE_POINTS)
    parameters = entry[:, None] + (leave - entry)[:, None] * fraction
    points = start[:, None] + parameters[..., None] * direction[:, None]
    points[~is_inside] = np.nan
    return np.asarray(points)


def swept_surface(points: FloatArray, lower: FloatArray, upper: FloatArray) -> Mesh | None:
    """Return the surface that a wire sweeps on its way through successive positions, clipped to a box.

    Args:
        points: Points of the wire at its positions (T, P, 3) [m], in the stock frame. A straight wire has
            two points, its ends.
        lower: Lower corner of the box (3,) [m].
        upper: Upper corner of the box (3,) [m].

    Returns:
        Surface of those quads whose centre is in the box, or None if there are none.
    """
    if points.shape[1] == 2:
        points = clip_wires(points, lower, upper)
    count = points.shape[1]
    i, j = np.meshgrid(np.arange(len(points) - 1), np.arange(count - 1), indexing="ij")
    a = (i * count + j).ravel()  # one corner of each quad between successive positions and points
    quads = np.stack([a, a + 1, a + count + 1, a + count], axis=1)
    vertices = points.reshape(-1, 3)
    middle = vertices[quads].mean(axis=1)
    with np.errstate(invalid="ignore"):
        inside = ((middle >= lower - 1e-9) & (middle <= upper + 1e-9)).all(axis=1)
    quads = quads[inside]
    if not len(quads):
        return None
    used, new_index = np.unique(quads, return_inverse=True)
    quads = new_index.reshape(quads.shape)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(vertices[used], faces.astype(np.int64))


def have_same_size(first: Stock, second: Stock) -> bool:
    """Report whether two blocks have the same corners in their own frames."""
    return np.allclose(first.lower, second.lower) and np.allclose(first.upper, second.upper)


def part_meshes(part: Part | None) -> tuple[tuple[str, Mesh], ...]:
    """Return the nominal surfaces of a part with their names, in the stock frame. Empty without a part."""
    if part is None:
        return ()
    face_meshes = [
        (name, mesh) for name, mesh in (("front", part.front), ("back", part.back)) if mesh is not None
    ]
    return (*face_meshes, *((surface.name, ruled_mesh(surface)) for surface in part.ruled))


def ruled_mesh(surface: RuledSurface) -> Mesh:
    """Triangulate a ruled surface, with two triangles between adjacent rulings.

    Their normals point along tangent x ruling. The vertices of rulings at corners are duplicated, so that
    smooth shading leaves a sharp edge there. So are those of the first ruling of a closed surface, which is
    also its last one.
    """
    ruling_indices = np.arange(len(surface.start))
    if surface.closed:
        ruling_indices = np.append(ruling_indices, 0)
    corner = surface.corner[ruling_indices]
    # The strips on both sides of a ruling share it, but at a corner each of them has a copy of its own.
    copied_rulings = np.repeat(ruling_indices, np.where(corner, 2, 1))
    last_copy = np.cumsum(np.where(corner, 2, 1)) - 1
    # Each strip goes from the last copy of its ruling to the first copy of the next one.
    from_copy, to_copy = last_copy[:-1], last_copy[1:] - np.where(corner[1:], 1, 0)
    vertices = np.stack([surface.start[copied_rulings], surface.end[copied_rulings]], axis=1).reshape(-1, 3)
    # vertex 2 k is the start of the ruling with the copy k, and vertex 2 k + 1 its end
    a, b = 2 * from_copy, 2 * to_copy
    faces = np.concatenate([np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)])
    return Mesh(vertices, faces.astype(np.int64))


_TILES: Final = (8, 24, 72, 216)
"""Sides [px] of the tiles in which triangles are filled. Each axis uses the smallest one that suffices."""
_BATCH: Final = 200_000
"""Number of pixels that are filled at a time."""
_LIGHT: Final = np.array([0.35, -0.55, 0.76])
"""Direction towards the light, in the world."""


@dataclasses.dataclass(frozen=True)
class RenderItem:
    """A solid in world coordinates with its colour.

    Attributes:
        solid: Solid.
        color: Red, green, blue in 0..1.
        glow: From 0, shaded, to 1, with the unshaded colour.
        closed: Whether only the outside is visible, so that back faces are culled.
    """

    solid: RenderSolid
    color: tuple[float, float, float]
    glow: float = 0.0
    closed: bool = True


@dataclasses.dataclass(frozen=True)
class Camera:
    """A perspective camera whose picture may be cropped to a window.

    Attributes:
        pose: Pose in the world (4, 4). The camera looks along +z, with y down.
        focal: Focal length [px].
        width: Width of the window [px].
        height: Height of the window [px].
        full: Size of the picture [px]. The optical axis is at its centre.
        left: Left edge of the window in the picture [px].
        top: Top edge of the window in the picture [px].
    """

    pose: FloatArray
    focal: float
    width: int
    height: int
    full: tuple[int, int]
    left: int = 0
    top: int = 0

    def window(self, points: FloatArray, margin: int = 4) -> "Camera":
        """Return the camera cropped to a window around world points (P, 3) [m] with a ``margin`` [px]."""
        pixels = self.project(points)[..., :2] + [self.left, self.top]
        low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - margin, 0, np.array(self.full) - 1)
        high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + margin, low + 1, self.full)
        width, height = (int(v) for v in high - low)
        return dataclasses.replace(self, width=width, height=height, left=int(low[0]), top=int(low[1]))

    def project(self, points: FloatArray) -> FloatArray:
        """Project world points (..., 3) to x and y [px] in the window and depth [m] (..., 3)."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = np.maximum(local[..., 2], 1e-6)
        x = self.focal * local[..., 0] / depth + 0.5 * self.full[0] - self.left
        y = self.focal * local[..., 1] / depth + 0.5 * self.full[1] - self.top
        return np.stack([x, y, local[..., 2]], axis=-1)


def frame_camera(
    points: FloatArray, toward: FloatArray, width: int, height: int, fill: float = 0.94
) -> Camera:
    """Return a camera that just sees all points, with a field of view of 30 degrees.

    Args:
        points: Points (P, 3) [m].
        toward: View direction (3,), not vertical.
        width: Width [px].
        height: Height [px].
        fill: Fraction of the picture that the points fill.
    """
    z = toward / np.linalg.norm(toward)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    local = points @ rotation
    focal = 0.5 * width / np.tan(np.deg2rad(15.0))
    low, high = local.min(axis=0), local.max(axis=0)
    center = 0.5 * (low + high)
    # Perspective makes near points larger, so that centre and distance depend on each other: iterate.
    for _ in range(8):
        offsets = local[:, :2] - center[:2]
        min_distances = np.abs(offsets) * focal / (0.5 * fill * np.array([width, height])) - (
            local[:, 2:3] - center[2]
        )
        distance = float(min_distances.max())
        depth = local[:, 2] - center[2] + distance
        projected = offsets / depth[:, None]
        center[:2] += 0.5 * (projected.min(axis=0) + projected.max(axis=0)) * distance
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = rotation @ (center - [0.0, 0.0, distance])
    return Camera(pose, float(focal), width, height, (width, height))


@dataclasses.dataclass(frozen=True)
class RenderedImage:
    """A rendered image.

    Attributes:
        color: Colours (h, w, 3) in 0..1.
        depth: Depth (h, w) [m], inf where empty.
        thing: Index (h, w) of the item that is visible, -1 where empty.
    """

    color: FloatArray
    depth: FloatArray
    thing: IntArray


def render_items(camera: Camera, things: list[RenderItem]) -> RenderedImage:
    """Render items on white, with shading, ambient occlusion, and ink lines at outlines and creases.

    Glowing items are not darkened. The result has the colour, the depth [m] and the index of the item at each
    pixel, -1 without an item.
    """
    solids = [item.solid for item in things]
    owner = np.repeat(np.arange(len(solids)), [len(solid.faces) for solid in solids])
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids[:-1])])
    faces = np.concatenate([solid.faces + first for solid, first in zip(solids, starts, strict=True)])
    vertices = np.concatenate([solid.vertices for solid in solids])
    normals = np.concatenate([solid.normals for solid in solids]).astype(np.float32)
    is_closed = np.array([item.closed for item in things])[owner]
    face_index, weights, depth = _resolve(camera, camera.project(vertices)[faces], is_closed)
    covered = face_index >= 0
    item_index = np.where(covered, owner[face_index], -1)
    corner_indices = faces[face_index[covered]]
    corner_weights = weights[covered]
    blended = sum(corner_weights[:, k, None] * normals[corner_indices[:, k]] for k in range(3))
    normal = np.zeros((*face_index.shape, 3), dtype=np.float32)
    normal[covered] = blended
    base = np.array([item.color for item in things], dtype=np.float32)
    glow = np.array([item.glow for item in things], dtype=np.float32)
    color = np.ones((*face_index.shape, 3), dtype=np.float32)
    color[covered] = _shade(camera, base[item_index[covered]], glow[item_index[covered]], np.asarray(blended))
    darkening = _occlusion(depth, camera) * _ink(depth, normal, item_index)
    darkening = np.where(covered, np.maximum(darkening, glow[item_index]), 1.0)
    color *= darkening[..., None].astype(np.float32)
    return RenderedImage(color, depth, item_index)


def _shade(
    camera: Camera, base: NDArray[np.float32], glow: NDArray[np.float32], normal: FloatArray
) -> FloatArray:
    """Shade points of colours ``base`` (P, 3) by a key light, a fill light, the sky and a highlight.

    Normals (P, 3) may have any length. Those that point away from the camera are reversed.
    """
    view = -camera.pose[:3, 2]
    light = _LIGHT / np.linalg.norm(_LIGHT)
    side = view + np.cross(view, [0.0, 0.0, 1.0])
    half = light + view  # halfway vector, whose cosine gives the highlight (Blinn)
    directions = np.stack(
        [view, light, side / np.linalg.norm(side), half / np.linalg.norm(half), [0.0, 0.0, 1.0]]
    )
    length = np.maximum(lengths(normal), 1e-12)
    cosines = (normal @ directions.T.astype(np.float32)) / length[:, None]
    cosines *= np.where(cosines[:, :1] < 0.0, np.float32(-1.0), np.float32(1.0))
    key, fill, shine = (np.maximum(cosines[:, k], 0.0) for k in (1, 2, 3))
    sky = 0.5 + 0.5 * cosines[:, 4]
    for _ in range(5):
        shine *= shine  # to the power of 32
    lit = base * (0.34 + 0.46 * key + 0.14 * fill + 0.20 * sky)[:, None] + 0.10 * shine[:, None]
    return np.asarray(np.clip(lit + glow[:, None] * (base - lit), 0.0, 1.0))


def _occlusion(depth: FloatArray, camera: Camera) -> FloatArray:
    """Return a factor (h, w) that darkens corners (Luft et al. 2006).

    A pixel is darker the farther it is behind its blurred neighbourhood, unless a body well in front of it is
    the cause.
    """
    is_covered = np.isfinite(depth)
    if not is_covered.any():
        return np.ones_like(depth)
    filled = np.where(is_covered, depth, np.max(depth[is_covered]))
    blurred = ndimage.uniform_filter(ndimage.uniform_filter(filled, 31), 31)
    # depth differences are relative to the length of 40 px at the median depth
    scale = 40.0 / camera.focal * float(np.median(depth[is_covered]))
    depth_behind = np.clip((filled - blurred) / scale, 0.0, 1.0)
    gap = (filled - ndimage.minimum_filter(filled, 61)) / scale
    return np.asarray(1.0 - 0.45 * depth_behind * np.clip(1.5 - gap / 4.0, 0.0, 1.0))


def _ink(depth: FloatArray, normal: NDArray[np.float32], thing: IntArray) -> FloatArray:
    """Return a factor (h, w) that draws ink lines: below 1 at steps of depth, edges of items, and creases.

    The thresholds and strengths are chosen for the appearance.
    """
    ink = np.zeros(depth.shape)
    filled = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
    for axis in (0, 1):
        front = [slice(None)] * 2
        rear = [slice(None)] * 2
        front[axis], rear[axis] = slice(None, -1), slice(1, None)
        a, b = tuple(front), tuple(rear)
        step = np.abs(filled[a] - filled[b]) > 0.012 * np.minimum(filled[a], filled[b])
        edge = step | (thing[a] != thing[b])
        crease = sum(normal[a][..., k] * normal[b][..., k] for k in range(3)) < 0.6
        strength = np.where(edge, 0.62, np.where(crease, 0.30, 0.0))
        ink[a] = np.maximum(ink[a], strength)
        ink[b] = np.maximum(ink[b], strength)
    return 1.0 - ink


@dataclasses.dataclass(frozen=True)
class _PixelBuffers:
    """Nearest triangle of each pixel so far. The arrays are flat, row by row of the picture.

    Attributes:
        shape: Height h and width w [px].
        depth: Depth (h * w,) [m], inf where empty.
        face: Index of the face (h * w,), -1 where empty.
        weights: Weights (h * w, 3) of the three corners of the face, with the sum 1.
    """

    shape: tuple[int, int]
    depth: FloatArray
    face: IntArray
    weights: NDArray[np.float32]


def _resolve(
    camera: Camera, corners: FloatArray, closed: BoolArray
) -> tuple[IntArray, NDArray[np.float32], FloatArray]:
    """Find the nearest of F triangles at each pixel, from their projected corners (F, 3, 3).

    Returns the index of the face (h, w), -1 where empty, the weights of its corners (h, w, 3), and the depth
    (h, w) [m]. A triangle of a closed body (``closed`` (F,)) is visible only from its front.
    """
    h, w = camera.height, camera.width
    depth = np.full(h * w, np.inf)
    face = np.full(h * w, -1, dtype=np.int64)
    weights = np.zeros((h * w, 3), dtype=np.float32)
    buffers = _PixelBuffers((h, w), depth, face, weights)
    low = np.floor(corners[..., :2].min(axis=1)).astype(np.int64)
    high = np.ceil(corners[..., :2].max(axis=1)).astype(np.int64)
    visible = (high >= 0).all(axis=1) & (low < [w, h]).all(axis=1) & (corners[..., 2] > 1e-3).all(axis=1)
    ab, ac = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    # twice the signed area: y is down, so that it is negative for a triangle seen from its front
    visible &= np.where(closed, area < -1e-9, np.abs(area) > 1e-9)
    # Triangles with a bounding box of similar size are filled together, so that no pixel loop is needed.
    tile_index = np.searchsorted(_TILES, high - low + 1)
    for across, down in itertools.product(range(len(_TILES)), repeat=2):
        group = np.flatnonzero(visible & (tile_index[:, 0] == across) & (tile_index[:, 1] == down))
        step = max(1, _BATCH // (_TILES[across] * _TILES[down]))
        for start in range(0, len(group), step):
            batch = group[start : start + step]
            x = low[batch, 0, None, None] + np.arange(_TILES[across])[None, None, :]
            y = low[batch, 1, None, None] + np.arange(_TILES[down])[None, :, None]
            _fill_triangles(corners[batch], batch, x, y, buffers)
    # triangles larger than the largest tile, one by one
    for i in np.flatnonzero(visible & (tile_index == len(_TILES)).any(axis=1)):
        x = np.arange(max(low[i, 0], 0), min(high[i, 0] + 1, w))[None, None, :]
        y = np.arange(max(low[i, 1], 0), min(high[i, 1] + 1, h))[None, :, None]
        _fill_triangles(corners[i : i + 1], np.array([i]), x, y, buffers)
    return face.reshape(h, w), weights.reshape(h, w, 3), depth.reshape(h, w)


def _fill_triangles(
    corners: FloatArray, face_index: IntArray, x: IntArray, y: IntArray, buffers: _PixelBuffers
) -> None:
    """Draw triangles into the buffers, at the pixels where they are nearer than the triangle drawn before.

    ``corners`` (T, 3, 3) are their projected corners: x, y [px] and depth [m]. ``face_index`` (T,) are their
    indices among all triangles. The pixels to test are at columns ``x`` (T, 1, n) and rows ``y`` (T, m, 1).
    With one triangle the first axes may have the length 1.
    """
    (h, w), depth = buffers.shape, buffers.depth
    px, py = x + 0.5, y + 0.5
    ax, ay = corners[:, 0, 0, None, None], corners[:, 0, 1, None, None]
    bx, by = corners[:, 1, 0, None, None] - ax, corners[:, 1, 1, None, None] - ay
    cx, cy = corners[:, 2, 0, None, None] - ax, corners[:, 2, 1, None, None] - ay
    area = bx * cy - by * cx
    dx, dy = px - ax, py - ay
    # barycentric coordinates of the pixel centres: v belongs to the second corner, u to the third one
    v = (dx * cy - dy * cx) / area
    u = (bx * dy - by * dx) / area
    is_inside = (v >= -1e-9) & (u >= -1e-9) & (u + v <= 1.0 + 1e-9) & (x >= 0) & (x < w) & (y >= 0) & (y < h)
    t, iy, ix = np.nonzero(is_inside)
    pixel = (y[t, iy, 0] if len(y) > 1 else y[0, iy, 0]) * w + (x[t, 0, ix] if len(x) > 1 else x[0, 0, ix])
    v, u = v[is_inside], u[is_inside]
    # 1 / depth is linear in the picture: the weights that are correct in space are those of 1 / depth
    inverse_depth = 1.0 / corners[:, :, 2]
    wa, wb, wc = (1.0 - u - v) * inverse_depth[t, 0], v * inverse_depth[t, 1], u * inverse_depth[t, 2]
    z = 1.0 / (wa + wb + wc)
    is_nearer = z < depth[pixel]
    pixel, z, t = pixel[is_nearer], z[is_nearer], t[is_nearer]
    # several triangles of the batch may cover one pixel; only the nearest one is kept
    np.minimum.at(depth, pixel, z)
    is_nearest = depth[pixel] == z
    pixel, z, t = pixel[is_nearest], z[is_nearest], t[is_nearest]
    buffers.face[pixel] = face_index[t]
    buffers.weights[pixel] = (
        np.stack([wa[is_nearer][is_nearest], wb[is_nearer][is_nearest], wc[is_nearer][is_nearest]], axis=1)
        * z[:, None]
    )
