"""Line charts and heat maps as inline SVG in the colours of the page, light or dark.

The script of the page reads values off the charts. Heat maps show deviations over a face, seen along its
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
from planner.report.markup import BlockGroup, Drawing, FigureBlock, Paragraph, Phrase

_LEFT: Final = 52.0
"""Space [px of the drawing] left of a plot, for the numbers and the name of its y axis."""
_RIGHT: Final = 12.0
"""Space [px] right of a plot."""
_TOP: Final = 10.0
"""Space [px] above a plot."""
_BOTTOM: Final = 34.0
"""Space [px] below a plot, for the numbers and the name of its x axis."""
_COLUMNS: Final = 420
"""Maximum number of columns of a curve. Longer ones keep the minimum and maximum of each column."""
_NO_DATA: Final = Paragraph("no data", "empty")
"""Placeholder for a chart without data."""


@dataclasses.dataclass(frozen=True)
class ChartLine:
    """A curve of a chart.

    Attributes:
        name: Name in the legend.
        x: Abscissae (N,).
        y: Values (N,), NaN where there is none.
        color: Colour 0..7 of the page's palette.
        dashed: Draw a dashed line.
        dots: Draw the points only, as for measurements.
    """

    name: str
    x: FloatArray
    y: FloatArray
    color: int = 0
    dashed: bool = False
    dots: bool = False


@dataclasses.dataclass(frozen=True)
class LimitLine:
    """A horizontal limit line."""

    value: float
    name: str = ""


@dataclasses.dataclass(frozen=True)
class ChartBand:
    """A named interval of the x axis, such as a segment. ``kind`` chooses its tint."""

    start: float
    end: float
    name: str
    kind: str


@dataclasses.dataclass(frozen=True)
class ChartAxes:
    """Names and scales of the two axes of a chart.

    Attributes:
        x_label: Name of the x axis.
        y_label: Name of the y axis.
        y_range: Range of the y axis, or None to fit the data.
        equal: Use one scale for both axes.
    """

    x_label: str
    y_label: str
    y_range: tuple[float, float] | None = None
    equal: bool = False


@dataclasses.dataclass(frozen=True)
class _PlotFrame:
    """Ranges of both axes, and width and height of the whole picture [px]."""

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
        """Return the horizontal positions [px] of abscissae."""
        fraction = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        return np.asarray(_LEFT + fraction * (self.right - _LEFT))

    def py(self, y: FloatArray | float) -> FloatArray:
        """Return the vertical positions [px], from the top, of ordinates."""
        fraction = (self.y[1] - np.asarray(y)) / (self.y[1] - self.y[0])
        return np.asarray(_TOP + fraction * (self.bottom - _TOP))


def chart(
    lines: Sequence[ChartLine],
    axes: ChartAxes,
    *,
    levels: Sequence[LimitLine] = (),
    bands: Sequence[ChartBand] = (),
    size: tuple[float, float] = (540.0, 210.0),
) -> Drawing | Paragraph:
    """Draw a line chart with axes, limits, tinted bands and a legend.

    Curves with more points than the picture has columns keep the minimum and maximum of each column.

    Args:
        lines: Curves.
        axes: Names and scales of the axes.
        levels: Limits.
        bands: Tinted intervals.
        size: Width and height [px].

    Returns:
        SVG with its legend, or a placeholder if no curve has a finite value.
    """
    drawn_lines = [line for line in lines if np.isfinite(line.y).any()]
    if not drawn_lines:
        return _NO_DATA
    x_range = _value_range([line.x for line in drawn_lines])
    values = [*(line.y for line in drawn_lines), np.array([v.value for v in levels])]
    frame = _PlotFrame(x_range, axes.y_range or padded_range(*_value_range(values)), *size)
    if axes.equal:
        frame = _with_equal_scales(frame)
    label = html.escape(axes.y_label)
    parts = [
        f'<svg class="chart" viewBox="0 0 {size[0]:g} {size[1]:g}" role="img" aria-label="{label}" '
        f'data-x="{_LEFT:g} {frame.right:g} {frame.x[0]:.9g} {frame.x[1]:.9g}" '
        f'data-y="{frame.bottom:g} {_TOP:g} {frame.y[0]:.9g} {frame.y[1]:.9g}" '
        f'data-unit="{html.escape(axes.x_label)}">',
        *_bands(frame, bands),
        *_axes(frame, axes.x_label, axes.y_label),
        *_levels(frame, levels),
        *_curves(frame, drawn_lines),
        '<line class="cursor" y1="10" y2="0"/></svg>',
    ]
    legend_entries = dict.fromkeys(
        f'<span class="key c{line.color % 8}">{html.escape(line.name)}</span>' for line in drawn_lines
    )
    legend = f'<div class="legend">{"".join(legend_entries)}</div>' if len(drawn_lines) > 1 else ""
    return Drawing("".join(parts) + legend)


def _bands(frame: _PlotFrame, bands: Sequence[ChartBand]) -> list[str]:
    """Return a tinted rectangle for each band, clipped to the plot. Its name is shown at the pointer."""
    out = []
    for band in bands:
        a, b = np.clip(frame.px(np.array([band.start, band.end])), _LEFT, frame.right)
        if b - a > 0.2:
            out.append(
                f'<rect class="band k-{html.escape(band.kind)}" x="{a:.1f}" y="{_TOP:g}" width="{b - a:.1f}" '
                f'height="{frame.bottom - _TOP:g}"><title>{html.escape(band.name)}</title></rect>'
            )
    return out


def _levels(frame: _PlotFrame, levels: Sequence[LimitLine]) -> list[str]:
    """Return the limit lines within the plot, with their names."""
    out = []
    for level in levels:
        y = float(frame.py(level.value))
        if not _TOP - 0.5 <= y <= frame.bottom + 0.5:
            continue
        out.append(f'<line class="limit" x1="{_LEFT:g}" x2="{frame.right:g}" y1="{y:.1f}" y2="{y:.1f}"/>')
        name = html.escape(level.name).replace("-", "−")
        out.append(f'<text class="limit-name" x="{frame.right - 4:g}" y="{y - 4:.1f}">{name}</text>')
    return out


def _curves(frame: _PlotFrame, lines: Sequence[ChartLine]) -> list[str]:
    """Draw the curves in a nested picture that clips them to the plot."""
    box = f"{_LEFT:g} {_TOP:g} {frame.right - _LEFT:g} {frame.bottom - _TOP:g}"
    x, y, w, h = box.split()
    out = [f'<svg x="{x}" y="{y}" width="{w}" height="{h}" viewBox="{box}">']
    for line in lines:
        if line.dots:
            out += _dots(frame, line)
            continue
        xs, ys = _decimated(line.x, line.y)
        dash = " dashed" if line.dashed else ""
        for run in _runs(ys):
            heights = np.clip(frame.py(ys[run]), -2.0 * frame.height, 3.0 * frame.height)
            points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(frame.px(xs[run]), heights, strict=True))
            name = html.escape(line.name)
            out.append(
                f'<polyline class="line c{line.color % 8}{dash}" data-name="{name}" points="{points}"/>'
            )
    return [*out, "</svg>"]


def _dots(frame: _PlotFrame, line: ChartLine) -> list[str]:
    """Return a circle for each finite point of a curve."""
    known = np.isfinite(line.x) & np.isfinite(line.y)
    positions = zip(frame.px(line.x[known]), frame.py(line.y[known]), strict=True)
    name = html.escape(line.name)
    return [
        f'<circle class="dot c{line.color % 8}" cx="{x:.1f}" cy="{y:.1f}" r="3.2">'
        f"<title>{name}</title></circle>"
        for x, y in positions
    ]


def padded_range(low: float, high: float) -> tuple[float, float]:
    """Return a range with a margin of 6 % at its ends, except at a lower end of 0. It is never empty."""
    if high - low < 1e-12 * max(1.0, abs(high)):
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    margin = 0.06 * (high - low)
    return low - (0.0 if low == 0.0 else margin), high + margin


def ticks(low: float, high: float, count: int = 5) -> FloatArray:
    """Return round numbers (1, 2, 2.5 or 5 times a power of ten) within a range.

    Args:
        low: Lower end.
        high: Upper end.
        count: Approximate number of ticks.
    """
    min_step = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(min_step))
    # the factor 0.999 keeps a round step that rounding errors make slightly too small
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= min_step * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return np.asarray(np.arange(first, last + 1) * step)


def _axes(frame: _PlotFrame, x_label: str, y_label: str) -> list[str]:
    """Return grid lines, ticks with their numbers, and the names of both axes."""
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
    return f"{value + 0.0:.6g}".replace("-", "−")  # the sum turns -0.0 into 0.0


def _value_range(arrays: Sequence[FloatArray]) -> tuple[float, float]:
    """Return the finite minimum and maximum of arrays, or a range of size 1 if they are equal."""
    values = np.concatenate([np.ravel(a) for a in arrays])
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _with_equal_scales(frame: _PlotFrame) -> _PlotFrame:
    """Widen one of the ranges about its middle, so that both axes have the same scale."""
    aspect = (frame.right - _LEFT) / (frame.bottom - _TOP)
    scale = max((frame.x[1] - frame.x[0]) / aspect, frame.y[1] - frame.y[0])
    cx, cy = 0.5 * sum(frame.x), 0.5 * sum(frame.y)
    half = 0.5 * scale
    x = (cx - half * aspect, cx + half * aspect)
    return dataclasses.replace(frame, x=x, y=(cy - half, cy + half))


def _decimated(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Decimate a long curve to its ends and to the minimum and maximum of each column, in order."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(x) <= 2 * _COLUMNS:
        return x, y
    width = -(-len(x) // _COLUMNS)  # points per column, rounded up; the last columns are padded with NaN
    padded = np.full(width * _COLUMNS, np.nan)
    padded[: len(y)] = y
    columns = padded.reshape(_COLUMNS, width)
    missing = np.isnan(columns)
    minima = np.where(missing, np.inf, columns).argmin(axis=1)
    maxima = np.where(missing, -np.inf, columns).argmax(axis=1)
    start = np.arange(_COLUMNS) * width
    keep = np.unique(np.concatenate([start + minima, start + maxima, [0, len(x) - 1]]))
    keep = keep[keep < len(x)]
    return x[keep], y[keep]


def _runs(y: FloatArray) -> list[slice]:
    """Return the runs of finite values that are at least two points long, as slices of ``y`` (N,)."""
    is_finite = np.concatenate([[False], np.isfinite(y), [False]])
    edges = np.flatnonzero(is_finite[1:] != is_finite[:-1])
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a > 1]


_NEGATIVE_COLOUR = np.array([0.13, 0.36, 0.70])
"""Red, green, blue in 0..1 of a large negative deviation: too much is cut."""
_ZERO_COLOUR = np.array([0.93, 0.94, 0.93])
"""Red, green, blue in 0..1 of no deviation."""
_POSITIVE_COLOUR = np.array([0.78, 0.18, 0.13])
"""Red, green, blue in 0..1 of a large positive deviation: material remains."""
_UNROLLED_GRID = (1500, 41)
"""Number of points across and along the rulings of a ruled surface that is unrolled."""
MISSED_COLOUR = np.array([0.35, 0.13, 0.45])
"""Red, green, blue in 0..1 of points that the tool did not pass."""


@dataclasses.dataclass(frozen=True)
class FaceWords:
    """Words for a simulated face: the tool that passes it, and negative and positive deviations."""

    tool: str = "tool"
    negative: str = "too much cut"
    positive: str = "material left"

    @property
    def missing(self) -> str:
        """Words for missing deviations."""
        return f"the {self.tool} did not pass"


@dataclasses.dataclass(frozen=True)
class MapRulings:
    """Rulings of a face whose map is unrolled.

    Attributes:
        start: Starts (K, 3) [m].
        end: Ends (K, 3) [m].
        words: Description of the view of the map.
    """

    start: FloatArray
    end: FloatArray
    words: str


def plane_axes(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a plane to points, and return its horizontal axis, vertical axis and normal (3,) each.

    The vertical axis is the projection of the frame's z axis onto the plane, or of its y axis for a nearly
    horizontal plane. The largest component of the normal is positive.

    Args:
        points: Points (M, 3).
    """
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    normal = axes[2] * (1.0 if axes[2][np.argmax(np.abs(axes[2]))] > 0 else -1.0)
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    up = up - normal * (up @ normal)
    up /= np.linalg.norm(up)
    return np.cross(up, normal), up, normal


