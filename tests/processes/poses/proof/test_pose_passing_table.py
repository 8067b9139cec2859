"""The proof's own reader of pose tables, against scipy's rotations and the planner's reader.

It catches a planner that misreads the table, leaves a range or moves too fast.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from planner import pipeline
from planner.catalogue import robots
from planner.processes import registry
from planner.processes.poses.plan import job
from planner.processes.poses.proof import pose_passing

ROWS = 12
NAMES = ["robot." + key for key in (*pose_passing.POSITION_COLUMNS, *pose_passing.QUATERNION_COLUMNS)]


def table(path: Path, values: np.ndarray, feed: list[str] | None = None) -> Path:
    """A file of poses, rows (N, 7) in mm and quaternions, of either kind."""
    feeds = feed or [""] * len(values)
    if path.suffix == ".json":
        rows = [dict(zip(NAMES, row.tolist(), strict=True)) for row in values]
        rows = [row | ({"feed_mm_s": float(f)} if f else {}) for row, f in zip(rows, feeds, strict=True)]
        path.write_text(json.dumps(rows))
    else:
        lines = [", ".join(["feed_mm_s", *NAMES])]
        lines += [",".join([f, *map(repr, row.tolist())]) for row, f in zip(values, feeds, strict=True)]
        path.write_text("\n".join(["", *lines[:3], " ", *lines[3:]]) + "\n", "utf-8-sig")
    return path


@pytest.mark.parametrize("name", ["t.csv", "t.json"])
def test_poses_and_feeds_in_si_units(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(3)
    quaternion = rng.normal(size=(ROWS, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    place = rng.uniform(-500.0, 500.0, (ROWS, 3))
    feeds = ["", *map(str, range(10, 10 + ROWS - 1))]
    path = table(tmp_path / name, np.concatenate([place, quaternion], axis=1), feeds)
    read = pose_passing.read_pose_table(path, ("robot",))
    expected = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(read.poses["robot"][:, :3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(read.poses["robot"][:, :3, 3], place * 1e-3, atol=1e-15)
    assert np.isnan(read.feed[0])
    np.testing.assert_allclose(read.feed[1:], np.arange(10, 10 + ROWS - 1) * 1e-3)


def lanes(folder: Path, **changes: object) -> Path:
    """Return the first lane of the bundled table as a problem, with changed fields of its operation."""
    source = robots.data_dir("problems") / "gauge_lanes"
    data = yaml.safe_load((source / "problem.yaml").read_text())
    data["cell"] = str(source.parent / "cells" / "irb140_gauge.yaml")
    data["operations"][0] |= changes
    (folder / "targets.csv").write_text("\n".join((source / "targets.csv").read_text().splitlines()[:ROWS]))
    (folder / "problem.yaml").write_text(yaml.safe_dump(data))
    return folder / "problem.yaml"


SPIN = {"name": "spin", "arms": ["robot"], "axis": "z", "turn_deg": [-180, 180]}
TILT = {"name": "lean", "arms": ["robot"], "axis": "x", "turn_deg": [-4, 3]}
LIFT = {"name": "lift", "arms": ["robot"], "axis": "z", "slide_mm": [-3, 1]}


@pytest.mark.parametrize("free", [(), (SPIN,), (TILT, SPIN), (LIFT, SPIN, TILT)])
def test_what_is_free_is_proven_within_its_ranges(
    tmp_path: Path, free: tuple[dict[str, object], ...]
) -> None:
    outcome = pipeline.plan(pipeline.load(lanes(tmp_path, free=list(free))))
    assert outcome.verified, outcome.proof.issues


def row_of(x: float) -> str:
    return f"{x:.4f},0,90,0,1,0,0,cut/a"


def written(folder: Path, xs: list[float], **changes: object) -> Path:
    """A problem whose table goes along x, heads down."""
    path = lanes(folder, **changes)
    head = (folder / "targets.csv").read_text().splitlines()[0]
    (folder / "targets.csv").write_text("\n".join([head, *map(row_of, xs)]))
    return path


def test_a_slide_along_the_way_is_within_its_range(tmp_path: Path) -> None:
    """Along a free slide every target meets every pose; only its own is within the range."""
    xs = [float(x) for x in range(-100, 101, 10)]
    slide = {"name": "s", "arms": ["robot"], "axis": "x", "slide_mm": [-30, 30]}
    outcome = pipeline.plan(pipeline.load(written(tmp_path, xs, free=[slide])))
    assert outcome.verified, outcome.proof.issues


@pytest.mark.parametrize("tolerance", [0.01, 8])
def test_short_moves_are_at_their_feed(tmp_path: Path, tolerance: float) -> None:
    """Steps of 1 and 7 mm in turn. 1 mm takes 25 ms, no whole number of the samples of 4 ms; within 8 mm the
    targets of neighbours meet a pose too, and are not its own."""
    xs = [-100.0 + 8.0 * (k // 2) + (k % 2) for k in range(40)]
    changes = {"position_tol_mm": tolerance, "free": [SPIN]}
    outcome = pipeline.plan(pipeline.load(written(tmp_path, xs, **changes)))
    assert outcome.verified, outcome.proof.issues


def spoiled(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Puts a fault into the planner's reader of tables."""
    if name == "shifted by 3 mm":
        old = job._parse_poses

        def shifted(*args):  # type: ignore[no-untyped-def]
            out = old(*args)
            out[:, 0, 3] += 3e-3
            return out

        monkeypatch.setattr(job, "_parse_poses", shifted)
    elif name == "ten times the feed":
        monkeypatch.setattr(job.PosedJob, "targets", _changed(lambda t: {"feed": 10.0 * t.feed}))
    elif name == "a range without an end":
        wide = {"lower": -0.3, "upper": 0.3}

        def opened(targets):  # type: ignore[no-untyped-def]
            count = np.ones(targets.count)
            (own,) = targets.freedoms
            bounds = {key: value * count for key, value in wide.items()}
            return {"freedoms": (dataclasses.replace(own, prefer=0.25 * count, weight=1e3, **bounds),)}

        monkeypatch.setattr(job.PosedJob, "targets", _changed(opened))
    elif name == "a row left out":

        def without(targets):  # type: ignore[no-untyped-def]
            return {"pose": {"robot": np.repeat(targets.pose["robot"][::2], 2, axis=0)[: targets.count]}}

        monkeypatch.setattr(job.PosedJob, "targets", _changed(without))


