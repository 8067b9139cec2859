"""Drafts: problems in the making, and cells, tools and templates that people keep for later.

A draft is kept as it was sent, right or wrong, with the last `VERSIONS` that it was before, by whom and when.
Who saves says which version he has: one that somebody else has saved over meanwhile is not lost. Content lies
with the files of jobs, so it is stored once, charged, swept and backed up as theirs.
"""

import json
import secrets
from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import Connection, RowMapping, and_, delete, func, insert, or_, outerjoin, select, update

from planner.issues import Issue, refusal
from planner.reading.strict_yaml import MAX_YAML_BYTES
from planner.service import audit, finding
from planner.service.jobs import job_files, put_files
from planner.service.models import (
    CANCELLED,
    DRAFT_VERSIONS,
    DRAFTS,
    FILES,
    JOBS,
    TOKENS,
    Act,
    Database,
    moment,
    utc,
)
from planner.service.security import LOCAL, MB, Limits, RefusedError, Who, too_large, too_many
from planner.service.storage import Blob, Upload

VERSIONS: Final = 100
"""So many versions of a draft are kept, the newest."""
UNTITLED: Final = "Draft"
"""What a draft is called whose title is empty."""
OPERATOR: Final = "who runs the service"
"""In whose name drafts of a token are passed on or deleted by the command line."""


