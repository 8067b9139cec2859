"""What languages contribute to the proof."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from planner.issues import Issue
from planner.proof.language_contribution import ProofOfLanguage, checked, job_issues, of_arm, of_file, of_task
from planner.proof.rule import Outcome
from planner.proof.rule_table import built_in
from planner.proof.same_program import same_program
from planner.runtime import plugins
from planner.runtime.plugins import Language

FOUND = Issue("verify.hidden", "something is hidden")
TOY = ProofOfLanguage(
    checks={"verify.hidden": lambda context, task: Outcome((FOUND,))},
    job_checks={"verify.files": lambda context: [FOUND]},
)


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two languages with one contribution, and one without."""
    reader, proof = "tests:reader", "tests.proof.test_contribution:TOY"
    languages = {
        name: Language(name, (name.upper(),), (f".{name}",), reader, reader, proof=part)
        for name, part in (("one", proof), ("other", proof), ("bare", None))
    }
    monkeypatch.setattr(plugins, "usable", lambda kind: languages)


def _task(language: str) -> Any:
    return SimpleNamespace(text=SimpleNamespace(language=language))


def test_a_rule_asks_the_language_of_a_task(toys: None) -> None:
    context: Any = None
    assert checked("verify.hidden", context, _task("one")).issues == (FOUND,)
    for code, language in (("verify.names", "one"), ("verify.hidden", "bare"), ("verify.hidden", "")):
        assert checked(code, context, _task(language)) == Outcome()


def test_a_contribution_that_languages_share_is_asked_once(toys: None) -> None:
    context: Any = None
    assert job_issues("verify.files", context) == [FOUND]
    assert job_issues("verify.names", context) == []


def test_languages_are_known_by_tasks_files_and_arms(toys: None) -> None:
    arm: Any = SimpleNamespace(data=SimpleNamespace(family="OTHER"))
    assert of_task(_task("one")) is of_file("left/a.ONE") is of_arm(arm) is TOY
    assert of_file("a.txt") == of_task(_task("bare")) == ProofOfLanguage()


@pytest.mark.parametrize("name", ["rapid", "krl", "urscript", "trajectories"])
def test_parts_belong_to_rules_of_the_proof(name: str) -> None:
    own = of_task(_task(name))
    assert {*own.checks, *own.job_checks, *(rule.code for rule in own.rules)} <= set(built_in())


@pytest.mark.parametrize("file", ["a.jsonl", "controller/left/EIO.cfg"])
def test_files_without_comments_are_compared_as_they_are(file: str) -> None:
    assert same_program({file: '{"t": 1}'}, {file: '{"t": 1}'})
    assert not same_program({file: '{"t": 1}'}, {file: '{"t": 2}'})
