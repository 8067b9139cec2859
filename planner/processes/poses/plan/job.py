"""The process ``targets``: synchronised poses for one or two arms from a CSV or JSON file."""

import csv
import io
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from planner.claims.claim import Claim
from planner.claims.dialogue import OperatorDialogue
from planner.claims.segments import Segment
from planner.files import is_file, no_file
from planner.geometry.arrays import FloatArray, from_parts, from_quaternion
from planner.geometry.units import DEG, MM
from planner.issues import Issue, TandemError, refusal
from planner.problem import Stock
from planner.processes.poses import claims
from planner.reading.strict_yaml import Name, Strict
from planner.reading.values import POSE_COLUMNS, ROW_COLUMNS
from planner.targets import Job, ScrewFreedom, Targets

MAX_TABLE_BYTES = 100_000_000
"""Tables of poses larger than this [bytes] are refused unread."""
FARTHEST_MM = 100_000.0
"""Positions farther out [mm] are refused: metres or micrometres were meant."""
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 10_000.0
MOST_LEAST_FEED_SHARE = 0.95
"""A least feed is at most this share of the feed: plans keep a reserve to the feed."""
LEAST_DISTANCE = 1e-6
"""A tool that goes no farther than this [m] stands."""
SEGMENT_LABEL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(/[A-Za-z0-9_]{1,32})?")
"""Form of a segment's label: its kind, and perhaps a name behind a slash."""
FLAG_WORDS = {"": False, "0": False, "false": False, "no": False, "1": True, "true": True, "yes": True}
"""Words of the column ``stop``."""
AXIS_INDEX = {"x": 0, "y": 1, "z": 2}
"""Index of each axis of a tool frame."""


class FreeAxis(Strict):
    """A free turn about or slide along an axis of the tool frame; with two arms in ``arms`` both share its
    value.
    """

    name: str
    arms: list[str] = Field(min_length=1, max_length=2)
    axis: Literal["x", "y", "z"]
    turn_deg: tuple[float, float] | None = None
    slide_mm: tuple[float, float] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> "FreeAxis":
        for bounds in (self.turn_deg, self.slide_mm):
            if bounds is not None and bounds[0] > bounds[1]:
                raise ValueError("turn_deg and slide_mm are [lower, upper] with lower <= upper")
        return self


class Posed(Strict):
    """Poses from a file.

    CSV columns: for each arm ``<arm>.x_mm, .y_mm, .z_mm, .qw, .qx, .qy, .qz``, besides ``feed_mm_s`` and, if
    wanted, ``feed_min_mm_s``, ``segment`` and ``stop``. JSON: a list of objects with the same keys.
    ``segment`` is a kind, or ``kind/name``, of letters, digits and ``_``, such as ``cut/front``.
    """

    name: Name
    process: Literal["targets"]
    arms: tuple[str, ...] = Field(min_length=1, max_length=2)
    file: Path
    frame: Literal["stock", "world"] = "stock"
    free: tuple[FreeAxis, ...] = ()
    feed_mm_s: Annotated[float, Field(ge=SLOWEST_MM_S, le=FASTEST_MM_S)] | None = None
    feed_min_mm_s: float = Field(
        default=0.0, ge=0, le=FASTEST_MM_S, description="a slower tool is refused and not proven; 0: none"
    )
    run_up_mm: float = Field(
        default=5.0, gt=0, le=1000, description="way from and to stops over which the tool comes up to it"
    )
    coupled: bool = False
    position_tol_mm: float = Field(default=0.01, gt=0)
    angle_tol_deg: float = Field(default=0.01, gt=0)

    @field_validator("file")
    @classmethod
    def _from_the_problem_file(cls, value: Path, info: ValidationInfo) -> Path:
        folder: Path = (info.context or {}).get("folder", Path())
        return folder / value

    any_lean: ClassVar[bool] = True
    """Its targets and claims are the same however the block leans,"""
    any_base: ClassVar[bool] = True
    """and wherever the arm stands meanwhile."""

    def leaves(self, stock: Stock) -> Stock:
        """The block as it was: what is cut stays in its place."""
        return stock

    @model_validator(mode="after")
    def _consistent(self) -> "Posed":
        if len(set(self.arms)) != len(self.arms):
            raise ValueError("arms: each arm is named once")
        names = [axis.name for axis in self.free]
        if len(set(names)) != len(names):
            raise ValueError("free: two axes have one name; rename one")
        for axis in self.free:
            if not set(axis.arms) <= set(self.arms) or len(set(axis.arms)) != len(axis.arms):
                raise ValueError(f"free: axis '{axis.name}' must name arms of this operation, each once")
        if self.feed_mm_s is not None and self.feed_min_mm_s > MOST_LEAST_FEED_SHARE * self.feed_mm_s:
            raise ValueError(f"feed_min_mm_s must not exceed {MOST_LEAST_FEED_SHARE:g} of feed_mm_s")
        return self


