"""A single level of a pass, as the problem states it: its claims, its heights, and the file of its shifts.

Everything that an operation has to form stays claimed, and is compared with the part. Of the programs only
the level's segment is required. Which level that is, and its heights, follow from the problem's step alone:
level K of a pass goes from K to K + 1 steps below the surrounding flat, the last one of a spiral along its
end.
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
from planner.processes.forming.proof.springback_file import LevelFileData

WHOLE_STEP_TOLERANCE = 1e-6
"""Fraction of a step by which a pass may be deeper than a whole number of steps."""
FLOOR_OFFSET_FRACTION = 0.05
"""Distance above the floor, as a fraction of a step, at which a level that ends at the floor is checked: the
floor has no contour.
"""


@dataclasses.dataclass(frozen=True, eq=False)
class SingleLevel:
    """A claim that a single level is formed, with its file.

    Attributes:
        claim: Claim.
        index: Index of the setup.
        operation: Operation of the problem.
        sheet: Claim on the sheet of its segment.
        first_pass: Name of the first pass.
        file: Data of its file, or None.
        fault: Why the file cannot be read, or why there is none.
    """

    claim: FormsLevel
    index: int
    operation: Any
    sheet: FormsSheet | None
    first_pass: str
    file: LevelFileData | None
    fault: str

    @property
    def step(self) -> float:
        """Step-down [m] of the operation."""
        return float(self.operation.stepdown_mm) * MM

    @property
    def depth(self) -> float:
        """Depth [m] of the pass."""
        return 0.0 if self.sheet is None else abs(self.sheet.end - self.sheet.start)

    @property
    def level_count(self) -> int:
        """Number of levels of the pass."""
        whole = max(int(np.ceil(self.depth / self.step - WHOLE_STEP_TOLERANCE)), 1)
        return whole + (1 if self.operation.path == "helical" else 0)

    @property
    def depths(self) -> tuple[float, float]:
        """Depths [m] below the flat around the feature at which the level starts and ends."""
        number = int(self.operation.level.number)
        return min(number * self.step, self.depth), min((number + 1) * self.step, self.depth)

    @property
    def contour_height(self) -> float:
        """Height z [m] of the contour that this level has to pass all around.

        For a spiral it is in the middle of the level, for its first level near the start, otherwise at the
        end of the level.
        """
        start, end = self.depths
        depth = 0.5 * (start + end) if self.operation.path == "helical" else end
        if start == 0.0 and self.operation.path == "helical":
            depth = (
                FLOOR_OFFSET_FRACTION * self.step
            )  # at a sharp edge the first half of the loop is still on the edge
        depth = min(depth, self.depth - FLOOR_OFFSET_FRACTION * self.step)
        return 0.0 if self.sheet is None else self.sheet.start - self.sheet.side * depth


def current_claims(group: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return what a group claims of the programs: only of the level's segment if a single level is formed."""
    kept = {claim.segment for claim in group if isinstance(claim, FormsLevel)}
    if not kept:
        return tuple(group)
    out: list[Claim] = []
    for claim in group:
        if isinstance(claim, FormsInOrder):
            claim = FormsInOrder(tuple(segment for segment in claim.segments if segment in kept))
        if getattr(claim, "segment", None) is None or getattr(claim, "segment") in kept:  # noqa: B009
            out.append(claim)
    return tuple(out)


def single_levels(problem: Problem, groups: Sequence[tuple[int, Sequence[Claim]]]) -> tuple[SingleLevel, ...]:
    """Return all claims of a single level, with their files."""
    out = []
    for index, group in groups:
        sheets = {claim.segment: claim for claim in group if isinstance(claim, FormsSheet)}
        order = [claim.segments for claim in group if isinstance(claim, FormsInOrder) and claim.segments]
        for claim in group:
            if not isinstance(claim, FormsLevel):
                continue
            named = [candidate for candidate in problem.operations if candidate.name == claim.operation]
            operation = named[0] if named else None
            stated = getattr(operation, "level", None)
            file, fault = None, "" if stated is not None else "its operation does not form a single level"
            if stated is not None and stated.file is not None:
                try:
                    file = springback_file.read_level_data(Path(stated.file))
                except ValueError as error:
                    fault = f"{Path(stated.file).name}: {error}"
            first = order[0][0].name if order else ""
            out.append(SingleLevel(claim, index, operation, sheets.get(claim.segment), first, file, fault))
    return tuple(out)
