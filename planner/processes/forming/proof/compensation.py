"""Tools with springback compensation: their files, and their positions without the shifts."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.problem import Problem
from planner.processes.forming.claims import CompensatesSpringback, FormsSheet
from planner.processes.forming.proof import springback_file
from planner.processes.forming.proof.level import SingleLevel
from planner.processes.forming.proof.springback_file import ShiftLookup, SpringbackFileData


@dataclasses.dataclass(frozen=True, eq=False)
class CompensationClaim:
    """A claim of springback compensation, with its file.

    Attributes:
        claim: Claim.
        index: Index of the setup.
        operation: Operation of the problem.
        file: Data of its file, or None.
        fault: Why the file cannot be read, or why there is none; empty if there is a file.
    """

    claim: CompensatesSpringback
    index: int
    operation: Any
    file: SpringbackFileData | None
    fault: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class CompensatedSegment:
    """The compensation of one segment, with which the proof removes the shifts of its tools.

    Attributes:
        forming_arm: Arm of the forming tool.
        side: Side of the forming tool: +1 above the sheet, -1 below.
        lookup: Lookup of the shifts by position of the forming tool.
    """

    forming_arm: str
    side: int
    lookup: ShiftLookup

    def z_correction(self, shift: FloatArray) -> FloatArray:
        """Return what is added along z (N,) [m] to the tools to undo their shifts (N,) [m] into the sheet."""
        return self.side * shift


def compensation_claims(
    problem: Problem, by_setup: Sequence[tuple[int, Claim]]
) -> tuple[CompensationClaim, ...]:
    """Return all claims of springback compensation, with their files.

    ``by_setup`` has all claims, each with the index of its setup.
    """
    out = []
    for index, claim in by_setup:
        if not isinstance(claim, CompensatesSpringback):
            continue
        named = [candidate for candidate in problem.operations if candidate.name == claim.operation]
        stated = getattr(named[0], "springback", None) if named else None
        if stated is None:
            out.append(CompensationClaim(claim, index, None, None, "its operation names no springback file"))
            continue
        try:
            out.append(
                CompensationClaim(
                    claim, index, named[0], springback_file.read_springback_data(Path(stated.file))
                )
            )
        except ValueError as error:
            out.append(CompensationClaim(claim, index, named[0], None, f"{Path(stated.file).name}: {error}"))
    return tuple(out)


def compensated_segments(
    compensations: Sequence[CompensationClaim],
    levels: Sequence[SingleLevel],
    by_setup: Sequence[tuple[int, Claim]],
) -> dict[tuple[str, int], CompensatedSegment]:
    """Return the segments whose tools are shifted by a file, by the segment's key and the index of the setup.

    The file is the springback file of a part or the file of a single level.
    """
    out = {
        (item.claim.segment.key, item.index): CompensatedSegment(
            item.sheet.arm, item.sheet.side, ShiftLookup(item.file.path, item.sheet.side)
        )
        for item in levels
        if item.file is not None and item.sheet is not None
    }
    for item in compensations:
        for index, claim in by_setup:
            if not isinstance(claim, FormsSheet) or index != item.index or item.file is None:
                continue
            file_path = item.file.paths.get(claim.segment.name)
            if file_path is not None and claim.segment in item.claim.segments:
                out[claim.segment.key, index] = CompensatedSegment(
                    claim.arm, claim.side, ShiftLookup(file_path, claim.side)
                )
    return out
