"""The element file: a surface, how it is divided into panels, blocks at hand, and jobs for the panels.

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
from planner.element.elastic import Rules
from planner.element.panel_faces import CutWire
from planner.element.stock_list import LeftOver
from planner.element.surface import ElementSurface, axes, seam, stand
from planner.geometry.arrays import FloatArray
from planner.geometry.cut_tree import Bow
from planner.geometry.face_offset import Rim
from planner.geometry.mesh import TriangleMesh
from planner.geometry.planar_panels import LEAST_COUNT, MOST_COUNT, Shape
from planner.geometry.ruled_approximation import Patch
from planner.geometry.ruled_wall import RuledWall, ruled_wall
from planner.geometry.units import MM, measurement
from planner.issues import Issue, TandemError, refusal
from planner.processes.hotwire.plan import wire as hot_wires
from planner.processes.hotwire.plan.operation import Straight
from planner.reading import strict_yaml
from planner.reading.cell import BowFile, RackFile
from planner.reading.materials import WireFile, WiresFile, wires_at_hand
from planner.reading.part_ruled import RuledFile, build_ruled
from planner.reading.part_surfaces import FrontFile, check_size, surface, surface_patch
from planner.reading.problem import SettingsFile, resolved, validate
from planner.reading.strict_yaml import Far, FileName, Positive, Strict, Vector

LONGEST: Final = 200.0
"""A surface to be divided whose longest side is longer [m] was stated in a wrong unit."""
SLACK_WIRE: Final = 5.0
"""A wire that is more than so many times as long as a whole element is not meant for it, or the element is in
another unit: an inch read as a millimetre is 25 times too small."""
MOST_CELLS: Final = 48
"""Cells of a grid along one side at most: the division looks at all rectangles of the grid."""
USUAL_CELLS: Final = 24
"""Cells along the longer side where none are stated."""
END_SHARE: Final = 0.6
"""Share of the tolerance by which errors of its ends may move a wire."""
USUAL_FOAM: Final = {
    "elastic": (2.0, 14.0),
    "hexagons": (10.0, 0.0),
    "boxes": (4.0, 4.0),
    "puzzle": (4.0, 4.0),
    "strips": (4.0, 4.0),
}
"""Foam [mm] beside panels, and above and below them, where none is stated. Under a back that a wire cuts 12
are too few: wires came to 9.95 mm of pedestals, of which they keep 10."""
LEAST_FOAM: Final = 3.0
"""Foam [mm] that panels of walls and strips need around them: their surfaces go on into it."""
NODE_STEP: Final = 0.02
"""Largest distance [m] of the rulings that stand for a wall."""
CLOSED: Final = 1e-3
"""A wall whose ends are no farther apart [m] is closed."""
ElementName = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,17}$", description="letter first, at most 18 characters")
]
LEAST_TOLERANCE_MM: Final = 0.05
"""Panels for the bent wire are asked to be no nearer to the surface."""


class PlaneFile(Strict):
    """The plane over which the surface stands: its normal, and the direction of one side of the rectangle."""

    normal: Vector
    along: Vector


class SurfaceFile(FrontFile):
    """The element's front, as that of a part: its normals point away from the element. Of a wall it is
    ``ruled``, as a surface of ``part.ruled``."""

    ruled: RuledFile | None = None
    plane: PlaneFile | None = None

    @model_validator(mode="after")
    def _one(self) -> "SurfaceFile":
        if [self.loft, self.mesh, self.rhino, self.step, self.ruled].count(None) != 4:
            raise ValueError("give one of loft, mesh, rhino, step and ruled")
        if self.ruled is not None and self.plane is not None:
            raise ValueError(
                "plane: a ruled wall is divided along its rulings however it stands; take it out"
            )
        return self


class ElasticFile(Strict):
    """Panels whose faces a bent wire cuts."""

    tolerance_mm: float = Field(ge=LEAST_TOLERANCE_MM, le=50, description="of panels to the surface")
    joint_mm: float = Field(
        default=0.2, ge=0.01, le=50, description="step between neighbours at 95 % of a joint's points"
    )
    cells: (
        tuple[Annotated[int, Field(ge=1, le=MOST_CELLS)], Annotated[int, Field(ge=1, le=MOST_CELLS)]] | None
    ) = Field(default=None, description="cut lines may lie between them; none: 24 along the longer side")
    ends_mm: float = Field(
        default=80.0, ge=5, le=1000, description="of the wire, free of the panel at each end"
    )
    end_error_mm: float = Field(
        default=0.05, ge=0, le=5, description="how far each wire end may be off in reality"
    )
    end_weight: float = Field(
        default=100.0, ge=1, le=1000, description="weight of the ends of sections in the fit"
    )
    check: Literal["none", "held", "wire", "all"] = Field(
        default="none",
        description="panels are struck off in which no wire is held safely, whose job refuses the wire, "
        "or that any part of tandem check refuses",
    )


class HexagonsFile(Strict):
    """Thick planar panels that a straight wire cuts out of held blocks."""

    count: int = Field(ge=LEAST_COUNT, le=MOST_COUNT, description="of panels")
    shape: Shape = Field(
        default="hexagon",
        description="most panels have six sides, or four, in rows along conjugate directions: then the "
        "count is the nearest that such rows make",
    )
    least_edge_mm: float = Field(default=50.0, ge=1, le=1000, description="of either face")
    least_width_mm: float = Field(default=100.0, ge=0, le=2000, description="of either face, across")
    off_surface_mm: float = Field(default=30.0, gt=0, le=1000, description="of fronts to the surface")
    rim: Rim = Field(default="square", description="sides on the rim: square to their panels, or upright")
    ground_mm: Far | None = Field(
        default=None, description="height on which a rim stands, with a level side there"
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
    """Panels of a free-form surface with ruled faces, in strips beside one another."""

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
        if len(self._given) != 1:
            raise ValueError(f"give exactly one kind of panels, {', '.join(get_args(Kind))}")
        return self

    @property
    def _given(self) -> list[Kind]:
        return [kind for kind in get_args(Kind) if getattr(self, kind) is not None]

    @property
    def kind(self) -> Kind:
        """Which of them it is."""
        return self._given[0]


class GroupsFile(Strict):
    """How a shell is put into groups for transport, and panels are numbered within each."""

    parts: int = Field(ge=1, le=26, description="groups, each with as many panels")
    numbering: Literal["rows", "height", "ground"] = Field(
        default="rows", description="by rows, by height, or by the way over the shell from its first row"
    )


class BlockFile(Strict):
    """A kind of block at hand: length, width, thickness."""

    size_mm: tuple[Positive, Positive, Positive]
    foam: Annotated[str, Field(max_length=60, description="name in the table of foams")] | None = None


Range = tuple[Annotated[float, Field(ge=0, le=100_000)], Annotated[float, Field(gt=0, le=100_000)]]


class WhenFile(Strict):
    """What panels a job is for: ranges [from, below) of the block that a panel is cut from."""

    longest_mm: Range | None = Field(default=None, description="longer side in plan")
    shortest_mm: Range | None = Field(default=None, description="shorter side in plan")
    thickness_mm: Range | None = Field(default=None, description="height of the block")

    def holds(self, size: tuple[float, float, float]) -> bool:
        """Whether a block (x, y, z) [mm] is meant."""
        own = {"longest_mm": max(size[:2]), "shortest_mm": min(size[:2]), "thickness_mm": size[2]}
        ranges = {name: getattr(self, name) for name in own}
        return all(r is None or r[0] <= own[name] < r[1] for name, r in ranges.items())


Rest = Annotated[FileName | dict[str, Any], Field(description="a file, or what it would hold")]


class JobFile(Strict):
    """A template: the rest of a problem file for the panels that ``when`` names; without it, for all.
    ``grippers`` lie ready beside those of its cell."""

    when: WhenFile = WhenFile()
    problem: Rest
    grippers: RackFile = ()


class SawBowFile(Strict):
    """The bow that cuts raw blocks apart."""

    span_mm: float = Field(ge=50, le=5000, description="wire between its clamps")
    throat_mm: float = Field(ge=50, le=5000, description="free between wire and beam")


class RawBlocksFile(Strict):
    """What panels' blocks are cut from, by through cuts."""

    sizes: tuple[BlockFile, ...] = Field(min_length=1, max_length=20)
    kerf_mm: float = Field(ge=0, le=50)
    oversize_mm: float = Field(
        default=0.0, ge=0, le=500, description="of a panel's block, along x and along y, to be trimmed"
    )
    grain: Literal["any", "along"] = Field(
        default="any", description="along: x of panels' blocks lies along the first side of raw blocks"
    )
    keep_mm: float = Field(default=200.0, ge=10, le=5000, description="least side of what is kept")
    bow: SawBowFile | None = None
    stock: FileName | None = Field(default=None, description="list of what is left over")


