"""Minimum feeds of given poses: programs that keep them are proven, slowed programs are not.

If the planner cannot keep a minimum feed, it refuses the job with the cause and the place.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from planner import pipeline
from planner.issues import Severity, TandemError
from planner.motion.trajectory import move_limits as planned
from planner.processes import registry
from planner.processes.poses.proof import pose_passing as proven
from planner.proof.prove import Prover
from planner.targets import Targets
from tests.processes.hotwire.proof import bead_job

Texts = dict[str, str]
Mutator = Callable[[np.random.Generator, Texts], Texts]
T = re.compile(r"\\T:=([\d.]+)")
MOVE = {"abb": "    MoveL ", "two": "    MoveL ", "kuka": "SLIN "}
X_COORDINATE = {
    "abb": re.compile(r"\[\[([-\d.]+),"),
    "two": re.compile(r"\[\[([-\d.]+),"),
    "kuka": re.compile(r"X ([-\d.]+),"),
}


def files(texts: Texts) -> list[str]:
    return [name for name in texts if "Cut" in name or name.endswith("_1.src")]


def lanes(rows: list[str], job: str) -> list[list[int]]:
    """Rows of the moves with a least feed, stretch by stretch: there, back to the stop, on from it."""
    part, out = "", {"there": [], "back": []}  # type: ignore[var-annotated]
    for i, row in enumerate(rows):
        found = re.search(r"Segment (?:cut|link)/(\w+)", row)
        part = found[1] if found else part
        if row.startswith(MOVE[job]) and part in out:
            out[part].append(i)
    cut = bead_job.STOP + 1
    return [out["there"], out["back"][1:cut], out["back"][cut:]]


def slowed(job: str, texts: Texts, stretch: int, moves: list[int], factor: float) -> Texts:
    """The texts with moves of a stretch slower by a factor, in all tasks."""
    out = dict(texts)
    for name in files(texts):
        rows = texts[name].split("\r\n" if "\r\n" in texts[name] else "\n")
        for k in sorted(moves, reverse=True):
            i = lanes(rows, job)[stretch][k]
            if job == "kuka":
                before = [row for row in rows[:i] if row.startswith("$VEL.CP=")][-1]
                rows[i : i + 1] = [f"$VEL.CP={float(before[8:]) / factor:.8f}", rows[i], before]
            else:
                rows[i] = T.sub(lambda found: f"\\T:={float(found[1]) * factor:.5f}", rows[i])
        out[name] = ("\r\n" if "\r\n" in texts[name] else "\n").join(rows)
    return out


def changed(job: str, texts: Texts, stretch: int, move: int, new: Callable[[str, str], list[str]]) -> Texts:
    """The texts with one move replaced by ``new``, a function of its row and of that before it."""
    out = dict(texts)
    for name in files(texts):
        end = "\r\n" if "\r\n" in texts[name] else "\n"
        rows = texts[name].split(end)
        own = lanes(rows, job)[stretch]
        rows[own[move] : own[move] + 1] = new(rows[own[move]], rows[own[move - 1]])
        out[name] = end.join(rows)
    return out


def count(job: str, stretch: int) -> int:
    texts = bead_job.programs(job)
    name = files(texts)[0]
    return len(lanes(texts[name].splitlines(), job)[stretch])


def any_inner(rng: np.random.Generator, job: str) -> tuple[int, int]:
    """A stretch and a move of it that is neither its first nor its last one."""
    stretch = int(rng.integers(3))
    return stretch, int(rng.integers(1, count(job, stretch) - 1))


def one_move(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    stretch, move = any_inner(rng, job)
    return slowed(job, texts, stretch, [move], rng.uniform(1.12, 4.0))


def some_moves(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    stretch = int(rng.integers(3))
    first = int(rng.integers(1, count(job, stretch) - 3))
    return slowed(job, texts, stretch, [first, first + 1, first + 2], rng.uniform(1.15, 3.0))


def every(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    factor = rng.uniform(1.12, 3.0)
    for stretch in range(3):
        texts = slowed(job, texts, stretch, list(range(count(job, stretch))), factor)
    return texts


def first_or_last(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    stretch = int(rng.integers(3))
    return slowed(job, texts, stretch, [int(rng.choice([0, count(job, stretch) - 1]))], rng.uniform(2.2, 6.0))


def stopped(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    stretch, move = any_inner(rng, job)
    if job == "kuka":
        return changed(job, texts, stretch, move, lambda row, _: [row.replace(" C_SPL", "")])
    return changed(job, texts, stretch, move, lambda row, _: [re.sub(r",z\w+,", ",fine,", row)])


def dwelt(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    stretch, move = any_inner(rng, job)
    wait = (
        f"WAIT SEC {rng.uniform(0.05, 9.0):.2f}"
        if job == "kuka"
        else f"    WaitTime {rng.uniform(0.05, 9):.2f};"
    )
    return changed(job, texts, stretch, move, lambda row, _: [row, wait])


def unsteady(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    """Insert a pose, to which the tool creeps. It hurries from there in the remaining time."""
    stretch, move = any_inner(rng, job)
    fraction = rng.uniform(0.2, 0.5)

    def new(row: str, previous: str) -> list[str]:
        a, b = (float(X_COORDINATE[job].search(text)[1]) for text in (previous, row))  # type: ignore[index]
        there = X_COORDINATE[job].sub(
            lambda f: f[0].replace(f[1], f"{a + fraction * (b - a):.4f}"), row, count=1
        )
        if job == "kuka":
            slow, fast = bead_job.FEED * 4e-4, bead_job.FEED * 2e-3
            return [f"$VEL.CP={slow:.8f}", there, f"$VEL.CP={fast:.8f}", row, "$VEL.CP=0.03879979"]
        took = float(T.search(row)[1])  # type: ignore[index]
        times = took * 0.85, took * 0.15
        return [T.sub(f"\\\\T:={time:.5f}", text) for time, text in zip(times, (there, row), strict=True)]

    out = changed(job, texts, stretch, move, new)
    if job == "two":  # numbers of moves follow each other
        for name in files(out):
            first, *others = re.split(r"\\ID:=\d+", out[name])
            out[name] = first + "".join(f"\\ID:={k}{text}" for k, text in enumerate(others, 1))
    return out


def turning(rng: np.random.Generator, job: str, texts: Texts) -> Texts:
    """KUKA: reduce the rotation speed, so that the move takes as long as the rotation."""
    name = files(texts)[0]
    slow = f"{rng.uniform(0.5, 4.0):.5f}"
    return {**texts, name: re.sub(r"(\$VEL.ORI[12])=[\d.]+", rf"\1={slow}", texts[name])}


MUTATORS = {f.__name__: f for f in (one_move, some_moves, every, first_or_last, stopped, dwelt, unsteady)}
CASES = [(job, kind) for job in bead_job.JOBS for kind in MUTATORS] + [("kuka", "turning")]


@functools.cache
def prover(job: str) -> Prover:
    return Prover(bead_job.problem(job), bead_job.claims(job))


def caught(job: str, kind: str, seed: int) -> bool:
    """Return whether its rule refuses a mutant."""
    rng = np.random.default_rng([seed, len(kind), bead_job.JOBS.index(job)])
    texts = bead_job.programs(job)
    mutant = {**MUTATORS, "turning": turning}[kind](rng, job, texts)
    assert mutant != texts
    proof = prover(job).prove(mutant, last="verify.follows")
    return any(issue.code == "verify.follows" for issue in proof.issues)


@pytest.mark.parametrize("job", bead_job.JOBS)
def test_what_the_planner_keeps_is_proven(job: str) -> None:
    proof = prover(job).prove(bead_job.programs(job))
    assert proof.ok, proof.issues


@pytest.mark.parametrize(("job", "kind"), CASES[::2])
def test_each_slower_program_is_refused(job: str, kind: str) -> None:
    assert caught(job, kind, 1)


@pytest.mark.long
@pytest.mark.parametrize(("job", "kind"), CASES)
def test_many_slower_programs_are_refused(job: str, kind: str) -> None:
    assert [seed for seed in range(2, 14) if not caught(job, kind, seed)] == []


def harmless(job: str) -> dict[str, Texts]:
    texts = bead_job.programs(job)
    inner = [list(range(1, count(job, k) - 1)) for k in range(3)]
    word = "; " if job == "kuka" else "  ! "
    end = {name: "\r\n" if "\r\n" in text else "\n" for name, text in texts.items()}
    noted = {
        name: text.replace("Segment cut/there", "Segment cut/there", 1) + f"{word}by hand{end[name]}"
        if name in files(texts)
        else text
        for name, text in texts.items()
    }
    slower = texts
    for stretch in range(3):
        slower = slowed(job, slower, stretch, inner[stretch], 1.05)
    return {
        "a comment": noted,
        "slower within the window": slower,
        "one move at 37 mm/s": slowed(job, texts, 0, [5], 1.045),
        "one move a little faster": slowed(job, texts, 1, [4], 0.98),
        "the last move eased": slowed(job, texts, 2, [count(job, 2) - 1], 1.1),
    }


@pytest.mark.parametrize("job", ["abb", "kuka", pytest.param("two", marks=pytest.mark.long)])
def test_harmless_changes_end_without_alarm(job: str) -> None:
    for name, texts in harmless(job).items():
        assert texts != bead_job.programs(job), name
        proof = prover(job).prove(texts, last="verify.follows")
        assert [str(issue) for issue in proof.issues] == [], name


# ---- what is allowed, in closed form and of the two sides ----------------------------------------


def some_targets(rng: np.random.Generator) -> Targets:
    targets = registry.job(bead_job.problem("abb"), 0).targets()
    return dataclasses.replace(
        targets,
        travel=np.append(0.0, rng.uniform(0.5e-3, 9e-3, targets.count - 1)),
        stop=targets.stop | (rng.uniform(size=targets.count) < 0.1),
        feed_min=np.where(rng.uniform(size=targets.count) < 0.8, 0.03, 0.0) * (np.arange(targets.count) > 0),
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_time_allowed_is_that_of_a_point_that_accelerates_evenly(seed: int) -> None:
    """Against the integral of ds / v with v^2 = v0^2 s / run-up from either end of each stretch."""
    targets = some_targets(np.random.default_rng(seed))
    allowed = planned.max_move_times(targets)
    run_up = targets.run_up
    assert run_up is not None
    for first, last in planned.min_feed_runs(targets):
        way = np.concatenate([[0.0], np.cumsum(targets.travel[first : last + 1])])
        for k, (a, b) in enumerate(itertools.pairwise(way)):
            s = a + (b - a) * (1.0 - np.cos(np.pi * (np.arange(20000) + 0.5) / 20000)) / 2.0
            ds = np.diff(a + (b - a) * (1.0 - np.cos(np.pi * np.arange(20001) / 20000)) / 2.0)
            v = 0.03 * np.sqrt(np.minimum(np.minimum(s, way[-1] - s) / run_up, 1.0))
            assert allowed[first + k] == pytest.approx(float((ds / v).sum()), rel=2e-3)


@pytest.mark.parametrize("seed", range(6))
def test_proof_and_planner_allow_the_same(seed: int) -> None:
    targets = some_targets(np.random.default_rng(50 + seed))
    allowed = planned.max_move_times(targets)
    took = np.where(np.isfinite(allowed), allowed, 0.2)
    took[0] = 0.0

    def faults(factor: float) -> list[proven.SlowFault]:
        way = proven.PoseTiming(
            targets.travel[1:],
            targets.feed_min[1:],
            targets.feed[1:],
            targets.stop,
            np.arange(targets.count),
            np.cumsum(took * factor),
            targets.stop,
            (),
        )
        halting = dataclasses.replace(way, positions=(np.cumsum(targets.travel)[:, None] * [1.0, 0.0, 0.0],))
        return proven.find_feed_shortfalls(halting, targets.run_up or 0.0)

    assert [f for f in faults(1.0) if "on the way to pose" in f.message and f.got < 0.999 * f.limit] == []
    late = {f.pose for f in faults(1.01) if "at least" in f.message and "required" in f.message}
    assert len(late) >= 15


# ---- what the planner refuses ----------------------------------------


def refused(
    folder: Path, table: Callable[[str], str] | None = None, job: str = "abb", **changes: object
) -> str:
    path = bead_job.write(folder, job, **changes)
    if table is not None:
        file = folder / "beads.csv"
        file.write_text(table(file.read_text()))
    with pytest.raises(TandemError) as caught_error:
        pipeline.plan(pipeline.load(path))
    return " ".join(f"{issue} [{issue.code}]" for issue in caught_error.value.issues)


def test_a_least_feed_beyond_the_accelerations_names_the_run_up(tmp_path: Path) -> None:
    reported = refused(tmp_path, feed_mm_s=240, run_up_mm=0.1, table=lambda t: t.replace(",36,", ",225,"))
    assert "[motion.feed_min]" in reported
    assert "need a longer run-up than 0.1 mm" in reported


def test_a_least_feed_beyond_the_tcp_speed_names_the_setting(tmp_path: Path) -> None:
    reported = refused(tmp_path, feed_mm_s=400, run_up_mm=30, table=lambda t: t.replace(",36,", ",300,"))
    assert "settings.tcp_speed_mm_s is 250 mm/s" in reported


def test_a_least_feed_beyond_a_joint_names_the_joint(tmp_path: Path) -> None:
    """The tool turns by 8 degrees a millimetre about z: 450 deg/s, 0.9 by the settings, 0.97 used."""
    rows = ["robot.x_mm,robot.y_mm,robot.z_mm,robot.qw,robot.qx,robot.qy,robot.qz"]
    for k in range(20):
        half = np.deg2rad(4.0 * k)
        rows.append(f"{k},0,90,0,{np.cos(half):.9f},{np.sin(half):.9f},0")
    reported = refused(
        tmp_path, free=[], feed_mm_s=100, feed_min_mm_s=90, table=lambda _: "\n".join(rows), run_up_mm=5
    )
    assert re.search(r"joint 6 of robot would turn at \d+\.\d deg/s, allowed 392\.8", reported), reported


def test_a_tool_that_turns_faster_than_krl_lets_it_is_named(tmp_path: Path) -> None:
    rows = ["robot.x_mm,robot.y_mm,robot.z_mm,robot.qw,robot.qx,robot.qy,robot.qz"]
    for k in range(24):
        half = np.deg2rad(2.2 * k)
        rows.append(f"{2 * k},0,90,0,{np.cos(half):.9f},{np.sin(half):.9f},0")
    reported = refused(
        tmp_path, job="kuka", feed_mm_s=110, feed_min_mm_s=90, table=lambda _: "\n".join(rows), run_up_mm=30
    )
    pattern = r"the tool of robot turns at 2\d\d.* deg/s; KRL programs with a minimum feed"
    assert re.search(pattern, reported), reported


def test_poses_too_near_for_a_controller_are_named(tmp_path: Path) -> None:
    rows = ["robot.x_mm,robot.y_mm,robot.z_mm,robot.qw,robot.qx,robot.qy,robot.qz"]
    rows += [f"{0.2 * k:.1f},0,90,0,1,0,0" for k in range(80)]
    reported = refused(tmp_path, feed_min_mm_s=38, table=lambda _: "\n".join(rows))
    assert "controllers plan no move below 6 ms" in reported


def test_a_short_turn_before_a_stop_is_proven(tmp_path: Path) -> None:
    """A long way, then a short one with a turn, at whose end the planner stops: the turn begins twice as fast
    as it is on average, and the corner between them is as sharp as that."""
    rows = [
        "robot.x_mm,robot.y_mm,robot.z_mm,robot.qw,robot.qx,robot.qy,robot.qz,segment",
        "48.8182,30.3709,98.4705,0,0.999505227,-0.002959374,0.031313615,cut/a",
        "71.1120,7.7701,99.9200,0,0.999343543,0.000229140,0.036227494,cut/a",
        "71.2288,7.4383,99.9317,0,0.997183734,0.021110418,0.071964922,cut/a",
        "71.3909,6.2794,99.9398,0,0.997183734,0.021110418,0.071964922,cut/a",
    ]
    path = bead_job.write(tmp_path, "kuka", feed_mm_s=66.27, free=[])
    (tmp_path / "beads.csv").write_text("\n".join(rows))
    proof = pipeline.plan(pipeline.load(path)).proof
    assert [issue.message for issue in proof.issues if issue.severity is Severity.ERROR] == []
    assert proof.ok


def test_a_sharp_corner_is_named_with_its_place(tmp_path: Path) -> None:
    rows = ["robot.x_mm,robot.y_mm,robot.z_mm,robot.qw,robot.qx,robot.qy,robot.qz,segment"]
    rows += [
        f"{x},{y},90,0,1,0,0,cut/a"
        for x, y in [*((k, 0) for k in range(0, 50, 8)), (44, 8), (40, 16), (36, 24)]
    ]
    reported = refused(tmp_path, feed_mm_s=20, feed_min_mm_s=18, table=lambda _: "\n".join(rows))
    assert "[motion.feed_min]" in reported
    assert "cut/a/7" in reported


def test_two_controllers_that_meet_on_the_way_are_refused(tmp_path: Path) -> None:
    path = bead_job.write(tmp_path, "two")
    data = yaml.safe_load(path.read_text())
    data["cell"]["controller"] = {"sync": "handshake"}
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(TandemError) as caught_error:
        pipeline.plan(pipeline.load(path))
    (issue,) = [i for i in caught_error.value.issues if i.code == "post.handshake_process"]
    assert "stop at cut/there/2" in issue.message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace(",36,cut/back", ",-1,cut/back", 1), "feed_min_mm_s of -1 is below 0"),
        (
            lambda t: t.replace(",36,cut/back", ",39,cut/back", 1),
            "feed_min_mm_s of 39 is over 0.95 of the feed",
        ),
        (lambda t: t.replace(",36,cut/back", ",nan,cut/back", 1), "column 'feed_min_mm_s'"),
        (lambda t: t + t.splitlines()[-1] + "\n", "where the tools rest or only rotate"),
    ],
)
def test_wrong_least_feeds_are_told_by_row(tmp_path: Path, change: Callable[[str], str], words: str) -> None:
    assert words in refused(tmp_path, table=change)


def test_wrong_least_feeds_of_the_operation_are_told(tmp_path: Path) -> None:
    for name, changes, words in (
        ("a", {"feed_min_mm_s": 39}, "must not exceed 0.95 of feed_mm_s"),
        ("b", {"feed_min_mm_s": -1}, "greater than or equal to 0"),
        ("c", {"run_up_mm": 0}, "greater than 0"),
        (
            "d",
            {"free": [{"name": "s", "arms": ["robot"], "axis": "x", "slide_mm": [-1, 1]}]},
            "free axis 's' slides",
        ),
        ("e", {"coupled": True}, "transit of joined tools"),
    ):
        folder = tmp_path / name
        folder.mkdir()
        text = bead_job.write(folder, "abb", **changes)
        if name == "e":
            table = folder / "beads.csv"
            table.write_text(table.read_text().replace("cut/back", "transit/back"))
        with pytest.raises(TandemError) as caught_error:
            pipeline.plan(pipeline.load(text))
        assert words in " ".join(str(issue) for issue in caught_error.value.issues)
