"""Rules, checks and texts that KRL contributes to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.krl.reader.parser import significant_lines
from planner.languages.krl.rules import controller_files, external_axes, moves, spline, text
from planner.languages.krl.sentences import KRL_EARLIER
from planner.proof.language_contribution import AxisFormat, ProofOfLanguage, StartSentences


def _same_text(first: str, second: str) -> bool:
    """Return whether two texts differ only in blanks and in comments that the proof does not read."""
    return significant_lines(first) == significant_lines(second)


PROOF: Final = ProofOfLanguage(
    rules=(moves.status, spline.spline),
    checks={"verify.hidden": moves.hidden, "verify.move_kinds": moves.move_kinds},
    same_text=_same_text,
    targets_in=text.target_offsets,
    likely_cause=text.likely_cause,
    start=StartSentences(
        ready=sentences.KRL_READY,
        clear=sentences.KRL_CLEAR,
        leader_earlier=KRL_EARLIER,
        follower_earlier=KRL_EARLIER,
    ),
    external_axes=AxisFormat(checks_home=external_axes.checks_axis),
    controller_files=controller_files.controller_files,
    corners=moves.corners,
    slowest=moves.is_slowest,
)
