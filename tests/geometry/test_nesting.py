"""Nests of boxes: an independent saw cuts them. Few boxes are compared with all possible strips."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.geometry import nesting
from planner.geometry.cut_tree import BowSize, CutTree, required_bows, unreachable_cuts
from planner.geometry.nesting import BoxNest, NestBlock, NestBox, NestRules, min_blocks, nest_boxes
from planner.geometry.two_stage import exact_strips

ROUND = 2.5e-5  # m: boxes are rounded up to steps of a hundredth of a millimetre
Rectangle = tuple[float, float, float, float]


def cut_pieces(tree: CutTree, block: NestBlock, kerf: float) -> list[Rectangle]:
    """Pieces (x, y, length, width) that are left when the cuts are made one after the other, each through one
    whole piece, with the piece that was cut last always gone on with."""
    assert tree.parts[0].x == tree.parts[0].y == 0.0
    assert tree.parts[0].length == pytest.approx(block.length, abs=ROUND)
    assert tree.parts[0].width == pytest.approx(block.width, abs=ROUND)
    pieces: list[Rectangle] = [(0.0, 0.0, tree.parts[0].length, tree.parts[0].width)]
    for cut in tree.cuts():
        (where,) = [k for k, p in enumerate(pieces) if np.allclose(p[:2], (cut.x, cut.y), atol=1e-9)]
        x, y, long, wide = pieces.pop(where)
        if cut.axis == 0:
            assert cut.length == pytest.approx(wide, abs=1e-9)
            low, high = (
                (x, y, cut.position - x, wide),
                (cut.position + kerf, y, x + long - cut.position - kerf, wide),
            )
        else:
            assert cut.length == pytest.approx(long, abs=1e-9)
            low, high = (
                (x, y, long, cut.position - y),
                (x, cut.position + kerf, long, y + wide - cut.position - kerf),
            )
        assert min(low[2:]) > 0.0
        assert (low[2 + cut.axis], max(high[2 + cut.axis], 0.0)) == pytest.approx(
            (cut.low_size, cut.high_size), abs=1e-9
        )
        pieces += [low] + ([high] if min(high[2:]) > 1e-9 else [])
    return pieces


def check_nest(
    result: BoxNest, boxes: Sequence[NestBox], blocks: Sequence[NestBlock], rules: NestRules
) -> None:
    """Every box once, as large as asked, thin enough, a kerf from its neighbours; all of a block told of."""
    seen = []
    for kind, tree in result.blocks:
        block = blocks[kind]
        pieces = cut_pieces(tree, block, rules.kerf)
        told = [(p.x, p.y, p.length, p.width) for p in (*tree.boxes(), *tree.offcuts())]
        assert np.allclose(sorted(pieces), sorted(told), atol=1e-9)
        for part in tree.boxes():
            assert part.box is not None
            box = boxes[part.box]
            asked = (box.width, box.length) if part.is_rotated else (box.length, box.width)
            assert rules.may_rotate or not part.is_rotated
            assert np.allclose((part.length, part.width), asked, atol=ROUND)
            assert min(part.length - asked[0], part.width - asked[1]) > -1e-9
            assert box.thickness <= block.thickness + 1e-9
            seen.append(part.box)
        for a, b in itertools.combinations(tree.boxes(), 2):
            gap = max(a.x - b.x - b.length, b.x - a.x - a.length, a.y - b.y - b.width, b.y - a.y - a.width)
            assert gap >= rules.kerf - 1e-9
    assert sorted(seen) == list(range(len(boxes)))
    for kind, block in enumerate(blocks):
        assert block.count is None or sum(k == kind for k, _ in result.blocks) <= block.count


def some_boxes(count: int, seed: int) -> list[NestBox]:
    rng = np.random.default_rng(seed)
    sides = rng.uniform([0.25, 0.2], [1.0, 0.6], (count, 2)).round(4)
    return [NestBox(float(a), float(b), 0.2) for a, b in sides]


@pytest.fixture(scope="module", autouse=True)
def few_looks() -> Iterator[None]:
    """Reduce the search effort. The tested properties hold for any nest."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(nesting, "MAX_CHECKS", 60_000)
        yield


