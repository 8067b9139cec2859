"""Jobs over HTTP: made, listed, watched, cancelled, deleted, answered from the store; and every refusal."""

from __future__ import annotations

import hashlib
import io
import json
import time
import zipfile
from collections.abc import Iterator

import pytest

from planner.service.security import Limits
from tests import small_problem
from tests.service.support import NOTE, TABLE, InProcess, codes, named


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    limits = Limits(upload_mb=8, mesh_mb=0.5, open_jobs=3, check_s=60, files=5, streams=2)
    with InProcess(tmp_path_factory.mktemp("service") / "data", limits, examiners=1) as made:
        yield made


@pytest.fixture
def held(here: InProcess) -> Iterator[InProcess]:
    """Nothing ends until the test is over."""
    here.team.hold.set()
    try:
        yield here
    finally:
        here.team.hold.clear()
        for job in here.http.get("/v1/jobs?limit=200").json()["jobs"]:
            here.ended(job["id"])
        while {"queued", "running"} & here.service.jobs.counts().keys():
            time.sleep(0.02)  # what is deleted while it runs is in no list


def test_a_job_from_upload_to_result(here: InProcess) -> None:
    answer = here.post(named("whole"))
    assert answer.status_code == 201
    job = answer.json()["id"]
    done = here.ended(job)
    assert (done["state"], done["attempts"], done["from_store"]) == ("verified", 1, False)
    assert done["metrics"] == {"cycle_s": 1.0}
    assert [issue["message"] for issue in done["issues"]] == [NOTE.message]
    files = {one["name"]: one for one in here.http.get(f"/v1/jobs/{job}/files").json()["files"]}
    assert {"problem/problem.yaml", "programs/main.mod", "report.html"} <= set(files)
    program = here.http.get(f"/v1/jobs/{job}/files/programs/main.mod", params={"download": True})
    assert program.text == "MODULE main"
    assert program.headers["content-disposition"] == 'attachment; filename="main.mod"'
    report = here.http.get(f"/v1/jobs/{job}/files/report.html")
    assert "sandbox" in report.headers["content-security-policy"]
    assert report.headers["x-content-type-options"] == "nosniff"
    packed = here.http.get(f"/v1/jobs/{job}/programs.zip")
    assert zipfile.ZipFile(io.BytesIO(packed.content)).read("main.mod") == b"MODULE main"
    (table,) = [name for name in files if name.startswith("problem/files/")]
    assert here.http.get(f"/v1/jobs/{job}/files/{table}").content == TABLE


def test_identical_problems_are_answered_from_the_store(here: InProcess) -> None:
    first = here.ended(here.post(named("twice")).json()["id"])
    before = len(here.team.started)
    comment = named("twice") + "# where comments stand does not matter\n"
    second = here.post(comment).json()
    assert (second["state"], second["from_store"]) == ("verified", True)
    assert second["id"] != first["id"]
    assert second["digest"] == first["digest"]
    assert len(here.team.started) == before
    assert here.http.get(f"/v1/jobs/{second['id']}/files/programs/main.mod").text == "MODULE main"


def test_uploaded_files_keep_their_names_with_their_hash(here: InProcess) -> None:
    problem = named("traced").replace("targets.csv", "My way rev B.csv")
    sent = [("problem", ("p.yaml", problem)), ("files", ("My way rev B.csv", TABLE))]
    job = here.http.post("/v1/jobs", files=sent).json()["id"]
    here.ended(job)
    files = {one["name"]: one for one in here.http.get(f"/v1/jobs/{job}/files").json()["files"]}
    name = f"problem/files/My-way-rev-B-{hashlib.sha256(TABLE).hexdigest()[:16]}.csv"
    assert files[name]["sha256"] == hashlib.sha256(TABLE).hexdigest()
    text = here.http.get(f"/v1/jobs/{job}/files/problem/problem.yaml").text
    assert name.removeprefix("problem/") in text
    before = len(here.team.started)
    other = [("problem", ("p.yaml", named("traced"))), ("files", ("targets.csv", TABLE))]
    again = here.http.post("/v1/jobs", files=other).json()
    assert not again["from_store"], "its report would name the other file"
    here.ended(again["id"])
    assert len(here.team.started) == before + 1


def test_identical_problems_that_wait_are_planned_once(held: InProcess) -> None:
    before = len(held.team.started)
    jobs = [held.post(named("at_once")).json()["id"] for _ in range(3)]
    held.team.hold.clear()
    assert [held.ended(job)["from_store"] for job in jobs] == [False, True, True]
    assert len(held.team.started) == before + 1


