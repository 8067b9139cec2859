"""The kind ``hexagons``: a shell of thick planar panels with six sides or four, each cut by a straight wire
out of a held block.

The panels are those of `geometry/planar_panels.py`, with their fronts on the surface. Here they get ids and
blocks, and what cannot be made is refused, with a change that was tried and helps.

**Rows** go from panel to panel: the first one stands on the ground, or is the lowest of the rim; each panel
of the next one has a neighbour in the row before. So ids follow from the pattern alone, and are an order in
which the shell can be put up.

**Groups**, where the file states them, are as many panels each, in turn round the shell where it lies, else
along it. Then letters of ids are groups, and numbers in a group go by rows, by height, or by the way over the
shell from the first row.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.element.elastic import FITS
from planner.element.element_file import HexagonElement, HexagonsFile
from planner.element.jobs import row_names
from planner.element.panel_box import hull_boxes
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, from_parts, inverse, transform
from planner.geometry.assembly import rows_up
from planner.geometry.face_offset import ThickPanel
from planner.geometry.guided_projection import LONGEST_WAY
from planner.geometry.mesh import face_areas, vertex_normals
from planner.geometry.panel_pattern import RIM, PatternError
from planner.geometry.planar_panels import (
    FLAT,
    LEAST_COUNT,
    MOST_COUNT,
    STEEPEST,
    PanelCheck,
    PanelShell,
    planar_shell,
)
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal

LOW: Final = 0.4618
"""Without a stated ground, panels on the rim that reach down to its lowest corner within this share of their
mean size are the first row. An odd number on purpose, as the next two: no regular shell has corners there."""
FIRST: Final = -0.0618
"""Numbers of a row that goes round begin at this angle [rad] from the view's x."""
UP: Final = (0.137, 0.071, 1.0)
"""What the y axes of blocks point to rather than away from."""
ALIKE: Final = 1e-6
"""Boxes whose areas differ by no more than this share are alike: the first one counts."""
ALIKE_HEIGHT: Final = 1e-3
"""Panels whose heights or ways from the first row differ by less [m] are numbered round the shell."""
TRIED_TO: Final = 1000
"""Where a shell of more panels is refused, no changes are tried: each takes as long as the shell."""
COUNT_SHARES: Final = (1.05, 1.25, 1.5, 1.8)
"""Counts that are tried where blocks are too small, in shares of that by area: panels are not all alike."""
LESS: Final = 0.7
"""How much of the least edge and width, made smaller as panels are, is asked of smaller panels."""


LEAST_AREA: Final = 1.0 / np.sqrt(3.0)
"""Of a convex outline, in squares of its least width: an equilateral triangle has that (J. Pal, 1921)."""


