"""A first look at some targets says of them what the whole check says, and no more."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from planner import pipeline
from planner.geometry.arrays import Mesh
from planner.issues import has_errors
from planner.motion import first_look
from planner.motion.first_look import FirstLook
from planner.problem import Problem
from planner.processes import registry
from planner.reading import strict_yaml
from planner.runtime.memoize import use_cache
from planner.service.kept_files import KeptFiles
from planner.service.kept_targets import maker, seen, seen_alike
from planner.targets import Targets
from tests import small_forming, small_problem

FAR = "2450,50,500,0.5,-0.5,0.5,0.5,20"
POST = """
  obstacles:
    - {name: post, shapes: [{kind: box, size_mm: [30, 30, 100], pose: {xyz_mm: [460, 60, 500]}}]}
"""


def small(folder: Path, problem: str = small_problem.PROBLEM, rows: list[str] | None = None) -> Problem:
    table = "\n".join([small_problem.COLUMNS, *(rows or small_problem.ROWS)]) + "\n"
    return pipeline.load(small_problem.write(folder, problem, table))


def dense(count: int) -> list[str]:
    return [f"450,{y:.4f},500,0.5,-0.5,0.5,0.5,20" for y in np.linspace(-50, 50, count)]


def test_targets_are_spread_evenly_over_operations_with_both_ends() -> None:
    look = FirstLook((1000, 10, 1), 40)
    first, second, third = (look.rows(k) for k in range(3))
    assert first[0] == 0 and first[-1] == 999 and len(first) == 40
    assert np.ptp(np.diff(first)) <= 1
    assert second.tolist() == [0, 9]
    assert third.tolist() == [0]


def test_a_problem_with_a_path_has_no_fault_at_any_share(tmp_path: Path) -> None:
    problem = small(tmp_path, rows=dense(60))
    for most, looked in ((5, 5), (1000, 60)):
        found = pipeline.looked_over(problem, most)
        assert (found.targets, found.of) == (looked, 60)
        assert not has_errors(found.issues)
    whole = pipeline.looked_over(problem, None)
    assert (whole.targets, whole.of) == (60, 60)
    assert whole.issues == pipeline.check(problem)


def test_what_is_out_of_reach_is_told_as_the_whole_check_tells_it(tmp_path: Path) -> None:
    problem = small(tmp_path, rows=[*dense(59), FAR])
    found = pipeline.looked_over(problem, 6)
    (fault,) = (issue for issue in found.issues if issue.code.startswith("motion."))
    (whole,) = (issue for issue in pipeline.check(problem, advise=False) if issue.code.startswith("motion."))
    assert (fault.code, fault.target, fault.index) == (whole.code, whole.target, whole.index)
    assert (fault.code, fault.index) == ("motion.no_reach", 59)
    assert fault.value == pytest.approx(whole.value)
    assert (found.targets, found.of) == (6, 60)


def test_a_fault_between_the_targets_is_left_to_the_whole_check(tmp_path: Path) -> None:
    """One of sixty targets is out of reach, and not among those that are looked at."""
    rows = dense(60)
    rows[7] = FAR
    problem = small(tmp_path, rows=rows)
    assert 7 not in FirstLook((60,), 6).rows(0)
    assert not has_errors(pipeline.looked_over(problem, 6).issues)
    assert has_errors(pipeline.check(problem, advise=False))
    assert has_errors(pipeline.looked_over(problem, 60).issues)


def test_what_stands_in_the_way_is_found(tmp_path: Path) -> None:
    text = small_problem.PROBLEM.replace("\nstock:", POST + "stock:")
    found = pipeline.looked_over(small(tmp_path, text), 6)
    (fault,) = (issue for issue in found.issues if issue.code == "motion.collision")
    assert "post" in fault.bodies
    whole = [i for i in pipeline.check(small(tmp_path, text), advise=False) if i.code == "motion.collision"]
    assert whole and set(whole[0].bodies) == set(fault.bodies)


@pytest.mark.parametrize("beside_mm", [60, 95])
def test_it_is_all_one_how_many_postures_are_looked_at_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, beside_mm: int
) -> None:
    """A post that closes some targets, or leaves them other postures than the best."""
    text = small_problem.PROBLEM.replace("\nstock:", POST.replace("460, 60", f"460, {beside_mm}") + "stock:")
    problem = small(tmp_path, text)
    found = []
    for together in (1, 8, 100_000):
        monkeypatch.setattr(first_look, "FIRST_POSTURES", together)
        found.append(pipeline.looked_over(problem, 6))
    assert found[0] == found[1] == found[2]
    assert found[0].of == 6


def test_a_place_that_is_searched_is_found_or_left_to_the_whole_check(tmp_path: Path) -> None:
    searched = small_problem.PROBLEM.replace("place: {xyz_mm: [450, 0, 0]}", "place: auto")
    searched = searched.replace("frame: world", "frame: stock") + "accept: [stock.hangs]\n"
    rows = [f"50,{y},150,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]
    found = pipeline.looked_over(small(tmp_path, searched, rows), 6)
    assert not has_errors(found.issues) and found.placed and found.targets == 6
    apart = ["-2000,0,150,0.5,-0.5,0.5,0.5,20", *rows, "2000,0,150,0.5,-0.5,0.5,0.5,20"]
    found = pipeline.looked_over(small(tmp_path, searched, apart), 6)
    assert not found.placed and not has_errors(found.issues)  # the whole check searches on
    told = {issue.code for issue in pipeline.check(small(tmp_path, searched, apart), advise=False)}
    assert "motion.no_placement" in told


def move_arm(data: dict[str, Any]) -> None:
    for arm in data["cell"]["arms"]:
        arm["base"] = {"xyz_mm": [-4000 if arm["name"] == "left" else 10, 20, 30]}


def stand_home_elsewhere(data: dict[str, Any]) -> None:
    for arm in data["cell"]["arms"]:
        arm["home_deg"] = [5, -5, 5, 0, 40, 0]


def put_an_obstacle(data: dict[str, Any]) -> None:
    box = {"kind": "box", "size_mm": [10, 10, 10], "pose": {"xyz_mm": [0, 0, 3000]}}
    data["cell"]["obstacles"] = [*data["cell"].get("obstacles", []), {"name": "other", "shapes": [box]}]


def keep_more_room(data: dict[str, Any]) -> None:
    data["settings"] = {**data.get("settings", {}), "clearance_mm": 17.0, "joint_margin_deg": 3.0}


def rename(data: dict[str, Any]) -> None:
    data["name"] = "another"


def other_feed(data: dict[str, Any]) -> None:
    data["operations"] = [*data["operations"][::-1], {"another": 1}]


def other_tool(data: dict[str, Any]) -> None:
    data["cell"]["arms"][0]["tool"] = {"kind": "bow"}


def other_block(data: dict[str, Any]) -> None:
    data["stock"] = {**data.get("stock", {}), "size_mm": [1, 2, 3]}


UNSEEN = (move_arm, stand_home_elsewhere, put_an_obstacle, keep_more_room, rename)
SEEN = (other_feed, other_tool, other_block)


def data_of(name: str) -> dict[str, Any]:
    problem = pipeline.load(name)
    return json.loads(json.dumps(problem.source, default=str))  # type: ignore[no-any-return]


@pytest.mark.parametrize("change", [*UNSEEN, *SEEN])
def test_edits_of_what_no_process_sees_are_told_from_others(change: Callable[[dict[str, Any]], None]) -> None:
    data = data_of("wing")
    before = seen(data)
    change(data)
    assert (seen(data) == before) == (change in UNSEEN)


ONE_OF_EACH = (
    "wing",
    pytest.param("wave_wall", marks=pytest.mark.long),
    "gcode",
    "gauge_lanes",
    "plate_with_holes",
    pytest.param("dish", marks=pytest.mark.long),
)


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_processes_make_the_same_targets_whatever_they_do_not_see(name: str, tmp_path: Path) -> None:
    """One problem of each process: kept targets are those that would be made, array by array."""
    if name == "dish":
        data = strict_yaml.read(small_forming.write(tmp_path, small_forming.problem())).data
    else:
        data = data_of(name)
    first = tmp_path / "first.yaml"
    first.write_text(strict_yaml.dump(data))
    for change in (move_arm, put_an_obstacle, keep_more_room, rename):
        change(data)
    if isinstance(data.get("stock", {}).get("place"), dict):
        data["stock"]["place"]["xyz_mm"] = [v + 10 for v in data["stock"]["place"]["xyz_mm"]]
    second = tmp_path / "second.yaml"
    second.write_text(strict_yaml.dump(data))
    one, other = pipeline.load(first), pipeline.load(second)
    assert one.digest != other.digest and seen_alike(one) == seen_alike(other)
    for index, (a, b) in enumerate(zip(registry.jobs(one), registry.jobs(other), strict=True)):
        made = maker(KeptFiles(tmp_path / "kept"), one, alike=True)(index, a)
        kept = maker(KeptFiles(tmp_path / "kept"), other, alike=True)(index, no_job)
        alike(kept, made)
        alike(kept, b.targets())
        few = registry.job(other, index, brief=True).targets()
        assert few.thinned == (name == "dish")
        if not few.thinned:  # what a first look does not judge shapes none
            alike(few, made)
        with pytest.raises(AttributeError):  # a whole check makes its own
            maker(KeptFiles(tmp_path / "kept"), other, alike=False)(index, no_job)


def test_a_block_that_leans_otherwise_is_seen(tmp_path: Path) -> None:
    """What is cut loose falls another way: turned about the vertical it is the same, laid over it is not."""
    data = data_of("gauge_lanes")
    found = []
    for turn in ([0, 0, 0], [0, 0, 30], [90, 0, 0]):
        data["stock"]["place"]["rpy_deg"] = turn
        (tmp_path / "p.yaml").write_text(strict_yaml.dump(data))
        found.append(seen_alike(pipeline.load(tmp_path / "p.yaml")))
    assert found[0] == found[1] != found[2]


@pytest.mark.long
def test_fewer_loops_of_a_formed_sheet_are_as_true_as_all_and_kept_for_first_looks_alone(
    tmp_path: Path,
) -> None:
    problem = pipeline.load(small_forming.write(tmp_path, small_forming.problem()))
    few, whole = (registry.job(problem, 0, brief=brief).targets() for brief in (True, False))
    assert few.thinned and not whole.thinned and 2 * few.count < whole.count
    works = [np.array([one.works for one in item.segment]) for item in (few, whole)]
    at, way = (item.pose["robot"][rows][:, :3, 3] for item, rows in zip((few, whole), works, strict=True))
    step = 1e-3 * problem.operations[0].stepdown_mm  # type: ignore[attr-defined]
    off = cKDTree(densified(way, 0.1 * step)).query(at)[0]
    assert off.max() < 1.1 * step  # between two of its loops
    assert np.ptp(at[:, 2]) == pytest.approx(np.ptp(way[:, 2]), abs=1e-6)
    brief = registry.job(problem, 0, brief=True)
    first = maker(KeptFiles(tmp_path / "kept"), problem, alike=True)(0, brief)
    alike(
        maker(KeptFiles(tmp_path / "kept"), problem, alike=True)(0, registry.job(problem, 0, brief=True)),
        first,
    )
    made = maker(KeptFiles(tmp_path / "kept"), problem, alike=True)(0, registry.job(problem, 0))
    assert not made.thinned  # as where a plan is drawn beside them
    alike(
        maker(KeptFiles(tmp_path / "kept"), problem, alike=True)(0, brief), made
    )  # the whole ones, once they are there


@pytest.mark.long
def test_what_is_kept_of_a_mesh_is_never_that_of_another_edit(tmp_path: Path) -> None:
    """One store over all edits, in first looks and whole ones: targets and solids are those made without."""
    data, part = small_forming.problem(strategy="virgin"), small_forming.dish()
    deeper = part.vertices * [1.0, 1.0, 1.0 + 1e-7]
    edits: list[tuple[Mesh, dict[str, Any]]] = [
        (part, data),
        (Mesh(deeper, part.faces), data),
        (part, {**data, "sheet": data["sheet"] | {"thickness_mm": 0.999}}),
        (part, {**data, "operations": [data["operations"][0] | {"stepdown_mm": 2.5}]}),
        (part, {**data, "operations": [data["operations"][0] | {"feature_step_mm": 0.4}]}),
        (part, data),
    ]
    kept, solids, made = KeptFiles(tmp_path / "kept"), [], []
    for number, (mesh, one) in enumerate(edits):
        (folder := tmp_path / str(number)).mkdir()
        path = small_forming.write(folder, one, mesh)
        with use_cache(kept):
            problem = pipeline.load(path)
            few, whole = (registry.job(problem, 0, brief=brief).targets() for brief in (True, False))
        fresh = pipeline.load(path)
        alike(few, registry.job(fresh, 0, brief=True).targets())
        alike(whole, registry.job(fresh, 0).targets())
        assert few.thinned and not whole.thinned
        own, other = (item.found_by(0).stock.sheet.formed for item in (problem, fresh))  # type: ignore[union-attr]
        for a, b in zip(own, other, strict=True):
            np.testing.assert_array_equal(a.vertices, b.vertices)
        solids.append(own[0].vertices)
        made.append(whole.pose["robot"])
    assert not np.array_equal(solids[0], solids[1]) and not np.array_equal(solids[0], solids[2])
    assert all(not np.array_equal(made[0], made[k]) for k in (1, 2, 3))
    assert np.array_equal(made[0], made[-1])


def test_a_first_look_says_whether_it_is_of_fewer_targets(tmp_path: Path) -> None:
    formed = pipeline.load(small_forming.write(tmp_path, small_forming.problem()))
    found = pipeline.looked_over(formed, 4)
    assert found.thinned and found.targets == 4 and not has_errors(found.issues)
    (tmp_path / "other").mkdir()
    assert not pipeline.looked_over(small(tmp_path / "other"), 4).thinned


def densified(way: Any, step: float) -> Any:
    """Places on straight moves between places (N, 3), no farther apart than ``step`` [m]."""
    out = [way[:1]]
    for a, b in itertools.pairwise(way):
        count = int(np.linalg.norm(b - a) / step) + 1
        out.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(out)


no_job: Any = object()


def alike(one: Targets, other: Targets) -> None:
    assert one.arms == other.arms and one.frame == other.frame and one.segment == other.segment
    for arm in one.arms:
        np.testing.assert_array_equal(one.pose[arm], other.pose[arm])
    np.testing.assert_array_equal(one.feed, other.feed)
    for a, b in zip(one.freedoms, other.freedoms, strict=True):
        np.testing.assert_array_equal(a.lower, b.lower)
        np.testing.assert_array_equal(a.upper, b.upper)
