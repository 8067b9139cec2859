"""Heat maps of deviations over a face, seen along its normal, with a histogram and figures."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from planner.report import charts, markup
from planner.report.markup import Raw

FloatArray = NDArray[np.float64]
_COLD = np.array([0.13, 0.36, 0.70])
_MILD = np.array([0.93, 0.94, 0.93])
_WARM = np.array([0.78, 0.18, 0.13])
_GRID = (1500, 41)
_MISSED = np.array([0.35, 0.13, 0.45])
CUT: Final = ("too much cut", "left standing", "the wire did not pass")
FORMED: Final = ("pressed too far", "not pressed so far", "the ball did not pass")
MILLED: Final = ("too much cut", "left standing", "the cutter did not pass")
"""What negative, positive and missing deviations of a cut, a formed and a milled face are called."""


def view(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Horizontal axis, vertical axis and normal (3,) each of the plane that lies best through points (M, 3).

    Vertical is the frame's z as far as the plane allows, or its y for a plane that lies flat.
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    normal = axes[2] * (1.0 if axes[2][np.argmax(np.abs(axes[2]))] > 0 else -1.0)
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    up = up - normal * (up @ normal)
    up /= np.linalg.norm(up)
    return np.cross(up, normal), up, normal


def diverging(value: FloatArray, span: float) -> FloatArray:
    """Colours (..., 3): blue below zero, pale at zero, red above, full at ``span``."""
    t = np.clip(value / span, -1.0, 1.0)[..., None]
    weight = np.abs(t) ** 0.8
    return np.asarray(np.where(t < 0, _MILD + weight * (_COLD - _MILD), _MILD + weight * (_WARM - _MILD)))


def sequential(value: FloatArray) -> FloatArray:
    """Colours (..., 3) for values in 0..1, dark blue over green to yellow (keys of the viridis map)."""
    keys = np.array(
        [[0.27, 0.0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38], [0.99, 0.91, 0.15]]
    )
    at = np.linspace(0.0, 1.0, len(keys))
    return np.stack([np.interp(value, at, keys[:, c]) for c in range(3)], axis=-1)


def binned(uv: FloatArray, value: FloatArray) -> tuple[FloatArray, tuple[float, float, float, float]]:
    """Values on a grid (rows from the top) and its extent u0, u1, v0, v1: the greatest value in each cell.

    Cells without a point take the nearest one's where that is near; farther ones are infinite; NaN stays NaN.
    """
    low, high = uv.min(axis=0), uv.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    cell = max(float(np.sqrt(size[0] * size[1] / max(len(uv), 1))) * 2.0, float(size.max()) / 240.0)
    shape = np.ceil(size / cell).astype(int) + 1
    column, row = ((uv - low) / cell).astype(int).T
    flat = (shape[1] - 1 - row) * shape[0] + column
    order = np.argsort(np.where(np.isnan(value), np.inf, np.abs(value)), kind="stable")
    grid = np.full(shape[0] * shape[1], np.inf)
    grid[flat[order]] = value[order]
    grid = grid.reshape(shape[1], shape[0])
    empty = np.isposinf(grid)
    distance, nearest = ndimage.distance_transform_edt(empty, return_indices=True)
    filled = np.where(distance <= 3.0, grid[tuple(nearest)], np.inf)
    return filled, (
        float(low[0]),
        float(low[0] + shape[0] * cell),
        float(low[1]),
        float(low[1] + shape[1] * cell),
    )


def laid(points: FloatArray) -> tuple[FloatArray, str]:
    """Coordinates (M, 2) of points (M, 3) in the plane that lies best through them, the longer side across,
    and words that say from where they are seen.
    """
    across, up, normal = view(points)
    uv = points @ np.stack([across, up], axis=1)
    if np.ptp(uv[:, 1]) > 1.2 * np.ptp(uv[:, 0]):
        across, up = up, -across
        uv = points @ np.stack([across, up], axis=1)
    words = f"seen from {_axis(normal)} of the stock frame, {_axis(across)} to the right, {_axis(up)} up; mm"
    return uv, words


def unrolled(points: FloatArray, start: FloatArray, end: FloatArray) -> tuple[FloatArray, str]:
    """Coordinates (M, 2) [m] of points (M, 3) on the ruled surface between ``start`` and ``end`` (K, 3), laid
    flat: along its middle line, and along its rulings; and words that say so.

    Each point takes the place of the nearest one of a dense grid on the surface.
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(0.5 * (start + end), axis=0), axis=1))])
    at, share = np.linspace(0.0, way[-1], _GRID[0]), np.linspace(0.0, 1.0, _GRID[1])
    low, high = (
        np.stack([np.interp(at, way, side[:, c]) for c in range(3)], axis=-1) for side in (start, end)
    )
    grid = low[:, None] + share[:, None] * (high - low)[:, None]
    _, nearest = cKDTree(grid.reshape(-1, 3)).query(points)
    row, column = np.divmod(nearest, _GRID[1])
    length = float(np.linalg.norm(end - start, axis=1).mean())
    words = "laid flat: along the cut to the right, along the wire up; mm"
    return np.stack([at[row], length * share[column]], axis=1), words


