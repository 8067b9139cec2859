"""Claims on milling that name a file or curves, worked out by the proof as ways and feeds of segments."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

from planner.claims import Claim
from planner.claims_dialogue import OperatorDialogue
from planner.claims_milling import Engraves, MillsProgram, SparesPart
from planner.issues import Issue
from planner.segments import Segment
from planner.verify import mill_engraved, mill_program
from planner.verify.gcode_words import UnreadableError
from planner.verify.mill_engraved import NotThereError
from planner.verify.mill_program import Pass

CODE = "verify.mill_path"
Claims = Mapping[str, tuple[Claim, ...]]


def worked_out(claims: Claims) -> tuple[Claims, tuple[Issue, ...]]:
    """The claims by operation, those on G-code files and on curves put as ways and feeds of segments; and
    what could not be read."""
    issues: list[Issue] = []
    out = {name: tuple(_group(group, issues)) for name, group in claims.items()}
    return out, tuple(issues)


def _group(group: tuple[Claim, ...], issues: list[Issue]) -> Iterator[Claim]:
    """The claims of an operation."""
    programs = [claim for claim in group if isinstance(claim, MillsProgram)]
    known = {program.name: _passes(program, issues) for program in programs}
    for claim in group:
        if isinstance(claim, MillsProgram):
            for own in known[claim.name]:
                yield from mill_program.segments(claim, own)
        elif isinstance(claim, Engraves):
            try:
                yield from mill_engraved.segments(claim)
            except NotThereError as error:
                what = f"{claim.name}: {error}; the planner has it otherwise, report this"
                issues.append(Issue(CODE, what, field=claim.name))
        elif isinstance(claim, SparesPart) and known:
            yield dataclasses.replace(claim, segments=tuple(_each(claim.segments, known)))
        elif isinstance(claim, OperatorDialogue) and known:
            yield mill_program.spoken(claim, programs, known)
        else:
            yield claim


def _each(segments: tuple[Segment, ...], known: Mapping[str, tuple[Pass, ...]]) -> Iterator[Segment]:
    """The segments, a file's passes for the name of that file's cut."""
    for segment in segments:
        if segment.name in known:
            yield from (Segment(segment.kind, f"{segment.name}_{one.number}") for one in known[segment.name])
        else:
            yield segment


def _passes(program: MillsProgram, issues: list[Issue]) -> tuple[Pass, ...]:
    """The passes of a file; none where it cannot be read, which is an issue."""
    try:
        return mill_program.passes(program)
    except UnreadableError as error:
        path = str(program.file.path)
        where = f"{path}, line {error.line}" if error.line else path
        what = f"{where}: the proof's own reader of G-code cannot read it: {error}; correct the file"
        issues.append(Issue(CODE, what, file=path, line=error.line or None))
        return ()
