"""The page in a real browser: whole jobs, refusals at their fields, and a service that goes down."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from playwright.sync_api import Page, Route, expect

import planner
from planner.service.models import Database, default_url
from planner.service.security import Auth
from tests.service.support import ROOT, Process, free_port

MAX_WAIT_MS = 180_000


def open_problem(page: Page, server: str, files: list[Path]) -> None:
    """Upload the user's own problem on the page for new jobs."""
    page.goto(f"{server}/ui/new")
    page.get_by_text("Sheet forming").wait_for()
    page.locator("#problem-file").set_input_files(files)


def with_issues_at(page: Page, *times: float) -> None:
    """Show the job as if the proof had remarks on those moments."""
    remarks = [
        {
            "code": "verify.clearance",
            "severity": "note",
            "message": f"remark {t}",
            "time": t,
            "field": "cut/path",
        }
        for t in times
    ]

    def answer(route: Route) -> None:
        job = route.fetch().json()
        route.fulfill(json={**job, "issues": remarks})

    page.route(re.compile("/v1/jobs/[0-9a-f]{32}$"), answer)
    page.goto(page.url.split("#")[0])
    page.reload()


def answers(address: str, timeout_s: float = 60.0) -> None:
    """Wait until a service answers."""
    until = time.monotonic() + timeout_s
    while time.monotonic() < until:
        try:
            with urllib.request.urlopen(f"{address}/v1/health", timeout=5):
                return
        except OSError:
            time.sleep(0.1)
    raise TimeoutError(address)


def wait_until_read(page: Page) -> None:
    """Wait until the problem was read; the check of the whole may go on."""
    expect(page.locator("#verdict")).to_contain_text(re.compile("Checking|Testing|Ready|to correct"))


def start(page: Page) -> None:
    """Begin to plan, when the whole was checked."""
    button = page.get_by_role("button", name="Start planning")
    expect(button).to_be_enabled(timeout=MAX_WAIT_MS)
    button.click()


COUNTS = """
  for (const kind of ["click", "keydown"]) {
    addEventListener(kind, (event) => event.isTrusted && window.counted(kind), true);
  }
"""
"""Counts what a user clicks and types."""


ENTER = """() => {
  const key = { key: "Enter", bubbles: true, cancelable: true };
  if (document.activeElement.dispatchEvent(new KeyboardEvent("keydown", key))) throw Error("it goes on");
}"""
"""Presses Enter where the focus is, which the page has to take for itself."""


def open_bundled(page: Page, server: str, name: str) -> None:
    """Begin with a bundled problem, and wait until it is read."""
    page.goto(f"{server}/ui/new?example={name}")
    wait_until_read(page)


