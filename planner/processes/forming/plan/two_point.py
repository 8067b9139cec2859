"""The die and the blank holder of two point forming.

**Die** (``tpif``), fixed, against the wanted part: it may not stand in it, and a full one must be
where the part is.

**Blank holder** over a male die, which sinks by a step at each pulse of a signal. All is told in
the frame of the die, which stands still, and in which the sheet's frame is the place of the sheet
at the end. The clamp begins with the flat sheet on the top of the die. The tool goes outward and
down from there, and the flat around it sinks with it: the clamp is as low as the lowest level that
the tool's tip has reached, within one step. A pulse is given at a stop where that brings the clamp
nearer to the tip, half a step before or after it; before a move that goes down by more, up to a
step ahead of it.

What is not looked at: whether the holder has moved when the tool goes on (it has the time of a
pulse, on and off, and gives no answer), and how the sheet bends between the tool and a rim that is
up to a step off.
"""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely

from planner.geometry.arrays import FloatArray, IntArray, dots
from planner.geometry.mesh import TriangleMesh, face_normals, small_pieces
from planner.geometry.mesh_queries import Nearness
from planner.geometry.units import DEG, MM, measurement
from planner.issues import Issue, Severity
from planner.processes.forming.claims import SinksHolder
from planner.processes.forming.plan.contact import Pass, ToolPath
from planner.processes.forming.plan.operation import Die
from planner.processes.forming.plan.process_plan import Work, segment
from planner.targets import Action

DIE_SPACING: Final = 3e-3
"""Distance [m] of the points of a face that are held against a die."""
SUPPORT_DISTANCE: Final = 0.5e-3
"""A full die farther [m] from the part than this does not support it there."""
WRONG_PLACE_HEIGHT: Final = 10e-3
"""A die that stands out so far [m] over the whole part is in a wrong unit or place; no more is asked."""
UNSUPPORTED_SHARE: Final = 0.02
"""A warning is due where a full die is away from more than this share of the walls."""
_MOST_POINTS: Final = 20_000
"""Pieces at most into which a face is divided for its points."""
_FLATTEST_WALL: Final = 2.0 * DEG
"""Walls flatter than this [rad] need no die."""


def die_issues(
    passes: Sequence[Pass], die: Die, mesh: TriangleMesh, thickness: float, tolerance: float
) -> tuple[Issue, ...]:
    """Issues of a die whose ``mesh`` is in the sheet's frame: forming.die_gouge, an error, where it stands in
    the part's far face by more than ``tolerance`` [m]; forming.die_far, a warning, where a full one is away
    from the walls. ``thickness`` [m] of the sheet."""
    pieces, _ = small_pieces(mesh.vertices[mesh.faces], DIE_SPACING, _MOST_POINTS)
    points = np.concatenate([pieces.mean(axis=1), mesh.vertices])
    out: list[Issue] = []
    for one in passes:
        shift = np.array([0.0, 0.0, -one.side * thickness])
        far = TriangleMesh(one.vertices + shift, one.faces)
        deep = list(_gouge(one, far, points, tolerance))
        out += deep
        if die.full and not deep:
            out += _away(one, far, mesh)
    return tuple(out)


def _gouge(one: Pass, far: TriangleMesh, points: FloatArray, tolerance: float) -> Iterator[Issue]:
    inside = shapely.Polygon(one.region[:, :2]).buffer(DIE_SPACING)
    points = points[shapely.contains_xy(inside, points[:, 0], points[:, 1])]
    if not len(points):
        return
    depth = one.side * points[:, 2] - float((one.side * far.vertices[:, 2]).max())
    if depth.max() <= WRONG_PLACE_HEIGHT:
        distance, face = Nearness(far, DIE_SPACING).distance(points)
        normals = face_normals(far)[face]
        ahead = one.side * dots(points - far.vertices[far.faces[face, 0]], normals)
        depth = np.where(ahead > 0.0, distance, 0.0)
    k = int(np.argmax(depth))
    if depth[k] <= tolerance:
        return
    x, y, z = (float(value) / MM for value in points[k])
    what = f"feature {one.feature}: the die stands {depth[k] / MM:.2f} mm in the part at ({x:.1f}, {y:.1f}, "
    what += f"{z:.1f}) mm, allowed is {tolerance / MM:.2f} mm; check its unit, or lower it by so much: it "
    what += "has to leave room for the sheet's thickness"
    yield Issue(
        "forming.die_gouge", what, field="die", **measurement(float(depth[k]) / MM, tolerance / MM, "mm")
    )


