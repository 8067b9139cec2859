"""Flank passes over a ruled surface, derived from the guides alone.

The planner's paths, which other code computes, fulfil the requirements for all options of a problem. Faults
do not.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.geometry.arrays import FloatArray
from planner.languages.writing import write
from planner.motion import solve
from planner.processes import registry
from planner.processes.milling.claims import MillsFlank
from planner.processes.milling.plan import cutter_contact, flank_cut
from planner.processes.milling.plan import job as milling_job
from planner.processes.milling.plan.job import MillingJob
from planner.processes.milling.plan.tool_path import CutterPass, safe_points
from planner.processes.milling.proof import surface_passes
from planner.processes.milling.proof.tool_motion import in_block
from planner.proof.prove import Prover
from tests import line_ends
from tests.processes.milling.plan.small_mill import WALL, problem

LONG = {"flute_mm": 60, "overhang_mm": 95, "diameter_mm": 8}


def wall(start: dict[str, Any], end: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"ruled": [{"name": "wall", "start": start, "end": end, **more}], "in_stock": {}}


TURN = np.linspace(0.0, 2 * np.pi, 200, endpoint=False)
ROUND = [
    {"polyline_mm": [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in TURN]}
    for r, z in ((20, 12), (16, 50))
]
SQUARE = [{"polyline_mm": [[s, s, z], [-s, s, z], [-s, -s, z], [s, -s, z]]} for s, z in ((20, 12), (17, 50))]
TENT = [{"polyline_mm": [[-50, 9, z], [0, -5, z], [50, 6, z]]} for z in (12, 50)]
TWIST = [{"polyline_mm": [[-50, -a, z], [50, a, z]]} for a, z in ((4, 12), (-4, 50))]
APEX = [
    {"bspline_mm": [[-40, 0, 12], [0, 20, 12], [40, 0, 12]]},
    {"bspline_mm": [[-1, 0, 50], [0, 0.4, 50], [1, 0, 50]]},
]
CASES: dict[str, dict[str, Any]] = {
    "plain": {"cuts": [{"flank": "wall"}]},
    "against": {"cuts": [{"flank": "wall", "direction": "against"}]},
    "climb": {"cuts": [{"flank": "wall", "direction": "climb"}]},
    "conventional": {"cuts": [{"flank": "wall", "direction": "conventional"}]},
    "no lead": {"cuts": [{"flank": "wall", "lead_mm": 0}]},
    "short lead": {"cuts": [{"flank": "wall", "lead_mm": 15}]},
    "roughed": {"cuts": [{"flank": "wall", "stepdown_mm": 11, "leave_mm": 0.7}]},
    "the guides' own": {"cuts": [{"flank": "wall", "guides": "tool"}]},
    "round": {"part": wall(*ROUND, closed=True), "cuts": [{"flank": "wall"}]},
    "round the other way": {
        "part": wall(*ROUND, closed=True),
        "cuts": [{"flank": "wall", "direction": "climb"}],
    },
    "corners": {"part": wall(*SQUARE, closed=True), "cuts": [{"flank": "wall", "stepdown_mm": 20}]},
    "one corner": {"part": wall(*TENT), "cuts": [{"flank": "wall", "lead_mm": 12}]},
    "twisted": {"part": wall(*TWIST), "cuts": [{"flank": "wall", "stepdown_mm": 15}]},
    "fan": {"part": wall(*APEX, match="parameter"), "cuts": [{"flank": "wall"}]},
}


def job(folder: Path, **fields: Any) -> tuple[MillingJob, MillsFlank]:
    own = registry.job(problem(folder, WALL, LONG, **fields), 0)
    assert isinstance(own, MillingJob)
    (claim,) = [claim for claim in own.claims() if isinstance(claim, MillsFlank)]
    return own, claim


def dense(tip: FloatArray, axis: FloatArray, step: float = 0.8e-3) -> tuple[FloatArray, FloatArray]:
    """Sample a path, straight from point to point."""
    path_length = np.maximum(
        np.linalg.norm(np.diff(tip, axis=0), axis=1), 0.02 * np.linalg.norm(np.diff(axis, axis=0), axis=1)
    )
    along = np.append(0.0, np.cumsum(path_length))
    at = np.union1d(np.arange(0.0, along[-1], step), along)
    tips, axes = (
        np.stack([np.interp(at, along, row[:, k]) for k in range(3)], axis=1) for row in (tip, axis)
    )
    return tips, axes / np.linalg.norm(axes, axis=1, keepdims=True)


def parts(milling_job: MillingJob, run: CutterPass) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Samples of a pass, and of its ways away from it."""
    path = run.path
    start, end = safe_points(milling_job.operation, run, milling_job.planned.box)
    into = np.concatenate([start[None], path.tip[: run.first + 1]])[::-1]
    turned = np.concatenate([path.axis[:1], path.axis[: run.first + 1]])[::-1]
    out = np.concatenate([path.tip[run.last :], end[None]])
    leant = np.concatenate([path.axis[run.last :], path.axis[-1:]])
    rows = slice(run.first, run.last + 1)
    return {"": dense(path.tip[rows], path.axis[rows]), "_in": dense(into, turned), "_out": dense(out, leant)}


