"""Search for jobs on the page, their titles, and deletion of many jobs."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import update

from planner.files import THUMBNAIL
from planner.service.jobs import Jobs, NewJob, put_files
from planner.service.models import JOBS, Database, default_url
from planner.service.security import LOCAL, ServiceLimits
from planner.service.storage import ContentStore
from tests.report.test_thumbnail import noise
from tests.service.page.test_access import CUT_OFF, NAMELESS
from tests.service.support import Process

CALLED = {
    "panel_03": ("Gewölbe 3 – Ostseite", ["dome", "Ost"], "Cut on Tuesday."),
    "panel_04": ("لوحة القبو ٤", ["dome"], ""),
    "panel_05": ("<img src=x onerror=alert(1)>", ["<b>x</b>"], ""),
    "W" * 24: ("W" * 200, ["T" * 40, "dome"], "N" * 500),
    "plain": ("", [], ""),
}
"""Title, tags and notes of a job by its name."""


DRAWN = {"panel_03": noise(200, 111), "W" * 24: noise(200, 111), "panel_04": b"no picture"}
"""What their pictures are."""


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, str]]]:
    """A service with jobs that have ended, and their ids by name."""
    data = tmp_path_factory.mktemp("finding") / "data"
    data.mkdir()
    database = Database(default_url(data))
    jobs, ids = Jobs(database, ServiceLimits()), {}
    files = {"problem/problem.yaml": ContentStore(data / "files").put(io.BytesIO(b"{}"))}
    for name, (title, tags, notes) in CALLED.items():
        new = NewJob(LOCAL, name, "0" * 64, name, ("targets",), files, 1.0, 1.0)
        ids[name] = jobs.create(new).id
        with database.write() as db:
            db.execute(update(JOBS).where(JOBS.c.id == ids[name]).values(state="infeasible"))
        jobs.describe(ids[name], {"title": title, "tags": tags, "notes": notes})
    for name, content in DRAWN.items():
        drawn = ContentStore(data / "files").put(io.BytesIO(content))
        with database.write() as db:
            put_files(db, ids[name], {THUMBNAIL: drawn})
    database.close()
    process = Process(data).wait()
    yield process.url, ids
    process.stop()
    assert "Traceback" not in process.log.read_text()


def test_jobs_are_found_by_words_and_tags_and_sorted(page: Page, shop: tuple[str, dict[str, str]]) -> None:
    url, _ = shop
    page.goto(url)
    names = page.locator(".job-name")
    expect(names).to_have_count(len(CALLED))
    expect(names.nth(2)).to_have_text("<img src=x onerror=alert(1)>")
    page.get_by_label("Find jobs").fill("GEWÖLBE tuesday")
    expect(names).to_have_count(1)
    page.reload()  # the address keeps the query
    expect(names).to_have_text(["Gewölbe 3 – Ostseite"])
    page.get_by_label("Find jobs").fill("nothing of this")
    expect(page.get_by_text("No matching jobs.")).to_be_visible()
    page.get_by_label("Find jobs").fill("")
    expect(names).to_have_count(len(CALLED))
    page.get_by_role("button", name="dome", exact=True).first.click()
    page.get_by_label("Order").select_option("by title")
    expect(names).to_have_text(["Gewölbe 3 – Ostseite", "W" * 200, "لوحة القبو ٤"])
    page.reload()
    expect(names).to_have_count(3)
    page.get_by_role("button", name="Without the tag dome").click()
    expect(names).to_have_count(len(CALLED))


@pytest.mark.parametrize("width", [390, 1440])
def test_long_titles_are_not_cut_off(page: Page, shop: tuple[str, dict[str, str]], width: int) -> None:
    url, ids = shop
    page.set_viewport_size({"width": width, "height": 900})
    for path in ("/", f"/ui/jobs/{ids['W' * 24]}"):
        page.goto(f"{url}{path}")
        expect(page.get_by_text("W" * 200)).to_be_visible()
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], []), path


def test_long_titles_take_few_lines_where_lists_are_narrow_and_marks_stay_in_their_row(
    page: Page, shop: tuple[str, dict[str, str]]
) -> None:
    url, _ = shop
    page.set_viewport_size({"width": 390, "height": 900})
    page.goto(url)
    name = page.get_by_role("link", name="W" * 200)
    expect(name).to_have_attribute("title", "W" * 200)
    seen = """one => [one.clientHeight / parseFloat(getComputedStyle(one).lineHeight), one.scrollHeight]"""
    lines, whole = name.evaluate(seen)
    assert lines <= 3.1 and whole > 200
    name.focus()
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Tab")  # as by the keyboard, or a finger that stays on it: all of it
    assert name.evaluate(seen)[0] > 6
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        hides = "one => getComputedStyle(one).overflowY"
        for kept in (name, page.locator("#rows .sub").first, page.locator("#rows .tag").first):
            assert kept.evaluate(hides) in ("clip", "hidden")


def test_each_job_has_a_picture_or_the_sign_of_its_process(
    page: Page, shop: tuple[str, dict[str, str]]
) -> None:
    url, ids = shop
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(url)
    expect(page.locator(".job-name")).to_have_count(len(CALLED))
    picture = page.get_by_role("img", name="The cell of Gewölbe 3 – Ostseite")
    expect(picture).to_have_attribute("loading", "lazy")
    expect(picture).to_have_js_property("naturalWidth", 200)
    signs = page.get_by_role("img", name="Given poses, no picture")
    expect(signs).to_have_count(3)  # that of a picture which is none is one of them
    path = f"{url}/v1/jobs/{{}}/files/{THUMBNAIL}"
    assert {item for item in requests if THUMBNAIL in item} == {path.format(ids[name]) for name in DRAWN}
    requests.clear()
    change = "(path) => fetch(path, { method: 'PATCH', body: JSON.stringify({ tags: ['fresh'] }) })"
    page.evaluate(change, f"/v1/jobs/{ids['plain']}")
    expect(page.get_by_role("button", name="fresh")).to_be_visible()  # all rows were drawn anew
    expect(picture).to_have_js_property("naturalWidth", 200)
    assert path.format(ids["panel_03"]) not in requests


def test_a_title_is_given_on_the_page(page: Page, shop: tuple[str, dict[str, str]]) -> None:
    url, ids = shop
    page.goto(f"{url}/ui/jobs/{ids['plain']}")
    page.get_by_role("button", name="Title, tags, notes").click()
    ask = page.get_by_role("dialog", name="Title, tags and notes of this job")
    ask.get_by_label("Title").fill("a\u202eb")
    ask.get_by_role("button", name="Save").click()
    expect(page.locator("#banner")).to_contain_text("right-to-left override")
    page.get_by_role("button", name="Title, tags, notes").click()
    ask.get_by_label("Title").fill("קמרון 3")
    ask.get_by_label("Tags").fill("new, , new,  old ")
    ask.get_by_label("Notes").fill("one\ntwo")
    ask.get_by_role("button", name="Save").click()
    expect(page.get_by_role("heading", name="קמרון 3")).to_be_visible()
    expect(page.locator("#job-tags .tag")).to_have_text(["new", "old"])
    expect(page.locator("#facts")).to_contain_text("plain")
    page.locator("#job-tags").get_by_text("old").click()
    expect(page.locator(".job-name")).to_have_text(["קמרון 3"])


def test_many_are_deleted_and_only_what_is_seen(page: Page, shop: tuple[str, dict[str, str]]) -> None:
    url, _ = shop
    page.goto(url)
    for title in ("<img src=x onerror=alert(1)>", "لوحة القبو ٤", "Gewölbe 3 – Ostseite"):
        page.get_by_label(f"Choose {title}").check()
    expect(page.get_by_role("button", name="Delete 3")).to_be_visible()
    page.get_by_label("Find jobs").fill("dome")
    page.get_by_role("button", name="Delete 2").click()
    page.get_by_role("dialog").get_by_role("button", name="Keep them").click()
    page.get_by_role("button", name="Delete 2").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete 2").click()
    expect(page.locator(".job-name")).to_have_count(1)
    page.get_by_label("Find jobs").fill("")
    expect(page.locator(".job-name")).to_have_count(len(CALLED) - 2)
    expect(page.get_by_text("<img src=x onerror=alert(1)>")).to_be_visible()
