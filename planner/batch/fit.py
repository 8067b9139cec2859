"""Which robots for this part: one problem in each of several cells, and these ranked by how well it goes.

A cell takes the place of the problem's own. Operations name arms, so a cell's arms take the names of those of
the problem's own cell, in their order; what else differs (tools, reach, payload, the controller) the plan and
its proof say.
"""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from planner.batch.job import safe_names
from planner.batch.rows import Item, Row
from planner.batch.run import SUFFIXES
from planner.geometry.units import DEG, MM
from planner.issues import TandemError, refusal
from planner.problem import Problem, Settings
from planner.reading import strict_yaml
from planner.reading.problem import resolved

OWN: Final = "own"
"""What the problem's own cell is called."""
AMPLE: Final = 2.0
"""Margins of so many times what the problem asks are as good as larger ones."""
MARGINS: Final = {
    "clearance_mm": ("clearance", MM),
    "own_clearance_mm": ("of_one_arm", MM),
    "joint_limits_deg": ("joint_margin", DEG),
    "singularity_deg": ("singularity_margin", DEG),
}
"""Figures of a job that are margins: which setting asks for them, and its unit."""


def items(problem: Problem, folder: Path) -> list[Item]:
    """The problem in its own cell, and in each cell of a folder. Raises ``TandemError`` (batch.field) where
    no cell is there."""
    files = sorted(path for path in _files(folder) if "arms" in _data(path))
    if not files:
        what = f"{folder}: got no cell in this folder, allowed are YAML files with arms"
        raise refusal("batch.field", what, field="--cells", hint="name a folder of cell files")
    names = safe_names([OWN, *(path.stem for path in files)])
    read = [functools.partial(_in_cell, problem, path) for path in files]
    first = Item(names[0], f"the cell of {problem.path}", lambda: problem)
    return [first, *(Item(n, str(p), r) for n, p, r in zip(names[1:], files, read, strict=True))]


def _files(folder: Path) -> list[Path]:
    return [p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES] if folder.is_dir() else []


def _data(path: Path) -> Mapping[str, Any]:
    try:
        return dict(strict_yaml.read(path).data)
    except TandemError:
        return {"arms": None}  # its row says what is wrong with it


def _in_cell(problem: Problem, path: Path) -> Problem:
    """The problem in the cell of a file. Raises ``TandemError``."""
    from planner.processes import registry
    from planner.reading.problem import build

    strict_yaml.read(path)
    whole = resolved({"cell": path.name}, path.parent)
    own = [arm.name for arm in problem.cell.arms]
    cell = whole["cell"]
    theirs = [arm.get("name") for arm in cell.get("arms") or () if isinstance(arm, dict)]
    if len(theirs) < len(own):
        what = f"got a cell of {len(theirs)} arm{'s' * (len(theirs) != 1)}, {problem.name} uses {len(own)}"
        raise refusal("batch.field", what, file=str(path), hint="try it in a cell of more arms")
    names = dict(zip(theirs, [*own, *(f"{own[0]}_{k}" for k in range(len(own), len(theirs)))], strict=True))
    source = {**problem.source, "cell": _renamed(cell, names)}
    return build(strict_yaml.Document(path, source, None, b"", file=False), registry.readers())


def _renamed(value: Any, names: Mapping[Any, str]) -> Any:
    """Plain data with every word that is an arm's name changed, all at once."""
    if isinstance(value, Mapping):
        return {names.get(k, k): _renamed(v, names) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_renamed(v, names) for v in value]
    return names.get(value, value) if isinstance(value, str) else value


def margin(row: Row, settings: Settings) -> float:
    """The least of a job's margins over what the problem asks, up to `AMPLE`; 0 without a plan."""
    found = [
        row.done.metrics[name] * unit / getattr(settings, asked)
        for name, (asked, unit) in MARGINS.items()
        if name in row.done.metrics and getattr(settings, asked) > 0.0
    ]
    return min([AMPLE, *found]) if row.done.metrics else 0.0


def ranked(rows: Sequence[Row], settings: Settings) -> list[Row]:
    """Rows from the best cell to the worst: those that are proven, of these with ample margins, of these the
    fastest, with the time of tracks and turntables; the others in the order in which they came."""

    def order(row: Row) -> tuple[bool, float, float]:
        proven = row.done.state == "verified"
        wide = round(margin(row, settings), 2) if proven else 0.0
        times = (row.done.metrics.get(name, 0.0) for name in ("cycle_s", "travel_s"))
        return not proven, -wide, sum(times) if proven else 0.0

    return sorted(rows, key=order)
