"""Equilibrium states of a sheet under loads, and its load-displacement curves.

They are computed by a quasi-Newton method with step cuts.

The tangent is factorised once at the start of each load. From there on the factorisation is corrected with
BFGS updates and a line search along each step, which costs a twentieth of a new factorisation. If that does
not contract any more, the tangent is factorised again. A sheet that snaps through has no equilibrium nearby:
steps are cut, and then the last load reached is reported.

Source: H. Matthies, G. Strang, The solution of nonlinear finite element equations, International Journal for
Numerical Methods in Engineering 14 (1979) 1613-1626.
"""

import dataclasses

import numpy as np
import shapely
from scipy.sparse.linalg import SuperLU, splu

from planner.geometry.arrays import BoolArray, FloatArray, dots, lengths
from planner.geometry.mesh_repair import border_edges as border_edges
from planner.shell.corotation import Assembly, State, TooFarError, at_rest
from planner.shell.element import ShellSheet

TOLERANCE = 1e-6
"""Convergence limit: largest displacement of the last step over the largest of the state."""
MIN_DISPLACEMENT_M = 1e-9
"""Smallest displacement [m] of the state to which the last step is compared, for a sheet without load."""
MAX_ITERATIONS = 30
"""Maximum number of iterations per load step before it is halved."""
MAX_UPDATES = 12
"""Number of BFGS updates after which the tangent is factorised again."""
CONTRACTION = 0.5
"""Ratio of successive step lengths. If it is exceeded twice in a row, the tangent is factorised again."""
MAX_SEARCHES = 8
"""Maximum number of trials of a line search."""
SEARCH_TOLERANCE = 0.4
"""A line search ends if the residual's work along the step falls below this fraction of its initial value."""
MIN_BRACKET_FRACTION = 0.1
"""Minimum fraction of the bracket of a line search by which the next trial is ahead of its lower end."""
MAX_CUTS = 6
"""Maximum number of halvings of a load step before the limit load is reported."""
MIN_PIVOT_RATIO = 1e-11
"""The tangent counts as not positive definite if a pivot over its diagonal entry is at most this."""
JUMP = 2.0
"""Maximum ratio of the work of a load step to the larger prediction by the tangents at its ends. A sheet that
snapped through has moved further.
"""


@dataclasses.dataclass(frozen=True)
class Supports:
    """Supports of a sheet.

    Attributes:
        fixed: Freedoms (n, 6) that are zero: displacements and spins along the global axes.
        spring: Stiffness (n, 3) [N/m] of springs between nodes and their initial positions.
    """

    fixed: BoolArray
    spring: FloatArray


def clamped(sheet: ShellSheet, border: str | float) -> Supports:
    """Return the supports of a sheet whose border is clamped and kept level.

    Args:
        sheet: Sheet.
        border: "sliding" (free in plane except for three displacements of two corners, which cause no force),
            "immovable", or the in-plane stiffness of a spring along the border [N/m per m].

    Raises:
        ValueError: For other values and stiffnesses that are not positive.
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


def column_weights(sheet: ShellSheet, centre: FloatArray, width: float) -> FloatArray:
    """Return weights (n,) with sum 1 that distribute a load equally to the nodes in a square seen from above.

    The other nodes have the weight 0.

    Args:
        sheet: Sheet.
        centre: Centre [m]; x and y are used.
        width: Side [m].

    Raises:
        ValueError: If no node is there. Meshes have nodes at the points they are given.
    """
    distance = np.abs(sheet.nodes[:, :2] - np.asarray(centre, dtype=np.float64)[:2]).max(axis=1)
    within = distance <= 0.5 * width + 1e-9
    if not within.any():
        raise ValueError(
            f"point ({centre[0]:.4g}, {centre[1]:.4g}) m: the next node is {distance.min():.2g} m away, "
            f"allowed {0.5 * width:.2g} m; give the point to the mesh"
        )
    return np.asarray(within / np.count_nonzero(within))


def pressure_weights(sheet: ShellSheet, centre: FloatArray, width: float) -> FloatArray:
    """Return the weights (n,) with sum 1 of a uniform pressure along z on a square seen from above.

    They use the linear shape functions of the triangles, so the effect does not depend on the mesh, unlike
    that of `column_weights`.

    Args:
        sheet: Sheet.
        centre: Centre [m]; x and y are used.
        width: Side [m].

    Raises:
        ValueError: If no triangle is there.
    """
    x, y = np.asarray(centre, dtype=np.float64)[:2]
    half = 0.5 * width
    corners = sheet.nodes[sheet.triangles][:, :, :2]
    is_near = (corners.min(axis=1) < [x + half, y + half]).all(axis=1)
    is_near &= (corners.max(axis=1) > [x - half, y - half]).all(axis=1)
    loaded = np.flatnonzero(is_near)
    square = shapely.box(x - half, y - half, x + half, y + half)
    pieces = shapely.intersection(shapely.polygons(corners[loaded]), square)
    area = shapely.area(pieces)
    loaded, pieces, area = loaded[area > 0.0], pieces[area > 0.0], area[area > 0.0]
    if not len(loaded):
        raise ValueError(f"point ({x:.4g}, {y:.4g}) m: not on the sheet; give a point on it")
    # the integral of a linear function over a piece is its value at the centroid times the area
    middle = shapely.get_coordinates(shapely.centroid(pieces))
    a, b, c = (corners[loaded, k] for k in range(3))
    whole = _plan_cross(b - a, c - a)
    second = _plan_cross(middle - a, c - a) / whole
    third = _plan_cross(b - a, middle - a) / whole
    out = np.zeros(len(sheet.nodes))
    for corner, weight in enumerate((1.0 - second - third, second, third)):
        np.add.at(out, sheet.triangles[loaded, corner], area * weight)
    return out / float(out.sum())


def _plan_cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the cross products (n,) of vectors (n, 2): twice the signed areas of their triangles."""
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