def span_of(deviation: FloatArray, tolerance: float) -> float:
    """What the colours reach to [m]: nearly all deviations, so that small ones can be seen too."""
    finite = np.abs(deviation[np.isfinite(deviation)])
    largest = float(np.percentile(finite, 99.5)) if len(finite) else tolerance
    return max(1.15 * largest, 0.05 * tolerance)


def deviation_map(
    points: FloatArray,
    deviation: FloatArray,
    tolerance: float,
    title: str,
    rulings: tuple[FloatArray, FloatArray] | None = None,
    signs: tuple[str, str, str] = CUT,
) -> Raw:
    """A heat map [mm] of deviations (M,) [m] at points (M, 3) [m]; NaN marks where the edge did not pass.

    ``signs``: what negative, positive and missing deviations are called.

    A surface of the ``rulings`` from (K, 3) to (K, 3) is laid flat, any other one seen along its normal.
    """
    uv, words = laid(points) if rulings is None else unrolled(points, *rulings)
    span = span_of(deviation, tolerance)
    grid, extent = binned(uv, deviation)
    missed = np.isnan(grid)
    color = diverging(np.where(np.isfinite(grid), grid, 0.0), span)
    color[missed] = _MISSED
    alpha = np.where(np.isposinf(grid), 0.0, 1.0)
    body = _field(markup.png(color, alpha), extent) + _scale_bar(span, tolerance, bool(missed.any()), signs)
    return markup.figure(title, body, words)


def _axis(direction: FloatArray) -> str:
    k = int(np.argmax(np.abs(direction)))
    return ("+" if direction[k] > 0 else "−") + "xyz"[k]


def histogram(deviation: FloatArray, tolerance: float) -> str:
    """Share of the face over the deviation [mm], with the tolerance marked."""
    finite = deviation[np.isfinite(deviation)] * 1e3
    if not len(finite):
        return '<p class="empty">no data</p>'
    span = 1e3 * span_of(deviation, tolerance)
    counts, edges = np.histogram(np.clip(finite, -span, span), bins=60, range=(-span, span))
    share = 100.0 * counts / max(len(deviation), 1)
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(share, 2)
    inside = charts.Band(-tolerance * 1e3, tolerance * 1e3, "within tolerance", "link")
    return charts.chart(
        [charts.Line("share", x, y, 0)],
        x_label="deviation [mm]",
        y_label="share [%]",
        bands=[inside],
        y_range=(0.0, float(share.max()) * 1.08),
    )


