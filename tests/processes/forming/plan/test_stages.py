"""Forming in stages and around holes: the initial sheet state of each operation, and refused operations."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.cell.clearance import find_overlaps
from planner.cell.plant import build_cell_model
from planner.issues import Issue, TandemError
from planner.problem import Problem, SheetHole, Stock
from planner.processes import registry
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.stages import formed_sheet, hole_issues, sheet_exhibit
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.processes.forming.proof.rules.part import check_forming_part
from planner.processes.trim.plan.job import TrimJob
from planner.proof.context import Context
from tests.processes.forming.plan.staged import BALL, DEPTHS, HOLE, SUMP_RADIUS, part, problem
from tests.processes.trim.plan.small_trim import data
from tests.small_forming import die, dish, dish_with_a_dome, upside_down, write
from tests.small_forming import problem as one_forming

ACROSS = 1.0 / np.cos(np.deg2rad(15.0))
"""Longest cut [mm] through a sheet of 1 mm by a torch that leans up to 15 degrees."""


def refused(folder: Path, index: int, **changes: Any) -> list[Issue]:
    with pytest.raises(TandemError) as error:
        registry.job(problem(folder, **changes), index).targets()
    return [issue for issue in error.value.issues if issue.severity.name == "ERROR"]


def hole(x: float, diameter: float = 5.0, **more: Any) -> dict[str, Any]:
    return {"name": "hole", "circle": {"at_mm": [x, 0], "diameter_mm": diameter}, **more}


def test_a_stage_leaves_the_sheet_with_its_features_alone(tmp_path: Path) -> None:
    read = problem(tmp_path)
    first, second = (registry.job(read, k) for k in (0, 2))
    assert isinstance(first, FormingJob) and isinstance(second, FormingJob)
    made, then = first.planned, second.planned
    assert [forming_pass.name for forming_pass in made.passes] == ["f1"] and made.previous_features == ()
    assert [forming_pass.name for forming_pass in then.passes] == ["f2"] and then.previous_features == (1,)
    # the sump is the only thing below the dish's floor, so without it the sheet is the part cut off there
    expected = np.maximum(part().vertices[:, 2], -DEPTHS[0] * 1e-3)
    assert np.allclose(np.sort(made.formed_mesh.vertices[:, 2]), np.sort(expected), atol=1e-6)
    assert np.array_equal(then.formed_mesh.vertices, then.mesh.vertices)
    flat = formed_sheet(made.mesh, made.tree, ())
    assert np.allclose(flat.vertices[:, 2], 0.0, atol=1e-9)


def test_a_torch_between_two_stages_follows_the_sheet_as_it_is_then(tmp_path: Path) -> None:
    job = registry.job(problem(tmp_path), 1)
    assert isinstance(job, TrimJob)
    top, low = job.face.at(np.array([[0.0, 0.0], [0.036, 0.0]]))[0][:, 2]
    assert top == pytest.approx((1.0 - DEPTHS[0]) * 1e-3, abs=1e-6)  # no sump yet; a sheet of 1 mm
    assert -0.007 < low < 0.001


def test_a_torch_before_all_forming_finds_a_flat_sheet(tmp_path: Path) -> None:
    whole = data(outlines=[HOLE])
    (trim,) = whole["operations"]
    torch = whole["cell"]["arms"][0]["tool"]
    form = {"name": "form", "process": "forming", "arms": ["robot"], "mode": "spif", "stepdown_mm": 2}
    ball = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
    whole["operations"] = [trim, {**form, "setup": {"tools": {"robot": ball}}}]
    assert torch["kind"] == "torch"
    job = registry.job(pipeline.load(write(tmp_path, whole, part())), 0)
    assert isinstance(job, TrimJob)
    assert np.allclose(job.face.mesh.vertices[:, 2], 0.001, atol=1e-9)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ({"features": [1, 2]}, {"features": [2]}, "sump: feature 2 is already formed by dish"),
        ({"features": None}, {"features": [2]}, "sump: feature 2 is already formed by dish"),
        ({"features": [1]}, {"features": [3, 2]}, "sump: feature 3 is not in the part, which has 1 to 2"),
        ({"features": [1]}, {"features": [5]}, "sump: feature 5 is not in the part, which has 1 to 2"),
    ],
)
def test_features_that_do_not_add_up_to_the_part_are_refused(
    tmp_path: Path, first: dict[str, Any], second: dict[str, Any], words: str
) -> None:
    (issue,) = refused(tmp_path, 2, first=first, second=second)
    assert (issue.code, issue.message) == ("forming.features", words)
    assert issue.hint


def test_a_feature_that_nothing_forms_is_told(tmp_path: Path) -> None:
    whole = data()
    whole["operations"] = [
        {"name": "dish", "process": "forming", "arms": ["robot"], "mode": "spif", "stepdown_mm": 2}
        | {"features": [1]}
    ]
    whole["cell"]["arms"][0]["tool"] = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
    with pytest.raises(TandemError) as error:
        registry.job(pipeline.load(write(tmp_path, whole, part())), 0).targets()
    (issue,) = error.value.issues
    assert issue.code == "forming.features"
    assert issue.message == "dish: feature 2 is formed by no operation"


def test_an_order_with_a_feature_of_another_operation_says_so(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, 2, second={"order": [2, 1]})
    assert issue.code == "forming.order"
    assert "feature 1 is formed by another operation; name each of 2 once" in issue.message


def test_what_stands_on_a_feature_is_not_formed_in_place_before_it(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, 0, first={"features": [2]}, second={"features": [1]})
    assert issue.code == "forming.order"
    assert "feature 2 comes before its parent, feature 1" in issue.message


def test_the_part_may_be_formed_from_the_inside_out_over_two_stages(tmp_path: Path) -> None:
    changes = {"first": {"features": [2], "strategy": "virgin"}, "second": {"features": [1]}}
    first = registry.job(problem(tmp_path, **changes), 0)
    assert isinstance(first, FormingJob)
    (forming_pass,) = first.planned.passes
    assert forming_pass.start == pytest.approx(
        0.001, abs=1e-6
    )  # on the flat sheet of 1 mm, not on the dish's floor
    # what was cut in what sinks then would be moved
    (issue,) = refused(tmp_path, 2, **changes)
    assert issue.code == "forming.holes"
    assert issue.message.startswith("hole, which was cut before, lies in what f1 forms")


def on_a_virgin_sheet(folder: Path, stages: bool, **cell: Any) -> Problem:
    """A dome of 5 mm up in a dish of 8 mm, formed first on the virgin sheet: there it stands 5 mm above the
    flat, where the finished part has nothing. By one operation, or by two."""
    whole = one_forming("dsif", strategy="virgin")
    (own,) = whole["operations"]
    if stages:
        whole["operations"] = [
            {**own, "name": "dome", "features": [2]},
            {**own, "name": "dish", "features": [1], "strategy": "in_place", "setup": {"note": "as told"}},
        ]
    whole["sheet"] |= {"size_mm": [220, 220], "opening_mm": 150}
    whole["cell"] |= cell
    return pipeline.load(write(folder, whole, dish_with_a_dome(60)))


def test_bodies_keep_clear_of_what_stands_out_before_the_part_is_finished(tmp_path: Path) -> None:
    """A bar 3 mm over the sheet is clear of the finished part, whose highest place is its rim, but inside of
    the dome as that is at first, 5 mm high; both planner and proof ask this model."""
    shape = {"kind": "box", "size_mm": [60, 4, 4], "pose": {"xyz_mm": [0, 0, 6]}}
    found = on_a_virgin_sheet(tmp_path, False, obstacles=[{"name": "bar", "shapes": [shape]}])
    setup = found.setups[0]
    (pair,) = [
        one
        for one in find_overlaps(build_cell_model(setup.cell, setup.stock, np.eye(4)))
        if set(one[:2]) == {"bar", "stock"}
    ]
    assert pair[2] == pytest.approx(0.002, abs=2e-4)  # dome of 5 mm and sheet of 1 mm, less 4 mm
    assert registry.job(found, 0).targets().arms == ("left", "right")


@pytest.mark.parametrize("stages", [False, True])
def test_the_proof_finds_states_that_bodies_do_not_keep_clear_of(tmp_path: Path, stages: bool) -> None:
    found = on_a_virgin_sheet(tmp_path, stages)
    assert not part_messages(found)
    sheet = found.stock.sheet
    assert sheet is not None
    finished = dataclasses.replace(sheet, formed=sheet.formed[:1])
    (message,) = part_messages(
        dataclasses.replace(found, stock=dataclasses.replace(found.stock, sheet=finished))
    )
    assert message.startswith("once form/f2 is formed the sheet protrudes from the solids")


def part_messages(loaded: Problem) -> list[str]:
    """What the proof says, of claims alone, of the part that is formed."""
    forming = FormingFacts.__new__(FormingFacts)  # of a text there is no need
    forming.context = Context(loaded, registry.claims(loaded), {})
    forming.context.put(FORMING, forming)
    return [issue.message for issue in check_forming_part(forming.context).issues]


@pytest.mark.parametrize(
    ("x", "diameter", "got", "words"),
    [
        # off the sump's edge by x less both radii, and what a torch leans through the sheet
        (22.0, 5.0, 22.0 - 2.5 - SUMP_RADIUS - ACROSS, "mm away from what f2 forms"),
        (10.0, 5.0, 0.0, "lies in what f2 forms"),
        (0.0, 40.0, 0.0, "lies in what f2 forms"),
    ],
)
def test_holes_that_forming_would_move_or_tear_are_refused_with_the_distance(
    tmp_path: Path, x: float, diameter: float, got: float, words: str
) -> None:
    found = refused(tmp_path, 2, hole=hole(x, diameter))
    (issue,) = [one for one in found if one.code == "forming.holes"]
    assert issue.value == pytest.approx(got, abs=0.6)  # where a feature begins it is hardly off the flat
    assert (issue.limit, issue.unit) == (5.0, "mm")
    assert words in issue.message and "hole" in issue.message and "hole_margin_mm" in issue.message
    assert issue.hint is not None and "before the sheet is cut" in issue.hint


def test_tools_keep_off_holes_with_their_own_radius(tmp_path: Path) -> None:
    job = registry.job(problem(tmp_path, hole=hole(28.0)), 2)
    assert isinstance(job, FormingJob)
    holes = job.planned.sheet.holes
    ((one, path),) = make_tool_paths(job.planned)
    assert not list(hole_issues(holes, 0.005, [(one, path)], [(0.006, 0.0)]))
    aside = dataclasses.replace(path, forming_centre=path.forming_centre + np.array([0.006, 0.0, 0.0]))
    (issue,) = hole_issues(holes, 0.005, [(one, aside)], [(0.006, 0.0)])
    assert issue.value is not None
    way = 1e3 * float(aside.forming_centre[:, 0].max())
    assert issue.value == pytest.approx(28.0 - 2.5 - way - 6.0 - ACROSS, abs=0.05)
    assert "in f2 a tool comes within" in issue.message
    (late,) = hole_issues(holes, 0.005, [(one, aside)], [(0.006, 0.0)], slack=0.0003)
    assert late.value == pytest.approx(issue.value - 0.3)  # what tools may be off their ways


def test_a_smaller_margin_and_a_hole_farther_away_help(tmp_path: Path) -> None:
    assert registry.job(problem(tmp_path, hole=hole(22.0), second={"hole_margin_mm": 2.8}), 2).targets().count
    reported = registry.job(problem(tmp_path), 2).targets().issues
    (note,) = [one for one in reported if one.code == "forming.springback"]
    assert "not predicted" in note.message


def test_a_sheet_that_was_cut_off_its_clamp_is_not_formed(tmp_path: Path) -> None:
    (issue,) = refused(tmp_path, 2, hole=hole(0.0, 100.0, drops="outside"))
    assert issue.code == "forming.holes"
    assert "so the clamp holds nothing" in issue.message


@pytest.mark.parametrize("kind", ["male", "female"])
def test_a_sheet_that_was_cut_is_not_formed_over_a_die(tmp_path: Path, kind: str) -> None:
    # 14 mm off the cone: far enough for the margin, but a holder that sinks takes the cut edge along
    mesh = upside_down(dish(around=96)) if kind == "male" else dish(around=96)
    whole = data(outlines=[hole(60.0)])
    whole["operations"].append(
        {"name": "dish", "process": "forming", "arms": ["robot"], "mode": "tpif", "stepdown_mm": 1}
        | {"die": die(tmp_path, mesh, kind, True), "setup": {"tools": {"robot": BALL}}}
    )
    whole["sheet"] |= {"opening_mm": 150, "size_mm": [200, 200]}
    whole["accept"] = ["forming.force", "forming.die_far"]
    with pytest.raises(TandemError) as error:
        registry.job(pipeline.load(write(tmp_path, whole, mesh)), 1).targets()
    (issue,) = [one for one in error.value.issues if one.code == "forming.holes"]
    assert issue.message == "the sheet was cut along hole before; in tpif all of it moves against the die"
    assert issue.hint == "form it before it is cut, or use another mode"


def two(folder: Path, first: dict[str, Any], second: dict[str, Any]) -> Problem:
    """Two operations on a plain dish."""
    whole = one_forming("spif")
    (own,) = whole["operations"]
    ops = [{**own, "stepdown_mm": 1, **first}, {**own, "name": "second", "stepdown_mm": 1, **second}]
    return pipeline.load(write(folder, {**whole, "operations": ops}, dish()))


def test_levels_of_a_pass_may_be_operations_of_one_problem(tmp_path: Path) -> None:
    whole = two(tmp_path, {"level": {"number": 0}}, {"level": {"number": 1}, "setup": {"note": "scanned"}})
    for k in (0, 1):
        assert registry.job(whole, k).targets().count
    with pytest.raises(TandemError, match="formed by"):
        registry.job(two(tmp_path, {}, {"level": {"number": 1}}), 1).targets()


def test_a_sheet_that_is_clamped_anew_does_not_stay_clamped(tmp_path: Path) -> None:
    for change, stays in (({}, True), ({"place": {"xyz_mm": [700, 0, 500]}}, False)):
        whole = two(tmp_path, {"features": [1]}, {"features": [1], "setup": {"note": "as told", **change}})
        sheet = whole.setup_on_arrival(0).stock.sheet
        assert sheet is not None and sheet.stages is not None
        assert sheet.stages.stays_clamped is stays


def test_an_operation_of_another_process_is_no_stage(tmp_path: Path) -> None:
    """Packages add processes, whose fields may be named as those of forming."""

    @dataclasses.dataclass(frozen=True)
    class Marks:
        name: str
        process: str
        arms: tuple[str, ...]
        features: tuple[int, ...] | None = None
        level: None = None

        def leaves(self, stock: Stock) -> Stock:
            return stock

    whole = problem(tmp_path)
    dish_first, _, sump = whole.operations
    ops = (dish_first, Marks("marks", "marks", ("robot",)), sump)
    assert registry.job(dataclasses.replace(whole, operations=ops), 0).targets().count


@pytest.mark.parametrize("inside", [True, False])
def test_what_is_shown_has_its_holes(inside: bool) -> None:
    mesh = part()
    turn = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    ring = 0.01 * np.stack([np.cos(turn), np.sin(turn)], axis=1) + [0.02, 0.0]
    (one,) = sheet_exhibit(mesh, [SheetHole("hole", ring, inside)], "cut").values()
    whole, left = (
        0.5 * float(np.abs(np.linalg.det(np.diff(v[f][:, :, :2], axis=1))).sum())
        for v, f in ((mesh.vertices, mesh.faces), (one["vertices"], one["faces"]))
    )
    hole = np.pi * 0.01**2
    assert left == pytest.approx(whole - hole if inside else hole, abs=0.02 * hole)


@pytest.mark.parametrize("inside", [True, False])
def test_a_hole_beyond_the_mesh_of_the_part_leaves_what_is_shown(inside: bool) -> None:
    mesh = part()
    ring = 0.01 * np.array([[10.0, 0.0], [11.0, 0.0], [10.0, 1.0]])
    found = sheet_exhibit(mesh, [SheetHole("hole", ring, inside)], "cut")
    assert [len(one["faces"]) for one in found.values()] == ([len(mesh.faces)] if inside else [])


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"features": [2, 2]}, "numbers start at 1; name each once"),
        ({"features": [0]}, "numbers start at 1; name each once"),
        ({"features": []}, "has 0 entries, at least 1 required"),
        ({"springback": {"file": "back.json"}}, "level and springback are not supported"),
        ({"hole_margin_mm": 0}, "hole_margin_mm"),
        ({"features": 2}, "operations.2.features: expected a list, got 2; put it in brackets: [..]"),
    ],
)
def test_what_cannot_be_a_stage_is_refused_by_its_field(
    tmp_path: Path, fields: dict[str, Any], words: str
) -> None:
    with pytest.raises(TandemError) as error:
        problem(tmp_path, second=fields)
    assert any(words in str(issue) for issue in error.value.issues)


def test_operations_of_one_setup_find_what_was_cut_in_it(tmp_path: Path) -> None:
    whole = data(outlines=[HOLE])
    (trim,) = whole["operations"]
    arm = whole["cell"]["arms"][0]
    ball = {"kind": "ball_tool", "radius_mm": 6, "length_mm": 180}
    turned = {"xyz_mm": [0, 1500, 0], "rpy_deg": [0, 0, -90]}
    whole["cell"]["arms"].append({**arm, "name": "other", "tool": ball, "base": turned})
    whole["cell"]["controller"] = {}
    form = {"name": "form", "process": "forming", "arms": ["other"], "mode": "spif", "stepdown_mm": 2}
    whole["operations"] = [trim, form]
    read = pipeline.load(write(tmp_path, whole, part()))
    assert len(read.setups) == 1
    found = registry.job(read, 1).setup.stock.sheet
    assert found is not None and [hole.name for hole in found.holes] == ["hole"]
