"""Programs released by a person: what is recorded, what downloads contain, and attempts to circumvent it."""

from __future__ import annotations

import datetime as dt
import hashlib
import io
import itertools
import json
import threading
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import func, select, update

from planner.service import user_texts
from planner.service.jobs import delete_job, put_files
from planner.service.models import JOBS, RELEASES
from planner.service.releases import Releases
from planner.service.security import RefusedError
from tests.service import postgres
from tests.service.support import BASE_URL, InProcess, issue_codes, named_problem
from tests.service.test_roles import UNKNOWN, Shop, bearer, open_service

MAIN: Final = hashlib.sha256(b"MODULE main").hexdigest()
"""SHA-256 of the program of a pretended plan."""
NUMBERS: Final = itertools.count()
"""Other names for other jobs."""


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    with open_service(tmp_path_factory.mktemp("releases") / "data", None) as running_service:
        yield Shop(running_service)


def release(shop: Shop, job: str, name: str = "bob", **more: Any) -> Any:
    return shop.ask(name, "POST", f"/v1/jobs/{job}/release", json=more)


def withdraw(shop: Shop, job: str, name: str = "bob", **more: Any) -> Any:
    return shop.ask(name, "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "the clamp moved", **more})


def test_a_release_says_who_when_and_of_what(shop: Shop) -> None:
    job = shop.job("ann", "released")
    before = time.time()
    made = release(shop, job, note="  Schnitt am Dienstag\nmit Führung  ")
    assert made.status_code == 201, made.text
    body = made.json()
    answer_body = shop.ask("lea", "GET", f"/v1/jobs/{job}").json()
    files = shop.ask("lea", "GET", f"/v1/jobs/{job}/files").json()["files"]
    shas = {item["name"]: item["sha256"] for item in files}
    assert body["by"] == "bob"
    assert body["note"] == "Schnitt am Dienstag\nmit Führung"
    assert body["programs"] == {"main.mod": MAIN} == {"main.mod": shas["programs/main.mod"]}
    assert body["proof"] == shas["proof.json"]
    assert body["digest"] == answer_body["digest"]
    assert before - 1 < dt.datetime.fromisoformat(body["at"]).timestamp() < time.time() + 1
    assert answer_body["released"] is True
    assert answer_body["release"] == {"by": "bob", "at": body["at"], "note": body["note"]}
    (listed,) = [item for item in shop.ask("ann", "GET", "/v1/jobs").json()["jobs"] if item["id"] == job]
    assert listed["released"] is True
    assert shop.ask("lea", "GET", f"/v1/jobs/{job}/releases").json()["releases"] == [body]


def test_who_may_not_release_does_not(shop: Shop) -> None:
    job = shop.job("ann", "guarded")
    for name in ("ann", "lea"):
        for answer in (release(shop, job, name), withdraw(shop, job, name)):
            assert (answer.status_code, issue_codes(answer)) == (403, [("service.role", "Authorization")])
            assert "required release" in answer.json()["detail"]
    for name in ("eve", "dan"):
        for answer in (release(shop, job, name), withdraw(shop, job, name)):
            assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN)
        assert shop.ask(name, "GET", f"/v1/jobs/{job}/releases").status_code == 404
    anybody = TestClient(shop.running_service.http.app, base_url=BASE_URL)
    assert anybody.post(f"/v1/jobs/{job}/release", json={}).status_code == 401
    assert shop.ask("lea", "GET", f"/v1/jobs/{job}/releases").json() == {"releases": []}
    other = shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={"name": "ann"})
    assert (other.status_code, issue_codes(other)) == (422, [("service.request", "name")])
    assert "allowed bob" in other.text
    assert shop.ask("lea", "GET", f"/v1/jobs/{job}").json()["released"] is False


