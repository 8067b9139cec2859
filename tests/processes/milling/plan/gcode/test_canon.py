"""Both readers, the planner's and the proof's, against LinuxCNC's interpreter of RS274/NGC.

``canon_program.txt`` is what ``rs274 -g canon_program.nc`` of LinuxCNC 2.9.0 (Debian package linuxcnc-uspace)
printed: canonical machine commands, which name ends, centres and turns of arcs. Where ``rs274`` is on the
path, it is run as well, on this program and on random ones.
"""

from __future__ import annotations

import dataclasses
import math
import random
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from planner.processes.milling.plan.job import program_file
from planner.processes.milling.plan.tool_path import ToolPath
from planner.processes.milling.proof import gcode_moves
from tests.processes.milling.plan.gcode.gcode_programs import read, spec

FOLDER = Path(__file__).parent
COMMAND = re.compile(r"^\s*\d+\s+N\S*\s+([A-Z_0-9]+)\((.*)\)\s*$")
STATED = {"tool_axis": "rotary", "convention": "head_ca"}


@dataclasses.dataclass
class Move:
    """One canonical move: its end X Y Z [mm], its feed [mm/min], infinite for traverses, and for arcs centre,
    turns and plane."""

    end: tuple[float, float, float]
    feed: float
    spindle: float
    arc: tuple[float, float, int, int] | None = None


def canonical(text: str) -> list[Move]:
    """The moves of the interpreter's output. Lengths are in the units in use, feeds likewise."""
    moves: list[Move] = []
    unit, plane, feed, speed, way, per_turn = 1.0, 2, 0.0, 0.0, 0, False
    for line in text.splitlines():
        met = COMMAND.match(line)
        if met is None:
            continue
        name, arguments = met[1], met[2].replace(",", " ").split()
        if name == "USE_LENGTH_UNITS":
            unit = 25.4 if "INCHES" in arguments[0] else 1.0
        elif name == "SELECT_PLANE":
            plane = {"XY": 2, "XZ": 1, "YZ": 0}[arguments[0].removeprefix("CANON_PLANE_")]
        elif name == "SET_FEED_RATE":
            feed = float(arguments[0]) * unit
        elif name == "SET_FEED_MODE":
            per_turn = int(arguments[1]) == 1
        elif name == "SET_SPINDLE_SPEED":
            speed = float(arguments[1])
        elif name.startswith("START_SPINDLE"):
            way = -1 if "COUNTER" in name else 1
        elif name == "STOP_SPINDLE_TURNING":
            way = 0
        elif name in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"):
            values = [float(value) for value in arguments]
            real = math.inf if name == "STRAIGHT_TRAVERSE" else feed * (speed if per_turn else 1.0)
            if name != "ARC_FEED":
                end = (values[0] * unit, values[1] * unit, values[2] * unit)
                moves.append(Move(end, real, way * speed))
                continue
            first, second, normal = (plane + 1) % 3, (plane + 2) % 3, plane
            end_of = {first: values[0] * unit, second: values[1] * unit, normal: values[5] * unit}
            arc = (values[2] * unit, values[3] * unit, int(values[4]), plane)
            moves.append(Move((end_of[0], end_of[1], end_of[2]), real, way * speed, arc))
    return moves


def first_reader(tmp_path: Path, program: str) -> ToolPath:
    return read(tmp_path, program, **STATED).path


def second_reader(tmp_path: Path, program: str) -> ToolPath:
    """Return the path of the proof's own reader, in the form of the first one."""
    stated = program_file(spec(tmp_path, program, **STATED))
    way = gcode_moves.read_path(stated, stated.chord_tol_mm * 1e-3)
    kind = tuple("cut" if cuts else "rapid" for cuts in way.cuts.tolist())
    spindle, tool = way.spindle * np.pi / 30.0, np.zeros_like(way.line)
    return ToolPath(way.tip, way.axis, way.feed, kind, spindle, tool, way.line)


READERS = pytest.mark.parametrize("reader", [first_reader, second_reader], ids=["planner", "proof"])
Reader = Callable[[Path, str], ToolPath]


