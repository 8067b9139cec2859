"""A real browser for the page tests: the distribution's Chromium, driven by Playwright.

It renders in software.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect, sync_playwright

from tests.service.support import Process

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
GRAPHICS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL in software;"""
PLAIN = ["--disable-gpu-rasterization", "--disable-gpu-compositing"]
"""all else is drawn without it, which takes a third of the time."""
ARGUMENTS = ["--no-sandbox", *GRAPHICS, *PLAIN]
expect.set_options(timeout=90_000)  # readings of uploads wait for processors, where two suites run at once


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One browser for all tests of a worker."""
    if BROWSER is None:
        pytest.skip("no Chromium here: apt-get install chromium")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=BROWSER, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A tab of a browser that knows nothing; at the end, no script failed and no policy was broken."""
    context = browser.new_context(viewport={"width": 1366, "height": 900}, accept_downloads=True)
    tab = context.new_page()
    tab.set_default_timeout(90_000)
    faults: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        told = message.text
        if message.type == "error" and "Failed to load resource" not in told and "ERR_" not in told:
            faults.append(told)

    tab.on("console", listen)
    tab.on("pageerror", lambda error: faults.append(str(error.stack)))
    yield tab
    context.close()
    assert not faults


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a real service with one worker."""
    process = Process(tmp_path_factory.mktemp("page") / "data").wait()
    yield process.url
    process.stop()


@pytest.fixture
def small(tmp_path: Path) -> list[Path]:
    """The files of the small problem, as a user has them on disk."""
    from tests import small_problem

    return [small_problem.write(tmp_path), tmp_path / "targets.csv"]
