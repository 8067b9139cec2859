"""The components for Grasshopper, as a canvas runs them, against a real service.

The names of Rhino that they use are stand-ins (rhino_host.py). No Rhino ran.
"""

from __future__ import annotations

import importlib
import json
import math
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

from tests import small_problem
from tests.element.shells import cap
from tests.integrations import rhino_host
from tests.integrations.rhino_host import Component, Document, UnitSystem
from tests.service.support import ROOT, Process
from tests.service.test_tandem_client import interpreter

SOLUTION_S = 0.4
"""A solution of one component takes no longer, on a machine that has other work too."""
OURS = ("Rhino", "Grasshopper", "scriptcontext", "tandem_client", "tandem_grasshopper")
EXPECTED_ROWS = np.array([[float(word) for word in row.split(",")] for row in small_problem.ROWS])


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    process = Process(tmp_path_factory.mktemp("desk") / "data").wait()
    yield process.url
    process.stop()
    assert "Traceback" not in process.log.read_text()


@pytest.fixture(scope="module")
def module() -> Iterator[ModuleType]:
    paths = list(sys.path)
    rhino_host.install()
    yield importlib.import_module("tandem_grasshopper")
    sys.path[:] = paths
    for name in OURS:
        del sys.modules[name]


@pytest.fixture
def canvas(module: ModuleType) -> Any:
    """The document that is open in Rhino, in metres."""
    active = module.Rhino.RhinoDoc.ActiveDoc
    active.ModelUnitSystem = UnitSystem.Meters
    return active


def problem(**changes: Any) -> str:
    return json.dumps({**yaml.safe_load(small_problem.PROBLEM), **changes})


def client(url: str) -> Any:
    result = Component("connect", Document()).settle(url=url, token=None)
    assert result["version"] == "0.1.0"
    return result["client"]


def press_button(name: str, button: str = "run", **inputs: Any) -> tuple[Component, dict[str, Any]]:
    """Press the button of a component; return the component and its final outputs."""
    buttons = {"job": ("check", "run", "cancel"), "divide": ("run", "cancel")}[name]
    given = {"mesh": None, "files": None, **({"curves": None} if name == "job" else {}), **inputs}
    component = Component(name, Document())
    component.solve(**given, **dict.fromkeys(buttons, False))
    component.solve(**given, **{item: item == button for item in buttons})
    return component, component.settle(**given, **dict.fromkeys(buttons, False))


@pytest.fixture(scope="module")
def job(module: ModuleType, url: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    table = tmp_path_factory.mktemp("table") / "targets.csv"
    table.write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS]))
    component, found = press_button("job", client=client(url), problem=problem(), files=[str(table)])
    assert (found["state"], found["issues"], component.told) == ("verified", [], [])
    assert component.Message == "verified"
    assert component.longest_s < SOLUTION_S
    return str(found["job"])


def test_a_result_comes_in_the_unit_of_the_document(canvas: Any, url: str, job: str, tmp_path: Path) -> None:
    component = Component("result", Document())
    given = {"client": client(url), "job": job, "folder": str(tmp_path), "refresh": False}
    result = component.settle(**given)
    assert (result["state"], result["issues"]) == ("verified", [])
    assert component.longest_s < SOLUTION_S
    planes = result["planes"].branches[(0, 0)]
    assert np.abs(np.array([[*item.Origin] for item in planes]) - EXPECTED_ROWS[:, :3] / 1e3).max() < 1e-9
    assert np.allclose([*planes[0].XAxis], [0, 0, -1], atol=1e-9)
    assert np.allclose([*planes[0].YAxis], [-1, 0, 0], atol=1e-9)
    assert result["names"].branches == {(0, 0): [f"joint_{i}" for i in range(1, 7)]}
    assert sorted(result["joints"].branches) == [(0, 0, k) for k in range(6)]
    assert {len(item) for item in result["joints"].branches.values()} == {len(EXPECTED_ROWS)}
    times = result["times"].branches[(0,)]
    assert times[0] == 0.0
    assert len(times) == len(EXPECTED_ROWS) == len(set(times))
    assert result["targets"].branches[(0,)][0].endswith("/1")
    assert [*result["blocks"].branches[(0,)][0].Origin] == [0.45, 0, 0]
    assert result["part"] == [], "poses leave none"
    texts = [Path(path).read_text() for path in result["programs"]]
    assert any("MODULE" in text for text in texts)
    assert {Path(path).relative_to(tmp_path).parts[0] for path in result["programs"]} == {f"small-{job[:8]}"}
    for link in (result["report"], result["replay"]):
        with urllib.request.urlopen(link, timeout=60) as answer:
            assert answer.read(15).lower() == b"<!doctype html>"
    canvas.ModelUnitSystem = UnitSystem.Inches
    planes = component.solve(**given)["planes"].branches[(0, 0)]
    assert np.abs(np.array([[*item.Origin] for item in planes]) - EXPECTED_ROWS[:, :3] / 25.4).max() < 1e-9
    canvas.ModelUnitSystem = UnitSystem.Unset
    result = component.solve(**given)
    assert (result["state"], result["planes"]) == ("verified", None)
    assert "Unset. Set one" in result["issues"][0] and component.told[0][0] == "Error"


