"""Paths of contact against faces in closed form."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from planner.geometry.arrays import FloatArray
from planner.geometry.mesh import TriangleMesh
from planner.issues import TandemError
from planner.processes.forming.plan import contact
from planner.processes.forming.plan.contact import ContactPath, FormingPass
from planner.processes.forming.plan.paths.contact_path import make_contact_path
from planner.processes.forming.plan.paths.spiral import PathOptions
from tests.processes.forming.plan.paths.path_faces import (
    bowl,
    cone,
    distance,
    rings,
    round_shape,
    square_shape,
)

Shape = Callable[[FloatArray], FloatArray]
KINDS = ("contour", "alternating", "stepped", "helical")


def random_rows(count: int, max_count: int = 150, seed: int = 0) -> np.ndarray:
    return np.sort(np.random.default_rng(seed).choice(count, min(max_count, count), replace=False))


def check(forming_pass: FormingPass, radius: float, path: ContactPath, options: PathOptions) -> None:
    """What holds of every path: contact on the mesh, no gouge at targets and on moves, spacing."""
    rows = random_rows(len(path.point))
    work = path.working[rows]
    assert distance(forming_pass, path.point[rows]).max() <= 5e-6
    clear = distance(forming_pass, path.centre[rows]) - radius
    assert clear.min() >= -2e-6
    assert clear[work].max() <= 3e-6
    moves = np.flatnonzero(path.working[1:])
    moves = moves[random_rows(len(moves), seed=1)]
    fraction = np.random.default_rng(2).random((len(moves), 1))
    between = (1.0 - fraction) * path.centre[moves] + fraction * path.centre[moves + 1]
    deviation = distance(forming_pass, between) - radius
    assert deviation.min() >= -min(options.chord, options.cut)
    if options.kind != "stepped":
        assert deviation.max() <= options.chord + 5e-6
    forms = path.working
    reach = path.centre - path.point - forming_pass.side * radius * path.normal
    assert np.abs(reach[forms]).max() <= 5e-6
    assert (path.normal[:, 2] > 0.0).all()
    assert np.allclose(path.angle, np.arccos(path.normal[:, 2]))
    assert np.linalg.norm(np.diff(path.centre, axis=0), axis=1).min() >= 5e-5


def test_moves_over_a_round_rim_cut_less_than_they_may_be_off() -> None:
    """A cone of 50 degrees that leaves the flat in a fillet of 6 mm: the ball's centre keeps 11 mm off the
    fillet's own circle, in closed form, but for the facets, and what steps down the rim may cut."""
    turn = np.radians(np.linspace(0.0, 50.0, 61))
    fillet = np.column_stack([0.05 - 0.006 * np.sin(turn), 0.006 * (np.cos(turn) - 1.0)])
    foot = fillet[-1] - 0.015 * np.array([np.cos(turn[-1]), np.sin(turn[-1])])
    line = np.concatenate([[[0.0, foot[1]]], foot[None], fillet[::-1]])
    one = rings(line[:, 0], line[:, 1], 90)
    least = []
    for cut in (1e-4, 1e-5):
        options = PathOptions(kind="alternating", stepdown=6e-4, chord=1e-4, tangent_angle=0.3, cut=cut)
        path = make_contact_path(one, 0.005, options)
        fraction = np.linspace(0.0, 1.0, 9)[:, None, None]
        between = ((1.0 - fraction) * path.centre[:-1] + fraction * path.centre[1:]).reshape(-1, 3)
        plan = np.column_stack([np.hypot(between[:, 0], between[:, 1]), between[:, 2]])
        rim = (plan[:, 1] < 0.004) & (plan[:, 0] > 0.03) & (plan[:, 1] > -0.001)
        least.append(float(np.linalg.norm(plan[rim] - [0.05, -0.006], axis=1).min()) - 0.011)
    assert least[0] < -4e-5 and -2e-5 < least[1] < 0.0


