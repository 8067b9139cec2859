"""Results of an element's panels in a batch: verdicts, robot minutes and joints of the cut panels, as values.

`run_page.py` shows them. **Robot minutes** are the motion times of the programs for each arm; loading,
heating and rotating are additional.
"""

import csv
import dataclasses
import functools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from planner import plans
from planner.element.output import table
from planner.element.row_fronts import CutFront, cut_front
from planner.element.run_joints import CutJoint, PanelCutFace, cut_faces, cut_joint, job_of
from planner.element.side_joints import CutSide, cut_sides, side_joint
from planner.element.wall_joints import cut_surfaces, wall_joint
from planner.files import is_file
from planner.geometry.units import MM, measurement
from planner.issue_codes import format_message
from planner.issues import Issue, Severity, TandemError, issue_error

MAX_STEP_95_M: Final = 0.2e-3
"""Default limit of step and gap [m] for 95 % of the points of a joint."""
MAX_STEP_M: Final = 0.5e-3
"""Limit of step and gap [m] for every point of a joint."""
PROVEN: Final = "verified"
"""State that the summary of a batch has for a panel whose programs are proven."""
NOT_PLANNED: Final = "not planned"
"""State of a panel that is not in the batch."""
_MAX_NAMED_PANELS: Final = 30  # of the panels that are not planned, in a message
MINUTE_S: Final = 60.0
"""Duration of a minute [s]."""


@dataclasses.dataclass(frozen=True)
class PanelRun:
    """A panel with its results.

    Attributes:
        panel: Data in ``element.json``.
        state: State in the summary.
        code: Code of its first issue; empty if there is none.
        message: Message of that issue.
        seconds: Motion time [s] by arm; empty if the panel is cut together with others.
        faces: Front and back as cut. For a planar panel these are its sides, after its front if that is cut.
        sides: Sides of a planar panel as cut.
    """

    panel: Mapping[str, Any]
    state: str
    code: str = ""
    message: str = ""
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)
    faces: tuple[PanelCutFace, ...] = ()
    sides: tuple[CutSide, ...] = ()

    @property
    def name(self) -> str:
        """Id of the panel."""
        return str(self.panel["id"])

    @property
    def proven(self) -> bool:
        """Whether its programs are proven."""
        return self.state == PROVEN

    @property
    def own_job(self) -> bool:
        """Whether it has a job of its own, rather than being cut together with others."""
        return "cut_in" not in self.panel


@dataclasses.dataclass(frozen=True)
class SawRun:
    """A job that cuts a raw block, with its results.

    Attributes:
        job: Data in ``element.json``.
        block: Id of the block.
        state: State in the summary.
        code: Code of its first issue; empty if there is none.
        message: Message of that issue.
        seconds: Motion time [s] by arm.
    """

    job: Mapping[str, Any]
    block: str
    state: str
    code: str = ""
    message: str = ""
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        """Id of the job."""
        return str(self.job["id"])

    @property
    def proven(self) -> bool:
        """Whether its programs are proven."""
        return self.state == PROVEN


@dataclasses.dataclass(frozen=True)
class JointRun:
    """A joint with its measurement.

    Attributes:
        panels: Ids of the panels.
        length: Length [m].
        limit: Limit of step and gap [m] for 95 % of its points.
        cut: Measurement; None if a panel is not proven or they share no point.
    """

    panels: tuple[str, str]
    length: float
    limit: float
    cut: CutJoint | None

    @property
    def at_95(self) -> float:
        """Larger one [m] of the 95th percentiles of steps and gaps; NaN if it is not measured."""
        if self.cut is None:
            return float("nan")
        return max(float(np.percentile(v, 95.0)) for v in (self.cut.steps, self.cut.gaps))

    @property
    def largest(self) -> float:
        """Largest step or gap [m]; NaN if it is not measured."""
        return float("nan") if self.cut is None else float(max(self.cut.steps.max(), self.cut.gaps.max()))

    @property
    def is_over_limit(self) -> bool:
        """Whether it is measured and exceeds a limit."""
        # comparisons with NaN are False
        return self.at_95 > self.limit or self.largest > MAX_STEP_M


