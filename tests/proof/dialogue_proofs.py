"""Jobs with a proven dialogue: problems, claims, programs, and issues of the rules up to the dialogue's."""

from __future__ import annotations

import functools

from planner.proof.prove import Prover
from tests.processes.hotwire.proof import straight_job
from tests.proof import dialogue_job, handshake_job, small_job

CODE = "verify.dialogue"

JOBS = {
    "bent": (small_job.problem, dialogue_job.bent_claims, dialogue_job.bent_programs),
    "choice": (small_job.problem, dialogue_job.choice_claims, dialogue_job.choice_programs),
    "bow": (straight_job.problem, dialogue_job.bow_claims, dialogue_job.bow_programs),
    "krl": (
        lambda: dialogue_job.bow_problem("kr10_r1100", "krc2"),
        dialogue_job.bow_claims,
        lambda: dialogue_job.bow_programs("kr10_r1100", "krc2"),
    ),
    "dialogs": (
        lambda: dialogue_job.bow_problem("kr10_r1100"),
        dialogue_job.bow_claims,
        lambda: dialogue_job.bow_programs("kr10_r1100"),
    ),
    "handshake": (handshake_job.problem, handshake_job.claims, handshake_job.programs),
}


@functools.cache
def prover(job):
    return Prover(JOBS[job][0](), JOBS[job][1]())


def faults(job, programs):
    """Issues of the rules up to the one on the dialogue."""
    return prover(job).prove(programs, last=CODE).issues
