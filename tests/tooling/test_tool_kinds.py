"""Tools are one sum type: each kind has only its own fields. Work that needs a kind refuses all others."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import types
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from pydantic import TypeAdapter

from planner import pipeline
from planner.cell import plant
from planner.cell.bodies import shapes_by_body
from planner.geometry import corner_rounding
from planner.geometry.arrays import Shape, axis_ends, inverse, transform
from planner.geometry.arrays import hull_points as hull
from planner.geometry.units import MM
from planner.issues import TandemError
from planner.problem import Problem
from planner.processes import registry
from planner.processes.hotwire.plan.straight import job
from planner.proof.prove import Prover
from planner.reading import cell
from planner.targets import tool_reach
from planner.tooling import (
    Bow,
    CutterGeometry,
    FormingTool,
    Gripper,
    Knife,
    Mill,
    PlainTool,
    Tool,
    Torch,
    WireHolder,
    ball_tool,
    bow,
    disk_tool,
    mill,
    working_solid,
)
from planner.tooling.holding_tools import OnFlange
from tests import small_forming
from tests.cell.cells import BLOCK, alone
from tests.processes.hotwire.plan import foam_blocks
from tests.processes.hotwire.proof import straight_job
from tests.processes.milling.plan import small_mill
from tests.proof.provers import broken

MILL = {"kind": "mill", "diameter_mm": 10, "flute_mm": 30, "overhang_mm": 60, "mass_kg": 3}
PLAIN = {
    "kind": "plain",
    "tcp": {"xyz_mm": [0, 0, 120]},
    "mass_kg": 0.7,
    "cog_mm": [0, 1, 40],
    "shapes": [{"kind": "box", "size_mm": [20, 30, 100], "pose": {"xyz_mm": [0, 0, 50]}}],
}
FILES: dict[str, tuple[dict[str, Any], type[OnFlange]]] = {
    "wire_holder": ({"kind": "wire_holder", "side": "end"}, WireHolder),
    "bow": ({"kind": "bow"}, Bow),
    "gripper_plate": ({"kind": "gripper_plate"}, Gripper),
    "vacuum_cup": ({"kind": "vacuum_cup", "holding_n": 9}, Gripper),
    "ball_tool": ({"kind": "ball_tool"}, FormingTool),
    "disk_tool": ({"kind": "disk_tool"}, FormingTool),
    "heat_tool": ({"kind": "heat_tool"}, FormingTool),
    "mill": (MILL, Mill),
    "torch": ({"kind": "torch", "cuts_by": "plasma", "kerf_mm": 1.2}, Torch),
    "knife": ({"kind": "knife", "width_mm": 4, "ground_mm": 4, "blade_mm": 20}, Knife),
    "plain": (PLAIN, PlainTool),
}
WORKS = (Bow, FormingTool, Mill, Torch, Knife)


def read_tool(kind: str) -> Tool:
    """Read the tool of that kind from a cell file."""
    spec: Any = TypeAdapter(cell.ToolFile).validate_python(FILES[kind][0])
    return cell.build_tool(spec, Path())


def all_kinds() -> list[type]:
    return list(get_args(Tool))


def test_the_table_has_every_kind_of_cell_files_and_of_the_sum_type() -> None:
    union = get_args(cell.ToolFile)[0]
    said = {get_args(get_type_hints(spec)["kind"])[0] for spec in get_args(union)}
    assert said == set(FILES)
    assert {cls for _, cls in FILES.values()} == set(all_kinds()) == set(OnFlange.__subclasses__())


@pytest.mark.parametrize("kind", FILES)
def test_a_cell_file_gives_a_tool_of_its_kind(kind: str) -> None:
    tool = read_tool(kind)
    assert type(tool) is FILES[kind][1]
    assert tool.mass > 0.0
    assert tool.tcp.shape == (4, 4)


@pytest.mark.parametrize("cls", all_kinds())
def test_no_kind_has_a_field_that_may_be_missing(cls: type) -> None:
    hints = get_type_hints(cls)
    for field in dataclasses.fields(cls):
        assert field.default is dataclasses.MISSING, field.name
        assert field.default_factory is dataclasses.MISSING, field.name
        if get_origin(hints[field.name]) in (Union, types.UnionType):
            assert type(None) not in get_args(hints[field.name]), field.name


def test_a_plain_tool_is_what_its_file_says() -> None:
    tool = read_tool("plain")
    assert (tool.name, tool.mass) == ("plain", 0.7)
    np.testing.assert_allclose(tool.cog, [0.0, 0.001, 0.04])
    np.testing.assert_allclose(tool.tcp[:3, 3], [0.0, 0.0, 0.12])
    (box,) = tool.shapes
    assert (box.kind, box.size) == ("box", (0.02, 0.03, 0.1))


@pytest.mark.parametrize("kind", FILES)
def test_only_tools_that_work_with_something_rigid_have_a_solid_that_may_touch_the_stock(kind: str) -> None:
    tool = read_tool(kind)
    solid = working_solid(tool)
    bodies = shapes_by_body(alone("irb140", tool), BLOCK)
    assert ("arm/edge" in bodies) == isinstance(tool, WORKS)
    assert (solid is not None) == isinstance(tool, WORKS)
    if solid is not None:
        assert bodies["arm/edge"] == (solid,)
        assert not any(solid is shape for shape in tool.shapes)


@pytest.mark.parametrize("kind", FILES)
def test_tools_go_through_pickle_and_have_a_digest_of_their_own(kind: str) -> None:
    tool = read_tool(kind)
    again = pickle.loads(pickle.dumps(tool))
    assert type(again) is type(tool)
    assert plant.content_digest(again) == plant.content_digest(tool)
    assert sum(plant.content_digest(read_tool(other)) == plant.content_digest(tool) for other in FILES) == 1


@pytest.mark.parametrize(("tilt", "throat"), [(0.0, 0.385), (np.pi / 3, 0.4 - 0.02 * np.sin(np.pi / 3))])
def test_a_bow_knows_its_wire_and_the_room_behind_it(tilt: float, throat: float) -> None:
    """The beam's near face is half of its 30 mm before its middle, from which 400 mm are measured; a corner
    of the stem of 40 mm, which ends at the beam's middle, stands out of a bow that leans by 60 degrees."""
    tool = bow(0.5, 0.4, wire_diameter=0.0006, tilt=tilt)
    assert tool.span == pytest.approx(0.5, abs=1e-12)
    assert tool.radius == pytest.approx(0.0003, abs=1e-12)
    assert tool.throat == pytest.approx(throat, abs=1e-12)


