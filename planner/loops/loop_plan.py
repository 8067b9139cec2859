"""Data about a pass that the correction from level to level needs before forming, as a value and as a file.

A level is one turn of the path around the part. Its points are positions along the path at which force is
measured. Each point has the curve of springback over force, for the sheet as formed so far, and the expected
force. ``tandem springback PROBLEM --curves FILE`` writes the file (JSON, lengths in mm, forces in N). The
file states the digest of its problem.
"""

import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, model_validator

from planner.files import is_file, missing_file_reason
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.reading.forces_file import ExpectedLevels
from planner.reading.strict_yaml import Name, Strict

MAX_FILE_BYTES: Final = 50_000_000
"""Maximum size of a file of curves [bytes]."""
MAX_COORDINATE_MM: Final = 10_000.0
"""Maximum absolute coordinate [mm]."""
OTHER_FILE_KINDS: Final = {
    "tandem_springback": "is a springback file, written by tandem springback --write",
    "tandem_level": "has the shifts of one level, written by tandem next-loop --problem",
    "tandem_offsets": "has the offsets of one level, written by tandem next-loop -o",
}
"""Descriptions of files with shifts but no curves, by the key that marks them instead of ``tandem_loop``."""


@dataclasses.dataclass(frozen=True)
class FormingLevel:
    """A level: one turn of the tool along a closed path with K positions, P of which are control points.

    At each control point, a curve gives the springback of the sheet for any forming force. All forces are
    along the tool's direction (z).

    Attributes:
        path: Contact positions at equal distances along the closed path (K, 3) [m].
        depth: Depth below the flat sheet, along the tool's direction [m].
        path_index: Index of each control point among the positions of the path, ascending (P,).
        loads: Forces at which the curve of each control point is given, increasing from 0 to the largest one
            that was computed (P, L) [N].
        springback: Springback at these forces, increasing from 0 (P, L) [m].
        force: Expected steady forming force at each control point (P,) [N].
    """

    path: FloatArray
    depth: float
    path_index: IntArray
    loads: FloatArray
    springback: FloatArray
    force: FloatArray

    @functools.cached_property
    def curves(self) -> FloatArray:
        """Coefficients (4, P, L - 1) of the cubics between the loads of each point's curve.

        The coefficient of the third power is first. The variable is the load [N] above that at the start of
        the piece. The cubics are monotone. Their slopes at the loads are those of F. N. Fritsch, J. Butland,
        SIAM Journal on Scientific and Statistical Computing 5 (1984) 300, as in
        `scipy.interpolate.PchipInterpolator`, here for all points at once.
        """
        h = np.diff(self.loads, axis=1)
        m = np.diff(self.springback, axis=1) / h
        slope = np.repeat(m[:, :1], h.shape[1] + 1, axis=1)
        if h.shape[1] > 1:
            first_weight, second_weight = 2.0 * h[:, 1:] + h[:, :-1], h[:, 1:] + 2.0 * h[:, :-1]
            slope[:, 1:-1] = (first_weight + second_weight) / (
                first_weight / m[:, :-1] + second_weight / m[:, 1:]
            )
            for end, outer, inner in ((0, 0, 1), (-1, -1, -2)):
                a, b = h[:, outer], h[:, inner]
                slope[:, end] = np.maximum(((2.0 * a + b) * m[:, outer] - a * m[:, inner]) / (a + b), 0.0)
        low, high = slope[:, :-1], slope[:, 1:]
        cubic = (low + high - 2.0 * m) / h**2
        quadratic = (3.0 * m - 2.0 * low - high) / h
        return np.stack([cubic, quadratic, low, self.springback[:, :-1]])

    @functools.cached_property
    def spacing(self) -> float:
        """Mean distance [m] between two consecutive positions of the path."""
        closed_path = np.vstack([self.path, self.path[:1]])
        return float(lengths(np.diff(closed_path, axis=0)).mean())


@dataclasses.dataclass(frozen=True)
class LoopPlan:
    """A pass, level by level.

    Attributes:
        name: Name of the pass.
        digest: Digest of the problem.
        side: 1 if the tool moves down, -1 if it moves up.
        radius: Radius of the tool's ball [m].
        force_exponent: Exponent m of the force F ~ step^m.
        levels: The levels in the order in which they are formed.
    """

    name: str
    digest: str
    side: int
    radius: float
    force_exponent: float
    levels: tuple[FormingLevel, ...]

    @property
    def expected_forces(self) -> ExpectedLevels:
        """What :func:`planner.reading.forces_file.read_forces` expects of a file of measured forces.

        A measured force far above the largest force of a level's curves, or far below the expected one,
        indicates a wrong unit. A stated position must be that of the control point.
        """
        return ExpectedLevels(
            self.name,
            tuple(level.path[level.path_index, :2] for level in self.levels),
            np.array([float(level.loads.max()) for level in self.levels]),
            np.array([float(level.force.max()) for level in self.levels]),
        )


Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_MM, le=MAX_COORDINATE_MM, allow_inf_nan=False)]
Force = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class PointFile(Strict):
    """A point of a level."""

    place: Annotated[int, Field(ge=0)]
    forces_n: Annotated[list[Force], Field(min_length=2, max_length=50)]
    springback_mm: Annotated[list[Coordinate], Field(min_length=2, max_length=50)]
    expected_n: Force

    @model_validator(mode="after")
    def _grows(self) -> "PointFile":
        if len(self.forces_n) != len(self.springback_mm):
            raise ValueError(f"{len(self.forces_n)} forces, but {len(self.springback_mm)} springback_mm")
        for name, values in (("forces_n", self.forces_n), ("springback_mm", self.springback_mm)):
            if values[0] != 0.0 or any(b <= a for a, b in itertools.pairwise(values)):
                raise ValueError(f"{name}: values must start with 0 and increase")
        return self


