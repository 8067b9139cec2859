"""Support on the border: rays for star-shaped borders, fractions for others, never across the formed area."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import FloatArray, Mesh
from planner.processes.forming.plan.contact import ContactPath, FormingPass, PassContact
from planner.processes.forming.plan.features.tree import MIN_BUMP_HEIGHT_M, build_feature_tree, in_place_order
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.support.modes import (
    MountedSheet,
    border_curve,
    border_path,
    make_mode_path,
)
from planner.tooling import FormingHead
from tests.processes.forming.plan.nests import sheet
from tests.processes.forming.plan.shapes import (
    BALL,
    T0,
    cone,
    cone_path,
    horseshoe,
    operation,
    pit,
    star,
    tree_of,
    upside_down,
)

DISK = FormingHead("disk", 0.03, 0.01, 0.01, 0.1, 0.002)


def last_pass(part: Mesh) -> FormingPass:
    tree, order = tree_of(part)
    return make_passes(tree, order, part, T0, operation("dpif_p"), sheet_metal("aluminium"))[-1]


def concentric_loops(
    forming_pass: FormingPass, outline: shapely.Polygon, inset: list[float], every: float
) -> ContactPath:
    """Loops inside an outline, ``inset`` [m] from it, a target ``every`` [m]."""
    places, loop = [], []
    for number, off in enumerate(inset):
        ring = outline.buffer(-off).exterior
        at = np.linspace(0.0, 1.0, int(ring.length / every) + 1)
        places.append(shapely.get_coordinates(shapely.line_interpolate_point(ring, at, normalized=True)))
        loop.append(np.full(len(at), number))
    xy = np.concatenate(places)
    point = np.column_stack([xy, np.full(len(xy), forming_pass.start - 0.001)])
    normal = np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    working = np.arange(len(xy)) > 0
    return ContactPath(
        point, normal, point + BALL.radius * normal, np.zeros(len(xy)), np.concatenate(loop), working
    )


def moves(centre: FloatArray) -> FloatArray:
    """The straight moves of a path in plan, but for those that go nowhere."""
    lines = shapely.linestrings(np.stack([centre[:-1, :2], centre[1:, :2]], axis=1))
    return np.asarray(lines[shapely.length(lines) > 0.0])


def check_border_path(forming_pass: FormingPass, centre: FloatArray, head: FormingHead) -> None:
    curve = border_curve(forming_pass, head, T0)
    inside = shapely.Polygon(curve[:, :2])
    assert not shapely.intersects(inside.buffer(-1e-9), moves(centre)).any()
    middle = shapely.line_interpolate_point(moves(centre), 0.5, normalized=True)
    assert shapely.distance(inside.exterior, middle).max() < 1e-3
    assert np.allclose(centre[:, 2], curve[0, 2])


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("head", [BALL, DISK])
def test_round_borders_are_met_by_rays(side: int, head: FormingHead) -> None:
    part = cone(60.0, 0.03, 0.1, 400)
    forming_pass = last_pass(part if side > 0 else upside_down(part))
    contact = cone_path(forming_pass, 60.0, 0.1, BALL.radius)
    path = make_mode_path(
        PassContact(forming_pass, contact), operation("dpif_p"), BALL, head, MountedSheet(T0)
    )
    assert path.support_centre is not None and path.support_axis is not None
    assert len(path.support_centre) == len(path.forming_centre) == len(path.contact.point)
    turn = np.arctan2(path.forming_centre[:, 1], path.forming_centre[:, 0])
    there = np.arctan2(path.support_centre[:, 1], path.support_centre[:, 0])
    assert np.abs(np.angle(np.exp(1j * (turn - there)))).max() < np.radians(0.5)
    assert np.abs(np.hypot(*path.support_centre.T[:2]) - 0.1 - head.radius).max() < 6e-4
    # a ball lies under the flat with its top, a disk with its face
    off = T0 + (head.radius if head.kind == "ball" else 0.0)
    assert np.allclose(path.support_centre[:, 2], forming_pass.start - side * off)
    assert np.allclose(path.support_axis, [0.0, 0.0, side])
    check_border_path(forming_pass, path.support_centre, head)
    assert np.isnan(path.gap).all()


def test_at_corners_of_the_border_targets_are_added() -> None:
    outline = star(0.1, 0.06)
    forming_pass = last_pass(pit(outline, 60.0, 0.01))
    contact = concentric_loops(forming_pass, outline, [0.001, 0.002, 0.003], 0.03)
    path, place = border_path(forming_pass, contact, BALL.radius, BALL, T0)
    assert len(place) == len(path.point) > len(contact.point)
    check_border_path(forming_pass, place, BALL)
    # the former stays on its straight moves
    line = shapely.LineString(contact.centre[:, :2])
    assert shapely.distance(line, shapely.points(path.centre[:, :2])).max() < 1e-9
    middle = np.array(outline.centroid.coords[0])
    seen = np.arctan2(*(contact.point[:, :2] - middle).T[::-1])
    rows = [int(np.argmin(np.linalg.norm(path.point - point, axis=1))) for point in contact.point[::7]]
    there = np.arctan2(*(place[rows, :2] - middle).T[::-1])
    assert np.abs(np.angle(np.exp(1j * (seen[::7] - there)))).max() < np.radians(1.0)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_the_border_is_around_all_that_is_off_the_flat(noise: float) -> None:
    """A wall that leaves the flat in a fillet of 12 mm is 1.5 mm inside of its foot where it is 0.1 mm deep,
    which is as far as noise goes. All of the face that is off the flat by more than 60 um lies the tool's
    radius inside of the border, and the tool nowhere farther than 0.3 mm off that which is off it by 1 um.
    Shapely's distances to the triangles themselves are asked."""

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        far = np.hypot(x, y)
        rim, wall = 0.03, np.sqrt(0.5) * 0.012
        fillet = np.sqrt(np.maximum(0.012**2 - np.maximum(rim - far, 0.0) ** 2, 0.5 * 0.012**2)) - 0.012
        return np.maximum(fillet - np.maximum(rim - wall - far, 0.0), -0.01)

    part = sheet(height, 0.05, 2e-3, noise=noise)
    part = Mesh(
        np.where(
            np.abs(part.vertices).max(axis=1)[:, None] > 0.045, part.vertices * [1, 1, 0], part.vertices
        ),
        part.faces,
    )
    tree = build_feature_tree(part, 5e-4, max(MIN_BUMP_HEIGHT_M, 2.0 * noise))
    forming_pass = make_passes(
        tree, in_place_order(tree), part, T0, operation("dpif_p"), sheet_metal("aluminium")
    )[-1]
    ring = shapely.points(border_curve(forming_pass, BALL, T0)[:, :2])
    corners = forming_pass.vertices[forming_pass.faces]
    deviation = np.abs(corners[:, :, 2] - forming_pass.start).max(axis=1)
    for least, low, high in ((6e-5, -1e-6, 0.1), (1e-6, -0.1, 3e-4)):
        face = shapely.union_all(shapely.polygons(corners[deviation > least][:, [0, 1, 2, 0], :2]))
        distance = shapely.distance(face, ring) - BALL.radius
        assert low <= distance.min() and distance.max() <= high


