"""``tandem next-loop`` and ``simulate-loop``: springback correction from level to level.

``tandem next-loop OUT --forces CSV``: offsets of the next level from measured forces. ``tandem simulate-loop
OUT --plant FILE``: the same loop on sheets with known properties.
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
from planner.files import format_csv
from planner.geometry.units import MM
from planner.issues import Issue, Severity, TandemError, issue_error

if TYPE_CHECKING:
    from planner.geometry.arrays import FloatArray
    from planner.loops.job_stability import JobStability
    from planner.loops.level_correction import CorrectionLaw, LevelCorrection
    from planner.loops.loop_plan import LoopPlan
    from planner.loops.simulate import LoopRun
    from planner.reading.forces_file import MeasuredForces

CURVES_FILE = "springback.json"
"""Default file name of curves in a result folder."""
MIN_KAPPA, MAX_KAPPA = 0.2, 5.0
"""Allowed ratio of the springback of a sheet to that of the model. Beyond it, the sheet was not measured in
mm, or it is another one.
"""
MAX_SHOWN_LIFTS = 8
"""Maximum number of lifts in a picture."""
MAX_SHEETS = 10_000
"""Maximum number of sheets of a simulation."""
MAX_SEED = 1_000_000_000
"""Maximum seed of the first sheet."""


@dataclasses.dataclass(frozen=True)
class LawOptions:
    """Options of the correction law."""

    springback: Path | None = None
    """curves of the part, by `tandem springback PROBLEM --curves FILE`; else OUT/springback.json"""
    pass_name: str | None = None
    """name of the pass; else the first"""
    rule: Literal["model", "held", "half", "linear"] = "model"
    """how the next force is predicted: the expected one scaled by measurements; the last one; halfway along a
    line (the rule of the dissertation); fully along it
    """
    every: int = 1
    """number of levels per action"""
    gain: float = 1.0
    """fraction of the springback that is corrected"""
    weight: float = 0.7
    """weight of the last action in the mean of rule model"""
    feed_forward: bool = True
    """correct the first levels by the expected force"""
    slope: float = 0.05
    """maximum change of the offset along the path, mm per mm"""
    most_mm: float = 10.0
    """maximum offset"""
    stiffness_n_mm: float | None = None
    """stiffness of the robot with its tool along z, to correct its deflection too; not if its controller does
    so
    """
    model_error: float = 0.05
    """maximum relative excess of the model's springback over that of the sheet"""


@dataclasses.dataclass(frozen=True)
class NextLoop:
    """Compute offsets of the next level from the forces that were measured on the levels so far."""

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    law: tyro.conf.OmitArgPrefixes[LawOptions]
    forces: Path | None = None
    """CSV: level, point, force_n, and springback_mm where the tool was lifted; none before the first level"""
    kappa: float | None = None
    """ratio of the springback of the sheet to that of the model; else from the lifts in the file, else 1"""
    before_mm: float | None = None
    """the offset at which the previous level ends, including a springback file; this level continues from
    there within the slope
    """
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """offsets along the path of the level, .csv or .json; .html: lifts over the curves, the stability map"""
    problem: Path | None = None
    """the level as its own problem, .yaml: `tandem plan` writes and proves its programs"""


