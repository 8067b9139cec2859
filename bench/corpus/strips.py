"""Strips of free-form surfaces, and ruled meshes, by a bow on one arm: from lofts, coarse and fine meshes.

Feasible by: surfaces of gentle slope (below 20 degrees) and curvature, kinks of their meshes below 8
degrees, a tolerance above what as many strips need; a wire 60 mm longer than the block is wide.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from bench.corpus import cells, foams, meshes
from bench.corpus.job import Draft, Draw, Fault
from planner.geometry.arrays import FloatArray


def _surface(draw: Draw, width: float, length: float, rise: float, kind: str) -> meshes.Mesh:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        u, v = 2.0 * x / width, 2.0 * y / length
        if kind == "saddle":
            return np.asarray(rise * (u * u - v * v) / 2.0)
        if kind == "dome":
            return np.asarray(-rise * (u * u + v * v) / 2.0)
        if kind == "wave":
            return np.asarray(rise * np.sin(1.6 * v) * (0.6 + 0.2 * u))
        return np.asarray(rise * u * v / 1.5 + 0.3 * rise * v * v)

    fine = draw.chance(0.5)
    count = (draw.whole(30, 50), draw.whole(40, 60)) if fine else (draw.whole(8, 12), draw.whole(10, 14))
    xs, ys = (np.linspace(-s / 2, s / 2, n) for s, n in zip((width, length), count, strict=True))
    return meshes.grid(xs, ys, height, quads=draw.chance(0.5))


def base(draw: Draw) -> Draft:
    """A strip, or a ruled mesh, without fault."""
    cell, wire = cells.bow_cell(draw, False)
    width, length = draw.number(180, 300, 0), draw.number(400, 540, 0)
    rise = draw.number(12, 28, 0)
    kind = draw.turn(["saddle", "dome", "wave", "twist", "ruled", "loft"])
    files = {}
    take = 1
    if kind == "loft":
        sections = []
        for at in (0.0, 0.35, 0.7, 1.0):
            line = [
                [x, at * width, draw.number(0, 2 * rise)] for x in np.linspace(-length / 2, length / 2, 5)
            ]
            sections.append({"at": at, "bspline_mm": line})
        part = {"strips": {"loft": {"sections": sections}, "tolerance_mm": draw.pick([1.5, 2.0, 3.0])}}
    elif kind == "ruled":

        def hypar(x: FloatArray, y: FloatArray) -> FloatArray:
            return np.asarray(rise * (4.0 * x * y / (width * length)) + 0.1 * y)

        count = draw.pick([(6, 8), (20, 30)])
        mesh = meshes.grid(
            *(np.linspace(-s / 2, s / 2, n) for s, n in zip((width, length), count, strict=True)), hypar
        )
        name, content, unit = meshes.file(mesh, draw.pick(meshes.FORMATS))
        files[name] = content
        # two triangles are off the twisted cell between them by a quarter of its twist
        coarse = rise / ((count[0] - 1) * (count[1] - 1))
        part = {"mesh": {"file": name, "unit": unit, "tolerance_mm": round(0.5 + 2.0 * coarse, 1)}}
    else:
        mesh = _surface(draw, width, length, rise, kind)
        name, content, unit = meshes.file(mesh, draw.pick(meshes.FORMATS))
        files[name] = content
        strips = {"mesh": {"file": name, "unit": unit}, "across": draw.pick(["u", "v"])}
        if draw.chance(0.5):
            strips["tolerance_mm"] = draw.pick([1.0, 2.0, 3.0])
        else:
            strips["count"] = draw.whole(3, 6)
            strips["tolerance_mm"] = 8.0
            take = draw.whole(1, 3)
            strips["take"] = take
        part = {"strips": strips}
    size = [width + 20, length + 20, float(math.ceil(4 * rise + 60))]
    problem = {
        "stock": {"size_mm": size, "place": "auto", "support": cells.stand(0.4 * width, 0.6 * length, 1500)},
        "part": part,
        "operations": [
            {
                "name": "strip",
                "process": "straight_wire",
                "arms": ["robot"],
                "shape_tol_mm": draw.pick([0.4, 0.5, 0.8]),
            }
        ],
    }
    why = f"a {kind} surface of gentle slope, as ruled strips"
    draft = Draft(problem, cell, files, {"kind": kind, "width": width, "length": length}, why)
    foams.settle(draft, draw, wire, (1.1, 1.5))
    return draft


def _spherical(draft: Draft) -> meshes.Mesh:
    """A dome too round for any few ruled surfaces."""
    side = 0.5 * draft.facts["width"]

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.maximum((0.9 * draft.facts["width"]) ** 2 - x * x - y * y, 0.0)))

    line = np.linspace(-side, side, 25)
    return meshes.grid(line, line, height)


def _not_ruled(draft: Draft, draw: Draw) -> None:
    draft.files = {"part.obj": meshes.obj(_spherical(draft))}
    draft.problem["part"] = {"mesh": {"file": "part.obj", "unit": "mm", "tolerance_mm": 0.5}}
    draft.problem["stock"]["size_mm"] = [draft.facts["width"] + 40.0] * 2 + [140.0]


def _two_strips(draft: Draft, draw: Draw) -> None:
    draft.files = {"part.obj": meshes.obj(_spherical(draft))}
    mesh = {"file": "part.obj", "unit": "mm"}
    draft.problem["part"] = {"strips": {"mesh": mesh, "count": 2, "tolerance_mm": 0.05}}


def _round(draft: Draft, draw: Draw) -> None:
    def flat(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(0.001 * x * y)

    draft.files = {"part.obj": meshes.obj(meshes.polar(100.0, flat, 12, 90))}
    draft.problem["part"] = {"strips": {"mesh": {"file": "part.obj", "unit": "mm"}}}


def _unit(draft: Draft, draw: Draw) -> None:
    draft.files = {"part.obj": meshes.obj(_spherical(draft), 0.001)}
    draft.problem["part"] = {"strips": {"mesh": {"file": "part.obj", "unit": "mm"}}}


def _beyond(draft: Draft, draw: Draw) -> None:
    draft.files = {"part.obj": meshes.obj(_spherical(draft))}
    mesh = {"file": "part.obj", "unit": "mm"}
    draft.problem["part"] = {"strips": {"mesh": mesh, "count": 4, "tolerance_mm": 50, "take": 9}}


FAULTS: Final = [
    Fault("a part of a ball is no ruled surface within half a millimetre", ("part.not_ruled",), _not_ruled),
    foams.TOO_HOT,
    Fault("two strips do not keep 0.05 mm of a ball", ("part.strips",), _two_strips),
    foams.UNREACHABLE,
    Fault("a round mesh has no four corners", ("part.patch",), _round),
    Fault("the mesh is in metres and said to be in mm", ("mesh.unit",), _unit),
    Fault("the ninth of four strips", ("part.strips",), _beyond),
    foams.TOO_COLD,
]