def test_a_whole_job_from_upload_to_download(
    page: Page, server: str, small: list[Path], tmp_path: Path
) -> None:
    counted = {"click": 0, "keydown": 0}
    page.context.expose_binding("counted", lambda source, what: counted.update({what: counted[what] + 1}))
    page.add_init_script(COUNTS)
    page.goto(server)
    page.get_by_role("link", name="New job").first.click()
    with page.expect_file_chooser() as chooser:
        page.get_by_text("Or open your own problem files").click()
    chooser.value.set_files(small)
    wait_until_read(page)
    expect(page.locator("#size")).to_have_text("100 × 100 × 100 mm")
    start(page)
    page.wait_for_url("**/ui/jobs/*")
    expect(page.locator("#state")).to_have_text("Verified", timeout=90_000)
    page.get_by_role("button", name="Release", exact=True).click()
    page.keyboard.type("A B")  # into who releases, without a click
    page.evaluate(ENTER)  # which neither releases nor throws away what was typed
    expect(page.get_by_label("Released by")).to_have_value("A B")
    page.get_by_role("dialog").get_by_role("button", name="Release", exact=True).click()
    expect(page.locator("#released-list")).to_contain_text("Released by A B, ")
    expect(page.locator("#figures")).to_contain_text("Minimum clearance")
    report = page.frame_locator("iframe.report")
    expect(report.get_by_role("heading", name="small")).to_be_visible()
    with page.expect_download() as caught:
        page.get_by_role("link", name="Download released programs").click()
    assert (counted["click"], counted["keydown"]) == (6, 3)  # from an empty browser to released programs
    with zipfile.ZipFile(caught.value.path()) as archive:
        assert any("MODULE" in archive.read(name).decode() for name in archive.namelist())
    page.get_by_role("tab", name="Replay").click()
    frame = page.frame_locator("iframe.replay")
    expect(frame.locator("#bar .time")).to_contain_text("/ 0:08.5", timeout=60_000)
    with_issues_at(page, 6.7, 8.7)  # on the programs' clock; the work takes from 4.1 to 9.3 s there
    page.get_by_role("button", name="Show at 0:06.7").click()
    time = frame.locator("#bar .time")
    expect(time).to_contain_text("0:04.", timeout=60_000)
    page.get_by_role("tab", name="Issues (2)").click()
    page.get_by_role("button", name="Show at 0:08.7").click()
    expect(time).to_contain_text("0:06.")
    page.unroute_all()
    page.get_by_role("link", name="Re-run with changes").click()
    page.locator("#f-settings button, #f-settings").first.wait_for(state="attached")
    page.locator("#f-name").fill("renamed")
    expect(page.locator("#changes")).to_contain_text("1 field changed")
    expect(page.locator('.field[data-path="name"] .was')).to_contain_text("was small")
    start(page)
    page.wait_for_url("**/ui/jobs/*")
    page.goto(server)
    boxes = page.locator("#rows input[type=checkbox]")
    boxes.nth(0).check()
    boxes.nth(1).check()
    page.get_by_role("link", name="Compare the two").click()
    row = page.locator("#result tr", has_text=re.compile("^name"))
    expect(row).to_contain_text("renamed")
    expect(row).to_contain_text("small")


@pytest.mark.long
def test_a_list_that_is_open_shows_jobs_that_others_send(page: Page, server: str, small: list[Path]) -> None:
    page.goto(server)
    page.locator("#rows tr, #empty").first.wait_for()
    text = small[0].read_text()
    small[0].write_text(text.replace("name: small", "name: sent_by_another"))
    job = planner.Client(server).submit(planner.load(small[0]))
    sent = page.locator("#rows tr", has_text="sent_by_another")
    expect(sent).to_have_count(1)
    expect(sent).to_contain_text("Verified", timeout=90_000)
    planner.Client(server).delete(job)
    expect(sent).to_have_count(0)


def test_what_has_no_plan_says_what_where_and_what_to_do(page: Page, server: str) -> None:
    open_bundled(page, server, "infeasible/wire_too_short")
    expect(page.locator("#verdict")).to_contain_text("to correct", timeout=MAX_WAIT_MS)
    expect(page.locator("#check-issues")).to_contain_text(re.compile("length_mm: [0-9]+"))
    expect(page.get_by_role("button", name="Start planning")).to_be_disabled()
    client = planner.Client(server)
    job = client.submit(planner.load(ROOT / "problems/infeasible/wire_too_short.yaml"))
    page.goto(f"{server}/ui/jobs/{job}")
    title = page.locator("#outcome-title")
    expect(title).to_have_text("There is no feasible plan for this problem", timeout=90_000)
    outcome = page.locator("#outcome")
    for told in ("wire.too_short", "170 mm", re.compile("What to do: .*length_mm: [0-9]+"), "wire › length"):
        expect(outcome).to_contain_text(told)
    expect(page.get_by_role("link", name="Download programs")).to_be_hidden()
    page.get_by_role("button", name="Change this field").first.click()
    length = page.locator('.field[data-path="operations.0.wire.length_mm"]')
    expect(length.locator("input")).to_be_focused()
    length.locator("input").fill("400")
    expect(length.locator(".was")).to_contain_text("was 170")
    length.get_by_role("button", name="undo").click()
    expect(length.locator("input")).to_have_value("170")


