"""Joint trajectories for ROS 2 controllers."""

from typing import Final

from planner.runtime.plugins import Language

LANGUAGE: Final = Language(
    title="trajectories of ROS 2",
    families=("ROS",),
    endings=(".jsonl",),
    reader="planner.languages.trajectories.reader.task:READER",
    writer="planner.languages.trajectories.writer.language:WRITER",
    proof="planner.languages.trajectories.rules.contribution:PROOF",
    report="planner.languages.trajectories.sheet:REPORT",
)
