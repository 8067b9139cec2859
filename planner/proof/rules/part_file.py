"""verify.part_file: what the proof itself reads of the part's files, against the simulated part.

What is to be made, in which segments and how well, follows from the operations; the surfaces from
the proof's own readers (`files`) of the files and the problem's numbers. A part is where the
problem puts it; where it leaves that open, a rigid motion, without mirror or scale, has to bring
all surfaces at once onto what the programs make, within the block.
"""

import dataclasses
import itertools
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue
from planner.proof.context import Context
from planner.proof.contribution import of_processes
from planner.proof.findings import in_mm, in_percent
from planner.proof.part_files import Samples, UnreadError, comparison, on_triangles, pose
from planner.proof.part_files.made import ALL_RULED, Made, MadeSheet, MadeSurfaces, Wanted
from planner.proof.part_files.surfaces import Surface, stated
from planner.proof.rule import Outcome, issue, mm, rule

PART_FILE: Final = "verify.part_file"
"""Code of this rule."""
FEWEST_PLACES: Final = 500
"""Places of a file that are looked at, at least."""
FEWEST_PLACES_OF_STRIP: Final = 100
"""The same, where the operation leaves a strip along the edge."""
SHARE_NOISE: Final = 0.03
"""So much less than the wanted share may be good of the places: 600 of them tell a share within 3 % (three
standard deviations at 95 %)."""
READING_ERROR: Final = 2e-5
"""Two readings follow curves within 0.01 mm each [m]."""
MOST_STANDING_OUT: Final = 1e-4
"""A part that is laid by hand here may stand out of the block by so much [m]."""
_TARGET_PLACES: Final = 20_000
"""Places of the claimed surfaces that a file is compared with."""


@dataclasses.dataclass
class _Found:
    """What the rule has found so far: issues, places looked at by file, and the worst share left."""

    issues: list[Issue] = dataclasses.field(default_factory=list)
    looked: dict[str, int] = dataclasses.field(default_factory=dict)
    room: float = np.inf
    share: float = 1.0
    limit: float = 1.0

    def record(self, file: str, places: int, share: float, limit: float) -> None:
        """Count places of a file, with the share of them that is good and the one that is wanted."""
        self.looked[file] = self.looked.get(file, 0) + places
        if share - limit < self.room:
            self.room, self.share, self.limit = share - limit, share, limit

    def outcome(self) -> Outcome:
        """The outcome of the rule."""
        told = ", ".join(f"{count} places of {file}" for file, count in self.looked.items())
        if not self.looked:
            return Outcome(tuple(self.issues), nothing="no operation makes what the problem states")
        return Outcome(tuple(self.issues), 100 * self.share, 100 * self.limit, "% as read again", told)


@rule("verify.part_file")
def part_file(context: Context) -> Outcome:
    """The part as the proof itself reads it from its file, or from the problem's numbers, is what the
    programs make, at places all over it."""
    found = _Found()
    try:
        part = context.problem.source.get("part")
        if part and part.get("sheet_mesh"):
            for one in of_processes(context.problem):
                sheet = None if one.made_sheet is None else one.made_sheet(context, part)
                if sheet is not None:
                    _judge_sheet(sheet, found)
        elif part:
            _surfaces(context, part, found)
        elif context.problem.part is not None and context.problem.source:  # else a part of values in Python
            what = (
                "the problem has a part that its file does not state; state it there, or take the file "
                "away (source={}) for a problem of values alone"
            )
            found.issues.append(Issue(PART_FILE, what, field="part"))
    except UnreadError as error:
        found.issues.append(Issue(PART_FILE, f"{error}; export it anew, or convert it", field="part"))
    return found.outcome()


def _surfaces(context: Context, part: Any, found: _Found) -> None:
    block = np.asarray(context.problem.stock.size)
    made = [one.made_surfaces for one in of_processes(context.problem) if one.made_surfaces is not None]
    wanted = [
        one for operation in context.problem.operations for own in made for one in own.wanted(operation)
    ]
    whole = {one.name for one in wanted}
    surfaces = stated(part, float(block[2]), not whole.isdisjoint((ALL_RULED, "edges")))
    at = _stated_place(part, surfaces, block)
    pairs = _paired(surfaces, _made(context, part, surfaces, (made, wanted), found), at, found)
    if not pairs:
        return
    if at is None:
        at = _place(surfaces, pairs, block)
        _lies_well(surfaces, at, block, found)
    for surface, one in pairs:
        if surface.part_of:
            _lies_on(surface, one, at, found)
            continue
        # where guides fit in several ways, any of them is what the problem says
        tried = [_Tried(surface, one, own.moved(at), at) for own in surface.samples]
        max(tried, key=lambda each: each.share).judge(found)


