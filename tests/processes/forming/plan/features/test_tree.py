"""Feature trees of parts whose features are known by construction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from shapely.geometry import Point, Polygon

from planner.geometry.arrays import FloatArray, Mesh
from planner.issues import TandemError
from planner.processes.forming.plan.features.surface import plan_area
from planner.processes.forming.plan.features.tree import (
    FeatureTree,
    build_feature_tree,
    custom_order,
    in_place_order,
    virgin_sheet_order,
)
from tests.processes.forming.plan.nests import Nest, dome, frustum, over, random_nest, revolved, sheet

STEPS = (1e-3, 5e-4, 1e-4)
MM = 1e-3


def differences(nest: Nest, tree: FeatureTree) -> list[str]:
    """Return the differences between a tree and the true features, empty if there are none."""
    if len(tree.features) != len(nest.truth):
        return [f"{len(tree.features)} features, true are {len(nest.truth)}"]
    wrong = []
    match: dict[int, int] = {}
    for index, truth in enumerate(nest.truth):
        fits = [
            f.id
            for f in tree.features
            if f.kind == truth.kind
            and abs(f.start - truth.start) < 0.1 * MM
            and abs(f.end - truth.end) < max(0.1 * MM, 0.05 * abs(truth.end - truth.start))
            and Polygon(f.region).contains(Point(truth.middle))
            and abs(np.sqrt(Polygon(f.region).area / np.pi) - truth.radius) < 0.1 * truth.radius + 1.5 * MM
        ]
        if len(fits) != 1:
            wrong.append(f"{truth} is found {len(fits)} times")
        else:
            match[index] = fits[0]
    for index, number in match.items():
        parent = nest.truth[index].parent
        if tree.feature(number).parent != (None if parent is None else match.get(parent)):
            wrong.append(f"feature {number} has the wrong parent")
    return wrong if len(set(match.values())) == len(match) or wrong else ["two truths in one feature"]


def outline(tree: FeatureTree) -> list[tuple[int | None, str, float, float]]:
    """Parent, kind, start and end [mm] to a tenth of each feature."""
    return [(f.parent, f.kind, round(f.start / MM, 1), round(f.end / MM, 1)) for f in tree.features]


def ten_features(x: FloatArray, y: FloatArray) -> FloatArray:
    """A dish with six domes up and three dimples down in its floor."""
    z = -frustum(x, y, (0.0, 0.0), 90 * MM, 20 * MM, 60.0)
    for k in range(6):
        a = k * np.pi / 3.0
        z = z + dome(x, y, (50 * MM * np.cos(a), 50 * MM * np.sin(a)), 14 * MM, 8 * MM)
    for k in range(3):
        a = k * 2.0 * np.pi / 3.0 + 0.3
        z = z - frustum(x, y, (22 * MM * np.cos(a), 22 * MM * np.sin(a)), 9 * MM, 4 * MM, 50.0)
    return np.asarray(z)


@pytest.fixture(scope="module")
def dish() -> Mesh:
    return sheet(ten_features, 100 * MM, 1.25 * MM, noise=5e-6)


@pytest.mark.parametrize("step", STEPS)
def test_a_cone_is_one_feature_with_its_closed_form_contours(step: float) -> None:
    mesh = revolved([(60 * MM, 0.0), (50 * MM, 0.0), (20 * MM, -30 * MM), (0.0, -30 * MM)])
    tree = build_feature_tree(mesh, step)
    assert outline(tree) == [(None, "concave", 0.0, -30.0)]
    (feature,) = tree.features
    assert len(feature.contours) == round(30 * MM / step) + 1
    polygon = 0.5 * 96 * np.sin(2.0 * np.pi / 96)  # area of a 96-gon over the square of its radius
    for level, line in zip(feature.levels, feature.contours, strict=True):
        assert (line[:, 2] == level).all()
        assert (line[0] == line[-1]).all()
        assert plan_area(line) == pytest.approx(polygon * (50 * MM + level) ** 2, rel=1e-9)
    assert np.all(np.diff(feature.levels) < 0.0)
    assert np.allclose(feature.levels[1:-1], -step * np.arange(1, len(feature.levels) - 1))
    assert plan_area(feature.region) == pytest.approx(polygon * (50 * MM) ** 2, rel=1e-3)


def test_a_cone_with_a_tip_ends_at_the_tip() -> None:
    tree = build_feature_tree(revolved([(60 * MM, 3 * MM), (50 * MM, 3 * MM), (0.0, 43 * MM)]), 1e-3)
    assert tree.level == 3 * MM
    assert outline(tree) == [(None, "convex", 3.0, 43.0)]
    assert tree.features[0].end == 43 * MM
    assert tree.features[0].levels[-1] > 42.99 * MM


@pytest.mark.parametrize("step", STEPS)
def test_a_dish_with_six_domes_and_three_dimples_has_ten_features(dish: Mesh, step: float) -> None:
    tree = build_feature_tree(dish, step)
    expected = [(None, "concave", 0.0, -20.0)]
    expected += [(1, "convex", -20.0, -12.0)] * 6 + [(1, "concave", -20.0, -24.0)] * 3
    assert outline(tree) == expected
    assert tree.features[0].children == tuple(range(2, 11))
    assert not tree.issues
    # what the features do to the sheet adds up to the part
    assert np.abs(tree.level + tree.displacement.sum(axis=0) - dish.vertices[:, 2]).max() < 50e-6
    # every contour lies on the part
    part = LinearNDInterpolator(dish.vertices[:, :2], dish.vertices[:, 2])
    for feature in tree.features:
        for line in feature.contours[1:-1]:
            assert np.abs(part(line[:, 0], line[:, 1]) - line[:, 2]).max() < 20e-6
            assert Polygon(line).is_valid


@pytest.mark.parametrize("step", STEPS)
def test_a_stepped_dish_is_two_features_also_where_its_terrace_is_at_a_level(step: float) -> None:
    profile = [(60, 0), (50, 0), (45, -5), (30, -5), (20, -15), (0, -15)]
    tree = build_feature_tree(revolved([(r * MM, z * MM) for r, z in profile]), step)
    assert outline(tree) == [(None, "concave", 0.0, -5.0), (1, "concave", -5.0, -15.0)]
    assert plan_area(tree.features[1].region) == pytest.approx(np.pi * (30 * MM) ** 2, rel=2e-3)


@pytest.mark.parametrize("angle", [1.0, 2.0, 2.5])
@pytest.mark.parametrize("noise", [0.0, 5e-6])
def test_a_terrace_that_slopes_ends_where_the_next_wall_begins(angle: float, noise: float) -> None:
    """Else some of it is in the feature of that wall, whose first loop is then off its outline and lost."""
    low = -5 - 15 * np.tan(np.radians(angle))
    profile = [(60, 0), (50, 0), (45, -5), (40, -5 + (low + 5) / 3), (30, low), (20, low - 10), (0, low - 10)]
    made = revolved([(r * MM, z * MM) for r, z in profile])
    up = noise * np.random.default_rng(3).uniform(-1.0, 1.0, len(made.vertices))
    off = np.abs(made.vertices[:, 2]) > 1e-9
    mesh = Mesh(made.vertices + np.column_stack([0.0 * up, 0.0 * up, off * up]), made.faces)
    first, second = build_feature_tree(mesh, 5e-4).features
    assert first.end == second.start == pytest.approx(low * MM, abs=1e-9 + 2.0 * noise)
    assert plan_area(second.region) == pytest.approx(np.pi * (30 * MM) ** 2, rel=3e-3)


@pytest.mark.parametrize("step", STEPS)
def test_a_dimple_alone_in_a_floor_is_a_feature(step: float) -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        return -frustum(x, y, (0, 0), 60 * MM, 10 * MM, 50.0) - frustum(
            x, y, (20 * MM, 9 * MM), 10 * MM, MM, 40.0
        )

    tree = build_feature_tree(sheet(height, 70 * MM, 1.5 * MM, noise=5e-6), step)
    assert outline(tree) == [(None, "concave", 0.0, -10.0), (1, "concave", -10.0, -11.0)]


def test_walls_without_a_flat_between_them_are_one_feature() -> None:
    profile = [(60, 0), (50, 0), (45, -10), (35, -15), (30, -25), (0, -25)]  # 63, 27 and 63 degrees
    tree = build_feature_tree(revolved([(r * MM, z * MM) for r, z in profile]), 1e-3)
    assert outline(tree) == [(None, "concave", 0.0, -25.0)]


@pytest.mark.parametrize("step", STEPS)
def test_a_saddle_splits_a_feature(step: float) -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        pockets = [frustum(x, y, (c * MM, 0.0), 25 * MM, 15 * MM, 45.0) for c in (-15.0, 15.0)]
        return -np.maximum(*pockets)

    line = np.linspace(-60 * MM, 60 * MM, 121)
    tree = build_feature_tree(over(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2), height), step)
    # cones of 45 degrees meet half-way, 15 mm from their axes, 10 mm deep
    assert outline(tree) == [
        (None, "concave", 0.0, -10.0),
        (1, "concave", -10.0, -15.0),
        (1, "concave", -10.0, -15.0),
    ]
    assert [issue.code for issue in tree.issues] == ["forming.touching"]


@pytest.mark.parametrize("step", STEPS)
def test_loops_that_merge_are_a_dome_on_a_slope(step: float) -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        return -frustum(x, y, (0, 0), 60 * MM, 30 * MM, 30.0) + dome(x, y, (30 * MM, 0.0), 12 * MM, 9 * MM)

    tree = build_feature_tree(sheet(height, 70 * MM, MM, noise=5e-6), step)
    (wall, bump) = tree.features
    assert (wall.kind, bump.kind, bump.parent) == ("concave", "convex", 1)
    assert (wall.start, wall.end) == pytest.approx((0.0, -30 * MM), abs=0.02 * MM)
    # above it the dome's edge lies 18 mm from the dish's, 10.4 mm deep; facets fill part of the crease
    assert -10.4 * MM < bump.start < -9.5 * MM
    assert wall.end < bump.start < bump.end


@pytest.mark.parametrize("step", STEPS)
def test_an_island_in_a_groove_rises_above_the_sheet(step: float) -> None:
    profile = [(60, 0), (50, 0), (44, -10), (36, -10), (20, 4), (0, 4)]
    tree = build_feature_tree(revolved([(r * MM, z * MM) for r, z in profile]), step)
    assert outline(tree) == [(None, "concave", 0.0, -10.0), (1, "convex", -10.0, 4.0)]


@pytest.mark.parametrize("step", STEPS)
def test_a_groove_of_uneven_depth_is_one_feature(step: float) -> None:
    """Below its shallowest place its loops are crescents."""

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        away, deep = np.hypot(x, y), 8 * MM + 40e-3 * x
        wall = np.minimum((50 * MM - away), np.maximum(away - 20 * MM, 0.0))
        return -np.clip(np.minimum(wall, deep), 0.0, None)

    tree = build_feature_tree(sheet(height, 60 * MM, MM), step)
    groove, island = tree.features
    assert (groove.kind, groove.end) == ("concave", pytest.approx(-9.75 * MM, abs=0.4 * MM))
    assert (island.kind, island.end) == ("convex", pytest.approx(0.0, abs=0.01 * MM))
    assert island.start == pytest.approx(-6.5 * MM, abs=0.5 * MM)


@pytest.mark.parametrize("step", STEPS)
def test_both_sides_of_the_sheet_are_formed(step: float) -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        up, down = (frustum(x, y, (c * MM, 0.0), 25 * MM, 12 * MM, 60.0) for c in (-35.0, 35.0))
        return up - down

    tree = build_feature_tree(sheet(height, 75 * MM, 1.5 * MM, noise=5e-6), step)
    assert sorted(outline(tree)) == [(None, "concave", 0.0, -12.0), (None, "convex", 0.0, 12.0)]
    assert tree.roots == (1, 2)


@pytest.mark.parametrize("step", STEPS)
def test_what_is_lower_than_a_step_is_found(step: float) -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        small = dome(x, y, (20 * MM, 0.0), 8 * MM, 0.3 * MM) - dome(x, y, (-20 * MM, 0.0), 8 * MM, 0.25 * MM)
        return -frustum(x, y, (0, 0), 50 * MM, 9.97 * MM, 60.0) + small

    tree = build_feature_tree(sheet(height, 60 * MM, MM), step)
    assert [(f.parent, f.kind) for f in tree.features] == [(None, "concave"), (1, "convex"), (1, "concave")]
    assert [abs(f.end - f.start) / MM for f in tree.features] == pytest.approx([9.97, 0.3, 0.25], abs=0.01)
    assert all(len(f.contours) >= 2 for f in tree.features)


@pytest.mark.parametrize("step", STEPS)
def test_vertical_walls_have_loops_that_coincide(step: float) -> None:
    profile = [(60, 0), (50, 0), (50, -20), (30, -20), (30, -8), (0, -8)]
    tree = build_feature_tree(revolved([(r * MM, z * MM) for r, z in profile]), step)
    assert outline(tree) == [(None, "concave", 0.0, -20.0), (1, "convex", -20.0, -8.0)]
    for feature, radius in zip(tree.features, (50, 30), strict=True):
        for line in feature.contours:
            assert np.hypot(line[:, 0], line[:, 1]).max() == pytest.approx(radius * MM)


def test_a_ridge_of_few_facets_and_one_that_climbs_and_parts() -> None:
    """A roof over a rectangle, of six facets; and a ridge whose crest dips in its middle."""
    corners = [(-40, -20, 0), (40, -20, 0), (40, 20, 0), (-40, 20, 0), (-20, 0, 12), (20, 0, 12)]
    roof = [(0, 1, 5), (0, 5, 4), (1, 2, 5), (2, 3, 4), (2, 4, 5), (3, 0, 4)]
    tree = build_feature_tree(Mesh(np.array(corners) * MM, np.array(roof)), 1e-3)
    assert outline(tree) == [(None, "convex", 0.0, 12.0)]
    (feature,) = tree.features
    for level, line in zip(feature.levels, feature.contours, strict=True):
        part = level / (12 * MM)
        assert plan_area(line) == pytest.approx(
            (80 - 40 * part) * (40 - 40 * part) * MM**2, rel=1e-6, abs=1e-12
        )

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        crest = 8 * MM + 4 * MM * np.clip(np.abs(x) / (20 * MM), 0.0, 1.0)
        ends = np.clip(40 * MM - np.abs(x), 0.0, 20 * MM) / (20 * MM)
        return np.asarray(np.clip(crest * ends * (1.0 - np.abs(y) / (20 * MM)), 0.0, None))

    line = np.linspace(-60 * MM, 60 * MM, 121)
    tree = build_feature_tree(over(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2), height), 1e-3)
    assert outline(tree) == [(None, "convex", 0.0, 8.0), (1, "convex", 8.0, 12.0), (1, "convex", 8.0, 12.0)]


def test_a_ledge_along_half_of_a_wall_does_no_harm_to_the_contours() -> None:
    """Its level is a slicing level."""

    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        z = frustum(x, y, (0.0, 0.0), 50 * MM, 20 * MM, 55.0)
        return -np.where(x > 0.0, np.minimum(z, np.maximum(10 * MM, z - 12 * MM)), z)

    tree = build_feature_tree(sheet(height, 60 * MM, MM, noise=5e-6), 1e-3)
    assert tree.features[0].start == pytest.approx(0.0, abs=0.01 * MM)
    assert min(feature.end for feature in tree.features) == pytest.approx(-20 * MM, abs=0.02 * MM)
    assert all(feature.kind == "concave" for feature in tree.features)
    assert all(Polygon(line).is_valid for feature in tree.features for line in feature.contours)


def test_a_part_without_flat_around_it() -> None:
    tree = build_feature_tree(revolved([(50 * MM, 0.0), (20 * MM, -30 * MM), (0.0, -30 * MM)]), 1e-3)
    assert outline(tree) == [(None, "concave", 0.0, -30.0)]


def test_vertices_that_no_face_uses_stay_where_they_are() -> None:
    mesh = revolved([(50 * MM, 0.0), (20 * MM, -30 * MM), (0.0, -30 * MM)])
    padded = Mesh(np.concatenate([[[9.0, 9.0, 9.0]], mesh.vertices]), mesh.faces + 1)
    tree = build_feature_tree(padded, 1e-3)
    assert tree.displacement.shape == (1, len(padded.vertices))
    assert tree.displacement[0, 0] == 0.0
    assert tree.displacement[0, 1:].min() == pytest.approx(-30 * MM)


def test_features_whose_edges_touch_are_named() -> None:
    def height(x: FloatArray, y: FloatArray) -> FloatArray:
        return -frustum(x, y, (-20 * MM, 0), 20 * MM, 9 * MM, 45.0) + frustum(
            x, y, (20 * MM, 0), 20 * MM, 9 * MM, 45.0
        )

    tree = build_feature_tree(sheet(height, 50 * MM, MM), 1e-3)
    assert sorted(outline(tree)) == [(None, "concave", 0.0, -9.0), (None, "convex", 0.0, 9.0)]
    (issue,) = tree.issues
    assert issue.code == "forming.touching"
    assert "touch at (" in issue.message


def refused(mesh: Mesh, step: float = 1e-3) -> str:
    with pytest.raises(TandemError) as caught:
        build_feature_tree(mesh, step)
    return str(caught.value)


def test_undercuts_are_refused_with_their_place() -> None:
    profile = [(60, 0), (50, 0), (51, -20), (0, -20)]
    text = refused(revolved([(r * MM, z * MM) for r, z in profile]))
    assert "forming.undercut" in text
    assert "92.9 deg" in text


def test_holes_edges_off_the_sheet_and_pieces_are_refused() -> None:
    cone = revolved([(60 * MM, 0.0), (50 * MM, 0.0), (20 * MM, -30 * MM), (0.0, -30 * MM)])
    assert "forming.hole" in refused(Mesh(cone.vertices, cone.faces[:-96]))
    tilted = cone.vertices.copy()
    tilted[:, 2] += 0.01 * tilted[:, 0]
    text = refused(Mesh(tilted, cone.faces))
    assert "forming.border" in text
    assert "0.600 mm away" in text
    twice = np.concatenate([cone.vertices, cone.vertices + np.array([0.2, 0.0, 0.0])])
    assert "mesh.pieces" in refused(
        Mesh(twice, np.concatenate([cone.faces, cone.faces + len(cone.vertices)]))
    )
    mixed = cone.faces.copy()
    mixed[5] = mixed[5, ::-1]
    assert "mesh.orientation" in refused(Mesh(cone.vertices, mixed))
    lid = np.array([[0, k + 1, k] for k in range(1, 95)])
    assert "mesh.closed" in refused(Mesh(cone.vertices, np.concatenate([cone.faces, lid[:, ::-1]])))


def test_pieces_that_share_one_point_cannot_be_told_apart() -> None:
    cone = revolved([(50 * MM, 0.0), (20 * MM, -30 * MM), (0.0, -30 * MM)])
    other = cone.faces + len(cone.vertices)
    other[other == len(cone.vertices) + 48] = 0  # its leftmost point is the first one's rightmost
    both = np.concatenate([cone.vertices, cone.vertices + np.array([0.1, 0.0, 0.0])])
    assert "forming.touching" in refused(Mesh(both, np.concatenate([cone.faces, other])))


def test_features_that_lie_over_each_other_are_refused() -> None:
    """A strip that goes round by more than a whole turn, with a dome at each end."""
    line = np.stack(np.meshgrid(np.linspace(0.0, 420.0, 421), np.linspace(40, 80, 41)), axis=-1).reshape(
        -1, 2
    )
    turned = np.radians(line[:, 0])
    mesh = over(line, lambda a, r: sum(dome(a, r, (c, 60.0), 14.0, 5.0) for c in (25.0, 390.0)))  # type: ignore[return-value]
    round_ = np.column_stack([line[:, 1] * np.cos(turned), line[:, 1] * np.sin(turned), mesh.vertices[:, 2]])
    text = refused(Mesh(round_ * MM, mesh.faces))
    assert "forming.touching" in text
    assert "overlap" in text


def test_bumps_of_a_noisy_floor_are_no_features_by_the_place_where_they_part() -> None:
    """Heights off by up to 0.05 mm either way: from the lowest place of the floor to its highest is 0.1 mm,
    from the floor's own level to either no more than the noise of 0.07 mm."""
    for seed in range(6):
        part = sheet(
            lambda x, y: -frustum(x, y, (0.0, 0.0), 25 * MM, 6 * MM, 50.0), 0.035, 2e-3, seed, 0.05 * MM
        )
        (one,) = build_feature_tree(part, 5e-4, 0.07 * MM).features
        assert (one.start, one.end) == pytest.approx((0.0, -6 * MM), abs=0.05 * MM)


