"""The kind ``hexagons``: a shell of thick planar panels with six or four sides, cut by a straight wire.

The blocks are held. The panels are those of `geometry/planar_panels.py`, with their fronts on the surface.
Here they get ids and blocks. Infeasible panels are refused, with a change that was tried and helps.

**Rows** follow adjacency: the first row stands on the ground, or is the lowest of the rim. Each panel of the
next row has a neighbour in the previous one. So ids follow from the pattern alone, and are an order in which
the shell can be assembled.

**Groups**, if the file states them, have equal numbers of panels, in turn around a lying shell, else along
it. Then letters of ids are groups, and numbers in a group go by rows, by height, or by the distance over the
shell from the first row.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.element.elastic import FIT_TOLERANCE_M
from planner.element.element_file import HexagonElement, HexagonsFile
from planner.element.jobs import row_names
from planner.element.panel_box import hull_boxes
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, from_parts, inverse, transform
from planner.geometry.assembly import assembly_rows
from planner.geometry.face_offset import ThickPanel
from planner.geometry.guided_projection import MAX_OFFSET_LENGTH_FACTOR, PanelRequirements
from planner.geometry.mesh import face_areas, vertex_normals
from planner.geometry.panel_pattern import RIM, PatternError
from planner.geometry.planar_panels import (
    FLATNESS_M,
    MAX_COUNT,
    MAX_SIDE_TILT_RAD,
    MIN_COUNT,
    PanelMeasurements,
    PanelShell,
    planar_shell,
)
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, issue_error

FIRST_ROW_HEIGHT_FRACTION: Final = 0.4618
"""Height range of the first row without a stated ground, as a fraction of the mean panel size.

Rim panels that reach down to the lowest corner of the rim within it are the first row. Chosen: an odd number,
because no regular shell has corners there.
"""
FIRST_ANGLE_RAD: Final = -0.0618
"""Angle [rad] from the view's x at which the numbers of a closed row start. Chosen: an odd number."""
BLOCK_UP: Final = (0.137, 0.071, 1.0)
"""Direction with which the y axes of blocks have a positive component. Chosen: odd numbers."""
AREA_TOLERANCE: Final = 1e-6
"""Relative difference of areas up to which boxes are equal; the first one is chosen."""
HEIGHT_STEP_M: Final = 1e-3
"""Height or distance difference [m] below which panels are numbered around the shell."""
MAX_TRIED_COUNT: Final = 1000
"""Maximum number of panels of a refused shell for which changes are tried. Each trial divides it again."""
COUNT_FACTORS: Final = (1.05, 1.25, 1.5, 1.8)
"""Factors on the count by area that are tried if blocks are too small, because panels are not all alike."""
SMALLER_LIMIT_FACTOR: Final = 0.7
"""Additional factor on minimum edge and width for smaller panels."""


MIN_AREA_RATIO: Final = 1.0 / np.sqrt(3.0)
"""Minimum area of a convex outline in squares of its minimum width: that of an equilateral triangle.

Source: J. Pal (1921).
"""


@dataclasses.dataclass(frozen=True)
class HexagonPanel:
    """A panel in its block.

    The block frame has z along the normal of the panel, x along the longer side of its box, y with a positive
    component along `BLOCK_UP`, and its origin at the centre of the bottom face.

    Attributes:
        name: Id.
        row: Row of the shell, from 0.
        block: Index of the kind of block in the file.
        size: Size (3,) [m] of the piece of the block.
        pose: Pose (4, 4) of the block in the element frame.
        bottom: Outline of the back (C, 3) [m] in the block frame.
        top: Outline of the front (C, 3) [m] in the block frame.
        beyond: Ids of the panels beyond the sides, from corner i to i + 1; empty on the rim.
        level: Whether each side (C,) is on the ground.
        deviation: Maximum distance [m] from the front to the surface.
        tilt: Tilt [rad] of the most tilted edge from face to face.
        concave: Whether the outline is concave.
    """

    name: str
    row: int
    block: int
    size: FloatArray
    pose: FloatArray
    bottom: FloatArray
    top: FloatArray
    beyond: tuple[str, ...]
    level: BoolArray
    deviation: float
    tilt: float
    concave: bool

    @property
    def volume(self) -> float:
        """Volume [m^3], exact by Simpson's rule, because corners are straight from face to face."""
        # V = h (A_bottom + 4 A_middle + A_top) / 6
        rings = (self.bottom, 0.5 * (self.bottom + self.top), self.top)
        low, middle, high = (float(shapely.Polygon(ring[:, :2]).area) for ring in rings)
        return float(self.size[2]) * (low + 4.0 * middle + high) / 6.0


