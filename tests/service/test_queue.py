"""Whose turn it is, a sweep of a field, and what a job may still take by like ones."""

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
from planner.service.runner import Work
from planner.service.security import Limits
from planner.service.storage import Blob
from tests import small_problem
from tests.service import postgres
from tests.service.support import TABLE, InProcess, codes, named
from tests.service.test_finding import put
from tests.service.test_roles import Shop, opened


@pytest.fixture(params=["sqlite", "postgresql"])
def shop(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Shop]:
    """A service whose one worker has a job of dan, so that all others wait."""
    database = postgres.fresh(tmp_path) if request.param == "postgresql" else None
    with opened(tmp_path / "data", database) as here:
        here.team.hold.set()
        here.service.runner.stop()
        yield Shop(here)


def order(shop: Shop, by: str = "ann") -> list[tuple[str, int]]:
    found = shop.ask(by, "GET", "/v1/jobs?state=queued&sort=turn").json()["jobs"]
    return [(one["name"], one["ahead"]) for one in found]


def claimed(shop: Shop) -> list[str]:
    """The names of jobs in the order in which they are taken, each ended before the next."""
    work, out = Work(shop.here.service.database, "other", 60.0), []
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
    assert claimed(shop) == ["a3", "e1", "a1", "e2", "a2"]
    late = shop.ask("ann", "POST", f"/v1/jobs/{ids['a2']}/first")
    assert (late.status_code, codes(late)) == (409, [("service.state", "state")])


def test_many_who_come_first_at_once_lose_no_turn(shop: Shop) -> None:
    ids = [put(shop, "ann", f"j{n}") for n in range(6)]
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda one: shop.ask("ann", "POST", f"/v1/jobs/{one}/first"), ids))
    assert {one.status_code for one in answers} == {200}
    found = order(shop)
    assert [ahead for _, ahead in found] == list(range(6))
    assert claimed(shop) == [name for name, _ in found]


def swept(here: InProcess, query: dict[str, Any], **more: Any) -> Any:
    files = [("problem", ("p.yaml", small_problem.PROBLEM)), ("files", ("targets.csv", TABLE))]
    return here.http.post("/v1/sweeps", params=query, files=files, **more)


