"""Drafts on the page: saved while the user edits, undone, opened elsewhere, and saved by two users."""

from __future__ import annotations

import json
import re
import urllib.request
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, Route, expect

from tests.service.page.test_access import CUT_OFF, NAMELESS

KEPT = re.compile("Saved as draft .*, version")


def begin_draft(page: Page, server: str, name: str = "engrave") -> None:
    page.goto(f"{server}/ui/new?example={name}")
    expect(page.locator("#f-name")).to_be_attached()
    expect(page.locator("#draft-bar")).to_be_visible()


def rename_problem(page: Page, name: str) -> None:
    """Change the name of the problem."""
    page.locator("#f-name").fill(name)
    page.locator("#f-name").blur()


def request_json(server: str, path: str, method: str = "GET", body: Any = None, kind: str = "json") -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(f"{server}{path}", data, {"Content-Type": f"application/{kind}"})
    request.method = method
    with urllib.request.urlopen(request) as answer:
        text = answer.read()
    return json.loads(text) if text else None


def wait_until_kept(page: Page, server: str, name: str) -> int:
    """The version in which the name of the problem is kept, when all of it is."""
    expect(page.locator("#f-name")).to_have_value(name)
    expect(page.locator("#draft-bar[data-kept=true]")).to_be_visible()
    draft = draft_id(page)
    number = int(request_json(server, f"/v1/drafts/{draft}")["version"])
    assert request_json(server, f"/v1/drafts/{draft}/versions/{number}/problem")["name"] == name
    return number


def draft_id(page: Page) -> str:
    expect(page).to_have_url(re.compile(r"draft=[0-9a-f]{32}"))
    return page.url.partition("draft=")[2][:32]


@pytest.mark.long
def test_what_is_edited_is_kept_and_opened_on_another_machine(
    page: Page, browser: Browser, server: str
) -> None:
    begin_draft(page, server)
    expect(page.get_by_role("button", name="Undo", exact=True)).to_be_disabled()
    rename_problem(page, "first")
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    draft = draft_id(page)
    rename_problem(page, "second")
    assert wait_until_kept(page, server, "second") > 1
    page.get_by_role("button", name="Undo", exact=True).click()
    expect(page.locator("#f-name")).to_have_value("first")
    page.get_by_role("button", name="Redo", exact=True).click()
    expect(page.locator("#f-name")).to_have_value("second")
    page.get_by_role("button", name="Undo", exact=True).click()
    page.get_by_role("button", name="Undo", exact=True).click()
    last = wait_until_kept(page, server, "engrave")

    other = browser.new_context().new_page()
    other.set_default_timeout(90_000)
    other.goto(f"{server}/ui/drafts")
    other.locator(f"#rows a[href$='{draft}']").click()
    expect(other.locator("#f-name")).to_have_value("engrave")
    assert draft_id(other) == draft
    other.get_by_role("button", name="History").click()
    expect(other.locator("#history-list li")).to_have_count(last)
    other.set_viewport_size({"width": 390, "height": 844})
    assert (other.evaluate(CUT_OFF), other.evaluate(NAMELESS)) == ([], [])
    other.get_by_role("button", name="Restore version 1").click()
    expect(other.locator("#f-name")).to_have_value("first")
    assert wait_until_kept(other, server, "first") == last + 1

    rename_problem(page, "mine")  # in the first window, of the version before
    conflict = page.locator("#draft-conflict")
    expect(conflict).to_contain_text(f"saved version {last + 1} meanwhile")
    assert request_json(server, f"/v1/drafts/{draft}")["version"] == last + 1
    page.get_by_role("button", name="Save mine as another draft").click()
    expect(page.locator("#draft-state")).to_have_text("Saved as draft mine, version 1")
    assert draft_id(page) != draft
    other.context.close()


def test_a_name_that_no_title_may_have_is_kept_all_the_same(page: Page, server: str) -> None:
    begin_draft(page, server)
    rename_problem(page, "a\u202eb\u0007 Gewölbe " + "\U0001f3db" * 200)
    expect(page.locator("#draft-state")).to_contain_text("Saved as draft ab Gewölbe ")
    expect(page.locator("#draft-state")).to_contain_text("what no title may have of the name is left out")
    kept = request_json(server, f"/v1/drafts/{draft_id(page)}")
    assert kept["title"] == "ab Gewölbe " + "\U0001f3db" * 189
    assert request_json(server, f"/v1/drafts/{kept['id']}/versions/1/problem")["name"].startswith(
        "a\u202eb\u0007"
    )


