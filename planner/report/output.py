"""Files of a result folder for people: report, replay, simulated part and the proof.

The report is one self-contained HTML file for screen and paper. It is also written without a plan. The
proof is written as data.
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planner.cell import plant
from planner.cell.plant import CellModel
from planner.issues import Issue, TandemError, accepted_codes, aggregate, has_errors
from planner.plans import Plan
from planner.problem import Problem, Setup
from planner.proof.verdict import Proof
from planner.report import (
    cell_picture,
    exhibits,
    freedom_map,
    markup,
    motion_charts,
    page_sections,
    replay,
    setup_sheet,
)
from planner.report.cell_picture import Picture
from planner.report.freedom_map import FreedomMapData
from planner.report.markup import Block, PageSection
from planner.report.motion_charts import MotionSeries
from planner.report.replay import Viewer


@dataclasses.dataclass(frozen=True)
class ReportExtras:
    """What the report shows besides problem, plan and proof.

    Attributes:
        pictures: Pictures of the cell with their titles.
        filtered: Pairs of bodies whose collision is not tested, with reasons.
        programs: Names of program files, with their numbers of lines.
        issues: Issues that belong to no plan.
        maps: Maps of freedoms.
    """

    pictures: Sequence[tuple[str, Picture]] = ()
    filtered: Sequence[tuple[str, str, str]] = ()
    programs: Sequence[tuple[str, int]] = ()
    issues: Sequence[Issue] = ()
    maps: Sequence[FreedomMapData] = ()


def report_html(
    problem: Problem | None, plan: Plan | None, proof: Proof | None, extra: ReportExtras | None = None
) -> str:
    """Return the report as HTML. Without a plan it shows the problem as far as known, and the issues.

    Args:
        problem: Problem, or None if it was refused.
        plan: Plan, or None.
        proof: Proof, or None.
        extra: Further content.
    """
    extra = extra or ReportExtras()
    process_sections, exhibit_issues = _exhibits(problem, plan)
    part = problem.part if problem is not None else None
    issues = aggregate(
        [
            *(part.notes if part is not None else ()),
            *(problem.notes if problem is not None else ()),
            *(plan.issues if plan else ()),
            *(issue for op in (plan.operations if plan else ()) for issue in op.issues),
            *(proof.issues if proof else ()),
            *extra.issues,
            *exhibit_issues,
        ]
    )
    sections: list[PageSection] = []
    if issues:
        sections.append(PageSection("issues", "Issues", (page_sections.issue_table(_unique(issues)),)))
    if extra.pictures:
        cell_pictures = tuple(page_sections.picture(picture, title) for title, picture in extra.pictures)
        sections.append(PageSection("cell", "Cell", cell_pictures))
    if problem is not None and plan is not None and proof is not None and proof.surfaces:
        faces = page_sections.face_figures(problem, plan, proof)
        sections.append(PageSection("part", "Simulated part compared with the nominal part", faces))
    sections += process_sections
    if problem is not None and plan is not None and plan.operations:
        motion = motion_charts.motion_series(problem, plan, proof)
        sections += _motion(problem, motion, proof)
        if extra.maps:
            sections.append(
                PageSection("maps", "Maps of freedoms", tuple(map(freedom_map.figure, extra.maps)))
            )
        sections.append(PageSection("setup", "Setup sheet", (setup_sheet.build_sheet(problem, plan, proof),)))
    if proof is not None and proof.rules:
        tables = page_sections.rule_tables(proof.rules)
        sections.append(PageSection("proof", "Proof from the programs' text", tables))
    sections += _background(plan, extra)
    title = problem.name if problem is not None else "Problem"
    return markup.page_html(
        markup.Page(
            f"{title} – Tandem report",
            problem.name if problem is not None else "The problem was refused",
            page_sections.verdicts(plan, proof, has_errors(issues), accepted_codes(issues)),
            page_sections.problem_summary(problem) if problem is not None else None,
            page_sections.key_tiles(problem, plan, proof) if plan is not None and problem is not None else (),
            tuple(sections),
        )
    )


def _unique(issues: Sequence[Issue]) -> list[Issue]:
    """Remove repeated issues: a plan repeats those of its operations."""
    return list(dict.fromkeys(issues))


def _exhibits(problem: Problem | None, plan: Plan | None) -> tuple[list[PageSection], list[Issue]]:
    """Return a section of exhibits for each operation, and issues for those that cannot be drawn."""
    sections: list[PageSection] = []
    exhibit_issues: list[Issue] = []
    for index, operation in enumerate(plan.operations if plan else ()):
        stock = problem.setup_of(index).stock if problem is not None else None
        default_block = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
        block = default_block if stock is None else np.array([stock.lower, stock.upper])
        figures, issues = exhibits.draw(operation.targets.exhibits, block)
        exhibit_issues += issues
        title = "Process" if plan is None or len(plan.operations) == 1 else f"Process: {operation.name}"
        wide_figures = tuple(figure for figure in figures if isinstance(figure, markup.Wide))
        narrow_figures = tuple(figure for figure in figures if not isinstance(figure, markup.Wide))
        content: tuple[Block, ...] = (
            (*wide_figures, markup.GridBlock(narrow_figures)) if narrow_figures else wide_figures
        )
        sections.append(PageSection(f"process{index}", title, content))
    return sections, exhibit_issues


def _motion(problem: Problem, motion: MotionSeries, proof: Proof | None) -> list[PageSection]:
    """Return two sections of the report: charts over the time of the motion, and charts of joint angles.

    The first one contains feed, clearances, margins, speeds, and the charts of each process.
    """
    settings = problem.settings
    figures = [motion_charts.feed_figure(motion)] if len(motion.feed.time) > 1 else []
    if motion.clearance is not None:
        figures.append(motion_charts.clearance_figure(motion.clearance, motion, settings))
    if motion.own_clearance is not None:
        figures.append(motion_charts.own_clearance_figure(motion.own_clearance, motion, settings))
    for process in motion.processes:
        figures += motion_charts.process_figures(process.distances, motion)
    figures += motion_charts.margin_figures(motion, settings, proof) if motion.arms else []
    for process in motion.processes:
        figures += motion_charts.process_figures(process.charts, motion)
    for name, arm in motion.arms.items():
        figures += motion_charts.speed_figures(name, arm, motion, settings)
    pairs = motion_charts.closest_pairs(motion.clearance) if motion.clearance is not None else ()
    note = f"Joint motion: {motion.source}. Tinted bands are segments."
    content: tuple[Block, ...] = (markup.GridBlock(tuple(figures)), *pairs, markup.Paragraph(note, "note"))
    joints: list[Block] = []
    for name, arm in motion.arms.items():
        joints.append(markup.Heading(f"{name}: {arm.robot.title}"))
        joints.append(markup.GridBlock(tuple(motion_charts.joint_figures(name, arm, motion)), "three"))
    return [
        PageSection("motion", "Motion", content),
        PageSection("joints", "Joint angles and limits", tuple(joints)),
    ]


def _background(plan: Plan | None, extra: ReportExtras) -> list[PageSection]:
    """Return the sections on placement search, planning and pairs whose collision is not tested."""
    out = []
    if plan is not None:
        out.append(PageSection("placement", "Placement search", page_sections.placement_figures(plan)))
        planning = page_sections.planning_details(plan, extra.programs)
        out.append(PageSection("times", "Planning details", (planning,)))
    if extra.filtered:
        pair_table = markup.make_table(("body", "body", "why collisions are not tested"), extra.filtered)
        summary = (
            f"Collisions of {len(extra.filtered)} pairs of bodies, or some of their solids, are not tested. "
            "All other pairs are tested."
        )
        out.append(PageSection("filter", "Collision filter", (markup.Folded(summary, pair_table),)))
    return out


def pictures(problem: Problem, plan: Plan) -> Iterator[tuple[str, Picture]]:
    """Yield the pictures of the cell that the report shows, with their titles."""
    yield from cell_picture.setup_pictures(cell_model(problem, plan), problem, plan)


def files(
    problem: Problem, plan: Plan, proof: Proof | None, drawn: Sequence[tuple[str, Picture]] | None = None
) -> dict[str, str]:
    """Return the files of :func:`pages` and :func:`proof_files`, by name, without digests of programs."""
    return pages(problem, plan, proof, drawn) | proof_files(plan, proof)


def proof_files(plan: Plan, proof: Proof | None, programs: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return ``proof.json`` and ``simulated_part.obj`` if there is a proof, by name.

    Args:
        plan: Plan.
        proof: Proof, or None.
        programs: Proven programs by name. ``proof.json`` contains their SHA-256.
    """
    out: dict[str, str] = {}
    if proof is not None:
        texts = (programs or {}).items()
        digests = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts}
        out["proof.json"] = proof_json(proof, accepted_codes(plan.issues), digests)
        if proof.part_obj:
            out["simulated_part.obj"] = proof.part_obj
    return out


