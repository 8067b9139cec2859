"""One level of a pass: which targets of the pass belong to it, and its path alone.

A level is a loop of the path, with the targets that follow it without going deeper: floors and other loops at
its height. The flat first loop belongs to the first level. Levels are counted from 0, as in the files of the
springback loop. Level K goes from K to K + 1 step-downs below the flat; the last level of a spiral is flat
along the end.
"""

import dataclasses
from typing import Final

import numpy as np

from planner.geometry.arrays import FloatArray, lengths
from planner.geometry.units import MM
from planner.issues import TandemError, issue_error
from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath, level_depths
from planner.processes.forming.plan.operation import Level
from planner.processes.forming.plan.process_plan import FormingWork, make_tool_path

MIN_LEVEL_STEP_M: Final = 0.01 * MM
"""Minimum depth [m] of a loop below the previous one for a new level.

Shallower loops are floors of that level.
"""
LEVEL_HEIGHT_TOLERANCE_FRACTION: Final = 0.2
"""Maximum deviation of a level's points from its height range, and of its end from its nominal end, as a
fraction of the step-down.
"""
ON_FACE_TOLERANCE_M: Final = 0.1 * MM
"""Balls farther [m] from the face than this are in the air."""


def first_loops(forming_pass: FormingPass, contact: ContactPath) -> list[int]:
    """Return the number of the loop with which each level of a pass starts.

    A loop starts a level if it has at least three points and if its mean height is deeper than the previous
    level by at least `MIN_LEVEL_STEP_M`.
    """
    out = []
    last_depth = 0.0
    for number in np.unique(contact.loop).tolist():
        height = contact.point[contact.loop == number, 2]
        depth = abs(float(height.mean()) - forming_pass.start)
        if len(height) < 3 or depth - last_depth < MIN_LEVEL_STEP_M:
            continue
        last_depth = depth
        out.append(int(number))
    return out


def level_pass(work: FormingWork, level: Level) -> FormingPass:
    """Return the pass to which a level belongs: the one that the level names, else the first pass.

    Raises:
        TandemError: forming.path_options if no pass has the level's name.
    """
    matches = [forming_pass for forming_pass in work.passes if level.pass_name in (None, forming_pass.name)]
    if not matches:
        names = ", ".join(forming_pass.name for forming_pass in work.passes)
        raise _option_error(
            f"got pass {level.pass_name}, allowed are: {names}", "pass_name", "name one of them"
        )
    return matches[0]


def make_level_path(work: FormingWork, forming_pass: FormingPass, level: Level) -> FormingToolPath:
    """Compute the path of one level, if the job forms a single level of a pass.

    The path of the whole pass is computed, and the loops of the level are selected from it.

    Raises:
        TandemError: forming.path_options if the level is beyond the last one or is not at the depth that its
            number implies; any issue of the path of the whole pass.
    """

    def select_level(contact: ContactPath) -> ContactPath:
        """Return the part of the contact path that forms the level."""
        loops = first_loops(forming_pass, contact)
        if level.number >= len(loops):
            message = f"got level {level.number}, {forming_pass.name} has 0 to {len(loops) - 1}"
            raise _option_error(message, "number", "after the last level the pass is done")
        start = 0 if level.number == 0 else loops[level.number]
        end = loops[level.number + 1] if level.number + 1 < len(loops) else int(contact.loop.max()) + 1
        indices = np.flatnonzero((contact.loop >= start) & (contact.loop < end))
        if work.operation.path == "helical" and contact.working[indices[0]]:
            indices = np.append(indices[0] - 1, indices)  # the seam, at which the previous loop ends
        distance = lengths(contact.centre[indices] - contact.point[indices])
        is_near = distance < work.heads[work.forming_arm(forming_pass)].radius + max(
            ON_FACE_TOLERANCE_M, _allowed_standoff(work)
        )
        indices = indices[int(np.argmax(is_near)) :]  # the approach covers the move through the air
        _require_height(work, forming_pass, contact.point[indices, 2], level)
        kept = {
            field.name: getattr(contact, field.name)[indices].copy() for field in dataclasses.fields(contact)
        }
        kept["loop"] = np.maximum(kept["loop"], start) - start
        kept["working"][0] = False
        return ContactPath(**kept)

    return make_tool_path(work, forming_pass, select_level)


def _allowed_standoff(work: FormingWork) -> float:
    """Return the distance [m] that balls may stay off the part where they do not fit."""
    return (work.operation.unreached_mm or 0.0) * MM


def _require_height(work: FormingWork, forming_pass: FormingPass, height: FloatArray, level: Level) -> None:
    """Raise ``TandemError`` if contact heights (N,) [m] do not fit the whole step-downs of a level."""
    step = (work.operation.stepdown_mm or 0.0) * MM
    top, bottom = level_depths(forming_pass, step, level.number)
    depth = forming_pass.side * (forming_pass.start - height)
    tolerance = LEVEL_HEIGHT_TOLERANCE_FRACTION * step
    if depth.min() < top - tolerance or abs(depth.max() - bottom) > tolerance:
        message = (
            f"level {level.number} of {forming_pass.name} is {depth.min() / MM:.2f} to "
            f"{depth.max() / MM:.2f} mm deep, expected {top / MM:.2f} to {bottom / MM:.2f} mm from whole "
            f"steps of {step / MM:g} mm"
        )
        hint = (
            "end with the previous level, or form the pass as a whole, because steps differ where balls do "
            "not reach the floor"
        )
        raise _option_error(message, "number", hint)


def _option_error(message: str, field: str, hint: str) -> TandemError:
    return issue_error("forming.path_options", message, field=f"level.{field}", hint=hint)
