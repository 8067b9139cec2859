"""Result folders of jobs that this process did not plan: stopped jobs, and results from other machines."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from planner import pipeline
from planner.files import RESULT_ENTRIES, write_folder
from planner.issues import Issue


def write_failure(folder: Path, issues: Sequence[Issue]) -> None:
    """Write a result folder with only the report, for a job whose planning was stopped."""
    pipeline.save_failure(None, tuple(issues), folder)


def write_result(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write a result folder of files that were planned elsewhere, completely or not at all."""
    write_folder(
        folder, files, tuple(dict.fromkeys((*RESULT_ENTRIES, *(name.split("/")[0] for name in files))))
    )
