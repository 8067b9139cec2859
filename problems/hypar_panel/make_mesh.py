"""Writes hypar.obj: a hyperbolic paraboloid z = y^2 / (2 * 700) - x^2 / (2 * 380), 300 x 400 mm, in
millimetres.
"""

from __future__ import annotations

from pathlib import Path


def main() -> None:
    """Write the mesh beside this file, as quads."""
    nx, ny = 100, 134
    lines = ["# hyperbolic paraboloid, millimetres, written by make_mesh.py"]
    for i in range(nx + 1):
        for j in range(ny + 1):
            x, y = -150 + 300 * i / nx, -200 + 400 * j / ny
            lines.append(f"v {x:.6f} {y:.6f} {y * y / 1400 - x * x / 760:.6f}")
    for i in range(nx):
        for j in range(ny):
            a = i * (ny + 1) + j + 1
            lines.append(f"f {a} {a + ny + 1} {a + ny + 2} {a + 1}")
    (Path(__file__).parent / "hypar.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
