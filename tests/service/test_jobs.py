"""Jobs over HTTP: created, listed, watched, cancelled, deleted, answered from the store; every refusal."""

from __future__ import annotations

import hashlib
import io
import json
import time
import zipfile
from collections.abc import Iterator

import pytest

from planner.service.security import ServiceLimits
from tests import small_problem
from tests.service.support import NOTE, TABLE, InProcess, issue_codes, named_problem


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[InProcess]:
    limits = ServiceLimits(upload_mb=8, mesh_mb=0.5, open_jobs=3, check_s=60, files=5, streams=2)
    with InProcess(tmp_path_factory.mktemp("service") / "data", limits, examiners=1) as made:
        yield made


@pytest.fixture
def held_service(running_service: InProcess) -> Iterator[InProcess]:
    """Nothing ends until the test is over."""
    running_service.team.hold.set()
    try:
        yield running_service
    finally:
        running_service.team.hold.clear()
        for job in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]:
            running_service.wait_for_end(job["id"])
        while {"queued", "running"} & running_service.service.jobs.counts().keys():
            time.sleep(0.02)  # what is deleted while it runs is in no list


def test_a_job_from_upload_to_result(running_service: InProcess) -> None:
    answer = running_service.post(named_problem("whole"))
    assert answer.status_code == 201
    job = answer.json()["id"]
    done = running_service.wait_for_end(job)
    assert (done["state"], done["attempts"], done["from_store"]) == ("verified", 1, False)
    assert done["metrics"] == {"cycle_s": 1.0}
    assert [issue["message"] for issue in done["issues"]] == [NOTE.message]
    files = {file["name"]: file for file in running_service.http.get(f"/v1/jobs/{job}/files").json()["files"]}
    assert {"problem/problem.yaml", "programs/main.mod", "report.html"} <= set(files)
    program = running_service.http.get(f"/v1/jobs/{job}/files/programs/main.mod", params={"download": True})
    assert program.text == "MODULE main"
    assert program.headers["content-disposition"] == 'attachment; filename="main.mod"'
    report = running_service.http.get(f"/v1/jobs/{job}/files/report.html")
    assert "sandbox" in report.headers["content-security-policy"]
    assert report.headers["x-content-type-options"] == "nosniff"
    packed = running_service.http.get(f"/v1/jobs/{job}/programs.zip")
    assert zipfile.ZipFile(io.BytesIO(packed.content)).read("main.mod") == b"MODULE main"
    (table,) = [name for name in files if name.startswith("problem/files/")]
    assert running_service.http.get(f"/v1/jobs/{job}/files/{table}").content == TABLE


def test_identical_problems_are_answered_from_the_store(running_service: InProcess) -> None:
    first = running_service.wait_for_end(running_service.post(named_problem("twice")).json()["id"])
    before = len(running_service.team.started)
    comment = named_problem("twice") + "# where comments stand does not matter\n"
    second = running_service.post(comment).json()
    assert (second["state"], second["from_store"]) == ("verified", True)
    assert second["id"] != first["id"]
    assert second["digest"] == first["digest"]
    assert len(running_service.team.started) == before
    assert running_service.http.get(f"/v1/jobs/{second['id']}/files/programs/main.mod").text == "MODULE main"


def test_uploaded_files_keep_their_names_with_their_hash(running_service: InProcess) -> None:
    problem = named_problem("traced").replace("targets.csv", "My way rev B.csv")
    sent = [("problem", ("p.yaml", problem)), ("files", ("My way rev B.csv", TABLE))]
    job = running_service.http.post("/v1/jobs", files=sent).json()["id"]
    running_service.wait_for_end(job)
    files = {file["name"]: file for file in running_service.http.get(f"/v1/jobs/{job}/files").json()["files"]}
    name = f"problem/files/My-way-rev-B-{hashlib.sha256(TABLE).hexdigest()[:16]}.csv"
    assert files[name]["sha256"] == hashlib.sha256(TABLE).hexdigest()
    text = running_service.http.get(f"/v1/jobs/{job}/files/problem/problem.yaml").text
    assert name.removeprefix("problem/") in text
    before = len(running_service.team.started)
    other = [("problem", ("p.yaml", named_problem("traced"))), ("files", ("targets.csv", TABLE))]
    again = running_service.http.post("/v1/jobs", files=other).json()
    assert not again["from_store"], "its report would name the other file"
    running_service.wait_for_end(again["id"])
    assert len(running_service.team.started) == before + 1


def test_identical_problems_that_wait_are_planned_once(held_service: InProcess) -> None:
    before = len(held_service.team.started)
    jobs = [held_service.post(named_problem("at_once")).json()["id"] for _ in range(3)]
    held_service.team.hold.clear()
    assert [held_service.wait_for_end(job)["from_store"] for job in jobs] == [False, True, True]
    assert len(held_service.team.started) == before + 1


