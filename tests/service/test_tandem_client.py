"""The single-file client: a round trip by other Pythons against a real service, and its error messages."""

from __future__ import annotations

import ast
import http.server
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.request
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import planner
from planner.issues import Issue
from planner.service import idempotency, tandem_client
from planner.service.models import API, Database, default_url
from planner.service.security import Auth, RefusedError
from tests import small_problem
from tests.element.shells import cap
from tests.service.support import ROOT, Process

FOLDER = ROOT / "client"
FILE = FOLDER / "tandem_client.py"


@pytest.fixture(scope="module")
def server_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, str]]:
    data = tmp_path_factory.mktemp("desk") / "data"
    data.mkdir()
    database = Database(default_url(data))
    token = Auth(database).create_token("ann")
    database.close()
    process = Process(data, "--require-token").wait()
    yield process, token
    process.stop()
    assert "Traceback" not in process.log.read_text()


def interpreter(version: str) -> str | None:
    """Find a Python of that version in PATH, pyenv or uv. Their shims may be broken."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    uv = Path.home() / ".local" / "share" / "uv" / "python"
    found = [shutil.which(f"python{version}")]
    found += map(str, sorted(pyenv.glob(f"versions/{version}.*/bin/python{version}")))
    found += map(str, sorted(uv.glob(f"*-{version}.*/bin/python{version}")))
    asked = "import sys; print('%d.%d' % sys.version_info[:2])"
    for item in filter(None, found):
        done = subprocess.run([item, "-I", "-c", asked], capture_output=True, text=True, check=False)
        if done.returncode == 0 and done.stdout.strip() == version:
            return item
    return None


@pytest.mark.sampled(every=2)
@pytest.mark.parametrize("version", ["3.9", "3.13"])
def test_a_round_trip_by_another_python(server_process: tuple[Process, str], version: str) -> None:
    """Without site-packages, so with nothing but the standard library, and with no warning."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version}: no python{version} in PATH, of pyenv or of uv")
    process, token = server_process
    name = f"small_{version.replace('.', '_')}"
    script = Path(__file__).with_name("round_trip.py")
    command = [python, "-I", "-S", "-W", "error", str(script), str(FOLDER), process.url, token, name]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    out = json.loads(done.stdout)
    assert ".".join(map(str, out["python"])) == version
    assert out.get("import_mb", 0) < 30
    assert out["api"] == API == tandem_client.API
    assert out["found"] == []
    assert out["state"] == "verified"
    assert "motion" in out["heard"]
    assert "MODULE" in "".join(out["programs"].values())
    assert out["motion"] == pytest.approx([450, -50, 500, 0, 0, -1, -1, 0, 0], abs=1e-6)
    assert out["report"].lower() == out["replay"].lower() == "<!doctype html>"
    assert f"name: {name}" in out["sent"]
    assert out["named"] == [["problem.field", "name"]]
    assert out["panel"] == []
    wrong, infinite, no_unit, no_faces = out["refusals"]
    assert sorted(item[::2] for item in wrong) == [
        ["problem.field", "colour"],
        ["problem.field", "stock.size_mm.0"],
    ]
    assert [item[::2] for item in infinite] == [["problem.not_finite", "stock.size_mm.0"]]
    assert [item[::2] for item in no_unit] == [["mesh.unit", "part.front.mesh.file"]]
    assert [item[::2] for item in no_faces] == [["problem.field", "part.front.mesh.file"]]
    assert all(item[1] for refusal in out["refusals"] for item in refusal)
    assert out["cancelled"] == "cancelled"
    assert out["jobs"] >= 2
    assert out["wrong_token"] == ["service.token"]


def readme_blocks() -> list[str]:
    """The scripts on the page of the client."""
    return re.findall(r"^```python\n(.*?)^```", (FOLDER / "README.md").read_text("utf-8"), re.M | re.S)


