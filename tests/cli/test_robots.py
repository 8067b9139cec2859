"""``tandem robots add``: the lines that it writes are an arm of a cell, and the picture shows its axes.

Faults of a URDF are reported with a remedy.
"""

from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import trimesh
import yaml

from planner import pipeline
from planner.catalogue import robots
from planner.cli.robots import AddRobot, run_add
from planner.issues import TandemError
from tests import small_problem
from tests.refusals import POSES, change

TEXT = robots.urdf_path("irb140").read_text("utf-8").replace('name="irb140"', 'name="Our arm 2"')
BARE = re.sub(r"(<link name=\"link_6\">.*?)<collision>.*?</collision>", r"\1MESH", TEXT, flags=re.DOTALL)
MESH = '<collision><geometry><mesh filename="package://our_support/meshes/hand.stl"/></geometry></collision>'


def tandem(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "planner", "robots", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "files" / "our.urdf"
    path.parent.mkdir()
    path.write_text(TEXT, "utf-8")
    return path


def expect_refusal(**given: object) -> list[str]:
    with pytest.raises(TandemError) as caught:
        run_add(AddRobot(**{"family": "abb", "payload_kg": 6.0, **given}))
    return [str(issue) for issue in caught.value.issues]


def test_what_it_writes_is_an_arm_of_a_cell(urdf: Path, tmp_path: Path) -> None:
    done = tandem("add", "files/our.urdf", "--family", "abb", "--payload-kg", "6", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "a1 70, a2 0, b 0, c1 352, c2 360, c3 380, c4 65 mm" in done.stdout
    assert "- acceleration: assumed, every axis reaches its full speed in 0.4 s from rest" in done.stdout
    text = (tmp_path / "Our_arm_2.yaml").read_text("utf-8")
    lines = yaml.safe_load(text)["robot"]
    assert lines["urdf"] == "files/our.urdf"
    small_problem.write(tmp_path)
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(change(POSES, "cell.arms.0.robot", lines)), "utf-8")
    robot = pipeline.load(path).cell.arms[0].data
    assert (robot.name, robot.payload) == ("Our_arm_2", 6.0)
    for line in robot.assumed:
        assert f"# {line}\n" in text
    assert "# home_deg: [0, 0, 0, 0, 0, 0]" in text
    picture = ET.parse(tmp_path / "Our_arm_2.svg")
    words = {element.text for element in picture.iter() if element.tag.endswith("text")}
    assert words >= {"1", "2", "3", "4", "5", "6", "base", "tip", "Our_arm_2, at home"}


def test_what_is_stated_is_no_longer_assumed(urdf: Path, tmp_path: Path) -> None:
    path = tmp_path / "new" / "arm.yaml"
    home = (0.0, 10.0, -10.0, 0.0, 45.0, 0.0)
    run_add(
        AddRobot(
            urdf, "kuka", 5.5, path, "arm", title="An arm", full_speed_after_s=0.2, home_deg=home, source="me"
        )
    )
    text = path.read_text("utf-8")
    lines = yaml.safe_load(text)["robot"]
    assert lines["urdf"] == "../files/our.urdf"
    assert (lines["home_deg"], lines["full_speed_after_s"]) == (list(home), 0.2)
    assert lines["sources"] == {"urdf": "me"}
    assert "assumed, every axis" not in text
    assert "without a source\n# coupling" in text


def test_meshes_that_lie_elsewhere_are_looked_for(urdf: Path, tmp_path: Path) -> None:
    urdf.write_text(BARE.replace("MESH", MESH), "utf-8")
    (issue,) = expect_refusal(urdf=urdf, output=tmp_path / "arm.yaml")
    assert "hand.stl" in issue
    assert "--meshes FOLDER" in issue
    for folder in ("a/our_support/meshes", "b/other_support/meshes"):
        (tmp_path / folder).mkdir(parents=True)
        trimesh.creation.box((0.06, 0.06, 0.02)).export(tmp_path / folder / "hand.stl")
    run_add(AddRobot(urdf, "abb", 6.0, tmp_path / "arm.yaml", meshes=tmp_path))
    (mesh,) = yaml.safe_load((tmp_path / "arm.yaml").read_text("utf-8"))["robot"]["meshes"]
    assert mesh["file"] == "../a/our_support/meshes/hand.stl"


def test_meshes_that_are_not_read_are_told_and_what_they_became_is_taken(urdf: Path, tmp_path: Path) -> None:
    urdf.write_text(BARE.replace("MESH", MESH.replace(".stl", ".dae")), "utf-8")
    folder = urdf.parent / "our_support" / "meshes"
    folder.mkdir(parents=True)
    (folder / "hand.dae").write_text("<COLLADA/>", "utf-8")
    (issue,) = expect_refusal(urdf=urdf, output=tmp_path / "arm.yaml")
    assert "robot.bodies" in issue
    assert "meshes/hand.dae" in issue
    trimesh.creation.box((0.06, 0.06, 0.02)).export(tmp_path / "hand.stl")
    run_add(AddRobot(urdf, "abb", 6.0, tmp_path / "arm.yaml", meshes=tmp_path))
    lines = yaml.safe_load((tmp_path / "arm.yaml").read_text("utf-8"))["robot"]
    assert [mesh["file"] for mesh in lines["meshes"]] == ["../hand.stl"]
    small_problem.write(tmp_path)
    path = tmp_path / "problem.yaml"
    path.write_text(yaml.safe_dump(change(POSES, "cell.arms.0.robot", lines)), "utf-8")
    kinds = [shape.kind for shape in pipeline.load(path).cell.arms[0].data.file.shapes[6]]
    assert kinds.count("mesh") == 1


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"name": "irb140"}, "is a built-in robot; choose another --name"),
        ({"name": "2 arms"}, "start with a letter A to Z"),
        ({"payload_kg": 0.0}, "payload_kg"),
        ({"family": "irc5"}, "family: Input should be 'abb'"),
        ({"base": "foot"}, "the URDF has no link 'foot', it has base_link"),
        ({"tip": "base_link"}, "robot."),
        ({"home_deg": (0.0, 0.0, 200.0, 0.0, 0.0, 0.0)}, "beyond the limits"),
        ({"coupled_deg": (400.0, 500.0)}, "give a sum within -320 to 160 deg"),
        ({"full_speed_after_s": 0.0}, "full_speed_after_s"),
    ],
)
def test_wrong_options_are_told_and_nothing_is_written(
    urdf: Path, tmp_path: Path, given: dict[str, object], words: str
) -> None:
    path = tmp_path / "arm.yaml"
    assert words in " ".join(expect_refusal(urdf=urdf, output=path, **given))
    assert not path.exists()
    assert not path.with_suffix(".svg").exists()


