"""``calibrate-clamp``: recovers clamp parameters from simulated readings (by shells) and refuses bad ones."""

from __future__ import annotations

import dataclasses
import functools
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from planner import pipeline
from planner.cli import clamp
from planner.geometry.arrays import FloatArray
from planner.issues import TandemError
from planner.processes.forming.plan.springback import clamp_calibration
from planner.processes.forming.plan.springback.clamp_calibration import (
    PRESSED_WIDTH_M,
    PlateReadings,
    TestPlate,
    calibrate,
    clarity_issues,
    plate_response,
    read_readings,
)
from planner.shell.element import ShellSheet
from planner.shell.mesh import mesh_walls
from planner.shell.newton import clamped, curve

OUTLINE = 0.125 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
PLATE = TestPlate(OUTLINE, np.zeros(2), 68e9, 0.3, 1e-3, 5e-5)
FORCES = np.array([20.0, 40, 80, 120, 180, 250, 320, 400, 480, 560])
TRUTHS = ((1.0, 0.0, 1.05), (1.05, 0.0, 0.92), (0.96, 1.0, 1.1), (1.03, 0.5, 1.03))
"""Thickness [mm], grip and kappa of sheets that are pressed."""
SEEDS = 25
ERROR = 2e-5


@functools.cache
def response() -> clamp_calibration.PlateResponse:
    return plate_response(PLATE, float(FORCES.max()), float(FORCES.min()))


@functools.cache
def pressed(thickness: float, grip: float) -> FloatArray:
    """Return the deflection [m] of a sheet under `FORCES`, by a separate, finer shell of true thickness."""
    made = mesh_walls([], OUTLINE, 1500, np.zeros((1, 2)))
    sheet = ShellSheet(made.nodes, made.triangles, np.full(len(made.triangles), thickness), 68e9, 0.3)
    border = {0.0: "sliding", 1.0: "immovable"}.get(grip, PLATE.spring(grip, thickness))
    loads = np.stack([0.0 * FORCES, 0.0 * FORCES, -FORCES], axis=1)
    return -curve(sheet, clamped(sheet, border), np.zeros(2), loads, PRESSED_WIDTH_M)[:, 2]


def readings(truth: tuple[float, float, float], seed: int) -> PlateReadings:
    thickness, grip, kappa = truth
    noise = np.random.default_rng(seed).normal(0.0, ERROR, len(FORCES))
    return PlateReadings(FORCES, kappa * pressed(thickness * 1e-3, grip) + noise, ERROR)


@pytest.mark.long
def test_intervals_hold_the_truth_in_nine_of_ten_tests() -> None:
    """100 made-up tests of four clamps: each figure is in its interval of 95 % in 90 at least."""
    held = np.zeros(3, dtype=np.int64)
    for truth in TRUTHS:
        for seed in range(SEEDS):
            found = calibrate(PLATE, readings(truth, seed), response())
            figures = zip(
                (found.thickness, found.grip, found.kappa), (truth[0] * 1e-3, *truth[1:]), strict=True
            )
            held += [one.low <= value <= one.high for one, value in figures]
    print(f"thickness, grip, kappa held: {held} of {SEEDS * len(TRUTHS)}")
    assert (held >= 90).all()


@pytest.mark.long
def test_a_plate_is_like_one_of_another_thickness() -> None:
    """One response serves all thicknesses: within 0.4 % of a finer shell of another one."""
    for thickness, grip, _ in TRUTHS:
        load = np.log(FORCES * PLATE.width**2 / (PLATE.young * (thickness * 1e-3) ** 4))
        told = thickness * 1e-3 * np.exp(response().log_deflection_at(load, np.array([grip]))[:, 0])
        np.testing.assert_allclose(told, pressed(thickness * 1e-3, grip), rtol=0.004)


@pytest.mark.long
def test_borders_that_differ_are_told_apart() -> None:
    one, _, three, four = (calibrate(PLATE, readings(truth, 1), response()) for truth in TRUTHS)
    assert one.border == "sliding"
    assert one.grip.high < 0.2
    assert three.border == "immovable"
    assert three.grip.low > 0.5
    assert four.border == "spring"
    assert four.spring.low < PLATE.spring(0.5, 1.03e-3) < four.spring.high
    assert four.grip.low > one.grip.high


def test_what_is_not_told_is_said() -> None:
    """A sheet that is hardly pressed says nothing of its border; one test cannot part thickness and kappa."""
    full = readings(TRUTHS[0], 3)
    some = [readings(TRUTHS[0], seed) for seed in range(4)]
    lightly = PlateReadings(
        *(np.concatenate([getattr(r, n)[:2] for r in some]) for n in ("force", "dial")), ERROR
    )
    found = calibrate(PLATE, lightly, response())
    assert not found.grip.is_determined
    reported = " ".join(issue.message for issue in clarity_issues(found, PLATE, lightly, True))
    assert {issue.code for issue in clarity_issues(found, PLATE, lightly, True)} == {"forming.clamp_unclear"}
    assert "press harder" in reported
    clear = calibrate(PLATE, full, response())
    assert "press harder" not in " ".join(i.message for i in clarity_issues(clear, PLATE, full, True))
    # a tolerance that is given is not asked for
    assert "--thickness-tol-mm" in reported
    given = " ".join(issue.message for issue in clarity_issues(found, PLATE, lightly, False))
    assert "determine the thickness" in given
    assert "--thickness-tol-mm" not in given
    assert "the thickness and kappa are correlated" in " ".join(
        i.message for i in clarity_issues(clear, PLATE, full, True)
    )
    # the remedy: a thickness measured to a hundredth
    exact = dataclasses.replace(PLATE, tolerance=1e-5)
    sure = calibrate(exact, full, response())
    assert sure.kappa.high - sure.kappa.low < 0.6 * (clear.kappa.high - clear.kappa.low)
    assert sure.kappa.low <= 1.05 <= sure.kappa.high


