"""``python -m bench.plant_shells``: what the sheets of ``planner/data/loop_plant.json`` do.

A loop from level to level is tried on sheets that are not those it believes in: other thickness, a clamp that
holds the sheet in its plane by a spring, a finer mesh. This works out, for a cone and a rounded pyramid, how
far places on the floor's edge move under forces along z at some depths, thicknesses and springs; and, beside,
what a loop believes: the sheet of nominal thickness that slides, on a coarse mesh. Takes about ten
minutes; nothing else makes the table.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.shell.element import ShellSheet
from planner.shell.mesh import mesh_sheet
from planner.shell.newton import Loading, clamped, column_weights

TABLE = Path(__file__).parents[1] / "planner" / "data" / "loop_plant.json"
WINDOW = 0.125 * np.array([[-1.0, -1.0], [1.0, 1.0]])
ANGLE = np.radians(45.0)
THICKNESS = 1.0 * MM
YOUNG, POISSON = 68e9, 0.3
DEPTHS = (1.0, 4.0, 8.0, 14.0, 20.0)
SHARES = (0.85, 1.0, 1.1)
"""Thickness over the nominal one."""
SPRINGS = (0.0, 15.0, 60.0)
"""Stiffness of the clamp in the sheet's plane [N/mm for each mm of its length]."""
LOADS = (25.0, 75.0, 175.0, 325.0, 500.0, 700.0, 950.0)
FINE, COARSE = 5000, 1500
"""Triangles of the true sheet, and of the one in the loop's model."""
COLUMN = 3.0 * MM
OUTLINES = {"cone": shapely.Point(0.0, 0.0), "pyramid": shapely.box(-0.015, -0.015, 0.015, 0.015)}
"""Outlines of the contours, at these distances [m] on the flat: those of walls that rise at 45 degrees."""
TOPS = {"cone": 0.050, "pyramid": 0.025}
PROBE_ANGLES_DEG = {"cone": {"wall": 0.0}, "pyramid": {"wall": 0.0, "corner": 45.0}}
"""Angles [deg], seen from the middle, at which the floor's edge is loaded."""


def ring(name: str, depth: float) -> FloatArray:
    """The contour (K, 3) [m] of a shape at a depth [m]."""
    line = OUTLINES[name].buffer(TOPS[name] - depth / np.tan(ANGLE), quad_segs=60)
    points = np.array(line.exterior.coords)[:-1]
    return np.column_stack([points, np.full(len(points), -depth)])


def contour_point(name: str, depth: float, degrees: float) -> FloatArray:
    """Return the point (2,) [m] of a contour in the given direction [deg] from the middle."""
    turn = np.radians(degrees)
    ray = shapely.LineString([(0.0, 0.0), (0.2 * np.cos(turn), 0.2 * np.sin(turn))])
    ends = shapely.Polygon(ring(name, depth)[:, :2]).exterior.intersection(ray)
    return np.array([ends.x, ends.y])


def displacements(
    name: str, depth: float, degrees: float, thickness_fraction: float, spring: float, size: int
) -> FloatArray:
    """Displacements (L,) [mm] under `LOADS`."""
    at = contour_point(name, depth, degrees)
    mesh = mesh_sheet([ring(name, 0.0), ring(name, depth)], WINDOW, size, at[None])
    corner = mesh.nodes[mesh.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    thick = thickness_fraction * THICKNESS * normal[:, 2] / lengths(normal)
    sheet = ShellSheet(mesh.nodes, mesh.triangles, thick, YOUNG, POISSON)
    loading = Loading(sheet, clamped(sheet, spring / MM**2 if spring else "sliding"))
    loads = np.column_stack([np.zeros((len(LOADS), 2)), -np.array(LOADS)])
    return -loading.curve(column_weights(sheet, at, COLUMN), loads)[:, 2] / MM


def shape(name: str) -> dict[str, Any]:
    """One shape of the table."""
    start_s = time.process_time()
    true = [
        [
            [
                [
                    np.round(displacements(name, d * MM, turn, fraction, spring, FINE), 4).tolist()
                    for spring in SPRINGS
                ]
                for fraction in SHARES
            ]
            for turn in PROBE_ANGLES_DEG[name].values()
        ]
        for d in DEPTHS
    ]
    believed = [
        [
            np.round(displacements(name, d * MM, turn, 1.0, 0.0, COARSE), 4).tolist()
            for turn in PROBE_ANGLES_DEG[name].values()
        ]
        for d in DEPTHS
    ]
    print(f"{name}: {time.process_time() - start_s:.0f} s")
    rings = {"around_mm": 1e3 * (TOPS[name]), "core_mm": 0.0 if name == "cone" else 15.0}
    return {
        "places_deg": list(PROBE_ANGLES_DEG[name].values()),
        **rings,
        "true_mm": true,
        "believed_mm": believed,
    }


def main() -> None:
    """Write the table."""
    axes = {"depth_mm": DEPTHS, "thickness": SHARES, "spring_n_mm2": SPRINGS, "load_n": LOADS}
    about = (
        "true_mm: displacement by depth, place, thickness over the nominal one, clamp's spring and load, "
        f"of elastic shells of {FINE} triangles; believed_mm: of {COARSE} triangles, nominal, sliding. Sheet "
        "250 x 250 x 1 mm, 68 GPa, 0.3; walls of 45 degrees around core_mm, around_mm from it at the top."
    )
    shapes = {name: shape(name) for name in OUTLINES}
    data = {"tandem_plant_table": 1, "about": about, **axes, "shapes": shapes}
    TABLE.write_text(json.dumps(data, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
