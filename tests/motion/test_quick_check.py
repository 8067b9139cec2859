"""A quick check of some targets reports the same about them as the complete check, and no more."""

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
from planner.motion import quick_check
from planner.motion.quick_check import QuickCheck
from planner.problem import Problem
from planner.processes import registry
from planner.reading import strict_yaml
from planner.runtime.memoize import use_cache
from planner.service.file_cache import FileCache
from planner.service.target_cache import cached_targets_maker, equivalence_digest, used_values_digest
from planner.targets import Targets
from tests import small_forming, small_problem

UNREACHABLE_ROW = "2450,50,500,0.5,-0.5,0.5,0.5,20"
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
    look = QuickCheck((1000, 10, 1), 40)
    first, second, third = (look.target_rows(k) for k in range(3))
    assert first[0] == 0 and first[-1] == 999 and len(first) == 40
    assert np.ptp(np.diff(first)) <= 1
    assert second.tolist() == [0, 9]
    assert third.tolist() == [0]


def test_a_problem_with_a_path_has_no_fault_at_any_share(tmp_path: Path) -> None:
    problem = small(tmp_path, rows=dense(60))
    for most, looked in ((5, 5), (1000, 60)):
        result = pipeline.quick_check(problem, most)
        assert (result.checked, result.total) == (looked, 60)
        assert not has_errors(result.issues)
    whole = pipeline.quick_check(problem, None)
    assert (whole.checked, whole.total) == (60, 60)
    assert whole.issues == pipeline.check(problem)


def test_what_is_out_of_reach_is_told_as_the_whole_check_tells_it(tmp_path: Path) -> None:
    problem = small(tmp_path, rows=[*dense(59), UNREACHABLE_ROW])
    result = pipeline.quick_check(problem, 6)
    (fault,) = (issue for issue in result.issues if issue.code.startswith("motion."))
    (whole,) = (issue for issue in pipeline.check(problem, advise=False) if issue.code.startswith("motion."))
    assert (fault.code, fault.target, fault.index) == (whole.code, whole.target, whole.index)
    assert (fault.code, fault.index) == ("motion.no_reach", 59)
    assert fault.value == pytest.approx(whole.value)
    assert (result.checked, result.total) == (6, 60)


def test_a_fault_between_the_targets_is_left_to_the_whole_check(tmp_path: Path) -> None:
    """One of sixty targets is out of reach, and is not among those that are checked."""
    rows = dense(60)
    rows[7] = UNREACHABLE_ROW
    problem = small(tmp_path, rows=rows)
    assert 7 not in QuickCheck((60,), 6).target_rows(0)
    assert not has_errors(pipeline.quick_check(problem, 6).issues)
    assert has_errors(pipeline.check(problem, advise=False))
    assert has_errors(pipeline.quick_check(problem, 60).issues)


def test_what_stands_in_the_way_is_found(tmp_path: Path) -> None:
    text = small_problem.PROBLEM.replace("\nstock:", POST + "stock:")
    result = pipeline.quick_check(small(tmp_path, text), 6)
    (fault,) = (issue for issue in result.issues if issue.code == "motion.collision")
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
    result = []
    for together in (1, 8, 100_000):
        monkeypatch.setattr(quick_check, "FIRST_BATCH", together)
        result.append(pipeline.quick_check(problem, 6))
    assert result[0] == result[1] == result[2]
    assert result[0].total == 6


