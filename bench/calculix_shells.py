"""``python -m bench.calculix_shells [name ...]``: loaded plates, cones and pyramids by CalculiX.

Writes decks of S8R elements (quadrilaterals of eight nodes), three meshes a shape, runs ``ccx`` (Debian
package ``calculix-ccx``), one at a time, and keeps displacements in ``tests/shell/calculix.json``, which
tests hold ``planner.shell`` against. S8R converges in the first order of the element's size, as rigid knots
stand where elements meet at an angle: what counts is the line through three meshes, at size zero. All meshes
of a shape are halvings of one layout: flange, wall, floor around a square core, whose lines follow the kinks.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.shell.element import Membrane, ShellSheet
from planner.shell.mesh import mesh_sheet
from planner.shell.newton import clamped, curve

TABLE = Path(__file__).parents[1] / "tests" / "shell" / "calculix.json"
MESHES = (6, 10, 14)
"""Elements along each side of the clamp, half of those of a flat sheet.

Even, so that there is a node at the middle.
"""
FINER = (6, 10, 14, 20)
"""Meshes of a steep wall and of a fast border, where coarse meshes of S8R are less accurate."""
FITTED = 3
"""Number of the finest meshes that the line goes through; a test runs the first of them again."""
CORE = 0.5
"""Half side of the square core over the floor's half width."""
LOAD_WIDTH = 1e-4
"""Width [m] of the load; so narrow that one node carries it, as in the decks."""
TRIANGLES = 4000
"""Triangles of Tandem's mesh for the comparison."""
SECONDS = 1200
"""Wall time limit [s] of a run."""


@dataclasses.dataclass(frozen=True)
class PlateShape:
    """A clamped sheet with a load: lengths [mm], angles [deg], forces [N], modulus [MPa].

    ``half``: half the window; ``top``: half width of the top edge, 0 of a plate; ``corner``: its radius (the
    half width: a cone); ``at``: where the load is, the floor's ``edge`` on x, its ``corner`` on the diagonal
    or the ``centre``."""

    name: str
    half: tuple[float, float] = (125.0, 125.0)
    top: float = 0.0
    corner: float = 0.0
    angle: float = 45.0
    depth: float = 0.0
    thickness: float = 1.0
    modulus: float = 68e3
    poisson: float = 0.3
    border: Literal["sliding", "immovable"] = "sliding"
    at: Literal["edge", "corner", "centre"] = "centre"
    forces: tuple[float, float] = (200.0, 600.0)
    meshes: tuple[int, ...] = MESHES

    @property
    def inwards(self) -> float:
        """How far the floor's edge is inside of the top edge [mm]."""
        return self.depth / np.tan(np.radians(self.angle)) if self.top else 0.0

    @property
    def load_point(self) -> FloatArray:
        """x, y of the load [mm]."""
        if self.at == "centre":
            return np.zeros(2)
        if self.at == "edge":
            return np.array([self.top - self.inwards, 0.0])
        centre, radius = self.top - self.corner, self.corner - self.inwards
        return (centre + radius / np.sqrt(2.0)) * np.ones(2)


SHAPES = (
    PlateShape("plate", forces=(100.0, 400.0)),
    PlateShape("plate, immovable", (90.0, 70.0), thickness=0.8, border="immovable", forces=(100.0, 300.0)),
    PlateShape("cone 50", top=50.0, corner=50.0, depth=20.0, at="edge"),
    PlateShape("cone 40", top=40.0, corner=40.0, depth=20.0, at="edge"),
    PlateShape("cone 50, centre", top=50.0, corner=50.0, depth=20.0),
    PlateShape("cone 60, 30 deg", top=60.0, corner=60.0, angle=30.0, depth=15.0, thickness=1.5, at="edge"),
    PlateShape("cone 45, 60 deg", top=45.0, corner=45.0, angle=60.0, depth=25.0, at="edge", meshes=FINER),
    PlateShape("cone 50, shallow", top=50.0, corner=50.0, depth=8.0, at="edge"),
    PlateShape(
        "cone 50, immovable",
        (100.0, 80.0),
        50.0,
        50.0,
        depth=20.0,
        border="immovable",
        at="edge",
        meshes=FINER,
    ),
    PlateShape(
        "cone 40, steel", (100.0, 100.0), 40.0, 40.0, depth=15.0, thickness=0.7, modulus=205e3, at="edge"
    ),
    PlateShape("pyramid, wall", top=40.0, corner=25.0, depth=20.0, at="edge"),
    PlateShape("pyramid, corner", top=40.0, corner=25.0, depth=20.0, at="corner"),
)


