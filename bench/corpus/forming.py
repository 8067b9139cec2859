"""Sheet forming in every mode, on every cell that fits.

Feasible by: floor fillets at least 1.5 mm larger than the forming ball (or a share of the walls asked that
leaves out twice what a ball cannot reach at sharp edges), walls 7 degrees below what the metal stands, an
opening that leaves both tools room beside the part, a force by Aerens' formula below the robot's payload.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from bench.corpus import cells, meshes, sheets
from bench.corpus.job import Data, Draft, Draw

METALS: Final = {
    # strength [MPa], usual thicknesses [mm]
    "aa1050_o": (80.0, (0.5, 0.8, 1.0)),
    "aa1100_o": (90.0, (0.8, 1.0, 1.0)),
    "aa3003_o": (110.0, (0.8, 1.0)),
    "aa5754_o": (215.0, (1.0,)),
    "dc04": (310.0, (0.5, 0.7)),
}
PAYLOAD: Final = {"irb4600_40": 40.0, "irb6640_185": 185.0, "irb6700_200": 200.0, "kr60_ha": 60.0}
PAIRS: Final = [
    # robots, half distances [mm], payload of the weaker one [kg]
    (("irb6640_185", "irb4400_60"), (1900.0, 1700.0), 60.0),
    (("irb6640_185", "irb6700_200"), (1900.0, 1900.0), 185.0),
    (("irb6640_185", "irb4400_60"), (1900.0, 1700.0), 60.0),
    (("irb4600_40", "irb4600_40"), (1700.0, 1700.0), 40.0),
    (("kr210_r2700", "kr210_r2700"), (1900.0, 1900.0), 210.0),
]
BALL_HOMES: Final = {
    "irb6640_185": [0, -30, 20, 0, 50, 0],
    "irb6700_200": [0, -30, 20, 0, 50, 0],
    "irb4400_60": [0, -20, 10, 0, 40, 0],
    "irb4600_40": [0, -20, 20, 0, 60, 0],
    "kr60_ha": [0, -110, 110, 0, 60, 0],
    "kr210_r2700": [0, -115, 110, 0, 55, 0],
    "irb140": [0, -10, 10, 0, 60, 0],
}
NOISE: Final = (0.0, 0.0, 0.0, 0.02, 0.05, 0.1)


def force(strength: float, thick: float, ball: float) -> float:
    """Axial force [N] by Aerens and others (2010) at its steepest, 49 degrees, with ridges of 0.02 mm."""
    lengths = thick**1.57 * (2.0 * ball) ** 0.41 * 0.02**0.09
    return 0.0716 * strength * lengths * 49.3 * math.cos(math.radians(49.3))


def metal(draw: Draw, payload: float, ball: float) -> tuple[str, float]:
    """A metal and a thickness that the robot can form."""
    fitting = [
        (name, thick)
        for name, (strength, sizes) in METALS.items()
        for thick in sizes
        if force(strength, thick, ball) < 0.9 * 9.81 * payload
    ]
    name, thick = draw.pick(fitting)
    return str(name), float(thick)


def ball_cell(draw: Draw, ball: float) -> tuple[Data, float]:
    """One arm with a ball tool, and its payload [kg]."""
    robot = draw.turn(["irb4600_40", "irb6640_185", "kr60_ha", "irb6700_200"])
    tool = {"kind": "ball_tool", "radius_mm": ball, "length_mm": draw.pick([250, 300])}
    return cells.alone(robot, tool, BALL_HOMES[robot]), PAYLOAD[robot]


def pair_cell(draw: Draw, ball: float, other: Data | None = None) -> tuple[Data, float]:
    """Two arms that face each other across an upright sheet, and the weaker one's payload [kg]."""
    robots, apart, payload = draw.turn(PAIRS)
    length = draw.pick([300, 330])
    tool = {"kind": "ball_tool", "radius_mm": ball, "length_mm": length}
    tools = (tool, dict(tool) if other is None else other)
    handshake = cells.kuka(robots[0]) or draw.chance(0.25)
    homes = (BALL_HOMES[robots[0]], BALL_HOMES[robots[1]])
    return cells.facing(robots, tools, *apart, homes, handshake), payload


