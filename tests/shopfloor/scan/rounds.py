"""Rounds of forming, scanning and adjusting against sheets whose true behaviour is known.

The sheets are `planner.loops.plant`, which knows nothing of adjustments. The scans are synthesized from what
it formed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from planner import pipeline
from planner.geometry.arrays import FloatArray, Mesh
from planner.geometry.curves import arc_length, interpolate_polyline
from planner.geometry.units import MM
from planner.loops.plant import PlantFile, PlantSheets
from planner.processes import registry
from planner.processes.forming.plan.contact import FormingToolPath
from planner.processes.forming.plan.job import FormingJob
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import make_tool_paths
from planner.processes.forming.plan.springback.compensation import ShiftedPath
from planner.processes.forming.plan.springback.compensation_file import SpringbackFile
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import adjustment, deviation
from planner.shopfloor.scan.adjustment import AdjustedPass
from planner.shopfloor.scan.cloud import Cloud
from tests import small_forming
from tests.processes.forming.plan.shapes import pit, revolved
from tests.shopfloor.scan.synthetic_scan import make_scan

TURN = 2.0 * np.pi * np.arange(24) / 24
STEP = 1.0 * MM
"""Levels are so far apart [m]."""
FINE = 0.25 * MM
"""Places of a path at which its shifts are asked are so far apart [m]."""
GIVES_WAY = 3
"""Levels above which such a sheet gives way before it forms at all."""


def cone(angle: float = 45.0, depth: float = 20.0, radius: float = 50.0) -> Mesh:
    """Return a cone from a circle [mm], with walls at an angle [deg], like that of the plant."""
    low = np.linspace(0.0, depth, 41)
    wide = radius - low / np.tan(np.radians(angle))
    rings = [(radius + 8.0, 0.0), *zip(wide, low, strict=True), (0.5 * wide[-1], depth), (0.0, depth)]
    return revolved([(float(r) * MM, float(-z) * MM) for r, z in rings], 120)


@dataclasses.dataclass(frozen=True)
class Kind:
    """Parts of a ``mesh`` [m], ``depth`` [mm], whose outlines are ``around`` a depth [mm], formed of a
    ``plant``'s sheets under ``force`` [N]."""

    mesh: Callable[[], Mesh]
    depth: float
    around: Callable[[float], FloatArray]
    plant: dict[str, Any]
    force: float


def _ring(depth: float, angle: float, radius: float) -> FloatArray:
    wide = (radius - depth / np.tan(np.radians(angle))) * MM
    return np.asarray(wide * np.column_stack([np.cos(TURN), np.sin(TURN)]))


def _square(depth: float) -> FloatArray:
    line = shapely.box(-0.015, -0.015, 0.015, 0.015).buffer((25.0 - depth) * MM, quad_segs=30).exterior
    rays = [shapely.LineString([(0.0, 0.0), (np.cos(a), np.sin(a))]) for a in TURN]
    return np.array([line.intersection(ray).coords[0] for ray in rays])


SOFT = [
    {"depth_mm": d, "forces_n": [100, 300, 600], "springback_mm": s}
    for d, s in ((5, [1.9, 3.7, 5.5]), (20, [1.6, 3.2, 4.7]))
]
STIFF = [
    {"depth_mm": d, "forces_n": [100, 300, 600], "springback_mm": s}
    for d, s in ((2, [0.5, 1.1, 1.6]), (12, [0.4, 0.8, 1.1]))
]
KINDS = {
    "cone": Kind(cone, 20.0, lambda d: _ring(d, 45.0, 50.0), {"sheet": "cone"}, 620.0),
    "pyramid": Kind(
        lambda: pit(shapely.box(-0.015, -0.015, 0.015, 0.015).buffer(0.025, quad_segs=30), 45.0, 0.02),
        *(20.0, _square, {"sheet": "pyramid"}, 620.0),
    ),
    "flat cone, soft sheet": Kind(
        lambda: cone(35.0, 12.0, 40.0),
        *(12.0, lambda d: _ring(d, 35.0, 40.0), {"curves": SOFT, "force_n": 400}, 400.0),
    ),
    "steep cone, stiff sheet": Kind(
        lambda: cone(55.0, 12.0, 35.0),
        *(12.0, lambda d: _ring(d, 55.0, 35.0), {"curves": STIFF, "force_n": 400}, 400.0),
    ),
}


def forming_job(folder: Path, kind: Kind) -> FormingJob:
    """The job of forming a part of a kind."""
    data = small_forming.problem("spif", stepdown_mm=STEP / MM, force_n=kind.force, unreached_mm=5)
    data["sheet"] |= {"size_mm": [260, 260], "opening_mm": 180, "metal": "aa5754_o"}
    (found,) = registry.jobs(pipeline.load(small_forming.write(folder, data, kind.mesh())))
    assert isinstance(found, FormingJob)
    return found


