"""Tools that go where a scan says: each target moved along z by what the part before was off.

Of a part that was formed with the commanded way C, whose scan is off the wanted face by d along its normal,
too shallow by e = d / cos a along z on a wall of angle a, the next one is formed with

    C' = C + g (e + m),

g the gain (a displacement adjustment, as springback is compensated in die design), and m what comes back
more, or less, of a part that is formed as it is wanted (`planner.shopfloor.scan.forming_rate`): C, e and
the wall above say that. Both are averaged over the ball's width, and what comes out is limited in slope as
every springback file is. What is formed in a pass whose face is not the part's own is not on the scan: its
tools go as they went.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from planner.geometry.arrays import BoolArray, FloatArray, unit
from planner.geometry.curves import arc_length
from planner.geometry.mesh_queries import Nearness
from planner.geometry.units import MM
from planner.issues import refusal
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.operation import Springback
from planner.processes.forming.plan.process_plan import Work
from planner.processes.forming.plan.springback.compensation import (
    Way,
    at_targets,
    require_mode,
    smoothed,
    way_of,
)
from planner.processes.forming.plan.springback.compensation_file import (
    VERSIONS,
    Compensation,
    passes_text,
    require_limits,
    sealed,
    way_lines,
)
from planner.shopfloor.align.probing import ProbedPoints
from planner.shopfloor.scan import forming_rate
from planner.shopfloor.scan.cloud import Cloud
from planner.shopfloor.scan.deviation import SPACING, Deviation
from planner.shopfloor.scan.registration import Pose

ON_FACE: Final = 0.1 * MM
"""Half of a pass's contact is within this [m] of the wanted face, or the pass is one before the last."""
LEAST_SEEN: Final = 0.7
"""Share of a pass's way along which the scan shows the part at least."""
DECIMALS: Final = 9
"""Digits of the pose behind the point, m and cosines."""


@dataclasses.dataclass(frozen=True, eq=False)
class Adjusted:
    """The ``way`` of a pass as it is formed next; of its targets, N of them: how much too shallow the scan
    shows the part ``before`` (N,) [m, along z], NaN where it does not, and what is ``foretold`` (N,) [m] of
    the next one. ``point`` (N, 3) [m] of contact; ``seen``: whether the scan decides on this pass."""

    way: Way
    point: FloatArray
    before: FloatArray
    foretold: FloatArray
    seen: bool


def adjusted(
    work: Work,
    laid: Sequence[tuple[Pass, ToolPath]],
    given: Compensation | None,
    found: Deviation,
    top: bool,
    gain: float,
    limits: Springback,
) -> tuple[Adjusted, ...]:
    """Ways of all passes for the next part, from what the scan of the one before has ``found`` on its ``top``
    or bottom face, and the file that this was ``given``.

    Raises ``TandemError``: forming.springback_mode, forming.compensation beyond the ``limits``, scan.hole
    where the scan shows too little of a way, scan.other_part where no pass forms the part's own face.
    """
    require_mode(work)
    before = {} if given is None else {way.name: way for way in given.ways}
    near = Nearness(found.face, SPACING)
    out = []
    for one, path in laid:
        # the face that is touched, as the scanned one is: moved along z by the sheet's thickness
        up = work.thickness * (float(top) - float(one.side > 0))
        lift = np.array([0.0, 0.0, up])
        on_face = float(np.median(near.distance(path.contact.point[::10] + lift)[0])) <= ON_FACE
        out.append(
            _adjusted(work, one, path, before.get(one.name), found, lift, gain if on_face else 0.0, limits)
        )
    if not any(one.seen for one in out):
        what = (
            "no pass forms the wanted face where it is in the part, so a scan says nothing of where tools go"
        )
        hint = "form with strategy: in_place, or adjust the part's file by hand"
        raise refusal("scan.other_part", what, hint=hint)
    require_limits([one.way for one in out], limits.slope, limits.most_mm * MM)
    return tuple(out)


