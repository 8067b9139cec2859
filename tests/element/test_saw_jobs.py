"""Problems that saw raw blocks apart: the remainders are the panels' blocks, in stages that can be made."""

from __future__ import annotations

import csv
import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline, plans
from planner.batch import run as batch
from planner.cli.element import ElementReport, ElementRequest, run_element, run_element_report
from planner.element import element_file
from planner.issues import TandemError
from planner.processes import registry
from tests.element.shells import cap, shell
from tests.element.test_run_report import read_data
from tests.element.walls import ROOT
from tests.test_plans import some_plan

KERF = 2.0
"""[mm]"""
BOW = {"span_mm": 900, "throat_mm": 900}
SAW = {
    "cell": str(ROOT / "problems" / "cells" / "irb4600_bow.yaml"),
    "operations": [
        {
            "name": "saw",
            "process": "straight_wire",
            "arms": ["robot"],
            "setup": {"tools": {"robot": {"kind": "bow", **BOW}}},
            "feed_mm_s": 6,
        }
    ],
}


def sawn_shell(folder: Path, template: Any = SAW, **changes: Any) -> Path:
    """A shell 150 mm thick whose raw blocks are 170 mm thick, so that each panel takes a level cut too."""
    raw = {"sizes": [{"size_mm": [2400, 1200, 170], "foam": "eps_a120"}], "kerf_mm": KERF}
    given = {"raw_blocks": raw, "cut_blocks": {"problem": "saw.yaml"}, **changes}
    path = shell(folder, **given)
    (folder / "saw.yaml").write_text(yaml.safe_dump(template))
    return path


def write_small_shell(folder: Path, **changes: Any) -> list[Path]:
    """The files of a small shell as a user has them on disk, the element file first; its 24 panels are cut
    together, three out of each raw block."""
    (saw,) = SAW["operations"]
    bow = {"robot": {"kind": "bow", "span_mm": 1300, "throat_mm": 1300}}
    template = {**SAW, "operations": [{**saw, "setup": {"tools": bow}}]}
    given = {"mesh": cap(n=9), "hexagons": {"count": 24, "off_surface_mm": 60}, "foam_sides_mm": 14}
    cut = {"problem": "saw.yaml", "together": True}
    path = sawn_shell(folder, template, cut_blocks=cut, **given, **changes)
    cells = []
    for item in ("held.yaml", "saw.yaml"):
        data = yaml.safe_load((folder / item).read_text())
        cells.append(Path(data["cell"]))
        (folder / item).write_text(yaml.safe_dump({**data, "cell": cells[-1].name}))
    return [path, *(folder / item for item in ("shell.obj", "held.yaml", "saw.yaml")), *cells]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saw")
    run_element(ElementRequest(sawn_shell(folder), folder / "out"))
    return folder / "out"


