"""Uploads to a fake server that answers as public descriptions say. No real controller was used."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.issues import TandemError
from planner.shopfloor.loading import compare, download, proven, upload
from planner.shopfloor.loading.http_link import Link, Login, Trust
from planner.shopfloor.loading.proven import Proven
from planner.shopfloor.loading.rws import Rws
from planner.shopfloor.loading.store import MountedFolder
from tests.processes.hotwire.proof import bead_job
from tests.shopfloor.loading.rws_server import SECRET, USER, FakeController, certificate, fingerprint

TOOL = "[TRUE,[[0,0,160],[1,0,0,0]],[0.9,[0,0,60],[1,0,0,0],0,0,0]]"
OBJECT = '[FALSE,TRUE,"",[[560,0,220],[1,0,0,0]],[[0,0,0],[1,0,0,0]]]'


@pytest.fixture(scope="module")
def result() -> Proven:
    files = {name: text.encode() for name, text in bead_job.programs("abb").items()}
    return Proven(bead_job.problem("abb"), files)


@pytest.fixture
def controller() -> Iterator[FakeController]:
    made = FakeController()
    yield made
    made.close()


@pytest.fixture(params=[1, 2])
def either(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[FakeController]:
    """A controller of each version of the services."""
    pem = certificate(tmp_path_factory.mktemp("tls"))
    made = FakeController(request.param, pem if request.param == 2 else None)
    made.pem = pem  # type: ignore[attr-defined]
    yield made
    made.close()


def rws(
    controller: FakeController, password: str = SECRET, timeout: float = 5.0, trust: Trust | None = None
) -> Rws:
    two = controller.version == 2
    if two and trust is None:
        trust = Trust(fingerprint=fingerprint(controller.pem))  # type: ignore[attr-defined]
    return Rws(Link(controller.url, Login(USER, password), two, timeout, trust or Trust()), 1 + two)


def for_robotware_7(result: Proven) -> Proven:
    """The same files, sent to a controller of RobotWare 7."""
    cell = result.problem.cell
    own = dataclasses.replace(cell.controller, robotware=7)
    return Proven(
        dataclasses.replace(result.problem, cell=dataclasses.replace(cell, controller=own)), result.files
    )


def expect_refusal(
    controller: FakeController, result: Proven, code: str, *words: str, **more: object
) -> None:
    with pytest.raises(TandemError) as caught:
        upload.to_controller(rws(controller, **more), result)  # type: ignore[arg-type]
    assert code in {issue.code for issue in caught.value.issues}, str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert SECRET not in str(caught.value)


def test_programs_go_into_a_new_folder_each_time_and_nothing_starts(
    either: FakeController, result: Proven
) -> None:
    sent = for_robotware_7(result) if either.version == 2 else result
    first = upload.to_controller(rws(either), sent)
    before = dict(either.files)
    link = rws(either)
    second = upload.to_controller(link, sent)
    link.close()
    assert (first.issues, first.ready, second.folder) == ((), True, f"{first.folder}_2")
    assert {k: either.files[k] for k in before} == before
    for name, content in sent.files.items():
        assert either.files[f"{second.folder}/{name}"] == content
    assert {"base frames and robot types", "options", "signals", "tasks", "RobotWare"} <= set(first.agreed)
    posts = [path for verb, path in either.requests if verb == "POST" and "fileservice" not in path]
    domain = "/rw/mastership/rapid?action=" if either.version == 1 else "/rw/mastership/edit/"
    assert posts == [f"{domain}request", f"{domain}release"] * 2, "all that is asked of it but files"
    assert all("fileservice" in path for verb, path in either.requests if verb in ("PUT", "DELETE"))
    assert either.requests[-1] == ("GET", "/logout")


def test_a_certificate_is_trusted_by_its_fingerprint_alone(tmp_path: Path, result: Proven) -> None:
    controller = FakeController(2, certificate(tmp_path))
    try:
        expect_refusal(controller, result, "upload.login", "not trusted", "--fingerprint", trust=Trust())
        wrong = Trust(fingerprint="ab" * 32)
        expect_refusal(controller, result, "upload.login", "--fingerprint names abab", trust=wrong)
        assert controller.requests == [], "nothing, and no password, goes to a stranger"
        short = Trust(fingerprint="ab:cd")
        expect_refusal(controller, result, "upload.address", "64 hexadecimal digits", trust=short)
        shown = fingerprint(certificate(tmp_path)).upper()
        colons = "SHA256:" + ":".join(shown[k : k + 2] for k in range(0, 64, 2))
        assert rws(controller, trust=Trust(fingerprint=colons)).mode == "AUTO"
        assert rws(controller, trust=Trust(fingerprint=shown)).robotware == "7.13.1"
    finally:
        controller.close()


def test_a_controller_that_is_not_ready_is_refused_and_nothing_is_written(
    controller: FakeController, result: Proven
) -> None:
    expect_refusal(controller, result, "upload.login", "401", password="wrong")
    controller.mode = "MANR"
    expect_refusal(controller, result, "upload.busy", "MANR", "allowed is AUTO")
    controller.mode, controller.running = "AUTO", "running"
    expect_refusal(controller, result, "upload.busy", "running")
    controller.running = "stopped"
    controller.fail = {"mastership": 403}
    expect_refusal(controller, result, "upload.busy", "mastership")
    controller.fail, controller.delay_s = {}, 0.6
    expect_refusal(controller, result, "upload.controller", "no answer in time", timeout=0.2)
    assert list(controller.files) == [""]
    assert not [path for verb, path in controller.requests if verb == "POST" and "mastership" not in path]
    controller.delay_s = 0.0
    assert upload.to_controller(rws(controller), result).ready


def test_differences_are_told_with_figures(controller: FakeController, result: Proven) -> None:
    controller.base[0] = 0.0025
    controller.robotware, controller.model = "7.10.0", "ROB1_4400_60_1.96"
    controller.tasks = ["T_ROB2"]
    expect_refusal(
        controller, result, "upload.differs", "2.500 mm", "7.10.0", "task T_ROB1 does not exist", "4400"
    )
    assert list(controller.files) == [""]


def test_options_are_those_that_the_text_needs() -> None:
    problem = bead_job.problem("abb")

    def lost(text: str, *installed: str) -> list[str]:
        return compare.missing_options(installed, problem, text)

    assert lost("PathAccLim TRUE\\AccMax:=1;\nStorePath;\nMoveL p1,v40,fine,t;") == []
    assert lost("! SyncMoveOn is no word here\nMoveL p1,v40,fine,t;") == []
    for text in (
        "SyncMoveOn on1,all;",
        "MoveL p1\\ID:=10,v40,fine,t;",
        "MoveL [[1,2,3],[1,0,0,0]]\\ID:=1,v40;",
    ):
        (told,) = lost(text, "604-2 MultiMove Independent", "623-1 Multitasking")
        assert "MultiMove Coordinated" in told
        assert lost(text, "604-1 MultiMove Coordinated") == lost(text, "3102-1 MultiMove Coordinated") == []
    assert lost("WaitSyncTask s1,all;", "623-1 Multitasking") == []
    assert "Multitasking" in lost("WaitSyncTask s1,all;", "608-1 World Zones")[0]


def test_tools_are_compared_with_the_text_of_the_module(controller: FakeController, result: Proven) -> None:
    controller.loaded["TandemData_1"] = {"t_plain": TOOL, "w_stock": OBJECT}  # as a controller prints them
    sent = upload.to_controller(rws(controller), result)
    assert {"tooldata t_plain", "wobjdata w_stock"} <= set(sent.agreed)
    assert sent.ready
    controller.loaded["TandemData_1"]["t_plain"] = TOOL.replace("160", "162.5")
    expect_refusal(controller, result, "upload.differs", "t_plain", "1 of 18 numbers", "2.5", "162.5")
    controller.loaded["TandemData_1"]["t_plain"] = TOOL.replace("TRUE", "FALSE")
    expect_refusal(controller, result, "upload.differs", "t_plain", "FALSE")
    controller.loaded["TandemData_1"] = {"t_plain": TOOL}
    sent = upload.to_controller(rws(controller), result)
    assert not sent.ready, "a module that is loaded, and does not tell one of its data"
    assert any("w_stock" in issue.message for issue in sent.issues)
    del controller.loaded["TandemData_1"]  # unloaded, as the hint says
    assert upload.to_controller(rws(controller), result).ready


def wrapped_content(*items: dict[str, object]) -> bytes:
    return json.dumps({"_embedded": {"_state": items}}).encode()


LISTS = (
    "/rw/system/options",
    "/rw/rapid/tasks",
    "/rw/iosystem/signals",
    "/rw/cfg/moc/ROBOT",
    "/rw/rapid/modules",
)
NOWHERE = {"base_frame_pos_x": "nan", "base_frame_pos_y": "0", "base_frame_pos_z": "0"} | {
    f"base_frame_orient_u{k}": "0" for k in range(4)
}


@pytest.mark.sampled(every=3)
@pytest.mark.parametrize(
    ("body", "parts"),
    [
        (b"null", LISTS),
        (b"[]", LISTS),
        (b"{}", LISTS),
        (b"[" * 100_000, LISTS),
        (
            b'{"_embedded": {}, "_links": {"next": "x"}, "state": 7}',
            ("/rw/system/options", "/rw/cfg/moc/ROBOT"),
        ),
        (b'{"_embedded": {}, "_links": {"next": {"href": "http://[x"}}}', LISTS),
        (wrapped_content({"_type": "rap-task-li"}, {"_type": "rap-module-info-li"}), LISTS[1:2] + LISTS[4:]),
        (wrapped_content({"_type": "something", "name": "else"}), LISTS),
        (
            wrapped_content(
                {
                    "_type": "cfg-dt-instance",
                    "_title": "ROB_1",
                    "attrib": [{"_type": "cfg-ia-t", "_title": k, "value": v} for k, v in NOWHERE.items()],
                }
            ),
            ("/rw/cfg/moc/ROBOT",),
        ),
    ],
)
def test_answers_that_are_none_are_never_agreement(
    controller: FakeController, result: Proven, body: bytes, parts: tuple[str, ...]
) -> None:
    for part in parts:
        controller.lies = {part: body}
        try:
            assert not upload.to_controller(rws(controller), result).ready, part
        except TandemError as error:  # a robot or task that is not told may be another one, too
            assert {issue.code for issue in error.issues} <= {"upload.differs", "upload.not_looked_at"}


def test_half_answers_and_busy_controllers_are_told(controller: FakeController, result: Proven) -> None:
    controller.halves = "/rw/rapid/execution"
    expect_refusal(controller, result, "upload.controller", "the answer ended after", "before its end")
    controller.halves = ""
    controller.fail = {"/rw/panel": 503}
    expect_refusal(controller, result, "upload.controller", "cannot answer now", "503", "sessions")
    controller.fail = {"/rw/panel": 302}
    expect_refusal(controller, result, "upload.controller", "redirects elsewhere")
    controller.fail = {}
    sent = upload.to_controller(rws(controller), result)
    controller.halves = f"{sent.folder}/T_ROB1"
    with pytest.raises(TandemError, match="the answer ended after"):
        download.fetch(rws(controller), sent.folder)


@pytest.mark.parametrize("part", ["/rw/cfg", "/rw/system/options", "/rw/iosystem", "/rw/rapid/modules"])
def test_ready_is_said_only_where_all_was_looked_at(
    controller: FakeController, result: Proven, part: str
) -> None:
    controller.fail = {part: 403}
    sent = upload.to_controller(rws(controller), result)
    assert not sent.ready
    (issue,) = sent.issues
    assert issue.code == "upload.not_looked_at"
    assert "403" in issue.message


def test_lists_are_read_to_their_last_page(either: FakeController) -> None:
    either.signals["DO_LAST"] = "DO"
    assert len(rws(either).signals) == len(either.signals)
    assert rws(either).signals["DO_LAST"] == "DO"


@pytest.mark.parametrize("after", [1, 12, 20])
def test_a_session_that_expires_half_way_is_renewed(
    controller: FakeController, result: Proven, after: int
) -> None:
    controller.expires = after
    assert upload.to_controller(rws(controller), result).ready
    assert controller.nonce == "n2"


def test_signals_are_those_of_the_text(controller: FakeController, result: Proven) -> None:
    name = "T_ROB1/TandemMain_1.mod"
    text = result.files[name].replace(
        b"    operation_1;", b"    SetDO\\SDelay:=0.2,do_heat,1;\r\n    operation_1;", 1
    )
    text = text.replace(
        b"PROC operation_1()", b"PROC operation_1()\r\n    ! SetDO do_none,1;\r\n    WaitDI di_ok,1;", 1
    )
    changed = Proven(result.problem, {**result.files, name: text})
    expect_refusal(controller, changed, "upload.differs", "signal do_heat (DO)", "signal di_ok (DI)")
    controller.signals |= {"DO_HEAT": "DO", "di_ok": "DO"}
    expect_refusal(
        controller, changed, "upload.differs", "di_ok of robot is DO on the controller, required is DI"
    )
    controller.signals["di_ok"] = "DI"
    assert upload.to_controller(rws(controller), changed).ready


def test_base_frames_are_read_one_by_one_where_lists_are_short(either: FakeController) -> None:
    whole = rws(either).robots
    either.short = True
    assert rws(either).robots == whole
    assert whole["ROB_1"]["base_frame_orient_u0"] == "1.0"


@pytest.mark.parametrize("name", ["..", "../x.mod", "/etc/x.mod", "a\\x.mod", "\x1b[31mx.mod", "\udcdcx.mod"])
def test_a_controller_names_no_files_outside_of_its_folder(tmp_path: Path, name: str) -> None:
    class Strange(MountedFolder):
        def listing(self, folder: str) -> dict[str, bool] | None:
            return {name: False}

    with pytest.raises(TandemError, match="not a valid file name") as caught:
        download.fetch(Strange(tmp_path), "folder")
    assert caught.value.issues[0].code == "upload.controller"


@pytest.mark.parametrize(("fault", "words"), [("full", "disk is full"), ("half", "bytes read back")])
def test_what_was_begun_is_taken_away(
    controller: FakeController, result: Proven, fault: str, words: str
) -> None:
    controller.fail = {"PUT ": 507} if fault == "full" else {}
    controller.cut = 3 if fault == "half" else 0
    expect_refusal(controller, result, "upload.write", words, "nothing of it remains")
    assert list(controller.files) == [""]
    controller.fail, controller.cut = {}, 0
    assert upload.to_controller(rws(controller), result).ready


def test_a_connection_that_breaks_half_way_leaves_nothing(controller: FakeController, result: Proven) -> None:
    last = sorted(result.files)[-1]
    controller.drop = {f"{last}"}
    controller.files["old"] = b"kept"
    with pytest.raises(TandemError) as caught:
        upload.to_controller(rws(controller), result)
    assert caught.value.issues[0].code == "upload.controller"
    assert "PUT" in str(caught.value)
    assert "by hand what" in str(caught.value), "the server answers nothing for that name, not even DELETE"
    controller.drop, controller.files = (
        {f"PUT /fileservice/$home/{upload.folder_name(result.problem)}"},
        {"": None},
    )
    expect_refusal(controller, result, "upload.controller", "nothing of it remains")
    assert list(controller.files) == [""]
    assert controller.requests[-1][1].endswith("release"), "mastership is given back"


def test_what_cannot_be_taken_away_is_named(controller: FakeController, result: Proven) -> None:
    controller.cut, controller.fail = 3, {"DELETE": 403}
    expect_refusal(controller, result, "upload.write", "delete by hand")


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit, MemoryError])
def test_whatever_happens_half_way_nothing_is_left(
    tmp_path: Path, result: Proven, kind: type[BaseException]
) -> None:
    class Broken(MountedFolder):
        def read(self, name: str) -> bytes | None:
            raise kind("half-way")

    (tmp_path / "own.txt").write_text("kept")
    with pytest.raises(kind) as caught:
        upload.to_store(Broken(tmp_path), result)
    assert [path.name for path in tmp_path.iterdir()] == ["own.txt"]
    assert any("nothing of it remains" in note for note in caught.value.__notes__)


def require_written(folder: Path, result: Proven, **changes: object) -> None:
    for name, content in result.files.items():
        (folder / "programs" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "programs" / name).write_bytes(content)
    named = {name: hashlib.sha256(content).hexdigest() for name, content in result.files.items()}
    data = {"ok": True, "problem_digest": result.problem.digest, "programs": named} | changes
    (folder / "proof.json").write_text(json.dumps(data))


def test_only_files_that_the_proof_names(tmp_path: Path, result: Proven) -> None:
    require_written(tmp_path, result)
    assert proven.read(tmp_path, result.problem).files == result.files
    first = next(name for name in result.files if name.endswith(".mod"))
    for change, words in (
        ({"ok": False}, "the verdict is not 'verified'"),
        ({"programs": {}}, "no digests"),
        ({"programs": None}, "no digests"),
        ({"problem_digest": "0" * 64}, "the folder holds"),
    ):
        require_written(tmp_path, result, **change)
        with pytest.raises(TandemError, match=words) as caught:
            proven.read(tmp_path, result.problem)
        assert "prove again: tandem verify" in str(caught.value)
    require_written(tmp_path, result)
    (tmp_path / "programs" / first).write_bytes(b"!" + result.files[first])
    (tmp_path / "programs" / "extra.mod").write_bytes(b"MODULE m ENDMODULE")
    with pytest.raises(TandemError, match=r"extra.mod is not in the proof") as caught:
        proven.read(tmp_path, result.problem)
    assert caught.value.issues[0].code == "upload.unproven"
    assert "the proof has" in str(caught.value)


def test_a_result_names_the_digests_of_its_files(tmp_path: Path) -> None:
    outcome = bead_job.outcome("abb")
    outcome.save(tmp_path / "out", pages=False)
    named = json.loads((tmp_path / "out" / "proof.json").read_text())["programs"]
    root = tmp_path / "out" / "programs"
    there = {path.relative_to(root).as_posix(): path for path in root.rglob("*") if path.is_file()}
    assert named == {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in there.items()}


class Endless(MountedFolder):
    """A folder in which there is always another one."""

    def listing(self, folder: str) -> dict[str, bool] | None:
        return {"inner": True}


def test_a_controller_without_end_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(TandemError, match="nested folders"):
        download.fetch(Endless(tmp_path), "tandem_x")
    (tmp_path / "tandem_x").mkdir()
    for k in range(3):
        (tmp_path / "tandem_x" / f"{k}.mod").write_bytes(b"x" * 100)
    monkeypatch.setattr(download, "MAX_BYTES", 250)
    with pytest.raises(TandemError, match="the folder that upload reported"):
        download.fetch(MountedFolder(tmp_path), "tandem_x")


def test_passwords_never_go_in_urls_or_without_tls() -> None:
    for url, basic in (("http://a:b@host", False), ("http://host", True)):
        with pytest.raises(TandemError) as caught:
            Link(url, Login(USER, SECRET), basic)
        assert caught.value.issues[0].code == "upload.address"
    assert SECRET not in repr(Login(USER, SECRET))
