"""Raw blocks as ordinary problem files: a straight wire cuts each of them apart, stage by stage.

A stage is a part of a block that earlier stages have separated, with all parallel cuts through the whole of
it. The part lies flat, and the wire, level along the cut, goes down between beams that support the pieces and
comes back up through its slot, so nothing drops. If the bow does not span a cut, the part stands on edge: the
wire spans its thickness and goes along the cut, the uppermost cut first, so that what rests on a slot is not
cut again.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.block_nesting import (
    MAX_NAMED_CUTS,
    BlockNesting,
    NestedBlock,
    PanelBlock,
    level_cuts,
    nearest_alternative,
)
from planner.element.element_file import Element, JobTemplate, SawTemplate
from planner.element.jobs import cut_figures, fill_template
from planner.geometry.cut_tree import BlockPart, BowSize, CutStage
from planner.geometry.units import MM
from planner.issues import Issue, Severity
from planner.reading import strict_yaml

BEAM_DISTANCE_M: Final = 0.02
"""Distance [m] between a beam and the slots or edges of the part beside it."""
MIN_BEAM_M: Final = 0.01
"""Minimum width [m] of a beam. Pieces too narrow for it have none."""
SUPPORT_INSET_M: Final = 0.06
"""Distance [m] of the ends of supports from those of the part along the cuts, for the bow's prongs."""
_MAX_NAME_LENGTH: Final = 24  # letters that the name of a problem may have
_AXES: Final = "xyz"


