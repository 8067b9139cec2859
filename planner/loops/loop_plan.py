"""What the loop from level to level knows of a pass before it is formed, as a value and as a file.

A level is a loop of the path. At its points, places along it where force is measured, stands the curve of
springback over force of the sheet as formed so far, and the force that is expected. ``tandem springback
PROBLEM --curves FILE`` writes the file (JSON, lengths in mm, forces in N); the digest says of which problem.
"""

import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError, model_validator

from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, IntArray, lengths
from planner.geometry.units import MM
from planner.issues import Issue, TandemError
from planner.reading.forces_file import Asked
from planner.reading.strict_yaml import Name, Strict

MOST_BYTES: Final = 50_000_000
"""Bytes of a file of curves at most."""
FARTHEST: Final = 10_000.0
"""Coordinates up to this [mm] are read."""
OTHER_KINDS: Final = {
    "tandem_springback": "is a springback file, as tandem springback --write writes it",
    "tandem_level": "has the shifts of one level, as tandem next-loop --problem writes them",
    "tandem_offsets": "has the offsets of one level, as tandem next-loop -o writes them",
}
"""What files with shifts and no curves are, by what they have in place of ``tandem_loop``."""


@dataclasses.dataclass(frozen=True)
class Level:
    """A loop of the path: ``path`` (K, 3) [m], places of contact evenly along it, closed; ``depth`` [m] below
    the flat, along the tool's way. Of its P points ``place`` (P,) on the path, rising; ``loads`` (P, L) [N]
    and ``springback`` (P, L) [m], both from 0 and growing; ``force`` (P,) [N] that is expected."""

    path: FloatArray
    depth: float
    place: IntArray
    loads: FloatArray
    springback: FloatArray
    force: FloatArray

    @functools.cached_property
    def curves(self) -> FloatArray:
        """Coefficients (4, P, L - 1) of the cubics through each point's curve, by powers of what the load is
        above that at the piece's start, the third first.

        Monotone, by slopes of F. N. Fritsch, J. Butland, SIAM Journal on Scientific and Statistical Computing
        5 (1984) 300, as `scipy.interpolate.PchipInterpolator` has them, here of all points at once.
        """
        h = np.diff(self.loads, axis=1)
        m = np.diff(self.springback, axis=1) / h
        slope = np.repeat(m[:, :1], h.shape[1] + 1, axis=1)
        if h.shape[1] > 1:
            one, two = 2.0 * h[:, 1:] + h[:, :-1], h[:, 1:] + 2.0 * h[:, :-1]
            slope[:, 1:-1] = (one + two) / (one / m[:, :-1] + two / m[:, 1:])
            for end, near, next_ in ((0, 0, 1), (-1, -1, -2)):
                a, b = h[:, near], h[:, next_]
                slope[:, end] = np.maximum(((2.0 * a + b) * m[:, near] - a * m[:, next_]) / (a + b), 0.0)
        low, high = slope[:, :-1], slope[:, 1:]
        turn, bend = (low + high - 2.0 * m) / h**2, (3.0 * m - 2.0 * low - high) / h
        return np.stack([turn, bend, low, self.springback[:, :-1]])

    @functools.cached_property
    def spacing(self) -> float:
        """Way [m] between two places of the path."""
        ends = np.vstack([self.path, self.path[:1]])
        return float(lengths(np.diff(ends, axis=0)).mean())


@dataclasses.dataclass(frozen=True)
class LoopPlan:
    """A pass of ``levels``. ``name`` of the pass, ``digest`` of its problem; ``side``: 1 where the tool goes
    down, -1 up; ``radius`` [m] of its ball; ``force_exponent`` m of the force in the step."""

    name: str
    digest: str
    side: int
    radius: float
    force_exponent: float
    levels: tuple[Level, ...]

    @property
    def asked(self) -> Asked:
        """What a file of forces may have of it."""
        return Asked(
            self.name,
            tuple(level.path[level.place, :2] for level in self.levels),
            np.array([float(level.loads.max()) for level in self.levels]),
            np.array([float(level.force.max()) for level in self.levels]),
        )


