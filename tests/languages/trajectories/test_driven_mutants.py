"""Trajectory files of the planner are proven, for one arm and for two.

Each kind of fault is caught by its rule, and all seeded mutants are caught.
"""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import inverse
from planner.languages.trajectories.reader import rows as rows_of_text
from planner.processes.hotwire.claims import StraightWire
from planner.programs import job
from planner.proof.context import Context
from planner.proof.prove import Prover
from planner.proof.replay import moves, tool_speeds
from tests.languages.trajectories import driven_job
from tests.languages.trajectories.driven_mutants import BENT, HELD, MUTATORS
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job, provers, small_job

FULL = 12
JOBS = {
    "bow": (driven_job.bow_problem, straight_job.claims, driven_job.bow_programs, MUTATORS),
    "bent": (driven_job.bent_problem, small_job.claims, driven_job.bent_programs, {**MUTATORS, **BENT}),
    "held": (driven_job.held_problem, held_job.claims, driven_job.held_programs, HELD),
}


@functools.cache
def prover(name):
    problem, claims, _, _ = JOBS[name]
    return Prover(problem(), claims())


def named_faults():
    """Each kind once, in turn of either job; those of two arms, and of a block that is held, of theirs."""
    for count, kind in enumerate({**MUTATORS, **BENT}):
        yield "bent" if kind in BENT or count % 2 else "bow", kind
    for kind in HELD:
        yield "held", kind


@pytest.mark.parametrize("name", JOBS)
def test_clean_files_are_proven_and_every_rule_runs(name):
    proof = prover(name).prove(JOBS[name][2]())
    assert [str(issue) for issue in proof.issues] == []
    assert all(rule.ran for rule in proof.rules)
    assert proof.ok


@pytest.mark.parametrize(("name", "kind"), named_faults())
def test_the_named_rule_catches_the_fault(name, kind):
    code, mutate = JOBS[name][3][kind]
    programs = JOBS[name][2]()
    mutant = mutate(np.random.default_rng(len(kind)), programs)
    assert mutant != programs
    proof = prover(name).prove(mutant, last=code)
    assert not proof.ok
    assert code in provers.broken(proof), [str(issue) for issue in proof.issues]


@pytest.mark.long
@pytest.mark.parametrize("name", JOBS)
def test_no_seeded_mutant_is_proven(name):
    for kind, (_, mutate) in JOBS[name][3].items():
        for seed in range(FULL):
            mutant = mutate(np.random.default_rng(seed), JOBS[name][2]())
            assert not prover(name).prove(mutant, first_error=True).ok, (kind, seed)


def test_line_ends_change_nothing():
    ((name, text),) = driven_job.bow_programs().items()
    assert text.isascii() and text.endswith("\r\n")
    assert prover("bow").prove({name: text.replace("\r\n", "\n")}).ok


def test_the_replay_lays_the_cubic_of_positions_and_velocities():
    """scipy's Hermite spline has the joints that the proof's replay has, at all samples of a goal."""
    read = job.read_job(driven_job.bent_problem(), driven_job.bent_programs())
    assert not read.faults and not read.flow_faults
    stage = max(read.stages, key=lambda one: len(one.moves("left")))
    task = read.tasks[0]
    steps = stage.moves("left")
    q = np.array([step.target.joints for step in steps])
    v = np.array([step.target.rates for step in steps])
    start = q[0] - 0.01
    t = np.cumsum([step.time for step in steps])
    row = moves.ArmMoves(
        task, steps, None, np.eye(4), None, np.zeros(len(q), bool), None, q, None, None, None, None, rates=v
    )
    law = moves.trajectory_time_law([row])
    when = np.linspace(0.0, t[-1], 5000)
    expected = CubicHermiteSpline(
        np.append(0.0, t), np.concatenate([start[None], q]), np.concatenate([np.zeros((1, 6)), v])
    )
    np.testing.assert_allclose(moves.trajectory_joints(law, start, row, when), expected(when), atol=1e-12)


