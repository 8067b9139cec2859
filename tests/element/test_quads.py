"""Shells of planar quads along conjugate directions: their files, read by independent test code."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
import shapely

from planner.cli.batch import Batch, run_batch
from planner.cli.element import ElementReport, ElementRequest, run_element, run_element_report
from planner.geometry.mesh import TriangleMesh, merge_vertices
from tests.element.shells import THICK, WrittenPanel, patch, read_panels, saddle, shell
from tests.element.test_hexagons import (
    divide,
    divide_with_issues,
    plane_deviation,
    refusals,
    require_convex_panel,
    sides,
)


def wavy() -> TriangleMesh:
    """Two waves that run across each other, as those of `problems/wave_facade`: both signs of curvature."""
    return patch(lambda x, y: 0.2 * np.sin(1.5 * x + 0.6 * y) + 0.1 * np.cos(2.6 * y - 0.5 * x), 61)


def rotated_saddle() -> TriangleMesh:
    """A saddle whose principal directions run across its rim."""
    return patch(lambda x, y: 0.2 * x * y)


SURFACES = {
    "saddle": (saddle, {}),
    "turned": (rotated_saddle, {}),
    "wavy": (wavy, {"count": 70, "off_surface_mm": 45}),
}
THIN = {"wavy": {"thickness_mm": 60, "blocks": [{"size_mm": [1200, 1000, 60], "foam": "eps_a120"}]}}


@pytest.fixture(scope="module", params=SURFACES)
def quads(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The name of a surface, its written panels, and the issues."""
    mesh, own = SURFACES[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    path = shell(folder, mesh(), {"shape": "quad", **own}, **THIN.get(request.param, {}))
    files, said = divide_with_issues(path)
    return request.param, read_panels(files), said


@pytest.mark.sampled(every=3)
def test_panels_are_planar_do_not_cross_and_keep_the_limits(quads: Any) -> None:
    name, panels, expected_text = quads
    thick = 60.0 if name == "wavy" else THICK
    assert len(panels) == SURFACES[name][1].get("count", 40)
    assert not [issue.code for issue in expected_text if issue.code in ("element.count", "element.concave")]
    four = 0
    for panel in panels.values():
        four += len(panel.top) == 4
        require_convex_panel(panel, thick, 40.0)
        rise = np.linalg.norm(panel.local_outlines[1] - panel.local_outlines[0], axis=1)
        assert rise.max() <= 1.15 * thick
        assert np.degrees(np.arccos(thick / rise)).max() <= 30.0
    assert four >= 0.6 * len(panels)


def test_neighbours_have_one_plane_between_them_and_backs_end_nearly_alike(quads: Any) -> None:
    panels = quads[1]
    met = 0
    apart = dict.fromkeys(panels, 0.0)
    for name, panel in panels.items():
        for i, other in enumerate(panel.row["neighbours"]):
            if other is None or other < name:
                continue
            beyond = panels[other]
            k = beyond.row["neighbours"].index(name)
            side, neighbour_side = sides(panel)[i][[1, 0, 3, 2]], sides(beyond)[k]
            assert plane_deviation(np.concatenate([side, neighbour_side])) < 1e-6
            np.testing.assert_allclose(side[2:], neighbour_side[2:], atol=1e-6)  # fronts have one edge
            met += 1
            for back, front in ((0, 3), (1, 2)):
                if at_rim(panel, i, back) or at_rim(beyond, k, 1 - back):
                    continue
                # one line from front to back, of two lengths: four planes moved by one have no common point
                step = np.linalg.norm(side[back] - neighbour_side[back])
                assert step < 3.0
                for item in (name, other):
                    apart[item] = max(apart[item], float(step))
                way = side[back] - side[front]
                assert (
                    np.linalg.norm(np.cross(way, neighbour_side[back] - neighbour_side[front]))
                    / np.linalg.norm(way)
                    < 1e-6
                )
    assert met > 1.3 * len(panels)
    stated = {name: panel.row["backs_apart_mm"] for name, panel in panels.items()}
    assert max(stated.values()) > 0.1
    for name, own in apart.items():  # those across a corner count too
        assert own - 2e-3 <= stated[name] <= 2.0 * max(apart.values()) + 2e-3


def at_rim(panel: WrittenPanel, side: int, end: int) -> bool:
    """Whether a side's first (0) or second corner, as its neighbour counts them, is on the rim."""
    beside = panel.row["neighbours"]
    return beside[(side + 1) % len(beside) if end == 0 else side - 1] is None


def test_no_two_solids_have_anything_in_common(quads: Any) -> None:
    """Pair by pair: a union of all is not exact where many faces nearly lie in one plane."""
    panels = list(quads[1].values())
    corners = [np.concatenate([p.bottom, p.top]) / 1e3 for p in panels]
    bodies = [manifold3d.Manifold.hull_points(corner) for corner in corners]
    low, high = (np.array([extreme(corner, axis=0) for corner in corners]) for extreme in (np.min, np.max))
    met = 0
    for a in range(len(bodies)):
        for b in range(a):
            if (low[a] < high[b]).all() and (low[b] < high[a]).all():
                assert (bodies[a] ^ bodies[b]).volume() < 1e-9
                met += 1
    assert met > len(panels)
    stated = [panel.row["volume_l"] for panel in panels]
    np.testing.assert_allclose(stated, [1e3 * body.volume() for body in bodies], atol=1e-3)


def test_panels_leave_nothing_bare(quads: Any) -> None:
    panels = quads[1]
    fronts = shapely.union_all([shapely.Polygon(p.top[:, :2]) for p in panels.values()])
    plan = shapely.box(-2000.0, -1500.0, 2000.0, 1500.0)
    assert fronts.symmetric_difference(plan).buffer(-40.0).is_empty
    assert fronts.intersection(plan).area > 0.98 * plan.area


@pytest.mark.long
def test_the_same_file_gives_the_same_bytes_and_a_billionth_changes_no_id(tmp_path: Path) -> None:
    quad = {"shape": "quad"}
    first = divide(shell(tmp_path / "one", saddle(), quad))
    assert divide(shell(tmp_path / "two", saddle(), quad)) == first
    mesh = saddle()
    moved = mesh.vertices + np.random.default_rng(1).uniform(-1e-9, 1e-9, mesh.vertices.shape)
    near = read_panels(divide(shell(tmp_path / "three", TriangleMesh(moved, mesh.faces), quad)))
    for name, panel in read_panels(first).items():
        assert panel.row["neighbours"] == near[name].row["neighbours"]
        np.testing.assert_allclose(panel.top, near[name].top, atol=0.1)


@pytest.mark.long
def test_a_count_that_rows_cannot_make_is_told_and_narrower_panels_make_it(tmp_path: Path) -> None:
    quad = {"shape": "quad", "count": 37}
    files, said = divide_with_issues(shell(tmp_path / "one", saddle(), {**quad, "least_width_mm": 380}))
    (issue,) = (item for item in said if item.code == "element.count")
    count = len(read_panels(files))
    assert issue.message.startswith(f"{count} panels: rows of quads over")
    assert 0 < abs(count - 37) <= 4
    assert "a smaller least_width_mm" in str(issue.hint)
    files, said = divide_with_issues(shell(tmp_path / "two", saddle(), {**quad, "least_width_mm": 100}))
    assert len(read_panels(files)) == 37
    assert not [item for item in said if item.code == "element.count"]


@pytest.mark.long
def test_quads_are_advised_where_hexagons_fail_as_the_surface_bends_both_ways(tmp_path: Path) -> None:
    limits = {"least_edge_mm": 150, "least_width_mm": 200}
    result = refusals(shell(tmp_path, saddle(), limits))
    assert all("shape: quad was tried: all panels can be made then" in str(i.hint) for i in result.values())
    assert divide(shell(tmp_path, saddle(), {**limits, "shape": "quad"}))


def test_a_surface_that_cannot_be_laid_out_is_refused_with_a_place(tmp_path: Path) -> None:
    """A tube: lines round it have no beginning."""
    mesh = patch(lambda x, y: 0 * x, 41)
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1].copy()
    mesh.vertices[:] = np.stack([y, np.cos(np.pi * x / 2.0), np.sin(np.pi * x / 2.0)], axis=1)
    issue = refusals(shell(tmp_path, merge_vertices(mesh), {"shape": "quad"}))["panels.hexagons.count"]
    assert issue.code == "element.surface"
    assert re.search(r"near \(-?\d+, -?\d+, -?\d+\) mm", issue.message)
    assert "shape: hexagon" in str(issue.hint)