GOOD = "force_n,dial_mm\n" + "".join(f"{f:g},{0.8 * (f / 20) ** 0.5:.3f}\n" for f in FORCES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("force_kn,dial_mm\n0.1,1\n", "the columns are force_kn, dial_mm, expected force_n, dial_mm"),
        ("force_n,dial_in\n100,1\n", "expected force_n, dial_mm"),
        ("", "the columns are nothing"),
        ("force_n,dial_mm\n", "0 readings at 0 forces"),
        ("\n".join(GOOD.splitlines()[:5]), "4 readings at 4 forces"),
        (GOOD.replace("40,", "-40,"), "line 3: the force is -40 N"),
        (GOOD.replace("40,", "40;"), "line 3: got"),
        (GOOD.replace("40,", "nan,"), "line 3: got"),
        (GOOD.replace("40,", "40,1,"), "line 3: got"),
        ("force_n,dial_mm\n" + "".join(f"{f:g},{5 - f / 200:.3f}\n" for f in FORCES), "must increase"),
        ("force_n,dial_mm\n" + "".join(f"{f:g},2.0\n" for f in FORCES), "must increase"),
        ("force_n,dial_mm\n" + "".join(f"{f:g},{-f / 100:.3f}\n" for f in FORCES), "must increase"),
        ("force_n,dial_mm\n" + "".join(f"{f / 1e3:g},{f / 100:.3f}\n" for f in FORCES), "state forces in N"),
        ("force_n,dial_mm\n" + "".join(f"{f:g},{f / 1e5:.6f}\n" for f in FORCES), "state forces in N"),
        ("force_n,dial_mm\n" + "100,1\n" * 20, "20 readings at 1 forces"),
    ],
)
def test_what_are_no_readings_is_refused_by_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    path.write_text(text)
    with pytest.raises(TandemError) as refused:
        read_readings(path, ERROR)
    assert {issue.code for issue in refused.value.issues} == {"forming.plate_test"}
    assert message in refused.value.issues[0].message


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "bytes.csv").write_bytes(bytes(range(256)))
    for path in (tmp_path / "none.csv", tmp_path, tmp_path / "bytes.csv"):
        with pytest.raises(TandemError) as refused:
            read_readings(path, ERROR)
        assert refused.value.issues[0].code == "forming.plate_test"


def test_what_the_dial_shows_without_force_is_taken_off(tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    rows = "".join(f"{f:g},{0.25 + 0.8 * (f / 20) ** 0.5:.3f}\n" for f in FORCES)
    path.write_text(f"# a plate\nforce_n,dial_mm\n0,0.25\n{rows}")
    shifted = read_readings(path, ERROR)
    path.write_text(GOOD)
    plain = read_readings(path, ERROR)
    np.testing.assert_allclose(shifted.dial, plain.dial, atol=1e-9)
    assert len(plain.force) == len(FORCES)


def test_the_command_says_what_to_write_into_the_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a plate whose response is known already, for it depends on no modulus."""
    monkeypatch.setattr(clamp_calibration, "plate_response", lambda *plate: response())
    problem = pipeline.load("cone_spif")
    assert problem.stock.sheet is not None
    sheet = dataclasses.replace(problem.stock.sheet, opening=OUTLINE)
    stock = dataclasses.replace(problem.stock, sheet=sheet, size=np.array([0.3, 0.3, 1e-3]))
    path, page = tmp_path / "readings.csv", tmp_path / "test.html"
    full = readings(TRUTHS[3], 1)
    rows = "".join(f"{f:g},{d * 1e3:.3f}\n" for f, d in zip(full.force, full.dial, strict=True))
    path.write_text(f"force_n,dial_mm\n{rows}")
    request = clamp.CalibrateClamp(path, Path("cone_spif"), output=page)
    issues = clamp.run_calibrate_clamp(request, dataclasses.replace(problem, stock=stock))
    assert {issue.code for issue in issues} == {"forming.clamp_unclear"}
    reported = capsys.readouterr().out
    assert "for the problem: clamp: {border: spring, spring_n_mm2:" in reported
    assert "thickness within 5 %; kappa includes the error of the modulus" in reported
    assert "Deflection of the flat sheet over force" in page.read_text()


def test_the_command_refuses_bad_input(tmp_path: Path) -> None:
    path = tmp_path / "readings.csv"
    path.write_text(GOOD)
    good, cone, wing = clamp.CalibrateClamp(path, Path()), pipeline.load("cone_spif"), pipeline.load("wing")
    for request, problem, said in (
        (dataclasses.replace(good, dial_mm=-1.0), cone, "dial_mm: got -1 mm"),
        (dataclasses.replace(good, thickness_tol_mm=0.0), cone, "thickness_tol_mm: got 0 of the thickness"),
        (dataclasses.replace(good, place_mm=(500.0, 0.0)), cone, "which is not in the opening"),
        (dataclasses.replace(good, output=Path("x.pdf")), cone, "a page is .html"),
        (good, wing, "has a block and no sheet"),
    ):
        with pytest.raises(TandemError) as refused:
            clamp.run_calibrate_clamp(request, problem)
        assert said in refused.value.issues[0].message
    path.write_text("force_kn,dial_mm\n1,1\n")
    command = [sys.executable, "-m", "planner", "calibrate-clamp", str(path), "--problem", "cone_spif"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "expected force_n, dial_mm" in done.stderr + done.stdout