def test_a_sweep_makes_a_job_of_each_value_or_none(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as here:
        query = {"field": "operations.0.feed_mm_s", "value": ["20", "30.5", "40"], "tag": "Vorschub"}
        key = {"Idempotency-Key": "sweep-1"}
        made, again = swept(here, query, headers=key), swept(here, query, headers=key)
        assert made.status_code == 201, made.text
        jobs = made.json()["jobs"]
        assert [one["id"] for one in again.json()["jobs"]] == [one["id"] for one in jobs]
        assert [one["title"].rpartition(": ")[2] for one in jobs] == [
            f"operations.0.feed_mm_s = {v}" for v in ("20", "30.5", "40")
        ]
        assert len({one["digest"] for one in jobs}) == 3
        text = here.http.get(f"/v1/jobs/{jobs[1]['id']}/files/problem/problem.yaml").text
        assert "feed_mm_s: 30.5" in text
        found = here.http.get("/v1/jobs", params={"tag": "vorschub"}).json()["jobs"]
        assert {one["id"] for one in found} == {one["id"] for one in jobs}
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
            refused = swept(here, {**query, **bad})
            assert refused.status_code == 422, (bad, refused.text)
            assert "passwd" not in refused.text or "not uploaded" in refused.text.replace("_", " ")
            assert field is None or field in [one[1] for one in codes(refused)], (bad, refused.text)
        wrong = swept(here, {**query, "value": ["20", "-1"]})
        assert wrong.json()["issues"][0]["message"].startswith("operations.0.feed_mm_s = -1: ")
        assert len(here.http.get("/v1/jobs?limit=200").json()["jobs"]) == 3


def test_several_problems_make_a_job_each_or_none(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as here:
        url, params, header = "/v1/batches", {"tag": "Wand ٣"}, {"Idempotency-Key": "batch-1"}

        def sent(*texts: str, names: tuple[str, ...] = ("a.yaml", "b.yaml", "c.yaml"), **more: Any) -> Any:
            parts = [("problem", (name, text)) for name, text in zip(names, texts, strict=False)]
            files = [*parts, ("files", ("targets.csv", TABLE))]
            return here.http.post(url, files=files, **{"params": params, **more})

        good = [named("first"), named("second"), small_problem.PROBLEM]
        made, again = sent(*good, headers=header), sent(*good, headers=header)
        assert made.status_code == 201, made.text
        jobs = made.json()["jobs"]
        assert [one["name"] for one in jobs] == ["first", "second", "small"]
        assert {tuple(one["tags"]) for one in jobs} == {("Wand ٣",)}
        assert [one["id"] for one in again.json()["jobs"]] == [one["id"] for one in jobs]
        listed = here.http.get(f"/v1/jobs/{jobs[0]['id']}/files").json()["files"]
        assert any(one["name"].startswith("problem/files/targets-") for one in listed)
        other = sent(*reversed(good), headers=header)
        assert codes(other) == [("service.idempotency", "Idempotency-Key")]
        bad = named("bad") + "\nnonsense: 1\n"
        wrong = sent(named("fine"), bad, "]")
        assert wrong.status_code == 422
        said = [one["message"].partition(": ")[0] for one in wrong.json()["issues"]]
        assert said == ["b.yaml", "c.yaml"], wrong.text
        assert wrong.json()["of"] == [1, 2]
        swapped = [good[1], good[0], good[2]]  # jobs come in the order of the parts
        turned = sent(*swapped, names=("b.yaml", "a.yaml", "c.yaml"), headers=header)
        assert codes(turned) == [("service.idempotency", "Idempotency-Key")]
        for name in ("W" * 256, "a\u202e.yaml"):
            assert codes(sent(good[0], names=(name,))) == [("service.file_name", "problem")]
        for refused, what in (
            (sent(*good, names=("a.yaml", "a.yaml", "b.yaml")), "two problems have the name 'a.yaml'"),
            (
                sent(*["{}"] * 51, names=tuple(f"{n}.yaml" for n in range(51))),
                "got 51 problems, 1 to 50 may be",
            ),
            (sent(), "got 0 problems, 1 to 50 may be"),
            (sent(*good, params={"tag": "a\u202eb"}), "right-to-left override"),
            (
                here.http.post(url, data={"problem": [good[0], "x" * 200_000]}, files={"files": ("t", b"1")}),
                "exceeded maximum size of 97KB.; send problems as files",
            ),
        ):
            assert refused.status_code == 422
            assert what in refused.text, refused.text
        assert len(here.http.get("/v1/jobs?limit=200").json()["jobs"]) == 3
        twice = sent(named("same"), named("same"), named("other")).json()["jobs"]
        assert [one["title"] for one in twice] == ["same: a.yaml", "same: b.yaml", ""]
        wide = sent(
            named("same"), named("same"), names=("\u0958" * 150, "b")
        )  # each is two letters when kept
        assert wide.json()["jobs"][0]["title"] == "same: " + "\u0915\u093c" * 97
        here.team.hold.set()
        object.__setattr__(here.service.limits, "open_jobs", 1)
        many = sent(named("n"), named("m"))
        assert (many.status_code, codes(many)) == (429, [("service.too_many", None)])


def test_a_sweep_opens_no_more_jobs_than_one_may(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", Limits(open_jobs=3), examiners=1) as here:
        here.team.hold.set()
        query = {"field": "operations.0.feed_mm_s", "value": ["20", "30", "40", "50"]}
        refused = swept(here, query)
        assert (refused.status_code, codes(refused)) == (429, [("service.too_many", None)])
        assert "0 jobs wait or run, 4 more are wanted, at most 3 may" in refused.text
        assert swept(here, {**query, "value": ["20", "30", "40"]}).status_code == 201


def ran(here: InProcess, name: str, times: dict[str, tuple[float, float]], end: float) -> str:
    """A proven job whose stages began then."""
    jobs: Jobs = here.service.jobs
    job = jobs.create(NewJob("local", name, "0" * 64, name, ("targets",), {"p": Blob("0" * 64, 1)}, 1, 1)).id
    rows = [{"kind": "state", "data": {"state": "running"}, "at": 0.0}]
    for stage, seen in times.items():
        rows += [{"kind": "progress", "data": {"stage": stage, "fraction": 0.0}, "at": at} for at in seen]
    rows.append({"kind": "state", "data": {"state": "verified"}, "at": end})
    with here.service.database.write() as db:
        for seq, row in enumerate(rows, 10):
            data = json.dumps(row["data"])
            db.execute(insert(EVENTS).values(**{**row, "data": data, "job": job, "seq": seq}))
        db.execute(update(JOBS).where(JOBS.c.id == job).values(state="verified", finished=end))
    return job


def test_what_is_left_is_the_median_of_like_jobs(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", examiners=1) as here:
        here.service.runner.stop()
        job = here.service.jobs.create(NewJob("local", "now", "0" * 64, "now", ("targets",), {}, 1, 1)).id

        def told() -> dict[str, Any]:
            here.service.estimates._known.clear()
            return dict(here.http.get(f"/v1/jobs/{job}/estimate").json())

        assert told() == {"like": 0, "stages": []}  # nothing is made up
        ran(here, "a", {"motion": (1.0, 3.0), "proof": (11.0, 11.0)}, 13.0)  # 10 s, 2 s
        ran(here, "b", {"motion": (1.0, 2.0), "proof": (21.0, 21.0)}, 25.0)  # 20 s, 4 s
        ran(here, "c", {"motion": (1.0, 2.0), "proof": (31.0, 99.0)}, 5.0)  # 30 s, 68 s: clock set back
        found = told()
        assert found["like"] == 3
        assert {one["stage"]: one["seconds"] for one in found["stages"]} == {"motion": 20.0, "proof": 4.0}
        assert (found["whole_s"], "left_s" in found, "elapsed_s" in found) == (24.0, False, False)

        for stage, fraction, ago, least, most in (
            ("motion", 0.0, 5.0, 18.0, 19.1),
            ("motion", 0.5, 60.0, 14.0, 14.0),  # half of it is left, however long it took
            ("proof", 0.0, 21.0, 2.0, 3.1),
            ("proof", 0.0, 999.0, 0.0, 0.0),
            ("unknown", 0.0, 0.0, 23.0, 24.0),
            ("motion", 0.0, -3e8, 24.0, 24.0),  # begun in the future
        ):
            values = {"state": "running", "stage": stage, "fraction": fraction, "started": time.time() - ago}
            with here.service.database.write() as db:
                db.execute(update(JOBS).where(JOBS.c.id == job).values(**values))
            now = told()
            assert least <= now["left_s"] <= most, (stage, now)
            assert now["elapsed_s"] >= 0
