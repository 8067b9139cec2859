"""Energy of a discrete Kirchhoff rod with its first and second derivatives, for many rods at once.

The rod of length 1 has N straight segments of length h = 1/N. The unknowns are the segments' attitudes (unit
quaternions). Positions follow by summation, so the rod cannot stretch. The middles of neighbouring segments
are h apart, and the clamps are h/2 from the first and the last middle. The discretisation is of second order
in h. Three multipliers F, the force in the rod at its end, hold the end's position.

    Lagrangian = sum_j K.phi_j^2 / (2 D_j) - h sum_k t_k.(F + w (1 - s_k)) + F.d

phi_j: rotation vector between neighbours, D_j their distance, K = (torsion, bending about y, bending about
z), t_k the tangents, w the weight per length, s_k the segments' middles, d the end's position seen from the
start. In terms of the relative quaternion (a, v), phi = v (8 - 2a) / 3, which is the rotation vector up to
fifth order. All derivatives are exact ones of this energy. Arrays have their components first and instants
last: quaternions are (4, N, T).
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import FloatArray, IndexArray

_LEVI_CIVITA = np.zeros((3, 3, 3))
"""Levi-Civita symbol (3, 3, 3), which expresses cross products as sums."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0


def quaternion_product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the product of quaternions (4, ...) wxyz."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def quaternion_conjugate(a: FloatArray) -> FloatArray:
    """Return the inverse of unit quaternions (4, ...)."""
    return np.stack([a[0], -a[1], -a[2], -a[3]])


def quaternion_exp(rotation: FloatArray) -> FloatArray:
    """Return unit quaternions (4, ...) of rotation vectors (3, ...)."""
    half = 0.5 * np.sqrt((rotation * rotation).sum(axis=0))
    return np.concatenate([np.cos(half)[None], 0.5 * np.sinc(half / np.pi) * rotation])


def quaternion_log(q: FloatArray) -> FloatArray:
    """Return the rotation vectors (3, ...) of unit quaternions (4, ...), with angles of at most pi."""
    q = np.where(q[0] < 0.0, -q, q)
    sine = np.sqrt((q[1:] * q[1:]).sum(axis=0))
    angle = 2.0 * np.arctan2(sine, q[0])
    ratio = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 1e-12)
    rotation: FloatArray = ratio * q[1:]
    return rotation


def rotation_matrix(q: FloatArray) -> FloatArray:
    """Return rotation matrices (3, 3, ...) of unit quaternions (4, ...). Column 0 is the tangent."""
    w, x, y, z = q
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def quaternion_from_matrix(rotation: FloatArray) -> FloatArray:
    """Return unit quaternions (4, ...) of rotation matrices (3, 3, ...)."""
    r = rotation
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    four = np.stack([trace, *(2.0 * r[i, i] - trace for i in range(3))]) + 1.0  # 4 q_i^2
    a, b, c = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]  # 4 q_0 q_i; below 4 q_i q_j
    xy, yz, zx = r[0, 1] + r[1, 0], r[1, 2] + r[2, 1], r[2, 0] + r[0, 2]
    rows = np.stack(
        [
            np.stack([four[0], a, b, c]),
            np.stack([a, four[1], xy, zx]),
            np.stack([b, xy, four[2], yz]),
            np.stack([c, zx, yz, four[3]]),
        ]
    )
    best = np.argmax(four, axis=0)  # the largest component gives the row without cancellation
    row = np.take_along_axis(rows, best[None, None], axis=0)[0]
    result: FloatArray = row / np.sqrt((row * row).sum(axis=0))
    return result


@dataclass(frozen=True)
class RodEnds:
    """Clamps at T instants, in the start clamp's frame and in units of the rod's length.

    Attributes:
        position: Position of the end clamp (3, T).
        attitude: Attitude of the end clamp (4, T).
        weight: Weight per length times L^3 / EI (3, T).
    """

    position: FloatArray
    attitude: FloatArray
    weight: FloatArray

    def at(self, which: IndexArray | slice) -> "RodEnds":
        """Return a subset of the instants."""
        return RodEnds(self.position[:, which], self.attitude[:, which], self.weight[:, which])


