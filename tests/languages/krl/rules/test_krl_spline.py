"""Programs with spline blocks are written, read and proven. Each fault is caught, harmless rewrites pass."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from planner import pipeline
from planner.claims.claim import kinds
from planner.issues import TandemError
from planner.languages.krl.writer import spline_blocks
from planner.languages.writing import write
from planner.processes import registry
from planner.proof import context, prove
from planner.proof.rule_table import built_in
from planner.proof.rules import clearance
from planner.reading.controller import ControllerFile, build_controller
from tests import small_problem
from tests.languages.krl import spline_job
from tests.languages.krl.spline_job import MAIN, MOVES, broken
from tests.languages.krl.spline_mutants import MUTATORS, REWRITES, apply_mutation, instances
from tests.processes.hotwire.proof import straight_job


def test_a_block_keeps_the_planned_times_and_says_what_it_rests_on():
    problem, plan, texts, _ = spline_job.job()
    text = texts[MOVES]
    assert text.count("\r\nSPLINE\r\nTIME_BLOCK START\r\n") == text.count("\r\nENDSPLINE\r\n") == 1
    assert "SLIN" not in text and text.count("\r\nSPL {") == 80
    parts = np.array([float(part) for part in re.findall(r"PART = ([\d.]+)", text)])
    end = float(re.search(r"TIME_BLOCK END = ([\d.]+)", text)[1])
    assert parts.sum() == pytest.approx(100.0, abs=1e-6)
    assert np.allclose(parts / 100.0 * end, np.diff(plan.operations[0].time), atol=2e-5)
    assert "not observed on a controller" in " ".join(texts[MAIN].replace("\r\n; ", " ").split())
    (reported,) = [issue for issue in write.program_notes(plan, problem) if issue.code == "post.spline"]
    assert "not observed on a controller" in reported.message and reported.value < 0.02


def test_the_job_is_proven_with_that_much_less_room():
    proof = spline_job.job()[3].prove(spline_job.job()[2])
    assert proof.ok, proof.issues
    rules = {rule.code: rule for rule in proof.rules}
    assert rules["verify.spline"].worst < 0.02 and "not seen" in rules["verify.spline"].where
    assert rules["verify.singularity"].limit > 5.0


def test_a_long_job_is_measured_with_that_much_less_room_too(monkeypatch):
    """What is looked at in another process is asked for with the clearance that the curves leave."""
    expected = []
    measured = clearance.measure_queries

    def record(models, queries, settings):
        expected.append(settings.clearance)
        return measured(models, queries, settings)

    monkeypatch.setattr(context, "MAX_SENT_SAMPLES", 0)
    monkeypatch.setattr(clearance, "measure_queries", record)
    problem, _, texts, prover = spline_job.job()
    assert prover.prove(texts).ok
    assert expected and min(expected) > problem.settings.clearance


def test_straight_moves_are_what_is_written_without_asking(tmp_path):
    problem = pipeline.load(spline_job.written(tmp_path, spline_job.bow(), path="slin"))
    plan = dataclasses.replace(spline_job.job()[1], digest=problem.digest)
    texts = write.program_files(plan, problem)
    assert "SPLINE" not in texts[MOVES] and "SLIN {" in texts[MOVES]
    texts[MOVES] = spline_job.job()[2][MOVES].replace(spline_job.job()[0].digest, problem.digest)
    found = prove.Prover(problem, registry.claims(problem)).prove(texts, first_error=True)
    assert {issue.code for issue in found.issues} == {"verify.spline"}


def test_a_kink_stays_straight_and_is_named(tmp_path):
    points = spline_job.bow(41)
    points[21:, 0] += 1.5 * np.arange(20)
    problem = pipeline.load(spline_job.written(tmp_path, points))
    outcome = pipeline.plan(problem)
    assert outcome.verified, outcome.issues
    (left,) = [issue for issue in outcome.issues if issue.code == "post.spline_left"]
    assert "move 2" in left.message and "allowed" in left.message
    assert "SPLINE" not in outcome.programs[MOVES]


def test_a_turn_that_is_too_wide_for_a_block_is_named(tmp_path):
    path = spline_job.written(tmp_path, spline_job.bow(9))
    table = tmp_path / "targets.csv"
    rows = table.read_text().splitlines()
    for k, row in enumerate(rows[1:]):
        cells, turn = row.split(","), np.deg2rad(70.0 + 6.0 * k) / 2.0
        cells[3:7] = [f"{v:.9f}" for v in (np.cos(turn), 0.0, np.sin(turn), 0.0)]
        rows[k + 1] = ",".join(cells)
    table.write_text("\n".join(rows) + "\n")
    outcome = pipeline.plan(pipeline.load(path))
    assert outcome.verified, outcome.issues
    (left,) = [issue for issue in outcome.issues if issue.code == "post.spline_left"]
    assert "rotates by more than 5.7 degrees" in left.message and "inf" not in left.message


@pytest.mark.parametrize(
    "fields", [{"dialect": "krc2"}, {"sync": "handshake", "io": "{left: {doPartner: 1, diPartner: 1}}"}]
)
def test_splines_are_refused_where_they_cannot_be(tmp_path, fields):
    with pytest.raises(TandemError) as caught:
        pipeline.load(spline_job.written(tmp_path, spline_job.bow(), **fields))
    assert any("controller" in (issue.field or "") for issue in caught.value.issues)


def refused(problem):
    return [issue for issue in pipeline.check(problem) if issue.code == "post.path"]


def with_splines(problem):
    controller = dataclasses.replace(problem.cell.controller, path="spline")
    return dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, controller=controller))


def test_work_that_is_proven_on_straight_moves_alone_is_refused_by_check(tmp_path):
    """ABB's arms, and claims of hot wires."""
    (issue,) = refused(with_splines(pipeline.load(small_problem.write(tmp_path))))
    assert issue.field == "controller.path" and "irb140" in issue.message
    assert not refused(spline_job.job()[0])
    targets = spline_job.job()[1].operations[0].targets
    wire = dataclasses.replace(targets, claims=straight_job.claims()[next(iter(straight_job.claims()))])
    (issue, *_) = spline_blocks.spline_refusals(spline_job.job()[0], [wire])
    assert "StraightWire" in issue.message and "path: slin" in issue.hint


