"""Clicks, input and dropped files before the scripts or the answers of the service have arrived.

Each control works, or is disabled until it does.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Locator, Page, Route, expect

import planner
from tests import small_problem

PAGES: Final = {
    "jobs": "/",
    "new": "/ui/new",
    "drafts": "/ui/drafts",
    "compare": "/ui/compare",
    "audit": "/ui/audit",
    "elements": "/ui/elements",
    "job": "/ui/jobs/{job}",
    "element": "/ui/elements/{job}",
}
"""Addresses of the pages, by the names of their scripts."""
ENABLED: Final = """() => [...document.querySelectorAll("main :is(button, input, select, textarea)")]
  .filter((one) => !one.matches(":disabled")).map((one) => one.id || one.outerHTML)"""
"""Controls that take what somebody does to them."""


@pytest.fixture(scope="module")
def job(server: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    client = planner.Client(server)
    made = client.submit(planner.load(small_problem.write(tmp_path_factory.mktemp("early"))))
    client.wait(made)
    return made


@contextmanager
def hold_requests(page: Page, address: re.Pattern[str]) -> Iterator[None]:
    """Hold the answers of requests to an address until the context ends."""
    held: list[Route] = []
    over = False
    page.route(address, lambda route: route.continue_() if over else held.append(route))
    yield
    over = True
    for route in held:
        route.continue_()


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", PAGES)
def test_nothing_takes_a_click_before_its_script_is_there(
    page: Page, server: str, job: str, name: str
) -> None:
    with hold_requests(page, re.compile(f"/ui/static/{name}.js$")):
        page.goto(server + PAGES[name].format(job=job), wait_until="commit")
        theme = page.get_by_role("button", name=re.compile("Use .* colours"))
        expect(theme).to_be_enabled()
        assert page.evaluate(ENABLED) == []
        theme.click()
        expect(page.locator("html")).to_have_attribute("data-theme", "dark")
        stays = page.evaluate(
            """() => {
              const given = new DataTransfer();
              given.items.add(new File(["a"], "a.obj"));
              const dropped = new DragEvent("drop", { dataTransfer: given, cancelable: true, bubbles: true });
              return !document.body.dispatchEvent(dropped);
            }"""
        )
        assert stays, "a file that is dropped opens in the page's place"
    expect(page.locator("main")).not_to_have_attribute("aria-busy", "true")
    assert len(page.evaluate(ENABLED)) >= 2


def test_a_page_whose_scripts_do_not_come_says_so(page: Page, server: str) -> None:
    page.route("**/ui/static/issues.js", lambda route: route.abort())
    page.goto(f"{server}/ui/new")
    expect(page.locator("#banner")).to_have_text(
        "This page was not loaded completely and does not work. Reload it."
    )
    assert page.evaluate(ENABLED) == []


@pytest.mark.parametrize("late", ["/ui/static/new.js$", "/v1/schema$", "/v1/drafts"])
def test_a_problem_that_is_chosen_early_is_opened(
    page: Page, server: str, small: list[Path], late: str
) -> None:
    with hold_requests(page, re.compile(late)):
        page.goto(f"{server}/ui/new", wait_until="commit")
        chooser = page.locator("#problem-file")
        expect(chooser).to_be_disabled()
        chooser.set_input_files(small)  # as who drops them, or had chosen them when the page was left
    expect(page.locator("#source")).to_have_text("from the file problem.yaml")
    expect(page.locator("#file-list")).to_contain_text("targets.csv")
    expect(page.locator("#banner")).to_be_hidden()


def test_an_element_that_is_chosen_early_is_sent(page: Page, server: str, tmp_path: Path) -> None:
    element = tmp_path / "wall.yaml"
    element.write_text("element: 1\nname: wall\n")
    for late in ("/ui/static/elements.js$", "/ui/example-elements$"):
        with page.expect_request(re.compile("/v1/elements$")), hold_requests(page, re.compile(late)):
            page.goto(f"{server}/ui/elements", wait_until="commit")
            page.locator("#files").set_input_files(element)
        expect(page.locator("#issues li").first).to_be_visible()


def test_words_are_sought_although_who_asks_is_not_known_yet(page: Page, server: str, job: str) -> None:
    with hold_requests(page, re.compile("/v1/session$")):
        page.goto(server, wait_until="commit")
        with page.expect_request(re.compile("search=nothing")):
            page.get_by_label("Find jobs").fill("nothing such")
    expect(page.locator("#none")).to_be_visible()


@pytest.mark.parametrize(
    ("name", "path"), [("new", "/v1/schema"), ("drafts", "/v1/drafts"), ("elements", "/ui/example-elements")]
)
def test_what_a_page_needs_is_asked_for_until_it_comes(page: Page, server: str, name: str, path: str) -> None:
    address = re.compile(re.escape(path))
    page.route(address, lambda route: route.abort())
    page.goto(server + PAGES[name])
    expect(page.locator("#banner")).to_contain_text("cannot be reached. Trying again")
    page.unroute(address)
    expect(page.locator("#banner")).to_be_hidden()
    if name == "new":
        expect(page.get_by_text("Sheet forming")).to_be_visible()
    if name == "elements":
        expect(page.locator("#example option")).not_to_have_count(1)


def ready(page: Page, server: str, small: list[Path], name: str) -> Locator:
    """The button that starts planning, of the small problem by another name."""
    small[0].write_text(small[0].read_text().replace("name: small", f"name: {name}"))
    page.goto(f"{server}/ui/new")
    page.locator("#problem-file").set_input_files(small)
    go = page.get_by_role("button", name="Start planning")
    expect(go).to_be_enabled()
    return go


def test_a_job_is_made_once_although_the_connection_broke_off(
    page: Page, server: str, small: list[Path]
) -> None:
    """It is sent again with the same key, by which the service knows it."""
    go = ready(page, server, small, "broken_off")
    keys: list[str] = []

    def lose(route: Route) -> None:
        keys.append(route.request.headers["idempotency-key"])
        route.abort() if len(keys) < 2 else route.continue_()

    page.route(re.compile("/v1/jobs$"), lose)
    go.click()
    expect(page.locator("#banner")).to_contain_text("Trying again")
    page.wait_for_url(re.compile("/ui/jobs/"))
    assert len(keys) == 2 and len(set(keys)) == 1 and re.fullmatch("[0-9a-f]{32}", keys[0])
    assert len(list(planner.Client(server).jobs("broken_off"))) == 1


def test_what_is_changed_while_the_service_is_away_is_not_sent_as_it_was(
    page: Page, server: str, small: list[Path]
) -> None:
    go = ready(page, server, small, "before")
    address = re.compile("/v1/jobs$")
    page.route(address, lambda route: route.abort())
    go.click()
    expect(page.locator("#banner")).to_contain_text("Trying again")
    page.locator('.field[data-path="name"] input').fill("after")
    page.unroute(address)
    expect(page.locator("#banner")).to_contain_text("was changed while the service could not be reached")
    expect(go).to_be_enabled()
    go.click()
    page.wait_for_url(re.compile("/ui/jobs/"))
    client = planner.Client(server)
    assert [job["name"] for job in client.jobs("before")] == []
    assert [job["name"] for job in client.jobs("after")] == ["after"]


def test_planning_is_started_again_after_a_refusal_that_the_problem_has_no_part_in(
    page: Page, server: str, small: list[Path]
) -> None:
    page.goto(f"{server}/ui/new")
    page.locator("#problem-file").set_input_files(small)
    go = page.get_by_role("button", name="Start planning")
    expect(go).to_be_enabled()
    full = {"code": "service.too_many", "severity": "error", "message": "100 jobs wait, as many as may"}
    address = re.compile("/v1/jobs$")
    page.route(address, lambda route: route.fulfill(status=429, json={"issues": [full]}))
    go.click()
    expect(page.locator("#banner")).to_have_text("100 jobs wait, as many as may")
    page.unroute(address)
    expect(go).to_be_enabled()
    go.click()
    page.wait_for_url(re.compile("/ui/jobs/"))


def test_a_file_that_is_written_anew_since_it_was_chosen_is_sent_as_it_was(
    page: Page, server: str, small: list[Path]
) -> None:
    """A browser sends nothing of a changed file, and its error reads as if the service were away."""
    page.goto(f"{server}/ui/new")
    page.locator("#problem-file").set_input_files(small)
    go = page.get_by_role("button", name="Start planning")
    expect(go).to_be_enabled()
    small[1].write_text("what CAD wrote meanwhile")
    with page.expect_response(re.compile("check.reach=true")):
        page.locator('.field[data-path="name"] input').fill("written_anew")
    expect(page.locator("#verdict")).to_have_text("Ready: the arms reach every target")


@pytest.mark.parametrize("address", ["/ui/new", "/ui/elements"])
def test_a_folder_that_is_dropped_is_told(page: Page, server: str, address: str) -> None:
    """As a file that cannot be read."""
    page.goto(server + address)
    expect(page.locator("main")).not_to_have_attribute("aria-busy", "true")
    page.evaluate(
        """() => {
          const given = new DataTransfer();
          const file = new File(["a"], "parts");
          given.items.add(file);
          File.prototype.arrayBuffer = () => Promise.reject(new DOMException("", "NotReadableError"));
          document.body.dispatchEvent(new DragEvent("drop", { dataTransfer: given, bubbles: true }));
        }"""
    )
    expect(page.locator("#banner")).to_contain_text("parts cannot be read. Choose files, not folders")
