"""What KRL contributes to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.krl.reader.parser import without_comments
from planner.languages.krl.rules import controller_files, external_axes, moves, spline, text
from planner.languages.krl.sentences import KRL_EARLIER
from planner.proof.language_contribution import ExternalAxes, ProofOfLanguage, StartSentences


def _same_text(first: str, second: str) -> bool:
    return without_comments(first) == without_comments(second)


PROOF: Final = ProofOfLanguage(
    rules=(moves.status, spline.spline),
    checks={"verify.hidden": moves.hidden, "verify.move_kinds": moves.move_kinds},
    same_text=_same_text,
    targets_in=text.targets_in,
    likely_cause=text.likely_cause,
    start=StartSentences(
        ready=sentences.KRL_READY,
        clear=sentences.KRL_CLEAR,
        leader_earlier=KRL_EARLIER,
        follower_earlier=KRL_EARLIER,
    ),
    external_axes=ExternalAxes(looks_at=external_axes.looks_at),
    controller_files=controller_files.controller_files,
    corners=moves.corners,
    slowest=moves.creeps,
)
