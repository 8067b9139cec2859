"""An element that is divided again, and a resumed batch of its problems: unchanged files stay as they are."""

from __future__ import annotations

import contextlib
import csv
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner.batch import run as batch
from planner.batch.workers import BatchWorkers
from planner.cli.batch import Batch, run_batch
from planner.cli.element import ElementRequest, run_element
from planner.element import unchanged
from planner.geometry.mesh import TriangleMesh
from tests.batch.jobs import FAULTY, content
from tests.element import test_walls
from tests.element.shells import cap, shell
from tests.element.test_saw_jobs import read_data, saw_jobs
from tests.element.walls import ROOT, element, wall, write_obj

Make = Callable[[Path, float], Path]
"""Writes an element file in a folder, its surface moved by up to so much [m] at random."""


def move_mesh(mesh: TriangleMesh, by: float) -> TriangleMesh:
    noise = np.random.default_rng(1).uniform(-by, by, mesh.vertices.shape)
    return TriangleMesh(mesh.vertices + noise, mesh.faces)


def write_ruled_element(folder: Path, by: float) -> Path:
    path = test_walls.wall(folder)
    data = yaml.safe_load(path.read_text())
    data["surface"]["ruled"]["start"]["bspline_mm"][1][2] += 1e3 * by
    path.write_text(yaml.safe_dump(data))
    return path


KINDS: dict[str, Make] = {
    "elastic": lambda folder, by: element(folder, move_mesh(wall(1.2, 0.9, 0.02), by)),
    "hexagons": lambda folder, by: shell(folder, move_mesh(cap(), by), {"count": 30}),
    "boxes": write_ruled_element,
}


