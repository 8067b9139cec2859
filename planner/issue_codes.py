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
    # internal
    "internal.error": "Tandem itself failed; nothing was written",
}
