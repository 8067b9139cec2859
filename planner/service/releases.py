"""Programs that a named person has released, and what downloads say of that.

Only what is proven can be released. What is released is written down by content: the digest of the problem,
the SHA-256 of its proof, and of each program as it lies in the store, after it was read again and found to be
the one that the proof names. A release holds until it is withdrawn, and belongs to its job alone.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from sqlalchemy import Connection, RowMapping, insert, select, update

from planner.issues import Issue
from planner.service import audit
from planner.service.jobs import job_files, job_row, release_of
from planner.service.models import JOBS, RELEASES, Database, JobOut, Release, ReleaseOut, Shown, moment, utc
from planner.service.security import LOCAL, RefusedError, Who
from planner.service.storage import Blob, Files

HEADER: Final = "Tandem-Release"
"""Name of the header by which downloads say whether they are released."""
PROGRAMS: Final = "programs/"
"""How the names of programs begin among the files of a job."""
PROOF: Final = "proof.json"
"""The file that names the programs which were proven."""


class Told(NamedTuple):
    """Whether programs are released, in a word, and as a file: the same bytes for the same release, whenever
    they are asked for."""

    word: str
    content: bytes


class _Seen(NamedTuple):
    """A job that was looked at: its files, and the SHA-256 of its programs by name."""

    job: str
    files: dict[str, Blob]
    programs: dict[str, str]


class Releases:
    """The releases of one database, of programs among ``files``."""

    def __init__(self, database: Database, files: Files) -> None:
        self._database, self._files = database, files

    def release(self, job: str, who: Who, name: str | None, note: str) -> ReleaseOut:
        """Release the programs of a job in the name of ``who``, or by that ``name`` where no tokens are asked
        for. Raises :class:`RefusedError`: 404, 409 where it is not proven or released already, 422."""
        person = _person(who, name)
        seen = self._look(job)
        with self._database.write() as db:
            made = self._write(db, seen, who, person, note)
            self._note(db, made, who, {})
        return made

    def release_panels(
        self,
        element: str,
        panels: Mapping[str, Shown],
        last: Callable[[Connection], Mapping[str, str]],
        who: Who,
        name: str | None,
        note: str,
    ) -> tuple[dict[str, ReleaseOut], dict[str, RefusedError]]:
        """Release the programs of panels of an element, by one act of one person: those that are as they were
        shown, proven, not released yet, and of which that job is the ``last``; and why the others are not, by
        their ids. Raises :class:`RefusedError`, 422."""
        person = _person(who, name)
        seen: dict[str, _Seen] = {}
        made: dict[str, ReleaseOut] = {}
        refused: dict[str, RefusedError] = {}
        with self._database.read() as db:
            now = last(db)
        for panel, shown in panels.items():
            try:
                _still(now.get(panel), shown.job)  # before anything is told of that job
                seen[panel] = self._look(shown.job, shown.digest)
            except RefusedError as error:
                refused[panel] = error
        with self._database.write() as db:
            now = last(db)  # to look at many files has taken its time
            for panel in sorted(seen, key=lambda one: seen[one].job):  # two who do so wait in one order
                try:
                    _still(now.get(panel), seen[panel].job)
                    made[panel] = self._write(db, seen[panel], who, person, note)
                except RefusedError as error:
                    refused[panel] = error
            for panel in made:
                self._note(db, made[panel], who, {"element": element, "panel": panel})
        return made, refused

    def _look(self, job: str, digest: str | None = None) -> _Seen:
        """A job whose programs may be released, if it has that ``digest``; raises :class:`RefusedError`, 404
        or 409."""
        with self._database.read() as db:
            files, row = job_files(db, job), job_row(db, job)  # so a job that is there had its files
        if digest is not None and row["digest"] != digest:
            what = f"its problem has the digest {row['digest'][:16]}, you were shown {digest[:16]}"
            raise _not_releasable(job, what, "look at it again")
        return _Seen(job, files, self._proven(row, files))

    def _write(self, db: Connection, seen: _Seen, who: Who, person: str, note: str) -> ReleaseOut:
        """Write a release down; raises :class:`RefusedError`, 404 or 409, before anything is written."""
        job = seen.job
        self._database.one_at_a_time(db, job)
        row = _held(db, job)
        last = _last(db, job)
        if last is not None and last["withdrawn"] is None:
            what = f"job {job}: {last['who']} released it, {moment(utc(last['at']))}; withdraw that first"
            raise RefusedError(409, Issue("service.release", what))
        if job_files(db, job) != seen.files:  # whatever made them others, it was not looked at
            raise _not_releasable(job, "its files were changed meanwhile", "look at it again")
        number = row["releases"] + 1
        values = {"job": job, "number": number, "token": who.token, "who": person, "note": note}
        values |= {"digest": row["digest"], "proof": seen.files[PROOF].sha}
        values |= {"programs": json.dumps(seen.programs), "at": self._database.clock()}
        db.execute(insert(RELEASES).values(**values))
        db.execute(update(JOBS).where(JOBS.c.id == job).values(releases=number))
        return _out(row, _known(_last(db, job)))

    def _note(self, db: Connection, made: ReleaseOut, who: Who, more: Mapping[str, str]) -> None:
        said = made.model_dump(mode="json", include={"name", "note", "digest", "proof", "programs"})
        audit.note(self._database, db, who.token, "released", made.job, said | dict(more), made.by)

    def withdraw(self, job: str, who: Who, name: str | None, reason: str) -> ReleaseOut:
        """Take a release back. Raises :class:`RefusedError`: 404, 409 where there is none, 422."""
        person = _person(who, name)
        with self._database.write() as db:
            self._database.one_at_a_time(db, job)
            row = _held(db, job)
            last = _last(db, job)
            if last is None or last["withdrawn"] is not None:
                said = (
                    "it is not released" if last is None else f"{last['withdrawn_who']} withdrew it already"
                )
                what = f"job {job}: {said}; there is nothing to withdraw"
                raise RefusedError(409, Issue("service.release", what))
            values = {"withdrawn_token": who.token, "withdrawn_who": person, "reason": reason}
            own = (RELEASES.c.job == job, RELEASES.c.number == last["number"])
            db.execute(update(RELEASES).where(*own).values(**values, withdrawn=self._database.clock()))
            about = {"name": row["name"], "reason": reason, "released_by": last["who"]}
            audit.note(self._database, db, who.token, "withdrew", job, about, person)
            return _out(row, _known(_last(db, job)))

    def all(self, job: str) -> list[ReleaseOut]:
        """The releases of a job, the newest first; raises :class:`RefusedError`, 404."""
        query = select(RELEASES).where(RELEASES.c.job == job).order_by(RELEASES.c.number.desc())
        with self._database.read() as db:
            row = job_row(db, job)
            return [_out(row, one) for one in db.execute(query).mappings()]

    def told(self, job: JobOut, files: Mapping[str, Blob]) -> Told:
        """Whether the programs of a job are released, for what goes out with them."""
        known = self.all(job.id)[:1]
        said: dict[str, Any] = {"released": False, "says": "not released", "job": job.id, "name": job.name}
        if not known:
            said |= {"digest": job.digest, "programs": _programs(files), "release": None}
        for one in known:
            withdrawn = one.withdrawn
            taken = withdrawn and f"; withdrawn by {withdrawn.by}, {moment(withdrawn.at)}"
            said["released"] = withdrawn is None
            said["says"] = f"released by {one.by}, {moment(one.at)}{taken or ''}"
            said |= {"digest": one.digest, "proof": one.proof, "programs": one.programs}
            said["release"] = one.model_dump(mode="json", include={"by", "at", "note", "withdrawn"})
        content = (json.dumps(said, indent=1, ensure_ascii=False) + "\n").encode()
        return Told(word(known[0] if known else None), content)

    def _proven(self, row: RowMapping, files: Mapping[str, Blob]) -> dict[str, str]:
        """SHA-256 of the programs by name, if they are those that the job's proof names, and lie in the store
        as that says; raises :class:`RefusedError`, 409."""
        job, programs = row["id"], _programs(files)
        if row["state"] != "verified" or not programs or PROOF not in files:
            way = "only programs whose proof holds are released: see its issues"
            raise _not_releasable(job, f"it is {row['state']}", way)
        for name, blob in files.items():
            if (name.startswith(PROGRAMS) or name == PROOF) and self._intact(blob) is None:
                what = f"{name} is not in the store as it was written"
                raise _not_releasable(job, what, "the store is damaged: tell who runs the service")
        try:
            proof = json.loads(self._files.read(files[PROOF].sha))
            ok, digest, named = proof["ok"], proof["problem_digest"], dict(proof.get("programs") or {})
        except (ValueError, KeyError, TypeError) as error:
            raise _not_releasable(job, "its proof cannot be read", "plan it again") from error
        faults = {
            "the verdict of its proof is not verified": ok is not True,
            "its proof is of another problem": digest != row["digest"],
            "its proof names other programs, or none": named != programs,
        }
        for what, is_so in faults.items():
            if is_so:
                raise _not_releasable(job, what, "plan it again with this version")
        return programs

    def _intact(self, blob: Blob) -> bytes | None:
        """The content, if it lies in the store as it was written."""
        try:
            content = self._files.read(blob.sha)
        except FileNotFoundError:
            return None
        return content if hashlib.sha256(content).hexdigest() == blob.sha else None

    def read(self, job: str, programs: Mapping[str, Blob]) -> dict[str, bytes]:
        """The contents of programs that go out: what is said of them is said of these bytes. Raises
        :class:`RefusedError`, 500, where one is not in the store as it was written."""
        out = {}
        for name, blob in programs.items():
            content = self._intact(blob)
            if content is None:
                what = f"job {job}: {name} is not in the store as it was written; it is not given out: tell "
                what += "who runs the service, and plan the job again"
                raise RefusedError(500, Issue("service.damaged", what, field=name))
            out[name] = content
        return out


def is_program(name: str) -> bool:
    """Whether a file of a job is one that robots run."""
    return name.startswith(PROGRAMS)


def word(last: Release | None) -> str:
    """How downloads call themselves by the last release of their programs."""
    return "not-released" if last is None else "released" if last.withdrawn is None else "withdrawn"


def _programs(files: Mapping[str, Blob]) -> dict[str, str]:
    return {n.removeprefix(PROGRAMS): blob.sha for n, blob in sorted(files.items()) if is_program(n)}


def _last(db: Connection, job: str) -> RowMapping | None:
    query = select(RELEASES).where(RELEASES.c.job == job).order_by(RELEASES.c.number.desc()).limit(1)
    return db.execute(query).mappings().first()


def _known(row: RowMapping | None) -> RowMapping:
    if row is None:
        raise TypeError("a release that was just written is not there")
    return row


def _held(db: Connection, job: str) -> RowMapping:
    """A job whose row nobody deletes until the transaction ends; raises :class:`RefusedError`, 404."""
    db.execute(select(JOBS.c.id).where(JOBS.c.id == job).with_for_update())
    return job_row(db, job)


def _person(who: Who, name: str | None) -> str:
    """Who answers for a release; raises :class:`RefusedError`, 422."""
    if who.token == LOCAL:
        if name:
            return name
        what = "name: is missing; say who releases, for this service asks for no tokens"
    elif name in (None, who.name):
        return who.name
    else:
        what = f"name: got {(name or '')[:80]!r}; it is {who.name}, by the token: leave it out"
    raise RefusedError(422, Issue("service.request", what, field="name"))


def _still(now: str | None, shown: str) -> None:
    """Raises :class:`RefusedError`, 409, where the job of a panel is another one ``now`` than was shown."""
    if now != shown:
        what = "its job was deleted" if now is None else f"it was planned again meanwhile, as job {now}"
        raise RefusedError(409, Issue("service.release", f"{what}; look at it again"))


def _not_releasable(job: str, what: str, way: str) -> RefusedError:
    return RefusedError(409, Issue("service.release", f"job {job}: {what}; {way}"))


def _out(job: RowMapping, row: RowMapping) -> ReleaseOut:
    of = {name: row[name] for name in ("job", "digest", "proof")}
    programs = json.loads(row["programs"])
    return ReleaseOut(**dict(release_of(row)), **of, name=job["name"], programs=programs)
