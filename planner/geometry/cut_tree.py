"""A block divided by through cuts: the tree of its parts, the order of its cuts, and the bow's reach.

Every cut goes through a whole part from side to side (a guillotine cut), and its slot is one kerf wide. The
first cut divides the block. Then each of the two parts is divided in turn, the lower one first. In this
depth-first order the next cut is always in one part in one place.
"""

import dataclasses
from collections.abc import Callable, Collection, Iterator, Sequence


@dataclasses.dataclass(frozen=True)
class BlockPart:
    """A part of a block in plan.

    It is a box, or divided by a cut, or left whole for another job, or an offcut.

    Attributes:
        x: Lower corner along x [m].
        y: Lower corner along y [m].
        length: Size along x [m].
        width: Size along y [m].
        box: Number of the box that it is.
        is_rotated: Whether that box has its width along x.
        axis: 0 if a cut divides it along x, 1 along y.
        position: Start of the slot along that axis [m].
        low: Number of the lower remaining part in the tree, None if the slot takes all of it.
        high: Number of the upper remaining part.
        is_kept: Whether it is kept for another job.
    """

    x: float
    y: float
    length: float
    width: float
    box: int | None = None
    is_rotated: bool = False
    axis: int | None = None
    position: float = 0.0
    low: int | None = None
    high: int | None = None
    is_kept: bool = False


@dataclasses.dataclass(frozen=True)
class CutTree:
    """All parts of a block.

    The first one is the block, and each comes before the parts into which it is divided.
    """

    parts: tuple[BlockPart, ...]

    def cuts(self) -> "tuple[ThroughCut, ...]":
        """Return all cuts in order."""
        return tuple(self._through_cut(part) for part in self.parts if part.axis is not None)

    def boxes(self) -> tuple[BlockPart, ...]:
        """Return the parts that are boxes, in the order in which they become free."""
        return tuple(part for part in self.parts if part.box is not None)

    def offcuts(self) -> tuple[BlockPart, ...]:
        """Return the parts that are not boxes, not cut and not kept for another job."""
        return tuple(
            part for part in self.parts if part.box is None and part.axis is None and not part.is_kept
        )

    def descendants(self, first: int) -> tuple[int, ...]:
        """Return the numbers of a part and of all its descendants, in order.

        Args:
            first: Number of the part.
        """
        out, stack = [], [first]
        while stack:
            i = stack.pop()
            out.append(i)
            stack += [k for k in (self.parts[i].high, self.parts[i].low) if k is not None]
        return tuple(out)

    def with_boxes(self, numbers: Sequence[int], swapped: Sequence[bool]) -> "CutTree":
        """Return the tree with other boxes.

        Args:
            numbers: New numbers of its boxes 0, 1 ...
            swapped: Whether length and width of each of these boxes are swapped.
        """
        parts = [
            part
            if part.box is None
            else dataclasses.replace(
                part, box=numbers[part.box], is_rotated=part.is_rotated != swapped[part.box]
            )
            for part in self.parts
        ]
        return CutTree(tuple(parts))

    def keep_whole(self, parts: Collection[int]) -> "CutTree":
        """Return the tree in which some parts are not divided.

        Args:
            parts: Numbers of the parts, none of them inside another.
        """
        removed = {k for i in parts for k in self.descendants(i)[1:]}
        numbers = {i: n for n, i in enumerate(i for i in range(len(self.parts)) if i not in removed)}
        out = []
        for i in numbers:
            part = self.parts[i]
            if i in parts:
                out.append(BlockPart(part.x, part.y, part.length, part.width, is_kept=True))
                continue
            low, high = (None if k is None else numbers[k] for k in (part.low, part.high))
            out.append(dataclasses.replace(part, low=low, high=high))
        return CutTree(tuple(out))

    def stages(self, cut_together: "Callable[[CutStage], bool]") -> "tuple[CutStage, ...]":
        """Return the cuts made in one position of the piece, in the order of the tree.

        Args:
            cut_together: Whether all cuts of a stage are made side by side; otherwise only the first one is.

        Returns:
            Stages, each a part with all cuts along one axis that go through the whole of it.
        """
        cut = [i for i, part in enumerate(self.parts) if part.axis is not None]
        numbers = {i: number for number, i in enumerate(cut, 1)}
        out, stack = [], [0]
        while stack:
            first = stack.pop()
            if first not in numbers:
                continue
            stage, pieces = self._collect_stage(first, numbers)
            if not cut_together(stage):
                part = self.parts[first]
                stage = CutStage(part, ((numbers[first], self._through_cut(part)),))
                pieces = [i for i in (part.low, part.high) if i is not None]
            out.append(stage)
            stack += reversed(pieces)
        return tuple(out)

    def _collect_stage(self, first: int, numbers: dict[int, int]) -> "tuple[CutStage, list[int]]":
        """Return all cuts side by side in a part, and the parts that remain, both from the lower end on."""
        cuts: list[tuple[int, ThroughCut]] = []
        pieces: list[int] = []

        def walk(i: int | None) -> None:
            if i is None:
                return
            part = self.parts[i]
            if part.axis != self.parts[first].axis:
                pieces.append(i)
                return
            walk(part.low)
            cuts.append((numbers[i], self._through_cut(part)))
            walk(part.high)

        walk(first)
        return CutStage(self.parts[first], tuple(cuts)), pieces

    def _through_cut(self, part: BlockPart) -> "ThroughCut":
        """Return the cut that divides a part."""
        sizes = [
            0.0 if i is None else (self.parts[i].length, self.parts[i].width)[part.axis or 0]
            for i in (part.low, part.high)
        ]
        across = (part.width, part.length)[part.axis or 0]
        return ThroughCut(part.axis or 0, part.x, part.y, across, part.position, sizes[0], sizes[1])


