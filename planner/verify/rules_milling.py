"""Rules on milling: what the swept cutter leaves and takes, the curves that it
follows, the spindle, the feed."""

from __future__ import annotations

import functools

import numpy as np
import shapely
from numpy.typing import NDArray

from planner.claims_milling import MillsAlong, MillsSurface, SparesPart
from planner.issues import Issue
from planner.verify import rules_mill_flank, rules_mill_over
from planner.verify.context import Context, Outcome, mm
from planner.verify.findings import at_node, at_sample
from planner.verify.mill_body import SIGHT, Solid, comes_near, solids, sweep
from planner.verify.mill_follow import Followed
from planner.verify.mill_over import within
from planner.verify.mill_rims import MOST, edges, near_places, rim_size, rim_step, round_size
from planner.verify.mill_track import Milling
from planner.verify.result import CutFace
from planner.verify.setups import MILL
from planner.verify.surface import divided

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

NONE = "nothing is milled"
SHOWN = 50
"""Issues of one rule and segment at most."""
FACETS = 5e-5
"""What facets, and places between which nothing is looked at, may hide [m]."""
_PLACES = 30_000
_FINEST = 0.4e-3
_GOUGE = 1.6
"""Gouges are looked for at places so much farther apart, of which a quarter of the tolerance is hidden."""


def milled(context: Context, milling: Milling) -> tuple[Outcome, tuple[CutFace, ...]]:
    """The swept cutter makes the wanted surface within the tolerance, but for a stated share of it, with the
    cutter that is mounted, and nothing is milled that is not claimed."""
    issues = _unclaimed(context, milling)
    faces: list[CutFace] = []
    for index, claim in milling.surfaces:
        issues += _same_cutter(milling, index, claim)
        face = cut_face(milling, index, claim)
        faces.append(face)
        if face.share < claim.share:
            what = (
                f"{face.title}: {100 * face.share:.2f} % of the surface are within "
                f"{mm(claim.tolerance):g} mm; "
                f"wanted: {100 * claim.share:g} %"
            )
            measure = {"value": 100 * face.share, "limit": 100 * claim.share, "unit": "%"}
            issues.append(Issue("verify.milled", what, field=face.title, **measure))  # type: ignore[arg-type]
    if not faces:
        return Outcome(tuple(issues), where=NONE), ()
    worst = min(faces, key=lambda face: face.share - face.wanted_share)
    share, wanted = 100 * worst.share, 100 * worst.wanted_share
    return Outcome(tuple(issues), share, wanted, "% within tolerance", worst.title), tuple(faces)


