"""The order of the queue, sweeps of a field, and the remaining time of a job estimated from similar jobs."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import insert, update

from planner.service.jobs import Jobs, NewJob
from planner.service.models import EVENTS, JOBS
from planner.service.runner import JobQueue
from planner.service.security import ServiceLimits
from planner.service.storage import Blob
from tests import small_problem
from tests.service import postgres
from tests.service.support import TABLE, InProcess, issue_codes, named_problem
from tests.service.test_finding import put
from tests.service.test_roles import Shop, open_service


@pytest.fixture(params=["sqlite", "postgresql"])
def shop(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Shop]:
    """A service whose one worker has a job of dan, so that all others wait."""
    database = postgres.fresh(tmp_path) if request.param == "postgresql" else None
    with open_service(tmp_path / "data", database) as running_service:
        running_service.team.hold.set()
        running_service.service.runner.stop()
        yield Shop(running_service)


def order(shop: Shop, by: str = "ann") -> list[tuple[str, int]]:
    found = shop.ask(by, "GET", "/v1/jobs?state=queued&sort=turn").json()["jobs"]
    return [(item["name"], item["ahead"]) for item in found]


def claim_all(shop: Shop) -> list[str]:
    """The names of jobs in the order in which they are taken, each ended before the next."""
    work, out = JobQueue(shop.running_service.service.database, "other", 60.0), []
    while (job := work.claim()) is not None:
        out.append(job.name)
        work.finish(job, "infeasible", (), {}, 1.0, {})
    return out


def test_a_job_comes_first_among_those_of_its_owner_alone(shop: Shop) -> None:
    ids = {name: put(shop, owner, name) for owner, name in
           (("ann", "a1"), ("eve", "e1"), ("ann", "a2"), ("eve", "e2"), ("ann", "a3"))}  # fmt: skip
    assert order(shop) == [("a1", 0), ("a2", 2), ("a3", 4)]
    moved = shop.ask("bob", "POST", f"/v1/jobs/{ids['a3']}/first")  # of the same team
    assert (moved.status_code, moved.json()["ahead"]) == (200, 0)
    assert order(shop) == [("a3", 0), ("a1", 2), ("a2", 4)]
    assert order(shop, "eve") == [("e1", 1), ("e2", 3)]  # no place of another is taken
    assert shop.ask("eve", "POST", f"/v1/jobs/{ids['a2']}/first").status_code == 404
    assert shop.ask("lea", "POST", f"/v1/jobs/{ids['a2']}/first").status_code == 403
    one = shop.ask("ann", "GET", "/v1/jobs?state=queued&sort=turn&limit=1").json()
    rest = shop.ask("ann", "GET", f"/v1/jobs?state=queued&sort=turn&cursor={one['next']}").json()["jobs"]
    assert [job["name"] for job in (*one["jobs"], *rest)] == ["a3", "a1", "a2"]
    assert claim_all(shop) == ["a3", "e1", "a1", "e2", "a2"]
    late = shop.ask("ann", "POST", f"/v1/jobs/{ids['a2']}/first")
    assert (late.status_code, issue_codes(late)) == (409, [("service.state", "state")])


def test_many_who_come_first_at_once_lose_no_turn(shop: Shop) -> None:
    ids = [put(shop, "ann", f"j{n}") for n in range(6)]
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda one: shop.ask("ann", "POST", f"/v1/jobs/{one}/first"), ids))
    assert {one.status_code for one in answers} == {200}
    result = order(shop)
    assert [ahead for _, ahead in result] == list(range(6))
    assert claim_all(shop) == [name for name, _ in result]


def post_sweep(running_service: InProcess, query: dict[str, Any], **more: Any) -> Any:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", TABLE))]
    return running_service.http.post("/v1/sweeps", params=query, files=files, **more)


def test_a_sweep_makes_a_job_of_each_value_or_none(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        query = {"field": "operations.0.feed_mm_s", "value": ["20", "30.5", "40"], "tag": "Vorschub"}
        key = {"Idempotency-Key": "sweep-1"}
        made, again = (
            post_sweep(running_service, query, headers=key),
            post_sweep(running_service, query, headers=key),
        )
        assert made.status_code == 201, made.text
        jobs = made.json()["jobs"]
        assert [item["id"] for item in again.json()["jobs"]] == [item["id"] for item in jobs]
        assert [item["title"].rpartition(": ")[2] for item in jobs] == [
            f"operations.0.feed_mm_s = {v}" for v in ("20", "30.5", "40")
        ]
        assert len({item["digest"] for item in jobs}) == 3
        text = running_service.http.get(f"/v1/jobs/{jobs[1]['id']}/files/problem/problem.yaml").text
        assert "feed_mm_s: 30.5" in text
        found = running_service.http.get("/v1/jobs", params={"tag": "vorschub"}).json()["jobs"]
        assert {item["id"] for item in found} == {item["id"] for item in jobs}
        for bad, field in (
            ({"value": ["20", "-1"]}, "operations.0.feed_mm_s"),
            ({"value": ["20", "1e999"]}, "operations.0.feed_mm_s"),
            ({"value": ["20", "20"]}, "value"),
            ({"field": "operations.7.feed_mm_s"}, "operations.7.feed_mm_s"),
            ({"field": "operations..x"}, "operations..x"),
            ({"field": "nothing.such"}, "nothing"),
            ({"field": "operations.0.file", "value": ["../../../etc/passwd"]}, None),
            ({"value": [str(n) for n in range(51)]}, "value"),
            ({"tag": "a\u202eb"}, "tag"),
            ({"field": "W" * 10_000}, "field"),
            ({"field": "cell.name\u202e"}, "field"),
            ({"field": "cell.name", "value": ["z\0y"]}, "value.0"),
            ({"field": "cell.name", "value": ["q\x1fapproved\x1f"]}, "value.0"),
            ({"field": "cell.name", "value": ["a\u2028b", "a"]}, "value.0"),
            ({"field": "operations.\u00b2.feed_mm_s"}, None),
        ):
            refused = post_sweep(running_service, {**query, **bad})
            assert refused.status_code == 422, (bad, refused.text)
            assert "passwd" not in refused.text or "not uploaded" in refused.text.replace("_", " ")
            assert field is None or field in [item[1] for item in issue_codes(refused)], (bad, refused.text)
        wrong = post_sweep(running_service, {**query, "value": ["20", "-1"]})
        assert wrong.json()["issues"][0]["message"].startswith("operations.0.feed_mm_s = -1: ")
        assert len(running_service.http.get("/v1/jobs?limit=200").json()["jobs"]) == 3


def test_several_problems_make_a_job_each_or_none(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        url, params, header = "/v1/batches", {"tag": "Wand ٣"}, {"Idempotency-Key": "batch-1"}

        def sent(*texts: str, names: tuple[str, ...] = ("a.yaml", "b.yaml", "c.yaml"), **more: Any) -> Any:
            parts = [("problem", (name, text)) for name, text in zip(names, texts, strict=False)]
            files = [*parts, ("files", ("targets.csv", TABLE))]
            return running_service.http.post(url, files=files, **{"params": params, **more})

        good = [named_problem("first"), named_problem("second"), small_problem.PROBLEM]
        made, again = sent(*good, headers=header), sent(*good, headers=header)
        assert made.status_code == 201, made.text
        jobs = made.json()["jobs"]
        assert [item["name"] for item in jobs] == ["first", "second", "small"]
        assert {tuple(item["tags"]) for item in jobs} == {("Wand ٣",)}
        assert [item["id"] for item in again.json()["jobs"]] == [item["id"] for item in jobs]
        listed = running_service.http.get(f"/v1/jobs/{jobs[0]['id']}/files").json()["files"]
        assert any(item["name"].startswith("problem/files/targets-") for item in listed)
        other = sent(*reversed(good), headers=header)
        assert issue_codes(other) == [("service.idempotency", "Idempotency-Key")]
        bad = named_problem("bad") + "\nnonsense: 1\n"
        wrong = sent(named_problem("fine"), bad, "]")
        assert wrong.status_code == 422
        said = [item["message"].partition(": ")[0] for item in wrong.json()["issues"]]
        assert said == ["b.yaml", "c.yaml"], wrong.text
        assert wrong.json()["of"] == [1, 2]
        swapped = [good[1], good[0], good[2]]  # jobs come in the order of the parts
        turned = sent(*swapped, names=("b.yaml", "a.yaml", "c.yaml"), headers=header)
        assert issue_codes(turned) == [("service.idempotency", "Idempotency-Key")]
        for name in ("W" * 256, "a\u202e.yaml"):
            assert issue_codes(sent(good[0], names=(name,))) == [("service.file_name", "problem")]
        for refused, what in (
            (sent(*good, names=("a.yaml", "a.yaml", "b.yaml")), "two problems have the name 'a.yaml'"),
            (
                sent(*["{}"] * 51, names=tuple(f"{n}.yaml" for n in range(51))),
                "wrong number of problems (got 51, allowed 1 to 50)",
            ),
            (sent(), "wrong number of problems (got 0, allowed 1 to 50)"),
            (sent(*good, params={"tag": "a\u202eb"}), "right-to-left override"),
            (
                running_service.http.post(
                    url, data={"problem": [good[0], "x" * 200_000]}, files={"files": ("t", b"1")}
                ),
                "exceeded maximum size of 97KB. Send problems as files.",
            ),
        ):
            assert refused.status_code == 422
            assert what in refused.text, refused.text
        assert len(running_service.http.get("/v1/jobs?limit=200").json()["jobs"]) == 3
        twice = sent(named_problem("same"), named_problem("same"), named_problem("other")).json()["jobs"]
        assert [item["title"] for item in twice] == ["same: a.yaml", "same: b.yaml", ""]
        wide = sent(
            named_problem("same"), named_problem("same"), names=("\u0958" * 150, "b")
        )  # each is two letters when kept
        assert wide.json()["jobs"][0]["title"] == "same: " + "\u0915\u093c" * 97
        running_service.team.hold.set()
        object.__setattr__(running_service.service.limits, "open_jobs", 1)
        many = sent(named_problem("n"), named_problem("m"))
        assert (many.status_code, issue_codes(many)) == (429, [("service.too_many", None)])


def test_a_sweep_opens_no_more_jobs_than_one_may(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", ServiceLimits(open_jobs=3), examiners=1) as running_service:
        running_service.team.hold.set()
        query = {"field": "operations.0.feed_mm_s", "value": ["20", "30", "40", "50"]}
        refused = post_sweep(running_service, query)
        assert (refused.status_code, issue_codes(refused)) == (429, [("service.too_many", None)])
        assert "got 0 and 4 new ones, allowed 3" in refused.text
        assert post_sweep(running_service, {**query, "value": ["20", "30", "40"]}).status_code == 201


def add_finished_job(
    running_service: InProcess, name: str, times: dict[str, tuple[float, float]], end: float
) -> str:
    """A proven job whose stages began then."""
    jobs: Jobs = running_service.service.jobs
    job = jobs.create(NewJob("local", name, "0" * 64, name, ("targets",), {"p": Blob("0" * 64, 1)}, 1, 1)).id
    rows = [{"kind": "state", "data": {"state": "running"}, "at": 0.0}]
    for stage, seen in times.items():
        rows += [{"kind": "progress", "data": {"stage": stage, "fraction": 0.0}, "at": at} for at in seen]
    rows.append({"kind": "state", "data": {"state": "verified"}, "at": end})
    with running_service.service.database.write() as db:
        for seq, row in enumerate(rows, 10):
            data = json.dumps(row["data"])
            db.execute(insert(EVENTS).values(**{**row, "data": data, "job": job, "seq": seq}))
        db.execute(update(JOBS).where(JOBS.c.id == job).values(state="verified", finished=end))
    return job


def test_what_is_left_is_the_median_of_like_jobs(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as running_service:
        running_service.service.runner.stop()
        job = running_service.service.jobs.create(
            NewJob("local", "now", "0" * 64, "now", ("targets",), {}, 1, 1)
        ).id

        def read_estimate() -> dict[str, Any]:
            running_service.service.estimates._known.clear()
            return dict(running_service.http.get(f"/v1/jobs/{job}/estimate").json())

        assert read_estimate() == {"like": 0, "stages": []}  # nothing is made up
        add_finished_job(
            running_service, "a", {"motion": (1.0, 3.0), "proof": (11.0, 11.0)}, 13.0
        )  # 10 s, 2 s
        add_finished_job(
            running_service, "b", {"motion": (1.0, 2.0), "proof": (21.0, 21.0)}, 25.0
        )  # 20 s, 4 s
        add_finished_job(
            running_service, "c", {"motion": (1.0, 2.0), "proof": (31.0, 99.0)}, 5.0
        )  # 30 s, 68 s: clock set back
        result = read_estimate()
        assert result["like"] == 3
        assert {item["stage"]: item["seconds"] for item in result["stages"]} == {"motion": 20.0, "proof": 4.0}
        assert (result["whole_s"], "left_s" in result, "elapsed_s" in result) == (24.0, False, False)

        for stage, fraction, ago, least, most in (
            ("motion", 0.0, 5.0, 18.0, 19.1),
            ("motion", 0.5, 60.0, 14.0, 14.0),  # half of it is left, however long it took
            ("proof", 0.0, 21.0, 2.0, 3.1),
            ("proof", 0.0, 999.0, 0.0, 0.0),
            ("unknown", 0.0, 0.0, 23.0, 24.0),
            ("motion", 0.0, -3e8, 24.0, 24.0),  # begun in the future
        ):
            values = {"state": "running", "stage": stage, "fraction": fraction, "started": time.time() - ago}
            with running_service.service.database.write() as db:
                db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
            now = read_estimate()
            assert least <= now["left_s"] <= most, (stage, now)
            assert now["elapsed_s"] >= 0
