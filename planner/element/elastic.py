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
"""Fraction of the limit up to which a step counts as even. The rest is left to the errors of the programs."""
_SIZE_MARGIN_M = 1e-3  # m: added to advised blocks, because a surface bends between nodes
_THICKNESS_STEP_M = 1e-3
"""Step [m] of the search for a feasible thickness."""


@dataclasses.dataclass(frozen=True)
class ElasticRules:
    """Requirements on panels. All lengths are in m.

    Attributes:
        wires: Wires, shortest first.
        blocks: Length, width and thickness (3,) of each kind of block.
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
"""Function that returns why the problem of a panel, as it will be written, is refused; None if accepted."""


@dataclasses.dataclass(frozen=True)
class DivisionInput:
    """Input of the division.

    Attributes:
        surface: Surface.
        lines: Grid lines across x (nx + 1,) and y (ny + 1,) [m].
        rules: Requirements.
        profiles: Sections of the front along x and along y.
        nodes: Points of front and back at the nodes of the grid.
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
    """Prepare the input of the division: sections and nodes of a surface with ``cells`` along x and y.

    Raises:
        TandemError: ``element.surface`` if a section of the surface has several pieces or runs back.
    """
    x, y = (np.linspace(0.0, surface.size[i], cells[i] + 1) for i in range(2))
    profiles = (
        cut_profiles(surface.front, surface.size, 0, section_positions(y)),
        cut_profiles(surface.front, surface.size, 1, section_positions(x)),
    )
    return DivisionInput(surface, (x, y), rules, profiles, grid_nodes(surface, *cells))