def cut_face(milling: Milling, index: int, claim: MillsSurface) -> CutFace:
    """What the swept cutting part leaves of a surface (positive) or takes too much (negative); NaN where it
    never comes near."""
    corners = claim.vertices[claim.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    size = max(float(np.sqrt(area.sum() / _PLACES)) * 2.0, _FINEST)
    pieces, _ = divided(corners, size)
    area = 0.5 * np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    points = pieces.mean(axis=1)
    if claim.margin:
        kept = shapely.contains_xy(within(corners, claim.margin + 0.5 * size), points[:, 0], points[:, 1])
        points, area = points[kept], area[kept]
    labels = tuple(segment.key for segment in claim.segments)
    track = milling.track(index, claim.arm, labels)
    solid = solids(claim.cutter)[0]
    tip, axis, _ = track.spaced(_step(solid, claim.tolerance))
    off, _ = sweep(points, tip, axis, solid)
    known = off < SIGHT
    share = float(area[known & (np.abs(off) <= claim.tolerance)].sum() / max(float(area.sum()), 1e-30))
    weight = max(float(area[known].sum()), 1e-30)
    rms = float(np.sqrt((area[known] * off[known] ** 2).sum() / weight))
    largest = float(np.abs(off[known]).max(initial=0.0))
    deviation = np.where(known, off, np.nan)
    first, *more = claim.segments
    measure = (claim.tolerance, share, claim.share, rms, largest)
    return CutFace(first, points, deviation, area, *measure, more=len(more))


def _step(solid: Solid, tolerance: float) -> float:
    """Way between places [m] of which a round tool hides a tenth of the tolerance at most: s^2 / 8 r."""
    narrow = solid.radius if solid.corner == 0.0 else 0.5 * solid.radius
    return float(np.clip(np.sqrt(0.8 * narrow * tolerance), 0.3e-3, 3e-3))


def mill_gouge(context: Context, milling: Milling) -> Outcome:
    """At every instant, also on its ways in and out, neither cutter nor shank, holder and spindle are in a
    face of the part by more than the tolerance; a cutter that engraves is as deep as wanted."""
    issues: list[Issue] = []
    worst, limit, where = -np.inf, None, ""
    for index, claim in milling.spared:
        issues += _same_cutter(milling, index, claim)
        labels = tuple(way.key for segment in claim.segments for way in segment.ways)
        track = milling.track(index, claim.arm, labels)
        if not len(track.rows):
            continue
        pieces, corners = solids(claim.cutter), claim.vertices[claim.faces]
        for solid, sharp in [*((one, False) for one in pieces), *((one, True) for one in edges(pieces))]:
            allowed = claim.tolerance + FACETS + (claim.depth if solid.name == "cutter" else 0.0)
            near = comes_near(claim.vertices, track.tip, track.axis, solid)
            if sharp and not near:
                continue
            step = rim_step(claim.tolerance) if sharp else _GOUGE * _step(solid, claim.tolerance)
            tip, axis, rows = milling.spaced(index, claim.arm, labels, step)
            points = claim.vertices[:1]
            if near:
                size = rim_size if sharp else functools.partial(round_size, solid.radius)
                found, count = near_places(corners, solid, tip, axis, size(claim.tolerance))
                if count > MOST:
                    issues.append(_too_many(claim, solid, count, size(claim.tolerance)))
                    worst, limit, where = max(worst, 0.0), mm(allowed), str(claim.segments[0])
                    continue
                points = np.concatenate([found, points if sharp else claim.vertices])
            off, place = sweep(points, tip, axis, solid, -allowed)
            k = int(off.argmin())
            if -off[k] - allowed > worst:
                worst, limit = float(-off[k]) - allowed, mm(allowed)
                where = f"{solid.name} in {context.motion.node_segment[context.motion.node[rows[place[k]]]]}"
            deep = np.flatnonzero(off < -allowed)
            first = np.unique(place[deep], return_index=True)[1]
            for i in deep[first][:: max(1, len(first) // SHOWN)]:
                at = ", ".join(f"{mm(v):.1f}" for v in points[i])
                what = f"the {solid.name} is {mm(-off[i]):.3f} mm in the part at {at} mm; allowed: "
                what += f"{mm(allowed):.3f} mm"
                measure = (mm(float(-off[i])), mm(allowed), "mm")
                row = int(rows[place[i]])
                issues.append(at_sample("verify.mill_gouge", what, context.motion, claim.arm, row, measure))
    if limit is None:
        return Outcome(tuple(issues), where=NONE)
    return Outcome(tuple(issues), mm(worst) + limit, limit, "mm", where)


def _too_many(claim: SparesPart, solid: Solid, count: int, size: float) -> Issue:
    """Nothing is proven of a face that is too large to be looked at as closely as it has to be."""
    what = (
        f"beside the {solid.name} the face would have to be looked at in {count} places, {mm(size):.2f} mm "
    )
    what += f"apart; allowed: {MOST}: split the cut, or take a larger tolerance"
    name = str(claim.segments[0])
    return Issue("verify.mill_gouge", what, field=name, value=float(count), limit=float(MOST))


def mill_path(context: Context, milling: Milling) -> Outcome:
    """Tip and axis stay within the tolerances on the way that the G-code file, the curves, the ruled surface
    or the face asks for, all of which is passed, ways in and out too, and mill nothing beside it."""
    issues: list[Issue] = list(context.unread)
    own, worst, where = rules_mill_flank.flanks(context, milling)
    issues += own
    own, share, name = rules_mill_over.over(context, milling)
    issues += own
    worst, where = (share, name) if share > worst else (worst, where)
    limit = 1.0 if where else None
    for index, claim in milling.curves:
        track = milling.track(index, claim.arm, (claim.segment.key,))
        known = milling.followed(index, claim)
        if known is None and _small(claim):
            continue
        if known is None:
            issues.append(
                Issue("verify.mill_path", f"{claim.segment} is not milled", field=str(claim.segment))
            )
            continue
        some, found = known
        off, turn = found.off, found.turn
        share = max(float(off.max()) / claim.tolerance, float(turn.max()) / claim.turn)
        if share > worst:
            worst, limit, where = share, 1.0, str(claim.segment)
        bad = np.flatnonzero((off > claim.tolerance) | (turn > claim.turn))
        for i in bad[:: max(1, len(bad) // SHOWN)]:
            what = (
                f"in {claim.segment} the tip is {mm(off[i]):.3f} mm off its curve{_line(claim, found, i)} "
                f"and the axis {np.rad2deg(turn[i]):.2f} deg; allowed: {mm(claim.tolerance):g} mm, "
                f"{np.rad2deg(claim.turn):.2f} deg"
            )
            measure = (mm(float(off[i])), mm(claim.tolerance), "mm")
            row = int(track.rows[some[i]])
            issues.append(at_sample("verify.mill_path", what, context.motion, claim.arm, row, measure))
        if found.missed:
            word = f"{found.missed} of {len(claim.tip)} places are never passed, or not in order"
            issues.append(Issue("verify.mill_path", f"{claim.segment}: {word}", field=str(claim.segment)))
    return Outcome(tuple(issues), worst, limit, "of what is allowed", where or NONE)


def _small(claim: MillsAlong) -> bool:
    """Whether a way is so short that standing still follows it."""
    tips = float(np.linalg.norm(claim.tip - claim.tip[0], axis=1).max())
    return tips <= claim.tolerance and float((claim.axis @ claim.axis[0]).min()) >= np.cos(claim.turn)


def _line(claim: MillsAlong, found: Followed, i: int) -> str:
    """The line of the file by which a sample should be."""
    if claim.line is None:
        return ""
    place = min(int(np.searchsorted(found.along, found.at[i])), len(claim.line) - 1)
    return f" by line {claim.line[place]} of {claim.file}"


def _unclaimed(context: Context, milling: Milling) -> list[Issue]:
    """Moves of segments that mill, of which nothing is claimed, and claimed ones that never come."""
    motion = context.motion
    arm = context.job.tasks[0].arm.name
    out: list[Issue] = []
    seen: set[str] = set()
    for node, (segment, name) in enumerate(zip(motion.node_segment, motion.node_label, strict=True)):
        if segment.kind == MILL and name not in milling.labels and name not in seen:
            what = f"the programs mill in {segment}, of which the problem claims nothing"
            out.append(at_node("verify.milled", what, motion, arm, node))
        seen.add(name)
    lacks = {segment.key for _, c in milling.surfaces for segment in c.segments} - seen
    out += [Issue("verify.milled", f"{name} is never milled", field=name) for name in sorted(lacks)]
    return out


def _same_cutter(milling: Milling, index: int, claim: MillsSurface | SparesPart) -> list[Issue]:
    own, said = milling.mounted(index, claim.arm), claim.cutter
    if (
        own is not None
        and own.kind == said.kind
        and all(
            np.allclose(getattr(own, name), getattr(said, name), atol=1e-9)
            for name in ("radius", "corner", "flute", "overhang", "shank", "behind")
            if np.shape(getattr(own, name)) == np.shape(getattr(said, name))
        )
        and np.shape(own.behind) == np.shape(said.behind)
    ):
        return []
    what = f"the tool of {claim.arm} in setup {index + 1} has another cutter than the claimed one"
    return [Issue("verify.milled", what, arm=claim.arm)]
