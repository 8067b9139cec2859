"""Thumbnails of jobs in lists: made with the result, read like other files, announced where they exist."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest
from PIL import Image

from tests.report.test_thumbnail import noise, report_of
from tests.service.support import issue_codes, named_problem
from tests.service.test_links import stranger
from tests.service.test_roles import UNKNOWN, Shop, open_service
from tests.service.test_view_links import addresses, make_view_link


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A service whose team draws the cell in its reports."""
    with open_service(tmp_path_factory.mktemp("thumbnails") / "data", None) as running_service:
        running_service.team.report = report_of(noise(900, 499))
        yield Shop(running_service)


def thumbnail_flags(shop: Shop, job: str) -> tuple[bool, bool, bool]:
    """Return whether list, job and files announce a thumbnail."""
    listed = {item["id"]: item for item in shop.ask("ann", "GET", "/v1/jobs?limit=200").json()["jobs"]}
    files = shop.ask("ann", "GET", f"/v1/jobs/{job}/files").json()["files"]
    own = shop.ask("ann", "GET", f"/v1/jobs/{job}").json()
    return listed[job]["thumbnail"], own["thumbnail"], "thumbnail.png" in {item["name"] for item in files}


def test_who_sees_a_job_sees_its_picture(shop: Shop) -> None:
    job = shop.job("ann", "pictured")
    assert thumbnail_flags(shop, job) == (True, True, True)
    path = f"/v1/jobs/{job}/files/thumbnail.png"
    for mate in ("ann", "bob", "lea"):
        answer = shop.ask(mate, "GET", path)
        assert (answer.status_code, answer.headers["Content-Type"]) == (200, "image/png")
        assert answer.headers["Cache-Control"] == "private, max-age=3600"
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert len(answer.content) <= 15_000
    with Image.open(io.BytesIO(answer.content)) as picture:
        assert picture.size == (200, 111)
    known = {"If-None-Match": answer.headers["ETag"]}
    token = {"Authorization": f"Bearer {shop.tokens['ann']}"}
    assert shop.running_service.http.get(path, headers=known | token).status_code == 304
    assert issue_codes(shop.ask("eve", "GET", path)) == issue_codes(shop.ask("dan", "GET", path)) == UNKNOWN
    assert stranger(shop.running_service).get(path).status_code == 401
    link = shop.ask("ann", "POST", f"/v1/jobs/{job}/links?name=thumbnail.png").json()["path"]
    opened_by_link = stranger(shop.running_service).get(link)
    assert (opened_by_link.status_code, opened_by_link.headers["Cache-Control"]) == (200, "no-store")
    report = addresses(job, make_view_link(shop.running_service, job, shop.tokens["ann"]))[2]
    assert stranger(shop.running_service).get(report).status_code == 200
    assert (
        stranger(shop.running_service).get(report.replace("report.html", "thumbnail.png")).status_code == 404
    )


def test_an_answer_from_the_store_has_its_picture(shop: Shop) -> None:
    first, again = shop.job("ann", "twice"), shop.job("bob", "twice")
    assert shop.ask("bob", "GET", f"/v1/jobs/{again}").json()["from_store"]
    shop.ask("ann", "DELETE", f"/v1/jobs/{first}")
    assert thumbnail_flags(shop, again) == (True, True, True)


@pytest.mark.parametrize("state", ["infeasible", "unproven", "crashed"])
def test_what_did_not_end_well_has_none(shop: Shop, monkeypatch: pytest.MonkeyPatch, state: str) -> None:
    monkeypatch.setattr(shop.running_service.team, "state", state)
    token = {"Authorization": f"Bearer {shop.tokens['ann']}"}
    job = shop.running_service.post(named_problem(state), headers=token).json()["id"]
    assert shop.running_service.wait_for_end(job, headers=token)["state"] == state
    assert thumbnail_flags(shop, job) == (False, False, False)


def test_a_report_without_a_picture_is_stored_all_the_same(
    shop: Shop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shop.running_service.team, "report", "<script>1</script>")
    job = shop.job("ann", "plain")
    assert thumbnail_flags(shop, job) == (False, False, False)
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}/files/thumbnail.png").status_code == 404
