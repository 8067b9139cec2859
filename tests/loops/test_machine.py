"""Machine files: their gains, their refusals, and the remedies of all issues."""

from __future__ import annotations

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from planner.issues import Issue, TandemError
from planner.loops import machine
from tests.remedies.advice import ReportedFigure

MACHINE: dict[str, Any] = {
    "tandem_machine": 1,
    "name": "lab",
    "former": {"stiffness_n_mm": 500, "bandwidth_hz": 18, "delay_ms": 20},
    "support": {"stiffness_n_mm": 500, "bandwidth_hz": 18, "delay_ms": 20},
    "metal_n_mm": 5000,
    "force_n": 200,
    "compensate": 0.9,
}
FEED = 0.002


def read_changed_machine(tmp_path: Path, **fields: Any) -> machine.MachineFile:
    data = copy.deepcopy(MACHINE)
    for name, value in fields.items():
        *steps, last = name.split("__")
        inner = data
        for step in steps:
            inner = inner.setdefault(step, {})
        inner[last] = value
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(data))
    return machine.read_machine(path)


def machine_issues(file: machine.MachineFile, feed: float = FEED) -> list[Issue]:
    try:
        return list(machine.machine_warnings(file, machine.simulate_machine(file, feed), feed))
    except TandemError as error:
        return list(error.issues)


def test_a_machine_in_si_units(tmp_path: Path) -> None:
    value = read_changed_machine(tmp_path, sensor__cycle_ms=12, sensor__step_n=1).value()
    assert value.forming.stiffness == 5e5
    assert value.metal == 5e6
    assert value.forming.delay == 0.02
    assert value.sensor.cycle == 0.012
    assert value.contact == pytest.approx(1e6 / (2 + 2 + 0.2))


def test_the_recommended_gain_is_refused_nowhere_and_keeps_its_band(tmp_path: Path) -> None:
    file = read_changed_machine(tmp_path)
    run = machine.simulate_machine(file, FEED)
    assert machine_issues(file) == []
    assert run.response.has_settled.all()
    assert run.error <= file.band_n
    assert 0.0 < run.remaining_deflection < 0.2


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("former__stiffness_n_mm", 0),
        ("former__bandwidth_hz", "fast"),
        ("support__delay_ms", -1),
        ("sensor__cycle_ms", 0),
        ("metal_n_mm", -5),
        ("force_n", None),
        ("compensate", 2),
        ("interface", "ethernet"),
        ("colour", "red"),
    ],
)
def test_a_wrong_field_is_named_and_correcting_it_is_enough(
    tmp_path: Path, field: str, value: object
) -> None:
    with pytest.raises(TandemError) as refused:
        read_changed_machine(tmp_path, **{field: value})
    issue = refused.value.issues[0]
    assert issue.code == "control.machine"
    assert field.replace("__", ".") in str(issue.field)
    read_changed_machine(tmp_path)


def test_a_gain_that_swings_up_is_refused_and_the_one_advised_is_not(tmp_path: Path) -> None:
    issues = machine_issues(read_changed_machine(tmp_path, gain_um_ns=80.0))
    assert [issue.code for issue in issues] == ["control.unstable"]
    gain = ReportedFigure("use # um", 0.01, down=True).of(issues, None)
    assert machine_issues(read_changed_machine(tmp_path, gain_um_ns=gain)) == []


def test_a_delay_that_a_gain_does_not_bear_is_refused(tmp_path: Path) -> None:
    assert machine_issues(read_changed_machine(tmp_path, gain_um_ns=20.0)) == []
    slow = read_changed_machine(tmp_path, gain_um_ns=20.0, support__delay_ms=200)
    assert [issue.code for issue in machine_issues(slow)] == ["control.unstable"]


def test_compensation_that_runs_away_is_refused_and_less_is_not(tmp_path: Path) -> None:
    soft = {"former__stiffness_n_mm": 100, "support__stiffness_n_mm": 10_000, "metal_n_mm": 50_000}
    issues = machine_issues(read_changed_machine(tmp_path, **soft, compensate=1.1))
    assert [issue.code for issue in issues] == ["control.unstable"]
    fraction = ReportedFigure("compensate a fraction of # at most", 0.01, down=True).of(issues, None)
    assert all(
        issue.code != "control.unstable"
        for issue in machine_issues(read_changed_machine(tmp_path, **soft, compensate=fraction))
    )


def test_a_feed_that_loses_the_band_is_told_and_the_one_advised_keeps_it(tmp_path: Path) -> None:
    file = read_changed_machine(tmp_path)
    issues = machine_issues(file, 0.025)
    assert [issue.code for issue in issues] == ["control.band"]
    feed = ReportedFigure("form at # mm/s", 0.01, down=True).of(issues, None)
    assert machine_issues(file, 0.99 * feed * 1e-3) == []


def test_corrections_beyond_the_range_are_told_and_a_larger_range_ends_it(tmp_path: Path) -> None:
    issues = machine_issues(read_changed_machine(tmp_path, correction_mm=0.2))
    assert [issue.code for issue in issues] == ["control.range"]
    assert machine_issues(read_changed_machine(tmp_path, correction_mm=issues[0].value)) == []


def test_the_command(tmp_path: Path) -> None:
    read_changed_machine(tmp_path, interface="rsi")
    page = tmp_path / "control.html"
    command = [sys.executable, "-m", "planner", "control", "cone_dpif_l", "-o", str(page)]
    command += ["--machine", str(tmp_path / "machine.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "integral gain" in done.stdout
    assert "POSCORR" in done.stdout
    assert "control.band" in done.stderr  # it forms at 25 mm/s
    text = page.read_text()
    assert "Step of the required force" in text
    assert "Gap that changes by 1.25 mm/s" in text
    for what in ("commanded", "+10 N", "\u221210 N", "support, from its start"):
        assert what in text


def test_one_arm_has_no_support_whose_force_could_be_controlled(tmp_path: Path) -> None:
    read_changed_machine(tmp_path)
    command = [sys.executable, "-m", "planner", "control", "cone_spif"]
    command += ["--machine", str(tmp_path / "machine.yaml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert "mode with two arms" in done.stderr
