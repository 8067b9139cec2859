"""Exhibits are drawn by kind. A malformed one is reported and left out. Maps and charts keep the extremes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.report import charts, exhibits, markup

BLOCK = np.array([[-0.3, -0.05, 0.0], [0.3, 0.05, 0.4]])
S = np.linspace(0.0, 1.0, 30)
CURVES = np.stack([np.stack([S, 0.1 * k * S * (1 - S), 0 * S + 0.1 * k], axis=1) for k in range(4)])
GOOD = {
    "sections": {
        "kind": "sections",
        "title": "a",
        "curves": CURVES,
        "wanted": CURVES,
        "value": np.arange(4.0),
    },
    "straight": {"kind": "sections", "title": "s", "curves": (CURVES[0],)},
    "paths": {"kind": "paths", "title": "p", "curves": (CURVES[0], CURVES[1][:5])},
    "curve": {
        "kind": "curve",
        "title": "b",
        "x": S,
        "x_label": "x",
        "y_label": "y",
        "series": ({"name": "n", "y": S**2},),
        "limits": ({"name": "most", "value": 0.8},),
        "equal": True,
    },
    "table": {"kind": "table", "title": "c", "columns": ("k", "v"), "rows": (("a", 1.5), ("b", None))},
    "facts": {"kind": "facts", "title": "d", "items": (("length", 870.2, "mm"), ("wire", "Kanthal"))},
    "setup": {"kind": "setup", "title": "e", "items": (("cold length", 868.0, "mm"),)},
    "heat": {
        "kind": "heatmap",
        "title": "f",
        "points": CURVES.reshape(-1, 3),
        "value": np.arange(120.0),
        "unit": "mm",
    },
    "diverging": {
        "kind": "heatmap",
        "title": "g",
        "points": CURVES.reshape(-1, 3),
        "value": np.linspace(-1, 1, 120),
        "limit": 0.5,
    },
    "mesh": {
        "kind": "mesh",
        "title": "h",
        "vertices": np.eye(4)[:, :3],
        "faces": np.array([[0, 1, 2], [0, 1, 3]]),
    },
    "tree": {"kind": "tree", "title": "i", "nodes": ("root", "left", "right"), "parent": (-1, 0, 0)},
    "text": {"kind": "text", "title": "j", "text": "1 < 2"},
}


def test_every_kind_is_drawn_in_order() -> None:
    figures, issues = exhibits.draw(GOOD, BLOCK)
    assert issues == []
    titles = [re.findall(r"<figcaption>(\w)</figcaption>", markup.render(figure)) for figure in figures]
    assert [title for found in titles for title in found[:1]] == list("aspbcdfghij")
    assert exhibits.setup_items(GOOD)[0][0] == "cold length"


@pytest.mark.parametrize(
    "bad",
    [
        {"kind": "sculpture", "title": "x"},
        {"title": "no kind"},
        "not a mapping",
        {"kind": "curve", "title": "x"},
        {"kind": "setup", "title": "x", "items": (("name",),)},
        {"kind": "heatmap", "title": "x", "points": np.zeros((3, 3)), "value": np.zeros(2)},
        {"kind": "tree", "title": "x", "nodes": ("a", "b"), "parent": (-1,)},
        {"kind": "mesh", "title": "x", "vertices": np.zeros((2, 3)), "faces": np.array([[0, 1, 7]])},
    ],
)
def test_a_malformed_exhibit_is_named_and_left_out(bad: object) -> None:
    figures, issues = exhibits.draw({"good": GOOD["table"], "bad": bad, "also": GOOD["text"]}, BLOCK)
    assert len(figures) == 2
    assert [issue.code for issue in issues] == ["report.exhibit"]
    assert issues[0].field == "bad"


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_are_round_and_inside(low: float, span: float) -> None:
    result = charts.ticks(low, low + span, 5)
    assert 2 <= len(result) <= 12
    step = result[1] - result[0]
    slack = 1e-6 * span + 1e-9 * abs(low)
    assert result[0] >= low - slack and result[-1] <= low + span + slack
    digits = step / 10.0 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(digits - d) for d in (1.0, 2.0, 2.5, 5.0, 10.0)) < 1e-3 * 10


def test_long_curves_keep_their_peaks() -> None:
    y = np.sin(np.linspace(0, 300, 50_000))
    y[31_234] = 9.0
    y[777] = -7.0
    text = markup.render(
        charts.chart([charts.ChartLine("y", np.arange(50_000.0), y)], charts.ChartAxes("", ""))
    )
    match = re.search(r'points="([^"]*)"', text)
    assert match is not None
    heights = np.array([float(p.split(",")[1]) for p in match.group(1).split()])
    bottom, top, y0, y1 = (float(v) for v in re.search(r'data-y="([^"]*)"', text).group(1).split())  # type: ignore[union-attr]
    values = y0 + (bottom - heights) / (bottom - top) * (y1 - y0)
    assert values.max() == pytest.approx(9.0, abs=0.1) and values.min() == pytest.approx(-7.0, abs=0.1)
    assert len(heights) < 2000


def test_gaps_split_a_curve() -> None:
    y = np.array([0.0, 1.0, np.nan, 1.0, 0.0])
    chart = charts.chart([charts.ChartLine("y", np.arange(5.0), y)], charts.ChartAxes("", ""))
    assert markup.render(chart).count("<polyline") == 2
    empty = charts.chart([charts.ChartLine("y", np.arange(5.0), y * np.nan)], charts.ChartAxes("", ""))
    assert "no data" in markup.render(empty)


def test_map_shows_the_worst_of_each_cell_and_what_was_missed() -> None:
    u, v = np.meshgrid(np.linspace(0, 0.4, 60), np.linspace(0, 0.3, 45))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    value = np.full(len(uv), 1e-4)
    value[1000] = -2e-3
    value[(uv[:, 0] > 0.35) & (uv[:, 1] > 0.25)] = np.nan
    grid, (u0, u1, v0, v1) = charts.bin_values(uv, value)
    assert np.nanmin(np.where(np.isfinite(grid), grid, np.nan)) == -2e-3
    assert np.isnan(grid[0, -2]) and not np.isnan(grid[-1, 0])
    assert u0 == 0.0 and v0 == 0.0 and u1 >= 0.4 and v1 >= 0.3


@pytest.mark.parametrize("normal", [(0.0, 1.0, 0.0), (1.0, 0.2, 0.1), (0.0, 0.0, 1.0)])
def test_view_looks_along_the_normal(normal: tuple[float, float, float]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    points = np.random.default_rng(0).normal(size=(200, 3))
    points -= np.outer(points @ n, n)
    across, up, found = charts.plane_axes(points)
    assert abs(abs(found @ n) - 1.0) < 1e-9
    np.testing.assert_allclose(np.cross(across, up), found, atol=1e-12)


def test_a_ruled_surface_is_laid_flat() -> None:
    """A quarter of a cone's mantle: along the middle line radius times angle, along the ruling its length."""
    angle = np.linspace(0.0, 0.5 * np.pi, 200)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    start, end = 0.2 * ring, 0.1 * ring + np.array([0.0, 0.0, 0.3])
    rng = np.random.default_rng(1)
    row, fraction = rng.integers(0, 200, 500), rng.random(500)
    points = start[row] + fraction[:, None] * (end - start)[row]
    uv = charts.unroll(points, start, end)
    np.testing.assert_allclose(uv[:, 0], 0.15 * angle[row], atol=5e-4)
    np.testing.assert_allclose(
        uv[:, 1], np.hypot(0.1, 0.3) * fraction, atol=0.5 * np.hypot(0.1, 0.3) / 40 + 1e-4
    )