class FormingRounds:
    """Sheets of one kind that are formed, scanned and adjusted; ``exponent`` of the force in the step."""

    def __init__(self, job: FormingJob, kind: Kind, exponent: float = 0.18) -> None:
        self.job, self.kind, self.paths = job, kind, make_tool_paths(job.planned)
        ((_, self.path),) = self.paths
        self.levels = np.arange(STEP, kind.depth * MM + 1e-9, STEP)
        self._file = PlantFile(tandem_plant=1, force_exponent=exponent, **kind.plant)
        rings = [kind.around(depth / MM) for depth in self.levels]
        heights = job.planned.thickness - self.levels
        self._at = [_between(self.path, ring, z) for ring, z in zip(rings, heights, strict=True)]
        self._rings = rings

    def simulate_forming(self, shifted_path: ShiftedPath | None, seed: int) -> FloatArray:
        """How much too shallow (L, 24) [m] a sheet is, by level and around, formed by a way's shifts."""
        sheets, out = PlantSheets(self._file, [seed], self._rings[0]), []
        for depth, ring, (low, high, fraction) in zip(self.levels, self._rings, self._at, strict=True):
            shift = np.zeros(len(TURN))
            if shifted_path is not None:
                gone = arc_length(shifted_path.point)
                ends = [np.interp(item, gone / gone[-1], shifted_path.shift) for item in (low, high)]
                shift = (1.0 - fraction) * ends[0] + fraction * ends[1]
            sheets.form_level(float(depth), STEP, (depth + shift)[None], ring)
            out.append(depth - sheets.depth[0])
        return np.array(out)

    def scan(self, shallow: FloatArray, seed: int) -> tuple[Cloud, ProbedPoints]:
        """A scan of it: 0.05 mm of noise, a tenth of the points stray."""
        return simulate_scan(self.job, self.levels, shallow, seed)

    def run(self, seed: int, count: int) -> list[FloatArray]:
        """What is left (L, 24) [m] of the first one and after each round."""
        path: ShiftedPath | None = None
        given: SpringbackFile | None = None
        out = [self.simulate_forming(None, seed)]
        for number in range(count):
            (one,) = adjust_paths(self.job, self.paths, given, self.scan(out[-1], 1000 * seed + number))
            path, given = one.tool_path, SpringbackFile("a.json", (one.tool_path,), 0.05, scan="scan.ply")
            out.append(self.simulate_forming(path, seed))
        return out


def _between(path: FormingToolPath, ring: FloatArray, z: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For each place of a ring (24, 2) at a height [m] the shares of the way at which the loops above and
    below pass it, and how far (24,) it is from the one to the other."""
    places = arc_length(path.forming_centre)
    at = np.linspace(0.0, float(places[-1]), int(places[-1] / FINE))
    touch = interpolate_polyline(path.contact.point, places, at)
    loop = path.contact.loop[np.clip(np.searchsorted(places, at), 0, len(places) - 1)]
    out = []
    for place in ring:
        away = np.linalg.norm(touch[:, :2] - place, axis=1)
        nearest: dict[int, int] = {}
        for row in np.flatnonzero(away < 6.0 * MM)[np.argsort(away[away < 6.0 * MM])]:
            nearest.setdefault(int(loop[row]), int(row))
        rows = np.array(sorted(nearest.values(), key=lambda row: touch[row, 2]))
        heights = touch[rows, 2]
        fraction = float(np.interp(z, heights, np.arange(len(rows))))
        low = min(int(fraction), len(rows) - 2)
        out.append((at[rows[low]] / places[-1], at[rows[low + 1]] / places[-1], fraction - low))
    low_at, high_at, between = np.array(out).T
    return low_at, high_at, between


def simulate_scan(
    job: FormingJob, levels: FloatArray, shallow: FloatArray, seed: int
) -> tuple[Cloud, ProbedPoints]:
    """A scan of a part that is too ``shallow`` (L, 24) [m] at ``levels`` (L,) [m], and its marks."""
    thick, around = job.planned.thickness, np.append(TURN, 2.0 * np.pi)
    rows = np.vstack([np.zeros(24), shallow])
    field = RegularGridInterpolator(
        (np.append(0.0, levels), around),
        np.column_stack([rows, rows[:, 0]]),
        bounds_error=False,
        fill_value=None,
    )

    def deviation_at(q: FloatArray) -> FloatArray:
        angle = np.mod(np.arctan2(q[:, 1], q[:, 0]), 2.0 * np.pi)
        return np.asarray(field(np.column_stack([np.clip(thick - q[:, 2], 0.0, levels[-1]), angle])))

    assert job.part is not None
    assert job.part.formed is not None
    sample = make_scan(job.part.formed.mesh, job.setup.stock.size, deviation_at, seed, along_z=True)
    return Cloud("scan.ply", "0" * 64, sample.points, 0), ProbedPoints(
        tuple("abcd"), sample.sheet, sample.scan
    )


def adjust_paths(
    job: FormingJob,
    paths: Any,
    given: SpringbackFile | None,
    scan: tuple[Cloud, ProbedPoints],
    gain: float = 1.0,
) -> tuple[AdjustedPass, ...]:
    """The ways of the next part, from a scan of the one that was formed by what is ``given``."""
    cloud, marks = scan
    pose, found = deviation.of_part(cloud, job.part, job.setup.stock.size, marks, True)
    registered = adjustment.RegisteredScan(cloud, marks, pose, found, top=True)
    step = adjustment.AdjustmentStep(given, gain, Springback(file=Path("a.json")))
    return adjustment.adjusted(job.planned, paths, registered, step)