@pytest.mark.parametrize(
    ("angle", "shape"), [(2.0, round_shape), (4.0, round_shape), (4.0, square_shape), (8.0, round_shape)]
)
@pytest.mark.parametrize("kind", ["helical", "contour"])
def test_ball_rolls_over_the_edge_of_a_ledge(kind: str, angle: float, shape: Shape) -> None:
    """From the last loop on a ledge to the first one on the wall below the nearest place of the face hops
    over the sharp edge between them; a straight move from side to side cuts 0.3 mm into it."""
    down, run = 0.008 * np.sin(np.radians(45.0)), 0.008
    fall = run * np.tan(np.radians(angle))
    radius = 0.055 - np.array([2.0 * down + run, down + run, down, 0.0])
    height = -np.array([2.0 * down + fall, down + fall, down, 0.0])
    one = rings(np.append(0.0, radius), np.append(height[0], height), 72, shape=shape)
    options = PathOptions(kind=kind, stepdown=1e-3, cut=2e-5)
    path = make_contact_path(one, 0.006, options)
    turned = (path.normal[1:] * path.normal[:-1]).sum(axis=1)
    moves = np.flatnonzero(path.working[1:] & path.working[:-1])
    moves = moves[np.argsort(turned[moves])[:12]]
    fraction = np.linspace(0.0, 1.0, 5)[1:-1, None, None]
    between = ((1.0 - fraction) * path.centre[moves] + fraction * path.centre[moves + 1]).reshape(-1, 3)
    assert distance(one, between).min() > 0.006 - 2.2e-5
    edge = np.abs(path.point[:, 2] - height[1]) < 1e-6  # where it touches while it rolls
    assert np.ptp(path.angle[edge]) > np.radians(20.0)


@pytest.mark.parametrize("kind", KINDS)
def test_cone_is_touched_on_its_offset(kind: str) -> None:
    one = cone(0.1, 0.04, 60.0, 0.012)
    options = PathOptions(kind=kind, stepdown=4e-3)
    path = make_contact_path(one, 0.009525, options)
    check(one, 0.009525, path, options)
    wall = path.working & (path.point[:, 2] > -0.03) & (path.point[:, 2] < -1e-4)
    # offset of the cone: a cone 9.525 mm nearer to the axis along its normal
    # (facets of 2 degrees: 15 um in)
    radial = np.linalg.norm(path.centre[wall, :2], axis=1)
    true = 0.1 + path.centre[wall, 2] / np.tan(np.radians(60.0)) - 0.009525 / np.sin(np.radians(60.0))
    assert np.abs(radial - true).max() < 2e-5
    assert np.degrees(path.angle[wall]) == pytest.approx(60.0, abs=0.05)
    # the end is flat: the last contact is at the floor's edge
    assert path.point[-1, 2] == pytest.approx(-0.04, abs=5e-6)
    assert np.degrees(path.angle[-1]) < 3.0


def test_spiral_is_flat_at_both_ends_and_has_no_seam() -> None:
    one = cone(0.06, 0.03, 50.0, 0.012)
    path = make_contact_path(one, 0.008, PathOptions(kind="helical", stepdown=2e-3))
    assert path.working[1:].all()
    first, last = path.loop == 0, path.loop == path.loop.max()
    assert np.ptp(path.point[first, 2]) < 5e-6
    assert np.ptp(path.point[last, 2]) < 5e-6
    assert path.point[first, 2].max() == pytest.approx(0.0, abs=1e-5)
    assert np.diff(path.point[:, 2]).max() < 5e-6  # never up again
    assert np.diff(path.point[:, 2]).min() > -5e-4  # and never down by a step
    turn = np.unwrap(np.arctan2(path.point[:, 1], path.point[:, 0]))
    assert (np.diff(turn) > 0.0).all()
    assert turn[-1] - turn[0] == pytest.approx(2.0 * np.pi * (path.loop.max() + 1), abs=0.02)


