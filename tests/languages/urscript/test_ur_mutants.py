"""URScript programs of the planner are proven.

Each kind of fault is caught by its rule, and all seeded mutants are caught.
"""

from __future__ import annotations

import dataclasses
import functools
import re

import numpy as np
import pytest

from planner.geometry.arrays import from_rpy
from planner.languages.urscript.writer import program, syntax
from planner.languages.writing import write
from planner.proof.prove import Prover
from planner.proof.same_program import is_same_program
from tests import urdf_text
from tests.languages.urscript import ur_job
from tests.languages.urscript.ur_mutants import FILE, MUTATORS
from tests.processes.hotwire.proof import straight_job
from tests.proof import provers

SAMPLE = 1
FULL = 12


@functools.cache
def prover():
    return Prover(ur_job.problem(), ur_job.claims())


def test_clean_programs_are_proven_in_the_times_that_they_state():
    proof = prover().prove(ur_job.programs())
    assert [str(issue) for issue in proof.issues] == []
    assert all(rule.ran for rule in proof.rules)
    assert proof.ok


@pytest.mark.parametrize("kind", MUTATORS)
def test_the_named_rule_catches_the_fault(kind):
    code, mutate = MUTATORS[kind]
    programs = ur_job.programs()
    mutant = mutate(np.random.default_rng(len(kind)), programs)
    assert mutant != programs
    proof = prover().prove(mutant, last=code)
    assert not proof.ok
    assert code in provers.broken(proof), [str(issue) for issue in proof.issues]


@pytest.mark.long
@pytest.mark.parametrize("kind", MUTATORS)
def test_no_seeded_mutant_is_proven(kind):
    for seed in range(FULL):
        mutant = MUTATORS[kind][1](np.random.default_rng(seed), ur_job.programs())
        assert not prover().prove(mutant, first_error=True).ok, seed


def test_comments_and_white_space_change_nothing():
    programs = ur_job.programs()
    text = re.sub(r",", " , ", programs[FILE].replace("\r\nmovel(", "\r\n\r\n  # here\r\n  movel( "))
    # texts that are shown, and the digest, are compared as they are
    texts = iter(re.findall(r'"[^"]*"', programs[FILE]))
    text = re.sub(r'"[^"]*"', lambda _: next(texts), text)
    other = {FILE: text}
    assert text != programs[FILE]
    assert prover().prove(other).ok
    assert not is_same_program(programs, {FILE: text.replace("t=0.72023", "t=0.72024", 1)})
    bare = {FILE: re.sub(r"\r\n#.*", "", programs[FILE])}
    assert is_same_program(programs, bare)


def rotated_base_job():
    """The job with a URDF whose base_link is turned by 180 degrees, as ROS has it, and the arm's base too."""
    problem, plan = ur_job.problem(), straight_job.plan(12, model=ur_job.MODEL)
    turn = from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, np.pi])
    (arm,) = problem.cell.arms
    arm = dataclasses.replace(arm, base=turn, custom_data=urdf_text.ur10e_data(turn))
    cell = dataclasses.replace(problem.cell, arms=(arm,))
    return dataclasses.replace(problem, cell=cell), dataclasses.replace(plan, bases={"left": turn})


def test_a_writer_that_takes_base_link_for_the_controllers_base_is_caught(monkeypatch):
    problem, plan = rotated_base_job()
    own = Prover(problem, ur_job.claims())
    texts = write.program_files(plan, problem)
    moves = [text.replace("\r\n", "\n").split("# Operation")[1:] for text in texts.values()]
    plain = [text.replace("\r\n", "\n").split("# Operation")[1:] for text in ur_job.programs().values()]
    assert moves == plain
    assert own.prove(texts).ok
    monkeypatch.setattr(program, "controller_base", lambda arm: np.eye(4))
    proof = own.prove(write.program_files(plan, problem))
    assert not proof.ok
    assert {"verify.base_frames", "verify.cell_check"} <= provers.broken(proof)


def test_a_writer_in_other_units_is_caught(monkeypatch):
    """Degrees for radians of joints, millimetres for metres of targets, milliseconds for seconds."""
    problem, plan = ur_job.problem(), straight_job.plan(12, model=ur_job.MODEL)
    joints, straight = syntax.format_joints, syntax.linear_moves
    faults = {
        "format_joints": lambda q: joints(np.rad2deg(q)),
        "linear_moves": lambda track, radius, frame: straight(
            dataclasses.replace(track, position=1e3 * track.position), radius, frame
        ),
        "format_real": lambda value, decimals: f"{1e3 * value:.3f}",
    }
    for name, fault in faults.items():
        with monkeypatch.context() as patch:
            patch.setattr(syntax, name, fault)
            assert not prover().prove(write.program_files(plan, problem), first_error=True).ok, name
