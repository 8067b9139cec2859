"""Building elements of the service: uploaded, divided by the queue's workers, their panels and the jobs of
their raw blocks planned as jobs like any others, and what became of them.

An element is the job that divides it; its files are what ``tandem element`` writes, and ``progress.csv``
where panels are marked. The store has which jobs are those of its panels.
"""

import dataclasses
import functools
import hashlib
import io
import json
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from sqlalchemy import Connection, func, select

from planner.batch.job import ELEMENT, PLANNED, PROBLEM
from planner.batch.neighbours import like_within
from planner.element import progress
from planner.element.nested_output import PROBLEMS
from planner.issues import Issue, TandemError
from planner.service import audit, element_problems, idempotency
from planner.service.element_problems import Problem
from planner.service.examined import Examined
from planner.service.finding import Wanted
from planner.service.idempotency import Once
from planner.service.jobs import Jobs, NewJob, OfElement, job_files, job_out, job_row, put_files, remove
from planner.service.models import (
    CANCELLED,
    ELEMENT_JOBS,
    JOBS,
    MARKS,
    OPEN,
    Database,
    ElementOut,
    ElementPanels,
    ElementReleases,
    JobOut,
    Mark,
    PanelRefused,
    PanelRelease,
    Shown,
)
from planner.service.pieces import Pieces
from planner.service.releases import Releases
from planner.service.security import RefusedError, Who
from planner.service.storage import Blob, Files, Storage, Upload
from planner.service.upload_processes import Reading

DATA: Final = "element.json"
"""The result of a division that has all of it as data."""
OF_PLANS: Final = ("plan.json", "plan.npz", "simulated_part.obj")
"""What a report reads of a panel's result."""
AGAIN: Final = ("cancelled", "crashed")
"""Panels whose jobs ended so are planned with those that were not planned yet."""
_PARTS: Final = tuple(f"{folder}/" for folder in ("problem", *PROBLEMS))
"""Files of a division that problems are read from."""
KEPT: Final = 8
"""So many elements' data are remembered."""


_OUT: Final = set(ElementOut.model_fields)
"""What is told of an element without its panels."""


class ElementService(Protocol):
    """The parts of :class:`planner.service.service.Service` that :class:`Elements` uses."""

    database: Database
    jobs: Jobs
    files: Files
    storage: Storage
    releases: Releases
    scratch: Path

    def examine_element(
        self, sha: str, uploads: Mapping[str, Blob], fields: Mapping[str, Any], reading: Reading
    ) -> Examined:
        """Read an uploaded element."""
        ...

    def examine_panels(
        self, files: Mapping[str, Blob], panels: Sequence[str], reading: Reading
    ) -> Pieces[dict[str, Examined]]:
        """Read panels of a divided element, by their ids."""
        ...

    def stored(
        self,
        owner: str,
        read: Mapping[str, Examined],
        uploads: Mapping[str, Blob],
        document: str | None = None,
    ) -> dict[str, dict[str, Blob]]:
        """Store the files of the jobs for what was read."""
        ...

    def new_job(
        self,
        owner: str,
        name: str,
        read: Examined,
        files: Mapping[str, Blob],
        timeout_s: float | None = None,
        memory_mb: float | None = None,
        of: OfElement | None = None,
        after: str = "",
    ) -> NewJob:
        """Describe the job for what was read."""
        ...


