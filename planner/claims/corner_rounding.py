"""How much of its moves a corner between two of them may round off: what a zone may take.

It follows from what is claimed at the targets. The clock asks it as well as the writers of
programs: the speed that changes at a corner changes while that is rounded off, so small zones want
slow corners.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from planner.claims.claim import CutsSurface, StraightWire
from planner.claims.forming import FormsSheet
from planner.claims.milling import (
    Engraves,
    MillsAlong,
    MillsFlank,
    MillsOver,
    MillsProgram,
    MillsSurface,
    SparesPart,
)
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths
from planner.geometry.rigid import axis_ends
from planner.targets import Targets
from planner.tooling import Tool, working_solid

CUTTER_WAYS: Final = (MillsAlong, MillsProgram, Engraves, MillsFlank, MillsOver)
"""Claims on the way of a cutter."""
CORNER_DEVIATION_MM: Final = 0.02
"""How far [mm] a rounded corner may pass its target; on a smooth curve with dense targets it is less."""
AIR_DEVIATION_MM: Final = 0.5
"""How far [mm] a straight wire may pass a target in the air: slower turns, and still far within any
clearance."""
SURFACE_SHARE: Final = 0.15
"""Part of a surface's tolerance that rounded corners of a straight wire may take, where it is more."""
TIGHT_SHARE: Final = 0.5
"""The same of a cutter's tolerance that is tighter than :data:`CORNER_DEVIATION_MM`."""
FORMED_SHARE: Final = 0.4
"""The same of what a forming ball may cut into its face."""
SPLINE_DEVIATION_MM: Final = 0.08
"""How far [mm] the curve of a spline block may be off straight moves; the proof allows no more than 0.1."""
SPLINE_SHARE: Final = 0.75
SPLINE_WAY_SHARE: Final = 0.5
"""The same as a part of a cutter's tolerance on its surfaces, which corners then leave alone, and on ways
that are divided by a part of it themselves."""
TURNING_LEVER_MM: Final = 100.0
"""Turning counts as the way [mm/rad] of a point so far from the TCP at least, for what a tool holds is
long."""
PATH_ACCURACY_MM: Final = 0.01
"""A controller rounds corners within this of their targets [mm] even without a zone: a tenth of what ABB
states for path repeatability."""
PATH_ACCURACY_RAD: Final = 1e-4
"""The same for turning [rad]."""
FINE_ZONES: Final = (
    *(0.7, 0.5, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.015, 0.01),
    *(0.007, 0.005, 0.003, 0.002, 0.001),
)
"""Sizes of small zones [mm] or [deg] that programs may name."""
ZONE_STEP: Final = 1.7
"""Sizes of zones are no farther apart than by this factor, but for those within :data:`PATH_ACCURACY_MM`."""
LARGEST_ZONE_MM: Final = 15.0
LARGEST_ZONE_DEG: Final = 1.0
"""Sizes of the largest zones [mm] and [deg] that programs name."""
STANDING_MM: Final = 0.01
"""A TCP stands in a move that goes no farther than this [mm]: corners beside it are sized by angle."""
_CORNER_SHARE: Final = 0.5


def lever(tool: Tool) -> float:
    """How far [mm] from its TCP a tool cuts: to the far end of its working solid's axis, or
    :data:`TURNING_LEVER_MM`, also for a solid with corners."""
    solid = working_solid(tool)
    if solid is None or solid.vertices is not None:
        return TURNING_LEVER_MM
    off = axis_ends(solid) - tool.tcp[:3, 3]
    return max(TURNING_LEVER_MM, 1e3 * float(np.linalg.norm(off, axis=1).max()))


def levers(targets: Targets, arm: str, tool: Tool) -> FloatArray:
    """What turning about the tool's axes x, y, z (3,) counts as [mm/rad].

    :func:`lever`; but a cutter is a body of revolution that follows a way within an angle: its spin is worth
    what a solid may move in the air, its lean, where no surface asks for more, what that angle allows.
    """
    along = [c for c in targets.claims if isinstance(c, CUTTER_WAYS) and c.arm == arm]
    if not along:
        return np.full(3, lever(tool))
    lean, allowed = TURNING_LEVER_MM, float(deviations(targets, [Segment("mill")])[0])
    if not any(isinstance(claim, MillsSurface | SparesPart) for claim in targets.claims):
        lean = min(TURNING_LEVER_MM, allowed / (SURFACE_SHARE * min(claim.turn for claim in along)))
    return np.array([lean, lean, TURNING_LEVER_MM * allowed / AIR_DEVIATION_MM])


