"""Scans that are made up, held against the part: time and memory of `tandem scan-fit`, pose and field that
come back, with marks and without, beside other ways to lay a scan on its part from the same start.

Noise 0.05 mm, a tenth of the points stray by up to 10 mm, one hole. The field is known: more comes back the
deeper it is, three crests around and a tilt to one side, which a fit to the formed part takes for a pose.
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
from bench.peers import installed
from planner import pipeline
from planner.geometry.arrays import FloatArray, Mesh, transform
from planner.geometry.mesh import TriangleMesh
from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.problem import Formed, Part
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.align.rigid_fit import rigid_fit
from planner.shopfloor.scan import deviation, freedoms
from planner.shopfloor.scan.cloud import Cloud
from planner.shopfloor.scan.deviation import Deviation
from planner.shopfloor.scan.registration import Pose
from tests import small_forming
from tests.processes.forming.plan.shapes import pit
from tests.shopfloor.scan import rounds
from tests.shopfloor.scan.made_scan import MadeScan, made_scan, write_marks, write_ply

GOAL_S, GOAL_MB = 15.0, 1500.0
GOAL_FIELD, GOAL_WAY, GOAL_TURN = 0.05 * MM, 0.05 * MM, 0.05 * DEG
COUNTS: Final = (100_000, 300_000, 1_000_000)
RUNS: Final = 3
"""Runs of a command whose median is told; one for other kinds of files."""
SEEDS: Final = {100_000: 6, 300_000: 2, 1_000_000: 1}
"""Scans of each part by their points."""
KNOWN: Final = 0.02 * MM
"""Marks are known to this [m] in each coordinate, one standard deviation."""
HOLE: Final = (0.02, 0.0, 0.006)
BESIDE: Final = (1.0 * MM, -0.6 * MM)
TURNED: Final = 0.5 * DEG
"""Where scans without marks lie in the sheet's plane, if they do not lie right,"""
ABOVE: Final = 2.0 * MM
LEANS: Final = (0.3 * DEG, -0.2 * DEG)
"""and how high and how tilted all of them are."""
ROUNDS: Final = (
    ("cone", "cone", 0.18, range(31, 36)),
    ("pyramid", "pyramid", 0.18, range(31, 33)),
    ("flat cone of a soft sheet", "flat cone, soft sheet", 0.18, range(31, 33)),
    ("steep cone of a stiff sheet", "steep cone, stiff sheet", 0.18, range(31, 33)),
    ("cone, force not by the step (0.03)", "cone", 0.03, range(31, 33)),
    ("cone, force more by the step (0.4)", "cone", 0.4, range(31, 33)),
)
"""Parts that are formed again and again: of what, exponent of the force in the step, seeds of sheets."""
PEER_POINTS: Final = 200_000
"""Points of the wanted shape that peers are given."""
PEER_CELL_MM: Final = 0.5
FARTHEST_MM: Final = 3.0
"""small_gicp takes a point of each cell, and pairs that are no farther apart."""
PLAIN_POINTS: Final = 20_000
PLAIN_ROUNDS: Final = 40
"""Points of the scan that the plain fit takes, and its rounds."""


@dataclasses.dataclass(frozen=True)
class Job:
    """A part and the ``size`` (3,) [m] of its sheet."""

    mesh: Mesh
    size: FloatArray

    @property
    def face(self) -> TriangleMesh:
        """The wanted top face in the sheet's frame."""
        return TriangleMesh(self.mesh.vertices + self.size * [0, 0, 1], np.asarray(self.mesh.faces))

    def off(self, q: FloatArray) -> FloatArray:
        """How far (N,) [m] the formed part is off at places (N, 3) [m] of the wanted face."""
        deepest = float(-self.mesh.vertices[:, 2].min())
        depth = np.clip((self.size[2] - q[:, 2]) / deepest, 0.0, 1.0)
        far = np.minimum(np.hypot(q[:, 0], q[:, 1]) / 0.015, 1.0)
        crests = 1.0 + 0.4 * far * np.sin(3.0 * np.arctan2(q[:, 1], q[:, 0]))
        return np.asarray(0.6 * MM * np.sqrt(depth) * crests + depth * 8.0 * MM * q[:, 0])


