"""Outputs from a result folder.

These are report and replay, freedom maps, files for CAD programs and files for other machines.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from planner.cli.console import write_file
from planner.files import write_atomic
from planner.geometry.units import MM
from planner.issues import issue_error
from planner.pipeline import QUICK_CHECK_TARGETS, load_planned_result, read_programs, verify
from planner.problem import Problem

if TYPE_CHECKING:
    from planner.plans import Plan
    from planner.proof.verdict import Proof
    from planner.report.freedom_map import FreedomMapData

GCODE_SUFFIX: Final = ".ngc"
"""Suffix of files for five-axis machines."""


def write_pages(folder: str | Path, processes: int = 1, maps: bool = False) -> Proof:
    """Write report and replay into a result folder, with a new proof of its programs.

    Args:
        folder: Result folder.
        processes: As for :func:`planner.pipeline.plan`.
        maps: Whether the report gets a map of each freedom, over a sample of the targets.

    Returns:
        The new proof.

    Raises:
        TandemError: Something is missing or damaged in the folder.
    """
    from planner.report import output

    problem, plan = load_planned_result(folder)
    proof = verify(problem, read_programs(folder), processes)
    maps_shown = list(freedom_maps(problem, plan)) if maps else []
    for name, text in output.pages(problem, plan, proof, maps=maps_shown).items():
        write_atomic(Path(folder) / name, text)
    return proof


def freedom_maps(problem: Problem, plan: Plan) -> Iterator[FreedomMapData]:
    """Yield maps of all freedoms of all operations, with the plan's values.

    Each map is over :data:`planner.pipeline.QUICK_CHECK_TARGETS` targets of its operation.
    """
    from planner.geometry.arrays import spread_rows
    from planner.motion import freedom_ranges
    from planner.motion.planning_scene import Scene
    from planner.motion.search.subsampling import select_targets
    from planner.report.freedom_map import FreedomMapData
    from planner.report.output import cell_model

    for index, operation_plan in enumerate(plan.operations):
        setup = problem.setup_of(index)
        stock_pose, model = plan.stock_poses[setup.number - 1], cell_model(problem, plan, setup)
        scene = Scene.of(
            setup.cell, operation_plan.targets.arms, stock_pose, problem.settings, model, plan.bases
        )
        target_indices = spread_rows(operation_plan.targets.count, QUICK_CHECK_TARGETS)
        subset_targets = select_targets(operation_plan.targets, target_indices)
        columns = [freedom_of_targets.name for freedom_of_targets in operation_plan.targets.freedoms]
        names = tuple(operation_plan.targets.name(target_index) for target_index in target_indices.tolist())
        for freedom, unit in freedom_ranges.freedom_units(
            operation_plan.targets, has_stock_pose=False
        ).items():
            freedom_map = freedom_ranges.compute_freedom_map(
                scene, subset_targets, freedom, operation_plan.values[target_indices]
            )
            display_unit, scale = freedom_ranges.DISPLAY_UNITS[unit]
            yield FreedomMapData(
                operation=operation_plan.name,
                freedom=freedom,
                unit=display_unit,
                names=names,
                values=freedom_map.values / scale,
                states=freedom_map.grid.state,
                causes=("", *freedom_ranges.CAUSE_TEXTS.values()),
                distance=freedom_map.clearance / MM,
                clearance=problem.settings.clearance / MM,
                path=operation_plan.values[target_indices, columns.index(freedom)] / scale,
            )


def export_result(
    folder: str | Path, output: Path, seconds: float = 0.0, machine: str | None = None, reverse: str = ""
) -> Path:
    """Write a result for CAD programs or as G-code.

    A .glb or .3dm file shows the cell at one moment, with nominal and simulated part, tool paths and wires.
    A .ngc file contains the milling operations as G-code for a five-axis machine.

    Args:
        folder: Result folder.
        output: File to write.
        seconds: Moment [s] after the plan's first target.
        machine: Name in :data:`planner.processes.milling.plan.gcode.state.KINEMATICS`, for .ngc files.
        reverse: Letters of rotary axes of the machine that count in the opposite direction.

    Raises:
        TandemError: ``problem.field`` for another suffix, a time outside the plan or an unsuitable machine,
            ``upload.unproven`` for G-code of a result that is not proven, ``part.extra_missing``,
            ``output.folder``, and the issues of missing or damaged files in the folder.
    """
    from planner.report import cad_export, rhino_file
    from planner.report.output import cell_model

    kinds = (*cad_export.SUFFIXES, GCODE_SUFFIX)
    if output.suffix.lower() not in kinds:
        text = f"-o: got {output.name}, allowed suffixes: {' or '.join(kinds)}"
        raise issue_error("problem.field", text, field="output")
    if (output.suffix.lower() == GCODE_SUFFIX) != (machine is not None):
        text = f"--machine: got {machine}; it is required for {GCODE_SUFFIX} files and not allowed for others"
        raise issue_error("problem.field", text, field="machine")
    problem, plan = load_planned_result(folder)
    if machine is not None:
        write_file(output, _gcode_text(Path(folder), problem, plan, machine, reverse).encode("ascii"))
        return output
    cell_state = cad_export.cell_state(problem, plan, seconds)
    simulated_part = cad_export.read_simulated_part(Path(folder) / "simulated_part.obj")
    shapes = cad_export.shapes(
        cell_model(problem, plan, cell_state.setup), problem, plan, cell_state, simulated_part
    )
    if output.suffix.lower() == ".glb":
        write_file(output, cad_export.glb(shapes))
        return output
    lines, targets = cad_export.lines(problem, plan, cell_state), cad_export.targets(problem, plan)
    write_file(output, rhino_file.rhino_bytes(itertools.chain(shapes, lines, targets)))
    return output


def _gcode_text(folder: Path, problem: Problem, plan: Plan, machine: str, reverse: str) -> str:
    """Return the G-code of a proven milling result.

    Raises:
        TandemError: ``problem.field`` for an unsuitable machine, ``upload.unproven`` without a valid proof.
    """
    from planner.processes.milling.plan.gcode import inverse_time, state
    from planner.shopfloor.loading import proven

    if machine not in state.KINEMATICS:
        message = f"--machine: got {machine}, allowed: {', '.join(state.KINEMATICS)}"
        raise issue_error("problem.field", message, field="machine")
    letters = state.KINEMATICS[machine].letters
    if not set(reverse) <= set(letters) or len(set(reverse)) != len(reverse):
        message = f"--reverse: got {reverse[:20]!r}, allowed: letters of {letters}, each once"
        raise issue_error("problem.field", message, field="reverse")
    if plan.digest != problem.digest:  # the proof covers the programs, but G-code is written from the plan
        message = (
            f"plan.json is of problem {plan.digest[:12]}, the folder holds {problem.digest[:12]}; plan again"
        )
        raise issue_error("upload.unproven", f"{folder}: {message}", file=str(folder))
    proven.read(folder, problem)
    operation_pairs = zip(problem.operations, plan.operations, strict=True)
    paths = [
        inverse_time.machine_path(
            operation, operation_plan.targets, operation_plan.values, operation_plan.time
        )
        for operation, operation_plan in operation_pairs
    ]
    return inverse_time.write_program(problem.name, paths, state.find_convention(machine, reverse))
