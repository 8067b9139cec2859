"""The queue on the page: positions, moving to the front, remaining time, retry, and a sweep."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

import planner
from tests import small_problem
from tests.service.page.test_access import CUT_OFF, NAMELESS
from tests.service.support import Process, named_problem


@pytest.fixture
def held_service(tmp_path: Path) -> Iterator[Process]:
    """A service whose jobs stay at the stage motion until there is a file."""
    data = tmp_path / "data"
    process = Process(data, module="tests.service.page.held", arguments=(str(data),)).wait()
    yield process
    process.stop()


@pytest.mark.long
def test_places_the_front_what_is_left_and_again(page: Page, held_service: Process, tmp_path: Path) -> None:
    client, ids = planner.Client(held_service.url), {}
    for name in ("one", "two", "three", "four"):
        (tmp_path / name).mkdir()
        ids[name] = client.submit(planner.load(small_problem.write(tmp_path / name, named_problem(name))))
    page.goto(f"{held_service.url}/ui/jobs/{ids['one']}")
    expect(page.locator("#estimate")).to_contain_text("so far; no estimate, because no similar job")
    page.goto(held_service.url)
    page.get_by_role("button", name="Queue").click()
    names = page.locator(".job-name")
    expect(names).to_have_text(["two", "three", "four"])
    expect(page.locator("#rows tr").nth(2)).to_contain_text("position 3 in the queue")
    page.get_by_role("button", name="Plan four next").click()
    expect(names).to_have_text(["four", "two", "three"])
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    page.goto(f"{held_service.url}/ui/jobs/{ids['three']}")
    page.get_by_role("button", name="Plan it next").click()
    expect(page.get_by_role("button", name="Plan it next")).to_be_hidden()
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#state")).to_have_text("Cancelled")
    page.goto(f"{held_service.url}/?show=Stopped")
    page.get_by_role("button", name="Try three again").click()
    page.get_by_role("button", name="Queue").click()
    expect(names).to_have_text(["four", "two", "three"])
    (tmp_path / "data" / "go").touch()
    expect(page.get_by_text("No matching jobs.")).to_be_visible()
    (tmp_path / "data" / "go").unlink()
    (tmp_path / "five").mkdir()
    last = client.submit(planner.load(small_problem.write(tmp_path / "five", named_problem("five"))))
    page.goto(f"{held_service.url}/ui/jobs/{last}")
    expect(page.locator("#estimate")).to_contain_text(re.compile("left, estimated from|longer than the"))


@pytest.mark.long
def test_a_field_is_swept_on_the_page(page: Page, held_service: Process, small: list[Path]) -> None:
    page.goto(f"{held_service.url}/ui/new")
    page.get_by_text("Sheet forming").wait_for()
    page.locator("#problem-file").set_input_files(small)
    page.get_by_text("Sweep a field over values").click()
    page.get_by_label("Field", exact=True).fill("operations.0.feed_mm_s")
    page.get_by_label("Values, separated by spaces").fill("20 -1")
    page.locator("#sweep-tag").fill("Vorschub ٣")
    page.get_by_role("button", name="Create 2 jobs").click()
    expect(page.locator("#check-issues")).to_contain_text("operations.0.feed_mm_s = -1: ")
    page.get_by_label("Values, separated by spaces").fill("20 30; 40.5")
    page.set_viewport_size({"width": 390, "height": 900})
    assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    page.get_by_role("button", name="Create 3 jobs").click()
    expect(page.locator(".job-name")).to_have_count(3)
    expect(page.locator(".job-name").first).to_contain_text("operations.0.feed_mm_s = 40.5")
    expect(page.get_by_role("button", name="Without the tag Vorschub ٣")).to_be_visible()


def test_several_problem_files_become_jobs_all_or_none(
    page: Page, held_service: Process, tmp_path: Path
) -> None:
    small_problem.write(tmp_path)
    paths = [tmp_path / "targets.csv", tmp_path / "cell.yaml"]
    paths[1].write_text("arms: []\n")  # no problem
    long = "W" * 90  # the service treats the names of both alike
    names = [f"{long}one", "two", f'{long}"<b>three']
    for name, called in zip(names, ("one", "two", "three"), strict=True):
        paths.append(tmp_path / f"{name}.yaml")
        paths[-1].write_text(named_problem(called))
    page.goto(f"{held_service.url}/ui/new")
    expect(page.locator("#processes label").first).to_be_visible()
    paths[-1].write_text(named_problem("three") + "nonsense: 1\n")
    page.locator("#problem-file").set_input_files(paths)
    batch = page.get_by_role("region", name="3 problems")
    expect(batch.locator("#batch-list > li")).to_have_text([f"{name}.yaml" for name in names])
    expect(batch.locator("#batch-files")).to_contain_text("With targets.csv, cell.yaml")
    expect(page.locator("#rest")).to_be_hidden()
    batch.get_by_label("Tag").fill("Wand ٣")
    batch.get_by_role("button", name="Create 3 jobs").click()
    expect(page.locator("#banner")).to_have_text("1 of 3 problems cannot be read, so no job was created.")
    expect(batch.locator("#batch-list > li").nth(2)).to_contain_text("nonsense")
    expect(batch.locator("#batch-list > li").nth(0).locator(".issue")).to_have_count(0)
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    assert not list(planner.Client(held_service.url).jobs())
    paths[-1].write_text(named_problem("three"))
    page.locator("#problem-file").set_input_files(paths)
    batch.get_by_label("Tag").fill("Wand ٣")
    batch.get_by_role("button", name="Create 3 jobs").click()
    expect(page).to_have_url(re.compile("tag=Wand"))
    expect(page.locator(".job-name")).to_have_text(["three", "two", "one"])
    page.goto(f"{held_service.url}/ui/new")
    expect(page.locator("#processes label").first).to_be_visible()
    page.locator("#problem-file").set_input_files(paths[:3])  # one problem, its cell and its table
    expect(page.locator("#f-name")).to_have_value("one")