def run_next_loop(request: NextLoop) -> tuple[Issue, ...]:
    """Compute the offsets of the next level from measured forces, print them and write the requested files.

    Returns:
        Warnings.

    Raises:
        TandemError: Options, curves or forces are not usable.
    """
    import numpy as np

    from planner.loops import level_correction
    from planner.loops.job_stability import job_stability, require_stability
    from planner.reading.forces_file import MeasuredForces, read_forces

    require_suffix(request.output, "a file is .csv, .json, .html", (".csv", ".json", ".html"))
    plan, law = _read_plan(request.folder, request.law), _make_law(request.law)
    if request.kappa is not None and not MIN_KAPPA <= request.kappa <= MAX_KAPPA:
        raise TandemError(_out_of_range("kappa", request.kappa, f"{MIN_KAPPA:g} to {MAX_KAPPA:g}"))
    if request.before_mm is not None and not 0.0 <= request.before_mm <= request.law.most_mm:
        message = f"0 to {request.law.most_mm:g}, as most_mm has it"
        raise TandemError(_out_of_range("before_mm", request.before_mm, message))
    measured = (
        MeasuredForces((), ())
        if request.forces is None
        else read_forces(request.forces, [plan.expected_forces])[0]
    )
    number = len(measured.force)
    if number >= len(plan.levels):
        message = f"got forces of all {number} levels of {plan.name}, so there is no next level"
        raise issue_error("forming.loop_forces", message, field="level", hint="leave out the last level")
    if number == 0 and request.before_mm:
        raise TandemError(_out_of_range("before_mm", request.before_mm, "0 for level 0, the first one"))
    is_problem_only = (
        request.problem is not None and request.output is None
    )  # the level ignores the springback file
    file_name, file_shift = (
        ("", None) if is_problem_only else _springback_file_shift(request.folder, plan, number)
    )
    start = time.perf_counter()
    kappa = _measured_kappa(plan, measured) if request.kappa is None else request.kappa
    border = job_stability(plan, law, kappa, request.law.model_error)
    require_stability(border, law)
    previous_shift = None if request.before_mm is None else np.asarray(request.before_mm * MM)
    path_offsets = level_correction.PathOffsets(previous_shift, file_shift)
    offsets = level_correction.level_correction(plan, law, number, measured.force, kappa, path_offsets)
    seconds = time.perf_counter() - start
    _print_offsets(plan, number, offsets, kappa, border, seconds)
    issues = _limited_offset_issues(plan, law, number, offsets)
    if file_shift is not None:
        out.print(
            f"the plan goes {file_shift.min() / MM:.3f} to {file_shift.max() / MM:.3f} mm deeper on this "
            f"level by {file_name}: offsets are the required shifts minus that",
            markup=False,
        )
    if request.output is not None:
        suffix = request.output.suffix.lower()
        writer = {".csv": _offsets_csv, ".json": _offsets_json}.get(suffix)
        if writer is None:
            text = _map_page(plan, law, border, measured, kappa)
        else:
            text = writer(plan, number, offsets, kappa, file_shift)
        write_output(request.output, text)
    if request.problem is not None:
        from planner import pipeline
        from planner.cli.next_level import CorrectedLevel, write_level

        planned_problem = pipeline.load_result(request.folder)
        # the level's own path, which is not a closed loop, determines the shift at its start
        free_offsets = level_correction.level_correction(plan, law, number, measured.force, kappa)
        level = CorrectedLevel(plan, number, free_offsets, law, kappa, request.before_mm)
        path = write_level(request.problem, planned_problem, level)
        out.print(f"written to {path}; next: tandem plan {path} -o FOLDER")
    return tuple(issues)


def _read_plan(folder: Path, options: LawOptions) -> LoopPlan:
    """Read the pass of a result folder with its springback curves.

    Raises:
        TandemError: ``forming.loop_curves``, also if the curves belong to another problem.
    """
    from planner import pipeline
    from planner.loops.loop_plan import read_loop_plan

    file = folder / CURVES_FILE if options.springback is None else options.springback
    plan = read_loop_plan(file, options.pass_name)
    digest = pipeline.load_result(folder).digest
    if plan.digest != digest:
        message = f"{file} has curves of problem {plan.digest[:12]}, {folder} is a plan of {digest[:12]}"
        hint = f"write them for this one: tandem springback {folder}/problem/problem.yaml --curves {file}"
        raise issue_error("forming.loop_curves", message, file=str(file), field="digest", hint=hint)
    return plan


