"""Uploads against a server of our own that answers as public descriptions say: no controller was there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from planner.issues import TandemError
from planner.loading import download, proven, upload
from planner.loading.http_link import Link, Login
from planner.loading.proven import Proven
from planner.loading.rws import Rws
from planner.loading.store import Share
from tests.loading.rws_server import SECRET, USER, Controller
from tests.verify import bead_job


@pytest.fixture(scope="module")
def result() -> Proven:
    files = {name: text.encode() for name, text in bead_job.programs("abb").items()}
    return Proven(bead_job.problem("abb"), files)


@pytest.fixture
def controller() -> Iterator[Controller]:
    made = Controller()
    yield made
    made.close()


def rws(controller: Controller, password: str = SECRET, timeout: float = 5.0) -> Rws:
    return Rws(Link(controller.url, Login(USER, password), False, timeout), 1)


def refused(controller: Controller, result: Proven, code: str, *words: str, **more: object) -> None:
    with pytest.raises(TandemError) as caught:
        upload.to_controller(rws(controller, **more), result)  # type: ignore[arg-type]
    assert code in {issue.code for issue in caught.value.issues}, str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert SECRET not in str(caught.value)


def nothing_started(controller: Controller) -> None:
    wrong = ("execution", "pcp", "motors", "ctrlstate", "ctrl-state", "loadmod", "cfg", "symbol", "signals")
    posts = [path for verb, path in controller.asked if verb != "GET"]
    assert not [path for path in posts if any(word in path for word in wrong)]


def test_programs_go_into_a_new_folder_each_time_and_nothing_starts(
    controller: Controller, result: Proven
) -> None:
    first = upload.to_controller(rws(controller), result)
    before = dict(controller.files)
    second = upload.to_controller(rws(controller), result)
    assert (first.ready, second.folder) == (True, f"{first.folder}_2")
    assert {k: controller.files[k] for k in before} == before
    for name, content in result.files.items():
        assert controller.files[f"{second.folder}/{name}"] == content
    assert "base frames and robot types" in first.agreed
    nothing_started(controller)
    kept = [path for verb, path in controller.asked if "mastership" in path and verb == "POST"]
    assert [path.rpartition("=")[2] for path in kept] == ["request", "release"] * 2


def test_a_controller_that_is_not_ready_is_refused_and_nothing_is_written(
    controller: Controller, result: Proven
) -> None:
    refused(controller, result, "upload.login", "401", password="wrong")
    controller.values["opmode"] = "MANR"
    refused(controller, result, "upload.busy", "MANR", "allowed is AUTO")
    controller.values |= {"opmode": "AUTO", "ctrlexecstate": "running"}
    refused(controller, result, "upload.busy", "running")
    controller.values["ctrlexecstate"] = "stopped"
    controller.fail = {"mastership": 403}
    refused(controller, result, "upload.busy", "mastership")
    controller.fail, controller.slow = {}, 0.6
    refused(controller, result, "upload.controller", "no answer in time", timeout=0.2)
    assert list(controller.files) == [""]


def test_differences_are_told_with_figures(controller: Controller, result: Proven) -> None:
    controller.base[0] = 0.0025
    controller.values["rwversion"] = "7.10.0"
    controller.tasks = ["T_ROB2"]
    refused(controller, result, "upload.differs", "2.500 mm", "7.10.0", "task T_ROB1 is not there")
    assert list(controller.files) == [""]


@pytest.mark.parametrize(("fault", "words"), [("full", "full"), ("half", "bytes came back")])
def test_what_was_begun_is_taken_away(controller: Controller, result: Proven, fault: str, words: str) -> None:
    controller.fail = {"PUT ": 507} if fault == "full" else {}
    controller.cut = 3 if fault == "half" else 0
    refused(controller, result, "upload.write", words, "nothing of it was left")
    assert list(controller.files) == [""]


def test_what_cannot_be_taken_away_is_named(controller: Controller, result: Proven) -> None:
    controller.cut, controller.fail = 3, {"DELETE": 403}
    refused(controller, result, "upload.write", "take it away by hand")


def test_what_cannot_be_read_is_not_said_to_agree(controller: Controller, result: Proven) -> None:
    controller.fail = {"/rw/cfg": 403}
    sent = upload.to_controller(rws(controller), result)
    assert "base frames and robot types" not in sent.agreed
    assert any(i.code == "upload.not_looked_at" and "base frames" in i.message for i in sent.issues)


def test_only_files_that_the_proof_names(tmp_path: Path, result: Proven) -> None:
    for name, content in result.files.items():
        (tmp_path / "programs" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "programs" / name).write_bytes(content)
    named = {name: hashlib.sha256(content).hexdigest() for name, content in result.files.items()}
    data = {"ok": True, "problem_digest": result.problem.digest, "programs": named}
    (tmp_path / "proof.json").write_text(json.dumps(data))
    assert proven.read(tmp_path, result.problem).files == result.files
    first = next(name for name in named if name.endswith(".mod"))
    (tmp_path / "programs" / first).write_bytes(b"!" + result.files[first])
    with pytest.raises(TandemError, match="the proof names") as caught:
        proven.read(tmp_path, result.problem)
    assert caught.value.issues[0].code == "upload.unproven"
    (tmp_path / "proof.json").write_text(json.dumps(data | {"ok": False}))
    with pytest.raises(TandemError, match="not verified"):
        proven.read(tmp_path, result.problem)


def test_a_share_keeps_what_is_there_and_touched_data_are_named(tmp_path: Path, result: Proven) -> None:
    sent = upload.to_store(Share(tmp_path), result)
    assert upload.to_store(Share(tmp_path), result).folder == f"{sent.folder}_2"
    assert {i.code for i in sent.issues} == {"upload.not_looked_at"}
    back = download.fetch(Share(tmp_path), sent.folder)
    assert download.touched(result.files, back) == ()
    old = {
        "a.mod": b"MODULE a\r\n"
        b"CONST robtarget p1:=[[1,2,3],[1,0,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\r\nENDMODULE\r\n"
    }
    new = {"a.mod": old["a.mod"].replace(b"[[1,2,3],[1,0,0,0]", b"[[4,6,3],[0.70710678,0.70710678,0,0]")}
    (found,) = download.touched(old, new)
    assert (found.code, "robtarget p1: moved by 5.000 mm, turned by 90.000 deg" in found.message) == (
        "upload.touched",
        True,
    )
    with pytest.raises(TandemError, match="no such folder") as caught:
        download.fetch(Share(tmp_path), "other")
    assert caught.value.issues[0].code == "upload.missing"


def test_passwords_never_go_in_urls_or_without_tls() -> None:
    for url, basic in (("http://a:b@host", False), ("http://host", True)):
        with pytest.raises(TandemError) as caught:
            Link(url, Login(USER, SECRET), basic)
        assert caught.value.issues[0].code == "upload.address"
    assert SECRET not in repr(Login(USER, SECRET))