@dataclasses.dataclass(frozen=True)
class FeasibilityTable:
    """Feasibility of rectangles (nx, ny, nx, ny), indexed [w - 1, h - 1, x, y].

    Attributes:
        boxes: (2, nx, ny, nx, ny) whether a block holds the panel with its wire along x, and along y.
        misfits: Table of misfits [m] for each variant, the index 2 * wire + along of a wire and a direction.
            Infinite if no block holds the panel or the wire is too short. Single cells have a misfit even if
            no block holds them, so that a refusal can state it.
    """

    boxes: BoolArray
    misfits: tuple[FloatArray, ...]

    def best(self, tolerance: float) -> FloatArray:
        """Return the smallest misfit [m] of each rectangle; infinite if no variant is feasible."""
        limit = tolerance + 0.5 * MISFIT_STEP_M
        best = np.full(self.boxes.shape[1:], np.inf)
        for number, misfit in enumerate(self.misfits):
            better = self.boxes[number % 2] & (misfit <= limit) & (misfit < best)
            best[better] = misfit[better]
        return best

    def variants(self, rectangle: tuple[int, int, int, int], tolerance: float) -> list[int]:
        """Return all feasible variants of the rectangle at an index of the table, the best first.

        Variants well within the tolerance come first, shortest wire first, because a short wire is least
        sensitive to errors of its ends. The others follow by misfit.
        """
        feasible = {
            number: float(misfit[rectangle])
            for number, misfit in enumerate(self.misfits)
            if self.boxes[(number % 2, *rectangle)] and misfit[rectangle] <= tolerance + 0.5 * MISFIT_STEP_M
        }

        def rank(number: int) -> tuple[float, float, int]:
            is_good = feasible[number] < GOOD_FIT_FRACTION * tolerance
            return (0.0, number // 2, number) if is_good else (1.0, feasible[number], number)

        return sorted(feasible, key=rank)


def feasibility_table(division_input: DivisionInput, held: bool = False) -> FeasibilityTable:
    """Compute which rectangles fit a block, and their misfits for each wire and direction.

    Args:
        division_input: Input of the division.
        held: Whether wires that are not held safely in a section are infeasible.
    """
    nx, ny = division_input.cells
    rules = division_input.rules
    boxes = np.zeros((2, nx, ny, nx, ny), dtype=np.bool_)
    is_small = _small_enough(division_input)
    for along in range(2):
        sizes = box_sizes(division_input.nodes, is_small, along)
        boxes[along] = np.any([_fits(sizes, block, rules) for block in rules.blocks], axis=0)
    misfit_tables = []
    for cut in rules.wires:
        for along in range(2):
            required = boxes[along].copy()
            required[0, 0] = True  # misfits of single cells explain refusals
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
    """Return which rectangles (nx, ny, nx, ny) are in the grid and no longer than a block's diagonal."""
    nx, ny = division_input.cells
    longest = max(float(np.linalg.norm(block)) for block in division_input.rules.blocks)
    w, h, x, y = np.ogrid[1 : nx + 1, 1 : ny + 1, 0:nx, 0:ny]
    step = division_input.surface.size / (nx, ny)
    return np.asarray((x + w <= nx) & (y + h <= ny) & (np.maximum(w * step[0], h * step[1]) <= longest))


def _required_blocks(sizes: FloatArray, rules: ElasticRules) -> FloatArray:
    """Return the size (..., 3) [m] of the block that boxes (..., 3) need with foam, the longer side first."""
    flat = np.sort(sizes[..., :2], axis=-1)[..., ::-1] + 2.0 * rules.sides
    return np.concatenate([flat, sizes[..., 2:] + 2.0 * rules.faces], axis=-1)


def _fits(sizes: FloatArray, block: FloatArray, rules: ElasticRules) -> BoolArray:
    """Return whether boxes (..., 3) fit a block (3,) with foam around them."""
    longest, shortest = max(block[:2]), min(block[:2])
    return np.asarray(
        (_required_blocks(sizes, rules) <= np.array([longest, shortest, block[2]]) + FIT_TOLERANCE_M).all(
            axis=-1
        )
    )


def divide_elastic(
    division_input: DivisionInput, check: PanelCheck | None = None, held: bool = False
) -> tuple[ElasticPanel, ...]:
    """Compute the panels of the best division, ordered by rows of the grid.

    If no division is left without panels that were removed, the smallest of them are taken back, each with
    the reason of its refusal.

    Args:
        division_input: Input of the division.
        check: If given, panels that it refuses are removed as well.
        held: Whether panels in which no wire is held safely are removed, as if they were out of tolerance.

    Raises:
        TandemError: ``element.wire``, ``element.tolerance``, ``element.block`` for places that no panel can
            cover, each with the closest remedy.
    """
    # the table is optimistic: panels are fitted only if a division uses them
    held = held or check is not None
    cache = _PanelCache(division_input, feasibility_table(division_input, held), held, check)
    misfit = cache.table.best(division_input.rules.tolerance)
    removed: dict[_RectangleIndex, float] = {}
    for _ in range(_MAX_DIVISIONS if check is None else _MAX_CHECKED_DIVISIONS):
        division = divide_grid(misfit)
        if division is None and not removed and held:
            # the table excludes wires that are not held: admit them as if they were removed before
            cache.table = feasibility_table(division_input)
            unheld_misfit = cache.table.best(division_input.rules.tolerance)
            for w, h, x, y in np.argwhere(unheld_misfit < misfit).tolist():
                removed[w, h, x, y] = float(unheld_misfit[w, h, x, y])
        if division is None and not removed:
            raise TandemError(list(_refusals(division_input, cache.table, misfit)))
        if division is None:
            # take the smallest removed panels back, with the reason of their refusal
            min_area = min((w + 1) * (h + 1) for w, h, _, _ in removed)
            for rectangle in [p for p in removed if (p[0] + 1) * (p[1] + 1) == min_area]:
                removed_misfit = removed.pop(rectangle)
                best = _best_held(_panel_variants(division_input, cache.table, rectangle))
                if best is not None:
                    misfit[rectangle] = removed_misfit
                    cache.keep(
                        rectangle, best if check is None else dataclasses.replace(best, refused=check(best))
                    )
            continue
        rectangles = _rectangle_indices(division)
        # the check takes longest, so it runs last
        failed = [p for p in rectangles if cache.panel(p) is None] or [
            p for p in rectangles if not cache.passes(p)
        ]
        if not failed:
            return _with_improved_joints(cache, misfit, rectangles)
        for rectangle in failed:
            if held:
                removed[rectangle] = float(misfit[rectangle])
            misfit[rectangle] = np.inf
    if held:
        # too many divisions: keep the first one within tolerance, with the reasons why its panels are refused
        panels = divide_elastic(division_input)
        return panels if check is None else tuple(dataclasses.replace(p, refused=check(p)) for p in panels)
    text = f"after {_MAX_DIVISIONS} divisions some panels still fail in the planes of their blocks"
    raise issue_error("element.tolerance", text, field="panels.elastic", hint="allow more, or use more cells")


_RectangleIndex = tuple[int, int, int, int]
"""Index of a rectangle in a table: w - 1, h - 1, x, y."""


def _rectangle_indices(division: GridDivision) -> list[_RectangleIndex]:
    """Return the index in a table of each rectangle of a division."""
    return [(x1 - x0 - 1, y1 - y0 - 1, x0, y0) for x0, x1, y0, y1 in division.rectangles.tolist()]


class _PanelCache:
    """Panels by their index in a table, each fitted once.

    A panel uses the first wire and direction within tolerance, and held safely if required. It is None if
    there is no such wire.
    """

    def __init__(
        self, division_input: DivisionInput, table: FeasibilityTable, held: bool, check: PanelCheck | None
    ) -> None:
        self.division_input = division_input
        self.table = table
        self.held = held
        self.check = check
        self._panels: dict[_RectangleIndex, ElasticPanel | None] = {}
        self._remaining_variants: dict[_RectangleIndex, Iterator[ElasticPanel]] = {}
        self._passed: set[_RectangleIndex] = set()
        self._followers: dict[tuple[_FollowerKey, int, int], ElasticPanel | None] = {}

    def panel(self, rectangle: _RectangleIndex) -> ElasticPanel | None:
        """Return the panel of a rectangle; None if no wire makes it."""
        if rectangle not in self._panels:
            variants = _panel_variants(self.division_input, self.table, rectangle)
            if self.held:
                self._remaining_variants[rectangle] = (panel for panel in variants if panel.held)
                self._panels[rectangle] = next(self._remaining_variants[rectangle], None)
            else:
                self._panels[rectangle] = _best_held(variants)
        return self._panels[rectangle]

    def keep(self, rectangle: _RectangleIndex, panel: ElasticPanel) -> None:
        """Use this panel for a rectangle without a check."""
        self._panels[rectangle] = panel
        self._passed.add(rectangle)

    def passes(self, rectangle: _RectangleIndex) -> bool:
        """Whether the check accepts the result of `panel` with any wire. The panel then uses that wire."""
        if rectangle not in self._passed and self.check is not None:
            while (panel := self._panels[rectangle]) is not None and not self.accepts(panel):
                self._panels[rectangle] = next(self._remaining_variants[rectangle], None)
        self._passed.add(rectangle)
        return self._panels[rectangle] is not None

    def following_panel(
        self, key: "_FollowerKey", panel: ElasticPanel, leads: tuple[FollowedOffset, ...]
    ) -> ElasticPanel | None:
        """Return ``panel`` fitted again with ``leads``, the offsets of the neighbours that it follows.

        ``key`` identifies the result by all panels that it follows. Each key, wire and direction is fitted
        once.
        """
        fit_key = key, panel.wire, panel.along
        if fit_key not in self._followers:
            variant = 2 * panel.wire + panel.along
            self._followers[fit_key] = _fit_panel(self.division_input, panel.rectangle, variant, leads)
        return self._followers[fit_key]

    def accepts(self, panel: ElasticPanel) -> bool:
        """Whether the check accepts a panel, or there is no check."""
        return self.check is None or self.check(panel) is None

    def panels(self, rectangles: Sequence[_RectangleIndex]) -> tuple[ElasticPanel, ...]:
        """Return the panels of all rectangles that have one."""
        return tuple(panel for rectangle in rectangles if (panel := self.panel(rectangle)) is not None)

    def division(self, price: FloatArray, max_count: int) -> list[_RectangleIndex] | None:
        """Return the best division at ``price`` whose panels are all within tolerance.

        None if it takes more than ``max_count`` panels.
        """
        price = price.copy()
        for rectangle in [rectangle for rectangle, panel in self._panels.items() if panel is None]:
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
    cache: _PanelCache, price: FloatArray, rectangles: list[_RectangleIndex]
) -> tuple[ElasticPanel, ...]:
    """Return the panels of a division, or of a better one, improved at their joints.

    Some panels follow a neighbour. Another division at ``price`` with as many panels is used if fewer of its
    joints are beyond the limit.
    The deviation of a panel at a joint is known when it is fitted, but the step depends on two panels, so no
    price of a single panel states it. Therefore panels at the worst joints are removed on trial, one at a
    time. The search continues from the best of these divisions until none has fewer joints beyond the limit.
    """
    limit = cache.division_input.rules.joint
    panels = _with_followers(cache, cache.panels(rectangles))
    unevenness = _unevenness(panels, limit)
    for _ in range(_MAX_JOINT_IMPROVEMENTS):
        trials: list[tuple[tuple[int, int], int, FloatArray, list[_RectangleIndex]]] = []
        for k in dict.fromkeys(k for joint in _worst_joints(panels, limit) for k in joint.panels):
            without = price.copy()
            without[rectangles[k]] = np.inf
            other_rectangles = cache.division(without, len(rectangles))
            if other_rectangles is not None:
                uneven = _unevenness(_with_followers(cache, cache.panels(other_rectangles)), limit)
                trials.append((uneven, len(trials), without, other_rectangles))
        for uneven, _, without, other_rectangles in sorted(trials, key=lambda trial: trial[:2]):
            if uneven[0] >= unevenness[0]:
                return panels
            if not all(cache.passes(rectangle) for rectangle in other_rectangles):
                continue
            followed = _with_followers(cache, cache.panels(other_rectangles))
            if _unevenness(followed, limit) <= uneven:
                unevenness, price, rectangles, panels = uneven, without, other_rectangles, followed
                break
        else:
            return panels
    return panels


