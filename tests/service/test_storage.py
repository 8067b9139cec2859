"""Storage quotas: what a token, and the whole service, may occupy. Equal content counts once."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import shutil
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from planner.service import storage
from planner.service.security import RefusedError, ServiceLimits
from planner.service.storage import GRACE_S, ContentStore, StorageQuota, blob_of
from tests import small_problem
from tests.service.support import TABLE, InProcess, named_problem


@pytest.fixture
def running_service(tmp_path: Path) -> Iterator[InProcess]:
    with InProcess(tmp_path / "data", ServiceLimits(token_disk_mb=1.0), examiners=1) as made:
        yield made


def send(running_service: InProcess, name: str, filling: bytes, path: str = "/v1/jobs") -> Any:
    """Send the small problem with a file that no problem refers to."""
    files = [
        ("problem", ("p.yaml", named_problem(name))),
        ("files", ("targets.csv", TABLE)),
        ("files", ("more.txt", filling)),
    ]
    return running_service.http.post(path, files=files)


def storage_refusal(answer: Any) -> dict[str, Any]:
    assert answer.status_code == 507
    (issue,) = answer.json()["issues"]
    assert (issue["code"], issue["field"], issue["unit"]) == ("service.storage", "files", "MB")
    return dict(issue)


def test_a_token_has_so_much_room_and_content_counts_once(running_service: InProcess) -> None:
    large = os.urandom(600_000)
    for name in ("one", "two"):  # the same content
        sent = send(running_service, name, large)
        assert sent.status_code == 201
        running_service.wait_for_end(sent.json()["id"])  # its results count, too
    before = running_service.http.get("/v1/storage").json()
    assert before["limit_mb"] == 1.0
    assert 0.6 < before["used_mb"] < 0.7
    issue = storage_refusal(send(running_service, "three", os.urandom(600_000)))
    assert issue["value"] > issue["limit"] == 1.0
    assert "Delete jobs" in issue["hint"]
    assert running_service.http.get("/v1/storage").json() == before  # what was refused is not kept
    assert running_service.service.files.used < 700_000
    storage_refusal(send(running_service, "four", os.urandom(600_000), "/v1/check"))
    storage_refusal(send(running_service, "five", os.urandom(600_000), "/ui/preview"))


def test_room_of_deleted_jobs_is_free_again(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", ServiceLimits(token_disk_mb=0.6), examiners=1) as running_service:
        wide = "\n".join([small_problem.COLUMNS, *small_problem.ROWS * 10_000]).encode()
        body = [("problem", ("p.yaml", named_problem("wide"))), ("files", ("targets.csv", wide[:450_000]))]
        text = wide[:450_000].rsplit(b"\n", 1)[0]
        body[1] = ("files", ("targets.csv", text))
        job = running_service.http.post("/v1/jobs", files=body).json()["id"]
        running_service.wait_for_end(job)
        storage_refusal(send(running_service, "next", os.urandom(300_000)))
        assert running_service.http.delete(f"/v1/jobs/{job}").status_code == 204
        running_service.service.storage._sent.clear()  # as an hour later
        assert send(running_service, "next", os.urandom(300_000)).status_code == 201


def test_what_was_checked_counts_for_an_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = ContentStore(tmp_path)
    room = StorageQuota(files, lambda owner: {}, ServiceLimits(token_disk_mb=1.0))
    room.put("ann", [io.BytesIO(b"a" * 600_000)])
    with pytest.raises(RefusedError):
        room.put("ann", [io.BytesIO(b"b" * 600_000)])
    room.put("bob", [io.BytesIO(b"b" * 600_000)])  # another token has its own room
    assert room.used("ann") == 600_000
    later = time.monotonic() + GRACE_S + 1.0
    monkeypatch.setattr(storage.time, "monotonic", lambda: later)
    assert room.used("ann") == 0
    room.put("ann", [io.BytesIO(b"b" * 600_000)])


def test_the_service_has_so_much_room_for_all(tmp_path: Path) -> None:
    files = ContentStore(tmp_path)
    room = StorageQuota(files, lambda owner: {}, ServiceLimits(disk_mb=1.0))
    first = room.put("ann", [io.BytesIO(b"a" * 600_000), io.BytesIO(b"a" * 600_000)])
    assert first[0] == first[1]
    assert files.used == 600_000
    room.put("bob", [io.BytesIO(b"a" * 600_000)])  # it is there
    with pytest.raises(RefusedError) as caught:
        room.put("bob", [io.BytesIO(b"b" * 300_000), io.BytesIO(b"c" * 300_000)])
    assert caught.value.status == 507
    assert not files.has(blob_of(io.BytesIO(b"b" * 300_000)).sha)  # all or nothing
    assert ContentStore(tmp_path).used == 600_000  # known again after a restart
    for path in tmp_path.glob("*/*"):
        os.utime(path, (0, 0))
    assert files.sweep(lambda shas: set()) == 1
    assert files.used == 0
    room.put("bob", [io.BytesIO(b"b" * 300_000), io.BytesIO(b"c" * 300_000)])


class CountedStream(io.BytesIO):
    """Content that counts how many of its bytes were read."""

    count = 0

    def read(self, size: int | None = -1, /) -> bytes:
        chunk = super().read(size)
        self.count += len(chunk)
        return chunk


def test_content_is_hashed_once_and_read_again_only_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = StorageQuota(files := ContentStore(tmp_path), lambda owner: {}, ServiceLimits(disk_mb=4.0))
    hashed: list[int] = []

    class Digest:
        def __init__(self) -> None:
            self._digest = hashlib.sha256()

        def update(self, chunk: bytes) -> None:
            hashed.append(len(chunk))
            self._digest.update(chunk)

        def hexdigest(self) -> str:
            return self._digest.hexdigest()

    monkeypatch.setattr(storage, "hashlib", types.SimpleNamespace(sha256=Digest))
    content = os.urandom(3_000_000)
    for owner, reads in (("ann", 2), ("ann", 1), ("bob", 1)):  # it is new only once
        (blob,) = room.put(owner, [stream := CountedStream(content)])
        assert (blob.sha, blob.size) == (hashlib.sha256(content).hexdigest(), len(content))
        assert stream.count == reads * len(content)
        assert sum(hashed) == len(content)
        hashed.clear()
    assert files.read(blob.sha) == content
    with pytest.raises(RefusedError):
        room.put("bob", [stream := CountedStream(b"b" * 2_000_000)])
    assert stream.count == sum(hashed) == 2_000_000  # nothing of it went to the disk
    assert [path.name for path in tmp_path.glob("*/*")] == [blob.sha]


def test_a_stream_that_broke_off_leaves_nothing(tmp_path: Path) -> None:
    files = ContentStore(tmp_path)
    blob = blob_of(io.BytesIO(b"whole"))
    with pytest.raises(OSError, match="read 3 bytes of a file of 5"):
        files.put(io.BytesIO(b"who"), blob)
    assert not files.has(blob.sha)
    assert files.used == 0
    assert not list(tmp_path.glob("*/*"))


def test_a_disk_that_is_full_or_nearly_is_507(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = StorageQuota(files := ContentStore(tmp_path), lambda owner: {}, ServiceLimits())
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(storage.shutil, "disk_usage", lambda root: usage._replace(free=200_000_000))
    with pytest.raises(RefusedError, match="too little free disk space"):
        room.put("ann", [io.BytesIO(b"a")])
    monkeypatch.undo()

    def full(stream: object, known: object) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    monkeypatch.setattr(files, "put", full)
    with pytest.raises(RefusedError) as caught:
        room.put("ann", [io.BytesIO(b"a")])
    assert (caught.value.status, caught.value.issues[0].code) == (507, "service.storage")


def test_results_are_charged_though_never_refused(tmp_path: Path) -> None:
    with InProcess(tmp_path / "data", ServiceLimits(token_disk_mb=0.01), examiners=1) as running_service:
        used = 0.0
        for number in range(40):
            answer = running_service.post(named_problem(f"n{number}"))
            if answer.status_code == 507:
                break
            assert running_service.wait_for_end(answer.json()["id"])["state"] == "verified"
            used = running_service.http.get("/v1/storage").json()["used_mb"]
        assert storage_refusal(answer)["limit"] == 0.01
        assert 0.005 < used < 0.012
