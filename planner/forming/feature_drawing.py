"""Drawings of a feature tree: its contours from above, and the tree over the levels of its features."""

from __future__ import annotations

import html
from typing import Final

import numpy as np
import shapely

from planner.forming.feature_tree import Feature, FeatureTree
from planner.forming.values import FloatArray
from planner.units import MM

COLOURS: Final = 8
"""Colours c0 to c7 of the report's style sheet; features take them in turn."""
PRINTED: Final = (
    *("#1f6fb4", "#d9662b", "#2a9461", "#8e5bb5"),
    *("#b8912a", "#c4497f", "#3aa5a0", "#6b7686"),
)
"""The same on white, for a drawing without the style sheet."""
LOOPS: Final = 24
"""Contours drawn of one feature, at most: more run into each other."""
FINE: Final = 0.15
"""Contours are drawn with points left out up to this far from the line, in units of the drawing."""
WIDE: Final = 760.0


def plan(tree: FeatureTree) -> str:
    """Contours of all features from above as SVG: the sheet's x to the right and y up; dashed ones go up."""
    every = np.concatenate([feature.region for feature in tree.features])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.04 * float((high - low).max())
    low, high = low - margin, high + margin
    scale = WIDE / float(high[0] - low[0])
    tall = scale * float(high[1] - low[1])
    parts = [
        f'<svg class="plot" viewBox="0 0 {WIDE:.0f} {tall:.0f}" role="img" aria-label="contours from above">'
    ]
    for feature in tree.features:
        dashed = " dashed" if feature.sign > 0 else ""
        parts.append(f'<g class="thin c{feature.id % COLOURS}{dashed}">')
        parts.append(f"<title>{html.escape(_told(feature))}</title>")
        parts += [f'<path d="{_path((line[:, :2] - low) * scale, tall)}"/>' for line in _some(feature)]
        parts.append("</g>")
    for feature in tree.features:
        x, y = (np.array(shapely.Polygon(feature.region).exterior.interpolate(0.0).coords[0]) - low) * scale
        parts.append(f'<text x="{x + 4:.1f}" y="{tall - y - 4:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def diagram(tree: FeatureTree) -> str:
    """The tree as SVG: a bar for each feature from its start to its end, joined to its parent."""
    levels = [tree.level, *(value for feature in tree.features for value in (feature.start, feature.end))]
    low, high = min(levels), max(levels)
    tall, left, top = 260.0, 64.0, 24.0
    step = min((WIDE - left - 20.0) / len(tree.features), 90.0)

    def down(level: float) -> float:
        return top + (high - level) / (high - low) * tall

    parts = [
        f'<svg class="plot" viewBox="0 0 {WIDE:.0f} {tall + 2 * top:.0f}" role="img" '
        f'aria-label="feature tree"><line class="axis" x1="{left}" x2="{WIDE - 10}" '
        f'y1="{down(tree.level):.1f}" y2="{down(tree.level):.1f}"/>',
    ]
    for level in sorted({round(value / MM, 1) for value in levels}):
        y = down(level * MM) + 4
        parts.append(f'<text class="ytick" x="{left - 6}" y="{y:.1f}">{level + 0.0:g} mm</text>')
    for feature in tree.features:
        x, begin, end = left + (feature.id - 0.5) * step, down(feature.start), down(feature.end)
        colour = feature.id % COLOURS
        if feature.parent is not None:
            from_x = left + (feature.parent - 0.5) * step
            parts.append(
                f'<line class="axis" x1="{from_x:.1f}" x2="{x:.1f}" y1="{begin:.1f}" y2="{begin:.1f}"/>'
            )
        parts.append(
            f'<rect style="fill:var(--c{colour})" x="{x - 6:.1f}" width="12" y="{min(begin, end):.1f}" '
            f'height="{max(abs(end - begin), 1.0):.1f}"><title>{html.escape(_told(feature))}</title></rect>'
        )
        y = end + 14.0 if feature.sign < 0 else end - 6.0
        parts.append(f'<text class="mid" x="{x:.1f}" y="{y:.1f}">{feature.id}</text>')
    return "".join([*parts, "</svg>"])


def page(tree: FeatureTree, title: str) -> str:
    """One HTML file with both drawings and a table; it needs nothing else."""
    from planner.report.style import CSS

    rows = "".join(
        f"<tr><td>{f.id}</td><td>{f.parent or '–'}</td><td>{f.kind}</td><td>{f.start / MM:z.3f}</td>"
        f"<td>{f.end / MM:z.3f}</td><td>{len(f.contours)}</td></tr>"
        for f in tree.features
    )
    name = html.escape(title)
    notes = "".join(f'<p class="note">{html.escape(str(issue))}</p>' for issue in tree.issues)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{name}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{CSS}</style><main><h1>{name}</h1>'
        f'<p class="soft">{len(tree.features)} features, sliced every {tree.step / MM:g} mm; '
        f"the flat sheet is at z = {tree.level / MM:z.3f} mm. "
        f"Solid: down (concave), dashed: up (convex).</p>{notes}"
        f"<section><h2>Contours from above</h2>{plan(tree)}</section>"
        f"<section><h2>Tree over the level</h2>{diagram(tree)}</section><section><h2>Features</h2>"
        "<table><tr><th>id</th><th>on</th><th>kind</th><th>start mm</th><th>end mm</th><th>contours</th></tr>"
        f"{rows}</table></section></main></html>\n"
    )


def alone(tree: FeatureTree) -> str:
    """The contours from above as an SVG file of its own, with its colours in it."""
    rules = [".thin{fill:none;stroke-width:1}", ".dashed{stroke-dasharray:4 3}", "text{font:11px sans-serif}"]
    rules += [f".c{index}{{stroke:{colour}}}" for index, colour in enumerate(PRINTED)]
    start, rest = plan(tree).split(">", 1)
    named = start.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"')
    return f"{named}><style>{''.join(rules)}</style>{rest}\n"


def _some(feature: Feature) -> list[FloatArray]:
    count = len(feature.contours)
    chosen = np.unique(np.linspace(0, count - 1, min(count, LOOPS)).round().astype(int))
    return [feature.contours[index] for index in chosen]


def _path(points: FloatArray, tall: float) -> str:
    line = shapely.LineString(points).simplify(FINE)
    pairs = (f"{x:.1f} {tall - y:.1f}" for x, y in shapely.get_coordinates(line)[:-1])
    return "M" + "L".join(pairs) + "Z"


def _told(feature: Feature) -> str:
    on = "the flat sheet" if feature.parent is None else f"feature {feature.parent}"
    name = f"feature {feature.id} on {on}: {feature.kind}"
    return f"{name}, {feature.start / MM:z.2f} to {feature.end / MM:z.2f} mm"
