"""Drafts: unfinished problems, and cells, tools and templates kept for later use.

A draft is stored unchanged, valid or not. The last `MAX_VERSIONS` versions are kept, with the name of the
person who saved each and the time. Saving requires the version that was edited (optimistic locking), so
that no other person's change is overwritten. Content is stored with the files of jobs. It is therefore
stored once, counted in the owner's storage, deleted when unused and backed up like these.
"""

import dataclasses
import json
import secrets
from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import Connection, RowMapping, and_, delete, func, insert, or_, outerjoin, select, update

from planner.issues import Issue, issue_error
from planner.reading.strict_yaml import MAX_YAML_BYTES
from planner.service import audit, job_search
from planner.service.jobs import job_files, put_files
from planner.service.models import (
    CANCELLED,
    DRAFT_VERSIONS,
    DRAFTS,
    FILES,
    JOBS,
    TOKENS,
    AuditAct,
    Database,
    format_time,
    utc,
)
from planner.service.security import LOCAL, MB, Principal, RefusedError, ServiceLimits, too_large, too_many
from planner.service.storage import Blob, ProblemUpload

MAX_VERSIONS: Final = 100
"""Maximum number of versions kept of a draft."""
DEFAULT_TITLE: Final = "Draft"
"""Title of drafts without one."""
OPERATOR_NAME: Final = "the operator of the service"
"""Name recorded for drafts that the command line passes on or deletes."""


@dataclasses.dataclass(frozen=True)
class DraftEdit:
    """Change of a draft, besides the upload.

    Attributes:
        tags: Entity tags of the version that was edited.
        without: Names of files of the last version that are dropped.
        title: New title, or None to keep it.
        replaced_title: Set the title only if the present one is this, or None to set it in any case.
    """

    tags: Sequence[str]
    without: Sequence[str] = ()
    title: str | None = None
    replaced_title: str | None = None