def divide_hexagons(element: HexagonElement) -> tuple[HexagonPanel, ...]:
    """Compute all panels of a shell, in the order of their ids.

    Raises:
        TandemError: ``element.surface`` if the surface has no room for adjacent panels or no rim on the
            ground; ``element.shape`` and ``element.tolerance`` for panels that are infeasible or too far off;
            ``element.block`` if no block holds a panel. Each names its panels and a change that was tried and
            helps, if there is one.
    """
    _require_area(element)
    shell = _create_shell(element)
    rows = _rows(shell.panels)
    names, order = _name_panels(element, shell, rows)
    issues = _shape_faults(element, shell, names)
    placements: list[_BlockPlacement] = []
    if not issues:
        placements = [_place_in_block(element, panel) for panel in shell.panels]
        issues = _too_large(element, shell, placements, names)
    if issues:
        hint = _advice(element, issues, shell.check, placements)
        raise TandemError(
            [dataclasses.replace(i, hint="; ".join(filter(None, (i.hint, hint)))) for i in issues]
        )
    return tuple(_create_panel(shell, placements, names, rows, k) for k in order)


def _require_area(element: HexagonElement) -> None:
    """Raise ``element.shape`` if the larger of both faces has too little area for the requested panels.

    A convex panel with minimum width w in every direction has at least the area ``MIN_AREA_RATIO`` w^2.
    """
    options, front = element.options, element.surface
    back = dataclasses.replace(
        front, vertices=front.vertices - element.file.thickness_mm * MM * vertex_normals(front)
    )
    area = max(float(face_areas(face).sum()) for face in (front, back))
    width = options.least_width_mm * MM
    if area >= MIN_AREA_RATIO * width**2 * options.count:
        return
    max_count = int(area / width**2)
    text = (
        f"{options.count} panels do not fit on {area:.4g} m2: one would have "
        f"{area / options.count / MM**2:.0f} mm2, too little for a width of {options.least_width_mm:g} mm"
    )
    side = np.floor(np.sqrt(area / options.count) / MM)
    hint = f"give least_width_mm: {max(side, 0.0):g} at most, or check the unit of the surface"
    if max_count >= MIN_COUNT:
        hint = f"give count: {max_count} at most, or " + hint.removeprefix("give ")
    raise issue_error(
        "element.shape", text, field="panels.hexagons.count", value=options.count, limit=max_count, hint=hint
    )


def _create_shell(element: HexagonElement) -> PanelShell:
    """Divide the surface. Raises ``element.surface`` if no pattern fits or no rim is on the stated ground."""
    options, thickness = element.options, element.file.thickness_mm * MM
    ground = None if options.ground_mm is None else options.ground_mm * MM
    try:
        shell = planar_shell(
            element.surface,
            options.count,
            PanelRequirements(-thickness, options.least_edge_mm * MM, ground),
            options.rim,
            options.shape,
            options.least_width_mm * MM,
        )
    except PatternError as error:
        hint = "give another count, or a surface that is wider there"
        if options.shape == "quad":
            hint += ", or shape: hexagon"
        raise issue_error("element.surface", str(error), field="panels.hexagons.count", hint=hint) from error
    if ground is not None and not any(panel.level.any() for panel in shell.panels):
        low = float(element.surface.vertices[:, 2].min()) / MM
        message = f"no rim stands at the height of ground_mm, {options.ground_mm:g} mm"
        hint = f"the lowest point of the surface is at {low:.3f} mm; give that, or remove ground_mm"
        raise issue_error("element.surface", message, field="panels.hexagons.ground_mm", hint=hint)
    return shell


