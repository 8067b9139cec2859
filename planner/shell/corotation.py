"""Forces and tangent of triangles that move and turn as far as they like while they deform little.

Each triangle carries a frame: origin in corner 1, x through corner 2, the plane through corner 3. What its
corners do beyond the frame are the 12 deformations of ``element``; these alone make forces. After C. A.
Felippa and B. Haugen, A unified formulation of small-strain corotational finite elements: I. Theory, Computer
Methods in Applied Mechanics and Engineering 194 (2005) 2285-2335, with B. Nour-Omid and C. C. Rankin (same
journal 93, 1991) for the derivatives of turns.

With this frame no corner is deflected and three stretches are left, so that tangents are products of 12 and
15 rows instead of projections of 18 x 18:

    force   f = P^T t,             t = (stress of stretches, H^T moments)
    tangent K = P^T C P + F G + G^T A D,

where P (12, 18) are the rates of the deformations (turns as spins), D its first three rows, G (3, 18) the
spin of the frame, C the stiffness with H and the derivative of H, F how forces turn with the frame, and A how
G and D change with the triangle's own shape. K is symmetric in balance without moments from outside; its
symmetric half is used, which costs no order of convergence there."""

import dataclasses

import numpy as np
from scipy.sparse import csc_array

from planner.geometry.arrays import BoolArray, FloatArray, IntArray, exp_rotation, lengths, skew
from planner.shell.element import Elements, Sheet, elements, frames

LARGEST_SINE = 0.9
"""Sine of the largest turn of a corner against its triangle that is worked with: small strains end long
before."""


@dataclasses.dataclass(frozen=True)
class State:
    """Where a sheet is: displacements ``u`` (n, 3) [m] and turns ``rotation`` (n, 3, 3) of all nodes."""

    u: FloatArray
    rotation: FloatArray

    def moved(self, step: FloatArray) -> "State":
        """After a step (n, 6): displacements [m], and spins [rad] about the axes of space."""
        return State(self.u + step[:, :3], exp_rotation(step[:, 3:]) @ self.rotation)


def at_rest(sheet: Sheet) -> State:
    """The state without displacements."""
    count = len(sheet.nodes)
    return State(np.zeros((count, 3)), np.broadcast_to(np.eye(3), (count, 3, 3)))


class TooFarError(ArithmeticError):
    """A triangle is turned inside out, or a corner has turned too far from it: the step was too long."""


@dataclasses.dataclass(frozen=True)
class _Deformed:
    """Triangles in a state: ``frame`` (m, 3, 3), ``corner`` (m, 3) as in `Elements`; ``turn`` (m, 3, 3) of
    corners by component; ``own`` (m, 12) forces over the deformations."""

    frame: FloatArray
    corner: FloatArray
    turn: FloatArray
    own: FloatArray