def _away(one: Pass, far: TriangleMesh, mesh: TriangleMesh) -> Iterator[Issue]:
    normals = face_normals(far)
    wall = np.arccos(np.clip(normals[:, 2], -1.0, 1.0)) > _FLATTEST_WALL
    pieces, _ = small_pieces(far.vertices[far.faces[wall]], DIE_SPACING, _MOST_POINTS)
    points = pieces.mean(axis=1)
    area = np.linalg.norm(np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0]), axis=1)
    distance, _ = Nearness(mesh, DIE_SPACING).distance(points)
    share = float(area[distance > SUPPORT_DISTANCE].sum() / area.sum())
    if share <= UNSUPPORTED_SHARE:
        return
    k = int(np.argmax(distance))
    x, y, z = (float(value) / MM for value in points[k])
    yield Issue(
        "forming.die_far",
        f"feature {one.feature}: the full die is more than {SUPPORT_DISTANCE / MM:g} mm away from "
        f"{100 * share:.0f} % "
        f"of the walls, most {distance[k] / MM:.2f} mm at ({x:.1f}, {y:.1f}, {z:.1f}) mm; check its "
        "unit and place, or state full: false for a partial die",
        Severity.WARNING,
        field="die",
        **measurement(float(distance[k]) / MM, SUPPORT_DISTANCE / MM, "mm"),
        accepted=False,
    )


PULSE_SECONDS: Final = 0.1
"""The signal is on for so long [s], and off for so long before it is on again."""
SAME_LEVEL: Final = 1e-6
"""Levels nearer to each other [m] are the same."""


def holder_sinks(work: Work) -> bool:
    """Whether the clamp sinks while the sheet is formed."""
    return work.operation.die is not None and work.operation.die.holder == "sinking"


def holder_step(work: Work) -> float:
    """By how much [m] a pulse lowers the clamp."""
    op = work.operation
    own = None if op.die is None else op.die.step_mm
    return (own if own is not None else op.stepdown_mm or 0.0) * MM


def holder_claim(work: Work) -> SinksHolder | None:
    """What must hold of the signal: in the first pass, in which alone the clamp sinks."""
    die = work.operation.die
    if die is None or not holder_sinks(work):
        return None
    one = work.passes[0]
    arm = work.former(one)
    radius = work.heads[arm].radius
    return SinksHolder(
        segment(one), arm, one.side, radius, die.signal, one.start, one.end, holder_step(work), PULSE_SECONDS
    )


def pulses(one: Pass, path: ToolPath, radius: float, by: float) -> IntArray:
    """How many pulses (N,) are given at each target of a pass, each lowering the clamp ``by`` [m].

    ``radius`` [m] of the ball. In all there are as many whole steps as the pass is deep. The clamp is within
    one step of the tip's lowest level wherever moves go down by no more than a step; `holder_issues` tells
    where they do.
    """
    sunk = _sunk(one, path, radius)
    after = np.append(sunk[1:], sunk[-1])
    wanted = np.floor(0.5 * (sunk + after) / by + 0.5)
    least, most = np.ceil((after - SAME_LEVEL) / by - 1.0), np.floor((sunk + SAME_LEVEL) / by + 1.0)
    total = np.clip(np.clip(wanted, least, most), 0.0, _whole(one, by))
    total[-1] = _whole(one, by)
    return np.diff(np.maximum.accumulate(total), prepend=0.0).astype(np.int64)