def jobs() -> dict[str, Job]:
    """A round dish, one with a dome on its floor, and a pit with rounded corners and walls of 45 degrees."""
    square = shapely.box(-0.025, -0.02, 0.025, 0.02).buffer(0.012, quad_segs=16)
    return {
        "dish": Job(small_forming.dish(around=120), np.array([160.0, 160.0, 1.0]) * MM),
        "dish with a dome": Job(small_forming.dish_with_a_dome(), np.array([180.0, 180.0, 1.0]) * MM),
        "pit": Job(pit(square, 45.0, 0.010), np.array([160.0, 160.0, 1.0]) * MM),
    }


@dataclasses.dataclass(frozen=True)
class Error:
    """What is wrong of a fit: the field, root mean square and most [m]; the pose at the sheet's middle [m]
    and its turn [rad]; of it the height [m] and the tilt [rad]; the share of the face that is known."""

    field: float
    most: float
    way: float
    turn: float
    height: float
    tilt: float
    known: float


def scan(job: Job, count: int, seed: int) -> MadeScan:
    """A scan of about so many points, some centimetres and degrees off."""
    return made_scan(job.mesh, job.size, job.off, seed, count=count, hole=HOLE, marks=KNOWN)


def unplaced(made: MadeScan, beside: tuple[float, float], turned: float) -> MadeScan:
    """The same scan as a scanner gives it whose frame is the sheet's but for height, tilt and a place
    ``beside`` [m] and ``turned`` [rad]."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([*LEANS, turned]).as_matrix()
    pose[:3, 3] = *beside, ABOVE
    points = transform(np.linalg.inv(pose) @ made.pose, made.points)
    return MadeScan(points, pose, made.sheet, transform(np.linalg.inv(pose), made.sheet))


def fitted(job: Job, made: MadeScan, marks: bool) -> tuple[Pose, Deviation]:
    """What the product makes of a scan."""
    names = tuple(f"m{k}" for k in range(len(made.sheet)))
    known = ProbedPoints(names, made.sheet, made.scan) if marks else None
    cloud = Cloud("scan.ply", "", made.points, 0)
    return deviation.of_part(cloud, Part(formed=Formed(job.mesh)), job.size, known, True)


def error(job: Job, made: MadeScan, matrix: FloatArray, found: Deviation) -> Error:
    """What a pose (4, 4) and a field are off the truth."""
    wrong = matrix @ np.linalg.inv(made.pose)
    turn = Rotation.from_matrix(wrong[:3, :3]).as_rotvec()
    known = np.isfinite(found.off)
    off = found.off[known] - job.off(found.point[known])
    return Error(
        float(np.sqrt(np.mean(off**2))),
        float(np.abs(off).max()),
        float(np.linalg.norm(wrong[:3, 3])),
        float(np.linalg.norm(turn)),
        float(abs(wrong[2, 3])),
        float(np.hypot(turn[0], turn[1])),
        float(known.mean()),
    )


def run() -> list[dict[str, Any]]:
    """Rows of processor time [s], memory [MB], errors [mm] and [deg]."""
    return [*commands(), *with_marks(), *without_marks(), *adjusted(), *beside_peers()]


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
                middle = statistics.median(one[0] for one in spent)
                peak = max(one[1] for one in spent)
                yield {
                    "name": f"scan-fit, {len(points):,} points, {kind}",
                    "median_s": middle,
                    "spread": max(one[0] for one in spent) - min(one[0] for one in spent),
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
"""Starts a command from a small process: its memory begins with that of who starts it."""


def _command(result: Path, path: Path, marks: Path) -> tuple[float, float]:
    """Processor time [s] and largest memory [MB] of a command; raises ``RuntimeError`` where it fails."""
    words = [sys.executable, "-m", "planner", "scan-fit", str(result), str(path), "--marks", str(marks)]
    done = subprocess.run([sys.executable, "-S", "-c", _WATCHED, *words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"tandem scan-fit of {path.name}: {done.stderr}")
    spent, peak = map(float, done.stdout.split())
    return spent, peak / 1024.0


def _triples(count: int) -> FloatArray:
    """Two faces for each vertex, as meshes of scanners have; which does not matter to whom takes vertices."""
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
    """The worst of all parts and seeds, four marks beside the part."""
    for count in COUNTS:
        found = []
        for job in jobs().values():
            for seed in range(SEEDS[count]):
                made = scan(job, count, seed)
                pose, field = fitted(job, made, marks=True)
                found.append(error(job, made, pose.matrix, field))
        yield from _worst(f"{count:,} points, four marks", found)


def _worst(name: str, found: list[Error]) -> Iterator[dict[str, Any]]:
    many = f"worst of {len(found)} scans"
    field, most = max(one.field for one in found), max(one.most for one in found)
    note = f"{many}; {most / MM:.3f} mm at most"
    yield _row(f"{name}: field, mm rms", field / MM, GOAL_FIELD / MM, note)
    yield _row(f"{name}: place, mm", max(one.way for one in found) / MM, GOAL_WAY / MM, many)
    yield _row(f"{name}: turn, deg", max(one.turn for one in found) / DEG, GOAL_TURN / DEG, many)


def without_marks() -> Iterator[dict[str, Any]]:
    """The flat alone: what it says, and what is told of the rest."""
    count = COUNTS[0]
    right, wrong = [], []
    for name, job in jobs().items():
        for seed in range(SEEDS[count]):
            made = unplaced(scan(job, count, seed), (0.0, 0.0), 0.0)
            pose, field = fitted(job, made, marks=False)
            right.append(error(job, made, pose.matrix, field))
        made = unplaced(scan(job, count, 0), BESIDE, TURNED)
        pose, field = fitted(job, made, marks=False)
        wrong.append((name, error(job, made, pose.matrix, field), freedoms.sideways(field)))
    head, many = f"{count:,} points, no marks", f"worst of {len(right)} scans"
    field = max(one.field for one in right) / MM
    yield _row(f"{head}, placed right: field, mm rms", field, GOAL_FIELD / MM, many)
    yield _row(f"{head}: height, mm", max(one.height for one in right) / MM, GOAL_WAY / MM, many)
    yield _row(f"{head}: tilt, deg", max(one.tilt for one in right) / DEG, GOAL_TURN / DEG, many)
    for name, one, told in wrong:
        x, y = told.move / MM
        note = (
            f"told: {100.0 * told.share:.0f} % as if ({x:.2f}, {y:.2f}) mm beside, {told.turn / DEG:.2f} deg "
            f"turned; truth ({-BESIDE[0] / MM:g}, {-BESIDE[1] / MM:g}) mm, {-TURNED / DEG:g} deg; adjust "
            + ("refuses" if told.beside else "warns")
        )
        yield {
            "name": f"{head}, {np.hypot(*BESIDE) / MM:.1f} mm beside, {name}: field, mm rms",
            "median_s": one.field / MM,
            "note": note,
        }


def adjusted() -> Iterator[dict[str, Any]]:
    """What three rounds of forming, scanning and adjusting leave below the first 3 mm, of sheets whose truth
    is known; and what the third changes."""
    for name, kind, exponent, seeds in ROUNDS:
        with tempfile.TemporaryDirectory() as folder:
            made = rounds.Rounds(
                rounds.job_of(Path(folder), rounds.KINDS[kind]), rounds.KINDS[kind], exponent
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
    """What is left (S, R, L, P) [mm] of round k, the worst of all sheets, and by how much it changed."""
    now = np.abs(left[:, k]).reshape(len(left), -1)
    changed = np.abs(left[:, k] - left[:, k - 1]).reshape(len(left), -1)
    high, steps = np.percentile(now, 95, axis=1).max(), np.percentile(changed, 95, axis=1).max()
    return (
        f"worst of {len(left)} sheets; 95 % {high:.3f}, at most {now.max():.3f}; changed by {steps:.3f} "
        f"(95 %), {changed.max():.3f}"
    )


Fit = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""From a start (4, 4): the pose that carries a scan (N, 3) onto the wanted shape (M, 3), both [m]."""


