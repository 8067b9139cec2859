"""Lazy imports: a command without timing loads no graphics, and one that only reads a problem no Drake.

Timing leaves the modules of Python unchanged. Each case runs in a separate process and is judged by what it
has loaded, never by its duration.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROBLEMS = Path(__file__).parents[2] / "problems"


def _loaded_packages(code: str, packages: tuple[str, ...]) -> set[str]:
    """Which of ``packages`` a process has loaded that ran ``code``."""
    code = f"import sys; {code}; print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = done.stderr.splitlines()[-1].split()
    return {package for package in packages if any(f"{name}.".startswith(f"{package}.") for name in names)}


def test_motion_times_without_pictures_and_leaves_them_to_others() -> None:
    """``toppra`` imports them; whoever plots with it, or has loaded them before, has the library itself."""
    solver = "planner.motion.trajectory.toppra_solver"
    assert _loaded_packages(f"import {solver}", ("matplotlib", "toppra")) == {"toppra"}
    plot = "from toppra.algorithm import algorithm; algorithm.plt.figure()"
    same = "import matplotlib.pyplot as p; assert algorithm.plt.figure is p.figure"
    for code in (
        f"import {solver}; {plot}; {same}",
        f"import matplotlib.pyplot; import {solver}; {plot}; {same}",
    ):
        assert _loaded_packages(code, ("matplotlib",))


def test_check_loads_no_pictures() -> None:
    problem = PROBLEMS / "engrave" / "problem.yaml"
    code = f"from planner import pipeline; found = pipeline.check(pipeline.load({str(problem)!r}))"
    assert not _loaded_packages(code, ("matplotlib",))


PLANNING = (
    "pydrake",
    "planner.cell.plant",
    "planner.cell.clearance",
    "planner.motion",
    "planner.languages.writing",
    "planner.proof",
    "planner.report",
)
"""What plans, proves and draws, and loads Drake for that."""


@pytest.mark.parametrize("name", ["wing", "column_capital"])
def test_a_problem_is_read_without_what_plans_it(name: str) -> None:
    """The wing and the capital, as a user loads them; no part of theirs is a mesh."""
    assert not _loaded_packages(
        f"import planner; planner.load({name!r})", (*PLANNING, "trimesh", "matplotlib")
    )


def test_the_command_begins_with_little() -> None:
    """The first message of any command waits for the imports of its module.

    The catalogue is read without the imports that a problem needs.
    """
    heavy = (
        *PLANNING,
        "trimesh",
        "scipy",
        "shapely",
        "pydantic",
        "planner.pipeline",
        "fastapi",
        "sqlalchemy",
    )
    assert not _loaded_packages("import planner.cli.command_line", heavy)
    assert not _loaded_packages("from planner.cli.command_line import robots; robots()", heavy)