def _name_panels(element: HexagonElement, shell: PanelShell, rows: IntArray) -> tuple[list[str], IntArray]:
    """Return the id of each panel from its row (N,), and the indices (N,) of panels in the order of ids."""
    panels = shell.panels
    centres = np.array([panel.top.mean(axis=0) for panel in panels])
    view_positions = (centres - centres.mean(axis=0)) @ element.view
    is_lying = abs(float(element.view[2, 2])) > np.cos(45.0 * DEG)
    along = (
        (np.arctan2(view_positions[:, 1], view_positions[:, 0]) - FIRST_ANGLE_RAD) % (2.0 * np.pi)
        if is_lying
        else view_positions[:, 0]
    )
    group = rank = rows
    if (groups := element.file.groups) is not None:
        # rank along the shell, divided into equal parts
        group = np.argsort(np.argsort(along)) * groups.parts // len(panels)
        if groups.numbering == "height":
            rank = np.round(centres[:, 2] / HEIGHT_STEP_M).astype(np.int64)
        elif groups.numbering == "ground":
            rank = np.round(_distance_from_first(panels, centres, rows == 0) / HEIGHT_STEP_M).astype(np.int64)
    order = np.lexsort((along, rank, group))
    names = [""] * len(panels)
    for k, name in zip(order.tolist(), row_names(group[order].tolist()), strict=True):
        names[k] = name
    return names, order


def _distance_from_first(panels: Sequence[ThickPanel], centres: FloatArray, first: BoolArray) -> FloatArray:
    """Return the distance (N,) [m] over the shell of each panel from the nearest panel of the first row.

    Distances are summed over ``centres`` (N, 3) [m] of neighbours. Panels that no neighbours connect get 0.
    ``first`` (N,) is whether a panel is in the first row.
    """
    pairs = [
        (k, neighbour)
        for k, panel in enumerate(panels)
        for neighbour in panel.across.tolist()
        if neighbour != RIM
    ]
    first_of_pair, second_of_pair = np.array(pairs).T
    distances = np.linalg.norm(centres[first_of_pair] - centres[second_of_pair], axis=1)
    graph = csr_array((distances, (first_of_pair, second_of_pair)), shape=(len(panels), len(panels)))
    distance = dijkstra(graph, indices=np.flatnonzero(first), min_only=True)
    return np.where(np.isfinite(distance), distance, 0.0)  # pieces connected by a corner only


def _rows(panels: Sequence[ThickPanel]) -> IntArray:
    """Return the row (N,) of each panel, counted from 0.

    The first row stands on the ground if any panel does, else it consists of the low panels on the rim.
    """
    is_rim = np.array([(panel.across == RIM).any() for panel in panels])
    lowest = np.array([panel.top[:, 2].min() for panel in panels])
    areas = [shapely.Polygon(panel.top @ _plane_axes(panel.normal)).area for panel in panels]
    first = np.array([panel.level.any() for panel in panels])
    is_low = is_rim & (lowest < lowest[is_rim].min() + FIRST_ROW_HEIGHT_FRACTION * np.sqrt(np.mean(areas)))
    return assembly_rows([panel.across for panel in panels], first if first.any() else is_low, lowest)


def _plane_axes(normal: FloatArray) -> FloatArray:
    """Return two axes perpendicular to a normal, as columns (3, 2)."""
    first_axis = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first_axis /= np.linalg.norm(first_axis)
    return np.stack([first_axis, np.cross(normal, first_axis)], axis=1)