def test_spherical_dish_is_touched_on_the_smaller_sphere() -> None:
    one = bowl(0.05, 0.03, count=240, walls=90)
    options = PathOptions(kind="helical", stepdown=1e-3)
    path = make_contact_path(one, 0.01, options)
    check(one, 0.01, path, options)
    apart = np.linalg.norm(path.centre - [0.0, 0.0, 0.02], axis=1)
    inner = path.point[:, 2] < -1e-4  # at the rim the ball goes round the edge
    assert np.abs(apart[inner] - 0.04).max() < 1e-5


def test_upward_feature_is_the_mirror_image() -> None:
    down = bowl(0.05, 0.02, count=120, walls=40)
    up = bowl(0.05, 0.02, side=-1, count=120, walls=40)
    options = PathOptions(kind="helical", stepdown=2e-3)
    one, two = make_contact_path(down, 0.01, options), make_contact_path(up, 0.01, options)
    assert np.allclose(two.centre, one.centre * [1, 1, -1], atol=1e-12)
    assert np.allclose(two.point, one.point * [1, 1, -1], atol=1e-12)
    assert np.allclose(two.normal, one.normal * [-1, -1, 1], atol=1e-12)
    assert (two.centre[two.working, 2] < two.point[two.working, 2]).all()  # the ball is below the sheet


@pytest.mark.parametrize("kind", ["contour", "helical"])
def test_pyramid_keeps_its_corners(kind: str) -> None:
    angle = np.radians(55.0)
    height = np.linspace(-0.03, 0.0, 16)
    r = 0.05 + height / np.tan(angle)
    one = rings(np.append(0.0, r), np.append(-0.03, height), 80, shape=square_shape)
    options = PathOptions(kind=kind, stepdown=3e-3)
    path = make_contact_path(one, 0.005, options)
    check(one, 0.005, path, dataclasses.replace(options, chord=1e-3 if kind == "helical" else options.chord))
    # where the offsets of two walls meet, on every loop: the ball goes into each corner as far as it can
    inside = 0.05 + path.centre[:, 2] / np.tan(angle) - 0.005 / np.sin(angle)
    for loop in range(path.loop.max()):
        rows = (path.loop == loop) & path.working
        for sign in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
            corner = inside[rows, None] * np.array(sign)
            assert np.linalg.norm(path.centre[rows, :2] - corner, axis=1).min() < 2e-4
    # sides are straight: few targets are needed
    assert len(path.point) < 45 * (path.loop.max() + 1)
    # the tip reaches the floor although the edge around it is sharp, but for what keeps it at the wall
    assert path.centre[-1, 2] - 0.005 == pytest.approx(-0.03 + options.chord + 1e-5, abs=2e-5)


def test_ellipse_gets_targets_by_turn_and_chord() -> None:
    one = bowl(0.05, 0.02, count=360, walls=40, stretch=1.6)
    wide = make_contact_path(
        one, 0.005, PathOptions(stepdown=4e-3, tangent_angle=0.15, chord=1.0, longest=1.0)
    )
    loop = wide.point[wide.loop == 0]
    way = np.diff(loop, axis=0)
    heading = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    assert np.abs(np.diff(heading)).max() < 0.15 + 2.1 * np.radians(1.6)  # facets turn by up to 1.6 degrees
    assert len(loop) == pytest.approx(2.0 * np.pi / 0.15, abs=3)
    counts = []
    for chord in (1e-4, 2.5e-5):
        options = PathOptions(stepdown=4e-3, tangent_angle=1.0, chord=chord, longest=1.0)
        path = make_contact_path(one, 0.005, options)
        check(one, 0.005, path, options)
        counts.append(len(path.point))
    assert counts[1] > 1.5 * counts[0]  # 2 where facets are fine
    short = make_contact_path(
        one, 0.005, PathOptions(stepdown=4e-3, tangent_angle=1.0, chord=1.0, longest=2e-3)
    )
    assert np.linalg.norm(np.diff(short.centre, axis=0), axis=1).max() <= 2.1e-3