class DraftStore:
    """The drafts of one database."""

    def __init__(self, database: Database, limits: ServiceLimits) -> None:
        self._database, self._limits = database, limits

    def create(self, principal: Principal, kind: str, title: str, upload: ProblemUpload) -> RowMapping:
        """Create a draft.

        Args:
            principal: Owner.
            kind: draft, cell, tool or template.
            title: Title, or empty.
            upload: Problem and files.

        Raises:
            RefusedError: 413 if the problem is too large, 429 if the owner has too many drafts.
        """
        _check_size(upload)
        draft = secrets.token_hex(16)
        with self._database.write() as db:
            self._database.lock(db, f"drafts {principal.token}")
            draft_count_query = (
                select(func.count()).select_from(DRAFTS).where(DRAFTS.c.owner == principal.token)
            )
            max_drafts, draft_count = self._limits.drafts, int(db.execute(draft_count_query).scalar_one())
            if draft_count >= max_drafts:
                problem = (
                    f"too many drafts, cells, tools and templates (got {draft_count}, allowed {max_drafts}). "
                )
                raise too_many(f"{problem}Delete some.", 60, max_drafts)
            now = self._database.clock()
            row = {
                "id": draft,
                "owner": principal.token,
                "kind": kind,
                "title": title or DEFAULT_TITLE,
                "version": 1,
            }
            db.execute(insert(DRAFTS).values(**row, created=now, changed=now))
            self._add_version(db, draft, 1, principal, upload.problem, upload.files)
            return draft_row(db, draft)

    def save(self, draft: str, principal: Principal, upload: ProblemUpload, edit: DraftEdit) -> RowMapping:
        """Save the next version of a draft. If problem and files are unchanged, no version is created.

        Args:
            draft: Id of the draft.
            principal: Caller.
            upload: Problem and new files. Other files of the last version are kept.
            edit: Edited version, dropped files and new title.

        Raises:
            RefusedError: 404, 412 if the draft was saved since, 413 if the problem is too large, 422 if there
                are too many files.
        """
        _check_size(upload)
        with self._database.write() as db:
            self._database.lock(db, draft)
            row = draft_row(db, draft)
            last = version_row(db, draft, row["version"])
            if "*" not in edit.tags and entity_tag(row) not in edit.tags:
                saved_at = format_time(utc(last["at"]))
                problem = f"draft {draft}: {last['who']} saved version {row['version']} meanwhile, {saved_at}"
                remedy = "Nothing was overwritten. Open that version, or save yours as another draft."
                raise RefusedError(412, Issue("service.draft", f"{problem}. {remedy}", field="If-Match"))
            last_files, blobs = _version_files(last), job_files(db, draft)
            new_files = {name: blobs[sha] for name, sha in last_files.items() if name not in edit.without}
            new_files |= upload.files
            if len(new_files) > self._limits.files:
                problem = f"files: too many in the draft (got {len(new_files)}, allowed {self._limits.files})"
                raise RefusedError(422, Issue("service.request", f"{problem}. Remove some.", field="files"))
            if (
                upload.problem.sha != last["problem"]
                or {name: blob.sha for name, blob in new_files.items()} != last_files
            ):
                number = row["version"] + 1
                self._add_version(db, draft, number, principal, upload.problem, new_files)
                values = {"version": number, "changed": self._database.clock()}
                db.execute(update(DRAFTS).where(DRAFTS.c.id == draft).values(**values))
                _delete_old_versions(db, draft, number - MAX_VERSIONS)
            if edit.title is not None:
                _set_title(db, draft, edit.title, edit.replaced_title)
            return draft_row(db, draft)

    def rename(self, draft: str, title: str) -> RowMapping:
        """Give a draft another title.

        Args:
            draft: Id of the draft.
            title: New title.

        Raises:
            RefusedError: 404.
        """
        with self._database.write() as db:
            _set_title(db, draft, title)
            return draft_row(db, draft)

    def mark_sent(self, draft: str, number: int, job: str) -> RowMapping:
        """Record that a version was submitted as a job, unless a newer version was submitted before.

        Args:
            draft: Id of the draft.
            number: Version.
            job: Id of the job.

        Raises:
            RefusedError: 404.
        """
        with self._database.write() as db:
            version_row(db, draft, number)
            first = or_(DRAFTS.c.sent.is_(None), DRAFTS.c.sent <= number)
            db.execute(update(DRAFTS).where(DRAFTS.c.id == draft, first).values(sent=number, job=job))
            return draft_row(db, draft)

    def delete(self, draft: str, by: str) -> None:
        """Delete a draft with its versions.

        Args:
            draft: Id of the draft.
            by: Token that deletes it.

        Raises:
            RefusedError: 404.
        """
        with self._database.write() as db:
            self._database.lock(db, draft)
            row = draft_row(db, draft)
            _remove(db, draft)
            details = {"name": row["title"], "kind": row["kind"]}
            audit.record_act(self._database, db, by, audit.AuditEvent("deleted", draft, details))

    def get(self, draft: str) -> tuple[RowMapping, list[RowMapping]]:
        """Return a draft and its versions, newest first.

        Raises:
            RefusedError: 404.
        """
        query = select(DRAFT_VERSIONS).where(DRAFT_VERSIONS.c.draft == draft)
        with self._database.read() as db:
            row = draft_row(db, draft)
            rows = db.execute(query.order_by(DRAFT_VERSIONS.c.number.desc())).mappings().all()
        return row, list(rows)

    def version(self, draft: str, number: int) -> tuple[Blob, dict[str, Blob]]:
        """Return the problem and the files of a version.

        Raises:
            RefusedError: 404.
        """
        with self._database.read() as db:
            row = version_row(db, draft, number)
            blobs = job_files(db, draft)
        return blobs[row["problem"]], {name: blobs[sha] for name, sha in _version_files(row).items()}

    def page(
        self, owners: Sequence[str], kinds: Sequence[str], count: int, cursor: str | None = None
    ) -> tuple[list[RowMapping], str | None]:
        """Return a page of drafts, last changed first.

        Args:
            owners: Tokens whose drafts are listed.
            kinds: Only these kinds; empty for all.
            count: Maximum number of drafts.
            cursor: Cursor from the previous page.

        Returns:
            Drafts, and the cursor of the next page, or None.
        """
        query = _draft_query().where(DRAFTS.c.owner.in_(owners))
        if kinds:
            query = query.where(DRAFTS.c.kind.in_(kinds))
        if cursor is not None:  # the draft of the cursor may have been changed or deleted since
            query = query.where(job_search.older_than_cursor(DRAFTS.c.changed, DRAFTS.c.id, cursor))
        query = query.order_by(DRAFTS.c.changed.desc(), DRAFTS.c.id.desc()).limit(count + 1)
        with self._database.read() as db:
            rows = list(db.execute(query).mappings())
        last = rows[count - 1] if len(rows) > count else None
        return rows[:count], None if last is None else job_search.cursor_of(last["changed"], last["id"])

    def of_token(self, name: str) -> Sequence[RowMapping]:
        """Return all drafts of a token, newest first. The token may be revoked or expired.

        Args:
            name: Name of the token.

        Raises:
            TandemError: No such token.
        """
        with self._database.read() as db:
            owner_filter = DRAFTS.c.owner == token_id_by_name(db, name)
            return (
                db.execute(_draft_query().where(owner_filter).order_by(DRAFTS.c.changed.desc()))
                .mappings()
                .all()
            )

    def transfer(self, name: str, to: str | None) -> int:
        """Transfer all drafts of a token to another one, or delete them.

        The operator of the service does this, so limits of the other token do not apply.

        Args:
            name: Name of the token.
            to: Name of the other token, or None to delete the drafts.

        Returns:
            Number of drafts.

        Raises:
            TandemError: No such token.
        """
        with self._database.write() as db:
            owner = token_id_by_name(db, name)
            new_owner = None if to is None else token_id_by_name(db, to)
            rows = db.execute(select(DRAFTS).where(DRAFTS.c.owner == owner)).mappings().all()
            for row in rows:
                self._database.lock(db, row["id"])
                if new_owner is None:
                    _remove(db, row["id"])
            if new_owner is not None:
                db.execute(update(DRAFTS).where(DRAFTS.c.owner == owner).values(owner=new_owner))
            for row in rows:
                details = {"name": row["title"], "kind": row["kind"]} | ({} if to is None else {"to": to})
                act: AuditAct = "deleted" if to is None else "passed"
                event = audit.AuditEvent(act, row["id"], details)
                audit.record_act(self._database, db, owner, event, OPERATOR_NAME)
            return len(rows)

    def owner(self, draft: str) -> str | None:
        """Return the token that owns a draft, or None if there is no such draft."""
        with self._database.read() as db:
            owner: str | None = db.execute(select(DRAFTS.c.owner).where(DRAFTS.c.id == draft)).scalar()
        return owner

    def _add_version(
        self, db: Connection, draft: str, number: int, principal: Principal, problem: Blob, files: Any
    ) -> None:
        """Insert a version and record its content: ``problem``, and ``files`` as stored files by name."""
        blobs = {blob.sha: blob for blob in (problem, *files.values())}
        put_files(db, draft, blobs)
        file_rows = [{"name": name, "sha": blob.sha} for name, blob in sorted(files.items())]
        row = {"draft": draft, "number": number, "who": principal.name, "problem": problem.sha}
        text = json.dumps(file_rows, ensure_ascii=False)
        db.execute(insert(DRAFT_VERSIONS).values(**row, at=self._database.clock(), files=text))


