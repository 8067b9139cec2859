"""Writes the G-code of this problem: ``python problems/gcode/make_files.py`` (NumPy is all it needs).

A panel of 320 x 240 mm, x y z from the middle of its top. ``dome.nc`` mills a spherical cap with the tool
along its normals (I J K), a groove by arcs in all three planes, and marks in inches and step by step;
``sides_ca.nc`` and ``sides_cb.nc`` bevel the panel's sides by the angles of two kinds of five-axis heads.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
RADIUS = 350.0
"""Of the cap [mm]; its top is 1 mm below the panel's."""
RIM = 70.0
TURNS = 7
LINES = 240


def cap(radius: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 3) [mm] on the cap and its normals (N, 3)."""
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    height = np.sqrt(RADIUS**2 - radius**2)
    place = np.stack([x, y, height - RADIUS - 1.0], axis=1)
    return place, np.stack([x, y, height], axis=1) / RADIUS


def dome() -> str:
    """The cap from its rim to its top in a spiral, and the rest of what a file may say."""
    share = np.linspace(0.0, 1.0, LINES)
    place, normal = cap(RIM * (1.0 - 0.97 * share), 2.0 * np.pi * TURNS * share)
    head = [
        "%",
        "O1000 (CAP OF A PANEL)",
        "N10 G21 G90 G17 G94 G40 G49 G80 G91.1 (mm, absolute, feed a minute)",
        "N20 G54",
        "N30 T1 M6 ; cylinder of 20 mm",
        "N40 S12000 M3",
        "N50 G4 P2",
        "N60 G0 X{:.3f} Y{:.3f} Z20 I0 J0 K1".format(*place[0, :2]),
        "N70 G1 Z{:.3f} I{:.6f} J{:.6f} K{:.6f} F900".format(place[0, 2], *normal[0]),
    ]
    spiral = [
        f"N{80 + 10 * i}X{x:.3f}Y{y:.3f}Z{z:.3f}I{i_:.8f}J{j_:.8f}K{k_:.8f}" + ("F2400" if i == 0 else "")
        for i, ((x, y, z), (i_, j_, k_)) in enumerate(
            zip(place[1:].tolist(), normal[1:].tolist(), strict=True)
        )
    ]
    rest = """\
(a groove around the cap: down in a helix, round, and on in arcs of the upright planes)
g0 z20 i0 j0 k1
G0 X95 Y0
G1 Z1 F900
G3 X95 Y0 Z-2 I-95 J0 F1800 (full turn, helix)
G2 X95 Y0 I-95
X-95 Y0 R95
G3 X0 Y-95 R95
G18 G2 X40 Z-2 I20 K5 F1200 (xz, dips below)
G0 Z20
G0 X-130 Y30
G1 Z0 F900
G19 G2 Y-30 Z0 J-30 K40
G3 Y30 Z0 J30 K40
G17 G90.1 G2 X-110 Y50 I-110 J30 (absolute centre)
G91.1
M1 (look at it)
G0 Z20
(marks in inches, step by step)
G20 G0 X4.5 Y-1.5 Z.5
G1 Z-.05 F40.
G91 X.25
Y.25
X-.25
Y-.25
G90 G93 X5. F6.
X5. Y-1. F8
G94 G21
/G1 X0 (block delete: only on the machine that has a probe)
G0 Z20
S9000
G55 X-20 Y-20 (the second origin)
G1 Z-1 F900
G95 X20 F.2
G94 G1 Y20 F1500
M8
G0 Z20
M5
M30
%
"""
    return "\n".join([*head, *spiral, rest])


def sides(tilt: str) -> str:
    """The long sides by A and C, the short ones by B and C: 30 degrees outward."""
    lines = ["G21 G90 G94 G17", "T1 M6", "S12000 M3 F1800"]
    for turn, way in ((0, 1), (180, -1)):
        # head_ca leans to -y at C0, head_cb to +x: C leads either to its side
        along, beside = 150.0 * way, (-112.0 if tilt == "A" else 152.0) * way
        if tilt == "A":
            ends = [(-along, beside), (along, beside)]
        else:
            ends = [(beside, -along * 0.7), (beside, along * 0.7)]
        (x0, y0), (x1, y1) = ends
        lines += [
            f"G0 X{x0:.3f} Y{y0:.3f} Z30 {tilt}30 C{turn}",
            "G1 Z-4",
            f"X{x1:.3f} Y{y1:.3f}",
            f"{tilt}20 (in place)",
            f"X{x0:.3f} Y{y0:.3f} {tilt}35 C{turn + 10}",
            "G0 Z30",
        ]
    return "\n".join([*lines, "G0 A0 C0" if tilt == "A" else "G0 B0 C0", "M5", "M30", ""])


def main() -> None:
    """Write all files beside this one."""
    (HERE / "dome.nc").write_text(dome())
    (HERE / "sides_ca.nc").write_text(sides("A"))
    (HERE / "sides_cb.nc").write_text(sides("B"))


if __name__ == "__main__":
    main()
