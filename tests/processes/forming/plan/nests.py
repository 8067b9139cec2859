"""Parts with known features: meshed height fields and random nests with their true features."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy.spatial import Delaunay

from planner.geometry.arrays import FloatArray, Mesh

Height = Callable[[FloatArray, FloatArray], FloatArray]


@dataclasses.dataclass(frozen=True)
class Truth:
    """A true feature. ``middle`` (2,) [m] lies in it, ``parent`` is an index or None."""

    parent: int | None
    kind: str
    start: float
    end: float
    middle: tuple[float, float]
    radius: float


@dataclasses.dataclass(frozen=True)
class Nest:
    mesh: Mesh
    truth: tuple[Truth, ...]


def sheet(height: Height, half: float, spacing: float, seed: int = 0, noise: float = 0.0) -> Mesh:
    """A mesh of irregular triangles over the square of half side ``half`` [m], ``spacing`` [m] apart, with
    every height off by up to ``noise`` [m]."""
    rng = np.random.default_rng(seed)
    line = np.linspace(-half, half, max(round(2.0 * half / spacing), 2) + 1)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    inner = (np.abs(points) < half - 1e-9).all(axis=1)
    points[inner] += rng.uniform(-0.3, 0.3, (int(inner.sum()), 2)) * (line[1] - line[0])
    return over(points, height, rng, noise)


def over(
    points: FloatArray, height: Height, rng: np.random.Generator | None = None, noise: float = 0.0
) -> Mesh:
    """The Delaunay mesh of ``points`` (N, 2) [m] at their heights."""
    z = height(points[:, 0], points[:, 1])
    if rng is not None and noise:
        z = z + rng.uniform(-noise, noise, len(z))
    faces = Delaunay(points).simplices
    a, b, c = (points[faces[:, i]] for i in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = faces[np.abs(doubled) > 1e-13]
    return Mesh(np.column_stack([points, z]), faces.astype(np.int64))


def frustum(
    x: FloatArray, y: FloatArray, middle: tuple[float, float], radius: float, height: float, angle: float
) -> FloatArray:
    """A cone cut off at ``height`` [m], with walls of ``angle`` [deg]; 0 outside of ``radius`` [m]."""
    away = np.hypot(x - middle[0], y - middle[1])
    return np.clip((radius - away) * np.tan(np.radians(angle)), 0.0, height)


def dome(
    x: FloatArray, y: FloatArray, middle: tuple[float, float], radius: float, height: float
) -> FloatArray:
    """A cap of a sphere."""
    ball = (radius**2 + height**2) / (2.0 * height)
    away = np.hypot(x - middle[0], y - middle[1])
    cap = np.sqrt(np.maximum(ball**2 - away**2, 0.0)) - (ball - height)
    return np.asarray(np.where(away < radius, np.maximum(cap, 0.0), 0.0))


def random_nest(seed: int) -> Nest:
    """A random part: up to four levels of features in each other, of two kinds, in several shapes of outline
    and wall, turned about z, moved, and noisy by up to 5 um. The flat sheet may be anywhere in z."""
    rng = np.random.default_rng(seed)
    half, spacing = 0.1, 1.25e-3
    shapes: list[_Shape] = []
    truth: list[Truth] = []
    _fill(rng, shapes, truth, None, (0.0, 0.0), 0.092, 0.0, 0, spacing)
    turn, shift = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.3, 0.3, 3)
    mesh = sheet(
        lambda x, y: sum((s.height(x, y) for s in shapes), np.zeros_like(x)), half, spacing, seed, 5e-6
    )
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    vertices = mesh.vertices.copy()
    vertices[:, :2] = vertices[:, :2] @ rotation.T
    faces = mesh.faces[:, ::-1] if rng.uniform() < 0.3 else mesh.faces
    moved = [
        dataclasses.replace(
            t,
            start=t.start + shift[2],
            end=t.end + shift[2],
            middle=tuple((rotation @ np.array(t.middle) + shift[:2]).tolist()),
        )
        for t in truth
    ]
    return Nest(Mesh(vertices + shift, np.ascontiguousarray(faces)), tuple(moved))


@dataclasses.dataclass(frozen=True)
class _Shape:
    """A feature with an outline r(phi) = radius (1 + wave cos(lobes phi + phase)) and a wall of one of three
    profiles: straight, rounded at both ends, or a cap without a flat. ``inner``: its floor as a share."""

    middle: tuple[float, float]
    radius: float
    rise: float
    inner: float
    profile: str
    wave: float
    lobes: int
    phase: float

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        dx, dy = x - self.middle[0], y - self.middle[1]
        outline = self.radius * (1.0 + self.wave * np.cos(self.lobes * np.arctan2(dy, dx) + self.phase))
        fraction = np.hypot(dx, dy) / outline
        if self.profile == "cap":
            return np.asarray(self.rise * np.clip(1.0 - fraction**2, 0.0, 1.0))
        ramp = np.clip((1.0 - fraction) / (1.0 - self.inner), 0.0, 1.0)
        if self.profile == "rounded":
            ramp = ramp * ramp * (3.0 - 2.0 * ramp)
        return np.asarray(self.rise * ramp)


def _fill(
    rng: np.random.Generator,
    shapes: list[_Shape],
    truth: list[Truth],
    parent: int | None,
    middle: tuple[float, float],
    room: float,
    level: float,
    depth: int,
    spacing: float,
) -> None:
    """Features on a round flat of radius ``room`` at ``level``."""
    gap = 4.0 * spacing
    expected = int(rng.integers(1, 8)) if depth else int(rng.integers(1, 5))
    placed: list[tuple[float, float, float]] = []
    for _ in range(60):
        if len(placed) == expected:
            return
        radius = float(rng.uniform(0.15, 0.95 if expected < 3 else 0.5) * room)
        away = float(np.sqrt(rng.uniform()) * max(room - radius - gap, 0.0))
        angle = rng.uniform(0.0, 2.0 * np.pi)
        x, y = middle[0] + away * np.cos(angle), middle[1] + away * np.sin(angle)
        if radius < 5.0 * spacing or radius + gap > room:
            continue
        if any(np.hypot(x - a, y - b) < radius + r + gap for a, b, r in placed):
            continue
        placed.append((x, y, radius))
        wave = float(rng.uniform(0.0, 0.08))
        inner = float(rng.uniform(0.5, 0.85))
        deeper = depth < 3 and inner * radius > 12.0 * spacing and rng.uniform() < 0.9
        profile = str(rng.choice(["straight", "rounded"] if deeper else ["straight", "rounded", "cap"]))
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        # from a fifth of a millimetre up to walls of about 70 degrees
        rise = sign * float(np.exp(rng.uniform(np.log(3e-4), np.log(2.5 * (1.0 - inner) * radius))))
        mean = radius / (1.0 + wave)
        shapes.append(_Shape((x, y), mean, rise, inner, profile, wave, int(rng.integers(2, 6)), angle))
        kind = "convex" if sign > 0 else "concave"
        truth.append(Truth(parent, kind, level, level + rise, (x, y), radius))
        if deeper:
            free = inner * mean * (1.0 - wave)
            _fill(rng, shapes, truth, len(truth) - 1, (x, y), free, level + rise, depth + 1, spacing)


def revolved(profile: list[tuple[float, float]], sectors: int = 96) -> Mesh:
    """A surface of revolution about z: ``profile`` of (radius, z) [m] from the outer edge to the axis, where
    the last radius must be 0. Walls may be vertical or turn over."""
    angle = np.arange(sectors) * 2.0 * np.pi / sectors
    rings = [
        np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(sectors, z)])
        for radius, z in profile[:-1]
    ]
    vertices = np.concatenate([*rings, [[0.0, 0.0, profile[-1][1]]]])
    here, after = np.arange(sectors), (np.arange(sectors) + 1) % sectors
    faces = []
    for ring in range(len(rings) - 1):
        a, b, c, d = (k * sectors + index for k in (ring, ring + 1) for index in (here, after))
        faces += [np.column_stack([a, b, c]), np.column_stack([b, d, c])]
    last = (len(rings) - 1) * sectors
    faces.append(np.column_stack([last + here, last + after, np.full(sectors, len(vertices) - 1)]))
    return Mesh(vertices, np.concatenate(faces).astype(np.int64))
