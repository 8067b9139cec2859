"""What became of an element's panels in a batch: verdicts, robot minutes and the joints of what was cut, as
values; `run_page.py` shows them.

**Robot minutes** are those of the programs' motion, of each arm that a panel takes; loading, heating up and
turning come on top.
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
from planner.element.run_joints import CutFace, CutJoint, cut_faces, cut_joint, job_of
from planner.element.side_joints import CutSide, cut_sides, side_joint
from planner.element.wall_joints import cut_surfaces, wall_joint
from planner.files import is_file
from planner.geometry.units import MM, measurement
from planner.issues import Issue, Severity, TandemError, refusal

MOST_AT_95: Final = 0.2e-3
"""Step and gap [m] that 95 % of the points of a joint must keep, where the element states no other."""
MOST: Final = 0.5e-3
"""Step and gap [m] that every point of a joint must keep."""
PROVEN: Final = "verified"
"""What the summary of a batch calls a panel whose programs are proven."""
NOT_PLANNED: Final = "not planned"
"""State of a panel that the batch does not have."""
_MOST_NAMED: Final = 30  # panels that are not planned, in a message
MINUTE: Final = 60.0
"""[s]"""


@dataclasses.dataclass(frozen=True)
class PanelRun:
    """A panel of ``element.json`` and what became of it: its ``state`` in the summary, the ``code`` and
    ``message`` of what is to be said, ``seconds`` of motion by arm, its ``faces`` as cut; of a planar panel
    these are its ``sides``, and before them its front where a row is cut to its thickness."""

    panel: Mapping[str, Any]
    state: str
    code: str = ""
    message: str = ""
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)
    faces: tuple[CutFace, ...] = ()
    sides: tuple[CutSide, ...] = ()

    @property
    def name(self) -> str:
        """The panel's id."""
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
    """A job that cuts a raw block, as ``element.json`` has it, the id of the ``block``, and what became of
    it, as of a panel."""

    job: Mapping[str, Any]
    block: str
    state: str
    code: str = ""
    message: str = ""
    seconds: Mapping[str, float] = dataclasses.field(default_factory=dict)

    @property
    def name(self) -> str:
        """The job's id."""
        return str(self.job["id"])

    @property
    def proven(self) -> bool:
        """Whether its programs are proven."""
        return self.state == PROVEN


@dataclasses.dataclass(frozen=True)
class JointRun:
    """A joint and its measure where both panels are proven, with the step [m] that 95 % must keep."""

    panels: tuple[str, str]
    length: float
    limit: float
    cut: CutJoint | None

    @property
    def at_95(self) -> float:
        """The larger one of step and gap at 95 % of its points [m]; NaN where it is not measured."""
        if self.cut is None:
            return float("nan")
        return max(float(np.percentile(v, 95.0)) for v in (self.cut.steps, self.cut.gaps))

    @property
    def largest(self) -> float:
        """The largest step or gap [m]; NaN where it is not measured."""
        return float("nan") if self.cut is None else float(max(self.cut.steps.max(), self.cut.gaps.max()))

    @property
    def over(self) -> bool:
        """Whether it is measured and beyond a limit."""
        return self.at_95 > self.limit or self.largest > MOST


@dataclasses.dataclass(frozen=True)
class ElementRun:
    """An element and a batch of its panels, with the jobs that cut its raw blocks."""

    data: Mapping[str, Any]
    panels: tuple[PanelRun, ...]
    joints: tuple[JointRun, ...]
    saw: tuple[SawRun, ...] = ()

    @property
    def measured(self) -> tuple[JointRun, ...]:
        """Joints of which both panels are proven."""
        return tuple(joint for joint in self.joints if joint.cut is not None)

    @property
    def _all(self) -> tuple[PanelRun | SawRun, ...]:
        return *self.panels, *self.saw

    @functools.cached_property
    def planned(self) -> bool:
        """Whether the batch has any of its panels, or of the jobs of its raw blocks."""
        return any(one.state != NOT_PLANNED for one in self._all)

    def arm_seconds(self) -> dict[str, float]:
        """Seconds of motion of each arm, over the proven panels."""
        return _summed(self.panels)

    def saw_seconds(self) -> dict[str, float]:
        """The same over the proven jobs of raw blocks."""
        return _summed(self.saw)

    def all_seconds(self) -> dict[str, float]:
        """Both together."""
        return _summed(self._all)

    def issues(self) -> tuple[Issue, ...]:
        """``element.joint`` for each joint beyond its limits, ``element.face`` for each face that is cut on
        its wrong side, and each planar front off its plane, ``element.run`` for panels without proof."""
        found = [
            Issue(
                "element.joint",
                f"joint {joint.panels[0]} to {joint.panels[1]} as cut: {joint.at_95 / MM:.3f} mm at 95 % of "
                f"its points, {joint.largest / MM:.3f} mm at most; allowed are {joint.limit / MM:g} and "
                f"{MOST / MM:g} mm",
                Severity.WARNING,
                field="panels.elastic.joint_mm" if "joint_mm" in self.data else "jobs",
                **measurement(joint.at_95 / MM, joint.limit / MM, "mm"),
                hint="ask for a smaller shape_tol_mm in the jobs"
                + (", or a smaller tolerance_mm" if "joint_mm" in self.data else ""),
            )
            for joint in self.joints
            if joint.over
        ]
        found += [issue for panel in self.panels for issue in _off_face(panel)]
        found += _left("panels", self.panels, "see what their reports say, and order no foam for them before")
        if any(one.state != NOT_PLANNED for one in self.saw):
            hint = "see what their reports say; cut these by hand otherwise"
            found += _left("jobs of raw blocks", self.saw, hint)
        return tuple(found)


