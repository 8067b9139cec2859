"""Wire and material data against published figures."""

import numpy as np
import pytest

from planner.catalogue.materials import foams, wire_material, wire_materials
from planner.issues import TandemError
from planner.processes.hotwire.plan.wire import make_wire


def test_kanthal_d_wire_has_the_handbooks_resistance():
    # Kanthal Appliance Alloys Handbook: Kanthal D, 1.0 mm, 1.72 ohm/m at 20 C; factor 1.02 at 400 C
    assert make_wire("kanthal_d", diameter_mm=1.0).resistance_per_length == pytest.approx(1.72, abs=0.005)
    assert make_wire("kanthal_d", 1.0, temperature_c=400.0).resistance_per_length == pytest.approx(
        1.72 * 1.02, abs=0.005
    )


def test_heat_lengthens_and_softens():
    # Kanthal data sheet: 12e-6 / K from 20 to 500 C, 190 GPa at 400 C
    wire = make_wire("kanthal_d", diameter_mm=0.8, temperature_c=500.0)
    hot = 0.7
    assert hot - wire.cold_length(hot) == pytest.approx(0.7 * 480 * 12e-6, rel=6e-3)
    assert wire.cold_length(hot) * (1 + 480 * 12e-6) == pytest.approx(hot, abs=1e-15)
    assert make_wire("kanthal_d", 0.8, temperature_c=400.0).youngs_modulus == 190e9


def test_strip_stiffness_and_weight_by_hand():
    # 10 x 1 mm steel, 206 GPa, 7850 kg/m3: I = 10 * 1 / 12 mm4, weight 0.0785 kg/m
    strip = make_wire("spring_steel", width_mm=10.0, thickness_mm=1.0)
    assert strip.bending_stiffness == pytest.approx(206e9 * 10e-12 / 12)
    assert strip.bending_stiffness * strip.stiffness_ratios.stiff_bending == pytest.approx(
        206e9 * 1000e-12 / 12
    )
    assert strip.weight_per_length == pytest.approx(0.0785 * 9.80665)
    # torsion constant of a 10:1 rectangle is 0.312 w t^3 (Timoshenko and Goodier, table of art. 109)
    assert strip.torsional_stiffness == pytest.approx(206e9 / (2 * 1.29) * 0.312 * 10e-12, rel=3e-3)
    assert strip.min_bend_radius == pytest.approx(0.5e-3 / (1100 / 206e3))
    assert strip.max_curvature * strip.min_bend_radius == pytest.approx(1.0)


def test_thin_round_wire_feels_its_weight_at_a_third_of_a_metre():
    wire = make_wire("nichrome_80_20", diameter_mm=0.4)
    assert wire.load_over_stiffness ** (-1.0 / 3.0) == pytest.approx(0.31, abs=0.015)
    assert wire.torsional_stiffness == pytest.approx(wire.bending_stiffness / 1.3)
    assert wire.stiffness_ratios.stiff_bending == 1.0
    assert wire.area == pytest.approx(np.pi * 0.04e-6)


def test_every_figure_names_its_source():
    for material in wire_materials().values():
        assert all(material.sources.values()), material.name
        assert len(material.sources) >= 8
    assert {"eps", "xps"} <= set(foams())
    assert all(foam.sources["density"] for foam in foams().values())


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"material": "gold", "diameter_mm": 1.0}, "wire.unknown_material"),
        ({"material": "kanthal_d"}, "wire.size"),
        ({"material": "kanthal_d", "diameter_mm": -1.0}, "wire.size"),
        ({"material": "kanthal_d", "diameter_mm": 1.0, "width_mm": 2.0}, "wire.size"),
        ({"material": "kanthal_d", "width_mm": 1.0, "thickness_mm": 2.0}, "wire.size"),
        ({"material": "kanthal_d", "width_mm": 1.0, "thickness_mm": float("nan")}, "wire.size"),
        (
            {"material": "spring_steel", "width_mm": 10.0, "thickness_mm": 1.0, "temperature_c": 900.0},
            "wire.temperature",
        ),
    ],
)
def test_bad_wires_are_refused(arguments, code):
    with pytest.raises(TandemError) as caught:
        make_wire(**arguments)
    assert [issue.code for issue in caught.value.issues] == [code]
    assert "allowed" in caught.value.issues[0].message


def test_materials_by_name():
    assert wire_material("kanthal_d").poisson == 0.30