def test_loops_turn_and_join_as_their_kind_says() -> None:
    one = cone(0.06, 0.02, 45.0, 0.01)

    def swept(path: ContactPath, loop: int) -> float:
        at = path.point[(path.loop == loop) & path.working, :2]
        return float(np.unwrap(np.arctan2(at[:, 1], at[:, 0]))[[0, -1]] @ [-1.0, 1.0])

    base = PathOptions(stepdown=4e-3, start_angle=0.7)
    plain = make_contact_path(one, 0.006, base)
    assert all(swept(plain, k) == pytest.approx(2.0 * np.pi, abs=0.2) for k in range(4))
    starts = plain.point[np.flatnonzero(np.diff(plain.loop)) + 1]
    assert np.arctan2(starts[:, 1], starts[:, 0]) == pytest.approx(0.7, abs=0.2)
    for k in range(1, 5):  # the first is at the flat; closed: the loop ends where it began
        rows = np.flatnonzero((plain.loop == k) & (np.abs(plain.point[:, 2] + 4e-3 * k) < 1e-6))
        assert np.allclose(plain.centre[rows[0]], plain.centre[rows[-1]], atol=1e-6)
    turned = make_contact_path(one, 0.006, dataclasses.replace(base, direction="cw"))
    assert all(swept(turned, k) == pytest.approx(-2.0 * np.pi, abs=0.2) for k in range(4))
    flips = make_contact_path(one, 0.006, dataclasses.replace(base, kind="alternating"))
    assert [np.sign(swept(flips, k)) for k in range(4)] == [1.0, -1.0, 1.0, -1.0]
    steps = make_contact_path(one, 0.006, dataclasses.replace(base, kind="stepped"))
    over = np.flatnonzero(~steps.working[1:]) + 1
    assert len(over) == steps.loop.max()
    level, down = steps.centre[over] - steps.centre[over - 1], steps.centre[over + 1] - steps.centre[over]
    assert np.abs(level[:, 2]).max() < 1e-9
    assert np.abs(down[:, :2]).max() < 1e-9
    assert (down[:, 2] < 0.0).all()


def test_sharp_floor_edge_is_left_with_a_fillet_of_the_ball() -> None:
    one = cone(0.1, 0.03, 60.0, 0.0)
    options = PathOptions(kind="helical", stepdown=1e-3)
    path = make_contact_path(one, 0.009525, options)
    check(one, 0.009525, path, options)
    # it keeps off the floor by what straight moves may be off the wall, and a little
    assert path.centre[-1, 2] - 0.009525 == pytest.approx(-0.03 + options.chord + 1e-5, abs=2e-5)
    # the wall is touched down to where a ball that lies on the floor touches it
    assert path.point[-1, 2] == pytest.approx(-0.03 + 0.009525 * (1.0 - np.cos(np.radians(60.0))), abs=8e-5)
    assert np.ptp(path.point[path.loop == path.loop.max(), 2]) < 1e-5


def test_the_lowest_loop_of_a_pyramid_with_sharp_corners_keeps_off_its_floor_too() -> None:
    """In such a corner the other wall pushes the ball aside at any height, which no floor does."""
    radius = np.linspace(0.018, 0.064, 24)
    height = np.append(-0.023, -0.023 + (radius - radius[0]) / (radius[-1] - radius[0]) * 0.023)
    ball, options = 0.003, PathOptions(kind="contour", stepdown=8e-4)
    one = rings(np.append(0.0, radius), height, 96, shape=square_shape)
    path = make_contact_path(one, ball, options)
    last = path.working & (path.loop == path.loop.max())
    # beside the corners, where the floor and one wall alone are near
    middle = last & (np.abs(path.centre[:, :2]).min(axis=1) < 0.01)
    off_floor = path.centre[middle, 2] + 0.023 - ball
    assert off_floor.min() > 1e-5 and off_floor.max() < 1.5e-4


