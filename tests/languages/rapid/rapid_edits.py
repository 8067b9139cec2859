"""RAPID texts of ``small_job`` as rows, moves and fields, read and edited."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from tests.proof.registry import Texts, pick

TASKS = (1, 2)
MOVE = re.compile(
    r"MoveL \[\[(?P<pos>[^\]]*)\],\[(?P<orient>[^\]]*)\],\[(?P<conf>[^\]]*)\],\[(?P<ext>[^\]]*)\]\]"
    r"\\ID:=(?P<id>\d+),"
    r"(?P<speed>\w+)\\T:=(?P<time>[\d.]+),(?P<zone>\w+),(?P<tool>\w+)\\WObj:=(?P<wobj>\w+);"
)


def name(kind: str, task: int) -> str:
    """File name of a module."""
    return f"T_ROB{task}/Tandem{kind}_{task}.mod"


def edit(texts: Texts, file: str, old: str, new: str, count: int = 1) -> Texts:
    """Texts with ``old`` replaced; raises when it is not there."""
    assert old in texts[file], (file, old)
    return {**texts, file: texts[file].replace(old, new, count)}


def lines(texts: Texts, task: int, kind: str = "Cut1") -> list[str]:
    return texts[name(kind, task)].split("\n")


def put(texts: Texts, task: int, rows: list[str], kind: str = "Cut1") -> Texts:
    return {**texts, name(kind, task): "\n".join(rows)}


def moves(texts: Texts, task: int) -> list[int]:
    """Rows of the moves of the cut module."""
    return [i for i, row in enumerate(lines(texts, task)) if "MoveL" in row]


def segment(texts: Texts, proc: str, task: int = 1) -> list[int]:
    """Indices among the moves that belong to a procedure."""
    rows = lines(texts, task)
    out, here, k = [], "", 0
    for row in rows:
        found = re.search(r"PROC (\w+)", row)
        here = found.group(1) if found else here
        if "MoveL" in row:
            if here == proc:
                out.append(k)
            k += 1
    return out


def change(texts: Texts, task: int, k: int, **fields: str) -> Texts:
    """Texts with fields of move ``k`` of a task changed."""
    rows = lines(texts, task)
    i = moves(texts, task)[k]
    found = MOVE.search(rows[i])
    assert found is not None
    parts = {**found.groupdict(), **fields}
    rows[i] = (
        f"    MoveL [[{parts['pos']}],[{parts['orient']}],[{parts['conf']}],[{parts['ext']}]]"
        f"\\ID:={parts['id']},"
        f"{parts['speed']}\\T:={parts['time']},{parts['zone']},{parts['tool']}\\WObj:={parts['wobj']};"
    )
    return put(texts, task, rows)


def field(texts: Texts, task: int, k: int, which: str) -> str:
    found = MOVE.search(lines(texts, task)[moves(texts, task)[k]])
    assert found is not None
    return found.group(which)


def both(texts: Texts, k: int, function: Callable[[Texts, int, int], Texts]) -> Texts:
    for task in TASKS:
        texts = function(texts, task, k)
    return texts


def shifted(texts: Texts, task: int, k: int, by) -> Texts:
    position = np.array([float(v) for v in field(texts, task, k, "pos").split(",")]) + by
    return change(texts, task, k, pos=",".join(f"{v:.4f}" for v in position + 0.0))


def tilted(texts: Texts, task: int, k: int, degrees: float) -> Texts:
    """Rotate a tool about its own x axis at one target."""
    w, x, y, z = (float(v) for v in field(texts, task, k, "orient").split(","))
    c, s = np.cos(0.5 * np.deg2rad(degrees)), np.sin(0.5 * np.deg2rad(degrees))
    turned = np.array([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])
    return change(texts, task, k, orient=",".join(f"{v:.8f}" for v in turned + 0.0))


def timed(texts: Texts, k: int, factor: float) -> Texts:
    """Both moves' times scaled, with a speed that fits."""
    time = float(field(texts, 1, k, "time")) * factor
    return both(texts, k, lambda t, task, i: change(t, task, i, time=f"{time:.5f}", speed="v7000"))


def random_task(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 3))


def cutting(rng: np.random.Generator, texts: Texts) -> int:
    """A move that is well inside the block."""
    inside = segment(texts, pick(rng, ["cut_front", "cut_back"]))
    return pick(rng, [k for k in inside if abs(float(field(texts, 1, k, "pos").split(",")[1])) < 32.0])
