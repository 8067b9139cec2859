"""``tandem next-loop`` and ``simulate-loop``: what they print, write and refuse, on a small dish."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.cli import forming
from planner.cli.forming import SpringbackCommand, run_springback
from planner.cli.loop import LawOptions, NextLoop, SimulateLoop, run_next_loop, run_simulate_loop
from planner.issues import TandemError
from planner.loops.level_correction import model_springback
from planner.loops.loop_plan import read_loop_plan
from planner.processes import registry
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.springback import forecast
from planner.processes.forming.plan.springback.curves import SpringbackCurve, SpringbackPoint
from tests import small_forming
from tests.processes.forming.plan.springback import springback_files
from tests.remedies.advice import find_in_issues


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the loop reads of a result: the problem, and curves."""
    folder = tmp_path_factory.mktemp("result")
    (folder / "problem").mkdir()
    path = small_forming.write(folder / "problem", small_forming.problem(stepdown_mm=0.5, force_n=300))
    curves = folder / "springback.json"
    run_springback(SpringbackCommand(path, most_points=3, triangles=400, curves=curves), pipeline.load(path))
    return folder


def forces(result: Path, levels: int, force_fraction: float = 1.0) -> str:
    plan = read_loop_plan(result / "springback.json")
    rows = [
        f"{k},{p},{force_fraction * 0.5 * plan.levels[k].force[p]:.2f}"
        for k in range(levels)
        for p in range(len(plan.levels[k].path_index))
    ]
    return "\n".join(["level,point,force_n", *rows])


def test_lifts_stand_in_the_picture_of_springback_over_force(result: Path, tmp_path: Path) -> None:
    plan = read_loop_plan(result / "springback.json")
    rows = forces(result, 2).splitlines()
    rows = [f"{rows[0]},springback_mm", *(f"{row}," for row in rows[1:])]
    lift = 1.1 * 1e3 * float(model_springback(plan.levels[1], 0.5 * plan.levels[1].force)[3])
    at = next(k for k, row in enumerate(rows) if row.startswith("1,3,"))
    rows[at] += f"{lift:.4f}"
    (tmp_path / "forces.csv").write_text("\n".join(rows))
    page = tmp_path / "next.html"
    assert run_next_loop(NextLoop(result, LawOptions(), tmp_path / "forces.csv", output=page)) == ()
    html = page.read_text()
    assert "times kappa 1.1" in html
    assert "level 1, point 3" in html
    # the lift, and every level in the map of stability
    assert html.count('class="dot c') == 1 + len(plan.levels)
    # the lift lies on the model's curve times kappa
    x, y = (float(v) for v in re.findall(r'class="dot c0" cx="([\d.]+)" cy="([\d.]+)"', html)[0])
    dashed = re.findall(r'class="line c0 dashed" data-name="level 1, point 3" points="(.*?)"', html)[0]
    curve = np.array([[float(v) for v in point.split(",")] for point in dashed.split()])
    assert np.interp(x, curve[:, 0], curve[:, 1]) == pytest.approx(y, abs=4.0)


def expect_refusal(request: NextLoop | SimulateLoop) -> Any:
    with pytest.raises(TandemError) as error:
        run_next_loop(request) if isinstance(request, NextLoop) else run_simulate_loop(request)
    return error.value.issues[0]


def test_curves_are_those_of_the_forecast_at_every_level(result: Path) -> None:
    plan = read_loop_plan(result / "springback.json")
    assert plan.digest == pipeline.load_result(result).digest
    depth = [level.depth for level in plan.levels]
    assert len(depth) > 6
    assert np.all(np.diff(depth) > 0.0)
    for level in plan.levels:
        assert len(level.path_index) >= 48
        assert level.force == pytest.approx(300.0)
        assert level.loads[0, -1] == pytest.approx(1.4 * 300.0)
        assert np.ptp(level.path[:, 2]) < 1e-3


