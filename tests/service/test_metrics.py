"""Figures for Prometheus: what they count, read by Prometheus's own parser, and who may read them."""

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
from planner.service.security import Limits
from tests.service.support import InProcess, named, until


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    data = tmp_path_factory.mktemp("figures") / "data"
    with InProcess(data, Limits(open_jobs=50), examiners=1) as made:
        yield made


Figures = dict[tuple[str, tuple[str, ...]], float]


def figures(here: InProcess) -> Figures:
    """Values by name and labels, in the order of their names."""
    answer = here.http.get("/metrics")
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    return {
        (one.name, tuple(one.labels.values())): one.value
        for family in text_string_to_metric_families(answer.text)
        for one in family.samples
    }


def more(before: Figures, after: Figures, name: str, *labels: str) -> float:
    return after.get((name, labels), 0.0) - before.get((name, labels), 0.0)


def test_requests_by_route_and_status(here: InProcess, monkeypatch: pytest.MonkeyPatch) -> None:
    before = figures(here)
    here.http.get(f"/v1/jobs/{'0' * 32}")
    here.http.get("/v1/jobs/x%22%7D%0Aevil")
    here.http.head("/v1/health")
    here.http.get("/no/such/address")
    here.http.request("BREW", "/v1/jobs")
    here.http.get("/v1/health", headers={"Host": "other.example"})
    monkeypatch.setattr(Jobs, "page", lambda *asked: 1 / 0)
    here.http.get("/v1/jobs")
    after = figures(here)
    total, seconds = "tandem_http_requests_total", "tandem_http_request_duration_seconds_count"
    assert more(before, after, total, "GET", "/v1/jobs/{job}", "404") == 2
    assert more(before, after, seconds, "GET", "/v1/jobs/{job}") == 2
    assert more(before, after, total, "HEAD", "/v1/health", "200") == 1
    assert more(before, after, total, "GET", "none", "404") == 1
    assert (
        more(before, after, total, "other", "/v1/jobs", "405")
        + more(before, after, total, "other", "none", "405")
        == 1
    )
    assert more(before, after, total, "GET", "none", "403") == 1
    assert more(before, after, total, "GET", "/v1/jobs", "500") == 1
    assert "evil" not in here.http.get("/metrics").text


def test_outcomes_stay_when_jobs_are_deleted(here: InProcess) -> None:
    before = figures(here)
    job = here.post(named("counted")).json()["id"]
    here.ended(job)
    again = here.post(named("counted")).json()["id"]
    here.team.hold.set()
    waits = here.post(named("waits")).json()["id"]  # its worker holds it
    until(lambda: here.http.get(f"/v1/jobs/{waits}").json()["state"] == "running")
    queued = here.post(named("queued")).json()["id"]
    here.http.post(f"/v1/jobs/{queued}/cancel")
    here.http.post(f"/v1/jobs/{queued}/cancel")
    here.http.post(f"/v1/jobs/{waits}/cancel")
    here.ended(waits)
    here.team.hold.clear()
    outcomes = "tandem_job_outcomes_total"
    counted = {("planned", "verified"): 1, ("store", "verified"): 1, ("planned", "cancelled"): 2}
    until(lambda: more(before, figures(here), outcomes, "planned", "cancelled") == 2)
    for one in (job, again, waits, queued):
        here.http.delete(f"/v1/jobs/{one}")
    after = figures(here)
    assert after[("tandem_jobs", ("verified",))] == 0
    assert {labels: more(before, after, outcomes, *labels) for labels in counted} == counted
    assert more(before, after, "tandem_job_stage_duration_seconds_count", "motion") == 2
    assert more(before, after, "tandem_job_wait_seconds_count") == 2


def test_the_age_of_the_queue_over_clocks_that_jump(here: InProcess) -> None:
    assert figures(here)[("tandem_queue_age_seconds", ())] == 0
    here.team.hold.set()
    held = here.post(named("held")).json()["id"]
    until(lambda: here.http.get(f"/v1/jobs/{held}").json()["state"] == "running")
    job = here.post(named("old")).json()["id"]

    def age(seconds: float) -> float:
        with here.service.database.write() as db:
            db.execute(update(JOBS).where(JOBS.c.id == job).values(created=time.time() - seconds))
        return figures(here)[("tandem_queue_age_seconds", ())]

    assert age(1000.0) == pytest.approx(1000.0, abs=60.0)
    assert age(-1000.0) == 0
    metrics.waited(-5.0)
    metrics.staged("a user's <word>", -1.0)
    assert ("tandem_job_stage_duration_seconds_count", ("other",)) in figures(here)
    here.team.hold.clear()
    for one in (held, job):
        here.ended(one)


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
