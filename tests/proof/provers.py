"""Cached provers of the jobs with known answers, and the codes of the rules that fail."""

from __future__ import annotations

import dataclasses
import functools

from planner.pipeline import Outcome
from planner.processes import registry
from planner.proof.prove import Prover
from planner.proof.verdict import Proof
from tests.languages.krl import krl_job
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job, small_job

JOBS = {"straight": straight_job, "held": held_job, "small": small_job, "krl": krl_job}
ABB = ("straight", "held", "small")


@functools.cache
def prover(job: str) -> Prover:
    """The prover of one of these jobs; it keeps the models of its cell."""
    return Prover(JOBS[job].problem(), JOBS[job].claims())


def broken(proof: Proof) -> set[str]:
    """Codes of the rules that ran and are broken."""
    return {rule.code for rule in proof.rules if rule.ran and not rule.passed}


def prover_of(outcome: Outcome) -> Prover:
    """Return the prover of a planned job without the plan's positions of external axes."""
    made = dataclasses.replace(outcome.problem, stations={})
    return Prover(made, registry.claims(made))
