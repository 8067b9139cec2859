"""Problems written in Python: the same problems as files, the same faults, and refusal of other values."""

from __future__ import annotations

import dataclasses
import enum
import html
import json
import re
import shutil
import subprocess
import sys
import types
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import planner
from planner import spec
from planner.geometry.mesh_files import read_mesh
from planner.reading import strict_yaml
from tests import small_problem
from tests.test_docs import reference

PROBLEMS = Path(__file__).parents[1] / "problems"
FAST_NAMES = ["wing", "gcode", "plate_with_holes", "kerf_test", "engrave", "shell_piece_held", "ruled_wall"]


def small(**words: Any) -> spec.Problem:
    """The small problem, written in Python."""
    turn = Rotation.from_quat([-0.5, 0.5, 0.5, 0.5]).as_matrix()
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :3, :3] = turn
    poses[:, :3, 3] = [(0.45, y, 0.5) for y in np.linspace(-0.05, 0.05, 6)]
    arm = spec.Arm(
        name="left",
        robot="irb140",
        tool=spec.WireHolder(mounting="along", side="start"),
        home_deg=np.array([0, 0, 0, 0, 45, 0]),
    )
    given = {
        "name": "small",
        "cell": spec.Cell(arms=[arm]),
        "stock": spec.Stock(size_mm=[100, 100, 100], place=spec.Pose(xyz_mm=(450, 0, 0))),
        "operations": [
            spec.Targets(
                name="poses", poses={"left": poses}, unit="m", columns={"feed_mm_s": [20] * 6}, frame="world"
            )
        ],
    }
    return spec.Problem(**{**given, **words})


def refusal(make: Any) -> planner.Issue:
    with pytest.raises(planner.TandemError) as caught:
        make()
    (issue,) = caught.value.issues
    return issue


@pytest.mark.parametrize("name", FAST_NAMES)
def test_a_file_read_as_sections_is_the_same_problem_and_is_saved_as_one(name: str, tmp_path: Path) -> None:
    loaded = planner.load(PROBLEMS / name / "problem.yaml")
    built = planner.build(spec.Problem.read(name))
    assert built.digest == loaded.digest
    path = planner.save(built, tmp_path / "there")
    assert path == tmp_path / "there" / "problem.yaml"
    assert planner.load(path).digest == loaded.digest


def test_what_is_said_in_python_plans_as_the_file_does(tmp_path: Path) -> None:
    from_file = planner.plan(planner.load(small_problem.write(tmp_path)))
    outcome = planner.plan(small())
    assert outcome.verified
    for arm, path in from_file.plan.operations[0].q.items():
        assert outcome.plan.operations[0].q[arm] == pytest.approx(path, abs=1e-9)
    assert repr(outcome).startswith("<Outcome of small: verified, ")
    assert len(repr(outcome.plan)) < 1000


def test_meshes_grids_and_pairs_of_arrays_are_files(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(-100, 100, 5), np.linspace(-50, 50, 4), indexing="ij")
    grid = np.stack([x, y, 0.001 * x**2 + 1 / 3], axis=-1)
    whole = spec.FaceMesh(file=grid, unit="mm")
    vertices, faces = grid.reshape(-1, 3), read_mesh(Path(whole["file"]), 1e-3).faces
    assert spec.FaceMesh(file=(vertices, faces), unit="mm") == whole
    assert spec.FaceMesh(file=trimesh.Trimesh(vertices, faces, process=False), unit="mm") == whole
    read = trimesh.load(whole["file"], process=False)
    assert read.area == pytest.approx(trimesh.Trimesh(vertices, faces).area, rel=1e-12)
    assert (np.asarray(read.vertices) == vertices).all(), "every digit is kept"
    assert (read.face_normals[:, 2] > 0.9).all(), "along N x along M"
    nested = spec.Part(front={"mesh": {"file": grid, "unit": "mm"}}, back=spec.Back(offset_mm=10))
    assert nested["front"]["mesh"]["file"] == whole["file"]


def test_the_mesh_travels_with_the_problem_that_is_saved(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(-60, 60, 9), np.linspace(-150, 150, 9), indexing="ij")
    part = spec.Part(
        front=spec.Front(mesh=spec.FaceMesh(file=np.stack([x, y, 60 + x**2 / 200], axis=-1), unit="mm")),
        back=spec.Back(offset_mm=15),
    )
    wire = spec.Wire(material="spring_steel", diameter_mm=1.5, length_mm=520, temperature_c=300)
    problem = spec.Problem(
        name="panel",
        cell="two_irb140_facing",
        stock=spec.Stock(size_mm=[180, 400, 110], support="pedestal"),
        part=part,
        operations=[spec.ElasticWire(name="faces", arms=["left", "right"], wire=wire, kerf_mm=2.5)],
    )
    built = planner.build(problem)
    path = planner.save(problem, tmp_path / "panel.yaml")
    (mesh,) = (tmp_path / "files").iterdir()
    assert mesh.read_bytes() == Path(part["front"]["mesh"]["file"]).read_bytes()
    assert planner.load(path).digest == built.digest