def contour(shape: PlateShape, parameter: FloatArray, inwards: float, depth: float) -> FloatArray:
    """Return points (k, 3) [mm] of a contour at parameters, from the diagonal (+, -) counterclockwise.

    Each quarter lies beside one side of the window.
    """
    straight, radius = shape.top - shape.corner, shape.corner - inwards
    quarter, rest = np.divmod(4.0 * parameter, 1.0)
    arc = 0.25 * np.pi * radius
    along = rest * (2.0 * arc + 2.0 * straight)
    turn = np.where(along < arc, along / radius - 0.25 * np.pi, 0.0)
    turn = np.where(along > arc + 2.0 * straight, (along - arc - 2.0 * straight) / radius, turn)
    side = np.clip(along - arc - straight, -straight, straight)
    x, y = straight + radius * np.cos(turn), side + radius * np.sin(turn)
    c, s = np.cos(0.5 * np.pi * quarter), np.sin(0.5 * np.pi * quarter)
    return np.column_stack([c * x - s * y, s * x + c * y, np.full(len(parameter), -depth)])


def quadrilaterals(shape: PlateShape, count: int) -> tuple[FloatArray, IntArray, FloatArray]:
    """Nodes (n, 3) [mm], elements (e, 8) and thicknesses (e,) [mm] with ``count`` elements a side."""
    fine = 2 * count * (1 if shape.top else 2)
    line = np.linspace(-1.0, 1.0, fine + 1)
    if not shape.top:
        x, y = np.meshgrid(shape.half[0] * line, shape.half[1] * line, indexing="ij")
        grid = np.stack([x, y, np.zeros_like(x)], axis=-1)
        return _join_grids([(grid, shape.thickness)])
    fraction = np.arange(4 * fine + 1) / (4 * fine)
    edge = np.concatenate(
        [np.column_stack([np.ones(fine), line[:-1]]), np.column_stack([-line[:-1], np.ones(fine)])]
    )
    edge = np.concatenate([edge, -edge, edge[:1]])
    top = contour(shape, fraction % 1.0, 0.0, 0.0)
    low = contour(shape, fraction % 1.0, shape.inwards, shape.depth)
    window = np.column_stack([edge * shape.half, np.zeros(len(edge))])
    size = CORE * (shape.top - shape.inwards)
    core = np.column_stack([size * edge, np.full(len(edge), -shape.depth)])
    rows = np.linspace(0.0, 1.0, count + 1)[:, None, None]
    x, y = np.meshgrid(size * line, size * line, indexing="ij")
    wall = shape.thickness * np.cos(np.radians(shape.angle))
    return _join_grids(
        [
            ((1.0 - rows**0.8) * window + rows**0.8 * top, shape.thickness),
            ((1.0 - rows) * top + rows * low, wall),
            ((1.0 - rows) * low + rows * core, shape.thickness),
            (np.stack([x, y, np.full_like(x, -shape.depth)], axis=-1), shape.thickness),
        ]
    )


def _join_grids(grids: list[tuple[FloatArray, float]]) -> tuple[FloatArray, IntArray, FloatArray]:
    """Elements of grids of nodes (2 a + 1, 2 b + 1, 3) whose rims are the same."""
    points, cells, thickness = [], [], []
    start = 0
    for grid, thick in grids:
        index = start + np.arange(grid.shape[0] * grid.shape[1]).reshape(grid.shape[:2])
        a, b, c = index[:-2:2], index[1::2], index[2::2]
        one = [
            a[:, :-2:2],
            c[:, :-2:2],
            c[:, 2::2],
            a[:, 2::2],
            b[:, :-2:2],
            c[:, 1::2],
            b[:, 2::2],
            a[:, 1::2],
        ]
        cells.append(np.stack(one, axis=-1).reshape(-1, 8))
        thickness.append(np.full(len(cells[-1]), thick))
        points.append(grid.reshape(-1, 3))
        start += index.size
    whole = np.concatenate(points)
    _, first, same = np.unique(np.round(whole, 6), axis=0, return_index=True, return_inverse=True)
    elements = same.reshape(-1)[np.concatenate(cells)]
    used, elements = np.unique(elements, return_inverse=True)
    nodes, elements = whole[first[used]], elements.reshape(-1, 8)
    a, b, d = (nodes[elements[:, k]] for k in (0, 1, 3))
    down = np.cross(b - a, d - a)[:, 2] < 0.0
    elements[down] = elements[down][:, [0, 3, 2, 1, 7, 6, 5, 4]]
    return nodes, elements, np.concatenate(thickness)