@dataclasses.dataclass(frozen=True)
class _BlockPlacement:
    """Block of a panel: index of its kind (None if none holds it), ``size`` (3,) [m] and ``pose`` (4, 4)."""

    block: int | None
    size: FloatArray
    pose: FloatArray


def _place_in_block(element: HexagonElement, panel: ThickPanel) -> _BlockPlacement:
    """Place a panel in the smallest block that holds it, in the orientation of smallest area."""
    thickness = element.file.thickness_mm * MM
    plane = _plane_axes(panel.normal)
    directions, extent = hull_boxes(np.concatenate([panel.bottom, panel.top]) @ plane)
    # the longer side of each box is along x
    is_tall = extent[:, 1] > extent[:, 0] * (1.0 + AREA_TOLERANCE)
    directions = np.where(
        is_tall[:, None], np.stack([-directions[:, 1], directions[:, 0]], axis=1), directions
    )
    size = np.where(is_tall[:, None], extent[:, ::-1], extent) + 2.0 * element.file.sides
    area = size.prod(axis=1)
    blocks = [np.array(block.size_mm) * MM for block in element.file.blocks]
    block_index: int | None = None
    is_candidate = area <= area.min() * (1.0 + AREA_TOLERANCE)
    for number in sorted(range(len(blocks)), key=lambda i: (float(blocks[i].prod()), i)):
        block = blocks[number]
        space = np.array([max(block[:2]), min(block[:2])]) + FIT_TOLERANCE_M
        fits = (size <= space).all(axis=1)
        if thickness <= block[2] + FIT_TOLERANCE_M and fits.any():
            block_index, is_candidate = number, fits & (area <= area[fits].min() * (1.0 + AREA_TOLERANCE))
            break
    best = int(np.flatnonzero(is_candidate)[0])
    x = plane @ directions[best]
    y = np.cross(panel.normal, x)
    x, y = (x, y) if y @ BLOCK_UP > 0.0 else (-x, -y)
    axes = np.stack([x, y, panel.normal], axis=1)
    local = np.concatenate([panel.bottom, panel.top]) @ axes
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    origin = axes @ np.array([middle[0], middle[1], float((panel.bottom @ panel.normal).mean())])
    return _BlockPlacement(block_index, np.array([*size[best], thickness]), from_parts(axes, origin))


def _create_panel(
    shell: PanelShell, placements: Sequence[_BlockPlacement], names: Sequence[str], rows: IntArray, k: int
) -> HexagonPanel:
    """Create the panel ``k`` of a shell, in the frame of its block."""
    panel, placement, check = shell.panels[k], placements[k], shell.check
    bottom, top = (transform(inverse(placement.pose), ring) for ring in (panel.bottom, panel.top))
    # snap to both planes, which are exact within a billionth of a metre
    bottom[:, 2], top[:, 2] = 0.0, placement.size[2]
    return HexagonPanel(
        names[k],
        int(rows[k]),
        0 if placement.block is None else placement.block,
        placement.size,
        placement.pose,
        bottom,
        top,
        tuple("" if neighbour == RIM else names[neighbour] for neighbour in panel.across.tolist()),
        panel.level.astype(np.bool_),
        float(check.off_surface[k]),
        float(check.tilt[k]),
        bool(check.concave[k]),
    )


@dataclasses.dataclass(frozen=True)
class _ShapeLimit:
    """A property of N panels with its limit.

    Attributes:
        code: Issue code.
        field: Field of the file.
        what: What panels beyond the limit do, as the predicate of a message.
        got: Values (N,) of the panels.
        limit: Limit, in the same unit.
        unit: Unit in messages.
        is_minimum: Whether the limit is a minimum, else it is a maximum.
        slack: Tolerance of the comparison.
    """

    code: str
    field: str
    what: str
    got: FloatArray
    limit: float
    unit: str
    is_minimum: bool = False
    slack: float = 0.0

    @property
    def over(self) -> BoolArray:
        """Whether each panel (N,) is beyond the limit."""
        low, high = self.limit - self.slack, self.limit + self.slack
        return np.asarray(self.got < low if self.is_minimum else self.got > high)


