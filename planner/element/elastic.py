"""The kind ``elastic``: a free-form surface divided into panels whose faces are cut by a bent wire.

A table states which rectangles of the grid can be panels: the misfit of every section for every wire and both
directions, and the box of the panel in every block. The cheapest guillotine division of the table is exact
(`geometry/guillotine.py`). Then each panel is fitted again in the planes of its own tilted block, front and
back, preferably by a wire that is held safely there. Panels that are out of tolerance there, or that the
check of their own problem refuses, are removed from the table, and the division is repeated.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.element.elastic_panel import ElasticJoint, ElasticPanel, find_joints
from planner.element.joint_followers import FollowedOffset, followed_offset
from planner.element.misfit import (
    MISFIT_STEP_M,
    SECTIONS_PER_CELL,
    compute_misfits,
    required_sections,
    section_positions,
    worst_misfits,
)
from planner.element.panel_box import GridNodes, block_axes, box_sizes, grid_nodes, plane_normals
from planner.element.panel_faces import CutWire, bend_face, cut_out, is_held
from planner.element.surface import ElementSurface, SectionProfiles, cut_profiles
from planner.geometry.arrays import BoolArray, FloatArray, from_parts
from planner.geometry.guillotine import GridDivision, divide_grid
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.geometry.units import MM, Measurement, measurement
from planner.issues import Issue, TandemError, issue_error

FIT_TOLERANCE_M: Final = 1e-6
"""Excess [m] up to which a panel fits its block."""
GOOD_FIT_FRACTION: Final = 0.5
"""Fraction of the tolerance below which a shorter wire is preferred to a smaller misfit."""
_MAX_DIVISIONS = 200
"""Maximum number of divisions, each without the panels that failed in the previous one."""
_MAX_CHECKED_DIVISIONS = 100
"""Maximum number of divisions if panels are checked. Then the first division is kept, with its reasons."""
_MAX_JOINT_IMPROVEMENTS = 20
"""Maximum number of successive improvements of joints."""
_MAX_WORST_JOINTS = 5
"""Number of worst joints whose panels are removed on trial to find a better division."""
_EVEN_STEP_FRACTION = 0.9
"""Fraction of the limit up to which steps count as even: the programs add their own."""
_SIZE_MARGIN_M = 1e-3  # m: added to advised blocks, because a surface bends between nodes
_THICKNESS_STEP_M = 1e-3
"""Step [m] of the search for a feasible thickness."""


@dataclasses.dataclass(frozen=True)
class ElasticRules:
    """Requirements on panels. All lengths are in m.

    Attributes:
        wires: Wires, shortest first.
        blocks: Sizes (3,) of blocks.
        sides: Foam beside a panel, at each side.
        faces: Foam above a panel, and below.
        tolerance: Tolerance of a face.
        end_weight: Weight of the ends of sections in the fit.
        joint: Maximum step between two panels.
    """

    wires: tuple[CutWire, ...]
    blocks: tuple[FloatArray, ...]
    sides: float
    faces: float
    tolerance: float
    end_weight: float
    joint: float = np.inf


PanelCheck = Callable[[ElasticPanel], Issue | None]
"""Returns why the problem of a panel, as it will be written, is refused; None if it is not."""


@dataclasses.dataclass(frozen=True)
class DivisionInput:
    """Input of the division.

    Attributes:
        surface: Surface.
        lines: Grid lines across x (nx + 1,) and y (ny + 1,) [m].
        rules: Requirements.
        profiles: Sections along x and along y.
        nodes: Nodes of the grid.
    """

    surface: ElementSurface
    lines: tuple[FloatArray, FloatArray]
    rules: ElasticRules
    profiles: tuple[SectionProfiles, SectionProfiles]
    nodes: GridNodes

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        return len(self.lines[0]) - 1, len(self.lines[1]) - 1


def prepare_division(surface: ElementSurface, cells: tuple[int, int], rules: ElasticRules) -> DivisionInput:
    """Prepare the input of the division.

    Raises:
        TandemError: ``element.surface``.
    """
    x, y = (np.linspace(0.0, surface.size[i], cells[i] + 1) for i in range(2))
    along = (
        cut_profiles(surface.front, surface.size, 0, section_positions(y)),
        cut_profiles(surface.front, surface.size, 1, section_positions(x)),
    )
    return DivisionInput(surface, (x, y), rules, along, grid_nodes(surface, *cells))


@dataclasses.dataclass(frozen=True)
class FeasibilityTable:
    """Feasibility of rectangles (nx, ny, nx, ny), indexed [w - 1, h - 1, x, y].

    Attributes:
        boxes: (2, ...) whether a block holds the panel with its wire along x and along y.
        misfits: Misfit [m] for each variant, an index over wires and directions (2 wire + along); infinite if
            no block holds it or the wire is too short. Single cells have theirs whatever their boxes.
    """

    boxes: BoolArray
    misfits: tuple[FloatArray, ...]

    def best(self, tolerance: float) -> FloatArray:
        """Return the smallest misfit of each rectangle, infinite if no variant is feasible."""
        limit = tolerance + 0.5 * MISFIT_STEP_M
        best = np.full(self.boxes.shape[1:], np.inf)
        for number, misfit in enumerate(self.misfits):
            better = self.boxes[number % 2] & (misfit <= limit) & (misfit < best)
            best[better] = misfit[better]
        return best

    def variants(self, rectangle: tuple[int, int, int, int], tolerance: float) -> list[int]:
        """Return all feasible variants of one rectangle, the best first.

        Variants well within the tolerance come first, shortest wire first, because a short wire is least
        sensitive to errors of its ends. The others follow by misfit.
        """
        feasible = {
            number: float(misfit[rectangle])
            for number, misfit in enumerate(self.misfits)
            if self.boxes[(number % 2, *rectangle)] and misfit[rectangle] <= tolerance + 0.5 * MISFIT_STEP_M
        }

        def rank(number: int) -> tuple[float, float, int]:
            well = feasible[number] < GOOD_FIT_FRACTION * tolerance
            return (0.0, number // 2, number) if well else (1.0, feasible[number], number)

        return sorted(feasible, key=rank)


def feasibility_table(division_input: DivisionInput, held: bool = False) -> FeasibilityTable:
    """Compute which rectangles a block holds and their misfits.

    Args:
        division_input: Input of the division.
        held: Whether wires that are not held safely in a section are infeasible.
    """
    nx, ny = division_input.cells
    rules = division_input.rules
    boxes = np.zeros((2, nx, ny, nx, ny), dtype=np.bool_)
    small = _small_enough(division_input)
    for along in range(2):
        sizes = box_sizes(division_input.nodes, small, along)
        boxes[along] = np.any([_fits(sizes, block, rules) for block in rules.blocks], axis=0)
    misfit_tables = []
    for cut in rules.wires:
        for along in range(2):
            required = boxes[along].copy()
            required[0, 0] = True
            required = required if along == 0 else required.transpose(1, 0, 3, 2)
            fitted = compute_misfits(
                division_input.profiles[along],
                division_input.lines[along],
                required_sections(required),
                cut,
                rules.end_weight,
                functools.partial(is_held, cut=cut) if held else None,
            )
            worst = worst_misfits(fitted, (ny, nx)[along])
            misfit_tables.append(worst if along == 0 else worst.transpose(1, 0, 3, 2))
    return FeasibilityTable(boxes, tuple(misfit_tables))


def _small_enough(division_input: DivisionInput) -> BoolArray:
    """Return rectangles (nx, ny, nx, ny) in the grid no longer in plan than the diagonal of a block."""
    nx, ny = division_input.cells
    longest = max(float(np.linalg.norm(block)) for block in division_input.rules.blocks)
    w, h, x, y = np.ogrid[1 : nx + 1, 1 : ny + 1, 0:nx, 0:ny]
    step = division_input.surface.size / (nx, ny)
    return np.asarray((x + w <= nx) & (y + h <= ny) & (np.maximum(w * step[0], h * step[1]) <= longest))


def _required_blocks(sizes: FloatArray, rules: ElasticRules) -> FloatArray:
    """Return the blocks (..., 3) that boxes need, the longer side first."""
    flat = np.sort(sizes[..., :2], axis=-1)[..., ::-1] + 2.0 * rules.sides
    return np.concatenate([flat, sizes[..., 2:] + 2.0 * rules.faces], axis=-1)


def _fits(sizes: FloatArray, block: FloatArray, rules: ElasticRules) -> BoolArray:
    longest, shortest = max(block[:2]), min(block[:2])
    return np.asarray(
        (_required_blocks(sizes, rules) <= np.array([longest, shortest, block[2]]) + FIT_TOLERANCE_M).all(
            axis=-1
        )
    )


def divide_elastic(
    division_input: DivisionInput, check: PanelCheck | None = None, held: bool = False
) -> tuple[ElasticPanel, ...]:
    """Compute the panels of the best division, by rows of the grid.

    Panels without which nothing covers the element stay, the smallest ones, with the reason of their refusal.

    Args:
        division_input: Input of the division.
        check: Also removes the panels that it refuses.
        held: Whether panels in which no wire is held safely are removed, as if they were out of tolerance.

    Raises:
        TandemError: ``element.wire``, ``element.tolerance``, ``element.block`` for places that no panel can
            cover, each with the closest remedy.
    """
    # the table is optimistic: panels are fitted only if a division uses them
    held = held or check is not None
    fits = _PanelCache(division_input, feasibility_table(division_input, held), held, check)
    misfit = fits.table.best(division_input.rules.tolerance)
    removed: dict[_RectangleIndex, float] = {}
    for _ in range(_MAX_DIVISIONS if check is None else _MAX_CHECKED_DIVISIONS):
        division = divide_grid(misfit)
        if division is None and not removed and held:
            fits.table = feasibility_table(division_input)
            every = fits.table.best(division_input.rules.tolerance)
            for w, h, x, y in np.argwhere(every < misfit).tolist():
                removed[w, h, x, y] = float(every[w, h, x, y])
        if division is None and not removed:
            raise TandemError(list(_refusals(division_input, fits.table, misfit)))
        if division is None:
            # take the smallest removed panels back, with the reason of their refusal
            min_area = min((w + 1) * (h + 1) for w, h, _, _ in removed)
            for rectangle in [p for p in removed if (p[0] + 1) * (p[1] + 1) == min_area]:
                price, best = (
                    removed.pop(rectangle),
                    _best_held(_panel_variants(division_input, fits.table, rectangle)),
                )
                if best is not None:
                    misfit[rectangle] = price
                    fits.keep(
                        rectangle, best if check is None else dataclasses.replace(best, refused=check(best))
                    )
            continue
        rectangles = _rectangle_indices(division)
        # the check takes longest, so it runs last
        failed = [p for p in rectangles if fits.panel(p) is None] or [
            p for p in rectangles if not fits.passes(p)
        ]
        if not failed:
            return _with_improved_joints(fits, misfit, rectangles)
        for rectangle in failed:
            if held:
                removed[rectangle] = float(misfit[rectangle])
            misfit[rectangle] = np.inf
    if held:
        first = divide_elastic(division_input)
        return first if check is None else tuple(dataclasses.replace(p, refused=check(p)) for p in first)
    what = f"after {_MAX_DIVISIONS} divisions some panels still fail in the planes of their blocks"
    raise issue_error("element.tolerance", what, field="panels.elastic", hint="allow more, or use more cells")


_RectangleIndex = tuple[int, int, int, int]
"""Index of a rectangle in a table: w - 1, h - 1, x, y."""


def _rectangle_indices(division: GridDivision) -> list[_RectangleIndex]:
    return [(x1 - x0 - 1, y1 - y0 - 1, x0, y0) for x0, x1, y0, y1 in division.rectangles.tolist()]


class _PanelCache:
    """Panels by their index in a table, each fitted once.

    A panel uses the first wire and direction within tolerance, and held safely if required; None if there is
    none.
    """

    def __init__(
        self, division_input: DivisionInput, table: FeasibilityTable, held: bool, check: PanelCheck | None
    ) -> None:
        self.division_input, self.table, self.held, self.check = division_input, table, held, check
        self._known: dict[_RectangleIndex, ElasticPanel | None] = {}
        self._tries: dict[_RectangleIndex, Iterator[ElasticPanel]] = {}
        self._passed: set[_RectangleIndex] = set()
        self._following: dict[tuple[_FollowerKey, int, int], ElasticPanel | None] = {}

    def panel(self, rectangle: _RectangleIndex) -> ElasticPanel | None:
        """Return the panel of a rectangle."""
        if rectangle not in self._known:
            tries = _panel_variants(self.division_input, self.table, rectangle)
            if self.held:
                self._tries[rectangle] = (panel for panel in tries if panel.held)
                self._known[rectangle] = next(self._tries[rectangle], None)
            else:
                self._known[rectangle] = _best_held(tries)
        return self._known[rectangle]

    def keep(self, rectangle: _RectangleIndex, panel: ElasticPanel) -> None:
        """Accept a panel unchanged."""
        self._known[rectangle] = panel
        self._passed.add(rectangle)

    def passes(self, rectangle: _RectangleIndex) -> bool:
        """Whether the check accepts one of the wires of a panel. The panel then uses that wire."""
        if rectangle not in self._passed and self.check is not None:
            while (panel := self._known[rectangle]) is not None and not self.accepts(panel):
                self._known[rectangle] = next(self._tries[rectangle], None)
        self._passed.add(rectangle)
        return self._known[rectangle] is not None

    def following_panel(
        self, who: "_FollowerKey", panel: ElasticPanel, leads: tuple[FollowedOffset, ...]
    ) -> ElasticPanel | None:
        """Return a panel that follows neighbours (`_fit_panel`), each fitted once.

        ``who`` identifies it by all panels that it follows.
        """
        known = who, panel.wire, panel.along
        if known not in self._following:
            variant = 2 * panel.wire + panel.along
            self._following[known] = _fit_panel(self.division_input, panel.rectangle, variant, leads)
        return self._following[known]

    def accepts(self, panel: ElasticPanel) -> bool:
        """Whether the check accepts a panel, or there is no check."""
        return self.check is None or self.check(panel) is None

    def panels(self, rectangles: Sequence[_RectangleIndex]) -> tuple[ElasticPanel, ...]:
        """Return the panels of all rectangles that have one."""
        return tuple(panel for rectangle in rectangles if (panel := self.panel(rectangle)) is not None)

    def division(self, price: FloatArray, max_count: int) -> list[_RectangleIndex] | None:
        """Return the best division with all panels within tolerance.

        None if it takes more than ``max_count``.
        """
        price = price.copy()
        for rectangle in [rectangle for rectangle, panel in self._known.items() if panel is None]:
            price[rectangle] = np.inf
        while True:
            division = divide_grid(price)
            if division is None or len(division.rectangles) > max_count:
                return None
            rectangles = _rectangle_indices(division)
            failed = [rectangle for rectangle in rectangles if self.panel(rectangle) is None]
            if not failed:
                return rectangles
            for rectangle in failed:
                price[rectangle] = np.inf


def _with_improved_joints(
    fits: _PanelCache, price: FloatArray, rectangles: list[_RectangleIndex]
) -> tuple[ElasticPanel, ...]:
    """Return the panels of a division at ``price``, improved at their joints.

    Some panels follow a neighbour, or another division with as many panels has fewer joints beyond the limit.
    The deviation of a panel at a joint is known when it is fitted, but the step depends on two panels, so no
    price of a single panel states it. Therefore panels at the worst joints are removed on trial, one at a
    time. The search continues from the best of these divisions until none has fewer joints beyond the limit.
    """
    limit = fits.division_input.rules.joint
    panels = _with_followers(fits, fits.panels(rectangles))
    unevenness = _unevenness(panels, limit)
    for _ in range(_MAX_JOINT_IMPROVEMENTS):
        tried: list[tuple[tuple[int, int], int, FloatArray, list[_RectangleIndex]]] = []
        for k in dict.fromkeys(k for joint in _worst_joints(panels, limit) for k in joint.panels):
            without = price.copy()
            without[rectangles[k]] = np.inf
            other_rectangles = fits.division(without, len(rectangles))
            if other_rectangles is not None:
                uneven = _unevenness(_with_followers(fits, fits.panels(other_rectangles)), limit)
                tried.append((uneven, len(tried), without, other_rectangles))
        for uneven, _, without, other_rectangles in sorted(tried, key=lambda trial: trial[:2]):
            if uneven[0] >= unevenness[0]:
                return panels
            if not all(fits.passes(rectangle) for rectangle in other_rectangles):
                continue
            followed = _with_followers(fits, fits.panels(other_rectangles))
            if _unevenness(followed, limit) <= uneven:
                unevenness, price, rectangles, panels = uneven, without, other_rectangles, followed
                break
        else:
            return panels
    return panels


def _worst_joints(panels: Sequence[ElasticPanel], limit: float) -> list[ElasticJoint]:
    """Return the worst joints beyond the limit, worst first."""
    over = sorted(
        (joint for joint in find_joints(panels) if joint.step > limit), key=lambda joint: -joint.step
    )
    return over[:_MAX_WORST_JOINTS]


def _with_followers(fits: _PanelCache, panels: tuple[ElasticPanel, ...]) -> tuple[ElasticPanel, ...]:
    """Let one panel at a joint beyond the limit follow the other (`follow`), while that improves the joints.

    The worst joint where it helps is treated first, on the side where it helps more.
    """
    limit = fits.division_input.rules.joint
    following: list[_FollowerKey] = [(panel.rectangle, ()) for panel in panels]
    leads: dict[int, dict[int, FollowedOffset]] = {}
    unevenness = _unevenness(panels, limit)
    for _ in range(_MAX_JOINT_IMPROVEMENTS):
        for joint in _worst_joints(panels, limit):
            best: tuple[tuple[int, int], int, int, FollowedOffset, tuple[ElasticPanel, ...]] | None = None
            for k, index in enumerate(joint.panels):
                other = joint.panels[1 - k]
                more = followed_offset(joint, 1 - k, panels[other])
                who = _follower_key(following, index, other)
                panel = fits.following_panel(
                    who, panels[index], tuple({**leads.get(index, {}), other: more}.values())
                )
                if panel is None or panel.held < panels[index].held:
                    continue
                changed = (*panels[:index], panel, *panels[index + 1 :])
                uneven = _unevenness(changed, limit)
                if uneven < (unevenness if best is None else best[0]) and fits.accepts(panel):
                    best = uneven, index, other, more, changed
            if best is not None:
                unevenness, index, other, more, panels = best
                following[index] = _follower_key(following, index, other)
                leads.setdefault(index, {})[other] = more
                break
        else:
            return panels
    return panels


_FollowerKey = tuple[tuple[int, int, int, int], tuple[object, ...]]
"""Rectangle of a panel, and the keys of the panels that it follows, in order."""


def _follower_key(following: Sequence[_FollowerKey], index: int, other: int) -> _FollowerKey:
    """Return the key of a panel that additionally follows the current state of another one."""
    rectangle, others = following[index]
    kept = [who for who in others if isinstance(who, tuple) and who[0] != following[other][0]]
    return rectangle, (*kept, following[other])


def _unevenness(panels: Sequence[ElasticPanel], limit: float) -> tuple[int, int]:
    """Return the number of joints beyond the limit, and the sum of steps above what counts as even.

    The sum is in misfit steps. Both are zero without a limit.
    """
    if not np.isfinite(limit):
        return 0, 0
    steps = [joint.step for joint in find_joints(panels)]
    return sum(step > limit for step in steps), sum(
        max(0, round((step - _EVEN_STEP_FRACTION * limit) / MISFIT_STEP_M)) for step in steps
    )


def _panel_variants(
    division_input: DivisionInput, table: FeasibilityTable, rectangle: _RectangleIndex
) -> Iterator[ElasticPanel]:
    """Yield the panel by each wire and direction that is within tolerance in its block."""
    w, h, x, y = rectangle
    for variant in table.variants(rectangle, division_input.rules.tolerance):
        panel = _fit_panel(division_input, (x, x + w + 1, y, y + h + 1), variant)
        if panel is not None:
            yield panel


def _best_held(panels: Iterator[ElasticPanel]) -> ElasticPanel | None:
    """Return the first panel whose wire is held safely, else the first panel."""
    best = None
    for panel in panels:
        if panel.held:
            return panel
        best = best or panel
    return best


def _fit_panel(
    division_input: DivisionInput,
    rectangle: tuple[int, int, int, int],
    variant: int,
    leads: Sequence[FollowedOffset] = (),
) -> ElasticPanel | None:
    """Fit a panel in its block, with its faces offset at joints by ``leads``.

    None if a face deviates from the wire, or then from the surface, by more than the tolerance, or no block
    holds it.
    """
    number, along = divmod(variant, 2)
    cut, rules = division_input.rules.wires[number], division_input.rules
    x0, x1, y0, y1 = rectangle
    x, y = division_input.lines
    bounds = float(x[x0]), float(x[x1]), float(y[y0]), float(y[y1])
    front, back = cut_out(division_input.surface.front, division_input.surface.back, bounds)
    axes = block_axes(plane_normals(division_input.nodes.under(rectangle)), along)
    cloud = np.concatenate([front.vertices, back.vertices]) @ axes.T
    box = np.ptp(cloud, axis=0)
    blocks = [i for i, block in enumerate(rules.blocks) if _fits(box, block, rules)]
    if not blocks:
        return None
    best = min(blocks, key=lambda i: (float(np.prod(rules.blocks[i])), i))
    size = box + 2.0 * np.array([rules.sides, rules.sides, rules.faces])
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    origin = middle - np.array([0.0, 0.0, 0.5 * size[2]])
    pose = from_parts(axes.T, axes.T @ origin)
    flat = front.vertices[:, :2]
    offsets = sum((lead.offset_at(flat) for lead in leads), np.zeros((2, len(flat))))
    made_faces, deviations, misfit, held = [], [], 0.0, True
    for mesh, out in zip((front, back), offsets, strict=True):
        rise = out / np.abs(vertex_normals(mesh)[:, 2]) if leads else out  # along z, in which faces are moved
        block_mesh = TriangleMesh(mesh.vertices @ axes.T - origin + rise[:, None] * axes[:, 2], mesh.faces)
        bent = bend_face(block_mesh, axes[:, 2], cut, 0.5 * float(size[0]), rules.end_weight)
        if bent is None:
            return None
        whole = bent.deviation + out
        # sections are finer than vertices
        max_deviation = bent.misfit + float(np.abs(whole).max() - np.abs(bent.deviation).max())
        if max(max_deviation, bent.misfit) > rules.tolerance + 0.5 * MISFIT_STEP_M:
            return None
        moved = block_mesh.vertices + bent.shift[:, None] * axes[:, 2]
        made_faces.append(TriangleMesh(moved, block_mesh.faces))
        deviations.append(whole)
        misfit, held = max(misfit, max_deviation), held and bent.held
    rim = np.any(
        [flat[:, 0] == bounds[0], flat[:, 0] == bounds[1], flat[:, 1] == bounds[2], flat[:, 1] == bounds[3]],
        axis=0,
    )
    back_mesh = TriangleMesh(made_faces[1].vertices, made_faces[1].faces[:, ::-1])
    return ElasticPanel(
        rectangle,
        along,
        number,
        best,
        pose,
        size,
        made_faces[0],
        back_mesh,
        misfit,
        held,
        flat[rim],
        np.stack(deviations)[:, rim],
    )


def _refusals(division_input: DivisionInput, table: FeasibilityTable, misfit: FloatArray) -> Iterator[Issue]:
    """Yield why cells cannot even be single panels: one issue per cause, for the worst cell."""
    rules, (nx, ny) = division_input.rules, division_input.cells
    single = [np.asarray(item[0, 0]) for item in table.misfits]
    min_misfit = np.min(single, axis=0)
    alone = ~np.isfinite(misfit[0, 0])
    is_short = alone & ~np.isfinite(min_misfit)
    is_far = alone & ~is_short & (min_misfit > rules.tolerance + 0.5 * MISFIT_STEP_M)
    if is_short.any():
        needs = np.stack([_longest_sections(division_input, along) for along in range(2)]).min(axis=0)
        at = np.unravel_index(int(np.argmax(np.where(is_short, needs, -1.0))), is_short.shape)
        need = float(needs[at]) + min(cut.outside for cut in rules.wires)
        longest = max(cut.length for cut in rules.wires)
        what = (
            f"{_cell_text(division_input, at)}: its sections and the wire's free ends need {need / MM:.0f} "
            f"mm, the longest wire is {longest / MM:.0f} mm"
        )
        hint = f"give a wire of {np.ceil(need / MM / 5.0) * 5.0:.0f} mm, or more cells than {nx} x {ny}"
        measure = measurement(longest / MM, need / MM, "mm")
        yield _cell_issue("element.wire", what, "panels.elastic.wires", measure, hint, is_short)
    if is_far.any():
        at = np.unravel_index(int(np.argmax(np.where(is_far, min_misfit, -1.0))), is_far.shape)
        worst = float(min_misfit[at])
        what = (
            f"{_cell_text(division_input, at)}: the best wire is {worst / MM:.2f} mm off the surface, "
            f"allowed {rules.tolerance / MM:g} mm"
        )
        hint = (
            f"allow tolerance_mm: {np.ceil(worst / MM * 100.0) / 100.0 + 0.01:.2f}, give more cells than "
            f"{nx} x {ny}, or smooth the surface if it is noisy"
        )
        measure = measurement(worst / MM, rules.tolerance / MM, "mm")
        yield _cell_issue("element.tolerance", what, "panels.elastic.tolerance_mm", measure, hint, is_far)
    is_large = alone & ~is_short & ~is_far & ~table.boxes[:, 0, 0].any(axis=0)
    if is_large.any():
        yield _too_large(division_input, is_large)
    left = alone & ~is_short & ~is_far & ~is_large
    if left.any() and not (is_short | is_far | is_large).any():
        at = np.unravel_index(int(np.argmax(left)), left.shape)
        what = (
            f"{_cell_text(division_input, at)}: it is at the limit of its block or of the tolerance, and "
            "exceeds it "
        )
        what += "when measured on its facets"
        hint = f"allow 0.1 mm more of tolerance_mm, 1 mm more of blocks, or more cells than {nx} x {ny}"
        measure = measurement(rules.tolerance / MM, rules.tolerance / MM, "mm")
        yield _cell_issue("element.tolerance", what, "panels.elastic", measure, hint, left)


def _cell_issue(code: str, what: str, field: str, measure: Measurement, hint: str, cells: BoolArray) -> Issue:
    """Create ``element.*`` for cells that cannot be panels, of which ``what`` names the worst."""
    return Issue(
        code,
        f"{int(cells.sum())} of the cells cannot be panels even alone, the worst is {what}",
        field=field,
        **measure,
        hint=hint,
    )


def _cell_text(division_input: DivisionInput, at: tuple[np.intp, ...]) -> str:
    range_text = " x ".join(
        f"{division_input.lines[i][at[i]] / MM:.0f} to {division_input.lines[i][at[i] + 1] / MM:.0f}"
        for i in range(2)
    )
    return f"the cell {at[0] + 1}, {at[1] + 1} ({range_text} mm)"


def _longest_sections(division_input: DivisionInput, along: int) -> FloatArray:
    """Return the length [m] of the longest section along an axis in each cell (nx, ny)."""
    profile, lines = division_input.profiles[along], division_input.lines[along]
    arc = np.stack(
        [
            np.diff(np.interp(lines, position, length))
            for position, length in zip(profile.position, profile.length, strict=True)
        ]
    )
    parts = SECTIONS_PER_CELL
    longest = np.max([arc[i : len(arc) - parts + i : parts] for i in range(parts + 1)], axis=0)
    return np.asarray(longest.T if along == 0 else longest)


def _too_large(division_input: DivisionInput, cells: BoolArray) -> Issue:
    """Create the issue of cells that no block holds, with a sufficient block and thickness."""
    rules = division_input.rules

    def needed(nodes: GridNodes) -> FloatArray:
        only = np.zeros((*division_input.cells, *division_input.cells), dtype=np.bool_)
        only[0, 0] = cells
        return np.stack([_required_blocks(box_sizes(nodes, only, along)[0, 0], rules) for along in range(2)])

    def excess(sizes: FloatArray) -> FloatArray:
        limits = np.array([[max(b[:2]), min(b[:2]), b[2]] for b in rules.blocks])
        over = (sizes[:, None] - limits[:, None, None]).max(axis=-1)  # (2, blocks, nx, ny)
        return np.asarray(np.where(cells, over.min(axis=(0, 1)), -np.inf))

    sizes = needed(division_input.nodes)
    over = excess(sizes)
    at = np.unravel_index(int(np.argmax(over)), over.shape)
    direction = np.argmin(sizes.max(axis=-1), axis=0)[None, ..., None]
    size = np.take_along_axis(sizes, direction, axis=0)[0][cells].max(axis=0)  # large enough for all of them
    worst = float(over[at])
    text = " x ".join(f"{np.ceil((v + _SIZE_MARGIN_M) / MM):.0f}" for v in size)
    thickness = None
    for thin in np.arange(division_input.surface.thickness - _THICKNESS_STEP_M, 0.0, -_THICKNESS_STEP_M):
        back = division_input.nodes.front + (division_input.nodes.back - division_input.nodes.front) * (
            thin / division_input.surface.thickness
        )
        if (excess(needed(dataclasses.replace(division_input.nodes, back=back))) <= -_SIZE_MARGIN_M).all():
            thickness = float(thin)
            break
    fits = f"thickness_mm: {np.floor(thickness / MM + 1e-6):.0f} would fit, " if thickness is not None else ""
    what = (
        f"{_cell_text(division_input, at)}: with foam around it, it exceeds all blocks by {worst / MM:.1f} mm"
    )
    hint = (
        f"{fits}a block of {text} mm would fit, or give more cells than {division_input.cells[0]} x "
        f"{division_input.cells[1]}"
    )
    largest = max(rules.blocks, key=lambda block: float(np.prod(block)))
    measure = measurement(float(size[2]) / MM, float(largest[2]) / MM, "mm")
    return _cell_issue("element.block", what, "blocks", measure, hint, cells)
