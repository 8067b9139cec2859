"""Curves that are to be cut, read once more and laid on the sheet's face, and their order.

The face is that of the part's own mesh file. Curves are laid on it along z; beyond the mesh the sheet
is flat. What a curve encloses, seen along z, is told by its winding number about a place.
"""

import dataclasses
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planner.claims.claim import Claim
from planner.claims.dialogue import DialogueStep, DialogueStop, OperatorDialogue
from planner.claims.drawn_curve import DrawnCurve
from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray
from planner.issues import Issue
from planner.processes.trim.claims import TrimOutline, TrimsSheet, slot_names
from planner.processes.trim.proof.rough_face import levelled, noise_turn
from planner.proof.part_files import UnreadError
from planner.proof.part_files.drawn_curves import NotThereError, curves_of, points
from planner.proof.part_files.plan_face import Laid
from planner.proof.part_files.sheets import sheet_face, tolerance_of

TRIM = "trim"
"""The kind of segments in which a torch cuts."""
SPACING = 0.2e-3
"""Distance [m] of the places of a curve."""
CIRCLE_PLACES = 1440
"""Corners of a circle, of which the chords of 1 m are off by 2.4 micrometres."""
PLACES_AT_ONCE = 500
"""Places that are held against a curve at once."""
FOOT_ROUNDS = 3
"""Times that the foot of a place on the face is looked for anew, from where it was found."""
MILLIMETRE = 1e-3
"""One millimetre in metres."""