class LimitLoadError(ArithmeticError):
    """No equilibrium was found beyond a load: the sheet snaps through or buckles there.

    Attributes:
        reached: Largest load (3,) [N] that was reached on the way to the requested one.
        requested: Requested load (3,) [N].
        displacements: Displacements (k, 3) [m] under the loads before.
    """

    def __init__(self, reached: FloatArray, requested: FloatArray, displacements: FloatArray) -> None:
        self.reached, self.requested, self.displacements = reached, requested, displacements
        reached_text, requested_text = (
            ", ".join(f"{value:.4g}" for value in load) for load in (reached, requested)
        )
        super().__init__(
            f"no equilibrium was found beyond ({reached_text}) N on the way to a load of ({requested_text}) "
            f"N, in steps down to 1/{2**MAX_CUTS} of it: the sheet snaps through or buckles there, or "
            "exceeds small strains; give a smaller load, loads in between, or a thicker sheet"
        )


@dataclasses.dataclass
class Effort:
    """Computational effort of the solution.

    It counts factorisations, solves, force evaluations, and halvings of load steps.
    """

    factors: int = 0
    solves: int = 0
    forces: int = 0
    cuts: int = 0


def curve(
    sheet: ShellSheet, supports: Supports, centre: FloatArray, loads: FloatArray, width: float = 3e-3
) -> FloatArray:
    """Return the displacements (k, 3) [m] of a point under successive loads from rest.

    The displacement is the mean over the nodes in a square, which is conjugate to the load.

    Args:
        sheet: Sheet.
        supports: Supports.
        centre: Centre of the square [m]; x and y are used.
        loads: Loads (k, 3) [N].
        width: Side of the square [m].

    Raises:
        LimitLoadError: If the sheet snaps through or buckles.
        ValueError: If the supports let the sheet move freely.
    """
    return Loading(sheet, supports).curve(column_weights(sheet, centre, width), loads)


