"""Response models for the problems of an element: its panels and its raw-block jobs.

A panel may be cut together with others (``cut_in`` in ``element.json``). It then shows the job that plans
all of them, until it has its own job.
"""

import json
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from sqlalchemy import Connection, RowMapping, select

from planner.batch.job import JobResult
from planner.element import progress
from planner.issues import Issue, Severity
from planner.service.jobs import HAS_THUMBNAIL, LAST_RELEASE, job_out, job_row
from planner.service.models import CANCELLED, ELEMENT_JOBS, JOBS, RELEASES, BlockJobOut, JobOut, PanelOut

_FIELDS_OF_OWN_JOB: Final = {"digest", "cycle_s", "thumbnail"}
"""Fields that a panel does not take from a job that cuts it together with others."""


class PlannedProblem(NamedTuple):
    """Last job of a panel, or of a raw-block job.

    Attributes:
        job: Id of the job.
        like: Id of the job whose plan was the reference plan.
        row: Database row of the job.
    """

    job: str
    like: str | None
    row: RowMapping


def last_jobs(db: Connection, element: str) -> dict[str, PlannedProblem]:
    """Read the last job of each planned panel and raw-block job of an element, by its id."""
    query = (
        select(JOBS, HAS_THUMBNAIL, ELEMENT_JOBS.c.panel, ELEMENT_JOBS.c.like)
        .add_columns(RELEASES.c.withdrawn, RELEASES.c.number)
        .join_from(ELEMENT_JOBS, JOBS, ELEMENT_JOBS.c.job == JOBS.c.id)
        .outerjoin(RELEASES, LAST_RELEASE)
        .where(ELEMENT_JOBS.c.element == element, ELEMENT_JOBS.c.role == "panel", JOBS.c.cancel <= CANCELLED)
        .order_by(JOBS.c.created, JOBS.c.id)
    )
    return {row["panel"]: PlannedProblem(row["id"], row["like"], row) for row in db.execute(query).mappings()}


def last_report(db: Connection, element: str) -> JobOut | None:
    """Read the last job that reports on an element, even if it is being deleted, or None."""
    report_jobs = select(ELEMENT_JOBS.c.job).where(
        ELEMENT_JOBS.c.element == element, ELEMENT_JOBS.c.role == "report"
    )
    job_id = db.execute(
        select(JOBS.c.id).where(JOBS.c.id.in_(report_jobs)).order_by(JOBS.c.created.desc())
    ).scalar()
    return None if job_id is None else job_out(job_row(db, job_id, deleted_too=True))


def _job_fields(planned: PlannedProblem | None) -> dict[str, Any]:
    """Return the fields of :class:`planner.service.models.PlannedOut` that come from a job, if any."""
    if planned is None:
        return {}
    job = planned.row
    issues = [Issue.from_dict(issue) for issue in json.loads(job["issues"])]
    error_issues = [issue for issue in issues if issue.severity is Severity.ERROR]
    fields: dict[str, Any] = {"job": planned.job, "state": job["state"], "stage": job["stage"]}
    fields["digest"] = job["digest"]
    if job["state"] == "verified":
        release_state = "released" if job["withdrawn"] is None else "withdrawn"
        fields["release"] = "not-released" if job["number"] is None else release_state
    fields["cycle_s"] = json.loads(job["metrics"]).get("cycle_s")
    fields["thumbnail"] = bool(job["thumbnail"])
    fields["issue"] = error_issues[0] if error_issues and job["state"] != "verified" else None
    return fields


def panel_model(
    row: Mapping[str, Any], planned: Mapping[str, PlannedProblem], marks: progress.ElementProgress
) -> PanelOut:
    """Combine a panel of ``element.json`` with its mark and the last job that cuts it.

    Args:
        row: Panel from ``element.json``.
        planned: Last jobs by panel id.
        marks: Progress of the element.
    """
    name = str(row["id"])
    row_job = str(row["cut_in"]["job"]) if "cut_in" in row and name not in planned else None
    fields = _job_fields(planned.get(row_job or name))
    if row_job is not None:
        fields = {key: value for key, value in fields.items() if key not in _FIELDS_OF_OWN_JOB}
    return PanelOut(
        id=name,
        order=int(row["order"]) if "order" in row else None,
        block_mm=[float(row[f"block_{axis}_mm"]) for axis in "xyz"],
        cut_min=_minutes(row),
        cut_in=row_job,
        mark=marks.state(name),
        **fields,
    )


def block_job_model(
    job: Mapping[str, Any], planned: Mapping[str, PlannedProblem], marks: progress.ElementProgress
) -> BlockJobOut:
    """Combine a raw-block job of ``element.json`` with its last job and its mark.

    Args:
        job: Raw-block job from ``element.json``.
        planned: Last jobs by id.
        marks: Progress of the element.
    """
    return BlockJobOut(
        id=str(job["id"]),
        block=str(job["block"]),
        said=str(job["said"]),
        panels=list(job.get("panels", ())),
        cut_min=_minutes(job),
        mark=marks.job_state(job),
        **_job_fields(planned.get(str(job["id"]))),
    )


def _minutes(row: Mapping[str, Any]) -> dict[str, float]:
    return {str(arm): float(value) for arm, value in row.get("cut_min", {}).items()}


def finished_job(name: str, row: RowMapping) -> JobResult:
    """Convert the row of an ended job to the result that a report on the element reads.

    Args:
        name: Id of the panel or raw-block job.
        row: Database row of the job.
    """
    issues = tuple(Issue.from_dict(issue) for issue in json.loads(row["issues"]))
    return JobResult(name, row["state"], issues, json.loads(row["metrics"]), row["seconds"] or 0.0)
