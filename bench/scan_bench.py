"""Synthetic scans compared with the part: time and memory of `tandem scan-fit`, recovered pose and field.

Runs with marks and without, and compares other methods of aligning a scan with its part from the same start.

Noise 0.05 mm, a tenth of the points stray by up to 10 mm, one hole. The field is known: the error grows with
depth, with three crests around and a tilt to one side, which a fit to the formed part takes for a pose.
"""

from __future__ import annotations

import dataclasses
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import planner
from bench.peers import installed_version
from planner import pipeline
from planner.geometry.arrays import FloatArray, Mesh, transform
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.problem import FormedPart, Part
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.align.rigid_fit import rigid_fit
from planner.shopfloor.scan import deviation, freedoms
from planner.shopfloor.scan.cloud import Cloud
from planner.shopfloor.scan.deviation import Deviation
from planner.shopfloor.scan.registration import ScanPose
from tests import small_forming
from tests.processes.forming.plan.shapes import pit
from tests.shopfloor.scan import rounds
from tests.shopfloor.scan.synthetic_scan import SyntheticScan, make_scan, write_marks, write_ply

GOAL_S, GOAL_MB = 15.0, 1500.0
GOAL_FIELD, GOAL_WAY, GOAL_TURN = 0.05 * MM, 0.05 * MM, 0.05 * DEG
COUNTS: Final = (100_000, 300_000, 1_000_000)
RUNS: Final = 3
"""Number of runs of a command whose median is reported; one for other kinds of files."""
SEEDS: Final = {100_000: 6, 300_000: 2, 1_000_000: 1}
"""Number of scans of each part, by their points."""
KNOWN: Final = 0.02 * MM
"""Standard deviation [m] of the marks in each coordinate."""
HOLE: Final = (0.02, 0.0, 0.006)
LATERAL_OFFSET_M: Final = (1.0 * MM, -0.6 * MM)
ROTATION_RAD: Final = 0.5 * DEG
"""Rotation [rad] in the sheet's plane of scans without marks that are misplaced."""
ABOVE: Final = 2.0 * MM
TILTS_RAD: Final = (0.3 * DEG, -0.2 * DEG)
"""Tilts [rad] of all scans."""
ROUNDS: Final = (
    ("cone", "cone", 0.18, range(31, 36)),
    ("pyramid", "pyramid", 0.18, range(31, 33)),
    ("flat cone of a soft sheet", "flat cone, soft sheet", 0.18, range(31, 33)),
    ("steep cone of a stiff sheet", "steep cone, stiff sheet", 0.18, range(31, 33)),
    ("cone, force not by the step (0.03)", "cone", 0.03, range(31, 33)),
    ("cone, force more by the step (0.4)", "cone", 0.4, range(31, 33)),
)
"""Parts that are formed repeatedly: shape, exponent of the force in the step, seeds of sheets."""
PEER_POINTS: Final = 200_000
"""Number of points of the nominal shape for peers."""
PEER_CELL_MM: Final = 0.5
MAX_PAIR_DISTANCE_MM: Final = 3.0
"""small_gicp takes a point of each cell, and pairs within this distance."""
PLAIN_POINTS: Final = 20_000
PLAIN_ROUNDS: Final = 40
"""Number of scan points of the plain fit, and of its rounds."""


@dataclasses.dataclass(frozen=True)
class ScanJob:
    """A part and the ``size`` (3,) [m] of its sheet."""

    mesh: Mesh
    size: FloatArray

    @property
    def face(self) -> TriangleMesh:
        """The nominal top face in the frame of the sheet."""
        return TriangleMesh(self.mesh.vertices + self.size * [0, 0, 1], np.asarray(self.mesh.faces))

    def deviation_at(self, q: FloatArray) -> FloatArray:
        """Return the deviations (N,) [m] of the formed part at points (N, 3) [m] of the nominal face."""
        deepest = float(-self.mesh.vertices[:, 2].min())
        depth = np.clip((self.size[2] - q[:, 2]) / deepest, 0.0, 1.0)
        distance = np.minimum(np.hypot(q[:, 0], q[:, 1]) / 0.015, 1.0)
        crests = 1.0 + 0.4 * distance * np.sin(3.0 * np.arctan2(q[:, 1], q[:, 0]))
        return np.asarray(0.6 * MM * np.sqrt(depth) * crests + depth * 8.0 * MM * q[:, 0])


