"""Springback of a pass: at each control point the curve of displacement over force, and S along the path.

S is how far the sheet moves, at a place and along z, under the force of the tools there; when they let go it
comes back by as much, so the part is S too shallow (a dissertation on double-sided forming, section 4.2: S is
the tool's command less the part after release). What is loaded is the sheet as formed so far, elastic, its
displacements large: loads of several places must not be added, nor scaled.

The curve itself is used, a monotone cubic through S(0) = 0 (F. N. Fritsch, J. Butland, A method for
constructing local monotone piecewise cubic interpolants, SIAM Journal on Scientific and Statistical Computing
5 (1984) 300). S = a F^b is fitted beside it, for people to compare.
"""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from planner.geometry.arrays import FloatArray, IntArray, Mesh
from planner.geometry.units import MM
from planner.processes.forming.plan.contact import Pass
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.sheet_mechanics import axial_force, scallop_height
from planner.processes.forming.plan.springback.control_points import ControlPoints
from planner.processes.forming.plan.springback.formed_sheet import thickness, walls
from planner.shell.element import Sheet
from planner.shell.mesh import SheetMesh, Wall, mesh_walls
from planner.shell.newton import LimitLoadError, Loading, clamped, pressure

LOAD_SHARES: Final = np.array([0.15, 0.35, 0.65, 1.0, 1.4])
"""Loads of a curve over the force that is expected."""
TRIANGLES: Final = 4000
"""Triangles of an elastic sheet at most: within half a percent of five times as many."""
SQUARE: Final = 3.0 * MM
"""Width [m] of the square that a tool presses on."""
MORE: Final = (1.0, 1.5, 2.25)
"""Times as many triangles that are tried, one after the other, where a sheet has no mesh of those allowed."""
NEAR: Final = SQUARE / 3.0
"""Elements there at most [m]: beside a sharp rim or on a narrow ledge it decides, not how many there are."""


@dataclasses.dataclass(frozen=True)
class Point:
    """What is to be solved: pass ``number``, ``place`` (3,) [m] of contact, ``force`` [N] that is expected
    there, ``most`` [N] on the levels around."""

    number: int
    place: FloatArray
    force: float
    most: float = 0.0


@dataclasses.dataclass(frozen=True)
class Curve:
    """Displacement along the tool's way over force: ``force`` (K,) [N], ``springback`` (K,) [m], from 0 and
    growing. ``snaps``: beyond the last force the sheet has no state in balance near by. ``allowed``: as many
    triangles its mesh might have; 0 of one that was read."""

    force: FloatArray
    springback: FloatArray
    snaps: bool
    allowed: int = 0

    def at(self, force: float | FloatArray) -> FloatArray:
        """Springback [m] under ``force`` [N], NaN beyond the last force."""
        if len(self.force) < 2:  # it snaps under the first load already
            return np.where(np.asarray(force) > 0.0, np.nan, 0.0)
        return np.asarray(PchipInterpolator(self.force, self.springback, extrapolate=False)(force))

    def power_law(self) -> tuple[float, float]:
        """a and b of S = a F^b, with S [m] and F [N], by least squares of the logarithms."""
        b, log_a = np.polyfit(np.log(self.force[1:]), np.log(self.springback[1:]), 1)
        return float(np.exp(log_a)), float(b)


@dataclasses.dataclass(frozen=True)
class PassSpringback:
    """Springback of pass ``one``: at its ``control`` points C ``curves``, the ``force`` (C,) [N] that is
    expected and the ``springback`` (C,) [m] under it."""

    one: Pass
    control: ControlPoints
    curves: tuple[Curve, ...]
    force: FloatArray
    springback: FloatArray

    def at(self, points: FloatArray, force: FloatArray) -> FloatArray:
        """Springback (N,) [m] at places (N, 3) [m] of the contact's path under the forces (N,) [N] there:
        that of the nearest places in plan of the rings above and below, linear in z between them."""
        height = np.array([float(ring.point[:, 2].mean()) for ring in self.control.rings])
        each = np.stack(
            [
                self._under(level, np.asarray(cKDTree(ring.point[:, :2]).query(points[:, :2])[1]), force)
                for level, ring in enumerate(self.control.rings)
            ]
        )
        order = np.argsort(height)
        height, each = height[order], each[order]
        above = np.clip(np.searchsorted(height, points[:, 2]), 1, max(len(height) - 1, 1))
        below = above - 1
        above = np.minimum(above, len(height) - 1)
        rise = height[above] - height[below]
        rise = np.where(rise > 0.0, rise, 1.0)  # of a file two levels may be nearest to one loop
        share = np.clip((points[:, 2] - height[below]) / rise, 0.0, 1.0)
        rows = np.arange(len(points))
        return _between(each[below, rows], each[above, rows], share)

    def _under(self, level: int, at: IntArray, force: FloatArray) -> FloatArray:
        """Springback (N,) [m] at places (N,) of a level's ring under forces (N,) [N]: linear from one control
        point to the next, along the ring. Of a curve no more force than its last one is asked, but where
        the sheet snaps beyond that: NaN."""
        mine = np.flatnonzero(self.control.level == level)
        mine = mine[np.argsort(self.control.place[mine])]
        knots, count = self.control.place[mine], len(self.control.rings[level].point)
        before = (np.searchsorted(knots, at, side="right") - 1) % len(mine)
        after = (before + 1) % len(mine)
        gap = (knots[after] - knots[before] - 1) % count + 1
        share = ((at - knots[before]) % count) / gap
        ends = np.zeros((2, len(at)))
        for k, row in enumerate(mine):
            curve = self.curves[row]
            most = np.inf if curve.snaps else curve.force[-1]
            for end, value in zip((before, after), ends, strict=True):
                some = end == k
                value[some] = curve.at(np.minimum(force[some], most))
        return _between(ends[0], ends[1], share)