def test_offsets_of_the_next_level_are_written_along_its_path(result: Path, tmp_path: Path) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, 4))
    out = tmp_path / "next.csv"
    assert run_next_loop(NextLoop(result, LawOptions(), file, output=out)) == ()
    rows = list(csv.DictReader(out.open()))
    level = read_loop_plan(result / "springback.json").levels[4]
    assert len(rows) == len(level.path)
    assert {row["level"] for row in rows} == {"4"}
    offset = np.array([float(row["offset_mm"]) for row in rows])
    assert 0.1 < offset.min() <= offset.max() < 5.0
    data = tmp_path / "next.json"
    run_next_loop(NextLoop(result, LawOptions(), file, kappa=1.1, output=data))
    made = json.loads(data.read_text())
    assert made["way"] == [0, 0, -1]
    assert [place["offset_mm"] for place in made["places"]] == pytest.approx(1.1 * offset, abs=2e-4)


def test_files_with_shifts_and_no_curves_are_told_in_one_message(result: Path, tmp_path: Path) -> None:
    job = registry.job(pipeline.load(result / "problem" / "problem.yaml"), 0)
    assert isinstance(job, FormingJob)
    back = tmp_path / "back.json"
    back.write_text(springback_files.text_of(job))
    offsets = tmp_path / "offsets.json"
    run_next_loop(NextLoop(result, LawOptions(), output=offsets))
    run_next_loop(NextLoop(result, LawOptions(), problem=tmp_path / "next.yaml"))
    level = pipeline.load(tmp_path / "next.yaml").operations[0].level.file  # type: ignore[attr-defined]
    for file, what in ((back, "springback file"), (offsets, "offsets of one level"), (level, "of one level")):
        request = NextLoop(result, LawOptions(springback=file))
        with pytest.raises(TandemError) as error:
            run_next_loop(request)
        (issue,) = error.value.issues
        assert issue.code == "forming.loop_curves"
        assert what in issue.message
        assert "--curves FILE" in str(issue.hint)


def test_lifts_in_the_file_scale_the_offsets(result: Path, tmp_path: Path) -> None:
    file, out = tmp_path / "forces.csv", tmp_path / "next.json"
    text = forces(result, 2)
    file.write_text(text)
    run_next_loop(NextLoop(result, LawOptions(), file, output=out))
    model = json.loads(out.read_text())
    lines = text.replace("force_n", "force_n,springback_mm").splitlines()
    lines[1:] = [f"{line}," for line in lines[1:]]
    plan = read_loop_plan(result / "springback.json")
    true = 1.2 * float(
        np.interp(float(lines[3].split(",")[2]), plan.levels[0].loads[2], plan.levels[0].springback[2])
    )
    lines[3] += f"{1e3 * true:.4f}"
    file.write_text("\n".join(lines))
    run_next_loop(NextLoop(result, LawOptions(), file, output=out))
    made = json.loads(out.read_text())
    assert made["kappa"] == pytest.approx(1.2, abs=0.1)
    ratio = made["places"][0]["offset_mm"] / model["places"][0]["offset_mm"]
    assert ratio == pytest.approx(made["kappa"], abs=1e-3)


def test_a_gain_that_swings_up_is_refused_and_the_one_advised_is_not(result: Path) -> None:
    law = LawOptions(rule="half", gain=4.0)
    issue = expect_refusal(NextLoop(result, law))
    assert issue.code == "forming.loop_unstable"
    assert issue.limit is not None
    assert f"{issue.limit:.2f}" in issue.message
    gain = float(find_in_issues([issue], r"gain ([\d.]+) at most"))
    run_next_loop(NextLoop(result, dataclasses.replace(law, gain=gain)))


def test_curves_of_another_problem_are_refused_and_writing_them_again_helps(
    result: Path, tmp_path: Path
) -> None:
    data = json.loads((result / "springback.json").read_text())
    data["digest"] = "0" * 64
    other = tmp_path / "other.json"
    other.write_text(json.dumps(data))
    issue = expect_refusal(NextLoop(result, LawOptions(springback=other)))
    assert issue.code == "forming.loop_curves"
    file = re.search(r"tandem springback (\S+) --curves (\S+)", str(issue.hint))
    assert file is not None
    request = SpringbackCommand(Path(file[1]), most_points=3, triangles=400, curves=Path(file[2]))
    run_springback(request, pipeline.load(request.problem))
    run_next_loop(NextLoop(result, LawOptions(springback=other)))


