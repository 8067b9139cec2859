"""Wings: any two airfoils, with sweep, dihedral and twist, by a bow on one arm.

Feasible by: chords within 1 to 0.64 of one another, so that the slower end's slot stays below 3 mm where the
faster one's is at most 1.6 mm; a blunt edge opposite a sharp one at most 1 mm thick, for the same reason; a
wire 60 mm longer than the block is wide; a block with 14 mm of foam around the panel.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from bench.corpus import airfoils, cells, foams
from bench.corpus.job import Draft, Draw, Fault
from planner.geometry.arrays import FloatArray

ROUND: Final = 14.0
"""Foam [mm] around the panel on each side."""


def _section(draw: Draw, kind: str) -> tuple[FloatArray, float]:
    """An airfoil's points and the thickness of its trailing edge, over the chord."""
    if kind == "blunt":
        edge = 0.004
        return airfoils.blunt(draw.number(0.09, 0.14, 3), edge, draw.whole(25, 60)), edge
    if kind == "sharp":
        angle = draw.pick([8.0, 12.0, 16.0])
        camber = draw.number(0.0, 0.06, 3)
        return airfoils.karman_trefftz(draw.number(0.07, 0.10, 3), camber, angle, draw.whole(30, 80)), 0.0
    if kind == "thick":
        return airfoils.naca_four_digits(
            0.02, 0.4, draw.number(0.18, 0.22, 3), draw.whole(30, 60), False
        ), 0.0042
    if kind == "reflexed":
        return airfoils.reflexed(
            draw.number(0.09, 0.12, 3), draw.number(0.03, 0.06, 3), draw.whole(30, 60)
        ), 0.0
    if kind == "flat":
        return airfoils.flat_bottom(draw.number(0.10, 0.13, 3), draw.whole(30, 50)), 0.0
    return airfoils.naca_four_digits(
        draw.number(0.01, 0.04, 3), 0.4, draw.number(0.10, 0.13, 3), 13, True
    ), 0.0


KINDS: Final = ("blunt", "sharp", "thick", "reflexed", "coarse", "flat")
PAIRS: Final = [(one, other) for one in KINDS for other in KINDS]


def base(draw: Draw) -> Draft:
    """A wing without fault."""
    small = draw.chance(0.4)
    cell, wire = cells.bow_cell(draw, small)
    span = draw.number(200, 280, 0) if small else draw.number(380, 540, 0)
    root = draw.number(120, 160, 0) if small else draw.number(160, 240, 0)
    tip = round(root * draw.number(0.66, 1.0, 2))
    kinds = PAIRS[(7 * draw.index) % len(PAIRS)]
    sweep, twist = draw.number(-10, 15), draw.number(-3, 4)
    dihedral = draw.pick([0, 0, draw.number(0, 5), draw.number(-2, 5)])
    files, specs, boxes, edges = {}, [], [], []
    for kind, chord in zip(kinds, (root, tip), strict=True):
        points, edge = _section(draw, kind)
        file = f"{('root', 'tip')[len(specs)]}_{kind}.dat"
        files[file] = airfoils.selig(kind, points)
        specs.append({"file": file, "chord_mm": chord})
        boxes.append(chord * points)
        edges.append(edge * chord)
    if draw.chance(0.3):
        specs[0] = {"naca": draw.pick(["2412", "0012", "4415", "23112"]), "chord_mm": root}
        boxes[0] = root * airfoils.naca_four_digits(0.04, 0.4, 0.15, 20, False)
        del files[f"root_{kinds[0]}.dat"]
        edges[0] = 0.0025 * root
    wing = {"root": specs[0], "tip": specs[1], "span_mm": span}
    wing |= {"sweep_deg": sweep, "twist_deg": twist, "dihedral_deg": dihedral}
    if draw.chance(0.4) or abs(edges[0] - edges[1]) > 0.9:
        wing["trailing_edge_mm"] = round(max(*edges, 0.8), 1)
    size = _size(boxes, root, tip, span, sweep, dihedral, twist)
    problem = {
        "stock": {
            "size_mm": size,
            "place": "auto",
            "support": cells.stand(0.4 * size[0], 0.5 * size[1], 1500),
        },
        "part": {"wing": wing},
        "operations": [
            {
                "name": "wing",
                "process": "straight_wire",
                "arms": ["robot"],
                "shape_tol_mm": draw.pick([0.3, 0.4, 0.5]),
                **({"step_mm": draw.pick([1.5, 2, 3])} if draw.chance(0.6) else {}),
            }
        ],
    }
    why = f"a {kinds[0]} root to a {kinds[1]} tip: slots of both ends within 0.8 to 3 mm, foam all around"
    draft = Draft(problem, cell, files, {"span": span}, why)
    foams.settle(draft, draw, wire, (1.1, 1.4))
    return draft


