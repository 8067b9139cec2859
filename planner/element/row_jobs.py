"""Problem files of rows of panels: one pass for all fronts, one for all backs, then a cut around each panel.

Faces are cut while the row lies flat: fronts as one surface from end to end of the row, then backs, with
straight runs between panels. For a slab, whose back is that of the block, one plane cuts it to its thickness.
Then the operator puts the row on edge, and the wire, which spans the thickness, goes around each panel, the
uppermost first and its top last, so that nothing drops before it is cut.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.block_nesting import NestedBlock
from planner.element.element_file import Element, SawTemplate
from planner.element.jobs import DIGITS, cut_figures, fill_template, pose_to_mm, ruled_surface
from planner.element.rows import BACKS, PanelRow, SupportRange
from planner.element.saw_jobs import (
    BEAM_DISTANCE_M,
    SUPPORT_INSET_M,
    SawJob,
    box_shape,
    job_name,
    problem_name,
    to_mm,
)
from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.reading import strict_yaml

FACES, OUTLINES = "faces", "outlines"
"""Names of the operations of a row: the faces of all panels, and the outlines of each."""
TIE_INSTRUCTION: Final = "Put spacers into the slots and tie the layers together before it is put on edge."
"""Instruction if faces were cut, because a thin layer has nothing below it while the row is on edge."""


@dataclasses.dataclass(frozen=True)
class _RowJob:
    """A row with the jobs, one for each pose in which it is cut.

    Attributes:
        row: The row.
        flat: Part and pose while the row lies flat.
    """

    row: PanelRow
    flat: SawJob

    @property
    def edge(self) -> SawJob:
        """Part and pose while the row is on edge."""
        return dataclasses.replace(self.flat, axis=self.row.axis, up=1)

    @property
    def first(self) -> SawJob:
        """Part and pose in which the row is cut first."""
        return self.flat if self.row.faces else self.edge


def _combined_face(name: str, parts: Sequence[FloatArray]) -> dict[str, Any]:
    """Return faces of panels as one ruled surface of a problem, with a straight run from each to the next.

    ``parts`` are the rulings (2, N, 3) [m] of the faces. The ends of the runs are corners of the surface.
    """
    start, end = np.concatenate(parts, axis=1)
    surface = ruled_surface(name, start, end, **({"flip": True} if name == BACKS else {}))
    inner_ends = np.concatenate([part[:, [0, -1]] for part in parts], axis=1)[:, 1:-1]
    for side, corners in zip(("start", "end"), inner_ends, strict=True):
        if len(corners):
            surface[side]["corners_mm"] = [
                [round(v, DIGITS) + 0.0 for v in row] for row in (corners / MM).tolist()
            ]
    return surface


def row_files(
    element: Element, template: SawTemplate, block: NestedBlock, previous_jobs: int, stand: float
) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Return the problem files of a block's rows by path, and the data of these jobs for ``element.json``.

    Args:
        element: Element.
        template: Template for raw blocks.
        block: Block.
        previous_jobs: Number of other jobs of the block before these.
        stand: Maximum height of supports [m].
    """
    files: dict[str, str] = {}
    data: list[dict[str, Any]] = []
    for number, row in enumerate(block.rows.values(), previous_jobs + 1):
        name = job_name(block, number)
        job = _RowJob(row, SawJob(name, row.part, block.size[2], 2, (), (), 0))
        problem = _problem(element, template, block, job, stand)
        ids, first = " ".join(row.outlines), job.first
        comment = (
            f"# Panels {ids} of {element.file.name}, cut together out of {block.name}: {first.description}. "
        )
        files[f"blocks/{name}.yaml"] = f"{comment}Written by tandem element.\n" + strict_yaml.dump(problem)
        data.append(_data(template, row, first))
    return files, data


def _data(template: SawTemplate, row: PanelRow, job: SawJob) -> dict[str, Any]:
    """Return the data of a row's job for ``element.json``."""

    def cut_length(_: Mapping[str, Any]) -> float:
        """Return the total cut length [mm], midway between both ends of the wire."""
        paths = [np.concatenate([ring, ring[:, :1]], axis=1) for ring in row.outlines.values()]
        paths += [np.concatenate(parts, axis=1) for parts in row.faces.values()]
        return sum(float(lengths(np.diff(path.mean(axis=0), axis=0)).sum()) for path in paths) / MM

    return {
        "id": job.name,
        "said": f"{', '.join(row.outlines)} together: {'faces first, then ' if row.faces else ''}around "
        f"each of them; {job.description}",
        "corner_mm": [to_mm(job.part.x), to_mm(job.part.y)],
        "size_mm": [to_mm(v) for v in job.size],
        "cuts": [],
        "panels": {name: pose_to_mm(pose) for name, pose in row.poses.items()},
        **cut_figures(template, cut_length, 2 if row.faces else 1),
    }