def test_ready_is_said_when_the_whole_was_checked(page: Page, server: str, small: list[Path]) -> None:
    """A stock that is metres away is found by the check of reach alone."""
    waiting: list[Route] = []
    page.route(re.compile("/v1/check.reach"), lambda route: waiting.append(route))
    with page.expect_request(re.compile("/v1/check.reach")):
        open_problem(page, server, small)
    verdict, button = page.locator("#verdict"), page.get_by_role("button", name="Start planning")
    expect(verdict).to_contain_text("Checked 6 of 6 targets: no errors so far")
    expect(verdict).to_contain_text("Testing the part, the tools and the reach")
    expect(button).to_be_disabled()
    for route in waiting:
        route.continue_()
    page.unroute_all()
    expect(verdict).to_contain_text("Ready", timeout=MAX_WAIT_MS)
    expect(button).to_be_enabled()
    text = small[0].read_text()
    small[0].write_text(text.replace("robot: irb140", "robot: irb140\n      base: {xyz_mm: [-1900, 0, 0]}"))
    open_problem(page, server, small)
    expect(verdict).to_contain_text("to correct", timeout=MAX_WAIT_MS)
    expect(page.locator("#check-issues")).to_contain_text("reach")
    expect(button).to_be_disabled()


def test_the_next_change_breaks_off_the_look_at_the_one_before(
    page: Page, server: str, small: list[Path]
) -> None:
    waiting: list[Route] = []
    page.route(re.compile("/v1/check.targets"), lambda route: waiting.append(route))
    with page.expect_request(re.compile("/v1/check.targets")):
        open_problem(page, server, small)
    with page.expect_event("requestfailed", lambda request: "/v1/check" in request.url):
        page.locator("#f-name").fill("renamed")
    page.unroute_all(behavior="ignoreErrors")
    expect(page.locator("#verdict")).to_contain_text("Ready", timeout=MAX_WAIT_MS)


def test_a_fault_of_the_first_look_is_told_while_the_whole_goes_on(
    page: Page, server: str, small: list[Path]
) -> None:
    waiting: list[Route] = []
    page.route(re.compile("/v1/check.reach"), lambda route: waiting.append(route))
    text = small[0].read_text()
    small[0].write_text(text.replace("robot: irb140", "robot: irb140\n      base: {xyz_mm: [-1900, 0, 0]}"))
    with page.expect_request(re.compile("/v1/check.reach")):
        open_problem(page, server, small)
    expect(page.locator("#verdict")).to_contain_text("1 thing to correct; checked 1 of 6 targets so far")
    expect(page.locator("#check-issues")).to_contain_text("cannot reach")
    expect(page.get_by_role("button", name="Start planning")).to_be_disabled()
    page.unroute_all(behavior="ignoreErrors")


def test_a_refusal_shows_at_its_field(page: Page, server: str, small: list[Path]) -> None:
    text = small[0].read_text().replace("irb140", "irb141").replace("tandem: 1", "tandem: 1\ncolour: red")
    small[0].write_text(text + "settings: {speed_fraction: 3}\n")
    open_problem(page, server, small)
    expect(page.locator("#verdict")).to_contain_text("to correct")
    speed = page.locator('.field[data-path="settings.speed_fraction"]')
    expect(speed.locator(".fault.error")).to_contain_text("less than or equal to 1")
    expect(speed.locator("input")).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("button", name="Start planning")).to_be_disabled()
    unknown = page.locator("#check-issues li", has_text="Unknown key")
    unknown.get_by_role("button", name="Remove it").click()
    expect(unknown).to_have_count(0)
    speed.locator("input").fill("0.5")
    expect(speed.locator(".fault")).to_have_count(0)