def _made(
    context: Context,
    part: Any,
    surfaces: Sequence[Surface],
    asked: tuple[Sequence[MadeSurfaces], Sequence[Wanted]],
    found: _Found,
) -> list[Made]:
    """What the programs make of what is wanted; ``asked`` are the processes, and what is wanted of them."""
    processes, wanted = asked
    out: list[Made] = []
    faces = ("front", "back") if part.get("front") else ()  # ruled surfaces may have these names too
    ruled = [surface.name for surface in surfaces if surface.name not in faces]
    for one in wanted:
        every: Sequence[str] = (one.name,)
        if one.name == ALL_RULED:
            every = ruled
            if part.get("plate"):
                # outlines have no names in the problem: as many as it states have to be cut
                form = re.compile(r"(?:outline|hole)_[a-z]+")
                every = [name for own in processes for name in own.names(context) if form.fullmatch(name)]
                if len(every) != len(ruled):
                    what = f"{len(every)} outlines are cut; the part, read once more, has {len(ruled)}"
                    count = len(every), len(ruled), None
                    found.issues.append(issue(PART_FILE, what, count, field="part.plate"))
        for name in every:
            made = [each for own in processes for each in own.made(context, one, name)]
            if not made:
                segment = Segment(one.kind, name).folded
                what = f"the problem wants {name} made, and nothing is claimed of {segment}"
                found.issues.append(Issue(PART_FILE, what, field=str(segment)))
            out += made
    return out


def _paired(
    surfaces: Sequence[Surface], made: Sequence[Made], at: FloatArray | None, found: _Found
) -> list[tuple[Surface, Made]]:
    """Each thing that is made with the surface that was read, outlines of a plate by where they are. A
    surface may be made more than once, roughly and then finely; outlines, which have no names, once each."""
    out: list[tuple[Surface, Made]] = []
    left = list(surfaces)
    for one in made:
        base = one.name.split("_", 1)[0]
        named = [surface for surface in surfaces if surface.name == one.name]
        if named:
            out.append((named[0], one))
            left = [surface for surface in left if surface is not named[0]]
            continue
        fits: list[int] = []
        if at is not None:
            fits = [
                k for k, surface in enumerate(left) if surface.name == base and base in comparison.OUTLINES
            ]
            box = _box(one.vertices)
            far = [np.abs(_box(left[k].bound @ at[:3, :3].T + at[:3, 3]) - box).max() for k in fits]
            fits = [fits[int(np.argmin(far))]] if fits else []
        if fits:
            out.append((left.pop(fits[0]), one))
            continue
        what = f"{one.segment} makes {one.name}, which the part, read once more, does not have"
        found.issues.append(Issue(PART_FILE, what, field=one.segment))
    return out