def compare(reader: Reader, tmp_path: Path, program: str, output: str, tolerance: float) -> int:
    """Hold a reader's rows against canonical moves, within what the output's decimals say; moves seen."""
    path = reader(tmp_path, program)
    moves = canonical(output)
    row, before = 0, np.zeros(3)
    for move in moves:
        end = row
        line = path.line[row]
        while end + 1 < len(path) and path.line[end + 1] == line:
            end += 1
        tip = path.tip[row : end + 1] * 1e3
        np.testing.assert_allclose(tip[-1], move.end, atol=tolerance)
        np.testing.assert_allclose(path.spindle[end] * 30 / np.pi, move.spindle, atol=1e-3)
        assert (path.kind[end] == "rapid") == math.isinf(move.feed)
        if not math.isinf(move.feed) and row > 0:
            np.testing.assert_allclose(path.feed[end] * 60e3, move.feed, rtol=2e-3)
        if move.arc is not None:
            first, second, turns, normal = move.arc
            a, b = (normal + 1) % 3, (normal + 2) % 3
            points = np.vstack([before, tip])
            radius = np.hypot(points[:, a] - first, points[:, b] - second)
            np.testing.assert_allclose(radius, radius[0], atol=0.02 + tolerance)
            angle = np.unwrap(np.arctan2(points[:, b] - second, points[:, a] - first))
            assert np.sign(angle[-1] - angle[0]) == np.sign(turns)
            assert (abs(turns) - 1) * 2 * np.pi - 1e-6 <= abs(angle[-1] - angle[0]) <= 2 * np.pi + 1e-6
        before, row = tip[-1], end + 1
    assert row == len(path)
    return len(moves)


def rs274(folder: Path, program: str) -> str:
    """The output of LinuxCNC's interpreter for a program; skips the test where it is not installed."""
    command = shutil.which("rs274")
    if command is None:
        pytest.skip("rs274 of LinuxCNC is not on the path (Debian: apt-get install linuxcnc-uspace)")
    (folder / "own.nc").write_text(program)
    (folder / "own.var").write_text("")
    (folder / "own.tbl").write_text("T1 P1 Z0 D1\n")
    done = subprocess.run(
        [command, "-g", "-v", "own.var", "-t", "own.tbl", "own.nc"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@READERS
def test_the_program_is_read_as_linuxcnc_did(reader: Reader, tmp_path: Path) -> None:
    program = (FOLDER / "canon_program.nc").read_text()
    assert compare(reader, tmp_path, program, (FOLDER / "canon_program.txt").read_text(), 6e-5 * 25.4) == 32


@READERS
def test_the_program_is_read_as_linuxcnc_does(reader: Reader, tmp_path: Path) -> None:
    program = (FOLDER / "canon_program.nc").read_text()
    assert compare(reader, tmp_path, program, rs274(tmp_path, program), 6e-5 * 25.4) == 32


def random_program(seed: int) -> str:
    """Return straight moves and arcs in all planes, in both units and both distance modes."""
    own = random.Random(seed)
    lines = ["G21 G90 G17 G94 G91.1", "S1000 M3", "F600", "G0 X0 Y0 Z0"]
    for _ in range(60):
        plane = own.choice([("G17", "XYZ", "IJ"), ("G18", "ZXY", "KI"), ("G19", "YZX", "JK")])
        kind = own.random()
        if kind < 0.4:
            axes = own.sample("XYZ", own.randint(1, 3))
            words = " ".join(f"{axis}{own.uniform(-50, 50):.3f}" for axis in axes)
            lines.append(f"{own.choice(['G0', 'G1', 'G1'])} {words}")
        elif kind < 0.6:
            lines.append(own.choice(["G90", "G91", "G20", "G21", f"F{own.uniform(10, 900):.1f}"]))
        elif kind < 0.85:
            # by centre, in G91 so that the end is known whatever came before
            radius, begin, turn = own.uniform(1, 30), own.uniform(-3, 3), own.uniform(0.2, 6.0)
            way = own.choice([-1, 1])
            code, axes, centre = plane
            first = (-radius * math.cos(begin), -radius * math.sin(begin))
            last = begin + way * turn
            step = (first[0] + radius * math.cos(last), first[1] + radius * math.sin(last))
            lines.append(
                f"{code} G91 G{2 if way < 0 else 3} {axes[0]}{step[0]:.5f} {axes[1]}{step[1]:.5f} "
                f"{axes[2]}{own.uniform(-5, 5):.3f} {centre[0]}{first[0]:.5f} {centre[1]}{first[1]:.5f}"
            )
        else:
            code, axes, _ = plane
            radius, turn = own.uniform(1, 30), own.uniform(0.3, 2.8)
            chord, angle = 2 * radius * math.sin(turn / 2), own.uniform(-3, 3)
            lines.append(
                f"{code} G91 {own.choice(['G2', 'G3'])} {axes[0]}{chord * math.cos(angle):.5f} "
                f"{axes[1]}{chord * math.sin(angle):.5f} R{own.choice([1, -1]) * radius:.5f}"
            )
    return "\n".join([*lines, "M2", ""])


@READERS
@pytest.mark.parametrize("seed", range(20))
def test_random_programs_are_read_as_linuxcnc_does(reader: Reader, tmp_path: Path, seed: int) -> None:
    program = random_program(seed)
    assert compare(reader, tmp_path, program, rs274(tmp_path, program), 6e-5 * 25.4) > 20
