"""What must hold of curves that are cut out of a sheet, as data, in the sheet's frame; see
``claims.claim``."""

import dataclasses
from pathlib import Path
from typing import Final

from planner.claims.claim import Claim, Power
from planner.claims.drawn_curve import DrawnCurve
from planner.tooling import Blade, Cutter, Torch


@dataclasses.dataclass(frozen=True)
class TrimOutline:
    """A closed curve as the problem has it, ``drawn`` or a circle of ``middle`` (2,) and ``diameter`` [mm],
    whose ``inside`` drops, or what is outside. ``joints`` pieces of metal, ``width`` [m] across, stay in its
    slot.

    Where what is ``drawn`` stands for all curves of a file, each is an outline of its own, with numbers
    behind the name."""

    name: str
    drawn: DrawnCurve | None
    middle: tuple[float, float]
    diameter: float
    inside: bool
    joints: int
    width: float


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
class TrimCutter:
    """A mill that goes through the sheet, square to it: ``cutter``, whose tip is ``below`` [m] lower than a
    sheet of its whole thickness.

    It comes down, not turned, to ``start`` [m] over the face, far enough off all curves, and from there into
    the waste, where ``ramp`` on its way in, else straight, along its axis no faster than ``plunge`` [m/s].
    Its spindle has been on for ``spin_up`` [s] then, and is until it is ``start`` over the face again.
    """

    cutter: Cutter
    below: float
    start: float
    ramp: bool
    plunge: float
    spin_up: float


@dataclasses.dataclass(frozen=True)
class TrimBlade:
    """A knife that goes through the sheet, square to it: ``blade``, whose tip is ``below`` [m] lower than a
    sheet of its whole thickness, in a body of radius ``body`` [m] that goes on to ``back`` [m] behind the
    tip.

    Wherever it is in the sheet it stands along the curve within ``heading`` [rad], its edge ahead. It comes
    down, not turned, to ``start`` [m] over the face, and from there on the curve along its axis no faster
    than ``plunge`` [m/s]; so it comes out again. Corners of the curve sharper than ``turns`` [rad] it does
    not go round in the sheet. Past one it cuts into the part by ``overcut`` [m] at most. Its drive, if it
    has one, has been on for ``spin_up`` [s] then.
    """

    blade: Blade
    body: float
    back: float
    below: float
    start: float
    heading: float
    turns: float
    overcut: float
    plunge: float
    spin_up: float


@dataclasses.dataclass(frozen=True)
class TrimsSheet(Claim):
    """In trimming segments ``torch``, the mill ``mill`` or the knife ``knife`` on ``arm`` cuts all of
    ``outlines``, laid along z
    on one face of the formed sheet, each closed but for its joints, inner ones before outer ones.

    The face is the upper one (``side`` +1) or the lower one of the part of the problem, or of the mesh
    ``surface``; ``thickness`` [m] is the flat sheet's. The proof reads part and curves itself. ``rough`` [m]
    is how far the vertices of the mesh are said to be off the face, at most as far as the proof finds them.

    The slot, ``kerf`` [m] wide, lies in the waste, its edge on the curve within ``tolerance`` [m]; a knife's
    has no width, and lies on the curve. The TCP of
    a torch is on the face within ``height`` [m], and where it leads in no higher than the nozzle's
    ``pierce_height`` [m] says; of others it is as deep as wanted within that. The tool leans no farther than
    ``cone`` [rad] off the normal, and no part of it, but for what cuts of a mill or a knife, is nearer to the
    sheet than ``clear`` [m]. It goes at ``feed`` [m/s] over the cosine of the wall's angle, at ``feed_most``
    at most and, but for a knife, at the share ``least_feed`` of that on average.

    The output ``signal`` of a torch is on in trimming segments alone, and goes on at rest in the waste,
    ``pierce_off`` [m] off all curves, as far as a mill goes into the sheet; then the program waits for the
    input ``ok_signal``, if there is one, ``timeout`` [s] at most, and ``pierce_seconds`` [s] more. A knife
    that is dragged has none: it is empty.
    """

    arm: str
    side: int
    thickness: float
    rough: float
    surface: SurfaceFile | None
    outlines: tuple[TrimOutline, ...]
    kerf: float
    torch: Torch | None
    mill: TrimCutter | None
    knife: TrimBlade | None
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

    def power(self) -> Power | None:
        """Return the output of the torch or of the drive, None for a knife that is dragged."""
        return Power(self.signal, burns=self.torch is not None) if self.signal else None

    @property
    def through(self) -> TrimCutter | TrimBlade | None:
        """What goes through the sheet, if that is not a torch."""
        return self.knife if self.mill is None else self.mill

    @property
    def spindle_rule(self) -> tuple[str, str]:
        """``verify.trim_spindle`` judges the spindle of a mill that trims."""
        return self.arm, "trim"


MOST_STRETCHES: Final = 200
"""A knife is lifted so often on one curve at most."""


def slot_names(claim: TrimsSheet, one: TrimOutline) -> tuple[str, ...]:
    """Names of the slots of an outline: its own, or a number for each between two joints. Those that a knife
    may have, which is lifted as often as it must: its own alone where it is never lifted."""
    count = MOST_STRETCHES if claim.knife is not None else one.joints
    numbers = tuple(f"{one.name}_p{k + 1}" for k in range(count))
    return (one.name, *numbers) if claim.knife is not None else numbers or (one.name,)


CLAIMS: Final[tuple[type[Claim], ...]] = (TrimsSheet,)
"""Kinds of claims of trimming."""