def faults_of_pass(
    claim: MillsFlank, number: int, sampled: dict[str, tuple[FloatArray, FloatArray]]
) -> list[str]:
    """Return the faults of a pass with its lead-in and lead-out."""
    tip, axis = sampled[""]
    own = surface_passes.check_pass(claim, number, tip, axis)
    out = [*own.faults, *(own.criterion[i] for i in np.flatnonzero(own.deviation > 1.0)[:1])]
    for phase, rows in (("_in", [0, 1]), ("_out", [-1, -2])):
        way = surface_passes.check_lead(claim, number, (tip[rows], axis[rows]), *sampled[phase])
        out += [*way.faults, *(f"{phase} {value:.2f}" for value in [way.deviation.max()] if value > 1.0)]
        assert way.is_axial[-1]
    return out


@pytest.mark.parametrize("name", CASES)
def test_what_the_planner_lays_keeps_to_the_surface(tmp_path: Path, name: str) -> None:
    own, claim = job(tmp_path, **CASES[name])
    for number, run in enumerate(own.planned.passes):
        assert faults_of_pass(claim, number, parts(own, run)) == []


@pytest.mark.parametrize("radii", [(28, 8), (20, 16), (26, 30)])
def test_a_tool_that_turns_on_its_way_is_off_the_block_at_its_end(
    tmp_path: Path, radii: tuple[int, int]
) -> None:
    """It is behind at its end that goes round less, and drawn back along its axis (verify.mill_path)."""
    cone = [
        {"polyline_mm": [[float(r * np.cos(t)), float(r * np.sin(t)), z] for t in TURN]}
        for r, z in zip(radii, (12, 50), strict=True)
    ]
    own, claim = job(tmp_path, part=wall(*cone, closed=True), cuts=[{"flank": "wall"}])
    cutter, stock = claim.cutter, own.setup.stock
    for run in own.planned.passes:
        tip, axis = run.path.tip[[0, -1]], run.path.axis[[0, -1]]
        assert not in_block(tip, axis, cutter.overhang, cutter.radius, stock).any()


def test_a_tool_that_is_drawn_back_may_do_so_fast_from_the_end_of_its_way_on(tmp_path: Path) -> None:
    """Its first millimetres up counted as its way aside, at the feed: a quick arm's job was not proven."""
    straight = [{"polyline_mm": [[*p[:2], z] for p in ROUND[0]["polyline_mm"]]} for z in (12, 50)]
    own, claim = job(tmp_path, part=wall(*straight, closed=True), cuts=[{"flank": "wall"}])
    (run,) = own.planned.passes
    found = parts(own, run)
    tip, axis = found[""]
    for phase, rows, end in (("_in", [0, 1], 0), ("_out", [-1, -2], -1)):
        way = surface_passes.check_lead(claim, 0, (tip[rows], axis[rows]), *found[phase])
        rise = (found[phase][0] - run.path.tip[end]) @ run.path.axis[end]
        assert way.is_axial[rise > 0.5e-3].all() and not way.is_axial[rise < -0.5e-3].any()


Change = Callable[[FloatArray, FloatArray, MillsFlank], tuple[FloatArray, FloatArray]]


def _sideways(metres: float) -> Change:
    def change(tip: FloatArray, axis: FloatArray, claim: MillsFlank) -> tuple[FloatArray, FloatArray]:
        travel = np.gradient(tip, axis=0)
        side = np.cross(axis, travel)
        return tip + metres * side / np.linalg.norm(side, axis=1, keepdims=True), axis

    return change


def _tilt(tip: FloatArray, axis: FloatArray, claim: MillsFlank) -> tuple[FloatArray, FloatArray]:
    side = np.cross(axis, np.gradient(tip, axis=0))
    out = axis + 0.03 * side / np.linalg.norm(side, axis=1, keepdims=True)
    return tip, out / np.linalg.norm(out, axis=1, keepdims=True)


