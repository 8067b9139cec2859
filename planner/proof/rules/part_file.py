"""verify.part_file: the simulated part against the part that the proof itself reads from the part files.

The operations determine which surfaces must be produced, in which segments, and with which tolerances. The
surfaces come from the proof's own readers (`part_files`) and the problem's numbers. A part has the pose that
the problem states. If the problem leaves the pose open, one rigid motion, without mirror or scale, must bring
all surfaces at once onto the produced ones, within the block.
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
from planner.proof.findings import measure_in_mm, measure_in_percent
from planner.proof.part_files import Samples, UnreadError, comparison, on_triangles, pose_of
from planner.proof.part_files.produced import (
    ALL_RULED,
    ProducedSheet,
    ProducedSurface,
    RequiredSurface,
    SurfaceProducer,
)
from planner.proof.part_files.surfaces import PartSurface, part_surfaces
from planner.proof.rule import RuleOutcome, measured_issue, mm, rule

PART_FILE: Final = "verify.part_file"
"""Code of this rule."""
MIN_POINTS: Final = 500
"""Minimum number of points of a surface that are compared."""
MIN_POINTS_BESIDE_STRIP: Final = 100
"""Minimum number of points that are compared if the operation leaves out a strip along the edge."""
FRACTION_TOLERANCE: Final = 0.03
"""Tolerance of the fraction of points within tolerance. 600 points estimate a fraction of 95 % within 3 %,
which are three standard deviations.
"""
READING_TOLERANCE_M: Final = 2e-5
"""Tolerance [m] between two readings of a curve, which follow it within 0.01 mm each."""
MAX_OVERSIZE_M: Final = 1e-4
"""Maximum distance [m] by which a part without a stated pose may be larger than the block."""
_TARGET_POINTS: Final = 20_000
"""Number of points on the claimed surfaces with which a file is compared."""


@dataclasses.dataclass
class _PartFileFindings:
    """Findings of the rule so far.

    Attributes:
        issues: Issues that were found.
        point_counts: Number of compared points by file.
        margin: Smallest difference, of all surfaces, of the fraction of good points and the required one.
        fraction: Fraction of good points of that surface.
        limit: Required fraction of that surface.
    """

    issues: list[Issue] = dataclasses.field(default_factory=list)
    point_counts: dict[str, int] = dataclasses.field(default_factory=dict)
    margin: float = np.inf
    fraction: float = 1.0
    limit: float = 1.0

    def record(self, file: str, count: int, fraction: float, limit: float) -> None:
        """Record compared points of a file, the fraction of good points, and the required fraction."""
        self.point_counts[file] = self.point_counts.get(file, 0) + count
        if fraction - limit < self.margin:
            self.margin, self.fraction, self.limit = fraction - limit, fraction, limit

    def outcome(self) -> RuleOutcome:
        """Return the outcome of the rule."""
        counts = ", ".join(f"{count} points of {file}" for file, count in self.point_counts.items())
        if not self.point_counts:
            return RuleOutcome(tuple(self.issues), nothing="no operation makes a surface of the part")
        return RuleOutcome(tuple(self.issues), 100 * self.fraction, 100 * self.limit, "% as read", counts)


@rule("verify.part_file")
def part_file(context: Context) -> RuleOutcome:
    """The programs make the part that the proof itself reads from its file or from the problem's numbers.
    Points all over the part are compared.
    """
    findings = _PartFileFindings()
    try:
        part = context.problem.source.get("part")
        if part and part.get("sheet_mesh"):
            for contribution in of_processes(context.problem):
                sheet = (
                    None
                    if contribution.produced_sheet is None
                    else contribution.produced_sheet(context, part)
                )
                if sheet is not None:
                    _compare_sheet(sheet, findings)
        elif part:
            _compare_surfaces(context, part, findings)
        elif context.problem.part is not None and context.problem.source:  # without: a part built in Python
            message = (
                "the problem has a part that its file does not state. State it there, or remove the file "
                "(source={}) for a problem of values alone"
            )
            findings.issues.append(Issue(PART_FILE, message, field="part"))
    except UnreadError as error:
        findings.issues.append(Issue(PART_FILE, f"{error}; export it again, or convert it", field="part"))
    return findings.outcome()


def _compare_surfaces(context: Context, part: Any, findings: _PartFileFindings) -> None:
    """Compare the surfaces of a part as read with the surfaces that the programs produce.

    ``part`` is the part as the problem file states it. The results are added to the findings. Without a pair
    of surfaces nothing is compared.
    """
    block = np.asarray(context.problem.stock.size)  # (3,) [m]
    producers = [
        contribution.surface_producer
        for contribution in of_processes(context.problem)
        if contribution.surface_producer is not None
    ]
    required = [
        required_surface
        for operation in context.problem.operations
        for producer in producers
        for required_surface in producer.required(operation)
    ]
    names = {required_surface.name for required_surface in required}
    # The edges between front and back are read only if an operation must produce them.
    surfaces = part_surfaces(part, float(block[2]), not names.isdisjoint((ALL_RULED, "edges")))
    pose_in_stock = _stated_pose(part, surfaces, block)
    pairs = _match_surfaces(
        surfaces,
        _produced_surfaces(context, part, surfaces, (producers, required), findings),
        pose_in_stock,
        findings,
    )
    if not pairs:
        return
    if pose_in_stock is None:
        pose_in_stock = _find_pose(surfaces, pairs, block)
        _check_found_pose(surfaces, pose_in_stock, block, findings)
    for surface, produced in pairs:
        if surface.part_of:
            _check_strip(surface, produced, pose_in_stock, findings)
            continue
        # If guides can be joined in several ways, each of them satisfies the problem.
        comparisons = [
            _SurfaceComparison(surface, produced, samples.moved(pose_in_stock), pose_in_stock)
            for samples in surface.samples
        ]
        max(comparisons, key=lambda candidate: candidate.fraction).report(findings)


def _produced_surfaces(
    context: Context,
    part: Any,
    surfaces: Sequence[PartSurface],
    requested: tuple[Sequence[SurfaceProducer], Sequence[RequiredSurface]],
    findings: _PartFileFindings,
) -> list[ProducedSurface]:
    """Return the surfaces that the programs produce for the required ones.

    An issue is added for each required surface that no claim covers. The name ``ALL_RULED`` stands for all
    surfaces as read except front and back, and for a plate for all outlines that are cut.

    Args:
        context: The proof.
        part: The part as the problem file states it.
        surfaces: Surfaces of the part as read.
        requested: Surface producers of the processes, and the required surfaces.
        findings: Findings, to which issues are added.
    """
    processes, required = requested
    out: list[ProducedSurface] = []
    faces = ("front", "back") if part.get("front") else ()  # ruled surfaces may have these names, too
    ruled = [surface.name for surface in surfaces if surface.name not in faces]
    for required_surface in required:
        required_names: Sequence[str] = (required_surface.name,)
        if required_surface.name == ALL_RULED:
            required_names = ruled
            if part.get("plate"):
                # Outlines have no names in the problem, so only their number is compared.
                form = re.compile(r"(?:outline|hole)_[a-z]+")
                required_names = [
                    name for producer in processes for name in producer.names(context) if form.fullmatch(name)
                ]
                if len(required_names) != len(ruled):
                    message = f"{len(required_names)} outlines are cut; the part as read has {len(ruled)}"
                    count = len(required_names), len(ruled), None
                    findings.issues.append(measured_issue(PART_FILE, message, count, field="part.plate"))
        for name in required_names:
            produced = [
                surface
                for producer in processes
                for surface in producer.produced(context, required_surface, name)
            ]
            if not produced:
                segment = Segment(required_surface.kind, name).folded
                message = f"the problem requires {name}, but no claim covers {segment}"
                findings.issues.append(Issue(PART_FILE, message, field=str(segment)))
            out += produced
    return out


def _match_surfaces(
    surfaces: Sequence[PartSurface],
    produced: Sequence[ProducedSurface],
    pose_in_stock: FloatArray | None,
    findings: _PartFileFindings,
) -> list[tuple[PartSurface, ProducedSurface]]:
    """Match each produced surface with a surface as read, and add issues for produced ones without a match.

    Surfaces are matched by name. A surface may be produced more than once, roughly and then finely. Outlines
    of a plate have no names. Each is matched once, with the nearest bounding box among those of its kind, if
    the pose ``pose_in_stock`` (4, 4) of the part is known. It is None if the part's pose is open.
    """
    out: list[tuple[PartSurface, ProducedSurface]] = []
    unmatched = list(surfaces)
    for surface_made in produced:
        base = surface_made.name.split("_", 1)[0]
        same_name = [surface for surface in surfaces if surface.name == surface_made.name]
        if same_name:
            out.append((same_name[0], surface_made))
            unmatched = [surface for surface in unmatched if surface is not same_name[0]]
            continue
        candidates: list[int] = []
        if pose_in_stock is not None:
            candidates = [
                k
                for k, surface in enumerate(unmatched)
                if surface.name == base and base in comparison.OUTLINES
            ]
            box = _box(surface_made.vertices)
            distances = [
                np.abs(_box(unmatched[k].bound @ pose_in_stock[:3, :3].T + pose_in_stock[:3, 3]) - box).max()
                for k in candidates
            ]
            candidates = [candidates[int(np.argmin(distances))]] if candidates else []
        if candidates:
            out.append((unmatched.pop(candidates[0]), surface_made))
            continue
        message = f"{surface_made.segment} makes {surface_made.name}, which the part as read does not have"
        findings.issues.append(Issue(PART_FILE, message, field=surface_made.segment))
    return out


def _box(points: FloatArray) -> FloatArray:
    """Return lower and upper corner (2, D) of the bounding box of points (N, D)."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _stated_pose(part: Any, surfaces: Sequence[PartSurface], block: FloatArray) -> FloatArray | None:
    """Return the part's frame (4, 4) in the block's frame, or None if the problem leaves it open.

    The outlines of a plate are never open: they are in the middle of the block, of size ``block`` (3,) [m],
    rotated by a quarter turn if they fit only with this rotation.
    """
    stated_pose = part.get("in_stock")
    if stated_pose is not None and not isinstance(stated_pose, str):
        return pose_of(stated_pose)
    if not part.get("plate"):
        return None
    low, high = _box(np.concatenate([surface.bound for surface in surfaces]))
    size = (high - low)[:2]
    out = np.eye(4)
    if (size > block[:2] + 1e-9).any() and (size[::-1] <= block[:2] + 1e-9).all():
        out[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    out[:2, 3] = -out[:2, :2] @ (0.5 * (low + high))[:2]
    return out


def _find_pose(
    surfaces: Sequence[PartSurface], pairs: Sequence[tuple[PartSurface, ProducedSurface]], block: FloatArray
) -> FloatArray:
    """Find the pose (4, 4) of a part in the block that fits best to the produced surfaces.

    The bounding box of the part is in the middle of the block, whose size is ``block`` (3,) [m]. All ways in
    which the guides of the surfaces may be joined are tried, first from initial poses by axes of inertia,
    then from all orientations. The search ends at the first pose at which all surfaces fit well enough. Of
    strips, only the first produced piece is placed on the surface.
    """
    if any(surface.part_of for surface in surfaces):
        surface, produced = pairs[0]
        return comparison.piece_pose(
            comparison.claimed_points(produced, MIN_POINTS),
            on_triangles(surface.facets, np.arange(len(surface.facets)) + 1, _TARGET_POINTS),
        )
    target = [comparison.claimed_points(produced, _TARGET_POINTS // len(pairs)) for _, produced in pairs]
    bound = np.concatenate([surface.bound for surface in surfaces])
    centre = np.array([0.0, 0.0, 0.5 * block[2]])
    candidates = []
    join_variants = range(max(len(surface.samples) for surface, _ in pairs))
    for all_around, k in itertools.product((False, True), join_variants):
        source = [surface.samples[min(k, len(surface.samples) - 1)] for surface, _ in pairs]
        candidate = comparison.aligned_pose(source, target, bound, centre, all_around)
        fractions = [
            _SurfaceComparison(surface, produced, samples.moved(candidate), candidate).fraction
            for (surface, produced), samples in zip(pairs, source, strict=True)
        ]
        candidates.append((min(fractions), candidate))
        if candidates[-1][0] >= max(produced.required.fraction for _, produced in pairs) - FRACTION_TOLERANCE:
            break
    return max(candidates, key=lambda candidate: candidate[0])[1]


def _check_found_pose(
    surfaces: Sequence[PartSurface], pose_in_stock: FloatArray, block: FloatArray, findings: _PartFileFindings
) -> None:
    """Check that a part without a stated pose fits into the block, and that a front faces up.

    A surface of which only strips are cut may be larger than the block. ``block`` (3,) [m] is its size.
    """
    front = next((surface for surface in surfaces if surface.name == "front"), None)
    if front is not None and float((front.samples[0].normals @ pose_in_stock[2, :3]).mean()) <= 0.0:
        message = "the front of the part as read does not face up"
        findings.issues.append(Issue(PART_FILE, message, field="part.in_stock"))
    if any(surface.part_of for surface in surfaces):
        return
    low, high = _box(
        np.concatenate([surface.bound for surface in surfaces]) @ pose_in_stock[:3, :3].T
        + pose_in_stock[:3, 3]
    )
    oversize = float((high - low - block).max())
    if oversize > MAX_OVERSIZE_M:
        text = f"the part as read is {mm(oversize):.2f} mm larger than the block"
        findings.issues.append(
            measured_issue(PART_FILE, text, measure_in_mm(oversize, MAX_OVERSIZE_M), field="part.in_stock")
        )


class _SurfaceComparison:
    """Comparison of a surface as read, in the block's frame, with the produced surface.

    Attributes:
        surface: Surface of the part.
        produced: Surface that the programs produce.
        points: Points of the surface as read.
        deviation: Deviation (N,) [m] of the produced surface at the points, NaN where nothing is produced.
        limit: Allowed deviation [m].
        required: Required fraction of good points.
        counts: Whether the points count, because they are not in the strip along the edge (N,).
        good: Whether the deviation is within the limit (N,).
        fraction: Fraction of good points among those that count.
    """

    def __init__(
        self, surface: PartSurface, produced: ProducedSurface, points: Samples, pose_in_stock: FloatArray
    ) -> None:
        self.surface, self.produced, self.points = surface, produced, points
        self.deviation = produced.deviation(points)
        self.limit = produced.required.tolerance + surface.spare + READING_TOLERANCE_M
        self.required = produced.required.fraction - FRACTION_TOLERANCE
        self.counts = np.ones(len(points.points), dtype=np.bool_)
        if produced.required.margin > 0.0:
            rim = surface.rim() @ pose_in_stock[:3, :3].T + pose_in_stock[:3, 3]
            self.counts = comparison.distance_to_edges(points.points, rim) > produced.required.margin
        self.good = np.abs(self.deviation) <= self.limit  # NaN is not good
        self.fraction = float(self.good[self.counts].mean()) if self.counts.any() else 0.0

    def report(self, findings: _PartFileFindings) -> None:
        """Add the result to the findings."""
        surface, produced, count = self.surface, self.produced, int(self.counts.sum())
        findings.record(surface.file, count, self.fraction, self.required)
        min_count = (
            MIN_POINTS_BESIDE_STRIP if produced.required.margin > 0.0 else min(MIN_POINTS, len(self.good))
        )
        if count < min_count:
            message = (
                f"{count} points of {surface.name} of {surface.file} were compared; required: {min_count}"
            )
            findings.issues.append(
                Issue(PART_FILE, message, field=produced.segment, value=count, limit=min_count)
            )
        if self.fraction < self.required:
            deviation = np.where(self.counts, self.deviation, 0.0)
            difference = _FileDifference(
                surface.file, produced.segment, self.fraction, self.required, self.limit
            )
            findings.issues.append(difference.issue(self.points, deviation))


@dataclasses.dataclass(frozen=True)
class _FileDifference:
    """Difference between a file and the surface that is produced in a segment.

    Attributes:
        file: Name of the file.
        segment: Segment that produces the surface.
        fraction: Fraction of points within the limit.
        required: Required fraction.
        limit: Allowed deviation [m].
    """

    file: str
    segment: str
    fraction: float
    required: float
    limit: float

    def issue(self, points: Samples, deviation: FloatArray) -> Issue:
        """Return the issue, with the worst point.

        Args:
            points: Points (N,) of the surface.
            deviation: Deviations (N,) [m], NaN where nothing is produced.
        """
        k = int(np.argmax(np.where(np.isfinite(deviation), np.abs(deviation), -1.0)))
        missing = int((~np.isfinite(deviation)).sum())
        position = ", ".join(f"{mm(v):.2f}" for v in points.points[k])
        message = (
            f"{self.file} as read: {100 * self.fraction:.1f} % of {len(deviation)} points are within "
            f"{mm(self.limit):.3g} mm of what is made in {self.segment}; required: {100 * self.required:g} %"
        )
        if np.isfinite(deviation[k]):
            message += (
                f"; row {points.row[k]} at {position} mm in the block deviates by "
                f"{mm(float(deviation[k])):.3f} mm"
            )
        if missing:
            message += f"; {missing} of them are not reached"
        return measured_issue(
            PART_FILE, message, measure_in_percent(self.fraction, self.required), field=self.segment
        )


def _check_strip(
    surface: PartSurface, produced: ProducedSurface, pose_in_stock: FloatArray, findings: _PartFileFindings
) -> None:
    """Check that the produced part of a strip lies on the surface as read, within the problem's tolerance.

    Points of the claimed surface are moved by their deviation onto the produced surface, and their distances
    from the surface as read are measured. Points that are not produced count as wrong.
    """
    if not produced.along_strips:
        return
    claimed_points = comparison.claimed_points(produced, MIN_POINTS)
    deviation = produced.deviation(claimed_points)
    points = claimed_points.points + deviation[:, None] * claimed_points.normals
    is_produced = np.isfinite(deviation)
    facets = surface.facets @ pose_in_stock[:3, :3].T + pose_in_stock[:3, 3]
    distances = np.full(len(points), np.nan)
    distances[is_produced] = comparison.distance_to_facets(points[is_produced], facets)
    limit = produced.required.tolerance + surface.spare + READING_TOLERANCE_M
    required = produced.required.fraction - FRACTION_TOLERANCE
    fraction = float((distances <= limit).mean())
    findings.record(surface.file, len(points), fraction, required)
    if fraction < required:
        findings.issues.append(
            _FileDifference(surface.file, produced.segment, fraction, required, limit).issue(
                claimed_points, distances
            )
        )


def _compare_sheet(produced: ProducedSheet, findings: _PartFileFindings) -> None:
    """Compare the walls of a produced sheet with those of the file, and add the result to the findings.

    The deviation may be at most ``allowed`` to the outside and ``tolerance`` to the inside, plus the
    tolerances of reading and of the file.
    """
    sheet, required = produced.sheet, produced.fraction - FRACTION_TOLERANCE
    tolerance = READING_TOLERANCE_M + sheet.tolerance
    good = (produced.deviation <= produced.allowed + tolerance) & (
        produced.deviation >= -produced.tolerance - tolerance
    )
    fraction = float(good.mean())
    findings.record(sheet.file, len(good), fraction, required)
    if fraction < required:
        difference = _FileDifference(
            sheet.file, produced.segment, fraction, required, float(produced.allowed.max())
        )
        findings.issues.append(difference.issue(sheet.walls, produced.deviation))
