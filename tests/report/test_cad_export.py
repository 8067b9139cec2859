"""Exports of a plan for CAD programs: positions against the table of poses of the job, units, and layers."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import rhino3dm
import trimesh

import planner
from planner.cli import results
from planner.issues import TandemError
from planner.report import cad_export
from tests import small_problem
from tests.proof.planner_jobs import ruled

AT = (450.0, 0.0, 0.0)
"""Where the small problem's block stands [mm]."""


@pytest.fixture(scope="module")
def result_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    outcome = planner.plan(planner.load(small_problem.write(folder)))
    outcome.save(folder / "out")
    return folder / "out"


def export(folder: Path, name: str, seconds: float = 0.0) -> Path:
    return results.export_result(folder, folder.parent / name, seconds)


def test_a_3dm_file_has_targets_where_the_table_has_them(result_folder: Path) -> None:
    model = rhino3dm.File3dm.Read(str(export(result_folder, "cell.3dm")))
    assert model.Settings.ModelUnitSystem == rhino3dm.UnitSystem.Millimeters
    by_layer: dict[str, list] = {}
    for item in model.Objects:
        by_layer.setdefault(model.Layers[item.Attributes.LayerIndex].FullPath, []).append(item)
    points = by_layer["targets::poses::left"]
    table = np.array([[float(v) for v in row.split(",")[:3]] for row in small_problem.ROWS])
    result = np.array([(p.Geometry.Location.X, p.Geometry.Location.Y, p.Geometry.Location.Z) for p in points])
    assert len(result) >= len(table)
    for row in table:
        assert np.linalg.norm(result - row, axis=1).min() < 1e-3
    text = [dict(item.Attributes.GetUserStrings()) for item in points]
    times = [float(own["time_s"]) for own in text]
    assert times[0] == 0.0
    assert times == sorted(times)
    q = np.array([[float(own[f"j{i}_deg"]) for i in range(1, 7)] for own in text])
    assert np.abs(np.diff(q, axis=0)).max() < 20.0
    ok = by_layer["ways::poses::left::work"][0].Geometry.TryGetPolyline()
    line = ok[1] if isinstance(ok, tuple) else ok
    assert np.linalg.norm(np.array([(p.X, p.Y, p.Z) for p in line])[0] - table[0]) < 1e-3
    layers = Counter(path.split("::")[0] for path in by_layer)
    assert layers["cell"] > 5
    box = by_layer["cell::stock"][0].Geometry.GetBoundingBox()
    size = 0.5 * np.array([100.0, 100.0, 100.0])
    middle = 0.5 * np.array([box.Min.X + box.Max.X, box.Min.Y + box.Max.Y, box.Min.Z + box.Max.Z])
    assert np.array([box.Max.X - box.Min.X, box.Max.Z - box.Min.Z]) == pytest.approx(2 * size[:2])
    assert middle[:2] == pytest.approx(AT[:2])


def test_a_glb_file_is_in_metres_with_y_up(result_folder: Path) -> None:
    scene = trimesh.load(io.BytesIO(export(result_folder, "cell.glb").read_bytes()), file_type="glb")
    names = {name.rpartition(" ")[0]: name for name in scene.graph.nodes_geometry}
    assert {"cell::stock", "cell::left::link_1", "cell::left::tool"} <= set(names)
    pose, geometry = scene.graph.get(names["cell::stock"])
    block = scene.geometry[geometry].vertices @ pose[:3, :3].T + pose[:3, 3]
    # x stays, z of the cell is y, y of the cell is -z
    assert block[:, 0].mean() == pytest.approx(0.450)
    assert np.ptp(block, axis=0) == pytest.approx([0.1, 0.1, 0.1])
    assert scene.bounds[1][1] > 0.5


def test_the_arm_is_where_it_is_at_that_time(result_folder: Path) -> None:
    tips = []
    for seconds in (0.0, 2.5):
        model = rhino3dm.File3dm.Read(str(export(result_folder, f"at{seconds}.3dm", seconds)))
        tool = [
            item.Geometry.GetBoundingBox().Center.Y
            for item in model.Objects
            if model.Layers[item.Attributes.LayerIndex].FullPath == "cell::left::tool"
        ]
        tips.append(float(np.mean(tool)))
    assert tips[1] - tips[0] > 10.0  # the table goes along y at 20 mm/s


def test_wanted_and_simulated_part_lie_in_the_block(tmp_path: Path) -> None:
    planner.plan(planner.load(ruled(tmp_path))).save(tmp_path / "out")
    model = rhino3dm.File3dm.Read(str(results.export_result(tmp_path / "out", tmp_path / "w.3dm")))
    boxes: dict[str, list[np.ndarray]] = {}
    for item in model.Objects:
        box = item.Geometry.GetBoundingBox()
        ends = np.array([[p.X, p.Y, p.Z] for p in (box.Min, box.Max)])
        boxes.setdefault(model.Layers[item.Attributes.LayerIndex].FullPath, []).append(ends)
    expected, cut = boxes["part::wanted::front"][0], boxes["part::simulated::cut_front"][0]
    stock = boxes["cell::stock"][0]
    assert (expected > stock[0] - 1e-3).all()
    assert (expected < stock[1] + 1e-3).all()
    assert np.abs(expected - cut).max() < 12.0  # the wire goes on through the block
    wires = np.array(boxes["wire::setup 1"])
    assert len(wires) > 20
    assert wires[:, 1].max() > stock[1].min()


@pytest.mark.parametrize(
    ("name", "seconds", "says"),
    [("a.step", 0.0, "allowed suffixes: .glb or .3dm"), ("a.glb", 1e6, "allowed 0 to"),
     ("a.glb", -1.0, "allowed 0 to"), ("a.glb", float("nan"), "allowed 0 to")],
)  # fmt: skip
def test_other_files_and_times_are_refused(result_folder: Path, name: str, seconds: float, says: str) -> None:
    with pytest.raises(TandemError, match=says):
        export(result_folder, name, seconds)


def test_a_folder_without_a_plan_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TandemError):
        results.export_result(tmp_path, tmp_path / "a.glb")
    assert cad_export.read_simulated_part(tmp_path / "simulated_part.obj") == {}