def test_tool_larger_than_a_fillet_is_refused_with_the_largest_that_fits() -> None:
    with pytest.raises(TandemError) as caught:
        make_contact_path(cone(0.1, 0.04, 60.0, 0.006), 0.009525, PathOptions(stepdown=3e-3))
    (issue,) = caught.value.issues
    assert issue.code == "forming.tool_radius"
    assert issue.value == pytest.approx(9.525)
    assert issue.limit == pytest.approx(6.0, rel=0.06)
    assert "largest radius that fits" in issue.message
    make_contact_path(cone(0.1, 0.04, 60.0, 0.006), 1e-3 * issue.limit, PathOptions(stepdown=3e-3))


@pytest.mark.parametrize("ball", [1.9e-3, 2e-3, 2.06e-3])
def test_a_fillet_that_a_ball_just_fits_is_left_as_a_crease_where_the_place_counts(ball: float) -> None:
    """In a fillet of its own radius a ball touches another place for any step aside; on the cone above it
    does not. The wall's plane and the floor's say where it is."""
    fillet, angle, spare = 2e-3, np.radians(45.0), 0.25e-3
    one, options = cone(0.04, 0.012, 45.0, fillet), PathOptions(kind="helical", stepdown=1e-3)
    path = make_contact_path(one, ball, dataclasses.replace(options, spare=spare))
    off_floor = path.centre[:, 2] + 0.012 - ball
    assert 4e-5 < off_floor.min() < spare * (1.0 - np.cos(angle))
    wall = (0.04 - np.hypot(path.centre[:, 0], path.centre[:, 1])) * np.sin(angle) + path.centre[
        :, 2
    ] * np.cos(angle)
    assert np.abs(wall[path.working] - ball)[path.loop[path.working] > 1].max() < 6e-5
    assert (
        make_contact_path(one, ball, options).centre[:, 2] + 0.012 - ball
    ).min() < 1e-5  # else into the fillet
    wide = make_contact_path(one, 1.7e-3, dataclasses.replace(options, spare=spare))
    assert (wide.centre[:, 2] + 0.012 - 1.7e-3).min() < 1e-5


def test_a_dish_that_a_ball_just_fits_is_formed_all_the_same() -> None:
    one, options = bowl(0.0051, 0.0015, count=72, walls=40), PathOptions(kind="helical", stepdown=3e-4)
    path = make_contact_path(one, 0.005, dataclasses.replace(options, spare=0.25e-3))
    assert path.centre[:, 2].min() + 0.0015 - 0.005 < 2e-5


def test_a_fillet_that_is_low_for_the_step_is_no_narrower_between_its_loops() -> None:
    """A spiral's normal goes from one loop's to the next one's: half way it may be far off."""
    one, options = cone(0.06, 0.006, 40.0, 0.003), PathOptions(kind="helical", stepdown=1.5e-3)
    path = make_contact_path(one, 0.0025, options)
    check(one, 0.0025, path, options)


@pytest.mark.parametrize(("kind", "fillet"), [("helical", 0.0031), ("stepped", 0.0047)])
def test_the_radius_that_is_named_does_all_along(kind: str, fillet: float) -> None:
    """Its own path has other targets than the refused one; the bound is the fillet of the cone."""
    one, options = cone(0.08, 0.02, 50.0, fillet), PathOptions(kind=kind, stepdown=1e-3)  # type: ignore[arg-type]
    with pytest.raises(TandemError) as caught:
        make_contact_path(one, 0.008, options)
    (issue,) = caught.value.issues
    assert issue.limit is not None
    assert 0.85e3 * fillet < issue.limit < 1.06e3 * fillet
    assert f"is {issue.limit:.2f} mm" in issue.message
    make_contact_path(one, 1e-3 * float(f"{issue.limit:.2f}"), options)


