"""Forces and tangent stiffness of triangles with arbitrarily large displacements but small strains.

Rotations may be arbitrarily large, too. Each triangle carries a frame: origin in corner 1, x through corner
2, the plane through corner 3. The motion of its corners relative to the frame consists of the 12 deformations
of ``element``; only these produce forces.

In this frame no corner is deflected and three stretches remain, so tangents are products of matrices with 12
and 15 rows instead of projections of 18 x 18:

    force   f = P^T t,             t = (stress of stretches, H^T moments)
    tangent K = P^T C P + F G + G^T A D,

where P (12, 18) are the rates of the deformations (rotations as spins), D its first three rows, G (3, 18) the
spin of the frame, C the stiffness with H and the derivative of H, F the change of the forces with the frame's
rotation, and A the change of G and D with the triangle's own shape. K is symmetric in equilibrium without
external moments. Its symmetric part is used, which costs no order of convergence there.

Sources: C. A. Felippa and B. Haugen, A unified formulation of small-strain corotational finite elements: I.
Theory, Computer Methods in Applied Mechanics and Engineering 194 (2005) 2285-2335; B. Nour-Omid and C. C.
Rankin (same journal 93, 1991) for the derivatives of rotations.
"""

import dataclasses

import numpy as np
from scipy.sparse import csc_array

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, exp_rotation, lengths, skew
from planner.shell.element import Elements, ShellSheet, elements, frames

MAX_ROTATION_SINE = 0.9
"""Sine of the largest allowed rotation of a corner relative to its triangle. Small strains end long
before.
"""


@dataclasses.dataclass(frozen=True)
class State:
    """Displacements and rotations of all nodes of a sheet.

    Attributes:
        u: Displacements (n, 3) [m].
        rotation: Rotation matrices (n, 3, 3).
    """

    u: FloatArray
    rotation: FloatArray

    def moved(self, step: FloatArray) -> "State":
        """Return the state after a step (n, 6) of displacements [m] and spins [rad] about the global axes."""
        return State(self.u + step[:, :3], exp_rotation(step[:, 3:]) @ self.rotation)


def at_rest(sheet: ShellSheet) -> State:
    """Return the state of a sheet without displacements and rotations."""
    count = len(sheet.nodes)
    return State(np.zeros((count, 3)), np.broadcast_to(np.eye(3), (count, 3, 3)))


class TooFarError(ArithmeticError):
    """A triangle is inverted, or a corner has rotated too far relative to it, because a step was too long."""


@dataclasses.dataclass(frozen=True)
class _Deformed:
    """Triangles in a deformed state.

    Attributes:
        frame: Axes (m, 3, 3), as in `Elements`.
        corner: Coordinates x2, x3, y3 (m, 3) [m], as in `Elements`.
        turn: Rotation vectors (m, 3, 3) [rad] of the corners relative to the triangle, one row per corner.
        forces: Forces (m, 12) conjugate to the deformations [N, Nm].
    """

    frame: FloatArray
    corner: FloatArray
    turn: FloatArray
    forces: FloatArray