def shape(draw: Draw, kind: str, ball: float, steep: float, facts: Data, large: bool = False) -> meshes.Mesh:
    """A part that goes down, and in ``facts`` its half width, depth and sharpness."""
    angle = draw.number(30, steep, 0)
    rim, floor = draw.number(ball + 1.5, 2 * ball + 4), draw.number(ball + 1.5, 2 * ball + 4)
    rounds = (rim + floor) * (1.0 - math.cos(math.radians(angle)))
    depth = round(rounds + (draw.number(20, 45) if large else draw.number(4, 14)), 1)
    foot = depth / math.tan(math.radians(angle)) + (rim + floor) * math.tan(math.radians(angle / 2))
    half = round(foot + (draw.number(25, 70) if large else draw.number(10, 25)), 1)
    facts.update(angle=angle, depth=depth, half=half, share=0.95)
    line = sheets.profile(sheets.wall(depth, angle, rim, floor))
    around = draw.pick([96, 144, 180])
    if kind == "cone":
        return sheets.turned_surface(half, line, around)
    if kind == "oval":
        facts["half"] = round(1.3 * half, 1)
        return sheets.turned_surface(half, line, around, 1.3)
    if kind == "dome":
        radius = max(half, (ball + 4 + rim) * math.sin(math.radians(angle)))
        facts["half"] = radius
        return sheets.turned_surface(radius, sheets.profile(sheets.bowl(radius, angle, rim)), around)
    if kind == "funnel":
        first = max(angle - 20.0, 22.0)
        pieces = [(sheets.FLAT, 0.0, 0.0), (rim * math.radians(first), 0.0, first)]
        pieces += [(draw.number(16, 30), first, angle), (floor * math.radians(angle), angle, 0.0)]
        line = sheets.profile(pieces)
        half = float(line[-1, 0] - sheets.FLAT + draw.number(8, 15))
        facts.update(half=half, depth=float(-line[-1, 1]))
        return sheets.turned_surface(half, line, around)
    if kind == "pyramid":
        corner = line[-1, 0] - sheets.FLAT + ball + draw.number(2, 8)
        half = max(half, corner + 4.0)
        facts.update(half=half, square=True)
        return sheets.pyramid(half, corner, line, draw.pick([16, 24]))
    if kind == "sharp":
        angle, depth = min(angle, 50.0), draw.number(22, 30)
        half = depth / math.tan(math.radians(angle)) + draw.number(18, 30)
        lost = sheets.unreached_fraction(ball, angle, depth, half, True)
        facts.update(angle=angle, depth=depth, half=half, square=True)
        facts["share"] = math.floor(100 * (1 - 2 * lost)) / 100
        line = sheets.profile(sheets.wall(depth, angle, 0.0, 0.0))
        return sheets.pyramid(half, 0.0, line, 24)
    # a dish with dimples further down on its floor
    size = 2.5 * ball + 6
    # between two dimples a support along the border of the second finds room beside the first
    aside = 4.0 + max(0.5 * facts.get("beside", 0.0) - 4.0, 0.0)
    half = float(line[-1, 0] - sheets.FLAT + 2 * size + 10 + aside)
    facts["half"] = half
    # curvature of the half wave, h pi^2 / 2 r^2, is below that of the ball
    rise = min(0.6 * 2.0 * size**2 / (math.pi**2 * (ball + 1.5)), 5.0)
    bumps = [(size + aside, 0.0, size, -rise), (-size - aside, 0.0, size, -rise)]
    return sheets.nest(half, line, bumps)


def sheet(draft_facts: Data, draw: Draw, name: str, thick: float, room: float, clamp: float) -> Data:
    """A sheet whose opening leaves ``room`` [mm] on each side of the part's flat."""
    half = draft_facts["half"] + sheets.FLAT + room
    opening = math.ceil(2 * half / 10) * 10
    # a round opening has to hold the corners of a square part, too
    across = math.ceil(2 * half * math.sqrt(2.0) / 10) * 10 if draft_facts.get("square") else opening
    section: Data = {
        "size_mm": [opening + 2 * clamp + 10] * 2,
        "thickness_mm": thick,
        "metal": name,
        "opening_mm": draw.pick([across, [opening, opening]]),
    }
    if section["opening_mm"] == across:
        section["size_mm"] = [across + 2 * clamp + 10] * 2
    return section


