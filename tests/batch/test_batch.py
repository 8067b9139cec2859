"""A batch: results as one by one, nothing lost or repeated when it is killed, summaries, and exit codes."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
import random
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from planner import pipeline, spec
from planner.batch import compare
from planner.batch import run as batch
from planner.batch.job import BatchJob, JobEvent, JobFinished, JobRecord, JobResult, JobState
from planner.batch.rows import RECORDS_FOLDER, BatchItem, BatchRow
from planner.batch.run import BatchSettings, collect_items, make_bundled_job
from planner.batch.workers import BatchWorkers
from planner.cli import batch as batch_commands
from planner.cli import command_line
from planner.cli.batch import Batch
from planner.cli.batch import run_batch as command
from planner.issues import Issue, Severity, TandemError
from tests import small_problem
from tests.batch.jobs import FAULTY, alive, content, items

PLAIN = BatchSettings()
BAD = small_problem.PROBLEM.replace("irb140", "irb9000")


def plan(
    items: Sequence[BatchItem], out: Path, settings: BatchSettings = PLAIN, count: int = 2
) -> tuple[list[BatchRow], list[JobEvent]]:
    events: list[JobEvent] = []
    with batch.claimed_folder(out), BatchWorkers(count, module=FAULTY) as workers:
        return batch.run_batch(items, out, workers, settings, events.append), events


def test_results_are_those_of_planning_one_by_one(tmp_path: Path) -> None:
    single = "\n".join([small_problem.COLUMNS, small_problem.ROWS[0]])
    texts = {
        "bad": (BAD, None),
        "good": (small_problem.PROBLEM, None),
        "few": (small_problem.PROBLEM, single),
    }
    for name, (text, rows) in texts.items():
        (tmp_path / "in" / name).mkdir(parents=True)
        small_problem.write(tmp_path / "in" / name, text, rows)
    assert command(Batch((tmp_path / "in",), tmp_path / "out", workers=1)) == 2
    for name in texts:
        command_line.plan(tmp_path / "in" / name / "problem.yaml", tmp_path / "alone" / name)
        assert content(tmp_path / "out" / name) == content(tmp_path / "alone" / name)
    assert (tmp_path / "out" / "good" / "programs").is_dir()
    told = (tmp_path / "out" / "summary.csv").read_text()
    bad, few, good = csv.DictReader(io.StringIO(told))
    assert [(r["name"], r["state"]) for r in (bad, few, good)] == [
        ("bad", "bad_input"),
        ("few", "bad_input"),
        ("good", "verified"),
    ]
    assert "problem.unknown_robot" in bad["issues"]
    assert str(tmp_path / "in" / "few" / "targets.csv") in few["message"]
    assert good["targets"] == "6"
    assert float(good["clearance_mm"]) > 10.0
    page = (tmp_path / "out" / "summary.html").read_text()
    assert page.count('<img alt="" src="data:image/png') == 2  # where a cell could be drawn
    before = {name: (tmp_path / "out" / name).stat().st_ino for name in ("good", "few")}
    assert command(Batch((tmp_path / "in",), tmp_path / "out", workers=1, resume=True)) == 2
    assert before == {name: (tmp_path / "out" / name).stat().st_ino for name in before}
    assert "2 kept from earlier runs" in (tmp_path / "out" / "summary.html").read_text()


@pytest.mark.long
def test_reports_may_be_made_later(tmp_path: Path) -> None:
    for name, text in (("bad", BAD), ("good", small_problem.PROBLEM)):
        (tmp_path / "in" / name).mkdir(parents=True)
        small_problem.write(tmp_path / "in" / name, text)
    good = tmp_path / "out" / "good"
    asked = Batch((tmp_path / "in",), tmp_path / "out", workers=1, reports="failed")
    assert command(asked) == 2
    assert not (good / "report.html").exists()
    assert (tmp_path / "out" / "bad" / "report.html").is_file()
    command_line.plan(tmp_path / "in" / "good" / "problem.yaml", tmp_path / "alone")
    whole = content(tmp_path / "alone")
    pages = {"report.html", "replay.html"}
    assert content(good) == {name: text for name, text in whole.items() if name not in pages}
    assert "good/report.html" not in (tmp_path / "out" / "summary.html").read_text()
    before = good.stat().st_ino
    assert command(dataclasses.replace(asked, resume=True)) == 2
    assert good.stat().st_ino == before
    assert command_line.report((good,)) == 0
    assert content(good) == whole
    next((good / "programs").rglob("*.mod*")).unlink()
    assert command_line.report((good, tmp_path / "out" / "bad")) == 4


def test_without_reports_what_has_none_is_planned_again_where_all_are_asked_for(tmp_path: Path) -> None:
    result, out = items(tmp_path, ["good-1"]), tmp_path / "out"
    for resume, reports, kept in ((False, "failed", False), (True, "failed", True), (True, "all", False)):
        rows, _ = plan(result, out, BatchSettings(resume=resume, reports=reports))  # type: ignore[arg-type]
        assert [(row.done.state, row.is_kept) for row in rows] == [("verified", kept)]
        assert (out / "good-1" / "report.html").is_file() == (reports == "all")


@pytest.mark.parametrize("rounds", [5, pytest.param(40, marks=pytest.mark.long)])
@pytest.mark.parametrize("whom", ["parent", "worker"])
def test_a_batch_that_is_killed_at_many_moments_goes_on(tmp_path: Path, whom: str, rounds: int) -> None:
    moments, out = random.Random(whom), tmp_path / "out"
    names = [f"slow-{i:02d}" for i in range(3 * rounds)]
    result = items(tmp_path, names)
    finished: dict[str, tuple[int, bytes]] = {}
    for _ in range(rounds):
        wait = moments.randint(0, 3), moments.uniform(0.0, 0.15)
        child = os.fork()
        if child == 0:
            _batch_in_child(result, out, wait if whom == "worker" else None)
        if whom == "parent":
            _wait_until_finished(out, len(finished) + wait[0])
            time.sleep(wait[1])
            os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        now = {p.name: _standing(p) for p in out.glob("slow-*")}
        for name, standing in finished.items():
            assert now[name] == standing, f"{name} was finished and was planned again"
        for name, (_, text) in now.items():
            assert text.startswith(f"{name} ".encode()) or b"batch.crashed" in text
            assert [p.name for p in (out / name).iterdir()] == ["report.html"]
        finished |= {n: s for n, s in now.items() if b"batch.crashed" not in s[1]}
        assert len([p for p in out.iterdir() if p.name.startswith(".tandem-")]) <= 2
    rows, _ = plan(result, out, BatchSettings(resume=True))
    assert [row.done.state for row in rows] == ["verified"] * len(names)
    assert sum(row.is_kept for row in rows) == len(finished) > 0
    for name, standing in finished.items():
        assert _standing(out / name) == standing
    assert {p.name for p in out.iterdir()} == {RECORDS_FOLDER, *names}
    assert {p.name for p in (out / RECORDS_FOLDER).iterdir()} == {f"{name}.json" for name in names}


def _wait_until_finished(out: Path, count: int) -> None:
    until = time.monotonic() + 60.0
    while len(list(out.glob("slow-*"))) < count and time.monotonic() < until:
        time.sleep(0.005)


def _batch_in_child(items: Sequence[BatchItem], out: Path, kill: tuple[int, float] | None) -> None:
    """A batch in a forked process, which never comes back; a worker is killed when so many jobs have
    finished, and so many seconds have gone by since."""
    try:
        ended, since = 0, 0.0
        with batch.claimed_folder(out), BatchWorkers(2, module=FAULTY) as workers:

            def tell(event: JobEvent) -> None:
                nonlocal ended, since, kill
                ended += isinstance(event, JobFinished)
                if kill is not None and ended >= kill[0]:
                    since = since or time.monotonic()
                    if time.monotonic() - since > kill[1]:
                        kill = None
                        os.kill(workers.pids[-1], signal.SIGKILL)

            rest = [item for item in items if not (out / item.name).exists()]
            subset = items if kill is None else [*rest[:5], *[i for i in items if i not in rest]]
            batch.run_batch(subset, out, workers, BatchSettings(resume=True), tell)
    finally:
        os._exit(0)


@pytest.mark.parametrize("moment", ["before the record", "after the record", "before the rename of the old"])
def test_a_kill_between_two_steps_of_the_end_of_a_job(tmp_path: Path, moment: str) -> None:
    result, out = items(tmp_path, ["good-1"]), tmp_path / "out"
    plan(result, out)
    old = _standing(out / "good-1")
    child = os.fork()
    if child == 0:
        real = JobRecord.write

        def killed(self: JobRecord, done: JobResult) -> None:
            if moment == "after the record":
                real(self, done)
            os._exit(9)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(JobRecord, "write", killed)
            if moment == "before the rename of the old":
                patch.setattr(Path, "rename", lambda *_: os._exit(9))
            plan(result, out)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    assert not (out / "good-1").exists() or _standing(out / "good-1") == old
    ((row,), _) = plan(result, out, BatchSettings(resume=True))
    assert row.done.state == "verified"
    assert row.is_kept == (moment == "before the rename of the old")
    assert sorted(p.name for p in out.iterdir()) == [RECORDS_FOLDER, "good-1"]


def _standing(folder: Path) -> tuple[int, bytes]:
    return folder.stat().st_ino, (folder / "report.html").read_bytes()


def test_what_is_tried_again(tmp_path: Path) -> None:
    result = items(tmp_path, ["exit-1", "hang-1", "good-1"])
    out = tmp_path / "out"
    rows, _ = plan(result, out, BatchSettings(timeout_s=3.0))
    assert [row.done.state for row in rows] == ["crashed", "timeout", "verified"]
    assert batch.exit_code(rows) == 1
    rows, heard = plan(result, out, BatchSettings(timeout_s=3.0, resume=True))
    assert [row.is_kept for row in rows] == [False, True, True]
    assert [e.name for e in heard if isinstance(e, JobFinished)].count("good-1") == 1
    rows, _ = plan(result[1:], out, BatchSettings(timeout_s=3.5, resume=True))
    assert [row.is_kept for row in rows] == [False, True]
    assert rows[0].done.issues[0].limit == 3.5
    rows, _ = plan(result[2:], out)
    assert [row.is_kept for row in rows] == [False]
    (tmp_path / "targets.csv").write_text((tmp_path / "targets.csv").read_text() + "\n")
    rows, _ = plan(result[2:], out, BatchSettings(resume=True))
    assert [row.is_kept for row in rows] == [False]  # a file of the problem has changed
    (out / RECORDS_FOLDER / "good-1.json").write_text("{")
    rows, _ = plan(result[2:], out, BatchSettings(resume=True))
    assert [row.is_kept for row in rows] == [False]


def test_one_folder_that_cannot_be_replaced_fails_its_job_alone(tmp_path: Path) -> None:
    result = items(tmp_path, ["good-1", "good-2"])
    (tmp_path / "out" / "good-1").mkdir(parents=True)
    (tmp_path / "out" / "good-1" / "mine.txt").write_text("mine")
    rows, _ = plan(result, tmp_path / "out")
    assert [row.done.state for row in rows] == ["bad_input", "verified"]
    assert rows[0].done.issues[0].code == "output.folder"
    assert (tmp_path / "out" / "good-1" / "mine.txt").read_text() == "mine"


def test_two_batches_do_not_share_a_folder(tmp_path: Path) -> None:
    refused = pytest.raises(TandemError, match="another batch is writing")
    with batch.claimed_folder(tmp_path), refused as caught, batch.claimed_folder(tmp_path):
        pass
    assert caught.value.issues[0].code == "batch.in_use"
    with batch.claimed_folder(tmp_path):
        pass


def test_workers_are_gone_after_ctrl_c(tmp_path: Path) -> None:
    result = items(tmp_path, ["hang-1"])
    pids: list[int] = []
    with (
        pytest.raises(KeyboardInterrupt),
        batch.claimed_folder(tmp_path / "out"),
        BatchWorkers(1, module=FAULTY) as w,
    ):

        def stop(_: JobEvent) -> None:
            pids.extend(w.pids)
            raise KeyboardInterrupt

        batch.run_batch(result, tmp_path / "out", w, BatchSettings(), stop)
    assert len(pids) == 1
    assert not alive(pids[0])
    assert [p.name for p in (tmp_path / "out").iterdir()] == [RECORDS_FOLDER]


def test_files_folders_and_bundled_names_are_found(tmp_path: Path) -> None:
    for place in ("a", "a/deep", "B", ".hidden", "out/a/problem"):
        (tmp_path / place).mkdir(parents=True, exist_ok=True)
        small_problem.write(tmp_path / place)
    (tmp_path / "a" / "small.yaml").write_text(small_problem.PROBLEM)
    (tmp_path / "a" / "cell.yaml").write_text("arms: []\n")
    (tmp_path / "a" / "broken.yaml").write_text("tandem: [")
    result = collect_items([tmp_path], tmp_path / "out")
    assert [item.name for item in result] == ["B", "a-broken", "a-deep", "a", "a-small"]
    again = collect_items([tmp_path / "a" / "problem.yaml", tmp_path / "a", Path("wing")], tmp_path / "out")
    assert [item.name for item in again] == ["a", "broken", "deep", "a-2", "small", "wing"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(TandemError) as caught:
        collect_items([tmp_path / "nowhere", tmp_path / "empty"], tmp_path / "out")
    assert [issue.code for issue in caught.value.issues] == ["problem.missing_file"] * 2


def row(state: JobState = "verified", name: str = "a", **more: object) -> BatchRow:
    item = BatchItem(name, "p.yaml", lambda: pipeline.load("p"), {"settings.seed": 3})
    return BatchRow(item, dataclasses.replace(JobResult(name, state), **more))  # type: ignore[arg-type]


def test_a_file_that_is_no_yaml_is_a_row_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = {
        "broken.yaml": "tandem: 1\nname: [a, b\n",
        "twice.yaml": "tandem: 1\ntandem: 1\n",
        "empty.yml": "",
        "latin.yaml": "name: Stra\udcdfe\n",
    }
    folder = tmp_path / "in"
    folder.mkdir()
    for name, text in texts.items():
        (folder / name).write_bytes(text.encode("utf-8", "surrogateescape"))
    (folder / "cell.yaml").write_text("arms: []\n")  # YAML of another kind is still passed over
    assert command(Batch((folder,), tmp_path / "out", workers=1)) == 2
    shown = capsys.readouterr()
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "summary.csv").read_text())))
    assert [row["name"] for row in rows] == ["broken", "empty", "latin", "twice"]
    assert {row["state"] for row in rows} == {"bad_input"}
    assert [row["issues"] for row in rows] == [*["problem.not_yaml"] * 3, "problem.duplicate_name"]
    page = (tmp_path / "out" / "summary.html").read_text()
    assert page.count("bad input") >= 4 and "broken.yaml" in page
    assert "0 of 4 verified" in shown.out and shown.out.count("bad input") == 4


def test_the_line_of_a_job_that_ended_names_its_error(capsys: pytest.CaptureFixture[str]) -> None:
    doubt = Issue("kerf.doubt", "the kerf is not sure", Severity.WARNING)
    error = Issue("stock.footprint", "the gripper stands out of the block")
    item = BatchItem("one", "one.yaml", lambda: pytest.fail("nobody reads it"))
    for issues, expected_text in (((doubt, error), "stock.footprint"), ((doubt,), "kerf.doubt")):
        with batch_commands._show_progress([item]) as shown:
            shown.show(JobFinished("one", JobResult("one", "infeasible", issues)))
        output = capsys.readouterr().err
        assert expected_text in output and (expected_text == "kerf.doubt" or "kerf.doubt" not in output)


@pytest.mark.parametrize(
    ("states", "code"),
    [
        (("verified",), 0),
        (("verified", "bad_input"), 2),
        (("bad_input", "infeasible"), 3),
        (("unproven", "infeasible"), 4),
        (("timeout", "unproven"), 1),
        (("memory",), 1),
        (("crashed",), 1),
    ],
)
def test_exit_codes(states: tuple[JobState, ...], code: int) -> None:
    assert batch.exit_code([row(state) for state in states]) == code


def test_tables_hold_what_people_wrote_as_text(tmp_path: Path) -> None:
    issues = (
        Issue("kerf.doubt", "=1+1 <b>", Severity.WARNING),
        Issue("mesh.unit", '@cmd, "quoted"\nline'),
        Issue("mesh.empty", "note", Severity.NOTE),
    )
    rows = [row("infeasible", issues=issues, metrics={"cycle_s": 1.25, "targets": 4.0}), row(name="b")]
    first, second = csv.DictReader(io.StringIO(compare.csv_table(rows), newline=""))
    assert first["message"] == '\'@cmd, "quoted"\nline'
    assert first["issues"] == "mesh.unit kerf.doubt mesh.empty"  # that of the message first
    assert (first["cycle_s"], first["targets"], first["settings.seed"]) == ("1.25", "4", "3")
    assert second["cycle_s"] == ""
    assert compare.issue_counts(rows[0]) == "1 error, 1 warning, 1 note"
    page = compare.summary_page("A & B", rows, tmp_path, 3.0)
    assert "A &amp; B" in page
    assert "@cmd" in page
    assert "<b> " not in page
    assert page.endswith("</html>\n")


def test_records_that_are_none_are_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    good = JobResult("a", "verified").to_dict()
    for wrong in (
        [],
        {},
        {**good, "state": "lost"},
        {**good, "issues": [{"code": "x"}]},
        {**good, "metrics": 1},
    ):
        path.write_text(json.dumps(wrong))
        assert JobRecord.read(path) is None
    JobRecord(path, {"identity": "i"}).write(JobResult("a", "verified"))
    assert JobRecord.read(path) is not None


def test_numbers_and_names_of_a_command_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(TandemError) as caught:
        command(Batch((), tmp_path, workers=0, timeout=-1.0, memory=float("nan")))
    assert [issue.code for issue in caught.value.issues] == ["batch.field"] * 4
    assert {issue.field for issue in caught.value.issues} == {"--workers", "--timeout", "--memory", None}


def test_issues_call_files_as_the_problem_does(tmp_path: Path) -> None:

    small_problem.write(tmp_path)
    made = make_bundled_job("a", pipeline.load(tmp_path / "problem.yaml"))
    (name,) = (file for file in made.files if file.startswith("files/"))
    assert made.origins == {name: str(tmp_path / "targets.csv")}
    assert isinstance(made, BatchJob)


def test_problems_of_python_end_by_their_names(tmp_path: Path) -> None:
    small = pipeline.load(small_problem.write(tmp_path))
    high = spec.Problem.read(tmp_path).changed("stock.place.xyz_mm", [450, 0, 900])
    nobody = high.changed("operations.poses.arms", ["nobody"])
    ended = batch.plan_all({"a problem": small, "nobody": nobody}, tmp_path / "out", workers=1)
    assert {name: done.state for name, done in ended.items()} == {
        "a problem": "verified",
        "nobody": "bad_input",
    }
    assert [issue.code for issue in ended["nobody"].issues] == ["problem.unknown_arm"]
    assert (tmp_path / "out" / ended["a problem"].name / "programs").is_dir()
    assert not (tmp_path / "out" / "nobody" / "programs").exists()
    with pytest.raises(ValueError, match="at least 1"):
        batch.plan_all({"a problem": small}, tmp_path / "out", workers=0)
