"""Remedies for requests: the advice of each refusal is followed literally, and the next answer is good."""

from __future__ import annotations

import dataclasses
import gzip
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest

from planner.service.security import ServiceLimits
from tests import small_problem
from tests.service.support import TABLE, InProcess, named_problem

MESH: Final = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
FACETS: Final = 30


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    limits = ServiceLimits(upload_mb=2, mesh_mb=0.5, mesh_facets=FACETS, check_s=60, files=5)
    with InProcess(tmp_path_factory.mktemp("remedies") / "data", limits, examiners=1) as made:
        yield made


@dataclasses.dataclass(frozen=True)
class RequestSpec:
    """A request; ``files``: rows of field, name and content."""

    path: str
    method: str = "GET"
    files: tuple[tuple[str, str, bytes], ...] = ()
    content: bytes = b""
    kind: str | None = None

    def send(self, running_service: InProcess) -> Any:
        """The answer."""
        own = {"Content-Type": self.kind} if self.kind else {}
        files = [(field, (name, content)) for field, name, content in self.files] or None
        return running_service.http.request(
            self.method, self.path, files=files, content=self.content or None, headers=own
        )


def post(*files: tuple[str, str, bytes], problem: str = "problem", text: str = "") -> RequestSpec:
    """Return the request for a job with these files beside its problem."""
    own = (problem, "p.yaml", (text or small_problem.PROBLEM).encode())
    return RequestSpec("/v1/jobs", "POST", (own, *files))


def wall(facets: int) -> RequestSpec:
    """Return the request for a job with an obstacle of the given number of facets."""
    body = "obstacles: [{name: wall, shapes: [{kind: mesh, file: wall.obj, unit: mm}]}]"
    text = small_problem.PROBLEM.replace("stock:", f"  {body}\nstock:")
    mesh = MESH + "".join(f"v {x} {y} {x * y}\n" for x in range(9) for y in range(9))
    faces = [f"f {9 * x + y + 4} {9 * x + y + 5} {9 * x + y + 13}\n" for x in range(8) for y in range(8)]
    return post(CSV, ("files", "wall.obj", (mesh + "".join(faces[:facets])).encode()), text=text)


Next = Callable[[InProcess, Mapping[str, Any]], RequestSpec]
"""What an issue advises, as the next request."""


def match_issue_text(pattern: str, words: Mapping[str, Any]) -> str:
    match = re.search(pattern, f"{words['message']}; {words.get('hint', '')}")
    assert match is not None, words
    return match[1]


def listed_job(running_service: InProcess) -> str:
    """A job that the list of jobs has."""
    if not (known := running_service.http.get("/v1/jobs").json()["jobs"]):
        assert running_service.post().status_code == 201
        known = running_service.http.get("/v1/jobs").json()["jobs"]
    return str(known[0]["id"])


def first_file_url(running_service: InProcess) -> str:
    job = listed_job(running_service)
    return (
        f"/v1/jobs/{job}/files/{running_service.http.get(f'/v1/jobs/{job}/files').json()['files'][0]['name']}"
    )


def follow_description(running_service: InProcess, words: Mapping[str, Any]) -> RequestSpec:
    """An address of the description that the issue points to."""
    paths = running_service.http.get(match_issue_text(r"See (/[\w.]*\w)", words)).json()["paths"]
    return RequestSpec(next(path for path in paths if "processes" in path and "{" not in path))