def diverging(value: FloatArray, span: float) -> FloatArray:
    """Map values to colours (..., 3): blue below zero, pale at zero, red above, saturated at ``span``."""
    t = np.clip(value / span, -1.0, 1.0)[..., None]
    weight = np.abs(t) ** 0.8  # an exponent below 1 makes small deviations visible
    return np.asarray(
        np.where(
            t < 0,
            _ZERO_COLOUR + weight * (_NEGATIVE_COLOUR - _ZERO_COLOUR),
            _ZERO_COLOUR + weight * (_POSITIVE_COLOUR - _ZERO_COLOUR),
        )
    )


def sequential(value: FloatArray) -> FloatArray:
    """Map values in 0..1 to colours (..., 3), dark blue over green to yellow (keys of the viridis map)."""
    key_colours = np.array(
        [[0.27, 0.0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38], [0.99, 0.91, 0.15]]
    )
    key_values = np.linspace(0.0, 1.0, len(key_colours))
    return np.stack([np.interp(value, key_values, key_colours[:, c]) for c in range(3)], axis=-1)


def bin_values(uv: FloatArray, value: FloatArray) -> tuple[FloatArray, tuple[float, float, float, float]]:
    """Bin values on a grid, with the value of the largest magnitude in each cell.

    A cell with a NaN is NaN. An empty cell takes the value of the nearest other cell if that is at most three
    cells away, else it is infinite.

    Args:
        uv: Coordinates (M, 2) [m].
        value: Values (M,).

    Returns:
        Grid (h, w) with rows from the largest v down, and its extent u0, u1, v0, v1 [m].
    """
    low, high = uv.min(axis=0), uv.max(axis=0)
    size = np.maximum(high - low, 1e-6)
    # twice the mean distance of the points, but at most 240 cells along the longer side
    cell_size = max(float(np.sqrt(size[0] * size[1] / max(len(uv), 1))) * 2.0, float(size.max()) / 240.0)
    shape = np.ceil(size / cell_size).astype(int) + 1
    column, row = ((uv - low) / cell_size).astype(int).T
    flat = (shape[1] - 1 - row) * shape[0] + column
    # in a cell the last assignment remains: that of NaN or of the largest magnitude
    order = np.argsort(np.where(np.isnan(value), np.inf, np.abs(value)), kind="stable")
    grid = np.full(shape[0] * shape[1], np.inf)
    grid[flat[order]] = value[order]
    grid = grid.reshape(shape[1], shape[0])
    empty = np.isposinf(grid)
    distance, nearest = ndimage.distance_transform_edt(empty, return_indices=True)
    filled = np.where(distance <= 3.0, grid[tuple(nearest)], np.inf)
    return filled, (
        float(low[0]),
        float(low[0] + shape[0] * cell_size),
        float(low[1]),
        float(low[1] + shape[1] * cell_size),
    )


