"""What is made of a result folder later: report and replay, maps of freedoms, files for CAD programs and for
other machines.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from planner.cli.console import write_file
from planner.files import write_whole
from planner.geometry.units import MM
from planner.issues import refusal
from planner.pipeline import FIRST_TARGETS, planned_result, read_programs, verify
from planner.problem import Problem

if TYPE_CHECKING:
    from planner.plans import Plan
    from planner.proof.verdict import Proof
    from planner.report.freedom_map import FreedomMap

GCODE: Final = ".ngc"
"""Ending of files for five-axis machines."""


def write_pages(folder: str | Path, processes: int = 1, maps: bool = False) -> Proof:
    """Write report and replay into a result folder, of its problem, its plan and the proof of its programs,
    which is made anew and given back; ``processes`` as for :func:`planner.pipeline.plan`. With ``maps`` the
    report has a map of each freedom over some targets. Raises ``TandemError`` for what is missing or damaged
    there."""
    from planner.report import output

    problem, made = planned_result(folder)
    proof = verify(problem, read_programs(folder), processes)
    shown = list(maps_of(problem, made)) if maps else []
    for name, text in output.pages(problem, made, proof, maps=shown).items():
        write_whole(Path(folder) / name, text)
    return proof


def maps_of(problem: Problem, made: Plan) -> Iterator[FreedomMap]:
    """Maps of all freedoms of all operations, over :data:`planner.pipeline.FIRST_TARGETS` targets of each,
    with the plan's values."""
    from planner.geometry.arrays import spread_rows
    from planner.motion import axis_map
    from planner.motion.planning_scene import Scene
    from planner.motion.search.subsampling import subset
    from planner.report.freedom_map import FreedomMap
    from planner.report.output import cell_model

    for index, own in enumerate(made.operations):
        setup = problem.setup_of(index)
        place, model = made.places[setup.number - 1], cell_model(problem, made, setup)
        scene = Scene.of(setup.cell, own.targets.arms, place, problem.settings, model, made.bases)
        rows = spread_rows(own.targets.count, FIRST_TARGETS)
        few, columns = subset(own.targets, rows), [one.name for one in own.targets.freedoms]
        names = tuple(own.targets.name(row) for row in rows.tolist())
        for freedom, unit in axis_map.freedoms(own.targets, stated=False).items():
            found = axis_map.axis_map(scene, few, freedom, own.values[rows])
            shown, scale = axis_map.SHOWN[unit]
            yield FreedomMap(
                operation=own.name,
                freedom=freedom,
                unit=shown,
                names=names,
                values=found.values / scale,
                states=found.places.state,
                causes=("", *axis_map.CAUSES.values()),
                apart=found.clearance / MM,
                clearance=problem.settings.clearance / MM,
                path=own.values[rows, columns.index(freedom)] / scale,
            )


def export(
    folder: str | Path, output: Path, seconds: float = 0.0, machine: str | None = None, reverse: str = ""
) -> Path:
    """Write the cell at ``seconds`` after the plan's first target, with wanted and simulated part, ways of
    tools and wires, for CAD programs: ``output`` is a .glb or .3dm file. A .ngc file has what was milled as
    G-code for a five-axis ``machine``, by its name in
    :data:`planner.processes.milling.plan.gcode.state.KINEMATICS`, whose rotary axes in ``reverse`` count
    the other way round.

    Raises ``TandemError``: ``problem.field`` for another ending, a time that the plan does not have or a
    machine that cannot do it, ``upload.unproven`` for G-code of what is not proven, ``part.extra_missing``,
    ``output.folder``, and for what is missing or damaged in the folder.
    """
    from planner.report import cad_export, rhino_file
    from planner.report.output import cell_model

    kinds = (*cad_export.KINDS, GCODE)
    if output.suffix.lower() not in kinds:
        what = f"-o: got {output.name}, allowed are files that end in {' or '.join(kinds)}"
        raise refusal("problem.field", what, field="output")
    if (output.suffix.lower() == GCODE) != (machine is not None):
        what = f"--machine: got {machine}; {GCODE} files need one, other files have none"
        raise refusal("problem.field", what, field="machine")
    problem, made = planned_result(folder)
    if machine is not None:
        write_file(output, _milled(Path(folder), problem, made, machine, reverse).encode("ascii"))
        return output
    at = cad_export.moment(problem, made, seconds)
    cut = cad_export.simulated(Path(folder) / "simulated_part.obj")
    shapes = cad_export.shapes(cell_model(problem, made, at.setup), problem, made, at, cut)
    if output.suffix.lower() == ".glb":
        write_file(output, cad_export.glb(shapes))
        return output
    lines, targets = cad_export.lines(problem, made, at), cad_export.targets(problem, made)
    write_file(output, rhino_file.rhino(itertools.chain(shapes, lines, targets)))
    return output


def _milled(folder: Path, problem: Problem, made: Plan, machine: str, reverse: str) -> str:
    """What a proven result mills as G-code."""
    from planner.processes.milling.plan.gcode import inverse_time, state
    from planner.shopfloor.loading import proven

    if machine not in state.KINEMATICS:
        what = f"--machine: got {machine}, allowed are {', '.join(state.KINEMATICS)}"
        raise refusal("problem.field", what, field="machine")
    letters = state.KINEMATICS[machine].letters
    if not set(reverse) <= set(letters) or len(set(reverse)) != len(reverse):
        what = f"--reverse: got {reverse[:20]!r}, allowed are letters of {letters}, each once"
        raise refusal("problem.field", what, field="reverse")
    if made.digest != problem.digest:  # the proof is of the programs, and G-code is written of the plan
        what = (
            f"plan.json is of problem {made.digest[:12]}, the folder holds {problem.digest[:12]}; plan again"
        )
        raise refusal("upload.unproven", f"{folder}: {what}", file=str(folder))
    proven.read(folder, problem)
    each = zip(problem.operations, made.operations, strict=True)
    ways = [inverse_time.way_of(own, done.targets, done.values, done.time) for own, done in each]
    return inverse_time.program(problem.name, ways, state.convention(machine, reverse))
