"""The cell of a problem file: schema in mm and degrees, and conversion to values in SI units."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, Tag

from planner import tooling
from planner.catalogue.robots import JointStiffness, RobotData, robot, robot_names
from planner.geometry.arrays import FloatArray, Shape, from_rpy
from planner.geometry.mesh_files import read_mesh
from planner.geometry.units import DEG, LENGTH_UNITS, MM, measurement
from planner.issues import Issue, TandemError, issue_error
from planner.problem import Arm, Cell, Obstacle, SagCompensation
from planner.reading import rail_axes, rotary_axes
from planner.reading.controller import ControllerFile, build_controller
from planner.reading.materials import WiresFile, available_wires
from planner.reading.robot_file import OwnRobotFile, Posture, build_robot, posture_fault
from planner.reading.strict_yaml import Angle, FileName, Name, Positive, Strict, Unit, Vector, WordOrMapping
from planner.runtime import plugins
from planner.runtime.plugins import Language

DriveStiffness = Annotated[float, Field(ge=1e3, le=1e9)]
"""Stiffness of a drive [N m/rad]. Chosen: below are small toys or other units, above no robots."""


class PoseFile(Strict):
    """A pose: position and roll, pitch, yaw about fixed x, then y, then z."""

    xyz_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)

    def to_matrix(self) -> FloatArray:
        """Return the pose as (4, 4) in metres."""
        return from_rpy(np.array(self.xyz_mm) * MM, np.array(self.rpy_deg) * DEG)


class BoxFile(Strict):
    """A box centred on its pose."""

    kind: Literal["box"]
    size_mm: tuple[Positive, Positive, Positive]
    pose: PoseFile = PoseFile()


class RoundFile(Strict):
    """A cylinder or capsule along z, centred on its pose."""

    kind: Literal["cylinder", "capsule"]
    radius_mm: Positive
    length_mm: Positive
    pose: PoseFile = PoseFile()


class SphereFile(Strict):
    """A sphere."""

    kind: Literal["sphere"]
    radius_mm: Positive
    pose: PoseFile = PoseFile()


class MeshFile(Strict):
    """A mesh file in a stated unit. Collision checks use its convex hull."""

    kind: Literal["mesh"]
    file: FileName
    unit: Unit
    pose: PoseFile = PoseFile()


ShapeFile = Annotated[BoxFile | RoundFile | SphereFile | MeshFile, Field(discriminator="kind")]


class WireHolderFile(Strict):
    """The built-in wire holder with a sliding clamp."""

    kind: Literal["wire_holder"]
    mounting: Literal["along", "across", "diagonal"] = "across"
    side: Literal["start", "end"]


class BowFile(Strict):
    """The built-in bow with a straight hot wire; 400 x 400 mm and 650 x 650 mm are common sizes."""

    kind: Literal["bow"]
    span_mm: float = Field(
        default=tooling.BOW_SPAN / MM, ge=50, le=3000, description="wire between its clamps"
    )
    throat_mm: float = Field(
        default=tooling.BOW_THROAT / MM, ge=50, le=3000, description="from the beam to the wire"
    )
    wire_diameter_mm: float = Field(default=tooling.BOW_WIRE_DIAMETER / MM, ge=0.01, le=10)
    tilt_deg: float = Field(default=0.0, ge=-90, le=90, description="of the bow about its wire")


class _GripperFile(Strict):
    """Keys of all tools that hold a block."""

    name: Name | None = Field(default=None, description="display name; none: by its kind")
    reach_mm: float = Field(
        default=tooling.GRIPPER_REACH / MM, ge=30, le=500, description="from the flange to the block"
    )
    holding_n: float | None = Field(
        default=None, gt=0, le=100_000, description="force that it holds with; none: by its area"
    )


class GripperPlateFile(_GripperFile):
    """The built-in plate with needles that holds a block by its bottom face."""

    kind: Literal["gripper_plate"]
    width_mm: float = Field(default=160.0, ge=20, le=2000)
    depth_mm: float = Field(default=160.0, ge=20, le=2000)


class VacuumCupFile(_GripperFile):
    """The built-in vacuum cup that holds a block by its bottom face."""

    kind: Literal["vacuum_cup"]
    radius_mm: float = Field(default=60.0, ge=10, le=500)


class BallToolFile(Strict):
    """The built-in ball tool for sheets, on a shaft of the ball's or another radius.

    Its TCP is the centre of the ball.
    """

    kind: Literal["ball_tool"]
    radius_mm: float = Field(default=9.525, ge=0.5, le=100)
    length_mm: float = Field(
        default=300.0, ge=110, le=1500, description="from the flange to the ball's centre"
    )
    shaft_radius_mm: float | None = Field(default=None, ge=0.5, le=100, description="none: that of the ball")
    neck_mm: float = Field(
        default=0.0, ge=0, le=500, description="from the ball's centre to a shaft of another radius"
    )
    tilt_deg: float = Field(default=0.0, ge=-90, le=90, description="of the tool against the flange's axis")


class DiskToolFile(Strict):
    """The built-in flat disk that supports the border of a part while it is formed.

    Its TCP is the centre of its face.
    """

    kind: Literal["disk_tool"]
    radius_mm: float = Field(default=25.4, ge=2, le=200)
    thickness_mm: float = Field(default=12.0, ge=1, le=100)
    rim_mm: float = Field(default=tooling.DISK_RIM_M / MM, ge=0, le=50, description="rounding of its edge")
    shaft_radius_mm: float = Field(default=9.525, ge=0.5, le=200)
    length_mm: float = Field(default=300.0, ge=110, le=1500, description="from the flange to the face")


class HeatToolFile(Strict):
    """The built-in heat gun or laser head. Its TCP is the heated spot."""

    kind: Literal["heat_tool"]
    radius_mm: float = Field(default=25.0, ge=1, le=200)
    length_mm: float = Field(default=250.0, ge=110, le=1500, description="from the flange to the nozzle")
    standoff_mm: float = Field(default=40.0, ge=1, le=1000, description="from the nozzle to the TCP")


class HolderPieceFile(Strict):
    """A piece of a milling tool's holder, a cylinder."""

    length_mm: float = Field(ge=1, le=1000)
    diameter_mm: float = Field(ge=1, le=1000)


