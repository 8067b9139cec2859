"""verify.level: one level of a dish between two tools, deepened by its own file, from file to proof."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import planner
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.pipeline import Outcome
from planner.processes import registry
from planner.processes.forming.claims import FormsLevel
from planner.processes.forming.plan import level as one_level
from planner.processes.forming.proof.forming_facts import FORMING, FormingFacts
from planner.processes.forming.proof.rules import level as forming_level
from planner.processes.forming.proof.rules import tool, two_tools
from planner.proof.context import Context
from tests import small_forming
from tests.processes.forming.plan import shapes
from tests.processes.forming.plan.springback import level_files
from tests.processes.forming.plan.springback import springback_files as files
from tests.proof import planner_faults
from tests.test_whole_forming import UPRIGHT

PASS = "PROC form_f1()"


def written(folder: Path, level: dict[str, Any], mode: str = "dsif", **more: Any) -> Path:
    data = small_forming.problem(mode, force_n=500.0, tangent_deg=3, level=level, **more)
    data["sheet"]["place"] = UPRIGHT
    return small_forming.write(folder, data, small_forming.dish(around=120))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("level")


@pytest.fixture(scope="module")
def outcome(folder: Path) -> Outcome:
    path = written(folder, level_files.stated(1))
    level_files.write(path)
    return planner.plan(planner.load(path))


def context_of(outcome: Outcome, texts: Mapping[str, str] | None = None, **level: Any) -> Context:
    """The proof's view of programs, where the problem states another level than it was planned with."""
    (operation,) = outcome.problem.operations
    other = operation.model_copy(update={"level": operation.level.model_copy(update=level)})
    problem = dataclasses.replace(outcome.problem, operations=(other,))
    claims = {job.operation.name: job.claims() for job in registry.jobs(outcome.problem)}
    return Context(problem, claims, outcome.programs if texts is None else texts)


@pytest.fixture(scope="module")
def context(outcome: Outcome) -> Context:
    return context_of(outcome)


@pytest.fixture
def file(folder: Path) -> Iterator[Path]:
    path = folder / "level.json"
    before = path.read_text()
    yield path
    path.write_text(before)


def messages(context: Context) -> list[str]:
    context.release(FORMING)  # which has read the files
    return [issue.message for issue in forming_level.check_level(context).issues]


def test_one_level_is_planned_and_proven_alone(outcome: Outcome) -> None:
    assert outcome.verified, outcome.issues
    rules = {rule.code: rule for rule in outcome.proof.rules}
    assert rules["verify.level"].ran
    assert rules["verify.formed"].worst >= 95.0
    assert rules["verify.gap"].worst <= 0.02
    (reported,) = (issue for issue in outcome.issues if issue.code == "forming.compensated")
    assert 0.5 < reported.value < 0.8
    text = "".join(outcome.programs.values())
    assert "Level 1 of the first pass alone" in text
    assert "which stays clamped" in text


def test_tools_are_deeper_by_the_file_from_the_way_in_to_the_way_out(context: Context) -> None:
    (one,) = FormingFacts(context).formed
    lifted, way = one.track.z_correction, one.track
    assert lifted is not None
    own = np.flatnonzero(way.is_forming)
    assert lifted[own[0]] == pytest.approx(0.3 * MM, abs=0.05 * MM)
    assert lifted[own[0] - 1] == pytest.approx(0.3 * MM, abs=1e-6)
    assert lifted[own[-1] + 1] > 0.3 * MM
    assert lifted[0] == pytest.approx(0.3 * MM, abs=1e-6)
    assert one.formed_depth == pytest.approx(2.0 * MM)


def test_a_level_has_to_be_claimed_and_is_no_other_segment(outcome: Outcome, context: Context) -> None:
    without = {
        name: tuple(c for c in group if not isinstance(c, FormsLevel))
        for name, group in context.by_operation.items()
    }
    plain = Context(context.problem, without, context.programs)
    assert any("got claims for 0" in what for what in messages(plain))
    assert any("expected a level of f9" in what for what in messages(context_of(outcome, pass_name="f9")))


# ---- faults of programs ----


