"""The kind ``elastic``: a free-form surface divided into panels whose faces a bent wire cuts.

Which rectangles of the grid may be panels says a table: the misfit of every section for every wire and both
directions, and the box of the panel in every block. The cheapest guillotine division of that is exact
(`geometry/guillotine.py`). Then each of its panels is fitted again in the planes of its own tilted block,
front and back, by a wire that is held safely there where one is. A panel that is out of tolerance there, or
that the check of its own problem refuses, is struck off the table, and the division is made anew.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from planner.element.elastic_panel import ElasticPanel, Joint, joints
from planner.element.follow import Lead, lead
from planner.element.misfit import (
    MISFIT_STEP,
    SECTIONS_PER_CELL,
    misfits,
    section_places,
    sections_of,
    worst_over,
)
from planner.element.panel_box import Nodes, block_axes, box_sizes, grid_nodes, plane_normals
from planner.element.panel_faces import CutWire, bend, cut_out, holds
from planner.element.surface import ElementSurface, Profile, profiles
from planner.geometry.arrays import BoolArray, FloatArray, from_parts
from planner.geometry.guillotine import Division, divide
from planner.geometry.mesh import TriangleMesh, vertex_normals
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal

FITS: Final = 1e-6
"""A panel that is larger than its block by no more than this [m] fits."""
WELL_WITHIN: Final = 0.5
"""Share of the tolerance below which a shorter wire counts more than a smaller misfit."""
_MOST_ROUNDS = 200
"""Divisions that are tried at most, each without the panels that failed in the one before."""
_MOST_JUDGED = 100
"""The same where panels are struck off by their check: then the first division stands, with its reasons."""
_MOST_EVENED = 20
"""Divisions with evener joints that are taken at most, each after the one before."""
_WORST_JOINTS = 5
"""Joints beyond the limit of which panels are struck off to find one."""
_LESS = 0.9
"""Share of the limit up to which steps count as even: the programs add their own."""
_SURE = 1e-3  # m: how much more room is advised than nodes between which a surface is bent need
_THINNER = 1e-3
"""Steps [m] in which a thickness is sought that would fit."""


@dataclasses.dataclass(frozen=True)
class Rules:
    """What panels are held to: wires, shortest first, sizes (3,) of ``blocks`` and the foam that a block has
    more than its panel at each side, ``sides`` and ``faces`` (above and below); ``tolerance`` of a face;
    weight of the ends of sections; the step that a ``joint`` of two panels should keep. All in m."""

    wires: tuple[CutWire, ...]
    blocks: tuple[FloatArray, ...]
    sides: float
    faces: float
    tolerance: float
    end_weight: float
    joint: float = np.inf


Judge = Callable[[ElasticPanel], Issue | None]
"""Why a panel's problem as it will be written is refused, None where it is not."""


@dataclasses.dataclass(frozen=True)
class Search:
    """An element and its grid: ``lines`` across x (nx + 1,) and y (ny + 1,) [m], what every rule asks of
    it."""

    surface: ElementSurface
    lines: tuple[FloatArray, FloatArray]
    rules: Rules
    profiles: tuple[Profile, Profile]
    nodes: Nodes

    @property
    def cells(self) -> tuple[int, int]:
        """Cells along x and y."""
        return len(self.lines[0]) - 1, len(self.lines[1]) - 1


def search(surface: ElementSurface, cells: tuple[int, int], rules: Rules) -> Search:
    """What the table and the division start from. Raises ``TandemError``: ``element.surface``."""
    x, y = (np.linspace(0.0, surface.size[i], cells[i] + 1) for i in range(2))
    along = (
        profiles(surface.front, surface.size, 0, section_places(y)),
        profiles(surface.front, surface.size, 1, section_places(x)),
    )
    return Search(surface, (x, y), rules, along, grid_nodes(surface, *cells))


