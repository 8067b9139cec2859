"""The examples in docs/examples: each runs unchanged, is short enough to read at once, and succeeds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planner import spec
from planner.issues import TandemError

ROOT = Path(__file__).parent.parent
EXAMPLES = ROOT / "docs" / "examples"
LINES = 40
RESULT = ("report.html", "replay.html", "plan.json", "problem/problem.yaml", "programs")

EXPECTED: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "01_wing": ((r"verified: True, \d+ s, programs: T_ROB1/",), RESULT),
    "02_wire_panel": ((r"verified: True; (9\d|100)\.\d % within tolerance",), RESULT),
    "03_held_drum": ((r"verified: True, cut in \d+ s",), (*RESULT, "programs/T_ROB2")),
    "04_formed_cone": ((r"verified: True, \d+ s; (9\d|100)\.\d % within the scallop",), RESULT),
    "05_gcode_to_krl": (
        (r"robot/panel_rim\.src: \d+ lines", r"verified: True"),
        (*RESULT, "programs/robot/panel_rim.dat"),
    ),
    "06_own_poses": ((r"verified: True, 9 places in \d+\.\d s",), (*RESULT, "programs/T_ROB2")),
    "07_sweep": (
        (
            r"300 mm: at home robot/link_1 and stock are 5.0 mm apart",
            r"540 mm: \d+ deg from a limit, \d+ deg from a singularity",
        ),
        ("sweep.svg",),
    ),
    "08_custom_process": ((r"verified: True; largest distance from the circle 0\.0\d+ mm",), RESULT),
    "09_check_programs": (
        (
            r"verified: True as written, False after the change by hand",
            r"error \[verify\.follows\] .* missed by 5\.0000 mm",
            r"somebody else's: 1 of 3 moves",
            r"line 6: bodies of the cell come too close",
        ),
        RESULT,
    ),
    "10_batch": (
        (r"block_60: verified, \d", r"block_120: verified, \d", r"block_900: infeasible, at home robot/tool"),
        ("block_60/programs", "block_120/programs", "block_900/report.html"),
    ),
    "11_look_at_a_plan": (
        (
            r"at 2\.\d s: cut/path, joints \[",
            r"\d+ samples, greatest joint speeds \[",
            r"planned: clearance \d+\.\d mm",
            r"proven: verify\.clearance \d+\.\d+ mm, allowed 9",
            r"verified: True",
            r"3D view at http://127\.0\.0\.1:\d+/ ",
        ),
        (*RESULT, "../out.yaml"),
    ),
}
"""Lines that each prints, in this order, and what it leaves in its folder."""
FAST_EXAMPLES = {"06_own_poses", "08_custom_process"}
"""Examples that make test runs. The wing is planned by the README's Python; batches, forming and G-code have
tests of their own."""


def test_each_example_is_here() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(EXPECTED)
    assert 8 <= len(EXPECTED) <= 12


@pytest.mark.parametrize("path", sorted(EXAMPLES.rglob("*.py")), ids=lambda path: path.stem)
def test_an_example_is_read_at_once(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < LINES
    assert text.startswith('"""')
    assert "accept=" not in text, "an example accepts no errors"


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in FAST_EXAMPLES else [pytest.mark.long]) for name in EXPECTED],
)
def test_an_example_runs_as_it_stands(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    environment |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), "out"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    lines, files = EXPECTED[name]
    at = 0
    for line in lines:
        result = re.compile(line).search(done.stdout, at)
        assert result, f"{line!r} is not in {done.stdout[at:]!r}"
        at = result.end()
    missing = [file for file in files if not (tmp_path / "out" / file).exists()]
    assert not missing


POSE = np.eye(4)[None]


@pytest.mark.parametrize(
    ("make_slip", "code", "expected_text"),
    [
        (lambda: spec.Cell.read("irb140_bowl"), "problem.missing_file", "irb140_bow, irb140_gauge"),
        (lambda: spec.FaceMesh(file=np.zeros((3, 4, 3))), "problem.field", "a mesh with its unit"),
        (
            lambda: spec.Targets(name="a", poses=POSE, unit="mm"),
            "problem.field",
            "Targets.poses: got a ndarray",
        ),
        (
            lambda: spec.Targets(name="a", poses={"robot": POSE}, unit="mm", columns=[1.0]),
            "problem.field",
            "Targets.columns: got a list",
        ),
    ],
)
def test_slips_of_a_first_user_are_named(
    make_slip: Callable[[], object], code: str, expected_text: str
) -> None:
    with pytest.raises(TandemError) as caught:
        make_slip()
    (issue,) = caught.value.issues
    assert issue.code == code
    assert expected_text in issue.message


def test_the_page_lists_every_example() -> None:
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    listed = re.findall(r"\(examples/(\w+\.py)\)", page)
    assert listed == sorted(path.name for path in EXAMPLES.glob("*.py"))
