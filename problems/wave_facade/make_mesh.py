"""Writes wave_facade.obj, a wavy wall of 4 x 3 m as quads of 25 mm, in millimetres: two long waves, a short
one and a bump.
"""

from __future__ import annotations

from math import cos, exp, sin
from pathlib import Path

STEP = 25  # mm


def height(x: float, y: float) -> float:
    """Height [m] of the wall over x, y [m]."""
    waves = 0.30 * sin(1.5 * x + 0.6 * y) + 0.16 * cos(2.6 * y - 0.5 * x) + 0.04 * sin(5.5 * x) * cos(3 * y)
    return waves + 0.10 * exp(-((x - 2.6) ** 2 + (y - 1.2) ** 2) / 0.15)


def main() -> None:
    """Write the mesh beside this file."""
    nx, ny = 4000 // STEP, 3000 // STEP
    lines = ["# wavy wall, millimetres, written by make_mesh.py"]
    for i in range(nx + 1):
        for j in range(ny + 1):
            x, y = i * STEP, j * STEP
            lines.append(f"v {x} {y} {1e3 * height(x / 1e3, y / 1e3):.3f}")
    for i in range(nx):
        for j in range(ny):
            a = i * (ny + 1) + j + 1
            lines.append(f"f {a} {a + ny + 1} {a + ny + 2} {a + 1}")
    (Path(__file__).parent / "wave_facade.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