def test_readings_are_dots_where_the_axes_have_them() -> None:
    x, y = np.array([0.0, 50.0, 100.0]), np.array([0.0, 1.0, 4.0])
    rows = (
        {"name": "model", "x": x, "y": y, "colour": 3},
        {"name": "model", "x": x, "y": 1.1 * y, "colour": 3, "style": "dashed"},
        {"name": "lift", "x": x[1:], "y": y[1:], "colour": 3, "style": "dots"},
    )
    shown = {"kind": "curve", "title": "b", "x_label": "force [N]", "y_label": "S [mm]", "series": rows}
    (figure,), issues = exhibits.draw({"curve": shown}, BLOCK)
    html = markup.render(figure)
    assert not issues
    dots = re.findall(r'<circle class="dot c3" cx="([\d.]+)" cy="([\d.]+)"', html)
    lines = re.findall(r'<polyline class="line c3(.*?)" data-name="model" points="(.*?)"', html)
    assert [dash.strip() for dash, _ in lines] == ["", "dashed"]
    corners = [point.split(",") for point in lines[0][1].split()]
    assert [list(dot) for dot in dots] == corners[1:]
    # one key for each name and colour
    assert html.count(">model</span>") == 1


def test_paths_are_coloured_by_their_value_with_dots() -> None:
    shown = {"kind": "paths", "title": "p", "curves": (CURVES[0], CURVES[1], CURVES[2])}
    rows = {"value": np.array([0.0, 1.0, 0.0]), "value_name": "part of a loop", "points": CURVES[0][:4]}
    (figure,), issues = exhibits.draw({"paths": {**shown, **rows, "near": True}}, BLOCK)
    html = markup.render(figure)
    assert not issues
    item, two, three = re.findall(r'<polyline class="thin" style="stroke:(.*?)"', html)
    assert item == three != two
    assert html.count('<circle class="dot"') == 4
    assert "part of a loop" in html
