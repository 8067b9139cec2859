"""The files of a result folder that people look at: report, replay, simulated part, the proof.

The report is one HTML file that needs nothing else, for screen and paper; it is written where there
is no plan, too. The proof is written as data.
"""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planner.cell import plant
from planner.cell.plant import CellModel
from planner.issues import Issue, TandemError, accepted, aggregate, has_errors
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
from planner.report.freedom_map import FreedomMap
from planner.report.markup import Block, Section
from planner.report.motion_charts import Motion
from planner.report.replay import Viewer


@dataclasses.dataclass(frozen=True)
class Extra:
    """What the report shows besides problem, plan and proof.

    ``pictures`` of the cell with their titles; ``filtered`` pairs of bodies that are not held apart, with
    reasons; ``programs``: names and numbers of lines; ``issues`` that belong to no plan; ``maps`` of
    freedoms.
    """

    pictures: Sequence[tuple[str, Picture]] = ()
    filtered: Sequence[tuple[str, str, str]] = ()
    programs: Sequence[tuple[str, int]] = ()
    issues: Sequence[Issue] = ()
    maps: Sequence[FreedomMap] = ()


def render(
    problem: Problem | None, plan: Plan | None, proof: Proof | None, extra: Extra | None = None
) -> str:
    """The page as text. Without ``plan`` it shows the problem as far as known, and the issues."""
    extra = extra or Extra()
    drawn, left_out = _exhibits(problem, plan)
    part = problem.part if problem is not None else None
    found = aggregate(
        [
            *(part.notes if part is not None else ()),
            *(problem.notes if problem is not None else ()),
            *(plan.issues if plan else ()),
            *(i for op in (plan.operations if plan else ()) for i in op.issues),
            *(proof.issues if proof else ()),
            *extra.issues,
            *left_out,
        ]
    )
    sections: list[Section] = []
    if found:
        sections.append(Section("issues", "Issues", (page_sections.issue_table(_unique(found)),)))
    if extra.pictures:
        shown = tuple(page_sections.picture(picture, title) for title, picture in extra.pictures)
        sections.append(Section("cell", "Cell", shown))
    if problem is not None and plan is not None and proof is not None and proof.surfaces:
        faces = page_sections.face_figures(problem, plan, proof)
        sections.append(Section("part", "Simulated part against the wanted one", faces))
    sections += drawn
    if problem is not None and plan is not None and plan.operations:
        motion = motion_charts.motion_series(problem, plan, proof)
        sections += _motion(problem, motion, proof)
        if extra.maps:
            sections.append(Section("maps", "Maps of freedoms", tuple(map(freedom_map.figure, extra.maps))))
        sections.append(Section("setup", "Setup sheet", (setup_sheet.sheet(problem, plan, proof),)))
    if proof is not None and proof.rules:
        rules = page_sections.rules(proof.rules)
        sections.append(Section("proof", "Proof from the programs' text", rules))
    sections += _background(plan, extra)
    title = problem.name if problem is not None else "Problem"
    return markup.page(
        markup.Page(
            f"{title} – Tandem report",
            problem.name if problem is not None else "The problem was refused",
            page_sections.verdicts(plan, proof, has_errors(found), accepted(found)),
            page_sections.about(problem) if problem is not None else None,
            page_sections.tiles(problem, plan, proof) if plan is not None and problem is not None else (),
            tuple(sections),
        )
    )


def _unique(issues: Sequence[Issue]) -> list[Issue]:
    """Issues that say the same once: a plan repeats those of its operations."""
    return list(dict.fromkeys(issues))


def _exhibits(problem: Problem | None, plan: Plan | None) -> tuple[list[Section], list[Issue]]:
    sections: list[Section] = []
    left_out: list[Issue] = []
    for index, operation in enumerate(plan.operations if plan else ()):
        stock = problem.setup_of(index).stock if problem is not None else None
        corners = np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 1.0]])
        block = corners if stock is None else np.array([stock.lower, stock.upper])
        figures, issues = exhibits.draw(operation.targets.exhibits, block)
        left_out += issues
        title = "Process" if plan is None or len(plan.operations) == 1 else f"Process: {operation.name}"
        wide = tuple(figure for figure in figures if isinstance(figure, markup.Wide))
        small = tuple(figure for figure in figures if not isinstance(figure, markup.Wide))
        content: tuple[Block, ...] = (*wide, markup.Grid(small)) if small else wide
        sections.append(Section(f"process{index}", title, content))
    return sections, left_out


def _motion(problem: Problem, motion: Motion, proof: Proof | None) -> list[Section]:
    settings = problem.settings
    figures = [motion_charts.feed(motion)] if len(motion.feed.time) > 1 else []
    if motion.clearance is not None:
        figures.append(motion_charts.clearance(motion.clearance, motion, settings))
    if motion.own_clearance is not None:
        figures.append(motion_charts.own_clearance(motion.own_clearance, motion, settings))
    for process in motion.processes:
        figures += motion_charts.drawn(process.distances, motion)
    figures += motion_charts.margins(motion, settings, proof) if motion.arms else []
    for process in motion.processes:
        figures += motion_charts.drawn(process.charts, motion)
    for name, arm in motion.arms.items():
        figures += motion_charts.speeds(name, arm, motion, settings)
    pairs = motion_charts.closest_pairs(motion.clearance) if motion.clearance is not None else ()
    words = f"Joint motion: {motion.source}. Tinted stretches are segments."
    content: tuple[Block, ...] = (markup.Grid(tuple(figures)), *pairs, markup.Paragraph(words, "note"))
    rows: list[Block] = []
    for name, arm in motion.arms.items():
        rows.append(markup.Heading(f"{name}: {arm.robot.title}"))
        rows.append(markup.Grid(tuple(motion_charts.joints(name, arm, motion)), "three"))
    return [Section("motion", "Motion", content), Section("joints", "Joint angles and limits", tuple(rows))]


