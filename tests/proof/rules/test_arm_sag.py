"""verify.sag and the proof's poses of arms with sag: against the planner's, and with wrong figures."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from planner import pipeline
from planner.catalogue import robots
from planner.catalogue.robots import JointStiffness, robot
from planner.cell.compliance import PointLoad, joint_deflection
from planner.cell.kinematics import forward_kinematics
from planner.claims.claim import ArmSags
from planner.geometry.arrays import from_rpy
from planner.geometry.units import GRAVITY
from planner.processes import registry
from planner.proof import prove
from planner.proof.kinematics.arm_model import robot_machine
from planner.proof.replay.arm_deflection import SaggingArm
from tests.proof.planner_jobs import JOBS
from tests.robot_sample import SAMPLE

BASE = from_rpy([0.4, -1.2, 0.6], [0.2, 3.0, 2.0])
TCP = from_rpy([0.12, -0.05, 0.31], [0.3, -0.7, 1.1])
JOINTS = np.array([2.1e6, 2.6e6, 1.3e6, 3.1e5, 2.9e5, 1.9e5])


@pytest.fixture(scope="module")
def proven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, Any]:
    """A job whose sag is compensated, its claims and its programs."""
    problem = pipeline.load(JOBS["posed_sag"](tmp_path_factory.mktemp("job")))
    outcome = pipeline.plan(problem)
    assert outcome.verified
    return problem, registry.claims(problem), outcome.programs


@pytest.mark.parametrize("name", SAMPLE)
@pytest.mark.parametrize("frame", ["stock", "tool", "feed"])
def test_the_proof_bends_an_arm_as_the_planner_unbends_it(name: str, frame: Any) -> None:
    """Of drives that the planner takes the sag off, the proof has the arm where it is wanted, upside down
    and under 3 kN too."""
    data = robot(name)
    q = np.random.default_rng(8).uniform(0.8 * data.lower, 0.8 * data.upper, (200, 6))
    force, cog = np.array([1200.0, -700.0, 2600.0]), np.array([0.02, -0.04, 0.2])
    flange = forward_kinematics(data, q)
    hand = flange @ TCP
    to_base = BASE[:3, :3].T
    feed = np.random.default_rng(9).uniform(-0.7, 0.7, (200, 3))
    down = hand[:, :3, 2]
    ahead = np.cross(np.cross(down, feed @ to_base.T), down)
    work = {
        "stock": np.tile(to_base @ force, (200, 1)),
        "tool": hand[:, :3, :3] @ force,
        "feed": force[0] * ahead + force[1] * np.cross(down, ahead) + force[2] * down,
    }[frame]
    fraction = np.linspace(0.0, 1.0, 200)[:, None]
    loads = (
        PointLoad((flange @ np.append(cog, 1.0))[:, :3], np.tile(to_base @ [0, 0, -35 * GRAVITY], (200, 1))),
        PointLoad(hand[:, :3, 3], fraction * work),
    )
    drives = q - joint_deflection(data, JointStiffness(JOINTS, ""), q, loads)
    claim = ArmSags("a", JOINTS, 35.0, cog, force[None], np.zeros(1), frame, 0.1)
    bent = SaggingArm(robot_machine(robots.robot(name)), claim, BASE, TCP, np.eye(4)).loaded_joints(
        drives, fraction[:, 0], feed
    )
    assert np.abs(drives - q).max() > 1e-3
    np.testing.assert_allclose(bent, q, atol=1e-9)


def test_the_clean_proof_tells_the_largest_shift(proven: Any) -> None:
    problem, claims, programs = proven
    (rule,) = [r for r in prove.prove(problem, claims, programs).rules if r.code == "verify.sag"]
    assert rule.passed
    assert 0.3 < rule.worst < 0.5
    assert rule.limit == 5.0


@pytest.mark.parametrize(
    ("field", "value"),
    [("joints", 1.01), ("mass", 0.9), ("cog", 1.1), ("force", -1.0), ("max_deflection", 2.0)],
)
def test_a_claim_that_is_not_the_problems_is_refused(field: str, value: float, proven: Any) -> None:
    problem, claims, programs = proven
    off = {
        name: tuple(
            dataclasses.replace(c, **{field: value * getattr(c, field)}) if isinstance(c, ArmSags) else c
            for c in group
        )
        for name, group in claims.items()
    }
    proof = prove.prove(problem, off, programs)
    assert not proof.ok
    assert "verify.sag" in {issue.code for issue in proof.issues}


def test_claims_that_are_left_out_or_made_up_are_refused(proven: Any) -> None:
    problem, claims, programs = proven
    none = {name: tuple(c for c in group if not isinstance(c, ArmSags)) for name, group in claims.items()}
    assert "verify.sag" in {i.code for i in prove.prove(problem, none, programs).issues}
    arms = tuple(dataclasses.replace(arm, sag=None) for arm in problem.cell.arms)
    plain = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms), forces={})
    assert "verify.sag" in {i.code for i in prove.prove(plain, claims, programs).issues}


def test_programs_that_make_up_for_nothing_are_not_proven_for_arms_that_give_way(proven: Any) -> None:
    problem, claims, _ = proven
    arms = tuple(dataclasses.replace(arm, sag=None) for arm in problem.cell.arms)
    plain = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms), forces={})
    stiff = pipeline.plan(plain)
    assert stiff.verified
    assert "verify.follows" in {i.code for i in prove.prove(problem, claims, stiff.programs).issues}


def test_a_shift_beyond_what_the_problem_allows_is_refused(proven: Any) -> None:
    problem, _, programs = proven
    arms = tuple(
        dataclasses.replace(a, sag=dataclasses.replace(a.sag, max_correction=1e-4)) for a in problem.cell.arms
    )
    tight = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms))
    found = prove.prove(tight, registry.claims(tight), programs)
    assert {i.code for i in found.issues if i.value and i.value > 0.1} >= {"verify.sag"}


def test_a_process_that_claims_nothing_is_refused_though_its_arms_sag(proven: Any) -> None:
    _, claims, _ = proven
    alone = {name: tuple(c for c in group if isinstance(c, ArmSags)) for name, group in claims.items()}
    assert all(alone.values())
    assert {issue.code for issue in prove.unproven_claims(alone)} == {"claims.none"}
    assert prove.unproven_claims(claims) == []
