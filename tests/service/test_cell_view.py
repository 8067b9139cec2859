"""The cell view of the service: links where the URDF, read independently, has them; targets of the table."""

from __future__ import annotations

import gzip
import itertools
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from planner import pipeline
from planner.cell import plant
from planner.issues import has_errors
from planner.report import scene as scenes
from planner.service import cell_drawing, http_responses, routes
from tests import small_problem, urdf_text
from tests.service.support import ROOT, InProcess, issue_codes, named_problem

OFFSET_PROBLEM = small_problem.PROBLEM.replace(
    "robot: irb140", "robot: irb140\n      base: {xyz_mm: [0, 40, 0]}"
)
POST = """
  obstacles:
    - {name: post, shapes: [{kind: box, size_mm: [30, 30, 100], pose: {xyz_mm: [0, 900, 50]}}]}
"""


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    with InProcess(tmp_path_factory.mktemp("cell") / "data", examiners=1) as made:
        yield made


def matrices(rows: list[list[float]]) -> np.ndarray[Any, Any]:
    """Poses (B, 4, 4) [mm] of rows of twelve numbers."""
    out = np.tile(np.eye(4), (len(rows), 1, 1))
    out[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return out


def axis_rotation(axis: np.ndarray[Any, Any], angle: float) -> np.ndarray[Any, Any]:
    """Rodrigues' formula."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    out = np.eye(4)
    out[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return out


def joint_transforms(robot: str, base_mm: list[float], q_deg: list[float]) -> dict[str, np.ndarray[Any, Any]]:
    """Poses (4, 4) [mm] of the links of a serial arm, from the XML of its URDF."""
    tree = ET.parse(ROOT / "urdf" / f"{robot}.urdf").getroot()
    pose = np.eye(4)
    pose[:3, 3] = base_mm
    out = {"base_link": pose}
    joints = [item for item in tree.iter("joint") if item.get("type") == "revolute"]
    for joint, angle in zip(joints, np.deg2rad(q_deg), strict=True):
        origin = joint.find("origin")
        given = {} if origin is None else origin.attrib
        move = np.eye(4)
        r, p, y = (float(v) for v in given.get("rpy", "0 0 0").split())
        for axis, value in zip(np.eye(3)[::-1], (y, p, r), strict=True):
            move = move @ axis_rotation(axis, value)
        move[:3, 3] = [1000.0 * float(v) for v in given.get("xyz", "0 0 0").split()]
        axis_of, child = joint.find("axis"), joint.find("child")
        assert axis_of is not None and child is not None
        way = np.array([float(v) for v in axis_of.attrib["xyz"].split()])
        pose = pose @ move @ axis_rotation(way, float(angle))
        out[child.attrib["link"]] = pose
    return out


def test_links_are_where_the_urdf_has_them_at_home_and_at_every_target(running_service: InProcess) -> None:
    body = running_service.post(OFFSET_PROBLEM, path="/v1/cell?targets=4").json()
    assert [arm["name"] for arm in body["arms"]] == ["left"]
    joints = body["joints_deg"]["left"]
    assert joints[0] == [0, 0, 0, 0, 45, 0] == body["arms"][0]["home_deg"]
    assert len(joints) == 1 + len(body["targets"]) == 5
    for number, q in enumerate(joints):
        for link, pose in joint_transforms("irb140", [0.0, 40.0, 0.0], q).items():
            told = matrices(body["poses"][f"left/{link}"])[number]
            assert told == pytest.approx(pose, abs=0.02), (link, q)  # joints are reported to 0.001 degree


def test_targets_are_told_with_where_they_are_and_what_posture_they_have(running_service: InProcess) -> None:
    body = running_service.post(path="/v1/cell?targets=3").json()
    assert (body["of"], len(body["targets"])) == (len(small_problem.ROWS), 3)
    places = [[float(v) for v in row.split(",")[:3]] for row in small_problem.ROWS]
    for target, number in zip(body["targets"], itertools.count(1)):
        assert target["points_mm"]["left"] == pytest.approx(places[target["index"]], abs=0.01)
        assert target["posture"] == number and target["faults"] == []
    assert body["targets"][-1]["index"] == len(small_problem.ROWS) - 1
    assert body["placed"] is True and body["operations"] == ["poses"]


def test_a_target_that_fails_has_no_posture_and_says_why(running_service: InProcess) -> None:
    far = small_problem.PROBLEM.replace("robot: irb140", "robot: irb140\n      base: {xyz_mm: [-435, 0, 0]}")
    body = running_service.post(far, path="/v1/cell?targets=6").json()
    bad = [target for target in body["targets"] if "posture" not in target]
    assert bad and len(body["joints_deg"]["left"]) == 1 + len(body["targets"]) - len(bad)
    for target in bad:
        (fault,) = target["faults"]
        assert (fault["code"], fault["arm"], fault["index"]) == ("motion.no_reach", "left", target["index"])
        assert "cannot reach" in fault["message"]


def test_bodies_are_whole_and_in_millimetres(running_service: InProcess) -> None:
    answer_body = running_service.post(
        named_problem("bodies").replace("\nstock:", POST + "stock:"), path="/v1/cell"
    ).json()
    assert "targets" not in answer_body and "map" not in answer_body
    kinds = {body["kind"] for body in answer_body["bodies"]}
    assert kinds >= {"link", "tool", "stock", "obstacle"}
    for body in answer_body["bodies"]:
        vertices = np.array(body["vertices"]).reshape(-1, 3)
        faces = np.array(body["faces"]).reshape(-1, 3)
        assert faces.min() >= 0 and faces.max() < len(vertices)
        assert body["body"] in answer_body["poses"] and len(answer_body["poses"][body["body"]]) == 1
        if body["kind"] == "obstacle":
            assert [vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()] == [
                [-15, 885, 0],
                [15, 915, 100],
            ]
        if body["kind"] == "stock":
            assert np.ptp(vertices, axis=0).tolist() == [100, 100, 100]
    moves = {move["name"]: [field["field"] for field in move["fields"]] for move in answer_body["moves"]}
    assert moves == {
        "stock": ["stock.place"],
        "left": ["cell.arms.0.base"],
        "post": ["cell.obstacles.0.shapes.0.pose"],
    }
    (stock,) = (move["fields"][0] for move in answer_body["moves"] if move["kind"] == "stock")
    assert (stock["xyz_mm"], stock["rpy_deg"]) == ([450, 0, 0], [0, 0, 0])


def test_a_map_has_the_targets_and_the_values_of_its_freedom(running_service: InProcess) -> None:
    text = named_problem("mapped").replace("frame: world", "frame: stock")
    rows = [row.replace("450,", "0,", 1) for row in small_problem.ROWS]
    table = "\n".join([small_problem.COLUMNS, *rows]).encode()
    files = [("problem", ("p.yaml", text)), ("files", ("targets.csv", table))]
    body = running_service.http.post("/v1/cell?targets=6&freedom=place x", files=files).json()
    assert [freedom["name"] for freedom in body["freedoms"]] == ["place x", "place y", "place z"]
    made = body["map"]
    assert (made["freedom"], made["unit"]) == ("place x", "mm")
    shape = np.array(made["values"]).shape
    assert shape == (6, 25) and made["values"][0][0] == -300 and made["values"][0][-1] == 300
    for table_of in (made["states"]["left"], made["limit_deg"]["left"], made["clearance_mm"], made["pairs"]):
        assert (len(table_of), len(table_of[0])) == shape
    states = np.array(made["states"]["left"])
    assert 0 < (states == 0).sum() < states.size
    assert (np.array(made["clearance_mm"], dtype=float)[states == 0] >= 0).all()
    assert all(code == "" or code.startswith("motion.") for code in made["codes"])
    other = running_service.http.post("/v1/cell?targets=6&freedom=none", files=files).json()
    assert "map" not in other and other["freedoms"] == body["freedoms"]


def test_a_block_whose_place_is_searched_is_where_a_first_look_has_it_or_nowhere(
    running_service: InProcess,
) -> None:
    text = named_problem("searched").replace("place: {xyz_mm: [450, 0, 0]}", "place: auto")
    text = text.replace("frame: world", "frame: stock") + "accept: [stock.hangs]\n"
    rows = [f"50,{y},150,0.5,-0.5,0.5,0.5,20" for y in range(-50, 51, 20)]

    def request_cell(rows: list[str], more: str = "") -> dict[str, Any]:
        table = "\n".join([small_problem.COLUMNS, *rows]).encode()
        files = [("problem", ("p.yaml", text)), ("files", ("targets.csv", table))]
        body: dict[str, Any] = running_service.http.post(f"/v1/cell{more}", files=files).json()
        return body

    assert request_cell(rows)["placed"] is False
    result = request_cell(rows, "?targets=6")
    assert result["placed"] is True and all("posture" in target for target in result["targets"])
    stock = matrices(result["poses"]["stock"])[0]
    point = result["targets"][0]["points_mm"]["left"]
    assert stock @ [50, -50, 150, 1] == pytest.approx([*point, 1], abs=0.05)
    apart = ["-2000,0,150,0.5,-0.5,0.5,0.5,20", *rows, "2000,0,150,0.5,-0.5,0.5,0.5,20"]
    assert request_cell(apart, "?targets=6")["placed"] is False


def test_what_cannot_be_drawn_is_refused_by_field(running_service: InProcess) -> None:
    answer = running_service.post(path="/v1/cell?operation=1")
    assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "operation")])
    assert "allowed 0 to 0 of 1" in answer.json()["issues"][0]["message"]
    answer = running_service.post(named_problem("own").replace("irb140", "irb0"), path="/v1/cell")
    assert answer.status_code == 422 and issue_codes(answer)[0][1] == "cell.arms.0.robot"
    for more, field in (("targets=1", "targets"), ("targets=201", "targets"), ("operation=-1", "operation")):
        assert issue_codes(running_service.post(path=f"/v1/cell?{more}")) == [("service.request", field)]


def test_targets_that_cannot_be_made_leave_the_cell_drawn(running_service: InProcess) -> None:
    files = [
        ("problem", ("p.yaml", named_problem("bad"))),
        ("files", ("targets.csv", small_problem.COLUMNS.encode())),
    ]
    answer = running_service.http.post("/v1/cell?targets=6", files=files)
    assert answer.status_code == 200
    body = answer.json()
    assert body["bodies"] and "targets" not in body
    assert [issue for issue in body["issues"] if issue.get("severity", "error") == "error"]


def test_it_is_compressed_for_who_takes_that(running_service: InProcess) -> None:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", _table()))]
    with running_service.http.stream(
        "POST", "/v1/cell", files=files, headers={"Accept-Encoding": "gzip"}
    ) as answer:
        packed = b"".join(answer.iter_raw())
        assert answer.headers["content-encoding"] == "gzip"
    plain: httpx.Response = running_service.http.post(
        "/v1/cell", files=files, headers={"Accept-Encoding": "identity"}
    )
    assert "content-encoding" not in plain.headers
    assert gzip.decompress(packed) == plain.content and len(packed) < len(plain.content) / 2


def post_crowded_cell(running_service: InProcess, mesh: str, times: int) -> Any:
    """Post a cell in which one obstacle repeats a mesh (text of an OBJ file) the given number of times."""
    shapes = ["{kind: mesh, file: fine.obj, unit: mm, pose: {xyz_mm: [0, 900, 50]}}"] * times
    body = f"\n  obstacles:\n    - {{name: post, shapes: [{', '.join(shapes)}]}}\n"
    text = named_problem("crowded").replace("\nstock:", body + "stock:")
    files = [("problem", ("p.yaml", text)), ("files", ("targets.csv", _table()))]
    return running_service.http.post("/v1/cell", files=[*files, ("files", ("fine.obj", mesh.encode()))])


def test_fine_meshes_are_thinned_out(running_service: InProcess) -> None:
    """A sphere of 100 mm, three times, as the obstacle."""
    rings, turns = 100, 120
    polar, around = np.meshgrid(np.linspace(0.01, np.pi - 0.01, rings), np.arange(turns) * 2 * np.pi / turns)
    points = 100.0 * np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
    )
    at = 1 + np.arange(turns * rings).reshape(turns, rings)
    a, b = at[:, :-1], np.roll(at, -1, axis=0)[:, :-1]
    faces = np.concatenate([np.stack([a, b, b + 1], -1), np.stack([a, b + 1, a + 1], -1)]).reshape(-1, 3)
    mesh = "".join(f"v {x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in points.reshape(-1, 3))
    answer = post_crowded_cell(running_service, mesh + "".join(f"f {i} {j} {k}\n" for i, j, k in faces), 3)
    assert answer.status_code == 200, answer.text[:500]
    (post,) = (body for body in answer.json()["bodies"] if body["kind"] == "obstacle")
    assert len(faces) == 23_760 and 3_000 < len(post["faces"]) / 9 < 15_000
    away = np.linalg.norm(np.array(post["vertices"]).reshape(-1, 3) - [0, 900, 50], axis=1)
    assert away.max() <= 100.01 and away.min() > 98.0


def test_more_triangles_than_are_drawn_are_refused(running_service: InProcess) -> None:
    """Such as cross one another, which nothing makes fewer."""
    random = np.random.default_rng(7)
    mesh = "".join(f"v {x:.2f} {y:.2f} {z:.2f}\n" for x, y, z in random.uniform(-90, 90, (150, 3)))
    mesh += "".join(
        f"f {i} {j} {k}\n" for i, j, k in np.sort(random.integers(1, 151, (32_000, 3))) if i < j < k
    )
    answer = post_crowded_cell(running_service, mesh, 10)
    assert (answer.status_code, issue_codes(answer)) == (413, [("service.too_large", "cell")])
    assert "allowed 300,000). Use fewer meshes" in answer.json()["detail"]


def test_a_cell_is_packed_in_the_turn_of_who_asks(
    running_service: InProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    turns = []
    packed, readers = http_responses.gzipped_json, running_service.service._readers
    free = readers.value

    def seen(*given: Any) -> Any:
        turns.append(free - readers.value)
        return packed(*given)

    monkeypatch.setattr(routes, "gzipped_json", seen)
    assert running_service.post(path="/v1/cell").status_code == 200
    assert turns == [1]


def _table() -> bytes:
    return "\n".join([small_problem.COLUMNS, *small_problem.ROWS]).encode()


FREE_SPIN = small_problem.PROBLEM.replace(
    "frame: world}", "frame: world,\n     free: [{name: spin, arms: [left], axis: z, turn_deg: [-170, 170]}]}"
)


@pytest.mark.parametrize("other", [False, True])
def test_the_way_of_a_plan_goes_through_its_map_alone(tmp_path: Path, other: bool) -> None:
    """At each target the posture of the plan has the tool turned by the value that is drawn: by Drake's plant
    of the URDF. Of a problem with other targets nothing is drawn."""
    outcome = pipeline.plan(pipeline.load(small_problem.write(tmp_path, FREE_SPIN))).plan
    rows = [row.replace(",500,", ",505,") if other else row for row in small_problem.ROWS]
    table = "\n".join([small_problem.COLUMNS, *rows]) + "\n"
    problem = pipeline.load(small_problem.write(tmp_path, FREE_SPIN, table))
    sampling = cell_drawing.TargetSampling(6, freedom="spin")
    result, issues = cell_drawing.view(problem, 0, sampling, plan=outcome)
    assert not has_errors(issues)
    if other:
        assert "path" not in result["map"]
        return
    path = result["map"]["path"]
    (operation,) = outcome.operations
    assert len(path) == 6 == operation.targets.count
    model = plant.build_cell_model(problem.cell, problem.stock, np.asarray(problem.stock.place))
    tools = scenes.extract_scene(model).poses({"left": operation.q["left"]})["left/tool"]
    for value, tool, nominal in zip(path, tools, operation.targets.pose["left"], strict=True):
        turn = np.linalg.inv(nominal) @ tool @ problem.cell.arm("left").tool.tcp
        assert value == pytest.approx(np.rad2deg(np.arctan2(turn[1, 0], turn[0, 0])), abs=0.01)
    place_sampling = cell_drawing.TargetSampling(6, freedom="place x")
    along, _ = cell_drawing.view(problem, 0, place_sampling, plan=outcome)
    assert along["map"]["path"] == [0.0] * 6  # the block stands where it was planned
    bare, _ = cell_drawing.view(problem, 0, sampling)
    assert "path" not in bare["map"]


def test_a_plan_of_somebody_else_or_of_no_job_is_404(running_service: InProcess) -> None:
    answer = running_service.post(path=f"/v1/cell?targets=6&freedom=place x&job={'0' * 32}")
    assert (answer.status_code, issue_codes(answer)) == (404, [("service.unknown_job", None)])
    job = running_service.post(named_problem("unplanned")).json()["id"]
    running_service.wait_for_end(job)
    body = running_service.post(path=f"/v1/cell?targets=6&freedom=place x&job={job}").json()
    assert "path" not in body["map"]  # its plan cannot be read


def test_a_robot_of_a_users_file_is_drawn_where_it_says(running_service: InProcess) -> None:
    """The URDF of the catalogue's robot as a user's file: its bodies are drawn where the catalogue's are."""
    own = "{urdf: mine.urdf, name: mine, family: abb, payload_kg: 6, full_speed_after_s: 0.25}"
    files = [
        ("problem", ("p.yaml", named_problem("own_robot").replace("robot: irb140", f"robot: {own}"))),
        ("files", ("targets.csv", _table())),
        ("files", ("mine.urdf", (ROOT / "urdf" / "irb140.urdf").read_bytes())),
    ]
    answer_body = running_service.http.post("/v1/cell?targets=3", files=files).json()
    usual = running_service.post(named_problem("usual"), path="/v1/cell?targets=3").json()
    links = {body["body"] for body in answer_body["bodies"] if body["kind"] == "link"}
    assert len(links) >= 6
    for link in links:
        item, other = matrices(answer_body["poses"][link]), matrices(usual["poses"][link])
        assert item == pytest.approx(other, abs=0.02)


def test_meshes_of_a_robot_come_with_the_problem(running_service: InProcess) -> None:
    """One for collision and one to be seen, each by the name that the problem has for it; the second one is
    drawn."""
    lines = "urdf: mine.urdf, name: mine, family: abb, payload_kg: 6, full_speed_after_s: 0.25"
    lines += ", meshes: [{name: plate.stl, file: plate.stl}], visuals: [{name: seen.stl, file: seen.stl}]"
    text = (ROOT / "urdf" / "irb140.urdf").read_text("utf-8")
    text = re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)
    both = [urdf_text.geometry_tag("mesh", (), np.eye(4), "plate.stl")]
    both += [urdf_text.geometry_tag("mesh", (), np.eye(4), "seen.stl", "visual")]
    hand = r'(<link name="link_6">.*?)(?:<collision>.*?</collision>\s*)+'
    text = re.sub(hand, rf"\1{both[0]}{both[1]}", text, flags=re.DOTALL)
    files = [
        ("problem", ("p.yaml", named_problem("meshed").replace("robot: irb140", f"robot: {{{lines}}}"))),
        ("files", ("targets.csv", _table())),
        ("files", ("mine.urdf", text.encode())),
    ]
    for name, size in (("plate.stl", (0.06, 0.06, 0.02)), ("seen.stl", (0.05, 0.04, 0.03))):
        mesh = trimesh.creation.box(size).export(file_type="stl")
        files.append(("files", (name, mesh)))
    response = running_service.http.post("/v1/cell", files=files)
    assert response.status_code == 200, response.text[:500]
    (hand,) = [body for body in response.json()["bodies"] if body["body"] == "left/link_6"]
    assert np.ptp(np.reshape(hand["vertices"], (-1, 3)), axis=0) == pytest.approx([50.0, 40.0, 30.0])