class PosedJob(Job[Posed]):
    """An operation that follows the poses of a file."""

    def targets(self) -> Targets:
        """Targets from the operation's file. Raises ``TandemError`` with every fault of the file, by row and
        column.
        """
        operation, setup = self.operation, self.setup
        if setup.stock.held_by is not None:
            what = (
                f"{operation.name}: arm {setup.stock.held_by} holds the block, and poses of one's own are "
                "planned for a block that stands; let it stand: leave stock.held_by out and state "
                "what bears it (support: pedestal), or where an earlier setup has it held: setup: {held_by: "
                "nobody, place: auto, support: pedestal}"
            )
            raise refusal("targets.held", what, field="operations.process", arm=setup.stock.held_by)
        rows = _rows(operation)
        poses = {arm: _poses(rows, arm, operation) for arm in operation.arms}
        count = len(rows)
        feed = np.array(
            [_number(row, "feed_mm_s", i, operation, operation.feed_mm_s) for i, row in enumerate(rows)]
        )
        if not ((feed >= SLOWEST_MM_S) & (feed <= FASTEST_MM_S)).all():
            first = int(np.argmax((feed < SLOWEST_MM_S) | (feed > FASTEST_MM_S)))
            raise TandemError(
                _fault(
                    operation,
                    first,
                    f"feed_mm_s is {feed[first]:g}, allowed {SLOWEST_MM_S:g} to {FASTEST_MM_S:g}; correct it",
                )
            )
        segment = tuple(_segment(row, i, operation) for i, row in enumerate(rows))
        stop = np.array([_flag(row, i, operation) for i, row in enumerate(rows)])
        stop[[0, -1]] = True
        travel = _travel(poses)
        least = _least(rows, operation, feed, travel, segment)
        return Targets(
            arms=operation.arms,
            pose=poses,
            frame=dict.fromkeys(operation.arms, operation.frame),
            freedoms=tuple(_freedom(axis, count) for axis in operation.free),
            feed=feed * MM,
            feed_min=least * MM,
            travel=travel,
            stop=stop,
            segment=segment,
            coupled=operation.coupled,
            run_up=operation.run_up_mm * MM,
            claims=self.claims(),
            may_stop=True,
            feed_throughout=False,
        )

    def stated(self) -> tuple[Claim, ...]:
        """Each TCP passes the poses of the file, as the proof reads it, up to its free axes."""
        op = self.operation
        free = tuple(
            claims.FreeAxis(
                tuple(axis.arms),
                AXIS_INDEX[axis.axis],
                axis.turn_deg is not None,
                *(
                    bound * (DEG if axis.turn_deg else MM)
                    for bound in axis.turn_deg or axis.slide_mm or (0.0, 0.0)
                ),
            )
            for axis in op.free
        )
        feed = None if op.feed_mm_s is None else op.feed_mm_s * MM
        tolerance = (op.position_tol_mm * MM, op.angle_tol_deg * DEG)
        least = (op.feed_min_mm_s * MM, op.run_up_mm * MM)
        return (
            claims.FollowsTable(op.name, op.arms, op.frame, free, *tolerance, feed, *least),
            OperatorDialogue(op.arms, joined=op.coupled),
        )


