"""Links to files of jobs: what they open, and every way to make one open something else."""

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
from planner.service.security import Auth, Limits
from planner.service.service import Options, Service
from tests.service import postgres
from tests.service.support import HERE, InProcess, Process, Team, codes, named


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[InProcess, str, str]]:
    """A service that asks for tokens, and the tokens of ann and bob."""
    data = tmp_path_factory.mktemp("links") / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.make("ann"), auth.make("bob")
    with InProcess(data, Limits(check_s=60), examiners=1, require_token=True) as made:
        yield made, *tokens


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def done(here: InProcess, name: str, token: str) -> str:
    """A job of the token that has ended."""
    job = str(here.post(named(name), headers=bearer(token)).json()["id"])
    assert here.ended(job, headers=bearer(token))["state"] == "verified"
    return job


def link(here: InProcess, job: str, token: str, name: str = "report.html", seconds: int = 60) -> str:
    answer = here.http.post(
        f"/v1/jobs/{job}/links", params={"name": name, "seconds": seconds}, headers=bearer(token)
    )
    assert answer.status_code == 200, answer.text
    return str(answer.json()["path"])


def stranger(here: InProcess) -> TestClient:
    """A browser without token or cookie."""
    return TestClient(here.http.app, base_url=HERE)


def refused(here: InProcess, path: str) -> None:
    answer = stranger(here).get(path)
    assert answer.status_code == 403, (path, answer.text)
    assert codes(answer) == [("service.link", "signature")]


