"""The working ends of tools that form and mill: what of them touches the stock."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class FormingHead:
    """The working end of a forming tool, a body of revolution about the TCP's z axis, which points out of it.

    ``kind`` "ball": a ball of ``radius`` [m] about the TCP, its centre, on a shaft of ``shaft_radius`` [m]
    that begins ``neck`` [m] behind the centre; between them the neck is as thick as the thinner of both.
    "disk": a flat disk of ``radius`` about the TCP, the middle of its face, with a rim rounded by ``rim``
    [m], as thick as ``neck``, on the shaft. "heat": a nozzle of that radius whose TCP is ``standoff`` [m]
    before it, at the place to be heated. ``length`` [m] of head and shaft behind the TCP.
    """

    kind: Literal["ball", "disk", "heat"]
    radius: float
    shaft_radius: float
    neck: float
    length: float
    rim: float = 0.0
    standoff: float = 0.0


CutterKind = Literal["cylinder", "ball", "bull"]


@dataclasses.dataclass(frozen=True)
class Cutter:
    """The cutter of a milling tool, a body of revolution about the TCP's z axis, which points out of it; the
    TCP is its tip, the middle of its end.

    ``radius`` [m]; ``corner`` [m] rounds its end: 0 for a cylinder, the radius for a ball nose, between for a
    bull nose. It cuts along ``flute`` [m] behind its tip; behind that its shank of radius ``shank`` [m] goes
    on to the nose of the holder, ``overhang`` [m] behind the tip. ``behind`` (K, 2) [m] is the outline of
    holder and spindle: distance behind the tip and radius there.
    """

    kind: CutterKind
    radius: float
    corner: float
    flute: float
    overhang: float
    shank: float
    behind: FloatArray


def profile(head: FormingHead) -> FloatArray:
    """Outline (K, 2) [m] of a head: distance behind the TCP along its axis and radius there, ascending.

    A ball begins ``radius`` before the TCP, a disk at it, a nozzle ``standoff`` behind it.
    """
    if head.kind == "heat":
        return np.array([[head.standoff, head.radius], [head.length, head.radius]])
    if head.kind == "disk":
        turn = np.linspace(0.0, 0.5 * np.pi, 9)
        rim = np.stack([head.rim * (1 - np.cos(turn)), head.radius - head.rim + head.rim * np.sin(turn)], 1)
        back = [[head.neck, head.radius], [head.neck, head.shaft_radius], [head.length, head.shaft_radius]]
        return np.concatenate([rim, back])
    thin = min(head.radius, head.shaft_radius)
    turn = np.linspace(0.0, np.pi - np.arcsin(thin / head.radius), 25)
    ball = head.radius * np.stack([-np.cos(turn), np.sin(turn)], 1)
    neck = max(head.neck, float(ball[-1, 0]))
    return np.concatenate([ball, [[neck, thin], [neck, head.shaft_radius], [head.length, head.shaft_radius]]])