def _worst_joints(panels: Sequence[ElasticPanel], limit: float) -> list[ElasticJoint]:
    """Return the `_MAX_WORST_JOINTS` largest joints whose step exceeds the limit [m], largest first."""
    over = sorted(
        (joint for joint in find_joints(panels) if joint.step > limit), key=lambda joint: -joint.step
    )
    return over[:_MAX_WORST_JOINTS]


def _with_followers(cache: _PanelCache, panels: tuple[ElasticPanel, ...]) -> tuple[ElasticPanel, ...]:
    """Let one panel at a joint beyond the limit follow the other, while that improves the joints.

    The worst joint where it helps is treated first, on the side where it helps more.
    """
    limit = cache.division_input.rules.joint
    following: list[_FollowerKey] = [(panel.rectangle, ()) for panel in panels]
    leads: dict[int, dict[int, FollowedOffset]] = {}
    unevenness = _unevenness(panels, limit)
    for _ in range(_MAX_JOINT_IMPROVEMENTS):
        for joint in _worst_joints(panels, limit):
            best: tuple[tuple[int, int], int, int, FollowedOffset, tuple[ElasticPanel, ...]] | None = None
            for k, index in enumerate(joint.panels):
                other = joint.panels[1 - k]
                offset = followed_offset(joint, 1 - k, panels[other])
                key = _follower_key(following, index, other)
                panel = cache.following_panel(
                    key, panels[index], tuple({**leads.get(index, {}), other: offset}.values())
                )
                if panel is None or panel.held < panels[index].held:
                    continue
                changed = (*panels[:index], panel, *panels[index + 1 :])
                uneven = _unevenness(changed, limit)
                if uneven < (unevenness if best is None else best[0]) and cache.accepts(panel):
                    best = uneven, index, other, offset, changed
            if best is not None:
                unevenness, index, other, offset, panels = best
                following[index] = _follower_key(following, index, other)
                leads.setdefault(index, {})[other] = offset
                break
        else:
            return panels
    return panels


