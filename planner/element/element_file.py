"""The element file: a surface, its division into panels, available blocks, and jobs for the panels.

Lengths are in mm. Faces are described as those of a part (`reading/part_surfaces.py`), wires as those of a
cell.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args

import numpy as np
from pydantic import Field, ValidationError, model_validator

from planner.catalogue.materials import foam
from planner.element import stock_list
from planner.element.elastic import ElasticRules
from planner.element.panel_faces import CutWire
from planner.element.stock_list import Offcut
from planner.element.surface import ElementSurface, seam_issues, surface_axes, to_element_frame
from planner.geometry.arrays import FloatArray
from planner.geometry.cut_tree import BowSize
from planner.geometry.face_offset import Rim
from planner.geometry.mesh import TriangleMesh
from planner.geometry.planar_panels import MAX_COUNT, MIN_COUNT, Shape
from planner.geometry.ruled_approximation import Patch
from planner.geometry.ruled_wall import RuledWall, build_wall
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, issue_error
from planner.processes.hotwire.plan import wire as hot_wires
from planner.processes.hotwire.plan.operation import Straight
from planner.reading import strict_yaml
from planner.reading.cell import BowFile, RackFile
from planner.reading.materials import WireFile, WiresFile, available_wires
from planner.reading.part_ruled import RuledFile, build_ruled
from planner.reading.part_surfaces import FrontFile, build_patch, build_surface, check_size
from planner.reading.problem import SettingsFile, resolve_files, validate
from planner.reading.strict_yaml import Coordinate, FileName, Positive, Strict, Vector

MAX_LENGTH_M: Final = 200.0
"""Maximum length [m] of a surface to divide. A longer one is in a wrong unit."""
MAX_WIRE_RATIO: Final = 5.0
"""Maximum ratio of wire length to the length of the element.

A longer wire is not meant for it, or the element is in another unit: an inch read as a millimetre is 25 times
too small.
"""
MAX_CELLS: Final = 48
"""Maximum number of cells of a grid along one side. The division considers all rectangles of the grid."""
DEFAULT_CELLS: Final = 24
"""Default number of cells along the longer side."""
END_ERROR_FRACTION: Final = 0.6
"""Maximum displacement of a wire by errors of its ends, as a fraction of the tolerance."""
DEFAULT_FOAM_MM: Final = {
    "elastic": (2.0, 14.0),
    "hexagons": (10.0, 0.0),
    "boxes": (4.0, 4.0),
    "puzzle": (4.0, 4.0),
    "strips": (4.0, 4.0),
}
"""Default foam [mm] for each kind of panels: beside them, and above and below them.

