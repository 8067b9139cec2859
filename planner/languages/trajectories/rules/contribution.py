"""Rules, checks and texts that joint trajectories contribute to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.trajectories.reader.flow import FIRST_POINT_KINDS
from planner.languages.trajectories.rules import trajectories
from planner.programs.stages import TaskText
from planner.proof.context import Context
from planner.proof.language_contribution import ProofOfLanguage, StartSentences
from planner.proof.rule import RuleOutcome


def _unknown_start(context: Context, task: TaskText) -> RuleOutcome:
    """Return that the rule on starts does not apply, because each move starts from a checked posture."""
    return RuleOutcome(nothing="each move starts from the checked posture")


PROOF: Final = ProofOfLanguage(
    rules=(
        trajectories.start_posture,
        trajectories.goal_tolerances,
        trajectories.power_on_failure,
        trajectories.between_points,
    ),
    checks={"verify.unknown_start": _unknown_start},
    job_checks={"verify.dialogue": trajectories.announcement_issues},
    start=StartSentences(ready=sentences.KRL_READY, clear=sentences.KRL_CLEAR),
    missing_file="no file of trajectories moves arm {arm}",
    starting_kinds=frozenset(FIRST_POINT_KINDS.values()),
)