@pytest.mark.long
def test_a_title_goes_with_the_name_until_somebody_gives_another(page: Page, server: str) -> None:
    begin_draft(page, server)
    rename_problem(page, "wing_1")
    draft = draft_id(page)
    rename_problem(page, "wing_2")
    wait_until_kept(page, server, "wing_2")
    assert request_json(server, f"/v1/drafts/{draft}")["title"] == "wing_2"
    page.reload()  # it is known of a draft that is opened, too
    rename_problem(page, "wing_3")
    wait_until_kept(page, server, "wing_3")
    expect(page.locator("#draft-state")).to_contain_text("Saved as draft wing_3, version")
    request_json(server, f"/v1/drafts/{draft}", "PATCH", {"title": "Flügel"})  # while it is open
    rename_problem(page, "wing_4")
    wait_until_kept(page, server, "wing_4")
    expect(page.locator("#draft-state")).to_contain_text("Saved as draft Flügel, version")
    assert request_json(server, f"/v1/drafts/{draft}")["title"] == "Flügel"


@pytest.mark.long
def test_a_draft_that_was_sent_is_no_unsent_work(page: Page, server: str) -> None:
    """Also where it was not kept yet when it was sent."""
    begin_draft(page, server)
    rename_problem(page, "sent_1")
    draft = draft_id(page)
    page.locator("#f-name").fill("sent_2")
    expect(page.get_by_role("button", name="Start planning")).to_be_enabled()
    page.get_by_role("button", name="Start planning").click()
    expect(page).to_have_url(re.compile("/ui/jobs/[0-9a-f]{32}"))
    job = page.url.rpartition("/")[2]
    request_json(server, f"/v1/jobs/{job}/cancel", "POST")
    kept = request_json(server, f"/v1/drafts/{draft}")
    assert (kept["sent"], kept["job"]) == (kept["version"], job)
    assert request_json(server, f"/v1/drafts/{draft}/versions/{kept['version']}/problem")["name"] == "sent_2"
    page.goto(f"{server}/ui/drafts")
    row = page.locator("#rows tr").filter(has_text=kept["title"]).filter(has_text="submitted as a job").first
    expect(row.get_by_role("link", name="a job")).to_have_attribute("href", f"/ui/jobs/{job}")
    page.goto(f"{server}/ui/new")
    expect(page.locator("#processes label").first).to_be_visible()
    expect(page.locator(f"#kept option[value='{draft}']")).to_have_count(0)
    page.goto(f"{server}/ui/new?draft={draft}")
    expect(page.locator("#draft-state")).to_contain_text("was submitted. Further changes are saved")
    expect(page.get_by_role("link", name="Its job")).to_be_visible()
    rename_problem(page, "sent_3")
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    request_json(server, f"/v1/jobs/{job}", "DELETE")


@pytest.mark.long
def test_a_draft_that_was_swept_is_no_unsent_work(page: Page, server: str) -> None:
    begin_draft(page, server)
    rename_problem(page, "swept_1")
    draft = draft_id(page)
    page.locator("#f-name").fill("swept_2")
    page.get_by_text("Sweep a field over values").click()
    page.get_by_label("Field", exact=True).fill("operations.0.feed_mm_s")
    page.get_by_label("Values, separated by spaces").fill("20 30")
    page.get_by_role("button", name="Create 2 jobs").click()
    expect(page).to_have_url(re.compile("tag=sweep"))
    kept = request_json(server, f"/v1/drafts/{draft}")
    assert kept["sent"] == kept["version"]
    assert request_json(server, f"/v1/drafts/{draft}/versions/{kept['version']}/problem")["name"] == "swept_2"
    jobs = request_json(server, "/v1/jobs?tag=sweep")["jobs"]
    assert kept["job"] in [job["id"] for job in jobs]
    for job in jobs:
        request_json(server, f"/v1/jobs/{job['id']}/cancel", "POST")
        request_json(server, f"/v1/jobs/{job['id']}", "DELETE")


