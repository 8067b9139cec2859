"""What a forming operation comes to: features, order, passes, who forms, and both tools' way.

`work` says features, their order, passes and who forms, before any path is laid; `lay_all` lays the
paths of both tools over each pass, whatever the mode; `lay_out` is the whole way of both tools:
over the sheet to each pass, down onto it, along it, and off again.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from planner.claims.segments import Segment
from planner.geometry.arrays import BoolArray, FloatArray, IntArray, Mesh, dots
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import Part, Setup, Sheet
from planner.processes.forming.plan.contact import ContactPath, Pass, ToolPath
from planner.processes.forming.plan.features import tree as feature_tree
from planner.processes.forming.plan.features.tree import FeatureTree, OrderStep
from planner.processes.forming.plan.operation import GAP_MODES, Forming
from planner.processes.forming.plan.passes import passes
from planner.processes.forming.plan.paths.adsif_path import adsif_tool_path, pressed_by_support
from planner.processes.forming.plan.paths.contact_path import make_path
from planner.processes.forming.plan.paths.spiral import MISSED_DISTANCE, PathOptions
from planner.processes.forming.plan.sheet_mechanics import steepest
from planner.processes.forming.plan.stages import formed_sheet, order_of, own_features
from planner.processes.forming.plan.stated_force import Stated, stated
from planner.processes.forming.plan.support.clearance import Clamp, clamp_of
from planner.processes.forming.plan.support.modes import tool_path
from planner.tooling import FormingHead, FormingTool

JOINED_SHARE: Final = 0.4
"""Share of what tools may cut in that straight moves between two places of the path may take: moves that are
joined take as much again (`planner.processes.forming.plan.job.ROUNDED_SHARE`), and the proof does not know
the way between its samples."""
FEATURES_NAMED: Final = 5
"""Features that a message names at most."""


@dataclasses.dataclass(frozen=True)
class Work:
    """An operation on its sheet: ``mesh`` is the part's lower face in the sheet's frame, ``heads`` the tools'
    working ends by arm, ``passes`` in the order of forming, ``clamp`` what holds the sheet, ``tolerance`` [m]
    how far the part's mesh may be off the face that is meant. ``every``: how many moves the controllers of
    two arms go between meetings; 0 where they go by one clock. ``before``: the features that other operations
    have formed. ``between``: targets are added until what lies between them holds, too."""

    operation: Forming
    sheet: Sheet
    thickness: float
    mesh: Mesh
    tree: FeatureTree
    order: tuple[OrderStep, ...]
    passes: tuple[Pass, ...]
    heads: dict[str, FormingHead]
    clamp: Clamp
    tolerance: float = 0.0
    every: int = 0
    before: tuple[int, ...] = ()
    between: bool = True

    @functools.cached_property
    def left(self) -> Mesh:
        """The lower face of the sheet as the operation leaves it."""
        own = {step.feature for step in self.order}
        return formed_sheet(self.mesh, self.tree, sorted(own.union(self.before)))

    @property
    def flat(self) -> bool:
        """Whether the sheet is flat and whole when the operation begins."""
        return not self.before and not self.sheet.holes

    @property
    def staged(self) -> bool:
        """Whether other operations form or cut the sheet before it, or form it further."""
        return not self.flat or len(self.order) < len(self.tree.features)

    def former(self, one: Pass) -> str:
        """The arm that forms a pass."""
        arms = self.operation.arms
        return arms[0] if len(arms) == 1 or one.side > 0 else arms[1]

    def supporter(self, one: Pass) -> str | None:
        """The arm on the other side of the sheet, or None where one works alone."""
        arms = self.operation.arms
        return None if len(arms) == 1 else arms[1] if one.side > 0 else arms[0]

    def above(self, arm: str) -> bool:
        """Whether an arm's tool is on the top side of the sheet."""
        if len(self.operation.arms) == 1:
            return self.operation.side == "top"
        return arm == self.operation.arms[0]

    @functools.cached_property
    def stated(self) -> Stated | None:
        """Forces on the sheet that the user states; None: by the formula. Raises ``TandemError``:
        forming.force_input, forming.loop_forces."""
        radius = {one.name: self.heads[self.former(one)].radius for one in self.passes}
        return stated(self.operation, self.passes, self.sheet.metal, self.thickness, radius)

    @property
    def pressed(self) -> tuple[float, float]:
        """How far [m] the forming and the other tool may press into what is formed already or flat, the
        stated tolerance included: in adsif the flat sheet around them by the projection distance, and as far
        as the response table has the other one, else by what they squeeze."""
        op = self.operation
        allowed = op.gouge_tol_mm * MM
        if op.mode == "adsif":
            depth = op.adsif.projection_mm * MM
            radii = 2.0 * next(iter(self.heads.values())).radius
            return allowed + depth, allowed + max(depth, pressed_by_support(op, radii, self.thickness))
        if op.mode in ("dsif", "dpif_l"):
            allowed += max(1.0 - op.squeeze, 0.0) * self.thickness
        return allowed, allowed

    @property
    def options(self) -> PathOptions:
        """How paths are laid."""
        op = self.operation
        return PathOptions(
            kind=op.path,
            stepdown=None if op.stepdown_mm is None else op.stepdown_mm * MM,
            scallop=None if op.scallop_mm is None else op.scallop_mm * MM,
            tangent_angle=op.tangent_deg * DEG,
            chord=op.chord_mm * MM,
            cut=JOINED_SHARE * op.gouge_tol_mm * MM if self.between else np.inf,
            start_angle=op.seam_deg * DEG,
            direction=op.direction,
            longest=op.longest_mm * MM,
            missed=max(MISSED_DISTANCE, self.tolerance) if op.unreached_mm is None else np.inf,
            seams=op.level is not None,
        )


