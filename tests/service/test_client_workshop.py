"""Client calls of workshop scripts besides single jobs.

Batches, the queue, elements with their panels, releases and marks, and drafts, against the service's own app
over HTTP. Its team is a fake.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn
import yaml

import planner
from planner.service import tandem_client
from tests import small_problem
from tests.element.shells import cap, shell
from tests.service.support import TABLE, free_port, named_problem, wait_until
from tests.service.test_elements import ElementService
from tests.service.test_tandem_client import readme_blocks, refusal

COUNT = 24
FILES = {"targets.csv": TABLE}


@pytest.fixture(scope="module")
def running_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ElementService, str]]:
    made, port = ElementService(tmp_path_factory.mktemp("workshop") / "data", examiners=1), free_port()
    server = uvicorn.Server(uvicorn.Config(made.http.app, port=port, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    wait_until(lambda: server.started)
    yield made, f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def client(running_service: tuple[ElementService, str]) -> tandem_client.Client:
    return tandem_client.Client(running_service[1])


@pytest.fixture(scope="module")
def dome(client: tandem_client.Client, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("dome")
    path = shell(folder, cap(n=9), {"count": COUNT, "off_surface_mm": 60}, name="dome")
    template = yaml.safe_load((folder / "held.yaml").read_text())
    cell = Path(template["cell"])
    held = yaml.safe_dump({**template, "cell": cell.name}).encode()
    files: dict[str, Any] = {"shell.obj": folder / "shell.obj", "held.yaml": held, cell.name: cell}
    element = client.divide(path, files)
    assert client.wait(element, timeout_s=120)["state"] == "done"
    return element


def test_a_batch_makes_a_job_of_each_problem_or_none(client: tandem_client.Client, tmp_path: Path) -> None:
    problems = {f"{name}.yaml": named_problem(name).encode() for name in ("first", "second", "same")}
    problems["other.yaml"] = problems["same.yaml"]
    jobs = client.batch(problems, "Wand ٣", FILES, key="batch-1")
    assert client.batch(problems, "Wand ٣", FILES, key="batch-1") == jobs
    told = [client.job(item) for item in jobs]
    assert [(item["name"], item["title"]) for item in told] == [
        ("first", ""),
        ("second", ""),
        ("same", "same: same.yaml"),
        ("same", "same: other.yaml"),
    ]
    assert {item["id"] for item in client.jobs(tags=["wand ٣"])} == set(jobs)
    (issue,) = refusal(lambda: client.batch({**problems, "a.yaml": b"{}"}, "Wand ٣", FILES, key="batch-1"))
    assert issue.code == "service.idempotency"

    wrong = {
        "good": named_problem("good").encode(),
        "bad": named_problem("bad").encode() + b"\nnonsense: 1\n",
        "none": b"]",
    }
    issues = refusal(lambda: client.batch(wrong, files=FILES))
    assert [(item.message.partition(": ")[0], item.data["of"]) for item in issues] == [
        ("bad", 1),
        ("none", 2),
    ]
    with pytest.raises(planner.TandemError) as caught:
        planner.Client(client._url).batch(wrong, files=FILES)
    assert [item.message.partition(": ")[0] for item in caught.value.issues] == ["bad", "none"]

    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(named_problem(name))
    paths = [str(tmp_path / "one.yaml"), tmp_path / "two.yaml"]
    draft = client.keep_draft(tmp_path / "one.yaml")
    made = client.batch(paths, files=FILES, drafts=[(draft["id"], 1)])
    assert [client.job(item)["name"] for item in made] == ["one", "two"]
    (kept,) = client.drafts()
    assert (kept["sent"], kept["job"]) == (1, made[0])
    client.delete_draft(draft["id"])


def test_a_key_whose_jobs_are_gone_in_part_is_told(client: tandem_client.Client, tmp_path: Path) -> None:
    """Else ids would stand for other problems than they are of."""
    problems = {name: named_problem(name).encode() for name in ("left_1", "left_2")}
    path = small_problem.write(tmp_path, named_problem("left_3"))
    field = "operations.0.feed_mm_s"
    for ask in (
        lambda: client.batch(problems, files=FILES, key="left-1"),
        lambda: client.sweep(path, field, [20, 30], files=FILES, key="left-2"),
    ):
        first, second = ask()
        client.wait(first)
        client.delete(first)
        (issue,) = refusal(ask)
        assert (issue.code, issue.field, issue.data["jobs"]) == ("service.idempotency", "key", [second])
        assert "created 2 jobs, remaining: 1" in issue.message
        client.delete(second)
        assert len(ask()) == 2


def test_what_is_half_a_character_is_told(client: tandem_client.Client) -> None:
    """Names of files that are no UTF-8 have some on Linux."""
    half = "a\udce4b"
    problem = {half: named_problem("half").encode()}
    for asked, code in (
        (lambda: client.batch(problem, files=FILES), "service.file_name"),
        (lambda: client.submit(problem[half], files={half: b"1"}), "service.file_name"),
        (lambda: list(client.jobs(half)), "service.request"),
        (lambda: client.keep_draft(b"", half), "service.request"),
        (lambda: client.job(half), "service.unknown_job"),
    ):
        (issue,) = refusal(asked)
        assert issue.code == code
        str(issue).encode()


def test_problems_of_a_batch_share_the_files_that_they_name(
    client: tandem_client.Client, tmp_path: Path
) -> None:
    """A table that several name goes once, so that fifty problems may; others keep apart."""
    table = tmp_path / "targets.csv"
    table.write_bytes(TABLE)
    base = yaml.safe_load(small_problem.PROBLEM)
    base["operations"][0]["file"] = table
    problems = {f"{number}": {**base, "name": f"many_{number}"} for number in range(3)}
    other = tmp_path / "other" / "targets.csv"
    other.parent.mkdir()
    other.write_bytes(TABLE.replace(b",500,", b",520,"))
    problems["higher"] = {**base, "operations": [{**base["operations"][0], "file": other}], "name": "higher"}
    texts, sent = client._bundles(problems, {"more.csv": b"1"})
    assert (len(texts), len(sent)) == (4, 3)
    jobs = client.batch(problems)
    for job, content in zip(jobs, [table.read_bytes()] * 3 + [other.read_bytes()], strict=True):
        files = client.files(job)
        assert [files[name] for name in files if "targets" in name] == [content]
    loaded = {
        "a": planner.load(small_problem.write(tmp_path, named_problem("a"))),
        "b": {**base, "name": "b"},
    }
    both = planner.Client(client._url)
    assert [both.job(item)["name"] for item in both.batch(loaded)] == ["a", "b"]


@pytest.mark.parametrize(
    ("problems", "expected_issues"),
    [
        ("a.yaml", [("problem.field", "problems: give {name: problem}", None)]),
        ([b"{}"], [("problem.field", "problems: give {name: problem}", None)]),
        (["x/a.yaml", "y/a.yaml"], [("service.file_name", "two problems have the name 'a.yaml'", 1)]),
        ({"a": {"b": float("nan")}, "c": {}}, [("problem.not_finite", "a: b: got nan", 0)]),
        ({"a": {}, "c": 5}, [("problem.field", "c: problem: got a int", 1)]),
    ],
)
def test_a_batch_that_cannot_be_sent_is_told_before(
    problems: Any,
    expected_issues: list[tuple[str, str, int | None]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.yaml").write_text("{}")
    issues = refusal(lambda: tandem_client.Client("http://127.0.0.1:1").batch(problems))
    assert len(issues) == len(expected_issues)
    for issue, (code, begin, of) in zip(issues, expected_issues, strict=True):
        assert (issue.code, issue.data.get("of")) == (code, of)
        assert issue.message.startswith(begin), issue.message
    with pytest.raises(planner.TandemError) as caught:
        planner.Client("http://127.0.0.1:1").batch(problems)
    assert [item.code for item in caught.value.issues] == [item[0] for item in expected_issues]


def test_the_queue_is_seen_and_its_order_changed(
    running_service: tuple[ElementService, str], client: tandem_client.Client
) -> None:
    team = running_service[0].team
    wait_until(lambda: not list(client.jobs(states=["queued", "running"])))
    team.hold.set()
    try:
        names = [f"waits_{number}" for number in range(6)]
        jobs = client.batch({name: named_problem(name).encode() for name in names}, "queue", FILES)
        wait_until(lambda: client.job(jobs[0])["state"] == "running")
        waiting = [item["id"] for item in client.jobs(tags=["queue"], sort="turn", states=["queued"])]
        assert len(waiting) >= 2 and waiting == [item for item in jobs if item in waiting]
        client.first(waiting[-1])
        turns = [item["id"] for item in client.jobs(tags=["queue"], sort="turn", states=["queued"])]
        assert turns == [waiting[-1], *waiting[:-1]]
        assert client.estimate(waiting[0])["like"] >= 0
        for job in waiting:
            client.cancel(job)
        (issue,) = refusal(lambda: client.first(waiting[0]))
        assert issue.code == "service.state"
    finally:
        team.hold.clear()
    for job in jobs:
        client.wait(job, timeout_s=60)
    assert client.delete_jobs([*jobs, "0" * 32]) == ["0" * 32]
    assert client.delete_jobs("0" * 32) == ["0" * 32]
    assert list(client.jobs(tags=["queue"])) == []
    acts = [(item["act"], item["job"]) for item in client.audit(acts=["cancelled"])]
    assert {("cancelled", item) for item in waiting} == set(acts)


def test_elements_are_called_found_and_divided_anew(client: tandem_client.Client, dome: str) -> None:
    told = client.describe_element(dome, "Gewölbe ٣", ["Halle"], "Dienstag")
    assert (told["title"], told["tags"], told["notes"]) == ("Gewölbe ٣", ["Halle"], "Dienstag")
    assert client.describe_element(dome, notes="")["title"] == "Gewölbe ٣"
    assert [element["id"] for element in client.elements("gewölbe", ["halle"], "title")] == [dome]
    assert list(client.elements("nothing such")) == []
    other = client.divide_anew(dome, {"panels.hexagons.count": COUNT + 2}, key="anew-1")
    assert client.divide_anew(dome, {"panels.hexagons.count": COUNT + 2}, key="anew-1") == other
    assert client.wait(other, timeout_s=120)["state"] == "done"
    assert len(client.element(other)["panels"]) == COUNT + 2
    assert {element["id"] for element in client.elements()} == {dome, other}
    last = client.divide_anew(other, {"panels.hexagons.count": COUNT}, instead=True)
    (issue,) = refusal(lambda: client.element(other))
    assert issue.code == "service.unknown_job"
    (issue,) = refusal(lambda: client.divide_anew(last, {"surface.mesh.file": Path(__file__)}))
    assert issue.field == "fields"
    client.cancel_element(last)
    client.delete_element(last)
    assert [element["id"] for element in client.elements()] == [dome]


def test_panels_are_released_marked_and_reported(client: tandem_client.Client, dome: str) -> None:
    names = [item["id"] for item in client.element(dome)["panels"][:3]]
    for job in client.plan_panels(dome, names):
        assert client.wait(job, timeout_s=60)["state"] == "verified"
    rows = [item for item in client.element(dome)["panels"] if item["state"] == "verified"]
    assert sorted(item["id"] for item in rows) == sorted(names)
    (again,) = client.plan_panels(dome, [rows[0]["id"]])
    client.wait(again, timeout_s=60)
    told = client.release_panels(dome, rows, "Nordseite", name="Ann")
    assert sorted(item["panel"] for item in told["releases"]) == sorted(item["id"] for item in rows[1:])
    (refused,) = told["refused"]
    assert refused["panel"] == rows[0]["id"]
    assert "planned again as job" in refused["issues"][0]["message"]
    assert client.releases(rows[1]["job"])[0]["note"] == "Nordseite"
    issues = refusal(lambda: client.release_panels(dome, rows, name="Ann"))
    assert {item.code for item in issues} == {"service.release"}
    unplanned = next(item for item in client.element(dome)["panels"] if item["state"] == "not_planned")
    assert refusal(lambda: client.release_panels(dome, [unplanned], name="Ann"))[0].code == "service.request"
    (issue,) = refusal(lambda: client.release_panels(dome, names, name="Ann"))  # type: ignore[arg-type]
    assert issue.field == "panels"
    marked = client.mark_panel(dome, names[0], "cut")
    assert {item["id"]: item["mark"] for item in marked["panels"] if "mark" in item} == {names[0]: "cut"}
    report = client.report_panels(dome, key="report-1")
    assert client.report_panels(dome, key="report-1") == report
    assert client.element(dome)["report"]["id"] == report  # of pretended plans, of which none can be made


def test_the_script_of_its_page_plans_a_wall_and_releases_a_dome(
    client: tandem_client.Client,
    dome: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The script runs unchanged; without tokens, a name states who releases."""
    (tmp_path / "wall" / "files").mkdir(parents=True)
    (tmp_path / "wall" / "files" / "targets.csv").write_bytes(TABLE)
    for name in ("b", "a"):
        (tmp_path / "wall" / f"{name}.yaml").write_text(named_problem(f"wall_{name}"))
    (panel,) = client.plan_panels(dome, [client.element(dome)["panels"][-1]["id"]])
    client.wait(panel, timeout_s=60)
    monkeypatch.chdir(tmp_path)
    script = readme_blocks()[1]
    assert script.count('"seen on Tuesday")') == 1
    exec(
        script.replace('"seen on Tuesday")', '"seen on Tuesday", "Ann")'),
        {"client": client, "dome": dome, "Path": Path},
    )
    assert capsys.readouterr().out == "['verified', 'verified'] []\n"
    assert client.job(panel)["release"]["note"] == "seen on Tuesday"
    assert [job["name"] for job in client.jobs(tags=["north wall"], sort="title")] == ["wall_a", "wall_b"]