def test_events_tell_all_from_the_first_on_and_from_any_number(here: InProcess) -> None:
    job = here.post(named("events")).json()["id"]
    here.ended(job)
    text = here.http.get(f"/v1/jobs/{job}/events").text
    blocks = [
        dict(line.split(": ", 1) for line in b.splitlines()) for b in text.split("\n\n") if "event: " in b
    ]
    kinds = [block["event"] for block in blocks]
    assert kinds[:2] == ["state", "state"]
    assert kinds[-2:] == ["state", "end"]
    assert {"progress", "issues"} <= set(kinds)
    assert json.loads(blocks[-2]["data"]) == {"state": "verified"}
    assert [int(block["id"]) for block in blocks[:-1]] == list(range(1, len(blocks)))
    later = here.http.get(f"/v1/jobs/{job}/events", headers={"Last-Event-ID": "3"}).text
    assert "id: 3\n" not in later
    assert "id: 4\n" in later


def test_too_many_streams_are_429(here: InProcess) -> None:
    job = here.ended(here.post(named("streams")).json()["id"])["id"]
    hub = here.service.hub
    with hub.slot("local"), hub.slot("local"):
        answer = here.http.get(f"/v1/jobs/{job}/events")
        assert answer.status_code == 429
        assert codes(answer) == [("service.too_many", None)]
    for _ in range(3):
        assert here.http.get(f"/v1/jobs/{job}/events").status_code == 200


def test_the_list_comes_in_pages(here: InProcess) -> None:
    made = [here.ended(here.post(named(f"page{i}")).json()["id"])["id"] for i in range(3)]
    seen: list[str] = []
    query = "?limit=2"
    while True:
        page = here.http.get(f"/v1/jobs{query}").json()
        seen += [job["id"] for job in page["jobs"]]
        if "next" not in page:
            break
        here.http.delete(f"/v1/jobs/{seen[-1]}")  # it may be gone when the next page is asked for
        query = f"?limit=2&cursor={page['next']}"
    assert seen[:3] == made[::-1]
    assert len(seen) == len(set(seen))
    assert not here.http.get("/v1/jobs?state=queued").json()["jobs"]


def test_a_running_job_is_cancelled(held: InProcess) -> None:
    job = held.post(named("long")).json()["id"]
    while held.http.get(f"/v1/jobs/{job}").json()["state"] != "running":
        pass
    waiting = held.post(named("waits")).json()
    assert waiting["state"] == "queued"
    assert held.http.post(f"/v1/jobs/{waiting['id']}/cancel").json()["state"] == "cancelled"
    assert held.http.post(f"/v1/jobs/{job}/cancel").json()["state"] == "running"
    assert held.ended(job)["state"] == "cancelled"
    assert held.http.post(f"/v1/jobs/{job}/cancel").json()["state"] == "cancelled"


def test_jobs_are_deleted_even_while_they_run(held: InProcess) -> None:
    job = held.post(named("doomed")).json()["id"]
    while held.http.get(f"/v1/jobs/{job}").json()["state"] != "running":
        pass
    assert held.http.delete(f"/v1/jobs/{job}").status_code == 204
    for answer in (held.http.get(f"/v1/jobs/{job}"), held.http.delete(f"/v1/jobs/{job}")):
        assert answer.status_code == 404
        assert codes(answer) == [("service.unknown_job", None)]


def test_too_many_jobs_are_429(held: InProcess) -> None:
    for number in range(3):
        assert held.post(named(f"many{number}")).status_code == 201
    answer = held.post(named("one_more"))
    assert answer.status_code == 429
    assert codes(answer) == [("service.too_many", None)]
    assert int(answer.headers["retry-after"]) > 0


@pytest.mark.parametrize("job", ["0" * 32, "x", "..", "%2e%2e%2fetc"])
def test_unknown_jobs_are_404(here: InProcess, job: str) -> None:
    for path in ("", "/events", "/files", "/files/report.html"):
        assert here.http.get(f"/v1/jobs/{job}{path}").status_code == 404


def test_file_names_are_no_paths(here: InProcess) -> None:
    job = here.ended(here.post(named("paths")).json()["id"])["id"]
    for name in (
        "../../service.lock",
        "..%2f..%2fservice.lock",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "programs",
    ):
        answer = here.http.get(f"/v1/jobs/{job}/files/{name}")
        assert answer.status_code == 404, name
    assert codes(here.http.get(f"/v1/jobs/{job}/files/nothing")) == [("service.unknown_file", "name")]


def test_check_tells_what_is_known_without_planning(here: InProcess) -> None:
    before = len(here.team.started)
    found = here.post(named("check"), path="/v1/check").json()
    assert found["ok"]
    assert found["summary"]["stock_mm"] == [[-50.0, -50.0, 0.0], [50.0, 50.0, 100.0]]
    assert len(here.team.started) == before