USUAL_LOOKS = nesting.MAX_CHECKS
millimetres = st.integers(20, 900)


@given(
    sides=st.lists(st.tuples(millimetres, millimetres), min_size=1, max_size=25),
    kerf=st.sampled_from([0.0, 0.002, 0.0153]),
    turn=st.booleans(),
    left=st.integers(0, 2),
    data=st.data(),
)
@settings(max_examples=25, deadline=None, derandomize=True)
def test_every_nest_can_be_sawn(
    sides: list[tuple[int, int]], kerf: float, turn: bool, left: int, data: st.DataObject
) -> None:
    thick = [data.draw(st.sampled_from([0.1, 0.2])) for _ in sides]
    boxes = [NestBox(a / 1e3, b / 1e3, t) for (a, b), t in zip(sides, thick, strict=True)]
    blocks = [
        NestBlock(1.2, 1.0, 0.2),
        NestBlock(0.95, 0.95, 0.12),
        NestBlock(0.6, 0.4, 0.2, left, is_free=True),
    ]
    rules = NestRules(kerf, turn)
    check_nest(nest_boxes(boxes, blocks, rules), boxes, blocks, rules)


def fewest_by_strips(sides: Sequence[tuple[int, int]], room: tuple[int, int], turn: bool) -> int | None:
    """The fewest blocks over all divisions of boxes into strips and of strips into blocks."""
    everything = range(1, 1 << len(sides))
    holds = set()
    for axis in range(2):
        long, high = room[1 - axis], room[axis]
        height: dict[int, float] = {}
        for some in everything:
            chosen = [sides[i] for i in range(len(sides)) if some >> i & 1]
            ways = [((b[axis], b[1 - axis]), (b[1 - axis], b[axis]))[: 2 if turn else 1] for b in chosen]
            height[some] = min(
                (
                    max(h for h, _ in way)
                    for way in itertools.product(*ways)
                    if sum(w for _, w in way) <= long
                ),
                default=np.inf,
            )
        stacked = {0: 0.0}
        for some in everything:
            first = some & -some
            parts = (p for p in everything if p & some == p and p & first)
            stacked[some] = min(height[p] + stacked[some ^ p] for p in parts)
        holds |= {some for some in everything if stacked[some] <= high}
    best: dict[int, int | None] = {0: 0}
    for some in everything:
        rests = [best[some ^ p] for p in holds if p & some == p and p & some & -some]
        best[some] = min((1 + r for r in rests if r is not None), default=None)
    return best[(1 << len(sides)) - 1]


sides_of_strips = st.lists(st.tuples(st.integers(3, 20), st.integers(3, 20)), min_size=2, max_size=6)


@given(sides=sides_of_strips, turn=st.booleans())
@settings(max_examples=25, deadline=None, derandomize=True)
def test_strips_are_the_fewest_of_all(sides: list[tuple[int, int]], turn: bool) -> None:
    room = (24, 20)
    fewest = fewest_by_strips(sides, room, turn)
    assert fewest is not None
    found, _ = exact_strips(sides, room, fewest, turn)
    assert found is not None
    assert len(found) == fewest
    if fewest > 1:
        assert exact_strips(sides, room, fewest - 1, turn) == (None, True)


@given(sides=sides_of_strips, turn=st.booleans())
@settings(max_examples=25, deadline=None, derandomize=True)
def test_a_nest_of_few_boxes_takes_no_more_than_the_best_strips(
    sides: list[tuple[int, int]], turn: bool
) -> None:
    boxes = [NestBox(a / 100, b / 100, 0.1) for a, b in sides]
    found = nest_boxes(boxes, [NestBlock(0.24, 0.2, 0.1)], NestRules(0.0, turn))
    fewest = fewest_by_strips(sides, (24, 20), turn)
    assert fewest is not None
    assert len(found.blocks) <= fewest
    assert found.optimality is not None


