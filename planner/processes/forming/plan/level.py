"""One level of a pass: which targets of its path are of it, and the path of it alone.

A level is a loop of the path, and what follows it without going deeper: floors, other loops at its height.
The flat first loop belongs to the first level. Levels are counted from 0, as the files of the springback loop
count them; level K goes from K to K + 1 stepdowns below the flat, a spiral's last one flat along its end.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.issues import TandemError, refusal
from planner.processes.forming.plan.contact import ContactPath, Pass, ToolPath, heights
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.process_plan import Work, lay

LEAST_STEP: Final = 0.01 * MM
"""Loops that are less deeper [m] than the last one belong to its level: floors."""
OFF_STEP: Final = 0.2
"""Places of a level are beyond its heights, and its end is off its own, by no more than this share of a
step."""
ON_FACE: Final = 0.1 * MM
"""Balls that are farther [m] off the face are in the air."""


def first_loops(one: Pass, contact: ContactPath) -> list[int]:
    """The loop of the path with which each level of a pass begins: levels' own loops."""
    out, last = [], 0.0
    for number in np.unique(contact.loop).tolist():
        height = contact.point[contact.loop == number, 2]
        depth = abs(float(height.mean()) - one.start)
        if len(height) < 3 or depth - last < LEAST_STEP:
            continue
        last = depth
        out.append(int(number))
    return out


def pass_of(work: Work, level: Level) -> Pass:
    """The pass of a level. Raises ``TandemError`` (forming.path_options) where there is none of its name."""
    found = [one for one in work.passes if level.pass_name in (None, one.name)]
    if not found:
        names = ", ".join(one.name for one in work.passes)
        raise _refused(f"got pass {level.pass_name}, passes are: {names}", "pass_name", "name one of them")
    return found[0]


def alone(work: Work, one: Pass, level: Level) -> ToolPath:
    """The path of one level. Raises ``TandemError``: forming.path_options beyond the last one, or where that
    is not where its number says, and what laying the pass is refused for."""

    def own(contact: ContactPath) -> ContactPath:
        loops = first_loops(one, contact)
        if level.number >= len(loops):
            what = f"got level {level.number}, {one.name} has 0 to {len(loops) - 1}"
            raise _refused(what, "number", "after the last level the pass is done")
        begin = 0 if level.number == 0 else loops[level.number]
        end = loops[level.number + 1] if level.number + 1 < len(loops) else int(contact.loop.max()) + 1
        rows = np.flatnonzero((contact.loop >= begin) & (contact.loop < end))
        if work.operation.path == "helical" and contact.working[rows[0]]:
            rows = np.append(rows[0] - 1, rows)  # the seam, at which the loop before ends
        away = lengths(contact.centre[rows] - contact.point[rows])
        near = away < work.heads[work.former(one)].radius + max(ON_FACE, _spared(work))
        rows = rows[int(np.argmax(near)) :]  # over to it in the air is what the way in does
        _require_height(work, one, contact.point[rows, 2], level)
        kept = {f.name: getattr(contact, f.name)[rows].copy() for f in dataclasses.fields(contact)}
        kept["loop"] = np.maximum(kept["loop"], begin) - begin
        kept["working"][0] = False
        return ContactPath(**kept)

    return lay(work, one, own)


def _spared(work: Work) -> float:
    """How far [m] balls may stay off the part where they do not fit."""
    return (work.operation.unreached_mm or 0.0) * MM


def _require_height(work: Work, one: Pass, height: FloatArray, level: Level) -> None:
    step = (work.operation.stepdown_mm or 0.0) * MM
    top, bottom = heights(one, step, level.number)
    depth = one.side * (one.start - height)
    most = OFF_STEP * step
    if depth.min() < top - most or abs(depth.max() - bottom) > most:
        what = (
            f"level {level.number} of {one.name} is {depth.min() / MM:.2f} to {depth.max() / MM:.2f} mm "
            f"deep, by whole steps of {step / MM:g} mm it is {top / MM:.2f} to {bottom / MM:.2f} mm"
        )
        hint = (
            "end with the level before, or form the pass as a whole: where balls do not reach the floor "
            "steps are others"
        )
        raise _refused(what, "number", hint)


def _refused(what: str, field: str, hint: str) -> TandemError:
    return refusal("forming.path_options", what, field=f"level.{field}", hint=hint)