def beside_peers() -> Iterator[dict[str, Any]]:
    """Poses by other fits, from the same start, and the field that the product finds with each."""
    for name, count in [*((name, COUNTS[0]) for name in jobs()), ("dish", COUNTS[-1])]:
        job = jobs()[name]
        made = scan(job, count, 7)
        begin = time.process_time()
        pose, field = fitted(job, made, marks=True)
        ours = time.process_time() - begin
        head = f"{name}, {count:,} points"
        note = _told(error(job, made, pose.matrix, field))
        yield {"name": f"{head}: pose and field by Tandem", "median_s": ours, "note": note}
        for peer, fit in PEERS.items():
            yield beside(f"{head}: {peer}", job, made, fit, ours)


def beside(name: str, job: Job, made: MadeScan, fit: Fit, ours: float) -> dict[str, Any]:
    """A row of another fit's pose, from the start that marks give, and the field that it makes."""
    shape = made_scan(job.mesh, job.size, lambda q: np.zeros(len(q)), 99, PEER_POINTS, 0.0, 0.0)
    wanted = transform(shape.pose, shape.points)
    start = rigid_fit(made.sheet, made.scan, np.ones(len(made.sheet)))
    try:
        begin = time.process_time()
        matrix = fit(start, made.points, wanted)
        spent = time.process_time() - begin
    except ImportError as missing:
        return {"name": name, "note": f"skipped: {missing}"}
    row = {"name": name, "median_s": spent, "ratio": spent / ours}
    pose = Pose(matrix, 0, 0.0, {}, np.full(6, np.inf))
    try:
        field = deviation.deviation(made.points, pose, job.face, float(job.size[2]))
    except TandemError as refused:
        return row | {"note": f"no field: {refused.issues[0].message}"}
    return row | {"note": _told(error(job, made, matrix, field))}