def _springback_file_shift(folder: Path, plan: LoopPlan, number: int) -> tuple[str, FloatArray | None]:
    """Return the springback file that a plan uses, and the shift of the tools on a level.

    Args:
        folder: Result folder.
        plan: Pass with its curves.
        number: Index of the level.

    Returns:
        Name of the file, and shift (K,) [m] at the points of the level. Without a file, an empty name and
        None.

    Raises:
        TandemError: The path of the curves differs (``forming.loop_curves``), or a file is refused.
    """
    from planner import pipeline
    from planner.processes import registry
    from planner.processes.forming.plan.job import FormingJob
    from planner.processes.forming.plan.process_plan import make_tool_paths
    from planner.processes.forming.plan.springback.levels import level_shifts

    problem = pipeline.load_result(folder)
    if all(getattr(pass_plan, "springback", None) is None for pass_plan in problem.operations):
        return "", None
    for job in registry.jobs(problem):
        compensation = job.read_compensation() if isinstance(job, FormingJob) else None
        if compensation is None or not isinstance(job, FormingJob):
            continue
        paths_by_name = {tool_path.name: tool_path for tool_path in compensation.paths}
        for pass_plan, path in make_tool_paths(job.planned):
            if pass_plan.name != plan.name or pass_plan.name not in paths_by_name:
                continue
            levels = level_shifts(pass_plan, path, paths_by_name[pass_plan.name])
            if [len(shifts) for shifts in levels] == [len(level.path) for level in plan.levels]:
                return compensation.file, levels[number]
    message = f"{folder} uses a springback file, whose loops in {plan.name} differ from those of the curves"
    hint = f"write the curves again: tandem springback {folder}/problem/problem.yaml --curves FILE"
    raise issue_error("forming.loop_curves", message, field="springback", hint=hint)


def _make_law(options: LawOptions) -> CorrectionLaw:
    """Check the options of the correction law, and convert them to SI units."""
    from planner.loops.level_correction import CorrectionLaw

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
    return CorrectionLaw(
        rule=options.rule,
        every=options.every,
        gain=options.gain,
        weight=options.weight,
        feed_forward=options.feed_forward,
        slope=options.slope,
        max_offset=options.most_mm * MM,
        stiffness=stiffness,
    )


def _out_of_range(name: str, value: float, allowed: str) -> Issue:
    return Issue("forming.loop_law", f"got {value:g}, allowed {allowed}", field=name, hint="correct it")


def _measured_kappa(plan: LoopPlan, measured: Any) -> float:
    """Estimate kappa, the ratio of the springback of the sheet to that of the model, from lifts of the tool.

    Where the tool was lifted, the springback of the sheet was measured. Elsewhere the measured value is NaN.

    Args:
        plan: Pass with its curves.
        measured: Measured forces and lifts.

    Raises:
        TandemError: ``forming.loop_forces``, a lift is far from the model.
    """
    import numpy as np

    from planner.loops import level_correction

    measured_lifts, models = [np.empty(0)], [np.empty(0)]
    for number, (level, force, lift) in enumerate(
        zip(plan.levels, measured.force, measured.lift, strict=False)
    ):
        lifted_points = np.flatnonzero(np.isfinite(lift))
        model = level_correction.model_springback(level, np.minimum(force, level.loads[:, -1]))
        for point in lifted_points:
            if not MIN_KAPPA * model[point] <= lift[point] <= MAX_KAPPA * model[point]:
                message = (
                    f"level {number}, point {point}: got {lift[point] / MM:g} mm for the tool's lift, "
                    f"allowed {MIN_KAPPA * model[point] / MM:.3f} to {MAX_KAPPA * model[point] / MM:.3f} mm: "
                    f"the model predicts {model[point] / MM:.3f} mm under {force[point]:.0f} N"
                )
                hint = "state the springback of the sheet in mm, or leave the cell empty"
                raise issue_error("forming.loop_forces", message, field="springback_mm", hint=hint)
        measured_lifts.append(lift[lifted_points])
        models.append(model[lifted_points])
    return float(level_correction.springback_ratio(np.concatenate(measured_lifts), np.concatenate(models)))


