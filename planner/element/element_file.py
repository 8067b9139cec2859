"""The element file: a surface, how it is divided into panels, blocks and wires at hand, and jobs for the
panels.

Lengths are in mm. Faces are described as those of a part (`reading/part_surfaces.py`), wires as those of a
cell.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from planner.catalogue.materials import foam
from planner.element.elastic import Rules
from planner.element.panel_faces import CutWire
from planner.element.surface import ElementSurface, stand
from planner.geometry.units import MM
from planner.hotwire import wire as hot_wires
from planner.issues import Issue, TandemError
from planner.reading import strict_yaml
from planner.reading.materials import WireFile, WiresFile, wires_at_hand
from planner.reading.part_surfaces import FrontFile, check_size, surface
from planner.reading.problem import resolved, validate
from planner.reading.strict_yaml import FileName, Positive, Strict, Vector

MOST_CELLS: Final = 48
"""Cells of a grid along one side at most: the division looks at all rectangles of the grid."""
USUAL_CELLS: Final = 24
"""Cells along the longer side where none are stated."""
END_SHARE: Final = 0.6
"""Share of the tolerance by which errors of its ends may move a wire."""
ElementName = Annotated[
    str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,17}$", description="letter first, at most 18 characters")
]


class PlaneFile(Strict):
    """The plane over which the surface stands: its normal, and the direction of one side of the rectangle."""

    normal: Vector
    along: Vector


class SurfaceFile(FrontFile):
    """The element's front, as that of a part: its normals point away from the element."""

    plane: PlaneFile | None = None


class ElasticFile(Strict):
    """Panels whose faces a bent wire cuts."""

    tolerance_mm: Annotated[float, Field(ge=0.05, le=50, description="of panels to the surface")]
    joint_mm: Annotated[
        float, Field(ge=0.01, le=50, description="step between neighbours at 95 % of a joint's points")
    ] = 0.2
    cells: Annotated[
        tuple[
            Annotated[int, Field(ge=1, le=MOST_CELLS)],
            Annotated[int, Field(ge=1, le=MOST_CELLS)],
        ]
        | None,
        Field(description="cut lines may lie between them; none: 24 along the longer side"),
    ] = None
    ends_mm: Annotated[
        float, Field(ge=5, le=1000, description="of the wire, free of the panel at each end")
    ] = 80.0
    end_error_mm: Annotated[
        float, Field(ge=0, le=5, description="how far each wire end may be off in reality")
    ] = 0.05
    end_weight: Annotated[
        float, Field(ge=1, le=1000, description="weight of the ends of sections in the fit")
    ] = 100.0
    check: Annotated[
        Literal["none", "wire", "all"],
        Field(
            description="panels are struck off that the wire cannot cut, or that all of tandem check refuses"
        ),
    ] = "wire"


class PanelsFile(Strict):
    """How the element is divided: one kind of panels."""

    elastic: ElasticFile


class BlockFile(Strict):
    """A kind of block at hand: length, width, thickness."""

    size_mm: tuple[Positive, Positive, Positive]
    foam: Annotated[str, Field(max_length=60, description="name in the table of foams")] | None = None


Range = tuple[Annotated[float, Field(ge=0, le=100_000)], Annotated[float, Field(gt=0, le=100_000)]]


class WhenFile(Strict):
    """What panels a job is for: ranges [from, below) of the block that a panel is cut from."""

    longest_mm: Annotated[Range | None, Field(description="longer side in plan")] = None
    shortest_mm: Annotated[Range | None, Field(description="shorter side in plan")] = None
    thickness_mm: Annotated[Range | None, Field(description="height of the block")] = None

    def holds(self, size: tuple[float, float, float]) -> bool:
        """Whether a block (x, y, z) [mm] is meant."""
        own = {"longest_mm": max(size[:2]), "shortest_mm": min(size[:2]), "thickness_mm": size[2]}
        ranges = {name: getattr(self, name) for name in own}
        return all(r is None or r[0] <= own[name] < r[1] for name, r in ranges.items())


class JobFile(Strict):
    """A template: the rest of a problem file for the panels that ``when`` names; without it, for all."""

    when: WhenFile = WhenFile()
    problem: FileName


