"""Faces in closed form for path tests, and distances from them by brute force."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.processes.forming.plan.contact import FormingPass


def round_shape(turn: FloatArray) -> FloatArray:
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def square_shape(turn: FloatArray) -> FloatArray:
    both = round_shape(turn)
    return both / np.abs(both).max(axis=1, keepdims=True)


def rings(
    radius: FloatArray,
    height: FloatArray,
    count: int,
    side: int = 1,
    end: float | None = None,
    shape: Callable[[FloatArray], FloatArray] = round_shape,
    stretch: float = 1.0,
    middle: tuple[float, float] = (0.0, 0.0),
) -> FormingPass:
    """A feature of rings of ``shape`` at radii and heights (K,) [m] from the middle out, the last one the
    rim at z = 0, in a flat that reaches half as far again; mirrored for side -1."""
    turn = 2.0 * np.pi * np.arange(count) / count
    plan = shape(turn) * [stretch, 1.0]
    vertices = [np.array([[0.0, 0.0, height[0]]])]
    start = 1 if radius[0] == 0.0 else 0
    wide = np.append(radius[start:], 1.5 * radius[-1])
    for r, z in zip(wide, np.append(height[start:], 0.0), strict=True):
        vertices.append(np.concatenate([r * plan, np.full((count, 1), z)], axis=1))
    i, j = np.arange(count), (np.arange(count) + 1) % count
    faces = [np.stack([np.zeros(count, dtype=np.int64), 1 + i, 1 + j], axis=1)]
    for k in range(len(wide) - 1):
        a, b = 1 + k * count, 1 + (k + 1) * count
        faces += [np.stack([a + i, b + i, b + j], axis=1), np.stack([a + i, b + j, a + j], axis=1)]
    points = np.concatenate(vertices) * [1.0, 1.0, side] + [*middle, 0.0]
    region = radius[-1] * np.concatenate([plan, plan[:1]]) + middle
    low = float(height.min()) if end is None else end
    thick = np.full(len(points), 1e-3)
    return FormingPass("shape", 0, 0, side, points, np.concatenate(faces), thick, 0.0, side * low, region)


def cone(
    radius: float, depth: float, angle: float, fillet: float, side: int = 1, count: int = 180, walls: int = 12
) -> FormingPass:
    """A frustum with a flat floor; ``fillet`` [m] between floor and wall, 0 for a sharp one."""
    a = np.radians(angle)
    turn = np.linspace(0.0, a, 31)
    floor = radius - depth / np.tan(a) - fillet * np.tan(0.5 * a)
    foot = floor + fillet * np.sin(turn), -depth + fillet * (1.0 - np.cos(turn))
    if fillet == 0.0:
        foot = foot[0][:1], foot[1][:1]
    r = np.linspace(foot[0][-1], radius, walls)[1:]
    wide = np.concatenate([[0.0], foot[0], r])
    high = np.concatenate([[-depth], foot[1], (r - radius) * np.tan(a)])
    return rings(wide, high, count, side)


def bowl(
    radius: float, depth: float, side: int = 1, count: int = 180, walls: int = 60, **more
) -> FormingPass:  # type: ignore[no-untyped-def]
    """A cap of a sphere."""
    turn = np.linspace(0.0, np.arccos(1.0 - depth / radius), walls)
    return rings(radius * np.sin(turn), radius * (1.0 - np.cos(turn)) - depth, count, side, **more)


def distance(forming_pass: FormingPass, points: FloatArray) -> FloatArray:
    """Distances (N,) [m] from the face of a pass: to all triangles near enough, by planes and edges."""
    corners = forming_pass.vertices[forming_pass.faces]
    middle = corners.mean(axis=1)
    size = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    found = np.empty(len(points))
    for k, p in enumerate(points):
        deviation = np.linalg.norm(middle - p, axis=1)
        found[k] = _nearest_distance(p, corners[deviation - size <= (deviation + size).min()])
    return found


def _nearest_distance(p: FloatArray, corners: FloatArray) -> float:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height = np.einsum("fd,fd->f", p - corners[:, 0], normal)
    inside = np.ones(len(corners), dtype=bool)
    best = np.full(len(corners), np.inf)
    for k in range(3):
        one, two = corners[:, k], corners[:, (k + 1) % 3]
        way = two - one
        inside &= np.einsum("fd,fd->f", np.cross(way, p - one), normal) >= 0.0
        fraction = np.einsum("fd,fd->f", p - one, way) / np.einsum("fd,fd->f", way, way)
        foot = one + np.clip(fraction, 0.0, 1.0)[:, None] * way
        best = np.minimum(best, np.linalg.norm(p - foot, axis=1))
    return float(np.where(inside, np.abs(height), best).min())