def test_what_the_strips_alone_find_is_sawn_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first nest is made bad, so that the exact model gives the answer."""
    boxes, blocks, rules = some_boxes(10, 4), [NestBlock(2.4, 1.2, 0.2)], NestRules(0.002)
    best = nest_boxes(boxes, blocks, rules)
    monkeypatch.setattr(nesting, "_ORDERS", (lambda a, b: (-a * b,),) * 3)
    monkeypatch.setattr(nesting._NestSearch, "improve", lambda self, found: found)
    monkeypatch.setattr(
        nesting._NestSearch,
        "best_by_rules",
        lambda self: [self.pack([i], nesting._PackingRule(0, 0, 0), [], [0])[0] for i in range(10)],
    )
    found = nest_boxes(boxes, blocks, rules)
    check_nest(found, boxes, blocks, rules)
    assert found.optimality is not None
    assert len(found.blocks) <= len(best.blocks) + (best.optimality != "two-stage")


def test_many_boxes_take_little_more_than_their_area(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks that hold 7 boxes and more: one block above the bound by areas, and each is looked at."""
    monkeypatch.setattr(nesting, "MAX_CHECKS", 200_000)
    boxes, blocks, rules = some_boxes(120, 1), [NestBlock(2.4, 1.2, 0.2)], NestRules(0.002)
    found = nest_boxes(boxes, blocks, rules)
    check_nest(found, boxes, blocks, rules)
    assert len(boxes) / len(found.blocks) >= 7.0
    assert len(found.blocks) <= min_blocks(boxes, blocks[0], rules.kerf) + 1


CASES = [((2.4, 1.2), 35), ((3.0, 1.25), 27), ((2.5, 0.6), 33), ((1.25, 0.6), 67)]
"""Blocks [m] and how many of them the best of the guillotine rules of the package rectpack 0.2.2 takes."""


