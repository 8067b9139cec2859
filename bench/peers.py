"""``python -m bench peers [--write]``: every row against another tool, in one run, each peer by its version.

Peers: Tesseract, Drake's own tools, toppra's own retimers, py-opw-kinematics, EAIK, ssik. What is not
installed or cannot be loaded is "skipped" with the reason. With ``--write`` the table goes into
``docs/benchmarks.md``, between its marks.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from scipy.spatial.transform import RigidTransform
from toppra import algorithm, constraint
from toppra.interpolator import SplineInterpolator

from bench import drake_bench, tesseract_bench, timing_bench
from bench.machine import machine
from planner.catalogue.robots import RobotData, robot, urdf_path
from planner.cell.kinematics import forward_kinematics, joint_axes, link_frames
from planner.geometry.arrays import FloatArray
from planner.motion.planning_scene import inverse_kinematics
from planner.motion.trajectory.timing import compute_profile, solve_drake
from tests.urdf_text import UR10E

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"
START_MARK = "<!-- written by python -m bench peers --write -->"
END_MARK = "<!-- end of what bench peers writes -->"
PACKAGES = ("drake", "numpy", "scipy", "toppra", "coal")
RUNS = 5
POSES = 10_000
FEW = 200
"""Number of poses for a slow peer that takes them one at a time."""
GRID = 400
PATHS = 20
SPEED, STRENGTH = 3.0, 9.0
"""Bounds of the joints' speeds [rad/s] and accelerations [rad/s^2] on random paths."""


@dataclasses.dataclass(frozen=True)
class Row:
    """One piece of work: median processor seconds of Tandem and of the ``peer``, None if there is none."""

    work: str
    peer: str
    ours: float | None
    theirs: float | None
    note: str

    @property
    def ratio(self) -> float | None:
        """How many times as long the peer takes."""
        return None if not self.ours or self.theirs is None else self.theirs / self.ours


def installed_version(package: str) -> str:
    """Name and version of a package, or its name alone."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return package


def medians(*works: Callable[[], object]) -> list[float]:
    """Median processor times [s] of works that take turns, the first turn not counted."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(RUNS + 1):
        for work, own in zip(works, times, strict=True):
            start = time.process_time()
            work()
            if turn:
                own.append(time.process_time() - start)
    return [float(np.median(own)) for own in times]


def rows() -> list[Row]:
    """All rows."""
    return [*inverse(), *timing(), *drake(), *tesseract()]


def inverse() -> Iterator[Row]:
    """All branches of poses of an IRB 140 and of a UR10e by closed forms, of a GoFa by a search."""
    irb, ur = ("an IRB 140", robot("irb140")), ("a UR10e", UR10E)
    gofa = ("a GoFa CRB 15000-5/0.95", robot("crb15000_5_95"))
    for (arm, data), package, make, count in (
        (irb, "py-opw-kinematics", _opw, POSES),
        (irb, "EAIK", _eaik, POSES),
        (irb, "ssik", _ssik, FEW),
        (ur, "EAIK", _eaik, POSES),
        (gofa, "ssik", _ssik, FEW),  # which prepares itself for a minute or two when asked first
    ):
        q = np.random.default_rng(0).uniform(data.lower, data.upper, (POSES, 6))
        flange = forward_kinematics(data, q)
        work = f"inverse kinematics, all branches, {count:,} poses of {arm}"
        try:
            prepare, solve, counted = make(data)
        except ImportError as error:
            yield Row(work, installed_version(package), None, None, f"skipped: {error}")
            continue
        subset = flange[:count]
        asked = prepare(subset)
        own, peer = medians(partial(inverse_kinematics, data.form, subset), partial(solve, asked))
        branches = int(np.sum(~np.isnan(inverse_kinematics(data.form, subset)[..., 0])))
        note = f"solutions: {branches:,}, {counted(solve(asked)):,} by the peer"
        yield Row(work, installed_version(package), own, peer, note)


