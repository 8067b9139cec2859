"""Drafts on the page: kept while one edits, stepped back, opened elsewhere, saved by two, kept for later."""

from __future__ import annotations

import json
import re
import urllib.request
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.service.page.test_access import CUT_OFF, NAMELESS

KEPT = re.compile("Kept as the draft .*, version")


def begun(page: Page, server: str, name: str = "engrave") -> None:
    page.goto(f"{server}/ui/new?example={name}")
    expect(page.locator("#f-name")).to_be_attached()
    expect(page.locator("#draft-bar")).to_be_visible()


def called(page: Page, name: str) -> None:
    """Change the name of the problem."""
    page.locator("#f-name").fill(name)
    page.locator("#f-name").blur()


def asked(server: str, path: str, method: str = "GET", body: Any = None, kind: str = "json") -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"{server}{path}", data, {"Content-Type": f"application/{kind}"})
    request.method = method
    with urllib.request.urlopen(request) as answer:
        text = answer.read()
    return json.loads(text) if text else None


def settled(page: Page, server: str, name: str) -> int:
    """The version in which the name of the problem is kept, when all of it is."""
    expect(page.locator("#f-name")).to_have_value(name)
    expect(page.locator("#draft-bar[data-kept=true]")).to_be_visible()
    draft = draft_of(page)
    number = int(asked(server, f"/v1/drafts/{draft}")["version"])
    assert asked(server, f"/v1/drafts/{draft}/versions/{number}/problem")["name"] == name
    return number


def draft_of(page: Page) -> str:
    expect(page).to_have_url(re.compile(r"draft=[0-9a-f]{32}"))
    return page.url.partition("draft=")[2][:32]


@pytest.mark.long
def test_what_is_edited_is_kept_and_opened_on_another_machine(
    page: Page, browser: Browser, server: str
) -> None:
    begun(page, server)
    expect(page.get_by_role("button", name="Undo", exact=True)).to_be_disabled()
    called(page, "first")
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    draft = draft_of(page)
    called(page, "second")
    assert settled(page, server, "second") > 1
    page.get_by_role("button", name="Undo", exact=True).click()
    expect(page.locator("#f-name")).to_have_value("first")
    page.get_by_role("button", name="Redo", exact=True).click()
    expect(page.locator("#f-name")).to_have_value("second")
    page.get_by_role("button", name="Undo", exact=True).click()
    page.get_by_role("button", name="Undo", exact=True).click()
    last = settled(page, server, "engrave")

    other = browser.new_context().new_page()
    other.set_default_timeout(90_000)
    other.goto(f"{server}/ui/drafts")
    other.locator(f"#rows a[href$='{draft}']").click()
    expect(other.locator("#f-name")).to_have_value("engrave")
    assert draft_of(other) == draft
    other.get_by_role("button", name="History").click()
    expect(other.locator("#history-list li")).to_have_count(last)
    other.set_viewport_size({"width": 390, "height": 844})
    assert (other.evaluate(CUT_OFF), other.evaluate(NAMELESS)) == ([], [])
    other.get_by_role("button", name="Take version 1").click()
    expect(other.locator("#f-name")).to_have_value("first")
    assert settled(other, server, "first") == last + 1

    called(page, "mine")  # in the first window, of the version before
    conflict = page.locator("#draft-conflict")
    expect(conflict).to_contain_text(f"saved version {last + 1} of it meanwhile")
    assert asked(server, f"/v1/drafts/{draft}")["version"] == last + 1
    page.get_by_role("button", name="Keep mine as another draft").click()
    expect(page.locator("#draft-state")).to_have_text("Kept as the draft mine, version 1")
    assert draft_of(page) != draft
    other.context.close()


def test_a_name_that_no_title_may_have_is_kept_all_the_same(page: Page, server: str) -> None:
    begun(page, server)
    called(page, "a\u202eb\u0007 Gewölbe " + "\U0001f3db" * 200)
    expect(page.locator("#draft-state")).to_contain_text("Kept as the draft ab Gewölbe ")
    expect(page.locator("#draft-state")).to_contain_text("what no title may have of the name is left out")
    kept = asked(server, f"/v1/drafts/{draft_of(page)}")
    assert kept["title"] == "ab Gewölbe " + "\U0001f3db" * 189
    assert asked(server, f"/v1/drafts/{kept['id']}/versions/1/problem")["name"].startswith("a\u202eb\u0007")


