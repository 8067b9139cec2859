"""A user's own robot in a cell, described by its URDF.

The plan equals that of the catalogue robot and is proven. Faults are reported by field.
"""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import trimesh
import yaml

from planner import pipeline
from planner.catalogue import robots
from planner.cell.kinematics import forward_kinematics
from planner.geometry.arrays import from_rpy, inverse, to_rpy
from planner.issues import TandemError
from planner.proof.kinematics import arm_model
from planner.reading import problem as problem_file
from planner.report import setup_sheet
from planner.tooling import wire_holder
from tests import small_problem, urdf_text
from tests.refusals import POSES, change

FOOT = from_rpy([0.1, 0.05, -0.3], [0.0, 0.0, np.pi / 2])
HAND = from_rpy([0.01, 0.0, 0.02], [0.0, np.pi / 2, 0.0])
TEXT = robots.urdf_path("irb140").read_text("utf-8")
LINES = {"name": "mine", "family": "abb", "payload_kg": 6, "full_speed_after_s": 0.25}


def fixed_joint(name, pose, parent, child):
    xyz, rpy = (" ".join(repr(float(v)) for v in part) for part in (pose[:3, 3], to_rpy(pose[:3, :3])))
    origin = f'<origin xyz="{xyz}" rpy="{rpy}"/><parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="fixed">{origin}</joint>'


def rotated_urdf():
    """The catalogue's IRB 140 on a foot of another frame, with a hand of another frame."""
    ends = f'<link name="foot"/><link name="hand"/>{fixed_joint("f", FOOT, "foot", "base_link")}'
    return TEXT.replace("</robot>", f"{ends}{fixed_joint('h', HAND, 'tool0', 'hand')}</robot>")


def origin_tag(pose):
    return {"xyz_mm": (1e3 * pose[:3, 3]).tolist(), "rpy_deg": np.rad2deg(to_rpy(pose[:3, :3])).tolist()}


def data(folder, text=TEXT, **lines):
    (folder / "mine.urdf").write_text(text, "utf-8")
    return change(POSES, "cell.arms.0.robot", {"urdf": "mine.urdf", **LINES, **lines})


def load_problem(folder, source):
    path = folder / "problem.yaml"
    path.write_text(yaml.safe_dump(source), "utf-8")
    return pipeline.load(path)


