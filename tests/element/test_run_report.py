"""What a batch made of an element: joints of what was cut, measured here by other code; verdicts, minutes."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import plans
from planner.cli import command_line
from planner.cli.element import ElementReport, ElementRequest, run_element, run_element_report
from planner.issues import Issue, TandemError
from tests.element.shells import shell
from tests.element.walls import element
from tests.test_plans import some_plan

SECONDS = 90.0
SIDES = ("front", "back")


def read_obj(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Vertices (V, 3) and faces (F, 3) of each object of an OBJ file [mm], by code of the tests' own."""
    vertices, faces, name = [], {}, ""
    start: dict[str, int] = {}
    for line in path.read_text().splitlines():
        kind, *rest = line.split()
        if kind == "o":
            name = rest[0]
        elif kind == "v":
            start.setdefault(name, len(vertices))
            vertices.append([float(v) for v in rest])
        elif kind == "f":
            faces.setdefault(name, []).append([int(v) - 1 for v in rest])
    points = np.array(vertices)
    return {
        name: (points[start[name] : np.max(own) + 1], np.array(own) - start[name])
        for name, own in faces.items()
    }


def outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), the mean of those of the facets."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, faces[:, k], np.cross(b - a, c - a))
    return out / np.linalg.norm(out, axis=1, keepdims=True)


