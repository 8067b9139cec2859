"""Report of a batch of an element: joints of the cut parts, measured independently; verdicts, minutes."""

from __future__ import annotations

import csv
import dataclasses
import html
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import plans
from planner.cli import command_line
from planner.cli.element import ElementReport, ElementRequest, run_element, run_element_report
from planner.element import run_joints, wall_joints
from planner.issues import Issue, TandemError
from tests.element.shells import WrittenPanel, read_panels, shell
from tests.element.test_strips import sheet, wave
from tests.element.test_strips import write_element as strips_file
from tests.element.test_walls import PUZZLE, wall
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


def write_results(out: Path, run: Path, data: Mapping[str, Any], offsets: Mapping[str, float]) -> None:
    """Results of a batch as it writes them: each panel cut ``off`` [mm] outwards, unevenly."""
    plan = some_plan()
    operation = dataclasses.replace(plan.operations[0], time=np.linspace(0.0, SECONDS, 4))
    plan = dataclasses.replace(plan, operations=(operation,))
    rows = [["name", "state", "issues", "message"]]
    for name, by in offsets.items():
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
    refused = [panel["id"] for panel in data["panels"] if panel["id"] not in offsets][:1]
    rows += [[name, "infeasible", "motion.no_path", "nothing is free, <b>anywhere</b>"] for name in refused]
    with (run / "summary.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("element")
    run_element(ElementRequest(element(folder), folder / "out"))
    return folder / "out"


def read_data(out: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((out / "element.json").read_text())
    return loaded


def measure_gaps(out: Path, run: Path, data: Mapping[str, Any], names: list[str]) -> np.ndarray:
    """Return the distances [mm] between the cut faces of two panels at shared corners, front and back."""
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
        item, other = np.nonzero(near < 1e-3)
        sides.append(np.linalg.norm(solid[0][item] - solid[1][other], axis=1))
    return np.concatenate(sides)


def test_joints_are_those_of_the_parts_as_cut_and_the_ones_over_the_limit_are_named(
    out: Path, tmp_path: Path
) -> None:
    data = read_data(out)
    names = [panel["id"] for panel in data["panels"]]
    off = {name: (0.45 if k == 0 else 0.02 * (k % 3)) for k, name in enumerate(names[:-1])}
    write_results(out, tmp_path, data, off)
    issues = run_element_report(ElementReport(out, tmp_path))
    rows = list(csv.DictReader((out / "joints.csv").open()))
    assert [[row["panel"], row["other"]] for row in rows] == [joint["panels"] for joint in data["joints"]]
    over = set()
    for row in rows:
        pair = [row["panel"], row["other"]]
        if names[-1] in pair:
            assert (row["step_95_mm"], row["over"]) == ("", "")
            continue
        own = measure_gaps(out, tmp_path, data, pair)
        step, gap = float(row["step_largest_mm"]), float(row["gap_largest_mm"])
        assert int(row["points"]) == len(own)
        assert max(step, gap) <= own.max() + 2e-4
        assert np.hypot(step, gap) >= own.max() - 2e-4
        far = np.percentile(own, 95.0) > 0.201 or own.max() > 0.501
        over |= {tuple(pair)} if row["over"] == "yes" else set()
        assert (row["over"] == "yes") or not far
    assert over and all(names[0] in pair for pair in over)
    messages = [issue.message for issue in issues if issue.code == "element.joint"]
    assert len(messages) == len(over)
    assert all(any(f"joint {a} to {b} " in words for words in messages) for a, b in over)


def test_a_face_of_a_bent_wire_with_its_slot_on_the_side_of_the_panel_is_named(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Had the element written a front wound the other way, its problem would ask for that slot, and claim and
    program would agree: the part that is left is then wound the other way, too."""
    data = read_data(out)
    names = [panel["id"] for panel in data["panels"]]
    write_results(out, tmp_path, data, dict.fromkeys(names, 0.02))
    monkeypatch.setattr(run_joints, "slot_width", lambda result, surface: 0.003)
    assert "element.face" not in {i.code for i in run_element_report(ElementReport(out, tmp_path))}
    part = tmp_path / names[0] / "simulated_part.obj"
    front, back = part.read_text().split("o cut_back")
    part.write_text(re.sub(r"^f (\d+) (\d+) (\d+)", r"f \1 \3 \2", front, flags=re.M) + "o cut_back" + back)
    found = [i for i in run_element_report(ElementReport(out, tmp_path)) if i.code == "element.face"]
    assert len(found) == 1
    assert f"panel {names[0]} " in found[0].message
    assert "the slot of 3 mm is in the panel" in found[0].message
    assert found[0].value == pytest.approx(3.0, abs=0.1)


def test_the_page_tells_states_minutes_and_reasons_and_needs_no_network(out: Path, tmp_path: Path) -> None:
    data = read_data(out)
    names = [panel["id"] for panel in data["panels"]]
    write_results(out, tmp_path, data, dict.fromkeys(names[:3], 0.01))
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
    data = read_data(out)
    names = [panel["id"] for panel in data["panels"]]
    for folder, run in ((out, tmp_path), (tmp_path, tmp_path)):
        issue = refusal(folder, run)
        assert issue.code == "element.run"
        assert "tandem" in issue.message
    write_results(out, tmp_path, data, {names[0]: 0.0, names[1]: 0.0})
    item, other = (tmp_path / name / "simulated_part.obj" for name in names[:2])
    text = item.read_text()
    item.write_text(other.read_text())
    assert refusal(out, tmp_path).code == "element.run"
    item.write_text(text)
    run_element_report(ElementReport(out, tmp_path))


def test_report_is_a_word_of_the_command(out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = read_data(out)
    write_results(out, tmp_path, data, {data["panels"][0]["id"]: 0.0})
    monkeypatch.setattr(sys, "argv", ["tandem", "element", "report", str(out), str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 0


@pytest.fixture(scope="module")
def planar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planar")
    run_element(ElementRequest(shell(folder), folder / "out"))
    return folder / "out"


def panels_by_row(out: Path) -> dict[str, WrittenPanel]:
    names = [panel["id"] for panel in read_data(out)["panels"]]
    files = {f"panels/{name}.yaml": (out / "panels" / f"{name}.yaml").read_text() for name in names}
    return read_panels({**files, "element.json": (out / "element.json").read_text()})


def write_planar_results(out: Path, run: Path, offsets: Mapping[str, float], wave: float = 0.0) -> None:
    """Results of a batch: sides of each panel ``off`` [mm] outwards, and a ``wave`` [mm] half-way along."""
    plan = some_plan()
    rows = [["name", "state", "issues", "message"]]
    fraction = np.linspace(0.0, 1.0, 9)
    for name, panel in panels_by_row(out).items():
        if name not in offsets:
            continue
        lines = ["o cut_sides"]
        bottom, top = panel.local_outlines
        for i in range(len(top)):
            k = (i + 1) % len(top)
            way = (top[k] - top[i]) / np.linalg.norm(top[k] - top[i])
            normal = np.cross(way, top[i] - bottom[i])
            normal /= np.linalg.norm(normal)
            for z in np.linspace(0.0, 1.0, 4):
                a, b = bottom[i] + z * (top[i] - bottom[i]), bottom[k] + z * (top[k] - bottom[k])
                a, b = a + 3.0 * way, b - 3.0 * way  # corners belong to two sides
                by = offsets[name] + wave * np.sin(np.pi * fraction)
                at = a + fraction[:, None] * (b - a) + by[:, None] * normal
                lines += [f"v {x:.5f} {y:.5f} {h:.5f}" for x, y, h in at]
        (run / name).mkdir(parents=True)
        (run / name / "simulated_part.obj").write_text("\n".join(lines) + "\n")
        plans.save(plan, run / name)
        rows.append([name, "verified", "", ""])
    with (run / "summary.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def face_distances(panel: WrittenPanel, i: int, normal: np.ndarray, by: float) -> np.ndarray:
    """Where the edge of a front goes as its side i is cut ``by`` [mm] outwards: in the front's plane, in
    that of the side, nowhere along the edge."""
    a, b, c = (panel.top[k % len(panel.top)] for k in (i, i + 1, i + 2))
    front = np.cross(b - a, c - b)
    return np.linalg.solve(np.stack([normal, front, b - a]), [by, 0.0, 0.0])


def test_joints_of_planar_panels_are_those_of_their_sides_as_cut(planar: Path, tmp_path: Path) -> None:
    """Sides that are cut evenly off: the gap is the sum of both, the step follows from three planes."""
    panels = panels_by_row(planar)
    names = list(panels)
    off = {name: 0.02 * (k % 4) - 0.03 for k, name in enumerate(names[:-1])}
    off[names[3]] = 0.4
    write_planar_results(planar, tmp_path, off)
    issues = run_element_report(ElementReport(planar, tmp_path))
    rows = list(csv.DictReader((planar / "joints.csv").open()))
    pairs = {(a, b) for a, p in panels.items() for b in p.row["neighbours"] if b is not None and a < b}
    assert {(row["panel"], row["other"]) for row in rows} == pairs
    over = set()
    for row in rows:
        a, b = row["panel"], row["other"]
        if names[-1] in (a, b):
            assert (row["gap_95_mm"], row["over"]) == ("", "")
            continue
        apart = abs(off[a] + off[b])
        assert float(row["gap_95_mm"]) == pytest.approx(apart, abs=2e-4)
        assert float(row["gap_largest_mm"]) == pytest.approx(apart, abs=2e-4)
        item, other = panels[a], panels[b]
        i, k = item.row["neighbours"].index(b), other.row["neighbours"].index(a)
        along = item.top[(i + 1) % len(item.top)] - item.top[i]
        normal = np.cross(along, item.top[i] - item.bottom[i])
        normal /= np.linalg.norm(normal)
        moved = face_distances(item, i, normal, off[a]) - face_distances(other, k, normal, -off[b])
        up = np.array(item.row["block_pose"])[:3, 2] + np.array(other.row["block_pose"])[:3, 2]
        step = abs(moved @ up / np.linalg.norm(up))
        assert float(row["step_largest_mm"]) == pytest.approx(step, abs=2e-4)
        assert (row["over"] == "yes") == (apart > 0.2)
        over |= {(a, b)} if apart > 0.2 else set()
    assert over and all(names[3] in pair for pair in over)
    messages = [issue.message for issue in issues if issue.code == "element.joint"]
    assert len(messages) == len(over)
    assert all(any(f"joint {a} to {b} " in words for words in messages) for a, b in over)
    page = (planar / "element.html").read_text()
    assert all(html.escape(words) in page for words in messages)


def test_what_a_wire_leaves_between_corners_counts_and_parts_of_others_are_refused(
    planar: Path, tmp_path: Path
) -> None:
    names = list(panels_by_row(planar))
    write_planar_results(planar, tmp_path, dict.fromkeys(names, 0.0), wave=0.3)
    run_element_report(ElementReport(planar, tmp_path))
    rows = list(csv.DictReader((planar / "joints.csv").open()))
    assert all(float(row["gap_largest_mm"]) == pytest.approx(0.6, abs=0.01) for row in rows)
    page = (planar / "element.html").read_text()
    assert f"{len(names)} of {len(names)} panels proven" in page
    assert f"{len(rows)} of {len(rows)} measured joints over the limit" in page
    item, other = (tmp_path / name / "simulated_part.obj" for name in names[:2])
    item.write_text(other.read_text())
    assert refusal(planar, tmp_path).code == "element.run"
    bare = read_data(planar)
    del bare["panels"][0]["outline_mm"]
    (tmp_path / "element.json").write_text(json.dumps(bare))
    assert "no joints or outlines" in refusal(tmp_path, tmp_path).message


def write_wall_results(out: Path, run: Path, offsets: Mapping[str, float], without: str = "") -> None:
    """Results of a batch of a wall: each panel's faces and sides cut ``off`` [mm] outwards."""
    rows = [["name", "state", "issues", "message"]]
    for name, by in offsets.items():
        problem = yaml.safe_load((out / "panels" / f"{name}.yaml").read_text())
        lines = []
        for item in problem["part"]["ruled"]:
            start, end = (np.array(item[side]["polyline_mm"]) for side in ("start", "end"))
            fine = np.linspace(0, len(start) - 1, 12 * (len(start) - 1) + 1)  # twisted as the wire leaves it
            start, end = (
                np.stack([np.interp(fine, range(len(line)), c) for c in line.T], axis=1)
                for line in (start, end)
            )
            fraction = np.linspace(0.0, 1.0, 12)[:, None, None]
            grid = (1.0 - fraction) * start + fraction * end
            normal = np.cross(np.gradient(grid, axis=1), np.broadcast_to(end - start, grid.shape))
            normal /= np.linalg.norm(normal, axis=2, keepdims=True) * (-1.0 if item.get("flip") else 1.0)
            if item["name"] != without:
                moved = (grid + by * normal).reshape(-1, 3)
                lines += [f"o cut_{item['name']}", *(f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in moved)]
        (run / name).mkdir(parents=True)
        (run / name / "simulated_part.obj").write_text("\n".join(lines) + "\n")
        plans.save(some_plan(), run / name)
        rows.append([name, "verified", "", ""])
    with (run / "summary.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def write_twisted_element(folder: Path) -> Path:
    return wall(folder)


def write_bent_element(folder: Path) -> Path:
    return strips_file(folder, sheet(wave))


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("make", [write_twisted_element, write_bent_element])
def test_joints_of_walls_and_strips_are_those_of_the_parts_as_cut(make: Any, tmp_path: Path) -> None:
    """Sides that are cut too far out overlap by both; fronts stand apart by the difference."""
    out = tmp_path / "out"
    run_element(ElementRequest(make(tmp_path), out))
    data = read_data(out)
    names = [panel["id"] for panel in data["panels"]]
    met = {frozenset((p["id"], item)) for p in data["panels"] for item in p["neighbours"] if item}
    assert {frozenset(joint["panels"]) for joint in data["joints"]} == met
    off = {name: 0.05 * (k % 4) for k, name in enumerate(names[:-1])}
    write_wall_results(out, tmp_path / "run", off)
    run_element_report(ElementReport(out, tmp_path / "run"))
    rows = list(csv.DictReader((out / "joints.csv").open()))
    assert len(rows) == len(data["joints"])
    for row in rows:
        pair = row["panel"], row["other"]
        if names[-1] in pair:
            assert row["gap_95_mm"] == ""
            continue
        a, b = (off[name] for name in pair)
        assert float(row["gap_largest_mm"]) == pytest.approx(a + b, abs=2e-3)
        assert float(row["step_largest_mm"]) == pytest.approx(abs(a - b), abs=2e-3)
    report = {row["id"]: row for row in csv.DictReader((out / "report.csv").open())}
    for name, by in off.items():
        assert float(report[name]["off_written_95_mm"]) == pytest.approx(by, abs=0.01)
    write_wall_results(out, tmp_path / "bare", off, without="right")
    run_element_report(ElementReport(out, tmp_path / "bare"))
    rights = {frozenset(joint["panels"]) for joint in data["joints"] if "right" in joint["sides"]}
    for row in csv.DictReader((out / "joints.csv").open()):
        bare = frozenset((row["panel"], row["other"])) in rights or names[-1] in (row["panel"], row["other"])
        assert (row["gap_95_mm"] == "") == bare
    item, other = (tmp_path / "run" / name / "simulated_part.obj" for name in names[:2])
    item.write_text(
        "".join(
            f"{line}\n" if line[0] == "o" else f"v 900 900 {n}\n"
            for n, line in enumerate(other.read_text().splitlines())
        )
    )
    assert refusal(out, tmp_path / "run").code == "element.run"


def test_puzzle_pieces_have_no_joints_that_are_measured(tmp_path: Path) -> None:
    run_element(ElementRequest(wall(tmp_path, PUZZLE), tmp_path / "out"))
    (tmp_path / "summary.csv").write_text("name,state,issues,message\n")
    assert "puzzle pieces never have" in refusal(tmp_path / "out", tmp_path).message


def test_what_is_cut_near_a_corner_is_of_its_own_side(tmp_path: Path) -> None:
    """Two sides of a panel in a row meet at a right angle.

    Sample points of one side may be nearer to the cut of the other, and were measured against it.
    """

    def side(name: str, a: tuple[float, float], b: tuple[float, float]) -> dict[str, Any]:
        ends = {"start": 0.0, "end": 100.0}
        return {"name": name, **{k: {"polyline_mm": [[*a, z], [*b, z]]} for k, z in ends.items()}}

    def face(name: str, z: float) -> dict[str, Any]:
        ends = {"start": 0.0, "end": 100.0}
        return {"name": name, **{k: {"polyline_mm": [[x, 0, z], [x, 100, z]]} for k, x in ends.items()}}

    sides = [side("right", (100, -3), (100, 101.1)), side("top", (101.1, 100), (-3, 100))]
    written = {"part": {"ruled": [face("front", 90.0), face("back", 10.0), *sides]}}
    (tmp_path / "again").mkdir()
    (tmp_path / "again" / "P0.yaml").write_text(yaml.safe_dump(written))
    level = np.arange(0.0, 100.0, 7.0)
    up = np.array([[100.0, y, z] for y in np.arange(90.0, 99.9, 0.25) for z in level])
    plane = np.array([[x, y, 0.0] for x in np.arange(0.0, 100.0, 9.0) for y in np.arange(0.0, 100.0, 9.0)])
    objects = {"fronts": plane + np.array([0, 0, 90.0]), "backs": plane + np.array([0, 0, 10.0]), "P0": up}
    (tmp_path / "run" / "B1").mkdir(parents=True)
    lines = [
        line
        for name, points in objects.items()
        for line in (f"o cut_{name}", *(f"v {x} {y} {z}" for x, y, z in points.tolist()))
    ]
    (tmp_path / "run" / "B1" / "simulated_part.obj").write_text("\n".join(lines) + "\n")
    pose = np.eye(4).tolist()
    panel = {"id": "P0", "block_pose": pose, "cut_in": {"job": "B1", "pose": pose}}
    cut = {item.name: item for item in wall_joints.cut_surfaces(tmp_path, tmp_path / "run", panel)}
    assert max(float(np.abs(item.deviation).max(initial=0.0)) for item in cut.values()) < 1e-9
    assert len(cut["right"].cut) == len(up)