class Loading:
    """A supported sheet for several load cases, with the data that does not depend on the load.

    Args:
        sheet: Sheet.
        supports: Supports.

    Raises:
        ValueError: If the supports let the sheet move freely.
    """

    def __init__(self, sheet: ShellSheet, supports: Supports) -> None:
        _check_supports(sheet, supports)
        self.sheet = sheet
        self.assembly = Assembly(sheet, ~supports.fixed, supports.spring)
        self.effort = Effort()
        message = "supports: got a sheet that can move without forces; add supports"
        try:
            self._rest = self._start(at_rest(sheet))
        except TooFarError:
            raise ValueError(message) from None
        if self._rest.unstable:
            raise ValueError(message)

    def curve(self, weights: FloatArray, loads: FloatArray) -> FloatArray:
        """Return weighted mean displacements (k, 3) [m] under successive loads from rest.

        Args:
            weights: Weights (n,) of the nodes.
            loads: Loads (k, 3) [N].

        Raises:
            LimitLoadError: If the sheet snaps through or buckles.
            ValueError: For invalid loads or weights.
        """
        return np.array([weights @ state.u for state in self.states(weights, loads)]).reshape(-1, 3)

    def states(self, weights: FloatArray, loads: FloatArray) -> list[State]:
        """Return the states (k,) under successive loads from rest.

        Args:
            weights: Weights (n,) of the nodes.
            loads: Loads (k, 3) [N].

        Raises:
            LimitLoadError: If the sheet snaps through or buckles.
            ValueError: For loads or weights that are not finite or have a wrong shape.
        """
        loads = np.asarray(loads, dtype=np.float64)
        count = len(self.sheet.nodes)
        if loads.ndim != 2 or loads.shape[1] != 3 or not np.all(np.isfinite(loads)):
            raise ValueError(
                f"loads: got shape {loads.shape}, or not finite; allowed finite forces (k, 3) [N]"
            )
        if weights.shape != (count,) or not np.all(np.isfinite(weights)):
            raise ValueError(
                f"shares: got shape {weights.shape}, or not finite; allowed one for each of {count} nodes"
            )
        states: list[State] = []
        current_load, current = np.zeros(3), self._rest
        for load in loads:
            fraction, current = self._advance(current, weights, current_load, load)
            if fraction < 1.0:
                displacements = np.array([weights @ state.u for state in states]).reshape(-1, 3)
                raise LimitLoadError(current_load + fraction * (load - current_load), load, displacements)
            current_load = load
            states.append(current.state)
        return states

    def _advance(
        self, at: "_BalancedState", weights: FloatArray, now: FloatArray, load: FloatArray
    ) -> "tuple[float, _BalancedState]":
        """Advance from one load to the next in steps that are halved if they fail.

        Args:
            at: Current state.
            weights: Weights (n,) of the nodes.
            now: Current load (3,) [N].
            load: Next load (3,) [N].

        Returns:
            Fraction (0 to 1) of the load difference that was reached, and the state there.
        """
        done, part = 0.0, 1.0
        while done < 1.0 and part >= 0.5**MAX_CUTS:
            next_state = self._step(at, weights, now + done * (load - now), part * (load - now))
            if next_state is None:
                self.effort.cuts += 1
                part *= 0.5
            else:
                at, done = next_state, done + part
                part = min(part, 1.0 - done)
        return done, at

    def _step(
        self, at: "_BalancedState", weights: FloatArray, base: FloatArray, added: FloatArray
    ) -> "_BalancedState | None":
        """Return the equilibrium with a load ``added`` to ``base`` (3,) [N], or None if none is nearby.

        None is also returned if the sheet snapped through on the way: the result is unstable, or it has moved
        too far or against the load.

        Args:
            at: State in equilibrium with ``base``.
            weights: Weights (n,) of the nodes.
            base: Current load (3,) [N].
            added: Load that is added (3,) [N].
        """
        load = np.zeros((len(weights), 6))
        load[:, :3] = weights[:, None] * (base + added)
        try:
            end = self._find_balance(at, load)
        except TooFarError:
            return None
        if end is None:
            return None
        # A snap-through has moved too far: work p.du > JUMP max(p.K^-1 p) with the tangents K at both ends.
        added_load = np.zeros_like(load)
        added_load[:, :3] = weights[:, None] * added
        p = added_load.reshape(-1)[self.assembly.free]
        work = float(np.sum(added_load[:, :3] * (end.state.u - at.state.u)))
        predicted = [float(dots(p, self._solve(balanced.factors, p))) for balanced in (at, end)]
        if end.unstable or work < 0.0 or work > JUMP * max(predicted) + 1e-15:
            return None
        return end

    def _find_balance(self, at: "_BalancedState", load: FloatArray) -> "_BalancedState | None":
        """Solve for the equilibrium with ``load`` (n, 6) [N, Nm], from ``at``. None if the iteration fails.

        It fails after `MAX_ITERATIONS`. The result has the factorised tangent of its own state.

        Raises:
            TooFarError: If a step is too long.
        """
        free = self.assembly.free
        target = load.reshape(-1)[free]
        state, factors = at.state, at.factors
        residual = target - at.force
        pairs: list[tuple[FloatArray, FloatArray, float]] = []
        last, slow_count = np.inf, 0
        for _ in range(MAX_ITERATIONS):
            # step against the residual r = load - force, until it is small
            step = self._bfgs_step(factors, pairs, residual)
            size = float(np.abs(self._expand(step)[:, :3]).max())
            if size <= TOLERANCE * max(float(np.abs(state.u).max()), MIN_DISPLACEMENT_M):
                return self._start(state.moved(self._expand(step)))
            # a factorisation that no longer contracts is replaced by one of the present state
            slow_count = slow_count + 1 if size > CONTRACTION * last else 0
            last = size
            if slow_count >= 2 or len(pairs) >= MAX_UPDATES:
                restarted = self._start(state)
                factors, pairs = restarted.factors, []
                last, slow_count = np.inf, 0
                residual = target - restarted.force
                continue
            # s = fraction * step, y = change of the forces; s.y > 0 keeps the matrix positive definite
            fraction, state, force = self._line_search(state, step, residual, target)
            change = residual - (target - force)
            taken = fraction * step
            if float(dots(taken, change)) > 0.0:
                pairs.append((taken, change, 1.0 / float(dots(taken, change))))
            residual = target - force
        return None

    def _line_search(
        self, state: State, step: FloatArray, residual: FloatArray, target: FloatArray
    ) -> tuple[float, State, FloatArray]:
        """Search for a fraction of a step after which the residual does little work along the step.

        The full step is taken if the residual still does positive work after it. After `MAX_SEARCHES` trials
        the last fraction is returned.

        Args:
            state: Start of the step.
            step: Step over the free freedoms.
            residual: Residual forces at the start.
            target: Loads over the free freedoms.

        Returns:
            The fraction, and the state and forces there.

        Raises:
            TooFarError: If the step leads away from equilibrium, or no fraction of it is possible.
        """
        # Find f with |g| <= SEARCH_TOLERANCE g(0), g(f) = step.(target - force(f)), or g > 0 at once.
        full_step = self._expand(step)
        start = float(dots(step, residual))
        if start <= 0.0:
            raise TooFarError
        low: tuple[float, float] = (0.0, start)
        high: tuple[float, float] | None = None
        best: tuple[float, State, FloatArray] | None = None
        fraction = 1.0
        for _ in range(MAX_SEARCHES):
            try:
                state_there = state.moved(fraction * full_step)
                force = self._force(state_there)
            except TooFarError:
                fraction = 0.5 * (low[0] + fraction)
                continue
            best = fraction, state_there, force
            work = float(dots(step, target - force))
            if abs(work) <= SEARCH_TOLERANCE * start or (work > 0.0 and high is None):
                break
            if work > 0.0:
                low = (fraction, work)
            else:
                high = (fraction, work)
            if high is not None:
                # forces grow faster than the step, so the secant's root is below the true one
                root = low[0] + (high[0] - low[0]) * low[1] / (low[1] - high[1])
                fraction = max(root, low[0] + MIN_BRACKET_FRACTION * (high[0] - low[0]))
        if best is None:
            raise TooFarError
        return best

    def _bfgs_step(
        self, factors: SuperLU, pairs: list[tuple[FloatArray, FloatArray, float]], residual: FloatArray
    ) -> FloatArray:
        """Return the step against a residual, by a factorisation with BFGS updates (two-loop recursion).

        ``pairs`` are s, y and 1 / y.s of earlier steps s, which changed the forces by y.
        """
        # H = (1 - s y^T / y.s) H' (1 - y s^T / y.s) + s s^T / y.s for each pair, from H' = K^-1; step = H r
        residual = residual.copy()
        weights = []
        for taken, change, inverse in reversed(pairs):
            weight = inverse * float(dots(taken, residual))
            residual -= weight * change
            weights.append(weight)
        step = self._solve(factors, residual)
        for (taken, change, inverse), weight in zip(pairs, reversed(weights), strict=True):
            step += (weight - inverse * float(dots(change, step))) * taken
        return step

    def _start(self, state: State) -> "_BalancedState":
        """Return a state with its forces and the factorised tangent, from which `_find_balance` starts.

        Raises:
            TooFarError: If the tangent is singular.
        """
        force, matrix = self.assembly.tangent(state)
        self.effort.factors += 1
        try:
            factors = splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError:  # exactly singular
            raise TooFarError from None
        # a symmetric factorisation has as many negative pivots as there are unstable directions
        pivots = factors.U.diagonal() / matrix.diagonal()[np.argsort(factors.perm_c)]
        unstable = bool(np.any(factors.perm_r != factors.perm_c) or pivots.min() <= MIN_PIVOT_RATIO)
        return _BalancedState(state, force.reshape(-1)[self.assembly.free], factors, unstable)

    def _solve(self, factors: SuperLU, right_side: FloatArray) -> FloatArray:
        self.effort.solves += 1
        return np.asarray(factors.solve(right_side))

    def _force(self, state: State) -> FloatArray:
        self.effort.forces += 1
        return self.assembly.force(state).reshape(-1)[self.assembly.free]

    def _expand(self, step: FloatArray) -> FloatArray:
        """Return a step over the free freedoms as (n, 6), with 0 for the fixed ones."""
        out = np.zeros(6 * len(self.sheet.nodes))
        out[self.assembly.free] = step
        return out.reshape(-1, 6)


@dataclasses.dataclass(frozen=True)
class _BalancedState:
    """A state and its linearisation.

    Attributes:
        state: State.
        force: Forces over the free freedoms.
        factors: Factorised tangent.
        unstable: Whether the tangent is not positive definite.
    """

    state: State
    force: FloatArray
    factors: SuperLU
    unstable: bool


def _check_supports(sheet: ShellSheet, supports: Supports) -> None:
    """Raise ``ValueError`` if the arrays of supports do not have one row for each node."""
    count = len(sheet.nodes)
    if supports.fixed.shape != (count, 6) or supports.spring.shape != (count, 3):
        raise ValueError(f"supports: got {supports.fixed.shape}, {supports.spring.shape} for {count} nodes")
