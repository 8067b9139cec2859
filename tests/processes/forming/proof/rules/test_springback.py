"""verify.springback: a dish whose two tools compensate the springback, from file to proof.

Planner faults are put into the programs, and file faults into the file. The expected rule is named for each
of them. File faults run only this rule, on one shared replay.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.cli.forming import SpringbackCommand, run_springback
from planner.geometry.units import MM
from planner.pipeline import Outcome
from planner.processes import registry
from planner.processes.forming.claims import CompensatesSpringback
from planner.processes.forming.proof import compensation, elastic_sheet, springback_bounds, springback_file
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.processes.forming.proof.rules import springback, springback_forces, tool, two_tools
from planner.proof.context import Context
from tests import small_forming
from tests.processes.forming.plan.springback import springback_files as files
from tests.processes.forming.plan.test_stated_force import TABLE, by_level
from tests.proof import planner_faults
from tests.test_whole_forming import UPRIGHT

FORCE = 500.0
PASS = "PROC form_f1()"


def stated(folder: Path, **more: Any) -> Path:
    data = small_forming.problem("dsif", force_n=FORCE, tangent_deg=3, **more)
    data["sheet"]["place"] = UPRIGHT
    return small_forming.write(folder, data, small_forming.dish(around=120))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("deeper")


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    """The job planned with the file that the command writes for it."""
    path = stated(folder)
    request = SpringbackCommand(path, most_points=3, triangles=3000, write=folder / "back.json")
    assert {issue.code for issue in run_springback(request, planner.load(path))} == {"forming.springback"}
    return planner.plan(planner.load(stated(folder, springback={"file": "back.json"})))


def claims_of(outcome: Outcome) -> Mapping[str, Any]:
    return {job.operation.name: job.claims() for job in registry.jobs(outcome.problem)}


@pytest.fixture(scope="module")
def context(outcome: Outcome) -> Context:
    return Context(outcome.problem, claims_of(outcome), outcome.programs)


@pytest.fixture
def file(folder: Path) -> Iterator[Path]:
    """The springback file, which is restored afterwards."""
    path = folder / "back.json"
    before = path.read_text()
    yield path
    path.write_text(before)


_unlike_a_sheet = {"forces_n": [0.0, 499.0, 501.0], "displacements_mm": [0.0, 1e-9, 2.0]}
"""True between its loads by a cubic, and next to nothing under less."""


def messages(context: Context) -> list[str]:
    context.release(FORMING)  # which has read the files
    return [issue.message for issue in springback.check_springback(context).issues]


def passes_of(context: Context, forming: FormingFacts) -> list[springback_bounds.FilePass]:
    return list(springback._file_passes(context, forming, forming.compensations[0]))


@pytest.mark.long
def test_what_is_planned_is_proven_and_five_points_are_solved_again(outcome: Outcome) -> None:
    assert outcome.verified, outcome.issues
    rules = {rule.code: rule for rule in outcome.proof.rules}
    assert rules["verify.springback"].ran
    assert 0.0 < rules["verify.springback"].worst <= 100.0
    assert rules["verify.gap"].worst <= 0.02
    # what comes out of the press is the part: the deviation is that of the released tools
    assert rules["verify.formed"].worst > 99.0
    (reported,) = (issue for issue in outcome.issues if issue.code == "forming.compensated")
    assert 1.0 < reported.value < 2.5


def test_the_tools_are_deeper_and_the_released_ones_are_on_the_part(context: Context) -> None:
    forming = context.get(FORMING)
    (one,) = forming.formed
    assert one.track.z_correction is not None
    assert one.track.path_distance is not None
    assert float(one.track.z_correction.max()) > 1.0 * MM
    assert float(one.track.path_distance.max()) < 0.05 * MM
    deep = one.track.commanded_tcp(0, slice(None))
    np.testing.assert_allclose(one.track.centre[:, 0][:, 2] - deep[:, 2], one.track.z_correction, atol=1e-12)
    plain = Context(context.problem, _without_claim(context), context.programs)
    assert len(tool.check_gouge(plain).issues) > 0


def _without_claim(context: Context) -> Mapping[str, Any]:
    return {
        name: tuple(c for c in group if not isinstance(c, CompensatesSpringback))
        for name, group in context.by_operation.items()
    }


def test_a_file_that_is_named_has_to_be_claimed(context: Context) -> None:
    plain = Context(context.problem, _without_claim(context), context.programs)
    assert any("nothing is claimed" in what for what in messages(plain))


# ---- faults of the planner, in its programs ----


def moved(texts: Mapping[str, str], arms: tuple[str, ...], up: np.ndarray) -> dict[str, str]:
    """Move all targets (N,) of the pass of some arms by ``up`` (N,) [mm] along the sheet's normal."""
    out = dict(texts)
    for name, text in texts.items():
        if any(f"T_{arm}" in name for arm in arms) and PASS in text:
            head, mark, rest = text.partition(PASS)
            body, end, tail = rest.partition("ENDPROC")
            rise = iter(up.tolist())

            def raise_target(match: re.Match[str], rise: Iterator[float] = rise) -> str:
                x, y, z = (float(v) for v in match.group(2).split(","))
                return f"{match.group(1)}{x:.4f},{y:.4f},{z + next(rise):.4f}]"

            out[name] = head + mark + re.sub(r"(MoveL \[\[)([^\]]*)\]", raise_target, body) + end + tail
    assert out != dict(texts)
    return out