WRONG: dict[str, Change] = {
    "0.8 mm toward the block": _sideways(8e-4),
    "0.8 mm toward the part": _sideways(-8e-4),
    "on the other side": _sideways(-0.008),
    "too deep": lambda tip, axis, claim: (tip - 1e-3 * axis, axis),
    "too high": lambda tip, axis, claim: (tip + 1e-3 * axis, axis),
    "leaning off": _tilt,
    "backwards": lambda tip, axis, claim: (tip[::-1], axis[::-1]),
    "cut short": lambda tip, axis, claim: (tip[: len(tip) * 9 // 10], axis[: len(tip) * 9 // 10]),
    "begun late": lambda tip, axis, claim: (tip[len(tip) // 10 :], axis[len(tip) // 10 :]),
    "there and back": lambda tip, axis, claim: (
        np.concatenate([tip, tip[::-1]]),
        np.concatenate([axis, axis[::-1]]),
    ),
    "leading too far": lambda tip, axis, claim: _led(tip, axis, claim),
}


def _led(tip: FloatArray, axis: FloatArray, claim: MillsFlank) -> tuple[FloatArray, FloatArray]:
    """The axis leans along the feed, by more than the radius over the height."""
    travel = np.gradient(tip, axis=0)
    tall = float(np.linalg.norm(claim.high - claim.low, axis=1).mean())
    out = axis + (0.009 / tall) * travel / np.linalg.norm(travel, axis=1, keepdims=True)
    return tip, out / np.linalg.norm(out, axis=1, keepdims=True)


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("name", ["plain", "against", "round", "twisted"])
def test_what_is_off_it_is_found(tmp_path: Path, name: str, wrong: str) -> None:
    own, claim = job(tmp_path, **CASES[name])
    last = len(claim.segments) - 1
    tip, axis = WRONG[wrong](*parts(own, own.planned.passes[-1])[""], claim)
    found = surface_passes.check_pass(claim, last, tip, axis)
    assert found.faults or found.deviation.max() > 1.0


ASTRAY: dict[str, Change] = {
    "beside": lambda tip, axis, claim: (tip + np.array([0.0, 0.004, 0.0]), axis),
    "deeper": lambda tip, axis, claim: (tip - 0.002 * axis, axis),
    "not from the safe plane": lambda tip, axis, claim: (tip[:-12], axis[:-12]),
    "longer": lambda tip, axis, claim: (
        np.concatenate([tip[:1], tip[:1] + 2.5 * (tip - tip[0])]),
        axis[[0, *range(len(axis))]],
    ),
    "off to the side": lambda tip, axis, claim: (
        np.concatenate(
            [
                tip[:1] + np.linspace(0, 1, 40)[:, None] * np.array([0, 0.02, 0]),
                tip[:1] + np.array([0, 0.02, 0.1]),
            ]
        ),
        np.repeat(axis[:1], 41, axis=0),
    ),
}


@pytest.mark.parametrize("wrong", ASTRAY)
@pytest.mark.parametrize("phase", ["_in", "_out"])
def test_ways_that_go_elsewhere_are_found(tmp_path: Path, phase: str, wrong: str) -> None:
    own, claim = job(tmp_path, **CASES["short lead"])
    found = parts(own, own.planned.passes[0])
    rows = [0, 1] if phase == "_in" else [-1, -2]
    end = found[""][0][rows], found[""][1][rows]
    way = surface_passes.check_lead(claim, 0, end, *ASTRAY[wrong](*found[phase], claim))
    assert way.faults or way.deviation.max() > 1.0


_AXES, _RUN, _PLACED = cutter_contact.cutter_axes, flank_cut._build_pass, flank_cut.place_cutter
FAULTS: dict[str, tuple[Any, str, Any]] = {
    "on the other side": (
        cutter_contact,
        "cutter_axes",
        lambda strip, radius: _AXES(dataclasses.replace(strip, outward_sign=-strip.outward_sign), radius),
    ),
    "radius not compensated": (cutter_contact, "cutter_axes", lambda strip, radius: _AXES(strip, 0.0)),
    "half of the radius": (cutter_contact, "cutter_axes", lambda strip, radius: _AXES(strip, 0.5 * radius)),
    "tip not beyond its guide": (flank_cut, "tip_overrun", lambda cut, cutter: -0.004),
    "roughing 2 mm too high": (
        flank_cut,
        "_build_pass",
        lambda op, cut, name, on, lift, *more: _RUN(
            op, cut, name, on, lift + 0.002 * (name != "wall"), *more
        ),
    ),
    "the other way": (
        flank_cut,
        "place_cutter",
        lambda op, cut, ruled, radius: _PLACED(
            op, cut.model_copy(update={"direction": "against"}), ruled, radius
        ),
    ),
    "ways in and out left out": (
        flank_cut,
        "_extend_lead",
        lambda cut, low, high, *more: (low[:0], high[:0]),
    ),
}


def prove(folder: Path) -> Any:
    own = problem(folder, WALL, cuts=[{"flank": "wall", "stepdown_mm": 25}])
    targets = [registry.job(own, 0).targets()]
    programs = line_ends.bare(write.program_files(solve.solve(own, targets), own))
    return Prover(own, registry.claims(own)).prove(programs, last="verify.spindle")


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_the_planner_is_not_proven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(milling_job, "check_work", lambda made: [])
    monkeypatch.setattr(flank_cut, "check_flank", lambda *given: [])
    monkeypatch.setattr(*FAULTS[name])
    assert prove(tmp_path).issues
