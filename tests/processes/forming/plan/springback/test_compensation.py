"""Springback compensation: shifts along the path, the springback file, and refused files.

The forecasts follow a formula here. No elastic sheet is solved.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.geometry.arrays import lengths
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.processes import registry
from planner.processes.forming.plan.check import check
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.springback import compensation, compensation_file
from tests import small_forming
from tests.processes.forming.plan.springback import springback_files as files

SLOPE = 0.05


def job(folder: Path, mode: str = "spif", **op: Any) -> FormingJob:
    data = small_forming.problem(mode, force_n=500.0, **op)
    path = small_forming.write(folder, data, small_forming.dish())
    found = registry.jobs(pipeline.load(path))[0]
    assert isinstance(found, FormingJob)
    return found


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> FormingJob:
    return job(tmp_path_factory.mktemp("dsif"), "dsif")


@pytest.fixture(scope="module")
def text(together: FormingJob) -> str:
    return files.text_of(together)


def with_springback_file(job: FormingJob, folder: Path, text: str, **limits: Any) -> FormingJob:
    """The same job with a springback file."""
    path = files.written(folder / "back.json", text)
    operation = job.operation.model_copy(update={"springback": Springback(file=path, **limits)})
    return FormingJob(operation, job.setup, job.part)


def refusal_messages(job: FormingJob) -> list[str]:
    with pytest.raises(TandemError) as refused:
        job.targets()
    assert {issue.code for issue in refused.value.issues} == {"forming.compensation"}
    assert all("tandem springback" in str(issue.hint) for issue in refused.value.issues)
    return [issue.message for issue in refused.value.issues]


def test_shifts_begin_at_nothing_and_keep_their_slope(together: FormingJob) -> None:
    laid, found = files.forecast_job(together)
    (way,), left = compensation.compensated_paths(together.planned, laid, found, SLOPE)
    gone = arc_length(way.point)
    assert way.shift[0] == 0.0
    step = np.diff(gone)
    assert np.abs(np.diff(way.shift)[step > 0.0] / step[step > 0.0]).max() <= SLOPE * (1.0 + 1e-9)
    # where it has grown it is the forecast
    depth = np.abs(way.point[:, 2] - way.point[0, 2])
    later = gone > 1.5 * 1.2 * MM / SLOPE
    assert way.shift[later] == pytest.approx(1.2 * MM - 0.05 * depth[later], abs=0.1 * MM)
    assert left[0].max() == pytest.approx(1.2 * MM, abs=0.05 * MM)


def test_a_steeper_slope_leaves_less(together: FormingJob) -> None:
    laid, found = files.forecast_job(together)
    (slow,), _ = compensation.compensated_paths(together.planned, laid, found, 0.01)
    (fast,), _ = compensation.compensated_paths(together.planned, laid, found, 0.2)
    assert slow.shift.max() < fast.shift.max() + 1e-9
    gone = arc_length(fast.point)
    assert np.interp(20.0 * MM, gone, fast.shift) > 1.0 * MM
    assert np.interp(20.0 * MM, arc_length(slow.point), slow.shift) == pytest.approx(0.2 * MM, abs=1e-6)


def test_both_tools_are_shifted_alike_and_their_gap_stays(together: FormingJob) -> None:
    laid, found = files.forecast_job(together)
    ways, _ = compensation.compensated_paths(together.planned, laid, found, SLOPE)
    ((one, before),) = laid
    ((_, after),) = compensation.apply_shifts(laid, ways)
    assert before.support_centre is not None
    assert after.support_centre is not None
    apart = lengths(after.forming_centre - after.support_centre)
    # what targets there were before: none of them is left out, also where one tool stands and the other turns
    row = 0
    for k in range(len(before.forming_centre)):
        while not (
            np.allclose(after.forming_centre[row, :2], before.forming_centre[k, :2], atol=1e-12)
            and np.allclose(after.support_centre[row, :2], before.support_centre[k, :2], atol=1e-12)
        ):
            row += 1
        assert apart[row] == pytest.approx(
            float(lengths(before.forming_centre[k] - before.support_centre[k])), abs=1e-9
        )
        deeper = one.side * (before.forming_centre[k, 2] - after.forming_centre[row, 2])
        assert deeper == pytest.approx(
            one.side * (before.support_centre[k, 2] - after.support_centre[row, 2]), abs=1e-12
        )
        assert -1e-12 <= deeper <= 1.2 * MM
    # targets between are on the straight moves that there were
    released = after.forming_centre.copy()
    released[:, 2] += one.side * np.interp(arc_length(released), *_arc_length_and_shift(ways[0]))
    gone = arc_length(before.forming_centre)
    fraction = np.linspace(0.0, 1.0, 4000)
    old, new = (
        interpolate_polyline(p, arc_length(p), fraction * arc_length(p)[-1])
        for p in (before.forming_centre, ways[0].point)
    )
    assert lengths(old - new).max() < 2e-6
    assert gone[-1] == pytest.approx(arc_length(ways[0].point)[-1], rel=1e-9)


def _arc_length_and_shift(compensated: compensation.ShiftedPath) -> tuple[np.ndarray, np.ndarray]:
    return arc_length(compensated.point), compensated.shift


def test_a_tool_below_goes_up(tmp_path: Path) -> None:
    data = small_forming.problem("spif", force_n=500.0, side="bottom")
    path = small_forming.write(tmp_path, data, small_forming.upside_down(small_forming.dish()))
    made = registry.jobs(pipeline.load(path))[0]
    assert isinstance(made, FormingJob)
    laid, found = files.forecast_job(made)
    ways, _ = compensation.compensated_paths(made.planned, laid, found, SLOPE)
    ((_, after),) = compensation.apply_shifts(laid, ways)
    assert after.forming_centre[:, 2].max() > laid[0][1].forming_centre[:, 2].max() + 0.5 * MM


def test_the_file_says_what_was_written_and_targets_go_deeper(
    together: FormingJob, text: str, tmp_path: Path
) -> None:
    made = with_springback_file(together, tmp_path, text)
    plain, deep = together.targets(), made.targets()
    former = made.operation.arms[0]
    low = [float(targets.pose[former][:, 2, 3].min()) for targets in (plain, deep)]
    assert low[1] < low[0] - 0.8 * MM
    assert [issue.code for issue in deep.issues].count("forming.compensated") == 1
    assert "compensation" in deep.exhibits
    data = json.loads(text)
    assert any("500 N" in line for line in data["assumed"])
    assert any("edge slides" in line for line in data["assumed"])
    assert any("other tool" in line for line in data["assumed"])
    assert data["belongs_to"]["operation.force_n"] == 500.0
    # the released path is held against the sheet as ever
    assert check(made.planned, made.setup, make_tool_paths(made.planned)) is not None


@pytest.mark.parametrize("cut", [1, 40, 90, 4000])
def test_a_file_that_is_cut_short_is_refused(
    together: FormingJob, text: str, tmp_path: Path, cut: int
) -> None:
    if cut == 1:
        text = text.rstrip()  # the last line break says nothing
        assert with_springback_file(together, tmp_path, text).targets()
        return
    (what,) = refusal_messages(with_springback_file(together, tmp_path, text[:-cut]))
    assert "truncated" in what


def test_an_edited_file_is_refused_and_one_that_is_written_again_is_good(
    together: FormingJob, text: str, tmp_path: Path
) -> None:
    (what,) = refusal_messages(
        with_springback_file(together, tmp_path, text.replace('"force_n": 500', '"force_n": 501', 1))
    )
    assert "changed after it was written" in what
    (what,) = refusal_messages(with_springback_file(together, tmp_path, "{}"))
    assert "truncated" in what
    missing = with_springback_file(together, tmp_path, text)
    (tmp_path / "back.json").unlink()
    (what,) = refusal_messages(missing)
    assert "no such file" in what
    files.written(tmp_path / "back.json", text)
    assert missing.targets()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (files.negate_springback, "a shift of -1."),
        (files.steep, "a slope of"),
        (files.short, "the path has changed since then"),
        (lambda data: data.update(points=7), "it states 7 points"),
        (lambda data: data.update(passes=[]), "passes: got nothing"),
        (lambda data: data["passes"][0].update(name="f9"), "no shifts for pass f1"),
        (lambda data: data["passes"][0]["rings"].__setitem__(0, [[1, 2]]), "ring 0 is not a table"),
        (lambda data: data.update(tandem_springback=9), "not a springback file of version"),
        (files.each_point(lambda p: p.__setitem__(3, p[3] + 0.1)), "at its start"),
        (lambda data: data["passes"][0]["rings"][0][3].__setitem__(0, 10**400), "ring 0 is not a table"),
        (lambda data: data["control_points"][1].update(forces_n=3, displacements_mm=3), "increasing curves"),
        (lambda data: data["control_points"][1]["displacements_mm"].reverse(), "increasing curves"),
        (lambda data: data["control_points"][1].update(level=10**30), "numbers from 0 to"),
    ],
)
def test_a_file_with_wrong_values_is_refused_by_their_name(
    together: FormingJob, text: str, tmp_path: Path, change: Any, named: str
) -> None:
    wrong = files.edited(text, change)
    assert any(named in what for what in refusal_messages(with_springback_file(together, tmp_path, wrong))), (
        named
    )


def test_limits_are_the_problems(together: FormingJob, text: str, tmp_path: Path) -> None:
    assert any(
        "most_mm allows 0.5 mm" in w
        for w in refusal_messages(with_springback_file(together, tmp_path, text, most_mm=0.5))
    )
    assert any(
        "allowed 0.01" in w
        for w in refusal_messages(with_springback_file(together, tmp_path, text, slope=0.01))
    )


def test_a_file_of_another_job_is_refused_by_what_differs(
    together: FormingJob, text: str, tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    other = job(tmp_path / "other", "dsif", stepdown_mm=1.5, squeeze=0.9)
    found = refusal_messages(with_springback_file(other, tmp_path, text))
    assert len(found) == 1
    assert "operation.stepdown_mm: got 2.0, the problem has 1.5" in found[0]
    data = small_forming.problem("dsif", force_n=500.0)
    data["sheet"] |= {"thickness_mm": 1.2, "clamp": {"border": "immovable"}}
    path = small_forming.write(tmp_path / "other", data, small_forming.dish(depth=5.0))
    (made,) = registry.jobs(pipeline.load(path))
    assert isinstance(made, FormingJob)
    found = refusal_messages(with_springback_file(made, tmp_path, text))
    names = {what.split("another job: ")[1].split(":")[0] for what in found}
    assert names == {"part", "sheet.size_mm", "clamp.border_n_mm2"}


def test_modes_without_a_model_are_refused_by_name(tmp_path: Path) -> None:
    made = with_springback_file(job(tmp_path, "adsif"), tmp_path, "{}")
    with pytest.raises(TandemError) as refused:
        made.targets()
    assert [issue.code for issue in refused.value.issues] == ["forming.springback_mode"]
    assert "adsif" in refused.value.issues[0].message


def test_a_wall_that_gets_too_steep_is_told(together: FormingJob) -> None:
    laid, found = files.forecast_job(together)
    ways, _ = compensation.compensated_paths(together.planned, laid, found, SLOPE)
    assert list(compensation.steepening_issues(together.planned, laid, ways, SLOPE)) == []
    (way,) = ways
    depth = way.point[0, 2] - way.point[:, 2]
    more = compensation.ShiftedPath(way.name, way.point, 3.0 * np.maximum(depth, 0.0), way.loop)
    (issue,) = compensation.steepening_issues(together.planned, laid, [more], SLOPE)
    assert issue.code == "forming.wall_angle"
    # a wall of 40 degrees whose tools sink four times as fast
    assert issue.value == pytest.approx(np.degrees(np.arctan(4.0 * np.tan(np.radians(40.0)))), abs=3.0)


def test_the_identity_is_plain_data(together: FormingJob) -> None:
    identity = compensation_file.job_identity(together.planned, together.setup.stock, together.part)
    assert json.loads(json.dumps(identity)) == identity
    assert len(identity["part"]) == 32
