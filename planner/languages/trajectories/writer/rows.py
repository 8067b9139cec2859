"""Rows of a trajectory file: JSON Lines, one step or one point of a move a line
([page](docs/trajectories.md)).

Metres, radians, seconds, kilograms; a pose is a position and a rotation vector."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from planner.geometry.arrays import FloatArray, log_rotation
from planner.issues import refusal
from planner.languages.writing.layout import LINE_END, number, plain

VERSION: Final = 2
"""The form of the file."""
TIME_DECIMALS: Final = 6
"""Decimals of times in s."""
JOINT_DECIMALS: Final = 9
"""Decimals of joints in rad and of their velocities in rad/s."""
METRE_DECIMALS: Final = 7
"""Decimals of positions in m."""
NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_/.-]{0,99}", re.ASCII)
"""What may be a name in a row."""


def row(values: Mapping[str, object]) -> str:
    """A row of keys and their values, which are JSON already where they are :class:`Written`."""
    parts = (f"{json.dumps(key)}:{_value(value)}" for key, value in values.items())
    return f"{{{','.join(parts)}}}"


class Written(str):
    """A value as it stands in the row."""


def _value(value: object) -> str:
    return value if isinstance(value, Written) else json.dumps(value, separators=(",", ":"))


def text(value: str) -> str:
    """Text as it stands in a row: printable ASCII on one line."""
    return plain(value)


def name(value: str) -> str:
    """A name as rows have them. Raises :class:`TandemError` (``post.name``) for what is none."""
    if NAME.fullmatch(value) is None:
        message = f"{value!r} cannot name anything in a trajectory file"
        hint = "a letter, then letters, digits and _ / . -, 100 at most"
        raise refusal("post.name", message, hint=hint)
    return value


def stem(problem: str) -> str:
    """The file's name without its ending, from the problem's. Raises as :func:`name`."""
    return name(re.sub(r"[^a-z0-9]+", "_", plain(problem).lower()).strip("_")[:60].strip("_"))


def numbers(values: Iterable[float], decimals: int) -> Written:
    """A list of numbers."""
    return Written(f"[{','.join(number(float(v), decimals) for v in values)}]")


def real(value: float, decimals: int) -> Written:
    """A number."""
    return Written(number(value, decimals))


def pose(matrix: FloatArray) -> Written:
    """A pose of (4, 4) [m]."""
    place = [number(float(v), METRE_DECIMALS) for v in matrix[:3, 3]]
    turn = [number(float(v), JOINT_DECIMALS) for v in log_rotation(matrix[None, :3, :3])[0]]
    return Written(f"[{','.join([*place, *turn])}]")


def sealed(lines: Sequence[str]) -> str:
    """The file of these rows and the one that counts and seals them: SHA-256 of the rows before it, each with
    a line feed."""
    digest = hashlib.sha256("".join(f"{line}\n" for line in lines).encode("ascii")).hexdigest()
    rows = [*lines, row({"end": len(lines) + 1, "sha256": digest})]
    return "".join(f"{line}{LINE_END}" for line in rows)