@pytest.mark.parametrize("back", [False, True])
def test_borders_that_no_point_sees_are_gone_round_by_share(back: bool) -> None:
    outline = horseshoe(0.1, 0.05)
    forming_pass = last_pass(pit(outline, 60.0, 0.01))
    contact = concentric_loops(forming_pass, outline, [0.002, 0.004], 0.004)
    if back:
        contact = ContactPath(
            contact.point[::-1],
            contact.normal,
            contact.centre[::-1],
            contact.angle,
            contact.loop,
            contact.working,
        )
    path, place = border_path(forming_pass, contact, BALL.radius, BALL, T0)
    check_border_path(forming_pass, place, BALL)
    # each loop goes once round the whole border, in its own sense
    ring = shapely.LineString(border_curve(forming_pass, BALL, T0)[:, :2])
    for number in (0, 1):
        mine = place[path.loop == number]
        length = float(np.linalg.norm(np.diff(mine[:, :2], axis=0), axis=1).sum())
        assert length == pytest.approx(ring.length, rel=0.02)
        x, y = (mine[:, :2] - mine[0, :2]).T
        area = float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        former = path.point[path.loop == number][:, :2]
        u, v = (former - former[0]).T
        assert np.sign(area) == np.sign(np.sum(u * np.roll(v, -1) - np.roll(u, -1) * v))
    # beside the tool that forms, but for what the lengths of border and loop differ by
    distance = np.linalg.norm(place[:, :2] - path.point[:, :2], axis=1)
    assert np.median(distance) < 0.06 and distance.max() < 0.12
