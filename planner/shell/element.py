"""Linear stiffness of flat shell triangles: bending and membrane.

Bending uses the discrete Kirchhoff triangle (DKT). In the plane, the triangle is a membrane with drilling
freedoms (rotations of corners about the normal), or one of constant strain.

Each triangle has its own frame: the first corner is the origin, the second lies on x, the third has y > 0.
Deflections are measured from the plane through the corners, so that three stretches and the rotations of
three corners remain, 12 deformations:

    (d x2, d x3, d y3, rotation of corner 1 (x, y, z), of corner 2, of corner 3).

Bending (DKT): the rotations of the normal are quadratic over the triangle. Along each side, the rotation in
the side's plane is minus the slope of a cubic deflection, and the one across it is linear. Source: J.-L.
Batoz, K.-J. Bathe, L.-W. Ho, A study of three-node triangular plate bending elements, International Journal
for Numerical Methods in Engineering 15 (1980) 1771-1812.

Membrane ("optimal"): C. A. Felippa, A study of optimal membrane triangles with drilling freedoms, Computer
Methods in Applied Mechanics and Engineering 192 (2003) 2125-2168, from the ANDES template by C. A. Felippa
and C. Militello (Computers & Structures 1992). "Constant strain" is the usual triangle of three corners; each
of its drilling rotations has a weak spring against the rotation of the triangle.
"""

import dataclasses
from typing import Literal

import numpy as np

from planner.geometry.arrays import FloatArray, IntArray, dots, lengths, unit

Membrane = Literal["optimal", "constant strain"]
"""Membrane formulation: with drilling freedoms, or the constant strain triangle."""

DRILLING_SPRING = 1e-3
"""Spring stiffness of a drilling rotation of a constant strain triangle, as a fraction of shear modulus x
volume.
"""
_ALPHA_B = 1.5
"""Parameter alpha_b of the template, the weight of drilling rotations in the constant strain part (Felippa
2003, table of OPT).
"""
_BETA = (1.0, 2.0, 1.0, 0.0, 1.0, -1.0, -1.0, -1.0, -2.0)
"""Parameters beta_1 to beta_9 of the template, with which in-plane bending is exact (Felippa 2003, table of
OPT).
"""
_MIN_BETA_0 = 0.01
"""Minimum of beta_0 = (1 - 4 nu^2) / 2, which vanishes at nu = 0.5 together with the drilling stiffness."""
_STRETCHES = (3, 6, 7)
"""Indices of u2, u3, v3 in the nine membrane displacements (u, v, rotation) x 3. The frame removes the
others.
"""
_DRILLINGS = (2, 5, 8)
"""Indices of the drilling rotations in the nine membrane displacements."""


@dataclasses.dataclass(frozen=True)
class ShellSheet:
    """An elastic sheet, stress-free in its initial shape.

    Attributes:
        nodes: Points (n, 3) [m] on the middle surface.
        triangles: Node indices (m, 3).
        thickness: Thickness (m,) [m] of each triangle.
        youngs_modulus: Young's modulus [Pa].
        poisson: Poisson's ratio, from 0 to below 0.5.
        membrane: Membrane formulation.

    Raises:
        ValueError: If a triangle has no area, a node has no triangle, or a value is out of range.
    """

    nodes: FloatArray
    triangles: IntArray
    thickness: FloatArray
    youngs_modulus: float
    poisson: float
    membrane: Membrane = "optimal"

    def __post_init__(self) -> None:
        count = len(self.triangles)
        if count == 0 or self.thickness.shape != (count,):
            raise ValueError(
                f"thickness: got shape {self.thickness.shape} for {count} triangles, allowed one for each"
            )
        if not (np.all(np.isfinite(self.nodes)) and np.all(self.thickness > 0.0)):
            raise ValueError("nodes and thickness: got values that are not finite or not positive")
        if not (self.youngs_modulus > 0.0 and 0.0 <= self.poisson < 0.5):
            raise ValueError(
                f"got E {self.youngs_modulus:g}, nu {self.poisson:g}; allowed E > 0 and 0 <= nu < 0.5"
            )
        if set(np.unique(self.triangles).tolist()) != set(range(len(self.nodes))):
            raise ValueError("triangles: each node must be a corner of a triangle, and each corner a node")
        a, b, c = (self.nodes[self.triangles[:, k]] for k in range(3))
        flat = lengths(np.cross(b - a, c - a)) <= 1e-9 * dots(b - a, b - a)
        if flat.any():
            raise ValueError(f"triangle {int(np.argmax(flat))} has no area; remove it")


