"""The writer of URScript as the planner uses it."""

from typing import Final

from planner.languages.urscript.writer.program import write
from planner.languages.urscript.writer.refusals import refuse
from planner.languages.writing.language import Writer

WRITER: Final = Writer(
    write,
    syncs=("handshake",),
    unmixed="a UR program restarts after each stop, and nothing prevents one of another controller from "
    "continuing in the middle, where it would meet the restarted one",
    stops_at_turns=True,
    stops_at_pauses=True,
    refuse=refuse,
)
