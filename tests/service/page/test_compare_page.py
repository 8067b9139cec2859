"""Comparison of two jobs on the page: both plans in one picture at one time, and differences of programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, Route, expect
from playwright.sync_api import TimeoutError as NotInTime

import planner
from tests import small_problem
from tests.service.page.test_access import CUT_OFF, NAMELESS
from tests.service.support import named_problem

TIP: Final = """() => {
  const tip = (film, frames) => {
    const place = both.view.rule.position.clone().set(...film.view.tips.left[0]);
    return place.applyMatrix4(frames.get("left/tool").matrix).toArray();
  };
  return [tip(both.one.film, both.view.frames), tip(both.two.film, both.ghost.frames)];
}"""
"""Where the tips of both tools are [mm]."""


@pytest.fixture(scope="module")
def jobs(server: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Two verified jobs: the second one's targets lie 40 mm higher, and are passed in half the speed."""
    client, ids = planner.Client(server), []
    rows = [small_problem.COLUMNS, *small_problem.ROWS]
    higher = "\n".join(row.replace(",500,", ",540,").replace(",20", ",10") for row in rows) + "\n"
    for name, table in (("lower", None), ("higher", higher)):
        folder = tmp_path_factory.mktemp(name)
        ids.append(client.submit(planner.load(small_problem.write(folder, named_problem(name), table))))
    assert [client.wait(item)["state"] for item in ids] == ["verified", "verified"]
    return ids[0], ids[1]


