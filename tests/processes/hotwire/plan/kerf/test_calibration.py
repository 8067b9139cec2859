"""User-defined foams: test cuts are read, fitted, written and read back, and every fault is named."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from planner.catalogue import materials
from planner.cli import command_line
from planner.cli import preparation as kerf_commands
from planner.issues import TandemError
from planner.problem import Stock
from planner.processes.hotwire.plan.kerf import calibration, width
from planner.processes.hotwire.plan.kerf.cut_measurements import CutMeasurements, dissertation_tables
from planner.processes.hotwire.plan.kerf.width import TEST_WIRE
from planner.reading import materials as material_file
from planner.reading import stock

FOAM = dataclasses.replace(materials.foam("eps_a120"), name="mine", kerf=None)
CHI, OFFSET = 1.05, 0.45e-3
HEAT = 22.0 * 1450.0 * 260.0


def cuts(noise: float = 0.0, seed: int = 8) -> CutMeasurements:
    power, speed = (v.ravel() for v in np.meshgrid([83.0, 97.0, 111.0], np.arange(5.0, 11.0) * 1e-3))
    error = np.random.default_rng(seed).normal(0.0, 1.0, len(power)) * noise
    return CutMeasurements(power, speed, CHI * power / (HEAT * speed) - OFFSET + error)


def no_faces(measured: CutMeasurements) -> np.ndarray:
    return np.zeros(len(measured), bool)


def fitted(measured: CutMeasurements, **faces: np.ndarray) -> calibration.FitReport:
    masks = {name: faces.get(name, no_faces(measured)) for name in ("burnt", "dragging", "good")}
    return calibration.fit_robust(FOAM, calibration.CutFile(measured, 0.05, **masks), 0.0004)


def issues_of(text: str, tmp_path: Path, **given: float | None) -> list[tuple[str, int | None, str | None]]:
    path = tmp_path / "tests.csv"
    path.write_text(text)
    with pytest.raises(TandemError) as caught:
        calibration.read_cuts(path, 0.0004, given.get("length", 0.43), given.get("thickness", 0.05))
    assert all(issue.hint for issue in caught.value.issues)
    return [(issue.code, issue.line, issue.field) for issue in caught.value.issues]


def test_exact_cuts_give_their_line_back() -> None:
    report = fitted(cuts(), good=~no_faces(cuts()))
    assert report.fit.chi == pytest.approx(CHI, rel=1e-9)
    assert report.fit.offset == pytest.approx(OFFSET, rel=1e-9)
    assert report.fit.spread < 1e-12
    assert report.fit.tests.power_per_length == (83.0, 111.0)
    assert report.fit.tests.speed == pytest.approx((5e-3, 10e-3))


def test_three_wrong_readings_do_not_turn_the_line() -> None:
    some = cuts(0.05e-3)
    wrong = some.width.copy()
    wrong[[0, 9, 15]] += np.array([3e-3, -0.9e-3, 2e-3])
    report = fitted(dataclasses.replace(some, width=wrong), good=~no_faces(some))
    right = np.ones(18, bool)
    right[[0, 9, 15]] = False
    expected = calibration.fit_least_squares(FOAM, some.select(right), 0.05, 0.0004)
    assert report.fit.chi == pytest.approx(expected.chi, rel=0.01)
    assert report.fit.offset == pytest.approx(expected.offset, abs=0.01e-3)
    plain = calibration.fit_least_squares(FOAM, dataclasses.replace(some, width=wrong), 0.05, 0.0004)
    assert report.fit.spread < 0.1 * plain.spread


def test_the_interval_holds_nine_of_ten_new_cuts() -> None:
    inside = []
    for seed in range(60):
        report = fitted(cuts(0.15e-3, seed), good=~no_faces(cuts()))
        foam = dataclasses.replace(FOAM, kerf=report.fit)
        new = cuts(0.15e-3, seed + 1000)
        got = width.width(foam, TEST_WIRE, new.power_per_length * 0.43, new.speed, 0.05)
        inside.append((got.low <= new.width) & (new.width <= got.high))
    assert np.mean(inside) == pytest.approx(0.9, abs=0.04)


def test_cuts_that_the_line_calls_too_hot_or_too_cold_are_left_out_unless_their_faces_are_good() -> None:
    power = np.full(10, 97.0)
    speed = np.array([2.0, 2.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 14.0, 18.0]) * 1e-3
    some = CutMeasurements(power, speed, CHI * power / (HEAT * speed) - OFFSET)
    some.width[:2] += 2e-3  # burnt wide
    some.width[-2:] = 0.6e-3  # dragged
    report = fitted(some)
    assert report.hot.tolist() == [True] * 2 + [False] * 8
    assert report.cold.tolist() == [False] * 8 + [True] * 2
    assert report.fit.chi == pytest.approx(CHI, rel=1e-6)
    assert report.kept.sum() == report.fit.count == 6
    kept = fitted(some, good=~no_faces(some))
    assert kept.fit.count == 10


def test_burnt_faces_tell_the_speed_below_which_the_foam_burns() -> None:
    some = cuts()
    burnt = some.speed < 6.5e-3
    report = fitted(some, burnt=burnt, good=~burnt)
    assert report.fit.tests.burnt_speed == pytest.approx(6e-3)
    foam = dataclasses.replace(FOAM, kerf=report.fit)
    assert int(width.width(foam, TEST_WIRE, 40.0, 6e-3, 0.05).flag) & width.KerfFlag.TOO_HOT


def test_cuts_that_fit_no_line() -> None:
    for some in (cuts().select(np.arange(18) < 3), cuts().select(np.arange(18) % 18 < 1)):
        with pytest.raises(TandemError) as caught:
            fitted(some)
        assert [i.code for i in caught.value.issues] == ["kerf.few_cuts"]
    same = CutMeasurements(np.full(6, 97.0), np.full(6, 6e-3), np.full(6, 1.6e-3))
    with pytest.raises(TandemError) as caught:
        fitted(same)
    assert [i.code for i in caught.value.issues] == ["kerf.few_cuts"]
    falling = dataclasses.replace(cuts(), width=4e-3 - cuts().width)
    with pytest.raises(TandemError) as caught:
        fitted(falling)
    assert [i.code for i in caught.value.issues] == ["kerf.no_trend"]


def test_sides_of_squares_are_one_kerf_short(tmp_path: Path) -> None:
    path = tmp_path / "tests.csv"
    path.write_text(
        "# four squares\n"
        "Power_W; speed_mm_s; nominal_side_mm; measured_side_mm; wire_length_mm; thickness_mm; face\n"
        "47,5;5;100;97,63;430;50;\n\n47,5;7;100;98,58;430;50;ok\n41.3;7;100;98.73;430;50;Burnt\n"
    )
    read = calibration.read_cuts(path, 0.0004, None, None)
    assert read.cuts.width == pytest.approx([2.37e-3, 1.42e-3, 1.27e-3])
    assert read.cuts.power_per_length == pytest.approx(np.array([47.5, 47.5, 41.3]) / 0.43)
    assert read.thickness == pytest.approx(0.05)
    assert read.good.tolist() == [False, True, False]
    assert read.burnt.tolist() == [False, False, True]


def test_every_fault_of_a_file_is_named_with_its_line(tmp_path: Path) -> None:
    head = "power_w,speed_mm_s,kerf_mm\n"
    assert issues_of(head + "47,5,2\n47,x,2\n-1,5,nan\n", tmp_path) == [
        ("kerf.file", 3, "speed_mm_s"),
        ("kerf.file", 4, "power_w"),
        ("kerf.file", 4, "kerf_mm"),
    ]
    assert issues_of(head + "47,5,2\n47,5,-0.2\n47,5,0.3\n", tmp_path) == [
        ("kerf.impossible", 3, None),
        ("kerf.impossible", 4, None),
    ]
    assert issues_of("power_w,kerf_mm,sped\n47,5,2\n", tmp_path) == [
        ("kerf.file", 1, "sped"),
        ("kerf.file", 1, "speed_mm_s"),
    ]
    assert issues_of(head + "47,5,2\n", tmp_path, length=None, thickness=None) == [
        ("kerf.file", 1, "wire_length_mm"),
        ("kerf.file", 1, "thickness_mm"),
    ]
    assert issues_of("power_w,speed_mm_s,measured_side_mm\n47,5,98\n", tmp_path) == [
        ("kerf.file", 1, "kerf_mm")
    ]
    assert issues_of("power_w,power_w,speed_mm_s,kerf_mm\n47,47,5,2\n", tmp_path) == [
        ("kerf.file", 1, "power_w")
    ]
    assert issues_of(head + "47,5\n", tmp_path) == [("kerf.file", 2, None)]
    assert issues_of(head, tmp_path) == [("kerf.file", None, None)]
    assert issues_of("power_w,speed_mm_s,kerf_mm,face\n47,5,2,charred\n", tmp_path) == [
        ("kerf.file", 2, "face")
    ]
    uneven = "power_w,speed_mm_s,kerf_mm,thickness_mm\n47,5,2,50\n47,6,2,80\n"
    assert issues_of(uneven, tmp_path) == [("kerf.file", 3, "thickness_mm")]


def test_files_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01")
    (tmp_path / "large.csv").write_text("1" * (calibration.MAX_TEST_CUT_BYTES + 1))
    for name in ("nowhere.csv", "binary.csv", "large.csv", "."):
        with pytest.raises(TandemError) as caught:
            calibration.read_cuts(tmp_path / name, 0.0004, 0.43, 0.05)
        assert [i.code for i in caught.value.issues] == ["kerf.file"]


def test_foam_files_come_back_as_they_were(tmp_path: Path) -> None:
    burnt = cuts().speed < 5.5e-3
    report = fitted(cuts(0.1e-3), burnt=burnt, good=~burnt)
    foam = dataclasses.replace(FOAM, kerf=report.fit)
    material_file.write_foam(tmp_path / "mine.yaml", foam, "cuts of a test")
    back = material_file.read_foam(tmp_path / "mine.yaml")
    assert (back.name, back.density, back.conductivity) == ("mine", 22.0, 0.036)
    assert back.sources["kerf"] == "cuts of a test"
    speed = np.linspace(2e-3, 12e-3, 50)
    first, second = (width.width(one, TEST_WIRE, 45.0, speed, 0.05) for one in (foam, back))
    assert np.abs(first.width - second.width).max() < 1e-9
    assert np.abs(first.high - second.high).max() < 1e-9
    assert np.array_equal(first.flag, second.flag)


def test_a_foam_file_without_cuts_serves_the_general_model(tmp_path: Path) -> None:
    path = tmp_path / "bare.yaml"
    path.write_text(
        "tandem_foam: 1\nname: bare\ndensity_kg_m3: 14\nspecific_heat_j_kg_k: 1450\n"
        "melt_temperature_c: 280\nconductivity_w_m_k: 0.04\n"
    )
    foam = material_file.read_foam(path)
    ours = width.width(foam, TEST_WIRE, 45.0, 7e-3, 0.05, "general")
    assert float(ours.width) == float(width.width("eps_af", TEST_WIRE, 45.0, 7e-3, 0.05, "general").width)
    assert int(ours.flag) & width.KerfFlag.UNTESTED


@pytest.mark.parametrize(
    ("change", "line", "field"),
    [
        (("density_kg_m3: 22.0", "density_kg_m3: -22.0"), 6, "density_kg_m3"),
        (("density_kg_m3: 22.0", "density_kg_m3: heavy"), 6, "density_kg_m3"),
        (("density_kg_m3: 22.0\n", ""), 1, "density_kg_m3"),
        (("name: mine", "name: 7 mine"), 3, "name"),
        (("tandem_foam: 1", "tandem_foam: 2"), 2, "tandem_foam"),
        (("  count:", "  number:"), 14, "kerf.number"),
        (("  chi: ", "  chi: -"), 11, "kerf.chi"),
        (("speed_mm_s: [5.0, 10.0]", "speed_mm_s: [10.0, 5.0]"), 18, "kerf.speed_mm_s"),
        (("speed_mm_s: [5.0, 10.0]", "speed_mm_s: [5.0, .nan]"), 18, "kerf.speed_mm_s.1"),
    ],
)
def test_faults_of_foam_files(change: tuple[str, str], line: int, field: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    report = fitted(cuts(0.1e-3), good=~no_faces(cuts()))
    material_file.write_foam(path, dataclasses.replace(FOAM, kerf=report.fit), "x")
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    with pytest.raises(TandemError) as caught:
        material_file.read_foam(path)
    found = [(i.code, i.line, i.field) for i in caught.value.issues]
    assert ("kerf.foam_file", line, field) in found
    assert all(i.file == str(path) and i.hint for i in caught.value.issues)


def test_foam_files_that_are_missing_or_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        material_file.read_foam(tmp_path / "nowhere.yaml")
    assert caught.value.issues[0].code == "problem.missing_file"
    (tmp_path / "file").write_text("")
    with pytest.raises(TandemError) as caught:
        material_file.write_foam(tmp_path / "file" / "foam.yaml", FOAM, "x")
    assert caught.value.issues[0].code == "output.folder"


def table_of(name: str) -> str:
    lines = ["power_w,speed_mm_s,nominal_side_mm,measured_side_mm,face"]
    table = dissertation_tables()[name]
    for k in np.flatnonzero(np.isfinite(table.cuts.width)):
        side = 100.0 - table.cuts.width[k] * 1e3
        face = "burnt" if table.burnt[k] else "ok"
        lines.append(f"{table.power[k]},{table.cuts.speed[k] * 1e3:g},100,{side:.2f},{face}")
    return "\n".join(lines) + "\n"


def test_the_command_fits_a_foam_and_answers(tmp_path: Path) -> None:
    (tmp_path / "tests.csv").write_text(table_of("eps_af_plus"))

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "COLUMNS": "200", "OMP_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "planner", "kerf", *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False, timeout=60
        )

    given = ("--density-kg-m3", "14", "--thickness-mm", "50", "--wire-length-mm", "430")
    done = run("fit", "tests.csv", *given, "--name", "graphite", "-o", "graphite.yaml")
    assert done.returncode == 0, done.stderr
    assert "20 cuts used; left out as too hot 12, as too cold 0" in done.stdout
    assert material_file.read_foam(tmp_path / "graphite.yaml").name == "graphite"
    asked = run("width", "graphite.yaml", "--power-w", "47.5", "--speed-mm-s", "8")
    built_in = run("width", "eps_af_plus", "--power-w", "47.5", "--speed-mm-s", "8")
    assert asked.returncode == built_in.returncode == 0
    assert asked.stdout.startswith("kerf 2.5")
    assert built_in.stdout.startswith("kerf 2.5")
    refused = run("fit", "tests.csv", "--density-kg-m3", "14")
    assert refused.returncode == command_line.BAD_INPUT
    assert refused.stderr.count("kerf.file") == 2


def test_speed_and_power_at_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    kerf_commands.run_kerf(kerf_commands.KerfSpeed("eps_af", power_w=47.5, kerf_mm=1.5))
    speed = float(width.speed_for("eps_af", TEST_WIRE, 47.5, 1.5e-3, 0.05)) * 1e3
    assert f"at 47.5 W and {speed:.2f} mm/s" in capsys.readouterr().out
    kerf_commands.run_kerf(kerf_commands.KerfPower("eps_af", speed_mm_s=4.0, kerf_mm=2.0, thickness_mm=200.0))
    shown = capsys.readouterr().out
    assert "kerf 2.00 mm" in shown
    assert "note: too hot" in shown
    assert "note: the foam is thicker" in shown
    with pytest.raises(TandemError) as caught:
        kerf_commands.run_kerf(kerf_commands.FoamFit(Path("t.csv"), density_kg_m3=-1.0))
    assert caught.value.issues[0].code == "kerf.foam_file"
    with pytest.raises(TandemError) as caught:
        kerf_commands.run_kerf(kerf_commands.FoamFit(Path("t.csv"), density_kg_m3=14.0, thickness_mm=0.0))
    assert caught.value.issues[0].code == "kerf.input"


def test_a_block_of_a_foam_of_ones_own(tmp_path: Path) -> None:
    material_file.write_foam(tmp_path / "mine.yaml", dataclasses.replace(FOAM, density=18.5), "weighed")
    (tmp_path / "wrong.yaml").write_text("name: wrong\n")

    def block(name: str) -> Stock:
        spec = stock.StockFile.model_validate({"size_mm": (100, 100, 100), "foam": {"file": name}})
        return stock.build_stock(spec, tmp_path)

    assert block("mine.yaml").mass == pytest.approx(0.0185)
    for name, code in (("nowhere.yaml", "problem.missing_file"), ("wrong.yaml", "kerf.foam_file")):
        with pytest.raises(TandemError) as caught:
            block(name)
        assert {issue.code for issue in caught.value.issues} == {code}
        assert all(issue.file == str(tmp_path / name) for issue in caught.value.issues)
