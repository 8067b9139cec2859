"""States of a sheet under loads: Newton's method with step cuts, and the curve of displacement over force.

The tangent is factorised once where a load begins. From there on the factors are corrected by the steps
themselves (BFGS: H. Matthies, G. Strang, The solution of nonlinear finite element equations, International
Journal for Numerical Methods in Engineering 14 (1979) 1613-1626), each step with a search along it, which
costs a twentieth of new factors; where that no longer contracts, the tangent is made anew. A sheet that snaps
through has no state in balance near by: steps are cut, and then the load that was reached is told."""

import dataclasses

import numpy as np
import shapely
from scipy.sparse.linalg import SuperLU, splu

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths
from planner.geometry.mesh_repair import border as border_edges
from planner.shell.corotation import Assembly, State, TooFarError, at_rest
from planner.shell.element import Sheet

TOLERANCE = 1e-6
"""Largest displacement of the last correction, over the largest of the state."""
LEAST_DISPLACEMENT = 1e-9
"""Displacements [m] below which corrections are not asked to be smaller: a sheet without load."""
ITERATIONS = 30
"""Steps within one load at most, before it is cut in two."""
PAIRS = 12
"""Corrections of the factors that are remembered, after which the tangent is made anew."""
CONTRACTION = 0.5
"""Share of the step before that a step may have, twice, before the tangent is made anew."""
SEARCHES = 8
"""Shares of a step that are looked at."""
SEARCHED = 0.4
"""Work left along a step, over that at its start, with which the search along it ends."""
SHORTEST = 0.1
"""Share of the way between two places of the search that the next one is ahead of the first at least."""
CUTS = 6
"""How often a load is cut in two before it counts as the limit."""
LEAST_PIVOT = 1e-11
"""Pivots, as shares of the stiffness of their freedoms, up to which a tangent is not positive definite."""
JUMP = 2.0
"""Work of a load's step over the larger of those that the tangents at both ends foretell, at most: a sheet
that has snapped through on the way has moved further than either says."""


@dataclasses.dataclass(frozen=True)
class Supports:
    """What holds a sheet: ``fixed`` (n, 6) displacements and spins along the axes of space that are zero,
    ``spring`` (n, 3) [N/m] springs of nodes to where they were at rest."""

    fixed: BoolArray
    spring: FloatArray


def clamped(sheet: Sheet, border: str | float) -> Supports:
    """A clamp around the border of a sheet, which keeps it level there.

    ``border``: "sliding" (free in plane: of one corner both displacements, of the next one are held, which
    makes no force), "immovable", or the stiffness in plane of a spring along the border [N/m per m]. Raises
    ValueError for others and for springs that hold nothing.
    """
    count = len(sheet.nodes)
    fixed = np.zeros((count, 6), dtype=np.bool_)
    spring = np.zeros((count, 3))
    edges = border_edges(sheet.triangles)
    nodes = np.unique(edges)
    fixed[nodes, 2:5] = True
    if border == "immovable":
        fixed[nodes, :2] = True
    elif border == "sliding":
        x, y = sheet.nodes[nodes, 0], sheet.nodes[nodes, 1]
        fixed[nodes[np.argmin(x + y)], :2] = True
        fixed[nodes[np.argmax(x - y)], 1] = True
    elif isinstance(border, float | int) and np.isfinite(border) and border > 0.0:
        half = 0.5 * lengths(sheet.nodes[edges[:, 1]] - sheet.nodes[edges[:, 0]])
        reach = np.bincount(edges.T.reshape(-1), weights=np.tile(half, 2), minlength=count)
        spring[:, :2] = border * reach[:, None]
    else:
        raise ValueError(f"border: got {border!r}; allowed sliding, immovable or a stiffness above 0 [N/m^2]")
    return Supports(fixed, spring)


