"""What a slot of a round wire cannot reach of a ruled surface, from the part alone: in an acute inner
corner, or in a groove that is narrower than the slot, foam stays on the part however the wire goes.

In the plane across the wire the surface is a polyline. The middle of a slot may stand wherever no part of the
line is nearer than half of it; how far the nearest such place is from a point of the surface is looked up
among places that lie densely along the line's parallel. A place on the other side of a wall of the part does
not count: what is cut there takes nothing off this side.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.claims import FollowsRulings
from planner.geometry.vectors import dots

FloatArray = NDArray[np.float64]

DENSE: Final = 5e-5
"""[m] distance of the places that are tried."""
NEARER: Final = 2e-6
"""[m] a place that is nearer to the line than half a slot by less is not too near."""
FAN: Final = np.deg2rad(3.0)
"""[rad] turn between the places that are tried around an outer corner."""


def unreached(claim: FollowsRulings, places: FloatArray, half: float) -> FloatArray:
    """How much (N,) [m] farther than ``half`` [m] a slot's middle must stay from places (N, 3) of the surface
    that a claim follows; infinite where that is more than the claim allows to be left by far."""
    out = np.empty(len(places))
    along = claim.end - claim.start
    middle = claim.start + 0.5 * along
    for k, place in enumerate(places):
        nearest = int(np.argmin(dots(place - middle, place - middle)))
        axis = along[nearest] / np.linalg.norm(along[nearest])
        out[k] = _farther(_section(claim, along, place, axis), half, claim.left, claim.tolerance)
    return out


def _section(claim: FollowsRulings, along: FloatArray, place: FloatArray, axis: FloatArray) -> FloatArray:
    """The surface (M, 2) across ``axis`` as seen from a place; the part is to the left of its way."""
    share = (place - claim.start) @ axis / (along @ axis)
    row = claim.start + share[:, None] * along - place
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    one /= np.linalg.norm(one)
    return np.stack([row @ one, row @ np.cross(axis, one)], axis=1)


def _farther(line: FloatArray, half: float, left: float, thin: float) -> float:
    """How much farther than ``half`` the nearest admissible place is from the origin, a point of the line,
    that does not lie behind more than ``thin`` of the part."""
    reach = 2.0 * half + left + 1e-3
    a, b = line[:-1], line[1:]
    size = np.linalg.norm(b - a, axis=1)
    own = (size > 1e-9) & (_apart(np.zeros((1, 2)), a, b)[0] < reach + 2.0 * half)
    a, b, size = a[own], b[own], size[own]
    if not len(a):
        return 0.0
    way = (b - a) / size[:, None]
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1)
    tried = [_fans(a, b, normal, half)]
    for start, end, out, length in zip(a, b, normal, size, strict=True):
        share = np.linspace(0.0, 1.0, max(int(np.ceil(length / DENSE)), 1) + 1)[:, None]
        tried.append(start + share * (end - start) + half * out)
    places = np.concatenate(tried)
    distance = np.linalg.norm(places, axis=1)
    near = np.argsort(distance, kind="stable")
    near = near[distance[near] <= reach]
    for low in range(0, len(near), 256):  # the nearest ones first: one is enough
        some = near[low : low + 256]
        free = _apart(places[some], a, b).min(axis=1) >= half - NEARER
        for k in some[free]:
            if _within(places[k], a, b) <= thin:
                return max(float(distance[k]) - half, 0.0)
    return float("inf")


def _within(place: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """How much of the way from the origin to a place outside is within the part, whose border are the pieces
    of a line, ``a`` to ``b`` (M, 2): between the crossings, counted from the place."""
    edge = b - a
    across = place[0] * edge[:, 1] - place[1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (a[:, 0] * edge[:, 1] - a[:, 1] * edge[:, 0]) / across
        on = (a[:, 0] * place[1] - a[:, 1] * place[0]) / across
    length = float(np.linalg.norm(place))
    crossed = (across != 0.0) & (on >= 0.0) & (on < 1.0) & (share * length > NEARER) & (share < 1.0)
    at = np.sort(share[crossed])[::-1]
    if len(at) % 2:  # the last of them is where the way begins
        at = np.append(at, 0.0)
    return float((at[::2] - at[1::2]).sum()) * length


def _fans(a: FloatArray, b: FloatArray, normal: FloatArray, half: float) -> FloatArray:
    """Places (F, 2) around the corners between pieces that follow one another, from one's normal to the
    other's."""
    joined = np.flatnonzero(np.linalg.norm(b[:-1] - a[1:], axis=1) < 1e-9)
    out = [np.zeros((0, 2))]
    for k in joined:
        n, m = normal[k], normal[k + 1]
        turn = np.arctan2(n[0] * m[1] - n[1] * m[0], n @ m)
        angle = np.linspace(0.0, turn, max(int(np.ceil(abs(turn) / FAN)), 1) + 1)
        c, s = np.cos(angle), np.sin(angle)
        out.append(b[k] + half * np.stack([c * n[0] - s * n[1], s * n[0] + c * n[1]], axis=1))
    return np.concatenate(out)


def _apart(places: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance (N, M) of places (N, 2) from pieces of a line, ``a`` to ``b`` (M, 2)."""
    edge, to = b - a, places[:, None] - a
    share = dots(to, np.broadcast_to(edge, to.shape)) / np.maximum(dots(edge, edge), 1e-30)
    off = to - np.clip(share, 0.0, 1.0)[..., None] * edge
    return np.asarray(np.sqrt(dots(off, off)))