def test_drafts_are_renamed_and_noted_as_sent(client: tandem_client.Client) -> None:
    made = client.keep_draft(named_problem("noted").encode(), "Entwurf", files=FILES)
    assert (
        client.save_draft(made["id"], 1, named_problem("noted2").encode(), title="Wand 7")["title"]
        == "Wand 7"
    )
    assert client.rename_draft(made["id"], "Gewölbe ٣")["title"] == "Gewölbe ٣"
    versions = client.versions(made["id"])
    assert [(version["number"], version["files"]) for version in versions] == [
        (2, ["targets.csv"]),
        (1, ["targets.csv"]),
    ]
    text, files = client.draft(made["id"], 2)
    job = client.submit(text, files=files)
    told = client.mark_sent(made["id"], 2, job)
    assert (told["version"], told["sent"], told["job"]) == (2, 2, job)
    client.delete_draft(made["id"])
    for asked in (
        lambda: client.mark_sent(made["id"], 2, job),
        lambda: client.rename_draft(made["id"], "x"),
        lambda: client.versions(made["id"]),
    ):
        (issue,) = refusal(asked)
        assert issue.code == "service.draft"


def test_a_service_without_these_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    client = tandem_client.Client("http://127.0.0.1:1")
    said = {"status": "ok", "version": "0.1.0", "api": 10, "api_oldest": 1}
    monkeypatch.setattr(client, "service", lambda: said)
    for asked in (
        lambda: client.batch({"a": b"{}"}),
        lambda: client.release_panels("e", []),
        lambda: client.describe_element("e", "x"),
        lambda: list(client.elements("x")),
        lambda: list(client.jobs(sort="turn")),
        lambda: client.first("j"),
        lambda: client.estimate("j"),
        lambda: client.delete_jobs(["j"]),
        lambda: client.mark_sent("d", 1, "j"),
    ):
        (issue,) = refusal(asked)
        assert issue.code == "service.version"