def _travel(poses: Mapping[str, FloatArray]) -> FloatArray:
    steps = [np.linalg.norm(np.diff(p[:, :3, 3], axis=0), axis=1) for p in poses.values()]
    return np.concatenate([[0.0], np.max(steps, axis=0)])


def _least(
    rows: list[Mapping[str, Any]],
    operation: Posed,
    feed: FloatArray,
    travel: FloatArray,
    segment: tuple[Segment, ...],
) -> FloatArray:
    """Least feeds (N,) [mm/s] on the way to each target, 0 for none. Raises ``TandemError`` where one cannot
    be kept whatever the arms can do."""
    default = operation.feed_min_mm_s
    least = np.array([_number(row, "feed_min_mm_s", i, operation, default) for i, row in enumerate(rows)])
    least[0] = 0.0
    coupled = [operation.coupled and own.kind == "transit" for own in segment]
    wrong = (
        (least < 0.0, "is below 0; give 0 for none"),
        (
            least > MOST_LEAST_FEED_SHARE * feed,
            f"is over {MOST_LEAST_FEED_SHARE:g} of the feed; lower it or raise feed_mm_s",
        ),
        (
            (least > 0.0) & (travel < LEAST_DISTANCE),
            "is asked for where the tools stand or only turn; give 0",
        ),
        (
            (least > 0.0) & np.array(coupled),
            "is asked for in a transit of joined tools, which may be led otherwise; give 0",
        ),
    )
    for bad, why in wrong:
        if bad.any():
            first = int(np.argmax(bad))
            raise TandemError(_fault(operation, first, f"feed_min_mm_s of {least[first]:g} {why}"))
    slides = [axis.name for axis in operation.free if axis.slide_mm is not None]
    if slides and least.any():
        what = (
            f"free axis '{slides[0]}' slides, which changes the tool's speed, and feed_min_mm_s asks for a "
            "least one; leave turns free alone, or take feed_min_mm_s out"
        )
        raise refusal("targets.freedom", what, field="operations.free")
    return least


def _twist(axis: FreeAxis) -> FloatArray:
    twist = np.zeros(6)
    twist[AXIS_INDEX[axis.axis] + (0 if axis.turn_deg is not None else 3)] = 1.0
    return twist


def _freedom(axis: FreeAxis, count: int) -> ScrewFreedom:
    if (axis.turn_deg is None) == (axis.slide_mm is None):
        what = f"free axis '{axis.name}': give either turn_deg or slide_mm, one of them"
        raise refusal("targets.freedom", what, field="operations.free")
    bounds = axis.turn_deg or axis.slide_mm or (0.0, 0.0)
    scale = DEG if axis.turn_deg is not None else MM
    lower, upper = (np.full(count, bound * scale) for bound in bounds)
    periodic = axis.turn_deg is not None and bounds[1] - bounds[0] >= 360.0
    return ScrewFreedom(axis.name, dict.fromkeys(axis.arms, _twist(axis)), lower, upper, None, periodic)


def _rows(operation: Posed) -> list[Mapping[str, Any]]:
    path = operation.file
    if not is_file(path):
        what = f"{path}: {no_file(path)}; check the path, which starts at the problem file's folder"
        raise refusal("problem.missing_file", what, file=str(path), field="operations.file")
    if path.stat().st_size > MAX_TABLE_BYTES:
        what = f"{path}: over {MAX_TABLE_BYTES // 1_000_000} MB; split the job"
        raise refusal("problem.too_large", what, file=str(path))
    try:
        text = path.read_bytes().decode("utf-8-sig")
        rows = json.loads(text) if path.suffix.lower() == ".json" else _table(text, operation)
    except (OSError, ValueError, RecursionError, csv.Error) as error:
        reason = str(error) or type(error).__name__
        raise TandemError(
            _fault(operation, None, f"cannot be read: {reason}; give CSV or JSON in UTF-8")
        ) from error
    if not isinstance(rows, list) or len(rows) < 2 or not all(isinstance(row, dict) for row in rows):
        raise TandemError(_fault(operation, None, "expected a list of at least 2 targets; add them"))
    known = {f"{arm}.{column}" for arm in operation.arms for column in POSE_COLUMNS} | set(ROW_COLUMNS)
    unknown = sorted({str(key) for row in rows for key in row} - known)
    if unknown:
        more, names = ", ".join(unknown[:5]), ", ".join(sorted(known))
        what = f"unknown columns {more}; remove them or correct their spelling (known: {names})"
        raise TandemError(_fault(operation, None, what))
    return rows


