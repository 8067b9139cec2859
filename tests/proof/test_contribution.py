"""Contributions of languages to the proof."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from planner.issues import Issue
from planner.proof.language_contribution import (
    ProofOfLanguage,
    check_task,
    job_issues,
    language_of_arm,
    language_of_file,
    language_of_task,
)
from planner.proof.rule import RuleOutcome
from planner.proof.rule_table import built_in
from planner.proof.same_program import is_same_program
from planner.runtime import plugins
from planner.runtime.plugins import Language

ISSUE = Issue("verify.hidden", "something is hidden")
TOY = ProofOfLanguage(
    checks={"verify.hidden": lambda context, task: RuleOutcome((ISSUE,))},
    job_checks={"verify.files": lambda context: [ISSUE]},
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
    assert check_task("verify.hidden", context, _task("one")).issues == (ISSUE,)
    for code, language in (("verify.names", "one"), ("verify.hidden", "bare"), ("verify.hidden", "")):
        assert check_task(code, context, _task(language)) == RuleOutcome()


def test_a_contribution_that_languages_share_is_asked_once(toys: None) -> None:
    context: Any = None
    assert job_issues("verify.files", context) == [ISSUE]
    assert job_issues("verify.names", context) == []


def test_languages_are_known_by_tasks_files_and_arms(toys: None) -> None:
    arm: Any = SimpleNamespace(data=SimpleNamespace(family="OTHER"))
    assert language_of_task(_task("one")) is language_of_file("left/a.ONE") is language_of_arm(arm) is TOY
    assert language_of_file("a.txt") == language_of_task(_task("bare")) == ProofOfLanguage()


@pytest.mark.parametrize("name", ["rapid", "krl", "urscript", "trajectories"])
def test_parts_belong_to_rules_of_the_proof(name: str) -> None:
    own = language_of_task(_task(name))
    assert {*own.checks, *own.job_checks, *(rule.code for rule in own.rules)} <= set(built_in())


@pytest.mark.parametrize("file", ["a.jsonl", "controller/left/EIO.cfg"])
def test_files_without_comments_are_compared_as_they_are(file: str) -> None:
    assert is_same_program({file: '{"t": 1}'}, {file: '{"t": 1}'})
    assert not is_same_program({file: '{"t": 1}'}, {file: '{"t": 2}'})
