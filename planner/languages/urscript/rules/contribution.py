"""Rules, checks and texts that URScript contributes to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.urscript.reader.syntax_tree import STAND
from planner.languages.urscript.reader.words import without_comments
from planner.languages.urscript.rules import handshake
from planner.languages.urscript.rules.robot_check import robot_check
from planner.languages.urscript.sentences import UR_CALLED, UR_EARLIER, UR_START_PARTNER
from planner.programs.steps import MoveStep
from planner.proof.language_contribution import ProofOfLanguage, StartSentences


def _same_text(first: str, second: str) -> bool:
    return without_comments(first) == without_comments(second)


def _zero_length_fault(move: MoveStep) -> str:
    return "" if move.kind == STAND else f"the movel has zero length; use {STAND} instead"


PROOF: Final = ProofOfLanguage(
    checks={"verify.cell_check": robot_check},
    job_checks={"verify.handshake": handshake.handshake_issues},
    same_text=_same_text,
    start=StartSentences(
        ready=sentences.KRL_READY,
        clear=sentences.KRL_CLEAR,
        leader_earlier=UR_EARLIER,
        follower_earlier=UR_CALLED,
        start_partner=UR_START_PARTNER,
    ),
    zero_length_fault=_zero_length_fault,
    watches_torch=True,
    restarts=handshake.restarts,
)
