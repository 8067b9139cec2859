"""What the store has of the problems of an element, its panels and the jobs of its raw blocks, as answers
tell it."""

import json
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from sqlalchemy import Connection, RowMapping, select

from planner.batch.job import Done
from planner.element import progress
from planner.issues import Issue, Severity
from planner.service.jobs import LAST_RELEASE, PICTURED, job_out, job_row
from planner.service.models import CANCELLED, ELEMENT_JOBS, JOBS, RELEASES, BlockJobOut, JobOut, PanelOut

_ALONE: Final = {"digest", "cycle_s", "thumbnail"}
"""What a panel does not have of the job that cuts it together with others."""


class Problem(NamedTuple):
    """The last job of a panel, or of a job of a raw block."""

    job: str
    like: str | None
    row: RowMapping


def problems(db: Connection, element: str) -> dict[str, Problem]:
    """The last job of each panel that was planned, by its id."""
    asked = (
        select(JOBS, PICTURED, ELEMENT_JOBS.c.panel, ELEMENT_JOBS.c.like)
        .add_columns(RELEASES.c.withdrawn, RELEASES.c.number)
        .join_from(ELEMENT_JOBS, JOBS, ELEMENT_JOBS.c.job == JOBS.c.id)
        .outerjoin(RELEASES, LAST_RELEASE)
        .where(ELEMENT_JOBS.c.element == element, ELEMENT_JOBS.c.role == "panel", JOBS.c.cancel <= CANCELLED)
        .order_by(JOBS.c.created, JOBS.c.id)
    )
    return {row["panel"]: Problem(row["id"], row["like"], row) for row in db.execute(asked).mappings()}


def report(db: Connection, element: str) -> JobOut | None:
    """The last report on an element, if there is one."""
    own = select(ELEMENT_JOBS.c.job).where(ELEMENT_JOBS.c.element == element, ELEMENT_JOBS.c.role == "report")
    found = db.execute(select(JOBS.c.id).where(JOBS.c.id.in_(own)).order_by(JOBS.c.created.desc())).scalar()
    return None if found is None else job_out(job_row(db, found, deleted_too=True))


def _planned(planned: Problem | None) -> dict[str, Any]:
    if planned is None:
        return {}
    job = planned.row
    issues = [Issue.from_dict(one) for one in json.loads(job["issues"])]
    wrong = [one for one in issues if one.severity is Severity.ERROR]
    known: dict[str, Any] = {"job": planned.job, "state": job["state"], "stage": job["stage"]}
    known["digest"] = job["digest"]
    if job["state"] == "verified":
        held = "released" if job["withdrawn"] is None else "withdrawn"
        known["release"] = "not-released" if job["number"] is None else held
    known["cycle_s"] = json.loads(job["metrics"]).get("cycle_s")
    known["thumbnail"] = bool(job["thumbnail"])
    known["issue"] = wrong[0] if wrong and job["state"] != "verified" else None
    return known


def panel(row: Mapping[str, Any], planned: Mapping[str, Problem], found: progress.Progress) -> PanelOut:
    """A panel, as ``element.json`` has it, with its last job, or that of its row, and its mark."""
    name = str(row["id"])
    cut_in = str(row["cut_in"]["job"]) if "cut_in" in row and name not in planned else None
    known = _planned(planned.get(cut_in or name))
    if cut_in is not None:
        known = {key: value for key, value in known.items() if key not in _ALONE}
    return PanelOut(
        id=name,
        order=int(row["order"]) if "order" in row else None,
        block_mm=[float(row[f"block_{axis}_mm"]) for axis in "xyz"],
        cut_min=_minutes(row),
        cut_in=cut_in,
        mark=found.state(name),
        **known,
    )


def block_job(
    job: Mapping[str, Any], planned: Mapping[str, Problem], found: progress.Progress
) -> BlockJobOut:
    """A job of a raw block, as ``element.json`` has it, with its last job and its mark."""
    return BlockJobOut(
        id=str(job["id"]),
        block=str(job["block"]),
        said=str(job["said"]),
        panels=list(job.get("panels", ())),
        cut_min=_minutes(job),
        mark=found.job_state(job),
        **_planned(planned.get(str(job["id"]))),
    )


def _minutes(row: Mapping[str, Any]) -> dict[str, float]:
    return {str(arm): float(value) for arm, value in row.get("cut_min", {}).items()}


def done(name: str, row: RowMapping) -> Done:
    """How a panel's job ended."""
    issues = tuple(Issue.from_dict(one) for one in json.loads(row["issues"]))
    return Done(name, row["state"], issues, json.loads(row["metrics"]), row["seconds"] or 0.0)
