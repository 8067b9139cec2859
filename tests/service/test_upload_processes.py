"""Readers of uploads: owners take turns, queues have an end, and who hangs up is no longer served."""

from __future__ import annotations

import os
import re
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import anyio
import pytest
from starlette.requests import Request

from planner.service.examined import Examined
from planner.service.models import Database, default_url
from planner.service.security import Auth, Limits, RefusedError
from planner.service.upload_processes import Examiners, Reader, Reading, connection_closed
from tests import small_problem
from tests.service.support import InProcess, codes, named, until

READINGS = 4
PATHS = ("/ui/preview", "/v1/check", "/v1/jobs")


class Held:
    """Stands for the readers: counts who reads, and reads on until it is let go."""

    def __init__(self) -> None:
        self.go, self.lock = threading.Event(), threading.Lock()
        self.now = self.most = 0

    def __call__(self, *asked: Any) -> Examined:
        with self.lock:
            self.now += 1
            self.most = max(self.most, self.now)
        self.go.wait(60)
        with self.lock:
            self.now -= 1
        return Examined((), name="small", digest="0", text="tandem: 1")


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[InProcess, Held, str, str]]:
    """A service with three readers that are held, and two tokens."""
    data = tmp_path / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.make("ann"), auth.make("bob")
    held = Held()
    monkeypatch.setattr(Examiners, "examine", lambda self, *asked: held(*asked))
    limits = Limits(readings=READINGS)
    with InProcess(data, limits, examiners=3, require_token=True) as made:
        yield made, held, *tokens
        held.go.set()


@pytest.mark.parametrize("path", PATHS)
def test_one_token_never_keeps_all_readers(shared: tuple[InProcess, Held, str, str], path: str) -> None:
    here, held, ann, bob = shared
    with ThreadPoolExecutor(8) as pool:
        asked = [
            pool.submit(here.post, named(f"a{k}"), path, headers={"Authorization": f"Bearer {ann}"})
            for k in range(READINGS)
        ]
        until(lambda: held.now == 2)
        other = pool.submit(here.post, named("b"), path, headers={"Authorization": f"Bearer {bob}"})
        until(lambda: held.now == 3)
        more = here.post(named("more"), path, headers={"Authorization": f"Bearer {ann}"})
        assert more.status_code == 429 and int(more.headers["retry-after"]) > 0
        assert codes(more) == [("service.too_many", None)]
        held.go.set()
        assert {one.result().status_code for one in [*asked, other]} <= {200, 201}
        assert held.most == 3
    assert here.post(named("later"), path, headers={"Authorization": f"Bearer {ann}"}).status_code < 400


def test_long_readings_take_turns_with_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One reader, two who send batches, one who sweeps a field, one who checks: each waits for one problem of
    the others, and not for their batches; a second batch of one waits for the first."""
    data, first, order = tmp_path / "data", threading.Event(), list[str]()
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = {name: auth.make(name) for name in ("ann", "bob", "cyd", "dan")}

    def read(self: Examiners, problem: Path, *asked: Any) -> Examined:
        text = problem.read_text()
        (name,) = re.findall("^name: (.*)", text, re.M)
        order.append(name if asked[-1] is None else f"{name}-{asked[-1]['operations.0.feed_mm_s']}")
        first.wait(60)
        return Examined((), name=name, digest=order[-1], text=text)

    monkeypatch.setattr(Examiners, "examine", read)

    def send(who: str, path: str, *names: str, **asked: Any) -> Any:
        files = [("problem", (f"{name}.yaml", named(name))) for name in names]
        headers = {"Authorization": f"Bearer {tokens[who]}"}
        answer = here.http.post(path, files=files, params=asked, headers=headers)
        return answer.status_code, [one["name"] for one in answer.json().get("jobs", ())]

    with InProcess(data, examiners=1, require_token=True) as here, ThreadPoolExecutor(5) as pool:
        asked = [pool.submit(send, "ann", "/v1/batches", "a0", "a1", "a2")]
        until(lambda: order, 20)
        swept = {"field": "operations.0.feed_mm_s", "value": ["1", "2"]}
        for who, path, names, more in (
            ("bob", "/v1/batches", ("b0", "b1"), {}),
            ("cyd", "/v1/sweeps", ("c",), swept),
            ("dan", "/v1/check", ("d",), {}),
        ):
            waiting = len(asked)
            asked.append(pool.submit(send, who, path, *names, **more))
            until(lambda now=waiting: here.service._readers.statistics().tasks_waiting == now)  # type: ignore[misc]
        asked.append(pool.submit(send, "ann", "/v1/batches", "z0", "z1"))
        until(lambda: sum(here.service._waiting.values()) == 5)
        time.sleep(0.2)
        first.set()
        answers = [one.result() for one in asked]
    assert answers[0] == (201, ["a0", "a1", "a2"]) and answers[1] == (201, ["b0", "b1"])
    assert answers[2] == (201, ["c", "c"]) and answers[3][0] == 200 and answers[4] == (201, ["z0", "z1"])
    assert order[:4] == ["a0", "b0", "c-1", "d"]
    assert order.index("b1") < order.index("a2") and order.index("c-2") < order.index("a2")
    assert order.index("z1") > order.index("a2")


def test_a_closed_connection_ends_its_reading_and_its_waiting(tmp_path: Path) -> None:
    """Two requests of the machine's own user at one reader: one reads, one waits; both hang up."""
    begun: list[Reading] = []

    def read(reading: Reading) -> None:
        begun.append(reading)
        until(lambda: reading.off)
        raise connection_closed()

    async def hang_up() -> None:
        async def receive() -> dict[str, str]:
            while not begun:
                await anyio.sleep(0.01)
            await anyio.sleep(0.05)
            return {"type": "http.disconnect"}

        request = Request({"type": "http", "method": "POST", "headers": []}, receive)
        with pytest.raises(RefusedError) as caught:
            await here.service.in_turn(request, "local", read)
        assert caught.value.status == 499

    async def both() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(hang_up)
            tasks.start_soon(hang_up)

    # in a thread: the pages' browser keeps a loop of its own running in this one
    with InProcess(tmp_path / "data", examiners=1) as here, ThreadPoolExecutor(1) as pool:
        pool.submit(anyio.run, both).result()
    assert len(begun) == 1 and begun[0].off


