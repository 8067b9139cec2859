"""Requirements of an engraving on a tool, computed by the proof's own code.

They are tested against closed forms, against the planner's independent paths, and with planner faults, which
must not end proven.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from planner.claims.drawn_curve import DrawnCurve
from planner.geometry.arrays import FloatArray
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.milling.claims import Engraves, MillsAlong
from planner.processes.milling.plan import job as milling_job
from planner.processes.milling.plan import point_cut
from planner.processes.milling.plan.job import MillingJob
from planner.processes.milling.proof import resolve_claims
from planner.processes.milling.proof.path_following import match_path
from planner.proof.part_files import drawn_curves
from planner.proof.part_files.plan_face import PlanFace
from planner.proof.prove import Prover
from planner.proof.verdict import Proof
from planner.tooling import Cutter
from tests.processes.milling.plan.small_mill import BALL, PANEL, problem

WAVE = {"bspline_mm": [[-30, -15, 0], [0, 15, 0], [30, -15, 0]]}
ZIGZAG = {"polyline_mm": [[-30, -10, 0], [-10, 12, 0], [5, -8, 0], [5, 10, 0], [28, 9, 0]]}
BEND = {"bspline_mm": [[17, 1, 0], [-29, -4, 0], [-20, 11, 0], [-11, -8, 0]]}
ARCH = {"bezier_mm": [[-25, 10, 5], [0, 20, 9], [25, 8, 1]]}
ABOVE = {"polyline_mm": [[-34, -14, 60], [-12, 16, 60], [6, -12, 60], [6, 14, 60], [33, 12, 60]]}
VARIANTS: dict[str, dict[str, Any]] = {
    "along the normal": {"engrave": [WAVE, ARCH, ZIGZAG]},
    "leaning": {"engrave": [WAVE, ARCH], "lead_deg": 12, "tilt_deg": -7},
    "leaning round corners": {"engrave": [ZIGZAG], "lead_deg": 10},
    "leaning round a tight bend": {"engrave": [BEND], "lead_deg": -15, "tilt_deg": 12},
    "upright": {"engrave": [WAVE, ZIGZAG], "axis": "upright"},
    "through curves": {"engrave": [ZIGZAG], "axis": "curves", "axis_curves": [ABOVE]},
}
TOOLS: dict[str, dict[str, Any]] = {
    "ball": BALL,
    "bull": {**BALL, "cutter": "bull", "diameter_mm": 4, "corner_mm": 1},
    "cylinder": {**BALL, "cutter": "cylinder", "diameter_mm": 2},
}


def samples(path: MillsAlong, step: float = 0.1e-3) -> tuple[FloatArray, FloatArray]:
    """Return tips and axes along a path. Each move is straight with one uniform rotation (SciPy's)."""
    tips, axes = [path.tip[:1]], [path.axis[:1]]
    for i in range(len(path.tip) - 1):
        count = max(int(np.linalg.norm(path.tip[i + 1] - path.tip[i]) / step), 1)
        fraction = np.arange(1, count + 1) / count
        tips.append(path.tip[i] + fraction[:, None] * (path.tip[i + 1] - path.tip[i]))
        turn = Rotation.align_vectors(path.axis[i + 1].copy(), path.axis[i].copy())[0]
        both = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), turn]))
        axes.append(both(fraction).apply(path.axis[i].copy()))
    return np.concatenate(tips), np.concatenate(axes)


@pytest.mark.parametrize("tool", TOOLS)
@pytest.mark.parametrize("name", VARIANTS)
def test_the_planner_follows_what_the_proof_lays(tmp_path: Path, name: str, tool: str) -> None:
    own = problem(tmp_path, PANEL, TOOLS[tool], cuts=[{**VARIANTS[name], "depth_mm": 0.4}])
    job = registry.job(own, 0)
    assert isinstance(job, MillingJob)
    (group,) = resolve_claims.resolve_claims(registry.claims(own))[0].values()
    expected = {str(claim.segment): claim for claim in group if isinstance(claim, MillsAlong)}
    for run in job.planned.passes:
        claim = expected[f"mill/{run.name}"]
        path = dataclasses.replace(claim, tip=run.path.tip, axis=run.path.axis)
        found = match_path(claim, *samples(path))
        assert found.distance.max() < 0.15 * claim.tolerance or "corners" in name
        assert found.distance.max() <= claim.tolerance
        assert found.angle.max() <= claim.turn
        assert found.missed_count == 0


