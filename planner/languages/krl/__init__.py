"""KRL for KUKA controllers."""

from typing import Final

from planner.runtime.plugins import Language

LANGUAGE: Final = Language(
    title="KRL",
    families=("KUKA",),
    endings=(".src", ".dat"),
    other_endings=(".sub",),
    comment=";",
    reader="planner.languages.krl.reader.task:READER",
    writer="planner.languages.krl.writer.language:WRITER",
    proof="planner.languages.krl.rules.contribution:PROOF",
    report="planner.languages.krl.sheet:REPORT",
)
