"""Walls of a part: runs of the contour tree that go one way, cut at terraces; each is a feature.

**Skeleton**: what of a contour tree is meant: places where features begin and end, and walls
between them. A branch that does not leave the height of its fork by ``noise`` is no feature, nor is
the lesser one of two that is smaller in plan than any tool: its vertices count as part of the fork.
Forks within ``noise`` of each other are one place, as those are that noise makes on a flat.

**Terraces**: where a wall pauses on a flat, a feature ends and the next one begins. A wall that
goes on after a flat in the same direction (a stepped dish, a dimple alone in a floor) has level
lines that nest in one another throughout; the flat shows only in the plan area that they enclose,
which changes at once. Between the levels ``noise`` apart the mean width of the surface in plan is
the change over the length of the line.

**Walls** are the maximal runs of a skeleton that go one way, cut at terraces.
"""

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from planner.geometry.arrays import BoolArray, FloatArray, IntArray
from planner.processes.forming.plan.features.surface import ContourTree, SheetSurface, plan_areas

FLAT_WIDTH: Final = 1e-3
"""Mean width [m] in plan, within a height of ``noise``, from which on a flat may be a terrace: 3 degrees."""
RADIUS_SHARE: Final = 0.1
"""The same as a share of the radius of a circle as large as the feature there, where that is less."""
LEAST_WIDTH: Final = 0.4e-3
"""Mean width [m] below which nothing is a terrace."""
TERRACE_CONTRAST: Final = 3.0
"""How many times wider a terrace is than the wall is somewhere before it and somewhere after it."""
WALL_HEIGHTS: Final = 2.0
"""Height of those walls at least, in units of ``noise``."""


@dataclasses.dataclass(frozen=True)
class Terrace:
    """``level`` [m] at which one feature ends and the next one begins; level lines are clean before ``first``
    and after ``last`` [m], in the direction of the wall."""

    level: float
    first: float
    last: float


class _Passed:
    """Plan area that lies before a depth, each face's spread evenly over its depths."""

    def __init__(self, near: FloatArray, far: FloatArray, area: FloatArray) -> None:
        rate = area / (far - near)
        order_near, order_far = np.argsort(near), np.argsort(far)
        self.near, self.far = near[order_near], far[order_far]
        self.sums = tuple(
            np.concatenate([[0.0], np.cumsum(values)])
            for values in (
                rate[order_near],
                (rate * near)[order_near],
                rate[order_far],
                (rate * far)[order_far],
            )
        )

    def __call__(self, depth: FloatArray) -> FloatArray:
        i, j = np.searchsorted(self.near, depth), np.searchsorted(self.far, depth)
        begun, begun_at, ended, ended_at = self.sums
        return np.asarray(depth * begun[i] - begun_at[i] - depth * ended[j] + ended_at[j])


def find_terraces(
    low: FloatArray, high: FloatArray, area: FloatArray, inside: float, start: float, end: float, noise: float
) -> list[Terrace]:
    """Terraces of a wall from level ``start`` to ``end`` [m], in its order.

    ``low``, ``high`` and ``area`` (F,): between which levels [m] each face lies, and its plan area [m^2].
    ``inside`` [m^2]: plan area that the wall's first level line encloses.
    """
    total = abs(end - start)
    if total < 2.0 * WALL_HEIGHTS * noise or len(area) == 0:
        return []
    sign = 1.0 if end > start else -1.0
    near = np.clip(np.where(sign > 0, low - start, start - high), 0.0, total)
    far = np.clip(np.where(sign > 0, high - start, start - low), 0.0, total)
    cell = noise / 5.0
    at = np.arange(0.5 * cell, total, cell)
    passed = _Passed(near, np.maximum(far, near + 0.01 * cell), area)
    change = passed(at + 0.5 * noise) - passed(at - 0.5 * noise)
    radius = np.sqrt(np.maximum(inside - passed(at - 0.5 * noise), 1e-12) / np.pi)
    width = change / (2.0 * np.pi * radius)
    flat = width >= np.maximum(
        np.clip(RADIUS_SHARE * radius, LEAST_WIDTH, FLAT_WIDTH),
        TERRACE_CONTRAST * _walled(width, noise / cell),
    )
    bounds = np.nonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))[0].reshape(-1, 2)
    return [_terrace(begin * cell, stop * cell, passed, start, sign, noise) for begin, stop in bounds]


