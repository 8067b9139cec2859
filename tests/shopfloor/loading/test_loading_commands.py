"""``tandem upload`` and ``tandem download`` as a user meets them: messages, files and exit codes."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from planner.cli import command_line
from tests.processes.hotwire.proof import bead_job
from tests.shopfloor.loading.rws_server import SECRET, FakeController

Run = Callable[..., tuple[int, str]]


@pytest.fixture(scope="module")
def result_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("beads") / "out"
    bead_job.outcome("abb").save(out, pages=False)
    return out


@pytest.fixture
def out(result_folder: Path, tmp_path: Path) -> Path:
    """A copy of the result folder for one test."""
    return Path(shutil.copytree(result_folder, tmp_path / "out"))


@pytest.fixture
def controller() -> Iterator[FakeController]:
    made = FakeController()
    yield made
    made.close()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Call the command as the shell does; return exit code and all output."""
    monkeypatch.setenv("TANDEM_CONTROLLER_PASSWORD", SECRET)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")

    def call(*arguments: object) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["tandem", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command_line.main()
        output = capsys.readouterr()
        return int(str(ended.value.code)), output.out + output.err

    return call


def test_a_controller_that_is_as_planned_is_ready(run: Run, out: Path, controller: FakeController) -> None:
    code, said = run("upload", out, "--controller", controller.url)
    assert (code, "Ready to load" in said, "Nothing was loaded or started" in said) == (0, True, True), said
    assert "base frames and robot types" in said
    assert SECRET not in said
    controller.fail = {"/rw/iosystem": 403}
    code, said = run("upload", out, "--controller", controller.url)
    assert (code, "NOT reported as ready" in said, "Ready to load" in said) == (5, True, False), said
    assert "signals: " in said
    controller.fail, controller.mode = {}, "MANR"
    code, said = run("upload", out, "--controller", controller.url)
    assert (code, "upload.busy" in said) == (1, True), said
    controller.mode, controller.base[2] = "AUTO", 0.01
    code, said = run("upload", out, "--controller", controller.url)
    assert (code, "10.000 mm" in said, "Ready" in said) == (1, True, False), said


def test_a_folder_is_never_ready_and_what_was_there_stays(run: Run, out: Path, tmp_path: Path) -> None:
    fraction = tmp_path / "share"
    fraction.mkdir()
    code, said = run("upload", out, "--controller", fraction)
    assert (code, "a folder contains none" in said, "NOT reported" in said) == (5, True, True), said
    first = next(fraction.iterdir()).name
    code, said = run("upload", out, "--controller", fraction)
    assert {path.name for path in fraction.iterdir()} == {first, f"{first}_2"}
    code, said = run("upload", out, "--controller", tmp_path / "nowhere")
    assert (code, "mount the controller's share" in said) == (1, True), said
    code, said = run("upload", out, "--controller", fraction, "--arm", "other")
    assert (code, "upload.address" in said) == (2, True), said


def test_what_was_changed_is_not_sent_and_an_old_result_is_proven_again(
    run: Run, out: Path, tmp_path: Path
) -> None:
    (tmp_path / "share").mkdir()
    proof = out / "proof.json"
    proof.write_text(json.dumps({k: v for k, v in json.loads(proof.read_text()).items() if k != "programs"}))
    code, said = run("upload", out, "--controller", tmp_path / "share")
    assert (code, "prove again: tandem verify" in said) == (2, True), said
    code, said = run("verify", out)
    assert (code, "proven" in said) == (0, True), said
    assert json.loads(proof.read_text())["accepted"] == ["stock.hangs"]
    code, said = run("upload", out, "--controller", tmp_path / "share")
    assert code == 5, said
    program = next((out / "programs").rglob("TandemCut1_1.mod"))
    program.write_bytes(program.read_bytes().replace(b"v40", b"v45"))
    code, said = run("upload", out, "--controller", tmp_path / "share")
    assert (code, "upload.unproven" in said, "has digest" in said) == (2, True, True), said
    assert len(list((tmp_path / "share").iterdir())) == 1


def test_what_is_not_released_is_not_sent(run: Run, out: Path, tmp_path: Path) -> None:
    """`release.json` of a service beside the result, or beside the programs of its archive."""
    fraction = tmp_path / "share"
    fraction.mkdir()
    proof = json.loads((out / "proof.json").read_text())
    good = {"released": True, "says": "released by ann, 2026-11-27 06:40:12 UTC", "release": {"by": "ann"}}
    good |= {"digest": proof["problem_digest"], "programs": proof["programs"]}
    taken = {"released": False, "says": "released by ann, then; withdrawn by bob, now"}
    never = {"released": False, "says": "not released", "release": None}

    def send(content: object, *more: str, file_name: str = "release.json") -> tuple[int, str]:
        (out / file_name).write_text(content if isinstance(content, str) else json.dumps(content))
        told = run("upload", out, "--controller", fraction, *more)
        (out / file_name).unlink()
        return told

    for place in ("release.json", "programs/release.json"):
        code, said = send(good, "--released", file_name=place)
        assert (code, "released by ann, 2026-11-27 06:40:12 UTC" in said) == (5, True), said
        assert not list(fraction.rglob("release.json"))
    code, said = run("upload", out, "--controller", fraction)
    assert (code, "released" in said) == (5, False), said
    assert send(good | never)[0] == 5
    there = len(list(fraction.iterdir()))
    for wrong, more, why in (
        (good | taken, (), "withdrawn by bob"),
        (good | never, ("--released",), "not released"),
        (good | {"digest": "0" * 64}, (), "other programs"),
        (good | {"programs": {}}, (), "other programs"),
        (good | {"released": "yes"}, (), "it says"),
        ("{", (), "cannot be read"),
        ([], (), "cannot be read"),
    ):
        code, said = send(wrong, *more)
        assert (code, "upload.release" in said, why in said) == (2, True, True), said
        assert "release the job in the service" in said
    code, said = run("upload", out, "--controller", fraction, "--released")
    assert (code, "there is no release file" in said) == (2, True), said
    assert len(list(fraction.iterdir())) == there
    (out / "programs/release.json").write_text(json.dumps(good))
    assert run("verify", out)[0] == 0


def test_what_is_signed_stays_as_it_is_unless_it_is_signed_again(run: Run, out: Path) -> None:
    (out / "statement.json").write_text("{}")
    before = (out / "proof.json").read_text().replace('"accepted"', '"taken"')
    (out / "proof.json").write_text(before)
    code, said = run("verify", out)
    assert (code, "proof.json is signed and stays" in said) == (0, True), said
    assert (out / "proof.json").read_text() == before


def save_module(path: Path, change: Callable[[str], str] = lambda text: text) -> None:
    """A module as a controller may have saved it, changed."""
    text = re.sub(r"(?<=[\[,])(-?\d+)\.0+(?=[\],])", r"\1", path.read_text().replace("9E9", "9E+09"))
    path.write_bytes(change(text).encode())


def test_touched_up_targets_are_named_and_the_proof_says_the_rest(
    run: Run, out: Path, tmp_path: Path
) -> None:
    fraction = tmp_path / "share"
    fraction.mkdir()
    run("upload", out, "--controller", fraction)
    code, said = run("download", fraction, "--result", out, "-o", tmp_path / "back")
    assert (code, "unchanged since it was sent; proven" in said) == (0, True), said
    folder = next(fraction.iterdir())
    cut = next(folder.rglob("TandemCut1_1.mod"))
    save_module(cut)
    code, said = run("download", fraction, "--result", out, "-o", tmp_path / "printed")
    assert (code, "unchanged since it was sent; proven" in said) == (0, True), said
    save_module(cut, lambda text: text.replace("[-18,-15,90]", "[-18.3,-15.4,90]", 1))
    code, said = run("download", fraction, "--result", out, "-o", tmp_path / "touched")
    assert re.search(r"cut_there, target 3 \(line \d+\): moved by 0\.500 mm, turned by 0\.000 deg", said), (
        said
    )
    assert (code, "touched up in 1 places; NOT proven" in said) == (4, True), said
    assert next((tmp_path / "touched").rglob("TandemCut1_1.mod")).read_bytes() == cut.read_bytes()
    code, said = run("download", fraction, "--result", out, "-o", tmp_path / "touched")
    assert (code, "is not an empty folder" in said) == (2, True), said
    code, said = run("verify", tmp_path / "touched")
    assert code == 4, "what came back is a folder that can be proven by itself"


def test_programs_come_back_from_a_controller(
    run: Run, out: Path, tmp_path: Path, controller: FakeController
) -> None:
    run("upload", out, "--controller", controller.url)
    code, said = run("download", controller.url, "--result", out, "-o", tmp_path / "back")
    assert (code, "save them first" in said) == (0, True), said
    run("upload", out, "--controller", controller.url)
    code, said = run("download", controller.url, "--result", out, "-o", tmp_path / "again")
    assert (code, "the controller has more than one" in said, "--there" in said) == (1, True, True), said
    first = min((name for name in controller.files if name), key=len)
    code, said = run("download", controller.url, "--result", out, "-o", tmp_path / "again", "--there", first)
    assert code == 0, said
    code, said = run("download", controller.url, "--result", out, "-o", tmp_path / "no", "--there", "other")
    assert (code, "upload.missing" in said) == (1, True), said
