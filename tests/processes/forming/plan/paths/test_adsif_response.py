"""The ADSIF response: printed table, bilinear interpolation between stable cells, brute-force inverse."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from planner.geometry.units import DEG, MM
from planner.issues import TandemError
from planner.processes.forming.plan.paths import adsif_response

PRINTED = {  # wall angle [deg] by gap over thickness and position angle [deg]
    (0.6, 35): 35.8,
    (0.6, 45): 37.3,
    (0.6, 55): 36.7,
    (0.7, 25): 31.9,
    (0.7, 35): 31.7,
    (0.7, 45): 31.9,
    (0.7, 55): 31.8,
    (0.8, 25): 22.4,
    (0.8, 35): 25.4,
    (0.8, 45): 27.1,
    (0.8, 55): 29.0,
    (0.9, 25): 18.3,
    (0.9, 35): 21.5,
    (0.9, 45): 25.4,
    (0.9, 55): 28.1,
    (1.0, 25): 16.5,
    (1.0, 35): 21.1,
    (1.0, 45): 24.5,
    (1.0, 55): 27.2,
}
TABLE = adsif_response.built_in_table()
CONDITIONS = TABLE.conditions


def test_the_table_is_the_printed_one() -> None:
    assert np.isfinite(TABLE.wall).sum() == 19
    gaps, positions = (np.array(values) for values in zip(*PRINTED, strict=True))
    walls = adsif_response.formed_wall_angle(TABLE, positions * DEG, gaps)
    assert np.allclose(walls / DEG, list(PRINTED.values()), atol=1e-9)
    assert adsif_response.ResponseConditions("aa5754_o", 1 * MM, 5 * MM, 0.2 * MM, 1.6 * MM) == CONDITIONS


@pytest.mark.parametrize("prefer", ["angle", "gap"])
def test_the_inverse_forms_what_is_wanted(prefer: adsif_response.SolutionPreference) -> None:
    expected = np.concatenate([list(PRINTED.values()), np.linspace(16.5, 37.3, 1001)]) * DEG
    position, gap = adsif_response.invert_response(TABLE, expected, prefer)
    assert np.abs(adsif_response.formed_wall_angle(TABLE, position, gap) - expected).max() < 1e-9


def test_no_solution_of_a_fine_search_is_better() -> None:
    """Every position and gap of a fine grid forms some wall; the inverse of that wall prefers no less."""
    th, g = (a.reshape(-1) for a in np.meshgrid(np.linspace(25, 55, 151) * DEG, np.linspace(0.6, 1.0, 101)))
    stable = (g >= 0.7 - 1e-9) | (th >= 35 * DEG)
    th, g = th[stable], g[stable]
    walls = adsif_response.formed_wall_angle(TABLE, th, g)
    small, _ = adsif_response.invert_response(TABLE, walls, "angle")
    _, large = adsif_response.invert_response(TABLE, walls, "gap")
    assert np.all(small <= th + 1e-7)
    assert np.all(large >= g - 1e-7)


def test_known_choices() -> None:
    position, gap = adsif_response.invert_response(TABLE, np.array([16.5, 20.35, 31.9, 37.3]) * DEG, "angle")
    assert np.allclose(position / DEG, [25, 25, 25, 45])
    assert np.allclose(gap, [1.0, 0.85, 0.7, 0.6])
    position, gap = adsif_response.invert_response(TABLE, np.array([18.8, 27.65, 37.3]) * DEG, "gap")
    assert np.allclose(position / DEG, [30, 55, 45])
    assert np.allclose(gap, [1.0, 0.95, 0.6])


@pytest.mark.parametrize(("wall", "limit"), [(16.4, 16.5), (37.4, 37.3), (math.nan, 16.5)])
def test_walls_beyond_the_table_are_refused(wall: float, limit: float) -> None:
    with pytest.raises(TandemError) as caught:
        adsif_response.invert_response(TABLE, np.array([30.0, wall, wall]) * DEG, "angle")
    (issue,) = caught.value.issues
    assert issue.code == "forming.adsif_range"
    assert issue.index == 1
    assert issue.count == 2
    assert issue.limit == pytest.approx(limit)


@pytest.mark.parametrize(
    ("position", "gap"), [(30, 0.65), (34.9, 0.6), (25, 0.699), (40, 0.55), (60, 0.8), (20, 0.8), (40, 1.1)]
)
def test_unstable_and_unknown_positions_are_refused(position: float, gap: float) -> None:
    with pytest.raises(TandemError) as caught:
        adsif_response.formed_wall_angle(TABLE, position * DEG, gap)
    assert caught.value.issues[0].code == "forming.adsif_unstable"


def test_other_conditions_are_refused_one_by_one() -> None:
    adsif_response.require_conditions(TABLE, CONDITIONS)
    changes = {
        "metal": "dc04",
        "thickness": 1.2 * MM,
        "pitch": 0.5 * MM,
        "projection": 1.0 * MM,
        "radius": 6 * MM,
    }
    fields = {"radius": ["thickness to tool radius"], "thickness": ["thickness", "thickness to tool radius"]}
    for name, value in changes.items():
        with pytest.raises(TandemError) as caught:
            adsif_response.require_conditions(TABLE, dataclasses.replace(CONDITIONS, **{name: value}))  # type: ignore[arg-type]
        assert [i.field for i in caught.value.issues] == fields.get(name, [name])
        assert {i.code for i in caught.value.issues} == {"forming.adsif_conditions"}


def test_compensation_keeps_the_gap_of_tools_that_yield() -> None:
    """Balls whose centres stand apart as commanded, pushed apart in the plane, leave the wanted gap."""
    radius, force, stiffness = 5 * MM, 150.0, (2e6, 3e6)
    position, gap = adsif_response.invert_response(TABLE, np.array([20.0, 30.0, 36.0]) * DEG, "gap")
    yielded = adsif_response.tool_deflection(force, *stiffness)
    assert float(yielded) == pytest.approx(150 / 2e6 + 150 / 3e6)
    command = adsif_response.checked_gap_to_command(gap * MM, position, yielded)
    x, z = adsif_response.centre_distances(position, command, radius, radius)
    real = np.hypot(x + yielded, z) - 2 * radius
    # what the first-order formula leaves out is D^2 cos^2 / (2 distance), less than 1 um here
    assert np.abs(real - gap * MM).max() < float(yielded) ** 2 / (2 * 10 * MM)
    assert np.abs(x / z - np.tan(position)).max() < 1e-12
    assert np.allclose(np.hypot(x, z), command + 2 * radius)


@pytest.mark.parametrize(
    ("force", "stiffness"), [(5000.0, (1e6,)), (-1.0, (1e6,)), (10.0, (0.0,)), (10.0, ())]
)
def test_too_soft_or_senseless_tools_are_refused(force: float, stiffness: tuple[float, ...]) -> None:
    with pytest.raises(TandemError) as caught:
        adsif_response.checked_gap_to_command(
            0.7 * MM, 45 * DEG, adsif_response.tool_deflection(force, *stiffness)
        )
    assert caught.value.issues[0].code == "forming.adsif_compliance"


CUSTOM_TABLE = """# metal: dc04
# thickness_mm: 0.8
# tool_radius_mm: 4
# pitch_mm: 0.1
# projection_mm: 1
# source: own simulations
gap_over_thickness,position_angle_deg,wall_angle_deg
0.7,20,30
0.7,40,34
0.9,20,20
0.9,40,26
"""


def test_a_table_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    path.write_text(CUSTOM_TABLE)
    own = adsif_response.read_table(path)
    assert own.source == "own simulations"
    adsif_response.require_conditions(
        own, adsif_response.ResponseConditions("dc04", 0.8 * MM, 4 * MM, 0.1 * MM, 1 * MM)
    )
    assert float(adsif_response.formed_wall_angle(own, 30 * DEG, 0.8)) / DEG == pytest.approx(
        (30 + 34 + 20 + 26) / 4
    )


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("# metal: dc04\n", "", "metal"),
        ("thickness_mm: 0.8", "thickness_mm: thin", "thin"),
        ("wall_angle_deg", "angle", "headings"),
        ("0.9,40,26", "0.9,40,96", "96"),
        ("0.9,40,26", "0.9,40", "2 values"),
        ("0.9,40,26", "0.9,20,26", "second time"),
        ("0.9,40,26", "x,40,26", "'x'"),
        ("0.9,20,20\n0.9,40,26\n", "", "fewer than 2"),
        ("40,34\n0.9,20,20", "40,unstable\n0.9,20,unstable", "neighbouring"),
    ],
)
def test_faults_of_a_table_are_named(tmp_path: Path, old: str, new: str, what: str) -> None:
    assert old in CUSTOM_TABLE
    path = tmp_path / "own.csv"
    path.write_text(CUSTOM_TABLE.replace(old, new))
    with pytest.raises(TandemError) as caught:
        adsif_response.read_table(path)
    assert {i.code for i in caught.value.issues} == {"forming.adsif_table"}
    assert what in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_table_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TandemError, match="no such file"):
        adsif_response.read_table(tmp_path / "nothing.csv")