def _walled(width: FloatArray, cells: float) -> FloatArray:
    """For each cell of height the width of the steepest wall before it, or after it if that is wider; where
    there is no wall on a side, infinite."""
    tall = round(WALL_HEIGHTS * cells)
    before = np.full(len(width), np.inf)
    after = before.copy()
    if len(width) > tall:
        widest = sliding_window_view(width, tall).max(axis=1)
        before[tall:] = np.minimum.accumulate(widest)[:-1]
        after[:-tall] = np.minimum.accumulate(widest[::-1])[::-1][1:]
    return np.asarray(np.maximum(before, after))


def _terrace(begin: float, stop: float, passed: _Passed, start: float, sign: float, noise: float) -> Terrace:
    # the window of heights makes a flat seem half of it higher on both sides
    begin, stop = sorted((begin + 0.5 * noise, stop - 0.5 * noise))
    cell = noise / 5.0
    if stop - begin > noise:  # it slopes: its own level lines belong to the wall before it
        # the steeper it is, the farther ahead of its end the window has too much of the wall behind it
        rate = float(np.diff(passed(np.array([begin, stop])))[0]) / (stop - begin)
        depths = np.linspace(stop, stop + 1.5 * noise, 76)
        wide = passed(depths + 0.5 * cell) - passed(depths - 0.5 * cell) >= 0.5 * rate * cell
        stop = float(depths[np.flatnonzero(wide)].max(initial=stop))
        # at vertices: below a level between them a facet of the terrace would reach back to those before
        vertex = float(passed.far[np.argmin(np.abs(passed.far - stop))])
        stop = vertex if abs(vertex - stop) <= noise else stop
        levels = (stop, stop - cell, stop + cell)
        return Terrace(*(start + sign * level for level in levels))
    depths = np.linspace(begin - cell, stop + cell, 201)
    areas = passed(depths)
    middle = float(np.interp(0.5 * (areas[0] + areas[-1]), areas, depths))
    return Terrace(
        start + sign * middle,
        start + sign * min(begin - cell, middle - 0.1 * cell),
        start + sign * max(stop + cell, middle + 0.1 * cell),
    )


EXACT_HEIGHT: Final = 1e-6
"""Heights [m] that differ by less are those of a mesh without noise."""
LEAST_AREA: Final = 3e-6
"""Plan area [m^2], 2 mm across, below which a bump is one of facets that do not follow a crease."""


@dataclasses.dataclass(frozen=True)
class Place:
    """A flat, a saddle or an end, on which walls begin or end: its ``level`` [m], how far ``off`` [m]
    it noise takes its vertices, and the place from which a wall leads here (-1 for the flat sheet)."""

    level: float
    off: float
    before: int


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """Places, each after the one before it, and where the vertices are. ``element`` (N,): 2 p at place p,
    2 p + 1 on the wall that leads to place p. ``height`` (N,) [m]: the surface without what is noise."""

    places: tuple[Place, ...]
    element: IntArray
    height: FloatArray

    def onward(self, place: int) -> list[int]:
        """The places to which walls lead from one."""
        return [index for index, other in enumerate(self.places) if other.before == place]

    def direction(self, place: int) -> int:
        """+1 where the wall to a place rises, -1 where it goes down."""
        return 1 if self.places[place].level > self.places[self.places[place].before].level else -1


Size = Callable[[list[int], float], float]
"""Plan area [m^2] of what of the surface around some vertices lies beyond a level [m]."""


def skeleton(
    tree: ContourTree, height: FloatArray, weight: FloatArray, size: Size, noise: float, level: float
) -> Skeleton:
    """The skeleton of a contour tree of ``height`` (N,) [m] whose root is the flat sheet at ``level`` [m].

    ``weight`` (N,): plan area of the vertices [m^2], by which a noisy flat's level is the median.
    """
    return _Builder(tree, height, weight, size, noise).build(level)


def _floats(values: FloatArray) -> list[float]:
    """Single numbers of a list are got at several times faster than those of an array."""
    return list(map(float, values))