class Assembly:
    """A supported sheet, ready to compute forces and tangents in any state.

    Args:
        sheet: Sheet.
        free: Freedoms (n, 6) that can move.
        spring: Stiffness (n, 3) [N/m] of springs between nodes and their initial positions.
    """

    def __init__(self, sheet: ShellSheet, free: BoolArray, spring: FloatArray) -> None:
        self.sheet = sheet
        self.elements: Elements = elements(sheet)
        self.spring = spring
        self.free: IntArray = np.flatnonzero(free.reshape(-1))
        count = len(sheet.nodes)
        # indices of the 18 freedoms of each triangle among all 6 n
        self._freedoms = (6 * sheet.triangles[:, :, None] + np.arange(6)).reshape(-1, 18)
        self._all = 6 * count
        self._build_pattern()

    def _build_pattern(self) -> None:
        """Set up the sparsity pattern of the tangent, and where the entries of each triangle are added.

        The pattern does not change with the state, so it is computed once. Entries of fixed freedoms are left
        out. Each diagonal entry is in the pattern, because springs are added there.
        """
        # number: index among the free freedoms, -1 if fixed; key: position in a dense matrix, by columns
        number = np.full(self._all, -1, dtype=np.int64)
        number[self.free] = np.arange(len(self.free))
        local = number[self._freedoms]
        row = np.broadcast_to(local[:, :, None], (len(local), 18, 18)).reshape(-1)
        column = np.broadcast_to(local[:, None, :], (len(local), 18, 18)).reshape(-1)
        self._entries = np.flatnonzero((row >= 0) & (column >= 0))
        key = column[self._entries] * len(self.free) + row[self._entries]
        diagonal = np.arange(len(self.free)) * (len(self.free) + 1)
        entries, self._entry_index = np.unique(np.concatenate([key, diagonal]), return_inverse=True)
        self._diagonal = self._entry_index[len(key) :]
        self._entry_index = self._entry_index[: len(key)]
        self._rows = (entries % len(self.free)).astype(np.int32)
        counts = np.bincount(entries // len(self.free), minlength=len(self.free))
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)

    def force(self, state: State) -> FloatArray:
        """Return the nodal forces and moments (n, 6) [N, Nm] in equilibrium with a state.

        Raises:
            TooFarError: If a triangle is deformed too far.
        """
        deformed = self._deform(state)
        rates = self._rates(deformed)
        local = np.matmul(self._conjugate_forces(deformed)[:, None, :], rates[:, :12])[:, 0]
        return self._assemble_forces(local, state)

    def tangent(self, state: State) -> tuple[FloatArray, csc_array]:
        """Return nodal forces (n, 6) [N, Nm], and the symmetric tangent over the free freedoms [N/m, N, Nm].

        Raises:
            TooFarError: If a triangle is deformed too far.
        """
        deformed = self._deform(state)
        rates, pulled = self._rates(deformed), self._conjugate_forces(deformed)
        local = np.matmul(pulled[:, None, :], rates[:, :12])[:, 0]
        matrix = self._local_tangent(deformed, rates, pulled, local).reshape(-1)[self._entries]
        values = np.bincount(self._entry_index, weights=matrix, minlength=len(self._rows)).astype(np.float64)
        springs = np.zeros((len(self.spring), 6))
        springs[:, :3] = self.spring
        values[self._diagonal] += springs.reshape(-1)[self.free]
        shape = (len(self.free), len(self.free))
        return self._assemble_forces(local, state), csc_array((values, self._rows, self._starts), shape=shape)

    def _assemble_forces(self, local: FloatArray, state: State) -> FloatArray:
        """Return the sums (n, 6) [N, Nm] at each node of the forces (m, 18) of triangles and of springs."""
        freedoms, forces = self._freedoms.reshape(-1), local.reshape(-1)
        out = np.bincount(freedoms, weights=forces, minlength=self._all).astype(np.float64).reshape(-1, 6)
        out[:, :3] += self.spring * state.u
        return out

    def _deform(self, state: State) -> _Deformed:
        """Return frames, deformations and forces of all triangles in a state, from which `_rates` follows.

        With R = frame rotation * node rotation * initial frame^T, the rotation vector is axial(R) * asin(s) /
        s, with s = |axial(R)| (Felippa and Haugen 2005).

        Raises:
            TooFarError: If the sine s reaches `MAX_ROTATION_SINE` or trace R is 1 or less.
        """
        rest, triangles = self.elements, self.sheet.triangles
        frame, corner = frames((self.sheet.nodes + state.u)[triangles])
        # rotation of each corner relative to its triangle, along the triangle's axes
        ahead = np.matmul(frame[:, None], state.rotation[triangles])
        relative_rotation = np.matmul(ahead, np.swapaxes(rest.frame, 1, 2)[:, None])
        # axial(R) = (R32 - R23, R13 - R31, R21 - R12) / 2 = sin(angle) axis
        axial = 0.5 * np.stack(
            [
                relative_rotation[..., 2, 1] - relative_rotation[..., 1, 2],
                relative_rotation[..., 0, 2] - relative_rotation[..., 2, 0],
                relative_rotation[..., 1, 0] - relative_rotation[..., 0, 1],
            ],
            axis=-1,
        )
        sine = lengths(axial)
        trace = relative_rotation[..., 0, 0] + relative_rotation[..., 1, 1] + relative_rotation[..., 2, 2]
        if not (sine.max() < MAX_ROTATION_SINE and trace.min() > 1.0):
            raise TooFarError
        small = sine < 1e-6
        rotation_vectors = (
            axial * np.where(small, 1.0, np.arcsin(sine) / np.where(small, 1.0, sine))[..., None]
        )
        deformations = np.concatenate([corner - rest.corner, rotation_vectors.reshape(-1, 9)], axis=1)
        return _Deformed(
            frame, corner, rotation_vectors, np.matmul(rest.stiffness, deformations[:, :, None])[:, :, 0]
        )

    def _rates(self, deformed: _Deformed) -> FloatArray:
        """Return the matrix (m, 15, 18) of each triangle from rates of its corners to those of deformations.

        Its first 12 rows map rates of the corners to rates of the deformations. Their transpose maps the
        forces of the deformations to nodal forces, and the tangent is built from all rows.

        A row multiplies the displacement rate and the spin (x, y, z of each) of corner 1, then of corners 2
        and 3, all along the global axes. The rows give, along the axes of the triangle's frame:

        - 0 to 2: rates of the stretches x2, x3, y3 (the matrix D),
        - 3 to 11: spins of corners 1 to 3 relative to the frame (with D the matrix P),
        - 12 to 14: spin of the frame (the matrix G).
        """
        frame = deformed.frame
        e1, e2, e3 = frame[:, 0], frame[:, 1], frame[:, 2]
        x2, x3, y3 = deformed.corner.T[:, :, None]
        out = np.zeros((len(frame), 15, 18))
        # G, the spin w of the frame, with d_ij = u_i - u_j:
        # w = (e3.(d_31 - x3 / x2 d_21) / y3, -e3.d_21 / x2, e2.d_21 / x2)
        spin = out[:, 12:]
        spin[:, 0, 12:15] = e3 / y3
        spin[:, 0, 6:9] = -(x3 / x2) * spin[:, 0, 12:15]
        spin[:, 0, 0:3] = -spin[:, 0, 12:15] - spin[:, 0, 6:9]
        spin[:, 1, 0:3] = e3 / x2
        spin[:, 1, 6:9] = -spin[:, 1, 0:3]
        spin[:, 2, 6:9] = e2 / x2
        spin[:, 2, 0:3] = -spin[:, 2, 6:9]
        # D, the stretches: (e1.d_21, e1.d_31 + y3 w_z, e2.d_31 - x3 w_z). The frame turns with side 1-2, so
        # w_z changes the coordinates of corner 3.
        out[:, 1:2] = y3[:, None] * spin[:, 2:]
        out[:, 2:3] = -x3[:, None] * spin[:, 2:]
        out[:, 0, 6:9] += e1
        out[:, 0, 0:3] -= e1
        out[:, 1, 12:15] += e1
        out[:, 1, 0:3] -= e1
        out[:, 2, 12:15] += e2
        out[:, 2, 0:3] -= e2
        # spins of the corners relative to the frame, along its axes
        for corner in range(3):
            corner_spin = out[:, 3 + 3 * corner : 6 + 3 * corner]
            corner_spin -= spin
            corner_spin[:, :, 6 * corner + 3 : 6 * corner + 6] = frame
        return out

    def _conjugate_forces(self, deformed: _Deformed) -> FloatArray:
        """Return the forces (m, 12) conjugate to the rates of the deformations (rows 0 to 11 of `_rates`).

        Forces of stretches stay as they are. Moments M, which are conjugate to the rotation vectors, become
        those conjugate to spins, H^T M, with H from `_spin_to_vector_rate`.
        """
        out = deformed.forces.copy()
        moments = deformed.forces[:, 3:].reshape(-1, 3, 3)
        spin_moments = np.matmul(np.swapaxes(_spin_to_vector_rate(deformed.turn), 2, 3), moments[..., None])[
            ..., 0
        ]
        out[:, 3:] = spin_moments.reshape(-1, 9)
        return out

    def _local_tangent(
        self, deformed: _Deformed, rates: FloatArray, pulled: FloatArray, force: FloatArray
    ) -> FloatArray:
        """Return the symmetric parts (m, 18, 18) of the tangents K = P^T C P + F G + G^T A D of triangles.

        A tangent is the derivative of a triangle's nodal forces and moments by displacements and spins of its
        corners, all along the global axes. The module docstring explains the matrices.

        Args:
            deformed: Triangles in a state.
            rates: Rates (m, 15, 18): P and G, from `_rates`.
            pulled: Forces (m, 12) conjugate to the rates: t, from `_conjugate_forces`.
            force: Forces and moments (m, 18) of the corners along the global axes: f.
        """
        count = len(rates)
        x2, x3, y3 = deformed.corner.T
        vector_rates = _spin_to_vector_rate(deformed.turn)
        # C = H^T S H + d(H^T M)/dt H at constant M, with rotation vectors t; S is the element stiffness, H
        # acts on rotations
        inner = self.elements.stiffness.copy()
        for corner in range(3):
            rotations = slice(3 + 3 * corner, 6 + 3 * corner)
            inner[:, :, rotations] = inner[:, :, rotations] @ vector_rates[:, corner]
        for corner in range(3):
            rotations = slice(3 + 3 * corner, 6 + 3 * corner)
            inner[:, rotations] = np.swapaxes(vector_rates[:, corner], 1, 2) @ inner[:, rotations]
            moment = deformed.forces[:, rotations]
            inner[:, rotations, rotations] += (
                _moment_derivative(deformed.turn[:, corner], moment) @ vector_rates[:, corner]
            )
        left = np.empty((count, 18, 15))
        np.matmul(np.swapaxes(rates[:, :12], 1, 2), inner, out=left[:, :, :12])
        # F: forces rotate with the frame, spin x force at each corner
        across = np.swapaxes(skew(force.reshape(-1, 6, 3)), 2, 3) @ np.swapaxes(deformed.frame, 1, 2)[:, None]
        left[:, :, 12:] = across.reshape(-1, 18, 3)
        # A: spins and stretches change with the triangle's shape. The part of t.P that depends on it is mu.w,
        # with mu = -sum of moments + (0, 0, y3 t_2 - x3 t_3). By G: dw_z = -w_z dx2 / x2,
        # dw_y = -w_y dx2 / x2, dw_x = (-w_x dy3 + w_y (dx3 - x3 / x2 dx2)) / y3.
        stress = pulled[:, :3]
        moment = -pulled[:, 3:].reshape(-1, 3, 3).sum(axis=1)
        moment[:, 2] += y3 * stress[:, 1] - x3 * stress[:, 2]
        shape = np.zeros((count, 3, 3))
        shape[:, 0, 2] = -moment[:, 0] / y3
        shape[:, 1, 0] = -(moment[:, 1] + moment[:, 0] * x3 / y3) / x2
        shape[:, 1, 1] = moment[:, 0] / y3
        shape[:, 2, 0] = -moment[:, 2] / x2
        shape[:, 2, 1], shape[:, 2, 2] = -stress[:, 2], stress[:, 1]
        left[:, :, :3] += np.swapaxes(rates[:, 12:], 1, 2) @ shape
        tangent = left @ rates
        return np.asarray(0.5 * (tangent + np.swapaxes(tangent, 1, 2)))