def _changed(change):  # type: ignore[no-untyped-def]
    old = job.PosedJob.targets

    def targets(self):  # type: ignore[no-untyped-def]
        made = old(self)
        return dataclasses.replace(made, **change(made))

    return targets


@pytest.mark.parametrize(
    ("fault", "free", "message"),
    [
        ("shifted by 3 mm", [SPIN], "of robot is missed by 3.000"),
        ("ten times the feed", [SPIN], "the tool moves at"),
        ("a range without an end", [TILT], "the free rotation about x is 1"),
        ("a row left out", [SPIN], "of robot is missed by"),
    ],
)
def test_faults_of_the_planner_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str, free: list[dict[str, object]], message: str
) -> None:
    problem = pipeline.load(lanes(tmp_path, free=free, feed_mm_s=20))
    spoiled(fault, monkeypatch)
    outcome = pipeline.plan(problem)
    assert not outcome.verified
    found = [issue for issue in outcome.proof.issues if issue.code == "verify.follows"]
    assert any(message in issue.message for issue in found), [issue.message for issue in outcome.proof.issues]


def test_a_table_that_is_gone_is_told(tmp_path: Path) -> None:
    problem = pipeline.load(lanes(tmp_path))
    outcome = pipeline.plan(problem)
    (tmp_path / "targets.csv").unlink()
    (issue,) = pipeline.verify(problem, dict(outcome.programs)).issues
    assert "targets.csv: the proof cannot read the poses" in issue.message


def test_both_readers_agree_on_the_bundled_table() -> None:
    problem = pipeline.load("gauge_lanes")
    mine = pose_passing.read_pose_table(problem.operations[0].file, ("robot",))  # type: ignore[attr-defined]
    np.testing.assert_allclose(
        mine.poses["robot"], registry.job(problem, 0).targets().pose["robot"], atol=1e-12
    )
