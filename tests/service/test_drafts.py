"""Drafts on the server: saved, also by many users at once, opened elsewhere, limited, and deleted."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pytest

from planner.cli import service as commands
from planner.issues import TandemError
from planner.service import backup, drafts
from tests.service import postgres
from tests.service.support import TABLE, issue_codes, named_problem
from tests.service.test_roles import Shop, open_service

ODD: Final = {
    "<img src=x onerror=alert(1)>": 201,
    "لوحة القبو ٣": 201,
    "W" * 200: 201,
    "ﷺ" * 100: 201,
    "a\u202eb": 422,
    "a\u200fb": 422,
    "a\x00b": 422,
    "W" * 10_000: 422,
}
"""Titles, and what is answered."""


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def shop(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    folder = tmp_path_factory.mktemp("drafts")
    database = postgres.fresh(folder) if request.param == "postgresql" else None
    with open_service(folder / "data", database) as running_service:
        yield Shop(running_service)


def body(text: str, *names: str) -> dict[str, Any]:
    """An upload of a problem, right or wrong, with files."""
    files = [("files", (name, TABLE + name.encode())) for name in names]
    return {"files": [("problem", ("problem.json", text)), *files]}


def kept(shop: Shop, by: str = "ann", text: str = "{}", *names: str, **query: str) -> str:
    answer = shop.ask(by, "POST", "/v1/drafts", params={"title": "Vault", **query}, **body(text, *names))
    assert answer.status_code == 201, answer.text
    assert answer.headers["ETag"] == '"1"'
    return str(answer.json()["id"])


def save(shop: Shop, draft: str, tag: str, text: str, *names: str, by: str = "ann", **query: Any) -> Any:
    token = {"Authorization": f"Bearer {shop.tokens[by]}", "If-Match": tag}
    url = f"/v1/drafts/{draft}"
    return shop.running_service.http.put(url, headers=token, params=query, **body(text, *names))


def content(shop: Shop, draft: str, number: int, by: str = "ann") -> tuple[str, dict[str, bytes]]:
    url = f"/v1/drafts/{draft}/versions/{number}"
    names = [file["name"] for file in shop.ask(by, "GET", url).json()["files"]]
    files = {name: shop.ask(by, "GET", f"{url}/files/{name}").content for name in names}
    return shop.ask(by, "GET", f"{url}/problem").text, files


def test_a_draft_is_saved_and_opened_again_as_it_was_at_any_time(shop: Shop) -> None:
    draft = kept(shop, "ann", '{"a": [not a problem', "dome.stl", "Gewölbe ٣.csv")
    assert save(shop, draft, '"1"', "{}", "dome.stl").headers["ETag"] == '"2"'  # the other file stays
    assert save(shop, draft, 'W/"2"', "{}").headers["ETag"] == '"2"'  # nothing is new
    again = save(shop, draft, '"2"', '{"b": 1}', "more.csv", by="bob", without=["dome.stl"])
    assert (again.status_code, again.json()["version"]) == (200, 3)
    first, second, third = (content(shop, draft, n, "bob") for n in (1, 2, 3))
    assert first[0] == '{"a": [not a problem'
    assert first[1] == {name: TABLE + name.encode() for name in ("dome.stl", "Gewölbe ٣.csv")}
    assert (second[0], second[1]) == ("{}", first[1])
    assert (third[0], set(third[1])) == ('{"b": 1}', {"Gewölbe ٣.csv", "more.csv"})
    body = shop.ask("lea", "GET", f"/v1/drafts/{draft}").json()
    assert [(version["number"], version["by"]) for version in body["versions"]] == [
        (3, "bob"),
        (2, "ann"),
        (1, "ann"),
    ]
    assert body["versions"][0]["at"] >= body["versions"][2]["at"]


def test_who_saves_over_another_is_told_and_nothing_is_lost(shop: Shop) -> None:
    draft = kept(shop)
    assert save(shop, draft, '"1"', "theirs", by="bob").status_code == 200
    refused = save(shop, draft, '"1"', "mine")
    assert (refused.status_code, issue_codes(refused)) == (412, [("service.draft", "If-Match")])
    assert "bob saved version 2" in refused.json()["detail"]
    assert "save yours as another draft" in refused.json()["detail"]
    assert content(shop, draft, 2)[0] == "theirs"
    token = {"Authorization": f"Bearer {shop.tokens['ann']}"}
    without = shop.running_service.http.put(f"/v1/drafts/{draft}", headers=token, **body("mine"))
    assert (without.status_code, issue_codes(without)) == (428, [("service.draft", "If-Match")])
    for tag in ("x" * 101, '"9"', "2", "", '"1", "3"'):
        assert save(shop, draft, tag, "mine").status_code in (412, 422), tag
    assert save(shop, draft, '"1", "2"', "mine").json()["version"] == 3


def test_a_title_is_changed_with_the_content_unless_somebody_gave_another(shop: Shop) -> None:
    draft = kept(shop)
    first = save(shop, draft, '"1"', '{"name": "a"}', title="a", instead="Vault").json()
    assert (first["title"], first["version"]) == ("a", 2)
    shop.ask("bob", "PATCH", f"/v1/drafts/{draft}", json={"title": "Gewölbe 3"})
    kept_on = save(shop, draft, '"2"', '{"name": "b"}', title="b", instead="a").json()
    assert (kept_on["title"], kept_on["version"]) == ("Gewölbe 3", 3)
    assert save(shop, draft, '"2"', "{}", title="c").status_code == 412
    assert shop.ask("ann", "GET", f"/v1/drafts/{draft}").json()["title"] == "Gewölbe 3"
    assert save(shop, draft, '"3"', "{}").json()["title"] == "Gewölbe 3"
    assert save(shop, draft, '"4"', "{}", title="").json()["title"] == "Draft"
    odd = save(shop, draft, '"4"', "{}", title="a\u202eb")
    assert (odd.status_code, issue_codes(odd)) == (422, [("service.request", "title")])


def test_of_many_who_save_the_same_version_at_once_one_does(shop: Shop) -> None:
    draft = kept(shop)
    with ThreadPoolExecutor(6) as pool:
        futures = [pool.submit(save, shop, draft, '"1"', f'"{n}"') for n in range(6)]
        answers = [item.result() for item in futures]
    assert sorted(item.status_code for item in answers) == [200, *[412] * 5]
    (won,) = (n for n, item in enumerate(answers) if item.status_code == 200)
    assert content(shop, draft, 2)[0] == f'"{won}"'


def test_old_versions_go_with_what_they_alone_named(shop: Shop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drafts, "MAX_VERSIONS", 3)
    draft = kept(shop, "ann", "0", "first.csv")
    save(shop, draft, '"1"', "1", without=["first.csv"])
    for number in range(2, 6):
        assert save(shop, draft, f'"{number}"', str(number)).status_code == 200
    body = shop.ask("ann", "GET", f"/v1/drafts/{draft}").json()
    assert [version["number"] for version in body["versions"]] == [6, 5, 4]
    gone = shop.ask("ann", "GET", f"/v1/drafts/{draft}/versions/1/problem")
    assert (gone.status_code, issue_codes(gone)) == (404, [("service.draft", "number")])
    assert "not found" in gone.json()["detail"]
    with shop.running_service.service.database.read() as db:
        query = drafts.select(drafts.FILES.c.name).where(drafts.FILES.c.job == draft)
        assert len(db.execute(query).all()) == 3


@pytest.mark.parametrize(("title", "status"), ODD.items(), ids=map(ascii, ODD))
def test_titles_in_any_language(shop: Shop, title: str, status: int) -> None:
    asked = {"params": {"title": title}, **body("{}")}
    made = shop.ask("ann", "POST", "/v1/drafts", **asked)
    assert made.status_code == status, made.text
    draft = kept(shop)
    named = shop.ask("ann", "PATCH", f"/v1/drafts/{draft}", json={"title": title})
    assert named.status_code == {201: 200}.get(status, status)
    if status == 201:
        assert made.json()["title"] == named.json()["title"] == title
        assert named.headers["ETag"] == '"1"'


def test_drafts_are_those_of_the_team_and_of_nobody_else(shop: Shop) -> None:
    draft = kept(shop, "ann", "{}", "dome.stl", kind="cell")
    addresses = [
        ("GET", ""),
        ("GET", "/versions/1"),
        ("GET", "/versions/1/problem"),
        ("GET", "/versions/1/files/dome.stl"),
        ("PUT", ""),
        ("PATCH", ""),
        ("POST", "/sent"),
        ("DELETE", ""),
    ]
    for other in ("eve", "dan"):
        for way, path in addresses:
            more = {"json": {"title": "x"}} if way == "PATCH" else {}
            if way == "PUT":
                answer = save(shop, draft, "*", "{}", by=other)
            else:
                answer = shop.ask(other, way, f"/v1/drafts/{draft}{path}", **more)
            assert (answer.status_code, issue_codes(answer)) == (404, [("service.draft", None)]), (way, path)
        listed = shop.ask(other, "GET", "/v1/drafts").json()["drafts"]
        assert draft not in [item["id"] for item in listed]
    cells = shop.ask("lea", "GET", "/v1/drafts?kind=cell").json()["drafts"]
    assert [item["id"] for item in cells] == [draft]
    assert cells[0]["by"] == "ann"
    for way in ("PUT", "PATCH", "DELETE", "POST"):
        url = "/v1/drafts" if way == "POST" else f"/v1/drafts/{draft}"
        assert shop.ask("lea", way, url, content=b"{}").status_code == 403


def test_a_draft_says_as_which_job_it_was_sent(shop: Shop) -> None:
    draft, job = kept(shop), shop.job("bob", "sent")
    told = {"version": 1, "job": job}
    marked = shop.ask("ann", "POST", f"/v1/drafts/{draft}/sent", json=told).json()
    assert (marked["sent"], marked["job"], marked["version"]) == (1, job, 1)
    changed = save(shop, draft, '"1"', '{"b": 2}').json()
    assert (changed["sent"], changed["job"], changed["version"]) == (1, job, 2)  # what is newer was not sent
    newer = shop.job("bob", "newer")
    for number, last in ((2, newer), (1, job)):  # a late report about the previous version changes nothing
        marked = shop.ask(
            "ann", "POST", f"/v1/drafts/{draft}/sent", json={"version": number, "job": last}
        ).json()
        assert (marked["sent"], marked["job"]) == (2, newer)
    eves = shop.job("eve", "hers")
    for wrong, code in (
        ({"version": 9, "job": job}, ("service.draft", "number")),
        ({"version": 1, "job": eves}, ("service.unknown_job", None)),
        ({"version": 0, "job": job}, ("service.request", "version")),
        ({"version": 1, "job": "x"}, ("service.request", "job")),
    ):
        refused = shop.ask("ann", "POST", f"/v1/drafts/{draft}/sent", json=wrong)
        assert issue_codes(refused) == [code]
    assert shop.ask("bob", "DELETE", f"/v1/jobs/{newer}").status_code == 204
    (listed,) = (
        item for item in shop.ask("ann", "GET", "/v1/drafts").json()["drafts"] if item["id"] == draft
    )
    assert (listed["sent"], listed["job"]) == (2, None)


def test_sweeps_and_batches_say_of_which_drafts_they_were_sent(shop: Shop) -> None:
    a, b, c = (kept(shop, "ann", named_problem(f"draft_{k}")) for k in "abc")
    eves = kept(shop, "eve", named_problem("hers"))
    form = [("files", ("targets.csv", TABLE))]
    parts = [("problem", (f"{k}.yaml", named_problem(f"draft_{k}"))) for k in "bc"]
    many = {"tag": "t", "draft": [f"{b}@1", f"{c}@1"]}
    swept = {"field": "operations.0.feed_mm_s", "value": ["20", "30"], "draft": f"{a}@1"}
    for url, files, query in (
        ("/v1/sweeps", [("problem", ("a.yaml", named_problem("draft_a"))), *form], swept),
        ("/v1/batches", [*parts, *form], many),
    ):
        for wrong, status in (
            (f"{eves}@1", 404),
            (f"{a}@2", 404),
            (f"{a}@0", 422),
            (f"{a}@1\n", 422),
            (a, 422),
        ):
            refused = shop.ask("ann", "POST", url, files=files, params={**query, "draft": wrong})
            assert refused.status_code == status, refused.text
        made = shop.ask("ann", "POST", url, files=files, params=query)
        assert made.status_code == 201, made.text
        drafts_of = [a] if url == "/v1/sweeps" else [b, c]
        for draft, job in zip(drafts_of, made.json()["jobs"], strict=False):
            body = shop.ask("bob", "GET", f"/v1/drafts/{draft}").json()
            assert (body["sent"], body["job"]) == (1, job["id"])
    assert shop.ask("eve", "GET", f"/v1/drafts/{eves}").json()["sent"] is None


def test_pages_of_drafts_miss_none(shop: Shop) -> None:
    """Also where many were changed at one moment."""
    made = [kept(shop, "eve", str(n)) for n in range(5)]
    with shop.running_service.service.database.write() as db:
        db.execute(drafts.update(drafts.DRAFTS).where(drafts.DRAFTS.c.id.in_(made)).values(changed=1e9))
    found, asked = list[str](), dict[str, Any](limit=2)
    while True:
        page = shop.ask("eve", "GET", "/v1/drafts", params=asked).json()
        assert len(page["drafts"]) <= 2
        found += [item["id"] for item in page["drafts"]]
        if page["next"] is None:
            break
        asked["cursor"] = page["next"]
    assert [item for item in found if item in made] == sorted(made, reverse=True)
    assert len(found) == len(set(found))
    whole = shop.ask("eve", "GET", "/v1/drafts").json()
    assert (found, whole["next"]) == ([item["id"] for item in whole["drafts"]], None)
    for wrong in ("x", "1-2", "~" + "0" * 32):
        refused = shop.ask("eve", "GET", "/v1/drafts", params={"cursor": wrong})
        assert (refused.status_code, issue_codes(refused)) == (422, [("service.request", "cursor")])


def test_a_link_to_a_deleted_draft_has_a_sentence(shop: Shop) -> None:
    draft = kept(shop)
    assert shop.ask("bob", "DELETE", f"/v1/drafts/{draft}").status_code == 204
    for answer in (
        shop.ask("ann", "GET", f"/v1/drafts/{draft}"),
        shop.ask("ann", "DELETE", f"/v1/drafts/{draft}"),
        save(shop, draft, '"1"', "{}"),
    ):
        assert answer.status_code == 404
        assert "It was deleted, or belongs to others" in answer.json()["detail"]
    acts = shop.ask("bob", "GET", f"/v1/audit?job={draft}").json()["acts"]
    assert [(act["by"], act["act"], act["about"]["kind"]) for act in acts] == [("bob", "deleted", "draft")]


@pytest.mark.parametrize("action", ["to", "delete"])
def test_drafts_of_who_left_are_passed_on_or_deleted(
    tmp_path: Path, action: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A revoked token without a team: nobody else sees its drafts."""
    data = tmp_path / "data"
    with open_service(data, None) as running_service:
        made = Shop(running_service)
        draft, _ = kept(made, "dan", '"kept"', "dome.stl"), kept(made, "ann")
        running_service.service.auth.revoke("dan")
        commands.token(commands.Drafts("dan", data=data))
        assert f"{draft}  " in capsys.readouterr().out
        assert made.ask("bob", "GET", f"/v1/drafts/{draft}").status_code == 404
        commands.token(
            commands.Drafts("dan", **({"to": "bob"} if action == "to" else {"delete": True}), data=data)
        )
        assert "dan: 1 drafts" in capsys.readouterr().out
        if action == "to":
            assert content(made, draft, 1, "ann") == ('"kept"', {"dome.stl": TABLE + b"dome.stl"})
            assert made.ask("bob", "DELETE", f"/v1/drafts/{draft}").status_code == 204
        with running_service.service.database.read() as db:
            assert not db.execute(drafts.select(drafts.FILES).where(drafts.FILES.c.job == draft)).all()
        assert len(made.ask("ann", "GET", "/v1/drafts").json()["drafts"]) == 1
        commands.audit(commands.Audit(job=draft, data=data))
        output = capsys.readouterr().out
        assert (
            f"{drafts.OPERATOR_NAME}  {'passed' if action == 'to' else 'deleted'}  {draft}  Vault" in output
        )
    for wrong in (
        {"name": "nobody"},
        {"name": "dan", "to": "nobody"},
        {"name": "dan", "to": "bob", "delete": True},
    ):
        with pytest.raises(TandemError) as caught:
            commands.token(commands.Drafts(**wrong, data=data))
        assert [issue.code for issue in caught.value.issues] == ["service.token"]


