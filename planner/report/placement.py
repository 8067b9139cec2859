"""The search for a place of the stock, from ``metrics["placement"]``.

Read are ``positions`` (K, 2 or 3) [m] and ``score`` (K,) (greater is better, not finite: not feasible), with
``chosen`` (index), ``unit`` and ``name`` of the score where given.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.plans import Plan
from planner.report import charts, heatmap, markup
from planner.report.markup import Raw

FloatArray = NDArray[np.float64]


def figures(plan: Plan) -> Raw:
    """Map of the places tried and the best score over the search; nothing where no search was made."""
    found = [plan.metrics, *(op.metrics for op in plan.operations)]
    searches = [m["placement"] for m in found if isinstance(m.get("placement"), Mapping)]
    shown = [s for s in searches if {"positions", "score"} <= set(s) and np.size(s["score"])]
    return Raw("".join(_search(search) for search in shown[:1]))


def _search(search: Mapping[str, Any]) -> Raw:
    places = np.asarray(search["positions"], dtype=np.float64)
    score = np.asarray(search["score"], dtype=np.float64)
    score = np.where(np.isfinite(score), score, np.nan)
    name = str(search.get("name", "score"))
    unit = f" [{search['unit']}]" if search.get("unit") else ""
    best = np.fmax.accumulate(score) if np.isfinite(score).any() else score
    step = np.arange(len(score), dtype=np.float64)
    course = charts.chart(
        [charts.Line("tried", step, score, 7), charts.Line("best so far", step, best, 2)],
        x_label="place tried",
        y_label=f"{name}{unit}",
    )
    chosen = search.get("chosen")
    index = int(chosen) if chosen is not None else None
    note = f"{len(score)} places tried, {int(np.isfinite(score).sum())} of them feasible"
    return markup.grid(
        [
            markup.figure("Places tried, from above", _map(places, score, index), note),
            markup.figure("Course of the search", course),
        ]
    )


def _map(places: FloatArray, score: FloatArray, chosen: int | None) -> str:
    low, high = places[:, :2].min(axis=0), places[:, :2].max(axis=0)
    span = np.maximum(high - low, 1e-3)
    scale = float(min(440.0 / span[0], 260.0 / span[1]))
    height = span[1] * scale + 30
    good = np.isfinite(score)
    low_score = float(np.nanmin(score)) if good.any() else 0.0
    range_ = max(float(np.nanmax(score)) - low_score, 1e-12) if good.any() else 1.0
    shade = heatmap.sequential(np.where(good, (score - low_score) / range_, 0.0)) * 255.0
    parts = [f'<svg class="plot" viewBox="0 0 540 {height + 26:.0f}">']
    for v in charts.ticks(low[0] * 1e3, high[0] * 1e3 + 1e-9, 6):
        x = 60 + (v * 1e-3 - low[0]) * scale
        parts.append(f'<text class="xtick" x="{x:.1f}" y="{height + 8:.1f}">{markup.number(float(v))}</text>')
    for v in charts.ticks(low[1] * 1e3, high[1] * 1e3 + 1e-9, 5):
        y = 10 + (high[1] - v * 1e-3) * scale
        parts.append(f'<text class="ytick" x="46" y="{y + 4:.1f}">{markup.number(float(v))}</text>')
    for i in np.argsort(np.where(good, score, -np.inf)):
        x = 60 + (places[i, 0] - low[0]) * scale
        y = 10 + (high[1] - places[i, 1]) * scale
        r, g, b = shade[i]
        look = f'fill="rgb({r:.0f} {g:.0f} {b:.0f})"' if good[i] else 'fill="none" stroke="var(--soft)"'
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" {look}/>')
    if chosen is not None:
        x = 60 + (places[chosen, 0] - low[0]) * scale
        y = 10 + (high[1] - places[chosen, 1]) * scale
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="var(--bad)" stroke-width="2"/>'
        )
        parts.append(f'<text x="{x + 12:.1f}" y="{y - 8:.1f}">chosen</text>')
    return (
        "".join(parts)
        + f'<text class="mid" x="280" y="{height + 24:.0f}">x, y in the world [mm]</text></svg>'
    )