@pytest.mark.parametrize("name", ["cell.yaml", "arm.svg", "arm", "."])
def test_it_writes_over_nothing_but_its_own(urdf: Path, tmp_path: Path, name: str) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("arms: []\n", "utf-8")
    (issue,) = expect_refusal(urdf=urdf, output=tmp_path / name)
    assert "output.folder" in issue
    assert {path.name for path in tmp_path.iterdir()} == {"cell.yaml", "files"}
    assert cell.read_text("utf-8") == "arms: []\n"
    for _ in range(2):
        run_add(AddRobot(urdf, "abb", 6.0, tmp_path / "own.yaml"))


def test_an_arm_of_another_class_ends_with_bad_input(urdf: Path, tmp_path: Path) -> None:
    """Its wrist is moved off one point."""
    turned = re.sub(r'(name="joint_5".*?xyz=")([^"]*)', r"\g<1>0.1 0.2 0.05", TEXT, count=1, flags=re.DOTALL)
    urdf.write_text(turned, "utf-8")
    done = tandem("add", str(urdf), "--family", "abb", "--payload-kg", "6", folder=tmp_path)
    assert done.returncode == 2
    assert "robot.not_opw" in done.stderr
    assert "axes 4 and 5 do not meet" in done.stderr
    assert not list(tmp_path.glob("*.yaml"))


def test_robots_are_listed(tmp_path: Path) -> None:
    done = tandem(folder=tmp_path)
    assert done.returncode == 0
    rows = {line.split()[0]: line for line in done.stdout.splitlines()}
    for name in robots.robot_names():
        assert robots.robot(name).title in rows[name]


def test_a_robot_tells_its_sources(tmp_path: Path) -> None:
    done = tandem("irb2600_12_185", folder=tmp_path)
    assert done.returncode == 0
    assert "- velocity: assumed, that of the IRB 2600-12/1.65" in done.stdout
    assert "- dimensions and limits: RobotComponents@2a71d0c" in done.stdout
    done = tandem("irb1", folder=tmp_path)
    assert done.returncode == 2
    assert "problem.unknown_robot" in done.stderr
