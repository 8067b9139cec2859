"""Processes of installed packages that cannot be used are refused by name and affect no other problem."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from planner import pipeline
from planner.issues import Issue, TandemError
from planner.processes import registry
from tests import small_problem
from tests.toys.installation import forget, install, problem

GAUGE = "ring = tests.toys.gauge:PROCESS"
VARIANTS = "ring = tests.toys.variants:"


@pytest.fixture(autouse=True)
def _rescan_packages() -> Iterator[None]:
    forget()
    yield
    forget()


def expect_refusal(path: Path) -> str:
    with pytest.raises(TandemError) as caught:
        pipeline.load(path)
    (issue,) = caught.value.issues
    assert issue.code == "problem.process_package"
    assert issue.field == "operations.0.process" and issue.line is not None
    return issue.message


@pytest.mark.parametrize(
    ("point", "expected_text"),
    [
        ("ring = no_such_module_at_all:PROCESS", "ModuleNotFoundError"),
        ("ring = tests.toys.gauge:NOTHING", "AttributeError"),
        ("ring = tests.toys.gauge.operation:Ring", "not planner.runtime.plugins.Process"),
        (f"{VARIANTS}UNFINISHED", "has a schema without arms, leaves()"),
        (
            f"{VARIANTS}NO_KIND",
            "NoClaim'> among its claims, which is not a dataclass that inherits from Claim",
        ),
        (f"{VARIANTS}MISSING_CODES", "the codes of the process 'ring' of package broken-gauge cannot be im"),
        (
            f"{VARIANTS}NO_ROWS",
            "states the issue code 'ring.above' as str, not planner.issue_codes.IssueCode",
        ),
        (f"{VARIANTS}TANDEMS_CODE", "states the issue code verify.reach, as Tandem does"),
    ],
)
def test_what_cannot_be_used_is_refused_where_a_problem_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, point: str, expected_text: str
) -> None:
    install(monkeypatch, tmp_path, "broken-gauge", point)
    message = expect_refusal(problem(tmp_path))
    assert expected_text in message and "package broken-gauge" in message and "uninstall" in message
    assert "ring" not in registry.schemas()
    assert pipeline.load("gauge_lanes").name == "gauge_lanes"


def test_a_name_that_is_claimed_twice_is_nobodys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "one-gauge", GAUGE)
    install(monkeypatch, tmp_path, "two-gauge", GAUGE)
    message = expect_refusal(problem(tmp_path))
    assert "package one-gauge" in message and "package two-gauge" in message


def test_an_issue_code_of_two_packages_is_nobodys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "one-gauge", GAUGE)
    install(monkeypatch, tmp_path, "two-gauge", "disc = tests.toys.variants:DUPLICATE_CODES")
    for name, own, other in (("ring", "one", "two"), ("disc", "two", "one")):
        issue = registry.all_processes()[name]
        assert isinstance(issue, Issue)
        what = f"the process '{name}' of package {own}-gauge states the issue code ring.above, as package "
        assert issue.message == f"{what}{other}-gauge does; repair or uninstall package {own}-gauge"
    assert "states the issue code ring.above" in expect_refusal(problem(tmp_path))


def test_a_name_that_is_built_in_cannot_be_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "my-targets", "targets = tests.toys.gauge:PROCESS")
    message = expect_refusal(small_problem.write(tmp_path))
    assert "'targets' is claimed by Tandem and by package my-targets" in message


def test_without_the_package_the_name_is_unknown(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match="known are elastic_wire, forming"):
        pipeline.load(problem(tmp_path))


def expect_plan_refusal(path: Path) -> Issue:
    """Return the issue that refuses a readable problem before motion."""
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(path))
    (issue,) = caught.value.issues
    return issue


def test_a_claim_without_a_rule_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "ring-gauge", f"{VARIANTS}UNPROVEN")
    issue = expect_plan_refusal(problem(tmp_path))
    assert issue.code == "claims.unproven"
    assert "ring: its process claims KeepsAbove, which no rule of the proof checks" in issue.message


@pytest.mark.parametrize(
    ("variant", "expected_text"),
    [
        ("NO_PROOF", "the proof of the process 'ring' of package ring-gauge cannot be imported"),
        ("BARE_RULE", "ring.bare of tests.toys.gauge.proof has no row among the issue codes of its package"),
        (
            "BORROWED_CODE",
            "the rule verify.unread of tests.toys.gauge.proof has no row among the issue codes",
        ),
        ("SECOND_RULE", "the rule verify.follows of tests.toys.gauge.proof has the code of another rule"),
        ("NO_STAGE", "has the stage 'someday'; stages are text, robots, tasks, setups, curves, motion, "),
    ],
)
def test_rules_that_cannot_be_used_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variant: str, expected_text: str
) -> None:
    """A rule that never runs would leave its claims unproven without notice."""
    install(monkeypatch, tmp_path, "ring-gauge", f"{VARIANTS}{variant}")
    issue = expect_plan_refusal(problem(tmp_path))
    assert issue.code == "problem.process_package"
    assert expected_text in issue.message and "uninstall" in issue.message


def test_a_report_that_cannot_be_used_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "ring-gauge", f"{VARIANTS}NO_REPORT")
    issue = expect_plan_refusal(problem(tmp_path))
    assert issue.code == "problem.process_package"
    assert "the report of the process 'ring' of package ring-gauge is tuple, not planner" in issue.message