def segment(one: Pass) -> Segment:
    """The segment in which a pass is formed."""
    return Segment("form", one.name)


def work(operation: Forming, setup: Setup, part: Part | None) -> Work:
    """The job of an operation. Raises ``TandemError`` with the codes ``forming.*``."""
    sheet, mesh = setup.stock.sheet, None if part is None or part.formed is None else part.formed.mesh
    if sheet is None or mesh is None:
        what = f"{operation.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise refusal("forming.no_sheet", what, field="sheet")
    heads = _heads(operation, setup)
    tolerance = part.formed.tolerance if part is not None and part.formed is not None else 0.0
    tree = feature_tree.build(mesh, operation.feature_step_mm * MM, max(feature_tree.LEAST_BUMP, tolerance))
    before, own = own_features(operation.name, operation.features, sheet.stages, tree)
    some = None if operation.features is None else own
    order = order_of(tree, operation.strategy == "virgin", operation.order, some, before)
    thickness = float(setup.stock.size[2])
    made = passes(tree, order, mesh, thickness, operation, sheet.metal)
    _require_sides(operation, made)
    controller = setup.cell.controller
    every = controller.handshake.every if controller.sync == "handshake" else 0
    clamp = clamp_of(setup.stock)
    found = Work(operation, sheet, thickness, mesh, tree, order, made, heads, clamp, tolerance, every, before)
    _ = found.stated  # what is wrong with it is said before anything is laid
    return found


def _heads(op: Forming, setup: Setup) -> dict[str, FormingHead]:
    out: dict[str, FormingHead] = {}
    issues = []
    for place, arm in enumerate(op.arms):
        tool = setup.cell.arm(arm).tool
        wanted = "heat_tool" if op.mode == "heat" and place == 1 else "ball_tool"
        may = {"heat"} if wanted == "heat_tool" else {"ball"}
        if op.mode == "dpif_p" and place == 1:
            may.add("disk")
        if not isinstance(tool, FormingTool) or tool.head.kind not in may:
            other = " or a disk_tool" if op.mode == "dpif_p" and place == 1 else ""
            what = f"{op.name}: arm {arm} carries the tool {tool.name}; mode {op.mode} wants {wanted}{other}"
            issues.append(Issue("forming.tool", what, field="cell.arms.tool", arm=arm))
        else:
            out[arm] = tool.head
    if issues:
        raise TandemError(issues)
    return out


