"""Timing does not load pictures, and what asks for them later has them: seen in processes of their own."""

from __future__ import annotations

import subprocess
import sys


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_timing_loads_no_plots() -> None:
    said = _run(
        "import sys, planner.motion.trajectory.timing; print([n for n in sys.modules if 'matplotlib' in n])"
    )
    assert said == "[]"


def test_plots_are_loaded_when_they_are_asked_for() -> None:
    code = "import planner.motion.trajectory.timing, toppra.algorithm.algorithm as a; "
    code += "print(a.plt.Figure.__name__)"
    assert _run(code) == "Figure"
    code = (
        "import planner.motion.trajectory.timing, matplotlib.pyplot; print(matplotlib.pyplot.Figure.__name__)"
    )
    assert _run(code) == "Figure"
