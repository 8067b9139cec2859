"""A refusal by the service stays on the page until the next action, although lists are reloaded."""

from __future__ import annotations

import re
from pathlib import Path

from playwright.sync_api import Page, Route, expect

import planner
from tests import small_problem
from tests.service.support import named_problem

REFUSED = {"issues": [{"code": "service.state", "severity": "error", "message": "it does not wait any more"}]}


def refuse(route: Route) -> None:
    route.fulfill(status=409, json=REFUSED)


def test_a_refusal_stays_beside_a_list_that_is_read_anew(page: Page, server: str, tmp_path: Path) -> None:
    client = planner.Client(server)
    job = client.submit(planner.load(small_problem.write(tmp_path, named_problem("told"))))
    client.wait(job)

    def cancelled(route: Route) -> None:
        result = client.job(job)
        route.fulfill(json={"jobs": [{**result, "state": "cancelled"}], "next": None})

    page.route(re.compile(r"/v1/jobs\?"), cancelled)
    page.route(f"**/v1/jobs/{job}/retry", refuse)
    page.goto(server)
    page.get_by_role("button", name="Try told again").click()
    banner = page.locator("#banner")
    expect(banner).to_have_text("it does not wait any more")
    with page.expect_response(re.compile(r"/v1/jobs\?")):
        pass
    page.wait_for_timeout(300)
    expect(banner).to_have_text("it does not wait any more")
    page.get_by_role("button", name="Under way").click()
    expect(banner).to_be_hidden()


def test_what_is_no_element_is_told_until_something_else_is_chosen(
    page: Page, server: str, tmp_path: Path
) -> None:
    page.goto(f"{server}/ui/elements")
    (tmp_path / "notes.txt").write_text("none")
    page.locator("#files").set_input_files(tmp_path / "notes.txt")
    banner = page.locator("#banner")
    expect(banner).to_contain_text("None of these is an element file")
    with page.expect_response(re.compile(r"/v1/elements\?")):
        pass
    page.wait_for_timeout(300)
    expect(banner).to_contain_text("None of these is an element file")


def test_a_refusal_stays_beside_a_job_that_goes_on(page: Page, server: str, tmp_path: Path) -> None:
    client = planner.Client(server)
    job = client.submit(planner.load(small_problem.write(tmp_path, named_problem("goes_on"))))
    client.wait(job)
    page.goto(f"{server}/ui/jobs/{job}")
    page.route(
        f"**/v1/jobs/{job}",
        lambda route: refuse(route) if route.request.method == "PATCH" else route.continue_(),
    )
    ask = page.get_by_role("button", name="Title, tags, notes")
    ask.click()
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#banner")).to_have_text("it does not wait any more")
    page.unroute(f"**/v1/jobs/{job}")
    ask.click()
    page.get_by_role("button", name="Save").click()
    expect(page.locator("#banner")).to_be_hidden()
