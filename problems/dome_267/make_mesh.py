"""Writes dome.obj, a shallow dome over an oval of 9.7 x 7.8 m, in millimetres: a part of an ellipsoid,
as rings of triangles round its crown.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from pathlib import Path

RINGS, AROUND = 24, 96
SHARE = 0.97  # of the half axes 5 and 4 m: where the dome ends


def height(x: float, y: float) -> float:
    """Height [m] of the dome over x, y [m]."""
    return 2.5 * (sqrt(1.25 - (x / 5) ** 2 - (y / 4) ** 2) - sqrt(0.25))


def main() -> None:
    """Write the mesh beside this file."""
    lines = ["# shallow dome, millimetres, written by make_mesh.py", f"v 0 0 {1e3 * height(0, 0):.3f}"]
    for ring in range(1, RINGS + 1):
        for k in range(AROUND):
            r, angle = SHARE * ring / RINGS, 2 * pi * k / AROUND
            x, y = 5 * r * cos(angle), 4 * r * sin(angle)
            lines.append(f"v {1e3 * x:.3f} {1e3 * y:.3f} {1e3 * height(x, y):.3f}")
    for k in range(AROUND):
        after = (k + 1) % AROUND
        lines.append(f"f 1 {2 + k} {2 + after}")
        for ring in range(1, RINGS):
            a, b = 2 + (ring - 1) * AROUND, 2 + ring * AROUND
            lines.append(f"f {a + k} {b + k} {b + after}")
            lines.append(f"f {a + k} {b + after} {a + after}")
    (Path(__file__).parent / "dome.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
