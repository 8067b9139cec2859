"""Random programs against a plain evaluator.

The result does not depend on block size or on the points where the file is split. A million lines take
bounded memory.
"""

from __future__ import annotations

import math
import random
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.processes.milling.plan.gcode import reader
from tests.processes.milling.plan.gcode.gcode_programs import HEAD, spec
from tests.processes.milling.plan.gcode.plain_evaluator import evaluate

START = HEAD + "G0 X0 Y0 Z0 I0 J0 K1\n"


def program(seed: int, size: int, regular: float) -> str:
    """A random program; the share ``regular`` of its lines has words in the usual order."""
    own = random.Random(seed)
    lines = []
    for i in range(size):
        words = []
        if own.random() < 0.5:
            words.append(f"N{i}")
        if own.random() < 0.2:
            words.append(own.choice(["G0", "G1", "G01", "G00"]))
        words += [axis + number(own) for axis in "XYZ" if own.random() < 0.5]
        if own.random() < 0.4:
            angle, tilt = own.uniform(-3, 3), own.uniform(0, 1.5)
            vector = (math.sin(tilt) * math.cos(angle), math.sin(tilt) * math.sin(angle), math.cos(tilt))
            words += [f"{word}{value:.6f}" for word, value in zip("IJK", vector, strict=True)]
        if own.random() < 0.1:
            words.append(f"F{own.uniform(1, 9000):.2f}")
        if own.random() > regular:
            own.shuffle(words)
            words = [word.lower() if own.random() < 0.3 else word for word in words]
            if own.random() < 0.3:
                words.insert(own.randint(0, len(words)), "(a; b X9)")
            if own.random() < 0.2:
                words.append(own.choice(["G90", "G91", "G20", "G21", "; X1 ("]))
        lines.append(own.choice(["", " ", "\t"]).join(words))
    return "\n".join(lines) + own.choice(["", "\n"])


def number(rng: random.Random) -> str:
    """Return a coordinate in a random notation."""
    value = rng.uniform(-200, 200)
    kind = rng.randint(0, 5)
    if kind == 0:
        return f"{int(value)}"
    if kind == 1:
        return f"{int(value)}."
    if kind == 2:
        return f"{'-' if value < 0 else ''}.{abs(int(value))}"
    if kind == 3:
        return f"{value:+.4f}"
    return f"{value:.3f}"


def rows(text: str) -> np.ndarray:
    """The program as read, as rows like those of the plain evaluator; rapid feeds are -1."""
    with tempfile.TemporaryDirectory() as folder:
        path = reader.read_gcode(spec(Path(folder), text, tool_axis="ijk").dialect("gcode")).path
    feed = np.where(np.isfinite(path.feed), path.feed * 60e3, -1.0)
    assert [kind == "rapid" for kind in path.kind] == (feed < 0).tolist()
    return np.column_stack([path.tip * 1e3, path.axis, feed, path.line])


def plain(text: str) -> np.ndarray:
    """The same from the plain evaluator."""
    return np.array([[-1.0 if value is None else value for value in move] for move in evaluate(text).moves])


@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 10**9), size=st.integers(1, 120), regular=st.sampled_from([0.0, 0.9, 1.0]))
def test_random_programs_are_read_as_by_a_plain_evaluator(seed: int, size: int, regular: float) -> None:
    text = START + program(seed, size, regular)
    np.testing.assert_allclose(rows(text), plain(text), atol=1e-7, rtol=1e-9)


@pytest.mark.parametrize("chunk", [40, 97, 1000])
def test_it_does_not_matter_where_a_file_is_parted(monkeypatch: pytest.MonkeyPatch, chunk: int) -> None:
    text = START + program(5, 400, 0.95)
    whole = rows(text)
    monkeypatch.setattr(reader, "READ_SIZE", chunk)
    np.testing.assert_array_equal(rows(text), whole)


def test_stretches_are_read_as_their_lines_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    text = START + program(6, 600, 1.0)
    stretched = rows(text)
    monkeypatch.setattr(reader, "allows_regular", lambda modal, dialect: False)
    np.testing.assert_allclose(rows(text), stretched, atol=1e-9)


def test_faults_in_stretches_are_those_of_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = "G21 G90 G94 G0 X0 Y0 Z0\n" + "G1 X1\nX2\nF0\nX3\n" * 20

    def issues() -> list[tuple[str, str | None, int | None, int, str]]:
        faults = reader.LineFaults(tmp_path / "job.nc")
        with pytest.raises(reader.TandemError):
            list(reader.read_blocks(spec(tmp_path, text).dialect("gcode"), faults))
        return sorted((i.code, i.field, i.line, i.count, i.message.split(" [")[0]) for i in faults.issues())

    stretched = issues()
    monkeypatch.setattr(reader, "allows_regular", lambda modal, dialect: False)
    one_by_one = issues()
    # of F0 and of a cut without feed, both field F, each way of reading tells the one that it meets first
    assert [i[:2] for i in stretched] == [i[:2] for i in one_by_one]
    assert stretched[1] == one_by_one[1]


STREAM = """
import resource, sys
from pathlib import Path
from planner.processes.milling.plan.gcode import reader
from planner.processes.milling.plan.operation import GCodeFile
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
spec = GCodeFile(file=Path(sys.argv[1]), origin={}, tool_axis="ijk")
count = sum(len(block.path) for block in reader.read_blocks(spec.dialect("gcode")))
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def stream(path: Path, lines: int) -> tuple[int, float]:
    """Return the moves read from a file of the given lines, and the memory [MB] that reading took."""
    with path.open("w") as out:
        out.write(START)
        for i in range(lines):
            out.write(
                f"N{i}X{i % 977 * 0.1:.3f}Y{i % 461 * 0.2:.3f}Z-1.500I0.60000000J0.00000000K0.80000000\n"
            )
    done = subprocess.run(
        [sys.executable, "-c", STREAM, str(path)], capture_output=True, text=True, check=True
    )
    count, kilobytes = done.stdout.split()
    return int(count), float(kilobytes) / 1024.0


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    count, megabytes = stream(tmp_path / "job.nc", 60_000)
    assert count == 60_001
    assert megabytes < 120.0


@pytest.mark.long
def test_a_million_lines_stream(tmp_path: Path) -> None:
    count, megabytes = stream(tmp_path / "job.nc", 1_000_000)
    assert count == 1_000_001
    assert megabytes < 120.0