@pytest.mark.long
@pytest.mark.parametrize(("size", "max_blocks"), CASES)
def test_the_panels_of_a_dome_take_no_more_blocks_than_rules_of_others(
    size: tuple[float, float], max_blocks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Boxes of 267 panels of a dome, those that fit; at most 1.08 of the bound where a block holds 7."""
    monkeypatch.setattr(nesting, "MAX_CHECKS", USUAL_LOOKS)
    rows = (Path(__file__).parents[2] / "bench" / "panel_boxes.csv").read_text().splitlines()[1:]
    sides = [[float(v) / 1e3 for v in row.split(",")[1:3]] for row in rows]
    boxes = [NestBox(a, b, 0.2) for a, b in sides if a <= size[0] and b <= size[1]]
    blocks, rules = [NestBlock(*size, 0.2)], NestRules(0.002)
    found = nest_boxes(boxes, blocks, rules)
    check_nest(found, boxes, blocks, rules)
    assert len(found.blocks) <= max_blocks
    if len(boxes) / len(found.blocks) >= 7.0:
        assert len(found.blocks) <= 1.08 * min_blocks(boxes, blocks[0], rules.kerf)


def test_a_nest_is_the_same_each_time() -> None:
    boxes, blocks = some_boxes(60, 2), [NestBlock(1.25, 0.6, 0.2), NestBlock(2.4, 1.2, 0.25)]
    assert nest_boxes(boxes, blocks, NestRules(0.002)) == nest_boxes(boxes, blocks, NestRules(0.002))


def test_each_slot_takes_its_kerf() -> None:
    """Four boxes that would go into one block but for three slots."""
    boxes = [NestBox(0.25, 0.5, 0.1)] * 4
    block = [NestBlock(1.0, 0.5, 0.1)]
    assert len(nest_boxes(boxes, block, NestRules(0.0, False)).blocks) == 1
    assert len(nest_boxes(boxes, block, NestRules(0.001, False)).blocks) == 2
    assert len(nest_boxes(boxes, [NestBlock(1.003, 0.5, 0.1)], NestRules(0.001, False)).blocks) == 1


def test_grain_keeps_boxes_as_they_are() -> None:
    boxes = [NestBox(0.2, 0.5, 0.1)] * 4
    blocks = [NestBlock(1.0, 0.4, 0.1), NestBlock(0.4, 1.0, 0.1)]
    turned, kept = (nest_boxes(boxes, blocks, NestRules(0.0, turn)) for turn in (True, False))
    assert len(turned.blocks) == len(kept.blocks) == 1
    assert [kind for kind, _ in kept.blocks] == [1]
    assert not any(part.is_rotated for _, tree in kept.blocks for part in tree.boxes())


def test_what_is_free_is_used_first_and_no_more_of_it_than_there_is() -> None:
    boxes, rules = [NestBox(0.5, 0.4, 0.1)] * 3, NestRules(0.002)
    blocks = [NestBlock(1.0, 1.0, 0.1), NestBlock(0.6, 0.4, 0.1, 2, is_free=True)]
    found = nest_boxes(boxes, blocks, rules)
    check_nest(found, boxes, blocks, rules)
    assert [kind for kind, _ in found.blocks] == [1, 1, 0]


def test_the_kind_of_least_volume_is_taken() -> None:
    boxes = [NestBox(0.9, 0.5, 0.1)]
    blocks = [NestBlock(2.0, 1.0, 0.1), NestBlock(1.0, 0.6, 0.3), NestBlock(1.0, 0.6, 0.1)]
    assert [kind for kind, _ in nest_boxes(boxes, blocks, NestRules(0.002)).blocks] == [2]


def test_a_box_that_fits_nothing_is_an_error() -> None:
    with pytest.raises(ValueError, match="box 1 fits no block"):
        nest_boxes(
            [NestBox(0.5, 0.5, 0.1), NestBox(0.5, 0.5, 0.3)], [NestBlock(1.0, 1.0, 0.2)], NestRules(0.002)
        )


def reached(bow: BowSize, along: float, low: float, high: float, thickness: float) -> bool:
    """Upright, the beam beside a piece or behind, from both ends; level, beside a piece or above."""
    upright = bow.span >= thickness and (min(low, high) <= bow.throat or 0.5 * along <= bow.throat)
    level = bow.span >= along and (min(low, high) <= bow.throat or thickness <= bow.throat)
    return upright or level


@given(st.tuples(*[st.integers(1, 12)] * 6))
@settings(max_examples=200, deadline=None, derandomize=True)
def test_a_bow_reaches_what_it_spans_and_has_a_throat_for(v: tuple[int, int, int, int, int, int]) -> None:
    bow = BowSize(v[0], v[1])
    assert bow.reaches(v[2], v[3], v[4], v[5]) == reached(bow, v[2], v[3], v[4], v[5])
    for span, throat in required_bows(v[2], v[3], v[4], v[5]):
        assert BowSize(span, throat).reaches(v[2], v[3], v[4], v[5])


def test_cuts_are_laid_so_that_the_bow_reaches_them() -> None:
    boxes, blocks = some_boxes(40, 3), [NestBlock(2.4, 1.2, 0.2)]
    bow = BowSize(0.65, 0.62)
    rules = NestRules(0.002, bow=bow)
    found = nest_boxes(boxes, blocks, rules)
    check_nest(found, boxes, blocks, rules)
    assert not any(True for _, tree in found.blocks for _ in unreachable_cuts(tree, 0.2, bow))
    plain = nest_boxes(boxes, blocks, NestRules(0.002))
    assert any(True for _, tree in plain.blocks for _ in unreachable_cuts(tree, 0.2, BowSize(0.65, 0.3)))


def test_cuts_that_no_order_reaches_are_named() -> None:
    """One box in the middle of nothing: 900 mm from each end, through a wire of 300 mm."""
    boxes, blocks = [NestBox(0.9, 0.9, 0.2)], [NestBlock(2.0, 2.0, 0.2)]
    found = nest_boxes(boxes, blocks, NestRules(0.002, bow=BowSize(0.3, 0.2)))
    ((number, cut), *_) = unreachable_cuts(found.blocks[0][1], 0.2, BowSize(0.3, 0.2))
    assert number == 1
    assert required_bows(cut.length, cut.low_size, cut.high_size, 0.2) == (
        (0.2, pytest.approx(0.9)),
        (2.0, pytest.approx(0.2)),
    )
