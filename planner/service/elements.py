"""Building elements of the service: division, planning of panels and raw-block jobs, marks, reports.

An element is the job that divides it. Its files are those that ``tandem element`` writes, and
``progress.csv`` if panels are marked. The database records which jobs belong to its panels.
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

from planner.batch.job import ELEMENT_FILE, PLANNED_FILE, PROBLEM_FILE
from planner.batch.reference_neighbours import reference_panels
from planner.element import progress
from planner.element.nested_output import PROBLEMS
from planner.issues import Issue, TandemError
from planner.service import audit, element_problems, idempotency
from planner.service.element_problems import PlannedProblem
from planner.service.idempotency import IdempotencyKey
from planner.service.job_search import JobFilter
from planner.service.jobs import (
    SERVICE_LIMITS_ONLY,
    ElementRole,
    Jobs,
    NewJob,
    PlanningLimits,
    delete_job,
    job_files,
    job_out,
    job_row,
    put_files,
)
from planner.service.models import (
    CANCELLED,
    ELEMENT_JOBS,
    JOBS,
    MARKS_FILE,
    OPEN_STATES,
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
from planner.service.reading_parts import Pieces
from planner.service.reading_result import ReadingResult
from planner.service.releases import Releases
from planner.service.security import Principal, RefusedError
from planner.service.storage import Blob, ContentStore, ProblemUpload, StorageQuota
from planner.service.upload_processes import UploadReading

DIVISION_DATA: Final = "element.json"
"""Result file of a division that contains everything as data."""
PLAN_FILES: Final = ("plan.json", "plan.npz", "simulated_part.obj")
"""Files of a panel's result that a report reads."""
REPLANNED_STATES: Final = ("cancelled", "crashed")
"""States of jobs whose panels are planned again together with unplanned ones."""
_PROBLEM_PREFIXES: Final = tuple(f"{folder}/" for folder in ("problem", *PROBLEMS))
"""Prefixes of the files of a division that problems are read from."""
CACHED_ELEMENTS: Final = 8
"""Number of elements whose data are cached."""


_HEAD_FIELDS: Final = set(ElementOut.model_fields)
"""Fields of an element that are sent without its panels."""


class ElementService(Protocol):
    """The parts of :class:`planner.service.service.Service` that :class:`ElementStore` uses."""

    database: Database
    jobs: Jobs
    files: ContentStore
    storage: StorageQuota
    releases: Releases
    scratch: Path

    def examine_element(
        self, sha: str, uploads: Mapping[str, Blob], fields: Mapping[str, Any], reading: UploadReading
    ) -> ReadingResult:
        """Read an uploaded element."""
        ...

    def examine_panels(
        self, files: Mapping[str, Blob], panels: Sequence[str], reading: UploadReading
    ) -> Pieces[dict[str, ReadingResult]]:
        """Read panels of a divided element, by their ids."""
        ...

    def store_job_files(
        self,
        owner: str,
        results: Mapping[str, ReadingResult],
        uploads: Mapping[str, Blob],
        document: str | None = None,
    ) -> dict[str, dict[str, Blob]]:
        """Store the files of the jobs that results of reading describe, by the names of the results."""
        ...

    def new_job(
        self,
        owner: str,
        name: str,
        result: ReadingResult,
        files: Mapping[str, Blob],
        limits: PlanningLimits = SERVICE_LIMITS_ONLY,
        of: ElementRole | None = None,
    ) -> NewJob:
        """Describe the job for a result of reading."""
        ...


@dataclasses.dataclass(frozen=True)
class _PresentElement:
    """An element that is divided again. The new one takes over its marks, title, tags and notes.

    Attributes:
        job: Job that divided it.
        marks: File of its marks by name; empty if no panel is marked.
    """

    job: JobOut
    marks: Mapping[str, Blob]