def test_a_part_in_the_wrong_unit_is_seen_and_told(page: Page, server: str, tmp_path: Path) -> None:
    open_bundled(page, server, "cone_spif")
    cone = trimesh.load(ROOT / "problems" / "cone_spif" / "cone.ply", force="mesh")
    cone.apply_scale(1e-3)
    page.locator("#files").set_input_files(
        {"name": "metres.stl", "mimeType": "", "buffer": cone.export(file_type="stl")}
    )
    size = np.ptp(cone.vertices, axis=0)
    rows = page.locator(".unit-row")
    expect(rows.filter(has=page.locator("b", has_text=re.compile("^m$")))).to_contain_text(
        f"{1000 * size[0]:.4g} ×"
    )
    expect(rows.first).to_contain_text("far too small")
    unit = page.locator('[data-path="part.sheet_mesh.unit"]')
    expect(unit.locator(".fault.error")).to_contain_text(re.compile("required", re.I))
    rows.first.locator("input").check()
    expect(unit.locator(".fault.error")).to_contain_text("in the stated unit")
    page.locator('.unit-row input[value="m"]').check()
    wait_until_read(page)
    expect(page.locator("#size")).to_contain_text("× 25 mm")


def test_the_last_choice_holds_although_an_earlier_one_is_slower(page: Page, server: str) -> None:
    page.goto(f"{server}/ui/new")
    page.get_by_text("Sheet forming").wait_for()
    waiting: list[Route] = []
    page.route(re.compile(r"example\?name=flank_wall"), lambda route: waiting.append(route))
    page.locator("input[name=process][value=milling]").check()
    example = page.locator("#example")
    example.select_option("flank_wall")
    example.select_option("engrave")
    source = page.locator("#source")
    expect(source).to_have_text("from the bundled problem engrave")
    with page.expect_response(re.compile(r"example\?name=flank_wall")):
        for route in waiting:
            route.continue_()
    page.wait_for_timeout(300)
    expect(source).to_have_text("from the bundled problem engrave")


def test_another_cell_is_taken_with_its_arms(page: Page, server: str) -> None:
    open_bundled(page, server, "wing")
    page.locator("#cell").select_option("irb140_bow")
    expect(page.locator("#arms")).to_contain_text("IRB140")
    expect(page.locator("#changes")).to_contain_text("changed")
    expect(page.locator("#f-operations-0-arms")).to_have_value("robot")


@pytest.mark.parametrize("name", ["problem.txt", "broken.yaml"])
def test_what_is_no_problem_file_is_refused_in_words(
    page: Page, server: str, tmp_path: Path, name: str
) -> None:
    (tmp_path / name).write_text("tandem: [1\nname: <img src=x onerror=alert(1)>")
    open_problem(page, server, [tmp_path / name])
    expect(page.get_by_role("alert")).to_contain_text("cannot be opened")
    expect(page.locator("#verdict")).to_contain_text("to correct")


def test_the_page_is_used_by_keyboard_alone(page: Page, server: str) -> None:
    page.goto(f"{server}/ui/new")
    first = page.locator("input[name=process]").first
    first.wait_for()
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.name") == "process":
            break
    page.keyboard.press("Space")
    wait_until_read(page)
    page.keyboard.press("ArrowRight")
    expect(page.locator("#source")).to_have_text(re.compile("bundled problem"))
    expect(page.locator("input[name=process]:checked")).to_have_value("straight_wire")
    page.locator("#canvas").focus()
    before = str(page.locator(".measure").first.get_attribute("style"))
    page.keyboard.press("ArrowLeft")
    expect(page.locator(".measure").first).not_to_have_attribute("style", before)
    nameless = page.evaluate(  # at one moment: the form is drawn anew when an answer comes
        """() => [...document.querySelectorAll("input, select, textarea")]
          .filter(one => one.checkVisibility() && one.ariaHidden !== "true")  // some are behind a button
          .filter(one => !one.labels.length && !one.ariaLabel)
          .map(one => one.id || one.outerHTML)"""
    )
    assert nameless == []


