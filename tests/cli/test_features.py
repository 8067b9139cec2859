"""``tandem features``: what it prints, draws and refuses."""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.cli.preparation import Features, run_features
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.units import MM
from planner.issues import TandemError
from tests.processes.forming.plan.nests import dome, frustum, revolved, sheet

PROFILE = [(60, 0), (50, 0), (44, -10), (36, -10), (20, 4), (0, 4)]


def write_part(folder: Path, mesh: Mesh) -> Path:
    path = folder / "part.stl"
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return path


@pytest.fixture
def part(tmp_path: Path) -> Path:
    return write_part(tmp_path, revolved([(float(r), float(z)) for r, z in PROFILE]))


def tandem(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "planner", "features", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_the_tree_and_the_order_are_printed(part: Path) -> None:
    done = tandem(str(part), "--strategy", "virgin")
    assert done.returncode == 0, done.stderr
    assert "2 features, flat at z = 0.000 mm" in done.stdout
    assert "1 concave (down) 0.00 to -10.00 mm, 99.9 x 99.9 mm across" in done.stdout  # a radius of 50
    assert "2 convex (up) -10.00 to 4.00 mm" in done.stdout
    assert "forming order: 2 (moved by +10.00 mm), 1" in done.stdout


def test_bad_parts_end_with_the_code_of_bad_input(tmp_path: Path) -> None:
    part = write_part(tmp_path, revolved([(60.0, 0.0), (50.0, 0.0), (51.0, -20.0), (0.0, -20.0)]))
    done = tandem(str(part))
    assert done.returncode == 2
    assert "forming.undercut" in done.stderr


@pytest.mark.parametrize("suffix", [".svg", ".html"])
def test_drawings_are_whole_and_show_every_contour(part: Path, tmp_path: Path, suffix: str) -> None:
    drawing = tmp_path / f"tree{suffix}"
    run_features(Features(part, step_mm=2.0, output=drawing))
    text = drawing.read_text("utf-8")
    svg = text[text.index("<svg") : text.index("</svg>") + 6]
    root = ET.fromstring(svg)
    paths = [element for element in root.iter() if element.tag.endswith("path")]
    assert len(paths) == 6 + 8  # 10 mm and 14 mm every 2 mm, with both ends
    assert all(element.get("d", "").startswith("M") for element in paths)


def test_other_drawings_and_folders_that_are_not_are_refused(part: Path, tmp_path: Path) -> None:
    with pytest.raises(TandemError, match=r"output\.folder.*\.html or \.svg"):
        run_features(Features(part, output=tmp_path / "tree.png"))
    (tmp_path / "file").write_text("")
    with pytest.raises(TandemError, match=r"output\.folder.*cannot be written"):
        run_features(Features(part, output=tmp_path / "file" / "tree.svg"))


def test_a_table_has_centres_depths_and_wall_angles(tmp_path: Path) -> None:
    """Against the part as it was made: a pit of 59.04 degrees and a knob of 41.19 degrees, 10 and 14 mm."""
    moved = revolved([(float(r), float(z)) for r, z in PROFILE])
    part = write_part(tmp_path, Mesh(moved.vertices + np.array([30.0, -5.0, 2.0]), moved.faces))
    table = tmp_path / "tree.json"
    run_features(Features(part, output=table, strategy="virgin"))
    read = json.loads(table.read_text("utf-8"))
    pit, knob = read["features"]
    assert (read["level_mm"], read["tolerance_mm"]) == (2.0, 0.0)
    assert (pit["kind"], pit["parent"], pit["children"]) == ("concave", None, [2])
    assert (knob["kind"], knob["parent"], knob["children"]) == ("convex", 1, [])
    assert (pit["start_mm"], pit["end_mm"], pit["depth_mm"]) == pytest.approx((2.0, -8.0, 10.0), abs=1e-3)
    assert (knob["start_mm"], knob["end_mm"], knob["depth_mm"]) == pytest.approx((-8.0, 6.0, 14.0), abs=1e-3)
    for item, angle, across in ((pit, np.arctan2(10, 6), 100.0), (knob, np.arctan2(14, 16), 72.0)):
        assert item["centre_mm"] == pytest.approx([30.0, -5.0], abs=0.01)
        assert item["size_mm"] == pytest.approx([across, across], rel=2e-3)
        assert item["wall_angle_deg"] == pytest.approx(np.rad2deg(angle), abs=0.1)
        assert item["mean_wall_angle_deg"] == pytest.approx(np.rad2deg(angle), abs=0.1)
    assert read["order"] == [{"feature": 2, "shift_mm": 10.0}, {"feature": 1, "shift_mm": 0.0}]


def test_the_noise_of_a_scan_is_no_feature(tmp_path: Path) -> None:
    """A dish with a dome and a dimple on its floor, with noise of 0.1 mm at each vertex."""

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        dish = -frustum(x, y, (0.0, 0.0), 0.05, 0.012, 45.0)
        return dish + dome(x, y, (-0.016, 0.0), 0.012, 0.004) - dome(x, y, (0.016, 0.0), 0.012, 0.004)

    clean = sheet(height, 0.06, 1e-3)
    noise = np.random.default_rng(7).normal(0.0, 1e-4, clean.vertices.shape)
    part = write_part(tmp_path, Mesh((clean.vertices + noise) / MM, clean.faces))
    table = tmp_path / "tree.json"
    (note,) = run_features(Features(part, output=table))
    assert note.code == "part.mesh_noise"
    read = json.loads(table.read_text("utf-8"))
    assert read["tolerance_mm"] == pytest.approx(0.3, rel=0.1)
    assert [(one["kind"], one["parent"]) for one in read["features"]] == [
        ("concave", None),
        *sorted([("convex", 1), ("concave", 1)], key=lambda one: one[0] != read["features"][1]["kind"]),
    ]
    middle = {one["kind"]: one["centre_mm"][0] for one in read["features"][1:]}
    assert middle == {"convex": pytest.approx(-16.0, abs=0.5), "concave": pytest.approx(16.0, abs=0.5)}
    assert [one["depth_mm"] for one in read["features"][1:]] == pytest.approx([4.0, 4.0], abs=0.3)
    with pytest.raises(TandemError, match="tolerance"):
        run_features(Features(part, tolerance_mm=0.0))