_FollowerKey = tuple[tuple[int, int, int, int], tuple[object, ...]]
"""Cells (x0, x1, y0, y1) of a panel, and the keys of the panels that it follows, in order."""


def _follower_key(following: Sequence[_FollowerKey], index: int, other: int) -> _FollowerKey:
    """Return the key of the panel ``index`` if it additionally follows the panel ``other`` as that is now."""
    rectangle, others = following[index]
    kept = [key for key in others if isinstance(key, tuple) and key[0] != following[other][0]]
    return rectangle, (*kept, following[other])


def _unevenness(panels: Sequence[ElasticPanel], limit: float) -> tuple[int, int]:
    """Return the number of joints beyond the limit [m], and the sum of their excess over what counts as even.

    The sum covers all joints, in units of `MISFIT_STEP_M`. Both values are zero without a limit.
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
    """Yield the panel of a rectangle for each wire and direction with which it is within tolerance."""
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
    cells: tuple[int, int, int, int],
    variant: int,
    leads: Sequence[FollowedOffset] = (),
) -> ElasticPanel | None:
    """Fit a panel in its block, with its faces offset at joints by ``leads``.

    Args:
        division_input: Input of the division.
        cells: Cells (x0, x1, y0, y1) of the panel.
        variant: Index 2 * wire + along of its wire and direction.
        leads: Offsets of the neighbours that it follows.

    Returns:
        The panel; None if a face deviates from the wire or from the surface by more than the tolerance, or no
            block holds it.
    """
    number, along = divmod(variant, 2)
    cut, rules = division_input.rules.wires[number], division_input.rules
    x0, x1, y0, y1 = cells
    x, y = division_input.lines
    bounds = float(x[x0]), float(x[x1]), float(y[y0]), float(y[y1])
    front, back = cut_out(division_input.surface.front, division_input.surface.back, bounds)
    axes = block_axes(plane_normals(division_input.nodes.under(cells)), along)
    cloud = np.concatenate([front.vertices, back.vertices]) @ axes.T
    box = np.ptp(cloud, axis=0)
    blocks = [i for i, block in enumerate(rules.blocks) if _fits(box, block, rules)]
    if not blocks:
        return None
    block_index = min(blocks, key=lambda i: (float(np.prod(rules.blocks[i])), i))
    size = box + 2.0 * np.array([rules.sides, rules.sides, rules.faces])
    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    origin = middle - np.array([0.0, 0.0, 0.5 * size[2]])
    pose = from_parts(axes.T, axes.T @ origin)
    flat = front.vertices[:, :2]
    offsets = sum((lead.offset_at(flat) for lead in leads), np.zeros((2, len(flat))))
    cut_faces, deviations, misfit, held = [], [], 0.0, True
    for mesh, offset in zip((front, back), offsets, strict=True):
        # faces are moved along z, so an offset across the surface is divided by the normal's z
        rise = offset / np.abs(vertex_normals(mesh)[:, 2]) if leads else offset
        block_mesh = TriangleMesh(mesh.vertices @ axes.T - origin + rise[:, None] * axes[:, 2], mesh.faces)
        bent = bend_face(block_mesh, axes[:, 2], cut, 0.5 * float(size[0]), rules.end_weight)
        if bent is None:
            return None
        deviation = bent.deviation + offset
        # the misfit is measured on sections, which are finer than vertices: add what the offset adds
        max_deviation = bent.misfit + float(np.abs(deviation).max() - np.abs(bent.deviation).max())
        if max(max_deviation, bent.misfit) > rules.tolerance + 0.5 * MISFIT_STEP_M:
            return None
        moved = block_mesh.vertices + bent.shift[:, None] * axes[:, 2]
        cut_faces.append(TriangleMesh(moved, block_mesh.faces))
        deviations.append(deviation)
        misfit, held = max(misfit, max_deviation), held and bent.held
    rim = np.any(
        [flat[:, 0] == bounds[0], flat[:, 0] == bounds[1], flat[:, 1] == bounds[2], flat[:, 1] == bounds[3]],
        axis=0,
    )
    back_mesh = TriangleMesh(cut_faces[1].vertices, cut_faces[1].faces[:, ::-1])
    return ElasticPanel(
        cells,
        along,
        number,
        block_index,
        pose,
        size,
        cut_faces[0],
        back_mesh,
        misfit,
        held,
        flat[rim],
        np.stack(deviations)[:, rim],
    )


def _refusals(division_input: DivisionInput, table: FeasibilityTable, misfit: FloatArray) -> Iterator[Issue]:
    """Yield why some cells cannot be panels even alone: one issue per cause, which names the worst cell.

    ``misfit`` (nx, ny, nx, ny) [m] are the misfits with which no division was found.
    """
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
        worst = (
            f"{_cell_text(division_input, at)}: its sections and the wire's free ends need {need / MM:.0f} "
            f"mm, the longest wire is {longest / MM:.0f} mm"
        )
        hint = f"give a wire of {np.ceil(need / MM / 5.0) * 5.0:.0f} mm, or more cells than {nx} x {ny}"
        measure = measurement(longest / MM, need / MM, "mm")
        yield _cell_issue("element.wire", worst, "panels.elastic.wires", measure, hint, is_short)
    if is_far.any():
        at = np.unravel_index(int(np.argmax(np.where(is_far, min_misfit, -1.0))), is_far.shape)
        misfit_m = float(min_misfit[at])
        worst = (
            f"{_cell_text(division_input, at)}: the best wire is {misfit_m / MM:.2f} mm off the surface, "
            f"allowed {rules.tolerance / MM:g} mm"
        )
        hint = (
            f"allow tolerance_mm: {np.ceil(misfit_m / MM * 100.0) / 100.0 + 0.01:.2f}, give more cells than "
            f"{nx} x {ny}, or smooth the surface if it is noisy"
        )
        measure = measurement(misfit_m / MM, rules.tolerance / MM, "mm")
        yield _cell_issue("element.tolerance", worst, "panels.elastic.tolerance_mm", measure, hint, is_far)
    is_large = alone & ~is_short & ~is_far & ~table.boxes[:, 0, 0].any(axis=0)
    if is_large.any():
        yield _too_large(division_input, is_large)
    # feasible in the table, but refused when fitted
    is_unexplained = alone & ~is_short & ~is_far & ~is_large
    if is_unexplained.any() and not (is_short | is_far | is_large).any():
        at = np.unravel_index(int(np.argmax(is_unexplained)), is_unexplained.shape)
        worst = (
            f"{_cell_text(division_input, at)}: it is at the limit of its block or of the tolerance, and "
            "exceeds it "
        )
        worst += "when measured on its facets"
        hint = f"allow 0.1 mm more of tolerance_mm, 1 mm more of blocks, or more cells than {nx} x {ny}"
        measure = measurement(rules.tolerance / MM, rules.tolerance / MM, "mm")
        yield _cell_issue("element.tolerance", worst, "panels.elastic", measure, hint, is_unexplained)


def _cell_issue(
    code: str, worst: str, field: str, measure: Measurement, hint: str, cells: BoolArray
) -> Issue:
    """Create the issue ``code`` for ``cells`` that cannot be panels; ``worst`` describes the worst one."""
    return Issue(
        code,
        f"{int(cells.sum())} of the cells cannot be panels even alone, the worst is {worst}",
        field=field,
        **measure,
        hint=hint,
    )


def _cell_text(division_input: DivisionInput, at: tuple[np.intp, ...]) -> str:
    """Return the number of a cell, counted from 1, and its range in the element plane."""
    range_text = " x ".join(
        f"{division_input.lines[i][at[i]] / MM:.0f} to {division_input.lines[i][at[i] + 1] / MM:.0f}"
        for i in range(2)
    )
    return f"the cell {at[0] + 1}, {at[1] + 1} ({range_text} mm)"


def _longest_sections(division_input: DivisionInput, along: int) -> FloatArray:
    """Return the length [m] of the longest section in each cell (nx, ny), along x (``along`` 0) or y (1)."""
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
    """Create the issue of cells that no block holds, with a block or a thickness that would suffice."""
    rules = division_input.rules

    def needed(nodes: GridNodes) -> FloatArray:
        """Return the blocks (2, nx, ny, 3) [m] that single cells need, with the wire along x and along y."""
        required = np.zeros((*division_input.cells, *division_input.cells), dtype=np.bool_)
        required[0, 0] = cells
        return np.stack(
            [_required_blocks(box_sizes(nodes, required, along)[0, 0], rules) for along in range(2)]
        )

    def excess(sizes: FloatArray) -> FloatArray:
        """Return by how much each cell (nx, ny) exceeds the best block in the better direction [m]."""
        limits = np.array([[max(b[:2]), min(b[:2]), b[2]] for b in rules.blocks])
        over = (sizes[:, None] - limits[:, None, None]).max(axis=-1)  # (2, blocks, nx, ny)
        return np.asarray(np.where(cells, over.min(axis=(0, 1)), -np.inf))

    sizes = needed(division_input.nodes)
    over = excess(sizes)
    at = np.unravel_index(int(np.argmax(over)), over.shape)
    direction = np.argmin(sizes.max(axis=-1), axis=0)[None, ..., None]
    size = np.take_along_axis(sizes, direction, axis=0)[0][cells].max(axis=0)  # large enough for all of them
    gap = float(over[at])
    size_text = " x ".join(f"{np.ceil((v + _SIZE_MARGIN_M) / MM):.0f}" for v in size)
    thickness = None
    for candidate in np.arange(division_input.surface.thickness - _THICKNESS_STEP_M, 0.0, -_THICKNESS_STEP_M):
        back = division_input.nodes.front + (division_input.nodes.back - division_input.nodes.front) * (
            candidate / division_input.surface.thickness
        )
        if (excess(needed(dataclasses.replace(division_input.nodes, back=back))) <= -_SIZE_MARGIN_M).all():
            thickness = float(candidate)
            break
    advice = (
        f"thickness_mm: {np.floor(thickness / MM + 1e-6):.0f} would fit, " if thickness is not None else ""
    )
    message = (
        f"{_cell_text(division_input, at)}: with foam around it, it exceeds all blocks by {gap / MM:.1f} mm"
    )
    hint = (
        f"{advice}a block of {size_text} mm would fit, or give more cells than {division_input.cells[0]} x "
        f"{division_input.cells[1]}"
    )
    largest = max(rules.blocks, key=lambda block: float(np.prod(block)))
    measure = measurement(float(size[2]) / MM, float(largest[2]) / MM, "mm")
    return _cell_issue("element.block", message, "blocks", measure, hint, cells)
