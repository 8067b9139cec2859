"""How much of its moves a corner between them may round off: the size of zones.

A process defines how far a corner may deviate from its target (:class:`planner.targets.CornerRounding`).
Timing and program writers both use the fractions computed here. Velocity changes at a corner while it is
rounded, so small zones require slow corners.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths

CORNER_DEVIATION_MM: Final = 0.02
"""Maximum distance of a rounded corner from its target [mm].

On a smooth curve with dense targets it is smaller.
"""
ROTATION_LEVER_MM: Final = 100.0
"""Length [mm/rad] that converts rotation to distance, because what a tool holds is long. Chosen."""
PATH_ACCURACY_MM: Final = 0.01
"""Distance within which a controller rounds corners even without a zone [mm].

It is a tenth of what ABB states for path repeatability.
"""
PATH_ACCURACY_RAD: Final = 1e-4
"""Angle within which a controller rounds rotations even without a zone [rad]."""
FINE_ZONE_SIZES: Final = (
    *(0.7, 0.5, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.015, 0.01),
    *(0.007, 0.005, 0.003, 0.002, 0.001),
)
"""Sizes of small zones [mm] or [deg] that programs may name."""
MAX_ZONE_RATIO: Final = 1.7
"""Maximum ratio of adjacent zone sizes, except for sizes within :data:`PATH_ACCURACY_MM`."""
MAX_ZONE_MM: Final = 15.0
MAX_ZONE_DEG: Final = 1.0
"""Sizes of the largest zones [mm] and [deg] that programs name."""
MAX_TRACK_ZONE_MM: Final = 10.0
"""Path radius of the largest zone over which a track is rounded too [mm]. The size above is for rotation."""
TRACK_ZONE_RATIO: Final = 2.0
"""Factor by which a zone over which a track is rounded may be smaller than the available length."""
REST_DISTANCE_MM: Final = 0.01
"""A TCP is at rest in a move that is no longer than this [mm]. Corners next to it are sized by angle."""
_MAX_CORNER_FRACTION: Final = 0.5


def max_zones(
    position: FloatArray,
    quaternion: FloatArray,
    stop: BoolArray,
    levers: FloatArray | float = ROTATION_LEVER_MM,
    deviation: FloatArray | float = CORNER_DEVIATION_MM,
) -> tuple[FloatArray, FloatArray]:
    """Return the largest zones at the ends of M moves between M + 1 poses.

    Args:
        position: Positions of the poses (M + 1, 3) [mm].
        quaternion: Orientations of the poses (M + 1, 4).
        stop: Whether the motion stops at each pose (M + 1,).
        levers: Lengths that convert rotation about the tool's axes to distance (3,) [mm/rad].
        deviation: Maximum distance of a corner from its target (M,) [mm].

    Returns:
        Zones (M,) [mm] and (M,) [rad]; 0 at stops. Those in mm are 0 where the TCP rests in an adjacent move.
    """
    steps_mm, rotations = np.diff(position, axis=0), _rotation_steps(quaternion)
    angle = 2.0 * np.arcsin(np.clip(0.5 * lengths(rotations), 0.0, 1.0))
    steps = np.concatenate([steps_mm, levers * rotations], axis=1)
    max_deviation = np.broadcast_to(deviation, stop.shape)[:-1]
    zones = np.zeros((2, len(stop)))
    for zone, move_sizes in zip(zones, (lengths(steps_mm), angle), strict=True):
        zone[:-1] = _zone_sizes(steps, move_sizes, max_deviation)
    zones[:, stop] = 0.0
    return np.where(_shorter(lengths(steps_mm)) > REST_DISTANCE_MM, zones[0], 0.0), zones[1]


@dataclasses.dataclass(frozen=True, eq=False)
class MoveTiming:
    """Durations and end speeds of M moves.

    Attributes:
        duration: Durations (M,) [s].
        start_ratio: Velocity at the start of each move (M,), relative to its mean.
        end_ratio: Velocity at the end of each move (M,), relative to its mean.
    """

    duration: FloatArray
    start_ratio: FloatArray
    end_ratio: FloatArray


def corner_fractions(
    position: FloatArray,
    quaternion: FloatArray,
    timing: MoveTiming,
    levers: FloatArray,
    deviation: FloatArray,
    track_mm: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return over which fraction of the shorter adjacent move's time each corner between M moves is rounded.

    A zone is a length. The faster move passes it in less time than the slower one, and the fraction is that
    of the shorter time. No zone is larger than those that programs name. A zone that would be smaller than
    the smallest one rounds nothing. Zones of angles round only corners at which the TCP rests on both sides.

    Args:
        position: As for :func:`max_zones`.
        quaternion: As for :func:`max_zones`.
        timing: Durations and end speeds of the moves.
        levers: As for :func:`max_zones`.
        deviation: As for :func:`max_zones`.
        track_mm: Positions of a coordinated track (M + 1,) [mm]. There is a corner where its ratio to the
            tool's path changes, however straight the tool moves.

    Returns:
        Lower bounds of the fraction (M - 1,) on both sides of each corner: by the zone that :func:`max_zones`
        allows, and by what the controller rounds without a zone.
    """
    steps_mm, rotations = np.diff(position, axis=0), _rotation_steps(quaternion)
    duration, ratios = timing.duration, (timing.start_ratio, timing.end_ratio)
    start_rate, end_rate = (ratio[:, None] / duration[:, None] for ratio in ratios)
    measures = [(steps_mm, PATH_ACCURACY_MM), (rotations, PATH_ACCURACY_RAD)]
    if track_mm is not None:
        measures.append((np.column_stack([steps_mm, np.diff(track_mm)]), PATH_ACCURACY_MM))
    changes = [
        (_max_lateral_change((step * end_rate)[:-1], (step * start_rate)[1:]), accuracy)
        for step, accuracy in measures
    ]
    without_zone = np.minimum.reduce(
        [_time_fraction(lateral_change, duration, accuracy) for lateral_change, accuracy in changes]
    )
    steps = np.concatenate([steps_mm, levers * rotations], axis=1)
    lengths_mm = lengths(steps_mm)
    angle = np.rad2deg(lengths(rotations))
    is_at_rest = np.maximum(lengths_mm[1:], lengths_mm[:-1]) <= REST_DISTANCE_MM
    moving_mm = np.where(lengths_mm > REST_DISTANCE_MM, lengths_mm, 0.0)
    zone = np.where(
        is_at_rest, _zone_sizes(steps, angle, deviation[:-1]), _zone_sizes(steps, moving_mm, deviation[:-1])
    )
    max_ratio, max_size = (
        (MAX_ZONE_RATIO, MAX_ZONE_MM) if track_mm is None else (TRACK_ZONE_RATIO, MAX_TRACK_ZONE_MM)
    )
    # the program may name a zone that is smaller by the ratio
    size = np.minimum(zone / max_ratio, np.where(is_at_rest, MAX_ZONE_DEG, max_size))
    per_mm, per_deg = (
        duration / np.maximum(move_sizes, 1e-9) for move_sizes in (lengths_mm, angle)
    )  # [s/mm] and [s/deg]
    pace = np.where(is_at_rest, np.minimum(per_deg[1:], per_deg[:-1]), np.minimum(per_mm[1:], per_mm[:-1]))
    fraction = size * pace / np.minimum(duration[1:], duration[:-1])
    return np.where(size >= FINE_ZONE_SIZES[-1], fraction, 0.0), without_zone


