"""``kill -9`` of the whole service at seeded moments, on both databases: accepted jobs are still planned.

Their results are complete.
"""

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
from tests.service.support import Process, named_problem, wait_until


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return "" if request.param == "sqlite" else postgres.fresh(tmp_path)


def problems(folder: Path, count: int, name: str = "job") -> Iterator[Problem]:
    for number in range(count):
        (folder / str(number)).mkdir()
        yield planner.load(small_problem.write(folder / str(number), named_problem(f"{name}{number}")))


def wait_for_jobs(client: Client, jobs: list[str], timeout_s: float) -> list[dict[str, object]]:
    ending = time.monotonic() + timeout_s
    while time.monotonic() < ending:
        result = [client.job(job) for job in jobs]
        if all(job["state"] not in ("queued", "running") for job in result):
            return result
        time.sleep(0.1)
    raise TimeoutError(str(Counter(job["state"] for job in result)))


@pytest.mark.sampled(every=2)
def test_jobs_survive_kills_while_they_come_in_and_are_planned(tmp_path: Path, database: str) -> None:
    """Two threads send jobs continuously; each acknowledged job exists in the end."""
    data, moments, accepted = tmp_path / "data", random.Random(11), []
    expected = list(problems(tmp_path, 12))

    def start(port: int, *extra_arguments: str) -> Process:
        arguments = (str(data), database, *extra_arguments)
        return Process(data, port=port, module="tests.service.fake_team", arguments=arguments)

    most = moments.randint(1, 6)  # so many end, and what is begun then runs until the kill
    process = start(0, str(most)).wait()
    client = Client(process.url)
    client.check(expected[0], reach=False)  # the reader has started

    def send(problem: Problem) -> None:
        ending = time.monotonic() + 240.0
        while time.monotonic() < ending:
            with contextlib.suppress(TandemError):  # it is down
                accepted.append(client.submit(problem))
                return
            time.sleep(0.1)

    with ThreadPoolExecutor(2) as pool:
        sent = [pool.submit(send, problem) for problem in expected]
        wait_until((tmp_path / "held").exists)
        time.sleep(moments.uniform(0.0, 0.3))
        process.kill()
        process = start(process.port).wait()
    for item in sent:
        item.result()
    result = wait_for_jobs(client, accepted, 240.0)
    assert len(accepted) == len(expected)
    assert {job["state"] for job in result} == {"verified"}
    assert max(int(str(job["attempts"])) for job in result) >= 2  # a kill met a job that ran
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
    expected = list(problems(tmp_path, 4))
    jobs = [client.submit(problem) for problem in expected]
    for kill in range(3):
        time.sleep(moments.uniform(0.0, 12.0))
        if kill == 2:  # where plans take long, a job that two kills have met would be given up by a third
            wait_for_jobs(client, [job for job in jobs if int(client.job(job)["attempts"]) >= 2], 300.0)
        process.kill()
        process = Process(data, *more, port=process.port).wait()
    result = wait_for_jobs(client, jobs, 300.0)
    assert {job["state"] for job in result} == {"verified"}
    for job, problem in zip(jobs, expected, strict=True):
        service_outcome, local_outcome = client.outcome(client.job(job), problem), planner.plan(problem)
        assert dict(service_outcome.programs) == dict(local_outcome.programs)
    process.stop()
