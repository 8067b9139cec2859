"""Jobs are worked out once: targets and the claims on them follow from one and the same problem."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from numpy.typing import NDArray

from planner.milling.job import Job, job
from planner.milling.operation import Milling
from planner.problem import Part, Setup
from planner.tooling import Cutter, Mill

KEPT: Final = 4
"""So many jobs are kept, the last ones."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Known:
    """A job and all that it follows from: the very objects, not equal ones."""

    operation: Milling
    part: Part | None
    cutter: Cutter | None
    box: NDArray[np.float64]
    job: Job

    def answers(self, operation: Milling, setup: Setup, part: Part | None) -> bool:
        same = self.operation is operation and self.part is part and self.cutter is _cutter(operation, setup)
        return same and np.array_equal(self.box, setup.stock.box)


_known: list[_Known] = []


def job_once(operation: Milling, setup: Setup, part: Part | None) -> Job:
    """The job, from the problem alone, as ``job`` works it out; the last ones are remembered, and nobody can
    write into their arrays. Raises ``TandemError`` with the codes ``milling.*``."""
    for known in _known:
        if known.answers(operation, setup, part):
            return known.job
    made = job(operation, setup, part)
    _freeze(made.cuts)
    _freeze(made.faces)
    _known.append(_Known(operation, part, _cutter(operation, setup), setup.stock.box.copy(), made))
    del _known[:-KEPT]
    return made


def _cutter(operation: Milling, setup: Setup) -> Cutter | None:
    tool = setup.cell.arm(operation.arms[0]).tool
    return tool.cutter if isinstance(tool, Mill) else None


def _freeze(value: object) -> None:
    """Makes all arrays in frozen dataclasses and tuples read-only."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, tuple):
        for item in value:
            _freeze(item)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            _freeze(getattr(value, field.name))