def jobs() -> dict[str, ScanJob]:
    """A round dish, one with a dome on its floor, and a pit with rounded corners and walls of 45 degrees."""
    square = shapely.box(-0.025, -0.02, 0.025, 0.02).buffer(0.012, quad_segs=16)
    return {
        "dish": ScanJob(small_forming.dish(around=120), np.array([160.0, 160.0, 1.0]) * MM),
        "dish with a dome": ScanJob(small_forming.dish_with_a_dome(), np.array([180.0, 180.0, 1.0]) * MM),
        "pit": ScanJob(pit(square, 45.0, 0.010), np.array([160.0, 160.0, 1.0]) * MM),
    }


@dataclasses.dataclass(frozen=True)
class FitError:
    """Errors of a fit.

    The field, root mean square and maximum [m]; the pose at the sheet's middle [m] and its rotation [rad];
    their height [m] and tilt [rad]; and the fraction of the face that is known.
    """

    field: float
    max_field: float
    displacement: float
    rotation: float
    height: float
    tilt: float
    known: float


def scan(job: ScanJob, count: int, seed: int) -> SyntheticScan:
    """Return a scan of about the given number of points, displaced by some centimetres and degrees."""
    return make_scan(job.mesh, job.size, job.deviation_at, seed, count=count, hole=HOLE, marks=KNOWN)


def displace_scan(
    sample: SyntheticScan, lateral_offset: tuple[float, float], rotation: float
) -> SyntheticScan:
    """Return the scan of a scanner whose frame differs from the sheet's.

    It differs by height, tilt, ``lateral_offset`` [m] and ``rotation`` [rad].
    """
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([*TILTS_RAD, rotation]).as_matrix()
    pose[:3, 3] = *lateral_offset, ABOVE
    points = transform(np.linalg.inv(pose) @ sample.pose, sample.points)
    return SyntheticScan(points, pose, sample.sheet, transform(np.linalg.inv(pose), sample.sheet))


def fit_scan(job: ScanJob, sample: SyntheticScan, marks: bool) -> tuple[ScanPose, Deviation]:
    """Fit a scan as the product does."""
    names = tuple(f"m{k}" for k in range(len(sample.sheet)))
    known = ProbedPoints(names, sample.sheet, sample.scan) if marks else None
    cloud = Cloud("scan.ply", "", sample.points, 0)
    return deviation.of_part(cloud, Part(formed=FormedPart(job.mesh)), job.size, known, True)


def fit_error(
    job: ScanJob, sample: SyntheticScan, matrix: FloatArray, fitted_deviation: Deviation
) -> FitError:
    """Return the errors of a pose (4, 4) and a field."""
    wrong = matrix @ np.linalg.inv(sample.pose)
    turn = Rotation.from_matrix(wrong[:3, :3]).as_rotvec()
    known = np.isfinite(fitted_deviation.deviation)
    deviation = fitted_deviation.deviation[known] - job.deviation_at(fitted_deviation.point[known])
    return FitError(
        float(np.sqrt(np.mean(deviation**2))),
        float(np.abs(deviation).max()),
        float(np.linalg.norm(wrong[:3, 3])),
        float(np.linalg.norm(turn)),
        float(abs(wrong[2, 3])),
        float(np.hypot(turn[0], turn[1])),
        float(known.mean()),
    )


def run() -> list[dict[str, Any]]:
    """Rows of processor time [s], memory [MB], errors [mm] and [deg]."""
    return [*commands(), *with_marks(), *without_marks(), *adjustment_rows(), *compare_peers()]


