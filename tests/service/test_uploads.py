"""What may be uploaded: hostile files, names and bodies are refused with their code and field."""

from __future__ import annotations

import gzip
import http.client
import io
import json
import struct
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.service import tandem_client
from planner.service.models import Database, default_url
from planner.service.security import Auth, ServiceLimits
from tests import small_problem
from tests.service.support import InProcess, Process, issue_codes, named_problem

PLY = "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty float x\nproperty float y\n"
PLY += "property float z\nelement face {m}\nproperty list uchar int vertex_indices\nend_header\n"


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    limits = ServiceLimits(upload_mb=2, mesh_mb=0.5, check_s=60, files=5)
    with InProcess(tmp_path_factory.mktemp("open") / "data", limits, examiners=1) as made:
        yield made


def with_mesh(name: str) -> str:
    """The small problem with an obstacle from a mesh file."""
    body = f"obstacles: [{{name: wall, shapes: [{{kind: mesh, file: {name}, unit: mm}}]}}]"
    return small_problem.PROBLEM.replace("stock:", f"  {body}\nstock:")


def test_too_much_is_413_said_or_not(running_service: InProcess) -> None:
    big = b"x" * 2_100_000
    answer = running_service.http.post(
        "/v1/jobs", files=[("problem", ("p.yaml", "a: 1")), ("files", ("t.csv", big))]
    )
    assert answer.status_code == 413
    assert issue_codes(answer) == [("service.too_large", None)]

    def chunks() -> Iterator[bytes]:  # no Content-Length
        yield b'--b\r\nContent-Disposition: form-data; name="files"; filename="t.csv"\r\n\r\n'
        for _ in range(40):
            yield b"x" * 65536

    kind = {"Content-Type": "multipart/form-data; boundary=b"}
    answer = running_service.http.post("/v1/jobs", content=chunks(), headers=kind)
    assert answer.status_code == 413
    mesh = [("problem", ("p.yaml", "a: 1")), ("files", ("wall.STL", b"x" * 600_000))]
    assert issue_codes(running_service.http.post("/v1/jobs", files=mesh)) == [
        ("service.too_large", "files.0")
    ]
    assert not list((running_service.service.options.data / "files" / "incoming").iterdir())


def test_who_still_sends_sees_why_it_was_refused(tmp_path: Path) -> None:
    """Of a body of 30 MB a connection holds a few; one that is closed on the rest is reset."""
    data = tmp_path / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).create_token("ann")
    process = Process(data, "--upload-mb", "20", "--require-token").wait()
    good = {"Content-Type": "application/yaml", "Authorization": f"Bearer {token}"}
    large = (413, "service.too_large")
    cases = [
        (False, 30, {}, large),
        (True, 30, {}, large),  # its length is not said
        (False, 18, {"Authorization": "Bearer none"}, (401, "service.token")),
        (False, 18, {"Origin": "https://evil.example"}, (403, "service.foreign")),
    ]
    try:
        for chunked, mb, more, expected in cases * 3:
            body = b"x" * (mb * 1_000_000)
            chunks = (body[at : at + 65536] for at in range(0, len(body), 65536))
            link = http.client.HTTPConnection("127.0.0.1", process.port, timeout=60)
            sent = chunks if chunked else body
            link.request("POST", "/v1/jobs", sent, {**good, **more}, encode_chunked=chunked)
            answer = link.getresponse()
            assert (answer.status, json.loads(answer.read())["issues"][0]["code"]) == expected, (mb, more)
            link.close()
        before = process.log.read_text().count('"POST /v1/jobs')
        client = tandem_client.Client(process.url, token)
        with pytest.raises(tandem_client.TandemError) as error:
            client.submit({"tandem": 1, "name": "big"}, files={"big.obj": b"x" * 30_000_000})
        assert error.value.issues[0].code == "service.too_large"
        assert process.log.read_text().count('"POST /v1/jobs') == before + 1  # the client sent it once
    finally:
        process.stop()


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
def test_archives_are_refused_whatever_they_are_called(
    running_service: InProcess, name: str, content: bytes
) -> None:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", (name, content))]
    answer = running_service.http.post("/v1/jobs", files=files)
    assert answer.status_code == 422
    assert issue_codes(answer) == [("service.archive", "files")]


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
def test_a_problem_names_no_file_outside_its_upload(running_service: InProcess, path: str) -> None:
    whole = small_problem.PROBLEM
    cell = whole[whole.index("cell:") : whole.index("stock:")]
    for text in (
        whole.replace("file: targets.csv", f'file: "{path}"'),
        whole.replace(cell, f'cell: "{path}"\n'),
        with_mesh(f'"{path}"'),
    ):
        answer = running_service.post(text)
        assert answer.status_code == 422
        assert "service.not_uploaded" in [code for code, _ in issue_codes(answer)]
        assert "root:" not in answer.text


def test_an_upload_whose_name_is_a_path_is_found_by_its_last_step(running_service: InProcess) -> None:
    files = [
        (
            "problem",
            ("../../etc/p.yaml", named_problem("steps").replace("targets.csv", "../tables/targets.csv")),
        ),
        ("files", ("C:\\work\\targets.csv", "\n".join([small_problem.COLUMNS, *small_problem.ROWS]))),
    ]
    answer = running_service.http.post("/v1/jobs", files=files)
    assert answer.status_code == 201, answer.text
    names = [
        file["name"]
        for file in running_service.http.get(f"/v1/jobs/{answer.json()['id']}/files").json()["files"]
    ]
    assert all(".." not in name and "\\" not in name for name in names)


def test_bad_names_of_files_are_told(running_service: InProcess) -> None:
    table = b"1"
    files = [
        ("problem", ("p.yaml", "a: 1")),
        *(("files", (name, table)) for name in ("a", "a", "x" * 300, "b/")),
    ]
    assert issue_codes(running_service.http.post("/v1/jobs", files=files)) == [
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
def test_hostile_yaml_is_422_with_issues(running_service: InProcess, text: str) -> None:
    answer = running_service.post(text)
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
def test_hostile_meshes_are_422_with_issues(running_service: InProcess, name: str, content: bytes) -> None:
    table = "\n".join([small_problem.COLUMNS, *small_problem.ROWS])
    files = [
        ("problem", ("p.yaml", with_mesh(name))),
        ("files", (name, content)),
        ("files", ("targets.csv", table)),
    ]
    answer = running_service.http.post("/v1/jobs", files=files)
    assert answer.status_code == 422
    assert answer.json()["issues"]
    assert str(running_service.service.options.data) not in answer.text


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
def test_malformed_bodies_are_422_with_issues(running_service: InProcess, kind: str, body: bytes) -> None:
    answer = running_service.http.post("/v1/jobs", content=body, headers={"Content-Type": kind})
    assert answer.status_code == 422
    assert answer.json()["issues"]


def test_reading_that_takes_too_long_or_too_much_is_422(tmp_path: Path) -> None:
    large = "tandem: 1\na: [" + "x, " * 400_000 + "x]"
    with InProcess(tmp_path / "data", ServiceLimits(check_s=0.5), examiners=1) as running_service:
        assert issue_codes(answer := running_service.post(large)) == [("service.check_stopped", "problem")]
        assert answer.status_code == 422 and "0.5 s" in answer.text
    with InProcess(tmp_path / "more", ServiceLimits(check_memory_mb=500), examiners=1) as running_service:
        assert issue_codes(answer := running_service.post(large)) == [("service.check_stopped", "problem")]
        assert answer.status_code == 422 and "500 MB" in answer.text
        assert running_service.post(named_problem("after")).status_code == 201