@pytest.mark.parametrize(
    ("field", "value"),
    [("every", 0), ("gain", -1.0), ("weight", 0.0), ("slope", 2.0), ("most_mm", float("nan"))],
)
def test_a_figure_out_of_range_is_named_and_the_default_serves(
    result: Path, field: str, value: float
) -> None:
    options: dict[str, Any] = {field: value}
    issue = expect_refusal(NextLoop(result, LawOptions(**options)))
    assert (issue.code, issue.field) == ("forming.loop_law", field)
    run_next_loop(NextLoop(result, LawOptions()))


def test_forces_of_the_last_level_leave_nothing_to_correct(result: Path, tmp_path: Path) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, len(read_loop_plan(result / "springback.json").levels)))
    assert expect_refusal(NextLoop(result, LawOptions(), file)).code == "forming.loop_forces"


def test_offsets_beyond_their_range_are_cut_and_told_and_more_range_ends_it(
    result: Path, tmp_path: Path
) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, 3))
    (issue,) = run_next_loop(NextLoop(result, LawOptions(most_mm=0.1), file))
    assert issue.code == "forming.loop_range"
    assert run_next_loop(NextLoop(result, LawOptions(most_mm=5.0), file)) == ()
    file.write_text(forces(result, 3, 5.0))
    (issue,) = run_next_loop(NextLoop(result, LawOptions(), file))
    assert issue.code == "forming.loop_range"