def stand(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Return the files and their content. A rewritten file has another inode number."""
    return {name: ((folder / name).stat().st_ino, text) for name, text in content(folder).items()}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize("kind", KINDS)
def test_a_folder_of_this_element_stays_as_it_is_where_the_surface_moves_by_nothing(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    issues = run_element(ElementRequest(KINDS[kind](tmp_path, 0.0), out))
    before = stand(out)
    capsys.readouterr()
    again = run_element(ElementRequest(KINDS[kind](tmp_path, 1e-9), out, resume=True))
    assert stand(out) == before
    assert "unchanged" in capsys.readouterr().out
    assert [issue.message for issue in again] == [issue.message for issue in issues]
    run_element(ElementRequest(KINDS[kind](tmp_path, 1e-6), out, resume=True))
    assert not {name for name, item in stand(out).items() if item == before.get(name)}


def other_template(path: Path, out: Path) -> None:
    template = path.parent / "held.yaml"
    template.write_text(template.read_text().replace("feed_mm_s: 6", "feed_mm_s: 5"))


def no_problem(path: Path, out: Path) -> None:
    next((out / "panels").glob("*.yaml")).unlink()


def edit_result(path: Path, out: Path) -> None:
    problem = next((out / "panels").glob("*.yaml"))
    problem.write_text(problem.read_text() + "# mine\n")


def kill_run(path: Path, out: Path) -> None:
    (out / "element.json").unlink()  # which comes last


def broken(path: Path, out: Path) -> None:
    (out / unchanged.MADE_FROM_FILE).write_bytes(b"PK")


@pytest.mark.sampled(every=5)
@pytest.mark.parametrize("change", [other_template, no_problem, edit_result, kill_run, broken])
def test_a_folder_that_is_not_whole_or_of_another_file_is_written_anew(change: Any, tmp_path: Path) -> None:
    path, out = shell(tmp_path, hexagons={"count": 30}), tmp_path / "out"
    run_element(ElementRequest(path, out))
    first = content(out)
    change(path, out)
    run_element(ElementRequest(path, out, resume=True))
    assert (content(out) == first) == (change is not other_template)


def planned_panels(out: Path, run: Path) -> set[str]:
    """What a batch plans of an element when it goes on; nothing is planned in truth."""
    items = batch.collect_items([out / "panels"], run)
    with batch.claimed_folder(run), BatchWorkers(1, module=FAULTY) as workers:
        rows = batch.run_batch(items, run, workers, batch.BatchSettings(resume=True), lambda _: None)
    assert {row.done.state for row in rows} == {"verified"}
    return {row.item.name for row in rows if not row.is_kept}


def test_a_surface_that_changes_within_one_panel_plans_one_panel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = wall(1.2, 0.9, 0.02)
    plane = {"normal": [0, 0, 1], "along": [1, 0, 0]}
    surface = {"mesh": {"file": "wall.obj", "unit": "mm"}, "plane": plane}
    path, out, run = element(tmp_path, mesh, surface=surface), tmp_path / "out", tmp_path / "run"
    run_element(ElementRequest(path, out))
    names = {row["id"] for row in csv.DictReader((out / "panels.csv").open())}
    assert planned_panels(out, run) == names
    assert not planned_panels(out, run)
    first = read_data(out)["panels"][0]
    low = np.array([first["from_x_mm"], first["from_y_mm"]])
    size = np.array([first["to_x_mm"], first["to_y_mm"]]) - low
    inside = np.linalg.norm((1e3 * mesh.vertices[:, :2] - low) / size - 0.5, axis=1) < 0.2
    bump = np.where(inside[:, None], [0.0, 0.0, 2e-4], 0.0)
    write_obj(tmp_path / "wall.obj", TriangleMesh(mesh.vertices + bump, mesh.faces))
    capsys.readouterr()
    run_element(ElementRequest(path, out, resume=True))
    assert f"{len(names) - 1} of {len(names)} problems are unchanged" in capsys.readouterr().out
    assert planned_panels(out, run) == {first["id"]}


@pytest.mark.long
def test_a_template_for_one_panel_more_plans_one_panel(tmp_path: Path) -> None:
    def path(border: float) -> Path:
        ranges = [("held.yaml", [0, border]), ("long.yaml", [border, 5000])]
        jobs = [{"problem": name, "when": {"longest_mm": own}} for name, own in ranges]
        file = shell(tmp_path, hexagons={"count": 30}, jobs=jobs)
        slower = (tmp_path / "held.yaml").read_text().replace("feed_mm_s: 6", "feed_mm_s: 5")
        (tmp_path / "long.yaml").write_text(slower)
        return file

    out, run = tmp_path / "out", tmp_path / "run"
    run_element(ElementRequest(path(4000.0), out))
    planned_panels(out, run)
    rows = list(csv.DictReader((out / "panels.csv").open()))
    long = sorted((max(float(row["block_x_mm"]), float(row["block_y_mm"])), row["id"]) for row in rows)
    run_element(ElementRequest(path(0.5 * (long[-1][0] + long[-2][0])), out, resume=True))
    assert planned_panels(out, run) == {long[-1][1]}


@pytest.mark.long
@pytest.mark.parametrize("count", [2, pytest.param(6, marks=pytest.mark.long)])
def test_a_batch_of_an_element_that_is_killed_goes_on_to_the_same_bytes(count: int, tmp_path: Path) -> None:
    saw = yaml.safe_load((ROOT / "problems" / "ruled_wall_108" / "saw_job.yaml").read_text())
    saw["cell"] = str(ROOT / "problems" / "cells" / "irb4600_bow.yaml")
    (tmp_path / "saw.yaml").write_text(yaml.safe_dump(saw))
    out = tmp_path / "out"
    run_element(ElementRequest(test_walls.wall(tmp_path, cut_blocks={"problem": "saw.yaml"}), out))
    jobs = [job for _, job in saw_jobs(read_data(out)) if "flat" in job["said"]]
    jobs.sort(key=lambda job: max(job["size_mm"]))
    files = tuple(out / "blocks" / f"{job['id']}.yaml" for job in jobs[:count])
    names = [file.stem for file in files]
    assert len(files) == count

    def batch_request(run: str, resume: bool = False) -> Batch:
        return Batch(files, tmp_path / run, workers=1, resume=resume, reports="failed")

    assert run_batch(batch_request("whole")) == 0
    one = tmp_path / "killed"
    words = [sys.executable, "-m", "planner", "batch", *files, "-o", one, "--workers", "1"]
    going = subprocess.Popen([*words, "--reports", "failed"], stdout=subprocess.DEVNULL)
    while not (one / names[0]).exists() and going.poll() is None:
        time.sleep(0.01)
    os.kill(going.pid, signal.SIGKILL)  # the next job is under way
    assert going.wait() == -signal.SIGKILL
    done = {name: (one / name).stat().st_ino for name in names if (one / name).exists()}
    assert 0 < len(done) < count
    assert run_batch(batch_request("killed", resume=True)) == 0
    assert {name: (one / name).stat().st_ino for name in done} == done
    for name in names:
        assert content(one / name) == content(tmp_path / "whole" / name)


def run_whole_and_killed(words: list[Any], again: list[Any], seed: int, kills: int) -> None:
    """Run a command once whole, and once with kills at random instants of its usual duration, to its end.

    The first killed command is ``words``, later ones are ``again``.
    """
    rng = random.Random(seed)
    start = time.monotonic()
    assert subprocess.run([*words, "-o", "whole"], stdout=subprocess.DEVNULL, check=False).returncode == 0
    usual = time.monotonic() - start
    for n in range(kills):
        going = subprocess.Popen([*(again if n else words), "-o", "killed"], stdout=subprocess.DEVNULL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            going.wait(rng.uniform(0.1, 1.0) * usual)
        going.kill()
        going.wait()
    assert subprocess.run([*again, "-o", "killed"], stdout=subprocess.DEVNULL, check=False).returncode == 0


@pytest.mark.long
def test_a_dome_that_is_killed_goes_on_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shell(tmp_path, hexagons={"count": 24, "off_surface_mm": 60})
    monkeypatch.chdir(tmp_path)
    words = [sys.executable, "-m", "planner", "element", path]
    run_whole_and_killed(words, [*words, "--resume"], 5, 6)
    assert content(tmp_path / "killed") == content(tmp_path / "whole")
    left = {item.name for item in tmp_path.iterdir()}
    assert left == {"shell.obj", "held.yaml", "element.yaml", "whole", "killed"}


@pytest.mark.long
def test_a_batch_of_a_dome_like_neighbours_that_is_killed_goes_on_to_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_element(ElementRequest(ROOT / "problems" / "dome_267" / "element.yaml", tmp_path / "dome"))
    monkeypatch.chdir(tmp_path)
    files = [tmp_path / "dome" / "panels" / f"{name}.yaml" for name in ("A05", "A06", "A07", "B05", "D10")]
    words = [sys.executable, "-m", "planner", "batch", *files, "--workers", "1", "--like", "neighbour"]
    run_whole_and_killed(words, [*words, "--resume"], 3, 3)
    for file in files:
        assert content(tmp_path / "killed" / file.stem) == content(tmp_path / "whole" / file.stem)