def _print_offsets(
    plan: LoopPlan, number: int, offsets: LevelCorrection, kappa: float, border: JobStability, seconds: float
) -> None:
    """Print force, springback and offset at some control points of a level, and how stable the loop is.

    ``seconds`` [s] is the time of the computation.
    """
    level = plan.levels[number]
    table = Table("point", "x mm", "y mm", "z mm", "force N", "springback mm", "offset mm")
    point_indices = range(len(level.path_index))
    for point in point_indices[:: max(1, len(point_indices) // 24)]:
        x, y, z = level.path[level.path_index[point]] / MM
        table.add_row(
            str(point),
            *(f"{value:.2f}" for value in (x, y, z)),
            f"{offsets.force[point]:.0f}",
            f"{kappa * offsets.springback[point] / MM:.3f}",
            f"{offsets.offset[level.path_index[point]] / MM:.3f}",
        )
    out.print(table)
    worst_level = border.worst_level
    out.print(
        f"{plan.name}: level {number} of {len(plan.levels)}, {len(level.path)} places; kappa {kappa:.3f}; "
        f"q {border.ratio:.2f}, border {border.max_ratio[worst_level]:.2f} "
        f"at gamma {border.gamma[worst_level]:.2f}; {1e3 * seconds:.0f} ms"
    )


def _offsets_csv(
    plan: LoopPlan,
    level_number: int,
    offsets: LevelCorrection,
    kappa: float,
    file_shift: FloatArray | None = None,
) -> str:
    """Return the offsets of a level as CSV, with a row for each of the K positions of its path ("place").

    Args:
        plan: Pass with its levels.
        level_number: Index of the level, from 0.
        offsets: Correction of the level. Its ``offset`` (K,) [m] is positive into the sheet.
        kappa: Ratio of the springback of the sheet to that of the model. Not used: the parameter makes the
            signature that of :func:`_offsets_json`, which reports springback.
        file_shift: Shift (K,) [m] that the plan already has by a springback file, written as ``file_mm``.
            None if the plan does not use such a file.
    """
    del kappa
    file_heading = [] if file_shift is None else ["file_mm"]
    rows: list[list[object]] = [["level", "place", "x_mm", "y_mm", "z_mm", "offset_mm", *file_heading]]
    path = plan.levels[level_number].path
    for index, (position, offset) in enumerate(zip(path, offsets.offset, strict=True)):
        position_cells = [f"{value:.3f}" for value in position / MM]
        file_cells = [] if file_shift is None else [f"{file_shift[index] / MM:.4f}"]
        rows.append([level_number, index, *position_cells, f"{offset / MM:.4f}", *file_cells])
    return format_csv(rows)


def _offsets_json(
    plan: LoopPlan,
    level_number: int,
    offsets: LevelCorrection,
    kappa: float,
    file_shift: FloatArray | None = None,
) -> str:
    """Return the offsets of a level as JSON, with the forces and the springback at its control points.

    The parameters are those of :func:`_offsets_csv`.
    """
    level = plan.levels[level_number]
    file_fields = (
        [{}] * len(level.path)
        if file_shift is None
        else [{"file_mm": round(float(shift) / MM, 4)} for shift in file_shift]
    )
    data = {
        "tandem_offsets": 1,
        "digest": plan.digest,
        "pass": plan.name,
        "level": level_number,
        "way": [0, 0, -plan.side],
        "kappa": round(kappa, 4),
        "points": [
            {
                "point": index,
                "force_n": round(float(force), 2),
                "springback_mm": round(float(kappa * springback) / MM, 4),
            }
            for index, (force, springback) in enumerate(zip(offsets.force, offsets.springback, strict=True))
        ],
        "places": [
            {
                "xyz_mm": [round(float(coordinate), 3) for coordinate in point / MM],
                "offset_mm": round(float(value) / MM, 4),
                **file_field,
            }
            for point, value, file_field in zip(level.path, offsets.offset, file_fields, strict=True)
        ],
    }
    return json.dumps(data, indent=1) + "\n"


def _limited_offset_issues(
    plan: LoopPlan, law: CorrectionLaw, number: int, offsets: LevelCorrection
) -> list[Issue]:
    """Return a warning if offsets of level ``number`` were limited, or a force is beyond its curve."""
    if not offsets.clipped:
        return []
    level = plan.levels[number]
    excess_force = float((offsets.force - level.loads[:, -1]).max())
    if excess_force > 0.0:
        message = (
            f"level {number}: {offsets.force.max():.0f} N are predicted, curves end {excess_force:.0f} N "
            "below; the springback at their ends is used"
        )
        hint = "check the force sensor, or state the force in the problem (force_n) and write curves again"
    else:
        message = f"level {number}: offsets were limited to 0 to {law.max_offset / MM:g} mm"
        hint = "allow more (most_mm), if the cell and the controller do"
    return [Issue("forming.loop_range", message, Severity.WARNING, field="most_mm", hint=hint)]


def _map_page(
    plan: LoopPlan, law: CorrectionLaw, border: JobStability, measured: MeasuredForces, kappa: float
) -> str:
    from planner.loops.job_stability import stability_map

    exhibits_by_name = {"lifts": _lifts_exhibit(plan, measured, kappa), "map": stability_map(border, law)}
    return _loop_page(
        f"Springback loop of pass {plan.name}",
        {name: exhibit for name, exhibit in exhibits_by_name.items() if exhibit},
    )


def _lifts_exhibit(plan: LoopPlan, measured: MeasuredForces, kappa: float) -> dict[str, Any]:
    """Return an exhibit with lifts of the tool, at which springback was measured, over the force.

    At most ``MAX_SHOWN_LIFTS`` lifts are shown. Each has the model's curve of its point, the curve times
    ``kappa``, and the measured value. The result is empty without lifts.
    """
    import numpy as np

    from planner.geometry.arrays import spread_rows
    from planner.loops.level_correction import model_springback

    measured_lifts = [
        (number, int(point))
        for number, lifts in enumerate(measured.lift)
        for point in np.flatnonzero(np.isfinite(lifts))
    ]
    chosen_indices = spread_rows(len(measured_lifts), MAX_SHOWN_LIFTS)
    series: list[dict[str, Any]] = []
    for colour, (number, point) in enumerate(measured_lifts[index] for index in chosen_indices):
        level = plan.levels[number]
        x = np.linspace(0.0, float(level.loads[point, -1]), 60)
        model = np.array(
            [model_springback(level, np.full(len(level.path_index), force))[point] for force in x]
        )
        curves = (
            (x, model, ""),
            (x, kappa * model, "dashed"),
            (measured.force[number][[point]], measured.lift[number][[point]], "dots"),
        )
        name = f"level {number}, point {point}"
        series += [
            {"name": name, "x": force, "y": springback / MM, "colour": colour, "style": style}
            for force, springback, style in curves
        ]
    return (
        {}
        if not series
        else {
            "kind": "curve",
            "title": "Springback over force, and measured lifts",
            "note": f"lines: the model; dashed: times kappa {kappa:.3f}; dots: lifts of the tool",
            "x_label": "force along z [N]",
            "y_label": "springback [mm]",
            "series": tuple(series),
        }
    )


def _loop_page(title: str, shown: dict[str, Any]) -> str:
    from planner.report import exhibits

    about = "Stability of the loop, by the model's springback and forces."
    return exhibits.exhibits_page(title, ("loop", "Loop from level to level"), shown, about)


@dataclasses.dataclass(frozen=True)
class SimulateLoop:
    """Simulate the loop on sheets with known springback, force and robots.

    It shows the remaining error, and when the loop oscillates. It compares no correction, the rule of the
    dissertation, and your rule.
    """

    folder: tyro.conf.Positional[Path]
    """result folder of `tandem plan`"""
    law: tyro.conf.OmitArgPrefixes[LawOptions]
    plant: Path
    """sheets and robots, YAML"""
    sheets: int = 100
    """number of formed sheets"""
    seed: int = 0
    """seed of the first sheet"""
    lifts_mm: tuple[float, ...] = ()
    """depths at which the tool is lifted to measure kappa; the first ones early, such as 1 2 5 10 15"""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """an .html page: errors over depth, the stability map"""


def run_simulate_loop(request: SimulateLoop) -> tuple[Issue, ...]:
    """Simulate the springback loop on random sheets, and print and write the remaining errors.

    It is simulated without correction, with the rule "half", and with the law of the request.

    Returns:
        No issues.

    Raises:
        TandemError: Options, curves or the plant are not usable.
    """
    from planner.loops.job_stability import job_stability, require_stability
    from planner.loops.level_correction import CorrectionLaw
    from planner.loops.plant import read_plant
    from planner.loops.simulate import run_loop

    require_suffix(request.output, "a file is .html", (".html",))
    if not 1 <= request.sheets <= MAX_SHEETS:
        raise TandemError(_out_of_range("sheets", request.sheets, f"1 to {MAX_SHEETS}"))
    if not 0 <= request.seed <= MAX_SEED:
        raise TandemError(_out_of_range("seed", request.seed, f"0 to {MAX_SEED}"))
    plant = read_plant(request.plant)
    plan, law = _read_plan(request.folder, request.law), _make_law(request.law)
    border = job_stability(plan, law, model_error=request.law.model_error)
    require_stability(border, law)
    deepest = plan.levels[-1].depth
    for lift in request.lifts_mm:
        if not 0.0 < lift * MM <= deepest:
            raise TandemError(_out_of_range("lifts_mm", lift, f"above 0 and at most {deepest / MM:g}"))
    level_depth = deepest / len(plan.levels)
    seeds = [request.seed + index for index in range(request.sheets)]
    # for comparison: the rule "half", with an action for about every millimetre of depth
    half_rule = CorrectionLaw(rule="half", every=max(1, round(MM / level_depth)), feed_forward=False)
    runs = {
        "not corrected": run_loop(plan, plant, None, seeds),
        _law_title(half_rule): run_loop(plan, plant, half_rule, seeds),
        f"yours: {_law_title(law)}": run_loop(
            plan, plant, law, seeds, [lift * MM for lift in request.lifts_mm]
        ),
    }
    table = Table("loop", "largest mm", "95 % of sheets", "mean mm", "95 % of sheets", "at depth mm")
    for name, simulated in runs.items():
        table.add_row(name, *_run_figures(simulated))
    out.print(table)
    worst_level = border.worst_level
    out.print(
        f"{request.sheets} sheets of {plant.name}, errors below 2 mm of depth; q {border.ratio:.2f}, border "
        f"{border.max_ratio[worst_level]:.2f} at gamma {border.gamma[worst_level]:.2f}"
    )
    if request.output is not None:
        from planner.loops.job_stability import stability_map

        exhibits_by_name = {"errors": _errors_exhibit(runs), "map": stability_map(border, law)}
        write_output(
            request.output, _loop_page(f"Simulated springback loop of pass {plan.name}", exhibits_by_name)
        )
    return ()


def _law_title(law: CorrectionLaw) -> str:
    return f"rule {law.rule}, each {'level' if law.every == 1 else f'{law.every} levels'}"


def _run_figures(simulated: LoopRun) -> tuple[str, ...]:
    """Return the errors of a simulated loop [mm] as table cells: means over the sheets and 95 % quantiles."""
    import numpy as np

    largest, mean = simulated.max_error() / MM, simulated.mean_error() / MM
    values: Sequence[FloatArray | float] = (
        largest.mean(),
        float(np.quantile(largest, 0.95)),
        mean.mean(),
        float(np.quantile(mean, 0.95)),
        simulated.final_mean_error().mean() / MM,
    )
    return tuple(f"{value:.2f}" for value in values)


def _errors_exhibit(runs: dict[str, LoopRun]) -> dict[str, Any]:
    """Return a picture of the mean error over depth, with one curve for each simulated loop."""
    import numpy as np

    first_run = next(iter(runs.values()))
    series = [
        {"name": name, "y": np.abs(simulated.error).mean(axis=(0, 2)) / MM}
        for name, simulated in runs.items()
    ]
    return {
        "kind": "curve",
        "title": "Mean error of the released part over depth",
        "x": first_run.depth / MM,
        "x_label": "depth [mm]",
        "y_label": "error [mm]",
        "series": tuple(series),
    }