@dataclasses.dataclass(frozen=True)
class HexagonPanel:
    """A panel in its block, whose ``pose`` (4, 4) is in the element's frame: z along the panel's normal, x
    along its box, y rather upwards, the origin in the middle of the bottom face.

    ``bottom``, ``top`` (C, 3) [m] in that frame; ``beyond``: ids of the panels beyond the sides, from corner
    i to i + 1, empty on the rim; ``level`` (C,): sides on the ground. ``row``: of the shell, from 0;
    ``block``: the kind of block in the file, ``size`` (3,) [m] of the piece of it. ``off`` [m]: front to
    surface; ``lean`` [rad] of the steepest edge from face to face.
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
    off: float
    lean: float
    concave: bool

    @property
    def volume(self) -> float:
        """[m^3]: exact, as the corners go straight from face to face."""
        rings = (self.bottom, 0.5 * (self.bottom + self.top), self.top)
        low, middle, high = (float(shapely.Polygon(ring[:, :2]).area) for ring in rings)
        return float(self.size[2]) * (low + 4.0 * middle + high) / 6.0


def divide_hexagons(element: HexagonElement) -> tuple[HexagonPanel, ...]:
    """All panels of a shell by their ids.

    Raises ``TandemError``: ``element.surface`` where the surface has no room for panels side by side or no
    rim on the ground, ``element.shape`` and ``element.tolerance`` for panels that cannot be made or are too
    far off, ``element.block`` where no block holds a panel; each names its panels and a change that was tried
    and helps, where one does.
    """
    _refuse_crowds(element)
    made = _shell(element)
    rows = _rows(made.panels)
    names, order = _named(element, made, rows)
    issues = _faults(element, made, names)
    placed: list[_Placed] = []
    if not issues:
        placed = [_in_block(element, panel) for panel in made.panels]
        issues = _too_large(element, made, placed, names)
    if issues:
        hint = _advice(element, issues, made.check, placed)
        raise TandemError(
            [dataclasses.replace(i, hint="; ".join(filter(None, (i.hint, hint)))) for i in issues]
        )
    return tuple(_panel(made, placed, names, rows, k) for k in order)


def _refuse_crowds(element: HexagonElement) -> None:
    """Refuse more panels than a surface, in front or at the back, has room for by its area, before they are
    made: no convex panel that is wide enough in every direction has less than ``LEAST_AREA`` of its width
    squared."""
    wanted, front = element.wanted, element.surface
    back = dataclasses.replace(
        front, vertices=front.vertices - element.file.thickness_mm * MM * vertex_normals(front)
    )
    area = max(float(face_areas(face).sum()) for face in (front, back))
    width = wanted.least_width_mm * MM
    if area >= LEAST_AREA * width**2 * wanted.count:
        return
    most = int(area / width**2)
    what = (
        f"{wanted.count} panels have no room on {area:.4g} m2: one would have "
        f"{area / wanted.count / MM**2:.0f} mm2, too little for a width of {wanted.least_width_mm:g} mm"
    )
    side = np.floor(np.sqrt(area / wanted.count) / MM)
    hint = f"give least_width_mm: {max(side, 0.0):g} at most, or see to the unit of the surface"
    if most >= LEAST_COUNT:
        hint = f"give count: {most} at most, or " + hint.removeprefix("give ")
    raise refusal(
        "element.shape", what, field="panels.hexagons.count", value=wanted.count, limit=most, hint=hint
    )


def _shell(element: HexagonElement) -> PanelShell:
    wanted, thickness = element.wanted, element.file.thickness_mm * MM
    ground = None if wanted.ground_mm is None else wanted.ground_mm * MM
    try:
        made = planar_shell(
            element.surface,
            wanted.count,
            -thickness,
            wanted.least_edge_mm * MM,
            wanted.rim,
            ground,
            wanted.shape,
            wanted.least_width_mm * MM,
        )
    except PatternError as error:
        hint = "give another count, or a surface that is wider there"
        if wanted.shape == "quad":
            hint += ", or shape: hexagon"
        raise refusal("element.surface", str(error), field="panels.hexagons.count", hint=hint) from error
    if ground is not None and not any(panel.level.any() for panel in made.panels):
        low = float(element.surface.vertices[:, 2].min()) / MM
        what = f"no rim stands at the height of ground_mm, {wanted.ground_mm:g} mm"
        hint = f"the lowest place of the surface is at {low:.3f} mm; give that, or leave ground_mm out"
        raise refusal("element.surface", what, field="panels.hexagons.ground_mm", hint=hint)
    return made


def _named(element: HexagonElement, made: PanelShell, rows: IntArray) -> tuple[list[str], IntArray]:
    """The id of each panel, by the ``rows`` that they are in, and the panels in the order of their ids."""
    panels = made.panels
    middle = np.array([panel.top.mean(axis=0) for panel in panels])
    own = (middle - middle.mean(axis=0)) @ element.view
    lies = abs(float(element.view[2, 2])) > np.cos(45.0 * DEG)
    along = (np.arctan2(own[:, 1], own[:, 0]) - FIRST) % (2.0 * np.pi) if lies else own[:, 0]
    letter = by = rows
    if (groups := element.file.groups) is not None:
        letter = np.argsort(np.argsort(along)) * groups.parts // len(panels)
        if groups.numbering == "height":
            by = np.round(middle[:, 2] / ALIKE_HEIGHT).astype(np.int64)
        elif groups.numbering == "ground":
            by = np.round(_way_up(panels, middle, rows == 0) / ALIKE_HEIGHT).astype(np.int64)
    order = np.lexsort((along, by, letter))
    names = [""] * len(panels)
    for k, name in zip(order.tolist(), row_names(letter[order].tolist()), strict=True):
        names[k] = name
    return names, order


def _way_up(panels: Sequence[ThickPanel], middle: FloatArray, first: BoolArray) -> FloatArray:
    """How far (N,) [m] panels are from the nearest of the ``first`` ones, from middle to middle over the
    shell."""
    pairs = [(k, b) for k, panel in enumerate(panels) for b in panel.across.tolist() if b != RIM]
    one, other = np.array(pairs).T
    apart = np.linalg.norm(middle[one] - middle[other], axis=1)
    graph = csr_array((apart, (one, other)), shape=(len(panels), len(panels)))
    way = dijkstra(graph, indices=np.flatnonzero(first), min_only=True)
    return np.where(np.isfinite(way), way, 0.0)  # pieces that hang together by a corner alone


def _rows(panels: Sequence[ThickPanel]) -> IntArray:
    """Return the row (N,) of each panel, counted from 0."""
    rim = np.array([(panel.across == RIM).any() for panel in panels])
    lowest = np.array([panel.top[:, 2].min() for panel in panels])
    flat = [shapely.Polygon(panel.top @ _across(panel.normal)).area for panel in panels]
    first = np.array([panel.level.any() for panel in panels])
    low = rim & (lowest < lowest[rim].min() + LOW * np.sqrt(np.mean(flat)))
    return rows_up([panel.across for panel in panels], first if first.any() else low, lowest)


def _across(normal: FloatArray) -> FloatArray:
    """Two axes square to a normal, as columns (3, 2)."""
    one = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(normal, one)], axis=1)


@dataclasses.dataclass(frozen=True)
class _Placed:
    """A panel's block: its kind, None where none holds it, ``size`` (3,) [m] and ``pose`` (4, 4)."""

    block: int | None
    size: FloatArray
    pose: FloatArray


