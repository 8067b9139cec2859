"""Kerf models against the dissertation's printed tables, closed forms and their own inverses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from bench import kerf_bench
from planner.catalogue import materials
from planner.issues import TandemError
from planner.processes.hotwire.plan import wire
from planner.processes.hotwire.plan.kerf import cut_measurements, models
from planner.processes.hotwire.plan.kerf import width as kerf_width
from planner.processes.hotwire.plan.kerf.models import max_power
from planner.processes.hotwire.plan.kerf.width import TEST_WIRE, HotWire, KerfFlag

TABLES = cut_measurements.dissertation_tables()
FOAMS = sorted(TABLES)
MODELS = ["energy", "general", "measured", "dissertation"]
LINES = ["energy", "general", "dissertation"]
rng = np.random.default_rng(30)


def codes(error: pytest.ExceptionInfo[TandemError]) -> list[str]:
    return [issue.code for issue in error.value.issues]


@pytest.mark.parametrize("foam", FOAMS)
def test_the_dissertations_form_gives_its_printed_values(foam: str) -> None:
    table = TABLES[foam]
    got = kerf_width.width(foam, TEST_WIRE, table.power, table.cuts.speed, 0.05, model="dissertation")
    assert table.calculated.shape == (32,)
    assert np.abs(got.width - table.calculated).max() < 0.01e-3


def test_the_dissertations_form_by_hand() -> None:
    # XPS 30 at 13 V and 2 mm/s: air at 20 + 460.6 / 2 = 250.3 C is within 0.3 K of a row of the air table
    conductivity, density, heat, viscosity, rise = 0.0421, 0.675, 1034.0, 41.17e-6, 460.6
    reynolds, prandtl = 2e-3 * 0.4e-3 / viscosity, heat * density * viscosity / conductivity
    nusselt = 0.3 + 0.62 * reynolds**0.5 * prandtl ** (1 / 3) / (1 + (0.4 / prandtl) ** (2 / 3)) ** 0.25
    flow = 0.43 * conductivity * rise * nusselt
    flow += 0.8 * 0.9 * 0.7 * np.pi * 0.4e-3 * 0.43 * 5.670374419e-8 * rise**4
    expected = flow / (260 * 1500 * 30 * 0.05 * 2e-3) - 0.4e-3
    got = kerf_width.width("xps_30", TEST_WIRE, 35.9, 2e-3, 0.05, model="dissertation").width
    assert float(got) == pytest.approx(expected, rel=1e-3)
    assert float(kerf_width.width("xps_30", TEST_WIRE, 35.9, 2e-3, 0.43, model="dissertation").width) < 0.0


def test_the_energy_balance_by_hand() -> None:
    ideal = 47.5 / 0.43 / (14.0 * 1450.0 * (280.0 - 20.0) * 7e-3)
    fit = materials.foam("eps_af").kerf
    assert fit is not None
    got = kerf_width.width("eps_af", TEST_WIRE, 47.5, 7e-3, 0.05)
    assert float(got.width) == pytest.approx(fit.chi * ideal - fit.offset, rel=1e-12)
    assert 2.4e-3 < float(got.width) < 2.5e-3


@pytest.mark.parametrize("foam", FOAMS)
def test_the_built_in_fits_are_those_of_the_tables(foam: str) -> None:
    table, data = TABLES[foam], materials.foam(foam)
    assert data.kerf is not None
    power, speed, width = (v[table.valid] for v in (table.power, table.cuts.speed, table.cuts.width))
    ideal = power / 0.43 / (data.density * data.specific_heat * 260.0 * speed) * 1e3
    line = stats.linregress(ideal, width * 1e3)
    assert data.kerf.chi == pytest.approx(line.slope, abs=2e-5)
    assert data.kerf.offset * 1e3 == pytest.approx(-line.intercept, abs=2e-5)
    assert data.kerf.count == len(ideal)

    # the interval for one new cut, by matrices
    columns = np.stack([ideal, np.ones_like(ideal)], axis=1)
    residual = width * 1e3 - columns @ np.array([line.slope, line.intercept])
    new = np.array([2.0, 1.0])
    leverage = new @ np.linalg.inv(columns.T @ columns) @ new
    spread = np.sqrt(residual @ residual / (len(ideal) - 2))
    half = stats.t.ppf(0.95, len(ideal) - 2) * spread * np.sqrt(1.0 + leverage)
    assert models.interval_half_width(data.kerf, np.array(2e-3)) * 1e3 == pytest.approx(half, rel=1e-3)


def test_the_valid_cells_are_86_and_lost_ones_are_never_used() -> None:
    assert sum(int(t.valid.sum()) for t in TABLES.values()) == 86
    assert sum(int(np.isnan(t.cuts.width).sum()) for t in TABLES.values()) == 6
    assert not any(np.any(t.valid & np.isnan(t.cuts.width)) for t in TABLES.values())


def test_errors_in_cells_that_were_left_out() -> None:
    valid = {name: table.valid for name, table in TABLES.items()}
    scores = {name: kerf_bench.evaluate(one, valid) for name, one in kerf_bench.PREDICTORS.items()}
    assert scores["measured"]["voltage_out"] <= 0.20
    assert scores["energy"]["voltage_out"] <= 0.228
    assert scores["general"]["foam_out"] <= 0.30
    naive = scores["in proportion to power over speed"]
    assert scores["energy"]["voltage_out"] < 0.9 * naive["voltage_out"]
    assert kerf_bench.coverage(valid) == pytest.approx(0.9, abs=0.06)


def test_the_general_constants_are_a_plain_least_squares_fit() -> None:
    rows, widths = [], []
    for name, table in TABLES.items():
        foam, cuts = materials.foam(name), table.cuts.select(table.valid)
        per_speed = 1.0 / (foam.density * foam.specific_heat * 260.0 * cuts.speed)
        rows.append(
            np.stack([cuts.power_per_length * per_speed, -foam.conductivity * 260.0 * per_speed], axis=1)
        )
        widths.append(cuts.width)
    stacked = np.concatenate(rows)
    chi, product = np.linalg.solve(stacked.T @ stacked, stacked.T @ np.concatenate(widths))
    found = models.general_constants()
    assert (found.chi, found.chi_lambda) == (pytest.approx(chi), pytest.approx(product))


def test_the_measured_model_is_the_energy_balance_with_a_conditioned_residual() -> None:
    table, prior = TABLES["eps_af"], models.prior()
    cuts = table.cuts.select(table.valid)
    law = kerf_width.width("eps_af", TEST_WIRE, table.power[table.valid], cuts.speed, 0.05).width
    old = np.stack([np.log(cuts.power_per_length), np.log(cuts.speed)], axis=1)
    new = np.array([np.log(45.0 / 0.43), np.log(6.3e-3)])
    scale = np.array([prior.power_length, prior.speed_length])

    def covariance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return prior.amplitude**2 * np.exp(-0.5 * (((a[:, None] - b[None]) / scale) ** 2).sum(-1))

    total = covariance(old, old) + prior.noise**2 * np.eye(len(old))
    residual = covariance(new[None], old) @ np.linalg.solve(total, cuts.width - law)
    base = kerf_width.width("eps_af", TEST_WIRE, 45.0, 6.3e-3, 0.05).width
    got = kerf_width.width("eps_af", TEST_WIRE, 45.0, 6.3e-3, 0.05, model="measured")
    assert float(got.width) == pytest.approx(float(base + residual[0]), rel=1e-9)
    far = kerf_width.width("eps_af", TEST_WIRE, 20.0, 1e-3, 0.05, model="measured").width
    assert float(far) == pytest.approx(
        float(kerf_width.width("eps_af", TEST_WIRE, 20.0, 1e-3, 0.05).width), rel=1e-3
    )


@pytest.mark.parametrize("model", LINES)
@pytest.mark.parametrize("foam", FOAMS)
def test_backward_is_the_inverse_of_forward(foam: str, model: kerf_width.Model) -> None:
    expected = rng.uniform(0.7e-3, 4e-3, (7, 1))
    power, speed = rng.uniform(30.0, 60.0, 5), rng.uniform(2e-3, 12e-3, 5)
    found = kerf_width.speed_for(foam, TEST_WIRE, power, expected, 0.05, model)
    assert found.shape == (7, 5)
    assert kerf_width.width(foam, TEST_WIRE, power, found, 0.05, model).width == pytest.approx(
        np.broadcast_to(expected, (7, 5)), rel=1e-9
    )
    needed = kerf_width.power_for(foam, TEST_WIRE, speed, expected, 0.05, model)
    assert kerf_width.width(foam, TEST_WIRE, needed, speed, 0.05, model).width == pytest.approx(
        np.broadcast_to(expected, (7, 5)), rel=1e-9
    )


def test_each_point_along_a_wire_has_its_own_kerf() -> None:
    speed = np.linspace(3e-3, 9e-3, 12).reshape(4, 3)
    together = kerf_width.width("xps_30", TEST_WIRE, 45.0, speed, 0.05)
    assert together.width.shape == together.low.shape == together.flag.shape == (4, 3)
    one = kerf_width.width("xps_30", TEST_WIRE, 45.0, float(speed[2, 1]), 0.05)
    assert float(one.width) == together.width[2, 1]
    assert np.all(np.diff(together.width.ravel()) < 0.0)
    assert np.all((together.low <= together.width) & (together.width <= together.high))


def test_the_longer_wire_needs_the_power_in_proportion() -> None:
    short = kerf_width.width("eps_a120", TEST_WIRE, 43.0, 6e-3, 0.05)
    long = kerf_width.width("eps_a120", HotWire(0.0004, 0.86), 86.0, 6e-3, 0.05)
    assert float(short.width) == pytest.approx(float(long.width), rel=1e-12)


@pytest.mark.parametrize(
    ("foam", "given", "expected"),
    [
        ("eps_af_plus", (45.0, 8e-3, 0.05), KerfFlag.OK),
        ("eps_af_plus", (45.0, 4e-3, 0.05), KerfFlag.TOO_HOT | KerfFlag.UNTESTED),
        ("xps_30", (36.0, 9e-3, 0.05), KerfFlag.TOO_COLD),
        ("xps_30", (45.0, 5e-3, 0.05), KerfFlag.OK),
        ("eps_af_plus", (45.0, 8e-3, 0.43), KerfFlag.THICKNESS),
        ("eps_af_plus", (45.0, 12e-3, 0.05), KerfFlag.UNTESTED),
        ("eps_a120", (70.0, 10e-3, 0.05), KerfFlag.UNTESTED),
    ],
)
def test_flags(foam: str, given: tuple[float, float, float], expected: KerfFlag) -> None:
    power, speed, thickness = given
    flag = int(kerf_width.width(foam, TEST_WIRE, power, speed, thickness).flag)
    assert KerfFlag(flag) == expected
    assert len(kerf_width.explain(flag)) == bin(flag).count("1")


def test_burnt_and_dragging_cells_of_the_tables_are_flagged() -> None:
    for foam, table in TABLES.items():
        flag = kerf_width.width(foam, TEST_WIRE, table.power, table.cuts.speed, 0.05).flag
        assert np.all(flag[table.burnt] & KerfFlag.TOO_HOT)
        assert np.all(flag[table.dragging] & KerfFlag.TOO_COLD)
        assert np.mean(flag[table.valid & ~table.dragging] == 0) > 0.65


def test_a_thicker_wire_is_flagged_and_no_kerf_is_below_it() -> None:
    got = kerf_width.width("eps_a120", HotWire(0.001, 0.43), 36.0, 10e-3, 0.05)
    assert int(got.flag) & KerfFlag.OTHER_WIRE
    assert float(got.width) == float(got.low) == 0.001
    made = wire.make_wire("kanthal_d", diameter_mm=0.4, temperature_c=300.0)
    assert HotWire.from_wire(made, 0.43) == TEST_WIRE


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("foam", ["xps_30", "eps_af"])
def test_curves_are_read_linearly_within_a_micrometre(foam: str, model: kerf_width.Model) -> None:
    table = kerf_width.curve(foam, TEST_WIRE, 45.0, 0.05, model=model)
    speed = np.linspace(0.5e-3, 50e-3, 40_001)
    exact = kerf_width.width(foam, TEST_WIRE, 45.0, speed, 0.05, model)
    assert np.abs(table.at(speed) - exact.width).max() < 1e-6
    assert np.abs(np.interp(speed, table.speed, table.low) - exact.low).max() < 1e-6
    assert np.abs(np.interp(speed, table.speed, table.high) - exact.high).max() < 1e-6
    assert np.all(np.diff(table.speed) > 0.0)
    assert len(table.speed) < 1000


def test_curves_between_given_speeds() -> None:
    table = kerf_width.curve("xps_30", TEST_WIRE, 45.0, 0.05, speeds=[8e-3, 2e-3])
    assert (table.speed[0], table.speed[-1]) == (2e-3, 8e-3)
    single = kerf_width.curve("xps_30", TEST_WIRE, 45.0, 0.05, speeds=5e-3)
    expected = float(kerf_width.width("xps_30", TEST_WIRE, 45.0, 5e-3, 0.05).width)
    assert single.at(np.array(5e-3)) == pytest.approx(expected, abs=1e-6)


def test_a_curve_of_absurd_power_ends() -> None:
    with pytest.raises(TandemError) as caught:
        kerf_width.curve("xps_30", TEST_WIRE, 1e15, 0.05)
    assert codes(caught) == ["kerf.melts"]
    with pytest.raises(TandemError) as caught:  # nearly at rest: metres of kerf
        kerf_width.curve("xps_30", TEST_WIRE, 45.0, 0.05, speeds=[1e-12, 50e-3])
    assert codes(caught) == ["kerf.input"]


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_what_is_not_a_positive_number_is_refused(bad: float, index: int) -> None:
    given = [45.0, 5e-3, 0.05]
    given[index] = bad
    with pytest.raises(TandemError) as caught:
        kerf_width.width("xps_30", TEST_WIRE, *given)
    assert codes(caught) == ["kerf.input"]
    assert caught.value.issues[0].field == ("power_w", "speed_m_s", "thickness_m")[index]
    with pytest.raises(TandemError):
        HotWire(bad, 0.4)


def test_shapes_that_do_not_fit_and_no_values_at_all() -> None:
    for speed in (np.full(3, 5e-3), np.zeros(0)):
        with pytest.raises(TandemError) as caught:
            kerf_width.width("xps_30", TEST_WIRE, np.full(2, 45.0), speed, 0.05)
        assert codes(caught) == ["kerf.input"]


def test_foams_and_models_without_data_are_named() -> None:
    with pytest.raises(TandemError) as caught:
        kerf_width.width("balsa", TEST_WIRE, 45.0, 5e-3, 0.05)
    assert codes(caught) == ["kerf.unknown_foam"]
    for model in MODELS:
        with pytest.raises(TandemError) as caught:
            kerf_width.width("eps", TEST_WIRE, 45.0, 5e-3, 0.05, model)
        assert codes(caught) == ["kerf.no_data"]
        assert "tandem kerf fit" in str(caught.value)
    with pytest.raises(TandemError) as caught:
        kerf_width.width("xps_30", TEST_WIRE, 45.0, 5e-3, 0.05, "guess")  # type: ignore[arg-type]
    assert codes(caught) == ["kerf.model"]
    with pytest.raises(TandemError) as caught:
        kerf_width.speed_for("xps_30", TEST_WIRE, 45.0, 2e-3, 0.05, "measured")
    assert codes(caught) == ["kerf.model"]


def test_kerfs_that_cannot_be_are_refused_with_a_remedy() -> None:
    for expected in (0.3e-3, [1e-3, 0.4e-3]):
        with pytest.raises(TandemError) as caught:
            kerf_width.speed_for("xps_30", TEST_WIRE, 45.0, expected, 0.05)
        assert codes(caught) == ["kerf.impossible"]
        assert caught.value.issues[0].hint
    with pytest.raises(TandemError) as caught:  # the foam takes more heat away than 5 W give
        kerf_width.speed_for("xps_30", TEST_WIRE, 5.0, 2e-3, 0.05, "general")
    assert codes(caught) == ["kerf.impossible"]
    with pytest.raises(TandemError) as caught:
        kerf_width.power_for("xps_30", TEST_WIRE, 1.0, 10e-3, 0.05, "dissertation")
    assert codes(caught) == ["kerf.impossible"]


def test_a_power_that_melts_the_wire_is_refused_with_the_range_of_the_tests() -> None:
    """The limit against the heat balance of a wire in air, solved for its temperature by scipy."""
    most = max_power(TEST_WIRE)
    air = float(cut_measurements.air_table()["conductivity"].max())

    def surplus(hot: float) -> float:
        around = np.pi * TEST_WIRE.diameter * 0.7 * 5.670374419e-8 * (hot**4 - 293.15**4)
        return float(around + np.pi * air * (hot - 293.15) - most / TEST_WIRE.length)

    assert optimize.brentq(surplus, 400.0, 3000.0) - 273.15 == pytest.approx(1300.0, abs=0.1)  # Kanthal D
    kerf_width.width("xps_30", TEST_WIRE, 0.99 * most, 5e-3, 0.05)
    for ask in (
        lambda: kerf_width.width("xps_30", TEST_WIRE, [40.0, 1.01 * most], 5e-3, 0.05),
        lambda: kerf_width.curve("xps_30", TEST_WIRE, 4000.0, 0.05),
        lambda: kerf_width.speed_for("xps_30", TEST_WIRE, 1e4, 2e-3, 0.05),
        lambda: kerf_width.power_for("xps_30", TEST_WIRE, 0.045, 15e-3, 0.05),
    ):
        with pytest.raises(TandemError) as caught:
            ask()
        assert codes(caught) == ["kerf.melts"]
        assert "35.9 to 54.9 W" in caught.value.issues[0].hint


def test_figures_of_materials_are_listed_with_values_and_units() -> None:
    rows = {(name, key): (value, source) for name, _, key, value, source in materials.figures()}
    steel, foam = materials.wire_materials()["spring_steel"], materials.foams()["eps_a120"]
    assert rows["spring_steel", "density"][0] == f"{steel.density:g} kg/m^3"
    assert rows["spring_steel", "yield"][0] == "1100 MPa"
    assert rows["spring_steel", "young"][0] == "206 at 20, 195 at 200, 187 at 300, 178 at 400 C, in GPa"
    assert rows["eps_a120", "kerf"][0].startswith(f"chi {foam.kerf.chi:.4g}, offset 0.664 mm")
    assert rows["eps_a120", "melt_temperature"][0] == f"{foam.melt_temperature:g} C"
    for (name, key), (_, source) in rows.items():
        both = materials.wire_materials() | materials.foams()
        assert both[name].sources[key] == source
    sheets = {(name, key): value for name, _, key, value, _ in materials.sheet_metal_figures()}
    assert sheets["aa1050_o", "tensile"] == "65 to 95 MPa"
    assert sheets["aa1050_o", "wall_angle_single"] == "65 deg"
