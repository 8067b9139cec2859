"""Forming over a die: the die and its holder as bodies and as a signal, from the problem to proven programs.

The proof finds faults of the signal.
"""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.issues import TandemError
from planner.languages.writing import write
from planner.motion import solve
from planner.problem import Problem
from planner.processes import registry
from planner.processes.forming.plan import job as forming
from planner.processes.forming.plan import two_point
from planner.processes.forming.plan.operation import Die, Forming, die_mesh, with_die
from planner.processes.forming.plan.process_plan import FormingWork, make_tool_path, prepare_work
from planner.processes.forming.plan.sheet_state import sheet_states
from planner.proof.prove import Prover
from planner.proof.verdict import Proof
from tests import line_ends
from tests.proof.provers import broken

PROBLEM_FOLDER = Path(pipeline.__file__).resolve().parents[1] / "problems" / "dome_tpif"
MAIN = "T_ROB1/TandemMain_1.mod"
PULSE = ["    SetDO doBlankHolder,1;", "    WaitTime 0.1;", "    SetDO doBlankHolder,0;", "    WaitTime 0.1;"]
RISE, SHEET = 25e-3, 0.8e-3


def operation(problem: Problem, die: dict[str, Any] | None = None, **more: Any) -> Forming:
    first = problem.operations[0]
    assert isinstance(first, Forming) and first.die is not None
    changed = first.die.model_copy(update=die or {})
    return first.model_copy(update={"die": changed, **more})


@functools.cache
def coarse() -> Problem:
    """The bundled problem with large steps."""
    problem = pipeline.load(PROBLEM_FOLDER / "problem.yaml")
    one = operation(problem, {"step_mm": 5.0}, stepdown_mm=2.5, tangent_deg=12.0)
    return dataclasses.replace(problem, operations=(one,))


def work_of(forming_operation: Forming) -> FormingWork:
    problem = coarse()
    return prepare_work(forming_operation, problem.setups[0], problem.part)


@functools.cache
def programs() -> dict[str, str]:
    problem = coarse()
    targets = [registry.job(problem, 0).targets()]
    return line_ends.bare(write.program_files(solve.solve(problem, targets, lambda *_: None), problem))


@functools.cache
def prover() -> Prover:
    return Prover(coarse(), registry.claims(coarse()))


def proven(texts: dict[str, str], last: str | None = "verify.holder") -> Proof:
    return prover().prove(texts, last=last)


def test_a_dome_over_a_die_is_planned_and_proven() -> None:
    proof = proven(programs(), None)
    assert [str(issue) for issue in proof.issues] == []
    assert proof.ok
    rule = proof.rule("verify.holder")
    assert rule.ran and rule.worst is not None and 0.0 < rule.worst <= 5.0
    assert programs()[MAIN].count("SetDO doBlankHolder,1;") == 5  # 25 mm in steps of 5 mm


def edited(fault: str) -> dict[str, str]:
    rows = programs()[MAIN].split("\n")
    at = [k for k in range(len(rows)) if rows[k : k + 4] == PULSE]
    assert len(at) == 5
    if fault == "one is missing":
        del rows[at[2] : at[2] + 4]
    elif fault == "one too many":
        rows[at[2] : at[2]] = PULSE
    elif fault == "one step late, another early":
        del rows[at[1] : at[1] + 4]
        rows[at[3] - 4 : at[3] - 4] = PULSE
    elif fault == "all at the beginning":
        for k in reversed(at):
            del rows[k : k + 4]
        rows[at[0] : at[0]] = PULSE * 5
    elif fault == "too short":
        rows[at[1] + 1] = "    WaitTime 0.02;"
    elif fault == "too soon again":
        rows[at[3] : at[3] + 4] = [*PULSE[:3], *PULSE]
        del rows[at[4] + 3 : at[4] + 7]
    elif fault == "left on":
        del rows[at[4] + 2]
    elif fault == "before the tool is on the sheet":
        del rows[at[0] : at[0] + 4]
        first = next(k for k, row in enumerate(rows) if row == "    form_f1_in;")
        rows[first:first] = PULSE
    elif fault == "behind the pass":
        del rows[at[4] : at[4] + 4]
        last = next(k for k, row in enumerate(rows) if row == "    retreat;")
        rows[last:last] = PULSE
    return {**programs(), MAIN: "\n".join(rows)}


