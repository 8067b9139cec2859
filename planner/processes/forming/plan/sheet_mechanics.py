"""Thickness of a formed sheet by the sine law, and the axial force of forming as an estimate.

**Wall angle and thickness**, as maps over the sheet's mesh. A place that is moved along z only
keeps its area in plan, so its sheet of constant volume becomes as thick along the normal as t = t0
cos(a) at a wall of angle a: the sine law t = t0 sin(90 deg - a).

**Force** along the tool that single point incremental forming takes, for choosing robots: `axial_force`.
"""

import dataclasses
import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from planner.catalogue.materials import SheetMetal
from planner.geometry.arrays import FloatArray, IntArray
from planner.geometry.mesh import TriangleMesh, face_areas, face_normals
from planner.geometry.units import DEG, GRAVITY, MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal
from planner.processes.forming.plan.contact import Pass, smooth_normals

STEEP_SHARE: Final = 0.005
"""Share of a wall's area that may be steeper than what counts as its angle: facets of noise and slivers."""


@dataclasses.dataclass(frozen=True)
class Thinnest:
    """The thinnest place: ``thickness`` [m] along the normal, ``point`` (3,) [m], wall ``angle`` [rad]."""

    thickness: float
    point: FloatArray
    angle: float


def wall_angle_map(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Wall angles (V,) [rad] at the vertices, that of the steepest wall where several meet in a crease; 0 for
    vertices of no face."""
    return np.asarray(np.arccos(_least_up(vertices, faces)))


def thickness_map(vertices: FloatArray, faces: IntArray, thickness: float) -> FloatArray:
    """Thicknesses (V,) [m] along the normal of a sheet of ``thickness`` [m] formed in one pass, at a crease
    that of the steepest wall."""
    return np.asarray(thickness * _least_up(vertices, faces))


def thinnest(vertices: FloatArray, faces: IntArray, thickness: float) -> Thinnest:
    """The thinnest place of a sheet of ``thickness`` [m] formed in one pass."""
    up = _least_up(vertices, faces)
    at = int(np.argmin(up))
    return Thinnest(thickness * float(up[at]), vertices[at], float(np.arccos(up[at])))


def steepest(vertices: FloatArray, faces: IntArray) -> float:
    """Wall angle [rad] that all but ``STEEP_SHARE`` of the walls' area (what is not level) stays below."""
    mesh = TriangleMesh(vertices, faces)
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > np.radians(0.5), face_areas(mesh), 0.0)
    if not area.any():
        return 0.0
    order = np.argsort(angle)
    total = np.cumsum(area[order])
    return float(angle[order[int(np.searchsorted(total, (1.0 - STEEP_SHARE) * total[-1]))]])


def by_corner(surface: Pass, thickness: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """The face of a pass with corners of its own for each facet, and its thickness there: vertices (3 F, 3)
    [m], faces (F, 3), thickness (3 F,) [m].

    Across a crease thickness jumps, which values at shared vertices cannot; over smooth faces it is as smooth
    as their normals. ``thickness`` [m] of the flat sheet.
    """
    mesh = TriangleMesh(surface.vertices, surface.faces)
    up = np.clip(smooth_normals(mesh)[:, :, 2], 0.0, 1.0)
    single = thickness * _least(surface.vertices, surface.faces, up)
    earlier = np.where(single > 0.0, surface.thickness / np.maximum(single, 1e-12), 1.0)
    value = thickness * up * np.minimum(earlier, 1.0)[surface.faces]
    corners = surface.vertices[surface.faces].reshape(-1, 3)
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3), value.reshape(-1)


