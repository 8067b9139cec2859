"""Drawing of ``Targets.exhibits`` by kind, independent of the process.

An exhibit is a mapping of arrays and plain data with ``kind`` and ``title`` (``note`` optional):

- ``sections``: ``curves`` (S, P, 3) or a sequence of (P, 3) [m] in the stock frame. Optional: ``wanted`` of
  the same form, and ``value`` (S,), ``value_name``, ``unit``, which colour the curves. Drawn in space
  within the block, and superimposed in their planes.
- ``paths``: ``curves``: sequence of (P, 3) [m] in the stock frame, drawn in space, coloured in their order
  or by ``value`` (S,) with the name ``value_name``. Optional: ``points`` (M, 3) [m], drawn as dots, and
  ``near``: zoom to the curves instead of the block.
- ``curve``: ``x`` (N,), ``x_label``, ``y_label``; ``series``: sequence of {``name``, ``y`` (N,), own ``x``,
  shared ``colour``, ``style``: "dashed" or "dots"}. Optional: ``limits``: sequence of {``name``,
  ``value``}, and ``equal``: one scale.
- ``table``: ``columns``: names; ``rows``: sequence of sequences.
- ``facts``: ``items``: sequence of (name, value) or (name, value, unit).
- ``setup``: as ``facts``, shown in the setup sheet: what an operator mounts, cuts, sets or measures.
- ``heatmap``: ``points`` (M, 3) [m], ``value`` (M,), ``unit``. With ``limit`` the colours diverge from 0 up
  to it.
- ``released``: a formed sheet over a grid: ``x`` (W,), ``y`` (H,) [m]; heights (H, W) [m] ``formed`` under
  the tools and ``released``; ``deviation`` (H, W) from the nominal part, NaN where unknown; ``limit``: end
  of its scale; ``unit``. The replay shows both surfaces.
- ``mesh``: ``vertices`` (V, 3) [m], ``faces`` (F, 3): a shaded picture.
- ``left``: as ``mesh``, the stock that remains after an operation. The replay shows it from then on.
- ``tree``: ``nodes``: names; ``parent``: for each node the index of its parent, -1 for a root.
- ``text``: ``text``: a paragraph.

An exhibit of another form gives an issue ``report.exhibit`` and is left out of the report.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import FloatArray
from planner.issue_codes import format_message
from planner.issues import Issue, Severity
from planner.report import charts, markup, raster
from planner.report.markup import Block, Drawing, Phrase

_MAX_CURVES = 60
"""Maximum number of drawn curves of one exhibit, evenly chosen."""


def in_space(
    curves: Sequence[FloatArray], value: FloatArray, block: FloatArray, points: FloatArray | None = None
) -> Drawing:
    """Draw curves in a parallel view from above, with the edges of the block. Hidden edges are dashed.

    Args:
        curves: S curves (P, 3) [m] in the stock frame, of which at most 60 are drawn.
        value: Values (S,) that colour the curves.
        block: Lowest and highest corner of the block (2, 3) [m].
        points: Points (M, 3) [m] drawn as dots, or None.
    """
    block_size = block[1] - block[0]
    view_direction = (
        np.array([-0.62, 1.0, -0.55]) if block_size[1] <= block_size[0] else np.array([-1.0, 0.62, -0.55])
    )
    z = view_direction / np.linalg.norm(view_direction)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x)], axis=1)
    corners = np.array(
        [[block[i, 0], block[j, 1], block[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    projected = [curve @ axes for curve in curves]
    everything = np.concatenate([*projected, corners @ axes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    scale = min(500.0 / (high[0] - low[0]), 300.0 / (high[1] - low[1]))
    size_px = (high - low) * scale + 24.0
    parts = [f'<svg class="plot" viewBox="0 0 {size_px[0]:.0f} {size_px[1]:.0f}" style="max-height:340px">']
    hidden_corner = int(np.argmax(corners @ z))  # the farthest one: its three edges are behind the block
    for a in range(8):
        for b in range(a + 1, 8):
            # an edge joins two corners that differ in one coordinate
            if np.count_nonzero(np.abs(corners[a] - corners[b]) > 1e-12) == 1:
                p, q = ((corners[[a, b]] @ axes) - low) * scale + 12.0
                back = " back" if hidden_corner in (a, b) else ""
                parts.append(
                    f'<line class="edge{back}" x1="{p[0]:.1f}" y1="{p[1]:.1f}" '
                    f'x2="{q[0]:.1f}" y2="{q[1]:.1f}"/>'
                )
    colors = _colours(value)
    for i in _even_indices(len(curves)):
        drawn_points = " ".join(f"{u:.1f},{v:.1f}" for u, v in (projected[i] - low) * scale + 12.0)
        parts.append(f'<polyline class="thin" style="stroke:{colors[i]}" points="{drawn_points}"/>')
    if points is not None:
        for u, v in (points @ axes - low) * scale + 12.0:
            parts.append(f'<circle class="dot" cx="{u:.1f}" cy="{v:.1f}" r="2.6"/>')
    parts.append("</svg>")
    return Drawing("".join(parts))


def in_plane(curves: Sequence[FloatArray], nominal: Sequence[FloatArray], value: FloatArray) -> Drawing:
    """Draw curves on top of each other [mm], each in its own plane, to compare their shapes.

    The chord of each curve is along x, with its middle at 0. The plane of a curve contains its chord, and is
    perpendicular to the path from one curve to the next. Low curves are drawn with exaggerated heights.

    Args:
        curves: S curves (P, 3) [m].
        nominal: Nominal curves (P, 3) [m], which are dashed. They are drawn only if there are S of them.
        value: Values (S,) that colour the curves.
    """
    centroids = np.array([c.mean(axis=0) for c in curves])
    sweep = np.gradient(centroids, axis=0) if len(curves) > 1 else np.array([[0.0, 0.0, 1.0]])
    frames: list[tuple[FloatArray, FloatArray]] = []
    for i, curve in enumerate(curves):
        origin, axes = _plane(curve, sweep[i])
        is_flipped = bool(frames) and float(axes[:, 1] @ frames[-1][1][:, 1]) < 0.0
        frames.append((origin, axes * [1.0, -1.0] if is_flipped else axes))
    with_frames = zip(curves, frames, strict=True)
    width, rise = np.ptp(np.concatenate([(c - origin) @ axes for c, (origin, axes) in with_frames]), axis=0)
    # smallest factor with which the curves are higher than 0.22 of their width
    exaggeration = next((k for k in (1, 2, 5, 10) if rise * k > 0.22 * width), 10)
    stretch = np.array([1e3, 1e3 * exaggeration])
    styled_curves: list[tuple[FloatArray, str]] = []
    colors = _colours(value)
    for i in _even_indices(len(curves)):
        origin, axes = frames[i]
        styled_curves.append((((curves[i] - origin) @ axes) * stretch, f"stroke:{colors[i]}"))
        if len(nominal) == len(curves):
            styled_curves.append(
                (((nominal[i] - origin) @ axes) * stretch, "stroke:var(--soft);stroke-dasharray:2 3")
            )
    everything = np.concatenate([d for d, _ in styled_curves])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.05 * max(high - low)
    low, high = low - margin, high + margin
    scale = min(470.0 / (high[0] - low[0]), 290.0 / (high[1] - low[1]))
    height = (high[1] - low[1]) * scale
    parts = [f'<svg class="plot" viewBox="0 0 540 {height + 40:.0f}">']
    for v in charts.ticks(low[0], high[0], 6):
        x = 52 + (v - low[0]) * scale
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{height + 4:.1f}"/>')
        parts.append(
            f'<text class="xtick" x="{x:.1f}" y="{height + 20:.1f}">{markup.number(float(v))}</text>'
        )
    for v in exaggeration * charts.ticks(
        low[1] / exaggeration, high[1] / exaggeration, int(np.clip(height / 40, 2, 6))
    ):
        y = 4 + (high[1] - v) * scale
        right = 52 + (high[0] - low[0]) * scale
        parts.append(f'<line class="grid" x1="52" x2="{right:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(
            f'<text class="ytick" x="46" y="{y + 4:.1f}">{markup.number(float(v) / exaggeration)}</text>'
        )
    axis_label = "mm" if exaggeration == 1 else f"mm; heights drawn {exaggeration} times"
    for path, style in styled_curves:
        uv = np.stack([52 + (path[:, 0] - low[0]) * scale, 4 + (high[1] - path[:, 1]) * scale], axis=1)
        points = " ".join(f"{u:.1f},{v:.1f}" for u, v in uv)
        parts.append(f'<polyline class="thin" style="{style}" points="{points}"/>')
    parts.append(
        f'<text class="mid" x="{52 + 0.5 * (high[0] - low[0]) * scale:.0f}" '
        f'y="{height + 36:.0f}">{axis_label}</text></svg>'
    )
    return Drawing("".join(parts))


def colour_key(value: FloatArray, name: str) -> Drawing:
    """Draw a bar that shows which colour stands for which value.

    Args:
        value: Values.
        name: Name of the values.
    """
    image = markup.png(np.tile(charts.sequential(np.linspace(0.18, 0.92, 160))[None], (2, 1, 1)))
    low, high = (markup.number(float(v), 3) for v in (value.min(), value.max()))
    return Drawing(
        '<svg class="plot" viewBox="0 0 540 22"><text class="ytick" x="150" y="12">'
        f'{low}</text><image href="{image}" x="158" y="4" width="224" height="8" preserveAspectRatio="none"/>'
        f'<text x="390" y="12">{high} · {markup.phrase_html(name)}</text></svg>'
    )


def _plane(curve: FloatArray, sweep: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the plane of a section: the middle (3,) of its chord, and its axes (3, 2).

    The first axis is along the chord, the second one across it and perpendicular to ``sweep`` (3,), the
    direction from section to section. A closed curve has as chord the line to its middle point.
    """
    chord = curve[-1] - curve[0]
    if np.linalg.norm(chord) < 1e-9:
        chord = curve[len(curve) // 2] - curve[0]
    x = chord / np.linalg.norm(chord)
    y = np.cross(sweep, x)
    if np.linalg.norm(y) < 1e-9 * max(float(np.linalg.norm(sweep)), 1e-12) or not np.linalg.norm(sweep):
        y = np.cross([0.0, 0.0, 1.0], x) if abs(x[2]) < 0.9 else np.cross([0.0, 1.0, 0.0], x)
    y = y / np.linalg.norm(y)
    if y[np.argmax(np.abs(y))] < 0:
        y = -y
    return 0.5 * (curve[0] + curve[-1]), np.stack([x, y], axis=1)


def _even_indices(count: int) -> list[int]:
    """Return at most `_MAX_CURVES` evenly spaced indices of ``count`` curves."""
    return sorted({round(i) for i in np.linspace(0, count - 1, min(count, _MAX_CURVES))})


def _colours(value: FloatArray) -> list[str]:
    """Return CSS colours for values (S,), from the smallest to the largest one of them."""
    span = float(np.ptp(value)) or 1.0
    rgb = charts.sequential(0.18 + 0.74 * (value - value.min()) / span) * 255.0
    return [f"rgb({r:.0f} {g:.0f} {b:.0f})" for r, g, b in rgb]


UNIT_BLOCK: Final = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
"""Corners of the block for exhibits without one."""
_HALF_WIDTH_COLUMNS = 6
"""Maximum number of columns of a table of half width."""


def draw(exhibits: Mapping[str, Any], block: FloatArray) -> tuple[list[Block], list[Issue]]:
    """Draw all exhibits except those of the setup sheet, which are only checked.

    Args:
        exhibits: Exhibits by name.
        block: Lowest and highest corner (2, 3) [m] of the block as the operation finds it.

    Returns:
        Figures, and issues for exhibits that cannot be drawn.
    """
    figures: list[Block] = []
    issues: list[Issue] = []
    for name, exhibit in exhibits.items():
        kind = exhibit.get("kind") if isinstance(exhibit, Mapping) else None
        try:
            if kind == "setup":
                _items(exhibit["items"])
                continue
            figures.append(_DRAWERS[str(kind)](exhibit, block))
        except (KeyError, TypeError, ValueError, IndexError, np.linalg.LinAlgError) as error:
            issues.append(_undrawable(name, kind, error))
    return figures, issues


def exhibits_page(
    title: str,
    section: tuple[str, str],
    shown: Mapping[str, Any],
    about: str,
    block: FloatArray = UNIT_BLOCK,
    name: str = "",
) -> str:
    """Return an HTML page with nothing but exhibits. Exhibits that cannot be drawn are left out.

    Args:
        title: Title of the page.
        section: Anchor and title of its only section.
        shown: Exhibits by name.
        about: Description of the page.
        block: Lowest and highest corner of the block (2, 3) [m], for exhibits that are drawn in it.
        name: Heading of the page, by default its title.
    """
    figures, _ = draw(shown, block)
    sections = (markup.PageSection(*section, (markup.GridBlock(tuple(figures)),)),)
    return markup.page_html(markup.Page(title, name or title, (), markup.Paragraph(about), (), sections))


def setup_items(exhibits: Mapping[str, Any]) -> list[tuple[Phrase, Phrase]]:
    """Return names and values of all valid exhibits of kind ``setup``."""
    out: list[tuple[Phrase, Phrase]] = []
    for exhibit in exhibits.values():
        if isinstance(exhibit, Mapping) and exhibit.get("kind") == "setup":
            with contextlib.suppress(KeyError, TypeError, ValueError):  # draw() reports these
                out += _items(exhibit["items"])
    return out


def _undrawable(name: str, kind: Any, error: Exception) -> Issue:
    """Return the issue about an exhibit that cannot be drawn because of an error."""
    return Issue(
        "report.exhibit",
        format_message(
            "report.exhibit",
            name=name,
            kind=kind,
            error_type=type(error).__name__,
            error=error,
            allowed_kinds=", ".join((*_DRAWERS, "setup")),
        ),
        Severity.WARNING,
        field=name,
    )


def _items(items: Sequence[Any]) -> list[tuple[Phrase, Phrase]]:
    """Return names and values of items (name, value) or (name, value, unit), the value with its unit."""
    out = []
    for item in items:
        name, value, unit = (*item, "")[:3]
        out.append((name, markup.JoinedPhrases((value, " ", unit)) if unit else value))
    return out


def _titled_figure(exhibit: Mapping[str, Any], content: Block) -> markup.FigureBlock:
    """Wrap the drawing of an exhibit with its title and note."""
    return markup.FigureBlock(exhibit["title"], content, exhibit.get("note", ""))


def _paths(exhibit: Mapping[str, Any], block: FloatArray) -> Block:
    """Draw curves in space with their colour key, and dots at points."""
    curves = [np.asarray(c, dtype=np.float64) for c in exhibit["curves"]]
    value = np.asarray(exhibit.get("value", np.arange(len(curves))), dtype=np.float64)
    points = np.asarray(exhibit.get("points", np.zeros((0, 3))), dtype=np.float64)
    if exhibit.get("near"):
        all_points = np.concatenate(curves)
        block = np.array([all_points.min(axis=0), all_points.max(axis=0)])
    key = colour_key(value, str(exhibit.get("value_name", "in order")))
    return _titled_figure(exhibit, markup.BlockGroup((in_space(curves, value, block, points), key)))


def _sections(exhibit: Mapping[str, Any], block: FloatArray) -> Block:
    """Draw curves in space, and superimposed in their planes next to it."""
    curves = [np.asarray(c, dtype=np.float64) for c in exhibit["curves"]]
    nominal = [np.asarray(c, dtype=np.float64) for c in exhibit.get("wanted", ())]
    value = exhibit.get("value")
    value = np.arange(len(curves), dtype=np.float64) if value is None else np.asarray(value, dtype=np.float64)
    name = f"{exhibit.get('value_name', 'section')} [{exhibit['unit']}]" if exhibit.get("unit") else "section"
    space = in_space(curves, value, block)
    plane = in_plane(curves, nominal, value)
    key = colour_key(value, name)
    left = markup.FigureBlock(exhibit["title"], markup.BlockGroup((space, key)))
    right = markup.FigureBlock("In their planes", plane, exhibit.get("note", ""))
    return markup.Wide(markup.GridBlock((left, right)))


def _curve(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    """Draw a line chart. A series without an own ``x`` uses that of the exhibit."""
    x = exhibit.get("x")
    lines = [
        charts.ChartLine(
            str(item["name"]),
            np.asarray(item.get("x", x), dtype=np.float64),
            np.asarray(item["y"], dtype=np.float64),
            int(item.get("colour", i)),
            dashed=item.get("style") == "dashed",
            dots=item.get("style") == "dots",
        )
        for i, item in enumerate(exhibit["series"])
    ]
    levels = [charts.LimitLine(float(v["value"]), str(v["name"])) for v in exhibit.get("limits", ())]
    body = charts.chart(
        lines,
        charts.ChartAxes(
            x_label=str(exhibit.get("x_label", "")),
            y_label=str(exhibit.get("y_label", "")),
            equal=bool(exhibit.get("equal", False)),
        ),
        levels=levels,
    )
    return _titled_figure(exhibit, body)


def _table(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    columns = tuple(exhibit["columns"])
    drawn = _titled_figure(exhibit, markup.make_table(columns, exhibit["rows"]))
    return markup.Wide(drawn) if len(columns) > _HALF_WIDTH_COLUMNS else drawn


def _facts(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    return _titled_figure(exhibit, markup.FactsBlock(tuple(_items(exhibit["items"]))))


def _heatmap(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    points, value = np.asarray(exhibit["points"]), np.asarray(exhibit["value"], dtype=np.float64)
    body = charts.value_map(points, value, exhibit.get("limit"), str(exhibit.get("unit", "")))
    return _titled_figure(exhibit, body)


def _released(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    """Draw the deviations of a released sheet as a heat map over its surface."""
    x, y = np.meshgrid(exhibit["x"], exhibit["y"])
    points = np.stack([x, y, np.asarray(exhibit["released"])], axis=-1).reshape(-1, 3)
    value = np.asarray(exhibit["deviation"], dtype=np.float64).ravel()
    body = charts.value_map(points, value, exhibit["limit"], str(exhibit.get("unit", "")))
    return _titled_figure(exhibit, body)


def _mesh(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    """Draw a shaded picture of a mesh, seen obliquely from above."""
    vertices = np.asarray(exhibit["vertices"], dtype=np.float64)
    solid = raster.mesh(vertices, np.asarray(exhibit["faces"], dtype=np.int64), smooth=True)
    camera = raster.frame_camera(vertices, np.array([-0.55, 1.0, -0.55]), 1000, 640)
    image = raster.render_items(camera, [raster.RenderItem(solid, (0.55, 0.68, 0.74), 0.0, closed=False)])
    image_url = markup.png(image.color, np.isfinite(image.depth).astype(np.float64))
    return _titled_figure(exhibit, markup.Photo(image_url, str(exhibit["title"])))


def _tree(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    """Draw a tree from the index of each node's parent. A cycle, or depth above 64, raises ValueError."""
    parents = [int(p) for p in exhibit["parent"]]
    names = list(exhibit["nodes"])
    if len(names) != len(parents):
        raise ValueError(f"{len(names)} nodes but {len(parents)} parents")

    def subtree(parent: int, depth: int) -> markup.TreeBlock:
        """Return the descendants of a node, of all nodes for -1."""
        if depth > 64:
            raise ValueError("the tree has a cycle or is deeper than 64")
        children = [i for i, p in enumerate(parents) if p == parent]
        return markup.TreeBlock(tuple((names[i], subtree(i, depth + 1)) for i in children))

    return _titled_figure(exhibit, subtree(-1, 0))


def _text(exhibit: Mapping[str, Any], _: FloatArray) -> Block:
    return _titled_figure(exhibit, markup.Paragraph(exhibit["text"]))


_DRAWERS: Final[Mapping[str, Callable[[Mapping[str, Any], FloatArray], Block]]] = {
    "paths": _paths,
    "sections": _sections,
    "curve": _curve,
    "table": _table,
    "facts": _facts,
    "heatmap": _heatmap,
    "released": _released,
    "mesh": _mesh,
    "left": _mesh,
    "tree": _tree,
    "text": _text,
}
"""Functions that draw each kind of exhibit in the block of an operation."""