@dataclasses.dataclass(frozen=True)
class SawJob:
    """One stage: a part of a block, its pose, and its cuts.

    Attributes:
        name: Id of the job.
        part: Part of the block.
        thickness: Thickness of the block [m].
        axis: Axis across the cuts; 2 for a level cut.
        cuts: Numbers of the cuts in order.
        positions: Positions [m] of the cuts along the axis, from the lower end of the part.
        up: Side along the axis that is up when the part stands on edge, 1 or -1; 0 if it lies flat.
    """

    name: str
    part: BlockPart
    thickness: float
    axis: int
    cuts: tuple[int, ...]
    positions: tuple[float, ...]
    up: int

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and thickness of the part [m]."""
        return self.part.length, self.part.width, self.thickness

    @property
    def cut_length(self) -> float:
        """Length [m] of the path of the wire through the foam in each cut."""
        if self.axis == 2:
            return max(self.size[:2])
        return self.size[1 - self.axis] if self.up else self.thickness

    @property
    def roll_pitch(self) -> list[float]:
        """Roll and pitch of the part [deg], as in a problem file."""
        angle = 90.0 * self.up
        return [angle, 0.0] if self.axis == 1 else [0.0, -angle]

    @property
    def description(self) -> str:
        """Description of the part and its pose, for the operator."""
        size = " x ".join(f"{to_mm(v):g}" for v in self.size)
        side = f"on edge, its {'+' if self.up > 0 else '-'}{_AXES[self.axis]} side up" if self.up else "flat"
        corner = f"({to_mm(self.part.x):g}, {to_mm(self.part.y):g})"
        return f"the part of {size} mm at {corner}, {side}"


def saw_jobs(
    block: NestedBlock, panels: Sequence[PanelBlock], kerf: float, bow: BowSize, margin: float
) -> tuple[SawJob, ...]:
    """Return the stages of a block: parts in the order of its tree, level cuts last.

    ``margin`` [m] is the minimum distance of the foam from the ends of the wire and from the beam.
    """
    thick = block.size[2]

    def lies_flat(stage: CutStage) -> bool:
        return bow.reaches_horizontal(stage.cuts[0][1].length, thick, margin)

    def cut_together(stage: CutStage) -> bool:
        return lies_flat(stage) or _height_above_cuts(stage, kerf)[0] + margin <= bow.throat

    jobs: list[tuple[BlockPart, int, tuple[int, ...], tuple[float, ...], int]] = []
    for stage in block.tree.stages(cut_together):
        axis = stage.cuts[0][1].axis
        up = 0 if lies_flat(stage) else _height_above_cuts(stage, kerf)[1]
        cuts = stage.cuts[::-1] if up > 0 else stage.cuts
        low = (stage.part.x, stage.part.y)[axis]
        positions = tuple(cut.position - low for _, cut in cuts)
        jobs.append((stage.part, axis, tuple(number for number, _ in cuts), positions, up))
    boxes = {block.panel(part.box): part for part in block.boxes()}
    for number, i, _ in level_cuts(block, panels, kerf):
        jobs.append((boxes[i], 2, (number,), (panels[i].thickness,), 0))
    names = [job_name(block, n) for n in range(1, len(jobs) + 1)]
    return tuple(
        SawJob(name, part, thick, axis, cuts, positions, up)
        for name, (part, axis, cuts, positions, up) in zip(names, jobs, strict=True)
    )


def job_name(block: NestedBlock, number: int) -> str:
    """Return the id of a job of a block; ``number`` counts from 1."""
    return block.name if number == 1 else f"{block.name}-{number}"


def _height_above_cuts(stage: CutStage, kerf: float) -> tuple[float, int]:
    """Return the smallest height [m] of a part on edge above its lowest cut, and which side is then up."""
    axis = stage.cuts[0][1].axis
    low, size = (stage.part.x, stage.part.length) if axis == 0 else (stage.part.y, stage.part.width)
    first, last = stage.cuts[0][1].position - low, stage.cuts[-1][1].position - low + kerf
    return (size - first, 1) if size - first <= last else (last, -1)


def saw_files(
    element: Element, template: SawTemplate, nesting: BlockNesting, panels: Sequence[PanelBlock]
) -> tuple[dict[str, str], dict[str, list[dict[str, Any]]], tuple[Issue, ...]]:
    """Return the problem files of all blocks by path, the data of their jobs by block, and issues.

    All are empty if the element does not state raw blocks and how they are cut.
    """
    spec, bow = element.file, template.bow
    raw, cut = spec.raw_blocks, spec.cut_blocks
    if raw is None or cut is None:
        return {}, {}, ()
    kerf = raw.kerf_mm * MM
    margin = template.margin
    files: dict[str, str] = {}
    data: dict[str, list[dict[str, Any]]] = {}
    unreachable: list[tuple[str, float, float]] = []
    for block in nesting.blocks:
        data[block.name] = []
        for job in saw_jobs(block, panels, kerf, bow, margin):
            name = problem_name(spec.name, job.name)
            problem = _problem(template, name, job, block, kerf, cut.stand_mm * MM)
            comment = f"# Block {block.name} of {spec.name}: {job.description}. Written by tandem element.\n"
            files[f"blocks/{job.name}.yaml"] = comment + strict_yaml.dump(problem)
            data[block.name].append(_data(job, template))
            alternatives = _required_bows(job, kerf, margin)
            if not any(bow.span >= span and bow.throat >= throat for span, throat in alternatives):
                unreachable.append((job.name, *nearest_alternative(alternatives, bow)))
    return files, data, _reach_issues(unreachable, template)


def _required_bows(job: SawJob, kerf: float, margin: float) -> tuple[tuple[float, float], ...]:
    """Return the alternatives (span, throat) [m] of a bow that can cut a job: lying flat, then on edge."""
    span, throat = 2.0 * margin, job.thickness + 2.0 * margin
    if job.axis == 2:
        return ((min(job.size[:2]) + span, throat),)
    first, last = min(job.positions), max(job.positions) + kerf
    above = min(job.size[job.axis] - first, last) + margin
    return (job.size[1 - job.axis] + span, throat), (job.thickness + span, above)


def _reach_issues(unreachable: list[tuple[str, float, float]], template: SawTemplate) -> tuple[Issue, ...]:
    """Return one ``element.cut`` for jobs (id, span, throat [m]) that the bow cannot reach, if any."""
    if not unreachable:
        return ()
    bow = template.bow
    required = (
        max(bow.span, *(job[1] for job in unreachable)),
        max(bow.throat, *(job[2] for job in unreachable)),
    )
    names = ", ".join(name for name, _, _ in unreachable[:MAX_NAMED_CUTS])
    remainder = f" and {len(unreachable) - MAX_NAMED_CUTS} more" if len(unreachable) > MAX_NAMED_CUTS else ""
    message = (
        f"{len(unreachable)} jobs of raw blocks are out of reach of the bow of {template.file}, which has a "
        f"span of {bow.span / MM:g} and a throat of {bow.throat / MM:g} mm: {names}{remainder}"
    )
    span, throat = (np.ceil(v / MM - 1e-6) for v in required)
    hint = f"use a bow with {{span_mm: {span:.0f}, throat_mm: {throat:.0f}}}, or smaller raw blocks; "
    hint += "otherwise cut those by hand"
    return (Issue("element.cut", message, Severity.WARNING, field="cut_blocks", hint=hint),)


def problem_name(element: str, job: str) -> str:
    """Return the name of the problem of a job, at most `_MAX_NAME_LENGTH` letters."""
    return f"{element[: _MAX_NAME_LENGTH - 1 - len(job)]}_{job.replace('-', '_')}"


def to_mm(value: float) -> float:
    """Return a length [m] in mm, rounded as in files."""
    return round(value / MM, 3) + 0.0


def _data(job: SawJob, template: JobTemplate) -> dict[str, Any]:
    """Return the data of a job for ``element.json``."""

    def cut_length(operation: Mapping[str, Any]) -> float:
        return len(job.cuts) * job.cut_length / MM

    return {
        "id": job.name,
        "said": f"cut{'s' * (len(job.cuts) > 1)} {', '.join(str(n) for n in job.cuts)}: {job.description}",
        "corner_mm": [to_mm(job.part.x), to_mm(job.part.y)],
        "size_mm": [to_mm(v) for v in job.size],
        "cuts": list(job.cuts),
        **cut_figures(template, cut_length),
    }


def _problem(
    template: JobTemplate, name: str, job: SawJob, block: NestedBlock, kerf: float, stand: float
) -> dict[str, Any]:
    """Return the problem of a job: the template with its stock, supports and cuts."""
    stock = {
        "size_mm": [to_mm(v) for v in job.size],
        "place": "auto",
        "roll_pitch_deg": job.roll_pitch,
        "support": [box_shape(size, middle) for size, middle in _support_boxes(job, kerf, stand)],
    }
    planes = [
        _cut_plane(job, number, position) for number, position in zip(job.cuts, job.positions, strict=True)
    ]
    out = fill_template(template, name, stock, block.foam, {"ruled": planes})
    # lying flat, the wire goes down through a slot and comes back up through it
    back = {"leave": "back"} if job.axis < 2 and not job.up else {}
    operation = out["operations"][0]
    operation["setup"] = {"note": f"Block {block.name}: {job.description}.", **(operation.get("setup") or {})}
    operation["cuts"] = [{"surface": plane["name"], **back} for plane in planes]
    return out


def box_shape(size: Sequence[float], middle: Sequence[float]) -> dict[str, Any]:
    """Return a box of ``size`` (3,) [m] centred at ``middle`` (3,) [m] as a shape of a problem file."""
    return {
        "kind": "box",
        "size_mm": [to_mm(v) for v in size],
        "pose": {"xyz_mm": [to_mm(v) for v in middle]},
    }


def _support_boxes(job: SawJob, kerf: float, stand: float) -> Iterator[tuple[list[float], list[float]]]:
    """Yield sizes and centres (3,) [m] of supports, ``stand`` [m] high, in the frame of the part.

    A part on edge stands on one wall. A flat part has a beam below each piece between two cuts.
    """
    size, middle = [0.0] * 3, [0.0] * 3
    across = job.axis if job.axis < 2 else 0
    along = 1 - across
    size[along] = max(job.size[along] - 2.0 * SUPPORT_INSET_M, 0.5 * job.size[along])
    if job.up:
        size[across], middle[across] = stand, -job.up * 0.5 * (job.size[across] + stand)
        size[2] = max(job.thickness - BEAM_DISTANCE_M, 0.5 * job.thickness)
        middle[2] = 0.5 * job.thickness
        yield size, middle
        return
    size[2], middle[2] = stand, -0.5 * stand
    start, ends = 0.0, sorted(job.positions) if job.axis < 2 else []
    for end in (*ends, job.size[across]):
        if end - start - 2.0 * BEAM_DISTANCE_M >= MIN_BEAM_M:
            size[across] = end - start - 2.0 * BEAM_DISTANCE_M
            middle[across] = 0.5 * (start + end - job.size[across])
            yield list(size), list(middle)
        start = end + kerf


def _cut_plane(job: SawJob, number: int, position: float) -> dict[str, Any]:
    """Return the lower face of a cut's slot as a ruled surface across the part, its normal into the slot."""
    low = [-0.5 * job.part.length, -0.5 * job.part.width, 0.0]
    high = [0.5 * job.part.length, 0.5 * job.part.width, job.thickness]
    if job.axis == 2:  # the wire spans the shorter side
        wire, motion_axis = (1, 0) if job.part.width <= job.part.length else (0, 1)
    elif job.up:
        wire, motion_axis = 2, 1 - job.axis
    else:
        wire, motion_axis = 1 - job.axis, 2
    start, end = (
        (high[motion_axis], low[motion_axis]) if motion_axis == 2 else (low[motion_axis], high[motion_axis])
    )
    sides = (low[wire], high[wire])
    # the normal is (direction of motion) x (direction of the wire); y x x and x x z point down
    flipped = job.axis == 1 or (job.axis == 2 and wire == 0)
    if flipped and motion_axis == 2:  # flip would also reverse the motion: upward, starting between the beams
        sides, flipped = sides[::-1], False

    def guide(side: float) -> dict[str, Any]:
        """Return the path of one end of the wire, as a guide of the surface."""
        points = []
        for motion_position in (start, end):
            point = [0.0] * 3
            point[job.axis] = low[job.axis] + position
            point[wire] = side
            point[motion_axis] = motion_position
            points.append([to_mm(v) for v in point])
        return {"polyline_mm": points}

    return {
        "name": f"cut{number}",
        **({"flip": True} if flipped else {}),
        "match": "parameter",
        "start": guide(sides[0]),
        "end": guide(sides[1]),
    }
