"""The paths of both tools over one pass, whatever the mode."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from planner.forming.adsif_path import adsif_tool_path
from planner.forming.operation import GAPPED
from planner.forming.paths import make_path
from planner.forming.support import tool_path
from planner.forming.thickness import steepest
from planner.forming.values import ContactPath, Pass, ToolPath
from planner.forming.work import Work
from planner.issues import Issue, TandemError
from planner.units import MM

NARROW: Final = "forming.tool_radius"
SHORTEST: Final = 0.006
"""Moves take so long [s] at least at the stated feed; controllers plan none that are much shorter."""
SPARE: Final = 0.01 * MM
"""How far tools may be off their way, where fillets are that the ball just fits, times how steeply the
sheet's thickness changes with the wall's angle."""
LEFT: Final = 0.06 * MM
"""So far off the floor the ball may stay for it."""
TOP: Final = 5.0 * MM
"""Loops about the top of a male die that are no wider than this may be left out."""


def lay_all(work: Work) -> list[tuple[Pass, ToolPath]]:
    """Where the tools are over all passes. Raises ``TandemError`` with the codes ``forming.*``: of balls that
    are too large for several passes the one that has to be the smallest first."""
    out: list[tuple[Pass, ToolPath]] = []
    narrow: list[Issue] = []
    for one in work.passes:
        try:
            out.append((one, lay(work, one)))
        except TandemError as error:
            if any(issue.code != NARROW for issue in error.issues):
                raise
            narrow += error.issues
    if narrow:
        raise TandemError(sorted(narrow, key=lambda issue: issue.limit or 0.0))
    return out


def lay(work: Work, one: Pass) -> ToolPath:
    """Where the tools are over a pass. Raises ``TandemError`` with the codes ``forming.*``."""
    op, other = work.operation, work.supporter(one)
    former = work.heads[work.former(one)]
    if op.mode == "adsif" and other is not None:
        return adsif_tool_path(one, op, former, work.heads[other], work.thickness, work.sheet.metal)
    options = work.options
    if op.mode in GAPPED or op.mode == "heat":
        options = dataclasses.replace(options, spare=_spare(work, one))
    contact = make_path(one, former.radius, options)
    if work.tree.feature(one.feature).sign == one.side:
        contact = _off_the_top(contact, SHORTEST * op.feed_mm_s * MM)
    support = None if other is None else work.heads[other]
    return tool_path(one, contact, op, former, support, work.thickness, work.clamp, work.every)


def _spare(work: Work, one: Pass) -> float:
    """How much larger [m] than the ball fillets have to be so that it goes through them: beside the wall, in
    one that is hardly larger, it touches the floor for the wall: the gap of the tools is another, and the
    place to be heated is elsewhere."""
    wanted = SPARE * work.operation.squeeze * work.thickness / (work.operation.gap_tol_mm * MM)
    return min(wanted, LEFT / max(1.0 - float(np.cos(steepest(one.vertices, one.faces))), 1e-3))


def _off_the_top(path: ContactPath, shortest: float) -> ContactPath:
    """A path over a male die without its beginning, where loops about the die's top, on which the sheet lies
    flat already, have moves of less than ``shortest`` [m]."""
    away = np.linalg.norm(path.centre - path.centre[0], axis=1)
    short = np.linalg.norm(np.diff(path.centre, axis=0), axis=1) < shortest
    rows = np.flatnonzero(short & (np.maximum.accumulate(away)[1:] <= TOP))
    if not len(rows):
        return path
    first = int(rows[-1]) + 1
    kept = {field.name: getattr(path, field.name)[first:].copy() for field in dataclasses.fields(path)}
    kept["loop"] -= kept["loop"][0]
    kept["working"][0] = False
    return ContactPath(**kept)
