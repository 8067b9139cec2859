"""The block of a problem file, and the changes that an operator makes between operations.

Schemas are in mm and degrees, values in SI units.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, Tag

from planner.catalogue.materials import FoamMaterial, foam
from planner.geometry.arrays import from_rpy
from planner.geometry.units import DEG, GRAVITY, MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Arm, Cell, Pedestal, Problem, Setup, SetupChange, Stock
from planner.reading import cell as cell_file
from planner.reading import materials as material_file
from planner.reading.cell import PoseFile, ShapeFile, ToolFile
from planner.reading.strict_yaml import Angle, FileName, Name, Positive, Strict, WordOrMapping
from planner.tooling import Gripper

TABLE: Final = Pedestal(
    "table", tuple(0.2 * k for k in range(1, 21)), tuple(0.05 * k for k in range(10, 23)), 1.0, 0.1
)
"""Sizes of `support: table`: steps of 200 mm along the sides, 50 mm of height."""
PEDESTAL: Final = Pedestal(
    "pedestal", tuple(0.04 * k for k in range(1, 26)), tuple(0.1 * k for k in range(2, 16)), 0.6
)
"""Sizes of `support: pedestal`: steps of 40 mm along the sides, 100 mm of height.

It leaves room beside it for wires and tools.
"""
GRIP_FORCE_FACTOR: Final = 3.0
"""Required ratio of holding force to weight of a block, for the arm's accelerations and compliant foam."""


Auto = Annotated[Literal["auto"], Tag("word")]
PlaceFile = Annotated[Auto | Annotated[PoseFile, Tag("mapping")], WordOrMapping]
SupportFile = Annotated[
    Annotated[Literal["table", "pedestal"], Tag("word")] | Annotated[tuple[ShapeFile, ...], Tag("mapping")],
    WordOrMapping,
]
Extra = Annotated[float, Field(ge=0, le=5000)]
Sides = tuple[Extra, Extra]
MAX_GRIP_ANGLE_RAD: Final = 1.0 * DEG
"""Maximum angle [rad] between the bottom face of a block and the gripper that holds it."""
MAX_GRIP_GAP_M: Final = 0.5 * MM
"""Maximum gap [m] between the bottom face of a block and the gripper that holds it."""


class FoamReference(Strict):
    """A custom foam, from a file that ``tandem kerf fit`` writes."""

    file: FileName