def _adjusted(
    work: Work,
    one: Pass,
    path: ToolPath,
    before: Way | None,
    found: Deviation,
    lift: FloatArray,
    gain: float,
    limits: Springback,
) -> Adjusted:
    radius = work.heads[work.former(one)].radius
    places = arc_length(path.former)
    went = np.zeros(len(places)) if before is None else at_targets(before, path)

    def short(contact: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How much too shallow the part was, NaN where that is not known, and what tools are to go deeper."""
        off = one.side * found.along_z(contact + lift)
        known = _filled(off, at)
        back = np.interp(at, places, went) + known
        normal = unit(np.column_stack([np.interp(at, places, each) for each in path.contact.normal.T]))
        above = found.nearest(contact + lift + forming_rate.up_the_wall(normal, one.side))
        less = _filled(off - one.side * found.along_z(above), at)
        drop = one.side * (above - contact - lift)[:, 2]
        return off, known + forming_rate.as_wanted(back, less, drop)

    def asked(contact: FloatArray, _: FloatArray, at: FloatArray) -> FloatArray:
        value = np.interp(at, places, went)
        if not gain:
            return value
        off, more = short(contact, at)
        _require_seen(one, np.isfinite(off), contact)
        return np.asarray(value + gain * smoothed(more, radius / max(float(at[1]), 1e-12)))

    way, _ = way_of(one.name, path, radius, asked, limits.slope)
    off = more = np.full(len(places), np.nan)
    if gain:
        off, more = short(path.contact.point, places)
        more = np.where(np.isfinite(off), more, np.nan)
    return Adjusted(way, path.contact.point, off, more - (at_targets(way, path) - went), gain != 0.0)


def _filled(value: FloatArray, at: FloatArray) -> FloatArray:
    """Values (N,) at places ``at`` (N,) [m] of a way, straight where they are not known; 0 if none is."""
    known = np.isfinite(value)
    return np.interp(at, at[known], value[known]) if known.any() else np.zeros(len(at))


def _require_seen(one: Pass, seen: BoolArray, contact: FloatArray) -> None:
    if seen.mean() >= LEAST_SEEN:
        return
    x, y, z = contact[np.flatnonzero(~seen)[0]] / MM
    what = (
        f"pass {one.name}: the scan shows {100.0 * seen.mean():.0f} % of its way, allowed "
        f"{100.0 * LEAST_SEEN:g} % or more; nothing is known at ({x:.0f}, {y:.0f}, {z:.0f}) mm"
    )
    hint = "scan the part from more sides, with spray where it is bright"
    raise refusal("scan.hole", what, value=100.0 * float(seen.mean()), unit="%", hint=hint)


def text(
    title: str,
    operation: str,
    identity: Mapping[str, Any],
    cloud: Cloud,
    unit: float,
    top: bool,
    pose: Pose,
    marks: ProbedPoints | None,
    gain: float,
    given: Compensation | None,
    made: Sequence[Adjusted],
    slope: float,
) -> str:
    """The file of adjustments: from which scan it comes, where that lies, the ways that were formed and those
    to come; its last line is a checksum, as in a springback file."""
    rows = [] if marks is None else list(zip(marks.names, marks.first / MM, marks.second / MM, strict=True))
    head = {
        "tandem_adjustment": VERSIONS["tandem_adjustment"],
        "problem": title,
        "operation": operation,
        "belongs_to": dict(identity),
        "scan": {
            "file": cloud.file,
            "sha256": cloud.digest,
            "points": len(cloud.points),
            "unit_m": unit,
            "face": "top" if top else "bottom",
            "pose": np.round(pose.matrix, DECIMALS).tolist(),
            "marks": [[name, a.tolist(), b.tolist()] for name, a, b in rows],
        },
        "gain": gain,
        "adjusts": [one.way.name for one in made if one.seen],
        "slope": slope,
    }
    lines = [f"{json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in head.items()]
    lines.append(f'"before": {passes_text(given.ways if given is not None else ())}')
    return sealed([*lines, *way_lines([one.way for one in made])])
