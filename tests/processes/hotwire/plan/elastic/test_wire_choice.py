"""Choice of wire and sweep where the problem leaves them open. The remedies of refusals work."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from planner.claims.claim import OneOf
from planner.geometry.arrays import Mesh
from planner.issues import Issue, TandemError
from planner.problem import BentWire, Part, Setup
from planner.processes.hotwire.claims import WireJoins
from planner.processes.hotwire.plan.elastic.job import ElasticJob
from planner.reading import materials
from planner.reading.materials import WireFile, WiresFile
from planner.targets import Targets
from tests.processes.hotwire.plan import panels

STEEL = {"material": "spring_steel", "diameter_mm": 1.5, "temperature_c": 300}


def wires(*lengths: float, **more: Any) -> tuple[BentWire, ...]:
    found = materials.available_wires([WiresFile(**(STEEL | more), lengths_mm=lengths)])
    return tuple(wire.to_wire() for wire in found)


def setup(at_hand: tuple[BentWire, ...] = (), **block: Any) -> Setup:
    bare = panels.setup(panels.stock(**block))
    return dataclasses.replace(bare, cell=dataclasses.replace(bare.cell, wires=at_hand))


@given(st.integers(50_000_000, 5_000_000_000), st.integers(200, 5000), st.integers(5000, 60_000))
def test_a_wire_at_hand_keeps_the_figures_of_its_file(length: int, thickness: int, width: int) -> None:
    common = {"material": "spring_steel", "length_mm": length / 1e6, "temperature_c": 300}
    strip = WireFile(**common, thickness_mm=thickness / 1e3, width_mm=width / 1e3)
    for wire in (strip, WireFile(**common, diameter_mm=thickness / 1e3)):
        assert WireFile.from_wire(wire.to_wire()) == wire


def open_operation(**more: Any) -> Any:
    return panels.operation(**({"sweep": "auto"} | more)).model_copy(update={"wire": None})


def refused(operation: Any, job_setup: Setup, part: Part) -> Issue:
    with pytest.raises(TandemError) as caught:
        ElasticJob(operation, job_setup, part).targets()
    return caught.value.issues[0]


def surface(x: float, y: float, height: Any, count: int = 31) -> Part:
    """A face z = height(x, y) over a rectangle, as the front of a part."""
    grid = np.stack(
        np.meshgrid(np.linspace(-x / 2, x / 2, count), np.linspace(-y / 2, y / 2, count)), axis=-1
    )
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return Part(front=Mesh(np.dstack([grid, height(grid[..., 0], grid[..., 1])]).reshape(-1, 3), faces))


def saddle(x: float, y: float, rise: float) -> Part:
    """A saddle whose edges are parabolas in both directions."""
    return surface(x, y, lambda a, b: rise * ((2 * a / x) ** 2 - (2 * b / y) ** 2) + 0.05)


def length_of(targets: Targets) -> float:
    (wire,) = (claim for claim in targets.claims if isinstance(claim, WireJoins))
    return 1e3 * wire.length


def test_of_the_wires_at_hand_one_that_does_is_taken_and_told() -> None:
    part, place = panels.part(), setup(wires(190, 520, 900))
    job = ElasticJob(open_operation(), place, part)
    targets = job.targets()
    (note,) = (issue for issue in targets.issues if issue.code == "wire.chosen")
    assert "520 mm, swept along y" in note.message
    assert targets.actions[0].text == "Wire: spring_steel 1.5 mm round"
    assert "518.2 mm cold" in targets.actions[1].text  # 12.6e-6 / K
    (choice,) = job.claims()
    assert isinstance(choice, OneOf)
    assert len(choice.either) == 3
    assert any(group[0] == targets.claims[0] for group in choice.either)
    stated = panels.operation(dict(STEEL, length_mm=length_of(targets)), sweep="auto")
    again = ElasticJob(stated, place, part).targets()
    np.testing.assert_array_equal(again.pose["left"], targets.pose["left"])


def test_where_the_stated_wire_does_not_do_the_one_at_hand_that_does_is_named() -> None:
    place = setup(wires(190, 520))
    issue = refused(panels.operation(dict(STEEL, length_mm=190), sweep="auto"), place, panels.part())
    assert issue.code == "wire.too_short"
    assert "spring_steel 1.5 mm round of 520 mm, which is available, works" in str(issue.hint)


def named(hint: str) -> dict[str, Any]:
    """Length, diameter and sweep that a hint names."""
    found = re.search(r"\(((?:diameter_mm|length_mm): [^;)]*)[;)]", hint)
    assert found is not None, hint
    pairs = dict(item.split(": ") for item in found[1].split(", "))
    return {key: value if value in ("x", "y") else float(value) for key, value in pairs.items()}


@pytest.mark.parametrize(
    ("size", "rise", "wire", "code"),
    [
        ((0.15, 0.22), 0.012, {"length_mm": 180}, "wire.too_short"),
        ((0.20, 0.20), 0.020, {"length_mm": 300, "diameter_mm": 8.0}, "wire.curvature"),
    ],
)
def test_the_wire_that_a_refusal_names_does(
    size: tuple[float, float], rise: float, wire: dict[str, Any], code: str
) -> None:
    part, place = saddle(*size, rise), setup(size=(size[0] + 0.01, size[1] + 0.01, 0.10))
    asked = {"sweep": "auto", "faces": ("front",)}
    issue = refused(panels.operation(STEEL | wire, **asked), place, part)
    assert issue.code == code
    new = named(str(issue.hint))
    asked["sweep"] = new.pop("sweep")
    done = ElasticJob(panels.operation(STEEL | wire | new, **asked), place, part).targets()
    assert length_of(done) == pytest.approx(new["length_mm"])


def shallow() -> tuple[Part, Setup]:
    """A trough that is bent along y alone, and so little that errors of the wire's ends move it far."""
    part = surface(0.30, 0.50, lambda x, y: 0.04 + 0.012 * (2 * y / 0.50) ** 2 + 0.0 * x)
    return part, setup(size=(0.31, 0.51, 0.10))


