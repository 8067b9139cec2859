"""Metrics for Prometheus: what they count, read by Prometheus's own parser, and who may read them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import update

from planner.service import metrics
from planner.service.jobs import Jobs
from planner.service.models import JOBS
from planner.service.security import ServiceLimits
from tests.service.support import InProcess, named_problem, wait_until


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    data = tmp_path_factory.mktemp("figures") / "data"
    with InProcess(data, ServiceLimits(open_jobs=50), examiners=1) as made:
        yield made


Figures = dict[tuple[str, tuple[str, ...]], float]


def read_figures(running_service: InProcess) -> Figures:
    """Values by name and labels, in the order of their names."""
    answer = running_service.http.get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return {
        (sample.name, tuple(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }


def increase(previous: Figures, current: Figures, name: str, *labels: str) -> float:
    return current.get((name, labels), 0.0) - previous.get((name, labels), 0.0)


def test_requests_by_route_and_status(running_service: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    before = read_figures(running_service)
    running_service.http.get(f"/v1/jobs/{'0' * 32}")
    running_service.http.get("/v1/jobs/x%22%7D%0Aevil")
    running_service.http.head("/v1/health")
    running_service.http.get("/no/such/address")
    running_service.http.request("BREW", "/v1/jobs")
    running_service.http.get("/v1/health", headers={"Host": "other.example"})
    monkeypatch.setattr(Jobs, "page", lambda *asked: 1 / 0)
    running_service.http.get("/v1/jobs")
    after = read_figures(running_service)
    total, seconds = "tandem_http_requests_total", "tandem_http_request_duration_seconds_count"
    assert increase(before, after, total, "GET", "/v1/jobs/{job}", "404") == 2
    assert increase(before, after, seconds, "GET", "/v1/jobs/{job}") == 2
    assert increase(before, after, total, "HEAD", "/v1/health", "200") == 1
    assert increase(before, after, total, "GET", "none", "404") == 1
    assert (
        increase(before, after, total, "other", "/v1/jobs", "405")
        + increase(before, after, total, "other", "none", "405")
        == 1
    )
    assert increase(before, after, total, "GET", "none", "403") == 1
    assert increase(before, after, total, "GET", "/v1/jobs", "500") == 1
    assert "evil" not in running_service.http.get("/metrics").text


def test_outcomes_stay_when_jobs_are_deleted(running_service: InProcess) -> None:
    before = read_figures(running_service)
    job = running_service.post(named_problem("counted")).json()["id"]
    running_service.wait_for_end(job)
    again = running_service.post(named_problem("counted")).json()["id"]
    running_service.team.hold.set()
    waits = running_service.post(named_problem("waits")).json()["id"]  # its worker holds it
    wait_until(lambda: running_service.http.get(f"/v1/jobs/{waits}").json()["state"] == "running")
    queued = running_service.post(named_problem("queued")).json()["id"]
    running_service.http.post(f"/v1/jobs/{queued}/cancel")
    running_service.http.post(f"/v1/jobs/{queued}/cancel")
    running_service.http.post(f"/v1/jobs/{waits}/cancel")
    running_service.wait_for_end(waits)
    running_service.team.hold.clear()
    outcomes = "tandem_job_outcomes_total"
    counted = {("planned", "verified"): 1, ("store", "verified"): 1, ("planned", "cancelled"): 2}
    wait_until(lambda: increase(before, read_figures(running_service), outcomes, "planned", "cancelled") == 2)
    for item in (job, again, waits, queued):
        running_service.http.delete(f"/v1/jobs/{item}")
    after = read_figures(running_service)
    assert after[("tandem_jobs", ("verified",))] == 0
    assert {labels: increase(before, after, outcomes, *labels) for labels in counted} == counted
    assert increase(before, after, "tandem_job_stage_duration_seconds_count", "motion") == 2
    assert increase(before, after, "tandem_job_wait_seconds_count") == 2


def test_the_age_of_the_queue_over_clocks_that_jump(running_service: InProcess) -> None:
    assert read_figures(running_service)[("tandem_queue_age_seconds", ())] == 0
    running_service.team.hold.set()
    held = running_service.post(named_problem("held")).json()["id"]
    wait_until(lambda: running_service.http.get(f"/v1/jobs/{held}").json()["state"] == "running")
    job = running_service.post(named_problem("old")).json()["id"]

    def age(seconds: float) -> float:
        with running_service.service.database.write() as db:
            db.execute(update(JOBS).where(JOBS.c.id == job).values(created=time.time() - seconds))
        return read_figures(running_service)[("tandem_queue_age_seconds", ())]

    assert age(1000.0) == pytest.approx(1000.0, abs=60.0)
    assert age(-1000.0) == 0
    metrics.observe_wait(-5.0)
    metrics.observe_stage("a user's <word>", -1.0)
    assert ("tandem_job_stage_duration_seconds_count", ("other",)) in read_figures(running_service)
    running_service.team.hold.clear()
    for item in (held, job):
        running_service.wait_for_end(item)


def test_without_the_library_the_service_says_what_to_install(tmp_path: Path) -> None:
    import subprocess
    import sys

    code = "import sys; sys.modules['prometheus_client'] = None\nfrom planner.cli.command_line import app\n"
    code += f"sys.exit(app.cli(args=['serve', '--data', {str(tmp_path / 'data')!r}]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    said = " ".join((done.stdout + done.stderr).split())
    assert "service.install" in said
    assert "tandem-planner[service]" in said