def test_colours_are_switched_and_remembered(page: Page, server: str) -> None:
    page.goto(server)
    colour = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(colour)
    page.get_by_role("button", name="Use dark colours").click()
    dark = page.evaluate(colour)
    assert dark != light
    page.reload()
    assert page.evaluate(colour) == dark


@pytest.mark.long
def test_a_job_goes_on_when_the_service_is_killed_and_started_again(
    page: Page, tmp_path: Path, small: list[Path]
) -> None:
    data, port = tmp_path / "data", free_port()
    data.mkdir()
    command = [sys.executable, "-m", "tests.service.page.held", str(port), str(data)]

    def serving() -> subprocess.Popen[bytes]:
        with (tmp_path / "log").open("ab") as log:
            return subprocess.Popen(
                command, cwd=ROOT, stdout=log, stderr=log, env={**os.environ, "PYTHONPATH": str(ROOT)}
            )

    address = f"http://127.0.0.1:{port}"
    process = serving()
    try:
        answers(address)
        open_problem(page, address, small)
        start(page)
        expect(page.locator("#state")).to_have_text("Planning")
        expect(page.locator("#progress-text")).to_contain_text("motion")
        again = page.get_by_role("button", name="Try again")
        expect(again).to_be_hidden()
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("#outcome-title")).to_have_text("Cancelled")
        again.click()
        expect(page.locator("#state")).to_have_text("Planning")
        expect(page.locator("#progress-text")).to_contain_text("motion")
        expect(page.locator("#outcome")).to_be_hidden()
        process.kill()
        process.wait()
        expect(page.get_by_role("alert")).to_contain_text("connection to the service is lost")
        process = serving()
        expect(page.get_by_role("alert")).to_be_hidden(timeout=60_000)
        expect(page.locator("#facts")).to_contain_text("attempt 2", timeout=60_000)
        (data / "go").touch()
        expect(page.locator("#state")).to_have_text("Verified", timeout=60_000)
    finally:
        process.kill()
        process.wait()
        shutil.rmtree(data, ignore_errors=True)