class Drafts:
    """The drafts of one database."""

    def __init__(self, database: Database, limits: Limits) -> None:
        self._database, self._limits = database, limits

    def create(self, who: Who, kind: str, title: str, upload: Upload) -> RowMapping:
        """A new draft; raises :class:`RefusedError`, 413, or 429 where its owner has too many."""
        _check_size(upload)
        draft = secrets.token_hex(16)
        with self._database.write() as db:
            self._database.one_at_a_time(db, f"drafts {who.token}")
            mine = select(func.count()).select_from(DRAFTS).where(DRAFTS.c.owner == who.token)
            most, have = self._limits.drafts, int(db.execute(mine).scalar_one())
            if have >= most:
                what = f"{have} drafts, cells, tools and templates are kept, at most {most} may be; "
                raise too_many(f"{what}delete some", 60, most)
            now = self._database.clock()
            row = {"id": draft, "owner": who.token, "kind": kind, "title": title or UNTITLED, "version": 1}
            db.execute(insert(DRAFTS).values(**row, created=now, changed=now))
            self._add_version(db, draft, 1, who, upload.problem, upload.files)
            return draft_row(db, draft)

    def save(
        self,
        draft: str,
        who: Who,
        tags: Sequence[str],
        upload: Upload,
        without: Sequence[str],
        title: str | None = None,
        instead: str | None = None,
    ) -> RowMapping:
        """The next version of a draft, for who has the one that is the last: the upload, and files of before
        that it does not send anew, but ``without`` those. What is there already makes no version. It is
        called ``title`` then, unless it has another title by now than the one ``instead`` of which that is.
        Raises :class:`RefusedError`: 404, 412 where it was saved meanwhile, 413, 422."""
        _check_size(upload)
        with self._database.write() as db:
            self._database.one_at_a_time(db, draft)
            row = draft_row(db, draft)
            last = version_row(db, draft, row["version"])
            if "*" not in tags and tag_of(row) not in tags:
                when = moment(utc(last["at"]))
                what = f"draft {draft}: {last['who']} saved version {row['version']} of it meanwhile, {when}"
                way = "nothing was overwritten: open that version, or keep yours as another draft"
                raise RefusedError(412, Issue("service.draft", f"{what}; {way}", field="If-Match"))
            known, blobs = _files_of(last), job_files(db, draft)
            kept = {name: blobs[sha] for name, sha in known.items() if name not in without}
            kept |= upload.files
            if len(kept) > self._limits.files:
                what = f"the draft has {len(kept)} files with these, at most {self._limits.files} may be"
                raise RefusedError(422, Issue("service.request", f"{what}; take some away", field="files"))
            if upload.problem.sha != last["problem"] or {n: b.sha for n, b in kept.items()} != known:
                number = row["version"] + 1
                self._add_version(db, draft, number, who, upload.problem, kept)
                values = {"version": number, "changed": self._database.clock()}
                db.execute(update(DRAFTS).where(DRAFTS.c.id == draft).values(**values))
                _forget(db, draft, number - VERSIONS)
            if title is not None:
                _call(db, draft, title, instead)
            return draft_row(db, draft)

    def rename(self, draft: str, title: str) -> RowMapping:
        """Call it otherwise; raises :class:`RefusedError`, 404."""
        with self._database.write() as db:
            _call(db, draft, title)
            return draft_row(db, draft)

    def mark_sent(self, draft: str, number: int, job: str) -> RowMapping:
        """Note that a version was sent as that job, unless a newer one was; raises :class:`RefusedError`,
        404."""
        with self._database.write() as db:
            version_row(db, draft, number)
            first = or_(DRAFTS.c.sent.is_(None), DRAFTS.c.sent <= number)
            db.execute(update(DRAFTS).where(DRAFTS.c.id == draft, first).values(sent=number, job=job))
            return draft_row(db, draft)

    def delete(self, draft: str, by: str) -> None:
        """Delete a draft with its versions; raises :class:`RefusedError`, 404."""
        with self._database.write() as db:
            self._database.one_at_a_time(db, draft)
            row = draft_row(db, draft)
            _remove(db, draft)
            said = {"name": row["title"], "kind": row["kind"]}
            audit.note(self._database, db, by, "deleted", draft, said)

    def get(self, draft: str) -> tuple[RowMapping, list[RowMapping]]:
        """A draft and its versions, the newest first; raises :class:`RefusedError`, 404."""
        query = select(DRAFT_VERSIONS).where(DRAFT_VERSIONS.c.draft == draft)
        with self._database.read() as db:
            row = draft_row(db, draft)
            rows = db.execute(query.order_by(DRAFT_VERSIONS.c.number.desc())).mappings().all()
        return row, list(rows)

    def version(self, draft: str, number: int) -> tuple[Blob, dict[str, Blob]]:
        """Problem and files of a version; raises :class:`RefusedError`, 404."""
        with self._database.read() as db:
            row = version_row(db, draft, number)
            blobs = job_files(db, draft)
        return blobs[row["problem"]], {name: blobs[sha] for name, sha in _files_of(row).items()}

    def page(
        self, owners: Sequence[str], kinds: Sequence[str], count: int, cursor: str | None = None
    ) -> tuple[list[RowMapping], str | None]:
        """Up to ``count`` drafts of the owners, what was changed last first, behind the ``cursor`` of the
        page before; and the cursor behind which more follow, if any do."""
        query = _with_names().where(DRAFTS.c.owner.in_(owners))
        if kinds:
            query = query.where(DRAFTS.c.kind.in_(kinds))
        if cursor is not None:  # that draft may have been changed since, or deleted
            query = query.where(finding.older(DRAFTS.c.changed, DRAFTS.c.id, cursor))
        query = query.order_by(DRAFTS.c.changed.desc(), DRAFTS.c.id.desc()).limit(count + 1)
        with self._database.read() as db:
            rows = list(db.execute(query).mappings())
        last = rows[count - 1] if len(rows) > count else None
        return rows[:count], None if last is None else finding.mark(last["changed"], last["id"])

    def of_token(self, name: str) -> Sequence[RowMapping]:
        """All drafts of the token of that name, also of one that is over, the newest first. Raises
        ``TandemError`` where there is no such token."""
        with self._database.read() as db:
            own = DRAFTS.c.owner == token_named(db, name)
            return db.execute(_with_names().where(own).order_by(DRAFTS.c.changed.desc())).mappings().all()

    def pass_on(self, name: str, to: str | None) -> int:
        """Give all drafts of the token of that name to the one called ``to``, or delete them; how many they
        were. It is who runs the service that does so: no limit of the other token holds. Raises
        ``TandemError`` where there is no such token."""
        with self._database.write() as db:
            owner = token_named(db, name)
            other = None if to is None else token_named(db, to)
            rows = db.execute(select(DRAFTS).where(DRAFTS.c.owner == owner)).mappings().all()
            for row in rows:
                self._database.one_at_a_time(db, row["id"])
                if other is None:
                    _remove(db, row["id"])
            if other is not None:
                db.execute(update(DRAFTS).where(DRAFTS.c.owner == owner).values(owner=other))
            for row in rows:
                said = {"name": row["title"], "kind": row["kind"]} | ({} if to is None else {"to": to})
                act: Act = "deleted" if to is None else "passed"
                audit.note(self._database, db, owner, act, row["id"], said, OPERATOR)
            return len(rows)

    def owner(self, draft: str) -> str | None:
        """Whose draft it is; None where there is none."""
        with self._database.read() as db:
            found: str | None = db.execute(select(DRAFTS.c.owner).where(DRAFTS.c.id == draft)).scalar()
        return found

    def _add_version(
        self, db: Connection, draft: str, number: int, who: Who, problem: Blob, files: Any
    ) -> None:
        blobs = {blob.sha: blob for blob in (problem, *files.values())}
        put_files(db, draft, blobs)
        named = [{"name": name, "sha": blob.sha} for name, blob in sorted(files.items())]
        row = {"draft": draft, "number": number, "who": who.name, "problem": problem.sha}
        text = json.dumps(named, ensure_ascii=False)
        db.execute(insert(DRAFT_VERSIONS).values(**row, at=self._database.clock(), files=text))


