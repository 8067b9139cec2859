"""Ctrl-C and kill at seeded moments: a result folder is never half of one run and half of another."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pydrake.common import trigger_an_assertion_failure

from planner import files, pipeline
from planner.issues import TandemError
from planner.problem import Problem
from tests import small_problem

OWNED = ("programs", "problem", "plan.json", "report.html")
WRITER = """
import sys, itertools
from pathlib import Path
from planner.files import write_folder
folder = Path(sys.argv[1])
print("ready", flush=True)
for run in itertools.count():
    text = f"{run}\\n" * 20_000
    names = ("programs/a.mod", "programs/sub/b.mod", "problem/p.yaml", "plan.json", "report.html")
    write_folder(folder, {name: text for name in names}, ("programs", "problem", "plan.json", "report.html"))
"""


def start(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=Path(__file__).parent.parent,
    )


def litter(folder: Path) -> list[Path]:
    """Everything in a result folder that is not part of a result."""
    return [p for p in folder.iterdir() if p.name.startswith(".")] if folder.exists() else []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_writing_is_killed_at_many_moments(tmp_path: Path, number: signal.Signals) -> None:
    moments, litters = random.Random(7), 0
    for _ in range(12):
        process = start("-c", WRITER, str(tmp_path / "out"))
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(moments.uniform(0.0, 0.05))
        process.send_signal(number)
        process.communicate(timeout=30)
        left = litter(tmp_path / "out")
        litters += len(left)
        assert len(left) <= 1
        whole = [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
        whole = [p for p in whole if not any(parent in left for parent in p.parents)]
        texts = {p.read_text() for p in whole}
        assert all(text.count("\n") == 20_000 for text in texts)
        if (tmp_path / "out" / "programs").exists():
            assert len(texts) == 1
            assert len(whole) == 5
    assert number == signal.SIGKILL or litters <= 1
    files.write_folder(tmp_path / "out", {"report.html": "r"}, OWNED)
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["report.html"]


def test_what_a_running_process_writes_is_left_to_it(tmp_path: Path) -> None:
    with files.staging(tmp_path) as staging:
        files.prepare_folder(tmp_path, OWNED)
        assert staging.is_dir()
    assert not litter(tmp_path)


def test_ctrl_c_waits_until_the_new_result_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files.write_folder(tmp_path, {"programs/x": "old", "plan.json": "old"}, OWNED)
    real = Path.replace

    def interrupted_replace(self: Path, target: Path) -> Path:
        if self.name == "programs":
            signal.raise_signal(signal.SIGINT)
        return real(self, target)

    monkeypatch.setattr(Path, "replace", interrupted_replace)
    with pytest.raises(KeyboardInterrupt):
        files.write_folder(tmp_path, {"programs/x": "new", "plan.json": "new"}, OWNED)
    assert (tmp_path / "programs" / "x").read_text() == "new"
    assert (tmp_path / "plan.json").read_text() == "new"
    assert not litter(tmp_path)


def complete(folder: Path) -> bool:
    """Whether a result is whole: programs with all files that go with them, or nothing but the folder."""
    names = {p.name for p in folder.iterdir() if not p.name.startswith(".")} if folder.exists() else set()
    if "programs" not in names:
        return True
    json.loads((folder / "plan.json").read_text())
    json.loads((folder / "proof.json").read_text())
    whole = {"programs", "problem", "plan.npz", "plan.json", "proof.json", "report.html", "replay.html"}
    return whole <= names and (folder / "report.html").read_text().rstrip().endswith("</html>")


def interrupt(tmp_path: Path, number: signal.Signals, delay: float) -> subprocess.CompletedProcess[str]:
    process = start("-m", "planner", "plan", str(tmp_path / "problem.yaml"), "-o", str(tmp_path / "out"))
    time.sleep(delay)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    return subprocess.CompletedProcess([], process.returncode, out, err)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_planning_is_stopped_at_many_moments(tmp_path: Path, seed: int) -> None:
    small_problem.write(tmp_path)
    moments = random.Random(seed)
    for number in (signal.SIGINT, signal.SIGKILL) * (2 if seed == 1 else 15):
        done = interrupt(tmp_path, number, moments.uniform(0.3, 6.0))
        assert complete(tmp_path / "out")
        assert len(litter(tmp_path / "out")) <= (0 if number == signal.SIGINT else 1)
        if number == signal.SIGINT:
            assert done.returncode in (130, 0, -signal.SIGINT)
            assert "Traceback" not in done.stderr
            assert "internal.error" not in done.stderr


def test_an_output_folder_that_cannot_be_is_told_before_planning(tmp_path: Path) -> None:
    taken = tmp_path / "file"
    taken.write_text("mine")
    for folder in (taken, taken / "sub", Path("/proc/out"), tmp_path / ("x" * 300), tmp_path / "a\0b"):
        with pytest.raises(TandemError) as caught:
            files.prepare_folder(folder, OWNED)
        assert [issue.code for issue in caught.value.issues] == ["output.folder"]
    assert taken.read_text() == "mine"
    files.prepare_folder(tmp_path / "new" / "deep", OWNED)
    assert list((tmp_path / "new" / "deep").iterdir()) == []


def test_an_output_folder_that_would_swallow_the_problem_is_refused(tmp_path: Path) -> None:
    mine = tmp_path / "problem" / "problem.yaml"
    mine.parent.mkdir()
    mine.write_text("tandem: 1")
    with pytest.raises(TandemError, match="choose another"):
        files.prepare_folder(tmp_path, OWNED, keep=mine)
    assert mine.read_text() == "tandem: 1"


def test_a_full_disk_is_an_issue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files.write_folder(tmp_path, {"programs/x": "old"}, OWNED)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(TandemError, match="No space left"):
        files.write_folder(tmp_path, {"programs/x": "new"}, OWNED)
    assert (tmp_path / "programs" / "x").read_text() == "old"
    assert not litter(tmp_path)


def test_a_library_that_gives_up_ends_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drake raises ``SystemExit`` if one of its assertions fails: here by its own function for that."""

    def jobs(problem: Problem, brief: bool = False) -> list[object]:
        trigger_an_assertion_failure()
        return [problem]

    problem = pipeline.load(small_problem.write(tmp_path))
    with pytest.raises(SystemExit):
        jobs(problem)
    monkeypatch.setattr(pipeline.processes, "jobs", jobs)
    for work in (pipeline.plan, pipeline.check):
        with pytest.raises(RuntimeError, match="a library aborted"):
            work(problem)