def test_a_file_of_another_problem_is_not_overwritten_unasked(tmp_path: Path) -> None:
    path = planner.save(small(), tmp_path)
    planner.save(small(), tmp_path)
    issue = refusal(lambda: planner.save(small(name="other"), tmp_path))
    assert issue.code == "output.folder"
    assert "overwrite=True" in issue.message
    assert planner.load(path).name == "small"
    planner.save(small(name="other"), tmp_path, overwrite=True)
    assert planner.load(path).name == "other"


@given(st.tuples(*[st.floats(-179, 179)] * 3), st.sampled_from([("mm", 1.0), ("m", 1e3), ("in", 25.4)]))
@settings(max_examples=60, derandomize=True)
def test_a_matrix_is_the_pose_that_scipy_makes_of_its_angles(
    angles: tuple[float, float, float], unit: tuple[str, float]
) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    matrix[:3, 3] = 1.0, -2.0, 3.5
    pose = spec.Pose(matrix=matrix, unit=unit[0])
    again = Rotation.from_euler("xyz", pose["rpy_deg"], degrees=True).as_matrix()
    assert again == pytest.approx(matrix[:3, :3], abs=1e-12)
    assert pose["xyz_mm"] == pytest.approx(matrix[:3, 3] * unit[1])


class Side(enum.StrEnum):
    START = "start"


def test_values_of_numpy_and_enums_are_plain_ones() -> None:
    stock = spec.Stock(size_mm=(np.float32(3), np.int64(4), 5), foam=np.str_("eps_a120"))
    assert json.dumps(dict(stock)) == '{"size_mm": [3.0, 4, 5], "foam": "eps_a120"}'
    assert json.dumps(dict(spec.WireHolder(side=Side.START))) == '{"kind": "wire_holder", "side": "start"}'


def test_arrays_of_any_precision_and_of_text_are_plain_values() -> None:
    assert (
        json.dumps(spec.Pose(xyz_mm=np.array([1, 2, 3], dtype=np.longdouble))["xyz_mm"]) == "[1.0, 2.0, 3.0]"
    )
    assert spec.Targets(name="p", arms=np.array(["left", "right"]), file="x.csv")["arms"] == ["left", "right"]
    poses = {"left": np.tile(np.eye(4, dtype=int), (2, 1, 1))}
    column = {"segment": np.array(["cut", "air"])}
    made = spec.Targets(name="p", poses=poses, unit="m", columns=column)
    assert [row.split(",")[-1] for row in Path(made["file"]).read_text().split()] == ["segment", "cut", "air"]


def test_files_of_arrays_that_are_gone_are_named_and_come_again(tmp_path: Path) -> None:
    problem, built = small(), planner.build(small())
    path = Path(problem["operations"][0]["file"])
    shutil.rmtree(path.parent)
    issue = refusal(lambda: planner.save(built, tmp_path))
    assert (issue.code, issue.file) == ("problem.missing_file", str(path))
    assert small() == problem
    planner.save(built, tmp_path)


FORKED = """
import os, sys
from pathlib import Path
from planner.reading import values
path = Path(values._store("v 0 0 0", ".obj"))
child = os.fork()
if child == 0:
    sys.exit()
os.waitpid(child, 0)
print(path, path.is_file())
"""


def test_files_of_arrays_outlive_a_forked_process_and_end_with_their_own() -> None:
    ran = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, check=True)
    path, there = ran.stdout.split()
    assert there == "True"
    assert not Path(path).parent.exists()


