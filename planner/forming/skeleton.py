"""What of a contour tree is meant: places where features begin and end, and walls between them.

A branch that does not leave the height of its fork by ``noise`` is no feature, nor is the lesser one of two
that is smaller in plan than any tool: its vertices count as part of the fork. Forks within ``noise`` of each
other are one place, as those are that noise makes on a flat.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np

from planner.forming.contour_tree import ContourTree
from planner.forming.values import BoolArray, FloatArray, IntArray

EXACT: Final = 1e-6
"""Heights [m] that differ by less are those of a mesh without noise."""
SMALLEST: Final = 3e-6
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
        self.matters = np.zeros(len(height), dtype=bool)
        self.matters[inner] = reach
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
                if members and self.size(members, self.z[fork]) < SMALLEST:
                    self.matters[branch] = False

    def _few(self, vertex: int) -> list[int]:
        """The vertices from one on; none where they are clearly not small."""
        members, total = [vertex], 0.0
        for member in members:
            total += self.weight[member]
            if total > 10.0 * SMALLEST:
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
        rises = self.rank[child] > self.rank[vertex]
        path = [child]
        while len(onward := self.onward(path[-1])) == 1 and (
            (self.rank[onward[0]] > self.rank[path[-1]]) == rises
        ):
            path.append(onward[0])
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
            noisy = max(others, default=0.0) > EXACT and reach[best] < self.noise
            if noisy or sign * (self.z[children[best]] - here) < -EXACT:
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
        if place in self.ends and np.ptp(heights) <= EXACT:
            return self.z[self.ends[place]]
        order = np.argsort(heights)
        total = np.cumsum(weight[order])
        return float(heights[order[min(int(np.searchsorted(total, 0.5 * total[-1])), len(order) - 1)]])
