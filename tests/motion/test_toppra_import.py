"""What times no path loads no pictures, and timing leaves Python's modules as they are: seen in processes of
their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SLOW = "[n for n in sys.modules if n.split('.')[0] in ('matplotlib', 'toppra')]"


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_motion_loads_the_solver_where_it_is_asked_for() -> None:
    assert _run(f"import sys, planner.motion.solve; print({SLOW})") == "[]"
    assert "toppra.algorithm" in _run(f"import sys, planner.motion.trajectory.toppra_solver; print({SLOW})")


def test_check_loads_no_pictures() -> None:
    problem = Path(__file__).parents[2] / "problems" / "engrave" / "problem.yaml"
    code = "import sys; from planner import pipeline; "
    code += f"found = pipeline.check(pipeline.load({str(problem)!r})); print({SLOW})"
    assert _run(code) == "[]"