def test_the_problem_of_its_page_is_one(server_process: tuple[Process, str], tmp_path: Path) -> None:
    """As far as it is sent; the round trip plans a smaller one."""
    process, token = server_process
    code, _ = readme_blocks()
    code = code.replace("https://plans.example.org", process.url).replace("tandem_...", token)
    sent, _, rest = code.partition("job = client.submit(problem)")
    assert rest
    shutil.copy(ROOT / "problems" / "cells" / "two_irb140_facing.yaml", tmp_path / "cell.yaml")
    shutil.copy(FILE, tmp_path)
    whole = f"import sys; sys.path.insert(0, '.')\n{sent}"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", whole], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


ANY_SYSTEM = {
    *(
        "__future__",
        "collections.abc",
        "dataclasses",
        "http.client",
        "io",
        "json",
        "math",
        "os",
        "pathlib",
        "re",
    ),
    *(
        "secrets",
        "socket",
        "ssl",
        "time",
        "typing",
        "urllib.error",
        "urllib.parse",
        "urllib.request",
        "zipfile",
    ),
}
"""Modules that Windows and macOS have too."""


def test_it_is_written_for_python_3_9_and_any_system() -> None:
    tree = ast.parse(FILE.read_text("utf-8"), feature_version=(3, 9))
    imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imported |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert imported <= ANY_SYSTEM
    assert FILE.read_bytes().isascii()
    from_os = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "os"]
    assert {name.name for node in from_os for name in node.names} == {"PathLike", "fspath"}


def test_there_is_one_file_for_two_distributions(tmp_path: Path) -> None:
    """The wheels are built by the very builder that both pyproject.toml name, and the one of the planner's
    source package, too."""
    wheels = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is not installed")
    sources = pytest.importorskip("hatchling.builders.sdist", reason="hatchling is not installed")
    assert planner.Client.__mro__[1] is tandem_client.Client
    assert Path(tandem_client.__file__).resolve() == FILE
    for root, inside in ((FOLDER, "tandem_client.py"), (ROOT, "planner/service/tandem_client.py")):
        (made,) = sources.SdistBuilder(str(root)).build(directory=str(tmp_path), versions=["standard"])
        unpacked = tmp_path / Path(made).name.removesuffix(".tar.gz")
        shutil.unpack_archive(made, tmp_path)
        for source in (root, unpacked):
            (made,) = wheels.WheelBuilder(str(source)).build(directory=str(tmp_path), versions=["standard"])
            with zipfile.ZipFile(made) as wheel:
                assert wheel.read(inside) == FILE.read_bytes()
                modules = [name for name in wheel.namelist() if name.endswith(".py")]
                metadata = next(name for name in wheel.namelist() if name.endswith("METADATA"))
                about = wheel.read(metadata).decode()
            assert len(modules) == 1 or root == ROOT
            assert "Requires-Dist" not in about or root == ROOT
            assert "Requires-Python: >=3.9" in about or root == ROOT


def test_values_of_numpy_and_paths_go_along(server_process: tuple[Process, str], tmp_path: Path) -> None:
    process, token = server_process
    table = tmp_path / "targets.csv"
    table.write_text("\n".join([small_problem.COLUMNS, *small_problem.ROWS]))
    problem = {
        "tandem": np.int64(1),
        "name": "numpy",
        "cell": {
            "arms": [
                {
                    "name": "left",
                    "robot": "irb140",
                    "tool": {"kind": "wire_holder", "mounting": "along", "side": "start"},
                    "home_deg": np.array([0, 0, 0, 0, 45, 1e-7]),
                }
            ]
        },
        "stock": {"size_mm": np.full(3, 100.0), "place": {"xyz_mm": (450, 0, np.float64(0))}},
        "operations": [
            {"name": "poses", "process": "targets", "arms": ["left"], "file": table, "frame": "world"}
        ],
    }
    client = tandem_client.Client(process.url, token)
    assert client.check(problem) == ()
    written = small_problem.write(tmp_path)
    assert client.check(written, files={"targets.csv": table}) == ()
    assert client.check(written.read_bytes(), files={"targets.csv": table.read_bytes()}) == ()
    (issue,) = refusal(lambda: client.check(written))
    assert issue.code == "service.not_uploaded"
    both = planner.Client(process.url, token)
    assert both.check(problem) == both.check(planner.load(written)) == ()