class MillFile(Strict):
    """The built-in milling tool: cutter, holder and spindle.

    Its TCP is the tip of the cutter, on its axis.
    """

    kind: Literal["mill"]
    cutter: Literal["cylinder", "ball", "bull"] = "cylinder"
    diameter_mm: float = Field(ge=0.1, le=200)
    corner_mm: float = Field(default=0.0, ge=0, le=100, description="radius of the corners of a bull nose")
    flute_mm: float = Field(ge=0.1, le=500, description="cutting length from the tip")
    overhang_mm: float = Field(ge=1, le=800, description="from the nose of the holder to the tip")
    shank_diameter_mm: float | None = Field(
        default=None, ge=0.1, le=200, description="none: that of the cutter"
    )
    holder: tuple[HolderPieceFile, ...] = Field(
        default=tuple(
            HolderPieceFile(length_mm=length / MM, diameter_mm=2.0 * radius / MM)
            for length, radius in tooling.MILL_HOLDER
        ),
        min_length=1,
        max_length=20,
        description="its pieces from the nose to the spindle",
    )
    spindle_diameter_mm: float = Field(default=2.0 * tooling.MILL_SPINDLE[0] / MM, ge=10, le=600)
    spindle_length_mm: float = Field(default=tooling.MILL_SPINDLE[1] / MM, ge=10, le=1500)
    tilt_deg: float = Field(
        default=0.0, ge=-135, le=135, description="of the spindle against the flange's axis"
    )
    mass_kg: float | None = Field(
        default=None, ge=0.001, le=1000, description="of the whole tool; none: by its volume"
    )