def _spin_coefficients(rotation_vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of H and its derivative (see below) for rotation vectors (..., 3) of angle a.

    They are eta = (1 - a/2 cot(a/2)) / a^2 and (d eta / da) / a. For angles below 1e-2, the first terms of
    the series 1/12 + a^2/720 and 1/360 + a^2/7560 are used (errors of 1e-10).

    Returns:
        Both coefficients (..., 1, 1).

    Source: Nour-Omid and Rankin 1991.
    """
    square = np.einsum("...i,...i->...", rotation_vector, rotation_vector)[..., None, None]
    small = square < 1e-4
    angle = np.sqrt(np.where(small, 1.0, square))
    eta = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    slope = (angle**2 + 4.0 * np.cos(angle) + angle * np.sin(angle) - 4.0) / (
        4.0 * angle**4 * np.sin(0.5 * angle) ** 2
    )
    return (
        np.where(small, 1.0 / 12.0 + square / 720.0, eta),
        np.where(small, 1.0 / 360.0 + square / 7560.0, slope),
    )


def _spin_to_vector_rate(rotation_vector: FloatArray) -> FloatArray:
    """Return the matrix H (..., 3, 3) from spins (angular velocities) to rates of rotation vectors (..., 3).

    H = 1 - skew/2 + eta skew^2 (Felippa and Haugen 2005).
    """
    cross = skew(rotation_vector)
    eta, _ = _spin_coefficients(rotation_vector)
    return np.asarray(np.eye(3) - 0.5 * cross + eta * (cross @ cross))


def _moment_derivative(rotation_vector: FloatArray, moment: FloatArray) -> FloatArray:
    """Return the derivative (m, 3, 3) of H^T M by the rotation vector t, for a constant moment M.

    eta (t.M 1 + t M^T - 2 M t^T) + slope skew(t)^2 M t^T - skew(M) / 2, see `_spin_coefficients`.

    Source: Nour-Omid and Rankin 1991.
    """
    eta, slope = _spin_coefficients(rotation_vector)
    cross, t, m = skew(rotation_vector), rotation_vector[:, :, None], moment[:, :, None]
    tm = np.swapaxes(t, 1, 2) @ m
    first = tm * np.eye(3) + t @ np.swapaxes(m, 1, 2) - 2.0 * (m @ np.swapaxes(t, 1, 2))
    second = (cross @ cross @ m) @ np.swapaxes(t, 1, 2)
    return np.asarray(eta * first + slope * second - 0.5 * skew(moment))
