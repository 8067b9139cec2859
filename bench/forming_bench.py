"""Features of a part: the time of a tree of ten features, from 80,000 triangles (4 MB as binary STL)."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from planner.geometry.arrays import Mesh
from planner.processes.forming.plan.features.tree import build_feature_tree

HALF, SPACING = 0.1, 1e-3
ROUNDS = 5


def run() -> list[dict[str, Any]]:
    """Rows with name, median_s, p99_s, spread, note."""
    mesh = ten_features()
    rows = []
    for step in (1e-3, 5e-4, 1e-4):
        times = []
        for _ in range(ROUNDS):
            started = time.perf_counter()
            tree = build_feature_tree(mesh, step)
            times.append(time.perf_counter() - started)
        contours = sum(len(feature.contours) for feature in tree.features)
        rows.append(
            {
                "name": f"feature tree, {len(mesh.faces)} triangles, step {1e3 * step:g} mm",
                "median_s": float(np.median(times)),
                "p99_s": float(np.max(times)),
                "spread": float(np.ptp(times)),
                "note": f"{len(tree.features)} features, {contours} contours"
                + ("; goal 5 s" if step == 1e-4 else ""),
            }
        )
    return rows


def ten_features() -> Mesh:
    """A dish with six domes up and three dimples down in its floor, with noise of 5 um."""
    rng = np.random.default_rng(1)
    count = round(2.0 * HALF / SPACING) + 1
    line = np.linspace(-HALF, HALF, count)
    x, y = (axis.reshape(-1) for axis in np.meshgrid(line, line))

    def bump(u: float, v: float, radius: float, height: float) -> np.ndarray:
        return np.clip(1.2 * (radius - np.hypot(x - u, y - v)), 0.0, height)

    z = -bump(0.0, 0.0, 0.09, 0.02) + rng.uniform(-5e-6, 5e-6, len(x))
    for angle in np.arange(6) * np.pi / 3.0:
        z += bump(0.05 * np.cos(angle), 0.05 * np.sin(angle), 0.014, 0.008)
    for angle in np.arange(3) * 2.0 * np.pi / 3.0 + 0.3:
        z -= bump(0.022 * np.cos(angle), 0.022 * np.sin(angle), 0.009, 0.004)
    cell = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).reshape(-1)
    lower = np.column_stack([cell, cell + 1, cell + count + 1])
    upper = np.column_stack([cell, cell + count + 1, cell + count])
    return Mesh(np.column_stack([x, y, z]), np.concatenate([lower, upper]).astype(np.int64))