def test_tool_larger_than_the_dish_is_refused() -> None:
    with pytest.raises(TandemError) as caught:
        make_contact_path(bowl(0.02, 0.012, count=72, walls=60), 0.024, PathOptions(stepdown=2e-3))
    (issue,) = caught.value.issues
    assert issue.code == "forming.tool_radius"
    assert 18.0 < (issue.limit or 0.0) < 20.2  # facets take a little


def test_two_hollows_at_a_level_are_formed_with_a_lift_between() -> None:
    low = bowl(0.03, 0.01, count=60, walls=16)
    aside = np.array([0.04, 0.0, 0.0])
    vertices = np.concatenate([low.vertices - aside, low.vertices + aside])
    faces = np.concatenate([low.faces, low.faces + len(low.vertices)])
    edge = np.array([[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05], [-0.1, -0.05]])
    one = dataclasses.replace(low, vertices=vertices, faces=faces, region=edge)
    options = PathOptions(kind="helical", stepdown=2e-3)
    path = make_contact_path(one, 0.005, options)
    check(one, 0.005, path, options)
    air = np.flatnonzero(~path.working)[1:]
    lifts = air[path.centre[air, 2] > 0.009]
    assert len(lifts) == 2 * path.loop.max()
    assert path.centre[lifts, 2].min() >= 0.005 + options.lift - 1e-9
    deep = [float(path.point[(path.loop == k) & path.working, 2].min()) for k in range(path.loop.max() + 1)]
    assert (np.diff(deep) < 1e-6).all()  # both of a level before the next level


def test_what_cannot_be_a_path_is_refused_by_name() -> None:
    one = bowl(0.03, 0.01, count=60, walls=16)

    def code(face: FormingPass, options: PathOptions, radius: float = 0.005) -> set[str]:
        with pytest.raises(TandemError) as caught:
            make_contact_path(face, radius, options)
        return {issue.code for issue in caught.value.issues}

    for wrong in (
        PathOptions(stepdown=0.0),
        PathOptions(stepdown=None),
        PathOptions(stepdown=1e-3, scallop=1e-5),
        PathOptions(stepdown=1e-7),
        PathOptions(stepdown=None, scallop=0.01),
        PathOptions(chord=0.0),
        PathOptions(longest=float("nan")),
    ):
        assert code(one, wrong) == {"forming.path_options"}
    assert code(one, PathOptions(), radius=0.0) == {"forming.path_options"}
    assert code(dataclasses.replace(one, end=0.01), PathOptions()) == {"forming.path_options"}
    away = dataclasses.replace(one, region=one.region + 1.0)
    assert code(away, PathOptions()) == {"forming.no_contour"}
    torn = dataclasses.replace(one, faces=np.delete(one.faces, 500, axis=0))
    assert code(torn, PathOptions()) == {"forming.open_contour"}


def test_the_nearest_place_is_that_of_another_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """As trimesh finds it on all triangles, for places above and below a cone and far beside it; also where
    pairs are counted, and places are looked at in halves."""
    one = cone(0.04, 0.02, 0.8, 0.01)
    low, high = one.vertices.min(axis=0) - 0.02, one.vertices.max(axis=0) + 0.02
    points = np.random.default_rng(9).uniform(low, high, (80, 3))
    face = contact.ContactFace(TriangleMesh(one.vertices, one.faces), 0.008)
    corners = one.vertices[one.faces]
    each = [trimesh.triangles.closest_point(corners, np.tile(p, (len(corners), 1))) - p for p in points]
    expected = np.linalg.norm(each, axis=2).min(axis=1)
    whole = face.touched(points, 1e-4)
    row, _, _, place, apart = whole
    first = np.searchsorted(row, np.arange(len(points)))
    np.testing.assert_allclose(apart[first], expected, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(points[row] - place, axis=1), apart, atol=1e-12)
    assert (apart <= apart[first][row] + 1e-4).all()
    monkeypatch.setattr(contact, "_MAX_PAIRS", 500)
    for got, known in zip(face.touched(points, 1e-4), whole, strict=True):
        assert np.array_equal(got, known)