def _size(
    boxes: list[FloatArray], root: float, tip: float, span: float, sweep: float, dihedral: float, twist: float
) -> list[float]:
    """The block's size for a panel: its own extent and foam around it; along the span 10 mm more."""
    turn = math.radians(twist)
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    shift = 0.25 * (root - tip) + span * math.tan(math.radians(sweep))
    quarter = np.array([0.25 * tip, 0.0])
    moved = quarter + np.array([shift, span * math.tan(math.radians(dihedral))])
    far = (boxes[1] - quarter) @ turned + moved
    both = np.concatenate([boxes[0], far])
    extent = both.max(axis=0) - both.min(axis=0) + 2.0 * ROUND
    return [float(np.ceil(extent[0] / 5) * 5), span + 10.0, float(np.ceil(extent[1] / 5) * 5)]


def _small(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"]["size_mm"][2] = 16.0


def _long(draft: Draft, draw: Draw) -> None:
    span = draft.facts["wire"] + draw.number(10, 60, 0)
    draft.problem["part"]["wing"]["span_mm"] = span
    size = draft.problem["stock"]["size_mm"]
    size[0], size[1], size[2] = size[0] + 160, span + 10, size[2] + 60


def _file(points: FloatArray, name: str) -> Fault:
    codes = {"order": "part.airfoil_order", "open": "part.airfoil_open", "few": "part.airfoil_points"}

    def spoil(draft: Draft, draw: Draw) -> None:
        draft.files[f"{name}.dat"] = airfoils.selig(name, points)
        draft.problem["part"]["wing"]["tip"]["file"] = f"{name}.dat"
        draft.problem["part"]["wing"]["tip"].pop("naca", None)

    return Fault(f"the tip's airfoil file is wrong: {name}", (codes[name],), spoil)


def _walls(draft: Draft, draw: Draw) -> None:
    """Add walls 5 mm beside both ends of the rulings, where the wire's ends and clamps have to be."""
    size = draft.problem["stock"]["size_mm"]
    reach = 470 if draft.facts["wire"] == 400 else 1300
    height = 450 if reach == 470 else 900
    draft.problem["stock"]["place"] = {"xyz_mm": [reach, 0, height]}
    for name, side in (("wall_left", -1), ("wall_right", 1)):
        shape = {"kind": "box", "size_mm": [4 * size[0], 20, 2 * height + 2000]}
        shape["pose"] = {"xyz_mm": [reach, side * (size[1] / 2 + 15), 0]}
        draft.cell["obstacles"].append({"name": name, "shapes": [shape]})


def _steep_taper(draft: Draft, draw: Draw) -> None:
    """The tip goes at a fifth of the root's speed: its slot is 5 (k + c) - c, over 5 mm in all foams."""
    wing = draft.problem["part"]["wing"]
    wing["tip"]["chord_mm"] = round(0.2 * wing["root"]["chord_mm"])
    draft.operation["feed_min_mm_s"] = round(0.9 * draft.operation["feed_mm_s"], 1)


def _missing(draft: Draft, draw: Draw) -> None:
    wing = draft.problem["part"]["wing"]
    wing["tip"] = {"file": "not_there.dat", "chord_mm": wing["tip"]["chord_mm"]}


def _key(draft: Draft, draw: Draw) -> None:
    draft.problem["part"]["wing"]["washout_deg"] = 2


def _cuts(draft: Draft, draw: Draw) -> None:
    draft.operation["cuts"] = [{"surface": "upper"}]


def _arm(draft: Draft, draw: Draw) -> None:
    draft.operation["arms"] = ["right"]


_GOOD: Final = airfoils.naca_four_digits(0.02, 0.4, 0.12, 30, True)
FAULTS: Final = [
    Fault("the block is 16 mm high, thinner than the panel", ("part.stock_too_small",), _small),
    foams.TOO_HOT,
    Fault("the panel is wider than the bow's wire", ("bow.span",), _long),
    _file(_GOOD[np.argsort(np.sin(7.0 * np.arange(len(_GOOD))))], "order"),
    foams.UNREACHABLE,
    foams.TOO_COLD,
    Fault(
        "walls stand where the wire's ends and clamps must be",
        # nearer to each other than the bow is wide, they reach its home, too
        ("motion.collision", "motion.no_path", "motion.entry", "motion.home"),
        _walls,
    ),
    _file(_GOOD[: len(_GOOD) // 2], "open"),
    Fault("the tip is a fifth of the root: it burns", ("kerf.too_hot",), _steep_taper),
    foams.NO_DATA,
    _file(_GOOD[::6], "few"),
    Fault("the airfoil's file is not there", ("problem.missing_file",), _missing),
    Fault("a key that no wing has", ("problem.field",), _key),
    Fault("a cut names a surface that a wing has not", ("part.missing_surface",), _cuts),
    Fault("an arm that the cell has not", ("problem.unknown_arm",), _arm),
]
