"""The bow that carries an operation's straight wire."""

from __future__ import annotations

from planner.hotwire.straight_operation import Straight
from planner.issues import Issue, TandemError
from planner.problem import Setup
from planner.tooling import Bow


def bow_of(op: Straight, setup: Setup) -> Bow:
    """The bow on the first arm. Raises ``TandemError``: bow.missing, bow.holder, bow.arms."""
    issues = [*_arms(op, setup)]
    tool = setup.cell.arm(op.arms[0]).tool
    if not isinstance(tool, Bow):
        issues.append(
            Issue(
                "bow.missing",
                f"{op.name}: arm {op.arms[0]} carries the tool {tool.name}, which has no straight wire; "
                "give it a bow, in the cell or in this operation's setup",
                field="cell.arms",
                arm=op.arms[0],
            )
        )
    if issues or not isinstance(tool, Bow):
        raise TandemError(issues)
    return tool


def _arms(op: Straight, setup: Setup) -> list[Issue]:
    """The operation has the holder as its second arm exactly where the block is held."""
    holder = setup.stock.held_by
    wanted = (op.arms[0],) if holder is None else (op.arms[0], holder)
    if op.arms == wanted and op.arms[0] != holder:
        return []
    how = "stands" if holder is None else f"is held by arm {holder}"
    need = "the arm with the bow alone" if holder is None else f"the arm with the bow, then {holder}"
    return [
        Issue(
            "bow.arms",
            f"{op.name}: arms are {', '.join(op.arms)}, but the block {how} in this setup; name {need}",
            field="operations.arms",
        )
    ]