def test_count_and_size_are_limited_and_room_is_charged(shop: Shop, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = shop.running_service.service.limits
    have = len(shop.ask("dan", "GET", "/v1/drafts").json()["drafts"])
    draft = kept(shop, "dan", json.dumps("w" * 300_000))
    used = shop.ask("dan", "GET", "/v1/storage").json()["used_mb"]
    object.__setattr__(limits, "drafts", have + 1)
    answer = shop.ask("dan", "POST", "/v1/drafts", **body("{}"))
    object.__setattr__(limits, "drafts", 500)
    assert (answer.status_code, issue_codes(answer)) == (429, [("service.too_many", None)])
    monkeypatch.setattr(drafts, "MAX_YAML_BYTES", 1000)
    for long in (
        shop.ask("dan", "POST", "/v1/drafts", **body("w" * 1001)),
        save(shop, draft, '"1"', "w" * 1001, by="dan"),
    ):
        assert (long.status_code, issue_codes(long)) == (413, [("service.too_large", "problem")])
    maximum = save(shop, draft, '"1"', "{}", *(f"{n}.csv" for n in range(limits.files)), by="dan")
    assert maximum.status_code == 200
    more = save(shop, draft, '"2"', "{}", "more.csv", by="dan")
    assert (more.status_code, issue_codes(more)) == (422, [("service.request", "files")])
    assert used > 0.3


def test_who_saves_a_draft_of_another_cannot_fill_the_room_of_that_one(shop: Shop) -> None:
    """Ann's versions are Ann's files, whoever of her team saves them."""
    draft, _ = kept(shop), kept(shop, "ann", json.dumps("v" * 1_000_000))
    used = shop.ask("ann", "GET", "/v1/storage").json()["used_mb"]
    object.__setattr__(shop.running_service.service.limits, "token_disk_mb", used + 0.1)
    try:
        refused = save(shop, draft, '"1"', json.dumps("w" * 300_000), by="bob")
    finally:
        object.__setattr__(shop.running_service.service.limits, "token_disk_mb", 20_000.0)
    assert (refused.status_code, issue_codes(refused)) == (507, [("service.storage", "files")])
    assert "the files of the draft's owner would be too large" in refused.text
    assert shop.ask("ann", "GET", f"/v1/drafts/{draft}").json()["version"] == 1


def test_clocks_that_jump_do_not_lose_a_draft(shop: Shop, monkeypatch: pytest.MonkeyPatch) -> None:
    if not shop.running_service.service.database.sqlite:
        pytest.skip("PostgreSQL has its own clock")
    draft = kept(shop)
    real = time.time
    for years in (10, -10):
        monkeypatch.setattr(time, "time", lambda years=years: real() + years * 3e7)
        number = shop.ask("ann", "GET", f"/v1/drafts/{draft}").json()["version"]
        assert save(shop, draft, f'"{number}"', str(years)).status_code == 200
    monkeypatch.setattr(time, "time", real)
    assert content(shop, draft, 3)[0] == "-10"


def test_files_of_drafts_are_neither_swept_nor_left_out_of_backups(tmp_path: Path) -> None:
    with open_service(tmp_path / "data", None) as running_service:
        made = Shop(running_service)
        draft = kept(made, "ann", '"kept"', "dome.stl")
        copy = backup.back_up(tmp_path / "data", None, tmp_path / "copy")
        assert (copy.jobs, copy.files) == (0, 2)
        assert running_service.service.files.sweep(running_service.service.jobs.used_shas) == 0
        for path in running_service.service.files.root.glob("??/*"):
            path.touch()
            assert running_service.service.jobs.used_shas([path.name]) == {path.name}
    backup.restore(tmp_path / "copy", tmp_path / "new", None)
    with sqlite3.connect(tmp_path / "new" / "tandem.db") as db:
        assert db.execute("SELECT id, title FROM tandem_drafts").fetchall() == [(draft, "Vault")]
