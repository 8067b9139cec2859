"""Panels for a bent wire between two arms: saddles, waves, domes and twisted ones, from lofts and meshes.

Feasible by: sections that are cubic parabolas or arcs of a slope below 0.35, which a wire held at both ends
takes up to a fraction of a millimetre (a beam that bears no load between its clamps is a cubic), bent far
less than its elastic limit, none of them straight; a wire that is at least 180 mm longer than the block is
wide; tolerances of 0.8 mm and more; cells and blocks as large as those of the bundled panels.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from bench.corpus import cells, meshes
from bench.corpus.foams import UNREACHABLE
from bench.corpus.job import Data, Draft, Draw, Fault
from planner.geometry.arrays import FloatArray


def _heights(draw: Draw, kind: str, width: float, length: float) -> Any:
    """Height over the panel: arcs or S-lines across it (along x, as the wire lies), changed along y."""
    rise = draw.number(0.06, 0.1, 3) * width
    along = draw.number(0.01, 0.025, 3) * length

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        u, v = 2.0 * x / width, 2.0 * y / length
        if kind == "saddle":
            return np.asarray(rise * (1.0 - u * u) + along * v * v)
        if kind == "dome":
            return np.asarray(rise * (1.0 - u * u) - along * v * v)
        if kind == "wave":
            return np.asarray(0.6 * rise * (1.5 * u - 0.5 * u**3) * (1.0 + 0.2 * v))
        if kind == "twisted":
            return np.asarray(rise * (1.0 - u * u) + 0.5 * along * u * v)
        return np.asarray(rise * (1.0 - u * u) * (1.0 + 0.15 * v))

    return height


def _loft(height: Any, width: float, length: float) -> Data:
    """The surface as a loft of cubic Bezier sections, which is exact for parabolas and cubics across x."""
    sections = []
    for at in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = (at - 0.5) * length
        x = np.array([-0.5, -1.0 / 6.0, 1.0 / 6.0, 0.5]) * width
        z = height(x, np.full(4, y))
        # control points of the cubic through four points at thirds
        one = (-5.0 * z[0] + 18.0 * z[1] - 9.0 * z[2] + 2.0 * z[3]) / 6.0
        two = (2.0 * z[0] - 9.0 * z[1] + 18.0 * z[2] - 5.0 * z[3]) / 6.0
        controls = [z[0], one, two, z[3]]
        sections.append({"at": at, "bezier_mm": [[u, y, w] for u, w in zip(x, controls, strict=True)]})
    return {"loft": {"sections": sections, "flip": True, "chord_mm": 0.02}}


def base(draw: Draw) -> Draft:
    """A panel without fault."""
    kind = draw.turn(["saddle", "wave", "dome", "twisted", "arch"])
    large = draw.chance(0.25)
    width = draw.number(420, 600, 0) if large else draw.number(150, 320, 0)
    length = draw.number(500, 800, 0) if large else draw.number(240, 460, 0)
    height = _heights(draw, kind, width, length)
    thick = draw.number(15, 30, 0)
    files = {}
    source = draw.turn(["loft", "obj_m", "stl", "ply"])
    if source == "loft":
        front = _loft(height, width, length)
    else:
        count = max(16, round(width / draw.pick([6, 8]))), max(16, round(length / draw.pick([6, 8])))
        xs, ys = (np.linspace(-s / 2, s / 2, n) for s, n in zip((width, length), count, strict=True))
        mesh = meshes.grid(xs, ys, height, quads=source == "obj_m" and draw.chance(0.5))
        kinds = {"obj_m": ("obj", "m", 0.001), "stl": ("stl", "mm", 1.0), "ply": ("ply", "mm", 1.0)}
        name, content, unit = meshes.file(mesh, kinds[source], "panel")
        files[name] = content
        front = {"mesh": {"file": name, "unit": unit}}
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, 21), np.linspace(-length / 2, length / 2, 21))
    z = height(x, y)
    extent = float(z.max() - z.min())
    size = [width + 6, length + 6, float(np.ceil(extent + thick + 40))]
    if large:
        robots, apart, wire = ("irb4600_40", "irb4600_40"), 1800.0, {"diameter_mm": 2.0}
    else:
        robots, apart, wire = (
            ("irb140", "irb140"),
            draw.pick([830.0, 850.0]),
            {"diameter_mm": draw.pick([1.5, 1.5, 2.0])},
        )
    span = width + (draw.number(320, 420, 0) if large else draw.number(230, 330, 0))
    across = draw.pick(["across", "across", "diagonal"])
    tools = tuple({"kind": "wire_holder", "mounting": across, "side": side} for side in ("start", "end"))
    cell = cells.facing(robots, (tools[0], tools[1]), apart, apart, signals=cells.WIRE_SIGNAL)
    operation: Data = {
        "name": "faces",
        "process": "elastic_wire",
        "arms": ["left", "right"],
        "wire": {
            "material": "spring_steel",
            **wire,
            "length_mm": span,
            "temperature_c": draw.pick([250, 300]),
        },
        "kerf_mm": draw.pick([2.0, 2.5, 3.0]),
        "feed_min_mm_s": draw.pick([2, 3]),
        "shape_tol_mm": draw.pick([0.8, 1.0, 1.5]) if not large else 1.5,
        "end_error_mm": draw.pick([0.03, 0.05]),
        "faces": draw.pick([["front", "back"], ["front", "back"], ["front"]]),
        "runs": draw.pick(["one", "one", "two"]),
        "sweep": draw.pick(["y", "y", "auto"]),
    }
    problem = {
        "stock": {
            "size_mm": size,
            "foam": draw.pick(["eps_a120", "xps_30"]),
            "place": "auto",
            "support": cells.stand(0.4 * width, 0.7 * length, 1500),
        },
        "part": {"front": front, "back": {"offset_mm": thick}, "in_stock": "auto"},
        "operations": [operation],
    }
    why = f"a {kind} panel from {source}: every section is a gentle cubic, which a wire takes"
    return Draft(problem, cell, files, {"width": width, "length": length, "height": height}, why)


def _short(draft: Draft, draw: Draw) -> None:
    draft.operation["wire"]["length_mm"] = round(draft.facts["width"] + 4)
    draft.operation["sweep"] = "y"


def _thick(draft: Draft, draw: Draw) -> None:
    """Use a bar that an arc of the panel bends beyond its limit: strain d / 2R, where steel bears 0.6 %."""
    width = 170.0
    draft.operation["wire"].update(diameter_mm=8.0, length_mm=520.0)
    draft.operation["sweep"] = "y"
    _loft_panel(draft, width, 260.0, lambda x, y: 34.0 * (1.0 - (2.0 * x / width) ** 2) + 0.0 * y)


def _loft_panel(draft: Draft, width: float, length: float, height: Any) -> None:
    draft.files.clear()
    draft.problem["part"]["front"] = _loft(height, width, length)
    draft.problem["stock"]["size_mm"] = [width + 6, length + 6, 110.0]
    draft.problem["part"]["back"] = {"offset_mm": 15}


def _waves(draft: Draft, draw: Draw) -> None:
    """Three waves of 30 mm across 150 mm: far from any shape that a wire takes between two clamps."""
    width, length = 180.0, 260.0
    xs, ys = np.linspace(-width / 2, width / 2, 91), np.linspace(-length / 2, length / 2, 40)
    mesh = meshes.grid(xs, ys, lambda x, y: np.asarray(14.0 * np.sin(2.0 * np.pi * x / 60.0) + 0.0 * y))
    draft.files = {"panel.obj": meshes.obj(mesh)}
    draft.problem["part"] = {"front": {"mesh": {"file": "panel.obj", "unit": "mm"}}, "in_stock": "auto"}
    draft.operation.update(faces=["front"], sweep="y")
    draft.problem["stock"]["size_mm"] = [186.0, 266.0, 110.0]


def _flat(draft: Draft, draw: Draw) -> None:
    """A straight wire: the least error of its ends moves its middle by many times as much."""
    _loft_panel(draft, 200.0, 300.0, lambda x, y: 0.0 * x + 0.0 * y)
    draft.operation["wire"]["length_mm"] = 520.0
    draft.operation["shape_tol_mm"] = 0.5


def _small(draft: Draft, draw: Draw) -> None:
    draft.problem["stock"]["size_mm"][1] = round(0.75 * draft.facts["length"])
    if draft.problem["stock"]["size_mm"][0] > draft.facts["length"]:
        draft.problem["stock"]["size_mm"][0] = round(0.8 * draft.facts["length"])


def _offset(draft: Draft, draw: Draw) -> None:
    width = 80.0
    _loft_panel(draft, width, 220.0, lambda x, y: -40.0 * (2.0 * x / width) ** 2 + 0.0 * y)
    draft.problem["part"]["back"] = {"offset_mm": 60}


def _no_back(draft: Draft, draw: Draw) -> None:
    draft.problem["part"].pop("back")
    draft.operation["faces"] = ["front", "back"]


def _hot(draft: Draft, draw: Draw) -> None:
    draft.operation["wire"]["temperature_c"] = 450


def _material(draft: Draft, draw: Draw) -> None:
    draft.operation["wire"]["material"] = "piano_wire"


def _closed(draft: Draft, draw: Draw) -> None:
    turn = np.linspace(0.0, np.pi, 20)
    profile = np.stack([100.0 * np.sin(turn), 100.0 * np.cos(turn)], axis=1)[::-1]
    points, faces = meshes.revolve(np.vstack([[[0.01, -100.0]], profile[1:]]), 48)
    centre = len(points)
    cap = np.stack([(np.arange(48) + 1) % 48, np.arange(48), np.full(48, centre)], axis=1)
    mesh = np.vstack([points, [[0.0, 0.0, -100.0]]]), np.vstack([faces, cap])
    draft.files = {"panel.stl": meshes.stl(mesh)}
    draft.problem["part"]["front"] = {"mesh": {"file": "panel.stl", "unit": "mm"}}


def _pieces(draft: Draft, draw: Draw) -> None:
    line = np.linspace(-60, 60, 20)
    points, faces = meshes.grid(line, line, lambda x, y: np.asarray(-0.003 * x * x + 0.0 * y))
    aside = np.array([90.0, 0.0, 0.0])
    both = np.vstack([points - aside, points + aside])
    mesh = both, np.vstack([faces, faces + len(points)])
    draft.files = {"panel.obj": meshes.obj(mesh)}
    draft.problem["part"]["front"] = {"mesh": {"file": "panel.obj", "unit": "mm"}}


def _unit(draft: Draft, draw: Draw) -> None:
    line = np.linspace(-60, 60, 20)
    mesh = meshes.grid(line, 2 * line, lambda x, y: np.asarray(-0.003 * x * x + 0.0 * y))
    draft.files = {"panel.obj": meshes.obj(mesh)}
    draft.problem["part"]["front"] = {"mesh": {"file": "panel.obj", "unit": "m"}}


def _one_arm(draft: Draft, draw: Draw) -> None:
    draft.operation["arms"] = ["left"]


def _two_controllers(draft: Draft, draw: Draw) -> None:
    draft.cell["controller"] = cells.controller(["irb140"] * 2, ["left", "right"], cells.WIRE_SIGNAL, True)


FAULTS: Final = [
    Fault("the wire is hardly longer than the block is wide", ("wire.too_short",), _short),
    Fault("the wire is a bar of 8 mm, which does not bend so much", ("wire.curvature",), _thick),
    Fault("the panel has three full waves across", ("wire.shape", "wire.curvature"), _waves),
    Fault("a flat panel needs a straight wire", ("wire.end_error",), _flat),
    Fault("the block is shorter than the panel", ("part.stock_too_small",), _small),
    Fault("the panel is bent more tightly than it is thick", ("part.offset",), _offset),
    UNREACHABLE,
    Fault("the back is to be cut and is not there", ("part.missing_face",), _no_back),
    Fault("the wire is hotter than its temper stands", ("wire.temperature",), _hot),
    Fault("a wire material that nobody knows", ("wire.unknown_material",), _material),
    Fault("the mesh is a closed ball", ("mesh.closed",), _closed),
    Fault("the mesh has two pieces", ("mesh.pieces",), _pieces),
    Fault("the mesh is in mm and said to be in metres", ("mesh.unit",), _unit),
    Fault("one arm alone for a wire that two hold", ("problem.field",), _one_arm),
    Fault(
        "two controllers that meet by signals bend one wire", ("post.handshake_process",), _two_controllers
    ),
]