class Assembly:
    """A sheet with supports, ready for forces and tangents of any state.

    ``free`` (n, 6): freedoms that move; ``spring`` (n, 3) [N/m]: springs of nodes to where they started.
    """

    def __init__(self, sheet: Sheet, free: BoolArray, spring: FloatArray) -> None:
        self.sheet = sheet
        self.elements: Elements = elements(sheet)
        self.spring = spring
        self.free: IntArray = np.flatnonzero(free.reshape(-1))
        count = len(sheet.nodes)
        self._freedoms = (6 * sheet.triangles[:, :, None] + np.arange(6)).reshape(-1, 18)
        self._all = 6 * count
        self._pattern()

    def _pattern(self) -> None:
        """Rows and columns of the tangent, and which of its places each entry of each triangle goes to."""
        number = np.full(self._all, -1, dtype=np.int64)
        number[self.free] = np.arange(len(self.free))
        local = number[self._freedoms]
        row = np.broadcast_to(local[:, :, None], (len(local), 18, 18)).reshape(-1)
        column = np.broadcast_to(local[:, None, :], (len(local), 18, 18)).reshape(-1)
        self._entries = np.flatnonzero((row >= 0) & (column >= 0))
        key = column[self._entries] * len(self.free) + row[self._entries]
        diagonal = np.arange(len(self.free)) * (len(self.free) + 1)
        places, self._place = np.unique(np.concatenate([key, diagonal]), return_inverse=True)
        self._diagonal = self._place[len(key) :]
        self._place = self._place[: len(key)]
        self._rows = (places % len(self.free)).astype(np.int32)
        counts = np.bincount(places // len(self.free), minlength=len(self.free))
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)

    def force(self, state: State) -> FloatArray:
        """Forces (n, 6) [N, Nm] that hold the sheet in a state. Raises TooFarError."""
        deformed = self._deformed(state)
        rates = self._rates(deformed)
        local = np.matmul(self._pulled(deformed)[:, None, :], rates[:, :12])[:, 0]
        return self._gathered(local, state)

    def tangent(self, state: State) -> tuple[FloatArray, csc_array]:
        """Forces (n, 6), and their symmetric tangent over the free freedoms [N/m, N, Nm]. Raises
        TooFarError."""
        deformed = self._deformed(state)
        rates, pulled = self._rates(deformed), self._pulled(deformed)
        local = np.matmul(pulled[:, None, :], rates[:, :12])[:, 0]
        matrix = self._local_tangent(deformed, rates, pulled, local).reshape(-1)[self._entries]
        values = np.bincount(self._place, weights=matrix, minlength=len(self._rows)).astype(np.float64)
        springs = np.zeros((len(self.spring), 6))
        springs[:, :3] = self.spring
        values[self._diagonal] += springs.reshape(-1)[self.free]
        shape = (len(self.free), len(self.free))
        return self._gathered(local, state), csc_array((values, self._rows, self._starts), shape=shape)

    def _gathered(self, local: FloatArray, state: State) -> FloatArray:
        """Sum (n, 6) of the forces (m, 18) of triangles at nodes, with those of springs."""
        freedoms, forces = self._freedoms.reshape(-1), local.reshape(-1)
        out = np.bincount(freedoms, weights=forces, minlength=self._all).astype(np.float64).reshape(-1, 6)
        out[:, :3] += self.spring * state.u
        return out

    def _deformed(self, state: State) -> _Deformed:
        rest, triangles = self.elements, self.sheet.triangles
        frame, corner = frames((self.sheet.nodes + state.u)[triangles])
        # how each corner has turned beyond its triangle, along the triangle's axes
        ahead = np.matmul(frame[:, None], state.rotation[triangles])
        turned = np.matmul(ahead, np.swapaxes(rest.frame, 1, 2)[:, None])
        axial = 0.5 * np.stack(
            [
                turned[..., 2, 1] - turned[..., 1, 2],
                turned[..., 0, 2] - turned[..., 2, 0],
                turned[..., 1, 0] - turned[..., 0, 1],
            ],
            axis=-1,
        )
        sine = lengths(axial)
        trace = turned[..., 0, 0] + turned[..., 1, 1] + turned[..., 2, 2]
        if not (sine.max() < LARGEST_SINE and trace.min() > 1.0):
            raise TooFarError
        small = sine < 1e-6
        turn = axial * np.where(small, 1.0, np.arcsin(sine) / np.where(small, 1.0, sine))[..., None]
        d = np.concatenate([corner - rest.corner, turn.reshape(-1, 9)], axis=1)
        return _Deformed(frame, corner, turn, np.matmul(rest.stiffness, d[:, :, None])[:, :, 0])

    def _rates(self, deformed: _Deformed) -> FloatArray:
        """Rows (m, 15, 18) over displacements and spins of the corners along the axes of space: three
        stretches, spins of corners 1 to 3 beyond the frame, spin of the frame; spins along its axes."""
        frame = deformed.frame
        e1, e2, e3 = frame[:, 0], frame[:, 1], frame[:, 2]
        x2, x3, y3 = deformed.corner.T[:, :, None]
        out = np.zeros((len(frame), 15, 18))
        spin = out[:, 12:]
        spin[:, 0, 12:15] = e3 / y3
        spin[:, 0, 6:9] = -(x3 / x2) * spin[:, 0, 12:15]
        spin[:, 0, 0:3] = -spin[:, 0, 12:15] - spin[:, 0, 6:9]
        spin[:, 1, 0:3] = e3 / x2
        spin[:, 1, 6:9] = -spin[:, 1, 0:3]
        spin[:, 2, 6:9] = e2 / x2
        spin[:, 2, 0:3] = -spin[:, 2, 6:9]
        out[:, 1:2] = y3[:, None] * spin[:, 2:]
        out[:, 2:3] = -x3[:, None] * spin[:, 2:]
        out[:, 0, 6:9] += e1
        out[:, 0, 0:3] -= e1
        out[:, 1, 12:15] += e1
        out[:, 1, 0:3] -= e1
        out[:, 2, 12:15] += e2
        out[:, 2, 0:3] -= e2
        for corner in range(3):
            rows = out[:, 3 + 3 * corner : 6 + 3 * corner]
            rows -= spin
            rows[:, :, 6 * corner + 3 : 6 * corner + 6] = frame
        return out

    def _pulled(self, deformed: _Deformed) -> FloatArray:
        """Forces (m, 12) over rates: stresses of stretches, and moments over spins (m = H^T M)."""
        out = deformed.own.copy()
        moments = deformed.own[:, 3:].reshape(-1, 3, 3)
        spins = np.matmul(np.swapaxes(_spin_to_turn(deformed.turn), 2, 3), moments[..., None])[..., 0]
        out[:, 3:] = spins.reshape(-1, 9)
        return out

    def _local_tangent(
        self, deformed: _Deformed, rates: FloatArray, pulled: FloatArray, force: FloatArray
    ) -> FloatArray:
        """Symmetric tangents (m, 18, 18) of triangles along the axes of space."""
        count = len(rates)
        x2, x3, y3 = deformed.corner.T
        by_turn = _spin_to_turn(deformed.turn)
        inner = self.elements.stiffness.copy()
        for corner in range(3):
            rows = slice(3 + 3 * corner, 6 + 3 * corner)
            inner[:, :, rows] = inner[:, :, rows] @ by_turn[:, corner]
        for corner in range(3):
            rows = slice(3 + 3 * corner, 6 + 3 * corner)
            inner[:, rows] = np.swapaxes(by_turn[:, corner], 1, 2) @ inner[:, rows]
            moment = deformed.own[:, rows]
            inner[:, rows, rows] += _turned_moment(deformed.turn[:, corner], moment) @ by_turn[:, corner]
        left = np.empty((count, 18, 15))
        np.matmul(np.swapaxes(rates[:, :12], 1, 2), inner, out=left[:, :, :12])
        # forces turn with the frame: spin x force, at each corner
        across = np.swapaxes(skew(force.reshape(-1, 6, 3)), 2, 3) @ np.swapaxes(deformed.frame, 1, 2)[:, None]
        left[:, :, 12:] = across.reshape(-1, 18, 3)
        # spins and stretches change with the triangle's shape
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
        whole = left @ rates
        return np.asarray(0.5 * (whole + np.swapaxes(whole, 1, 2)))


