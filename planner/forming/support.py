"""Where both tools are along the path of the contact, for each mode of forming.

Opposite each other (``dsif``, ``dpif_l``), with the wall angle a, the forming ball of radius R1 and the
other of R2: the gap is g = squeeze t0 cos(a), and the centres are R1 + g + R2 apart. The line between them
is the face's normal in dsif; in dpif_l it is turned from there toward the vertical by the shift angle, at
most by a.

Near the flat around a feature there is no room for a ball opposite a steep wall: it would cut into the flat.
There the line is turned toward the vertical as far as it must, at the same distance, so that the support
rolls around the forming ball as that sinks into the sheet. For a ball of R2 this ends at a depth of about R2
(1 - cos a).
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.forming.border import border_path
from planner.forming.clamp import Clamp
from planner.forming.clearing import radius_issue
from planner.forming.heated import heated
from planner.forming.operation import Forming
from planner.forming.opposite import SHARE, opposite_path
from planner.forming.tilt import axes
from planner.forming.values import ContactPath, Pass, ToolPath
from planner.issues import Issue, Severity, TandemError
from planner.tooling import FormingHead
from planner.units import DEG, MM

_MIRROR: Final = np.array([1.0, 1.0, -1.0])


def tool_path(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
    clamp: Clamp | None = None,
    every: int = 0,
) -> ToolPath:
    """Both tools along ``contact``, for all modes but adsif (`adsif_path.adsif_tool_path`).

    ``thickness`` [m] of the flat sheet; ``clamp``: what a source of heat leans away from;
    ``every``: moves between meetings of two controllers, 0 for one clock. The result's
    contact has more targets where straight moves would let the gap, or the support's way along the border,
    off by too much. Raises ``TandemError`` (forming.support_tool) where the mode has no such support.
    """
    _require(operation, former, support)
    mode = operation.mode
    if one.side < 0:
        over = None if clamp is None else dataclasses.replace(clamp, low=-clamp.high, high=-clamp.low)
        found = tool_path(
            _mirrored(one), _turned_over(contact), operation, former, support, thickness, over, every
        )
        return _back(found)
    if support is None or mode in ("spif", "tpif"):
        none = np.full(len(contact.point), np.nan)
        return ToolPath(contact.centre, axes(contact.normal, _lean(operation)), None, None, none, contact)
    if mode == "dpif_p":
        path, place = border_path(one, contact, former.radius, support, thickness)
        up = np.tile([0.0, 0.0, 1.0], (len(place), 1))
        none = np.full(len(place), np.nan)
        return ToolPath(path.centre, axes(path.normal, _lean(operation)), place, up, none, path)
    if mode == "heat":
        path, place, behind = heated(
            one, contact, former, support, thickness, clamp, operation.gouge_tol_mm * MM
        )
        none = np.full(len(place), np.nan)
        return ToolPath(path.centre, axes(path.normal, _lean(operation)), place, behind, none, path)
    return opposite_path(one, contact, operation, former, support, thickness, every)


def support_issues(
    one: Pass,
    path: ToolPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
) -> tuple[Issue, ...]:
    """Warnings of a path of two tools opposite each other: where the support is too large to be opposite, and
    so is turned aside (forming.support_radius), and where straight moves do not keep the gap as they should
    (forming.gap)."""
    if path.support is None or support is None or operation.mode not in ("dsif", "dpif_l"):
        return ()
    contact, across = path.contact, path.former - path.support
    if one.side < 0:
        one, contact, across = _mirrored(one), _turned_over(contact), across * _MIRROR
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    tilt = np.arccos(np.clip(across[:, 2] / np.linalg.norm(across, axis=1), -1.0, 1.0))
    wanted = np.maximum(contact.angle - shift, 0.0)
    off = np.where(np.isnan(path.gap), 0.0, wanted - tilt)
    radii, slack = np.array([former.radius, support.radius]), operation.gouge_tol_mm * MM
    gap = np.nan_to_num(path.gap)
    issue = radius_issue(one, thickness, contact, wanted, off, gap, radii, slack)
    loose = _loose_issue(one, path, operation)
    return tuple(found for found in (issue, loose) if found is not None)


def _loose_issue(one: Pass, path: ToolPath, operation: Forming) -> Issue | None:
    if path.loose is None or path.support is None or not path.loose.any():
        return None
    rows = np.flatnonzero(path.loose)
    first = ", ".join(f"{value:.1f}" for value in path.former[rows[0]] / MM)
    across = path.former - path.support
    length = np.linalg.norm(across, axis=1)
    middle = np.linalg.norm(0.5 * (across[rows] + across[rows - 1]), axis=1)
    off = float((0.5 * (length[rows] + length[rows - 1]) - middle).max()) / MM
    what = f"pass {one.name}: on {len(rows)} moves between targets, first at ({first}) mm, "
    if off > SHARE * operation.gap_tol_mm:
        what += (
            f"the gap of the tools is off by up to {off:.3f} mm, {SHARE:.0%} of gap_tol_mm are planned for"
        )
        hint = f"allow a gap_tol_mm of {off / SHARE + 5e-4:.3f}, or round the part there"
    else:
        what += "the wall turns at once, and the line of the tools does not follow within its tolerance"
        hint = "round the part there"
    what += ", however near the targets are; the proof decides whether it holds"
    return Issue("forming.gap", what, Severity.WARNING, value=float(len(rows)), limit=0.0, hint=hint)


def _lean(operation: Forming) -> float:
    return operation.lean_deg * DEG


def _mirrored(one: Pass) -> Pass:
    """A pass mirrored in z; its faces run the same way round in plan, so their normals are up again."""
    return dataclasses.replace(
        one,
        side=-one.side,
        vertices=one.vertices * _MIRROR,
        start=-one.start,
        end=-one.end,
    )


def _turned_over(contact: ContactPath) -> ContactPath:
    """A path mirrored in z with its normals still up."""
    return dataclasses.replace(
        contact,
        point=contact.point * _MIRROR,
        centre=contact.centre * _MIRROR,
        normal=contact.normal * -_MIRROR,
    )


def _back(found: ToolPath) -> ToolPath:
    return dataclasses.replace(
        found,
        former=found.former * _MIRROR,
        axis=found.axis * _MIRROR,
        support=None if found.support is None else found.support * _MIRROR,
        support_axis=None if found.support_axis is None else found.support_axis * _MIRROR,
        contact=_turned_over(found.contact),
    )


def _require(operation: Forming, former: FormingHead, support: FormingHead | None) -> None:
    mode = operation.mode
    wanted = {"dsif": "ball", "dpif_l": "ball", "adsif": "ball", "dpif_p": "ball or disk", "heat": "heat"}
    issues: list[tuple[str, str, str]] = []
    if former.kind != "ball":
        issues.append(("forming", former.kind, "ball"))
    if mode in wanted and (support is None or support.kind not in wanted[mode]):
        issues.append(("supporting", "none" if support is None else support.kind, wanted[mode]))
    if issues:
        raise TandemError(
            [
                Issue(
                    "forming.support_tool",
                    f"mode {mode}: the {role} tool is {got}, allowed is {allowed}; mount another tool, or "
                    "take another mode",
                    field="mode",
                )
                for role, got, allowed in issues
            ]
        )
