"""Line charts and heat maps as inline SVG in the page's colours, light or dark.

The page's script reads values off the charts. Heat maps show deviations over a face, seen along its
normal, with a histogram and figures.
"""

import dataclasses
import html
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray
from planner.report import markup
from planner.report.markup import Drawing, Figure, Group, Paragraph, Phrase

_LEFT: Final = 52.0
"""Room [px of the drawing] left of a plot, for the numbers and the name of its y axis."""
_RIGHT: Final = 12.0
"""Room [px] right of a plot."""
_TOP: Final = 10.0
"""Room [px] above a plot."""
_BOTTOM: Final = 34.0
"""Room [px] below a plot, for the numbers and the name of its x axis."""
_COLUMNS: Final = 420
"""Columns that a longer curve is thinned to, with its least and greatest value in each."""
_NO_DATA: Final = Paragraph("no data", "empty")
"""What stands for a chart of nothing."""


@dataclasses.dataclass(frozen=True)
class Line:
    """One curve: x, y (N,), NaN where there is none; ``color`` 0..7 of the page's palette; ``dots``: its
    points alone, as of readings."""

    name: str
    x: FloatArray
    y: FloatArray
    color: int = 0
    dashed: bool = False
    dots: bool = False


@dataclasses.dataclass(frozen=True)
class Level:
    """A horizontal limit."""

    value: float
    name: str = ""


@dataclasses.dataclass(frozen=True)
class Band:
    """A stretch of the x axis with a name, such as a segment; ``kind`` chooses its tint."""

    start: float
    end: float
    name: str
    kind: str


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Ranges of both axes and the size of the picture."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float
    height: float

    @property
    def right(self) -> float:
        return self.width - _RIGHT

    @property
    def bottom(self) -> float:
        return self.height - _BOTTOM

    def px(self, x: FloatArray | float) -> FloatArray:
        share = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        return np.asarray(_LEFT + share * (self.right - _LEFT))

    def py(self, y: FloatArray | float) -> FloatArray:
        share = (self.y[1] - np.asarray(y)) / (self.y[1] - self.y[0])
        return np.asarray(_TOP + share * (self.bottom - _TOP))


def chart(
    lines: Sequence[Line],
    *,
    x_label: str,
    y_label: str,
    levels: Sequence[Level] = (),
    bands: Sequence[Band] = (),
    y_range: tuple[float, float] | None = None,
    size: tuple[float, float] = (540.0, 210.0),
    equal: bool = False,
) -> Drawing | Paragraph:
    """A line chart with axes, limits, tinted bands and a legend; ``equal`` gives both axes one scale.

    Curves of more points than the picture has columns keep the least and greatest value of each column.
    """
    finite = [line for line in lines if np.isfinite(line.y).any()]
    if not finite:
        return _NO_DATA
    x_range = _span([line.x for line in finite])
    values = [*(line.y for line in finite), np.array([v.value for v in levels])]
    frame = _Frame(x_range, y_range or padded(*_span(values)), *size)
    if equal:
        frame = _equalised(frame)
    label = html.escape(y_label)
    parts = [
        f'<svg class="chart" viewBox="0 0 {size[0]:g} {size[1]:g}" role="img" aria-label="{label}" '
        f'data-x="{_LEFT:g} {frame.right:g} {frame.x[0]:.9g} {frame.x[1]:.9g}" '
        f'data-y="{frame.bottom:g} {_TOP:g} {frame.y[0]:.9g} {frame.y[1]:.9g}" '
        f'data-unit="{html.escape(x_label)}">',
        *_bands(frame, bands),
        *_axes(frame, x_label, y_label),
        *_levels(frame, levels),
        *_curves(frame, finite),
        '<line class="cursor" y1="10" y2="0"/></svg>',
    ]
    keys = dict.fromkeys(
        f'<span class="key c{line.color % 8}">{html.escape(line.name)}</span>' for line in finite
    )
    legend = f'<div class="legend">{"".join(keys)}</div>' if len(finite) > 1 else ""
    return Drawing("".join(parts) + legend)