def deck(shape: PlateShape, count: int) -> tuple[str, int]:
    """The text of a deck, and which node has the load."""
    nodes, elements, thickness = quadrilaterals(shape, count)
    rows = ["*NODE, NSET=ALL"]
    rows += [f"{k + 1}, {x:.9g}, {y:.9g}, {z:.9g}" for k, (x, y, z) in enumerate(nodes)]
    for number, thick in enumerate(np.unique(thickness)):
        rows.append(f"*ELEMENT, TYPE=S8R, ELSET=E{number}")
        chosen = np.flatnonzero(thickness == thick)
        rows += [", ".join(map(str, [k + 1, *(elements[k] + 1)])) for k in chosen]
    rows += ["*MATERIAL, NAME=METAL", "*ELASTIC", f"{shape.modulus:.9g}, {shape.poisson:.9g}"]
    for number, thick in enumerate(np.unique(thickness)):
        rows += [f"*SHELL SECTION, ELSET=E{number}, MATERIAL=METAL", f"{thick:.9g}"]
    deviation = np.abs(nodes[:, :2]) - shape.half
    border = np.flatnonzero(deviation.max(axis=1) > -1e-6)
    corner = [
        int(np.argmin(lengths(nodes[:, :2] - np.multiply(shape.half, sign)))) + 1
        for sign in ((-1, -1), (1, -1))
    ]
    rows += ["*NSET, NSET=BORDER", *(f"{k + 1}," for k in border), "*BOUNDARY"]
    if shape.border == "immovable":
        rows += ["BORDER, 1, 5"]
    else:
        rows += ["BORDER, 3, 5", f"{corner[0]}, 1, 2", f"{corner[1]}, 2, 2"]
    loaded = int(np.argmin(lengths(nodes[:, :2] - shape.load_point)))
    if lengths(nodes[loaded, :2] - shape.load_point) > 1e-6:
        raise ValueError(f"{shape.name}: no node at the load")
    rows += ["*NSET, NSET=LOADED", f"{loaded + 1},"]
    for force in shape.forces:
        rows += [
            "*STEP, NLGEOM, INC=200",
            "*STATIC",
            "0.5, 1., 1e-3, 0.5",
            "*CLOAD",
            f"{loaded + 1}, 3, {-force:.9g}",
        ]
        rows += ["*NODE PRINT, NSET=LOADED, FREQUENCY=1000", "U", "*END STEP"]
    return "\n".join(rows) + "\n", len(elements)


def calculix(shape: PlateShape, count: int) -> dict[str, object]:
    """Displacements down [mm] under both forces by CalculiX, with elements and processor seconds."""
    text, elements = deck(shape, count)
    one = {**os.environ, "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "shape.inp").write_text(text)
        start = os.times()
        done = subprocess.run(
            ["ccx", "shape"],
            cwd=folder,
            env=one,
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=False,
        )
        took = os.times().children_user - start.children_user
        result = []
        out = Path(folder) / "shape.dat"
        for line in out.read_text().splitlines() if out.exists() else []:
            words = line.split()
            if len(words) == 4 and words[0].isdigit():
                result.append(-float(words[3]))
    if done.returncode or len(result) != len(shape.forces):
        raise RuntimeError(f"{shape.name}, {count}: ccx ended with {result}\n{done.stdout[-2000:]}")
    return {"elements": elements, "mm": result, "seconds": round(took, 1)}


def extrapolate(meshes: dict[int, list[float]]) -> list[float]:
    """Displacements at size zero: of the line over 1 / count through the finest meshes (least squares)."""
    finest = sorted(meshes)[-FITTED:]
    size = 1.0 / np.array(finest, dtype=np.float64)
    values = np.array([meshes[count] for count in finest])
    return [float(np.polyfit(size, column, 1)[1]) for column in values.T]


def ours(shape: PlateShape, triangles: int, membrane: Membrane = "optimal") -> FloatArray:
    """Displacements down [mm] under both forces by ``planner.shell``."""
    rings = []
    if shape.top:
        fraction = np.arange(400) / 400.0
        rings = [contour(shape, fraction, 0.0, 0.0), contour(shape, fraction, shape.inwards, shape.depth)]
    window = 1e-3 * np.array([np.negative(shape.half), shape.half])
    place = 1e-3 * shape.load_point
    mesh = mesh_sheet([1e-3 * ring for ring in rings], window, triangles, place[None])
    corners = mesh.nodes[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    thickness = 1e-3 * shape.thickness * normal[:, 2] / lengths(normal)
    sheet = ShellSheet(mesh.nodes, mesh.triangles, thickness, 1e6 * shape.modulus, shape.poisson, membrane)
    loads = np.zeros((len(shape.forces), 3))
    loads[:, 2] = np.negative(shape.forces)
    return -1e3 * curve(sheet, clamped(sheet, shape.border), place, loads, LOAD_WIDTH)[:, 2]


def main(names: list[str]) -> int:
    """Run the cases missing in the table, of the named shapes or of all, and write them into the table."""
    table = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    for shape in SHAPES:
        if names and shape.name not in names:
            continue
        meshes = table.get(shape.name, {}).get("meshes", {})
        for count in shape.meshes:
            if str(count) not in meshes:
                meshes[str(count)] = calculix(shape, count)
        result = extrapolate({int(count): item["mm"] for count, item in meshes.items()})
        table[shape.name] = {
            "forces_n": list(shape.forces),
            "meshes": meshes,
            "extrapolated_mm": [round(value, 5) for value in result],
        }
        mine = ours(shape, TRIANGLES)
        deviation = 100.0 * (mine / result - 1.0)
        print(
            f"{shape.name}: {np.round(result, 3)} mm, ours {mine.round(3)}, {deviation.round(2)} % off",
            flush=True,
        )
        ordered = {item.name: table[item.name] for item in SHAPES if item.name in table}
        TABLE.write_text(json.dumps(ordered, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
