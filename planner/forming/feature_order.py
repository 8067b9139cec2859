"""In which order the features of a part are formed, and at which level each.

The sheet inside a feature goes along when the feature is formed. So a feature is formed where its place of
the sheet is at that time: at the level of its start where all the features around it are done (strategy 1),
on the flat sheet where none is (strategy 2), and in between in an order of one's own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from planner.forming.feature_tree import FeatureTree
from planner.issues import Issue, TandemError


@dataclasses.dataclass(frozen=True)
class OrderStep:
    """Form ``feature`` (its id) with ``shift`` [m] added to z of its contours."""

    feature: int
    shift: float


def in_place(tree: FeatureTree) -> tuple[OrderStep, ...]:
    """Strategy 1: parents before their children (preorder), every feature where it is in the part."""
    return given(tree, [feature.id for feature in tree.features])


def on_virgin_sheet(tree: FeatureTree) -> tuple[OrderStep, ...]:
    """Strategy 2: children before their parents (postorder), every feature from the level of the flat
    sheet."""
    order: list[int] = []
    waiting = list(tree.roots)  # siblings come out in reverse, then all is reversed
    while waiting:
        feature = tree.feature(waiting.pop())
        order.append(feature.id)
        waiting.extend(feature.children)
    return given(tree, order[::-1], translated=True)


def given(tree: FeatureTree, order: Sequence[int], translated: bool = False) -> tuple[OrderStep, ...]:
    """An order of one's own. In place, a parent must come before its children. ``translated`` allows any
    order: what is formed before its parent is formed at the level that the sheet has there at the time.

    Raises ``TandemError`` with ``forming.order`` for a feature that is unknown, missing or named twice, and
    in place for a child before its parent.
    """
    _check(tree, order, translated)
    done: set[int] = set()
    steps = []
    for number in order:
        steps.append(OrderStep(number, sheet_level(tree, number, done) - tree.feature(number).start))
        done.add(number)
    return tuple(steps)


def sheet_level(tree: FeatureTree, number: int, done: set[int]) -> float:
    """z [m] of the sheet where a feature starts, once the features ``done`` are formed.

    A feature around it takes it along from the feature's own start to the start of what stands on it. With
    all of them done that is the start itself, with none the flat sheet, to the last bit.
    """
    feature = tree.feature(number)
    around = []
    while feature.parent is not None:
        parent = tree.feature(feature.parent)
        around.append((parent.id, feature.start - parent.start))
        feature = parent
    if all(parent in done for parent, _ in around):
        return tree.feature(number).start
    return tree.level + sum(moved for parent, moved in around if parent in done)


def _check(tree: FeatureTree, order: Sequence[int], translated: bool) -> None:
    wanted = set(range(1, len(tree.features) + 1))
    issues = []
    unknown = sorted(set(order) - wanted)
    missing = sorted(wanted - set(order))
    twice = sorted({number for number in order if order.count(number) > 1})
    for what, numbers in (("does not exist", unknown), ("is missing", missing), ("is there twice", twice)):
        issues += [_issue(f"feature {n} {what}; name each of 1 to {len(wanted)} once") for n in numbers]
    if not translated and not issues:
        place = {number: index for index, number in enumerate(order)}
        issues += [
            _issue(
                f"feature {feature.id} comes before feature {feature.parent}, on which it stands; form the "
                "parent first, or form the features translated, on the virgin sheet"
            )
            for feature in tree.features
            if feature.parent is not None and place[feature.id] < place[feature.parent]
        ]
    if issues:
        raise TandemError(issues)


def _issue(what: str) -> Issue:
    return Issue("forming.order", f"order of forming: {what}", field="order")