Number = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST, allow_inf_nan=False)]
Force = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class PointFile(Strict):
    """A point of a level."""

    place: Annotated[int, Field(ge=0)]
    forces_n: Annotated[list[Force], Field(min_length=2, max_length=50)]
    springback_mm: Annotated[list[Number], Field(min_length=2, max_length=50)]
    expected_n: Force

    @model_validator(mode="after")
    def _grows(self) -> "PointFile":
        if len(self.forces_n) != len(self.springback_mm):
            raise ValueError(f"{len(self.forces_n)} forces, but {len(self.springback_mm)} springback_mm")
        for name, values in (("forces_n", self.forces_n), ("springback_mm", self.springback_mm)):
            if values[0] != 0.0 or any(b <= a for a, b in itertools.pairwise(values)):
                raise ValueError(f"{name}: allowed is a row that begins with 0 and grows")
        return self


class LevelFile(Strict):
    """A level."""

    depth_mm: Annotated[float, Field(ge=0, le=FARTHEST)]
    path_mm: Annotated[list[tuple[Number, Number, Number]], Field(min_length=3, max_length=100_000)]
    points: Annotated[list[PointFile], Field(min_length=1, max_length=10_000)]

    @model_validator(mode="after")
    def _on_path(self) -> "LevelFile":
        places = [point.place for point in self.points]
        if places[-1] >= len(self.path_mm) or any(b <= a for a, b in itertools.pairwise(places)):
            raise ValueError(f"points: places have to rise, and be below {len(self.path_mm)}")
        if len({len(point.forces_n) for point in self.points}) > 1:
            raise ValueError("points: curves of a level have equally many forces")
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


def read_plan(path: Path, name: str | None = None) -> LoopPlan:
    """The pass of a file that is called ``name``, else its first. Raises `TandemError` (forming.loop_curves)
    where there is no such file or pass, it is cut short, or a value is wrong."""
    file = str(path)
    again = "write it again: tandem springback PROBLEM --curves FILE"
    if not is_file(path):
        raise TandemError(_wrong(file, None, f"{file}: {no_file(path)}", again))
    if path.stat().st_size > MOST_BYTES:
        raise TandemError(_wrong(file, None, f"larger than {MOST_BYTES / 1e6:g} MB", again))
    try:
        found = TypeAdapter(LoopFile).validate_json(path.read_bytes())
    except ValidationError as error:
        wrong = error.errors()
        other = [OTHER_KINDS[name] for name in OTHER_KINDS if any(one["loc"] == (name,) for one in wrong)]
        if other:
            what = f"{path.name} {other[0]}; wanted: the curves of every level"
            hint = "give the file of curves: tandem springback PROBLEM --curves FILE writes it"
            raise TandemError(_wrong(file, None, what, hint)) from error
        raise TandemError(
            [
                _wrong(
                    file, ".".join(map(str, one["loc"])), f"{one['msg']}; got {one.get('input')!r:.80}", again
                )
                for one in wrong[:10]
            ]
        ) from error
    some = [one for one in found.passes if name in (None, one.name)]
    if not some:
        have = ", ".join(one.name for one in found.passes)
        raise TandemError(_wrong(file, "passes", f"got pass {name}, passes are: {have}", "name one of them"))
    return _value(some[0], found.digest)


def _wrong(file: str, field: str | None, what: str, hint: str) -> Issue:
    return Issue("forming.loop_curves", what, file=file, field=field, hint=hint)


def _value(one: PassFile, digest: str) -> LoopPlan:
    levels = [
        Level(
            path=np.array(level.path_mm) * MM,
            depth=level.depth_mm * MM,
            place=np.array([point.place for point in level.points]),
            loads=np.array([point.forces_n for point in level.points]),
            springback=np.array([point.springback_mm for point in level.points]) * MM,
            force=np.array([point.expected_n for point in level.points]),
        )
        for level in one.levels
    ]
    return LoopPlan(one.name, digest, one.side, one.ball_radius_mm * MM, one.force_exponent, tuple(levels))