def _background(plan: Plan | None, extra: Extra) -> list[Section]:
    out = []
    if plan is not None:
        out.append(Section("placement", "Search for a place", page_sections.placement_figures(plan)))
        made = page_sections.how_it_was_made(plan, extra.programs)
        out.append(Section("times", "How the plan was made", (made,)))
    if extra.filtered:
        rows = markup.table(("body", "body", "why the two are not held apart"), extra.filtered)
        summary = (
            f"{len(extra.filtered)} pairs of bodies are not held apart, or some of their solids are not; "
            "every other pair is"
        )
        out.append(Section("filter", "Collision filter", (markup.Folded(summary, rows),)))
    return out


def pictures(problem: Problem, plan: Plan) -> Iterator[tuple[str, Picture]]:
    """The pictures of the cell that the report shows, with their titles."""
    yield from cell_picture.setup_pictures(cell_model(problem, plan), problem, plan)


def files(
    problem: Problem, plan: Plan, proof: Proof | None, drawn: Sequence[tuple[str, Picture]] | None = None
) -> dict[str, str]:
    """What :func:`pages` and :func:`proof_files` make, by name."""
    return pages(problem, plan, proof, drawn) | proof_files(plan, proof)


def proof_files(plan: Plan, proof: Proof | None, programs: Mapping[str, str] | None = None) -> dict[str, str]:
    """With a proof ``proof.json``, which names the SHA-256 of each of the proven ``programs``, and
    ``simulated_part.obj``, by name."""
    out: dict[str, str] = {}
    if proof is not None:
        texts = (programs or {}).items()
        digests = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts}
        out["proof.json"] = proof_text(proof, accepted(plan.issues), digests)
        if proof.part_obj:
            out["simulated_part.obj"] = proof.part_obj
    return out


def pages(
    problem: Problem,
    plan: Plan,
    proof: Proof | None,
    drawn: Sequence[tuple[str, Picture]] | None = None,
    maps: Sequence[FreedomMap] = (),
) -> dict[str, str]:
    """``report.html`` and ``replay.html``, by name.

    ``drawn``: what :func:`pictures` gives, where that is done already; ``maps`` of freedoms to show.
    """
    model = cell_model(problem, plan)
    if drawn is None:
        drawn = cell_picture.setup_pictures(model, problem, plan)
    return {
        "replay.html": replay.document(model, problem, plan, proof),
        "report.html": render(problem, plan, proof, Extra(drawn, model.pairs_filtered, maps=maps)),
    }


def cell_model(problem: Problem, plan: Plan, setup: Setup | None = None) -> CellModel:
    """The cell's model as a setup finds it, the first one where none is given."""
    own = setup or problem.setups[0]
    return plant.build(own.cell, own.stock, plan.places[own.number - 1], plan.bases)


def show(problem: Problem, plan: Plan, proof: Proof | None = None) -> Viewer:
    """The replay as a page, served on this machine."""
    return replay.show(cell_model(problem, plan), problem, plan, proof)


def failure(problem: Problem | None, issues: Sequence[Issue]) -> str:
    """The report alone, for a problem that was refused or has no plan."""
    shown: tuple[tuple[str, Picture], ...] = ()
    filtered: Sequence[tuple[str, str, str]] = ()
    if problem is not None:
        place = problem.stock.place
        standing = np.eye(4)
        standing[:3, :3] = problem.stock.attitude
        try:
            model = plant.build(problem.cell, problem.stock, standing if place is None else place)
        except TandemError as error:
            issues = [*issues, *(i for i in error.issues if i not in issues)]
        else:
            shown = cell_picture.setup_pictures(model, problem, None)
            filtered = model.pairs_filtered
    return render(problem, None, None, Extra(shown, filtered, issues=issues))


def accepted_of(text: str) -> list[str]:
    """What a ``proof.json`` says is accepted; nothing where it is none."""
    try:
        found = json.loads(text)["accepted"]
    except (ValueError, KeyError, TypeError):
        return []
    return [str(code) for code in found] if isinstance(found, list) else []


def proof_text(proof: Proof, taken: Sequence[str], digests: Mapping[str, str]) -> str:
    """The proof as JSON: verdict, what the problem accepts beside it, SHA-256 of the proven program files by
    name, rules, issues, faces without their points."""
    faces = [
        {"segment": face.title, **{k: v for k, v in vars(face).items() if isinstance(v, float)}}
        for face in proof.surfaces
    ]
    found = aggregate(proof.issues)
    data = {
        "ok": proof.ok and not has_errors(found),
        "accepted": list(taken),
        "problem_digest": proof.problem_digest,
        "programs": dict(digests),
        "rules": [dataclasses.asdict(rule) for rule in proof.rules],
        "issues": [issue.to_dict() for issue in found],
        "surfaces": faces,
    }
    return json.dumps(_plain(data), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    """Plain data for JSON: tuples as lists, NumPy's numbers as Python's, numbers that JSON lacks as None."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value
