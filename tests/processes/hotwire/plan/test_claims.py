"""Inputs of hot-wire claims, against tables, raw data, closed forms and the planner's figures.

The claims share no code with the planner.
"""

from __future__ import annotations

import ast
import csv
from pathlib import Path

import numpy as np
import pytest
import yaml

import planner
from planner.catalogue import materials
from planner.geometry.arrays import RuledSurface
from planner.geometry.rulings import resample
from planner.issues import TandemError
from planner.processes.hotwire.claims import SlitsAllowed
from planner.processes.hotwire.plan import claims, wire
from planner.processes.hotwire.plan.claims import (
    claimed_cuts,
    nesting_depths,
    rectangle_torsion,
    slot_width_curve,
    wire_stiffness,
)
from planner.processes.hotwire.plan.kerf import width as kerf_width
from planner.processes.hotwire.plan.operation import SurfaceCut
from planner.processes.hotwire.plan.straight.cut import choose_start
from planner.processes.hotwire.plan.straight.order import contour_depths, nominal_surfaces
from planner.processes.hotwire.proof.slits import (
    SLIT_CONTOUR_FRACTION,
    SLIT_DIAGONAL_FRACTION,
    SLIT_LENGTH_FACTOR,
    ContourSection,
)
from planner.reading import materials as material_file
from tests.processes.hotwire.plan import foam_blocks as blocks

DATA = Path(planner.__file__).parent / "data"
RAW = yaml.safe_load((DATA / "materials.yaml").read_text(encoding="utf-8"))
TESTED = sorted(name for name, entry in RAW["foams"].items() if "kerf" in entry)
LENGTH, DIAMETER = 0.43, 0.0004
SPAN = 0.4


MADE_BY: dict[str, set[str]] = {
    "processes.hotwire.plan.claims": {"planner.geometry.arrays", "planner.processes.hotwire.plan.operation"}
}
OUTSIDE = {
    "planner.catalogue.materials",
    "planner.claims.claim",
    "planner.claims.dialogue",
    "planner.claims.segments",
    "planner.claims.sentences",
    "planner.geometry.rulings",
    "planner.geometry.units",
    "planner.issues",
    "planner.problem",
    "planner.processes.hotwire.claims",
    "planner.processes.hotwire.sentences",
    "planner.reading.materials",
    "planner.tooling",
}


@pytest.mark.parametrize("module", sorted(MADE_BY))
def test_what_makes_claims_uses_nothing_that_plans(module: str) -> None:
    """As the page on the proof says."""
    root = Path(planner.__file__).parent

    def imported(path: Path, required_text: str = "") -> set[str]:
        text, found = path.read_text(encoding="utf-8"), set()
        if required_text not in text:
            return found
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                found |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                whole = {f"{node.module}.{alias.name}" for alias in node.names}
                inside = {one for one in whole if (root.parent / f"{one.replace('.', '/')}.py").is_file()}
                found |= inside | ({node.module} if inside != whole else set())
        return {name for name in found if name.startswith("planner")}

    name = f"planner.{module}"
    own = imported(root.parent / f"{name.replace('.', '/')}.py")
    assert own <= OUTSIDE | MADE_BY[module]
    used_by = {
        path.relative_to(root).with_suffix("").as_posix()
        for path in root.rglob("*.py")
        if name in imported(path, name.rpartition(".")[2])
    }
    folder = "processes/hotwire/plan"
    entries = {f"{folder}/straight/job", f"{folder}/elastic/job"}  # which hand the claims over
    assert used_by and used_by <= entries


# ---- the slot ----------------------------------------


@pytest.mark.parametrize("name", TESTED)
def test_the_slot_follows_the_raw_figures_of_its_foam(name: str) -> None:
    entry = RAW["foams"][name]
    heat = entry["density"]["value"] * entry["specific_heat"]["value"]
    heat *= entry["melt_temperature"]["value"] - 20.0
    speed = np.array([0.0005, 0.001, 0.0023, 0.007, 0.0311, 0.050, 0.080])
    ideal = 42.0 / LENGTH / heat / np.clip(speed, 0.001, 0.050)
    by_hand = np.maximum(entry["kerf"]["chi"] * ideal - entry["kerf"]["offset_mm"] * 1e-3, DIAMETER)
    got = slot_width_curve(None, 42.0, materials.foam(name), DIAMETER, LENGTH).at(speed)
    np.testing.assert_allclose(got, by_hand, rtol=3e-6)


