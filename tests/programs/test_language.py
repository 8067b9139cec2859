"""Readers are found by the families of controllers."""

from __future__ import annotations

import dataclasses

import pytest

from planner.problem import Problem
from planner.programs import job, language
from planner.runtime import plugins
from tests.processes.hotwire.proof import straight_job

LANGUAGES = {"abb": "rapid", "kuka": "krl", "ur": "urscript", "ros": "trajectories"}


def with_family(family: str) -> Problem:
    problem = straight_job.problem()
    arms = tuple(
        dataclasses.replace(arm, custom_data=dataclasses.replace(arm.data, family=family))
        for arm in problem.cell.arms
    )
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms))


@pytest.mark.parametrize(("family", "name"), LANGUAGES.items())
def test_each_language_has_a_reader(family: str, name: str) -> None:
    arm = with_family(family.upper()).cell.arms[0]
    found = plugins.language_of(arm.data.family)
    assert found is not None
    assert found is plugins.usable(plugins.Language)[name]
    assert language.reader_of(arm) is plugins.load(found.reader, language.Reader)


def test_an_arm_without_a_language_has_no_programs() -> None:
    found = job.read_job(with_family("generic"), {"T_ROB1/a.mod": "MODULE a\nENDMODULE\n"})
    assert (found.tasks, found.strays) == ((), ("T_ROB1/a.mod",))
