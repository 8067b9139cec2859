"""Signed results, and problems that are compared with the user's own.

Signatures are checked by ``ssh-keygen`` itself, and every later change is reported.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from planner import pipeline
from planner.cli import command_line, statement
from planner.cli.batch import differences
from planner.files import RESULT_ENTRIES, write_folder
from planner.issues import TandemError
from planner.problem import Problem
from planner.reading import problem as problem_file
from tests.processes.hotwire.proof import bead_job

KEYGEN = shutil.which("ssh-keygen")
needs_keygen = pytest.mark.skipif(KEYGEN is None, reason="no ssh-keygen here: install openssh-client")


def keys(folder: Path, name: str = "key") -> tuple[Path, Path]:
    """An Ed25519 key of OpenSSH and its public half, made by the library."""
    pytest.importorskip("cryptography", reason="cryptography is not installed: pip install '.[sign]'")
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
        PublicFormat,
    )

    key = Ed25519PrivateKey.generate()
    private, public = folder / name, folder / f"{name}.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.OpenSSH, NoEncryption()))
    private.chmod(0o600)
    public.write_bytes(key.public_key().public_bytes(Encoding.OpenSSH, PublicFormat.OpenSSH) + b" lab@cell\n")
    return private, public


@pytest.fixture(scope="module")
def signed_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a problem, a key and a signed result."""
    folder = tmp_path_factory.mktemp("signed")
    key, _ = keys(folder)
    bead_job.write(folder, "abb")
    problem = pipeline.load(folder / "problem.yaml")
    write_folder(
        folder / "out", result(problem) | {"report.html": "<html>", "proof.json": "true"}, RESULT_ENTRIES
    )
    assert command_line.verify(folder / "out", problem=folder / "problem.yaml", sign=key) == command_line.DONE
    return folder


def result(problem: Problem) -> dict[str, str | bytes]:
    """Programs and problem as a result folder has them."""
    files: dict[str, str | bytes] = {
        f"programs/{name}": text for name, text in pipeline.plan(problem).programs.items()
    }
    return files | {f"problem/{name}": text for name, text in problem_file.bundle(problem).items()}


@pytest.fixture
def copy(signed_folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(signed_folder, tmp_path / "copy"))