def column(sheet: Sheet, place: FloatArray, width: float) -> FloatArray:
    """Shares (n,) of nodes, sum 1, of a load on all nodes in a column of a square of ``width`` [m] about x, y
    of ``place``. Raises ValueError where none is: meshes have nodes at places that they are told."""
    off = np.abs(sheet.nodes[:, :2] - np.asarray(place, dtype=np.float64)[:2]).max(axis=1)
    within = off <= 0.5 * width + 1e-9
    if not within.any():
        raise ValueError(
            f"place ({place[0]:.4g}, {place[1]:.4g}) m: the next node is {off.min():.2g} m away, allowed"
            f" {0.5 * width:.2g}; give the place to the mesh"
        )
    return np.asarray(within / np.count_nonzero(within))


def pressure(sheet: Sheet, place: FloatArray, width: float) -> FloatArray:
    """Shares (n,) of nodes, sum 1, of an even pressure along z on a square of ``width`` [m] about x, y of
    ``place``, by the linear shapes of triangles: what it does hangs on no mesh, where `column` counts nodes.
    Raises ValueError where no triangle is there."""
    x, y = np.asarray(place, dtype=np.float64)[:2]
    half = 0.5 * width
    corners = sheet.nodes[sheet.triangles][:, :, :2]
    near = (corners.min(axis=1) < [x + half, y + half]).all(axis=1)
    near &= (corners.max(axis=1) > [x - half, y - half]).all(axis=1)
    rows = np.flatnonzero(near)
    plan = shapely.polygons(corners[rows])
    both = shapely.intersection(plan, shapely.box(x - half, y - half, x + half, y + half))
    area = shapely.area(both)
    rows, both, area = rows[area > 0.0], both[area > 0.0], area[area > 0.0]
    if not len(rows):
        raise ValueError(f"place ({x:.4g}, {y:.4g}) m: the sheet is elsewhere; give a place on it")
    middle = shapely.get_coordinates(shapely.centroid(both))
    a, b, c = (corners[rows, k] for k in range(3))
    whole = _plan_cross(b - a, c - a)
    second = _plan_cross(middle - a, c - a) / whole
    third = _plan_cross(b - a, middle - a) / whole
    out = np.zeros(len(sheet.nodes))
    for corner, share in enumerate((1.0 - second - third, second, third)):
        np.add.at(out, sheet.triangles[rows, corner], area * share)
    return out / float(out.sum())


def _plan_cross(one: FloatArray, two: FloatArray) -> FloatArray:
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


class LimitLoadError(ArithmeticError):
    """No state in balance was found beyond a load: the sheet snaps through, or buckles, there.

    ``reached`` (3,) [N]: the largest load on the way to the wanted one at which it still held;
    ``displacements`` (k, 3) [m] of the loads before.
    """

    def __init__(self, reached: FloatArray, wanted: FloatArray, displacements: FloatArray) -> None:
        self.reached, self.wanted, self.displacements = reached, wanted, displacements
        last, asked = (", ".join(f"{value:.4g}" for value in load) for load in (reached, wanted))
        super().__init__(
            f"no balance was found beyond ({last}) N on the way to a load of ({asked}) N, in steps down to"
            f" 1/{2**CUTS} of it: it snaps through or buckles there, or bends further than small strains"
            " allow; give less load, loads in between, or a thicker sheet"
        )


@dataclasses.dataclass
class Effort:
    """What a curve took: factors made, steps solved by them, forces worked out, loads cut."""

    factors: int = 0
    solves: int = 0
    forces: int = 0
    cuts: int = 0


def curve(
    sheet: Sheet, supports: Supports, place: FloatArray, loads: FloatArray, width: float = 3e-3
) -> FloatArray:
    """Displacements (k, 3) [m] of a place under ``loads`` (k, 3) [N], one after the other from rest.

    The place is a square of ``width`` [m] about x, y of ``place``; its displacement is the mean that the load
    does work on. Raises LimitLoadError, ValueError where supports let the sheet move freely.
    """
    return Loading(sheet, supports).curve(column(sheet, place, width), loads)