def test_a_part_is_a_mesh_of_the_document(canvas: Any, module: ModuleType, url: str) -> None:
    face = rhino_host.Mesh()
    for x in range(-60, 61, 10):
        for y in range(-150, 151, 10):
            face.Vertices.Add(x / 1e3, y / 1e3, 0.06 + x * x / 2e5 - y * y / 1.5e6)
    for i in range(12):
        for j in range(30):
            a = 31 * i + j
            face.Faces.AddFace(a, a + 31, a + 32)
            face.Faces.AddFace(a, a + 32, a + 1)
    wire = {"material": "spring_steel", "diameter_mm": 1.5, "length_mm": 520, "temperature_c": 300}
    cut = {
        "name": "faces",
        "process": "elastic_wire",
        "arms": ["left", "right"],
        "wire": wire,
        "kerf_mm": 2.5,
    }
    said = {
        "tandem": 1,
        "name": "panel",
        "cell": "two_irb140_facing.yaml",
        "stock": {"size_mm": [180, 400, 110], "support": "pedestal"},
        "part": {"back": {"offset_mm": 15}},
        "operations": [cut],
    }
    files = [str(ROOT / "problems" / "cells" / "two_irb140_facing.yaml")]
    given = {"client": client(url), "problem": json.dumps(said), "files": files}
    component, found = press_button("job", "check", mesh=face, **given)
    assert (found["state"], found["issues"], found["job"]) == ("checked", [], "")
    assert component.longest_s < SOLUTION_S
    canvas.ModelUnitSystem = UnitSystem.Inches
    sent = module._with_part({"part": {"back": {"offset_mm": 15}}}, face, (), {})[0]["part"]
    assert sent["back"] == {"offset_mm": 15}
    points = np.array(sent["front"]["mesh"]["file"][0])
    assert np.ptp(points, axis=0)[:2] == pytest.approx([0.12 * 25.4, 0.3 * 25.4])


def test_pairs_of_curves_are_ruled_surfaces(canvas: Any, module: ModuleType) -> None:
    canvas.ModelUnitSystem = UnitSystem.Inches
    low, high = rhino_host.ArcCurve(10.0, 0.0), rhino_host.ArcCurve(10.0, 4.0)
    part = module._with_part({"part": {"in_stock": {}}}, None, [low, high], {})[0]["part"]
    assert part["in_stock"] == {}
    (own,) = part["ruled"]
    assert own["name"] == "surface_1"
    start = np.array(own["start"]["polyline_mm"])
    assert np.linalg.norm(start[:, :2], axis=1) == pytest.approx(254.0)
    middles = np.linalg.norm((start[1:] + start[:-1])[:, :2] / 2, axis=1)
    assert 254.0 - middles.min() <= module.CURVE_TOL_MM * (1 + 1e-6)
    assert own["end"]["polyline_mm"][0] == pytest.approx([254.0, 0.0, 101.6])
    named = {"part": {"ruled": [{"name": "wall", "flip": True}]}}
    assert module._with_part(named, None, [low, high], {})[0]["part"]["ruled"][0]["flip"] is True
    with pytest.raises(ValueError, match="two for each surface"):
        module._with_part({}, None, [low], {})
    with pytest.raises(ValueError, match="dict or JSON"):
        module._with_part(Path("a.yaml"), None, [low, high], {})


