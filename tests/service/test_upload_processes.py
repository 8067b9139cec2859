"""Reader processes of uploads: owners take turns, queues are limited, and closed connections are dropped."""

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

from planner.service.models import Database, default_url
from planner.service.reading_result import ReadingOptions, ReadingResult
from planner.service.security import Auth, RefusedError, ServiceLimits
from planner.service.upload_processes import ReaderPool, UploadReader, UploadReading, connection_closed
from tests import small_problem
from tests.service.support import InProcess, issue_codes, named_problem, wait_until

READINGS = 4
PATHS = ("/ui/preview", "/v1/check", "/v1/jobs")


class HeldReader:
    """A stand-in for the readers: counts concurrent readings, which last until they are released."""

    def __init__(self) -> None:
        self.go, self.lock = threading.Event(), threading.Lock()
        self.running = self.max_running = 0

    def __call__(self, *arguments: Any) -> ReadingResult:
        with self.lock:
            self.running += 1
            self.max_running = max(self.max_running, self.running)
        self.go.wait(60)
        with self.lock:
            self.running -= 1
        return ReadingResult((), name="small", digest="0", text="tandem: 1")


@pytest.fixture
def shared_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[InProcess, HeldReader, str, str]]:
    """A service with three readers that are held, and two tokens."""
    data = tmp_path / "data"
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = auth.create_token("ann"), auth.create_token("bob")
    held = HeldReader()
    monkeypatch.setattr(ReaderPool, "examine", lambda self, *asked: held(*asked))
    limits = ServiceLimits(readings=READINGS)
    with InProcess(data, limits, examiners=3, require_token=True) as running_service:
        yield running_service, held, *tokens
        held.go.set()


@pytest.mark.parametrize("path", PATHS)
def test_one_token_never_keeps_all_readers(
    shared_service: tuple[InProcess, HeldReader, str, str], path: str
) -> None:
    running_service, held, ann, bob = shared_service
    with ThreadPoolExecutor(8) as pool:
        futures = [
            pool.submit(
                running_service.post, named_problem(f"a{k}"), path, headers={"Authorization": f"Bearer {ann}"}
            )
            for k in range(READINGS)
        ]
        wait_until(lambda: held.running == 2)
        other = pool.submit(
            running_service.post, named_problem("b"), path, headers={"Authorization": f"Bearer {bob}"}
        )
        wait_until(lambda: held.running == 3)
        more = running_service.post(named_problem("more"), path, headers={"Authorization": f"Bearer {ann}"})
        assert more.status_code == 429 and int(more.headers["retry-after"]) > 0
        assert issue_codes(more) == [("service.too_many", None)]
        held.go.set()
        assert {item.result().status_code for item in [*futures, other]} <= {200, 201}
        assert held.max_running == 3
    assert (
        running_service.post(
            named_problem("later"), path, headers={"Authorization": f"Bearer {ann}"}
        ).status_code
        < 400
    )


def test_long_readings_take_turns_with_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each owner waits for one problem of the others, not for their batches.

    One reader; two owners send batches, one sweeps a field, one checks. A second batch of an owner waits for
    the first.
    """
    data, first, order = tmp_path / "data", threading.Event(), list[str]()
    data.mkdir()
    auth = Auth(Database(default_url(data)))
    tokens = {name: auth.create_token(name) for name in ("ann", "bob", "cyd", "dan")}

    def read(
        self: ReaderPool, problem: Path, uploads: Any, options: ReadingOptions, reading: Any
    ) -> ReadingResult:
        text = problem.read_text()
        (name,) = re.findall("^name: (.*)", text, re.M)
        fields = options.fields
        order.append(name if fields is None else f"{name}-{fields['operations.0.feed_mm_s']}")
        first.wait(60)
        return ReadingResult((), name=name, digest=order[-1], text=text)

    monkeypatch.setattr(ReaderPool, "examine", read)

    def send(who: str, path: str, *names: str, **parameters: Any) -> Any:
        files = [("problem", (f"{name}.yaml", named_problem(name))) for name in names]
        headers = {"Authorization": f"Bearer {tokens[who]}"}
        answer = running_service.http.post(path, files=files, params=parameters, headers=headers)
        return answer.status_code, [job["name"] for job in answer.json().get("jobs", ())]

    with InProcess(data, examiners=1, require_token=True) as running_service, ThreadPoolExecutor(5) as pool:
        futures = [pool.submit(send, "ann", "/v1/batches", "a0", "a1", "a2")]
        wait_until(lambda: order, 20)
        swept = {"field": "operations.0.feed_mm_s", "value": ["1", "2"]}
        for who, path, names, more in (
            ("bob", "/v1/batches", ("b0", "b1"), {}),
            ("cyd", "/v1/sweeps", ("c",), swept),
            ("dan", "/v1/check", ("d",), {}),
        ):
            waiting = len(futures)
            futures.append(pool.submit(send, who, path, *names, **more))
            wait_until(lambda now=waiting: running_service.service._readers.statistics().tasks_waiting == now)  # type: ignore[misc]
        futures.append(pool.submit(send, "ann", "/v1/batches", "z0", "z1"))
        wait_until(lambda: sum(running_service.service._waiting.values()) == 5)
        time.sleep(0.2)
        first.set()
        answers = [item.result() for item in futures]
    assert answers[0] == (201, ["a0", "a1", "a2"]) and answers[1] == (201, ["b0", "b1"])
    assert answers[2] == (201, ["c", "c"]) and answers[3][0] == 200 and answers[4] == (201, ["z0", "z1"])
    assert order[:4] == ["a0", "b0", "c-1", "d"]
    assert order.index("b1") < order.index("a2") and order.index("c-2") < order.index("a2")
    assert order.index("z1") > order.index("a2")


def test_a_closed_connection_ends_its_reading_and_its_waiting(tmp_path: Path) -> None:
    """Two requests of the machine's own user at one reader: one reads, one waits; both hang up."""
    begun: list[UploadReading] = []

    def read(reading: UploadReading) -> None:
        begun.append(reading)
        wait_until(lambda: reading.cancelled)
        raise connection_closed()

    async def hang_up() -> None:
        async def receive() -> dict[str, str]:
            while not begun:
                await anyio.sleep(0.01)
            await anyio.sleep(0.05)
            return {"type": "http.disconnect"}

        request = Request({"type": "http", "method": "POST", "headers": []}, receive)
        with pytest.raises(RefusedError) as caught:
            await running_service.service.run_in_turn(request, "local", read)
        assert caught.value.status == 499

    async def both() -> None:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(hang_up)
            tasks.start_soon(hang_up)

    # in a thread: the pages' browser keeps a loop of its own running in this one
    with InProcess(tmp_path / "data", examiners=1) as running_service, ThreadPoolExecutor(1) as pool:
        pool.submit(anyio.run, both).result()
    assert len(begun) == 1 and begun[0].cancelled


