"""Rows of panels as ordinary problem files: all of their faces on one way each, then round each of them.

Faces are cut as the row lies flat: fronts as one surface from end to end of the row, then backs, with
straight runs between panels; of a slab, whose back is that of the block, the one plane that takes it to its
thickness. Then the operator stands the row on edge, and the wire, which spans the thickness, goes round each
panel, the uppermost first and its top last, so that nothing drops before it is cut.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.element_file import Element, SawTemplate
from planner.element.jobs import DIGITS, cut_figures, filled, pose_mm, ruled
from planner.element.nest import NestedBlock
from planner.element.rows import BACKS, Bearer, Row
from planner.element.saw_jobs import BESIDE, ENDS, SawJob, box, job_name, millimetres, problem_name
from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.reading import strict_yaml

FACES, OUTLINES = "faces", "outlines"
"""Names of the operations."""
TIED: Final = "Tie its layers together, spacers in their slots, before it is stood up."
"""What the operator does where faces were cut: a thin layer has nothing below it as the row is on edge."""


def _face(name: str, parts: Sequence[FloatArray]) -> dict[str, Any]:
    """Faces of panels as one surface, a straight run from each to the next; its corners are those of the
    runs, whatever else is bent."""
    start, end = np.concatenate(parts, axis=1)
    out = ruled(name, start, end, **({"flip": True} if name == BACKS else {}))
    ends = np.concatenate([part[:, [0, -1]] for part in parts], axis=1)[:, 1:-1]
    for side, corners in zip(("start", "end"), ends, strict=True):
        if len(corners):
            out[side]["corners_mm"] = [
                [round(v, DIGITS) + 0.0 for v in row] for row in (corners / MM).tolist()
            ]
    return out


def row_files(
    element: Element, template: SawTemplate, block: NestedBlock, before: int, stand: float
) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Problem files of the rows of a block by their places in the folder, and what ``element.json`` says of
    these jobs, which follow ``before`` others of the block."""
    files: dict[str, str] = {}
    data: list[dict[str, Any]] = []
    for number, row in enumerate(block.rows.values(), before + 1):
        name = job_name(block, number)
        flat = SawJob(name, row.part, block.size[2], 2, (), (), 0)
        edge = dataclasses.replace(flat, axis=row.axis, up=1)
        lies = flat if row.faces else edge
        problem = _problem(element, template, block, row, flat, edge, stand)
        ids = " ".join(row.outlines)
        head = f"# Panels {ids} of {element.file.name}, cut together out of {block.name}: {lies.said}. "
        files[f"blocks/{name}.yaml"] = f"{head}Written by tandem element.\n" + strict_yaml.dump(problem)
        data.append(_data(template, row, lies))
    return files, data


def _data(template: SawTemplate, row: Row, job: SawJob) -> dict[str, Any]:
    def way(_: Mapping[str, Any]) -> float:
        ways = [np.concatenate([ring, ring[:, :1]], axis=1) for ring in row.outlines.values()]
        ways += [np.concatenate(parts, axis=1) for parts in row.faces.values()]
        return sum(float(lengths(np.diff(one.mean(axis=0), axis=0)).sum()) for one in ways) / MM

    return {
        "id": job.name,
        "said": f"{', '.join(row.outlines)} together: {'faces on one way, then ' if row.faces else ''}round "
        f"each of them; {job.said}",
        "corner_mm": [millimetres(job.part.x), millimetres(job.part.y)],
        "size_mm": [millimetres(v) for v in job.size],
        "cuts": [],
        "panels": {name: pose_mm(place) for name, place in row.places.items()},
        **cut_figures(template, way, 2 if row.faces else 1),
    }


def _problem(
    element: Element,
    template: SawTemplate,
    block: NestedBlock,
    row: Row,
    flat: SawJob,
    edge: SawJob,
    stand: float,
) -> dict[str, Any]:
    shapes = [_face(name, parts) for name, parts in row.faces.items()]
    shapes += [ruled(name, ring[0], ring[1], closed=True) for name, ring in row.outlines.items()]
    stands = {"place": "auto", "roll_pitch_deg": edge.roll_pitch, "support": _feet(row, edge, stand)}
    lies = {"place": "auto", "roll_pitch_deg": flat.roll_pitch, "support": _beams(row, flat, stand)}
    stock = {"size_mm": [millimetres(v) for v in flat.size], **(lies if row.faces else stands)}
    out = filled(template, problem_name(element.file.name, flat.name), stock, block.foam, {"ruled": shapes})
    (one,) = out["operations"]
    given = one.get("setup") or {}

    def operation(
        name: str, setup: Mapping[str, Any], cuts: list[dict[str, Any]], **more: Any
    ) -> dict[str, Any]:
        return {**one, "name": name, "setup": setup, **more, "cuts": cuts}

    lead = {"lead": [float(k == row.axis) for k in range(3)]}
    round_each = [{"surface": name, **(lead if row.from_above(name) else {})} for name in row.outlines]

    each_face = [{"surface": name} for name in row.faces]
    whose = f"Block {block.name}: "
    round_them = f"{whose}{edge.said}. The wire goes round {', '.join(row.outlines)}."
    if not row.faces:
        out["operations"] = [operation(OUTLINES, {"note": round_them, **given}, round_each)]
        return out
    out["operations"] = [
        # what is above a slot must not drop before it is cut round
        operation(FACES, {"note": f"{whose}{flat.said}.", **given}, each_face, spacers=True),
        operation(OUTLINES, {**stands, "note": f"{round_them} {TIED}"}, round_each),
    ]
    return out


def _beams(row: Row, job: SawJob, stand: float) -> list[dict[str, Any]]:
    """What bears a row that lies flat, ``stand`` [m] high."""
    side = job.size[1 - row.along]
    across = max(side - 2.0 * ENDS, 0.5 * side)
    return [_bearer(row.along, bearer, 1 - row.along, across, 2, -0.5 * stand, stand) for bearer in row.beams]


def _feet(row: Row, job: SawJob, stand: float) -> list[dict[str, Any]]:
    thick = max(job.thickness - BESIDE, 0.5 * job.thickness)
    below = -0.5 * (job.size[row.axis] + stand)
    made = [_bearer(1 - row.axis, foot, 2, thick, row.axis, below, stand) for foot in row.feet]
    for one in made:
        one["pose"]["xyz_mm"][2] = millimetres(0.5 * job.thickness)
    return made


def _bearer(
    along: int, ends: Bearer, across: int, wide: float, up: int, middle: float, stand: float
) -> dict[str, Any]:
    size, at = [0.0] * 3, [0.0] * 3
    size[along], at[along] = ends[1] - ends[0], 0.5 * (ends[0] + ends[1])
    size[across] = wide
    size[up], at[up] = stand, middle
    return box(size, at)