@pytest.mark.long
def test_a_longer_wire_that_a_refusal_names_holds_against_errors_of_its_ends() -> None:
    part, place = shallow()
    operation = panels.operation(STEEL | {"length_mm": 600}, sweep="auto", faces=("front",))
    issue = refused(operation, place, part)
    assert issue.code == "wire.end_error"
    new = named(str(issue.hint))
    sweep = new.pop("sweep")
    assert new["length_mm"] > 700
    operation = panels.operation(STEEL | new, sweep=sweep, faces=("front",))
    assert ElasticJob(operation, place, part).targets()


def test_the_tolerance_that_a_refusal_names_is_kept() -> None:
    part, place = shallow()
    operation = panels.operation(STEEL | {"length_mm": 600}, sweep="auto", faces=("front",))
    hint = str(refused(operation, place, part).hint)
    found = re.search(r"shape_tol_mm: ([\d.]+) works", hint)
    assert found is not None, hint
    assert ElasticJob(operation.model_copy(update={"shape_tol_mm": float(found[1])}), place, part).targets()


@pytest.mark.long
def test_a_panel_is_split_where_both_sides_do() -> None:
    """A wave needs a wire with an inflection, which snaps; a side of it is an arc. The sides are cut off here
    with trimesh and put into blocks of their own."""
    part = surface(0.26, 0.3, lambda x, y: 0.05 + 0.014 * np.sin(2 * np.pi * x / 0.26) + 0.0 * y)
    place, asked = setup(size=(0.28, 0.31, 0.10)), {"faces": ("front",)}
    steel = STEEL | {"length_mm": 420, "diameter_mm": 1.2}
    hint = str(refused(panels.operation(steel, sweep="auto", **asked), place, part).hint)
    found = re.search(r"split the panel at x = (-?[\d.]+) mm", hint)
    assert found is not None, hint
    sides = re.findall(r"with a wire of ([\d.]+) mm \(([\d.]+) mm round\) swept along (\w)", hint)
    at = 1e-3 * float(found[1])
    assert part.front is not None
    for sign, (length, diameter, sweep) in zip((-1.0, 1.0), sides, strict=True):
        whole = trimesh.Trimesh(part.front.vertices, part.front.faces, process=False)
        half = whole.slice_plane([at, 0, 0], [sign, 0, 0])
        wide = 0.14 - sign * at
        middle = at + 0.5 * sign * wide
        face = Mesh(np.asarray(half.vertices) - [middle, 0, 0], np.asarray(half.faces, dtype=np.int64))
        own = STEEL | {"length_mm": float(length), "diameter_mm": float(diameter)}
        block = setup(size=(wide, 0.31, 0.10))
        operation = panels.operation(own, sweep=sweep, **asked)
        assert ElasticJob(operation, block, Part(front=face)).targets()


@pytest.mark.long
def test_where_nothing_helps_that_is_said() -> None:
    """A face with many waves both ways: no elastica meets it, whole or in halves."""
    face = surface(0.15, 0.2, lambda x, y: 0.05 + 0.006 * np.sin(150 * x) * np.sin(150 * y))
    operation = panels.operation(sweep="auto", faces=("front",), kerf_mm=0.5, shape_tol_mm=0.3)
    issue = refused(operation, setup(), face)
    assert issue.code in ("wire.shape", "wire.unstable")
    assert "no wire, sweep, cut line or tolerance that was tried works" in str(issue.hint)


@pytest.mark.parametrize(
    ("entries", "field"),
    [
        ([STEEL | {"lengths_mm": (500.0, 500.5)}], "wires.0.lengths_mm"),
        ([STEEL | {"lengths_mm": (500.0, 500.0)}], "wires.0.lengths_mm"),
        ([STEEL | {"lengths_mm": (500.0,)}] * 2, "wires.1"),
        ([STEEL | {"lengths_mm": (500.0,), "temperature_c": 950}], "wires.0.temperature_c"),
        ([STEEL | {"lengths_mm": (500.0,), "material": "tin"}], "wires.0.material"),
    ],
)
def test_lists_of_wires_are_refused_by_field(entries: list[dict[str, Any]], field: str) -> None:
    with pytest.raises(TandemError) as caught:
        materials.available_wires([WiresFile(**entry) for entry in entries])
    assert [issue.field for issue in caught.value.issues] == [field]


def test_a_stated_wire_has_to_be_one_of_those_at_hand() -> None:
    have = wires(400, 520)
    stated = panels.operation(dict(STEEL, length_mm=520))
    assert list(materials.wire_faults(have, [stated])) == []
    assert list(materials.wire_faults((), [stated])) == []
    assert list(materials.wire_faults(have, [open_operation()])) == []
    for wrong in ({"length_mm": 500}, {"length_mm": 520, "temperature_c": 250}):
        (issue,) = materials.wire_faults(have, [panels.operation(STEEL | wrong)])
        assert issue.field == "operations.0.wire"
    (issue,) = materials.wire_faults((), [open_operation()])
    assert issue.field == "operations.0.wire"
    strip = {"diameter_mm": None, "width_mm": 8, "thickness_mm": 0.8}
    heated = open_operation(kerf_mm=None, power_w=100)
    (issue,) = materials.wire_faults(wires(400, **strip), [heated])
    assert issue.field == "operations.0.power_w"