def draft(draw: Draw, mode: str, kind: str, large: bool = False) -> Draft:
    """A job of one mode and one kind of part without fault."""
    alone = mode in ("spif", "tpif")
    ball = draw.pick([5.0, 6.0, 6.35, 8.0]) if kind != "sharp" else draw.pick([3.0, 4.0])
    facts: Data = {"ball": ball, "mode": mode}
    other = None
    if mode == "heat":
        other = {"kind": "heat_tool", "radius_mm": 15, "length_mm": 250, "standoff_mm": draw.pick([20, 30])}
    elif mode == "dpif_p" and draw.chance(0.3):
        other = {
            "kind": "disk_tool",
            "radius_mm": 20,
            "length_mm": 300,
            "thickness_mm": 8,
            "shaft_radius_mm": 10,
        }
    if mode == "dpif_p":
        facts["beside"] = 2.0 * (20.0 if other else ball) + 2.0
    cell, payload = ball_cell(draw, ball) if alone else pair_cell(draw, ball, other)
    name, thick = metal(draw, payload, ball)
    mesh = shape(draw, kind, ball, 55.0 if alone else 60.0, facts, large)
    noise = draw.pick(NOISE) if kind != "sharp" else 0.0
    if noise:
        mesh = meshes.noisy(mesh, noise, draw.random)
    file, content, unit = meshes.file(mesh, draw.pick(meshes.FORMATS if not noise else meshes.FORMATS[2:4]))
    room = 14.0 if alone else 30.0 + (4 * 20.0 + 20.0 if other else 2 * ball) * (mode == "dpif_p")
    clamp = 30.0 if alone else 40.0
    own_sheet = sheet(facts, draw, name, thick, room, clamp)
    if alone:
        own_sheet["clamp"] = {"width_mm": 30, "above_mm": 10, "below_mm": 80}
        if draw.chance(0.3):
            own_sheet["stand"] = "upright"
    else:
        own_sheet["stand"] = "upright"
        own_sheet["clamp"] = {"width_mm": 40, "above_mm": 15, "below_mm": 40}
    operation: Data = {
        "name": "form",
        "process": "forming",
        "arms": ["robot"] if alone else ["left", "right"],
        "mode": mode,
        "path": draw.pick(["helical", "helical", "contour", "alternating", "stepped"]),
        "feed_mm_s": draw.pick([15, 25, 25, 40]),
    }
    operation |= (
        {"scallop_mm": draw.pick([0.02, 0.04])}
        if draw.chance(0.2)
        else {"stepdown_mm": draw.pick([0.8, 1, 1, 1.5])}
    )
    if facts["share"] != 0.95:
        operation["share"] = facts["share"]
    if mode in ("dsif", "dpif_l") and draw.chance(0.3):
        operation["squeeze"] = draw.pick([0.9, 0.95])
    if mode == "dpif_l" and draw.chance(0.4):
        operation["shift_deg"] = draw.pick([5, 10, 15])
    if cell["controller"].get("sync") == "handshake":
        operation |= {"longest_mm": 3.0, "handshake_gap_mm": 0.6}
    problem = {
        "sheet": own_sheet,
        "part": {"sheet_mesh": {"file": file, "unit": unit, "face": draw.pick(["bottom", "bottom", "top"])}},
        "settings": {"clearance_mm": 5},
        "operations": [operation],
    }
    scan = f", noise of {noise:g} mm" if noise else ""
    why = f"{mode}: a {kind} of {facts['angle']:g} degrees{scan}, fillets larger than the ball of R {ball:g}"
    if kind == "sharp":
        why = f"{mode}: a sharp pyramid; the share leaves out twice what the ball of R {ball:g} cannot touch"
    return Draft(problem, cell, {file: content}, facts, why)


KINDS: Final = ("cone", "pyramid", "dome", "sharp", "funnel", "oval", "nest")


def base(mode: str) -> Any:
    """A generator of one mode."""

    def make(draw: Draw) -> Draft:
        return draft(draw, mode, draw.turn(KINDS))

    return make


def large(draw: Draw) -> Draft:
    """Parts two to four times as wide and deep as the others."""
    return draft(draw, draw.turn(("spif", "dsif", "dpif_l", "spif")), draw.turn(KINDS[:3]), True)


