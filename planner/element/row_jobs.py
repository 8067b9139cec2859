"""Rows of panels as ordinary problem files: all of their faces in one pass each, then around each panel.

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
"""Names of the operations."""
TIE_INSTRUCTION: Final = "Put spacers into the slots and tie the layers together before it is put on edge."
"""Instruction if faces were cut: a thin layer has nothing below it while the row is on edge."""


@dataclasses.dataclass(frozen=True)
class _RowJob:
    """A row with the poses in which it is cut.

    Attributes:
        row: The row.
        flat: The job while the row lies flat.
    """

    row: PanelRow
    flat: SawJob

    @property
    def edge(self) -> SawJob:
        """The job while the row is on edge."""
        return dataclasses.replace(self.flat, axis=self.row.axis, up=1)

    @property
    def first(self) -> SawJob:
        """The job in the pose in which the row is cut first."""
        return self.flat if self.row.faces else self.edge


def _combined_face(name: str, parts: Sequence[FloatArray]) -> dict[str, Any]:
    """Return faces of panels as one surface, with a straight run from each to the next.

    Its corners are those of the runs.
    """
    start, end = np.concatenate(parts, axis=1)
    out = ruled_surface(name, start, end, **({"flip": True} if name == BACKS else {}))
    ends = np.concatenate([part[:, [0, -1]] for part in parts], axis=1)[:, 1:-1]
    for side, corners in zip(("start", "end"), ends, strict=True):
        if len(corners):
            out[side]["corners_mm"] = [
                [round(v, DIGITS) + 0.0 for v in row] for row in (corners / MM).tolist()
            ]
    return out


def row_files(
    element: Element, template: SawTemplate, block: NestedBlock, previous_jobs: int, stand: float
) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Return problem files of the rows of a block by path, and the data of these jobs for ``element.json``.

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
        ids, lies = " ".join(row.outlines), job.first
        head = (
            f"# Panels {ids} of {element.file.name}, cut together out of {block.name}: {lies.description}. "
        )
        files[f"blocks/{name}.yaml"] = f"{head}Written by tandem element.\n" + strict_yaml.dump(problem)
        data.append(_data(template, row, lies))
    return files, data


def _data(template: SawTemplate, row: PanelRow, job: SawJob) -> dict[str, Any]:
    def cut_length(_: Mapping[str, Any]) -> float:
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
    given = operation_data.get("setup") or {}

    def operation(
        name: str, setup: Mapping[str, Any], cuts: list[dict[str, Any]], **more: Any
    ) -> dict[str, Any]:
        return {**operation_data, "name": name, "setup": setup, **more, "cuts": cuts}

    lead = {"lead": [float(k == row.axis) for k in range(3)]}
    round_each = [{"surface": name, **(lead if row.is_free_above(name) else {})} for name in row.outlines]

    each_face = [{"surface": name} for name in row.faces]
    whose = f"Block {block.name}: "
    round_them = f"{whose}{edge.description}. The wire goes around {', '.join(row.outlines)}."
    if not row.faces:
        out["operations"] = [operation(OUTLINES, {"note": round_them, **given}, round_each)]
        return out
    out["operations"] = [
        # what is above a slot must not drop before it is cut around
        operation(FACES, {"note": f"{whose}{flat.description}.", **given}, each_face, spacers=True),
        operation(OUTLINES, {**edge_stock, "note": f"{round_them} {TIE_INSTRUCTION}"}, round_each),
    ]
    return out


def _beams(row: PanelRow, job: SawJob, stand: float) -> list[dict[str, Any]]:
    """Return the supports of a row that lies flat, ``stand`` [m] high."""
    side = job.size[1 - row.along]
    across = max(side - 2.0 * SUPPORT_INSET_M, 0.5 * side)
    width, height = _BoxSide(1 - row.along, across), _BoxSide(2, stand, -0.5 * stand)
    return [_support_box([_range_side(row.along, beam), width, height]) for beam in row.beams]


def _feet(row: PanelRow, job: SawJob, stand: float) -> list[dict[str, Any]]:
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
    """Return the side of a support that covers a range of an axis."""
    return _BoxSide(axis, ends[1] - ends[0], 0.5 * (ends[0] + ends[1]))


def _support_box(sides: Sequence[_BoxSide]) -> dict[str, Any]:
    """Return a support with its three sides as a shape of a problem file."""
    size, at = [0.0] * 3, [0.0] * 3
    for side in sides:
        size[side.axis], at[side.axis] = side.size, side.middle
    return box_shape(size, at)