def test_who_reads_next_is_ready_after_a_reading_was_broken_off(tmp_path: Path) -> None:
    """Ten checks of reach are broken off at different moments; each time the next one is answered, and
    the process that has loaded Drake stays."""
    small = small_problem.write(tmp_path)
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    readers = ReaderPool(1, tmp_path, 60.0, 4096.0, 1000)
    try:
        assert readers.examine(small, uploads, ReadingOptions(reach=True, targets=2)).looked_at is not None
        (reader,) = readers._all
        for k in range(10):
            reading = UploadReading()
            with ThreadPoolExecutor(1) as pool:
                future = pool.submit(
                    readers.examine, small, uploads, ReadingOptions(reach=True), reading=reading
                )
                time.sleep(0.01 * k)
                reading.cancel()
                try:
                    future.result(30)  # it may have been quicker
                except RefusedError as error:
                    assert error.status == 499
            assert readers.examine(small, uploads).readable
        assert readers._all == {reader} and reader.alive
        assert readers.examine(small, uploads, ReadingOptions(reach=True, targets=2)).looked_at is not None
    finally:
        readers.close()


def test_a_reading_that_is_broken_off_costs_its_process_alone(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    large.write_text("tandem: 1\na: [" + "x, " * 400_000 + "x]")
    small = small_problem.write(tmp_path)
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    readers = ReaderPool(1, tmp_path, 60.0, 4096.0, 1000)
    reading = UploadReading()
    try:
        assert readers.examine(small, uploads).readable
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(readers.examine, large, {}, reading=reading)
            time.sleep(0.2)
            reading.cancel()
            with pytest.raises(RefusedError) as caught:
                future.result(30)
        assert caught.value.status == 499
        assert readers.examine(small, uploads).readable
    finally:
        readers.close()


class Late(UploadReading):
    """Upload that is cancelled as soon as its reader is known, and asks the reader after a delay."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds

    def set_reader(self, reader: UploadReader | None) -> bool:
        wanted = super().set_reader(reader)
        if reader is not None:
            self.cancel()
            time.sleep(self.seconds)
        return wanted


class Early(UploadReading):
    """Upload that is cancelled a delay after its reader can be notified, before the reader starts."""

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self.seconds = seconds

    def set_reader(self, reader: UploadReader | None) -> bool:
        if reader is not None:
            threading.Thread(target=self.end, args=(reader._process.pid,)).start()
        return super().set_reader(reader)

    def end(self, pid: int) -> None:
        caught = re.compile(r"^SigCgt:\s*(\w+)", re.M)

        def hears() -> bool:
            result = caught.search(Path(f"/proc/{pid}/status").read_text())
            return result is not None and bool(int(result[1], 16) & 1 << (signal.SIGUSR2 - 1))

        wait_until(hears)
        time.sleep(self.seconds)
        self.cancel()


@pytest.fixture
def three_readers(tmp_path: Path) -> Iterator[tuple[ReaderPool, dict[str, Path], dict[str, Path]]]:
    """One reader, and three problems by their names with the files of all."""
    uploads = {"targets.csv": tmp_path / "targets.csv"}
    paths = {}
    for name in ("first", "second", "third"):
        (tmp_path / name).mkdir()
        paths[name] = small_problem.write(tmp_path / name, named_problem(name))
        shutil.copy(tmp_path / name / "targets.csv", tmp_path)
    readers = ReaderPool(1, tmp_path, 60.0, 4096.0, 1000)
    yield readers, paths, uploads
    readers.close()


def test_what_was_broken_off_is_no_answer_to_what_is_asked_next(
    three_readers: tuple[ReaderPool, dict[str, Path], dict[str, Path]],
) -> None:
    """The next reading was answered by the result of a broken one.

    The reading is broken off, and the replacement of its reader exists, before it is written, as under load.
    """
    readers, paths, uploads = three_readers
    assert readers.examine(paths["first"], uploads).name == "first"
    with pytest.raises(RefusedError) as caught:
        readers.examine(paths["second"], uploads, reading=Late(1.0))
    assert caught.value.status == 499
    for name in ("third", "first"):
        assert readers.examine(paths[name], uploads).name == name


@pytest.mark.parametrize("seconds", [0.0, 0.004])
def test_a_reading_that_is_broken_off_while_its_process_begins_costs_nobody_a_reader(
    three_readers: tuple[ReaderPool, dict[str, Path], dict[str, Path]], seconds: float
) -> None:
    """A process that was ended before it reported its start was awaited for ever."""
    readers, paths, uploads = three_readers
    reading, pool = Early(seconds), ThreadPoolExecutor(1)
    future = pool.submit(readers.examine, paths["first"], uploads, reading=reading)
    wait_until(lambda: reading.cancelled)
    try:
        assert future.result(60).name == "first"  # it was quicker
    except RefusedError as error:
        assert error.status == 499
    assert pool.submit(readers.examine, paths["second"], uploads).result(60).name == "second"


def who_reads(reader: UploadReader) -> int:
    """The process that reads: the child of the one that forks it; 0 while there is none."""
    result = Path(f"/proc/{reader._process.pid}/task/{reader._process.pid}/children").read_text().split()
    return int(result[0]) if result else 0


def test_who_reads_may_be_ended_between_two_readings(
    three_readers: tuple[ReaderPool, dict[str, Path], dict[str, Path]],
) -> None:
    """The kernel ends an idle reader: the next reading is refused or done.

    No later reading gets the answer of another.
    """
    readers, paths, uploads = three_readers
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    ended = who_reads(reader)
    os.kill(ended, signal.SIGKILL)
    wait_until(lambda: who_reads(reader) not in (0, ended))
    time.sleep(0.5)
    assert readers.examine(paths["first"], uploads).name in ("first", "")
    for name in ("second", "third", "first"):
        assert readers.examine(paths[name], uploads).name == name


def test_drake_is_asked_for_again_and_again_while_it_is_loaded(
    three_readers: tuple[ReaderPool, dict[str, Path], dict[str, Path]],
) -> None:
    """Readings with reach are broken off one by one during the import of Drake.

    Nested imports failed, and with them the process and its reading.
    """
    readers, paths, uploads = three_readers
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    for _ in range(60):
        reader._process.send_signal(signal.SIGUSR1)
        time.sleep(0.02)
    result = readers.examine(paths["second"], uploads, ReadingOptions(reach=True))
    assert result.name == "second" and result.looked_at is not None
    assert reader.alive and readers._all == {reader}  # it is the same one


@pytest.mark.parametrize("begun", [False, True])
def test_a_reader_that_crashes_in_the_moment_it_is_broken_off(
    three_readers: tuple[ReaderPool, dict[str, Path], dict[str, Path]],
    monkeypatch: pytest.MonkeyPatch,
    begun: bool,
) -> None:
    """Its replacement is ended instead, before or after it reports its start.

    The next reading gets its own answer at once.
    """
    readers, paths, uploads = three_readers
    large = paths["first"].with_name("large.yaml")
    large.write_text("tandem: 1\na: [" + "x, " * 400_000 + "x]")
    assert readers.examine(paths["first"], uploads).name == "first"
    (reader,) = readers._all
    reading = UploadReading()
    line = UploadReader._read_line

    def crash(self: UploadReader) -> str:
        monkeypatch.setattr(UploadReader, "_read_line", line)
        ended = who_reads(self)
        os.kill(ended, signal.SIGKILL)
        if begun:
            wait_until(lambda: who_reads(self) not in (0, ended))
            time.sleep(0.5)
        reading.cancel()
        return line(self)

    monkeypatch.setattr(UploadReader, "_read_line", crash)
    with pytest.raises(RefusedError) as caught:
        readers.examine(large, {}, reading=reading)
    assert caught.value.status == 499
    for name in ("third", "first", "second"):
        assert readers.examine(paths[name], uploads).name == name
    assert readers._all == {reader} and reader.alive