def test_two_arms_have_no_splines():
    spec = ControllerFile.model_validate({"path": "spline", "sync": "handshake"})
    with pytest.raises(TandemError) as caught:
        build_controller(spec, ("left", "right"))
    (issue,) = caught.value.issues
    assert issue.field == "controller.path" and "allowed: one arm" in issue.message


@pytest.mark.parametrize(("name", "seed"), instances(MUTATORS, [0]))
def test_each_kind_of_fault_is_caught(name, seed):
    assert broken(apply_mutation(name, seed, spline_job.job()[2])), name


@pytest.mark.parametrize(("name", "seed"), instances(REWRITES, [0]))
def test_harmless_rewrites_pass(name, seed):
    texts = apply_mutation(name, seed, spline_job.job()[2])
    assert spline_job.job()[3].prove(texts).ok, name


@pytest.mark.long
@pytest.mark.parametrize(("name", "seed"), instances(MUTATORS, [1, 2, 3, 4]))
def test_all_faults_are_caught(name, seed):
    assert broken(apply_mutation(name, seed, spline_job.job()[2])), name


@pytest.mark.long
@pytest.mark.parametrize(("name", "seed"), instances(REWRITES, [1, 2, 3]))
def test_all_harmless_rewrites_pass(name, seed):
    texts = apply_mutation(name, seed, spline_job.job()[2])
    assert spline_job.job()[3].prove(texts).ok, name


@pytest.mark.long
def test_a_bundled_job_of_milling_is_proven_in_blocks():
    outcome = pipeline.plan(with_splines(pipeline.load("flank_wall")))
    assert outcome.verified, outcome.issues
    assert outcome.programs["robot/flank_wall_1.src"].count("\r\nSPLINE\r\n") >= 4
    rules = {rule.code: rule for rule in outcome.proof.rules}
    assert 0.01 < rules["verify.spline"].worst < 0.1
    assert rules["verify.mill_gouge"].limit < 0.15  # of 0.15 mm without blocks


ON_CURVES = {
    "ContactOnlyIn": "is about states of an output, not about the path",
    "FeedWindow": "has feeds lowered by the factor by which a curve may be faster",
    "OperatorDialogue": "is about what is shown and asked",
    "FollowsPoses": "asks for the points, through which every curve goes",
    "FollowsTable": "asks for the points, and for the times between them",
    **dict.fromkeys(
        ("MillsSurface", "MillsAlong", "MillsFlank", "MillsOver", "SparesPart"), "has a tolerance"
    ),
    **dict.fromkeys(("MillsProgram", "Engraves"), "becomes MillsAlong when its file is read"),
}
"""Kinds of claims that hold on spline blocks, with the reason: by hand, because writer and proof ask the
claim."""


def test_claims_hold_on_curves_for_a_reason() -> None:
    built_in()  # imports all processes
    own = {kind for kind in kinds() if kind.__module__.startswith("planner.")}
    assert {kind.__name__ for kind in own if kind.on_curves} == set(ON_CURVES)