def shifts(outcome: Outcome, path: Path) -> np.ndarray:
    """The shift (N,) [mm] of each target of the pass, by the former's targets and the file."""
    data = json.loads(path.read_text())
    points = np.array([p for one in data["passes"] for ring in one["rings"] for p in ring])
    former, _ = tasks(outcome)
    (text,) = (text for name, text in outcome.programs.items() if f"T_{former}" in name and PASS in text)
    body = text.partition(PASS)[2].partition("ENDPROC")[0]
    rows = np.array([[float(v) for v in row.split(",")] for row in re.findall(r"MoveL \[\[([^\]]*)\]", body)])
    near = np.abs(rows[:, None] - (points[:, :3] - points[:, [3]] * [0.0, 0.0, 1.0])[None]).sum(axis=2)
    assert near.min(axis=1).max() < 2.0
    return np.asarray(points[near.argmin(axis=1), 3])


def tasks(outcome: Outcome) -> tuple[str, str]:
    names = sorted({name.split("/")[0] for name in outcome.programs if name.startswith("T_")})
    assert len(names) == 2
    return names[0].removeprefix("T_"), names[1].removeprefix("T_")


def broken(outcome: Outcome, texts: Mapping[str, str]) -> set[str]:
    found = Context(outcome.problem, claims_of(outcome), texts)
    forming = found.get(FORMING)
    rules: tuple[Callable[..., Any], ...] = (tool.check_gouge, two_tools.check_gap)
    out = {issue.code for rule in rules for issue in rule(found).issues}
    way = springback._path_issues(found, forming, forming.compensations[0])
    return out | {issue.code for issue in way}


def test_a_shift_of_the_wrong_sign_is_off_the_part(outcome: Outcome, folder: Path) -> None:
    up = shifts(outcome, folder / "back.json")
    assert "verify.springback" in broken(outcome, moved(outcome.programs, tasks(outcome), 2.0 * up))


def test_tools_that_are_too_deep_gouge_the_released_part(outcome: Outcome, folder: Path) -> None:
    up = shifts(outcome, folder / "back.json")
    found = broken(outcome, moved(outcome.programs, tasks(outcome), -0.2 * up))
    assert {"verify.springback", "verify.gouge"} <= found


def test_one_tool_alone_breaks_the_gap(outcome: Outcome, folder: Path) -> None:
    up = shifts(outcome, folder / "back.json")
    for arm in tasks(outcome):
        assert "verify.gap" in broken(outcome, moved(outcome.programs, (arm,), up))


