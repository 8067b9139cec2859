"""Thickness of a formed sheet by the sine law, and an estimate of the axial forming force.

**Wall angle and thickness** are maps over the sheet's mesh. A point that moves along z only keeps its area in
plan. The sheet has constant volume, so its thickness along the normal is t = t0 cos(a) at a wall of angle a:
the sine law t = t0 sin(90 deg - a).

**Force** along the tool of single point incremental forming, for the choice of robots: `axial_force`.
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
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error
from planner.processes.forming.plan.contact import FormingPass, smooth_normals

STEEP_AREA_FRACTION: Final = 0.005
"""Fraction of a wall's area that may be steeper than its reported angle: facets of noise and slivers."""


@dataclasses.dataclass(frozen=True)
class ThinnestPoint:
    """Thinnest point of a sheet.

    Attributes:
        thickness: Thickness [m] along the normal.
        point: Position (3,) [m].
        angle: Wall angle [rad].
    """

    thickness: float
    point: FloatArray
    angle: float


def wall_angle_map(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return wall angles (V,) [rad] at the vertices.

    At a crease the steepest wall counts. Vertices without a face have 0.
    """
    return np.asarray(np.arccos(_min_normal_z(vertices, faces)))


def thickness_map(vertices: FloatArray, faces: IntArray, thickness: float) -> FloatArray:
    """Return thicknesses (V,) [m] along the normal of a sheet that is formed in one pass.

    At a crease the steepest wall counts. ``thickness`` [m] is that of the flat sheet.
    """
    return np.asarray(thickness * _min_normal_z(vertices, faces))


def thinnest_point(vertices: FloatArray, faces: IntArray, thickness: float) -> ThinnestPoint:
    """Return the thinnest point of a sheet of ``thickness`` [m] that is formed in one pass."""
    up = _min_normal_z(vertices, faces)
    index = int(np.argmin(up))
    return ThinnestPoint(thickness * float(up[index]), vertices[index], float(np.arccos(up[index])))


def wall_angle(vertices: FloatArray, faces: IntArray) -> float:
    """Return the wall angle [rad] below which all but ``STEEP_AREA_FRACTION`` of the walls' area stays.

    Walls are all faces that are not level (more than 0.5 deg).
    """
    mesh = TriangleMesh(vertices, faces)
    angle = np.arccos(np.clip(face_normals(mesh)[:, 2], -1.0, 1.0))
    area = np.where(angle > np.radians(0.5), face_areas(mesh), 0.0)
    if not area.any():
        return 0.0
    order = np.argsort(angle)
    total = np.cumsum(area[order])
    return float(angle[order[int(np.searchsorted(total, (1.0 - STEEP_AREA_FRACTION) * total[-1]))]])


def face_by_corner(surface: FormingPass, thickness: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the face of a pass with separate corners for each facet, and its thickness there.

    Thickness jumps across a crease, which values at shared vertices cannot represent. Over smooth faces it is
    as smooth as their normals. Thinning by earlier passes is included.

    Args:
        surface: Pass.
        thickness: Thickness [m] of the flat sheet.

    Returns:
        Vertices (3 F, 3) [m], faces (F, 3) and thickness (3 F,) [m].
    """
    mesh = TriangleMesh(surface.vertices, surface.faces)
    up = np.clip(smooth_normals(mesh)[:, :, 2], 0.0, 1.0)
    single_pass = thickness * _vertex_minimum(surface.vertices, surface.faces, up)
    # ratio (V,) of the thickness after all passes to that after a single pass
    thinning = np.where(single_pass > 0.0, surface.thickness / np.maximum(single_pass, 1e-12), 1.0)
    corner_thickness = thickness * up * np.minimum(thinning, 1.0)[surface.faces]
    corners = surface.vertices[surface.faces].reshape(-1, 3)
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3), corner_thickness.reshape(-1)