class TorchFile(Strict):
    """The built-in torch: a body with a conical nozzle.

    Its TCP is the point of the cut, ``standoff_mm`` from the nozzle. The cut is a slot of ``kerf_mm``.
    """

    kind: Literal["torch"]
    cuts_by: Literal["plasma", "laser", "waterjet"] = Field(description="what the torch cuts with")
    standoff_mm: float = Field(default=3.0, ge=0.2, le=100, description="from the nozzle to the sheet")
    kerf_mm: float = Field(ge=0.05, le=20, description="width of the slot in this sheet")
    nozzle_diameter_mm: float = Field(
        default=2.0 * tooling.TORCH_SIZE[0] / MM, ge=1, le=200, description="of the nozzle's end"
    )
    nozzle_length_mm: float = Field(
        default=tooling.TORCH_SIZE[1] / MM, ge=1, le=500, description="of the cone from its end to the body"
    )
    body_diameter_mm: float = Field(default=2.0 * tooling.TORCH_SIZE[2] / MM, ge=5, le=400)
    length_mm: float = Field(
        default=tooling.TORCH_SIZE[3] / MM, ge=110, le=1500, description="from the flange to the nozzle's end"
    )
    tilt_deg: float = Field(
        default=0.0, ge=-135, le=135, description="of the torch against the flange's axis"
    )
    mass_kg: float | None = Field(
        default=None, ge=0.001, le=1000, description="with cable and hoses; none: by its volume"
    )


class KnifeFile(Strict):
    """The built-in knife: a blade in a round body.

    The blade has a straight end, from whose front its edge rises forward. The TCP is the front of that end, x
    is the cutting direction, z points out of the tool. For an oscillating blade, the TCP is at its lowest
    position.
    """

    kind: Literal["knife"]
    thickness_mm: float = Field(default=0.6, ge=0.05, le=10, description="of the blade")
    width_mm: float = Field(ge=0.2, le=100, description="of the blade, from its back to its edge")
    end_mm: float = Field(
        default=0.0, ge=0, le=100, description="of its straight end; none, 0: a point at its back"
    )
    ground_mm: float = Field(
        ge=0, le=200, description="height over which its edge rises from the end to its full width"
    )
    blade_mm: float = Field(ge=1, le=300, description="of the blade out of its body")
    body_diameter_mm: float = Field(default=2.0 * tooling.KNIFE_BODY[0] / MM, ge=5, le=400)
    length_mm: float = Field(
        default=tooling.KNIFE_BODY[1] / MM, ge=75, le=1500, description="from the flange to the tip"
    )
    turn_deg: float = Field(
        default=0.0, ge=-180, le=180, description="of its edge about the tool's axis, from the flange's x"
    )
    tilt_deg: float = Field(default=0.0, ge=-135, le=135, description="against the flange's axis")
    mass_kg: float | None = Field(
        default=None, ge=0.001, le=1000, description="with cable and hoses; none: by its volume"
    )


class PlainToolFile(Strict):
    """Any tool: TCP and shapes in the flange frame, mass, centre of gravity."""

    kind: Literal["plain"]
    tcp: PoseFile
    mass_kg: float = Field(ge=0.001, le=1000)
    cog_mm: Vector = (0.0, 0.0, 50.0)
    shapes: tuple[ShapeFile, ...] = ()


ToolFile = Annotated[
    WireHolderFile
    | BowFile
    | GripperPlateFile
    | VacuumCupFile
    | BallToolFile
    | DiskToolFile
    | HeatToolFile
    | MillFile
    | TorchFile
    | KnifeFile
    | PlainToolFile,
    Field(discriminator="kind"),
]


class StiffnessFile(Strict):
    """Stiffness of the drives as identified on this individual robot, with rigid links."""

    joints_nm_rad: tuple[
        DriveStiffness, DriveStiffness, DriveStiffness, DriveStiffness, DriveStiffness, DriveStiffness
    ] = Field(description="of axes 1 to 6, N m/rad, as the controller counts them")
    source: str = Field(min_length=3, max_length=300, description="who identified it, where and how")

    def to_stiffness(self) -> JointStiffness:
        """Convert to SI units."""
        return JointStiffness(np.array(self.joints_nm_rad, dtype=np.float64), self.source)