Solver = tuple[Callable[[FloatArray], Any], Callable[[Any], Any], Callable[[Any], int]]
"""Poses (N, 4, 4) of the flange in the peer's format, its call, and the number of solutions."""


def _opw(data: RobotData) -> Solver:
    from py_opw_kinematics import KinematicModel, Robot

    p = data.opw
    model = KinematicModel(p.a1, p.a2, p.b, p.c1, p.c2, p.c3, p.c4, tuple(p.offsets), (False,) * 6)
    peer = Robot(model, degrees=False)
    return (
        RigidTransform.from_matrix,
        peer.reach,
        lambda found: int(np.sum(np.isfinite(np.asarray(found.joints)[..., 0]))),
    )


def _eaik(data: RobotData) -> Solver:
    from eaik.IK_Homogeneous import HomogeneousRobot

    frames = link_frames(data, np.zeros(6))
    joints = [frames[6]]
    for axis, frame in zip(joint_axes(data, frames)[::-1], frames[5::-1], strict=True):
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = np.stack([side, np.cross(axis, side), axis], axis=1), frame[:3, 3]
        joints.insert(0, pose)
    peer = HomogeneousRobot(np.array(joints))
    return (
        list,
        lambda poses: peer.IK_batched(poses, 1),
        lambda found: sum(int(np.sum(~np.asarray(own.is_LS, dtype=bool))) for own in found),
    )


def _ssik(data: RobotData) -> Solver:
    import ssik

    peer = ssik.Manipulator.from_urdf(urdf_path(data.name), base="base_link", ee="tool0")
    peer.prepare()
    return (
        list,
        lambda poses: [peer.solve(pose) for pose in poses],
        lambda found: sum(len(own) for own in found),
    )


def timing() -> Iterator[Row]:
    """Random smooth paths of twelve joints: toppra's own retimers, and Drake's."""
    paths = [timing_bench.smooth_path(seed) for seed in range(PATHS)]
    grid = np.linspace(0.0, 1.0, GRID + 1)
    speed, strength = np.full(12, SPEED), np.full(12, STRENGTH)
    bound = np.full(GRID + 1, 100.0)
    work = f"clock of {PATHS} paths, 12 joints, grid {GRID}"

    def ours() -> list[FloatArray | None]:
        return [compute_profile(path, grid, bound, speed, strength)[0] for path in paths]

    for name in ("ParametrizeConstAccel", "ParametrizeSpline"):

        def retime(name: str = name) -> list[Any]:
            return [_retime(path(np.linspace(0.0, 1.0, 7)), grid, name) for path in paths]

        own, peer = medians(ours, retime)
        done = [trajectory for trajectory in retime() if trajectory is not None]
        fraction = max((_acceleration_ratio(trajectory) for trajectory in done), default=np.nan)
        note = f"{len(done)} timed; accelerations up to {fraction:.3f} of the bound between grid points"
        yield Row(f"{work}, with a trajectory", f"{installed_version('toppra')} {name}", own, peer, note)

    def by_drake() -> list[FloatArray | None]:
        limits = [np.min(speed / np.abs(path(grid, 1)), axis=1) for path in paths]
        return [solve_drake(p, grid, limit, strength) for p, limit in zip(paths, limits, strict=True)]

    own, peer = medians(ours, by_drake)
    done = sum(found is not None for found in by_drake())
    yield Row(work, f"{installed_version('drake')} Toppra", own, peer, f"{done} of {PATHS} timed by the peer")


def _retime(points: FloatArray, grid: FloatArray, parametrizer: str) -> Any:
    """A trajectory by toppra alone, as its tutorial does it; None where it finds none."""
    path = SplineInterpolator(np.linspace(0.0, 1.0, len(points)), points)
    bounds = np.stack([-np.ones(12), np.ones(12)], axis=1)
    held = [
        constraint.JointVelocityConstraint(SPEED * bounds),
        constraint.JointAccelerationConstraint(STRENGTH * bounds),
    ]
    solver = algorithm.TOPPRA(held, path, gridpoints=grid, parametrizer=parametrizer)
    return solver.compute_trajectory(0.0, 0.0)


