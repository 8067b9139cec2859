"""Search, filter and order of job lists; titles, tags and notes of jobs.

Each job has a search text that is case folded and normalised (NFKC), so that SQLite and PostgreSQL find the
same jobs in any language by plain comparison.
"""

import base64
import dataclasses
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, Final

from sqlalchemy import ColumnElement, RowMapping, Select, and_, or_

from planner.issues import Issue
from planner.service.models import JOBS, RELEASES, JobOrder
from planner.service.security import RefusedError

MAX_WORDS: Final = 10
"""Maximum number of words of a search."""


@dataclasses.dataclass(frozen=True)
class JobFilter:
    """Filter and order of a list of jobs.

    Attributes:
        states: States; empty for all.
        search: Words that all must occur.
        tags: Tags that a job must all have.
        order: Order.
        cursor: Cursor from the previous page.
        released: Only jobs whose release is in force.
    """

    states: Sequence[str] = ()
    search: str = ""
    tags: Sequence[str] = ()
    order: JobOrder = "newest"
    cursor: str | None = None
    released: bool = False


def fold(text: str) -> str:
    """Return a text in the form in which it is compared (NFKC, case folded)."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).casefold())


def description_columns(name: str, title: str, tags: Sequence[str], notes: str) -> dict[str, str]:
    """Return the columns that hold the title, tags and notes of a job, and their search text.

    Args:
        name: Name of the problem.
        title: Title, or empty.
        tags: Tags.
        notes: Notes.
    """
    return {
        "title": title,
        "tags": "".join(f"\n{tag}\n" for tag in tags),
        "notes": notes,
        "label": fold(title or name)[:200],
        "sought": fold("\n".join((name, title, notes))) + "".join(map(_search_tag, tags)),
    }


def is_tagged(tags: Sequence[str], tag: str) -> bool:
    """Report whether a tag is among the tags of a job, as a search would decide.

    Args:
        tags: Tags of the job.
        tag: Tag to find.
    """
    return fold(tag) in map(fold, tags)


def _search_tag(tag: str) -> str:
    """Return a tag as it occurs in the search text, between separators that no text contains."""
    return f"\x1f{fold(tag)}\x1f"


def tags_of(row: Mapping[str, Any] | RowMapping) -> list[str]:
    """Return the tags of a job from its database row."""
    return [tag for tag in row["tags"].split("\n") if tag]


def apply_filter(query: Select[Any], job_filter: JobFilter) -> Select[Any]:
    """Apply filter, order and cursor to a query.

    Args:
        query: Query of jobs, joined with their last releases.
        job_filter: Filter, order and cursor.

    Raises:
        RefusedError: 422, the cursor is invalid.
    """
    if job_filter.states:
        query = query.where(JOBS.c.state.in_(job_filter.states))
    for word in fold(job_filter.search).split()[:MAX_WORDS]:
        query = query.where(JOBS.c.sought.contains(word, autoescape=True))
    for tag in job_filter.tags:
        query = query.where(JOBS.c.sought.contains(_search_tag(tag), autoescape=True))
    if job_filter.released:
        query = query.where(RELEASES.c.who.is_not(None), RELEASES.c.withdrawn.is_(None))
    if job_filter.cursor is not None:  # the job of the cursor may have been deleted since
        query = query.where(_after_cursor(job_filter.order, job_filter.cursor))
    if job_filter.order == "title":
        return query.order_by(JOBS.c.label, JOBS.c.id)
    if job_filter.order == "oldest":
        return query.order_by(JOBS.c.created, JOBS.c.id)
    if job_filter.order == "turn":
        return query.order_by(JOBS.c.turn, JOBS.c.id)
    return query.order_by(JOBS.c.created.desc(), JOBS.c.id.desc())


def page_cursor(order: JobOrder, row: RowMapping) -> str:
    """Return the cursor of a page whose last job is ``row``.

    Args:
        order: Order of the list.
        row: Database row of the job.
    """
    if order == "title":
        return f"{base64.urlsafe_b64encode(row['label'].encode()).decode().rstrip('=')}~{row['id']}"
    return cursor_of(row["turn" if order == "turn" else "created"], row["id"])


def _after_cursor(order: JobOrder, cursor: str) -> ColumnElement[bool]:
    """Return the condition for jobs after a :func:`page_cursor` in a list of the same order.

    Cursors of lists by title contain "~", those of other orders do not.

    Raises:
        RefusedError: 422, the cursor is invalid or belongs to a list with another order.
    """
    if ("~" in cursor) != (order == "title"):
        message = "cursor: belongs to a list with another order. Start from the first page."
        raise RefusedError(422, Issue("service.request", message, field="cursor"))
    if order == "title":
        encoded_label, job_id = cursor.split("~")
        try:
            # page_cursor strips the padding; "=" * (-n % 4) fills up to a multiple of four characters
            label = base64.urlsafe_b64decode(encoded_label + "=" * (-len(encoded_label) % 4)).decode()
        except ValueError as error:
            message = "cursor: is invalid. Start from the first page."
            raise RefusedError(422, Issue("service.request", message, field="cursor")) from error
        if "\0" in label:  # PostgreSQL refuses such texts
            label = label.replace("\0", "")
        return or_(JOBS.c.label > label, and_(JOBS.c.label == label, JOBS.c.id > job_id))
    if order == "newest":
        return older_than_cursor(JOBS.c.created, JOBS.c.id, cursor)
    position, job_id = _split_cursor(cursor)
    if order == "turn":
        return or_(JOBS.c.turn > position, and_(JOBS.c.turn == position, JOBS.c.id > job_id))
    return or_(JOBS.c.created > position, and_(JOBS.c.created == position, JOBS.c.id > job_id))


def older_than_cursor(
    time: ColumnElement[float], row_id: ColumnElement[str], cursor: str
) -> ColumnElement[bool]:
    """Return the condition for rows after a :func:`cursor_of`, newest first, in any table.

    The row of the cursor may have been deleted.

    Args:
        time: Column with the time.
        row_id: Column with the id.
        cursor: Cursor from the previous page.
    """
    cursor_time, cursor_id = _split_cursor(cursor)
    return or_(time < cursor_time, and_(time == cursor_time, row_id < cursor_id))


def cursor_of(time: float, row_id: str) -> str:
    """Return the cursor of a page, with which the client requests the next page.

    It identifies the last row of the page in a list that is ordered by a time or a turn, then by id. Its form
    is "TIME-ID". A turn is a number [s] that orders queued jobs.

    Args:
        time: Time [s since 1970] or turn of the last row.
        row_id: Id of the last row.
    """
    # !r keeps all digits, so that the row is found exactly
    return f"{time!r}-{row_id}"


def _split_cursor(cursor: str) -> tuple[float, str]:
    """Return the time or turn and the id that a :func:`cursor_of` contains."""
    time, _, row_id = cursor.partition("-")
    return float(time), row_id
