"""Springback of a pass: at each control point the curve of displacement over force, and S along the path.

S is the displacement of the sheet, at a point and along z, under the force of the tools there. The sheet
springs back by as much when they release it, so the part is S too shallow (a dissertation on double-sided
forming, section 4.2: S is the tool's command minus the part after release). The load acts on the sheet as
formed so far, which is elastic with large displacements: loads of several points must not be added, nor
scaled.

The curve itself is used, a monotone cubic through S(0) = 0 (F. N. Fritsch, J. Butland, A method for
constructing local monotone piecewise cubic interpolants, SIAM Journal on Scientific and Statistical Computing
5 (1984) 300). S = a F^b is fitted as well, for comparison by people.
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
from planner.processes.forming.plan.contact import FormingPass
from planner.processes.forming.plan.process_plan import FormingWork
from planner.processes.forming.plan.sheet_mechanics import axial_force, scallop_height
from planner.processes.forming.plan.springback.control_points import ControlPoints
from planner.processes.forming.plan.springback.formed_sheet import sheet_thickness, sheet_walls
from planner.shell.element import ShellSheet
from planner.shell.mesh import ShellMesh, Wall, mesh_walls
from planner.shell.newton import LimitLoadError, Loading, clamped, pressure_weights

LOAD_FACTORS: Final = np.array([0.15, 0.35, 0.65, 1.0, 1.4])
"""Loads of a curve as multiples of the expected force."""
MAX_TRIANGLES: Final = 4000
"""Maximum number of triangles of an elastic sheet: the result is within half a percent of that with five
times as many.
"""
PRESSED_WIDTH_M: Final = 3.0 * MM
"""Width [m] of the square on which a tool presses."""
TRIANGLE_FACTORS: Final = (1.0, 1.5, 2.25)
"""Factors on the number of triangles that are tried in turn if a sheet has no mesh with the allowed
number.
"""
MAX_LOCAL_ELEMENT_M: Final = PRESSED_WIDTH_M / 3.0
"""Maximum size [m] of elements at the pressed point: next to a sharp rim or on a narrow ledge it is decisive,
not the number of elements.
"""


@dataclasses.dataclass(frozen=True)
class SpringbackPoint:
    """A point at which springback is to be solved.

    Attributes:
        number: Number of the pass.
        contact: Contact point (3,) [m].
        force: Expected force [N].
        max_force: Largest force [N] on the adjacent levels.
    """

    number: int
    contact: FloatArray
    force: float
    max_force: float = 0.0


@dataclasses.dataclass(frozen=True)
class SpringbackCurve:
    """Displacement in the direction of the tool as a function of force.

    Attributes:
        force: Forces (K,) [N], from 0.
        springback: Displacements (K,) [m], from 0 and increasing.
        snaps: Whether the sheet has no nearby equilibrium beyond the last force.
        allowed: Maximum number of triangles of its mesh; 0 for a curve that was read.
    """

    force: FloatArray
    springback: FloatArray
    snaps: bool
    allowed: int = 0

    def at(self, force: float | FloatArray) -> FloatArray:
        """Return the springback [m] under forces [N], in the shape of ``force``; NaN beyond the last one."""
        if len(self.force) < 2:  # it snaps under the first load
            return np.where(np.asarray(force) > 0.0, np.nan, 0.0)
        return np.asarray(PchipInterpolator(self.force, self.springback, extrapolate=False)(force))

    def power_law(self) -> tuple[float, float]:
        """Return a and b of S = a F^b, with S [m] and F [N], by least squares of the logarithms."""
        b, log_a = np.polyfit(np.log(self.force[1:]), np.log(self.springback[1:]), 1)
        return float(np.exp(log_a)), float(b)


@dataclasses.dataclass(frozen=True)
class PassSpringback:
    """Springback of a pass at C control points.

    Attributes:
        forming_pass: Pass.
        control: Control points.
        curves: C curves.
        force: Expected forces (C,) [N].
        springback: Springback (C,) [m] under these forces, NaN where the sheet snaps.
    """

    forming_pass: FormingPass
    control: ControlPoints
    curves: tuple[SpringbackCurve, ...]
    force: FloatArray
    springback: FloatArray

    def at(self, points: FloatArray, force: FloatArray) -> FloatArray:
        """Return the springback (N,) [m] at points of the contact's path.

        It is that of the nearest points in plan of the rings above and below, linear in z between them.

        Args:
            points: Points (N, 3) [m].
            force: Forces (N,) [N] there.
        """
        height = np.array([float(ring.point[:, 2].mean()) for ring in self.control.rings])
        ring_springback = np.stack(
            [
                self._on_ring(level, np.asarray(cKDTree(ring.point[:, :2]).query(points[:, :2])[1]), force)
                for level, ring in enumerate(self.control.rings)
            ]
        )
        order = np.argsort(height)
        height, ring_springback = height[order], ring_springback[order]
        upper = np.clip(np.searchsorted(height, points[:, 2]), 1, max(len(height) - 1, 1))
        lower = upper - 1
        upper = np.minimum(upper, len(height) - 1)
        rise = height[upper] - height[lower]
        rise = np.where(rise > 0.0, rise, 1.0)  # two levels of a file may be nearest to one loop
        fraction = np.clip((points[:, 2] - height[lower]) / rise, 0.0, 1.0)
        indices = np.arange(len(points))
        return _interpolate(ring_springback[lower, indices], ring_springback[upper, indices], fraction)

    def _on_ring(self, level: int, ring_index: IntArray, force: FloatArray) -> FloatArray:
        """Return the springback (N,) [m] at indices (N,) of a level's ring under forces (N,) [N].

        It is linear from one control point to the next, along the ring. Forces are limited to the last one of
        each curve; where the sheet snaps beyond that, the result is NaN.
        """
        on_level = np.flatnonzero(self.control.level == level)
        on_level = on_level[np.argsort(self.control.ring_index[on_level])]
        knots, count = self.control.ring_index[on_level], len(self.control.rings[level].point)
        previous = (np.searchsorted(knots, ring_index, side="right") - 1) % len(on_level)
        following = (previous + 1) % len(on_level)
        gap = (knots[following] - knots[previous] - 1) % count + 1
        fraction = ((ring_index - knots[previous]) % count) / gap
        end_springback = np.zeros((2, len(ring_index)))
        for k, control_index in enumerate(on_level):
            curve = self.curves[control_index]
            max_force = np.inf if curve.snaps else curve.force[-1]
            for end, value in zip((previous, following), end_springback, strict=True):
                selected = end == k
                value[selected] = curve.at(np.minimum(force[selected], max_force))
        return _interpolate(end_springback[0], end_springback[1], fraction)


def _interpolate(first: FloatArray, second: FloatArray, fraction: FloatArray) -> FloatArray:
    """Interpolate from ``first`` to ``second`` (N,) by a ``fraction`` (N,).

    At an end, where the fraction is 0 or 1, the other value may be NaN.
    """
    mixed = (1.0 - fraction) * first + fraction * second
    return np.asarray(np.where(fraction <= 0.0, first, np.where(fraction >= 1.0, second, mixed)))


def sheet_forces(
    work: FormingWork, forming_pass: FormingPass, points: FloatArray, angle: FloatArray
) -> FloatArray:
    """Return the forces (N,) [N] along z on the sheet at points of a pass.

    They are those that the user states, otherwise those of the formula of `axial_force`, which does not
    include a second tool.

    Args:
        work: Work of the operation.
        forming_pass: Pass.
        points: Points (N, 3) [m].
        angle: Wall angles (N,) [rad].
    """
    if work.stated_forces is not None:
        return work.stated_forces.force_at(forming_pass.name, points)
    op = work.operation
    radius = work.heads[work.forming_arm(forming_pass)].radius
    if op.stepdown_mm is None:
        ridge = np.full(len(angle), (op.scallop_mm or 0.0) * MM)
    else:
        ridge = scallop_height(radius, op.stepdown_mm * MM, np.maximum(angle, 1e-3))
    return axial_force(work.sheet.metal.tensile_stress, work.thickness, 2.0 * radius, ridge, angle)


def solve_curve(
    work: FormingWork,
    point: SpringbackPoint,
    triangles: int = MAX_TRIANGLES,
    factors: FloatArray = LOAD_FACTORS,
) -> SpringbackCurve:
    """Return the springback curve at a point of a pass, on the sheet as formed when the tool is there.

    Loads are ``factors`` of the expected force. If larger forces are expected nearby, loads are this force
    and fractions of the larger one up to it.

    Args:
        work: Work of the operation.
        point: Point.
        triangles: Maximum number of triangles; multiplied by `TRIANGLE_FACTORS` if the sheet has no mesh of
            so few.
        factors: Loads (K,) as multiples of the expected force.

    Raises:
        ValueError: if the formed sheet cannot be meshed with any of these numbers.
    """
    forming_pass = work.passes[point.number]
    walls = sheet_walls(work, point.number, float(point.contact[2]))
    sheet_mesh, allowed = _mesh_sheet(walls, work.sheet.opening, triangles, point.contact)
    mesh = Mesh(sheet_mesh.nodes, sheet_mesh.triangles)
    metal = work.sheet.metal
    sheet = ShellSheet(
        sheet_mesh.nodes,
        sheet_mesh.triangles,
        sheet_thickness(work, point.number, mesh),
        metal.young,
        metal.poisson,
    )
    loads = point.force * factors
    if point.max_force > loads[-1]:
        loads = np.unique(np.append(point.max_force * factors[factors <= 1.0], point.force))
    direction = np.array([0.0, 0.0, -float(forming_pass.side)])
    try:
        loading = Loading(sheet, clamped(sheet, _border_condition(work)))
        displacements = loading.curve(
            pressure_weights(sheet, point.contact, PRESSED_WIDTH_M), loads[:, None] * direction
        )
        snaps = False
    except LimitLoadError as error:
        displacements, snaps = error.displacements, True
    count = len(displacements)
    return SpringbackCurve(
        np.append(0.0, loads[:count]), np.append(0.0, displacements @ direction), snaps, allowed
    )


def _mesh_sheet(
    walls: Sequence[Wall], opening: FloatArray, triangles: int, point: FloatArray
) -> tuple[ShellMesh, int]:
    """Return a mesh of a sheet with a node at a point (3,) [m], and the allowed number of its triangles.

    The numbers of `TRIANGLE_FACTORS` are tried in turn. Raises ``ValueError`` if none is sufficient.
    """
    *earlier_counts, last_count = (int(factor * triangles) for factor in TRIANGLE_FACTORS)
    for allowed in earlier_counts:
        with contextlib.suppress(ValueError):  # the last attempt reports the reason
            return mesh_walls(walls, opening, allowed, point[None], MAX_LOCAL_ELEMENT_M), allowed
    return mesh_walls(walls, opening, last_count, point[None], MAX_LOCAL_ELEMENT_M), last_count


def _border_condition(work: FormingWork) -> str | float:
    """Return the border of the sheet as `clamped` expects it: a word, or its stiffness [N/m^2]."""
    stiffness = work.sheet.border
    return "sliding" if stiffness == 0.0 else "immovable" if np.isinf(stiffness) else stiffness