def unknown_draft(draft: str) -> RefusedError:
    """Return the refusal for an unknown draft: 404."""
    message = f"draft {draft[:40]!r}: not found. It was deleted, or belongs to others. List the drafts."
    return RefusedError(404, Issue("service.draft", message))


def entity_tag(row: RowMapping) -> str:
    """Return the entity tag of a draft: that of its last version."""
    return f'"{row["version"]}"'


def draft_row(db: Connection, draft: str) -> RowMapping:
    """Read the database row of a draft.

    Raises:
        RefusedError: 404.
    """
    row = db.execute(_draft_query().where(DRAFTS.c.id == draft)).mappings().first()
    if row is None:
        raise unknown_draft(draft)
    return row


def version_row(db: Connection, draft: str, number: int) -> RowMapping:
    """Read the database row of a version.

    Raises:
        RefusedError: 404.
    """
    key_filter = (DRAFT_VERSIONS.c.draft == draft, DRAFT_VERSIONS.c.number == number)
    row = db.execute(select(DRAFT_VERSIONS).where(*key_filter)).mappings().first()
    if row is None:
        message = f"draft {draft[:40]}: version {number} not found. List its versions."
        raise RefusedError(404, Issue("service.draft", message, field="number"))
    return row


def token_id_by_name(db: Connection, name: str) -> str:
    """Return the identifier of a token. The token may be revoked or expired.

    Args:
        db: Database connection.
        name: Name of the token.

    Raises:
        TandemError: No such token.
    """
    token_id: str | None = db.execute(select(TOKENS.c.id).where(TOKENS.c.name == name)).scalar()
    if token_id is None:
        message = f"name: no such token (got {name[:80]!r}). List the tokens with tandem token list."
        raise issue_error("service.token", message, field="name")
    return token_id