def test_an_element_is_divided_and_its_panels_are_meshes(server_process: tuple[Process, str]) -> None:
    process, token = server_process
    dome, problems = cap(n=9), ROOT / "problems"
    template = yaml.safe_load((problems / "dome_267" / "held.yaml").read_text())
    template["cell"] = problems / "cells" / "two_irb4600_bow_gripper.yaml"
    element = {
        "element": 1,
        "name": "dome",
        "surface": {"mesh": {"file": (dome.vertices * 1e3, dome.faces), "unit": "mm"}},
        "thickness_mm": 150,
        "panels": {"hexagons": {"count": 30, "least_edge_mm": 40}},
        "blocks": [{"size_mm": [1200, 1000, 150], "foam": "eps_a120"}],
        "jobs": [{"problem": template}],
    }
    client = tandem_client.Client(process.url, token)
    result = client.divide(element)
    assert client.wait(result, timeout_s=120)["state"] == "done"
    panels = client.element(result)["panels"]
    meshes = client.meshes(result, "element.obj")
    assert sorted(meshes) == sorted(item["id"] for item in panels)
    for points, faces in meshes.values():
        edges = [(a, b) for face in faces for a, b in zip(face, face[1:] + face[:1], strict=True)]
        assert sorted(edges) == sorted((b, a) for a, b in edges), "a closed body"
        assert {item for face in faces for item in face} == set(range(len(points)))
        assert np.ptp(points, axis=0).max() < 1700, "of a block's size, in mm"
    (job,) = client.plan_panels(result, [panels[0]["id"]])
    client.cancel(job)
    again = {item["id"]: item.get("job") for item in client.element(result)["panels"]}
    assert [name for name, own in again.items() if own == job] == [panels[0]["id"]]


def test_drafts_sweeps_and_links_to_look(server_process: tuple[Process, str], tmp_path: Path) -> None:
    """As the service answers; what it does is for the tests of each."""
    process, token = server_process
    client = tandem_client.Client(process.url, token)
    table = {"Gewölbe ٣/t.csv": b"1,2"}
    first = client.keep_draft(b'{"a": [not a problem', "Gewölbe ٣", files=table)
    client.keep_draft({"kind": "none"}, "Greifer", "tool")
    assert (first["title"], first["version"]) == ("Gewölbe ٣", 1)
    second = client.save_draft(first["id"], 1, {"b": 2}, {"u.csv": b"3"}, without=["Gewölbe ٣/t.csv"])
    assert second["version"] == 2
    assert client.draft(first["id"]) == (b'{"b": 2}', {"u.csv": b"3"})
    assert client.draft(first["id"], 1) == (b'{"a": [not a problem', table)
    (issue,) = refusal(lambda: client.save_draft(first["id"], 1, {"c": 3}))
    assert (issue.code, issue.field) == ("service.draft", "If-Match")
    assert [item["title"] for item in client.drafts()] == ["Gewölbe ٣", "Greifer"]
    assert [item["kind"] for item in client.drafts("tool")] == ["tool"]
    ours = client.keep_draft({}, "swept")
    draft = (ours["id"], ours["version"])
    client.delete_draft(first["id"])
    assert [item["title"] for item in client.drafts()] == ["swept", "Greifer"]

    problem = small_problem.write(tmp_path)
    files = {"targets.csv": tmp_path / "targets.csv"}

    def swept(*values: float) -> list[str]:
        key = None if -1 in values else "sweep-1"
        return client.sweep(problem, "operations.0.feed_mm_s", values, "Vorschub ٣", files, key, draft)

    jobs = swept(20, 30.5)
    assert swept(20, 30.5) == jobs
    (told,) = client.drafts("draft")
    assert (told["sent"], told["job"]) == (1, jobs[0])
    assert sorted(item["id"] for item in client.jobs(tags=["vorschub ٣"])) == sorted(jobs)
    titles = [client.job(item)["title"].rpartition(": ")[2] for item in jobs]
    assert titles == ["operations.0.feed_mm_s = 20", "operations.0.feed_mm_s = 30.5"]
    (issue,) = refusal(lambda: swept(20, -1))
    assert issue.message.startswith("operations.0.feed_mm_s = -1: ")
    for item in jobs:
        client.cancel(item)

    address = client.look(jobs[0], 3600)
    with urllib.request.urlopen(address) as page:
        assert page.status == 200
    (made,) = client.looks(jobs[0])
    assert made["by"] == "ann"
    client.withdraw_look(jobs[0], made["id"])
    assert client.looks(jobs[0]) == []


