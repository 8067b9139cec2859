"""The forming process as a whole: targets and claims of every mode, independently checked on the mesh."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial import Delaunay

from planner import pipeline
from planner.claims.claim import Claim
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.geometry.arrays import Mesh
from planner.geometry.units import DEG, MM
from planner.issues import Severity, TandemError
from planner.problem import Problem
from planner.processes import registry
from planner.processes.forming.claims import (
    FollowsOpposite,
    FormingFeed,
    FormsByTable,
    FormsInOrder,
    FormsPart,
    FormsSheet,
    LimitsToolTilt,
    SheetState,
    SupportsBorder,
    ToolGap,
)
from planner.processes.forming.plan.features.pass_shape import merge_meshes, polygons, triangulate
from planner.processes.forming.plan.process_plan import FormingWork, prepare_work
from planner.reading.sheet import CLAMP_BARS
from planner.targets import Targets
from tests import small_forming
from tests.processes.forming.plan import shapes

KINDS = ("helical", "contour", "alternating", "stepped")
MODES: dict[str, tuple[dict[str, Any], set[type]]] = {
    "spif": ({}, {FormsSheet, LimitsToolTilt}),
    "dsif": ({}, {FormsSheet, ToolGap, LimitsToolTilt}),
    "dpif_l": ({"shift_deg": 20}, {FormsSheet, ToolGap, LimitsToolTilt}),
    "dpif_p": ({}, {FormsSheet, SupportsBorder, LimitsToolTilt}),
    "heat": ({}, {FormsSheet, FollowsOpposite, LimitsToolTilt}),
    "adsif": ({}, {FormsByTable}),
}


class PlannedMode(NamedTuple):
    """A part's job and its targets."""

    mode: str
    part: Mesh
    problem: Problem
    targets: Targets


def problem(folder: Path, mode: str = "spif", part: Mesh | None = None, **operation: Any) -> Problem:
    return pipeline.load(small_forming.write(folder, small_forming.problem(mode, **operation), part))


def work_of(loaded: Problem) -> FormingWork:
    return prepare_work(loaded.operations[0], loaded.setups[0], loaded.part)  # type: ignore[arg-type]


def gentle() -> Mesh:
    """A cone whose wall the table of accumulative forming knows, with sharp edges."""
    return shapes.cone(25.0, 0.004, 0.02, 96)


def upside_down(part: Mesh) -> Mesh:
    return Mesh(part.vertices * [1.0, 1.0, -1.0], part.faces[:, ::-1])


def notched() -> Mesh:
    """A smooth basin whose outline no point sees all of."""
    outline = shapely.box(-0.036, -0.03, 0.036, 0.03).difference(shapely.box(-0.012, -0.005, 0.012, 0.04))
    outline = outline.buffer(-0.007).buffer(0.015).buffer(-0.008)
    grid = (
        np.stack(np.meshgrid(np.arange(-48, 49, 1.5), np.arange(-42, 43, 1.5)), axis=-1).reshape(-1, 2) * MM
    )
    lines = [outline.buffer(-d * MM).boundary.segmentize(1.5 * MM) for d in np.arange(0.0, 8.0, 0.75)]
    near = shapely.distance(shapely.union_all(lines), shapely.points(grid)) < 0.6 * MM
    points = np.unique(np.concatenate([grid[~near], shapely.get_coordinates(lines)]).round(9), axis=0)
    inside = shapely.contains_xy(outline, points[:, 0], points[:, 1])
    deep = np.where(inside, shapely.distance(outline.boundary, shapely.points(points)), 0.0)
    fraction = np.clip(deep / 0.0075, 0.0, 1.0)
    z = -0.0008 * fraction**2 * (3.0 - 2.0 * fraction)
    return Mesh(np.column_stack([points, z]), Delaunay(points).simplices.astype(np.int64))


def facing_up(part: Mesh) -> Mesh:
    """The part with the normals of all its faces up."""
    corners = part.vertices[part.faces]
    down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0.0
    return Mesh(part.vertices, np.where(down[:, None], part.faces[:, ::-1], part.faces))


def pyramid(depth: float) -> Mesh:
    """A pit of four facets, as CAD systems write it."""
    vertices = np.array([[-20, -20, 0], [20, -20, 0], [20, 20, 0], [-20, 20, 0], [0, 0, -depth]]) * MM
    return Mesh(vertices, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))