def ssh_keygen(*arguments: object, message: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    assert KEYGEN is not None
    command = [KEYGEN, *map(str, arguments)]
    return subprocess.run(command, input=message, capture_output=True, check=False)


# ---- the format ----------------------------------------


@needs_keygen
def test_ssh_keygen_takes_our_signatures_and_no_others(signed_folder: Path, tmp_path: Path) -> None:
    out = signed_folder / "out"
    allowed = tmp_path / "allowed"
    allowed.write_text(f"lab@cell {(signed_folder / 'key.pub').read_text()}")
    asked = ("-Y", "verify", "-f", allowed, "-I", "lab@cell", "-s", out / "statement.json.sig", "-n")
    content = (out / "statement.json").read_bytes()
    done = ssh_keygen(*asked, "tandem", message=content)
    assert done.returncode == 0, done.stderr
    assert ssh_keygen(*asked, "tandem", message=content + b" ").returncode != 0
    assert ssh_keygen(*asked, "file", message=content).returncode != 0
    shown = ssh_keygen("-l", "-f", signed_folder / "key.pub").stdout.decode()
    assert statement.read_public_keys(signed_folder / "key.pub")[0].fingerprint in shown


@needs_keygen
@pytest.mark.parametrize("name", ["sha512", "sha256"])
def test_signatures_of_ssh_keygen_are_taken(tmp_path: Path, name: str) -> None:
    pytest.importorskip("cryptography", reason="cryptography is not installed: pip install '.[sign]'")
    key, message = tmp_path / "id", tmp_path / "text"
    assert ssh_keygen("-q", "-t", "ed25519", "-N", "", "-C", "me", "-f", key).returncode == 0
    message.write_bytes(b"a text of some length\n" * 9)
    signed = ssh_keygen("-Y", "sign", "-O", f"hashalg={name}", "-f", key, "-n", "tandem", message)
    assert signed.returncode == 0, signed.stderr
    armoured = Path(f"{message}.sig").read_text()
    known = statement.read_public_keys(Path(f"{key}.pub"))
    assert statement.find_signer(message.read_bytes(), armoured, known).who == "me"
    if name == "sha512":  # Ed25519 signs a text in one way
        assert statement.sign_message(message.read_bytes(), statement.read_private_key(key)) == armoured


@needs_keygen
def test_keys_with_a_passphrase_ask_at_a_terminal_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("bcrypt", reason="keys with a passphrase need bcrypt")
    key = tmp_path / "id"
    assert ssh_keygen("-q", "-t", "ed25519", "-N", "secret", "-f", key).returncode == 0
    with pytest.raises(TandemError, match="no terminal"):
        statement.read_private_key(key)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(statement.getpass, "getpass", lambda _: "secret")
    assert statement.read_private_key(key).public == statement.PublicKey(
        statement.read_public_keys(Path(f"{key}.pub"))[0].raw
    )


def test_files_of_allowed_signers(signed_folder: Path, tmp_path: Path) -> None:
    own = (signed_folder / "key.pub").read_text().split()[:2]
    file = tmp_path / "allowed"
    for line, who in (
        (["me@lab", *own], "me@lab"),
        (["me@lab", 'namespaces="git,tandem"', *own], "me@lab"),
        ([*own, "a", "comment"], "a comment"),
    ):
        file.write_text("# keys\n\nssh-rsa AAAAB3NzaC1yc2E= other\n" + " ".join(line) + "\n")
        (key,) = statement.read_public_keys(file)
        assert key.who == who


@pytest.mark.parametrize(
    ("line", "expected_text"),
    [
        ("me ssh-ed25519 AAAA", "line 1 contains no"),
        ("me ssh-ed25519 !!", "line 1 contains no key"),
        ("me ssh-ed25519", "line 1 contains no key"),
        ('me valid-before="20300101" ssh-ed25519 KEY', "'valid-before=\"20300101\"' is not supported"),
        ("me cert-authority ssh-ed25519 KEY", "'cert-authority' is not supported"),
        ('me namespaces="file" ssh-ed25519 KEY', "contains no ssh-ed25519 key"),
        ("", "contains no ssh-ed25519 key"),
    ],
)
def test_files_without_a_key_of_ours_are_refused(
    signed_folder: Path, tmp_path: Path, line: str, expected_text: str
) -> None:
    file = tmp_path / "allowed"
    file.write_text(line.replace("KEY", (signed_folder / "key.pub").read_text().split()[1]))
    with pytest.raises(TandemError, match=expected_text) as caught:
        statement.read_public_keys(file)
    assert [issue.code for issue in caught.value.issues] == ["sign.key"]


def test_what_is_no_key_is_no_key(signed_folder: Path, tmp_path: Path) -> None:
    for path in (signed_folder / "key.pub", signed_folder / "problem.yaml", tmp_path / "none", tmp_path):
        with pytest.raises(TandemError) as caught:
            statement.read_private_key(path)
        assert [issue.code for issue in caught.value.issues] == ["sign.key"]
    assert (
        command_line.plan(signed_folder / "problem.yaml", tmp_path / "out", sign=tmp_path / "none")
        == command_line.BAD_INPUT
    )
    assert not (tmp_path / "out").exists()


def test_without_the_package_the_install_line_is_told(
    signed_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(TandemError, match=r"pip install 'tandem-planner\[sign\]'") as caught:
        statement.read_private_key(signed_folder / "key")
    assert [issue.code for issue in caught.value.issues] == ["sign.extra"]


# ---- what is signed ----------------------------------------


def verify(folder: Path, key: str = "key.pub", **more: Path) -> int:
    return command_line.verify(
        folder / "out", problem=folder / "problem.yaml", signed_by=folder / key, **more
    )


def test_a_signed_result_is_found_good(signed_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert verify(signed_folder) == command_line.DONE
    shown = capsys.readouterr()
    assert "sign.good" in shown.err
    assert "lab@cell" in shown.err
    assert "They are the same, values and files." in shown.out
    data = json.loads((signed_folder / "out" / "statement.json").read_text())
    assert data["proven"] is True
    assert data["problem"]["digest"] == pipeline.load(signed_folder / "problem.yaml").digest
    there = [p for p in (signed_folder / "out").rglob("*") if p.is_file() and "statement.json" not in p.name]
    assert set(data["files"]) == {p.relative_to(signed_folder / "out").as_posix() for p in there}
    assert "programs/T_ROB1/TandemMain_1.mod" in data["files"]
    assert {"report.html", "proof.json"} <= set(data["files"])


CHANGES = {
    "a program": ("programs/T_ROB1/TandemMain_1.mod", lambda t: t.replace("PROC main", "! x\n  PROC main")),
    "the report": ("report.html", lambda t: t + " "),
    "the proof": ("proof.json", lambda t: t.replace("true", "false", 1)),
    "the problem": ("problem/problem.yaml", lambda t: t + "# relaxed\n"),
}


@pytest.mark.parametrize("what", CHANGES)
def test_every_change_of_a_signed_file_is_told(
    copy: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    name, change = CHANGES[what]
    file = copy / "out" / name
    file.write_text(change(file.read_text()))
    assert verify(copy) == command_line.NOT_PROVEN
    shown = capsys.readouterr().err
    assert "sign.content" in shown
    assert f"{name} was changed" in shown


def test_files_that_come_and_go_are_told(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (copy / "out" / "proof.json").unlink()
    (copy / "out" / "programs" / "note.txt").write_text("x")
    assert verify(copy) == command_line.NOT_PROVEN
    shown = capsys.readouterr().err
    assert "proof.json is missing" in shown
    assert "programs/note.txt was added" in shown


@pytest.mark.parametrize("change", ["statement", "signature", "other key", "no armour", "none"])
def test_signatures_that_do_not_hold_are_told(
    copy: Path, capsys: pytest.CaptureFixture[str], change: str
) -> None:
    text, signature = copy / "out" / "statement.json", copy / "out" / "statement.json.sig"
    key, code = "key.pub", "sign.signature"
    if change == "statement":
        text.write_text(text.read_text().replace('"holds"', '"broken"', 1))
    elif change == "signature":
        lines = signature.read_text().splitlines()
        lines[-2] = lines[-2][:9] + ("A" if lines[-2][9] != "A" else "B") + lines[-2][10:]
        signature.write_text("\n".join(lines))
    elif change == "other key":
        keys(copy, "other")
        key = "other.pub"
    elif change == "no armour":
        signature.write_text("signed, the boss")
    else:
        signature.unlink()
        code = "sign.missing"
    assert verify(copy, key) == command_line.NOT_PROVEN
    assert code in capsys.readouterr().err


def test_a_result_is_signed_after_a_proof(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other, _ = keys(copy, "other")
    assert command_line.verify(copy / "out", sign=other) == command_line.DONE
    assert "was not compared with your own file" in capsys.readouterr().out
    assert verify(copy, "other.pub") == command_line.DONE


def test_what_is_not_proven_is_not_signed(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (copy / "out" / "statement.json.sig").read_bytes()
    file = copy / "out" / "programs" / "T_ROB1" / "TandemCut1_1.mod"
    file.write_text(file.read_text().replace("z3mm", "fine", 9))
    assert command_line.verify(copy / "out", sign=copy / "key") == command_line.NOT_PROVEN
    assert "sign.unproven" in capsys.readouterr().err
    assert (copy / "out" / "statement.json.sig").read_bytes() == before


@pytest.mark.long
def test_a_plan_is_signed_as_a_whole(copy: Path) -> None:
    key, _ = keys(copy, "other")
    assert command_line.plan(copy / "problem.yaml", copy / "out", sign=key) == command_line.DONE
    assert verify(copy, "other.pub") == command_line.DONE
    signed = json.loads((copy / "out" / "statement.json").read_text())["files"]
    assert {"report.html", "replay.html", "plan.npz", "plan.json", "proof.json"} <= set(signed)


def test_the_next_result_takes_the_old_signature_away(copy: Path) -> None:
    write_folder(copy / "out", {"report.html": "of another plan"}, RESULT_ENTRIES)
    assert not (copy / "out" / "statement.json").exists()
    assert not (copy / "out" / "statement.json.sig").exists()


# ---- one's own problem ----------------------------------------


def test_a_relaxed_problem_in_the_folder_is_shown(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The result was planned with less clearance and another table than the user's own problem."""
    data = yaml.safe_load((copy / "problem.yaml").read_text())
    own = copy / "own.yaml"
    own.write_text(yaml.safe_dump({**data, "settings": {"clearance_mm": 12}}))
    data["settings"] = {"clearance_mm": 0}
    (copy / "beads2.csv").write_text((copy / "beads.csv").read_text().replace("-36.0000", "-36.0100"))
    data["operations"][0]["file"] = "beads2.csv"
    del data["operations"][0]["feed_mm_s"]
    data["operations"][0]["feed_mm_s"] = 41
    (copy / "relaxed.yaml").write_text(yaml.safe_dump(data))
    write_folder(copy / "out", result(pipeline.load(copy / "relaxed.yaml")), RESULT_ENTRIES)
    assert command_line.verify(copy / "out") == command_line.DONE
    assert command_line.verify(copy / "out", problem=own) == command_line.NOT_PROVEN
    shown = capsys.readouterr()
    relaxed, expected = pipeline.load(copy / "relaxed.yaml").digest, pipeline.load(own).digest
    for text in (
        relaxed,
        expected,
        "settings.clearance_mm: 0 in",
        ", 12 in",
        "operations[0].feed_mm_s: 41 in",
    ):
        assert text in shown.out
    assert "operations[0].file: " in shown.out
    assert "verify.problem_differs" in shown.err
    assert "verify.digest" in shown.err


def test_a_changed_copy_is_told_though_the_programs_hold(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stored = copy / "out" / "problem" / "problem.yaml"
    stored.write_text(stored.read_text().replace("name: beads", "name: other", 1))
    assert command_line.verify(copy / "out", problem=copy / "problem.yaml") == command_line.DONE
    assert "verify.problem_differs" in capsys.readouterr().err
    assert (
        command_line.verify(copy / "out", problem=copy / "problem.yaml", sign=copy / "key")
        == command_line.NOT_PROVEN
    )
    assert "sign.unproven" in capsys.readouterr().err
    stored.unlink()
    assert command_line.verify(copy / "out", problem=copy / "problem.yaml") == command_line.DONE
    assert "cannot be read" in capsys.readouterr().err


def test_differences_field_by_field(tmp_path: Path) -> None:
    for name, content in (("a.csv", "1"), ("b.csv", "1"), ("c.csv", "2")):
        (tmp_path / name).write_text(content)

    def source(file: str, **more: object) -> dict[str, object]:
        return {"name": "x", "list": [1, {"file": str(tmp_path / file)}], **more}

    assert differences(source("a.csv"), source("b.csv")) == ()
    (found,) = differences(source("a.csv"), source("c.csv"))
    assert found.field == "list[1].file"
    assert found.first.startswith("a.csv, SHA-256 6b86b273")
    (gone,) = differences(source("a.csv"), source("none.csv"))
    assert gone.second == "none.csv, missing"
    more = differences(
        source("a.csv", deep={"k": [1, 2]}, flag=True), source("a.csv", deep={"k": [1]}, flag=1)
    )
    assert [(d.field, d.first, d.second) for d in more] == [
        ("deep.k[1]", "2", "not given"),
        ("flag", "True", "1"),
    ]


def test_the_statement_is_the_same_each_time(signed_folder: Path) -> None:
    problem = pipeline.load(signed_folder / "problem.yaml")
    proof = pipeline.verify(problem, pipeline.read_programs(signed_folder / "out"))
    first = statement.text(signed_folder / "out", problem, proof)
    assert first == statement.text(signed_folder / "out", problem, proof)
    assert first == (signed_folder / "out" / "statement.json").read_bytes()
