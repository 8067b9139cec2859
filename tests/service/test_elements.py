"""Building elements over HTTP: uploaded, divided by a worker and divided again.

Also panels as jobs, marks, reports, and every refusal.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import yaml
from sqlalchemy import update

from planner.batch.job import ELEMENT_FILE, PLANNED_FILE, BatchJob, JobEvent, JobFinished, JobOrder, JobResult
from planner.batch.solve import solve_job
from planner.files import THUMBNAIL
from planner.issues import Issue
from planner.service import audit
from planner.service.jobs import put_files
from planner.service.models import JOBS
from planner.service.security import Auth, ServiceLimits
from tests.element.shells import cap, shell
from tests.element.test_saw_jobs import SAW, write_small_shell
from tests.service.support import ROOT, FakeTeam, InProcess, issue_codes, named_problem

NO_REACH = Issue("motion.no_reach", "a target of the pretended plan is too far")
COUNT = 24
SHELL = {"count": COUNT, "off_surface_mm": 60}
SMALL = ServiceLimits(open_jobs=3, files=8, upload_mb=8, mesh_mb=1)


class FakeDivision(FakeTeam):
    """Divides and reports as a worker does, in this process; only pretends to plan panels."""

    def __init__(self) -> None:
        super().__init__()
        self.given: dict[str, dict[str, bytes]] = {}
        self.no_reach: set[str] = set()
        self._waiting: dict[str, tuple[BatchJob, Path]] = {}

    def start(self, job: BatchJob, folder: Path) -> None:
        self.given[job.name] = dict(job.files)
        if job.files.keys() & {ELEMENT_FILE, PLANNED_FILE}:
            self.started.append(job.name)
            self._waiting[job.name] = (job, folder)
        elif job.name.rpartition("-")[0] in self.no_reach:
            self._events.append(JobFinished(job.name, JobResult(job.name, "infeasible", (NO_REACH,))))
        else:
            super().start(job, folder)

    def cancel(self, name: str) -> bool:
        if name in self._waiting:
            del self._waiting[name]
            self._events.append(JobFinished(name, JobResult(name, "cancelled")))
            return True
        return super().cancel(name)

    def events(self, timeout_s: float) -> Iterator[JobEvent]:
        while self._waiting and not self.hold.is_set():
            name, (job, folder) = self._waiting.popitem()
            source = folder.parent / "source"
            for file, content in job.files.items():
                (source / file).parent.mkdir(parents=True, exist_ok=True)
                (source / file).write_bytes(content)
            order = JobOrder(name, source, folder)
            done = solve_job(order, lambda stage, fraction: None, lambda issues: None)
            self._events.append(JobFinished(name, done))
        yield from super().events(timeout_s)


class ElementService(InProcess):
    """A service whose team divides."""

    def __init__(self, data: Path, limits: ServiceLimits | None = None, **options: Any) -> None:
        super().__init__(data, limits, **options)
        self.team = self.dividing = FakeDivision()
        self.team.digest = self._digest

    def upload(self, folder: Path, **changes: Any) -> Any:
        """Upload a small shell with its template and its cell as separate files."""
        path = shell(folder, cap(n=9), SHELL, **changes)
        template = yaml.safe_load((folder / "held.yaml").read_text())
        cell = Path(template["cell"])
        files = [("problem", ("element.yaml", path.read_bytes()))]
        files += [("files", ("shell.obj", (folder / "shell.obj").read_bytes()))]
        files += [("files", ("held.yaml", yaml.safe_dump({**template, "cell": f"../{cell.name}"})))]
        files += [("files", (cell.name, cell.read_bytes()))]
        return self.http.post("/v1/elements", files=files)

    def wait_for_division(self, element: str) -> dict[str, Any]:
        """The element when its division has ended."""
        self.wait_for_end(element)
        body: dict[str, Any] = self.http.get(f"/v1/elements/{element}").json()
        return body


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ElementService]:
    with ElementService(tmp_path_factory.mktemp("service") / "data", SMALL, examiners=1, workers=4) as made:
        yield made


@pytest.fixture(scope="module")
def dome(running_service: ElementService, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    answer = running_service.upload(tmp_path_factory.mktemp("shell"), name="dome")
    assert answer.status_code == 201, answer.text
    return running_service.wait_for_division(answer.json()["id"])


def test_an_element_is_uploaded_and_divided(running_service: ElementService, dome: dict[str, Any]) -> None:
    assert (dome["state"], dome["name"], dome["kind"]) == ("done", "dome", "hexagons")
    assert dome["fields"] == {
        "panels.hexagons.count": COUNT,
        "panels.hexagons.off_surface_mm": 60.0,
        "thickness_mm": 150.0,
        "blocks.0.size_mm": [1200.0, 1000.0, 150.0],
    }
    assert len(dome["panels"]) == COUNT
    assert dome["counts"] == {"not_planned": COUNT}
    assert sorted(item["order"] for item in dome["panels"]) == list(range(1, COUNT + 1))
    assert dome["cut_h"]["left"] > 0
    names = {
        item["name"] for item in running_service.http.get(f"/v1/jobs/{dome['id']}/files").json()["files"]
    }
    assert {"element.html", "element.json", "panels.csv", "labels.svg", "problem/element.yaml"} <= names
    page = running_service.http.get(f"/v1/jobs/{dome['id']}/files/element.html")
    assert "sandbox" in page.headers["content-security-policy"]
    listed = running_service.http.get("/v1/elements").json()["elements"]
    assert dome["id"] in [item["id"] for item in listed]
    assert dome["id"] not in [
        item["id"] for item in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]
    ]


def test_fields_are_changed_by_dividing_anew(running_service: ElementService, dome: dict[str, Any]) -> None:
    change = {
        "fields": {"panels.hexagons.count": 30, "thickness_mm": 120, "blocks.0.size_mm": [1300, 1300, 120]}
    }
    answer = running_service.http.post(f"/v1/elements/{dome['id']}/divide", json=change)
    assert answer.status_code == 201, answer.text
    other = running_service.wait_for_division(answer.json()["id"])
    assert len(other["panels"]) == 30
    assert {panel["block_mm"][2] for panel in other["panels"]} == {120.0}
    assert other["fields"]["panels.hexagons.count"] == 30
    back = {
        "fields": {
            "panels.hexagons.count": COUNT,
            "thickness_mm": 150.0,
            "blocks.0.size_mm": [1200, 1000, 150],
        }
    }
    before = len(running_service.team.started)
    again = running_service.http.post(f"/v1/elements/{other['id']}/divide?instead=true", json=back).json()
    assert running_service.http.get(f"/v1/elements/{other['id']}").status_code == 404
    assert len(running_service.wait_for_division(again["id"])["panels"]) == COUNT
    assert len(running_service.team.started) - before <= 1
    third = running_service.http.post(f"/v1/elements/{again['id']}/divide", json=back).json()
    assert (third["state"], third["from_store"]) == ("done", True)


def test_elements_have_titles_tags_and_notes_and_are_found_by_them(
    running_service: ElementService, dome: dict[str, Any]
) -> None:
    url = f"/v1/elements/{dome['id']}"
    said = {"title": "Gewölbe ٣", "tags": ["Halle", "قبو"], "notes": "<b>Dienstag</b>"}
    body = running_service.http.patch(url, json=said).json()
    assert {name: body[name] for name in said} == said
    assert (body["name"], len(body["panels"])) == ("dome", COUNT)
    for asked, is_found in (
        ({"search": "gewölbe dienstag"}, True),
        ({"tag": ["halle", "قبو"]}, True),
        ({"search": "wand"}, False),
        ({"tag": "Hall"}, False),
    ):
        found = running_service.http.get("/v1/elements", params=asked).json()["elements"]
        assert (dome["id"] in [item["id"] for item in found]) is is_found, asked
    page = running_service.http.get("/v1/elements?sort=title&limit=1").json()
    rest = (
        running_service.http.get("/v1/elements", params={"sort": "title", "cursor": page["next"]}).json()
        if page.get("next")  # where no other test has left an element there is none
        else {"elements": []}
    )
    listed = running_service.http.get("/v1/elements?limit=200").json()["elements"]
    assert len(page["elements"] + rest["elements"]) == len(listed)
    again = running_service.http.post(f"{url}/divide", json={"fields": {"panels.hexagons.count": 23}}).json()
    assert {name: again[name] for name in said} == said
    assert (
        running_service.http.patch(url, json={"notes": ""}).json()["title"] == "Gewölbe ٣"
    )  # what is left out stays
    wrong = running_service.http.patch(url, json={"title": "a\u202eb"})
    assert (wrong.status_code, issue_codes(wrong)) == (422, [("service.request", "title")])
    assert running_service.http.patch(f"/v1/elements/{'0' * 32}", json=said).status_code == 404


def test_a_new_division_takes_the_place_of_one_that_runs(
    running_service: ElementService, dome: dict[str, Any]
) -> None:
    running_service.team.hold.set()
    try:
        change = {"fields": {"panels.hexagons.count": 25}}
        first = running_service.http.post(f"/v1/elements/{dome['id']}/divide", json=change).json()["id"]
        while running_service.http.get(f"/v1/elements/{first}").json()["state"] != "running":
            pass
        change = {"fields": {"panels.hexagons.count": 26}}
        second = running_service.http.post(f"/v1/elements/{first}/divide?instead=true", json=change).json()[
            "id"
        ]
        assert running_service.http.get(f"/v1/elements/{first}").status_code == 404
    finally:
        running_service.team.hold.clear()
    assert len(running_service.wait_for_division(second)["panels"]) == 26


def test_panels_are_planned_as_jobs_each_like_one_beside_it(
    running_service: ElementService, tmp_path: Path
) -> None:
    element = running_service.wait_for_division(running_service.upload(tmp_path, name="planned").json()["id"])
    address = f"/v1/elements/{element['id']}"
    subset = [item["id"] for item in element["panels"][:3]]
    answer = running_service.http.post(f"{address}/plan", json={"panels": subset})
    assert answer.status_code == 201, answer.text
    jobs = answer.json()["jobs"]
    assert sorted(item["name"] for item in jobs) == [f"planned-{item}" for item in sorted(subset)]
    for item in jobs:
        assert running_service.wait_for_end(item["id"])["state"] == "verified"
    body = running_service.http.get(address).json()
    assert body["counts"] == {"verified": 3, "not_planned": COUNT - 3}
    planned = {item["id"]: item["job"] for item in body["panels"] if "job" in item}
    assert planned.keys() == set(subset)
    assert not any(item["thumbnail"] for item in body["panels"])
    drawn = running_service.service.files.put(io.BytesIO(b"a picture"))
    with running_service.service.database.write() as db:
        put_files(db, planned[subset[1]], {THUMBNAIL: drawn})
    body = running_service.http.get(address).json()
    assert [item["id"] for item in body["panels"] if item["thumbnail"]] == [subset[1]]
    rest = running_service.http.post(f"{address}/plan", json={}).json()["jobs"]
    assert len(rest) == COUNT - 3
    for item in rest:
        running_service.wait_for_end(item["id"])
    assert running_service.http.get(address).json()["counts"] == {"verified": COUNT}
    assert running_service.http.post(f"{address}/plan", json={}).json()["jobs"] == []
    like = {
        name.rpartition("-")[0]
        for name, files in running_service.dividing.given.items()
        if "like/problem/problem.yaml" in files and "like/plan.json" in files
    }
    assert {item["name"] for item in rest} <= like
    assert not {f"planned-{item}" for item in subset} <= like  # one was first


def test_proven_panels_are_released_by_one_act_and_the_others_named(
    running_service: ElementService, tmp_path: Path
) -> None:
    element = running_service.wait_for_division(
        running_service.upload(tmp_path, name="released").json()["id"]
    )
    address = f"/v1/elements/{element['id']}"
    good, old, bad, other, unplanned = (item["id"] for item in element["panels"][:5])
    (first,) = running_service.http.post(f"{address}/plan", json={"panels": [bad]}).json()["jobs"]
    running_service.wait_for_end(first["id"])
    for item in running_service.http.post(f"{address}/plan", json={"panels": [good, old, other]}).json()[
        "jobs"
    ]:
        running_service.wait_for_end(item["id"])

    def read_element() -> dict[str, Any]:
        return {
            panel["id"]: panel
            for panel in running_service.http.get(address).json()["panels"]
            if "job" in panel
        }

    before = read_element()
    with running_service.service.database.write() as db:  # it was proven, and is not any more
        db.execute(update(JOBS).where(JOBS.c.id == before[bad]["job"]).values(state="unproven"))
    (again,) = running_service.http.post(f"{address}/plan", json={"panels": [old]}).json()["jobs"]
    running_service.wait_for_end(again["id"])
    shown = {item: {"job": panel["job"], "digest": panel["digest"]} for item, panel in before.items()}
    shown[other]["digest"] = "0" * 64
    asked = {"panels": shown, "note": "Nordseite", "name": "Ann"}
    answer = running_service.http.post(f"{address}/release", json=asked)
    assert answer.status_code == 201, answer.text
    body = answer.json()
    (made,) = body["releases"]
    assert (made["panel"], made["by"], made["note"]) == (good, "Ann", "Nordseite")
    assert (made["job"], made["digest"]) == (before[good]["job"], before[good]["digest"])
    assert made["programs"] == {"main.mod": hashlib.sha256(b"MODULE main").hexdigest()}
    why = {item["panel"]: item["issues"][0]["message"] for item in body["refused"]}
    assert why.keys() == {old, bad, other}
    assert f"planned again as job {again['id']}" in why[old]
    assert "state is unproven" in why[bad]
    assert "shown 0000000000000000" in why[other]
    foreign = running_service.post(named_problem("foreign")).json()["id"]
    running_service.wait_for_end(foreign)
    stolen = running_service.http.post(
        f"{address}/release", json={**asked, "panels": {good: {**shown[good], "job": foreign}}}
    )
    assert stolen.status_code == 409
    assert "planned again as job" in stolen.text  # and not a word of the other job
    after = read_element()
    states = {item: after[item].get("release") for item in (good, old, bad, other)}
    assert states == {good: "released", old: "not-released", bad: None, other: "not-released"}
    log = audit.all_entries(running_service.service.database, made["job"], ("released",), 9)
    assert [(item.by, item.about["panel"], item.about["element"]) for item in log] == [
        ("Ann", good, element["id"])
    ]
    twice = running_service.http.post(f"{address}/release", json=asked)
    assert (twice.status_code, {code for code, _ in issue_codes(twice)}) == (409, {"service.release"})
    assert f"{good}: job {made['job']}: released by Ann" in twice.json()["detail"]
    strange = {unplanned: shown[good]}
    for wrong in ({"panels": strange, "name": "Ann"}, {"panels": {}, "name": "Ann"}, {"panels": shown}):
        assert running_service.http.post(f"{address}/release", json=wrong).status_code == 422


def test_what_is_planned_again_while_files_are_looked_at_is_not_released(
    running_service: ElementService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    element = running_service.wait_for_division(running_service.upload(tmp_path, name="looked").json()["id"])
    address, panel = f"/v1/elements/{element['id']}", element["panels"][0]["id"]
    (first,) = running_service.http.post(f"{address}/plan", json={"panels": [panel]}).json()["jobs"]
    shown = {"job": first["id"], "digest": running_service.wait_for_end(first["id"])["digest"]}
    look = running_service.service.releases._verify_job

    def delayed_check(*arguments: Any) -> Any:
        result = look(*arguments)
        running_service.http.post(f"{address}/plan", json={"panels": [panel]})
        return result

    monkeypatch.setattr(running_service.service.releases, "_verify_job", delayed_check)
    answer = running_service.http.post(f"{address}/release", json={"panels": {panel: shown}, "name": "Ann"})
    assert (answer.status_code, issue_codes(answer)) == (409, [("service.release", None)])
    assert not running_service.http.get(f"/v1/jobs/{first['id']}/releases").json()["releases"]


def test_an_elements_panels_count_as_one_job_that_waits(
    running_service: ElementService, dome: dict[str, Any]
) -> None:
    running_service.team.hold.set()
    try:
        assert running_service.http.post(f"/v1/elements/{dome['id']}/plan", json={}).status_code == 201
        waiting = running_service.http.get("/v1/jobs?state=queued&limit=200").json()["jobs"]
        assert len(waiting) > SMALL.open_jobs
        assert running_service.post().status_code == 201
        states = running_service.http.post(f"/v1/elements/{dome['id']}/cancel").json()["counts"]
        assert states["cancelled"] >= COUNT - 2
    finally:
        running_service.team.hold.clear()
    for job in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]:
        running_service.wait_for_end(job["id"])


def test_panels_are_marked_as_by_the_command(running_service: ElementService, tmp_path: Path) -> None:
    element = running_service.wait_for_division(running_service.upload(tmp_path, name="marked").json()["id"])
    address = f"/v1/elements/{element['id']}"
    first, second = (item["id"] for item in element["panels"][:2])
    running_service.http.post(f"{address}/mark", json={"panel": first, "state": "glued"})
    body = running_service.http.post(f"{address}/mark", json={"panel": second, "state": "broken"}).json()
    assert {item["id"]: item["mark"] for item in body["panels"] if "mark" in item} == {
        first: "glued",
        second: "broken",
    }
    assert body["told"][0] == "marked: of 24 panels 1 are glued, 0 cut, 1 broken, 22 to be cut"
    assert any(line.startswith(f"{second} again") for line in body["told"])
    rows = running_service.http.get(f"/v1/jobs/{element['id']}/files/progress.csv").text.splitlines()
    assert rows[0] == "id,state,block_mm"
    assert rows[1].startswith(f"{first},glued,")
    wrong = running_service.http.post(f"{address}/mark", json={"panel": "Z99", "state": "cut"})
    assert (wrong.status_code, issue_codes(wrong)) == (422, [("element.mark", "panel")])
    wrong = running_service.http.post(f"{address}/mark", json={"panel": first, "state": "lost", "more": 1})
    assert issue_codes(wrong) == [("service.request", "state"), ("service.request", "more")]
    for panel in (first, first):  # taken away twice is taken away
        back = running_service.http.post(f"{address}/mark", json={"panel": panel, "state": "open"}).json()
        assert [item["id"] for item in back["panels"] if "mark" in item] == [second]
    running_service.http.post(f"{address}/mark", json={"panel": first, "state": "glued"})
    again = running_service.http.post(f"{address}/divide?instead=true", json={"fields": {}}).json()["id"]
    assert running_service.wait_for_division(again)["counts"] == {
        "not_planned": COUNT,
        "glued": 1,
        "broken": 1,
    }
    assert running_service.http.get(address).status_code == 200
    other = running_service.upload(tmp_path, name="marked").json()["id"]
    assert "glued" not in running_service.wait_for_division(other)["counts"]


def test_a_report_tells_what_became_of_the_panels(running_service: ElementService, tmp_path: Path) -> None:
    element = running_service.wait_for_division(running_service.upload(tmp_path, name="told").json()["id"])
    address = f"/v1/elements/{element['id']}"
    early = running_service.http.post(f"{address}/report")
    assert (early.status_code, issue_codes(early)) == (404, [("service.unknown_file", None)])
    panel = element["panels"][0]["id"]
    running_service.dividing.no_reach.add(f"told-{panel}")
    (job,) = running_service.http.post(f"{address}/plan", json={"panels": [panel]}).json()["jobs"]
    assert running_service.wait_for_end(job["id"])["state"] == "infeasible"
    row = next(item for item in running_service.http.get(address).json()["panels"] if item["id"] == panel)
    assert (row["state"], row["issue"]["code"]) == ("infeasible", "motion.no_reach")
    report = running_service.http.post(f"{address}/report").json()
    assert running_service.wait_for_end(report["id"])["state"] == "done"
    body = running_service.http.get(address).json()
    assert body["report"]["id"] == report["id"]
    page = running_service.http.get(f"/v1/jobs/{report['id']}/files/element.html").text
    assert "motion.no_reach" in page
    rows = running_service.http.get(f"/v1/jobs/{report['id']}/files/report.csv").text
    assert f"{panel},infeasible" in rows
    assert report["id"] not in [
        item["id"] for item in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]
    ]
    newer = running_service.http.post(f"{address}/report").json()["id"]
    assert running_service.wait_for_end(newer)["state"] == "done"
    assert running_service.http.delete(address).status_code == 204
    assert running_service.http.get(f"/v1/jobs/{report['id']}").status_code == 404
    assert running_service.http.get(f"/v1/jobs/{job['id']}").status_code == 200
    for item in (report["id"], newer, element["id"]):  # the older report gave way, the newer went with all
        log = running_service.http.get(f"/v1/audit?job={item}").json()["acts"]
        assert [entry["act"] for entry in reversed(log)] == ["submitted", "deleted"], item


def test_panels_stand_alone_with_what_their_template_names(
    running_service: ElementService, tmp_path: Path
) -> None:
    path = shell(tmp_path, cap(n=9), SHELL, name="alone")
    template = yaml.safe_load((tmp_path / "held.yaml").read_text())
    cell = yaml.safe_load(Path(template["cell"]).read_text())
    mesh = {"kind": "mesh", "file": "post.obj", "unit": "mm"}
    cell["obstacles"].append({"name": "post", "shapes": [mesh]})
    template["cell"] = cell
    files = [
        ("problem", ("element.yaml", path.read_bytes())),
        ("files", ("shell.obj", (tmp_path / "shell.obj").read_bytes())),
        ("files", ("post.obj", b"v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")),
        ("files", ("held.yaml", yaml.safe_dump(template))),
    ]
    element = running_service.wait_for_division(
        running_service.http.post("/v1/elements", files=files).json()["id"]
    )
    assert element["state"] == "done"
    (job,) = running_service.http.post(
        f"/v1/elements/{element['id']}/plan", json={"panels": [element["panels"][0]["id"]]}
    ).json()["jobs"]
    running_service.wait_for_end(job["id"])
    given = running_service.dividing.given[f"{job['name']}-{job['id'][:12]}"]
    problem = yaml.safe_load(given["problem.yaml"])
    name = problem["cell"]["obstacles"][-1]["shapes"][0]["file"]
    assert given[name].startswith(b"v 0 0 0")
    assert not any(str(tmp_path.parent) in content.decode("utf-8", "replace") for content in given.values())


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"thickness_mm": -1}, "problem.field", "thickness_mm"),
        ({"name": "<b>x</b>"}, "problem.field", "name"),
        ({"jobs": [{"problem": "../other.yaml"}]}, "service.not_uploaded", "jobs.0.problem"),
        ({"surface": {"mesh": {"file": "/etc/passwd"}}}, "service.not_uploaded", "surface.mesh.file"),
    ],
)
def test_what_cannot_be_read_is_refused(
    running_service: ElementService, tmp_path: Path, changes: dict[str, Any], code: str, field: str
) -> None:
    answer = running_service.upload(tmp_path, **changes)
    assert answer.status_code == 422
    assert (code, field) in issue_codes(answer)
    assert str(tmp_path) not in answer.text


def test_what_cannot_be_divided_ends_with_its_issues(running_service: ElementService, tmp_path: Path) -> None:
    answer = running_service.upload(tmp_path, name="thin", blocks=[{"size_mm": [60, 60, 150]}])
    found = running_service.wait_for_division(answer.json()["id"])
    assert found["state"] == "bad_input"
    assert found["issues"][0]["code"] == "element.block"
    assert found["panels"] == []
    refused = running_service.http.post(f"/v1/elements/{found['id']}/plan", json={})
    assert (refused.status_code, issue_codes(refused)) == (404, [("service.unknown_file", None)])


def test_raw_blocks_have_jobs_with_what_their_template_names(
    running_service: ElementService, tmp_path: Path
) -> None:
    saw = {**SAW, "cell": "../irb4600_bow.yaml"}
    raw = {"sizes": [{"size_mm": [2400, 1200, 170], "foam": "eps_a120"}], "kerf_mm": 2}
    path = shell(tmp_path, cap(n=9), SHELL, name="sawn", raw_blocks=raw, cut_blocks={"problem": "saw.yaml"})
    cells = ROOT / "problems" / "cells"
    held = yaml.safe_load((tmp_path / "held.yaml").read_text()) | {"cell": "two_irb4600_bow_gripper.yaml"}
    files = [
        ("problem", ("element.yaml", path.read_bytes())),
        ("files", ("shell.obj", (tmp_path / "shell.obj").read_bytes())),
        ("files", ("held.yaml", yaml.safe_dump(held))),
        ("files", ("two_irb4600_bow_gripper.yaml", (cells / "two_irb4600_bow_gripper.yaml").read_bytes())),
        ("files", ("irb4600_bow.yaml", (cells / "irb4600_bow.yaml").read_bytes())),
    ]
    missing = running_service.http.post("/v1/elements", files=files)
    assert (missing.status_code, issue_codes(missing)) == (
        422,
        [("service.not_uploaded", "cut_blocks.problem")],
    )
    files.append(("files", ("saw.yaml", yaml.safe_dump(saw))))
    found = running_service.wait_for_division(
        running_service.http.post("/v1/elements", files=files).json()["id"]
    )
    assert found["state"] == "done"
    assert found["fields"]["raw_blocks.sizes.0.size_mm"] == [2400.0, 1200.0, 170.0]
    names = [
        file["name"] for file in running_service.http.get(f"/v1/jobs/{found['id']}/files").json()["files"]
    ]
    jobs = [name for name in names if name.startswith("blocks/")]
    problem = yaml.safe_load(running_service.http.get(f"/v1/jobs/{found['id']}/files/{jobs[0]}").text)
    assert problem["cell"]["arms"][0]["robot"] == "irb4600_40"


def test_jobs_of_raw_blocks_are_jobs_and_panels_are_those_of_their_rows(
    running_service: ElementService, tmp_path: Path
) -> None:
    element_file, *others = write_small_shell(tmp_path, name="rows")
    files = [("problem", (element_file.name, element_file.read_bytes()))]
    files += [("files", (path.name, path.read_bytes())) for path in others]
    posted = running_service.http.post("/v1/elements", files=files)
    assert posted.status_code == 201, posted.text
    element = running_service.wait_for_division(posted.json()["id"])
    address = f"/v1/elements/{element['id']}"
    jobs = {item["id"]: item for item in element["block_jobs"]}
    rows = [item for item in element["block_jobs"] if item["panels"]]
    assert sorted(panel for row in rows for panel in row["panels"]) == [
        item["id"] for item in element["panels"]
    ]
    row, other = rows[:2]
    apart = next(item["id"] for item in element["block_jobs"] if not item["panels"])
    cut_in = {item["id"]: item["cut_in"] for item in element["panels"]}
    assert {cut_in[panel] for panel in row["panels"]} == {row["id"]}
    assert element["cut_h"]["robot"] == pytest.approx(
        sum(item["cut_min"]["robot"] for item in jobs.values()) / 60.0, abs=1e-3
    )
    running_service.dividing.no_reach.add(f"rows-{other['id']}")
    (bad,) = running_service.http.post(f"{address}/plan", json={"panels": [other["id"]]}).json()["jobs"]
    running_service.wait_for_end(bad["id"])
    report = running_service.http.post(f"{address}/report").json()["id"]
    assert running_service.wait_for_end(report)["state"] == "done"
    table = running_service.http.get(f"/v1/jobs/{report}/files/report.csv").text
    assert f"{other['panels'][0]},infeasible" in table
    subset = [apart, row["id"]]
    made = running_service.http.post(f"{address}/plan", json={"panels": subset}).json()["jobs"]
    assert sorted(item["name"] for item in made) == sorted(f"rows-{item}" for item in subset)
    for item in made:
        running_service.wait_for_end(item["id"])
    given = running_service.dividing.given
    (sent,) = (files for name, files in given.items() if name.startswith(f"rows-{row['id']}-"))
    assert yaml.safe_load(sent["problem.yaml"])["name"] == f"rows_{row['id'].replace('-', '_')}"

    def panels() -> dict[str, dict[str, Any]]:
        return {panel["id"]: panel for panel in running_service.http.get(address).json()["panels"]}

    first, *rest = row["panels"]
    assert {panels()[item]["state"] for item in row["panels"]} == {"verified"}
    assert {panels()[item]["issue"]["code"] for item in other["panels"]} == {"motion.no_reach"}
    left = len(jobs) - 3
    assert len(running_service.http.post(f"{address}/plan", json={}).json()["jobs"]) == left
    for item in running_service.http.get("/v1/jobs?limit=200").json()["jobs"]:
        running_service.wait_for_end(item["id"])

    shown = {"job": panels()[first]["job"], "digest": "0" * 64}
    refused = running_service.http.post(f"{address}/release", json={"panels": {first: shown}, "name": "Ann"})
    assert refused.status_code == 422
    assert f"{first} in {row['id']}. Release that job." in refused.json()["issues"][0]["hint"]
    now = {item["id"]: item for item in running_service.http.get(address).json()["block_jobs"]}
    shown = {"job": now[row["id"]]["job"], "digest": now[row["id"]]["digest"]}
    released = running_service.http.post(
        f"{address}/release", json={"panels": {row["id"]: shown}, "name": "Ann"}
    )
    assert released.status_code == 201
    assert panels()[first]["release"] == "released"

    running_service.http.post(f"{address}/mark", json={"panel": first, "state": "broken"})
    marked = running_service.http.post(f"{address}/mark", json={"panel": row["id"], "state": "cut"}).json()
    marks = {item["id"]: item.get("mark") for item in marked["panels"]}
    assert [marks[item] for item in row["panels"]] == ["broken", *("cut" for _ in rest)]
    assert next(item for item in marked["block_jobs"] if item["id"] == row["id"])["mark"] == "cut"
    (again,) = (line for line in marked["told"] if line.startswith(f"{first} again"))
    assert f"again/{first}.yaml" in again
    (own,) = running_service.http.post(f"{address}/plan", json={"panels": [first]}).json()["jobs"]
    assert running_service.wait_for_end(own["id"])["state"] == "verified"
    assert (panels()[first]["job"], panels()[first].get("cut_in")) == (own["id"], None)
    assert panels()[rest[0]]["job"] == now[row["id"]]["job"]


@pytest.mark.parametrize("name", ["../shell.obj", "/etc/shell.obj", "..\\shell.obj", "a/../../shell.obj"])
def test_names_of_uploads_lead_nowhere(running_service: ElementService, tmp_path: Path, name: str) -> None:
    """A surface of such a name is refused, or found by its last step: nothing is read or written beside."""
    path = shell(tmp_path, cap(n=9), SHELL, name="named", surface={"mesh": {"file": name, "unit": "mm"}})
    template = yaml.safe_load((tmp_path / "held.yaml").read_text())
    cell = yaml.safe_load(Path(template["cell"]).read_text())
    files = [
        ("problem", ("element.yaml", path.read_bytes())),
        ("files", (name, (tmp_path / "shell.obj").read_bytes())),
        ("files", ("held.yaml", yaml.safe_dump({**template, "cell": cell}))),
    ]
    before = sorted(running_service.service.options.data.parent.rglob("shell.obj"))
    answer = running_service.http.post("/v1/elements", files=files)
    if answer.status_code != 422:
        assert running_service.wait_for_division(answer.json()["id"])["state"] == "done"
    assert sorted(running_service.service.options.data.parent.rglob("shell.obj")) == before


def test_an_element_is_deleted_while_it_is_divided(
    running_service: ElementService, dome: dict[str, Any]
) -> None:
    running_service.team.hold.set()
    try:
        change = {"fields": {"panels.hexagons.count": 27}}
        made = running_service.http.post(f"/v1/elements/{dome['id']}/divide", json=change).json()["id"]
        while running_service.http.get(f"/v1/elements/{made}").json()["state"] != "running":
            pass
        assert running_service.http.delete(f"/v1/elements/{made}").status_code == 204
        for ask in (
            running_service.http.get(f"/v1/elements/{made}"),
            running_service.http.delete(f"/v1/elements/{made}"),
            running_service.http.post(f"/v1/elements/{made}/divide", json=change),
            running_service.http.post(f"/v1/elements/{made}/mark", json={"panel": "A01", "state": "cut"}),
        ):
            assert (ask.status_code, issue_codes(ask)) == (404, [("service.unknown_job", None)])
    finally:
        running_service.team.hold.clear()
    assert len(running_service.http.get(f"/v1/elements/{dome['id']}").json()["panels"]) == COUNT


def test_two_who_change_one_element_each_have_an_answer(
    running_service: ElementService, tmp_path: Path
) -> None:
    """The slower request gets its own element, or the answer that the element is gone; then it made none."""
    element = running_service.wait_for_division(running_service.upload(tmp_path, name="shared").json()["id"])[
        "id"
    ]
    address = f"/v1/elements/{element}/divide?instead=true"
    counts = (28, 29)
    with ThreadPoolExecutor(2) as both:
        answers = list(
            both.map(
                lambda count: running_service.http.post(
                    address, json={"fields": {"panels.hexagons.count": count}}
                ),
                counts,
            )
        )
    assert {item.status_code for item in answers} <= {201, 404}
    made = [(n, item.json()["id"]) for n, item in zip(counts, answers, strict=True) if item.is_success]
    listed = running_service.http.get("/v1/elements?limit=200").json()["elements"]
    assert {item["id"] for item in listed if item["name"] == "shared"} == {other for _, other in made}
    assert made
    for count, other in made:
        assert len(running_service.wait_for_division(other)["panels"]) == count
    assert running_service.http.get(f"/v1/elements/{element}").status_code == 404


def test_an_element_that_goes_while_it_is_changed_is_none(
    running_service: ElementService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer is 404, not a server error, if it is deleted before its files are looked up."""
    element = running_service.upload(tmp_path, name="going").json()["id"]
    address = f"/v1/elements/{running_service.wait_for_division(element)['id']}"
    files, gone = running_service.service.jobs.files, []

    def late(job: str) -> Any:
        gone.append(running_service.http.delete(address).status_code)
        return files(job)

    monkeypatch.setattr(running_service.service.jobs, "files", late)
    answer = running_service.http.post(f"{address}/divide", json={"fields": {"panels.hexagons.count": 28}})
    assert (gone, answer.status_code) == ([204], 404)


