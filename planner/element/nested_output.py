"""What nested blocks leave in an element's folder: a table, cut drawings, the stock list, and data."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from planner.element import nest
from planner.element.block_drawing import drawing
from planner.element.element_file import Element
from planner.element.row_jobs import row_files
from planner.element.rows import ROOM, Limits
from planner.element.saw_jobs import saw_files
from planner.geometry.cut_tree import Bow, Part
from planner.geometry.units import MM
from planner.issues import Issue

AGAIN: Final = "again"
"""Folder of the problems of panels that rows cut, for those that break."""
PROBLEMS: Final = ("panels", "blocks", AGAIN)
"""Folders of problems; no id is in two of them."""


def nested_folder(
    element: Element, panels: Sequence[nest.PanelBlock]
) -> tuple[dict[str, str], tuple[Issue, ...], dict[str, Any]]:
    """Files by their names, what is to be said, and the data; nothing where the element states no raw blocks.
    Raises ``TandemError``: ``element.raw_block``."""
    file, name = element.file.raw_blocks, element.file.name
    if file is None:
        return {}, (), {}
    raw = []
    for one in file.sizes:
        length, width, thickness = (v * MM for v in one.size_mm)
        raw.append(nest.RawBlock(length, width, thickness, one.foam))
    bow = None if file.bow is None else Bow(file.bow.span_mm * MM, file.bow.throat_mm * MM)
    kerf = file.kerf_mm * MM
    saw, cut, kept = element.saw, element.file.cut_blocks, file.keep_mm * MM
    together = (
        None
        if saw is None or cut is None or not cut.together
        else Limits(saw.bow, saw.margin, kept, saw.clearance + kerf + ROOM)
    )
    sawing = nest.Sawing(kerf, file.oversize_mm * MM, file.grain == "any", bow, kept, together)
    made = nest.nested(name, panels, raw, element.stock, sawing)
    problems: dict[str, str] = {}
    jobs: dict[str, list[dict[str, Any]]] = {}
    said = nest.told(made, panels, sawing)
    if saw is not None and cut is not None:
        problems, jobs, of_jobs = saw_files(element, saw, made, panels)
        said += of_jobs
        for block in made.blocks:
            own = jobs[block.name]
            files, more = row_files(element, saw, block, len(own), cut.stand_mm * MM)
            problems |= files
            own += more
    names = {block: [job["id"] for job in own] for block, own in jobs.items()}
    files = {
        "blocks.csv": nest.table(made, panels, names, together is not None),
        "blocks.svg": drawing(name, made, panels, kerf),
        "stock.csv": nest.stock_file(made),
        **problems,
    }
    data = _data(made, panels, sawing)
    for block in data["blocks"]:
        if block["id"] in jobs:
            block["jobs"] = jobs[block["id"]]
    return files, said, {"blocks": data}


def rows_in(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Of each panel that is cut together with others, by its id, the ``job`` that does it and the ``pose``
    (4, 4) [mm] of its own block in the frame of that job's."""
    return {
        name: {"job": job["id"], "pose": pose}
        for block in data.get("blocks", {}).get("blocks", ())
        for job in block.get("jobs", ())
        for name, pose in job.get("panels", {}).items()
    }


def _data(made: nest.Nesting, panels: Sequence[nest.PanelBlock], sawing: nest.Sawing) -> dict[str, Any]:
    """Blocks with where their panels lie and their cuts in order [mm]: corners of parts at x and y, the slot
    from place on along the axis, through a part that is as long as the cut."""

    def mm(value: float) -> float:
        return round(value / MM, 3) + 0.0

    volume, boxes = nest.total_yields(made, panels)
    return {
        "least": made.bound,
        "least_because": made.least,
        "yield_volume": round(volume, 4),
        "yield_boxes": round(boxes, 4),
        "oversize_mm": mm(sawing.oversize),
        "turned": sawing.turned,
        "blocks": [
            {
                "id": block.name,
                "left_over": block.source,
                "size_mm": [mm(v) for v in block.size],
                "foam": block.foam,
                "yield_volume": round(nest.yields(block, panels)[0], 4),
                "yield_boxes": round(nest.yields(block, panels)[1], 4),
                "panels": [
                    {
                        "id": panels[block.panel(part.box)].name,
                        "corner_mm": [mm(part.x), mm(part.y)],
                        "size_mm": [mm(part.length), mm(part.width)],
                        "turned": part.turned,
                        "level_cut": block.panel(part.box) in block.level,
                        **_why(block, part),
                    }
                    for part in block.boxes()
                ],
                "cuts": [
                    {
                        "across": "xy"[cut.axis],
                        "corner_mm": [mm(cut.x), mm(cut.y)],
                        "place_mm": mm(cut.place),
                        "along_mm": mm(cut.along),
                    }
                    for cut in block.tree.cuts()
                ],
            }
            for block in made.blocks
        ],
    }


def _why(block: nest.NestedBlock, part: Part) -> dict[str, str]:
    """Why a panel is cut by itself, where others are cut together."""
    why = block.alone.get(block.panel(part.box))
    return {} if why is None else {"alone": why}