@dataclasses.dataclass(frozen=True)
class Table:
    """Rectangles (nx, ny, nx, ny), [w - 1, h - 1, x, y]: ``boxes`` (2, ...): whether a block holds the panel
    with its wire along x and along y; ``misfits`` [m], one for each way, an index over wires and directions
    (2 wire + along), infinite where no block holds it or the wire does not reach; single cells have theirs
    whatever their boxes."""

    boxes: BoolArray
    misfits: tuple[FloatArray, ...]

    def best(self, tolerance: float) -> FloatArray:
        """The least misfit of each rectangle, infinite where nothing makes it."""
        limit = tolerance + 0.5 * MISFIT_STEP
        best = np.full(self.boxes.shape[1:], np.inf)
        for number, found in enumerate(self.misfits):
            better = self.boxes[number % 2] & (found <= limit) & (found < best)
            best[better] = found[better]
        return best

    def ways(self, place: tuple[int, int, int, int], tolerance: float) -> list[int]:
        """All ways to make one rectangle: those well within the tolerance first, with the shortest wire
        first, since that holds best against errors of its ends; then by misfit."""
        found = {
            number: float(one[place])
            for number, one in enumerate(self.misfits)
            if self.boxes[(number % 2, *place)] and one[place] <= tolerance + 0.5 * MISFIT_STEP
        }

        def rank(number: int) -> tuple[float, float, int]:
            well = found[number] < WELL_WITHIN * tolerance
            return (0.0, number // 2, number) if well else (1.0, found[number], number)

        return sorted(found, key=rank)


def table(made: Search, held: bool = False) -> Table:
    """Which rectangles a block holds, and how well wires meet those; ``held``: wires that are not held safely
    in a section do not meet it."""
    nx, ny = made.cells
    rules = made.rules
    boxes = np.zeros((2, nx, ny, nx, ny), dtype=np.bool_)
    small = _small_enough(made)
    for along in range(2):
        sizes = box_sizes(made.nodes, small, along)
        boxes[along] = np.any([_fits(sizes, block, rules) for block in rules.blocks], axis=0)
    found = []
    for cut in rules.wires:
        for along in range(2):
            asked = boxes[along].copy()
            asked[0, 0] = True
            asked = asked if along == 0 else asked.transpose(1, 0, 3, 2)
            fitted = misfits(
                made.profiles[along],
                made.lines[along],
                sections_of(asked),
                cut.length,
                cut.outside,
                cut.wire.load,
                rules.end_weight,
                functools.partial(holds, cut=cut) if held else None,
            )
            worst = worst_over(fitted, (ny, nx)[along])
            found.append(worst if along == 0 else worst.transpose(1, 0, 3, 2))
    return Table(boxes, tuple(found))


def _small_enough(made: Search) -> BoolArray:
    """Rectangles (nx, ny, nx, ny) in the grid that are no longer in plan than the diagonal of a block."""
    nx, ny = made.cells
    longest = max(float(np.linalg.norm(block)) for block in made.rules.blocks)
    w, h, x, y = np.ogrid[1 : nx + 1, 1 : ny + 1, 0:nx, 0:ny]
    step = made.surface.size / (nx, ny)
    return np.asarray((x + w <= nx) & (y + h <= ny) & (np.maximum(w * step[0], h * step[1]) <= longest))


def _needed(sizes: FloatArray, rules: Rules) -> FloatArray:
    """Blocks (..., 3) that boxes need, the longer side first."""
    flat = np.sort(sizes[..., :2], axis=-1)[..., ::-1] + 2.0 * rules.sides
    return np.concatenate([flat, sizes[..., 2:] + 2.0 * rules.faces], axis=-1)


def _fits(sizes: FloatArray, block: FloatArray, rules: Rules) -> BoolArray:
    longest, shortest = max(block[:2]), min(block[:2])
    return np.asarray((_needed(sizes, rules) <= np.array([longest, shortest, block[2]]) + FITS).all(axis=-1))


def divide_elastic(made: Search, judge: Judge | None = None, held: bool = False) -> tuple[ElasticPanel, ...]:
    """The panels of the best division, by rows of the grid.

    ``held``: panels in which no wire is held safely are struck off, as if they were out of tolerance;
    ``judge`` also strikes off those that it refuses. Those without which nothing covers the element stay, the
    smallest, with the reason. Raises ``TandemError``: ``element.wire``, ``element.tolerance``,
    ``element.block`` for places that no panel can cover, each with the nearest remedy.
    """
    held = held or judge is not None
    fits = _Fits(made, table(made, held), held, judge)
    misfit = fits.table.best(made.rules.tolerance)
    struck: dict[_Place, float] = {}
    for _ in range(_MOST_ROUNDS if judge is None else _MOST_JUDGED):
        division = divide(misfit)
        if division is None and not struck and held:
            fits.table = table(made)
            every = fits.table.best(made.rules.tolerance)
            for w, h, x, y in np.argwhere(every < misfit).tolist():
                struck[w, h, x, y] = float(every[w, h, x, y])
        if division is None and not struck:
            raise TandemError(list(_refusals(made, fits.table, misfit)))
        if division is None:
            least = min((w + 1) * (h + 1) for w, h, _, _ in struck)
            for place in [p for p in struck if (p[0] + 1) * (p[1] + 1) == least]:
                price, best = struck.pop(place), _first(_tries(made, fits.table, place))
                if best is not None:
                    misfit[place] = price
                    fits.keep(
                        place, best if judge is None else dataclasses.replace(best, refused=judge(best))
                    )
            continue
        places = _places(division)
        # the check takes longest: it comes when all else is well
        failed = [p for p in places if fits.at(p) is None] or [p for p in places if not fits.passes(p)]
        if not failed:
            return _joined(fits, misfit, places)
        for place in failed:
            if held:
                struck[place] = float(misfit[place])
            misfit[place] = np.inf
    if held:
        first = divide_elastic(made)
        return first if judge is None else tuple(dataclasses.replace(p, refused=judge(p)) for p in first)
    what = f"after {_MOST_ROUNDS} divisions some panels still fail in the planes of their own blocks"
    raise refusal("element.tolerance", what, field="panels.elastic", hint="allow more, or take more cells")


_Place = tuple[int, int, int, int]
"""Where a rectangle is in a table: w - 1, h - 1, x, y."""


def _places(division: Division) -> list[_Place]:
    return [(x1 - x0 - 1, y1 - y0 - 1, x0, y0) for x0, x1, y0, y1 in division.rectangles.tolist()]


class _Fits:
    """Panels by their places in a table, each fitted once: by the first wire and direction in which it is
    within tolerance, and held where that is asked; None where there is none."""

    def __init__(self, made: Search, found: Table, held: bool, judge: Judge | None) -> None:
        self.made, self.table, self.held, self.judge = made, found, held, judge
        self._known: dict[_Place, ElasticPanel | None] = {}
        self._tries: dict[_Place, Iterator[ElasticPanel]] = {}
        self._passed: set[_Place] = set()
        self._led: dict[tuple[_Following, int, int], ElasticPanel | None] = {}

    def at(self, place: _Place) -> ElasticPanel | None:
        """The panel at a place."""
        if place not in self._known:
            tries = _tries(self.made, self.table, place)
            if self.held:
                self._tries[place] = (panel for panel in tries if panel.held)
                self._known[place] = next(self._tries[place], None)
            else:
                self._known[place] = _first(tries)
        return self._known[place]

    def keep(self, place: _Place, panel: ElasticPanel) -> None:
        """Take a panel as it is."""
        self._known[place] = panel
        self._passed.add(place)

    def passes(self, place: _Place) -> bool:
        """Whether one of the wires held in a panel's shapes is not refused: from then on, the panel is cut by
        that."""
        if place not in self._passed and self.judge is not None:
            while (panel := self._known[place]) is not None and not self.accepts(panel):
                self._known[place] = next(self._tries[place], None)
        self._passed.add(place)
        return self._known[place] is not None

    def led(self, who: "_Following", panel: ElasticPanel, leads: tuple[Lead, ...]) -> ElasticPanel | None:
        """A panel that follows others (`_panel`), each fitted once: ``who`` tells it by all that it
        follows."""
        known = who, panel.wire, panel.along
        if known not in self._led:
            way = 2 * panel.wire + panel.along
            self._led[known] = _panel(self.made, panel.rectangle, way, leads)
        return self._led[known]

    def accepts(self, panel: ElasticPanel) -> bool:
        """Whether the judge refuses nothing of a panel, or there is none."""
        return self.judge is None or self.judge(panel) is None

    def panels(self, places: Sequence[_Place]) -> tuple[ElasticPanel, ...]:
        """Those at all places that have one."""
        return tuple(panel for place in places if (panel := self.at(place)) is not None)

    def division(self, price: FloatArray, most: int) -> list[_Place] | None:
        """The best division of which every panel is within tolerance; None where it takes more than
        ``most``."""
        price = price.copy()
        for place in [place for place, panel in self._known.items() if panel is None]:
            price[place] = np.inf
        while True:
            found = divide(price)
            if found is None or len(found.rectangles) > most:
                return None
            places = _places(found)
            failed = [place for place in places if self.at(place) is None]
            if not failed:
                return places
            for place in failed:
                price[place] = np.inf


def _joined(fits: _Fits, price: FloatArray, places: list[_Place]) -> tuple[ElasticPanel, ...]:
    """The panels of a division at ``price``, of which some follow a neighbour, or of another one with as few
    panels and fewer joints beyond the limit.

    How far a panel is off the surface along a joint is known when it is fitted, and the step is between two
    of them: no price of a panel alone says it. So panels at the worst joints are struck off, one at a time,
    and the best of the divisions without is gone on from, until none has fewer joints beyond the limit."""
    limit = fits.made.rules.joint
    panels = _led(fits, fits.panels(places))
    least = _unevenness(panels, limit)
    for _ in range(_MOST_EVENED):
        tried: list[tuple[tuple[int, int], int, FloatArray, list[_Place]]] = []
        for k in dict.fromkeys(k for joint in _beyond(panels, limit) for k in joint.panels):
            without = price.copy()
            without[places[k]] = np.inf
            anew = fits.division(without, len(places))
            if anew is not None:
                uneven = _unevenness(_led(fits, fits.panels(anew)), limit)
                tried.append((uneven, len(tried), without, anew))
        for uneven, _, without, anew in sorted(tried, key=lambda one: one[:2]):
            if uneven[0] >= least[0]:
                return panels
            if not all(fits.passes(place) for place in anew):
                continue
            led = _led(fits, fits.panels(anew))
            if _unevenness(led, limit) <= uneven:
                least, price, places, panels = uneven, without, anew, led
                break
        else:
            return panels
    return panels


def _beyond(panels: Sequence[ElasticPanel], limit: float) -> list[Joint]:
    """The worst joints beyond the limit, worst first."""
    over = sorted((one for one in joints(panels) if one.step > limit), key=lambda one: -one.step)
    return over[:_WORST_JOINTS]


def _led(fits: _Fits, panels: tuple[ElasticPanel, ...]) -> tuple[ElasticPanel, ...]:
    """The panels, of which one at each joint beyond the limit follows the other (`follow`), as far as fewer
    joints are beyond it then: at the worst joint where that helps, on the side where it helps more."""
    limit = fits.made.rules.joint
    following: list[_Following] = [(panel.rectangle, ()) for panel in panels]
    leads: dict[int, dict[int, Lead]] = {}
    least = _unevenness(panels, limit)
    for _ in range(_MOST_EVENED):
        for joint in _beyond(panels, limit):
            best: tuple[tuple[int, int], int, int, Lead, tuple[ElasticPanel, ...]] | None = None
            for k, one in enumerate(joint.panels):
                other = joint.panels[1 - k]
                more = lead(joint, 1 - k, panels[other])
                who = _after(following, one, other)
                panel = fits.led(who, panels[one], tuple({**leads.get(one, {}), other: more}.values()))
                if panel is None or panel.held < panels[one].held:
                    continue
                anew = (*panels[:one], panel, *panels[one + 1 :])
                uneven = _unevenness(anew, limit)
                if uneven < (least if best is None else best[0]) and fits.accepts(panel):
                    best = uneven, one, other, more, anew
            if best is not None:
                least, one, other, more, panels = best
                following[one] = _after(following, one, other)
                leads.setdefault(one, {})[other] = more
                break
        else:
            return panels
    return panels


_Following = tuple[tuple[int, int, int, int], tuple[object, ...]]
"""The rectangle of a panel, and the same of those that it follows, in order."""


def _after(following: Sequence[_Following], one: int, other: int) -> _Following:
    """What a panel is when it follows an other one, too: as that is now, whatever it was before."""
    rectangle, others = following[one]
    kept = [who for who in others if isinstance(who, tuple) and who[0] != following[other][0]]
    return rectangle, (*kept, following[other])


def _unevenness(panels: Sequence[ElasticPanel], limit: float) -> tuple[int, int]:
    """How many joints are beyond the limit, and how far joints are above what counts as even, in steps of
    misfits, added up; nothing without a limit."""
    if not np.isfinite(limit):
        return 0, 0
    steps = [joint.step for joint in joints(panels)]
    return sum(step > limit for step in steps), sum(
        max(0, round((step - _LESS * limit) / MISFIT_STEP)) for step in steps
    )


def _tries(made: Search, found: Table, place: _Place) -> Iterator[ElasticPanel]:
    """The panel by each wire and direction that is within tolerance in its block."""
    w, h, x, y = place
    for way in found.ways(place, made.rules.tolerance):
        panel = _panel(made, (x, x + w + 1, y, y + h + 1), way)
        if panel is not None:
            yield panel


def _first(panels: Iterator[ElasticPanel]) -> ElasticPanel | None:
    """The first panel whose wire is held safely, else the first of all."""
    best = None
    for panel in panels:
        if panel.held:
            return panel
        best = best or panel
    return best


def _panel(
    made: Search, rectangle: tuple[int, int, int, int], way: int, leads: Sequence[Lead] = ()
) -> ElasticPanel | None:
    """The panel in its block, its faces where ``leads`` say at joints; None where a face is off the wire, or
    then off the surface, by more than the tolerance, or no block holds it."""
    number, along = divmod(way, 2)
    cut, rules = made.rules.wires[number], made.rules
    x0, x1, y0, y1 = rectangle
    x, y = made.lines
    bounds = float(x[x0]), float(x[x1]), float(y[y0]), float(y[y1])
    front, back = cut_out(made.surface.front, made.surface.back, bounds)
    axes = block_axes(plane_normals(made.nodes.under(rectangle)), along)
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
    wanted = sum((lead.over(flat) for lead in leads), np.zeros((2, len(flat))))
    made_faces, off, misfit, held = [], [], 0.0, True
    for mesh, out in zip((front, back), wanted, strict=True):
        rise = out / np.abs(vertex_normals(mesh)[:, 2]) if leads else out  # upright, as faces are moved
        laid = TriangleMesh(mesh.vertices @ axes.T - origin + rise[:, None] * axes[:, 2], mesh.faces)
        bent = bend(laid, axes[:, 2], cut, 0.5 * float(size[0]), rules.end_weight)
        if bent is None:
            return None
        whole = bent.off + out
        # sections see more than vertices do
        far = bent.misfit + float(np.abs(whole).max() - np.abs(bent.off).max())
        if max(far, bent.misfit) > rules.tolerance + 0.5 * MISFIT_STEP:
            return None
        moved = laid.vertices + bent.shift[:, None] * axes[:, 2]
        made_faces.append(TriangleMesh(moved, laid.faces))
        off.append(whole)
        misfit, held = max(misfit, far), held and bent.held
    rim = np.any(
        [flat[:, 0] == bounds[0], flat[:, 0] == bounds[1], flat[:, 1] == bounds[2], flat[:, 1] == bounds[3]],
        axis=0,
    )
    turned = TriangleMesh(made_faces[1].vertices, made_faces[1].faces[:, ::-1])
    return ElasticPanel(
        rectangle,
        along,
        number,
        best,
        pose,
        size,
        made_faces[0],
        turned,
        misfit,
        held,
        flat[rim],
        np.stack(off)[:, rim],
    )


def _refusals(made: Search, found: Table, misfit: FloatArray) -> Iterator[Issue]:
    """Why cells can be no panel even alone: one issue for each cause, of the cell that is farthest from its
    limit."""
    rules, (nx, ny) = made.rules, made.cells
    single = [np.asarray(one[0, 0]) for one in found.misfits]
    least = np.min(single, axis=0)
    alone = ~np.isfinite(misfit[0, 0])
    short = alone & ~np.isfinite(least)
    far = alone & ~short & (least > rules.tolerance + 0.5 * MISFIT_STEP)
    if short.any():
        needs = np.stack([_longest(made, along) for along in range(2)]).min(axis=0)
        at = np.unravel_index(int(np.argmax(np.where(short, needs, -1.0))), short.shape)
        need = float(needs[at]) + min(cut.outside for cut in rules.wires)
        longest = max(cut.length for cut in rules.wires)
        what = (
            f"{_where(made, at)}: its sections and the wire's free ends take {need / MM:.0f} mm, the longest "
            f"wire has {longest / MM:.0f} mm"
        )
        hint = f"give a wire of {np.ceil(need / MM / 5.0) * 5.0:.0f} mm, or more cells than {nx} x {ny}"
        yield _limit("element.wire", what, "panels.elastic.wires", longest, need, hint, short)
    if far.any():
        at = np.unravel_index(int(np.argmax(np.where(far, least, -1.0))), far.shape)
        worst = float(least[at])
        what = (
            f"{_where(made, at)}: the best wire is {worst / MM:.2f} mm off the surface, allowed are "
            f"{rules.tolerance / MM:g} mm"
        )
        hint = (
            f"allow tolerance_mm: {np.ceil(worst / MM * 100.0) / 100.0 + 0.01:.2f}, give more cells than "
            f"{nx} x {ny}, or smooth the surface if that is noise"
        )
        yield _limit(
            "element.tolerance", what, "panels.elastic.tolerance_mm", worst, rules.tolerance, hint, far
        )
    large = alone & ~short & ~far & ~found.boxes[:, 0, 0].any(axis=0)
    if large.any():
        yield _too_large(made, large)
    left = alone & ~short & ~far & ~large
    if left.any() and not (short | far | large).any():
        at = np.unravel_index(int(np.argmax(left)), left.shape)
        what = f"{_where(made, at)}: it is at the very limit of its block or of the tolerance, and beyond it "
        what += "where it is measured by its facets"
        hint = f"allow 0.1 mm more of tolerance_mm, 1 mm more of blocks, or more cells than {nx} x {ny}"
        most = rules.tolerance
        yield _limit("element.tolerance", what, "panels.elastic", most, most, hint, left)


def _limit(
    code: str, what: str, field: str, value: float, limit: float, hint: str, cells: BoolArray
) -> Issue:
    """``element.*`` for cells that can be no panel, of which ``what`` names the worst."""
    return Issue(
        code,
        f"{int(cells.sum())} of the cells can be no panel even alone, the worst is {what}",
        field=field,
        **measurement(value / MM, limit / MM, "mm"),
        hint=hint,
    )


def _where(made: Search, at: tuple[np.intp, ...]) -> str:
    place = " x ".join(
        f"{made.lines[i][at[i]] / MM:.0f} to {made.lines[i][at[i] + 1] / MM:.0f}" for i in range(2)
    )
    return f"the cell {at[0] + 1}, {at[1] + 1} ({place} mm)"


def _longest(made: Search, along: int) -> FloatArray:
    """Length [m] of the longest section along an axis in each cell (nx, ny)."""
    profile, lines = made.profiles[along], made.lines[along]
    arc = np.stack(
        [
            np.diff(np.interp(lines, place, length))
            for place, length in zip(profile.place, profile.length, strict=True)
        ]
    )
    parts = SECTIONS_PER_CELL
    longest = np.max([arc[i : len(arc) - parts + i : parts] for i in range(parts + 1)], axis=0)
    return np.asarray(longest.T if along == 0 else longest)


def _too_large(made: Search, cells: BoolArray) -> Issue:
    """Cells whose boxes fit no block: what would hold the worst of them, and the thickness that would fit."""
    rules = made.rules

    def needed(nodes: Nodes) -> FloatArray:
        only = np.zeros((*made.cells, *made.cells), dtype=np.bool_)
        only[0, 0] = cells
        return np.stack([_needed(box_sizes(nodes, only, along)[0, 0], rules) for along in range(2)])

    def excess(sizes: FloatArray) -> FloatArray:
        limits = np.array([[max(b[:2]), min(b[:2]), b[2]] for b in rules.blocks])
        over = (sizes[:, None] - limits[:, None, None]).max(axis=-1)  # (2, blocks, nx, ny)
        return np.asarray(np.where(cells, over.min(axis=(0, 1)), -np.inf))

    sizes = needed(made.nodes)
    over = excess(sizes)
    at = np.unravel_index(int(np.argmax(over)), over.shape)
    way = np.argmin(sizes.max(axis=-1), axis=0)[None, ..., None]
    size = np.take_along_axis(sizes, way, axis=0)[0][cells].max(axis=0)  # what holds all of them
    worst = float(over[at])
    text = " x ".join(f"{np.ceil((v + _SURE) / MM):.0f}" for v in size)
    thickness = None
    for thin in np.arange(made.surface.thickness - _THINNER, 0.0, -_THINNER):
        back = made.nodes.front + (made.nodes.back - made.nodes.front) * (thin / made.surface.thickness)
        if (excess(needed(dataclasses.replace(made.nodes, back=back))) <= -_SURE).all():
            thickness = float(thin)
            break
    fits = f"thickness_mm: {np.floor(thickness / MM + 1e-6):.0f} would fit, " if thickness is not None else ""
    what = f"{_where(made, at)}: with foam around it no block holds it by {worst / MM:.1f} mm"
    hint = f"{fits}a block of {text} mm would, or give more cells than {made.cells[0]} x {made.cells[1]}"
    largest = max(rules.blocks, key=lambda block: float(np.prod(block)))
    return _limit("element.block", what, "blocks", float(size[2]), float(largest[2]), hint, cells)