@dataclasses.dataclass(frozen=True)
class Elements:
    """Data of a sheet's triangles that does not change with the deformation.

    Attributes:
        frame: Axes (m, 3, 3), as rows.
        corner: Coordinates x2, x3, y3 (m, 3) [m] in the frame.
        stiffness: Stiffness (m, 12, 12) over the 12 deformations (stretches [m], rotations [rad]), in N/m, N
            and Nm.
        area: Area (m,) [m^2].
    """

    frame: FloatArray
    corner: FloatArray
    stiffness: FloatArray
    area: FloatArray


def frames(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the frames of triangles with corners ``points`` (m, 3, 3) [m].

    Returns:
        Axes as rows (m, 3, 3), and coordinates x2, x3, y3 of the second and third corner (m, 3) [m].
    """
    to_second, to_third = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    x = unit(to_second)
    z = unit(np.cross(to_second, to_third))
    y = np.cross(z, x)
    corner = np.stack([dots(x, to_second), dots(x, to_third), dots(y, to_third)], axis=1)
    return np.stack([x, y, z], axis=1), corner


def elements(sheet: ShellSheet) -> Elements:
    """Compute frames and stiffness of all triangles of a sheet in its initial shape.

    The stiffness combines a membrane with bending, over the 12 deformations of each triangle.
    """
    frame, corner = frames(sheet.nodes[sheet.triangles])
    xy = np.zeros((len(corner), 3, 2))
    xy[:, 1, 0], xy[:, 2, 0], xy[:, 2, 1] = corner.T
    elastic = plane_stress(sheet.youngs_modulus, sheet.poisson)
    if sheet.membrane == "optimal":
        inplane = optimal_membrane(xy, sheet.thickness, elastic, sheet.poisson)
    else:
        shear = sheet.youngs_modulus / (2.0 + 2.0 * sheet.poisson)
        inplane = constant_strain_membrane(xy, sheet.thickness, elastic, DRILLING_SPRING * shear)
    bending = dkt_bending(xy, sheet.thickness, elastic)
    stiffness = np.zeros((len(corner), 12, 12))
    # membrane freedoms that the frame leaves, and their places among the 12 deformations
    kept = list(_STRETCHES + _DRILLINGS)
    targets = [0, 1, 2, 5, 8, 11]
    stiffness[:, np.array(targets)[:, None], targets] = inplane[:, np.array(kept)[:, None], kept]
    # rotations of the corners about x and y
    tilts = [3, 4, 6, 7, 9, 10]
    stiffness[:, np.array(tilts)[:, None], tilts] = bending
    return Elements(frame, corner, stiffness, 0.5 * corner[:, 0] * corner[:, 2])


def plane_stress(youngs_modulus: float, poisson: float) -> FloatArray:
    """Return the elasticity matrix (3, 3) [Pa] of an isotropic material in plane stress.

    It maps the strains (xx, yy, shear angle) to stresses:

        E / (1 - nu^2) * [[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]]
    """
    modulus = youngs_modulus / (1.0 - poisson**2)
    return modulus * np.array([[1.0, poisson, 0.0], [poisson, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - poisson)]])


def dkt_bending(xy: FloatArray, thickness: FloatArray, elastic: FloatArray) -> FloatArray:
    """Return the bending stiffness (m, 6, 6) [Nm] over the rotations about x and y of each corner (DKT).

    The corners have no deflections. The normal rotates by (bx, by) = (rotation about y, - rotation about x).
    The curvatures are bx,x, by,y and bx,y + by,x. At the middle of a side without deflections at its ends,
    the slope along the side is -1/4 of the sum of those at the ends, the one across it is their mean.

    Args:
        xy: Corners (m, 3, 2) [m].
        thickness: Thickness (m,) [m].
        elastic: Elasticity matrix (3, 3) [Pa].

    Source: Batoz, Bathe and Ho 1980, section 2.3.
    """
    count = len(xy)
    normal = np.zeros((count, 6, 2, 6))  # (bx, by) at corners and middles of sides 12, 23, 31, over rotations
    for corner in range(3):
        normal[:, corner, 0, 2 * corner + 1] = 1.0
        normal[:, corner, 1, 2 * corner] = -1.0
    for side, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        along = unit(xy[:, j] - xy[:, i])
        end_sum = normal[:, i] + normal[:, j]
        # half of the sum, but -1/4 of it along the side: 1/2 - 3/4
        projected = along[:, :, None] * along[:, None, :]
        normal[:, 3 + side] = 0.5 * end_sum - 0.75 * (projected @ end_sum)
    gradient, area = _area_gradients(xy)
    out = np.zeros((count, 6, 6))
    weight = thickness**3 / 12.0 * area / 3.0  # weight of each of three points, exact for quadratic functions
    for point in ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5)):
        # K = t^3 / 12 int B^T E B dA, B the curvatures (bx,x; by,y; bx,y + by,x) by the rotations
        slopes = np.swapaxes(_quadratic_slopes(point) @ gradient, 1, 2)
        change = (slopes @ normal.reshape(count, 6, 12)).reshape(count, 2, 2, 6)  # axis, component, rotation
        curvature = np.stack([change[:, 0, 0], change[:, 1, 1], change[:, 1, 0] + change[:, 0, 1]], axis=1)
        out += weight[:, None, None] * (np.swapaxes(curvature, 1, 2) @ elastic @ curvature)
    return out


def optimal_membrane(
    xy: FloatArray, thickness: FloatArray, elastic: FloatArray, poisson: float
) -> FloatArray:
    """Return the membrane stiffness (m, 9, 9) over (u, v, drilling rotation) of each corner: Felippa's OPT.

    The basic part is (1 / V) L E L^T. The higher part is 3/4 beta_0 T^T K_theta T of the drilling rotations
    relative to the triangle, with beta_0 = (1 - 4 nu^2) / 2.

    Args:
        xy: Corners (m, 3, 2) [m].
        thickness: Thickness (m,) [m].
        elastic: Elasticity matrix (3, 3) [Pa].
        poisson: Poisson's ratio.

    Source: Felippa 2003, sections 4 and 5.
    """
    _, area = _area_gradients(xy)
    x = {f"{i}{j}": xy[:, i - 1, 0] - xy[:, j - 1, 0] for i in (1, 2, 3) for j in (1, 2, 3) if i != j}
    y = {f"{i}{j}": xy[:, i - 1, 1] - xy[:, j - 1, 1] for i in (1, 2, 3) for j in (1, 2, 3) if i != j}
    square = {key: x[key] ** 2 + y[key] ** 2 for key in ("21", "32", "13")}
    # L = t / 2 (y_jk, 0, x_kj; 0, x_kj, y_jk; alpha_b / 6 (y_jk (y_ik - y_ji), x_kj (x_ki - x_ij),
    # 2 (x_ki y_ik - x_ij y_ji))), rows u, v, rotation of corner i, columns xx, yy, xy
    lumped = np.zeros((len(xy), 9, 3))
    # corner i follows corner k and precedes corner j
    for corner, (i, j, k) in enumerate(((1, 2, 3), (2, 3, 1), (3, 1, 2))):
        yjk, xkj = y[f"{j}{k}"], x[f"{k}{j}"]
        yik, yji = y[f"{i}{k}"], y[f"{j}{i}"]
        xki, xij = x[f"{k}{i}"], x[f"{i}{j}"]
        lumped[:, 3 * corner, 0] = lumped[:, 3 * corner + 1, 2] = yjk
        lumped[:, 3 * corner + 1, 1] = lumped[:, 3 * corner, 2] = xkj
        lumped[:, 3 * corner + 2] = (
            _ALPHA_B
            / 6.0
            * np.stack([yjk * (yik - yji), xkj * (xki - xij), 2.0 * (xki * yik - xij * yji)], axis=1)
        )
    lumped *= 0.5 * thickness[:, None, None]
    # basic stiffness L E L^T / V with V = A t
    basic = lumped @ elastic @ np.swapaxes(lumped, 1, 2) / (area * thickness)[:, None, None]
    drilling_rotations = _drilling_rotations(xy, area)
    factor = 1.0 / (4.0 * area**2)
    # T_e: strains (xx, yy, xy) by the natural strains along the sides 21, 32, 13
    natural = factor[:, None, None] * np.stack(
        [
            np.stack(
                [
                    y["23"] * y["13"] * square["21"],
                    y["31"] * y["21"] * square["32"],
                    y["12"] * y["32"] * square["13"],
                ],
                axis=1,
            ),
            np.stack(
                [
                    x["23"] * x["13"] * square["21"],
                    x["31"] * x["21"] * square["32"],
                    x["12"] * x["32"] * square["13"],
                ],
                axis=1,
            ),
            np.stack(
                [
                    (y["23"] * x["31"] + x["32"] * y["13"]) * square["21"],
                    (y["31"] * x["12"] + x["13"] * y["21"]) * square["32"],
                    (y["12"] * x["23"] + x["21"] * y["32"]) * square["13"],
                ],
                axis=1,
            ),
        ],
        axis=1,
    )
    side_stiffness = np.swapaxes(natural, 1, 2) @ elastic @ natural
    # Q_1 to Q_3: natural strains at the corners by the drilling rotations; their means are at the middles
    b1, b2, b3, b4, b5, b6, b7, b8, b9 = _BETA
    weights = np.array(
        [
            [[b1, b2, b3], [b4, b5, b6], [b7, b8, b9]],
            [[b9, b7, b8], [b3, b1, b2], [b6, b4, b5]],
            [[b5, b6, b4], [b8, b9, b7], [b2, b3, b1]],
        ]
    )
    sides = np.stack([square["21"], square["32"], square["13"]], axis=1)
    corners = (2.0 * area / 3.0)[:, None, None, None] * weights / sides[:, None, :, None]
    middles = 0.5 * (corners + corners[:, [1, 2, 0]])
    # higher stiffness 3/4 beta_0 A t T^T (sum over middles of Q^T T_e^T E T_e Q) T, T the drilling rotations
    higher = np.einsum("mqai,mab,mqbj->mij", middles, side_stiffness, middles)
    beta_0 = max(0.5 * (1.0 - 4.0 * poisson**2), _MIN_BETA_0)
    higher *= (0.75 * beta_0 * area * thickness)[:, None, None]
    return np.asarray(basic + np.swapaxes(drilling_rotations, 1, 2) @ higher @ drilling_rotations)


def constant_strain_membrane(
    xy: FloatArray, thickness: FloatArray, elastic: FloatArray, drilling: float
) -> FloatArray:
    """Return the membrane stiffness (m, 9, 9) of triangles of constant strain with drilling springs.

    It is over (u, v, drilling rotation) of each corner.

    Args:
        xy: Corners (m, 3, 2) [m].
        thickness: Thickness (m,) [m].
        elastic: Elasticity matrix (3, 3) [Pa].
        drilling: Stiffness [Pa] per volume between each corner's rotation and the triangle's.
    """
    gradient, area = _area_gradients(xy)
    strain = np.zeros((len(xy), 3, 9))
    for corner in range(3):
        strain[:, 0, 3 * corner] = strain[:, 2, 3 * corner + 1] = gradient[:, corner, 0]
        strain[:, 1, 3 * corner + 1] = strain[:, 2, 3 * corner] = gradient[:, corner, 1]
    drilling_rotations = _drilling_rotations(xy, area)
    # K = A t (B^T E B + drilling T^T T), B the strains and T the drilling rotations by the displacements
    per_volume = np.swapaxes(strain, 1, 2) @ elastic @ strain
    per_volume += drilling * (np.swapaxes(drilling_rotations, 1, 2) @ drilling_rotations)
    return np.asarray((area * thickness)[:, None, None] * per_volume)


def _drilling_rotations(xy: FloatArray, area: FloatArray) -> FloatArray:
    """Return the matrix (m, 3, 9) from membrane displacements to drilling rotations relative to the triangle.

    The triangle rotates by (v,x - u,y) / 2.
    """
    # rotation_i - (v,x - u,y) / 2 with u,y = sum over corners of u_k dL_k/dy
    gradient, _ = _area_gradients(xy)
    out = np.zeros((len(xy), 3, 9))
    for corner in range(3):
        out[:, :, 3 * corner] = 0.5 * gradient[:, None, corner, 1]
        out[:, :, 3 * corner + 1] = -0.5 * gradient[:, None, corner, 0]
        out[:, corner, 3 * corner + 2] = 1.0
    return out


def _area_gradients(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gradients (m, 3, 2) [1/m] of the area coordinates, and the areas (m,) [m^2]."""
    after, before = xy[:, [1, 2, 0]], xy[:, [2, 0, 1]]
    side = after - before
    area = 0.5 * (
        (xy[:, 1, 0] - xy[:, 0, 0]) * (xy[:, 2, 1] - xy[:, 0, 1])
        - (xy[:, 2, 0] - xy[:, 0, 0]) * (xy[:, 1, 1] - xy[:, 0, 1])
    )
    return np.stack([side[..., 1], -side[..., 0]], axis=2) / (2.0 * area)[:, None, None], area


def _quadratic_slopes(point: tuple[float, float, float]) -> FloatArray:
    """Return the derivatives (6, 3) of the quadratic shape functions by the area coordinates at a point.

    The functions belong to the corners 1 to 3, then to the middles of the sides 12, 23 and 31.
    """
    out = np.zeros((6, 3))
    for corner in range(3):
        out[corner, corner] = 4.0 * point[corner] - 1.0
    for side, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        out[3 + side, i], out[3 + side, j] = 4.0 * point[j], 4.0 * point[i]
    return out