def moved(texts: Mapping[str, str], arms: tuple[str, ...], up: float) -> dict[str, str]:
    """Move all targets of the level of some arms by ``up`` [mm] along the sheet's normal."""

    def raise_target(match: re.Match[str]) -> str:
        x, y, z = (float(v) for v in match.group(2).split(","))
        return f"{match.group(1)}{x:.4f},{y:.4f},{z + up:.4f}]"

    out = dict(texts)
    for name, text in texts.items():
        if any(f"T_{arm}" in name for arm in arms) and PASS in text:
            head, mark, rest = text.partition(PASS)
            body, end, tail = rest.partition("ENDPROC")
            out[name] = head + mark + re.sub(r"(MoveL \[\[)([^\]]*)\]", raise_target, body) + end + tail
    assert out != dict(texts)
    return out


def tasks(outcome: Outcome) -> tuple[str, ...]:
    names = sorted({name.split("/")[0] for name in outcome.programs if name.startswith("T_")})
    return tuple(name.removeprefix("T_") for name in names)


def broken(outcome: Outcome, texts: Mapping[str, str]) -> set[str]:
    found = context_of(outcome, texts)
    rules: tuple[Callable[..., Any], ...] = (forming_level.check_level, tool.check_gouge, two_tools.check_gap)
    return {issue.code for rule in rules for issue in rule(found).issues}


def into_the_middle(texts: Mapping[str, str], task: str, procedure: str, z: float) -> dict[str, str]:
    """Move the last target of a ``procedure`` of one task to the middle of the sheet, at ``z`` [mm]."""
    out = dict(texts)
    (name,) = (key for key, text in texts.items() if f"T_{task}" in key and f"PROC {procedure}()" in text)
    head, mark, rest = texts[name].partition(f"PROC {procedure}()")
    body, end, tail = rest.partition("ENDPROC")
    at = body.rindex("MoveL [[")
    moved_body = body[:at] + re.sub(r"^MoveL \[\[[^\]]*\]", f"MoveL [[0,0,{z:g}]", body[at:])
    out[name] = head + mark + moved_body + end + tail
    assert out != dict(texts)
    return out


@pytest.mark.long
def test_tools_of_an_honest_plan_are_not_pushed_through_the_sheet(context: Context) -> None:
    assert tool.check_sheet_state(context).issues == ()


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    ("arm", "procedure", "z"), [(0, "form_f1_in", 1.0), (0, "form_f1_out", 1.0), (1, "form_f1_in", 8.0)]
)
def test_tools_on_their_ways_are_not_pushed_through_the_sheet(
    outcome: Outcome, arm: int, procedure: str, z: float
) -> None:
    """In the middle the sheet is where the level before has left it, whatever it is to become."""
    bad = context_of(outcome, into_the_middle(outcome.programs, tasks(outcome)[arm], procedure, z))
    found = [issue.message for issue in tool.check_sheet_state(bad).issues]
    assert any("deeper than the sheet is formed by then" in what for what in found), found


def test_shifts_of_the_wrong_sign_are_off_the_level(outcome: Outcome) -> None:
    assert "verify.level" in broken(outcome, moved(outcome.programs, tasks(outcome), 1.0))


def test_tools_that_are_too_deep_gouge_the_released_part(outcome: Outcome) -> None:
    found = broken(outcome, moved(outcome.programs, tasks(outcome), -0.3))
    assert {"verify.level", "verify.gouge"} <= found


def test_shifts_on_one_arm_alone_break_the_gap(outcome: Outcome) -> None:
    for arm in tasks(outcome):
        assert "verify.gap" in broken(outcome, moved(outcome.programs, (arm,), 0.5))