def holder_issues(work: Work) -> Iterator[Issue]:
    """Dies and holders that do not go together; to be asked before paths are laid."""
    die = work.operation.die
    if die is None:
        return
    if die.kind == "male" and die.holder == "fixed":
        what = "a male die stands through the flat sheet, whose clamp is fixed at the level of the part's rim"
        hint = "state holder: sinking, by which the clamp starts at the die's top"
        yield Issue("forming.holder", what, field="die.holder", hint=hint)
    if die.kind == "female" and die.holder == "sinking":
        what = "the sheet's rim lies on a female die; a clamp that sinks would bend it over the die's edge"
        yield Issue("forming.holder", what, field="die.holder", hint="state holder: fixed")
    features = sorted({one.feature for one in work.passes})
    if holder_sinks(work) and len(features) > 1:
        what = (
            f"the part has {len(features)} features, allowed is 1: while the clamp sinks they would all have "
            "to be formed level by level"
        )
        hint = "form one feature over a male die, the others in a job of their own"
        yield Issue("forming.holder", what, field="die", value=len(features), limit=1, hint=hint)


def step_issues(work: Work, paths: Sequence[tuple[Pass, ToolPath]]) -> Iterator[Issue]:
    """Where the clamp cannot keep within a step of the tool, or does not come to the rim's level."""
    if not holder_sinks(work):
        return
    (one, path), by = paths[0], holder_step(work)
    sunk = _sunk(one, path, work.heads[work.former(one)].radius)
    total = by * np.cumsum(pulses(one, path, work.heads[work.former(one)].radius, by))
    after = np.append(sunk[1:], sunk[-1])
    off = np.maximum(np.abs(sunk - total), np.abs(after - total))
    k = int(np.argmax(off))
    if off[k] > by + 2.0 * SAME_LEVEL:
        what = (
            f"pass {one.name}: at z = {(one.start - one.side * sunk[k]) / MM:.2f} mm the tool goes "
            f"{(after[k] - sunk[k]) / MM:.2f} mm down in one move, so that the clamp is {off[k] / MM:.2f} mm "
            f"off it; allowed is one of its steps, {by / MM:g} mm"
        )
        hint = "take path: helical, or larger steps of the holder (die.step_mm)"
        yield Issue("forming.holder_step", what, field="die.step_mm", index=k, hint=hint)
    left = abs(one.start - one.end) - by * _whole(one, by)
    if left > 0.02 * MM:
        what = (
            f"pass {one.name}: {abs(one.start - one.end) / MM:.2f} mm are no whole number of steps of "
            f"{by / MM:g} mm; at the end the clamp is {left / MM:.2f} mm higher than the part's rim"
        )
        hint = "choose steps of the holder (die.step_mm) that divide the depth"
        yield Issue("forming.holder_step", what, Severity.WARNING, field="die.step_mm", hint=hint)


def holder_actions(work: Work, one: Pass, path: ToolPath, first: int) -> Iterator[Action]:
    """The pulses at the targets of the first pass, whose first one is target ``first``."""
    die = work.operation.die
    if die is None or not holder_sinks(work):
        return
    count = pulses(one, path, work.heads[work.former(one)].radius, holder_step(work))
    for row in np.flatnonzero(count):
        for _ in range(count[row]):
            yield Action(first + int(row), "on", signal=die.signal, powers=False)
            yield Action(first + int(row), "wait", seconds=PULSE_SECONDS)
            yield Action(first + int(row), "off", signal=die.signal, powers=False)
            yield Action(first + int(row), "wait", seconds=PULSE_SECONDS)


def _sunk(one: Pass, path: ToolPath, radius: float) -> FloatArray:
    """How far (N,) [m] below the pass's start the tip has been, up to each target."""
    tip = one.side * (one.start - path.former[:, 2]) + radius
    return np.asarray(np.maximum(np.maximum.accumulate(tip), 0.0))


def _whole(one: Pass, by: float) -> int:
    return int(np.floor(abs(one.start - one.end) / by + 1e-3))