@pytest.mark.parametrize("name", TESTED)
def test_nine_of_ten_measured_cells_are_within_the_stated_interval_of_the_slot(name: str) -> None:
    """The dissertation's tables as printed; the interval is the one that planning tells."""
    with (DATA / "kerf_cuts.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    mine = [
        r for r in rows if r["foam"] == name and r["measured_mm"] and not r["shading"].startswith("burnt")
    ]
    hits = 0
    for row in mine:
        power, speed = float(row["power_w"]), float(row["speed_mm_s"]) * 1e-3
        told = kerf_width.width(name, kerf_width.TEST_WIRE, power, speed, 0.05)
        width = float(
            slot_width_curve(None, power, materials.foam(name), DIAMETER, LENGTH).at(np.array(speed))
        )
        hits += abs(width - float(row["measured_mm"]) * 1e-3) <= float(told.high - told.low) / 2.0
    assert len(mine) >= 17
    assert hits >= 0.85 * len(mine)


@pytest.mark.parametrize("name", TESTED)
def test_both_readings_of_the_model_agree(name: str) -> None:
    speed = np.geomspace(1e-3, 50e-3, 777)
    own = slot_width_curve(None, 55.0, materials.foam(name), 0.0006, 0.7).at(speed)
    planned = kerf_width.curve(name, kerf_width.HotWire(0.0006, 0.7), 55.0, 0.1, speed).at(speed)
    assert np.abs(own - planned).max() < 1.5e-6


def test_the_slot_in_a_foam_of_ones_own_follows_its_file(tmp_path: Path) -> None:
    """By hand from the file's text: 30 W over 0.5 m at 4 mm/s in 20 kg/m3 of 1400 J/(kg K), 200 K to melt."""
    path = tmp_path / "own.yaml"
    path.write_text(
        "tandem_foam: 1\nname: own\ndensity_kg_m3: 20\nspecific_heat_j_kg_k: 1400\nmelt_temperature_c: 220\n"
        "kerf: {chi: 1.25, offset_mm: 0.3, spread_mm: 0.1, count: 9, mean_ideal_mm: 2, scatter_mm2: 4, "
        "power_per_length_w_m: [50, 100], speed_mm_s: [2, 10], thickness_mm: 50, wire_diameter_mm: 0.4}\n"
    )
    width = 1.25 * 30.0 / 0.5 / (20.0 * 1400.0 * 200.0) / 0.004 - 0.0003
    got = slot_width_curve(None, 30.0, material_file.read_foam(path), 0.0004, 0.5).at(
        np.array([0.004, 0.049])
    )
    np.testing.assert_allclose(got, [width, 0.0004], rtol=1e-5)


def test_what_a_slot_needs_is_asked_for() -> None:
    bare = materials.FoamMaterial("bare", "no tests", 20.0, {})
    for code, given in (
        ("stock.foam_missing", (None, 30.0, None, 0.0004, 0.4)),
        ("kerf.no_data", (None, 30.0, bare, 0.0004, 0.4)),
        ("kerf.input", (None, 30.0, materials.foam("xps_30"), 0.0, 0.4)),
    ):
        with pytest.raises(TandemError) as caught:
            slot_width_curve(*given)
        assert [issue.code for issue in caught.value.issues] == [code]


@pytest.mark.parametrize("name", sorted(RAW["foams"]))
def test_foams_are_read_as_their_file_says(name: str) -> None:
    """Both sides read materials by one reader, so that it is held against the raw file."""
    entry, foam = RAW["foams"][name], materials.foam(name)
    assert foam.density == entry["density"]["value"]
    for key, got in (("specific_heat", foam.specific_heat), ("melt_temperature", foam.melt_temperature)):
        assert got == (entry[key]["value"] if key in entry else None)
    assert (foam.kerf is None) == ("kerf" not in entry)
    if foam.kerf is not None:
        assert foam.kerf.chi == entry["kerf"]["chi"]
        assert foam.kerf.offset * 1e3 == pytest.approx(entry["kerf"]["offset_mm"])


@pytest.mark.parametrize("name", sorted(RAW["wires"]))
def test_wires_are_read_as_their_file_says(name: str) -> None:
    entry, got = RAW["wires"][name], materials.wire_material(name)
    assert (got.density, got.poisson) == (entry["density"]["value"], entry["poisson"]["value"])
    assert got.yield_stress == float(entry["yield"]["value"])
    assert [list(row) for row in got.young_table] == [[float(x) for x in r] for r in entry["young"]["table"]]