def test_a_tool_cuts_as_far_from_its_tcp_as_its_solid_goes() -> None:
    """A wire to its clamps on either side; a ball's shaft and a cutter from tip to holder, but for rounded
    ends; a solid with corners counts as nothing long."""
    assert tool_reach(bow(0.8, 0.4)) == pytest.approx(0.4)
    ball = ball_tool(0.01, 0.3)
    assert tool_reach(ball) == pytest.approx(ball.head.length - 0.01)
    long = mill(CutterGeometry("cylinder", 0.005, 0.0, 0.05, 0.25))
    assert tool_reach(long) == pytest.approx(0.25)
    assert working_solid(disk_tool(0.03, 0.3, 0.01, 0.01)).kind == "mesh"  # type: ignore[union-attr]
    assert (
        tool_reach(disk_tool(0.03, 0.3, 0.01, 0.01))
        == corner_rounding.ROTATION_LEVER_MM * MM
        == tool_reach(read_tool("plain"))
    )


def refusal(problem: Problem) -> dict[str, str]:
    with pytest.raises(TandemError) as caught:
        registry.job(problem, 0).targets()
    return {issue.code: issue.message for issue in caught.value.issues}


@pytest.mark.parametrize("kind", [kind for kind, (_, cls) in FILES.items() if cls is not Bow])
def test_a_straight_wire_is_cut_with_a_bow_alone(kind: str) -> None:
    setup = foam_blocks.setup()
    arms = [dataclasses.replace(a, tool=read_tool(kind)) if a.name == "left" else a for a in setup.cell.arms]
    setup = dataclasses.replace(setup, cell=dataclasses.replace(setup.cell, arms=tuple(arms)))
    square = np.array([(-0.08, 0.02), (-0.08, 0.08), (0.08, 0.08), (0.08, 0.02)])
    part = foam_blocks.part(foam_blocks.prism("sq", square, closed=True))
    with pytest.raises(TandemError) as caught:
        job.StraightJob(foam_blocks.operation(), setup, part).targets()
    (issue,) = caught.value.issues
    assert issue.code == "bow.missing"
    assert read_tool(kind).name in issue.message