def commands() -> Iterator[dict[str, Any]]:
    """`tandem scan-fit` on a dish, a process each, from the file to the table that it prints."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        problem = planner.load(
            small_forming.write(folder, small_forming.problem("spif"), small_forming.dish(around=120))
        )
        pipeline.save(problem, folder / "out" / "problem")
        job = jobs()["dish"]
        for count in COUNTS:
            # holes and what lies under the part take some of the points
            made = scan(job, round(1.02 * count), 1)
            marks = write_marks(folder / "marks.csv", made)
            points = made.points[:count]
            kinds = _WRITERS if count == COUNTS[-1] else {".ply": write_ply}
            for kind, write in kinds.items():
                path = write(folder / f"scan{kind}", points)
                runs = RUNS if kind == ".ply" else 1
                spent = [_command(folder / "out", path, marks) for _ in range(runs)]
                path.unlink()
                middle = statistics.median(item[0] for item in spent)
                peak = max(item[1] for item in spent)
                yield {
                    "name": f"scan-fit, {len(points):,} points, {kind}",
                    "median_s": middle,
                    "spread": max(item[0] for item in spent) - min(item[0] for item in spent),
                    "ratio": middle / GOAL_S,
                    "memory_mb": peak,
                    "note": f"processor time; {peak:.0f} MB; wanted {GOAL_S:g} s, {GOAL_MB:g} MB",
                }


_WATCHED: Final = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
sys.exit(done.returncode)
"""
"""Starts a command from a small process, because its memory begins with that of its parent."""


def _command(result: Path, path: Path, marks: Path) -> tuple[float, float]:
    """Processor time [s] and largest memory [MB] of a command; raises ``RuntimeError`` where it fails."""
    words = [sys.executable, "-m", "planner", "scan-fit", str(result), str(path), "--marks", str(marks)]
    done = subprocess.run([sys.executable, "-S", "-c", _WATCHED, *words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"tandem scan-fit of {path.name}: {done.stderr}")
    spent, peak = map(float, done.stdout.split())
    return spent, peak / 1024.0


def _triples(count: int) -> FloatArray:
    """Return two faces for each vertex, as in scanner meshes; irrelevant to readers of vertices."""
    k = np.arange(count)
    return np.vstack([np.column_stack([k, (k + a) % count, (k + b) % count]) for a, b in ((1, 2), (3, 5))])


def write_xyz(path: Path, points: FloatArray) -> Path:
    """A point a line, mm."""
    np.savetxt(path, points / MM, fmt="%.4f")
    return path


def write_obj(path: Path, points: FloatArray) -> Path:
    """Vertices and faces, mm."""
    with path.open("wb") as file:
        np.savetxt(file, points / MM, fmt="v %.4f %.4f %.4f")
        np.savetxt(file, _triples(len(points)) + 1, fmt="f %d %d %d")
    return path


def write_stl(path: Path, points: FloatArray) -> Path:
    """Binary, mm: two triangles for each point."""
    corners = (points / MM)[_triples(len(points))]
    rows = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("none", "<u2")])
    rows["corners"] = corners
    path.write_bytes(bytes(80) + np.uint32(len(rows)).tobytes() + rows.tobytes())
    return path


_WRITERS: Final[dict[str, Callable[[Path, FloatArray], Path]]] = {
    ".ply": write_ply,
    ".xyz": write_xyz,
    ".obj": write_obj,
    ".stl": write_stl,
}


def with_marks() -> Iterator[dict[str, Any]]:
    """Return the worst of all parts and seeds, with four marks beside the part."""
    for count in COUNTS:
        result = []
        for job in jobs().values():
            for seed in range(SEEDS[count]):
                made = scan(job, count, seed)
                pose, field = fit_scan(job, made, marks=True)
                result.append(fit_error(job, made, pose.matrix, field))
        yield from _worst(f"{count:,} points, four marks", result)