def _shares(turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """eta = (1 - a/2 cot(a/2)) / a^2 and its slope over a, by a, for turns (..., 3) of angles a, (..., 1, 1).

    Of turns below 1e-2 the first terms of the series 1/12 + a^2/720, 1/360 + a^2/7560 (errors of 1e-10).
    """
    square = np.einsum("...i,...i->...", turn, turn)[..., None, None]
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


def _spin_to_turn(turn: FloatArray) -> FloatArray:
    """H (..., 3, 3): rate of a rotation vector by spin, 1 - skew/2 + eta skew^2 (Felippa and Haugen 2005)."""
    cross = skew(turn)
    eta, _ = _shares(turn)
    return np.asarray(np.eye(3) - 0.5 * cross + eta * (cross @ cross))


def _turned_moment(turn: FloatArray, moment: FloatArray) -> FloatArray:
    """Derivative (m, 3, 3) of H^T M over the turn, M held (Nour-Omid and Rankin 1991)."""
    eta, slope = _shares(turn)
    cross, t, m = skew(turn), turn[:, :, None], moment[:, :, None]
    tm = np.swapaxes(t, 1, 2) @ m
    first = tm * np.eye(3) + t @ np.swapaxes(m, 1, 2) - 2.0 * (m @ np.swapaxes(t, 1, 2))
    second = (cross @ cross @ m) @ np.swapaxes(t, 1, 2)
    return np.asarray(eta * first + slope * second - 0.5 * skew(moment))
