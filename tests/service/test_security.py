"""Who may ask, from where, and what may be sent: every refusal with its code."""

from __future__ import annotations

import builtins
import gzip
import hashlib
import io
import struct
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from planner import service_commands
from planner.issues import TandemError
from planner.service.auth import Auth
from planner.service.database import Database, default_url
from planner.service.limits import Limits
from planner.service.service import Options, Service
from tests import small_problem
from tests.service.support import HERE, InProcess, Team, named

PLY = "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty float x\nproperty float y\n"
PLY += "property float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    limits = Limits(upload_mb=2, mesh_mb=0.5, check_s=60, files=5)
    with InProcess(tmp_path_factory.mktemp("open") / "data", limits, examiners=1) as made:
        yield made


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str, str]]:
    """A service that asks for tokens, and two of them."""
    data = tmp_path_factory.mktemp("closed") / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.make("ann"), auth.make("bob")
    with InProcess(data, Limits(check_s=60), examiners=1, require_token=True) as made:
        yield made, *tokens


def codes(answer: Any) -> list[tuple[str, str | None]]:
    return [(issue["code"], issue.get("field")) for issue in answer.json()["issues"]]


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def with_mesh(name: str) -> str:
    """The small problem with an obstacle from a mesh file."""
    body = f"obstacles: [{{name: wall, shapes: [{{kind: mesh, file: {name}, unit: mm}}]}}]"
    return small_problem.PROBLEM.replace("stock:", f"  {body}\nstock:")


def test_without_a_token_nothing_but_health_is_told(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    for path in ("/v1/jobs", "/v1/catalogue/robots", "/metrics", "/v1/schema", f"/v1/jobs/{'0' * 32}"):
        answer = here.http.get(path)
        assert answer.status_code == 401, path
        assert codes(answer) == [("service.token", "Authorization")]
        assert answer.headers["www-authenticate"] == "Bearer"
    assert here.post().status_code == 401
    assert here.http.get("/v1/health").status_code == 200
    assert here.http.get("/v1/jobs", headers=bearer(ann)).status_code == 200


@pytest.mark.parametrize(
    "change", [lambda t: t[:-1] + "!", lambda t: t[:-2] + "AA", lambda t: "", lambda t: "é"]
)
def test_wrong_tokens_are_401(closed: tuple[InProcess, str, str], change: Any) -> None:
    here, ann, _ = closed
    header = f"Bearer {change(ann)}".encode("latin-1")
    answer = here.http.get("/v1/jobs", headers={"Authorization": header})
    assert answer.status_code == 401


def test_tokens_are_hashed_at_rest(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    kept = b"".join(path.read_bytes() for path in here.service.options.data.glob("tandem.db*"))
    assert ann.encode() not in kept
    assert ann.rsplit("_", 1)[1].encode() not in kept
    assert hashlib.sha256(ann.encode()).hexdigest().encode() in kept


def test_jobs_of_others_are_403_and_not_listed(closed: tuple[InProcess, str, str]) -> None:
    here, ann, bob = closed
    job = here.post(named("mine"), headers=bearer(ann)).json()["id"]
    here.ended(job, headers=bearer(ann))
    for method, path in (
        ("GET", ""),
        ("GET", "/events"),
        ("GET", "/files"),
        ("GET", "/files/report.html"),
        ("GET", "/programs.zip"),
        ("POST", "/cancel"),
        ("DELETE", ""),
    ):
        answer = here.http.request(method, f"/v1/jobs/{job}{path}", headers=bearer(bob))
        assert answer.status_code == 403, path
        assert codes(answer) == [("service.foreign", None)]
    assert not here.http.get("/v1/jobs", headers=bearer(bob)).json()["jobs"]
    later = f"/v1/jobs?cursor=99999999999.0-{job}"
    assert here.http.get(later, headers=bearer(bob)).json()["jobs"] == []


def test_a_revoked_token_ends_at_once_with_its_sessions(closed: tuple[InProcess, str, str]) -> None:
    here, _, _ = closed
    eve = here.service.auth.make("eve")
    browser = TestClient(here.http.app, base_url=HERE)
    logged_in = browser.post("/v1/session", headers=bearer(eve))
    assert logged_in.status_code == 204
    cookie = logged_in.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert browser.get("/v1/jobs").status_code == 200
    here.service.auth.revoke("eve")
    assert browser.get("/v1/jobs").status_code == 401
    assert here.http.get("/v1/jobs", headers=bearer(eve)).status_code == 401


def test_a_session_ends_when_the_browser_logs_out(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    browser = TestClient(here.http.app, base_url=HERE)
    browser.post("/v1/session", headers=bearer(ann))
    cookie = browser.cookies["tandem_session"]
    assert browser.delete("/v1/session").status_code == 204
    browser.cookies.set("tandem_session", cookie)
    assert browser.get("/v1/jobs").status_code == 401


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Host": "evil.example"},
        {"X-Forwarded-For": "10.0.0.1"},
    ],
)
def test_other_sites_cannot_ask_through_a_browser(here: InProcess, headers: dict[str, str]) -> None:
    answer = here.post(headers=headers)
    assert answer.status_code == 403
    assert codes(answer) == [("service.foreign", None)]


def test_no_other_origin_may_read(here: InProcess) -> None:
    answer = here.http.get("/v1/jobs", headers={"Origin": "https://evil.example"})
    assert "access-control-allow-origin" not in answer.headers


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "::"])
def test_off_loopback_a_token_must_exist(tmp_path: Path, host: str) -> None:
    with pytest.raises(TandemError) as caught:
        Service(Options(data=tmp_path / "data", host=host), Team)
    (issue,) = caught.value.issues
    assert issue.code == "service.start"
    assert "tandem token add" in str(issue.hint)


