"""The elastic wire: fits and clamped solutions per curve in batch, compared with plain SciPy."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import least_squares

from planner.geometry.arrays import FloatArray
from planner.processes.hotwire.plan.elastica import heavy
from tests.processes.hotwire.plan.elastica import weightless

SEED = 20
BATCH = 200


def run() -> list[dict[str, Any]]:
    """Rows with name, median_s, p99_s, spread (p90 - p10), ratio (peer's median over ours), note."""
    rng = np.random.default_rng(SEED)
    rows = []
    length, start, end = _clamps(rng, 40)
    solved = _times(lambda: weightless.solve(length, start, end), 5, 40)
    shapes = weightless.solve(length, start, end)
    rows.append(
        _row(
            "solve, per wire",
            solved,
            _times(lambda: _bvp(shapes, 0), 5, 1),
            "batch of 40, peer: solve_bvp, good guess",
        )
    )

    few: list[tuple[float, float]] = []
    for _ in range(30):
        size, a, b = _clamps(rng, 20)
        points = weightless.solve(size, a, b).points(60)
        few += _times(lambda p=points: weightless.fit(p), 1, 20)
    peer = _times(lambda: _plain_fit(points[0]), 3, 1)
    rows.append(
        _row(
            "fit of exact elasticas, per curve", few, peer, "30 batches of 20, peer: least_squares, unbatched"
        )
    )

    panel, wires, weight = _panel(rng)
    times = _times(lambda: heavy.fit(panel, wires, weight), 7, 1)
    rows.append(
        _row("fit of a panel, 200 sections", times, None, "160 mm targets in 560 mm wires with weight")
    )
    per: list[tuple[float, float]] = []
    for _ in range(30):
        some, long, load = _panel(rng, 20)
        per += _times(lambda p=some, w=long, q=load: heavy.fit(p, w, q), 1, 20)
    rows.append(_row("fit with weight, per curve", per, None, "30 batches of 20"))

    fitted = heavy.fit(panel, wires, weight).shape
    section = weightless.strip_section(10.0, 0.3)
    rows.append(_row("stability in plane, 200 wires", _times(lambda: fitted.margin_in_plane, 7, 1), None, ""))
    rows.append(
        _row(
            "stability out of plane, 200 wires",
            _times(lambda: fitted.margin_out_of_plane(section), 7, 1),
            None,
            "",
        )
    )
    rows.append(
        _row("end sensitivity, 200 wires", _times(lambda: heavy.end_sensitivity(fitted), 7, 1), None, "")
    )
    points = _times(lambda: shapes.points(201), 7, 40)
    rows.append(_row("closed form at 201 points, per wire", points, None, "batch of 40"))
    return rows


def _clamps(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    length = rng.uniform(0.1, 3.0, count)
    turn = rng.uniform(-1.5, 1.5, count) * np.pi
    aim = rng.uniform(-np.pi, np.pi, count)
    reach = rng.uniform(0.1, 0.85, count) * length
    start = np.zeros((count, 3))
    return length, start, np.stack([reach * np.cos(aim), reach * np.sin(aim), turn], axis=1)


def _panel(rng: np.random.Generator, count: int = BATCH) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sections that change along a sweep: arcs with a little S and a ripple that no elastica follows."""
    u = np.linspace(-1.0, 1.0, 60)
    v = np.linspace(0.0, 1.0, count)[:, None]
    a, b, c = rng.uniform(-1.0, 1.0, (3, 1, 1))
    rise = 0.014 + 0.004 * a * v + 0.003 * b * np.sin(3.0 * v)
    y = rise * (1.0 - u**2) + 0.003 * c * v * (u - u**3) + 1e-4 * np.sin(5.0 * u + v)
    points = np.stack([np.broadcast_to(0.08 * u, y.shape), y], axis=-1)
    return points, np.full(count, 0.56), np.tile([0.0, -6.0], (count, 1))


def _bvp(shape: weightless.Shape, i: int) -> None:
    start, end, length = shape.start[i], shape.end[i], float(shape.length[i])
    s = np.linspace(0.0, length, 51)
    first = np.vstack([shape.points(51)[i].T, shape.theta(51)[i], shape.curvature(51)[i]]) * 1.05

    def balance(_: FloatArray, y: FloatArray, p: FloatArray) -> FloatArray:
        return np.vstack([np.cos(y[2]), np.sin(y[2]), y[3], p[0] * np.sin(y[2]) - p[1] * np.cos(y[2])])

    solve_bvp(
        balance,
        lambda a, b, p: np.concatenate([a[:3] - start, b[:3] - end]),
        s,
        first,
        shape.params[i, 4:] * 0.9,
        tol=1e-8,
    )


def _plain_fit(points: FloatArray) -> None:
    size = float(np.hypot(*np.diff(points, axis=0).T).sum())
    chord = np.diff(points, axis=0)
    theta = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    begin = np.array([*points[0], theta[0], (theta[-1] - theta[0]) / size, 0.0, 0.0, size])

    def gap(p: FloatArray) -> FloatArray:
        return (weightless.from_params(p[:6], p[6]).points(len(points)) - points).ravel()

    least_squares(gap, begin, x_scale=[size, size, 1.0, 1 / size, size**-2, size**-2, size])


def _times(work: Callable[[], object], repeats: int, parts: int) -> list[tuple[float, float]]:
    """Wall and processor time of a part of the work, for each repeat."""
    out = []
    for _ in range(repeats):
        begin, used = time.perf_counter(), time.process_time()
        work()
        out.append(((time.perf_counter() - begin) / parts, (time.process_time() - used) / parts))
    return out


def _row(
    name: str, times: list[tuple[float, float]], peer: list[tuple[float, float]] | None, note: str
) -> dict[str, Any]:
    wall, used = np.array(times).T
    median = float(np.median(wall))
    cpu = f"processor {1e3 * np.median(used):.3g} ms, p99 {1e3 * np.percentile(used, 99):.3g} ms"
    return {
        "name": name,
        "median_s": median,
        "p99_s": float(np.percentile(wall, 99)),
        "spread": float(np.percentile(wall, 90) - np.percentile(wall, 10)),
        "ratio": None if peer is None else float(np.median([t for t, _ in peer])) / median,
        "note": f"{note}; {cpu}" if note else cpu,
    }