def test_a_problem_file_goes_along_with_its_mesh(canvas: Any, url: str, tmp_path: Path) -> None:
    face = rhino_host.Mesh()
    for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
        face.Vertices.Add(x, y, 0)
    face.Faces.AddFace(0, 1, 2)
    face.Faces.AddFace(0, 2, 3)
    path = small_problem.write(tmp_path)
    given = {"client": client(url), "problem": str(path), "files": [str(tmp_path / "targets.csv")]}
    _, found = press_button("job", "check", mesh=face, **given)
    assert (found["state"], found["issues"]) == ("checked", [])


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"problem": "nowhere.yaml"}, "is not a file"),
        ({"problem": "{"}, "problem: invalid JSON"),
        ({"problem": "{}", "files": ["a/cell.yaml", "b/cell.yaml"]}, "two are named cell.yaml"),
        ({"problem": "{}", "curves": [None]}, "two for each surface"),
        ({"problem": "{}"}, "required"),
        ({"problem": "{}", "files": ["nowhere.csv"]}, "nowhere.csv"),
    ],
)
def test_what_is_wrong_stands_at_the_component(canvas: Any, url: str, inputs: Any, words: str) -> None:
    component, found = press_button("job", "check", client=client(url), **inputs)
    assert any(words in issue for issue in found["issues"]), found["issues"]
    assert component.told[0][0] == "Error"


def test_a_document_that_opens_with_a_switch_on_plans_nothing(canvas: Any, url: str) -> None:
    service = client(url)
    before = len(list(service.jobs()))
    component = Component("job", Document())
    on = {"mesh": None, "curves": None, "files": None, "check": False, "run": True, "cancel": False}
    component.settle(client=service, problem=problem(), **on)
    component.settle(client=service, problem=problem(), **on)
    assert component.Message == "press the button"
    assert len(list(service.jobs())) == before


def test_a_job_is_cancelled(canvas: Any, url: str, tmp_path: Path) -> None:
    table = tmp_path / "targets.csv"
    rows = [f"450,{y / 10},500,0.5,-0.5,0.5,0.5,20" for y in range(-500, 501)]
    table.write_text("\n".join([small_problem.COLUMNS, *rows]))
    given = {"client": client(url), "problem": problem(name="long"), "files": [str(table)]}
    given |= {"mesh": None, "curves": None, "check": False}
    component = Component("job", Document())
    component.solve(**given, run=False, cancel=False)
    component.solve(**given, run=True, cancel=False)
    until = time.monotonic() + 60
    while not component.solve(**given, run=False, cancel=False)["job"]:
        assert time.monotonic() < until
        time.sleep(0.02)
    found = component.settle(**given, run=False, cancel=True)
    assert found["state"] == "cancelled"
    result = Component("result", Document()).settle(
        client=given["client"], job=found["job"], folder=None, refresh=False
    )
    assert (result["state"], result["report"], result["planes"].branches) == ("cancelled", None, {})


class FakeSender:
    """A client that has not sent a job yet until ``go`` is set."""

    def __init__(self) -> None:
        self.go, self.cancelled = threading.Event(), []

    def submit(self, problem: Any, files: Any) -> str:
        self.go.wait(20.0)
        return "a"

    divide = submit

    def cancel(self, job: str) -> None:
        self.cancelled.append(job)

    def cancel_element(self, element: str) -> None:
        self.cancelled.append(f"element {element}")

    def wait(self, job: str, progress: Any) -> dict[str, Any]:
        return {"state": "cancelled" if self.cancelled else "verified", "issues": []}


@pytest.mark.parametrize(
    ("name", "inputs", "sent"),
    [
        ("job", {"problem": "{}", "curves": None, "check": False}, "a"),
        ("divide", {"definition": "{}"}, "element a"),
    ],
)
def test_what_is_still_being_sent_is_cancelled(canvas: Any, name: str, inputs: Any, sent: str) -> None:
    service = FakeSender()
    given = {"client": service, "mesh": None, "files": None, **inputs}
    component = Component(name, Document())
    for run, cancel in ((False, False), (True, False), (False, True), (False, False)):
        component.solve(**given, run=run, cancel=cancel)
    service.go.set()
    assert component.settle(**given, run=False, cancel=False)["state"] == "cancelled"
    assert service.cancelled == [sent]


def test_a_job_that_was_tried_again_is_asked_for_anew(canvas: Any) -> None:
    service = FakeSender()
    service.report_url = service.replay_url = lambda job: None
    given = {"client": service, "job": "a", "folder": None}
    service.cancelled.append("a")
    component = Component("result", Document())
    assert component.settle(**given, refresh=False)["state"] == "cancelled"
    service.wait = lambda job, progress: {"state": "refused", "issues": []}
    assert component.settle(**given, refresh=False)["state"] == "cancelled", "as it was asked for"
    component.solve(**given, refresh=True)
    assert component.settle(**given, refresh=False)["state"] == "refused"


