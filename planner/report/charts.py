"""Line charts as inline SVG in the page's colours, light or dark; the page's script reads values off them."""

from __future__ import annotations

import dataclasses
import html
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
_LEFT: Final = 52.0
_RIGHT: Final = 12.0
_TOP: Final = 10.0
_BOTTOM: Final = 34.0
_COLUMNS: Final = 420


@dataclasses.dataclass(frozen=True)
class Line:
    """One curve: x, y (N,), NaN where there is none; ``color`` 0..7 of the page's palette."""

    name: str
    x: FloatArray
    y: FloatArray
    color: int = 0
    dashed: bool = False


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
) -> str:
    """An SVG line chart with axes, limits, tinted bands and a legend; ``equal`` gives both axes one scale.

    Curves of more points than the picture has columns keep the least and greatest value of each column.
    """
    finite = [line for line in lines if np.isfinite(line.y).any()]
    if not finite:
        return '<p class="empty">no data</p>'
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
    return "".join(parts) + (f'<div class="legend">{"".join(keys)}</div>' if len(finite) > 1 else "")


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
