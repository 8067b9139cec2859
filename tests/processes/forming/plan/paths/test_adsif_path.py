"""Paths of both tools in ADSIF against the table and the formulas of its source."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from planner.catalogue.materials import sheet_metal
from planner.geometry.arrays import FloatArray, Mesh
from planner.issues import TandemError
from planner.processes.forming.plan.contact import FormingPass, FormingToolPath
from planner.processes.forming.plan.passes import make_passes
from planner.processes.forming.plan.paths.adsif_path import adsif_tool_path, support_press_depth
from planner.processes.forming.plan.paths.adsif_response import built_in_table, formed_wall_angle
from planner.tooling import FormingHead
from tests.processes.forming.plan.shapes import T0, cone, operation, revolved, tree_of, upside_down

METAL = sheet_metal("aa5754_o")
BALL = FormingHead("ball", 0.005, 0.005, 0.0, 0.1)


def plan_path(part: Mesh, **more: object) -> tuple[FormingPass, FormingToolPath]:
    op = operation("adsif", **more)
    tree, order = tree_of(part)
    (forming_pass,) = make_passes(tree, order, part, T0, op, METAL)
    return forming_pass, adsif_tool_path(forming_pass, op, BALL, BALL, T0, METAL)


def seen(path: FormingToolPath, side: int) -> tuple[FloatArray, FloatArray]:
    """Position angle [rad] and gap [m] of the tools as they are."""
    assert path.support_centre is not None
    across = path.forming_centre - path.support_centre
    outward = -np.einsum("nd,nd->n", across[:, :2], path.forming_centre[:, :2])
    assert np.all(outward > 0.0)  # the support is farther out
    th = np.arctan2(np.linalg.norm(across[:, :2], axis=1), side * across[:, 2])
    return th, np.linalg.norm(across, axis=1) - 2.0 * BALL.radius


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("kind", ["helical", "contour"])
@pytest.mark.parametrize("prefer", ["angle", "gap"])
def test_a_cone_is_formed_at_the_angle_of_the_table(side: int, kind: str, prefer: str) -> None:
    part = cone(30.0, 0.012, 0.04, 300)
    one, path = plan_path(part if side > 0 else upside_down(part), path=kind, adsif={"prefer": prefer})
    th, gap = seen(path, side)
    formed = np.degrees(formed_wall_angle(built_in_table(), th, gap / T0))
    assert np.abs(formed - 30.0).max() < 0.1
    assert np.allclose(gap, path.gap)
    # at the sheet's level all the time, and from the inside out by the pitch
    assert np.ptp(path.forming_centre[:, 2]) < 1e-12
    tip = path.forming_centre[:, 2] - side * BALL.radius
    assert np.allclose(side * (one.start - tip), 1.6e-3)
    r = np.hypot(*path.forming_centre.T[:2])
    inner = 0.04 - 0.012 / np.tan(np.radians(30.0))
    lost = BALL.radius * np.sin(np.radians(30.0))
    assert r[0] == pytest.approx(inner - lost, abs=1e-4) and r[-1] == pytest.approx(0.04 - lost, abs=3e-4)
    mean = np.array([r[path.contact.loop == number].mean() for number in range(path.contact.loop.max() + 1)])
    between = np.diff(mean)[2:-2]
    assert np.abs(between - 0.2e-3).max() < 5e-6


def test_the_support_presses_the_flat_as_the_table_has_it() -> None:
    """At 55 degrees, the largest position angle of the table, with gaps of 0.7 to 0.8 of 1 mm, and balls of 5
    mm: 1 - 1.6 + 10 - (10 + Tg) cos 55 mm is between 3.20 and 3.27 mm, by the source's own formula."""
    most = support_press_depth(operation("adsif", adsif={"prefer": "gap"}), 0.01, T0)
    assert 3.20e-3 < most < 3.27e-3
    one, path = plan_path(cone(26.0, 0.008, 0.04, 240), adsif={"prefer": "gap"})
    assert path.support_centre is not None
    pressed = path.support_centre[:, 2].max() + BALL.radius - (one.start - T0)
    assert 1.65e-3 < pressed <= most


def test_walls_that_vary_get_tools_that_vary() -> None:
    r = np.linspace(0.06, 0.03, 31)
    steep, shallow = np.tan(np.radians(34.0)), np.tan(np.radians(26.0))
    z = -np.minimum(0.06 - r, 0.015) * steep - np.maximum(0.045 - r, 0.0) * shallow
    rings = [(0.08, 0.0), *zip(r.tolist(), z.tolist(), strict=True), (0.0, float(z[-1]))]
    _, path = plan_path(revolved(rings, 200))
    th, gap = seen(path, 1)
    formed = np.degrees(formed_wall_angle(built_in_table(), th, gap / T0))
    r = np.hypot(*path.contact.point.T[:2])
    assert np.abs(formed[r < 0.0439] - 26.0).max() < 0.1
    assert np.abs(formed[r > 0.0461] - 34.0).max() < 0.1


def test_the_give_of_the_tools_is_taken_off_the_gap() -> None:
    part = cone(30.0, 0.012, 0.04, 200)
    _, plain = plan_path(part)
    _, path = plan_path(part, adsif={"force_n": 500.0, "stiffness_n_mm": 5000.0})
    th, gap = seen(plain, 1)
    assert np.allclose(gap - path.gap, 0.1e-3 * np.sin(th), atol=1e-9)


def test_what_the_table_does_not_know_is_refused() -> None:
    codes = []
    for angle, more in ((50.0, {}), (30.0, {"adsif": {"pitch_mm": 0.4}})):
        with pytest.raises(TandemError) as caught:
            plan_path(cone(angle, 0.012, 0.04), **more)
        codes.append(caught.value.issues[0].code)
    assert codes == ["forming.adsif_range", "forming.adsif_conditions"]
    one, _ = plan_path(cone(30.0, 0.012, 0.04))
    with pytest.raises(TandemError) as caught:
        adsif_tool_path(one, operation("adsif"), BALL, dataclasses.replace(BALL, radius=0.004), T0, METAL)
    assert caught.value.issues[0].code == "forming.support_tool"