def drawn(one: TrimOutline) -> FloatArray:
    """The curve in plan (K, 2) [m], counter-clockwise, its first place not repeated. Raises `UnreadError`."""
    if one.drawn is None:
        turn = 2.0 * np.pi * np.arange(CIRCLE_PLACES) / CIRCLE_PLACES
        radius = 0.5 * one.diameter * MILLIMETRE
        centre = np.array(one.middle) * MILLIMETRE
        return np.asarray(centre + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    try:
        flat = points(one.drawn)[0][:, :2]
    except NotThereError as error:
        raise UnreadError(str(error)) from error
    flat = flat[np.append(True, np.linalg.norm(np.diff(flat, axis=0), axis=1) > 1e-9)]
    if len(flat) > 1 and np.linalg.norm(flat[0] - flat[-1]) < 1e-9:
        flat = flat[:-1]
    if len(flat) < 3:
        raise UnreadError(f"{one.name} has {len(flat)} places that differ")
    after = np.roll(flat, -1, axis=0)
    turns = float((flat[:, 0] * after[:, 1] - flat[:, 1] * after[:, 0]).sum())
    return np.asarray(flat if turns > 0.0 else flat[::-1])


def expanded(claim: TrimsSheet) -> TrimsSheet:
    """The claim with each curve of its drawings as an outline of its own, by the proof's reading of the file:
    layer by layer, in the file's order, with numbers. Raises `UnreadError`, also where one is open."""
    out: list[TrimOutline] = []
    for one in claim.outlines:
        if one.drawn is None or not one.drawn.layers:
            out.append(one)
            continue
        number = 0
        for curve in curves_of(one.drawn):
            number += 1
            if not curve.closed:
                raise UnreadError(f"curve {number} of {one.name} is open")
            mm = tuple(map(tuple, (curve.points / MILLIMETRE).tolist()))
            own = DrawnCurve("polyline", mm)
            out.append(dataclasses.replace(one, name=f"{one.name}_{number}", drawn=own))
        if not number:
            raise UnreadError(f"{one.name} has no curves")
    return dataclasses.replace(claim, outlines=tuple(out))


def winding(ring: FloatArray, places: FloatArray) -> BoolArray:
    """(N,) whether places (N, 2) are enclosed by a closed curve (K, 2): those from which a ray along x
    crosses it up and down a different number of times."""
    after = np.roll(ring, -1, axis=0)
    out = np.zeros(len(places), dtype=np.int64)
    for first in range(0, len(places), PLACES_AT_ONCE):
        some = places[first : first + PLACES_AT_ONCE]
        up = (ring[:, 1] <= some[:, 1:]).astype(np.int8) - (after[:, 1] <= some[:, 1:]).astype(np.int8)
        row, edge = np.nonzero(up)
        a, b = ring[edge], after[edge]
        share = (some[row, 1] - a[:, 1]) / (b[:, 1] - a[:, 1])
        right = a[:, 0] + share * (b[:, 0] - a[:, 0]) > some[row, 0]
        out[first : first + PLACES_AT_ONCE] = np.bincount(
            row[right], weights=up[row[right], edge[right]], minlength=len(some)
        ).astype(np.int64)
    return np.asarray(out != 0)


def order(claim: TrimsSheet) -> list[int]:
    """The outlines in the order of cutting: those that lie in most others first, else as they are stated.
    Raises `UnreadError`."""
    rings = [drawn(one) for one in claim.outlines]
    deep = [sum(bool(winding(other, own[:1])[0]) for other in rings if other is not own) for own in rings]
    return sorted(range(len(rings)), key=lambda k: -deep[k])


def dialogue(claim: OperatorDialogue, trims: TrimsSheet) -> OperatorDialogue:
    """The dialogue with what is switched and waited for at each slot of a torch. Raises `UnreadError`."""
    if trims.torch is None:
        return claim
    begin = [DialogueStep("on", signal=trims.signal)]
    if trims.ok_signal is not None:
        begin.append(DialogueStep("input", signal=trims.ok_signal, seconds=trims.timeout))
    if trims.pierce_seconds > 0.0:
        begin.append(DialogueStep("wait", seconds=trims.pierce_seconds))
    stops: list[DialogueStop] = []
    for k in order(trims):
        for name in slot_names(trims, trims.outlines[k]):
            own = Segment(TRIM, name)
            stops.append(DialogueStop(own, "before", tuple(begin)))
            stops.append(DialogueStop(own, "behind", (DialogueStep("off", signal=trims.signal),)))
    return dataclasses.replace(claim, stops=tuple(stops))


def worked_out(
    claims: Mapping[str, tuple[Claim, ...]],
) -> tuple[dict[str, tuple[Claim, ...]], tuple[Issue, ...]]:
    """The claims by operation, each curve of a drawing as an outline of its own, and dialogues of trimmed
    sheets with what is switched at each slot; and what could not be read."""
    issues: list[Issue] = []
    out: dict[str, tuple[Claim, ...]] = {}
    for name, group in claims.items():
        whole: list[Claim] = []
        for claim in group:
            try:
                whole.append(expanded(claim) if isinstance(claim, TrimsSheet) else claim)
            except UnreadError as error:
                whole.append(claim)
                what = f"{name}: drawings cannot be read a second time: {error}"
                issues.append(Issue("verify.trim_cut", what, field="operations.outlines"))
        trims = [claim for claim in whole if isinstance(claim, TrimsSheet)]
        own: list[Claim] = []
        for claim in whole:
            if isinstance(claim, OperatorDialogue) and trims:
                try:
                    claim = dialogue(claim, trims[0])
                except UnreadError as error:
                    what = f"{name}: curves cannot be read a second time: {error}"
                    issues.append(Issue("verify.trim_cut", what, field="operations.outlines"))
            own.append(claim)
        out[name] = tuple(own)
    return out, tuple(issues)


@dataclasses.dataclass(frozen=True)
class Feet:
    """Places seen from the face: ``foot``, ``normal`` (N, 3) away from the sheet on the torch's side, and
    ``height`` (N,) [m] over it."""

    foot: FloatArray
    normal: FloatArray
    height: FloatArray


class SheetSide:
    """The side of the formed sheet on which the torch is. Where it is to be as in the part, it is less so by
    what is ``flat`` still: how far (N,) [m] later operations move it at places in plan (N, 2). ``turn`` [rad]
    is what noise of the mesh may turn its normals by."""

    def __init__(
        self,
        claim: TrimsSheet,
        part: Mapping[str, Any] | None,
        flat: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        own = claim.surface
        if own is not None:
            said: dict[str, Any] = {"file": str(own.file), "unit": own.unit, "face": own.face}
            said |= {"frame": own.frame, "down": own.down, "tolerance_mm": own.tolerance_mm}
            place = "auto" if own.frame == "find" else {"xyz_mm": (0.0, 0.0, 0.0)}
            part = {"sheet_mesh": said, "in_stock": place}
        if part is None or not part.get("sheet_mesh"):
            raise UnreadError("the problem has no sheet_mesh to be trimmed")
        found = sheet_face(part, claim.rough)
        self.side, self.rise = claim.side, claim.thickness if claim.side > 0 else 0.0
        self.tolerance = found.tolerance
        corners = found.face.corners + np.array([0.0, 0.0, self.rise])
        vertices, index = np.unique(np.round(corners.reshape(-1, 3), 10), axis=0, return_inverse=True)
        self.faces = np.asarray(index).reshape(-1, 3)
        noise = tolerance_of(vertices, self.faces)
        vertices, self.turn = levelled(vertices, self.faces) if noise else vertices, noise_turn(noise)
        if own is None and flat is not None:
            vertices[:, 2] -= flat(vertices[:, :2])
        self.vertices = vertices
        self._laid = Laid(self.vertices, self.faces)

    def at(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (N, 3) over ``xy`` (N, 2) and normals (N, 3) that look up."""
        found = self._laid.at(xy)
        on = np.isfinite(found.point[:, 2:])
        flat = np.column_stack([xy, np.full(len(xy), self.rise)])
        return np.where(on, found.point, flat), np.where(on, found.normal, np.array([0.0, 0.0, 1.0]))

    def feet(self, places: FloatArray) -> Feet:
        """Where places (N, 3) near to the face are over it."""
        point, normal = self.at(places[:, :2])
        for _ in range(FOOT_ROUNDS):
            foot = places - ((places - point) * normal).sum(axis=1, keepdims=True) * normal
            point, normal = self.at(foot[:, :2])
        height = ((places - point) * normal).sum(axis=1)
        return Feet(point, self.side * normal, self.side * height)


class Curve:
    """An outline laid on the face: ``ring`` (K, 3) [m], ``SPACING`` apart at most in plan, ``along`` (K,) [m]
    its way; ``flat`` (J, 2) its own places in plan."""

    def __init__(self, one: TrimOutline, sheet: SheetSide) -> None:
        self.one, self.flat = one, drawn(one)
        shut = np.concatenate([self.flat, self.flat[:1]])
        way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(shut, axis=0), axis=1)))
        count = int(np.ceil(way[-1] / SPACING)) + 1
        at = np.unique(np.concatenate([np.linspace(0.0, way[-1], count)[:-1], way[:-1]]))
        xy = np.stack([np.interp(at, way, shut[:, k]) for k in range(2)], axis=1)
        self.ring, _ = sheet.at(xy)
        step = np.linalg.norm(np.diff(np.concatenate([self.ring, self.ring[:1]]), axis=0), axis=1)
        self.along, self.length = np.append(0.0, np.cumsum(step[:-1])), float(step.sum())

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.ring)

    def off(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances (N,) [m] of places (N, 3) from the curve, and where (N,) [m] along it they are
        nearest."""
        near = np.asarray(self._tree.query(places)[1])
        best, where = np.full(len(places), np.inf), np.zeros(len(places))
        for first in ((near - 1) % len(self.ring), near):
            start = self.ring[first]
            way = self.ring[(first + 1) % len(self.ring)] - start
            size = np.maximum((way * way).sum(axis=1), 1e-24)
            share = np.clip(((places - start) * way).sum(axis=1) / size, 0.0, 1.0)
            found = np.linalg.norm(places - start - share[:, None] * way, axis=1)
            closer = found < best
            best[closer] = found[closer]
            where[closer] = (self.along[first] + share * np.sqrt(size))[closer] % self.length
        return best, where

    def place(self, along: float) -> FloatArray:
        """The place (3,) of its ring next behind some way along it [m]."""
        k = int(np.searchsorted(self.along, along % self.length)) % len(self.ring)
        return np.asarray(self.ring[k])

    def on(self, along: FloatArray) -> FloatArray:
        """Places (N, 3) ``along`` (N,) [m] its ring."""
        ring = np.concatenate([self.ring, self.ring[:1]])
        way = np.append(self.along, self.length)
        return np.stack([np.interp(along % self.length, way, ring[:, k]) for k in range(3)], axis=1)

    def in_waste(self, places: FloatArray) -> BoolArray:
        """(N,) whether places (N, 3) are, seen along z, in what this outline lets drop."""
        return np.asarray(winding(self.flat, places[:, :2]) == self.one.inside)
