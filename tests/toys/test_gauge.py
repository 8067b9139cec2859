"""The package with a gauge works like a part of Tandem."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from planner import pipeline
from planner.cli import command_line
from planner.issues import TandemError, is_input_error
from planner.processes import registry
from planner.proof import prove
from planner.proof.contribution import ParallelGroup, ProofOfProcess
from planner.proof.rule_table import built_in
from planner.runtime.second_process import module_path
from tests import small_problem
from tests.proof.provers import broken
from tests.runtime.test_second_process import RecordingExecutor
from tests.toys.gauge import proof
from tests.toys.installation import RING, forget, install, problem

Texts = Mapping[str, str]


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as path:
        install(path, tmp_path_factory.mktemp("gauge"), "ring-gauge", "ring = tests.toys.gauge:PROCESS")
        yield
    forget()


@pytest.fixture(scope="module")
def outcome(_installed: None, tmp_path_factory: pytest.TempPathFactory) -> pipeline.Outcome:
    return pipeline.plan(pipeline.load(problem(tmp_path_factory.mktemp("ring"))))


@pytest.fixture(scope="module")
def folder(outcome: pipeline.Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    outcome.save(out)
    return out


def test_its_claim_is_proven_by_its_rule(outcome: pipeline.Outcome) -> None:
    assert outcome.verified, outcome.issues
    above = outcome.proof.rule("ring.above")
    assert above.ran and above.applies and above.passed
    assert above.worst == pytest.approx(300.0, abs=1e-3)
    assert (above.limit, above.unit, above.where) == (299.0, "mm", "cut/ring")
    assert above.title.startswith("While a gauge goes round")


def test_its_rule_runs_after_those_of_tandem_in_its_stage(outcome: pipeline.Outcome) -> None:
    codes = [rule.code for rule in outcome.proof.rules]
    place = codes.index("ring.above")
    assert codes[place - 1] == "verify.order"
    assert codes[:place] + codes[place + 1 :] == list(built_in())


def test_its_claims_are_of_the_problem(outcome: pipeline.Outcome) -> None:
    """The same programs are not proven for a circle that is larger by 0.3 mm, or has to be higher."""
    (ring,) = outcome.problem.operations
    for change, code in (({"radius_mm": 40.3}, "verify.follows"), ({"least_mm": 300.1}, "ring.above")):
        other = dataclasses.replace(outcome.problem, operations=(ring.model_copy(update=change),))
        assert code in broken(pipeline.verify(other, outcome.programs))


def _dip(texts: Texts) -> Texts:
    """Two targets between places that the gauge has to pass are 2 mm lower."""
    (name,) = (name for name in texts if "Cut" in name)
    lines = texts[name].split("\n")
    moves = [number for number, line in enumerate(lines) if "MoveL" in line]
    for number in moves[12:14]:
        assert ",400.0000]" in lines[number]
        lines[number] = lines[number].replace(",400.0000]", ",398.0000]")
    return {**texts, name: "\n".join(lines)}


def _renamed(texts: Texts) -> Texts:
    """The gauge goes round, but in another segment."""
    return {name: text.replace("cut_ring", "link_ring") for name, text in texts.items()}


@pytest.mark.parametrize("fault", [_dip, _renamed])
def test_its_rule_alone_catches_a_fault(outcome: pipeline.Outcome, fault: Callable[[Texts], Texts]) -> None:
    found = pipeline.verify(outcome.problem, fault(outcome.programs))
    assert broken(found) == {"ring.above"}
    (issue,) = found.issues
    assert issue.hint == "plan again, or lower least_mm"
    if fault is _dip:
        assert (issue.value, issue.limit, issue.unit, issue.field) == (298.0, 299.0, "mm", "cut/ring")
        assert "298.000 mm above the block" in issue.message


def test_its_codes_are_those_of_refusals_and_notes(outcome: pipeline.Outcome, tmp_path: Path) -> None:
    (note,) = outcome.issues
    assert note.code == "ring.height"
    low = RING.replace("height_mm: 300", "height_mm: 298")
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(problem(tmp_path, low)))
    assert [issue.code for issue in caught.value.issues] == ["ring.height"]
    assert is_input_error(caught.value.issues)


def test_its_codes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    command_line.issues()
    shown = capsys.readouterr().out
    assert "ring.above" in shown and "ring.height" in shown and "verify.reach" in shown


def test_the_report_shows_its_parts(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert "<b>300.0<small>mm</small></b><span>gauge above the block</span>" in page  # a tile
    assert "<dt>gauge stays above the block by</dt><dd>299.0 mm</dd>" in page  # a row of the setup sheet
    assert "Height of the gauge</figcaption>" in page  # a chart
    assert "<code>ring.above</code>" in page and "<code>ring.height</code>" in page
    assert "ring.above" in {rule["code"] for rule in json.loads((folder / "proof.json").read_text())["rules"]}
    assert (folder / "replay.html").stat().st_size > 0


FRESH = """
import sys
from planner import pipeline, plans
from planner.claims import claim
made = plans.load(sys.argv[1])
print({"MillsSurface", "TrimsSheet"} <= {kind.__name__ for kind in claim.kinds()})
problem, same = pipeline.load_planned_result(sys.argv[1])
print(problem.operations[0].least_mm, made.digest == same.digest == problem.digest)
print(*(type(claim).__name__ for claim in made.operations[0].targets.claims))
print(*(issue.code for issue in made.issues))
"""


def test_its_plan_is_loaded_in_another_process(folder: Path) -> None:
    found = subprocess.run(
        [sys.executable, "-c", FRESH, str(folder)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": module_path()},
        check=True,
    )
    assert found.stdout.splitlines() == [
        "True",
        "299.0 True",
        "FollowsPoses KeepsAbove OperatorDialogue",
        "ring.height",
    ]


def test_two_processes_give_the_same_bytes(outcome: pipeline.Outcome, folder: Path, tmp_path: Path) -> None:
    pipeline.plan(outcome.problem, processes=2).save(tmp_path)
    one, two = ({p.relative_to(f): p for p in f.rglob("*.*")} for f in (folder, tmp_path))
    assert one.keys() == two.keys()
    for name in one.keys() - {Path("plan.json"), Path("report.html")}:
        assert one[name].read_bytes() == two[name].read_bytes(), name


def test_its_rule_is_examined_in_the_second_process(
    outcome: pipeline.Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An issue with its code comes back from there."""
    given = outcome.problem, registry.claims(outcome.problem), _dip(outcome.programs)
    one = prove.prove(*given)
    rule, group = (
        dataclasses.replace(proof.above, parallel_group="ring"),
        ParallelGroup("ring", "motion", lambda _: True),
    )
    monkeypatch.setattr(proof, "PROOF", ProofOfProcess((rule,), parallel_groups=(group,)))
    with RecordingExecutor() as second:
        two = prove.prove(*given, second)
        assert second.done == [True, True]
    assert one.issues == two.issues
    assert broken(two) == {"ring.above"}


def test_nothing_of_it_appears_in_other_proofs(tmp_path: Path) -> None:
    other = pipeline.load(small_problem.write(tmp_path))
    found = pipeline.verify(other, {})
    assert [rule.code for rule in found.rules] == list(built_in())
