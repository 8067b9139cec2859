"""The `forming` operation of a problem file, and its die, sheet and clamp as bodies of the cell.

Lengths are in mm, angles in degrees, speeds in mm/s.

**Bodies** that arms keep clear of in two point forming. The die stands behind the sheet, and what
the tool may not do to it follows from two things that are held elsewhere: the die does not stand in
the part's far face (`planner.processes.forming.plan.two_point`), and the tool does not cut into the near
one. So the die needs no shape of its own for the tool's working end; for all other bodies its convex hull
stands for it, which is larger than a female die, on the side away from the tool alone.

Over a male die the clamp sinks with the sheet's rim, from the top of the die to the level that the
sheet's frame stands for. The clamp's bars reach over all places that they pass, and so does the
flat sheet: bodies keep clear of both at every height at once, whenever they are there.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from planner.geometry.arrays import Shape, from_rpy
from planner.geometry.mesh import TriangleMesh
from planner.geometry.mesh_files import read_mesh
from planner.geometry.mesh_queries import outer_hull
from planner.geometry.units import LENGTH_UNITS, MM
from planner.issues import TandemError
from planner.problem import FORMING, Forms, Operation, Part, Stock
from planner.processes.forming.plan.features.tree import LEAST_BUMP, build
from planner.processes.forming.plan.stages import order_of, with_states
from planner.reading.strict_yaml import Angle, Name, Strict, Unit


def die_mesh(die: "Die") -> TriangleMesh:
    """The die's mesh [m] in the sheet's frame. Raises ``TandemError`` for files that cannot be read."""
    return read_mesh(die.file, LENGTH_UNITS[die.unit])


def with_die(die: "Die", side: int, stock: Stock, part: Part | None) -> Stock:
    """The stock with the die behind it and, where the holder sinks, with clamp and sheet drawn out towards
    ``side`` (+1 top) over all heights at which they are. Raises ``TandemError``: issues of the die's file."""
    if stock.sheet is None:
        return stock
    mesh = die_mesh(die)
    hull = outer_hull(mesh.vertices)
    solids = [Shape("mesh", (), np.eye(4), hull.vertices, hull.faces)]
    support = stock.support
    if die.holder == "sinking" and part is not None and part.formed is not None:
        sunk = max(float((side * part.formed.mesh.vertices[:, 2]).max()), 0.0)
        support = tuple(_drawn(shape, side * sunk) for shape in support)
        sheet = Shape(
            "box", tuple(stock.size), from_rpy([0.0, 0.0, 0.5 * float(stock.size[2])], [0.0, 0.0, 0.0])
        )
        solids.append(_drawn(sheet, side * sunk))
    made = dataclasses.replace(stock.sheet, formed=(*stock.sheet.formed, *solids), die=True)
    return dataclasses.replace(stock, sheet=made, support=support)


def _drawn(shape: Shape, along: float) -> Shape:
    """A box whose last side is along z, drawn out by ``along`` [m] along z; others stay as they are."""
    if shape.kind != "box":
        return shape
    x, y, z = shape.size
    pose = shape.pose.copy()
    pose[2, 3] += 0.5 * along
    return dataclasses.replace(shape, size=(x, y, z + abs(along)), pose=pose)


