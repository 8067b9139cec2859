"""G-code: reading a million lines, compared with a plain loop, and 100,000 lines planned and proven.

The planned lines are a smooth face, which needs few targets, and fine waves at a tight tolerance, which are
all targets.
"""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from bench.proc import run_plan
from planner.processes.milling.plan.gcode import reader
from planner.processes.milling.plan.operation import GCodeFile

LINES = 1_000_000
PLANNED = 332
"""Lines of the raster that is planned, each of 301 places: 100,000 lines of the file."""
GOAL_S, GOAL_MB = 150.0, 1500.0
"""Target wall time [s] of the whole command on two cores, and peak memory [MB] of its larger process."""
END = "G0 Z30\nM5\nM30\n"
PROBLEM = """\
tandem: 1
name: gcode_100k
cell: {cell}
stock:
  size_mm: [320, 240, 80]
  place: {{xyz_mm: [1500, 0, 900]}}
  support: pedestal
settings: {{clearance_mm: 8}}
operations:
  - name: panel
    process: milling
    arms: [robot]
    shape_tol_mm: {tolerance}
    cuts:
      - {{gcode: {{file: job.nc, origin: {{xyz_mm: [0, 0, 80]}}, tool_axis: ijk}}}}
"""


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        return [
            _read(Path(folder) / "million.nc"),
            _plan(Path(folder), "100,000 lines planned", raster(PLANNED), 0.1),
            _plan(Path(folder), "100,000 targets planned", raster(PLANNED, 1.0, 4.0), 0.01),
        ]


def raster(rows: int, height: float = 3.0, wave: float = 25.0) -> list[str]:
    """Return lines of a zigzag over a wavy face, the tool along its normals, points 1 mm apart.

    The waves are ``height`` [mm] high and 2 pi ``wave`` [mm] long.
    """
    across = np.linspace(-150.0, 150.0, 301)
    out = []
    for number, y in enumerate(np.linspace(-110.0, 110.0, rows)):
        x = across if number % 2 == 0 else across[::-1]
        z = -5.0 + height * np.sin(x / wave) * np.sin(y / 25.0)
        slope = [
            -height / wave * np.cos(x / wave) * np.sin(y / 25.0),
            -height / 25.0 * np.sin(x / wave) * np.cos(y / 25.0),
            np.ones_like(x),
        ]
        normal = np.stack(slope, axis=1) / np.linalg.norm(slope, axis=0)[:, None]
        for place, (i, j, k) in zip(zip(x, z, strict=True), normal, strict=True):
            out.append(f"X{place[0]:.3f}Y{y:.3f}Z{place[1]:.3f}I{i:.6f}J{j:.6f}K{k:.6f}")
    return out


def program(lines: list[str]) -> str:
    """A whole file of these places."""
    head = ["G21 G90 G94 G17", "S12000 M3 F3000", "G0 X-150 Y-110 Z20 I0 J0 K1", f"G1 {lines[0]}"]
    return "\n".join([*head, *lines[1:], END])


def _read(path: Path) -> dict[str, Any]:
    lines = raster(PLANNED)
    with path.open("w") as stream:  # piece by piece: what writing takes must not hide what reading takes
        stream.write(program(lines).removesuffix(END))
        for _ in range(LINES // len(lines)):
            stream.write("\n".join([*lines, ""]))
        stream.write(END)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.perf_counter()
    spec = GCodeFile.model_validate({"file": path, "origin": {}, "tool_axis": "ijk"})
    count = sum(len(block.path) for block in reader.read_blocks(spec.dialect("gcode")))
    span = time.perf_counter() - start
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
    start = time.perf_counter()
    with path.open() as stream:
        for line in stream:
            line.split("X")
    peer = time.perf_counter() - start
    note = (
        f"{count} moves, {count / span:.0f} lines/s, {grown:.0f} MB more; peer: a loop that splits each line"
    )
    return {"name": "G-code, a million lines", "median_s": span, "ratio": span / peer, "note": note}


def _plan(folder: Path, name: str, lines: list[str], tolerance: float) -> dict[str, Any]:
    (folder / "job.nc").write_text(program(lines))
    cell = Path(__file__).parent.parent / "problems" / "cells" / "irb6640_mill.yaml"
    (folder / "problem.yaml").write_text(PROBLEM.format(cell=cell, tolerance=tolerance))
    ran = run_plan(folder / "problem.yaml", folder / "out")
    count = [line for line in ran.output.splitlines() if "targets" in line]
    told = f"{ran.note}; {count[-1] if count else 'no plan'}; "
    told += f"ratio is to the goal of {GOAL_S:g} s, {GOAL_MB:g} MB"
    return {
        "name": f"G-code, {name}",
        "median_s": ran.wall,
        "ratio": ran.wall / GOAL_S,
        "note": f"{told} are wanted",
    }
