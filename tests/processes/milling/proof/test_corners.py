"""Sharp corners of milled paths: the verdict does not depend on the phase of the samples."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest

import planner
from planner.geometry.arrays import FloatArray
from planner.processes import registry
from planner.processes.milling.proof import path_following
from planner.proof.prove import Prover
from planner.proof.replay import moves, playback, tool_track
from planner.proof.replay.tool_track import ReplayedToolPath, _add_bends
from tests.test_sharp_turns import ABB, CELLS, KUKA, MILLED

PHASES = np.linspace(3.7e-3, 4.3e-3, 12)
"""Times between samples [s]: each puts the samples elsewhere on every corner."""
CORNERS = ["X20 Y0", "X0 Y0", "X20 Y2", "X0 Y0", "X0 Y20", "X20 Y20", "X30 Y10"]
"""A path with turns by 180, 174, 96, 90 and 45 degrees."""
POINTS_MM = np.clip(np.cumsum(np.random.default_rng(2).normal(0.0, 10.0, (14, 2)), axis=0), -60.0, 60.0)
ZIGZAG = [*(f"X{x:.3f} Y{y:.3f}" for x, y in POINTS_MM), "X0 Y0", "X20 Y0", "X0 Y0", "X20 Y2", "X0 Y-1"]
"""One with turns of any size."""


class Job:
    """A zigzag that is milled at one feed [mm/min] within a tolerance [mm], and its programs."""

    def __init__(
        self, folder: Path, cell: tuple[str, str], tolerance: float, feed: float, path_words: list[str]
    ) -> None:
        text = MILLED.replace("CELL", f"{CELLS / cell[0]}.yaml").replace("PLACE", cell[1])
        text = text.replace("TOLERANCE", str(tolerance)).replace("AXIS", "tool_axis: fixed")
        (folder / "problem.yaml").write_text(text)
        head = ["G21 G90 G94 G17", "S12000 M3 F1200", "G0 X0 Y0 Z20", "G1 Z-3"]
        lines = [*head, f"F{feed:g}", *path_words, "G0 Z30", "M5", "M30", ""]
        (folder / "job.nc").write_text("\n".join(lines))
        problem = planner.load(folder / "problem.yaml")
        self.outcome = planner.plan(problem)
        self.programs = dict(self.outcome.programs)
        self.prover = Prover(problem, registry.claims(problem))

    def verdicts(self, monkeypatch: pytest.MonkeyPatch, programs: dict[str, str]) -> set[tuple[bool, bool]]:
        """Verdicts on the path and on the feed, for any phase of the samples."""
        out = set()
        for phase in PHASES:
            monkeypatch.setattr(playback, "SAMPLE_TIME_S", float(phase))
            proof = self.prover.prove(programs, last="verify.mill_feed")
            out.add((proof.rule("verify.mill_path").passed, proof.rule("verify.mill_feed").passed))
        return out


@pytest.fixture(scope="module")
def fine(tmp_path_factory: pytest.TempPathFactory) -> Job:
    return Job(tmp_path_factory.mktemp("fine"), ABB, 0.01, 2400, CORNERS)


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    ("cell", "tolerance", "feed"), [(ABB, 0.01, 9000), (ABB, 0.1, 9000), (KUKA, 0.01, 2400)]
)
def test_corners_hold_at_every_phase_of_the_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell: tuple[str, str], tolerance: float, feed: float
) -> None:
    job = Job(tmp_path, cell, tolerance, feed, ZIGZAG)
    assert job.outcome.verified
    assert job.verdicts(monkeypatch, job.programs) == {(True, True)}


def moved(programs: dict[str, str], target: str, to: str) -> dict[str, str]:
    """Move the last occurrence of a target in the programs."""
    (name,) = [name for name, text in programs.items() if target in text]
    before, _, behind = programs[name].rpartition(target)
    return {**programs, name: before + to + behind}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    "corner", [(20.0, 0.0, -1.0, 0.0), (20.0, 2.0, -1.0, -0.1), (20.0, 20.0, -0.38, -0.92)]
)
def test_a_corner_that_is_cut_is_found_at_every_phase(
    fine: Job, monkeypatch: pytest.MonkeyPatch, corner: tuple[float, float, float, float]
) -> None:
    """Its target is moved to where both its ways lead, by 0.006 mm, which is allowed, and by 0.02 mm."""
    x, y, *inwards = corner
    way = np.array(inwards) / np.hypot(*inwards)
    place = f"[[{x:.4f},{y:.4f},77.0000]"
    for cut, holds in ((0.006, True), (0.02, False)):
        to = np.array([x, y]) + cut * way
        programs = moved(fine.programs, place, f"[[{to[0]:.4f},{to[1]:.4f},77.0000]")
        assert {path for path, _ in fine.verdicts(monkeypatch, programs)} == {holds}


def test_a_zone_that_rounds_a_corner_too_far_is_found_at_every_phase(
    fine: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A corner of 90 degrees at equal speeds is a parabola that passes it by s / sqrt(8), where s is how long
    before it begins: 0.06 mm at 25 mm/s, 5 ms in all, leave it by 0.021 mm."""
    place = "[[0.0000,20.0000,77.0000]"
    (name,) = [name for name, text in fine.programs.items() if place in text]
    text = fine.programs[name]
    start = text.index(place)
    assert re.match(r".*?,fine,", text[start : text.index("\n", start)])
    zoned = text[:start] + text[start:].replace(",fine,", ",z60um,", 1)
    for size, holds in ((0.015, True), (0.06, False)):
        zone = f"CONST zonedata z60um:=[FALSE,{size},{size},{size},0.1,{size},0.1];\n"
        module, rest = zoned.split("\n", 1)
        programs = {**fine.programs, name: f"{module}\n  {zone}{rest}"}
        assert {path for path, _ in fine.verdicts(monkeypatch, programs)} == {holds}