@dataclasses.dataclass(frozen=True)
class ElementRun:
    """An element with the results of a batch.

    Attributes:
        data: Content of ``element.json``.
        panels: Panels with their results.
        joints: Joints with their measurements.
        saw: Jobs that cut raw blocks, with their results.
    """

    data: Mapping[str, Any]
    panels: tuple[PanelRun, ...]
    joints: tuple[JointRun, ...]
    saw: tuple[SawRun, ...] = ()

    @property
    def measured(self) -> tuple[JointRun, ...]:
        """Joints that are measured."""
        return tuple(joint for joint in self.joints if joint.cut is not None)

    @property
    def _all(self) -> tuple[PanelRun | SawRun, ...]:
        """All panels and jobs of raw blocks."""
        return *self.panels, *self.saw

    @functools.cached_property
    def planned(self) -> bool:
        """Whether the batch has at least one of its panels or jobs of raw blocks."""
        return any(job.state != NOT_PLANNED for job in self._all)

    def arm_seconds(self) -> dict[str, float]:
        """Return the motion time [s] of each arm over the proven panels."""
        return _sum_seconds(self.panels)

    def saw_seconds(self) -> dict[str, float]:
        """Return the motion time [s] of each arm over the proven jobs of raw blocks."""
        return _sum_seconds(self.saw)

    def all_seconds(self) -> dict[str, float]:
        """Return the motion time [s] of each arm over proven panels and jobs of raw blocks."""
        return _sum_seconds(self._all)

    def issues(self) -> tuple[Issue, ...]:
        """Return the issues of the batch.

        ``element.joint`` for each joint beyond its limits, ``element.face`` for each face whose slot is
        inside the panel and each planar front off its plane, ``element.run`` once for all panels without a
        proof.
        """
        out = [
            Issue(
                "element.joint",
                f"joint {joint.panels[0]} to {joint.panels[1]} as cut: {joint.at_95 / MM:.3f} mm at 95 % of "
                f"its points, {joint.largest / MM:.3f} mm at most; allowed: {joint.limit / MM:g} and "
                f"{MAX_STEP_M / MM:g} mm",
                Severity.WARNING,
                field="panels.elastic.joint_mm" if "joint_mm" in self.data else "jobs",
                **measurement(joint.at_95 / MM, joint.limit / MM, "mm"),
                hint="set a smaller shape_tol_mm in the jobs"
                + (", or a smaller tolerance_mm" if "joint_mm" in self.data else ""),
            )
            for joint in self.joints
            if joint.is_over_limit
        ]
        out += [issue for panel in self.panels for issue in _face_issues(panel)]
        out += _unproven_issues("panels", self.panels, "read their reports before ordering foam for them")
        if any(job.state != NOT_PLANNED for job in self.saw):
            hint = "read their reports; otherwise cut these by hand"
            out += _unproven_issues("jobs of raw blocks", self.saw, hint)
        return tuple(out)


def _sum_seconds(jobs: Sequence[PanelRun | SawRun]) -> dict[str, float]:
    """Return the motion time [s] of each arm, summed over jobs."""
    out: dict[str, float] = {}
    for job in jobs:
        for arm, seconds in job.seconds.items():
            out[arm] = out.get(arm, 0.0) + seconds
    return out


def _face_issues(panel: PanelRun) -> Iterator[Issue]:
    """Yield ``element.face`` for a planar front off its plane and for a face whose slot is in the panel."""
    for face in panel.faces:
        is_planar = isinstance(face, CutFront)
        deviations = np.abs(face.deviation)
        at_95 = float(np.percentile(deviations, 95.0))
        is_within = at_95 <= MAX_STEP_95_M and float(deviations.max()) <= MAX_STEP_M
        if not face.slot and (is_within or not is_planar):
            continue
        slot_text = f"; the slot of {face.slot / MM:.2g} mm is in the panel" if face.slot else ""
        face_text, reference = ("front", "its plane") if is_planar else ("a face", "the face as written")
        yield Issue(
            "element.face",
            format_message(
                "element.face",
                face=face_text,
                panel=panel.name,
                percentile_95_mm=at_95 / MM,
                reference=reference,
                max_deviation_mm=deviations.max() / MM,
                slot_clause=slot_text,
                percentile_95_limit_mm=MAX_STEP_95_M / MM,
                max_deviation_limit_mm=MAX_STEP_M / MM,
            ),
            Severity.WARNING,
            field="cut_blocks" if is_planar else "jobs",
            **measurement(at_95 / MM, MAX_STEP_95_M / MM, "mm"),
            hint=f"do not cut {job_of(panel.panel)}; divide the element again and plan "
            f"{'its blocks' if is_planar else 'it'} anew"
            if face.slot
            else "set a smaller shape_tol_mm in cut_blocks.problem",
        )


