"""The visual meshes of a user's own robot are shown in the replay and in the cell view of the page.

Distances, programs and digests do not depend on them.
"""

from __future__ import annotations

import base64
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial import cKDTree

from planner import pipeline
from planner.catalogue import robots
from planner.cell import clearance, plant
from planner.cell.plant import ROBOT_COLOUR, CellModel
from planner.geometry.arrays import from_rpy, transform
from planner.problem import Problem
from planner.reading import link_visuals
from planner.reading import problem as problem_file
from planner.report import replay
from planner.report import scene as scenes
from planner.service import cell_drawing
from tests import small_problem, urdf_text
from tests.refusals import POSES, change

PLATE = (0.06, 0.06, 0.02)
HULL = urdf_text.geometry_tag("mesh", (), np.eye(4), "package://mine_support/meshes/plate.stl")
AT = from_rpy([0.01, -0.02, 0.03], [0.3, -0.2, 0.9])
"""Where the visual of link 6 is in it."""
RED = '<material name="red"><color rgba="0.8 0.1 0.2 0.0"/></material>'
RING = "package://mine_support/visual/ring.obj"
PLAIN = re.sub(r"<visual>.*?</visual>\s*", "", robots.urdf_path("irb140").read_text("utf-8"), flags=re.DOTALL)
BARE = re.sub(
    r'(<link name="link_6">.*?)(?:<collision>.*?</collision>\s*)+', rf"\1{HULL}", PLAIN, flags=re.DOTALL
)
"""An arm that is a small plate from link 6 on, and nothing else to be seen."""


def ring(folder: Path) -> trimesh.Trimesh:
    """A ring of 80 mm, in a file in mm, and the plate; the ring in metres."""
    for name in ("meshes", "visual"):
        (folder / "mine_support" / name).mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(PLATE).export(folder / "mine_support" / "meshes" / "plate.stl")
    made = trimesh.creation.torus(30.0, 10.0, major_sections=24, minor_sections=12)
    made.export(folder / "mine_support" / "visual" / "ring.obj")
    return made.apply_scale(1e-3)


def visual(file: str = RING, scale: float = 1e-3, pose: np.ndarray = AT, inside: str = RED) -> str:
    return urdf_text.geometry_tag("mesh", (scale,) * 3, pose, file, "visual", inside)


def add_visuals(**links: str) -> str:
    """Return the URDF of the arm with visual elements for some links."""
    text = BARE
    for link, own in links.items():
        text = text.replace(f'<link name="{link}">', f'<link name="{link}">{own}')
    return text


def load_problem(folder: Path, text: str, **lines: Any) -> Problem:
    small_problem.write(folder)
    (folder / "mine.urdf").write_text(text, "utf-8")
    robot = {"urdf": "mine.urdf", "name": "mine", "family": "abb", "payload_kg": 6, **lines}
    (folder / "own.yaml").write_text(yaml.safe_dump(change(POSES, "cell.arms.0.robot", robot)), "utf-8")
    return pipeline.load(folder / "own.yaml")


def build_model(problem: Problem) -> CellModel:
    return plant.build_cell_model(problem.cell, problem.stock, problem.stock.place)


def visual_pieces(model: CellModel, body: str) -> list[scenes.VisiblePiece]:
    return [piece for piece in scenes.extract_scene(model).pieces if piece.body == body]


def visual_issues(problem: Problem) -> list[Any]:
    return [issue for issue in pipeline.check(problem) if issue.code == "robot.unseen"]


def read_replay(page: str) -> dict[str, Any]:
    """Return the data of a replay, with ``bodies`` as (frame, colour, vertices (V, 3) [mm])."""
    match = re.search(r"<script type='application/json' id='film'>(.*?)</script>", page)
    assert match is not None
    data = json.loads(match[1])
    raw = base64.b64decode(data["arrays"])

    def vertices(mesh: int) -> np.ndarray:
        kind, start, count = data["meshes"][mesh][0]
        return np.frombuffer(raw, f"<{kind}", count, start).reshape(-1, 3)

    return {**data, "bodies": [(b["body"], b["color"], vertices(b["mesh"])) for b in data["bodies"]]}


def same_points(points: np.ndarray, other: np.ndarray, atol: float) -> bool:
    """Whether two clouds are one, each point as often as it likes."""
    gaps = (cKDTree(points).query(other)[0].max(), cKDTree(other).query(points)[0].max())
    return max(gaps) <= atol