def test_a_link_opens_its_file_without_a_token(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    job = done(here, "opened", ann)
    path = link(here, job, ann)
    answer = stranger(here).get(path)
    assert answer.status_code == 200
    assert answer.text == "<script>1</script>"
    assert "sandbox" in answer.headers["content-security-policy"]
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert stranger(here).get(f"{path}&download=true").headers["content-disposition"].startswith("attachment")
    program = link(here, job, ann, "programs/main.mod")
    assert stranger(here).get(program).text == "MODULE main"
    assert stranger(here).get(path.split("?")[0]).status_code == 401


def test_a_link_says_when_it_ends(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    job = done(here, "ends", ann)
    answer = here.http.post(f"/v1/jobs/{job}/links?name=report.html&seconds=90", headers=bearer(ann)).json()
    (said,) = parse_qs(urlsplit(answer["path"]).query)["expires"]
    assert dt.datetime.fromisoformat(answer["expires"]).timestamp() == int(said)
    assert 80 < int(said) - time.time() <= 90


@pytest.mark.parametrize("query", ["name=report.html&seconds=0", "name=report.html&seconds=86401", ""])
def test_links_that_cannot_be_had_are_422(closed: tuple[InProcess, str, str], query: str) -> None:
    here, ann, _ = closed
    job = done(here, "wrong", ann)
    assert here.http.post(f"/v1/jobs/{job}/links?{query}", headers=bearer(ann)).status_code == 422


def test_a_link_is_over_at_its_end(
    closed: tuple[InProcess, str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, ann, _ = closed
    job = done(here, "over", ann)
    path = link(here, job, ann, seconds=60)
    later = time.time() + 61
    monkeypatch.setattr(links.time, "time", lambda: later)
    refused(here, path)
    assert "it is over" in stranger(here).get(path).text


def test_only_the_owner_gets_a_link(closed: tuple[InProcess, str, str]) -> None:
    here, ann, bob = closed
    job = done(here, "owned", ann)
    asked = f"/v1/jobs/{job}/links?name=report.html"
    answer = here.http.post(asked, headers=bearer(bob))
    assert answer.status_code == 404
    assert codes(answer) == [("service.unknown_job", None)]
    assert stranger(here).post(asked).status_code == 401
    (query,) = [urlsplit(link(here, job, ann)).query]
    assert stranger(here).post(f"{asked}&{query}").status_code == 401, "a link makes no further links"
    for unknown in ("replay.html", "../../service.lock", "", "report.html/"):
        answer = here.http.post(f"/v1/jobs/{job}/links", params={"name": unknown}, headers=bearer(ann))
        assert answer.status_code == 404, unknown
        assert codes(answer) == [("service.unknown_file", "name")]


def test_a_changed_link_opens_nothing(closed: tuple[InProcess, str, str]) -> None:
    here, ann, bob = closed
    mine, other, bobs = done(here, "mine", ann), done(here, "other", ann), done(here, "bobs", bob)
    path, query = link(here, mine, ann).split("?")
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
        f"{path}?expires={expires}&signature={forged(mine, int(expires), b'')}",
        f"{path}?expires={expires}&signature={forged(mine, int(expires), ann.encode())}",
    ):
        refused(here, changed)
    for changed in (f"{path}?expires=-1&signature={signature}", f"{path}?expires=soon&signature={signature}"):
        assert stranger(here).get(changed).status_code == 422
    assert stranger(here).get(f"{path}?{query}").status_code == 200


def forged(job: str, expires: int, secret: bytes) -> str:
    signed = json.dumps(["tandem link", job, "report.html", expires]).encode()
    return hmac.new(secret, signed, hashlib.sha256).hexdigest()


def test_a_link_only_reads_and_only_that_file(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    job = done(here, "reads", ann)
    path, query = link(here, job, ann).split("?")
    for method, asked in (
        ("GET", ""),
        ("GET", "/files"),
        ("GET", "/events"),
        ("GET", "/programs.zip"),
        ("POST", "/cancel"),
        ("DELETE", ""),
    ):
        answer = stranger(here).request(method, f"/v1/jobs/{job}{asked}?{query}")
        assert answer.status_code == 401, asked
    for method in ("POST", "PUT", "DELETE"):
        assert stranger(here).request(method, f"{path}?{query}").status_code == 405


def test_a_bad_link_is_refused_whoever_sends_it(closed: tuple[InProcess, str, str]) -> None:
    """What is shown does not depend on a cookie that happens to be there."""
    here, ann, _ = closed
    job = done(here, "whoever", ann)
    answer = here.http.get(f"/v1/jobs/{job}/files/report.html?expires=1&signature=0", headers=bearer(ann))
    assert codes(answer) == [("service.link", "signature")]


def test_links_end_with_their_token_and_their_job(closed: tuple[InProcess, str, str]) -> None:
    here, ann, _ = closed
    eve = here.service.auth.make("eve")
    path = link(here, done(here, "eves", eve), eve)
    assert stranger(here).get(path).status_code == 200
    here.service.auth.revoke("eve")
    refused(here, path)
    job = done(here, "deleted", ann)
    path = link(here, job, ann)
    assert here.http.delete(f"/v1/jobs/{job}", headers=bearer(ann)).status_code == 204
    answer = stranger(here).get(path)
    assert answer.status_code == 404
    assert codes(answer) == [("service.unknown_job", None)]


def test_links_of_a_service_without_tokens_end_when_it_asks_for_them(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as here:
        job = here.post(named("open")).json()["id"]
        here.ended(job)
        path = here.http.post(f"/v1/jobs/{job}/links?name=report.html").json()["path"]
        assert here.http.get(path).status_code == 200
        assert codes(here.http.get(path[:-1])) == [("service.link", "signature")]
        here.service.auth.make("ann")
    with InProcess(tmp_path / "data", examiners=1, require_token=True) as here:
        refused(here, path)


def test_the_secret_is_that_of_the_store(tmp_path: Path) -> None:
    """Links outlive a restart, hosts of one store take one another's, and other stores take none."""
    signed = []
    for folder in ("one", "one", "two"):
        service = Service(Options(data=tmp_path / folder, examiners=1), Team)
        signed.append(service.links.sign("0" * 32, "report.html", 1))
        service.close()
    assert signed[0] == signed[1] != signed[2]


def test_hosts_on_postgres_share_the_secret(tmp_path: Path) -> None:
    url = postgres.fresh(tmp_path)
    hosts = [links.Links(Database(url)) for _ in range(2)]
    assert len({host.sign("0" * 32, "report.html", 1) for host in hosts}) == 1


def test_no_log_has_a_signature(tmp_path: Path) -> None:
    data = tmp_path / "data"
    process = Process(data, module="tests.service.pretend", arguments=(str(data), "")).wait()
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


def test_the_service_says_its_interface(closed: tuple[InProcess, str, str]) -> None:
    here, _, _ = closed
    said: dict[str, Any] = stranger(here).get("/v1/health").json()
    assert said["api"] >= said["api_oldest"] == 1