def _rotation_steps(quaternion: FloatArray) -> FloatArray:
    """Return rotations (M, 3) about the tool's own axes between M + 1 orientations (M + 1, 4) as w, x, y, z.

    Their length is the chord 2 sin(angle / 2), nearly the angle [rad]. Signs of quaternions do not matter.
    """
    a, b = quaternion[:-1], quaternion[1:]
    w, u, v = a[:, :1], a[:, 1:], b[:, 1:]
    half = w * v - b[:, :1] * u - np.cross(u, v)
    return np.asarray(2.0 * half * np.where(dots(a, b) < 0.0, -1.0, 1.0)[:, None])


def _zone_sizes(steps: FloatArray, sizes: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return the sizes (M - 1,) of the largest zones at the corners between M moves.

    A corner that is rounded over the length z before and after it passes the target at z |dr| / 4. Here dr is
    the change, across the path, of the steps over their lengths (quadratic Bezier curve with the corner as
    its control point). It is also no farther away than its ends.

    Args:
        steps: Displacements of the moves, with rotation as distance (M, D) [mm].
        sizes: Lengths of the moves in the unit of the zones (M,). A zone is at most half of the shorter one.
        deviation: Maximum distance of each corner from its target (M - 1,) [mm].
    """
    rate = steps / np.maximum(sizes, 1e-9)[:, None]
    deviation_rate = np.minimum(0.25 * _lateral_change(rate), _shorter(lengths(rate))[:-1])
    return np.asarray(
        np.minimum(_MAX_CORNER_FRACTION * _shorter(sizes)[:-1], deviation / np.maximum(deviation_rate, 1e-12))
    )


def _time_fraction(
    lateral_change: FloatArray, duration: FloatArray, deviation: FloatArray | float
) -> FloatArray:
    """Return the fraction (M - 1,) of the shorter move that a corner may use on each side.

    It is at most one half. ``lateral_change`` (M - 1,) is the change of velocity across the path. As in
    :func:`_zone_sizes`, a corner that is rounded over the time h passes the target at h |dv| / 4, with dv
    that change.
    """
    full_deviation = np.minimum(duration[:-1], duration[1:]) * lateral_change / 4.0
    return np.asarray(np.minimum(_MAX_CORNER_FRACTION, deviation / np.maximum(full_deviation, 1e-12)))


def _lateral_change(rate: FloatArray) -> FloatArray:
    """Return the change (M - 1,) of velocities (M, D) across the path: along the bisector of the corner.

    Only this component leaves the path. At equal speeds it is all of the change.
    """
    size = lengths(rate)
    along = rate / np.maximum(size, 1e-12)[:, None]
    lateral = 0.5 * (size[1:] + size[:-1]) * lengths(np.diff(along, axis=0))
    is_at_rest = np.minimum(size[1:], size[:-1]) < 1e-9
    return np.where(is_at_rest, lengths(np.diff(rate, axis=0)), lateral)


def _max_lateral_change(incoming: FloatArray, outgoing: FloatArray) -> FloatArray:
    """Return an upper bound (M - 1,) of the change of velocity across the path.

    It holds for a controller that keeps the faster of two speeds. Velocities before and after corners are (M
    - 1, D).
    """
    sizes = lengths(incoming), lengths(outgoing)
    first, second = (
        rate / np.maximum(s, 1e-12)[:, None] for rate, s in zip((incoming, outgoing), sizes, strict=True)
    )
    return np.asarray(np.minimum(np.maximum(*sizes) * lengths(second - first), lengths(outgoing - incoming)))


def _shorter(size: FloatArray) -> FloatArray:
    """Return the smaller of each value (M,) and the next one. The next one after the last is 0."""
    return np.asarray(np.minimum(size, np.append(size[1:], 0.0)))
