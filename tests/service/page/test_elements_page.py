"""Building elements on the page, in a real browser.

They are uploaded, divided again with sliders, ticked off at the robot, and meanwhile changed and deleted by
other users.
"""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from playwright.sync_api import Page, Route, expect

from tests.element.shells import cap, shell
from tests.element.test_saw_jobs import write_small_shell

COUNT = 24


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    return shell_files(tmp_path)


def shell_files(tmp_path: Path) -> list[Path]:
    """The files of a small shell, as a user has them on disk."""
    path = shell(tmp_path, cap(n=9), {"count": COUNT, "off_surface_mm": 60})
    cell = Path(yaml.safe_load((tmp_path / "held.yaml").read_text())["cell"])
    return [tmp_path / "held.yaml", path, tmp_path / "shell.obj", cell]


def upload(page: Page, server: str, files: list[Path]) -> None:
    page.goto(f"{server}/ui/elements")
    page.locator("#files").set_input_files(files)
    page.wait_for_url("**/ui/elements/*")
    expect(page.locator("#size")).to_have_text(f"{COUNT} panels", timeout=90_000)


def test_an_element_is_divided_by_sliders_and_ticked_off(page: Page, server: str, files: list[Path]) -> None:
    page.goto(f"{server}/ui/elements")
    page.locator("#files").set_input_files(files[1:])  # without its template
    expect(page.locator("#issues")).to_contain_text("held.yaml")
    upload(page, server, files)
    expect(page.locator("#verdict")).to_contain_text(f"{COUNT} panels")
    expect(page.locator(".panel-id").first).to_have_text(re.compile("^[A-Z][0-9]{2}$"))
    expect(page.locator("#foam-said")).to_contain_text("Robot hours: cutting takes about")
    expect(page.locator("#foam-said")).to_contain_text(f"Proven: 0 of {COUNT}")

    seen = np.asarray(Image.open(io.BytesIO(page.locator("#canvas").screenshot())).convert("RGB"))
    for rim in (seen[5], seen[-6], seen[:, 5], seen[:, -6]):  # all of it is in the picture, and fills that
        assert (np.abs(rim.astype(int) - seen[5, 5])[:-9] <= 2).all()
    inside = np.flatnonzero((np.abs(seen[9:-9, 9:-9].astype(int) - seen[5, 5]) > 20).any(axis=(1, 2)))
    assert np.ptp(inside) > 0.6 * len(seen)

    label = page.locator(".panel-id").last
    name, place = label.inner_text(), label.bounding_box()
    assert place is not None
    page.mouse.click(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    expect(page.locator("#said")).to_contain_text(f"{name}: not planned")
    expect(page.locator(".panel.chosen")).to_contain_text(name)

    slider = page.get_by_role("slider", name="Panels, slider")
    slider.focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#size")).to_have_text(f"{COUNT + 1} panels", timeout=90_000)
    number = page.get_by_role("spinbutton", name="Panels", exact=True)
    number.fill("100000")
    field = page.locator('[data-path="panels.hexagons.count"]')
    expect(field.locator(".fault.error")).to_contain_text("less than or equal to 5000")
    expect(page.locator("#size")).to_have_text(f"{COUNT + 1} panels")  # what was divided before stays

    held: list[Route] = []

    def hold_the_first(route: Route) -> None:
        if held:
            route.continue_()
        held.append(route)

    page.route(re.compile("/divide"), hold_the_first)
    number.fill("20")
    page.wait_for_timeout(500)
    number.fill("22")  # while the answer to the first is under way
    page.wait_for_timeout(500)
    assert len(held) == 1
    held[0].continue_()
    expect(page.locator("#size")).to_have_text("22 panels", timeout=90_000)
    expect(number).to_have_value("22")
    expect(field.locator(".fault")).to_have_count(0)

    cut = page.get_by_role("button", name="A01 cut")
    cut.press("Enter")
    expect(cut).to_have_attribute("aria-pressed", "true")
    expect(cut).to_be_focused()
    expect(page.locator("#told")).to_contain_text("1 cut")
    other = page.context.new_page()
    other.goto(page.url)
    other.get_by_role("button", name="A01 glued").click()
    expect(page.get_by_role("button", name="A01 glued")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("button", name="A01 glued").click()  # a tap that was wrong
    expect(page.locator("#told")).to_contain_text("0 are glued, 0 cut")

    page.get_by_role("button", name="Create job of A02").click()
    row = page.locator('[data-panel="A02"]')
    expect(row.get_by_role("link", name="Job of A02")).to_have_attribute("href", re.compile("/ui/jobs/"))
    page.get_by_role("button", name="Cancel open jobs").click()
    expect(row.locator(".badge")).to_have_text("Cancelled")

    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    high = "Math.min(...[...document.querySelectorAll('.tick button')].map(one => one.offsetHeight))"
    assert page.evaluate(high) >= 44
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("input, select, button, canvas")]
          .filter(one => one.checkVisibility() && one.ariaHidden !== "true")
          .filter(one => !one.ariaLabel && !one.labels?.length && !one.textContent.trim())
          .map(one => one.outerHTML)"""
    )
    assert nameless == []

    other.get_by_role("button", name="Delete").click()
    other.get_by_role("dialog").get_by_role("button", name="Delete").click()
    other.wait_for_url("**/ui/elements")
    expect(page.locator("#banner")).to_contain_text("no longer exists")
    expect(page.get_by_role("button", name="A01 cut")).to_be_disabled()


def test_jobs_of_raw_blocks_are_ticked_off_with_their_panels(page: Page, server: str, tmp_path: Path) -> None:
    upload(page, server, write_small_shell(tmp_path))
    match = re.fullmatch("Create jobs of all ([0-9]+)", page.locator("#plan").inner_text())
    assert match is not None
    row = page.locator("#block-jobs li").filter(has_text=" together").first
    job = row.locator("b").inner_text()
    names = re.findall(r"\b[A-C][0-9]{2}", row.locator(".sub").inner_text())
    expect(page.locator("#told")).to_contain_text(f"{', '.join(names)} together of block")
    first = page.locator(f'[data-panel="{names[0]}"]')
    expect(first).to_contain_text(f"cut in {job} with others")
    expect(first.get_by_role("button", name="job", exact=False)).to_have_count(0)  # it has none of its own
    page.get_by_role("button", name=f"{names[0]} broken").click()
    cut = row.get_by_role("button", name=f"Job {job} cut")
    cut.press("Enter")
    expect(cut).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("button", name=f"{names[1]} cut")).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#told")).to_contain_text(f"again/{names[0]}.yaml")
    page.get_by_role("button", name=f"Create own job of {names[0]}").press("Enter")
    expect(page.get_by_role("link", name=f"Job of {names[0]}")).to_be_focused()
    expect(first).not_to_contain_text("with others")
    page.get_by_role("button", name="Cancel open jobs").click()
    left = int(match[1]) + 1  # what was stopped, too
    expect(page.locator("#plan")).to_have_text(f"Create jobs of all {left}")
