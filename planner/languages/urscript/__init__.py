"""URScript for Universal Robots controllers."""

from typing import Final

from planner.runtime.plugins import Language

LANGUAGE: Final = Language(
    title="URScript",
    families=("UR",),
    endings=(".script",),
    reader="planner.languages.urscript.reader.task:READER",
    writer="planner.languages.urscript.writer.language:WRITER",
    proof="planner.languages.urscript.rules.contribution:PROOF",
    report="planner.languages.urscript.sheet:REPORT",
)
