"""The block of a problem file and what an operator changes between operations: schemas in mm and degrees, and
their values in SI units.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, Tag

from planner.catalogue.materials import Foam, foam
from planner.geometry.arrays import from_rpy
from planner.geometry.units import DEG, GRAVITY, MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.problem import Arm, Cell, Change, Pedestal, Problem, Setup, Stock
from planner.reading import cell as cell_file
from planner.reading import materials as material_file
from planner.reading.cell import PoseFile, ShapeFile, ToolFile
from planner.reading.strict_yaml import Angle, Choice, FileName, Name, Positive, Strict
from planner.tooling import Gripper

TABLE: Final = Pedestal(
    "table", tuple(0.2 * k for k in range(1, 21)), tuple(0.05 * k for k in range(10, 23)), 1.0, 0.1
)
"""What `support: table` stands for: sizes by 200 mm along the sides, 50 mm of height."""
PEDESTAL: Final = Pedestal(
    "pedestal", tuple(0.04 * k for k in range(1, 26)), tuple(0.1 * k for k in range(2, 16)), 0.6
)
"""What `support: pedestal` stands for: sizes by 40 mm along the sides, 100 mm of height; it leaves wires and
tools room beside it."""
GRIP_FORCE_FACTOR: Final = 3.0
"""Times its weight that a gripper must hold a block with: the arm's accelerations, and foam that gives."""


Auto = Annotated[Literal["auto"], Tag("word")]
PlaceFile = Annotated[Auto | Annotated[PoseFile, Tag("mapping")], Choice]
SupportFile = Annotated[
    Annotated[Literal["table", "pedestal"], Tag("word")] | Annotated[tuple[ShapeFile, ...], Tag("mapping")],
    Choice,
]
Extra = Annotated[float, Field(ge=0, le=5000)]
Sides = tuple[Extra, Extra]
FLAT_ANGLE: Final = 1.0 * DEG
"""How far a block's bottom face may be turned off the gripper that holds it [rad]."""
FLAT_GAP: Final = 0.5 * MM
"""How far a block's bottom face may be off the gripper that holds it [m]."""


class FoamReference(Strict):
    """A foam of the user's own, from a file that ``tandem kerf fit`` writes."""

    file: FileName


class StockFile(Strict):
    """The block and where it stands; ``place: auto`` lets Tandem search.

    ``oversize_mm``: how far the raw block stands out of the datum block below and above along x, y and z.
    ``held_by``: the arm that holds the block by its bottom face; ``grip`` is the block's frame in that arm's
    TCP frame, and ``place`` then the pose about which it is moved.
    """

    size_mm: tuple[Positive, Positive, Positive]
    place: PlaceFile = "auto"
    roll_pitch_deg: tuple[Angle, Angle] | None = None
    support: SupportFile = ()
    oversize_mm: tuple[Sides, Sides, Sides] = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    foam: (
        Annotated[
            Annotated[str, Tag("word"), Field(max_length=60, description="name in the table of foams")]
            | Annotated[FoamReference, Tag("mapping")],
            Choice,
        ]
        | None
    ) = None
    held_by: Name | None = None
    grip: PoseFile | None = Field(
        default=None, description="none: chosen, the middle of the block where that will do"
    )
    gripper: Name | None = Field(
        default=None, description="one of the cell's grippers; none: the mounted one, or one that fits"
    )


class SetupFile(Strict):
    """What the operator changes before an operation; what is not named stays as it was."""

    tools: dict[Name, ToolFile] = Field(
        default_factory=dict, description="tool of each arm that gets another one"
    )
    place: PlaceFile | None = None
    roll_pitch_deg: tuple[Angle, Angle] | None = None
    support: SupportFile | None = None
    oversize_mm: tuple[Sides, Sides, Sides] | None = None
    held_by: Annotated[Name | Literal["nobody"], Field(description="nobody: the block stands")] | None = None
    grip: PoseFile | None = None
    note: str = Field(default="", max_length=200, description="what else the operator is told")


def stock(spec: StockFile, folder: Path) -> Stock:
    """The block in SI units. Raises ``TandemError`` for mesh files, foam files and unknown foams."""
    return Stock(
        np.array(spec.size_mm) * MM,
        **_placed(spec.place, spec.roll_pitch_deg),
        **_support(spec.support, folder),
        oversize=_oversize(spec.oversize_mm),
        foam=_foam(spec.foam, folder),
        held_by=spec.held_by,
        grip=(spec.grip or PoseFile()).matrix(),
    )