def is_same(first: Any, second: Any) -> bool:
    if isinstance(first, np.ndarray):
        return isinstance(second, np.ndarray) and np.array_equal(first, second)
    if dataclasses.is_dataclass(first):
        return type(first) is type(second) and all(
            is_same(getattr(first, field.name), getattr(second, field.name))
            for field in dataclasses.fields(first)
        )
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(is_same, first, second))
    return bool(first == second)


def centres(targets: Targets, arm: str, segment: str) -> np.ndarray:
    return targets.pose[arm][[str(one) == segment for one in targets.segment], :3, 3]


def refusal(loaded: Problem) -> dict[str, str]:
    with pytest.raises(TandemError) as caught:
        registry.job(loaded, 0).targets()
    return {issue.code: f"{issue.message} {issue.hint}" for issue in caught.value.issues}


@pytest.fixture(scope="module", params=MODES)
def planned_mode(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PlannedMode:
    """A dish in every mode, or a gentle cone where only that can be formed."""
    part = gentle() if request.param == "adsif" else small_forming.dish()
    found = problem(tmp_path_factory.mktemp("mode"), request.param, part, **MODES[request.param][0])
    return PlannedMode(request.param, part, found, registry.job(found, 0).targets())


def test_targets_of_every_mode(planned_mode: PlannedMode) -> None:
    (_, kinds), found, targets = MODES[planned_mode.mode], planned_mode.problem, planned_mode.targets
    count, forming = len(targets.segment), np.array([segment.works for segment in targets.segment])
    assert count == len(targets.feed) == len(targets.travel) == len(targets.stop)
    assert forming.sum() > 100
    for arm, pose in targets.pose.items():
        assert pose.shape == (count, 4, 4)
        np.testing.assert_allclose(np.linalg.det(pose[:, :3, :3]), 1.0)
        path_length = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
        assert (targets.travel[1:] >= path_length - 1e-12).all(), arm
    assert (targets.feed[forming] <= found.operations[0].feed_mm_s * MM + 1e-12).all()  # type: ignore[attr-defined]
    assert (targets.travel[1:] / targets.feed[1:] >= 0.005).all()
    assert targets.stop[[0, -1]].all()
    assert {type(claim) for claim in targets.claims} == {
        FormsPart,
        OperatorDialogue,
        FormsInOrder,
        SheetState,
        FormingFeed,
        *kinds,
    }
    assert is_same(targets.claims, registry.claims(found)["dish"])


def test_tools_begin_and_end_off_the_sheet(planned_mode: PlannedMode) -> None:
    part, targets, made = planned_mode.part, planned_mode.targets, work_of(planned_mode.problem)
    away = [k for k, segment in enumerate(targets.segment) if not segment.works]
    assert {0, len(targets.segment) - 1} <= set(away)
    low, high = float(part.vertices[:, 2].min()), MM
    for arm, pose in targets.pose.items():
        head = made.heads[arm]
        reach = head.radius if head.kind == "ball" else 0.0
        z = pose[away, 2, 3]
        off = z - high if made.above(arm) else low - z
        assert (off >= reach + 0.01 - 1e-9).all(), arm
        toward = pose[away, 2, 2]
        assert (toward < 0.0).all() if made.above(arm) else (toward > 0.0).all()


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("kind", KINDS)
def test_the_ball_is_on_the_mesh_and_never_in_it(tmp_path: Path, kind: str) -> None:
    found = problem(tmp_path, path=kind)
    targets, made = registry.job(found, 0).targets(), work_of(found)
    (forming_pass,) = made.passes
    centre = centres(targets, "robot", "form/f1")
    mesh = trimesh.Trimesh(forming_pass.vertices, forming_pass.faces, process=False)
    fraction = np.linspace(0.0, 1.0, 4)[:-1, None, None]
    between = ((1.0 - fraction) * centre[:-1] + fraction * centre[1:]).reshape(-1, 3)
    rng = np.random.default_rng(11)
    deviation = trimesh.proximity.closest_point(mesh, rng.permutation(between)[:1500])[1] - 6.0 * MM
    assert deviation.min() > -0.05 * MM  # the stated chord
    at = trimesh.proximity.closest_point(mesh, centre)[1] - 6.0 * MM
    assert at.min() > -2.5e-6
    assert np.quantile(at, 0.9) < 15e-6  # facets are chords of the smooth face that the ball is on


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("up", [False, True], ids=["down", "up"])
@pytest.mark.parametrize("squeeze", [1.0, 0.9])
def test_the_gap_is_the_sheet_by_the_sine_law(tmp_path: Path, up: bool, squeeze: float) -> None:
    part = shapes.revolved([(0.045, 0.0), (0.03, 0.0), (0.012, -0.018), (0.0, -0.018)], 120)  # 45 deg
    found = problem(tmp_path, "dsif", upside_down(part) if up else part, squeeze=squeeze)
    targets = registry.job(found, 0).targets()
    left, right = (centres(targets, arm, "form/f1") for arm in ("left", "right"))
    gap = np.linalg.norm(left - right, axis=1) - 10.0 * MM
    former = right if up else left
    # in the middle of the wall: the contact is where the ball's centre is R / sqrt(2) off the cone's line
    radius = np.linalg.norm(former[:, :2], axis=1)
    wall = (radius > 0.014) & (radius < 0.020)
    assert wall.sum() > 50
    np.testing.assert_allclose(gap[wall], squeeze * MM * np.cos(45.0 * DEG), atol=4e-6)
    assert (gap > squeeze * MM * np.cos(45.5 * DEG)).all()
    assert (gap < squeeze * MM + 2e-6).all()


@pytest.mark.long
def test_a_shifted_support_keeps_its_distance_and_turns_toward_the_vertical(tmp_path: Path) -> None:
    part = shapes.cone(45.0, 0.018, 0.03, 120)
    for shift in (20.0, 45.0):
        found = problem(tmp_path, "dpif_l", part, shift_deg=shift, stepdown_mm=3)
        targets = registry.job(found, 0).targets()
        left, right = (centres(targets, arm, "form/f1") for arm in ("left", "right"))
        line = (left - right) / np.linalg.norm(left - right, axis=1)[:, None]
        radius = np.linalg.norm(left[:, :2], axis=1)
        wall = (radius > 0.014) & (radius < 0.018)
        angle = np.arccos(line[wall, 2]) / DEG
        np.testing.assert_allclose(angle, max(45.0 - shift, 0.0), atol=0.6)


def test_a_support_too_large_for_a_bend_is_told_with_the_largest_that_fits(tmp_path: Path) -> None:
    turn = np.radians(np.linspace(20.0, 60.0, 9))  # a wall that turns steeper around 2.5 mm at the far face
    bend = np.column_stack([0.028 + 0.0025 * (np.sin(turn[0]) - np.sin(turn)), 0.0025 * (np.cos(turn) - 1.0)])
    bend[:, 1] -= bend[0, 1] + 0.017 * np.tan(turn[0])
    foot = bend[-1, 0] - (0.02 + bend[-1, 1]) / np.tan(turn[-1])
    bent = [(0.055, 0.0), (0.045, 0.0), *map(tuple, bend), (foot, -0.02), (0.0, -0.02)]
    part = shapes.revolved(bent, 120)
    (reported,) = {
        issue
        for issue in registry.job(problem(tmp_path, "dsif", part), 0).targets().issues
        if issue.code == "forming.support_radius"
    }
    assert reported.severity is Severity.WARNING
    assert "pass f1: on" in reported.message and "largest that fits" in reported.message


def test_a_step_deeper_than_the_part_is_refused_as_that(tmp_path: Path) -> None:
    part = shapes.cone(40.0, 0.006, 0.03, 96)
    reported = refusal(problem(tmp_path, "spif", part, stepdown_mm=7))
    assert list(reported) == ["forming.path_options"]
    assert "stepdown_mm is 7, allowed is up to 6" in reported["forming.path_options"]
    assert "a tenth of that, 0.6" in reported["forming.path_options"]
    assert registry.job(problem(tmp_path, "spif", part, stepdown_mm=0.6), 0).targets().count > 100


@pytest.mark.long
def test_a_ledge_that_no_step_in_height_forms_is_refused_and_scallop_forms_it(tmp_path: Path) -> None:
    """15 mm of 1 degree between two walls: one loop at its foot and one at its edge."""
    low = -4.0 - 15.0 * np.tan(np.radians(1.0))
    profile = [(46.0, 0.0), (38.0, 0.0), (34.0, -4.0), (19.0, low), (15.0, low - 4.0), (0.0, low - 4.0)]
    part = shapes.revolved([(r * MM, z * MM) for r, z in profile], 48)
    with pytest.raises(TandemError) as refused:
        registry.job(problem(tmp_path, "spif", part, stepdown_mm=1.0), 0).targets()
    (issue,) = (one for one in refused.value.issues if one.severity is Severity.ERROR)
    assert issue.code == "forming.path_options"
    assert issue.value is not None
    assert 30.0 < issue.value < 80.0
    assert "state scallop_mm: 0.01 instead of stepdown_mm" in str(issue.hint)
    assert registry.job(problem(tmp_path, "spif", part, scallop_mm=0.01), 0).targets().count > 300


@pytest.mark.long
def test_small_fillets_are_left_to_the_ball_where_the_stated_tolerance_allows_it(tmp_path: Path) -> None:
    """Fillets of 2 mm below walls of 40 degrees: a ball of 6 mm stays (6 - 2) (1 / cos 20 - 1) = 0.26 mm off.
    The tolerance that the refusal names is enough, and half of it is not."""
    part = small_forming.dish(fillet=2.0)
    reported = refusal(problem(tmp_path, "spif", part))
    named = re.search(r"unreached_mm: ([0-9.]+)", reported["forming.tool_radius"])
    assert named is not None and 0.24 < float(named[1]) < 0.30
    assert list(refusal(problem(tmp_path, "spif", part, unreached_mm=0.5 * float(named[1])))) == [
        "forming.unreached"
    ]
    targets = registry.job(problem(tmp_path, "spif", part, unreached_mm=float(named[1])), 0).targets()
    assert not any(issue.severity is Severity.ERROR for issue in targets.issues)
    assert targets.pose["robot"][:, 2, 3].min() == pytest.approx(-0.006 + 0.001 + 0.006, abs=1e-4)


def test_a_shift_beyond_the_wall_is_refused(tmp_path: Path) -> None:
    reported = refusal(problem(tmp_path, "dpif_l", shift_deg=41))["forming.shift"]
    assert "shift_deg is 41, allowed is 0 to 40.0" in reported
    with pytest.raises(TandemError, match="shift_deg belongs to mode dpif_l"):
        problem(tmp_path, "dsif", shift_deg=10)


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("outline", ["star", "notched"])
@pytest.mark.parametrize("tool", ["ball", "disk"])
def test_a_support_on_the_border_never_comes_over_the_part(tmp_path: Path, outline: str, tool: str) -> None:
    part = notched() if outline == "notched" else shapes.pit(shapes.star(0.045, 0.028), 30.0, 0.003)
    data = small_forming.problem("dpif_p", stepdown_mm=0.4)
    data["sheet"] |= {"size_mm": [240, 240], "opening_mm": 160}
    radius = 5.0 * MM
    if tool == "disk":
        data["cell"]["arms"][1]["tool"] = dict(small_forming.DISK, radius_mm=8, shaft_radius_mm=6)
        radius = 8.0 * MM
    found = pipeline.load(small_forming.write(tmp_path, data, part))
    targets, (one,) = registry.job(found, 0).targets(), work_of(found).passes
    place = centres(targets, "right", "form/f1")
    region = shapely.Polygon(one.region[:, :2])
    inside = shapely.LineString(place[:, :2]).distance(region)
    assert inside >= radius - 0.2 * MM
    far = shapely.distance(region, shapely.points(place[:, :2]))
    assert far.max() <= radius + 1.0 * MM
    np.testing.assert_allclose(place[:, 2], 0.0 if tool == "disk" else -radius, atol=1e-9)


def test_tools_that_reach_into_the_clamp_are_told_before_any_arm_is_asked(tmp_path: Path) -> None:
    """The disk of 20 mm goes round the dish 20 mm outside of its border, so that it reaches 40 mm farther."""
    data = small_forming.problem("dpif_p")
    data["cell"]["arms"][1]["tool"] = dict(small_forming.DISK)
    found = pipeline.load(small_forming.write(tmp_path, data))
    with pytest.raises(TandemError) as caught:
        registry.job(found, 0).targets()
    (issue,) = caught.value.issues
    border = np.linalg.norm(work_of(found).passes[0].region[:, :2], axis=1).max()
    assert (issue.code, issue.arm, issue.field) == ("forming.clamp", "right", "sheet.opening_mm")
    # the bars are chords of the opening's circle, and the support keeps 0.3 mm outside of its border
    assert issue.value == pytest.approx(border / MM + 40.3 - 60.0 * np.cos(np.pi / CLAMP_BARS), abs=0.05)
    data["sheet"] |= {"size_mm": [240, 240], "opening_mm": 170}
    registry.job(pipeline.load(small_forming.write(tmp_path, data)), 0).targets()


def test_ridges_are_as_high_as_stated(tmp_path: Path) -> None:
    found = problem(tmp_path, scallop_mm=0.05, chord_mm=0.005, path="contour")
    targets, (one,) = registry.job(found, 0).targets(), work_of(found).passes
    centre = centres(targets, "robot", "form/f1")
    fraction = np.linspace(0.0, 1.0, 10)[:, None, None]
    dense = ((1.0 - fraction) * centre[:-1] + fraction * centre[1:]).reshape(-1, 3)
    mesh = trimesh.Trimesh(one.vertices, one.faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, 5000, seed=5)
    wall = mesh.face_normals[face][:, 2] < np.cos(15.0 * DEG)
    deviation = np.linalg.norm(points[wall][:, None, :2] - dense[None, ::40, :2], axis=2).min(axis=1)
    assert deviation.max() < 0.01
    least = np.array([np.linalg.norm(dense - point, axis=1).min() for point in points[wall][:400]])
    ridge = least - 6.0 * MM
    assert np.quantile(ridge, 0.98) <= (0.05 + 0.015) * MM  # and what facets of the mesh are off
    assert ridge.max() > 0.03 * MM


def test_both_sides_in_one_program_swap_the_tools(tmp_path: Path) -> None:
    down = small_forming.dish(18.0, 4.0, 35.0, 8.0)
    turned = upside_down(down)
    aside = np.array([0.027, 0.0, 0.0])
    flat = shapely.box(-0.055, -0.055, 0.055, 0.055)
    rims = [
        shapely.Polygon(part.vertices[:96, :2] + side[:2]) for part, side in ((down, -aside), (turned, aside))
    ]
    points, faces = triangulate(polygons(flat.difference(shapely.union_all(rims))))
    rest = Mesh(np.column_stack([points, np.zeros(len(points))]), faces)
    part = merge_meshes(
        merge_meshes(Mesh(down.vertices - aside, down.faces), Mesh(turned.vertices + aside, turned.faces)),
        rest,
    )
    part = facing_up(part)
    found = problem(tmp_path, "dsif", part)
    targets, made = registry.job(found, 0).targets(), work_of(found)
    assert sorted(forming_pass.side for forming_pass in made.passes) == [-1, 1]
    for forming_pass in made.passes:
        (claim,) = [
            c
            for c in targets.claims
            if isinstance(c, ToolGap) and c.segment == Segment.read(f"form/{forming_pass.name}")
        ]
        assert claim.arms == (("left", "right") if forming_pass.side > 0 else ("right", "left"))
    order = next(c for c in targets.claims if isinstance(c, FormsInOrder))
    assert order.segments == tuple(Segment("form", forming_pass.name) for forming_pass in made.passes)
    states: list[Claim] = [c for c in targets.claims if isinstance(c, SheetState)]
    assert len(states) == 2
    # one arm alone can form only one of them
    assert "forming.side" in refusal(problem(tmp_path, "spif", part))


def test_repeats_and_stated_passes_are_passes_of_their_own(tmp_path: Path) -> None:
    twice = registry.job(problem(tmp_path, repeats=2), 0).targets()
    assert [str(s) for s in dict.fromkeys(twice.segment) if s.works and not s.phase] == [
        "form/f1_p1",
        "form/f1_p2",
    ]
    one, two = (centres(twice, "robot", f"form/f1_p{k}") for k in (1, 2))
    np.testing.assert_array_equal(one[-100:], two[-100:])
    steps = work_of(problem(tmp_path, "dsif", small_forming.dish(30, 12, 55, 8), passes=[40])).passes
    assert [one.number for one in steps] == [1, 2]
    assert steps[0].end > steps[1].end - 1e-9


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", ["spif", "dsif"])
def test_a_pit_of_four_facets_is_formed(tmp_path: Path, mode: str, kind: str) -> None:
    found = problem(tmp_path, mode, pyramid(10.0), path=kind)
    targets = registry.job(found, 0).targets()
    assert sum(segment.works for segment in targets.segment) > 100


def test_what_cannot_be_formed_is_told_with_figures_and_a_remedy(tmp_path: Path) -> None:
    small = refusal(problem(tmp_path, "spif", small_forming.dish(30.0, 6.0, 40.0, 3.0)))[
        "forming.tool_radius"
    ]
    assert "largest radius that fits is" in small
    assert "smaller tool" in small
    up = refusal(problem(tmp_path, "spif", upside_down(small_forming.dish())))["forming.side"]
    assert "feature 1 goes up and needs a ball tool below" in up
    assert "name each of 1 to 1 once" in refusal(problem(tmp_path, order=[2]))["forming.order"]
    data = small_forming.problem("dsif")
    data["cell"]["arms"][1]["tool"] = dict(small_forming.DISK)
    disk = refusal(pipeline.load(small_forming.write(tmp_path, data)))["forming.tool"]
    assert "mode dsif needs ball_tool" in disk
    data = small_forming.problem("spif")
    data["cell"]["arms"][0]["tool"] |= {"radius_mm": 2, "shaft_radius_mm": 15, "neck_mm": 2.1}
    thick = refusal(pipeline.load(small_forming.write(tmp_path, data)))["forming.clear"]
    assert "cuts" in thick
    assert "slimmer" in thick


def test_what_a_ball_does_not_reach_is_told_or_refused_by_the_users_figure(tmp_path: Path) -> None:
    """A pit of four facets that lean by the angle a: from its tip a ball stays R (1 / cos a - 1) off."""
    sharp = pyramid(10.0)
    found = problem(tmp_path, "spif", sharp)
    reported = [
        issue for issue in registry.job(found, 0).targets().issues if issue.code == "forming.unreached"
    ]
    radius = found.cell.arms[0].tool.head.radius / MM
    off = float(radius * (np.hypot(1.0, 0.5) - 1.0))
    assert len(reported) == 1
    assert reported[0].severity is not Severity.ERROR
    assert reported[0].value == pytest.approx(off, abs=0.02)
    assert "mm3" in reported[0].message
    refused = refusal(problem(tmp_path, "spif", sharp, unreached_mm=0.9 * off))["forming.unreached"]
    assert "unreached_mm allows" in refused
    # each remedy that it names
    allowed = float(re.findall(r"allow ([\d.]+) mm", refused)[-1])
    assert registry.job(problem(tmp_path, "spif", sharp, unreached_mm=allowed), 0).targets()
    data = small_forming.problem("spif", unreached_mm=0.9 * off)
    data["cell"]["arms"][0]["tool"] |= {"radius_mm": 0.5 * radius, "shaft_radius_mm": 0.5 * radius}
    assert registry.job(pipeline.load(small_forming.write(tmp_path, data, sharp)), 0).targets()
    round_ = small_forming.dish(30.0, 6.0, 40.0, 1.1 * radius)
    assert registry.job(problem(tmp_path, "spif", round_, unreached_mm=0.9 * off), 0).targets()


def test_a_job_needs_a_sheet_and_a_part(tmp_path: Path) -> None:
    data = small_forming.problem()
    del data["part"]
    assert (
        "give sheet: and a part"
        in refusal(pipeline.load(small_forming.write(tmp_path, data)))["forming.no_sheet"]
    )


def test_the_force_is_held_against_the_payload(tmp_path: Path) -> None:
    issues = registry.job(problem(tmp_path, force_n=2000), 0).targets().issues
    (issue,) = [one for one in issues if one.code == "forming.force"]
    assert issue.severity is Severity.WARNING
    assert "2000 N" in issue.message
    assert not [
        i for i in registry.job(problem(tmp_path, force_n=5), 0).targets().issues if i.code == "forming.force"
    ]