def test_a_simulation_prints_and_draws_what_is_left(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = read_loop_plan(result / "springback.json")
    level = plan.levels[len(plan.levels) // 2]
    plant = tmp_path / "plant.yaml"
    curve = {
        "forces_n": level.loads[0, 1:].tolist(),
        "springback_mm": (1050.0 * level.springback[0, 1:]).tolist(),
    }
    subset = {"tandem_plant": 1, "curves": [{"depth_mm": 3, **curve}], "force_n": 280}
    plant.write_text(yaml.safe_dump(subset))
    page = tmp_path / "loop.html"
    run_simulate_loop(SimulateLoop(result, LawOptions(), plant, sheets=5, lifts_mm=(1.0, 2.0), output=page))
    printed = capsys.readouterr().out
    assert "5 sheets of plant" in printed
    text = page.read_text("utf-8")
    assert "limit, rule half" in text
    assert "not corrected" in text
    plant.write_text(yaml.safe_dump({"tandem_plant": 1, "sheet": "pyramid"}))
    issue = expect_refusal(SimulateLoop(result, LawOptions(), plant))
    assert issue.code == "forming.loop_plant"


def test_the_commands_end_with_the_codes_of_what_is_wrong(result: Path, tmp_path: Path) -> None:
    file = tmp_path / "forces.csv"
    file.write_text("level,point,force_n\n0,0,-5\n")
    command = [sys.executable, "-m", "planner", "next-loop", str(result)]
    done = subprocess.run(
        [*command, "--forces", str(file)], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 2, done.stderr
    assert "forming.loop_forces" in done.stderr
    done = subprocess.run(
        [*command, "--rule", "linear", "--gain", "3"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 3, done.stderr
    assert "forming.loop_unstable" in done.stderr


@pytest.mark.parametrize("offset_mm", [float("nan"), float("inf"), -3.0, 50.0])
def test_offsets_to_go_on_from_are_within_their_range(result: Path, offset_mm: float) -> None:
    issue = expect_refusal(NextLoop(result, LawOptions(), before_mm=offset_mm))
    assert (issue.code, issue.field) == ("forming.loop_law", "before_mm")
    assert "allowed 0 to 10" in issue.message


def test_before_the_first_level_there_is_no_offset(result: Path) -> None:
    issue = expect_refusal(NextLoop(result, LawOptions(), before_mm=0.3))
    assert (issue.code, issue.field) == ("forming.loop_law", "before_mm")
    assert "allowed 0 for level 0" in issue.message


@pytest.mark.parametrize("lift", ["35", "0.0003", "0"])
def test_lifts_in_other_units_are_refused_by_level_and_point(result: Path, tmp_path: Path, lift: str) -> None:
    lines = forces(result, 3).replace("force_n", "force_n,springback_mm").splitlines()
    lines[1:] = [f"{line}," for line in lines[1:]]
    points = len(read_loop_plan(result / "springback.json").levels[0].path_index)
    row = 1 + 2 * points
    lines[row] += lift
    file = tmp_path / "forces.csv"
    file.write_text("\n".join(lines))
    issue = expect_refusal(NextLoop(result, LawOptions(), file))
    assert (issue.code, issue.field) == ("forming.loop_forces", "springback_mm")
    assert f"level 2, point 0: got {float(lift):g} mm" in issue.message


def test_numbers_of_levels_are_short(result: Path, tmp_path: Path) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, 1) + f"\n{'9' * 5000},0,100")
    issue = expect_refusal(NextLoop(result, LawOptions(), file))
    assert (issue.code, issue.field) == ("forming.loop_forces", "level")
    assert len(issue.message) < 200


@pytest.mark.parametrize(
    ("wrong", "field"),
    [({"seed": -5}, "seed"), ({"lifts_mm": (-1.0,)}, "lifts_mm"), ({"lifts_mm": (999.0,)}, "lifts_mm")],
)
def test_seeds_and_lifts_of_a_simulation_are_within_their_range(
    result: Path, tmp_path: Path, wrong: dict[str, Any], field: str
) -> None:
    plant = tmp_path / "plant.yaml"
    plant.write_text("tandem_plant: 1\nsheet: cone\n")
    issue = expect_refusal(SimulateLoop(result, LawOptions(), plant, sheets=2, **wrong))
    assert (issue.code, issue.field) == ("forming.loop_law", field)


def test_a_springback_file_wants_sheets_as_fine_as_the_proof(result: Path, tmp_path: Path) -> None:
    path = result / "problem" / "problem.yaml"
    with pytest.raises(TandemError) as error:
        run_springback(
            SpringbackCommand(path, triangles=1500, write=tmp_path / "back.json"), pipeline.load(path)
        )
    assert error.value.issues[0].field == "triangles"
    assert "allowed at least 3000" in error.value.issues[0].message
    assert not (tmp_path / "back.json").exists()


def test_sheets_of_springback_files_are_so_fine_that_a_finer_one_agrees(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fake_solve(
        _: Any, points: list[SpringbackPoint], triangles: int, shares: Any = None
    ) -> list[SpringbackCurve]:
        # what is left out of a sheet of triangles falls with their number: 7 % at 3,000
        n = np.array([0.0, 100.0, 200.0])
        return [SpringbackCurve(n, n * 1e-5 * (1.0 - 200.0 / triangles), False) for _ in points]

    monkeypatch.setattr(forming, "_solve_curves", fake_solve)
    points = [SpringbackPoint(0, np.zeros(3), 150.0, 150.0)] * 9
    assert forming._converged_triangles(cast(Any, None), [(cast(Any, None), points)]) == 6750
    assert "3.5 % from that with 6750" in capsys.readouterr().out
    snapped = SpringbackCurve(np.array([0.0, 100.0]), np.array([0.0, 1e-3]), True)
    assert forecast.max_relative_difference(points[:1], [snapped], [snapped]) == 0.0
    assert (
        forecast.max_relative_difference(points[:1], [snapped], fake_solve(None, points[:1], 4000)) == np.inf
    )


def test_offsets_of_a_plan_with_a_springback_file_are_beyond_what_that_does(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file shifts by the forecast of a formula, the loop by its own: both together are the loop's."""
    folder = tmp_path / "result"
    (folder / "problem").mkdir(parents=True)
    made = small_forming.problem(stepdown_mm=0.5, force_n=300)
    path = small_forming.write(folder / "problem", made)
    (job,) = registry.jobs(pipeline.load(path))
    assert isinstance(job, FormingJob)
    (folder / "problem" / "back.json").write_text(springback_files.text_of(job))
    made["operations"][0]["springback"] = {"file": "back.json"}
    small_forming.write(folder / "problem", made)
    data = json.loads((result / "springback.json").read_text())
    data["digest"] = pipeline.load_result(folder).digest
    (folder / "springback.json").write_text(json.dumps(data))
    file, table, plain = tmp_path / "forces.csv", tmp_path / "offsets.csv", tmp_path / "plain.csv"
    file.write_text(forces(result, 5))
    assert run_next_loop(NextLoop(folder, LawOptions(), file, before_mm=0.9, output=table)) == ()
    assert "minus that" in capsys.readouterr().out
    run_next_loop(NextLoop(result, LawOptions(), file, before_mm=0.9, output=plain))
    both, item = (np.genfromtxt(each, delimiter=",", names=True) for each in (table, plain))
    assert both["file_mm"].max() == pytest.approx(1.2 - 0.05 * 3.0, abs=0.05)
    assert both["offset_mm"] + both["file_mm"] == pytest.approx(item["offset_mm"], abs=2e-4)
    as_json = tmp_path / "offsets.json"
    run_next_loop(NextLoop(folder, LawOptions(), file, before_mm=0.9, output=as_json))
    places = json.loads(as_json.read_text())["places"]
    assert [row["file_mm"] for row in places] == pytest.approx(both["file_mm"])
    # curves of another path, and a file that is cut short
    data["passes"][0]["levels"][5]["path_mm"].pop()
    (folder / "springback.json").write_text(json.dumps(data))
    assert expect_refusal(NextLoop(folder, LawOptions(), file)).code == "forming.loop_curves"
    (folder / "problem" / "back.json").write_text("{}")
    assert expect_refusal(NextLoop(folder, LawOptions(), file)).code == "forming.loop_curves"


def test_the_next_level_is_written_as_a_problem_of_its_own(result: Path, tmp_path: Path) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, 4))
    path = tmp_path / "level" / "next.yaml"
    request = NextLoop(result, LawOptions(), file, before_mm=0.2, problem=path)
    assert run_next_loop(request) == ()
    problem = pipeline.load(path)
    (operation,) = problem.operations
    level = operation.level  # type: ignore[attr-defined]
    assert (level.number, level.pass_name, level.before_mm) == (4, "f1", 0.2)
    assert level.plan == pipeline.load_result(result).digest
    job = registry.job(problem, 0)
    made = job.targets()
    assert "forming.compensated" in {issue.code for issue in made.issues}
    whole = registry.job(pipeline.load_result(result), 0).targets()
    assert len(made.segment) < 0.4 * len(whole.segment)
    # the path of the level is that of the whole part, as much deeper as the file says
    data = json.loads(level.file.read_text())
    rows = np.array([row for ring in data["passes"][0]["rings"] for row in ring])
    assert rows[0, 3] == pytest.approx(0.2)
    assert 0.2 < rows[:, 3].max() < 5.0
    assert np.abs(np.diff(rows[:, 3])).max() > 0.0
    below = made.pose["robot"][:, 2, 3].min() / 1e-3
    assert below == pytest.approx((rows[:, 2] - rows[:, 3]).min(), abs=1e-3)


def test_a_level_overwrites_levels_and_nothing_else(result: Path, tmp_path: Path) -> None:
    path = tmp_path / "next.yaml"
    for number in (0, 1):
        file = tmp_path / "forces.csv"
        file.write_text(forces(result, number))
        run_next_loop(NextLoop(result, LawOptions(), file, before_mm=0.1 * number, problem=path))
        assert pipeline.load(path).operations[0].level.number == number  # type: ignore[attr-defined]
    own = result / "problem" / "problem.yaml"
    path.write_text(own.read_text())
    for taken, what in ((own, "own problem"), (path, "exists and is not a problem with a level")):
        before = taken.read_bytes()
        issue = expect_refusal(NextLoop(result, LawOptions(), file, before_mm=0.1, problem=taken))
        assert issue.code == "output.folder"
        assert what in issue.message
        assert taken.read_bytes() == before


@pytest.mark.parametrize(
    ("more", "field"),
    [({"problem": Path("next.json")}, "problem"), ({"problem": Path("next.yaml")}, "before_mm")],
)
def test_a_level_as_a_problem_wants_to_know_where_the_one_before_ended(
    result: Path, tmp_path: Path, more: dict[str, Any], field: str
) -> None:
    file = tmp_path / "forces.csv"
    file.write_text(forces(result, 2))
    more = {"problem": tmp_path / more["problem"]}
    assert expect_refusal(NextLoop(result, LawOptions(), file, **more)).field == field
    assert not more["problem"].exists()
