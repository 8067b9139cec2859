"""Raw blocks as ordinary problem files: a straight wire cuts each of them apart, stage by stage.

A stage is a part of a block that lies alone by then, with all cuts side by side through the whole of it. It
lies flat, and the wire, level along the cut, goes down between beams that bear the pieces and comes back up
through its slot: nothing drops. Where the bow does not span a cut, the part stands on edge: the wire spans
its thickness and goes along the cut, the uppermost cut first, so that what rests on a slot is not cut again.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.element.element_file import Element, SawTemplate, Template
from planner.element.jobs import cut_figures, filled
from planner.element.nest import MOST_NAMED, NestedBlock, Nesting, PanelBlock, level_cuts, nearest
from planner.geometry.cut_tree import Bow, Part, Stage
from planner.geometry.units import MM
from planner.issues import Issue, Severity
from planner.reading import strict_yaml

BESIDE: Final = 0.02
"""Room [m] between beams and the slots or rims beside them."""
LEAST_BEAM: Final = 0.01
"""Pieces whose beam would be narrower [m] have none."""
ENDS: Final = 0.06
"""What bears a part ends so far [m] within it, along the cuts: the bow's prongs pass there."""
_LONGEST: Final = 24  # letters that the name of a problem may have
_AXES: Final = "xyz"


@dataclasses.dataclass(frozen=True)
class SawJob:
    """One stage: its ``name``, the ``part`` of a block ``thickness`` [m] thick, its ``cuts`` in their order
    with their numbers, all along ``axis`` at ``places`` [m] from the part's lower end. ``up``: the side
    along that axis which is up where it stands on edge, 1 or -1; 0 where it lies."""

    name: str
    part: Part
    thickness: float
    axis: int
    cuts: tuple[int, ...]
    places: tuple[float, ...]
    up: int

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and thickness of the part [m]."""
        return self.part.length, self.part.width, self.thickness

    @property
    def way(self) -> float:
        """How far [m] the wire goes in the foam for each cut."""
        if self.axis == 2:
            return max(self.size[:2])
        return self.size[1 - self.axis] if self.up else self.thickness

    @property
    def roll_pitch(self) -> list[float]:
        """How the part is turned as it stands [deg], as a problem file has it."""
        turn = 90.0 * self.up
        return [turn, 0.0] if self.axis == 1 else [0.0, -turn]

    @property
    def said(self) -> str:
        """Which part of the block it is and how it lies, for the operator."""
        size = " x ".join(f"{millimetres(v):g}" for v in self.size)
        side = f"on edge, its {'+' if self.up > 0 else '-'}{_AXES[self.axis]} side up" if self.up else "flat"
        corner = f"({millimetres(self.part.x):g}, {millimetres(self.part.y):g})"
        return f"the part of {size} mm at {corner}, {side}"


def saw_jobs(
    block: NestedBlock, panels: Sequence[PanelBlock], kerf: float, bow: Bow, margin: float
) -> tuple[SawJob, ...]:
    """The stages of a block: parts in the order of its tree, level cuts last. ``margin`` [m] of foam to the
    wire's ends and to the beam."""
    thick = block.size[2]

    def lies(stage: Stage) -> bool:
        return bow.reaches_lying(stage.cuts[0][1].along, thick, margin)

    def together(stage: Stage) -> bool:
        return lies(stage) or _above(stage, kerf)[0] + margin <= bow.throat

    jobs: list[tuple[Part, int, tuple[int, ...], tuple[float, ...], int]] = []
    for stage in block.tree.stages(together):
        axis = stage.cuts[0][1].axis
        up = 0 if lies(stage) else _above(stage, kerf)[1]
        cuts = stage.cuts[::-1] if up > 0 else stage.cuts
        low = (stage.part.x, stage.part.y)[axis]
        places = tuple(cut.place - low for _, cut in cuts)
        jobs.append((stage.part, axis, tuple(number for number, _ in cuts), places, up))
    boxes = {block.panel(part.box): part for part in block.boxes()}
    for number, i, _ in level_cuts(block, panels, kerf):
        jobs.append((boxes[i], 2, (number,), (panels[i].thickness,), 0))
    names = [job_name(block, n) for n in range(1, len(jobs) + 1)]
    return tuple(
        SawJob(name, part, thick, axis, cuts, places, up)
        for name, (part, axis, cuts, places, up) in zip(names, jobs, strict=True)
    )