class Elements:
    """The elements of a service."""

    def __init__(self, service: ElementService) -> None:
        self._service, self._database = service, service.database
        self._jobs, self._files = service.jobs, service.files
        self._data = functools.lru_cache(KEPT)(self._read_data)

    def made(self, once: Once | None) -> ElementOut | None:
        """The element that a request made which is to be done ``once``, as it is now; None where it made none
        yet. Raises :class:`RefusedError`, 422."""
        known = self._jobs.made(once)
        return ElementOut(**self.get(known[0].id).model_dump(include=_OUT)) if known else None

    def create(self, owner: str, upload: Upload, reading: Reading, once: Once | None = None) -> ElementOut:
        """Divide an uploaded element; raises :class:`RefusedError`, 413, 422, 429, 499 or 507."""
        return self._divide(owner, upload.problem.sha, upload.files, {}, {}, None, reading, once)

    def change(
        self, owner: str, element: str, fields: Mapping[str, Any], reading: Reading, once: Once | None = None
    ) -> ElementOut:
        """Divide an element anew with fields replaced, as another one with the marks of this one, and called
        as it; raises as :meth:`create`."""
        files = self._jobs.files(element)
        _, before = self._jobs.get(element)  # behind its files: they are none of one that is gone by now
        prefix = "problem/"
        given = {name.removeprefix(prefix): blob for name, blob in files.items() if name.startswith(prefix)}
        document = given.pop(ELEMENT)
        marks = {MARKS: files[MARKS]} if MARKS in files else {}
        return self._divide(owner, document.sha, given, fields, marks, before, reading, once)

    def _divide(
        self,
        owner: str,
        sha: str,
        uploads: Mapping[str, Blob],
        fields: Mapping[str, Any],
        more: Mapping[str, Blob],
        before: JobOut | None,
        reading: Reading,
        once: Once | None,
    ) -> ElementOut:
        read = self._service.examine_element(sha, uploads, fields, reading)
        of = OfElement("division", about=read.summary)
        files = {**self._service.stored(owner, {ELEMENT: read}, uploads)[ELEMENT], **more}
        new = self._service.new_job(owner, read.name, read, files, of=of)
        if before is not None:
            tags = tuple(before.tags)
            new = dataclasses.replace(new, title=before.title, tags=tags, notes=before.notes)
        made = self._jobs.create(new, once)
        return self._head(made, json.dumps(read.summary), 0)

    def page(self, owners: Sequence[str], wanted: Wanted, count: int) -> tuple[list[ElementOut], str | None]:
        """Elements of the owners as :meth:`planner.service.jobs.Jobs.page` gives jobs."""
        found, following = self._jobs.page(owners, wanted, count, "division")
        own = [one.id for one in found]
        about = select(ELEMENT_JOBS.c.job, ELEMENT_JOBS.c.about).where(ELEMENT_JOBS.c.job.in_(own))
        planned = (
            select(ELEMENT_JOBS.c.element, func.count(ELEMENT_JOBS.c.panel.distinct()))
            .where(ELEMENT_JOBS.c.element.in_(own), ELEMENT_JOBS.c.role == "panel")
            .group_by(ELEMENT_JOBS.c.element)
        )
        with self._database.read() as db:
            texts = dict(row.tuple() for row in db.execute(about))
            counts: dict[str, int] = dict(row.tuple() for row in db.execute(planned))
        return [self._head(one, texts.get(one.id, "{}"), counts.get(one.id, 0)) for one in found], following

    def owner(self, element: str) -> str | None:
        """Whose element it is; None where there is none of that id, or it is being deleted."""
        asked = (
            select(JOBS.c.owner)
            .join_from(JOBS, ELEMENT_JOBS, JOBS.c.id == ELEMENT_JOBS.c.job)
            .where(JOBS.c.id == element, ELEMENT_JOBS.c.role == "division", JOBS.c.cancel <= CANCELLED)
        )
        with self._database.read() as db:
            found: str | None = db.execute(asked).scalar()
        return found

    def get(self, element: str) -> ElementPanels:
        """An element with its panels; raises :class:`RefusedError`, 404."""
        with self._database.read() as db:
            asked = select(ELEMENT_JOBS.c.about).where(ELEMENT_JOBS.c.job == element)
            about = str(db.execute(asked).scalar())
            planned = element_problems.problems(db, element)
            report = element_problems.report(db, element)
            files = job_files(db, element)
        _, job = self._jobs.get(element)  # behind the rest, which is none of one that is gone by now
        head = self._head(job, about, len(planned)).model_dump()
        if DATA not in files:
            return ElementPanels(**head)
        found, told = self._progress(files)
        jobs = [
            element_problems.block_job(job, planned, found)
            for job in progress.block_jobs(found.data).values()
        ]
        panels = [element_problems.panel(row, planned, found) for row in found.data["panels"]]
        blocks = {
            one["id"]: block["id"]
            for block in (found.data.get("blocks") or {}).get("blocks", ())
            for one in block["panels"]
        }
        panels = [one.model_copy(update={"block": blocks.get(one.id, "")}) for one in panels]
        minutes: Counter[str] = Counter()
        for one in (*panels, *jobs):
            minutes.update(one.cut_min)
        return ElementPanels(
            **head,
            panels=panels,
            block_jobs=jobs,
            counts=dict(Counter([*(one.state for one in panels), *(one.mark for one in panels if one.mark)])),
            cut_h={arm: round(total / 60.0, 3) for arm, total in minutes.items()},
            told=told,
            report=report,
        )

    def plan(
        self,
        owner: str,
        element: str,
        chosen: Sequence[str] | None,
        reading: Reading,
        once: Once | None = None,
    ) -> Pieces[list[JobOut]]:
        """Plan panels and jobs of raw blocks, those that are chosen or all that are not planned yet, each
        panel like one beside it; raises :class:`RefusedError`, 404, 413, 422, 429, 499 or 507."""
        yield
        name, files = self._divided(element)
        data = self._data(files[DATA].sha)
        with self._database.read() as db:
            before = element_problems.problems(db, element)
        panels = [str(row["id"]) for row in data["panels"]]
        known = {str(row["id"]): "cut_in" not in row for row in data["panels"]}
        known |= dict.fromkeys(progress.block_jobs(data), True)
        wanted = _wanted(known, before, chosen)
        if not wanted:
            return []
        parts = {f: b for f, b in files.items() if f.startswith(_PARTS)}
        read = yield from self._service.examine_panels(parts, wanted, reading)
        with self._database.read() as db:  # others had their turns meanwhile
            before = element_problems.problems(db, element)
        wanted = [one for one in _wanted(known, before, chosen) if one in read]
        read = {one: read[one] for one in wanted}
        stored = self._service.stored(owner, read, parts, PROBLEM)
        done = set(panels) & before.keys() - read.keys()
        after = like_within(data, [one for one in panels if one in done or one in read], done)
        made: dict[str, NewJob] = {}
        keys = {one: panel.row["key"] for one, panel in before.items()}
        for one in _in_turn(wanted, after):
            like = after.get(one)
            like_job = None if like is None else made[like].id if like in made else before[like].job
            of = OfElement("panel", element, one, like_job)
            key = "" if like is None else made[like].key if like in made else keys[like]
            made[one] = self._service.new_job(
                owner, f"{name}-{one}", read[one], stored[one], of=of, after=key
            )
        return self._jobs.create_all(list(made.values()), once)

    def release(
        self, element: str, shown: Mapping[str, Shown], who: Who, name: str | None, note: str
    ) -> ElementReleases:
        """Release the programs of panels and of jobs of raw blocks by one act, each as it was ``shown``:
        those that are proven, not released, and still what was shown; the others are refused by name. Raises
        :class:`RefusedError`: 404, 409 where none can be released, 422."""
        _, files = self._divided(element)
        with self._database.read() as db:
            strange = sorted(shown.keys() - element_problems.problems(db, element).keys())
        if strange:
            what = f"panels: got {_some(strange)}, of which none has a job of its own here; see its list"
            rows = {str(one["id"]): one.get("cut_in") for one in self._data(files[DATA].sha)["panels"]}
            own = [f"{one} in {row['job']}" for one in strange if (row := rows.get(one)) is not None]
            hint = f"cut together with others: {', '.join(own[:5])}; release that" if own else None
            raise RefusedError(422, Issue("service.request", what, field="panels", hint=hint))

        def last(db: Connection) -> dict[str, str]:
            return {panel: one.job for panel, one in element_problems.problems(db, element).items()}

        made, refused = self._service.releases.release_panels(element, shown, last, who, name, note)
        if not made:
            told = [
                dataclasses.replace(one, message=f"{panel}: {one.message}")
                for panel in sorted(refused)
                for one in refused[panel].issues
            ]
            raise RefusedError(409, told)
        return ElementReleases(
            releases=[PanelRelease(panel=one, **made[one].model_dump()) for one in shown if one in made],
            refused=[
                PanelRefused(panel=one, issues=list(refused[one].issues)) for one in shown if one in refused
            ],
        )

    def cancel(self, element: str, by: str) -> None:
        """Cancel what of an element waits or runs, as the token ``by`` asks: its division, panels, and a
        report."""
        own = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.element == element)
        asked = select(JOBS.c.id).where(JOBS.c.id.in_(own), JOBS.c.state.in_(OPEN))
        with self._database.read() as db:
            found = list(db.execute(asked.order_by(JOBS.c.created.desc())).scalars())
        for job in found:
            self._jobs.cancel(job, by)

    def delete(self, element: str, by: str) -> None:
        """Cancel and delete an element; what was planned of it stays."""
        self.cancel(element, by)
        self._jobs.cancel(element, by, also_delete=True)

    def give_up(self, element: str, by: str) -> None:
        """Delete an element of which nothing was made: no panel was planned or marked. One that was deleted
        meanwhile is gone as well."""
        with self._database.read() as db:
            used = element_problems.problems(db, element) or MARKS in job_files(db, element)
        if used:
            return
        try:
            self.delete(element, by)
        except RefusedError as error:
            if error.status != 404:
                raise

    def mark(self, owner: str, element: str, panel: str, state: Mark | Literal["open"]) -> None:
        """Mark a panel as ``tandem element mark`` does; raises :class:`RefusedError`, 404, 422 or 507."""
        self._divided(element)
        with self._database.write() as db:
            self._database.one_at_a_time(db, element)
            files = job_files(db, element)
            try:
                found = progress.marked(self._progress(files)[0], panel, state)
            except TandemError as error:
                raise RefusedError(422, error.issues) from error
            text = io.BytesIO(progress.text(found).encode())
            put_files(db, element, {MARKS: self._service.storage.put(owner, [text])[0]})

    def report(self, owner: str, element: str, once: Once | None = None) -> JobOut:
        """Begin the report on what was planned; raises :class:`RefusedError`, 404, 422, 429 or 507."""
        name, files = self._divided(element)
        with self._database.write() as db:
            known = [] if once is None else idempotency.made(db, once)
            if known:
                return job_out(job_row(db, known[0]))
            panels = element_problems.problems(db, element)
            ended = {one: panel for one, panel in panels.items() if panel.row["state"] not in OPEN}
            if not ended:
                what = f"element {name}: no panel was planned to its end; plan panels, and ask again"
                raise RefusedError(404, Issue("service.unknown_file", what))
            given = {f"problem/element/{f}": b for f, b in files.items() if not f.startswith("problem/")}
            for one, panel in ended.items():
                own = job_files(db, panel.job)
                given |= {f"problem/run/{one}/{f}": own[f] for f in OF_PLANS if f in own}
            old = element_problems.report(db, element)
            if old is not None and old.state not in OPEN:
                for gone in remove(db, old.id):
                    audit.note(self._database, db, owner, "deleted", gone.id, {"name": gone.name})
        text = json.dumps(
            [element_problems.done(one, panel.row).to_dict() for one, panel in ended.items()]
        ).encode()
        (listed,) = self._service.storage.put(owner, [io.BytesIO(text)])
        given[f"problem/{PLANNED}"] = listed
        rows = json.dumps(sorted((file, blob.sha) for file, blob in given.items()))
        digest = hashlib.sha256(rows.encode()).hexdigest()
        of = OfElement("report", element)
        new = self._service.new_job(owner, name, Examined((), name, digest), given, of=of)
        return self._jobs.create(new, once)

    def _divided(self, element: str) -> tuple[str, dict[str, Blob]]:
        """Name and files of an element that is divided; raises :class:`RefusedError`, 404."""
        _, job = self._jobs.get(element)
        files = self._jobs.files(element)
        if DATA not in files:
            what = f"element {job.name} is {job.state}, not divided; "
            what += "ask again when it is" if job.state in OPEN else "see its issues, and change it"
            raise RefusedError(404, Issue("service.unknown_file", what))
        return job.name, files

    def _read_data(self, sha: str) -> Mapping[str, Any]:
        found: dict[str, Any] = json.loads(self._files.read(sha))
        return found

    def _progress(self, files: Mapping[str, Blob]) -> tuple[progress.Progress, list[str]]:
        """How far an element is made, and that in lines."""
        with tempfile.TemporaryDirectory(dir=self._service.scratch, prefix="element-") as folder:
            out = Path(folder)
            for name in (DATA, MARKS, "stock.csv"):
                if name in files:
                    (out / name).symlink_to(self._files.path(files[name].sha).resolve())
            found = progress.read(out)
            said = [*progress.told(found, out), *(issue.message for issue in progress.issues(found))]
        return found, said

    @staticmethod
    def _head(job: JobOut, about: str, planned: int) -> ElementOut:
        known = json.loads(about)
        return ElementOut(**job.model_dump(), kind=known["kind"], fields=known["fields"], planned=planned)