# ---- stiffness ----------------------------------------


@pytest.mark.parametrize(("ratio", "table"), [(1.0, 0.1406), (2.0, 0.229), (5.0, 0.291), (10.0, 0.312)])
def test_torsion_of_rectangles(ratio: float, table: float) -> None:
    """Timoshenko and Goodier, Theory of Elasticity, art. 109, table of k1."""
    assert rectangle_torsion(ratio * 0.001, 0.001) == pytest.approx(table * ratio * 1e-12, rel=3e-3)


@pytest.mark.parametrize("name", sorted(RAW["wires"]))
@pytest.mark.parametrize("size", [(1.5, None, None), (None, 5.0, 0.5), (None, 2.0, 1.5)])
def test_both_readings_of_a_wire_agree(name: str, size: tuple[float | None, ...]) -> None:
    hot = 0.6 * materials.wire_material(name).limit_temperature
    own = wire_stiffness(materials.wire_material(name), *(None if s is None else s * 1e-3 for s in size), hot)
    made = wire.make_wire(name, *size, temperature_c=hot)
    assert own.ei_soft == pytest.approx(made.bending_stiffness, rel=1e-9)
    assert own.ei_stiff == pytest.approx(
        made.bending_stiffness * made.stiffness_ratios.stiff_bending, rel=1e-9
    )
    assert own.gj == pytest.approx(made.torsional_stiffness, rel=5e-3)  # the planner's is a fit to the series
    assert own.weight == pytest.approx(made.weight_per_length, rel=1e-9)
    assert own.max_curvature == pytest.approx(made.max_curvature, rel=1e-9)
    assert own.thickness == pytest.approx(made.thickness)


# ---- what is cut, and when ----------------------------------------


def ring(
    name: str, x: float, z: float, radius: float, corners: int, hole: bool = False, turn: float = 0.0
) -> RuledSurface:
    angle = turn + 2.0 * np.pi * np.arange(corners) / corners
    angle = angle if hole else angle[::-1]
    points = np.column_stack([x + radius * np.cos(angle), z + radius * np.sin(angle)])
    return blocks.prism(name, points, corner=corners < 12, closed=True, hole=hole)


def plate(seed: int) -> tuple[RuledSurface, ...]:
    """An outline with holes in it, some of which hold a piece, which may have a bore; in any order."""
    rng = np.random.default_rng(seed)
    out = []
    if rng.random() < 0.7:
        half = np.array([0.12, 0.04]) * rng.uniform(0.8, 1.0, 2)
        corners = half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) + [0.0, 0.05]
        out.append(blocks.prism("rim", corners, closed=True))
    for k, x in enumerate((-0.06, 0.0, 0.06)):
        middle = x + rng.uniform(-0.008, 0.008), 0.05 + rng.uniform(-0.006, 0.006)
        turn, corners = rng.uniform(0.0, 6.0), int(rng.choice([4, 5, 60, 90]))
        size = rng.uniform(0.015, 0.022)
        out.append(ring(f"hole_{k}", *middle, size, corners, True, turn))
        if rng.random() < 0.5:
            inner = size * rng.uniform(0.3, 0.55)
            out.append(ring(f"core_{k}", *middle, inner, int(rng.choice([4, 6, 50])), turn=turn + 0.3))
            if rng.random() < 0.5:
                out.append(ring(f"bore_{k}", *middle, 0.4 * inner, 40, True))
    return tuple(out[k] for k in rng.permutation(len(out)))


@pytest.mark.parametrize("seed", range(12))
def test_both_orders_of_a_plate_agree(seed: int) -> None:
    part, setup = blocks.part(*plate(seed)), blocks.setup()
    op = blocks.operation(cuts="all")
    assert nesting_depths(list(part.ruled)) == contour_depths(part.ruled)
    planned = [one.segment for one in nominal_surfaces(op, setup, part)]
    assert [one.segment for one in claimed_cuts(op, setup.stock, part, SPAN)] == planned