@pytest.mark.long
def test_another_level_than_the_stated_one_is_told_by_its_height(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first = one_level.first_loops
    monkeypatch.setattr(one_level, "first_loops", lambda one, contact: first(one, contact)[1:])
    monkeypatch.setattr(one_level, "_require_height", lambda *_: None)
    outcome = planner.plan(planner.load(written(tmp_path, {"number": 1})))
    assert "verify.level" in {rule.code for rule in outcome.proof.rules if not rule.passed}


@pytest.mark.long
def test_half_a_level_is_not_the_whole(folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = one_level.make_tool_path

    def half(work: Any, forming_pass: Any, part: Any) -> Any:
        def first_half(contact: Any) -> Any:
            kept = part(contact)
            count = len(kept.point) // 2
            return type(kept)(
                **{f.name: getattr(kept, f.name)[:count].copy() for f in dataclasses.fields(kept)}
            )

        return whole(work, forming_pass, first_half)

    monkeypatch.setattr(one_level, "make_tool_path", half)
    outcome = planner.plan(planner.load(written(tmp_path, {"number": 1})))
    assert "verify.formed" in {rule.code for rule in outcome.proof.rules if not rule.passed}


# ---- faults of the file, each of which proof and planner refuse ----


def _set(name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda data: data.__setitem__(name, value)


def _first(data: dict[str, Any]) -> None:
    data["passes"][0]["rings"][0][0][3] += 0.05


def _steep(data: dict[str, Any]) -> None:
    data["passes"][0]["rings"][0][5][3] += 1.0


def _fewer(data: dict[str, Any]) -> None:
    data["passes"][0]["rings"][0].pop()


def _negative(data: dict[str, Any]) -> None:
    for point in data["passes"][0]["rings"][0]:
        point[3] *= -1.0


FAULTS: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "wrong sign": (_negative, "mm"),
    "another level": (_set("level", 2), "level"),
    "another plan": (_set("plan", "f" * 64), "plan"),
    "a step at the start": (_first, "0.3"),
    "too steep": (_steep, "mm/mm"),
    "a point less": (_fewer, "points"),
    "another part": (lambda data: data["belongs_to"].update(part="0" * 32), "part"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_files_with_a_fault_are_refused_by_proof_and_planner(
    context: Context, file: Path, folder: Path, name: str
) -> None:
    change, what = FAULTS[name]
    file.write_text(files.edited(file.read_text(), change))
    found = messages(context)
    assert found
    assert any(what in one for one in found)
    with pytest.raises(TandemError) as error:
        registry.job(planner.load(written(folder, level_files.stated(1))), 0).targets()
    assert {issue.code for issue in error.value.issues} == {"forming.compensation"}


def test_a_file_that_is_cut_short_is_not_read(context: Context, file: Path, folder: Path) -> None:
    text = file.read_text()
    for other, what in ((text[: len(text) // 2], "truncated"), (text.replace("0.3,", "0.31,"), "checksum")):
        file.write_text(other)
        assert any(what in message for message in messages(context))
        with pytest.raises(TandemError) as error:
            registry.job(planner.load(written(folder, level_files.stated(1))), 0).targets()
        assert error.value.issues[0].code == "forming.compensation"


def test_limits_of_the_problem_hold_for_its_file(outcome: Outcome) -> None:
    assert any("too large" in what for what in messages(context_of(outcome, most_mm=0.4)))
    assert any("too fast" in what for what in messages(context_of(outcome, slope=0.002)))
    assert any("reaches the sheet" in what for what in messages(context_of(outcome, before_mm=0.0)))
    assert any("levels 0 to 3" in what for what in messages(context_of(outcome, number=9)))
    assert any("level is 1, here 2" in what for what in messages(context_of(outcome, number=2)))
    assert any("has no previous level" in what for what in messages(context_of(outcome, number=0)))


def test_a_level_that_is_not_there_is_refused(tmp_path: Path) -> None:
    for level, what in (({"number": 9}, "has 0 to 3"), ({"number": 0, "pass_name": "f2"}, "allowed are: f1")):
        with pytest.raises(TandemError) as error:
            registry.job(planner.load(written(tmp_path, level)), 0).targets()
        assert error.value.issues[0].code == "forming.path_options"
        assert what in error.value.issues[0].message


@pytest.mark.parametrize(
    ("level", "more", "what"),
    [
        ({"number": 1, "file": "level.json"}, {}, "file and plan"),
        ({"number": 1, "before_mm": 5, "most_mm": 4}, {}, "before_mm"),
        ({"number": 0, "before_mm": 0.3, "file": "level.json", "plan": level_files.PLAN}, {}, "level 0"),
        ({"number": 1, "before_mm": 0.3}, {}, "before_mm needs file"),
        ({"number": 1}, {"scallop_mm": 0.1}, "stepdown_mm"),
        ({"number": 1}, {"springback": {"file": "back.json"}}, "springback"),
        ({"number": 1}, {"mode": "dpif_p"}, "modes"),
    ],
)
def test_what_a_level_cannot_be_with_is_refused(
    tmp_path: Path, level: dict[str, Any], more: dict[str, Any], what: str
) -> None:
    with pytest.raises(TandemError) as error:
        planner.load(written(tmp_path, level, more.pop("mode", "dsif"), **more))
    assert any(what in issue.message for issue in error.value.issues)


def _ever_deeper(data: dict[str, Any]) -> None:
    """From the shift at which the level before ended on by 0.045 mm a millimetre, all around."""
    points = [point for one in data["passes"] for ring in one["rings"] for point in ring]
    place = np.array(points)[:, :3]
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1)))
    for point, way in zip(points, gone.tolist(), strict=True):
        point[3] = 0.3 + 0.045 * way


@pytest.mark.long
def test_a_wall_too_steep_below_the_level_before_is_no_level(tmp_path: Path) -> None:
    """Within range and slope, but from where the level before ended the sheet would be torn."""
    path = written(tmp_path, level_files.stated(1))
    level_files.write(path)
    file = tmp_path / "level.json"
    file.write_text(files.edited(file.read_text(), _ever_deeper))
    with pytest.raises(TandemError) as refused:
        planner.plan(planner.load(path))
    assert "forming.wall_angle" in {issue.code for issue in refused.value.issues}
    with planner_faults.changed(planner_faults.CHECKS):
        outcome = planner.plan(planner.load(path))
    assert [rule.code for rule in outcome.proof.rules if rule.ran and not rule.passed] == ["verify.level"]
    (issue,) = (one for one in outcome.issues if one.code == "verify.level")
    assert "has a wall of" in issue.message
    assert issue.value > issue.limit == pytest.approx(73.0)


@pytest.mark.long
@pytest.mark.parametrize("number", [0, pytest.param(3, marks=pytest.mark.long)])
def test_the_first_and_the_last_level_are_proven(tmp_path: Path, number: int) -> None:
    path = written(tmp_path, level_files.stated(number, before_mm=0.0 if number == 0 else 0.4))
    level_files.write(path)
    outcome = planner.plan(planner.load(path))
    assert outcome.verified, outcome.issues


def pit(folder: Path) -> Outcome:
    """A level of a square pit with sharp corners that go down aslant, which no ball fits."""
    data = small_forming.problem("spif", stepdown_mm=1.0, level={"number": 3})
    part = shapes.pit(shapely.box(-0.03, -0.03, 0.03, 0.03), 45.0, 0.010)
    return planner.plan(planner.load(small_forming.write(folder, data, part)))


def test_a_level_with_corners_that_no_ball_fits_is_proven(tmp_path: Path) -> None:
    outcome = pit(tmp_path)
    assert outcome.verified, outcome.issues


def test_a_level_that_cuts_its_corners_short_is_not_formed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    whole = one_level.make_tool_path

    def short(work: Any, forming_pass: Any, part: Any) -> Any:
        def without_corners(contact: Any) -> Any:
            kept = part(contact)
            x, y = np.abs(kept.point[:, :2]).T
            far = np.minimum(x, y) < np.maximum(x, y).max() - 12.0 * MM
            return type(kept)(**{f.name: getattr(kept, f.name)[far] for f in dataclasses.fields(kept)})

        return whole(work, forming_pass, without_corners)

    monkeypatch.setattr(one_level, "make_tool_path", short)
    assert "verify.formed" in {rule.code for rule in pit(tmp_path).proof.rules if not rule.passed}


def test_a_level_is_planned_and_proven_for_a_controller_of_the_other_brand(tmp_path: Path) -> None:
    data = small_forming.problem("spif", force_n=500.0, tangent_deg=3, level=level_files.stated(1))
    data["cell"]["arms"][0] |= {"robot": "kr10_r1100", "home_deg": [0, -110, 110, 0, 60, 0]}
    data["cell"]["controller"] = {}
    path = small_forming.write(tmp_path, data, small_forming.dish(around=180))
    level_files.write(path)
    outcome = planner.plan(planner.load(path))
    assert outcome.verified, outcome.issues
    assert {Path(name).suffix for name in outcome.programs} == {".src", ".dat"}
    assert "Level 1 of the first pass alone" in "".join(outcome.programs.values())