def _in_block(element: HexagonElement, panel: ThickPanel) -> _Placed:
    """The smallest block that holds a panel, in the direction that takes least of it."""
    thick = element.file.thickness_mm * MM
    plane = _across(panel.normal)
    way, extent = hull_boxes(np.concatenate([panel.bottom, panel.top]) @ plane)
    tall = extent[:, 1] > extent[:, 0] * (1.0 + ALIKE)
    way = np.where(tall[:, None], np.stack([-way[:, 1], way[:, 0]], axis=1), way)
    size = np.where(tall[:, None], extent[:, ::-1], extent) + 2.0 * element.file.sides
    area = size.prod(axis=1)
    blocks = [np.array(block.size_mm) * MM for block in element.file.blocks]
    found: int | None = None
    chosen = area <= area.min() * (1.0 + ALIKE)
    for number in sorted(range(len(blocks)), key=lambda i: (float(blocks[i].prod()), i)):
        block = blocks[number]
        room = np.array([max(block[:2]), min(block[:2])]) + FITS
        fits = (size <= room).all(axis=1)
        if thick <= block[2] + FITS and fits.any():
            found, chosen = number, fits & (area <= area[fits].min() * (1.0 + ALIKE))
            break
    best = int(np.flatnonzero(chosen)[0])
    x = plane @ way[best]
    y = np.cross(panel.normal, x)
    x, y = (x, y) if y @ UP > 0.0 else (-x, -y)
    axes = np.stack([x, y, panel.normal], axis=1)
    local = np.concatenate([panel.bottom, panel.top]) @ axes
    middle = 0.5 * (local.min(axis=0) + local.max(axis=0))
    origin = axes @ np.array([middle[0], middle[1], float((panel.bottom @ panel.normal).mean())])
    return _Placed(found, np.array([*size[best], thick]), from_parts(axes, origin))