def test_who_reads_next_is_ready_after_a_reading_was_broken_off(tmp_path: Path) -> None:
    """Ten checks of reach are broken off at different moments; each time the next one is answered, and
    the process that has loaded Drake stays."""
    small = small_problem.write(tmp_path)
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    readers = Examiners(1, tmp_path, 60.0, 4096.0, 1000)
    try:
        assert readers.examine(small, uploads, True, targets=2).looked_at is not None
        (reader,) = readers._all
        for k in range(10):
            reading = Reading()
            with ThreadPoolExecutor(1) as pool:
                asked = pool.submit(readers.examine, small, uploads, True, reading=reading)
                time.sleep(0.01 * k)
                reading.break_off()
                try:
                    asked.result(30)  # it may have been quicker
                except RefusedError as error:
                    assert error.status == 499
            assert readers.examine(small, uploads).readable
        assert readers._all == {reader} and reader.alive
        assert readers.examine(small, uploads, True, targets=2).looked_at is not None
    finally:
        readers.close()


def test_a_reading_that_is_broken_off_costs_its_process_alone(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    large.write_text("tandem: 1\na: [" + "x, " * 400_000 + "x]")
    small = small_problem.write(tmp_path)
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    readers = Examiners(1, tmp_path, 60.0, 4096.0, 1000)
    reading = Reading()
    try:
        assert readers.examine(small, uploads).readable
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(readers.examine, large, {}, reading=reading)
            time.sleep(0.2)
            reading.break_off()
            with pytest.raises(RefusedError) as caught:
                asked.result(30)
        assert caught.value.status == 499
        assert readers.examine(small, uploads).readable
    finally:
        readers.close()


class Late(Reading):
    """Is broken off as soon as it is known who reads; goes on to ask that one so many seconds later."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds

    def by(self, reader: Reader | None) -> bool:
        wanted = super().by(reader)
        if reader is not None:
            self.break_off()
            time.sleep(self.seconds)
        return wanted


class Early(Reading):
    """Is broken off so many seconds after the process of who reads can be told so: it has not begun yet."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds

    def by(self, reader: Reader | None) -> bool:
        if reader is not None:
            threading.Thread(target=self.end, args=(reader._process.pid,)).start()
        return super().by(reader)

    def end(self, pid: int) -> None:
        caught = re.compile(r"^SigCgt:\s*(\w+)", re.M)

        def hears() -> bool:
            found = caught.search(Path(f"/proc/{pid}/status").read_text())
            return found is not None and bool(int(found[1], 16) & 1 << (signal.SIGUSR2 - 1))

        until(hears)
        time.sleep(self.seconds)
        self.break_off()


@pytest.fixture
def three(tmp_path: Path) -> Iterator[tuple[Examiners, dict[str, Path], dict[str, Path]]]:
    """One reader, and three problems by their names with the files of all."""
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    paths = {}
    for name in ("first", "second", "third"):
        (tmp_path / name).mkdir()
        paths[name] = small_problem.write(tmp_path / name, named(name))
        shutil.copy(tmp_path / name / "targets.csv", tmp_path)
    readers = Examiners(1, tmp_path, 60.0, 4096.0, 1000)
    yield readers, paths, uploads
    readers.close()


def test_what_was_broken_off_is_no_answer_to_what_is_asked_next(
    three: tuple[Examiners, dict[str, Path], dict[str, Path]],
) -> None:
    """It is broken off, and whoever takes the place of who was to read it is there, before it is written, as
    under load: the next one was answered by what became of it."""
    readers, paths, uploads = three
    assert readers.examine(paths["first"], uploads).name == "first"
    with pytest.raises(RefusedError) as caught:
        readers.examine(paths["second"], uploads, reading=Late(1.0))
    assert caught.value.status == 499
    for name in ("third", "first"):
        assert readers.examine(paths[name], uploads).name == name


@pytest.mark.parametrize("seconds", [0.0, 0.004])
def test_a_reading_that_is_broken_off_while_its_process_begins_costs_nobody_a_reader(
    three: tuple[Examiners, dict[str, Path], dict[str, Path]], seconds: float
) -> None:
    """Who was ended before it said that it begins was waited for ever after."""
    readers, paths, uploads = three
    reading, pool = Early(seconds), ThreadPoolExecutor(1)
    asked = pool.submit(readers.examine, paths["first"], uploads, reading=reading)
    until(lambda: reading.off)
    try:
        assert asked.result(60).name == "first"  # it was quicker
    except RefusedError as error:
        assert error.status == 499
    assert pool.submit(readers.examine, paths["second"], uploads).result(60).name == "second"


def who_reads(reader: Reader) -> int:
    """The process that reads: the child of the one that forks it; 0 while there is none."""
    found = Path(f"/proc/{reader._process.pid}/task/{reader._process.pid}/children").read_text().split()
    return int(found[0]) if found else 0


def test_who_reads_may_be_ended_between_two_readings(
    three: tuple[Examiners, dict[str, Path], dict[str, Path]],
) -> None:
    """The kernel ends who reads and has nothing to do: the reading that follows is told, or done, and no
    later one has the answer of another."""
    readers, paths, uploads = three
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    ended = who_reads(reader)
    os.kill(ended, signal.SIGKILL)
    until(lambda: who_reads(reader) not in (0, ended))
    time.sleep(0.5)
    assert readers.examine(paths["first"], uploads).name in ("first", "")
    for name in ("second", "third", "first"):
        assert readers.examine(paths[name], uploads).name == name


def test_drake_is_asked_for_again_and_again_while_it_is_loaded(
    three: tuple[Examiners, dict[str, Path], dict[str, Path]],
) -> None:
    """By readings with reach that are broken off, one by one: imports within imports failed, and with
    them the process, and what it read."""
    readers, paths, uploads = three
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    for _ in range(60):
        reader._process.send_signal(signal.SIGUSR1)
        time.sleep(0.02)
    found = readers.examine(paths["second"], uploads, True)
    assert found.name == "second" and found.looked_at is not None
    assert reader.alive and readers._all == {reader}  # it is the same one


@pytest.mark.parametrize("begun", [False, True])
def test_a_reader_that_crashes_in_the_moment_it_is_broken_off(
    three: tuple[Examiners, dict[str, Path], dict[str, Path]], monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    """The one that takes its place is ended for it, before or after it said that it begins: what follows has
    its own answer, at once."""
    readers, paths, uploads = three
    large = paths["first"].with_name("large.yaml")
    large.write_text("tandem: 1\na: [" + "x, " * 400_000 + "x]")
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    reading = Reading()
    line = Reader._line

    def crash(self: Reader) -> str:
        monkeypatch.setattr(Reader, "_line", line)
        ended = who_reads(self)
        os.kill(ended, signal.SIGKILL)
        if begun:
            until(lambda: who_reads(self) not in (0, ended))
            time.sleep(0.5)
        reading.break_off()
        return line(self)

    monkeypatch.setattr(Reader, "_line", crash)
    with pytest.raises(RefusedError) as caught:
        readers.examine(large, {}, reading=reading)
    assert caught.value.status == 499
    for name in ("third", "first", "second"):
        assert readers.examine(paths[name], uploads).name == name
    assert readers._all == {reader} and reader.alive
