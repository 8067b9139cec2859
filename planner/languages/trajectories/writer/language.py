"""The writer of ROS 2 trajectories as the planner uses it."""

from typing import Final

from planner.languages.trajectories.writer.program import write
from planner.languages.trajectories.writer.refusals import refuse
from planner.languages.writing.language import Writer

WRITER: Final = Writer(
    write,
    syncs=("multimove",),
    opt_in="if a computer with ROS 2 moves it, set controller: {language: ros}",
    refuse=refuse,
)