FAULTS = (
    "one is missing",
    "one too many",
    "one step late, another early",
    "all at the beginning",
    "too short",
    "too soon again",
    "left on",
    "before the tool is on the sheet",
    "behind the pass",
)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_the_signal_are_found(fault: str) -> None:
    assert "verify.holder" in broken(proven(edited(fault)))


def test_a_tool_that_goes_ahead_of_the_clamp_is_found() -> None:
    claims = registry.claims(coarse())
    sooner = tuple(
        dataclasses.replace(claim, step=2.4e-3) if type(claim).__name__ == "SinksHolder" else claim
        for claim in claims["dome"]
    )
    assert "verify.holder" in broken(
        Prover(coarse(), {"dome": sooner}).prove(programs(), last="verify.holder")
    )


def test_another_signal_is_refused() -> None:
    text = programs()[MAIN].replace("SetDO doBlankHolder,1;", "SetDO doCoolant,1;", 1)
    assert "verify.signals" in broken(proven({**programs(), MAIN: text}, "verify.signals"))


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize(
    ("path", "by"), [("helical", 0.5), ("helical", 1.3), ("contour", 2.5), ("helical", 7.0)]
)
def test_the_clamp_keeps_within_a_step_of_the_tip(path: str, by: float) -> None:
    """The tip's level straight from the targets, the clamp's from the actions in their order."""
    one = operation(coarse(), {"step_mm": by}, path=path, stepdown_mm=1.0, tangent_deg=12.0)
    problem = coarse()
    targets = forming.FormingJob(one, problem.setups[0], problem.part).targets()
    form = np.array([str(one) == "form/f1" for one in targets.segment])
    tip = targets.pose["robot"][:, 2, 3] - 6e-3
    start, end = SHEET + RISE, SHEET
    clamp = start
    pulses: dict[int, int] = {}
    for action in targets.actions:
        assert action.kind != "on" or targets.stop[action.target]
        pulses[action.target] = pulses.get(action.target, 0) + (action.kind == "on")
    low = start
    for k in np.flatnonzero(form | np.roll(form, -1)):
        low = min(low, float(tip[k]))
        assert abs(clamp - low) <= by * 1e-3 + 1e-5
        clamp -= pulses.get(int(k), 0) * by * 1e-3
        assert abs(clamp - low) <= by * 1e-3 + 1e-5
    assert end - 1e-6 <= clamp < end + by * 1e-3
    assert sum(pulses.values()) == int(RISE / (by * 1e-3) + 1e-6)


def test_steps_that_are_too_small_for_the_tools_moves_are_refused() -> None:
    one = operation(coarse(), {"step_mm": 0.3}, path="contour", stepdown_mm=2.5)
    problem = coarse()
    with pytest.raises(TandemError) as caught:
        forming.FormingJob(one, problem.setups[0], problem.part).targets()
    assert {issue.code for issue in caught.value.issues if issue.severity.value == "error"} == {
        "forming.holder_step"
    }


def test_a_depth_of_no_whole_steps_is_told() -> None:
    there = work_of(operation(coarse(), {"step_mm": 4.0}))
    paths = [(forming_pass, make_tool_path(there, forming_pass)) for forming_pass in there.passes]
    (issue,) = two_point.step_issues(there, paths)
    assert issue.code == "forming.holder_step" and issue.severity.value == "warning"
    assert "1.00 mm higher" in issue.message


@pytest.mark.parametrize(("kind", "how"), [("male", "fixed"), ("female", "sinking")])
def test_dies_and_holders_that_do_not_go_together(kind: str, how: str) -> None:
    there = dataclasses.replace(
        work_of(coarse_operation()), operation=operation(coarse(), {"kind": kind, "holder": how})
    )
    assert [issue.code for issue in two_point.holder_issues(there)] == ["forming.holder"]


