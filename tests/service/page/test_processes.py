"""One whole job of each process in a real browser, from its bundled problem to the programs."""

from __future__ import annotations

import re
import zipfile

import pytest
from playwright.sync_api import Page, expect

SMALLEST = {
    "elastic_wire": "wave_wall",
    "straight_wire": "wing",
    "forming": "cone_spif",
    "milling": "engrave",
    "targets": "gauge_lanes",
}
MAX_WAIT_MS = 900_000


@pytest.mark.long
@pytest.mark.parametrize("process", SMALLEST)
def test_a_whole_job_of_each_process(page: Page, server: str, process: str) -> None:
    page.goto(f"{server}/ui/new")
    page.locator(f"input[name=process][value={process}]").check()
    page.locator("#rest").wait_for()
    page.locator("#example").select_option(SMALLEST[process])
    expect(page.locator("#source")).to_have_text(f"from the bundled problem {SMALLEST[process]}")
    expect(page.locator("#verdict")).to_contain_text("Ready", timeout=MAX_WAIT_MS)
    expect(page.locator("#size")).to_contain_text("mm")
    page.get_by_role("button", name="Start planning").click()
    page.wait_for_url("**/ui/jobs/*")
    expect(page.locator("#state")).to_have_text("Verified", timeout=MAX_WAIT_MS)
    with page.expect_download() as caught:
        page.get_by_role("link", name="Download programs").click()
    with zipfile.ZipFile(caught.value.path()) as archive:
        texts = [archive.read(name).decode() for name in archive.namelist()]
    assert any(re.search(r"^(MODULE|DEF) ", text, re.MULTILINE) for text in texts)  # RAPID, KRL
    page.get_by_role("tab", name="Replay").click()
    expect(page.frame_locator("iframe.replay").locator("#bar .time")).to_contain_text("/", timeout=60_000)