Mode = Literal["spif", "tpif", "dsif", "dpif_l", "dpif_p", "adsif", "heat"]
GAP_MODES = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes in which the sheet is held between both tools, so that their gap is part of the job."""


Height = Annotated[float, Field(ge=-10_000, le=10_000)]
Newton = Annotated[float, Field(ge=0, le=100_000)]


def _from_the_problem_file(value: Path | None, info: ValidationInfo) -> Path | None:
    """A file name, looked up from the folder of the problem file."""
    return None if value is None else (info.context or {}).get("folder", Path()) / value


class Adsif(Strict):
    """Accumulative forming: which solution of the response table is taken, and how much the tools give.

    ``file``: a table of one's own with the columns of the built-in one; its conditions are stated here.
    """

    prefer: Literal["angle", "gap"] = Field(
        default="angle", description="small position angle, or large gap, which needs less force"
    )
    pitch_mm: float = Field(default=0.2, gt=0, le=5)
    projection_mm: float = Field(default=1.6, gt=0, le=50, description="projection distance")
    force_n: float = Field(default=0.0, ge=0, le=100_000)
    stiffness_n_mm: float | None = Field(default=None, gt=0, description="of tool and arm across the gap")
    file: Annotated[Path | None, AfterValidator(_from_the_problem_file)] = None

    @model_validator(mode="after")
    def _stiff(self) -> Self:
        if self.force_n > 0 and self.stiffness_n_mm is None:
            raise ValueError("force_n bends the tools apart only by a stiffness_n_mm; state it")
        return self


class Die(Strict):
    """The fixed die of ``tpif``: a mesh in the sheet's frame, on the side of the sheet away from the tool.

    ``kind``: a female die holds the sheet's rim and has the part's far face in it; its ``holder`` is fixed. A
    male one stands up in the part; its blank holder is sinking, from the die's top to the level of the part's
    rim, by ``step_mm`` (none: the operation's step) whenever ``signal`` is pulsed.
    """

    file: Annotated[Path, AfterValidator(_from_the_problem_file)]
    unit: Unit
    kind: Literal["male", "female"]
    full: bool = Field(default=True, description="the die has the whole part's shape")
    holder: Literal["fixed", "sinking"] = "fixed"
    signal: str = Field(default="doBlankHolder", pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")
    step_mm: float | None = Field(
        default=None, ge=0.02, le=20, description="by which the holder sinks at each pulse"
    )


class PartScan(Strict):
    """Points of a part that was formed before: ``file`` as it was given to `tandem adjust`."""

    file: Annotated[Path, AfterValidator(_from_the_problem_file)]


class Springback(Strict):
    """Both tools go deeper by what the sheet comes back by when they let go.

    ``file``: what `tandem springback --write` has written for this very problem, or `tandem adjust` from the
    ``scan`` of a part that was formed before. What it shifts the tools by changes along the path by no more
    than ``slope`` and is nowhere more than ``most_mm``.
    """

    file: Annotated[Path, AfterValidator(_from_the_problem_file)]
    scan: PartScan | None = None
    slope: float = Field(default=0.05, ge=0.001, le=0.5, description="of the shift along the path, in mm/mm")
    most_mm: float = Field(default=10.0, gt=0, le=12, description="largest shift")


LEVEL_MODES = frozenset({"spif", "dsif", "dpif_l", "heat"})
"""Modes that form level by level, each on its own: where the sheet is one elastic sheet held by its clamp."""


class ForceBy(Strict):
    """Forces on the sheet that change over a part, in place of ``force_n``.

    ``table``: on the former by depth. ``file``: a CSV as it was measured, with the columns of `tandem
    next-loop --forces`: by level, of both tools together, and where it has points with ``x_mm`` and ``y_mm``
    by place.
    """

    table: list[tuple[Height, Newton]] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="rows of z of the contact in the sheet's frame [mm], ascending or descending, and "
        "the force along z [N] there; between rows it goes on evenly",
    )
    file: Annotated[Path | None, AfterValidator(_from_the_problem_file)] = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.table is None) == (self.file is None):
            raise ValueError("state a table by depth, or the file of what was measured: one of them")
        step = np.diff([row[0] for row in self.table or ()])
        if not ((step > 0.0).all() or (step < 0.0).all()):
            row = int(np.flatnonzero(step * step[0] <= 0.0)[0]) + 2
            z = 0.0 if self.table is None else self.table[row - 1][0]
            raise ValueError(f"table: row {row} is at z {z:g} mm; rows have to ascend in z, or to descend")
        if self.table is not None and not any(n > 0.0 for _, n in self.table):
            raise ValueError("table: all forces are 0")
        return self


FORCE_MODES = frozenset({"spif", "dsif", "dpif_l", "dpif_p", "heat"})
"""Modes whose forces may be stated by depth or level: those whose springback is foretold."""
MODES_OF_WHOLE_SHEETS = frozenset({"adsif", "tpif"})
"""Modes that form no sheet that was cut before: tools press all of it, or its rim sinks with a holder."""
SUPPORT_MODES = frozenset({"dsif", "dpif_l"})
"""Modes in which the second tool presses the sheet against the former."""


class Level(Strict):
    """One level of one pass alone, in the sheet as the levels before it have left it.

    ``number`` counts from 0, as the file of curves of `tandem springback --curves` does; ``pass_name``: none
    is the first pass. ``file``: the shifts of this level, which `tandem next-loop --problem` writes beside
    the problem, of the problem with the digest ``plan``; none: tools stay on their path. Shifts change along
    the path by no more than ``slope``, are nowhere more than ``most_mm``, and begin with ``before_mm``, at
    which the level before ends.
    """

    number: int = Field(ge=0, lt=100_000)
    pass_name: Name | None = None
    file: Annotated[Path | None, AfterValidator(_from_the_problem_file)] = None
    plan: str | None = Field(
        default=None, pattern="^[0-9a-f]{64}$", description="digest of the problem that the file is of"
    )
    slope: float = Field(default=0.05, ge=0.001, le=0.5, description="of the shift along the path, in mm/mm")
    most_mm: float = Field(default=10.0, gt=0, le=12, description="largest shift")
    before_mm: float = Field(default=0.0, ge=0, le=12, description="shift at which the level before ends")


class Forming(Strict):
    """Incremental forming of the clamped sheet by the tools of one or two arms.

    The first arm's tool works on the sheet's top side (+z of its frame), the second one's below; one arm
    alone works on ``side``. A feature that goes down is formed by the tool above, one that goes up by the one
    below.
    """

    name: Name
    process: Literal["forming"]
    arms: tuple[str, ...] = Field(min_length=1, max_length=2)
    mode: Mode
    side: Literal["top", "bottom"] = Field(default="top", description="of the tool of one arm alone")
    path: Literal["helical", "contour", "alternating", "stepped"] = "helical"
    stepdown_mm: float | None = Field(default=None, ge=0.02, le=20)
    scallop_mm: float | None = Field(
        default=None, ge=0.0005, le=2, description="height of the ridges between loops; sets the steps"
    )
    tangent_deg: float = Field(
        default=4.0, ge=0.2, le=30, description="a target where the path has turned by so much"
    )
    chord_mm: float = Field(
        default=0.05, ge=0.002, le=1, description="how far straight moves may be off the path"
    )
    longest_mm: float = Field(
        default=20.0, ge=0.2, le=200, description="longest move; two controllers drift apart by no more"
    )
    seam_deg: Angle = Field(default=0.0, description="where loops begin, about the feature's middle")
    direction: Literal["ccw", "cw"] = "ccw"
    feature_step_mm: float = Field(
        default=0.5, ge=0.02, le=10, description="distance of the slices that find the features"
    )
    strategy: Literal["in_place", "virgin"] = Field(
        default="in_place", description="parents first, in place; or inner features first, on the flat sheet"
    )
    features: tuple[int, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=10_000,
        description="numbers of those that this operation forms, as `tandem features` prints them; "
        "others are formed by other operations. None: all",
    )
    hole_margin_mm: float = Field(
        default=5.0,
        ge=0.5,
        le=200,
        description="least distance, seen along z, of what is formed and of the tools from curves along "
        "which the sheet was cut before",
    )
    order: tuple[int, ...] | None = Field(default=None, description="features in an order of one's own")
    squeeze: float = Field(default=1.0, ge=0.5, le=1.2, description="gap over the thickness by the sine law")
    shift_deg: float = Field(
        default=0.0, ge=0, le=90, description="of the support around the former, up to the wall angle"
    )
    angle_step_deg: float = Field(
        default=15.0, ge=1, le=45, description="between intermediate shapes of steep walls"
    )
    passes: Literal["auto"] | tuple[float, ...] = Field(
        default="auto", description="wall angles [deg] of the passes; auto: as the metal needs"
    )
    repeats: int = Field(default=1, ge=1, le=10, description="times that each pass is run")
    feed_mm_s: float = Field(default=25.0, ge=0.5, le=500, description="of both tools' TCPs on the sheet")
    lean_deg: float = Field(
        default=0.0, ge=0, le=60, description="of the tools from the sheet's normal toward the surface's"
    )
    cone_deg: float = Field(
        default=0.0, ge=0, le=45, description="how far motion may tilt the tools from there"
    )
    force_n: float | None = Field(
        default=None, gt=0, le=100_000, description="on the former; none: by a formula"
    )
    force_by: ForceBy | None = None
    support_force_n: float | None = Field(
        default=None,
        ge=0,
        le=100_000,
        description="along z, by which the support presses the sheet against the former; what is left "
        "of the former's force bends the sheet",
    )
    gouge_tol_mm: float = Field(default=0.05, ge=0.002, le=1)
    gap_tol_mm: float = Field(default=0.02, ge=0.002, le=1)
    handshake_gap_mm: float = Field(
        default=0.5, ge=0, le=10, description="how far the gap may be off with two controllers a step apart"
    )
    share: float = Field(
        default=0.95, gt=0.5, le=1, description="part of the walls that must be formed within tolerance"
    )
    unreached_mm: float | None = Field(
        default=None,
        ge=0.02,
        le=100,
        description="how far balls may stay off the part where they do not fit; none: told",
    )
    adsif: Adsif = Adsif()
    die: Die | None = None
    springback: Springback | None = None
    level: Level | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: each arm is named once")
        alone = self.mode in ("spif", "tpif")
        if alone != (len(self.arms) == 1):
            need = "one arm" if alone else "two arms, the first above the sheet and the second below"
            raise ValueError(f"mode {self.mode} needs {need}")
        if (self.die is not None) != (self.mode == "tpif"):
            raise ValueError("a die belongs to mode tpif, and tpif needs one")
        sinking = self.die is not None and self.die.holder == "sinking"
        if self.die is not None and sinking and self.die.step_mm is None and self.stepdown_mm is None:
            raise ValueError("die: the holder's step_mm is needed where scallop_mm sets the tool's steps")
        if (self.stepdown_mm is None) == (self.scallop_mm is None):
            raise ValueError("give either stepdown_mm or scallop_mm, one of them")
        if self.shift_deg > 0.0 and self.mode != "dpif_l":
            raise ValueError(f"shift_deg belongs to mode dpif_l; mode {self.mode} has no shift")
        if isinstance(self.passes, tuple) and (
            not self.passes or list(self.passes) != sorted(set(self.passes)) or not 0 < self.passes[0] <= 90
        ):
            raise ValueError("passes: wall angles must ascend, each above 0 and at most 90")
        self._stated_forces()
        self._one_level()
        self._some_features()
        return self

    def _some_features(self) -> None:
        if self.features is None:
            return
        if len(set(self.features)) != len(self.features) or min(self.features) < 1:
            raise ValueError("features: each number from 1 on is named once")
        if self.mode not in FORCE_MODES:
            allowed = ", ".join(sorted(FORCE_MODES))
            raise ValueError(f"features belongs to the modes {allowed}, not {self.mode}")
        if self.level is not None or self.springback is not None:
            raise ValueError(
                "features: neither level nor springback is known of a sheet that is formed in stages; take "
                "them out"
            )

    def _stated_forces(self) -> None:
        """What forces by depth or level, and that of a support, ask of their operation."""
        by, support = self.force_by, self.support_force_n
        if by is not None:
            if self.force_n is not None:
                raise ValueError("give either force_n or force_by, one of them")
            if self.mode not in FORCE_MODES:
                allowed = ", ".join(sorted(FORCE_MODES))
                raise ValueError(f"force_by belongs to the modes {allowed}, not {self.mode}")
            if by.file is not None and self.stepdown_mm is None:
                raise ValueError(
                    "force_by: levels are counted by stepdown_mm; state it in place of scallop_mm"
                )
        if support is None:
            return
        if self.mode not in SUPPORT_MODES:
            allowed = " and ".join(sorted(SUPPORT_MODES))
            what = f"support_force_n belongs to the modes {allowed}; in {self.mode} no second tool presses "
            raise ValueError(what + "the sheet against the former")
        if by is not None and by.file is not None:
            raise ValueError("support_force_n: the forces of force_by's file are of both tools together")
        if self.force_n is None and by is None:
            what = "support_force_n: it is taken off the former's force; state that, force_n or a table of "
            raise ValueError(what + "force_by: the formula has no support")
        former = [n for _, n in by.table or ()] if by is not None else [self.force_n or 0.0]
        if min(former) < support or max(former) <= support:
            what = f"support_force_n: {support:g} N is more than the former's {min(former):g} N leave: "
            raise ValueError(what + "together they have to press the former's way")

    def _one_level(self) -> None:
        if self.level is None:
            return
        if self.mode not in LEVEL_MODES:
            raise ValueError(f"level belongs to the modes {', '.join(sorted(LEVEL_MODES))}, not {self.mode}")
        if self.stepdown_mm is None:
            raise ValueError("level: levels are counted by stepdown_mm; state it in place of scallop_mm")
        if self.springback is not None:
            raise ValueError("level: has a file of its own; take springback out")
        if (self.level.file is None) != (self.level.plan is None):
            raise ValueError("level: give file and plan, or neither")
        if self.level.before_mm > self.level.most_mm:
            raise ValueError("level: before_mm is above most_mm")
        if self.level.file is None and self.level.before_mm > 0.0:
            raise ValueError("level: before_mm is where the shifts of a file begin; give that too")
        if self.level.number == 0 and self.level.before_mm > 0.0:
            raise ValueError("level: before_mm is 0 for level 0: none is before it")

    def leaves(self, stock: Stock) -> Stock:
        """The sheet as it stays clamped: what stands out of it is part of its solids from the beginning."""
        return stock

    def with_fixtures(self, stock: Stock, part: Part | None, before: Sequence[Operation]) -> Stock:
        """The sheet with the die behind it, all over the heights at which a clamp that sinks has it, and
        with all that stands out of it before the part is finished."""
        if self.die is not None:
            stock = with_die(self.die, 1 if self.side == "top" else -1, stock, part)
        if self.strategy != "virgin" or part is None or part.formed is None:
            return stock
        done = [
            k for op in before if isinstance(op, Forms) and op.process == FORMING for k in op.features or ()
        ]
        mesh, noise = part.formed.mesh, max(LEAST_BUMP, part.formed.tolerance)
        try:
            tree = build(mesh, self.feature_step_mm * MM, noise)
            order = order_of(tree, True, self.order, self.features, done)
        except TandemError:
            return stock  # the job itself says what is wrong
        return with_states(stock, mesh, tree, order, [k for k in done if k <= len(tree.features)])