LOOP: list[Any] = []
LOOP.append(LOOP)
FAULTS = {
    "Arm.base: a pose as an array has no unit; write spec.Pose(matrix=..., unit='m')": lambda: spec.Arm(
        name="a", robot="irb140", tool=spec.Bow(), base=np.eye(4)
    ),
    "Pose.matrix: got the unit None; give mm, cm, m, in, ft": lambda: spec.Pose(matrix=np.eye(4)),
    "Pose.matrix: got an array of shape (3, 3), a pose is (4, 4)": lambda: spec.Pose(
        matrix=np.eye(3), unit="m"
    ),
    "Pose.matrix: pose is not a right-handed frame": lambda: spec.Pose(
        matrix=np.diag([1.0, 1, -1, 1]), unit="m"
    ),
    "Pose: unit is for a matrix": lambda: spec.Pose(xyz_mm=[0, 0, 0], unit="m"),
    "Pose.xyz_mm.2: got nan; give a finite number": lambda: spec.Pose(xyz_mm=[1, 2, np.nan]),
    "Pose.xyz_mm: has inf at [1]; give finite numbers": lambda: spec.Pose(xyz_mm=np.array([1, np.inf, 2])),
    "Pose: xyz_mm: entry 2, counted from 0, is missing": lambda: spec.Pose(xyz_mm=np.array([1.0, 2.0])),
    "Pose.xyz_mm: got a set, which no problem file can state": lambda: spec.Pose(xyz_mm={1, 2, 3}),
    "Pose.xyz_mm: is a masked array": lambda: spec.Pose(xyz_mm=np.ma.masked_less(np.arange(3.0), 1)),
    "Pose.xyz_mm: is an array of complex128": lambda: spec.Pose(xyz_mm=np.array([1j, 2, 3])),
    "Stock.size_mm: nested more than 50 deep": lambda: spec.Stock(size_mm=LOOP),
    "Stock.size_mm: has the key 1, which is not text": lambda: spec.Stock(size_mm={1: 2}),
    "Stock: sizes_mm: unknown key": lambda: spec.Stock(size_mm=[1, 2, 3], sizes_mm=1),
    "Stock: size_mm.0: Input should be a valid number, got True": lambda: spec.Stock(size_mm=[True, 1, 1]),
    "Stock.foam: has half a character": lambda: spec.Stock(size_mm=[1, 2, 3], foam="\ud800"),
    "FaceMesh.file: got an array of shape (3, 3), a grid is (N, M, 3)": lambda: spec.FaceMesh(
        file=np.zeros((3, 3)), unit="mm"
    ),
    "FaceMesh.file: got a ndarray; give a file name": lambda: spec.FaceMesh(file=np.zeros((3, 3, 3))),
    "FaceMesh.file: faces must be vertex indices from 0 to 2": lambda: spec.FaceMesh(
        file=(np.zeros((3, 3)), [[0, 1, 7]]), unit="mm"
    ),
    "FaceMesh.file: got vertices (3, 2) and faces (1, 3), allowed are (V, 3) and (F, 3)": lambda: (
        spec.FaceMesh(file=(np.zeros((3, 2)), [[0, 1, 2]]), unit="mm")
    ),
    "FaceMesh.file: has vertices that are not finite": lambda: spec.FaceMesh(
        file=np.full((2, 2, 3), np.nan), unit="mm"
    ),
    "FaceMesh.file: got a object; give a file, a trimesh": lambda: spec.FaceMesh(file=object(), unit="mm"),
    "Targets.poses.l: got an array of shape (4, 4), a pose is (N, 4, 4)": lambda: spec.Targets(
        name="p", poses={"l": np.eye(4)}, unit="m"
    ),
    "Targets.columns: got 'feed', known are feed_mm_s": lambda: spec.Targets(
        name="p", poses={"l": np.eye(4)[None]}, unit="m", columns={"feed": [1]}
    ),
    "Targets.poses: the columns differ in length": lambda: spec.Targets(
        name="p", poses={"l": np.eye(4)[None]}, unit="m", columns={"feed_mm_s": [1, 2]}
    ),
    "Pose: xyz_mm together with a matrix": lambda: spec.Pose(matrix=np.eye(4), unit="m", xyz_mm=[1, 2, 3]),
    "Pose.matrix: is a masked array": lambda: spec.Pose(matrix=np.ma.masked_equal(np.eye(4), 1), unit="m"),
    "Pose.matrix: is an array of complex128": lambda: spec.Pose(matrix=np.eye(4) * (1 + 1j), unit="m"),
    "Pose.matrix: got the unit ['m']; give mm": lambda: spec.Pose(matrix=np.eye(4), unit=["m"]),  # type: ignore[arg-type]
    "Pose.xyz_mm.0: is too large a whole number": lambda: spec.Pose(xyz_mm=[10**5000, 0, 0]),
    "FaceMesh.file: is a masked array": lambda: spec.FaceMesh(
        file=(np.ma.masked_equal(np.eye(3), 1), [[0, 1, 2]]), unit="mm"
    ),
    "FaceMesh.file: is an array of complex128; give": lambda: spec.FaceMesh(
        file=(np.eye(3) * 1j, [[0, 1, 2]]), unit="mm"
    ),
    "FaceMesh.file: got a NoneType; give a file": lambda: spec.FaceMesh(file=None, unit="mm"),
    "FaceMesh.file: got '', which is not a file name": lambda: spec.FaceMesh(file="", unit="mm"),
    "FaceMesh.file: has half a character": lambda: spec.FaceMesh(file="\ud800.obj", unit="mm"),
    "Targets: file together with poses": lambda: spec.Targets(
        name="p", poses={"l": np.eye(4)[None]}, unit="m", file="x.csv"
    ),
    "Targets: setup: got a str; give a Setup": lambda: spec.Targets(
        name="p", arms=["l"], file="x.csv", setup="auto"
    ),
    "Problem: operations.0.setup.plase: unknown key": lambda: small().changed("operations.0.setup.plase", 1),
    "Targets: unit and columns are for poses": lambda: spec.Targets(
        name="p", arms=["l"], file="x.csv", unit="m"
    ),
    "got 'polish', known are elastic_wire": lambda: spec.Operation(name="p", process="polish"),
    "Setup: place: Input should be 'auto', got 'nowhere'": lambda: spec.StraightWire(
        name="p", arms=["a"], cuts="all", kerf_mm=1, setup={"place": "nowhere"}
    ),
    "Problem: operations.0.feed_mm_s: Input should be greater than or equal to 0.1, got -1": lambda: (
        small().changed("operations.poses.feed_mm_s", -1)
    ),
    "Problem: operations.nobody: 0 entries have that name, known are poses": lambda: small().changed(
        "operations.nobody.feed_mm_s", 1
    ),
    "no such file; check the path": lambda: spec.Problem.read("nothing"),
}