SIDES = ("left", "right", "front", "back", "bottom", "top")


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("along", ["auto", "x", "y", "z"])
@pytest.mark.parametrize("size", [(0.3, 0.2, 0.1), (0.2, 0.3, 0.3), (0.1, 0.5, 0.2)])
def test_both_readings_of_a_trimmed_side_agree(
    side: str, along: str, size: tuple[float, float, float]
) -> None:
    axis = SIDES.index(side) // 2
    if along == "xyz"[axis]:
        return
    over = np.zeros((2, 3))
    over[SIDES.index(side) % 2, axis] = 0.01
    setup = blocks.setup(blocks.stock(size, oversize=over))
    op = blocks.operation(cuts=[{"trim": [side], "along": along}])
    (planned,) = nominal_surfaces(op, setup, None)
    (own,) = claimed_cuts(op, setup.stock, None, SPAN)
    assert own.segment == planned.segment

    def lines(ruled: RuledSurface) -> list[list[list[float]]]:
        both = np.stack([ruled.start, ruled.end], axis=1).round(9) + 0.0
        return sorted(sorted(line.tolist()) for line in both)

    assert lines(own.ruled) == lines(planned.ruled)
    outwards = np.cross(own.ruled.start[1] - own.ruled.start[0], own.ruled.end[0] - own.ruled.start[0])
    assert outwards[axis] * (1.0 if SIDES.index(side) % 2 else -1.0) > 0.0
    place = (-0.5, 0.5)[SIDES.index(side) % 2] * size[axis] + (0.5 * size[2] if axis == 2 else 0.0)
    np.testing.assert_allclose(own.ruled.start[:, axis], place)


# ---- slits ----------------------------------------


def slits(seed: int) -> SlitsAllowed:
    setup = blocks.setup()
    found = claims.straight_claims(blocks.operation(cuts="all"), setup, blocks.part(*plate(seed)))
    (one,) = (claim for claim in found if isinstance(claim, SlitsAllowed))
    return one


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("seed", range(16))
@pytest.mark.parametrize("lead", ["auto", (1.0, 0.0, 0.4), (0.0, 0.0, -1.0)])
def test_slits_that_the_search_finds_are_allowed(seed: int, lead: str | tuple[float, float, float]) -> None:
    """The search tries other places and directions, by shapely; the proof's bound must hold for all it
    finds."""
    claim, ruled = slits(seed), plate(seed)
    up = np.array([0.0, 0.0, 1.0])
    seen = 0
    for number, contour in enumerate(ruled):
        section = ContourSection.across(claim.contours, number, claim.box)
        cut = SurfaceCut(surface=contour.name, lead=lead)
        own = resample(contour, 3e-5, 0.004)  # as cuts are, before their beginning is chosen
        start = choose_start(own, ruled, cut, claim.box, up)
        assert section.is_surrounded == (contour.hole or "core" in contour.name)
        if not section.is_surrounded:
            continue
        least = section.min_length_in_part(None if lead == "auto" else np.array(lead))
        spare = SLIT_CONTOUR_FRACTION * section.length + SLIT_DIAGONAL_FRACTION * section.diagonal
        assert start.length_in_part <= SLIT_LENGTH_FACTOR * least + spare
        middle = 0.5 * (own.start + own.end)[start.first] @ section.axes
        way = start.direction @ section.axes
        far = np.array([start.length])
        mine = float(section.length_in_part(middle[None], way[None], far)[0])
        assert mine == pytest.approx(start.length_in_part, abs=2e-5)
        seen += 1
    assert seen >= 3


def test_a_plate_of_even_thickness() -> None:
    """By hand: a hole of 20 mm in the middle of an outline of 240 x 80 mm is 30 mm from its long sides, and
    60 mm from a short one where a lead says so."""
    angle = 2.0 * np.pi * np.arange(360) / 360
    hole = np.column_stack([0.01 * np.cos(angle), 0.05 + 0.01 * np.sin(angle)])
    rim = [(-0.07, 0.01), (-0.07, 0.09), (0.07, 0.09), (0.07, 0.01)]
    part = blocks.part(
        blocks.prism("rim", rim, closed=True),
        blocks.prism("hole", hole, corner=False, closed=True, hole=True),
    )
    found = claims.straight_claims(blocks.operation(cuts="all"), blocks.setup(), part)
    (claim,) = (one for one in found if isinstance(one, SlitsAllowed))
    assert [str(one.segment) for one in claim.contours] == ["cut/rim", "cut/hole"]
    section = ContourSection.across(claim.contours, 1, claim.box)
    assert section.length == pytest.approx(0.02 * np.pi, rel=1e-4)
    assert section.min_length_in_part(None) == pytest.approx(0.030, abs=1e-5)
    assert section.min_length_in_part(np.array([-1.0, 0.0, 0.0])) == pytest.approx(0.060, abs=1e-4)