@pytest.fixture(scope="module")
def moved_job(server: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The first of these jobs, with its block moved by 40 mm and a table added beside it."""
    text = named_problem("moved").replace("xyz_mm: [450, 0, 0]", "xyz_mm: [450, 40, 0]")
    box = "{kind: box, size_mm: [300, 300, 100], pose: {xyz_mm: [450, 700, 50]}}"
    text = text.replace("stock: {", f"  obstacles: [{{name: table, shapes: [{box}]}}]\nstock: {{")
    client = planner.Client(server)
    job = client.submit(planner.load(small_problem.write(tmp_path_factory.mktemp("moved"), text)))
    assert client.wait(job)["state"] == "verified"
    return job


@pytest.fixture(scope="module")
def none(server: str, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A job without a plan."""
    client = planner.Client(server)
    far = "\n".join([small_problem.COLUMNS, *small_problem.ROWS]).replace("450,", "4500,") + "\n"
    job = client.submit(
        planner.load(small_problem.write(tmp_path_factory.mktemp("far"), named_problem("far"), far))
    )
    assert client.wait(job)["state"] == "infeasible"
    return job


SEEN: Final = """() => {
  const least = (one) => one.points[0].clone().applyMatrix4(one.matrix).toArray().map(Math.round);
  const seen = both.ghost.bodies.filter((one) => one.visible);
  return seen.map((one) => [one.userData.kind, ...least(one)]);
}"""
"""Bodies of the second that are drawn, each with its least corner [mm] in the world."""


def figures(page: Page) -> Locator:
    """Heads of the columns of figures."""
    return page.locator("#result thead").first.locator("th")


@pytest.mark.long
def test_what_of_the_second_stands_elsewhere_is_drawn_and_named(
    page: Page, server: str, jobs: tuple[str, str], moved_job: str
) -> None:
    """The block and a table of the other problem, and not what both have at one place."""
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={moved_job}")
    page.get_by_role("button", name="Draw both over each other").click()
    legend = page.locator("#both-legend")
    expect(legend).to_contain_text("Second, clear: block, obstacles; arms, tools as in the first")
    page.evaluate("both.go(both.end / 2)")
    expect(legend).to_contain_text("Second, clear: block, obstacles; arms, tools, cuts as in the first")
    drawn = sorted(page.evaluate(SEEN))
    assert drawn == [["obstacle", 300, 550, 0], ["stock", 400, -10, 0]]
    low, high = page.evaluate("both.view.all")
    assert high[1] > 849, "the table is in the whole picture"
    box = page.evaluate("both.view.whole")
    assert box[0][1] <= -50 and box[1][1] >= 90, "the work of both is in the picture at first"
    assert low[2] <= 0
    page.get_by_label("The second, clear").uncheck()
    expect(legend).to_contain_text("Second, clear: not shown")
    assert page.evaluate(SEEN) == []
    page.get_by_label("The second, clear").check()
    page.emulate_media(color_scheme="dark")
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


@pytest.mark.long
def test_another_choice_is_drawn_as_the_former_was(
    page: Page, server: str, jobs: tuple[str, str], moved_job: str, none: str
) -> None:
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={moved_job}")
    page.get_by_role("button", name="Draw both over each other").click()
    legend = page.locator("#both-legend")
    expect(legend).to_contain_text("block, obstacles")
    page.locator("#both-speed").select_option("20")
    page.evaluate("() => { both.go(3); both.view.rotate(1, 0); globalThis.former = both; }")
    page.locator("#b").select_option(jobs[1])
    expect(legend).to_contain_text("Second, clear: arms, tools; block as in the first")
    assert page.evaluate("former !== both && former.view.three.getContext().isContextLost()")
    assert page.evaluate("both.at === 3 && both.view.turn === former.view.turn")
    expect(page.locator("#both-speed")).to_have_value("20")
    page.locator("#b").select_option(none)
    expect(page.locator("#result")).to_contain_text("The second has no plan to draw.")
    expect(page.locator("canvas")).to_have_count(0)
    page.get_by_role("button", name="Swap the two").click()
    expect(page.locator("#result")).to_contain_text("The first has no plan to draw.")
    page.locator("#a").select_option(jobs[1])
    expect(legend).to_contain_text("block as in the first")
    held: list[Route] = []
    page.route(re.compile(f"/v1/jobs/{moved_job}/files/replay.html$"), lambda route: held.append(route))
    page.locator("#b").select_option(moved_job)
    expect(page.get_by_role("button", name="Loading")).to_be_visible()
    page.locator("#b").select_option(jobs[0])
    expect(legend).to_contain_text("block as in the first")
    for route in held:
        route.continue_()
    page.wait_for_timeout(300)
    expect(page.locator("canvas")).to_have_count(1)
    assert page.evaluate("both.two.times.end") < page.evaluate("both.one.times.end")
    expect(page.locator("#banner")).to_be_hidden()


@pytest.mark.long
def test_a_job_that_is_gone_is_told_and_nothing_else_is_shown_for_it(
    page: Page, server: str, jobs: tuple[str, str], tmp_path: Path
) -> None:
    client = planner.Client(server)
    gone = client.submit(planner.load(small_problem.write(tmp_path, named_problem("gone"))))
    client.wait(gone)
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    expect(figures(page)).to_have_count(3)
    client.delete(gone)
    page.locator("#b").select_option(gone)
    expect(page.locator("#banner")).to_contain_text("not found")
    expect(page.locator("#result")).to_have_text("These jobs cannot be compared now.")
    page.locator("#b").select_option(jobs[1])
    expect(figures(page)).to_have_count(3)
    expect(page.locator("#banner")).to_be_hidden()
    page.goto(f"{server}/ui/compare?a={gone}&b={jobs[1]}")  # as a link that somebody kept
    expect(page.locator("#banner")).to_contain_text("not found")
    page.locator("#a").select_option(jobs[0])
    expect(figures(page)).to_have_count(3)


@pytest.mark.long
def test_a_job_under_way_is_followed_to_its_end(page: Page, server: str, jobs: tuple[str, str]) -> None:
    """The page updates by itself, also after a time without the service.

    State and stage change with the job; figures, programs and the picture appear when it has ended.
    """
    as_it_is: dict[str, Any] = planner.Client(server).job(jobs[1])
    now = {**as_it_is, "state": "queued", "stage": "", "metrics": None, "seconds": None}
    item, files = re.compile(f"/v1/jobs/{jobs[1]}$"), re.compile(f"/v1/jobs/{jobs[1]}/files$")
    page.route(item, lambda route: route.fulfill(json=now))
    page.route(files, lambda route: route.fulfill(json={"files": []}))
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    states = page.locator("#result td.state")
    expect(states).to_have_text(["Verified", "Waiting"])
    expect(page.locator("#result")).to_contain_text("The second has no plan to draw.")
    now = {**now, "state": "running", "stage": "motion", "fraction": 0.5}
    expect(states.nth(1)).to_have_text("Planningmotion, 50 %")
    expect(page.locator("#b option:checked")).to_contain_text("Planning")
    now = {**now, "stage": "proof", "fraction": 0.25}
    expect(states.nth(1)).to_contain_text("proof, 25 %")
    page.unroute(item)
    page.route(item, lambda route: route.abort())
    expect(page.locator("#banner")).to_contain_text("cannot be reached")
    page.unroute(files)
    page.unroute(item)
    expect(states).to_have_text(["Verified", "Verified"])
    expect(page.locator("#banner")).to_be_hidden()
    expect(page.get_by_role("button", name="Draw both over each other")).to_be_visible()
    expect(page.locator("#b option:checked")).to_contain_text("Verified")
    with pytest.raises(NotInTime), page.expect_request(item, timeout=3000):
        pass  # nothing more is asked for


def test_jobs_beyond_the_list_are_swapped_and_a_service_that_is_away_is_asked_again(
    page: Page, server: str, jobs: tuple[str, str]
) -> None:
    """Of a team with thousands of jobs the list has the last ones."""
    page.route("**/v1/jobs?limit=200", lambda route: route.fulfill(json={"jobs": []}))
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    expect(figures(page)).to_have_count(3)
    page.get_by_role("button", name="Swap the two").click()
    page.wait_for_url(f"**/ui/compare?a={jobs[1]}&b={jobs[0]}")
    expect(figures(page).nth(0)).to_contain_text("higher")
    away = re.compile("/v1/jobs/")
    page.route(away, lambda route: route.abort())
    page.locator("#a").select_option(jobs[0])
    expect(page.locator("#banner")).to_contain_text("cannot be reached")
    page.unroute(away)
    expect(figures(page).nth(0)).to_contain_text("lower")
    expect(page.locator("#banner")).to_be_hidden()


def test_the_picture_comes_when_the_service_is_back(page: Page, server: str, jobs: tuple[str, str]) -> None:
    """Browsers cache that a script failed to load: requested while the service was away, it never came."""
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    page.route("**/ui/static/*", lambda route: route.abort())
    page.get_by_role("button", name="Draw both over each other").click()
    expect(page.locator("#banner")).to_contain_text("Trying again")
    page.unroute("**/ui/static/*")
    expect(page.locator("#both-legend")).to_contain_text("block as in the first")
    expect(page.locator("#banner")).to_be_hidden()


def test_nothing_can_be_chosen_before_there_is_something_to_choose(
    page: Page, server: str, jobs: tuple[str, str]
) -> None:
    held: list[Route] = []
    page.route("**/v1/jobs?limit=200", lambda route: held.append(route))
    page.goto(f"{server}/ui/compare")
    controls = [page.locator("#a"), page.locator("#b"), page.locator("#swap")]
    for control in controls:
        expect(control).to_be_disabled()
    held[0].continue_()
    for control in controls:
        expect(control).to_be_enabled()
    page.locator("#a").select_option(jobs[0])
    page.locator("#b").select_option(jobs[1])
    expect(figures(page)).to_have_count(3)


def test_both_plans_are_drawn_over_each_other_at_one_time(
    page: Page, server: str, jobs: tuple[str, str]
) -> None:
    """Tips of both tools stand where the motion as data has them, which another program may read."""
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    page.get_by_role("button", name="Draw both over each other").click()
    expect(page.locator("#both-said")).to_contain_text("First: ")
    client = planner.Client(server)
    tips, reached = [], []
    for own, job in zip(("one", "two"), jobs, strict=True):
        tips.append(np.array(client.motion(job)["operations"][0]["arms"]["left"]["tcp"])[:, :3])
        read = f"both.{'view' if own == 'one' else 'ghost'}.read(both.{own}.film.targets.times)"
        told = page.evaluate(f"[[...{read}], both.{own}.times.clock]")
        program, replay = np.array(told[1]).T
        reached.append(np.interp(told[0], replay, program))  # targets on the clock of the programs
    assert [len(item) for item in tips] == [len(item) for item in reached]
    assert reached[1][-1] > 1.3 * reached[0][-1]
    for t in (*reached[0][[0, 2, -1]], *reached[1][[0, 2, -1]]):
        page.evaluate("(t) => both.go(t)", float(t))
        for way, times, seen in zip(tips, reached, page.evaluate(TIP), strict=True):
            if times[0] <= t <= times[-1]:
                expected = [np.interp(t, times, way[:, axis]) for axis in range(3)]
                assert np.abs(np.subtract(seen, expected)).max() < 2.0, (t, seen, expected)
    page.evaluate("both.go(both.end)")
    expect(page.locator("#both-said")).to_contain_text("First: is done")
    assert page.evaluate("both.ghost.bodies.some((one) => one.visible)")
    page.get_by_label("The second, clear").uncheck()
    assert not page.evaluate("both.ghost.bodies.some((one) => one.visible)")
    slider = page.get_by_role("slider", name="Time")
    slider.focus()
    page.keyboard.press("Home")
    expect(slider).to_have_value("0")
    assert page.evaluate("both.view.shown") > 1
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


def test_programs_say_what_differs(page: Page, server: str, jobs: tuple[str, str]) -> None:
    client = planner.Client(server)
    texts: list[dict[str, Any]] = [client.programs(job) for job in jobs]
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}")
    programs = page.get_by_role("heading", name="Programs").locator("..")
    names = sorted(texts[0].keys() | texts[1].keys())
    expect(programs.locator("li code")).to_have_text(names)
    rows = programs.locator("li")
    other = [name for name in names if texts[0].get(name) != texts[1].get(name)]
    assert other and len(other) < len(names)
    for number, name in enumerate(names):
        expect(rows.nth(number)).to_contain_text("differs" if name in other else "the same")
    page.get_by_role("button", name=f"Show what differs in {other[0]}").click()
    lines = [text[other[0]].split("\n") for text in texts]
    first = next(i for i, pair in enumerate(zip(*lines, strict=False)) if pair[0] != pair[1])
    expect(programs).to_contain_text(f"From line {first + 1}: ")
    expect(programs.locator("pre").first).to_contain_text(lines[0][first].strip())
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])