def test_noise_is_no_feature_and_a_flat_part_is_refused() -> None:
    assert "forming.flat" in refused(sheet(lambda x, y: 0.0 * x, 50 * MM, 2 * MM, noise=20e-6))


@pytest.mark.parametrize("step", [0.0, -1e-3, float("nan"), 1e-9])
def test_steps_that_are_none_are_refused(step: float) -> None:
    assert "forming.step" in refused(revolved([(50 * MM, 0.0), (0.0, -30 * MM)]), step)


def test_strategies_and_orders_of_ones_own(dish: Mesh) -> None:
    tree = build_feature_tree(dish, 1e-3)
    first = in_place_order(tree)
    assert [step.feature for step in first] == list(range(1, 11))
    assert all(step.shift == 0.0 for step in first)
    second = virgin_sheet_order(tree)
    assert [step.feature for step in second] == [*range(2, 11), 1]
    for step in second:
        assert tree.feature(step.feature).start + step.shift == pytest.approx(tree.level, abs=1e-12)
    mixed = custom_order(tree, [5, 1, 10, 9, 8, 7, 6, 4, 3, 2], translated=True)
    assert mixed[0].shift == pytest.approx(20 * MM, abs=0.02 * MM)
    assert all(step.shift == 0.0 for step in mixed[1:])
    for wrong, what in (
        ([*range(2, 11), 1], "feature 2 comes before its parent, feature 1"),
        (list(range(1, 10)), "feature 10 is missing"),
        ([1, 1, *range(2, 11)], "feature 1 is named twice"),
        (list(range(1, 12)), "feature 11 does not exist"),
    ):
        with pytest.raises(TandemError, match=r"forming\.order.*" + what):
            custom_order(tree, wrong)


