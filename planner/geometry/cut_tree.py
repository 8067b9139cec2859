"""A block cut apart by through cuts: the tree of its parts, its cuts in their order, whether a bow reaches
them.

Every cut goes through a whole part, from side to side (a guillotine cut), and takes a slot of one kerf. The
first cut parts the block, then each of the two parts is cut apart in turn, the lower one first: order of the
tree, depth first, so that what is cut next is always one part in one place.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Sequence


@dataclasses.dataclass(frozen=True)
class Part:
    """A part of a block in plan: its lower corner (x, y) and its size along x and y [m].

    ``box``: number of the box that it is, ``turned`` where that lies with its width along x. ``axis``: 0
    where a cut parts it along x, 1 along y, with the slot from ``place`` [m] on; ``low`` and ``high`` are
    the numbers of what that leaves in the tree, None where the slot takes all of it. ``whole``: it stays
    as it is for another job. None of these: left over.
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
    whole: bool = False


@dataclasses.dataclass(frozen=True)
class CutTree:
    """All parts of a block; the first is the block, each stands before what it is cut into."""

    parts: tuple[Part, ...]

    def cuts(self) -> "tuple[Cut, ...]":
        """All cuts in their order."""
        return tuple(self._cut(part) for part in self.parts if part.axis is not None)

    def boxes(self) -> tuple[Part, ...]:
        """Parts that are boxes, in the order in which they are free."""
        return tuple(part for part in self.parts if part.box is not None)

    def offcuts(self) -> tuple[Part, ...]:
        """What is left over."""
        return tuple(part for part in self.parts if part.box is None and part.axis is None and not part.whole)

    def below(self, first: int) -> tuple[int, ...]:
        """Numbers of a part and of all that it is cut into, in their order."""
        out, waiting = [], [first]
        while waiting:
            i = waiting.pop()
            out.append(i)
            waiting += [k for k in (self.parts[i].high, self.parts[i].low) if k is not None]
        return tuple(out)

    def with_boxes(self, numbers: Sequence[int], swapped: Sequence[bool]) -> "CutTree":
        """The tree with ``numbers`` for its boxes 0, 1 ..., some of them ``swapped``: length and width of
        these are the other way round."""
        parts = [
            part
            if part.box is None
            else dataclasses.replace(part, box=numbers[part.box], turned=part.turned != swapped[part.box])
            for part in self.parts
        ]
        return CutTree(tuple(parts))

    def left_whole(self, parts: Collection[int]) -> "CutTree":
        """The tree in which the parts with these numbers, none of them in another, are not cut apart."""
        inner = {k for i in parts for k in self.below(i)[1:]}
        numbers = {i: n for n, i in enumerate(i for i in range(len(self.parts)) if i not in inner)}
        out = []
        for i in numbers:
            part = self.parts[i]
            if i in parts:
                out.append(Part(part.x, part.y, part.length, part.width, whole=True))
                continue
            low, high = (None if k is None else numbers[k] for k in (part.low, part.high))
            out.append(dataclasses.replace(part, low=low, high=high))
        return CutTree(tuple(out))

    def stages(self, together: "Callable[[Stage], bool]") -> "tuple[Stage, ...]":
        """What is cut while it lies in one place: parts in the order of the tree, each with all cuts along
        one axis that go through the whole of it, where ``together`` says that these are made side by side,
        else with the first of them alone."""
        cut = [i for i, part in enumerate(self.parts) if part.axis is not None]
        numbers = {i: number for number, i in enumerate(cut, 1)}
        out, waiting = [], [0]
        while waiting:
            first = waiting.pop()
            if first not in numbers:
                continue
            stage, pieces = self._stage(first, numbers)
            if not together(stage):
                part = self.parts[first]
                stage = Stage(part, ((numbers[first], self._cut(part)),))
                pieces = [i for i in (part.low, part.high) if i is not None]
            out.append(stage)
            waiting += reversed(pieces)
        return tuple(out)

    def _stage(self, first: int, numbers: dict[int, int]) -> "tuple[Stage, list[int]]":
        """All cuts side by side in a part, and what they leave of it, both from its lower end on."""
        cuts: list[tuple[int, Cut]] = []
        pieces: list[int] = []

        def walk(i: int | None) -> None:
            if i is None:
                return
            part = self.parts[i]
            if part.axis != self.parts[first].axis:
                pieces.append(i)
                return
            walk(part.low)
            cuts.append((numbers[i], self._cut(part)))
            walk(part.high)

        walk(first)
        return Stage(self.parts[first], tuple(cuts)), pieces

    def _cut(self, part: Part) -> "Cut":
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
class Stage:
    """``cuts`` side by side in one ``part``, from its lower end on, each with its number from 1 among all."""

    part: Part
    cuts: tuple[tuple[int, Cut], ...]


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

    def reaches_lying(self, along: float, thickness: float, margin: float) -> bool:
        """Whether the wire can lie in a cut and go down with the beam above the block, ``margin`` [m] of foam
        to its ends and to the beam, and as far below the block."""
        return self.span >= along + 2.0 * margin and self.throat >= thickness + 2.0 * margin


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
