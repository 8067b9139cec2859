"""Links to files of jobs: what they open, and every attempt to make one open something else."""

from __future__ import annotations

import datetime as dt
import hashlib
import hmac
import json
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from fastapi.testclient import TestClient

from planner.service import links
from planner.service.models import Database, default_url
from planner.service.security import Auth, ServiceLimits
from planner.service.service import Options, Service
from tests.service import postgres
from tests.service.support import BASE_URL, FakeTeam, InProcess, Process, issue_codes, named_problem


@pytest.fixture(scope="module")
def closed_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str, str]]:
    """A service that requires tokens, and the tokens of ann and bob."""
    data = tmp_path_factory.mktemp("links") / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.create_token("ann"), auth.create_token("bob")
    with InProcess(data, ServiceLimits(check_s=60), examiners=1, require_token=True) as running_service:
        yield running_service, *tokens


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def finished_job(running_service: InProcess, name: str, token: str) -> str:
    """A job of the token that has ended."""
    job = str(running_service.post(named_problem(name), headers=bearer(token)).json()["id"])
    assert running_service.wait_for_end(job, headers=bearer(token))["state"] == "verified"
    return job


def link(
    running_service: InProcess, job: str, token: str, name: str = "report.html", seconds: int = 60
) -> str:
    answer = running_service.http.post(
        f"/v1/jobs/{job}/links", params={"name": name, "seconds": seconds}, headers=bearer(token)
    )
    assert answer.status_code == 200, answer.text
    return str(answer.json()["path"])


def stranger(running_service: InProcess) -> TestClient:
    """A browser without token or cookie."""
    return TestClient(running_service.http.app, base_url=BASE_URL)


def require_refused(running_service: InProcess, path: str) -> None:
    answer = stranger(running_service).get(path)
    assert answer.status_code == 403, (path, answer.text)
    assert issue_codes(answer) == [("service.link", "signature")]


def test_a_link_opens_its_file_without_a_token(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "opened", ann)
    path = link(running_service, job, ann)
    answer = stranger(running_service).get(path)
    assert answer.status_code == 200
    assert answer.text == "<script>1</script>"
    assert "sandbox" in answer.headers["content-security-policy"]
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert (
        stranger(running_service)
        .get(f"{path}&download=true")
        .headers["content-disposition"]
        .startswith("attachment")
    )
    program = link(running_service, job, ann, "programs/main.mod")
    assert stranger(running_service).get(program).text == "MODULE main"
    assert stranger(running_service).get(path.split("?")[0]).status_code == 401


def test_a_link_says_when_it_ends(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "ends", ann)
    answer = running_service.http.post(
        f"/v1/jobs/{job}/links?name=report.html&seconds=90", headers=bearer(ann)
    ).json()
    (said,) = parse_qs(urlsplit(answer["path"]).query)["expires"]
    assert dt.datetime.fromisoformat(answer["expires"]).timestamp() == int(said)
    assert 80 < int(said) - time.time() <= 90


@pytest.mark.parametrize("query", ["name=report.html&seconds=0", "name=report.html&seconds=86401", ""])
def test_links_that_cannot_be_had_are_422(closed_service: tuple[InProcess, str, str], query: str) -> None:
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "wrong", ann)
    assert running_service.http.post(f"/v1/jobs/{job}/links?{query}", headers=bearer(ann)).status_code == 422


