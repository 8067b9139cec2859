"""How much of its moves a corner between two of them may round off: what a zone may take.

How far a corner may pass its target is what a process says of its targets
(:class:`planner.targets.Rounding`). The clock asks for the shares that follow as well as the
writers of programs: the speed that changes at a corner changes while that is rounded off, so small
zones want slow corners.
"""

from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths

CORNER_DEVIATION_MM: Final = 0.02
"""How far [mm] a rounded corner may pass its target; on a smooth curve with dense targets it is less."""
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
RIDING_ZONE_MM: Final = 10.0
"""Path radius [mm] of the largest zone, over which a track is rounded, too: its size above is for turning,"""
RIDING_ZONE_STEP: Final = 2.0
"""and by this factor zones may be smaller in it than there is room for."""
STANDING_MM: Final = 0.01
"""A TCP stands in a move that goes no farther than this [mm]: corners beside it are sized by angle."""
_CORNER_SHARE: Final = 0.5


def room(
    position: FloatArray,
    quaternion: FloatArray,
    stop: BoolArray,
    levers: FloatArray | float = TURNING_LEVER_MM,
    deviation: FloatArray | float = CORNER_DEVIATION_MM,
) -> tuple[FloatArray, FloatArray]:
    """Largest zones (M,) [mm] and (M,) [rad] at the ends of M moves between M + 1 poses; 0 at stops, and
    those in mm where the TCP stands in one of the moves beside them.

    ``position`` [mm] and ``quaternion`` of the poses; ``deviation`` (M,) [mm] is how far a corner may pass
    its target. Turning about the tool's axes counts by ``levers`` (3,) [mm/rad].
    """
    way, turn = np.diff(position, axis=0), _turns(quaternion)
    angle = 2.0 * np.arcsin(np.clip(0.5 * lengths(turn), 0.0, 1.0))
    steps, within = np.concatenate([way, levers * turn], axis=1), np.broadcast_to(deviation, stop.shape)[:-1]
    out = np.zeros((2, len(stop)))
    for size, far in zip(out, (lengths(way), angle), strict=True):
        size[:-1] = _zone(steps, far, within)
    out[:, stop] = 0.0
    return np.where(_shorter(lengths(way)) > STANDING_MM, out[0], 0.0), out[1]


def shares(
    position: FloatArray,
    quaternion: FloatArray,
    duration: FloatArray,
    rates: tuple[FloatArray, FloatArray],
    levers: FloatArray,
    deviation: FloatArray,
    ride: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """At least which share (M - 1,) of the time of the shorter one of the moves beside it each corner between
    M moves of ``duration`` (M,) [s] is rounded over, on both sides: by the zone that :func:`room` allows, and
    by what the controller takes without one. ``rates`` (M,): how many times as fast as on average each move
    begins and ends. Other arguments as there.

    A zone is a length, so the faster move goes through its side in less time, which counts. No zone is larger
    than those that programs name; one that would be smaller rounds nothing, nor does one of an angle where
    the TCP moves on one side. ``ride`` (M + 1,) [mm] has the values of a track that goes along: where its
    share of the tool's way changes there is a corner, however straight the tool goes.
    """
    way, turn = np.diff(position, axis=0), _turns(quaternion)
    comes, goes = (rate[:, None] / duration[:, None] for rate in rates)
    own = [(way, PATH_ACCURACY_MM), (turn, PATH_ACCURACY_RAD)]
    if ride is not None:
        own.append((np.column_stack([way, np.diff(ride)]), PATH_ACCURACY_MM))
    change = [(_sideways_at_most((step * goes)[:-1], (step * comes)[1:]), within) for step, within in own]
    without = np.minimum.reduce([_share(sideways, duration, within) for sideways, within in change])
    steps, far, angle = np.concatenate([way, levers * turn], axis=1), lengths(way), np.rad2deg(lengths(turn))
    stands = np.maximum(far[1:], far[:-1]) <= STANDING_MM
    moved = np.where(far > STANDING_MM, far, 0.0)
    zone = np.where(stands, _zone(steps, angle, deviation[:-1]), _zone(steps, moved, deviation[:-1]))
    step, largest = (ZONE_STEP, LARGEST_ZONE_MM) if ride is None else (RIDING_ZONE_STEP, RIDING_ZONE_MM)
    size = np.minimum(zone / step, np.where(stands, LARGEST_ZONE_DEG, largest))
    by_way, by_turn = (duration / np.maximum(gone, 1e-9) for gone in (far, angle))  # [s/mm] and [s/deg]
    pace = np.where(stands, np.minimum(by_turn[1:], by_turn[:-1]), np.minimum(by_way[1:], by_way[:-1]))
    taken = size * pace / np.minimum(duration[1:], duration[:-1])
    return np.where(size >= FINE_ZONES[-1], taken, 0.0), without


def _turns(quaternion: FloatArray) -> FloatArray:
    """Turns (M, 3) [rad] about the tool's own axes from each of M + 1 orientations to the next, by their
    chords; signs of quaternions do not matter."""
    a, b = quaternion[:-1], quaternion[1:]
    w, u, v = a[:, :1], a[:, 1:], b[:, 1:]
    half = w * v - b[:, :1] * u - np.cross(u, v)
    return np.asarray(2.0 * half * np.where(dots(a, b) < 0.0, -1.0, 1.0)[:, None])


def _zone(steps: FloatArray, far: FloatArray, deviation: FloatArray) -> FloatArray:
    """Size (M - 1,) of the largest zones between M moves over ``steps`` (M, D) [mm], in the measure of their
    lengths ``far`` (M,), at most half of the shorter one.

    A corner that is rounded over the length z before and behind it passes the target at z |dr| / 4, dr being
    the change across the way of the steps over their lengths (the quadratic Bezier curve with the corner as
    its control point), and no farther off than it begins or ends.
    """
    rate = steps / np.maximum(far, 1e-9)[:, None]
    passed = np.minimum(0.25 * _sideways(rate), _shorter(lengths(rate))[:-1])
    return np.asarray(np.minimum(_CORNER_SHARE * _shorter(far)[:-1], deviation / np.maximum(passed, 1e-12)))


def _share(sideways: FloatArray, duration: FloatArray, deviation: FloatArray | float) -> FloatArray:
    """Share (M - 1,) of the shorter one of two moves that the corner between them may take before and behind
    it, at most one half; ``sideways`` (M - 1,) is the change of speed that leaves the way.

    As in :func:`_zone`, over the time h at h |dv| / 4, dv being the change of velocity across the way.
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


def _sideways_at_most(before: FloatArray, after: FloatArray) -> FloatArray:
    """The same (M - 1,) of the speeds before and after corners (M - 1, D), as a controller may take it that
    holds to the faster one of two moves."""
    sizes = lengths(before), lengths(after)
    one, two = (rate / np.maximum(s, 1e-12)[:, None] for rate, s in zip((before, after), sizes, strict=True))
    return np.asarray(np.minimum(np.maximum(*sizes) * lengths(two - one), lengths(after - before)))


def _shorter(size: FloatArray) -> FloatArray:
    """The smaller one of each row and the next."""
    return np.asarray(np.minimum(size, np.append(size[1:], 0.0)))