def test_one_data_folder_has_one_service(here: InProcess) -> None:
    with pytest.raises(TandemError) as caught:
        Service(Options(data=here.service.options.data), Team)
    assert caught.value.issues[0].code == "service.start"


@pytest.mark.parametrize("url", ["mysql://a/b", "no url", "postgresql://u:secret@127.0.0.1:1/none"])
def test_a_database_that_cannot_be_opened_is_told_without_its_password(url: str) -> None:
    with pytest.raises(TandemError) as caught:
        Database(url)
    assert caught.value.issues[0].code == "service.database"
    assert "secret" not in str(caught.value)


def test_what_is_not_installed_is_told_with_the_install_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.startswith("planner.service."):
            raise ImportError("no", name="sqlalchemy")
        return usual(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    for ask in (
        lambda: service_commands.serve(service_commands.Serve(data=tmp_path)),
        lambda: service_commands.token(service_commands.List(data=tmp_path)),
    ):
        with pytest.raises(TandemError) as caught:
            ask()
        assert caught.value.issues[0].code == "service.install"
        assert "tandem-planner[service]" in str(caught.value.issues[0].hint)


def test_tokens_are_made_listed_and_revoked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    service_commands.token(service_commands.Add("ann", tmp_path))
    token = capsys.readouterr().out.strip()
    auth = Auth(Database(default_url(tmp_path)))
    assert auth.owner(token)
    for wrong in ("ann", "", "a b", "x" * 65):
        with pytest.raises(TandemError) as caught:
            service_commands.token(service_commands.Add(wrong, tmp_path))
        assert caught.value.issues[0].code == "service.token"
    service_commands.token(service_commands.Revoke("ann", tmp_path))
    assert not auth.any()
    service_commands.token(service_commands.List(tmp_path))
    assert "ann" in capsys.readouterr().out


def test_too_much_is_413_said_or_not(here: InProcess) -> None:
    big = b"x" * 2_100_000
    answer = here.http.post("/v1/jobs", files=[("problem", ("p.yaml", "a: 1")), ("files", ("t.csv", big))])
    assert answer.status_code == 413
    assert codes(answer) == [("service.too_large", None)]

    def chunks() -> Iterator[bytes]:  # no Content-Length
        yield b'--b\r\nContent-Disposition: form-data; name="files"; filename="t.csv"\r\n\r\n'
        for _ in range(40):
            yield b"x" * 65536

    kind = {"Content-Type": "multipart/form-data; boundary=b"}
    answer = here.http.post("/v1/jobs", content=chunks(), headers=kind)
    assert answer.status_code == 413
    mesh = [("problem", ("p.yaml", "a: 1")), ("files", ("wall.STL", b"x" * 600_000))]
    assert codes(here.http.post("/v1/jobs", files=mesh)) == [("service.too_large", "files.0")]
    assert not list((here.service.options.data / "files" / "incoming").iterdir())


def archives() -> Iterator[tuple[str, bytes]]:
    zipped, tarred = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.writestr("../../escape", "x")
    with tarfile.open(fileobj=tarred, mode="w") as tar:
        tar.addfile(tarfile.TarInfo("/etc/escape"), io.BytesIO(b""))
    yield "targets.csv", zipped.getvalue()
    yield "targets.csv", tarred.getvalue()
    yield "targets.csv", gzip.compress(b"x")


@pytest.mark.parametrize(("name", "content"), list(archives()), ids=["zip", "tar", "gzip"])
def test_archives_are_refused_whatever_they_are_called(here: InProcess, name: str, content: bytes) -> None:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", (name, content))]
    answer = here.http.post("/v1/jobs", files=files)
    assert answer.status_code == 422
    assert codes(answer) == [("service.archive", "files")]


@pytest.mark.parametrize(
    "path",
    [
        "/etc/passwd",
        "../../../../etc/passwd",
        "file:///etc/passwd",
        "..\\\\..\\\\secret",
        ".",
        "",
        "a\\0b",
        "~/.ssh/id",
    ],
)
def test_a_problem_names_no_file_outside_its_upload(here: InProcess, path: str) -> None:
    whole = small_problem.PROBLEM
    cell = whole[whole.index("cell:") : whole.index("stock:")]
    for text in (
        whole.replace("file: targets.csv", f'file: "{path}"'),
        whole.replace(cell, f'cell: "{path}"\n'),
        with_mesh(f'"{path}"'),
    ):
        answer = here.post(text)
        assert answer.status_code == 422
        assert "service.not_uploaded" in [code for code, _ in codes(answer)]
        assert "root:" not in answer.text


def test_an_upload_whose_name_is_a_path_is_found_by_its_last_step(here: InProcess) -> None:
    files = [
        ("problem", ("../../etc/p.yaml", named("steps").replace("targets.csv", "../tables/targets.csv"))),
        ("files", ("C:\\work\\targets.csv", "\n".join([small_problem.COLUMNS, *small_problem.ROWS]))),
    ]
    answer = here.http.post("/v1/jobs", files=files)
    assert answer.status_code == 201, answer.text
    names = [one["name"] for one in here.http.get(f"/v1/jobs/{answer.json()['id']}/files").json()["files"]]
    assert all(".." not in name and "\\" not in name for name in names)


def test_bad_names_of_files_are_told(here: InProcess) -> None:
    table = b"1"
    files = [
        ("problem", ("p.yaml", "a: 1")),
        *(("files", (name, table)) for name in ("a", "a", "x" * 300, "b/")),
    ]
    assert codes(here.http.post("/v1/jobs", files=files)) == [
        ("service.file_name", "files.1"),
        ("service.file_name", "files.2"),
        ("service.file_name", "files.3"),
    ]


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)
)