def _problem(
    element: Element, template: SawTemplate, block: NestedBlock, job: _RowJob, stand: float
) -> dict[str, Any]:
    """Return the problem of a row: the template with its stock, surfaces, and one or two operations."""
    row, flat, edge = job.row, job.flat, job.edge
    shapes = [_combined_face(name, parts) for name, parts in row.faces.items()]
    shapes += [ruled_surface(name, ring[0], ring[1], closed=True) for name, ring in row.outlines.items()]
    edge_stock = {"place": "auto", "roll_pitch_deg": edge.roll_pitch, "support": _feet(row, edge, stand)}
    flat_stock = {"place": "auto", "roll_pitch_deg": flat.roll_pitch, "support": _beams(row, flat, stand)}
    stock = {"size_mm": [to_mm(v) for v in flat.size], **(flat_stock if row.faces else edge_stock)}
    out = fill_template(
        template, problem_name(element.file.name, flat.name), stock, block.foam, {"ruled": shapes}
    )
    (operation_data,) = out["operations"]
    template_setup = operation_data.get("setup") or {}

    def operation(
        name: str, setup: Mapping[str, Any], cuts: list[dict[str, Any]], **options: Any
    ) -> dict[str, Any]:
        """Return the operation of the template with a name, setup and cuts."""
        return {**operation_data, "name": name, "setup": setup, **options, "cuts": cuts}

    lead = {"lead": [float(k == row.axis) for k in range(3)]}
    outline_cuts = [{"surface": name, **(lead if row.is_free_above(name) else {})} for name in row.outlines]
    face_cuts = [{"surface": name} for name in row.faces]
    block_text = f"Block {block.name}: "
    outlines_note = f"{block_text}{edge.description}. The wire goes around {', '.join(row.outlines)}."
    if not row.faces:
        out["operations"] = [operation(OUTLINES, {"note": outlines_note, **template_setup}, outline_cuts)]
        return out
    out["operations"] = [
        # what is above a slot must not drop before it is cut around
        operation(
            FACES, {"note": f"{block_text}{flat.description}.", **template_setup}, face_cuts, spacers=True
        ),
        operation(OUTLINES, {**edge_stock, "note": f"{outlines_note} {TIE_INSTRUCTION}"}, outline_cuts),
    ]
    return out


def _beams(row: PanelRow, job: SawJob, stand: float) -> list[dict[str, Any]]:
    """Return the supports of a row that lies flat, ``stand`` [m] high, as shapes of a problem file."""
    side = job.size[1 - row.along]
    across = max(side - 2.0 * SUPPORT_INSET_M, 0.5 * side)
    width, height = _BoxSide(1 - row.along, across), _BoxSide(2, stand, -0.5 * stand)
    return [_support_box([_range_side(row.along, beam), width, height]) for beam in row.beams]


def _feet(row: PanelRow, job: SawJob, stand: float) -> list[dict[str, Any]]:
    """Return the supports of a row on edge, ``stand`` [m] high, as shapes of a problem file."""
    thick = max(job.thickness - BEAM_DISTANCE_M, 0.5 * job.thickness)
    below = -0.5 * (job.size[row.axis] + stand)
    width, height = _BoxSide(2, thick), _BoxSide(row.axis, stand, below)
    boxes = [_support_box([_range_side(1 - row.axis, foot), width, height]) for foot in row.feet]
    for box_data in boxes:
        box_data["pose"]["xyz_mm"][2] = to_mm(0.5 * job.thickness)
    return boxes


@dataclasses.dataclass(frozen=True)
class _BoxSide:
    """Extent of a box along one axis.

    Attributes:
        axis: The axis, 0 to 2.
        size: Size along the axis [m].
        middle: Centre of the box along the axis [m].
    """

    axis: int
    size: float
    middle: float = 0.0


def _range_side(axis: int, ends: SupportRange) -> _BoxSide:
    """Return the extent of a support that covers a range [m] of an axis."""
    return _BoxSide(axis, ends[1] - ends[0], 0.5 * (ends[0] + ends[1]))


def _support_box(sides: Sequence[_BoxSide]) -> dict[str, Any]:
    """Return a support with three extents, one per axis, as a shape of a problem file."""
    size, middle = [0.0] * 3, [0.0] * 3
    for side in sides:
        size[side.axis] = side.size
        middle[side.axis] = side.middle
    return box_shape(size, middle)