def _bands(frame: _Frame, bands: Sequence[Band]) -> list[str]:
    out = []
    for band in bands:
        a, b = np.clip(frame.px(np.array([band.start, band.end])), _LEFT, frame.right)
        if b - a > 0.2:
            out.append(
                f'<rect class="band k-{html.escape(band.kind)}" x="{a:.1f}" y="{_TOP:g}" width="{b - a:.1f}" '
                f'height="{frame.bottom - _TOP:g}"><title>{html.escape(band.name)}</title></rect>'
            )
    return out


def _levels(frame: _Frame, levels: Sequence[Level]) -> list[str]:
    out = []
    for level in levels:
        y = float(frame.py(level.value))
        if not _TOP - 0.5 <= y <= frame.bottom + 0.5:
            continue
        out.append(f'<line class="limit" x1="{_LEFT:g}" x2="{frame.right:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        name = html.escape(level.name).replace("-", "−")
        out.append(f'<text class="limit-name" x="{frame.right - 4:g}" y="{y - 4:.1f}">{name}</text>')
    return out


def _curves(frame: _Frame, lines: Sequence[Line]) -> list[str]:
    """The curves in a nested picture that clips them to the plot."""
    box = f"{_LEFT:g} {_TOP:g} {frame.right - _LEFT:g} {frame.bottom - _TOP:g}"
    x, y, w, h = box.split()
    out = [f'<svg x="{x}" y="{y}" width="{w}" height="{h}" viewBox="{box}">']
    for line in lines:
        if line.dots:
            out += _dots(frame, line)
            continue
        xs, ys = _thinned(line.x, line.y)
        dash = " dashed" if line.dashed else ""
        for run in _runs(ys):
            heights = np.clip(frame.py(ys[run]), -2.0 * frame.height, 3.0 * frame.height)
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(frame.px(xs[run]), heights, strict=True))
            name = html.escape(line.name)
            out.append(
                f'<polyline class="line c{line.color % 8}{dash}" data-name="{name}" points="{points}"/>'
            )
    return [*out, "</svg>"]


def _dots(frame: _Frame, line: Line) -> list[str]:
    known = np.isfinite(line.x) & np.isfinite(line.y)
    places = zip(frame.px(line.x[known]), frame.py(line.y[known]), strict=True)
    name = html.escape(line.name)
    return [
        f'<circle class="dot c{line.color % 8}" cx="{x:.1f}" cy="{y:.1f}" r="3.2">'
        f"<title>{name}</title></circle>"
        for x, y in places
    ]


def padded(low: float, high: float) -> tuple[float, float]:
    """A range with some air, never empty."""
    if high - low < 1e-12 * max(1.0, abs(high)):
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    air = 0.06 * (high - low)
    return low - (0.0 if low == 0.0 else air), high + air


def ticks(low: float, high: float, count: int = 5) -> FloatArray:
    """Round numbers (1, 2, 2.5 or 5 times a power of ten) within a range, about ``count`` of them."""
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return np.asarray(np.arange(first, last + 1) * step)


