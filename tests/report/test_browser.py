"""Report and replay in a real browser without a network: they show something, and request nothing."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planner.plans import Plan
from planner.report import output
from tests.report import synthetic_job as job

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--enable-logging=stderr",
)

pytestmark = pytest.mark.skipif(
    BROWSER is None and "CI" not in os.environ, reason="no Chromium or Chrome on this machine"
)


@pytest.fixture(scope="module")
def files() -> dict[str, str]:
    return output.files(job.problem(), job.plan(), job.proof())


def take_screenshot(html: str, folder: Path, *more: str, at: str = "") -> tuple[np.ndarray, str]:
    """Return a screenshot (H, W, 3) of a page at a fragment of its address, and the browser's log."""
    page, shot = folder / "page.html", folder / "shot.png"
    page.write_text(html, encoding="utf-8")
    command = [
        str(BROWSER),
        *FLAGS,
        f"--user-data-dir={folder / 'profile'}",
        "--window-size=1200,800",
        f"--screenshot={shot}",
        *more,
        page.as_uri() + at,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert shot.exists(), done.stderr[-2000:]
    return np.asarray(Image.open(shot).convert("RGB")), done.stderr


def console_errors(log: str) -> list[str]:
    return [line for line in log.splitlines() if re.search(r"CONSOLE.*(Error|Failed|net::)", line)]


def test_the_report_shows(files: dict[str, str], tmp_path: Path) -> None:
    shot, log = take_screenshot(files["report.html"], tmp_path)
    assert not console_errors(log)
    assert len(np.unique(shot.reshape(-1, 3), axis=0)) > 200
    assert "http" not in re.sub(r"http://www\.w3\.org/\S+", "", files["report.html"])


@pytest.mark.long
def test_the_replay_draws_orange_robots(files: dict[str, str], tmp_path: Path) -> None:
    shot, log = take_screenshot(files["replay.html"], tmp_path, "--timeout=15000")
    assert not console_errors(log)
    red, green, blue = (shot[..., i].astype(int) for i in range(3))
    orange = (red > 150) & (red - blue > 90) & (green - blue > 10)
    above_the_bar = orange[: int(0.8 * len(orange))]
    assert above_the_bar.mean() > 0.005


def test_a_notebook_shows_the_replay_in_its_cell(tmp_path: Path) -> None:
    """By a server that is gone, as one that was saved has it."""
    viewer = output.show(job.problem(), job.plan(), job.proof())
    cell = f"<!doctype html><html><body>{viewer._repr_html_()}</body></html>"
    assert viewer.url not in cell
    del viewer
    shot, log = take_screenshot(cell, tmp_path, "--timeout=15000")
    assert not console_errors(log)
    red, green, blue = (shot[:450, :, i].astype(int) for i in range(3))
    assert ((red > 150) & (red - blue > 90) & (green - blue > 10)).mean() > 0.005


def add_released_sheet(plan: Plan) -> Plan:
    """The plan with a sheet that is too deep everywhere, wide over the block."""
    x = np.linspace(-0.3, 0.3, 12)
    flat = np.zeros((12, 12))
    sheet = {
        "kind": "released",
        "title": "too deep",
        "x": x,
        "y": x,
        "formed": flat + 0.38,
        "released": flat + 0.40,
        "deviation": flat - 2.0,
        "limit": 2.0,
        "unit": "mm",
    }
    (own,) = plan.operations
    targets = dataclasses.replace(own.targets, exhibits={"released": sheet})
    return dataclasses.replace(plan, operations=(dataclasses.replace(own, targets=targets),))


@pytest.mark.long
def test_the_replay_draws_a_released_sheet_in_the_colour_of_its_key(tmp_path: Path) -> None:
    plan = job.plan()
    shares = []
    for name, item in (("none", plan), ("sheet", add_released_sheet(plan))):
        html = output.files(job.problem(), item, None)["replay.html"]
        (tmp_path / name).mkdir()
        # Standing at its start: the tools are blue as well, and how much of it shows turns with them.
        shot, log = take_screenshot(html, tmp_path / name, "--timeout=15000", at="#t=0")
        assert not console_errors(log)
        red, green, blue = (shot[..., i].astype(int) for i in range(3))
        shares.append(((blue > 1.6 * green) & (blue > 2.5 * red) & (blue > 90)).mean())
        assert ("after release" in html) is (name == "sheet")
    assert shares[1] > 2.0 * shares[0] + 0.002
