"""What a ruled wall in boxes or puzzle pieces, or a surface in ruled strips, leaves in a folder: problems, a
table and a drawing of its panels, and all as data."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from planner.element import jobs
from planner.element.assembly import GIVE
from planner.element.dowels import square
from planner.element.element_file import Element, StripsElement, WallElement
from planner.element.nest import PanelBlock
from planner.element.output import finished, outline, table, weight_kg
from planner.element.panel_drawing import DrawnPanel, panels_drawing
from planner.element.rows import Shape
from planner.element.strips import Divided
from planner.element.wall_assembly import Stand, assembly
from planner.element.wall_panels import SIDES, WallPanel, face_rulings, numbers
from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import DEG, MM
from planner.issues import Issue

TURN: Final = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""Places (u, t) of a wall as seen from the front: its rulings from right to left, u up."""
JOINT_POINTS: Final = 13
"""Points of each line of a joint in ``element.json``."""
JOINT_DIGITS: Final = 6
"""Their decimals in mm."""
SHADED: Final = 1.0
"""A back that is so far off [mm] is drawn darkest."""


@dataclasses.dataclass(frozen=True)
class Laid:
    """What is told of a panel by its kind. ``ring``: its corners [mm] among those of its neighbours, laid
    flat as seen from the front, with the panel ``beyond`` each edge; ``outline`` (C, 2) [mm]: as it is drawn;
    ``across``: its part of the surface there, from and to as shares; ``share`` of what is allowed that it is
    off; ``row`` of the table, and ``data`` beside it."""

    ring: Sequence[tuple[float, float]]
    beyond: Sequence[str | None]
    outline: FloatArray
    across: tuple[float, float]
    share: float
    row: dict[str, Any]
    data: dict[str, Any]