def test_downloads_say_whether_they_are_released(shop: Shop) -> None:
    job = shop.job("ann", "told")
    parts: dict[str, bytes] = {}
    for word in ("not-released", "released", "withdrawn"):
        if word == "released":
            body = release(shop, job, note="ja").json()
        if word == "withdrawn":
            body = withdraw(shop, job).json()
        whole = shop.ask("lea", "GET", f"/v1/jobs/{job}/programs.zip")
        again = shop.ask("bob", "GET", f"/v1/jobs/{job}/programs.zip")
        assert whole.content == again.content, "the same bytes for the same release"
        assert whole.headers["tandem-release"] == word
        assert f'filename="told-{word}.zip"' in whole.headers["content-disposition"]
        with zipfile.ZipFile(io.BytesIO(whole.content)) as packed:
            assert packed.namelist() == ["main.mod", "release.json"]
            told = json.loads(packed.read("release.json"))
        assert told["released"] is (word == "released")
        assert told["programs"] == {"main.mod": MAIN}
        assert told["says"].startswith("released by bob, 20" if word != "not-released" else "not released")
        assert ("withdrawn by bob" in told["says"]) is (word == "withdrawn")
        one = shop.ask("lea", "GET", f"/v1/jobs/{job}/files/programs/main.mod")
        assert (one.content, one.headers["tandem-release"]) == (b"MODULE main", word)
        assert one.headers["cache-control"] == "private, no-cache"
        tag = {"If-None-Match": one.headers["etag"], **bearer(shop.tokens["lea"])}
        known = shop.running_service.http.get(f"/v1/jobs/{job}/files/programs/main.mod", headers=tag)
        assert (known.status_code, known.headers["tandem-release"]) == (304, word), "caches get new headers"
        file = shop.ask("lea", "GET", f"/v1/jobs/{job}/files/release.json")
        listed = {f["name"]: f for f in shop.ask("lea", "GET", f"/v1/jobs/{job}/files").json()["files"]}
        if word == "not-released":
            assert (file.status_code, "release.json" in listed) == (404, False)
        else:
            assert file.json() == told
            about = listed["release.json"]
            assert about["sha256"] == hashlib.sha256(file.content).hexdigest()
            assert about["size"] == len(file.content)
            assert told["release"]["by"] == body["by"] == "bob"
            headers = {"If-None-Match": file.headers["etag"], **bearer(shop.tokens["lea"])}
            assert (
                shop.running_service.http.get(
                    f"/v1/jobs/{job}/files/release.json", headers=headers
                ).status_code
                == 304
            )
        parts[whole.headers["etag"]] = whole.content
    assert len(parts) == 3
    # who went on with the part of what he had begun gets the whole of what is true now
    old = next(tag for tag, content in parts.items() if content != whole.content)
    headers = {"Range": "bytes=10-", "If-Range": old, **bearer(shop.tokens["lea"])}
    rest = shop.running_service.http.get(f"/v1/jobs/{job}/programs.zip", headers=headers)
    assert (rest.status_code, rest.content) == (200, whole.content)
    headers["If-Range"] = whole.headers["etag"]
    rest = shop.running_service.http.get(f"/v1/jobs/{job}/programs.zip", headers=headers)
    assert (rest.status_code, rest.content) == (206, whole.content[10:])


def test_a_link_to_a_program_says_it_too(shop: Shop) -> None:
    job, anybody = shop.job("ann", "link_told"), TestClient(shop.running_service.http.app, base_url=BASE_URL)
    release(shop, job)
    for name in ("programs/main.mod", "release.json"):
        path = shop.ask("bob", "POST", f"/v1/jobs/{job}/links?name={name}").json()["path"]
        assert anybody.get(path).headers["tandem-release"] == "released"
        assert anybody.get(path).headers["cache-control"] == "no-store"