class LevelFile(Strict):
    """A level."""

    depth_mm: Annotated[float, Field(ge=0, le=MAX_COORDINATE_MM)]
    path_mm: Annotated[
        list[tuple[Coordinate, Coordinate, Coordinate]], Field(min_length=3, max_length=100_000)
    ]
    points: Annotated[list[PointFile], Field(min_length=1, max_length=10_000)]

    @model_validator(mode="after")
    def _on_path(self) -> "LevelFile":
        places = [point.place for point in self.points]
        if places[-1] >= len(self.path_mm) or any(b <= a for a, b in itertools.pairwise(places)):
            raise ValueError(f"points: place must increase and be below {len(self.path_mm)}")
        if len({len(point.forces_n) for point in self.points}) > 1:
            raise ValueError("points: all curves of a level must have the same number of forces")
        return self


class PassFile(Strict):
    """A pass."""

    name: Name
    side: Literal[1, -1]
    ball_radius_mm: Annotated[float, Field(gt=0, le=1000)]
    force_exponent: Annotated[float, Field(gt=0, le=2)]
    levels: Annotated[list[LevelFile], Field(min_length=1, max_length=10_000)]


class LoopFile(Strict):
    """Curves of springback for the loop from level to level."""

    tandem_loop: Literal[1]
    problem: Annotated[str, Field(max_length=200)]
    digest: Annotated[str, Field(max_length=200)]
    passes: Annotated[list[PassFile], Field(min_length=1, max_length=1000)]


def read_loop_plan(path: Path, name: str | None = None) -> LoopPlan:
    """Read a pass from a file of curves.

    Args:
        path: File of curves.
        name: Name of the pass, by default the first one.

    Raises:
        TandemError: The file or the pass is missing, or the file is too large, truncated, of another kind or
            has an invalid value (``forming.loop_curves``).
    """
    file = str(path)
    rewrite_hint = "write it again: tandem springback PROBLEM --curves FILE"
    if not is_file(path):
        raise TandemError(_curves_issue(file, None, f"{file}: {missing_file_reason(path)}", rewrite_hint))
    if path.stat().st_size > MAX_FILE_BYTES:
        raise TandemError(_curves_issue(file, None, f"larger than {MAX_FILE_BYTES / 1e6:g} MB", rewrite_hint))
    try:
        loop_file = TypeAdapter(LoopFile).validate_json(path.read_bytes())
    except ValidationError as error:
        errors = error.errors()
        other_kinds = [
            OTHER_FILE_KINDS[key] for key in OTHER_FILE_KINDS if any(item["loc"] == (key,) for item in errors)
        ]
        if other_kinds:
            message = f"{path.name} {other_kinds[0]}; required: the curves of every level"
            hint = "give the file of curves: tandem springback PROBLEM --curves FILE writes it"
            raise TandemError(_curves_issue(file, None, message, hint)) from error
        raise TandemError(
            [
                _curves_issue(
                    file,
                    ".".join(map(str, item["loc"])),
                    f"{item['msg']}; got {item.get('input')!r:.80}",
                    rewrite_hint,
                )
                for item in errors[:10]
            ]
        ) from error
    matching = [item for item in loop_file.passes if name in (None, item.name)]
    if not matching:
        available = ", ".join(item.name for item in loop_file.passes)
        raise TandemError(
            _curves_issue(file, "passes", f"got pass {name}, allowed {available}", "name one of them")
        )
    return _to_plan(matching[0], loop_file.digest)


def _curves_issue(file: str, field: str | None, message: str, hint: str) -> Issue:
    return Issue("forming.loop_curves", message, file=file, field=field, hint=hint)


def _to_plan(pass_file: PassFile, digest: str) -> LoopPlan:
    """Convert a pass of the file to SI units."""
    levels = [
        FormingLevel(
            path=np.array(level.path_mm) * MM,
            depth=level.depth_mm * MM,
            path_index=np.array([point.place for point in level.points]),
            loads=np.array([point.forces_n for point in level.points]),
            springback=np.array([point.springback_mm for point in level.points]) * MM,
            force=np.array([point.expected_n for point in level.points]),
        )
        for level in pass_file.levels
    ]
    return LoopPlan(
        pass_file.name,
        digest,
        pass_file.side,
        pass_file.ball_radius_mm * MM,
        pass_file.force_exponent,
        tuple(levels),
    )