def _acceleration_ratio(trajectory: Any) -> float:
    at = np.linspace(0.0, trajectory.duration, 4 * GRID + 1)
    return float(np.abs(trajectory(at, 2)).max() / STRENGTH)


def drake() -> Iterator[Row]:
    """Drake's own tools on the faces of a column capital, cut by a wire between two arms."""
    name, peer = drake_bench.WIRE_JOB, installed_version("drake")
    witness = drake_bench.plan_witness(name)
    for spin, work in ((True, "the wire, its spin free"), (False, "both poses")):
        found = drake_bench.witness_row(name, witness, spin)
        yield Row(f"Drake IK at a target, {work}", peer, None, found["median_s"], found["note"])
    for found in drake_bench.whole_path(witness):
        yield Row(found["name"], peer, None, found["median_s"], found["note"])
    found = drake_bench.kinematics()
    yield Row(found["name"], peer, found["median_s"], found["median_s"] / found["ratio"], found["note"])


def tesseract() -> Iterator[Row]:
    """Tesseract's Descartes planner on one arm along a curve."""
    missing = tesseract_bench.reason()
    for count in tesseract_bench.COUNTS:
        ours, theirs = tesseract_bench.compare(count, missing)
        work = ours["name"].removeprefix("Tandem: ")
        note = f"Tandem: {ours['note']}. Tesseract: {theirs['note']}"
        peer = (
            f"{tesseract_bench.WHEEL} {theirs['version']}" if "version" in theirs else tesseract_bench.WHEEL
        )
        yield Row(work, peer, ours.get("median_s"), theirs.get("median_s"), note)


def markdown(results: Sequence[Row], machine: str) -> str:
    """The table of the page."""
    lines = [f"Measured on: {machine}.", "", "| work | peer | ours, s | peer's, s | peer / ours | |"]
    lines.append("|---|---|---|---|---|---|")
    lines += [
        f"| {row.work} | {row.peer} | {_figure(row.ours)} | {_figure(row.theirs)} | {_figure(row.ratio)} "
        f"| {row.note.replace('|', '/')} |"
        for row in results
    ]
    return "\n".join(lines)


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def with_table(page: str, table: str) -> str:
    """A page with ``table`` between its marks; raises ``ValueError`` for a page without them."""
    head, begin, rest = page.partition(START_MARK)
    _, end, tail = rest.partition(END_MARK)
    if not begin or not end:
        raise ValueError(f"{PAGE} has no marks {START_MARK!r} ... {END_MARK!r}")
    return f"{head}{START_MARK}\n\n{table}\n\n{END_MARK}{tail}"


def main(arguments: list[str]) -> int:
    """Measure, print and, with ``--write``, write the page."""
    parser = argparse.ArgumentParser(prog="python -m bench peers", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the table into docs/benchmarks.md")
    expected = parser.parse_args(arguments)
    result = rows()
    table = Table("work", "peer", "ours, s", "peer's, s", "peer / ours", "note")
    for row in result:
        table.add_row(
            row.work, row.peer, _figure(row.ours), _figure(row.theirs), _figure(row.ratio), escape(row.note)
        )
    Console(width=180).print(table)
    if expected.write:
        facts = machine()
        system = f"{facts['cpu']}, one core, processor time; {os.confstr('CS_GNU_LIBC_VERSION')}, "
        system += f"Python {facts['python']}, {', '.join(map(installed_version, PACKAGES))}"
        PAGE.write_text(
            with_table(PAGE.read_text(encoding="utf-8"), markdown(result, system)), encoding="utf-8"
        )
    return 0
