"""Rules, checks and texts that RAPID contributes to the proof."""

from typing import Final

from planner.claims import sentences
from planner.languages.rapid.rules import (
    cell_check,
    confdata,
    controller_files,
    external_axes,
    moves,
    settings,
    text,
)
from planner.proof.language_contribution import AxisFormat, ProofOfLanguage, StartSentences

PROOF: Final = ProofOfLanguage(
    rules=(settings.error_handler, settings.undo, confdata.confdata),
    checks={
        "verify.pers_literal": text.shared_persistents,
        "verify.decimals": text.quaternions,
        "verify.files": text.files,
        "verify.hidden": settings.hidden,
        "verify.cell_check": cell_check.cell_check,
        "verify.signals": settings.hidden_signals,
        "verify.move_kinds": moves.move_kinds,
        "verify.external_axes": external_axes.units_and_offsets,
        "verify.unknown_start": moves.unknown_start,
    },
    job_checks={"verify.files": text.program_lists},
    same_text=text.same_text,
    targets_in=text.target_offsets,
    start=StartSentences(joined=sentences.NO_WIRE),
    external_axes=AxisFormat(
        names=("eax_a", "eax_b", "eax_c", "eax_d", "eax_e", "eax_f"),
        zero_is_unused=False,
        checks_home=external_axes.checks_axis,
    ),
    controller_files=controller_files.controller_files,
)
