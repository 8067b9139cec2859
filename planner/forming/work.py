"""What a forming operation comes to before any path is laid: features, their order, passes, and who forms."""

from __future__ import annotations

import dataclasses
from typing import Final

from planner.forming import feature_order, feature_tree
from planner.forming.adsif_table import pressed
from planner.forming.clamp import Clamp, clamp_of
from planner.forming.feature_order import OrderStep
from planner.forming.feature_tree import FeatureTree
from planner.forming.operation import Forming
from planner.forming.passes import passes
from planner.forming.path_options import MISSED, PathOptions
from planner.forming.values import Pass
from planner.issues import Issue, TandemError
from planner.problem import Mesh, Part, Setup, Sheet
from planner.segments import Segment
from planner.tooling import FormingHead, FormingTool
from planner.units import DEG, MM

NAMED: Final = 5
"""Features that a message names at most."""


CUT_SHARE: Final = 0.5
"""Share of the stated tolerance that straight moves may cut into the face: short ones that are joined and
the mesh's own facets cut, too."""


@dataclasses.dataclass(frozen=True)
class Work:
    """An operation on its sheet: ``mesh`` is the part's lower face in the sheet's frame, ``heads`` the tools'
    working ends by arm, ``passes`` in the order of forming, ``clamp`` what holds the sheet, ``tolerance`` [m]
    how far the part's mesh may be off the face that is meant. ``every``: how many moves the controllers of
    two arms go between meetings; 0 where they go by one clock."""

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

    @property
    def pressed(self) -> float:
        """How far [m] tools may press into what is formed already or flat, besides the stated tolerance: in
        adsif they press the flat sheet around them, else by what they squeeze."""
        op = self.operation
        depth = pressed(op)
        if op.mode in ("dsif", "dpif_l"):
            depth = max(1.0 - op.squeeze, 0.0) * self.thickness
        return op.gouge_tol_mm * MM + depth

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
            cut=CUT_SHARE * op.gouge_tol_mm * MM,
            start_angle=op.seam_deg * DEG,
            direction=op.direction,
            longest=op.longest_mm * MM,
            missed=max(MISSED, self.tolerance),
        )


def segment(one: Pass) -> Segment:
    """The segment in which a pass is formed."""
    return Segment("form", one.name)


def work(operation: Forming, setup: Setup, part: Part | None) -> Work:
    """The job of an operation. Raises ``TandemError`` with the codes ``forming.*``."""
    sheet, mesh = setup.stock.sheet, None if part is None or part.formed is None else part.formed.mesh
    if sheet is None or mesh is None:
        what = f"{operation.name}: there is no sheet to form; give sheet: and a part of kind sheet_mesh"
        raise TandemError(Issue("forming.no_sheet", what, field="sheet"))
    heads = _heads(operation, setup)
    tolerance = part.formed.tolerance if part is not None and part.formed is not None else 0.0
    tree = feature_tree.build(mesh, operation.feature_step_mm * MM, max(feature_tree.NOISE, tolerance))
    order = _order(operation, tree)
    thickness = float(setup.stock.size[2])
    made = passes(tree, order, mesh, thickness, operation, sheet.metal)
    _require_sides(operation, made)
    controller = setup.cell.controller
    every = controller.handshake.every if controller.sync == "handshake" else 0
    clamp = clamp_of(setup.stock)
    return Work(operation, sheet, thickness, mesh, tree, order, made, heads, clamp, tolerance, every)


def _order(op: Forming, tree: FeatureTree) -> tuple[OrderStep, ...]:
    if op.order is not None:
        return feature_order.given(tree, op.order, translated=op.strategy == "virgin")
    return feature_order.on_virgin_sheet(tree) if op.strategy == "virgin" else feature_order.in_place(tree)


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
    """Every pass needs a ball on its side of the sheet."""
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
        raise TandemError(Issue("forming.side", what, field="operations.mode"))


def _named(features: list[int]) -> str:
    """Features as a message names them, the first few of many."""
    if len(features) == 1:
        return f"feature {features[0]} goes"
    shown = ", ".join(str(number) for number in features[:NAMED])
    return f"{len(features)} features ({shown}{', ...' if len(features) > NAMED else ''}) go"
