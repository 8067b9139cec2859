"""Frames of the cell in 3D: what the page draws of each bundled problem's cell, in a headless browser.

Software rendering, 600 x 430 pixels, as on the page. The view turns a little with each frame, and a pixel is
read back, so that drawing is complete. Wall time: run it on an idle machine. The note has the processor time
of the whole browser for a frame, which other work on the machine changes little.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

import planner
from bench.proc import child_processes, processor_time
from planner.catalogue import robots
from planner.report import view3d
from planner.service import app, cell_drawing

GOAL_S = 0.03
"""Target time [s] of a frame."""
SIZE = (600, 430)
FRAMES = 40
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_SCRIPT = """
const data = JSON.parse(document.getElementById("data").textContent);
const canvas = document.querySelector("canvas");
const nothing = () => null;
const hooks = { meant: nothing, picked: nothing, moved: nothing, dropped: nothing };
const view = new CellView(canvas, document.querySelector("div"), hooks);
view.show(data, false);
globalThis.frames_ms = (count) => {
  const out = [];
  for (let i = 0; i < count; i++) {
    view.turn += 0.02;
    const begin = performance.now();
    view.paint();
    view.gl.readPixels(0, 0, 1, 1, view.gl.RGBA, view.gl.UNSIGNED_BYTE, new Uint8Array(4));
    out.push(performance.now() - begin);
  }
  return out;
};
"""


def run() -> list[dict[str, Any]]:
    """Rows of median and spread [s] of a frame by problem."""
    from playwright.sync_api import sync_playwright

    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        return []
    folder = robots.data_dir("problems")
    rows = []
    with sync_playwright() as driver:
        shown = driver.chromium.launch(executable_path=browser, args=FLAGS)
        for name in sorted(path.parent.name for path in folder.glob("*/problem.yaml")):
            data, _ = cell_drawing.view(planner.load(name))
            tab = shown.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            tab.set_content(page(data))
            tab.evaluate("frames_ms(5)")
            before = _spent_s()
            times = np.array(tab.evaluate(f"frames_ms({FRAMES})")) / 1000.0
            spent = (_spent_s() - before) / FRAMES
            cost = f"{1000.0 * spent:.0f} ms of processor time; wanted {GOAL_S:g} s"
            triangles = sum(len(body["faces"]) // 3 for body in data["bodies"])
            tab.close()
            rows.append(
                {
                    "name": f"a frame, {name}",
                    "median_s": float(np.median(times)),
                    "spread": float(np.ptp(np.percentile(times, [10, 90]))),
                    "ratio": None,
                    "note": f"{triangles:,} triangles, {cost}",
                }
            )
        shown.close()
    return rows


def _spent_s() -> float:
    """Return the processor time [s] so far of the child processes."""
    spent = 0.0
    for pid in child_processes(os.getpid()):
        with contextlib.suppress(OSError):  # it has ended
            spent += processor_time(pid)
    return spent


def page(data: dict[str, Any]) -> str:
    """A page that shows nothing but the cell, by the page's own scripts."""
    own = "\n".join(_text(app.STATIC / name) for name in ("dom.js", "cell_view.js")) + _SCRIPT
    packed = json.dumps(data).replace("<", "\\u003c")
    return (
        f"<!doctype html><style>{_text(view3d.FOLDER / 'theme.css')} body {{ margin: 0 }} "
        "canvas { width: 600px; height: 430px }</style><div></div><canvas></canvas>"
        f"<script type='application/json' id='data'>{packed}</script><script>{view3d.three_js()}</script>"
        f"<script>{view3d.bundle_script(own, view3d.THREE_MODULES)}</script>"
    )


def _text(path: Path) -> str:
    return path.read_text("utf-8")