class Loading:
    """A supported sheet of which several curves are wanted: what does not depend on the load is made once."""

    def __init__(self, sheet: Sheet, supports: Supports) -> None:
        _check(sheet, supports)
        self.sheet = sheet
        self.assembly = Assembly(sheet, ~supports.fixed, supports.spring)
        self.effort = Effort()
        loose = "supports: got a sheet that can move without forces; hold it"
        try:
            self._rest = self._start(at_rest(sheet))
        except TooFarError:
            raise ValueError(loose) from None
        if self._rest.unstable:
            raise ValueError(loose)

    def curve(self, shares: FloatArray, loads: FloatArray) -> FloatArray:
        """Displacements (k, 3) [m], the mean over ``shares`` (n,), under ``loads`` (k, 3) [N]: see
        `curve`."""
        return np.array([shares @ state.u for state in self.states(shares, loads)]).reshape(-1, 3)

    def states(self, shares: FloatArray, loads: FloatArray) -> list[State]:
        """The states (k,) under ``loads`` (k, 3) [N], one after the other from rest.

        Raises LimitLoadError, ValueError for loads or shares that are no numbers or of another shape.
        """
        loads = np.asarray(loads, dtype=np.float64)
        count = len(self.sheet.nodes)
        if loads.ndim != 2 or loads.shape[1] != 3 or not np.all(np.isfinite(loads)):
            raise ValueError(
                f"loads: got shape {loads.shape}, or no numbers; allowed finite forces (k, 3) [N]"
            )
        if shares.shape != (count,) or not np.all(np.isfinite(shares)):
            raise ValueError(
                f"shares: got shape {shares.shape}, or no numbers; allowed one of each of {count} nodes"
            )
        found: list[State] = []
        now, at = np.zeros(3), self._rest
        for load in loads:
            reached, at = self._reached(at, shares, now, load)
            if reached < 1.0:
                before = np.array([shares @ state.u for state in found]).reshape(-1, 3)
                raise LimitLoadError(now + reached * (load - now), load, before)
            now = load
            found.append(at.state)
        return found

    def _reached(
        self, at: "_At", shares: FloatArray, now: FloatArray, load: FloatArray
    ) -> "tuple[float, _At]":
        """How far (0 to 1) from the load ``now`` to ``load`` a sheet comes, in steps that are cut where they
        fail, and its state there."""
        done, part = 0.0, 1.0
        while done < 1.0 and part >= 0.5**CUTS:
            found = self._step(at, shares, now + done * (load - now), part * (load - now))
            if found is None:
                self.effort.cuts += 1
                part *= 0.5
            else:
                at, done = found, done + part
                part = min(part, 1.0 - done)
        return done, at

    def _step(self, at: "_At", shares: FloatArray, base: FloatArray, more: FloatArray) -> "_At | None":
        """The state after ``more`` [N], or None where there is none near by."""
        load = np.zeros((len(shares), 6))
        load[:, :3] = shares[:, None] * (base + more)
        try:
            end = self._balanced(at, load)
        except TooFarError:
            return None
        if end is None:
            return None
        first = np.zeros_like(load)
        first[:, :3] = shares[:, None] * more
        push = first.reshape(-1)[self.assembly.free]
        work = float(np.sum(first[:, :3] * (end.state.u - at.state.u)))
        foretold = [float(dots(push, self._solve(one.factors, push))) for one in (at, end)]
        if end.unstable or work < 0.0 or work > JUMP * max(foretold) + 1e-15:
            return None
        return end

    def _balanced(self, at: "_At", load: FloatArray) -> "_At | None":
        """The state in balance with ``load`` (n, 6) from that ``at``, with its own factors. Raises
        TooFarError."""
        free = self.assembly.free
        wanted = load.reshape(-1)[free]
        state, factors = at.state, at.factors
        left = wanted - at.force
        pairs: list[tuple[FloatArray, FloatArray, float]] = []
        last, slow = np.inf, 0
        for _ in range(ITERATIONS):
            step = self._corrected(factors, pairs, left)
            size = float(np.abs(self._whole(step)[:, :3]).max())
            if size <= TOLERANCE * max(float(np.abs(state.u).max()), LEAST_DISPLACEMENT):
                return self._start(state.moved(self._whole(step)))
            slow = slow + 1 if size > CONTRACTION * last else 0
            last = size
            if slow >= 2 or len(pairs) >= PAIRS:
                again = self._start(state)
                factors, pairs, last, slow = again.factors, [], np.inf, 0
                left = wanted - again.force
                continue
            share, state, force = self._searched(state, step, left, wanted)
            change = left - (wanted - force)
            taken = share * step
            if float(dots(taken, change)) > 0.0:
                pairs.append((taken, change, 1.0 / float(dots(taken, change))))
            left = wanted - force
        return None

    def _searched(
        self, state: State, step: FloatArray, left: FloatArray, wanted: FloatArray
    ) -> tuple[float, State, FloatArray]:
        """Share of a step after which the forces left do little work along it, with state and forces
        there. Raises TooFarError where the step leads away from balance, or no share of it can be taken."""
        whole = self._whole(step)
        start = float(dots(step, left))
        if start <= 0.0:
            raise TooFarError
        low: tuple[float, float] = (0.0, start)
        high: tuple[float, float] | None = None
        found: tuple[float, State, FloatArray] | None = None
        share = 1.0
        for _ in range(SEARCHES):
            try:
                state_there = state.moved(share * whole)
                force = self._force(state_there)
            except TooFarError:
                share = 0.5 * (low[0] + share)
                continue
            found = share, state_there, force
            work = float(dots(step, wanted - force))
            if abs(work) <= SEARCHED * start or (work > 0.0 and high is None):
                break
            if work > 0.0:
                low = (share, work)
            else:
                high = (share, work)
            if high is not None:
                # forces grow faster than the step, so that the secant's root is short of the true one
                root = low[0] + (high[0] - low[0]) * low[1] / (low[1] - high[1])
                share = max(root, low[0] + SHORTEST * (high[0] - low[0]))
        if found is None:
            raise TooFarError
        return found

    def _corrected(
        self, factors: SuperLU, pairs: list[tuple[FloatArray, FloatArray, float]], left: FloatArray
    ) -> FloatArray:
        """The step against forces ``left``, by factors corrected by the steps before (two loops)."""
        left = left.copy()
        shares = []
        for taken, change, inverse in reversed(pairs):
            share = inverse * float(dots(taken, left))
            left -= share * change
            shares.append(share)
        step = self._solve(factors, left)
        for (taken, change, inverse), share in zip(pairs, reversed(shares), strict=True):
            step += (share - inverse * float(dots(change, step))) * taken
        return step

    def _start(self, state: State) -> "_At":
        """A state with its forces and the factors of its tangent."""
        force, matrix = self.assembly.tangent(state)
        self.effort.factors += 1
        try:
            factors = splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError:  # exactly singular
            raise TooFarError from None
        # pivots of a symmetric elimination count directions in which a sheet would leave by itself
        pivots = factors.U.diagonal() / matrix.diagonal()[np.argsort(factors.perm_c)]
        unstable = bool(np.any(factors.perm_r != factors.perm_c) or pivots.min() <= LEAST_PIVOT)
        return _At(state, force.reshape(-1)[self.assembly.free], factors, unstable)

    def _solve(self, factors: SuperLU, left: FloatArray) -> FloatArray:
        self.effort.solves += 1
        return np.asarray(factors.solve(left))

    def _force(self, state: State) -> FloatArray:
        self.effort.forces += 1
        return self.assembly.force(state).reshape(-1)[self.assembly.free]

    def _whole(self, step: FloatArray) -> FloatArray:
        out = np.zeros(6 * len(self.sheet.nodes))
        out[self.assembly.free] = step
        return out.reshape(-1, 6)


@dataclasses.dataclass(frozen=True)
class _At:
    """A state, its forces over the free freedoms, its factors, and whether it would leave by itself."""

    state: State
    force: FloatArray
    factors: SuperLU
    unstable: bool


def _check(sheet: Sheet, supports: Supports) -> None:
    count = len(sheet.nodes)
    if supports.fixed.shape != (count, 6) or supports.spring.shape != (count, 3):
        raise ValueError(f"supports: got {supports.fixed.shape}, {supports.spring.shape} for {count} nodes")