def _unproven_issues(kind: str, jobs: Sequence[PanelRun | SawRun], hint: str) -> Iterator[Issue]:
    """Yield one ``element.run`` that lists the jobs that are not proven, if any; ``kind`` is their plural."""
    unproven = [job for job in jobs if not job.proven]
    if not unproven:
        return
    texts = [f"{job.name} ({job.code or job.state})" for job in unproven if job.state != NOT_PLANNED]
    names = [job.name for job in unproven if job.state == NOT_PLANNED]
    remainder = f" and {len(names) - _MAX_NAMED_PANELS} more" if len(names) > _MAX_NAMED_PANELS else ""
    if names:
        texts.append(f"not planned: {', '.join(names[:_MAX_NAMED_PANELS])}{remainder}")
    message = f"{len(unproven)} of {len(jobs)} {kind} are not proven: {', '.join(texts)}"
    yield Issue("element.run", message, Severity.WARNING, hint=hint)


def read_run(out: Path, run: Path) -> ElementRun:
    """Read the results of the batch in ``run`` for the element in ``out``.

    Raises:
        TandemError: ``element.run`` if a file is missing, the element has no joints or outlines, or a plan
            belongs to another panel.
    """
    if not is_file(out / "element.json"):
        raise _missing_error(out / "element.json", "tandem element FILE -o OUT writes it")
    if not is_file(run / "summary.csv"):
        raise _missing_error(run / "summary.csv", "tandem batch OUT/panels -o RUN writes it")
    data = json.loads((out / "element.json").read_text("utf-8"))
    if "joints" not in data or not all("outline_mm" in panel for panel in data["panels"]):
        message = f"{out} has no joints or outlines of its panels; puzzle pieces never have"
        hint = (
            f"verdicts are in {run / 'summary.csv'}; divide another element again: tandem element "
            "FILE -o OUT; panels that stay need no new plan"
        )
        raise issue_error("element.run", message, file=str(out / "element.json"), hint=hint)
    with (run / "summary.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    thickness = float(data.get("thickness_mm", 0.0)) * MM
    panels = tuple(
        _panel_run(out, run, panel, rows.get(job_of(panel)), thickness) for panel in data["panels"]
    )
    panels_by_name = {panel.name: panel for panel in panels}
    limit = float(data.get("joint_mm", MAX_STEP_95_M / MM)) * MM
    joints = []
    for joint in data["joints"]:
        first, second = (panels_by_name[str(name)] for name in joint["panels"])
        names = first.name, second.name
        cut = None
        if first.faces and second.faces and "front_mm" in joint:
            cut = wall_joint(names, joint, first.faces, second.faces)
        elif first.faces and second.faces and "sides" in joint:
            i, k = joint["sides"]
            cut = side_joint(names, first.sides[i], second.sides[k])
        elif first.faces and second.faces:
            cut = cut_joint(names, first.faces, second.faces)
        joints.append(JointRun(names, float(joint["length_mm"]) * MM, limit, cut))
    return ElementRun(data, panels, tuple(joints), tuple(_saw_runs(data, run, rows)))


def unplanned_run(data: Mapping[str, Any]) -> ElementRun:
    """Return an element as divided, without results."""
    joints = tuple(
        JointRun(
            (str(joint["panels"][0]), str(joint["panels"][1])),
            float(joint["length_mm"]) * MM,
            MAX_STEP_95_M,
            cut=None,
        )
        for joint in data.get("joints", ())
    )
    panels = tuple(PanelRun(panel, NOT_PLANNED) for panel in data["panels"])
    return ElementRun(data, panels, joints, tuple(_saw_runs(data, None, {})))


def _saw_runs(
    data: Mapping[str, Any], run: Path | None, rows: Mapping[str, Mapping[str, str]]
) -> Iterator[SawRun]:
    """Yield the jobs of raw blocks with their ``rows`` of the summary in ``run`` (None: none is planned)."""
    for block in (data.get("blocks") or {}).get("blocks", ()):
        for job in block.get("jobs", ()):
            name, row = str(job["id"]), rows.get(str(job["id"]))
            if run is None or row is None:
                yield SawRun(job, block["id"], NOT_PLANNED)
                continue
            proven = row["state"] == PROVEN
            code = next(iter(row["issues"].split()), "")
            seconds = _motion_seconds(run / name) if proven else {}
            yield SawRun(job, block["id"], row["state"], code, row["message"], seconds)


def _motion_seconds(result: Path) -> dict[str, float]:
    """Return the motion time [s] of each arm, summed over the operations of a result folder."""
    seconds: dict[str, float] = {}
    for operation in plans.load(result).operations:
        for arm in operation.targets.arms:
            seconds[arm] = seconds.get(arm, 0.0) + float(operation.time[-1])
    return seconds


def _missing_error(path: Path, remedy: str) -> TandemError:
    return issue_error("element.run", f"{path}: no such file; {remedy}", file=str(path))


def _panel_run(
    out: Path, run: Path, panel: Mapping[str, Any], row: Mapping[str, str] | None, thickness: float
) -> PanelRun:
    """Return a panel with its results from the summary and, if it is proven, from its result folder.

    ``row`` is that of the job that cuts it in the summary; None if it is not planned. ``thickness`` [m] is
    that of planar panels.
    """
    if row is None:
        return PanelRun(panel, NOT_PLANNED)
    code = next(iter(row["issues"].split()), "")
    if row["state"] != PROVEN:
        return PanelRun(panel, row["state"], code, row["message"])
    # the time of a row counts with the jobs of raw blocks
    seconds = {} if "cut_in" in panel else _motion_seconds(run / job_of(panel))
    if "front_mm" in panel:
        sides = cut_sides(out, run, panel, thickness)
        front_and_sides = (*cut_front(run, panel, thickness), *sides)
        return PanelRun(panel, PROVEN, code, row["message"], seconds, front_and_sides, sides)
    faces = cut_surfaces(out, run, panel) if "from_share" in panel else cut_faces(out, run, panel)
    return PanelRun(panel, PROVEN, code, row["message"], seconds, faces)


def panels_csv(run: ElementRun) -> str:
    """Return ``report.csv``: a row for each panel with its state, times, deviations [mm] and issue."""
    rows = []
    for panel in run.panels:
        deviations = (
            np.concatenate([face.deviation for face in panel.faces]) / MM if panel.faces else np.zeros(0)
        )
        rows.append(
            {
                "id": panel.name,
                "state": panel.state,
                **{
                    f"{arm}_min": round(panel.seconds[arm] / MINUTE_S, 3) if arm in panel.seconds else ""
                    for arm in run.arm_seconds()
                },
                "off_written_95_mm": round(float(np.percentile(np.abs(deviations), 95.0)), 4)
                if len(deviations)
                else "",
                "off_written_largest_mm": round(float(np.abs(deviations).max()), 4)
                if len(deviations)
                else "",
                **{name: panel.panel[name] for name in ("backs_apart_mm",) if name in panel.panel},
                "issue": panel.code,
                "message": panel.message,
            }
        )
    return table(rows)


def joints_csv(run: ElementRun) -> str:
    """Return ``joints.csv``: a row for each joint; values are empty if it is not measured."""

    def mm(value: float) -> float | str:
        return "" if np.isnan(value) else round(value / MM, 4)

    unmeasured = np.full(1, np.nan)
    rows = []
    for joint in run.joints:
        steps, gaps = (unmeasured, unmeasured) if joint.cut is None else (joint.cut.steps, joint.cut.gaps)
        rows.append(
            {
                "panel": joint.panels[0],
                "other": joint.panels[1],
                "length_mm": mm(joint.length),
                "points": 0 if joint.cut is None else len(gaps),
                "step_95_mm": mm(float(np.percentile(steps, 95.0))),
                "step_largest_mm": mm(float(steps.max())),
                "gap_95_mm": mm(float(np.percentile(gaps, 95.0))),
                "gap_largest_mm": mm(float(gaps.max())),
                "over": "" if joint.cut is None else "yes" if joint.is_over_limit else "no",
            }
        )
    return table(rows)
