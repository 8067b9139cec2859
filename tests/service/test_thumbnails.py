"""Pictures of jobs in lists: made with the result, read as other files are, told where there are any."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest
from PIL import Image

from tests.report.test_thumbnail import noise, report_of
from tests.service.support import codes, named
from tests.service.test_links import stranger
from tests.service.test_looks import addresses, look
from tests.service.test_roles import UNKNOWN, Shop, opened


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A service whose team draws the cell in its reports."""
    with opened(tmp_path_factory.mktemp("thumbnails") / "data", None) as here:
        here.team.report = report_of(noise(900, 499))
        yield Shop(here)


def told(shop: Shop, job: str) -> tuple[bool, bool, bool]:
    """Whether list, job and files tell of a picture."""
    listed = {one["id"]: one for one in shop.ask("ann", "GET", "/v1/jobs?limit=200").json()["jobs"]}
    files = shop.ask("ann", "GET", f"/v1/jobs/{job}/files").json()["files"]
    own = shop.ask("ann", "GET", f"/v1/jobs/{job}").json()
    return listed[job]["thumbnail"], own["thumbnail"], "thumbnail.png" in {one["name"] for one in files}


def test_who_sees_a_job_sees_its_picture(shop: Shop) -> None:
    job = shop.job("ann", "pictured")
    assert told(shop, job) == (True, True, True)
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
    assert shop.here.http.get(path, headers=known | token).status_code == 304
    assert codes(shop.ask("eve", "GET", path)) == codes(shop.ask("dan", "GET", path)) == UNKNOWN
    assert stranger(shop.here).get(path).status_code == 401
    link = shop.ask("ann", "POST", f"/v1/jobs/{job}/links?name=thumbnail.png").json()["path"]
    opened_by_link = stranger(shop.here).get(link)
    assert (opened_by_link.status_code, opened_by_link.headers["Cache-Control"]) == (200, "no-store")
    report = addresses(job, look(shop.here, job, shop.tokens["ann"]))[2]
    assert stranger(shop.here).get(report).status_code == 200
    assert stranger(shop.here).get(report.replace("report.html", "thumbnail.png")).status_code == 404


def test_an_answer_from_the_store_has_its_picture(shop: Shop) -> None:
    first, again = shop.job("ann", "twice"), shop.job("bob", "twice")
    assert shop.ask("bob", "GET", f"/v1/jobs/{again}").json()["from_store"]
    shop.ask("ann", "DELETE", f"/v1/jobs/{first}")
    assert told(shop, again) == (True, True, True)


@pytest.mark.parametrize("state", ["infeasible", "unproven", "crashed"])
def test_what_did_not_end_well_has_none(shop: Shop, monkeypatch: pytest.MonkeyPatch, state: str) -> None:
    monkeypatch.setattr(shop.here.team, "state", state)
    token = {"Authorization": f"Bearer {shop.tokens['ann']}"}
    job = shop.here.post(named(state), headers=token).json()["id"]
    assert shop.here.ended(job, headers=token)["state"] == state
    assert told(shop, job) == (False, False, False)


def test_a_report_without_a_picture_is_stored_all_the_same(
    shop: Shop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shop.here.team, "report", "<script>1</script>")
    job = shop.job("ann", "plain")
    assert told(shop, job) == (False, False, False)
    assert shop.ask("ann", "GET", f"/v1/jobs/{job}/files/thumbnail.png").status_code == 404