class SagFile(Strict):
    """Targets are commanded so that the sagged arm reaches the nominal pose."""

    load: bool = Field(
        default=True, description="include the weight of the tool; false if the controller compensates for it"
    )
    most_mm: float = Field(default=5.0, ge=0.01, le=20, description="largest shift of a target")

    def to_compensation(self) -> SagCompensation:
        """Convert to SI units."""
        return SagCompensation(self.load, self.most_mm * MM)


class ArmFile(Strict):
    """One robot: catalogue name, base, tool, home joints as the controller shows them."""

    name: Name
    robot: Annotated[
        Annotated[str, Tag("word")] | Annotated[OwnRobotFile, Tag("mapping")],
        WordOrMapping,
        Field(description="a built-in one (`tandem robots`), or a custom one"),
    ]
    base: PoseFile = PoseFile()
    base_auto: bool = False
    tool: ToolFile
    home_deg: Posture | None = Field(
        default=None,
        description="joints at home, one for each axis; none: the upper arm upright, the forearm level",
    )
    stiffness: StiffnessFile | None = Field(
        default=None, description="none: from the catalogue, which has none for most robots"
    )
    compensate_sag: SagFile | None = Field(
        default=None, description="none: targets are commanded without correction"
    )
    track: rail_axes.TrackFile | None = Field(
        default=None, description="none: the base is fixed; `base` is stated at value 0"
    )
    axes: tuple[rail_axes.GantryAxisFile, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=3,
        description="instead of a track: axes of a gantry, from the floor up; `base` is stated at values 0",
    )


class ObstacleFile(Strict):
    """A fixed body: its shapes are placed in the world."""

    name: Name
    shapes: list[ShapeFile] = Field(min_length=1)


RackFile = Annotated[
    tuple[Annotated[GripperPlateFile | VacuumCupFile, Field(discriminator="kind")], ...],
    Field(max_length=40, description="available grippers; one is chosen for a held block"),
]


class CellFile(Strict):
    """A robot cell."""

    name: str = "cell"
    arms: list[ArmFile] = Field(min_length=1, max_length=2)
    obstacles: tuple[ObstacleFile, ...] = ()
    grippers: RackFile = ()
    wires: tuple[WiresFile, ...] | None = Field(
        default=None, min_length=1, max_length=50, description="available bent wires, of which one is chosen"
    )
    turntable: rotary_axes.TurntableFile | None = Field(
        default=None, description="none: the block stands still"
    )
    positioner: rotary_axes.PositionerFile | None = Field(
        default=None, description="instead of a turntable: one with a tilt axis"
    )
    controller: ControllerFile = ControllerFile.model_validate({})


