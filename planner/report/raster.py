"""A small depth-buffer renderer in NumPy: pictures of a cell without a display."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from planner.geometry.vectors import lengths
from planner.report.solids import Solid

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_TILES: Final = (8, 24, 72, 216)
_BATCH: Final = 200_000
_LIGHT: Final = np.array([0.35, -0.55, 0.76])


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

    def window(self, points: FloatArray, margin: int = 4) -> Camera:
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


def draw(camera: Camera, things: list[Thing]) -> Image:
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
    camera: Camera, corners: FloatArray, closed: NDArray[np.bool_]
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
