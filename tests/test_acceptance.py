"""Errors that a problem may accept by name: reported if not accepted, else shown beside every verdict."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner import pipeline, plans
from planner.catalogue.robots import data_dir
from planner.cli import command_line
from planner.cli.batch import Batch
from planner.cli.batch import run_batch as batch
from planner.issue_codes import CODES
from planner.issues import Issue, Severity, TandemError, accepted_codes, apply_acceptances
from planner.processes import registry
from tests import small_forming

FORCE = "forming.force"


def problem(folder: Path, **more: Any) -> Path:
    data = small_forming.problem("spif", stepdown_mm=3)
    data.pop("accept")
    return small_forming.write(folder, {**data, **more})


def issues_before_motion(path: Path) -> tuple[Issue, ...]:
    """Return the issues found before motion."""
    problem = pipeline.load(path)
    try:
        targets = pipeline.create_targets(problem, registry.jobs(problem))
    except TandemError as error:
        return error.issues
    result = [issue for item in targets for issue in item.issues]
    return (*result, *pipeline._unused_acceptances(problem, result))


def test_only_codes_of_the_table_can_be_accepted() -> None:
    rooms = {code.split(".")[0] for code, row in CODES.items() if row.acceptance}
    assert not rooms & {"motion", "verify", "wire", "kerf", "post", "internal", "milling"}
    with pytest.raises(ValueError, match=r"motion\.collision"):
        apply_acceptances([Issue("motion.collision", "m", accepted=False)], ["motion.collision"])


@pytest.mark.parametrize(
    ("given", "field"),
    [
        (["motion.collision"], "accept.0"),
        ([FORCE, "forming.farce"], "accept.1"),
        (["all"], "accept.0"),
        ([7], "accept.0"),
        (FORCE, "accept"),
    ],
)
def test_what_cannot_be_accepted_is_refused_by_field(tmp_path: Path, given: object, field: str) -> None:
    with pytest.raises(TandemError) as caught:
        pipeline.load(problem(tmp_path, accept=given))
    assert [(i.code, i.field) for i in caught.value.issues] == [("problem.field", field)]


def test_an_error_says_how_it_is_accepted_and_following_that_works(tmp_path: Path) -> None:
    path = problem(tmp_path)
    refused = {i.code: i for i in issues_before_motion(path) if i.severity is Severity.ERROR}
    assert list(refused) == [FORCE]
    assert refused[FORCE].value is not None and refused[FORCE].limit is not None
    assert refused[FORCE].value > 2.0 * refused[FORCE].limit
    with pytest.raises(TandemError) as caught:
        pipeline.plan(pipeline.load(path))  # the same before any motion
    assert FORCE in [i.code for i in caught.value.issues if i.severity is Severity.ERROR]
    advice = re.search(r"accept: \[.*?\]", str(refused[FORCE]))
    assert advice is not None
    path = problem(tmp_path, **yaml.safe_load(advice[0]))
    issues = pipeline.check(pipeline.load(path))
    assert not [i for i in issues if i.severity is Severity.ERROR]
    (taken,) = [i for i in issues if i.code == FORCE]
    assert taken.accepted and taken.severity is Severity.WARNING
    assert str(taken).startswith(f"warning [{FORCE}] accepted by the problem:")
    assert Issue.from_dict(taken.to_dict()) == taken


def test_a_force_a_little_beyond_the_payload_stays_a_warning(tmp_path: Path) -> None:
    free = next(i for i in issues_before_motion(problem(tmp_path)) if i.code == FORCE).limit
    assert free is not None
    for factor, severity in ((1.9, Severity.WARNING), (2.1, Severity.ERROR)):
        data = yaml.safe_load(problem(tmp_path).read_text())
        data["operations"][0]["force_n"] = factor * free
        (tmp_path / "problem.yaml").write_text(yaml.safe_dump(data))
        result = [i for i in issues_before_motion(tmp_path / "problem.yaml") if i.code == FORCE]
        assert [i.severity for i in result] == [severity]


def test_what_does_not_occur_is_a_note(tmp_path: Path) -> None:
    path = problem(tmp_path, accept=[FORCE, "straight.drop"])
    notes = [i for i in issues_before_motion(path) if i.code == "problem.accepted"]
    assert [(n.severity, n.field) for n in notes] == [(Severity.NOTE, "accept.1")]
    assert "straight.drop" in notes[0].message


def test_the_acceptance_stands_beside_every_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = problem(tmp_path, accept=[FORCE])
    assert batch(Batch((path,), tmp_path / "out", workers=1)) == 0
    assert FORCE in capsys.readouterr().out
    (result,) = [p for p in (tmp_path / "out").iterdir() if (p / "plan.json").is_file()]
    (row,) = csv.DictReader((tmp_path / "out" / "summary.csv").open())
    assert (row["state"], row["accepted"]) == ("verified", FORCE)
    assert f"accepted: {FORCE}" in (tmp_path / "out" / "summary.html").read_text()
    head = (result / "report.html").read_text().split("</header>")[0]
    assert f"Accepted by the problem: {FORCE}" in head
    assert json.loads((result / "proof.json").read_text())["accepted"] == [FORCE]
    issues = plans.load(result).issues
    assert [i.code for i in issues if i.accepted] == [FORCE]
    assert command_line.verify(result) == 0
    assert f"accepted by the problem, not by Tandem: {FORCE}" in capsys.readouterr().out
    # without the acceptance the same programs are those of another problem
    copy = result / "problem" / "problem.yaml"
    data = yaml.safe_load(copy.read_text())
    assert data.pop("accept") == [FORCE]
    copy.write_text(yaml.safe_dump(data))
    assert command_line.verify(result) == 4


def test_bundled_problems_accept_what_they_must_and_no_more() -> None:
    taking = {
        p.parent.name for p in data_dir("problems").glob("*/problem.yaml") if "accept:" in p.read_text()
    }
    assert taking == {"cone_spif", "dome_tpif"}
    path = data_dir("problems") / "cone_spif" / "problem.yaml"
    result = issues_before_motion(path)
    assert accepted_codes(result) == (FORCE,)
    assert not [i for i in result if i.code == "problem.accepted" or i.severity is Severity.ERROR]
