"""Comparison of cells for one problem: the problem in each of several cells, ranked.

A cell replaces the problem's own. Operations name arms, so a cell's arms take the names of those of the
problem's own cell, in order. Other differences (tools, reach, payload, controller) show in the plan and its
proof.
"""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from planner.batch.job import make_safe_names
from planner.batch.rows import BatchItem, BatchRow
from planner.batch.run import YAML_SUFFIXES
from planner.geometry.units import DEG, MM
from planner.issues import TandemError, issue_error
from planner.problem import Problem, Settings
from planner.reading import strict_yaml
from planner.reading.problem import resolve_files

OWN_CELL_NAME: Final = "own"
"""Name of the problem's own cell."""
AMPLE_MARGIN_FACTOR: Final = 2.0
"""Factor of the required margin above which larger margins no longer improve the rank of a cell."""
MARGIN_SETTINGS: Final = {
    "clearance_mm": ("clearance", MM),
    "own_clearance_mm": ("self_clearance", MM),
    "joint_limits_deg": ("joint_margin", DEG),
    "singularity_deg": ("singularity_margin", DEG),
}
"""Metrics of a job that are margins, with the setting that requires each and the factor of its unit."""


def cell_items(problem: Problem, folder: Path) -> list[BatchItem]:
    """Return the problem in its own cell, and in each cell of a folder.

    Raises:
        TandemError: batch.field, if the folder contains no cell.
    """
    files = sorted(path for path in _files(folder) if "arms" in _cell_data(path))
    if not files:
        message = f"{folder}: the folder contains no cell, which is a YAML file with arms"
        raise issue_error("batch.field", message, field="--cells", hint="give a folder of cell files")
    names = make_safe_names([OWN_CELL_NAME, *(path.stem for path in files)])
    readers = [functools.partial(_problem_in_cell, problem, path) for path in files]
    own_item = BatchItem(names[0], f"the cell of {problem.path}", lambda: problem)
    return [
        own_item,
        *(
            BatchItem(name, str(path), reader)
            for name, path, reader in zip(names[1:], files, readers, strict=True)
        ),
    ]


def _files(folder: Path) -> list[Path]:
    """Return the YAML files directly in a folder."""
    return (
        [path for path in folder.iterdir() if path.suffix.lower() in YAML_SUFFIXES] if folder.is_dir() else []
    )


def _cell_data(path: Path) -> Mapping[str, Any]:
    """Read a YAML file. A file that cannot be read counts as a cell."""
    try:
        return dict(strict_yaml.read(path).data)
    except TandemError:
        return {"arms": None}  # its row states the error


def _problem_in_cell(problem: Problem, path: Path) -> Problem:
    """Return the problem in the cell of a file.

    Raises:
        TandemError: The file is invalid or has too few arms.
    """
    from planner.processes import registry
    from planner.reading.problem import build_problem

    strict_yaml.read(path)
    source_with_cell = resolve_files({"cell": path.name}, path.parent)
    own_arms = [arm.name for arm in problem.cell.arms]
    cell = source_with_cell["cell"]
    cell_arms = [arm.get("name") for arm in cell.get("arms") or () if isinstance(arm, dict)]
    if len(cell_arms) < len(own_arms):
        message = (
            f"got a cell of {len(cell_arms)} arm{'s' * (len(cell_arms) != 1)}, {problem.name} uses "
            f"{len(own_arms)}"
        )
        raise issue_error("batch.field", message, file=str(path), hint="use a cell with more arms")
    new_names = dict(
        zip(
            cell_arms,
            [*own_arms, *(f"{own_arms[0]}_{number}" for number in range(len(own_arms), len(cell_arms)))],
            strict=True,
        )
    )
    source = {**problem.source, "cell": _rename_arms(cell, new_names)}
    return build_problem(strict_yaml.Document(path, source, None, b"", file=False), registry.readers())


def _rename_arms(value: Any, names: Mapping[Any, str]) -> Any:
    """Return plain data with every string that is an arm's name replaced, all at once."""
    if isinstance(value, Mapping):
        return {names.get(key, key): _rename_arms(item, names) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rename_arms(item, names) for item in value]
    return names.get(value, value) if isinstance(value, str) else value


def min_margin(row: BatchRow, settings: Settings) -> float:
    """Return the smallest ratio of a job's margin to the margin that the problem requires.

    The ratio is at most `AMPLE_MARGIN_FACTOR`. It is 0 without a plan.
    """
    ratios = [
        row.done.metrics[name] * unit / getattr(settings, setting)
        for name, (setting, unit) in MARGIN_SETTINGS.items()
        if name in row.done.metrics and getattr(settings, setting) > 0.0
    ]
    return min([AMPLE_MARGIN_FACTOR, *ratios]) if row.done.metrics else 0.0


def rank_cells(rows: Sequence[BatchRow], settings: Settings) -> list[BatchRow]:
    """Return the rows of a batch from the best cell to the worst.

    Proven cells come first, then by margin up to `AMPLE_MARGIN_FACTOR`, then by time including tracks and
    turntables. The others keep their order.
    """

    def sort_key(row: BatchRow) -> tuple[bool, float, float]:
        is_proven = row.done.state == "verified"
        margin_value = round(min_margin(row, settings), 2) if is_proven else 0.0
        # Tracks and turntables travel between the cycles of their stations, so both times are added.
        times = (row.done.metrics.get(name, 0.0) for name in ("cycle_s", "travel_s"))
        return not is_proven, -margin_value, sum(times) if is_proven else 0.0

    return sorted(rows, key=sort_key)