def _limits(element: HexagonElement, check: PanelMeasurements) -> list[_ShapeLimit]:
    """Return all limits of shapes with the measured values of the panels."""
    options, field, shape = element.options, "panels.hexagons", "element.shape"
    gap = np.maximum(check.off_plane, check.off_side)
    return [
        _ShapeLimit(
            shape, field, "intersect themselves", (~check.simple).astype(np.float64), 0.0, "crossing"
        ),
        _ShapeLimit(
            shape,
            field,
            "have corners off the planes of their faces and sides",
            gap / MM,
            FLATNESS_M / MM,
            "mm",
        ),
        _ShapeLimit(
            shape,
            f"{field}.least_edge_mm",
            "have short edges",
            check.least_edge / MM,
            options.least_edge_mm,
            "mm",
            is_minimum=True,
        ),
        _ShapeLimit(
            shape,
            f"{field}.least_width_mm",
            "are narrow",
            check.width / MM,
            options.least_width_mm,
            "mm",
            is_minimum=True,
        ),
        _ShapeLimit(
            shape,
            field,
            "have edges from face to face that are tilted too far",
            check.tilt / DEG,
            MAX_SIDE_TILT_RAD / DEG,
            "degrees",
        ),
        _ShapeLimit(
            shape,
            field,
            "have long edges from face to face",
            check.stretch * element.file.thickness_mm,
            MAX_OFFSET_LENGTH_FACTOR * element.file.thickness_mm,
            "mm",
            slack=1e-9,
        ),
        _ShapeLimit(
            "element.tolerance",
            f"{field}.off_surface_mm",
            "are too far off the surface",
            check.off_surface / MM,
            options.off_surface_mm,
            "mm",
        ),
    ]


def _shape_faults(element: HexagonElement, shell: PanelShell, names: Sequence[str]) -> list[Issue]:
    """Return why panels are infeasible: one issue for each exceeded limit, with the worst panel first."""
    issues = []
    for limit in _limits(element, shell.check):
        over = np.flatnonzero(limit.over)
        if not len(over):
            continue
        order = over[np.argsort(limit.got[over] if limit.is_minimum else -limit.got[over], kind="stable")]
        worst_k = int(order[0])
        message = (
            f"{len(over)} of {len(names)} panels {limit.what}, the worst is "
            f"{_panel_location(shell, names, worst_k)} with {limit.got[worst_k]:.4g} {limit.unit}, allowed "
            f"{'at least ' if limit.is_minimum else ''}{limit.limit:g}"
        )
        if len(over) > 1:
            message += f"; the others: {', '.join(names[k] for k in order[1:].tolist())}"
        if bent := int((shell.check.bend[over] < 0.0).sum()):
            message += f"; {bent} of them are where the surface bends both ways"
        value = float(limit.got[worst_k])
        issues.append(
            Issue(limit.code, message, field=limit.field, value=value, limit=limit.limit, unit=limit.unit)
        )
    return issues


def _panel_location(shell: PanelShell, names: Sequence[str], k: int) -> str:
    """Return the id of the panel ``k`` and its centre in the element frame, for messages."""
    x, y, z = (shell.panels[k].top.mean(axis=0) / MM).tolist()
    return f"{names[k]} near ({x:.0f}, {y:.0f}, {z:.0f}) mm"


