"""Releases of programs by a named person, and the release information in downloads.

Only proven programs can be released. A release records content: the digest of the problem, the SHA-256 of
its proof, and the SHA-256 of each program in the store, after the program was read again and compared with
the proof. A release is in force until it is withdrawn, and applies to its job only.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from sqlalchemy import Connection, RowMapping, insert, select, update

from planner.issues import Issue
from planner.service import audit
from planner.service.jobs import job_files, job_row, release_of
from planner.service.models import (
    JOBS,
    RELEASES,
    Database,
    JobOut,
    Release,
    ReleaseOut,
    Shown,
    format_time,
    utc,
)
from planner.service.security import LOCAL, Principal, RefusedError
from planner.service.storage import Blob, ContentStore

HEADER: Final = "Tandem-Release"
"""Name of the header by which downloads state whether they are released."""
PROGRAMS: Final = "programs/"
"""Prefix of the names of programs among the files of a job."""
PROOF: Final = "proof.json"
"""File that names the proven programs."""


class ReleaseStatement(NamedTuple):
    """Release state of programs.

    Attributes:
        word: not-released, released or withdrawn.
        content: Content of ``release.json``: identical bytes for the same release.
    """

    word: str
    content: bytes


class _VerifiedJob(NamedTuple):
    """A job whose files were verified.

    Attributes:
        job: Id of the job.
        files: Files by name.
        programs: SHA-256 of its programs, by name.
    """

    job: str
    files: dict[str, Blob]
    programs: dict[str, str]


class Releases:
    """The releases of one database."""

    def __init__(self, database: Database, files: ContentStore) -> None:
        self._database, self._files = database, files

    def release(self, job: str, principal: Principal, name: str | None, note: str) -> ReleaseOut:
        """Release the programs of a job.

        Args:
            job: Id of the job.
            principal: Authenticated caller.
            name: Name of the person, if the service requires no tokens.
            note: Note.

        Raises:
            RefusedError: 404, 409 if the job is not proven or already released, 422.
        """
        person = _responsible_person(principal, name)
        verified = self._verify_job(job)
        with self._database.write() as db:
            created = self._write(db, verified, principal, person, note)
            self._record_release(db, created, principal, {})
        return created

    def release_panels(
        self,
        element: str,
        panels: Mapping[str, Shown],
        read_last_jobs: Callable[[Connection], Mapping[str, str]],
        principal: Principal,
        name: str | None,
        note: str,
    ) -> tuple[dict[str, ReleaseOut], dict[str, RefusedError]]:
        """Release the programs of panels of an element in one act of one person.

        A panel is released if its job is proven, not released yet, as it was shown, and still the last job of
        the panel. The others are refused one by one.

        Args:
            element: Id of the element.
            panels: Job and digest of each panel as the person saw it.
            read_last_jobs: Function that reads the last job of each panel.
            principal: Authenticated caller.
            name: Name of the person, if the service requires no tokens.
            note: Note.

        Returns:
            Releases, and refusals, by panel.

        Raises:
            RefusedError: 422 if the name of the person is missing, or differs from that of the token.
        """
        person = _responsible_person(principal, name)
        verified: dict[str, _VerifiedJob] = {}
        releases: dict[str, ReleaseOut] = {}
        refused: dict[str, RefusedError] = {}
        with self._database.read() as db:
            last_jobs = read_last_jobs(db)
        for panel, shown in panels.items():
            try:
                # First, so that nothing is revealed about a job that is not of this element.
                _check_unchanged_job(last_jobs.get(panel), shown.job)
                verified[panel] = self._verify_job(shown.job, shown.digest)
            except RefusedError as error:
                refused[panel] = error
        with self._database.write() as db:
            last_jobs = read_last_jobs(db)  # again, because verifying many files takes time
            # All hosts lock jobs in the same order, which prevents deadlocks.
            for panel in sorted(verified, key=lambda panel_id: verified[panel_id].job):
                try:
                    _check_unchanged_job(last_jobs.get(panel), verified[panel].job)
                    releases[panel] = self._write(db, verified[panel], principal, person, note)
                except RefusedError as error:
                    refused[panel] = error
            for panel in releases:
                self._record_release(db, releases[panel], principal, {"element": element, "panel": panel})
        return releases, refused

    def _verify_job(self, job: str, digest: str | None = None) -> _VerifiedJob:
        """Verify the programs of a job that is to be released against its proof and the store.

        Args:
            job: Id of the job.
            digest: Digest of the problem as the person saw it, or None if it need not be compared.

        Raises:
            RefusedError: 404, or 409 if the job is not proven, damaged or changed.
        """
        with self._database.read() as db:
            files, row = job_files(db, job), job_row(db, job)  # in this order: an existing job had its files
        if digest is not None and row["digest"] != digest:
            problem = f"its problem has changed (digest {row['digest'][:16]}, shown {digest[:16]})"
            raise _not_releasable(job, problem, "Review it again.")
        return _VerifiedJob(job, files, self._proven_programs(row, files))

    def _write(
        self, db: Connection, verified: _VerifiedJob, principal: Principal, person: str, note: str
    ) -> ReleaseOut:
        """Record a release.

        Raises:
            RefusedError: 404 or 409, before anything is written.
        """
        job = verified.job
        self._database.lock(db, job)
        row = _locked_job(db, job)
        last = _last_release_row(db, job)
        if last is not None and last["withdrawn"] is None:
            message = (
                f"job {job}: released by {last['who']}, {format_time(utc(last['at']))}. Withdraw it first."
            )
            raise RefusedError(409, Issue("service.release", message))
        if job_files(db, job) != verified.files:  # the person has not reviewed these
            raise _not_releasable(job, "its files have changed", "Review it again.")
        number = row["releases"] + 1
        values = {"job": job, "number": number, "token": principal.token, "who": person, "note": note}
        values |= {"digest": row["digest"], "proof": verified.files[PROOF].sha}
        values |= {"programs": json.dumps(verified.programs), "at": self._database.clock()}
        db.execute(insert(RELEASES).values(**values))
        db.execute(update(JOBS).where(JOBS.c.id == job).values(releases=number))
        return _release_model(row, _existing_row(_last_release_row(db, job)))

    def _record_release(
        self, db: Connection, released: ReleaseOut, principal: Principal, extra_details: Mapping[str, str]
    ) -> None:
        """Write a release to the audit log, with ``extra_details`` such as the panel."""
        details = released.model_dump(mode="json", include={"name", "note", "digest", "proof", "programs"})
        event = audit.AuditEvent("released", released.job, details | dict(extra_details))
        audit.record_act(self._database, db, principal.token, event, released.by)

    def withdraw(self, job: str, principal: Principal, name: str | None, reason: str) -> ReleaseOut:
        """Withdraw the release of a job.

        Args:
            job: Id of the job.
            principal: Authenticated caller.
            name: Name of the person, if the service requires no tokens.
            reason: Reason.

        Raises:
            RefusedError: 404, 409 if there is no release, 422.
        """
        person = _responsible_person(principal, name)
        with self._database.write() as db:
            self._database.lock(db, job)
            row = _locked_job(db, job)
            last_release = _last_release_row(db, job)
            if last_release is None or last_release["withdrawn"] is not None:
                problem = (
                    "is not released"
                    if last_release is None
                    else f"already withdrawn by {last_release['withdrawn_who']}"
                )
                message = f"job {job}: {problem}. There is nothing to withdraw."
                raise RefusedError(409, Issue("service.release", message))
            values = {"withdrawn_token": principal.token, "withdrawn_who": person, "reason": reason}
            release_filter = (RELEASES.c.job == job, RELEASES.c.number == last_release["number"])
            db.execute(
                update(RELEASES).where(*release_filter).values(**values, withdrawn=self._database.clock())
            )
            details = {"name": row["name"], "reason": reason, "released_by": last_release["who"]}
            event = audit.AuditEvent("withdrew", job, details)
            audit.record_act(self._database, db, principal.token, event, person)
            return _release_model(row, _existing_row(_last_release_row(db, job)))

    def all(self, job: str) -> list[ReleaseOut]:
        """Return the releases of a job, newest first.

        Raises:
            RefusedError: 404.
        """
        query = select(RELEASES).where(RELEASES.c.job == job).order_by(RELEASES.c.number.desc())
        with self._database.read() as db:
            row = job_row(db, job)
            return [_release_model(row, release_row) for release_row in db.execute(query).mappings()]

    def statement(self, job: JobOut, files: Mapping[str, Blob]) -> ReleaseStatement:
        """Return the release state of a job's programs, as it is sent with them.

        Args:
            job: Job.
            files: Files of the job.
        """
        last_release = self.all(job.id)[:1]
        # The fields of a job that was never released. A last release replaces them.
        fields: dict[str, Any] = {"released": False, "says": "not released", "job": job.id, "name": job.name}
        if not last_release:
            fields |= {"digest": job.digest, "programs": _program_hashes(files), "release": None}
        for release in last_release:
            withdrawn = release.withdrawn
            withdrawal = withdrawn and f"; withdrawn by {withdrawn.by}, {format_time(withdrawn.at)}"
            fields["released"] = withdrawn is None
            fields["says"] = f"released by {release.by}, {format_time(release.at)}{withdrawal or ''}"
            fields |= {"digest": release.digest, "proof": release.proof, "programs": release.programs}
            fields["release"] = release.model_dump(mode="json", include={"by", "at", "note", "withdrawn"})
        content = (json.dumps(fields, indent=1, ensure_ascii=False) + "\n").encode()
        return ReleaseStatement(release_state(last_release[0] if last_release else None), content)

    def _proven_programs(self, row: RowMapping, files: Mapping[str, Blob]) -> dict[str, str]:
        """Return the SHA-256 of the programs by name, after comparing them with the proof and with the store.

        Args:
            row: Database row of the job.
            files: Stored files of the job, by name.

        Raises:
            RefusedError: 409, the job is not proven, or a program is damaged or differs from the proof.
        """
        job, programs = row["id"], _program_hashes(files)
        if row["state"] != "verified" or not programs or PROOF not in files:
            remedy = "Only programs with a valid proof can be released. See its issues."
            raise _not_releasable(job, f"state is {row['state']}", remedy)
        for name, blob in files.items():
            if (name.startswith(PROGRAMS) or name == PROOF) and self._read_intact(blob) is None:
                problem = f"{name} in the store is damaged"
                raise _not_releasable(job, problem, "Inform the operator of the service.")
        try:
            proof = json.loads(self._files.read(files[PROOF].sha))
            ok = proof["ok"]
            digest = proof["problem_digest"]
            proven_programs = dict(proof.get("programs") or {})
        except (ValueError, KeyError, TypeError) as error:
            raise _not_releasable(job, "its proof cannot be read", "Plan it again.") from error
        applies_by_problem = {
            "the verdict of its proof is not verified": ok is not True,
            "its proof belongs to another problem": digest != row["digest"],
            "its proof names other programs, or none": proven_programs != programs,
        }
        for problem, applies in applies_by_problem.items():
            if applies:
                raise _not_releasable(job, problem, "Plan it again with this version.")
        return programs

    def _read_intact(self, blob: Blob) -> bytes | None:
        """Return the content of a stored file, or None if it does not match its hash."""
        try:
            content = self._files.read(blob.sha)
        except FileNotFoundError:
            return None
        return content if hashlib.sha256(content).hexdigest() == blob.sha else None

    def read_programs(self, job: str, programs: Mapping[str, Blob]) -> dict[str, bytes]:
        """Read the programs of a download, so that the release information applies to exactly these bytes.

        Args:
            job: Id of the job.
            programs: Stored files by name.

        Raises:
            RefusedError: 500, a file in the store is damaged.
        """
        contents = {}
        for name, blob in programs.items():
            content = self._read_intact(blob)
            if content is None:
                message = (
                    f"job {job}: {name} in the store is damaged and not sent. Inform the operator of the "
                )
                message += "service, and plan the job again."
                raise RefusedError(500, Issue("service.damaged", message, field=name))
            contents[name] = content
        return contents


def is_program(name: str) -> bool:
    """Report whether a file of a job is a robot program."""
    return name.startswith(PROGRAMS)


def release_state(last: Release | None) -> str:
    """Return the release state in one word: not-released, released or withdrawn.

    Args:
        last: Last release of the job, or None.
    """
    return "not-released" if last is None else "released" if last.withdrawn is None else "withdrawn"


def _program_hashes(files: Mapping[str, Blob]) -> dict[str, str]:
    return {name.removeprefix(PROGRAMS): blob.sha for name, blob in sorted(files.items()) if is_program(name)}


def _last_release_row(db: Connection, job: str) -> RowMapping | None:
    query = select(RELEASES).where(RELEASES.c.job == job).order_by(RELEASES.c.number.desc()).limit(1)
    return db.execute(query).mappings().first()


def _existing_row(row: RowMapping | None) -> RowMapping:
    """Return the row of a release that the same transaction has written or read, which must exist."""
    if row is None:
        raise TypeError("a release that was just written is not there")
    return row


def _locked_job(db: Connection, job: str) -> RowMapping:
    """Read a job and lock its row until the transaction ends, so that it is not deleted.

    Raises:
        RefusedError: 404.
    """
    db.execute(select(JOBS.c.id).where(JOBS.c.id == job).with_for_update())
    return job_row(db, job)


def _responsible_person(principal: Principal, name: str | None) -> str:
    """Return the name of the person who releases or withdraws.

    Raises:
        RefusedError: 422, the name is missing, or differs from that of the token.
    """
    if principal.token == LOCAL:
        if name:
            return name
        message = "name: is missing. Give the name of the person, because this service requires no tokens."
    elif name in (None, principal.name):
        return principal.name
    else:
        message = (
            f"name: differs from the token (got {(name or '')[:80]!r}, allowed {principal.name}). Leave it "
            "out."
        )
    raise RefusedError(422, Issue("service.request", message, field="name"))


def _check_unchanged_job(last_job: str | None, shown: str) -> None:
    """Check that the job of a panel is still the one that was shown.

    Raises:
        RefusedError: 409, the panel was planned again, or its job was deleted.
    """
    if last_job != shown:
        problem = "its job was deleted" if last_job is None else f"it was planned again as job {last_job}"
        raise RefusedError(409, Issue("service.release", f"{problem}. Review it again."))


def _not_releasable(job: str, problem: str, remedy: str) -> RefusedError:
    return RefusedError(409, Issue("service.release", f"job {job}: {problem}. {remedy}"))


def _release_model(job: RowMapping, row: RowMapping) -> ReleaseOut:
    """Convert the database rows of a job and of its release to the API model of the release."""
    columns = {name: row[name] for name in ("job", "digest", "proof")}
    programs = json.loads(row["programs"])
    return ReleaseOut(**dict(release_of(row)), **columns, name=job["name"], programs=programs)
