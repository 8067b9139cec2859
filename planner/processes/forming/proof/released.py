"""Tools that go deeper by what the sheet comes back by: their files, and where they are without that."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner.claims.claim import Claim
from planner.geometry.arrays import FloatArray
from planner.problem import Problem
from planner.processes.forming.claims import ComesBack, FormsSheet
from planner.processes.forming.proof import springback_file
from planner.processes.forming.proof.level import OneLevel
from planner.processes.forming.proof.springback_file import Deeper, Given


@dataclasses.dataclass(frozen=True, eq=False)
class Told:
    """What a claim is about: its ``operation`` in setup ``index``, and what its file holds, None with the
    ``fault`` where it cannot be read."""

    claim: ComesBack
    index: int
    operation: Any
    given: Given | None
    fault: str = ""


@dataclasses.dataclass(frozen=True, eq=False)
class Released:
    """Of the tools in one segment: the arm of the ``former``, on ``side``, and how deep its way is."""

    former: str
    side: int
    deeper: Deeper

    def lifted(self, shift: FloatArray) -> FloatArray:
        """What is to be added along z (N,) [m] so that tools are where they would be without it."""
        return self.side * shift


def told(problem: Problem, by_setup: Sequence[tuple[int, Claim]]) -> tuple[Told, ...]:
    """All claims of deeper tools, with their files."""
    out = []
    for index, claim in by_setup:
        if not isinstance(claim, ComesBack):
            continue
        named = [one for one in problem.operations if one.name == claim.operation]
        stated = getattr(named[0], "springback", None) if named else None
        if stated is None:
            out.append(Told(claim, index, None, None, "its operation names no springback file"))
            continue
        try:
            out.append(Told(claim, index, named[0], springback_file.read(Path(stated.file))))
        except ValueError as error:
            out.append(Told(claim, index, named[0], None, f"{Path(stated.file).name}: {error}"))
    return tuple(out)


def released(
    found: Sequence[Told], levels: Sequence[OneLevel], by_setup: Sequence[tuple[int, Claim]]
) -> dict[tuple[str, int], Released]:
    """Of each segment, in its setup, whose tools are deeper by a file, of a part or of one level."""
    out = {
        (one.claim.segment.key, one.index): Released(
            one.sheet.arm, one.sheet.side, Deeper(one.given.way, one.sheet.side)
        )
        for one in levels
        if one.given is not None and one.sheet is not None
    }
    for one in found:
        for index, claim in by_setup:
            if not isinstance(claim, FormsSheet) or index != one.index or one.given is None:
                continue
            way = one.given.ways.get(claim.segment.name)
            if way is not None and claim.segment in one.claim.segments:
                out[claim.segment.key, index] = Released(claim.arm, claim.side, Deeper(way, claim.side))
    return out