def with_gripper(cell: Cell, spec: StockFile) -> Cell:
    """The cell with the gripper that the block names mounted on the arm that holds it. Raises ``TandemError``
    for a name that the cell does not have."""
    if spec.gripper is None:
        return cell
    found = next((tool for tool in cell.grippers if tool.name == spec.gripper), None)
    if found is None or spec.held_by not in [arm.name for arm in cell.arms]:
        known = ", ".join(tool.name for tool in cell.grippers) or "none"
        what = (
            f"stock.gripper: got {spec.gripper}; the cell's grippers are {known}"
            if found is None
            else "stock.gripper: a gripper is named for a block that no arm holds; give held_by"
        )
        raise refusal("problem.field", what, field="stock.gripper")
    arms = tuple(
        dataclasses.replace(arm, tool=found) if arm.name == spec.held_by else arm for arm in cell.arms
    )
    return dataclasses.replace(cell, arms=arms, grippers=())


def change(spec: SetupFile, arms: tuple[Arm, ...], folder: Path, number: int) -> Change:
    """The change that an operation's ``setup`` asks for. Raises ``TandemError`` for tools and mesh files.

    ``number`` is the operation's index, for the fields of issues.
    """
    field = f"operations.{number}.setup"
    known = {arm.name: arm for arm in arms}
    tools, steps, issues = {}, [], []
    for name, wanted in spec.tools.items():
        if name not in known:
            issues.append(_unknown_arm(f"{field}.tools", name, known))
            continue
        tools[name] = cell_file.tool(wanted, folder)
        data = known[name].data
        if tools[name].mass > data.payload:
            issues.append(cell_file.too_heavy(name, f"{field}.tools.{name}", tools[name], data))
        steps.append(f"Mount the tool {tools[name].name} on arm {name}.")
    fields: dict[str, Any] = {}
    if spec.place is not None:
        fields |= _placed(spec.place, spec.roll_pitch_deg)
    elif spec.roll_pitch_deg is not None:
        issues.append(Issue("problem.field", f"{field}.roll_pitch_deg needs place; add it", field=field))
    if spec.support is not None:
        fields |= _support(spec.support, folder)
    if spec.oversize_mm is not None:
        fields["oversize"] = _oversize(spec.oversize_mm)
    if spec.held_by is not None:
        fields["held_by"] = None if spec.held_by == "nobody" else spec.held_by
    if spec.grip is not None:
        fields["grip"] = spec.grip.matrix()
    if spec.held_by == "nobody":
        steps.append("Take the block off its gripper and clamp it as the setup sheet says.")
    elif spec.held_by is not None:
        steps.append(f"Fix the block to the gripper of arm {spec.held_by} as the setup sheet says.")
    elif set(fields) & {"place", "support"}:
        steps.append("Clamp the block in its new place as the setup sheet says.")
    steps += [spec.note] if spec.note else []
    if issues:
        raise TandemError(issues)
    return Change(tools, fields, tuple(steps) or ("Look the setup over.",))


def first_steps(problem: Problem) -> tuple[str, ...]:
    """What the operator does before the first operation of a job in which something is changed or held."""
    steps = []
    first, several = problem.setups[0], len(problem.setups) > 1
    if several:
        steps += [f"Mount the tool {arm.tool.name} on arm {arm.name}." for arm in first.cell.arms]
    if first.stock.held_by is not None:
        tool = first.cell.arm(first.stock.held_by).tool
        if not several and tool in first.cell.grippers:
            steps.append(f"Mount the tool {tool.name} on arm {first.stock.held_by}.")
        steps.append(f"Fix the block to the gripper of arm {first.stock.held_by} as the setup sheet says.")
    elif several:
        steps.append("Clamp the block as the setup sheet says.")
    return tuple(steps)


def check_setups(problem: Problem) -> Iterator[Issue]:
    """Issues of blocks that are held: by whom, with what, and whether the arm can carry them."""
    for setup in problem.setups:
        if setup.stock.held_by is not None:
            yield from _held(
                setup, f"operations.{setup.operations[0]}.setup" if setup.number > 1 else "stock"
            )


