"""Trials of forming with two robots, from `data/forming_trials.yaml`, and the warnings that they give.

They are single trials of one lab with metals of unstated alloy: hints of what may go wrong, no limits.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from pathlib import Path
from typing import Any, Final

import yaml

from planner.issues import Issue, Severity
from planner.units import DEG, MM

_FILE: Final = Path(__file__).resolve().parents[1] / "data" / "forming_trials.yaml"

MODES: Final = {"spif": "isf", "dpif_p": "dpif_p", "dpif_l": "dpif_l", "dsif": "dpif_l"}
"""The trials' mode that is likest to a mode of forming; the others have none."""
CAUSES: Final = {
    "force": "the robot stopped with a collision error, from the forming force,",
    "border_tear": "the sheet tore along the border",
    "local_tear": "the sheet tore at the forming tool",
    "completed": "the part was completed",
}
NAMES: Final = {"isf": "no support", "dpif_p": "support on the border", "dpif_l": "support opposite the tool"}
ANGLE_SLACK: Final = 5.0 * DEG
DEPTH_SLACK: Final = 0.9
THICKNESS_SLACK: Final = 1.25
"""How near to a trial's wall angle, depth and thickness a part must come to be like it."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """One trial. Lengths [m], ``angle`` [rad], ``feed`` [m/s], ``duration`` [s]. ``mode`` is isf, dpif_p or
    dpif_l, ``cause`` what stopped it at ``depth``: force, border_tear, local_tear or completed.
    ``second_depth`` [m] of a stage the other way inside the first."""

    name: str
    mode: str
    family: str
    thickness: float
    angle: float
    diameter: float
    stepdown: float
    feed: float
    depth: float
    second_depth: float | None
    duration: float
    cause: str
    former: str
    supporter: str | None
    support_tool: str | None
    lubricant: str
    note: str

    @property
    def failed(self) -> bool:
        """Whether something else than its end stopped it."""
        return self.cause != "completed"


@functools.lru_cache(maxsize=1)
def trials() -> tuple[Trial, ...]:
    """All trials, in the order of their source."""
    with _FILE.open(encoding="utf-8") as stream:
        return tuple(_trial(entry) for entry in yaml.safe_load(stream)["trials"])


def nearest_failed(family: str, thickness: float, angle: float, depth: float, mode: str) -> Trial | None:
    """The failed trial that says most of such a part; None if no trial is like it.

    ``family`` of the sheet metal, ``thickness`` [m], steepest wall ``angle`` [rad], ``depth`` [m],
    ``mode`` of forming. A trial is like it if the metal is of the same family, the part as steep and deep at
    least, and its sheet no thinner than one that met too much force, or no thicker than one that tore.
    """
    if mode not in MODES:
        return None
    like = [
        trial
        for trial in trials()
        if trial.failed
        and trial.family == family
        and trial.mode == MODES[mode]
        and angle >= trial.angle - ANGLE_SLACK
        and depth >= DEPTH_SLACK * trial.depth
        and _as_bad(trial, thickness)
    ]
    return min(like, key=lambda trial: _distance(trial, thickness, angle, depth), default=None)


def warning(family: str, thickness: float, angle: float, depth: float, mode: str) -> Issue | None:
    """A warning (forming.trial) of what stopped the nearest failed trial; arguments as `nearest_failed`."""
    trial = nearest_failed(family, thickness, angle, depth, mode)
    if trial is None:
        return None
    helper = f", {trial.support_tool}" if trial.support_tool else ""
    part = (
        f"{thickness / MM:g} mm {family.replace('_', ' ')}, {angle / DEG:.0f} deg, {depth / MM:.0f} mm deep"
    )
    return Issue(
        "forming.trial",
        f"{part}: in a trial ({trial.name}: {NAMES[trial.mode]}{helper}, {trial.thickness / MM:g} mm, "
        f"{trial.angle / DEG:.0f} deg, {trial.lubricant}) {CAUSES[trial.cause]} at a depth of "
        f"{trial.depth / MM:.0f} mm; one trial in one lab, with metal of unstated alloy: a hint, no limit",
        Severity.WARNING,
        value=depth / MM,
        limit=trial.depth / MM,
        unit="mm",
        hint=f"form a test piece first; of the trial: {trial.note}",
    )


def _as_bad(trial: Trial, thickness: float) -> bool:
    if trial.cause == "force":  # thicker sheet takes more force
        return thickness >= trial.thickness / THICKNESS_SLACK
    return thickness <= trial.thickness * THICKNESS_SLACK  # thinner sheet tears sooner


def _distance(trial: Trial, thickness: float, angle: float, depth: float) -> float:
    return math.hypot(
        math.log(thickness / trial.thickness),
        (angle - trial.angle) / (15.0 * DEG),
        math.log(depth / trial.depth),
    )


def _trial(entry: dict[str, Any]) -> Trial:
    second = entry.get("second_depth_mm")
    return Trial(
        name=entry["name"],
        mode=entry["mode"],
        family=entry["family"],
        thickness=float(entry["thickness_mm"]) * MM,
        angle=float(entry["angle_deg"]) * DEG,
        diameter=float(entry["diameter_mm"]) * MM,
        stepdown=float(entry["stepdown_mm"]) * MM,
        feed=float(entry["feed_mm_s"]) * MM,
        depth=float(entry["depth_mm"]) * MM,
        second_depth=None if second is None else float(second) * MM,
        duration=float(entry["minutes"]) * 60.0,
        cause=entry["cause"],
        former=entry["former"],
        supporter=entry["supporter"],
        support_tool=entry["support_tool"],
        lubricant=entry["lubricant"],
        note=entry["note"],
    )