def _worst(name: str, errors: list[FitError]) -> Iterator[dict[str, Any]]:
    many = f"worst of {len(errors)} scans"
    field, most = max(item.field for item in errors), max(item.max_field for item in errors)
    note = f"{many}; {most / MM:.3f} mm at most"
    yield _row(f"{name}: field, mm rms", field / MM, GOAL_FIELD / MM, note)
    yield _row(f"{name}: place, mm", max(item.displacement for item in errors) / MM, GOAL_WAY / MM, many)
    yield _row(f"{name}: turn, deg", max(item.rotation for item in errors) / DEG, GOAL_TURN / DEG, many)


def without_marks() -> Iterator[dict[str, Any]]:
    """Fit the flat alone: its results, and the messages about the rest."""
    count = COUNTS[0]
    right, wrong = [], []
    for name, job in jobs().items():
        for seed in range(SEEDS[count]):
            made = displace_scan(scan(job, count, seed), (0.0, 0.0), 0.0)
            pose, field = fit_scan(job, made, marks=False)
            right.append(fit_error(job, made, pose.matrix, field))
        made = displace_scan(scan(job, count, 0), LATERAL_OFFSET_M, ROTATION_RAD)
        pose, field = fit_scan(job, made, marks=False)
        wrong.append((name, fit_error(job, made, pose.matrix, field), freedoms.in_plane_motion(field)))
    head, many = f"{count:,} points, no marks", f"worst of {len(right)} scans"
    field = max(item.field for item in right) / MM
    yield _row(f"{head}, placed right: field, mm rms", field, GOAL_FIELD / MM, many)
    yield _row(f"{head}: height, mm", max(item.height for item in right) / MM, GOAL_WAY / MM, many)
    yield _row(f"{head}: tilt, deg", max(item.tilt for item in right) / DEG, GOAL_TURN / DEG, many)
    for name, item, told in wrong:
        x, y = told.move / MM
        note = (
            f"told: {100.0 * told.fraction:.0f} % as if ({x:.2f}, {y:.2f}) mm beside, {told.turn / DEG:.2f} "
            f"deg turned; truth ({-LATERAL_OFFSET_M[0] / MM:g}, {-LATERAL_OFFSET_M[1] / MM:g}) mm, "
            f"{-ROTATION_RAD / DEG:g} deg; "
            "adjust " + ("refuses" if told.is_offset else "warns")
        )
        yield {
            "name": f"{head}, {np.hypot(*LATERAL_OFFSET_M) / MM:.1f} mm beside, {name}: field, mm rms",
            "median_s": item.field / MM,
            "note": note,
        }


def adjustment_rows() -> Iterator[dict[str, Any]]:
    """Return the error after three rounds of forming, scanning and adjusting, below the first 3 mm.

    The true behaviour of the sheets is known. Also returns the change by the third round.
    """
    for name, kind, exponent, seeds in ROUNDS:
        with tempfile.TemporaryDirectory() as folder:
            made = rounds.FormingRounds(
                rounds.forming_job(Path(folder), rounds.KINDS[kind]), rounds.KINDS[kind], exponent
            )
        left = np.array([made.run(seed, 3) for seed in seeds])[:, :, rounds.GIVES_WAY :] / MM
        for k in (1, 2, 3):
            yield {
                "name": f"adjusted, {name}: round {k}, mm, mean",
                "median_s": _mean(left[:, k]),
                "note": _left(left, k),
            }


def _mean(left: FloatArray) -> float:
    return float(np.abs(left).mean(axis=(1, 2)).max())


def _left(left: FloatArray, k: int) -> str:
    """Return the remaining error (S, R, L, P) [mm] of round k, the worst of all sheets, and its change."""
    now = np.abs(left[:, k]).reshape(len(left), -1)
    changed = np.abs(left[:, k] - left[:, k - 1]).reshape(len(left), -1)
    high, steps = np.percentile(now, 95, axis=1).max(), np.percentile(changed, 95, axis=1).max()
    return (
        f"worst of {len(left)} sheets; 95 % {high:.3f}, at most {now.max():.3f}; changed by {steps:.3f} "
        f"(95 %), {changed.max():.3f}"
    )


