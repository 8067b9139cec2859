"""Division of building elements: the shells of 267 and of 2,000 planar panels, and the wavy wall.

The shells use the whole command; the wall is for the bent wire in three cases.

Shells: processor time and peak memory of a separate process, start and files included. `problems/dome_267`
is the first; the second is the same dome, enlarged so that its panels are as large. Wall: the division of
`tests/element/walls.py` from its table of misfits to its panels, compared with the best division by strips
and by lines that go through all of it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from planner.element import elastic
from planner.element.elastic_panel import find_joints
from planner.element.panel_faces import CutWire
from planner.element.surface import to_element_frame
from planner.geometry.arrays import BoolArray
from planner.geometry.units import MM
from planner.processes.hotwire.plan import wire
from tests.element.walls import ROOT, wall

DOME: Final = ROOT / "problems" / "dome_267"
GOAL_DOME_S, GOAL_DOME_MB = 6.0, 500.0
MANY, GOAL_MANY_S, GOAL_PAGE_MB = 2000, 60.0, 15.0
TOLERANCE, JOINT, OUTSIDE, THICKNESS = 1e-3, 0.2e-3, 0.16, 0.05
CASES: Final = (
    (900.0, (1000.0, 600.0, 200.0), 24, 32),
    (700.0, (600.0, 600.0, 120.0), 16, 85),
    (1400.0, (1200.0, 1200.0, 300.0), 16, 16),
)
"""Length of the wire, block [mm], cells along either side, maximum number of panels."""
GOAL_DIVISION_S, GOAL_TO_GRID = 15.0, 0.85
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    return [*shells(), *walls()]


def shells() -> Iterator[dict[str, Any]]:
    """The dome of 267 panels, and that of 2,000."""
    note = f"goals {GOAL_DOME_S:g} s, {GOAL_DOME_MB:g} MB"
    yield _command("dome, 267 panels to files, nest and page", DOME / "element.yaml", GOAL_DOME_S, note)
    spec = yaml.safe_load((DOME / "element.yaml").read_text())
    larger = float(np.sqrt(MANY / spec["panels"]["hexagons"]["count"]))
    spec["panels"]["hexagons"]["count"] = MANY
    spec["jobs"][0]["problem"] = str(DOME / spec["jobs"][0]["problem"])
    with tempfile.TemporaryDirectory() as folder:
        lines = (DOME / "dome.obj").read_text().splitlines()
        (Path(folder) / "dome.obj").write_text("".join(f"{_scaled(line, larger)}\n" for line in lines))
        file = Path(folder) / "element.yaml"
        file.write_text(yaml.safe_dump(spec))
        note = f"goals {GOAL_MANY_S:g} s, {GOAL_PAGE_MB:g} MB of page"
        yield _command(f"dome, {MANY} panels to files, nest and page", file, GOAL_MANY_S, note)


def _scaled(line: str, by: float) -> str:
    kind, *words = line.split() or [""]
    return f"v {' '.join(f'{by * float(word):.3f}' for word in words)}" if kind == "v" else line


def _command(name: str, file: Path, goal: float, goals: str) -> dict[str, Any]:
    """Run ``tandem element`` of a file in a separate process with one thread."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [sys.executable, "-m", "planner", "element", str(file), "-o", str(out)]
        child = subprocess.Popen(
            command, env={**os.environ, **dict.fromkeys(_THREADS, "1")}, stdout=subprocess.DEVNULL
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise subprocess.CalledProcessError(child.returncode, command)
        ids = [panel["id"] for panel in json.loads((out / "element.json").read_text())["panels"]]
        page = (out / "element.html").stat().st_size / 1e6
    took, peak = used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3
    note = f"{len(ids)} panels, {len(set(ids))} ids, page {page:.1f} MB, peak memory {peak:.0f} MB; {goals}"
    return {"name": name, "median_s": took, "ratio": took / goal, "peak_mb": peak, "note": note}


def walls() -> Iterator[dict[str, Any]]:
    """The wall of 4 x 3 m in the cases that were measured when this kind was thought out."""
    for length, block, cells, most in CASES:
        own = wire.make_wire("spring_steel", diameter_mm=2.0, temperature_c=300.0)
        cut = CutWire(own, length * MM, OUTSIDE, 0.05e-3, 0.6e-3)
        rules = elastic.ElasticRules((cut,), (np.array(block) * MM,), 0.0, 0.0, TOLERANCE, 100.0, JOINT)
        start = time.process_time()
        made = elastic.prepare_division(
            to_element_frame(wall(4.0, 3.0, 0.02), THICKNESS), (cells, cells), rules
        )
        panels = elastic.divide_elastic(made)
        took = time.process_time() - start
        may = np.isfinite(elastic.feasibility_table(made).best(TOLERANCE))
        steps = np.array([joint.step for joint in find_joints(panels)]) / MM
        grid, strips = through(may), min(in_strips(may), in_strips(may.transpose(1, 0, 3, 2)))
        note = (
            f"{len(panels)} panels, asked {most} at most; {strips} in strips, {grid} by lines through all "
            f"({len(panels) / grid:.2f}, asked {GOAL_TO_GRID:g}); worst misfit "
            f"{max(panel.misfit for panel in panels) / MM:.2f} mm; joints over {JOINT / MM:g} mm: "
            f"{int((steps > JOINT / MM).sum())} of {len(steps)}, the worst {steps.max():.2f}; goal "
            f"{GOAL_DIVISION_S:g} s"
        )
        name = f"wall, wire {length:g}, {cells} x {cells} cells"
        yield {"name": name, "median_s": took, "ratio": took / GOAL_DIVISION_S, "note": note}


def in_strips(may: BoolArray) -> int:
    """The fewest rectangles that ``may`` be, [w - 1, h - 1, x, y], of a grid cut into rows and each of these
    for itself."""
    nx, ny = may.shape[:2]
    row = np.full((ny + 1, ny + 1), np.inf)  # of lines y0, y1
    for low in range(ny):
        for high in range(low + 1, ny + 1):
            best = [0.0] + [np.inf] * nx
            for end in range(1, nx + 1):
                for x in range(end):
                    if may[end - x - 1, high - low - 1, x, low]:
                        best[end] = min(best[end], best[x] + 1.0)
            row[low, high] = best[nx]
    best = [0.0] + [np.inf] * ny
    for end in range(1, ny + 1):
        best[end] = min(best[low] + row[low, end] for low in range(end))
    return int(best[ny])


def through(may: BoolArray) -> int:
    """Divide by lines that all go through the whole grid.

    Branch and bound over the rows, with the columns that all rows so far allow as bits.
    """
    nx, ny = may.shape[:2]
    width = nx + 1
    allowed = {
        (low, high): sum(
            1 << (x * width + x + w + 1)
            for w in range(nx)
            for x in range(nx - w)
            if may[w, high - low - 1, x, low]
        )
        for low in range(ny)
        for high in range(low + 1, ny + 1)
    }

    def columns(bits: int) -> float:
        best = [0.0] + [np.inf] * nx
        for end in range(1, nx + 1):
            for x in range(end):
                if bits >> (x * width + end) & 1:
                    best[end] = min(best[end], best[x] + 1.0)
        return best[nx]

    minimum = float(nx * ny)
    todo = [(0, 0, -1)]  # line, rows so far, columns that they allow
    known: dict[int, float] = {}
    while todo:
        low, rows, bits = todo.pop()
        count = known.setdefault(bits, columns(bits))
        if low == ny:
            minimum = min(minimum, rows * count)
        elif (rows + 1) * count < minimum:
            todo += [(high, rows + 1, bits & allowed[low, high]) for high in range(low + 1, ny + 1)]
    return int(minimum)
