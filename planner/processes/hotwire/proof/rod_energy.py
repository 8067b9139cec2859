"""Energy of a discrete Kirchhoff rod with its first and second derivatives, for many rods at once.

The rod of length 1 has N straight segments of length h = 1/N. The unknowns are the segments' attitudes
(unit quaternions); positions follow by adding up, so the rod cannot stretch. Neighbouring segments are h
apart (middle to middle), the clamped end frames h/2 from the first and last middle; this is second order in
h. The end's position is held by three multipliers F, the force in the rod at its end.

    Lagrangian = sum_j K.phi_j^2 / (2 D_j) - h sum_k t_k.(F + w (1 - s_k)) + F.d

phi_j: rotation vector between neighbours, D_j their distance, K = (torsion, bending about y, bending about
z), t_k the tangents, w the weight per length, s_k the segments' middles, d the end's place seen from the
start. In terms of the relative quaternion (a, v), phi = v (8 - 2a) / 3, which is the rotation vector up to
fifth order. All derivatives are exact ones of this energy. Arrays have their components first and instants
last: quaternions are (4, N, T).
"""

from dataclasses import dataclass

import numpy as np

from planner.geometry.arrays import FloatArray, IndexArray

_LEVI_CIVITA = np.zeros((3, 3, 3))
"""(3, 3, 3) signs of permutations: the cross product."""
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Product of quaternions (4, ...) wxyz."""
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


def conjugate(a: FloatArray) -> FloatArray:
    """Inverse of unit quaternions (4, ...)."""
    return np.stack([a[0], -a[1], -a[2], -a[3]])


def exponential(rotation: FloatArray) -> FloatArray:
    """Unit quaternions (4, ...) of rotation vectors (3, ...)."""
    half = 0.5 * np.sqrt((rotation * rotation).sum(axis=0))
    return np.concatenate([np.cos(half)[None], 0.5 * np.sinc(half / np.pi) * rotation])


def logarithm(q: FloatArray) -> FloatArray:
    """Rotation vectors (3, ...) of at most half a turn of unit quaternions (4, ...)."""
    q = np.where(q[0] < 0.0, -q, q)
    sine = np.sqrt((q[1:] * q[1:]).sum(axis=0))
    angle = 2.0 * np.arctan2(sine, q[0])
    ratio = np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 1e-12)
    found: FloatArray = ratio * q[1:]
    return found


def matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices (3, 3, ...) of unit quaternions (4, ...); column 0 is the tangent."""
    w, x, y, z = q
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def quaternion(rotation: FloatArray) -> FloatArray:
    """Unit quaternions (4, ...) of rotation matrices (3, 3, ...)."""
    r = rotation
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    four = np.stack([trace, *(2.0 * r[i, i] - trace for i in range(3))]) + 1.0  # 4 q_i^2
    a, b, c = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
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
    picked = np.take_along_axis(rows, best[None, None], axis=0)[0]
    found: FloatArray = picked / np.sqrt((picked * picked).sum(axis=0))
    return found


@dataclass(frozen=True)
class Ends:
    """Where the clamps stand, in the start clamp's frame, for T instants, in units of the rod's length.

    `place` (3, T) and `turn` (4, T) of the end clamp; `weight` (3, T): weight per length times L^3 / EI.
    """

    place: FloatArray
    turn: FloatArray
    weight: FloatArray

    def at(self, which: IndexArray | slice) -> "Ends":
        """Some of the instants."""
        return Ends(self.place[:, which], self.turn[:, which], self.weight[:, which])


@dataclass(frozen=True)
class Derivatives:
    """Of the Lagrangian: `gradient` (3, N, T), Hessian blocks `diagonal` (3, 3, N, T) and `beside` (3, 3,
    N-1, T) (row k, column k+1), Jacobian of the end's place `slope` (3, 3, N, T), and its error `gap` (3,
    T).
    """

    gradient: FloatArray
    diagonal: FloatArray
    beside: FloatArray
    slope: FloatArray
    gap: FloatArray


def spacing(n: int) -> FloatArray:
    """Distances (N + 1,) between neighbouring attitudes, clamps included."""
    found = np.full(n + 1, 1.0 / n)
    found[[0, -1]] *= 0.5
    return found


def joints(q: FloatArray, turn: FloatArray) -> FloatArray:
    """Relative quaternions (4, N + 1, T) between neighbours, clamps included, with positive scalar part."""
    start = np.zeros_like(q[:, :1])
    start[0] = 1.0
    chain = np.concatenate([start, q, turn[:, None]], axis=1)
    p = multiply(conjugate(chain[:, :-1]), chain[:, 1:])
    return np.where(p[0] < 0.0, -p, p)


def inner_force(force: FloatArray, weight: FloatArray, n: int) -> FloatArray:
    """Force (3, N, T) in the middle of each segment, from the part nearer the end onto the part nearer the
    start.
    """
    rest = 1.0 - (np.arange(n) + 0.5) / n
    return force[:, None, :] + weight[:, None, :] * rest[None, :, None]