def _panel(
    made: PanelShell, placed: Sequence[_Placed], names: Sequence[str], rows: IntArray, k: int
) -> HexagonPanel:
    panel, own, check = made.panels[k], placed[k], made.check
    bottom, top = (transform(inverse(own.pose), ring) for ring in (panel.bottom, panel.top))
    # planes within a billionth of a metre are these two
    bottom[:, 2], top[:, 2] = 0.0, own.size[2]
    return HexagonPanel(
        names[k],
        int(rows[k]),
        0 if own.block is None else own.block,
        own.size,
        own.pose,
        bottom,
        top,
        tuple("" if b == RIM else names[b] for b in panel.across.tolist()),
        panel.level.astype(np.bool_),
        float(check.off_surface[k]),
        float(check.tilt[k]),
        bool(check.concave[k]),
    )


@dataclasses.dataclass(frozen=True)
class _Limit:
    """What N panels are, ``got`` (N,), against a limit, the least that is allowed or the most; ``over`` (N,):
    those that do not keep it."""

    code: str
    field: str
    what: str
    got: FloatArray
    limit: float
    unit: str
    least: bool = False
    slack: float = 0.0

    @property
    def over(self) -> BoolArray:
        """Panels beyond the limit."""
        low, high = self.limit - self.slack, self.limit + self.slack
        return np.asarray(self.got < low if self.least else self.got > high)


def _limits(element: HexagonElement, check: PanelCheck) -> list[_Limit]:
    wanted, own, shape = element.wanted, "panels.hexagons", "element.shape"
    gap = np.maximum(check.off_plane, check.off_side)
    return [
        _Limit(shape, own, "cross themselves", (~check.simple).astype(np.float64), 0.0, "crossing"),
        _Limit(shape, own, "have corners off the planes of their faces and sides", gap / MM, FLAT / MM, "mm"),
        _Limit(
            shape,
            f"{own}.least_edge_mm",
            "have short edges",
            check.least_edge / MM,
            wanted.least_edge_mm,
            "mm",
            least=True,
        ),
        _Limit(
            shape,
            f"{own}.least_width_mm",
            "are narrow",
            check.width / MM,
            wanted.least_width_mm,
            "mm",
            least=True,
        ),
        _Limit(
            shape,
            own,
            "have corners that lean far from face to face",
            check.tilt / DEG,
            STEEPEST / DEG,
            "degrees",
        ),
        _Limit(
            shape,
            own,
            "have long edges from face to face",
            check.stretch * element.file.thickness_mm,
            LONGEST_WAY * element.file.thickness_mm,
            "mm",
            slack=1e-9,
        ),
        _Limit(
            "element.tolerance",
            f"{own}.off_surface_mm",
            "are off the surface",
            check.off_surface / MM,
            wanted.off_surface_mm,
            "mm",
        ),
    ]


def _faults(element: HexagonElement, made: PanelShell, names: Sequence[str]) -> list[Issue]:
    """Why panels cannot be made: one issue for each limit, with all that do not keep it, the worst first."""
    issues = []
    for one in _limits(element, made.check):
        over = np.flatnonzero(one.over)
        if not len(over):
            continue
        order = over[np.argsort(one.got[over] if one.least else -one.got[over], kind="stable")]
        worst = int(order[0])
        what = (
            f"{len(over)} of {len(names)} panels {one.what}, the worst is {_place(made, names, worst)} with "
            f"{one.got[worst]:.4g} {one.unit}, allowed are {'at least ' if one.least else ''}{one.limit:g}"
        )
        if len(over) > 1:
            what += f"; the others: {', '.join(names[k] for k in order[1:].tolist())}"
        if bent := int((made.check.bend[over] < 0.0).sum()):
            what += f"; {bent} of them lie where the surface bends both ways"
        value = float(one.got[worst])
        issues.append(Issue(one.code, what, field=one.field, value=value, limit=one.limit, unit=one.unit))
    return issues


