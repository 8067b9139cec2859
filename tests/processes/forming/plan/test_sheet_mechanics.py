"""Sheet metals and the force estimate: sourced values, the published formula and its maximum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from planner.catalogue.materials import sheet_metal, sheet_metals, untested_thickness_warning
from planner.geometry.units import DEG, GRAVITY, MM
from planner.issues import Severity, TandemError
from planner.processes.forming.plan import sheet_mechanics


def test_every_figure_has_a_source_and_makes_sense() -> None:
    figures = {"young", "poisson", "yield", "tensile", "density", "thickness"}
    figures |= {"wall_angle_single", "wall_angle_supported"}
    for name, metal in sheet_metals().items():
        assert metal.name == name
        assert set(metal.sources) == figures, name
        assert all(metal.sources.values())
        assert 60e9 < metal.young < 220e9
        assert 0.25 < metal.poisson < 0.36
        assert 2600 < metal.density < 9000
        assert metal.yield_stress <= metal.tensile_range[0] <= metal.tensile_stress <= metal.tensile_range[1]
        assert 0 < metal.wall_angle_single < metal.wall_angle_supported < 90 * DEG
        assert metal.thickness_range[0] <= metal.thickness_range[1] < 10 * MM


def test_the_metals_are_there() -> None:
    names = (
        "aluminium aa1050_o aa1100_o aa3003_o aa5754_o aa2024_t3 dc04 galvanised_steel stainless_304 copper"
    )
    assert set(names.split()) <= set(sheet_metals())
    assert sheet_metal("copper").family == "copper"


def test_soft_sheet_takes_65_deg_alone_and_73_supported() -> None:
    metal = sheet_metal("dc04")
    assert metal.wall_angle_limit(False) == pytest.approx(65 * DEG)
    assert metal.wall_angle_limit(True) == pytest.approx(73 * DEG)


def test_an_unknown_metal_names_the_known_ones() -> None:
    with pytest.raises(TandemError) as caught:
        sheet_metal("unobtainium")
    assert caught.value.issues[0].code == "forming.unknown_metal"
    assert "dc04" in str(caught.value)


def test_a_thickness_without_tests_is_doubted() -> None:
    metal = sheet_metal("galvanised_steel")
    assert untested_thickness_warning(metal, 0.5 * MM) is None
    assert untested_thickness_warning(metal, 1.0 * MM) is None
    found = untested_thickness_warning(metal, 3.0 * MM)
    assert found is not None
    assert found.code == "forming.thickness_untested"
    assert found.severity is Severity.WARNING
    assert found.limit == pytest.approx(1.0)


def test_the_formula_by_hand() -> None:
    # logarithms by hand: 0.0716 * 200 * 1.5^1.57 * 10^0.41 * 0.02^0.09 * 50 * cos 50 deg
    by_hand = math.exp(
        math.log(0.0716 * 200.0)
        + 1.57 * math.log(1.5)
        + 0.41 * math.log(10.0)
        + 0.09 * math.log(0.02)
        + math.log(50.0 * 0.6427876097)
    )
    got = sheet_mechanics.axial_force(200e6, 1.5 * MM, 10 * MM, 0.02 * MM, 50 * DEG)
    assert float(got) == pytest.approx(by_hand, rel=1e-9)


def test_the_force_is_largest_where_a_tan_a_is_one() -> None:
    best = minimize_scalar(
        lambda a: -float(sheet_mechanics.axial_force(200e6, MM, 10 * MM, 0.02 * MM, a)),
        bounds=(0.1, 1.5),
        method="bounded",
    )
    assert best.x * math.tan(best.x) == pytest.approx(1.0, abs=1e-4)
    ends = sheet_mechanics.axial_force(200e6, MM, 10 * MM, 0.02 * MM, np.array([0.0, 90.0]) * DEG)
    assert np.abs(ends).max() < 1e-9


def test_scallops_are_the_inverse_of_the_stepdown() -> None:
    # R = 5 mm, h = 0.01 mm: 0.216, 0.447, 0.573 mm at 20, 45, 65 deg
    steps, angles = np.array([0.216, 0.447, 0.573]) * MM, np.array([20.0, 45.0, 65.0]) * DEG
    assert np.allclose(sheet_mechanics.scallop_height(5 * MM, steps, angles) / MM, 0.01, rtol=4e-3)
    assert float(sheet_mechanics.scallop_height(5 * MM, 100 * MM, 45 * DEG)) == pytest.approx(5 * MM)


def test_an_estimate_takes_the_worst_wall_and_the_strengths_range() -> None:
    metal = sheet_metal("dc04")
    walls = np.array([0.0, 20.0, 50.0, 70.0]) * DEG
    found = sheet_mechanics.estimate_force(metal, 1 * MM, 10 * MM, 0.5 * MM, walls)
    assert found.angle == pytest.approx(50 * DEG)
    assert found.low == pytest.approx(found.force * 270 / 310)
    assert found.high == pytest.approx(found.force * 350 / 310)
    assert "Aerens" in found.source
    own = sheet_mechanics.estimate_force(metal, 1 * MM, 10 * MM, 0.5 * MM, walls, stated_force=900.0)
    assert (own.force, own.low, own.high, own.source) == (900.0, 900.0, 900.0, "stated by the user")


def test_a_force_beyond_the_payload_warns() -> None:
    metal = sheet_metal("dc04")
    found = sheet_mechanics.estimate_force(metal, 1 * MM, 10 * MM, 0.5 * MM, 50 * DEG)
    issue = sheet_mechanics.payload_issue(found, "left", "IRB 140", payload=6.0, carried=1.0)
    assert issue is not None
    assert issue.code == "forming.force"
    assert issue.severity is Severity.WARNING
    assert issue.limit == pytest.approx(5.0 * GRAVITY)
    assert sheet_mechanics.payload_issue(found, "left", "IRB 6640", payload=235.0, carried=5.0) is None


@pytest.mark.parametrize(
    ("thickness", "diameter", "step", "angle", "given"),
    [
        (0.0, 10.0, 0.5, 45.0, None),
        (1.0, -10.0, 0.5, 45.0, None),
        (1.0, 10.0, 0.0, 45.0, None),
        (math.nan, 10.0, 0.5, 45.0, None),
        (1.0, 10.0, 0.5, 95.0, None),
        (1.0, 10.0, 0.5, 0.0, None),
        (1.0, 10.0, 0.5, 45.0, -3.0),
    ],
)
def test_what_is_out_of_range_is_named(
    thickness: float, diameter: float, step: float, angle: float, given: float | None
) -> None:
    with pytest.raises(TandemError) as caught:
        sheet_mechanics.estimate_force(
            sheet_metal("dc04"), thickness * MM, diameter * MM, step * MM, angle * DEG, given
        )
    assert caught.value.issues[0].code == "forming.force_input"