class DowelsFile(Strict):
    """Dowels between neighbouring panels, along the way in of the one that comes later."""

    diameter_mm: float = Field(ge=2, le=100)
    depth_mm: float = Field(ge=5, le=1000, description="of the hole in either panel")
    count: int = Field(default=2, ge=1, le=6, description="in a joint, fewer where it is short")
    cover_mm: float = Field(
        default=20.0, ge=1, le=500, description="foam between a hole and faces, other sides and other holes"
    )
    lean_deg: float = Field(
        default=30.0, ge=0, le=60, description="of a dowel off square to its joint, at most"
    )


class CutBlocksFile(Strict):
    """How raw blocks are cut apart: a template, the rest of a problem file with a straight wire whose block,
    stand and cuts come with each piece."""

    problem: Rest
    stand_mm: float = Field(
        default=700.0, ge=50, le=2000, description="height of what pieces lie or stand on, at most"
    )
    together: bool = Field(
        default=False,
        description="panels of a block are cut out of it together where its bow can: all faces on one "
        "way, then round each of them",
    )


class ElementFile(Strict):
    """A whole element file, schema version 1."""

    element: Literal[1]
    name: ElementName
    surface: SurfaceFile
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
            raise ValueError("wires: elastic panels are cut by bent wires; give one")
        if kind != "hexagons" and self.groups is not None:
            raise ValueError(f"groups: {kind} are numbered by where they are; take that out")
        if kind == "puzzle" and self.dowels is not None:
            raise ValueError("dowels: lobes hold the pieces of a puzzle; take that out")
        if self.cut_blocks is not None and self.raw_blocks is None:
            raise ValueError("cut_blocks: cuts of blocks follow from raw_blocks; give both")
        wall = kind in ("boxes", "puzzle")
        if wall != (self.surface.ruled is not None):
            raise ValueError(
                f"surface: {kind} divide a {'ruled surface' if wall else 'loft or a mesh'}; give one"
            )
        strange = self.model_fields_set & ({"wires"} if kind != "elastic" else set())
        if kind == "hexagons":
            strange |= self.model_fields_set & {"foam_faces_mm"}
        if kind == "strips" and self.surface.plane is not None:
            raise ValueError("surface.plane: strips follow the surface however it stands; take it out")
        if strange:
            what = "out of blocks as thick as they are" if kind == "hexagons" else "with its straight wire"
            raise ValueError(
                f"{' and '.join(sorted(strange))}: {kind} are cut by the bow of their cell {what}; take that "
                "out"
            )
        if (wall or kind == "strips") and min(self.sides, self.faces) < LEAST_FOAM * MM:
            raise ValueError(
                f"foam_sides_mm and foam_faces_mm: {kind} need {LEAST_FOAM:g} mm around them at least, "
                "more than half a slot"
            )
        return self

    @property
    def sides(self) -> float:
        """Foam of a block beside its panel [m]."""
        return (USUAL_FOAM[self.panels.kind][0] if self.foam_sides_mm is None else self.foam_sides_mm) * MM

    @property
    def faces(self) -> float:
        """Foam of a block above its panel, and below [m]."""
        return (USUAL_FOAM[self.panels.kind][1] if self.foam_faces_mm is None else self.foam_faces_mm) * MM