@dataclass(frozen=True)
class RodDerivatives:
    """Derivatives of the Lagrangian with respect to rotations of the segments.

    Attributes:
        gradient: Gradient (3, N, T).
        diagonal: Diagonal blocks of the Hessian (3, 3, N, T).
        off_diagonal: Blocks of the Hessian in row k, column k+1 (3, 3, N-1, T).
        end_jacobian: Jacobian of the end's position (3, 3, N, T).
        end_error: Position of the end minus its required position (3, T).
    """

    gradient: FloatArray
    diagonal: FloatArray
    off_diagonal: FloatArray
    end_jacobian: FloatArray
    end_error: FloatArray


def joint_spacing(n: int) -> FloatArray:
    """Return the distances (N + 1,) between neighbouring attitudes, clamps included, in lengths of the rod.

    The clamps are half a segment from the first and the last attitude.
    """
    distances = np.full(n + 1, 1.0 / n)
    distances[[0, -1]] *= 0.5
    return distances


def joint_quaternions(q: FloatArray, end_attitude: FloatArray) -> FloatArray:
    """Return relative quaternions (4, N + 1, T) between neighbours, clamps included.

    Their scalar parts are not negative.

    Args:
        q: Attitudes of the segments (4, N, T).
        end_attitude: Attitude of the end clamp (4, T).
    """
    start = np.zeros_like(q[:, :1])
    start[0] = 1.0
    chain = np.concatenate([start, q, end_attitude[:, None]], axis=1)
    p = quaternion_product(quaternion_conjugate(chain[:, :-1]), chain[:, 1:])
    return np.where(p[0] < 0.0, -p, p)


def segment_force(force: FloatArray, weight: FloatArray, n: int) -> FloatArray:
    """Return the force (3, N, T) in the middle of each segment.

    It acts from the part nearer the end on the part nearer the start.

    Args:
        force: Force at the end (3, T).
        weight: Weight of the whole rod (3, T).
        n: Number of segments.
    """
    remaining = 1.0 - (np.arange(n) + 0.5) / n
    return force[:, None, :] + weight[:, None, :] * remaining[None, :, None]


def rod_energy(stiffness: FloatArray, q: FloatArray, ends: RodEnds) -> FloatArray:
    """Return the energy (T,) of bending, torsion and weight.

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        q: Attitudes of the segments (4, N, T).
        ends: The clamps.
    """
    n = q.shape[1]
    p = joint_quaternions(q, ends.attitude)
    # sum of K phi^2 / (2 D), minus h sum of t.w (1 - s)
    phi = p[1:] * ((8.0 - 2.0 * p[0]) / 3.0)
    elastic = 0.5 * np.einsum("i,ijt,j->t", stiffness, phi * phi, 1.0 / joint_spacing(n))
    load = segment_force(np.zeros_like(ends.position), ends.weight, n)
    energy: FloatArray = elastic - (rotation_matrix(q)[:, 0] * load).sum(axis=(0, 1)) / n
    return energy