def _place(made: PanelShell, names: Sequence[str], k: int) -> str:
    x, y, z = (made.panels[k].top.mean(axis=0) / MM).tolist()
    return f"{names[k]} near ({x:.0f}, {y:.0f}, {z:.0f}) mm"


def _too_large(
    element: HexagonElement, made: PanelShell, placed: Sequence[_Placed], names: Sequence[str]
) -> list[Issue]:
    """Panels that no block holds, and the block that would hold all."""
    over = [k for k, own in enumerate(placed) if own.block is None]
    if not over:
        return []
    worst = max(over, key=lambda k: (float(placed[k].size[0]), k))
    sizes = np.array([own.size for own in placed])
    thick = element.file.thickness_mm
    got = " x ".join(f"{v / MM:.1f}" for v in placed[worst].size.tolist())
    most = max(block.size_mm[2] for block in element.file.blocks)
    what = (
        f"no block holds {len(over)} of {len(names)} panels with foam beside them: "
        f"{_place(made, names, worst)} takes {got} mm"
    )
    if len(over) > 1:
        what += f"; the others: {', '.join(names[k] for k in over if k != worst)}"
    if most < thick:
        what += f"; the thickest block has {most:g} mm, the panels have {thick:g} mm"
    needed = " x ".join(f"{v:g}" for v in [*np.ceil(sizes.max(axis=0)[:2] / MM + 1e-6).tolist(), thick])
    hint = f"a block of {needed} mm would hold all"
    return [Issue("element.block", what, field="blocks", value=len(over), limit=0, unit="panels", hint=hint)]


def _advice(
    element: HexagonElement, issues: Sequence[Issue], check: PanelCheck, placed: Sequence[_Placed]
) -> str:
    """The first change of the file that was tried and leaves nothing to refuse. ``placed``: panels in their
    blocks, where all keep the limits of their shapes."""
    if element.wanted.count > TRIED_TO:
        return ""
    tried = []
    bent = bool((check.bend < 0.0).any())
    changed = _smaller(element, placed) if placed else _changes(element, issues, bent)
    for changes, thickness in changed:
        said = [f"{name}: {v if isinstance(v, str) else f'{v:g}'}" for name, v in changes.items()]
        if thickness is not None:
            said.append(f"thickness_mm: {thickness:g}")
        wanted = element.wanted.model_copy(update=changes)
        file = element.file
        file = file if thickness is None else file.model_copy(update={"thickness_mm": thickness})
        if _serves(dataclasses.replace(element, file=file, wanted=wanted)):
            return f"{', '.join(said)} was tried: all panels can be made then"
        tried.append(", ".join(said))
    in_vain = f"tried in vain: {'; '.join(tried)}" if tried else ""
    if placed:
        return "; ".join(filter(None, (in_vain, _count_by_area(element, placed))))
    return f"{in_vain}; smooth or divide the surface{' where it bends both ways' if bent else ''}"


def _times_too_large(element: HexagonElement, placed: Sequence[_Placed]) -> float:
    """How many times as many panels it takes until blocks hold each, if all shrink alike; infinite where foam
    beside a panel takes whole blocks. Thickness does not count."""
    most = max(block.size_mm[2] for block in element.file.blocks)
    least = min(element.file.thickness_mm, most)
    rooms = np.sort([block.size_mm[:2] for block in element.file.blocks if block.size_mm[2] >= least])
    foam = 2.0 * element.file.sides
    room = rooms[:, ::-1] * MM + FITS - foam
    room = room[(room > 0.0).all(axis=1)]
    if not len(room):
        return np.inf
    size = np.array([own.size[:2] for own in placed]) - foam
    return float((size[:, None] / room).max(axis=2).min(axis=1).max()) ** 2


