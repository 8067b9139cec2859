"""Point-milling passes over a face, derived from the face alone.

The planner's paths fulfil the requirements for all options of a problem. Faults in its paths or its code do
not.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.milling.claims import MillsOver, MillsSurface
from planner.processes.milling.plan import job as milling_job
from planner.processes.milling.plan import point_cut
from planner.processes.milling.plan.job import MillingJob
from planner.processes.milling.proof.surface_passes import MilledFace
from planner.proof.prove import Prover
from tests import line_ends
from tests.processes.milling.plan.small_mill import BALL, PANEL, problem
from tests.processes.milling.proof.test_surface_passes_flank import dense

LINES: dict[str, Any] = {"lines": "front", "stepover_mm": 4}
CASES: dict[str, dict[str, Any]] = {
    "normal": LINES,
    "across": {**LINES, "angle_deg": 70},
    "one way": {**LINES, "zigzag": False},
    "leant": {**LINES, "lead_deg": 9, "tilt_deg": -4},
    "upright": {**LINES, "axis": "upright"},
    "within a margin": {**LINES, "margin_mm": 5},
}
TOOLS: dict[str, dict[str, Any]] = {
    "ball": BALL,
    "bull": {**BALL, "cutter": "bull", "corner_mm": 1},
    "cylinder": {**BALL, "cutter": "cylinder"},
}


def job(folder: Path, tool: str, cut: dict[str, Any]) -> tuple[MillingJob, MillsOver]:
    own = registry.job(problem(folder, PANEL, TOOLS[tool], cuts=[cut], share=0.51), 0)  # far apart
    assert isinstance(own, MillingJob)
    (claim,) = [claim for claim in own.claims() if isinstance(claim, MillsOver)]
    return own, claim


def samples(milling_job: MillingJob) -> tuple[FloatArray, FloatArray]:
    """Samples of all passes."""
    rows = [dense(run.path.tip, run.path.axis) for run in milling_job.planned.passes]
    return np.concatenate([tip for tip, _ in rows]), np.concatenate([axis for _, axis in rows])


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("name", CASES)
def test_what_the_planner_lays_keeps_to_the_face(tmp_path: Path, name: str, tool: str) -> None:
    own, claim = job(tmp_path, tool, CASES[name])
    deviation = MilledFace(claim).deviations(*samples(own))
    assert max(float(value.max()) for value in deviation.values()) < 0.97


Change = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _leant(tip: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    out = axis + np.array([0.03, 0.0, 0.0])
    return tip, out / np.linalg.norm(out, axis=1, keepdims=True)


WRONG: dict[str, Change] = {
    "off the face": lambda tip, axis: (tip + 6e-4 * axis, axis),
    "in the face": lambda tip, axis: (tip - 6e-4 * axis, axis),
    "beyond the edge": lambda tip, axis: (tip + np.array([0.005, 0.0, 0.0]), axis),
    "leaning": _leant,
}


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("name", ["normal", "upright", "within a margin"])
def test_what_is_off_it_is_found(tmp_path: Path, name: str, wrong: str) -> None:
    own, claim = job(tmp_path, "ball", CASES[name])
    deviation = MilledFace(claim).deviations(*WRONG[wrong](*samples(own)))
    assert max(float(value.max()) for value in deviation.values()) > 1.0


_TOOL, _TIPS, _RUNS = point_cut._line_tool_path, point_cut.tool_tips, point_cut.plan_lines


def _each(change: Change) -> Callable[..., Any]:
    return lambda *given: change(*_TOOL(*given))


FAULTS: dict[str, tuple[str, Any]] = {
    "shifted by 3 mm": ("_line_tool_path", _each(lambda tip, axis: (tip + np.array([0.003, 0, 0]), axis))),
    "0.4 mm too deep": ("_line_tool_path", _each(lambda tip, axis: (tip - 4e-4 * axis, axis))),
    "the ball's middle for its tip": ("tool_tips", lambda contact, normal, *more: contact + 0.003 * normal),
    "x and y swapped": ("_line_tool_path", _each(lambda tip, axis: (tip[:, [1, 0, 2]], axis[:, [1, 0, 2]]))),
    "margin left out": ("plan_lines", lambda op, cut, over, cutter, area=None: _RUNS(op, cut, over, cutter)),
    "margin twice as wide": (
        "plan_lines",
        lambda op, cut, over, cutter, area=None: _RUNS(op, cut, over, cutter, area.buffer(-0.004)),
    ),
}


ALWAYS = ("0.4 mm too deep", "margin left out")


@pytest.mark.parametrize(
    "name", [None, *(n if n in ALWAYS else pytest.param(n, marks=pytest.mark.long) for n in FAULTS)]
)
def test_faults_in_the_planner_are_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str | None
) -> None:
    monkeypatch.setattr(milling_job, "check_work", lambda made: [])
    if name is not None:
        monkeypatch.setattr(point_cut, *FAULTS[name])
    own = problem(
        tmp_path, PANEL, BALL, cuts=[{**LINES, "stepover_mm": 1.2, "margin_mm": 8, "feed_mm_s": 20}]
    )
    claims = registry.claims(own)
    (expected,) = [c for group in claims.values() for c in group if isinstance(c, MillsSurface)]
    assert expected.margin == 0.008
    targets = [registry.job(own, 0).targets()]
    programs = line_ends.bare(write.program_files(solve.solve(own, targets), own))
    assert bool(Prover(own, claims).prove(programs, last="verify.spindle").issues) == (name is not None)