def _told(one: Error) -> str:
    return (
        f"place {one.way / MM:.3f} mm, turn {one.turn / DEG:.3f} deg, field {one.field / MM:.3f} mm rms, "
        f"{one.most / MM:.2f} at most"
    )


def by_small_gicp(start: FloatArray, points: FloatArray, wanted: FloatArray) -> FloatArray:
    """Point to plane by small_gicp, the whole scan, lengths in mm. Raises ``ImportError``."""
    import small_gicp

    begin = start.copy()
    begin[:3, 3] /= MM
    found = small_gicp.align(
        wanted / MM,
        points / MM,
        begin,
        registration_type="PLANE_ICP",
        downsampling_resolution=PEER_CELL_MM,
        max_correspondence_distance=FARTHEST_MM,
        num_threads=1,
        max_iterations=50,
        rotation_epsilon=1e-5,
        translation_epsilon=1e-3,
    )
    out = np.array(found.T_target_source)
    out[:3, 3] *= MM
    return out


def plain(start: FloatArray, points: FloatArray, wanted: FloatArray) -> FloatArray:
    """Point to point (Besl and McKay 1992), the whole scan, nothing left out."""
    tree, pose = cKDTree(wanted), start
    some = points[:: max(1, len(points) // PLAIN_POINTS)]
    for _ in range(PLAIN_ROUNDS):
        _, near = tree.query(transform(pose, some))
        last, pose = pose, rigid_fit(wanted[near], some, np.ones(len(some)))
        if np.abs(pose - last).max() < 1e-7:
            break
    return pose


PEERS: Final[dict[str, Fit]] = {
    f"{installed('small_gicp')}, point to plane": by_small_gicp,
    "point to point by a k-d tree": plain,
}


def _row(name: str, value: float, goal: float, note: str) -> dict[str, Any]:
    return {"name": name, "median_s": value, "ratio": value / goal, "note": f"{note}; wanted {goal:g}"}