def test_reach_over_the_block_is_that_of_the_wrist(running_service: InProcess, tmp_path: Path) -> None:
    """One pose at each point, so the reach follows from the wrist centre alone.

    It is bounded by the shells about shoulder and elbow of an arm with a spherical wrist (Brandstoetter et
    al. 2014), with the lengths of the IRB 140's data sheet (70, 352, 360, 380, 65 mm).
    """
    text = small_problem.PROBLEM.replace("size_mm: [100, 100, 100]", "size_mm: [700, 900, 900]")
    found = running_service.post(text, path="/v1/cell?targets=4&reach=true").json()["reach"]
    points = np.array(found["points_mm"])
    assert 300 < len(points) <= 700 and found["targets"] == len(small_problem.ROWS)
    state = np.array(found["states"]["left"])
    pose = np.tile(np.eye(4), (len(points), 1, 1))
    pose[:, :3, :3] = Rotation.from_quat([-0.5, 0.5, 0.5, 0.5]).as_matrix()
    pose[:, :3, 3] = points
    tcp = pipeline.load(small_problem.write(tmp_path, text)).cell.arms[0].tool.tcp.copy()
    tcp[:3, 3] *= 1000.0
    flange = pose @ np.linalg.inv(tcp)
    wrist = flange[:, :3, 3] - 65.0 * flange[:, :3, 2]
    reached = np.zeros(len(points), dtype=bool)
    for way in (-70.0, 70.0):  # with the shoulder before and behind the axis
        distance = np.hypot(np.hypot(wrist[:, 0], wrist[:, 1]) + way, wrist[:, 2] - 352.0)
        reached |= (distance <= 360.0 + 380.0) & (distance >= 380.0 - 360.0)
    assert ((state == found["codes"].index("motion.no_reach")) == ~reached).all()
    assert 20 < reached.sum() < len(points) - 20
    near = np.linalg.norm(points - [450.0, 0.0, 500.0], axis=1).argmin()
    assert state[near] == 0  # beside targets that have postures
    assert "reach" not in running_service.post(text, path="/v1/cell?targets=4").json()