def dome(radius: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """The top of a ball about the origin as a fine mesh over a square of 160 mm."""
    side = np.linspace(-0.08, 0.08, 161)
    x, y = (row.ravel() for row in np.meshgrid(side, side, indexing="ij"))
    rows, columns = np.meshgrid(np.arange(160), np.arange(160), indexing="ij")
    at = (rows * 161 + columns).ravel()
    faces = np.concatenate([np.stack([at, at + 161, at + 162], 1), np.stack([at, at + 162, at + 1], 1)])
    return np.stack([x, y, np.sqrt(radius**2 - x**2 - y**2)], axis=1), faces


def test_places_and_normals_on_a_ball_are_those_of_the_closed_form() -> None:
    face = PlanFace(*dome(0.2))
    rng = np.random.default_rng(3)
    xy = rng.uniform(-0.07, 0.07, (400, 2))
    found = face.points_over(xy)
    np.testing.assert_allclose(found.point[:, 2], np.sqrt(0.04 - (xy**2).sum(axis=1)), atol=1e-5)
    expected = found.point / np.linalg.norm(found.point, axis=1, keepdims=True)
    assert np.abs(found.normal - expected).max() < 2e-3
    assert np.isnan(face.points_over(np.array([[0.15, 0.0]])).point).all()


def test_a_ball_on_a_ball_is_at_the_radius_less_the_depth() -> None:
    """A ball nose along the normal is everywhere 1 mm below: its tip is on a ball of radius 199 mm."""
    vertices, faces = dome(0.2)
    drawn = (DrawnCurve("bspline", ((-60, 0, 0), (0, 50, 0), (60, 0, 0))),)
    cutter = Cutter("ball", 0.003, 0.003, 0.012, 0.06, 0.003, np.zeros((0, 2)))
    safe: Any = None
    bounds = (0.02, safe, 1e-4, 0.01)
    claim = Engraves("a", "r", cutter, drawn, vertices, faces, 1e-3, "normal", (), 0.0, 0.0, *bounds)
    tip, axis = resolve_claims.engraving_tool(
        claim, PlanFace(vertices, faces), 0, drawn_curves.curve_points(drawn[0])[0]
    )
    np.testing.assert_allclose(np.linalg.norm(tip, axis=1), 0.199, atol=1.2e-5)
    assert np.degrees(np.arccos(np.clip((axis * tip).sum(axis=1) / 0.199, -1, 1))).max() < 0.3


@pytest.mark.parametrize(("corner", "tilt"), [(0.0, 0.3), (0.001, 0.3), (0.002, 0.3), (0.001, 0.0)])
def test_the_end_of_a_cutter_touches_the_plane_that_it_is_to(corner: float, tilt: float) -> None:
    """The lowest of many points of the round edge, laid here, is at the plane."""
    axis = np.array([[np.sin(tilt), 0.0, np.cos(tilt)]])
    cutter = Cutter("bull", 0.002, corner, 0.01, 0.05, 0.002, np.zeros((0, 2)))
    up = np.array([[0.0, 0.0, 1.0]])
    tip = resolve_claims.tool_tips(np.zeros((1, 3)), up, axis, cutter)[0]
    turn, around = np.meshgrid(np.linspace(0, np.pi / 2, 200), np.linspace(0, 2 * np.pi, 721))
    wide = cutter.radius - corner + corner * np.sin(turn)
    local = np.stack([wide * np.cos(around), wide * np.sin(around), corner - corner * np.cos(turn)], axis=-1)
    world = Rotation.from_euler("y", tilt).apply(local.reshape(-1, 3)) + tip
    assert world[:, 2].min() == pytest.approx(0.0, abs=1e-7)


def _tool(change: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]) -> Any:
    real = point_cut._engraving_tool_path

    def changed_tool(*arguments: Any) -> tuple[FloatArray, FloatArray]:
        return change(*real(*arguments))

    return changed_tool