def _between(first: FloatArray, second: FloatArray, share: FloatArray) -> FloatArray:
    """From ``first`` to ``second`` (N,) by a ``share`` (N,); at an end whatever the other one is, NaN too."""
    mixed = (1.0 - share) * first + share * second
    return np.asarray(np.where(share <= 0.0, first, np.where(share >= 1.0, second, mixed)))


def forces(work: Work, one: Pass, points: FloatArray, angle: FloatArray) -> FloatArray:
    """Forces (N,) [N] along z on the sheet at places (N, 3) [m] of a pass, on walls at ``angle`` (N,) [rad]:
    as the user states them, else by the formula of `axial_force`, which knows of no second tool."""
    if work.stated is not None:
        return work.stated.at(one.name, points)
    op, radius = work.operation, work.heads[work.former(one)].radius
    if op.stepdown_mm is None:
        ridge = np.full(len(angle), (op.scallop_mm or 0.0) * MM)
    else:
        ridge = scallop_height(radius, op.stepdown_mm * MM, np.maximum(angle, 1e-3))
    return axial_force(work.sheet.metal.tensile_stress, work.thickness, 2.0 * radius, ridge, angle)


def solved(work: Work, point: Point, triangles: int = TRIANGLES, shares: FloatArray = LOAD_SHARES) -> Curve:
    """The curve at a point of a pass, on the sheet as formed when the tool is there, at ``shares`` (K,) of
    the expected force; where more is expected around, at this force and at shares of that one up to it. Of
    more ``triangles`` where the sheet has no mesh of so few: `MORE`.

    Raises ``ValueError`` where the sheet as formed cannot be divided into so many triangles either.
    """
    one = work.passes[point.number]
    formed = walls(work, point.number, float(point.place[2]))
    made, allowed = _meshed(formed, work.sheet.opening, triangles, point.place)
    mesh = Mesh(made.nodes, made.triangles)
    metal = work.sheet.metal
    sheet = Sheet(made.nodes, made.triangles, thickness(work, point.number, mesh), metal.young, metal.poisson)
    loads = point.force * shares
    if point.most > loads[-1]:
        loads = np.unique(np.append(point.most * shares[shares <= 1.0], point.force))
    way = np.array([0.0, 0.0, -float(one.side)])
    try:
        held = Loading(sheet, clamped(sheet, _border(work)))
        moved, snaps = held.curve(pressure(sheet, point.place, SQUARE), loads[:, None] * way), False
    except LimitLoadError as error:
        moved, snaps = error.displacements, True
    count = len(moved)
    return Curve(np.append(0.0, loads[:count]), np.append(0.0, moved @ way), snaps, allowed)


def _meshed(
    formed: Sequence[Wall], opening: FloatArray, triangles: int, place: FloatArray
) -> tuple[SheetMesh, int]:
    """A mesh of a sheet with a node at a place (3,) [m], and how many triangles it was allowed."""
    *first, last = (int(share * triangles) for share in MORE)
    for allowed in first:
        with contextlib.suppress(ValueError):  # the last one tells why
            return mesh_walls(formed, opening, allowed, place[None], NEAR), allowed
    return mesh_walls(formed, opening, last, place[None], NEAR), last


def _border(work: Work) -> str | float:
    stiff = work.sheet.border
    return "sliding" if stiff == 0.0 else "immovable" if np.isinf(stiff) else stiff
