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
from planner.forming.clearing import FarFace, clear_tilt, radius_issue
from planner.forming.contact import Face
from planner.forming.inserting import insert, shares
from planner.forming.operation import Forming
from planner.forming.steady import steady_below, steady_normals
from planner.forming.thickness import by_corner
from planner.forming.tilt import axes, below_flat, leaned, nozzle_below_flat
from planner.forming.values import ContactPath, FloatArray, Pass, ToolPath
from planner.geometry.mesh import TriangleMesh
from planner.issues import Issue, TandemError
from planner.problem import FormingHead
from planner.units import DEG, MM

_MIRROR: Final = np.array([1.0, 1.0, -1.0])
LIFT: Final = 5e-3
"""How far [m] the support draws back from the sheet where the forming tool goes over in the air."""
AIR: Final = 3e-3
"""Distance [m] of the forming ball from the face beyond which it is in the air."""
CREASED: Final = 0.15
"""Thicknesses on both sides of a crease differ by more than this share of the flat sheet's."""
SHARE: Final = 0.4
"""Part of the gap's tolerance that straight moves between targets may take."""
_ROUNDS: Final = 5


def tool_path(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
) -> ToolPath:
    """Both tools along ``contact``, for all modes but adsif (`adsif_path.adsif_tool_path`).

    ``thickness`` [m] of the flat sheet. The result's contact has more targets where straight moves would let
    the gap, or the support's way along the border, off by too much. Raises ``TandemError``
    (forming.support_tool) where the mode has no such support.
    """
    _require(operation, former, support)
    mode = operation.mode
    if one.side < 0:
        found = tool_path(_mirrored(one), _turned_over(contact), operation, former, support, thickness)
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
        return _heat(one, contact, operation, former, support, thickness)
    return _opposite(one, contact, operation, former, support, thickness)


def support_issues(
    one: Pass,
    path: ToolPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead | None,
    thickness: float,
) -> tuple[Issue, ...]:
    """Warnings (forming.support_radius) of a path of two tools opposite each other: where the support is too
    large to be opposite, and so is turned aside."""
    if path.support is None or support is None or operation.mode not in ("dsif", "dpif_l"):
        return ()
    contact, across = path.contact, path.former - path.support
    if one.side < 0:
        one, contact, across = _mirrored(one), _turned_over(contact), across * _MIRROR
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    tilt = np.arccos(np.clip(across[:, 2] / np.linalg.norm(across, axis=1), -1.0, 1.0))
    off = np.where(np.isnan(path.gap), 0.0, np.maximum(contact.angle - shift, 0.0) - tilt)
    radii = np.array([former.radius, support.radius])
    gap = np.nan_to_num(path.gap)
    issue = radius_issue(one, FarFace(one, thickness, contact, former.radius), contact, off, gap, radii)
    return () if issue is None else (issue,)


def wanted_gap(one: Pass, contact: ContactPath, squeeze: float, thickness: float) -> FloatArray:
    """Gap (N,) [m] at the targets: ``squeeze`` times the sheet's thickness along the smooth face's normal
    nearest to the ball, which does not hop from facet to facet as the contact's own normal does."""
    thick = by_corner(one, thickness)[2].reshape(-1, 3)
    whole = Face(TriangleMesh(one.vertices, one.faces), 5e-3)
    near, own = (
        np.einsum("nk,nk->n", weights, thick[face])
        for _, face, weights in (whole.nearest(contact.centre), whole.nearest(contact.point))
    )
    # in a crease the ball touches two walls at once, and the thinner one counts
    crease = np.abs(near - own) > CREASED * thickness
    return np.asarray(squeeze * np.where(crease, np.minimum(near, own), near))


