"""Formats rows of a trajectory file: JSON Lines, one step or one point of a move per line.

The format is described in [docs/trajectories.md](docs/trajectories.md). Units are metres, radians, seconds
and kilograms. A pose is a position and a rotation vector.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from planner.geometry.arrays import FloatArray, log_rotation
from planner.issues import issue_error
from planner.languages.writing.layout import LINE_END, format_fixed, to_ascii

VERSION: Final = 2
"""Version of the file format."""
TIME_DECIMALS: Final = 6
"""Decimals of times in s."""
JOINT_DECIMALS: Final = 9
"""Decimals of joints in rad and of their velocities in rad/s."""
METRE_DECIMALS: Final = 7
"""Decimals of positions in m."""
NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_/.-]{0,99}", re.ASCII)
"""Pattern of names that a row may contain."""


def row(values: Mapping[str, object]) -> str:
    """Format a row as a JSON object with the keys in their order in ``values``.

    Values of :class:`JsonText` are inserted unchanged, because they are JSON already.
    """
    parts = (f"{json.dumps(key)}:{_value(value)}" for key, value in values.items())
    return f"{{{','.join(parts)}}}"


class JsonText(str):
    """A value that is already formatted as JSON."""


def _value(value: object) -> str:
    return value if isinstance(value, JsonText) else json.dumps(value, separators=(",", ":"))


def ascii_text(value: str) -> str:
    """Return text as one line of printable ASCII."""
    return to_ascii(value)


def require_name(value: str) -> str:
    """Return a valid name unchanged.

    Raises:
        TandemError: The text is not a valid name (``post.name``).
    """
    if NAME.fullmatch(value) is None:
        message = f"{value!r} is no valid name in a trajectory file"
        hint = "a letter, then letters, digits and _ / . -, 100 at most"
        raise issue_error("post.name", message, hint=hint)
    return value


def stem(problem: str) -> str:
    """Return the file name without suffix for a problem's name.

    Raises:
        TandemError: The result is not a valid name (``post.name``).
    """
    return require_name(re.sub(r"[^a-z0-9]+", "_", to_ascii(problem).lower()).strip("_")[:60].strip("_"))


def numbers(values: Iterable[float], decimals: int) -> JsonText:
    """Format a list of numbers.

    Args:
        values: The numbers.
        decimals: Number of decimals.
    """
    return JsonText(f"[{','.join(format_fixed(float(value), decimals) for value in values)}]")


def real(value: float, decimals: int) -> JsonText:
    """Format a number.

    Args:
        value: The number.
        decimals: Number of decimals.
    """
    return JsonText(format_fixed(value, decimals))


def pose(matrix: FloatArray) -> JsonText:
    """Format a pose (4, 4) [m] as position [m] and rotation vector [rad]."""
    rotation_vector = log_rotation(matrix[None, :3, :3])[0]
    position_texts = [format_fixed(float(value), METRE_DECIMALS) for value in matrix[:3, 3]]
    rotation_texts = [format_fixed(float(value), JOINT_DECIMALS) for value in rotation_vector]
    return JsonText(f"[{','.join([*position_texts, *rotation_texts])}]")


def seal_rows(lines: Sequence[str]) -> str:
    """Return the text of a file with these rows and the end row, by which a reader detects changes.

    The end row states the number of all rows including itself, and the SHA-256 of the rows before it, each
    with a line feed.
    """
    digest = hashlib.sha256("".join(f"{line}\n" for line in lines).encode("ascii")).hexdigest()
    rows = [*lines, row({"end": len(lines) + 1, "sha256": digest})]
    return "".join(f"{line}{LINE_END}" for line in rows)
