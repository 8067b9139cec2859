"""The 3D view of the cell in a browser: what is drawn, red targets, moving by hand or by numbers, maps."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, Route, expect

import planner
from tests import small_problem
from tests.service.page.test_browser import open_problem
from tests.service.support import wait_until
from tests.service.test_cell_view import FREE_SPIN

SHIFTED = small_problem.PROBLEM.replace("robot: irb140", "robot: irb140\n      base: {xyz_mm: [-435, 0, 0]}")
IN_STOCK = small_problem.PROBLEM.replace("frame: world", "frame: stock")
POST = """
  obstacles:
    - {name: post, shapes: [{kind: box, size_mm: [60, 60, 400], pose: {xyz_mm: [0, 700, 200]}}]}
"""


def pixels(locator: Locator) -> np.ndarray[Any, Any]:
    """Return the rendered pixels (height, width, 3) of an element."""
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("RGB")).astype(int)


def colour_fraction(image: np.ndarray[Any, Any], colour: tuple[int, int, int], tolerance: int = 40) -> float:
    """How much of a picture has about that colour."""
    return float((np.abs(image - np.array(colour)).max(axis=-1) < tolerance).mean())


def open_checked_problem(
    page: Page, server: str, folder: Path, text: str, rows: list[str] | None = None
) -> None:
    """Open a problem with the cell view and wait until its targets are checked."""
    table = "\n".join([small_problem.COLUMNS, *(rows or small_problem.ROWS)]) + "\n"
    path = small_problem.write(folder, text, table)
    open_problem(page, server, [path, folder / "targets.csv"])
    page.get_by_role("tab", name="Cell").click()
    expect(page.locator("#cell-note")).to_contain_text("targets checked", timeout=180_000)


COLOUR = """(name) => {
  const one = document.body.appendChild(document.createElement("i"));
  one.style.color = `var(${name})`;
  const colour = getComputedStyle(one).color;
  one.remove();
  return colour;
}"""
ROWS = [row.replace("450,", "0,", 1) for row in small_problem.ROWS]


def test_the_cell_is_drawn_and_walked_through_before_it_is_planned(
    page: Page, server: str, tmp_path: Path
) -> None:
    open_checked_problem(page, server, tmp_path, small_problem.PROBLEM)
    canvas = page.locator("#cell-canvas")
    expect(page.locator("#cell-note")).to_have_text("6 of 6 targets checked, all have a posture")
    expect(canvas).to_have_attribute("aria-label", re.compile("left, ABB IRB 140"))
    home = pixels(canvas)
    orange = np.array([(item[..., 0] > 150) & (item[..., 2] < 90) for item in [home]]).mean()
    assert orange > 0.01  # the robot has its maker's colour
    slider = page.get_by_role("slider", name="Target")
    slider.focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#cell-where")).to_contain_text("(1 of 6)")
    expect(page.locator("#cell-told")).to_contain_text(re.compile(r"left -?\d+° .*°"))
    page.wait_for_timeout(200)
    first = pixels(canvas)
    assert (np.abs(first - home).max(axis=-1) > 30).mean() > 0.01  # the arm is elsewhere
    page.keyboard.press("End")
    expect(page.locator("#cell-where")).to_contain_text("(6 of 6)")
    canvas.focus()
    before = pixels(canvas)
    for key in ("ArrowLeft", "ArrowLeft", "+"):
        page.keyboard.press(key)
    page.wait_for_timeout(200)
    assert (np.abs(pixels(canvas) - before).max(axis=-1) > 30).mean() > 0.02
    page.keyboard.press("0")
    page.wait_for_timeout(200)
    assert (np.abs(pixels(canvas) - before).max(axis=-1) > 30).mean() < 0.002


def test_red_targets_say_why(page: Page, server: str, tmp_path: Path) -> None:
    open_checked_problem(page, server, tmp_path, SHIFTED)
    note = page.locator("#cell-note")
    expect(note).to_contain_text(re.compile(r"[1-6] without a posture \(red\)"))
    told = page.locator("#cell-told")
    page.get_by_role("button", name="Next red target").click()
    expect(told).to_contain_text("Arm left cannot reach target")
    expect(told).to_have_class(re.compile("wrong"))
    page.get_by_role("slider", name="Target").fill("0")
    expect(told).to_be_empty()
    canvas = page.locator("#cell-canvas")
    image = pixels(canvas)
    red = (image[..., 0] > 180) & (image[..., 1] < 80) & (image[..., 2] < 70)
    assert red.any()
    y, x = (int(np.median(axis)) for axis in np.nonzero(red))
    y, x = min(zip(*np.nonzero(red), strict=True), key=lambda p: abs(p[0] - y) + abs(p[1] - x))
    canvas.hover(position={"x": float(x), "y": float(y)})
    expect(told).to_contain_text("cannot reach")


def test_a_block_is_moved_by_hand_by_steps_and_the_form_follows(
    page: Page, server: str, tmp_path: Path
) -> None:
    text = IN_STOCK.replace("xyz_mm: [450, 0, 0]", "xyz_mm: [452, 3, 0]")
    open_checked_problem(page, server, tmp_path, text, ROWS)
    page.select_option("#cell-move", "stock")
    canvas = page.locator("#cell-canvas")
    page.wait_for_timeout(300)
    lit = pixels(canvas)
    page.select_option("#cell-move", "")
    page.wait_for_timeout(300)
    changed = np.abs(pixels(canvas) - lit).max(axis=-1) > 12  # the block glows while it can be moved
    assert changed.sum() > 100
    y, x = (float(np.median(axis)) for axis in np.nonzero(changed))
    page.select_option("#cell-move", "stock")
    box = canvas.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.mouse.down()
    page.mouse.move(box["x"] + x + 30, box["y"] + y + 4, steps=4)
    page.mouse.up()
    stock_pose = page.locator('[data-path="stock.place.xyz_mm"]')
    values = [float(item.input_value()) for item in stock_pose.locator("input").all()]
    assert values[:2] != [452, 3] and values[2] == 0
    assert all(value % 5 == 0 for value in values)
    shown = [float(item.input_value()) for item in page.locator("#cell-numbers input").all()]
    assert shown[:3] == values
    expect(page.locator("#changes")).to_contain_text("1 field")
    page.keyboard.down("Shift")
    page.mouse.move(box["x"] + x + 30, box["y"] + y + 4)
    page.mouse.down()
    page.mouse.move(box["x"] + x + 60, box["y"] + y + 4, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    yaw = page.locator('[data-path="stock.place.rpy_deg"] input').nth(2)
    assert float(yaw.input_value()) % 15 == 0 and float(yaw.input_value()) != 0
    stock_pose.locator("input").first.fill("400")  # and the other way round
    expect(page.get_by_role("spinbutton", name="the block, x [mm]")).to_have_value("400")
    page.locator('.field[data-path="stock.place.xyz_mm"]').get_by_role("button", name="undo").click()
    expect(page.get_by_role("spinbutton", name="the block, x [mm]")).to_have_value("452")


def test_bases_and_obstacles_are_moved_by_numbers(page: Page, server: str, tmp_path: Path) -> None:
    open_checked_problem(page, server, tmp_path, IN_STOCK.replace("\nstock:", POST + "stock:"), ROWS)
    canvas = page.locator("#cell-canvas")
    before = pixels(canvas)
    page.select_option("#cell-move", "post")
    number = page.get_by_role("spinbutton", name="post, y [mm]")
    number.press("ArrowDown")
    page.locator("summary", has_text="All fields of the cell").click()
    field = page.locator('[data-path="cell.obstacles.0.shapes.0.pose.xyz_mm"] input')
    expect(field.nth(1)).to_have_value("695")
    number = page.get_by_role("spinbutton", name="post, y [mm]")
    number.fill("400")
    number.press("Enter")
    expect(field.nth(1)).to_have_value("400")
    page.select_option("#cell-move", "")
    page.wait_for_timeout(300)
    assert (np.abs(pixels(canvas) - before).max(axis=-1) > 20).sum() > 200
    page.select_option("#cell-move", "left")
    number = page.get_by_role("spinbutton", name="base of left, turn [°]")
    number.press("ArrowUp")
    expect(page.locator('[data-path="cell.arms.0.base.rpy_deg"] input').nth(2)).to_have_value("15")


def test_a_number_that_is_being_typed_stays_when_the_service_answers(
    page: Page, server: str, tmp_path: Path
) -> None:
    open_checked_problem(page, server, tmp_path, IN_STOCK.replace("\nstock:", POST + "stock:"), ROWS)
    page.select_option("#cell-move", "post")
    number = page.get_by_role("spinbutton", name="post, y [mm]")
    other = page.get_by_role("spinbutton", name="post, x [mm]")
    held: list[Route] = []
    page.route(re.compile("/v1/cell"), lambda route: held.append(route))  # playwright marks its handlers
    other.press("ArrowUp")
    while not held:
        page.wait_for_timeout(50)
    number.fill("4")  # and the answer to the key before it comes
    with page.expect_response(re.compile("/v1/cell")) as answer:
        held[0].continue_()
    answer.value.finished()
    page.wait_for_timeout(500)
    page.unroute_all()
    page.keyboard.type("00\n")
    expect(number).to_have_value("400")
    page.locator("summary", has_text="All fields of the cell").click()
    field = page.locator('[data-path="cell.obstacles.0.shapes.0.pose.xyz_mm"] input')
    expect(field.nth(1)).to_have_value("400")


def test_reach_is_drawn_over_the_block_and_says_what_was_looked_at(
    page: Page, server: str, tmp_path: Path
) -> None:
    open_checked_problem(page, server, tmp_path, IN_STOCK, ROWS)
    canvas = page.locator("#cell-canvas")
    before = pixels(canvas)
    with page.expect_response(re.compile("reach=true")) as caught:
        page.select_option("#cell-reach", "left")
    made = caught.value.json()["reach"]
    told = page.locator("#cell-reach-told")
    expect(told).to_contain_text(f"{len(made['points_mm'])} points, every ")
    states = np.array(made["states"]["left"])
    expect(told).to_contain_text(f"within reach {round(100 * float((states == 0).mean()))} %")
    page.wait_for_timeout(300)
    free = tuple(int(c) for c in re.findall(r"\d+", page.evaluate(COLOUR, "--map-free"))[:3])
    assert colour_fraction(pixels(canvas), free, 25) > colour_fraction(before, free, 25) + 0.001
    page.select_option("#cell-reach", "")
    expect(told).to_be_hidden()
    page.wait_for_timeout(300)
    assert (np.abs(pixels(canvas) - before).max(axis=-1) > 30).mean() < 0.002


def test_a_map_shows_what_fails_and_a_click_moves_the_block(page: Page, server: str, tmp_path: Path) -> None:
    open_checked_problem(page, server, tmp_path, IN_STOCK, ROWS)
    with page.expect_response(re.compile("freedom=place")) as caught:
        page.get_by_role("tab", name="Axis map").click()
    made = caught.value.json()["map"]
    canvas = page.locator("#map-canvas")
    expect(canvas).to_be_visible()
    assert made["freedom"] == "place x"
    page.wait_for_timeout(300)
    image = pixels(canvas)
    states = np.array(made["states"]["left"])
    names = ("--map-free", "--map-reach", "--map-limit", "--map-singular", "--map-near")
    style = [page.evaluate(COLOUR, name) for name in names]
    left, top, high = 64, 20, 118
    wide = (image.shape[1] - left - 4) / len(states)
    for k in (0, len(states) - 1):
        for v in (0, 12, 24):
            x, y = int(left + (k + 0.5) * wide), int(top + high * (1 - (v + 0.5) / 25))
            expected = [int(c) for c in re.findall(r"\d+", style[int(states[k, v])])[:3]]
            assert np.abs(image[y, x] - expected).max() <= 3, (k, v)
    free = int(np.flatnonzero(states[0] == 0)[-1])
    value = made["values"][0][free]
    canvas.click(position={"x": left + 0.5 * wide, "y": top + high * (1 - (free + 0.5) / 25)})
    expect(page.locator("#map-told")).to_contain_text("The block was moved.")
    moved = page.locator('[data-path="stock.place.xyz_mm"] input').first
    expect(moved).to_have_value(f"{450 + 5 * round(value / 5):g}")
    expect(page.locator("#cell-where")).to_contain_text("(1 of 6)")
    page.select_option("#map-layer", "clearance_mm")
    expect(page.locator(".map-legend")).to_contain_text("clearance")


def test_the_next_change_ends_the_look_at_the_one_before(page: Page, server: str, tmp_path: Path) -> None:
    open_checked_problem(page, server, tmp_path, IN_STOCK, ROWS)
    waiting: list[Route] = []
    page.route(re.compile("freedom="), lambda route: waiting.append(route))
    with page.expect_request(re.compile("freedom=")):
        page.get_by_role("tab", name="Axis map").click()
    with page.expect_event("requestfailed", lambda request: "freedom=" in request.url):
        page.locator("#f-name").fill("renamed")
    page.unroute_all(behavior="ignoreErrors")
    expect(page.locator("#map-canvas")).to_be_visible(timeout=120_000)


def test_the_tabs_follow_the_arrow_keys_and_the_part_asks_for_nothing(
    page: Page, server: str, small: list[Path]
) -> None:
    requests: list[str] = []
    page.on("request", lambda one: requests.append(one.url))
    open_problem(page, server, small)
    expect(page.locator("#verdict")).to_contain_text("Ready", timeout=180_000)
    assert not [url for url in requests if "/v1/cell" in url or "three" in url]
    page.get_by_role("tab", name="Part").focus()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Cell")).to_be_focused()
    expect(page.locator("#cell-view")).to_be_visible()
    expect(page.locator("#part-view")).to_be_hidden()
    expect(page.locator("#cell-note")).to_contain_text("targets checked", timeout=120_000)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_has_the_colours_of_the_page(page: Page, server: str, tmp_path: Path, scheme: Any) -> None:
    page.emulate_media(color_scheme=scheme)
    open_checked_problem(page, server, tmp_path, IN_STOCK, ROWS)
    corner = pixels(page.locator("#cell-canvas"))[4, 4]
    assert (corner > 200).all() if scheme == "light" else (corner < 60).all()


def test_the_way_of_an_earlier_plan_is_drawn_through_the_map(page: Page, server: str, tmp_path: Path) -> None:
    client = planner.Client(server)
    job = client.submit(planner.load(small_problem.write(tmp_path, FREE_SPIN)))
    wait_until(lambda: client.job(job)["state"] not in ("queued", "running"))
    page.goto(f"{server}/ui/new?job={job}")
    with page.expect_response(re.compile(f"freedom=spin.*job={job}"), timeout=120_000) as caught:
        page.get_by_role("tab", name="Axis map").click()
    made = caught.value.json()["map"]
    expect(page.locator(".map-legend")).to_contain_text("path of the plan")
    page.wait_for_timeout(300)
    image = pixels(page.locator("#map-canvas"))
    wide = (image.shape[1] - 64 - 4) / 6
    low, high = made["values"][0][0], made["values"][0][-1]
    step = (high - low) / (len(made["values"][0]) - 1)
    ink = [int(c) for c in re.findall(r"\d+", page.evaluate(COLOUR, "--ink"))[:3]]
    for k in (1, 4):
        share_up = (made["path"][k] - low + step / 2) / (high - low + step)
        x, y = round(64 + (k + 0.5) * wide), round(20 + 118 * (1 - share_up))
        near = image[max(y - 2, 0) : y + 3, x]
        assert np.abs(near - ink).max(axis=-1).min() < 30, (k, made["path"])