def _least_up(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """The least z (V,) of the unit normals about each vertex, smooth but over creases, within [0, 1]."""
    up = np.clip(smooth_normals(TriangleMesh(vertices, faces))[:, :, 2], 0.0, 1.0)
    return _least(vertices, faces, up)


def _least(vertices: FloatArray, faces: IntArray, up: FloatArray) -> FloatArray:
    """The least (V,) of what corners of facets have, ``up`` (F, 3), about each vertex; 1 where none is."""
    least = np.ones(len(vertices))
    np.minimum.at(least, faces.reshape(-1), up.reshape(-1))
    return least


FORCE_COEFFICIENT: Final = 0.0716
"""Coefficient of the formula in `axial_force`, for N, N/mm^2, mm and degrees."""
OF_THICKNESS, OF_DIAMETER, OF_SCALLOP = 1.57, 0.41, 0.09
"""Exponents of thickness, tool diameter and scallop height [mm] in `axial_force`."""
MEGAPASCAL: Final = 1e6
"""One megapascal in pascals."""
MOST_FORCE_FACTOR: Final = 2.0
"""Forces beyond so many times what a payload leaves are refused unless the problem accepts them: arms that
push slowly bear more than they may swing about, but not any force. The factor is assumed."""


@dataclasses.dataclass(frozen=True)
class ForceEstimate:
    """``force`` [N] along the tool with ``low`` and ``high`` [N] from the metal's range of strength (not the
    formula's own error), at the wall angle ``angle`` [rad] where it is largest; ``source`` says where it
    comes from."""

    force: float
    low: float
    high: float
    angle: float
    source: str


def scallop_height(radius: float, stepdown: ArrayLike, angle: ArrayLike) -> FloatArray:
    """Height [m] of the ridge between two contours, for a ball of ``radius`` [m]: the inverse of
    stepdown = 2 sin(angle) sqrt(2 radius h - h^2), at most the radius."""
    chord = np.asarray(stepdown, dtype=np.float64) / (2.0 * np.sin(angle))
    short = np.minimum(chord, radius)
    # radius - sqrt(radius^2 - chord^2) without its cancellation
    height: FloatArray = short * short / (radius + np.sqrt(radius * radius - short * short))
    return height


def axial_force(
    tensile_stress: float, thickness: ArrayLike, diameter: float, scallop: ArrayLike, angle: ArrayLike
) -> FloatArray:
    """Axial force [N]: tensile strength [Pa], sheet thickness, tool diameter, scallop height [m] and wall
    angle [rad], which broadcast. Largest at 49.3 deg; 0 at 0 and 90 deg. Raises `TandemError`
    (forming.force_input).

    Formula of Aerens, Eyckens, Van Bael and Duflou, "Force prediction for single point incremental forming
    deduced from experimental and FEM observations", Int. J. Adv. Manuf. Technol. 46 (2010) 969, its general
    form for all of their metals:

        F = 0.0716 Rm t^1.57 d^0.41 h^0.09 a cos a

    F [N], Rm tensile strength [N/mm^2], t sheet thickness, d tool diameter, h scallop height [mm], a wall
    angle [deg]. The figures are quoted from general knowledge; the paper itself was not at hand. It is the
    steady force of a cone in one pass without support, so with a second tool it is a guess."""
    t, h, a = (np.asarray(value, dtype=np.float64) for value in (thickness, scallop, angle))
    _positive("tensile strength", tensile_stress, "Pa")
    _positive("thickness", t / MM, "mm")
    _positive("tool diameter", diameter / MM, "mm")
    if not (np.all(np.isfinite(h)) and np.all(h >= 0.0)):
        raise _wrong(f"scallop height: got {_worst(h) / MM:g} mm, allowed 0 mm or more")
    if not np.all((a >= 0.0) & (a <= 90.0 * DEG)):
        raise _wrong(f"wall angle: got {_worst(a) / DEG:g} deg, allowed 0 to 90 deg")
    lengths = (t / MM) ** OF_THICKNESS * (diameter / MM) ** OF_DIAMETER * (h / MM) ** OF_SCALLOP
    force: FloatArray = FORCE_COEFFICIENT * tensile_stress / MEGAPASCAL * lengths * (a / DEG) * np.cos(a)
    return force


def estimate(
    metal: SheetMetal,
    thickness: float,
    diameter: float,
    stepdown: float,
    angles: ArrayLike,
    given: float | None = None,
) -> ForceEstimate:
    """The largest axial force over a part's wall ``angles`` (N,) [rad], or the user's figure ``given`` [N].

    ``thickness``, ball ``diameter`` and ``stepdown`` [m]. Raises `TandemError` (forming.force_input).
    """
    walls = np.atleast_1d(np.asarray(angles, dtype=np.float64))
    walls = walls[walls > 0.0]
    if walls.size == 0:
        raise _wrong("wall angles: got none above 0 deg, allowed one at least; nothing is to be formed")
    if given is not None:
        if not (math.isfinite(given) and given > 0.0):
            raise _wrong(f"force: got {given:g} N, allowed a number above 0 N")
        return ForceEstimate(given, given, given, float(walls.max()), "the user's figure")
    _positive("stepdown", stepdown / MM, "mm")
    scallop = scallop_height(0.5 * diameter, stepdown, walls)
    force = axial_force(metal.tensile_stress, thickness, diameter, scallop, walls)
    worst = int(np.argmax(force))
    low, high = (float(force[worst]) * bound / metal.tensile_stress for bound in metal.tensile_range)
    source = "formula of Aerens et al. for one tool, from general knowledge; one pass, no support"
    return ForceEstimate(float(force[worst]), low, high, float(walls[worst]), source)


def payload_issue(found: ForceEstimate, arm: str, robot: str, payload: float, carried: float) -> Issue | None:
    """A warning where the force is beyond the weight of the ``payload`` [kg] less what is ``carried`` [kg]
    (forming.force); to be accepted where it is beyond `MOST_FORCE_FACTOR` times that.
    """
    free = max(payload - carried, 0.0) * GRAVITY
    if found.force <= free:
        return None
    spread = "" if found.low == found.high else f" ({found.low:.0f} to {found.high:.0f} N)"
    return Issue(
        "forming.force",
        f"{arm}: forming takes about {found.force:.0f} N{spread} ({found.source}), the payload of {robot} "
        f"leaves {free:.0f} N beside its tool; it may stop with a collision error, or bend out of place",
        Severity.WARNING,
        arm=arm,
        **measurement(found.force, free, "N"),
        hint="take thinner or softer sheet, a smaller tool or a larger robot, or state a measured force",
        accepted=False if found.force > MOST_FORCE_FACTOR * free else None,
    )


def _positive(what: str, value: ArrayLike, unit: str) -> None:
    values = np.asarray(value, dtype=np.float64)
    if not (np.all(np.isfinite(values)) and np.all(values > 0.0)):
        raise _wrong(f"{what}: got {_worst(values):g} {unit}, allowed a number above 0 {unit}")


def _worst(values: FloatArray) -> float:
    """The first value that is no number, else the least one if it is below 0, else the largest."""
    flat = values.reshape(-1)
    bad = flat[~np.isfinite(flat)]
    if bad.size:
        return float(bad[0])
    return float(flat.min() if flat.min() <= 0.0 else flat.max())


def _wrong(text: str) -> TandemError:
    return refusal("forming.force_input", text, hint="correct it, in the units stated")