def job_name(block: NestedBlock, number: int) -> str:
    """The id of a block's job, counted from 1."""
    return block.name if number == 1 else f"{block.name}-{number}"


def _above(stage: Stage, kerf: float) -> tuple[float, int]:
    """How high [m] a part on edge reaches above its lowest cut, and which of its sides is up for that to be
    least."""
    axis = stage.cuts[0][1].axis
    low, size = (stage.part.x, stage.part.length) if axis == 0 else (stage.part.y, stage.part.width)
    first, last = stage.cuts[0][1].place - low, stage.cuts[-1][1].place - low + kerf
    return (size - first, 1) if size - first <= last else (last, -1)


def saw_files(
    element: Element, template: SawTemplate, made: Nesting, panels: Sequence[PanelBlock]
) -> tuple[dict[str, str], dict[str, list[dict[str, Any]]], tuple[Issue, ...]]:
    """Problem files of all blocks by their places in the folder, what ``element.json`` says of them, by
    block, and what is to be said."""
    spec, bow = element.file, template.bow
    raw, cut = spec.raw_blocks, spec.cut_blocks
    if raw is None or cut is None:
        return {}, {}, ()
    kerf = raw.kerf_mm * MM
    margin = template.margin
    files: dict[str, str] = {}
    data: dict[str, list[dict[str, Any]]] = {}
    found: list[tuple[str, float, float]] = []
    for block in made.blocks:
        data[block.name] = []
        for job in saw_jobs(block, panels, kerf, bow, margin):
            name = problem_name(spec.name, job.name)
            problem = _problem(template, name, job, block, kerf, cut.stand_mm * MM)
            head = f"# Block {block.name} of {spec.name}: {job.said}. Written by tandem element.\n"
            files[f"blocks/{job.name}.yaml"] = head + strict_yaml.dump(problem)
            data[block.name].append(_data(job, template))
            ways = _needs(job, kerf, margin)
            if not any(bow.span >= span and bow.throat >= throat for span, throat in ways):
                found.append((job.name, *nearest(ways, bow)))
    return files, data, _told(found, template)


def _needs(job: SawJob, kerf: float, margin: float) -> tuple[tuple[float, float], ...]:
    """Span and throat [m] that a job takes, one pair for each way to make it."""
    span, throat = 2.0 * margin, job.thickness + 2.0 * margin
    if job.axis == 2:
        return ((min(job.size[:2]) + span, throat),)
    first, last = min(job.places), max(job.places) + kerf
    above = min(job.size[job.axis] - first, last) + margin
    return (job.size[1 - job.axis] + span, throat), (job.thickness + span, above)


def _told(found: list[tuple[str, float, float]], template: SawTemplate) -> tuple[Issue, ...]:
    """``element.cut`` for jobs that the bow of the template cannot reach, with the bow that would."""
    if not found:
        return ()
    bow = template.bow
    wanted = max(bow.span, *(f[1] for f in found)), max(bow.throat, *(f[2] for f in found))
    names = ", ".join(name for name, _, _ in found[:MOST_NAMED])
    more = f" and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    what = (
        f"{len(found)} jobs of raw blocks are out of reach of the bow of {template.file}, which has a span "
        f"of {bow.span / MM:g} and a throat of {bow.throat / MM:g} mm: {names}{more}"
    )
    span, throat = (np.ceil(v / MM - 1e-6) for v in wanted)
    hint = f"take a bow with {{span_mm: {span:.0f}, throat_mm: {throat:.0f}}}, or smaller raw blocks; cut "
    hint += "those by hand otherwise"
    return (Issue("element.cut", what, Severity.WARNING, field="cut_blocks", hint=hint),)


def problem_name(element: str, job: str) -> str:
    """The name of the problem of a job."""
    return f"{element[: _LONGEST - 1 - len(job)]}_{job.replace('-', '_')}"


def millimetres(value: float) -> float:
    """A length [m] as files have it."""
    return round(value / MM, 3) + 0.0


