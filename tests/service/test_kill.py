"""``kill -9`` of the whole service at seeded moments, on both databases: what was accepted is planned, and
whole."""

from __future__ import annotations

import contextlib
import random
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import planner
from planner import Client
from planner.issues import TandemError
from planner.problem import Problem
from tests import small_problem
from tests.service import postgres
from tests.service.support import Process, named, until


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return "" if request.param == "sqlite" else postgres.fresh(tmp_path)


def problems(folder: Path, count: int, name: str = "job") -> Iterator[Problem]:
    for number in range(count):
        (folder / str(number)).mkdir()
        yield planner.load(small_problem.write(folder / str(number), named(f"{name}{number}")))


def ended(client: Client, jobs: list[str], timeout_s: float) -> list[dict[str, object]]:
    ending = time.monotonic() + timeout_s
    while time.monotonic() < ending:
        found = [client.job(job) for job in jobs]
        if all(job["state"] not in ("queued", "running") for job in found):
            return found
        time.sleep(0.1)
    raise TimeoutError(str(Counter(job["state"] for job in found)))


@pytest.mark.sampled(every=2)
def test_jobs_survive_kills_while_they_come_in_and_are_planned(tmp_path: Path, database: str) -> None:
    """Two threads send jobs all the while; one that was told of a job finds it in the end."""
    data, moments, accepted = tmp_path / "data", random.Random(11), []
    wanted = list(problems(tmp_path, 12))

    def start(port: int, *most: str) -> Process:
        arguments = (str(data), database, *most)
        return Process(data, port=port, module="tests.service.pretend", arguments=arguments)

    most = moments.randint(1, 6)  # so many end, and what is begun then runs until the kill
    process = start(0, str(most)).wait()
    client = Client(process.url)
    client.check(wanted[0], reach=False)  # the reader has started

    def send(problem: Problem) -> None:
        ending = time.monotonic() + 240.0
        while time.monotonic() < ending:
            with contextlib.suppress(TandemError):  # it is down
                accepted.append(client.submit(problem))
                return
            time.sleep(0.1)

    with ThreadPoolExecutor(2) as pool:
        sent = [pool.submit(send, problem) for problem in wanted]
        until((tmp_path / "held").exists)
        time.sleep(moments.uniform(0.0, 0.3))
        process.kill()
        process = start(process.port).wait()
    for one in sent:
        one.result()
    found = ended(client, accepted, 240.0)
    assert len(accepted) == len(wanted)
    assert {job["state"] for job in found} == {"verified"}
    assert max(int(str(job["attempts"])) for job in found) >= 2  # a kill met a job that ran
    for job in accepted:
        files = client.files(job)
        assert files["programs/main.mod"] == b"MODULE main"
        assert b"name: job" in files["problem/problem.yaml"]
    process.stop()
    assert list((data / "work").iterdir()) == []


@pytest.mark.long
def test_real_plans_survive_kills(tmp_path: Path, database: str) -> None:
    data, moments = tmp_path / "data", random.Random(12)
    more = ("--database", database, "--lease-s", "3") if database else ()
    process = Process(data, *more).wait()
    client = Client(process.url)
    wanted = list(problems(tmp_path, 4))
    jobs = [client.submit(problem) for problem in wanted]
    for kill in range(3):
        time.sleep(moments.uniform(0.0, 12.0))
        if kill == 2:  # where plans take long, a job that two kills have met would be given up by a third
            ended(client, [job for job in jobs if int(client.job(job)["attempts"]) >= 2], 300.0)
        process.kill()
        process = Process(data, *more, port=process.port).wait()
    found = ended(client, jobs, 300.0)
    assert {job["state"] for job in found} == {"verified"}
    for job, problem in zip(jobs, wanted, strict=True):
        there, here = client.outcome(client.job(job), problem), planner.plan(problem)
        assert dict(there.programs) == dict(here.programs)
    process.stop()