def test_a_file_that_is_no_mesh_is_told(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    for text in (b"\xff", b"v 1 2", b"v 1 2 x", b"v 0 0 0\nf 1 a 1"):
        kind.answers = (200, {}, text)
        (issue,) = refusal(lambda: tandem_client.Client(url).meshes("a"))
        assert issue.code == "service.answer"
    kind.answers = (200, {}, b"v 9 9 9\nv 0 0 0\nv 1 0 0\no a b\nv 0 1 0\nf -1/1 2//4 3\n")
    assert tandem_client.Client(url).meshes("a") == {"a b": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [[2, 0, 1]])}


@pytest.mark.parametrize(
    ("problem", "files", "code"),
    [
        (5, {}, "problem.field"),
        ({"a": {1, 2}}, {}, "problem.field"),
        ({"a": "\ud800"}, {}, "problem.field"),
        ({"a": [1.0, float("inf")]}, {}, "problem.not_finite"),
        ({"a": Path("no such file")}, {}, "problem.missing_file"),
        ("no such file", {}, "problem.missing_file"),
        ({"file": ([[0, 0, 0]] * 3, [[0, 1, 2]])}, {}, "mesh.unit"),
        ({"file": ([[0, 0]] * 3, [[0, 1, 2]]), "unit": "mm"}, {}, "problem.field"),
        ({"file": ([[0, 0, 0]] * 3, [[0, 1]]), "unit": "mm"}, {}, "problem.field"),
        ({"file": ([[0, 0, 0]] * 3, [[-1, 1, 2]]), "unit": "mm"}, {}, "problem.field"),
        ({"file": ([[0, 0, 0]] * 3, [[0.5, 1, 2]]), "unit": "mm"}, {}, "problem.field"),
        ({"file": ([[0, 0, float("nan")]] * 3, [[0, 1, 2]]), "unit": "mm"}, {}, "problem.not_finite"),
        ({"file": ("abc",), "unit": "mm"}, {}, "problem.field"),
        ({}, {"a.obj": "text"}, "problem.field"),
        ({}, {"a.obj": Path("no such file")}, "problem.missing_file"),
    ],
)
def test_what_cannot_be_sent_is_told_before_it_is_sent(problem: Any, files: Any, code: str) -> None:
    for kind, error in (
        (tandem_client.Client, tandem_client.TandemError),
        (planner.Client, planner.TandemError),
    ):
        with pytest.raises(error) as caught:
            kind("http://127.0.0.1:1").submit(problem, files=files)
        assert [issue.code for issue in caught.value.issues] == [code]
        assert caught.value.issues[0].field


@pytest.mark.parametrize(
    ("key", "got"),
    [
        ("a\nb", r"got 'a\nb' of 3 characters"),
        ("a\n", r"got 'a\n' of 2 characters"),
        ("", "got '' of 0 characters"),
        ("wing 1", "got 'wing 1' of 6 characters"),
        ("flügel", "got 'flügel' of 6 characters"),
        ("k" * 256, f"got {'k' * 40!r} of 256 characters"),
        (b"wing", "got a bytes"),
    ],
)
def test_a_key_that_is_none_is_told_before_it_is_sent(key: Any, got: str) -> None:
    """By those that the service refuses; no service is there to ask."""
    if isinstance(key, str):
        with pytest.raises(RefusedError):
            idempotency.checked_header([key])
    for kind, error in (
        (tandem_client.Client, tandem_client.TandemError),
        (planner.Client, planner.TandemError),
    ):
        client = kind("http://127.0.0.1:1")
        for ask in (client.submit, client.divide, client.plan_panels):
            with pytest.raises(error) as caught:
                ask({} if ask != client.plan_panels else "e", key=key)
            (issue,) = caught.value.issues
            assert (issue.code, issue.field) == ("service.idempotency", "key")
            allowed = "1 to 255 printable ASCII characters without spaces"
            assert issue.message.startswith(f"key: {got}, allowed: {allowed}")