def test_a_place_that_is_searched_is_found_or_left_to_the_whole_check(tmp_path: Path) -> None:
    searched = small_problem.PROBLEM.replace("place: {xyz_mm: [450, 0, 0]}", "place: auto")
    searched = searched.replace("frame: world", "frame: stock") + "accept: [stock.hangs]\n"
    rows = [f"50,{y},150,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]
    result = pipeline.quick_check(small(tmp_path, searched, rows), 6)
    assert not has_errors(result.issues) and result.is_placed and result.checked == 6
    apart = ["-2000,0,150,0.5,-0.5,0.5,0.5,20", *rows, "2000,0,150,0.5,-0.5,0.5,0.5,20"]
    result = pipeline.quick_check(small(tmp_path, searched, apart), 6)
    assert not result.is_placed and not has_errors(result.issues)  # the whole check searches on
    codes = {issue.code for issue in pipeline.check(small(tmp_path, searched, apart), advise=False)}
    assert "motion.no_placement" in codes


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


def read_data(name: str) -> dict[str, Any]:
    problem = pipeline.load(name)
    return json.loads(json.dumps(problem.source, default=str))  # type: ignore[no-any-return]


@pytest.mark.parametrize("change", [*UNSEEN, *SEEN])
def test_edits_of_what_no_process_sees_are_told_from_others(change: Callable[[dict[str, Any]], None]) -> None:
    data = read_data("wing")
    before = used_values_digest(data)
    change(data)
    assert (used_values_digest(data) == before) == (change in UNSEEN)


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
        data = read_data(name)
    first = tmp_path / "first.yaml"
    first.write_text(strict_yaml.dump(data))
    for change in (move_arm, put_an_obstacle, keep_more_room, rename):
        change(data)
    if isinstance(data.get("stock", {}).get("place"), dict):
        data["stock"]["place"]["xyz_mm"] = [v + 10 for v in data["stock"]["place"]["xyz_mm"]]
    second = tmp_path / "second.yaml"
    second.write_text(strict_yaml.dump(data))
    item, other = pipeline.load(first), pipeline.load(second)
    assert item.digest != other.digest and equivalence_digest(item) == equivalence_digest(other)
    for index, (a, b) in enumerate(zip(registry.jobs(item), registry.jobs(other), strict=True)):
        made = cached_targets_maker(FileCache(tmp_path / "kept"), item, accept_equivalent=True)(index, a)
        kept = cached_targets_maker(FileCache(tmp_path / "kept"), other, accept_equivalent=True)(
            index, no_job
        )
        require_equal_targets(kept, made)
        require_equal_targets(kept, b.targets())
        few = registry.job(other, index, brief=True).targets()
        assert few.is_subsampled == (name == "dish")
        if not few.is_subsampled:  # what a first look does not judge shapes none
            require_equal_targets(few, made)
        with pytest.raises(AttributeError):  # a whole check makes its own
            cached_targets_maker(FileCache(tmp_path / "kept"), other, accept_equivalent=False)(index, no_job)


def test_a_block_that_leans_otherwise_is_seen(tmp_path: Path) -> None:
    """Loose pieces fall in another direction: rotated about the vertical nothing changes, tilted it does."""
    data = read_data("gauge_lanes")
    result = []
    for turn in ([0, 0, 0], [0, 0, 30], [90, 0, 0]):
        data["stock"]["place"]["rpy_deg"] = turn
        (tmp_path / "p.yaml").write_text(strict_yaml.dump(data))
        result.append(equivalence_digest(pipeline.load(tmp_path / "p.yaml")))
    assert result[0] == result[1] != result[2]


@pytest.mark.long
def test_fewer_loops_of_a_formed_sheet_are_as_true_as_all_and_kept_for_first_looks_alone(
    tmp_path: Path,
) -> None:
    problem = pipeline.load(small_forming.write(tmp_path, small_forming.problem()))
    few, whole = (registry.job(problem, 0, brief=brief).targets() for brief in (True, False))
    assert few.is_subsampled and not whole.is_subsampled and 2 * few.count < whole.count
    works = [np.array([one.works for one in item.segment]) for item in (few, whole)]
    at, way = (item.pose["robot"][rows][:, :3, 3] for item, rows in zip((few, whole), works, strict=True))
    step = 1e-3 * problem.operations[0].stepdown_mm  # type: ignore[attr-defined]
    deviation = cKDTree(densify(way, 0.1 * step)).query(at)[0]
    assert deviation.max() < 1.1 * step  # between two of its loops
    assert np.ptp(at[:, 2]) == pytest.approx(np.ptp(way[:, 2]), abs=1e-6)
    brief = registry.job(problem, 0, brief=True)
    first = cached_targets_maker(FileCache(tmp_path / "kept"), problem, accept_equivalent=True)(0, brief)
    require_equal_targets(
        cached_targets_maker(FileCache(tmp_path / "kept"), problem, accept_equivalent=True)(
            0, registry.job(problem, 0, brief=True)
        ),
        first,
    )
    made = cached_targets_maker(FileCache(tmp_path / "kept"), problem, accept_equivalent=True)(
        0, registry.job(problem, 0)
    )
    assert not made.is_subsampled  # as where a plan is drawn beside them
    require_equal_targets(
        cached_targets_maker(FileCache(tmp_path / "kept"), problem, accept_equivalent=True)(0, brief), made
    )  # the whole ones, once they are there


@pytest.mark.long
def test_what_is_kept_of_a_mesh_is_never_that_of_another_edit(tmp_path: Path) -> None:
    """One cache over all edits, in quick and complete checks: results equal those without a cache."""
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
    kept, solids, made = FileCache(tmp_path / "kept"), [], []
    for number, (mesh, one) in enumerate(edits):
        (folder := tmp_path / str(number)).mkdir()
        path = small_forming.write(folder, one, mesh)
        with use_cache(kept):
            problem = pipeline.load(path)
            few, whole = (registry.job(problem, 0, brief=brief).targets() for brief in (True, False))
        fresh = pipeline.load(path)
        require_equal_targets(few, registry.job(fresh, 0, brief=True).targets())
        require_equal_targets(whole, registry.job(fresh, 0).targets())
        assert few.is_subsampled and not whole.is_subsampled
        own, other = (item.setup_on_arrival(0).stock.sheet.formed for item in (problem, fresh))  # type: ignore[union-attr]
        for a, b in zip(own, other, strict=True):
            np.testing.assert_array_equal(a.vertices, b.vertices)
        solids.append(own[0].vertices)
        made.append(whole.pose["robot"])
    assert not np.array_equal(solids[0], solids[1]) and not np.array_equal(solids[0], solids[2])
    assert all(not np.array_equal(made[0], made[k]) for k in (1, 2, 3))
    assert np.array_equal(made[0], made[-1])


def test_a_first_look_says_whether_it_is_of_fewer_targets(tmp_path: Path) -> None:
    formed = pipeline.load(small_forming.write(tmp_path, small_forming.problem()))
    result = pipeline.quick_check(formed, 4)
    assert result.is_subsampled and result.checked == 4 and not has_errors(result.issues)
    (tmp_path / "other").mkdir()
    assert not pipeline.quick_check(small(tmp_path / "other"), 4).is_subsampled


def densify(waypoints: Any, step: float) -> Any:
    """Return points on straight moves between points (N, 3), at most ``step`` [m] apart."""
    out = [waypoints[:1]]
    for a, b in itertools.pairwise(waypoints):
        count = int(np.linalg.norm(b - a) / step) + 1
        out.append(a + np.linspace(0.0, 1.0, count + 1)[1:, None] * (b - a))
    return np.concatenate(out)


no_job: Any = object()


def require_equal_targets(targets: Targets, other: Targets) -> None:
    assert targets.arms == other.arms and targets.frame == other.frame and targets.segment == other.segment
    for arm in targets.arms:
        np.testing.assert_array_equal(targets.pose[arm], other.pose[arm])
    np.testing.assert_array_equal(targets.feed, other.feed)
    for a, b in zip(targets.freedoms, other.freedoms, strict=True):
        np.testing.assert_array_equal(a.lower, b.lower)
        np.testing.assert_array_equal(a.upper, b.upper)
