"""The table of trials and its warnings."""

from __future__ import annotations

import pytest

from planner.catalogue.materials import sheet_metals
from planner.geometry.units import DEG, MM
from planner.issues import Severity
from planner.processes.forming.plan.passes import nearest_failed_trial, trial_warning, trials

INCH = 25.4


def test_the_table_is_that_of_the_thesis() -> None:
    table = {t.name: t for t in trials()}
    assert len(table) == 10
    depths = {  # inches, as printed
        "isf_4400": 7 / 8,
        "isf_6640": 1.0,
        "border_disk": 5 / 8,
        "border_ball": 1.25,
        "local": 6.5,
        "local_three_times": 3.0,
        "undercut_30": 1.5,
        "undercut_15": 1.5,
        "second_stage": 1.5,
        "polysurface": 2.0,
    }
    assert {name: t.depth / MM / INCH for name, t in table.items()} == pytest.approx(depths)
    diameters = [18.0] + 8 * [16.0] + [21.0]
    assert [t.diameter / MM / INCH for t in trials()] == pytest.approx(diameters)
    assert [t.name for t in trials() if not t.failed] == ["local_three_times"]
    assert table["local"].duration == 134 * 60
    assert table["isf_4400"].feed == pytest.approx(0.1)
    assert {t.family for t in trials()} <= {m.family for m in sheet_metals().values()}


def test_the_same_part_again_meets_its_own_trial() -> None:
    modes = {"isf": "spif", "dpif_p": "dpif_p", "dpif_l": "dpif_l"}
    for trial in trials():
        found = nearest_failed_trial(
            trial.family, trial.thickness, trial.angle, trial.depth, modes[trial.mode]
        )
        if trial.failed:
            assert found == trial


def test_a_warning_says_what_it_is() -> None:
    issue = trial_warning("aluminium", 1.5 * MM, 60 * DEG, 165 * MM, "dpif_l")
    assert issue is not None
    assert issue.code == "forming.trial"
    assert issue.severity is Severity.WARNING
    assert "a single trial in one lab" in issue.message
    assert "tore at the forming tool at a depth of 165 mm" in issue.message


@pytest.mark.parametrize(
    ("family", "thickness", "angle", "depth", "mode"),
    [
        ("aluminium", 1.5, 60, 100, "dpif_l"),  # shallower than where it tore
        ("aluminium", 1.5, 45, 200, "dpif_l"),  # flatter
        ("aluminium", 3.0, 60, 200, "dpif_l"),  # thicker than what tore
        ("galvanised_steel", 0.4, 60, 30, "spif"),  # thinner than what met too much force
        ("copper", 1.5, 60, 200, "dpif_l"),
        ("aluminium", 1.5, 60, 200, "adsif"),
    ],
)
def test_parts_unlike_any_failed_trial_have_no_warning(
    family: str, thickness: float, angle: float, depth: float, mode: str
) -> None:
    assert trial_warning(family, thickness * MM, angle * DEG, depth * MM, mode) is None