def rod_derivatives(stiffness: FloatArray, q: FloatArray, force: FloatArray, ends: RodEnds) -> RodDerivatives:
    """Return the derivatives of the Lagrangian with respect to rotations of the segments.

    Newton's method uses them. The rotation vectors (3, N, T) are in each segment's own frame, q -> q
    exp(rotation).

    Args:
        stiffness: Torsion and bending stiffnesses (3,).
        q: Attitudes of the segments (4, N, T).
        force: Force at the end (3, T).
        ends: The clamps.
    """
    # joint energy in the relative quaternion p = (w, v): e = K phi^2 / (2 D), phi = v (8 - 2 w) / 3
    n = q.shape[1]
    p = joint_quaternions(q, ends.attitude)
    w, v = p[0], p[1:]
    scale = (8.0 - 2.0 * w) / 3.0
    k = stiffness[:, None, None] / joint_spacing(n)[None, :, None]
    moment = k * v * scale  # K phi / D
    dw = -2.0 / 3.0 * (moment * v).sum(axis=0)
    dv = moment * scale
    dww = 4.0 / 9.0 * (k * v * v).sum(axis=0)
    dwv = -4.0 / 3.0 * moment
    dvv = k * scale * scale

    # chain rule: p -> exp(-a/2) p exp(b/2) for rotations a, b of the joint's first and second neighbour
    cross = np.einsum("ijk,j...,k...->i...", _LEVI_CIVITA, v, dv)
    along = w * dv - v * dw
    left, right = -0.5 * (along + cross), 0.5 * (along - cross)  # on the joint's first and second neighbour

    skew = np.einsum("ijk,k...->ij...", -_LEVI_CIVITA, v)  # v x
    eye = np.eye(3)[:, :, None, None]
    second = w * eye + skew  # vector part of p e
    first = w * eye - skew  # vector part of e p
    inner = -0.25 * (w * dw + (v * dv).sum(axis=0)) * eye
    first_block = 0.25 * _quadratic_form(first, first, v, dww, dwv, dvv) + inner
    second_block = 0.25 * _quadratic_form(second, second, v, dww, dwv, dvv) + inner
    mixed = -0.25 * (_quadratic_form(first, second, v, dww, dwv, dvv) + _bracket_derivative(w, v, dw, dv))

    # load term -h t.(F + w (1 - s)): its gradient and second derivative in each segment's own frame
    rotation = rotation_matrix(q)
    local_force = -np.einsum("ji...,j...->i...", rotation, segment_force(force, ends.weight, n)) / n
    zero = np.zeros_like(local_force[0])
    gradient = right[:, :-1] + left[:, 1:] + np.stack([zero, -local_force[2], local_force[1]])
    tilt = np.stack(
        [
            np.stack([zero, 0.5 * local_force[1], 0.5 * local_force[2]]),
            np.stack([0.5 * local_force[1], -local_force[0], zero]),
            np.stack([0.5 * local_force[2], zero, -local_force[0]]),
        ]
    )
    diagonal = second_block[:, :, :-1] + first_block[:, :, 1:] + tilt
    # end position h sum of t, with dt = R (r x e_x) = r_z R e_y - r_y R e_z for a rotation r
    slope = np.stack([np.zeros_like(rotation[:, 0]), -rotation[:, 2], rotation[:, 1]], axis=1) / n
    return RodDerivatives(
        gradient, diagonal, mixed[:, :, 1:-1], slope, rotation[:, 0].sum(axis=1) / n - ends.position
    )


def _quadratic_form(
    a: FloatArray, b: FloatArray, v: FloatArray, dww: FloatArray, dwv: FloatArray, dvv: FloatArray
) -> FloatArray:
    """Return (-v; a)^T [[dww, dwv^T], [dwv, diag dvv]] (-v; b) as matrices (3, 3, ...).

    It is the part of a joint's second derivative that follows from the second derivatives of its energy, for
    rotations of its neighbours that change the relative quaternion (w, v) by half of (-v; a) and (-v; b), up
    to sign.
    """
    ua = np.einsum("ji...,j...->i...", a, dwv)
    ub = np.einsum("ji...,j...->i...", b, dwv)
    result: FloatArray = np.einsum("ki...,k...,kj...->ij...", a, dvv, b) + v[:, None] * (dww * v)[None]
    result -= v[:, None] * ub[None] + ua[:, None] * v[None]
    return result


def _bracket_derivative(w: FloatArray, v: FloatArray, dw: FloatArray, dv: FloatArray) -> FloatArray:
    """Return the directional derivatives (3, 3, ...) of the joint energy along the quaternions e_i p e_j.

    p = (w, v) is the relative quaternion. dw and dv are the derivatives of the energy with respect to it.
    """
    # e_i (w, v) e_j = (-v_i, w e_i + e_i x v) e_j
    #                = (-w d_ij - (e_i x v)_j, -v_i e_j + w e_i x e_j + (e_i x v) x e_j)
    # and (e_i x v) x e_j = v d_ij - e_i v_j
    eye = np.eye(3)[:, :, None, None]
    rotated = np.einsum("jik,k...->ij...", _LEVI_CIVITA, v)  # (e_i x v)_j = eps_{j i k} v_k
    scalar = -w * eye - rotated
    axial = np.einsum("ijk,k...->ij...", _LEVI_CIVITA, dv)  # (e_i x e_j) . dv
    vector = -v[:, None] * dv[None] + w * axial + eye * (v * dv).sum(axis=0) - dv[:, None] * v[None]
    result: FloatArray = dw * scalar + vector
    return result
