"""Releases on the page, who may make them, and what each role sees of the page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from playwright.sync_api import Browser, Page, Route, expect

import planner
from planner.service.models import Database, default_url
from planner.service.security import Auth
from tests import small_problem
from tests.service.page.test_access import CUT_OFF, NAMELESS
from tests.service.page.test_elements_page import COUNT, shell_files, upload
from tests.service.support import Process


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, dict[str, str]]]:
    """A service that requires tokens: its address, a verified job of bob, and the tokens of the team."""
    folder = tmp_path_factory.mktemp("shop")
    data = folder / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = {
        "ann": auth.create_token("ann", "release", "shop"),
        "bob": auth.create_token("bob", "plan", "shop"),
        "lea": auth.create_token("lea", "view", "shop"),
        "cell-3": auth.create_token("cell-3", None, "shop", scope="released"),
    }
    process = Process(data, "--require-token").wait()
    client = planner.Client(process.url, tokens["bob"])
    job = client.submit(planner.load(small_problem.write(folder)))
    assert client.wait(job)["state"] == "verified"
    yield process.url, job, tokens
    process.stop()
    assert "Traceback" not in process.log.read_text()


def login(page: Page, url: str, token: str) -> None:
    page.context.request.post(f"{url}/v1/session", headers={"Authorization": f"Bearer {token}"})


def test_programs_are_released_and_withdrawn_by_name(
    page: Page, shop: tuple[str, str, dict[str, str]], tmp_path: Path
) -> None:
    url, job, tokens = shop
    login(page, url, tokens["ann"])
    page.goto(f"{url}/ui/jobs/{job}")
    expect(page.locator("#me")).to_have_text("ann · shop · release")
    expect(page.locator("#released-title")).to_contain_text("Not released")
    page.get_by_role("button", name="Release", exact=True).click()
    ask = page.get_by_role("dialog", name="Release these programs?")
    digest = planner.Client(url, tokens["lea"]).job(job)["digest"]
    expect(ask.locator("#release-what")).to_contain_text(digest[:16])
    expect(ask.locator("#release-what dt")).to_have_count(7)
    expect(ask.get_by_label("Released by")).to_be_hidden()
    page.keyboard.press("Escape")
    expect(ask).to_be_hidden()
    expect(page.locator("#released-title")).to_contain_text("Not released")
    page.get_by_role("button", name="Release", exact=True).click()
    ask.get_by_label("Note").fill("<img src=x onerror=alert(1)> Dienstag")
    ask.get_by_role("button", name="Release", exact=True).click()
    expect(page.locator("#released-title")).to_contain_text("Released: these programs may run")
    expect(page.locator("#released-list")).to_contain_text("Released by ann, ")
    expect(page.locator("#released-list")).to_contain_text("<img src=x onerror=alert(1)> Dienstag")
    with page.expect_download() as got:
        page.get_by_role("link", name="Download released programs").click()
    assert got.value.suggested_filename == "small-released.zip"
    screen = at_the_cell(page, url, tokens["cell-3"], job)
    page.get_by_role("button", name="Delete").click()
    expect(page.locator("#sure")).to_contain_text("they are released")
    page.get_by_role("button", name="Keep it").click()
    page.get_by_role("button", name="Withdraw release").click()
    ask = page.get_by_role("dialog", name="Withdraw the release?")
    ask.get_by_role("button", name="Withdraw", exact=True).click()
    expect(ask).to_be_visible()  # a reason is wanted
    ask.get_by_label("Reason").fill("the clamp moved")
    ask.get_by_role("button", name="Withdraw", exact=True).click()
    expect(page.locator("#released-title")).to_contain_text("Withdrawn")
    expect(page.locator("#released-list")).to_contain_text("withdrawn by ann")
    screen.goto(url)
    expect(screen.get_by_role("heading", name="Nothing is released")).to_be_visible()
    screen.close()
    page.goto(url)
    expect(page.locator(".jobs .sub").first).to_contain_text("by bob")


def at_the_cell(page: Page, url: str, token: str, job: str) -> Page:
    """The page for a token that reads released jobs: it shows the job, and no forbidden control."""
    browser = page.context.browser
    assert browser is not None
    screen = browser.new_page(viewport={"width": 390, "height": 844})
    refused: list[str] = []
    screen.on("response", lambda answer: refused.append(answer.url) if answer.status == 403 else None)
    login(screen, url, token)
    screen.goto(url)
    expect(screen.locator("#me")).to_have_text("cell-3 · shop · released programs only")
    screen.get_by_role("link", name="small").click()
    expect(screen.get_by_role("link", name="Download released programs")).to_be_visible()
    expect(screen.get_by_role("tab", name="Replay")).to_be_visible()
    assert screen.get_by_role("navigation").get_by_role("link").all_inner_texts() == ["Jobs"]
    assert screen.locator("#actions").get_by_role("button").count() == 0
    assert screen.locator("#actions").get_by_role("link").count() == 1
    assert (screen.evaluate(CUT_OFF), screen.evaluate(NAMELESS), refused) == ([], [], [])
    return screen


@pytest.mark.parametrize(("who", "may"), [("lea", 0), ("bob", 1), ("ann", 2)])
def test_the_page_shows_what_a_role_allows(
    browser: Browser, shop: tuple[str, str, dict[str, str]], who: str, may: int
) -> None:
    url, job, tokens = shop
    tab = browser.new_page(viewport={"width": 390, "height": 844})
    login(tab, url, tokens[who])
    tab.goto(f"{url}/ui/jobs/{job}")
    expect(tab.locator("#released")).to_be_visible()
    expect(tab.get_by_role("link", name="Download programs")).to_be_visible()
    expect(tab.get_by_role("button", name="Delete")).to_be_visible(visible=may > 0)
    expect(tab.get_by_role("link", name="New job")).to_be_visible(visible=may > 0)
    expect(tab.get_by_role("link", name="Re-run with changes")).to_be_visible(visible=may > 0)
    expect(tab.get_by_role("button", name="Release", exact=True)).to_be_visible(visible=may > 1)
    assert tab.evaluate(CUT_OFF) == []
    if may > 1:
        tab.get_by_role("button", name="Release", exact=True).click()
        assert (tab.evaluate(CUT_OFF), tab.evaluate(NAMELESS)) == ([], [])
    tab.close()


def test_who_releases_says_so_where_no_tokens_are_asked_for(page: Page, server: str, tmp_path: Path) -> None:
    client = planner.Client(server)
    job = client.submit(planner.load(small_problem.write(tmp_path)))
    client.wait(job)
    page.goto(f"{server}/ui/jobs/{job}")
    page.get_by_role("button", name="Release", exact=True).click()
    ask = page.get_by_role("dialog", name="Release these programs?")
    ask.get_by_role("button", name="Release", exact=True).click()
    expect(ask).to_be_visible()  # a name is wanted
    ask.get_by_label("Released by").fill("רות 3")
    ask.get_by_role("button", name="Release", exact=True).click()
    expect(page.locator("#released-list bdi").first).to_have_text("רות 3")
    other = client.release  # once more, meanwhile
    with pytest.raises(planner.TandemError, match="released by") as caught:
        other(job, name="Ann")
    assert caught.value.issues[0].code == "service.release"
    outcome = client.plan(planner.load(small_problem.write(tmp_path)))
    assert outcome.verified
    assert "release.json" not in outcome.files
    assert "release.json" in client.files(job)
    assert sorted(client.programs(job)) == sorted(outcome.programs)
    taken = client.withdraw(job, "a test", name="Ann")
    assert taken["withdrawn"]["by"] == "Ann"
    assert [release["by"] for release in client.releases(job)] == ["רות 3"]


def test_who_may_release_sees_what_was_done(page: Page, shop: tuple[str, str, dict[str, str]]) -> None:
    url, job, tokens = shop
    login(page, url, tokens["ann"])
    page.goto(url)
    page.get_by_role("link", name="Audit", exact=True).click()
    expect(page.locator("#rows")).to_contain_text("submitted")
    page.get_by_label("Action").select_option("submitted")
    expect(page.locator("#rows tr")).to_have_count(1)
    expect(page.locator("#rows tr")).to_contain_text("bob")
    page.get_by_label("Job").fill("0" * 32)
    expect(page.get_by_text("No matching entries.")).to_be_visible()
    page.get_by_label("Job").fill("<b>x</b>")
    expect(page.locator("#banner")).to_contain_text("job")
    page.get_by_label("Job").fill(job)
    expect(page.locator("#rows tr")).to_have_count(1)
    page.get_by_label("Job").fill("")  # a long one is moved in its field
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    page.context.clear_cookies()
    login(page, url, tokens["bob"])
    page.goto(f"{url}/ui/audit")
    expect(page.locator("#banner")).to_contain_text("required release")
    expect(page.get_by_role("link", name="Audit", exact=True)).to_be_hidden()


def test_a_link_to_look_is_made_shown_and_withdrawn(
    browser: Browser, page: Page, shop: tuple[str, str, dict[str, str]], tmp_path: Path
) -> None:
    url, job, tokens = shop
    login(page, url, tokens["bob"])
    page.goto(f"{url}/ui/jobs/{job}")
    page.get_by_role("button", name="View links").click()
    ask = page.get_by_role("dialog", name="View links of this job")
    expect(ask.locator("#looks-none")).to_be_visible()
    ask.get_by_label("Valid for [days]").fill("31")
    ask.get_by_role("button", name="Create a link").click()
    expect(ask.locator("#looks-new")).to_be_hidden()  # 30 days at most
    ask.get_by_label("Valid for [days]").fill("3")
    ask.get_by_role("button", name="Create a link").click()
    expect(ask.locator("#looks-list")).to_contain_text("created by bob")
    address = ask.get_by_label("New link, shown only once").input_value()
    stranger = browser.new_context(viewport={"width": 390, "height": 844})
    tab, asked = stranger.new_page(), list[str]()
    faults = list[str]()
    tab.on("request", lambda request: asked.append(request.url))
    tab.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
    tab.goto(address)
    expect(tab.locator("#state")).to_have_text("Verified")
    expect(tab.locator("#outcome-title")).to_contain_text("Verified")
    expect(tab.locator("#facts")).to_contain_text("this link expires")
    expect(tab.locator("#figures .tile").first).to_be_visible()
    assert (tab.evaluate(CUT_OFF), tab.evaluate(NAMELESS)) == ([], [])
    expect(tab.locator("button, input, form")).to_have_count(0)
    with stranger.expect_page() as opened:
        tab.get_by_role("link", name="Open the replay").click()
    expect(opened.value).to_have_title(re.compile("small"))
    opened.value.close()
    assert [item for item in asked if "/v1/" in item] == [
        f"{url}/v1/jobs/{job}/looks/{address.split('/')[-1]}"  # the job's data alone, once
    ]
    assert (faults, stranger.cookies()) == ([], [])
    ask.get_by_role("button", name="Withdraw the link").click()
    expect(ask.locator("#looks-none")).to_be_visible()
    tab.reload()
    expect(tab.get_by_role("alert")).to_contain_text("link: expired, withdrawn or incomplete")
    stranger.close()


def test_an_element_has_a_title_and_its_proven_panels_are_released_by_one_act(
    page: Page, server: str, tmp_path: Path
) -> None:
    """The answers of the service are simulated here; tests/service/test_elements.py tests the service."""
    state = {"A01": "verified", "A02": "verified", "A03": "infeasible", "A04": "verified"}
    said = {"A04": "withdrawn"}  # with a reason, which the dialog does not show
    sent: list[dict[str, Any]] = []

    def fulfill_states(route: Route) -> None:
        answer = route.fetch()
        body = answer.json()
        for one in body.get("panels", []):
            if one["id"] in state:
                one |= {"state": state[one["id"]], "job": "ab" * 16, "digest": "cd" * 32}
                if one["state"] == "verified":
                    one["release"] = said.get(one["id"], "not-released")
        route.fulfill(response=answer, json=body)

    def release(route: Route) -> None:
        sent.append(route.request.post_data_json)
        said["A01"] = "released"
        why = {"code": "service.release", "severity": "error", "message": "it was planned again"}
        refused = [{"panel": "A02", "issues": [why]}]
        route.fulfill(status=201, json={"releases": [{"panel": "A01"}], "refused": refused})

    page.route(re.compile("/v1/elements/[0-9a-f]{32}$"), fulfill_states)
    page.route(re.compile("/v1/elements/[0-9a-f]{32}/release$"), release)
    upload(page, server, shell_files(tmp_path))
    row = page.locator('[data-panel="A01"]')
    expect(row).to_contain_text("not released")
    page.get_by_role("button", name="Release 2 proven panels").click()
    ask = page.get_by_role("dialog", name="Release these programs?")
    expect(ask.locator("#release-count")).to_have_text(
        f"2 panels; {COUNT - 2} others excluded: not proven, already released, or withdrawn."
    )
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    ask.get_by_label("Released by").fill("רות")
    ask.get_by_label("Note").fill("<b>Nordseite</b>")
    ask.get_by_role("button", name="Release", exact=True).click()
    expect(page.locator("#banner")).to_have_text("A02 was not released: it was planned again")
    expect(row.locator(".released-released")).to_have_text("released")
    expect(page.get_by_role("button", name="Release 1 proven panel")).to_be_visible()
    shown = {"job": "ab" * 16, "digest": "cd" * 32}
    assert sent == [{"panels": {"A01": shown, "A02": shown}, "note": "<b>Nordseite</b>", "name": "רות"}]
    page.get_by_role("button", name="Title, tags, notes").click()
    ask = page.get_by_role("dialog", name="Title, tags and notes of this element")
    ask.get_by_label("Title").fill("Gewölbe <b>٣</b>")
    ask.get_by_label("Tags, separated by commas").fill("Halle, قبو")
    ask.get_by_label("Notes").fill("Dienstag")
    ask.get_by_role("button", name="Save").click()
    expect(page.locator("#name")).to_have_text("Gewölbe <b>٣</b>")
    expect(page.locator("#job-notes")).to_have_text("Dienstag")
    page.get_by_role("link", name="Halle").click()
    names = page.locator(".job-name")
    expect(names).to_have_text(["Gewölbe <b>٣</b>"])
    page.get_by_label("Find elements").fill("wand")
    expect(page.get_by_text("No matching elements.")).to_be_visible()
    page.get_by_label("Find elements").fill("dienstag gewölbe")
    expect(names).to_have_text(["Gewölbe <b>٣</b>"])
    expect(page).to_have_url(re.compile("tag=Halle.*search=dienstag"))
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


WHOLE: Final = """() => {
  const head = document.querySelector("header.top").getBoundingClientRect(), out = [];
  for (const one of document.querySelectorAll("header.top a, header.top button, #me")) {
    const box = one.getBoundingClientRect();
    const aside = box.left < head.left || box.right > head.right;
    const beyond = aside || box.top < head.top || box.bottom > head.bottom;
    const nav = one.parentElement.getBoundingClientRect();
    const seen = box.right <= nav.right + 1 && one.scrollWidth <= one.clientWidth + 1;
    if (one.checkVisibility() && (beyond || !seen)) out.push(`${one.innerText}: ${JSON.stringify(box)}`);
    if (one.matches("nav a") && box.height > 45) out.push(`${one.innerText}: in two lines`);
  }
  return out;
}"""
"""What of the head of a page is cut off, beyond it, or broken into two lines."""


def test_the_head_of_the_page_is_whole_at_each_width(
    page: Page, shop: tuple[str, str, dict[str, str]]
) -> None:
    """The head shows all pages, the user, and the logout control.

    On telephones the last page was cut off, and on tablets two words were broken into two lines.
    """
    url, _, tokens = shop
    login(page, url, tokens["ann"])
    page.goto(f"{url}/ui/audit")
    expect(page.locator("#me")).to_have_text("ann · shop · release")
    expect(page.locator("header.top nav a")).to_have_count(6)
    for width in (390, 480, 761, 768, 1000, 1001, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        expect(page.locator("#me")).to_be_visible()
        assert page.evaluate(WHOLE) == [], width
        height = page.locator("header.top").evaluate("(one) => one.offsetHeight")
        assert height < (120 if width <= 1000 else 60), width
    who = page.locator("#rows td:nth-child(2) bdi", has_text="bob").first
    page.set_viewport_size({"width": 390, "height": 900})
    assert who.evaluate("(one) => one.getClientRects().length") == 1  # and no letter of it in another line