def _held(setup: Setup, field: str) -> Iterator[Issue]:
    block, name = setup.stock, setup.stock.held_by
    known = {arm.name: arm for arm in setup.cell.arms}
    if name not in known:
        yield _unknown_arm(f"{field}.held_by", str(name), known)
        return
    arm = known[name]
    tool = arm.tool
    if not isinstance(tool, Gripper):
        what = f"{field}.held_by: arm {name} carries the tool {tool.name}, which holds no block; give it a "
        what += "gripper_plate or a vacuum_cup"
        yield Issue("stock.gripper", what, field=f"{field}.held_by", arm=name)
        return
    if block.mass is None:
        what = f"{field}: the block is held by arm {name}, but its weight is not known; name its foam"
        yield Issue("stock.foam_missing", what, field="stock.foam")
        return
    if block.support or block.pedestal:
        what = f"{field}.support: a block that arm {name} holds stands on nothing; give support: [], and put "
        what += "what else stands in the cell among its obstacles"
        yield Issue("problem.field", what, field=f"{field}.support")
    payload, needed = arm.data.payload, GRIP_FORCE_FACTOR * block.mass * GRAVITY
    if tool.mass + block.mass > payload:
        yield Issue(
            "stock.too_heavy",
            f"{field}: the block of {block.mass:.2f} kg and the tool of {tool.mass:.2f} kg are "
            f"{block.mass + tool.mass:.2f} kg, {arm.data.title} carries {payload:g} kg; take a "
            "lighter foam, a smaller block or a larger arm",
            field=f"{field}.held_by",
            arm=name,
            **measurement(block.mass + tool.mass, payload, "kg"),
        )
    elif needed > tool.holding:
        yield Issue(
            "stock.grip_force",
            f"{field}: {tool.name} holds with {tool.holding:.1f} N, the block of {block.mass:.2f} kg "
            f"needs {needed:.1f} N ({GRIP_FORCE_FACTOR:g} times its weight, since the arm shakes it); "
            "take a larger gripper, or state its holding_n where it is known",
            field=f"{field}.held_by",
            arm=arm.name,
            **measurement(needed, tool.holding, "N"),
        )
    yield from _footprint(block, arm.name, tool, field)


def _footprint(block: Stock, arm: str, tool: Gripper, field: str) -> Iterator[Issue]:
    """The gripper must lie flat on the block's bottom face, and within it."""
    lean = float(np.arccos(np.clip(block.grip[2, 2], -1.0, 1.0)))
    gap = float(block.grip[2, 3] + block.lower[2])
    if lean > FLAT_ANGLE or abs(gap) > FLAT_GAP:
        how = f"{lean / DEG:.1f} degrees off it" if lean > FLAT_ANGLE else f"{gap / MM:.1f} mm off it"
        what = f"{field}.grip: the block's bottom face must lie on {tool.name}, whose z points into the "
        what += f"block, but is {how}; allowed are {FLAT_ANGLE / DEG:g} degrees and {FLAT_GAP / MM:g} mm: "
        what += f"turn the grip about z only, with {abs(block.lower[2]) / MM:g} as its z (the oversize below)"
        yield Issue("stock.footprint", what, field=f"{field}.grip", arm=arm)
        return
    half = 0.5 * np.array(tool.footprint)
    corners = np.array([[x, y, 0.0, 1.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    on_block = corners @ np.linalg.inv(block.grip).T
    over = np.maximum(on_block[:, :2] - block.upper[:2], block.lower[:2] - on_block[:, :2]).max()
    if over > 1e-9:
        yield Issue(
            "stock.footprint",
            f"{field}.grip: the face of {tool.name} stands {over / MM:.1f} mm out of the block's bottom "
            "face; take a smaller gripper or move the grip",
            field=f"{field}.grip",
            arm=arm,
            **measurement(float(over / MM), 0.0, "mm"),
        )


def _placed(place: Literal["auto"] | PoseFile, lean: tuple[float, float] | None) -> dict[str, Any]:
    pose = None if isinstance(place, str) else place.matrix()
    roll, pitch = np.array(lean or (0.0, 0.0)) * DEG
    attitude = from_rpy((0, 0, 0), (roll, pitch, 0))[:3, :3] if pose is None else pose[:3, :3]
    return {"place": pose, "attitude": attitude, "any_attitude": pose is None and lean is None}


def _support(given: SupportFile, folder: Path) -> dict[str, Any]:
    if isinstance(given, str):
        return {"support": (), "pedestal": TABLE if given == "table" else PEDESTAL}
    return {"support": tuple(cell_file.shape(s, folder) for s in given), "pedestal": None}


def _oversize(sides: tuple[Sides, Sides, Sides]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array(sides, dtype=np.float64).T * MM


def _foam(wanted: str | FoamReference | None, folder: Path) -> Foam | None:
    if isinstance(wanted, FoamReference):
        return material_file.read_foam(folder / wanted.file)
    if wanted is None:
        return None
    try:
        return foam(wanted)
    except TandemError as error:
        raise TandemError([dataclasses.replace(i, field="stock.foam") for i in error.issues]) from None


def _unknown_arm(field: str, name: str, known: Mapping[str, Arm]) -> Issue:
    what = f"{field}: '{name}' is not an arm of the cell; it has {', '.join(known)}"
    return Issue("problem.unknown_arm", what, field=field)
