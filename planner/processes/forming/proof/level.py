"""A single level of a pass, as the problem states it: its claims, its heights, and the file of its shifts.

An operation may form only one level of one pass. Its claims on the whole part remain, and are compared with
the part, but the programs only have to contain the level's segment. Which level that is, and its heights,
follow from the problem's step-down alone: level K of a pass goes from K to K + 1 steps below the surrounding
flat. The last level of a spiral is the loop at constant height along its end.
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
        operation: Operation of the problem, or None if there is none of that name.
        sheet: Claim on the pass that contains the level, or None.
        first_pass: Name of the first pass of the operation.
        file: Data of the file with its shifts, or None.
        fault: Why the file cannot be read or the operation states no level; empty otherwise.
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
        """Height z [m] of the contour along which the ball has to pass all around.

        It is at the end of the level. For a spiral it is in the middle of the level, and near the start for
        the first one. It is never at the floor, which has no contour.
        """
        start, end = self.depths
        depth = 0.5 * (start + end) if self.operation.path == "helical" else end
        if start == 0.0 and self.operation.path == "helical":
            # at a sharp edge the first half of the loop is still on the edge
            depth = FLOOR_OFFSET_FRACTION * self.step
        depth = min(depth, self.depth - FLOOR_OFFSET_FRACTION * self.step)
        return 0.0 if self.sheet is None else self.sheet.start - self.sheet.side * depth


def current_claims(group: Sequence[Claim]) -> tuple[Claim, ...]:
    """Return the claims of an operation that the programs have to meet.

    These are all claims, or, if only a single level is formed, those on its segment and those without one.
    """
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
    """Return all claims that a single level is formed, each with its operation, pass and file.

    ``groups`` has the claims of each operation, with the index of the setup.
    """
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
            file = None
            fault = "" if stated is not None else "its operation does not form a single level"
            if stated is not None and stated.file is not None:
                try:
                    file = springback_file.read_level_data(Path(stated.file))
                except ValueError as error:
                    fault = f"{Path(stated.file).name}: {error}"
            first = order[0][0].name if order else ""
            out.append(SingleLevel(claim, index, operation, sheets.get(claim.segment), first, file, fault))
    return tuple(out)