def build_cell(spec: CellFile, folder: Path) -> Cell:
    """Convert a cell to SI units.

    Args:
        spec: Cell of the file.
        folder: Folder to which names of mesh files are relative.

    Raises:
        TandemError: With the faults of robots, tools, meshes, controllers and axes.
    """
    arms = []
    for number, arm in enumerate(spec.arms):
        try:
            data = _read_robot(arm.robot, folder)
        except TandemError as error:
            field = f"arms.{number}.robot"
            issues = [
                dataclasses.replace(issue, field=f"{field}.{issue.field}" if issue.field else field)
                for issue in error.issues
            ]
            raise TandemError(issues) from error
        if arm.home_deg is not None and (fault := posture_fault(arm.home_deg, data.axes)):
            text = f"home_deg: {fault}"
            raise issue_error("problem.field", text, field=f"arms.{number}.home_deg", arm=arm.name)
        home = data.home if arm.home_deg is None else data.from_controller(np.array(arm.home_deg) * DEG)
        if float(data.limit_margin(home)) < 0.0:
            raise TandemError(_home_outside_limits_issue(arm, number, data))
        mounted = build_tool(arm.tool, folder)
        if mounted.mass > data.payload:
            raise TandemError(tool_too_heavy_issue(arm.name, f"arms.{number}.tool", mounted, data))
        if arm.stiffness is not None and data.axes != 6:
            text = f"stiffness: has six axes, but {data.title} has {data.axes}; remove it"
            raise issue_error("problem.field", text, field=f"arms.{number}.stiffness", arm=arm.name)
        stiffness = data.stiffness if arm.stiffness is None else arm.stiffness.to_stiffness()
        sag = None if arm.compensate_sag is None else arm.compensate_sag.to_compensation()
        if sag is not None and stiffness is None:
            raise TandemError(_unknown_stiffness_issue(arm, number))
        built_arm = Arm(
            arm.name, data.name, arm.base.to_matrix(), mounted, home, arm.base_auto, stiffness, sag
        )
        if spec.controller.language != "own":
            family = _language_family(spec.controller.language, arm, number)
            built_arm = dataclasses.replace(built_arm, custom_data=dataclasses.replace(data, family=family))
        elif data.file is not None:
            built_arm = dataclasses.replace(built_arm, custom_data=data)
        linear_axes = rail_axes.build_linear_axes(
            arm.track, arm.axes, built_arm, number, [body.name for body in spec.obstacles]
        )
        arms.append(dataclasses.replace(built_arm, linear_axes=linear_axes))
    _refuse_duplicate_robots(arms)
    obstacles = tuple(
        Obstacle(item.name, tuple(build_shape(s, folder) for s in item.shapes)) for item in spec.obstacles
    )
    controller = build_controller(spec.controller, [arm.name for arm in spec.arms])
    rail_axes.check_units(arms, controller)
    wires = tuple(wire.to_wire() for wire in available_wires(spec.wires or ()))
    if spec.turntable is not None and spec.positioner is not None:
        text = "got a turntable and a positioner; state only the one under the block"
        raise issue_error("problem.field", text, field="positioner")
    table_spec = spec.turntable if spec.positioner is None else spec.positioner
    table, plate = rotary_axes.build_turntable(
        table_spec, arms, controller, [body.name for body in obstacles]
    )
    return Cell(spec.name, tuple(arms), (*obstacles, *plate), controller, _build_grippers(spec), wires, table)


def _language_family(word: str, arm: ArmFile, number: int) -> str:
    """Return the controller family that ``controller: {language: ...}`` states.

    Raises:
        TandemError: ``problem.field`` if the arm is on a track or gantry, which such programs do not support.
    """
    language = None if word == "ros" else plugins.usable(Language)[word]
    title = "trajectories" if language is None else language.title
    for field, stated in (("track", arm.track), ("axes", arm.axes)):
        if stated is not None:
            message = f"{field} of arm {arm.name}: {title} (controller: {{language: {word}}}) support only "
            message += "fixed arms; remove it, or use the arm's own language"
            raise issue_error("problem.field", message, field=f"arms.{number}.{field}", arm=arm.name)
    return "ROS" if language is None else language.families[0]


def _read_robot(spec: str | OwnRobotFile, folder: Path) -> RobotData:
    """Return the robot of the catalogue with a name, or a custom one with files relative to ``folder``."""
    if isinstance(spec, str):
        return robot(spec)
    if spec.name in robot_names():
        message = f"name: {spec.name!r} is a built-in robot; give your robot another name"
        raise issue_error("problem.duplicate_name", message, field="name")
    return build_robot(spec, folder)


def _refuse_duplicate_robots(arms: list[Arm]) -> None:
    """Refuse two different robots with the same name."""
    first_by_name: dict[str, RobotData] = {}
    for number, arm in enumerate(arms):
        if arm.custom_data is None or arm.custom_data.file is None:
            continue
        other = first_by_name.setdefault(arm.robot, arm.custom_data)
        if _robot_identity(other) != _robot_identity(arm.custom_data):
            text = f"name: {arm.robot!r} is a different robot in another arm of the cell; rename one"
            raise issue_error("problem.duplicate_name", text, field=f"arms.{number}.robot.name", arm=arm.name)


