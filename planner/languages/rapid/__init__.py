"""RAPID for ABB controllers."""

from typing import Final

from planner.runtime.plugins import Language

LANGUAGE: Final = Language(
    title="RAPID",
    families=("ABB",),
    endings=(".mod", ".modx", ".sys", ".sysx"),
    other_endings=(".pgf",),
    utf_8=(".modx", ".sysx"),
    comment="!",
    reader="planner.languages.rapid.reader.task:READER",
    writer="planner.languages.rapid.writer.language:WRITER",
    proof="planner.languages.rapid.rules.contribution:PROOF",
    report="planner.languages.rapid.sheet:REPORT",
)
