"""The replay in a browser, from its file alone: it opens on the work; time bar, colours, measuring, width."""

from __future__ import annotations

import io
import os
import re
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from planner.report import output
from tests.report import synthetic_job as job

AXE: Final = os.environ.get("TANDEM_AXE", "")
SEEN: Final = """(place) => {
  const view = replay.view;
  const at = view.rule.position.clone().set(...place).project(view.lens);
  return [at.x, at.y];
}"""
"""Where a place [mm] of the world is seen, from -1 to 1 over the picture."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay")
    for name, text in output.pages(job.problem(), job.plan(), job.proof(), ()).items():
        (folder / name).write_text(text, "utf-8")
    return folder


def open_replay(page: Page, files: Path, at: str = "#t=0") -> list[str]:
    """Open the replay; return the addresses that it requests."""
    requests: list[str] = []
    page.on("request", lambda one: requests.append(one.url))
    page.goto((files / "replay.html").as_uri() + at)
    page.wait_for_function("window.replay && replay.view.shown > 0")
    return requests


def canvas_picture(page: Page) -> np.ndarray[Any, Any]:
    """The picture (height, width, 3) once all is drawn."""
    before = page.evaluate("replay.view.shown")
    page.evaluate("replay.view.draw()")
    page.wait_for_function(f"replay.view.shown > {before}")
    return np.asarray(Image.open(io.BytesIO(page.locator("#scene").screenshot())).convert("RGB")).astype(int)


def test_it_opens_on_the_work_and_follows_the_tool(page: Page, files: Path) -> None:
    asked = open_replay(page, files)
    assert len(asked) == 1 and asked[0].startswith("file:")
    assert (files / "replay.html").stat().st_size < 2_000_000  # 3.3 MB by Meshcat
    canvas_picture(page)
    half = 500.0 * job.SIZE
    middle = 1000.0 * job.STOCK_POSE[:3, 3] + [0.0, 0.0, half[2]]  # a stock frame's origin is amid its foot
    corners = [middle + half * [x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    seen = np.array([page.evaluate(SEEN, corner.tolist()) for corner in corners])
    assert np.abs(seen).max() < 1.0
    assert np.ptp(seen, axis=0).max() > 0.5  # and fills much of it
    base = page.evaluate(SEEN, [-950.0, 0.0, 0.0])
    assert np.abs(base).max() > 0.9
    page.get_by_role("button", name="Cell").click()
    canvas_picture(page)
    assert np.abs(page.evaluate(SEEN, [-950.0, 0.0, 0.0])).max() < 1.0
    page.get_by_role("button", name="Work").click()
    page.get_by_role("button", name="Follow tool").click()
    for fraction in (0.2, 0.6):
        page.evaluate(f"replay.bar.go({fraction} * replay.bar.end)")
        canvas_picture(page)
        tip = page.evaluate("replay.view.tip().toArray()")
        assert np.abs(page.evaluate(SEEN, tip)).max() < 0.01
    page.keyboard.press("f")
    expect(page.get_by_role("button", name="Follow tool")).to_have_attribute("aria-pressed", "false")


def test_the_tools_are_where_the_plan_has_them(page: Page, files: Path) -> None:
    """Compare the position between the arms' tips, by the plan's kinematics, with the picture at its time."""
    from planner.report.scene import flange_poses

    open_replay(page, files)
    problem, (operation,) = job.problem(), job.plan().operations
    for row in (20, len(operation.time) // 2):
        page.evaluate(f"replay.bar.go(replay.bar.reached[{row}])")
        tips = [
            (flange_poses(arm, {}, operation.q[arm.name][row]) @ arm.tool.tcp)[:3, 3] * 1000.0
            for arm in problem.cell.arms
        ]
        got = page.evaluate("replay.view.tip().toArray()")
        np.testing.assert_allclose(got, np.mean(tips, axis=0), atol=2.0)  # between keyframes straight lines
        expect(page.locator("#bar .segment")).to_contain_text(operation.targets.name(row))


def test_its_bar_is_worked_by_keys_and_says_where_it_is(page: Page, files: Path) -> None:
    open_replay(page, files)
    time = page.get_by_role("slider", name="Time")
    play = page.locator("#play")
    expect(play).to_have_attribute("aria-label", "Play")
    page.locator("body").press(" ")
    expect(play).to_have_attribute("aria-label", "Pause")
    page.wait_for_function("replay.bar.at > 0")
    page.locator("body").press(" ")
    expect(play).to_have_attribute("aria-label", "Play")
    time.focus()
    page.keyboard.press("Home")
    end = page.evaluate("replay.bar.end")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("replay.bar.at") == pytest.approx(end / 200)
    page.keyboard.press(".")
    page.keyboard.press(".")
    assert page.evaluate("replay.bar.at") == pytest.approx(page.evaluate("replay.bar.reached[1]"))
    expect(time).to_have_attribute("aria-valuetext", re.compile(r"\d+:\d\d\.\d of \d+:\d\d\.\d, \w+"))
    page.keyboard.press("End")
    assert page.evaluate("replay.bar.at") == pytest.approx(end)
    page.evaluate("location.hash = 't=3'")
    page.wait_for_function("replay.bar.at === 3")


def test_colours_are_the_proofs_and_their_words_the_reports(page: Page, files: Path) -> None:
    open_replay(page, files)
    series, report = job.proof().series, (files / "report.html").read_text("utf-8")
    page.evaluate("replay.bar.go(0.6 * replay.bar.end)")
    plain = canvas_picture(page)
    page.select_option("#colours", label="clearance")
    assert (np.abs(canvas_picture(page) - plain).max(axis=-1) > 30).mean() > 0.02
    words = re.search(r"minimum: [\d.]+ mm at [\d.]+ s, [^;<]+", page.locator("#key").inner_text())
    assert words is not None and words[0] in report
    values = np.array(
        page.evaluate("[...replay.view.read(replay.view.layer.values[''])].map((v) => v === v ? v : 1e9)")
    )
    assert values.min() == pytest.approx(1000.0 * np.min(series["clearance/distance"]), abs=1e-3)
    told = page.evaluate("replay.bar.times.clock")
    times = np.interp(page.evaluate("[...replay.view.fine]"), *np.array(told)[:, ::-1].T)
    at = len(values) // 2
    curve = np.interp(
        [times[at - 1], times[at]], series["clearance/time"], 1000.0 * series["clearance/distance"]
    )
    assert values[at] <= curve.min() + 1e-3
    page.select_option("#colours", label="deviation")
    canvas_picture(page)
    worst = max(job.proof().surfaces, key=lambda face: face.largest)
    expect(page.locator("#key")).to_contain_text(f"largest: {1000 * worst.largest:.3f} mm")
    assert f"{1000 * worst.largest:.3f} mm" in report
    shades = np.array(page.evaluate("[...replay.view.read(replay.view.layer.point_colours)]")).reshape(-1, 3)
    deviation = np.concatenate([face.deviation for face in job.proof().surfaces])
    if len(shades) == len(deviation):
        red, blue = shades[np.nanargmax(deviation)], shades[np.nanargmin(deviation)]
        assert red[0] > red[2] and blue[2] > blue[0]
    page.select_option("#colours", label="none")
    assert (np.abs(canvas_picture(page) - plain).max(axis=-1) > 30).mean() < 0.002
    expect(page.locator("#key")).to_be_hidden()


def test_two_points_are_measured(page: Page, files: Path) -> None:
    open_replay(page, files)
    page.get_by_role("button", name="Cell").click()
    canvas_picture(page)
    page.get_by_role("button", name="Measure").click()
    canvas = page.locator("#scene")
    box = canvas.bounding_box()
    assert box is not None
    for place in ([-240.0, -140.0, 20.0], [240.0, -140.0, 20.0]):  # on the table, 480 mm apart
        x, y = page.evaluate(SEEN, place)
        at = {"x": 0.5 * (x + 1.0) * box["width"], "y": 0.5 * (1.0 - y) * box["height"]}
        canvas.click(position=at)  # type: ignore[arg-type]
    told = page.locator("#measured").inner_text()
    match = re.match(r"([\d.]+) mm", told)
    assert match is not None and float(match[1]) == pytest.approx(480.0, abs=8.0)  # a pixel is 4 mm
    expect(page.locator(".measure")).to_have_text(match[0])
    page.keyboard.press("Escape")
    expect(page.locator("#measured")).to_be_empty()


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("wide", [390, 820, 1440])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_off_and_every_control_has_a_name(
    page: Page, files: Path, wide: int, scheme: Any
) -> None:
    page.set_viewport_size({"width": wide, "height": 780})
    page.emulate_media(color_scheme=scheme)
    if AXE:
        page.add_init_script(path=AXE)
    open_replay(page, files)
    page.select_option("#colours", label="clearance")
    ground = np.median(canvas_picture(page).reshape(-1, 3), axis=0)
    assert (ground > 180).all() if scheme == "light" else (ground < 80).all()
    assert page.evaluate("document.scrollingElement.scrollWidth") <= wide
    for control in page.locator("button, select, input").all():
        box = control.bounding_box()
        assert box is not None and box["x"] >= 0 and box["x"] + box["width"] <= wide
        assert box["y"] >= 0 and box["y"] + box["height"] <= 780
    page.evaluate(
        "location.hash = 'theme=' + (matchMedia('(prefers-color-scheme: dark)').matches ? 'light' : 'dark')"
    )
    page.wait_for_timeout(200)
    assert (np.median(canvas_picture(page).reshape(-1, 3), axis=0) > 180).all() == (scheme == "dark")
    if AXE:
        result = page.evaluate(
            "axe.run().then((one) => one.violations.map((v) => v.id + ' ' + v.nodes[0].html))"
        )
        assert result == []