def project_to_plane(points: FloatArray) -> tuple[FloatArray, str]:
    """Project points to their best-fit plane, with the clearly longer side horizontal.

    Args:
        points: Points (M, 3) [m] in the stock frame.

    Returns:
        Coordinates (M, 2) [m], and a description of the view direction.
    """
    across, up, normal = plane_axes(points)
    uv = points @ np.stack([across, up], axis=1)
    if np.ptp(uv[:, 1]) > 1.2 * np.ptp(uv[:, 0]):
        across, up = up, -across
        uv = points @ np.stack([across, up], axis=1)
    words = (
        f"seen from {_axis_name(normal)} of the stock frame, {_axis_name(across)} to the right, "
        f"{_axis_name(up)} up; mm"
    )
    return uv, words


def unroll(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the coordinates of points on an unrolled ruled surface.

    Each point takes the coordinates of the nearest point of a dense grid on the surface.

    Args:
        points: Points (M, 3) [m].
        start: Starts of the rulings (K, 3) [m].
        end: Ends of the rulings (K, 3) [m].

    Returns:
        Coordinates (M, 2) [m]: along the line of the rulings' middles, and along the rulings, which all
        have their mean length.
    """
    arc_length = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(0.5 * (start + end), axis=0), axis=1))]
    )
    samples = np.linspace(0.0, arc_length[-1], _UNROLLED_GRID[0])
    fraction = np.linspace(0.0, 1.0, _UNROLLED_GRID[1])
    low, high = (
        np.stack([np.interp(samples, arc_length, side[:, c]) for c in range(3)], axis=-1)
        for side in (start, end)
    )
    grid = low[:, None] + fraction[:, None] * (high - low)[:, None]
    _, nearest = cKDTree(grid.reshape(-1, 3)).query(points)
    row, column = np.divmod(nearest, _UNROLLED_GRID[1])
    length = float(np.linalg.norm(end - start, axis=1).mean())
    return np.stack([samples[row], length * fraction[column]], axis=1)


def colour_span(deviation: FloatArray, tolerance: float) -> float:
    """Return the deviation [m] at which the colours of a face are saturated.

    It covers all but the largest 0.5 % of the deviations, so that outliers do not make the others pale.

    Args:
        deviation: Deviations (M,) [m], NaN where unknown.
        tolerance: Tolerance [m].
    """
    finite = np.abs(deviation[np.isfinite(deviation)])
    largest = float(np.percentile(finite, 99.5)) if len(finite) else tolerance
    return max(1.15 * largest, 0.05 * tolerance)


def deviation_map(
    points: FloatArray,
    deviation: FloatArray,
    tolerance: float,
    title: Phrase,
    words: FaceWords,
    rulings: MapRulings | None = None,
) -> FigureBlock:
    """Draw a heat map [mm] of the deviations of a face.

    A face with ``rulings`` is unrolled. Other faces are seen along their normal.

    Args:
        points: Points (M, 3) [m].
        deviation: Deviations (M,) [m], NaN where the tool did not pass.
        tolerance: Tolerance [m].
        title: Title.
        words: Words for the face.
        rulings: Rulings, or None.
    """
    if rulings is None:
        uv, view_words = project_to_plane(points)
    else:
        uv, view_words = unroll(points, rulings.start, rulings.end), rulings.words
    span = colour_span(deviation, tolerance)
    grid, extent = bin_values(uv, deviation)
    missed = np.isnan(grid)
    color = diverging(np.where(np.isfinite(grid), grid, 0.0), span)
    color[missed] = MISSED_COLOUR
    alpha = np.where(np.isposinf(grid), 0.0, 1.0)
    field = _heat_map(markup.png(color, alpha), extent)
    return FigureBlock(
        title, BlockGroup((field, _scale_bar(span, tolerance, bool(missed.any()), words))), view_words
    )


def _axis_name(direction: FloatArray) -> str:
    """Return the name of the coordinate axis that is closest to a direction (3,), with its sign."""
    k = int(np.argmax(np.abs(direction)))
    return ("+" if direction[k] > 0 else "−") + "xyz"[k]


def histogram(deviation: FloatArray, tolerance: float) -> Drawing | Paragraph:
    """Draw a histogram of the deviations of a face [mm] in percent of its points, with the tolerance marked.

    Args:
        deviation: Deviations (M,) [m].
        tolerance: Tolerance [m].
    """
    finite = deviation[np.isfinite(deviation)] * 1e3
    if not len(finite):
        return _NO_DATA
    span = 1e3 * colour_span(deviation, tolerance)
    counts, edges = np.histogram(np.clip(finite, -span, span), bins=60, range=(-span, span))
    fraction = 100.0 * counts / max(len(deviation), 1)
    x, y = np.repeat(edges, 2)[1:-1], np.repeat(fraction, 2)
    inside = ChartBand(-tolerance * 1e3, tolerance * 1e3, "within tolerance", "link")
    return chart(
        [ChartLine("fraction", x, y, 0)],
        ChartAxes("deviation [mm]", "fraction [%]", (0.0, float(fraction.max()) * 1.08)),
        bands=[inside],
    )


def _heat_map(image: str, extent: tuple[float, float, float, float]) -> Drawing:
    """Draw an image, given as a data URL, over its extent u0, u1, v0, v1 [m] with scales in mm."""
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
    """Draw the colour scale of a map of deviations, from ``-span`` to ``span`` [m].

    The tolerance [m] is marked if it is within the scale. The legend explains both colours with the words of
    ``face``, and the colour of missing points if there are such points (``missed``).
    """
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
        # the number of a tolerance near an end of the scale would overlap the number of that end
        if abs(abs(value) - span) > 0.1 * span or abs(value) == span:
            parts.append(f'<text class="mid" x="{x:.1f}" y="24">{markup.number(value * 1e3, 2)}</text>')
        if abs(value) == tolerance:
            parts.append(f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="13"/>')
    parts.append("</svg>")
    words = [("#215cb2", face.negative), ("#c72e21", face.positive)]
    if missed:
        words.append(("#592173", face.missing))
    if tolerance > span:
        words.append(("transparent", f"tolerance ±{markup.number(tolerance * 1e3)} mm: beyond the scale"))
    keys = "".join(f'<span class="swatch" style="--s:{color}">{name}</span>' for color, name in words)
    return Drawing("".join(parts) + f'<div class="legend">{keys}</div>')


def value_map(points: FloatArray, value: FloatArray, limit: float | None, unit: str) -> BlockGroup:
    """Draw a heat map of values at points, seen along the normal of the points' best-fit plane.

    Args:
        points: Points (M, 3) [m] in the stock frame.
        value: Values (M,).
        limit: The colours diverge from 0 to at least this magnitude. None: from minimum to maximum.
        unit: Unit of the values.

    Raises:
        ValueError: The shapes of points and values do not match.
    """
    if points.shape != (len(value), 3):
        raise ValueError(f"points {points.shape} and value {value.shape} do not belong together")
    uv, view_words = project_to_plane(points)
    grid, extent = bin_values(uv, value)
    inside = np.isfinite(grid)
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    if limit is not None:
        span = max(float(limit), abs(low), abs(high))
        low, high = -span, span
        color = diverging(np.where(inside, grid, 0.0), span)
        bar_colours = diverging(np.linspace(-span, span, 200), span)
    else:
        color = sequential((np.where(inside, grid, low) - low) / max(high - low, 1e-12))
        bar_colours = sequential(np.linspace(0.0, 1.0, 200))
    image = markup.png(np.tile(bar_colours[None], (2, 1, 1)))
    key = Drawing(
        f'<svg class="plot" viewBox="0 0 440 24"><image href="{image}" x="90" y="6" width="260" height="9" '
        f'preserveAspectRatio="none"/><text class="ytick" x="84" y="14">{markup.number(low, 3)}</text>'
        f'<text x="356" y="14">{markup.number(high, 3)} {markup.phrase_html(unit)}</text></svg>'
    )
    field = _heat_map(markup.png(color, inside.astype(np.float64)), extent)
    return BlockGroup((field, key, Paragraph(view_words, "note")))
