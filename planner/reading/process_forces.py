"""Forces of the process on tools, as operations state them: schema and checks."""

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
    """Force of the process on a tool at its TCP while it works, measured or calculated."""

    force_n: tuple[Newton, Newton, Newton] | None = Field(
        default=None, description="on the tool, along x, y, z"
    )
    table: list[tuple[Height, Newton, Newton, Newton]] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="instead: force by depth, rows of z of the TCP in the stock's frame [mm] and the "
        "force along x, y, z [N] there; linear between rows",
    )
    frame: ForceFrame = Field(
        default="stock",
        description="frame of x, y, z: the block's or sheet's, the TCP's, or the feed's: forward, right, "
        "and along the tool's axis into the work",
    )

    @model_validator(mode="after")
    def _one_source(self) -> "ForceFile":
        if (self.force_n is None) == (self.table is None):
            raise ValueError("state either force_n, or a table of it by depth")
        if self.table is not None and len({row[0] for row in self.table}) < len(self.table):
            raise ValueError("two rows of the table have the same z; remove one of them")
        return self

    def to_force(self) -> Force:
        """Convert to SI units."""
        rows = [(0.0, *(self.force_n or (0.0, 0.0, 0.0)))] if self.table is None else sorted(self.table)
        table = np.array(rows, dtype=np.float64)
        return Force(table[:, 1:], table[:, 0] * MM, self.frame)


class ForcesFile(Strict):
    """Forces by the name of the arm."""

    forces: dict[Name, ForceFile] = Field(min_length=1, max_length=2)


def force_faults(problem: Problem) -> Iterator[Issue]:
    """Yield faults of stated forces.

    Forces are refused for arms that take no part or have no sag compensation, and for blocks that an arm
    holds. All operations of a setup must state the same forces, because a setup has one sag correction.
    """
    for index, forces in problem.forces.items():
        operation, setup = problem.operations[index], problem.setup_of(index)
        field = f"operations.{index}.forces"
        for name in forces:
            if name not in operation.arms:
                text = f"got {name!r}, which takes no part in {operation.name}; its arms are "
                yield _fault(f"{field}: {text}{', '.join(operation.arms)}", field)
                continue
            if setup.cell.arm(name).sag is None:
                text = f"{field}: a force on {name} has no effect without sag compensation; state "
                yield _fault(f"{text}compensate_sag and stiffness of that arm, or remove the force", field)
            if setup.stock.held_by is not None:
                text = f"{field}: arm {setup.stock.held_by} holds the block and would deflect under the same "
                yield _fault(
                    f"{text}force, which is not supported; clamp the block, or remove the force", field
                )
    for setup in problem.setups:
        for arm in setup.cell.arms:
            indices = [i for i in setup.operations if arm.name in problem.operations[i].arms]
            stated = {i: problem.forces.get(i, {}).get(arm.name) for i in indices}
            for i in indices[1:]:
                if not _are_equal(stated[indices[0]], stated[i]):
                    names = [problem.operations[k].name for k in (indices[0], i)]
                    text = f"operations.{i}.forces: {' and '.join(names)} belong to one setup but state "
                    text += f"different forces on {arm.name}; state the same force, or give the second "
                    text += "its own setup"
                    yield _fault(text, f"operations.{i}.forces")


def _are_equal(first: Force | None, second: Force | None) -> bool:
    """Return whether two forces have the same frame and the same values, or both are None."""
    if first is None or second is None:
        return first is second
    return (
        first.frame == second.frame
        and np.array_equal(first.vectors, second.vectors)
        and np.array_equal(first.height, second.height)
    )


def _fault(message: str, field: str) -> Issue:
    return Issue("problem.field", message, field=field)
