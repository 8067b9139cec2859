"""Claims of trimming: what must hold of curves that are cut out of a sheet, as data in the sheet's frame.

See ``planner.claims.claim`` for what a claim is.
"""

import dataclasses
from pathlib import Path
from typing import Final

from planner.claims.claim import Claim, Power
from planner.claims.drawn_curve import DrawnCurve
from planner.tooling import Blade, Cutter, Torch


@dataclasses.dataclass(frozen=True)
class TrimOutline:
    """A closed curve as the problem states it: a drawn curve or a circle.

    If the drawn curve stands for all curves of a file, each of them is an outline with a number after the
    name.

    Attributes:
        name: Name of the outline.
        drawn: Curve, None for a circle.
        centre: Centre of the circle (2,) [mm]; zeros for a drawn curve.
        diameter: Diameter of the circle [mm]; 0 for a drawn curve.
        drops_inside: Whether the sheet inside the curve is waste and drops, otherwise the sheet outside.
        joints: Number of micro-joints, which are left uncut in the slot.
        width: Width of a micro-joint [m].
    """

    name: str
    drawn: DrawnCurve | None
    centre: tuple[float, float]
    diameter: float
    drops_inside: bool
    joints: int
    width: float


@dataclasses.dataclass(frozen=True)
class SurfaceFile:
    """A mesh of the sheet as it is, in the problem's words, like ``part.sheet_mesh`` of a problem file."""

    file: Path
    unit: str | None
    face: str
    frame: str
    down: bool
    tolerance_mm: float | str


@dataclasses.dataclass(frozen=True)
class TrimCutter:
    """A mill that goes through the sheet, normal to it.

    It comes down without rotation to ``start_height`` above the face, at a sufficient distance from all
    curves. From there it goes into the waste.

    Attributes:
        cutter: The cutter.
        depth_below: Depth of its tip below a sheet of full thickness [m].
        start_height: Height above the face from which it plunges [m].
        is_ramp: Whether it goes down along its lead-in, otherwise straight down.
        plunge: Maximum speed along its axis [m/s].
        spin_up: Minimum time [s] for which the spindle is on before the cutter plunges. It stays on until the
            tip is ``start_height`` above the face again.
    """

    cutter: Cutter
    depth_below: float
    start_height: float
    is_ramp: bool
    plunge: float
    spin_up: float


@dataclasses.dataclass(frozen=True)
class TrimBlade:
    """A knife that goes through the sheet, normal to it.

    While it is in the sheet, it is aligned with the curve, its edge ahead. It comes down without rotation
    to ``start_height`` above the face, and from there onto the curve along its axis. It leaves the sheet in
    the same way.

    Attributes:
        blade: The blade.
        body: Radius of the knife's body [m].
        back: End of the body behind the tip [m].
        depth_below: Depth of its tip below a sheet of full thickness [m].
        start_height: Height above the face from which it plunges [m].
        heading_tolerance: Allowed angle between blade and curve [rad].
        max_corner: Maximum angle of a corner that it passes inside the sheet [rad].
        overcut: Maximum cut into the part past a sharper corner [m].
        plunge: Maximum speed along its axis [m/s].
        spin_up: Minimum time [s] for which its drive, if it has one, is on before the blade plunges.
    """

    blade: Blade
    body: float
    back: float
    depth_below: float
    start_height: float
    heading_tolerance: float
    max_corner: float
    overcut: float
    plunge: float
    spin_up: float


@dataclasses.dataclass(frozen=True)
class TrimsSheet(Claim):
    """In trimming segments the tool cuts all outlines on one face of the formed sheet.

    Inner outlines are cut before outer ones. Outlines are projected along z. Each slot is closed but for its
    joints. The slot lies in the waste, with its edge on the curve. That of a knife has no width and lies on
    the curve. The TCP of a torch is on the face, and where it leads in no higher than ``pierce_height``
    allows. The TCP of other tools is at its required depth.

    A torch is switched on only in trimming segments, at rest in the waste. Then the program waits for the
    input ``ok_signal``, if there is one, and for ``pierce_seconds``. The proof reads part and curves itself.

    Attributes:
        arm: Arm that carries the tool.
        side: +1 for the upper face, -1 for the lower one.
        thickness: Thickness of the flat sheet [m].
        surface_error: Stated deviation of the vertices of the mesh from the face [m], at most what the proof
            finds.
        surface: Mesh of the sheet, None for the part of the problem.
        outlines: Outlines to cut.
        kerf: Width of the slot [m].
        torch: Torch, if one cuts.
        mill: Mill, if one cuts.
        knife: Knife, if one cuts.
        tolerance: Allowed distance of the slot's edge from the curve [m].
        height_tolerance: Allowed deviation of the TCP along the normal [m].
        cone: Maximum angle between tool and normal [rad].
        clearance: Minimum distance to the sheet of all that does not cut [m].
        feed: Feed in the flat sheet [m/s]; on a wall it is divided by the cosine of the wall angle.
        max_feed: Maximum feed [m/s].
        min_feed_fraction: Minimum average feed as a fraction of the required one. It does not apply to a
            knife.
        signal: Output that switches the tool, empty for a knife that is dragged.
        ok_signal: Input that reports the arc, None if the program does not wait for it.
        timeout: Maximum wait for that input [s].
        pierce_height: Height of the nozzle where the torch pierces [m].
        pierce_seconds: Wait at the pierce point once the arc burns [s].
        pierce_distance: Minimum distance from all curves where the torch pierces or the mill goes into the
            sheet [m].
    """

    arm: str
    side: int
    thickness: float
    surface_error: float
    surface: SurfaceFile | None
    outlines: tuple[TrimOutline, ...]
    kerf: float
    torch: Torch | None
    mill: TrimCutter | None
    knife: TrimBlade | None
    tolerance: float
    height_tolerance: float
    cone: float
    clearance: float
    feed: float
    max_feed: float
    min_feed_fraction: float
    signal: str
    ok_signal: str | None
    timeout: float
    pierce_height: float
    pierce_seconds: float
    pierce_distance: float

    def power(self) -> Power | None:
        """Return the output of the torch or of the drive, None for a knife that is dragged."""
        return Power(self.signal, burns=self.torch is not None) if self.signal else None

    @property
    def through_tool(self) -> TrimCutter | TrimBlade | None:
        """The mill or knife that goes through the sheet, None for a torch."""
        return self.knife if self.mill is None else self.mill

    @property
    def spindle_rule(self) -> tuple[str, str]:
        """The arm whose spindle ``verify.trim_spindle`` judges, and the kind of segments."""
        return self.arm, "trim"


MAX_STRETCHES: Final = 200
"""Maximum number of times that a knife is lifted on one curve."""


def slot_names(claim: TrimsSheet, outline: TrimOutline) -> tuple[str, ...]:
    """Return the names that the slots of an outline may have.

    They are its own name, or a number for each slot between two joints. A knife is lifted as often as
    necessary, so all numbers are possible. Its slot has the outline's own name if it is never lifted.

    Args:
        claim: Claim on the sheet.
        outline: Outline.
    """
    count = MAX_STRETCHES if claim.knife is not None else outline.joints
    numbers = tuple(f"{outline.name}_p{k + 1}" for k in range(count))
    return (outline.name, *numbers) if claim.knife is not None else numbers or (outline.name,)


CLAIMS: Final[tuple[type[Claim], ...]] = (TrimsSheet,)
"""Kinds of claims of trimming."""