def _box(points: FloatArray) -> FloatArray:
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _stated_place(part: Any, surfaces: Sequence[Surface], block: FloatArray) -> FloatArray | None:
    """The part's frame (4, 4) in that of the block, None where the problem leaves it open: outlines are in
    the middle, turned by a quarter where they fit only so."""
    said = part.get("in_stock")
    if said is not None and not isinstance(said, str):
        return pose(said)
    if not part.get("plate"):
        return None
    low, high = _box(np.concatenate([surface.bound for surface in surfaces]))
    wide = (high - low)[:2]
    out = np.eye(4)
    if (wide > block[:2] + 1e-9).any() and (wide[::-1] <= block[:2] + 1e-9).all():
        out[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    out[:2, 3] = -out[:2, :2] @ (0.5 * (low + high))[:2]
    return out


def _place(
    surfaces: Sequence[Surface], pairs: Sequence[tuple[Surface, Made]], block: FloatArray
) -> FloatArray:
    """The place of a part, in the middle of the block, that fits what is made best, over the ways in which
    its guides may be joined."""
    if any(surface.part_of for surface in surfaces):
        surface, one = pairs[0]
        return comparison.found_piece(
            comparison.of_claim(one, FEWEST_PLACES),
            on_triangles(surface.facets, np.arange(len(surface.facets)) + 1, _TARGET_PLACES),
        )
    target = [comparison.of_claim(one, _TARGET_PLACES // len(pairs)) for _, one in pairs]
    bound, middle = np.concatenate([s.bound for s in surfaces]), np.array([0.0, 0.0, 0.5 * block[2]])
    tried = []
    ways = range(max(len(surface.samples) for surface, _ in pairs))
    for all_around, k in itertools.product((False, True), ways):
        source = [surface.samples[min(k, len(surface.samples) - 1)] for surface, _ in pairs]
        at = comparison.aligned_pose(source, target, bound, middle, all_around)
        share = [
            _Tried(surface, one, own.moved(at), at).share
            for (surface, one), own in zip(pairs, source, strict=True)
        ]
        tried.append((min(share), at))
        if tried[-1][0] >= max(one.wanted.share for _, one in pairs) - SHARE_NOISE:
            break
    return max(tried, key=lambda one: one[0])[1]


def _lies_well(surfaces: Sequence[Surface], at: FloatArray, block: FloatArray, found: _Found) -> None:
    """A part whose place is open fits into the block, and a front looks up."""
    front = next((surface for surface in surfaces if surface.name == "front"), None)
    if front is not None and float((front.samples[0].normals @ at[2, :3]).mean()) <= 0.0:
        what = "the front, read once more, does not look up"
        found.issues.append(Issue(PART_FILE, what, field="part.in_stock"))
    if any(surface.part_of for surface in surfaces):
        return
    low, high = _box(np.concatenate([surface.bound for surface in surfaces]) @ at[:3, :3].T + at[:3, 3])
    out = float((high - low - block).max())
    if out > MOST_STANDING_OUT:
        text = f"the part as it is made, read once more, is {mm(out):.2f} mm larger than the block"
        found.issues.append(issue(PART_FILE, text, in_mm(out, MOST_STANDING_OUT), field="part.in_stock"))


class _Tried:
    """One reading of a surface, in the block's frame, against what is made."""

    def __init__(self, surface: Surface, one: Made, places: Samples, at: FloatArray) -> None:
        self.surface, self.one, self.places = surface, one, places
        self.off = one.off(places)
        self.limit = one.wanted.tolerance + surface.spare + READING_ERROR
        self.wanted = one.wanted.share - SHARE_NOISE
        self.counts = np.ones(len(places.points), dtype=np.bool_)
        if one.wanted.margin > 0.0:
            rim = surface.rim() @ at[:3, :3].T + at[:3, 3]
            self.counts = comparison.beside(places.points, rim) > one.wanted.margin
        self.good = np.abs(self.off) <= self.limit  # NaN is not good
        self.share = float(self.good[self.counts].mean()) if self.counts.any() else 0.0

    def judge(self, found: _Found) -> None:
        """Tell what is found."""
        surface, one, seen = self.surface, self.one, int(self.counts.sum())
        found.record(surface.file, seen, self.share, self.wanted)
        fewest = FEWEST_PLACES_OF_STRIP if one.wanted.margin > 0.0 else min(FEWEST_PLACES, len(self.good))
        if seen < fewest:
            what = f"{seen} places of {surface.name} of {surface.file} were looked at, wanted: {fewest}"
            found.issues.append(Issue(PART_FILE, what, field=one.segment, value=seen, limit=fewest))
        if self.share < self.wanted:
            off = np.where(self.counts, self.off, 0.0)
            told = _Told(surface.file, one.segment, self.share, self.wanted, self.limit)
            found.issues.append(told.issue(self.places, off))


@dataclasses.dataclass(frozen=True)
class _Told:
    """How a file differs from what is made in a segment."""

    file: str
    segment: str
    share: float
    wanted: float
    limit: float

    def issue(self, places: Samples, off: FloatArray) -> Issue:
        """The issue, with the worst of the places (N) that are ``off`` (N,) [m]; NaN where nothing came."""
        k = int(np.argmax(np.where(np.isfinite(off), np.abs(off), -1.0)))
        missed = int((~np.isfinite(off)).sum())
        at = ", ".join(f"{mm(v):.2f}" for v in places.points[k])
        what = (
            f"{self.file}, read once more: {100 * self.share:.1f} % of {len(off)} places are within "
            f"{mm(self.limit):.3g} mm of what is made in {self.segment}; wanted: {100 * self.wanted:g} %"
        )
        if np.isfinite(off[k]):
            what += f"; row {places.row[k]} at {at} mm in the block is {mm(float(off[k])):.3f} mm off"
        if missed:
            what += f"; nothing comes near {missed} of them"
        return issue(PART_FILE, what, in_percent(self.share, self.wanted), field=self.segment)


def _lies_on(surface: Surface, one: Made, at: FloatArray, found: _Found) -> None:
    """Of a strip, what is made lies on the surface that was read, as near as the problem allows."""
    if not one.along_strips:
        return
    places = comparison.of_claim(one, FEWEST_PLACES)
    off = one.off(places)
    points = places.points + off[:, None] * places.normals
    known = np.isfinite(off)
    facets = surface.facets @ at[:3, :3].T + at[:3, 3]
    apart = np.full(len(points), np.nan)
    apart[known] = comparison.off_facets(points[known], facets)
    limit = one.wanted.tolerance + surface.spare + READING_ERROR
    wanted = one.wanted.share - SHARE_NOISE
    share = float((apart <= limit).mean())
    found.record(surface.file, len(points), share, wanted)
    if share < wanted:
        found.issues.append(_Told(surface.file, one.segment, share, wanted, limit).issue(places, apart))


def _judge_sheet(made: MadeSheet, found: _Found) -> None:
    """The walls of a sheet against those of the file."""
    sheet, wanted = made.sheet, made.share - SHARE_NOISE
    spare = READING_ERROR + sheet.tolerance
    good = (made.off <= made.allowed + spare) & (made.off >= -made.tolerance - spare)
    share = float(good.mean())
    found.record(sheet.file, len(good), share, wanted)
    if share < wanted:
        told = _Told(sheet.file, made.segment, share, wanted, float(made.allowed.max()))
        found.issues.append(told.issue(sheet.walls, made.off))
