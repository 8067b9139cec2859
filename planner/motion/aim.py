"""Tools that would like to be turned toward a point, such as their robot's base: the wanted values of their
spin, and what following them would be worth."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from planner.motion.paths import find
from planner.motion.scene import Scene
from planner.motion.search import Found, speed_limits
from planner.targets import Aim, ScrewFreedom, Targets
from planner.units import DEG

FloatArray = NDArray[np.float64]

COLUMNS: Final = (
    "spin",
    "joint motion [deg]",
    "most by one joint",
    "[deg]",
    "at full joint speed [s]",
    "least margin to limits [deg]",
    "least margin to singularities [deg]",
)


def resolved(scene: Scene, targets: Targets) -> Targets:
    """The targets with wanted values for every spin that aims and wants to."""
    if not any(_aim(f) is not None for f in targets.freedoms):
        return targets
    freedoms = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None and aim.wanted:
            freedom = dataclasses.replace(
                freedom, prefer=values(scene, targets, freedom, aim), weight=aim.weight
            )
        freedoms.append(freedom)
    return dataclasses.replace(targets, freedoms=tuple(freedoms))


def values(scene: Scene, targets: Targets, freedom: ScrewFreedom, aim: Aim) -> FloatArray:
    """Values (N,) [rad] of a spin at which its ray points to the aim as nearly as a turn can make it."""
    pose = scene.world(targets, {arm: targets.pose[arm] for arm in targets.arms})[aim.arm]
    if aim.at is None:
        place = scene.chains[aim.arm].base[:3, 3]
    else:
        own = scene.world(targets, {arm: np.eye(4) for arm in targets.arms})[aim.arm]
        place = own[:3, :3] @ aim.at + own[:3, 3]
    way = np.einsum("nji,nj->ni", pose[:, :3, :3], place - pose[:, :3, 3])
    axis = freedom.axis[aim.arm][:3] / np.linalg.norm(freedom.axis[aim.arm][:3])
    across = way - (way @ axis)[:, None] * axis
    angle = np.arctan2(np.cross(aim.ray, across) @ axis, across @ aim.ray)
    return np.asarray(np.clip(angle, freedom.lower, freedom.upper))


def exhibit(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> dict[str, Any]:
    """A table for the report, empty where nothing aims: the plan beside the path that aims all along and the
    one that never does."""
    aims = [f for f in targets.freedoms if _aim(f) is not None]
    if not aims:
        return {}
    # first the one whose samples are those of the plan: what the arm reaches there is remembered
    free = _found(scene, targets, _free(targets))
    held = _found(scene, targets, _held(scene, targets))
    rows = [
        ("as planned", *_figures(scene, targets, q)),
        ("toward the base all along, not optimised", *held),
        ("free, not optimised", *free),
    ]
    columns = tuple(c for c in COLUMNS if c != "[deg]")
    return {
        "aim": {
            "kind": "table",
            "title": "What turning the tool toward the base is worth",
            "columns": columns,
            "rows": rows,
        }
    }


def _found(scene: Scene, targets: Targets, freedoms: tuple[Any, ...]) -> tuple[str, ...]:
    """Figures of the path of targets with other freedoms."""
    other = dataclasses.replace(targets, freedoms=freedoms, exhibits={}, claims=())
    _, found = find(scene, other)
    return _figures(scene, other, found.q) if isinstance(found, Found) else ("no path", *[""] * 4)


def _figures(scene: Scene, targets: Targets, q: Mapping[str, FloatArray]) -> tuple[str, ...]:
    moved, most, time, limit, single = 0.0, 0.0, 0.0, np.inf, np.inf
    for arm in targets.arms:
        chain = scene.chains[arm]
        steps = np.abs(np.diff(q[arm], axis=0))
        moved += float(steps.sum())
        most = max(most, float(steps.sum(axis=0).max()))
        time = max(time, float((steps / speed_limits(scene, arm)).max(axis=1).sum()))
        limit = min(limit, float(chain.limit_margin(q[arm]).min()))
        single = min(single, float(chain.singularity_margin(q[arm]).min()))
    shown = [moved / DEG, most / DEG, time, limit / DEG, single / DEG]
    return tuple(f"{value:.{digits}f}" for value, digits in zip(shown, (0, 0, 1, 1, 1), strict=True))


def _held(scene: Scene, targets: Targets) -> tuple[Any, ...]:
    out = []
    for freedom in targets.freedoms:
        aim = _aim(freedom)
        if isinstance(freedom, ScrewFreedom) and aim is not None:
            held = values(scene, targets, freedom, aim)
            freedom = dataclasses.replace(freedom, lower=held, upper=held, prefer=None, aim=None)
        out.append(freedom)
    return tuple(out)


def _free(targets: Targets) -> tuple[Any, ...]:
    return tuple(
        dataclasses.replace(f, prefer=None, aim=None)
        if isinstance(f, ScrewFreedom) and _aim(f) is not None
        else f
        for f in targets.freedoms
    )


def _aim(freedom: object) -> Aim | None:
    return freedom.aim if isinstance(freedom, ScrewFreedom) else None