def _remove(db: Connection, draft: str) -> None:
    db.execute(delete(DRAFT_VERSIONS).where(DRAFT_VERSIONS.c.draft == draft))
    db.execute(delete(FILES).where(FILES.c.job == draft))
    db.execute(delete(DRAFTS).where(DRAFTS.c.id == draft))


def _set_title(db: Connection, draft: str, title: str, replaced_title: str | None = None) -> None:
    """Set the title of a draft, only in place of ``replaced_title`` if that is given."""
    condition = (
        DRAFTS.c.id == draft
        if replaced_title is None
        else and_(DRAFTS.c.id == draft, DRAFTS.c.title == replaced_title)
    )
    db.execute(update(DRAFTS).where(condition).values(title=title or DEFAULT_TITLE))


def _draft_query() -> Any:
    """Return the query of drafts, with the name of the owner's token and the job that still exists."""
    columns = (func.coalesce(TOKENS.c.name, LOCAL).label("made_by"), JOBS.c.id.label("sent_as"))
    named = outerjoin(DRAFTS, TOKENS, DRAFTS.c.owner == TOKENS.c.id)
    job_exists = and_(DRAFTS.c.job == JOBS.c.id, JOBS.c.cancel <= CANCELLED)
    return select(DRAFTS, *columns).select_from(outerjoin(named, JOBS, job_exists))


def _version_files(version: RowMapping) -> dict[str, str]:
    """Return the SHA-256 of the files of a version, by name."""
    return {file["name"]: file["sha"] for file in json.loads(version["files"])}


def _delete_old_versions(db: Connection, draft: str, last_number: int) -> None:
    """Delete the versions up to ``last_number``, and the files that only these reference."""
    draft_filter = DRAFT_VERSIONS.c.draft == draft
    if not db.execute(
        delete(DRAFT_VERSIONS).where(draft_filter, DRAFT_VERSIONS.c.number <= last_number)
    ).rowcount:
        return
    used_shas: set[str] = set()
    for row in db.execute(select(DRAFT_VERSIONS).where(draft_filter)).mappings():
        used_shas |= {row["problem"], *_version_files(row).values()}
    db.execute(delete(FILES).where(FILES.c.job == draft, FILES.c.name.not_in(sorted(used_shas))))


def _check_size(upload: ProblemUpload) -> None:
    if upload.problem.size > MAX_YAML_BYTES:
        raise too_large("the problem", MAX_YAML_BYTES / MB, "problem")