@pytest.mark.long
def test_two_quads_are_planned_proven_and_meet(tmp_path: Path) -> None:
    """From the surface to the joint between the parts as cut."""
    out, run = tmp_path / "out", tmp_path / "run"
    run_element(ElementRequest(shell(tmp_path, saddle(), {"shape": "quad"}), out))
    panels = {row["id"]: row for row in csv.DictReader((out / "panels.csv").open())}
    inner = {name for name, row in panels.items() if row["sides"] == "4" and "-" not in row["neighbours"]}
    pair = next((a, b) for a in sorted(inner) for b in panels[a]["neighbours"].split() if b in inner)
    files = tuple(out / "panels" / f"{name}.yaml" for name in pair)
    assert run_batch(Batch(files, run, workers=1, reports="failed")) == 0
    run_element_report(ElementReport(out, run))
    joints = {
        frozenset((row["panel"], row["other"])): row for row in csv.DictReader((out / "joints.csv").open())
    }
    joint = joints[frozenset(pair)]
    assert max(float(joint["step_95_mm"]), float(joint["gap_95_mm"])) <= 0.2
    assert max(float(joint["step_largest_mm"]), float(joint["gap_largest_mm"])) <= 0.5
    rows = {row["id"]: row for row in csv.DictReader((out / "report.csv").open())}
    assert [rows[name]["state"] for name in pair] == ["verified", "verified"]
    assert all(rows[name]["backs_apart_mm"] == panels[name]["backs_apart_mm"] for name in panels)
    assert "gap of backs mm" in (out / "element.html").read_text()