@pytest.mark.parametrize(
    "text",
    [
        BOMB,
        "[" * 100_000,
        "{a: " * 5000 + "1" + "}" * 5000,
        "&a [*a]",
        "a: !!python/object/apply:os.system ['true']",
        "tandem: 1\n? [1]\n: 2",
        "\x00",
        "\ud83d".encode("utf-16-le", "surrogatepass").decode("latin-1"),
        "a: " + "9" * 10_000,
        "- 1",
        "",
    ],
    ids=["aliases", "deep", "deep maps", "loop", "object", "key", "zero", "latin", "number", "list", "empty"],
)
def test_hostile_yaml_is_422_with_issues(here: InProcess, text: str) -> None:
    answer = here.post(text)
    assert answer.status_code == 422
    assert answer.json()["issues"]


def cube(facets: int, value: float) -> bytes:
    return b"\0" * 80 + struct.pack("<I", facets) + struct.pack("<12fH", *([value] * 12), 0)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("wall.stl", cube(1, float("nan"))),
        ("wall.stl", cube(2**32 - 1, 1.0)),
        ("wall.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 1e999 0 0\n" * 3),
        ("wall.ply", PLY.format(n=2**40, m=1).encode() + b"\0" * 64),
        ("wall.ply", PLY.format(n=-1, m=-1).encode()),
        ("wall.ply", PLY.format(n=3, m=1).encode() + struct.pack("<9fB3i", *range(9), 3, 7, 8, 9)),
        ("wall.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\n"),
        ("wall.obj", b"mtllib /etc/passwd\nv 0 0 0\nf 1 1 1\n"),
        ("wall.obj", b""),
        ("wall.exe", b"MZ"),
    ],
    ids=["nan", "count", "infinite", "huge", "negative", "index", "obj index", "material", "empty", "kind"],
)
def test_hostile_meshes_are_422_with_issues(here: InProcess, name: str, content: bytes) -> None:
    table = "\n".join([small_problem.COLUMNS, *small_problem.ROWS])
    files = [
        ("problem", ("p.yaml", with_mesh(name))),
        ("files", (name, content)),
        ("files", ("targets.csv", table)),
    ]
    answer = here.http.post("/v1/jobs", files=files)
    assert answer.status_code == 422
    assert answer.json()["issues"]
    assert str(here.service.options.data) not in answer.text


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("multipart/form-data", b"x"),
        ("multipart/form-data; boundary=b", b"x"),
        (
            "multipart/form-data; boundary=b",
            b'--b\r\nContent-Disposition: form-data; name="problem"\r\n\r\nx',
        ),
        (
            "multipart/form-data; boundary=b; charset=hex",
            b'--b\r\nContent-Disposition: form-data; name="a"\r\n\r\n',
        ),
        ("text/plain", b"x"),
        ("application/json", b"\xff"),
        ("application/json", b""),
    ],
)
def test_malformed_bodies_are_422_with_issues(here: InProcess, kind: str, body: bytes) -> None:
    answer = here.http.post("/v1/jobs", content=body, headers={"Content-Type": kind})
    assert answer.status_code == 422
    assert answer.json()["issues"]


def test_reading_that_takes_too_long_or_too_much_is_422(tmp_path: Path) -> None:
    slow = "tandem: 1\na: [" + "x, " * 400_000 + "x]"
    with InProcess(tmp_path / "data", Limits(check_s=0.5), examiners=1) as here:
        answer = here.post(slow)
        assert (answer.status_code, codes(answer)) == (422, [("service.check_stopped", "problem")])
        assert "0.5 s" in answer.text
    with InProcess(tmp_path / "more", Limits(check_memory_mb=200), examiners=1) as here:
        assert codes(here.post(named("memory"))) == [("service.check_stopped", "problem")]
