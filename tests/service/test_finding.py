"""Search for jobs: titles, tags and notes in any language, search, order, and deletion of many jobs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from planner.service.jobs import NewJob
from tests.service import postgres
from tests.service.support import InProcess, issue_codes
from tests.service.test_roles import UNKNOWN, Shop, bearer, open_service

TITLES: Final = {
    "alpha": ("Gewölbe STRASSE 3", ["dome", "Ost"], "cut of Tuesday"),
    "beta": ("κέλυφος ΘΟΛΟΣ", ["dome"], "100 %_ sure"),
    "gamma": ("لوحة القبو ٣", [], "a\nsecond line"),
    "delta": ("Ｆｕｌｌ ＷＩＤＴＨ ①", ["ost"], ""),
    "panel_05": ("", [], ""),
}
"""Title, tags and notes of a job by its name."""


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def shop(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """Five jobs of ann that wait, and one of eve."""
    folder = tmp_path_factory.mktemp("finding")
    database = postgres.fresh(folder) if request.param == "postgresql" else None
    with open_service(folder / "data", database) as running_service:
        running_service.team.hold.set()
        made = Shop(running_service)
        for name, (title, tags, notes) in TITLES.items():
            job = put(made, "ann", name)
            if title:
                said = {"title": title, "tags": tags, "notes": notes}
                answer = made.ask("ann", "PATCH", f"/v1/jobs/{job}", json=said)
                assert answer.status_code == 200, answer.text
        put(made, "eve", "alpha")
        yield made


def put(shop: Shop, owner: str, name: str) -> str:
    """A job as if it had been uploaded."""
    token = shop.tokens[owner][7:23]
    files = {"problem/problem.yaml": shop.running_service.service.files.put(io.BytesIO(b"{}"))}
    new = NewJob(token, name, "0" * 64, f"{owner} {name}", ("targets",), files, 1.0, 1.0)
    return shop.running_service.service.jobs.create(new).id


def names(shop: Shop, query: str = "", by: str = "ann") -> list[str]:
    answer = shop.ask(by, "GET", f"/v1/jobs?{query}")
    assert answer.status_code == 200, answer.text
    return [job["name"] for job in answer.json()["jobs"]]


@pytest.mark.parametrize(
    ("search", "expected_names"),
    [
        ("gewölbe", ["alpha"]),
        ("GEWO\u0308LBE", ["alpha"]),  # as some keyboards send it
        ("strasse", ["alpha"]),
        ("straße", ["alpha"]),
        ("θολος", ["beta"]),
        ("θόλος", []),  # another letter
        ("القبو", ["gamma"]),
        ("full width 1", ["delta"]),
        ("DOME", ["beta", "alpha"]),
        ("dome strasse", ["alpha"]),
        ("tuesday alpha", ["alpha"]),
        ("second", ["gamma"]),
        ("%", ["beta"]),
        ("_", ["panel_05", "beta"]),
        ("l_5", []),
        ("panel_05", ["panel_05"]),
        ("\\", []),
        ("'; DROP TABLE tandem_jobs; --", []),
        ("  ", list(reversed(TITLES))),
    ],
)
def test_all_words_are_found_in_any_language(shop: Shop, search: str, expected_names: list[str]) -> None:
    answer = shop.ask("ann", "GET", "/v1/jobs", params={"search": search})
    assert [job["name"] for job in answer.json()["jobs"]] == expected_names
    assert [
        job["name"] for job in shop.ask("lea", "GET", "/v1/jobs", params={"search": search}).json()["jobs"]
    ] == expected_names


def test_tags_are_whole_and_all_of_them(shop: Shop) -> None:
    assert names(shop, "tag=dome") == ["beta", "alpha"]
    assert names(shop, "tag=dome&tag=OST") == ["alpha"]
    assert names(shop, "tag=ost") == ["delta", "alpha"]
    assert names(shop, "tag=100 %25_ sure") == names(shop, "tag=beta") == []
    assert names(shop, "tag=dom") == names(shop, "tag=%25") == names(shop, "tag=dome&state=verified") == []
    assert names(shop, "search=alpha", by="eve") == ["alpha"]
    assert names(shop, "tag=dome", by="eve") == []


@pytest.mark.parametrize("sort_order", ["newest", "oldest", "title"])
def test_pages_of_each_order_miss_nothing(shop: Shop, sort_order: str) -> None:
    whole = names(shop, f"sort={sort_order}&limit=50")
    assert len(whole) == len(TITLES)
    assert sort_order != "oldest" or whole == list(TITLES)
    assert sort_order != "title" or whole.index("delta") < whole.index("alpha")  # full, gewölbe
    cursor, got = "", []
    while True:
        page = shop.ask("ann", "GET", f"/v1/jobs?sort={sort_order}&limit=2{cursor}").json()
        got += [job["name"] for job in page["jobs"]]
        if page.get("next") is None:
            break
        cursor = f"&cursor={page['next']}"
    assert got == whole
    others = {"newest", "oldest", "title"} - {sort_order} if sort_order == "title" else {"title"}
    for other in others:
        answer = shop.ask("ann", "GET", f"/v1/jobs?sort={other}&limit=2{cursor}")
        assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", "cursor")])


@pytest.mark.parametrize(
    "cursor", ["~" + "0" * 32, "_w~" + "0" * 32, "AA~" + "0" * 32, "A" * 1101 + "~" + "0" * 32, "x"]
)
def test_cursors_of_ones_own_making_are_no_500(shop: Shop, cursor: str) -> None:
    assert shop.ask("ann", "GET", f"/v1/jobs?sort=title&cursor={cursor}").status_code in (200, 422)


def test_what_is_left_out_stays_and_what_is_empty_goes(shop: Shop) -> None:
    job = put(shop, "ann", "changed")
    path = f"/v1/jobs/{job}"
    shop.ask("bob", "PATCH", path, json={"title": "One", "tags": ["a", "b"], "notes": "n"})
    body = shop.ask("ann", "PATCH", path, json={"title": "  Two "}).json()
    assert (body["title"], body["tags"], body["notes"], body["name"]) == ("Two", ["a", "b"], "n", "changed")
    assert names(shop, "search=one") == []
    body = shop.ask("ann", "PATCH", path, json={"title": "", "tags": [], "notes": ""}).json()
    assert (body["title"], body["tags"], body["notes"]) == ("", [], "")
    assert names(shop, "search=changed") == ["changed"]
    for name, status, issues in (("lea", 403, [("service.role", "Authorization")]), ("eve", 404, UNKNOWN)):
        answer = shop.ask(name, "PATCH", path, json={"title": "mine"})
        assert (answer.status_code, issue_codes(answer)) == (status, issues)
    shop.ask("ann", "DELETE", path)
    assert shop.ask("ann", "PATCH", path, json={"title": "gone"}).status_code in (200, 404)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"title": "a\u202eb"}, "title"),
        ({"title": "a\nb"}, "title"),
        ({"title": "x" * 10_000}, "title"),
        ({"title": 3}, "title"),
        ({"title": "\u3164"}, "title"),  # a letter that is not seen
        ({"title": "\u200d\ufe0f"}, "title"),  # nothing that is seen by itself
        ({"title": "\ufb2c" * 67}, "title"),  # three characters each, as they are kept
        ({"tags": ["\ufb2c" * 14]}, "tags.0"),
        ({"notes": "\ufb2c" * 667}, "notes"),
        ({"tags": ["a\u200fb"]}, "tags.0"),
        ({"tags": ["ok", ""]}, "tags.1"),
        ({"tags": ["x" * 41]}, "tags.0"),
        ({"tags": ["a"] * 21}, "tags"),
        ({"notes": "a\x00"}, "notes"),
        ({"name": "other"}, "name"),
    ],
)
def test_texts_that_hide_something_are_refused(shop: Shop, changes: dict[str, Any], field: str) -> None:
    job = shop.ask("ann", "GET", "/v1/jobs").json()["jobs"][0]
    answer = shop.ask("ann", "PATCH", f"/v1/jobs/{job['id']}", json=changes)
    assert (answer.status_code, issue_codes(answer)) == (422, [("service.request", field)])
    assert len(answer.content) < 2000
    assert shop.ask("ann", "GET", f"/v1/jobs/{job['id']}").json()["title"] == job["title"]


def test_texts_that_grow_may_be_as_long_as_others(shop: Shop) -> None:
    job = put(shop, "ann", "grown")
    said = {"title": "\ufb2c" * 66, "tags": ["\ufb2c" * 13], "notes": "\ufb2c" * 666}
    found = shop.ask("ann", "PATCH", f"/v1/jobs/{job}", json=said)
    assert (found.status_code, [len(found.json()[name]) for name in ("title", "notes")]) == (200, [198, 1998])
    assert shop.ask("ann", "GET", "/v1/jobs", params={"search": "\ufb2c" * 67}).status_code == 422
    assert shop.ask("ann", "GET", "/v1/jobs", params={"tag": "\ufb2c" * 14}).status_code == 422
    shop.ask("ann", "DELETE", f"/v1/jobs/{job}")


def test_a_zero_byte_in_an_address_is_no_500(shop: Shop) -> None:
    job = put(shop, "ann", "zero")
    described = shop.running_service.http.get("/openapi.json", headers=bearer(shop.tokens["bob"])).json()
    asked = 0
    for path, ways in described["paths"].items():
        if "{" not in path or "/webhooks" in path:
            continue
        for method in ways.keys() & {"get", "post", "patch", "delete"}:
            for first in ("%00", f"{job}%00", job if "{name}" in path else "0" * 31 + "%00"):
                url = path.replace("{job}", first).replace("{element}", first).replace("{kind}", "a%00")
                url = url.replace("{name}", "a%00.mod")
                answer = shop.ask("bob", method.upper(), url, json={})
                assert answer.status_code in (404, 422), (method, url, answer.text)
                asked += 1
    assert asked > 30
    shop.ask("ann", "DELETE", f"/v1/jobs/{job}")


def test_many_are_deleted_at_once_and_no_others(shop: Shop) -> None:
    jobs = [put(shop, "ann", f"many_{k}") for k in range(5)]
    others = put(shop, "eve", "theirs")
    asked = {"jobs": [*jobs, jobs[0], others, "0" * 32, "no id"]}
    assert shop.ask("lea", "POST", "/v1/jobs/delete", json=asked).status_code == 403
    answer = shop.ask("bob", "POST", "/v1/jobs/delete", json=asked)
    assert answer.json() == {"deleted": jobs, "unknown": [others, "0" * 32, "no id"]}
    assert names(shop, "search=many") == []
    assert names(shop, "search=theirs", by="eve") == ["theirs"]
    for wrong in ({"jobs": []}, {"jobs": ["0" * 32] * 201}, {}, {"jobs": ["x" * 41]}):
        assert shop.ask("bob", "POST", "/v1/jobs/delete", json=wrong).status_code == 422, wrong
    if shop.running_service.service.database.sqlite:
        told = shop.ask("bob", "GET", f"/v1/audit?job={jobs[0]}&act=deleted").json()["acts"]
        assert [item["by"] for item in told] == ["bob"]


def test_jobs_without_titles_are_found_by_their_names(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        job = running_service.post().json()["id"]
        for query in ("search=SMALL", "sort=title", "search=small&sort=title"):
            (found,) = running_service.http.get(f"/v1/jobs?{query}").json()["jobs"]
            assert (found["id"], found["title"], found["tags"]) == (job, "", [])
