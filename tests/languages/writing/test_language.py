"""Language writers that installed packages add by entry points: they are used, or refused by name."""

from __future__ import annotations

import dataclasses

import pytest

from planner.issues import TandemError
from planner.languages.writing import write
from planner.languages.writing.language import Writer, WrittenPrograms, writers
from planner.languages.writing.layout import SegmentRun
from planner.runtime import plugins
from planner.runtime.plugins import Language, LoadedPlugin
from tests.languages.writing import synthetic


def rows(tasks, job, plan, problem, margins):
    """Joints and times of all moves, a file for each arm."""
    files = {}
    for task in tasks:
        runs = [(op.moves, s) for op in task.operations for s in op.steps if isinstance(s, SegmentRun)]
        lines = [
            ",".join(f"{value:.6f}" for value in (*track.q[row], track.duration[row]))
            for track, run in runs
            for row in range(run.first, run.last)
        ]
        files[f"{task.arm.name}.csv"] = "\n".join([*lines, ""])
    return WrittenPrograms(files)


WRITER = Writer(rows)
TOY = Language("toy rows", ("toy",), (".csv",), "nowhere:READER", f"{__name__}:WRITER")


@pytest.fixture
def add(monkeypatch):
    """Installs a language as a package would."""

    def install(language: Language) -> None:
        found = {**plugins.installed(Language), "toy": LoadedPlugin(language, "package toy")}
        monkeypatch.setattr(plugins, "installed", lambda kind: found)

    return install


def driven(arms=("left",), **controller):
    """A plan and a problem, whose arms are of the family "toy"."""
    job = synthetic.problem(("left", "right"), **controller)
    toys = tuple(
        dataclasses.replace(arm, custom_data=dataclasses.replace(arm.data, family="toy"))
        for arm in job.cell.arms
    )
    job = dataclasses.replace(job, cell=dataclasses.replace(job.cell, arms=toys))
    q = {arm: synthetic.sweep(5) for arm in arms}
    labels = ["mount", "1st", "1st", "1st", "unmount"]
    return synthetic.plan(synthetic.operation(job, q, labels, actions=(), coupled=False)), job


def refused(plan, problem):
    with pytest.raises(TandemError) as caught:
        write.program_files(plan, problem)
    (issue,) = caught.value.issues
    return issue


def test_a_language_of_another_package_is_written(add):
    add(TOY)
    plan, problem = driven()
    files = write.program_files(plan, problem)
    assert list(files) == ["left.csv"]
    lines = [[float(value) for value in line.split(",")] for line in files["left.csv"].splitlines()]
    assert len(lines) == 4
    assert lines[-1] == pytest.approx([*plan.operations[0].q["left"][-1], 0.5], abs=1e-6)
    # RAPID has no name for the segment "1st", but these arms do not read RAPID
    assert write.refusals(problem, [plan.operations[0].targets]) == write.program_notes(plan, problem) == ()


@pytest.mark.parametrize(("sync", "text"), [("multimove", "cannot move together"), ("handshake", "toy rows")])
def test_arms_whose_programs_do_not_meet_are_refused(add, sync, text):
    add(TOY)
    issue = refused(*driven(("left", "right"), sync=sync))
    assert issue.code == "post.controller" and text in issue.message


def test_an_unknown_family_is_refused(add):
    issue = refused(*driven())
    assert issue.code == "post.language" and "is of the family toy" in issue.message
    assert "allowed are ABB (RAPID), KUKA (KRL), UR (URScript)" in issue.message


def test_a_writer_that_cannot_be_used_is_refused_where_an_arm_needs_it(add):
    add(dataclasses.replace(TOY, writer=f"{__name__}:TOY"))
    issue = refused(*driven())
    assert issue.code == "post.language" and "the writer of toy rows is Language" in issue.message
    assert write.program_files(*synthetic.small())


def test_a_built_in_family_keeps_its_language(add):
    add(dataclasses.replace(TOY, families=("ABB", "toy")))
    assert [title for title, _ in writers().values()][-1] == "toy rows"
    assert writers()["ABB"][0] == "RAPID"