def pages(
    problem: Problem,
    plan: Plan,
    proof: Proof | None,
    drawn: Sequence[tuple[str, Picture]] | None = None,
    maps: Sequence[FreedomMapData] = (),
) -> dict[str, str]:
    """Return ``report.html`` and ``replay.html``, by name.

    Args:
        problem: Problem.
        plan: Plan.
        proof: Proof, or None.
        drawn: Result of :func:`pictures`, if already computed.
        maps: Maps of freedoms to show.
    """
    model = cell_model(problem, plan)
    if drawn is None:
        drawn = cell_picture.setup_pictures(model, problem, plan)
    return {
        "replay.html": replay.replay_html(model, problem, plan, proof),
        "report.html": report_html(
            problem, plan, proof, ReportExtras(drawn, model.filtered_pairs, maps=maps)
        ),
    }


def cell_model(problem: Problem, plan: Plan, setup: Setup | None = None) -> CellModel:
    """Build the model of the cell and the block as a setup starts, with the bases of the plan.

    Args:
        problem: Problem.
        plan: Plan.
        setup: Setup, or None for the first one.
    """
    chosen_setup = setup or problem.setups[0]
    return plant.build_cell_model(
        chosen_setup.cell, chosen_setup.stock, plan.stock_poses[chosen_setup.number - 1], plan.bases
    )