def adsif(draw: Draw) -> Draft:
    """Accumulative forming: the only metal, sheet and balls that its table holds for, walls within it."""
    robots = ("irb6640_185", "irb6700_200")
    tool = {"kind": "ball_tool", "radius_mm": 5, "length_mm": draw.pick([300, 330])}
    homes = (BALL_HOMES[robots[0]], BALL_HOMES[robots[1]])
    cell = cells.facing(robots, (tool, dict(tool)), 1900, 1900, homes)
    first = draw.number(19, 28, 0)
    last = draw.pick([first, draw.number(first, 35, 0)])
    pieces = [(sheets.FLAT, 0.0, 0.0), (draw.number(16, 28), first, last)]
    line = sheets.profile(pieces, 0.75)
    half = float(line[-1, 0] - sheets.FLAT + draw.number(8, 16))
    facts: Data = {"half": half, "mode": "adsif", "ball": 5.0, "angle": last}
    file, content, unit = meshes.file(sheets.turned_surface(half, line), draw.pick(meshes.FORMATS[:4]))
    own_sheet = sheet(facts, draw, "aa5754_o", 1.0, 24.0, 40.0) | {"stand": "upright"}
    operation: Data = {"name": "form", "process": "forming", "arms": ["left", "right"], "mode": "adsif"}
    operation |= {"path": "helical", "stepdown_mm": draw.pick([0.1, 0.15, 0.2]), "feed_mm_s": 25}
    if draw.chance(0.4):
        operation["adsif"] = {"prefer": "gap"}
    problem = {
        "sheet": own_sheet,
        "part": {"sheet_mesh": {"file": file, "unit": unit, "face": "bottom"}},
        "settings": {"clearance_mm": 5},
        "operations": [operation],
    }
    why = f"adsif: walls of {first:g} to {last:g} degrees, within 16.5 to 37.3 of its table"
    return Draft(problem, cell, {file: content}, facts, why)


def tpif(draw: Draw) -> Draft:
    """Over a die: a dish into a female one, or a dome over a male one whose blank holder sinks."""
    ball = draw.pick([5.0, 6.0])
    facts: Data = {"ball": ball, "mode": "tpif"}
    cell, payload = ball_cell(draw, ball)
    name, thick = metal(draw, payload, ball)
    male = draw.index % 2 == 0
    if male:
        angle, rim = draw.number(35, 50, 0), draw.number(ball + 2, ball + 6)
        radius = (draw.number(45, 65, 0) + rim) * math.sin(math.radians(angle))
        line = sheets.profile(sheets.bowl(radius, angle, rim)) * [1.0, -1.0]
        top = 0.5 * math.floor(2.0 * line[-1, 1])
        line[:, 1] *= top / line[-1, 1]  # so that whole steps reach the rim
        mesh = sheets.turned_surface(radius, line)
        facts.update(half=radius, angle=angle, depth=top, share=0.95)
    else:
        mesh = shape(draw, draw.pick(["cone", "dome", "oval"]), ball, 55.0, facts)
    points, faces = mesh
    if male:
        # a solid: the part's lower face, skirts and a foot 50 mm lower
        ring = points[:144] * [1.0, 1.0, 0.0] - [0.0, 0.0, 50.0]
        count = len(points)
        skirt = np.arange(144)
        after = (skirt + 1) % 144
        sides = [[after, skirt, count + skirt], [after, count + skirt, count + after]]
        foot = [[count + skirt, np.full(144, count + 144), count + after]]
        more = np.concatenate([np.stack(cols, axis=1) for cols in sides + foot])
        die = np.vstack([points, ring, [[0.0, 0.0, -50.0]]]), np.vstack([faces, more])
    else:
        die = points - [0.0, 0.0, 0.05], faces
    own_sheet = sheet(facts, draw, name, thick, 14.0, 25.0)
    own_sheet["clamp"] = {"width_mm": 25, "above_mm": 10, "below_mm": 80}
    spec: Data = {"file": "die.ply", "unit": "mm", "kind": "male" if male else "female"}
    operation: Data = {"name": "form", "process": "forming", "arms": ["robot"], "mode": "tpif"}
    operation |= {"stepdown_mm": 0.5 if male else 1.0, "feed_mm_s": draw.pick([15, 25])}
    if male:
        spec |= {"holder": "sinking", "signal": "doBlankHolder", "step_mm": draw.pick([0.5, 1])}
        if spec["step_mm"] == 1:
            spec["step_mm"] = 1.0 if float(facts["depth"]).is_integer() else 0.5
        if cells.kuka(cell["arms"][0]["robot"]):
            cell["controller"]["io"]["robot"]["doBlankHolder"] = 21
    problem = {
        "sheet": own_sheet,
        "part": {"sheet_mesh": {"file": "part.ply", "unit": "mm", "face": "bottom"}},
        "settings": {"clearance_mm": 5},
        "operations": [operation | {"die": spec}],
    }
    why = f"tpif over a {spec['kind']} die of the part's own lower face"
    return Draft(problem, cell, {"part.ply": meshes.ply(mesh), "die.ply": meshes.ply(die)}, facts, why)
