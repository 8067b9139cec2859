"""Readers are found by the families of controllers, also those of other packages."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.problem import Problem
from planner.programs import job, language, partial
from planner.programs.steps import MoveStep
from planner.runtime import plugins
from tests.processes.hotwire.proof import straight_job
from tests.programs.csv_language import READER, CsvText

ROWS = "# digest\n0,0,0,0,0,0,1\n10,0,0,0,0,0,2\n"
LANGUAGES = {"abb": "rapid", "kuka": "krl", "ur": "urscript", "ros": "trajectories"}


@pytest.fixture
def _csv_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    info = tmp_path / "tandem_csv-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tandem-csv\nVersion: 1.0\n")
    points = "[tandem.languages]\ncsv = tests.programs.csv_language:LANGUAGE\n"
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(tmp_path)
    plugins.installed.cache_clear()
    yield
    monkeypatch.undo()
    plugins.installed.cache_clear()


def with_family(family: str) -> Problem:
    problem = straight_job.problem()
    arms = tuple(
        dataclasses.replace(arm, given=dataclasses.replace(arm.data, family=family))
        for arm in problem.cell.arms
    )
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms))


@pytest.mark.parametrize(("family", "name"), LANGUAGES.items())
def test_each_language_has_a_reader(family: str, name: str) -> None:
    arm = with_family(family.upper()).cell.arms[0]
    found = language.language_of(arm)
    assert found is plugins.usable(plugins.Language)[name]
    assert language.reader_of(arm) is plugins.load(found.reader, language.Reader)


def test_an_arm_without_a_language_has_no_programs() -> None:
    found = job.read(with_family("generic"), {"T_ROB1/a.mod": "MODULE a\nENDMODULE\n"})
    assert (found.tasks, found.strays) == ((), ("T_ROB1/a.mod",))


@pytest.mark.usefixtures("_csv_installed")
def test_programs_of_another_package_are_read() -> None:
    problem = with_family("generic")
    assert language.reader_of(problem.cell.arms[0]) is READER
    found = job.read(problem, {"left/a.csv": ROWS, "a.mod": "MODULE a\nENDMODULE\n"})
    (task,) = found.tasks
    assert isinstance(task.text, CsvText)
    assert (task.name, task.text.digest, found.strays, found.faults) == ("left", "digest", ("a.mod",), ())
    times = [step.time for step in task.steps if isinstance(step, MoveStep)]
    assert times == [1.0, 2.0]
    assert [stage.steps["left"] for stage in found.stages] == [task.steps]


@pytest.mark.usefixtures("_csv_installed")
@pytest.mark.parametrize("rows", [ROWS, ROWS + "up\n"])
def test_they_are_read_as_a_whole_or_not_at_all_without_a_reader_of_parts(rows: str) -> None:
    (one,), strays = partial.read(with_family("generic"), {"anywhere/a.csv": rows})
    assert not strays
    bad = [4] if "up" in rows else []
    assert [fault.line for fault in one.unread] == bad
    assert len(one.way) == (0 if bad else 2)
    assert one.moves == (() if bad else (("anywhere/a.csv", 2), ("anywhere/a.csv", 3)))
