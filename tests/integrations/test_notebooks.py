"""The notebooks in docs/notebooks run from top to bottom, in a kernel of Jupyter.

``TANDEM_JUPYTER_PYTHON`` names the Python that has Jupyter: in CI an environment of its own that sees the
planner and what it needs.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
PYTHON = os.environ.get("TANDEM_JUPYTER_PYTHON", "")
RUN = """
import sys, nbclient, nbformat
notebook = nbformat.read(sys.argv[1], as_version=4)
nbformat.validate(notebook)
nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=sys.argv[2])
nbformat.write(notebook, sys.argv[3])
"""
SHOWN: dict[str, tuple[tuple[str, str], ...]] = {
    "01_first_job": (
        ("plan", r"<Outcome of gauge_lanes: verified, (\d+) of \1 rules, \d+\.\d s>"),
        ("show", r'<iframe srcdoc="&lt;!doctype'),
        (
            "margins",
            r"^clearance +\d+\.?\d*  limit 9 mm .*\nown_clearance +\d+\.?\d*  limit 4\.5 mm .*\n"
            r"singularity +\d+\.\d+  limit 5 deg",
        ),
        ("wider", r"error \[motion\.collision\] .*robot/tool with stock.*at least 60\.0 mm"),
        ("save", r"\.mod \d+ lines\n(.*\n)*\['motion\.json', .*'programs', .*'replay\.html', 'report\.html'"),
        ("motion", r"^0\.00 s, .*/1: TCP at \[.*'joint_6': -?\d"),
    )
}
"""What cells show, by their ids."""


def test_notebooks_are_numbered_and_carry_no_outputs() -> None:
    assert [path.stem for path in NOTEBOOKS] == sorted(SHOWN)
    assert [int(path.stem[:2]) for path in NOTEBOOKS] == list(range(1, len(NOTEBOOKS) + 1))
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            assert not cell.get("outputs"), f"{path.name}: {cell['id']} has outputs; clear them"
            assert cell.get("execution_count") is None


@pytest.mark.skipif(not PYTHON, reason="no Jupyter: TANDEM_JUPYTER_PYTHON is not set")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_whole(path: Path, tmp_path: Path) -> None:
    there = [str(ROOT), sysconfig.get_path("purelib")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(there), "BROWSER": "false"}
    command = [PYTHON, "-c", RUN, str(path), str(tmp_path), str(tmp_path / "run.ipynb")]
    done = subprocess.run(
        command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    cells = json.loads((tmp_path / "run.ipynb").read_text("utf-8"))["cells"]
    shown = {cell["id"]: text(cell) for cell in cells if cell["cell_type"] == "code"}
    for name, expected in SHOWN[path.stem]:
        assert re.search(expected, shown[name]), shown[name][:500]


def text(cell: dict[str, Any]) -> str:
    """Return the displayed text of a cell."""
    out = ""
    for output in cell["outputs"]:
        assert output.get("name") != "stderr", output["text"]
        data = output.get("data", {})
        out += "".join(output.get("text", data.get("text/html", data.get("text/plain", ""))))
    return out
