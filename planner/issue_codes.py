"""Every issue code with its meaning: the one table that code, tests, ``tandem issues`` and the docs share.

A code is ``room.what``; it is stable once released.
"""

from __future__ import annotations

from typing import Final

CODES: Final[dict[str, str]] = {
    # problem files
    "problem.missing_file": "a file that the problem names does not exist",
    "problem.not_yaml": "the problem file is not YAML",
    "problem.field": "a field of the problem file is missing, unknown or out of range",
    "problem.duplicate_name": "two things of the same kind have the same name",
    "problem.too_large": "a file is larger than what is read",
    "problem.unknown_robot": "a robot that the catalogue does not have",
    "problem.unknown_arm": "an operation names an arm that the cell does not have",
    "problem.unknown_process": "an operation names a process that is not built in",
    "problem.not_finite": "a number is NaN or infinite",
    # catalogue and cell
    "catalogue.missing_data": "a data file that is part of Tandem is missing",
    "cell.body_name": "a body of the cell has a name that another body has, or that is reserved",
    # saved plans
    "plan.missing_file": "a file of a saved plan is missing or cannot be read",
    "plan.damaged": "a file of a saved plan is damaged",
    "plan.schema": "a saved plan comes from another format or schema version",
    "plan.not_saveable": "a plan holds a value that is neither an array nor plain data",
    # report
    "report.exhibit": "an exhibit of a process is not of its kind's form and was left out of the report",
    "report.replay_failed": "the 3D replay could not be written",
    # the general door, process: targets
    "targets.file": "a file of targets cannot be read, or a value in it is missing or out of range",
    "targets.freedom": "a free axis gives both a turn and a slide, or neither",
    # wire shapes
    "wire.too_short": "a wire is shorter than the distance between its clamps",
    "wire.unknown_material": "a wire material that is not built in",
    "wire.size": "the size of a wire or strip is missing, contradictory or not positive",
    "wire.temperature": "a wire temperature outside the range of its material",
    "wire.no_equilibrium": "the solver found no equilibrium of a wire with weight near its guess",
    "wire.no_stable_shape": "no stable shape of a wire was found between its clamps",
    # meshes and parts
    "mesh.unreadable": "a mesh file is of a kind that is not read, or is damaged",
    "mesh.empty": "a mesh file has no faces with area",
    "mesh.unit": "a mesh is implausibly large or small in the unit stated for it",
    "mesh.non_manifold": "more than two faces of a mesh meet at an edge",
    "mesh.orientation": "neighbouring faces of a mesh have opposite normals",
    "mesh.closed": "a closed mesh is given where one open face is wanted",
    "mesh.pieces": "a mesh has several separate pieces where one is wanted",
    "part.offset": "a face is bent more tightly than the distance by which it is to be offset",
    "part.stock_too_small": "the part does not fit into the block",
    "part.faces": "front and back face of a part do not lie on each other's inner side",
    # writing programs
    "post.tasks": "the controller has no task or unit for an arm, or has too few",
    "post.controller": "a robot's controller speaks a language that no writer is built in for",
    "post.plan": "a plan has times or joints that no program can carry out",
    "post.action": "an action of the process is at a target where the motion does not stop",
    "post.name": "a segment, tool or signal has a name that the language does not take, or that another thing has",
    "post.tool": "a tool's data cannot be written",
    "post.frame": "targets lie in a work frame that the program cannot refer to",
    "post.no_split": "a program is too long for one module and has no stop to split it at",
    # internal
    "internal.error": "Tandem itself failed; nothing was written",
}
