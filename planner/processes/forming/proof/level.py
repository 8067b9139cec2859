"""One level of a pass that is formed alone, as the problem states it: what is claimed then, between which
heights, and the file of its shifts.

All that an operation is to form stays claimed, and is held against the part; of the programs only the level's
segment is asked. Which level that is, and where it lies, follows from the problem's step alone: level K of a
pass goes from K to K + 1 steps below the flat around it, the last one of a spiral along its end.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planner.claims.claim import Claim
from planner.geometry.units import MM
from planner.problem import Problem
from planner.processes.forming.claims import FormsInOrder, FormsLevel, FormsSheet
from planner.processes.forming.proof import springback_file
from planner.processes.forming.proof.springback_file import GivenLevel

ROUNDING = 1e-6
"""Share of a step by which a pass may be deeper than whole ones."""
OFF_FLOOR = 0.05
"""A level that ends at the floor is looked at by so much of a step above it: the floor has no contour."""


@dataclasses.dataclass(frozen=True, eq=False)
class OneLevel:
    """A claim of setup ``index``, its ``operation``, the claim on the ``sheet`` of its segment and the name
    of the ``first`` pass; ``given``: what its file holds, None with the ``fault`` where it cannot be read,
    or where there is none."""

    claim: FormsLevel
    index: int
    operation: Any
    sheet: FormsSheet | None
    first: str
    given: GivenLevel | None
    fault: str

    @property
    def step(self) -> float:
        """The step [m] of the operation."""
        return float(self.operation.stepdown_mm) * MM

    @property
    def deep(self) -> float:
        """How deep [m] the pass is."""
        return 0.0 if self.sheet is None else abs(self.sheet.end - self.sheet.start)

    @property
    def count(self) -> int:
        """How many levels the pass has."""
        whole = max(int(np.ceil(self.deep / self.step - ROUNDING)), 1)
        return whole + (1 if self.operation.path == "helical" else 0)

    @property
    def depths(self) -> tuple[float, float]:
        """How far [m] below the flat around the feature the level begins and ends."""
        number = int(self.operation.level.number)
        return min(number * self.step, self.deep), min((number + 1) * self.step, self.deep)

    @property
    def contour(self) -> float:
        """The height z [m] of the contour that this level has to pass all around: of a spiral in the middle
        of it, the first one's at its beginning, else at its end."""
        begin, end = self.depths
        at = 0.5 * (begin + end) if self.operation.path == "helical" else end
        if begin == 0.0 and self.operation.path == "helical":
            at = OFF_FLOOR * self.step  # over a sharp edge its first half is still on the edge
        at = min(at, self.deep - OFF_FLOOR * self.step)
        return 0.0 if self.sheet is None else self.sheet.start - self.sheet.side * at


def now(group: Sequence[Claim]) -> tuple[Claim, ...]:
    """What a group claims of the programs: where one level is formed alone, of its segment only."""
    kept = {claim.segment for claim in group if isinstance(claim, FormsLevel)}
    if not kept:
        return tuple(group)
    out: list[Claim] = []
    for claim in group:
        if isinstance(claim, FormsInOrder):
            claim = FormsInOrder(tuple(one for one in claim.segments if one in kept))
        if getattr(claim, "segment", None) is None or getattr(claim, "segment") in kept:  # noqa: B009
            out.append(claim)
    return tuple(out)


def told(problem: Problem, groups: Sequence[tuple[int, Sequence[Claim]]]) -> tuple[OneLevel, ...]:
    """All claims of one level alone, with their files."""
    out = []
    for index, group in groups:
        sheets = {claim.segment: claim for claim in group if isinstance(claim, FormsSheet)}
        order = [claim.segments for claim in group if isinstance(claim, FormsInOrder) and claim.segments]
        for claim in group:
            if not isinstance(claim, FormsLevel):
                continue
            named = [one for one in problem.operations if one.name == claim.operation]
            operation = named[0] if named else None
            stated = getattr(operation, "level", None)
            given, fault = None, "" if stated is not None else "its operation forms no level alone"
            if stated is not None and stated.file is not None:
                try:
                    given = springback_file.read_level(Path(stated.file))
                except ValueError as error:
                    fault = f"{Path(stated.file).name}: {error}"
            first = order[0][0].name if order else ""
            out.append(OneLevel(claim, index, operation, sheets.get(claim.segment), first, given, fault))
    return tuple(out)
