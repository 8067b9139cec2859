"""``tandem next-loop`` and ``simulate-loop``: springback corrected from level to level.

``tandem next-loop OUT --forces CSV``: offsets of the next level from forces that were measured.
``tandem simulate-loop OUT --plant FILE``: the same loop against sheets whose truth is known.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.table import Table

from planner.cli.console import plain_out as out
from planner.cli.console import require_suffix, write_output
from planner.files import csv_text
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError, refusal

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.loops.job_border import JobBorder
    from planner.loops.loop_plan import LoopPlan
    from planner.loops.next_loop import Law, Offsets
    from planner.loops.simulate import Run
    from planner.reading.forces_file import Measured

CURVES = "springback.json"
"""Where curves stand in a result folder, unless a file is named."""
LEAST_KAPPA, MOST_KAPPA = 0.2, 5.0
"""Springback of a sheet over that of the model: beyond, it was not measured in mm, or of another sheet."""
LIFTS_SHOWN = 8
"""Lifts of a picture at most."""
MOST_SHEETS = 10_000
"""Sheets of a simulation at most."""
MOST_SEED = 1_000_000_000
"""Seed of the first sheet at most."""


@dataclasses.dataclass(frozen=True)
class LawOptions:
    """How the loop corrects."""

    springback: Path | None = None
    """curves of the part, by `tandem springback PROBLEM --curves FILE`; else OUT/springback.json"""
    pass_name: str | None = None
    """which pass; else the first"""
    rule: Literal["model", "held", "half", "linear"] = "model"
    """how the next force is foretold: the expected one scaled by what was measured; the last one; half of the
    way on a line (the dissertation's rule); all of it"""
    every: int = 1
    """levels of one action"""
    gain: float = 1.0
    """share of springback that is corrected"""
    weight: float = 0.7
    """of the last action in the mean of rule model"""
    feed_forward: bool = True
    """correct the first levels by the force that is expected"""
    slope: float = 0.05
    """change of the offset along the path at most, mm per mm"""
    most_mm: float = 10.0
    """offset at most"""
    stiffness_n_mm: float | None = None
    """of the robot with its tool along z, to correct its deflection too; not where its controller does so"""
    model_error: float = 0.05
    """by how much the model's springback may be above that of the sheet"""


@dataclasses.dataclass(frozen=True)
class NextLoop:
    """Offsets of the next level, from the forces that were measured on the levels so far."""

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    law: tyro.conf.OmitArgPrefixes[LawOptions]
    forces: Path | None = None
    """CSV: level, point, force_n, and springback_mm where the tool was lifted; none before the first level"""
    kappa: float | None = None
    """springback of the sheet over that of the model; else from the lifts in the file, else 1"""
    before_mm: float | None = None
    """the offset at which the level before ends, with what a springback file adds; this one goes on from
    there within the slope"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """offsets along the level's path, .csv or .json; .html: lifts over the curves, the map of stability"""
    problem: Path | None = None
    """the level as a problem of its own, .yaml: `tandem plan` writes and proves its programs"""


def run_next_loop(request: NextLoop) -> tuple[Issue, ...]:
    """Work out, print and write; warnings come back. Raises `TandemError`."""
    import numpy as np

    from planner.loops import next_loop
    from planner.loops.job_border import job_border, require_settling
    from planner.reading.forces_file import Measured, read_forces

    require_suffix(request.output, "a file is .csv, .json, .html", (".csv", ".json", ".html"))
    plan, law = _plan(request.folder, request.law), _law(request.law)
    if request.kappa is not None and not LEAST_KAPPA <= request.kappa <= MOST_KAPPA:
        raise TandemError(_out_of_range("kappa", request.kappa, f"{LEAST_KAPPA:g} to {MOST_KAPPA:g}"))
    if request.before_mm is not None and not 0.0 <= request.before_mm <= request.law.most_mm:
        what = f"0 to {request.law.most_mm:g}, as most_mm has it"
        raise TandemError(_out_of_range("before_mm", request.before_mm, what))
    measured = Measured((), ()) if request.forces is None else read_forces(request.forces, [plan.asked])[0]
    number = len(measured.force)
    if number >= len(plan.levels):
        what = f"got forces of all {number} levels of {plan.name}: there is no next one"
        raise refusal("forming.loop_forces", what, field="level", hint="leave out the last level")
    if number == 0 and request.before_mm:
        raise TandemError(_out_of_range("before_mm", request.before_mm, "0 for level 0: none is before it"))
    alone = request.problem is not None and request.output is None  # a level without the file
    file, already = ("", None) if alone else _deeper(request.folder, plan, number)
    begin = time.perf_counter()
    kappa = _kappa(plan, measured) if request.kappa is None else request.kappa
    found = job_border(plan, law, kappa, request.law.model_error)
    require_settling(found, law)
    before = None if request.before_mm is None else np.asarray(request.before_mm * MM)
    told = next_loop.offsets(plan, law, number, measured.force, kappa, before, already)
    seconds = time.perf_counter() - begin
    _print_offsets(plan, number, told, kappa, found, seconds)
    issues = _cut(plan, law, number, told)
    if already is not None:
        out.print(
            f"the plan goes {already.min() / MM:.3f} to {already.max() / MM:.3f} mm deeper on this level "
            f"by {file}: offsets are what is wanted less that",
            markup=False,
        )
    if request.output is not None:
        kind = request.output.suffix.lower()
        made = {".csv": _csv, ".json": _json}.get(kind)
        if made is None:
            text = _map_page(plan, law, found, measured, kappa)
        else:
            text = made(plan, number, told, kappa, already)
        write_output(request.output, text)
    if request.problem is not None:
        from planner import pipeline
        from planner.cli.next_level import write_level

        whole = pipeline.load_result(request.folder)
        # where a level begins is for the level's own path to say, which is no closed loop
        free = next_loop.offsets(plan, law, number, measured.force, kappa)
        path = write_level(request.problem, whole, plan, number, free, law, kappa, request.before_mm)
        out.print(f"written to {path}; next: tandem plan {path} -o FOLDER")
    return tuple(issues)


def _plan(folder: Path, options: LawOptions) -> LoopPlan:
    """The pass of a result folder. Raises `TandemError`: forming.loop_curves also where curves are another
    problem's."""
    from planner import pipeline
    from planner.loops.loop_plan import read_plan

    file = folder / CURVES if options.springback is None else options.springback
    plan = read_plan(file, options.pass_name)
    digest = pipeline.load_result(folder).digest
    if plan.digest != digest:
        what = f"{file} has curves of the problem {plan.digest[:12]}, {folder} is planned for {digest[:12]}"
        hint = f"write them for this one: tandem springback {folder}/problem/problem.yaml --curves {file}"
        raise refusal("forming.loop_curves", what, file=str(file), field="digest", hint=hint)
    return plan


def _deeper(folder: Path, plan: LoopPlan, number: int) -> tuple[str, FloatArray | None]:
    """The springback file of a plan, and by how much (K,) [m] its tools go deeper by that at the places of a
    level; none where there is none. Raises `TandemError`: forming.loop_curves where the path of the curves is
    another, what files are refused for."""
    from planner import pipeline
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.process_plan import lay_all
    from planner.processes.forming.plan.springback.levels import shifts

    whole = pipeline.load_result(folder)
    if all(getattr(one, "springback", None) is None for one in whole.operations):
        return "", None
    for job in registry.jobs(whole):
        given = job.compensated() if isinstance(job, FormingJob) else None
        if given is None or not isinstance(job, FormingJob):
            continue
        ways = {way.name: way for way in given.ways}
        for one, path in lay_all(job.planned):
            if one.name != plan.name or one.name not in ways:
                continue
            levels = shifts(one, path, ways[one.name])
            if [len(row) for row in levels] == [len(level.path) for level in plan.levels]:
                return given.file, levels[number]
    what = (
        f"{folder} goes deeper by a springback file, whose loops in {plan.name} are not those of the curves"
    )
    hint = f"write curves again: tandem springback {folder}/problem/problem.yaml --curves FILE"
    raise refusal("forming.loop_curves", what, field="springback", hint=hint)


def _law(options: LawOptions) -> Law:
    from planner.loops.next_loop import Law

    for name, value, low, high in (
        ("every", options.every, 1, 1000),
        ("gain", options.gain, 0.0, 5.0),
        ("weight", options.weight, 0.01, 1.0),
        ("slope", options.slope, 1e-4, 1.0),
        ("most_mm", options.most_mm, 0.0, 100.0),
        ("stiffness_n_mm", options.stiffness_n_mm, 1.0, 1e6),
        ("model_error", options.model_error, 0.0, 1.0),
    ):
        if value is not None and not low <= value <= high:
            raise TandemError(_out_of_range(name, value, f"{low:g} to {high:g}"))
    stiffness = float("inf") if options.stiffness_n_mm is None else options.stiffness_n_mm / MM
    return Law(
        rule=options.rule,
        every=options.every,
        gain=options.gain,
        weight=options.weight,
        feed_forward=options.feed_forward,
        slope=options.slope,
        most=options.most_mm * MM,
        stiffness=stiffness,
    )


def _out_of_range(name: str, value: float, allowed: str) -> Issue:
    return Issue("forming.loop_law", f"got {value:g}, allowed {allowed}", field=name, hint="correct it")


def _kappa(plan: LoopPlan, measured: Any) -> float:
    """Springback of the sheet over that of the model, by the lifts of a file. Raises ``TandemError``
    (forming.loop_forces) where a lift is far from what the model says."""
    import numpy as np

    from planner.loops import next_loop

    lifts, models = [np.empty(0)], [np.empty(0)]
    for number, (level, force, lift) in enumerate(
        zip(plan.levels, measured.force, measured.lift, strict=False)
    ):
        some = np.flatnonzero(np.isfinite(lift))
        model = next_loop.springback(level, np.minimum(force, level.loads[:, -1]))
        for k in some:
            if not LEAST_KAPPA * model[k] <= lift[k] <= MOST_KAPPA * model[k]:
                what = (
                    f"level {number}, point {k}: got {lift[k] / MM:g} mm for the tool's lift, allowed "
                    f"{LEAST_KAPPA * model[k] / MM:.3f} to {MOST_KAPPA * model[k] / MM:.3f} mm: the model "
                    f"says {model[k] / MM:.3f} mm under {force[k]:.0f} N"
                )
                hint = "give how far the sheet came back, in mm; or leave the cell empty"
                raise refusal("forming.loop_forces", what, field="springback_mm", hint=hint)
        lifts.append(lift[some])
        models.append(model[some])
    return float(next_loop.kappa(np.concatenate(lifts), np.concatenate(models)))


def _print_offsets(
    plan: LoopPlan, number: int, told: Offsets, kappa: float, found: JobBorder, seconds: float
) -> None:
    level = plan.levels[number]
    table = Table("point", "x mm", "y mm", "z mm", "force N", "springback mm", "offset mm")
    rows = range(len(level.place))
    for k in rows[:: max(1, len(rows) // 24)]:
        x, y, z = level.path[level.place[k]] / MM
        table.add_row(
            str(k),
            *(f"{value:.2f}" for value in (x, y, z)),
            f"{told.force[k]:.0f}",
            f"{kappa * told.springback[k] / MM:.3f}",
            f"{told.offset[level.place[k]] / MM:.3f}",
        )
    out.print(table)
    worst = found.worst
    out.print(
        f"{plan.name}: level {number} of {len(plan.levels)}, {len(level.path)} places; kappa {kappa:.3f}; "
        f"q {found.ratio:.2f}, border {found.border[worst]:.2f} at gamma {found.gamma[worst]:.2f}; "
        f"{1e3 * seconds:.0f} ms"
    )


def _csv(plan: LoopPlan, number: int, told: Offsets, kappa: float, already: FloatArray | None = None) -> str:
    del kappa
    deeper = [] if already is None else ["file_mm"]
    rows: list[list[object]] = [["level", "place", "x_mm", "y_mm", "z_mm", "offset_mm", *deeper]]
    for k, (point, offset) in enumerate(zip(plan.levels[number].path, told.offset, strict=True)):
        by_file = [] if already is None else [f"{already[k] / MM:.4f}"]
        rows.append([number, k, *(f"{value:.3f}" for value in point / MM), f"{offset / MM:.4f}", *by_file])
    return csv_text(rows)


def _json(plan: LoopPlan, number: int, told: Offsets, kappa: float, already: FloatArray | None = None) -> str:
    level = plan.levels[number]
    by_file = (
        [{}] * len(level.path) if already is None else [{"file_mm": round(float(s) / MM, 4)} for s in already]
    )
    data = {
        "tandem_offsets": 1,
        "digest": plan.digest,
        "pass": plan.name,
        "level": number,
        "way": [0, 0, -plan.side],
        "kappa": round(kappa, 4),
        "points": [
            {"point": k, "force_n": round(float(n), 2), "springback_mm": round(float(kappa * s) / MM, 4)}
            for k, (n, s) in enumerate(zip(told.force, told.springback, strict=True))
        ],
        "places": [
            {
                "xyz_mm": [round(float(v), 3) for v in point / MM],
                "offset_mm": round(float(value) / MM, 4),
                **deeper,
            }
            for point, value, deeper in zip(level.path, told.offset, by_file, strict=True)
        ],
    }
    return json.dumps(data, indent=1) + "\n"


def _cut(plan: LoopPlan, law: Law, number: int, told: Offsets) -> list[Issue]:
    if not told.clipped:
        return []
    level = plan.levels[number]
    over = float((told.force - level.loads[:, -1]).max())
    if over > 0.0:
        what = (
            f"level {number}: {told.force.max():.0f} N are foretold, curves end {over:.0f} N below; "
            "springback is that of their ends"
        )
        hint = "see to the force sensor, or state the force in the problem (force_n) and write curves again"
    else:
        what = f"level {number}: offsets were cut to 0 to {law.most / MM:g} mm"
        hint = "allow more (most_mm), if the cell and the controller do"
    return [Issue("forming.loop_range", what, Severity.WARNING, field="most_mm", hint=hint)]


def _map_page(plan: LoopPlan, law: Law, found: JobBorder, measured: Measured, kappa: float) -> str:
    from planner.loops.job_border import map_exhibit

    shown = {"lifts": _lifts(plan, measured, kappa), "map": map_exhibit(found, law)}
    return _page(f"Springback loop of pass {plan.name}", {k: one for k, one in shown.items() if one})


def _lifts(plan: LoopPlan, measured: Measured, kappa: float) -> dict[str, Any]:
    """What lifts of the tool have shown, over the curves of their points, some of them; nothing without
    one."""
    import numpy as np

    from planner.geometry.arrays import spread_rows
    from planner.loops.next_loop import springback

    made = [
        (number, int(k)) for number, row in enumerate(measured.lift) for k in np.flatnonzero(np.isfinite(row))
    ]
    chosen = spread_rows(len(made), LIFTS_SHOWN)
    series: list[dict[str, Any]] = []
    for colour, (number, k) in enumerate(made[i] for i in chosen):
        level = plan.levels[number]
        x = np.linspace(0.0, float(level.loads[k, -1]), 60)
        model = np.array([springback(level, np.full(len(level.place), n))[k] for n in x])
        rows = (
            (x, model, ""),
            (x, kappa * model, "dashed"),
            (measured.force[number][[k]], measured.lift[number][[k]], "dots"),
        )
        name = f"level {number}, point {k}"
        series += [
            {"name": name, "x": n, "y": s / MM, "colour": colour, "style": style} for n, s, style in rows
        ]
    return (
        {}
        if not series
        else {
            "kind": "curve",
            "title": "Springback over force, and what lifts have shown",
            "note": f"lines: the model; dashed: times kappa {kappa:.3f}; dots: lifts of the tool",
            "x_label": "force along z [N]",
            "y_label": "springback [mm]",
            "series": tuple(series),
        }
    )


def _page(title: str, shown: dict[str, Any]) -> str:
    from planner.report import exhibits

    about = "Where the loop settles, by the model's springback and forces."
    return exhibits.page(title, ("loop", "Loop from level to level"), shown, about)


@dataclasses.dataclass(frozen=True)
class SimulateLoop:
    """The loop against sheets whose springback, force and robots are known: what is left, and when it swings.

    Without correction, by the dissertation's rule, and by yours."""

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    law: tyro.conf.OmitArgPrefixes[LawOptions]
    plant: Path
    """sheets and robots, YAML"""
    sheets: int = 100
    """sheets that are formed"""
    seed: int = 0
    """of the first sheet"""
    lifts_mm: tuple[float, ...] = ()
    """depths at which the tool is lifted, which measures kappa; the first ones early, as 1 2 5 10 15"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page: errors over depth, the map of stability"""


def run_simulate_loop(request: SimulateLoop) -> tuple[Issue, ...]:
    """Form, print and write; warnings come back. Raises `TandemError`."""
    from planner.loops.job_border import job_border, require_settling
    from planner.loops.next_loop import Law
    from planner.loops.plant import read_plant
    from planner.loops.simulate import run

    require_suffix(request.output, "a file is .html", (".html",))
    if not 1 <= request.sheets <= MOST_SHEETS:
        raise TandemError(_out_of_range("sheets", request.sheets, f"1 to {MOST_SHEETS}"))
    if not 0 <= request.seed <= MOST_SEED:
        raise TandemError(_out_of_range("seed", request.seed, f"0 to {MOST_SEED}"))
    plant = read_plant(request.plant)
    plan, law = _plan(request.folder, request.law), _law(request.law)
    found = job_border(plan, law, model_error=request.law.model_error)
    require_settling(found, law)
    deepest = plan.levels[-1].depth
    for lift in request.lifts_mm:
        if not 0.0 < lift * MM <= deepest:
            raise TandemError(_out_of_range("lifts_mm", lift, f"above 0, {deepest / MM:g} at most"))
    depth = deepest / len(plan.levels)
    seeds = [request.seed + k for k in range(request.sheets)]
    half = Law(rule="half", every=max(1, round(MM / depth)), feed_forward=False)
    runs = {
        "not corrected": run(plan, plant, None, seeds),
        _named(half): run(plan, plant, half, seeds),
        f"yours: {_named(law)}": run(plan, plant, law, seeds, [lift * MM for lift in request.lifts_mm]),
    }
    table = Table("loop", "largest mm", "95 % of sheets", "mean mm", "95 % of sheets", "at depth mm")
    for name, one in runs.items():
        table.add_row(name, *_figures(one))
    out.print(table)
    worst = found.worst
    out.print(
        f"{request.sheets} sheets of {plant.name}, errors below 2 mm of depth; q {found.ratio:.2f}, border "
        f"{found.border[worst]:.2f} at gamma {found.gamma[worst]:.2f}"
    )
    if request.output is not None:
        from planner.loops.job_border import map_exhibit

        shown = {"errors": _errors(runs), "map": map_exhibit(found, law)}
        write_output(request.output, _page(f"Simulated springback loop of pass {plan.name}", shown))
    return ()


def _named(law: Law) -> str:
    return f"rule {law.rule}, each {'level' if law.every == 1 else f'{law.every} levels'}"


def _figures(one: Run) -> tuple[str, ...]:
    import numpy as np

    largest, mean = one.largest() / MM, one.mean() / MM
    row: Sequence[FloatArray | float] = (
        largest.mean(),
        float(np.quantile(largest, 0.95)),
        mean.mean(),
        float(np.quantile(mean, 0.95)),
        one.at_depth().mean() / MM,
    )
    return tuple(f"{value:.2f}" for value in row)


def _errors(runs: dict[str, Run]) -> dict[str, Any]:
    import numpy as np

    some = next(iter(runs.values()))
    series = [{"name": name, "y": np.abs(one.error).mean(axis=(0, 2)) / MM} for name, one in runs.items()]
    return {
        "kind": "curve",
        "title": "Mean error of the released part over depth",
        "x": some.depth / MM,
        "x_label": "depth [mm]",
        "y_label": "error [mm]",
        "series": tuple(series),
    }