def _too_large(
    element: HexagonElement, shell: PanelShell, placed: Sequence[_BlockPlacement], names: Sequence[str]
) -> list[Issue]:
    """Return one issue that lists the panels that no block holds, with a block that would hold all panels."""
    unplaced = [k for k, placement in enumerate(placed) if placement.block is None]
    if not unplaced:
        return []
    worst_index = max(unplaced, key=lambda k: (float(placed[k].size[0]), k))
    sizes = np.array([placement.size for placement in placed])
    thickness = element.file.thickness_mm
    got = " x ".join(f"{v / MM:.1f}" for v in placed[worst_index].size.tolist())
    max_thickness = max(block.size_mm[2] for block in element.file.blocks)
    reason = (
        f"no block holds {len(unplaced)} of {len(names)} panels with foam beside them: "
        f"{_panel_location(shell, names, worst_index)} needs {got} mm"
    )
    if len(unplaced) > 1:
        reason += f"; the others: {', '.join(names[k] for k in unplaced if k != worst_index)}"
    if max_thickness < thickness:
        reason += f"; the thickest block is {max_thickness:g} mm, the panels are {thickness:g} mm"
    needed = " x ".join(f"{v:g}" for v in [*np.ceil(sizes.max(axis=0)[:2] / MM + 1e-6).tolist(), thickness])
    hint = f"a block of {needed} mm would hold all"
    return [
        Issue("element.block", reason, field="blocks", value=len(unplaced), limit=0, unit="panels", hint=hint)
    ]


def _advice(
    element: HexagonElement,
    issues: Sequence[Issue],
    check: PanelMeasurements,
    placed: Sequence[_BlockPlacement],
) -> str:
    """Return as a hint the first change of the file with which all panels can be made.

    If no change helps, the hint lists those that were tried in vain. ``issues`` are the refusals, ``placed``
    the blocks of the panels; it is empty if shapes exceed their limits.
    """
    if element.options.count > MAX_TRIED_COUNT:
        return ""
    tried = []
    bent = bool((check.bend < 0.0).any())
    candidates = _smaller_panel_changes(element, placed) if placed else _shape_changes(element, issues, bent)
    for changes, thickness in candidates:
        change_texts = [
            f"{name}: {value if isinstance(value, str) else f'{value:g}'}" for name, value in changes.items()
        ]
        if thickness is not None:
            change_texts.append(f"thickness_mm: {thickness:g}")
        options = element.options.model_copy(update=changes)
        file = element.file
        file = file if thickness is None else file.model_copy(update={"thickness_mm": thickness})
        if _is_feasible(dataclasses.replace(element, file=file, options=options)):
            return f"{', '.join(change_texts)} was tried: all panels can be made then"
        tried.append(", ".join(change_texts))
    in_vain = f"tried in vain: {'; '.join(tried)}" if tried else ""
    if placed:
        return "; ".join(filter(None, (in_vain, _count_by_area(element, placed))))
    return f"{in_vain}; smooth or divide the surface{' where it bends both ways' if bent else ''}"


def _required_count_factor(element: HexagonElement, placed: Sequence[_BlockPlacement]) -> float:
    """Return the factor on the number of panels with which blocks hold each, if all panels shrink equally.

    Only blocks that are thick enough count, or the thickest ones if none is. Infinite if the foam beside a
    panel takes whole blocks.
    """
    max_thickness = max(block.size_mm[2] for block in element.file.blocks)
    min_thickness = min(element.file.thickness_mm, max_thickness)
    plans = np.sort([block.size_mm[:2] for block in element.file.blocks if block.size_mm[2] >= min_thickness])
    foam = 2.0 * element.file.sides
    space = plans[:, ::-1] * MM + FIT_TOLERANCE_M - foam
    space = space[(space > 0.0).all(axis=1)]
    if not len(space):
        return np.inf
    size = np.array([placement.size[:2] for placement in placed]) - foam
    return float((size[:, None] / space).max(axis=2).min(axis=1).max()) ** 2