def _opposite(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    support: FormingHead,
    thickness: float,
) -> ToolPath:
    level, far = one.start - thickness, FarFace(one, thickness, contact, former.radius)
    shift = operation.shift_deg * DEG if operation.mode == "dpif_l" else 0.0
    radii = former.radius + support.radius
    for left in range(_ROUNDS, -1, -1):
        gap = wanted_gap(one, contact, operation.squeeze, thickness)
        apart = gap + radii
        # the face's own normals hop from facet to facet, and the support far from it would hop along
        normal = steady_normals(contact.normal, contact.centre)
        steep = np.arccos(np.clip(normal[:, 2], -1.0, 1.0))
        tilt = np.maximum(steep - shift, 0.0)
        tilt = np.minimum(tilt, below_flat(contact.centre[:, 2], apart, level, support.radius))
        squeezed = np.maximum(thickness * np.cos(contact.angle) - gap, 0.0)
        inner = support.radius - squeezed - operation.gouge_tol_mm * MM
        opposite = dataclasses.replace(contact, normal=normal)
        tilt = steady_below(clear_tilt(far, opposite, tilt, apart, inner), contact.centre)
        line = leaned(normal, tilt)
        place = contact.centre - apart[:, None] * line
        air = np.linalg.norm(contact.centre - contact.point, axis=1) > former.radius + AIR
        row, share = _refinement(contact.centre - place, air, SHARE * operation.gap_tol_mm * MM)
        if not len(row) or left == 0:
            break
        contact = insert(contact, former.radius, 1, row, share)
    _draw_back(place, air, one, thickness, support.radius)
    lean = _lean(operation)
    return ToolPath(
        former=contact.centre,
        axis=axes(contact.normal, lean),
        support=place,
        support_axis=leaned(normal, np.minimum(tilt, lean)),
        gap=np.where(air, np.nan, gap),
        contact=contact,
    )


def _refinement(
    across: FloatArray, air: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], tolerance: float
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.int64]], FloatArray]:
    """Which moves need targets between, so that the distance of the centres ``across`` (N, 3), which go
    straight, is off by ``tolerance`` [m] at most: the chord of an arc is short by its sagitta."""
    length = np.linalg.norm(across, axis=1)
    middle = 0.5 * (length[1:] + length[:-1]) - np.linalg.norm(0.5 * (across[1:] + across[:-1]), axis=1)
    cosine = np.einsum("nd,nd->n", across[1:], across[:-1]) / (length[1:] * length[:-1])
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    finest = 2.0 * np.arccos(1.0 - tolerance / length[1:])
    need = np.where((middle > tolerance) & ~(air[1:] | air[:-1]), np.ceil(angle / finest), 1.0)
    return shares(np.concatenate([[1], need]).astype(np.int64))


def _draw_back(
    place: FloatArray,
    air: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    one: Pass,
    thickness: float,
    radius: float,
) -> None:
    """Where the forming tool goes over in the air the support leaves the sheet straight down, and comes back
    straight up."""
    if not air.any() or air.all():
        return
    low = float(one.vertices[:, 2].min()) - thickness - radius - LIFT
    rows = np.flatnonzero(air)
    touching = np.flatnonzero(~air)
    after = np.searchsorted(touching, rows)
    first = np.concatenate([[True], np.diff(rows) > 1])
    source = np.where(
        (first & (after > 0)) | (after == len(touching)),
        touching[np.maximum(after - 1, 0)],
        touching[np.minimum(after, len(touching) - 1)],
    )
    place[rows] = np.column_stack([place[source, :2], np.full(len(rows), low)])


def _heat(
    one: Pass,
    contact: ContactPath,
    operation: Forming,
    former: FormingHead,
    nozzle: FormingHead,
    thickness: float,
) -> ToolPath:
    through = former.radius + thickness * np.cos(contact.angle)
    place = contact.centre - through[:, None] * contact.normal
    most = nozzle_below_flat(place[:, 2], one.start - thickness, nozzle.standoff, nozzle.radius)
    return ToolPath(
        former=contact.centre,
        axis=axes(contact.normal, _lean(operation)),
        support=place,
        support_axis=leaned(contact.normal, np.minimum(contact.angle, most)),
        gap=np.full(len(place), np.nan),
        contact=contact,
    )


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
