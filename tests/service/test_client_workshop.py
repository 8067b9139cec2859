"""What scripts of a workshop ask by the client beside single jobs: batches, the queue, elements with their
panels, releases and marks, drafts. Against the service's own app over HTTP; its team pretends to plan."""

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
from tests.service.support import TABLE, free_port, named, until
from tests.service.test_elements import Elements
from tests.service.test_tandem_client import readme_blocks, refusal

COUNT = 24
FILES = {"targets.csv": TABLE}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Elements, str]]:
    made, port = Elements(tmp_path_factory.mktemp("workshop") / "data", examiners=1), free_port()
    server = uvicorn.Server(uvicorn.Config(made.http.app, port=port, log_level="error"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    until(lambda: server.started)
    yield made, f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join()


@pytest.fixture(scope="module")
def client(here: tuple[Elements, str]) -> tandem_client.Client:
    return tandem_client.Client(here[1])


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
    problems = {f"{name}.yaml": named(name).encode() for name in ("first", "second", "same")}
    problems["other.yaml"] = problems["same.yaml"]
    jobs = client.batch(problems, "Wand ٣", FILES, key="batch-1")
    assert client.batch(problems, "Wand ٣", FILES, key="batch-1") == jobs
    told = [client.job(one) for one in jobs]
    assert [(one["name"], one["title"]) for one in told] == [
        ("first", ""),
        ("second", ""),
        ("same", "same: same.yaml"),
        ("same", "same: other.yaml"),
    ]
    assert {one["id"] for one in client.jobs(tags=["wand ٣"])} == set(jobs)
    (issue,) = refusal(lambda: client.batch({**problems, "a.yaml": b"{}"}, "Wand ٣", FILES, key="batch-1"))
    assert issue.code == "service.idempotency"

    wrong = {"good": named("good").encode(), "bad": named("bad").encode() + b"\nnonsense: 1\n", "none": b"]"}
    issues = refusal(lambda: client.batch(wrong, files=FILES))
    assert [(one.message.partition(": ")[0], one.data["of"]) for one in issues] == [("bad", 1), ("none", 2)]
    with pytest.raises(planner.TandemError) as caught:
        planner.Client(client._url).batch(wrong, files=FILES)
    assert [one.message.partition(": ")[0] for one in caught.value.issues] == ["bad", "none"]

    for name in ("one", "two"):
        (tmp_path / f"{name}.yaml").write_text(named(name))
    paths = [str(tmp_path / "one.yaml"), tmp_path / "two.yaml"]
    draft = client.keep_draft(tmp_path / "one.yaml")
    made = client.batch(paths, files=FILES, drafts=[(draft["id"], 1)])
    assert [client.job(one)["name"] for one in made] == ["one", "two"]
    (kept,) = client.drafts()
    assert (kept["sent"], kept["job"]) == (1, made[0])
    client.delete_draft(draft["id"])


def test_a_key_whose_jobs_are_gone_in_part_is_told(client: tandem_client.Client, tmp_path: Path) -> None:
    """Else ids would stand for other problems than they are of."""
    problems = {name: named(name).encode() for name in ("left_1", "left_2")}
    path = small_problem.write(tmp_path, named("left_3"))
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
        assert "made 2 jobs before; left of them: 1" in issue.message
        client.delete(second)
        assert len(ask()) == 2


def test_what_is_half_a_character_is_told(client: tandem_client.Client) -> None:
    """Names of files that are no UTF-8 have some on Linux."""
    half = "a\udce4b"
    problem = {half: named("half").encode()}
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
    loaded = {"a": planner.load(small_problem.write(tmp_path, named("a"))), "b": {**base, "name": "b"}}
    both = planner.Client(client._url)
    assert [both.job(one)["name"] for one in both.batch(loaded)] == ["a", "b"]


@pytest.mark.parametrize(
    ("problems", "said"),
    [
        ("a.yaml", [("problem.field", "problems: give {name: problem}", None)]),
        ([b"{}"], [("problem.field", "problems: give {name: problem}", None)]),
        (["x/a.yaml", "y/a.yaml"], [("service.file_name", "two problems have the name 'a.yaml'", 1)]),
        ({"a": {"b": float("nan")}, "c": {}}, [("problem.not_finite", "a: b: got nan", 0)]),
        ({"a": {}, "c": 5}, [("problem.field", "c: problem: got a int", 1)]),
    ],
)
def test_a_batch_that_cannot_be_sent_is_told_before(
    problems: Any, said: list[tuple[str, str, int | None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("x", "y"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.yaml").write_text("{}")
    issues = refusal(lambda: tandem_client.Client("http://127.0.0.1:1").batch(problems))
    assert len(issues) == len(said)
    for issue, (code, begin, of) in zip(issues, said, strict=True):
        assert (issue.code, issue.data.get("of")) == (code, of)
        assert issue.message.startswith(begin), issue.message
    with pytest.raises(planner.TandemError) as caught:
        planner.Client("http://127.0.0.1:1").batch(problems)
    assert [one.code for one in caught.value.issues] == [one[0] for one in said]


def test_the_queue_is_seen_and_its_order_changed(
    here: tuple[Elements, str], client: tandem_client.Client
) -> None:
    team = here[0].team
    until(lambda: not list(client.jobs(states=["queued", "running"])))
    team.hold.set()
    try:
        names = [f"waits_{number}" for number in range(6)]
        jobs = client.batch({name: named(name).encode() for name in names}, "queue", FILES)
        until(lambda: client.job(jobs[0])["state"] == "running")
        waiting = [one["id"] for one in client.jobs(tags=["queue"], sort="turn", states=["queued"])]
        assert len(waiting) >= 2 and waiting == [one for one in jobs if one in waiting]
        client.first(waiting[-1])
        turns = [one["id"] for one in client.jobs(tags=["queue"], sort="turn", states=["queued"])]
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
    acts = [(one["act"], one["job"]) for one in client.audit(acts=["cancelled"])]
    assert {("cancelled", one) for one in waiting} == set(acts)


def test_elements_are_called_found_and_divided_anew(client: tandem_client.Client, dome: str) -> None:
    told = client.describe_element(dome, "Gewölbe ٣", ["Halle"], "Dienstag")
    assert (told["title"], told["tags"], told["notes"]) == ("Gewölbe ٣", ["Halle"], "Dienstag")
    assert client.describe_element(dome, notes="")["title"] == "Gewölbe ٣"
    assert [one["id"] for one in client.elements("gewölbe", ["halle"], "title")] == [dome]
    assert list(client.elements("nothing such")) == []
    other = client.divide_anew(dome, {"panels.hexagons.count": COUNT + 2}, key="anew-1")
    assert client.divide_anew(dome, {"panels.hexagons.count": COUNT + 2}, key="anew-1") == other
    assert client.wait(other, timeout_s=120)["state"] == "done"
    assert len(client.element(other)["panels"]) == COUNT + 2
    assert {one["id"] for one in client.elements()} == {dome, other}
    last = client.divide_anew(other, {"panels.hexagons.count": COUNT}, instead=True)
    (issue,) = refusal(lambda: client.element(other))
    assert issue.code == "service.unknown_job"
    (issue,) = refusal(lambda: client.divide_anew(last, {"surface.mesh.file": Path(__file__)}))
    assert issue.field == "fields"
    client.cancel_element(last)
    client.delete_element(last)
    assert [one["id"] for one in client.elements()] == [dome]


def test_panels_are_released_marked_and_reported(client: tandem_client.Client, dome: str) -> None:
    names = [one["id"] for one in client.element(dome)["panels"][:3]]
    for job in client.plan_panels(dome, names):
        assert client.wait(job, timeout_s=60)["state"] == "verified"
    rows = [one for one in client.element(dome)["panels"] if one["state"] == "verified"]
    assert sorted(one["id"] for one in rows) == sorted(names)
    (again,) = client.plan_panels(dome, [rows[0]["id"]])
    client.wait(again, timeout_s=60)
    told = client.release_panels(dome, rows, "Nordseite", name="Ann")
    assert sorted(one["panel"] for one in told["releases"]) == sorted(one["id"] for one in rows[1:])
    (refused,) = told["refused"]
    assert refused["panel"] == rows[0]["id"]
    assert "planned again meanwhile" in refused["issues"][0]["message"]
    assert client.releases(rows[1]["job"])[0]["note"] == "Nordseite"
    issues = refusal(lambda: client.release_panels(dome, rows, name="Ann"))
    assert {one.code for one in issues} == {"service.release"}
    unplanned = next(one for one in client.element(dome)["panels"] if one["state"] == "not_planned")
    assert refusal(lambda: client.release_panels(dome, [unplanned], name="Ann"))[0].code == "service.request"
    (issue,) = refusal(lambda: client.release_panels(dome, names, name="Ann"))  # type: ignore[arg-type]
    assert issue.field == "panels"
    marked = client.mark_panel(dome, names[0], "cut")
    assert {one["id"]: one["mark"] for one in marked["panels"] if "mark" in one} == {names[0]: "cut"}
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
    """As it stands there; without tokens, a name says who releases."""
    (tmp_path / "wall" / "files").mkdir(parents=True)
    (tmp_path / "wall" / "files" / "targets.csv").write_bytes(TABLE)
    for name in ("b", "a"):
        (tmp_path / "wall" / f"{name}.yaml").write_text(named(f"wall_{name}"))
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
    assert [one["name"] for one in client.jobs(tags=["north wall"], sort="title")] == ["wall_a", "wall_b"]


def test_drafts_are_renamed_and_noted_as_sent(client: tandem_client.Client) -> None:
    made = client.keep_draft(named("noted").encode(), "Entwurf", files=FILES)
    assert client.save_draft(made["id"], 1, named("noted2").encode(), title="Wand 7")["title"] == "Wand 7"
    assert client.rename_draft(made["id"], "Gewölbe ٣")["title"] == "Gewölbe ٣"
    versions = client.versions(made["id"])
    assert [(one["number"], one["files"]) for one in versions] == [(2, ["targets.csv"]), (1, ["targets.csv"])]
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
