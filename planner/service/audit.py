"""Audit log: who submitted, cancelled, retried, deleted, released, withdrew, downloaded or linked.

- An entry is written in the transaction of the action, so that both exist or neither.
- Its time is that of the clock that all hosts share. Its number gives the order, independent of that clock.
- Entries outlive jobs and tokens. They are deleted by age only.
- A download is recorded before it is sent, once an hour for the same file, token and release, because
  clients request parts of a file one by one.
"""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any, Final

from sqlalchemy import Connection, RowMapping, delete, func, insert, select

from planner.service.models import AUDIT, JOBS, TOKENS, AuditAct, AuditOut, Database, utc
from planner.service.security import LOCAL, Principal

DOWNLOAD_REPEAT_S: Final = 3600.0
"""Time [s] in which repeated downloads of the same file are recorded once."""
MAX_DELETED_ENTRIES: Final = 1000
"""Maximum number of entries deleted by age at a time.

A clock that jumps ahead and is corrected deletes no more than these.
"""
DELETED_BY_AGE: Final = "the service, by age"
"""Name recorded for the deletion of jobs by age."""


@dataclasses.dataclass(frozen=True)
class AuditEvent:
    """What was done, and to what.

    Attributes:
        act: Kind of action.
        job: Job, draft or element.
        details: Details, as plain data.
    """

    act: AuditAct
    job: str
    details: Mapping[str, Any]


def record_act(
    database: Database, db: Connection, token_id: str, event: AuditEvent, actor: str | None = None
) -> None:
    """Write an entry as the last statement of a transaction.

    Other transactions that write entries wait for its end.

    Args:
        database: Database of the log.
        db: Open write transaction.
        token_id: Token that acted.
        event: What was done.
        actor: Name to record instead of the token's.
    """
    token = db.execute(select(TOKENS.c.name, TOKENS.c.team).where(TOKENS.c.id == token_id)).first()
    name, team = (LOCAL, None) if token is None else token.tuple()
    database.lock(db, "audit")
    last_number = db.execute(select(func.max(AUDIT.c.number))).scalar() or 0
    row = {"number": last_number + 1, "token": token_id, "who": actor or name, "team": team}
    row |= {"act": event.act, "job": event.job}
    details_json = json.dumps(dict(event.details), ensure_ascii=False, sort_keys=True)
    db.execute(insert(AUDIT).values(**row, at=database.clock(), about=details_json))


def record_download(database: Database, token_id: str, job: str, details: Mapping[str, Any]) -> None:
    """Record that programs of a job are downloaded, unless the same entry was written in the last hour.

    The entry contains the number of the job's last release, if any. A download after a new release is
    therefore recorded again.

    Args:
        database: Database of the log.
        token_id: Token that downloads.
        job: Job.
        details: Details, as plain data.
    """
    with database.read() as db:
        number = db.execute(select(JOBS.c.releases).where(JOBS.c.id == job)).scalar()
        details = {**details, "release_number": number} if number else details
        details_json = json.dumps(dict(details), ensure_ascii=False, sort_keys=True)
        same_download = (
            AUDIT.c.job == job,
            AUDIT.c.token == token_id,
            AUDIT.c.act == "downloaded",
            AUDIT.c.about == details_json,
        )
        now = database.clock()
        # The upper bound excludes entries that were written while the clock was ahead.
        recent = (AUDIT.c.at > now - DOWNLOAD_REPEAT_S, AUDIT.c.at < now + DOWNLOAD_REPEAT_S)
        query = select(AUDIT.c.number).where(*same_download, *recent).limit(1)
        if db.execute(query).first() is not None:
            return
    with database.write() as db:
        record_act(database, db, token_id, AuditEvent("downloaded", job, details))


def page(
    database: Database,
    principal: Principal,
    job: str | None,
    acts: tuple[str, ...],
    cursor: int | None,
    count: int,
) -> tuple[list[AuditOut], int | None]:
    """Read a page of the log, newest first.

    Args:
        database: Database of the log.
        principal: Caller. Entries of its team are listed, or of its token if it has no team.
        job: Only entries of this job.
        acts: Only these actions; empty for all.
        cursor: Only entries with a smaller number, from the previous page.
        count: Maximum number of entries.

    Returns:
        Entries, and the cursor of the next page, or None.
    """
    team_filter = (
        AUDIT.c.token == principal.token if principal.team is None else AUDIT.c.team == principal.team
    )
    with database.read() as db:
        rows = _rows(db, team_filter, job, acts, cursor, count + 1)
    return [_entry_model(row) for row in rows[:count]], rows[count - 1]["number"] if len(
        rows
    ) > count else None


def all_entries(database: Database, job: str | None, acts: tuple[str, ...], count: int) -> list[AuditOut]:
    """Read the last entries of all teams, newest first.

    Args:
        database: Database of the log.
        job: Only entries of this job.
        acts: Only these actions; empty for all.
        count: Maximum number of entries.
    """
    with database.read() as db:
        return [_entry_model(row) for row in _rows(db, None, job, acts, None, count)]


def delete_old_entries(database: Database, db: Connection, older_s: float) -> None:
    """Delete old entries, at most `MAX_DELETED_ENTRIES` at a time.

    The last entry is never deleted, because numbering continues from it.

    Args:
        database: Database of the log.
        db: Open write transaction.
        older_s: Minimum age [s] of deleted entries.
    """
    first, last = db.execute(select(func.min(AUDIT.c.number), func.max(AUDIT.c.number))).one()
    if first is not None:
        batch = (AUDIT.c.number < last, AUDIT.c.number < first + MAX_DELETED_ENTRIES)
        db.execute(delete(AUDIT).where(*batch, AUDIT.c.at < database.clock() - older_s))


def _rows(
    db: Connection, team_filter: Any, job: str | None, acts: tuple[str, ...], cursor: int | None, count: int
) -> list[RowMapping]:
    """Select the newest ``count`` entries that meet all conditions. None or empty means no condition."""
    query = select(AUDIT).order_by(AUDIT.c.number.desc()).limit(count)
    for condition in (
        team_filter,
        None if job is None else AUDIT.c.job == job,
        AUDIT.c.act.in_(acts) if acts else None,
        None if cursor is None else AUDIT.c.number < cursor,
    ):
        query = query if condition is None else query.where(condition)
    return list(db.execute(query).mappings())


def _entry_model(row: RowMapping) -> AuditOut:
    """Convert a database row of the audit log to its API model."""
    details = json.loads(row["about"])
    return AuditOut(
        number=row["number"],
        at=utc(row["at"]),
        by=row["who"],
        team=row["team"],
        act=row["act"],
        job=row["job"],
        about=details,
    )