def test_bad_requests_are_told_by_field(running_service: ElementService, dome: dict[str, Any]) -> None:
    address = f"/v1/elements/{dome['id']}"
    wrong = running_service.http.post(f"{address}/divide", json={"fields": {"nothing.at..all": 1}})
    assert (wrong.status_code, issue_codes(wrong)) == (422, [("service.request", "nothing.at..all")])
    wrong = running_service.http.post(f"{address}/divide", json={"fields": {"panels.hexagons.count": "many"}})
    assert issue_codes(wrong) == [("problem.field", "panels.hexagons.count")]
    for count in (1, 100_000):
        wrong = running_service.http.post(
            f"{address}/divide", json={"fields": {"panels.hexagons.count": count}}
        )
        assert (wrong.status_code, issue_codes(wrong)) == (422, [("problem.field", "panels.hexagons.count")])
    wrong = running_service.http.post(
        f"{address}/divide", json={"fields": {"surface.mesh.file": "/etc/passwd"}}
    )
    assert issue_codes(wrong) == [("service.not_uploaded", "surface.mesh.file")]
    wrong = running_service.http.post(f"{address}/plan", json={"panels": ["A01", "<b>"]})
    assert (wrong.status_code, issue_codes(wrong)) == (422, [("service.request", "panels")])
    wrong = running_service.http.post(f"{address}/plan", content=b'{"panels": [' + b'"A",' * 400_000)
    assert (wrong.status_code, issue_codes(wrong)) == (413, [("service.too_large", "body")])
    wrong = running_service.http.post(f"{address}/plan", content=b"no JSON")
    assert issue_codes(wrong) == [("service.request", "body")]