@dataclasses.dataclass(frozen=True)
class Template:
    """A job's ``data`` as a problem file has them, its cell inside and file names absolute."""

    when: WhenFile
    file: str
    data: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class SawTemplate(Template):
    """A template for raw blocks, with the bow that it mounts, ``margin`` [m] of foam to the wire's ends and
    to the beam, and ``clearance`` [m] of its settings."""

    bow: Bow
    margin: float
    clearance: float


@dataclasses.dataclass(frozen=True)
class Element:
    """An element file of any kind, with its templates; ``stock``: what is left over of earlier elements;
    ``saw``: the template for raw blocks; ``notes`` of what its surface was read from."""

    file: ElementFile
    templates: tuple[Template, ...]
    stock: tuple[LeftOver, ...]
    saw: SawTemplate | None
    notes: tuple[Issue, ...] = dataclasses.field(default=(), kw_only=True)


@dataclasses.dataclass(frozen=True)
class ElasticElement(Element):
    """An element of elastic panels in SI units; ``wires`` as the file states them, in the order of
    ``rules``."""

    wanted: ElasticFile
    surface: ElementSurface
    cells: tuple[int, int]
    rules: Rules
    wires: tuple[WireFile, ...]

    @property
    def judged(self) -> bool:
        """Whether panels' problems are checked as they will be written."""
        return self.wanted.check in ("wire", "all")