def test_one_feature_over_a_die_that_sinks() -> None:
    there = work_of(coarse_operation())
    two = dataclasses.replace(there.passes[0], feature=2, name="f2")
    there = dataclasses.replace(there, passes=(*there.passes, two))
    assert [issue.code for issue in two_point.holder_issues(there)] == ["forming.holder"]


def coarse_operation() -> Forming:
    one = coarse().operations[0]
    assert isinstance(one, Forming)
    return one


def test_a_holder_needs_a_step_where_ridges_set_the_tools() -> None:
    data = yaml.safe_load((PROBLEM_FOLDER / "problem.yaml").read_text())["operations"][0]
    del data["stepdown_mm"], data["die"]["step_mm"]
    with pytest.raises(ValueError, match="step_mm"):
        Forming.model_validate({**data, "scallop_mm": 0.02})


def test_die_sheet_and_clamp_are_bodies_at_all_heights() -> None:
    stock = coarse().stock
    assert stock.sheet is not None
    top = [
        float(shape.pose[2, 3] + 0.5 * shape.size[2])
        for shape in (*stock.support, *stock.sheet.formed)
        if shape.kind == "box"
    ]
    # the upper bars end 10 mm above the sheet, the sheet at its top face, both 25 mm higher at first
    assert max(top) == pytest.approx(SHEET + 10e-3 + RISE)
    assert any(abs(z - (SHEET + RISE)) < 1e-9 for z in top)
    low = min(float(s.vertices[:, 2].min()) for s in stock.sheet.formed if s.vertices is not None)
    assert low == pytest.approx(-50e-3)  # the die's foot


def test_below_the_sheet_all_is_the_other_way_round() -> None:
    problem = coarse()
    die = coarse_operation().die
    assert die is not None and problem.part is not None and problem.part.formed is not None
    mesh = problem.part.formed.mesh
    down = dataclasses.replace(mesh, vertices=mesh.vertices * [1.0, 1.0, -1.0])
    part = dataclasses.replace(problem.part, formed=dataclasses.replace(problem.part.formed, mesh=down))
    bare = dataclasses.replace(problem.stock, support=problem.stock.support[:1])
    low = bare.support[0].pose[2, 3] - 0.5 * bare.support[0].size[2]
    drawn = with_die(die, -1, bare, part).support[0]
    assert drawn.pose[2, 3] - 0.5 * drawn.size[2] == pytest.approx(low - RISE)


def test_the_flat_sinks_with_the_tool() -> None:
    there = work_of(coarse_operation())
    (state,) = sheet_states(there.tree, there.mesh, there.passes, there.thickness)
    assert len(state.fixed) == 0
    assert np.unique(state.carried[:, 2].round(9)) == pytest.approx([RISE, RISE + SHEET])


def test_a_die_that_is_no_mesh_is_refused(tmp_path: Path) -> None:
    die = Die.model_validate({"file": str(tmp_path / "die.stl"), "unit": "mm", "kind": "male"})
    with pytest.raises(TandemError) as caught:
        die_mesh(die)
    assert caught.value.issues[0].code == "problem.missing_file"


def test_a_die_in_the_part_is_refused() -> None:
    """The same die in another unit is far larger than the part."""
    one = operation(coarse(), {"unit": "cm"})
    problem = coarse()
    with pytest.raises(TandemError) as caught:
        forming.FormingJob(one, problem.setups[0], problem.part).targets()
    assert "forming.die_gouge" in {issue.code for issue in caught.value.issues}


@pytest.mark.long
def test_a_die_that_is_not_the_parts_is_told_before_a_ball_that_is_too_large() -> None:
    problem = coarse()
    job = forming.FormingJob(operation(problem, {"unit": "cm"}), problem.setups[0], problem.part)
    heads = {arm: dataclasses.replace(head, radius=0.05) for arm, head in job.planned.heads.items()}
    job.__dict__["planned"] = dataclasses.replace(job.planned, heads=heads)
    with pytest.raises(TandemError) as caught:
        job.targets()
    assert {issue.code for issue in caught.value.issues} == {"forming.die_gouge"}