def test_a_link_is_over_at_its_end(
    closed_service: tuple[InProcess, str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "over", ann)
    path = link(running_service, job, ann, seconds=60)
    later = time.time() + 61
    monkeypatch.setattr(links.time, "time", lambda: later)
    require_refused(running_service, path)
    assert "has expired" in stranger(running_service).get(path).text


def test_only_the_owner_gets_a_link(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, bob = closed_service
    job = finished_job(running_service, "owned", ann)
    url = f"/v1/jobs/{job}/links?name=report.html"
    answer = running_service.http.post(url, headers=bearer(bob))
    assert answer.status_code == 404
    assert issue_codes(answer) == [("service.unknown_job", None)]
    assert stranger(running_service).post(url).status_code == 401
    (query,) = [urlsplit(link(running_service, job, ann)).query]
    assert stranger(running_service).post(f"{url}&{query}").status_code == 401, (
        "a link makes no further links"
    )
    for unknown in ("replay.html", "../../service.lock", "", "report.html/"):
        answer = running_service.http.post(
            f"/v1/jobs/{job}/links", params={"name": unknown}, headers=bearer(ann)
        )
        assert answer.status_code == 404, unknown
        assert issue_codes(answer) == [("service.unknown_file", "name")]


def test_a_changed_link_opens_nothing(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, bob = closed_service
    mine, other, bobs = (
        finished_job(running_service, "mine", ann),
        finished_job(running_service, "other", ann),
        finished_job(running_service, "bobs", bob),
    )
    path, query = link(running_service, mine, ann).split("?")
    expires, signature = (parse_qs(query)[name][0] for name in ("expires", "signature"))
    folder = f"/v1/jobs/{mine}/files"
    for changed in (
        f"/v1/jobs/{other}/files/report.html?{query}",  # another job
        f"/v1/jobs/{bobs}/files/report.html?{query}",  # of another owner
        f"/v1/jobs/{'0' * 32}/files/report.html?{query}",  # whether there is one is not told
        f"/v1/jobs/{mine.upper()}/files/report.html?{query}",
        f"{folder}/programs/main.mod?{query}",  # another file
        f"{folder}/problem/problem.yaml?{query}",
        f"{folder}/report.html%00?{query}",
        f"{folder}/REPORT.HTML?{query}",
        f"{folder}/report.html/?{query}",
        f"{folder}/..%2f..%2f{other}%2ffiles%2freport.html?{query}",
        f"{folder}/%2e%2e/%2e%2e/tandem.db?{query}",
        f"{folder}//etc/passwd?{query}",
        f"{path}?expires={int(expires) + 3600}&signature={signature}",  # for longer
        f"{path}?expires=9007199254740991&signature={signature}",
        f"{path}?signature={signature}",  # for ever
        f"{path}?expires={expires}&signature=",
        f"{path}?expires={expires}&signature={signature[:-1]}",
        f"{path}?expires={expires}&signature={signature[:-1]}{'0' if signature[-1] != '0' else '1'}",
        f"{path}?expires={expires}&signature={signature.upper()}",
        f"{path}?expires={expires}&signature={'0' * 64}",
        f"{path}?expires={expires}&signature=%C3%A9%00",
        f"{path}?expires={expires}&signature={signature}&signature=0",
        # a signature without the secret
        f"{path}?expires={expires}&signature={forged_link(mine, int(expires), b'')}",
        f"{path}?expires={expires}&signature={forged_link(mine, int(expires), ann.encode())}",
    ):
        require_refused(running_service, changed)
    for changed in (f"{path}?expires=-1&signature={signature}", f"{path}?expires=soon&signature={signature}"):
        assert stranger(running_service).get(changed).status_code == 422
    assert stranger(running_service).get(f"{path}?{query}").status_code == 200


def forged_link(job: str, expires: int, secret: bytes) -> str:
    signed = json.dumps(["tandem link", job, "report.html", expires]).encode()
    return hmac.new(secret, signed, hashlib.sha256).hexdigest()


def test_a_link_only_reads_and_only_that_file(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "reads", ann)
    path, query = link(running_service, job, ann).split("?")
    for method, asked in (
        ("GET", ""),
        ("GET", "/files"),
        ("GET", "/events"),
        ("GET", "/programs.zip"),
        ("POST", "/cancel"),
        ("DELETE", ""),
    ):
        answer = stranger(running_service).request(method, f"/v1/jobs/{job}{asked}?{query}")
        assert answer.status_code == 401, asked
    for method in ("POST", "PUT", "DELETE"):
        assert stranger(running_service).request(method, f"{path}?{query}").status_code == 405


def test_a_bad_link_is_refused_whoever_sends_it(closed_service: tuple[InProcess, str, str]) -> None:
    """The answer does not depend on a session cookie."""
    running_service, ann, _ = closed_service
    job = finished_job(running_service, "whoever", ann)
    answer = running_service.http.get(
        f"/v1/jobs/{job}/files/report.html?expires=1&signature=0", headers=bearer(ann)
    )
    assert issue_codes(answer) == [("service.link", "signature")]


def test_links_end_with_their_token_and_their_job(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, ann, _ = closed_service
    eve = running_service.service.auth.create_token("eve")
    path = link(running_service, finished_job(running_service, "eves", eve), eve)
    assert stranger(running_service).get(path).status_code == 200
    running_service.service.auth.revoke("eve")
    require_refused(running_service, path)
    job = finished_job(running_service, "deleted", ann)
    path = link(running_service, job, ann)
    assert running_service.http.delete(f"/v1/jobs/{job}", headers=bearer(ann)).status_code == 204
    answer = stranger(running_service).get(path)
    assert answer.status_code == 404
    assert issue_codes(answer) == [("service.unknown_job", None)]


def test_links_of_a_service_without_tokens_end_when_it_asks_for_them(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        job = running_service.post(named_problem("open")).json()["id"]
        running_service.wait_for_end(job)
        path = running_service.http.post(f"/v1/jobs/{job}/links?name=report.html").json()["path"]
        assert running_service.http.get(path).status_code == 200
        assert issue_codes(running_service.http.get(path[:-1])) == [("service.link", "signature")]
        running_service.service.auth.create_token("ann")
    with InProcess(tmp_path / "data", examiners=1, require_token=True) as running_service:
        require_refused(running_service, path)


def test_the_secret_is_that_of_the_store(tmp_path: Path) -> None:
    """Links outlive a restart, hosts of one store take one another's, and other stores take none."""
    signed = []
    for folder in ("one", "one", "two"):
        service = Service(Options(data=tmp_path / folder, examiners=1), FakeTeam)
        signed.append(service.links.sign("0" * 32, "report.html", 1))
        service.close()
    assert signed[0] == signed[1] != signed[2]


def test_hosts_on_postgres_share_the_secret(tmp_path: Path) -> None:
    url = postgres.fresh(tmp_path)
    hosts = [links.Links(Database(url)) for _ in range(2)]
    assert len({host.sign("0" * 32, "report.html", 1) for host in hosts}) == 1


def test_no_log_has_a_signature(tmp_path: Path) -> None:
    data = tmp_path / "data"
    process = Process(data, module="tests.service.fake_team", arguments=(str(data), "")).wait()
    try:
        for path in (
            "a?expires=1&signature=5ec2e7",
            "a?expires=1&%73ignature=5ec2e7",
            "%61?signature=5ec2e7",
        ):
            with pytest.raises(urllib.error.HTTPError):
                urllib.request.urlopen(f"{process.url}/v1/jobs/{'0' * 32}/files/{path}")
    finally:
        process.stop()
    log = process.log.read_text()
    assert log.count('/files/a HTTP/1.1" 403') + log.count('/files/%61 HTTP/1.1" 403') == 3, log
    assert "5ec2e7" not in log


def test_the_service_says_its_interface(closed_service: tuple[InProcess, str, str]) -> None:
    running_service, _, _ = closed_service
    body: dict[str, Any] = stranger(running_service).get("/v1/health").json()
    assert body["api"] >= body["api_oldest"] == 1
