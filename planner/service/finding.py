"""Jobs found again: what people call them, their tags and notes, and how lists are searched and sorted.

What is sought is kept beside each job without capitals and with one form for each letter (NFKC, case folded),
so that both databases find the same in any language, by plain comparison.
"""

import base64
import dataclasses
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, Final

from sqlalchemy import ColumnElement, RowMapping, Select, and_, or_

from planner.issues import Issue
from planner.service.models import JOBS, RELEASES, Sort
from planner.service.security import RefusedError

WORDS: Final = 10
"""Words that one search may have."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """Jobs of a list: in these ``states``, with all words of ``search``, all ``tags``, if
    ``released`` those whose release holds; how they are sorted, and what the page before ended with."""

    states: Sequence[str] = ()
    search: str = ""
    tags: Sequence[str] = ()
    sort: Sort = "newest"
    cursor: str | None = None
    released: bool = False


def folded(text: str) -> str:
    """A text as it is compared."""
    return unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).casefold())


def described(name: str, title: str, tags: Sequence[str], notes: str) -> dict[str, str]:
    """Columns of a job that is called so."""
    return {
        "title": title,
        "tags": "".join(f"\n{tag}\n" for tag in tags),
        "notes": notes,
        "label": folded(title or name)[:200],
        "sought": folded("\n".join((name, title, notes))) + "".join(map(_framed, tags)),
    }


def is_tagged(tags: Sequence[str], tag: str) -> bool:
    """Whether a list of jobs with that tag has one with these."""
    return folded(tag) in map(folded, tags)


def _framed(tag: str) -> str:
    """A tag among the words that are sought, between marks that no text has."""
    return f"\x1f{folded(tag)}\x1f"


def tags_of(row: Mapping[str, Any] | RowMapping) -> list[str]:
    """The tags of a job as the store has it."""
    return [tag for tag in row["tags"].split("\n") if tag]


def chosen(query: Select[Any], wanted: Wanted) -> Select[Any]:
    """Those of the jobs that are wanted, sorted, from the cursor on; ``query`` has their last releases too.
    Raises :class:`RefusedError`, 422."""
    if wanted.states:
        query = query.where(JOBS.c.state.in_(wanted.states))
    for word in folded(wanted.search).split()[:WORDS]:
        query = query.where(JOBS.c.sought.contains(word, autoescape=True))
    for tag in wanted.tags:
        query = query.where(JOBS.c.sought.contains(_framed(tag), autoescape=True))
    if wanted.released:
        query = query.where(RELEASES.c.who.is_not(None), RELEASES.c.withdrawn.is_(None))
    if wanted.cursor is not None:  # jobs may have been deleted since, that one too
        query = query.where(_behind(wanted.sort, wanted.cursor))
    if wanted.sort == "title":
        return query.order_by(JOBS.c.label, JOBS.c.id)
    if wanted.sort == "oldest":
        return query.order_by(JOBS.c.created, JOBS.c.id)
    if wanted.sort == "turn":
        return query.order_by(JOBS.c.turn, JOBS.c.id)
    return query.order_by(JOBS.c.created.desc(), JOBS.c.id.desc())


def cursor(sort: Sort, row: RowMapping) -> str:
    """What the page ends with whose last job is ``row``."""
    if sort == "title":
        return f"{base64.urlsafe_b64encode(row['label'].encode()).decode().rstrip('=')}~{row['id']}"
    return mark(row["turn" if sort == "turn" else "created"], row["id"])


def _behind(sort: Sort, cursor: str) -> ColumnElement[bool]:
    if ("~" in cursor) != (sort == "title"):
        what = "cursor: is that of a list that was sorted otherwise; begin it anew"
        raise RefusedError(422, Issue("service.request", what, field="cursor"))
    if sort == "title":
        text, job = cursor.split("~")
        try:
            label = base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)).decode()
        except ValueError as error:
            what = "cursor: is none that this service made; begin the list anew"
            raise RefusedError(422, Issue("service.request", what, field="cursor")) from error
        if "\0" in label:
            label = label.replace("\0", "")
        return or_(JOBS.c.label > label, and_(JOBS.c.label == label, JOBS.c.id > job))
    if sort == "newest":
        return older(JOBS.c.created, JOBS.c.id, cursor)
    made, job = _parts(cursor)
    if sort == "turn":
        return or_(JOBS.c.turn > made, and_(JOBS.c.turn == made, JOBS.c.id > job))
    return or_(JOBS.c.created > made, and_(JOBS.c.created == made, JOBS.c.id > job))


def older(at: ColumnElement[float], own: ColumnElement[str], cursor: str) -> ColumnElement[bool]:
    """Rows of any table behind a :func:`mark`, the newest first; the row that it names may be gone."""
    moment, last = _parts(cursor)
    return or_(at < moment, and_(at == moment, own < last))


def mark(at: float, own: str) -> str:
    """What a page ends with that is sorted by a moment [s], or by a turn."""
    return f"{at!r}-{own}"


def _parts(cursor: str) -> tuple[float, str]:
    at, _, own = cursor.partition("-")
    return float(at), own