Fit = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Function of a start (4, 4) that returns the pose of a scan (N, 3) on the nominal shape (M, 3), both [m]."""


def compare_peers() -> Iterator[dict[str, Any]]:
    """Poses by other fits, from the same start, and the field that the product finds with each."""
    for name, count in [*((name, COUNTS[0]) for name in jobs()), ("dish", COUNTS[-1])]:
        job = jobs()[name]
        made = scan(job, count, 7)
        start_s = time.process_time()
        pose, field = fit_scan(job, made, marks=True)
        ours = time.process_time() - start_s
        head = f"{name}, {count:,} points"
        note = _error_note(fit_error(job, made, pose.matrix, field))
        yield {"name": f"{head}: pose and field by Tandem", "median_s": ours, "note": note}
        for peer, fit in PEERS.items():
            yield peer_row(f"{head}: {peer}", job, made, fit, ours)


def peer_row(name: str, job: ScanJob, sample: SyntheticScan, fit: Fit, ours: float) -> dict[str, Any]:
    """A row of another fit's pose, from the start that marks give, and the field that it makes."""
    shape = make_scan(job.mesh, job.size, lambda q: np.zeros(len(q)), 99, PEER_POINTS, 0.0, 0.0)
    expected = transform(shape.pose, shape.points)
    start = rigid_fit(sample.sheet, sample.scan, np.ones(len(sample.sheet)))
    try:
        start_s = time.process_time()
        matrix = fit(start, sample.points, expected)
        spent = time.process_time() - start_s
    except ImportError as missing:
        return {"name": name, "note": f"skipped: {missing}"}
    row = {"name": name, "median_s": spent, "ratio": spent / ours}
    pose = ScanPose(matrix, 0, 0.0, {}, np.full(6, np.inf))
    try:
        field = deviation.deviation(sample.points, pose, job.face, float(job.size[2]))
    except TandemError as refused:
        return row | {"note": f"no field: {refused.issues[0].message}"}
    return row | {"note": _error_note(fit_error(job, sample, matrix, field))}


def _error_note(fit_error: FitError) -> str:
    return (
        f"place {fit_error.displacement / MM:.3f} mm, turn {fit_error.rotation / DEG:.3f} deg, "
        f"field {fit_error.field / MM:.3f} mm rms, "
        f"{fit_error.max_field / MM:.2f} at most"
    )


def by_small_gicp(start: FloatArray, points: FloatArray, reference_points: FloatArray) -> FloatArray:
    """Point to plane by small_gicp, the whole scan, lengths in mm. Raises ``ImportError``."""
    import small_gicp

    begin = start.copy()
    begin[:3, 3] /= MM
    result = small_gicp.align(
        reference_points / MM,
        points / MM,
        begin,
        registration_type="PLANE_ICP",
        downsampling_resolution=PEER_CELL_MM,
        max_correspondence_distance=MAX_PAIR_DISTANCE_MM,
        num_threads=1,
        max_iterations=50,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-3,
    )
    out = np.array(result.T_target_source)
    out[:3, 3] *= MM
    return out


def plain_icp(start: FloatArray, points: FloatArray, reference_points: FloatArray) -> FloatArray:
    """Point to point (Besl and McKay 1992), the whole scan, nothing left out."""
    tree, pose = cKDTree(reference_points), start
    subset = points[:: max(1, len(points) // PLAIN_POINTS)]
    for _ in range(PLAIN_ROUNDS):
        _, near = tree.query(transform(pose, subset))
        last, pose = pose, rigid_fit(reference_points[near], subset, np.ones(len(subset)))
        if np.abs(pose - last).max() < 1e-7:
            break
    return pose


PEERS: Final[dict[str, Fit]] = {
    f"{installed_version('small_gicp')}, point to plane": by_small_gicp,
    "point to point by a k-d tree": plain_icp,
}


def _row(name: str, value: float, goal: float, note: str) -> dict[str, Any]:
    return {"name": name, "median_s": value, "ratio": value / goal, "note": f"{note}; wanted {goal:g}"}
