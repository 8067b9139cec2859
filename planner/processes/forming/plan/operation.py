"""The `forming` operation of a problem file, and its die, sheet and clamp as bodies of the cell.

Lengths are in mm, angles in degrees, speeds in mm/s.

**Bodies** that arms must not touch in two point forming. The die is on the far side of the sheet. Two other
checks ensure that the tool does not damage it: the die does not protrude into the part's far face
(`planner.processes.forming.plan.two_point`), and the tool does not cut into the near one. So the tool's
working end needs no collision shape of the die. For all other bodies the die is represented by its convex
hull, which is larger than a female die only on the side away from the tool.

Over a male die the clamp sinks with the sheet's rim, from the top of the die to the level of the sheet's
frame. The clamp's bars cover all positions that they pass, and so does the flat sheet: bodies keep clear of
both at every height, at any time.
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
from planner.problem import FORMING, FormingOperation, Operation, Part, Stock
from planner.processes.forming.plan.features.tree import MIN_BUMP_HEIGHT_M, build_feature_tree
from planner.processes.forming.plan.stages import forming_order, with_states
from planner.reading.strict_yaml import Angle, Name, Strict, Unit


def die_mesh(die: "Die") -> TriangleMesh:
    """Return the die's mesh [m] in the sheet's frame.

    Raises:
        TandemError: for files that cannot be read.
    """
    return read_mesh(die.file, LENGTH_UNITS[die.unit])


def with_die(die: "Die", side: int, stock: Stock, part: Part | None) -> Stock:
    """Return the stock with the die behind it.

    If the holder sinks, clamp and sheet are extruded over all heights at which they can be.

    Args:
        die: Die of the operation.
        side: +1 if the tool is above the sheet, -1 if below.
        stock: Stock.
        part: Part to form.

    Raises:
        TandemError: issues of the die's file.
    """
    if stock.sheet is None:
        return stock
    mesh = die_mesh(die)
    hull = outer_hull(mesh.vertices)
    solids = [Shape("mesh", (), np.eye(4), hull.vertices, hull.faces)]
    support = stock.support
    if die.holder == "sinking" and part is not None and part.formed is not None:
        sink_depth = max(float((side * part.formed.mesh.vertices[:, 2]).max()), 0.0)
        support = tuple(_extruded(shape, side * sink_depth) for shape in support)
        sheet = Shape(
            "box", tuple(stock.size), from_rpy([0.0, 0.0, 0.5 * float(stock.size[2])], [0.0, 0.0, 0.0])
        )
        solids.append(_extruded(sheet, side * sink_depth))
    sheet_with_die = dataclasses.replace(stock.sheet, formed=(*stock.sheet.formed, *solids), die=True)
    return dataclasses.replace(stock, sheet=sheet_with_die, support=support)


def _extruded(shape: Shape, height: float) -> Shape:
    """Return a box, whose last side is along z, extruded by ``height`` [m] in z; other shapes unchanged."""
    if shape.kind != "box":
        return shape
    x, y, z = shape.size
    pose = shape.pose.copy()
    pose[2, 3] += 0.5 * height
    return dataclasses.replace(shape, size=(x, y, z + abs(height)), pose=pose)


Mode = Literal["spif", "tpif", "dsif", "dpif_l", "dpif_p", "adsif", "heat"]
GAP_MODES = frozenset({"dsif", "dpif_l", "adsif"})
"""Modes in which the sheet is held between both tools, so that their gap is part of the job."""


Height = Annotated[float, Field(ge=-10_000, le=10_000)]
Newton = Annotated[float, Field(ge=0, le=100_000)]


def _relative_to_problem_file(value: Path | None, info: ValidationInfo) -> Path | None:
    """Return a file name that is relative to the folder of the problem file as a path."""
    return None if value is None else (info.context or {}).get("folder", Path()) / value


class Adsif(Strict):
    """Accumulative forming: selects a solution of the response table, and states the compliance of the tools.

    ``file``: a custom table with the columns of the built-in one. Its conditions are stated in the file.
    """

    prefer: Literal["angle", "gap"] = Field(
        default="angle", description="small position angle, or large gap with less force"
    )
    pitch_mm: float = Field(default=0.2, gt=0, le=5)
    projection_mm: float = Field(default=1.6, gt=0, le=50, description="projection distance")
    force_n: float = Field(default=0.0, ge=0, le=100_000)
    stiffness_n_mm: float | None = Field(default=None, gt=0, description="of tool and arm across the gap")
    file: Annotated[Path | None, AfterValidator(_relative_to_problem_file)] = None

    @model_validator(mode="after")
    def _stiff(self) -> Self:
        if self.force_n > 0 and self.stiffness_n_mm is None:
            raise ValueError("force_n needs a stiffness_n_mm; state it")
        return self


class Die(Strict):
    """The fixed die of ``tpif``: a mesh in the sheet's frame, on the side of the sheet away from the tool.

    ``kind``: a female die holds the sheet's rim and contains the part's far face; its ``holder`` is fixed. A
    male die stands up in the part; its blank holder is sinking, from the die's top to the level of the part's
    rim, by ``step_mm`` (none: the operation's step) whenever ``signal`` is pulsed.
    """

    file: Annotated[Path, AfterValidator(_relative_to_problem_file)]
    unit: Unit
    kind: Literal["male", "female"]
    full: bool = Field(default=True, description="the die has the whole part's shape")
    holder: Literal["fixed", "sinking"] = "fixed"
    signal: str = Field(default="doBlankHolder", pattern=r"^[A-Za-z][A-Za-z0-9_]{0,31}$")
    step_mm: float | None = Field(
        default=None, ge=0.02, le=20, description="distance that the holder sinks at each pulse"
    )


class PartScan(Strict):
    """Scan of a part that was formed before: ``file`` as it was given to `tandem adjust`."""

    file: Annotated[Path, AfterValidator(_relative_to_problem_file)]


class Springback(Strict):
    """Springback compensation: both tools go deeper by the expected springback of the sheet.

    ``file``: output of `tandem springback --write` for this very problem, or of `tandem adjust` from the
    ``scan`` of a part that was formed before. The shift of the tools changes along the path by at most
    ``slope`` and is at most ``most_mm``.
    """

    file: Annotated[Path, AfterValidator(_relative_to_problem_file)]
    scan: PartScan | None = None
    slope: float = Field(
        default=0.05, ge=0.001, le=0.5, description="largest change of the shift along the path, in mm/mm"
    )
    most_mm: float = Field(default=10.0, gt=0, le=12, description="largest shift")


LEVEL_MODES = frozenset({"spif", "dsif", "dpif_l", "heat"})
"""Modes that form level by level, and in which the sheet is one elastic sheet held by its clamp."""


class ForceBy(Strict):
    """Forces on the sheet that vary over a part, instead of ``force_n``.

    ``table``: force on the forming tool by depth. ``file``: a measured CSV with the columns of `tandem
    next-loop --forces`: by level, of both tools together, and by position where it has points with ``x_mm``
    and ``y_mm``.
    """

    table: list[tuple[Height, Newton]] | None = Field(
        default=None,
        min_length=2,
        max_length=1000,
        description="rows of z of the contact in the sheet's frame [mm], ascending or descending, and "
        "the force along z [N] there; linear between rows",
    )
    file: Annotated[Path | None, AfterValidator(_relative_to_problem_file)] = None

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.table is None) == (self.file is None):
            raise ValueError("state either a table by depth or a file of measured forces")
        step = np.diff([row[0] for row in self.table or ()])
        if not ((step > 0.0).all() or (step < 0.0).all()):
            row = int(np.flatnonzero(step * step[0] <= 0.0)[0]) + 2
            z = 0.0 if self.table is None else self.table[row - 1][0]
            raise ValueError(f"table: row {row} is at z {z:g} mm; z must ascend or descend throughout")
        if self.table is not None and not any(force > 0.0 for _, force in self.table):
            raise ValueError("table: all forces are 0")
        return self


FORCE_MODES = frozenset({"spif", "dsif", "dpif_l", "dpif_p", "heat"})
"""Modes whose forces may be stated by depth or level: those whose springback is predicted."""
WHOLE_SHEET_MODES = frozenset({"adsif", "tpif"})
"""Modes that cannot form a sheet with holes: tools press all of it, or its rim sinks with a holder."""
SUPPORT_MODES = frozenset({"dsif", "dpif_l"})
"""Modes in which the second tool presses the sheet against the forming tool."""


class Level(Strict):
    """A single level of one pass, in the sheet as the previous levels have left it.

    ``number`` counts from 0, as in the file of curves of `tandem springback --curves`; ``pass_name``: none is
    the first pass. ``file``: the shifts of this level, which `tandem next-loop --problem` writes beside the
    problem, for the problem with the digest ``plan``; none: tools stay on their path. Shifts change along the
    path by at most ``slope``, are at most ``most_mm``, and start with ``before_mm``, at which the previous
    level ends.
    """

    number: int = Field(ge=0, lt=100_000)
    pass_name: Name | None = None
    file: Annotated[Path | None, AfterValidator(_relative_to_problem_file)] = None
    plan: str | None = Field(
        default=None, pattern="^[0-9a-f]{64}$", description="digest of the problem that the file belongs to"
    )
    slope: float = Field(
        default=0.05, ge=0.001, le=0.5, description="largest change of the shift along the path, in mm/mm"
    )
    most_mm: float = Field(default=10.0, gt=0, le=12, description="largest shift")
    before_mm: float = Field(default=0.0, ge=0, le=12, description="shift at which the previous level ends")


class Forming(Strict):
    """Incremental forming of the clamped sheet by the tools of one or two arms.

    The first arm's tool works on the sheet's top side (+z of its frame), the second one's below. A single arm
    works on ``side``. A feature that goes down is formed by the tool above, one that goes up by the one
    below.
    """

    name: Name
    process: Literal["forming"]
    arms: tuple[str, ...] = Field(min_length=1, max_length=2)
    mode: Mode
    side: Literal["top", "bottom"] = Field(default="top", description="side of the tool of a single arm")
    path: Literal["helical", "contour", "alternating", "stepped"] = "helical"
    stepdown_mm: float | None = Field(default=None, ge=0.02, le=20)
    scallop_mm: float | None = Field(
        default=None, ge=0.0005, le=2, description="height of the ridges between loops; sets the steps"
    )
    tangent_deg: float = Field(
        default=4.0, ge=0.2, le=30, description="largest turn of the path between targets"
    )
    chord_mm: float = Field(
        default=0.05, ge=0.002, le=1, description="largest deviation of straight moves from the path"
    )
    longest_mm: float = Field(
        default=20.0, ge=0.2, le=200, description="longest move; bounds the offset between two controllers"
    )
    seam_deg: Angle = Field(default=0.0, description="direction from the feature's middle where loops start")
    direction: Literal["ccw", "cw"] = "ccw"
    feature_step_mm: float = Field(
        default=0.5, ge=0.02, le=10, description="spacing of the slices that detect features"
    )
    strategy: Literal["in_place", "virgin"] = Field(
        default="in_place", description="parents first, in place; or inner features first, on the flat sheet"
    )
    features: tuple[int, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=10_000,
        description="numbers of the features that this operation forms, as `tandem features` prints them; "
        "other operations form the others. None: all",
    )
    hole_margin_mm: float = Field(
        default=5.0,
        ge=0.5,
        le=200,
        description="minimum distance, seen along z, of formed areas and tools from curves along "
        "which the sheet was cut before",
    )
    order: tuple[int, ...] | None = Field(default=None, description="custom order of the features")
    squeeze: float = Field(
        default=1.0, ge=0.5, le=1.2, description="ratio of the gap to the thickness by the sine law"
    )
    shift_deg: float = Field(
        default=0.0,
        ge=0,
        le=90,
        description="shift of the support around the forming tool, up to the wall angle",
    )
    angle_step_deg: float = Field(
        default=15.0, ge=1, le=45, description="wall angle between intermediate shapes of steep walls"
    )
    passes: Literal["auto"] | tuple[float, ...] = Field(
        default="auto", description="wall angles [deg] of the passes; auto: as the metal requires"
    )
    repeats: int = Field(default=1, ge=1, le=10, description="number of runs of each pass")
    feed_mm_s: float = Field(
        default=25.0, ge=0.5, le=500, description="feed of both tools' TCPs on the sheet"
    )
    lean_deg: float = Field(
        default=0.0, ge=0, le=60, description="tilt of the tools from the sheet's normal toward the surface's"
    )
    cone_deg: float = Field(
        default=0.0, ge=0, le=45, description="further tilt that motion planning may choose"
    )
    force_n: float | None = Field(
        default=None, gt=0, le=100_000, description="force on the forming tool; none: by a formula"
    )
    force_by: ForceBy | None = None
    support_force_n: float | None = Field(
        default=None,
        ge=0,
        le=100_000,
        description="force along z with which the support presses the sheet against the forming tool; "
        "the remaining force of the forming tool bends the sheet",
    )
    gouge_tol_mm: float = Field(default=0.05, ge=0.002, le=1)
    gap_tol_mm: float = Field(default=0.02, ge=0.002, le=1)
    handshake_gap_mm: float = Field(
        default=0.5, ge=0, le=10, description="allowed gap error if two controllers are one step apart"
    )
    share: float = Field(
        default=0.95, gt=0.5, le=1, description="fraction of the walls that must be formed within tolerance"
    )
    unreached_mm: float | None = Field(
        default=None,
        ge=0.02,
        le=100,
        description="largest distance of balls from the part where they do not fit; none: only reported",
    )
    adsif: Adsif = Adsif()
    die: Die | None = None
    springback: Springback | None = None
    level: Level | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Require that the fields do not contradict one another."""
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: name each arm once")
        is_single_arm = self.mode in ("spif", "tpif")
        if is_single_arm != (len(self.arms) == 1):
            required_arms = (
                "one arm" if is_single_arm else "two arms, the first above the sheet and the second below"
            )
            raise ValueError(f"mode {self.mode} needs {required_arms}")
        if (self.die is not None) != (self.mode == "tpif"):
            raise ValueError("a die is required in mode tpif and not allowed in other modes")
        sinking = self.die is not None and self.die.holder == "sinking"
        if self.die is not None and sinking and self.die.step_mm is None and self.stepdown_mm is None:
            raise ValueError("die: the holder's step_mm is needed where scallop_mm sets the tool's steps")
        if (self.stepdown_mm is None) == (self.scallop_mm is None):
            raise ValueError("give either stepdown_mm or scallop_mm")
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
        """Check the numbers of the features that the operation forms."""
        if self.features is None:
            return
        if len(set(self.features)) != len(self.features) or min(self.features) < 1:
            raise ValueError("features: numbers start at 1; name each once")
        if self.mode not in FORCE_MODES:
            allowed = ", ".join(sorted(FORCE_MODES))
            raise ValueError(f"features belongs to the modes {allowed}, not {self.mode}")
        if self.level is not None or self.springback is not None:
            raise ValueError(
                "features: level and springback are not supported for a sheet that is formed in stages; "
                "remove them"
            )

    def _stated_forces(self) -> None:
        """Check forces by depth or level, and the force of a support."""
        force_by, support = self.force_by, self.support_force_n
        if force_by is not None:
            if self.force_n is not None:
                raise ValueError("give either force_n or force_by")
            if self.mode not in FORCE_MODES:
                allowed = ", ".join(sorted(FORCE_MODES))
                raise ValueError(f"force_by belongs to the modes {allowed}, not {self.mode}")
            if force_by.file is not None and self.stepdown_mm is None:
                raise ValueError(
                    "force_by: levels are counted by stepdown_mm; state it instead of scallop_mm"
                )
        if support is None:
            return
        if self.mode not in SUPPORT_MODES:
            allowed = " and ".join(sorted(SUPPORT_MODES))
            message = (
                f"support_force_n belongs to the modes {allowed}; in {self.mode} no second tool presses "
            )
            raise ValueError(message + "the sheet against the forming tool")
        if force_by is not None and force_by.file is not None:
            raise ValueError("support_force_n: the file of force_by already has the force of both tools")
        if self.force_n is None and force_by is None:
            message = "support_force_n: the formula has no support; state the force of the forming tool in "
            raise ValueError(message + "force_n or in a table of force_by")
        forming_forces = (
            [force for _, force in force_by.table or ()] if force_by is not None else [self.force_n or 0.0]
        )
        if min(forming_forces) < support or max(forming_forces) <= support:
            message = f"support_force_n: {support:g} N exceeds the forming tool's {min(forming_forces):g} N; "
            raise ValueError(message + "the total force must point in the direction of the forming tool")

    def _one_level(self) -> None:
        """Check the level that is formed alone."""
        if self.level is None:
            return
        if self.mode not in LEVEL_MODES:
            raise ValueError(f"level belongs to the modes {', '.join(sorted(LEVEL_MODES))}, not {self.mode}")
        if self.stepdown_mm is None:
            raise ValueError("level: levels are counted by stepdown_mm; state it instead of scallop_mm")
        if self.springback is not None:
            raise ValueError("level: has its own file; remove springback")
        if (self.level.file is None) != (self.level.plan is None):
            raise ValueError("level: give file and plan, or neither")
        if self.level.before_mm > self.level.most_mm:
            raise ValueError("level: before_mm is above most_mm")
        if self.level.file is None and self.level.before_mm > 0.0:
            raise ValueError("level: before_mm needs file, whose shifts start with it")
        if self.level.number == 0 and self.level.before_mm > 0.0:
            raise ValueError("level: before_mm must be 0 for level 0, which has no previous level")

    def leaves(self, stock: Stock) -> Stock:
        """Return the stock after the operation: unchanged, because the sheet stays clamped.

        What protrudes from it is part of its solids from the beginning.
        """
        return stock

    def with_fixtures(
        self, stock: Stock, part: Part | None, previous_operations: Sequence[Operation]
    ) -> Stock:
        """Return the stock with the die and with everything that protrudes from the unfinished sheet.

        The die is behind the sheet, over all heights at which a clamp that sinks has it.

        Args:
            stock: Stock.
            part: Part to form.
            previous_operations: Operations before this one.
        """
        if self.die is not None:
            stock = with_die(self.die, 1 if self.side == "top" else -1, stock, part)
        if self.strategy != "virgin" or part is None or part.formed is None:
            return stock
        done = [
            number
            for op in previous_operations
            if isinstance(op, FormingOperation) and op.process == FORMING
            for number in op.features or ()
        ]
        mesh = part.formed.mesh
        noise = max(MIN_BUMP_HEIGHT_M, part.formed.tolerance)
        try:
            tree = build_feature_tree(mesh, self.feature_step_mm * MM, noise)
            order = forming_order(tree, virgin=True, given=self.order, selected=self.features, previous=done)
        except TandemError:
            return stock  # the job itself says what is wrong
        return with_states(
            stock, mesh, tree, order, [number for number in done if number <= len(tree.features)]
        )