def job_file(out: Path, name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((out / "blocks" / f"{name}.yaml").read_text())
    return loaded


def planes(problem: dict[str, Any]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Corners (4, 3) [mm] and the unit normal (3,) of each cut in the order of the operation, by the rule of
    the docs: way of the start guide times rulings, `flip` the other side."""
    ruled = {one["name"]: one for one in problem["part"]["ruled"]}
    result = []
    for cut in problem["operations"][0]["cuts"]:
        one = ruled[cut["surface"]]
        start, end = (np.array(one[side]["polyline_mm"]) for side in ("start", "end"))
        normal = np.cross(start[1] - start[0], end[0] - start[0])
        normal = normal / np.linalg.norm(normal) * (-1.0 if one.get("flip") else 1.0)
        result.append((np.concatenate([start, end]), normal))
    return result


def upwards(problem: dict[str, Any]) -> np.ndarray:
    """Return the up direction (3,) in the frame of the part."""
    roll, pitch = np.deg2rad(problem["stock"]["roll_pitch_deg"])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    return (about_y @ about_x)[2]


def saw_jobs(data: dict[str, Any]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    return [(block, job) for block in data["blocks"]["blocks"] for job in block["jobs"]]


def test_jobs_cut_raw_blocks_into_the_blocks_of_all_panels(out: Path) -> None:
    data = read_data(out)
    boxes = 0
    for block in data["blocks"]["blocks"]:
        pieces = [np.array([[0.0, 0.0, 0.0], block["size_mm"]])]
        done = []
        for job in block["jobs"]:
            problem = job_file(out, job["id"])
            low = np.array([*job["corner_mm"], 0.0])
            whole = np.array([low, low + problem["stock"]["size_mm"]])
            mine = [piece for piece in pieces if np.allclose(piece, whole, atol=0.01)]
            assert len(mine) == 1, f"{job['id']} cuts what does not lie there by itself"
            pieces = [piece for piece in pieces if piece is not mine[0]]
            new = mine
            to_block = low + [0.5, 0.5, 0.0] * (whole[1] - whole[0])
            for corners, normal in planes(problem):
                axis = int(np.argmax(normal))
                assert np.allclose(normal, np.eye(3)[axis], atol=1e-9)
                at = corners + to_block
                others = [k for k in range(3) if k != axis]  # from face to face of the part
                assert np.allclose(at.min(axis=0)[others], whole[0, others], atol=0.01)
                assert np.allclose(at.max(axis=0)[others], whole[1, others], atol=0.01)
                (through,) = [p for p in new if p[0, axis] < at[0, axis] < p[1, axis]]
                new = [piece for piece in new if piece is not through]
                below, above = through.copy(), through.copy()
                below[1, axis], above[0, axis] = at[0, axis], at[0, axis] + KERF
                new += [below] + [above] * bool(above[0, axis] < above[1, axis] - 1e-6)
            pieces += new
            done += job["cuts"]
        levels = [panel for panel in block["panels"] if panel["level_cut"]]
        assert sorted(done) == list(range(1, len(block["cuts"]) + len(levels) + 1))
        for panel in block["panels"]:
            low = np.array([*panel["corner_mm"], 0.0])
            box = np.array([low, [*low[:2] + panel["size_mm"], 150.0]])
            assert any(np.allclose(piece, box, atol=0.02) for piece in pieces), panel["id"]
            boxes += 1
    assert boxes == len(data["panels"])


def test_parts_lie_flat_where_the_bow_spans_their_cuts_and_stand_on_edge_else(out: Path) -> None:
    kinds = set()
    for _, job in saw_jobs(read_data(out)):
        problem = job_file(out, job["id"])
        cuts, up = planes(problem), upwards(problem)
        axis = int(np.argmax(cuts[0][1]))
        size = np.array(problem["stock"]["size_mm"])
        flat = abs(up[2]) > 0.999
        if axis == 2:
            kinds.add("level")
            assert flat
            continue
        kinds.add("flat" if flat else "edge")
        assert flat == (size[1 - axis] + 40.0 <= BOW["span_mm"])
        leaves = [cut.get("leave") for cut in problem["operations"][0]["cuts"]]
        assert set(leaves) == ({"back"} if flat else {None})
        for corners, _ in cuts:  # rulings lie as the wire does: along the cut, or through the thickness
            assert int(np.argmax(np.abs(corners[2] - corners[0]))) == (1 - axis if flat else 2)
        if not flat:
            assert abs(up[axis]) > 0.999
            heights = [float(corners[0] @ up) for corners, _ in cuts]
            assert heights == sorted(heights, reverse=True)  # what drops is not cut again
            assert 0.5 * size[axis] - heights[-1] <= BOW["throat_mm"]
    assert kinds == {"flat", "edge", "level"}


def test_the_wire_comes_to_parts_that_lie_flat_from_above_and_leaves_upwards(out: Path, small: Path) -> None:
    """Below are the beams, between which there is no way in for a bow."""
    seen = set()
    for folder in (out, small):
        for _, job in saw_jobs(read_data(folder)):
            written = job_file(folder, job["id"])
            axis = int(np.argmax(planes(written)[0][1]))
            if axis == 2 or abs(upwards(written)[2]) < 0.999 or (folder, axis) in seen:
                continue
            seen.add((folder, axis))
            problem = pipeline.load(folder / "blocks" / f"{job['id']}.yaml")
            (item,) = registry.jobs(problem)
            ends = item.targets().pose["robot"][[0, -1], 2, 3]
            assert (ends > problem.stock.size[2]).all(), job["id"]
    assert {axis for _, axis in seen} == {0, 1}


def test_what_bears_a_part_is_below_it_and_beside_its_slots(out: Path) -> None:
    for _, job in saw_jobs(read_data(out)):
        problem = job_file(out, job["id"])
        up, size = upwards(problem), np.array(problem["stock"]["size_mm"])
        low = np.array([-0.5 * size[0], -0.5 * size[1], 0.0])
        minimum = float(np.minimum(low * up, (low + size) * up).sum())
        for box in problem["stock"]["support"]:
            middle, half = np.array(box["pose"]["xyz_mm"]), 0.5 * np.array(box["size_mm"])
            assert float(middle @ up + half @ np.abs(up)) == pytest.approx(minimum, abs=0.01)
            assert 2.0 * float(half @ np.abs(up)) == pytest.approx(700.0)
            for k in (k for k in range(3) if abs(up[k]) < 0.5):
                assert low[k] + 5.0 < middle[k] - half[k]
                assert middle[k] + half[k] < low[k] + size[k] - 5.0
                for corners, normal in planes(problem):
                    if normal[k] > 0.5:
                        place = corners[0, k]
                        assert middle[k] + half[k] < place - 19.9 or middle[k] - half[k] > place + KERF + 19.9


def test_problems_are_read_and_blocks_have_other_names_than_panels(out: Path) -> None:
    data = read_data(out)
    panels = {panel["id"] for panel in data["panels"]}
    assert "B01" in panels
    rows = list(csv.DictReader((out / "blocks.csv").open()))
    named = [name for row in rows for name in row["jobs"].split()]
    assert named == [job["id"] for _, job in saw_jobs(data)]
    assert sorted(named) == sorted(path.stem for path in (out / "blocks").iterdir())
    assert not panels & {*named, *(row["block"] for row in rows)}
    for name in named[:4]:
        problem = pipeline.load(out / "blocks" / f"{name}.yaml")
        assert problem.name.startswith(data["name"][:10])
    result = batch.collect_items([out / "panels", out / "blocks"], out / "run")
    assert {item.name for item in result} == panels | set(named)


def test_slots_are_those_of_the_nest_or_narrower_by_power(tmp_path: Path, out: Path) -> None:
    name = read_data(out)["blocks"]["blocks"][0]["id"]
    assert job_file(out, name)["operations"][0]["kerf_mm"] == KERF
    hot = {**SAW, "operations": [{**SAW["operations"][0], "power_w": 76}]}
    element = element_file.read_element(sawn_shell(tmp_path, hot))
    assert element.saw is not None
    (operation,) = element.saw.data["operations"]
    assert operation["kerf_range_mm"][1] == KERF
    assert "kerf_mm" not in operation


@pytest.mark.parametrize(
    ("change", "expected_text"),
    [
        ({"operations": [{**SAW["operations"][0], "cuts": "all"}]}, "without cuts"),
        ({"operations": [{**SAW["operations"][0], "kerf_mm": 3}]}, "kerf_mm"),
        ({"operations": SAW["operations"] * 2}, "one operation"),
        ({"operations": [{**SAW["operations"][0], "process": "milling"}]}, "straight_wire"),
        ({"operations": [{**SAW["operations"][0], "arms": ["other"]}]}, "no bow on the first"),
        ({"stock": {"support": []}}, "stock.support, which is added for each piece of a block"),
        ({"part": {}}, "part, which is added for each piece"),
    ],
)
def test_templates_that_bring_what_blocks_bring_are_refused(
    tmp_path: Path, change: dict[str, Any], expected_text: str
) -> None:
    with pytest.raises(TandemError) as caught:
        element_file.read_element(sawn_shell(tmp_path, {**SAW, **change}))
    (issue,) = caught.value.issues
    assert (issue.code, issue.field) == ("element.jobs", "cut_blocks")
    assert expected_text in issue.message


def test_jobs_of_blocks_need_raw_blocks(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        element_file.read_element(sawn_shell(tmp_path, raw_blocks=None))
    assert "cut_blocks" in caught.value.issues[0].message


@pytest.mark.long
def test_jobs_out_of_reach_are_named_with_a_bow_that_reaches_them(tmp_path: Path, out: Path) -> None:
    assert not [i for i in read_data(out)["issues"] if i["field"] == "cut_blocks"]
    small = {**SAW["operations"][0], "setup": {"tools": {"robot": {"kind": "bow", "span_mm": 400}}}}
    run_element(ElementRequest(sawn_shell(tmp_path, {**SAW, "operations": [small]}), tmp_path / "out"))
    (issue,) = [i for i in read_data(tmp_path / "out")["issues"] if i["field"] == "cut_blocks"]
    assert issue["code"] == "element.cut"
    assert "a span of 400 and a throat of 400 mm: RB" in issue["message"]
    match = re.search(r"span_mm: (\d+), throat_mm: (\d+)", issue["hint"])
    assert match is not None
    wide = {"kind": "bow", "span_mm": int(match[1]), "throat_mm": int(match[2])}
    small = {**small, "setup": {"tools": {"robot": wide}}}
    run_element(ElementRequest(sawn_shell(tmp_path, {**SAW, "operations": [small]}), tmp_path / "out"))
    assert not [i for i in read_data(tmp_path / "out")["issues"] if i["field"] == "cut_blocks"]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same out of smaller blocks, for the bow of the cell."""
    folder = tmp_path_factory.mktemp("small")
    sizes = [{"size_mm": [1250, 600, 170], "foam": "eps_a120"}]
    operation = {key: value for key, value in SAW["operations"][0].items() if key != "setup"}
    raw = {"sizes": sizes, "kerf_mm": KERF}
    path = sawn_shell(folder, {**SAW, "operations": [operation]}, raw_blocks=raw, hexagons={"count": 80})
    run_element(ElementRequest(path, folder / "out"))
    return folder / "out"


def test_the_report_tells_states_and_minutes_of_the_jobs_that_cut_blocks(small: Path, tmp_path: Path) -> None:
    jobs = [job["id"] for _, job in saw_jobs(read_data(small))]
    before = (small / "element.html").read_text()
    assert f"{len(jobs)} jobs that cut them" in before
    assert "to cut raw blocks, arm robot" in before
    plan = some_plan()
    operation = dataclasses.replace(plan.operations[0], time=np.linspace(0.0, 90.0, 4))
    plans.save(dataclasses.replace(plan, operations=(operation,)), tmp_path / jobs[0])
    rows = [f"{jobs[0]},verified,,", f"{jobs[1]},infeasible,motion.entry,no way in"]
    (tmp_path / "summary.csv").write_text("\n".join(["name,state,issues,message", *rows]) + "\n")
    messages = [issue.message for issue in run_element_report(ElementReport(small, tmp_path))]
    (left,) = [message for message in messages if "jobs of raw blocks" in message]
    assert left.startswith(f"{len(jobs) - 1} of {len(jobs)} jobs of raw blocks are not proven: ")
    assert f"{jobs[1]} (motion.entry)" in left
    page = (small / "element.html").read_text()
    assert f"{len(jobs)} jobs that cut them, 1 of these proven" in page
    assert f"0.03 h of motion for 1 of {len(jobs)} jobs of raw blocks" in page
    assert "motion.entry no way in" in page


def plan_all(out: Path, names: list[str], run: Path) -> dict[str, str]:
    """How each of the jobs ended."""
    problems = {name: pipeline.load(out / "blocks" / f"{name}.yaml") for name in names}
    return {name: done.state for name, done in batch.plan_all(problems, run, 1).items()}


def test_a_level_cut_is_proven_as_it_is_written(small: Path, tmp_path: Path) -> None:
    name = read_data(small)["blocks"]["blocks"][0]["jobs"][-1]["id"]
    assert plan_all(small, [name], tmp_path) == {name: "verified"}


@pytest.mark.long
def test_a_raw_block_is_cut_apart_by_proven_jobs(tmp_path: Path) -> None:
    run_element(ElementRequest(ROOT / "problems" / "ruled_wall_108" / "boxes.yaml", tmp_path / "out"))
    block = read_data(tmp_path / "out")["blocks"]["blocks"][1]  # whose parts are cut along x and along y
    names = [job["id"] for job in block["jobs"]]
    assert names[:2] == ["B02", "B02-2"]
    assert set(plan_all(tmp_path / "out", names, tmp_path / "run").values()) == {"verified"}