@pytest.mark.parametrize("key", ["!", "~" * 255, '"8e03978e-40d5-43dd-bc93-6894a57f9324"'])
def test_a_key_that_the_service_takes_goes_on(key: str) -> None:
    assert idempotency.checked_header([key]) == key
    (issue,) = refusal(lambda: tandem_client.Client("http://127.0.0.1:1").submit({}, key=key))
    assert issue.code == "service.answer"


def test_a_problem_that_holds_itself_is_told() -> None:
    problem: dict[str, Any] = {}
    problem["a"] = problem
    (issue,) = refusal(lambda: tandem_client.Client("http://127.0.0.1:1").submit(problem))
    assert issue.code == "problem.field"


def test_a_mesh_keeps_every_digit() -> None:
    vertices = np.array([[0.1, 1e-17, -3.0], [1 / 3, 0, 0], [0, 2e10, 0], [1, 1, 1]])
    faces = np.array([[0, 1, 2, 3]], dtype=np.uint32)
    text, files = tandem_client._bundle({"file": (vertices, faces), "unit": "m"}, {"1-mesh.obj": b""})
    assert json.loads(text) == {"file": "2-mesh.obj", "unit": "m"}
    lines = files["2-mesh.obj"].decode().splitlines()
    assert [[float(x) for x in line.split()[1:]] for line in lines[:4]] == vertices.tolist()
    assert lines[4:] == ["f 1 2 3 4"]


def refusal(call: Any) -> Any:
    with pytest.raises(tandem_client.TandemError) as caught:
        call()
    return caught.value.issues


class OddService(http.server.BaseHTTPRequestHandler):
    """A service that answers ``health`` and, for other requests, ``answers``. It records the requests."""

    health: bytes = b'{"status": "ok", "version": "9.0", "api": 3, "api_oldest": 1}'
    answers: tuple[int, dict[str, str], bytes] = (200, {}, b"{}")
    pause_s = 0.0
    requests: list[tuple[str, str | None]]

    def do_GET(self) -> None:
        self.requests.append((self.path, self.headers.get("Authorization")))
        status, headers, body = (200, {}, self.health) if self.path == "/v1/health" else self.answers
        if self.path != "/v1/health":
            time.sleep(self.pause_s)
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_POST = do_GET  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def odd_service() -> Iterator[tuple[type[OddService], str]]:
    kind = type("Some", (OddService,), {"requests": []})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), kind) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield kind, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def test_a_service_without_pages_of_drafts_gives_all_at_once(
    odd_service: tuple[type[OddService], str],
) -> None:
    kind, url = odd_service
    kind.health = b'{"status": "ok", "version": "9.0", "api": 13, "api_oldest": 1}'
    kind.answers = (200, {}, b'{"drafts": [{"id": "a"}]}')
    assert list(tandem_client.Client(url).drafts("cell")) == [{"id": "a"}]
    assert [path for path, _ in kind.requests if "health" not in path] == ["/v1/drafts?limit=1000&kind=cell"]
    (issue,) = refusal(lambda: tandem_client.Client(url).sweep({}, "a", [1], draft=("b", 1)))
    assert issue.code == "service.version"