HOSTILE = {
    "markup": "<img src=x onerror=alert(1)>",
    "a letter that turns": "a\u202eb",
    "a zero byte": "a\0b",
    "a blank letter": "\u3164",
    "much": "x" * 10_000,
    "marks": "a" + "\u0301" * 500,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_odd_words_where_an_element_wants_names_are_told_as_plain_text(
    running_service: ElementService, dome: dict[str, Any], name: str
) -> None:
    """Of panels, states, fields, values, tags to search for, and the element itself."""
    word, way = HOSTILE[name], f"/v1/elements/{dome['id']}"
    before = running_service.http.get(way).json()
    for path, expected_text in (
        ("mark", {"panel": word, "state": "cut"}),
        ("mark", {"panel": "A01", "state": word}),
        ("plan", {"panels": [word]}),
        ("release", {"panels": {word: {"job": "0" * 32, "digest": "0" * 64}}, "name": "Ann"}),
        ("divide", {"fields": {word: 3}}),
        ("divide", {"fields": {"thickness_mm": word}}),
    ):
        answer = running_service.http.post(f"{way}/{path}", json=expected_text)
        assert answer.status_code == 422, (path, expected_text)
        told = "".join(issue["message"] for issue in answer.json()["issues"])
        assert len(told) < 2500 and not set("\u202e\0") & set(told), (path, told)
    assert running_service.http.get(way).json() == before


def test_other_peoples_elements_are_404(tmp_path: Path) -> None:
    data = tmp_path / "data"
    with ElementService(data, examiners=1) as running_service:
        auth = Auth(running_service.service.database)
        ann, bob = ({"Authorization": f"Bearer {auth.create_token(name)}"} for name in ("ann", "bob"))
        running_service.http.headers.update(ann)
        element = running_service.upload(tmp_path / "shell").json()["id"]
        assert running_service.wait_for_division(element)["state"] == "done"
        job = running_service.wait_for_end(running_service.post().json()["id"])["id"]
        running_service.http.headers.update(bob)
        for ask in (
            running_service.http.get(f"/v1/elements/{element}"),
            running_service.http.post(f"/v1/elements/{element}/divide", json={"fields": {}}),
            running_service.http.post(f"/v1/elements/{element}/plan", json={}),
            running_service.http.post(f"/v1/elements/{element}/mark", json={"panel": "A01", "state": "cut"}),
            running_service.http.post(f"/v1/elements/{element}/report"),
            running_service.http.post(f"/v1/elements/{element}/cancel"),
            running_service.http.delete(f"/v1/elements/{element}"),
            running_service.http.get("/v1/elements/..%2f"),
        ):
            assert ask.status_code == 404
        assert running_service.http.get("/v1/elements").json() == {"elements": []}
        assert running_service.http.get(f"/v1/jobs/{element}/files/element.html").status_code == 404
        running_service.http.headers.update(ann)
        assert running_service.http.get(f"/v1/elements/{job}").status_code == 404  # a job is no element


def test_a_division_survives_a_restart(tmp_path: Path) -> None:
    with ElementService(tmp_path / "data", examiners=1) as first:
        first.team.hold.set()
        element = first.upload(tmp_path / "shell").json()["id"]
        while first.http.get(f"/v1/elements/{element}").json()["state"] != "running":
            pass
        first.service.runner.stop()  # told to stop in the middle
    with ElementService(tmp_path / "data", examiners=1) as second:
        result = second.wait_for_division(element)
        assert (result["state"], result["attempts"], len(result["panels"])) == ("done", 1, COUNT)


def test_a_template_may_stand_in_the_element_file(tmp_path: Path) -> None:
    from planner.batch.division import divide_element
    from planner.element import element_file

    path = shell(tmp_path, cap(n=9), SHELL)
    apart = divide_element(element_file.read_element(path), lambda stage, fraction: None)
    data = yaml.safe_load(path.read_text())
    data["jobs"] = [{"problem": yaml.safe_load((tmp_path / "held.yaml").read_text())}]
    path.write_text(yaml.safe_dump(data))
    inside = divide_element(element_file.read_element(path), lambda stage, fraction: None)
    panels = [name for name in apart.files if name.startswith("panels/")]
    assert len(panels) == COUNT
    assert all(inside.files[name] == apart.files[name] for name in panels)
    assert json.loads(inside.files["element.json"])["panels"][0]["job"] == "jobs.0"
