"""Pictures without a display: triangle meshes and a small depth-buffer renderer in NumPy.

Meshes are the shapes of a cell, wanted surfaces, and what a wire leaves behind it in the block: strips
between its places one after the other.
"""

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, Ruled, lengths
from planner.problem import Part, Stock


@dataclasses.dataclass(frozen=True)
class Solid:
    """Triangles to draw: ``vertices`` (V, 3) [m], unit ``normals`` (V, 3), ``faces`` (F, 3)."""

    vertices: FloatArray
    normals: FloatArray
    faces: IntArray

    def moved(self, pose: FloatArray) -> "Solid":
        """The solid moved by a pose (4, 4)."""
        return Solid(self.vertices @ pose[:3, :3].T + pose[:3, 3], self.normals @ pose[:3, :3].T, self.faces)


def box(x: float, y: float, z: float) -> Solid:
    """A box of edges x, y, z [m] about its centre."""
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
    return Solid(np.concatenate(corners) * half, np.concatenate(normals), np.array(faces, dtype=np.int64))


def cylinder(radius: float, length: float, sides: int = 32) -> Solid:
    """A cylinder about z, centred, with flat ends."""
    profile = [(0.0, -1.0, 0.0, -1.0), (1.0, -1.0, 0.0, -1.0), (1.0, -1.0, 1.0, 0.0)]
    profile += [(1.0, 1.0, 1.0, 0.0), (1.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)]
    rows = np.array(profile) * [radius, 0.5 * length, 1.0, 1.0]
    return _turned(rows, sides)


def capsule(radius: float, length: float, sides: int = 24, rings: int = 6) -> Solid:
    """A capsule about z, centred; ``length`` without the caps."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * rings)
    shift = np.where(angle < 0.0, -0.5, 0.5) * length
    rows = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle) + shift, np.cos(angle), np.sin(angle)], axis=1
    )
    return _turned(rows, sides)


def sphere(radius: float, sides: int = 24) -> Solid:
    """A sphere about the origin."""
    return capsule(radius, 0.0, sides)


def mesh(vertices: FloatArray, faces: IntArray, smooth: bool = False) -> Solid:
    """A mesh; faceted, or ``smooth`` with area-weighted vertex normals."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if smooth:
        normals = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(normals, faces[:, k], normal)
        return Solid(vertices, _unit(normals), faces)
    flat = np.arange(3 * len(faces), dtype=np.int64).reshape(-1, 3)
    return Solid(corners.reshape(-1, 3), np.repeat(_unit(normal), 3, axis=0), flat)


def tube(points: FloatArray, radius: float, sides: int = 10) -> Solid:
    """A tube about a polyline (P, 3), with frames carried along it without turning."""
    tangent = _unit(np.gradient(points, axis=0))
    side = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    rings = np.empty((len(points), 3))
    for i, t in enumerate(tangent):
        side = side - t * (side @ t)
        side /= np.linalg.norm(side)
        rings[i] = side
    other = np.cross(tangent, rings)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    normals = np.cos(angle)[:, None] * rings[:, None] + np.sin(angle)[:, None] * other[:, None]
    vertices = points[:, None] + radius * normals
    return Solid(vertices.reshape(-1, 3), normals.reshape(-1, 3), _grid(len(points), sides))


def _turned(rows: FloatArray, sides: int) -> Solid:
    """A body of revolution about z of rows (radius, z, normal's radius, normal's z), from below upward."""
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)

    def spin(radius: FloatArray, z: FloatArray) -> FloatArray:
        ones = np.ones(sides)
        return np.stack([np.outer(radius, c), np.outer(radius, s), np.outer(z, ones)], axis=-1).reshape(-1, 3)

    return Solid(spin(rows[:, 0], rows[:, 1]), spin(rows[:, 2], rows[:, 3]), _grid(len(rows), sides))


