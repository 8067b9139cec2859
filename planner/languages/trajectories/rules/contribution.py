"""What joint trajectories contribute to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.trajectories.reader.flow import BEGINS
from planner.languages.trajectories.rules import trajectories
from planner.programs.stages import TaskText
from planner.proof.context import Context
from planner.proof.language_contribution import ProofOfLanguage, StartSentences
from planner.proof.rule import Outcome


def _unknown_start(context: Context, task: TaskText) -> Outcome:
    return Outcome(nothing="each move begins where it was looked at")


PROOF: Final = ProofOfLanguage(
    rules=(
        trajectories.start_posture,
        trajectories.goal_tolerances,
        trajectories.power_on_failure,
        trajectories.between_points,
    ),
    checks={"verify.unknown_start": _unknown_start},
    job_checks={"verify.dialogue": trajectories.announced},
    start=StartSentences(ready=sentences.KRL_READY, clear=sentences.KRL_CLEAR),
    missing_file="no file of trajectories moves arm {arm}",
    begins=frozenset(BEGINS.values()),
)