def show(problem: Problem, plan: Plan, proof: Proof | None = None) -> Viewer:
    """Serve the replay as a page on this machine."""
    return replay.show(cell_model(problem, plan), problem, plan, proof)


def failure_report(problem: Problem | None, issues: Sequence[Issue]) -> str:
    """Return the report for a problem that was refused or has no plan.

    It has a picture if the cell can be built. A block without a place is then at the world's origin.

    Args:
        problem: Problem, or None if it was refused.
        issues: Issues. Those of a cell that cannot be built are added.
    """
    cell_pictures: tuple[tuple[str, Picture], ...] = ()
    filtered: Sequence[tuple[str, str, str]] = ()
    if problem is not None:
        stock_pose = problem.stock.place
        pose_at_origin = np.eye(4)
        pose_at_origin[:3, :3] = problem.stock.attitude
        try:
            model = plant.build_cell_model(
                problem.cell, problem.stock, pose_at_origin if stock_pose is None else stock_pose
            )
        except TandemError as error:
            issues = [*issues, *(issue for issue in error.issues if issue not in issues)]
        else:
            cell_pictures = cell_picture.setup_pictures(model, problem, None)
            filtered = model.filtered_pairs
    return report_html(problem, None, None, ReportExtras(cell_pictures, filtered, issues=issues))


def read_accepted(text: str) -> list[str]:
    """Return the codes of accepted issues in the text of a ``proof.json``. Empty if it is invalid."""
    try:
        codes = json.loads(text)["accepted"]
    except (ValueError, KeyError, TypeError):
        return []
    return [str(code) for code in codes] if isinstance(codes, list) else []


def proof_json(proof: Proof, accepted_codes: Sequence[str], digests: Mapping[str, str]) -> str:
    """Return the proof as JSON: verdict, accepted codes, rules, issues, and faces without their points.

    Args:
        proof: Proof.
        accepted_codes: Codes of issues that the problem accepts.
        digests: SHA-256 of the proven program files by name.
    """
    # of a face, the scalar results without the arrays over its points
    faces = [
        {"segment": face.title, **{k: v for k, v in vars(face).items() if isinstance(v, float)}}
        for face in proof.surfaces
    ]
    issues = aggregate(proof.issues)
    data = {
        "ok": proof.ok and not has_errors(issues),
        "accepted": list(accepted_codes),
        "problem_digest": proof.problem_digest,
        "programs": dict(digests),
        "rules": [dataclasses.asdict(rule) for rule in proof.rules],
        "issues": [issue.to_dict() for issue in issues],
        "surfaces": faces,
    }
    return json.dumps(_plain_data(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain_data(value: object) -> object:
    """Convert nested data for JSON.

    Keys become strings, tuples lists, NumPy numbers Python numbers, and non-finite numbers None.
    """
    if isinstance(value, dict):
        return {str(k): _plain_data(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain_data(v) for v in value]
    if isinstance(value, np.generic):
        return _plain_data(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