class _Builder:
    def __init__(
        self, tree: ContourTree, height: FloatArray, weight: FloatArray, size: Size, noise: float
    ) -> None:
        self.weight, self.size = weight, size
        self.tree, self.noise, self.z = tree, noise, _floats(height)
        self.low, self.high = _floats(tree.low), _floats(tree.high)
        self.rank: list[int] = tree.rank.tolist()
        inner = tree.order[1:]
        above = tree.parent[inner]
        grouped = np.argsort(above, kind="stable")
        self.begin: list[int] = np.concatenate(
            [[0], np.cumsum(np.bincount(above, minlength=len(height)))]
        ).tolist()
        self.after: list[int] = inner[grouped].tolist()
        reach = np.maximum(tree.high[inner] - height[above], height[above] - tree.low[inner]) >= noise
        matters = np.zeros(len(height), dtype=bool)
        matters[inner] = reach
        self.matters: list[bool] = matters.tolist()
        forks = np.bincount(above[reach], minlength=len(height)) > 1
        self._drop_small(np.nonzero(forks)[0].tolist())
        self.element = np.full(len(height), -1, dtype=np.int64)
        self.before: list[int] = [-1]
        self.ends: dict[int, int] = {}

    def _drop_small(self, forks: list[int]) -> None:
        for fork in forks:
            branches = sorted(self.onward(fork), key=lambda child: self._beyond(child, self.z[fork]))
            for branch in branches[:-1]:
                members = self._few(branch)
                if members and self.size(members, self.z[fork]) < LEAST_AREA:
                    self.matters[branch] = False

    def _few(self, vertex: int) -> list[int]:
        """The vertices from one on; none where they are clearly not small."""
        members, total = [vertex], 0.0
        for member in members:
            total += self.weight[member]
            if total > 10.0 * LEAST_AREA:
                return []
            members.extend(self.children(member))
        return members

    def children(self, vertex: int) -> list[int]:
        return self.after[self.begin[vertex] : self.begin[vertex + 1]]

    def onward(self, vertex: int) -> list[int]:
        return [child for child in self.children(vertex) if self.matters[child]]

    def build(self, level: float) -> Skeleton:
        self.element[self.tree.root] = 0
        reference = [level]
        open_: list[tuple[int, int]] = [(self.tree.root, 0)]
        while open_:
            vertex, place = open_.pop()
            for child in self.onward(vertex):
                path, is_end = self._wall(vertex, child)
                last = path[-1]
                if is_end and self._beyond(child, reference[place]) < self.noise:
                    self.element[path] = 2 * place
                    continue
                if not is_end and abs(self.z[last] - reference[place]) < self.noise:
                    self.element[path] = 2 * place
                    open_.append((last, place))
                    continue
                new = len(self.before)
                self.before.append(place)
                reference.append(self.z[last])
                self.element[path[:-1]] = 2 * new + 1
                self.element[last] = 2 * new
                if is_end:
                    self.ends[new] = last
                else:
                    open_.append((last, new))
        return self._finish(level)

    def _wall(self, vertex: int, child: int) -> tuple[list[int], bool]:
        """From one fork on to the next one, or to the end."""
        begin, after, matters, rank = self.begin, self.after, self.matters, self.rank
        rises = rank[child] > rank[vertex]
        path, here = [child], child
        while True:
            onward = [one for one in after[begin[here] : begin[here + 1]] if matters[one]]
            if len(onward) != 1 or (rank[onward[0]] > rank[here]) != rises:
                break
            here = onward[0]
            path.append(here)
        if onward:
            return path, False
        return self._to_the_tip(path, 1.0 if rises else -1.0), True

    def _to_the_tip(self, path: list[int], sign: float) -> list[int]:
        """What is left is small, or less high than noise; where there is none, it is followed to its end."""
        while children := self.children(path[-1]):
            here = self.z[path[-1]]
            reach = [max(self.high[c] - here, here - self.low[c]) for c in children]
            best = int(np.argmax(reach))
            others = reach[:best] + reach[best + 1 :]
            noisy = max(others, default=0.0) > EXACT_HEIGHT and reach[best] < self.noise
            if noisy or sign * (self.z[children[best]] - here) < -EXACT_HEIGHT:
                break
            path.append(children[best])
        return path

    def _beyond(self, vertex: int, level: float) -> float:
        return max(self.high[vertex] - level, level - self.low[vertex])

    def _finish(self, level: float) -> Skeleton:
        element, flat, up = self.element.tolist(), list(self.z), self.tree.parent.tolist()
        for vertex in self.tree.order[1:].tolist():
            if element[vertex] < 0:
                element[vertex], flat[vertex] = element[up[vertex]], flat[up[vertex]]
        where, z = np.array(element), np.array(self.z)
        places = self._places(level, where, z)
        while (kept := self._apart(places)).sum() < len(places):
            where = self._join(kept, where)
            places = self._places(level, where, z)
        smooth = np.array(flat)
        return Skeleton(tuple(self._with_noise(places, where, z, smooth)), where, smooth)

    def _places(self, level: float, where: IntArray, z: FloatArray) -> list[Place]:
        at_place = np.nonzero(where % 2 == 0)[0]
        order = at_place[np.argsort(where[at_place], kind="stable")]
        groups = np.split(order, np.nonzero(np.diff(where[order]))[0] + 1)
        places = []
        for index, members in enumerate(groups):
            heights = z[members]
            own = level if index == 0 else self._level(index, heights, self.weight[members])
            places.append(Place(own, float(np.abs(heights - own).max()), self.before[index]))
        return places

    def _apart(self, places: list[Place]) -> BoolArray:
        """Whether (P,) places are off those before them by no less than noise: of a noisy flat the first fork
        that was found may be off its level by as much again."""
        level = np.array([place.level for place in places])
        kept = np.abs(level - level[[max(place.before, 0) for place in places]]) >= self.noise
        kept[0] = True
        return np.asarray(kept)

    def _join(self, kept: BoolArray, where: IntArray) -> IntArray:
        """The places that are ``kept`` (P,) stay, the others and the walls to them become those before them;
        ``where`` (N,) as `Skeleton.element`."""
        number = np.cumsum(kept) - 1
        to = np.zeros(len(kept), dtype=np.int64)
        for index, place in enumerate(self.before):  # each comes after the one before it
            to[index] = number[index] if kept[index] else to[place]
        self.ends = {int(to[place]): end for place, end in self.ends.items() if kept[place]}
        self.before = [
            int(to[place]) if place >= 0 else -1 for place, own in zip(self.before, kept, strict=True) if own
        ]
        return np.asarray(2 * to[where // 2] + (where % 2) * kept[where // 2])

    def _with_noise(
        self, places: list[Place], element: IntArray, z: FloatArray, smooth: FloatArray
    ) -> list[Place]:
        """The places with the noise of those of their vertices that hang on the walls beside them."""
        bump = np.abs(z - smooth)
        bumpy = np.nonzero((bump > 0.0) & (bump < self.noise))[0]
        if len(bumpy) == 0:
            return places
        most, z, smooth = float(bump[bumpy].max()), z[bumpy], smooth[bumpy]
        to = element[bumpy] // 2
        on_wall, since = element[bumpy] % 2 == 1, np.array(self.before)[to]
        found = []
        for index, place in enumerate(places):
            near = on_wall & ((to == index) | (since == index)) & (np.abs(smooth - place.level) <= most)
            off = float(np.abs(z[near] - place.level).max(initial=0.0))
            found.append(dataclasses.replace(place, off=max(place.off, off)))
        return found

    def _level(self, place: int, heights: FloatArray, weight: FloatArray) -> float:
        if place in self.ends and np.ptp(heights) <= EXACT_HEIGHT:
            return self.z[self.ends[place]]
        order = np.argsort(heights)
        total = np.cumsum(weight[order])
        return float(heights[order[min(int(np.searchsorted(total, 0.5 * total[-1])), len(order) - 1)]])


FLAT_CLEARANCE: Final = 1.1
"""How far from a noisy flat the first level line is, in units of its noise as it shows on the flat itself: of
the flat's vertices some count as parts of the walls."""


@dataclasses.dataclass(frozen=True)
class Wall:
    """One feature to be: ``parent`` index among the walls or None, ``start`` and ``end`` [m], ``first`` and
    ``last`` [m] levels between which its level lines are clean, ``height`` (V,) [m]: the surface on the wall,
    ``start`` outside it and ``end`` inside."""

    parent: int | None
    start: float
    end: float
    first: float
    last: float
    height: FloatArray

    @property
    def sign(self) -> float:
        """+1 where it rises from its start, -1 where it goes down."""
        return 1.0 if self.end > self.start else -1.0


@dataclasses.dataclass(frozen=True)
class _Run:
    begin: int
    through: tuple[int, ...]
    end: int


def walls(skeleton: Skeleton, surface: SheetSurface, noise: float) -> list[Wall]:
    """The walls, each after its parent."""
    area = plan_areas(surface)
    onward: list[list[int]] = [[] for _ in skeleton.places]
    for index, place in enumerate(skeleton.places[1:], start=1):
        onward[place.before].append(index)
    found: list[Wall] = []
    waiting: list[tuple[int, int | None]] = [(other, None) for other in onward[0]]
    while waiting:
        first, parent = waiting.pop()
        run = _run(skeleton, onward, first)
        pieces = _pieces(run, skeleton, surface, area, noise)
        owner = parent
        owners = []
        for piece in pieces:
            found.append(dataclasses.replace(piece, parent=owner))
            owner = len(found) - 1
            owners.append(owner)
        sign = pieces[0].sign
        for stop in (*run.through, run.end):
            level = skeleton.places[stop].level
            fits = [k for k, piece in enumerate(pieces) if sign * (level - piece.end) < noise]
            leaving = [other for other in onward[stop] if other not in (*run.through, run.end)]
            waiting.extend((other, owners[fits[0] if fits else -1]) for other in leaving)
    return found


def _run(skeleton: Skeleton, onward: list[list[int]], first: int) -> _Run:
    sign = skeleton.direction(first)
    through, place = [], first
    while len(same := [other for other in onward[place] if skeleton.direction(other) == sign]) == 1:
        through.append(place)
        place = same[0]
    return _Run(skeleton.places[first].before, tuple(through), place)


def _height(run: _Run, skeleton: Skeleton) -> tuple[FloatArray, FloatArray]:
    """The surface on a run, constant elsewhere; and (V,) whether a vertex lies on the run itself."""
    places = skeleton.places
    own = {*run.through, run.end}
    low = np.full(2 * len(places), places[run.begin].level)
    high = low.copy()
    mine = np.zeros(2 * len(places), dtype=bool)
    inside: set[int] = set()
    for index, place in enumerate(places):
        if index in own:
            before = places[place.before].level
            low[2 * index + 1], high[2 * index + 1] = min(before, place.level), max(before, place.level)
            low[2 * index] = high[2 * index] = place.level
            mine[2 * index : 2 * index + 2] = True
        elif place.before in inside:
            held = low[2 * place.before]
            low[2 * index : 2 * index + 2] = high[2 * index : 2 * index + 2] = held
        else:
            continue
        inside.add(index)
    element = skeleton.element
    return np.clip(skeleton.height, low[element], high[element]), mine[element]


def _pieces(
    run: _Run, skeleton: Skeleton, surface: SheetSurface, area: FloatArray, noise: float
) -> list[Wall]:
    height, mine = _height(run, skeleton)
    begin, finish = skeleton.places[run.begin], skeleton.places[run.end]
    start, end = begin.level, finish.level
    sign = 1.0 if end > start else -1.0
    off = begin.off
    if run.begin == 0:
        off = max(off, float(np.abs(surface.vertices[surface.border, 2] - start).max()))
    first, last = (
        start + sign * (FLAT_CLEARANCE * off + EXACT_HEIGHT),
        end - sign * (FLAT_CLEARANCE * finish.off + EXACT_HEIGHT),
    )
    one, two, three = height[surface.faces].T
    low, high = np.minimum(np.minimum(one, two), three), np.maximum(np.maximum(one, two), three)
    reached = (low != start) | (high != start)
    counts = (high > low) | mine[surface.faces].all(axis=1)
    counts &= reached & ((low != end) | (high != end))
    pauses = find_terraces(
        low[counts], high[counts], area[counts], float(area[reached].sum()), start, end, noise
    )
    pieces = []
    for pause in pauses:
        pieces.append(_wall(start, pause.level, first, pause.first, height))
        start, first = pause.level, pause.last
    pieces.append(_wall(start, end, first, last, height))
    return pieces


def _wall(start: float, end: float, first: float, last: float, height: FloatArray) -> Wall:
    if (last - first) * (end - start) <= 0.0:  # barely higher than the noise at its ends
        first, last = start + 0.4 * (end - start), start + 0.6 * (end - start)
    return Wall(None, start, end, first, last, np.clip(height, min(start, end), max(start, end)))
