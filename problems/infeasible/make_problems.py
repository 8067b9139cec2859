"""Writes small problems that cannot be solved, and expect.yaml: the issue codes that each must give.

Each is one block with one simple part, and has one fault.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import yaml

ARC = [[-70, 0], [-25, 21], [25, 21], [70, 0]]  # a flat arch, [x, z]
WAVES = [[-70, 0], [-40, 70], [-20, -60], [20, -60], [40, 70], [70, 0]]  # a camel's back turned over
FLAT = [[-70, 0], [70, 0]]


def loft(profile: list[list[float]], length: float = 200.0) -> dict[str, Any]:
    """A straight loft of one profile along y."""
    ends = [[[x, y, z] for x, z in profile] for y in (-length / 2, length / 2)]
    sections = [{"at": float(i), "bezier_mm": end} for i, end in enumerate(ends)]
    return {"loft": {"sections": sections, "flip": True, "chord_mm": 0.02}}


def saddle() -> dict[str, Any]:
    """The arch along a valley: its planes do not stay upright to the face."""
    sections = []
    for at, y, rise in ((0.0, -100.0, 45.0), (0.3, -40.0, 6.0), (0.7, 40.0, 6.0), (1.0, 100.0, 45.0)):
        sections.append({"at": at, "bezier_mm": [[x, y, z + rise] for x, z in ARC]})
    return {"loft": {"sections": sections, "flip": True, "chord_mm": 0.02}}


def base() -> dict[str, Any]:
    """A problem without fault."""
    return {
        "tandem": 1,
        "name": "feasible",
        "cell": "../cells/two_irb140_facing.yaml",
        "stock": {"size_mm": [160, 230, 100], "place": "auto", "support": "pedestal"},
        "part": {"front": loft(ARC), "back": {"offset_mm": 15}, "in_stock": "auto"},
        "operations": [
            {
                "name": "faces",
                "process": "elastic_wire",
                "arms": ["left", "right"],
                "wire": {
                    "material": "spring_steel",
                    "diameter_mm": 1.5,
                    "length_mm": 520,
                    "temperature_c": 300,
                },
                "kerf_mm": 2.5,
                "shape_tol_mm": 0.5,
                "sweep": "y",
                "step_mm": 5,
            }
        ],
    }


def straight(kind: str, held: bool = False) -> dict[str, Any]:
    """A problem of the straight wire without fault: an outline through a block that stands or is held."""
    square = [[-90, -70], [90, -70], [90, 70], [-90, 70]]
    stock: dict[str, Any] = {"size_mm": [240, 200, 100], "foam": "eps_a120"}
    if held:
        stock["held_by"] = "right"
    else:
        stock |= {"roll_pitch_deg": [90, 0], "support": "pedestal"}
    return {
        "tandem": 1,
        "name": kind,
        "cell": "../cells/two_irb140_bow_gripper.yaml",
        "stock": stock,
        "part": {"plate": {"outlines": [{"polyline_mm": square}]}},
        "operations": [
            {
                "name": "outline",
                "process": "straight_wire",
                "arms": ["left", "right"] if held else ["left"],
                "power_w": 46,
                "feed_mm_s": 6,
                "feed_min_mm_s": 4,
            }
        ],
    }


def straight_faults() -> dict[str, tuple[dict[str, Any], list[str]]]:
    """Problems of the straight wire by name with the codes that they must give."""
    out: dict[str, tuple[dict[str, Any], list[str]]] = {}

    def add(name: str, codes: list[str], held: bool = False) -> dict[str, Any]:
        out[name] = (straight(name, held), codes)
        return out[name][0]

    three, four = [[0, 0, 0], [90, 0, 0], [0, 90, 0]], [[0, 0, 80], [90, 0, 80], [90, 90, 80], [0, 90, 80]]
    guides = {"name": "side", "closed": True, "start": {"polyline_mm": three}, "end": {"polyline_mm": four}}
    add("unequal_corners", ["part.corners"])["part"] = {"ruled": [guides]}
    bow_tie = [[-90, -70], [90, 70], [90, -70], [-90, 70]]
    add("crossing_outline", ["part.outline_crossing"])["part"]["plate"]["outlines"][0]["polyline_mm"] = (
        bow_tie
    )
    for name, code in (("airfoil_order", "part.airfoil_order"), ("airfoil_open", "part.airfoil_open")):
        section = {"file": f"{name}.dat", "chord_mm": 150}
        problem = add(name, [code])
        problem["part"] = {
            "wing": {"root": section, "tip": {"naca": "2412", "chord_mm": 120}, "span_mm": 180}
        }
    add("wider_than_the_wire", ["bow.span"])["stock"]["size_mm"] = [240, 200, 390]
    problem = add("deeper_than_the_throat", ["bow.throat"])
    problem["stock"]["size_mm"] = [1000, 1000, 100]
    wide = [[-430, -430], [430, -430], [430, 430], [-430, 430]]
    hole = [[-40, -40], [40, -40], [40, 40], [-40, 40]]
    problem["part"]["plate"]["outlines"] = [{"polyline_mm": wide}, {"polyline_mm": hole}]
    problem = add("block_too_heavy", ["stock.too_heavy"], held=True)
    problem["stock"]["size_mm"] = [1400, 1200, 300]
    problem = add("gripper_in_the_way", ["stock.footprint"], held=True)
    problem["part"]["plate"]["outlines"][0]["polyline_mm"] = [[-90, -70], [40, -70], [40, 70], [-90, 70]]
    add("foam_without_data", ["kerf.no_data"])["stock"]["foam"] = "eps"
    add("no_such_surface", ["part.missing_surface"])["operations"][0]["cuts"] = [{"surface": "lid"}]
    return out


def airfoils() -> dict[str, str]:
    """Files of airfoil coordinates with a fault each: points shuffled; the upper side alone."""
    x = 0.5 * (1.0 + np.cos(np.linspace(0.0, 2.0 * np.pi, 41)))
    thick = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    points = np.stack([x, np.where(np.arange(41) <= 20, thick, -thick)], axis=1)
    shuffled = points[np.argsort(np.sin(7.0 * np.arange(41)))]
    rows = {"airfoil_order": shuffled, "airfoil_open": points[:21]}
    return {
        f"{name}.dat": f"{name}\n" + "".join(f"{u:9.5f} {v:9.5f}\n" for u, v in each)
        for name, each in rows.items()
    }


def faults() -> dict[str, tuple[dict[str, Any], list[str]]]:
    """Problems by name with the codes that they must give."""
    out: dict[str, tuple[dict[str, Any], list[str]]] = {}

    def add(name: str, codes: list[str]) -> dict[str, Any]:
        problem = copy.deepcopy(base())
        problem["name"] = name
        out[name] = (problem, codes)
        return problem

    wire = add("wire_too_short", ["wire.too_short"])["operations"][0]["wire"]
    wire["length_mm"] = 170
    wire = add("wire_too_thick", ["wire.curvature"])["operations"][0]["wire"]
    wire["diameter_mm"] = 6
    problem = add("waves", ["wire.shape"])
    problem["part"] = {"front": loft(WAVES), "in_stock": "auto"}
    problem["operations"][0]["faces"] = ["front"]
    add("flat_wall", ["wire.end_error"])["part"] |= {"front": loft(FLAT)}
    problem = add("thin_wire_on_edge", ["wire.weight"])
    problem["stock"]["roll_pitch_deg"] = [90, 0]
    problem["part"]["front"] = saddle()
    problem["operations"][0]["wire"]["diameter_mm"] = 0.5
    add("block_too_small", ["part.stock_too_small"])["stock"]["size_mm"] = [160, 190, 100]
    problem = add("bent_tighter_than_thick", ["part.offset"])
    problem["part"] |= {"front": loft([[-30, 0], [-30, 45], [30, 45], [30, 0]]), "back": {"offset_mm": 40}}
    add("no_back_face", ["part.missing_face"])["part"].pop("back")
    problem = add("unknown_key", ["problem.field"])
    problem["operations"][0]["speed"] = 8
    problem = add("far_cell", ["motion.no_reach"])
    problem["stock"]["place"] = {"xyz_mm": [0, 3000, 500]}
    return out


def revolved(profile: list[list[float]], around: int = 48) -> str:
    """An OBJ file of a surface of revolution, [radius, height] from its rim to its axis."""
    turn = 2.0 * np.pi * np.arange(around) / around
    lines = [
        f"v {r * np.cos(t):.4f} {r * np.sin(t):.4f} {z:.4f}" for r, z in profile[:-1] for t in turn.tolist()
    ]
    lines.append(f"v 0 0 {profile[-1][1]:.4f}")
    last = len(profile) - 2
    for ring in range(last):
        for k in range(around):
            a, b = 1 + ring * around + k, 1 + ring * around + (k + 1) % around
            lines += [f"f {a} {b} {a + around}", f"f {b} {b + around} {a + around}"]
    for k in range(around):
        a, b = 1 + last * around + k, 1 + last * around + (k + 1) % around
        lines.append(f"f {a} {b} {last * around + around + 1}")
    return "\n".join(lines) + "\n"


def rounded(angle: float, fillet: float = 9.0, up: bool = False) -> list[list[float]]:
    """A dish of 100 mm, 16 mm deep, with walls of an angle [deg] and rounded edges."""
    turn = np.linspace(0.0, np.deg2rad(angle), 9)
    edge = np.stack([fillet * np.sin(turn), fillet * (np.cos(turn) - 1.0)], axis=1)
    low = edge[-1] + max(16.0 - 2.0 * abs(edge[-1, 1]), 0.1) * np.array([1.0 / np.tan(turn[-1]), -1.0])
    line = np.concatenate(
        [[[-6.0, 0.0]], edge, (low + edge[-1]) - edge[::-1], [[50.0, low[1] + edge[-1, 1]]]]
    )
    return [[50.0 - x, -z if up else z] for x, z in line.tolist()]


def sheet(name: str) -> dict[str, Any]:
    """A problem of sheet forming without fault but for its part."""
    return {
        "tandem": 1,
        "name": name,
        "cell": "../cells/irb140_ball.yaml",
        "sheet": {"size_mm": [200, 200], "thickness_mm": 1, "metal": "aa1100_o", "opening_mm": 140},
        "part": {"sheet_mesh": {"file": f"{name}.obj", "unit": "mm", "face": "bottom"}},
        "operations": [
            {"name": "dish", "process": "forming", "arms": ["robot"], "mode": "spif", "stepdown_mm": 1}
        ],
    }


def sheet_faults() -> dict[str, tuple[dict[str, Any], str, list[str]]]:
    """Problems of sheet forming by name with their mesh and the codes that they must give."""
    out: dict[str, tuple[dict[str, Any], str, list[str]]] = {}

    def add(name: str, code: str, profile: list[list[float]], mesh: str = "") -> dict[str, Any]:
        out[name] = (sheet(name), mesh or revolved(profile), [code])
        return out[name][0]

    good = rounded(40.0)
    add(
        "sheet_undercut",
        "forming.undercut",
        [[56, 0], [50, 0], [45, -8], [46, -9], [40, -14], [20, -15], [0, -15]],
    )
    add("sheet_upright_wall", "forming.wall_angle", [[56, 0], [50, 0], [49.95, -15], [20, -15], [0, -15]])
    add("sheet_tool_too_big", "forming.tool_radius", rounded(40.0, 3.0))
    add("sheet_goes_up", "forming.side", rounded(40.0, up=True))
    add("sheet_part_too_wide", "part.stock_too_small", [[1.6 * r, z] for r, z in good])
    add("sheet_wrong_unit", "mesh.unit", [[0.001 * r, 0.001 * z] for r, z in good])
    add("sheet_flat", "forming.flat", [[r, 0.0] for r, _ in good])
    add("sheet_rim_not_flat", "forming.border", [[56, 3], *good[1:]])
    add(
        "sheet_closed_mesh",
        "forming.closed_mesh",
        [[0.01, 0], *good[1:]],
        revolved(good) + closing(len(good)),
    )
    lines = revolved(good).splitlines()
    flip = [k for k, line in enumerate(lines) if line.startswith("f ")][::3]
    for k in flip:
        lines[k] = "f " + " ".join(reversed(lines[k].split()[1:]))
    add("sheet_inside_out", "forming.inside_out", good, "\n".join(lines) + "\n")
    hole = "\n".join(revolved(good).splitlines()[:-48]) + "\n"
    add("sheet_hole", "forming.border", good, hole)
    problem = add("sheet_other_metal", "forming.unknown_metal", good)
    problem["sheet"]["metal"] = "unobtainium"
    problem = add("sheet_adsif_steep", "forming.adsif_range", rounded(50.0))
    problem["cell"] = "../cells/irb6640_irb4400_small_tools.yaml"
    problem["sheet"]["metal"] = "aa5754_o"
    problem["operations"][0] |= {"arms": ["left", "right"], "mode": "adsif"}
    return out


MILLED: dict[str, Any] = {
    "tandem": 1,
    "cell": "../cells/irb4600_mill.yaml",
    "stock": {"size_mm": [120, 80, 50], "place": {"xyz_mm": [1300, 0, 800]}, "support": "table"},
    "settings": {"clearance_mm": 5},
    "operations": [{"name": "mill", "process": "milling", "arms": ["robot"], "cuts": [{"flank": "wall"}]}],
}


def milled(low: list[list[float]], high: list[list[float]], **more: Any) -> dict[str, Any]:
    """A part of one ruled wall between two polylines."""
    wall = {"name": "wall", "start": {"polyline_mm": low}, "end": {"polyline_mm": high}, **more}
    return {"ruled": [wall], "in_stock": {}}


def mill_faults() -> dict[str, tuple[dict[str, Any], list[str]]]:
    """Problem and codes by name: blocks that cannot be milled as asked. The cutter is a ball nose of 6 mm."""
    out: dict[str, tuple[dict[str, Any], list[str]]] = {}

    def add(name: str, code: str, part: dict[str, Any]) -> dict[str, Any]:
        out[name] = ({"tandem": 1, "name": name, **copy.deepcopy(MILLED), "part": part}, [code])
        return out[name][0]

    def flat(points: list[list[float]], z: float) -> list[list[float]]:
        return [[*point, z] for point in points]

    plain = [[-55.0, 0.0], [55.0, 0.0]]
    add("mill_short_flute", "milling.flute", milled(flat(plain, 12.0), flat(plain, 50.0)))
    bent = [[-40.0, 0.0], [0.0, 20.0], [40.0, 0.0]]
    add("mill_inner_corner", "milling.corner", milled(flat(bent, 36.0), flat(bent, 50.0)))
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    ring = [[round(float(2 * np.sin(t)), 4), round(float(2 * np.cos(t)), 4)] for t in turn]
    tight = add("mill_too_thick", "milling.tool_radius", milled(flat(ring, 40.0), flat(ring, 50.0)))
    tight["operations"][0]["cuts"][0]["lead_mm"] = 0
    low, high = [[-6, -4, 41], [6, 4, 41]], [[-6, 4, 50], [6, -4, 50]]
    twisted = add("mill_twisted", "milling.twist", milled(low, high))
    twisted["operations"][0]["shape_tol_mm"] = 0.005
    back = [[-30.0, 0.0], [30.0, 0.0]], [[-30.0, 0.0], [-10.0, 0.0], [-25.0, 0.0], [30.0, 0.0]]
    crossed = add("mill_guides_cross", "part.ruled_shape", milled(flat(back[0], 40.0), flat(back[1], 50.0)))
    for side in ("start", "end"):
        crossed["part"]["ruled"][0][side]["corners_mm"] = []
    lies = milled([[-40, -5, 30], [40, -5, 30]], [[-40, 5, 31], [40, 5, 31]])
    add("mill_lies_flat", "milling.safe_plane", lies)
    far = add("mill_unreachable", "motion.no_reach", milled(flat(plain, 38.0), flat(plain, 50.0)))
    far["stock"]["place"] = {"xyz_mm": [4000, 0, 800]}
    return out


def closing(rings: int, around: int = 48) -> str:
    """Faces that close a surface of revolution along its rim, from a point above."""
    centre = (rings - 1) * around + 2
    faces = [f"f {1 + (k + 1) % around} {1 + k} {centre}" for k in range(around)]
    return "v 0 0 20\n" + "\n".join(faces) + "\n"


def gcode_faults() -> dict[str, tuple[str, list[str]]]:
    """G-code files, and the codes that each gives: units, feeds and planes stated nowhere; axes of no
    machine; slips and words that no robot carries out."""
    return {
        "gcode_unstated": (
            "\n".join(
                ["G90 S12000 M3", "G0 X-50 Y0 Z20", "G1 Z-2 F900", "G2 X50 I50 J0", "X0", "G0 Z20", "M30", ""]
            ),
            ["gcode.unit", "gcode.feed", "gcode.plane"],
        ),
        "gcode_no_machine": (
            "\n".join(
                [
                    "G21 G90 G94 S12000 M3 F1200",
                    "G0 X-100 Y0 Z20 A30 C90",
                    "G1 Z-2",
                    "X100 A25",
                    "G0 Z20",
                    "M30",
                    "",
                ]
            ),
            ["gcode.rotary"],
        ),
        "gcode_malformed": (
            "\n".join(
                [
                    "G21 G90 G17 G94 S12000 M3 F1200",
                    "G0 X0 Y0 Z20",
                    "G1 Z-2",
                    "G2 X10 Y0 I3 J0 (the centre is not in the middle)",
                    "G81 X20 Y20 Z-5 R2 (a canned cycle)",
                    "M8",
                    "G1 X=40",
                    "G42 D1 X50",
                    "T2 M6",
                    "T3 M6",
                    "M3",
                    "G55 X10",
                    "G4 P500",
                    "G0 Z20",
                    "M30",
                    "",
                ]
            ),
            ["gcode.arc", "gcode.word", "gcode.syntax", "gcode.tool", "gcode.offset", "gcode.mode"],
        ),
    }


def gcode_problem(name: str) -> dict[str, Any]:
    """A block that is milled by a G-code file of which nothing else is stated."""
    return {
        "tandem": 1,
        "name": name,
        "cell": "../cells/irb6640_mill.yaml",
        "stock": {"size_mm": [320, 240, 80], "place": {"xyz_mm": [1500, 0, 900]}, "support": "table"},
        "operations": [
            {
                "name": "panel",
                "process": "milling",
                "arms": ["robot"],
                "cuts": [{"gcode": {"file": f"{name}.nc", "origin": {"xyz_mm": [0, 0, 80]}}}],
            }
        ],
    }


def main() -> None:
    """Write all files beside this one."""
    folder = Path(__file__).parent
    expect = {}
    for name, (problem, codes) in {**faults(), **straight_faults(), **mill_faults()}.items():
        text = yaml.safe_dump(problem, sort_keys=False, default_flow_style=None, width=110)
        (folder / f"{name}.yaml").write_text(
            "# Written by make_problems.py. This problem cannot be solved.\n" + text
        )
        expect[f"{name}.yaml"] = codes
    for name, (problem, mesh, codes) in sheet_faults().items():
        text = yaml.safe_dump(problem, sort_keys=False, default_flow_style=None, width=110)
        (folder / f"{name}.yaml").write_text(
            "# Written by make_problems.py. This problem cannot be solved.\n" + text
        )
        (folder / f"{name}.obj").write_text(mesh)
        expect[f"{name}.yaml"] = codes
    for name, (program, codes) in gcode_faults().items():
        text = yaml.safe_dump(gcode_problem(name), sort_keys=False, default_flow_style=None, width=110)
        (folder / f"{name}.yaml").write_text(
            "# Written by make_problems.py. This problem cannot be solved.\n" + text
        )
        (folder / f"{name}.nc").write_text(program)
        expect[f"{name}.yaml"] = codes
    for name, text in airfoils().items():
        (folder / name).write_text(text)
    (folder / "expect.yaml").write_text(yaml.safe_dump(expect, sort_keys=False))


if __name__ == "__main__":
    main()
