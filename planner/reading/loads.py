"""Forces that the work exerts on tools, as operations of any process state them: schema, what is refused."""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from planner.claims.claim import ForceFrame
from planner.geometry.units import MM
from planner.issues import Issue
from planner.problem import Force, Problem
from planner.reading.strict_yaml import Name, Strict

Height = Annotated[float, Field(ge=-10_000, le=10_000)]
Newton = Annotated[float, Field(ge=-20_000, le=20_000)]


class ForceFile(Strict):
    """What the work exerts on a tool at its TCP while it works, as measured or reckoned."""

    force_n: tuple[Newton, Newton, Newton] | None = Field(
        default=None, description="on the tool, along x, y, z"
    )
    table: list[tuple[Height, Newton, Newton, Newton]] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="instead: the force by depth, rows of z of the TCP in the stock's frame [mm] and the "
        "force along x, y, z [N] there; between rows it goes on evenly",
    )
    frame: ForceFrame = Field(
        default="stock",
        description="whose x, y, z: the block's or sheet's, the TCP's, or the feed's: forward, right, "
        "and along the tool's axis into the work",
    )

    @model_validator(mode="after")
    def _one_source(self) -> "ForceFile":
        if (self.force_n is None) == (self.table is None):
            raise ValueError("state force_n, or a table of it by depth: one of them")
        if self.table is not None and len({row[0] for row in self.table}) < len(self.table):
            raise ValueError("two rows of the table have the same z; take one of them out")
        return self

    def value(self) -> Force:
        """In SI units."""
        rows = [(0.0, *(self.force_n or (0.0, 0.0, 0.0)))] if self.table is None else sorted(self.table)
        made = np.array(rows, dtype=np.float64)
        return Force(made[:, 1:], made[:, 0] * MM, self.frame)


class ForcesFile(Strict):
    """Forces by the name of the arm."""

    forces: dict[Name, ForceFile] = Field(min_length=1, max_length=2)


def faults(problem: Problem) -> Iterator[Issue]:
    """Forces of arms that take no part, or whose sag nobody compensates; on blocks that an arm holds; and
    forces that differ between operations of one setup, which nobody could tell apart."""
    for index, forces in problem.forces.items():
        operation, setup = problem.operations[index], problem.setup_of(index)
        field = f"operations.{index}.forces"
        for name in forces:
            if name not in operation.arms:
                what = f"got {name!r}, which takes no part in {operation.name}; its arms are "
                yield _fault(f"{field}: {what}{', '.join(operation.arms)}", field)
                continue
            if setup.cell.arm(name).sag is None:
                what = f"{field}: a force on {name} changes nothing, for its sag is not compensated; state "
                yield _fault(f"{what}compensate_sag and stiffness of that arm, or take the force out", field)
            if setup.stock.held_by is not None:
                what = f"{field}: arm {setup.stock.held_by} holds the block and would give way to the same "
                yield _fault(
                    f"{what}force, which is not reckoned; let the block stand, or take it out", field
                )
    for setup in problem.setups:
        for arm in setup.cell.arms:
            own = [i for i in setup.operations if arm.name in problem.operations[i].arms]
            stated = {i: problem.forces.get(i, {}).get(arm.name) for i in own}
            for i in own[1:]:
                if not _alike(stated[own[0]], stated[i]):
                    names = [problem.operations[k].name for k in (own[0], i)]
                    what = f"operations.{i}.forces: {' and '.join(names)} are of one setup and state "
                    what += f"different forces on {arm.name}; state the same, or give the second a setup of "
                    what += "its own"
                    yield _fault(what, f"operations.{i}.forces")


def _alike(one: Force | None, other: Force | None) -> bool:
    if one is None or other is None:
        return one is other
    return (
        one.frame == other.frame
        and np.array_equal(one.vectors, other.vectors)
        and np.array_equal(one.height, other.height)
    )


def _fault(what: str, field: str) -> Issue:
    return Issue("problem.field", what, field=field)