def _robot_identity(robot: RobotData) -> tuple[object, ...]:
    """Return what identifies a custom robot, for comparison."""
    file, coupling = robot.file, robot.coupling
    links = () if file is None else (file.text, file.base, file.tip)
    acceleration, home = robot.acceleration.tolist(), robot.home.tolist()
    return *links, robot.family, robot.payload, robot.assumed, coupling, acceleration, home


def _build_grippers(spec: CellFile) -> tuple[tooling.Gripper, ...]:
    """Create the available grippers, each with a unique name."""
    out: list[tooling.Gripper] = []
    for number, gripper in enumerate(spec.grippers):
        is_plate = isinstance(gripper, GripperPlateFile)
        size = (
            f"{gripper.width_mm:g}x{gripper.depth_mm:g}"
            if isinstance(gripper, GripperPlateFile)
            else f"{2 * gripper.radius_mm:g}"
        )
        default_name = f"{'plate' if is_plate else 'cup'}_{size}".replace(".", "_")
        named = gripper.model_copy(update={"name": gripper.name or default_name})
        try:
            built = build_tool(named, Path())
        except ValueError as error:
            raise issue_error(
                "problem.field", f"grippers.{number}: {error}", field=f"grippers.{number}"
            ) from error
        if built.name.lower() in [other.name.lower() for other in out]:
            message = f"grippers.{number}: the name '{built.name}' is given more than once; rename one"
            raise issue_error("problem.duplicate_name", message, field=f"grippers.{number}")
        out += [built] if isinstance(built, tooling.Gripper) else []
    return tuple(out)


def build_shape(spec: ShapeFile, folder: Path) -> Shape:
    """Convert one shape to SI units; names of mesh files are relative to ``folder``."""
    pose = spec.pose.to_matrix()
    if isinstance(spec, BoxFile):
        return Shape("box", tuple(v * MM for v in spec.size_mm), pose)
    if isinstance(spec, RoundFile):
        return Shape(spec.kind, (spec.radius_mm * MM, spec.length_mm * MM), pose)
    if isinstance(spec, SphereFile):
        return Shape("sphere", (spec.radius_mm * MM,), pose)
    mesh = read_mesh(folder / spec.file, LENGTH_UNITS[spec.unit])
    return Shape("mesh", (), pose, mesh.vertices, mesh.faces)


def build_tool(spec: ToolFile, folder: Path) -> tooling.Tool:
    """Convert one tool to SI units.

    Raises:
        TandemError: ``problem.field`` if the sizes of a working tool are inconsistent.
        ValueError: If the sizes of a bow or gripper are inconsistent.
    """
    if isinstance(spec, WireHolderFile):
        return tooling.wire_holder(spec.mounting, spec.side)
    if isinstance(spec, BowFile):
        size = spec.span_mm * MM, spec.throat_mm * MM
        return tooling.bow(*size, spec.wire_diameter_mm * MM, spec.tilt_deg * DEG)
    if isinstance(spec, GripperPlateFile):
        size = spec.width_mm * MM, spec.depth_mm * MM
        return tooling.gripper_plate(*size, spec.reach_mm * MM, spec.holding_n, spec.name)
    if isinstance(spec, VacuumCupFile):
        return tooling.vacuum_cup(spec.radius_mm * MM, spec.reach_mm * MM, spec.holding_n, spec.name)
    if isinstance(spec, PlainToolFile):
        shapes = tuple(build_shape(s, folder) for s in spec.shapes)
        return tooling.plain_tool(
            "plain", spec.tcp.to_matrix(), shapes, spec.mass_kg, np.array(spec.cog_mm) * MM
        )
    try:
        return _build_working_tool(spec)
    except ValueError as error:
        raise issue_error("problem.field", f"tool: {error}", field="tool") from error