def deviations(targets: Targets, segments: Sequence[Segment]) -> FloatArray:
    """How far (M,) [mm] the corners at the ends of M moves may pass their targets.

    A straight wire is free in the air; in the foam, and on the way into and out of it, the surfaces bound
    it. A cutter and a forming ball may take a share of what their surfaces allow. Whatever follows poses or
    joins two arms keeps to :data:`CORNER_DEVIATION_MM` everywhere.
    """
    least = np.full(len(segments), CORNER_DEVIATION_MM)
    formed = [c.tolerance for c in targets.claims if isinstance(c, FormsSheet)]
    if formed:
        return np.asarray(np.minimum(least, FORMED_SHARE * 1e3 * min(formed)))
    milled = [c.tolerance for c in targets.claims if isinstance(c, (SparesPart, *CUTTER_WAYS))]
    if milled:
        tolerance = 1e3 * min(milled)
        least = np.full(len(segments), min(CORNER_DEVIATION_MM, TIGHT_SHARE * tolerance))
        part = max(float(least[0]), SURFACE_SHARE * tolerance)
        return np.where(np.array([segment.works for segment in segments]), part, least)
    if not any(isinstance(claim, StraightWire) for claim in targets.claims) or targets.coupled:
        return least
    surfaces = [claim.tolerance for claim in targets.claims if isinstance(claim, CutsSurface)]
    cutting = np.array([segment.works for segment in segments])
    foam = max(CORNER_DEVIATION_MM, 1e3 * SURFACE_SHARE * min(surfaces, default=0.0))
    return np.where(cutting | np.append(cutting[1:], False), foam, AIR_DEVIATION_MM)


def spline_off(targets: Targets, arm: str) -> list[tuple[float, float]]:
    """How far [mm] the curve of a spline block may be off straight moves, at points so far [mm] from the TCP:
    of the most anywhere, and a part of what a cutter's surfaces and ways allow there."""
    out = [(TURNING_LEVER_MM, SPLINE_DEVIATION_MM)]
    for claim in targets.claims:
        if isinstance(claim, (SparesPart, *CUTTER_WAYS, MillsSurface)) and claim.arm == arm:
            cutter = getattr(claim, "cutter", None)
            lever = 0.0
            if cutter is not None:
                lever = 1e3 * (cutter.overhang if isinstance(claim, SparesPart) else cutter.flute)
            share = (
                SPLINE_WAY_SHARE if isinstance(claim, MillsAlong | MillsProgram | Engraves) else SPLINE_SHARE
            )
            out.append((lever, share * 1e3 * claim.tolerance))
    return list(dict.fromkeys(out))


def room(
    position: FloatArray,
    quaternion: FloatArray,
    duration: FloatArray,
    stop: BoolArray,
    levers: FloatArray | float = TURNING_LEVER_MM,
    deviation: FloatArray | float = CORNER_DEVIATION_MM,
) -> tuple[FloatArray, FloatArray]:
    """Largest zones (M,) [mm] and (M,) [rad] at the ends of M moves between M + 1 poses; 0 at stops, and
    those in mm where the TCP stands in one of the moves beside them.

    ``position`` [mm] and ``quaternion`` of the poses, ``duration`` (M,) [s]; ``deviation`` (M,) [mm] is how
    far a corner may pass its target. Turning about the tool's axes counts by ``levers`` (3,) [mm/rad].
    """
    way, turn = np.diff(position, axis=0), _turns(quaternion)
    angle = 2.0 * np.arcsin(np.clip(0.5 * lengths(turn), 0.0, 1.0))
    rate = np.concatenate([way, levers * turn], axis=1) / duration[:, None]
    taken = np.append(_share(_sideways(rate), duration, np.broadcast_to(deviation, stop.shape)[:-1]), 0.0)
    taken[stop] = 0.0
    shorter = _shorter(lengths(way))
    return np.where(shorter > STANDING_MM, taken * shorter, 0.0), taken * _shorter(angle)


