"""Accessibility of every page at three widths, in the light and the dark scheme.

axe-core (Deque, the engine in the developer tools of browsers) finds nothing, nothing is cut off, and every
control has a name. ``TANDEM_AXE`` is the file ``axe.min.js`` of npm's package ``axe-core``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import pytest
from playwright.sync_api import Browser, Page, expect

import planner
from planner.reading import strict_yaml
from tests import small_problem
from tests.element.shells import cap, shell
from tests.service.page.test_elements_page import upload
from tests.service.support import ROOT, wait_until

SIZES: Final = ((390, 844), (768, 1024), (1440, 900))
Scheme = Literal["light", "dark"]
SCHEMES: Final[tuple[Scheme, ...]] = ("light", "dark")
DISPLAY_VARIANTS: Final = [(scheme, size) for scheme in SCHEMES for size in SIZES]
AXE: Final = os.environ.get("TANDEM_AXE", "")
LONG_NAME: Final = "W" * 24
"""The longest name that a problem may have, of the widest letter."""

CUT_OFF: Final = """() => {
  const width = document.documentElement.clientWidth, out = [];
  const moves = (one) => ["auto", "scroll"].includes(getComputedStyle(one).overflowX);
  const inside = (one) => {
    for (let up = one.parentElement; up; up = up.parentElement) if (moves(up)) return true;
    return false;
  };
  for (const one of document.querySelectorAll("body *")) {
    if (!one.checkVisibility() || one.closest(".unseen, .skip, svg, select, #labels")) continue;
    const box = one.getBoundingClientRect();
    const hides = ["hidden", "clip"].includes(getComputedStyle(one).overflowX);
    const told = `${one.tagName} ${one.id} .${one.className}: `;
    const out_of_page = box.width && box.height && (box.right > width + 1 || box.left < -1);
    if (out_of_page && !inside(one)) out.push(`${told}to ${box.right}`);
    const inner = one.scrollWidth, room = one.clientWidth;
    if (hides && inner > room + 1) out.push(`${told}${inner} in ${room}`);
  }
  const whole = document.scrollingElement.scrollWidth;
  if (whole > width) out.push(`page: ${whole}`);
  return out;
}"""
"""What is wider than the page, or than the box that hides what is wider."""

NAMELESS: Final = """() => {
  const some = "a, button, input, select, textarea, summary, canvas, iframe, [tabindex='0']";
  const by = (one) => one.labels?.length || one.getAttribute("aria-labelledby");
  const named = (one) => one.ariaLabel || one.title || by(one);
  return [...document.querySelectorAll(some)]
    .filter((one) => one.checkVisibility() && !one.closest("[aria-hidden=true]"))
    .filter((one) => !named(one) && !one.innerText?.trim())
    .map((one) => one.outerHTML.slice(0, 200));
}"""
"""Controls without a name; text that is not shown is none."""


@pytest.fixture(scope="module")
def page_addresses(
    server: str, browser: Browser, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, str]]:
    """Addresses of all pages, by name."""
    client = planner.Client(server)
    folder = tmp_path_factory.mktemp("jobs")
    long = small_problem.PROBLEM.replace("name: small", f"name: {LONG_NAME}")
    jobs = [
        client.submit(planner.load(small_problem.write(folder, text)))
        for text in (small_problem.PROBLEM, long)
    ]
    none = client.submit(planner.load(ROOT / "problems/infeasible/wire_too_short.yaml"))
    held = tmp_path_factory.mktemp("element")
    path = shell(held, cap(n=9), {"count": 24, "off_surface_mm": 60})
    cell = Path(strict_yaml.read(held / "held.yaml").data["cell"])
    tab = browser.new_page()
    upload(tab, server, [held / "held.yaml", path, held / "shell.obj", cell])
    element = tab.url
    tab.close()
    wait_until(lambda: all(client.job(item)["state"] not in ("queued", "running") for item in (*jobs, none)))
    yield {
        "jobs": f"{server}/",
        "new": f"{server}/ui/new",
        "new: form": f"{server}/ui/new?example=wing",
        "new: sheet": f"{server}/ui/new?example=cone_spif",
        "new: faults": f"{server}/ui/new?example=wing",
        "new: cell": f"{server}/ui/new?job={jobs[0]}",
        "new: map": f"{server}/ui/new?job={jobs[0]}",
        "job": f"{server}/ui/jobs/{jobs[1]}",
        "job: replay": f"{server}/ui/jobs/{jobs[0]}#replay",
        "job: files": f"{server}/ui/jobs/{jobs[0]}#files",
        "job: no plan": f"{server}/ui/jobs/{none}",
        "job: missing": f"{server}/ui/jobs/{'0' * 32}",
        "compare": f"{server}/ui/compare?a={jobs[0]}&b={jobs[1]}",
        "compare: none": f"{server}/ui/compare",
        "drafts": f"{server}/ui/drafts",
        "elements": f"{server}/ui/elements",
        "element": element,
        "element: missing": f"{server}/ui/elements/{'0' * 32}",
        "audit": f"{server}/ui/audit",
        "login": f"{server}/ui/login",
    }


def open_whole_page(page: Page, name: str, address: str) -> None:
    """The page as it is when all of it has come."""
    page.goto(address)
    kind, _, state = name.partition(": ")
    if kind == "new" and state:
        expect(page.locator("#verdict")).not_to_be_empty()
        expect(page.locator("#operations-form input").first).to_be_attached()
    if state in ("cell", "map"):
        page.get_by_role("tab", name="Cell").click()
        page.select_option("#cell-move", "stock")
        page.get_by_role("tab", name="Axis map" if state == "map" else "Cell").click()
        if state == "map":
            expect(page.locator("#map-canvas")).to_be_visible(timeout=120_000)
    if state == "faults":
        page.locator("#f-name").fill("9 lives")
        expect(page.locator("#check-issues li.error").first).to_be_visible()
    elif state == "missing":
        expect(page.locator("#banner")).not_to_be_empty()
    elif kind == "job":
        tab = {"replay": "Replay", "files": "Files"}.get(state)
        expect(page.locator("#tabs")).to_be_visible()
        if tab:
            page.get_by_role("tab", name=tab).click()
    elif kind == "jobs":
        expect(page.locator("#rows tr")).not_to_have_count(0)
        expect(page.locator("#rows img.thumb").first).to_have_js_property("complete", True)
    elif name == "element":
        expect(page.locator(".panel").first).to_be_visible()
    elif name == "compare":
        expect(page.locator("#result")).to_contain_text("Motion time")
    if state == "form":
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
    page.wait_for_timeout(100)


PAGES: Final = (
    "jobs",
    "new",
    "new: form",
    "new: sheet",
    "new: faults",
    "new: cell",
    "new: map",
    "job",
    "job: replay",
    "job: files",
    "job: no plan",
    "job: missing",
    "compare",
    "compare: none",
    "drafts",
    "elements",
    "element",
    "element: missing",
    "audit",
    "login",
)


@pytest.mark.sampled(every=4)
@pytest.mark.parametrize("name", PAGES)
def test_nothing_is_cut_off_and_every_control_has_a_name(
    page: Page, page_addresses: dict[str, str], name: str
) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    open_whole_page(page, name, page_addresses[name])
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate(CUT_OFF) == [], width
        assert page.evaluate(NAMELESS) == [], width


def test_what_is_cut_off_or_nameless_is_found(page: Page, page_addresses: dict[str, str]) -> None:
    open_whole_page(page, "login", page_addresses["login"])
    page.set_viewport_size({"width": 390, "height": 844})
    page.evaluate(
        """() => {
          const wide = document.createElement("p"), box = document.createElement("div");
          wide.style.width = "500px"; wide.textContent = "wide";
          box.style.overflow = "hidden"; box.append(wide.cloneNode(true));
          document.querySelector("main").append(wide, box, document.createElement("button"));
        }"""
    )
    assert len(page.evaluate(CUT_OFF)) >= 3
    assert page.evaluate(NAMELESS) == ["<button></button>"]


@pytest.mark.sampled(every=4)
@pytest.mark.skipif(not AXE, reason="TANDEM_AXE names no axe.min.js: npm pack axe-core")
@pytest.mark.parametrize(
    "variants",
    [
        DISPLAY_VARIANTS[:1] + DISPLAY_VARIANTS[-1:],
        pytest.param(DISPLAY_VARIANTS[1:-1], marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_nothing(
    browser: Browser,
    page_addresses: dict[str, str],
    name: str,
    variants: Sequence[tuple[Scheme, tuple[int, int]]],
) -> None:
    """Narrow and light, wide and dark; between these in the long run."""
    context = browser.new_context(bypass_csp=True)  # its script is none of the page's own
    context.add_init_script(path=AXE)
    page = context.new_page()
    page.set_default_timeout(30_000)
    found = []
    open_whole_page(page, name, page_addresses[name])
    # what the card of the check lies over for the moment would be held against its colours
    page.add_style_tag(content="#check-card { position: static !important; }")
    for scheme, (width, height) in variants:
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": height})
        found += [
            (scheme, width, violation["id"], [node["html"][:200] for node in violation["nodes"]])
            for violation in violations(page)
        ]
    context.close()
    assert found == []


def violations(page: Page) -> list[dict[str, Any]]:
    """Return axe's violations on the page. Frames are excluded, because their pages have their own tests."""
    asked = "axe.run({exclude: [['iframe']]}, {resultTypes: ['violations']}).then((all) => all.violations)"
    out: list[dict[str, Any]] = page.evaluate(asked)
    return out


@pytest.mark.skipif(not AXE, reason="TANDEM_AXE names no axe.min.js: npm pack axe-core")
def test_axe_sees_the_colours_of_both_schemes(browser: Browser, page_addresses: dict[str, str]) -> None:
    """The check itself can fail."""
    context = browser.new_context(bypass_csp=True, color_scheme="dark")
    context.add_init_script(path=AXE)
    page = context.new_page()
    open_whole_page(page, "login", page_addresses["login"])
    page.evaluate("document.querySelector('h1').style.color = '#333'")
    assert "color-contrast" in [violation["id"] for violation in violations(page)]
    context.close()