def folder(element: WallElement, panels: tuple[WallPanel, ...]) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files of a ruled wall by their names, and what is to be said: ``element.assembly`` for panels
    without a way in, ``element.cut`` for cuts of raw blocks that no bow reaches.

    Raises ``TandemError``: ``element.jobs``, ``element.raw_block``.
    """
    wide, names = float(element.wall.widths.max()) / MM, numbers(panels)
    pieces = [panel.piece for panel in panels]
    parts = [
        (wide * (1.0 - p.across[1]), wide * (1.0 - p.across[0]), p.along[0] / MM, p.along[1] / MM)
        for p in pieces
    ]
    laid = []
    for k, (panel, piece) in enumerate(zip(panels, pieces, strict=True)):
        own = (piece.outline @ TURN + [1.0, 0.0]) * [wide, 1.0 / MM]
        row = {"off_surface_mm": round(panel.off / MM, 3)}
        ring = outline(parts, names, k)
        laid.append(Laid(*ring, own, piece.across, panel.off / MM / SHADED, row, {}))
    worst = max(panel.off for panel in panels) / MM
    legend = f"the straight back is farther off one thickness behind the front, at most {worst:.2f} mm"
    wall = element.wall
    stand = Stand(wall, wall.nodes, np.array([0.0, wall.widths.mean()]))
    return _folder(element, panels, laid, [stand] * len(panels), ("", legend), {})


def strips_folder(element: StripsElement, found: Divided) -> tuple[dict[str, str], tuple[Issue, ...]]:
    """All files of a surface in ruled strips, as `folder`; with how far each panel is off it, and the kinks
    between neighbours."""
    panels, limit, names = found.panels, element.wanted.tolerance_mm, numbers(found.panels)
    places, share = found.lines.places[found.cuts], found.lines.share[found.cuts]
    known = {name: found.steps(k) for k, name in enumerate(names)}
    parts = []
    for strip, first, last in known.values():
        x, y = (places[-1] - places[[strip + 1, strip]]) / MM, found.lines.way[[first, last]] / MM
        parts.append((float(x[0]), float(x[1]), float(y[0]), float(y[1])))
    laid = []
    for k, own in enumerate(known.values()):
        ring, beyond = outline(parts, names, k)
        kinks = [None if one is None else round(found.kink(own, known[one]) / DEG, 3) for one in beyond]
        row = {
            "off_surface_mm": round(float(found.off[k]) / MM, 3),
            "kink_deg": max((kink for kink in kinks if kink is not None), default=0.0),
            "back_off_mm": round(panels[k].off / MM, 3),
        }
        across = float(share[own[0]]), float(share[own[0] + 1])
        drawn = np.array(parts[k])[[[0, 2], [1, 2], [1, 3], [0, 3]]]
        data = {"kinks_deg": kinks}
        laid.append(Laid(ring, beyond, drawn, across, float(found.off[k]) / MM / limit, row, data))
    worst = float(found.off.max()) / MM
    told = (
        f" in {len(share) - 1} strips across {found.across}",
        f"the front is farther off the surface, at most {worst:.2f} of {limit:g} mm",
    )
    whole = {
        "across": found.across,
        "breaks": np.round(share, 9).tolist(),
        "widths_mm": np.round(np.diff(places) / MM, 3).tolist(),
        "tolerance_mm": limit,
        "tried": {one: {"strips": s, "panels": p} for one, (s, p) in found.tried.items()},
    }
    strips = [panel.piece.place[0] for panel in panels]
    stands = [Stand(found.walls[k], found.lines.way, places[[k, k + 1]]) for k in strips]
    return _folder(element, panels, laid, stands, told, {"strips": whole})


def _folder(
    element: Element,
    panels: Sequence[WallPanel],
    laid: Sequence[Laid],
    stands: Sequence[Stand],
    told: tuple[str, str],
    more: dict[str, Any],
) -> tuple[dict[str, str], tuple[Issue, ...]]:
    names = numbers(panels)
    templates = jobs.chosen_templates(element, panels, names)
    files, rows, data, blocks = {}, [], [], []
    up = assembly(panels, names, stands, element.file.thickness_mm * MM, square(element))
    columns, bodies = up.columns(), up.data()
    for k, (panel, own, name, place, template) in enumerate(
        zip(panels, laid, names, _places(panels), templates, strict=True)
    ):
        made = jobs.problem(element, panel, name, template, _part(panel))
        files[f"panels/{name}.yaml"] = jobs.problem_text(element, name, made)
        blocks.append(panel_block(element, panel, name))
        row = {**_row(element, panel, own, blocks[-1], place, template.file), **columns[k]}
        rows.append({**row, "neighbours": " ".join(dict.fromkeys(one for one in own.beyond if one))})
        drawn = {"neighbours": list(own.beyond), "outline_mm": np.round(np.array(own.ring), 2).tolist()}
        takes = jobs.cut_figures(template, functools.partial(jobs.ruled_way, made))
        data.append(
            {**row, **drawn, **own.data, **bodies[k], **takes, "block_pose": jobs.pose_mm(panel.pose)}
        )
    files["panels.csv"] = table(rows)
    files["panels.svg"] = _drawing(element, laid, names, told)
    files["element.obj"] = up.obj()
    whole = {
        "element": 1,
        "name": element.file.name,
        "pose": np.eye(4).tolist(),
        "up": up.up.tolist(),
        "thickness_mm": element.file.thickness_mm,
        "volume_l": round(1e3 * sum(panel.volume for panel in panels), 3),
        **more,
        "panels": data,
    }
    if any(panel.piece.way_in is not None for panel in panels):  # lobes are no joints of two lines
        return finished(element, files, whole, blocks, up)
    whole["joints"] = list(_joints(panels, laid, stands, names, element.file.thickness_mm * MM))
    return finished(element, files, whole, blocks, up, tuple(up.issues(GIVE)))


def _joints(
    panels: Sequence[WallPanel],
    laid: Sequence[Laid],
    stands: Sequence[Stand],
    names: Sequence[str],
    thickness: float,
) -> Iterator[dict[str, Any]]:
    """Where two panels meet: their sides there, how long it is, and points of its lines in front and at the
    back, in pairs."""
    for panel, own, stand, name in zip(panels, laid, stands, names, strict=True):
        piece, wall = panel.piece, stand.wall
        low, high = np.min(own.ring, axis=0), np.max(own.ring, axis=0)
        ends = zip(own.ring, (*own.ring[1:], own.ring[0]), own.beyond, strict=True)
        for (x, y), (x_end, y_end), beyond in ends:
            if beyond is None or beyond < name:
                continue
            if x == x_end:
                side, other = ("right", "left") if x == high[0] else ("left", "right")
                first, last = stand.ways(np.array([min(y, y_end), max(y, y_end)]) * MM).tolist()
                ways = np.linspace(first, last, JOINT_POINTS)
                lines = face_rulings(wall, thickness, ways, piece.across)
                front, back = (line[int(side == "left")] for line in lines)
            else:
                side, other = ("bottom", "top") if y == low[1] else ("top", "bottom")
                ways = np.array([piece.along[int(side == "top")]])
                share = np.linspace(0.0, 1.0, JOINT_POINTS)[:, None]
                lines = face_rulings(wall, thickness, ways, piece.across)
                front, back = (a + share * (b - a) for (a,), (b,) in lines)
            yield {
                "panels": [name, beyond],
                "sides": [side, other],
                "length_mm": round(float(lengths(np.diff(front, axis=0)).sum()) / MM, 3),
                "front_mm": np.round(front / MM, JOINT_DIGITS).tolist(),
                "back_mm": np.round(back / MM, JOINT_DIGITS).tolist(),
            }


def panel_block(element: Element, panel: WallPanel, name: str) -> PanelBlock:
    """What is nested into raw blocks for a panel."""
    length, width, high = (v * MM for v in jobs.block_mm(panel))
    own = element.file.blocks[panel.block].foam
    return PanelBlock(
        name, length, width, high, panel.volume, own, Shape(panel.ring, (panel.back, panel.front))
    )


def _places(panels: Sequence[WallPanel]) -> tuple[str, ...]:
    """Where panels belong: a letter for each strip or row, and a number in it."""
    order = sorted(range(len(panels)), key=lambda k: panels[k].piece.place)
    named = jobs.row_names([panels[k].piece.place[0] for k in order])
    return tuple(name for _, name in sorted(zip(order, named, strict=True)))


def _part(panel: WallPanel) -> dict[str, Any]:
    """Front, back and sides as the part of a problem file; each goes on beyond the others."""
    return {
        "ruled": [
            jobs.ruled("front", *panel.front),
            jobs.ruled("back", *panel.back, flip=True),
            *(jobs.ruled(name, *side) for name, side in zip(SIDES, panel.sides, strict=True)),
        ]
    }


def _row(
    element: Element, panel: WallPanel, laid: Laid, own: PanelBlock, place: str, template: str
) -> dict[str, Any]:
    block, piece = element.file.blocks[panel.block], panel.piece
    box = zip(("width", "height", "depth"), panel.box.tolist(), strict=True)
    return {
        "id": own.name,
        "place": place,
        "from_mm": round(piece.along[0] / MM, 3),
        "to_mm": round(piece.along[1] / MM, 3),
        "from_share": round(laid.across[0], 6),
        "to_share": round(laid.across[1], 6),
        **{f"box_{side}_mm": round(v / MM, 3) for side, v in box},
        **{f"block_{axis}_mm": v for axis, v in zip("xyz", jobs.block_mm(panel), strict=True)},
        "raw_block_mm": " x ".join(f"{v:g}" for v in block.size_mm),
        "volume_l": round(1e3 * panel.volume, 4),
        "weight_kg": weight_kg(own),
        **laid.row,
        "job": template,
    }


def _drawing(element: Element, laid: Sequence[Laid], names: Sequence[str], told: tuple[str, str]) -> str:
    """The panels laid flat as seen from the front; of a wall with its rulings level and as long as the
    longest. ``told``: of their number, and what the darker ones are."""
    title = f"{element.file.name}: {len(names)} panels{told[0]}, {element.file.thickness_mm:g} mm thick"
    legend = "laid flat, seen from the front; numbers grow with the height of the panel's box; darker: "
    drawn = [DrawnPanel(name, one.outline, one.share) for name, one in zip(names, laid, strict=True)]
    return panels_drawing(title, legend + told[1], drawn)