# ---- faults of the file ----


def test_a_file_that_is_cut_short_or_edited_is_not_read(context: Context, file: Path) -> None:
    text = file.read_text()
    for other, what in (
        (text[: len(text) // 2], "truncated"),
        (text.replace('"slope": 0.05', '"slope": 0.06'), "checksum"),
        (text[:-90], "truncated"),
    ):
        file.write_text(other)
        found = messages(context)
        assert len(found) == 1
        assert what in found[0]
    file.unlink()
    assert "cannot be read" in messages(context)[0]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (files.negate_springback, "a shift out of the sheet"),
        (files.steep, "changes too fast"),
        (files.short, "off the path of the springback file"),
        (files.each_point(lambda p: p.__setitem__(3, 2.0 * p[3])), "changes too fast"),
        (files.each_point(lambda p: p.__setitem__(3, 0.85 * p[3])), "control points and the slope give"),
        (files.each_point(lambda p: p.__setitem__(3, p[3] + 0.3)), "where the tool reaches the sheet"),
        (lambda data: data["belongs_to"].update(part="0" * 32), "of another job: part"),
        (lambda data: data["belongs_to"].update({"sheet.poisson": 0.3}), "of another job: sheet.poisson"),
        (lambda data: data["belongs_to"].pop("operation.force_n"), "of another job: operation.force_n"),
        (files.under_less, "under 400.0 N"),
        (lambda data: data["control_points"][1].update(force_n=400.0), "but its curve has"),
        (lambda data: data["control_points"][1]["displacements_mm"].reverse(), "no curve from 0 on"),
        (lambda data: data["control_points"][1]["forces_n"].__setitem__(3, 1.0), "does not increase"),
        (lambda data: data["control_points"][1].update(_unlike_a_sheet), "an implausible curve"),
        (lambda data: data["control_points"][1].update(forces_n=3, displacements_mm=3), "no curve from 0 on"),
        (lambda data: data["control_points"][1].update(x_mm=10**400), "it cannot be parsed"),
        (lambda data: data.update(tandem_springback=1), "another version"),
        (lambda data: data.update(control_points=[]), "no finite values"),
        (lambda data: data["passes"][0].update(name="f2"), "has the passes ['f2']"),
    ],
)
def test_what_is_wrong_in_a_file_is_found(context: Context, file: Path, change: Any, named: str) -> None:
    file.write_text(files.edited(file.read_text(), change))
    assert any(named in what for what in messages(context)), messages(context)


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.93, pytest.param(2.0, marks=pytest.mark.long)])
def test_what_the_sheet_does_not_say_is_found_where_it_is_drawn(
    context: Context, file: Path, monkeypatch: pytest.MonkeyPatch, factor: float
) -> None:
    monkeypatch.setattr(springback, "_random_order", lambda digest, count, most: [count // 2])
    forming = FormingFacts(context)
    (place,) = springback._draw_points(context, forming.compensations[0], passes_of(context, forming))
    assert len(place.around) == 2
    mine = [control.point / MM for control in place.around]

    def other(data: dict[str, Any]) -> None:
        for row in data["control_points"]:
            if any(np.allclose([row[f"{axis}_mm"] for axis in "xyz"], one) for one in mine):
                files.scaled(row, factor)

    file.write_text(files.edited(file.read_text(), other))
    forming = FormingFacts(context)
    off, issues = springback._elastic_issues(
        context, forming, forming.compensations[0], passes_of(context, forming)
    )
    assert off > 1.0
    assert sum("an elastic sheet on another mesh" in issue.message for issue in issues) == 2


def test_places_are_drawn_by_the_way_and_points_around_them(context: Context) -> None:
    """Points that stand for a little of the way are asked as little, however many there are."""
    forming = FormingFacts(context)
    places = springback._draw_points(context, forming.compensations[0], passes_of(context, forming))
    assert len(places) >= springback.RECALCULATED_POINTS
    controls = forming.compensations[0].file.controls
    around = {id(one) for place in places for one in place.around}
    assert len(around) >= min(springback.MIN_RECALCULATED, len(controls))
    for place in places:
        height = sorted(one.point[2] for one in place.around)
        z = place.file_pass.touch[place.row, 2]
        assert len(height) == 1 or height[0] - 5e-4 <= z <= height[1] + 5e-4


def test_what_is_drawn_follows_the_problem() -> None:
    some = {tuple(springback._random_order(digest, 40, 5)) for digest in ("a", "b", "c")}
    assert len(some) == 3
    assert all(len(set(one)) == 5 and max(one) < 40 for one in some)
    assert sorted(springback._random_order("a", 3, 5)) == [0, 1, 2]


def test_bounds_that_are_no_figures_hold_nothing(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two levels at one height made 0/0 of what lies between, and no shift was held against that."""
    whole = springback_bounds.springback_bounds_at

    def with_nan(file_pass: springback_bounds.FilePass) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        low, high, apart = whole(file_pass)
        low[len(low) // 2] = np.nan
        return low, high, apart

    monkeypatch.setattr(springback_bounds, "springback_bounds_at", with_nan)
    forming = FormingFacts(context)
    assert len(list(springback._shift_issues(forming.compensations[0], passes_of(context, forming)))) == 1


def _copies(data: dict[str, Any]) -> None:
    data["control_points"] += [dict(data["control_points"][2]) for _ in range(300)]


def _one_height(data: dict[str, Any]) -> None:
    level = data["control_points"][2]["level"]
    mine = [row for row in data["control_points"] if row["level"] == level]
    turned = [{**row, "x_mm": row["y_mm"], "y_mm": -row["x_mm"], "level": 99} for row in mine]
    data["control_points"] += turned


def _at_the_rim(data: dict[str, Any]) -> None:
    for row in data["control_points"]:
        out = 52.0 / np.hypot(row["x_mm"], row["y_mm"])
        row["x_mm"], row["y_mm"] = out * row["x_mm"], out * row["y_mm"]


def _first_level_alone(data: dict[str, Any]) -> None:
    data["control_points"] = [row for row in data["control_points"] if row["level"] == 0]


def _one_level(data: dict[str, Any]) -> None:
    for row in data["control_points"]:
        row["level"] = 0


def _steeper(data: dict[str, Any]) -> None:
    data["control_points"][-1]["wall_deg"] += 30.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (_at_the_rim, "mm off what the tool touches"),
        (_first_level_alone, "of its depth without a level"),
        (_one_level, "are of several loops"),
        (_copies, "are named twice"),
        (_one_height, "are at one height"),
    ],
)
def test_control_points_are_on_the_loops_that_the_tool_forms(
    context: Context, file: Path, change: Any, named: str
) -> None:
    file.write_text(files.edited(file.read_text(), change))
    assert any(named in what for what in messages(context)), messages(context)


def test_walls_by_which_a_formula_takes_forces_are_those_of_the_part(context: Context, file: Path) -> None:
    file.write_text(files.edited(file.read_text(), _steeper))
    forming = FormingFacts(context)
    (reported,) = forming.compensations
    by_formula = reported.operation.model_copy(update={"force_n": None})
    passes = passes_of(context, forming)
    assert list(springback._control_point_issues(reported, passes)) == []
    (issue,) = springback._control_point_issues(dataclasses.replace(reported, operation=by_formula), passes)
    assert "where the part has" in issue.message


@pytest.mark.long
def test_shifts_are_worked_out_once_more_anywhere(
    context: Context, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(springback, "_random_order", lambda digest, count, most: [count // 3])
    forming = FormingFacts(context)
    off, issues = springback._elastic_issues(
        context, forming, forming.compensations[0], passes_of(context, forming)
    )
    assert issues == []
    assert 0.0 < off < 1.0
    file.write_text(files.edited(file.read_text(), files.twice))
    forming = FormingFacts(context)
    off, issues = springback._elastic_issues(
        context, forming, forming.compensations[0], passes_of(context, forming)
    )
    assert off > 1.0
    for what in ("mm is shifted by", "mm by the control points around"):
        assert any("f1 at" in issue.message and what in issue.message for issue in issues)


def test_of_loops_that_lie_close_together_each_place_has_the_shift_of_its_own() -> None:
    """A ball that just fits a fillet stays where it is from loop to loop, and only the shifts differ."""
    turn = np.radians(np.arange(0.0, 24 * 360.0, 0.77))
    loop = (turn // (2.0 * np.pi)).astype(np.int64)
    drop = 0.01 * MM * turn / (2.0 * np.pi)
    point = np.column_stack([20.0 * MM * np.cos(turn), 20.0 * MM * np.sin(turn), -0.2 * drop])
    way = springback_file.FilePath(point, 1.0 * MM - 0.8 * drop, loop)
    at = np.linspace(0.0, len(turn) - 1.0, 50_000)
    place, shift = (
        np.stack([np.interp(at, np.arange(len(turn)), row) for row in np.atleast_2d(rows)], axis=-1)
        for rows in (point.T, way.shift)
    )
    place[:, 2] -= shift[:, 0]
    found, off = springback_file.ShiftLookup(way, 1).shift_and_distance(place)
    assert off.max() < 1e-9
    np.testing.assert_allclose(found, shift[:, 0], atol=1e-9)


def test_a_way_out_that_presses_into_the_flat_sheet_is_found(context: Context) -> None:
    """Beside the end of the way no file says that the sheet gives way: tools are where they are."""
    out = dict(context.programs)
    (name,) = (key for key, text in out.items() if "T_ROB1" in key and "PROC form_f1_out()" in text)
    head, mark, rest = out[name].partition("PROC form_f1_out()")
    body, end, tail = rest.partition("ENDPROC")
    line = next(one for one in body.splitlines(keepends=True) if "MoveL [[" in one)
    x, y, z = map(float, re.search(r"MoveL \[\[([^\]]*)\]", line)[1].split(","))  # type: ignore[index]
    beside = re.sub(r"MoveL \[\[[^\]]*\]", f"MoveL [[45,0,{4.935}]", line)
    assert z > 4.935 and np.hypot(x, y) < 40.0
    out[name] = head + mark + body.replace(line, beside) + end + tail
    bad = Context(context.problem, context.by_operation, out)
    (gouge, *_) = tool.check_gouge(bad).issues
    assert "flat sheet" in gouge.message


def _steep_pass(value: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> springback_bounds.FilePass:
    """The begin of a pass in which a ball rolls from the flat onto a wall, 4 mm deep, around a square whose
    corners give way more: control points under 16 N on the flat and 250 N on the wall, of curves that are
    ``value`` of the corner (0 or 1) and the force."""
    loads = np.array([0.0, 16.0, 60.0, 140.0, 260.0, 400.0])
    controls = []
    for level, (z, force) in enumerate([(0.0, 16.0), (-4.0 * MM, 250.0)]):
        for k in range(8):
            turn = 0.25 * np.pi * k
            place = np.array([0.05 * np.cos(turn), 0.05 * np.sin(turn), z])
            moved = np.append(0.0, value(np.array(k % 2), loads[1:]))
            at = float(np.interp(force, loads, moved))
            controls.append(
                springback_file.FileControlPoint("f1", level, place, 0.0, force, at, loads, moved)
            )
    turn = np.linspace(0.0, 8.0 * np.pi, 1257)
    touch = np.stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), -1.0 * MM * turn / (2.0 * np.pi)], axis=1)
    at = 1e-3 * np.arange(len(turn))
    angle = np.arccos(np.clip(1.0 + touch[:, 2] / 6e-3, 0.0, 1.0))
    force = 16.0 + 284.0 * np.sin(np.minimum(1.5 * angle, 2.2))
    ring = np.minimum(turn // (2.0 * np.pi), 3).astype(np.int64)
    way = springback_file.FilePath(touch, 0.0 * at, ring)
    return springback_bounds.FilePass(
        None,  # type: ignore[arg-type]
        None,  # type: ignore[arg-type]
        way,
        tuple(controls),
        at,
        touch,
        angle,
        np.stack([force, force]),
        ring,
        np.full(len(at), 0.1 * MM),
    )


def test_between_a_flat_level_and_a_wall_shifts_are_those_of_the_force_there() -> None:
    """What used to be laid: one springback a level, from level to level straight, is not what lies between;
    neither is a point for all places of a flat loop."""

    def of(corner: np.ndarray, force: np.ndarray) -> np.ndarray:
        return np.asarray((1.0 + 0.4 * corner) * 1e-3 * (force / 300.0) ** 0.6)

    own = _steep_pass(of)
    low, high, distance = springback_bounds.springback_bounds_at(own)
    corner = 1.0 - np.abs((4.0 * np.arctan2(own.touch[:, 1], own.touch[:, 0]) / np.pi) % 2.0 - 1.0)
    truth = of(corner, own.force[0])
    slack = springback.INTERPOLATION_TOLERANCE_FRACTION * high + springback.MESH_TOLERANCE_M
    assert (truth > low - slack).all()
    assert (truth < high + slack).all()
    assert springback.LEVEL_DIFFERENCE_FRACTION * distance.max() < 1e-6
    by_level = [np.mean([c.springback for c in own.controls if c.level == k]) for k in range(2)]
    straight = np.interp(-own.touch[:, 2], [0.0, 4.0 * MM], by_level)
    assert (low - straight).max() > 0.3 * MM
    flat = [
        dataclasses.replace(c, displacement=own.controls[0].displacement)
        for c in own.controls
        if c.level == 0
    ]
    for one in (flat[:1], flat):
        off = springback_bounds.springback_bounds_at(
            dataclasses.replace(own, controls=(*one, *own.controls[8:]))
        )
        # the rule holds places off it by what its levels differ
        assert off[2].max() > 0.2 * MM
        assert (truth - off[1]).max() > slack.max() + springback.LEVEL_DIFFERENCE_FRACTION * off[2].max()


# ---- the sheet of the proof's own ----


def test_the_sheet_of_the_proof_comes_back_as_trials_say(tmp_path: Path) -> None:
    """A cone of 45 degrees, top radius 50 mm, 20 mm deep, of 1 mm, 600 N at its floor's edge: 4.750
    mm by another shell code and CalculiX where the sheet slides, 3.29 where its edge does not move."""
    from planner.processes.forming.claims import FormsPart
    from planner.processes.forming.proof.formed_shapes import PartShapes, ordered_passes
    from tests.processes.forming.plan import shapes

    data = small_forming.problem("spif", force_n=600.0)
    data["sheet"] = {"size_mm": [320, 320], "thickness_mm": 1, "metal": "aa5754_o", "opening_mm": [250, 250]}
    path = small_forming.write(tmp_path, data, shapes.cone(45.0, 0.020, 0.050, 240))
    (job,) = registry.jobs(planner.load(path))
    claims = job.claims()
    part = next(claim for claim in claims if isinstance(claim, FormsPart))
    made = PartShapes(part, ordered_passes(claims))
    opening = 0.125 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    held = elastic_sheet.ClampedSheet(1.0 * MM, 68e9, 0.3, opening, 0.0)
    formed = elastic_sheet.PartlyFormedSheet(made, 0, 0, 20.0 * MM)
    for one, expected in ((held, 4.750), (dataclasses.replace(held, border=np.inf), 3.29)):
        got, triangles = elastic_sheet.springback_at(formed, one, np.array([30.0 * MM, 0.0]), 600.0)
        assert got / MM == pytest.approx(expected, rel=0.015)
        assert triangles < 2.0 * elastic_sheet.MAX_POINTS


def test_the_problem_of_a_result_has_the_file_in_it(outcome: Outcome, tmp_path: Path) -> None:
    path = planner.save(outcome.problem, tmp_path / "out")
    data = yaml.safe_load(path.read_text())
    assert (path.parent / data["operations"][0]["springback"]["file"]).is_file()
    assert planner.load(path).digest == outcome.problem.digest


# ---- forces that are stated by depth, by level and place, and of a support ----


def by_force(folder: Path, kind: str, **more: Any) -> Path:
    """A dish under forces of one of three kinds; the problem's file."""
    folder.mkdir(exist_ok=True)
    stated: dict[str, Any] = {"file": {"force_by": {"file": "forces.csv"}}}.get(kind) or {"force_n": 600}
    if kind == "table":
        stated = {"force_by": {"table": TABLE}}
    if kind == "file":
        (folder / "forces.csv").write_text(by_level(4, 8))
    else:
        stated["support_force_n"] = 150
    data = small_forming.problem("spif" if kind == "file" else "dsif", tangent_deg=3, **stated, **more)
    if kind != "file":
        data["sheet"]["place"] = UPRIGHT
    return small_forming.write(folder, data, small_forming.dish(around=120))


def force_messages(context: Context, file_data: compensation.CompensationClaim) -> list[str]:
    """What is wrong with the forces of a file."""
    found = (
        *springback._identity_issues(context, file_data),
        *springback_forces.force_issues(context, file_data),
    )
    return [issue.message for issue in found]


def _no_support(old: Callable[..., Any]) -> Callable[..., Any]:
    """The support's force is forgotten."""
    return lambda op, *rest: old(op.model_copy(update={"support_force_n": None}), *rest)


def _upside_down(old: Callable[..., Any]) -> Callable[..., Any]:
    """Forces of the floor where the wall begins."""
    return lambda stated, name, points: old(stated, name, points * [1.0, 1.0, -1.0] - [0.0, 0.0, 4.0 * MM])


def _all_around(old: Callable[..., Any]) -> Callable[..., Any]:
    """One force around a whole level."""
    return lambda stated, name, points: old(stated, name, points * [0.0, 0.0, 1.0])


_AT = "processes.forming.plan.stated_force:StatedForces.force_at"


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("figure", {"processes.forming.plan.process_plan:stated_forces": _no_support}),
        ("table", {"processes.forming.plan.process_plan:stated_forces": _no_support}),
        ("table", {_AT: _upside_down}),
        ("file", {_AT: _upside_down}),
        ("file", {_AT: _all_around}),
    ],
)
def test_another_force_than_the_stated_one_is_found(tmp_path: Path, kind: str, changes: Any) -> None:
    """Files by a formula for springback: forces alone are asked."""

    def messages_after(changes: Any) -> list[str]:
        with planner_faults.changed(changes):
            (job,) = registry.jobs(planner.load(by_force(tmp_path, kind)))
            (tmp_path / "back.json").write_text(files.text_of(job))  # type: ignore[arg-type]
        problem = planner.load(by_force(tmp_path, kind, springback={"file": "back.json"}))
        claims = {job.operation.name: job.claims() for job in registry.jobs(problem)}
        found = Context(problem, claims, {})
        (one,) = FormingFacts(found).compensations
        return [
            issue.message
            for issue in (
                *springback._identity_issues(found, one),
                *springback_forces.force_issues(found, one),
            )
        ]

    assert messages_after({}) == []
    (what,) = messages_after(changes)
    assert "the problem's force there is" in what


def test_a_file_of_other_forces_than_it_was_written_for_is_of_another_job(tmp_path: Path) -> None:
    (job,) = registry.jobs(planner.load(by_force(tmp_path, "file")))
    (tmp_path / "back.json").write_text(files.text_of(job))  # type: ignore[arg-type]
    problem = planner.load(by_force(tmp_path, "file", springback={"file": "back.json"}))
    found = Context(problem, {job.operation.name: job.claims() for job in registry.jobs(problem)}, {})
    (one,) = FormingFacts(found).compensations
    whole = (tmp_path / "forces.csv").read_text()
    for text, named in (
        (whole.replace("375.0", "376.0"), "of another job: operation.force_by"),
        (whole.replace("0,3,", "0,9,"), "level 0 of f1 has the points"),
        (whole.replace("0,3,", "0,2,"), "level 0 has point 2 twice"),
        (whole.replace("375.0", "-375.0"), "has the force -375.0"),
        (whole.replace("375.0", "nan"), "has the force nan"),
        (whole.replace("375.0", ""), "forces.csv: could not convert"),
        (by_level(2, 8), "which has 3"),
        ("level;point", "no rows of level and force_n"),
    ):
        (tmp_path / "forces.csv").write_text(text)
        what = [
            issue.message
            for issue in (
                *springback._identity_issues(found, one),
                *springback_forces.force_issues(found, one),
            )
        ]
        assert any(named in message for message in what), what
    (tmp_path / "forces.csv").unlink()
    assert any("cannot be read" in issue.message for issue in springback_forces.force_issues(found, one))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["file", "table"])