def test_check_can_test_reach(here: InProcess) -> None:
    far = named("far").replace("[450, 0, 0]", "[450, 0, 1]")
    files = [("problem", ("p.yaml", far)), ("files", ("targets.csv", TABLE.replace(b"450,", b"4500,")))]
    found = here.http.post("/v1/check?reach=true", files=files).json()
    assert not found["ok"]
    assert "motion.no_reach" in [issue["code"] for issue in found["issues"]]


def test_a_first_look_says_what_share_was_looked_at(here: InProcess) -> None:
    count = len(small_problem.ROWS)
    some = here.post(named("looked"), path="/v1/check?targets=3").json()
    assert some["ok"]
    assert some["looked_at"] == {"targets": 3, "of": count, "placed": True, "thinned": False}
    whole = here.post(named("looked"), path="/v1/check?reach=true").json()
    assert whole["looked_at"] == {"targets": count, "of": count, "placed": True, "thinned": False}
    both = here.post(named("looked"), path="/v1/check?reach=true&targets=3").json()
    assert both["looked_at"]["targets"] == count
    assert "looked_at" not in here.post(named("looked"), path="/v1/check").json()
    for wrong in ("0", "1001", "x"):
        assert codes(here.post(path=f"/v1/check?targets={wrong}")) == [("service.request", "targets")]


def test_a_problem_alone_may_be_the_body(here: InProcess) -> None:
    text = named("alone").replace("file: targets.csv, ", "")
    answer = here.http.post("/v1/jobs", content=text, headers={"Content-Type": "application/yaml"})
    assert answer.status_code == 422
    assert codes(answer) == [("problem.field", "operations.0.file")]


def test_all_faults_are_told_at_once_with_field_and_line(here: InProcess) -> None:
    wrong = named("9wrong").replace("robot: irb140", "robot: 5").replace("targets.csv", "other.csv")
    answer = here.post(wrong)
    assert answer.status_code == 422
    found = {issue.get("field"): issue for issue in answer.json()["issues"]}
    assert {"name", "cell.arms.0.robot", "operations.0.file"} <= set(found)
    assert found["operations.0.file"]["code"] == "service.not_uploaded"
    assert found["name"]["line"] == 2
    assert "/" not in str(found["name"]["message"])


def test_bad_requests_are_told_by_field(here: InProcess) -> None:
    assert codes(here.http.get("/v1/jobs?limit=0&state=no")) == [
        ("service.request", "limit"),
        ("service.request", "state.0"),
    ]
    answer = here.http.post("/v1/jobs", files=[("problm", ("p.yaml", "a: 1")), ("files", ("t.csv", "1"))])
    assert answer.status_code == 422
    assert {code for code, _ in codes(answer)} == {"service.request"}
    assert {field for _, field in codes(answer)} == {"problm", "problem"}
    assert codes(here.http.get("/v1/nothing")) == [("service.not_found", None)]
    assert here.http.put("/v1/jobs").status_code == 405


def test_what_is_built_in(here: InProcess) -> None:
    robots = here.http.get("/v1/catalogue/robots").json()["entries"]
    assert robots["irb140"]["payload_kg"] == 6.0
    assert "spring_steel" in here.http.get("/v1/catalogue/materials").json()["entries"]
    assert "bow" in here.http.get("/v1/catalogue/tools").json()["entries"]
    assert "arms" in here.http.get("/v1/catalogue/cells").json()["entries"]["two_irb140_facing"]
    assert set(here.http.get("/v1/processes").json()) >= {
        "elastic_wire",
        "straight_wire",
        "forming",
        "milling",
    }
    assert here.http.get("/v1/processes/nothing/schema").status_code == 404
    schema = here.http.get("/v1/processes/forming/schema").json()
    assert "stepdown_mm" in json.dumps(schema)


def test_figures_are_in_prometheus_text_format(here: InProcess) -> None:
    """The format: https://prometheus.io/docs/instrumenting/exposition_formats."""
    lines = here.http.get("/metrics").text.splitlines()
    assert 'tandem_jobs{state="queued"} 0.0' in lines
    for line in lines:
        if not line.startswith("#"):
            name, value = line.rsplit(" ", 1)
            assert name.split("{")[0].replace("_", "").isalnum()
            float(value)


def test_health(here: InProcess) -> None:
    found = here.http.get("/v1/health")
    assert (found.status_code, found.json()["status"]) == (200, "ok")


def test_the_small_problem_is_what_its_schema_says(here: InProcess) -> None:
    import jsonschema_rs
    import yaml

    schema = here.http.get("/v1/schema").json()
    check = jsonschema_rs.validator_for(schema)
    assert check.is_valid(yaml.safe_load(small_problem.PROBLEM))
    assert not check.is_valid({**yaml.safe_load(small_problem.PROBLEM), "stok": 1})
