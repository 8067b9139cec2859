"""Batches in which one problem takes its plan from a neighbour: which panel is whose reference, and order."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from planner import pipeline
from planner.batch import run as batch
from planner.batch.job import BatchJob, JobEvent, JobFinished, JobRecord, JobResult
from planner.batch.reference_neighbours import MAX_RINGS, assign_reference_neighbours, reference_panels
from planner.batch.rows import BatchItem
from planner.batch.run import BatchSettings
from planner.cli import command_line
from planner.cli.batch import Batch
from planner.cli.batch import run_batch as command
from planner.issues import TandemError
from tests import small_problem
from tests.batch.jobs import content

BEYOND = {"A": "BC", "B": "ADE", "C": "AE", "D": "B", "E": "BC", "F": "", "X": "A"}
"""Panels with their neighbours; X is of another job."""


def element(folder: Path, names: str = "ABCDEFX") -> list[BatchItem]:
    """Panels of an element, each a small problem, as items of a batch."""
    panels = folder / "panels"
    panels.mkdir(parents=True)
    rows = [
        {"id": name, "neighbours": [*beyond, None], "job": "other" if name == "X" else "one"}
        for name, beyond in BEYOND.items()
    ]
    (folder / "element.json").write_text(json.dumps({"panels": rows}))
    for name in names:
        (panels / f"{name}.yaml").write_text(small_problem.PROBLEM.replace("name: small", f"name: {name}"))
    (panels / "targets.csv").write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS]) + "\n")
    return batch.collect_items([panels], folder / "out")


REFERENCE_PANELS = {"A": "B", "B": None, "C": "A", "D": "B", "E": "B", "F": None, "X": None}
"""Who is like whom: B is the fewest steps from all others."""


def test_each_panel_is_like_the_neighbour_from_which_it_is_reached_first(tmp_path: Path) -> None:
    assert {
        item.name: item.reference for item in assign_reference_neighbours(element(tmp_path))
    } == REFERENCE_PANELS


def panel_rows(beyond: Mapping[str, list[str]]) -> dict[str, Any]:
    """Return the rows of ``element.json`` of panels with these neighbours."""
    return {"panels": [{"id": item, "job": "one", "neighbours": [*some]} for item, some in beyond.items()]}


def depths(like: Mapping[str, str], names: Iterable[str]) -> list[int]:
    """How many panels each one waits for, one after the other."""

    def depth(name: str) -> int:
        return 1 + depth(like[name]) if name in like else 0

    return [depth(name) for name in names]


@pytest.mark.parametrize("count", [1, 2, 5, 13, 14, 16, 26, 260])
def test_a_row_of_panels_is_planned_from_the_fewest_middles(count: int) -> None:
    """A path of n panels needs ceil(n / 13) firsts for none to be more than six steps away."""
    beyond = {f"{i}": [f"{k}" for k in (i - 1, i + 1) if 0 <= k < count] for i in range(count)}
    like = reference_panels(panel_rows(beyond), list(beyond))
    firsts = math.ceil(count / (2 * MAX_RINGS + 1))
    result = depths(like, beyond)
    assert result.count(0) == firsts and max(result) <= MAX_RINGS
    assert result.count(1) >= min(2 * firsts, count - firsts)  # both ways from each, so two are at hand


def test_panels_begin_with_those_that_are_done_where_these_are_near() -> None:
    beyond = {f"{i}": [f"{k}" for k in (i - 1, i + 1) if 0 <= k < 20] for i in range(20)}
    like = reference_panels(panel_rows(beyond), list(beyond), ["0"])
    assert [item for item in beyond if item not in like] == ["0", "13"]
    assert like["1"] == "0"


def test_panels_whose_element_names_no_jobs_are_alike() -> None:
    """Elastic ones were written so, and lie in stores of services."""
    rows = [{"id": "A", "neighbours": ["B"]}, {"id": "B", "neighbours": ["A", None]}]
    assert reference_panels({"panels": rows}, ["A", "B"]) in ({"A": "B"}, {"B": "A"})


def test_panels_of_a_shell_wait_for_few_others_and_for_neighbours_alone() -> None:
    cells = list(itertools.product(range(14), range(20)))
    steps = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, -1), (-1, 1))  # six neighbours, as hexagons have
    beyond = {
        f"{i}-{k}": [f"{i + a}-{k + b}" for a, b in steps if (i + a, k + b) in set(cells)] for i, k in cells
    }
    like = reference_panels(panel_rows(beyond), list(beyond))
    assert all(other in beyond[item] for item, other in like.items())
    result = depths(like, beyond)
    assert max(result) <= MAX_RINGS
    assert (
        2 <= result.count(0) <= len(cells) // 40
    )  # six rings of hexagons are 127 in the open, fewer at a rim


def test_of_panels_that_are_not_planned_nobody_is_like(tmp_path: Path) -> None:
    like = {item.name: item.reference for item in assign_reference_neighbours(element(tmp_path, "ADE"))}
    assert like == {"A": None, "D": None, "E": None}


@pytest.mark.parametrize("text", [None, "{", "[]", '{"panels": [{"id": "A"}]}'])
def test_problems_that_are_no_panels_are_refused(tmp_path: Path, text: str | None) -> None:
    items = element(tmp_path)
    if text is None:
        (tmp_path / "element.json").unlink()
    else:
        (tmp_path / "element.json").write_text(text)
    with pytest.raises(TandemError) as error:
        assign_reference_neighbours(items)
    assert [issue.code for issue in error.value.issues] == ["batch.field"]


class SlowPlanners:
    """Planners that end one job at a time, the last one begun first or the first (``turn`` 0); what fails is
    no plan."""

    ahead = 4

    def __init__(self, failing: str = "", turn: int = -1) -> None:
        self.jobs: list[BatchJob] = []
        self._failing, self._turn = failing, turn
        self._open: list[tuple[BatchJob, Path]] = []

    @property
    def busy(self) -> bool:
        return bool(self._open)

    def start(self, job: BatchJob, folder: Path, record: JobRecord | None = None) -> None:
        self.jobs.append(job)
        self._open.append((job, folder))

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        job, folder = self._open.pop(self._turn)
        folder.mkdir(parents=True)
        for name in ("plan.json", "plan.npz", "problem/problem.yaml"):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(job.name)
        yield JobFinished(
            job.name, JobResult(job.name, "infeasible" if job.name in self._failing else "verified")
        )


def plan_items(
    items: list[BatchItem], out: Path, failing: str = "", settings: BatchSettings | None = None
) -> list[BatchJob]:
    planners = SlowPlanners(failing)
    rows = batch.run_batch(items, out, planners, settings or BatchSettings(), lambda event: None)
    assert [row.item.name for row in rows] == [item.name for item in items]
    return planners.jobs


def reference_plans(jobs: list[BatchJob]) -> Mapping[str, str | None]:
    """Whose plan goes with each job."""
    out = {job.name: job.files.get("like/plan.npz", b"").decode() or None for job in jobs}
    for job in jobs:
        like = {name for name in job.files if name.startswith("like/")}
        expected = (
            {"like/plan.json", "like/plan.npz", "like/problem/problem.yaml"} if out[job.name] else set()
        )
        assert like == expected
    return out


def test_a_panel_waits_for_its_neighbour_and_gets_its_plan(tmp_path: Path) -> None:
    items = assign_reference_neighbours(element(tmp_path))
    result = reference_plans(plan_items(items, tmp_path / "out"))
    assert result == REFERENCE_PANELS


@pytest.mark.parametrize(("ahead", "turn"), [(1, 0), (2, 0), (7, 0), (7, -1)])
def test_whose_plan_a_panel_gets_hangs_on_nobody_who_is_free(tmp_path: Path, ahead: int, turn: int) -> None:
    """With one worker or seven, whoever ends first, and where some were finished before."""
    items = assign_reference_neighbours(element(tmp_path))
    planners = SlowPlanners(turn=turn)
    planners.ahead = ahead
    batch.run_batch(items, tmp_path / "out", planners, BatchSettings(), lambda event: None)
    assert reference_plans(planners.jobs) == REFERENCE_PANELS


def test_those_that_most_others_wait_for_come_first(tmp_path: Path) -> None:
    planners = SlowPlanners(turn=0)
    planners.ahead = 1
    batch.run_batch(
        assign_reference_neighbours(element(tmp_path)),
        tmp_path / "out",
        planners,
        BatchSettings(),
        lambda event: None,
    )
    assert [job.name for job in planners.jobs] == ["B", "A", "C", "D", "E", "F", "X"]


def test_a_neighbour_without_a_plan_stands_aside_for_its_own(tmp_path: Path) -> None:
    items = assign_reference_neighbours(element(tmp_path))
    assert reference_plans(plan_items(items, tmp_path / "one", failing="A"))["C"] == "B"
    assert reference_plans(plan_items(items, tmp_path / "two", failing="AB"))["C"] is None


def test_items_that_wait_for_one_another_are_planned_all_the_same(tmp_path: Path) -> None:
    a, b, *_ = element(tmp_path)
    pair = [dataclasses.replace(a, reference="B"), dataclasses.replace(b, reference="A")]
    assert reference_plans(plan_items(pair, tmp_path / "out")) == {"A": None, "B": "A"}


def test_a_job_is_another_one_where_what_it_is_like_has_changed(tmp_path: Path) -> None:
    (item,) = element(tmp_path, "A")
    before = tmp_path / "before"
    identities = set()
    for text in ("one", "other"):
        (before / "problem").mkdir(parents=True, exist_ok=True)
        (before / "plan.json").write_text(text)
        identities.add(batch.make_bundled_job("A", item.read(), reference=before).identity({}))
    identities.add(batch.make_bundled_job("A", item.read()).identity({}))
    assert len(identities) == 3


def test_an_earlier_batch_gives_its_plans_by_name(tmp_path: Path) -> None:
    items = element(tmp_path)
    plan_items(items[:2], tmp_path / "before")
    result = reference_plans(
        plan_items(items, tmp_path / "out", settings=BatchSettings(reference_folder=tmp_path / "before"))
    )
    assert result == {"A": "A", "B": "B", "C": None, "D": None, "E": None, "F": None, "X": None}
    with pytest.raises(TandemError) as error:
        command(Batch((tmp_path / "panels",), tmp_path / "new", like=str(tmp_path / "none")))
    assert "holds no plan of any" in error.value.issues[0].message


@pytest.mark.long
def test_a_batch_of_neighbours_is_what_planning_each_like_its_neighbour_is(tmp_path: Path) -> None:
    element(tmp_path, "AB")
    request = Batch((tmp_path / "panels",), tmp_path / "out", workers=1, like="neighbour")
    assert command(request) == 0
    alone, before = tmp_path / "alone", tmp_path / "out" / "A"
    assert command_line.plan(tmp_path / "panels" / "B.yaml", alone, like=before) == 0
    assert content(tmp_path / "out" / "B") == content(alone)
    assert '"like"' in (alone / "plan.json").read_text()
    assert "motion.like" in (alone / "report.html").read_text()
    kept = (tmp_path / "out" / "B").stat().st_ino
    assert command(dataclasses.replace(request, resume=True)) == 0
    assert (tmp_path / "out" / "B").stat().st_ino == kept


def test_a_folder_that_is_no_plan_or_was_tampered_with_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem, out, new = small_problem.write(tmp_path), tmp_path / "out", tmp_path / "new"
    assert command_line.plan(problem, new, like=tmp_path) == 2
    assert "plan.missing_file" in capsys.readouterr().err
    assert command_line.plan(problem, out) == 0
    stated = (out / "problem" / "problem.yaml").read_text()
    (out / "problem" / "problem.yaml").write_text(stated.replace("name: small", "name: other"))
    assert command_line.plan(problem, new, like=out) == 2
    assert "plan.damaged" in capsys.readouterr().err
    (out / "problem" / "problem.yaml").write_text(stated)
    packed = bytearray((out / "plan.npz").read_bytes())
    packed[-40] ^= 1
    (out / "plan.npz").write_bytes(packed)
    with pytest.raises(TandemError) as error:
        pipeline.plan(pipeline.load(problem), reference=out)
    assert [issue.code for issue in error.value.issues] == ["plan.damaged"]
    assert not list(new.iterdir())