KNOWN: Final = r"allowed (\w+)"
CSV: Final = ("files", "targets.csv", TABLE)
NOBODY: Final = f"/v1/jobs/{'0' * 32}"
ROWS: Final[Mapping[str, tuple[str, Callable[[InProcess], RequestSpec], Next]]] = {
    "an unknown field": (
        "service.request",
        lambda here: post(("fils", "targets.csv", TABLE)),
        lambda here, words: post((match_issue_text(r"allowed \w+, (\w+)", words), "targets.csv", TABLE)),
    ),
    "no problem": (
        "service.request",
        lambda here: RequestSpec("/v1/jobs", "POST", (CSV,)),
        lambda here, words: post(CSV, problem=match_issue_text(r"Add the (\w+) file", words)),
    ),
    "an unknown type": (
        "service.request",
        lambda here: RequestSpec("/v1/check", "POST", content=b"a: 1", kind="text/plain"),
        lambda here, words: dataclasses.replace(post(CSV), path="/v1/check"),
    ),
    "a page too long": (
        "service.request",
        lambda here: RequestSpec("/v1/jobs?limit=1000"),
        lambda here, words: RequestSpec(
            "/v1/jobs?limit=" + match_issue_text(r"less than or equal to (\d+)", words)
        ),
    ),
    "an unknown address": ("service.not_found", lambda here: RequestSpec("/v1/proceses"), follow_description),
    "an unknown method": (
        "service.not_found",
        lambda here: RequestSpec("/v1/processes", "PATCH"),
        lambda here, words: RequestSpec("/v1/processes", match_issue_text(r"allowed (\w+)", words)),
    ),
    "an unknown process": (
        "service.not_found",
        lambda here: RequestSpec("/v1/processes/knitting/schema"),
        lambda here, words: RequestSpec(f"/v1/processes/{match_issue_text(KNOWN, words)}/schema"),
    ),
    "an unknown page": (
        "service.not_found",
        lambda here: RequestSpec("/ui/nothing"),
        lambda here, words: RequestSpec(match_issue_text(r"Start at (/)", words)),
    ),
    "an unknown job": (
        "service.unknown_job",
        lambda here: RequestSpec(NOBODY),
        lambda here, words: RequestSpec(f"/v1/jobs/{listed_job(here)}"),
    ),
    "an unknown file": (
        "service.unknown_file",
        lambda here: RequestSpec(f"/v1/jobs/{listed_job(here)}/files/plan.xml"),
        lambda here, words: RequestSpec(first_file_url(here)),
    ),
    "a file that did not come": (
        "service.not_uploaded",
        lambda here: post(),
        lambda here, words: post(("files", match_issue_text(r"got '(.*?)'", words), TABLE)),
    ),
    "two files of one last step": (
        "service.not_uploaded",
        lambda here: post(("files", "a/targets.csv", TABLE), ("files", "b/targets.csv", b"x")),
        lambda here, words: post(
            ("files", match_issue_text(r"got '(.*?)'", words), TABLE), ("files", "b/targets.csv", b"x")
        ),
    ),
    "a name too long": (
        "service.file_name",
        lambda here: post(CSV, ("files", "x" * 300, b"1")),
        lambda here, words: post(
            CSV, ("files", "x" * int(match_issue_text(r"allowed 1 to (\d+)", words)), b"1")
        ),
    ),
    "one name twice": (
        "service.file_name",
        lambda here: post(CSV, CSV),
        lambda here, words: post(CSV, ("files", "other.csv", TABLE)),
    ),
    "an archive": (
        "service.archive",
        lambda here: post(("files", "targets.csv", gzip.compress(TABLE))),
        lambda here, words: post(("files", "targets.csv", TABLE)),
    ),
    "too many facets": (
        "service.too_large",
        lambda here: wall(60),
        lambda here, words: wall(int(match_issue_text(r"allowed (\d+)", words))),
    ),
    "too large a mesh": (
        "service.too_large",
        lambda here: post(CSV, ("files", "wall.stl", b"x" * 600_000)),
        lambda here, words: post(
            CSV, ("files", "wall.stl", b"x" * int(1e6 * float(match_issue_text(r"allowed (\S+) MB", words))))
        ),
    ),
}


@pytest.mark.parametrize("row", ROWS)
def test_what_an_answer_advises_makes_a_good_one(row: str, running_service: InProcess) -> None:
    code, ask, following = ROWS[row]
    refused = ask(running_service).send(running_service)
    assert refused.status_code >= 400
    own = [issue for issue in refused.json()["issues"] if issue["code"] == code]
    assert own, refused.text
    done = following(running_service, own[0]).send(running_service)
    assert done.status_code < 400, done.text


def test_programs_are_there_when_the_job_has_ended(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        running_service.team.hold.set()
        job = running_service.post(named_problem("waits")).json()["id"]
        (refused,) = running_service.http.get(f"/v1/jobs/{job}/programs.zip").json()["issues"]
        assert refused["code"] == "service.unknown_file"
        assert "Try again when it has ended" in refused["message"]
        running_service.team.hold.clear()
        running_service.wait_for_end(job)
        assert running_service.http.get(f"/v1/jobs/{job}/programs.zip").status_code == 200
