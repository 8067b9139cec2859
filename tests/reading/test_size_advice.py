"""Block sizes that a hint recommends are tried first: which sizes, and what is reported of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from planner import pipeline
from planner.issues import Issue, Remedy, TandemError
from planner.processes.forming.plan.support.clearance import wider_mm
from planner.reading import size_advice
from planner.reading.strict_yaml import Document
from tests import small_forming
from tests.refusals import change

Size = list[float]
Wrong = Callable[[Size], str | None]


def advise(size: Size, needed: tuple[float, ...], wrong: Wrong, **part: Any) -> tuple[Issue, list[Size]]:
    """Run the size advice for a block.

    Args:
        size: Size of the block [mm].
        needed: Size that holds the part.
        wrong: Returns the code of the fault of a size, or None.

    Returns:
        The issue, and the sizes that were tried.
    """
    tried: list[Size] = []

    def check(document: Document, is_thorough: bool) -> list[Issue]:
        assert is_thorough
        tried.append(document.data["stock"]["size_mm"])
        code = wrong(tried[-1])
        return [] if code is None else [Issue(code, f"{code} is wrong", hint="mend it")]

    first = Issue("part.stock_too_small", "out", remedy=Remedy("size", "stock", size_mm=needed))
    document = Document(Path("p.yaml"), {"stock": {"size_mm": size}, "part": part}, None, b"")
    (issue,) = size_advice.add_size_advice(document, [first], check, wider_mm)
    return issue, tried


def test_the_tightest_block_is_named_where_it_serves() -> None:
    issue, tried = advise([90, 200, 80], (166, 313, 80), lambda size: None)
    assert tried == [[166, 313, 80]]
    assert issue.hint == "set size_mm: [166, 313, 80] (tried)"


def test_a_part_may_be_meant_the_other_way_round() -> None:
    def wrong(size: Size) -> str | None:
        return "milling.off_surface" if size[0] < size[1] else None

    issue, _ = advise([90, 206, 80], (166, 313, 80), wrong)
    assert issue.hint == "set size_mm: [313, 206, 80] (tried)"
    assert issue.remedy == Remedy("size", "stock", size_mm=(313, 206, 80))
    placed, tried = advise([90, 206, 80], (166, 313, 80), wrong, in_stock={})
    assert tried == [[166, 313, 80]]  # a stated place is not turned
    assert placed.hint is not None
    assert placed.hint.endswith("then remains: milling.off_surface is wrong; mend it")


@pytest.mark.parametrize(
    ("min_height_mm", "named"), [(50, "55] (tried)"), (80, "85] (tried)"), (90, "25]; then")]
)
def test_a_higher_block_is_named_where_arms_have_no_room(min_height_mm: float, named: str) -> None:
    issue, tried = advise(
        [170, 231, 16],
        (170, 239, 25),
        lambda size: "motion.no_placement" if size[2] < min_height_mm else None,
    )
    assert issue.hint is not None
    assert named in issue.hint
    assert tried[0] == [170, 239, 25]


def test_a_part_in_another_unit_is_not_tried() -> None:
    issue, tried = advise([90, 200, 80], (1660, 3130, 80), lambda size: None)
    assert tried == []
    assert issue.hint is None


def test_the_file_is_refused_with_the_size_that_was_tried(tmp_path: Path) -> None:
    data = change(small_forming.problem(), "sheet.opening_mm", 56)
    with pytest.raises(TandemError) as refused:
        pipeline.load(small_forming.write(tmp_path, data))
    (issue,) = refused.value.issues
    assert issue.hint is not None
    assert issue.hint.startswith("set opening_mm: ")
    (same,) = size_advice.add_size_advice(
        Document(tmp_path, {**data}, None, b""), [issue, issue], lambda *_: [], wider_mm
    )[:1]
    assert same is issue  # of two errors neither is tried