def test_panels_of_an_element_are_meshes_of_the_document(canvas: Any, url: str) -> None:
    shape, dome = rhino_host.Mesh(), cap(n=9)
    for point in dome.vertices:
        shape.Vertices.Add(*point)
    for face in dome.faces:
        shape.Faces.AddFace(*face)
    problems = ROOT / "problems"
    template = yaml.safe_load((problems / "dome_267" / "held.yaml").read_text())
    definition = {
        "element": 1,
        "name": "dome",
        "thickness_mm": 150,
        "panels": {"hexagons": {"count": 30, "least_edge_mm": 40}},
        "blocks": [{"size_mm": [1200, 1000, 150], "foam": "eps_a120"}],
        "jobs": [{"problem": template}],
    }
    service = client(url)
    cell = str(problems / "cells" / "two_irb4600_bow_gripper.yaml")
    _, found = press_button("divide", client=service, definition=definition, mesh=shape, files=[cell])
    assert found["state"] == "done", found["issues"]
    component = Component("panels", Document())
    given = {"client": service, "element": found["element"]}
    shown = component.settle(**given, refresh=False)
    assert len(shown["ids"]) == len(shown["meshes"]) == 30
    assert set(shown["states"]) == {"not_planned"}
    sizes = [np.ptp([[*item] for item in mesh.Vertices.points], axis=0) for mesh in shown["meshes"]]
    assert 0.15 < np.max(sizes) < 1.7, "metres"
    (own,) = service.plan_panels(found["element"], [shown["ids"][0]])
    service.cancel(own)
    assert component.settle(**given, refresh=False)["jobs"] == [None] * 30, "as it was asked for"
    component.solve(**given, refresh=True)
    assert component.settle(**given, refresh=False)["jobs"][0] == own


def test_a_service_that_is_silent_holds_no_canvas(canvas: Any) -> None:
    """It takes the connection, and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        connect, job = Component("connect", Document()), Component("job", Document())
        service = connect.solve(url=address, token=None)["client"]
        given = {"mesh": None, "curves": None, "files": None, "check": False, "cancel": False}
        for run in (False, True, False):
            job.solve(client=service, problem=problem(), run=run, **given)
        Component("result", Document()).solve(client=service, job="a", folder=None, refresh=False)
        assert (len(connect.document.scheduled), len(job.document.scheduled)) == (1, 2)
        assert max(connect.longest_s, job.longest_s) < SOLUTION_S


def test_a_service_that_is_away_is_told_at_the_component(canvas: Any) -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        component = Component("connect", Document())
        component.settle(url=f"http://127.0.0.1:{one.getsockname()[1]}", token=None)
    ((level, text),) = component.told
    assert level == "Error"
    assert "does not answer" in text
    component.settle(url="ftp://x", token=None)
    assert "is not an http" in component.told[0][1]


@pytest.mark.parametrize("name", ["../a.mod", "/a.mod", "C:/a.mod", "a\\b.mod", "", "T/../../a"])
def test_programs_stay_in_their_folder(module: ModuleType, tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="sent a program"):
        module.save({name: "x"}, tmp_path / "own")
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_the_stand_in_refuses_other_threads() -> None:
    result: list[Exception] = []

    def touch() -> None:
        try:
            rhino_host.Point3d(0, 0, 0)
        except RuntimeError as error:
            result.append(error)

    thread = threading.Thread(target=touch)
    thread.start()
    thread.join()
    assert len(result) == 1
    assert math.isfinite(rhino_host.Point3d(0, 0, 0).X)


def test_they_run_by_the_python_of_rhino(url: str, tmp_path: Path) -> None:
    python = interpreter("3.9")
    if python is None:
        pytest.skip("there is no Python 3.9: no python3.9 in PATH, of pyenv or of uv")
    table = tmp_path / "targets.csv"
    table.write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS]))
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import rhino_host as host; host.install();"
        "one = lambda name: host.Component(name, host.Document());"
        "client = one('connect').settle(url=sys.argv[2], token=None)['client'];"
        "job, given = one('job'), dict(client=client, problem=sys.argv[3], files=[sys.argv[4]]);"
        "given.update(mesh=None, curves=None, check=False, cancel=False);"
        "job.solve(run=False, **given); job.solve(run=True, **given);"
        "made = job.settle(run=False, **given)['job'];"
        "found = one('result').settle(client=client, job=made, folder=None, refresh=False);"
        "print(sys.version_info[:2], found['state'], len(found['planes'].branches[0, 0]))"
    )
    command = [python, "-I", "-S", "-W", "error", "-c", code, str(Path(rhino_host.__file__).parent), url]
    command += [problem(name="ninth"), str(table)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.stdout == f"(3, 9) verified {len(EXPECTED_ROWS)}\n", done.stderr