@pytest.fixture(scope="module")
def custom_robot_job(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, trimesh.Trimesh, Problem, Any]:
    folder = tmp_path_factory.mktemp("own")
    made = ring(folder)
    problem = load_problem(folder, add_visuals(link_6=visual()))
    return folder, made, problem, pipeline.plan(problem)


def test_the_replay_has_the_visuals_vertices_in_the_urdfs_colour(custom_robot_job: Any) -> None:
    _, made, problem, outcome = custom_robot_job
    assert outcome.proof.ok
    film = read_replay(replay.replay_html(build_model(problem), problem, outcome.plan, outcome.proof))
    ((_, color, points),) = [item for item in film["bodies"] if item[0] == "left/link_6"]
    assert color == [0.8, 0.1, 0.2, 1.0]  # a link that cannot be seen helps nobody
    assert same_points(points, 1e3 * transform(AT, made.vertices), atol=2e-3)
    others = [item for item in film["bodies"] if item[0] == "left/link_3"]
    assert others and all(item[1] == pytest.approx(ROBOT_COLOUR.tolist()) for item in others)


def test_the_page_draws_the_same(custom_robot_job: Any) -> None:
    _, made, problem, _ = custom_robot_job
    result, _ = cell_drawing.view(problem)
    ((points, color),) = [(b["vertices"], b["color"]) for b in result["bodies"] if b["body"] == "left/link_6"]
    assert color == [0.8, 0.1, 0.2, 1.0]
    assert same_points(np.reshape(points, (-1, 3)), 1e3 * transform(AT, made.vertices), atol=0.02)