def _min_normal_z(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the minimum z (V,) of the unit normals about each vertex, within [0, 1].

    Normals are smooth except over creases.
    """
    up = np.clip(smooth_normals(TriangleMesh(vertices, faces))[:, :, 2], 0.0, 1.0)
    return _vertex_minimum(vertices, faces, up)


def _vertex_minimum(vertices: FloatArray, faces: IntArray, up: FloatArray) -> FloatArray:
    """Return the minimum (V,) of the corner values ``up`` (F, 3) about each vertex.

    It is 1 for vertices without a face.
    """
    minimum = np.ones(len(vertices))
    np.minimum.at(minimum, faces.reshape(-1), up.reshape(-1))
    return minimum


FORCE_COEFFICIENT: Final = 0.0716
"""Coefficient of the formula in `axial_force`, for N, N/mm^2, mm and degrees."""
THICKNESS_EXPONENT, DIAMETER_EXPONENT, SCALLOP_EXPONENT = 1.57, 0.41, 0.09
"""Exponents of thickness, tool diameter and scallop height [mm] in `axial_force`."""
PASCALS_PER_MEGAPASCAL: Final = 1e6
"""One megapascal in pascals."""
MAX_FORCE_FACTOR: Final = 2.0
"""Forces above this multiple of the weight that the payload leaves must be accepted in the problem file.

Arms that push slowly bear more than they can swing about, but not any force. Chosen: the factor is assumed.
"""


@dataclasses.dataclass(frozen=True)
class ForceEstimate:
    """Estimate of a forming force.

    Attributes:
        force: Force [N] along the tool.
        low: Lower bound [N] from the metal's range of strength, without the error of the formula.
        high: Upper bound [N] from the metal's range of strength, without the error of the formula.
        angle: Wall angle [rad] at which the force is largest.
        source: Origin of the estimate, for the user.
    """

    force: float
    low: float
    high: float
    angle: float
    source: str


def scallop_height(radius: float, stepdown: ArrayLike, angle: ArrayLike) -> FloatArray:
    """Return the height [m] of the ridge between two contours.

    The inverse of stepdown = 2 sin(angle) sqrt(2 R h - h^2), limited to the radius R.

    Args:
        radius: Radius R [m] of the ball.
        stepdown: Step-down [m].
        angle: Wall angle [rad].
    """
    chord = np.asarray(stepdown, dtype=np.float64) / (2.0 * np.sin(angle))
    short = np.minimum(chord, radius)
    # h = R - sqrt(R^2 - c^2) = c^2 / (R + sqrt(R^2 - c^2)), without cancellation
    height: FloatArray = short * short / (radius + np.sqrt(radius * radius - short * short))
    return height


def axial_force(
    tensile_stress: float, thickness: ArrayLike, diameter: float, scallop: ArrayLike, angle: ArrayLike
) -> FloatArray:
    """Return the axial force [N] of forming. The arguments broadcast.

        F = 0.0716 Rm t^1.57 d^0.41 h^0.09 a cos a

    with F [N], Rm tensile strength [N/mm^2], t sheet thickness, d tool diameter, h scallop height [mm], a
    wall angle [deg]. The force is largest at 49.3 deg, and 0 at 0 and 90 deg. It is the steady force of a
    cone in one pass without support, so with a second tool it is a guess.

    Args:
        tensile_stress: Tensile strength [Pa].
        thickness: Sheet thickness [m].
        diameter: Tool diameter [m].
        scallop: Scallop height [m].
        angle: Wall angle [rad].

    Raises:
        TandemError: forming.force_input.

    Source: Aerens, Eyckens, Van Bael and Duflou, "Force prediction for single point incremental forming
    deduced from experimental and FEM observations", Int. J. Adv. Manuf. Technol. 46 (2010) 969, the general
    form for all of their metals. The values are quoted from general knowledge; the paper itself was not at
    hand.
    """
    t, h, a = (np.asarray(value, dtype=np.float64) for value in (thickness, scallop, angle))
    _require_positive("tensile strength", tensile_stress, "Pa")
    _require_positive("thickness", t / MM, "mm")
    _require_positive("tool diameter", diameter / MM, "mm")
    if not (np.all(np.isfinite(h)) and np.all(h >= 0.0)):
        raise _input_error(f"scallop height: got {_worst_value(h) / MM:g} mm, allowed 0 mm or more")
    if not np.all((a >= 0.0) & (a <= 90.0 * DEG)):
        raise _input_error(f"wall angle: got {_worst_value(a) / DEG:g} deg, allowed 0 to 90 deg")
    lengths = (
        (t / MM) ** THICKNESS_EXPONENT * (diameter / MM) ** DIAMETER_EXPONENT * (h / MM) ** SCALLOP_EXPONENT
    )
    force: FloatArray = (
        FORCE_COEFFICIENT * tensile_stress / PASCALS_PER_MEGAPASCAL * lengths * (a / DEG) * np.cos(a)
    )
    return force


def estimate_force(
    metal: SheetMetal,
    thickness: float,
    diameter: float,
    stepdown: float,
    angles: ArrayLike,
    stated_force: float | None = None,
) -> ForceEstimate:
    """Return the largest axial force over a part's walls, or the force that the user states.

    Args:
        metal: Sheet metal.
        thickness: Sheet thickness [m].
        diameter: Diameter [m] of the ball.
        stepdown: Step-down [m].
        angles: Wall angles (N,) [rad].
        stated_force: Force [N] that the user states; None for the formula.

    Raises:
        TandemError: forming.force_input.
    """
    walls = np.atleast_1d(np.asarray(angles, dtype=np.float64))
    walls = walls[walls > 0.0]
    if walls.size == 0:
        raise _input_error("wall angles: got none above 0 deg, so there is nothing to form")
    if stated_force is not None:
        if not (math.isfinite(stated_force) and stated_force > 0.0):
            raise _input_error(f"force: got {stated_force:g} N, allowed a number above 0 N")
        return ForceEstimate(
            stated_force, stated_force, stated_force, float(walls.max()), "stated by the user"
        )
    _require_positive("stepdown", stepdown / MM, "mm")
    scallop = scallop_height(0.5 * diameter, stepdown, walls)
    force = axial_force(metal.tensile_stress, thickness, diameter, scallop, walls)
    worst_index = int(np.argmax(force))
    low, high = (float(force[worst_index]) * bound / metal.tensile_stress for bound in metal.tensile_range)
    source = "formula of Aerens et al. for one tool, from general knowledge; one pass, no support"
    return ForceEstimate(float(force[worst_index]), low, high, float(walls[worst_index]), source)


def payload_issue(
    estimated: ForceEstimate, arm: str, robot: str, payload: float, carried: float
) -> Issue | None:
    """Return a warning if the force exceeds what the payload leaves (forming.force).

    The limit is the weight of the payload minus that of the tool. Forces above `MAX_FORCE_FACTOR` times the
    limit have to be accepted.

    Args:
        estimated: Force on the tool.
        arm: Name of the arm.
        robot: Title of the robot.
        payload: Payload [kg] of the robot.
        carried: Mass [kg] of what the arm carries.
    """
    free_force = max(payload - carried, 0.0) * GRAVITY
    if estimated.force <= free_force:
        return None
    spread = "" if estimated.low == estimated.high else f" ({estimated.low:.0f} to {estimated.high:.0f} N)"
    return Issue(
        "forming.force",
        format_message(
            "forming.force",
            arm=arm,
            force_n=estimated.force,
            range_clause=spread,
            source=estimated.source,
            robot=robot,
            free_force_n=free_force,
        ),
        Severity.WARNING,
        arm=arm,
        **measurement(estimated.force, free_force, "N"),
        hint="use thinner or softer sheet, a smaller tool or a larger robot, or state a measured force",
        accepted=False if estimated.force > MAX_FORCE_FACTOR * free_force else None,
    )


def _require_positive(quantity: str, value: ArrayLike, unit: str) -> None:
    values = np.asarray(value, dtype=np.float64)
    if not (np.all(np.isfinite(values)) and np.all(values > 0.0)):
        raise _input_error(
            f"{quantity}: got {_worst_value(values):g} {unit}, allowed a number above 0 {unit}"
        )


def _worst_value(values: FloatArray) -> float:
    """Return the first value that is not finite, else the minimum if it is not positive, else the maximum."""
    flat = values.reshape(-1)
    bad = flat[~np.isfinite(flat)]
    if bad.size:
        return float(bad[0])
    return float(flat.min() if flat.min() <= 0.0 else flat.max())


def _input_error(text: str) -> TandemError:
    return issue_error("forming.force_input", text, hint="correct it, in the units stated")