@pytest.mark.long
def test_a_draft_that_was_deleted_is_told(page: Page, server: str) -> None:
    begin_draft(page, server)
    rename_problem(page, "gone")
    draft = draft_id(page)
    request_json(server, f"/v1/drafts/{draft}", "DELETE")
    rename_problem(page, "gone_2")
    expect(page.locator("#draft-state")).to_contain_text("was deleted elsewhere")
    rename_problem(page, "gone_3")
    expect(page.locator("#draft-state")).to_have_text("Saved as draft gone_3, version 1")
    page.goto(f"{server}/ui/new?draft={draft}")
    expect(page.locator("#banner")).to_contain_text("It was deleted, or belongs to others")


@pytest.mark.parametrize("title", ["Gewölbe ٣ <b>x</b>", "لوحة القبو"])
def test_cells_tools_and_templates_are_kept_and_used_again(page: Page, server: str, title: str) -> None:
    begin_draft(page, server)
    names = {"cell": "Save the cell", "tool": "Save its tool", "template": "Save as template"}
    for kind, name in names.items():
        page.get_by_role("button", name=name).click()
        page.get_by_label("Title, in any language").fill("a\u202eb")
        page.get_by_role("dialog").get_by_role("button", name="Save", exact=True).click()
        expect(page.locator("#banner")).to_contain_text("right-to-left override")
        page.get_by_role("button", name=name).click()
        page.keyboard.type(title)  # in the place of what is proposed
        page.keyboard.press("Enter")  # it was thrown away by that
        expect(page.locator("#draft-state")).to_have_text(f"The {kind} {title} is saved")
    begin_draft(page, server, "flank_wall")
    page.get_by_label("Use a saved cell").select_option(label=title)
    expect(page.locator("#draft-state")).to_have_text(KEPT)
    page.get_by_label("Use a saved tool").select_option(label=title)
    page.locator("#kept").select_option(label=title)
    page.get_by_role("dialog").get_by_role("button", name="Discard and open the saved work").click()
    expect(page.locator("#source")).to_have_text(f"from the template {title}")
    expect(page.locator("#f-name")).to_have_value("engrave")
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


def test_a_template_whose_robot_left_the_catalogue_says_so(page: Page, server: str) -> None:
    problem = request_json(server, "/ui/example?name=engrave")["problem"]
    problem["cell"]["arms"][0]["robot"] = "irb_1"
    made = request_json(server, "/v1/drafts?kind=template&title=Old", "POST", problem)
    page.goto(f"{server}/ui/new?template={made['id']}")
    expect(page.locator("#banner")).to_contain_text("The robot irb_1 of arm")
    expect(page.locator("#banner")).to_contain_text("Choose another one under Cell")
    expect(page.locator("#verdict")).to_contain_text("to correct")
    expect(page.locator("#banner")).to_contain_text("irb_1")


def test_a_page_that_was_left_open_over_an_update_says_so(page: Page, server: str) -> None:
    begin_draft(page, server)

    def newer(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, headers={**answer.headers, "tandem-version": "99.0"})

    page.route("**/v1/drafts*", newer)
    rename_problem(page, "over")
    expect(page.locator("#outdated")).to_contain_text("was updated to 99.0")
    page.unroute("**/v1/drafts*")
    draft_id(page)
    page.get_by_role("button", name="Reload").click()
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
    response = httpx.post(f"{server}/v1/drafts?kind=tool&title=Gripper", files=files)
    held: list[Route] = []
    page.route("**/ui/preview", lambda route: held.append(route))
    begin_draft(page, server)
    other, same = page.evaluate(PUT, response.json()["id"])
    assert other == [False, "of the obstacle", 1]
    assert same[:2] == [True, "of the tool"]
    said = "contains a file with the name of another file here but different content: body.stl."
    expect(page.locator("#banner")).to_contain_text(said)
    with page.expect_request("**/v1/check?targets=*"):  # a check that ends later does not take it away
        held.pop().continue_()
    expect(page.locator("#banner")).to_contain_text(said)
    rename_problem(page, "another")
    expect(page.locator("#banner")).to_be_hidden()