@pytest.mark.long
def test_a_title_goes_with_the_name_until_somebody_gives_another(page: Page, server: str) -> None:
    begun(page, server)
    called(page, "wing_1")
    draft = draft_of(page)
    called(page, "wing_2")
    settled(page, server, "wing_2")
    assert asked(server, f"/v1/drafts/{draft}")["title"] == "wing_2"
    page.reload()  # it is known of a draft that is opened, too
    called(page, "wing_3")
    settled(page, server, "wing_3")
    expect(page.locator("#draft-state")).to_contain_text("Kept as the draft wing_3, version")
    asked(server, f"/v1/drafts/{draft}", "PATCH", {"title": "Flügel"})  # while it is open
    called(page, "wing_4")
    settled(page, server, "wing_4")
    expect(page.locator("#draft-state")).to_contain_text("Kept as the draft Flügel, version")
    assert asked(server, f"/v1/drafts/{draft}")["title"] == "Flügel"


@pytest.mark.long
def test_a_draft_that_was_sent_is_no_unsent_work(page: Page, server: str) -> None:
    """Also where it was not kept yet when it was sent."""
    begun(page, server)
    called(page, "sent_1")
    draft = draft_of(page)
    page.locator("#f-name").fill("sent_2")
    expect(page.get_by_role("button", name="Start planning")).to_be_enabled()
    page.get_by_role("button", name="Start planning").click()
    expect(page).to_have_url(re.compile("/ui/jobs/[0-9a-f]{32}"))
    job = page.url.rpartition("/")[2]
    asked(server, f"/v1/jobs/{job}/cancel", "POST")
    kept = asked(server, f"/v1/drafts/{draft}")
    assert (kept["sent"], kept["job"]) == (kept["version"], job)
    assert asked(server, f"/v1/drafts/{draft}/versions/{kept['version']}/problem")["name"] == "sent_2"
    page.goto(f"{server}/ui/drafts")
    row = page.locator("#rows tr").filter(has_text=kept["title"]).filter(has_text="sent as a job").first
    expect(row.get_by_role("link", name="a job")).to_have_attribute("href", f"/ui/jobs/{job}")
    page.goto(f"{server}/ui/new")
    expect(page.locator("#processes label").first).to_be_visible()
    expect(page.locator(f"#kept option[value='{draft}']")).to_have_count(0)
    page.goto(f"{server}/ui/new?draft={draft}")
    expect(page.locator("#draft-state")).to_contain_text("was sent; changes go on from there")
    expect(page.get_by_role("link", name="Its job")).to_be_visible()
    called(page, "sent_3")
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    asked(server, f"/v1/jobs/{job}", "DELETE")


@pytest.mark.long
def test_a_draft_that_was_swept_is_no_unsent_work(page: Page, server: str) -> None:
    begun(page, server)
    called(page, "swept_1")
    draft = draft_of(page)
    page.locator("#f-name").fill("swept_2")
    page.get_by_text("Sweep a field over values").click()
    page.get_by_label("Field", exact=True).fill("operations.0.feed_mm_s")
    page.get_by_label("Values, with spaces between").fill("20 30")
    page.get_by_role("button", name="Make 2 jobs").click()
    expect(page).to_have_url(re.compile("tag=sweep"))
    kept = asked(server, f"/v1/drafts/{draft}")
    assert kept["sent"] == kept["version"]
    assert asked(server, f"/v1/drafts/{draft}/versions/{kept['version']}/problem")["name"] == "swept_2"
    jobs = asked(server, "/v1/jobs?tag=sweep")["jobs"]
    assert kept["job"] in [one["id"] for one in jobs]
    for one in jobs:
        asked(server, f"/v1/jobs/{one['id']}/cancel", "POST")
        asked(server, f"/v1/jobs/{one['id']}", "DELETE")


@pytest.mark.long
def test_a_draft_that_was_deleted_is_told(page: Page, server: str) -> None:
    begun(page, server)
    called(page, "gone")
    draft = draft_of(page)
    asked(server, f"/v1/drafts/{draft}", "DELETE")
    called(page, "gone_2")
    expect(page.locator("#draft-state")).to_contain_text("was deleted elsewhere")
    called(page, "gone_3")
    expect(page.locator("#draft-state")).to_have_text("Kept as the draft gone_3, version 1")
    page.goto(f"{server}/ui/new?draft={draft}")
    expect(page.locator("#banner")).to_contain_text("it was deleted, or belongs to others")