14 mm for elastic panels: with 12 mm, wires came to 9.95 mm of pedestals (measured), but have to keep 10 mm.
"""
MIN_FOAM_MM: Final = 3.0
"""Minimum foam [mm] around panels of walls and strips, into which their surfaces are extended."""
NODE_STEP_M: Final = 0.02
"""Maximum distance [m] of the rulings that represent a wall."""
CLOSED_TOLERANCE_M: Final = 1e-3
"""Maximum distance [m] between the ends of a closed wall."""
ElementName = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,17}$", description="letter first, at most 18 characters")
]
MIN_TOLERANCE_MM: Final = 0.05
"""Minimum tolerance [mm] of elastic panels."""


class PlaneFile(Strict):
    """The plane over which the surface lies: its normal, and the direction of one side of the rectangle."""

    normal: Vector
    along: Vector


class ElementSurfaceFile(FrontFile):
    """The front of the element, as that of a part: its normals point away from the element.

    For a wall it is ``ruled``, as a surface of ``part.ruled``.
    """

    ruled: RuledFile | None = None
    plane: PlaneFile | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> "ElementSurfaceFile":
        if [self.loft, self.mesh, self.rhino, self.step, self.ruled].count(None) != 4:
            raise ValueError("give one of loft, mesh, rhino, step and ruled")
        if self.ruled is not None and self.plane is not None:
            raise ValueError("plane: a ruled wall is always divided along its rulings; remove it")
        return self


class ElasticFile(Strict):
    """Panels whose faces a bent wire cuts."""

    tolerance_mm: float = Field(ge=MIN_TOLERANCE_MM, le=50, description="of panels to the surface")
    joint_mm: float = Field(
        default=0.2, ge=0.01, le=50, description="step between neighbours at 95 % of a joint's points"
    )
    cells: (
        tuple[Annotated[int, Field(ge=1, le=MAX_CELLS)], Annotated[int, Field(ge=1, le=MAX_CELLS)]] | None
    ) = Field(default=None, description="between which cut lines may lie; none: 24 along the longer side")
    ends_mm: float = Field(
        default=80.0, ge=5, le=1000, description="of the wire outside the panel, at each end"
    )
    end_error_mm: float = Field(
        default=0.05, ge=0, le=5, description="position error of each wire end in reality"
    )
    end_weight: float = Field(
        default=100.0, ge=1, le=1000, description="weight of the ends of sections in the fit"
    )
    check: Literal["none", "held", "wire", "all"] = Field(
        default="none",
        description="panels are rejected in which no wire is held safely, whose job refuses the wire, "
        "or that any part of tandem check refuses",
    )


class HexagonsFile(Strict):
    """Thick planar panels that a straight wire cuts out of held blocks."""

    count: int = Field(ge=MIN_COUNT, le=MAX_COUNT, description="of panels")
    shape: Shape = Field(
        default="hexagon",
        description="most panels have six sides, or four, in rows along conjugate directions: then the "
        "count is the nearest that such rows allow",
    )
    least_edge_mm: float = Field(default=50.0, ge=1, le=1000, description="of either face")
    least_width_mm: float = Field(default=100.0, ge=0, le=2000, description="of either face, across")
    off_surface_mm: float = Field(default=30.0, gt=0, le=1000, description="of fronts to the surface")
    rim: Rim = Field(default="square", description="rim sides: perpendicular to their panels, or upright")
    ground_mm: Coordinate | None = Field(
        default=None, description="height of the ground on which a rim stands, with a level side there"
    )


class BoxesFile(Strict):
    """Panels of a ruled wall with four sides, in strips along it."""

    least_height_mm: float = Field(default=100.0, ge=20, le=2000, description="of panels, along the wall")


class PuzzleFile(Strict):
    """Panels of a ruled wall in cells, with round lobes that hold them together."""

    lobe_mm: float = Field(ge=20, le=500, description="radius of lobes")
    cells: tuple[Annotated[int, Field(ge=1, le=100)], Annotated[int, Field(ge=1, le=100)]] | None = Field(
        default=None, description="across and along the wall; none: the fewest"
    )


class StripPanelsFile(Strict):
    """Panels of a free-form surface with ruled faces, in adjacent strips."""

    tolerance_mm: float = Field(ge=0.01, le=100, description="of fronts to the surface")
    least_width_mm: float = Field(default=60.0, ge=20, le=2000, description="of strips, in the mean")
    least_height_mm: float = Field(default=100.0, ge=20, le=2000, description="of panels, along their strip")


Kind = Literal["elastic", "hexagons", "boxes", "puzzle", "strips"]


class PanelsFile(Strict):
    """How the element is divided: exactly one kind of panels."""

    elastic: ElasticFile | None = None
    hexagons: HexagonsFile | None = None
    boxes: BoxesFile | None = None
    puzzle: PuzzleFile | None = None
    strips: StripPanelsFile | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "PanelsFile":
        if len(self._stated_kinds) != 1:
            raise ValueError(f"give exactly one kind of panels, {', '.join(get_args(Kind))}")
        return self

    @property
    def _stated_kinds(self) -> list[Kind]:
        return [kind for kind in get_args(Kind) if getattr(self, kind) is not None]

    @property
    def kind(self) -> Kind:
        """Kind of the panels."""
        return self._stated_kinds[0]


class GroupsFile(Strict):
    """How a shell is divided into groups for transport, and panels are numbered within each."""

    parts: int = Field(ge=1, le=26, description="number of groups of equal size")
    numbering: Literal["rows", "height", "ground"] = Field(
        default="rows", description="by rows, by height, or by the distance over the shell from its first row"
    )


class BlockFile(Strict):
    """A kind of available block: length, width, thickness."""

    size_mm: tuple[Positive, Positive, Positive]
    foam: Annotated[str, Field(max_length=60, description="name in the table of foams")] | None = None


Range = tuple[Annotated[float, Field(ge=0, le=100_000)], Annotated[float, Field(gt=0, le=100_000)]]


class WhenFile(Strict):
    """The panels that a job is for: ranges [from, below) of the block that a panel is cut from."""

    longest_mm: Range | None = Field(default=None, description="longer side in plan")
    shortest_mm: Range | None = Field(default=None, description="shorter side in plan")
    thickness_mm: Range | None = Field(default=None, description="height of the block")

    def matches(self, size: tuple[float, float, float]) -> bool:
        """Whether a block (x, y, z) [mm] is in all ranges."""
        sizes = {"longest_mm": max(size[:2]), "shortest_mm": min(size[:2]), "thickness_mm": size[2]}
        ranges = {name: getattr(self, name) for name in sizes}
        return all(r is None or r[0] <= sizes[name] < r[1] for name, r in ranges.items())


Rest = Annotated[FileName | dict[str, Any], Field(description="a file, or its content")]


class JobFile(Strict):
    """A template: the rest of a problem file for the panels that ``when`` selects; without it, for all.

    ``grippers`` are available in addition to those of its cell.
    """

    when: WhenFile = WhenFile()
    problem: Rest
    grippers: RackFile = ()


class SawBowFile(Strict):
    """The bow that cuts raw blocks apart."""

    span_mm: float = Field(ge=50, le=5000, description="wire between its clamps")
    throat_mm: float = Field(ge=50, le=5000, description="clear distance between wire and beam")


class RawBlocksFile(Strict):
    """Raw blocks from which the blocks of panels are cut, by through cuts."""

    sizes: tuple[BlockFile, ...] = Field(min_length=1, max_length=20)
    kerf_mm: float = Field(ge=0, le=50)
    oversize_mm: float = Field(
        default=0.0, ge=0, le=500, description="of a panel's block, along x and along y, to be trimmed"
    )
    grain: Literal["any", "along"] = Field(
        default="any", description="along: x of panels' blocks is along the first side of raw blocks"
    )
    keep_mm: float = Field(default=200.0, ge=10, le=5000, description="minimum side of offcuts that are kept")
    bow: SawBowFile | None = None
    stock: FileName | None = Field(default=None, description="list of offcuts")


class DowelsFile(Strict):
    """Dowels between neighbouring panels, along the insertion direction of the later one."""

    diameter_mm: float = Field(ge=2, le=100)
    depth_mm: float = Field(ge=5, le=1000, description="of the hole in either panel")
    count: int = Field(default=2, ge=1, le=6, description="in a joint, fewer if it is short")
    cover_mm: float = Field(
        default=20.0, ge=1, le=500, description="foam between a hole and faces, other sides and other holes"
    )
    lean_deg: float = Field(
        default=30.0, ge=0, le=60, description="maximum angle of a dowel to the normal of its joint"
    )


class CutBlocksFile(Strict):
    """How raw blocks are cut apart: a template, which is the rest of a problem file with a straight wire.

    Block, support and cuts are added for each piece.
    """

    problem: Rest
    stand_mm: float = Field(default=700.0, ge=50, le=2000, description="maximum height of supports of pieces")
    together: bool = Field(
        default=False,
        description="panels of a block are cut out of it together if its bow can: all faces in one "
        "pass, then around each of them",
    )


class ElementFile(Strict):
    """A whole element file, schema version 1."""

    element: Literal[1]
    name: ElementName
    surface: ElementSurfaceFile
    thickness_mm: float = Field(ge=1, le=2000)
    panels: PanelsFile
    wires: tuple[WiresFile, ...] | None = Field(
        default=None, min_length=1, max_length=20, description="of elastic panels"
    )
    blocks: tuple[BlockFile, ...] = Field(min_length=1, max_length=50)
    foam_sides_mm: float | None = Field(
        default=None,
        ge=0,
        le=500,
        description="foam of a block beside its panel, at each side; none: 2, hexagons 10, walls "
        "and strips 4",
    )
    foam_faces_mm: float | None = Field(
        default=None,
        ge=0,
        le=500,
        description="foam of a block above and below its panel; none: 14, walls and strips 4",
    )
    raw_blocks: RawBlocksFile | None = None
    groups: GroupsFile | None = Field(default=None, description="of hexagons")
    dowels: DowelsFile | None = None
    cut_blocks: CutBlocksFile | None = Field(default=None, description="problems of raw blocks")
    jobs: tuple[JobFile, ...] = Field(min_length=1, max_length=50)

    @model_validator(mode="after")
    def _of_one_kind(self) -> "ElementFile":
        kind = self.panels.kind
        if kind == "elastic" and self.wires is None:
            raise ValueError("wires: elastic panels are cut by bent wires; give at least one")
        if kind != "hexagons" and self.groups is not None:
            raise ValueError(f"groups: {kind} are numbered by position; remove groups")
        if kind == "puzzle" and self.dowels is not None:
            raise ValueError("dowels: lobes hold the pieces of a puzzle; remove dowels")
        if self.cut_blocks is not None and self.raw_blocks is None:
            raise ValueError("cut_blocks: requires raw_blocks; give both")
        wall = kind in ("boxes", "puzzle")
        if wall != (self.surface.ruled is not None):
            raise ValueError(
                f"surface: {kind} divide a {'ruled surface' if wall else 'loft or a mesh'}; give one"
            )
        strange = self.model_fields_set & ({"wires"} if kind != "elastic" else set())
        if kind == "hexagons":
            strange |= self.model_fields_set & {"foam_faces_mm"}
        if kind == "strips" and self.surface.plane is not None:
            raise ValueError("surface.plane: strips follow the surface in any pose; remove it")
        if strange:
            what = "out of blocks of their thickness" if kind == "hexagons" else "with its straight wire"
            raise ValueError(
                f"{' and '.join(sorted(strange))}: {kind} are cut by the bow of their cell {what}; remove "
                "these keys"
            )
        if (wall or kind == "strips") and min(self.sides, self.faces) < MIN_FOAM_MM * MM:
            raise ValueError(
                f"foam_sides_mm and foam_faces_mm: {kind} need at least {MIN_FOAM_MM:g} mm around them, "
                "more than half a slot"
            )
        return self

    @property
    def sides(self) -> float:
        """Foam of a block beside its panel [m]."""
        return (
            DEFAULT_FOAM_MM[self.panels.kind][0] if self.foam_sides_mm is None else self.foam_sides_mm
        ) * MM

    @property
    def faces(self) -> float:
        """Foam of a block above its panel, and below [m]."""
        return (
            DEFAULT_FOAM_MM[self.panels.kind][1] if self.foam_faces_mm is None else self.foam_faces_mm
        ) * MM


@dataclasses.dataclass(frozen=True)
class JobTemplate:
    """A job template.

    Attributes:
        when: Panels that it is for.
        file: Name of the template in messages: its file, or its field in the element file.
        data: Data as in a problem file, with its cell inlined and absolute file names.
    """

    when: WhenFile
    file: str
    data: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class SawTemplate(JobTemplate):
    """A template for raw blocks.

    Attributes:
        bow: Bow that its first arm mounts.
        margin: Minimum distance [m] of the foam from the ends of the wire and from the beam.
        clearance: Minimum clearance [m] between bodies, from its settings.
    """

    bow: BowSize
    margin: float
    clearance: float


@dataclasses.dataclass(frozen=True)
class Element:
    """An element file of any kind, with its templates.

    Attributes:
        file: Content of the file.
        templates: Job templates.
        stock: Offcuts of earlier elements.
        saw: Template for the problems of raw blocks; None if there are none.
        notes: Notes about the files that its surface was read from.
    """

    file: ElementFile
    templates: tuple[JobTemplate, ...]
    stock: tuple[Offcut, ...]
    saw: SawTemplate | None
    notes: tuple[Issue, ...] = dataclasses.field(default=(), kw_only=True)


@dataclasses.dataclass(frozen=True)
class ElasticElement(Element):
    """An element of elastic panels in SI units.

    Attributes:
        options: Options of the file.
        surface: Surface in the element frame.
        cells: Number of cells along x and y.
        rules: Requirements on panels.
        wires: Wires as the file states them, in the order of ``rules``.
    """

    options: ElasticFile
    surface: ElementSurface
    cells: tuple[int, int]
    rules: ElasticRules
    wires: tuple[WireFile, ...]

    @property
    def are_panels_checked(self) -> bool:
        """Whether the problems of panels are checked as they will be written."""
        return self.options.check in ("wire", "all")


@dataclasses.dataclass(frozen=True)
class HexagonElement(Element):
    """An element of planar panels.

    Attributes:
        options: Options of the file.
        surface: Surface [m] in the frame of the file, which is that of the element.
        view: Axes (3, 3) as columns: right, up, and toward a viewer in front.
    """

    options: HexagonsFile
    surface: TriangleMesh
    view: FloatArray


@dataclasses.dataclass(frozen=True)
class WallElement(Element):
    """A ruled wall in boxes or puzzle pieces.

    Attributes:
        options: Options of the file.
        wall: Wall [m] in the frame of the file, which is that of the element.
    """

    options: BoxesFile | PuzzleFile
    wall: RuledWall


@dataclasses.dataclass(frozen=True)
class StripsElement(Element):
    """A free-form surface in ruled strips.

    Attributes:
        options: Options of the file.
        patch: Surface [m] in the frame of the file, which is that of the element.
    """

    options: StripPanelsFile
    patch: Patch


def read_element(path: Path) -> ElasticElement | HexagonElement | WallElement | StripsElement:
    """Read an element file and the files that it names.

    Raises:
        TandemError: ``problem.field`` for each wrong field, with its line; issues of mesh files and guides;
            ``part.patch``; ``element.surface``; ``element.stock``; ``part.offset`` if the surface that is
            offset by the thickness folds over; ``element.jobs`` for templates that state what panels provide.
    """
    document = strict_yaml.read(path)
    spec, issues = validate(ElementFile, document.data, document, ())
    if spec is None:
        raise TandemError(issues)
    folder = path.parent
    wires: tuple[WireFile, ...] = ()
    templates: list[JobTemplate] = []
    try:
        wires = tuple(sorted(available_wires(spec.wires or ()), key=lambda w: w.length_mm))
    except TandemError as error:
        issues += error.issues
    raw = spec.raw_blocks
    blocks_by_field = [(f"blocks.{i}.foam", block) for i, block in enumerate(spec.blocks)]
    blocks_by_field += [
        (f"raw_blocks.sizes.{i}.foam", block) for i, block in enumerate(raw.sizes if raw else ())
    ]
    for field, block in blocks_by_field:
        try:
            if block.foam is not None:
                foam(block.foam)  # raises if it is unknown
        except TandemError as error:
            issues += [dataclasses.replace(i, field=field) for i in error.issues]
    stock: tuple[Offcut, ...] = ()
    try:
        stock = () if raw is None or raw.stock is None else stock_list.read_offcuts(folder / raw.stock)
    except TandemError as error:
        issues += error.issues
    for number, job in enumerate(spec.jobs):
        try:
            templates.append(_read_template(job, folder, f"jobs.{number}"))
        except TandemError as error:
            issues += error.issues
    saw: SawTemplate | None = None
    if spec.cut_blocks is not None and raw is not None:
        try:
            saw = _read_saw_template(spec.cut_blocks, raw.kerf_mm, folder)
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    wall_options = spec.panels.boxes or spec.panels.puzzle
    if wall_options is not None and spec.surface.ruled is not None:
        wall, notes = _read_wall(spec.surface.ruled, folder)
        return WallElement(spec, tuple(templates), stock, saw, wall_options, wall, notes=notes)
    strips = spec.panels.strips
    if strips is not None:
        patch, mesh_notes = build_patch(spec.surface, folder, "surface", MAX_LENGTH_M)
        return StripsElement(spec, tuple(templates), stock, saw, strips, patch, notes=tuple(mesh_notes))
    mesh, _, mesh_notes = build_surface(spec.surface, folder, "surface", MAX_LENGTH_M)
    check_size(mesh, "surface", MAX_LENGTH_M)
    plane = spec.surface.plane
    stated_axes = (None, None) if plane is None else (np.array(plane.normal), np.array(plane.along))
    elastic, hexagons = spec.panels.elastic, spec.panels.hexagons
    if hexagons is not None:
        view = surface_axes(mesh, *stated_axes)
        return HexagonElement(
            spec, tuple(templates), stock, saw, hexagons, mesh, view, notes=(*mesh_notes, *seam_issues(mesh))
        )
    if elastic is None:
        raise ValueError("panels of no kind")
    _require_wire_size(mesh, wires)
    element_surface = to_element_frame(mesh, spec.thickness_mm * MM, *stated_axes)
    cells = elastic.cells or _default_cells(element_surface)
    rules = _elastic_rules(spec, elastic, wires)
    return ElasticElement(
        spec,
        tuple(templates),
        stock,
        saw,
        elastic,
        element_surface,
        cells,
        rules,
        wires,
        notes=tuple(mesh_notes),
    )


def _read_wall(spec: RuledFile, folder: Path) -> tuple[RuledWall, tuple[Issue, ...]]:
    """Read a wall, and notes about its files. Raises ``element.surface`` if it is closed or has an edge."""
    ruled, notes = build_ruled(spec, folder, "surface.ruled")
    gap = np.linalg.norm([ruled.start[-1] - ruled.start[0], ruled.end[-1] - ruled.end[0]], axis=1).max()
    if ruled.closed or gap < CLOSED_TOLERANCE_M:
        raise _wall_error("the wall is closed: its last ruling equals its first one; give it in two halves")
    if ruled.corner[1:-1].any():
        k = 1 + int(np.argmax(ruled.corner[1:-1]))
        position = ", ".join(f"{v / MM:.0f}" for v in 0.5 * (ruled.start[k] + ruled.end[k]))
        raise _wall_error(
            f"the wall has an edge near ({position}) mm; give the parts on both sides as separate elements"
        )
    return build_wall(ruled, NODE_STEP_M), tuple(notes)


def _wall_error(message: str) -> TandemError:
    return issue_error("element.surface", message, field="surface.ruled")


def _elastic_rules(spec: ElementFile, elastic: ElasticFile, wires: tuple[WireFile, ...]) -> ElasticRules:
    """Convert the requirements on elastic panels to SI units."""
    return ElasticRules(
        tuple(
            CutWire(
                hot_wires.make_wire(w.material, w.diameter_mm, w.width_mm, w.thickness_mm, w.temperature_c),
                w.length_mm * MM,
                2.0 * elastic.ends_mm * MM,
                elastic.end_error_mm * MM,
                END_ERROR_FRACTION * elastic.tolerance_mm * MM,
            )
            for w in wires
        ),
        tuple(np.array(block.size_mm) * MM for block in spec.blocks),
        spec.sides,
        spec.faces,
        elastic.tolerance_mm * MM,
        elastic.end_weight,
        elastic.joint_mm * MM,
    )


def _require_wire_size(mesh: TriangleMesh, wires: tuple[WireFile, ...]) -> None:
    """Raise ``element.surface`` if all wires are much longer than the element: a unit is probably wrong."""
    size = np.ptp(mesh.vertices, axis=0)
    shortest, longest = min(wire.length_mm for wire in wires) * MM, float(size.max())
    if shortest <= MAX_WIRE_RATIO * longest:
        return
    text = " x ".join(f"{side / MM:.0f}" for side in size)
    raise issue_error(
        "element.surface",
        f"the surface is {text} mm, but the shortest wire is {shortest / MM:.0f} mm: more than "
        f"{MAX_WIRE_RATIO:g} times the length of the element",
        field="surface",
        **measurement(longest / MM, shortest / MAX_WIRE_RATIO / MM, "mm"),
        hint="state the correct unit of the file, or give a shorter wire",
    )


def _default_cells(surface: ElementSurface) -> tuple[int, int]:
    """Return the number of nearly square cells along x and y."""
    fraction = surface.size / surface.size.max()
    nx, ny = (max(1, int(np.round(DEFAULT_CELLS * f))) for f in fraction)
    return nx, ny


def _read_template(job: JobFile, folder: Path, field: str) -> JobTemplate:
    """Read a job template, and add its grippers to those of its cell."""
    name, _, data = _read_rest(job.problem, folder, field, ("size_mm",), "panel")
    rack = [gripper.model_dump(mode="json", exclude_none=True) for gripper in job.grippers]
    if rack and isinstance(data["cell"], dict):
        data["cell"] = {**data["cell"], "grippers": [*(data["cell"].get("grippers") or []), *rack]}
    return JobTemplate(job.when, name, data)


def _read_saw_template(cut: CutBlocksFile, kerf_mm: float, folder: Path) -> SawTemplate:
    """Read the template for raw blocks.

    The kerf [mm] of the nesting is written to its only operation: as ``kerf_mm``, or as the upper end of
    ``kerf_range_mm`` if the operation states its power.

    Raises:
        TandemError: ``element.jobs`` if it does not have exactly one such operation, or its arm has no bow.
    """
    stock = ("size_mm", "place", "roll_pitch_deg", "support", "oversize_mm", "held_by", "grip", "gripper")
    name, file, data = _read_rest(cut.problem, folder, "cut_blocks", stock, "piece of a block")
    operations = data["operations"]
    operation = operations[0] if len(operations) == 1 and isinstance(operations[0], dict) else {}
    provided = ("cuts", "kerf_mm", "kerf_range_mm")
    hint = "remove the others; state its power_w, or nothing about its slot"
    problem_text = f"must have one operation with the process straight_wire, without {', '.join(provided)}"
    if operation.get("process") == "straight_wire" and not any(key in operation for key in provided):
        bow = _mounted_bow(operation, data["cell"])
        if bow is not None:
            min_slot = min(Straight.model_fields["kerf_range_mm"].default[0], 0.5 * kerf_mm)
            slot = {"kerf_range_mm": [min_slot, kerf_mm]} if "power_w" in operation else {"kerf_mm": kerf_mm}
            margin = float(operation.get("margin_mm", Straight.model_fields["margin_mm"].default)) * MM
            settings = data.get("settings")
            stated_clearance = settings.get("clearance_mm") if isinstance(settings, dict) else None
            default = SettingsFile.model_fields["clearance_mm"].default
            clearance = float(stated_clearance if isinstance(stated_clearance, int | float) else default) * MM
            completed = {**data, "operations": [{**operation, **slot}]}
            return SawTemplate(WhenFile(), name, completed, bow, margin, clearance)
        problem_text, hint = "mounts no bow on the first of its arms", "give that arm a tool of the kind bow"
    raise issue_error("element.jobs", f"{name} {problem_text}", file=file, field="cut_blocks", hint=hint)


def _mounted_bow(operation: Mapping[str, Any], cell: object) -> BowSize | None:
    """Return the bow on the first arm of an operation; None if that arm has another tool or is unknown.

    The tool is that of the operation's setup, if stated, else that of the cell.
    """
    arms, setup = operation.get("arms"), operation.get("setup")
    name = arms[0] if isinstance(arms, list) and arms else None
    arms_of_cell = cell.get("arms") if isinstance(cell, dict) else None
    matching_arms = [arm for arm in arms_of_cell or () if isinstance(arm, dict) and arm.get("name") == name]
    setup_tools = setup.get("tools") if isinstance(setup, dict) else None
    tool = (setup_tools if isinstance(setup_tools, dict) else {}).get(
        name, matching_arms[0].get("tool") if matching_arms else None
    )
    try:
        bow = BowFile.model_validate(tool, strict=False)
    except ValidationError:
        return None
    return BowSize(bow.span_mm * MM, bow.throat_mm * MM)


def _read_rest(
    problem: str | Mapping[str, Any], folder: Path, field: str, of_stock: tuple[str, ...], who: str
) -> tuple[str, str | None, dict[str, Any]]:
    """Read a template: a problem file without its part and without some keys of its stock.

    ``problem`` is a file name relative to ``folder``, or the content. The keys ``of_stock`` must not be
    given, because they are added for each ``who``, a panel or piece. Raises ``element.jobs`` if they are
    given, or other keys are missing.

    Returns:
        Name for messages, path if it is a file, and data.
    """
    name, file = field, None
    template: Mapping[str, Any]
    if isinstance(problem, str):
        name, file = problem, str(folder / problem)
        folder, template = (folder / problem).parent, strict_yaml.read(folder / problem).data
    else:
        template = problem
    stock = template.get("stock") or {}
    provided = [key for key in ("part", "sheet") if key in template]
    if isinstance(stock, dict):
        provided += [f"stock.{key}" for key in of_stock if key in stock]
    if provided:
        text = f"{name} has {', '.join(provided)}, which is added for each {who}"
        raise issue_error("element.jobs", text, file=file, field=field, hint="remove it from the template")
    missing = [key for key in ("cell", "operations") if key not in template]
    if missing or not isinstance(stock, dict) or not isinstance(template.get("operations"), list):
        text = f"{name} is not a template: it must have a cell, a list of operations, and a mapping as stock"
        raise issue_error(
            "element.jobs", text, file=file, field=field, hint="write the rest of a problem file"
        )
    return name, file, resolve_files(template, folder)
