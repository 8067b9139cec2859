"""A block cut apart by through cuts: the tree of its parts, its cuts in their order, whether a bow reaches
them.

Every cut goes through a whole part, from side to side (a guillotine cut), and takes a slot of one kerf. The
first cut parts the block, then each of the two parts is cut apart in turn, the lower one first: order of the
tree, depth first, so that what is cut next is always one part in one place.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a block in plan: its lower corner (x, y) and its size along x and y [m].

    ``box``: number of the box that it is, ``turned`` where that lies with its width along x. ``axis``: 0
    where a cut parts it along x, 1 along y, with the slot from ``place`` [m] on; ``low`` and ``high`` are
    the numbers of what that leaves in the tree, None where the slot takes all of it. Neither box nor
    axis: left over.
    """

    x: float
    y: float
    length: float
    width: float
    box: int | None = None
    turned: bool = False
    axis: int | None = None
    place: float = 0.0
    low: int | None = None
    high: int | None = None


@dataclasses.dataclass(frozen=True)
class CutTree:
    """All parts of a block; the first is the block, each stands before what it is cut into."""

    parts: tuple[Part, ...]

    def cuts(self) -> tuple[Cut, ...]:
        """All cuts in their order."""
        return tuple(self._cut(part) for part in self.parts if part.axis is not None)

    def boxes(self) -> tuple[Part, ...]:
        """Parts that are boxes, in the order in which they are free."""
        return tuple(part for part in self.parts if part.box is not None)

    def offcuts(self) -> tuple[Part, ...]:
        """What is left over."""
        return tuple(part for part in self.parts if part.box is None and part.axis is None)

    def _cut(self, part: Part) -> Cut:
        sizes = [
            0.0 if i is None else (self.parts[i].length, self.parts[i].width)[part.axis or 0]
            for i in (part.low, part.high)
        ]
        across = (part.width, part.length)[part.axis or 0]
        return Cut(part.axis or 0, part.x, part.y, across, part.place, sizes[0], sizes[1])


@dataclasses.dataclass(frozen=True)
class Cut:
    """A through cut in the part whose corner is (x, y): ``along`` [m] from side to side, the slot from
    ``place`` on along ``axis``; ``low`` and ``high`` [m]: how far the two pieces reach away from it."""

    axis: int
    x: float
    y: float
    along: float
    place: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Bow:
    """A bow's straight wire: ``span`` [m] between its clamps, ``throat`` [m] free between wire and beam."""

    span: float
    throat: float

    def reaches(self, along: float, low: float, high: float, thickness: float) -> bool:
        """Whether a cut can be made, ``along`` [m] through a part ``thickness`` [m] thick between pieces that
        reach ``low`` and ``high`` [m] away from it: see `needs`. Any unit of length will do."""
        narrow = min(low, high)
        return (self.span >= thickness and self.throat >= min(narrow, 0.5 * along)) or (
            self.span >= along and self.throat >= min(narrow, thickness)
        )


def needs(along: float, low: float, high: float, thickness: float) -> tuple[tuple[float, float], ...]:
    """Span and throat [m] that a cut takes, one pair for each way to make it.

    The wire stands upright and goes along the cut: it spans the thickness, and the beam goes beside the
    narrower piece, or behind the wire, from either end half of the way. Or the wire lies in the cut and goes
    down: it spans the whole cut, and the beam goes beside the narrower piece or above the block.
    """
    narrow = min(low, high)
    return (thickness, min(narrow, 0.5 * along)), (along, min(narrow, thickness))


def unreached(tree: CutTree, thickness: float, bow: Bow) -> Iterator[tuple[int, Cut]]:
    """Cuts that a bow cannot make, by their numbers from 1."""
    for number, cut in enumerate(tree.cuts(), 1):
        if not bow.reaches(cut.along, cut.low, cut.high, thickness):
            yield number, cut