def _require_sides(op: Forming, made: tuple[Pass, ...]) -> None:
    balls = {"top"} if len(op.arms) == 2 and op.mode == "heat" else {"top", "bottom"}
    balls = {op.side} if len(op.arms) == 1 else balls
    wrong = [one for one in made if ("top" if one.side > 0 else "bottom") not in balls]
    if wrong:
        one = len({one.feature for one in wrong}) == 1
        way = f"down and need{'s' * one} a tool above"
        if wrong[0].side < 0:
            way = f"up and need{'s' * one} a tool below"
        names = _named(sorted({one.feature for one in wrong}))
        remedy = (
            "turn the part or the sheet over, or take two arms in mode dsif, whose tools swap their roles"
        )
        what = f"{op.name}: {names} {way} the sheet, where no ball works; {remedy}"
        raise refusal("forming.side", what, field="operations.mode")


def _named(features: list[int]) -> str:
    """Features as a message names them, the first few of many."""
    if len(features) == 1:
        return f"feature {features[0]} goes"
    shown = ", ".join(str(number) for number in features[:FEATURES_NAMED])
    return f"{len(features)} features ({shown}{', ...' if len(features) > FEATURES_NAMED else ''}) go"


TOO_NARROW: Final = "forming.tool_radius"
"""Code of a fillet or groove that is too narrow for the ball."""
LEAST_MOVE_TIME: Final = 0.006
"""Moves take so long [s] at least at the stated feed; controllers plan none that are much shorter."""
WAY_TOLERANCE: Final = 0.01 * MM
"""How far [m] tools may be off their way, where fillets are that the ball just fits, times how steeply the
sheet's thickness changes with the wall's angle."""
FLOOR_GAP: Final = 0.06 * MM
"""How far [m] the ball may stay off the floor for that."""
TOP_WIDTH: Final = 5.0 * MM
"""Loops about the top of a male die that are no wider than this [m] may be left out."""


FEW_LOOPS: Final = 12
"""Loops that a first look is made of, over all passes;"""
LOOPS_OF_PASS: Final = (2, 6)
"""of each pass so many at least, and at most;"""
FEWER_PLACES: Final = 4.0
"""it has so many times fewer places on each."""


