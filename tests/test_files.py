"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner import files


def test_a_failed_write_leaves_the_old_file_and_no_litter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    files.write_whole(path, "old")

    def fail(_: int) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(files.os, "fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        files.write_whole(path, "new")
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_is_replaced_as_a_whole_and_foreign_files_stay(tmp_path: Path) -> None:
    owned = ("programs", "report.html")
    (tmp_path / "notes.txt").write_text("mine")
    files.write_folder(tmp_path, {"programs/a/x.mod": "1", "report.html": "r"}, owned)
    files.write_folder(tmp_path, {"report.html": "r2"}, owned)
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*")) == ["notes.txt", "report.html"]
    assert (tmp_path / "report.html").read_text() == "r2"


def test_an_interrupted_folder_keeps_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    owned = ("programs",)
    files.write_folder(tmp_path, {"programs/x.mod": "old"}, owned)
    real = files.write_whole

    def interrupted(path: Path, content: str | bytes) -> None:
        real(path, content)
        raise KeyboardInterrupt

    monkeypatch.setattr(files, "write_whole", interrupted)
    with pytest.raises(KeyboardInterrupt):
        files.write_folder(tmp_path, {"programs/x.mod": "new", "programs/y.mod": "new"}, owned)
    assert (tmp_path / "programs" / "x.mod").read_text() == "old"
    assert not list(tmp_path.glob(".tandem-*"))