def _count_by_area(element: HexagonElement, placed: Sequence[_BlockPlacement]) -> str:
    """Return the advice if no tried count was sufficient: the count that is required by area, if allowed."""
    factor = _required_count_factor(element, placed)
    count = np.ceil(factor * element.options.count)
    if count > MAX_COUNT:
        reason = (
            "foam beside panels takes all of them" if np.isinf(factor) else f"{MAX_COUNT} at most are divided"
        )
        return f"no count makes panels that fit these blocks, because {reason}: give larger blocks"
    if count > MAX_TRIED_COUNT:
        limits = " and ".join(f"{name}: {v:g}" for name, v in _scaled_limits(element.options, count).items())
        return f"by area, these blocks require about count: {count:.0f}, with {limits}, which was not tried"
    return "give larger blocks"


def _smaller_panel_changes(
    element: HexagonElement, placed: Sequence[_BlockPlacement]
) -> Iterator[tuple[dict[str, Any], float | None]]:
    """Yield changes to try if blocks do not hold all panels, the smallest change first.

    Each change consists of fields of ``hexagons`` and a thickness [mm] or None. The first one reduces the
    thickness to that of the thickest block. The next ones have more, and thus smaller panels, the last one
    also a smaller minimum edge and width.
    """
    options = element.options
    max_thickness = max(block.size_mm[2] for block in element.file.blocks)
    thickness = max_thickness if max_thickness < element.file.thickness_mm else None
    area_factor = _required_count_factor(element, placed)
    if thickness is not None:
        yield {}, thickness
    if area_factor <= 1.0:
        return
    counts = [np.ceil(factor * area_factor * options.count) for factor in COUNT_FACTORS]
    counts = [int(count) for count in counts if count <= MAX_TRIED_COUNT]
    for count in counts:
        yield {"count": count}, thickness
    for count in counts[-1:]:
        yield {"count": count, **_scaled_limits(options, count)}, thickness


def _scaled_limits(options: HexagonsFile, count: float) -> dict[str, float]:
    """Return minimum edge and width [mm] of the file, reduced to the size of ``count`` panels."""
    factor = SMALLER_LIMIT_FACTOR * np.sqrt(options.count / count)
    names = ("least_edge_mm", "least_width_mm")
    return {name: float(max(np.floor(factor * getattr(options, name)), 1.0)) for name in names}


def _shape_changes(
    element: HexagonElement, issues: Sequence[Issue], bent: bool
) -> Iterator[tuple[dict[str, Any], float | None]]:
    """Yield changes to try if panels exceed the limits of their shapes, the smallest change first.

    Each change consists of fields of ``hexagons`` and a thickness [mm] or None. ``bent`` is whether panels
    lie where the surface bends both ways.
    """
    options, thickness = element.options, element.file.thickness_mm
    if bent:
        yield {"shape": "quad" if options.shape == "hexagon" else "hexagon"}, None
    if options.rim == "upright":
        yield {"rim": "square"}, None
    worst = {
        str(issue.field).rsplit(".", 1)[-1]: float(issue.value or 0.0)
        for issue in issues
        if issue.field != "panels.hexagons"
    }
    if len(worst) == len(issues):  # all exceeded limits are in the file: relax them to the worst values
        for factor in (1.0, 0.7):
            allowed = {
                name: float(np.ceil(value) if name == "off_surface_mm" else np.floor(factor * value))
                for name, value in worst.items()
            }
            if min(allowed.values()) >= 1.0:
                yield allowed, None
    for factor in (0.75, 1.5):
        yield {"count": max(round(factor * options.count), MIN_COUNT)}, None
    yield {}, float(np.floor(0.7 * thickness))


def _is_feasible(element: HexagonElement) -> bool:
    """Whether a shell can be created, keeps all limits of shapes, and fits blocks."""
    try:
        shell = _create_shell(element)
    except TandemError:
        return False
    limits = _limits(element, shell.check)
    return not any(limit.over.any() for limit in limits) and all(
        _place_in_block(element, panel).block is not None for panel in shell.panels
    )