@pytest.mark.parametrize("title", ["Gewölbe ٣ <b>x</b>", "لوحة القبو"])
def test_cells_tools_and_templates_are_kept_and_used_again(page: Page, server: str, title: str) -> None:
    begun(page, server)
    names = {"cell": "Keep the cell", "tool": "Keep its tool", "template": "Keep as a template"}
    for kind, name in names.items():
        page.get_by_role("button", name=name).click()
        page.get_by_label("Title, in any language").fill("a\u202eb")
        page.get_by_role("dialog").get_by_role("button", name="Keep", exact=True).click()
        expect(page.locator("#banner")).to_contain_text("right-to-left override")
        page.get_by_role("button", name=name).click()
        page.keyboard.type(title)  # in the place of what is proposed
        page.keyboard.press("Enter")  # it was thrown away by that
        expect(page.locator("#draft-state")).to_have_text(f"The {kind} {title} is kept")
    begun(page, server, "flank_wall")
    page.get_by_label("Take a kept cell").select_option(label=title)
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    page.get_by_label("Put on a kept tool").select_option(label=title)
    page.locator("#kept").select_option(label=title)
    page.get_by_role("dialog").get_by_role("button", name="Drop them").click()
    expect(page.locator("#source")).to_have_text(f"from the template {title}")
    expect(page.locator("#f-name")).to_have_value("engrave")
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


def test_a_template_whose_robot_left_the_catalogue_says_so(page: Page, server: str) -> None:
    problem = asked(server, "/ui/example?name=engrave")["problem"]
    problem["cell"]["arms"][0]["robot"] = "irb_1"
    made = asked(server, "/v1/drafts?kind=template&title=Old", "POST", problem)
    page.goto(f"{server}/ui/new?template={made['id']}")
    expect(page.locator("#banner")).to_contain_text("The robot irb_1 of the arm")
    expect(page.locator("#banner")).to_contain_text("choose another one")
    expect(page.locator("#verdict")).to_contain_text("to correct")
    expect(page.locator("#banner")).to_contain_text("irb_1")


def test_a_page_that_was_left_open_over_an_update_says_so(page: Page, server: str) -> None:
    begun(page, server)

    def newer(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, headers={**answer.headers, "tandem-version": "99.0"})

    page.route("**/v1/drafts*", newer)
    called(page, "over")
    expect(page.locator("#outdated")).to_contain_text("was updated to 99.0")
    page.unroute("**/v1/drafts*")
    draft_of(page)
    page.get_by_role("button", name="Load it anew").click()
    expect(page.locator("#f-name")).to_have_value("over")


PUT = """async (id) => {
  const { Keeping } = await import("/ui/static/keeping.js");
  const put = async (text) => {
    const select = document.getElementById("kept-tool");
    select.replaceChildren(new Option("chosen", id));
    const state = { files: new Map([["parts/body.stl", new Blob([text])]]) };
    const found = await Object.assign(Object.create(Keeping.prototype), { state }).chosen("tool");
    return [found !== null, await state.files.get("parts/body.stl").text(), state.files.size];
  };
  return [await put("of the obstacle"), await put("of the tool")];
}"""


def test_a_kept_tool_changes_the_shape_of_nothing_else(page: Page, server: str) -> None:
    """Its mesh has the name of an obstacle's: it is not put in; where both are one file, it is."""
    files = [
        ("problem", ("p.json", '{"kind": "mesh", "file": "body.stl"}')),
        ("files", ("body.stl", b"of the tool")),
    ]
    made = httpx.post(f"{server}/v1/drafts?kind=tool&title=Gripper", files=files)
    held: list[Route] = []
    page.route("**/ui/preview", lambda route: held.append(route))
    begun(page, server)
    other, same = page.evaluate(PUT, made.json()["id"])
    assert other == [False, "of the obstacle", 1]
    assert same[:2] == [True, "of the tool"]
    said = "The tool Gripper has a file of the same name as another one here, with other contents: body.stl."
    expect(page.locator("#banner")).to_contain_text(said)
    with page.expect_request("**/v1/check?targets=*"):  # a check that ends later does not take it away
        held.pop().continue_()
    expect(page.locator("#banner")).to_contain_text(said)
    called(page, "another")
    expect(page.locator("#banner")).to_be_hidden()
