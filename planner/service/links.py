"""Links that require no token and open a file of one job, or a read-only page of the job.

Both are signed with a secret that all hosts of one database share (HMAC, RFC 2104). A view link is also a
row of the store, with its creator and its end. The row is deleted when the link is withdrawn or found
expired, or when its job is deleted. Without the row the signature opens nothing.
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
from planner.service.security import Principal, RefusedError, shared_secret

DEFAULT_LINK_S: Final = 3600
"""Default lifetime [s] of a link to a file."""
MAX_LINK_S: Final = 86400
"""Maximum lifetime [s] of a link to a file."""
DEFAULT_VIEW_LINK_S: Final = 7 * 86400
"""Default lifetime [s] of a view link."""
MAX_VIEW_LINK_S: Final = 30 * 86400
"""Maximum lifetime [s] of a view link."""
MAX_VIEW_LINKS: Final = 20
"""Maximum number of view links of one job that are in force at once."""
MAX_CLOCK_SKEW_S: Final = 60.0
"""Maximum time [s] by which the creation of a view link may lie in the future.

A link with a later creation time was made while the clock was wrong, and is refused.
"""
VIEWABLE_FILES: Final = ("report.html", "replay.html")
"""Files of a job that a view link opens."""


class Links:
    """The links of one database."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._secret = bytes.fromhex(shared_secret(database, "links"))

    def sign(self, job: str, name: str, expires: int, token_id: str | None = None) -> str:
        """Return the signature of a link to a file.

        Args:
            job: Id of the job.
            name: Name of the file.
            expires: End of the link [s since 1970].
            token_id: Token that makes the link, or None for the owner of the job.
        """
        return self._hmac("tandem link", job, name, expires, *([] if token_id is None else [token_id]))

    def check(
        self, job: str, name: str, expires: int | None, signature: str, team_tokens: Sequence[str] = ()
    ) -> str | None:
        """Verify a link to a file.

        Args:
            job: Id of the job.
            name: Name of the file.
            expires: End of the link [s since 1970].
            signature: Signature of the link.
            team_tokens: Other tokens of the owner's team.

        Returns:
            The one of ``team_tokens`` that made the link, or None for the owner.

        Raises:
            RefusedError: 403, the signature is wrong or the link has expired.
        """
        for token_id in (None, *team_tokens):
            expected = "" if expires is None else self.sign(job, name, expires, token_id)
            if expires is None or not _equal_signatures(expected, signature):
                continue
            if expires <= time.time():
                raise file_link_refusal("has expired. Ask for a new one.")
            return token_id
        raise file_link_refusal("has an invalid signature. Copy the whole link, or ask for a new one.")

    def create_view_link(self, job: JobOut, principal: Principal, seconds: int) -> LinkMade:
        """Create a view link.

        Args:
            job: Job.
            principal: Caller.
            seconds: Lifetime [s].

        Raises:
            RefusedError: 409, the job has too many view links.
        """
        link_id = secrets.token_hex(16)
        with self._database.write() as db:
            self._database.lock(db, job.id)
            now = self._database.clock()
            db.execute(delete(LINKS).where(LINKS.c.job == job.id, LINKS.c.expires <= now))
            count = db.execute(select(func.count()).where(LINKS.c.job == job.id)).scalar_one()
            if count >= MAX_VIEW_LINKS:
                message = f"job {job.id}: too many view links (got {count}, allowed {MAX_VIEW_LINKS}). "
                raise RefusedError(409, Issue("service.link", f"{message}Withdraw one first."))
            columns = {"id": link_id, "job": job.id, "token": principal.token, "who": principal.name}
            db.execute(insert(LINKS).values(**columns, created=now, expires=now + float(seconds)))
            created, expires = db.execute(
                select(LINKS.c.created, LINKS.c.expires).where(LINKS.c.id == link_id)
            ).one()
            details = {"name": job.name, "link": link_id, "until": utc(expires).isoformat()}
            event = audit.AuditEvent("linked", job.id, details)
            audit.record_act(self._database, db, principal.token, event)
        signature = self._hmac("tandem look", job.id, link_id)
        path = f"/ui/look/{job.id}/{link_id}?signature={signature}"
        return LinkMade(id=link_id, by=principal.name, created=utc(created), expires=utc(expires), path=path)

    def view_links(self, job: str) -> list[LookLink]:
        """Return the view links of a job that are in force, newest first."""
        now = self._database.clock()
        query = select(LINKS).where(LINKS.c.job == job, LINKS.c.expires > now)
        with self._database.read() as db:
            rows = db.execute(query.order_by(LINKS.c.created.desc(), LINKS.c.id)).mappings().all()
        return [
            LookLink(id=row["id"], by=row["who"], created=utc(row["created"]), expires=utc(row["expires"]))
            for row in rows
        ]

    def withdraw(self, job: JobOut, link_id: str, principal: Principal) -> None:
        """End a view link early.

        Args:
            job: Job.
            link_id: Id of the link.
            principal: Caller.

        Raises:
            RefusedError: 404, the job has no such link.
        """
        link_filter = and_(LINKS.c.id == link_id, LINKS.c.job == job.id)
        with self._database.write() as db:
            creator = db.execute(select(LINKS.c.who).where(link_filter)).scalar()
            if not db.execute(delete(LINKS).where(link_filter)).rowcount:
                message = f"job {job.id}: link {link_id[:80]!r} not found. List its links."
                raise RefusedError(404, Issue("service.link", message, field="look"))
            details = {"name": job.name, "link": link_id, "made_by": creator}
            event = audit.AuditEvent("unlinked", job.id, details)
            audit.record_act(self._database, db, principal.token, event)

    def check_view_link(self, job: str, link_id: str, signature: str) -> tuple[str, dt.datetime]:
        """Verify a view link by the clock that all hosts share. An expired link stays expired.

        Args:
            job: Id of the job.
            link_id: Id of the link.
            signature: Signature of the link.

        Returns:
            Token that made the link, and the end of the link.

        Raises:
            RefusedError: 404, the link is unknown, expired or withdrawn, or its signature is wrong.
        """
        if not _equal_signatures(self._hmac("tandem look", job, link_id), signature):
            raise view_link_refusal()
        now = self._database.clock()
        link_filter = and_(LINKS.c.id == link_id, LINKS.c.job == job)
        query = select(
            LINKS.c.token, LINKS.c.expires, LINKS.c.expires <= now, LINKS.c.created <= now + MAX_CLOCK_SKEW_S
        )
        with self._database.read() as db:
            row = db.execute(query.where(link_filter)).first()
        if row is None:
            raise view_link_refusal()
        creator, expires, expired, created_before = row
        if expired:  # a clock that is set back must not revive the link
            with self._database.write() as db:
                db.execute(delete(LINKS).where(link_filter, LINKS.c.expires <= self._database.clock()))
        if expired or not created_before:
            raise view_link_refusal()
        return creator, utc(expires)

    def _hmac(self, *signed: str | int) -> str:
        return hmac.new(self._secret, json.dumps(signed).encode(), hashlib.sha256).hexdigest()


def _equal_signatures(expected: str, given: str) -> bool:
    return hmac.compare_digest(expected.encode(), given.encode("utf-8", "surrogatepass"))


def file_link_refusal(why: str) -> RefusedError:
    """Return the refusal of a link to a file: 403."""
    return RefusedError(403, Issue("service.link", f"link: {why}", field="signature"))


def view_link_refusal() -> RefusedError:
    """Return the refusal of a view link: 404.

    All causes give an equal refusal, so that guessing reveals nothing.
    """
    message = (
        "link: expired, withdrawn or incomplete. Copy the whole link again, or ask the person who sent it."
    )
    return RefusedError(404, Issue("service.link", message))
