"""Nests of the boxes of a dome's panels beside the best of all guillotine rules of rectpack, block by block.

`panel_boxes.csv`: 267 planar hexagons of a dome of 10 x 8 x 2.5 m, 200 mm thick, 10 mm oversize. Kerf 2 mm:
for rectpack it is added to boxes and once to the block. Then random boxes, more and fewer in a block.
"""

from __future__ import annotations

import csv
import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bench.peers import installed_version
from planner.geometry.nesting import BoxNest, NestBlock, NestBox, NestRules, min_blocks, nest_boxes
from planner.geometry.units import MM

KERF_MM: Final = 2.0
THICK_MM: Final = 200.0
SIZES_MM: Final = ((2400, 1200), (3000, 1250), (2500, 600), (1250, 600))
GOALS: Final = (35, 27, 33, 67)
GOAL_SHARE, GOAL_S = 1.08, 5.0
"""Ratio of blocks to the bound by areas if a block holds 7 boxes; processor time [s]."""
RANDOM: Final = 6
"""Number of sets of random boxes."""


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    return [*dome(), *at_random()]


def dome() -> Iterator[dict[str, Any]]:
    """The four kinds of blocks of the dome; boxes that fit."""
    with (Path(__file__).parent / "panel_boxes.csv").open(newline="") as file:
        sides = [(float(row["long_mm"]), float(row["short_mm"])) for row in csv.DictReader(file)]
    for size, goal in zip(SIZES_MM, GOALS, strict=True):
        subset = [side for side in sides if side[0] <= size[0] and side[1] <= size[1]]
        yield _row(f"dome, {len(subset)} boxes into {size[0]} x {size[1]}", subset, size, goal)


def at_random() -> Iterator[dict[str, Any]]:
    """Boxes of random sides, from 2 to 20 in a block."""
    for seed in range(RANDOM):
        rng = np.random.default_rng(seed)
        count, largest = 30 + 30 * seed, rng.uniform(500.0, 1200.0)
        sides = np.sort(rng.uniform(150.0, largest, (count, 2)).round(1), axis=1)[:, ::-1]
        yield _row(f"random {seed}, {count} boxes up to {largest:.0f}", sides.tolist(), (2400, 1200), None)


def _row(
    name: str, sides: Sequence[Sequence[float]], size: tuple[int, int], goal: int | None
) -> dict[str, Any]:
    boxes = [NestBox(a * MM, b * MM, THICK_MM * MM) for a, b in sides]
    block = NestBlock(size[0] * MM, size[1] * MM, THICK_MM * MM)
    start = time.process_time()
    result: BoxNest = nest_boxes(boxes, [block], NestRules(KERF_MM * MM))
    took = time.process_time() - start
    bound, count = min_blocks(boxes, block, KERF_MM * MM), len(result.blocks)
    note = f"{count} blocks, bound {bound} ({count / bound:.3f}); "
    peer: float | None = None
    try:
        start = time.process_time()
        theirs = peers_best(sides, size)
        peer = time.process_time() - start
        note += f"{installed_version('rectpack')}, best of all rules: {theirs}"
    except ImportError as error:
        note += f"rectpack skipped: {error}"
    note += f"; goal {goal}" if goal is not None else ""
    note += f"; nothing fewer: {result.optimality}" if result.optimality else ""
    return {"name": name, "median_s": took, "ratio": None if peer is None else peer / took, "note": note}


def peers_best(sides: Sequence[Sequence[float]], size: tuple[int, int]) -> int:
    """The fewest blocks of all guillotine rules, orders and choices of blocks of rectpack."""
    import rectpack
    from rectpack import guillotine

    rules = [getattr(guillotine, item) for item in dir(guillotine) if item.startswith("Guillotine")]
    rules = [
        rule for rule in rules if rule.__name__[10:13] in ("Bss", "Bls", "Baf") and len(rule.__name__) > 14
    ]
    orders = [getattr(rectpack, item) for item in dir(rectpack) if item.startswith("SORT_")]
    bins = (rectpack.PackingBin.BNF, rectpack.PackingBin.BFF, rectpack.PackingBin.BBF)
    best = len(sides)
    for rule, order, choice in itertools.product(rules, orders, bins):
        packer = rectpack.newPacker(
            mode=rectpack.PackingMode.Offline, bin_algo=choice, pack_algo=rule, sort_algo=order, rotation=True
        )
        for number, side in enumerate(sides):
            packer.add_rect(*(round(10.0 * (v + KERF_MM)) for v in side), number)
        packer.add_bin(*(round(10.0 * (v + KERF_MM)) for v in size), count=len(sides))
        packer.pack()
        if sum(len(item) for item in packer) == len(sides):
            best = min(best, len(packer))
    return best