def test_a_client_that_is_too_old_is_told(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    newer = {"status": "ok", "version": "9.0", "api": API + 2, "api_oldest": API + 1}
    kind.health = json.dumps(newer).encode()
    (issue,) = refusal(lambda: tandem_client.Client(url, "t").job("a"))
    assert issue.code == "service.version"
    assert "pip install --upgrade tandem-client" in issue.message
    assert [path for path, _ in kind.requests] == ["/v1/health"], "nothing was asked of it"
    kind.health = b'{"status": "ok", "version": "9.0", "api": 7, "api_oldest": 2}'
    assert tandem_client.Client(url).job("a") == {}


@pytest.mark.parametrize("health", [b'{"version": "9.0", "api": "x"}', b'{"version": 9}', b"[" * 100_000])
def test_what_answers_otherwise_than_any_tandem_is_told(
    odd_service: tuple[type[OddService], str], health: bytes
) -> None:
    """The first and the last broke off with an error of Python's own."""
    kind, url = odd_service
    kind.health = health
    (issue,) = refusal(lambda: tandem_client.Client(url).job("a"))
    assert issue.code == "service.answer" and url in issue.message


def test_a_service_that_is_too_old_is_told_where_it_matters(
    odd_service: tuple[type[OddService], str],
) -> None:
    kind, url = odd_service
    kind.health = b'{"status": "ok", "version": "0.1.0", "workers": 1, "queued": 0, "running": 0}'
    kind.answers = (200, {}, b'{"path": "/x"}')
    client = tandem_client.Client(url)
    client.job("a")
    for ask in (client.report_url, client.motion, client.element):
        (issue,) = refusal(lambda ask=ask: ask("a"))
        assert issue.code == "service.version"
        assert "Update the service" in issue.message
    kind.health = OddService.health  # it was updated
    assert client.report_url("a") == f"{url}/x"


def test_what_a_newer_service_says_besides_is_passed_over(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    said = {"code": "service.new", "message": "new", "severity": "error", "colour": "red", "field": "a"}
    kind.answers = (422, {}, json.dumps({"issues": [said]}).encode())
    (issue,) = refusal(lambda: tandem_client.Client(url).job("a"))
    assert (issue.code, issue.message, issue.field, issue.data["colour"]) == (
        "service.new",
        "new",
        "a",
        "red",
    )
    with pytest.raises(planner.TandemError) as caught:
        planner.Client(url).job("a")
    assert caught.value.issues == (Issue("service.answer", "[service.new] new", field="a"),)


def test_a_token_goes_to_no_other_address(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    kind.answers = (307, {"Location": "http://127.0.0.1:1/elsewhere"}, b"")
    for ask in (
        lambda: tandem_client.Client(url, "t").job("a"),
        lambda: tandem_client.Client(url, "t").cancel("a"),
    ):
        (issue,) = refusal(ask)
        assert issue.code == "service.answer"
        assert "http://127.0.0.1:1/elsewhere" in issue.message
    assert {token for _, token in kind.requests} == {"Bearer t"}


def test_a_token_is_sent_as_it_was_made(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    tandem_client.Client(url, " tandem_x\n").job("a/../b")
    assert kind.requests[-1] == ("/v1/jobs/a%2F..%2Fb", "Bearer tandem_x")
    for wrong in ("a\nb", "\u2013"):
        (issue,) = refusal(lambda wrong=wrong: tandem_client.Client(url, wrong))
        assert (issue.code, issue.field) == ("service.token", "token")


class Gateway(OddService):
    """A proxy before a service that is started anew: the first answers on each path are ``first``, a status,
    or 0 for a connection that breaks off."""

    health = b'{"status": "ok", "version": "9.0", "api": 16, "api_oldest": 1}'
    first: dict[str, list[int]]
    ended = False

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        left = self.first.get(path) or [200]
        status = left.pop(0)
        body = f'{{"id": "a", "state": "{"verified" if self.ended else "running"}"}}'.encode()
        if path.endswith("/events"):
            type(self).ended = status == 200
            body = b'id: 1\nevent: progress\ndata: {"stage": "plan", "fraction": 0.5}\n\n'
            body += b"id: 2\nevent: end\ndata: {}\n\n"
        if status == 503:
            body = b'{"issues": [{"code": "service.database", "message": "away"}]}'
        self.answers = status, {}, body if status in (200, 503) else b"<html>"
        if status:
            super().do_GET()

    do_POST = do_GET  # noqa: N815


@pytest.fixture
def gateway(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[type[Gateway], str]]:
    monkeypatch.setattr(tandem_client, "RETRY_S", 0.01)
    monkeypatch.setattr(tandem_client, "PAUSES_S", (0.01, 0.01, 0.01))
    kind = type("Some", (Gateway,), {"requests": [], "first": {}})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), kind) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield kind, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.parametrize("path", ["/v1/jobs/a/events", "/v1/jobs/a"])
def test_who_waits_goes_on_behind_a_proxy_while_the_service_is_away(
    gateway: tuple[type[Gateway], str], path: str
) -> None:
    kind, url = gateway
    kind.first = {path: [502, 503, 504, 0]}
    events: list[float] = []
    done = tandem_client.Client(url).wait(
        "a", lambda stage, fraction: events.append(fraction), timeout_s=20.0
    )
    assert (done["state"], events) == ("verified", [0.5])
    kind.first = {"/v1/jobs/a": [503] * 1000}
    (issue,) = refusal(lambda: tandem_client.Client(url).wait("a", timeout_s=0.3))
    assert issue.code == "service.timeout"
    (issue,) = refusal(lambda: tandem_client.Client(url).job("a"))
    assert issue.code == "service.database"


def test_what_makes_jobs_is_sent_again_behind_a_proxy(gateway: tuple[type[Gateway], str]) -> None:
    kind, url = gateway
    kind.first = {"/v1/jobs": [502, 503]}
    assert tandem_client.Client(url).submit(b"tandem: 1") == "a"
    kind.first = {"/v1/jobs": [502] * 9}
    (issue,) = refusal(lambda: tandem_client.Client(url).submit(b"tandem: 1"))
    assert issue.code == "service.answer" and len(kind.first["/v1/jobs"]) == 5


def test_proxies_are_named_and_passed_by_for_this_machine(
    gateway: tuple[type[Gateway], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("http_proxy", "http://ann:secret@127.0.0.1:9/")
    monkeypatch.delenv("no_proxy", raising=False)
    assert tandem_client.Client(gateway[1]).service()["version"] == "9.0"
    (issue,) = refusal(lambda: tandem_client.Client("http://plans.example.org").service())
    assert "through the proxy 127.0.0.1:9 " in issue.message and "no_proxy" in issue.message
    assert "secret" not in issue.message
    monkeypatch.setenv("no_proxy", "plans.example.org")
    assert (
        "proxy" not in refusal(lambda: tandem_client.Client("http://plans.example.org/").service())[0].message
    )


@pytest.mark.parametrize("url", ["http://[::1", "ftp://127.0.0.1", "127.0.0.1:8000", ""])
def test_what_is_no_address_is_told(url: str) -> None:
    (issue,) = refusal(lambda: tandem_client.Client(url))
    assert (issue.code, issue.field) == ("service.answer", "url")


def test_time_that_runs_out_is_told(odd_service: tuple[type[OddService], str]) -> None:
    kind, url = odd_service
    kind.pause_s = 2.0
    (issue,) = refusal(lambda: tandem_client.Client(url, timeout_s=0.2).job("a"))
    assert issue.code == "service.timeout"
    began = time.monotonic()
    (issue,) = refusal(lambda: tandem_client.Client(url).wait("a", timeout_s=0.3))
    assert issue.code == "service.timeout"
    assert "It continues" in issue.message
    assert time.monotonic() - began < 1.9, "a service that hangs does not hold whoever waits"


@pytest.mark.parametrize("body", [b"", b"[]", b"<html>", b"\xff", b'{"status": "up"}'])
def test_what_is_no_tandem_is_told(odd_service: tuple[type[OddService], str], body: bytes) -> None:
    kind, url = odd_service
    kind.health = body
    (issue,) = refusal(lambda: tandem_client.Client(url).job("a"))
    assert issue.code == "service.answer"


def test_a_service_that_is_away_is_told() -> None:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{one.getsockname()[1]}"
        for ask in ("service", "job", "wait", "report_url"):
            (issue,) = refusal(
                lambda ask=ask: getattr(tandem_client.Client(url), ask)(*[] if ask == "service" else "a")
            )
            assert (issue.code, issue.field) == ("service.answer", "url")
            assert url in str(issue)


def test_an_issue_reads_as_in_the_planner() -> None:
    for issue in (
        Issue("problem.field", "x", field="a", file="b", line=3, hint="c"),
        Issue("problem.field", "x"),
    ):
        assert str(tandem_client.Issue.from_dict(issue.to_dict())) == str(issue)


def test_it_runs_without_the_planner() -> None:
    """Imported alone it brings nothing of this package."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); import tandem_client; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code, str(FOLDER)], capture_output=True, text=True, check=True
    )
    assert not {"planner", "numpy", "fcntl", "zipfile"} & set(done.stdout.split())