def _build_working_tool(
    spec: BallToolFile | DiskToolFile | HeatToolFile | MillFile | TorchFile | KnifeFile,
) -> tooling.Tool:
    """Create a tool that forms, mills or trims. Raises ``ValueError`` if its sizes are inconsistent."""
    if isinstance(spec, MillFile):
        geometry = tooling.CutterGeometry(
            spec.cutter,
            0.5 * spec.diameter_mm * MM,
            spec.corner_mm * MM,
            spec.flute_mm * MM,
            spec.overhang_mm * MM,
            None if spec.shank_diameter_mm is None else 0.5 * spec.shank_diameter_mm * MM,
        )
        return tooling.mill(
            geometry,
            [(piece.length_mm * MM, 0.5 * piece.diameter_mm * MM) for piece in spec.holder],
            (0.5 * spec.spindle_diameter_mm * MM, spec.spindle_length_mm * MM),
            spec.tilt_deg * DEG,
            spec.mass_kg,
        )
    if isinstance(spec, TorchFile):
        nozzle = 0.5 * spec.nozzle_diameter_mm * MM, spec.nozzle_length_mm * MM
        body = 0.5 * spec.body_diameter_mm * MM, spec.length_mm * MM
        cut = spec.standoff_mm * MM, spec.kerf_mm * MM
        return tooling.torch(spec.cuts_by, *cut, (*nozzle, *body), spec.tilt_deg * DEG, spec.mass_kg)
    if isinstance(spec, KnifeFile):
        sizes = (spec.thickness_mm, spec.width_mm, spec.end_mm, spec.ground_mm, spec.blade_mm)
        blade = tooling.Blade(*(size * MM for size in sizes))
        body = 0.5 * spec.body_diameter_mm * MM, spec.length_mm * MM
        return tooling.knife(blade, body, spec.turn_deg * DEG, spec.tilt_deg * DEG, spec.mass_kg)
    radius, length = spec.radius_mm * MM, spec.length_mm * MM
    if isinstance(spec, HeatToolFile):
        return tooling.heat_tool(radius, length, spec.standoff_mm * MM)
    if isinstance(spec, DiskToolFile):
        shaft = spec.thickness_mm * MM, spec.shaft_radius_mm * MM
        return tooling.disk_tool(radius, length, *shaft, spec.rim_mm * MM)
    shaft_radius = None if spec.shaft_radius_mm is None else spec.shaft_radius_mm * MM
    return tooling.ball_tool(radius, length, shaft_radius, spec.neck_mm * MM, spec.tilt_deg * DEG)


def _unknown_stiffness_issue(arm: ArmFile, number: int) -> Issue:
    message = f"arm {arm.name}: the stiffness of its robot is unknown, so its sag cannot be computed"
    hint = "state stiffness: {joints_nm_rad: [...], source: ...} as identified, or remove compensate_sag"
    return Issue("problem.field", f"{message}; {hint}", field=f"arms.{number}.compensate_sag", arm=arm.name)


def _home_outside_limits_issue(arm: ArmFile, number: int, data: RobotData) -> Issue:
    limits = ", ".join(
        f"{low:.0f} to {high:.0f}" for low, high in np.stack([data.lower, data.upper], axis=1) / DEG
    )
    got = ", ".join(f"{angle:g}" for angle in arm.home_deg or ())
    message = f"home_deg is [{got}], outside the limits of {data.title}: its joints, counted without the "
    message += f"parallel rod, range over {limits} deg; correct it"
    return Issue("problem.field", message, field=f"arms.{number}.home_deg", arm=arm.name)


def tool_too_heavy_issue(arm: str, field: str, tool: tooling.Tool, data: RobotData) -> Issue:
    """Return the issue of a tool that exceeds the payload of the robot ``data``."""
    message = f"the tool weighs {tool.mass:g} kg, but {data.title} carries {data.payload:g} kg; use a larger "
    message += "robot or a lighter tool"
    return Issue("problem.field", message, field=field, arm=arm, **measurement(tool.mass, data.payload, "kg"))
