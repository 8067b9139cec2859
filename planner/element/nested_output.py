"""Output of nested blocks in an element's folder: table, cut drawings, stock list, and data."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

from planner.element import block_nesting
from planner.element.block_drawing import draw_blocks
from planner.element.element_file import Element
from planner.element.row_jobs import row_files
from planner.element.rows import SUPPORT_CLEARANCE_M, RowLimits
from planner.element.saw_jobs import saw_files
from planner.geometry.cut_tree import BlockPart, BowSize
from planner.geometry.units import MM
from planner.issues import Issue

REPLACEMENT_FOLDER: Final = "again"
"""Folder of single-panel problems of panels that are cut together in rows, to replace broken ones."""
PROBLEMS: Final = ("panels", "blocks", REPLACEMENT_FOLDER)
"""Folders of problem files. Ids are unique across all of them."""


def nested_folder(
    element: Element, panels: Sequence[block_nesting.PanelBlock]
) -> tuple[dict[str, str], tuple[Issue, ...], dict[str, Any]]:
    """Nest the blocks of panels in raw blocks, and write the result.

    Returns:
        Texts of files by name, issues, and data of ``element.json``; all empty without raw blocks in the
            file.

    Raises:
        TandemError: ``element.raw_block`` if a block fits no raw block.
    """
    file, name = element.file.raw_blocks, element.file.name
    if file is None:
        return {}, (), {}
    raw = []
    for size_spec in file.sizes:
        length, width, thickness = (v * MM for v in size_spec.size_mm)
        raw.append(block_nesting.RawBlock(length, width, thickness, size_spec.foam))
    bow = None if file.bow is None else BowSize(file.bow.span_mm * MM, file.bow.throat_mm * MM)
    kerf = file.kerf_mm * MM
    saw = element.saw
    cut = element.file.cut_blocks
    kept = file.keep_mm * MM
    together = (
        None
        if saw is None or cut is None or not cut.together
        else RowLimits(saw.bow, saw.margin, kept, saw.clearance + kerf + SUPPORT_CLEARANCE_M)
    )
    sawing = block_nesting.SawOptions(kerf, file.oversize_mm * MM, file.grain == "any", bow, kept, together)
    nesting = block_nesting.nest_blocks(name, panels, raw, element.stock, sawing)
    problems: dict[str, str] = {}
    jobs: dict[str, list[dict[str, Any]]] = {}
    issues = block_nesting.reach_issues(nesting, panels, sawing)
    if saw is not None and cut is not None:
        problems, jobs, job_issues = saw_files(element, saw, nesting, panels)
        issues += job_issues
        for block in nesting.blocks:
            block_jobs = jobs[block.name]
            files, jobs_of_rows = row_files(element, saw, block, len(block_jobs), cut.stand_mm * MM)
            problems |= files
            block_jobs += jobs_of_rows
    names = {block: [job["id"] for job in block_jobs] for block, block_jobs in jobs.items()}
    files = {
        "blocks.csv": block_nesting.blocks_csv(nesting, panels, names, together is not None),
        "blocks.svg": draw_blocks(name, nesting, panels, kerf),
        "stock.csv": block_nesting.stock_csv(nesting),
        **problems,
    }
    data = _data(nesting, panels, sawing)
    for block in data["blocks"]:
        if block["id"] in jobs:
            block["jobs"] = jobs[block["id"]]
    return files, issues, {"blocks": data}


def panels_in_rows(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return, for each panel that is cut together with others, its ``job`` and ``pose``.

    ``pose`` (4, 4) [mm] is that of its own block in the frame of the job's block.
    """
    return {
        name: {"job": job["id"], "pose": pose}
        for block in data.get("blocks", {}).get("blocks", ())
        for job in block.get("jobs", ())
        for name, pose in job.get("panels", {}).items()
    }


def _data(
    nesting: block_nesting.BlockNesting,
    panels: Sequence[block_nesting.PanelBlock],
    sawing: block_nesting.SawOptions,
) -> dict[str, Any]:
    """Return the data of ``element.json``: blocks with the positions of their panels and their cuts [mm].

    A cut has the axis across it, the corner (x, y) of the part that it goes through, its length, and the
    position of its slot on that axis.
    """

    def mm(value: float) -> float:
        return round(value / MM, 3) + 0.0

    volume, boxes = block_nesting.total_yields(nesting, panels)
    return {
        "least": nesting.bound,
        "least_because": nesting.proof,
        "yield_volume": round(volume, 4),
        "yield_boxes": round(boxes, 4),
        "oversize_mm": mm(sawing.oversize),
        "turned": sawing.may_rotate,
        "blocks": [
            {
                "id": block.name,
                "left_over": block.source,
                "size_mm": [mm(v) for v in block.size],
                "foam": block.foam,
                "yield_volume": round(block_nesting.block_yields(block, panels)[0], 4),
                "yield_boxes": round(block_nesting.block_yields(block, panels)[1], 4),
                "panels": [
                    {
                        "id": panels[block.panel(part.box)].name,
                        "corner_mm": [mm(part.x), mm(part.y)],
                        "size_mm": [mm(part.length), mm(part.width)],
                        "turned": part.is_rotated,
                        "level_cut": block.panel(part.box) in block.level,
                        **_alone_reason(block, part),
                    }
                    for part in block.boxes()
                ],
                "cuts": [
                    {
                        "across": "xy"[cut.axis],
                        "corner_mm": [mm(cut.x), mm(cut.y)],
                        "place_mm": mm(cut.position),
                        "along_mm": mm(cut.length),
                    }
                    for cut in block.tree.cuts()
                ],
            }
            for block in nesting.blocks
        ],
    }


def _alone_reason(block: block_nesting.NestedBlock, part: BlockPart) -> dict[str, str]:
    """Return the reason why a panel is cut alone, as data; empty if it is not."""
    reason = block.alone.get(block.panel(part.box))
    return {} if reason is None else {"alone": reason}