def test_events_tell_all_from_the_first_on_and_from_any_number(running_service: InProcess) -> None:
    job = running_service.post(named_problem("events")).json()["id"]
    running_service.wait_for_end(job)
    text = running_service.http.get(f"/v1/jobs/{job}/events").text
    blocks = [
        dict(line.split(": ", 1) for line in b.splitlines()) for b in text.split("\n\n") if "event: " in b
    ]
    kinds = [block["event"] for block in blocks]
    assert kinds[:2] == ["state", "state"]
    assert kinds[-2:] == ["state", "end"]
    assert {"progress", "issues"} <= set(kinds)
    assert json.loads(blocks[-2]["data"]) == {"state": "verified"}
    assert [int(block["id"]) for block in blocks[:-1]] == list(range(1, len(blocks)))
    later = running_service.http.get(f"/v1/jobs/{job}/events", headers={"Last-Event-ID": "3"}).text
    assert "id: 3\n" not in later
    assert "id: 4\n" in later


def test_too_many_streams_are_429(running_service: InProcess) -> None:
    job = running_service.wait_for_end(running_service.post(named_problem("streams")).json()["id"])["id"]
    hub = running_service.service.hub
    with hub.stream_slot("local"), hub.stream_slot("local"):
        answer = running_service.http.get(f"/v1/jobs/{job}/events")
        assert answer.status_code == 429
        assert issue_codes(answer) == [("service.too_many", None)]
    for _ in range(3):
        assert running_service.http.get(f"/v1/jobs/{job}/events").status_code == 200


def test_the_list_comes_in_pages(running_service: InProcess) -> None:
    made = [
        running_service.wait_for_end(running_service.post(named_problem(f"page{i}")).json()["id"])["id"]
        for i in range(3)
    ]
    seen: list[str] = []
    query = "?limit=2"
    while True:
        page = running_service.http.get(f"/v1/jobs{query}").json()
        seen += [job["id"] for job in page["jobs"]]
        if "next" not in page:
            break
        running_service.http.delete(f"/v1/jobs/{seen[-1]}")  # it may be gone when the next page is asked for
        query = f"?limit=2&cursor={page['next']}"
    assert seen[:3] == made[::-1]
    assert len(seen) == len(set(seen))
    assert not running_service.http.get("/v1/jobs?state=queued").json()["jobs"]


def test_a_running_job_is_cancelled(held_service: InProcess) -> None:
    job = held_service.post(named_problem("long")).json()["id"]
    while held_service.http.get(f"/v1/jobs/{job}").json()["state"] != "running":
        pass
    waiting = held_service.post(named_problem("waits")).json()
    assert waiting["state"] == "queued"
    assert held_service.http.post(f"/v1/jobs/{waiting['id']}/cancel").json()["state"] == "cancelled"
    assert held_service.http.post(f"/v1/jobs/{job}/cancel").json()["state"] == "running"
    assert held_service.wait_for_end(job)["state"] == "cancelled"
    assert held_service.http.post(f"/v1/jobs/{job}/cancel").json()["state"] == "cancelled"


def test_jobs_are_deleted_even_while_they_run(held_service: InProcess) -> None:
    job = held_service.post(named_problem("doomed")).json()["id"]
    while held_service.http.get(f"/v1/jobs/{job}").json()["state"] != "running":
        pass
    assert held_service.http.delete(f"/v1/jobs/{job}").status_code == 204
    for answer in (held_service.http.get(f"/v1/jobs/{job}"), held_service.http.delete(f"/v1/jobs/{job}")):
        assert answer.status_code == 404
        assert issue_codes(answer) == [("service.unknown_job", None)]


def test_too_many_jobs_are_429(held_service: InProcess) -> None:
    for number in range(3):
        assert held_service.post(named_problem(f"many{number}")).status_code == 201
    answer = held_service.post(named_problem("one_more"))
    assert answer.status_code == 429
    assert issue_codes(answer) == [("service.too_many", None)]
    assert int(answer.headers["retry-after"]) > 0


@pytest.mark.parametrize("job", ["0" * 32, "x", "..", "%2e%2e%2fetc"])
def test_unknown_jobs_are_404(running_service: InProcess, job: str) -> None:
    for path in ("", "/events", "/files", "/files/report.html"):
        assert running_service.http.get(f"/v1/jobs/{job}{path}").status_code == 404


def test_file_names_are_no_paths(running_service: InProcess) -> None:
    job = running_service.wait_for_end(running_service.post(named_problem("paths")).json()["id"])["id"]
    for name in (
        "../../service.lock",
        "..%2f..%2fservice.lock",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "programs",
    ):
        answer = running_service.http.get(f"/v1/jobs/{job}/files/{name}")
        assert answer.status_code == 404, name
    assert issue_codes(running_service.http.get(f"/v1/jobs/{job}/files/nothing")) == [
        ("service.unknown_file", "name")
    ]


def test_check_tells_what_is_known_without_planning(running_service: InProcess) -> None:
    before = len(running_service.team.started)
    body = running_service.post(named_problem("check"), path="/v1/check").json()
    assert body["ok"]
    assert body["summary"]["stock_mm"] == [[-50.0, -50.0, 0.0], [50.0, 50.0, 100.0]]
    assert len(running_service.team.started) == before