@pytest.mark.parametrize("message", FAULTS)
def test_what_is_wrong_is_refused_where_it_is_said(message: str) -> None:
    issue = refusal(FAULTS[message])
    assert message in issue.message
    assert issue.file is None or issue.code == "problem.missing_file"
    assert issue.line is None


def test_a_problem_larger_than_files_may_be_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strict_yaml, "MAX_YAML_BYTES", 300)
    issue = refusal(lambda: planner.build(small()))
    assert issue.code == "problem.too_large"
    assert "give points as a mesh or a separate file" in issue.message


def test_other_things_than_problems_are_named() -> None:
    with pytest.raises(TypeError, match=r"must be a planner\.spec\.Problem, got a dict"):
        planner.build({"name": "x"})  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="got a str"):
        planner.plan("wing")  # type: ignore[arg-type]


def test_faults_across_sections_are_those_of_a_file(tmp_path: Path) -> None:
    path = small_problem.write(tmp_path, small_problem.PROBLEM.replace("[left]", "[rihgt]"))
    with pytest.raises(planner.TandemError) as caught:
        planner.load(path)
    (told,) = caught.value.issues
    wrong = small().changed("operations.0.arms", ["rihgt"])
    assert refusal(lambda: planner.build(wrong)).message == told.message
    assert [issue.code for issue in planner.check(wrong)] == ["problem.unknown_arm"]


def test_sections_do_not_change() -> None:
    base = small()
    other = base.changed("stock.size_mm", [120, 100, 100]).replace(name="wider")
    base["stock"]["size_mm"][0] = 7
    assert base["stock"]["size_mm"] == [100, 100, 100]
    assert (other["name"], other["stock"]["size_mm"]) == ("wider", [120, 100, 100])
    assert eval(repr(base["cell"]["arms"])) == base["cell"]["arms"]
    assert eval(repr(base), vars(spec)) == base
    with pytest.raises(AttributeError, match=r"a Problem is immutable; replace\(name=...\) returns"):
        base.name = "other"


PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=12),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=20,
)


@given(st.dictionaries(st.text(min_size=1, max_size=8), PLAIN, max_size=5))
@settings(max_examples=300, derandomize=True)
def test_what_is_written_as_yaml_is_read_as_the_same(data: dict[str, Any]) -> None:
    text = strict_yaml.dump(data).encode()
    try:
        read, _ = strict_yaml.parse(text, "here")
    except planner.TandemError:
        assert any(ord(letter) < 32 or 0x7F <= ord(letter) < 0xA0 for letter in str(data)) or not data
        return
    assert read == data


@pytest.mark.parametrize(
    "text", ["1e3", "-2E-5", "on", "null", "~", "2026-01-01", "0x10", "1_000", ".5e1", "="]
)
def test_text_that_looks_like_something_else_stays_text(text: str) -> None:
    read, _ = strict_yaml.parse(strict_yaml.dump({"a": text, "b": [text]}).encode(), "here")
    assert read == {"a": text, "b": [text]}


