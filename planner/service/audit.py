"""The audit log: who submitted, cancelled, tried again, deleted, released, withdrew, downloaded, made links.

An entry is written in the transaction that does the thing, so there are both or neither, with the time of the
clock that all hosts share. Entries are numbered, so that their order does not depend on that clock. They
outlive jobs and tokens, and go by age alone. A download is written down before it is sent, once an hour for
the same file, token and release: parts of a file are asked for one by one.
"""

import json
from collections.abc import Mapping
from typing import Any, Final

from sqlalchemy import Connection, RowMapping, delete, func, insert, select

from planner.service.models import AUDIT, JOBS, TOKENS, Act, AuditOut, Database, utc
from planner.service.security import LOCAL, Who

SAME_S: Final = 3600.0
"""Time [s] in which the same download is written down once."""
FORGOTTEN: Final = 1000
"""Entries that go by age at once: a clock that jumps, and is set right, takes no more than these."""
AGED: Final = "the service, by age"
"""Who deletes jobs that are as old as they may be."""


def note(
    database: Database,
    db: Connection,
    by: str,
    act: Act,
    job: str,
    about: Mapping[str, Any],
    who: str | None = None,
) -> None:
    """Write down what the token ``by`` did, as the last thing of a transaction: others that write entries
    wait for its end. ``who``: in another name than the token's."""
    token = db.execute(select(TOKENS.c.name, TOKENS.c.team).where(TOKENS.c.id == by)).first()
    name, team = (LOCAL, None) if token is None else token.tuple()
    database.one_at_a_time(db, "audit")
    last = db.execute(select(func.max(AUDIT.c.number))).scalar() or 0
    row = {"number": last + 1, "token": by, "who": who or name, "team": team, "act": act, "job": job}
    text = json.dumps(dict(about), ensure_ascii=False, sort_keys=True)
    db.execute(insert(AUDIT).values(**row, at=database.clock(), about=text))


def note_download(database: Database, by: str, job: str, about: Mapping[str, Any]) -> None:
    """Write down that somebody gets programs of a job, with the number of its last release, if it had any:
    what is released anew is another download."""
    with database.read() as db:
        number = db.execute(select(JOBS.c.releases).where(JOBS.c.id == job)).scalar()
        about = {**about, "release_number": number} if number else about
        text = json.dumps(dict(about), ensure_ascii=False, sort_keys=True)
        same = (AUDIT.c.job == job, AUDIT.c.token == by, AUDIT.c.act == "downloaded", AUDIT.c.about == text)
        now = database.clock()  # what was written by a clock that was ahead is of no moment near this one
        near = (AUDIT.c.at > now - SAME_S, AUDIT.c.at < now + SAME_S)
        query = select(AUDIT.c.number).where(*same, *near).limit(1)
        if db.execute(query).first() is not None:
            return
    with database.write() as db:
        note(database, db, by, "downloaded", job, about)


def page(
    database: Database, who: Who, job: str | None, acts: tuple[str, ...], before: int | None, count: int
) -> tuple[list[AuditOut], int | None]:
    """Up to ``count`` entries of the team of ``who``, or of its token where it has none, the newest first,
    and the number before which more follow, if any do."""
    own = AUDIT.c.token == who.token if who.team is None else AUDIT.c.team == who.team
    with database.read() as db:
        rows = _rows(db, own, job, acts, before, count + 1)
    return [_out(row) for row in rows[:count]], rows[count - 1]["number"] if len(rows) > count else None


def everything(database: Database, job: str | None, acts: tuple[str, ...], count: int) -> list[AuditOut]:
    """The last ``count`` entries of the store, whoever's, the newest first."""
    with database.read() as db:
        return [_out(row) for row in _rows(db, None, job, acts, None, count)]


def forget(database: Database, db: Connection, older_s: float) -> None:
    """Remove entries that are so old, some at a time, and never the last one, from which numbers go on."""
    first, last = db.execute(select(func.min(AUDIT.c.number), func.max(AUDIT.c.number))).one()
    if first is not None:
        some = (AUDIT.c.number < last, AUDIT.c.number < first + FORGOTTEN)
        db.execute(delete(AUDIT).where(*some, AUDIT.c.at < database.clock() - older_s))


def _rows(
    db: Connection, own: Any, job: str | None, acts: tuple[str, ...], before: int | None, count: int
) -> list[RowMapping]:
    query = select(AUDIT).order_by(AUDIT.c.number.desc()).limit(count)
    for condition in (
        own,
        None if job is None else AUDIT.c.job == job,
        AUDIT.c.act.in_(acts) if acts else None,
        None if before is None else AUDIT.c.number < before,
    ):
        query = query if condition is None else query.where(condition)
    return list(db.execute(query).mappings())


def _out(row: RowMapping) -> AuditOut:
    about = json.loads(row["about"])
    return AuditOut(
        number=row["number"],
        at=utc(row["at"]),
        by=row["who"],
        team=row["team"],
        act=row["act"],
        job=row["job"],
        about=about,
    )