def _summed(jobs: Sequence[PanelRun | SawRun]) -> dict[str, float]:
    out: dict[str, float] = {}
    for job in jobs:
        for arm, seconds in job.seconds.items():
            out[arm] = out.get(arm, 0.0) + seconds
    return out


def _off_face(panel: PanelRun) -> Iterator[Issue]:
    """``element.face`` for a planar front that is cut off its plane, and for any other face whose slot is on
    the panel's side."""
    for face in panel.faces:
        planar = isinstance(face, CutFront)
        off = np.abs(face.deviation)
        at_95 = float(np.percentile(off, 95.0))
        near = at_95 <= MOST_AT_95 and float(off.max()) <= MOST
        if not face.slot and (near or not planar):
            continue
        where = f"; the slot of {face.slot / MM:.2g} mm is on the panel's side" if face.slot else ""
        what, wanted = ("front", "its plane") if planar else ("a face", "what is written")
        yield Issue(
            "element.face",
            f"{what} of panel {panel.name} as cut: {at_95 / MM:.3f} mm off {wanted} at 95 % of its points, "
            f"{off.max() / MM:.3f} mm at most{where}; allowed are {MOST_AT_95 / MM:g} and {MOST / MM:g} mm",
            Severity.WARNING,
            field="cut_blocks" if planar else "jobs",
            **measurement(at_95 / MM, MOST_AT_95 / MM, "mm"),
            hint=f"do not cut {job_of(panel.panel)}; divide the element again and plan "
            f"{'its blocks' if planar else 'it'} anew"
            if face.slot
            else "ask for a smaller shape_tol_mm in cut_blocks.problem",
        )


def _left(what: str, jobs: Sequence[PanelRun | SawRun], hint: str) -> Iterator[Issue]:
    left = [job for job in jobs if not job.proven]
    if not left:
        return
    tried = [f"{job.name} ({job.code or job.state})" for job in left if job.state != NOT_PLANNED]
    names = [job.name for job in left if job.state == NOT_PLANNED]
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    if names:
        tried.append(f"not planned: {', '.join(names[:_MOST_NAMED])}{more}")
    said = f"{len(left)} of {len(jobs)} {what} are not proven: {', '.join(tried)}"
    yield Issue("element.run", said, Severity.WARNING, hint=hint)


