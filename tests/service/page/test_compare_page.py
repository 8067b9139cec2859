"""Two jobs compared on the page: both plans in one picture at one time, and what differs in programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

import planner
from tests import small_problem
from tests.service.page.test_access import CUT_OFF, NAMELESS
from tests.service.support import named

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
        ids.append(client.submit(planner.load(small_problem.write(folder, named(name), table))))
    assert [client.wait(one)["state"] for one in ids] == ["verified", "verified"]
    return ids[0], ids[1]


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
    assert [len(one) for one in tips] == [len(one) for one in reached]
    assert reached[1][-1] > 1.3 * reached[0][-1]
    for t in (*reached[0][[0, 2, -1]], *reached[1][[0, 2, -1]]):
        page.evaluate("(t) => both.go(t)", float(t))
        for way, times, seen in zip(tips, reached, page.evaluate(TIP), strict=True):
            if times[0] <= t <= times[-1]:
                wanted = [np.interp(t, times, way[:, axis]) for axis in range(3)]
                assert np.abs(np.subtract(seen, wanted)).max() < 2.0, (t, seen, wanted)
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
    texts: list[dict[str, Any]] = [client.programs(one) for one in jobs]
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
    page: Page, server: str, jobs: tuple[str, str], tmp_path: Path
) -> None:
    client = planner.Client(server)
    far = "\n".join([small_problem.COLUMNS, *small_problem.ROWS]).replace("450,", "4500,") + "\n"
    none = client.submit(planner.load(small_problem.write(tmp_path, named("far"), far)))
    assert client.wait(none)["state"] == "infeasible"
    page.goto(f"{server}/ui/compare?a={jobs[0]}&b={none}")
    expect(page.locator("#result")).to_contain_text("in the first alone")
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