def test_what_is_found_hangs_not_on_how_many_places_are_worked_on_at_once(
    fine: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = fine.prover.prove(fine.programs, last="verify.spindle").rules
    monkeypatch.setattr(tool_track, "POSITIONS_PER_BATCH", 7)
    monkeypatch.setattr(path_following, "_MAX_SAMPLES", 7)
    assert fine.prover.prove(fine.programs, last="verify.spindle").rules == whole


def test_lines_between_looks_are_off_the_motion_by_micrometres() -> None:
    """Samples every 4 ms and the looks between them, against ten thousand places of the same motion."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        count = 30
        delta = np.concatenate([rng.normal(0.0, 2e-3, (count, 3)), rng.normal(0.0, 0.02, (count, 3))], axis=1)
        stop = rng.random(count + 1) < 0.2
        stop[[0, -1]] = True
        duration = rng.uniform(0.003, 0.2, count)
        reach, room = rng.uniform(0.0, 0.5, (count + 1, 2)), rng.uniform(0.0, 2e-3, count + 1)
        law = moves.time_law(duration, np.linalg.norm(delta[:, :3], axis=1), stop, reach, room)
        start = np.concatenate([np.zeros((1, 6)), np.cumsum(delta, axis=0)])

        def at(time: FloatArray) -> FloatArray:
            node, xi = moves.offsets(law, delta, time)  # noqa: B023 (called in this round)
            return np.asarray(start[node] + xi)  # noqa: B023

        total = float(law.times[-1])
        grid = np.linspace(0.0, total, int(np.ceil(total / 0.004)) + 1)
        looks = np.union1d(grid, moves.corner_times(law, [delta], float(grid[1])))
        dense = np.linspace(0.0, total, 10_000)
        seen, true = at(looks), at(dense)
        k = np.clip(np.searchsorted(looks, dense, side="right") - 1, 0, len(looks) - 2)
        for columns, error in (
            (slice(0, 3), moves.CHORD_TOLERANCE[0]),
            (slice(3, 6), moves.CHORD_TOLERANCE[1]),
        ):
            a, step = seen[k, columns], np.diff(seen[:, columns], axis=0)[k]
            off = true[:, columns] - a
            fraction = (off * step).sum(axis=1) / np.maximum((step * step).sum(axis=1), 1e-30)
            distance = np.linalg.norm(off - np.clip(fraction, 0.0, 1.0)[:, None] * step, axis=1)
            assert distance.max() <= 1.5 * error


def test_places_of_a_track_leave_out_no_corner() -> None:
    """A zigzag with a place each millimetre, where its corners are no whole millimetres apart."""
    corner = np.array([[0.0, 0, 0], [10.3, 0, 0], [10.3, 7.7, 0], [1.1, 7.7, 0], [9.2, 7.7, 0]]) * 1e-3
    part = np.linspace(0.0, 1.0, 101)[:-1, None]
    tip = np.concatenate([a + part * (b - a) for a, b in itertools.pairwise(corner)] + [corner[-1:]])
    rows = np.arange(len(tip))
    axis = np.tile([0.0, 0.0, 1.0], (len(tip), 1))
    joined = rows[1:] != 250  # there the tool is elsewhere for a while
    ahead = np.tile([1.0, 0.0, 0.0], (len(tip), 1))
    node, names = np.zeros(len(tip), dtype=np.int64), np.array(["mill/a"])
    track = ReplayedToolPath(rows, tip, axis, joined, node, names, 0.004 * rows, ahead)
    for bend in (np.inf, 1e-5):
        places, _, _ = track.spaced(1e-3, bend)
        distance = np.linalg.norm(places[None] - corner[:, None], axis=2).min(axis=1)
        assert (distance.max() < 1e-9) == np.isfinite(bend)
        assert len(places) < 40 + 3 * len(corner)
    on = np.linspace(0.0, 1.0, len(tip))
    assert np.array_equal(_add_bends(tip[:, None].repeat(2, 1), on, on, 1e-5), on)