def _some(names: Sequence[str]) -> str:
    """Names that somebody sent, the first few, as they are written where they hide or turn text."""
    return ", ".join(repr(one[:32]) for one in names[:5])


def _wanted(
    known: Mapping[str, bool], before: Mapping[str, Problem], chosen: Sequence[str] | None
) -> list[str]:
    """Panels and jobs of raw blocks to be planned, in the order of those that are ``known``, none twice at
    once; where none is chosen, those that are not cut by another one's job. Raises :class:`RefusedError`,
    422, for ids that the element does not have."""
    if chosen is None:
        return [
            one
            for one, own in known.items()
            if own and (one not in before or before[one].row["state"] in AGAIN)
        ]
    strange = sorted(set(chosen) - known.keys())
    if strange:
        names = list(known)
        what = f"panels: got {_some(strange)}, the element has {len(names)} panels and jobs of raw blocks "
        what += f"from {names[0]} to {names[-1]}; see its list"
        raise RefusedError(422, Issue("service.request", what, field="panels"))
    waiting = {one for one, panel in before.items() if panel.row["state"] in OPEN}
    return [one for one in known if one in set(chosen) - waiting]


def _in_turn(wanted: Sequence[str], after: Mapping[str, str]) -> list[str]:
    """Panels, each after the one that it is planned like."""
    out: dict[str, None] = {}

    def put(one: str) -> None:
        chain = [one]
        while (like := after.get(chain[-1])) is not None and like in todo and like not in out:
            chain.append(like)
        out.update(dict.fromkeys(reversed(chain)))

    todo = set(wanted)
    for one in wanted:
        put(one)
    return list(out)
