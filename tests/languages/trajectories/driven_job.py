"""The jobs of ``straight_job``, ``small_job`` and ``held_job`` as joint trajectories.

They are one arm with a bow over two setups, two arms with a bent wire, and one arm that holds the block that
the other one cuts. One ROS 2 controller moves all joints.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json

from planner.languages.writing import write
from tests.processes.hotwire.proof import straight_job
from tests.proof import held_job, small_job

BOW, BENT = "straight.trajectory.jsonl", "small.trajectory.jsonl"
COUNT = 12


def driven(problem):
    """The problem with arms that trajectories drive."""
    cell = problem.cell
    arms = tuple(
        dataclasses.replace(arm, custom_data=dataclasses.replace(arm.data, family="ROS")) for arm in cell.arms
    )
    prefix = {arm.name: f"{arm.name}_" for arm in arms}
    controller = dataclasses.replace(cell.controller, language="ros", joint_prefix=prefix)
    cell = dataclasses.replace(cell, arms=arms, controller=controller)
    return dataclasses.replace(problem, cell=cell)


def bow_problem():
    return driven(straight_job.problem())


def bent_problem():
    return driven(small_job.problem())


@functools.cache
def bow_programs():
    return write.program_files(straight_job.plan(COUNT), bow_problem())


@functools.cache
def bent_programs():
    return write.program_files(small_job.plan(), bent_problem())


def held_problem():
    return driven(held_job.problem())


@functools.cache
def held_programs():
    return write.program_files(held_job.plan(), held_problem())


def rows_of(programs):
    """The rows of the one file, without the one that seals them."""
    (text,) = programs.values()
    return [json.loads(line) for line in text.split("\r\n")[:-2]]


def written(value):
    """A value as rows have it: numbers as plain decimals."""
    if isinstance(value, float):
        return f"{value:.9f}"
    if isinstance(value, list):
        return f"[{','.join(map(written, value))}]"
    if isinstance(value, dict):
        return f"{{{','.join(f'{json.dumps(key)}:{written(one)}' for key, one in value.items())}}}"
    return json.dumps(value)


def sealed(programs, rows):
    """The file of these rows, counted and sealed as they are."""
    (name,) = programs
    lines = [row if isinstance(row, str) else written(row) for row in rows]
    digest = hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()
    end = json.dumps({"end": len(lines) + 1, "sha256": digest}, separators=(",", ":"))
    return {name: "".join(f"{line}\r\n" for line in [*lines, end])}
