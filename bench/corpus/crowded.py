"""Cells with more in them than the robots: cabinets, columns, fences; and bodies that are truly in the way.

Feasible by: the job is one of another family, and every body stands farther from each base than the arm
with its tool reaches. With a fault a box stands in the block itself, where the tool has to go.
"""

from __future__ import annotations

import math
from typing import Final

from bench.corpus import elastic, milling, posed, wings
from bench.corpus.job import Draft, Draw, Fault

BASE_YAWS: Final = {
    # [mm] what the arm reaches with a tool of this corpus, at most
    "irb140": 1500.0,
    "irb1200_7_70": 1400.0,
    "irb4600_40": 3600.0,
    "irb6640_185": 3900.0,
    "kr60_ha": 3100.0,
}
KINDS: Final = (wings.base, elastic.base, posed.base, milling.flank)


def base(draw: Draw) -> Draft:
    """Add bodies around a job that block no arm."""
    draft = KINDS[draw.index % len(KINDS)](draw)
    arms = draft.cell["arms"]
    bases = [(arm["base"]["xyz_mm"], BASE_YAWS[arm["robot"]]) for arm in arms]
    for k in range(draw.whole(1, 4)):
        size = [draw.number(200, 800, 0), draw.number(200, 800, 0), draw.number(600, 2200, 0)]
        half = math.hypot(*size[:2]) / 2
        turn = math.radians(draw.number(0, 360, 0))
        far = 0.0
        for (x, y, _), reach in bases:
            # along a ray from the origin, beyond this arm's circle
            along = x * math.cos(turn) + y * math.sin(turn)
            across = x * math.sin(turn) - y * math.cos(turn)
            far = max(far, along + math.sqrt(max((reach + half) ** 2 - across**2, 0.0)))
        far += draw.number(50, 400, 0)
        pose = {"xyz_mm": [far * math.cos(turn), far * math.sin(turn), size[2] / 2]}
        shape = {"kind": draw.pick(["box", "box", "cylinder"]), "pose": pose}
        shape |= (
            {"size_mm": size} if shape["kind"] == "box" else {"radius_mm": size[0] / 2, "length_mm": size[2]}
        )
        name = f"{draw.pick(['cabinet', 'column', 'fence'])}_{k}"
        draft.cell["obstacles"].append({"name": name, "shapes": [shape]})
    draft.why += "; bodies around it stand beyond the arms' reach"
    return draft


def _inside(draft: Draft, draw: Draw) -> None:
    """Add a box through the middle of the block, 80 mm higher than it; the planner may not cut it."""
    stock, arms = draft.problem["stock"], draft.cell["arms"]
    if not isinstance(stock["place"], dict):
        if len(arms) == 2:
            at = [0.0, 0.0, 500.0]
        else:
            small = arms[0]["robot"].startswith(("irb140", "irb1200"))
            at = [470.0, 0.0, 350.0] if small else [1300.0, 0.0, 800.0]
        stock["place"] = {"xyz_mm": at}
        stock.pop("roll_pitch_deg", None)
    x, y, z = stock["place"]["xyz_mm"]
    high = stock["size_mm"][2]
    size = [0.5 * stock["size_mm"][0], 0.5 * stock["size_mm"][1], high + 160.0]
    shape = {"kind": "box", "size_mm": size, "pose": {"xyz_mm": [x, y, z + high / 2]}}
    draft.cell["obstacles"].append({"name": "crate", "shapes": [shape]})


def _home(draft: Draft, draw: Draw) -> None:
    """A box around the first arm's base and all of its links."""
    x, y, _ = draft.cell["arms"][0]["base"]["xyz_mm"]
    shape = {"kind": "box", "size_mm": [2500, 2500, 900], "pose": {"xyz_mm": [x, y, 1000]}}
    draft.cell["obstacles"].append({"name": "crate", "shapes": [shape]})


FAULTS: Final = [
    Fault("a crate stands where the block is", ("motion.overlap",), _inside),
    Fault("a crate stands where the arm is at home", ("motion.home", "motion.collision"), _home),
]