def test_a_release_is_withdrawn_with_a_reason_and_stays_written_down(shop: Shop) -> None:
    job = shop.job("ann", "back")
    answer = withdraw(shop, job)
    assert (answer.status_code, issue_codes(answer)) == (409, [("service.release", None)])
    first = release(shop, job, note="one").json()
    for bad in ({}, {"reason": ""}, {"reason": " \n "}, {"reason": "\u200e"}):
        answer = shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json=bad)
        assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "reason")]), bad
    taken = withdraw(shop, job).json()
    assert taken["withdrawn"]["by"] == "bob"
    assert taken["withdrawn"]["reason"] == "the clamp moved"
    assert withdraw(shop, job).status_code == 409
    body = shop.ask("ann", "GET", f"/v1/jobs/{job}").json()
    assert (body["released"], body["release"]["withdrawn"]["by"]) == (False, "bob")
    second = release(shop, job, note="two").json()
    known = shop.ask("ann", "GET", f"/v1/jobs/{job}/releases").json()["releases"]
    assert known == [second, {**first, "withdrawn": taken["withdrawn"]}]
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["released"] is True


def test_what_is_not_proven_is_not_released(shop: Shop) -> None:
    running_service = shop.running_service
    running_service.team.hold.set()
    waits = running_service.post(named_problem("waits"), headers=bearer(shop.tokens["ann"])).json()["id"]
    answer = release(shop, waits)
    assert (answer.status_code, issue_codes(answer)) == (409, [("service.release", None)])
    assert "Only programs with a valid proof" in answer.text
    running_service.team.hold.clear()
    running_service.wait_for_end(waits, headers=bearer(shop.tokens["ann"]))
    for state in ("unproven", "infeasible", "done", "cancelled"):
        with running_service.service.database.write() as db:
            db.execute(update(JOBS).where(JOBS.c.id == waits).values(state=state))
        assert f"state is {state}" in release(shop, waits).text


@pytest.mark.parametrize(
    ("name", "change", "expected_text"),
    [
        ("proof.json", lambda proof: proof | {"ok": False}, "not verified"),
        ("proof.json", lambda proof: proof | {"ok": "yes"}, "not verified"),
        ("proof.json", lambda proof: proof | {"problem_digest": "0" * 64}, "belongs to another problem"),
        ("proof.json", lambda proof: proof | {"programs": {}}, "names other programs"),
        ("proof.json", lambda proof: proof | {"programs": {"main.mod": "0" * 64}}, "names other programs"),
        (
            "proof.json",
            lambda proof: proof | {"programs": {**proof["programs"], "more.mod": MAIN}},
            "names other programs",
        ),
        ("proof.json", lambda proof: [proof], "cannot be read"),
        ("programs/main.mod", lambda text: b"MODULE other", "names other programs"),
        ("programs/added.mod", lambda text: b"MODULE added", "names other programs"),
    ],
)
def test_what_the_proof_does_not_name_is_not_released(
    shop: Shop, name: str, change: Any, expected_text: str
) -> None:
    """As if planning had written it so: the file is one of the store."""
    job = shop.job("ann", f"proof_{next(NUMBERS)}")
    files = shop.running_service.service.jobs.files(job)
    content = b""
    if name == "proof.json":
        content = json.dumps(
            change(json.loads(shop.running_service.service.files.read(files[name].sha)))
        ).encode()
    else:
        content = change(content)
    with shop.running_service.service.database.write() as db:
        put_files(db, job, {name: shop.running_service.service.files.put(io.BytesIO(content))})
    answer = release(shop, job)
    assert (answer.status_code, issue_codes(answer)) == (409, [("service.release", None)])
    assert expected_text in answer.text
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["released"] is False