def _table(text: str, operation: Posed) -> list[Mapping[str, Any]]:
    """The rows of a CSV text, by column. Raises ``TandemError`` for a header or rows that do not fit."""
    lines = [line for line in csv.reader(io.StringIO(text), strict=True) if any(map(str.strip, line))]
    header = [name.strip() for name in lines[0]] if lines else []
    if len(header) == 1 and ";" in header[0]:
        raise TandemError(_fault(operation, None, "columns are parted by semicolons; use commas"))
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise TandemError(_fault(operation, None, f"column '{repeated[0]}' stands twice; keep one"))
    for i, line in enumerate(lines[1:]):
        if len(line) != len(header):
            what = f"{len(line)} cells where the header has {len(header)}; correct the row"
            raise TandemError(_fault(operation, i, what))
    return [dict(zip(header, line, strict=True)) for line in lines[1:]]


def _poses(rows: list[Mapping[str, Any]], arm: str, operation: Posed) -> FloatArray:
    table = np.array(
        [
            [_number(row, f"{arm}.{column}", i, operation) for column in POSE_COLUMNS]
            for i, row in enumerate(rows)
        ]
    )
    norm = np.linalg.norm(table[:, 3:], axis=1)
    wrong = np.abs(norm - 1.0) > 1e-3
    if wrong.any():
        first = int(np.argmax(wrong))
        raise TandemError(
            _fault(
                operation,
                first,
                f"{arm}: quaternion of length {norm[first]:.4f}, allowed 1 within 0.001; normalise it",
            )
        )
    far = (np.abs(table[:, :3]) > FARTHEST_MM).any(axis=1)
    if far.any():
        first = int(np.argmax(far))
        what = f"{arm}: a position beyond {FARTHEST_MM / 1000:g} m; give positions in mm"
        raise TandemError(_fault(operation, first, what))
    return from_parts(from_quaternion(table[:, 3:]), table[:, :3] * MM)


def _number(
    row: Mapping[str, Any], column: str, index: int, operation: Posed, default: float | None = None
) -> float:
    value = row.get(column)
    if value in (None, "") and default is not None:
        return default
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        got = "nothing" if value in (None, "") else repr(value)[:40]
        raise TandemError(
            _fault(operation, index, f"column '{column}': got {got}; a finite number is needed, correct it")
        )
    return number


def _segment(row: Mapping[str, Any], index: int, operation: Posed) -> Segment:
    value = row.get("segment") or "cut/path"
    if not isinstance(value, str) or not SEGMENT_LABEL.fullmatch(value):
        what = f"segment is {repr(value)[:60]}; use <kind> or <kind>/<name> of letters, digits and _"
        raise TandemError(_fault(operation, index, what))
    return Segment.of(value)


def _flag(row: Mapping[str, Any], index: int, operation: Posed) -> bool:
    value = row.get("stop")
    text = "" if value is None else str(value).strip().lower()
    if text not in FLAG_WORDS:
        raise TandemError(_fault(operation, index, f"stop is {repr(value)[:40]}; use true or false"))
    return FLAG_WORDS[text]


def _fault(operation: Posed, index: int | None, what: str) -> Issue:
    row = "" if index is None else f", target {index}"
    return Issue("targets.file", f"{operation.file}{row}: {what}", file=str(operation.file), index=index)