def shares(
    position: FloatArray,
    quaternion: FloatArray,
    duration: FloatArray,
    levers: FloatArray,
    deviation: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """At least which share (M - 1,) of the shorter one of the moves beside it each corner between M moves is
    rounded over, on both sides: by the zone that :func:`room` allows, and by what the controller takes
    without one. Arguments as there.

    No zone is larger than those that programs name; one that would be smaller rounds nothing, nor does one of
    an angle where the TCP moves on one side.
    """
    way, turn = np.diff(position, axis=0), _turns(quaternion)
    span = duration[:, None]
    rate = np.concatenate([way, levers * turn], axis=1) / span
    own = [(way / span, PATH_ACCURACY_MM), (turn / span, PATH_ACCURACY_RAD)]
    without = np.minimum(*(_share(_sideways_at_most(speed), duration, within) for speed, within in own))
    zone = _share(_sideways(rate), duration, deviation[:-1])
    far, angle = lengths(way), np.rad2deg(lengths(turn))
    stands = np.maximum(far[1:], far[:-1]) <= STANDING_MM
    whole = np.where(stands, _shorter(angle)[:-1], _shorter(np.where(far > STANDING_MM, far, 0.0))[:-1])
    size = np.minimum(zone * whole / ZONE_STEP, np.where(stands, LARGEST_ZONE_DEG, LARGEST_ZONE_MM))
    named = size >= FINE_ZONES[-1]
    return np.where(named, size / np.maximum(whole, FINE_ZONES[-1]), 0.0), without


def _turns(quaternion: FloatArray) -> FloatArray:
    """Turns (M, 3) [rad] about the tool's own axes from each of M + 1 orientations to the next, by their
    chords; signs of quaternions do not matter."""
    a, b = quaternion[:-1], quaternion[1:]
    w, u, v = a[:, :1], a[:, 1:], b[:, 1:]
    half = w * v - b[:, :1] * u - np.cross(u, v)
    return np.asarray(2.0 * half * np.where(dots(a, b) < 0.0, -1.0, 1.0)[:, None])


def _share(sideways: FloatArray, duration: FloatArray, deviation: FloatArray | float) -> FloatArray:
    """Share (M - 1,) of the shorter one of two moves that the corner between them may take before and behind
    it, at most one half; ``sideways`` (M - 1,) is the change of speed that leaves the way.

    A corner that is rounded over the time h before and behind it passes the target at h |dv| / 4, dv being
    the change of velocity across the way (the quadratic Bezier curve with the corner as its control point).
    """
    passed = np.minimum(duration[:-1], duration[1:]) * sideways / 4.0
    return np.asarray(np.minimum(_CORNER_SHARE, deviation / np.maximum(passed, 1e-12)))


def _sideways(rate: FloatArray) -> FloatArray:
    """Change (M - 1,) of speeds (M, D) across the way, which alone leaves it: along the line that halves the
    corner. At equal speeds it is all of the change."""
    size = lengths(rate)
    along = rate / np.maximum(size, 1e-12)[:, None]
    bent = 0.5 * (size[1:] + size[:-1]) * lengths(np.diff(along, axis=0))
    stands = np.minimum(size[1:], size[:-1]) < 1e-9
    return np.where(stands, lengths(np.diff(rate, axis=0)), bent)


def _sideways_at_most(rate: FloatArray) -> FloatArray:
    """The same (M - 1,) as a controller may take it that holds to the faster one of two moves."""
    size = lengths(rate)
    along = rate / np.maximum(size, 1e-12)[:, None]
    bent = np.maximum(size[1:], size[:-1]) * lengths(np.diff(along, axis=0))
    return np.asarray(np.minimum(bent, lengths(np.diff(rate, axis=0))))


def _shorter(size: FloatArray) -> FloatArray:
    """The smaller one of each row and the next."""
    return np.asarray(np.minimum(size, np.append(size[1:], 0.0)))