@dataclasses.dataclass(frozen=True)
class HexagonElement(Element):
    """An element of planar panels: ``wanted``, its ``surface`` [m] in the file's frame, which is that of the
    element, and ``view`` (3, 3), whose columns are to the right, up, and towards one who looks at its
    front."""

    wanted: HexagonsFile
    surface: TriangleMesh
    view: FloatArray


@dataclasses.dataclass(frozen=True)
class WallElement(Element):
    """A ruled wall in boxes or puzzle pieces: ``wanted``, and the ``wall`` [m] in the file's frame, which is
    that of the element."""

    wanted: BoxesFile | PuzzleFile
    wall: RuledWall


@dataclasses.dataclass(frozen=True)
class StripsElement(Element):
    """A free-form surface in ruled strips: ``wanted``, and the surface as a ``patch`` [m] in the file's
    frame, which is that of the element."""

    wanted: StripPanelsFile
    patch: Patch


def read(path: Path) -> ElasticElement | HexagonElement | WallElement | StripsElement:
    """The element of a file.

    Raises ``TandemError``: ``problem.field`` for every wrong field, with its line; issues of mesh files;
    issues of guides; ``part.patch``; ``element.surface``; ``element.stock``; ``part.offset`` where the
    thickness folds over; ``element.jobs`` for templates that bring what panels bring.
    """
    document = strict_yaml.read(path)
    spec, issues = validate(ElementFile, document.data, document, ())
    if spec is None:
        raise TandemError(issues)
    folder = path.parent
    wires: tuple[WireFile, ...] = ()
    templates: list[Template] = []
    try:
        wires = tuple(sorted(wires_at_hand(spec.wires or ()), key=lambda w: w.length_mm))
    except TandemError as error:
        issues += error.issues
    raw = spec.raw_blocks
    listed = [(f"blocks.{i}.foam", block) for i, block in enumerate(spec.blocks)]
    listed += [(f"raw_blocks.sizes.{i}.foam", block) for i, block in enumerate(raw.sizes if raw else ())]
    for field, block in listed:
        try:
            _ = None if block.foam is None else foam(block.foam)
        except TandemError as error:
            issues += [dataclasses.replace(i, field=field) for i in error.issues]
    stock: tuple[LeftOver, ...] = ()
    try:
        stock = () if raw is None or raw.stock is None else stock_list.read(folder / raw.stock)
    except TandemError as error:
        issues += error.issues
    for number, job in enumerate(spec.jobs):
        try:
            templates.append(_template(job, folder, f"jobs.{number}"))
        except TandemError as error:
            issues += error.issues
    saw: SawTemplate | None = None
    if spec.cut_blocks is not None and raw is not None:
        try:
            saw = _saw(spec.cut_blocks, raw.kerf_mm, folder)
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    walls = spec.panels.boxes or spec.panels.puzzle
    if walls is not None and spec.surface.ruled is not None:
        wall, notes = _wall(spec.surface.ruled, folder)
        return WallElement(spec, tuple(templates), stock, saw, walls, wall, notes=notes)
    strips = spec.panels.strips
    if strips is not None:
        patch, told = surface_patch(spec.surface, folder, "surface", LONGEST)
        return StripsElement(spec, tuple(templates), stock, saw, strips, patch, notes=tuple(told))
    mesh, _, told = surface(spec.surface, folder, "surface", LONGEST)
    check_size(mesh, "surface", LONGEST)
    plane = spec.surface.plane
    stated = (None, None) if plane is None else (np.array(plane.normal), np.array(plane.along))
    elastic, hexagons = spec.panels.elastic, spec.panels.hexagons
    if hexagons is not None:
        view = axes(mesh, *stated)
        return HexagonElement(
            spec, tuple(templates), stock, saw, hexagons, mesh, view, notes=(*told, *seam(mesh))
        )
    if elastic is None:
        raise ValueError("panels of no kind")
    _not_tiny(mesh, wires)
    own = stand(mesh, spec.thickness_mm * MM, *stated)
    cells = elastic.cells or _cells(own)
    rules = _rules(spec, elastic, wires)
    return ElasticElement(
        spec, tuple(templates), stock, saw, elastic, own, cells, rules, wires, notes=tuple(told)
    )