def test_the_page_lists_every_section() -> None:
    page = (PROBLEMS.parent / "docs" / "python.md").read_text(encoding="utf-8")
    listed = re.findall(r"`(\w+)`", page.split("| sections | of |")[1].split("\n\n")[0])
    kinds = [
        name for name, kind in vars(spec).items() if isinstance(kind, type) and issubclass(kind, spec.Section)
    ]
    assert sorted(listed) == sorted(set(kinds) - {"Section"})


def test_every_section_of_the_reference_can_be_said() -> None:
    """Each schema with a chapter on the page on problem files, except those with equivalent sections."""
    known = {
        kind.model
        for kind in vars(spec).values()
        if isinstance(kind, type) and issubclass(kind, spec.Section)
    }
    rest = {model.__name__ for _, _, model in reference().CHAPTERS} - {
        item.__name__ for item in known if item
    }
    inner = {
        "DrawingFile",
        "PlaceFile",
        "PowerOutputFile",
        "DevicePlaceFile",
        "EngravedFile",
        "SignalsFile",
        "SignalWireFile",
        "WireEndFile",
    }
    assert rest == inner, "plain mappings, and a pose"


@pytest.fixture(scope="module")
def outcome() -> planner.Outcome:
    return planner.plan(small())


def test_frames_and_samples_are_the_plan_at_its_times(outcome: planner.Outcome) -> None:
    plan = outcome.plan
    (operation,) = plan.operations
    assert plan.duration == operation.time[-1]
    for index in (0, 2, 5):
        frame = plan.frame(float(operation.time[index]))
        assert (frame.operation, frame.target) == ("poses", index)
        assert frame.q["left"] == pytest.approx(operation.q["left"][index], abs=1e-12)
    sampled = plan.sample(0.25)
    assert sampled.time[-1] == plan.duration
    for row in (1, 7, -1):
        frame = plan.frame(float(sampled.time[row]))
        assert frame.q["left"] == pytest.approx(sampled.q["left"][row], abs=1e-12)
        assert frame.target == sampled.target[row]
    middle = 0.5 * (operation.time[2] + operation.time[3])
    half = 0.5 * (operation.q["left"][2] + operation.q["left"][3])
    assert plan.frame(float(middle)).q["left"] == pytest.approx(half)


def test_plans_of_several_operations_follow_one_another(outcome: planner.Outcome) -> None:
    (own,) = outcome.plan.operations
    other = dataclasses.replace(own, name="again", q={"right": own.q["left"] + 1.0}, time=own.time + 3.0)
    plan = dataclasses.replace(outcome.plan, operations=(own, other))
    assert plan.duration == pytest.approx(2 * own.time[-1])
    frame = plan.frame(float(own.time[-1] + own.time[1]))
    assert (frame.operation, frame.target) == ("again", 1)
    assert frame.q["right"] == pytest.approx(own.q["left"][1] + 1.0)
    sampled = plan.sample(0.5)
    first = sampled.operation == 0
    assert np.isnan(sampled.q["right"][first]).all()
    assert np.isnan(sampled.q["left"][~first]).all()
    assert np.isfinite(sampled.q["left"][first]).all()


@pytest.mark.parametrize("t", [-1.0, 1e6, np.nan])
def test_times_outside_of_a_plan_are_refused(outcome: planner.Outcome, t: float) -> None:
    with pytest.raises(ValueError, match="t must be from 0 to"):
        outcome.plan.frame(t)


@pytest.mark.parametrize("dt", [0.0, -1.0, 1e-12, np.nan])
def test_steps_that_are_none_are_refused(outcome: planner.Outcome, dt: float) -> None:
    with pytest.raises(ValueError, match="dt must be above"):
        outcome.plan.sample(dt)


def test_an_outcome_is_shown_in_a_browser(
    outcome: planner.Outcome, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    viewer = outcome.show()
    assert opened == [viewer.url]
    assert html.escape(viewer.page) in viewer._repr_html_()
    assert "<div id='bar'>" in viewer.page
    with urllib.request.urlopen(viewer.url, timeout=30) as answer:
        assert answer.read().decode() == viewer.page
    assert "INFO" not in capfd.readouterr().err
    outcome.show(browser=False)
    kernel = types.SimpleNamespace(get_ipython=lambda: types.SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", kernel)  # type: ignore[arg-type]
    outcome.show()
    assert len(opened) == 1, "a notebook shows it in its cell"
    outcome.show(browser=True)
    kernel.get_ipython = lambda: object()  # the shell at a terminal has no cells
    outcome.show()
    assert len(opened) == 3
