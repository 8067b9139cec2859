"""URScript, as programs are written in it."""

from typing import Final

from planner.languages.urscript.writer.program import write
from planner.languages.urscript.writer.refusals import refuse
from planner.languages.writing.language import Writer

WRITER: Final = Writer(
    write,
    syncs=("handshake",),
    unmixed="a program of UR begins anew behind each stop, and nothing keeps one of another controller from "
    "going on in the middle, where it would meet the one that begins",
    stops_at_turns=True,
    stops_at_pauses=True,
    refuse=refuse,
)