def test_what_is_planned_under_stated_forces_is_proven(tmp_path: Path, kind: str) -> None:
    path = by_force(tmp_path, kind)
    request = SpringbackCommand(path, most_points=3, triangles=3000, write=tmp_path / "back.json")
    run_springback(request, planner.load(path))
    outcome = planner.plan(planner.load(by_force(tmp_path, kind, springback={"file": "back.json"})))
    assert outcome.verified, outcome.issues
    (rule,) = (rule for rule in outcome.proof.rules if rule.code == "verify.springback")
    assert rule.ran
    assert 0.0 < rule.worst <= 100.0
    forces = [row["force_n"] for row in json.loads((tmp_path / "back.json").read_text())["control_points"]]
    assert max(forces) > 1.5 * min(forces)


# ---- faults of the planner itself ----


def _negate_shift(old: Callable[..., Any]) -> Callable[..., Any]:
    """Reverse all shifts: out of the sheet instead of into it."""
    return lambda laid, ways: old(laid, [dataclasses.replace(way, shift=-way.shift) for way in ways])


def _one_tool(old: Callable[..., Any]) -> Callable[..., Any]:
    """The support stays where it was."""

    def other(tool_paths: Any, compensated: Any) -> Any:
        still = old(tool_paths, [dataclasses.replace(way, shift=0.0 * way.shift) for way in compensated])
        return [
            (one, dataclasses.replace(path, support_centre=before.support_centre))
            for (one, path), (_, before) in zip(old(tool_paths, compensated), still, strict=True)
        ]

    return other


def _left_out(old: Callable[..., Any]) -> Callable[..., Any]:
    """Nothing says that tools are deeper."""
    return lambda work: tuple(claim for claim in old(work) if not isinstance(claim, CompensatesSpringback))


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "caught"),
    [
        (
            {"processes.forming.plan.springback.compensation:apply_shifts": _negate_shift},
            {"verify.springback"},
        ),
        ({"processes.forming.plan.springback.compensation:apply_shifts": _one_tool}, {"verify.gap"}),
        ({"processes.forming.plan.claims:claims": _left_out}, {"verify.gouge", "verify.springback"}),
    ],
)
def test_faults_of_the_planner_are_not_proven(
    outcome: Outcome, folder: Path, changes: Any, caught: set[str]
) -> None:
    with planner_faults.changed({**planner_faults.CHECKS, **changes}):
        made = planner.plan(planner.load(folder / "problem.yaml"))
    assert not made.verified
    assert caught <= {rule.code for rule in made.proof.rules if rule.ran and not rule.passed}