def test_what_is_damaged_on_the_disk_is_not_released(shop: Shop) -> None:
    job, path = shop.job("ann", "damaged"), shop.running_service.service.files.path(MAIN)
    good = path.read_bytes()
    try:
        for damage in (lambda: path.write_bytes(b"MODULE evil"), path.unlink):
            damage()
            answer = release(shop, job)
            assert (answer.status_code, issue_codes(answer)) == (409, [("service.release", None)])
            assert "in the store is damaged" in answer.text
            assert str(path.parent) not in answer.text
    finally:
        path.write_bytes(good)
    assert release(shop, job).status_code == 201
    try:  # nor does it go out as released, where it was damaged since
        for damage in (lambda: path.write_bytes(b"MODULE evil"), path.unlink):
            damage()
            for what in ("files/programs/main.mod", "programs.zip"):
                answer = shop.ask("ann", "GET", f"/v1/jobs/{job}/{what}")
                assert (answer.status_code, issue_codes(answer)[0][0]) == (500, "service.damaged")
                assert "damaged and not sent" in answer.text and str(path.parent) not in answer.text
    finally:
        path.write_bytes(good)
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}/programs.zip").status_code == 200


def test_the_same_problem_again_is_another_job_and_not_released(shop: Shop) -> None:
    job = shop.job("ann", "again")
    release(shop, job)
    other = shop.running_service.post(named_problem("again"), headers=bearer(shop.tokens["ann"])).json()
    assert other["from_store"] is True
    assert (other["state"], other["released"]) == ("verified", False)
    files = shop.ask("ann", "GET", f"/v1/jobs/{other['id']}/files").json()["files"]
    assert "release.json" not in {file["name"] for file in files}
    told = shop.ask("ann", "GET", f"/v1/jobs/{other['id']}/programs.zip").headers["tandem-release"]
    assert told == "not-released"
    answer = shop.ask("ann", "POST", f"/v1/jobs/{job}/retry")
    assert answer.status_code == 409, "what is released is not planned again"
    shop.ask("ann", "POST", f"/v1/jobs/{job}/cancel")
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["released"] is True


@pytest.mark.parametrize(
    "text", ["<img src=x onerror=alert(1)>", "לוח 3", "پنل\u200cسه", "👩\u200d🔧 ok", "a\tb"]
)
def test_notes_in_any_language_are_kept_as_they_are(shop: Shop, text: str) -> None:
    job = shop.job("ann", f"note_{next(NUMBERS)}")
    assert release(shop, job, note=text).json()["note"] == text
    whole = shop.ask("ann", "GET", f"/v1/jobs/{job}/programs.zip")
    with zipfile.ZipFile(io.BytesIO(whole.content)) as packed:
        assert json.loads(packed.read("release.json"))["release"]["note"] == text


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("a\u202eb", "U+202E (right-to-left override)"),
        ("a\u2066b", "U+2066 (left-to-right isolate)"),
        ("\u061ca b", "U+061C (arabic letter mark)"),
        ("a\x00b", "U+0000 (a control character)"),
        ("a\x1b[2J", "U+001B (a control character)"),
        ("a\u2028b", "U+2028 (line separator)"),
        ("a\U000e0041b", "U+E0041 (tag latin capital letter a)"),
        ("a\ufeffb", "U+FEFF (zero width no-break space)"),
        ("x" * (user_texts.MAX_TEXT_LENGTH + 1), "at most 2000 characters"),
        ("x" * 900_000, "at most 2000 characters"),
        ("\ufb2c" * 667, "is too long after normalisation (NFC) (got 2001 characters, allowed 2000)"),
    ],
)
def test_what_hides_or_turns_text_is_refused(shop: Shop, text: str, named: str) -> None:
    answer = release(shop, shop.job("ann", "marks"), note=text)
    assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "note")])
    assert named in answer.json()["detail"]
    assert len(answer.content) < 2000


