"""Positions of both tools: gaps, shift, clearance of the support, axes; against closed forms on cones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import FloatArray
from planner.issues import Severity, TandemError
from planner.processes.forming.plan.contact import ContactPath, FormingPass, FormingToolPath, PassContact
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.support import opposite
from planner.processes.forming.plan.support.modes import MountedSheet, make_mode_path, support_issues
from planner.tooling import FormingHead
from tests.processes.forming.plan.shapes import (
    BALL,
    T0,
    bowl,
    cone,
    cone_path,
    operation,
    revolved,
    tree_of,
    upside_down,
)

METAL = sheet_metal("aluminium")
SHEET = MountedSheet(T0)
ANGLE, RADIUS, DEPTH = 60.0, 0.1, 0.05
COS, SIN = np.cos(np.radians(ANGLE)), np.sin(np.radians(ANGLE))
SIDES = pytest.mark.parametrize("side", [1, -1])


def plan_cone(side: int, per_loop: int = 150) -> tuple[FormingPass, ContactPath]:
    part = cone(ANGLE, DEPTH, RADIUS, 400)
    tree, order = tree_of(part if side > 0 else upside_down(part))
    (forming_pass,) = make_passes(
        tree, order, part if side > 0 else upside_down(part), T0, operation(), METAL
    )
    return forming_pass, cone_path(forming_pass, ANGLE, RADIUS, BALL.radius, per_loop)


def line(path: FormingToolPath) -> FloatArray:
    assert path.support_centre is not None
    across = path.forming_centre - path.support_centre
    return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))


def tool_distance(path: FormingToolPath) -> FloatArray:
    assert path.support_centre is not None
    return np.asarray(np.linalg.norm(path.forming_centre - path.support_centre, axis=1))


@SIDES
def test_alone_the_former_follows_the_contact(side: int) -> None:
    one, contact = plan_cone(side)
    path = make_mode_path(PassContact(one, contact), operation("spif", lean_deg=20.0), BALL, None, SHEET)
    assert path.support_centre is None and path.support_axis is None
    assert np.array_equal(path.forming_centre, contact.centre)
    # leaning 20 deg from straight onto the sheet, away from the wall
    assert np.allclose(path.axis[:, 2], -side * np.cos(np.radians(20.0)))
    inward = -contact.point[:, :2] / np.linalg.norm(contact.point[:, :2], axis=1, keepdims=True)
    assert np.allclose(path.axis[:, :2], -np.sin(np.radians(20.0)) * inward, atol=1e-9)


@pytest.mark.sampled(every=2)
@SIDES
@pytest.mark.parametrize("squeeze", [1.0, 0.9])
def test_opposite_each_other_the_gap_is_the_squeezed_sine_law(side: int, squeeze: float) -> None:
    one, contact = plan_cone(side)
    small = dataclasses.replace(BALL, radius=0.006)
    path = make_mode_path(PassContact(one, contact), operation("dsif", squeeze=squeeze), BALL, small, SHEET)
    gap = squeeze * T0 * COS
    assert np.allclose(path.gap, gap)
    assert np.allclose(tool_distance(path), BALL.radius + gap + small.radius)
    # below where the flat leaves no room: on the far side along the normal
    deep = side * (one.start - path.contact.point[:, 2]) > small.radius * (1.0 - COS) + T0
    assert deep.mean() > 0.85
    cosine = np.einsum("nd,nd->n", line(path)[deep], side * path.contact.normal[deep])
    turned = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    assert np.median(turned) < 0.1
    assert turned.max() < 8.0 and np.quantile(turned, 0.97) < 2.6  # steadied at the ends of the way
    # the support touches the far face, the near one moved along z, but for the squeeze
    assert path.support_centre is not None
    r = np.hypot(*path.support_centre.T[:2])
    far = one.start - side * T0
    off = COS * (side * (far - path.support_centre[:, 2]) - (RADIUS - r) * np.tan(np.radians(ANGLE)))
    assert np.allclose(off[deep], small.radius - (1.0 - squeeze) * T0 * COS, atol=0.02)
    assert path.support_axis is not None and np.allclose(path.support_axis, [0.0, 0.0, side])


@SIDES
def test_beside_the_flat_the_support_rolls_round_the_former(side: int) -> None:
    one, contact = plan_cone(side)
    path = make_mode_path(PassContact(one, contact), operation(), BALL, BALL, SHEET)
    assert path.support_centre is not None
    far = one.start - side * T0
    over = side * (path.support_centre[:, 2] - far) + BALL.radius
    assert over.max() < 1e-9  # never in the flat
    first = path.contact.loop == 0
    height = side * (path.forming_centre[first, 2] - far) + BALL.radius
    expected = np.arccos(height / (2.0 * BALL.radius + T0 * COS))
    got = np.arccos(side * line(path)[first, 2])
    assert np.allclose(got, expected, atol=np.radians(0.3))
    assert np.all(expected < np.radians(50.0))
    assert support_issues(one, path, operation(), BALL, BALL, T0) == ()


@pytest.mark.sampled(every=2)
@SIDES
def test_moves_that_do_not_keep_the_gap_are_told(side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    one, contact = plan_cone(side, per_loop=24)
    whole = make_mode_path(PassContact(one, contact), operation(), BALL, BALL, SHEET)
    assert whole.unresolved is not None and not whole.unresolved.any()
    monkeypatch.setattr(opposite, "_MAX_SPLIT_ROUNDS", 1)
    path = make_mode_path(PassContact(one, contact), operation(), BALL, BALL, SHEET)
    assert path.unresolved is not None and len(path.forming_centre) < len(whole.forming_centre)
    (issue,) = support_issues(one, path, operation(), BALL, BALL, T0)
    assert issue.code == "forming.gap" and issue.severity is Severity.WARNING
    assert issue.value == path.unresolved.sum() > 0.0
    assert f"on {path.unresolved.sum()} moves between targets, first at (" in issue.message


@SIDES
@pytest.mark.parametrize("shift", [20.0, 80.0])
def test_the_shift_turns_the_support_toward_the_vertical_at_the_same_distance(
    side: int, shift: float
) -> None:
    one, contact = plan_cone(side)
    path = make_mode_path(PassContact(one, contact), operation("dpif_l", shift_deg=shift), BALL, BALL, SHEET)
    assert np.allclose(tool_distance(path), 2.0 * BALL.radius + T0 * COS)
    tilt = np.degrees(np.arccos(np.clip(side * line(path)[:, 2], -1.0, 1.0)))
    deep = side * (one.start - path.contact.point[:, 2]) > BALL.radius
    assert np.allclose(tilt[deep], max(ANGLE - shift, 0.0), atol=0.02)
    # in the plane of the normal and the vertical
    out = np.cross(path.contact.normal, line(path))[:, 2]
    assert np.median(np.abs(out)) < 1e-3
    assert np.abs(out).max() < np.sin(np.radians(2.6))  # steadied at the ends of the way


def test_the_gap_holds_between_targets() -> None:
    one, contact = plan_cone(1, per_loop=40)  # the normal turns by 9 deg from target to target
    path = make_mode_path(PassContact(one, contact), operation(gap_tol_mm=0.02), BALL, BALL, SHEET)
    assert len(path.forming_centre) > 1.8 * len(contact.point)
    assert path.support_centre is not None
    across = path.forming_centre - path.support_centre
    middle = np.linalg.norm(0.5 * (across[1:] + across[:-1]), axis=1) - 2.0 * BALL.radius
    assert np.abs(middle - 0.5 * (path.gap[1:] + path.gap[:-1])).max() < 1e-5
    # the former still goes straight from target to target of before
    radii = np.hypot(*path.forming_centre.T[:2])
    assert radii.max() <= np.hypot(*contact.centre.T[:2]).max() + 1e-9


def test_in_the_air_the_support_draws_back() -> None:
    one, contact = plan_cone(1)
    lift = contact.centre[100:102] + np.array([0.0, 0.0, 0.03])
    contact = dataclasses.replace(
        contact,
        centre=np.insert(contact.centre, [101, 101], lift, axis=0),
        point=np.insert(contact.point, [101, 101], contact.point[100:102], axis=0),
        normal=np.insert(contact.normal, [101, 101], contact.normal[100:102], axis=0),
        angle=np.insert(contact.angle, [101, 101], contact.angle[100:102]),
        loop=np.insert(contact.loop, [101, 101], contact.loop[100:102]),
        working=np.insert(contact.working, [101, 101], False),
    )
    path = make_mode_path(PassContact(one, contact), operation(), BALL, BALL, SHEET)
    assert path.support_centre is not None
    air = np.isnan(path.gap)
    assert air.sum() == 2
    assert np.all(path.support_centre[air, 2] < one.end - T0 - BALL.radius)
    rows = np.flatnonzero(air)
    assert np.allclose(path.support_centre[rows[0], :2], path.support_centre[rows[0] - 1, :2])
    assert np.allclose(path.support_centre[rows[1], :2], path.support_centre[rows[1] + 1, :2])


@pytest.mark.long
def test_a_hollow_tighter_than_the_support_turns_it_aside_with_a_warning() -> None:
    # a wall of 30 deg that bends into one of 60 deg leaves a hollow below, at z = -20 mm
    rings = [(0.12, 0.0), (0.1, 0.0), (0.1 - 0.01 / np.tan(np.radians(60.0)), -0.01)]
    rings += [(rings[-1][0] - 0.01 / np.tan(np.radians(30.0)), -0.02)]
    rings += [(rings[-1][0] - 0.03 / np.tan(np.radians(60.0)), -0.05), (0.0, -0.05)]
    part = revolved(rings, 150)
    tree, order = tree_of(part)
    found = make_passes(tree, order, part, T0, operation(), METAL)
    one = found[0]
    # by closed form only along the last wall
    z = np.arange(-0.0215, -0.035, -0.0005)
    turn = np.linspace(0.0, 2.0 * np.pi, 46)
    level, phi = (grid.reshape(-1) for grid in np.meshgrid(z, turn, indexing="ij"))
    r = rings[3][0] - (-0.02 - level) * np.tan(np.radians(30.0))
    normal = np.column_stack([-SIN * np.cos(phi), -SIN * np.sin(phi), np.full(len(phi), COS)])
    point = np.column_stack([r * np.cos(phi), r * np.sin(phi), level + T0])
    flat = np.full(len(phi), np.radians(60.0))
    loops = np.repeat(np.arange(len(z)), len(turn))
    lower = ContactPath(point, normal, point + BALL.radius * normal, flat, loops, np.ones(len(phi), bool))
    # and what is above it is formed already: the ball was at it
    level = np.repeat(np.arange(-0.0105, -0.0195, -0.0005), len(turn))
    phi = np.tile(turn, len(level) // len(turn))
    r = rings[2][0] - (-0.01 - level) * np.tan(np.radians(60.0))
    up = np.column_stack([-0.5 * np.cos(phi), -0.5 * np.sin(phi), np.full(len(phi), np.sqrt(0.75))])
    place = np.column_stack([r * np.cos(phi), r * np.sin(phi), level + T0])
    both = ContactPath(
        np.concatenate([place, lower.point]),
        np.concatenate([up, lower.normal]),
        np.concatenate([place + BALL.radius * up, lower.centre]),
        np.concatenate([np.full(len(phi), np.radians(30.0)), lower.angle]),
        np.concatenate([np.zeros(len(phi), np.int64), lower.loop + 1]),
        np.ones(len(phi) + len(lower.point), bool),
    )
    path = make_mode_path(PassContact(one, both), operation(), BALL, BALL, SHEET)
    assert path.support_centre is not None
    # the far face of the 30 deg wall, as a cone: the ball stays below it
    slope = np.tan(np.radians(30.0))
    height = -0.01 - (rings[2][0] - np.hypot(*path.support_centre.T[:2])) * slope - path.support_centre[:, 2]
    under = path.contact.loop > 0
    beside = under & (np.hypot(*path.support_centre.T[:2]) > rings[3][0] + 0.005)
    assert beside.any()
    assert np.all(height[beside] * np.cos(np.radians(30.0)) > BALL.radius - 4e-4)
    (issue,) = support_issues(one, path, operation(), BALL, BALL, T0)
    assert issue.code == "forming.support_radius" and issue.severity is Severity.WARNING
    assert issue.limit is not None and issue.limit < BALL.radius * 1e3
    assert "largest that fits" in issue.message
    tiny = dataclasses.replace(BALL, radius=issue.limit * 0.8e-3)
    assert (
        support_issues(
            one,
            make_mode_path(PassContact(one, both), operation(), BALL, tiny, SHEET),
            operation(),
            BALL,
            tiny,
            T0,
        )
        == ()
    )


@pytest.mark.sampled(every=2)
@SIDES
def test_heat_comes_from_opposite(side: int) -> None:
    one, contact = plan_cone(side)
    nozzle = FormingHead("heat", 0.01, 0.01, 0.0, 0.1, 0.0, 0.03)
    path = make_mode_path(PassContact(one, contact), operation("heat"), BALL, nozzle, SHEET)
    assert path.support_centre is not None and path.support_axis is not None
    contact = path.contact
    far = contact.point - side * T0 * COS * contact.normal
    # the nozzle follows the smooth face: about the ball's centre it is off by what corners are rounded
    assert np.linalg.norm(path.support_centre - far, axis=1).max() < np.deg2rad(2.5) * (BALL.radius + T0)
    deep = side * (one.start - contact.point[:, 2]) > 0.02
    deviation = np.einsum("nd,nd->n", path.support_axis[deep], side * contact.normal[deep])
    assert np.rad2deg(np.arccos(np.clip(deviation, -1.0, 1.0))).max() < 3.0
    turn = np.einsum("nd,nd->n", path.support_axis[1:], path.support_axis[:-1])
    assert np.rad2deg(np.arccos(np.clip(turn, -1.0, 1.0))).max() < 1.01
    # the nozzle's edge stays under the flat
    behind = path.support_centre - 0.03 * path.support_axis
    top = side * behind[:, 2] + 0.01 * np.hypot(*path.support_axis.T[:2])
    assert np.all(top <= side * (one.start - side * T0) + 1e-9)


def test_tools_that_a_mode_cannot_use_are_refused() -> None:
    one, contact = plan_cone(1)
    disk = FormingHead("disk", 0.03, 0.01, 0.01, 0.1, 0.002)
    for mode, former, support in (
        ("dsif", BALL, disk),
        ("dsif", disk, BALL),
        ("heat", BALL, BALL),
        ("dsif", BALL, None),
    ):
        with pytest.raises(TandemError) as caught:
            make_mode_path(PassContact(one, contact), operation(mode), former, support, SHEET)
        assert [issue.code for issue in caught.value.issues] == ["forming.support_tool"]


def test_a_thinned_floor_has_the_gap_that_its_thickness_wants() -> None:
    part = bowl(0.05, 60.0, 200)
    tree, order = tree_of(part)
    (forming_pass,) = make_passes(tree, order, part, T0, operation(), METAL)
    thin = dataclasses.replace(forming_pass, thickness=0.5 * forming_pass.thickness)
    phi = np.linspace(0.0, 2.0 * np.pi, 200)
    a = np.radians(35.0)
    toward = np.column_stack([-np.sin(a) * np.cos(phi), -np.sin(a) * np.sin(phi), np.full(200, np.cos(a))])
    centre = np.array([0.0, 0.0, T0 + 0.05 * np.cos(np.radians(60.0))])
    point = centre - 0.05 * toward
    contact = ContactPath(
        point,
        toward,
        point + BALL.radius * toward,
        np.full(200, a),
        np.zeros(200, np.int64),
        np.ones(200, bool),
    )
    whole = make_mode_path(PassContact(forming_pass, contact), operation(), BALL, BALL, SHEET)
    half = make_mode_path(PassContact(thin, contact), operation(), BALL, BALL, SHEET)
    assert np.allclose(whole.gap, T0 * np.cos(a), rtol=2e-3)
    assert np.allclose(half.gap, 0.5 * T0 * np.cos(a), rtol=2e-3)