class ElementFile(Strict):
    """A whole element file, schema version 1."""

    element: Literal[1]
    name: ElementName
    surface: SurfaceFile
    thickness_mm: Annotated[float, Field(ge=1, le=2000)]
    panels: PanelsFile
    wires: Annotated[tuple[WiresFile, ...], Field(min_length=1, max_length=20)]
    blocks: Annotated[tuple[BlockFile, ...], Field(min_length=1, max_length=50)]
    foam_sides_mm: Annotated[
        float, Field(ge=0, le=500, description="foam of a block beside its panel, at each side")
    ] = 2.0
    foam_faces_mm: Annotated[
        float, Field(ge=0, le=500, description="foam of a block above and below its panel")
    ] = 12.0
    jobs: Annotated[tuple[JobFile, ...], Field(min_length=1, max_length=50)]


@dataclasses.dataclass(frozen=True)
class Template:
    """A job's ``data`` as a problem file has them, its cell inside and file names absolute."""

    when: WhenFile
    file: str
    data: dict[str, Any]


@dataclasses.dataclass(frozen=True)
class Element:
    """An element file in SI units; ``wires`` and ``blocks`` as the file states them, in the order of
    ``rules``."""

    file: ElementFile
    surface: ElementSurface
    cells: tuple[int, int]
    rules: Rules
    wires: tuple[WireFile, ...]
    templates: tuple[Template, ...]


def read(path: Path) -> Element:
    """The element of a file.

    Raises ``TandemError``: ``problem.field`` for every wrong field, with its line; issues of mesh files;
    ``element.surface``; ``part.offset`` where the thickness folds over; ``element.jobs`` for templates that
    bring what panels bring.
    """
    document = strict_yaml.read(path)
    spec, issues = validate(ElementFile, document.data, document, ())
    if spec is None:
        raise TandemError(issues)
    folder = path.parent
    wires: tuple[WireFile, ...] = ()
    templates: list[Template] = []
    try:
        wires = tuple(sorted(wires_at_hand(spec.wires), key=lambda w: w.length_mm))
    except TandemError as error:
        issues += error.issues
    for number, block in enumerate(spec.blocks):
        try:
            _ = None if block.foam is None else foam(block.foam)
        except TandemError as error:
            issues += [dataclasses.replace(i, field=f"blocks.{number}.foam") for i in error.issues]
    for number, job in enumerate(spec.jobs):
        try:
            templates.append(_template(job, folder, f"jobs.{number}"))
        except TandemError as error:
            issues += error.issues
    if issues:
        raise TandemError(issues)
    elastic = spec.panels.elastic
    mesh, _ = surface(spec.surface.loft, spec.surface.mesh, folder, "surface")
    check_size(mesh, "surface")
    plane = spec.surface.plane
    own = stand(
        mesh,
        spec.thickness_mm * MM,
        None if plane is None else np.array(plane.normal),
        None if plane is None else np.array(plane.along),
    )
    rules = Rules(
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
        spec.foam_sides_mm * MM,
        spec.foam_faces_mm * MM,
        elastic.tolerance_mm * MM,
        elastic.end_weight,
    )
    return Element(spec, own, elastic.cells or _cells(own), rules, wires, tuple(templates))


def _cells(own: ElementSurface) -> tuple[int, int]:
    share = own.size / own.size.max()
    nx, ny = (max(1, int(np.round(USUAL_CELLS * s))) for s in share)
    return nx, ny


def _template(job: JobFile, folder: Path, field: str) -> Template:
    path = folder / job.problem
    document = strict_yaml.read(path)
    brought = [key for key in ("part", "sheet") if key in document.data]
    stock = document.data.get("stock") or {}
    if isinstance(stock, dict) and "size_mm" in stock:
        brought.append("stock.size_mm")
    if brought:
        what = f"{job.problem} has {', '.join(brought)}, which each panel brings itself"
        raise TandemError(
            Issue("element.jobs", what, file=str(path), field=field, hint="take that out of the template")
        )
    missing = [key for key in ("cell", "operations") if key not in document.data]
    if missing or not isinstance(stock, dict) or not isinstance(document.data.get("operations"), list):
        what = (
            f"{job.problem} is no template: it must have a cell, a list of operations, and a mapping as stock"
        )
        raise TandemError(
            Issue("element.jobs", what, file=str(path), field=field, hint="write the rest of a problem file")
        )
    return Template(job.when, job.problem, resolved(document.data, path.parent))
