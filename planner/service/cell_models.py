"""Response models of a cell: bodies with triangles, their poses in postures, and maps of a freedom."""

from typing import Literal

from pydantic import Field

from planner.issues import Issue
from planner.service.models import Sent

ValueGrid = list[list[float | None]]
"""A table with one row per target and one column per value of the freedom. None where no number exists."""


class CellField(Sent):
    """A field of the problem that places something, with the pose that it states or that was found."""

    field: str
    xyz_mm: list[float]
    rpy_deg: list[float]


class CellMove(Sent):
    """Something whose pose is given by ``fields``, and the bodies that move with it."""

    name: str
    kind: Literal["stock", "arm", "obstacle"]
    bodies: list[str]
    fields: list[CellField]


class CellBody(Sent):
    """Triangles in the frame of a body.

    ``vertices`` [mm] has three numbers per vertex, and ``faces`` three indices per triangle. ``color`` is
    red, green, blue and opacity, from 0 to 1.
    """

    body: str
    kind: Literal["link", "tool", "edge", "stock", "support", "obstacle", "part"]
    color: list[float] | None = None
    vertices: list[float]
    faces: list[int]


class CellArm(Sent):
    """An arm and its joints. ``works`` says whether it takes part in the operation."""

    name: str
    robot: str
    works: bool
    home_deg: list[float]
    lower_deg: list[float]
    upper_deg: list[float]


class CellTarget(Sent):
    """A sampled target.

    It has tool points in the world, and the number of its ``posture``, or ``faults`` if there is none.
    """

    index: int
    name: str
    points_mm: dict[str, list[float]]
    posture: int | None = None
    faults: list[Issue]


class FreedomOut(Sent):
    """A freedom that can be mapped: of the targets, or of the block's placement (``place x``)."""

    name: str
    unit: Literal["deg", "mm", ""]


class FreedomMap(Sent):
    """A map of one freedom over the sampled targets.

    - ``values``: values of the freedom, by target.
    - ``states``: by arm, numbers of ``codes``, 0 if nothing fails.
    - ``limit_deg``, ``singular_deg``: distances of the best posture from joint limits and from
      singularities.
    - ``clearance_mm``: distance between bodies where nothing fails, at most 100.
    - ``pairs``: bodies that are too close to each other.
    """

    freedom: str
    unit: Literal["deg", "mm", ""]
    values: list[list[float]]
    states: dict[str, list[list[int]]]
    codes: list[str]
    limit_deg: dict[str, ValueGrid]
    singular_deg: dict[str, ValueGrid]
    clearance_mm: ValueGrid
    pairs: list[list[str]]
    path: list[float | None] | None = Field(
        default=None, description="values of a plan of the same targets, null at targets that it lacks"
    )


class ReachOut(Sent):
    """Reach of each arm over a fixed block, on a grid with the spacing ``pitch_mm`` along its edges.

    - ``states``: by arm, numbers of ``codes``, 0 if the arm reaches the point within its limits.
    - ``targets``: number of working targets. At each point the tool has the orientation of the nearest one.
    - ``samples``: number of samples of the freedoms that the process leaves open.

    Collisions between bodies are not tested.
    """

    points_mm: list[list[float]]
    pitch_mm: list[float]
    states: dict[str, list[int]]
    codes: list[str]
    targets: int
    samples: int


class CellOut(Sent):
    """A cell as an operation finds it.

    - ``poses``: of each body at home, then in every posture. Each pose has twelve numbers: the upper three
      rows of its matrix in the world, positions in mm.
    - ``joints_deg``: joint values of these postures.
    - ``placed``: whether the block's pose is stated or was found.
    - ``of``: number of targets. ``thinned``: whether the plan will have more targets.
    """

    name: str
    digest: str
    issues: list[Issue]
    operation: int
    operations: list[str]
    setup: int
    placed: bool
    arms: list[CellArm]
    moves: list[CellMove]
    bodies: list[CellBody]
    poses: dict[str, list[list[float]]]
    of: int | None = None
    thinned: bool | None = None
    targets: list[CellTarget] | None = None
    joints_deg: dict[str, list[list[float]]] | None = None
    wires_mm: list[list[list[float]]] | None = Field(
        default=None, description="the bent wire between the arms in each posture except home"
    )
    freedoms: list[FreedomOut] | None = None
    map: FreedomMap | None = None
    reach: ReachOut | None = None
