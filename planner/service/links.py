"""Links, which open something of one job without a token: a file for a while, or what there is to look at.

Both are signed with a secret that all hosts of one database share (HMAC, RFC 2104). A link to look is a row
of the store too, which says who made it and when it ends. It goes when it is withdrawn or found over, or its
job deleted: without the row the signature opens nothing.
"""

import datetime as dt
import hashlib
import hmac
import json
import secrets
import time
from collections.abc import Sequence
from typing import Final

from sqlalchemy import and_, delete, func, insert, select

from planner.issues import Issue
from planner.service import audit
from planner.service.models import LINKS, Database, JobOut, LinkMade, LookLink, utc
from planner.service.security import RefusedError, Who, shared_secret

LINK_S: Final = 3600
"""Time [s] after which a link to a file ends, where nothing is said."""
LONGEST_LINK_S: Final = 86400
"""Time [s] after which any link to a file ends."""
LOOK_S: Final = 7 * 86400
"""Time [s] after which a link to look ends, where nothing is said."""
LONGEST_LOOK_S: Final = 30 * 86400
"""Time [s] after which any link to look ends."""
MOST_LOOKS: Final = 20
"""Links to look at one job that may be in force at once."""
SKEW_S: Final = 60.0
"""A link opens nothing while the clock is further than this [s] before the moment at which it was made."""
TO_LOOK_AT: Final = ("report.html", "replay.html")
"""Files of a job that a link to look opens."""


class Links:
    """The links of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._secret = bytes.fromhex(shared_secret(database, "links"))

    def sign(self, job: str, name: str, expires: int, by: str | None = None) -> str:
        """The signature for a file of a job until ``expires`` [s since 1970], of the token ``by``, or of its
        owner."""
        return self._hmac("tandem link", job, name, expires, *([] if by is None else [by]))

    def check(
        self, job: str, name: str, expires: int | None, signature: str, mates: Sequence[str] = ()
    ) -> str | None:
        """Which of the ``mates`` of the job's owner made the link, None for the owner himself, if the
        signature is that of this file of this job, and is not over. Raises :class:`RefusedError`, 403."""
        for by in (None, *mates):
            wanted = "" if expires is None else self.sign(job, name, expires, by)
            if expires is None or not _same(wanted, signature):
                continue
            if expires <= time.time():
                raise bad_link("it is over; ask for a new one")
            return by
        raise bad_link("it is not one that this service signed; copy it whole, or ask for a new one")

    def make(self, job: JobOut, who: Who, seconds: int) -> LinkMade:
        """A new link to look at a job. Raises :class:`RefusedError`, 409, where it has too many."""
        look = secrets.token_hex(16)
        with self._database.write() as db:
            self._database.one_at_a_time(db, job.id)
            now = self._database.clock()
            db.execute(delete(LINKS).where(LINKS.c.job == job.id, LINKS.c.expires <= now))
            count = db.execute(select(func.count()).where(LINKS.c.job == job.id)).scalar_one()
            if count >= MOST_LOOKS:
                what = f"job {job.id}: {count} links to look at it are in force, {MOST_LOOKS} may be; "
                raise RefusedError(409, Issue("service.link", f"{what}withdraw one first"))
            row = {"id": look, "job": job.id, "token": who.token, "who": who.name}
            db.execute(insert(LINKS).values(**row, created=now, expires=now + float(seconds)))
            made, over = db.execute(select(LINKS.c.created, LINKS.c.expires).where(LINKS.c.id == look)).one()
            said = {"name": job.name, "link": look, "until": utc(over).isoformat()}
            audit.note(self._database, db, who.token, "linked", job.id, said)
        signed = self._hmac("tandem look", job.id, look)
        path = f"/ui/look/{job.id}/{look}?signature={signed}"
        return LinkMade(id=look, by=who.name, created=utc(made), expires=utc(over), path=path)

    def all(self, job: str) -> list[LookLink]:
        """Links to look at a job that are not over, the newest first."""
        now = self._database.clock()
        query = select(LINKS).where(LINKS.c.job == job, LINKS.c.expires > now)
        with self._database.read() as db:
            rows = db.execute(query.order_by(LINKS.c.created.desc(), LINKS.c.id)).mappings().all()
        return [
            LookLink(id=r["id"], by=r["who"], created=utc(r["created"]), expires=utc(r["expires"]))
            for r in rows
        ]

    def withdraw(self, job: JobOut, look: str, who: Who) -> None:
        """End a link to look before its time. Raises :class:`RefusedError`, 404."""
        own = and_(LINKS.c.id == look, LINKS.c.job == job.id)
        with self._database.write() as db:
            by = db.execute(select(LINKS.c.who).where(own)).scalar()
            if not db.execute(delete(LINKS).where(own)).rowcount:
                what = f"job {job.id} has no link {look[:80]!r}, or it was withdrawn; list its links"
                raise RefusedError(404, Issue("service.link", what, field="look"))
            said = {"name": job.name, "link": look, "made_by": by}
            audit.note(self._database, db, who.token, "unlinked", job.id, said)

    def looker(self, job: str, look: str, signature: str) -> tuple[str, dt.datetime]:
        """The token that made this link to look, and the link's end, if it holds by the clock that all hosts
        share. One that is found over stays so. Raises :class:`RefusedError`, 404."""
        if not _same(self._hmac("tandem look", job, look), signature):
            raise no_look()
        now = self._database.clock()
        own = and_(LINKS.c.id == look, LINKS.c.job == job)
        query = select(
            LINKS.c.token, LINKS.c.expires, LINKS.c.expires <= now, LINKS.c.created <= now + SKEW_S
        )
        with self._database.read() as db:
            found = db.execute(query.where(own)).first()
        if found is None:
            raise no_look()
        maker, expires, over, made = found
        if over:  # a clock that is set back revives none
            with self._database.write() as db:
                db.execute(delete(LINKS).where(own, LINKS.c.expires <= self._database.clock()))
        if over or not made:
            raise no_look()
        return maker, utc(expires)

    def _hmac(self, *signed: str | int) -> str:
        return hmac.new(self._secret, json.dumps(signed).encode(), hashlib.sha256).hexdigest()


def _same(wanted: str, given: str) -> bool:
    return hmac.compare_digest(wanted.encode(), given.encode("utf-8", "surrogatepass"))


def bad_link(why: str) -> RefusedError:
    """403, of a link to a file."""
    return RefusedError(403, Issue("service.link", f"the link: {why}", field="signature"))


def no_look() -> RefusedError:
    """404, of a link to look, whatever is wrong with it: who has none learns nothing."""
    what = (
        "there is no such link: it is over, was withdrawn, or is not whole; copy it anew, or ask who sent it"
    )
    return RefusedError(404, Issue("service.link", what))