@pytest.mark.long
def test_a_token_is_asked_for_once_and_refused_at_its_field(page: Page, tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    token = Auth(Database(default_url(data))).create_token("ann")
    process = Process(data, "--require-token").wait()
    try:
        page.goto(f"{process.url}/ui/new?process=forming")
        expect(page).to_have_url(re.compile(r"/ui/login\?next="))
        page.get_by_label("Token").fill(token[:-1] + "!")
        page.get_by_role("button", name="Log in").click()
        expect(page.locator(".fault.error")).to_contain_text("unknown or revoked")
        page.get_by_label("Token").fill(token)
        page.keyboard.press("Enter")
        page.wait_for_url("**/ui/new?process=forming")
        wait_until_read(page)
        assert token not in str(page.context.storage_state()["origins"])
        page.get_by_role("button", name="Log out").click()
        page.wait_for_url("**/ui/login")
        page.goto(process.url)
        expect(page).to_have_url(re.compile(r"/ui/login\?next="))
    finally:
        process.stop()


def test_a_token_given_before_the_script_is_there_is_not_sent(page: Page, server: str) -> None:
    """A form without its script requests `/ui/login?` again: the token and the requested page are lost."""
    held: list[Route] = []
    page.route("**/static/login.js", lambda route: held.append(route))
    page.goto(f"{server}/ui/login?next=/ui/drafts", wait_until="commit")
    page.get_by_label("Token").fill("ann")
    page.keyboard.press("Enter")
    send = page.get_by_role("button", name="Log in")
    expect(send).to_be_disabled()
    held[0].continue_()
    expect(send).to_be_enabled()
    expect(page.get_by_label("Token")).to_have_value("ann")
    expect(page).to_have_url(re.compile("next="))


def test_every_field_of_the_schema_has_a_part_of_the_form(page: Page, server: str) -> None:
    """Each definition, each of its fields, and each choice of a field is drawn with a value in it; all that
    can be filled in has a label."""
    open_bundled(page, server, "engrave")
    drawn, nameless = page.evaluate(
        """async () => {
          const { Form } = await import("/ui/static/form.js");
          const { Schema } = await import("/ui/static/schema.js");
          const schema = new Schema(await (await fetch("/v1/schema")).json());
          const host = document.body.appendChild(document.createElement("div"));
          let drawn = 0;
          const nameless = [];
          const draw = (given, name, value) => {
            const state = { problem: { x: { [name]: value } }, origin: null, files: new Map() };
            const form = new Form(schema, state, () => {}, () => undefined);
            host.replaceChildren(form.field(given, ["x", name], false));
            drawn += 1;
            for (const one of host.querySelectorAll("input, select, textarea"))
              if (!one.labels.length && !one.ariaLabel && one.ariaHidden !== "true")
                nameless.push(`${name}: ${one.id}`);
          };
          const filled = (given) => {
            const { schema: one, choices } = schema.read(given);
            const kinds = schema.mapOf(one);
            if (kinds) return [{ [kinds.key.enum?.[0] ?? "a"]: filled(kinds.value)[0] }];
            if (choices) return choices.map((choice) => filled(choice)[0]);
            if (one.type === "array" && one.items) return [[filled(one.items)[0]]];
            return [schema.blank({ ...one, default: undefined })];
          };
          for (const given of Object.values(schema.defs))
            for (const [name, field] of Object.entries(given.properties ?? {})) {
              draw(field, name, undefined);
              for (const value of filled(field)) draw(field, name, value);
            }
          host.remove();
          return [drawn, nameless];
        }"""
    )
    assert drawn > 600
    assert nameless == []


def test_fields_that_users_name_are_parts_of_the_form(page: Page, server: str) -> None:
    """Work offsets of G-code: added, filled, refused at the field, removed."""
    open_bundled(page, server, "gcode")
    offsets = page.locator('[data-path="operations.0.cuts.0.gcode.offsets"]')
    page.evaluate("import('/ui/static/issues.js').then(i => i.goTo('operations.0.cuts.0.gcode.offsets'))")
    offsets.locator("select").select_option("G58")
    offsets.get_by_role("button", name="Add").click()
    place = offsets.locator('[data-path="operations.0.cuts.0.gcode.offsets.G58"]')
    place.get_by_label("offsets x").fill("1e6")
    place.get_by_label("offsets y").fill("0")
    place.get_by_label("offsets z").fill("-5")
    expect(place.locator(".fault.error").first).to_contain_text("100000")
    place.get_by_label("offsets x").fill("10")
    expect(place.locator(".fault")).to_have_count(0)
    place.get_by_role("button", name="Remove G58").click()
    expect(place).to_have_count(0)


def test_changes_are_not_lost_without_a_word(page: Page, server: str) -> None:
    open_bundled(page, server, "engrave")
    page.locator("#f-name").fill("mine")
    page.locator("#example").focus()
    page.locator("#example").select_option("flank_wall")
    dialog = page.get_by_role("dialog", name="Drop your changes?")
    expect(dialog).to_contain_text(re.compile("1 changed field (would be lost|stays in the draft)"))
    expect(dialog.get_by_role("button", name="Keep them")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#example")).to_have_value("engrave")
    expect(page.locator("#f-name")).to_have_value("mine")
    page.locator("input[name=process]:checked").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")  # keeps them
    expect(page.locator("input[name=process]:checked")).to_have_value("milling")
    expect(page.locator("input[name=process]:checked")).to_be_focused()
    expect(page.locator("#f-name")).to_have_value("mine")
    page.locator("#cell").select_option("kr60_mill")
    expect(dialog).to_have_count(0)  # no field of the cell was changed
    page.locator("#example").select_option("flank_wall")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("#source")).to_have_text("from the bundled problem flank_wall")
    page.locator("#example").select_option("engrave")
    expect(page.locator("#source")).to_have_text("from the bundled problem engrave")
