"""The sheet around a pass, and tools that cut into it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.materials import sheet_metal
from planner.processes.forming.plan.contact import ContactPath, FormingPass, PassContact
from planner.processes.forming.plan.features.tree import in_place_order, virgin_sheet_order
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.sheet_state import (
    clearance_issues,
    deepest_penetration,
    descendants,
    sheet_states,
)
from planner.processes.forming.plan.support.modes import MountedSheet, make_mode_path
from planner.tooling import FormingHead, head_outline
from tests.processes.forming.plan.shapes import BALL, T0, cone_path, operation, revolved, tree_of

METAL = sheet_metal("aluminium")
DISH = [(0.12, 0.0), (0.1, 0.0), (0.08, -0.03), (0.03, -0.03), (0.02, -0.02), (0.0, -0.02)]
"""A dish, 30 mm deep, with a dome in its floor, 10 mm high."""


def test_in_place_what_stands_around_is_fixed() -> None:
    part = revolved(DISH)
    tree, _ = tree_of(part)
    found = make_passes(tree, in_place_order(tree), part, T0, operation(), METAL)
    first, second = sheet_states(tree, part, found, T0)
    assert descendants(tree, 1) == (2,)
    # before the dish there is flat only, on both faces, outside of it
    assert np.unique(np.round(first.fixed[:, 2], 9)).tolist() == [0.0, T0]
    assert np.hypot(*first.fixed.T[:2]).min() > 0.1 - 1e-3
    assert len(first.carried) == 0
    # at the dome the dish stands, by its closed form, on both faces; not where the dome will be
    r = np.hypot(*second.fixed.T[:2])
    assert r.min() > 0.03 - 1e-3 and len(second.carried) == 0
    z = np.interp(r, [0.08, 0.1], [-0.03, 0.0])
    low = np.abs(second.fixed[:, 2] - z) < 1e-4
    assert np.abs(second.fixed[~low, 2] - z[~low] - T0).max() < 1e-4
    assert 0.45 < low.mean() < 0.55


def test_on_the_virgin_sheet_what_is_inside_is_carried() -> None:
    part = revolved(DISH)
    tree, _ = tree_of(part)
    found = make_passes(tree, virgin_sheet_order(tree), part, T0, operation(repeats=2), METAL)
    assert [one.feature for one in found] == [2, 2, 1, 1]
    state = sheet_states(tree, part, found, T0)
    carried = state[2].carried
    r = np.hypot(*carried.T[:2])
    z = np.interp(r, [0.02, 0.03], [0.01, 0.0])  # as formed on the flat
    assert np.minimum(np.abs(carried[:, 2] - z), np.abs(carried[:, 2] - z - T0)).max() < 1e-4
    # the second time over the dish it is down already and stands still
    assert len(state[3].carried) == 0
    down = state[3].fixed[np.hypot(*state[3].fixed.T[:2]) < 0.02]
    assert np.allclose(np.unique(np.round(down[:, 2], 6)), [-0.02, -0.02 + T0])


def test_depth_of_a_cut_by_closed_form() -> None:
    ball = np.array([[0.0, 0.0, 0.0]])
    down = np.array([[0.0, 0.0, -1.0]])
    outline = head_outline(FormingHead("ball", 0.01, 0.01, 0.0, 0.1))
    for point, depth in (
        ([0.0, 0.0, -0.008], 0.002),
        ([0.006, 0.0, 0.0], 0.004),
        ([0.0, 0.009, 0.05], 0.001),
        ([0.0, 0.0, -0.011], None),
        ([0.011, 0.0, 0.05], None),
    ):
        found = deepest_penetration(ball, down, outline, np.array([point]))
        if depth is None:
            assert found is None
        else:
            assert found is not None and found.depth == pytest.approx(depth, abs=3e-5)
    # between two targets, and leaning: the shaft, not the ball
    along = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]])
    tilt = np.tile([np.sin(0.5), 0.0, -np.cos(0.5)], (2, 1))
    spot = np.array([[-0.05 * np.sin(0.5), 0.008, 0.05 * np.cos(0.5)]])
    found = deepest_penetration(along, tilt, outline, spot)
    assert found is not None and found.depth == pytest.approx(0.002, abs=1e-4) and found.index == 0


@pytest.mark.parametrize("seed", range(6))
def test_depth_along_a_winding_way_is_that_of_the_capsule(seed: int) -> None:
    rng = np.random.default_rng(seed)
    place = np.cumsum(rng.normal(0.0, 0.004, (120, 3)), axis=0)
    axis = np.cumsum(rng.normal(0.0, 0.03, (120, 3)), axis=0) - [0.0, 0.0, 1.0]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    points = place.mean(axis=0) + rng.normal(0.0, 0.08, (60, 3))
    outline = head_outline(FormingHead("ball", 0.006, 0.006, 0.0, 0.08))
    # a ball on a shaft of its own radius is a capsule that is cut off
    fraction = np.linspace(0.0, 1.0, 40, endpoint=False)[:, None, None]
    centre = (place[:-1] + fraction * np.diff(place, axis=0)).reshape(-1, 3)
    way = (axis[:-1] + fraction * np.diff(axis, axis=0)).reshape(-1, 3)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    off = points - centre[:, None]
    behind = -np.einsum("npd,nd->np", off, way)
    beside = np.linalg.norm(off + np.maximum(behind, 0.0)[..., None] * way[:, None], axis=-1)
    depth = float(np.where(behind < 0.08, 0.006 - beside, -1.0).max())
    found = deepest_penetration(place, axis, outline, points)
    if depth <= 0.0:
        assert found is None, seed
    else:
        assert found is not None and found.depth == pytest.approx(depth, abs=5e-5), seed


def _dome() -> tuple[FormingPass, ContactPath, list[FormingPass]]:
    part = revolved(DISH, 90)
    tree, _ = tree_of(part)
    found = make_passes(tree, in_place_order(tree), part, T0, operation(), METAL)
    return found[1], cone_path(found[1], 45.0, 0.03, 0.003, 40, 4e-3), list(found)


@pytest.mark.long
def test_a_support_that_meets_the_dish_around_is_found() -> None:
    part = revolved(DISH, 90)
    tree, _ = tree_of(part)
    one, contact, found = _dome()
    state = sheet_states(tree, part, found, T0)[1]
    former = FormingHead("ball", 0.003, 0.003, 0.0, 0.1)
    fits = FormingHead("ball", 0.003, 0.003, 0.0, 0.1)
    wide = FormingHead("ball", 0.003, 0.07, 0.02, 0.04)  # a shaft as wide as the dish, 20 mm behind
    for support, wrong in ((fits, False), (wide, True)):
        path = make_mode_path(PassContact(one, contact), operation(), former, support, MountedSheet(T0))
        profiles = (head_outline(former), head_outline(support))
        issues = clearance_issues(one, path, state, ("left", "right"), profiles, (5e-5, 5e-5))
        assert [(issue.code, issue.arm) for issue in issues] == (
            [("forming.clear", "right")] if wrong else []
        )
        if wrong:
            assert issues[0].value is not None and issues[0].value > 0.5
            assert issues[0].index is not None and "cuts" in issues[0].message


def test_what_is_carried_sinks_with_the_floor() -> None:
    part = revolved(DISH, 90)
    tree, _ = tree_of(part)
    found = make_passes(tree, virgin_sheet_order(tree), part, T0, operation("dpif_p"), METAL)
    state = sheet_states(tree, part, found, T0)[1]
    one = found[1]
    angle = float(np.degrees(np.arctan2(0.03, 0.02)))
    contact = cone_path(one, angle, 0.1, BALL.radius, 72)
    path = make_mode_path(PassContact(one, contact), operation("dpif_p"), BALL, BALL, MountedSheet(T0))
    outlines = (head_outline(BALL), head_outline(BALL))
    assert clearance_issues(one, path, state, ("A", "B"), outlines, (5e-5, 5e-5)) == ()
    # a dome that stands where the ball comes by sinks with it: it is cut by how far the ball is into it
    carried = np.array([[0.08, 0.0, T0 + 0.004]])
    cut = clearance_issues(
        one, path, dataclasses.replace(state, carried=carried), ("A", "B"), outlines, (5e-5, 5e-5)
    )
    assert [issue.code for issue in cut] == ["forming.clear"]
    assert cut[0].value == pytest.approx(4.0, abs=0.3)
