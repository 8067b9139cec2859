"""What must hold of curves that a torch cuts out of a sheet, as data, in the sheet's frame; see
``claims.claim``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from planner.claims.milling import DrawnCurve
from planner.tooling import Torch


@dataclasses.dataclass(frozen=True)
class TrimOutline:
    """A closed curve as the problem has it, ``drawn`` or a circle of ``middle`` (2,) and ``diameter`` [mm],
    whose ``inside`` drops, or what is outside. ``joints`` pieces of metal, ``width`` [m] across, stay in its
    slot.

    With ``layers`` it stands for all curves of the file that is ``drawn``, each an outline of its own: those
    of one layer after the other (None: of all at once) in the order of the file, with numbers behind the
    name."""

    name: str
    drawn: DrawnCurve | None
    middle: tuple[float, float]
    diameter: float
    inside: bool
    joints: int
    width: float
    layers: tuple[str | None, ...] = ()


@dataclasses.dataclass(frozen=True)
class SurfaceFile:
    """A mesh of the sheet as it is, in the problem's own words: as ``part.sheet_mesh`` of a problem file."""

    file: Path
    unit: str | None
    face: str
    frame: str
    down: bool
    tolerance_mm: float | str


@dataclasses.dataclass(frozen=True)
class TrimsSheet:
    """In trimming segments ``torch`` on ``arm`` cuts all of ``outlines``, laid along z on one face of the
    formed sheet, each closed but for its joints, inner ones before outer ones.

    The face is the upper one (``side`` +1) or the lower one of the part of the problem, or of the mesh
    ``surface``; ``thickness`` [m] is the flat sheet's. The proof reads part and curves itself.

    The slot lies in the waste, its edge on the curve within ``tolerance`` [m]. The TCP is on the face within
    ``height`` [m], and where it leads in no higher than the nozzle's ``pierce_height`` [m] says; the torch
    leans no farther than ``cone`` [rad] off the normal, and no part of it is nearer to the sheet than
    ``clear`` [m]. It goes at ``feed`` [m/s] over the cosine of the wall's angle, at ``feed_most`` at most and
    at the share ``least_feed`` of that on average.

    The output ``signal`` is on in trimming segments alone, and goes on at rest in the waste, ``pierce_off``
    [m] off all curves; then the program waits for the input ``ok_signal``, if there is one, ``timeout`` [s]
    at most, and ``pierce_seconds`` [s] more.
    """

    arm: str
    side: int
    thickness: float
    surface: SurfaceFile | None
    outlines: tuple[TrimOutline, ...]
    torch: Torch
    tolerance: float
    height: float
    cone: float
    clear: float
    feed: float
    feed_most: float
    least_feed: float
    signal: str
    ok_signal: str | None
    timeout: float
    pierce_height: float
    pierce_seconds: float
    pierce_off: float