def unknown_draft(draft: str) -> RefusedError:
    """404."""
    what = f"draft {draft[:40]!r}: there is none; it was deleted, or belongs to others: list the drafts"
    return RefusedError(404, Issue("service.draft", what))


def tag_of(row: RowMapping) -> str:
    """The entity tag of a draft: of its last version."""
    return f'"{row["version"]}"'


def draft_row(db: Connection, draft: str) -> RowMapping:
    """A draft as the store has it; raises :class:`RefusedError`, 404."""
    row = db.execute(_with_names().where(DRAFTS.c.id == draft)).mappings().first()
    if row is None:
        raise unknown_draft(draft)
    return row


def version_row(db: Connection, draft: str, number: int) -> RowMapping:
    """A version as the store has it; raises :class:`RefusedError`, 404."""
    own = (DRAFT_VERSIONS.c.draft == draft, DRAFT_VERSIONS.c.number == number)
    row = db.execute(select(DRAFT_VERSIONS).where(*own)).mappings().first()
    if row is None:
        what = f"draft {draft[:40]}: it has no version {number}, or no more; list its versions"
        raise RefusedError(404, Issue("service.draft", what, field="number"))
    return row


def token_named(db: Connection, name: str) -> str:
    """The identifier of the token of that name, also of one that is over. Raises ``TandemError``."""
    found: str | None = db.execute(select(TOKENS.c.id).where(TOKENS.c.name == name)).scalar()
    if found is None:
        what = f"name: got {name[:80]!r}; there is no token of that name: list them with tandem token list"
        raise refusal("service.token", what, field="name")
    return found


def _remove(db: Connection, draft: str) -> None:
    db.execute(delete(DRAFT_VERSIONS).where(DRAFT_VERSIONS.c.draft == draft))
    db.execute(delete(FILES).where(FILES.c.job == draft))
    db.execute(delete(DRAFTS).where(DRAFTS.c.id == draft))


def _call(db: Connection, draft: str, title: str, instead: str | None = None) -> None:
    """Give a draft a title; ``instead`` of that one alone, where it is stated."""
    named = DRAFTS.c.id == draft if instead is None else and_(DRAFTS.c.id == draft, DRAFTS.c.title == instead)
    db.execute(update(DRAFTS).where(named).values(title=title or UNTITLED))


def _with_names() -> Any:
    more = (func.coalesce(TOKENS.c.name, LOCAL).label("made_by"), JOBS.c.id.label("sent_as"))
    named = outerjoin(DRAFTS, TOKENS, DRAFTS.c.owner == TOKENS.c.id)
    there = and_(DRAFTS.c.job == JOBS.c.id, JOBS.c.cancel <= CANCELLED)
    return select(DRAFTS, *more).select_from(outerjoin(named, JOBS, there))


def _files_of(version: RowMapping) -> dict[str, str]:
    """SHA-256 of the files of a version by their names."""
    return {one["name"]: one["sha"] for one in json.loads(version["files"])}


def _forget(db: Connection, draft: str, last: int) -> None:
    """Remove the versions up to ``last``, and what they alone named."""
    own = DRAFT_VERSIONS.c.draft == draft
    if not db.execute(delete(DRAFT_VERSIONS).where(own, DRAFT_VERSIONS.c.number <= last)).rowcount:
        return
    wanted: set[str] = set()
    for row in db.execute(select(DRAFT_VERSIONS).where(own)).mappings():
        wanted |= {row["problem"], *_files_of(row).values()}
    db.execute(delete(FILES).where(FILES.c.job == draft, FILES.c.name.not_in(sorted(wanted))))


def _check_size(upload: Upload) -> None:
    if upload.problem.size > MAX_YAML_BYTES:
        raise too_large("the problem", MAX_YAML_BYTES / MB, "problem")