def _axes(frame: _Frame, x_label: str, y_label: str) -> list[str]:
    right, bottom = frame.right, frame.bottom
    out = []
    for value in ticks(*frame.y, 4):
        y = float(frame.py(value))
        out.append(f'<line class="grid" x1="{_LEFT:g}" x2="{right:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        out.append(f'<text class="ytick" x="{_LEFT - 6:g}" y="{y + 3.5:.1f}">{_number(value)}</text>')
    for value in ticks(*frame.x, 7):
        x = float(frame.px(value))
        out.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{bottom:g}" y2="{bottom + 4:g}"/>')
        out.append(f'<text class="xtick" x="{x:.1f}" y="{bottom + 16:g}">{_number(value)}</text>')
    out.append(f'<line class="axis" x1="{_LEFT:g}" x2="{right:g}" y1="{bottom:g}" y2="{bottom:g}"/>')
    middle_x, middle_y = 0.5 * (_LEFT + right), 0.5 * (_TOP + bottom)
    name_x, name_y = html.escape(x_label), html.escape(y_label)
    out.append(f'<text class="xlabel" x="{middle_x:g}" y="{frame.height - 3:g}">{name_x}</text>')
    out.append(f'<text class="ylabel" transform="translate(11 {middle_y:g}) rotate(-90)">{name_y}</text>')
    return out


def _number(value: float) -> str:
    return f"{value + 0.0:.6g}".replace("-", "−")


def _span(arrays: Sequence[FloatArray]) -> tuple[float, float]:
    values = np.concatenate([np.ravel(a) for a in arrays])
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _equalised(frame: _Frame) -> _Frame:
    aspect = (frame.right - _LEFT) / (frame.bottom - _TOP)
    scale = max((frame.x[1] - frame.x[0]) / aspect, frame.y[1] - frame.y[0])
    cx, cy = 0.5 * sum(frame.x), 0.5 * sum(frame.y)
    half = 0.5 * scale
    x = (cx - half * aspect, cx + half * aspect)
    return dataclasses.replace(frame, x=x, y=(cy - half, cy + half))


def _thinned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At most two points a column, the least and the greatest, in order."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(x) <= 2 * _COLUMNS:
        return x, y
    width = -(-len(x) // _COLUMNS)
    whole = np.full(width * _COLUMNS, np.nan)
    whole[: len(y)] = y
    columns = whole.reshape(_COLUMNS, width)
    missing = np.isnan(columns)
    least = np.where(missing, np.inf, columns).argmin(axis=1)
    greatest = np.where(missing, -np.inf, columns).argmax(axis=1)
    start = np.arange(_COLUMNS) * width
    keep = np.unique(np.concatenate([start + least, start + greatest, [0, len(x) - 1]]))
    keep = keep[keep < len(x)]
    return x[keep], y[keep]


def _runs(y: FloatArray) -> list[slice]:
    """Stretches of finite values, at least two points long."""
    good = np.concatenate([[False], np.isfinite(y), [False]])
    edges = np.flatnonzero(good[1:] != good[:-1])
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a > 1]


_COLD = np.array([0.13, 0.36, 0.70])
"""Red, green, blue in 0..1 of a deviation far below zero: too much is cut."""
_MILD = np.array([0.93, 0.94, 0.93])
"""Red, green, blue in 0..1 of no deviation."""
_WARM = np.array([0.78, 0.18, 0.13])
"""Red, green, blue in 0..1 of a deviation far above zero: material is left standing."""
_UNROLLED_GRID = (1500, 41)
"""Points along and across a ruled surface that is laid flat."""
MISSED_COLOUR = np.array([0.35, 0.13, 0.45])
"""Red, green, blue in 0..1 of places that the tool did not pass."""


@dataclasses.dataclass(frozen=True)
class FaceWords:
    """Words for a simulated face: what passes it, and its negative and positive deviations."""

    tool: str = "tool"
    negative: str = "too much cut"
    positive: str = "left standing"

    @property
    def missing(self) -> str:
        """What missing deviations are called."""
        return f"the {self.tool} did not pass"


@dataclasses.dataclass(frozen=True)
class Rulings:
    """Ends (K, 3) [m] of the rulings of a face, and words for the view of its map, which is laid flat."""

    start: FloatArray
    end: FloatArray
    words: str


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


def unrolled(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Coordinates (M, 2) [m] of points (M, 3) on the ruled surface between ``start`` and ``end`` (K, 3), laid
    flat: along its middle line, and along its rulings.

    Each point takes the place of the nearest one of a dense grid on the surface.
    """
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(0.5 * (start + end), axis=0), axis=1))])
    at, share = np.linspace(0.0, way[-1], _UNROLLED_GRID[0]), np.linspace(0.0, 1.0, _UNROLLED_GRID[1])
    low, high = (
        np.stack([np.interp(at, way, side[:, c]) for c in range(3)], axis=-1) for side in (start, end)
    )
    grid = low[:, None] + share[:, None] * (high - low)[:, None]
    _, nearest = cKDTree(grid.reshape(-1, 3)).query(points)
    row, column = np.divmod(nearest, _UNROLLED_GRID[1])
    length = float(np.linalg.norm(end - start, axis=1).mean())
    return np.stack([at[row], length * share[column]], axis=1)


def span_of(deviation: FloatArray, tolerance: float) -> float:
    """What the colours reach to [m]: nearly all deviations, so that small ones can be seen too."""
    finite = np.abs(deviation[np.isfinite(deviation)])
    largest = float(np.percentile(finite, 99.5)) if len(finite) else tolerance
    return max(1.15 * largest, 0.05 * tolerance)


def deviation_map(
    points: FloatArray,
    deviation: FloatArray,
    tolerance: float,
    title: Phrase,
    words: FaceWords,
    rulings: Rulings | None = None,
) -> Figure:
    """A heat map [mm] of deviations (M,) [m] at points (M, 3) [m]; NaN marks where the edge did not pass.

    A face with ``rulings`` is laid flat, any other one seen along its normal.
    """
    if rulings is None:
        uv, view_words = laid(points)
    else:
        uv, view_words = unrolled(points, rulings.start, rulings.end), rulings.words
    span = span_of(deviation, tolerance)
    grid, extent = binned(uv, deviation)
    missed = np.isnan(grid)
    color = diverging(np.where(np.isfinite(grid), grid, 0.0), span)
    color[missed] = MISSED_COLOUR
    alpha = np.where(np.isposinf(grid), 0.0, 1.0)
    field = _field(markup.png(color, alpha), extent)
    return Figure(title, Group((field, _scale_bar(span, tolerance, bool(missed.any()), words))), view_words)


def _axis(direction: FloatArray) -> str:
    k = int(np.argmax(np.abs(direction)))
    return ("+" if direction[k] > 0 else "−") + "xyz"[k]


def histogram(deviation: FloatArray, tolerance: float) -> Drawing | Paragraph:
    """Share of the face over the deviation [mm], with the tolerance marked."""
    finite = deviation[np.isfinite(deviation)] * 1e3
    if not len(finite):
        return _NO_DATA
    span = 1e3 * span_of(deviation, tolerance)
    counts, edges = np.histogram(np.clip(finite, -span, span), bins=60, range=(-span, span))
    share = 100.0 * counts / max(len(deviation), 1)
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(share, 2)
    inside = Band(-tolerance * 1e3, tolerance * 1e3, "within tolerance", "link")
    return chart(
        [Line("share", x, y, 0)],
        x_label="deviation [mm]",
        y_label="share [%]",
        bands=[inside],
        y_range=(0.0, float(share.max()) * 1.08),
    )


def _field(image: str, extent: tuple[float, float, float, float]) -> Drawing:
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
    for value in ticks(u0, u1, int(np.clip(w / 60.0, 1, 7))):
        x = left + (value - u0) * scale
        parts.append(f'<text class="xtick" x="{x:.1f}" y="{h + 21:.1f}">{markup.number(float(value))}</text>')
    for value in ticks(v0, v1, int(np.clip(h / 40.0, 1, 6))):
        y = 6 + (v1 - value) * scale
        parts.append(
            f'<text class="ytick" x="{left - 6:.1f}" y="{y + 4:.1f}">{markup.number(float(value))}</text>'
        )
    parts.append("</svg>")
    return Drawing("".join(parts))


def _scale_bar(span: float, tolerance: float, missed: bool, face: FaceWords) -> Drawing:
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
    words = [("#215cb2", face.negative), ("#c72e21", face.positive)]
    words += [("#592173", face.missing)] if missed else []
    words += [("transparent", f"tolerance ±{markup.number(tolerance * 1e3)} mm: off the scale")] * (
        tolerance > span
    )
    keys = "".join(f'<span class="swatch" style="--s:{color}">{name}</span>' for color, name in words)
    return Drawing("".join(parts) + f'<div class="legend">{keys}</div>')


def value_map(points: FloatArray, value: FloatArray, limit: float | None, unit: str) -> Group:
    """A heat map of any value (M,) at points (M, 3) [m]: about 0 with ``limit``, else from least to most."""
    if points.shape != (len(value), 3):
        raise ValueError(f"points {points.shape} and value {value.shape} do not belong together")
    uv, words = laid(points)
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
    key = Drawing(
        f'<svg class="plot" viewBox="0 0 440 24"><image href="{image}" x="90" y="6" width="260" height="9" '
        f'preserveAspectRatio="none"/><text class="ytick" x="84" y="14">{markup.number(low, 3)}</text>'
        f'<text x="356" y="14">{markup.number(high, 3)} {markup.text(unit)}</text></svg>'
    )
    field = _field(markup.png(color, inside.astype(np.float64)), extent)
    return Group((field, key, Paragraph(words, "note")))