def _count_by_area(element: HexagonElement, placed: Sequence[_Placed]) -> str:
    """What to say of the count that blocks ask for where none was found by trying."""
    times = _times_too_large(element, placed)
    count = np.ceil(times * element.wanted.count)
    if count > MOST_COUNT:
        why = (
            "foam beside panels takes all of them" if np.isinf(times) else f"{MOST_COUNT} at most are divided"
        )
        return f"no count makes panels that these blocks hold, as {why}: give larger blocks"
    if count > TRIED_TO:
        less = " and ".join(f"{name}: {v:g}" for name, v in _less(element.wanted, count).items())
        return f"by area it takes about count: {count:.0f} for these blocks, with {less}, which was not tried"
    return "give larger blocks"


def _smaller(
    element: HexagonElement, placed: Sequence[_Placed]
) -> Iterator[tuple[dict[str, Any], float | None]]:
    """Changes to try where blocks do not hold all panels, the least first: the thickness [mm] of the thickest
    block, and more panels by as much as they are too large; then with the least edge and width smaller by as
    much."""
    wanted = element.wanted
    most = max(block.size_mm[2] for block in element.file.blocks)
    thickness = most if most < element.file.thickness_mm else None
    times = _times_too_large(element, placed)
    if thickness is not None:
        yield {}, thickness
    if times <= 1.0:
        return
    counts = [np.ceil(share * times * wanted.count) for share in COUNT_SHARES]
    counts = [int(count) for count in counts if count <= TRIED_TO]
    for count in counts:
        yield {"count": count}, thickness
    for count in counts[-1:]:
        yield {"count": count, **_less(wanted, count)}, thickness


def _less(wanted: HexagonsFile, count: float) -> dict[str, float]:
    """The least edge and width [mm] of as many panels, smaller as these are."""
    share = LESS * np.sqrt(wanted.count / count)
    names = ("least_edge_mm", "least_width_mm")
    return {name: float(max(np.floor(share * getattr(wanted, name)), 1.0)) for name in names}


def _changes(
    element: HexagonElement, issues: Sequence[Issue], bent: bool
) -> Iterator[tuple[dict[str, Any], float | None]]:
    """Changes to try where panels do not keep the limits of their shapes, the least first: fields of
    ``hexagons``, thickness [mm]; ``bent``: panels lie where the surface bends both ways."""
    wanted, thick = element.wanted, element.file.thickness_mm
    if bent:
        yield {"shape": "quad" if wanted.shape == "hexagon" else "hexagon"}, None
    if wanted.rim == "upright":
        yield {"rim": "square"}, None
    limits = {
        str(i.field).rsplit(".", 1)[-1]: float(i.value or 0.0) for i in issues if i.field != "panels.hexagons"
    }
    if len(limits) == len(issues):
        for share in (1.0, 0.7):
            allowed = {
                name: float(np.ceil(value) if name == "off_surface_mm" else np.floor(share * value))
                for name, value in limits.items()
            }
            if min(allowed.values()) >= 1.0:
                yield allowed, None
    for share in (0.75, 1.5):
        yield {"count": max(round(share * wanted.count), LEAST_COUNT)}, None
    yield {}, float(np.floor(0.7 * thick))


def _serves(element: HexagonElement) -> bool:
    """Whether a shell can be made."""
    try:
        made = _shell(element)
    except TandemError:
        return False
    limits = _limits(element, made.check)
    return not any(one.over.any() for one in limits) and all(
        _in_block(element, panel).block is not None for panel in made.panels
    )
