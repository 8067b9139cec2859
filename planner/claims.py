"""What must hold of a job, as data: a process states claims, ``verify/`` proves each kind by its own rule.

Claims follow from the problem alone, never from a plan, so that a proof can start from the problem and the
program text. All geometry is in the stock frame, in metres.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True)
class WireJoins:
    """A wire of constant hot length joins the TCPs of ``arms`` from the mount to the unmount stop.

    ``length`` [m] hot, ``ei_soft``, ``ei_stiff`` [N m^2], ``gj`` [N m^2], ``weight`` [N/m],
    ``round_section``: whether it may spin. ``max_curvature`` [1/m] by the elastic limit; ``thickness`` [m] in
    the bending plane; ``end_error`` [m] is what each end may be off in reality.
    """

    arms: tuple[str, str]
    length: float
    ei_soft: float
    ei_stiff: float
    gj: float
    weight: float
    round_section: bool
    max_curvature: float
    thickness: float
    end_error: float


@dataclasses.dataclass(frozen=True)
class CutsSurface:
    """In ``segment`` the wire, with its kerf, cuts the surface ``vertices``, ``faces`` (stock frame, outward
    normals away from the part).

    ``tolerance`` [m] bounds the distance of the cut surface to the wanted one, for the fraction ``share`` of
    the surface; ``kerf`` [m] is the slot's width, half of which lies on the part's side.
    """

    segment: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    kerf: float
    tolerance: float
    share: float = 0.95


@dataclasses.dataclass(frozen=True)
class ContactOnlyIn:
    """The edge (wire) touches the stock only in segments of the kinds ``kinds``, while ``signal`` is on."""

    kinds: tuple[str, ...]
    signal: str
    heat_up: float


@dataclasses.dataclass(frozen=True)
class FeedWindow:
    """While the edge is inside the stock its fastest point there moves between ``lower`` and ``upper``
    [m/s].
    """

    segment: str
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True)
class FollowsPoses:
    """The TCP of ``arm`` passes the poses (M, 4, 4) in its work frame ``frame`` in order, up to the free axes
    ``free``.

    ``free`` are twists (6,) in the tool frame along which the pose may differ.
    """

    arm: str
    frame: str
    poses: NDArray[np.float64]
    free: tuple[NDArray[np.float64], ...]
    position_tol: float
    angle_tol: float


Claim = WireJoins | CutsSurface | ContactOnlyIn | FeedWindow | FollowsPoses