def test_rows_that_are_none_are_refused_by_what_they_are():
    ((name, text),) = driven_job.bow_programs().items()
    lines = text.split("\r\n")[:-1]
    for row, kind in (
        ("[]", "syntax"),
        ("", "syntax"),
        ('{"dwell":true,"on_failure":[]}', "type"),
        ('{"dwell":"1","on_failure":[]}', "type"),
        ('{"dwell":1e3,"on_failure":[]}', "number"),
        ('{"dwell":99999999.0,"on_failure":[]}', "number"),
        ('{"on_failure":[],"dwell":1.0}', "syntax"),
        ('{"tell":"two\\nlines"}', "type"),
        ('{"tell":"Gr\u00fc\u00dfe"}', "syntax"),
        ('{"set":"a b","to":1}', "name_form"),
        ('{"set":"doWirePower","to":2}', "type"),
        ('{"move":[],"path":[],"goal":[],"goal_time":1.0,"on_failure":["a","A"]}', "name_duplicate"),
        ("[" * 100_000, "syntax"),
    ):
        program, faults = rows_of_text.read(name, "\n".join([*lines[:4], row, *lines[4:], ""]), 10**6)
        assert program is None
        assert (faults[0].line, faults[0].kind) == (5, kind), row
    program, faults = rows_of_text.read(name, text, 1000)
    assert [fault.kind for fault in faults] == ["file_size"]


def test_the_proof_knows_the_arm_by_its_own_chain():
    """A wire that is claimed elsewhere on the tool is cut elsewhere, whatever the file says."""
    claims = {
        name: tuple(
            StraightWire(c.arm, c.start + 0.002, c.end + 0.002, *(c.radius, c.margin))
            if isinstance(c, StraightWire)
            else c
            for c in own
        )
        for name, own in straight_job.claims().items()
    }
    proof = Prover(driven_job.bow_problem(), claims).prove(driven_job.bow_programs())
    assert not proof.ok


def test_speeds_are_those_that_the_block_sees_also_where_an_arm_goes_alone_in_its_setup():
    """The ways of the arm that cuts are its own; the text's kinematics by the planner's."""
    problem, programs = driven_job.held_problem(), driven_job.held_programs()
    context = Context(problem, held_job.claims(), programs, ())
    own = tool_speeds.tool_speeds(context)["left"]
    rows, data = driven_job.rows_of(programs), problem.cell.arms[0].data
    moves = [row["move"] for row in rows if "move" in row]
    assert ["left"] in moves and ["left", "right"] in moves
    left, right = (held_job.BASES[arm] for arm in ("left", "right"))
    tcp = {arm: held_job.cell().arm(arm).tool.tcp for arm in ("left", "right")}
    looked = 0
    for k, move in enumerate(own.moves):
        if move.wobj.fixed or "t" not in rows[move.line - 2]:
            continue
        ends = [rows[line - 1] for line in (move.line - 1, move.line)]
        seen = [
            inverse(right @ forward_kinematics(data, np.array(row["q"][6:])) @ tcp["right"])
            @ (left @ forward_kinematics(data, np.array(row["q"][:6])) @ tcp["left"])
            for row in ends
        ]
        way = np.linalg.norm(seen[1][:3, 3] - seen[0][:3, 3])
        assert own.length[k] == pytest.approx(way, abs=1e-8)
        assert own.peak[k] >= way / (ends[1]["t"] - ends[0]["t"]) - 1e-9
        looked += 1
    assert looked > 40


def test_two_files_are_one_too_many():
    programs = driven_job.bow_programs()
    ((_, text),) = programs.items()
    proof = prover("bow").prove({**programs, "other.trajectory.jsonl": text})
    assert not proof.ok
    (issue,) = (issue for issue in proof.issues if issue.code == "verify.files")
    assert "only one file is allowed" in issue.message and issue.hint == "remove all but one"


def test_a_file_that_cannot_be_read_is_there_and_one_of_another_robot_is_told_as_that():
    programs = driven_job.bow_programs()
    ((name, text),) = programs.items()
    proof = prover("bow").prove({name: text[:900]})
    assert "verify.syntax" in provers.broken(proof) and "verify.files" not in provers.broken(proof)
    proof = prover("bow").prove({})
    assert "no file of trajectories moves arm left" in str(proof.issues)
    rows = driven_job.rows_of(programs)
    rows[1]["robot"] = "kr6_r700"
    (issue, *_) = prover("bow").prove(driven_job.sealed(programs, rows), first_error=True).issues
    assert "arm left is stated as kr6_r700; expected: irb140" in issue.message


def test_joints_are_written_with_nine_decimals():
    (text,) = driven_job.bow_programs().values()
    assert len(re.findall(r'"q":\[(-?\d+\.\d{9},){5}-?\d+\.\d{9}\]', text)) == text.count('"q":')