def _data(job: SawJob, template: Template) -> dict[str, Any]:
    def way(operation: Mapping[str, Any]) -> float:
        return len(job.cuts) * job.way / MM

    return {
        "id": job.name,
        "said": f"cut{'s' * (len(job.cuts) > 1)} {', '.join(str(n) for n in job.cuts)}: {job.said}",
        "corner_mm": [millimetres(job.part.x), millimetres(job.part.y)],
        "size_mm": [millimetres(v) for v in job.size],
        "cuts": list(job.cuts),
        **cut_figures(template, way),
    }


def _problem(
    template: Template, name: str, job: SawJob, block: NestedBlock, kerf: float, stand: float
) -> dict[str, Any]:
    stock = {
        "size_mm": [millimetres(v) for v in job.size],
        "place": "auto",
        "roll_pitch_deg": job.roll_pitch,
        "support": [box(size, middle) for size, middle in _bearers(job, kerf, stand)],
    }
    planes = [_plane(job, number, place) for number, place in zip(job.cuts, job.places, strict=True)]
    out = filled(template, name, stock, block.foam, {"ruled": planes})
    back = {"leave": "back"} if job.axis < 2 and not job.up else {}
    operation = out["operations"][0]
    operation["setup"] = {"note": f"Block {block.name}: {job.said}.", **(operation.get("setup") or {})}
    operation["cuts"] = [{"surface": plane["name"], **back} for plane in planes]
    return out


def box(size: Sequence[float], middle: Sequence[float]) -> dict[str, Any]:
    """A box (3,) about its ``middle`` (3,) [m] as shapes of a problem file are."""
    return {
        "kind": "box",
        "size_mm": [millimetres(v) for v in size],
        "pose": {"xyz_mm": [millimetres(v) for v in middle]},
    }


def _bearers(job: SawJob, kerf: float, stand: float) -> Iterator[tuple[list[float], list[float]]]:
    """Sizes and middles (3,) [m], in the frame of the part, of what bears it, ``stand`` [m] high: a wall
    below its edge, or a beam below each piece."""
    size, middle = [0.0] * 3, [0.0] * 3
    across = job.axis if job.axis < 2 else 0
    along = 1 - across
    size[along] = max(job.size[along] - 2.0 * ENDS, 0.5 * job.size[along])
    if job.up:
        size[across], middle[across] = stand, -job.up * 0.5 * (job.size[across] + stand)
        size[2] = max(job.thickness - BESIDE, 0.5 * job.thickness)
        middle[2] = 0.5 * job.thickness
        yield size, middle
        return
    size[2], middle[2] = stand, -0.5 * stand
    begin, ends = 0.0, sorted(job.places) if job.axis < 2 else []
    for end in (*ends, job.size[across]):
        if end - begin - 2.0 * BESIDE >= LEAST_BEAM:
            size[across] = end - begin - 2.0 * BESIDE
            middle[across] = 0.5 * (begin + end - job.size[across])
            yield list(size), list(middle)
        begin = end + kerf


def _plane(job: SawJob, number: int, place: float) -> dict[str, Any]:
    """The lower face of a cut's slot, from face to face of the part, its normal into the slot."""
    low = [-0.5 * job.part.length, -0.5 * job.part.width, 0.0]
    high = [0.5 * job.part.length, 0.5 * job.part.width, job.thickness]
    if job.axis == 2:  # the wire spans the shorter side
        wire, way = (1, 0) if job.part.width <= job.part.length else (0, 1)
    elif job.up:
        wire, way = 2, 1 - job.axis
    else:
        wire, way = 1 - job.axis, 2
    begin, end = (high[way], low[way]) if way == 2 else (low[way], high[way])
    sides = (low[wire], high[wire])
    # the normal is that of the way times the wire; y times x and x times z point down
    flipped = job.axis == 1 or (job.axis == 2 and wire == 0)
    if flipped and way == 2:  # flip would turn the way too: from below, between the beams
        sides, flipped = sides[::-1], False

    def ruling_ends(side: float) -> dict[str, Any]:
        points = []
        for at in (begin, end):
            point = [0.0] * 3
            point[job.axis], point[wire], point[way] = low[job.axis] + place, side, at
            points.append([millimetres(v) for v in point])
        return {"polyline_mm": points}

    return {
        "name": f"cut{number}",
        **({"flip": True} if flipped else {}),
        "match": "parameter",
        "start": ruling_ends(sides[0]),
        "end": ruling_ends(sides[1]),
    }