def test_a_job_without_a_plan_is_compared_without_a_picture(
    page: Page, server: str, jobs: tuple[str, str], none: str
) -> None:
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={none}")
    expect(page.locator("#result")).to_contain_text("only in the first")
    expect(page.get_by_role("button", name="Draw both over each other")).to_have_count(0)


def test_what_is_chosen_last_is_compared_and_called_by_its_title(
    page: Page, server: str, jobs: tuple[str, str]
) -> None:
    """Also where the answer to a former choice comes late."""
    title = "<b>Vorschub</b> = ٣٠ " + "W" * 100
    planner.Client(server).describe(jobs[0], title=title)
    held: list[Route] = []
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={jobs[0]}")
    heads = page.locator("#result thead th")
    expect(heads).to_have_text([f"First: {title}", f"Second: {title}", "Change"])
    expect(page.locator("#a option:checked")).to_contain_text(title)
    page.route(re.compile(f"/v1/jobs/{jobs[1]}$"), lambda route: held.append(route))
    page.locator("#b").select_option(jobs[1])
    page.wait_for_function("location.search.includes('" + jobs[1] + "')")
    with page.expect_response(re.compile(f"/v1/jobs/{jobs[0]}/files$")):
        page.locator("#b").select_option(jobs[0])
    expect(heads).to_have_count(3)
    for route in held:
        with page.expect_response(re.compile(f"/v1/jobs/{jobs[1]}/files$")):
            route.continue_()
    page.wait_for_timeout(300)
    expect(heads.nth(1)).to_have_text(f"Second: {title}")
    for width in (390, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        assert (page.evaluate(CUT_OFF), page.evaluate(NAMELESS)) == ([], [])
    planner.Client(server).describe(jobs[0], title="")