class StockFile(Strict):
    """The block and its pose. ``place: auto`` lets Tandem search.

    ``oversize_mm`` is how far the raw block extends beyond the datum block below and above along x, y and z.
    ``held_by`` is the arm that holds the block by its bottom face; ``grip`` is then the pose of the block in
    the TCP frame of that arm, and ``place`` the pose about which it is moved.
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
            WordOrMapping,
        ]
        | None
    ) = None
    held_by: Name | None = None
    grip: PoseFile | None = Field(
        default=None, description="none: chosen, at the centre of the block if possible"
    )
    gripper: Name | None = Field(
        default=None, description="one of the cell's grippers; none: the mounted one, or one that fits"
    )


class SetupFile(Strict):
    """What the operator changes before an operation. Keys that are not stated keep their values."""

    tools: dict[Name, ToolFile] = Field(default_factory=dict, description="new tools by arm")
    place: PlaceFile | None = None
    roll_pitch_deg: tuple[Angle, Angle] | None = None
    support: SupportFile | None = None
    oversize_mm: tuple[Sides, Sides, Sides] | None = None
    held_by: Annotated[Name | Literal["nobody"], Field(description="nobody: it is not held")] | None = None
    grip: PoseFile | None = None
    note: str = Field(default="", max_length=200, description="further instruction for the operator")


def build_stock(spec: StockFile, folder: Path) -> Stock:
    """Convert the block to SI units.

    Raises:
        TandemError: For mesh files, foam files and unknown foams.
    """
    return Stock(
        np.array(spec.size_mm) * MM,
        **_pose_fields(spec.place, spec.roll_pitch_deg),
        **_support_fields(spec.support, folder),
        oversize=_oversize_array(spec.oversize_mm),
        foam=_read_foam(spec.foam, folder),
        held_by=spec.held_by,
        grip=(spec.grip or PoseFile()).to_matrix(),
    )


def mount_gripper(cell: Cell, spec: StockFile) -> Cell:
    """Return the cell with the gripper that the block names mounted on the arm that holds it.

    Raises:
        TandemError: If the cell has no such gripper.
    """
    if spec.gripper is None:
        return cell
    gripper = next((tool for tool in cell.grippers if tool.name == spec.gripper), None)
    if gripper is None or spec.held_by not in [arm.name for arm in cell.arms]:
        gripper_names = ", ".join(tool.name for tool in cell.grippers) or "none"
        message = (
            f"stock.gripper: got {spec.gripper}; the cell's grippers are {gripper_names}"
            if gripper is None
            else "stock.gripper: a gripper is stated, but no arm holds the block; give held_by"
        )
        raise issue_error("problem.field", message, field="stock.gripper")
    arms = tuple(
        dataclasses.replace(arm, tool=gripper) if arm.name == spec.held_by else arm for arm in cell.arms
    )
    return dataclasses.replace(cell, arms=arms, grippers=())


def build_change(spec: SetupFile, arms: tuple[Arm, ...], folder: Path, number: int) -> SetupChange:
    """Convert the ``setup`` of an operation to a change.

    Args:
        spec: Setup of the file.
        arms: Arms of the cell.
        folder: Folder to which file names are relative.
        number: Index of the operation, for the fields of issues.

    Raises:
        TandemError: For tools and mesh files.
    """
    field = f"operations.{number}.setup"
    arms_by_name = {arm.name: arm for arm in arms}
    tools, steps, issues = {}, [], []
    for name, tool_spec in spec.tools.items():
        if name not in arms_by_name:
            issues.append(_unknown_arm_issue(f"{field}.tools", name, arms_by_name))
            continue
        tools[name] = cell_file.build_tool(tool_spec, folder)
        data = arms_by_name[name].data
        if tools[name].mass > data.payload:
            issues.append(cell_file.tool_too_heavy_issue(name, f"{field}.tools.{name}", tools[name], data))
        steps.append(f"Mount the tool {tools[name].name} on arm {name}.")
    fields: dict[str, Any] = {}
    if spec.place is not None:
        fields |= _pose_fields(spec.place, spec.roll_pitch_deg)
    elif spec.roll_pitch_deg is not None:
        issues.append(Issue("problem.field", f"{field}.roll_pitch_deg needs place; add it", field=field))
    if spec.support is not None:
        fields |= _support_fields(spec.support, folder)
    if spec.oversize_mm is not None:
        fields["oversize"] = _oversize_array(spec.oversize_mm)
    if spec.held_by is not None:
        fields["held_by"] = None if spec.held_by == "nobody" else spec.held_by
    if spec.grip is not None:
        fields["grip"] = spec.grip.to_matrix()
    if spec.held_by == "nobody":
        steps.append("Take the block off its gripper and clamp it as the setup sheet says.")
    elif spec.held_by is not None:
        steps.append(f"Fix the block to the gripper of arm {spec.held_by} as the setup sheet says.")
    elif set(fields) & {"place", "support"}:
        steps.append("Clamp the block in its new place as the setup sheet says.")
    steps += [spec.note] if spec.note else []
    if issues:
        raise TandemError(issues)
    return SetupChange(tools, fields, tuple(steps) or ("Check the setup.",))


def first_instructions(problem: Problem) -> tuple[str, ...]:
    """Return the instructions before the first operation, if something is changed or held."""
    steps = []
    first, has_changes = problem.setups[0], len(problem.setups) > 1
    if has_changes:
        steps += [f"Mount the tool {arm.tool.name} on arm {arm.name}." for arm in first.cell.arms]
    if first.stock.held_by is not None:
        tool = first.cell.arm(first.stock.held_by).tool
        if not has_changes and tool in first.cell.grippers:
            steps.append(f"Mount the tool {tool.name} on arm {first.stock.held_by}.")
        steps.append(f"Fix the block to the gripper of arm {first.stock.held_by} as the setup sheet says.")
    elif has_changes:
        steps.append("Clamp the block as the setup sheet says.")
    return tuple(steps)


def check_setups(problem: Problem) -> Iterator[Issue]:
    """Yield issues of held blocks: holder, gripper, and payload of the arm."""
    for setup in problem.setups:
        if setup.stock.held_by is not None:
            yield from _held_block_issues(
                setup, f"operations.{setup.operations[0]}.setup" if setup.number > 1 else "stock"
            )


def _held_block_issues(setup: Setup, field: str) -> Iterator[Issue]:
    """Yield issues of a block that an arm holds in a setup; ``field`` states the block."""
    block, name = setup.stock, setup.stock.held_by
    arms_by_name = {arm.name: arm for arm in setup.cell.arms}
    if name not in arms_by_name:
        yield _unknown_arm_issue(f"{field}.held_by", str(name), arms_by_name)
        return
    arm = arms_by_name[name]
    tool = arm.tool
    if not isinstance(tool, Gripper):
        text = f"{field}.held_by: arm {name} carries the tool {tool.name}, which holds no block; give it "
        text += "a gripper_plate or a vacuum_cup"
        yield Issue("stock.gripper", text, field=f"{field}.held_by", arm=name)
        return
    if block.mass is None:
        text = f"{field}: the block is held by arm {name}, but its weight is unknown; state its foam"
        yield Issue("stock.foam_missing", text, field="stock.foam")
        return
    if block.support or block.pedestal:
        text = f"{field}.support: a block that arm {name} holds has no support; give support: [], and list "
        text += "other bodies of the cell among its obstacles"
        yield Issue("problem.field", text, field=f"{field}.support")
    payload, required_force = arm.data.payload, GRIP_FORCE_FACTOR * block.mass * GRAVITY
    if tool.mass + block.mass > payload:
        yield Issue(
            "stock.too_heavy",
            format_message(
                "stock.too_heavy",
                field=field,
                block_kg=block.mass,
                tool_kg=tool.mass,
                total_kg=block.mass + tool.mass,
                robot=arm.data.title,
                payload_kg=payload,
            ),
            field=f"{field}.held_by",
            arm=name,
            **measurement(block.mass + tool.mass, payload, "kg"),
        )
    elif required_force > tool.holding_force:
        yield Issue(
            "stock.grip_force",
            format_message(
                "stock.grip_force",
                field=field,
                gripper=tool.name,
                holding_force_n=tool.holding_force,
                block_kg=block.mass,
                required_force_n=required_force,
                force_factor=GRIP_FORCE_FACTOR,
            ),
            field=f"{field}.held_by",
            arm=arm.name,
            **measurement(required_force, tool.holding_force, "N"),
        )
    yield from _footprint_issues(block, arm.name, tool, field)


def _footprint_issues(block: Stock, arm: str, tool: Gripper, field: str) -> Iterator[Issue]:
    """Check that the gripper lies flat on the bottom face of the block, and within it."""
    angle = float(np.arccos(np.clip(block.grip[2, 2], -1.0, 1.0)))
    gap = float(block.grip[2, 3] + block.lower[2])
    if angle > MAX_GRIP_ANGLE_RAD or abs(gap) > MAX_GRIP_GAP_M:
        deviation_text = (
            f"{angle / DEG:.1f} degrees off it" if angle > MAX_GRIP_ANGLE_RAD else f"{gap / MM:.1f} mm off it"
        )
        message = (
            f"{field}.grip: the block's bottom face must lie on {tool.name}, whose z points into the block, "
            f"but is {deviation_text}; allowed are {MAX_GRIP_ANGLE_RAD / DEG:g} degrees and "
            f"{MAX_GRIP_GAP_M / MM:g} mm: turn the grip about z only, with {abs(block.lower[2]) / MM:g} as "
            "its z (the oversize below)"
        )
        yield Issue("stock.footprint", message, field=f"{field}.grip", arm=arm)
        return
    half = 0.5 * np.array(tool.footprint)
    corners = np.array([[x, y, 0.0, 1.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    on_block = corners @ np.linalg.inv(block.grip).T
    overlap = np.maximum(on_block[:, :2] - block.upper[:2], block.lower[:2] - on_block[:, :2]).max()
    if overlap > 1e-9:
        yield Issue(
            "stock.footprint",
            f"{field}.grip: the face of {tool.name} extends {overlap / MM:.1f} mm beyond the block's bottom "
            "face; use a smaller gripper or move the grip",
            field=f"{field}.grip",
            arm=arm,
            **measurement(float(overlap / MM), 0.0, "mm"),
        )


def _pose_fields(placement: Literal["auto"] | PoseFile, tilt: tuple[float, float] | None) -> dict[str, Any]:
    """Return the fields of a stock that follow from its place, or from roll and pitch [deg] without one."""
    pose = None if isinstance(placement, str) else placement.to_matrix()
    roll, pitch = np.array(tilt or (0.0, 0.0)) * DEG
    attitude = from_rpy((0, 0, 0), (roll, pitch, 0))[:3, :3] if pose is None else pose[:3, :3]
    return {"place": pose, "attitude": attitude, "any_attitude": pose is None and tilt is None}


def _support_fields(support: SupportFile, folder: Path) -> dict[str, Any]:
    """Return the fields of a stock for a kind of support that Tandem designs, or for given shapes."""
    if isinstance(support, str):
        return {"support": (), "pedestal": TABLE if support == "table" else PEDESTAL}
    return {"support": tuple(cell_file.build_shape(s, folder) for s in support), "pedestal": None}


def _oversize_array(sides: tuple[Sides, Sides, Sides]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the oversize (2, 3) [m]: below and above, along x, y and z."""
    return np.array(sides, dtype=np.float64).T * MM


def _read_foam(spec: str | FoamReference | None, folder: Path) -> FoamMaterial | None:
    """Return the foam of a file, or of the table by its name; None if none is stated."""
    if isinstance(spec, FoamReference):
        return material_file.read_foam(folder / spec.file)
    if spec is None:
        return None
    try:
        return foam(spec)
    except TandemError as error:
        raise TandemError([dataclasses.replace(i, field="stock.foam") for i in error.issues]) from None


def _unknown_arm_issue(field: str, name: str, arms_by_name: Mapping[str, Arm]) -> Issue:
    message = f"{field}: '{name}' is not an arm of the cell; it has {', '.join(arms_by_name)}"
    return Issue("problem.unknown_arm", message, field=field)