def fewer(work: Work) -> Work:
    """The same work with fewer loops and places, all of which the true way has alike, whatever lies between
    them; itself where that is of no use: few loops, or a way whose turns hang on one another."""
    op = work.operation
    if op.mode == "adsif":
        return work
    # the sagitta of a chord goes with the square of its length
    more: dict[str, Any] = {"chord_mm": op.chord_mm * FEWER_PLACES**2}
    more |= {"tangent_deg": op.tangent_deg * FEWER_PLACES, "longest_mm": op.longest_mm * FEWER_PLACES}
    if op.stepdown_mm is not None:
        deep = max(abs(one.end - one.start) for one in work.passes) / MM
        loops = np.clip(FEW_LOOPS // len(work.passes), *LOOPS_OF_PASS)
        more["stepdown_mm"] = max(op.stepdown_mm, deep / float(loops))
    return dataclasses.replace(work, operation=op.model_copy(update=more), between=False, every=0)


def lay_all(work: Work) -> list[tuple[Pass, ToolPath]]:
    """Where the tools are over all passes. Raises ``TandemError`` with the codes ``forming.*``: of balls that
    are too large for several passes the one that has to be the smallest first."""
    out: list[tuple[Pass, ToolPath]] = []
    narrow: list[Issue] = []
    for one in work.passes:
        try:
            out.append((one, lay(work, one)))
        except TandemError as error:
            if any(issue.code != TOO_NARROW for issue in error.issues):
                raise
            narrow += error.issues
    if narrow:
        raise TandemError(sorted(narrow, key=lambda issue: issue.limit or 0.0))
    return out


def lay(work: Work, one: Pass, part: Callable[[ContactPath], ContactPath] | None = None) -> ToolPath:
    """Where the tools are over a pass, or over the ``part`` of its contact's path that is kept. Raises
    ``TandemError`` with the codes ``forming.*``."""
    op, other = work.operation, work.supporter(one)
    former = work.heads[work.former(one)]
    if op.mode == "adsif" and other is not None:
        return adsif_tool_path(one, op, former, work.heads[other], work.thickness, work.sheet.metal)
    options = work.options
    if work.between and (op.mode in GAP_MODES or op.mode == "heat"):
        options = dataclasses.replace(options, spare=_spare(work, one))
    contact = make_path(one, former.radius, options)
    if work.tree.feature(one.feature).sign == one.side:
        contact = _off_the_top(contact, LEAST_MOVE_TIME * op.feed_mm_s * MM)
    contact = contact if part is None else part(contact)
    support = None if other is None else work.heads[other]
    return tool_path(one, contact, op, former, support, work.thickness, work.clamp, work.every, work.between)


def _spare(work: Work, one: Pass) -> float:
    """How much larger [m] than the ball fillets have to be so that it goes through them: beside the wall, in
    one that is hardly larger, it touches the floor for the wall: the gap of the tools is another, and the
    place to be heated is elsewhere."""
    wanted = WAY_TOLERANCE * work.operation.squeeze * work.thickness / (work.operation.gap_tol_mm * MM)
    return min(wanted, FLOOR_GAP / max(1.0 - float(np.cos(steepest(one.vertices, one.faces))), 1e-3))


def _off_the_top(path: ContactPath, shortest: float) -> ContactPath:
    """A path over a male die without its beginning, where loops about the die's top, on which the sheet lies
    flat already, have moves of less than ``shortest`` [m]."""
    away = np.linalg.norm(path.centre - path.centre[0], axis=1)
    short = np.linalg.norm(np.diff(path.centre, axis=0), axis=1) < shortest
    rows = np.flatnonzero(short & (np.maximum.accumulate(away)[1:] <= TOP_WIDTH))
    if not len(rows):
        return path
    first = int(rows[-1]) + 1
    kept = {field.name: getattr(path, field.name)[first:].copy() for field in dataclasses.fields(path)}
    kept["loop"] -= kept["loop"][0]
    kept["working"][0] = False
    return ContactPath(**kept)


AIR_CLEARANCE: Final = 0.005
"""How much farther than the clearance tools stay off the sheet between passes [m]."""
SHARP_TURN: Final = 15.0 * DEG
"""Tools stop where their way turns by more than this [rad], and more than smooth ways do from target to
target: a corner that is rounded at full feed costs two tools some of their gap."""
LEAST_MOVE: Final = 1e-6
"""Moves that are shorter than this [m] have no direction."""
DRAWN_BACK_DISTANCE: Final = 0.06
"""How far tools are drawn back before and after the job [m], so that arms come to them in free space."""


@dataclasses.dataclass(frozen=True)
class Route:
    """N targets: ``centre``, ``axis`` {arm: (N, 3)}, ``segment`` and ``stop`` (N,)."""

    centre: dict[str, FloatArray]
    axis: dict[str, FloatArray]
    segment: tuple[Segment, ...]
    stop: BoolArray


def lay_out(work: Work, paths: Sequence[tuple[Pass, ToolPath]], clearance: float, most: int) -> Route:
    """The route through all passes. Between passes tools go over the highest place of the part, ``clearance``
    [m] and a little more away. They stop at sharp corners, and at least every ``most`` targets of a pass, at
    the end of a loop, so that programs can be split there."""
    arms = work.operation.arms
    away = {arm: _away(work, arm, clearance) for arm in arms}
    centre: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    axis: dict[str, list[FloatArray]] = {arm: [] for arm in arms}
    segments: list[Segment] = []
    stops: list[BoolArray] = []
    sharp = max(SHARP_TURN, 1.1 * work.operation.tangent_deg * DEG)
    for number, (one, path) in enumerate(paths):
        own = _by_arm(work, one, path)
        count, formed = len(path.former), segment(one)
        first, last = number == 0, number == len(paths) - 1
        for arm in arms:
            points, axes = own[arm]
            rise = np.array([0.0, 0.0, 1.0 if work.above(arm) else -1.0])
            start, end = (np.where([0, 0, 1], away[arm], points[k]) for k in (0, -1))
            row = (
                [start, start, *points, end]
                if not first
                else [start + DRAWN_BACK_DISTANCE * rise, start, *points, end]
            )
            row = row[0 if first else 1 :]
            turns = [axes[:1]] * (2 if first else 1) + [axes, axes[-1:]]
            if last:
                row.append(end + DRAWN_BACK_DISTANCE * rise)
                turns.append(axes[-1:])
            centre[arm].append(np.array(row))
            axis[arm].append(np.concatenate(turns))
        segments += [Segment("approach"), Segment("approach")] if first else [Segment("link")]
        segments += [formed.at("in"), *[formed] * (count - 1), formed.at("out")]
        segments += [Segment("retreat")] if last else []
        head, tail = (2 if first else 1), (2 if last else 1)
        within = _loop_ends(path.contact.loop, most)
        for points, _ in own.values():
            within |= _corners(points, sharp)
        within[[0, -1]] = True
        stops.append(np.concatenate([np.ones(head, bool), within, np.ones(tail, bool)]))
    return Route(
        {arm: np.concatenate(centre[arm]) for arm in arms},
        {arm: np.concatenate(axis[arm]) for arm in arms},
        tuple(segments),
        np.concatenate(stops),
    )


def _by_arm(work: Work, one: Pass, path: ToolPath) -> dict[str, tuple[FloatArray, FloatArray]]:
    out = {work.former(one): (path.former, path.axis)}
    other = work.supporter(one)
    if other is not None and path.support is not None and path.support_axis is not None:
        out[other] = (path.support, path.support_axis)
    return out


def _away(work: Work, arm: str, clearance: float) -> float:
    """Height z [m] at which a tool's TCP is off everything of the sheet, whatever is formed already."""
    head = work.heads[arm]
    found = formed_sheet(work.mesh, work.tree, work.before).vertices[:, 2]
    heights = np.concatenate([work.mesh.vertices[:, 2], found])
    shifts = [one.vertices[:, 2] for one in work.passes]
    low = min(float(heights.min()), *(float(z.min()) for z in shifts))
    high = max(float(heights.max()), *(float(z.max()) for z in shifts)) + work.thickness
    reach = head.radius if head.kind == "ball" else 0.0
    gap = clearance + AIR_CLEARANCE + reach
    return high + gap if work.above(arm) else low - gap


def _corners(points: FloatArray, angle: float) -> BoolArray:
    """(N,) where the way through ``points`` (N, 3) turns by more than ``angle`` [rad]."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    long = np.flatnonzero(length > LEAST_MOVE)
    out = np.zeros(len(points), dtype=bool)
    if len(long) > 1:
        way = step[long] / length[long, None]
        sharp = dots(way[1:], way[:-1]) < np.cos(angle)
        out[long[1:][sharp]] = True
    return out


def _loop_ends(loop: IntArray, most: int) -> BoolArray:
    """(N,) where to stop: at the last possible end of a loop before ``most`` targets have gone by."""
    ends = np.flatnonzero(np.diff(loop) != 0)
    out = np.zeros(len(loop), dtype=bool)
    last = 0
    while len(loop) - 1 - last > most:
        near = ends[(ends > last) & (ends <= last + most)]
        last = int(near[-1]) if len(near) else last + most
        out[last] = True
    return out
