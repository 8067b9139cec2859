"""The benchmarks against other tools: input of Tesseract, messages where it cannot be loaded, the page."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from bench import peers, tesseract_bench
from planner.catalogue import robots
from planner.cell import clearance


def test_tesseract_is_told_the_same_cell(tmp_path: Path) -> None:
    model = tesseract_bench.write_job(tmp_path, 12)
    told = ET.parse(tmp_path / "cell.urdf").getroot()
    drakes = robots.urdf_path("irb140").read_text(encoding="utf-8")
    capsule = f"{{{tesseract_bench.NAMESPACE}}}capsule"
    assert len(told.findall(f".//collision/geometry/{capsule}")) == drakes.count("<drake:capsule")
    solids = [solid.body for solid in model.solids]
    assert len(told.findall(".//collision")) == len(solids)
    pairs = ET.parse(tmp_path / "cell.srdf").getroot().findall("disable_collisions")
    apart = {frozenset(body.rpartition("/")[2] for body in pair[:2]) for pair in model.filtered_pairs}
    assert {frozenset((pair.attrib["link1"], pair.attrib["link2"])) for pair in pairs} == apart
    job = json.loads((tmp_path / "job.json").read_text())
    low, high = job["spin"]
    assert len(job["poses"]) == 12
    assert round((high - low) / job["resolution"]) + 1 == 36


def test_where_tesseract_cannot_be_loaded_the_row_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = tmp_path / "python"
    fake.write_text('#!/bin/sh\necho "libstdc++.so.6: version \\`GLIBCXX_3.4.32\' not found"\nexit 1\n')
    fake.chmod(fake.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv(tesseract_bench.PYTHON, str(fake))
    reason = tesseract_bench.reason()
    assert reason == "libstdc++.so.6: version `GLIBCXX_3.4.32' not found"
    monkeypatch.setenv(tesseract_bench.PYTHON, str(tmp_path / "none"))
    assert "none" in str(tesseract_bench.reason())


def test_a_skipped_peer_stands_in_the_table_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tesseract_bench, "RUNS", 1)
    monkeypatch.setattr(tesseract_bench, "COUNTS", (40,))
    monkeypatch.setattr(tesseract_bench, "reason", lambda: "the C library is too old")
    (row,) = peers.tesseract()
    assert row.theirs is None
    assert row.ratio is None
    assert row.ours is not None
    assert row.ours > 0.0
    table = peers.markdown([row], "a machine")
    assert "skipped: the C library is too old" in table
    assert "a machine" in table


def test_least_distance_by_coal_is_the_clearance() -> None:
    pytest.importorskip("coal")
    cell, _ = tesseract_bench.s_curve(12)
    place = tesseract_bench.STOCK_POSE
    model = tesseract_bench.plant.build_cell_model(
        cell, tesseract_bench.block(tesseract_bench.SIZE, place), place
    )
    q = cell.arms[0].home + np.random.default_rng(4).uniform(-0.3, 0.3, (6, 6))
    ours = clearance.min_clearance(model, {"arm": q}, 1.0).distance.min()
    assert tesseract_bench.least_by_coal(model, q) == pytest.approx(ours, abs=1e-6)


def test_the_page_keeps_its_words_around_the_table() -> None:
    page = peers.PAGE.read_text(encoding="utf-8")
    written = peers.with_table(page, "| a table |")
    assert written.startswith(page.partition(peers.START_MARK)[0])
    assert "| a table |" in written
    assert peers.with_table(written, "| a table |") == written
    with pytest.raises(ValueError, match="no marks"):
        peers.with_table("a page", "| a table |")