def _grid(rows: int, sides: int) -> IntArray:
    """Faces (2 (rows - 1) sides, 3) of rings of vertices, each ring closed."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = a + sides, b + sides
    return np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30))


STRAIGHT_WIRE_POINTS: Final = 3
"""Points that a straight wire is drawn by; two neighbouring rulings may be warped."""


def clipped_wires(ends: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """The part of straight wires with ends (T, 2, 3) that lies in the box, as (T, STRAIGHT, 3) points; NaN
    where none does.

    Slabs: the ray's parameters of entry and exit are the greatest and the least of those of the three pairs
    of planes (Kay and Kajiya 1986).
    """
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (lower - start) / way, (upper - start) / way
    along = np.abs(way) < 1e-12
    inside = (start >= lower) & (start <= upper)
    first = np.where(along, np.where(inside, -np.inf, np.inf), np.minimum(one, other)).max(axis=1)
    last = np.where(along, np.where(inside, np.inf, -np.inf), np.maximum(one, other)).min(axis=1)
    first, last = np.maximum(first, 0.0), np.minimum(last, 1.0)
    hit = last > first
    first, last = np.where(hit, first, 0.0), np.where(hit, last, 0.0)
    share = np.linspace(0.0, 1.0, STRAIGHT_WIRE_POINTS)
    at = first[:, None] + (last - first)[:, None] * share
    points = start[:, None] + at[..., None] * way[:, None]
    points[~hit] = np.nan
    return np.asarray(points)


def swept_surface(points: FloatArray, lower: FloatArray, upper: FloatArray) -> Mesh | None:
    """What wires (T, P, 3) in the stock frame sweep, one after the other, as far as it lies in the box; None
    if it does not. Straight wires are given by their two ends."""
    if points.shape[1] == 2:
        points = clipped_wires(points, lower, upper)
    count = points.shape[1]
    i, j = np.meshgrid(np.arange(len(points) - 1), np.arange(count - 1), indexing="ij")
    a = (i * count + j).ravel()
    quads = np.stack([a, a + 1, a + count + 1, a + count], axis=1)
    vertices = points.reshape(-1, 3)
    middle = vertices[quads].mean(axis=1)
    with np.errstate(invalid="ignore"):
        inside = ((middle >= lower - 1e-9) & (middle <= upper + 1e-9)).all(axis=1)
    quads = quads[inside]
    if not len(quads):
        return None
    used, place = np.unique(quads, return_inverse=True)
    quads = place.reshape(quads.shape)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Mesh(vertices[used], faces.astype(np.int64))


def same_size(one: Stock, other: Stock) -> bool:
    """Whether two blocks are of one size."""
    return np.allclose(one.lower, other.lower) and np.allclose(one.upper, other.upper)


def part_meshes(part: Part | None) -> tuple[tuple[str, Mesh], ...]:
    """The wanted surfaces by name, in the stock frame."""
    if part is None:
        return ()
    open_ = [(name, mesh) for name, mesh in (("front", part.front), ("back", part.back)) if mesh is not None]
    return (*open_, *((surface.name, ruled_mesh(surface)) for surface in part.ruled))


def ruled_mesh(surface: Ruled) -> Mesh:
    """Triangles between the rulings, with normals along tangent x ruling; a corner parts the vertices."""
    rows = np.arange(len(surface.start))
    if surface.closed:
        rows = np.append(rows, 0)
    corner = surface.corner[rows]
    # every ruling inside a stretch serves both its neighbours; one at a corner stands twice
    twice = np.repeat(rows, np.where(corner, 2, 1))
    left = np.cumsum(np.where(corner, 2, 1)) - 1
    a, b = left[:-1], left[1:] - np.where(corner[1:], 1, 0)
    vertices = np.stack([surface.start[twice], surface.end[twice]], axis=1).reshape(-1, 3)
    faces = np.concatenate(
        [np.stack([2 * a, 2 * b, 2 * b + 1], axis=1), np.stack([2 * a, 2 * b + 1, 2 * a + 1], axis=1)]
    )
    return Mesh(vertices, faces.astype(np.int64))


_TILES: Final = (8, 24, 72, 216)
"""Sides [px] of the tiles that triangles are filled in, each in the smallest that holds it."""
_BATCH: Final = 200_000
"""Pixels that are filled at once."""
_LIGHT: Final = np.array([0.35, -0.55, 0.76])
"""Direction towards the light, in the world."""


@dataclasses.dataclass(frozen=True)
class Thing:
    """A solid in world coordinates with its colour (r, g, b in 0..1); ``glow`` 1 shows the colour unshaded.

    ``closed`` says that only the outside can be seen, so that faces turned away are not drawn.
    """

    solid: Solid
    color: tuple[float, float, float]
    glow: float = 0.0
    closed: bool = True


@dataclasses.dataclass(frozen=True)
class Camera:
    """A perspective camera: ``pose`` (4, 4) in the world looks along its +z with y down; ``focal`` in pixels.

    ``left``, ``top`` are where its window starts in the picture whose axis is at half of ``full``.
    """

    pose: FloatArray
    focal: float
    width: int
    height: int
    full: tuple[int, int]
    left: int = 0
    top: int = 0

    def window(self, points: FloatArray, margin: int = 4) -> "Camera":
        """The same camera, cut to what shows the points (P, 3)."""
        seen = self.project(points)[..., :2] + [self.left, self.top]
        low = np.clip(np.floor(seen.min(axis=0)).astype(int) - margin, 0, np.array(self.full) - 1)
        high = np.clip(np.ceil(seen.max(axis=0)).astype(int) + margin, low + 1, self.full)
        width, height = (int(v) for v in high - low)
        return dataclasses.replace(self, width=width, height=height, left=int(low[0]), top=int(low[1]))

    def project(self, points: FloatArray) -> FloatArray:
        """Pixel x, y and depth [m] (..., 3) of world points (..., 3)."""
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        depth = np.maximum(local[..., 2], 1e-6)
        x = self.focal * local[..., 0] / depth + 0.5 * self.full[0] - self.left
        y = self.focal * local[..., 1] / depth + 0.5 * self.full[1] - self.top
        return np.stack([x, y, local[..., 2]], axis=-1)


def frame(points: FloatArray, toward: FloatArray, width: int, height: int, fill: float = 0.94) -> Camera:
    """The camera that looks along ``toward`` (3,) and just sees all ``points`` (P, 3); 30 degrees wide."""
    z = toward / np.linalg.norm(toward)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    local = points @ rotation
    focal = 0.5 * width / np.tan(np.deg2rad(15.0))
    low, high = local.min(axis=0), local.max(axis=0)
    center = 0.5 * (low + high)
    for _ in range(8):
        span = local[:, :2] - center[:2]
        need = np.abs(span) * focal / (0.5 * fill * np.array([width, height])) - (local[:, 2:3] - center[2])
        distance = float(need.max())
        depth = local[:, 2] - center[2] + distance
        seen = span / depth[:, None]
        center[:2] += 0.5 * (seen.min(axis=0) + seen.max(axis=0)) * distance
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = rotation @ (center - [0.0, 0.0, distance])
    return Camera(pose, float(focal), width, height, (width, height))


@dataclasses.dataclass(frozen=True)
class Image:
    """``color`` (h, w, 3) in 0..1, ``depth`` (h, w) [m] (inf: empty), ``thing`` (h, w) index (-1: empty)."""

    color: FloatArray
    depth: FloatArray
    thing: IntArray


def rendered(camera: Camera, things: list[Thing]) -> Image:
    """The things as seen by the camera, shaded, with soft corners and ink lines at outlines and creases."""
    solids = [t.solid for t in things]
    owner = np.repeat(np.arange(len(solids)), [len(s.faces) for s in solids])
    starts = np.cumsum([0, *(len(s.vertices) for s in solids[:-1])])
    faces = np.concatenate([s.faces + a for s, a in zip(solids, starts, strict=True)])
    vertices = np.concatenate([s.vertices for s in solids])
    normals = np.concatenate([s.normals for s in solids]).astype(np.float32)
    closed = np.array([t.closed for t in things])[owner]
    face, weights, depth = _resolve(camera, camera.project(vertices)[faces], closed)
    seen = face >= 0
    thing = np.where(seen, owner[face], -1)
    rows = faces[face[seen]]
    blend = weights[seen]
    shown = sum(blend[:, k, None] * normals[rows[:, k]] for k in range(3))
    normal = np.zeros((*face.shape, 3), dtype=np.float32)
    normal[seen] = shown
    base = np.array([t.color for t in things], dtype=np.float32)
    glow = np.array([t.glow for t in things], dtype=np.float32)
    color = np.ones((*face.shape, 3), dtype=np.float32)
    color[seen] = _shade(camera, base[thing[seen]], glow[thing[seen]], np.asarray(shown))
    dark = _occlusion(depth, camera) * _ink(depth, normal, thing)
    dark = np.where(seen, np.maximum(dark, glow[thing]), 1.0)
    color *= dark[..., None].astype(np.float32)
    return Image(color, depth, thing)


def _shade(
    camera: Camera, base: NDArray[np.float32], glow: NDArray[np.float32], normal: FloatArray
) -> FloatArray:
    """Warm key light from above, cool fill from below, a soft highlight."""
    view = -camera.pose[:3, 2]
    light = _LIGHT / np.linalg.norm(_LIGHT)
    side = view + np.cross(view, [0.0, 0.0, 1.0])
    half = light + view
    ways = np.stack([view, light, side / np.linalg.norm(side), half / np.linalg.norm(half), [0.0, 0.0, 1.0]])
    length = np.maximum(lengths(normal), 1e-12)
    seen = (normal @ ways.T.astype(np.float32)) / length[:, None]
    seen *= np.where(seen[:, :1] < 0.0, np.float32(-1.0), np.float32(1.0))
    key, fill, shine = (np.maximum(seen[:, k], 0.0) for k in (1, 2, 3))
    sky = 0.5 + 0.5 * seen[:, 4]
    for _ in range(5):
        shine *= shine  # to the power of 32
    lit = base * (0.34 + 0.46 * key + 0.14 * fill + 0.20 * sky)[:, None] + 0.10 * shine[:, None]
    return np.asarray(np.clip(lit + glow[:, None] * (base - lit), 0.0, 1.0))


def _occlusion(depth: FloatArray, camera: Camera) -> FloatArray:
    """Darkening of corners: by how much a pixel lies behind its blurred neighbourhood (Luft et al. 2006),
    but not behind things that stand well before it.
    """
    seen = np.isfinite(depth)
    if not seen.any():
        return np.ones_like(depth)
    filled = np.where(seen, depth, np.max(depth[seen]))
    blurred = ndimage.uniform_filter(ndimage.uniform_filter(filled, 31), 31)
    scale = 40.0 / camera.focal * float(np.median(depth[seen]))
    behind = np.clip((filled - blurred) / scale, 0.0, 1.0)
    gap = (filled - ndimage.minimum_filter(filled, 61)) / scale
    return np.asarray(1.0 - 0.45 * behind * np.clip(1.5 - gap / 4.0, 0.0, 1.0))


def _ink(depth: FloatArray, normal: NDArray[np.float32], thing: IntArray) -> FloatArray:
    """Darkening (h, w) at steps of depth, changes of thing, and creases."""
    ink = np.zeros(depth.shape)
    shallow = np.where(np.isfinite(depth), depth, 1e3).astype(np.float32)
    for axis in (0, 1):
        here = [slice(None)] * 2
        there = [slice(None)] * 2
        here[axis], there[axis] = slice(None, -1), slice(1, None)
        a, b = tuple(here), tuple(there)
        step = np.abs(shallow[a] - shallow[b]) > 0.012 * np.minimum(shallow[a], shallow[b])
        edge = step | (thing[a] != thing[b])
        crease = sum(normal[a][..., k] * normal[b][..., k] for k in range(3)) < 0.6
        mark = np.where(edge, 0.62, np.where(crease, 0.30, 0.0))
        ink[a] = np.maximum(ink[a], mark)
        ink[b] = np.maximum(ink[b], mark)
    return 1.0 - ink


def _resolve(
    camera: Camera, corners: FloatArray, closed: BoolArray
) -> tuple[IntArray, NDArray[np.float32], FloatArray]:
    """Nearest face (h, w), its weights (h, w, 3) and depth (h, w) of projected triangles (F, 3, 3)."""
    h, w = camera.height, camera.width
    depth = np.full(h * w, np.inf)
    face = np.full(h * w, -1, dtype=np.int64)
    weights = np.zeros((h * w, 3), dtype=np.float32)
    low = np.floor(corners[..., :2].min(axis=1)).astype(np.int64)
    high = np.ceil(corners[..., :2].max(axis=1)).astype(np.int64)
    inside = (high >= 0).all(axis=1) & (low < [w, h]).all(axis=1) & (corners[..., 2] > 1e-3).all(axis=1)
    ab, ac = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    inside &= np.where(closed, area < -1e-9, np.abs(area) > 1e-9)
    tile = np.searchsorted(_TILES, high - low + 1)
    for across, down in itertools.product(range(len(_TILES)), repeat=2):
        group = np.flatnonzero(inside & (tile[:, 0] == across) & (tile[:, 1] == down))
        step = max(1, _BATCH // (_TILES[across] * _TILES[down]))
        for start in range(0, len(group), step):
            part = group[start : start + step]
            x = low[part, 0, None, None] + np.arange(_TILES[across])[None, None, :]
            y = low[part, 1, None, None] + np.arange(_TILES[down])[None, :, None]
            _fill(corners[part], part, x, y, (h, w), depth, face, weights)
    for i in np.flatnonzero(inside & (tile == len(_TILES)).any(axis=1)):
        x = np.arange(max(low[i, 0], 0), min(high[i, 0] + 1, w))[None, None, :]
        y = np.arange(max(low[i, 1], 0), min(high[i, 1] + 1, h))[None, :, None]
        _fill(corners[i : i + 1], np.array([i]), x, y, (h, w), depth, face, weights)
    return face.reshape(h, w), weights.reshape(h, w, 3), depth.reshape(h, w)


def _fill(
    corners: FloatArray,
    name: IntArray,
    x: IntArray,
    y: IntArray,
    shape: tuple[int, int],
    depth: FloatArray,
    face: IntArray,
    weights: NDArray[np.float32],
) -> None:
    """Fills triangles (T, 3, 3) into the flat buffers at pixel centres x (T, 1, n), y (T, n, 1)."""
    h, w = shape
    px, py = x + 0.5, y + 0.5
    ax, ay = corners[:, 0, 0, None, None], corners[:, 0, 1, None, None]
    bx, by = corners[:, 1, 0, None, None] - ax, corners[:, 1, 1, None, None] - ay
    cx, cy = corners[:, 2, 0, None, None] - ax, corners[:, 2, 1, None, None] - ay
    area = bx * cy - by * cx
    dx, dy = px - ax, py - ay
    v = (dx * cy - dy * cx) / area
    u = (bx * dy - by * dx) / area
    hit = (v >= -1e-9) & (u >= -1e-9) & (u + v <= 1.0 + 1e-9) & (x >= 0) & (x < w) & (y >= 0) & (y < h)
    t, iy, ix = np.nonzero(hit)
    flat = (y[t, iy, 0] if len(y) > 1 else y[0, iy, 0]) * w + (x[t, 0, ix] if len(x) > 1 else x[0, 0, ix])
    v, u = v[hit], u[hit]
    inverse = 1.0 / corners[:, :, 2]
    wa, wb, wc = (1.0 - u - v) * inverse[t, 0], v * inverse[t, 1], u * inverse[t, 2]
    z = 1.0 / (wa + wb + wc)
    near = z < depth[flat]
    flat, z, t = flat[near], z[near], t[near]
    np.minimum.at(depth, flat, z)
    won = depth[flat] == z
    flat, z, t = flat[won], z[won], t[won]
    face[flat] = name[t]
    weights[flat] = np.stack([wa[near][won], wb[near][won], wc[near][won]], axis=1) * z[:, None]