def test_a_crowded_cell_is_drawn_with_hulls_as_before(
    custom_robot_job: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where all there is to be drawn has room only without the visuals."""
    _, _, problem, _ = custom_robot_job
    count = sum(len(body["faces"]) // 3 for body in cell_drawing.view(problem)[0]["bodies"])
    monkeypatch.setattr(cell_drawing, "MAX_TRIANGLES", count - 1)
    (hand,) = [body for body in cell_drawing.view(problem)[0]["bodies"] if body["body"] == "left/link_6"]
    assert hand["color"] == pytest.approx(ROBOT_COLOUR.tolist())
    assert np.ptp(np.reshape(hand["vertices"], (-1, 3)), axis=0) == pytest.approx([60.0, 60.0, 20.0])


def test_distances_know_nothing_of_it(custom_robot_job: Any, tmp_path: Path) -> None:
    """The ring stands out of the plate by 30 mm; with and without it all bodies are as far apart."""
    _, _, problem, outcome = custom_robot_job
    ring(tmp_path)
    bare = load_problem(tmp_path, BARE)
    assert bare.cell.arms[0].data.file.visuals == ()
    item, other = build_model(problem), build_model(bare)
    q = {"left": np.random.default_rng(4).uniform(-1.0, 1.0, (12, 6))}
    near = [clearance.min_clearance(model, q, 1.0) for model in (item, other)]
    np.testing.assert_array_equal(near[0].distance, near[1].distance)
    assert near[0].pair == near[1].pair
    (solid,) = [item for item in item.solids if item.body == "left/link_6"]
    assert np.ptp(solid.shape.vertices, axis=0) == pytest.approx(PLATE)
    again = pipeline.plan(bare)
    assert all(len(text) > 100 for text in again.programs.values())
    for name, values in again.plan.operations[0].q.items():
        np.testing.assert_array_equal(values, outcome.plan.operations[0].q[name])


def test_a_copy_carries_the_visuals_and_a_result_stays_what_it_is_without(
    custom_robot_job: Any, tmp_path: Path
) -> None:
    _, _, problem, _ = custom_robot_job
    for name, content in problem_file.bundle(problem).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    again = pipeline.load(tmp_path / "problem.yaml")
    assert (again.digest, visual_issues(again)) == (problem.digest, [])
    both = [visual_pieces(build_model(item), "left/link_6")[0].solid.vertices for item in (problem, again)]
    np.testing.assert_array_equal(*both)
    (file,) = (tmp_path / "files").glob("ring-*.obj")
    file.unlink()
    without = pipeline.load(tmp_path / "problem.yaml")
    assert without.digest == problem.digest
    assert [issue.severity.value for issue in visual_issues(without)] == ["note"]


def test_what_cannot_be_read_is_told_once_and_the_bodies_are_seen(tmp_path: Path) -> None:
    ring(tmp_path)
    (tmp_path / "broken.stl").write_bytes(b"solid nothing\nfacet\n")
    (tmp_path / "hand.dae").write_text("<COLLADA/>")
    text = add_visuals(
        link_3=visual("broken.stl"),
        link_4=visual("hand.dae"),
        link_5="<visual><geometry/></visual>",
        link_6=visual() + visual("nowhere.stl"),
        base_link=urdf_text.geometry_tag("box", (0.2, 0.2, 0.3), np.eye(4), tag="visual"),
    )
    problem = load_problem(tmp_path, text)
    (issue,) = visual_issues(problem)
    assert (issue.field, issue.severity.value) == ("cell.arms.0.robot.urdf", "note")
    for words in ("4 links of ", "broken.stl (", "hand.dae (", "link_5", "nowhere.stl (missing)"):
        assert words in issue.message, words
    model = build_model(problem)
    for link in ("link_3", "link_4", "link_5", "link_6"):
        pieces = visual_pieces(model, f"left/{link}")
        assert len(pieces) == len([solid for solid in model.solids if solid.body == f"left/{link}"])
        assert all(piece.color == pytest.approx(tuple(ROBOT_COLOUR)) for piece in pieces)
    (box,) = visual_pieces(model, "left/base_link")
    assert box.color == (*link_visuals.NEUTRAL_COLOUR, 1.0)
    assert np.ptp(box.solid.vertices, axis=0) == pytest.approx([0.2, 0.2, 0.3])


DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><created>2026-01-01</created><modified>2026-01-01</modified>
    <unit name="centimeter" meter="0.01"/><up_axis>Z_UP</up_axis></asset>
  <library_effects>EFFECTS</library_effects>
  <library_materials>
    <material id="blue"><instance_effect url="#blue_effect"/></material>
    <material id="plain"><instance_effect url="#plain_effect"/></material>
  </library_materials>
  <library_geometries><geometry id="shape"><mesh>
    <source id="places"><float_array id="numbers" count="15">0 0 0 6 0 0 6 4 0 0 4 0 3 2 5</float_array>
      <technique_common><accessor source="#numbers" count="5" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
    <polylist material="foot" count="1"><input semantic="VERTEX" source="#corners" offset="0"/>
      <vcount>4</vcount><p>3 2 1 0</p></polylist>
    <triangles material="sides" count="4"><input semantic="VERTEX" source="#corners" offset="0"/>
      <p>0 1 4 1 2 4 2 3 4 3 0 4</p></triangles>
    <lines count="1"><input semantic="VERTEX" source="#corners" offset="0"/><p>0 4</p></lines>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="scene"><node id="one">
    <rotate>0 0 1 90</rotate><translate>1 0 0</translate>
    <instance_geometry url="#shape"><bind_material><technique_common>
      <instance_material symbol="foot" target="#blue"/><instance_material symbol="sides" target="#plain"/>
    </technique_common></bind_material></instance_geometry>
  </node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>""".replace(
    "EFFECTS",
    "".join(
        f'<effect id="{name}_effect"><profile_COMMON><technique sid="t"><lambert>{diffuse}</lambert>'
        "</technique></profile_COMMON></effect>"
        for name, diffuse in {"blue": "<diffuse><color>0 0.2 1 0.5</color></diffuse>", "plain": ""}.items()
    ),
)
"""A pyramid of 6 by 4 by 5 cm with a blue foot, pushed along x by 1 cm and turned about z by 90 degrees."""
PYRAMID = 0.01 * np.array([(0, 1, 0), (0, 7, 0), (-4, 7, 0), (-4, 1, 0), (-2, 4, 5)], dtype=np.float64)


def test_a_dae_is_seen_in_its_unit_and_its_colours(tmp_path: Path) -> None:
    """Scaled by two along z; parts without a colour have that of the URDF."""
    pytest.importorskip("collada", reason="pycollada is not installed (pip install 'tandem-planner[dae]')")
    ring(tmp_path)
    (tmp_path / "hand.dae").write_text(DAE)
    drawn = urdf_text.geometry_tag("mesh", (1.0, 1.0, 2.0), AT, "hand.dae", "visual", RED)
    problem = load_problem(tmp_path, add_visuals(link_6=drawn))
    assert visual_issues(problem) == []
    foot, sides = visual_pieces(build_model(problem), "left/link_6")
    assert (foot.color, sides.color) == ((0.0, 0.2, 1.0, 1.0), (0.8, 0.1, 0.2, 1.0))
    expected = PYRAMID * [1.0, 1.0, 2.0]
    for piece, corners in ((foot, expected[:4]), (sides, expected)):
        assert same_points(transform(AT, piece.shape.vertices), transform(AT, corners), atol=1e-7)
    assert len(foot.shape.faces) == 2 and len(sides.shape.faces) == 4
    a, b, c = np.swapaxes(sides.shape.vertices[sides.shape.faces], 0, 1)
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()  # outwards
    for name, content in problem_file.bundle(problem).items():  # a copy has it too
        (tmp_path / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "copy" / name).write_bytes(content)
    again = pipeline.load(tmp_path / "copy" / "problem.yaml")
    assert visual_issues(again) == [] and len(again.cell.arms[0].data.file.visuals[6]) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DAE.replace("0 1 4 1", "0 1 9 1"), "beyond the limits"),
        (DAE.replace('meter="0.01"', 'meter="100"'), "mm long in its own unit"),
        (DAE.replace("3 2 5<", "3 2 inf<"), "not finite"),
        (DAE.replace("<p>0 1 4 1", "<p>0 1 4 x"), "it cannot be read ("),
        (DAE.replace('url="#shape"', 'url="#other"'), "it cannot be read ("),
        (DAE[:900], "it cannot be read ("),
        (DAE.replace('<scene><instance_visual_scene url="#scene"/></scene>', ""), "it has no scene"),
        ("PK\x03\x04", "it is compressed; unpack it"),
    ],
)
def test_a_bad_dae_is_told_and_the_bodies_are_seen(tmp_path: Path, text: str, words: str) -> None:
    pytest.importorskip("collada", reason="pycollada is not installed (pip install 'tandem-planner[dae]')")
    ring(tmp_path)
    (tmp_path / "hand.dae").write_text(text)
    problem = load_problem(tmp_path, add_visuals(link_6=visual("hand.dae", 1.0)))
    (issue,) = visual_issues(problem)
    assert words in issue.message
    assert problem.cell.arms[0].data.file.visuals == ()