@pytest.mark.parametrize("kind", [kind for kind, (_, cls) in FILES.items() if cls is not Mill])
def test_only_a_mill_mills(tmp_path: Path, kind: str) -> None:
    data = copy.deepcopy(small_mill.WALL)
    data["cell"]["arms"][0]["tool"] = FILES[kind][0]
    data["stock"]["foam"] = "xps"
    read_back = pipeline.load(small_mill.write(tmp_path, data))
    assert "has no cutter" in refusal(read_back)["milling.tool"]


FIT = {
    "spif": ({"ball_tool"},),
    "dsif": ({"ball_tool"}, {"ball_tool"}),
    "dpif_p": ({"ball_tool"}, {"ball_tool", "disk_tool"}),
    "heat": ({"ball_tool"}, {"heat_tool"}),
}
"""Kinds of tools that each arm of a mode may carry, from docs/forming.md."""


@pytest.mark.parametrize("mode", FIT)
@pytest.mark.parametrize("kind", FILES)
def test_sheets_are_formed_by_the_tools_that_their_mode_wants(tmp_path: Path, mode: str, kind: str) -> None:
    for place, fits in enumerate(FIT[mode]):
        data = small_forming.problem(mode)
        if kind in fits:
            continue
        data["cell"]["arms"][place]["tool"] = FILES[kind][0]
        problem = pipeline.load(small_forming.write(tmp_path, data))
        refusal_text = refusal(problem)["forming.tool"]
        assert f"arm {problem.operations[0].arms[place]} carries" in refusal_text
        assert f"mode {mode} needs {'heat_tool' if 'heat_tool' in fits else 'ball_tool'}" in refusal_text


def test_points_that_hold_a_shape() -> None:
    """Boxes by their corners, round shapes by the box about them, with their caps."""
    place = read_tool("bow").tcp
    sizes = {"box": (0.1, 0.2, 0.3), "cylinder": (0.05, 0.3), "capsule": (0.05, 0.2), "sphere": (0.15,)}
    half = {
        "box": [0.05, 0.1, 0.15],
        "cylinder": [0.05, 0.05, 0.15],
        "capsule": [0.05, 0.05, 0.15],
        "sphere": [0.15, 0.15, 0.15],
    }
    for kind, size in sizes.items():
        points = hull(Shape(kind, size, place))  # type: ignore[arg-type]
        np.testing.assert_allclose(points.max(axis=0), half[kind])
        np.testing.assert_allclose(points.min(axis=0), -np.array(half[kind]))
    ends = axis_ends(Shape("capsule", (0.05, 0.2), place))
    np.testing.assert_allclose(
        transform(inverse(place), ends), [[0.0, 0.0, -0.1], [0.0, 0.0, 0.1]], atol=1e-12
    )


def test_the_proof_takes_no_other_tools_solid_for_a_wire() -> None:
    """The claimed wires are proven with bows, and not with rods of their size that form sheets."""

    def rod(tool: Tool) -> FormingTool:
        assert isinstance(tool, Bow)
        common = {field.name: getattr(tool, field.name) for field in dataclasses.fields(OnFlange)}
        return FormingTool(**common, head=ball_tool(tool.radius, 0.3).head, solid=tool.wire)

    def rejected_codes(problem: Problem) -> set[str]:
        proof = Prover(problem, straight_job.claims()).prove(straight_job.programs(), last="verify.bow")
        return broken(proof)

    problem = straight_job.problem()
    arms = tuple(dataclasses.replace(arm, tool=rod(arm.tool)) for arm in problem.cell.arms)
    changes = {
        index: dataclasses.replace(change, tools={arm: rod(tool) for arm, tool in change.tools.items()})
        for index, change in problem.changes.items()
    }
    other = dataclasses.replace(problem, cell=dataclasses.replace(problem.cell, arms=arms), changes=changes)
    assert rejected_codes(problem) == set()
    assert rejected_codes(other) == {"verify.bow"}
