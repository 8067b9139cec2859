"""What the API sends of a cell: bodies with their triangles, their places in postures, maps of a freedom."""

from typing import Literal

from pydantic import Field

from planner.issues import Issue
from planner.service.models import Sent

Rows = list[list[float | None]]
"""Figures by target and value, nothing where there are none."""


class CellField(Sent):
    """A field of the problem that says where something stands, with the pose that it states or has got."""

    field: str
    xyz_mm: list[float]
    rpy_deg: list[float]


class CellMove(Sent):
    """What stands where ``fields`` say, and the bodies that go along with it."""

    name: str
    kind: Literal["stock", "arm", "obstacle"]
    bodies: list[str]
    fields: list[CellField]


class CellBody(Sent):
    """Triangles in the frame of a body: ``vertices`` [mm], three numbers each, and ``faces``, three indices
    each. ``color``: red, green, blue, opacity in 0..1."""

    body: str
    kind: Literal["link", "tool", "edge", "stock", "support", "obstacle", "part"]
    color: list[float] | None = None
    vertices: list[float]
    faces: list[int]


class CellArm(Sent):
    """An arm and its joints; ``works``: whether it takes part in the operation."""

    name: str
    robot: str
    works: bool
    home_deg: list[float]
    lower_deg: list[float]
    upper_deg: list[float]


class CellTarget(Sent):
    """A target that was looked at: where its tool points are in the world, the number of its ``posture``, and
    the ``faults`` where there is none."""

    index: int
    name: str
    points_mm: dict[str, list[float]]
    posture: int | None = None
    faults: list[Issue]


class FreedomOut(Sent):
    """What there is a map of: a freedom of the targets, or a way of the block's place (``place x``)."""

    name: str
    unit: Literal["deg", "mm", ""]


class FreedomMap(Sent):
    """A map of one freedom over the targets that were looked at: ``values`` by target. ``states`` by arm are
    numbers of ``codes``, 0 where nothing fails; distances to joint limits and to singular postures are those
    of the best state, ``clearance_mm`` is between bodies where nothing fails, at most 100. ``pairs``: bodies
    that are too near each other."""

    freedom: str
    unit: Literal["deg", "mm", ""]
    values: list[list[float]]
    states: dict[str, list[list[int]]]
    codes: list[str]
    limit_deg: dict[str, Rows]
    singular_deg: dict[str, Rows]
    clearance_mm: Rows
    pairs: list[list[str]]
    path: list[float | None] | None = Field(
        default=None, description="values of a plan of the same targets, nothing at those that it left out"
    )


class ReachOut(Sent):
    """What each arm can do over a standing block, at places on a grid that is ``pitch_mm`` apart along its
    edges: ``states`` by arm are numbers of ``codes``, 0 where it reaches within its limits. At a place the
    tool is turned as at the nearest of so many working ``targets``; ``samples`` of what the process leaves
    free were looked at, bodies were not held apart."""

    points_mm: list[list[float]]
    pitch_mm: list[float]
    states: dict[str, list[int]]
    codes: list[str]
    targets: int
    samples: int


class CellOut(Sent):
    """What a cell looks like to an operation. ``poses``: of each body at home, then in every posture, twelve
    numbers each: the upper rows of its matrix in the world, places in mm. ``joints_deg``: the joints of these
    postures. ``placed``: whether the block's place is stated or found. ``of``: targets that there are,
    ``thinned``: fewer than the plan will have."""

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
        default=None, description="the bent wire between the arms in each posture but home"
    )
    freedoms: list[FreedomOut] | None = None
    map: FreedomMap | None = None
    reach: ReachOut | None = None