def _field(image: str, extent: tuple[float, float, float, float]) -> str:
    """A picture with ruled edges in mm, one scale for both axes."""
    u0, u1, v0, v1 = (e * 1e3 for e in extent)
    width = 440.0
    scale = min((width - 60.0) / (u1 - u0), 330.0 / (v1 - v0))
    w, h = scale * (u1 - u0), scale * (v1 - v0)
    left = 46.0 + 0.5 * (width - 60.0 - w)
    parts = [
        f'<svg class="plot" viewBox="0 0 {width:g} {h + 34:.1f}">'
        f'<image href="{image}" x="{left:.1f}" y="6" width="{w:.1f}" height="{h:.1f}" '
        'preserveAspectRatio="none"/>'
    ]
    for value in charts.ticks(u0, u1, int(np.clip(w / 60.0, 1, 7))):
        x = left + (value - u0) * scale
        parts.append(f'<text class="xtick" x="{x:.1f}" y="{h + 21:.1f}">{markup.number(float(value))}</text>')
    for value in charts.ticks(v0, v1, int(np.clip(h / 40.0, 1, 6))):
        y = 6 + (v1 - value) * scale
        parts.append(
            f'<text class="ytick" x="{left - 6:.1f}" y="{y + 4:.1f}">{markup.number(float(value))}</text>'
        )
    parts.append("</svg>")
    return "".join(parts)


def _scale_bar(span: float, tolerance: float, missed: bool, signs: tuple[str, str, str]) -> str:
    values = np.linspace(-span, span, 200)
    image = markup.png(np.tile(diverging(values, span)[None], (2, 1, 1)))
    left, width = 60.0, 320.0
    parts = [
        '<svg class="plot" viewBox="0 0 440 30">',
        f'<image href="{image}" x="{left:g}" y="2" width="{width:g}" height="9" preserveAspectRatio="none"/>',
    ]
    marks = (-span, -tolerance, 0.0, tolerance, span) if tolerance <= span else (-span, 0.0, span)
    for value in marks:
        x = left + (value + span) / (2 * span) * width
        if abs(abs(value) - span) > 0.1 * span or abs(value) == span:
            parts.append(f'<text class="mid" x="{x:.1f}" y="24">{markup.number(value * 1e3, 2)}</text>')
        if abs(value) == tolerance:
            parts.append(f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="13"/>')
    parts.append("</svg>")
    words = [("#215cb2", signs[0]), ("#c72e21", signs[1])]
    words += [("#592173", signs[2])] if missed else []
    words += [("transparent", f"tolerance ±{markup.number(tolerance * 1e3)} mm: off the scale")] * (
        tolerance > span
    )
    keys = "".join(f'<span class="swatch" style="--s:{color}">{name}</span>' for color, name in words)
    return "".join(parts) + f'<div class="legend">{keys}</div>'


def value_map(points: FloatArray, value: FloatArray, limit: float | None, unit: str) -> str:
    """A heat map of any value (M,) at points (M, 3) [m]: about 0 with ``limit``, else from least to most."""
    if points.shape != (len(value), 3):
        raise ValueError(f"points {points.shape} and value {value.shape} do not belong together")
    uv, _ = laid(points)
    grid, extent = binned(uv, value)
    inside = np.isfinite(grid)
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    if limit is not None:
        span = max(float(limit), abs(low), abs(high))
        low, high = -span, span
        color = diverging(np.where(inside, grid, 0.0), span)
        bar = diverging(np.linspace(-span, span, 200), span)
    else:
        color = sequential((np.where(inside, grid, low) - low) / max(high - low, 1e-12))
        bar = sequential(np.linspace(0.0, 1.0, 200))
    image = markup.png(np.tile(bar[None], (2, 1, 1)))
    key = (
        f'<svg class="plot" viewBox="0 0 440 24"><image href="{image}" x="90" y="6" width="260" height="9" '
        f'preserveAspectRatio="none"/><text class="ytick" x="84" y="14">{markup.number(low, 3)}</text>'
        f'<text x="356" y="14">{markup.number(high, 3)} {markup.text(unit)}</text></svg>'
    )
    return _field(markup.png(color, inside.astype(np.float64)), extent) + key