def _wall(spec: RuledFile, folder: Path) -> tuple[RuledWall, tuple[Issue, ...]]:
    ruled, notes = build_ruled(spec, folder, "surface.ruled")
    gap = np.linalg.norm([ruled.start[-1] - ruled.start[0], ruled.end[-1] - ruled.end[0]], axis=1).max()
    if ruled.closed or gap < CLOSED:
        raise _no_wall("the wall is closed: its last ruling is its first one; give it in two halves")
    if ruled.corner[1:-1].any():
        k = 1 + int(np.argmax(ruled.corner[1:-1]))
        at = ", ".join(f"{v / MM:.0f}" for v in 0.5 * (ruled.start[k] + ruled.end[k]))
        raise _no_wall(
            f"the wall has an edge near ({at}) mm; give the parts beside it as elements of their own"
        )
    return ruled_wall(ruled, NODE_STEP), tuple(notes)


def _no_wall(what: str) -> TandemError:
    return refusal("element.surface", what, field="surface.ruled")


def _rules(spec: ElementFile, elastic: ElasticFile, wires: tuple[WireFile, ...]) -> Rules:
    return Rules(
        tuple(
            CutWire(
                hot_wires.make(w.material, w.diameter_mm, w.width_mm, w.thickness_mm, w.temperature_c),
                w.length_mm * MM,
                2.0 * elastic.ends_mm * MM,
                elastic.end_error_mm * MM,
                END_SHARE * elastic.tolerance_mm * MM,
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


def _not_tiny(mesh: TriangleMesh, wires: tuple[WireFile, ...]) -> None:
    """Raises ``element.surface`` for an element that all wires are much too long for."""
    size = np.ptp(mesh.vertices, axis=0)
    shortest, longest = min(one.length_mm for one in wires) * MM, float(size.max())
    if shortest <= SLACK_WIRE * longest:
        return
    text = " x ".join(f"{side / MM:.0f}" for side in size)
    raise refusal(
        "element.surface",
        f"the surface is {text} mm, and the shortest wire has {shortest / MM:.0f} mm: more than "
        f"{SLACK_WIRE:g} times as much as the element is long",
        field="surface",
        **measurement(longest / MM, shortest / SLACK_WIRE / MM, "mm"),
        hint="state the unit that the file was made in, or give a shorter wire",
    )


def _cells(own: ElementSurface) -> tuple[int, int]:
    share = own.size / own.size.max()
    nx, ny = (max(1, int(np.round(USUAL_CELLS * s))) for s in share)
    return nx, ny


def _template(job: JobFile, folder: Path, field: str) -> Template:
    name, _, data = _rest(job.problem, folder, field, ("size_mm",), "panel")
    rack = [one.model_dump(mode="json", exclude_none=True) for one in job.grippers]
    if rack and isinstance(data["cell"], dict):
        data["cell"] = {**data["cell"], "grippers": [*(data["cell"].get("grippers") or []), *rack]}
    return Template(job.when, name, data)


def _saw(cut: CutBlocksFile, kerf_mm: float, folder: Path) -> SawTemplate:
    """The template for raw blocks, whose one operation has the ``kerf_mm`` that blocks are nested with as its
    slot; where it states its power, at most that."""
    stock = ("size_mm", "place", "roll_pitch_deg", "support", "oversize_mm", "held_by", "grip", "gripper")
    name, file, data = _rest(cut.problem, folder, "cut_blocks", stock, "piece of a block")
    operations = data["operations"]
    one = operations[0] if len(operations) == 1 and isinstance(operations[0], dict) else {}
    brought = ("cuts", "kerf_mm", "kerf_range_mm")
    hint = "take all else out; state its power_w, or nothing of its slot"
    wrong = f"must have one operation with the process straight_wire, without {', '.join(brought)}"
    if one.get("process") == "straight_wire" and not any(key in one for key in brought):
        bow = _mounted(one, data["cell"])
        if bow is not None:
            least = min(Straight.model_fields["kerf_range_mm"].default[0], 0.5 * kerf_mm)
            slot = {"kerf_range_mm": [least, kerf_mm]} if "power_w" in one else {"kerf_mm": kerf_mm}
            margin = float(one.get("margin_mm", Straight.model_fields["margin_mm"].default)) * MM
            settings = data.get("settings")
            stated = settings.get("clearance_mm") if isinstance(settings, dict) else None
            usual = SettingsFile.model_fields["clearance_mm"].default
            clear = float(stated if isinstance(stated, int | float) else usual) * MM
            whole = {**data, "operations": [{**one, **slot}]}
            return SawTemplate(WhenFile(), name, whole, bow, margin, clear)
        wrong, hint = "mounts no bow on the first of its arms", "give that arm a tool of the kind bow"
    raise refusal("element.jobs", f"{name} {wrong}", file=file, field="cut_blocks", hint=hint)


def _mounted(operation: Mapping[str, Any], cell: object) -> Bow | None:
    """The bow that the first arm of an operation carries; None where that has none."""
    arms, setup = operation.get("arms"), operation.get("setup")
    name = arms[0] if isinstance(arms, list) and arms else None
    listed = cell.get("arms") if isinstance(cell, dict) else None
    of_arms = [arm for arm in listed or () if isinstance(arm, dict) and arm.get("name") == name]
    changed = setup.get("tools") if isinstance(setup, dict) else None
    tool = (changed if isinstance(changed, dict) else {}).get(
        name, of_arms[0].get("tool") if of_arms else None
    )
    try:
        bow = BowFile.model_validate(tool, strict=False)
    except ValidationError:
        return None
    return Bow(bow.span_mm * MM, bow.throat_mm * MM)


def _rest(
    problem: str | Mapping[str, Any], folder: Path, field: str, of_stock: tuple[str, ...], who: str
) -> tuple[str, str | None, dict[str, Any]]:
    """The rest of a problem file, without the part and what of its stock ``who`` brings itself: what it is
    called, its file, if it is one, and the data."""
    name, file = field, None
    given: Mapping[str, Any]
    if isinstance(problem, str):
        name, file = problem, str(folder / problem)
        folder, given = (folder / problem).parent, strict_yaml.read(folder / problem).data
    else:
        given = problem
    stock = given.get("stock") or {}
    brought = [key for key in ("part", "sheet") if key in given]
    if isinstance(stock, dict):
        brought += [f"stock.{key}" for key in of_stock if key in stock]
    if brought:
        what = f"{name} has {', '.join(brought)}, which each {who} brings itself"
        raise refusal("element.jobs", what, file=file, field=field, hint="take that out of the template")
    missing = [key for key in ("cell", "operations") if key not in given]
    if missing or not isinstance(stock, dict) or not isinstance(given.get("operations"), list):
        what = f"{name} is no template: it must have a cell, a list of operations, and a mapping as stock"
        raise refusal("element.jobs", what, file=file, field=field, hint="write the rest of a problem file")
    return name, file, resolved(given, folder)
