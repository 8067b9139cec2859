"""Axes beyond an arm in a cell file: a linear track under its base, with what cannot be one told.

Tracks of KUKA arms, turntables, gantries and tracks that move while an arm works are not written yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.problem import Arm, Controller, LinearTrack
from planner.reading.strict_yaml import Name, Strict, Vector

LEAST_AXIS: Final = 1e-9
"""Directions shorter than this have none."""


class TrackFile(Strict):
    """A linear track under an arm, that takes it from station to station between operations."""

    axis: Annotated[Vector, Field(description="direction of growing values in the world, any length")]
    range_mm: Annotated[tuple[float, float], Field(description="least and largest value")]
    unit: Annotated[Name, Field(description="its mechanical unit, `MECHANICAL_UNIT` in MOC.cfg")]
    speed_mm_s: Annotated[float, Field(le=5000, description="its highest")]
    acceleration_mm_s2: Annotated[float, Field(le=50_000, description="its highest")]
    home_mm: Annotated[float, Field(description="where it stands before a program begins")] = 0.0


def track(spec: TrackFile | None, arm: Arm, number: int) -> LinearTrack | None:
    """The track of arm ``number`` of a cell in SI units. Raises ``TandemError`` (``problem.field``,
    ``problem.track``) with all that is wrong."""
    if spec is None:
        return None
    field, wrong = f"arms.{number}.track", list[Issue]()

    def told(name: str, what: str) -> None:
        wrong.append(Issue("problem.field", f"{name}: {what}", field=f"{field}.{name}", arm=arm.name))

    low, high = spec.range_mm
    length = float(np.linalg.norm(spec.axis))
    if not length > LEAST_AXIS:
        told("axis", "its length is 0; give the direction in which values grow, such as [0, 1, 0]")
    if not low < high:
        told("range_mm", f"it goes from {low:g} to {high:g}; give the least value first, then a larger one")
    elif not low <= spec.home_mm <= high:
        told("home_mm", f"{spec.home_mm:g} is outside the range of {low:g} to {high:g}")
    for name, value in (("speed_mm_s", spec.speed_mm_s), ("acceleration_mm_s2", spec.acceleration_mm_s2)):
        if not value > 0.0:
            told(name, f"got {value:g}; allowed: above 0")
    if arm.data.family != "ABB":
        what = f"arm {arm.name} is of {arm.data.family}; tracks are written for ABB controllers alone, those "
        what += "of others (KRL's E1) not yet; take the track out and move the base, or take an ABB arm"
        wrong.append(Issue("problem.track", what, field=field, arm=arm.name))
    if arm.base_auto:
        what = f"arm {arm.name} stands on a track, whose place is not searched; state its base"
        wrong.append(Issue("problem.track", what, field=f"arms.{number}.base_auto", arm=arm.name))
    if wrong:
        raise TandemError(wrong)
    return LinearTrack(
        np.array(spec.axis) / length,
        low * MM,
        high * MM,
        spec.speed_mm_s * MM,
        spec.acceleration_mm_s2 * MM,
        spec.unit,
        spec.home_mm * MM,
    )


def check_units(arms: Sequence[Arm], controller: Controller) -> None:
    """Each track has a unit of its own. Raises ``TandemError``: ``problem.duplicate_name``, and
    ``problem.track`` for arms that meet by signals."""
    taken = {name.lower(): f"the robot {name}" for name in controller.units[: len(arms)]}
    for number, arm in enumerate(arms):
        if arm.track is None:
            continue
        field = f"arms.{number}.track"
        if controller.sync == "handshake":
            what = f"arm {arm.name} stands on a track; with two controllers (handshake) that is not written "
            what += "yet; use one controller (sync: multimove), or an arm of its own"
            raise TandemError(Issue("problem.track", what, field=field, arm=arm.name))
        unit = arm.track.unit
        if unit.lower() in taken:
            what = f"the unit {unit} is that of {taken[unit.lower()]}, too; give each track its own"
            raise TandemError(Issue("problem.duplicate_name", what, field=f"{field}.unit", arm=arm.name))
        taken[unit.lower()] = f"arm {arm.name}"