def test_bodies_that_are_none_are_refused(shop: Shop) -> None:
    job = shop.job("ann", "bodies")
    for content, status in (
        (b"[]", 422),
        (b"{", 422),
        (b'{"by": "ann"}', 422),
        (b'{"note": 1}', 422),
        (b'{"note": "\\ud800"}', 422),
        (b" " * 1_000_001, 413),
    ):
        answer = shop.ask("bob", "POST", f"/v1/jobs/{job}/release", content=content)
        assert answer.status_code == status, content[:30]


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_at_once_one_release_is_made(tmp_path: Path, kind: str) -> None:
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop = Shop(running_service)
        job = shop.job("ann", "twice")
        with ThreadPoolExecutor(8) as pool:
            answers = list(pool.map(lambda k: release(shop, job, note=str(k)), range(8)))
        assert sorted(answer.status_code for answer in answers) == [201, *[409] * 7]
        with ThreadPoolExecutor(8) as pool:
            answers = list(pool.map(lambda k: withdraw(shop, job, reason=str(k)), range(8)))
        assert sorted(answer.status_code for answer in answers) == [200, *[409] * 7]
        assert len(shop.ask("ann", "GET", f"/v1/jobs/{job}/releases").json()["releases"]) == 1


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_release_of_what_is_deleted_meanwhile_leaves_nothing(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Deleted by a user and by age, before and after the release checks again."""
    database = postgres.fresh(tmp_path) if kind == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        shop = Shop(running_service)
        first = shop.job("ann", "deleted")
        proven = Releases._proven_programs

        def then_delete(self: Releases, *given: Any) -> Any:
            result = proven(self, *given)
            assert shop.ask("ann", "DELETE", f"/v1/jobs/{first}").status_code == 204
            return result

        with monkeypatch.context() as between:
            between.setattr(Releases, "_proven_programs", then_delete)
            answer = release(shop, first)
        assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN)
        kept = shop.job("ann", "kept")
        assert release(shop, kept).status_code == 201
        assert shop.ask("ann", "DELETE", f"/v1/jobs/{kept}").status_code == 204
        jobs = [shop.job("ann", f"race_{k}") for k in range(6)]
        ready = threading.Barrier(3)

        def race(ask: Any) -> list[int]:
            ready.wait()
            return [ask(job) for job in jobs]

        def by_age(job: str) -> int:
            with running_service.service.database.write() as db:
                delete_job(db, job)
            return 0

        with ThreadPoolExecutor(3) as pool:
            releasing = pool.submit(race, lambda job: release(shop, job).status_code)
            deleting = pool.submit(race, lambda job: shop.ask("ann", "DELETE", f"/v1/jobs/{job}").status_code)
            aging = pool.submit(race, by_age)
        assert set(releasing.result()) <= {201, 404}
        assert set(deleting.result()) <= {204, 404}
        assert aging.result() == [0] * 6
        with running_service.service.database.read() as db:
            assert db.execute(select(func.count()).select_from(RELEASES)).scalar_one() == 0


def test_without_tokens_who_releases_says_so(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        job = running_service.post().json()["id"]
        running_service.wait_for_end(job)
        answer = running_service.http.post(f"/v1/jobs/{job}/release", json={})
        assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "name")])
        assert "Give the name of the person" in answer.text
        body = running_service.http.post(f"/v1/jobs/{job}/release", json={"name": "Änne Müller"}).json()
        assert body["by"] == "Änne Müller"
        whole = running_service.http.get(f"/v1/jobs/{job}/programs.zip")
        assert whole.headers["tandem-release"] == "released"


def test_a_clock_that_went_back_leaves_the_order_of_releases(
    shop: Shop, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = shop.job("ann", "clock")
    release(shop, job, note="first")
    with monkeypatch.context() as clock:
        past = time.time() - 86400.0
        clock.setattr("planner.service.models.time.time", lambda: past)
        withdraw(shop, job)
        release(shop, job, note="second")
    known = shop.ask("ann", "GET", f"/v1/jobs/{job}/releases").json()["releases"]
    assert [item["note"] for item in known] == ["second", "first"]
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}").json()["release"]["note"] == "second"


def test_the_store_refuses_a_job_that_is_none(shop: Shop) -> None:
    with pytest.raises(RefusedError) as caught:
        shop.running_service.service.releases.all("0" * 32)
    assert caught.value.status == 404