def expect_refusal(folder, source):
    with pytest.raises(TandemError) as caught:
        load_problem(folder, source)
    return caught.value.issues


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The plan of the small problem with the catalogue's robot, and with the file's on other frames."""
    folder = tmp_path_factory.mktemp("robot")
    small_problem.write(folder)
    tcp = wire_holder("along", "start").tcp
    tool = {"kind": "plain", "tcp": origin_tag(tcp), "mass_kg": 1.0, "cog_mm": [0, 0, 50]}
    known = change(POSES, "cell.arms.0.tool", tool)
    moved = change(data(folder, rotated_urdf(), base="foot", tip="hand"), "cell.arms.0.tool", tool)
    moved = change(moved, "cell.arms.0.tool.tcp", origin_tag(inverse(HAND) @ tcp))
    source = change(moved, "cell.arms.0.base", origin_tag(inverse(FOOT)))
    kept = [pipeline.plan(load_problem(folder, item)) for item in (known, source)]
    return folder, load_problem(folder, source), kept


def test_the_plan_is_the_catalogues_and_is_proven(both):
    _, _, (catalogue, own) = both
    assert catalogue.proof.ok
    assert own.proof.issues == ()
    for operation, other in zip(catalogue.plan.operations, own.plan.operations, strict=True):
        for arm in operation.q:
            np.testing.assert_allclose(other.q[arm], operation.q[arm], atol=1e-6)


def test_the_bundle_carries_the_urdf_and_has_the_same_digest(both, tmp_path):
    _, problem, _ = both
    for name, content in problem_file.bundle(problem).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    again = pipeline.load(tmp_path / "problem.yaml")
    assert again.digest == problem.digest
    assert again.cell.arms[0].data.file.text == rotated_urdf()


BARE = re.sub(
    r"(<link name=\"link_6\">.*?)(?:<collision>.*?</collision>\s*)+", r"\1MESH", TEXT, flags=re.DOTALL
)
MESHED = BARE.replace(
    "MESH",
    '<collision><geometry><mesh filename="package://mine_support/meshes/link_6.stl"/></geometry></collision>',
)


def test_meshes_that_are_not_there_are_refused_and_laid_there_are_hulled(tmp_path):
    (issue,) = expect_refusal(tmp_path, data(tmp_path, MESHED))
    assert (issue.code, issue.field) == ("robot.bodies", "cell.arms.0.robot.urdf")
    assert "link_6.stl" in issue.message
    folder = tmp_path / "mine_support" / "meshes"
    folder.mkdir(parents=True)
    trimesh.creation.box((0.06, 0.06, 0.02)).export(folder / "link_6.stl")
    small_problem.write(tmp_path)
    problem = load_problem(tmp_path, data(tmp_path, MESHED))
    (hull,) = problem.cell.arms[0].data.file.shapes[6]
    assert hull.kind == "mesh"
    assert len(hull.vertices) == 8
    assert trimesh.Trimesh(hull.vertices, hull.faces).volume == pytest.approx(0.06 * 0.06 * 0.02)
    assert len([name for name in problem_file.bundle(problem) if name.endswith(".stl")]) == 1


def test_a_link_without_any_body_is_refused(tmp_path):
    (issue,) = expect_refusal(tmp_path, data(tmp_path, BARE.replace("MESH", "")))
    assert issue.code == "robot.bodies"
    assert "link_6" in issue.message


PARENT = '<parent link="link_2"/><child link="rod"/>'
ROD = f'<link name="rod"/><joint name="piston" type="prismatic">{PARENT}</joint>'


@pytest.mark.parametrize(
    ("lines", "text", "code", "words"),
    [
        ({"name": "irb140"}, TEXT, "problem.duplicate_name", "built-in"),
        ({"coupled_deg": [400, 500]}, TEXT, "problem.field", "give a sum within -320 to 160 deg"),
        ({"home_deg": [0, 0, 200, 0, 0, 0]}, TEXT, "problem.field", "home_deg"),
        ({"sources": {"paylod_kg": "a"}}, TEXT, "problem.field", "'paylod_kg' is not a key"),
        ({"family": "fanuc"}, TEXT, "problem.field", "'abb', 'kuka', 'ur' or 'generic'"),
        ({"family": "kuka"}, urdf_text.ur10e(), "problem.field", "write ur or generic"),
        ({"tip": "hand"}, TEXT, "robot.chain", "no link 'hand'"),
        ({"urdf": "none.urdf"}, TEXT, "problem.missing_file", "none.urdf"),
        ({}, TEXT.replace("</robot>", f"{ROD}</robot>"), "robot.chain", "'piston'"),
    ],
)
def test_wrong_lines_are_told_by_field(tmp_path, lines, text, code, words):
    issues = expect_refusal(tmp_path, data(tmp_path, text, **lines))
    assert [issue.code for issue in issues] == [code]
    assert words in str(issues[0])
    assert issues[0].field.startswith("cell.arms.0.robot")
    small_problem.write(tmp_path)
    assert load_problem(tmp_path, data(tmp_path)).cell.arms[0].robot == "mine"


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ({}, True),
        ({"payload_kg": 5}, False),
        ({"family": "generic"}, False),
        ({"coupled_deg": [-100, 100]}, False),
        ({"full_speed_after_s": 0.5}, False),
        ({"home_deg": [0, 0, 10, 0, 0, 0]}, False),
        ({"tip": "link_6"}, False),
    ],
)
def test_two_arms_whose_robots_have_one_name_have_one_robot(tmp_path, other, same):
    """Whatever makes them two, with a source for each figure too."""
    keys = ("payload_kg", "coupled_deg", "home_deg", "full_speed_after_s")
    source = data(tmp_path, sources=dict.fromkeys(keys, "its sheet"), home_deg=[0] * 6, tip="tool0")
    small_problem.write(tmp_path)
    (left,) = source["cell"]["arms"]
    right = {**left, "name": "right", "base": {"xyz_mm": [5000, 0, 0]}}
    right["robot"] = {**left["robot"], **other}
    source["cell"]["arms"] = [left, right]
    source["cell"].pop("controller", None)
    if same:
        assert [arm.robot for arm in load_problem(tmp_path, source).cell.arms] == ["mine", "mine"]
        return
    issues_by_code = {issue.code: issue for issue in expect_refusal(tmp_path, source)}
    assert "is a different robot in another arm" in issues_by_code["problem.duplicate_name"].message


def test_what_a_urdf_does_not_say_is_shown_as_assumed(tmp_path):
    small_problem.write(tmp_path)
    lines = {"left_out": ["piston"], "sources": {"payload_kg": "data sheet of 2020"}}
    robot = (
        load_problem(tmp_path, data(tmp_path, TEXT.replace("</robot>", f"{ROD}</robot>"), **lines))
        .cell.arms[0]
        .data
    )
    assert robot.sources == ("payload_kg: data sheet of 2020",)
    assert "full_speed_after_s: stated without a source" in robot.assumed
    assert "bodies: those moved by the joint piston are ignored" in robot.assumed
    assert "coupling: assumed, none" in robot.assumed


def test_an_arm_of_ur_is_read_with_its_home(tmp_path):
    small_problem.write(tmp_path)
    robot = load_problem(tmp_path, data(tmp_path, urdf_text.ur10e(), family="ur")).cell.arms[0].data
    assert (robot.family, robot.controller) == ("UR", "e-Series")
    assert isinstance(robot.form, robots.ParallelParameters)
    pose = forward_kinematics(robot, robot.home)
    assert np.abs(pose[:3, 2] - [0.0, 0.0, -1.0]).max() < 1e-12
    longest = sum(abs(a) for _, a, _ in urdf_text.UR10E_DH)
    assert robot.reach == pytest.approx(np.hypot(longest, urdf_text.OUT))


def test_a_proof_sees_a_urdf_that_was_changed_behind_the_plan(both):
    _, problem, _ = both
    changed = rotated_urdf().replace('rgba="0.93', 'rgba="0.92')
    robot = problem.cell.arms[0].custom_data
    other = dataclasses.replace(robot, file=dataclasses.replace(robot.file, text=changed))
    stated = problem.source["cell"]["arms"][0]["robot"]
    assert arm_model.compare_with_problem(stated, robot) == []
    assert arm_model.compare_with_problem(stated, other)
    wrong = dataclasses.replace(robot, form=dataclasses.replace(robot.opw, c2=robot.opw.c2 + 1e-4))
    assert arm_model.compare_with_catalogue(arm_model.robot_machine(robot)) == []
    assert "c2 is" in arm_model.compare_with_catalogue(arm_model.robot_machine(wrong))[0]


GAZEBO = '<gazebo><joint name="rod"><parent>link_1</parent><child>link_3</child></joint></gazebo>'


@pytest.mark.parametrize(
    "text",
    [
        TEXT.replace('"', "'"),
        TEXT.replace('name="tool0"', 'name="flange"')
        .replace('link="tool0"', 'link="flange"')
        .replace("</robot>", '<!-- "tool0" --></robot>'),
        TEXT.replace("</robot>", f"{GAZEBO}</robot>"),
    ],
    ids=["quotes", "flange", "gazebo"],
)
def test_the_proof_reads_every_file_that_the_planner_takes(tmp_path, text):
    """The tip that is not named, in single quotes or beside a comment, and joints of a simulator."""
    problem = load_problem(tmp_path, data(tmp_path, text))
    robot = problem.cell.arms[0].custom_data
    assert arm_model.compare_with_problem(problem.source["cell"]["arms"][0]["robot"], robot) == []
    assert arm_model.compare_with_catalogue(arm_model.robot_machine(robot)) == []


def test_the_setup_sheet_shows_what_is_assumed(both):
    _, problem, (catalogue, own) = both
    told = repr(setup_sheet.tool_table(problem.setups[0], own.plan))
    assert "coupling: assumed, none" in told
    told = repr(setup_sheet.tool_table(catalogue.problem.setups[0], catalogue.plan))
    assert "bodies: boxes and cylinders that hold" in told


@pytest.mark.parametrize(
    "cell", [{}, [], None, {"arms": {}}, {"arms": [1, {}, {"robot": {}}, {"robot": {"urdf": 3}}]}]
)
def test_a_cell_that_is_not_well_stated_is_carried_as_it_is(tmp_path, cell):
    """Elements, batches and templates carry what nobody has read yet; whoever reads it says what is wrong."""
    assert problem_file.resolve_files({"cell": cell}, tmp_path) == {"cell": cell}
