"""The same button in many tabs at once, and parts of files that are released, withdrawn and linked.

What everybody sees is the state after the last change.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.service.support import BASE_URL, issue_codes, named_problem
from tests.service.test_roles import UNKNOWN, bearer, open_service
from tests.service.test_scopes import ScopedShop

TABS = 6


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ScopedShop]:
    with open_service(tmp_path_factory.mktemp("tabs") / "data", None) as running_service:
        yield ScopedShop(running_service)


def count_statuses(ask: Callable[[int], Any]) -> Counter[int]:
    """How often each status comes back from as many tabs."""
    with ThreadPoolExecutor(TABS) as pool:
        return Counter(answer.status_code for answer in pool.map(ask, range(TABS)))


def test_one_of_many_tabs_releases_and_one_withdraws(shop: ScopedShop) -> None:
    job = shop.job("ann", "tabs")
    path = f"/v1/jobs/{job}"
    status_counts = count_statuses(
        lambda tab: shop.ask("bob", "POST", f"{path}/release", json={"note": f"tab {tab}"})
    )
    assert status_counts == {201: 1, 409: TABS - 1}
    assert len(shop.ask("bob", "GET", f"{path}/releases").json()["releases"]) == 1
    status_counts = count_statuses(
        lambda tab: shop.ask("bob", "POST", f"{path}/withdraw", json={"reason": f"tab {tab}"})
    )
    assert status_counts == {200: 1, 409: TABS - 1}
    assert shop.ask("screen", "GET", path).status_code == 404


def test_tabs_that_release_and_withdraw_at_once_leave_what_the_list_says(shop: ScopedShop) -> None:
    job = shop.job("ann", "both")
    path = f"/v1/jobs/{job}"

    def press(tab: int) -> Any:
        way, body = ("withdraw", {"reason": "x"}) if tab % 2 else ("release", {})
        return shop.ask("bob", "POST", f"{path}/{way}", json=body)

    for _ in range(3):
        assert count_statuses(press).keys() <= {200, 201, 409}
        last = shop.ask("bob", "GET", f"{path}/releases").json()["releases"]
        released = sum(item.get("withdrawn") is None for item in last)
        assert released in (0, 1)
        assert (shop.ask("screen", "GET", path).status_code == 200) == bool(released)


def test_one_of_many_tabs_deletes_and_no_tab_revives(shop: ScopedShop) -> None:
    job = shop.job("ann", "gone")
    look = shop.ask("ann", "POST", f"/v1/jobs/{job}/looks").json()
    status_counts = count_statuses(
        lambda tab: shop.ask("ann", "DELETE", f"/v1/jobs/{job}/looks/{look['id']}")
    )
    assert status_counts[204] >= 1 and status_counts.keys() <= {204, 404}
    status_counts = count_statuses(lambda tab: shop.ask("ann", "DELETE", f"/v1/jobs/{job}"))
    assert status_counts[204] >= 1 and status_counts.keys() <= {204, 404}
    for way, path in (("POST", "/release"), ("POST", "/retry"), ("POST", "/looks"), ("POST", "/first")):
        answer = shop.ask("bob", way, f"/v1/jobs/{job}{path}", json={})
        assert (answer.status_code, issue_codes(answer)) == (404, UNKNOWN), path


def test_tabs_that_try_again_at_once_run_a_job_that_is_done_no_more(shop: ScopedShop) -> None:
    status_counts = count_statuses(lambda tab: shop.ask("ann", "POST", f"/v1/jobs/{shop.held}/retry"))
    assert status_counts == {409: TABS}
    assert shop.ask("ann", "GET", f"/v1/jobs/{shop.held}").json()["state"] == "verified"


@pytest.mark.parametrize("method", ["GET", "HEAD"])
@pytest.mark.parametrize("part", ["bytes=0-0", "bytes=-1", "bytes=0-,0-", "bytes=99999999-", "x=1-2"])
def test_parts_of_what_a_screen_may_not_read_are_as_closed_as_the_whole(
    shop: ScopedShop, method: str, part: str
) -> None:
    headers = bearer(shop.tokens["screen"]) | {"Range": part}
    for job, name in (
        (shop.out, "problem/problem.yaml"),
        (shop.out, "plan.json"),
        (shop.held, "programs/main.mod"),
        (shop.theirs, "programs/main.mod"),
    ):
        answer = shop.running_service.http.request(method, f"/v1/jobs/{job}/files/{name}", headers=headers)
        assert answer.status_code == 404, (job, name)
        assert not {"content-range", "etag", "tandem-release"} & answer.headers.keys()


def test_parts_without_number_are_not_sent_in_multiples(shop: ScopedShop) -> None:
    path = f"/v1/jobs/{shop.out}/programs.zip"
    whole = shop.ask("screen", "GET", path)
    part = "bytes=" + ",".join(["0-"] * 400)
    answer = shop.running_service.http.get(path, headers=bearer(shop.tokens["screen"]) | {"Range": part})
    assert answer.status_code in (200, 206, 400, 416)
    assert len(answer.content) < 2 * len(whole.content) + 1000


def test_no_download_is_put_together_of_two_releases(shop: ScopedShop) -> None:
    job = shop.job("ann", "parts")
    path, who = f"/v1/jobs/{job}/programs.zip", bearer(shop.tokens["screen"])
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={"note": "one"}).status_code == 201
    first = shop.running_service.http.get(path, headers=who)
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/withdraw", json={"reason": "x"}).status_code == 200
    assert shop.ask("bob", "POST", f"/v1/jobs/{job}/release", json={"note": "two"}).status_code == 201
    rest = {"Range": "bytes=10-", "If-Range": first.headers["ETag"]}
    answer = shop.running_service.http.get(path, headers=who | rest)
    assert answer.status_code == 200 and answer.headers["ETag"] != first.headers["ETag"]
    rest["If-Range"] = answer.headers["ETag"]
    again = shop.running_service.http.get(path, headers=who | rest)
    assert again.status_code == 206 and again.content == answer.content[10:]


def test_a_link_gives_no_more_by_parts_by_its_query_or_to_a_scope(shop: ScopedShop) -> None:
    asked = shop.ask("ann", "POST", f"/v1/jobs/{shop.held}/links?name=report.html")
    link = asked.json()["path"]
    browser = TestClient(shop.running_service.http.app, base_url=BASE_URL)
    assert browser.get(link, headers={"Range": "bytes=0-3"}).status_code == 206
    assert browser.head(link).status_code == 200
    query = link.split("?")[1]
    for other in ("proof.json", "programs/main.mod", "report.html/../proof.json", "%2e%2e/report.html"):
        assert browser.get(f"/v1/jobs/{shop.held}/files/{other}?{query}").status_code in (403, 404), other
        assert browser.head(f"/v1/jobs/{shop.held}/files/{other}?{query}").status_code in (403, 404), other
    assert browser.get(f"/v1/jobs/{shop.held}/programs.zip?{query}").status_code == 401
    for more in ("&signature=0", "&expires=9999999999", "&expires=0"):
        assert browser.get(f"{link}{more}").status_code in (403, 422), more
    for name in ("script", "screen", "tagged"):  # who may not make links has none made by what it may ask
        for path in (f"/v1/jobs/{shop.out}/links?name=report.html", f"/v1/jobs/{shop.out}/looks"):
            assert shop.ask(name, "POST", path).status_code == 403


def test_a_script_learns_nothing_of_its_team_by_keys_files_and_names(shop: ScopedShop) -> None:
    key = {"Idempotency-Key": "the-same"}
    mine = shop.running_service.post(named_problem("keyed"), headers=bearer(shop.tokens["ann"]) | key).json()[
        "id"
    ]
    own = shop.running_service.post(
        named_problem("keyed"), headers=bearer(shop.tokens["script"]) | key
    ).json()["id"]
    assert own != mine and shop.listed_names("script").isdisjoint({mine})
    assert shop.ask("script", "GET", "/v1/jobs?search=keyed").json()["jobs"][0]["id"] == own
    for query in (
        f"?cursor=x~{mine}&sort=title",
        f"?search={mine}",
        "?tag=Cell%203",
        "?state=verified&limit=200",
    ):
        told = shop.ask("script", "GET", f"/v1/jobs{query}")
        assert told.status_code == 422 or not {mine, shop.out, shop.held} & {
            job["id"] for job in told.json()["jobs"]
        }, query


@pytest.mark.parametrize("name", ["../../etc/x", "a/b", "..", "CON\\x", "a\u202eb", "<b>x</b>", "x" * 10_000])
def test_names_that_would_be_paths_in_a_zip_are_no_names_of_problems(shop: ScopedShop, name: str) -> None:
    answer = shop.running_service.post(named_problem(name), headers=bearer(shop.tokens["script"]))
    assert answer.status_code == 422
    assert {issue["code"].split(".")[0] for issue in answer.json()["issues"]} == {"problem"}