def test_without_its_reader_a_dae_is_told_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "collada", None)
    ring(tmp_path)
    (tmp_path / "hand.dae").write_text(DAE)
    (issue,) = visual_issues(load_problem(tmp_path, add_visuals(link_6=visual("hand.dae", 1.0))))
    assert "hand.dae (DAE needs pycollada: pip install 'tandem-planner[dae]')" in issue.message


def test_where_visuals_lie_may_be_stated(tmp_path: Path) -> None:
    ring(tmp_path)
    (tmp_path / "mine_support" / "visual" / "ring.obj").rename(tmp_path / "elsewhere.obj")
    stated = [{"name": RING, "file": "elsewhere.obj"}]
    problem = load_problem(tmp_path, add_visuals(link_6=visual()), visuals=stated)
    assert visual_issues(problem) == []
    assert len(problem.cell.arms[0].data.file.visuals[6]) == 1


@pytest.mark.long
def test_a_million_triangles_stay_within_the_size(custom_robot_job: Any, tmp_path: Path) -> None:
    """A ring of 500 mm on link 3: every point of it has a vertex near by that is shown, and none is beside
    it, by the diagonal of a cell of 10 mm."""
    _, _, _, outcome = custom_robot_job
    ring(tmp_path)
    big = trimesh.creation.torus(0.2, 0.05, major_sections=1250, minor_sections=400)
    assert len(big.faces) == 1_000_000
    big.export(tmp_path / "big.stl")
    text = add_visuals(link_3=visual("big.stl", 1.0, np.eye(4), ""), link_6=visual())
    problem = load_problem(tmp_path, text)
    assert visual_issues(problem) == []
    model = build_model(problem)
    (piece,) = visual_pieces(model, "left/link_3")
    assert len(piece.solid.faces) <= link_visuals.MAX_TRIANGLES
    points = piece.solid.vertices
    deviation = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.2, points[:, 2]) - 0.05
    diagonal = 0.010 * np.sqrt(3.0)
    assert np.abs(deviation).max() < diagonal
    assert cKDTree(points).query(big.vertices[::97])[0].max() < diagonal
    usual, page = (
        replay.replay_html(build_model(item), item, outcome.plan, outcome.proof)
        for item in (custom_robot_job[2], problem)
    )
    assert len(page) - len(usual) < 700_000
    assert len(json.dumps(cell_drawing.view(problem)[0])) < 1_500_000
