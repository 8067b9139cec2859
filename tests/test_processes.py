"""Processes that installed packages add by entry points: found, planned and proven, or refused by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner import pipeline
from planner.issues import TandemError
from planner.processes import registry
from planner.runtime import plugins
from tests import small_problem

RING = "{name: ring, process: ring, arms: [left], radius_mm: 40, height_mm: 300, feed_mm_s: 20}"


@pytest.fixture(autouse=True)
def _found_anew() -> Iterator[None]:
    _forget()
    yield
    _forget()


def _forget() -> None:
    registry.all_processes.cache_clear()
    plugins.installed.cache_clear()


def install(path: pytest.MonkeyPatch, folder: Path, package: str, *points: str) -> None:
    """As pip would: what a package says of itself, in a folder of the path."""
    info = folder / package / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("\n".join(["[tandem.processes]", *points]) + "\n")
    path.syspath_prepend(folder / package)


def problem(folder: Path, operation: str = RING) -> Path:
    """One arm above a block that hangs, with that operation."""
    head, _ = small_problem.PROBLEM.split("operations:")
    return small_problem.write(folder, f"{head}accept: [stock.hangs]\noperations:\n  - {operation}\n")


def test_a_process_of_another_package_is_planned_and_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, tmp_path, "ring-gauge", "ring = tests.toy_process:PROCESS")
    outcome = pipeline.plan(pipeline.load(problem(tmp_path)))
    assert outcome.verified, outcome.issues
    assert outcome.proof is not None
    (follows,) = [rule for rule in outcome.proof.rules if rule.code == "verify.follows"]
    assert follows.passed and follows.worst is not None
    # the proof holds its claims: of a circle 0.3 mm larger the same programs are not
    (ring,) = outcome.problem.operations
    larger = dataclasses.replace(outcome.problem, operations=(ring.model_copy(update={"radius_mm": 40.3}),))
    found = pipeline.verify(larger, outcome.programs)
    assert "verify.follows" in {issue.code for issue in found.issues}


def refused(path: Path) -> str:
    with pytest.raises(TandemError) as caught:
        pipeline.load(path)
    (issue,) = caught.value.issues
    assert issue.code == "problem.process_package"
    assert issue.field == "operations.0.process" and issue.line is not None
    return issue.message


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ("ring = no_such_module_at_all:PROCESS", "ModuleNotFoundError"),
        ("ring = tests.toy_process:NOTHING", "AttributeError"),
        ("ring = tests.toy_process:Ring", "not planner.runtime.plugins.Process"),
        ("ring = tests.toy_process:UNFINISHED", "has a schema without arms, leaves()"),
    ],
)
def test_what_cannot_be_used_is_refused_where_a_problem_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, point: str, said: str
) -> None:
    install(monkeypatch, tmp_path, "broken-gauge", point)
    message = refused(problem(tmp_path))
    assert said in message and "package broken-gauge" in message and "uninstall" in message
    assert "ring" not in registry.schemas()
    assert pipeline.load("gauge_lanes").name == "gauge_lanes"


def test_a_name_that_is_claimed_twice_is_nobodys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "one-gauge", "ring = tests.toy_process:PROCESS")
    install(monkeypatch, tmp_path, "two-gauge", "ring = tests.toy_process:PROCESS")
    message = refused(problem(tmp_path))
    assert "package one-gauge" in message and "package two-gauge" in message


def test_a_name_that_is_built_in_cannot_be_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "my-targets", "targets = tests.toy_process:PROCESS")
    message = refused(small_problem.write(tmp_path))
    assert "'targets' is claimed by Tandem and by package my-targets" in message


def test_without_the_package_the_name_is_unknown(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match="known are elastic_wire, forming"):
        pipeline.load(problem(tmp_path))