def test_shifts_in_a_nest_of_three_take_what_is_formed_around() -> None:
    profile = [(60, 0), (50, 0), (45, -10), (35, -10), (30, -4), (22, -4), (18, -9), (0, -9)]
    tree = build_feature_tree(revolved([(r * MM, z * MM) for r, z in profile]), 1e-3)
    assert outline(tree) == [(None, "concave", 0, -10), (1, "convex", -10, -4), (2, "concave", -4, -9)]
    shifts = {step.feature: step.shift / MM for step in custom_order(tree, [1, 3, 2], translated=True)}
    # with the dish done, and the island not yet, the innermost one starts 10 mm below the sheet
    assert shifts == pytest.approx({1: 0.0, 3: -6.0, 2: 0.0}, abs=1e-6)
    assert [step.feature for step in virgin_sheet_order(tree)] == [3, 2, 1]


@pytest.mark.sampled(every=8)
@pytest.mark.parametrize("seed", range(40))
def test_random_nests(seed: int) -> None:
    nest = random_nest(seed)
    assert not differences(nest, build_feature_tree(nest.mesh, STEPS[seed % 3]))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(200))
def test_random_nests_have_the_same_tree_at_every_step(seed: int) -> None:
    nest = random_nest(seed)
    assert [differences(nest, build_feature_tree(nest.mesh, step)) for step in STEPS] == [[], [], []]