class ElementStore:
    """The elements of a service."""

    def __init__(self, service: ElementService) -> None:
        self._service, self._database = service, service.database
        self._jobs, self._files = service.jobs, service.files
        self._data = functools.lru_cache(CACHED_ELEMENTS)(self._read_data)

    def created_before(self, idempotency_key: IdempotencyKey | None) -> ElementOut | None:
        """Return the element that an earlier request with the same idempotency key created.

        Args:
            idempotency_key: Idempotency key, or None.

        Returns:
            The element, or None if there is none yet.

        Raises:
            RefusedError: 422, the key was sent with another request.
        """
        earlier_jobs = self._jobs.created_before(idempotency_key)
        return (
            ElementOut(**self.get(earlier_jobs[0].id).model_dump(include=_HEAD_FIELDS))
            if earlier_jobs
            else None
        )

    def create(
        self,
        owner: str,
        upload: ProblemUpload,
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None = None,
    ) -> ElementOut:
        """Divide an uploaded element.

        Args:
            owner: Token.
            upload: Element file and its files.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: 413, 422, 429, 499 or 507.
        """
        return self._divide(owner, upload, {}, None, reading, idempotency_key)

    def divide_again(
        self,
        owner: str,
        element: str,
        fields: Mapping[str, Any],
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None = None,
    ) -> ElementOut:
        """Divide an element again with changed fields.

        The result is another element with the same marks, title, tags and notes.

        Args:
            owner: Token.
            element: Id of the present element.
            fields: New values by field path.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: 413, 422, 429, 499 or 507.
        """
        files = self._jobs.files(element)
        _, present_job = self._jobs.get(element)  # after its files: refuses an element deleted meanwhile
        prefix = "problem/"
        uploads = {name.removeprefix(prefix): blob for name, blob in files.items() if name.startswith(prefix)}
        document = uploads.pop(ELEMENT_FILE)
        marks = {MARKS_FILE: files[MARKS_FILE]} if MARKS_FILE in files else {}
        present = _PresentElement(present_job, marks)
        return self._divide(
            owner, ProblemUpload(document, uploads), fields, present, reading, idempotency_key
        )

    def _divide(
        self,
        owner: str,
        upload: ProblemUpload,
        fields: Mapping[str, Any],
        present: _PresentElement | None,
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None,
    ) -> ElementOut:
        """Create the job that divides an element, with new values by field path.

        The job takes over marks, title, tags and notes of ``present``, if that element is divided again.
        """
        reading_result = self._service.examine_element(upload.problem.sha, upload.files, fields, reading)
        role = ElementRole("division", about=reading_result.summary)
        files = {
            **self._service.store_job_files(owner, {ELEMENT_FILE: reading_result}, upload.files)[
                ELEMENT_FILE
            ],
            **({} if present is None else present.marks),
        }
        new_job = self._service.new_job(owner, reading_result.name, reading_result, files, of=role)
        if present is not None:
            title, tags, notes = present.job.title, tuple(present.job.tags), present.job.notes
            new_job = dataclasses.replace(new_job, title=title, tags=tags, notes=notes)
        job = self._jobs.create(new_job, idempotency_key)
        return self._head(job, json.dumps(reading_result.summary), 0)

    def page(
        self, owners: Sequence[str], job_filter: JobFilter, count: int
    ) -> tuple[list[ElementOut], str | None]:
        """Return a page of elements, as :meth:`planner.service.jobs.Jobs.page` does for jobs.

        Args:
            owners: Tokens whose elements are listed.
            job_filter: Filter, order and cursor.
            count: Maximum number of elements.
        """
        jobs, next_cursor = self._jobs.page(owners, job_filter, count, "division")
        job_ids = [job.id for job in jobs]
        details_query = select(ELEMENT_JOBS.c.job, ELEMENT_JOBS.c.about).where(
            ELEMENT_JOBS.c.job.in_(job_ids)
        )
        counts_query = (
            select(ELEMENT_JOBS.c.element, func.count(ELEMENT_JOBS.c.panel.distinct()))
            .where(ELEMENT_JOBS.c.element.in_(job_ids), ELEMENT_JOBS.c.role == "panel")
            .group_by(ELEMENT_JOBS.c.element)
        )
        with self._database.read() as db:
            details = dict(row.tuple() for row in db.execute(details_query))
            counts: dict[str, int] = dict(row.tuple() for row in db.execute(counts_query))
        return [
            self._head(job, details.get(job.id, "{}"), counts.get(job.id, 0)) for job in jobs
        ], next_cursor

    def owner(self, element: str) -> str | None:
        """Return the token that owns an element, or None if it does not exist or is being deleted."""
        query = (
            select(JOBS.c.owner)
            .join_from(JOBS, ELEMENT_JOBS, JOBS.c.id == ELEMENT_JOBS.c.job)
            .where(JOBS.c.id == element, ELEMENT_JOBS.c.role == "division", JOBS.c.cancel <= CANCELLED)
        )
        with self._database.read() as db:
            owner: str | None = db.execute(query).scalar()
        return owner

    def get(self, element: str) -> ElementPanels:
        """Return an element with its panels.

        Raises:
            RefusedError: 404.
        """
        with self._database.read() as db:
            query = select(ELEMENT_JOBS.c.about).where(ELEMENT_JOBS.c.job == element)
            about = str(db.execute(query).scalar())
            planned = element_problems.last_jobs(db, element)
            report = element_problems.last_report(db, element)
            files = job_files(db, element)
        _, job = self._jobs.get(element)  # last: refuses an element deleted meanwhile
        head = self._head(job, about, len(planned)).model_dump()
        if DIVISION_DATA not in files:
            return ElementPanels(**head)
        marks, next_steps = self._progress(files)
        block_jobs = [
            element_problems.block_job_model(job, planned, marks)
            for job in progress.block_jobs(marks.data).values()
        ]
        panels = [element_problems.panel_model(row, planned, marks) for row in marks.data["panels"]]
        blocks = {
            item["id"]: block["id"]
            for block in (marks.data.get("blocks") or {}).get("blocks", ())
            for item in block["panels"]
        }
        panels = [item.model_copy(update={"block": blocks.get(item.id, "")}) for item in panels]
        minutes: Counter[str] = Counter()
        for item in (*panels, *block_jobs):
            minutes.update(item.cut_min)
        return ElementPanels(
            **head,
            panels=panels,
            block_jobs=block_jobs,
            counts=dict(
                Counter([*(item.state for item in panels), *(item.mark for item in panels if item.mark)])
            ),
            cut_h={arm: round(total / 60.0, 3) for arm, total in minutes.items()},
            told=next_steps,
            report=report,
        )

    def plan(
        self,
        owner: str,
        element: str,
        chosen: Sequence[str] | None,
        reading: UploadReading,
        idempotency_key: IdempotencyKey | None = None,
    ) -> Pieces[list[JobOut]]:
        """Plan panels and raw-block jobs: create a job for each, all or none.

        The plan of an adjacent panel becomes the reference plan of a panel, if that panel has one or gets a
        job now. The result is empty if there is nothing to plan.

        Args:
            owner: Token.
            element: Id of the element.
            chosen: Ids of panels and raw-block jobs, or None for all that are not planned yet.
            reading: Reading, which another thread can cancel.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: 404, 413, 422, 429, 499 or 507.
        """
        yield  # wait for a turn before the first part of the reading
        name, files = self._divided_files(element)
        data = self._data(files[DIVISION_DATA].sha)
        with self._database.read() as db:
            last_jobs = element_problems.last_jobs(db, element)
        panels = [str(row["id"]) for row in data["panels"]]
        # a row with "cut_in" is a panel that is cut in the job of a raw block, together with others
        has_own_job = {str(row["id"]): "cut_in" not in row for row in data["panels"]}
        has_own_job |= dict.fromkeys(progress.block_jobs(data), True)
        panel_ids = _selected_ids(has_own_job, last_jobs, chosen)
        if not panel_ids:
            return []
        problem_files = {path: blob for path, blob in files.items() if path.startswith(_PROBLEM_PREFIXES)}
        results = yield from self._service.examine_panels(problem_files, panel_ids, reading)
        with self._database.read() as db:  # jobs may have changed while the panels were read
            last_jobs = element_problems.last_jobs(db, element)
        panel_ids = [
            panel_id for panel_id in _selected_ids(has_own_job, last_jobs, chosen) if panel_id in results
        ]
        results = {panel_id: results[panel_id] for panel_id in panel_ids}
        stored = self._service.store_job_files(owner, results, problem_files, PROBLEM_FILE)
        planned_panels = set(panels) & last_jobs.keys() - results.keys()
        references = reference_panels(
            data,
            [panel_id for panel_id in panels if panel_id in planned_panels or panel_id in results],
            planned_panels,
        )
        new_jobs: dict[str, NewJob] = {}
        last_keys = {panel_id: panel.row["key"] for panel_id, panel in last_jobs.items()}
        for panel_id in _in_reference_order(panel_ids, references):
            reference = references.get(panel_id)
            reference_job: str | None = None
            reference_key = ""
            if reference is not None and reference in new_jobs:
                reference_job, reference_key = new_jobs[reference].id, new_jobs[reference].key
            elif reference is not None:
                reference_job, reference_key = last_jobs[reference].job, last_keys[reference]
            role = ElementRole("panel", element, panel_id, reference_job, reference_key=reference_key)
            new_jobs[panel_id] = self._service.new_job(
                owner, f"{name}-{panel_id}", results[panel_id], stored[panel_id], of=role
            )
        return self._jobs.create_all(list(new_jobs.values()), idempotency_key)

    def release(
        self, element: str, shown: Mapping[str, Shown], principal: Principal, name: str | None, note: str
    ) -> ElementReleases:
        """Release the programs of panels and of raw-block jobs in one act.

        A job is released if it is proven, not released yet, and still as it was shown. The others are listed
        as refused.

        Args:
            element: Id of the element.
            shown: Job and digest of each panel as the person saw it.
            principal: Authenticated caller.
            name: Name of the person, if the service requires no tokens.
            note: Note for the audit log.

        Raises:
            RefusedError: 404, 409 if none can be released, 422 if an id has no own job, because it is unknown
                or its panel is cut in another job.
        """
        _, files = self._divided_files(element)
        with self._database.read() as db:
            unknown_ids = sorted(shown.keys() - element_problems.last_jobs(db, element).keys())
        if unknown_ids:
            message = f"panels: no own job for {_quoted_names(unknown_ids)}. See the panels of the element."
            cut_in_by_panel = {
                str(row["id"]): row.get("cut_in") for row in self._data(files[DIVISION_DATA].sha)["panels"]
            }
            common_jobs = [
                f"{panel_id} in {cut_in['job']}"
                for panel_id in unknown_ids
                if (cut_in := cut_in_by_panel.get(panel_id)) is not None
            ]
            hint = (
                f"cut together with others: {', '.join(common_jobs[:5])}. Release that job."
                if common_jobs
                else None
            )
            raise RefusedError(422, Issue("service.request", message, field="panels", hint=hint))

        def last_job_ids(db: Connection) -> dict[str, str]:
            return {panel: planned.job for panel, planned in element_problems.last_jobs(db, element).items()}

        releases, refused = self._service.releases.release_panels(
            element, shown, last_job_ids, principal, name, note
        )
        if not releases:
            issues = [
                dataclasses.replace(issue, message=f"{panel_id}: {issue.message}")
                for panel_id in sorted(refused)
                for issue in refused[panel_id].issues
            ]
            raise RefusedError(409, issues)
        return ElementReleases(
            releases=[
                PanelRelease(panel=panel_id, **releases[panel_id].model_dump())
                for panel_id in shown
                if panel_id in releases
            ],
            refused=[
                PanelRefused(panel=panel_id, issues=list(refused[panel_id].issues))
                for panel_id in shown
                if panel_id in refused
            ],
        )

    def cancel(self, element: str, token_id: str) -> None:
        """Cancel the queued and running jobs of an element: division, panels and report.

        Args:
            element: Id of the element.
            token_id: Token that cancels.
        """
        element_jobs = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.element == element)
        query = select(JOBS.c.id).where(JOBS.c.id.in_(element_jobs), JOBS.c.state.in_(OPEN_STATES))
        with self._database.read() as db:
            open_jobs = list(db.execute(query.order_by(JOBS.c.created.desc())).scalars())
        for job in open_jobs:
            self._jobs.cancel(job, token_id)

    def delete(self, element: str, token_id: str) -> None:
        """Cancel and delete an element. Jobs of its panels remain.

        Args:
            element: Id of the element.
            token_id: Token that deletes.
        """
        self.cancel(element, token_id)
        self._jobs.cancel(element, token_id, also_delete=True)

    def delete_unused(self, element: str, token_id: str) -> None:
        """Delete an element if no panel was planned or marked.

        An element that is already deleted is ignored.

        Args:
            element: Id of the element.
            token_id: Token that deletes.
        """
        with self._database.read() as db:
            used = element_problems.last_jobs(db, element) or MARKS_FILE in job_files(db, element)
        if used:
            return
        try:
            self.delete(element, token_id)
        except RefusedError as error:
            if error.status != 404:
                raise

    def mark(self, owner: str, element: str, panel: str, state: Mark | Literal["open"]) -> None:
        """Mark a panel, as ``tandem element mark`` does.

        Args:
            owner: Token.
            element: Id of the element.
            panel: Id of a panel or raw-block job.
            state: Mark, or open to remove it.

        Raises:
            RefusedError: 404, 422 or 507.
        """
        self._divided_files(element)
        with self._database.write() as db:
            self._database.lock(db, element)
            files = job_files(db, element)
            try:
                progress_after = progress.mark(self._progress(files)[0], panel, state)
            except TandemError as error:
                raise RefusedError(422, error.issues) from error
            progress_file = io.BytesIO(progress.progress_csv(progress_after).encode())
            put_files(db, element, {MARKS_FILE: self._service.storage.put(owner, [progress_file])[0]})

    def report(self, owner: str, element: str, idempotency_key: IdempotencyKey | None = None) -> JobOut:
        """Create the job that reports on all planned panels of an element whose jobs have ended.

        The previous report is deleted if it has ended.

        Args:
            owner: Token.
            element: Id of the element.
            idempotency_key: Idempotency key, or None.

        Raises:
            RefusedError: 404 if there is no such panel, 422, 429 or 507.
        """
        name, files = self._divided_files(element)
        with self._database.write() as db:
            earlier_jobs = [] if idempotency_key is None else idempotency.earlier_jobs(db, idempotency_key)
            if earlier_jobs:
                return job_out(job_row(db, earlier_jobs[0]))
            panels = element_problems.last_jobs(db, element)
            ended_panels = {
                panel_id: panel for panel_id, panel in panels.items() if panel.row["state"] not in OPEN_STATES
            }
            if not ended_panels:
                message = f"element {name}: no planned panel. Plan panels first."
                raise RefusedError(404, Issue("service.unknown_file", message))
            report_files = {
                f"problem/element/{f}": b for f, b in files.items() if not f.startswith("problem/")
            }
            for panel_id, panel in ended_panels.items():
                panel_files = job_files(db, panel.job)
                report_files |= {
                    f"problem/run/{panel_id}/{f}": panel_files[f] for f in PLAN_FILES if f in panel_files
                }
            previous_report = element_problems.last_report(db, element)
            if previous_report is not None and previous_report.state not in OPEN_STATES:
                for deleted_job in delete_job(db, previous_report.id):
                    event = audit.AuditEvent("deleted", deleted_job.id, {"name": deleted_job.name})
                    audit.record_act(self._database, db, owner, event)
        text = json.dumps(
            [
                element_problems.finished_job(panel_id, panel.row).to_dict()
                for panel_id, panel in ended_panels.items()
            ]
        ).encode()
        (panel_list,) = self._service.storage.put(owner, [io.BytesIO(text)])
        report_files[f"problem/{PLANNED_FILE}"] = panel_list
        file_hashes = json.dumps(sorted((file, blob.sha) for file, blob in report_files.items()))
        digest = hashlib.sha256(file_hashes.encode()).hexdigest()
        role = ElementRole("report", element)
        new_job = self._service.new_job(owner, name, ReadingResult((), name, digest), report_files, of=role)
        return self._jobs.create(new_job, idempotency_key)

    def _divided_files(self, element: str) -> tuple[str, dict[str, Blob]]:
        """Return name and files of an element that is divided.

        Raises:
            RefusedError: 404.
        """
        _, job = self._jobs.get(element)
        files = self._jobs.files(element)
        if DIVISION_DATA not in files:
            message = f"element {job.name}: is not divided (state {job.state}). "
            message += (
                "Try again when it is." if job.state in OPEN_STATES else "See its issues and change it."
            )
            raise RefusedError(404, Issue("service.unknown_file", message))
        return job.name, files

    def _read_data(self, sha: str) -> Mapping[str, Any]:
        data: dict[str, Any] = json.loads(self._files.read(sha))
        return data

    def _progress(self, files: Mapping[str, Blob]) -> tuple[progress.ElementProgress, list[str]]:
        """Return the progress of an element, as data and as lines of text with the next steps.

        Args:
            files: Files of the element's job, by name.
        """
        with tempfile.TemporaryDirectory(dir=self._service.scratch, prefix="element-") as folder:
            out = Path(folder)
            for name in (DIVISION_DATA, MARKS_FILE, "stock.csv"):
                if name in files:
                    (out / name).symlink_to(self._files.path(files[name].sha).resolve())
            marks = progress.read_progress(out)
            lines = [
                *progress.progress_lines(marks, out),
                *(issue.message for issue in progress.progress_issues(marks)),
            ]
        return marks, lines

    @staticmethod
    def _head(job: JobOut, about: str, planned: int) -> ElementOut:
        """Return an element without its panels, from its job and the column ``about`` of its division."""
        division = json.loads(about)
        return ElementOut(
            **job.model_dump(), kind=division["kind"], fields=division["fields"], planned=planned
        )