def energy(stiffness: FloatArray, q: FloatArray, ends: Ends) -> FloatArray:
    """Energy (T,) of bending, torsion and weight."""
    n = q.shape[1]
    p = joints(q, ends.turn)
    phi = p[1:] * ((8.0 - 2.0 * p[0]) / 3.0)
    elastic = 0.5 * np.einsum("i,ijt,j->t", stiffness, phi * phi, 1.0 / spacing(n))
    load = inner_force(np.zeros_like(ends.place), ends.weight, n)
    found: FloatArray = elastic - (matrix(q)[:, 0] * load).sum(axis=(0, 1)) / n
    return found


def derivatives(stiffness: FloatArray, q: FloatArray, force: FloatArray, ends: Ends) -> Derivatives:
    """Derivatives with respect to rotation vectors (3, N, T) in each segment's own frame, q -> q
    exp(rotation).
    """
    n = q.shape[1]
    p = joints(q, ends.turn)
    w, v = p[0], p[1:]
    scale = (8.0 - 2.0 * w) / 3.0
    k = stiffness[:, None, None] / spacing(n)[None, :, None]
    moment = k * v * scale  # K phi / D
    dw = -2.0 / 3.0 * (moment * v).sum(axis=0)
    dv = moment * scale
    dww = 4.0 / 9.0 * (k * v * v).sum(axis=0)
    dwv = -4.0 / 3.0 * moment
    dvv = k * scale * scale

    cross = np.einsum("ijk,j...,k...->i...", _LEVI_CIVITA, v, dv)
    along = w * dv - v * dw
    left, right = -0.5 * (along + cross), 0.5 * (along - cross)  # on the joint's first and second neighbour

    skew = np.einsum("ijk,k...->ij...", -_LEVI_CIVITA, v)  # v x
    eye = np.eye(3)[:, :, None, None]
    second = w * eye + skew  # vector part of p e
    first = w * eye - skew  # vector part of e p
    inner = -0.25 * (w * dw + (v * dv).sum(axis=0)) * eye
    own_first = 0.25 * _product(first, first, v, v, dww, dwv, dvv) + inner
    own_second = 0.25 * _product(second, second, v, v, dww, dwv, dvv) + inner
    mixed = -0.25 * (_product(first, second, v, v, dww, dwv, dvv) + _bracket(w, v, dw, dv))

    turn = matrix(q)
    pull = -np.einsum("ji...,j...->i...", turn, inner_force(force, ends.weight, n)) / n
    zero = np.zeros_like(pull[0])
    gradient = right[:, :-1] + left[:, 1:] + np.stack([zero, -pull[2], pull[1]])
    tilt = np.stack(
        [
            np.stack([zero, 0.5 * pull[1], 0.5 * pull[2]]),
            np.stack([0.5 * pull[1], -pull[0], zero]),
            np.stack([0.5 * pull[2], zero, -pull[0]]),
        ]
    )
    diagonal = own_second[:, :, :-1] + own_first[:, :, 1:] + tilt
    slope = np.stack([np.zeros_like(turn[:, 0]), -turn[:, 2], turn[:, 1]], axis=1) / n
    return Derivatives(gradient, diagonal, mixed[:, :, 1:-1], slope, turn[:, 0].sum(axis=1) / n - ends.place)


def _product(
    a: FloatArray,
    b: FloatArray,
    va: FloatArray,
    vb: FloatArray,
    dww: FloatArray,
    dwv: FloatArray,
    dvv: FloatArray,
) -> FloatArray:
    """(-va; a)^T [[dww, dwv^T], [dwv, diag dvv]] (-vb; b), entry by entry."""
    ua = np.einsum("ji...,j...->i...", a, dwv)
    ub = np.einsum("ji...,j...->i...", b, dwv)
    found: FloatArray = np.einsum("ki...,k...,kj...->ij...", a, dvv, b) + va[:, None] * (dww * vb)[None]
    found -= va[:, None] * ub[None] + ua[:, None] * vb[None]
    return found


def _bracket(w: FloatArray, v: FloatArray, dw: FloatArray, dv: FloatArray) -> FloatArray:
    """Derivative along e_i p e_j, (3, 3, ...): scalar part -w d_ij + v.(e_i x e_j), vector part worked out
    below.
    """
    # e_i (w, v) e_j = (-v_i, w e_i + e_i x v) e_j = (-w d_ij - (e_i x v)_j, -v_i e_j + w e_i x e_j + (e_i x
    # v) x e_j)
    # and (e_i x v) x e_j = v d_ij - e_i v_j
    eye = np.eye(3)[:, :, None, None]
    turned = np.einsum("jik,k...->ij...", _LEVI_CIVITA, v)  # (e_i x v)_j = eps_{j i k} v_k
    scalar = -w * eye - turned
    axial = np.einsum("ijk,k...->ij...", _LEVI_CIVITA, dv)  # (e_i x e_j) . dv
    vector = -v[:, None] * dv[None] + w * axial + eye * (v * dv).sum(axis=0) - dv[:, None] * v[None]
    found: FloatArray = dw * scalar + vector
    return found