_ALONG, _TIPS = point_cut._resample_curve, point_cut.tool_tips
MIRROR, SWAP = np.array([1.0, -1.0, 1.0]), [1, 0, 2]
FAULTS: dict[str, tuple[str, Any]] = {
    "shifted": ("_engraving_tool_path", _tool(lambda t, a: (t + np.array([4e-4, 0.0, 0.0]), a))),
    "mirrored": ("_resample_curve", lambda *given: _ALONG(*given) * MIRROR),
    "x and y swapped": ("_resample_curve", lambda *given: _ALONG(*given)[:, SWAP]),
    "half as long": ("_engraving_tool_path", _tool(lambda t, a: (t[: len(t) // 2], a[: len(a) // 2]))),
    "the other way": ("_resample_curve", lambda *given: _ALONG(*given)[::-1]),
    "half as deep": ("_engraving_tool_path", _tool(lambda t, a: (t + 0.4e-3 * a, a))),
    "not leant": ("tilted_axes", lambda normal, *more: normal),
    "radius not compensated": ("tool_tips", lambda contact, *more: contact),
    "curve left out": (
        "plan_engraving",
        lambda *given, real=point_cut.plan_engraving: (real(*given)[0][:-1], []),
    ),
    "first curve twice": (
        "_resample_curve",
        lambda *given: _ALONG(*FIRST[0]) if FIRST else FIRST.append(given) or _ALONG(*given),
    ),
}
FIRST: list[Any] = []


def proof(folder: Path) -> Proof:
    cut = {"engrave": [WAVE, ARCH], "depth_mm": 0.8, "lead_deg": 8, "feed_mm_s": 15}
    own = problem(folder, PANEL, BALL, cuts=[cut])
    targets = [registry.job(own, 0).targets()]
    programs = dict(write.program_files(solve.solve(own, targets), own))
    return Prover(own, registry.claims(own)).prove(programs, last="verify.spindle")


def test_a_clean_engraving_is_proven(tmp_path: Path) -> None:
    assert not proof(tmp_path).issues


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_planner_is_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(milling_job, "check_work", lambda made: [])
    FIRST.clear()
    where, change = FAULTS[name]
    monkeypatch.setattr(point_cut, where, change)
    assert proof(tmp_path).issues


@pytest.mark.parametrize("pieces", [1, 2])
def test_a_curve_of_a_drawing_is_laid_as_its_points_are(tmp_path: Path, pieces: int) -> None:
    """An open polyline in inches; in two pieces, the second of which is drawn first and backwards, nobody
    says which way it runs: either one will do."""
    ezdxf = pytest.importorskip("ezdxf")
    corners = [(x / 25.4, y / 25.4) for x, y, _ in ZIGZAG["polyline_mm"]]
    drawing = ezdxf.new()
    for part in [corners] if pieces == 1 else [corners[:1:-1], corners[:3]]:
        drawing.modelspace().add_lwpolyline(part)
    drawing.saveas(tmp_path / "own.dxf")
    own = problem(
        tmp_path,
        PANEL,
        BALL,
        cuts=[{"engrave": [{"dxf": {"file": "own.dxf", "unit": "in"}}], "depth_mm": 0.4}],
    )
    (group,) = resolve_claims.resolve_claims(registry.claims(own))[0].values()
    claim, *_ = [claim for claim in group if isinstance(claim, MillsAlong)]
    assert (claim.back is None) == (pieces == 1)
    straight = problem(tmp_path, PANEL, BALL, cuts=[{"engrave": [ZIGZAG], "depth_mm": 0.4}])
    (other,) = resolve_claims.resolve_claims(registry.claims(straight))[0].values()
    expected = next(claim for claim in other if isinstance(claim, MillsAlong))
    found = [np.abs(one.tip - expected.tip).max() for one in (claim, claim.back) if one is not None]
    assert min(found) < 1e-9
    if claim.back is not None:
        np.testing.assert_allclose(claim.back.tip, claim.tip[::-1], atol=1e-9)
    targets = [registry.job(own, 0).targets()]
    programs = dict(write.program_files(solve.solve(own, targets), own))
    assert not Prover(own, registry.claims(own)).prove(programs, last="verify.spindle").issues