def test_check_can_test_reach(running_service: InProcess) -> None:
    far = named_problem("far").replace("[450, 0, 0]", "[450, 0, 1]")
    files = [("problem", ("p.yaml", far)), ("files", ("targets.csv", TABLE.replace(b"450,", b"4500,")))]
    body = running_service.http.post("/v1/check?reach=true", files=files).json()
    assert not body["ok"]
    assert "motion.no_reach" in [issue["code"] for issue in body["issues"]]


def test_a_first_look_says_what_share_was_looked_at(running_service: InProcess) -> None:
    count = len(small_problem.ROWS)
    subset = running_service.post(named_problem("looked"), path="/v1/check?targets=3").json()
    assert subset["ok"]
    assert subset["looked_at"] == {"targets": 3, "of": count, "placed": True, "thinned": False}
    whole = running_service.post(named_problem("looked"), path="/v1/check?reach=true").json()
    assert whole["looked_at"] == {"targets": count, "of": count, "placed": True, "thinned": False}
    both = running_service.post(named_problem("looked"), path="/v1/check?reach=true&targets=3").json()
    assert both["looked_at"]["targets"] == count
    assert "looked_at" not in running_service.post(named_problem("looked"), path="/v1/check").json()
    for wrong in ("0", "1001", "x"):
        assert issue_codes(running_service.post(path=f"/v1/check?targets={wrong}")) == [
            ("service.request", "targets")
        ]


def test_a_problem_alone_may_be_the_body(running_service: InProcess) -> None:
    text = named_problem("alone").replace("file: targets.csv, ", "")
    answer = running_service.http.post("/v1/jobs", content=text, headers={"Content-Type": "application/yaml"})
    assert answer.status_code == 422
    assert issue_codes(answer) == [("problem.field", "operations.0.file")]


def test_all_faults_are_told_at_once_with_field_and_line(running_service: InProcess) -> None:
    wrong = named_problem("9wrong").replace("robot: irb140", "robot: 5").replace("targets.csv", "other.csv")
    answer = running_service.post(wrong)
    assert answer.status_code == 422
    found = {issue.get("field"): issue for issue in answer.json()["issues"]}
    assert {"name", "cell.arms.0.robot", "operations.0.file"} <= set(found)
    assert found["operations.0.file"]["code"] == "service.not_uploaded"
    assert found["name"]["line"] == 2
    assert "/" not in str(found["name"]["message"])


def test_bad_requests_are_told_by_field(running_service: InProcess) -> None:
    assert issue_codes(running_service.http.get("/v1/jobs?limit=0&state=no")) == [
        ("service.request", "limit"),
        ("service.request", "state.0"),
    ]
    answer = running_service.http.post(
        "/v1/jobs", files=[("problm", ("p.yaml", "a: 1")), ("files", ("t.csv", "1"))]
    )
    assert answer.status_code == 422
    assert {code for code, _ in issue_codes(answer)} == {"service.request"}
    assert {field for _, field in issue_codes(answer)} == {"problm", "problem"}
    assert issue_codes(running_service.http.get("/v1/nothing")) == [("service.not_found", None)]
    assert running_service.http.put("/v1/jobs").status_code == 405


def test_what_is_built_in(running_service: InProcess) -> None:
    robots = running_service.http.get("/v1/catalogue/robots").json()["entries"]
    assert robots["irb140"]["payload_kg"] == 6.0
    assert "spring_steel" in running_service.http.get("/v1/catalogue/materials").json()["entries"]
    assert "bow" in running_service.http.get("/v1/catalogue/tools").json()["entries"]
    assert "arms" in running_service.http.get("/v1/catalogue/cells").json()["entries"]["two_irb140_facing"]
    assert set(running_service.http.get("/v1/processes").json()) >= {
        "elastic_wire",
        "straight_wire",
        "forming",
        "milling",
    }
    assert running_service.http.get("/v1/processes/nothing/schema").status_code == 404
    schema = running_service.http.get("/v1/processes/forming/schema").json()
    assert "stepdown_mm" in json.dumps(schema)


def test_figures_are_in_prometheus_text_format(running_service: InProcess) -> None:
    """The format: https://prometheus.io/docs/instrumenting/exposition_formats."""
    lines = running_service.http.get("/metrics").text.splitlines()
    assert 'tandem_jobs{state="queued"} 0.0' in lines
    for line in lines:
        if not line.startswith("#"):
            name, value = line.rsplit(" ", 1)
            assert name.split("{")[0].replace("_", "").isalnum()
            float(value)


def test_health(running_service: InProcess) -> None:
    response = running_service.http.get("/v1/health")
    assert (response.status_code, response.json()["status"]) == (200, "ok")


def test_the_small_problem_is_what_its_schema_says(running_service: InProcess) -> None:
    import jsonschema_rs
    import yaml

    schema = running_service.http.get("/v1/schema").json()
    check = jsonschema_rs.validator_for(schema)
    assert check.is_valid(yaml.safe_load(small_problem.PROBLEM))
    assert not check.is_valid({**yaml.safe_load(small_problem.PROBLEM), "stok": 1})