def cut(out: Path, run: Path, data: Mapping[str, Any], off: Mapping[str, float]) -> None:
    """Results of a batch as it writes them: each panel cut ``off`` [mm] outwards, unevenly."""
    plan = some_plan()
    operation = dataclasses.replace(plan.operations[0], time=np.linspace(0.0, SECONDS, 4))
    plan = dataclasses.replace(plan, operations=(operation,))
    rows = [["name", "state", "issues", "message"]]
    for name, by in off.items():
        lines, count = [], 1
        for side in SIDES:
            ((vertices, faces),) = read_obj(out / "panels" / "meshes" / f"{name}_{side}.obj").values()
            uneven = by * (1.0 + 0.3 * np.sin(0.02 * vertices[:, :1]))
            moved = vertices + uneven * outward(vertices, faces)
            lines += [f"o cut_{side}", *(f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in moved)]
            lines += [f"f {a} {b} {c}" for a, b, c in faces + count]
            count += len(vertices)
        (run / name).mkdir(parents=True)
        (run / name / "simulated_part.obj").write_text("\n".join(lines) + "\n")
        plans.save(plan, run / name)
        rows.append([name, "verified", "kerf.doubt", "a note"])
    refused = [panel["id"] for panel in data["panels"] if panel["id"] not in off][:1]
    rows += [[name, "infeasible", "motion.no_path", "nothing is free, <b>anywhere</b>"] for name in refused]
    with (run / "summary.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("element")
    run_element(ElementRequest(element(folder), folder / "out"))
    return folder / "out"


def data_of(out: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((out / "element.json").read_text())
    return loaded


def measured(out: Path, run: Path, data: Mapping[str, Any], names: list[str]) -> np.ndarray:
    """How far apart [mm] the faces of two panels as cut are at the corners that they share as written, front
    and back."""
    poses = {panel["id"]: np.array(panel["block_pose"]) for panel in data["panels"]}
    sides = []
    for side in SIDES:
        flat, solid = [], []
        for name in names:
            ((vertices, _),) = read_obj(out / "panels" / "meshes" / f"{name}_{side}.obj").values()
            rotation, origin = poses[name][:3, :3], poses[name][:3, 3]
            flat.append((vertices @ rotation.T + origin)[:, :2])
            moved, _ = read_obj(run / name / "simulated_part.obj")[f"cut_{side}"]
            solid.append(moved @ rotation.T + origin)
        near = np.linalg.norm(flat[0][:, None] - flat[1][None], axis=2)
        one, other = np.nonzero(near < 1e-3)
        sides.append(np.linalg.norm(solid[0][one] - solid[1][other], axis=1))
    return np.concatenate(sides)


def test_joints_are_those_of_the_parts_as_cut_and_the_ones_over_the_limit_are_named(
    out: Path, tmp_path: Path
) -> None:
    data = data_of(out)
    names = [panel["id"] for panel in data["panels"]]
    off = {name: (0.45 if k == 0 else 0.02 * (k % 3)) for k, name in enumerate(names[:-1])}
    cut(out, tmp_path, data, off)
    issues = run_element_report(ElementReport(out, tmp_path))
    rows = list(csv.DictReader((out / "joints.csv").open()))
    assert [[row["panel"], row["other"]] for row in rows] == [joint["panels"] for joint in data["joints"]]
    over = set()
    for row in rows:
        pair = [row["panel"], row["other"]]
        if names[-1] in pair:
            assert (row["step_95_mm"], row["over"]) == ("", "")
            continue
        own = measured(out, tmp_path, data, pair)
        step, gap = float(row["step_largest_mm"]), float(row["gap_largest_mm"])
        assert int(row["points"]) == len(own)
        assert max(step, gap) <= own.max() + 2e-4
        assert np.hypot(step, gap) >= own.max() - 2e-4
        far = np.percentile(own, 95.0) > 0.201 or own.max() > 0.501
        over |= {tuple(pair)} if row["over"] == "yes" else set()
        assert (row["over"] == "yes") or not far
    assert over and all(names[0] in pair for pair in over)
    told = [issue.message for issue in issues if issue.code == "element.joint"]
    assert len(told) == len(over)
    assert all(any(f"joint {a} to {b} " in words for words in told) for a, b in over)


def test_the_page_tells_states_minutes_and_reasons_and_needs_no_network(out: Path, tmp_path: Path) -> None:
    data = data_of(out)
    names = [panel["id"] for panel in data["panels"]]
    cut(out, tmp_path, data, dict.fromkeys(names[:3], 0.01))
    issues = run_element_report(ElementReport(out, tmp_path))
    left = next(issue for issue in issues if issue.code == "element.run")
    assert all(name in left.message for name in names[3:])
    rows = {row["id"]: row for row in csv.DictReader((out / "report.csv").open())}
    assert [rows[name]["state"] for name in names[:5]] == [*["verified"] * 3, "infeasible", "not planned"]
    assert all(
        float(rows[name][f"{arm}_min"]) == SECONDS / 60 for name in names[:3] for arm in ("left", "right")
    )
    assert all(abs(float(rows[name]["off_written_largest_mm"])) < 0.015 for name in names[:3])
    page = (out / "element.html").read_text()
    assert all(name in page for name in names)
    assert f"{3 * SECONDS / 3600:.2f} h of motion for 3 proven panels" in page
    assert "&lt;b&gt;anywhere&lt;/b&gt;" in page and "<b>anywhere</b>" not in page
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)


def refusal(out: Path, run: Path) -> Issue:
    with pytest.raises(TandemError) as caught:
        run_element_report(ElementReport(out, run))
    (issue,) = caught.value.issues
    return issue


def test_what_is_no_batch_of_the_element_is_refused_and_a_batch_of_it_is_read(
    out: Path, tmp_path: Path
) -> None:
    data = data_of(out)
    names = [panel["id"] for panel in data["panels"]]
    for folder, run in ((out, tmp_path), (tmp_path, tmp_path)):
        issue = refusal(folder, run)
        assert issue.code == "element.run"
        assert "tandem" in issue.message
    cut(out, tmp_path, data, {names[0]: 0.0, names[1]: 0.0})
    one, other = (tmp_path / name / "simulated_part.obj" for name in names[:2])
    text = one.read_text()
    one.write_text(other.read_text())
    assert refusal(out, tmp_path).code == "element.run"
    one.write_text(text)
    run_element_report(ElementReport(out, tmp_path))


def test_report_is_a_word_of_the_command(out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = data_of(out)
    cut(out, tmp_path, data, {data["panels"][0]["id"]: 0.0})
    monkeypatch.setattr(sys, "argv", ["tandem", "element", "report", str(out), str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 0


def test_planar_panels_are_told_to_have_no_such_report(tmp_path: Path) -> None:
    run_element(ElementRequest(shell(tmp_path), tmp_path / "out"))
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "summary.csv").write_text("name,state\n")
    with pytest.raises(TandemError) as caught:
        run_element_report(ElementReport(tmp_path / "out", tmp_path / "run"))
    (issue,) = caught.value.issues
    assert issue.code == "element.run"
    assert "straight wire" in issue.message
    assert "summary.csv" in str(issue.hint)