@dataclasses.dataclass(frozen=True)
class ThroughCut:
    """A through cut.

    Attributes:
        axis: Axis that it crosses: 0 if it divides the part along x, 1 along y.
        x: Lower corner of the part along x [m].
        y: Lower corner of the part along y [m].
        length: Length of the cut from side to side [m].
        position: Start of the slot along ``axis`` [m].
        low_size: Size of the lower piece away from the cut [m].
        high_size: Size of the upper piece away from the cut [m].
    """

    axis: int
    x: float
    y: float
    length: float
    position: float
    low_size: float
    high_size: float


@dataclasses.dataclass(frozen=True)
class CutStage:
    """Cuts side by side in one part.

    Attributes:
        part: The part.
        cuts: Cuts from the lower end on, each with its number from 1 among all cuts.
    """

    part: BlockPart
    cuts: tuple[tuple[int, ThroughCut], ...]


@dataclasses.dataclass(frozen=True)
class BowSize:
    """A bow's straight wire.

    Attributes:
        span: Length between its clamps [m].
        throat: Free distance between wire and beam [m].
    """

    span: float
    throat: float

    def reaches(self, along: float, low: float, high: float, thickness: float) -> bool:
        """Return whether a cut can be made; see `required_bows`. Any unit of length is allowed.

        Args:
            along: Length of the cut [m].
            low: Size of the lower piece away from it [m].
            high: Size of the upper piece away from it [m].
            thickness: Thickness of the part [m].
        """
        narrow = min(low, high)
        return (self.span >= thickness and self.throat >= min(narrow, 0.5 * along)) or (
            self.span >= along and self.throat >= min(narrow, thickness)
        )

    def reaches_horizontal(self, along: float, thickness: float, margin: float) -> bool:
        """Return whether the wire can lie in a cut and move down, with the beam above the block.

        Args:
            along: Length of the cut [m].
            thickness: Thickness of the block [m].
            margin: Distance from the foam to the wire's ends and to the beam, and below the block [m].
        """
        return self.span >= along + 2.0 * margin and self.throat >= thickness + 2.0 * margin


def required_bows(along: float, low: float, high: float, thickness: float) -> tuple[tuple[float, float], ...]:
    """Return span and throat [m] that a cut requires, one pair for each way to make it.

    The wire is upright and moves along the cut: it spans the thickness, and the beam is beside the narrower
    piece, or behind the wire for half of the cut from either end. Or the wire lies in the cut and moves down:
    it spans the whole cut, and the beam is beside the narrower piece or above the block.

    Args:
        along: Length of the cut [m].
        low: Size of the lower piece away from it [m].
        high: Size of the upper piece away from it [m].
        thickness: Thickness of the block [m].
    """
    narrow = min(low, high)
    return (thickness, min(narrow, 0.5 * along)), (along, min(narrow, thickness))


def unreachable_cuts(tree: CutTree, thickness: float, bow: BowSize) -> Iterator[tuple[int, ThroughCut]]:
    """Yield the cuts that a bow cannot make, with their numbers from 1.

    Args:
        tree: The tree.
        thickness: Thickness of the block [m].
        bow: The bow.
    """
    for number, cut in enumerate(tree.cuts(), 1):
        if not bow.reaches(cut.length, cut.low_size, cut.high_size, thickness):
            yield number, cut