def read_run(out: Path, run: Path) -> ElementRun:
    """What the batch in ``run`` made of the element in ``out``.

    Raises ``TandemError``: ``element.run`` where one of them is no such folder, the element was written
    without joints, or a plan is of another panel.
    """
    if not is_file(out / "element.json"):
        raise _missing(out / "element.json", "tandem element FILE -o OUT writes it")
    if not is_file(run / "summary.csv"):
        raise _missing(run / "summary.csv", "tandem batch OUT/panels -o RUN writes it")
    data = json.loads((out / "element.json").read_text("utf-8"))
    if "joints" not in data or not all("outline_mm" in panel for panel in data["panels"]):
        what = f"{out} was written without joints or outlines of its panels; puzzle pieces have none"
        hint = (
            f"verdicts are in {run / 'summary.csv'}; divide another element again: tandem element "
            "FILE -o OUT; panels that stay need no new plan"
        )
        raise refusal("element.run", what, file=str(out / "element.json"), hint=hint)
    with (run / "summary.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    thickness = float(data.get("thickness_mm", 0.0)) * MM
    panels = tuple(_panel(out, run, panel, rows.get(job_of(panel)), thickness) for panel in data["panels"])
    known = {panel.name: panel for panel in panels}
    limit = float(data.get("joint_mm", MOST_AT_95 / MM)) * MM
    joints = []
    for joint in data["joints"]:
        one, other = (known[str(name)] for name in joint["panels"])
        names = one.name, other.name
        cut = None
        if one.faces and other.faces and "front_mm" in joint:
            cut = wall_joint(names, joint, one.faces, other.faces)
        elif one.faces and other.faces and "sides" in joint:
            i, k = joint["sides"]
            cut = side_joint(names, one.sides[i], other.sides[k])
        elif one.faces and other.faces:
            cut = cut_joint(names, one.faces, other.faces)
        joints.append(JointRun(names, float(joint["length_mm"]) * MM, limit, cut))
    return ElementRun(data, panels, tuple(joints), tuple(_saw(data, run, rows)))


def unplanned(data: Mapping[str, Any]) -> ElementRun:
    """An element as it is divided, before any batch."""
    joints = tuple(
        JointRun((str(j["panels"][0]), str(j["panels"][1])), float(j["length_mm"]) * MM, MOST_AT_95, None)
        for j in data.get("joints", ())
    )
    panels = tuple(PanelRun(panel, NOT_PLANNED) for panel in data["panels"])
    return ElementRun(data, panels, joints, tuple(_saw(data, None, {})))


def _saw(
    data: Mapping[str, Any], run: Path | None, rows: Mapping[str, Mapping[str, str]]
) -> Iterator[SawRun]:
    """The jobs of raw blocks, by the ``rows`` of the summary in ``run``."""
    for block in (data.get("blocks") or {}).get("blocks", ()):
        for job in block.get("jobs", ()):
            name, row = str(job["id"]), rows.get(str(job["id"]))
            if run is None or row is None:
                yield SawRun(job, block["id"], NOT_PLANNED)
                continue
            proven = row["state"] == PROVEN
            code = next(iter(row["issues"].split()), "")
            seconds = _motion(run / name) if proven else {}
            yield SawRun(job, block["id"], row["state"], code, row["message"], seconds)


def _motion(result: Path) -> dict[str, float]:
    """Seconds of motion of each arm in a result folder."""
    seconds: dict[str, float] = {}
    for operation in plans.load(result).operations:
        for arm in operation.targets.arms:
            seconds[arm] = seconds.get(arm, 0.0) + float(operation.time[-1])
    return seconds


def _missing(path: Path, who: str) -> TandemError:
    return refusal("element.run", f"{path}: there is no such file; {who}", file=str(path))


def _panel(
    out: Path, run: Path, panel: Mapping[str, Any], row: Mapping[str, str] | None, thickness: float
) -> PanelRun:
    if row is None:
        return PanelRun(panel, NOT_PLANNED)
    code = next(iter(row["issues"].split()), "")
    if row["state"] != PROVEN:
        return PanelRun(panel, row["state"], code, row["message"])
    seconds = {} if "cut_in" in panel else _motion(run / job_of(panel))  # of rows with those of blocks
    if "front_mm" in panel:
        sides = cut_sides(out, run, panel, thickness)
        whole = (*cut_front(run, panel, thickness), *sides)
        return PanelRun(panel, PROVEN, code, row["message"], seconds, whole, sides)
    faces = cut_surfaces(out, run, panel) if "from_share" in panel else cut_faces(out, run, panel)
    return PanelRun(panel, PROVEN, code, row["message"], seconds, faces)


def panel_rows(found: ElementRun) -> str:
    """``report.csv``: a row for each panel."""
    rows = []
    for panel in found.panels:
        off = np.concatenate([face.deviation for face in panel.faces]) / MM if panel.faces else np.zeros(0)
        rows.append(
            {
                "id": panel.name,
                "state": panel.state,
                **{
                    f"{arm}_min": round(panel.seconds[arm] / MINUTE, 3) if arm in panel.seconds else ""
                    for arm in found.arm_seconds()
                },
                "off_written_95_mm": round(float(np.percentile(np.abs(off), 95.0)), 4) if len(off) else "",
                "off_written_largest_mm": round(float(np.abs(off).max()), 4) if len(off) else "",
                **{name: panel.panel[name] for name in ("backs_apart_mm",) if name in panel.panel},
                "issue": panel.code,
                "message": panel.message,
            }
        )
    return table(rows)


def joint_rows(found: ElementRun) -> str:
    """``joints.csv``: a row for each joint; figures are empty where it is not measured."""

    def mm(value: float) -> float | str:
        return "" if np.isnan(value) else round(value / MM, 4)

    nothing = np.full(1, np.nan)
    rows = []
    for joint in found.joints:
        steps, gaps = (nothing, nothing) if joint.cut is None else (joint.cut.steps, joint.cut.gaps)
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
                "over": "" if joint.cut is None else "yes" if joint.over else "no",
            }
        )
    return table(rows)