def _quoted_names(names: Sequence[str]) -> str:
    """List the first five of some user-supplied names.

    Characters that hide or reorder text are escaped.
    """
    return ", ".join(repr(name[:32]) for name in names[:5])


def _selected_ids(
    has_own_job: Mapping[str, bool], last_jobs: Mapping[str, PlannedProblem], chosen: Sequence[str] | None
) -> list[str]:
    """Select panels and raw-block jobs to plan, in the order of ``has_own_job``.

    If ``chosen`` is None, these are all that were not planned yet or whose job was cancelled or crashed,
    without panels that another job cuts. Panels with a queued or running job are never planned twice.

    Raises:
        RefusedError: 422, the element does not have a chosen id.
    """
    if chosen is None:
        return [
            panel_id
            for panel_id, plannable in has_own_job.items()
            if plannable
            and (panel_id not in last_jobs or last_jobs[panel_id].row["state"] in REPLANNED_STATES)
        ]
    unknown_ids = sorted(set(chosen) - has_own_job.keys())
    if unknown_ids:
        names = list(has_own_job)
        message = (
            f"panels: unknown (got {_quoted_names(unknown_ids)}, allowed {len(names)} panels and raw-block "
            "jobs "
        )
        message += f"from {names[0]} to {names[-1]}). See the panels of the element."
        raise RefusedError(422, Issue("service.request", message, field="panels"))
    open_ids = {panel_id for panel_id, panel in last_jobs.items() if panel.row["state"] in OPEN_STATES}
    return [panel_id for panel_id in has_own_job if panel_id in set(chosen) - open_ids]


def _in_reference_order(panel_ids: Sequence[str], references: Mapping[str, str]) -> list[str]:
    """Order panels so that each follows the panel whose plan is its reference plan."""
    todo = set(panel_ids)
    out: dict[str, None] = {}

    def add_with_references(panel_id: str) -> None:
        chain = [panel_id]
        while (
            (reference_id := references.get(chain[-1])) is not None
            and reference_id in todo
            and reference_id not in out
        ):
            chain.append(reference_id)
        out.update(dict.fromkeys(reversed(chain)))

    for panel_id in panel_ids:
        add_with_references(panel_id)
    return list(out)
